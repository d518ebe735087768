"""Robust designs: minimise the largest error plus k standard deviations, or plus the worst case.

`optlink solve` does this for a robust problem file; here the tolerances may come from the command line, and the
nominal optimum is found as well.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

from optlink.errors import InputError
from optlink.problem.document import Number, Source
from optlink.problem.file import ProblemFile
from optlink.problem.robust import MAX_SIGMAS, WORST
from optlink.problem.tolerances import NORMAL
from optlink.studies.tolerance.options import read_tolerances
from optlink.tasks.design import solve, validate
from optlink.tasks.protocol import completed
from optlink.tasks.results.design import SynthesisResult
from optlink.tasks.run import solve as solve_nominal
from optlink.units import DISPLAYED

YIELD = "yield"
STEPS, LIMIT_TOLERANCE = 12, 1e-5  # of the search for the largest number of standard deviations, and its relative accuracy
MIN_SLOPE = 1e-12  # [SI] per standard deviation; least slope of the secants


@dataclass(frozen=True)
class RobustDesign:
    """A robust design, `result`, and the nominal optimum, `nominal` [SI]; `before` [SI]: objective of the latter.

    `sigmas`: number of standard deviations, None: the worst case; `by_yield`: the yield was maximised instead.
    """

    shown: ClassVar[Mapping[str, Source]] = {
        "counted": "counted",
        "status": "result.status",
        "valid": "result.valid",
        "kkt": lambda robust: getattr(robust.result.solution, "kkt", None),
        "design_SI": "result.design",
        "nominal_design_SI": "nominal",
        "largest_SI": "result.objective",
        "largest_of_the_nominal_design_SI": "before",
        "failed_checks?": lambda robust: robust.result.validation.failed or None,
    }

    result: SynthesisResult
    nominal: dict[str, Number]
    sigmas: float | None
    before: float
    by_yield: bool = False

    @property
    def counted(self) -> str:
        """Name of the term added to the error, or "yield" if it was maximised."""
        if self.by_yield:
            return YIELD
        return "the worst case" if self.sigmas is None else f"{self.sigmas:.4g} standard deviations"

    @property
    def free(self) -> dict[str, float]:
        """Design variables [SI]."""
        return {name: self.result.design[name] for name in self.result.problem.model.free}


def robust(problem: ProblemFile, tolerances: Sequence[str], sigmas: float | None = 3.0, *, shape: str = NORMAL) -> RobustDesign:
    """Minimise the largest error, including its scatter."""
    if sigmas is not None and not 0.0 <= sigmas <= MAX_SIGMAS:
        remedy = f"Give 0 to {MAX_SIGMAS:g} standard deviations, or worst, margin or yield"
        raise InputError("out of range", remedy, key="--robust", value=sigmas)
    return RobustSearch(problem, tolerances, shape).least(sigmas)


def most_reliable(problem: ProblemFile, tolerances: Sequence[str], limit: float, *, shape: str = NORMAL) -> RobustDesign:
    """Return the design that keeps a limit of its error with the largest number of standard deviations.

    Its number of standard deviations is that for which the minimised value equals the limit.
    """
    redesign = RobustSearch(problem, tolerances, shape)
    before = redesign.least(0.0)
    if before.result.objective > limit:
        factor, unit = DISPLAYED[problem.spec.unit]
        least, stated = (f"{factor * value:.4g} {unit}".strip() for value in (before.result.objective, limit))
        message = f"no design meets the limit, even without tolerances: the smallest largest error found is {least}"
        raise InputError(message, f"Give more than {least}", problem.file, "--limit", stated)
    current, sigmas = redesign.least(1.0, before.free), 1.0
    for _ in range(STEPS):  # secant method: the minimum is nearly linear in them
        rise = (current.result.objective - before.result.objective) / (sigmas - (before.sigmas or 0.0))
        proposed = min(max(sigmas + (limit - current.result.objective) / max(rise, MIN_SLOPE), 0.0), MAX_SIGMAS)
        if abs(current.result.objective - limit) <= LIMIT_TOLERANCE * limit or proposed == sigmas:
            break
        before, current, sigmas = current, redesign.least(proposed, current.free), proposed
    return current


def check_targets(problem: ProblemFile) -> None:
    """Check that the errors of one requirement are all that is minimised."""
    if not problem.model.parts or problem.spec.composed:
        message = "robust design minimises the error of one requirement alone, which this problem does not have"
        raise InputError(message, "Analyse its designs without --robust", problem.file, "--robust")


class RobustSearch:
    """Search of robust designs of one problem from its nominal optimum, `nominal` [SI]; `problem`: with its tolerances."""

    def __init__(self, problem: ProblemFile, tolerances: Sequence[str], shape: str) -> None:
        check_targets(problem)
        entries = {name: tolerance.raw for name, tolerance in read_tolerances(problem, tolerances, shape).items()}
        first: Any = completed(solve_nominal(problem.override({"requirement.robust": None})))
        if not first.valid:
            raise InputError("no valid design was found to start from", "See `optlink solve`", problem.file)
        self.nominal = first.design
        try:
            self.problem = first.definite.override({"requirement.measure": "max", "tolerances": entries})
        except InputError as error:
            if not tolerances:
                raise
            keys = [(fault.key or "").replace("tolerances.", "--tolerance ", 1) for fault in error.faults]
            raise InputError([replace(fault, key=key) for fault, key in zip(error.faults, keys, strict=True)]) from None

    def least(self, sigmas: float | None, start: Mapping[str, float] | None = None) -> RobustDesign:
        """Minimise the largest error including its scatter."""
        problem = self.problem.override({"requirement.robust": WORST if sigmas is None else f"{sigmas!r} sigma"})
        result = completed(solve(problem, begin=self.nominal if start is None else start))
        return RobustDesign(result, dict(self.nominal), sigmas, validate(problem, self.nominal).objective)
