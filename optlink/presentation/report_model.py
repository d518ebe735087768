"""Model of a report or drawing: a problem with its result and the resulting machine over its cycle."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias, cast

from optlink.errors import InputError, Status
from optlink.presentation.format import causes, why_invalid
from optlink.presentation.scene import Region, regions_of
from optlink.problem.file import ProblemFile
from optlink.tasks.analyze import Analysis, analyze
from optlink.tasks.run import solve, validate

if TYPE_CHECKING:
    from optlink.studies.sensitivity import Sensitivities
    from optlink.tasks.results.common import DesignResult
    from optlink.tasks.results.design import SynthesisResult

Outcome: TypeAlias = "SynthesisResult | Analysis"
"""What is stored, and shown in motion; an extension has results of its own."""


@dataclass(frozen=True, eq=False)
class ReportModel:
    """A problem with its result.

    `cycle` is the analysis of the resulting machine over its whole motion from the start of its task; it is None if the machine
    cannot be assembled, with the reason in `unmoved`. `notes` are for the reader of a page. `effects` are the sensitivities of
    the optimum, if they were requested.
    """

    problem: ProblemFile
    result: DesignResult | Analysis
    cycle: Analysis | None
    unmoved: str = ""
    notes: tuple[str, ...] = ()
    effects: Sensitivities | None = None

    @property
    def valid(self) -> bool:
        """Whether the design is valid, or the analysis sound."""
        return self.result.valid

    @property
    def verdict(self) -> str:
        """Whether the design is valid, and which checks failed; of an analysis its status."""
        outcome = self.result
        if isinstance(outcome, Analysis):
            return f"{outcome.status[0].upper()}{outcome.status[1:]}"
        if self.valid:
            fit = getattr(getattr(outcome, "best", None), "fit", None)
            return f"Valid, {fit.text}" if fit is not None and fit.grade == "poor" else "Valid: every check passed"
        checks = outcome.validation.checks
        if outcome.status is Status.INFEASIBLE:
            named = [] if getattr(outcome, "refuted", "") else causes(checks)[:1]
            return f"No feasible design found{''.join(f': {cause}' for cause in named)}"
        return f"Not valid: {why_invalid(checks, outcome.status.value)}"

    @property
    def objective(self) -> float:
        """Value of the objective [SI]; NaN for an analysis."""
        return math.nan if isinstance(self.result, Analysis) else self.result.objective

    @property
    def regions(self) -> tuple[Region, ...]:
        """Regions that points must stay in or out of; those that the design violates are marked."""
        validation = getattr(getattr(self.result, "best", None), "validation", None)
        return regions_of(self.problem, getattr(validation, "checks", ()))

    @property
    def forces(self) -> bool:
        """Whether the machine has masses or loads."""
        return self.cycle is not None and bool(self.cycle.machine.inertias or self.cycle.machine.loads)


def solve_or_validate(
    problem: ProblemFile,
    backend: str = "ipopt",
    starts: int | None = None,
    seed: int = 0,
    design: Mapping[str, float] | None = None,
) -> DesignResult | Analysis:
    """Solve a problem, validate a given design of it, or analyse it.

    An analysis or balancing problem is analysed. Any other problem is solved, or validated if a design is given or all is fixed.

    Parameters
    ----------
    problem : ProblemFile
    backend : str, optional
        Solver to use.
    starts : int or None, optional
        Number of starting points; None for the default of the problem kind.
    seed : int, optional
        Seed of the starting points.
    design : mapping of str to float or None [m, rad], optional
        Design to validate or analyse; None to search.

    Raises
    ------
    InputError
        If `solve`, `validate` or `analyze` raises it.
    """
    if problem.task in ("analysis", "balance"):
        return analyze(problem, design=design)
    if design is None and problem.model.free:
        return cast(Outcome, solve(problem, backend, starts, seed))
    return cast(Outcome, validate(problem, design or {}))


def report_model_of(outcome: DesignResult | Analysis) -> ReportModel:
    """Return the report model of a result, found just now or read from a file.

    Parameters
    ----------
    outcome : DesignResult or Analysis
    """
    problem = outcome.problem
    if isinstance(outcome, Analysis):
        balanced = "this is the machine before balancing: `solve --out DIR` and `report DIR` show the balanced one"
        return ReportModel(problem, outcome, outcome, notes=(balanced,) if problem.task == "balance" else ())
    try:
        machine = outcome.machine
        cycle = None if machine is None else analyze(machine)
    except InputError as error:
        return ReportModel(problem, outcome, None, error.faults[0].message)
    exact = getattr(outcome, "exact_solutions", None)
    missing = "none of the exact solutions is usable" if exact and exact.solutions else "no linkage was found"
    return ReportModel(problem, outcome, cycle, "" if cycle else missing)
