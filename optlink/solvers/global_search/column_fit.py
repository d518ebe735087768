"""Lower bounds of a linear least-squares fit of complex points with one column that is known over a box only.

The residuals are P - F y - w f: points P, known columns F with real unknowns y, and a column f with a complex unknown w. With h
the part of f, and p that of P, that no y can produce, the least sum of squares is |p|^2 - |<h, p>|^2 / |h|^2. It is at least L
if (|p|^2 - L) |h|^2 - |<h, p>|^2 >= 0: a quadratic form of f, which is bounded over the box by the Taylor model of f. Where the
known columns span no complex space, w is a real number times 1 + tau i, and the form is replaced by its least value over tau.

Complex vectors are stored as N real parts followed by N imaginary parts.

References
----------
G. H. Golub and V. Pereyra, The differentiation of pseudo-inverses and nonlinear least squares problems whose variables separate,
SIAM J. Numer. Anal. 10 (1973) 413-432.
"""

import math
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from optlink.linkage.vector2d import Array
from optlink.optimization.taylor_model import TINY, UNIT, pairs
from optlink.solvers.global_search.quadratic import quadratic_bound

Complex = NDArray[np.complex128]

FEWEST = 9  # points from which on positions may be left out
MAX_PAIR_POINTS = 36  # points up to which two positions may be left out
SLACK = 1e-12  # relative; far beyond the rounding of the sums to which it applies


