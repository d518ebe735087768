"""Common part of sweep tasks: division of the grid into chunks.

A chunk depends on its number only, so the rows are identical for any engine, number of workers and order.
"""

import csv
import hashlib
import io
import math
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Any, ClassVar, NamedTuple

import numpy as np

from optlink.dynamics.columns import MotionColumns, efforts, pin_columns
from optlink.dynamics.forward import Ending
from optlink.dynamics.machine import Machine, slider_names
from optlink.errors import InputError
from optlink.execution.worker import Runs
from optlink.linkage.singular import positions_text
from optlink.linkage.stroke import Ranges, failure, reachable
from optlink.linkage.vector2d import TURN, Array
from optlink.problem.file import ProblemFile
from optlink.problem.quantity import nearest
from optlink.studies.grid import Axis, Grid
from optlink.tasks.analyze import Analysis, analyze, analyze_batch, batch_extremes, reaction_parts
from optlink.tasks.clearance import check_simulations, simulate_clearance
from optlink.tasks.machine import crank_speed, machine_of
from optlink.tasks.simulate import simulate
from optlink.units import count_noun
from optlink.version import VERSION

OPTIMISE = "optimise"  # mode of a sweep that optimises at every point
FROM_KNOWN = "from a known design"
OUTCOME = ("status", "valid", "failed", "active", "method")
"""Columns of the outcome of an optimum."""


def number_text(value: float) -> str:
    """Return a number as text for a table: all digits, empty if not finite."""
    return repr(float(value)) if math.isfinite(value) else ""


@dataclass(frozen=True)
class SweepTask(ABC):
    """Common state of all chunks: the problem as written, the grid, and the number of points per chunk."""

    mode: ClassVar[str]
    """What is computed at every point: "analyse", "simulate" or "optimise"."""

    source: ProblemFile
    grid: Grid
    chunk: int
    hash: str = field(init=False)
    version: str = field(default=VERSION, init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "hash", self.source.hash)

    @property
    def chunks(self) -> int:
        """Number of chunks."""
        return math.ceil(self.grid.count / self.chunk)

    def span(self, index: int) -> range:
        """Return the points of a chunk."""
        return range(index * self.chunk, min((index + 1) * self.chunk, self.grid.count))

    def size(self, index: int) -> int:
        """Return the number of points of a chunk."""
        return len(self.span(index))

    def __getstate__(self) -> dict[str, Any]:
        return {item.name: getattr(self, item.name) for item in fields(self)}  # without cached values

    @cached_property
    def problem(self) -> ProblemFile:
        """The problem, read again in the process of the chunk."""
        if self.version != VERSION:
            message = f"this worker runs optlink {VERSION}, the study optlink {self.version}"
            raise InputError(message, "Install one version everywhere", self.source.file)
        problem = self.source.override({})
        if problem.hash != self.hash:
            raise InputError("a file that the problem refers to has changed", "Begin a new study", problem.file)
        return problem

    @cached_property
    def mark(self) -> str:
        """Key that distinguishes tasks."""
        text = repr([type(self).__name__, *(getattr(self, item.name) for item in fields(self) if item.compare)])
        return hashlib.sha256(text.encode()).hexdigest()

    @property
    @abstractmethod
    def columns(self) -> list[str]:
        """Names of the table columns."""

    @property
    @abstractmethod
    def options(self) -> dict[str, Any]:
        """Options that define the study besides problem and grid."""

    @abstractmethod
    def lines(self, index: int) -> list[list[str]]:
        """Return the rows of a chunk."""

    def prepared(self, todo: list[int], runs: Runs) -> tuple["SweepTask", float]:
        """Return the task with what some chunks share, and the processor time for that [s]; see `Store.fill`."""
        return self, 0.0

    def row(self, point: int, figures: Iterable[float], *outcome: str) -> list[str]:
        """Return a row: the values of the axes, the figures [SI], and the outcome."""
        return [*map(number_text, map(float, self.grid.in_si(point))), *map(number_text, figures), *outcome]

    def __call__(self, index: int) -> str:
        """Return a chunk as lines of CSV."""
        if self.mark not in _current_task:
            _current_task.clear()
            _current_task[self.mark] = self
        text = io.StringIO()
        csv.writer(text, lineterminator="\n").writerows(_current_task[self.mark].lines(index))
        return text.getvalue()


_current_task: dict[str, SweepTask] = {}
"""The task of this process: it keeps its compiled parts for all chunks, although each chunk may come with a copy of the task."""


