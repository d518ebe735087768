"""Intervals of problem files: limits of a measure, of the angles at joints, of the time ratio of the strokes."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any

from optlink.problem.quantity import (
    Unusable,
    below,
    check_keys,
    check_name,
    check_pair,
    range_example,
    read_number,
    read_scalar,
    reader,
)
from optlink.units import KINDS, mistyped_range, show

SIDES = ("min", "max", "exactly")


@dataclass(frozen=True)
class Interval:
    """Limits of a measure: at least `low`, at most `high` [SI]; None for an open side; both equal for a target value."""

    low: float | None
    high: float | None
    kind: str | None
    unit: str

    @property
    def bounds(self) -> tuple[float, float]:
        """Lower and upper bound [SI], infinite for an open side."""
        return -math.inf if self.low is None else self.low, math.inf if self.high is None else self.high

    def __str__(self) -> str:
        low, high = (None if bound is None else self.to_display(bound) for bound in (self.low, self.high))
        if low is None or high is None:
            return f"at least {low}" if high is None else f"at most {high}"
        return f"exactly {low}" if low == high else f"{low} ... {high}"

    def to_display(self, value: float) -> str:
        """Return the value in the interval's own unit."""
        return show(value, self.kind, self.unit) if self.kind else f"{value:.6g}"


@dataclass(frozen=True)
class JointRanges(Interval):
    """Limits of an angle at joints: the interval itself for every joint without its own, and `own` by the name of the joint."""

    own: tuple[tuple[str, Interval], ...] = ()

    @property
    def plain(self) -> bool:
        """Whether there are limits for the joints without their own."""
        return self.low is not None or self.high is not None

    def __str__(self) -> str:
        return "; ".join([*[super().__str__()] * self.plain, *(f"{interval} at {joint}" for joint, interval in self.own)])


STROKES = {"forward": "backward", "backward": "forward", "slow": "quick", "quick": "slow"}
"""Every name of a stroke, and that of the other stroke."""


@dataclass(frozen=True)
class StrokeRatio(Interval):
    """Limits of the duration of one stroke over that of the other: of `stroke`, or of the slow one if that is None."""

    stroke: str | None = None

    def __str__(self) -> str:
        return super().__str__() + (f", {self.strokes}" if self.stroke else "")

    @property
    def strokes(self) -> str:
        """Names of the two strokes, for display."""
        stroke = self.stroke or "slow"
        return f"{stroke} over {STROKES[stroke]}"


def check_time_ratio(stroke: str | None, value: float, key: str, low: float | None, high: float | None) -> None:
    """Refuse a limit `value` that no time ratio can satisfy, and suggest the part of its range, `low` to `high`, that one can.

    `stroke` is the one whose time is divided by the other's, None the slow one; `key` is empty if both sides have one key.

    Raises
    ------
    Unusable
        with the key.
    """
    slow, quick = stroke in (None, "slow") and value < 1.0, stroke == "quick" and value > 1.0
    if slow or quick:
        words, side = ("at least as long as the quick", "more") if slow else ("at most as long as the slow", "less")
        remedy = f"Give 1 or {side}"
        if low is not None and high is not None and low < 1.0 < high:
            remedy = "Give 1" if key else f"Write [1, {high:g}]" if slow else f"Write [{low:g}, 1]"
        raise Unusable(f"the {stroke or 'slow'} stroke takes {words} one, so that the ratio is 1 or {side}", remedy, key, value)
    if value <= 0.0:
        raise Unusable("the ratio of two stroke times must be positive", "Give a ratio above 0", key, value)


def read_figure(raw: object, kind: str | None, key: str = "") -> tuple[float, str]:
    """Read a value of a physical kind, or a plain number if there is no kind; return its SI number and the unit as written."""
    return read_scalar(raw, kind, key) if kind else (read_number(raw, key), "")


