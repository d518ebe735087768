"""Common interface of search results: validity, optimality checks, JSON document."""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Annotated, Any, ClassVar, Self

from optlink.errors import Status
from optlink.linkage.fourbar import LENGTHS
from optlink.problem.base_model import Contradiction, Number, Record, Recorded, ResultRecord, absent
from optlink.problem.file import ProblemFile
from optlink.problem.quantity import Quantity
from optlink.solvers.solution import FEASIBLE, STATIONARY, LimitState, Relaxation, Solution
from optlink.tasks.results.certificate import Certificate, message
from optlink.tasks.results.fit import FitRecord
from optlink.validation.check import Check, Validation

OPTIMALITY_CHECK = "optimality (KKT residual)"  # name of a check


@dataclass(frozen=True)
class Optimum:
    """A distinct optimum of a multistart search: design [SI], objective, number of converged searches, assembly mode."""

    design: Mapping[str, float]
    objective: float
    count: int
    assembly: str = ""


def shortest_link(quantities: Mapping[str, Quantity], crank: str) -> tuple[str, ...]:
    """Return a message if the bounds of a four-bar prevent full rotation of the crank: the shortest link cannot be the shortest.

    Parameters
    ----------
    quantities : mapping of str to Quantity
        The four lengths.
    crank : str
        `limits.crank` of the problem.
    """
    name = {"full rotation": "crank", "double-crank": "frame"}.get(crank)
    if name is None or name not in quantities:
        return ()
    least = quantities[name].bounds[0]
    other = min((link for link in LENGTHS if link != name), key=lambda link: quantities[link].bounds[1])
    most = quantities[other].bounds[1]
    if least <= most:
        return ()
    return (
        f"the {name}, at least {1e3 * least:.6g} mm, cannot be the shortest link, as the {other} is at most {1e3 * most:.6g} mm: "
        f'the crank cannot turn fully; shorten the {name}, or write limits.crank = "span"',
    )


def verified(status: Status, validation: Validation) -> bool:
    """Return whether a design passes its validation, and is optimal unless its status excludes that.

    Parameters
    ----------
    status : Status
    validation : Validation
    """
    return status in (Status.OPTIMAL, Status.FEASIBLE, Status.NOT_SEARCHED) and validation.valid


def optimality(solution: Solution) -> tuple[Check, ...]:
    """Return the checks of feasibility and stationarity by the NLP."""
    return (
        Check("all limits met (scaled)", solution.violation <= FEASIBLE, solution.violation, f"<= {FEASIBLE:.0e}", ""),
        _stationary(solution),
    )


def _stationary(solution: Solution) -> Check:
    """Check the first-order condition; if the residual alone does not decide, `limit` names the criterion."""
    passed, small = solution.status is Status.OPTIMAL, solution.kkt <= STATIONARY
    limit = f"<= {STATIONARY:.0e}"
    if passed and not small:
        limit = "no measurable improvement"
    if small and not passed:
        limit = "of a feasible design" if solution.violation > FEASIBLE else "of the design searched for"
    return Check(OPTIMALITY_CHECK, passed, solution.kkt, limit, "")


@dataclass(frozen=True, eq=False, repr=False)
class SingleResult(Recorded):
    """Result of a search for one design, which is its own best design.

    `design` [SI]; `objective` [SI]; `counts` and `conflict` as they apply: a search without a design has the reason instead.
    """

    incomplete: ClassVar[bool] = False
    """Whether a note states that the search may have missed the best design."""

    problem: ProblemFile
    status: Status
    backend: str
    design: dict[str, float]
    objective: float
    validation: Validation
    seconds: dict[str, float]
    seed: int | None = None
    starts: int = 0
    solution: Solution | None = None
    backends: dict[str, Solution] = field(default_factory=dict)
    optima: tuple[Optimum, ...] = ()
    conflict: tuple[Relaxation, ...] = ()
    together: tuple[Relaxation, ...] = ()
    interrupted: bool = False  # whether the search ended before its last starting point
    certificate: Certificate | None = None

    @property
    def valid(self) -> bool:
        """Whether the design is validated, and optimal if it was searched."""
        return verified(self.status, self.validation)

    @property
    def message(self) -> str:
        """Description of how the search ended."""
        return message(self.status, self.certificate, conflicting=bool(self.conflict))

    @property
    def definite(self) -> ProblemFile:
        """The problem with the assembly modes of the design."""
        return self.problem

    def complete(self, design: Mapping[str, float]) -> dict[str, float]:
        """Return every quantity [SI] for values of design variables."""
        return self.problem.model.design(design)

    def displayed(self, design: Mapping[str, float]) -> dict[str, float]:
        """Return a design [SI] in display units, which end the keys."""
        return self.problem.model.displayed(design)

    @property
    def best(self) -> Self:
        """The result itself."""
        return self

    def with_best(self, **changes: Any) -> Self:
        """Return the result with other fields of its best design."""
        return replace(self, **changes)

    def merged(self, results: Sequence[Self]) -> Self:
        """Return the result with the starts and optima of the searches of all assembly modes, its own among them.

        Parameters
        ----------
        results : sequence of SingleResult
        """
        optima = sorted((optimum for result in results for optimum in result.optima), key=lambda optimum: optimum.objective)
        return replace(
            self,
            starts=sum(result.starts for result in results),
            interrupted=any(result.interrupted for result in results),
            seconds={key: sum(result.seconds[key] for result in results) for key in self.seconds},
            optima=tuple(optima),
        )

    def with_checks(self, checks: Sequence[Check]) -> Self:
        """Return the result with further checks."""
        return self.with_best(validation=replace(self.validation, checks=(*self.validation.checks, *checks)))


