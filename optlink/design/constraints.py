"""Constraint terms: each limit of the problem file becomes labelled rows, low <= value <= high, elementwise.

A row's value is dimensionless or in rad and smooth wherever it can be; `Scale` tells what people read instead.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from optlink.design.generation import GenerationProblem, joint_cosine
from optlink.design.limits import Reach
from optlink.design.linkages import FourBarSection
from optlink.design.problem import DEAD_CENTRES, DesignProblem
from optlink.design.quantity import Interval
from optlink.linkage.elementwise import Value
from optlink.linkage.fourbar import (
    LENGTHS,
    crank_rocker_conditions,
    diagonal_squared,
    double_crank_conditions,
    lengths_of,
    swing,
    time_ratio,
    transmission_cosine,
    turning_points,
)
from optlink.linkage.groups import RRR
from optlink.linkage.mechanism import Pose


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


CLEARANCE = 1e-4
"""Share of the frame by which Grashof's sums must be met: at zero the linkage is a change-point linkage, no crank-rocker."""

FLAT = 1.0 - math.cos(math.radians(1.0))
"""What the cosine of the transmission angle of a generated linkage keeps from one, 1 deg: at one the assembly modes meet."""

DEGREES = Scale("deg", math.degrees(1.0))
COSINE = Scale("deg", cosine=True)
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


def crank(problem: AnyProblem, values: Mapping[str, Value], reach: Reach, size: float) -> Iterator[Row]:
    """The crank turns fully (linear conditions), or the mechanism can be assembled over the span."""
    lengths = lengths_of(values)
    millimetres = Scale("mm", 1e3 * size)
    if problem.limits.crank == "span":
        r, a, b, f = lengths
        cosines = [np.cos(phi) for phi in turning_points(reach.start, reach.span)]
        if isinstance(problem, GenerationProblem):
            yield from _bent(lengths, cosines)
            return
        for cos_phi in cosines:
            square = diagonal_squared(r, f, cos_phi) / size**2
            yield Row(
                "limits.crank",
                "B not too far from D",
                (a + b) * (a + b) / size**2 - square,
                0.0,
                math.inf,
                PLAIN,
            )
            yield Row(
                "limits.crank",
                "B not too near to D",
                square - (a - b) * (a - b) / size**2,
                0.0,
                math.inf,
                PLAIN,
            )
    else:
        full = problem.limits.crank == "full rotation"
        conditions = crank_rocker_conditions if full else double_crank_conditions
        for label, slack in conditions(*lengths).items():
            least = CLEARANCE if "+" in label else 0.0
            yield Row("limits.crank", label, slack / size, least, math.inf, millimetres)
        unlimited = problem.limits.transmission_angle is None and problem.limits.transmission_cosine is None
        if isinstance(problem, GenerationProblem) and (unlimited or problem.transmission_over != "revolution"):
            yield from _bent(lengths, [1.0, -1.0])
    if problem.limits.crank == "span" and problem.requirement.start in DEAD_CENTRES and "phi0" not in problem.quantities:
        r, a, b, f = lengths
        line = a + r if problem.requirement.start == DEAD_CENTRES[0] else a - r  # its sign does not matter
        square = line * line / size**2
        longest, shortest = (b + f) * (b + f) / size**2, (b - f) * (b - f) / size**2
        yield Row("requirement.from", "dead centre: C not too far from A", longest - square, 0.0, math.inf, PLAIN)
        yield Row("requirement.from", "dead centre: C not too near to A", square - shortest, 0.0, math.inf, PLAIN)


def _bent(lengths: tuple[Value, Value, Value, Value], cosines: Sequence[Value]) -> Iterator[Row]:
    """Coupler and rocker are never in line, where the assembly modes meet; `cosines` of the crank angles closest to that."""
    for cosine in cosines:
        value = transmission_cosine(*lengths, cosine)
        yield Row("limits.crank", "coupler and rocker not in line", value, FLAT - 1.0, 1.0 - FLAT, COSINE)


def transmission(problem: AnyProblem, values: Mapping[str, Value], reach: Reach, size: float) -> Iterator[Row]:
    """The transmission angle at its exact extremes, as cosines: rational in the lengths, finite even without assembly."""
    limits = problem.limits
    if limits.transmission_angle is not None:
        key, interval = "limits.transmission_angle", limits.transmission_angle
        low = -1.0 if interval.high is None else math.cos(interval.high)
        high = 1.0 if interval.low is None else math.cos(interval.low)
    elif limits.transmission_cosine is not None:
        key, interval = "limits.transmission_cosine", limits.transmission_cosine
        low = -1.0 if interval.low is None else interval.low
        high = 1.0 if interval.high is None else interval.high
    else:
        return
    lengths = lengths_of(values)
    if problem.transmission_over == "revolution":
        yield Row(key, "smallest transmission angle", transmission_cosine(*lengths, 1.0), -math.inf, high, COSINE)
        yield Row(key, "largest transmission angle", transmission_cosine(*lengths, -1.0), low, math.inf, COSINE)
        return
    for phi in turning_points(reach.start, reach.span):
        yield Row(
            key,
            "transmission angle over the span",
            transmission_cosine(*lengths, np.cos(phi)),
            low,
            high,
            COSINE,
        )


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
        value = time_ratio(*lengths, problem.side)
        yield Row("limits.time_ratio", "time ratio", value, *_within(problem.limits.time_ratio), PLAIN)


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


FOUR_BAR: tuple[Term, ...] = (crank, transmission, stroke, proportions)
GENERAL: tuple[Term, ...] = (pivots,)


def rows(problem: AnyProblem, values: Mapping[str, Value], reach: Reach, size: float) -> list[Row]:
    """Every row that the problem's limits ask for, but those of single crank angles (`position_rows`)."""
    terms = (*FOUR_BAR, *GENERAL) if isinstance(problem.mechanism, FourBarSection) else GENERAL
    return [row for term in terms for row in term(problem, values, reach, size)]


LEAST_MARGIN = 1e-4
"""Assembly margin that every group keeps: at zero its assembly modes meet."""


def position_rows(problem: GenerationProblem, pose: Pose) -> list[Row]:
    """Limits at one crank angle of any mechanism: every group closes, with the transmission angle asked for."""
    found = []
    interval = problem.limits.transmission_angle
    for group in problem.linkage.groups:
        found.append(Row("limits.crank", f"{group.joint} closes", pose.margins[group.joint], LEAST_MARGIN, math.inf, PLAIN))
        if interval is not None and isinstance(group, RRR):
            low = -1.0 if interval.high is None else math.cos(interval.high)
            high = 1.0 if interval.low is None else math.cos(interval.low)
            cosine = joint_cosine(pose, group)
            found.append(Row("limits.transmission_angle", f"transmission angle at {group.joint}", cosine, low, high, COSINE))
    return found
