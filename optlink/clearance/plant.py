"""A machine with gaps under its drive and controller, revolution by revolution; memory does not grow with their number."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from optlink.clearance.control import Controller
from optlink.clearance.equations import Drive, Equations, Weightless
from optlink.clearance.gap import Gap
from optlink.clearance.integration import Block, Impact, Integration
from optlink.clearance.output import Output
from optlink.clearance.record import Record
from optlink.dynamics.machine import Machine, parts
from optlink.linkage.elementwise import Value
from optlink.symbolic import Compiled, tracing

Array = NDArray[np.float64]
TURN = 2.0 * np.pi
DENSE = 360
"""Rows of a revolution that are looked at, at least: between them contacts are found by the path's values and slopes."""


@dataclass(frozen=True)
class Revolution:
    """One revolution: its rows, the command at each (m, 2) [rad, rad/s], and the contacts that ended in it."""

    block: Block
    command: Array
    impacts: tuple[Impact, ...]


class Plant:
    """A machine with gaps.

    Parameters
    ----------
    machine : Machine
    gaps : sequence of Gap
    drive : Drive
    output : Output
        What a controller measures.
    start : float [rad]
        Crank angle at the beginning; journals are centred then, velocities those of the ideal machine.
    speed, nominal : float [rad/s]
        Crank speed at the beginning, and the one whose revolutions count.
    points : int
        Rows told of each revolution.
    sample_time : float [s]
        Of the controller; the nearest that fits the revolution is used (`sample_time` of the plant).
    tolerance : float
        Relative, of the integrator.

    Raises
    ------
    Weightless
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
        self.samples = 1 if not np.isfinite(sample_time) else max(1, round(self.period / sample_time))
        least = np.lcm(points, self.samples) if self.samples > 1 else points
        if least > 20 * max(points, self.samples, DENSE):  # samples and rows that fit badly: take samples that fit
            self.samples = points * max(1, round(self.samples / points))
            least = max(points, self.samples)
        self.rows = int(least * -(-DENSE // least))
        self.points, self.sample_time = points, self.period / self.samples
        self.equations = Equations(machine, gaps, drive, nominal)
        self.output = output
        with tracing():
            self._measure = Compiled([self.equations.x], [output.of(self.equations.symbolic)])
        state = self._ideal(machine, start, speed)
        self._check_inertia(state)
        self.integration = Integration(self.equations, state, self.period / self.rows, tolerance)
        self.start, self.nominal = start, nominal
        self.controller: Controller | None = None

    def _ideal(self, machine: Machine, start: float, speed: float) -> Array:
        """The state of the machine without clearance."""
        moving = machine.moving(np.array([start]), speed)
        both = [parts(value) for value in self.equations.cut.read(moving.pose)]
        return np.array([_number(value[order]) for order in (0, 1) for value in both])

    def _check_inertia(self, state: Array) -> None:
        """Every free motion needs inertia."""
        equations = self.equations
        mass, held = equations.masses(state)
        count = len(equations.free)
        if not count:
            return
        matrix, grip = mass.reshape(count, count).T, held.reshape(count, -1).T
        lengths = np.array(
            [1.0 if equations.cut.coordinates[i].kind == "angle" else equations.machine.size for i in equations.free]
        )
        matrix, grip = matrix * np.outer(lengths, lengths), grip * lengths
        _, values, rows = np.linalg.svd(grip, full_matrices=True) if grip.size else (None, np.zeros(0), np.eye(count))
        free = rows[int(np.sum(values > 1e-9 * np.max(values, initial=0.0))) :].T
        sizes, ways = np.linalg.eigh(free.T @ matrix @ free)
        if sizes.size and sizes[0] <= 1e-12 * max(sizes[-1], 0.0):
            blame = int(np.argmax(np.abs(free @ ways[:, 0])))
            raise Weightless(equations.cut.coordinates[equations.free[blame]].body)

    @property
    def time(self) -> float:
        """Now [s]."""
        return self.integration.time

    def measured(self) -> float:
        """The output now."""
        return float(self._measure(self.integration.state)[0][0])

    def now(self) -> Block:
        """The present state as a row."""
        course = self.integration
        row = (course.state, course.modes, course.entered, course.works)
        return Block(np.array([course.time]), *(part[None, :].copy() for part in row))

    def turn(self) -> Revolution:
        """Go on by one revolution of the nominal speed.

        Raises
        ------
        Stalled
        """
        course, every = self.integration, self.rows // self.points
        blocks, commands = [], []
        stride = self.rows // self.samples if self.controller else self.rows
        for sample in range(self.rows // stride):
            time = course.time
            angle, speed = self.start + self.nominal * time, self.nominal
            if self.controller:
                angle, speed = self.controller(sample, time, self.measured())
            course.command = (angle, time, speed)
            for block in course.advance(stride):
                blocks.append(block)
                commands.append(np.column_stack([angle + speed * (block.time - time), np.full(len(block.time), speed)]))
        whole = Block(*(np.concatenate(part)[every - 1 :: every] for part in zip(*blocks, strict=True)))
        impacts, course.finished = tuple(course.finished), []
        return Revolution(whole, np.concatenate(commands)[every - 1 :: every], impacts)

    def record(self, revolution: Revolution) -> Record:
        """Everything about its rows."""
        return Record(self.equations, revolution.block, revolution.command)


def _number(value: Value) -> float:
    return float(np.asarray(value, dtype=float).ravel()[0])
