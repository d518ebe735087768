"""Constraint terms: each limit of the problem file becomes labelled rows, low <= value <= high, elementwise.

A row's value is dimensionless or in rad and smooth wherever possible; `Scale` converts it to display units.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from optlink.linkage.dyads import RRR, Transmitting
from optlink.linkage.fourbar import (
    LENGTHS,
    crank_rocker_conditions,
    double_crank_conditions,
    transmission_cosine,
    turning_points,
)
from optlink.linkage.mechanism import Dyad, Pose
from optlink.linkage.vector2d import Value, angle_from, magnitude, turn, unit
from optlink.problem.design import DesignProblem
from optlink.problem.limits import COUPLER_JOINT, Limits, Reach, limits_in_file
from optlink.problem.machine.model import Problem
from optlink.problem.quantity import quantity_key
from optlink.problem.requirements.base import StartPosition
from optlink.problem.requirements.laws import DEAD_CENTRES
from optlink.units import in_si


@dataclass(frozen=True)
class Scale:
    """Conversion from a row's value to display units, with its derivative."""

    unit: str
    factor: float = 1.0
    cosine: bool = False
    offset: float = 0.0

    def to_display(self, value: float) -> float:
        """Return the value in `unit`; NaN for a cosine outside -1 ... 1."""
        if not self.cosine:
            return value * self.factor + self.offset
        return math.degrees(math.acos(value)) if abs(value) <= 1.0 else math.nan

    def to_internal(self, displayed: float) -> float:
        """Convert a value in `unit` to the row's value."""
        return math.cos(math.radians(displayed)) if self.cosine else (displayed - self.offset) / self.factor

    def slope(self, value: float) -> float:
        """Return the derivative of the displayed value with respect to the row's value."""
        return -math.degrees(1.0 / math.sqrt(max(1.0 - value * value, 1e-300))) if self.cosine else self.factor

    @property
    def in_si(self) -> tuple[float, float, str]:
        """Factor and offset from the row's value to the same value in SI, and its unit: a cosine remains a cosine."""
        size, unit = in_si(self.unit)
        return (1.0, 0.0, "") if self.cosine else (self.factor * size, self.offset * size, unit)


@dataclass(frozen=True)
class SquareRootScale(Scale):
    """Scale of a row whose value is the square of the displayed value: smooth also where a force vanishes."""

    def to_display(self, value: float) -> float:
        """Return the value in `unit`."""
        return math.sqrt(max(value, 0.0)) * self.factor

    def to_internal(self, displayed: float) -> float:
        """Convert a value in `unit` to the row's value."""
        return (displayed / self.factor) ** 2

    def slope(self, value: float) -> float:
        """Return the derivative of the displayed value with respect to the row's value."""
        return 0.5 * self.factor / math.sqrt(max(value, 1e-300))

    @property
    def in_si(self) -> tuple[float, float, str]:
        """Factor and offset from the row's value to the square in SI, and its unit."""
        size, unit = in_si(self.unit)
        return (self.factor * size) ** 2, 0.0, f"({unit})^2" if unit else ""


@dataclass(frozen=True)
class SineSquared(Scale):
    """Scale of a row whose value is the squared sine of the displayed angle."""

    def to_display(self, value: float) -> float:
        """Return the angle [deg], at most 90; NaN where the group cannot be assembled."""
        return math.degrees(math.asin(math.sqrt(min(value, 1.0)))) if value >= 0.0 else math.nan

    def to_internal(self, displayed: float) -> float:
        """Return the row's value of an angle [deg]."""
        return math.sin(math.radians(displayed)) ** 2

    def slope(self, value: float) -> float:
        """Return the derivative of the displayed angle with respect to the row's value."""
        return math.degrees(0.5 / math.sqrt(max(value * (1.0 - value), 1e-300)))

    @property
    def in_si(self) -> tuple[float, float, str]:
        """The squared sine as it is."""
        return 1.0, 0.0, ""


