"""Common part of sweep tasks: division of the grid into chunks.

A chunk depends on its number only, so the rows are identical for any engine, number of workers and order.
"""

from __future__ import annotations

import csv
import hashlib
import io
import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import cached_property
from pathlib import Path
from typing import Any, Self

from optlink.errors import Fault, InputError
from optlink.problem.file import ProblemFile, read
from optlink.studies.grid import Axis, Grid
from optlink.version import VERSION


def number_text(value: float) -> str:
    """Return a number as text for a table: all digits, empty if not finite."""
    return repr(float(value)) if math.isfinite(value) else ""


def _tuples(value: Any) -> Any:
    return tuple(_tuples(item) for item in value) if isinstance(value, list) else value


@dataclass(frozen=True)
class SweepTask(ABC):
    """Common state of all chunks: the problem as written, the grid, and the number of points per chunk."""

    raw: Mapping[str, Any]
    name: str
    file: str
    folder: Path
    hash: str
    grid: Grid
    chunk: int
    version: str

    @classmethod
    def stated(cls, problem: ProblemFile) -> dict[str, Any]:
        """Return the fields that come from the problem."""
        return {
            "raw": problem.raw,
            "name": problem.name,
            "file": problem.file,
            "folder": problem.folder,
            "hash": problem.hash,
            "version": VERSION,
        }

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

    def state(self) -> dict[str, Any]:
        """Return all fields, JSON compatible."""
        axes = [[axis.key, axis.unit, list(axis.values)] for axis in self.grid.axes]
        return {**self.__getstate__(), "folder": str(self.folder), "grid": axes}

    @classmethod
    def revived(cls, state: dict[str, Any]) -> Self:
        """Return the task of such a state."""
        grid = Grid(tuple(Axis(key, unit, tuple(values)) for key, unit, values in state["grid"]))
        rest = {name: _tuples(value) for name, value in state.items() if name != "raw"}
        return cls(**{**rest, "raw": state["raw"], "folder": Path(state["folder"]), "grid": grid})

    def __getstate__(self) -> dict[str, Any]:
        return {field.name: getattr(self, field.name) for field in fields(self)}  # without cached values

    @cached_property
    def problem(self) -> ProblemFile:
        """The problem, read in the process of the chunk."""
        if self.version != VERSION:
            message = f"this worker runs optlink {VERSION}, the study optlink {self.version}"
            raise InputError(Fault(message, "Install one version everywhere", self.file))
        problem = read(self.raw, self.name, self.file, self.folder)
        if problem.hash != self.hash:
            raise InputError(Fault("a file that the problem reads has changed meanwhile", "Begin a new study", self.file))
        return problem

    @cached_property
    def mark(self) -> str:
        """Key that distinguishes tasks."""
        text = repr([type(self).__name__, *(getattr(self, field.name) for field in fields(self))])
        return hashlib.sha256(text.encode()).hexdigest()

    @property
    @abstractmethod
    def columns(self) -> list[str]:
        """Names of the table columns."""

    @abstractmethod
    def lines(self, index: int) -> list[list[str]]:
        """Return the rows of a chunk."""

    def __call__(self, index: int) -> str:
        """Return a chunk as lines of CSV."""
        if self.mark not in _kept:
            _kept.clear()
            _kept[self.mark] = self
        text = io.StringIO()
        csv.writer(text, lineterminator="\n").writerows(_kept[self.mark].lines(index))
        return text.getvalue()


_kept: dict[str, SweepTask] = {}
"""The task that this process is at: what it has built is used for every chunk, though each may come with a copy of the task."""
