"""A machine with joint clearance, its drive and its controller, simulated revolution by revolution with constant memory."""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from optlink.clearance.columns import ClearanceColumns
from optlink.clearance.contact_laws import EXPONENT
from optlink.clearance.controller import Controller
from optlink.clearance.equations import Drive, Equations, Weightless
from optlink.clearance.integration import Block, Impact, Integration
from optlink.clearance.joint import Gap
from optlink.clearance.output import Output
from optlink.dynamics.machine import Machine
from optlink.linkage.jet import as_jet
from optlink.linkage.vector2d import TURN, Array, Value
from optlink.symbolic import CompiledFunction, symbols_in_numpy

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
