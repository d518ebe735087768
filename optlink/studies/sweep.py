"""A sweep: the problem solved again, or designs analysed, at every point of a grid; resumable, on one machine or on a cluster."""

from __future__ import annotations

import csv
import shutil
import tempfile
import time
import weakref
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from optlink.errors import Fault, InputError, Status
from optlink.io import Summary, finite, head
from optlink.optimization.objectives import MEASURES
from optlink.problem.file import ProblemFile
from optlink.studies.analysis_task import MANY, Analysing, quantity_of
from optlink.studies.cycle_task import Designing
from optlink.studies.grid import Grid, read_grid
from optlink.studies.reoptimise_task import CHUNK, SEARCHED, SLOW_CHUNK, Reoptimising, buildable, check_backend
from optlink.studies.runner import run
from optlink.studies.simulation_task import Simulating, is_loose, simulated
from optlink.studies.store import Progress, Store
from optlink.studies.sweep_task import Sweeping

SCHEMA = "optlink/sweep/1"
CHANGED = "active_set_changed"
OPTIMISE = "optimise"  # the mode of a sweep that searches an optimum at every point
MOST_ANGLES = 10_000  # of an analysis
KEPT = 200  # changes of the active set that a result names; the table marks all
TEXT = ("status", "failed", "active", "found", "reason")


def objective_column(problem: ProblemFile) -> str:
    """Name of the objective's column, with its SI unit."""
    if problem.task == "path":
        from optlink.problem.path import GenerationProblem
        from optlink.tasks.path_result import objective_unit

        assert isinstance(problem.model, GenerationProblem)
        unit = objective_unit(problem.model)
    else:
        unit = MEASURES[problem.spec.requirement.measure].unit
    return f"objective_{unit.replace('^', '')}".rstrip("_")


@dataclass(frozen=True)
class Change:
    """Where another set of limits begins to hold the design: at a point `at`, the next after one that others hold."""

    at: Mapping[str, float]
    before: str
    after: str


@dataclass
class _Summary:
    """What a table says, gathered row by row."""

    objective: str | None
    valid: int = 0
    statuses: Counter[str] = field(default_factory=Counter)
    searched: int = 0
    changed: int = 0
    best: dict[str, str] | None = None
    changes: list[Change] = field(default_factory=list)


@dataclass(frozen=True, repr=False)
class Sweep(Summary):
    """A finished sweep. Its table is a file; nothing of it is held in memory until it is asked for.

    `valid`, `searched`, `changed`: how many points have a proven optimum (or a sound analysis), needed more than steps from a
    neighbour, have another active set than the point before; `statuses`: how many points have each status; `cpu` [s] of all
    processes for the `done` points that this run did itself.
    """

    problem: ProblemFile
    grid: Grid
    mode: str
    path: Path
    names: tuple[str, ...]
    valid: int
    statuses: Mapping[str, int]
    searched: int
    changed: int
    best: Mapping[str, str] | None
    changes: tuple[Change, ...]
    done: int
    seconds: float
    cpu: float
    engine: str
    workers: int | None
    keep: Any = None  # a temporary folder, as long as the result lives

    @cached_property
    def columns(self) -> dict[str, Any]:
        """The table: arrays by name, of texts where a column holds words."""
        with self.path.open(encoding="utf-8", newline="") as file:
            rows = csv.reader(file)
            names = next(rows)
            table = list(zip(*rows, strict=True))
        return {name: _column(name, values) for name, values in zip(names, table, strict=True)}

    @property
    def evaluated(self) -> bool:
        """Whether designs were analysed or simulated as they are, rather than optimised."""
        return self.mode != OPTIMISE

    @property
    def complete(self) -> bool:
        """Whether every point has a proven optimum, or all figures that it was analysed for."""
        return self.valid == self.grid.count

    @property
    def successful(self) -> bool:
        """Whether the sweep serves: every optimum proven; of an analysis, where some points may lie out of reach, any valid."""
        return self.complete or (self.evaluated and self.valid > 0)

    @property
    def infeasible(self) -> int:
        """How many points hold no design."""
        return self.statuses.get(Status.INFEASIBLE.value, 0)

    def to_dict(self) -> dict[str, Any]:
        """As a JSON document."""
        axes = [
            {"key": a.key, "unit": a.unit, "first": a.values[0], "last": a.values[-1], "values": len(a.values)}
            for a in self.grid.axes
        ]
        status = "complete" if self.complete else "not valid everywhere" if self.valid else "not valid anywhere"
        document = head(SCHEMA, self.problem, status)
        document |= {
            "mode": self.mode,
            "axes": axes,
            "points": self.grid.count,
            "table": None if self.keep is not None else str(self.path),
            "columns": list(self.names),
            "engine": self.engine,
            "workers": self.workers,
            "valid_points": self.valid,
            "statuses": dict(self.statuses),
            "points_done_now": self.done,
            "seconds": self.seconds,
            "processor_seconds": self.cpu,
        }
        if not self.evaluated:
            document |= {
                "infeasible_points": self.infeasible,
                "searched_points": self.searched,
                "active_set_changes": self.changed,
                "changes": [vars(change) | {"at": dict(change.at)} for change in self.changes],
                "best": None if self.best is None else dict(self.best),
            }
        return finite(document)  # type: ignore[no-any-return]


