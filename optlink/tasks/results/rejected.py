"""Better optima than the design of a result that its validation rejected."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from optlink.problem.base_model import Number
from optlink.problem.document import Source
from optlink.problem.file import ProblemFile
from optlink.validation.check import Check

BETTER = 1e-6  # relative difference by which the objective of a better optimum is less


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
    better = [one for one in designs if one is not None and one.objective < objective * (1.0 - BETTER)]
    return min(better, key=lambda one: one.objective, default=None)
