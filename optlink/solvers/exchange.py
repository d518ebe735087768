"""Exchange method for limits and largest errors over a whole range: exchange points move to the peaks, and the search resumes.

The heights of peaks are excesses: over a limit, in the unit of its row; over the largest error, as a share of it.

References
----------
R. Hettich, K. O. Kortanek, Semi-infinite programming: theory, methods, and applications, SIAM Review 35 (1993) 380-429.
"""

import functools
import itertools
import math
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import casadi
import numpy as np

from optlink.errors import Status
from optlink.linkage.extrema import Function, maxima
from optlink.linkage.fourbar import time_ratio
from optlink.linkage.vector2d import Array, max_magnitude
from optlink.optimization.courses import (
    EVENT,
    EXCEEDED,
    LEAST_LEVEL,
    LEVELLED,
    LimitCourse,
    TermCourse,
    error_courses,
    limit_courses,
)
from optlink.optimization.cycle_signals import EventOrder, Sample, TracedCycle
from optlink.optimization.mapped_terms import MappedTerms
from optlink.optimization.multipliers import ACTIVE, LEAST_PRICE
from optlink.optimization.nlp import NLP, Variable
from optlink.optimization.programme import build, solved_values
from optlink.optimization.terms import PLAIN, ConstraintRow
from optlink.problem.design import EPIGRAPH, DesignProblem
from optlink.problem.terms import Term
from optlink.solvers import contract, multistart as local
from optlink.solvers.multistart import latin_hypercubes, polish
from optlink.solvers.solution import Attempt, Solution

# Constants of the exchange method.
# What a search finds, and how much longer it takes, if one of them is halved or doubled: docs/constants.md.
# Rounds:
POSITIONS = 1441  # positions along the required motion at which limits are sampled
PER_STROKE = 241  # those along a stroke, or along the revolution where quantities of the machine are all that counts
EXCHANGES = 40  # rounds
RADIUS, SMALLEST = 0.3, 1e-6  # scaled units: trust-region radius of the first round, and the least one
GROWTH, ALL_BUT = 2.5, 0.9  # of the radius after a step of at least that share of it
TRACKED_PEAK = 0.1  # in the unit of the row: a peak this far below its limit may exceed it in the next round
MOVING_PEAK = 0.02  # the same for peaks whose positions are unknowns of the NLP, and where only an excess counts
TRACKED_LEVEL, MOVING_LEVEL = 0.3, 0.05  # the same for peaks of the error, as shares of the largest one
REACH, FARTHEST = 0.02, 0.1  # share of the motion by which such a position may move in a round of the first radius, and at most
PER_ROW = 2  # such positions of a row that the programme has at least
EDGE = 1e-3  # share of the motion: this close to its ends the derivative at a peak need not vanish
MOST_NODES, INTEGRAL_TOLERANCE = 400, 1e-8  # positions of integrals per revolution, and their relative accuracy
ROUNDING = 1e-9  # scaled units: a shorter step is none
PEAK_SEPARATION = 1e-4  # share of the motion; closer positions count as one
VIOLATION_PENALTY = 1e3  # penalty of exceeding a limit by one, in multiples of the objective
RESTORED = 0.5  # share of a violation: a step that leaves at most this much of it restores feasibility
# Orders of the ends of strokes:
STARTS = 16  # default number of random designs with which a search begins
SAMPLES = 160  # random designs for each of them; only those with one order of events are used
BLOCK = 32  # random designs whose events are determined together
ORDERS = 2  # further orders of events searched while no feasible design is known
STEPS = (1e-3, 1e-2)  # of the range of a design variable: from a design at the edge of its order of events to the next order
CROSSINGS = 12  # ends of searches from which others may be searched, in the orders beside them

PEAK = "place of a peak"


@dataclass(frozen=True)
class RowPeak:
    """A local maximum of a row at a share of its motion; `level`: number of the largest value to which it belongs, else -1."""

    at: float
    height: float
    row: int
    level: int = -1

    @property
    def tracked(self) -> bool:
        """Whether it may exceed the limit or level in the next round."""
        return self.height > -(TRACKED_LEVEL if self.level >= 0 else TRACKED_PEAK)

    @property
    def moving(self) -> bool:
        """Whether its position is an unknown of the NLP."""
        near = MOVING_LEVEL if self.level >= 0 else MOVING_PEAK
        return self.height > -near and EDGE < self.at < 1.0 - EDGE


