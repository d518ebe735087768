"""Parameter sweeps: optimise, analyse or simulate at every point of a grid; resumable, local or on a cluster."""

from __future__ import annotations

import contextlib
import csv
import itertools
import math
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, ClassVar, Self, Unpack

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import PlainSerializer, PlainValidator, WithJsonSchema

from optlink.errors import InputError, Status
from optlink.execution.options import Execution
from optlink.execution.runner import check, known_here
from optlink.execution.store import TABLE, Progress, Store, TemporaryFolder
from optlink.problem.arguments import typed
from optlink.problem.document import Document, Renamed, Source
from optlink.problem.file import AnyProblem, ProblemFile, problem_of
from optlink.studies.grid import Grid, read_grid
from optlink.studies.reoptimise_task import SEARCHED, check_backend, chunk_of, optimum_task
from optlink.studies.sweep_task import MAX_ANGLES, OPTIMISE, SweepTask, analysis_task, simulation_task
from optlink.tasks.machine import check_design

CHANGED = "active_set_changed"
MAX_ROWS = 200_000  # rows up to which a document contains the table, and a page shows all of it
BLOCK_ROWS = 10_000  # rows of a table that are read at a time
LISTED_CHANGES = 200  # active-set changes listed in a result; the table marks all
COMPLETE = "complete"  # status of a sweep with a valid result at every point
TEXT = ("status", "failed", "active", "method", "reason")


def _column(values: Sequence[Any]) -> NDArray[Any]:
    """Return a column as an array: of texts, of booleans, or of numbers, with NaN for a missing one."""
    return np.array(values, dtype=None if isinstance(values[0], str | bool) else float)


def _read_column(name: str, texts: Sequence[str]) -> NDArray[Any]:
    if name in TEXT:
        return _column(texts)
    return _column([text == "true" if name in ("valid", CHANGED) else float(text or "nan") for text in texts])


Cell = float | bool | str
"""An entry of a table: a number [SI], whether something holds, or words."""
TableColumn = Annotated[NDArray[Any], PlainValidator(_column), WithJsonSchema({"type": "array"})]


