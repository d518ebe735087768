"""Extrema of many functions of the crank angle at once: sampled on one grid, then refined together.

Every function is refined on an interpolant of its samples and evaluated once more at the extremum of the interpolant; where
the interpolant is not accurate, more samples are taken. Where several local extrema are nearly equal, all of them are refined.
"""

import itertools
import math
from collections.abc import Callable, Hashable, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from optlink.linkage.vector2d import Array, finite_or

Index = NDArray[np.intp]
Function = Callable[[Array], Array]
"""Crank angles (n,) [rad] -> values (functions, n)."""
POINTS = 9  # of a bracket, per round
ROUNDS = 12  # each shrinks the brackets to two of the eight steps: 6e-8 of a grid step at the end
EXACT = 1e-9  # share of the range of its samples by which an interpolant may be wrong
ROUNDING = 1e-13  # share of the largest value of its kind that is rounding error
SMOOTH = 1e-6  # share of that range which the last term of an interpolant may add half-way between samples
BEFORE = 1e-9  # rad before a jump at which the value before it is sampled
RIVALS = 6  # further local extrema that are refined at most, where the samples do not decide
ROWS = 16  # functions whose parabolas are computed at once, to keep memory small
UNEVEN = 1e-3  # least ratio of two steps with a parabola
PORTION, VALUES = 512, 1_000_000  # angles, and values of all functions, per portion
HALFWAY = float(np.prod(np.arange(0.5, POINTS // 2) ** 2))
"""Product of the distances to all samples but the last, from half-way between the two in the middle."""


def distinct(values: ArrayLike) -> NDArray[Any]:
    """Return the distinct values, rising, as np.unique does without the masked arrays that it loads."""
    rising: NDArray[Any] = np.sort(np.asarray(values), axis=None)
    new = np.concatenate([np.ones(min(1, rising.size), dtype=bool), rising[1:] != rising[:-1]])
    result: NDArray[Any] = rising[new]
    return result


def extremes(
    function: Function,
    grid: Array,
    breaks: Sequence[float] = (),
    kinds: Sequence[Hashable] | None = None,
    *,
    periodic: bool = False,
    signs: tuple[float, ...] = (1.0, -1.0),
) -> tuple[Array, Array]:
    """Compute angles and values (functions, 2) of the least and the largest value of every function over the range of the grid.

    Both are NaN where a function has none; it may be NaN in places. Each extremum must lie beside the best point of the rising
    `grid`. At `breaks` the functions may jump to the value that they have there. Functions of one of the `kinds` have the same
    unit: one that is rounding error compared with the others is not refined. On a `periodic` grid an extremum beside an end is
    refined on both sides of it.
    """
    sampled = SampledFunctions(function, grid, breaks, kinds, periodic=periodic)
    return sampled.extremes(np.arange(len(sampled.values)), lambda angles, rows: function(angles)[rows], signs)


def maxima(function: Function, grid: Array, breaks: Sequence[float] = (), *, periodic: bool = False) -> tuple[Array, Array]:
    """Compute angles and values (functions,) of the largest value of every function, as `extremes` does."""
    angles, values = extremes(function, grid, breaks, periodic=periodic, signs=(-1.0,))
    return angles[:, 0], values[:, 0]


class SampledFunctions:
    """Functions sampled over the range of a grid, as for `extremes`; the extremes of some of them are refined at a time."""

    def __init__(
        self,
        function: Function,
        grid: Array,
        breaks: Sequence[float] = (),
        kinds: Sequence[Hashable] | None = None,
        *,
        periodic: bool = False,
    ) -> None:
        edges = np.asarray(breaks, dtype=float)
        if periodic:
            edges = (edges + (grid[-1] - grid[0]) * np.array([[-1.0], [0.0], [1.0]])).ravel()
            grid = _continued(grid)
        edges = edges[(edges > grid[0]) & (edges < grid[-1])]
        if edges.size:
            apart = np.min(np.abs(grid[:, None] - edges), axis=1) > BEFORE
            grid = distinct(np.concatenate([grid[apart], edges - BEFORE, edges]))
        self.grid, self.edges, self.beyond = grid, edges, int(periodic)
        self.values = in_portions(function, grid)
        self._zero = _zero(self.values, kinds)

    def extremes(
        self, rows: Index, function: Callable[[Array, Index], Array], signs: tuple[float, ...] = (1.0, -1.0)
    ) -> tuple[Array, Array]:
        """Return angles and values (rows, signs) of the least value of some functions, by their rising numbers, times each sign.

        `function` maps crank angles (n,) and numbers of functions (k,) to values (k, n).
        """

        def own(points: Array, which: Index) -> Array:
            numbers = rows[which // len(signs)].repeat(points.shape[1])
            return own_values(function, points.ravel(), numbers, len(self.values)).reshape(points.shape)

        return _extremes(self.values[rows], self.grid, self.edges, self._zero[rows], own, self.beyond, signs)


def extremes_of_rows(
    function: Function,
    grid: Array,
    samples: Array | None = None,
    *,
    periodic: bool = True,
    signs: tuple[float, ...] = (1.0, -1.0),
) -> Array:
    """Compute the least and the largest value (rows, signs) of every row of a function, each refined at its own crank angles.

    `function` maps crank angles (rows, n), or (1, n) for all rows, to values (rows, n), which may be NaN in places. The rising
    grid is fine as for `extremes`, and one period if it is `periodic`. `samples`: the values (rows, n) on it, if they are known.
    The extremes of a row do not depend on the other rows.
    """
    if periodic:
        grid = _continued(grid)
        samples = samples if samples is None else np.concatenate([samples[:, -2:-1], samples, samples[:, 1:2]], axis=1)
    samples = function(grid[None, :]) if samples is None else samples

    def own(points: Array, which: Index) -> Array:
        slot = np.arange(len(which)) - np.searchsorted(which, which)  # among those of the same extremum
        points_by_row = np.full((len(signs) * len(samples), int(np.max(slot, initial=0)) + 1, points.shape[1]), grid[0])
        points_by_row[which, slot] = points
        values_at: Array = function(points_by_row.reshape(len(samples), -1)).reshape(points_by_row.shape)[which, slot]
        return values_at

    return _extremes(samples, grid, np.zeros(0), np.zeros(len(samples), dtype=bool), own, int(periodic), signs)[1]


def _continued(grid: Array) -> Array:
    """Return a grid over one period with one further point before and after it."""
    return np.concatenate([grid[:1] - (grid[-1] - grid[-2]), grid, grid[-1:] + (grid[1] - grid[0])])


def _extremes(
    values: Array,
    grid: Array,
    breaks: Array,
    zero: NDArray[np.bool_],
    values_at: Callable[[Array, Index], Array],
    beyond: int,
    signs: tuple[float, ...] = (1.0, -1.0),
) -> tuple[Array, Array]:
    """Angles and values (functions, signs) of the least of the values (functions, n) on a grid times each sign, refined.

    `values_at` returns the values (m, k) at crank angles (m, k) for the extrema number (m,), rising: those of the first function
    come first, in the order of the signs. The first and the last `beyond` points of the grid only continue it: no extremum is
    sought there.
    """
    finite = np.isfinite(values)
    finite[:, [*range(beyond), *range(len(grid) - beyond, len(grid))]] = False
    best = np.stack([np.argmin(np.where(finite, one * values, np.inf), axis=-1) for one in signs], axis=-1).ravel()
    rows, sign = np.arange(len(values)).repeat(len(signs)), np.tile(signs, len(values))
    angle, value = grid[best], sign * values[rows, best]
    some = np.flatnonzero(np.isfinite(value) & ~zero[rows])  # extrema still to be refined
    part = np.searchsorted(breaks, grid, side="right")
    room = EXACT * (np.where(finite, values, -np.inf).max(axis=-1) - np.where(finite, values, np.inf).min(axis=-1))[rows]

    def refined(which: Index, samples: Index) -> tuple[Array, Array]:
        """Refine samples (m,) of extrema number (m,), rising."""
        at = grid[samples]
        low, high = grid[np.maximum(samples - 1, 0)], grid[np.minimum(samples + 1, len(grid) - 1)]
        for edge in breaks:
            low, high = (
                np.where((low < edge) & (edge <= at), edge, low),
                np.where((at < edge) & (edge <= high), edge - BEFORE, high),
            )
        nodes, beside = _beside(values, rows[which], grid, samples, breaks)
        return refined_minima(
            lambda points, number: sign[which[number], None] * values_at(points, which[number]),
            (at, sign[which] * values[rows[which], samples], low, high),
            np.arange(len(which)),
            nodes,
            sign[which, None] * beside,
        )

    angle[some], value[some] = _lower(angle[some], value[some], *refined(some, best[some]))
    others = _rivals(values, finite, signs, grid, part)
    for near in (np.maximum(best - 1, 0), best, np.minimum(best + 1, len(grid) - 1)):  # in the bracket
        same = np.flatnonzero(part[near] == part[best])
        others[same, near[same]] = np.inf
    limit = value - room
    some = some[np.min(others[some], axis=-1, initial=np.inf) < limit[some]]
    count = min(RIVALS, len(grid) - 1)
    lowest = np.argpartition(others[some], count, axis=-1)[:, :count]
    row, place = np.nonzero(np.take_along_axis(others[some], lowest, axis=-1) < limit[some, None])
    which = some[row]
    if which.size:
        at, least = refined(which, lowest[row, place])
        order = np.argsort(-finite_or(least, np.inf), kind="stable")  # the lowest of each extremum last
        last = dict(zip(which[order].tolist(), order.tolist(), strict=True))
        each, chosen = np.array([*last]), np.array([*last.values()])
        angle[each], value[each] = _lower(angle[each], value[each], at[chosen], least[chosen])
    shape = (len(values), len(signs))
    return np.where(np.isfinite(value), angle, np.nan).reshape(shape), (sign * value).reshape(shape)


def _rivals(values: Array, finite: NDArray[np.bool_], signs: tuple[float, ...], grid: Array, part: Index) -> Array:
    """Lower bounds (functions x signs, n) of the local minima beside samples (functions, n) times each sign; infinite elsewhere.

    Each is that of the parabola through three samples of one part of the grid, less its error by the third differences.
    """
    candidates = np.full((len(values) * len(signs), len(grid)), np.inf)
    before, after = np.diff(grid)[:-1], np.diff(grid)[1:]
    longer = np.maximum(before, after)
    together = (part[2:] == part[:-2]) & (np.minimum(before, after) > UNEVEN * longer)
    for (k, sign), first in itertools.product(enumerate(signs), range(0, len(values), ROWS)):
        some = slice(first, first + ROWS)
        signed = np.where(finite[some], sign * values[some], np.nan)
        with np.errstate(all="ignore"):
            slopes = np.diff(signed, axis=-1) / np.diff(grid)
            curvature = 2.0 * np.diff(slopes, axis=-1) / (before + after)
            slope = (slopes[:, :-1] * after + slopes[:, 1:] * before) / (before + after)
            change = np.abs(np.diff(curvature, axis=-1, prepend=curvature[:, :1], append=curvature[:, -1:]))
            lowest = signed[:, 1:-1] - 0.5 * slope * slope / curvature - np.fmax(change[:, :-1], change[:, 1:]) * longer**2
            place = -slope / curvature
            inside = together & (curvature > 0.0) & np.isfinite(lowest) & (-before <= place) & (place <= after)
        rows, middle = np.nonzero(inside)
        nearest = middle + 1 + (place > 0.5 * after)[inside] - (place < -0.5 * before)[inside]
        np.minimum.at(candidates, ((first + rows) * len(signs) + k, nearest), lowest[inside])
    return candidates


def refined_minima(
    values_at: Callable[[Array, Index], Array], best: tuple[Array, Array, Array, Array], some: Index, nodes: Array, samples: Array
) -> tuple[Array, Array]:
    """Refine minima that are bracketed by samples, each on an interpolant of its samples, or on more samples.

    `values_at` maps crank angles (m, k) and numbers of minima (m,) to values (m, k); `best` are angle, value and both ends of
    the bracket [rad] of each (n,). Only the minima numbered `some` (m,) are refined; `nodes` and `samples` (m, points) are crank
    angles about each of these and the values there, NaN for none. Angles and values (n,) of all are returned.
    """
    angle, value, low, high = (np.array(part) for part in best)
    for left in range(ROUNDS, -1, -1):
        polynomials, tolerance = _interpolants(nodes, samples)
        at, expected = _refined(polynomials, low[some], high[some], angle[some], value[some])
        exact = values_at(at[:, None], some)[:, 0]
        angle[some], value[some] = _lower(angle[some], value[some], at, exact)
        some = some[~(np.abs(exact - expected) <= tolerance)]
        if not left or not some.size:
            break
        nodes = _points(low[some], high[some])
        samples = values_at(nodes, some)
        at, lowest, low[some], high[some] = _lowest(nodes, samples)
        angle[some], value[some] = _lower(angle[some], value[some], at, lowest)
    return angle, value


def _zero(values: Array, kinds: Sequence[Hashable] | None) -> NDArray[np.bool_]:
    """Return which functions are rounding error compared with others of their kind."""
    if kinds is None:
        return np.zeros(len(values), dtype=bool)
    size = np.max(np.where(np.isfinite(values), np.abs(values), 0.0), axis=-1, initial=0.0)
    largest = dict.fromkeys(kinds, 0.0)
    for kind, magnitude in zip(kinds, size, strict=True):
        largest[kind] = max(largest[kind], float(magnitude))
    zero: NDArray[np.bool_] = size <= ROUNDING * np.array([largest[kind] for kind in kinds])
    return zero


def _lower(angle: Array, value: Array, at: Array, other: Array) -> tuple[Array, Array]:
    """The lower of two candidates (n,), the first where the other is not finite."""
    lower = np.where(np.isfinite(other), other < value, False)
    return np.where(lower, at, angle), np.where(lower, other, value)


def _points(low: Array, high: Array) -> Array:
    """Points (n, points) from `low` to `high`."""
    return low[:, None] + (high - low)[:, None] * np.linspace(0.0, 1.0, POINTS)


def _lowest(points: Array, values: Array) -> tuple[Array, Array, Array, Array]:
    """Angle and value of the lowest of some points (n, points), and the points before and after it."""
    row, place = np.arange(len(points)), np.argmin(finite_or(values, np.inf), axis=-1)
    before, after = np.maximum(place - 1, 0), np.minimum(place + 1, POINTS - 1)
    return points[row, place], values[row, place], points[row, before], points[row, after]


def _refined(curves: Function, low: Array, high: Array, angle: Array, value: Array) -> tuple[Array, Array]:
    """Angles and values (n,) of the minima of curves between `low` and `high`; the input values where there is no lower one."""
    for _ in range(ROUNDS):
        points = _points(low, high)
        at, lowest, low, high = _lowest(points, curves(points))
        angle, value = _lower(angle, value, at, lowest)
    return angle, value


def _beside(values: Array, rows: Index, grid: Array, best: Index, breaks: Array) -> tuple[Array, Array]:
    """Grid points (n, points) beside the best ones, none across a break, and the values of `rows` there; NaN if too few."""
    ends = distinct(np.concatenate([[0, len(grid)], np.searchsorted(grid, breaks)])).astype(int)
    part = np.searchsorted(ends, best, side="right")
    first, last = ends[part - 1], ends[part]
    begin = np.clip(best - POINTS // 2, first, np.maximum(last - POINTS, first))
    enough = (last - first >= POINTS)[:, None]
    index = np.where(enough, begin[:, None] + np.arange(POINTS), 0)
    return grid[index], np.where(enough, values[rows[:, None], index], np.nan)


def _interpolants(nodes: Array, samples: Array) -> tuple[Function, Array]:
    """Polynomials through samples (n, points), and the tolerated error of their extrema (n,).

    That is NaN where the samples are not smooth.
    """
    order = np.argsort(np.abs(np.arange(POINTS) - POINTS // 2), kind="stable")  # from the middle on
    nodes, differences = nodes[:, order], samples[:, order]
    with np.errstate(all="ignore"):
        scale = np.ptp(nodes, axis=-1, keepdims=True) / (POINTS - 1)
        for k in range(1, POINTS):  # Newton's divided differences
            steps = (nodes[:, k:] - nodes[:, : POINTS - k]) / scale
            differences[:, k:] = (differences[:, k:] - differences[:, k - 1 : -1]) / steps
        spread, rounding = np.ptp(samples, axis=-1), ROUNDING * np.max(np.abs(samples), axis=-1)
        smooth = np.abs(differences[:, -1]) * HALFWAY <= SMOOTH * spread + rounding

    def curves(points: Array) -> Array:
        values = np.broadcast_to(differences[:, -1:], points.shape)
        with np.errstate(all="ignore"):
            for k in range(POINTS - 2, -1, -1):
                values = differences[:, k, None] + (points - nodes[:, k, None]) / scale * values
        return values

    return curves, np.where(smooth, EXACT * spread + rounding, np.nan)


def in_portions(function: Function, angles: Array) -> Array:
    """Evaluate functions at crank angles (n,), in portions of these to limit memory; returns values (functions, n)."""
    parts: list[Array] = []
    done, size = 0, PORTION
    while done < len(angles) or not parts:
        values = function(angles[done : done + size])
        parts.append(values)
        done, size = done + size, max(PORTION, VALUES // max(1, len(values)))
    return np.concatenate(parts, axis=-1)


def own_values(function: Callable[[Array, Index], Array], angles: Array, rows: Index, functions: int) -> Array:
    """Evaluate at each crank angle (n,) that of many functions whose number is in `rows` (n,), in portions to limit memory.

    `function` maps crank angles (n,) and the numbers of the functions needed (k,) to values (k, n); `functions` is the number of
    all.
    """
    parts: list[Array] = [np.empty(0)]
    done, size = 0, PORTION
    while done < len(angles):
        part = slice(done, done + size)
        needed = distinct(rows[part])
        values = function(angles[part], needed)
        parts.append(values[np.searchsorted(needed, rows[part]), np.arange(values.shape[1])])
        done, size = done + size, max(PORTION, VALUES // max(1, functions))
    return np.concatenate(parts)


# Zeros of many functions of the crank angle at once: sampled on one grid, then refined together.
#
# References
# ---------- T. R. Chandrupatla, A new hybrid quadratic/bisection algorithm for finding the zero of a nonlinear function without
# using derivatives, Advances in Engineering Software 28 (1997) 145-149.

STILL = 1e-11
"""Share of its largest value below which a rate is rounding."""
ZERO_ROUNDS = 60  # at most, of inverse quadratic interpolation or bisection
NEWTON = 12  # steps
NOISE = 1024  # units of the last place: shorter steps that no longer shrink are due to rounding of the function
Slope = Callable[[int, float], tuple[float, float]]
"""Index of a function and crank angle -> value, derivative."""


def zeros(
    function: Function,
    grid: Array,
    *,
    still: bool = False,
    rising: bool = False,
    slope: Slope | None = None,
    samples: Array | None = None,
) -> list[Array]:
    """Compute the crank angles [rad] at which each function changes sign, rising, to machine precision.

    Sign changes across a gap (NaN) or a jump to NaN do not count; with `rising`, only those from negative to positive: where the
    function is a rate, minima. `still`: see `sign_changes`. `samples` are the values (functions, n) on the grid, where they are
    known. With `slope` Newton's method replaces the rounds of inverse quadratic interpolation or bisection wherever it converges
    within the bracket.
    """
    values = in_portions(function, grid) if samples is None else samples
    crossing, left, right = sign_changes(values, still=still)
    if rising:
        crossing &= left < 0.0
    which, where = np.nonzero(crossing)

    ends = grid[where], grid[where + 1], left[crossing], right[crossing]
    roots = np.full(len(which), np.nan)
    if slope is not None:
        roots[:] = [_newton(slope, int(k), *(float(end[i]) for end in ends)) for i, k in enumerate(which)]
    rest = np.flatnonzero(np.isnan(roots))

    def own(angles: Array, brackets: Index) -> Array:
        return own_values(lambda at, rows: function(at)[rows], angles, which[rest[brackets]], len(crossing))

    low, high, at_low, at_high = (end[rest] for end in ends)
    roots[rest] = refined_roots(own, low, high, at_low, at_high, ZERO_ROUNDS)
    return [roots[which == k] for k in range(len(crossing))]


def sign_changes(values: Array, *, still: bool = False) -> tuple[NDArray[np.bool_], Array, Array]:
    """Return between which samples (..., n) functions change sign (..., n - 1), and their values before and after each step.

    With `still` they are rates that may be zero over a range: rounding errors then count as zero, not as reversals.
    """
    if still:
        size = np.max(np.where(np.isfinite(values), np.abs(values), 0.0), axis=-1, keepdims=True, initial=0.0)
        values = np.where(np.abs(values) <= STILL * size, 0.0, values)
    left, right = values[..., :-1], values[..., 1:]
    return np.isfinite(left) & np.isfinite(right) & (np.sign(left) * np.sign(right) <= 0.0) & (left != 0.0), left, right


def _newton(slope: Slope, k: int, low: float, high: float, at_low: float, at_high: float) -> float:
    """Return the zero of a function within a bracket, to rounding; NaN if Newton's method leaves it or does not converge."""
    at, last, place = low + (high - low) * abs(at_low) / (abs(at_low) + abs(at_high)), math.inf, math.ulp(high)
    for _ in range(NEWTON):
        value, rate = slope(k, at)
        step = value / rate if rate else math.inf
        at -= step
        if not low <= at <= high:
            return math.nan
        if abs(step) <= 2.0 * place or (abs(step) <= NOISE * place and abs(step) > 0.5 * last):
            return at
        last = abs(step)
    return math.nan


def refined_roots(
    function: Callable[[Array, Index], Array], low: Array, high: Array, at_low: Array, at_high: Array, count: int
) -> Array:
    """Return the upper ends (n,) of the brackets of sign changes, refined to rounding in `count` rounds at most.

    `function` maps crank angles (m,) and numbers of the brackets that they lie in (m,) to values (m,); `at_low` and `at_high`
    (n,) are those at the ends of the brackets (Chandrupatla 1997).
    """
    # `new` and `old` bracket a zero, `last` is the end dropped before
    roots, active, sign = high.copy(), np.arange(len(low)), np.sign(at_low)
    new, old, last, f_new, f_old, f_last = high, low, low, at_high, at_low, at_low
    lower = np.zeros(len(low), dtype=bool)  # whether `new` is the lower end
    step, rounding = np.full(len(low), 0.5), np.spacing(np.maximum(np.abs(low), np.abs(high)))
    for _ in range(count if len(low) else 0):
        at = new + step * (old - new)
        f_at = function(at, active)
        below = np.sign(f_at) == sign
        same = below == lower
        last, f_last = np.where(same, new, old), np.where(same, f_new, f_old)
        old, f_old = np.where(same, old, new), np.where(same, f_old, f_new)
        new, f_new, lower = at, f_at, below
        roots[active] = np.maximum(new, old)
        width, least = np.abs(old - new), rounding[active]  # at a zero at 0, of the bracket: not of ever smaller numbers
        wide = width > 2.0 * least
        if not np.any(wide):
            break
        active, sign, lower, width, least = (x[wide] for x in (active, sign, lower, width, least))
        new, old, last, f_new, f_old, f_last = (x[wide] for x in (new, old, last, f_new, f_old, f_last))
        with np.errstate(all="ignore"):
            xi, phi = (new - old) / (last - old), (f_new - f_old) / (f_last - f_old)
            a, b = f_new / (f_old - f_new) * f_last / (f_old - f_last), (last - new) / (old - new)
            inverse = a + b * f_new / (f_last - f_new) * f_old / (f_last - f_old)
            good = (phi * phi < xi) & ((1.0 - phi) ** 2 < 1.0 - xi) & np.isfinite(inverse)
        edge = np.minimum(0.5, least / width)
        step = np.clip(np.where(good, inverse, 0.5), edge, 1.0 - edge)
    return roots