def solve_semi_infinite(
    task: DesignProblem, start: Solution, backend: str, *, near: bool = False, radius: float = RADIUS
) -> Solution:
    """Return an optimum near a start at which limits and the largest error hold also between the positions of the NLP.

    In every round the exchange points move to where limits or the largest error are exceeded or nearly so, and the NLP is solved
    within a radius, in which these positions hardly move; a step is accepted only if the merit over all positions decreases. The
    penalty of the merit is raised where it would reject a step that restores feasibility: near an exact design the objective
    alone is a poor measure. `near`: the start satisfies its limits everywhere, so that the first search stays within the radius
    too, as from an optimum at the positions of the NLP. `radius`: that of the first round (scaled); a larger one may lead to
    another optimum.
    """
    nlp, near = start.nlp, near or start.status is Status.OPTIMAL
    if not nlp.exchange_count:
        return start if start.status is Status.OPTIMAL else local.solve_from(nlp, start.x, backend, persistent=False)
    nlp.spread_exchange_points()
    solution = local.solution_at(nlp, start.x, start.message)
    near = near or (task.composed and solution.violation <= 0.0)
    if not near and solution.status is not Status.OPTIMAL:
        solution = local.solve_from(nlp, start.x, backend, persistent=False, continuations=0)
    course = _courses(task, nlp)
    tops, violated = course.tops(solution), list[RowPeak]()
    if not near and solution.status is Status.INFEASIBLE and all(top.height <= 0.0 for top in tops if top.level < 0):
        return solution  # what is violated does not lie between the positions of the NLP
    worst, penalty = math.inf, 0.0
    for _ in range(EXCHANGES):
        if not math.isfinite(solution.objective):
            break
        nlp.set_exchange_points(_places(tops, nlp.exchange_count))
        before, solution = solution.x, local.solution_at(nlp, solution.x, solution.message)
        tops = _levelled(tops, before[nlp.first_level :], solution.x[nlp.first_level :])
        if (solution.status is Status.OPTIMAL and tops[0].height <= 0.0) or radius < SMALLEST:
            break
        begun = solution.x
        moved, limited = _followed(nlp, solution, len(task.free), radius, backend, tops, violated)
        there = course.tops(moved)
        penalty = max(penalty, _needed_penalty(solution, tops, moved, there))
        if _merit(moved, there, penalty) < _merit(solution, tops, penalty):
            solution, tops, violated, worst = moved, there, [], math.inf
            radius = GROWTH * radius if limited else radius
        elif 0.0 < there[0].height < worst:
            violated, worst = [*there, *violated], 0.5 * there[0].height  # the step is repeated with these positions
        else:
            radius, violated, worst = 0.25 * radius, [], math.inf
        if math.isfinite(moved.objective) and max_magnitude(moved.x - begun) < ROUNDING:
            break  # it stays where it is: further rounds would repeat this one
    if tops[0].height <= 0.0 or not solution.usable:
        return _polished(solution)
    what = "the largest values did not become level" if tops[0].level >= 0 else "limits are exceeded between the positions"
    return replace(solution, status=Status.STALLED, message=what)


def _polished(solution: Solution) -> Solution:
    """Return an optimum whose limits hold to rounding, as Newton's method finds it beside the end of a search."""
    if solution.status is not Status.OPTIMAL:
        return solution
    end = polish(solution.nlp, Attempt(solution.x, solution.iterations, solution.message), solution.p)
    again = local.solution_at(solution.nlp, end.x, solution.message)
    better = again.status is Status.OPTIMAL and again.violation <= solution.violation and again.kkt <= solution.kkt
    return replace(again, iterations=solution.iterations, path=solution.path) if better else solution


def largest_excess(task: DesignProblem, nlp: NLP, x: Array) -> float:
    """Return the largest excess over a limit or a largest value of a design, if it is not far below; see `RowPeak`."""
    return _courses(task, nlp).tops(local.solution_at(nlp, x, ""), MOVING_PEAK)[0].height


def rank(solution: Solution) -> tuple[bool, bool, float]:
    """Return a sort key, best first: feasible, optimal, low objective."""
    return not solution.usable, solution.status is not Status.OPTIMAL, solution.objective


def integral_error(solution: Solution) -> float:
    """Return the largest relative error of the integrals of a solution, as far as twice as many positions tell."""
    nlp, terms = solution.nlp, solution.nlp.terms
    if terms is None or not terms.integral:
        return 0.0
    return float(terms.integral_error(nlp.given | solution.design, solution.x[nlp.first_event : nlp.first_level]))


def has_accurate_integrals(solution: Solution) -> bool:
    """Return whether the integrals of a solution are accurate, or have as many positions as are used.

    A square root of an integral has second derivatives by each two positions, and half of the positions: squares have no kinks
    where values change their signs.
    """
    terms = solution.nlp.terms
    if terms is None or integral_error(solution) <= INTEGRAL_TOLERANCE:
        return True
    dense = any(term.how == "rms" for term in terms.trace.terms)
    return bool((2 if dense else 1) * terms.count >= MOST_NODES)