def _column(name: str, values: Sequence[str]) -> NDArray[Any]:
    if name in TEXT:
        return np.array(values)
    if name in ("valid", CHANGED):
        return np.array([value == "true" for value in values])
    return np.array([float(value) if value else np.nan for value in values])


class Folder:
    """A temporary folder that goes with whoever holds it."""

    def __init__(self) -> None:
        self.path = Path(tempfile.mkdtemp(prefix="optlink-sweep-"))
        weakref.finalize(self, shutil.rmtree, self.path, ignore_errors=True)


def sweep(
    problem: ProblemFile,
    vary: Sequence[str],
    out: Path | None = None,
    *,
    resume: bool = False,
    analyze: bool = False,
    columns: Sequence[str] = ("input.torque_Nm",),
    points: int = 360,
    design: Mapping[str, float] | None = None,
    simulate: Mapping[str, Any] | None = None,
    backend: str = "ipopt",
    engine: str = "local",
    workers: int | None = None,
    scheduler: str | None = None,
    progress: Progress | None = None,
) -> Sweep:
    """Solve a problem, or analyse its linkage, at every point of a grid.

    Parameters
    ----------
    problem : ProblemFile
    vary : texts such as "mechanism.frame=450..550 mm:101"
        The last one changes fastest. See `optlink.studies.grid`.
    out : folder, optional
        Where chunks are kept as they are done, and the table `sweep.csv` at the end.
    resume : bool
        Go on with a run of before that ended early in that folder.
    analyze : bool
        No optimisation: `columns` of the analysis, their exact least and largest value and their rms at `points` crank angles, or
        single figures such as "slider.stroke_m"; `design` [SI] of what is free and not varied, its start if left out.
    simulate : mapping, optional
        No optimisation: the figures of a simulation with these options (revolutions, points, control, tolerance or duration, as
        far as they are stated) of the machine at every point.
    backend : "slsqp" or "ipopt"
    engine, workers, scheduler
        See `optlink.studies.runner.run`.
    progress : function of the points done and of all, optional

    Raises
    ------
    InputError
        see `read_grid`; a folder that holds another study; a disk that is full (what is done is kept).
    """
    begin = time.perf_counter()
    grid = read_grid(problem, vary)
    if simulate is not None:
        task: Sweeping = _simulating(problem, grid, simulate, design)
    else:
        task = _task(problem, grid, analyze, columns, points, design, backend)
    evaluated = mode_of(task) != OPTIMISE
    run(task, (), engine, workers, scheduler)  # raises if it cannot
    holder = Folder() if out is None else None
    with Store(holder.path if holder is not None else Path(str(out)), _about(task), resume=resume) as store:
        store.divide(task.size, task.chunks)
        mine, cpu = store.fill(task, engine, workers, scheduler, progress)
        names = [*task.columns, *(() if evaluated else (CHANGED,))]
        summary = _Summary(None if evaluated else next(name for name in names if name.startswith("objective")))
        if store.finished:
            store.drop()
            rows = store.finished_rows(names)
            for _ in _marked(rows if evaluated else (row[:-1] for row in rows), grid, names, summary):
                pass  # for the sake of the summary
        else:
            store.finish(names, _marked(store.rows(), grid, names, summary))
        return Sweep(
            problem=problem,
            grid=grid,
            mode=mode_of(task),
            path=store.table,
            names=tuple(names),
            valid=summary.valid,
            statuses=summary.statuses,
            searched=summary.searched,
            changed=summary.changed,
            best=summary.best,
            changes=tuple(summary.changes),
            done=mine,
            seconds=time.perf_counter() - begin,
            cpu=cpu,
            engine=engine,
            workers=workers,
            keep=holder,
        )


