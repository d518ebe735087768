"""Pareto fronts of two or three objectives by the epsilon-constraint method; every point is a validated local optimum.

One objective is minimised, each of the others is constrained by a limit that varies from its best value to its value at the
optimum of the others. Unlike weighted sums, the method finds non-convex parts of a front. Grid, chunks, resuming and engines are
those of a sweep.

References
----------
Y. Y. Haimes, L. S. Lasdon, D. A. Wismer, "On a bicriterion formulation of the problems of integrated system identification and
system optimization", IEEE Trans. SMC-1 (1971) 296-297.
"""

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar, TypeVar, Unpack

import numpy as np
from numpy.typing import ArrayLike

from optlink.errors import InputError, Status
from optlink.execution.options import Execution
from optlink.execution.runner import check, known_here
from optlink.execution.store import Progress, Store
from optlink.linkage.vector2d import Array, all_finite
from optlink.optimization.pareto_front import ends, knee, undominated
from optlink.problem.arguments import typed
from optlink.problem.document import Renamed, Source, entries
from optlink.problem.file import AnyProblem, ProblemFile, problem_of
from optlink.studies.fronts.design_objectives import OPTION, ParetoObjective
from optlink.studies.fronts.epsilon_ranges import RANGES, EpsilonRanges, NoExtreme, read_objectives
from optlink.studies.grid import column_name
from optlink.studies.reoptimise_task import CHUNK, ReoptimiseTask, check_backend, optimum_task
from optlink.studies.sweeps import Cell, GridStudy, TableFile
from optlink.units import in_si
from optlink.version import VERSION

T = TypeVar("T")

POINTS = {1: 15, 2: 7}  # per constrained objective, by their number
ENDS = "ends"  # document of the study: results of the searches for the ends
RANGE_MARGIN = 1e-3
"""Share of an objective by which a design is better than the tightest limit of a range that does not restrict it."""
SAME_LIMIT = 1e-6  # relative excess over a limit up to which a validation decides whether a known design meets it
MAX_POINTS = 100_000  # largest number of points of a grid
STARTS = 8  # starting points of each search of a law, if the designs at the ends are not known


@dataclass(frozen=True)
class ParetoPoint:
    """A design of the front: values of the objectives in their order [SI], design variables by name [SI], active limits."""

    values: tuple[float, ...]
    design: Mapping[str, float]
    active: str
    mark: str