class MachineFigures(NamedTuple):
    """Figures of one machine by name, its status, and the reason if a figure is missing or it is not valid."""

    figures: Mapping[str, float]
    status: str
    reason: str = ""


class FiguresTask(SweepTask):
    """A task whose rows are figures of given machines."""

    figures: Any

    @abstractmethod
    def machines(self, points: range) -> Iterable[MachineFigures]:
        """Return the figures of the machines at points of the grid."""

    def lines(self, index: int) -> list[list[str]]:
        """Return the rows of a chunk."""
        rows = []
        for point, outcome in zip(self.span(index), self.machines(self.span(index)), strict=True):
            cells = [outcome.figures.get(name, math.nan) for name in self.figures]
            rows.append(self.row(point, cells, outcome.status, str(not outcome.reason).lower(), outcome.reason))
        return rows

    @property
    def columns(self) -> list[str]:
        """The axes, the figures, and the outcome."""
        return [*(axis.column for axis in self.grid.axes), *self.figures, "status", "valid", "reason"]


# Sweep task that analyses the machine at every point of a grid.

CHUNK = 2000  # designs per chunk
MAX_ANGLES = 10_000  # largest number of crank angles of an analysis
FIGURES = ("min", "max", "rms")
ANALYSED = "analysed"
ANGLE = ".angle_rad"  # its extremes are those of the swing


@dataclass(frozen=True)
class AnalysisTask(FiguresTask):
    """Analysis of given designs over the whole revolution.

    `quantities` of the mechanism that the axes vary; `requested`: columns, each with its least, largest and rms value, or single
    figures; `points`: crank angles per revolution, for rms values; `design` [SI]: design variables that are not varied.
    """

    mode = "analyse"

    quantities: tuple[str, ...]
    requested: tuple[str, ...]
    points: int
    design: tuple[tuple[str, float], ...]

    @property
    def options(self) -> dict[str, Any]:
        """Crank angles and the given design."""
        return {"crank_angles": self.points, "design": dict(self.design)}

    @cached_property
    def figures(self) -> tuple[str, ...]:
        """Names of the figures, in the order of the table."""
        columns, single = available_figures(self.problem)
        names: dict[str, None] = {}
        for name in self.requested:
            if name in columns:
                names |= dict.fromkeys(f"{name}.{kind}" for kind in FIGURES)
            elif name in single or (name.rpartition(".")[0] in columns and name.rpartition(".")[2] in FIGURES):
                names[name] = None
            else:
                raise InputError("no such column", nearest(name, (*columns, *single)), self.source.file, "--column", name)
        return tuple(names)

    def machines(self, points: range) -> Iterator[MachineFigures]:
        """Yield the figures of the designs at points of the grid."""
        quantities = self.problem.model.mechanism.quantities
        designs = {name: np.full(len(points), value) for name, value in self.design if name in quantities}  # none of a task alone
        designs |= dict(zip(self.quantities, self.grid.in_si(points), strict=True))
        clear = self._batched(designs)
        for i in range(len(points)):
            outcome = clear.get(i) or self._alone({name: float(sizes[i]) for name, sizes in designs.items()})
            missing = [name for name in self.figures if not math.isfinite(outcome.figures.get(name, math.nan))]
            if outcome.status == ANALYSED and missing:
                outcome = outcome._replace(status="no value", reason=f"{missing[0]} has no value for this design")
            yield outcome

    def _batched(self, designs: Mapping[str, Array]) -> dict[int, MachineFigures]:
        """Return the outcomes of the designs clear of all singular positions, by their index."""
        stems = {name.rpartition(".")[0] for name in self.figures}
        columns, _ = available_figures(self.problem)
        machine = machine_of(self.problem)
        limited = machine.mechanism.limits is not None
        paced = any(load.by_pace for load in self.problem.model.loads.values())
        known = stems <= {name for name in columns if not name.endswith(ANGLE)}
        if limited or paced or machine.switching or machine.cornered or not known:
            return {}
        extremes, clear = batch_extremes(self.problem, designs, tuple(sorted(stems)))
        numbers = np.flatnonzero(clear)
        if not numbers.size:
            return {}
        values = {f"{name}.{kind}": bounds[numbers, k] for name, bounds in extremes.items() for k, kind in enumerate(FIGURES[:2])}
        for name in {name.removesuffix(".rms") for name in self.figures if name.endswith(".rms")}:
            parts = reaction_parts(name)
            sampled = analyze_batch(self.problem, {key: sizes[numbers] for key, sizes in designs.items()}, parts, self.points)
            with np.errstate(all="ignore"):
                values[f"{name}.rms"] = np.sqrt(np.mean(sum(np.square(sampled[part]) for part in parts), axis=1))
        return {
            int(number): MachineFigures({name: float(column[i]) for name, column in values.items()}, ANALYSED)
            for i, number in enumerate(numbers)
        }

    def _alone(self, design: Mapping[str, float]) -> MachineFigures:
        """Return the outcome of one design [SI], including failures."""
        machine = machine_of(self.problem, design)
        ranges = reachable(machine.mechanism, machine.sizes)
        if not ranges.complete:
            return MachineFigures(
                {}, "partial rotation" if ranges.ranges else "not assembled", _unreached(self.problem, machine, ranges)
            )
        analysis = analyze(self.problem, self.points, design=design)
        if not analysis.valid:
            return MachineFigures(
                {}, "singular position" if analysis.singular.size else "no finite reactions", _unsound(analysis)
            )
        return MachineFigures({**analysis.figures, **dict(self._sampled(analysis))}, ANALYSED)

    def _sampled(self, analysis: Analysis) -> Iterator[tuple[str, float]]:
        """Yield figures missing in the summary of the analysis: rms values, and extremes of angles."""
        for name in {name.rpartition(".")[0] for name in self.figures}:
            parts = reaction_parts(name)
            if not all(part in analysis.columns for part in parts):
                continue
            squares = [np.square(analysis[part]) for part in parts]
            means = (np.mean(row[:-1] if analysis.full else 0.5 * (row[:-1] + row[1:])) for row in squares)
            yield f"{name}.rms", math.sqrt(sum(map(float, means)))
            if name.endswith(ANGLE):
                swing = analysis.swings.get(name.removesuffix(ANGLE))
                yield f"{name}.min", float(np.min(analysis[name])) if swing is None else swing.low
                yield f"{name}.max", float(np.max(analysis[name])) if swing is None else swing.high


