"""Forward dynamics of a machine: one degree of freedom under a torque or motor curve, or at a constant speed.

The crank obeys I(phi) phi'' + I'(phi) phi'^2 / 2 = torque of the drive + torque of loads and gravity, reduced to the crank.
In addition the accelerations of all bodies are integrated twice, as in a multibody code; the distance of these positions from
the closed loops is the drift. The work of drive and loads is integrated too, and compared with the energy of the bodies.

References
----------
Equation of motion of a machine with one degree of freedom (Eksergian's equation).
"""

import enum
import itertools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from optlink.dynamics.inverse import ROUNDING, Reactions, reactions, required_wrench, virtual_torque
from optlink.dynamics.machine import Machine, Magnitude, Moving
from optlink.dynamics.runge_kutta import ALL, Step, Stepper, TrialStep, attempt, states_at
from optlink.dynamics.work import LastTurn, jumps
from optlink.linkage.jet import Jet
from optlink.linkage.motion import Motion
from optlink.linkage.vector2d import Array, Value, all_finite, max_magnitude, wrapped

# Events of a simulation: crank angles at which the integration restarts or ends, and reasons for its end.

EDGE = 1e-6  # share of a limited range excluded at each end: speeds are infinite at a dead position
STILL = 1e-4  # share of the hardest impact below which a rebound from an end stop counts as rest
PASSED_JUMP = 1e-9  # rad: a jump of a load nearer than this counts as passed


class Ending(enum.Enum):
    """Reason for the end of a simulation; `text` describes it."""

    FINISHED = "finished"
    AT_REST = "at rest"
    AT_STOP = "at the end stop"
    END_OF_RANGE = "end of the range"
    DEAD_POSITION = "dead position"
    SINGULAR = "singular position"
    JAMMED = "jammed"
    UNDETERMINED = "undetermined"
    STALLED = "stalled"
    INTERRUPTED = "interrupted"

    @property
    def text(self) -> str:
        """Description in one sentence."""
        return _TEXT[self]


_TEXT = {
    Ending.FINISHED: "the whole duration was simulated",
    Ending.AT_REST: "the machine came to rest: the drive cannot overcome loads and friction there",
    Ending.AT_STOP: "the drive came to rest against the end stop",
    Ending.END_OF_RANGE: "the drive reached the end of its range",
    Ending.DEAD_POSITION: "the crank reached a position beyond which the mechanism cannot be assembled",
    Ending.SINGULAR: "the crank reached a singular position: the assembly modes meet, and the motion beyond is not determined",
    Ending.JAMMED: "friction jams a guide: no motion of the machine satisfies its law, and rest does not either",
    Ending.UNDETERMINED: "friction of a guide leaves the motion open: more than one motion, or motion and rest, satisfy it",
    Ending.STALLED: "the integration stalled: a singular position, or forces and speeds that grow without bound; "
    "results up to that time are kept. Start elsewhere, shorten the duration, or check loads and torque",
    Ending.INTERRUPTED: "interrupted; results up to that time are kept",
}


Mark = tuple[Any, Callable[[Array], float], float]
"""An event of a simulation: its kind, a quantity of the state, and the value that this passes."""


def crank_angle(state: Array) -> float:
    """Return the crank angle [rad] of a state."""
    return float(state[0])


@dataclass(frozen=True)
class Limits:
    """Crank angles or values of the cycle variable [rad] between which a machine moves, and what happens there.

    The simulation ends with `ending`; without one the drive meets an end stop: it rebounds with `restitution` times its speed,
    or without that from a stop that is among the loads.
    """

    low: float
    high: float
    ending: Ending | None = Ending.DEAD_POSITION
    restitution: float | None = None

    @property
    def marks(self) -> list[Mark]:
        """The events at both ends."""
        aside = {Ending.DEAD_POSITION: EDGE, Ending.END_OF_RANGE: -ROUNDING}.get(self.ending or Ending.FINISHED, 0.0)
        inward = aside * (self.high - self.low)
        kind = "limit" if self.ending else "switch" if self.restitution is None else "stop"
        return [(kind, crank_angle, self.low + inward), (kind, crank_angle, self.high - inward)]

    def pushes(self, angle: float, direction: float) -> float | None:
        """Return the end at which a machine is, if it would move beyond it in a direction; else None."""
        end = self.high if direction > 0.0 else self.low
        return end if abs(angle - end) <= ROUNDING * (self.high - self.low) else None