@dataclass(frozen=True)
class SIScale(Scale):
    """A scale whose displayed values are SI, in place of those of the scale `shown`."""

    shown: Scale = Scale("")

    @classmethod
    def of(cls, shown: Scale) -> SIScale:
        """Return the scale of the same rows in SI."""
        size, unit = in_si(shown.unit)
        return cls(unit, size, shown.cosine, shown=shown)

    def to_display(self, value: float) -> float:
        """Return the value in SI."""
        return self.shown.to_display(value) * self.factor

    def to_internal(self, displayed: float) -> float:
        """Convert a value in SI to the row's value."""
        return self.shown.to_internal(displayed / self.factor)

    def slope(self, value: float) -> float:
        """Return the derivative of the SI value with respect to the row's value."""
        return self.shown.slope(value) * self.factor

    @property
    def in_si(self) -> tuple[float, float, str]:
        """That of the scale `shown`."""
        return self.shown.in_si


def millimetres(size: float, origin: float = 0.0) -> Scale:
    """Return the scale of lengths that count in units of `size` from `origin` [m]."""
    return Scale("mm", 1e3 * size, offset=1e3 * origin)


DEGREES = Scale("deg", math.degrees(1.0))
COSINE = Scale("deg", cosine=True)
SINE_SQUARED = SineSquared("deg")
PLAIN = Scale("")


@dataclass(frozen=True)
class ConstraintRow:
    """One inequality (or equality if low = high) of the NLP.

    Rows with the same limit and label are one limit at several positions: they share one shadow price and are relaxed together.
    """

    limit: str  # key of the limit in the problem file
    label: str
    value: Value
    low: float
    high: float
    scale: Scale
    over_span: bool = False  # whether it applies over the span of the requirement alone, not over the whole revolution
    place: Value | None = None  # crank angle [rad] if it is one position of a limit over a motion, until the programme is built
    periodic: bool | None = None  # whether this motion is the whole revolution; None if it is no such position


Term = Callable[[DesignProblem, Mapping[str, Value], Reach, float], Iterator[ConstraintRow]]
"""(problem, values, requested crank angles, reference length [m]) -> rows"""


COSINE_ROUNDING = 1e-12  # cosines that differ by rounding alone
ALIGNED = "coupler and rocker not in line"


def full_rotation_rows(problem: DesignProblem, values: Mapping[str, Value], reach: Reach, size: float) -> Iterator[ConstraintRow]:
    """Yield the conditions for full rotation of the crank (linear, including the length margin)."""
    if problem.four_bar is None or problem.limits.crank == "span":
        return
    lengths = problem.four_bar.lengths(values)
    named = dict(zip(LENGTHS, lengths, strict=True))
    full = problem.limits.crank == "full rotation"
    conditions = crank_rocker_conditions if full else double_crank_conditions
    scale = millimetres(size)
    for label, slack in conditions(*lengths).items():
        words = label.split()
        if "+" not in words:
            yield ConstraintRow("limits.crank", label, slack / size, 0.0, math.inf, scale)
            continue
        # margin as a share of the second link of the longer side: if another link is longest its own sum implies this row
        least = problem.limits.length_margin * named[words[2]]
        yield ConstraintRow("limits.length_margin", label, (slack - least) / size, 0.0, math.inf, scale)


def dead_centres(problem: DesignProblem, values: Mapping[str, Value], reach: Reach, size: float) -> Iterator[ConstraintRow]:
    """Yield the conditions for the existence of the dead centre at which a law starts.

    At the inner dead centre, coupler and crank must differ in length: otherwise C coincides with A. For a crank with full
    rotation, Grashof's conditions imply both.
    """
    begin = problem.dead_centre
    if problem.four_bar is None or problem.limits.crank != "span" or begin is None:
        return
    r, a, b, f = problem.four_bar.lengths(values)
    key, scale, margin = "limits.length_margin", millimetres(size), problem.limits.length_margin
    line = a + r if begin == DEAD_CENTRES[0] else magnitude(a - r)
    for longest in (r, a, b, f):  # one row each, as their maximum is not smooth
        least = margin * longest
        yield ConstraintRow(key, "dead centre: C not too far from A", (b + f - line - least) / size, 0.0, math.inf, scale)
        for difference in (b - f, f - b):
            row = (line - difference - least) / size
            yield ConstraintRow(key, "dead centre: C not too near to A", row, 0.0, math.inf, scale)


