"""Extremes and zeros of functions of the crank angle, many at a time: sampled, bracketed, closed in on together."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Function = Callable[[Array], Array]
"""Crank angles (n,) [rad] -> values (functions, n)."""

POINTS = 9  # of a bracket, per round
ROUNDS = 12  # each shrinks the brackets to two of the eight steps: 6e-8 of a grid step at the end


def extremes(function: Function, grid: Array, breaks: Sequence[float] = ()) -> tuple[Array, Array]:
    """Least and largest value of every function over the range of the grid.

    Parameters
    ----------
    function : crank angles (n,) -> values (functions, n), NaN where there is none
    grid : array (n,) [rad], rising
        Fine enough that each extreme lies beside the best grid point.
    breaks : crank angles where the functions may jump; no bracket reaches across one

    Returns
    -------
    angles, values : arrays (functions, 2), of the least and of the largest value; NaN where a function has none
    """
    values = function(grid)
    signs = np.array([1.0, -1.0])
    scored = np.where(np.isfinite(values), values, np.inf)[:, None, :] * signs[None, :, None]
    scored = np.where(np.isfinite(values)[:, None, :], scored, np.inf)
    best = np.argmin(scored, axis=-1)  # (functions, 2)
    centre = grid[best]
    low, high = grid[np.maximum(best - 1, 0)], grid[np.minimum(best + 1, len(grid) - 1)]
    for at in breaks:
        low, high = np.where((low < at) & (at < centre), at, low), np.where((centre < at) & (at < high), at, high)
    value = np.take_along_axis(values, best, axis=-1)
    rows = np.arange(len(values))[:, None, None]

    def own(points: Array) -> Array:
        found = function(points.ravel()).reshape(len(values), *points.shape)
        return np.asarray(found[rows, rows, np.arange(2)[None, :, None], np.arange(POINTS)[None, None, :]])

    return _closed_in(own, centre, value, low, high)


def extremes_of_rows(function: Function, grid: Array) -> Array:
    """Least and largest value of every row of a function, each row closed in on at crank angles of its own.

    Parameters
    ----------
    function : crank angles (rows, n) [rad] -> values (rows, n), finite
    grid : array (n,) [rad], rising
        Fine enough that each extreme lies beside the best grid point.

    Returns
    -------
    values : array (rows, 2)
    """
    values = function(grid[None, :])
    best = np.stack([np.argmin(values, axis=1), np.argmax(values, axis=1)], axis=1)
    low, high = grid[np.maximum(best - 1, 0)], grid[np.minimum(best + 1, len(grid) - 1)]

    def own(points: Array) -> Array:
        return function(points.reshape(len(points), -1)).reshape(points.shape)

    return _closed_in(own, grid[best], np.take_along_axis(values, best, axis=1), low, high)[1]


def _closed_in(own: Callable[[Array], Array], centre: Array, value: Array, low: Array, high: Array) -> tuple[Array, Array]:
    """Close in on extremes within their brackets: `own` gives the values (rows, 2, n) at crank angles (rows, 2, n)."""
    signs, steps = np.array([1.0, -1.0]), np.linspace(0.0, 1.0, POINTS)
    for _ in range(ROUNDS):
        points = low[..., None] + (high - low)[..., None] * steps
        found = own(points)
        score = np.where(np.isfinite(found), found * signs[None, :, None], np.inf)
        place = np.argmin(score, axis=-1)
        near = np.take_along_axis(points, place[..., None], axis=-1)[..., 0]
        at_near = np.take_along_axis(found, place[..., None], axis=-1)[..., 0]
        better = np.where(np.isfinite(at_near), at_near * signs < value * signs, False)
        centre, value = np.where(better, near, centre), np.where(better, at_near, value)
        low = np.take_along_axis(points, np.maximum(place - 1, 0)[..., None], axis=-1)[..., 0]
        high = np.take_along_axis(points, np.minimum(place + 1, POINTS - 1)[..., None], axis=-1)[..., 0]
    lost = ~np.isfinite(value)
    return np.where(lost, np.nan, centre), value


STILL = 1e-11
"""Share of its largest value below which a rate is rounding."""


def zeros(function: Function, grid: Array, count: int = 60, *, still: bool = False) -> list[Array]:
    """Crank angles [rad] at which each function changes its sign, to the last digits.

    Parameters
    ----------
    function : crank angles (n,) -> values (functions, n)
    grid : array (n,) [rad], rising
    count : rounds of bisection at most
    still : whether the functions are rates of what may stand still for a while: rounding does not reverse it

    Returns
    -------
    one rising array per function; sign changes across a gap (NaN) or a jump to NaN are none
    """
    values = function(grid)
    if still:
        size = np.max(np.where(np.isfinite(values), np.abs(values), 0.0), axis=1, keepdims=True, initial=0.0)
        values = np.where(np.abs(values) <= STILL * size, 0.0, values)
    left, right = values[:, :-1], values[:, 1:]
    crossing = np.isfinite(left) & np.isfinite(right) & (np.sign(left) * np.sign(right) <= 0.0) & (left != 0.0)
    which, where = np.nonzero(crossing)
    a, b = grid[where], grid[where + 1]
    at_a = values[which, where]
    column = np.arange(len(which))
    for _ in range(count if len(which) else 0):
        middle = 0.5 * (a + b)
        at = function(middle)[which, column]
        same = np.sign(at) == np.sign(at_a)
        a, b = np.where(same, middle, a), np.where(same, b, middle)
        if np.all(b - a <= 2.0 * np.spacing(np.maximum(np.abs(a), np.abs(b)))):
            break
    return [b[which == k] for k in range(len(values))]
