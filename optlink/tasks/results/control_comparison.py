"""The results of a control comparison and of a tuning, as data and JSON."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Literal, Self

import numpy as np
from annotated_types import MinLen
from pydantic import Field, model_validator

from optlink.linkage.vector2d import Array
from optlink.problem.base_model import Column, Columns, Number, Record, Recorded, ResultRecord, absent, check_length
from optlink.problem.file import ProblemFile
from optlink.tasks.results.clearance import ClearanceSimulation


@dataclass(frozen=True)
class Trials:
    """One kind of control from several starts: rms and peak of the error [m, rad], correction, torque; arrays (starts,).

    `correction` [rad] and `torque` [N m] are root mean squares of the control effort. A run that stalled has no figures: NaN.
    """

    rms: Column
    peak: Column
    correction: Column
    torque: Column
    finished: bool

    @property
    def stalled(self) -> int:
        """Number of runs that stalled."""
        return int(np.sum(np.isnan(self.rms)))

    @property
    def mean(self) -> float:
        """Mean of the rms errors; NaN if a run stalled."""
        return float(np.mean(self.rms))

    @property
    def scatter(self) -> float:
        """Standard deviation of the rms errors."""
        return float(np.std(self.rms, ddof=1)) if len(self.rms) > 1 else 0.0


class TrialsRecord(Record):
    """One kind of control from several starts."""

    rms: Column
    peak: Column
    correction: Column
    torque: Column
    finished: bool
    mean: Number
    scatter: Number


class ComparisonRecord(ResultRecord):
    """Document of a comparison of control (SI)."""

    format: Literal["optlink/control-comparison/2"] = Field(alias="schema")
    seed: int
    revolutions: int
    unit: Literal["m", "rad"]
    starts_rad: Annotated[Column, "starts"]
    trials: Annotated[dict[str, TrialsRecord], MinLen(1)]

    @model_validator(mode="after")
    def _check_lengths(self) -> Self:
        for name, trials in self.trials.items():
            for key in ("rms", "peak", "correction", "torque"):
                check_length(getattr(trials, key), len(self.starts_rad), f"trials.{name}.{key}")
        return self


@dataclass(frozen=True, repr=False)
class Comparison(Recorded):
    """Comparison of control: `trials` by kind of control, from initial crank angles `starts` (starts,) [rad].

    `examples`: the simulations from the first start, for figures.
    """

    record = ComparisonRecord

    problem: ProblemFile
    trials: Mapping[str, Trials]
    starts: Array
    seed: int
    revolutions: int
    examples: Mapping[str, ClearanceSimulation]
    unit: str

    @property
    def finished(self) -> bool:
        """Whether every run finished."""
        return all(trials.finished for trials in self.trials.values())

    @property
    def status(self) -> str:
        """Whether every run finished, in a word."""
        return "finished" if self.finished else "stalled"

    def gain(self, kind: str) -> float:
        """Return the fraction of the uncompensated error (mean over the starts) that a kind of control removes."""
        return 1.0 - self.trials[kind].mean / self.trials["none"].mean


class OtherStarts(Record):
    """Mean rms error and scatter between starts that the search did not use: parameters of the problem, and best ones (SI)."""

    before: Annotated[Number, lambda check: check[0].mean]
    before_scatter: Annotated[Number, lambda check: check[0].scatter]
    cost: Annotated[Number, lambda check: check[1].mean]
    scatter: Annotated[Number, lambda check: check[1].scatter]


class TuningRecord(ResultRecord):
    """Document of a tuning (SI)."""

    format: Literal["optlink/tuning/2"] = Field(alias="schema")
    seed: int
    control: str
    starts: int
    revolutions: int
    unit: str
    before: Number
    cost: Number
    scatter: Number
    best: dict[str, str | float]
    tried: Columns
    costs: Column
    scatters: Column
    other_starts: Annotated[OtherStarts | None, lambda result: result.check and OtherStarts.of(result.check)] = absent()


@dataclass(frozen=True, repr=False)
class Tuning(Recorded):
    """Tuning of controller parameters: `tried` values by name (evaluations,), their costs and scatters [m, rad].

    `problem`: the problem with the `best` values, which are empty if its own were better. The cost is the mean rms
    error over the starts; costs that differ by less than the scatter are equivalent. It is infinite if a run
    stalled, or if the mean exceeds the best so far: the runs then stop early. `check`: figures from as many starts that the
    search did not use (those of the next seed), with the parameters of the problem and with the best ones; None if its own are
    the best.
    """

    record = TuningRecord

    problem: ProblemFile
    best: Mapping[str, str | float]
    cost: float
    scatter: float
    before: float
    tried: Mapping[str, Array]
    costs: Array
    scatters: Array
    control: str = "inverse+pid"
    starts: int = 1
    seed: int = 0
    revolutions: int = 11
    unit: str = "m"
    check: tuple[Trials, Trials] | None = None

    @property
    def finished(self) -> bool:
        """Whether the runs of some parameter set finished."""
        return math.isfinite(self.cost)

    @property
    def status(self) -> str:
        """Whether the runs of some parameter set finished, in a word."""
        return "finished" if self.finished else "stalled"