@dataclass(frozen=True)
class DriveForce:
    """A force along a line [N] as torque of the cycle variable: the slide or length is `begin` + `rate` [m/rad] * variable."""

    force: Magnitude
    begin: float
    rate: float

    def __call__(self, variables: Mapping[str, Value]) -> Value:
        """Return the force [N] times its lever [m/rad]."""
        place, speed = self.begin + self.rate * variables["phi"], self.rate * variables["omega"]
        return self.rate * self.force({**variables, "s": place, "v": speed})


def nearest(angle: float, marks: Array, cycle: float, aside: float = 0.0) -> list[float]:
    """Return the nearest below and above a crank angle [rad] of marks that repeat every cycle, at least `aside` away."""
    if not len(marks):
        return []
    every = (marks[:, None] + cycle * (np.floor(angle / cycle) + np.arange(-2.0, 3.0))).ravel()
    return [float(np.max(every[every <= angle - aside])), float(np.min(every[every >= angle + aside]))]


def first_event(step: Step, direction: float, marks: list[Mark]) -> tuple[float, Any]:
    """Return the time of the first event within a step, a mark is passed or the crank stops, and its kind; else the end.

    The state begins with crank angle and speed; `direction` is the sense in which the crank turns, 0 if it cannot come to rest.
    """
    events = [(kind, of, at) for kind, of, at in marks if (of(step.before) - at) * (of(step.after) - at) < 0.0]
    if step.before[1] * direction > 0.0 > step.after[1] * direction:
        events.append(("rest", lambda state: float(state[1]), 0.0))
    if not events:
        return step.end, None
    from scipy.optimize import brentq

    def time(of: Callable[[Array], float], at: float) -> float:
        found = brentq(lambda t: of(step.at(t)) - at, step.time, step.end, xtol=1e-16, rtol=1e-15)
        return float(found)

    return min(((time(of, at), kind) for kind, of, at in events), key=lambda event: event[0])


# Acceleration of the crank under a torque, with Coulomb friction in guides: none, one or several, and rest.
#
# References
# ---------- P. Painleve, Sur les lois du frottement de glissement, C. R. Acad. Sci. 121 (1895): friction may admit no motion, or
# several.

STEADY = 1e-13  # share of the larger torque by which a resting machine may be out of balance and still stay at rest


def required_torque(moving: Moving, geared: Moving) -> tuple[Value, Reactions | None]:
    """Return the torque on the crank that a motion requires [N m], and the reactions if friction requires them (else None).

    `geared` are the same positions at a crank speed of 1 rad/s, in this whole module.
    """
    if moving.machine.friction:
        joint_reactions = reactions(moving)
        return joint_reactions.torque, joint_reactions
    return virtual_torque(required_wrench(moving), geared), None


def crank_acceleration(geared: Moving, speed: Value, torque: Value, direction: Value) -> Value:
    """Compute the angular acceleration of the crank [rad/s^2] under a driving torque, elementwise (forward dynamics).

    It is NaN where no signs of the normal forces in guides with friction are consistent, or several that differ are. The crank
    turns, or is about to turn, in `direction`: +1 or -1.
    """
    if geared.machine.friction:
        return acceleration_with_friction(geared, speed, torque, direction)[0]
    needed, _ = required_torque(geared.scaled(speed, 0.0, direction), geared)
    return (torque - needed) / (2.0 * geared.kinetic)


