"""First steps of function generation: loop equations that are linear in three constants, fitted to every given start position.

Four-bar (conventions of `optlink.linkage.fourbar`, frame = 1) and slider-crank (crank pivot A at the origin, pin C of the slider
at (s, e): guide along +x, offset e to the left of A):

    F = K1 cos psi - K2 cos phi + K3 - cos(phi - psi)    K1 = 1/a, K2 = 1/c, K3 = (a^2 - b^2 + c^2 + 1) / (2 a c)
    F = K1 s cos phi + K2 sin phi + K3 - s^2             K1 = 2 a, K2 = 2 a e, K3 = b^2 - a^2 - e^2

F = 0 says that B-C is as long as the coupler. On the assembly mode `side` (+1: C left of B -> D, or forward of B), side * F falls
through zero as the output rises. With phi0 and psi0 (or s0) given, the linkages that follow the wanted outputs y_i on that mode
with no error above t are therefore those with

    side * F(x_i, y_i - t) >= 0 >= side * F(x_i, y_i + t)    for all i,

linear in K for every t: the smallest largest output error is the solution of a quasi-convex programme. A few linear programmes
find it and the multipliers of the last one prove it. (Left out of that proof: linkages which come so near a dead position that
their other mode lies within the same error.)

Source: F. Freudenstein, Approximate synthesis of four-bar linkages, Trans. ASME 77 (1955) 853-861; the search for t as in the
differential correction of E. W. Cheney and H. L. Loeb, Numerische Mathematik 3 (1961) 72-75.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from optlink.linkage.elementwise import root

Array = NDArray[np.float64]
Keep = Callable[[Array, Array, Array, Array, Array, Array], Any]
"""Which linkages are wanted, elementwise: (crank, coupler, rocker, phi0, psi0, side), or (crank, coupler, offset, phi0, s0,
side), all (m,), to (m,) bool."""

MEASURES = ("sum of squares", "rms", "max")
UNLIMITED = (1e-3, 1e3)  # a link a thousand times as long as the frame is no link
BLOCK = 1 << 17  # numbers in one array of the scan: they should stay in the cache
FITS = 2  # weighted fits per start position; a third changes nothing that could be measured
FLATTEST = 0.05  # of the largest slope: a position near a dead one must not outweigh all others
SINGULAR = 1e-12  # squared sine between the columns of a fit below which its constants are not determined
EXACT = 1e-9  # output error, in radians or strokes, that is none
CLOSE = 1e-4  # share of the output error up to which the largest one is proven to be the smallest
STEPS = 12  # convex programmes per start position
APART = 3.0  # grid steps between two start positions that count as different
ZOOMS = 6  # finer and finer grids around a start position, each of half the width
SPARE = 2  # so many times `count` start positions are zoomed in on, as some meet
ANYWHERE = (-math.inf, math.inf)
SHARES = 0.5 ** np.arange(6.0)  # of a step that are tried: the error is quasi-convex, so a part of a good step is good
FINE = np.array([-1.0, -0.5, 0.0, 0.5, 1.0])


@dataclass(frozen=True)
class Step:
    """What every first step has.

    `side`: assembly mode. `residual`: of the loop equation at the wanted positions [-, or square of the unit of s]. `error`: of
    the output [rad, or unit of s], by the closed form. Both are the largest, or (for both other measures) the root mean square.
    `bound`: what no linkage of this start position, mode and range of ratios can undercut, in the unit of `error`: for "max" the
    output error itself; else that of its linearised model about this linkage. Recomputed from the multipliers; zero where nothing
    is proven, as where `keep` or the coupler's ratio, which are not convex, hold the linkage back.
    `proven`: whether `error` is within a share `CLOSE` of `bound`, or no error at all.
    `status`: what the solver said; "closed form" where none was needed, "no answer" where it broke down.
    """

    side: int
    residual: float
    error: float
    bound: float
    proven: bool
    status: str

    @property
    def gap(self) -> float:
        """How far below `error` the convex programme's optimum could still lie, in its unit."""
        return self.error - self.bound


@dataclass(frozen=True)
class FirstStep(Step):
    """A four-bar, its lengths over the frame, and where it starts [rad]."""

    crank: float
    coupler: float
    rocker: float
    phi0: float
    psi0: float


