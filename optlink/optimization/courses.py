"""What holds over a range of crank angles: limits, errors of laws, quantities of the machine; in symbols and in numbers.

A course is traced by the programme at one crank angle, and evaluated by the exchange along its motion.
"""

import copy
import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import casadi
import numpy as np

from optlink.linkage.mechanism import Pose
from optlink.linkage.vector2d import Array, Value, finite_or, max_magnitude
from optlink.optimization.nlp import Variable
from optlink.optimization.output_errors import ErrorResiduals
from optlink.optimization.terms import (
    DEGREES,
    PLAIN,
    ConstraintRow,
    Scale,
    SquareRootScale,
    alignment_row,
    position_rows,
    region_rows,
)
from optlink.problem.design import EPIGRAPH, DesignProblem
from optlink.problem.limits import Bound
from optlink.problem.requirements.values import GRID
from optlink.problem.terms import Goal, Term
from optlink.units import KINDS, factor

if TYPE_CHECKING:
    from optlink.optimization.cycle_signals import EventOrder, TracedCycle


# Rows of quantities of the machine: their limits, and their largest values, which lie below a level.


@dataclass(frozen=True)
class ScaledLimit:
    """A limit in units of `size` [SI]: its bounds and the scale of its rows."""

    bound: Bound
    size: float
    below: float
    above: float
    scale: Scale

    def row(self, figure: Any) -> ConstraintRow:
        """Return the row of a term with a single value [SI]."""
        return ConstraintRow(self.bound.key, self.bound.term.words, figure / self.size, self.below, self.above, self.scale)

    def rows_at(self, parts: Sequence[Any]) -> Iterator[ConstraintRow]:
        """Yield the rows of a term at one position from its components there [SI]."""
        term = self.bound.term
        if term.nature.vector:
            scale = SquareRootScale(self.scale.unit, self.scale.factor)
            for x, y in _vectors(parts):
                square = (x * x + y * y) / self.size**2
                yield ConstraintRow(self.bound.key, term.words, square, -math.inf, self.above**2, scale)
            return
        for part, sign in itertools.product(parts, (1.0, -1.0) if term.how == "peak" else (1.0,)):
            yield self.row(sign * part)


def scaled_limit(bound: Bound, length: float) -> ScaledLimit:
    """Return a limit in units of its larger bound, else of a length [m] or 1."""
    interval = bound.interval
    kind = interval.kind or ""
    ends = [abs(x) for x in (interval.low, interval.high) if x is not None]
    size = max(ends) or (length if kind in ("length", "coordinate") else 1.0)
    scale = Scale(interval.unit, size / factor(interval.unit or KINDS[kind].display, kind)) if kind else Scale("", size)
    below = -math.inf if interval.low is None else interval.low / size
    above = math.inf if interval.high is None else interval.high / size
    return ScaledLimit(bound, size, below, above, scale)


def _vectors(parts: Sequence[Any]) -> Iterator[tuple[Any, Any]]:
    """Return the vectors of which these are the components: one, or those there and back."""
    return zip(parts[::2], parts[1::2], strict=True)


SIGNS = {"peak": (1.0, -1.0), "largest": (1.0,), "least": (-1.0,)}
"""Signs of the values whose largest is an extreme."""


def rows_below_level(goal: Goal, size: float, level: Any, parts: Sequence[Any]) -> Iterator[ConstraintRow]:
    """Yield the rows that keep the values at one position, in units of `size` [SI], below a level."""
    label = f"{goal.words} at another position"
    if goal.nature.vector:
        for x, y in _vectors(parts):
            yield ConstraintRow(EPIGRAPH, label, level * level - (x * x + y * y) / size**2, 0.0, math.inf, PLAIN)
        return
    for part, sign in itertools.product(parts, SIGNS[goal.how]):
        yield ConstraintRow(EPIGRAPH, label, level - sign * part / size, 0.0, math.inf, PLAIN)