def _task(
    problem: ProblemFile,
    grid: Grid,
    analyze: bool,
    columns: Sequence[str],
    points: int,
    design: Mapping[str, float] | None,
    backend: str,
) -> Sweeping:
    stated = Sweeping.stated(problem)
    if analyze:
        if not 2 <= points <= MOST_ANGLES:
            raise InputError(Fault("out of range", f"Give 2 to {MOST_ANGLES:,} crank angles", key="--points", value=points))
        quantities = tuple(quantity_of(problem, axis) for axis in grid.axes)
        given = tuple((name, value) for name, value in (design or {}).items() if name not in quantities)
        whole = Analysing(
            **stated, grid=grid, chunk=MANY, quantities=quantities, asked=tuple(columns), points=points, design=given
        )
        first = Grid(tuple(replace(axis, values=axis.values[:1]) for axis in grid.axes))
        replace(whole, grid=first).lines(0)  # whatever is wrong with columns or sizes shows now
        return whole
    if design is not None:
        raise InputError(Fault("a given design is not optimised", "Leave --design out, or add --analyze", key="--design"))
    check_backend(backend)
    if problem.task == "cycle":
        designing = Designing(**stated, grid=grid, chunk=SLOW_CHUNK, backend=backend)
        return _with_something_free(designing, problem)
    if problem.task != "path":
        problem.spec  # noqa: B018 - raises if there is nothing to solve
    task = Reoptimising(**stated, grid=grid, chunk=CHUNK, backend=backend)
    _with_something_free(task, problem)
    if buildable(task.template, tuple(axis.key for axis in grid.axes)):
        return task
    return replace(task, chunk=SLOW_CHUNK)


def _simulating(problem: ProblemFile, grid: Grid, options: Mapping[str, Any], design: Mapping[str, float] | None) -> Simulating:
    """The task that simulates; the names of its figures are those of a short run at the first point."""
    first = problem.override(grid.changes(0))
    short = {**options, "revolutions": 1} if is_loose(first) else options
    figures, _, _ = simulated(first, short, design, loose=is_loose(first))
    own = tuple((design or {}).items())
    return Simulating(
        **Sweeping.stated(problem), grid=grid, chunk=1, figures=tuple(figures), options=tuple(options.items()), design=own
    )


def _with_something_free(task: Designing | Reoptimising, problem: ProblemFile) -> Sweeping:
    """The task, if there is something to find."""
    if not task.free:
        raise InputError(Fault("nothing is free, there is nothing to find", "Add --analyze, or free a size", problem.file))
    return task


def mode_of(task: Sweeping) -> str:
    """What a sweep does at every point."""
    return "analyse" if isinstance(task, Analysing) else "simulate" if isinstance(task, Simulating) else OPTIMISE


def _about(task: Sweeping) -> dict[str, Any]:
    """What makes a study this one and no other."""
    about: dict[str, Any] = {
        "schema": "optlink/study/1",
        "optlink": task.version,
        "problem": task.name,
        "problem_hash": task.hash,
        "mode": mode_of(task),
        "axes": [[axis.key, axis.unit, list(axis.values)] for axis in task.grid.axes],
        "points_per_chunk": task.chunk,
        "columns": task.columns,
    }
    if isinstance(task, Analysing):
        about |= {"crank_angles": task.points, "design": dict(task.design)}
    if isinstance(task, Simulating):
        about |= {"options": dict(task.options), "design": dict(task.design)}
    if isinstance(task, Designing | Reoptimising):
        about["backend"] = task.backend
    return about


def _marked(rows: Iterator[list[str]], grid: Grid, names: list[str], summary: _Summary) -> Iterator[list[str]]:
    """Rows with the mark of a new active set, if they have one; the summary is gathered on the way."""
    before: str | None = None
    held, status = (names.index(name) if summary.objective is not None else -1 for name in ("active", "status"))

    def designed(row: list[str]) -> bool:
        return row[status] != Status.INFEASIBLE.value

    for number, row in enumerate(rows):
        if summary.objective is not None:
            before = before if number % grid.row else None
            row = [*row, "true" if designed(row) and before is not None and before != row[held] else "false"]
        _count(summary, grid, names, number, row, before)
        before = row[held] if designed(row) else None
        yield row


def _count(summary: _Summary, grid: Grid, names: list[str], number: int, row: list[str], before: str | None = None) -> None:
    found = dict(zip(names, row, strict=True))
    summary.statuses[found["status"]] += 1
    if summary.objective is None:
        summary.valid += found["valid"] == "true"
        return
    summary.searched += found["found"] == SEARCHED
    if found[CHANGED] == "true":
        summary.changed += 1
        if len(summary.changes) < KEPT and before is not None:
            at = {axis.column: value for axis, value in zip(grid.axes, grid.values(number), strict=True)}
            summary.changes.append(Change(at, before, found["active"]))
    if found["valid"] == "true":
        summary.valid += 1
        if summary.best is None or float(found[summary.objective]) < float(summary.best[summary.objective]):
            summary.best = found