def available_figures(problem: ProblemFile) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the columns of the analysis, whose extremes and rms values can be columns of a sweep, and its other figures."""
    machine = machine_of(problem)
    mechanism = machine.mechanism
    columns = list(MotionColumns(machine.moving(np.array([problem.model.driving.first]), crank_speed(problem))).columns)
    columns += [name for name, _, _ in pin_columns(machine)]
    sliders = set(slider_names(machine).values())
    single = [f"{name}.{kind}" for name in sliders for kind in ("stroke_m", "time_ratio")]
    for link in mechanism.links:
        single += [f"{link.body}.swing_rad", f"{link.body}.{'swing_' if link.body in sliders else ''}time_ratio"]
    work = f"input.work_per_{'revolution' if machine.cycle == TURN else 'cycle'}_J"
    return tuple(columns), (*sorted(single), work, "input.work_J.min", "input.work_J.max")


def _unreached(problem: ProblemFile, machine: Machine, ranges: Ranges) -> str:
    """Return where the crank can turn, and what stops it."""
    if ranges.ranges:
        moves = "turn fully" if ranges.limits is None else "move through its range"
        return f"the crank does not {moves}; reachable: {ranges.text}"
    failed = failure(machine.mechanism, machine.sizes, problem.model.driving.first)
    return f"no crank angle can be reached{f': {failed}' if failed else ''}"


def _unsound(analysis: Analysis) -> str:
    """Return why an analysis is not sound, and where."""
    if analysis.ranges.singular:
        where = f"singular position at {positions_text(analysis.ranges.singular, analysis.problem.model.driving.text)}"
        return f"{where}: the assembly modes meet, and the motion beyond it is not determined"
    for angles, what in (
        (analysis.singular, "singular position, reactions are infinite,"),
        (analysis.jammed, "friction locks a guide, or leaves several solutions,"),
        (analysis.undefined, "a load has no finite value"),
    ):
        if angles.size:
            more = f" and {count_noun(angles.size - 1, 'more position')}" if angles.size > 1 else ""
            return f"{what} at crank angle {math.degrees(float(angles[0])):.6g} deg{more}"
    return "`optlink analyze` with --set at this point gives the reason"


def quantity_of(problem: ProblemFile, axis: Axis) -> str:
    """Return the mechanism quantity that an axis varies: `mechanism.frame`, `mechanism.links.rod.length` or `rod.length`."""
    quantities = problem.model.mechanism.quantities
    name = axis.key.removeprefix("mechanism.")
    for start in ("links.", "ground.", "guides.", "points."):
        name = name.removeprefix(start)
    name = name.replace(".points.", ".").replace(".through.", ".")
    if name not in quantities:
        prescribed = axis.key.partition(".")[0] in ("requirement", "limits", "objective")
        remedy = "Leave --analyze out, to optimise at every point" if prescribed else "Add --simulate, which varies every key"
        remedy += f"; dimensions: {', '.join(quantities)}"
        raise InputError("an analysis varies dimensions of the mechanism only", remedy, problem.file, f"--vary {axis.key}")
    return name


def analysis_task(
    problem: ProblemFile, grid: Grid, columns: Sequence[str] | None, points: int, design: Mapping[str, float] | None
) -> AnalysisTask:
    """Return the task that analyses the machine at every point."""
    quantities = tuple(quantity_of(problem, axis) for axis in grid.axes)
    following = {*quantities, *problem.model.links}
    values = tuple((name, value) for name, value in (design or {}).items() if name not in following)
    if columns is None:
        columns = [effort.column for effort in efforts(problem.model.linkage)]
    task = AnalysisTask(problem, grid, CHUNK, quantities, tuple(columns), points, values)
    first = Grid(tuple(replace(axis, values=axis.values[:1]) for axis in grid.axes))
    replace(task, grid=first).lines(0)  # detects invalid columns or dimensions early
    return task


# Sweep task that simulates the machine at every point of a grid: speed, clearance, friction or dimensions vary.


@dataclass(frozen=True)
class SimulationTask(FiguresTask):
    """Figures of the simulation of the machine at every point.

    `figures`: their names, those of a simulation at the first point; `stated`: options (revolutions, points, control, tolerance,
    duration [s], speed [rad/s]); `design` [SI]: design variables that are not varied.
    """

    mode = "simulate"

    figures: tuple[str, ...]
    stated: tuple[tuple[str, Any], ...]
    design: tuple[tuple[str, float], ...]

    @property
    def options(self) -> dict[str, Any]:
        """Options of every simulation, and the given design."""
        return {"options": dict(self.stated), "design": dict(self.design)}

    def machines(self, points: range) -> Iterator[MachineFigures]:
        """Yield the figures of the simulations at points of the grid."""
        return map(self.simulated, points)

    @cached_property
    def has_clearance(self) -> bool:
        """Whether there are joints with clearance."""
        return self.problem.override(self.grid.changes(0)).model.has_clearance

    def simulated(self, point: int) -> MachineFigures:
        """Return the figures of a simulation, with its ending as status."""
        try:
            file = self.problem.override(self.grid.changes(point))
            design = {name: value for name, value in self.design if name in file.model.free} or None
            result = simulate_machine(file, dict(self.stated), design, has_clearances=self.has_clearance)
        except InputError as error:
            return MachineFigures({}, "not simulated", error.faults[0].message)
        if result.status == Ending.INTERRUPTED.value:  # a row is complete or absent
            raise KeyboardInterrupt
        return result


def simulate_machine(
    problem: ProblemFile, options: Mapping[str, Any], design: Mapping[str, float] | None, *, has_clearances: bool
) -> MachineFigures:
    """Simulate one machine."""
    settings = dict(options)
    if has_clearances:
        settings = {"integrator": "cvodes", **settings}  # one for all points, whatever is compiled meanwhile
        simulation = simulate_clearance(problem, design=design, check_predictability=False, **settings)
        return MachineFigures(simulation.figures, simulation.ending.value, "" if simulation.valid else simulation.message)
    if "points" in settings:
        settings["rows"] = settings.pop("points")
    ideal = simulate(problem, design=design, **settings)
    reason = "" if ideal.valid else f"{ideal.ending.text} (at {ideal.stopped:.9g} s)"
    return MachineFigures(ideal.figures, ideal.ending.value, reason)


def simulation_task(
    problem: ProblemFile, grid: Grid, options: Mapping[str, Any], design: Mapping[str, float] | None
) -> SimulationTask:
    """Return the task that simulates every point; the names of its figures are those of a short run at the first one.

    With joint clearance, its integrator is the one that is fastest for all points.
    """
    first, short = problem.override(grid.changes(0)), options
    clearances = first.model.has_clearance
    if clearances:
        settings = {"control": "none", "revolutions": 20, "points": 360, "tolerance": 1e-10, **options}
        _, integrator = check_simulations(first, design=design, runs=grid.count, **settings)
        options = {**options, "integrator": integrator} if integrator != "cvodes" else options
        short = {**options, "revolutions": 1}
    names = tuple(simulate_machine(first, short, design, has_clearances=clearances).figures)
    return SimulationTask(problem, grid, 1, names, tuple(options.items()), tuple((design or {}).items()))
