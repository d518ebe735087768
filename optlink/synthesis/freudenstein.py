"""First designs for function synthesis: four-bars from Freudenstein fits and convex programmes.

Every pair of start positions gets the linkage that fits a loop equation linear in three constants (`loop_equations`,
`freudenstein_fit`); the best fits are refined to the least output error of their start position, with an optimality proof
(`freudenstein_convex`).

References
----------
F. Freudenstein, Approximate synthesis of four-bar linkages, Trans. ASME 77 (1955) 853-861.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from optlink.linkage.fourbar import transmission_cosine
from optlink.linkage.vector2d import TURN, Array, root, unit
from optlink.problem.design import DesignProblem
from optlink.problem.quantity import Quantity
from optlink.problem.targets.law import Function

# Constants of the first designs of a function.
# What a search finds, and how much longer it takes, if one of them is halved or doubled: docs/constants.md.
EXACT = 1e-9  # negligible output error [rad]
# Fits at all start positions:
BLOCK = 1 << 17  # numbers in one array of the scan, so that it fits in the cache
FLATTEST = 0.05  # of the largest slope: limits the weight of positions near a dead position
SINGULAR = 1e-12  # squared sine between the columns of a fit below which its constants are not determined
ZOOMS = 6  # successive grids around a start position, each of half the width
FINE = np.array([-1.0, -0.5, 0.0, 0.5, 1.0])
# Convex programmes:
PROVEN_GAP = 1e-4  # relative gap of the output error at which it counts as proven optimal
STEPS = 12  # convex programmes per start position
# First designs:
START_SEPARATION = 3.0  # least distance of two distinct start positions, in grid steps
SPARE = 2  # `SPARE * count` start positions are refined, as some coincide afterwards
UNLIMITED = (1e-3, 1e3)  # ratios beyond a thousand are not practical
ANGLES_PER_BLOCK, BLOCKS = 1024, 8  # random start angles per block, and number of blocks
GRID = 36  # start angles of crank and rocker that are scanned, each over half a turn
WIDER = 2.0 * math.pi / 180.0  # relaxation of the transmission-angle limits: the nearest start may just violate them

# Loop equation of a four-bar that is linear in three constants (conventions of `optlink.linkage.fourbar`, frame = 1).
#
#     F = K1 cos psi - K2 cos phi + K3 - cos(phi - psi)    K1 = 1/a, K2 = 1/c, K3 = (a^2 - b^2 + c^2 + 1) / (2 a c)
#
# F = 0 states that the distance B-C equals the coupler length. On the assembly mode `side` (+1: C left of B -> D), side * F
# falls through zero as the output rises.
#
# References
# ---------- F. Freudenstein, Approximate synthesis of four-bar linkages, Trans. ASME 77 (1955) 853-861.


def _cosine_range(low: Array, high: Array) -> tuple[Array, Array]:
    """Return the least and largest cosine over low ... high [rad]."""
    ends = np.cos(low), np.cos(high)
    top = np.where(np.ceil(low / TURN) * TURN <= high, 1.0, np.maximum(*ends))
    bottom = np.where(np.ceil((low - np.pi) / TURN) * TURN + np.pi <= high, -1.0, np.minimum(*ends))
    return bottom, top


def _opposite(angle: Array, where: NDArray[np.bool_]) -> Array:
    """Turn angles by half a turn towards zero where `where` is True."""
    return np.where(where, angle - np.copysign(np.pi, angle), angle)


class LoopEquation:
    """Loop equation of a four-bar: F = K1 u + K2 v + K3 - w for crank angle x and rocker angle y [rad], both (..., n).

    `ratios` limits crank, coupler and rocker over the frame. Constants k (..., 3). `limits`: rows (r, 3) and bounds (r,) with
    rows @ k <= bounds, exactly; `corners`: those (4, 2) of the admissible region of K1, K2, in order; `box`: least and largest k
    (3,) of any linkage within the limits.
    """

    def __init__(self, ratios: tuple[float, float]) -> None:
        self.low, self.high = ratios
        least, largest = 1.0 / self.high, 1.0 / self.low
        self.limits = (np.vstack([np.eye(3)[:2], -np.eye(3)[:2]]), np.array([largest, largest, -least, -least]))
        self.corners = np.array([[least, least], [largest, least], [largest, largest], [least, largest]])
        reach = 1.0 + 2.0 * largest  # of |K3|: F = 0 at some position
        self.box = (np.array([least, least, -reach]), np.array([largest, largest, reach]))

    def terms(self, x: Array, y: Array) -> tuple[Array, Array, Array]:
        """Return the terms u, v, w of F."""
        return np.cos(y), -np.cos(x), np.cos(x - y)

    def slope(self, x: Array, y: Array, k: Array) -> Array:
        """Return dF/dy."""
        return -k[..., 0, None] * np.sin(y) - np.sin(x - y)

    def follow(self, x: Array, k: Array, side: Array) -> Array:
        """Return the output y (..., n) of the linkage; NaN where it cannot be assembled."""
        k1, k2, k3 = (k[..., i, None] for i in range(3))
        c, s = np.cos(x), np.sin(x)
        with np.errstate(invalid="ignore", divide="ignore"):
            inner = np.arccos((k2 * c - k3) / np.hypot(k1 - c, s))
        return np.arctan2(-s, k1 - c) + side[..., None] * inner

    def difference(self, y: Array, target: Array) -> Array:
        """Return the output error, angles wrapped to [-pi, pi)."""
        return np.remainder(y - target + np.pi, 2.0 * np.pi) - np.pi

    def upright(self, x0: Array, y0: Array, k: Array) -> tuple[Array, Array, Array]:
        """Return x0, y0, k of the equivalent linkages with positive lengths."""
        first, second = k[..., 0] < 0.0, k[..., 1] < 0.0
        k3 = np.where(first != second, -k[..., 2], k[..., 2])
        return _opposite(x0, first), _opposite(y0, second), np.stack([np.abs(k[..., 0]), np.abs(k[..., 1]), k3], axis=-1)

    def sizes(self, k: Array) -> tuple[Array, Array, Array]:
        """Return crank, coupler and rocker of linkages with positive lengths."""
        crank, rocker = 1.0 / k[..., 0], 1.0 / k[..., 1]
        return crank, np.asarray(root(crank * crank + rocker * rocker + 1.0 - 2.0 * crank * rocker * k[..., 2])), rocker

    def fits(self, sizes: tuple[Array, Array, Array]) -> Array:
        """Return whether the dimensions satisfy the limits of the ratios."""
        least, most = self.low * (1.0 - EXACT), self.high * (1.0 + EXACT)
        return np.asarray(np.all([(size >= least) & (size <= most) for size in sizes], axis=0))

    def margin(self, sizes: tuple[Array, Array, Array], low: Array, high: Array) -> Array:
        """Return the least squared sine of the transmission angle over low ... high.

        It is not positive if a dead position is reached.
        """
        crank, coupler, rocker = sizes
        spread = [
            (coupler**2 + rocker**2 - crank**2 - 1.0 + 2.0 * crank * cosine) / (2.0 * coupler * rocker)
            for cosine in _cosine_range(low, high)
        ]
        return 1.0 - np.maximum(spread[0] ** 2, spread[1] ** 2)


def linear_form(chain: LoopEquation, x: Array, y: Array) -> tuple[Array, Array]:
    """Return F in the form A @ k - w: A (n, 3) and w (n,)."""
    u, v, w = chain.terms(x, y)
    return np.stack([u, v, np.ones_like(w)], axis=-1), w


# Fit a linkage at every start position of a function by weighted least squares on the loop equation, vectorised.

Keep = Callable[[Array, Array, Array, Array, Array, Array], Any]
"""Admissible linkages, elementwise: (crank, coupler, rocker, phi0, psi0, side), all (m,), to (m,) bool."""


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
    k = _weighted(task, u, v, w, np.ones_like(w))  # then weighted by the slopes; a third fit has no measurable effect
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


# Minimise the output error at a fixed start position by convex programmes, with a lower bound that proves optimality.
#
# With the start position fixed, the linkages that follow the target outputs y_i on the assembly mode `side` with no error above
# t are those with
#
#     side * F(x_i, y_i - t) >= 0 >= side * F(x_i, y_i + t)    for all i,
#
# linear in the constants of F (`optlink.synthesis.freudenstein`) for every t: the minimax output error is the solution of a
# quasi-convex programme. A few linear programmes solve it and the multipliers of the last one prove it. (The proof excludes
# linkages so near a dead position that their other assembly mode lies within the same error.)
#
# References
# ---------- E. W. Cheney and H. L. Loeb, Numerische Mathematik 3 (1961) 72-75: differential correction, as used in the search
# for t.

SHARES = 0.5 ** np.arange(6.0)  # trial fractions of a step: the error is quasi-convex, so a fraction of a descent step descends


@dataclass(frozen=True)
class ConvexStep:
    """Step y (3,) and multipliers of the rows and of the limits, as returned by the solver."""

    step: Array
    rows: Array
    limits: Array
    status: str


class ConvexFit:
    """Convex programme: minimise max(M y + m) or |M y + m|^2 subject to L y <= h, compiled once for all M, m, L, h."""

    def __init__(self, rows: int, limits: int, largest: bool) -> None:
        import cvxpy

        self.cvxpy: Any = cvxpy
        self.matrix, self.vector = self.cvxpy.Parameter((rows, 3)), self.cvxpy.Parameter(rows)
        self.limit_matrix, self.limit_vector = self.cvxpy.Parameter((limits, 3)), self.cvxpy.Parameter(limits)
        self.y = self.cvxpy.Variable(3)
        residual = self.matrix @ self.y + self.vector
        self.constraints = [self.limit_matrix @ self.y <= self.limit_vector]
        goal = self.cvxpy.sum_squares(residual)
        if largest:
            goal = self.cvxpy.Variable()
            self.constraints.append(residual <= goal)
        self.problem = self.cvxpy.Problem(self.cvxpy.Minimize(goal), self.constraints)

    def __call__(self, matrix: Array, vector: Array, limit_matrix: Array, limit_vector: Array) -> ConvexStep | None:
        """Solve the programme of (M, m, L, h); None on failure. The caller must verify the optimality of the answer."""
        self.matrix.value, self.vector.value = matrix, vector
        self.limit_matrix.value, self.limit_vector.value = limit_matrix, limit_vector
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the caller detects inaccurate answers
            try:
                self.problem.solve(solver=self.cvxpy.CLARABEL)
            except self.cvxpy.error.SolverError:
                return None
        values = [self.y.value, *(one.dual_value for one in self.constraints)]
        if any(value is None or not np.all(np.isfinite(value)) for value in values):
            return None
        duals = [np.asarray(value, dtype=float) for value in values[1:]]
        rows = duals[1] if len(duals) > 1 else np.zeros(0)
        return ConvexStep(np.asarray(self.y.value, dtype=float), rows, duals[0], str(self.problem.status))


class Refinement:
    """Refine linkages at their start positions; the convex programme is compiled on first use."""

    def __init__(self, task: FitProblem) -> None:
        self.task = task

    def __call__(self, cell: Cells) -> tuple[Cells, float, str]:
        """Return the linkage of least error, a lower bound of that error (see `FirstStep`) and the solver status."""
        return (self._smallest_largest if self.task.largest else self._least_squares)(self._least(cell))

    @cached_property
    def programme(self) -> ConvexFit:
        """Convex programme of every step."""
        task = self.task
        return ConvexFit(task.x.size * (1 + task.largest), task.chain.limits[1].size, task.largest)

    def _moved(self, cell: Cells, change: Array) -> Cells:
        """Apply the largest improving fraction of a change (3,) of the constants; return the same cell if none improves it."""
        task = self.task
        same = np.ones(len(SHARES))
        others = fit_error(task, cell.x0 * same, cell.y0 * same, cell.k + SHARES[:, None] * change)
        better = np.flatnonzero((others.error < cell.error) & (others.x0 == cell.x0) & (others.y0 == cell.y0))
        return others[better[0]] if better.size else cell

    def _least(self, cell: Cells) -> Cells:
        """Repeat the weighted fit by orthogonal factorisation, for full precision of the constants."""
        task = self.task
        x, y = cell.x0 + task.x, cell.y0 + task.y
        a, w = linear_form(task.chain, x, y)
        weight = 1.0 / np.abs(task.chain.slope(x, y, cell.k))
        change = np.linalg.lstsq(a * weight[:, None], (w - a @ cell.k) * weight, rcond=None)[0]
        return self._moved(cell, np.asarray(change, dtype=float))

    def _smallest_largest(self, cell: Cells) -> tuple[Cells, float, str]:
        """Minimise the largest output error; return the linkage, a proven lower bound of the error and the solver status.

        Each linear programme minimises the excess over the band of (1 - PROVEN_GAP) times the current error, with each position
        scaled by its own slope. It either finds a linkage within the band, which becomes the next iterate, or its multipliers
        prove that there is none.
        """
        task = self.task
        chain, x, y = task.chain, cell.x0 + task.x, cell.y0 + task.y
        rows, bounds = chain.limits
        status = "closed form"
        for _ in range(STEPS):
            if cell.error <= EXACT:
                break
            target = (1.0 - PROVEN_GAP) * float(cell.error)
            weight = cell.side / np.abs(chain.slope(x, y, cell.k))
            below, above = linear_form(chain, x, y - target), linear_form(chain, x, y + target)
            matrix = np.concatenate([-weight[:, None] * below[0], weight[:, None] * above[0]])
            vector = matrix @ cell.k + np.concatenate([weight * below[1], -weight * above[1]])
            straight = np.linalg.inv(np.linalg.qr(matrix, mode="r")) * target  # constants change by straight @ step
            room = bounds - rows @ cell.k
            answer = self.programme(matrix @ straight / target, vector / target, rows @ straight, room)
            if answer is None:
                return cell, 0.0, "no answer"
            status = answer.status
            box = (chain.box[0] - cell.k, chain.box[1] - cell.k)
            if lower_bound(matrix, vector, rows, room, box, answer.rows, answer.limits * target) > 0.0:
                return cell, target, status
            better = self._moved(cell, straight @ answer.step)
            if better is cell:
                break
            cell = better
        return cell, 0.0, status

    def _least_squares(self, cell: Cells) -> tuple[Cells, float, str]:
        """Minimise the rms output error; return the linkage, a bound for its linearised model and the solver status.

        Gauss-Newton; each step is a convex quadratic programme, in closed form where no ratio limit is active.
        """
        task = self.task
        chain, x, y = task.chain, cell.x0 + task.x, cell.y0 + task.y
        rows, bounds = chain.limits
        status, bound = "closed form", 0.0
        for _ in range(STEPS):
            if cell.error <= EXACT:
                bound = 0.0
                break
            actual = chain.follow(x, cell.k, cell.side)
            error = chain.difference(actual, y)
            factor, r = np.linalg.qr(-linear_form(chain, x, actual)[0] / chain.slope(x, actual, cell.k)[:, None])
            size = float(np.linalg.norm(error))
            straight = np.linalg.inv(r) * size
            limit_matrix, room = rows @ straight, bounds - rows @ cell.k
            inner = factor.T @ error / size
            step, multipliers, status = -inner, np.zeros(room.size), "closed form"
            if np.any(limit_matrix @ step > room):
                answer = self.programme(factor, error / size, limit_matrix, room)
                if answer is None:
                    return cell, 0.0, "no answer"
                step, multipliers, status = answer.step, np.maximum(answer.limits, 0.0), answer.status
            free = -inner - 0.5 * limit_matrix.T @ multipliers  # least point of the Lagrangian: weak duality
            square = 1.0 - inner @ inner + np.sum((free + inner) ** 2) + multipliers @ (limit_matrix @ free - room)
            bound = math.sqrt(max(0.0, float(square))) * float(cell.error)
            better = self._moved(cell, straight @ step)
            if better is cell or bound >= (1.0 - PROVEN_GAP) * cell.error:
                break
            cell, bound = better, 0.0  # the bound belonged to the model about the previous linkage
        return cell, bound, status


def lower_bound(matrix: Array, vector: Array, rows: Array, room: Array, box: tuple[Array, Array], *multipliers: Array) -> float:
    """Return a lower bound of max(matrix @ d + vector) subject to rows @ d <= room and box[0] <= d <= box[1], by weak duality.

    Any non-negative multipliers of the m rows and the r limits give a bound; those of the solver are first shifted, in proportion
    to themselves, to satisfy stationarity.
    """
    both = np.concatenate([matrix, rows])
    p = np.maximum(np.concatenate(multipliers), 0.0)
    for _ in range(3):
        weighed = both * p[:, None]
        p = np.maximum(p - weighed @ np.linalg.lstsq(both.T @ weighed, both.T @ p, rcond=None)[0], 0.0)
    total = float(np.sum(p[: vector.size]))
    if not total > 0.0:
        return -math.inf
    p /= total
    pull = both.T @ p
    return float(p @ np.concatenate([vector, -room]) + np.sum(np.minimum(pull * box[0], pull * box[1])))


@dataclass(frozen=True)
class FirstStep:
    """A four-bar with lengths relative to the frame and start angles [rad].

    `side`: assembly mode. `residual`: of the loop equation at the target positions. `error`: of the output [rad], in closed
    form. Both are the largest value, or (for both other measures) the root mean square. `bound`: lower bound of the error for
    this start position, assembly mode and range of ratios [rad]: for "max" of the output error itself, otherwise of its
    linearised model about this linkage. Recomputed from the multipliers; zero without a proof, for example where `keep` or the
    coupler ratio, which are not convex, restrict the linkage. `proven`: whether `error` is within a share `PROVEN_GAP` of
    `bound`, or zero. `status`: solver status; "closed form" where no solver was needed, "no answer" where it failed.
    """

    side: int
    residual: float
    error: float
    bound: float
    proven: bool
    status: str
    crank: float
    coupler: float
    rocker: float
    phi0: float
    psi0: float

    @property
    def gap(self) -> float:
        """Difference of `error` and its lower bound [rad]."""
        return self.error - self.bound


def first_steps(task: FitProblem, phi0: ArrayLike, psi0: ArrayLike, count: int = 5) -> list[FirstStep]:
    """Return at most `count` four-bars that fit a task as closely as possible, by increasing error: starting points of an NLP.

    Several start angles phi0 (p,) and psi0 (q,) [rad] form a grid, which is refined around its best points. The starts of the
    four-bars are at least `START_SEPARATION` grid steps apart, or they differ in assembly mode. There is none if no start gives a
    four-bar that keeps its assembly mode over the whole range.
    """
    grids = np.unique(phi0), np.unique(psi0)
    cells = scan(task, *grids)
    steps = max(step_of(grids[0]), EXACT), max(step_of(grids[1]), EXACT)
    apart = START_SEPARATION * steps[0], START_SEPARATION * steps[1]
    cells = zoom(task, cells[distinct_cells(task, cells, apart, SPARE * count)], grids)
    cells = cells[distinct_cells(task, cells, steps, count)]
    refine, designs = Refinement(task), []
    for i in range(len(cells.error)):
        cell, bound, status = refine(cells[i])
        a, w = linear_form(task.chain, cell.x0 + task.x, cell.y0 + task.y)
        error = float(cell.error)
        proven = bound >= (1.0 - 2.0 * PROVEN_GAP) * error or error <= EXACT
        step = _step(task, cell, float(task.figure(a @ cell.k - w)), bound, proven, status)
        designs.append((max(error, EXACT), -float(cell.margin), step))
    return [step for *_, step in sorted(designs, key=lambda one: one[:2])]


def _step(task: FitProblem, cell: Cells, residual: float, bound: float, proven: bool, status: str) -> FirstStep:
    """Return one cell with what is known of its error; see `FirstStep`."""
    sizes = [float(size) for size in task.chain.sizes(cell.k)]
    start = [float(cell.x0), float(cell.y0)]
    if task.shift:  # to (-pi, pi]
        start = [math.pi - (math.pi - angle) % TURN for angle in start]
    return FirstStep(int(cell.side), residual, float(cell.error), bound, proven, status, *sizes, *start)


# Starting points of function synthesis: Freudenstein fits and convex first designs (`optlink.synthesis.freudenstein`).


def fittable(problem: DesignProblem) -> bool:
    """Return whether a function has convex first designs: free lengths, a range of ratios, and three positions at least."""
    loop, law = problem.four_bar, problem.requirement.law
    if loop is None or problem.links or not isinstance(law, Function) or not set(loop.names) <= set(problem.free):
        return False
    low, high = _ratios(problem)
    return low < high and len(problem.law.offsets) > 2


def _ratios(problem: DesignProblem) -> tuple[float, float]:
    """Return the limits of crank, coupler and rocker over the frame."""
    ratio = problem.limits.link_ratio
    return UNLIMITED if ratio is None else (ratio.low or UNLIMITED[0], ratio.high or UNLIMITED[1])


def steps(problem: DesignProblem) -> list[FirstStep]:
    """Return the best first designs with the assembly mode of the problem, by increasing error."""
    free, ranges = _ranges(problem)
    phi0, psi0 = (_grid(low, high, free) for low, high in ranges)
    return first_steps(_fit_problem(problem, free), phi0, psi0)


def fits(problem: DesignProblem, seed: int) -> Iterator[dict[str, float]]:
    """Yield fitted linkages at random start angles (scrambled Sobol points) as quantities of the problem.

    Only linkages that keep the assembly mode of the problem are yielded; at most `BLOCK` times `BLOCKS` points are tried.
    """
    from scipy.stats import qmc

    free, ranges = _ranges(problem)
    if all(low == high for low, high in ranges):
        return
    task, points = _fit_problem(problem, free), qmc.Sobol(2, rng=np.random.default_rng(seed))
    low = np.array([start[0] for start in ranges])
    size = np.array([math.pi if free else start[1] - start[0] for start in ranges])
    for _ in range(BLOCKS):
        cells = fit(task, *(low + size * points.random(ANGLES_PER_BLOCK)).T)
        for i in np.flatnonzero(np.isfinite(cells.error)):
            yield values(problem, _step(task, cells[i], math.nan, 0.0, False, "fit"))


def _fit_problem(problem: DesignProblem, free: bool) -> FitProblem:
    """Return the fit of a function; `free`: of start angles that are free over at least half a turn."""
    law, offsets = problem.requirement.law, problem.law.offsets
    assert isinstance(law, Function)
    rise = np.asarray(law.rise(offsets), dtype=float)
    return FitProblem(LoopEquation(_ratios(problem)), offsets, rise, problem.measure == "max", free, _keep(problem, offsets))


def _ranges(problem: DesignProblem) -> tuple[bool, list[tuple[float, float]]]:
    """Return whether both start angles are free over at least half a turn, and their bounds [rad]."""
    starts = [problem.quantities[name] for name in (problem.start_name, problem.base_name)]
    turned = problem.frame_angle or 0.0
    ranges = [(start.bounds[0] - turned, start.bounds[1] - turned) for start in starts]
    return all(start.free and start.bounds[1] - start.bounds[0] >= math.pi for start in starts), ranges


def values(problem: DesignProblem, step: FirstStep) -> dict[str, float]:
    """Return a first design as quantities [m, rad] of the problem."""
    loop, turned, quantities = problem.four_bar, problem.frame_angle or 0.0, problem.quantities
    assert loop is not None
    pivots = {name: quantities[name].value for name in loop.ground}
    frame = loop.frame(pivots)[0]
    lengths = dict(zip(loop.names, (step.crank * frame, step.coupler * frame, step.rocker * frame), strict=True))
    starts = (problem.start_name, step.phi0), (problem.base_name, step.psi0)
    return {**lengths, **pivots, **{name: _into(quantities[name], angle + turned) for name, angle in starts}}


def _grid(low: float, high: float, whole: bool) -> Array:
    if low == high:
        return np.array([low])
    if whole:
        return np.linspace(0.0, math.pi, GRID, endpoint=False) + low
    return np.linspace(low, high, GRID)


def _into(start: Quantity, angle: float) -> float:
    """Shift an angle by whole revolutions into the bounds of its quantity if possible, as near to zero as possible."""
    low, high = start.bounds
    turned = [angle + TURN * k for k in range(-2, 3)]
    return min(turned, key=lambda a: (not low <= a <= high, abs(a)))


def _keep(problem: DesignProblem, offsets: Array) -> Keep:
    """Return a filter for linkages with the assembly mode of the problem that nearly satisfy its transmission-angle limits."""
    assert problem.four_bar is not None
    interval, mode = problem.limits.transmission_at(problem.four_bar.joint), problem.four_bar.side
    low = 0.0 if interval is None or interval.low is None else interval.low - WIDER
    high = math.pi if interval is None or interval.high is None else interval.high + WIDER

    def keep(crank: Array, coupler: Array, rocker: Array, phi0: Array, psi0: Array, side: Array) -> NDArray[np.bool_]:
        cos_phi = unit(phi0[:, None] + offsets)[0]
        cosine = transmission_cosine(crank[:, None], coupler[:, None], rocker[:, None], 1.0, cos_phi)
        inside = np.all((cosine <= math.cos(max(low, 0.0))) & (cosine >= math.cos(min(high, math.pi))), axis=1)
        return np.asarray(inside & (side == mode))

    return keep
