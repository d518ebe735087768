"""All linkages that meet targets exactly, as data: each is usable, or has a reason for which it is not."""

import math
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from optlink.problem.document import Number

DEFECTS = {
    "circuit": "the positions lie on two circuits, between which the linkage must be taken apart",
    "branch": "they lie on both sides of a dead centre of the follower",
    "order": "the crank passes them in another order",
}
"""Defects of a linkage that meets all targets, and their meaning."""
BY_TRANSMISSION = "transmission angle"


@dataclass(frozen=True)
class ExactSolution:
    """A linkage that meets all targets: dimensions [SI], assembly mode, and the least distance [rad] of its transmission angle
    from 0 and 180 deg, over the required motion if it is usable, else at the targets.

    `certified`: its dyads are proven to be real; `reasons`: what excludes it: its `DEFECTS`, else checks that it fails; `figure`:
    the quantity by which they are ranked, in its display unit, of one without a defect.
    """

    values: Mapping[str, Number]
    assembly: str
    transmission: Number
    certified: bool
    reasons: tuple[str, ...]
    figure: Number | None = None

    @property
    def usable(self) -> bool:
        """Whether it passes all targets in order, within all limits and bounds."""
        return not self.reasons


@dataclass(frozen=True)
class ExactSolutions:
    """All linkages that meet the targets, usable ones first, ranked by a quantity (`ranked_by`, with its `unit`), the best first.

    `real`, `certified`, `complex`: numbers of roots of the equations, of which there are `roots`; `sliders`: those that are no
    links of finite length; `special`: a sentence about targets with infinitely many solutions, of which the best ones are listed,
    or none; `either`: whether each linkage is listed twice, driven at either link; `linkage`: what they are, "four-bar" or
    "slider-crank"; `counted`: what the roots are.
    """

    task: str
    real: int
    certified: int
    complex: int
    sliders: int
    special: str
    either: bool
    solutions: tuple[ExactSolution, ...]
    linkage: str = "four-bar"
    roots: int = 4
    counted: str = "roots"
    ranked_by: str = BY_TRANSMISSION
    unit: str = "deg"

    @property
    def usable(self) -> int:
        """Number of usable linkages."""
        return sum(solution.usable for solution in self.solutions)

    @property
    def complete(self) -> bool:
        """Whether each root is either certified to be real, or complex."""
        return not self.special and self.certified + self.complex == self.roots

    @property
    def sentence(self) -> str:
        """How many solutions there are, and how many of them are usable."""
        if self.special:
            return f"{self.task}: {self.special}"
        proof = "certified" if self.certified == self.real else f"{self.certified} of them certified"
        all_of_them = f"{self.roots} {self.counted}"
        roots = f"{self.real} of {all_of_them} are real ({proof})" if self.real else f"none of the {all_of_them} is real"
        missing = "" if self.complete else f", {self.roots - self.certified - self.complex} not found or not separated"
        sliders = f", {self.sliders} of them a slider or of no length" if self.sliders else ""
        count = len(self.solutions)
        found = f"{count} {self.linkage}{'s' * (count != 1)}, {self.usable} usable" if count else f"no {self.linkage}"
        if self.either and count:
            found = f"{count // 2} four-bar{'s' * (count > 2)}, {count} with either link as the crank, {self.usable} usable"
        return f"{self.task}: {roots}{missing}{sliders}; {found}{self._others}"

    @property
    def _others(self) -> str:
        """How many solutions have each reason as their first one."""
        causes = Counter(one.reasons[0].partition(":")[0] for one in self.solutions if one.reasons)
        listed = ", ".join(f"{cause} {count}" for cause, count in causes.most_common())
        return f"; the others fail by: {listed}" if listed else ""


def document(found: ExactSolutions, displayed: Callable[[Mapping[str, float]], Mapping[str, float]]) -> dict[str, Any]:
    """Return the solutions as part of a JSON document, their dimensions `displayed` in units."""
    counts = ("roots", "real", "certified", "complex", "sliders", "complete", "special", "usable")
    shown = ("task", "linkage", *counts, "ranked_by", "unit")
    solutions = [
        {name: getattr(one, name) for name in ("usable", "reasons", "certified", "assembly", "figure")}
        | {"transmission_deg": math.degrees(one.transmission), "design": displayed(one.values)}
        for one in found.solutions
    ]
    return {name: getattr(found, name) for name in shown} | {"solutions": solutions}