@dataclass(frozen=True)
class CosineLimit:
    """Limits low <= cosine <= high of a transmission angle over the "revolution" or "span"; `key` states them in the file."""

    key: str
    low: float
    high: float
    over: str

    @property
    def pressure(self) -> bool:
        """Whether the file limits the pressure angle, whose squared sine is the squared cosine."""
        return self.key.startswith("limits.pressure_angle")

    def row(self, label: str, cosine: Value) -> ConstraintRow:
        """Return the row of the limit for a cosine at a joint or position, which the label names."""
        if self.pressure:
            return ConstraintRow(self.key, f"pressure angle{label}", cosine * cosine, -math.inf, self.high**2, SINE_SQUARED)
        return ConstraintRow(self.key, f"transmission angle{label}", cosine, self.low, self.high, COSINE)


def _cosine(angle: Value) -> Value:
    """Return the cosine of a limit [rad], or of an array of limits."""
    return np.cos(angle) if np.ndim(angle) else math.cos(angle)


def _chosen(condition: Value, one: Value, other: Value) -> Value:
    """Return one of two numbers, elementwise for an array of conditions."""
    return np.where(condition, one, other) if np.ndim(condition) else one if condition else other


def transmission_sides(problem: DesignProblem, joint: str = COUPLER_JOINT) -> Iterator[CosineLimit]:
    """Yield the limits of the cosine of the transmission angle at an outer joint of a dyad, those of the alignment included.

    A side of the transmission limit that is looser than the alignment limit is left out (infinite). Beside one that is as tight
    or tighter the alignment limit is kept: it remains enforced when the other one is relaxed.
    """
    limits, required = problem.limits, "span" if problem.limits.crank == "span" else "revolution"
    most = _cosine(limits.alignment.value)
    low, high, prescribed = -math.inf, math.inf, limits.transmission_at(joint)
    if prescribed is not None:
        low = -math.inf if prescribed.high is None else _cosine(prescribed.high)
        high = math.inf if prescribed.low is None else _cosine(prescribed.low)
    sides = _chosen(low >= -most - COSINE_ROUNDING, low, -math.inf), _chosen(high <= most + COSINE_ROUNDING, high, math.inf)
    if prescribed is not None and np.any((sides[0] > -math.inf) | (sides[1] < math.inf)):
        yield CosineLimit(prescribed.key, *sides, problem.limits.transmission_range)
    yield CosineLimit("limits.alignment", -most, most, required)


def transmission(problem: DesignProblem, values: Mapping[str, Value], reach: Reach, size: float) -> Iterator[ConstraintRow]:
    """Yield the limits of the transmission angle at its exact extremes, as cosines.

    The cosines are rational in the lengths and finite even where the linkage cannot be assembled.
    """
    if problem.four_bar is None:
        return
    lengths = problem.four_bar.lengths(values)
    for limit in transmission_sides(problem, problem.four_bar.joint):
        aligned = limit.key == "limits.alignment"
        if limit.over == "span":
            for phi in turning_points(reach.start - problem.four_bar.turned(values), reach.span):
                row = limit.row(" over the span", transmission_cosine(*lengths, np.cos(phi)))
                yield replace(row, label=ALIGNED if aligned else row.label, over_span=True)
        elif limit.pressure:
            for cosine in (1.0, -1.0):
                yield limit.row("", transmission_cosine(*lengths, cosine))
        else:
            sides = ("smallest", 1.0, -math.inf, limit.high), ("largest", -1.0, limit.low, math.inf)
            for which, cos_phi, low, high in sides:
                if np.any(low > -math.inf) or np.any(high < math.inf):
                    label = ALIGNED if aligned else f"{which} transmission angle"
                    yield ConstraintRow(limit.key, label, transmission_cosine(*lengths, cos_phi), low, high, COSINE)