def heights_at(goal: Goal, size: float, parts: Sequence[Any]) -> list[Any]:
    """Return the values at one position whose largest is the level of a term, in units of `size` [SI]."""
    if goal.nature.vector:
        return [casadi.sqrt(x * x + y * y) / size for x, y in _vectors(parts)]
    return [(casadi.fabs(part) if goal.how == "peak" else SIGNS[goal.how][0] * part) / size for part in parts]


EVENT = "end of a stroke"
"""Name of the rows that define the crank angles at which motions reverse, and beginning of those of these unknowns."""
FEWEST = 4  # positions per stroke
BETWEEN = 3  # positions between two points if full crank rotation is not required
SMALL_INTEGRAL = 1e-6  # of the integral of the largest value: share below which an integral counts as zero
NODES = 48  # positions per revolution of quantities of the machine with an integral; half of it for extremes alone
EXCHANGE_POINTS = 24  # further positions, moved by the exchange method to where a limit or the largest value is exceeded
SLOTS = (4, 6)  # the same per stroke, least and most, where nothing else counts over a range
LEVEL_POINTS = 12  # the same for the largest error of a law alone; with scatter it is flatter, and has as many as others
SIZE_POSITIONS = 72  # crank angles at which the size of a quantity is estimated
EXCEEDED = 2e-9  # permitted excess over a limit, in the unit of its row: less than the validator's tolerance
LEVELLED, NO_ERROR = 1e-8, 1e-12  # permitted excess over a largest value, as a share of it, and in scaled units
LEAST_LEVEL = 1e-9  # scaled units: excesses over a smaller largest value are shares of this one


def has_position_limits(problem: DesignProblem) -> bool:
    """Return whether limits at single crank angles (`position_rows`) apply; for a four-bar the extremes are known instead."""
    return not problem.four_bar


def extent_of(problem: DesignProblem) -> tuple[float, float]:
    """Return where the whole motion of the drive begins and its rotation [rad]: a revolution, or its range."""
    low, high = problem.linkage.extent
    return low, high - low


class LimitCourse:
    """Limits at single crank angles, over the whole revolution or along the motion of a requirement, `part`.

    `over_span`: of the limits that apply over the span although the crank turns fully; None for all limits.
    """

    def __init__(self, problem: DesignProblem, part: DesignProblem | None, over_span: bool | None) -> None:
        self.problem, self.part, self.over_span = problem, part, over_span

    def rows(self, pose: Pose) -> list[ConstraintRow]:
        """Return the limits at one position."""
        return [row for row in position_rows(self.problem, pose) if self.over_span in (None, row.over_span)]

    def motion(self, angles: Any) -> tuple[Any, Any]:
        """Return the crank angle [rad] at which the motion begins, and its rotation, for the crank angles of the requirement."""
        return extent_of(self.problem) if self.part is None else (angles[0], angles[-1] - angles[0])

    def fixed_positions(self, angles: Any) -> list[Any]:
        """Return the crank angles [rad] at which the limits always apply."""
        if self.part is None:
            return list(np.linspace(*self.problem.linkage.extent, GRID, endpoint=self.problem.linkage.limits is not None))
        between = [a + (b - a) * (k / (BETWEEN + 1)) for a, b in itertools.pairwise(angles) for k in range(BETWEEN + 1)]
        return [*between, angles[-1]]

    def heights(self, values: Mapping[str, Value], angles: Any, shares: Array) -> Array:
        """Return the excess (rows, n) or (rows, designs, n) over every limit, in the units of the rows; -inf if undefined.

        Positions without assembly exceed the row of the assembly margin. `values` [m, rad] and the crank angles [rad] of the
        requirement are numbers or arrays (designs, 1); `shares` (n,) are positions as shares of the motion.
        """
        begin, whole = self.motion(angles)
        with np.errstate(all="ignore"):
            rows = self.rows(self.problem.linkage.at(values, begin + whole * shares))
            over = [np.maximum(row.low - row.value, row.value - row.high) for row in rows]
            excesses = np.array(np.broadcast_arrays(*over, begin + shares)[:-1])
        return finite_or(excesses, -np.inf)