def accelerations_with_friction(
    geared: Moving, speed: Value, torque: Value, direction: Value
) -> Iterator[tuple[Value, Value, dict[str, float]]]:
    """Yield for all signs of the normal forces in guides the acceleration, whether it is consistent with them, and the signs.

    For assumed signs, torque and normal forces are linear in the acceleration: two accelerations determine them.
    """
    names = tuple(geared.machine.friction)
    step = 1.0 + speed * speed + np.abs(torque) / (2.0 * geared.kinetic)
    ends = [geared.scaled(speed, alpha, direction) for alpha in (0.0, step)]
    wrenches = [required_wrench(moving) for moving in ends]
    for trial in itertools.product((1.0, -1.0), repeat=len(names)):
        normals = dict(zip(names, trial, strict=True))
        still, moved = (reactions(moving, needed, normals) for moving, needed in zip(ends, wrenches, strict=True))
        share = (torque - still.torque) / (moved.torque - still.torque)
        pins = (*still.pins.values(), *moved.pins.values())
        loaded = (np.hypot(*force) for on in pins for force in on.values())
        least = -ROUNDING * (1.0 + np.abs(share)) * sum(loaded)
        fits: Value = np.isfinite(share)
        for name, sign in normals.items():
            low, high = (joint_reactions.guides[name].normal for joint_reactions in (still, moved))
            fits = fits & (sign * (low + share * (high - low)) >= least)
        yield share * step, fits, normals


def acceleration_with_friction(
    geared: Moving, speed: Value, torque: Value, direction: Value
) -> tuple[Value, dict[str, Value], Value]:
    """Return the acceleration of the crank, the signs of the normal forces in guides, and where several fit.

    The acceleration is NaN where no signs are consistent, or several whose accelerations differ.
    """
    chosen: Value = np.nan
    signs: dict[str, Value] = dict.fromkeys(geared.machine.friction, 1.0)
    several: Value = False
    for alpha, fits, normals in accelerations_with_friction(geared, speed, torque, direction):
        step = 1.0 + speed * speed + np.abs(torque) / (2.0 * geared.kinetic)
        several = several | (fits & (np.abs(alpha - chosen) > 1e-6 * step))
        first = fits & np.isnan(chosen)
        chosen = np.where(first, alpha, chosen)
        signs = {name: np.where(first, normals[name], sign) for name, sign in signs.items()}
    return np.where(several, np.nan, chosen), signs, several


def can_rest(geared: Moving, torque: float) -> bool:
    """Return whether friction in guides can hold a machine at rest against a torque of the drive [N m].

    Torque and friction are out of balance by a polynomial that is linear in every coefficient of friction, between minus and
    plus its largest value: it vanishes if it has both signs among all the largest ones. It is the torque times the
    determinants.
    """
    signs = set()
    for direction in (1.0, -1.0):
        still = geared.scaled(0.0, 0.0, direction)
        needed = required_wrench(still)
        for trial in itertools.product((1.0, -1.0), repeat=len(geared.machine.friction)):
            joint_reactions = reactions(still, needed, dict(zip(geared.machine.friction, trial, strict=True)))
            least = np.asarray(joint_reactions.torque).item()
            determinant = math.prod(np.asarray(sine).item() for sine in joint_reactions.singularity.values())
            lacks = abs(torque - least) > STEADY * (abs(torque) + abs(least))
            signs.add(np.sign(determinant * (torque - least)) if lacks else 0.0)
    return 0.0 in signs or {1.0, -1.0} <= signs


STOP = 1e-6  # rad: distance before a singular position at which a simulation ends
LEAST, PATIENCE = 1e-4, 2000  # least share of the duration per so many steps; less is a stall
TOGETHER = 500  # steps whose rows are interpolated together


class Coordinate(NamedTuple):
    """Free coordinate of a drive (n,): its value [rad, m] with derivatives, the effort of the drive [N m, N] and of its stop.

    `error` [rad, m]: distance to the law that it follows, zero without one.
    """

    value: Jet
    effort: Value
    stop: Value
    error: Value


