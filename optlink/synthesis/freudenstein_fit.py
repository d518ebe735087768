"""Fit a linkage at every start position of a function by weighted least squares on the loop equation, vectorised."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from optlink.linkage.vector2d import Array
from optlink.synthesis.loop_equations import EXACT, LoopEquation

Keep = Callable[[Array, Array, Array, Array, Array, Array], Any]
"""Admissible linkages, elementwise: (crank, coupler, rocker, phi0, psi0, side), all (m,), to (m,) bool."""

BLOCK = 1 << 17  # numbers in one array of the scan, so that it fits in the cache
FITS_PER_START = 2  # fits per start position, unweighted then weighted; a third has no measurable effect
FLATTEST = 0.05  # of the largest slope: limits the weight of positions near a dead position
SINGULAR = 1e-12  # squared sine between the columns of a fit below which its constants are not determined
ZOOMS = 6  # successive grids around a start position, each of half the width
FINE = np.array([-1.0, -0.5, 0.0, 0.5, 1.0])


@dataclass(frozen=True)
class FitProblem:
    """Target rotations [rad] of crank `x` and rocker `y` (n,) from their starts, and the linkages that may produce them.

    At least three rotations of the crank differ, and the rocker moves. `largest`: the largest output error counts, not its root
    mean square. `shift`: a fit with a negative crank or rocker is replaced by the linkage that starts half a turn further, so
    that grids over half a turn cover all starts; otherwise start angles stay within the range of their grid. A limit of `keep`
    that may be active at the optimum should be relaxed slightly: the fit at the nearest start may just violate it.
    """

    chain: LoopEquation
    x: Array
    y: Array
    largest: bool
    shift: bool
    keep: Keep | None

    def figure(self, errors: Array) -> Array:
        """Return the largest absolute value, or the root mean square, over the last axis."""
        return np.asarray(np.max(np.abs(errors), axis=-1) if self.largest else np.sqrt(np.mean(errors * errors, axis=-1)))


@dataclass(frozen=True)
class Cells:
    """Fitted linkages, one per start position (m,), with positive lengths; `error` is infinite for inadmissible ones."""

    x0: Array
    y0: Array
    k: Array
    side: Array
    error: Array
    margin: Array

    def __getitem__(self, index: Any) -> Cells:
        return Cells(*(values[index] for values in vars(self).values()))


def _together(cells: list[Cells]) -> Cells:
    return Cells(*map(np.concatenate, zip(*(vars(cell).values() for cell in cells), strict=True)))


def _weighted(task: FitProblem, u: Array, v: Array, w: Array, q: Array) -> Array:
    """Minimise the sum of q (K1 u + K2 v + K3 - w)^2 within the limits; return the constants (m, 3), NaN where undetermined."""
    total = np.sum(q, axis=-1)
    mu, mv, mw = (np.einsum("mn,mn->m", q, a) / total for a in (u, v, w))
    du, dv, dw = u - mu[:, None], v - mv[:, None], w - mw[:, None]
    qu, qv = q * du, q * dv
    uu, uv, vv = (np.einsum("mn,mn->m", a, b) for a, b in ((qu, du), (qu, dv), (qv, dv)))
    uw, vw = np.einsum("mn,mn->m", qu, dw), np.einsum("mn,mn->m", qv, dw)
    det = uu * vv - uv * uv
    det = np.where((det > SINGULAR * uu * vv) & (np.minimum(uu, vv) > SINGULAR * total), det, np.nan)
    k = np.stack([(vv * uw - uv * vw) / det, (uu * vw - uv * uw) / det], axis=-1)
    rows, bounds = task.chain.limits
    sign = np.copysign(1.0, k) if task.shift else np.ones_like(k)
    outside = np.any((sign * k) @ rows[:, :2].T > bounds, axis=-1)
    if np.any(outside):
        normal = np.stack([uu, uv, uv, vv], axis=-1).reshape(-1, 2, 2)[outside]
        k[outside] = _on_edges(normal, np.stack([uw, vw], axis=-1)[outside], task.chain.corners * sign[outside, None])
    return np.stack([k[:, 0], k[:, 1], mw - k[:, 0] * mu - k[:, 1] * mv], axis=-1)


def _on_edges(normal: Array, right: Array, corners: Array) -> Array:
    """Minimise k' N k - 2 k' r on the edges of polygons: points (m, 2); N (m, 2, 2), r (m, 2), corners (m, e, 2) in order."""
    along = np.roll(corners, -1, axis=1) - corners
    steep = np.einsum("mei,mij,mej->me", along, normal, along)
    fall = np.einsum("mei,mei->me", along, right[:, None] - np.einsum("mij,mej->mei", normal, corners))
    points = corners + np.clip(fall / steep, 0.0, 1.0)[..., None] * along
    value = np.einsum("mei,mij,mej->me", points, normal, points) - 2.0 * np.einsum("mei,mi->me", points, right)
    return np.asarray(points[np.arange(len(points)), np.argmin(value, axis=-1)])


def fit(task: FitProblem, x0: Array, y0: Array) -> Cells:
    """Fit a linkage at every start position (m,) [rad] by weighted least squares that approximates the output error."""
    chain = task.chain
    x, y = x0[:, None] + task.x, y0[:, None] + task.y
    u, v, w = chain.terms(x, y)
    k = _weighted(task, u, v, w, np.ones_like(w))
    for _ in range(1, FITS_PER_START):
        slope = np.abs(chain.slope(x, y, k))
        floor = FLATTEST * np.max(slope, axis=-1, keepdims=True)
        q = np.maximum(np.maximum(slope, floor), 1e-100) ** -2.0
        k = _weighted(task, u, v, w, q / np.max(q, axis=-1, keepdims=True))
    return fit_error(task, x0, y0, k)


def fit_error(task: FitProblem, x0: Array, y0: Array, k: Array) -> Cells:
    """Compute assembly mode, output error and transmission margin of linkages; inadmissible ones get an infinite error."""
    chain = task.chain
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        good = np.all(np.isfinite(k), axis=-1)
        start = (x0, y0)
        x0, y0, k = chain.upright(x0, y0, k)
        if not task.shift:
            good &= (x0 == start[0]) & (y0 == start[1])
        x, y = x0[:, None] + task.x, y0[:, None] + task.y
        modes = -np.sign(chain.slope(x, y, k))
        side = np.where(np.sum(modes, axis=-1) >= 0.0, 1.0, -1.0)
        sizes = chain.sizes(k)
        margin = chain.margin(sizes, np.min(x, axis=-1), np.max(x, axis=-1))
        good &= np.all(modes == side[:, None], axis=-1) & chain.fits(sizes) & (margin > 0.0)
        error = task.figure(chain.difference(chain.follow(x, k, side), y))
        good &= np.isfinite(error)
        if task.keep is not None:
            good[good] = np.asarray(task.keep(*(a[good] for a in (*sizes, x0, y0, side))), dtype=bool)
    return Cells(x0, y0, k, side, np.where(good, error, np.inf), margin)


def scan(task: FitProblem, x0: Array, y0: Array) -> Cells:
    """Return the admissible fits of all pairs of start positions x0 (p,) and y0 (q,) [rad]."""
    first, second = (a.ravel() for a in np.meshgrid(x0, y0, indexing="ij"))
    blocks = min(first.size, math.ceil(first.size * task.x.size / BLOCK))
    fits = []
    for one, other in zip(np.array_split(first, blocks), np.array_split(second, blocks), strict=True):
        cells = fit(task, one, other)
        fits.append(cells[np.isfinite(cells.error)])
    return _together(fits)


def step_of(grid: Array) -> float:
    """Return the largest distance of neighbouring grid values; zero for a single value."""
    return float(np.max(np.diff(np.sort(grid)), initial=0.0))


def distinct_cells(task: FitProblem, cells: Cells, room: tuple[float, float], count: int) -> list[int]:
    """Return the indices of at most `count` best cells that differ by more than `room` in start position, or in assembly mode.

    Ordered by increasing error; cells of negligible error by decreasing transmission margin. `room`: distances in x0 and y0
    [rad].
    """
    chosen: list[int] = []
    for i in np.lexsort((-cells.margin, np.maximum(cells.error, EXACT))):
        if len(chosen) == count:
            break
        others = cells[chosen]
        dx = np.abs(task.chain.difference(others.x0, cells.x0[i]))
        dy = np.abs(task.chain.difference(others.y0, cells.y0[i]))
        near = (dx <= room[0]) & (dy <= room[1]) & (others.side == cells.side[i])
        if not np.any(near):
            chosen.append(int(i))
    return chosen


def zoom(task: FitProblem, cells: Cells, grids: tuple[Array, Array]) -> Cells:
    """Refine the start positions of cells on successively finer local grids; without `shift` they stay within their grid.

    The steps of the grids of x0 (p,) and y0 (q,) from which the cells come are the first search radii.
    """
    reach = [step_of(grid) for grid in grids]
    if len(cells.error) == 0 or not any(reach):
        return cells
    first, second = (a.ravel() for a in np.meshgrid(*(FINE if r > 0.0 else FINE[2:3] for r in reach), indexing="ij"))
    ranges = [(-np.inf, np.inf) if task.shift else (grid[0], grid[-1]) for grid in grids]
    for _ in range(ZOOMS):
        x0 = np.clip(cells.x0[:, None] + reach[0] * first, *ranges[0])
        y0 = np.clip(cells.y0[:, None] + reach[1] * second, *ranges[1])
        fits = fit(task, x0.ravel(), y0.ravel())
        best = np.argmin(fits.error.reshape(x0.shape), axis=-1) + first.size * np.arange(len(x0))
        better = np.flatnonzero(fits.error[best] < cells.error)
        both = _together([cells, fits[best]])
        index = np.arange(len(x0))
        index[better] += len(x0)
        cells = both[index]
        reach = [0.5 * r for r in reach]
    return cells
