"""Constraint terms: each limit of the problem file becomes labelled rows, low <= value <= high, elementwise.

A row's value is dimensionless or in rad and smooth wherever it can be; `Scale` tells what people read instead.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from optlink.linkage.dyad_types import RRR
from optlink.linkage.fourbar import (
    LENGTHS,
    crank_rocker_conditions,
    double_crank_conditions,
    lengths_of,
    swing,
    time_ratio,
    transmission_cosine,
    turning_points,
)
from optlink.linkage.mechanism import Group, Pose
from optlink.linkage.vector2d import Value, magnitude
from optlink.problem.function import DEAD_CENTRES, DesignProblem
from optlink.problem.limits import Alignment, Reach
from optlink.problem.mechanism import FourBarSection
from optlink.problem.path import GenerationProblem
from optlink.problem.quantity import Interval


@dataclass(frozen=True)
class Scale:
    """From a row's own value to the figure that people read, and its derivative."""

    unit: str
    factor: float = 1.0
    cosine: bool = False
    offset: float = 0.0

    def people(self, value: float) -> float:
        """The figure in `unit`; NaN for a cosine that no angle has."""
        if not self.cosine:
            return value * self.factor + self.offset
        return math.degrees(math.acos(value)) if abs(value) <= 1.0 else math.nan

    def own(self, people: float) -> float:
        """The row's own value of a figure in `unit`."""
        return math.cos(math.radians(people)) if self.cosine else (people - self.offset) / self.factor

    def slope(self, value: float) -> float:
        """d people / d value."""
        return -math.degrees(1.0 / math.sqrt(max(1.0 - value * value, 1e-300))) if self.cosine else self.factor


@dataclass(frozen=True)
class SineSquared(Scale):
    """A row that holds the squared sine of the angle that people read."""

    def people(self, value: float) -> float:
        """The angle [deg], 90 at most; NaN where the group cannot close."""
        return math.degrees(math.asin(math.sqrt(min(value, 1.0)))) if value >= 0.0 else math.nan

    def own(self, people: float) -> float:
        """The row's own value."""
        return math.sin(math.radians(people)) ** 2

    def slope(self, value: float) -> float:
        """d people / d value."""
        return math.degrees(0.5 / math.sqrt(max(value * (1.0 - value), 1e-300)))


DEGREES = Scale("deg", math.degrees(1.0))
COSINE = Scale("deg", cosine=True)
SINE_SQUARED = SineSquared("deg")
PLAIN = Scale("")


AnyProblem = DesignProblem | GenerationProblem


@dataclass(frozen=True)
class Row:
    """One inequality (or equality where low = high) of the programme.

    Rows of one limit with one label are the same limit asked at several positions: they have one price and give way together.
    """

    limit: str  # key of the limit in the problem file
    label: str
    value: Value
    low: float
    high: float
    scale: Scale


Term = Callable[[AnyProblem, Mapping[str, Value], Reach, float], Iterator[Row]]
"""(problem, values, crank angles asked for, reference length [m]) -> rows"""


SAME = 1e-12  # cosines that differ by rounding alone
ALIGNED = "coupler and rocker not in line"


def crank(problem: AnyProblem, values: Mapping[str, Value], reach: Reach, size: float) -> Iterator[Row]:
    """The crank turns fully (linear conditions, with the length margin in the sums)."""
    if problem.limits.crank == "span":
        return
    full = problem.limits.crank == "full rotation"
    conditions = crank_rocker_conditions if full else double_crank_conditions
    millimetres = Scale("mm", 1e3 * size)
    for label, slack in conditions(*lengths_of(values)).items():
        words = label.split()
        if "+" not in words:
            yield Row("limits.crank", label, slack / size, 0.0, math.inf, millimetres)
            continue
        # the share of the second link of the longer side: where another is longest its own sum implies this row
        least = problem.limits.length_margin * values[words[2]]
        yield Row("limits.length_margin", label, (slack - least) / size, 0.0, math.inf, millimetres)


def dead_centres(problem: AnyProblem, values: Mapping[str, Value], reach: Reach, size: float) -> Iterator[Row]:
    """The dead centre at which a law starts exists, and coupler and crank differ at the inner one: C would lie on A.

    Of a crank that turns fully Grashof's sums imply both.
    """
    begin = getattr(problem.requirement, "start", None)
    if problem.limits.crank != "span" or begin not in DEAD_CENTRES or "phi0" in problem.quantities:
        return
    r, a, b, f = lengths_of(values)
    key, millimetres, margin = "limits.length_margin", Scale("mm", 1e3 * size), problem.limits.length_margin
    line = a + r if begin == DEAD_CENTRES[0] else magnitude(a - r)
    for longest in (r, a, b, f):  # a row for each: the largest of them is not smooth
        least = margin * longest
        yield Row(key, "dead centre: C not too far from A", (b + f - line - least) / size, 0.0, math.inf, millimetres)
        for difference in (b - f, f - b):
            row = (line - difference - least) / size
            yield Row(key, "dead centre: C not too near to A", row, 0.0, math.inf, millimetres)