@dataclass(frozen=True, repr=False, kw_only=True)
class Pareto(GridStudy):
    """A Pareto front, sorted from the best value of the first objective.

    `ends`: index of the best point of every objective; `knee`: its index and its distance from the chord of the ends, if any;
    `reference`: the objectives [SI] of the initial machine, or of the optimum for the limits of the file. Of the `solved` points
    of the grid, `valid` are validated, `infeasible` have no design, and `dominated` are dominated by others.
    """

    kind = "pareto"
    shown: ClassVar[Mapping[str, Source]] = {
        "objectives": lambda result: [
            {"name": one.name, "column": one.column, "unit": one.unit, "sense": one.way} for one in result.objectives
        ],
        "minimised": lambda result: result.objectives[result.minimised].column,
        "constrained": lambda result: [
            {"limit" if key == "key" else key: value for key, value in entries(axis)} for axis in result.grid.axes
        ],
        "front": lambda result: [
            {
                "objectives": result._by_column(point.values),
                "design": point.design,
                "active": [name for name in point.active.split("; ") if name],
                "mark": point.mark or None,
            }
            for point in result.points
        ],
        "ends": lambda result: result._by_column(result.ends) if result.points else {},
        "knee": lambda result: result.knee and dict(zip(("point", "distance"), result.knee, strict=True)),
        "reference": lambda result: result.reference and {"what": result.reference_label} | result._by_column(result.reference),
        "points": "solved",
        "infeasible_points": "infeasible",
        "dominated_points": "dominated",
    }

    objectives: tuple[ParetoObjective, ...]
    minimised: int
    points: tuple[ParetoPoint, ...]
    ends: tuple[int, ...]
    knee: tuple[int, float] | None
    reference: tuple[float, ...] | None
    reference_label: str
    solved: int
    infeasible: int
    dominated: int

    @property
    def status(self) -> str:
        """Whether every point is validated, in words."""
        return "complete" if self.valid else "not valid everywhere"

    @property
    def single_point(self) -> str:
        """Why the front has one point, in words; empty for other fronts."""
        if len(self.points) != 1:
            return ""
        if self.valid_points < self.solved:
            return "Only one point has a verified design, so the front shows no trade-off"
        limited = [
            (objective, value)
            for k, (objective, value) in enumerate(zip(self.objectives, self.points[0].values, strict=True))
            if k != self.minimised
        ]
        for (objective, value), axis in zip(limited, self.grid.axes, strict=True):
            value /= objective.si_per_unit
            if objective.sense * (axis.values[-1] - value) > RANGE_MARGIN * abs(value):
                best = self.objectives[self.minimised].best
                value_of_best = f"{objective.name} {value:.6g} {objective.unit}"
                return f"No trade-off in this range: the {best} has {value_of_best}; give a range beyond it"
        return "No trade-off: one of the designs found is best in every objective"

    def _by_column(self, values: Sequence[T]) -> dict[str, T]:
        """Return one value for each objective by the column of the objective."""
        return dict(zip([objective.column for objective in self.objectives], values, strict=True))

    @property
    def costs(self) -> Array:
        """Objectives of the points (n, k), with the sign for minimisation."""
        return np.array([point.values for point in self.points]) * [objective.sense for objective in self.objectives]

    complete = Renamed("valid")

    @property
    def valid(self) -> bool:
        """Whether there is a front, and every point of the grid is validated or infeasible."""
        return bool(self.points) and self.valid_points + self.infeasible == self.solved

    @property
    def columns(self) -> dict[str, list[Any]]:
        """The front as a table: objectives and design variables [SI], active limits, and marks."""
        columns: dict[str, list[Any]] = {
            objective.column: [p.values[k] for p in self.points] for k, objective in enumerate(self.objectives)
        }
        quantities = self.problem.model.quantities
        for name in self.points[0].design if self.points else ():
            columns[column_name(name, quantities[name].display[1])] = [p.design[name] for p in self.points]
        return columns | {key: [getattr(p, key) for p in self.points] for key in ("active", "mark")}

    @property
    def chosen(self) -> int | None:
        """Index of the best point: the knee, without one the end of the first objective; None without points."""
        if not self.points:
            return None
        return self.ends[0] if self.knee is None else self.knee[0]

    @property
    def best(self) -> Mapping[str, Cell] | None:
        """Row of the best point, the knee or without one the end of the first objective, by column [SI]; None without points."""
        return None if self.chosen is None else {name: cells[self.chosen] for name, cells in self.columns.items()}

    def displayed(self, values: Sequence[float]) -> tuple[float, ...]:
        """Return values of the objectives [SI] in the units of the objectives."""
        return tuple(value / one.si_per_unit for value, one in zip(values, self.objectives, strict=True))