@dataclass(frozen=True)
class FirstStepSlider(Step):
    """An offset slider-crank, its lengths in the unit of s; phi0 [rad] from the guide's direction, s0 from the crank pivot."""

    crank: float
    coupler: float
    offset: float
    phi0: float
    s0: float


# --- the two loop equations ----------------------------------------------------------------------------------------


def _cosine_range(low: Array, high: Array) -> tuple[Array, Array]:
    """Least and largest cosine over low ... high [rad]."""
    turn = 2.0 * np.pi
    ends = np.cos(low), np.cos(high)
    top = np.where(np.ceil(low / turn) * turn <= high, 1.0, np.maximum(*ends))
    bottom = np.where(np.ceil((low - np.pi) / turn) * turn + np.pi <= high, -1.0, np.minimum(*ends))
    return bottom, top


def _parts(k: Array) -> tuple[Array, Array, Array]:
    """K1, K2, K3 of constants (..., 3), ready to meet positions (..., n)."""
    return k[..., 0, None], k[..., 1, None], k[..., 2, None]


class _Chain(Protocol):
    """F = K1 u + K2 v + K3 - w for input x and output y, both (..., n); constants k (..., 3)."""

    limits: tuple[Array, Array]  # rows (r, 3) and bounds (r,): rows @ k <= bounds, exactly
    corners: Array  # (4, 2) of the region of K1, K2 which they leave, in turn
    box: tuple[Array, Array]  # least and largest k (3,) of any linkage that meets them

    def terms(self, x: Array, y: Array) -> tuple[Array, Array, Array]:
        """u, v, w."""
        ...

    def slope(self, x: Array, y: Array, k: Array) -> Array:
        """dF/dy."""
        ...

    def follow(self, x: Array, k: Array, side: Array) -> Array:
        """Output y of the linkage; NaN where it cannot be assembled."""
        ...

    def difference(self, y: Array, wanted: Array) -> Array:
        """Output error."""
        ...

    def upright(self, x0: Array, y0: Array, k: Array) -> tuple[Array, Array, Array]:
        """The same linkages with positive lengths: x0, y0, k."""
        ...

    def sizes(self, k: Array) -> tuple[Array, Array, Array]:
        """Crank, coupler and the third size, of positive lengths."""
        ...

    def fits(self, sizes: tuple[Array, Array, Array]) -> Array:
        """Whether the ratios are met."""
        ...

    def margin(self, sizes: tuple[Array, Array, Array], low: Array, high: Array) -> Array:
        """Least squared sine of the transmission angle over inputs low ... high; not positive where a dead position is met."""
        ...


def _opposite(angle: Array, where: NDArray[np.bool_]) -> Array:
    """Angles turned by half a turn, towards zero, where wanted."""
    return np.where(where, angle - np.copysign(np.pi, angle), angle)