@dataclass(frozen=True)
class Run:
    """Simulated motion of a machine: crank angle [rad], speed, acceleration, driving torque [N m], works [J] at times (n,) [s].

    `works`: of the drive, of each load, of friction; `kinetic`, `potential`: energies, that of gravity zero at y = 0. `drift`
    [m]: largest distance between the twice integrated and the closed-loop positions of the bodies; `imbalance` [J]: largest error
    of the energy balance. `last_turn`: mean speed [rad/s] and its fluctuation over the last cycle (`LastTurn.speed`).
    `coordinates` of drives that move freely beside others, by name.
    """

    time: Array
    crank_angle: Array
    speed: Array
    acceleration: Array
    torque: Array
    direction: Array
    works: dict[str, Array]
    kinetic: Array
    potential: Array
    drift: float
    drift_angle: float
    imbalance: float
    steps: int
    evaluations: int
    ending: Ending
    stopped: float
    last_turn: tuple[float, float] | None
    coordinates: Mapping[str, Coordinate]

    @property
    def energy(self) -> Array:
        """Kinetic and potential energy [J] (n,)."""
        return self.kinetic + self.potential

    @property
    def turnover(self) -> float:
        """Largest kinetic energy, change of potential energy or work [J], the reference for the imbalance."""
        every = [self.kinetic, self.potential - self.potential[:1], *self.works.values()]
        return max(max_magnitude(values) for values in every)