@dataclass(frozen=True)
class TableFile:
    """The table of a study in its file, in a `temporary` folder if no other is given."""

    path: Path
    temporary: TemporaryFolder | None = None

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the columns."""
        with self._read():
            return tuple(next(self._rows(), ()))

    @cached_property
    def columns(self) -> dict[str, NDArray[Any]]:
        """The columns by name [SI].

        Raises
        ------
        InputError
            If the file cannot be read.
        """
        with self._read():
            rows, parts = self._rows(), []
            names = next(rows)
            while portion := list(itertools.islice(rows, BLOCK_ROWS)):
                parts.append([_read_column(*part) for part in zip(names, zip(*portion, strict=True), strict=True)])
            return dict(zip(names, map(np.concatenate, zip(*parts, strict=True)), strict=True))

    def __reduce__(self) -> tuple[Callable[..., TableFile], tuple[Any, ...]]:
        """Return what a copy or a pickle is made from: of a temporary table its content, since its file goes with this object."""
        if self.temporary is None:
            return TableFile, (self.path,)
        with self._read():
            return _in_temporary_folder, (self.path.read_bytes(),)

    @contextlib.contextmanager
    def _read(self) -> Iterator[None]:
        try:
            yield
        except (OSError, ValueError, StopIteration, csv.Error) as error:
            reason = getattr(error, "strerror", None) or "it is damaged"
            raise InputError(f"cannot read the table of the sweep: {reason}", "Run the sweep again", str(self.path)) from None

    def _rows(self) -> Iterator[list[str]]:
        with self.path.open(encoding="utf-8", newline="") as file:
            yield from csv.reader(file)


def _in_temporary_folder(content: bytes) -> TableFile:
    """Return the table that a file holds, in a temporary folder of its own."""
    folder = TemporaryFolder()
    path = folder.path / TABLE
    path.write_bytes(content)
    return TableFile(path, folder)


StoredTable = Annotated[
    TableFile | None,
    PlainValidator(lambda path: path and TableFile(Path(path))),
    PlainSerializer(lambda table: None if table is None or table.temporary else str(table.path)),
    WithJsonSchema({"anyOf": [{"type": "string"}, {"type": "null"}]}),
]
"""The table of a study, in a document the name of its file; None if that was temporary."""


@dataclass(frozen=True)
class ActiveSetChange:
    """Change of the active set: at a point, whose axes by column are `at` [SI], relative to the preceding one."""

    at: Mapping[str, float]
    before: str
    after: str


@dataclass
class _Summary:
    """Summary of a table, accumulated row by row; see `Sweep`."""

    valid_points: int = 0
    statuses: Counter[str] = field(default_factory=Counter)
    searched_points: int = 0
    active_set_changes: int = 0
    best: dict[str, Cell] | None = None
    changes: tuple[ActiveSetChange, ...] = ()


@dataclass(frozen=True, repr=False, kw_only=True)
class GridStudy(Document):
    """Result of a study of all points of a grid.

    `valid_points`: number of points with a validated optimum (or a complete analysis); `processor_seconds`: processor time of all
    processes for the `points_done_now`, those of this run; `best`: the row of the best point by column [SI], None if there is
    none.
    """

    problem: ProblemFile
    grid: Grid
    table: StoredTable
    valid_points: int
    points_done_now: int
    seconds: float
    processor_seconds: float
    engine: str
    workers: int | None

    done = Renamed("points_done_now")
    cpu = Renamed("processor_seconds")

    @property
    def path(self) -> Path:
        """File of the table."""
        assert self.table is not None
        return self.table.path


@dataclass(frozen=True, repr=False, kw_only=True)
class Sweep(GridStudy):
    """Result of a sweep; its table is read from its file on demand, and contained in its document up to `MAX_ROWS` rows.

    `searched_points`: number of points that were solved by a new search instead of continuation from a neighbour;
    `active_set_changes`: number of points whose active set differs from that of the preceding point; `statuses`: number of points
    by status; `best`: the valid point with the best objective, of a sweep of optima; `data`: the table that was read from a
    document.
    """

    kind = "sweep"
    shown: ClassVar[Mapping[str, Source]] = {
        "axes": "grid.axes",
        "points": "grid.count",
        "columns": "names",
        "infeasible_points?": lambda sweep: None if sweep.evaluated else sweep.infeasible,
    }

    mode: str
    statuses: Mapping[str, int]
    best: Mapping[str, Cell] | None
    changes: tuple[ActiveSetChange, ...]
    searched_points: int = 0
    active_set_changes: int = 0
    data: dict[str, TableColumn] | None = None

    def to_dict(self) -> dict[str, Any]:
        """Return the sweep as a JSON document, with its table unless that is too large."""
        if self.data is None and self.grid.count <= MAX_ROWS:
            return replace(self, data=self.columns).to_dict()
        return super().to_dict()

    @classmethod
    def from_dict(cls, document: Mapping[str, Any], path: Path) -> Self:
        """Return the sweep that a document holds; a large table is read from its file, which lies beside the document.

        Parameters
        ----------
        document : mapping
            From `to_dict`.
        path : Path
            File of the document.

        Raises
        ------
        InputError
            As `Document.from_dict`, and if a large table is missing.
        """
        result = super().from_dict(document, path)
        if result.data is not None:
            return result
        places = [TableFile(path.parent / TABLE), *([result.table] if result.table else [])]
        table = next((place for place in places if place.path.is_file()), None)
        if table is None or list(table.names) != document["columns"]:
            remedy = f"Keep {TABLE} and result.json of a large sweep in one folder"
            raise InputError(f"the table of this sweep is missing: {TABLE}", remedy, str(path))
        object.__setattr__(result, "table", table)  # a copy would lack the notes of others
        return result

    @property
    def columns(self) -> dict[str, NDArray[Any]]:
        """The table: arrays by name [SI], of texts for columns of words."""
        return self.table.columns if self.data is None and self.table is not None else self.data or {}

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the columns."""
        return self.table.names if self.data is None and self.table is not None else tuple(self.data or ())

    @property
    def evaluated(self) -> bool:
        """Whether designs were analysed or simulated instead of optimised."""
        return self.mode != OPTIMISE

    complete = Renamed("valid")
    successful = Renamed("valid")
    searched = Renamed("searched_points")
    changed = Renamed("active_set_changes")

    @property
    def valid(self) -> bool:
        """Whether the sweep is usable: every optimum validated; for an analysis, at least one valid point."""
        return self.status == COMPLETE or (self.evaluated and self.valid_points > 0)

    @property
    def infeasible(self) -> int:
        """Number of points without a design."""
        return self.statuses.get(Status.INFEASIBLE.value, 0)

    @property
    def status(self) -> str:
        """Whether every point has a validated optimum, or all requested figures, in words."""
        if self.valid_points == self.grid.count:
            return COMPLETE
        return "not valid everywhere" if self.valid_points else "not valid anywhere"