class _FourBar:
    def __init__(self, ratios: tuple[float, float]) -> None:
        self.low, self.high = ratios
        least, largest = 1.0 / self.high, 1.0 / self.low
        self.limits = (np.vstack([np.eye(3)[:2], -np.eye(3)[:2]]), np.array([largest, largest, -least, -least]))
        self.corners = np.array([[least, least], [largest, least], [largest, largest], [least, largest]])
        reach = 1.0 + 2.0 * largest  # of |K3|: F = 0 at some position
        self.box = (np.array([least, least, -reach]), np.array([largest, largest, reach]))

    def terms(self, x: Array, y: Array) -> tuple[Array, Array, Array]:
        return np.cos(y), -np.cos(x), np.cos(x - y)

    def slope(self, x: Array, y: Array, k: Array) -> Array:
        return -_parts(k)[0] * np.sin(y) - np.sin(x - y)

    def follow(self, x: Array, k: Array, side: Array) -> Array:
        k1, k2, k3 = _parts(k)
        c, s = np.cos(x), np.sin(x)
        with np.errstate(invalid="ignore", divide="ignore"):
            inner = np.arccos((k2 * c - k3) / np.hypot(k1 - c, s))
        return np.asarray(np.arctan2(-s, k1 - c) + side[..., None] * inner)

    def difference(self, y: Array, wanted: Array) -> Array:
        return np.asarray(np.remainder(y - wanted + np.pi, 2.0 * np.pi) - np.pi)

    def upright(self, x0: Array, y0: Array, k: Array) -> tuple[Array, Array, Array]:
        first, second = k[..., 0] < 0.0, k[..., 1] < 0.0
        k3 = np.where(first != second, -k[..., 2], k[..., 2])
        return _opposite(x0, first), _opposite(y0, second), np.stack([np.abs(k[..., 0]), np.abs(k[..., 1]), k3], axis=-1)

    def sizes(self, k: Array) -> tuple[Array, Array, Array]:
        crank, rocker = 1.0 / k[..., 0], 1.0 / k[..., 1]
        return crank, np.asarray(root(crank * crank + rocker * rocker + 1.0 - 2.0 * crank * rocker * k[..., 2])), rocker

    def fits(self, sizes: tuple[Array, Array, Array]) -> Array:
        least, most = self.low * (1.0 - EXACT), self.high * (1.0 + EXACT)
        return np.asarray(np.all([(size >= least) & (size <= most) for size in sizes], axis=0))

    def margin(self, sizes: tuple[Array, Array, Array], low: Array, high: Array) -> Array:
        crank, coupler, rocker = sizes
        spread = [
            (coupler**2 + rocker**2 - crank**2 - 1.0 + 2.0 * crank * cosine) / (2.0 * coupler * rocker)
            for cosine in _cosine_range(low, high)
        ]
        return np.asarray(1.0 - np.maximum(spread[0] ** 2, spread[1] ** 2))


