"""Objective and limits of a design problem in quantities of its machine."""

from collections.abc import Mapping
from functools import cached_property
from typing import TYPE_CHECKING

from optlink.dynamics.inertia import Inertia
from optlink.linkage.vector2d import Value
from optlink.problem.cycle.terms import Goal, Limit, Objective, Term, check_term, read_scale
from optlink.problem.limits import Alignment, Bound
from optlink.problem.machine.model import Problem
from optlink.problem.quantity import Unusable, below


class MachineTerms(Problem):
    """A problem with quantities of the machine in its objective, or limited under names of one's choice. Immutable."""

    objective: Objective | None = None
    """Objective of quantities of the machine."""
    if TYPE_CHECKING:
        limits: Alignment  # a key of each kind

    @cached_property
    def goals(self) -> tuple[Goal, ...]:
        """The quantities of the machine that are minimised or maximised."""
        return () if self.objective is None else self.objective.goals

    @property
    def named_limits(self) -> dict[str, Limit]:
        """Limits of quantities of the machine by their names."""
        return {}

    @cached_property
    def bounds(self) -> tuple[Bound, ...]:
        """The limits of quantities of the machine with their bounds."""
        bounds = []
        for name, limit in self.named_limits.items():
            with below(f"limits.{name}"):
                bounds.append(Bound(name, limit, limit.interval(self.linkage, self.quantities), f"limits.{name}"))
        return tuple(bounds)

    @cached_property
    def lengths(self) -> tuple[str, ...]:
        """Names of the lengths of the links; of a four-bar, the frame is one."""
        return tuple(name for name, quantity in self.mechanism.quantities.items() if quantity.kind == "length")

    @cached_property
    def scales(self) -> tuple[float | None, ...]:
        """Scale of each objective term [SI]; None if the file gives none."""
        return tuple(read_scale(goal, self.kind(goal)) for goal in self.goals)

    @property
    def single(self) -> bool:
        """Whether the objective is one quantity of the machine, in its own unit."""
        return len(self.goals) == 1 and (self.objective is None or not self.objective.terms)

    def kind(self, term: Term) -> str:
        """Return the physical kind of a term."""
        if term.quantity == "length":
            return self.quantities[str(term.of)].kind
        return term.kind(self.linkage)

    def inertias(self, values: Mapping[str, Value]) -> dict[str, Inertia]:
        """Return mass properties of all bodies for dimensions that may be symbols [SI]; centroids and bars follow the lengths."""
        sizes = self.sizes(values)
        return {name: body.inertia_of(name, self.linkage, sizes) for name, body in self.bodies.items()}

    def _check_term(self, term: Term) -> None:
        check_term(term, self.linkage, self.quantities)
        if term.over is not None:
            remedy = "Leave it out; only terms of [balance] count a range of crank angles"
            raise Unusable("a design problem counts the whole revolution", remedy, "over", str(term.over))

    def check_terms(self) -> None:
        """Check the quantities of the machine and their elements.

        Raises
        ------
        Unusable
            with the full key of the cause.
        """
        terms = (*self.goals, *self.named_limits.values())
        if any(term.nature.cyclic or term.ended or term.quantity == "work" for term in terms) and self.drive.speed.value == 0.0:
            remedy = "Give the constant speed of the cycle"
            raise Unusable("the crank speed is zero", remedy, "drive.speed", str(self.drive.speed))
        for k, goal in enumerate(self.goals):
            with below("objective" if self.single else f"objective.terms.{k}"):
                self._check_term(goal)
                if read_scale(goal, self.kind(goal)) is None and len(self.goals) > 1:
                    raise Unusable("terms of different units are added", 'Give each term a scale: scale = "1000 N"', "scale")
        for name, limit in self.named_limits.items():
            with below(f"limits.{name}"):
                self._check_term(limit)
        if self.mechanism.friction and any(_forced(term) for term in terms):
            guide = next(iter(self.mechanism.friction))
            message = "guide friction is not differentiable where the normal force changes sign"
            remedy = "Optimise without friction, then `optlink analyze` the result with friction"
            raise Unusable(message, remedy, f"mechanism.guides.{guide}.friction", self.mechanism.friction[guide])
        if not self.bodies and not self.loads and any(_forced(goal) for goal in self.goals):
            raise Unusable("no masses and no loads are given, so there are no forces", "Add [bodies] or [loads]", "objective")


def _forced(term: Term) -> bool:
    return term.nature.kind in ("torque", "force", "energy")