def with_accurate_integrals(solution: Solution, method: str, programme: Callable[[TermCourse], NLP]) -> Solution:
    """Return an optimum with so many positions that its integrals are accurate.

    `programme` returns the one of a course with more positions, `method` searches from the optimum there.
    """
    while solution.usable and not has_accurate_integrals(solution):
        nlp, terms = solution.nlp, solution.nlp.terms
        more = programme(TermCourse(terms.problem, solution.design, terms.trace, terms.structure, 2 * terms.count))
        values = {v.name: v.value(float(y)) for v, y in zip(nlp.variables, solution.x, strict=True)}
        start = local.solution_at(more, more.x_of(values), solution.message)
        solution = solve_semi_infinite(terms.problem, start, method, near=start.usable)
    return solution


def sharpened(task: DesignProblem, solution: Solution, backend: str) -> Solution:
    """Return an optimum with all digits, for differences between optima that are close to each other.

    A design whose optimality conditions hold within their tolerance is an optimum for the search, which does not move it. One
    step in which the peaks move finds the point at which the conditions hold exactly.
    """
    nlp, course = solution.nlp, _courses(task, solution.nlp)
    if not nlp.exchange_count:
        return solution
    tops = course.tops(solution)
    nlp.set_exchange_points(_places(tops, nlp.exchange_count))
    moved, _ = _followed(nlp, solution, len(task.free), RADIUS, backend, tops, [])
    nlp.set_exchange_points(_places(course.tops(moved), nlp.exchange_count))
    moved = local.solution_at(nlp, moved.x, moved.message)
    nearly = moved.objective <= solution.objective + LEVELLED * abs(solution.objective)
    return moved if moved.status is Status.OPTIMAL and nearly else solution


def place_at_peaks(task: DesignProblem, nlp: NLP, x: Array) -> None:
    """Move the exchange points, if there are any, to the peaks of the limits of a design."""
    if nlp.exchange_count:
        nlp.set_exchange_points(_places(_courses(task, nlp).tops(local.solution_at(nlp, x, "")), nlp.exchange_count))


def with_peaks(task: DesignProblem, solution: Solution) -> tuple[Solution, list[int]]:
    """Return an optimum as one of the programme in which the positions of its peaks are unknowns, and the rows that it keeps."""
    nlp, rows = solution.nlp, list(range(len(solution.nlp.rows)))
    if not nlp.exchange_count:
        return solution, rows
    first, each = nlp.exchange_rows
    tops = _courses(task, nlp).tops(solution)
    chosen = sorted((top for top in tops if top.moving), key=lambda top: (top.row, top.at))[: nlp.exchange_count]
    at = [top.at for top in chosen]
    places = [*at, *(place for place in _places(tops, nlp.exchange_count) if place not in at)]
    nlp.set_exchange_points(np.resize(places, nlp.exchange_count))
    x = nlp.lifted(solution.x)
    if not chosen:
        return local.solution_at(nlp, x, solution.message), rows
    whole = len([top for top in tops if top.level >= 0 and top.tracked]) > nlp.exchange_count
    rows, slots = _moving_rows(nlp, whole=whole), [first + slot * each + top.row for slot, top in enumerate(chosen)]
    key = f"at the peaks of rows {slots}" + (" and all positions" if whole else "")
    if key not in nlp.cache:
        nlp.cache[key] = with_moving_rows(nlp, rows, slots)
    moving: NLP = nlp.cache[key]
    moving.p[:] = nlp.p
    moving.set_bounds(np.append(nlp.x_low, np.zeros(len(at))), np.append(nlp.x_high, np.ones(len(at))))
    for k, j in enumerate(rows):
        moving.limit(len(moving.variables) + k, nlp.low[j], nlp.high[j])
    return local.solution_at(moving, np.append(x, at), solution.message), rows


def best_slow_stroke(task: DesignProblem, solution: Solution, backend: str) -> Solution:
    """Return the better one of a solution and the optimum near it whose slow stroke has the other direction.

    A time ratio that does not name its stroke divides the four-bars into two families. Near a ratio of 1 they almost meet, and
    searches that penalise the limit end between them.
    """
    ratio, nlp = task.limits.time_ratio, solution.nlp
    if ratio is None or ratio.stroke is not None or not (ratio.low or 0.0) > 1.0 or not math.isfinite(solution.objective):
        return solution
    values, angles = solved_values(task, solution.design, solution.x)
    sense = 1 if angles[-1] >= angles[0] else -1
    assert task.four_bar is not None
    forward = time_ratio(*task.four_bar.lengths(values), task.four_bar.side, "forward", sense)
    stroke = "backward" if forward >= 1.0 else "forward"
    if stroke not in nlp.cache:
        limits = task.limits.model_copy(update={"time_ratio": replace(ratio, stroke=stroke)})
        one_way = task.model_copy(update={"limits": limits})
        nlp.cache[stroke] = build(one_way, sense, terms=None if nlp.terms is None else nlp.terms.of(one_way))
    start = local.solution_at(nlp.cache[stroke], solution.x, solution.message)
    other = local.solution_at(nlp, local.solve_from(start.nlp, start.x, backend).x, solution.message)
    return local.best([solution, other]) if other.status is Status.OPTIMAL else solution


