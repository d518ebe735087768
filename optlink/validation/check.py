"""Checks of a validation, and the tolerances of limits."""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from optlink.linkage.dyads import RPR, RRR
from optlink.linkage.fourbar import LENGTHS, classify
from optlink.linkage.mechanism import Dyad
from optlink.linkage.motion import Motion
from optlink.linkage.vector2d import Array, finite_or, max_magnitude
from optlink.problem.document import Number
from optlink.problem.limits import Limits, Moved, TransmissionLimit, limits_in_file
from optlink.problem.machine.model import Problem
from optlink.problem.quantity import Interval

POSITIONS = 1440  # per revolution: every quarter of a degree; dead centres and extremes are refined
ANGLE_TOLERANCE = 1e-6  # deg; solvers satisfy limits to 1e-8 of a radian
LENGTH_TOLERANCE = 1e-9  # of the frame, or of the size of a curve
RATIO_TOLERANCE = 1e-7  # of ratios without unit
LONG_STEP = math.tau / 3.0  # rad; a law with longer steps between its positions can be met by whole revolutions less
FINE_STEP = math.radians(1.0)  # of the crank, at which an output is followed between positions
SAME = 1e-6  # relative difference of objectives that are the same
MEASURED = "objective measured in motion"
MEASURED_ROBUST = "error with tolerances measured in motion"
"""Names of the checks that compare the measured objective with that of the optimiser."""
SHORT_ROTATION = math.radians(30.0)  # of the crank; a rocker 1 deg off alignment turns by 240 deg in 70 deg of the crank at least


@dataclass(frozen=True)
class Check:
    """One check: the measured `value` and the allowed `limit`, in `unit`."""

    name: str
    passed: bool
    value: Number
    limit: str
    unit: str


KEY = r"(?:[\w.]+: )?"
LIMIT = re.compile(r"(>=|<=|=|)\s*([-+]?\d\S*(?: \.\.\. \S+)?)")
STATED = re.compile(
    r"(?!Grashof: )(?:[\w.]+: .+|.+, (?:least|largest)|stroke of .+"
    r"|(?:least|smallest|peak|largest) (?:transmission|pressure) angle(?: at .+)?)"
)
"""Names of limits that a file states, not of its bounds of dimensions or of the checks of the kinematics."""


@dataclass(frozen=True)
class Requirement:
    """A measured limit of a file: its bounds are equal for a prescribed value, and infinite for an open side."""

    name: str
    value: Number
    low: Number
    high: Number
    unit: str
    met: bool

    @property
    def margin(self) -> float:
        """Distance from the nearer bound, negative if the value is beyond it."""
        return min(self.value - self.low, self.high - self.value)


def requirements(checks: Iterable[Check]) -> Iterator[Requirement]:
    """Yield the measured limits of a file; both sides of a range, whose checks follow one another, are one."""
    stated = [check for check in checks if STATED.fullmatch(check.name) and LIMIT.fullmatch(check.limit)]
    for name, sides in itertools.groupby(stated, lambda check: re.sub(", (?:least|largest)$", "", check.name)):
        value, unit, low, high, met = math.nan, "", -math.inf, math.inf, True
        for check in sides:
            sense, text = LIMIT.fullmatch(check.limit).groups()  # type: ignore[union-attr]
            least, _, most = text.partition(" ... ")
            value, unit, met = check.value, check.unit, met and check.passed
            low = low if sense == "<=" else max(low, float(least))
            high = high if sense == ">=" else min(high, float(most or least))
        yield Requirement(re.sub(f"^{KEY}", "", name), value, low, high, unit, met)