class RegionCourse(LimitCourse):
    """Regions that points stay in or out of, over the whole revolution or along the motion of a requirement, `part`."""

    def rows(self, pose: Pose) -> list[ConstraintRow]:
        """Return the limits at one position."""
        return region_rows(self.problem, pose, over_span=bool(self.over_span))


class ErrorCourse:
    """The error of a law over its span, or the cosines of the transmission angles over the revolution."""

    def __init__(self, part: DesignProblem) -> None:
        self.part = part

    def level(self, problem: DesignProblem) -> int:
        """Return the number of its largest value among the unknowns of a programme; -1 if it is limited."""
        if self.part.tolerance is not None:
            return -1
        levelled = [part for part in problem.parts if part.tolerance is None and part.measure == "max"]
        return next(k for k, part in enumerate(levelled) if part is self.part)

    def motion(self, span: Any = None) -> tuple[Any, Any]:
        """Return begin and rotation [rad], from the start; `span` replaces that of the law."""
        return (0.0, self.part.span if span is None else span) if self.part.law_given else extent_of(self.part)

    @cached_property
    def _errors(self) -> ErrorResiduals:
        return ErrorResiduals(self.part)

    def sizes(self, values: Mapping[str, Value], shares: Array) -> Array:
        """Return the errors (rows, n) in scaled units.

        One row for either sign of a law and of a cosine with its scatter, else one for the cosine of each dyad.
        """
        begin, whole = self.motion()
        offsets = begin + whole * shares
        with np.errstate(all="ignore"):
            if self.part.law_given:
                lower, upper = self._errors.band(values, offsets)
                sizes = np.array([-lower + 0.0 * shares, upper + 0.0 * shares])
            else:
                cosines, signs = self._errors.cosines(values, offsets), itertools.cycle((1.0, -1.0))
                ends = map(np.abs, cosines) if self.part.robust is None else map(np.multiply, cosines, signs)
                sizes = np.array([end + 0.0 * shares for end in ends])
        return finite_or(sizes, -np.inf) / self.part.whole

    def heights(self, values: Mapping[str, float], level: float | None, shares: Array) -> Array:
        """Return the excess (rows, n) of the errors over the largest one (scaled), else over the tolerance."""
        sizes = self.sizes(values, shares)
        if level is not None:
            return above_level(sizes, level)
        assert self.part.tolerance is not None
        return sizes - self.part.tolerance / self.part.whole - EXCEEDED