def _followed(
    nlp: NLP, start: Solution, count: int, radius: float, backend: str, tops: list[RowPeak], violated: list[RowPeak]
) -> tuple[Solution, bool]:
    """Return the optimum with the first `count` variables within a radius, and whether the radius limits it.

    `tops` are the peaks at the start, `violated` those of a rejected step. The positions of active peaks are unknowns; those that
    no peak needs are fixed, so that one programme serves many sets of peaks.
    """
    each, places, chosen = nlp.exchange_rows[1], np.zeros(0), [top for top in tops if top.moving]
    rows = _moved_rows(nlp, chosen)
    many, used, left = len(rows), dict[int, float](), list(chosen)
    for slot, row in enumerate(rows):
        top = next((top for top in left if top.row == row), None)
        if top is not None:
            left.remove(top)
            used[slot] = top.at
    others = iter(at for at in _places([*tops, *violated], nlp.exchange_count) if at not in used.values())
    places = np.array([used[slot] if slot in used else next(others, 0.0) for slot in range(nlp.exchange_count)])
    nlp.set_exchange_points(places)
    whole = len([top for top in tops if top.level >= 0 and top.tracked]) > nlp.exchange_count  # too many peaks
    regular = rows == [slot % each for slot in range(many)]
    key = f"following {many if regular else rows} peaks" + (" and all positions" if whole else "")
    if key not in nlp.cache:
        nlp.cache[key] = _with_moving_peaks(nlp, rows, whole=whole)
    moving: NLP = nlp.cache[key]
    moving.p[:] = nlp.p
    for k, j in enumerate(_moving_rows(nlp, whole=whole)):
        moving.limit(len(moving.variables) + k, nlp.low[j], nlp.high[j])
    n, fixed = len(start.x), np.array([slot not in used for slot in range(many)])
    x, reach = np.append(start.x, places[:many]), min(REACH * max(1.0, radius / RADIUS), FARTHEST)
    room = np.where(fixed, 0.0, reach)
    low, high = np.append(nlp.x_low, x[n:] - room), np.append(nlp.x_high, x[n:] + room)
    around = np.flatnonzero(nlp.around[:count])
    low[around], high[around] = -math.inf, math.inf  # a step may pass where such an angle jumps by a revolution
    low[:count], high[:count] = np.maximum(low[:count], x[:count] - radius), np.minimum(high[:count], x[:count] + radius)
    first = len(moving.rows) - many
    moving.set_bounds(low, high)
    for k, free in enumerate(fixed):
        moving.limit(len(x) + first + k, -math.inf if free else 0.0, math.inf if free else 0.0)
    p = local.scaled_parameters(moving, x)
    method = contract.CLOSE if backend == contract.MINIMAX else backend  # its last unknowns are places, not the largest error
    end = polish(moving, contract.backend(method)(moving, x, p), p)
    step = np.abs(end.x - x)
    limited = bool(np.any(step[:count] > ALL_BUT * radius) or np.any(step[n:] > ALL_BUT * reach))
    return local.solution_at(nlp, nlp.wrapped(end.x[:n]), end.message), limited


def _moved_rows(nlp: NLP, chosen: Sequence[RowPeak]) -> list[int]:
    """Return for each exchange point that is an unknown the row at whose peak it is.

    One row follows the other, so that one programme serves many sets of peaks; where there are more rows than exchange points,
    they are the rows of the peaks.
    """
    each, per_row = nlp.exchange_rows[1], PER_ROW
    if each > nlp.exchange_count:
        return sorted(top.row for top in chosen[: nlp.exchange_count])
    while per_row < max(Counter(top.row for top in chosen).values(), default=0) and 2 * per_row * each <= nlp.exchange_count:
        per_row *= 2
    return [slot % each for slot in range(min(per_row * each, nlp.exchange_count))]


def _with_moving_peaks(nlp: NLP, rows: Sequence[int], *, whole: bool = False) -> NLP:
    """Return the NLP with the positions of peaks of some rows as unknowns, and without its fixed positions."""
    first, each = nlp.exchange_rows
    slots = [first + slot * each + row for slot, row in enumerate(rows)]
    return with_moving_rows(nlp, _moving_rows(nlp, whole=whole), slots)