class _SliderCrank:
    def __init__(self, ratios: tuple[float, float], stroke: float) -> None:
        self.low, self.high = ratios[0] * stroke, ratios[1] * stroke
        near, far, e = 2.0 * self.low, 2.0 * self.high, self.high  # of K1, and of the offset: |K2| <= e K1
        rows = [[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [-e, 1.0, 0.0], [-e, -1.0, 0.0]]
        self.limits = (np.array(rows), np.array([far, -near, 0.0, 0.0]))
        self.corners = np.array([[near, -e * near], [far, -e * far], [far, e * far], [near, e * near]])
        self.box = (np.array([near, -e * far, -e * far]), np.array([far, e * far, e * far]))

    def terms(self, x: Array, y: Array) -> tuple[Array, Array, Array]:
        return y * np.cos(x), np.sin(x) + 0.0 * y, y * y + 0.0 * x

    def slope(self, x: Array, y: Array, k: Array) -> Array:
        return np.asarray(_parts(k)[0] * np.cos(x) - 2.0 * y)

    def follow(self, x: Array, k: Array, side: Array) -> Array:
        k1, k2, k3 = _parts(k)
        foot = 0.5 * k1 * np.cos(x)
        return np.asarray(foot + side[..., None] * root(foot * foot + k2 * np.sin(x) + k3))

    def difference(self, y: Array, wanted: Array) -> Array:
        return y - wanted

    def upright(self, x0: Array, y0: Array, k: Array) -> tuple[Array, Array, Array]:
        back = k[..., 0] < 0.0
        return _opposite(x0, back), y0, np.where(back[..., None], k * np.array([-1.0, -1.0, 1.0]), k)

    def sizes(self, k: Array) -> tuple[Array, Array, Array]:
        crank, offset = 0.5 * k[..., 0], k[..., 1] / k[..., 0]
        return crank, np.asarray(root(k[..., 2] + crank * crank + offset * offset)), offset

    def fits(self, sizes: tuple[Array, Array, Array]) -> Array:
        most = self.high * (1.0 + EXACT)
        links = [(size >= self.low * (1.0 - EXACT)) & (size <= most) for size in sizes[:2]]
        return np.asarray(np.all([*links, np.abs(sizes[2]) <= most], axis=0))

    def margin(self, sizes: tuple[Array, Array, Array], low: Array, high: Array) -> Array:
        crank, coupler, offset = sizes
        spread = [(crank * sine - offset) / coupler for sine in _cosine_range(low - 0.5 * np.pi, high - 0.5 * np.pi)]
        return np.asarray(1.0 - np.maximum(spread[0] ** 2, spread[1] ** 2))


# --- all start positions at once -----------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Task:
    """What is wanted: rotations `x` and outputs `y` (n,) from the start, and how the error is measured."""

    chain: _Chain
    x: Array
    y: Array
    largest: bool
    unit: float  # of the output: 1 rad, or the stroke
    shift: bool
    keep: Keep | None
    range_x: tuple[float, float]  # of the start positions
    range_y: tuple[float, float]

    @cached_property
    def programme(self) -> _Programme:
        """The convex programme of every step, compiled when it is first needed."""
        return _Programme(self.x.size * (1 + self.largest), self.chain.limits[1].size, self.largest)

    def figure(self, errors: Array) -> Array:
        """Largest, or root mean square, over the last axis."""
        return np.asarray(np.max(np.abs(errors), axis=-1) if self.largest else np.sqrt(np.mean(errors * errors, axis=-1)))


@dataclass(frozen=True)
class _Cells:
    """Fitted linkages, one per start position (m,), positive lengths; `error` infinite where they will not do."""

    x0: Array
    y0: Array
    k: Array
    side: Array
    error: Array
    margin: Array

    def __getitem__(self, index: Any) -> _Cells:
        return _Cells(*(getattr(self, name)[index] for name in ("x0", "y0", "k", "side", "error", "margin")))


def _together(cells: list[_Cells]) -> _Cells:
    names = ("x0", "y0", "k", "side", "error", "margin")
    return _Cells(*(np.concatenate([getattr(cell, name) for cell in cells]) for name in names))


def _weighted(task: _Task, u: Array, v: Array, w: Array, q: Array) -> Array:
    """Constants (m, 3) within the limits of the least sum of q (K1 u + K2 v + K3 - w)^2; NaN where they are not determined."""
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
    """Least point (m, 2) of k' N k - 2 k' r on the edges of polygons: N (m, 2, 2), r (m, 2), corners (m, e, 2) in turn."""
    along = np.roll(corners, -1, axis=1) - corners
    steep = np.einsum("mei,mij,mej->me", along, normal, along)
    fall = np.einsum("mei,mei->me", along, right[:, None] - np.einsum("mij,mej->mei", normal, corners))
    points = corners + np.clip(fall / steep, 0.0, 1.0)[..., None] * along
    value = np.einsum("mei,mij,mej->me", points, normal, points) - 2.0 * np.einsum("mei,mi->me", points, right)
    return np.asarray(points[np.arange(len(points)), np.argmin(value, axis=-1)])


def _fit(task: _Task, x0: Array, y0: Array) -> _Cells:
    """Fit a linkage to every start position (m,): weighted least squares, the weights those of the output error."""
    chain = task.chain
    x, y = x0[:, None] + task.x, y0[:, None] + task.y
    u, v, w = chain.terms(x, y)
    k = _weighted(task, u, v, w, np.ones_like(w))
    for _ in range(1, FITS):
        slope = np.abs(chain.slope(x, y, k))
        floor = FLATTEST * np.max(slope, axis=-1, keepdims=True)
        q = np.maximum(np.maximum(slope, floor), 1e-100) ** -2.0
        k = _weighted(task, u, v, w, q / np.max(q, axis=-1, keepdims=True))
    return _judge(task, x0, y0, k)


def _judge(task: _Task, x0: Array, y0: Array, k: Array) -> _Cells:
    """Mode, output error and margin of linkages (m,); an infinite error where one does not meet what is asked."""
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
    return _Cells(x0, y0, k, side, np.where(good, error, np.inf), margin)


def _scan(task: _Task, x0: Array, y0: Array) -> _Cells:
    """Every pair of start positions of x0 (p,) and y0 (q,) that gives a linkage."""
    first, second = (a.ravel() for a in np.meshgrid(x0, y0, indexing="ij"))
    blocks = min(first.size, math.ceil(first.size * task.x.size / BLOCK))
    found = []
    for one, other in zip(np.array_split(first, blocks), np.array_split(second, blocks), strict=True):
        cells = _fit(task, one, other)
        found.append(cells[np.isfinite(cells.error)])
    return _together(found)


def _step_of(grid: Array) -> float:
    """Largest distance of neighbours; zero where there is one value."""
    return float(np.max(np.diff(np.sort(grid)), initial=0.0))


def _apart(task: _Task, cells: _Cells, room: tuple[float, float], count: int) -> list[int]:
    """The best whose start positions lie further apart than `room`, or whose modes differ; `count` of them at most.

    Least error first; among exact ones the best transmission first.
    """
    chosen: list[int] = []
    for i in np.lexsort((-cells.margin, np.maximum(cells.error, EXACT * task.unit))):
        if len(chosen) == count:
            break
        others = cells[chosen]
        dx = np.abs(np.remainder(others.x0 - cells.x0[i] + np.pi, 2.0 * np.pi) - np.pi)
        dy = np.abs(task.chain.difference(others.y0, cells.y0[i]))
        near = (dx <= room[0]) & (dy <= room[1]) & (others.side == cells.side[i])
        if not np.any(near):
            chosen.append(int(i))
    return chosen


# --- one start position, by convex programmes ----------------------------------------------------------------------


@dataclass(frozen=True)
class _Answer:
    """Step y (3,) and multipliers of the rows and of the limits, as the solver gave them."""

    step: Array
    rows: Array
    limits: Array
    status: str


class _Programme:
    """minimise max(M y + m) or |M y + m|^2 subject to L y <= h, compiled once for all M, m, L, h."""

    def __init__(self, rows: int, limits: int, largest: bool) -> None:
        import cvxpy

        self.cvxpy: Any = cvxpy
        self.matrix, self.vector = self.cvxpy.Parameter((rows, 3)), self.cvxpy.Parameter(rows)
        self.limit_matrix, self.limit_vector = self.cvxpy.Parameter((limits, 3)), self.cvxpy.Parameter(limits)
        self.y = self.cvxpy.Variable(3)
        residual = self.matrix @ self.y + self.vector
        self.held = [self.limit_matrix @ self.y <= self.limit_vector]
        goal = self.cvxpy.sum_squares(residual)
        if largest:
            goal = self.cvxpy.Variable()
            self.held.append(residual <= goal)
        self.problem = self.cvxpy.Problem(self.cvxpy.Minimize(goal), self.held)

    def __call__(self, matrix: Array, vector: Array, limit_matrix: Array, limit_vector: Array) -> _Answer | None:
        """Solve; None where the solver has no answer. What it claims of its answer is for the caller to check."""
        self.matrix.value, self.vector.value = matrix, vector
        self.limit_matrix.value, self.limit_vector.value = limit_matrix, limit_vector
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # an inaccurate answer is found out by its own numbers
            try:
                self.problem.solve(solver=self.cvxpy.CLARABEL)
            except self.cvxpy.error.SolverError:
                return None
        values = [self.y.value, *(one.dual_value for one in self.held)]
        if any(value is None or not np.all(np.isfinite(value)) for value in values):
            return None
        duals = [np.asarray(value, dtype=float) for value in values[1:]]
        rows = duals[1] if len(duals) > 1 else np.zeros(0)
        return _Answer(np.asarray(self.y.value, dtype=float), rows, duals[0], str(self.problem.status))


def _linear(chain: _Chain, x: Array, y: Array) -> tuple[Array, Array]:
    """F as A @ k - w: A (n, 3), w (n,)."""
    u, v, w = chain.terms(x, y)
    return np.stack([u, v, np.ones_like(w)], axis=-1), w


def _moved(task: _Task, cell: _Cells, change: Array) -> _Cells:
    """The cell after the largest of some shares of a change (3,) of its constants that betters it; itself where none does."""
    same = np.ones(len(SHARES))
    others = _judge(task, cell.x0 * same, cell.y0 * same, cell.k + SHARES[:, None] * change)
    better = np.flatnonzero((others.error < cell.error) & (others.x0 == cell.x0) & (others.y0 == cell.y0))
    return others[better[0]] if better.size else cell


def _least(task: _Task, cell: _Cells) -> _Cells:
    """The weighted fit again, by orthogonal factors: all digits of the constants."""
    x, y = cell.x0 + task.x, cell.y0 + task.y
    a, w = _linear(task.chain, x, y)
    weight = 1.0 / np.abs(task.chain.slope(x, y, cell.k))
    change = np.linalg.lstsq(a * weight[:, None], (w - a @ cell.k) * weight, rcond=None)[0]
    return _moved(task, cell, np.asarray(change, dtype=float))


def _smallest_largest(task: _Task, cell: _Cells) -> tuple[_Cells, float, str]:
    """The smallest largest output error: the linkage, a proven lower bound of the error, and the solver's status.

    Is there a linkage whose error is below (1 - CLOSE) times the one at hand? The linear programme (least excess over that band,
    each position in units of its own slope) either finds one, and the search goes on from its error, or its multipliers prove
    that there is none.
    """
    chain, x, y = task.chain, cell.x0 + task.x, cell.y0 + task.y
    rows, bounds = chain.limits
    status = "closed form"
    for _ in range(STEPS):
        if cell.error <= EXACT * task.unit:
            break
        aim = (1.0 - CLOSE) * float(cell.error)
        weight = cell.side / np.abs(chain.slope(x, y, cell.k))
        below, above = _linear(chain, x, y - aim), _linear(chain, x, y + aim)
        matrix = np.concatenate([-weight[:, None] * below[0], weight[:, None] * above[0]])
        vector = matrix @ cell.k + np.concatenate([weight * below[1], -weight * above[1]])
        straight = np.linalg.inv(np.linalg.qr(matrix, mode="r")) * aim  # constants change by straight @ step
        room = bounds - rows @ cell.k
        answer = task.programme(matrix @ straight / aim, vector / aim, rows @ straight, room)
        if answer is None:
            return cell, 0.0, "no answer"
        status = answer.status
        box = (chain.box[0] - cell.k, chain.box[1] - cell.k)
        if _proven(matrix, vector, rows, room, box, answer.rows, answer.limits * aim) > 0.0:
            return cell, aim, status
        better = _moved(task, cell, straight @ answer.step)
        if better is cell:
            break
        cell = better
    return cell, 0.0, status


def _proven(matrix: Array, vector: Array, rows: Array, room: Array, box: tuple[Array, Array], *multipliers: Array) -> float:
    """Lower bound of max(matrix @ d + vector) over rows @ d <= room, box[0] <= d <= box[1], by weak duality.

    Any multipliers that are not negative give one; the solver's are moved to where the constants balance, in proportion to
    themselves.
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


def _least_squares(task: _Task, cell: _Cells) -> tuple[_Cells, float, str]:
    """The least root mean square of the output error: the linkage, a lower bound for its linearised model, the solver's status.

    Gauss-Newton; each step is a convex quadratic programme, solved in closed form where no ratio limits it.
    """
    chain, x, y = task.chain, cell.x0 + task.x, cell.y0 + task.y
    rows, bounds = chain.limits
    status, bound = "closed form", 0.0
    for _ in range(STEPS):
        if cell.error <= EXACT * task.unit:
            bound = 0.0
            break
        actual = chain.follow(x, cell.k, cell.side)
        error = chain.difference(actual, y)
        factor, r = np.linalg.qr(-_linear(chain, x, actual)[0] / chain.slope(x, actual, cell.k)[:, None])
        size = float(np.linalg.norm(error))
        straight = np.linalg.inv(r) * size
        limit_matrix, room = rows @ straight, bounds - rows @ cell.k
        inner = factor.T @ error / size
        step, multipliers, status = -inner, np.zeros(room.size), "closed form"
        if np.any(limit_matrix @ step > room):
            answer = task.programme(factor, error / size, limit_matrix, room)
            if answer is None:
                return cell, 0.0, "no answer"
            step, multipliers, status = answer.step, np.maximum(answer.limits, 0.0), answer.status
        free = -inner - 0.5 * limit_matrix.T @ multipliers  # least point of the Lagrangian: weak duality
        square = 1.0 - inner @ inner + np.sum((free + inner) ** 2) + multipliers @ (limit_matrix @ free - room)
        bound = math.sqrt(max(0.0, float(square))) * float(cell.error)
        better = _moved(task, cell, straight @ step)
        if better is cell or bound >= (1.0 - CLOSE) * cell.error:
            break
        cell, bound = better, 0.0  # that bound was one of the model about the linkage before
    return cell, bound, status


# --- what a design needs -------------------------------------------------------------------------------------------


def _zoom(task: _Task, cells: _Cells, grids: tuple[Array, Array]) -> _Cells:
    """Better start positions around those of the grid, by ever finer grids of their own."""
    reach = [_step_of(grid) for grid in grids]
    if len(cells.error) == 0 or not any(reach):
        return cells
    first, second = (a.ravel() for a in np.meshgrid(*(FINE if r > 0.0 else FINE[2:3] for r in reach), indexing="ij"))
    for _ in range(ZOOMS):
        x0 = np.clip(cells.x0[:, None] + reach[0] * first, *task.range_x)
        y0 = np.clip(cells.y0[:, None] + reach[1] * second, *task.range_y)
        found = _fit(task, x0.ravel(), y0.ravel())
        best = np.argmin(found.error.reshape(x0.shape), axis=-1) + first.size * np.arange(len(x0))
        better = np.flatnonzero(found.error[best] < cells.error)
        both = _together([cells, found[best]])
        index = np.arange(len(x0))
        index[better] += len(x0)
        cells = both[index]
        reach = [0.5 * r for r in reach]
    return cells


def _search(task: _Task, x0: Array, y0: Array, count: int) -> list[tuple[_Cells, dict[str, Any]]]:
    """The best linkages that lie apart, each a cell without dimension and the fields of its `Step`; least error first."""
    cells = _scan(task, x0, y0)
    steps = max(_step_of(x0), EXACT), max(_step_of(y0), EXACT * task.unit)
    cells = _zoom(task, cells[_apart(task, cells, (APART * steps[0], APART * steps[1]), SPARE * count)], (x0, y0))
    cells = cells[_apart(task, cells, steps, count)]
    found = []
    for i in range(len(cells.error)):
        cell, bound, status = (_smallest_largest if task.largest else _least_squares)(task, _least(task, cells[i]))
        a, w = _linear(task.chain, cell.x0 + task.x, cell.y0 + task.y)
        error = float(cell.error)
        own: dict[str, Any] = {
            "side": int(cell.side),
            "residual": float(task.figure(a @ cell.k - w)),
            "error": error,
            "bound": bound,
            "proven": bound >= (1.0 - 2.0 * CLOSE) * error or error <= EXACT * task.unit,
            "status": status,
        }
        found.append((cell, own))
    return sorted(found, key=lambda one: (max(float(one[0].error), EXACT * task.unit), -float(one[0].margin)))


def _read(
    x: ArrayLike, y: ArrayLike, what: str, measure: str, ratios: tuple[float, float] | None, count: int
) -> tuple[Array, Array]:
    """The wanted rotations and outputs, checked."""
    one, other = np.asarray(x, dtype=float), np.asarray(y, dtype=float)
    if one.ndim != 1 or one.shape != other.shape:
        raise ValueError(f"phi and {what} are two lists of the same length, not of shapes {one.shape} and {other.shape}")
    if not (np.all(np.isfinite(one)) and np.all(np.isfinite(other))):
        raise ValueError(f"phi and {what} must be finite")
    if np.unique(one).size < 3:
        raise ValueError("three positions at least, at different phi: fewer do not determine the three constants")
    if np.ptp(other) == 0.0:
        raise ValueError(f"{what} is constant: an output that does not move needs no linkage")
    if measure not in MEASURES:
        raise ValueError(f"measure is one of {', '.join(MEASURES)}, not {measure!r}")
    if ratios is not None and not 0.0 < ratios[0] < ratios[1] < math.inf:
        raise ValueError(f"ratios are two positive numbers, the lower one first, not {ratios}")
    if count < 1:
        raise ValueError(f"count is 1 or more, not {count}")
    return one, other


def _grid(values: ArrayLike, what: str) -> Array:
    grid = np.unique(np.asarray(values, dtype=float))
    if grid.size == 0 or not np.all(np.isfinite(grid)):
        raise ValueError(f"{what} must be one or more finite numbers")
    return grid


def _range(grid: Array) -> tuple[float, float]:
    return float(grid[0]), float(grid[-1])


def _wrapped(angle: float) -> float:
    """The same direction in (-pi, pi]."""
    return math.pi - (math.pi - angle) % (2.0 * math.pi)


def first_steps(
    phi: ArrayLike,
    psi: ArrayLike,
    phi0: ArrayLike,
    psi0: ArrayLike,
    measure: str = "max",
    ratios: tuple[float, float] | None = None,
    count: int = 5,
    *,
    shift: bool = True,
    keep: Keep | None = None,
) -> list[FirstStep]:
    """Four-bars whose rocker turns by psi while the crank turns by phi, as nearly as they can: starts for a design programme.

    Parameters
    ----------
    phi, psi : (n,) [rad]
        Wanted rotations of crank and rocker, counted from their starts; n >= 3.
    phi0, psi0 : float or (p,), (q,) [rad]
        Starts to be scanned; several make a grid, between whose points the search goes on.
    measure : "max", "rms" or "sum of squares"
        Of the output error.
    ratios : (low, high), optional [-]
        Limits of crank, coupler and rocker over the frame; left out: `UNLIMITED`.
    count : int
        So many linkages at most, their starts at least `APART` grid steps apart or on different modes.
    shift : bool
        True: a fit with a negative crank or rocker is one that starts half a turn further; grids over half a turn then cover all
        starts. False: starts are meant as they are given, none leaves the range of its grid.
    keep : function (crank, coupler, rocker, phi0, psi0, side), all (m,), to (m,) of bool, optional
        Which linkages are wanted, lengths over the frame. A limit that the best design lies upon should be a little wider here
        (28 deg for a transmission angle of 30 deg): the fit at the nearest start may just miss it.

    Returns
    -------
    list of FirstStep, least error first; empty where no start gives a linkage that stays on its mode over the whole range

    Raises
    ------
    ValueError
        when there are fewer than three positions, psi is constant, something is not finite, or an option is out of range.
    """
    x, y = _read(phi, psi, "psi", measure, ratios, count)
    grids = _grid(phi0, "phi0"), _grid(psi0, "psi0")
    ranges = (ANYWHERE, ANYWHERE) if shift else (_range(grids[0]), _range(grids[1]))
    task = _Task(_FourBar(ratios or UNLIMITED), x, y, measure == "max", 1.0, shift, keep, *ranges)
    steps = []
    for cell, own in _search(task, *grids, count):
        crank, coupler, rocker = (float(size) for size in task.chain.sizes(cell.k))
        start = [_wrapped(float(angle)) if shift else float(angle) for angle in (cell.x0, cell.y0)]
        steps.append(FirstStep(**own, crank=crank, coupler=coupler, rocker=rocker, phi0=start[0], psi0=start[1]))
    return steps


def first_steps_slider(
    phi: ArrayLike,
    s: ArrayLike,
    phi0: ArrayLike,
    s0: ArrayLike,
    measure: str = "max",
    ratios: tuple[float, float] | None = None,
    count: int = 5,
    *,
    shift: bool = True,
    keep: Keep | None = None,
) -> list[FirstStepSlider]:
    """Slider-cranks whose slider moves by s while the crank turns by phi, as nearly as they can.

    Parameters
    ----------
    phi, s : (n,) [rad], [any unit of length]
        Wanted rotation of the crank and displacement of the slider along the guide, counted from their starts; n >= 3.
    phi0, s0 : float or (p,), (q,) [rad], [unit of s]
        Starts to be scanned: crank angle from the guide's direction, place of the slider from the crank pivot along the guide. No
        start leaves the range of s0.
    ratios : (low, high), optional [-]
        Limits of crank and coupler over the stroke (largest less least s); the offset's size has the upper one.
    keep : function (crank, coupler, offset, phi0, s0, side), all (m,), to (m,) of bool, optional
    measure, count, shift
        As in `first_steps`.

    Returns
    -------
    list of FirstStepSlider, least error first; empty where no start gives a linkage that stays on its mode over the whole range

    Raises
    ------
    ValueError
        as `first_steps`.
    """
    x, y = _read(phi, s, "s", measure, ratios, count)
    grids = _grid(phi0, "phi0"), _grid(s0, "s0")
    stroke = float(np.ptp(y))
    ranges = ANYWHERE if shift else _range(grids[0]), _range(grids[1])
    task = _Task(_SliderCrank(ratios or UNLIMITED, stroke), x, y, measure == "max", stroke, shift, keep, *ranges)
    steps = []
    for cell, own in _search(task, *grids, count):
        crank, coupler, offset = (float(size) for size in task.chain.sizes(cell.k))
        start = _wrapped(float(cell.x0)) if shift else float(cell.x0)
        steps.append(FirstStepSlider(**own, crank=crank, coupler=coupler, offset=offset, phi0=start, s0=float(cell.y0)))
    return steps
