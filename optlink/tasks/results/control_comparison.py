"""The results of a control comparison and of a tuning, as data and JSON."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np
from pydantic import AfterValidator

from optlink.problem.document import Column, Columns, Document, Never, Number, Source
from optlink.problem.file import ProblemFile
from optlink.tasks.results.clearance import ClearanceSimulation

Costs = Annotated[Column, AfterValidator(lambda costs: np.where(np.isnan(costs), np.inf, costs))]
"""A column; null where a cost is infinite."""


@dataclass(frozen=True)
class Trials:
    """One kind of control from several starts: rms and peak of the error [m, rad], correction, torque; arrays (starts,).

    `correction` [rad] and `torque` [N m] are root mean squares of the control effort. A run that stalled has no figures: NaN.
    """

    shown: ClassVar[Mapping[str, Source]] = {
        name: name for name in ("rms", "peak", "correction", "torque", "finished", "mean", "scatter")
    }

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


@dataclass(frozen=True, repr=False)
class Comparison(Document):
    """Comparison of control: `trials` by kind of control, from initial crank angles `starts` (starts,) [rad].

    `examples`: the simulations from the first start, with the columns that charts show.
    """

    kind = "control comparison"
    shown: ClassVar[Mapping[str, Source]] = {"starts_rad": "starts", "trials": "trials"}

    problem: ProblemFile
    trials: dict[str, Trials]
    starts: Column
    seed: int
    revolutions: int
    examples: dict[str, ClearanceSimulation]
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


@dataclass(frozen=True, repr=False)
class Tuning(Document):
    """Tuning of controller parameters: `tried` values by name (evaluations,), their costs and scatters [m, rad].

    `problem`: the problem with the `best` values, which are empty if its own were better. The cost is the mean rms
    error over the starts; costs that differ by less than the scatter are equivalent. It is infinite if a run
    stalled, or if the mean exceeds the best so far: the runs then stop early. `check`: figures from as many starts that the
    search did not use (those of the next seed), with the parameters of the problem and with the best ones; None if its own are
    the best.
    """

    kind = "tuning"
    shown: ClassVar[Mapping[str, Source]] = {"other_starts?": "other_starts"}

    problem: ProblemFile
    best: dict[str, str | float]
    cost: Never
    scatter: Number
    before: Never
    tried: Columns
    costs: Costs
    scatters: Column
    control: str
    starts: int
    seed: int
    revolutions: int
    unit: str
    check: tuple[Trials, Trials] | None

    @property
    def other_starts(self) -> dict[str, float] | None:
        """Means and scatters of `check` (SI): of the parameters of the problem, and of the best ones."""
        if self.check is None:
            return None
        before, best = self.check
        return {"before": before.mean, "before_scatter": before.scatter, "cost": best.mean, "scatter": best.scatter}

    @property
    def finished(self) -> bool:
        """Whether the runs of some parameter set finished."""
        return math.isfinite(self.cost)

    @property
    def status(self) -> str:
        """Whether the runs of some parameter set finished, in a word."""
        return "finished" if self.finished else "stalled"