def _moving_rows(nlp: NLP, *, whole: bool = False) -> list[int]:
    """Return the rows without those of limits at fixed positions, and of the error without those between its ends.

    `whole`: the error has more peaks than there are exchange points, so that its fixed positions are kept.
    """
    first, each = nlp.exchange_rows
    block = nlp.rows[first : first + each]
    names, levels = {(row.limit, row.label) for row in block}, sum(row.limit == EPIGRAPH for row in block)
    last = first + each * nlp.exchange_count
    errors = [j for j, row in enumerate(nlp.rows) if j >= last and row.limit == EPIGRAPH]
    between = set(errors[levels:-levels]) if levels and not whole else set()
    kept = (j for j, row in enumerate(nlp.rows) if j >= first or (row.limit, row.label) not in names)
    return [j for j in kept if j not in between]


def _violation(solution: Solution, tops: list[RowPeak]) -> float:
    """Return the largest violation of a limit, at the positions of the NLP or between them."""
    return max(solution.violation, *(top.height for top in tops if top.level < 0), 0.0)


def _largest(solution: Solution, tops: list[RowPeak]) -> float:
    """Return the objective, with the largest values between the positions too."""
    nlp, objective = solution.nlp, solution.objective
    for k, slope in enumerate(nlp.level_slopes):
        excess = max((top.height for top in tops if top.level == k), default=0.0)
        objective += slope * max(abs(float(solution.x[nlp.first_level + k])), LEAST_LEVEL) * max(excess, 0.0)
    return objective


def _merit(solution: Solution, tops: list[RowPeak], penalty: float) -> float:
    """Return the objective plus the penalty of its violation, `VIOLATION_PENALTY` times the objective or more."""
    violation, objective = _violation(solution, tops), _largest(solution, tops)
    factor = max(VIOLATION_PENALTY * abs(objective), penalty)
    return objective + factor * violation if math.isfinite(violation) else math.inf


def _needed_penalty(solution: Solution, tops: list[RowPeak], moved: Solution, there: list[RowPeak]) -> float:
    """Return a penalty with which a step that restores feasibility decreases the merit; 0 for any other step."""
    before, after = _violation(solution, tops), _violation(moved, there)
    begun, ended = _largest(solution, tops), _largest(moved, there)
    if not (0.0 < before < math.inf and after <= RESTORED * before and begun < ended < math.inf):
        return 0.0
    return 2.0 * (ended - begun) / (before - after)


def _levelled(tops: list[RowPeak], before: Array, now: Array) -> list[RowPeak]:
    """Return the peaks, those of largest values with their excess over others, largest first."""
    moved = []
    for top in tops:
        if top.level >= 0:
            was, level = float(before[top.level]), float(now[top.level])
            height = top.height * max(abs(was), LEAST_LEVEL) + was - level + LEVELLED * (abs(was) - abs(level))
            top = replace(top, height=height / max(abs(level), LEAST_LEVEL))
        moved.append(top)
    return sorted(moved, key=lambda top: -top.height)


def _places(tops: list[RowPeak], count: int) -> Array:
    """Return the positions of the first peaks, and evenly spaced ones where there is room."""
    chosen: list[float] = []
    for at in [*(top.at for top in tops if top.tracked), *((np.arange(count) + 0.5) / count).tolist()]:
        if len(chosen) < count and all(abs(at - other) > PEAK_SEPARATION for other in chosen):
            chosen.append(at)
    return np.array(chosen + chosen[:1] * (count - len(chosen)))


def _beyond_limits(course: LimitCourse, values: Mapping[str, float], angles: Array, shares: Array) -> Array:
    """Return the excess over the limits of a course beyond the permitted one."""
    return course.heights(values, angles, shares) - EXCEEDED


def _courses(task: DesignProblem, nlp: NLP) -> "_Courses":
    """Return the courses of a programme (cached)."""
    if "courses" not in nlp.cache:
        nlp.cache["courses"] = _Courses(task, nlp)
    courses: _Courses = nlp.cache["courses"]
    return courses


