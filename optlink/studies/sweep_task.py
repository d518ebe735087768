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

from optlink.errors import InputError
from optlink.problem.file import ProblemFile
from optlink.studies.grid import Grid
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