@dataclass(frozen=True)
class Checks:
    """One check of many designs: arrays (designs,) of `passed` and `value`; texts may depend on the number of the design.

    `applies` (designs,): whether the check applies to a design. Default: to all.
    """

    name: Text
    passed: NDArray[np.bool_]
    value: Array
    limit: Text
    unit: str
    applies: NDArray[np.bool_] | None = None

    def of(self, design: int = 0) -> Check:
        """Return the check of one design."""
        name, limit = (text_of if isinstance(text_of, str) else text_of(design) for text_of in (self.name, self.limit))
        return Check(name, bool(each(self.passed, design)), float(each(self.value, design)), limit, self.unit)


Text = str | Callable[[int], str]


def each(values: ArrayLike, design: int) -> Any:
    """Return the value of one design from one for each, or from a single one that applies to all."""
    return np.ravel(values)[design if np.size(values) > 1 else 0]


def text(form: str, *numbers: ArrayLike) -> Text:
    """Return a text from a format string and the numbers of each design."""
    return lambda design: form.format(*(each(number, design) for number in numbers))


@dataclass(frozen=True, repr=False)
class Validation:
    """All checks of a design, and its measured objective [SI]."""

    checks: tuple[Check, ...]
    objective: Number

    def __repr__(self) -> str:
        failed = f", failed: {', '.join(self.failed)}" if self.failed else ""
        return f"<Validation: {len(self.checks) - len(self.failed)} of {len(self.checks)} checks passed{failed}>"

    @property
    def valid(self) -> bool:
        """Whether every check passed."""
        return not self.failed

    @property
    def failures(self) -> tuple[Check, ...]:
        """The checks that did not pass."""
        return tuple(check for check in self.checks if not check.passed)

    @property
    def failed(self) -> tuple[str, ...]:
        """Names of the checks that did not pass."""
        return tuple(check.name for check in self.failures)

    def with_checks(self, checks: Iterable[Check]) -> Validation:
        """Return the validation with further checks."""
        return replace(self, checks=(*self.checks, *checks))


@dataclass(frozen=True)
class Validations:
    """All checks of many designs, and their measured objectives (designs,) [SI]."""

    checks: tuple[Checks, ...]
    objective: Array

    @cached_property
    def valid(self) -> NDArray[np.bool_]:
        """Whether every check of a design passed, (designs,)."""
        valid = np.ones(self.objective.shape, dtype=bool)
        for check in self.checks:
            valid &= check.passed if check.applies is None else check.passed | ~check.applies
        return valid

    def of(self, design: int = 0) -> Validation:
        """Return the validation of one design."""
        applies = (check.of(design) for check in self.checks if check.applies is None or each(check.applies, design))
        return Validation(tuple(applies), float(self.objective[design]))


def joined(checks: Mapping[int, Sequence[Check]], count: int) -> Iterator[Checks]:
    """Yield the checks of single designs, by the number of the design and in the same order for each, as checks of all designs.

    They do not apply to designs that are left out.
    """
    numbers = np.array(list(checks), dtype=int)
    applies = np.isin(np.arange(count), numbers)
    for column in zip(*checks.values(), strict=True):
        passed, value, limits = np.zeros(count, dtype=bool), np.full(count, np.nan), np.full(count, "", dtype=object)
        passed[numbers], value[numbers] = [check.passed for check in column], [check.value for check in column]
        limits[numbers] = [check.limit for check in column]
        yield Checks(column[0].name, passed, value, text("{}", limits), column[0].unit, applies)


def bounds_and_links(problem: Problem, design: Mapping[str, ArrayLike], size: ArrayLike) -> Iterator[Checks]:
    """Yield the checks that quantities [m, rad] lie within their bounds, and that linked ones follow from the others.

    Both to 1e-8 of a reference length `size` [m] or of a radian.
    """
    values = {name: np.asarray(value, dtype=float) for name, value in design.items()}
    for name, quantity in problem.quantities.items():
        length, (factor, unit) = quantity.in_metres, quantity.display
        tolerance, value = 1e-8 * (np.asarray(size) if length else 1.0), values[name]
        if name in problem.links:
            with np.errstate(all="ignore"):
                linked = np.asarray(problem.links[name](values), dtype=float)
            same = np.abs(value - linked) <= tolerance
            yield Checks(f"{name} {quantity.status}", same, value * factor, text("= {:.6g}", linked * factor), unit)
        if name not in problem.links or quantity.low is not None or length:
            low, high = (np.asarray(end) for end in quantity.bounds)
            limit = text("= {:.6g}" if quantity.fixed else "{:.6g} ... {:.6g}", low * factor, high * factor)
            inside = (low - tolerance <= value) & (value <= high + tolerance)
            yield Checks(f"{name} within its bounds", inside, value * factor, limit, unit)