class _Courses:
    """Limits and largest values of a problem along the motions over which they apply, in the order of the exchange rows."""

    def __init__(self, task: DesignProblem, nlp: NLP) -> None:
        self.task, self.limits, self.errors = task, limit_courses(task) if task.parts else [], error_courses(task)
        self.terms: TermCourse | None = None if nlp.terms is None else nlp.terms.of(task)

    def tops(self, solution: Solution, near: float = math.inf) -> list[RowPeak]:
        """Return the peaks where limits or largest values are exceeded or nearly so, at most by `near`, largest first."""
        values, angles = solved_values(self.task, solution.design, solution.x)
        nlp = solution.nlp
        levels = solution.x[nlp.first_level :]
        grid, found, rows = np.linspace(0.0, 1.0, POSITIONS), list[RowPeak](), 0

        def search(heights: Function, numbers: int | list[int], grid: Array = grid) -> None:
            nonlocal rows
            values = heights(grid)
            each = [numbers] * len(values) if isinstance(numbers, int) else numbers
            for level, group in itertools.groupby(range(len(each)), key=lambda row: each[row]):
                room = min(near, TRACKED_LEVEL if level >= 0 else TRACKED_PEAK)
                tops = peaks(heights, grid, room, values, list(group))
                found.extend(replace(top, row=rows + top.row, level=level) for top in tops)
            rows += len(values)

        for course in self.limits:
            own = next((own for part, own in self.task.of_parts(angles) if part is course.part), angles)
            assert own is not None
            search(functools.partial(_beyond_limits, course, values, own), -1)
        if self.terms is not None:
            first, events = len(levels) - len(self.terms.levels), solution.x[nlp.first_event : nlp.first_level]
            numbers = [first + level if level >= 0 else -1 for level in self.terms.level_numbers]
            along = np.linspace(0.0, 1.0, PER_STROKE) if self.terms.cuts or not self.task.parts else grid
            for motion in self.terms.motions(values, events):
                search(functools.partial(self.terms.heights, motion, levels[first:]), numbers, along)
        for error in self.errors:
            number = error.level(self.task)
            largest = float(levels[number]) if number >= 0 else None
            search(functools.partial(error.heights, error.part.own(values), largest), number)
        return sorted(found, key=lambda top: -top.height) or [RowPeak(0.0, -math.inf, 0)]


def peaks(
    heights: Function, grid: Array, near: float = 0.0, values: Array | None = None, rows: Sequence[int] | None = None
) -> list[RowPeak]:
    """Return the local maxima above -near of all `rows` of a function of positions (n,), largest first; `grid` brackets them.

    `values` are those of the function on the grid, if known.
    """
    values = heights(grid) if values is None else values
    padded = np.pad(values, ((0, 0), (1, 1)), constant_values=-np.inf)
    top = (values >= padded[:, :-2]) & (values > padded[:, 2:]) & (values > -2.0 * near)
    tops: list[RowPeak] = []
    for row, k in np.argwhere(top).tolist():
        if rows is not None and row not in rows:
            continue
        bracket = np.linspace(grid[max(k - 1, 0)], grid[min(k + 1, len(grid) - 1)], 9)
        at, value = maxima(lambda u: heights(u)[row : row + 1], bracket)  # noqa: B023
        tops.append(RowPeak(float(at[0]), float(value[0]), row))
    tops.sort(key=lambda peak: -peak.height)
    return [peak for k, peak in enumerate(tops) if all(abs(peak.at - other.at) > PEAK_SEPARATION for other in tops[:k])]


# --- places of peaks as unknowns ----------------------------------------------------------------------------------------------


def with_moving_rows(nlp: NLP, keep: Sequence[int], slots: Sequence[int]) -> NLP:
    """Return some rows of an NLP; the first exchange points are unknowns, each where a row of `slots` has a maximum."""
    assert nlp.mapped is not None
    count = nlp.exchange_count
    reduced = replace(nlp, rows=tuple(nlp.rows[j] for j in keep), g_expression=nlp.g_expression[keep], cache={})
    heights = dict(enumerate(casadi.vertsplit(nlp.g_expression[slots])))
    places = casadi.vertsplit(nlp.p_symbol)[len(nlp.p) - count :][: len(slots)]
    terms = nlp.mapped.of_rows(keep).with_slopes(casadi.vertsplit(nlp.mapped.g[slots]), places)
    return with_places(reduced, count, heights, terms)