class EquationsOfMotion:
    """Right-hand side of the equations; state = crank angle, speed, works, then position and velocity of every body."""

    def __init__(self, machine: Machine, torque: Magnitude | None, *, stops: bool = False) -> None:
        self.machine, self.drive = machine, torque
        self.bodies, self.cycle = tuple(machine.mechanism.bodies), machine.mechanism.cycle
        self.names = [
            "input",
            *(load.name for load in machine.loads),
            *(["friction"] if machine.friction else []),
            *(["stops"] if stops else []),
        ]
        self.direction, self.rigid, self.head = 1.0, stops, 2  # `head`: so many elements of the state determine the rates
        self.by_numbers = bool(machine.friction)  # symbols do not support the iteration for friction
        self.buffered: dict[float, tuple[Callable[..., list[Array]], Callable[..., list[Array]]]] = {}
        self.evaluations = 0

    def geared(self, angle: Value) -> Moving:
        """The machine at one crank angle and 1 rad/s, with plain floats (much faster than arrays of length one) or symbols."""
        pose = self.machine.mechanism.at(self.machine.sizes, Jet(angle, 1.0))
        return Moving(self.machine, Motion(self.machine.mechanism, self.machine.sizes, angle, 1.0, pose), 1, self.direction)

    def start(self, angle: float, speed: float) -> Array:
        """The state at the start."""
        moving = self.geared(angle).scaled(speed, 0.0, self.direction)
        return self.begun(np.array([angle, speed]), moving)

    def begun(self, head: Array, moving: Moving) -> Array:
        """The state at the start of a motion, whose first elements are `head`."""
        states = list(map(moving.state, self.bodies))
        positions = [part for s in states for part in (*s.start, np.arctan2(s.axis[1], s.axis[0]))]
        return np.concatenate([head, np.zeros(len(self.names)), flat(positions), self.velocities(moving)])

    def velocities(self, moving: Moving) -> Array:
        """The velocities of all bodies."""
        return flat([part for s in map(moving.state, self.bodies) for part in (*s.velocity, s.omega)])

    def accelerations(self, moving: Moving) -> list[Value]:
        """The accelerations of all bodies."""
        return [part for s in map(moving.state, self.bodies) for part in (*s.acceleration, s.alpha)]

    def load_powers(self, moving: Moving) -> Iterator[Value]:
        """Power of each load."""
        for load in self.machine.loads:
            yield sum((act.power(moving.state(act.body)) for act in load.act(moving)), 0.0)

    def torque(self, angle: Value, speed: Value) -> Value:
        """The torque of the drive [N m]."""
        assert self.drive is not None
        return self.drive({"phi": angle, "omega": speed})

    def rates(self, angle: Value, speed: Value) -> list[Value]:
        """Acceleration of the crank; powers of drive, loads and friction; accelerations of the bodies. Numbers or symbols."""
        geared, alpha, joint_reactions = self.geared(angle), 0.0, None
        if self.drive is None:
            moving = geared.scaled(speed, 0.0, self.direction)
            torque, joint_reactions = required_torque(moving, geared)
        else:
            torque = self.torque(angle, speed)
            if self.machine.friction:
                alpha, signs, _ = acceleration_with_friction(geared, speed, torque, self.direction)
                moving = geared.scaled(speed, alpha, self.direction)
                joint_reactions = reactions(moving, None, signs)
            else:
                alpha = crank_acceleration(geared, speed, torque, self.direction)
                moving = geared.scaled(speed, alpha, self.direction)
        powers = [torque * speed, *self.load_powers(moving)]
        if joint_reactions is not None:
            powers.append(sum(np.sum(force.friction * moving.slides[name][1]) for name, force in joint_reactions.guides.items()))
        if self.rigid:  # its stops act at an instant
            powers.append(0.0)
        return [alpha, *powers, *self.accelerations(moving)]

    def functions(self) -> tuple[Callable[..., list[Array]], Callable[..., list[Array]]]:
        """The rates at a crank angle and speed, and a step of the integrator: the formulas of both, compiled from symbols."""
        if self.direction not in self.buffered:
            from optlink.symbolic import BufferedFunction

            key, compiled_functions = self.machine.compiled.get("motion", (None, {}))
            compiled_functions = compiled_functions if key == (self.drive, self.names) else {}
            self.machine.compiled["motion"] = (self.drive, self.names), compiled_functions
            rates, step = compiled_functions[self.direction] = compiled_functions.get(self.direction) or self.compiled()
            self.buffered[self.direction] = BufferedFunction(rates), BufferedFunction(step)  # buffers of this simulation alone
        return self.buffered[self.direction]

    def compiled(self) -> tuple[Any, Any]:
        """Trace the rates, and a step of the integrator."""
        import casadi

        from optlink.symbolic import dense_function, symbols_in_numpy

        head, size = casadi.SX.sym("head", self.head), casadi.SX.sym("size")
        n = self.head + len(self.names) + 6 * len(self.bodies)
        state, first = casadi.SX.sym("state", n), casadi.SX.sym("first", n)
        with symbols_in_numpy():
            parts = self.rates(*(head[k] for k in range(self.head)))
            rates = dense_function([head], [casadi.cse(casadi.vertcat(*parts))])  # for all 16 stages
            whole = lambda y: casadi.vertcat(*self.placed(rates(y[: self.head]), y))  # noqa: E731
            trial = attempt(whole, lambda parts: casadi.horzcat(*parts), state, first, size)
        outputs = [trial.state, casadi.horzcat(*trial.rates), casadi.vertcat(trial.fifth, trial.third)]
        return rates, dense_function([state, first, size], outputs)

    def placed(self, rates: Any, state: Any) -> tuple[Any, ...]:
        """Rates of the whole state from those of crank speed, works and velocities."""
        count = 3 * len(self.bodies)
        return state[1:2], rates[:-count], state[-count:], rates[-count:]

    @property
    def switches(self) -> Array:
        """Crank angles [rad] at which the rates may jump; they repeat every cycle."""
        return jumps(self.machine, 0.0, self.cycle)

    def marks(self, state: Array) -> list[Mark]:
        """Further events ahead of a state, for `met`."""
        return []

    def met(self, state: Array, event: Any) -> Array:
        """The state after one of its events."""
        return state

    def along(self, states: Array, ways: Array, resting: bool) -> tuple[Moving, Value]:
        """The motion and the driving torque at states (n, size) and senses of motion (n,); the machine may rest in the last."""
        angles, speeds = states[:, 0], states[:, 1]
        geared = self.machine.moving(angles, 1.0)
        if self.drive is None:
            moving = geared.scaled(speeds, 0.0, ways)
            return moving, required_torque(moving, geared)[0]
        torque = self.torque(angles, speeds)
        accelerations = np.array(np.broadcast_to(crank_acceleration(geared, speeds, torque, ways), angles.shape))
        if resting:
            accelerations[-1] = 0.0
        return geared.scaled(speeds, accelerations, ways), torque

    def coordinates(self, states: Array) -> dict[str, Coordinate]:
        """The free coordinates at states (n, size)."""
        return {}

    def __call__(self, state: Array) -> Array:
        """Rates of the state; also where the crank is at rest, for which symbols cannot choose the sense of motion."""
        self.evaluations += 1
        numbers = self.by_numbers or state[1] == 0.0
        head = state[: self.head]
        rates = flat(self.rates(*head.tolist())) if numbers else self.functions()[0](head)[0]
        return np.concatenate(self.placed(rates, state))

    def attempt(self, state: Array, first: Array, size: float) -> TrialStep:
        """Take one step of the integrator."""
        if self.by_numbers:
            trial = attempt(self, np.column_stack, state, first, size)
            return trial._replace(rates=np.array(trial.rates))
        self.evaluations += ALL - 1
        new, rates, (fifth, third) = self.functions()[1](state, first, size)
        return TrialStep(new, rates.reshape(ALL, len(state)), float(fifth), float(third))