def length_check(lengths: Iterable[tuple[ArrayLike, ArrayLike, ArrayLike]], size: ArrayLike) -> Checks:
    """Check the largest deviation of all link lengths; NaN if one of them is not finite.

    For each link: its least and largest measured length, and its length [m]; `size` [m] is the reference.
    """
    misses = [np.maximum(largest - np.asarray(nominal), nominal - np.asarray(least)) for least, largest, nominal in lengths]
    worst, limit = np.max(misses, axis=0, initial=0.0) * 1e3, LENGTH_TOLERANCE * np.asarray(size) * 1e3
    return Checks("link lengths re-measured in motion", worst <= limit, worst, text("<= {:.1e}", limit), "mm")


def same_objective(
    measured: ArrayLike, claimed: ArrayLike, least: float, rounding: float = 0.0, *, squared: bool = False, same: float = SAME
) -> Checks:
    """Check that the measured objective is that of the optimiser: relatively, or within rounding of a deviation of nearly zero.

    `least`: objective to which differences of smaller ones are related. `rounding`: difference of two deviations that counts as
    rounding. `squared`: the objective is a sum of squared deviations. `same`: relative difference of equal objectives.
    """
    measured, claimed = np.asarray(measured, dtype=float), np.asarray(claimed, dtype=float)
    gap = np.abs(measured - claimed) / np.maximum(np.abs(measured), least)
    error, other = (np.sqrt(np.maximum(one, 0.0)) if squared else one for one in (measured, claimed))
    difference = np.abs(error - other)
    near, tiny = gap <= same, difference <= rounding  # NaN is neither
    limit = text("{}", np.where(near | ~tiny, f"<= {same:.0e}", f"<= {rounding:.0e}"))
    return Checks(MEASURED, near | tiny, np.where(near | ~tiny, gap, difference), limit, "")


def finely(offsets: Array) -> tuple[Array, NDArray[np.intp]]:
    """Return crank rotations between those of a law (monotonic) [rad], and the indices of its own among them."""
    steps = np.maximum(np.ceil(np.abs(np.diff(offsets)) / FINE_STEP), 1.0).astype(int)
    index = np.concatenate([[0], np.cumsum(steps)])
    return np.interp(np.arange(index[-1] + 1), index, offsets), index


def revolutions_check(crank: Array, target: Array, moved: Callable[[], Array]) -> Iterator[Checks]:
    """Yield the check that an output follows its law without an error of whole revolutions, which angles alone do not show.

    Positions where it is more than a quarter turn off do not count. Where the law and the output move by short steps, there is no
    such error and no check. Where a law with long steps or the output has no value, the check fails. (That any law has values is
    checked with the error.)

    At crank rotations (positions,) [rad] the output has the prescribed angles `target` (designs, positions) [rad], and, from
    `moved`, its own angles, continuous over its motion. NaN at the first position: the law of that design begins at the second.
    """
    begun = np.isfinite(target) | (np.arange(target.shape[1]) > 0)
    with np.errstate(invalid="ignore"):
        applies = np.any(np.abs(np.diff(target, axis=1)) > LONG_STEP, axis=1)
    if not np.any(applies) and max_magnitude(np.diff(crank)) <= SHORT_ROTATION:
        return
    actual = moved()
    with np.errstate(invalid="ignore"):
        applies |= np.any(np.abs(np.diff(actual, axis=1)) > LONG_STEP, axis=1)
    if not np.any(applies):
        return
    revolutions = (target - actual) / math.tau
    whole = np.round(finite_or(revolutions, np.nan))
    some = np.abs(revolutions - whole) < 0.25
    least, most = np.min(np.where(some, whole, np.inf), axis=1), np.max(np.where(some, whole, -np.inf), axis=1)
    range_of_errors = np.where(np.any(some, axis=1), most - least, 0.0)
    range_of_errors = np.where(np.all(np.isfinite(revolutions) | ~begun, axis=1), range_of_errors, np.nan)
    name = "output rotates as the law, without extra revolutions"
    yield Checks(name, range_of_errors == 0.0, range_of_errors, "= 0", "rev", applies)