def with_places(nlp: NLP, slots: int, heights: Mapping[int, Any], terms: tuple[MappedTerms, Any] | None = None) -> NLP:
    """Return an NLP with some exchange points as additional unknowns: each where the derivative of a height vanishes.

    The last `slots` parameters of the NLP are the exchange points; `heights` has expressions of its x and p by the number of an
    exchange point. `terms`: the NLP by vectors of positions, and the derivatives of the heights by the exchange points in its
    terms; by default those of the NLP, and derivatives in terms of x and p.
    """
    n, first, count = len(nlp.variables), len(nlp.p) - slots, len(heights)
    x = casadi.SX.sym("x", n + count)
    slopes, p = [], casadi.vertsplit(nlp.p_symbol)
    for k, (slot, height) in enumerate(heights.items()):
        slopes.append(casadi.gradient(height, nlp.p_symbol[first + slot]))
        p[first + slot] = x[n + k]
    expressions = [nlp.f_expression, nlp.g_expression, nlp.residual_expression, casadi.vertcat(*slopes)]
    moved: tuple[list[Any], list[Any]] = ([nlp.x_symbol, nlp.p_symbol], [x[:n], casadi.vertcat(*p)])
    mapped, rates = terms or (nlp.mapped, expressions[-1])
    f, g, residual, slope, rates = map(casadi.densify, casadi.substitute([*expressions, rates], *moved))  # a slope may be zero
    at = np.array([nlp.p[first + slot] for slot in heights])
    names = [f"{PEAK} {k + 1}" for k in range(count)]
    return NLP(
        variables=(*nlp.variables, *(Variable(label, 1.0, PLAIN) for label in names)),
        fixed=nlp.fixed,
        rows=(*nlp.rows, *(ConstraintRow(PEAK, label, slope[k], 0.0, 0.0, PLAIN) for k, label in enumerate(names))),
        measure=nlp.measure,
        x_start=np.concatenate([nlp.x_start, at]),
        x_low=np.concatenate([nlp.x_low, np.zeros(count)]),
        x_high=np.concatenate([nlp.x_high, np.ones(count)]),
        p=nlp.p,
        x_symbol=x,
        p_symbol=nlp.p_symbol,
        f_expression=f,
        g_expression=casadi.vertcat(g, slope),
        residual_expression=residual,
        cycle=nlp.cycle,
        mapped=None if mapped is None else mapped.substituted(x, moved, rates),
        exact=nlp.exact,
        factor=nlp.factor,
        helpers=nlp.helpers | {PEAK, *names},
        states=nlp.states | {PEAK, *names},
    )


# Orders of the ends of strokes: random designs of one order, whether a design has that of its programme, orders beside it.

FURTHER = "an output has further dead centres"


@dataclass(frozen=True)
class OrderedStart:
    """A starting point [SI] with an order of events and slow strokes, for which the programme is built at the design `near`.

    `first`: whether a search begins with this order.
    """

    order: EventOrder
    values: Mapping[str, float]
    near: Mapping[str, float]
    first: bool

    @property
    def insists(self) -> bool:
        """Whether it is searched although no feasible point is found beside it."""
        return self.first and self.values == self.near


class OrderedStarts:
    """Starting points of a search for up to `count` designs of each order of events: the first design, then random ones.

    Those of a smaller number come first in the same sequence. `fault`: of the first design in which an output with a stroke does
    not reciprocate, see `TracedCycle.strokeless`. `most`: number of starting points of one order that `rounds` has found.
    """

    def __init__(self, trace: TracedCycle, seed: int, count: int = 1) -> None:
        self.trace, self.count, self.most, self._known = trace, count, 0, list[Sample]()
        self.fault: tuple[str, Term, int] | None = None
        self.choices = list(itertools.product((True, False), repeat=len(trace.paced)))  # of the slow strokes
        task = trace.problem
        initial = {name: task.quantities[name].value for name in task.free}
        low, high = np.array([task.quantities[name].bounds for name in task.free]).T
        drawn = (dict(zip(task.free, x.tolist(), strict=True)) for x in latin_hypercubes(low, high, seed))
        self._next = itertools.chain([initial], drawn)

    def samples(self, count: int) -> Iterator[Sample]:
        """Iterate over the design of the file and `count` random ones."""
        for k in range(count + 1):
            if k == len(self._known):
                many = list(itertools.islice(self._next, BLOCK if k else 1))
                self._known += self.trace.samples(many)
            yield self._known[k]

    def fits(self, order: EventOrder) -> bool:
        """Return whether every output with a stroke reciprocates in a design."""
        fault = self.trace.strokeless(order)
        self.fault = self.fault or fault
        return fault is None

    @cached_property
    def begun(self) -> list[list[OrderedStart]]:
        """The groups with which a search begins: those with the order of events of the first suitable design, its own first."""
        return self._alike(None)

    def _alike(self, order: EventOrder | None) -> list[list[OrderedStart]]:
        """Return the starting points of an order of events, a group for each choice of slow strokes."""
        groups, first = dict[tuple[bool, ...], list[OrderedStart]](), order is None
        for k, sample in enumerate(self.samples(SAMPLES * self.count)):
            if order is not None and not sample.may_be_like(order):
                continue
            own = sample.structure
            if own is None or not self.fits(own):
                continue
            order = own if order is None else order
            if own.like(order):
                self._sort_in(groups, sample.values, own, first=first)
            if (k >= SAMPLES or len(self.choices) == 1) and any(len(group) >= self.count for group in groups.values()):
                break
        return [group[: self.count] for group in groups.values()]

    def _sort_in(
        self,
        groups: dict[tuple[bool, ...], list[OrderedStart]],
        values: Mapping[str, float],
        own: EventOrder,
        *,
        first: bool = False,
    ) -> None:
        """Add a starting point to the group of its slow strokes; to both groups if the strokes take equally long."""
        for slow in self.choices:
            if all(pace is None or pace == other for pace, other in zip(own.slow, slow, strict=True)):
                start = OrderedStart(replace(own, slow=slow), values, values, first)
                group = groups.setdefault(slow, [start])
                if group[0] is not start:
                    group.append(replace(group[0], values=values))

    def _further(self) -> list[list[OrderedStart]]:
        """Return groups for a search without a feasible design: missing slow strokes, the next most frequent orders."""
        first, known = self.begun[0], [group[0].order.slow for group in self.begun]
        missing = [slow for slow in self.choices if slow not in known]
        orders = [replace(first[0].order, slow=slow) for slow in missing]
        result = [[replace(start, order=order, first=False) for start in first] for order in orders]
        groups: dict[tuple[object, ...], dict[tuple[bool, ...], list[OrderedStart]]] = {}
        frequent: Counter[tuple[object, ...]] = Counter()
        for k, sample in enumerate(self.samples(SAMPLES * max(self.count, STARTS))):
            own = sample.structure
            if own is not None and not own.like(first[0].order) and self.fits(own):
                key = (own.which, own.rising)
                frequent[key] += k <= SAMPLES * STARTS
                self._sort_in(groups.setdefault(key, {}), sample.values, own)
        return [*result, *(group[: self.count] for key, _ in frequent.most_common(ORDERS) for group in groups[key].values())]

    def rounds(self, best: Callable[[], EventOrder | None]) -> Iterator[list[OrderedStart]]:
        """Yield the starting points of every round of a search: one of each group with which it begins.

        While no design is feasible, so that `best`, the order of events of the best one, is None, those of further groups follow.
        An order that turns out to be better is searched from all of its starting points.
        """
        more, groups = list[list[OrderedStart]](), list(self.begun)
        explored, self.most = [group[0].order for group in groups], max(map(len, groups))
        for k in range(max(map(len, self.begun))):
            yield one_of_each(self.begun, k)
            if best() is None:
                more = self._further() if k == 0 else more
                yield one_of_each(more, k)
                groups = [*self.begun, *more]
                explored = [group[0].order for group in groups]
            found = best()
            if found is not None and not any(found.like(order) for order in explored):
                explored.append(found)
                alike = self._alike(found)
                groups += alike
                yield list(itertools.chain(*alike))
            self.most = max(map(len, groups))


