"""What a sweep does with its grid: the division into chunks, and the task that analyses designs as they are.

A chunk depends on its number alone, so the rows are the same whatever the engine, the number of workers and the order.
"""

from __future__ import annotations

import csv
import hashlib
import io
import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from functools import cached_property
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from optlink.batch import analyze_batch
from optlink.design.files import ProblemFile, read
from optlink.design.quantity import nearest
from optlink.errors import Fault, InputError
from optlink.studies.axes import Axis, Grid
from optlink.units import factor
from optlink.version import VERSION

Array = NDArray[np.float64]
MANY = 2000  # designs of a chunk that is analysed
FIGURES: dict[str, Callable[[Array], Array]] = {
    "min": lambda values: np.min(values, axis=1),
    "max": lambda values: np.max(values, axis=1),
    "rms": lambda values: np.sqrt(np.mean(np.square(values), axis=1)),
}


def figure(value: float) -> str:
    """A number for a table: every digit, nothing where it is not finite."""
    return repr(float(value)) if math.isfinite(value) else ""


def _tuples(value: Any) -> Any:
    return tuple(_tuples(item) for item in value) if isinstance(value, list) else value


@dataclass(frozen=True)
class Sweeping(ABC):
    """What every chunk needs to know: the problem as written, the grid, and how many points a chunk has."""

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
        """The part that comes from the problem."""
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
        """Points of a chunk."""
        return range(index * self.chunk, min((index + 1) * self.chunk, self.grid.count))

    def size(self, index: int) -> int:
        """Number of points of a chunk."""
        return len(self.span(index))

    def state(self) -> dict[str, Any]:
        """Everything stated, fit for JSON."""
        axes = [[axis.key, axis.unit, list(axis.values)] for axis in self.grid.axes]
        return {**self.__getstate__(), "folder": str(self.folder), "grid": axes}

    @classmethod
    def revived(cls, state: dict[str, Any]) -> Self:
        """The task that such a state is of."""
        grid = Grid(tuple(Axis(key, unit, tuple(values)) for key, unit, values in state["grid"]))
        rest = {name: _tuples(value) for name, value in state.items() if name != "raw"}
        return cls(**{**rest, "raw": state["raw"], "folder": Path(state["folder"]), "grid": grid})

    def __getstate__(self) -> dict[str, Any]:
        return {field.name: getattr(self, field.name) for field in fields(self)}  # not what was built from them

    @cached_property
    def problem(self) -> ProblemFile:
        """The problem, read where the chunk is done."""
        if self.version != VERSION:
            message = f"this worker runs optlink {VERSION}, the study optlink {self.version}"
            raise InputError(Fault(message, "Install one version everywhere", self.file))
        problem = read(self.raw, self.name, self.file, self.folder)
        if problem.hash != self.hash:
            raise InputError(Fault("a file that the problem reads has changed meanwhile", "Begin a new study", self.file))
        return problem

    @cached_property
    def mark(self) -> str:
        """Tells tasks apart."""
        text = repr([type(self).__name__, *(getattr(self, field.name) for field in fields(self))])
        return hashlib.sha256(text.encode()).hexdigest()

    @property
    @abstractmethod
    def columns(self) -> list[str]:
        """Names of the columns."""

    @abstractmethod
    def lines(self, index: int) -> list[list[str]]:
        """Rows of a chunk."""

    def __call__(self, index: int) -> str:
        """A chunk as lines of CSV."""
        if self.mark not in _kept:
            _kept.clear()
            _kept[self.mark] = self
        text = io.StringIO()
        csv.writer(text, lineterminator="\n").writerows(_kept[self.mark].lines(index))
        return text.getvalue()


_kept: dict[str, Sweeping] = {}
"""The task that this process is at: what it has built is used for every chunk, though each may come with a copy of the task."""


@dataclass(frozen=True)
class Analysing(Sweeping):
    """Designs as they are: least, largest and rms value over the revolution of columns of the analysis.

    `quantities`: name of the mechanism's quantity of every axis; `design` [SI] of what is free and not varied.
    """

    quantities: tuple[str, ...]
    asked: tuple[str, ...]
    points: int
    design: tuple[tuple[str, float], ...]

    @property
    def columns(self) -> list[str]:
        """The axes, then three figures of every column."""
        return [*(axis.column for axis in self.grid.axes), *(f"{name}.{kind}" for name in self.asked for kind in FIGURES)]

    def lines(self, index: int) -> list[list[str]]:
        """Rows of a chunk, at the speed of the batch analysis."""
        values = [self.grid.values(point) for point in self.span(index)]
        table = np.array(values).T
        known = self.problem.model.mechanism.quantities
        designs = {name: np.full(len(values), value) for name, value in self.design}
        for name, axis, column in zip(self.quantities, self.grid.axes, table, strict=True):
            designs[name] = column * factor(axis.unit, known[name].kind)
        found = analyze_batch(self.problem, designs, self.asked, self.points)
        with np.errstate(all="ignore"):
            figures = [of(found[name]) for name in self.asked for of in FIGURES.values()]
        return [
            [*map(repr, own), *(figure(column[i]) for column in figures)] for i, own in enumerate(values)
        ]  # repr: the axes' own digits


def quantity_of(problem: ProblemFile, axis: Axis) -> str:
    """Name of the mechanism's quantity that an axis varies: `mechanism.frame`, `mechanism.links.rod.length` or `rod.length`.

    Raises
    ------
    InputError
        when it varies something else: that changes what is asked, not what is analysed.
    """
    known = problem.model.mechanism.quantities
    name = axis.key.removeprefix("mechanism.")
    for start in ("links.", "ground.", "guides.", "points."):
        name = name.removeprefix(start)
    name = name.replace(".points.", ".")
    if name not in known:
        message = "only sizes of the mechanism can be varied without a new optimisation"
        raise InputError(Fault(message, nearest(name, known), problem.file, f"--vary {axis.key}"))
    return name
