"""Common part of sweep tasks: division of the grid into chunks.

A chunk depends on its number only, so the rows are identical for any engine, number of workers and order.
"""

import csv
import hashlib
import io
import math
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields
from functools import cached_property
from typing import Any, ClassVar, NamedTuple

from optlink.errors import InputError, Status
from optlink.problem.file import ProblemFile
from optlink.problem.quantity import Quantity
from optlink.studies.grid import Grid, column
from optlink.tasks.run import design_task
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
        text = repr([type(self).__name__, *(getattr(self, item.name) for item in fields(self))])
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

    def row(self, point: int, figures: Iterable[float], *outcome: str) -> list[str]:
        """Return a row: the values of the axes in their own digits, the figures, and the outcome."""
        return [*map(repr, self.grid.values(point)), *map(number_text, figures), *outcome]

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


@dataclass(frozen=True)
class FoundOptimum:
    """Contents of a row: `design` [SI] by design variable, names of `failed` checks and of `active` limits, how it was found."""

    design: Mapping[str, float]
    objective: float
    status: Status
    valid: bool
    failed: Iterable[str]
    active: Iterable[str]
    method: str


@dataclass(frozen=True)
class OptimumTask(SweepTask):
    """A task whose rows are optima."""

    mode = OPTIMISE

    backend: str

    @property
    def options(self) -> dict[str, Any]:
        """The back end."""
        return {"backend": self.backend}

    @cached_property
    def template(self) -> ProblemFile:
        """The problem at the first point, whose design variables are those of all points."""
        return self.problem.override(self.grid.changes(0))

    @cached_property
    def free(self) -> dict[str, Quantity]:
        """Design variables."""
        model = self.template.model
        return {name: model.quantities[name] for name in model.free}

    @property
    def columns(self) -> list[str]:
        """The axes, the design variables and the objective in display units, and the outcome."""
        free = [f"{name}_{quantity.display[1]}" for name, quantity in self.free.items()]
        return [*(axis.column for axis in self.grid.axes), *free, self.objective_column, *OUTCOME]

    @property
    def objective_column(self) -> str:
        """Name of the column of the objective."""
        return column("objective", self.template.model.shown_objective(0.0).unit)

    def shown(self, objective: float) -> float:
        """Return the value of the column for a minimised value [SI]."""
        return self.template.model.shown_objective(objective).value

    @abstractmethod
    def near(self, point: int, file: ProblemFile, design: Mapping[str, float]) -> Any:
        """Return the result of a search of a point from a design [SI]."""

    @abstractmethod
    def result_row(self, point: int, result: Any, how: str) -> list[str]:
        """Return the row of a result."""

    def from_known(self, point: int, design: Mapping[str, float]) -> list[str] | None:
        """Return the row of the optimum near a design [SI], or of the design itself; None if it is not valid at the point."""
        file = self.problem.override(self.grid.changes(point))
        known = design_task(file).validate(file, design)
        if not known.valid:
            return None
        near = self.near(point, file, design)
        return self.result_row(point, near if near.valid else known, FROM_KNOWN)

    def optimum(self, point: int, outcome: FoundOptimum) -> list[str]:
        """Return the row of an optimum; design and objective are empty unless the search is optimal or stalled."""
        usable = outcome.valid or outcome.status in (Status.OPTIMAL, Status.STALLED)
        sizes = [outcome.design.get(name, math.nan) / q.si_per_unit for name, q in self.free.items()]
        figures = [value if usable else math.nan for value in (*sizes, self.shown(outcome.objective))]
        words = (
            outcome.status.value,
            str(outcome.valid).lower(),
            "; ".join(outcome.failed),
            "; ".join(outcome.active),
            outcome.method,
        )
        return self.row(point, figures, *words)