def registered(problem: DesignProblem, values: Mapping[str, Value], reach: Reach, size: float) -> Iterator[ConstraintRow]:
    """Yield the limits of `optlink.problem.limits` that the file states."""
    for term, interval in limits_in_file(problem.limits):
        low, high = interval.bounds
        for label, value in term.values(problem, values, reach, interval):
            if interval.kind == "length":
                yield ConstraintRow(term.key, label, value / size, low / size, high / size, millimetres(size))
            else:
                yield ConstraintRow(term.key, label, value, low, high, DEGREES if interval.kind == "angle" else PLAIN)


def pivot_region_rows(problem: DesignProblem, values: Mapping[str, Value], reach: Reach, size: float) -> Iterator[ConstraintRow]:
    """Yield the limits of a rectangular region for the fixed pivots."""
    region = getattr(problem.limits, "pivots", None)  # of path synthesis
    if region is None:
        return
    pose = Pose(problem.linkage, values)
    for name, place in problem.linkage.ground.items():
        for axis, coordinate in zip("xy", pose.fixed(place), strict=True):
            interval = getattr(region, axis)
            if interval is not None:
                low, high = interval.bounds
                yield ConstraintRow(
                    "limits.pivots", f"pivot {name}.{axis}", coordinate / size, low / size, high / size, millimetres(size)
                )


def link_rows(problem: Problem, values: Mapping[str, Value], size: float) -> Iterator[ConstraintRow]:
    """Yield the bounds of the linked quantities; a length that may vanish is kept above zero."""
    for name, link in problem.links.items():
        quantity = problem.quantities[name]
        low, high = quantity.bounds
        if quantity.low is None and (quantity.kind != "length" or link.positive):
            continue
        unit, scale = (size, millimetres(size)) if quantity.in_metres else (1.0, DEGREES if quantity.kind == "angle" else PLAIN)
        yield ConstraintRow(quantity_key(problem, name), name, values[name] / unit, low / unit, high / unit, scale)


TERMS: tuple[Term, ...] = (
    *(full_rotation_rows, dead_centres, transmission, registered, pivot_region_rows),
    lambda problem, values, reach, size: link_rows(problem, values, size),
)
"""Limits of the dimensions; the first three are those of four-bars."""


def rows(problem: DesignProblem, values: Mapping[str, Value], reach: Reach, size: float) -> list[ConstraintRow]:
    """Return every row of the problem's limits, except those at single crank angles (`position_rows`); arguments: see `Term`."""
    return [row for term in TERMS for row in term(problem, values, reach, size)]


def position_rows(problem: DesignProblem, pose: Pose) -> list[ConstraintRow]:
    """Return the limits at one crank angle of any mechanism: transmission angles, and alignment of every group."""
    required = "span" if problem.limits.crank == "span" else "revolution"
    result = []
    for group in problem.linkage.groups:
        aligned = not isinstance(group, RRR)
        for limit in transmission_sides(problem, group.joint) if isinstance(group, Transmitting) else ():
            if limit.key == "limits.alignment":
                aligned = True
            elif isinstance(group, Transmitting):
                row = limit.row(f" at {group.joint}", group.cosine(pose))
                result.append(replace(row, over_span=limit.over != required))
        if aligned:
            result.append(alignment_row(problem.limits, group, group.alignment(pose)))
    return result