@typed
def pareto(
    problem: AnyProblem,
    objectives: Mapping[str, ArrayLike | None] | str,
    out: Path | None = None,
    *,
    points: int | None = None,
    resume: bool = False,
    backend: str = "ipopt",
    progress: Progress | None = None,
    **execution: Unpack[Execution],
) -> Pareto:
    """Compute the Pareto front of two or three objectives by the epsilon-constraint method.

    Parameters
    ----------
    problem : ProblemFile, str or Path
        A design for a requirement of any kind, or a machine with an objective over its cycle.
    objectives : mapping of str to None, array [SI] or str; or str
        Two or three objectives, each with the values of the limit that constrains it, or None for the range that the front
        needs: {"peak torque": None, "guide force in F": np.linspace(1300.0, 1600.0, 7)} for a machine, {"error": None,
        "limits.transmission_angle.max": "120..140 deg"} for a requirement; a text without a number of values has `points`. Also
        as on the command line, "error, total length". See `optlink.studies.fronts.epsilon_ranges`.
    out : Path, optional
        Folder for completed chunks and for a table of all points (`sweep.csv`). Default: a temporary folder.
    points : int, optional
        Number of points; with three objectives, along each of two axes. Default: 15; with three objectives 7.
    resume, backend
        As in `optlink.studies.sweeps.sweep`.
    progress : function of (completed points, all points), optional
    **execution : Execution
        Where the points are computed.

    Returns
    -------
    Pareto
        Validated designs of the front, its ends and its knee.

    Raises
    ------
    InputError
        If an objective is invalid, an end of the front cannot be found, or `out` contains another study.

    Examples
    --------
    >>> from optlink.studies import pareto
    >>> front = pareto(optlink.load("crank-rocker"), {"error": None, "limits.transmission_angle.max": None}, points=3)
    >>> [point.mark for point in front.points], front.best["mark"]
    (['least error', 'knee', 'best largest transmission angle'], 'knee')
    """
    problem = problem_of(problem)
    begin = time.perf_counter()
    objective_list = read_objectives(problem, objectives)
    first = min(range(len(objective_list)), key=lambda k: _rank(objective_list[k], k))
    if objective_list[first].span:
        message, remedy = "all objectives have ranges", "One of them is minimised: leave its range out"
        if sum(objective.direct for objective in objective_list) == 1:
            message, remedy = f"{objective_list[first].name} has no range: it is minimised", "Leave the range out"
        raise InputError(message, remedy, problem.file, OPTION, _written(objective_list))
    limited = RANGES[problem.task].limited
    objective_list = tuple(one if k == first else limited(problem, one) for k, one in enumerate(objective_list))
    count = POINTS[len(objective_list) - 1] if points is None else points
    if count < 2:
        raise InputError("out of range", "Give 2 points or more", key="--points", value=points)
    check_backend(backend)
    ranges = RANGES[problem.task](problem, objective_list, first, count, backend)
    if (total := math.prod(ranges.shape)) > MAX_POINTS:
        size = " x ".join(f"{length:,}" for length in ranges.shape) + (f" = {total:,}" if len(ranges.shape) > 1 else "")
        raise InputError(f"{size} points exceed the limit of a front, {MAX_POINTS:,}", "Give fewer", key="--points")
    execution = known_here(problem, execution)
    check(**execution)
    with Store(None if out is None else Path(str(out)), _about(problem, objective_list, count, backend), resume=resume) as store:
        ahead = ranges.searches
        once = _Once(store, None if progress is None else lambda completed: progress(completed, ahead + total))
        try:
            base, grid, anchors = ranges.search(once)
        except NoExtreme:
            store.withdraw()
            raise
        once.progress = None
        task = optimum_task(base, grid, backend, CHUNK, anchors)
        task = task if anchors else replace(task, starts=STARTS)
        store.divide(task.size, task.chunks)
        mine, cpu = store.fill(
            task,
            None if progress is None else lambda completed, total: progress(ahead + completed, ahead + total),
            **execution,
        )
        if not store.finished:
            store.finish(task.columns, iter(_with_known_designs(task, ranges, list(store.rows()), anchors)))
        store.drop()
        rows = [dict(zip(task.columns, row, strict=True)) for row in store.finished_rows(task.columns)]
        designs = [point for row in rows if row["valid"] == "true" for point in [_point(task, ranges, row)] if point is not None]
        senses = [objective.sense for objective in objective_list]
        costs = np.array([p.values for p in designs]).reshape(-1, len(senses)) * senses
        non_dominated = np.flatnonzero(undominated(costs))
        non_dominated = non_dominated[np.lexsort(costs[non_dominated].T[::-1])]
        corner, bend = (ends(costs[non_dominated]), knee(costs[non_dominated])) if len(non_dominated) else ((), None)
        front = tuple(_marked(designs[i], j, objective_list, corner, bend) for j, i in enumerate(non_dominated))
        words, reference = ranges.reference(base, once)
        reference = reference and _si(objective_list, reference)
        return Pareto(
            problem=problem,
            objectives=objective_list,
            minimised=first,
            points=front,
            ends=corner,
            knee=bend,
            reference=reference,
            reference_label=words,
            solved=len(rows),
            valid_points=len(designs),
            infeasible=sum(row["status"] == Status.INFEASIBLE.value for row in rows),
            dominated=len(designs) - len(front),
            grid=grid,
            table=TableFile(store.table, store.temporary),
            points_done_now=mine,
            seconds=time.perf_counter() - begin,
            processor_seconds=cpu,
            engine=execution.get("engine", "local"),
            workers=execution.get("workers"),
        )


def _rank(objective: ParetoObjective, k: int) -> tuple[bool, bool, bool, bool, int]:
    """Return a sort key; the first is minimised: without a range the sum of the file, which has no limit, or a deviation."""
    return not objective.direct, bool(objective.span), bool(objective.key) and objective.part < 0, bool(objective.key), k