def one_of_each(groups: Iterable[Sequence[OrderedStart]], k: int) -> list[OrderedStart]:
    """Return the k-th starting point of each group that has so many."""
    return [start for group in groups for start in group[k : k + 1]]


def misfit(trace: TracedCycle, structure: EventOrder, design: Mapping[str, float]) -> str:
    """Return why a programme with the events of `structure` does not describe a design [SI]; empty if it does.

    A programme knows the dead centres of its own order of events only: a design may have further ones, so that an output does not
    reciprocate as its stroke or time ratio requires (`FURTHER`), or a load acts in other strokes. The angle of a load may count
    from another turn than in the trace.
    """
    own = trace.structure(design)
    if own is None:
        return ""
    if trace.strokeless(own) is not None:
        return FURTHER
    if trace.reversals(own) != trace.reversals(structure):
        return "a motion has further reversals"
    return "" if trace.serves(design) else "the angle of a load counts from another turn"


def at_edge(solution: Solution) -> bool:
    """Return whether the order of events, which no limit prescribes, keeps a solution from a better one."""
    rows = solution.nlp.rows
    prices = np.abs(solution.conditions.multipliers[len(solution.x) :])
    return solution.usable and any(
        row.limit == EVENT and row.low < row.high and value - row.low <= ACTIVE and price > LEAST_PRICE
        for row, value, price in zip(rows, solution.g, prices, strict=True)
    )


def orders_beside(
    trace: TracedCycle, structure: EventOrder, design: Mapping[str, float]
) -> list[tuple[EventOrder, Mapping[str, float]]]:
    """Return the other orders of events beside a design [SI], each with a design that has it, the nearest first."""
    designs = []
    for step, (name, way) in itertools.product(STEPS, itertools.product(trace.problem.free, (-1.0, 1.0))):
        low, high = trace.problem.quantities[name].bounds
        designs.append({**design, name: min(max(design[name] + way * step * (high - low), low), high)})
    orders: dict[tuple[object, ...], tuple[EventOrder, Mapping[str, float]]] = {}
    for sample in trace.samples(designs):
        own = sample.structure
        if own is not None and not own.like(structure):
            orders.setdefault((own.which, own.rising), (replace(own, slow=structure.slow), sample.values))
    return list(orders.values())