def sides(problem: AnyProblem) -> Iterator[tuple[str, float, float, str]]:
    """Limits of transmission cosines: (key, low, high, "revolution" or "span").

    A side of the transmission limit that is looser than the alignment says nothing and is left out (infinite); one that is as
    tight takes its place. Beside a tighter one the alignment stays: it still holds where that one has to give way.
    """
    limits, required = problem.limits, "span" if problem.limits.crank == "span" else "revolution"
    most = math.cos(limits.alignment.value)
    key, low, high = "limits.transmission_angle", -math.inf, math.inf
    if limits.transmission_angle is not None:
        low = -math.inf if limits.transmission_angle.high is None else math.cos(limits.transmission_angle.high)
        high = math.inf if limits.transmission_angle.low is None else math.cos(limits.transmission_angle.low)
    elif limits.transmission_cosine is not None:
        key = "limits.transmission_cosine"
        low, high = _within(limits.transmission_cosine)
    own = low if low >= -most - SAME else -math.inf, high if high <= most + SAME else math.inf
    if own != (-math.inf, math.inf):
        yield key, *own, problem.transmission_over
    same = problem.transmission_over == required
    floor = -math.inf if same and abs(own[0] + most) <= SAME else -most
    ceiling = math.inf if same and abs(own[1] - most) <= SAME else most
    if floor > -math.inf or ceiling < math.inf:
        yield "limits.alignment", floor, ceiling, required


def transmission(problem: AnyProblem, values: Mapping[str, Value], reach: Reach, size: float) -> Iterator[Row]:
    """The transmission angle at its exact extremes, as cosines: rational in the lengths, finite even without assembly."""
    lengths = lengths_of(values)
    for key, low, high, over in sides(problem):
        aligned = key == "limits.alignment"
        if over == "revolution":
            names = (ALIGNED, ALIGNED) if aligned else ("smallest transmission angle", "largest transmission angle")
            if high < math.inf:
                yield Row(key, names[0], transmission_cosine(*lengths, 1.0), -math.inf, high, COSINE)
            if low > -math.inf:
                yield Row(key, names[1], transmission_cosine(*lengths, -1.0), low, math.inf, COSINE)
            continue
        label = ALIGNED if aligned else "transmission angle over the span"
        for phi in turning_points(reach.start, reach.span):
            yield Row(key, label, transmission_cosine(*lengths, np.cos(phi)), low, high, COSINE)


def _within(interval: Interval | None) -> tuple[float, float]:
    if interval is None:
        return -math.inf, math.inf
    return (
        -math.inf if interval.low is None else interval.low,
        math.inf if interval.high is None else interval.high,
    )


def stroke(problem: AnyProblem, values: Mapping[str, Value], reach: Reach, size: float) -> Iterator[Row]:
    """Swing angle of the rocker and time ratio of its two strokes."""
    lengths = lengths_of(values)
    if problem.limits.swing_angle is not None:
        value = swing(*lengths, problem.side)
        yield Row("limits.swing_angle", "swing angle of the rocker", value, *_within(problem.limits.swing_angle), DEGREES)
    if problem.limits.time_ratio is not None:
        ratio = problem.limits.time_ratio
        value = time_ratio(*lengths, problem.side, ratio.stroke, reach.sense)
        label = f"time ratio, {ratio.strokes}" if ratio.stroke else "time ratio"
        yield Row("limits.time_ratio", label, value, *_within(ratio), PLAIN)


def proportions(problem: AnyProblem, values: Mapping[str, Value], reach: Reach, size: float) -> Iterator[Row]:
    """Frame length, and every moving link over the frame."""
    if problem.limits.frame_length is not None:
        low, high = _within(problem.limits.frame_length)
        yield Row(
            "limits.frame_length",
            "frame length",
            values["frame"] / size,
            low / size,
            high / size,
            Scale("mm", 1e3 * size),
        )
    if problem.limits.link_ratio is not None:
        low, high = _within(problem.limits.link_ratio)
        for name in LENGTHS[:3]:
            yield Row("limits.link_ratio", "moving link / frame", values[name] / values["frame"], low, high, PLAIN)


def pivots(problem: AnyProblem, values: Mapping[str, Value], reach: Reach, size: float) -> Iterator[Row]:
    """Every point of the frame within a rectangle."""
    region = problem.limits.pivots if isinstance(problem, GenerationProblem) else None
    if region is None:
        return
    pose = Pose(problem.linkage, values)
    for name, place in problem.linkage.ground.items():
        for axis, coordinate in zip("xy", pose.fixed(place), strict=True):
            interval = getattr(region, axis)
            if interval is not None:
                low, high = _within(interval)
                yield Row("limits.pivots", f"{name}.{axis}", coordinate / size, low / size, high / size, Scale("mm", 1e3 * size))


FOUR_BAR: tuple[Term, ...] = (crank, dead_centres, transmission, stroke, proportions)
GENERAL: tuple[Term, ...] = (pivots,)


def rows(problem: AnyProblem, values: Mapping[str, Value], reach: Reach, size: float) -> list[Row]:
    """Every row that the problem's limits ask for, but those of single crank angles (`position_rows`)."""
    terms = (*FOUR_BAR, *GENERAL) if isinstance(problem.mechanism, FourBarSection) else GENERAL
    return [row for term in terms for row in term(problem, values, reach, size)]


def position_rows(problem: GenerationProblem, pose: Pose) -> list[Row]:
    """Limits at one crank angle of any mechanism: transmission angles, and every group off the meeting of its assembly modes."""
    found, limited = [], list(sides(problem))
    aligned = any(key == "limits.alignment" for key, *_ in limited)
    for group in problem.linkage.groups:
        if isinstance(group, RRR):
            own = ((key, low, high) for key, low, high, _ in limited if key != "limits.alignment")
            label, cosine = f"transmission angle at {group.joint}", group.cosine(pose)
            found += [Row(key, label, cosine, low, high, COSINE) for key, low, high in own]
        if aligned or not isinstance(group, RRR):
            found.append(alignment_row(problem.limits, group, group.alignment(pose)))
    return found


def alignment_row(limits: Alignment, group: Group, value: Value) -> Row:
    """A group off the position where its assembly modes meet; `value` is its squared sine."""
    low = math.sin(limits.alignment.value) ** 2
    return Row("limits.alignment", f"{group.joint} not aligned", value, low, math.inf, SINE_SQUARED)
