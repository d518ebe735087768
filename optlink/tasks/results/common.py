"""Common interface of search results: validity, optimality checks, JSON document."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, Protocol, Self, TypeVar

from optlink.errors import Status
from optlink.problem.document import Document, Number, Result, Source
from optlink.problem.file import ProblemFile
from optlink.solvers.solution import FEASIBLE, SAME_OBJECTIVE, STATIONARY, LimitState, Relaxation, Solution
from optlink.tasks.results.certificate import Certificate, message
from optlink.validation.check import MEASURED, MEASURED_ROBUST, Check, Validation

ROUNDED = 2e-7
"""Root mean square of the deviations, as a share of the size of the curve or in rad, below which a design is as good as exact:
targets with six decimals leave that much."""
OPTIMALITY_CHECK, LIMITS_CHECK = "optimality (KKT residual)", "all limits met (scaled)"  # names of checks
INEXACT = frozenset({OPTIMALITY_CHECK, LIMITS_CHECK, MEASURED, MEASURED_ROBUST})
"""Checks that a design may fail because its search ended too early: it is refined and measured again."""


@dataclass(frozen=True)
class Optimum:
    """A distinct optimum of a multistart search: design [SI], objective, number of converged searches, assembly mode."""

    design: Mapping[str, Number]
    objective: Number
    count: int
    assembly: str = ""


@dataclass(frozen=True)
class RejectedDesign:
    """A better optimum that was not accepted: the problem with its assembly modes, design and objective [SI], failed checks."""

    shown: ClassVar[Mapping[str, Source]] = {
        "design": lambda rejected: rejected.problem.model.displayed(rejected.design),
        **{name: name for name in ("objective", "assembly", "failed")},
    }

    problem: ProblemFile
    design: Mapping[str, Number]
    objective: Number
    failed: tuple[Check, ...]

    @property
    def assembly(self) -> Any:
        """Assembly modes, in the words of the problem file."""
        return self.problem.raw["mechanism"].get("assembly", "left")

    @property
    def note(self) -> str:
        """The note for the user: objective, design, and the first failed check."""
        model, first = self.problem.model, self.failed[0]
        objective = model.shown_objective(self.objective)
        sizes = [(name, *model.display(name)) for name in model.free]
        design = ", ".join(f"{name} {self.design[name] * size:z.4f} {shown}".rstrip() for name, size, shown in sizes)
        more = f", and {len(self.failed) - 1} more" if len(self.failed) > 1 else ""
        return (
            f"a better optimum was found but not accepted: {objective.value:.4g} {objective.unit}".rstrip()
            + f' ({design}; assembly {self.assembly}); it fails the check "{first.name}" '
            + f"({first.value:.4g} {first.unit}".rstrip()
            + f", required {first.limit}){more}"
        )


def best_rejected(designs: Iterable[RejectedDesign | None], objective: float) -> RejectedDesign | None:
    """Return the best of some rejected designs if it is better than the objective of the accepted one, else None."""
    better = [one for one in designs if one is not None and one.objective < objective * (1.0 - SAME_OBJECTIVE)]
    return min(better, key=lambda one: one.objective, default=None)


def verified(status: Status, validation: Validation) -> bool:
    """Return whether a design passes its validation, and is optimal unless its status excludes that."""
    return status in (Status.OPTIMAL, Status.FEASIBLE, Status.ROUNDED, Status.NOT_SEARCHED) and validation.valid


def inexact(status: Status, validation: Validation) -> bool:
    """Return whether a design fails only by figures that a refinement can make exact."""
    return status in (Status.OPTIMAL, Status.STALLED) and bool(validation.failed) and INEXACT.issuperset(validation.failed)


def with_optimality(checked: Validation, solution: Solution) -> Validation:
    """Return a validation with the checks of feasibility and stationarity by the NLP, without mere consequences of failed ones.

    A design that breaks a limit is no optimum; one that fails a measured check need not be told that it breaks a limit.
    """
    met = solution.violation <= FEASIBLE
    feasible = Check(LIMITS_CHECK, met, solution.violation, f"<= {FEASIBLE:.0e}", "")
    if not met:
        return checked if checked.failed else checked.with_checks([feasible])
    return checked.with_checks([feasible, _stationary(solution)])


def _stationary(solution: Solution) -> Check:
    """Check the first-order condition; if the residual alone does not decide, `limit` names the criterion."""
    passed, small = solution.status is Status.OPTIMAL, solution.kkt <= STATIONARY
    limit = f"<= {STATIONARY:.0e}"
    if passed and not small:
        limit = "no measurable improvement"
    if small and not passed:
        limit = "of the design searched for"
    return Check(OPTIMALITY_CHECK, passed, solution.kkt, limit, "")


class Design(Protocol):
    """What every single design has, such as the best one of a `DesignResult`."""

    @property
    def status(self) -> Status:
        """How its search ended."""

    @property
    def valid(self) -> bool:
        """Whether it is validated and, if it was searched, optimal."""

    @property
    def objective(self) -> float:
        """Its objective [SI]."""

    @property
    def limits(self) -> tuple[LimitState, ...]:
        """All its bounds and limits [SI]; none without a search."""

    @property
    def validation(self) -> Validation:
        """Its independent checks."""


class DesignResult(Result, Protocol):
    """What every kind of design problem has in its result, with what every `Result` has.

    A type checker knows these members of what `solve` and `validate` return; `assert isinstance(result, optlink.SynthesisResult)`
    tells it the kind of the problem, and with it the others.
    """

    @property
    def status(self) -> Status:
        """How the search ended."""

    @property
    def message(self) -> str:
        """How it ended, in words."""

    @property
    def valid(self) -> bool:
        """Whether there is a design, validated and, if it was searched, optimal."""

    @property
    def best(self) -> Design | None:
        """The best design, else the nearest one that is not valid; None if there is none. A result of one design is its best."""

    @property
    def design(self) -> Mapping[str, float]:
        """Quantities of the best design [SI] by the names that arguments `design` have too, empty without one; see `machine`."""

    @property
    def objective(self) -> float:
        """Its objective [SI]."""

    @property
    def limits(self) -> tuple[LimitState, ...]:
        """All its bounds and limits [SI]; none without a search."""

    @property
    def validation(self) -> Validation:
        """Its independent checks."""

    @property
    def solution(self) -> Solution | None:
        """The optimum of the solver; None without a search."""

    @property
    def backends(self) -> Mapping[str, Solution]:
        """The optimum of each of several solvers by its name."""

    @property
    def definite(self) -> ProblemFile:
        """The problem with the assembly modes of the design."""

    @property
    def machine(self) -> ProblemFile | None:
        """The problem with all dimensions fixed, for `analyze`, `simulate` and pictures; None without a design."""

    @property
    def conflict(self) -> tuple[Relaxation, ...]:
        """Limits that exclude each other, each relaxed as far as it must be; none if there is a design."""

    @property
    def certificate(self) -> Certificate | None:
        """Proof that it is the global optimum, or None."""

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes for the user."""

    @property
    def backend(self) -> str:
        """Solver of the search, "both", or "none"."""

    @property
    def starts(self) -> int:
        """Number of starting points."""

    @property
    def seed(self) -> int | None:
        """Seed of the random ones."""

    @property
    def seconds(self) -> Mapping[str, float]:
        """Wall time by stage [s]."""

    @property
    def interrupted(self) -> bool:
        """Whether Ctrl-C ended the search."""

    def with_checks(self, checks: Sequence[Check]) -> Self:
        """Return the result with further checks."""


