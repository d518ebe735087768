"""All linkages that meet targets exactly, as data: each is usable, or has a reason for which it is not."""

import math
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from optlink.problem.document import Number
from optlink.units import count_noun

DEFECTS = {
    "circuit": "the positions lie on two circuits, between which the linkage must be taken apart",
    "branch": "the positions lie on both sides of a dead centre of the follower",
    "order": "the crank passes the positions in another order",
}
"""Defects of a linkage that meets all targets, and their meaning."""
BY_TRANSMISSION = "transmission angle"
MOST_CAUSES = 6  # reasons in the sentence


@dataclass(frozen=True)
class ExactSolution:
    """A linkage that meets all targets: dimensions [SI], assembly mode, and the least distance [rad] of its transmission angle
    from 0 and 180 deg, over the required motion if it is usable, else at the targets.

    `certified`: its dyads are proven to be real; `reasons`: what excludes it: its `DEFECTS`, else checks that it fails; `figure`:
    the quantity by which they are ranked, in its display unit, of one without a defect; `crank_angle` [rad] at the first target;
    `between`: largest error [rad or m] of a law over its range, that of the structure, of one without a defect.
    """

    values: Mapping[str, Number]
    assembly: str
    transmission: Number
    certified: bool
    reasons: tuple[str, ...]
    figure: Number | None = None
    crank_angle: Number | None = None
    between: Number | None = None

    @property
    def usable(self) -> bool:
        """Whether it passes all targets in order, within all limits and bounds."""
        return not self.reasons


@dataclass(frozen=True)
class ExactSolutions:
    """All linkages that meet the targets, usable ones first, ranked by a quantity (`ranked_by`, with its `unit`), the best first.

    `real`, `certified`, `complex`: numbers of roots of the equations, of which there are `roots`; `sliders`: those that are
    no links of finite length; `special`: a sentence about targets with infinitely many solutions, of which the best ones are
    listed, or none; `note`: a sentence about nearly special ones; `either`: whether each linkage is listed twice, driven at
    either link; `linkage`: what they are, "four-bar" or "slider-crank"; `counted`: what the roots are.
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
    note: str = ""

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
        return counts(self, self._others)

    @property
    def reasons(self) -> dict[str, int]:
        """How many linkages each reason excludes, the most frequent first; a bound is named."""
        counts = Counter(cause for one in self.solutions for cause in {_cause(reason) for reason in one.reasons})
        return dict(sorted(counts.items(), key=lambda item: (-item[1], item[0])))

    @property
    def _others(self) -> str:
        """How many solutions have each reason, with the most frequent ones."""
        listed = ", ".join(f"{count} × {cause}" for cause, count in [*self.reasons.items()][:MOST_CAUSES])
        left = len(self.reasons) - MOST_CAUSES
        more = f" and {count_noun(left, 'more reason')}" if left > 0 else ""
        several = " (some have several)" * (sum(self.reasons.values()) > len(self.solutions) - self.usable)
        return f"; reasons of the others{several}: {listed}{more}" if listed else ""


def counts(found: ExactSolutions, others: str = "") -> str:
    """Return how many solutions there are, and how many of them are usable, with words about the `others`."""
    note = f"; {found.note}" * bool(found.note)
    if found.special:
        return f"{found.task}: {found.special}{note}"
    proof = "certified" if found.certified == found.real else f"{found.certified} of them certified"
    all_of_them = f"{found.roots} {found.counted}"
    roots = f"{found.real} of {all_of_them} are real ({proof})" if found.real else f"none of the {all_of_them} is real"
    missing = "" if found.complete else f", {found.roots - found.certified - found.complex} not found or not separated"
    sliders = f", {found.sliders} of them a slider or of no length" if found.sliders else ""
    count = len(found.solutions)
    listed = f"{count_noun(count, found.linkage)}, {found.usable} usable" if count else f"no {found.linkage}"
    if found.either and count:
        listed = f"{count_noun(count // 2, 'four-bar')}, {count} with either link as the crank, {found.usable} usable"
    return f"{found.task}: {roots}{missing}{sliders}; {listed}{others}{note}"


def _cause(reason: str) -> str:
    """Return a reason without the figures of a linkage, but with the bound that it exceeds."""
    cause, _, rest = reason.partition(": ")
    size, allowed, bound = rest.partition(", allowed ")
    name, _, unit = size.partition(" ")
    return f"{cause} ({name} {bound} {unit.partition(' ')[2]}".rstrip() + ")" if allowed else cause


def document(found: ExactSolutions, displayed: Callable[[Mapping[str, float]], Mapping[str, float]]) -> dict[str, Any]:
    """Return the solutions as part of a JSON document, their dimensions `displayed` in units."""
    counts = ("roots", "real", "certified", "complex", "sliders", "complete", "special", "note", "usable", "reasons")
    shown = ("task", "linkage", *counts, "ranked_by", "unit")
    solutions = [
        {name: getattr(one, name) for name in ("usable", "reasons", "certified", "assembly", "figure")}
        | ({} if one.between is None else {"largest_between_SI": one.between})
        | {"transmission_deg": math.degrees(one.transmission), "design": displayed(one.values)}
        for one in found.solutions
    ]
    return {name: getattr(found, name) for name in shown} | {"solutions": solutions}