@typed
def sweep(
    problem: AnyProblem,
    vary: Mapping[str, ArrayLike] | Sequence[str],
    out: Path | None = None,
    *,
    resume: bool = False,
    analyze: bool = False,
    columns: Sequence[str] | None = None,
    points: int = 360,
    design: Mapping[str, float | str] | None = None,
    simulate: Mapping[str, Any] | None = None,
    backend: str = "ipopt",
    progress: Progress | None = None,
    **execution: Unpack[Execution],
) -> Sweep:
    """Optimise, analyse or simulate a problem at every point of a grid.

    Parameters
    ----------
    problem : ProblemFile, str or Path
        From `optlink.load`, the name of a shipped problem, or a file.
    vary : mapping of str to array [SI] or str, or sequence of str
        Axes of the grid: values by key, for example {"mechanism.frame": np.linspace(0.45, 0.55, 11)} in SI, or texts with units,
        "450..550 mm:11" (11 values) or "450 mm, 500 mm"; also as on the command line, ["mechanism.frame=450..550 mm:11"]. The
        last axis varies fastest.
    out : Path, optional
        Folder for completed chunks and for the final table `sweep.csv`. Default: a temporary folder.
    resume : bool
        Whether to resume the interrupted run in `out`.
    analyze : bool
        Whether to analyse the machine at every point instead of optimising it.
    columns : sequence of str, optional
        With `analyze`: columns of the analysis, each with its exact least and largest value and its rms value, or single figures
        such as "slider.stroke_m". Default: the torque or force of each drive.
    points : int
        With `analyze`: number of crank angles per revolution for rms values.
    design : mapping of str to float [SI] or str, optional
        Values of design variables that are not varied, for an analysis or simulation. Default: their starting values.
    simulate : mapping, optional
        Options of a simulation at every point, instead of an optimisation: revolutions, points, control, tolerance, integrator
        or duration.
    backend : "slsqp" or "ipopt"
        Local solver.
    progress : function of (completed points, all points), optional
    **execution : Execution
        Where the points are computed.

    Returns
    -------
    Sweep
        Number of points by status, and the table, which is read from its file on demand.

    Raises
    ------
    InputError
        If an axis or argument is invalid, `out` contains another study, or the disk is full (completed chunks are kept).

    Examples
    --------
    >>> from optlink.studies import sweep
    >>> result = sweep(optlink.load("crank-rocker"), {"mechanism.frame": [0.48, 0.5]})
    >>> result.columns["objective_rad2"].round(6).tolist(), result.best["mechanism.frame_m"]
    ([0.007794, 0.007592], 0.5)
    """
    problem = problem_of(problem)
    begin = time.perf_counter()
    if not 2 <= points <= MAX_ANGLES:
        raise InputError("out of range", f"Give 2 to {MAX_ANGLES:,} crank angles", key="--points", value=points)
    grid = read_grid(problem, vary)
    sizes = check_design(problem, design)
    if simulate is not None:
        task: SweepTask = simulation_task(problem, grid, simulate, sizes)
    elif analyze:
        task = analysis_task(problem, grid, columns, points, sizes)
    else:
        task = _reoptimising(problem, grid, sizes, backend)
    evaluated = task.mode != OPTIMISE
    execution = known_here(problem, execution)
    check(**execution)
    with Store(None if out is None else Path(str(out)), _about(task), resume=resume) as store:
        store.divide(task.size, task.chunks)
        mine, cpu = store.fill(task, progress, **execution)
        names = [*task.columns, *(() if evaluated else (CHANGED,))]
        summary, sense = _Summary(), problem.model.objective_display[0]
        if store.finished:
            store.drop()
            rows = store.finished_rows(names)
            for _ in _marked(rows if evaluated else (row[:-1] for row in rows), grid, names, summary, sense):
                pass  # accumulates the summary
        else:
            store.finish(names, _marked(store.rows(), grid, names, summary, sense))
        return Sweep(
            problem=problem,
            grid=grid,
            mode=task.mode,
            table=TableFile(store.table, store.temporary),
            **vars(summary),
            points_done_now=mine,
            seconds=time.perf_counter() - begin,
            processor_seconds=cpu,
            engine=execution.get("engine", "local"),
            workers=execution.get("workers"),
        )


