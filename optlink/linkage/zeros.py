"""Zeros of many functions of the crank angle at once: sampled on one grid, then refined together.

References
----------
T. R. Chandrupatla, A new hybrid quadratic/bisection algorithm for finding the zero of a nonlinear function without using
derivatives, Advances in Engineering Software 28 (1997) 145-149.
"""

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from optlink.linkage.extrema import Function, Index, in_portions, own_values
from optlink.linkage.vector2d import Array

STILL = 1e-11
"""Share of its largest value below which a rate is rounding."""
ROUNDS = 60  # at most, of inverse quadratic interpolation or bisection
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
    roots[rest] = refined_roots(own, low, high, at_low, at_high, ROUNDS)
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
