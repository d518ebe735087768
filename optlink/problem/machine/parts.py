"""Section `[parts]`: how the links are made."""

from typing import Literal

from pydantic import Field

from optlink.linkage.mechanism import FRAME, Mechanism
from optlink.problem.base_model import Fact, Name, Section
from optlink.problem.quantity import FixedLength, check_name

End = Literal["round", "square", "chamfered"]
"""Shapes of the ends of a link."""


class LinkPart(Section):
    """How one link is made, where it differs from the others."""

    width: FixedLength | None = None
    """Width of this link."""
    thickness: FixedLength | None = None
    """Thickness of this link."""
    end: End | None = None
    """Shape of the ends of this link."""
    material: Fact = ""
    """Material of this link, on the workshop sheet."""


class JointPart(Section):
    """How one pin joint is made, where it differs from the others."""

    hole: FixedLength | None = None
    """Diameter of the holes of this joint."""
    pin: FixedLength | None = None
    """Diameter of the pin of this joint, at most that of its holes."""
    fit: Fact = ""
    """Tolerance class of the holes of this joint, on the workshop sheet: `"H7"`."""


class PartsSection(LinkPart, JointPart):
    """How the links are cut or printed; what is left out follows from the size of the linkage. Without effect on the result."""

    width: FixedLength | None = None
    """Width of the links; default: 2.5 times the diameter of the holes."""
    thickness: FixedLength | None = None
    """Thickness of the links; default: about three quarters of the diameter of the holes."""
    end: End = "round"
    """Shape of the ends: `"round"`, `"square"` for bars that are cut off, `"chamfered"` for square ones without sharp corners."""
    hole: FixedLength | None = None
    """Diameter of the holes; default: about 3 % of the extent, at most half of the least distance of two holes of a link."""
    pin: FixedLength | None = None
    """Diameter of the pins; default: that of the holes."""
    material: Fact = ""
    """Material of the links, on the workshop sheet."""
    fit: Fact = ""
    """Tolerance class of the holes, on the workshop sheet: `"H7"`."""
    head: FixedLength | None = None
    """Diameter of the heads at both ends of a pin, that of the pin for one without heads; default: 1.6 times that of the pin."""
    spacer: FixedLength | None = None
    """Thickness of the washers between two layers of links; default: about a fifth of the diameter of the holes."""
    overtravel: FixedLength | None = None
    """Length of a slot beyond the travel of its pin, at each end; default: about a quarter of the diameter of the holes."""
    paper: Literal["A4", "A3"] | None = None
    """Paper of the workshop sheets; default: of each the smaller one that has room at the largest scale."""
    links: dict[Name, LinkPart] = Field(default_factory=dict)
    """Links that differ from the others, by name; `frame` is the plate with the fixed pivots."""
    joints: dict[Name, JointPart] = Field(default_factory=dict)
    """Pin joints that differ from the others, by name."""

    def check(self, mechanism: Mechanism) -> None:
        """Refuse links and joints that the mechanism does not have.

        Raises
        ------
        Unusable
            with the key below the section.
        """
        for name in self.links:
            check_name(name, (*mechanism.bodies, FRAME), "no such link", f"links.{name}")
        for name in self.joints:
            check_name(name, mechanism.pins, "no such pin joint", f"joints.{name}")