class ColumnFit:
    """A least-squares fit without any of its points, one of them or two: a lower bound of that with all points.

    `points` (N,) and `fixed_columns` (k, N) are P and F, weighted. `whole`: multiples of the columns by i are columns too. `size`
    bounds the length of y in the fits that count, `rounding` the error of the points.
    """

    def __init__(self, points: Complex, fixed_columns: Complex, *, whole: bool, size: float, rounding: float) -> None:
        count = len(points)
        largest = (2 if count <= MAX_PAIR_POINTS else 1) if count >= FEWEST else 0
        sets = [drop for number in range(largest + 1) for drop in combinations(range(count), number)]
        self.count, self.largest, self.whole = count, largest, whole
        self.index = {drop: k for k, drop in enumerate(sets)}
        self.keep = np.ones((len(sets), 2 * count))
        self.matrix = np.zeros((len(sets), 2 * count, 2 * count))  # projectors onto what y cannot produce
        self.target = np.zeros((len(sets), 2 if whole else 1, 2 * count))  # p, and i p
        self.error = np.zeros(len(sets))  # bound of what the projector leaves of the known columns, and of rounding
        for k, drop in enumerate(sets):
            for j in drop:
                self.keep[k, [j, count + j]] = 0.0
            rows = self.keep[k] > 0.0
            fixed, targets = as_real(fixed_columns) * self.keep[k], as_real(points) * self.keep[k]
            basis = np.zeros((2 * count, max(0, int(rows.sum()) - len(fixed))))
            basis[rows] = np.linalg.qr(fixed[:, rows].T, mode="complete")[0][:, len(fixed) :]
            self.matrix[k] = basis @ basis.T
            self.target[k, 0] = basis @ (basis.T @ targets)
            if whole:
                self.target[k, 1] = times_i(self.target[k, 0])
            left = np.sqrt(np.sum((basis.T @ fixed.T) ** 2)) + ((2 * count) ** 1.5 + 64.0) * UNIT * np.sqrt(np.sum(fixed**2))
            self.error[k] = left * size + 256.0 * count * UNIT * np.sqrt(np.sum(targets**2)) + rounding
        self.square = np.sum(self.target[:, 0] ** 2, axis=1)
        self._forms: tuple[float, Array, Array] = (math.nan, self.square, self.matrix)

    def proven(self, bound: Array, error: Array) -> Array:
        """Return the sum of squares that a bound of the projected one proves, in spite of the errors of the projection."""
        size = np.maximum(0.0, np.sqrt(np.maximum(bound, 0.0)) * (1.0 - SLACK) - error)
        return size * size * (1.0 - SLACK)

    def forms(self, threshold: float) -> tuple[Array, Array]:
        """Return the level L (sets,) that proves a threshold, and the quadratic forms (sets, 2 N, 2 N)."""
        if self._forms[0] != threshold:
            level = ((math.sqrt(max(threshold, 0.0)) * (1.0 + SLACK) + self.error) * (1.0 + SLACK)) ** 2
            rest = np.maximum(self.square * (1.0 - SLACK) - level, 0.0)
            outer = np.einsum("ski,skj->sij", self.target, self.target)
            self._forms = threshold, level, rest[:, None, None] * self.matrix - outer
        return self._forms[1:]

    def bounds(
        self, coefficients: Array, remainder: Array, chosen: NDArray[np.intp], threshold: float
    ) -> tuple[Array, Array, Array, NDArray[np.intp]]:
        """Bound the least sum of squares over boxes; a bound that reaches the threshold is the threshold.

        The column f has the Taylor coefficients (boxes, 1 + n + n (n + 1) / 2, 2 N) and remainder (boxes, 2 N); `chosen` (boxes,)
        is the set of points that is left out, or all zero for none.

        Returns
        -------
        bound : array (boxes,)
        size : array (boxes, coefficients)
            Of every coefficient of what no y can produce.
        value : array (boxes,)
            Sum of squares at the centre, not rigorous: the least one if `whole` or where it is the threshold.
        worst : array of int (boxes,)
            Point whose remainder costs most.
        """
        n = unknowns(coefficients)
        levels, forms = self.forms(threshold)
        rows = np.zeros(1, dtype=np.intp) if not chosen.any() else chosen
        matrix, form, keep = self.matrix[rows], forms[rows], self.keep[rows]
        level, square = levels[chosen], self.square[chosen]
        vectors, rho = coefficients * keep[:, None, :], remainder * keep
        if not self.whole:
            vectors, rho = _turned(vectors, rho, form)
        applied = vectors @ form
        polynomial = _products(vectors, applied)
        size = _lengths(vectors @ matrix)
        length, spread = _lengths(vectors).sum(axis=1), _lengths(rho)
        cost = 2.0 * rho * np.abs(applied).sum(axis=1)
        negative = level + SLACK * square  # no eigenvalue of the form is below the negative of it
        rounding = 32.0 * (2 * self.count) ** 1.5 * UNIT * square * (length + spread) ** 2
        rest = polynomial[3] + cost.sum(axis=1) + negative * (size[:, 1 + n :].sum(axis=1) + spread) ** 2
        rest = rest * (1.0 + SLACK) + rounding + TINY
        if not self.whole:
            _least_over_phase(polynomial, rest, vectors, rho, form, (negative, square, rounding))
        slack = quadratic_bound(polynomial[0], polynomial[1], polynomial[2], rest)
        least = np.maximum(0.0, size[:, 0] - size[:, 1:].sum(axis=1) - spread - SLACK * (length + spread))
        with np.errstate(all="ignore"):
            lower = level + slack / (least * least) * (1.0 + SLACK)
            lower = np.where((least > 0.0) & self.whole & np.isfinite(lower), lower, 0.0)
            possible = square * (1.0 - SLACK) > level
            value = level + polynomial[0] / (size[:, 0] ** 2)
        bound = np.where(slack >= 0.0, threshold, np.minimum(threshold, self.proven(lower, self.error[chosen])))
        each = np.where(keep[:, : self.count] > 0.0, cost[:, : self.count] + cost[:, self.count :], -1.0)
        value = np.where(np.isfinite(value), value, np.inf)
        return np.where(possible, bound, 0.0), size, value, np.argmax(each, axis=1)


def as_real(z: Any) -> Array:
    """Return real parts followed by imaginary parts along the last axis."""
    return np.concatenate([np.real(z), np.imag(z)], axis=-1)


def times_i(vectors: Array) -> Array:
    """Return complex vectors times i."""
    half = vectors.shape[-1] // 2
    return np.concatenate([-vectors[..., half:], vectors[..., :half]], axis=-1)


def unknowns(coefficients: Array) -> int:
    """Return the number n of unknowns of a polynomial with coefficients (boxes, 1 + n + n (n + 1) / 2, ...)."""
    return math.isqrt(2 * coefficients.shape[1]) - 1


def changes(size: Array) -> Array:
    """Return how much every unknown changes a polynomial (boxes, n), from the sizes of its coefficients; see `unknowns`."""
    n = unknowns(size)
    radius = size[:, 1 : 1 + n].copy()
    for k, (i, j) in enumerate(pairs(n)):
        radius[:, i] += size[:, 1 + n + k]
        radius[:, j] += size[:, 1 + n + k] if i != j else 0.0
    return radius