def better(result: SingleResult) -> tuple[bool, bool, float]:
    """Return a sort key: valid before invalid before infeasible, then by objective.

    Parameters
    ----------
    result : SingleResult
    """
    return not result.valid, result.status in (Status.INFEASIBLE, Status.NON_FINITE), result.objective


class SolutionRecord(Record):
    """Solution of one solver, in display units."""

    status: Status
    design: dict[str, Number]
    objective: Number
    iterations: int
    kkt: Number
    violation: Number
    message: str


class OptimumRecord(Record):
    """A distinct optimum of a multistart search, in display units."""

    design: dict[str, Number]
    objective: Number
    count: int
    assembly: Annotated[str | None, lambda optimum: optimum.assembly or None] = absent()


class SearchRecord(ResultRecord):
    """The common entries of the document of every search."""

    status: Status
    message: str
    valid: bool
    notes: tuple[str, ...]
    backend: str
    starts: int
    seconds: dict[str, float]


def _backends(result: SingleResult) -> dict[str, SolutionRecord] | None:
    """Return the solutions of the back ends in display units."""
    return {
        name: SolutionRecord.of(solution, design=result.displayed(solution.design)) for name, solution in result.backends.items()
    } or None


def _optima(result: SingleResult) -> tuple[OptimumRecord, ...] | None:
    """Return the distinct optima in display units."""
    return tuple(OptimumRecord.of(optimum, design=result.displayed(optimum.design)) for optimum in result.optima) or None


class SingleRecord(SearchRecord):
    """The common entries of the document of a search for one design."""

    design: Annotated[dict[str, float], lambda result: result.displayed(result.complete(result.design))]
    fit: FitRecord | None
    strokes: dict[str, dict[str, Any]]
    limits: Annotated[tuple[LimitState, ...], lambda result: result.solution.displayed_limits if result.solution else ()]
    validation: Annotated[tuple[Check, ...], "validation.checks"]
    iterations: Annotated[int, lambda result: result.solution.iterations if result.solution else 0]
    kkt: Annotated[Number, lambda result: getattr(result.solution, "kkt", None)] = absent()
    violation: Annotated[Number, lambda result: getattr(result.solution, "violation", None)] = absent()
    curvature: Annotated[Number, lambda result: getattr(result.solution, "curvature", None)] = absent()
    backends: Annotated[dict[str, SolutionRecord] | None, _backends] = absent()
    optima: Annotated[tuple[OptimumRecord, ...] | None, _optima] = absent()
    conflict: Annotated[tuple[Relaxation, ...] | None, lambda result: result.conflict or None] = absent()
    relax_together: Annotated[tuple[Relaxation, ...] | None, lambda result: result.together if result.conflict else None] = (
        absent()
    )


def check_entries(table: str, entries: Collection[str], names: Iterable[str]) -> None:
    """Raise if a table of a record lacks an entry.

    Parameters
    ----------
    table : str
        Key of the table.
    entries : collection of str
        Its keys.
    names : iterable of str
        Keys that it must have.

    Raises
    ------
    Contradiction
        with the first missing key.
    """
    for name in names:
        if name not in entries:
            raise Contradiction(f"{table}.{name}", "this is missing")