def flat(parts: Sequence[Value]) -> Array:
    """Return numbers, each perhaps an array of one, as an array."""
    return np.array([np.asarray(part, dtype=float).item() for part in parts])


def run(
    machine: Machine,
    times: Array,
    angle: float,
    speed: float,
    torque: Magnitude | None = None,
    limits: Limits | None = None,
    progress: Callable[[float], None] | None = None,
    singular: Sequence[float] = (),
    interrupted: Callable[[], None] | None = None,
) -> Run:
    """Simulate the motion of a machine; the result is shorter than requested where the machine stops (`Run.ending`).

    The output is at `times` (n,) [s], rising from 0, from a crank angle [rad] and speed; without a `torque` at constant speed.
    `limits` of the crank angle, where it does not turn fully; `singular`: crank angles, repeated every cycle,
    beyond which the motion is not determined; `progress` is called with the completed share, `interrupted` at once on Ctrl-C,
    which ends the motion.
    """
    equations = EquationsOfMotion(machine, torque, stops=limits is not None and limits.restitution is not None)
    return integrated(equations, times, angle, speed, limits, progress, singular, interrupted)


@np.errstate(all="ignore")
def integrated(
    equations: EquationsOfMotion,
    times: Array,
    angle: float,
    speed: float,
    limits: Limits | None = None,
    progress: Callable[[float], None] | None = None,
    singular: Sequence[float] = (),
    interrupted: Callable[[], None] | None = None,
) -> Run:
    """Integrate equations of motion; the arguments are those of `run`."""
    integration = _Integration(equations, times, angle, speed, limits, np.array(singular))
    integration.travel(progress, interrupted)
    return integration.result()