def _about(problem: ProblemFile, objectives: tuple[ParetoObjective, ...], count: int, backend: str) -> dict[str, Any]:
    """Return the definition of a front; the ranges of its limits follow from it."""
    return {
        "schema": "optlink/study/1",
        "optlink": VERSION,
        "problem": problem.name,
        "problem_hash": problem.hash,
        "mode": "pareto",
        "objectives": [_written([objective]) for objective in objectives],
        "points": count,
        "backend": backend,
    }


def _written(objectives: Sequence[ParetoObjective]) -> str:
    """Return objectives with their ranges as a text, as on the command line."""
    return ", ".join(f"{one.text}={one.span}" if one.span else one.text for one in objectives)


def _si(objectives: Sequence[ParetoObjective], values: Sequence[float]) -> tuple[float, ...]:
    """Return values of objectives [SI] from those in their units."""
    return tuple(value * one.si_per_unit for value, one in zip(values, objectives, strict=True))


class _Once:
    """Searches performed once per study: their results are stored in its folder."""

    def __init__(self, store: Store, progress: Callable[[int], None] | None) -> None:
        self.store, self.progress, self.done = store, progress, 0
        self.known: dict[str, Any] = store.document(ENDS)

    def __call__(self, name: str, search: Callable[[], Mapping[str, Any]]) -> Mapping[str, Any]:
        """Return the result of a search, from the folder if available."""
        if self.progress is not None:
            self.progress(self.done)
        if name not in self.known:
            self.known[name] = search()
            self.store.keep(ENDS, self.known)
        self.done += 1
        return self.known[name]  # type: ignore[no-any-return]


# --- from rows to the front ----------------------------------------------------------------------------------------------


def _with_known_designs(
    task: ReoptimiseTask, ranges: EpsilonRanges, rows: list[list[str]], anchors: Sequence[Mapping[str, float]]
) -> list[list[str]]:
    """Return the rows, where a search found no valid design with those from designs that are valid at tighter limits or the ends.

    No point is infeasible at which one of these designs meets all limits.
    """
    senses = np.array([ranges.objectives[k].sense for k in ranges.constrained])
    limits = np.array([task.grid.values(point) for point in range(len(rows))]) * senses  # to be minimised
    room, valid = SAME_LIMIT * np.abs(limits), np.zeros(len(rows), dtype=bool)
    figures = [ranges.figures(task.template, design, math.nan) for design in anchors]
    met = [np.all(senses * np.array(figure)[list(ranges.constrained)] <= limits + room, axis=1) for figure in figures]
    at = task.columns.index(task.objective_column)
    for point in reversed(range(len(rows))):  # from the tightest limits
        if not _is_valid(task, rows[point]):
            nearest = np.flatnonzero(valid & np.all(limits <= limits[point], axis=1))[:1]
            designs: list[Mapping[str, float]] = [_design(task, rows[other]) for other in nearest]
            designs += [design for design, meets in zip(anchors, met, strict=True) if meets[point]]
            found = [row for design in designs if (row := task.from_known(point, design)) is not None]
            rows[point] = min(found, key=lambda row: float(row[at]), default=rows[point])
        valid[point] = _is_valid(task, rows[point])
    return rows


def _is_valid(task: ReoptimiseTask, row: Sequence[str]) -> bool:
    return row[task.columns.index("valid")] == "true"


def _design(task: ReoptimiseTask, row: Sequence[str]) -> dict[str, float]:
    """Return the design variables [SI] of a row."""
    first = len(task.grid.axes)
    return {name: float(row[first + k]) for k, name in enumerate(task.free)}


def _point(task: ReoptimiseTask, ranges: EpsilonRanges, row: Mapping[str, str]) -> ParetoPoint | None:
    """Return a row with its objectives evaluated; None if they are not finite."""
    factor, unit = task.template.model.objective_display
    design = _design(task, list(row.values()))
    measured = ranges.figures(task.template, design, float(row[task.objective_column]) / (factor * in_si(unit)[0]))
    return ParetoPoint(_si(ranges.objectives, measured), design, row["active"], "") if all_finite(measured) else None


def _marked(
    point: ParetoPoint, number: int, objectives: Sequence[ParetoObjective], corner: Sequence[int], bend: tuple[int, float] | None
) -> ParetoPoint:
    marks = [objective.best for objective, end in zip(objectives, corner, strict=True) if end == number]
    if bend is not None and bend[0] == number:
        marks.append("knee")
    return replace(point, mark=", ".join(marks))
