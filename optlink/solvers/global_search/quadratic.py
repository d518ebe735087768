"""Polynomials of second order and linear inequalities over the box -1 <= d <= 1: rigorous bounds, elementwise over many boxes."""

import numpy as np

from optlink.linkage.vector2d import Array
from optlink.optimization.taylor_model import ROUNDING, TINY, UNIT, UPWARD, pairs

DESCENT = 8  # rounds of coordinate descent towards the minimum of a convex quadratic form
WORTH = 0.15  # share of the width of a box that must be cut off


def quadratic_bound(constant: Array, linear: Array, quadratic: Array, remainder: Array) -> Array:
    """Return a lower bound, over -1 <= d <= 1, of polynomials of second order minus a remainder; -inf where there is none.

    The better of two: each unknown by itself, with the mixed terms at their worst; and the tangent plane, at about its minimum,
    of the polynomial made convex by a multiple of d^2 - 1. Coefficients: `constant` (boxes,), `linear` (boxes, n), `quadratic`
    (boxes, n (n + 1) / 2) in the order of `pairs`.
    """
    boxes, n = linear.shape
    hessian, mixed = np.zeros((boxes, n, n)), np.zeros(boxes)
    for k, (i, j) in enumerate(pairs(n)):
        hessian[:, i, j] += quadratic[:, k]
        hessian[:, j, i] += quadratic[:, k]
        mixed += np.abs(quadratic[:, k]) if i != j else 0.0
    size = np.abs(constant) + np.abs(linear).sum(axis=1) + np.abs(quadratic).sum(axis=1)
    with np.errstate(all="ignore"):
        curvature = np.einsum("bii->bi", hessian)
        inside = np.abs(linear) < curvature
        separate = np.where(inside, -0.5 * linear * linear / np.where(inside, curvature, 1.0), 0.5 * curvature - np.abs(linear))
        simple = constant + separate.sum(axis=1) - mixed
        scale = np.abs(hessian).sum(axis=(1, 2))
        clean = np.isfinite(scale)
        least = np.linalg.eigvalsh(np.where(clean[:, None, None], hessian, 0.0))[:, 0]
        shift = np.maximum(0.0, 1e-12 * scale - least)  # far beyond the error of a computed eigenvalue, so the sum is convex
        convex = hessian + shift[:, None, None] * np.eye(n)
        point = box_minimum(linear, convex)
        slope = linear + np.einsum("bij,bj->bi", convex, point)
        value = constant + 0.5 * np.sum((linear + slope) * point, axis=1)
        tangent = value - np.sum(np.abs(slope) + slope * point, axis=1) - 0.5 * n * shift
        rounding = 16.0 * n * n * ROUNDING * (size + n * shift)
        bound = (
            np.maximum(simple, np.where(clean & np.isfinite(tangent), tangent, -np.inf)) - rounding - remainder * UPWARD - TINY
        )
    return np.where(np.isfinite(bound), bound, -np.inf)


def box_minimum(linear: Array, convex: Array) -> Array:
    """Return about the minimum (boxes, n) of linear . d + d' convex d / 2 over -1 <= d <= 1; `convex` is positive semidefinite.

    It starts from the minimum without bounds, which is the answer if it lies within, and goes on by coordinate descent.
    """
    n = linear.shape[1]
    clean = np.all(np.isfinite(convex), axis=(1, 2)) & np.all(np.isfinite(linear), axis=1)
    matrix = np.where(clean[:, None, None], convex, 0.0)
    firm = 1e-14 * np.trace(matrix, axis1=1, axis2=2) + TINY  # no matrix is singular
    with np.errstate(all="ignore"):
        point = -np.linalg.solve(matrix + firm[:, None, None] * np.eye(n), np.where(clean[:, None], linear, 0.0)[..., None])[
            ..., 0
        ]
        point = np.clip(np.where(np.isfinite(point), point, 0.0), -1.0, 1.0)
        slope = linear + np.einsum("bij,bj->bi", convex, point)
        for step in range(DESCENT * n):
            i = step % n
            curvature = convex[:, i, i]
            target = np.where(curvature > 0.0, point[:, i] - slope[:, i] / curvature, -np.sign(slope[:, i]))
            move = np.clip(np.where(np.isfinite(target), target, 0.0), -1.0, 1.0) - point[:, i]
            point[:, i] += move
            slope += convex[:, :, i] * move[:, None]
    return point


def cut_box(rows: Array, most: Array) -> tuple[Array, Array]:
    """Return bounds (boxes, n) within -1 ... 1 of the points d with rows . d <= most, rigorous; -1 and 1 where little is gained.

    `rows` (boxes, m, n), `most` (boxes, m).
    """
    size = np.abs(rows)
    total = size.sum(axis=2, keepdims=True)
    with np.errstate(all="ignore"):
        room = most[..., None] + (total - size)  # the other unknowns at their best
        rounding = 64.0 * UNIT * (np.abs(most)[..., None] + 2.0 * total) / size
        end = room / rows
        high = np.min(np.where(rows > 0.0, end + rounding, np.inf), axis=1, initial=np.inf)
        low = np.max(np.where(rows < 0.0, end - rounding, -np.inf), axis=1, initial=-np.inf)
    low = np.where(low > -1.0 + 2.0 * WORTH, low, -1.0)
    return low, np.where(high < 1.0 - 2.0 * WORTH, high, 1.0)


def least_squares(matrix: Array, vector: Array) -> Array:
    """Return x (n,) >= 0 with about the least |matrix x - vector|, by leaving out what becomes negative."""
    used = np.arange(matrix.shape[1])
    solution = np.zeros(matrix.shape[1])
    while used.size:
        x = np.linalg.lstsq(matrix[:, used], vector, rcond=None)[0]
        if np.all(x >= 0.0):
            solution[used] = x
            break
        used = used[x > np.min(x)]
    return solution