def read_interval(raw: object, kind: str | None) -> Interval:
    """Read a range: two values, one for both, or a table of `min`, `max` or `exactly`.

    Raises
    ------
    Unusable
    """
    example = range_example(kind)
    if isinstance(raw, str) and (suggestion := mistyped_range(raw)) is not None:
        raise Unusable("this is not a range", f'Write it with two dots: "{suggestion}"', "", raw)
    if isinstance(raw, dict):
        check_keys(raw, SIDES)
        if not raw:
            raise Unusable("the table is empty", f"Give min, max or both, or write {example}", "", raw)
        if "exactly" in raw and len(raw) > 1:
            message = "exactly and min or max are given together"
            raise Unusable(message, "Give either exactly, or min and max", "exactly", raw["exactly"])
        exactly = read_figure(raw["exactly"], kind, "exactly") if "exactly" in raw else None
        low, high = (read_figure(raw[key], kind, key) if key in raw else exactly for key in SIDES[:2])
    elif isinstance(raw, list):
        ends = check_pair(raw, "a range is two values, lower and upper", f"Write {example}")
        low, high = (read_figure(end, kind) for end in ends)
    else:
        low = high = read_figure(raw, kind)
    if low and high and low[0] > high[0]:
        raise Unusable("the lower limit is above the upper", "Exchange them", "", raw)
    unit = (low or high or (0.0, ""))[1]
    return Interval(low[0] if low else None, high[0] if high else None, kind, unit)


def _read_stroke_ratio(raw: object, kind: None) -> StrokeRatio:
    stroke, sides = None, raw
    if isinstance(raw, dict):
        stroke, sides = raw.get("stroke"), {key: value for key, value in raw.items() if key != "stroke"}
        if stroke is not None:
            check_name(stroke, STROKES, "unknown stroke", "stroke")
            if not sides:
                raise Unusable("the time ratio has no limit", "Add min, max or exactly", "", raw)
    interval = read_interval(sides, kind)
    for key, value in (("min", interval.low), ("max", interval.high)):
        if value is not None:
            written = "exactly" if isinstance(sides, dict) and "exactly" in sides else key
            check_time_ratio(stroke, value, written if isinstance(sides, dict) else "", interval.low, interval.high)
    return StrokeRatio(interval.low, interval.high, interval.kind, interval.unit, stroke)


def _read_joint_ranges(raw: object, kind: str) -> JointRanges:
    """Read a range for every joint, or a table with the ranges of single joints beside it."""
    return _joint_ranges(raw, kind, read_interval)


def _read_joint_maxima(raw: object, kind: str) -> JointRanges:
    """Read a largest value for every joint, or a table with those of single joints."""

    return _joint_ranges(raw, kind, _read_largest)


def _read_largest(raw: object, kind: str) -> Interval:
    if not isinstance(raw, dict):
        value, unit = read_scalar(raw, kind)
        return Interval(None, value, kind, unit)
    for key, value in raw.items():
        if key != "max":
            raise Unusable("only its largest value is limited", f'Write max = "{KINDS[kind].example}"', key, value)
    return read_interval(raw, kind)


def _joint_ranges(raw: object, kind: str, read: Callable[[object, str], Interval]) -> JointRanges:
    by_joint: dict[Any, Any] = {}
    sides = raw
    if isinstance(raw, dict):
        by_joint = {key: value for key, value in raw.items() if key not in SIDES}
        sides = {key: value for key, value in raw.items() if key in SIDES}
    entries = []
    for joint, value in by_joint.items():
        with below(str(joint)):
            entries.append((str(joint), read(value, kind)))
    plain = read(sides, kind) if sides or not by_joint else Interval(None, None, kind, entries[0][1].unit)
    return JointRanges(plain.low, plain.high, kind, plain.unit, tuple(entries))


CoordinateInterval = Annotated[Interval, reader(read_interval, "coordinate")]
LengthInterval = Annotated[Interval, reader(read_interval, "length")]
AngleInterval = Annotated[Interval, reader(read_interval, "angle")]
AnglesOfJoints = Annotated[JointRanges, reader(_read_joint_ranges, "angle")]
LargestAnglesOfJoints = Annotated[JointRanges, reader(_read_joint_maxima, "angle")]
NumberInterval = Annotated[Interval, reader(read_interval, None)]
RatioOfStrokes = Annotated[StrokeRatio, reader(_read_stroke_ratio, None)]
MassInterval = Annotated[Interval, reader(read_interval, "mass")]
StiffnessInterval = Annotated[Interval, reader(read_interval, "stiffness")]
