"""A machine with joint clearance, its drive and its controller, simulated revolution by revolution with constant memory."""

import enum
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import casadi
import numpy as np
from numpy.typing import NDArray

from optlink.clearance.columns import ClearanceColumns, Output
from optlink.clearance.equations import ClearanceState, Drive, Equations, ReferenceSignal, Servo, SpanningTree, Weightless
from optlink.clearance.integration import Block, Impact, Integration
from optlink.clearance.joint import EXPONENT, Gap
from optlink.dynamics.inverse import reactions
from optlink.dynamics.machine import Machine
from optlink.errors import InputError, extra_remedy
from optlink.linkage.jet import Jet, as_jet
from optlink.linkage.vector2d import TURN, Array, Value
from optlink.symbolic import CompiledFunction, symbols_in_numpy

# Control that compensates joint clearance, by sampled corrections of the crank command.
#
# none: constant speed. inverse: the periodic command of the inverse model. pid: a discrete PID on the measured error of the
# output, referred to the crank, added to the constant speed; inverse+pid: added to the command of the inverse model.


class Control(enum.StrEnum):
    """Kind of control of the crank."""

    NONE = "none"
    INVERSE = "inverse"
    PID = "pid"
    BOTH = "inverse+pid"

    @property
    def inverted(self) -> bool:
        """Whether the inverse model is used."""
        return self in (Control.INVERSE, Control.BOTH)

    @property
    def fed_back(self) -> bool:
        """Whether feedback of the measured error is used."""
        return self in (Control.PID, Control.BOTH)


@dataclass(frozen=True)
class Gains:
    """Gains of a PID controller: proportional [-], integral [1/s], derivative [s]; its output is limited to +-`limit` [rad]."""

    proportional: float = 0.0
    integral: float = 0.0
    derivative: float = 0.0
    limit: float = np.inf


@dataclass
class PID:
    """A discrete PID controller with anti-windup.

    The integral is frozen while the output is at its limit and the error would drive it further.
    """

    gains: Gains
    sample: float
    integral: float = 0.0
    before: float | None = None

    def __call__(self, error: float) -> float:
        """Return the correction for the error of this sample."""
        gains = self.gains
        slope = 0.0 if self.before is None else (error - self.before) / self.sample
        self.before = error
        integral = self.integral + gains.integral * self.sample * error
        demand = gains.proportional * error + integral + gains.derivative * slope
        limited = min(max(demand, -gains.limit), gains.limit)
        if limited == demand or (demand - limited) * error < 0.0:
            self.integral = integral
        return limited


@dataclass
class Controller:
    """Feedback correction of the crank angle, sample by sample.

    At the samples of a revolution: `target` output [m, rad], and `leverage`, the crank rotation per change of the output
    [rad/m, -]. The error of an `angular` output is wrapped to (-pi, pi].
    """

    pid: PID
    target: Array
    leverage: Array
    angular: bool = False

    def __call__(self, sample: int, measured: float) -> float:
        """Return the correction of the crank angle [rad] from this sample on."""
        k = sample % len(self.target)
        error = float(self.target[k]) - measured
        if self.angular:
            error = float(np.remainder(error + np.pi, 2.0 * np.pi) - np.pi)
        return self.pid(float(self.leverage[k]) * error)


DENSE, DENSEST = 360, 50_000
"""Least and largest number of evaluated rows per revolution; a contact within a row is detected by values and slopes."""

SLOW = 5_000
"""Rows per revolution, as required by the vibration of a journal, from which on the machine counts as slow."""

LOOKS = 4.0
"""Rows for each period in which a journal vibrates on its bearing under the load that the machine's motion makes."""

SAVED = "state", "modes", "entered", "works"
"""Arrays of an integration that describe its state."""


