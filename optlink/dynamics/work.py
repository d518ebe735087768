"""Work of the drive over the crank angle, by Gauss quadrature between the angles at which a load jumps."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from optlink.dynamics.inverse import reactions
from optlink.dynamics.machine import Machine
from optlink.dynamics.runge_kutta import Step, between
from optlink.dynamics.strokes import irregular
from optlink.linkage.elements import Element
from optlink.linkage.extrema import distinct, zeros
from optlink.linkage.vector2d import TURN, Array, all_finite, whole_turns

PANELS = 180  # per range or revolution: 2 degrees each in a revolution
BESIDE = 1e-8  # rad from a jump, where some loads may have jumped and others not
HALVINGS = 30  # of the panels at most, where the torque is not smooth
BLOCK = 500  # crank angles whose panels are evaluated at a time
MOST_ROUGH = 2_000  # panels that are halved again; more are rough from rounding errors, as beside singular positions
NODES, WEIGHTS = np.polynomial.legendre.leggauss(8)
TAILS = (np.polynomial.legendre.legvander(NODES, 7)[:, 6:] * WEIGHTS[:, None]) * (np.array([6.0, 7.0]) + 0.5)
"""Last two coefficients of the Legendre series through values at the nodes."""
ROUGH = 1e-7  # share of the whole work that these may add to a panel, whose quadrature is then exact to about 1e-13


def gauss_points(a: Array, b: Array) -> tuple[Array, Array]:
    """Return the points (k, nodes) of Gauss quadrature over intervals from `a` to `b` (k,), and half their lengths (k,)."""
    half = 0.5 * (b - a)
    return (0.5 * (a + b))[:, None] + half[:, None] * NODES, half


def _at_gauss_points(function: Callable[[Array], Array], a: Array, b: Array) -> tuple[Array, Array]:
    """Return the values of a function of crank angles at `gauss_points`, and half the lengths of the intervals."""
    points, half = gauss_points(a, b)
    return function(points.ravel()).reshape(points.shape), half


def jumps(machine: Machine, low: float, high: float) -> Array:
    """Return the crank angles [rad] from `low` to below `high` at which a load, friction or a prescribed motion may jump."""
    jump_angles: list[Array] = []
    switching = [load for load in machine.loads if load.switching]
    if switching or machine.friction:

        def rates(angles: Array) -> Array:
            moving = machine.moving(angles)
            values = [(load.reversing(moving) or (0.0, 0.0))[0] for load in switching]
            values += [moving.slides[guide][1] for guide in machine.friction]
            return np.array([np.broadcast_to(value, angles.shape) for value in values])

        with np.errstate(all="ignore"):
            jump_angles += zeros(rates, _grid(low, high), still=True)
    return _rising([*jump_angles, law_knots(machine, low, high)], low, high)


def law_knots(machine: Machine, low: float, high: float) -> Array:
    """Return the crank angles [rad] from `low` to below `high` at which a law passes a knot, where its acceleration may jump."""
    return _rising([at for element in machine.mechanism.elements for at in _knots(machine, element, low, high)], low, high)


def _knots(machine: Machine, element: Element, low: float, high: float) -> list[Array]:
    """Return the crank angles at which an element passes a knot of its law."""

    def distances(angles: Array) -> Array:
        x, knots, period = element.knots(machine.mechanism.at(machine.sizes, angles))
        return np.array([np.broadcast_to(np.sin(math.pi * (x - knot) / period), angles.shape) for knot in knots])

    grid = _grid(low, high)
    return zeros(distances, grid) if element.knots(machine.mechanism.at(machine.sizes, grid[:1]))[1] else []


def corners(machine: Machine, low: float, high: float, speed: float) -> Array:
    """Return the crank angles [rad] at which a load has a corner, a row of its table, or at which a normal force is zero.

    The crank speed [rad/s] affects the normal forces.
    """
    corner_angles: list[Array] = []
    rows: list[tuple[str, float]] = []
    for load in machine.processes:
        table, guide = load.magnitude, load.guide
        at, over = np.asarray(getattr(table, "at", ()), dtype=float), getattr(table, "over", "")
        if over == "phi":
            period = TURN * getattr(table, "revolutions", 1)
            cycles = np.arange(np.floor((low - at[-1]) / period), np.ceil((high - at[0]) / period) + 1.0)
            corner_angles.append((at[:, None] + period * cycles).ravel())
        elif over == "s":
            rows += [(guide, float(value)) for value in at]
    if rows:

        def distances(angles: Array) -> Array:
            slides = machine.moving(angles).slides
            return np.array([np.broadcast_to(slides[guide][0] - value, angles.shape) for guide, value in rows])

        corner_angles += zeros(distances, _grid(low, high))
    if machine.friction:

        def normals(angles: Array) -> Array:
            guides = reactions(machine.moving(angles, speed)).guides
            return np.array([np.broadcast_to(guides[name].normal, angles.shape) for name in machine.friction])

        corner_angles += zeros(normals, _grid(low, high))
    return _rising(corner_angles, low, high)


def _grid(low: float, high: float) -> Array:
    return low + (high - low) * np.linspace(0.0, 1.0, 8 * _panels(low, high) + 1)


def _panels(low: float, high: float) -> int:
    return PANELS * whole_turns(high - low)


def _rising(lists: list[Array], low: float, high: float) -> Array:
    angles = distinct(np.concatenate([*lists, np.empty(0)]))
    inside = angles[(angles >= low) & (angles < high)]
    return inside[np.diff(inside, prepend=-np.inf) > 1e-12]


class Work:
    """Work [J] of the drive since the crank angle `start` [rad], for any crank angle from `low` to `high`; NaN beyond a pole.

    `jumps`: crank angles [rad] at which loads or friction jump; `breaks`: also those at which they have a corner; `peaks`: those
    at which an expression may have a sharp peak; `poles`: by load, those at which it grows without bound.
    """

    def __init__(self, machine: Machine, start: float, low: float, high: float, speed: float) -> None:
        self.machine, self.speed = machine, speed
        self.jumps = jumps(machine, low, high)
        irregular_angles, self.peaks, self.poles = irregular(machine, _grid(low, high), speed)
        bent = np.concatenate([corners(machine, low, high, speed), irregular_angles])
        # a normal force may change its sign by a jump
        apart = np.min(np.abs(bent[:, None] - self.jumps), axis=1, initial=np.inf) > BESIDE
        self.breaks = _rising([self.jumps, bent[apart]], low, high)
        even = np.linspace(low, high, _panels(low, high) + 1)
        beside = (even[1] - even[0]) * np.outer([-1.0, 1.0], 0.5 ** np.arange(HALVINGS))
        graded = (self.peaks[:, None] + beside.ravel()).ravel()
        knots = distinct(np.concatenate([even, self.breaks, graded[(graded > low) & (graded < high)]]))
        self.knots, pieces, self._torques = self._panels(knots)
        for pole in np.concatenate([*self.poles.values(), np.empty(0)]):
            pieces[(self.knots[:-1] <= pole) & (pole <= self.knots[1:])] = np.nan
        self._sum = np.concatenate([[0.0], np.cumsum(pieces)])
        self._start = 0.0
        self._start = float(self(np.array([start]))[0])

    def torque(self, angles: Array) -> Array:
        """Return the driving torque [N m] at crank angles (n,)."""
        torque = reactions(self.machine.moving(angles, self.speed)).torque
        return np.broadcast_to(torque, angles.shape)

    @property
    def rms_torque(self) -> float:
        """The driving torque [N m], root mean square over the range."""
        half = 0.5 * np.diff(self.knots)
        return math.sqrt(float(np.sum(half * (self._torques**2 @ WEIGHTS))) / float(self.knots[-1] - self.knots[0]))

    def mean(self, signal: Callable[[Array], Array], *, square: bool = False) -> float:
        """Return the mean, or root mean square, over the range of a function of crank angles (n,), smooth between the knots."""
        values, half = _at_gauss_points(signal, self.knots[:-1], self.knots[1:])
        mean = float(np.sum(half * ((values**2 if square else values) @ WEIGHTS))) / float(self.knots[-1] - self.knots[0])
        return math.sqrt(mean) if square else mean

    def _panels(self, knots: Array) -> tuple[Array, Array, Array]:
        """Return knots between which the torque is smooth, halved where it is not, and the works and torques between them."""
        a, b, total, panels, torques = knots[:-1], knots[1:], None, [], []
        for level in range(HALVINGS):
            values, half = _at_gauss_points(self.torque, a, b)
            if total is None:
                total = float(np.nansum(half * (np.abs(values) @ WEIGHTS)))
            with np.errstate(invalid="ignore"):  # a load without a value
                rough = half * np.max(np.abs(values @ TAILS), axis=1) > ROUGH * total
            last = level == HALVINGS - 1 or np.count_nonzero(rough) > MOST_ROUGH
            done = np.ones(len(a), dtype=bool) if last else ~rough
            panels.append(np.array([a, b, half * (values @ WEIGHTS)])[:, done])
            torques.append(values[done])
            a, middle, b = a[~done], 0.5 * (a + b)[~done], b[~done]
            if not a.size:
                break
            a, b = np.concatenate([a, middle]), np.concatenate([middle, b])
        begins, _, works = np.concatenate(panels, axis=1)
        order = np.argsort(begins)
        return np.append(begins[order], knots[-1]), works[order], np.concatenate(torques)[order]

    def __call__(self, angles: Array) -> Array:
        """Return the work [J] from the start to crank angles (n,)."""
        place = np.clip(np.searchsorted(self.knots, angles, side="right") - 1, 0, len(self.knots) - 2)
        blocks = [slice(begin, begin + BLOCK) for begin in range(0, len(angles), BLOCK)]
        parts = (_at_gauss_points(self.torque, self.knots[place[block]], angles[block]) for block in blocks)
        rest = [half * (values @ WEIGHTS) for values, half in parts]
        return np.asarray(self._sum[place] + np.concatenate([np.empty(0), *rest]) - self._start)


# Speed fluctuation in the steady state and at the end of a simulation, and flywheel sizing.

POSITIONS = 2880  # of a revolution, at which the speed is computed: every eighth of a degree
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
        self.angles = np.linspace(low, high, POSITIONS * whole_turns(cycle), endpoint=False)
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
        energy = _least_enough(lambda energy: bool(np.mean(speed(energy)) >= target), 2.0 * float(np.max(total)) * target**2)
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
    if not all_finite(balance.gain):
        return None

    without_flywheel = balance.fluctuation() if np.min(balance.inertia) > 0.0 else np.nan
    if without_flywheel <= allowed:
        return Flywheel(speed, balance.mean_torque, without_flywheel, allowed, 0.0)
    likely = max(float(np.ptp(balance.gain)) / (allowed * speed**2), 1e-12)
    inertia = _least_enough(lambda inertia: balance.fluctuation(inertia) <= allowed, likely)
    return Flywheel(speed, balance.mean_torque, without_flywheel, allowed, inertia)


def _least_enough(enough: Callable[[float], bool], likely: float) -> float:
    """Return the least positive number that is enough, to rounding, from one of about its size."""
    low, high = 0.0, likely
    while not enough(high):
        high *= 2.0
    while low < (middle := 0.5 * (low + high)) < high:  # to the last digit
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
