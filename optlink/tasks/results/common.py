"""Common interface of search results: validity, optimality checks, JSON document."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from optlink.errors import Status
from optlink.io import head
from optlink.linkage.fourbar import LENGTHS
from optlink.problem.file import ProblemFile
from optlink.problem.quantity import Quantity
from optlink.solvers.solution import FEASIBLE, STATIONARY, Solution
from optlink.validation.check import Check, Validation

DisplayValues = Callable[[Mapping[str, float]], dict[str, float]]
"""A design [SI] as a document tells it: in the units that the keys end in."""
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


class DesignResult(Protocol):
    """Interface of a search result."""

    @property
    def problem(self) -> ProblemFile:
        """The problem."""
        ...

    @property
    def status(self) -> Status:
        """Status of the search."""
        ...

    @property
    def valid(self) -> bool:
        """Whether the design is validated."""
        ...

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes for the user."""
        ...

    @property
    def backend(self) -> str:
        """The solver."""
        ...

    @property
    def seed(self) -> int | None:
        """Seed of the starts."""
        ...

    @property
    def starts(self) -> int:
        """Number of starts."""
        ...

    @property
    def seconds(self) -> dict[str, float]:
        """Wall time per stage [s]."""
        ...


class SingleDesignResult(DesignResult, Protocol):
    """Interface of a result with one design."""

    @property
    def validation(self) -> Validation:
        """Its validation."""
        ...

    @property
    def solution(self) -> Solution | None:
        """Solver solution; None without a search."""
        ...

    @property
    def backends(self) -> dict[str, Solution]:
        """Solution of each solver."""
        ...

    @property
    def optima(self) -> tuple[Optimum, ...]:
        """Distinct optima."""
        ...

    @property
    def conflict(self) -> Sequence[object]:
        """Conflicting limits."""
        ...

    @property
    def together(self) -> Sequence[object]:
        """Least simultaneous relaxation of several limits."""
        ...


def proven(status: Status, validation: Validation) -> bool:
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


def heading(schema: str, outcome: DesignResult) -> dict[str, Any]:
    """Return the head of the JSON document of a search result.

    Parameters
    ----------
    schema : str
        Name and version of the schema.
    outcome : DesignResult
    """
    return head(schema, outcome.problem, outcome.status.value, outcome.seed) | {
        "message": outcome.status.text,
        "valid": outcome.valid,
        "notes": list(outcome.notes),
        "backend": outcome.backend,
        "starts": outcome.starts,
        "seconds": outcome.seconds,
    }


def proof(outcome: SingleDesignResult, displayed: DisplayValues) -> dict[str, Any]:
    """Return the part of the JSON document on limits, validation, solvers, optima and conflicts.

    Parameters
    ----------
    outcome : SingleDesignResult
    displayed : function of a design [SI]
        Converts a design to display units with the units in its keys.
    """
    solution = outcome.solution
    document: dict[str, Any] = {
        "limits": [vars(limit) | {} for limit in solution.limits] if solution else [],
        "validation": [vars(check) | {} for check in outcome.validation.checks],
        "iterations": solution.iterations if solution else 0,
    }
    if solution:
        document |= {"kkt": solution.kkt, "violation": solution.violation, "curvature": solution.curvature}
    if outcome.backends:
        document["backends"] = {name: _searched(found, displayed) for name, found in outcome.backends.items()}
    if outcome.optima:
        document["optima"] = [_listed(optimum, displayed) for optimum in outcome.optima]
    if outcome.conflict:
        document["conflict"] = [vars(item) | {} for item in outcome.conflict]
        document["relax_together"] = [vars(item) | {} for item in outcome.together]
    return document


def _listed(optimum: Optimum, displayed: DisplayValues) -> dict[str, Any]:
    document = {"design": displayed(optimum.design), "objective": optimum.objective, "count": optimum.count}
    return document | ({"assembly": optimum.assembly} if optimum.assembly else {})


def _searched(solution: Solution, displayed: DisplayValues) -> dict[str, Any]:
    return {
        "status": solution.status.value,
        "design": displayed(solution.design),
        "objective": solution.objective,
        "iterations": solution.iterations,
        "kkt": solution.kkt,
        "violation": solution.violation,
        "message": solution.message,
    }