def _lengths(vectors: Array) -> Array:
    return np.asarray(np.sqrt(np.sum(vectors * vectors, axis=-1)))


def _products(one: Array, other: Array) -> list[Array]:
    """Return the scalar product of two polynomials up to second order (three coefficients), and the size of the third order."""
    n = unknowns(one)
    gram = one @ np.moveaxis(other, 1, 2)
    linear = gram[:, 0, 1 : 1 + n] + gram[:, 1 : 1 + n, 0]
    quadratic = gram[:, 0, 1 + n :] + gram[:, 1 + n :, 0]
    for k, (i, j) in enumerate(pairs(n)):
        quadratic[:, k] += gram[:, 1 + i, 1 + j] + (gram[:, 1 + j, 1 + i] if i != j else 0.0)
    third = np.abs(gram[:, 1 : 1 + n, 1 + n :]).sum(axis=(1, 2)) + np.abs(gram[:, 1 + n :, 1 : 1 + n]).sum(axis=(1, 2))
    return [gram[:, 0, 0], linear, quadratic, third]


def _turned(vectors: Array, rho: Array, form: Array) -> tuple[Array, Array]:
    """Turn the column by the phase with the smallest value of the form at the centre."""
    column = vectors[:, :1]
    across = times_i(column)
    applied, over = column @ form, across @ form
    first, mixed, second = ((x * y).sum(axis=(1, 2)) for x, y in ((applied, column), (applied, across), (over, across)))
    angle = (0.5 * np.arctan2(-mixed, 0.5 * (second - first)))[:, None, None]
    cosine, sine = np.cos(angle), np.sin(angle)
    half = rho.shape[1] // 2
    either = np.hypot(rho[:, :half], rho[:, half:]) * (1.0 + SLACK)
    beside = times_i(vectors)
    lost = 8.0 * UNIT * (np.abs(vectors) + np.abs(beside)).sum(axis=1)
    return cosine * vectors + sine * beside, np.tile(either, 2) + lost


def _least_over_phase(
    polynomial: list[Array], rest: Array, vectors: Array, rho: Array, form: Array, sizes: tuple[Array, Array, Array]
) -> None:
    """Replace the form of a column f by its least value over f + tau i f for all real tau, in place.

    It is F(f, f) - F(f, i f)^2 / F(i f, i f), a Schur complement. `polynomial` and `rest` are F(f, f) and its remainder,
    `vectors` and `rho` the column f and its remainder; `sizes` are a bound of the negative eigenvalues of the form, its size, and
    its rounding error.
    """
    negative, square, rounding = sizes
    n = unknowns(vectors)
    across, beside = times_i(vectors), np.abs(times_i(rho))
    over, applied = np.abs(across @ form).sum(axis=1), np.abs(vectors @ form).sum(axis=1)
    beyond = (_lengths(across[:, 1 + n :]).sum(axis=1) + _lengths(rho)) ** 2
    constant, linear, quadratic, third = _products(across, across @ form)
    loss = third + (2.0 * beside * over).sum(axis=1) + negative * beyond
    least = quadratic_bound(constant, linear, quadratic, loss * (1.0 + SLACK) + rounding + TINY)
    constant, linear, quadratic, third = _products(vectors, across @ form)
    inexact = third + (rho * over + beside * applied).sum(axis=1) + square * beyond + np.abs(quadratic).sum(axis=1)
    inexact = inexact * (1.0 + SLACK) + rounding + TINY
    total = np.abs(constant) + np.abs(linear).sum(axis=1)
    with np.errstate(all="ignore"):
        share = np.where(least > 0.0, (1.0 + SLACK) / least, np.inf)
        polynomial[0] -= share * constant * constant
        polynomial[1] -= (2.0 * share * constant)[:, None] * linear
        for k, (i, j) in enumerate(pairs(n)):
            polynomial[2][:, k] -= share * linear[:, i] * linear[:, j] * (1.0 if i == j else 2.0)
        rest += share * (inexact * (2.0 * total + inexact) * (1.0 + SLACK) + 64.0 * UNIT * total * total)
    bad = ~(least > 0.0) | ~np.isfinite(rest)
    rest[bad] = np.inf
    for part in polynomial[:3]:
        part[bad] = 0.0