def of_solution(name: str) -> Callable[[Any], Any]:
    """Return the source of a figure of the solution, which a design that was not searched lacks."""
    return lambda result: getattr(result.solution, name, None)


SEARCHED: Mapping[str, Source] = {"message": "message", "notes": "notes"}
"""Computed entries of the document of every search."""
FIGURES = ("status", "objective", "iterations", "kkt", "violation", "message")
FOUND: Mapping[str, Source] = {
    "rejected?": "rejected",
    "backends?": lambda result: (
        {
            name: {"design": result.displayed(one.design), **{figure: getattr(one, figure) for figure in FIGURES}}
            for name, one in result.backends.items()
        }
        or None
    ),
}
"""Computed entries of designs that are not the best one."""


@dataclass(frozen=True, eq=False, repr=False)
class SingleResult(Document):
    """Base class for the results of a kind of problem from outside the package that has one design [SI]; see `DesignResult`."""

    shown: ClassVar[Mapping[str, Source]] = {**SEARCHED, "validation": "validation.checks"}

    problem: ProblemFile
    status: Status
    backend: str
    design: dict[str, Number]
    objective: Number
    validation: Validation
    seconds: dict[str, float]
    seed: int | None = None
    starts: int = 0
    solution: Solution | None = None
    backends: dict[str, Solution] = field(default_factory=dict)
    conflict: tuple[Relaxation, ...] = ()
    interrupted: bool = False
    certificate: Certificate | None = None

    @property
    def valid(self) -> bool:
        """Whether the design is validated, and optimal if it was searched."""
        return verified(self.status, self.validation)

    @property
    def best(self) -> Self:
        """The result itself."""
        return self

    @property
    def message(self) -> str:
        """Description of how the search ended."""
        return message(self.status, self.certificate, "")

    @property
    def limits(self) -> tuple[LimitState, ...]:
        """All bounds and limits of the design, in SI; none without a search."""
        return () if self.solution is None else self.solution.limits

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes for the user; none."""
        return ()

    @property
    def machine(self) -> ProblemFile | None:
        """The problem with all dimensions fixed; None without one."""
        return None

    @property
    def definite(self) -> ProblemFile:
        """The problem with the assembly modes of the design."""
        return self.problem

    def with_checks(self, checks: Sequence[Check]) -> Self:
        """Return the result with further checks."""
        return replace(self, validation=self.validation.with_checks(checks))


# Statistical evidence of a multistart search: how often the best optimum was reached, and how likely a better one was missed.

Item = TypeVar("Item")


def tally(items: Iterable[tuple[Item, int]], alike: Callable[[Item, Item], bool]) -> list[tuple[Item, int]]:
    """Return distinct items in order, each with the sum of the counts of all items like it."""
    distinct: list[tuple[Item, int]] = []
    for item, count in items:
        for k, (first, total) in enumerate(distinct):
            if alike(first, item):
                distinct[k] = first, total + count
                break
        else:
            distinct.append((item, count))
    return distinct


INCOMPLETE = "search incomplete"
"""Beginning of the note on a search that may have missed the best design."""


@dataclass(frozen=True)
class Evidence:
    """Statistical evidence of a multistart search about optima that it did not find.

    `starts`: local searches that ended at an optimum; `optima`: distinct ones; `hits`: searches that reached the best one.
    `unseen`: estimated probability that the next start ends at an optimum not found before.
    `missed`: estimated probability that a better optimum exists than the best one found. `counts`: searches that reached each
    optimum, the best one first.
    """

    starts: int
    optima: int
    hits: int
    unseen: float
    missed: float
    counts: tuple[int, ...] = ()

    @property
    def chance(self) -> str:
        """The estimate `missed` as a sentence."""
        return f"chance that a better optimum was missed: {percent(self.missed)} (estimate)"


def percent(share: float) -> str:
    """Format a share of 0 ... 1 in percent; only exact values are shown as 0 % or 100 %."""
    if share in (0.0, 1.0):
        return f"{100.0 * share:g} %"
    return "below 0.1 %" if share < 1e-3 else f"{min(100.0 * share, 99.9):.2g} %" if share < 0.995 else "over 99 %"


def evidence(counts: Sequence[int]) -> Evidence:
    """Estimate the optima that a multistart search missed from the hits (none zero) of every distinct optimum, the best first.

    Both estimates assume independent random starts, and `missed` also that the size of an optimum's region of attraction
    says nothing about its objective. Each is the larger one of two: that of Good and Chao counts the optima found once and
    twice, that of Boender and Rinnooy Kan takes all divisions of the starts among the optima as equally likely beforehand. So
    a search that reached one optimum n times is not certain: `missed` is 1 / (n - 1). Both are 1 where there is no optimum, or
    hardly more starts than optima.

    References
    ----------
    I. J. Good, The population frequencies of species and the estimation of population parameters, Biometrika 40 (1953)
    237-264, eq. 9: unseen = f1 / n. A. Chao, Nonparametric estimation of the number of classes in a population, Scand. J.
    Statistics 11 (1984) 265-270, in its bias-corrected form: f1 (f1 - 1) / (2 (f2 + 1)) classes are unseen at least.
    C. G. E. Boender and A. H. G. Rinnooy Kan, Bayesian stopping rules for multistart global optimization methods, Math.
    Programming 37 (1987) 59-80: unseen = w (w + 1) / (n (n - 1)); the mean of 1 - w / k over their distribution of the
    number k of optima is w / (n - 1).
    """
    n, w = sum(counts), len(counts)
    hits = counts[0] if w else 0
    if w == 0 or n <= w + 1:
        return Evidence(n, w, hits, 1.0, 1.0, tuple(counts))
    once, twice = (sum(count == times for count in counts) for times in (1, 2))
    absent = once * (once - 1) / (2.0 * (twice + 1))
    unseen = max(once / n, w * (w + 1) / (n * (n - 1)))
    return Evidence(n, w, hits, min(1.0, unseen), min(1.0, max(w / (n - 1), absent / (w + absent))), tuple(counts))
