"""All four-bars through given poses and points of a coupler: parameter homotopy from a generic problem of the same kind.

M poses and N further points with 2 (M - 1) + N = 8 leave a four-bar no freedom. Let x be a joint of the coupler, u the vector of
its link from the pivot, d a displacement with the rotation 1 + t, and (xb, ub, e, s) their conjugates, s = -t / (1 + t), which in
isotropic coordinates are independent numbers. The joint moves by p = d + t x, and the length of the link stays if

    (u + p) (ub + q) - u ub = p ub + u q + p q = 0,     q = e + s xb,

for both dyads. The rotation is known at a pose and unknown at a point. So do five points if both pivots are given. The number of
complex solutions is the same for almost all data, so the solutions of one generic problem are carried to those of any other one,
along paths that do not meet. With t and u, instead of the rotation and the pivot, no digits are lost where joints are far away
and rotations small.

References
----------
C. W. Wampler, A. P. Morgan, A. J. Sommese, J. Mech. Design 114 (1992) 153-159 (nine points: 1442 triples of cognates).
A. J. Sommese, C. W. Wampler, The Numerical Solution of Systems of Polynomials (2005), chapters 7 (parameter homotopy), 9.
T. Duff et al., IMA J. Numer. Anal. 39 (2019) 1421-1446 (monodromy).
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from optlink.linkage.vector2d import Array
from optlink.synthesis.pairs import Complex, Pair, closure

TOLERANCE = 1e-3  # correction of a predicted point that the step size aims at, relative to the coordinates
CONVERGED = 1e-8  # last correction of a point on a path: rounding is as large near infinity
CORRECTIONS = (3, 9)  # Newton steps at most, with a Jacobian in double precision
LEAST = 1e-2  # size that a smaller coordinate counts as when roots are compared; the displacements are of size 1
MANY = 400  # paths from which on compilation, which takes some seconds once, is worth it
SHORTEST = (1e-9, 1e-14)  # step at which a path is given up, in double precision and in pairs
MOST = (2000, 400)  # number of steps at which a path is given up
HISTORY = 6  # last points of a path through which a polynomial predicts the next one, in pairs
POOR = 0.01  # correction relative to the step of a path, from which on slopes in doubles are wrong
SHARE = 0.3  # of the last step by slopes, below which they predict better than points do
FARTHEST = 1e-2  # first correction of such a prediction, relative to the coordinates, from which on it may lead to another path
PIVOTS = np.array([[[1, 0, -1, 0], [0] * 4], [[0, 1, 0, -1], [0] * 4], [[0] * 4, [1, 0, -1, 0]], [[0] * 4, [0, 1, 0, -1]]])
"""Derivatives of both pivots by the dyads, (4, 2, 4)."""


@dataclass(frozen=True)
class Problem:
    """Displacements from the first pose and their conjugates (K,), and rotations less one (M - 1,) at the poses, the first ones.

    `pivots` (2, 2), if given: from the first pose, and their conjugates. For real data `e` is the conjugate of `d`, and
    1 + `turns` is of modulus 1; a generic problem is not real.
    """

    d: Complex
    e: Complex
    turns: Complex
    pivots: Complex | None = None

    @property
    def kind(self) -> tuple[int, int]:
        """Numbers of poses, with the first one, and of points."""
        return len(self.turns) + 1, len(self.d) - len(self.turns)

    @property
    def data(self) -> Complex:
        """All data (4, K), with 0 as the rotations at points and the pivots that are free."""
        pivots = np.zeros(0) if self.pivots is None else self.pivots.ravel()
        rows = (self.d, self.e, self.turns, pivots)
        return np.array([np.pad(row, (0, len(self.d) - len(row))) for row in rows], dtype=complex)


@dataclass(frozen=True)
class Roots:
    """Solutions: joint and link (B, 2, 4) of both dyads as (x, xb, u, ub), and rotations less one (B, K) at all displacements."""

    dyads: Complex
    turns: Complex

    def __len__(self) -> int:
        return len(self.dyads)

    def __getitem__(self, index: Any) -> "Roots":
        return Roots(self.dyads[index], self.turns[index])


Steps = Callable[..., tuple[Complex, Complex]]


def slopes(dyads: Complex, turns: Complex, d: Complex, e: Complex) -> tuple[Complex, Complex, Complex, Complex]:
    """Return the equations (B, 2, K), and their derivatives by dyads (B, 2, K, 4), rotations, and displacements (2, B, 2, K)."""
    x, xb, u, ub = np.moveaxis(dyads, 2, 0)[..., None]
    t, d, e = turns[:, None], d[..., None, :], e[..., None, :]
    inverse = 1.0 / (1.0 + t)
    s = -t * inverse
    p, q = d + t * x, e + s * xb
    by_d, by_e = ub + q, u + p
    slope = np.stack([t * by_d, s * by_e, q, p], axis=-1)
    return p * by_d + u * q, slope, x * by_d - inverse * inverse * xb * by_e, np.stack([by_d, by_e])


def steps(
    dyads: Complex,
    turns: Complex,
    d: Complex,
    e: Complex,
    poses: int,
    rates: tuple[Complex, ...] | None = None,
    residual: Complex | None = None,
) -> tuple[Complex, Complex]:
    """Return Newton steps of dyads and rotations at displacements (B, K), or tangents for rates of the data (K,).

    The rotation at a point is eliminated from the rows of both dyads, so a step solves eight linear equations. A `residual`
    (B, 2, K) is taken in place of the values of the equations in double precision.
    """
    value, slope, by_turn, (by_d, by_e) = slopes(dyads, turns, d, e)
    if residual is not None:
        value = residual
    if rates is not None:
        value = by_d * rates[0] + by_e * rates[1] + by_turn * rates[2]
    count = len(dyads)
    matrix, right = np.zeros((count, 8, 2, 4), complex), np.empty((count, 8), complex)
    for k in range(2):
        rows = slice(k * poses, (k + 1) * poses)
        matrix[:, rows, k], right[:, rows] = slope[:, k, :poses], -value[:, k, :poses]
    weight = by_turn[:, :, poses:]
    weight = weight / np.maximum(np.sqrt(np.sum(np.abs(weight) ** 2, axis=1, keepdims=True)), 1e-300)
    last = poses + turns.shape[1]  # four rows less than eight if the pivots are given
    matrix[:, 2 * poses : last, 0] = weight[:, 1, :, None] * slope[:, 0, poses:]
    matrix[:, 2 * poses : last, 1] = -weight[:, 0, :, None] * slope[:, 1, poses:]
    right[:, 2 * poses : last] = weight[:, 0] * value[:, 1, poses:] - weight[:, 1] * value[:, 0, poses:]
    matrix[:, last:] = PIVOTS[: 8 - last]
    if last < 8:
        right[:, last:] = 0.0 if rates is None else rates[3][: 8 - last]
    scale = np.maximum(np.abs(dyads), 1e-300)
    matrix *= scale[:, None]
    square = matrix.reshape(count, 8, 8)
    rows_of = np.maximum(np.max(np.abs(square), axis=2), 1e-300)
    square, right = square / rows_of[..., None], right / rows_of
    regular = np.linalg.det(square) != 0.0
    square[~regular], right[~regular] = np.eye(8), np.nan
    change = np.asarray(scale * np.linalg.solve(square, right[..., None]).reshape(count, 2, 4), complex)
    turned = np.zeros_like(turns)
    rest = value + np.einsum("bkij,bkj->bki", slope, change)
    size = np.sum(np.abs(by_turn) ** 2, axis=1)
    turned[:, poses:] = -(np.sum(np.conj(by_turn) * rest, axis=1) / np.maximum(size, 1e-300))[:, poses:]
    if rates is not None:
        turned[:, :poses] = rates[2][:poses]
    return change, turned


def track(roots: Roots, start: Problem, end: Problem) -> tuple[Roots, Array]:
    """Return the solutions where the paths from those of another problem end, and how far each came: 1 is its end.

    Where doubles are too short, near singular or infinite solutions, a path is continued with 32 digits.
    """
    found, at = follow(roots, start, end, np.zeros(len(roots)), False)
    lost = np.flatnonzero(at < 1.0)
    again, at[lost] = follow(found[lost], start, end, at[lost], True)
    found.dyads[lost], found.turns[lost] = again.dyads, again.turns
    return found, at


def follow(roots: Roots, start: Problem, end: Problem, reached: Array, precise: bool) -> tuple[Roots, Array]:
    """Return the last solutions on the paths from where they were `reached`, and how far each came: 1 is its end.

    A step of the classical Runge-Kutta method is corrected by Newton's method; all paths take their steps at the same time. With
    pairs a polynomial through the last points predicts the next one, as slopes of doubles are wrong near singular four-bars.
    """
    poses, advance = len(start.turns), steps if precise else solver(len(roots))
    begin, change = start.data, Pair(end.data) + Pair(-start.data)
    rates = tuple(change.high)
    state = Pair(np.concatenate([roots.dyads.reshape(-1, 8), roots.turns], axis=1))
    rest = np.zeros_like(state.high)
    at = reached.copy()
    step, count = np.minimum(0.02, 0.1 * (1.0 - at)), np.zeros(len(roots), int)
    open_paths = np.flatnonzero(at < 1.0)
    passed, points = np.full((HISTORY, len(at)), np.nan), np.empty((HISTORY, *state.high.shape), complex)
    passed[0], points[0], least = at, state.high, np.full(len(at), np.inf)

    def slope(state: Complex, s: Array, *more: Any) -> Complex:
        data = begin + s[:, None, None] * change.high
        dyads, turns = state[:, :8].reshape(-1, 2, 4), state[:, 8:].copy()
        by_dyads, by_turns = advance(dyads, turns, data[:, 0], data[:, 1], poses, *more)
        return np.concatenate([by_dyads.reshape(-1, 8), by_turns], axis=1)

    def residual(state: Pair, s: Array) -> Complex:
        data = Pair(begin) + Pair(s[:, None, None].astype(complex)) * change
        d, e, t = (data[:, None, k] for k in range(3))
        t.high[..., poses:], t.low[..., poses:] = state.high[:, None, 8 + poses :], state.low[:, None, 8 + poses :]
        x, xb, u, ub = (state[:, [k, k + 4], None] for k in range(4))
        values: Pair = closure(x, xb, u, ub, d, e, t, Pair(np.array(1.0 + 0j)), Pair(np.array(-1.0 + 0j)))
        return values.high / (1.0 + t.high)

    with np.errstate(all="ignore"):  # a path that meets a singular point has no finite steps, and is given up
        while len(open_paths):
            z, s = Pair(state.high[open_paths], rest[open_paths]), at[open_paths]
            h = np.minimum(step[open_paths], 1.0 - s)
            known = (h > least[open_paths]) & np.isfinite(passed[-1, open_paths])
            fresh = np.flatnonzero(~known)
            if len(fresh):
                total = rate = np.zeros_like(z.high[fresh])
                for share, weight in ((0.0, 1.0), (0.5, 2.0), (0.5, 2.0), (1.0, 1.0)):
                    far = share * h[fresh]
                    rate = slope(z.high[fresh] + far[:, None] * rate, s[fresh] + far, rates)
                    total = total + weight * rate
                moved = z[fresh] + Pair((h[fresh] / 6.0)[:, None] * total)
                z.high[fresh], z.low[fresh] = moved.high, moved.low
            old = open_paths[known]
            z.high[known], z.low[known] = extrapolated(passed[:, old], points[:, old], (s + h)[known]), 0.0
            s += h
            z.high[:, 8 : 8 + poses] = start.turns + s[:, None] * change.high[2, :poses]
            length = np.max(np.abs(z.high / state.high[open_paths] - 1.0), axis=1)
            first = last = np.full(len(s), np.inf)
            for k in range(CORRECTIONS[precise]):
                left = np.flatnonzero((last > CONVERGED) & ((k == 0) | (last < 0.1)))
                if not len(left):
                    break
                by = slope(z.high[left], s[left], None, *([residual(z[left], s[left])] if precise else []))
                moved = z[left] + Pair(by)
                z.high[left], z.low[left] = moved.high, moved.low
                last = last.copy()
                size = np.abs(moved.high)
                if precise:
                    size[:, 8:] = np.minimum(size[:, 8:], np.abs(1.0 + moved.high[:, 8:]))
                else:
                    size[:, :8] += 1.0
                last[left] = np.max(np.abs(by) / size, axis=1)
                first = last if k == 0 else first
            good = (last < CONVERGED) & ((first < FARTHEST) | ~known)  # false for numbers that are none
            taken = open_paths[good]
            state.high[taken], rest[taken], at[taken] = z.high[good], z.low[good], s[good]
            if precise:
                least[taken] = np.where(known, least[open_paths], np.where(first > POOR * length, SHARE * h, np.inf))[good]
                for values, newest in ((passed, at), (points, state.high)):
                    values[:, taken] = np.concatenate([newest[None, taken], values[:-1, taken]])
            scale = np.clip((TOLERANCE / first) ** 0.2, 0.3, 2.5)
            step[open_paths] = np.where(good, np.where(np.isfinite(scale), scale, 0.3), 0.4) * h
            count[open_paths] += 1
            open_paths = open_paths[
                (at[open_paths] < 1.0) & (step[open_paths] > SHORTEST[precise]) & (count[open_paths] < MOST[precise])
            ]
    return Roots(state.high[:, :8].reshape(-1, 2, 4), state.high[:, 8:]), at


def extrapolated(passed: Array, points: Complex, s: Array) -> Complex:
    """Return polynomials through points (n, B, m) at places `passed` (n, B), at other places (B,)."""
    total: Complex = np.zeros_like(points[0])
    for j, own in enumerate(passed):
        others = np.delete(passed, j, axis=0)
        total += np.prod((s - others) / (own - others), axis=0)[:, None] * points[j]
    return total


def solver(count: int) -> Steps:
    """Return `steps` for a number of paths, compiled if numba is installed and they are worth it."""
    if count < MANY:
        return steps
    try:
        from optlink.synthesis import compiled_steps
    except ImportError:
        return steps
    return compiled_steps.steps