class TermCourse:
    """Quantities of the machine over the revolution: terms of the objective and limits under names of the user's choice.

    Forces jump where a motion reverses, so that the revolution is divided at such events: their crank angles are unknowns of the
    programme, and each stroke from one event to the next is a course of its own. It describes designs with the events of
    `structure` in that order; by default those of a design `near`, at which the largest values of the terms are their units.
    `count`: positions per revolution of integrals; `sizes`: other units [SI].
    """

    def __init__(
        self,
        problem: DesignProblem,
        near: Mapping[str, float] | None,
        trace: "TracedCycle | None" = None,
        structure: "EventOrder | None" = None,
        count: int = NODES,
        sizes: Sequence[float] = (),
    ) -> None:
        from optlink.optimization.cycle_signals import TracedCycle

        self.problem, self.goals, self.near, self.count = problem, problem.goals, dict(near or {}), count
        trace = TracedCycle(problem, slow=problem.slow_assumed) if trace is None else trace
        structure = (trace.structure(self.near) or trace.assumed) if structure is None else structure
        self.structure, self.trace = structure, trace.with_slow(structure)
        self.cuts = self.trace.cuts(structure)
        self.extremes = [goal for goal in self.goals if goal.extreme]
        scaled = [scaled_limit(bound, problem.longest) for bound in problem.bounds]
        self.limits = [limit for limit in scaled if limit.bound.term.extreme]
        self.fixed_limits = [limit for limit in scaled if not limit.bound.term.extreme]
        self.integral = any(term.integral for term in self.trace.terms)
        self.sizes = list(sizes) or self._sizes()
        self.worths = [goal.weight / (scale or 1.0) for goal, scale in zip(self.goals, problem.scales, strict=True)]
        self.levels = []
        for goal, size in zip(self.extremes, self.sizes, strict=True):
            kind = problem.kind(goal)
            scale = Scale(KINDS[kind].si.replace("**", "^") if kind else "", size)
            self.levels.append(Variable(f"{EPIGRAPH}: {goal.words}", size, scale))
        self.events = [Variable(f"{EVENT} {k + 1}", 1.0, DEGREES) for k in range(len(structure.which))]

    def __reduce__(self) -> tuple[Any, ...]:
        return TermCourse, (self.problem, self.near, self.trace, self.structure, self.count, self.sizes)

    def of(self, problem: DesignProblem) -> "TermCourse":
        """Return the course of another problem with the same terms, whose limits may differ."""
        if problem is self.problem:
            return self
        other = copy.copy(self)
        bounds = [replace(own, interval=new.interval) for own, new in zip(self.problem.bounds, problem.bounds, strict=True)]
        other.problem, scaled = problem, [scaled_limit(bound, problem.longest) for bound in bounds]
        other.limits = [limit for limit in scaled if limit.bound.term.extreme]
        other.fixed_limits = [limit for limit in scaled if not limit.bound.term.extreme]
        return other

    @property
    def recipe(self) -> dict[str, Any]:
        """From what `course_again` makes the same course of a problem."""
        events = {"events": vars(self.structure), "loads": self.trace.slow, "values": self.trace.values}
        return {"near": self.near, "count": self.count, "sizes": list(self.sizes)} | (events if self.events else {})

    # --- positions

    @property
    def strokes(self) -> int:
        """Number of parts into which events divide the cycle."""
        return self.cuts + 1 if self.trace.limited else max(1, self.cuts) * self.trace.repeats

    @property
    def ended(self) -> bool:
        """Whether strokes have ends: quantities are not periodic, and may be largest there."""
        return self.cuts > 0 or self.trace.limited

    @property
    def whole(self) -> float:
        """Crank rotation [rad] over which quantities of the cycle are means."""
        return (self.trace.high - self.trace.low) * self.trace.repeats

    @cached_property
    def nodes(self) -> tuple[Array, Array]:
        """Shares of a stroke at which the terms always count, and their weights in the mean over the stroke."""
        return self._rule(self.count if self.integral else self.count // 2)

    def _rule(self, count: int) -> tuple[Array, Array]:
        """Return shares and weights of Gauss's rule; without events even steps integrate smooth periodic functions best."""
        if not self.ended:
            return np.arange(count) / count, np.full(count, 1.0 / count)
        least = FEWEST * (2 if self.integral else 1)
        shares, weights = np.polynomial.legendre.leggauss(max(least, math.ceil(count / max(1, self.cuts))))
        return 0.5 * (shares + 1.0), 0.5 * weights

    def integral_error(self, values: Mapping[str, float], events: Array) -> float:
        """Return the largest change of an integral of a design by twice as many positions, as a share of it."""
        motions, last = list(self.motions(values, events)), sum(self.trace.widths) - 1
        figures: list[list[tuple[float, float]]] = []
        for shares, weights in (self.nodes, self._rule(2 * self.count)):
            each = [(motion.span * weights, motion.signals(shares)) for motion in motions]
            figures.append([])
            for term in (term for term in self.trace.terms if term.integral):
                work = term.quantity == "work"
                rows = [(weight, [signals[last]] if work else self.parts(term, signals)) for weight, signals in each]
                square = term.how == "rms"
                sums = [np.sum(weight * (np.square(part) if square else part)) for weight, parts in rows for part in parts]
                size = max(max_magnitude(part) for _, parts in rows for part in parts) ** (2 if square else 1)
                figures[-1].append((math.fsum(sums), (self.trace.high - self.trace.low) * size))
        pairs = zip(*figures, strict=True)
        return max((abs(a - b) / max(abs(b), SMALL_INTEGRAL * size, 1e-300) for (a, _), (b, size) in pairs), default=0.0)

    def event_angles(self, values: Mapping[str, float]) -> tuple[float, ...] | None:
        """Return the crank angles [rad] of the events of a design [SI]; None if they are others, or in another order."""
        structure = self.trace.structure(values)
        return structure.angles if structure is not None and structure.like(self.structure) else None

    def motions(self, values: Mapping[str, float], events: Array) -> Iterator["Motion"]:
        """Yield the strokes of a design, with the crank angles [rad] of its events."""
        inputs = self.trace.inputs(values)
        for begin, end in itertools.pairwise(self.trace.edges(events[: self.cuts].tolist())):
            senses = np.asarray(self.trace.sensed([*inputs, begin + 0.5 * (end - begin)]), dtype=float).ravel()
            yield Motion(self.trace, inputs, begin, end - begin, senses)

    def _sizes(self) -> list[float]:
        """Return the largest values [SI] of the terms of the objective at a design; their scale or 1 where they have none."""
        shares = np.linspace(0.0, 1.0, math.ceil(SIZE_POSITIONS / max(1, self.cuts)), endpoint=self.ended)
        events = np.array(self.structure.angles)
        with np.errstate(all="ignore"):
            each = [motion.signals(shares) for motion in self.motions(self.problem.complete(self.near), events)]
        sizes = []
        for goal in self.extremes:
            scale, squares = self.problem.scales[self.goals.index(goal)], [self.parts(goal, signals) for signals in each]
            size = max(float(np.max(np.sqrt(np.sum(np.square(parts), axis=0)))) for parts in squares)
            sizes.append(size if math.isfinite(size) and size > 0.0 else scale or 1.0)
        return sizes

    def parts(self, term: Term, signals: Any) -> list[Any]:
        """Return the components of a term [SI] among the signals at one position, or at many."""
        index = next(k for k, other in enumerate(self.trace.cyclic) if other is term)
        first = sum(self.trace.widths[:index])
        return [signals[first + k] for k in range(self.trace.widths[index])]

    def alignment_rows(self, signals: Any) -> Iterator[ConstraintRow]:
        """Yield the rows that keep every group away from where its assembly modes meet; beside targets others do."""
        first = sum(self.trace.widths)
        for k, group in enumerate(self.trace.mechanism.groups if not self.problem.parts else ()):
            yield alignment_row(self.problem.limits, group, signals[first + k])

    # --- heights of peaks

    @cached_property
    def level_numbers(self) -> list[int]:
        """For each row at one position, the number of the largest value that it concerns; -1 for a limit."""
        widths = [(self._rows_of(limit.bound.term), -1) for limit in self.limits]
        widths += [(self._rows_of(goal), k) for k, goal in enumerate(self.extremes)]
        widths += [(len(self.trace.mechanism.groups), -1)] if not self.problem.parts else []
        return [level for count, level in widths for _ in range(count)]

    def _rows_of(self, term: Term) -> int:
        """Return the number of rows of a term at one position."""
        width = self.trace.widths[next(k for k, other in enumerate(self.trace.cyclic) if other is term)]
        return width // 2 if term.nature.vector else width * (2 if term.how == "peak" else 1)

    def heights(self, motion: "Motion", levels: Array, shares: Array) -> Array:
        """Return the excess (rows, n) of all terms over their limits or largest values along a stroke."""
        with np.errstate(all="ignore"):
            signals = motion.signals(shares)
            rows: list[Array] = []

            def values(term: Term, size: float, signs: tuple[float, ...]) -> list[Array]:
                parts = self.parts(term, signals)
                if term.nature.vector:
                    return [np.hypot(x, y) / size for x, y in _vectors(parts)]
                return [sign * part / size for part in parts for sign in signs]

            for limit in self.limits:
                term = limit.bound.term
                for value in values(term, limit.size, SIGNS["peak"] if term.how == "peak" else (1.0,)):
                    rows.append(_beyond(value, limit.below, limit.above) - EXCEEDED)
            for goal, size, level in zip(self.extremes, self.sizes, levels, strict=True):
                rows += [above_level(value, float(level)) for value in values(goal, size, SIGNS[goal.how])]
            rows += [_beyond(row.value, row.low, row.high) - EXCEEDED for row in self.alignment_rows(signals)]
            heights = np.array(rows).reshape(-1, len(shares))
        return finite_or(heights, -np.inf)


@dataclass(frozen=True)
class Motion:
    """A stroke of a design: inputs of the trace, crank angle at its begin and rotation [rad], senses of motion."""

    trace: "TracedCycle"
    inputs: Sequence[float]
    begin: float
    span: float
    senses: Array

    def signals(self, shares: Array) -> Array:
        """Return the signals at shares of the stroke, one-sided at its ends."""
        return self.trace.signals(*self.inputs, self.begin + self.span * shares, *self.senses)


def course_again(problem: DesignProblem, recipe: Mapping[str, Any]) -> TermCourse | None:
    """Return the course of the quantities of the machine that a programme with this `recipe` has; None if it has none."""
    if not problem.goals and not problem.bounds:
        return None
    if "events" not in recipe:
        return TermCourse(problem, recipe["near"], count=recipe["count"], sizes=recipe["sizes"])
    from optlink.optimization.cycle_signals import EventOrder, TracedCycle

    order = EventOrder(**{name: tuple(items) for name, items in recipe["events"].items()})
    trace = TracedCycle(problem, recipe["values"], recipe["loads"])
    return TermCourse(problem, recipe["near"], trace, order, recipe["count"], recipe["sizes"])


def _beyond(value: Array, low: float, high: float) -> Array:
    """Return by how much values lie beyond two bounds; negative inside."""
    return np.maximum(low - value, value - high)


def above_level(values: Array, level: float) -> Array:
    """Return by how much values (scaled) exceed a level beyond rounding, as shares of it."""
    return (values - level - LEVELLED * abs(level) - NO_ERROR) / max(abs(level), LEAST_LEVEL)


def limit_courses(problem: DesignProblem) -> list[LimitCourse]:
    """Return the courses of limits at single crank angles: over the revolution, and along the motion of each requirement."""
    pose = problem.linkage.at(problem.complete({}), 0.0)
    regions = [RegionCourse(problem, None, False), *(RegionCourse(problem, part, True) for part in problem.parts)]
    with np.errstate(all="ignore"):
        regions = [course for course in regions if course.rows(pose)]
        if not has_position_limits(problem):
            return [*regions]
        if problem.limits.crank == "span":
            return [*(LimitCourse(problem, part, None) for part in problem.parts), *regions]
        along = [LimitCourse(problem, part, True) for part in problem.parts]
        return [LimitCourse(problem, None, False), *(course for course in along if course.rows(pose)), *regions]


def error_courses(problem: DesignProblem) -> list[ErrorCourse]:
    """Return the courses of the errors that count over a range."""
    return [ErrorCourse(part) for part in problem.parts if part.everywhere]


def exchange_count(problem: DesignProblem, strokes: int = 1) -> int:
    """Return the number of exchange points of a programme, each of which counts in every one of its strokes."""
    extreme = any(term.extreme for term in (*problem.goals, *(bound.term for bound in problem.bounds)))
    per_stroke = min(max(EXCHANGE_POINTS // strokes, SLOTS[0]), SLOTS[1])
    if not problem.parts:
        return per_stroke
    if has_position_limits(problem) or problem.limits.regions:
        return EXCHANGE_POINTS
    if extreme:
        return per_stroke if strokes > 1 and not error_courses(problem) else EXCHANGE_POINTS
    errors = error_courses(problem)
    return (EXCHANGE_POINTS if problem.robust is not None else LEVEL_POINTS) if errors else 0