def limit_checks(
    name: str, value: ArrayLike, interval: Interval, tolerance: ArrayLike, factor: float, unit: str
) -> Iterator[Checks]:
    """Yield one check per side of an interval [SI]; value and tolerance are in the unit, of which `factor` are an SI unit."""
    value, tolerance = np.asarray(value, dtype=float), np.asarray(tolerance)
    if interval.low is not None:
        low = interval.low * factor
        yield Checks(f"{name}, least", value >= low - tolerance, value, f">= {low:.6g}", unit)
    if interval.high is not None:
        high = interval.high * factor
        yield Checks(f"{name}, largest", value <= high + tolerance, value, f"<= {high:.6g}", unit)


def registered_checks(moved: Moved, limits: Limits, size: float, design: int = 0) -> Iterator[Check]:
    """Yield the checks of the limits of `optlink.problem.limits` that a file states; `size` [m] is the reference of tolerances.

    `design`: number of the design, if the limits differ between designs.
    """
    tolerances = {"angle": (ANGLE_TOLERANCE, math.degrees(1.0), "deg"), "length": (1e-8 * size * 1e3, 1e3, "mm")}
    for term, common in limits_in_file(limits):
        low, high = (None if end is None else each(end, design) for end in (common.low, common.high))
        interval = replace(common, low=low, high=high)
        tolerance, factor, unit = tolerances.get(str(interval.kind), (RATIO_TOLERANCE, 1.0, ""))
        for name, value in term.measure(moved, interval):
            yield from (check.of() for check in limit_checks(name, value * factor, interval, tolerance, factor, unit))


def transmission_checks(
    least: ArrayLike, largest: ArrayLike, limit: TransmissionLimit | None, where: str = ""
) -> Iterator[Checks]:
    """Yield the checks of the extreme transmission angles [deg], or of the largest pressure angle if the file limits that.

    `where`: the joint, if there are several.
    """
    if limit is None:
        return
    least, largest = np.asarray(least, dtype=float), np.asarray(largest, dtype=float)
    low, high = (None if bound is None else np.degrees(bound) for bound in (limit.low, limit.high))
    kind = "transmission"
    if limit.pressure and high is not None:
        kind, low, high, largest = "pressure", None, high - 90.0, np.maximum(90.0 - least, largest - 90.0)
    if low is not None:
        name = f"smallest transmission angle{where}"
        yield Checks(name, least >= low - ANGLE_TOLERANCE, least, text(">= {:.6g}", low), "deg")
    if high is not None:
        name = f"largest {kind} angle{where}"
        yield Checks(name, largest <= high + ANGLE_TOLERANCE, largest, text("<= {:.6g}", high), "deg")


# Check the distance of a mechanism from singular positions, measured in motion as angles and lengths.
#
# The optimiser's formulas are not used: the angle between two links follows from measured distances of their joints.

SHORT = 5e-3
"""Share by which a design may fall short of a least margin: solvers meet the cosine of 0.1 deg to 1e-8, which is 3e-3 of it."""


