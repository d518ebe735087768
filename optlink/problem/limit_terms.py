"""Limits on values that the dimensions determine: one entry of `LIMITS` per key of `[limits]`.

An entry contains the formula of the optimiser (`values`, elementwise on floats, arrays and symbols) and, written separately, the
measurement of the validator in motion (`measure`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

from pydantic.fields import FieldInfo

from optlink.linkage.fourbar import LENGTHS, lengths_of, swing, time_ratio
from optlink.linkage.mechanism import Mechanism
from optlink.linkage.motion import Motion
from optlink.linkage.vector2d import Value
from optlink.problem.quantity import AngleInterval, Interval, LengthInterval, NumberInterval, RatioOfStrokes
from optlink.registry import Registry

if TYPE_CHECKING:
    from optlink.problem.limits import Limits, Reach


class Moved(Protocol):
    """A design in motion, as a validator measures it."""

    mechanism: Mechanism
    design: dict[str, float]

    @property
    def required(self) -> Motion:
        """The motion over which the mechanism must be assembled."""
        ...

    def strokes(self) -> tuple[float, float, float]:
        """Return the swing angle of the rocker and the crank rotation of its forward and backward strokes [rad], or NaN."""
        ...


@dataclass(frozen=True)
class LimitTerm:
    """A key of `[limits]`.

    Parameters
    ----------
    name : str
        The key.
    form : AngleInterval, LengthInterval, NumberInterval or RatioOfStrokes
        Type of its value, which determines unit and scaling.
    values : function of (problem, sizes [m, rad], reach, interval)
        Yields the label and the value [rad, m or -] of each row, elementwise.
    measure : function of (design in motion, interval)
        Yields the name and the value [rad, m or -] of each check.
    about : str
        Description for the reference of problem files.
    possible : (float, float) [rad, m or -]
        Range outside which no limit makes sense, with an `example` for the error message.
    four_bar, crank_rocker : bool
        Whether only a four-bar, or only a crank-rocker, has it.
    """

    name: str
    form: Any
    values: Callable[[Any, Mapping[str, Value], Reach, Any], Iterator[tuple[str, Value]]]
    measure: Callable[[Moved, Any], Iterator[tuple[str, float]]]
    about: str = ""
    possible: tuple[float, float] = (-math.inf, math.inf)
    example: str = ""
    four_bar: bool = True
    crank_rocker: bool = False

    @property
    def key(self) -> str:
        """Key in the problem file."""
        return f"limits.{self.name}"


LIMITS: Registry[LimitTerm] = Registry()


def stated(limits: Limits) -> Iterator[tuple[LimitTerm, Interval]]:
    """Yield the registered limits that a file states, with their bounds."""
    for term in LIMITS.values():
        interval = getattr(limits, term.name, None)
        if interval is not None:
            yield term, interval


def add_limit(term: LimitTerm) -> None:
    """Register a limit of function and path synthesis from outside the package.

    Raises
    ------
    ValueError
        if the key is already taken.
    """
    from optlink.problem.function import DesignProblem
    from optlink.problem.limits import Limits
    from optlink.problem.path import PathLimits, PathProblem

    if term.name in PathLimits.model_fields:
        raise ValueError(f"{term.key} is already registered")
    LIMITS.add(term.name, term)
    for section in (Limits, PathLimits):
        section.model_fields[term.name] = FieldInfo(annotation=term.form | None, default=None, description=term.about)
    for model in (Limits, PathLimits, DesignProblem, PathProblem):
        model.model_rebuild(force=True)


def stroke_ratio(forward: float, backward: float, stroke: str | None) -> float:
    """Return the time ratio of two strokes at constant crank speed.

    Parameters
    ----------
    forward, backward : float [rad]
        Positive crank rotation of the two strokes.
    stroke : "forward", "backward", "slow", "quick" or None
        Stroke in the numerator. None: the slow one.
    """
    if stroke in ("forward", "backward"):
        return forward / backward if stroke == "forward" else backward / forward
    quick, slow = sorted((forward, backward))
    return quick / slow if stroke == "quick" else slow / quick


def _ratio_label(limit: Any) -> str:
    return f"time ratio, {limit.strokes}" if limit.stroke else "time ratio"


for built_in in (
    LimitTerm(
        "swing_angle",
        AngleInterval,
        lambda problem, sizes, reach, _: iter([("swing angle of the rocker", swing(*lengths_of(sizes), problem.side))]),
        lambda moved, _: iter([("swing angle", moved.strokes()[0])]),
        possible=(0.0, math.pi),
        example='["30 deg", "60 deg"]',
        crank_rocker=True,
    ),
    LimitTerm(
        "time_ratio",
        RatioOfStrokes,
        lambda problem, sizes, reach, limit: iter(
            [(_ratio_label(limit), time_ratio(*lengths_of(sizes), problem.side, limit.stroke, reach.sense))]
        ),
        lambda moved, limit: iter([(_ratio_label(limit), stroke_ratio(*moved.strokes()[1:], limit.stroke))]),
        crank_rocker=True,
    ),
    LimitTerm(
        "frame_length",
        LengthInterval,
        lambda problem, sizes, reach, _: iter([("frame length", sizes["frame"])]),
        lambda moved, _: iter([("frame length", moved.design["frame"])]),
    ),
    LimitTerm(
        "link_ratio",
        NumberInterval,
        lambda problem, sizes, reach, _: (("moving link / frame", sizes[name] / sizes["frame"]) for name in LENGTHS[:3]),
        lambda moved, _: ((f"{name} / frame", moved.design[name] / moved.design["frame"]) for name in LENGTHS[:3]),
        possible=(0.0, math.inf),
        example="[0.2, 5.0]",
    ),
):
    LIMITS.add(built_in.name, built_in)