def region_rows(problem: DesignProblem, pose: Pose, *, over_span: bool) -> list[ConstraintRow]:
    """Return the limits of the regions at one crank angle, of those over the whole revolution or over the span."""
    size, required = problem.size, "span" if problem.limits.crank == "span" else "revolution"
    rows = []
    for name, region in problem.limits.regions.items():
        if ((region.over or required) == "span") is over_span:
            for distance in region.distances(pose.point(region.of), size):
                label, scale = f"{region.of} {region.side} {name}", millimetres(size)
                row = ConstraintRow(f"limits.{name}.clearance", label, distance / size, region.margin / size, math.inf, scale)
                rows.append(row)
    return rows


def alignment_row(limits: Limits, group: Dyad, value: Value) -> ConstraintRow:
    """Return the row that keeps a group away from the position where its assembly modes meet, from the squared sine there."""
    low = math.sin(limits.alignment.value) ** 2
    return ConstraintRow("limits.alignment", f"{group.joint} not aligned", value, low, math.inf, SINE_SQUARED)


# Objective terms: residuals that vanish for a perfect design, elementwise, with name and unit.


@dataclass(frozen=True)
class ErrorMeasure:
    """Reduction of residuals to one value: `unit` of that value, and `width`, the number of components per position."""

    name: str
    unit: str
    width: int = 1

    def sizes(self, residuals: ArrayLike) -> NDArray[np.float64]:
        """Return the size of the residual at each position."""
        r = np.asarray(residuals, dtype=float)
        sizes = np.abs(r) if self.width == 1 else np.sqrt(np.sum(np.square(r.reshape(-1, self.width)), axis=1))
        return np.asarray(sizes, dtype=float)

    def of(self, residuals: ArrayLike) -> float:
        """Return the value of the measure."""
        r = np.asarray(residuals, dtype=float).ravel()
        if self.name == "max":
            return float(np.max(self.sizes(r)))
        square = float(r @ r)
        return square if self.name == "sum of squares" else float(np.sqrt(square * self.width / r.size))

    @property
    def smooth_unit(self) -> str:
        """Unit of the objective of the NLP: of an rms the mean square."""
        return f"{self.unit}^2" if self.name == "rms" and self.unit else self.unit

    @property
    def rooted(self) -> bool:
        """Whether the value is the root of the objective of the NLP."""
        return self.name == "rms"

    def slope(self, residuals: ArrayLike) -> float:
        """Return the derivative with respect to the objective of the NLP (sum of squares, mean square, largest)."""
        return 0.5 / max(self.of(residuals), 1e-150) if self.rooted else 1.0


@dataclass(frozen=True)
class Figure(ErrorMeasure):
    """An objective with a single value."""

    def sizes(self, residuals: ArrayLike) -> NDArray[np.float64]:
        """Return the absolute value of the residuals."""
        return np.asarray(np.abs(np.asarray(residuals, dtype=float)), dtype=float)

    def of(self, residuals: ArrayLike) -> float:
        """Return the value of the objective."""
        return float(np.asarray(residuals, dtype=float).ravel()[0])

    @property
    def rooted(self) -> bool:
        """False: it is the objective of the NLP itself."""
        return False


def error_measures(unit: str, width: int = 1) -> dict[str, ErrorMeasure]:
    """Return every measure of residuals in a unit, by name; `width` is the number of components per position."""
    units = {"sum of squares": f"{unit}^2", "rms": unit, "max": unit}
    return {name: ErrorMeasure(name, display_unit, width) for name, display_unit in units.items()}


MEASURES = error_measures("rad")


def output_error(
    problem: DesignProblem, values: Mapping[str, Value], start: StartPosition, offset: Value, tabulated: Value
) -> Value:
    """Return prescribed minus actual rocker angle [rad], in (-pi, pi], elementwise.

    It is computed as the angle between two unit vectors, which avoids the branch cuts of both angles. `offset` [rad] is the crank
    rotation from the start, `tabulated` is `Law.tabulated` there.
    """
    pose = problem.linkage.pose(values, turn(start.crank, unit(offset)))
    target = problem.law.target(offset, tabulated, start.phi0, start.psi0)
    return angle_from(pose.direction(problem.output), unit(target))