def at_least(name: Text, value: ArrayLike, limit: ArrayLike, unit: str) -> Checks:
    """Check whether a value [unit] reaches a least margin [unit]; NaN does not."""
    value, limit = np.asarray(value, dtype=float), np.asarray(limit, dtype=float)
    return Checks(name, value >= limit * (1.0 - SHORT), value, text(">= {:.6g}", limit), unit)


def grashof_check(each: Sequence[ArrayLike], limits: Limits) -> Checks:
    """Check whether the crank of a four-bar turns fully; `each`: lengths [m] of crank, coupler, rocker and frame.

    The sum of shortest and longest link must be below that of the other two by the length margin.
    """
    lengths = np.array(np.broadcast_arrays(*map(np.atleast_1d, each)), dtype=float)
    shortest, second, third, longest = np.sort(lengths, axis=0)
    turning = "frame" if limits.crank == "double-crank" else "crank"  # the shortest link of the required inversion
    slack, margin = second + third - shortest - longest, limits.length_margin * longest
    check = at_least(lambda k: f"Grashof: {classify(*lengths[:, k].tolist()).inversion.value}", slack * 1e3, margin * 1e3, "mm")
    return replace(check, passed=check.passed & (slack > 0.0) & (np.argmin(lengths, axis=0) == LENGTHS.index(turning)))


def included_cosine(one: ArrayLike, other: ArrayLike, square: Array) -> Array:
    """Return the cosine of the angle between two links, by the law of cosines; beyond -1 ... 1 where they do not meet.

    From their measured lengths [m], and the square of the distance of their ends [m^2].
    """
    one, other = np.asarray(one), np.asarray(other)
    return np.asarray((one * one + other * other - square) / (2.0 * one * other))


def squared_sines(motion: Motion) -> Array:
    """Return the squared sine of the angle of each group from alignment (groups, ...); negative or NaN if not closed."""
    sines, crank = [], motion.mechanism.crank
    for group in motion.mechanism.groups:
        if isinstance(group, RRR):
            (p, q), c = (motion.position(name) for name in group.outer), motion.position(group.joint)
            first, second = (_median(np.linalg.norm(c - pin, axis=-1)) for pin in (p, q))
            cosine = included_cosine(first, second, np.sum((q - p) ** 2, axis=-1))
            sines.append(1.0 - cosine * cosine)
        elif isinstance(group, RPR):  # the slide, relative to the crank length
            places = [motion.position(name) for name in (*group.outer, crank.start, crank.end)]
            apart, arm = (np.sum((places[k] - places[k + 1]) ** 2, axis=-1) for k in (0, 2))
            sines.append(motion.margin(group.joint) * apart / arm)
        else:
            sines.append(motion.margin(group.joint))
    return np.array(sines).reshape(len(motion.mechanism.groups), *motion.shape)


def _median(values: Array) -> Array:
    """Return the median (..., 1) of the finite ones of values (..., n), without numpy's masked arrays; NaN if there is none."""
    rising = np.sort(finite_or(values, np.nan), axis=-1)
    count = np.count_nonzero(np.isfinite(values), axis=-1, keepdims=True)
    low, high = (np.take_along_axis(rising, np.maximum(place, 0), axis=-1) for place in ((count - 1) // 2, count // 2))
    return 0.5 * (low + high)


def alignment_check(group: Dyad, single: bool, sine: ArrayLike, limits: Limits, where: str) -> Checks:
    """Check that a group, the `single` one or one of several, keeps its least angle from alignment over the motion `where`.

    `sine`: least squared sine of that angle; negative or NaN if the group does not close.
    """
    joint = " and ".join(link.body for link in group.links) if single and isinstance(group, RRR) else group.joint
    with np.errstate(invalid="ignore"):
        angle = np.degrees(np.arcsin(np.sqrt(np.minimum(sine, 1.0))))
    return at_least(f"{joint} off alignment over {where}", angle, math.degrees(limits.alignment.value), "deg")
