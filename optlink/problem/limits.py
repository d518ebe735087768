"""Limits of a four-bar, and their crank range."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from pydantic import AfterValidator

from optlink.linkage.margins import LEAST_ALIGNMENT, LEAST_LENGTH_MARGIN, SMALLEST_ALIGNMENT, SMALLEST_LENGTH_MARGIN
from optlink.linkage.vector2d import Value
from optlink.problem.base_model import Section
from optlink.problem.limit_terms import LIMITS, stated
from optlink.problem.quantity import (
    AngleInterval,
    FixedAngle,
    LengthInterval,
    Number,
    NumberInterval,
    Quantity,
    RatioOfStrokes,
    Unusable,
)

MARGINS: dict[str, str | float] = {"alignment": f"{np.degrees(LEAST_ALIGNMENT):g} deg", "length_margin": LEAST_LENGTH_MARGIN}
"""Limits that every design problem has, as the file would state their defaults."""
MARGIN_KEYS = frozenset(f"limits.{key}" for key in MARGINS)
MOST_ALIGNMENT, MOST_LENGTH_MARGIN = np.radians(45.0), 0.1


def _alignment(value: Quantity) -> Quantity:
    if not SMALLEST_ALIGNMENT * (1.0 - 1e-9) <= value.value <= MOST_ALIGNMENT:
        raise Unusable(
            "the least angle from alignment lies between 0.1 and 45 deg", 'Write "1 deg", the default, or leave it out'
        )
    return value


def _length_margin(value: float) -> float:
    if not SMALLEST_LENGTH_MARGIN <= value <= MOST_LENGTH_MARGIN:
        raise Unusable(
            "the length margin, a share of the longest link, lies between 1e-5 and 0.1",
            "Write 1e-4, the default, or leave it out",
        )
    return value


class Alignment(Section):
    """Least distance of a mechanism from positions where it locks or its assembly modes meet (see `optlink.linkage.margins`)."""

    alignment: Annotated[FixedAngle, AfterValidator(_alignment)] = Quantity(LEAST_ALIGNMENT, "angle", "deg")
    """Least angle of two links at their joint from alignment, 0 and 180 deg, over the required motion; likewise of a link
    at a slider from the normal of its line. A tighter transmission limit governs where there is one."""


class Margins(Alignment):
    """Least distance of a four-bar from such positions and from change points."""

    length_margin: Annotated[Number, AfterValidator(_length_margin)] = LEAST_LENGTH_MARGIN
    """Least difference of lengths that must not be equal (Grashof's sums; crank and coupler at an inner dead centre), as a share
    of the longest link."""


class Limits(Margins):
    """Limits of a design problem."""

    crank: Literal["full rotation", "double-crank", "span"] = "full rotation"
    """Whether the crank turns fully (a four-bar is then a crank-rocker, or a double-crank), or need only be assembled over the
    span."""
    transmission_angle: AngleInterval | None = None
    """Between coupler and rocker; of dyads at every joint of two links."""
    transmission_cosine: NumberInterval | None = None
    """The same in cosines; of a four-bar."""
    transmission_over: Literal["revolution", "span"] | None = None
    """Where the transmission angle is limited; left out: wherever the crank must turn."""
    swing_angle: AngleInterval | None = None
    """Of the rocker, between its dead centres; of a crank-rocker."""
    time_ratio: RatioOfStrokes | None = None
    """Duration of one stroke of the rocker over that of the other: of the slow one, or of `stroke` ("forward":
    counter-clockwise, "backward", "slow", "quick"); of a crank-rocker."""
    frame_length: LengthInterval | None = None
    """Of a four-bar."""
    link_ratio: NumberInterval | None = None
    """Each moving link over the frame; of a four-bar."""


def check_limits(limits: Limits) -> None:
    """Refuse limits outside the physically possible range, and those that contradict the crank condition.

    Raises
    ------
    Unusable
        with the full key of the limit.
    """
    own = (
        ("transmission_angle", (0.0, np.pi), '["45 deg", "135 deg"]'),
        ("transmission_cosine", (-1.0, 1.0), "[-0.7071, 0.7071]"),
    )
    for key, (lowest, highest), example in (*own, *((term.name, term.possible, term.example) for term in LIMITS.values())):
        interval = getattr(limits, key)
        for bound in () if interval is None else (interval.low, interval.high):
            if bound is not None and not lowest <= bound <= highest:
                raise Unusable(
                    f"{interval.to_display(bound)} is out of the range that it can have",
                    f"Give a range such as {example}",
                    f"limits.{key}",
                    str(interval),
                )
    for term, _ in stated(limits) if limits.crank != "full rotation" else ():
        if term.crank_rocker:
            raise Unusable("only a crank-rocker has it", 'Set limits.crank = "full rotation", or leave the limit out', term.key)
    if limits.crank == "span" and limits.transmission_over == "revolution":
        raise Unusable(
            "a crank that need not turn fully has no whole revolution",
            'Write transmission_over = "span", or crank = "full rotation"',
            "limits.transmission_over",
            "revolution",
        )


@dataclass(frozen=True)
class Reach:
    """Crank range of a requirement: from `start` by `span` [rad], negative clockwise; `sense`: the sign of the span."""

    start: Value
    span: Value
    sense: Value
