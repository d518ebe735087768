"""What holds over a range of crank angles: limits, errors of laws, quantities of the machine; in symbols and in numbers.

A course is traced by the programme at one crank angle, and evaluated by the exchange along its motion.
"""

import itertools
import math
from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any

import numpy as np

from optlink.linkage.mechanism import Pose
from optlink.linkage.vector2d import TURN, Array, Value, unit
from optlink.optimization.constraints import ConstraintRow, Scale, position_rows, region_rows
from optlink.optimization.nlp import Variable
from optlink.optimization.output_derivatives import ErrorResiduals
from optlink.optimization.term_rows import SIGNS, scaled_limit
from optlink.problem.cycle.terms import Term
from optlink.problem.design import EPIGRAPH, DesignProblem
from optlink.units import KINDS

GRID = 36  # crank angles at which the assembly of a mechanism other than a four-bar is checked
BETWEEN = 3  # positions between two points if full crank rotation is not required
NODES = 48  # positions per revolution of quantities of the machine with an integral; half of it for extremes alone
EXCHANGE_POINTS = 24  # further positions, moved by the exchange method to where a limit or the largest value is exceeded
LEVEL_POINTS = 12  # the same for the largest error of a law alone; with scatter it is flatter, and has as many as others
SIZE_POSITIONS = 72  # crank angles at which the size of a quantity is estimated
EXCEEDED = 2e-9  # permitted excess over a limit, in the unit of its row: less than the validator's tolerance
LEVELLED, NO_ERROR = 1e-8, 1e-12  # permitted excess over a largest value, as a share of it, and in scaled units
LEAST_LEVEL = 1e-9  # scaled units: excesses over a smaller largest value are shares of this one


def has_position_limits(problem: DesignProblem) -> bool:
    """Return whether limits at single crank angles (`position_rows`) apply; for a four-bar the extremes are known instead."""
    return not problem.four_bar


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
        return (0.0, TURN) if self.part is None else (angles[0], angles[-1] - angles[0])

    def fixed_positions(self, angles: Any) -> list[Any]:
        """Return the crank angles [rad] at which the limits always apply."""
        if self.part is None:
            return list(np.linspace(0.0, TURN, GRID, endpoint=False))
        between = [a + (b - a) * (k / (BETWEEN + 1)) for a, b in itertools.pairwise(angles) for k in range(BETWEEN + 1)]
        return [*between, angles[-1]]

    def heights(self, values: Mapping[str, Value], angles: Any, shares: Array) -> Array:
        """Return the excess (rows, n) or (rows, designs, n) over every limit, in the units of the rows; -inf if undefined.

        Positions without assembly exceed the row of the assembly margin. `values` [m, rad] and the crank angles [rad] of the
        requirement are numbers or arrays (designs, 1); `shares` (n,) are positions as shares of the motion.
        """
        begin, whole = self.motion(angles)
        with np.errstate(all="ignore"):
            rows = self.rows(self.problem.linkage.pose(values, unit(begin + whole * shares)))
            over = [np.maximum(row.low - row.value, row.value - row.high) for row in rows]
            excesses = np.array(np.broadcast_arrays(*over, begin + shares)[:-1])
        return np.where(np.isfinite(excesses), excesses, -np.inf)


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
        return (0.0, self.part.span if span is None else span) if self.part.law_given else (0.0, TURN)

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
        return np.where(np.isfinite(sizes), sizes, -np.inf) / self.part.whole

    def heights(self, values: Mapping[str, float], level: float | None, shares: Array) -> Array:
        """Return the excess (rows, n) of the errors over the largest one (scaled), else over the tolerance."""
        sizes = self.sizes(values, shares)
        if level is not None:
            return above_level(sizes, level)
        assert self.part.tolerance is not None
        return np.asarray(sizes - self.part.tolerance / self.part.whole - EXCEEDED)