class SimulatedRevolution(NamedTuple):
    """One revolution.

    Its rows, the feedback correction of the crank angle beyond the command (m,) [rad], the contacts that ended; for every gap the
    largest penetration [m] and normal force [N], and the largest torque [N m]; these maxima include values between the rows.
    """

    block: Block
    further: Array
    impacts: tuple[Impact, ...]
    depths: tuple[float, ...] = ()
    forces: tuple[float, ...] = ()
    torque: float = 0.0


class ClosedLoop:
    """A machine with joint clearance, and the output that a controller measures.

    Parameters
    ----------
    start : float [rad]
        Initial crank angle; journals start centred, velocities are those of the ideal machine.
    speed, nominal : float [rad/s]
        Initial crank speed, and the nominal speed that defines a revolution.
    points : int
        Rows of output per revolution.
    tolerance : float
        Relative tolerance of the integrator.
    sample_time : float [s]
        Of the controller; the nearest that fits the revolution is used.

    Raises
    ------
    Weightless
        A free motion has no inertia.
    """

    def __init__(
        self,
        machine: Machine,
        gaps: Sequence[Gap],
        drive: Drive,
        output: Output,
        *,
        start: float,
        speed: float,
        nominal: float,
        points: int,
        tolerance: float,
        sample_time: float = np.inf,
    ) -> None:
        self.period = TURN / abs(nominal)
        self.samples = _samples(self.period / sample_time, points)
        least = int(np.lcm(points, self.samples))
        wished = LOOKS * self.period / vibration(machine, gaps, nominal)
        dense = min(max(DENSE, wished), DENSEST)
        self.rows = int(least * max(1, math.ceil(dense / least)))
        self.points, self.sample_time = points, self.period / self.samples
        self.equations = Equations(machine, gaps, drive, nominal)
        self.output = output
        with symbols_in_numpy():
            self._measure = CompiledFunction([self.equations.x], [output.of(self.equations.symbolic)])
        state = self._ideal(machine, start, speed)
        self._check_inertia(state)
        self.integration = Integration(self.equations, state, self.period / self.rows, tolerance, wished > SLOW)
        self.start, self.nominal = start, nominal
        self.controller: Controller | None = None
        self.advanced: Callable[[float], None] = lambda revolutions: None
        self.partial: SimulatedRevolution | None = None  # rows of an interrupted revolution

    def _ideal(self, machine: Machine, start: float, speed: float) -> Array:
        """State of the machine without clearance."""
        moving = machine.moving(np.array([start]), speed)
        both = [as_jet(value).parts for value in self.equations.tree.read(moving.pose)]
        state = np.array([_number(value[order]) for order in (0, 1) for value in both])
        state[self.equations.tree.driven] = start  # not wrapped, like the command of a servo
        return state

    def _check_inertia(self, state: Array) -> None:
        """Check that every free motion has inertia."""
        equations = self.equations
        mass, constraint_rows = equations.masses(state)
        count = len(equations.free)
        if not count:
            return
        matrix, grip = mass.reshape(count, count).T, constraint_rows.reshape(count, -1).T
        coordinates = [equations.tree.coordinates[i] for i in equations.free]
        lengths = np.array([1.0 if coordinate.kind == "angle" else equations.machine.size for coordinate in coordinates])
        matrix, grip = matrix * np.outer(lengths, lengths), grip * lengths
        _, values, rows = np.linalg.svd(grip, full_matrices=True) if grip.size else (None, np.zeros(0), np.eye(count))
        free = rows[int(np.sum(values > 1e-9 * np.max(values, initial=0.0))) :].T  # motions that the closing joints permit
        sizes, ways = np.linalg.eigh(free.T @ matrix @ free)
        if sizes.size and sizes[0] <= 1e-12 * max(sizes[-1], 0.0):
            raise Weightless(coordinates[int(np.argmax(np.abs(free @ ways[:, 0])))].body)

    def compile(self) -> None:
        """Integrate by the compiled engine from now on; the first use compiles it, which takes some seconds."""
        from optlink.clearance.compiled.integration import CompiledIntegration

        before = self.integration
        self.integration = CompiledIntegration(before.equations, before.state, before.step, before.tolerance, before.slow)

    @property
    def time(self) -> float:
        """Current time [s]."""
        return self.integration.time

    def measured(self) -> float:
        """Return the current output [m, rad]."""
        return float(self._measure(self.integration.state)[0][0])

    def now(self) -> Block:
        """Return the current state as one row."""
        return Block(np.array([self.time]), *(getattr(self.integration, name)[None, :].copy() for name in SAVED))

    def turn(self) -> SimulatedRevolution:
        """Simulate one revolution of the nominal speed.

        Raises
        ------
        Stalled
            The integration cannot continue.
        """
        integration, every = self.integration, self.rows // self.points
        stride = self.rows // self.samples if self.controller else self.rows
        parts: list[tuple[Block, Array]] = []
        integration.restart()
        try:
            for sample in range(self.rows // stride):
                if self.controller:
                    integration.further = self.controller(sample, self.measured())
                for block in integration.advance(stride):
                    parts.append((block, np.full(len(block.time), integration.further)))
                    self.advanced(integration.row / self.rows)
        finally:
            self.partial = self._rows(parts, every) if sum(len(block.time) for block, _ in parts) >= every else None
        impacts, integration.finished = tuple(integration.finished), []
        whole, self.partial = self.partial, None
        assert whole is not None
        peaks, k = integration.take_peaks(), len(self.equations.gaps)
        return whole._replace(impacts=impacts, depths=peaks[:k], forces=peaks[k : 2 * k], torque=peaks[-1])

    def _rows(self, parts: list[tuple[Block, Array]], every: int) -> SimulatedRevolution:
        """Select every `every`-th of the evaluated rows."""
        columns = zip(*((*block, further) for block, further in parts), strict=True)
        *block, further = (np.concatenate(column)[every - 1 :: every] for column in columns)
        return SimulatedRevolution(Block(*block), further, ())

    def save(self) -> dict[str, Any]:
        """Return the state at the end of a revolution as plain numbers; `restore` continues from it bit-identically."""
        integration, pid = self.integration, self.controller.pid if self.controller else None
        return {
            "row": integration.row,
            **{name: getattr(integration, name).tolist() for name in SAVED},
            "open": [list(impact) for impact in integration.open.values()],
            "switches": integration.switches,
            "further": integration.further,
            "pid": None if pid is None else [pid.integral, pid.before],
        }

    def restore(self, saved: Mapping[str, Any]) -> None:
        """Continue from a saved state."""
        integration = self.integration
        integration.row, integration.ahead, integration.switches = saved["row"], 0.0, saved["switches"]
        for name in SAVED:
            setattr(integration, name, np.array(saved[name], dtype=float))
        integration.open = {int(row[0]): Impact(int(row[0]), *row[1:]) for row in saved["open"]}
        integration.further = saved["further"]
        if self.controller and saved["pid"]:
            self.controller.pid.integral, self.controller.pid.before = saved["pid"]

    def record(self, revolution: SimulatedRevolution) -> ClearanceColumns:
        """Return all columns of the rows of a revolution."""
        return ClearanceColumns(self.equations, revolution.block, revolution.further)


def _samples(wished: float, points: int) -> int:
    """Return the nearest number of samples per revolution that has a small common multiple with the rows of output."""
    near = np.arange(max(1, round(wished) - points), round(wished) + points + 1)
    fits = near[np.lcm(points, near) <= 20 * np.maximum(near, max(points, DENSE))]
    return int(fits[np.argmin(np.abs(np.log(fits / max(wished, 1.0))))])


def vibration(machine: Machine, gaps: Sequence[Gap], speed: float) -> float:
    """Estimate the shortest period [s] of a journal vibrating on its bearing under gravity and the acceleration of the crank.

    It estimates the duration of contacts, from the masses of the two bodies.
    """
    pull = math.hypot(*(_number(part) for part in machine.gravity)) + speed * speed * _number(machine.size)
    total = sum(_number(inertia.mass) for inertia in machine.inertias.values())
    periods = []
    for gap in gaps:
        masses = [_number(machine.inertias[body].mass) for body in (gap.journal, gap.bearing) if body in machine.inertias]
        mass = 1.0 / sum(1.0 / m for m in masses if m > 0.0) if any(m > 0.0 for m in masses) else total
        depth = (mass * pull / gap.stiffness) ** (1.0 / EXPONENT)
        periods.append(TURN * math.sqrt(mass / (EXPONENT * gap.stiffness * math.sqrt(depth))) if mass > 0.0 else math.inf)
    return min(periods)


def _number(value: Value) -> float:
    return float(np.asarray(value, dtype=float).ravel()[0])


# Inverse model: the crank motion that gives the target output, with the journals at their predicted positions.
#
# In a bearing with clearance the load determines the position of the journal: opposite to the reaction of the ideal machine,
# rotated by the friction angle, at the distance of clearance plus penetration under that load. The loops are closed with these
# gap vectors, and the crank angle is corrected so that the output has its target value. At a dead centre the crank does not move
# the output, and no drive has unlimited bandwidth: therefore the correction is a Fourier series up to a bandwidth, computed by
# regularised least squares over the whole revolution. The speed command is the derivative of the series.

POINTS = 720  # positions of the revolution: 12 per period of the highest harmonic
ROUNDS = 60  # of Newton and Gauss-Newton at most: both end at rounding errors
HIGHEST = 60  # maximum harmonic of a correction


def predicted(machine: Machine, gaps: Sequence[Gap], angles: Array, speed: float) -> Array:
    """Predict the gap vectors (angles, 2 gaps) [m] at crank angles [rad] and a constant speed [rad/s].

    They are x, y of each journal relative to its bearing, in quasi-static contact along the ideal joint's reaction.
    """
    moving = machine.moving(angles, speed)
    joint_reactions = reactions(moving)
    columns = []
    for gap in gaps:
        x, y = (np.broadcast_to(part, angles.shape) for part in joint_reactions.pins[gap.point][gap.journal])
        load = np.hypot(x, y)
        away = gap.clearance + (load / gap.stiffness) ** (2.0 / 3.0)
        # the journal is pushed by (-normal, friction): the reaction leans against the slip by the angle of friction
        slip = gap.radius * (moving.state(gap.journal).omega - moving.state(gap.bearing).omega)
        lean = np.arctan(gap.friction * np.tanh(slip / gap.slip_speed))
        c, s = np.cos(lean), np.sin(lean)
        columns += [-away * (x * c + y * s) / load, -away * (y * c - x * s) / load]
    return np.stack(np.broadcast_arrays(*columns), axis=-1)


class Inverse:
    """Loop closure of a machine with prescribed gap vectors, at `POINTS` positions of a revolution at once.

    The `target` of the output at these positions is that of the machine without clearance.
    """

    def __init__(self, machine: Machine, gaps: Sequence[Gap], output: Output, start: float, speed: float) -> None:
        self.output, self.start, self.speed = output, start, speed
        self.tree = SpanningTree(machine.mechanism, machine.sizes, {gap.point: gap.journal for gap in gaps})
        self.size, crank = len(self.tree.coordinates), self.tree.driven
        self.free = [i for i in range(self.size) if i != crank]
        with symbols_in_numpy():
            q, e = casadi.SX.sym("q", self.size), casadi.SX.sym("e", 2 * len(gaps))
            moved = ClearanceState(machine, self.tree, [Jet(value) for value in casadi.vertsplit(q)], speed)
            apart = [moved.journal_motion(gap).eccentricity for gap in gaps]
            missing = [value - e[i] for i, value in enumerate(part for pair in apart for part in pair)]
            missing += [as_jet(value).value for value in self.tree.open(moved.places)]
            value, residuals = output.of(moved), casadi.vertcat(*missing)
            results = [residuals, casadi.jacobian(residuals, q), value, casadi.jacobian(value, q)]
            self._loops = CompiledFunction([q, e], results, POINTS)
        self.angles: Array = np.asarray(start + np.sign(speed) * np.linspace(0.0, 2.0 * np.pi, POINTS, endpoint=False))
        moving = machine.moving(self.angles, speed)
        self.target = np.asarray(output.ideal(moving)[0])
        self._ideal = np.stack([np.broadcast_to(as_jet(c).value, (POINTS,)) for c in self.tree.read(moving.pose)], axis=-1)
        self.gaps: Array = predicted(machine, gaps, self.angles, speed)

    def close(self, crank: Array) -> tuple[Array, Array]:
        """Return the output at crank angles (POINTS,) with the predicted gap vectors, and its derivative over the crank angle."""
        q = self._ideal.copy()
        q[:, self.tree.driven] = crank
        for _ in range(ROUNDS):
            residuals, slopes, value, gradient = self._loops(q.ravel(), self.gaps.ravel())
            residuals = residuals.reshape(POINTS, -1)
            slopes = slopes.reshape(POINTS, self.size, -1).transpose(0, 2, 1)
            if np.max(np.abs(residuals), initial=0.0) < 1e-13:
                break
            q[:, self.free] -= np.linalg.solve(slopes[:, :, self.free], residuals[:, :, None])[:, :, 0]
        gradient = gradient.reshape(POINTS, self.size)
        follow = -np.linalg.solve(slopes[:, :, self.free], slopes[:, :, self.tree.driven, None])[:, :, 0]
        return value, gradient[:, self.tree.driven] + np.sum(gradient[:, self.free] * follow, axis=1)

    def solve(self, regularisation: float, order: int) -> NDArray[np.complex128]:
        """Compute the harmonics (order + 1,) of the crank angle correction [rad] that brings the output closest to its target.

        It minimises the mean of (output - target)^2 + (regularisation * correction)^2 over the revolution among all corrections
        up to the harmonic `order`; near dead centres of the output the other positions determine it. Gauss-Newton with exact
        derivatives. The unit of the regularisation is m/rad or 1.
        """
        phase = 2.0 * np.pi * np.arange(POINTS) / POINTS
        waves = [wave(k * phase) for k in range(1, order + 1) for wave in (np.cos, np.sin)]
        basis = np.stack([np.ones(POINTS), *waves], axis=-1)
        shares = np.zeros(basis.shape[1])
        for _ in range(ROUNDS):
            turned = basis @ shares
            value, slope = self.close(self.angles + turned)
            missing = -self.output.difference(value, self.target)
            normal = basis.T @ ((slope**2 + regularisation**2)[:, None] * basis)  # well conditioned: waves are orthogonal
            step = np.linalg.lstsq(normal, basis.T @ (slope * missing - regularisation**2 * turned), rcond=None)[0]
            shares = shares + step
            if np.max(np.abs(step)) < 1e-11:
                break
        return np.concatenate([shares[:1], shares[1::2] - 1j * shares[2::2]])

    def motion(self, regularisation: float, bandwidth: float) -> tuple[Array, Array, Array, Array, Array]:
        """Return time [s], target, crank angle [rad], crank speed [rad/s] and reached output at the positions, each (POINTS,).

        `bandwidth` [rad/s] is the highest frequency of the correction.
        """
        signal = ReferenceSignal(self.start, self.speed, self.solve(regularisation, self._order(bandwidth)))
        time: Array = np.asarray(2.0 * np.pi / (POINTS * abs(self.speed)) * np.arange(POINTS))
        angle, speed = map(np.asarray, signal.at(time))
        return time, self.target, angle, speed, self.close(angle)[0]

    def _order(self, bandwidth: float) -> int:
        """Number of harmonics up to a frequency [rad/s]."""
        return int(min(HIGHEST, max(1.0, bandwidth / abs(self.speed) + 1e-9)))

    def reference_signal(self, regularisation: float, servo: Servo, bandwidth: float) -> ReferenceSignal:
        """Return the crank command: the correction up to a bandwidth, multiplied by the inverse transfer function of the servo.

        A correction of too high a bandwidth [rad/s] excites the machine so that the journals leave their predicted positions.
        """
        order = self._order(bandwidth)
        s = 1j * np.arange(order + 1) * abs(self.speed)
        follows = 2.0 * servo.damping * servo.bandwidth * s + servo.bandwidth**2
        return ReferenceSignal(self.start, self.speed, self.solve(regularisation, order) * (s * s + follows) / follows)


def leverage(machine: Machine, output: Output, angles: Array, regularisation: float) -> Array:
    """Return the crank rotation per change of the output [rad/m, -] at crank angles (n,) [rad].

    It is reduced near dead centres, at slopes of the output below the regularisation.
    """
    slope = np.broadcast_to(output.ideal(machine.moving(angles))[1], angles.shape)
    return np.asarray(slope / (slope * slope + regularisation * regularisation))


# Choice of the integrator from the amount of requested work.


class IntegratorKind(enum.StrEnum):
    """Integrator of machines with joint clearance."""

    AUTO = "auto"
    CVODES = "cvodes"
    COMPILED = "compiled"


WORTH = 6.0
"""Seconds of work of CVODES from which on the compiled integrator is faster even if everything must be compiled first ..."""

LOADED = 0.6
"""... and from which on it is faster if it only has to be loaded from the cache."""

REVOLUTION, ROW = 0.02, 2.5e-5
"""Seconds of CVODES for a revolution and for each of its rows, per joint with clearance (measured on the shipped machines)."""

INSTALL = f"{extra_remedy('fast')}; or leave the integrator to optlink"


def installed() -> bool:
    """Return whether numba, which the compiled integrator needs, is installed, and supports the installed numpy."""
    try:
        import numba  # noqa: F401
    except ImportError:
        return False
    return True


def resumed(integrator: str, checkpoint: Mapping[str, Any] | None) -> str:
    """Return the requested integrator; for "auto" that of the checkpoint from which the work continues."""
    if checkpoint is None or integrator != IntegratorKind.AUTO:
        return integrator
    return str(checkpoint.get("integrator", IntegratorKind.CVODES))


def chosen(integrator: str, closed_loop: ClosedLoop, revolutions: float, *, cache: bool = False) -> IntegratorKind:
    """Return the requested integrator, or for "auto" the faster one for the revolutions of all runs of a machine.

    `cache`: whether what is compiled already counts; else the choice depends on the request alone, as it must where several
    processes or an interrupted run take part in one work.

    Raises
    ------
    InputError
        The integrator is unknown or not installed, or cannot compile this machine.
    """
    if integrator not in list(IntegratorKind):
        raise InputError("no such integrator", f"Take one of {', '.join(IntegratorKind)}", key="integrator", value=integrator)
    auto, equations = integrator == IntegratorKind.AUTO, closed_loop.equations
    if integrator == IntegratorKind.CVODES or (auto and closed_loop.integration.slow):
        return IntegratorKind.CVODES
    from optlink.clearance.compiled.machine import Unsupported, code_of, is_cached

    if auto:
        seconds = revolutions * len(equations.gaps) * (REVOLUTION + ROW * closed_loop.rows)
        worth = LOADED if cache and LOADED < seconds < WORTH and is_cached(equations) else WORTH
        if seconds < worth or not installed():
            return IntegratorKind.CVODES
    elif not installed():
        message = "numba is not installed, or does not support the installed numpy"
        raise InputError(message, INSTALL, key="integrator", value=integrator)
    try:
        code_of(equations)
    except Unsupported as error:
        if auto:
            return IntegratorKind.CVODES
        message = f"a formula of the machine cannot be compiled: {error}"
        raise InputError(message, "Take the integrator cvodes", key="integrator", value=integrator) from None
    return IntegratorKind.COMPILED
