"""Speed fluctuation in the steady state and at the end of a simulation, and flywheel sizing."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from optlink.dynamics.machine import Machine
from optlink.dynamics.runge_kutta import Step, between
from optlink.dynamics.work import Work
from optlink.linkage.vector2d import TURN, Array

POSITIONS = 2880
HALVINGS = 100  # of a range of numbers at most
ROUNDING = 1e-9  # of a revolution, by which a run of exactly one may fall short


@dataclass(frozen=True)
class Flywheel:
    """Result of flywheel sizing for a constant driving torque.

    `mean_torque` [N m] balances the loads over a cycle at the mean speed [rad/s]; `fluctuation` is (largest - least) / mean
    speed without a flywheel, `allowed` the permitted one, `inertia` the least moment of inertia of the flywheel [kg m^2] that
    satisfies it.
    """

    mean_speed: float
    mean_torque: float
    fluctuation: float
    allowed: float
    inertia: float


class Fluctuation:
    """Energy of a machine over a cycle, which determines its speed.

    The kinetic energy changes by the work of a constant torque minus the work of loads and gravity. This work is computed at the
    mean speed, so speed-dependent loads have their values at that speed.

    References
    ----------
    Energy equation of a machine with one degree of freedom (Wittenbauer): (I + J) w^2 / 2 changes by the work done.
    """

    def __init__(self, machine: Machine, speed: float, start: float = 0.0) -> None:
        self.machine, self.mean_speed = machine, speed
        cycle = machine.cycle
        low, high = (start, start + cycle) if speed > 0.0 else (start - cycle, start)
        self.angles = np.linspace(low, high, POSITIONS * max(1, round(cycle / TURN)), endpoint=False)
        work = Work(machine, start, low, high, speed)
        self.mean_torque = float(work(np.array([high]))[0] - work(np.array([low]))[0]) / cycle
        moving = machine.moving(self.angles, speed)
        self.inertia = np.broadcast_to(2.0 * moving.kinetic / speed**2, self.angles.shape)  # reduced to the crank [kg m^2]
        kinetic = np.broadcast_to(moving.kinetic, self.angles.shape)
        load_work = work(self.angles) - kinetic  # work of loads and gravity: the drive's work minus the kinetic energy
        self.gain = self.mean_torque * (self.angles - start) - load_work

    def speeds(self, flywheel: float = 0.0) -> Array:
        """Return the speed [rad/s] at `angles` with a flywheel [kg m^2] at the crank; its mean is the machine's mean speed.

        NaN where the machine has too little energy at that speed: it would come to rest.
        """
        total = self.inertia + flywheel
        gain = self.gain - np.min(self.gain)

        def speed(energy: float) -> Array:
            return np.asarray(np.sqrt(np.maximum(2.0 * (energy + gain) / total, 0.0)))

        target = abs(self.mean_speed)
        if np.mean(speed(0.0)) > target:
            return np.full(self.angles.shape, np.nan)
        energy = _least(lambda energy: bool(np.mean(speed(energy)) >= target), 2.0 * float(np.max(total)) * target**2)
        return np.copysign(speed(energy), self.mean_speed)

    def fluctuation(self, flywheel: float = 0.0) -> float:
        """Return (largest - least) / mean speed with a flywheel [kg m^2] at the crank."""
        speeds = self.speeds(flywheel)
        return float(np.ptp(speeds) / abs(np.mean(speeds)))


def flywheel(machine: Machine, speed: float, allowed: float, start: float = 0.0) -> Flywheel | None:
    """Compute the flywheel that limits the fluctuation of the crank speed to `allowed` (share of the mean `speed` [rad/s]).

    The cycle starts at the crank angle `start` [rad]. The inertia is 0 if the fluctuation is within the limit without a
    flywheel; None where the torque is not finite at some position.
    """
    balance = Fluctuation(machine, speed, start)
    if not np.all(np.isfinite(balance.gain)):
        return None

    without_flywheel = balance.fluctuation() if np.min(balance.inertia) > 0.0 else np.nan
    if without_flywheel <= allowed:
        return Flywheel(speed, balance.mean_torque, without_flywheel, allowed, 0.0)
    likely = max(float(np.ptp(balance.gain)) / (allowed * speed**2), 1e-12)
    inertia = _least(lambda inertia: balance.fluctuation(inertia) <= allowed, likely)
    return Flywheel(speed, balance.mean_torque, without_flywheel, allowed, inertia)


def _least(enough: Callable[[float], bool], likely: float) -> float:
    """Return the least positive number that is enough, to rounding, from one of about its size."""
    low, high = 0.0, likely
    while not enough(high):
        high *= 2.0
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        if not low < middle < high:
            break
        low, high = (low, middle) if enough(middle) else (middle, high)
    return high


class LastTurn:
    """Speed of a simulated crank over its last revolution or cycle, from places within the steps of the integrator.

    `turn` [rad] is the crank rotation after which motion and loads repeat.
    """

    def __init__(self, angle: float, speed: float, turn: float = TURN) -> None:
        self.turn = turn
        self.blocks = [np.array([[0.0, angle, speed]])]  # time, crank angle, speed

    def add(self, steps: Sequence[Step], until: float) -> None:
        """Add consecutive steps, the last of which ends at `until` [s]; drop what lies more than a cycle before.

        Their states begin with crank angle and speed.
        """
        self.blocks.append(np.column_stack(between(steps, until, 2)))
        end = self.blocks[-1][-1, 1]
        while len(self.blocks) > 2 and abs(end - self.blocks[1][-1, 1]) >= self.turn:
            del self.blocks[0]

    @property
    def speed(self) -> tuple[float, float] | None:
        """Mean over time [rad/s], and (largest - least) / mean; None if the crank has not turned a cycle in one sense."""
        turn = self.turn
        time, angle, speed = np.concatenate(self.blocks).T
        turned = np.abs(angle - angle[-1])
        before = np.flatnonzero(turned >= turn * (1.0 - ROUNDING))
        if not before.size or np.any(np.diff(turned[before[-1] :]) > 0.0):
            return None
        k = int(before[-1])
        share = (turned[k] - turn) / (turned[k] - turned[k + 1])
        speeds = np.abs(np.append(speed[k + 1 :], speed[k] + share * (speed[k + 1] - speed[k])))  # the last: where it begins
        duration = time[-1] - time[k + 1] + (turn - turned[k + 1]) / (0.5 * (speeds[0] + speeds[-1]))
        mean = turn / float(duration)
        return mean, float(np.ptp(speeds)) / mean
