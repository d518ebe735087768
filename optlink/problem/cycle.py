"""CycleProblem: a machine whose design variables are optimised for quantities of its cycle."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

from pydantic import ConfigDict, Field

from optlink.dynamics.inertia import Inertia
from optlink.linkage.vector2d import Value
from optlink.problem.base_model import Name
from optlink.problem.cycle_terms import Goal, Limit, Objective, Term, check_term, read_figure
from optlink.problem.limits import Alignment
from optlink.problem.machine.model import Problem
from optlink.problem.mechanism import check_one_mode, sizes_of
from optlink.problem.quantity import Interval, Unusable, below


@dataclass(frozen=True)
class Bound:
    """A limit with its name in the file and its bounds [SI]."""

    name: str
    term: Limit
    interval: Interval

    @property
    def key(self) -> str:
        """Key of the limit in the problem file."""
        return f"limits.{self.name}"


class CycleLimits(Alignment):
    """Limits with names of the user's choice, in addition to those of every design problem."""

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[Name, Limit] = Field(init=False)

    @property
    def named(self) -> dict[str, Limit]:
        """The limits of the user by their names."""
        return dict(self.__pydantic_extra__ or {})


class CycleProblem(Problem):
    """A problem file with an objective over the cycle: input of `solve`. Immutable."""

    objective: Objective
    """Objective over the cycle."""
    limits: CycleLimits = CycleLimits()
    """Limits on quantities of the cycle, each under a name of your choice, and the least distance from positions where the
    mechanism locks."""

    @property
    def task(self) -> str:
        """Kind of task: cycle optimisation."""
        return "cycle"

    @cached_property
    def goals(self) -> tuple[Goal, ...]:
        """The terms of the objective."""
        return self.objective.goals

    @cached_property
    def bounds(self) -> tuple[Bound, ...]:
        """The limits with their bounds."""
        found = []
        for name, limit in self.limits.named.items():
            with below(f"limits.{name}"):
                found.append(Bound(name, limit, limit.interval(self.linkage, self.quantities)))
        return tuple(found)

    @cached_property
    def scales(self) -> tuple[float | None, ...]:
        """Scale of each objective term [SI]; None if the file gives none."""
        return tuple(None if goal.scale is None else read_figure(goal.scale, self.kind(goal), "scale")[0] for goal in self.goals)

    @property
    def unit_kind(self) -> str:
        """Physical kind of the objective; empty for a weighted sum, which is a plain number."""
        return self.kind(self.goals[0]) if self.single else ""

    @property
    def single(self) -> bool:
        """Whether the objective is one term, in its own unit."""
        return not self.objective.terms

    def kind(self, term: Term) -> str:
        """Return the physical kind of a term."""
        if term.quantity == "length":
            return self.quantities[str(term.of)].kind
        return term.kind(self.linkage)

    def inertias(self, values: Mapping[str, Value]) -> dict[str, Inertia]:
        """Return mass properties of all bodies for dimensions that may be symbols [SI]; centroids and bars follow the lengths."""
        sizes = {**sizes_of(self.mechanism.quantities), **values}
        return {name: body.inertia_of(name, self.linkage, sizes) for name, body in self.bodies.items()}


def cross_check_cycle(problem: CycleProblem) -> None:
    """Check that the sections of a cycle problem are consistent.

    Raises
    ------
    Unusable
        with the full key of the cause.
    """
    check_one_mode(problem.mechanism)
    mechanism = problem.linkage
    if problem.drive.speed.value == 0.0:
        raise Unusable("the crank speed is zero", "Give the constant speed of the cycle", "drive.speed", str(problem.drive.speed))
    for k, goal in enumerate(problem.goals):
        place = "objective" if problem.single else f"objective.terms.{k}"
        with below(place):
            check_term(goal, mechanism, problem.quantities)
            if goal.scale is not None and read_figure(goal.scale, problem.kind(goal), "scale")[0] <= 0.0:
                raise Unusable("a scale is positive", "Give one above zero", "scale", goal.scale)
    for name, limit in problem.limits.named.items():
        with below(f"limits.{name}"):
            check_term(limit, mechanism, problem.quantities)
    _ = problem.bounds
    if problem.mechanism.friction and any(_forced(term) for term in (*problem.goals, *problem.limits.named.values())):
        guide = next(iter(problem.mechanism.friction))
        raise Unusable(
            "where a normal force changes its sign friction has a corner that no derivative sees",
            "Leave the friction out of the design and `optlink analyze` its result with it",
            f"mechanism.guides.{guide}.friction",
            problem.mechanism.friction[guide],
        )
    if not problem.bodies and not problem.loads and any(_forced(goal) for goal in problem.goals):
        raise Unusable("no masses and no loads are given, so there are no forces", "Add [bodies] or [loads]", "objective")


def _forced(term: Term) -> bool:
    return term.nature.kind in ("torque", "force", "energy")


__all__ = ["Bound", "CycleProblem", "cross_check_cycle", "replace"]