def _reoptimising(problem: ProblemFile, grid: Grid, design: Mapping[str, float] | None, backend: str) -> SweepTask:
    if design is not None:
        raise InputError("--design has no effect on an optimisation", "Leave --design out, or add --analyze", key="--design")
    check_backend(backend)
    if problem.task == "balance":
        remedy = "Run `optlink balance` with --set for each value, or add --analyze"
        raise InputError("a sweep does not optimise a balancing problem", remedy, problem.file, "balance")
    if problem.task not in ("path", "cycle"):
        problem.spec  # noqa: B018 - raises if there is nothing to solve
    task = optimum_task(problem, grid, backend, chunk_of(grid))
    if not task.free:
        raise InputError("no design variables: every dimension is fixed", "Add --analyze, or free a dimension", problem.file)
    return task


def _about(task: SweepTask) -> dict[str, Any]:
    """Return the definition of a study."""
    return {
        "schema": "optlink/study/1",
        "optlink": task.version,
        "problem": task.source.name,
        "problem_hash": task.hash,
        "mode": task.mode,
        "axes": [[axis.key, axis.unit, list(axis.values)] for axis in task.grid.axes],
        "points_per_chunk": task.chunk,
        "columns": task.columns,
        **task.options,
    }


def _marked(rows: Iterator[list[str]], grid: Grid, names: list[str], summary: _Summary, sense: float) -> Iterator[list[str]]:
    """Yield rows with a mark of active-set changes, if applicable, and accumulate the summary.

    `sense`: negative if the objective is maximised.
    """
    status, valid = names.index("status"), names.index("valid")
    if CHANGED not in names:
        for row in rows:
            summary.statuses[row[status]] += 1
            summary.valid_points += row[valid] == "true"
            yield row
        return
    active, method = names.index("active"), names.index("method")
    objective = next(k for k, name in enumerate(names) if name.startswith("objective"))
    before, length, least, infeasible = None, grid.row, math.inf, Status.INFEASIBLE.value
    for number, row in enumerate(rows):
        now = None if row[status] == infeasible else row[active]
        changed = number % length != 0 and now is not None and before is not None and before != now
        row = [*row, "true" if changed else "false"]
        summary.statuses[row[status]] += 1
        summary.searched_points += row[method] == SEARCHED
        if changed:
            summary.active_set_changes += 1
            if len(summary.changes) < LISTED_CHANGES:
                assert before is not None
                at = {axis.column: float(value) for axis, value in zip(grid.axes, grid.in_si(number), strict=True)}
                summary.changes += (ActiveSetChange(at, before, row[active]),)
        if row[valid] == "true":
            summary.valid_points += 1
            if sense * float(row[objective]) < least:
                least = sense * float(row[objective])
                summary.best = {name: _read_column(name, [text])[0].item() for name, text in zip(names, row, strict=True)}
        before = now
        yield row