class _Integration:
    """A simulation in progress, integrated from event to event."""

    def __init__(
        self,
        equations: EquationsOfMotion,
        times: Array,
        angle: float,
        speed: float,
        limits: Limits | None,
        singular: Array,
    ) -> None:
        self.equations, self.times, self.limits, self.singular = equations, times, limits, singular
        equations.direction = float(np.sign(speed)) or 1.0
        self.switches = equations.switches
        stopped = limits is not None and limits.ending is None  # a rebound within a step would pass unseen
        self.may_rest, self.hardest = equations.drive is not None and (equations.machine.switching or stopped), 0.0
        self.time, self.state = 0.0, equations.start(angle, speed)
        self.blocks, self.ways, self.recent = [self.state[None]], [equations.direction], list[Step]()
        self.last_turn = LastTurn(angle, speed, equations.machine.cycle)
        self.steps, self.mark, self.ending = 0, 0.0, Ending.FINISHED

    def travel(self, progress: Callable[[float], None] | None, interrupted: Callable[[], None] | None) -> None:
        """Integrate until the end of the duration, or until the machine stops."""
        if self.limits is not None and self.limits.restitution is not None and self.state[1] != 0.0:
            end = self.limits.pushes(float(self.state[0]), self.equations.direction)
            if end is not None:
                self.rebound(end, self.limits.restitution)
        elif self.state[1] == 0.0 and self.equations.drive is not None:
            self.set_off()
            self.ways = [self.equations.direction]
        if any(abs(at - float(self.state[0])) <= 2.0 * STOP for *_, at in self.stops()):
            self.ending = Ending.SINGULAR
        try:
            while self.ending is Ending.FINISHED and len(self.ways) < len(self.times):
                try:
                    self.leg(progress)
                finally:
                    self.keep()
        except KeyboardInterrupt:
            if interrupted is not None:
                interrupted()
            self.ending = Ending.INTERRUPTED

    def stops(self) -> list[Mark]:
        """Return the nearest singular position on either side, with a small margin."""
        around = nearest(float(self.state[0]), self.singular, self.equations.cycle)
        return [("singular", crank_angle, at + way * STOP) for way, at in zip((1.0, -1.0), around, strict=False)]

    def leg(self, progress: Callable[[float], None] | None) -> None:
        """Integrate to the next event."""
        end, first = float(self.times[-1]), self.equations(self.state)
        if not all_finite(first):  # no step size would do
            self.ending = _stopped(self.equations, self.state)
            return
        stepper = Stepper(self.equations, self.equations.attempt, self.time, end, self.state, first)
        ahead = [
            mark
            for mark in (self.limits.marks if self.limits is not None else ())
            if mark[0] != "switch" or abs(mark[2] - float(self.state[0])) > PASSED_JUMP
        ]
        around = nearest(float(self.state[0]), self.switches, self.equations.cycle, PASSED_JUMP)
        ahead += [*(("switch", crank_angle, at) for at in around), *self.stops(), *self.equations.marks(self.state)]
        event = None
        while event is None and self.time < end:
            step = stepper.step()
            self.steps += 1
            if step is None or not math.isfinite(step.after.sum()) or self.crawls(stepper.time):
                self.ending = _stopped(self.equations, self.state)
                return
            upto, event = first_event(step, self.equations.direction if self.may_rest else 0.0, ahead)
            self.recent.append(step)
            self.time, self.state = upto, step.after
            if event is not None:
                self.state = step.at(upto)
            if len(self.recent) >= TOGETHER:
                self.keep()
            if progress:
                progress(upto / end)
        self.keep()
        if self.limits is not None and event in ("limit", "stop"):
            if self.limits.ending is not None:
                self.ending = self.limits.ending
            elif self.limits.restitution is not None:
                self.rebound(
                    min(self.limits.low, self.limits.high, key=lambda end: abs(end - self.state[0])), self.limits.restitution
                )
        elif event == "singular":
            self.ending = Ending.SINGULAR
        elif event == "rest":
            self.state[1] = 0.0
            self.set_off()
        else:
            self.state = self.equations.met(self.state, event)

    def set_off(self) -> None:
        """Set the sense in which a resting machine starts to turn, or end where it stays at rest."""
        angle, limits = float(self.state[0]), self.limits
        self.ending = _set_off(self.equations, angle)
        stops = limits is not None and limits.restitution is not None and self.ending is Ending.FINISHED
        if stops and limits is not None and limits.pushes(angle, self.equations.direction) is not None:
            self.ending = Ending.AT_STOP

    def rebound(self, end: float, restitution: float) -> None:
        """Reverse the motion at a rigid stop; all speeds scale, as one coordinate moves all bodies."""
        before, equations = float(self.state[1]), self.equations
        self.hardest = max(self.hardest, abs(before))
        after = -restitution * before if restitution * abs(before) > STILL * self.hardest else 0.0
        lost = np.asarray(equations.geared(end).kinetic).item() * (before * before - after * after)
        self.state = self.state.copy()
        self.state[0], self.state[1] = end, after
        self.state[1 + len(equations.names)] -= lost
        self.state[-3 * len(equations.bodies) :] *= after / before
        if after:
            equations.direction = -equations.direction
        else:
            self.set_off()

    def keep(self) -> None:
        """Interpolate the rows that the recent steps have reached."""
        count = int(np.searchsorted(self.times, self.time, side="right")) - len(self.ways)
        if count > 0 and self.recent:
            self.blocks.append(states_at(self.times[len(self.ways) : len(self.ways) + count], self.recent))
            self.ways += [self.equations.direction] * count
        if self.recent:
            self.last_turn.add(self.recent, self.time)
        self.recent = []

    def crawls(self, time: float) -> bool:
        """Whether the last `PATIENCE` steps made no significant progress."""
        if self.steps % PATIENCE:
            return False
        slow = time - self.mark < LEAST * float(self.times[-1])
        self.mark = time
        return slow

    def result(self) -> Run:
        """Return the result so far."""
        equations, times = self.equations, self.times[: len(self.ways)]
        if self.ending in (Ending.AT_REST, Ending.AT_STOP) and self.time > times[-1]:  # the last row is that of the rest
            self.blocks.append(self.state[None])
            self.ways.append(self.ways[-1])
            times = np.append(times, self.time)
        states, ways = np.concatenate(self.blocks), np.array(self.ways)
        machine, angles, speeds = equations.machine, states[:, 0], states[:, 1]
        resting = self.ending in (Ending.AT_REST, Ending.AT_STOP) and speeds[-1] == 0.0
        moving, torque = equations.along(states, ways, resting)
        kinetic, potential = (np.zeros(len(times)) + energy(moving.state) for energy in (machine.kinetic, machine.weight))
        works = {name: states[:, equations.head + k] for k, name in enumerate(equations.names)}
        energy = kinetic + potential
        imbalance = energy - energy[0] - sum(works.values())
        drift = twist = 0.0
        for k, body in enumerate(equations.bodies):
            state, begin = moving.state(body), equations.head + len(works) + 3 * k
            x, y, angle = states[:, begin : begin + 3].T
            drift = max(drift, float(np.max(np.hypot(x - state.start[0], y - state.start[1]))))
            turned = angle - np.arctan2(state.axis[1], state.axis[0])
            twist = max(twist, max_magnitude(wrapped(turned)))
        return Run(
            times,
            angles,
            speeds,
            np.broadcast_to(moving.motion.crank_acceleration, angles.shape),
            np.broadcast_to(torque, angles.shape),
            ways,
            works,
            kinetic,
            potential,
            drift,
            twist,
            max_magnitude(imbalance),
            self.steps,
            equations.evaluations,
            self.ending,
            self.time,
            self.last_turn.speed,
            equations.coordinates(states),
        )