class TermCourse:
    """Quantities of the machine over the revolution: terms of the objective and limits under names of the user's choice.

    `near`: a design [SI] at which the largest values of the terms are their units.
    """

    def __init__(self, problem: DesignProblem, near: Mapping[str, float] | None) -> None:
        from optlink.optimization.cycle_signals import TracedCycle

        self.problem, self.goals = problem, problem.goals
        self.trace = TracedCycle(problem)
        self.extremes = [goal for goal in self.goals if goal.extreme]
        scaled = [scaled_limit(bound, problem.longest) for bound in problem.bounds]
        self.limits = [limit for limit in scaled if limit.bound.term.extreme]
        self.fixed_limits = [limit for limit in scaled if not limit.bound.term.extreme]
        self.integral = any(term.integral for term in self.trace.terms)
        self.sizes = self._sizes({} if near is None else near)
        self.worths = [goal.weight / (scale or 1.0) for goal, scale in zip(self.goals, problem.scales, strict=True)]
        self.levels = []
        for goal, size in zip(self.extremes, self.sizes, strict=True):
            kind = problem.kind(goal)
            scale = Scale(KINDS[kind].si.replace("**", "^") if kind else "", size)
            self.levels.append(Variable(f"{EPIGRAPH}: {goal.words}", size, scale))

    @property
    def fixed(self) -> Array:
        """Crank angles [rad] at which the terms always count; even steps integrate smooth periodic functions best."""
        count = NODES if self.integral else NODES // 2
        return TURN * np.arange(count) / count

    def _sizes(self, near: Mapping[str, float]) -> list[float]:
        """Return the largest values [SI] of the terms of the objective at a design; their scale or 1 where they have none."""
        angles = np.linspace(0.0, TURN, SIZE_POSITIONS, endpoint=False)
        with np.errstate(all="ignore"):
            signals = self.trace.signals(*self.trace.inputs(self.problem.complete(near)), angles)
        sizes = []
        for goal in self.extremes:
            scale = self.problem.scales[self.goals.index(goal)]
            size = float(np.max(np.sqrt(np.sum(np.square(self.parts(goal, signals)), axis=0))))
            sizes.append(size if math.isfinite(size) and size > 0.0 else scale or 1.0)
        return sizes

    def parts(self, term: Term, signals: Any) -> list[Any]:
        """Return the components of a term [SI] among the signals at one position, or at many."""
        index = next(k for k, other in enumerate(self.trace.cyclic) if other is term)
        first = sum(self.trace.widths[:index])
        return [signals[first + k] for k in range(self.trace.widths[index])]

    def figure(self, term: Term, values: Mapping[str, Any], nodes: Sequence[Any]) -> Any:
        """Return a term with a single value [SI] from the quantities, and the signals at even steps of the revolution."""
        if term.quantity == "length":
            return values[str(term.of)]
        if term.quantity == "total length":
            return sum(values[name] for name in self.problem.lengths)
        if term.quantity == "work":
            return sum(signals[sum(self.trace.widths) - 1] for signals in nodes) * self.trace.direction * TURN / len(nodes)
        each = [self.parts(term, signals) for signals in nodes]
        if term.how == "mean":
            return sum(parts[0] for parts in each) / len(nodes)
        return np.sqrt(sum(part * part for parts in each for part in parts) / len(nodes))

    @property
    def order(self) -> list[int]:
        """For each limit and each largest value, its number among the largest values; -1 for a limit."""
        return [-1] * len(self.limits) + list(range(len(self.extremes)))

    def heights_of(self, k: int, values: Mapping[str, float], levels: Array, shares: Array) -> Array:
        """Return the excess (rows, n) of a term over its limit or largest value over the revolution; `k`: see `order`."""
        with np.errstate(all="ignore"):
            signals = self.trace.signals(*self.trace.inputs(values), TURN * shares)
        if k < len(self.limits):
            limit = self.limits[k]
            parts, term = self.parts(limit.bound.term, signals), limit.bound.term
            signs = SIGNS["peak"] if term.how == "peak" else (1.0,)
            if len(parts) > 1 and not term.nature.general:
                rows = [np.hypot(*parts) / limit.size - limit.above]
            else:
                rows = [_beyond(sign * part / limit.size, limit.below, limit.above) for part in parts for sign in signs]
            heights = np.array(rows) - EXCEEDED
        else:
            goal, size = self.extremes[k - len(self.limits)], self.sizes[k - len(self.limits)]
            parts = self.parts(goal, signals)
            if len(parts) > 1 and not goal.nature.general:
                rows = [np.hypot(*parts) / size]
            else:
                rows = [sign * part / size for part in parts for sign in SIGNS[goal.how]]
            heights = above_level(np.array(rows), levels[k - len(self.limits)])
        return np.where(np.isfinite(heights), heights, -np.inf)


def _beyond(value: Array, low: float, high: float) -> Array:
    """Return by how much values lie beyond two bounds; negative inside."""
    return np.asarray(np.maximum(low - value, value - high))


def above_level(values: Array, level: float) -> Array:
    """Return by how much values (scaled) exceed a level beyond rounding, as shares of it."""
    return np.asarray((values - level * (1.0 + LEVELLED) - NO_ERROR) / max(abs(level), LEAST_LEVEL))


def limit_courses(problem: DesignProblem) -> list[LimitCourse]:
    """Return the courses of limits at single crank angles: over the revolution, and along the motion of each requirement."""
    pose = problem.linkage.pose(problem.complete({}), unit(0.0))
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


def exchange_count(problem: DesignProblem) -> int:
    """Return the number of exchange points of a programme."""
    terms = [*problem.goals, *(bound.term for bound in problem.bounds)]
    if has_position_limits(problem) or problem.limits.regions or any(term.extreme for term in terms):
        return EXCHANGE_POINTS
    errors = error_courses(problem)
    return (EXCHANGE_POINTS if problem.robust is not None else LEVEL_POINTS) if errors else 0