def _set_off(equations: EquationsOfMotion, angle: float) -> Ending:
    """Set the sense in which a resting machine starts to turn; return why it ends there, `FINISHED` if it starts."""
    torque, geared = np.asarray(equations.torque(angle, 0.0)).item(), equations.geared(angle)
    starts: list[tuple[float, float]] = []
    determined, rough = True, equations.machine.friction
    for direction in (equations.direction, -equations.direction):
        if rough:
            solutions = [alpha for alpha, fits, _ in accelerations_with_friction(geared, 0.0, torque, direction) if np.all(fits)]
        else:
            solutions = [crank_acceleration(geared, 0.0, torque, direction)]
        for pull in (np.asarray(2.0 * geared.kinetic * alpha).item() for alpha in solutions):
            determined = determined and math.isfinite(pull)
            if direction * pull > STEADY * (abs(torque) + abs(torque - pull)):
                starts.append((direction, pull))
    rest = can_rest(geared, torque) if rough else not starts
    if rough and starts and (rest or max(starts)[1] - min(starts)[1] > 1e-6 * abs(starts[0][1])):
        return Ending.UNDETERMINED
    if starts:
        equations.direction = starts[0][0]
        return Ending.FINISHED
    if not determined:
        return Ending.STALLED
    return Ending.AT_REST if rest else _stopped(equations, np.array([angle, 0.0]))


def _stopped(equations: EquationsOfMotion, state: Array) -> Ending:
    """Return why the integration cannot continue from a state."""
    if not equations.machine.friction:
        return Ending.STALLED
    angles = np.array([state[0], state[0] + equations.direction * STOP])
    geared = equations.machine.moving(angles, 1.0, direction=equations.direction)
    if equations.drive is None:
        joint_reactions = reactions(geared.scaled(state[1], 0.0, equations.direction))
        jammed, several = joint_reactions.jammed, joint_reactions.several
    else:
        alpha, _, several = acceleration_with_friction(geared, state[1], equations.torque(angles, state[1]), equations.direction)
        jammed = np.isnan(alpha) & np.isfinite(geared.kinetic)
    if np.any(several):
        return Ending.UNDETERMINED
    return Ending.JAMMED if np.any(jammed) else Ending.STALLED
