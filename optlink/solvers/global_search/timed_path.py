"""Lower bounds of timed path synthesis of a four-bar: the best linear variables in closed form, boxes of the proportions.

As complex numbers the points of the coupler are P_j = A + z exp(i t_j) + w u_j, with A the crank pivot, z the crank, u_j the
direction of the coupler and w the coupler point in it. A, z and w are linear, so the least sum of squares over them is known, and
only three proportions and the start angle are divided into boxes. With frame d, crank a, q = a exp(i theta) - d and Q = |q|^2 the
coupler of length b and the rocker of length c satisfy

    2 b u = f (b + c) - q,    f = (nu + i sqrt((Q - nu^2) (1 - Q / (b + c)^2))) / conj(q),    nu = c - b.

The crank turns fully if nu^2 <= (a - d)^2 and (b + c)^2 >= (a + d)^2, so the unknowns are angles: a : d = cos eta : sin eta,
nu = (a - d) sin omega, cos chi = (a + d) / (b + c). They contain every four-bar, up to infinitely long links. Where pivot and
direction are free the columns q and exp(i t_j) are the same, f replaces u, and the change of sign of the root is that of omega
(Roberts' cognate with coupler and rocker interchanged); otherwise cos omega < 0 stands for the other assembly mode.

The fit is bounded by `column_fit`. Positions where the root has a corner in the box, or whose model is poor, are left out:
the sum of squares only becomes smaller.

References
----------
J. M. McCarthy and G. S. Soh, Geometric Design of Linkages, 2nd ed., Springer 2011 (cognates of a four-bar).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from optlink.linkage.fourbar import InnerFourBar
from optlink.linkage.vector2d import TURN, Array, finite_or
from optlink.optimization.taylor_model import TINY, UNIT, UPWARD, TaylorModel, pairs
from optlink.optimization.terms import transmission_sides
from optlink.problem.design import DesignProblem
from optlink.problem.mechanism import sizes_of
from optlink.problem.requirements.base import START
from optlink.solvers.global_search.lagrangian import OPEN, TESTS, BoxRecord, quadratic_bound

# Lower bounds of a linear least-squares fit of complex points with one column that is known over a box only.
#
# The residuals are P - F y - w f: points P, known columns F with real unknowns y, and a column f with a complex unknown w. With
# h the part of f, and p that of P, that no y can produce, the least sum of squares is |p|^2 - |<h, p>|^2 / |h|^2. It is at least
# L if (|p|^2 - L) |h|^2 - |<h, p>|^2 >= 0: a quadratic form of f, which is bounded over the box by the Taylor model of f. Where
# the known columns span no complex space, w is a real number times 1 + tau i, and the form is replaced by its least value over
# tau.
#
# Complex vectors are stored as N real parts followed by N imaginary parts.
#
# References
# ---------- G. H. Golub and V. Pereyra, The differentiation of pseudo-inverses and nonlinear least squares problems whose
# variables separate, SIAM J. Numer. Anal. 10 (1973) 413-432.

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
        value = finite_or(value, np.inf)
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


Mask = NDArray[np.bool_]

WIDE = 0.126  # share of the bounds beyond which a box is halved along its widest unknown
OMEGA = 1  # index of omega


@dataclass(frozen=True)
class FourBarUnknowns:
    """The quantities of a timed path of a four-bar, however it is written.

    `pivots`: names of the coordinates of the crank pivot, none in the origin; `direction`: name of the direction of the frame;
    `mark`: names of those of the coupler point. `frame`: bounds of the length of the frame [m]; `relative`: range of the crank
    angle from the frame [rad] at the start; `absolute`: that angle in the plane, None if a design variable changes it.
    """

    loop: InnerFourBar
    pivots: tuple[str, ...]
    direction: str
    mark: tuple[str, str]
    frame: tuple[float, float]
    relative: tuple[float, float]
    absolute: float | None

    @classmethod
    def of(cls, problem: DesignProblem) -> Self:
        """Return those of a problem.

        Raises
        ------
        ValueError
            if it has none.
        """
        loop, quantities, linkage = problem.four_bar, problem.quantities, problem.linkage
        mark = None if loop is None else linkage.marks.get((loop.coupler.body, problem.point))
        if loop is None:
            raise ValueError("the mechanism is not a four-bar")
        if mark is None or loop.coupler.start != loop.pin:
            raise ValueError(f"{problem.point} is not a point of the coupler that is measured from the crank")
        names = (*loop.names, *((loop.frame_length,) if loop.frame_length else ()), str(mark.along), str(mark.across))
        fixed = [name for name in names if name not in problem.free]
        if not loop.frame_length and not set(loop.ground) & set(problem.free):
            fixed.append("the frame")
        if fixed:
            raise ValueError(f"{fixed[0]} is fixed")
        frame, limit = problem.frame_bounds, problem.limits.frame_length
        if limit is not None:
            frame = max(frame[0], limit.bounds[0]), min(frame[1], limit.bounds[1])
        start = quantities[START].bounds if START in quantities else (0.0, 0.0)
        by_length, angle = bool(loop.frame_length), problem.frame_angle
        direction = linkage.datum if isinstance(linkage.datum, str) else ""
        turning = START in problem.free or direction in problem.free
        relative = start if by_length else (-math.pi, math.pi) if angle is None else (start[0] - angle, start[1] - angle)
        return cls(
            loop=loop,
            pivots=loop.ground[:2] if len(loop.ground) == 4 else (),
            direction=direction,
            mark=(str(mark.along), str(mark.across)),
            frame=frame,
            relative=relative,
            absolute=None if turning else start[0] + (quantities[direction].value if direction else 0.0),
        )

    def values(self, lengths: Sequence[float], pivot: Sequence[float], direction: float, arm: complex) -> dict[str, float]:
        """Return the quantities of a four-bar with a pivot [m], frame at an angle [rad] and coupler point [m]."""
        x, y = pivot
        values = dict(zip((*self.loop.names, self.loop.frame_length), lengths, strict=True))
        values |= dict(zip(self.mark, (float(arm.real), float(arm.imag)), strict=True)) | dict(
            zip(self.pivots, pivot, strict=False)
        )
        if self.direction:
            values[self.direction] = direction
        if not self.loop.frame_length:
            values[self.loop.ground[2]] = x + lengths[3] * math.cos(direction)
            values[self.loop.ground[3]] = y + lengths[3] * math.sin(direction)
        return {name: value for name, value in values.items() if name}


def unsuitable(problem: DesignProblem) -> str:
    """Return why a problem is not one that `TimedPathBounds` can bound; empty if it is."""
    if problem.four_bar is None:
        return "the mechanism is not a four-bar"
    if problem.requirement.kind != "path" or problem.data.offsets is None:
        return "the crank angles of the points are not prescribed"
    if problem.measure == "max":
        return 'the measure "max" is not a sum of squares'
    if problem.links:
        return "dimensions are linked"
    if problem.limits.crank == "span":
        return "the crank need not turn fully"
    if problem.mechanism.follows:
        return "the assembly mode continues through change points"
    try:
        FourBarUnknowns.of(problem)
    except ValueError as error:
        return str(error)
    return ""


class TimedPathBounds:
    """Lower bounds of the sum of squared distances [m^2] over boxes of eta, omega, chi, and the start angle where it is free.

    Lengths, coordinates and limits other than the frame's, `link_ratio` of the crank and transmission angles are left out: the
    bounds hold for more four-bars than the problem permits.

    Raises
    ------
    ValueError
        where `unsuitable` returns a reason.
    """

    def __init__(self, problem: DesignProblem) -> None:
        reason = unsuitable(problem)
        if reason:
            raise ValueError(reason)
        self.problem, data, free = problem, problem.data, set(problem.free)
        self.unknowns, quantities = FourBarUnknowns.of(problem), problem.quantities
        low, high = self.unknowns.relative
        self.start, self.started = low, low < high  # crank angle from the frame, and whether it is an unknown
        assert data.offsets is not None
        self.t, self.roots = data.offsets, data.roots
        self.turned = self.unknowns.absolute is None  # the crank column has a complex factor
        self.open = len(problem.mechanism.variants(problem.linkage)) > 1  # both assembly modes
        unknown_pivots = [name in free for name in self.unknowns.pivots] or [False, False]
        self.reduced = self.turned and all(unknown_pivots)  # f replaces u
        whole = self.turned and unknown_pivots[0] == unknown_pivots[1]
        self.unit = problem.size
        self.area = self.unit**2 / (len(self.t) if problem.measure == "rms" else 1)  # objective (rms: squared) of the sum 1
        pivots = zip(self.unknowns.pivots, problem.centre, strict=False)
        base = complex(*(c if name in free else quantities[name].value for name, c in pivots))
        targets = data.columns[:, 0] + 1j * data.columns[:, 1]
        self.points = (targets - base) / self.unit
        ones = np.ones(len(self.t), dtype=complex)
        crank = np.exp(1j * self.t) if self.turned else np.exp(1j * (self.t + (self.unknowns.absolute or 0.0)))
        columns = [factor * ones for factor, use in zip((1.0, 1j), unknown_pivots, strict=True) if use]
        self.columns: Complex = np.array([*columns, crank, 1j * crank] if self.turned else [*columns, crank], dtype=complex)
        self.low, self.high = self._ranges()
        rounding = 16.0 * len(self.t) * UNIT * float(np.max(self.roots) * np.max(np.abs(targets) + abs(base))) / self.unit
        weighted: Complex = self.columns * self.roots
        self.fit = ColumnFit(self.points * self.roots, weighted, whole=whole, size=self._largest(free), rounding=rounding)

    def _largest(self, free: set[str]) -> float:
        """Return a bound of the pivot and the crank, as parts of the column f too, in terms of the size of the curve."""
        quantities, known, ratio = self.problem.quantities, self.unknowns, self.problem.limits.link_ratio
        crank, coupler, _ = known.loop.names
        arm = math.hypot(*(max(abs(b) for b in quantities[name].bounds) for name in known.mark))
        longest = max(quantities[crank].bounds[1], known.frame[1])
        stretch = longest / quantities[coupler].bounds[0]  # of crank and frame over the coupler
        if ratio is not None and ratio.low is not None and ratio.low > 0.0 and ratio.high is not None:
            stretch = min(stretch, max(1.0, ratio.high) / ratio.low)
        base = sum(max(abs(b) for b in quantities[name].bounds) for name in known.pivots if name in free)
        return 1.001 * (base + math.hypot(*self.problem.centre) + longest + arm * (1.0 + stretch)) / self.unit

    # --- the fixed parts ------------------------------------------------------------------------------------------

    def _ranges(self) -> tuple[Array, Array]:
        """Return the bounds of the unknowns."""
        known, ratio = self.unknowns, self.problem.limits.link_ratio
        (a_low, a_high), (d_low, d_high) = self.problem.quantities[known.loop.names[0]].bounds, known.frame
        least, most = a_low / d_high, a_high / d_low if d_low > 0.0 else math.inf  # crank to frame
        if ratio is not None:
            least = max(least, -math.inf if ratio.low is None else ratio.low)
            most = min(most, math.inf if ratio.high is None else ratio.high)
        eta = math.atan(1.0 / most) * (1.0 - SLACK), min(math.atan(1.0 / least) * (1.0 + SLACK), 0.5 * math.pi)
        left = known.loop.side > 0
        omega = [-0.5 * math.pi * (1.0 + SLACK), 0.5 * math.pi * (1.0 + SLACK)]
        if not self.reduced and (self.open or left):
            omega[1] = 1.5 * math.pi * (1.0 + SLACK)
        if not self.reduced and left and not self.open:
            omega[0] = 0.5 * math.pi * (1.0 - SLACK)
        chi = (0.0, 0.5 * math.pi * (1.0 + SLACK))
        ranges = [eta, (omega[0], omega[1]), chi]
        if self.started:
            low, high = known.relative
            ranges.append((low, min(high, low + 2.0 * math.pi * (1.0 + SLACK))))
        low, high = np.array(ranges).T
        return low.copy(), high.copy()

    def left(self, point: Array) -> bool:
        """Return whether the four-bar at a point has the left assembly mode."""
        return self.unknowns.loop.side > 0 and not self.open if self.reduced else math.cos(point[OMEGA]) < 0.0

    def design(self, point: Array) -> dict[str, float]:
        """Return the four-bar at a point with the best linear variables: every quantity [m, rad], not within its bounds.

        Lengths are negative where the crank would have to point the other way.
        """
        a, d = math.cos(point[0]), math.sin(point[0])
        nu, total = (a - d) * math.sin(point[1]), (a + d) / max(math.cos(point[2]), 1e-6)
        start = float(point[3]) if len(point) > 3 else self.start
        left = self.left(point)
        nu = -nu if self.reduced and left else nu
        b, c = 0.5 * (total - nu), 0.5 * (total + nu)
        q = a * np.exp(1j * (self.t + start)) - d
        square = np.abs(q) ** 2
        root = np.sqrt(np.maximum((square - nu * nu) * (total * total - square), 0.0)) * (-1.0 if left else 1.0)
        u = ((nu * total + 1j * root) / np.conj(q) - q) / (2.0 * b)
        columns = as_real(np.array([*self.columns, u, 1j * u]) * self.roots)
        linear = np.linalg.lstsq(columns.T, as_real((self.points * self.roots)[None])[0], rcond=None)[0]
        crank = complex(linear[-4], linear[-3]) if self.turned else complex(linear[-3], 0.0)
        problem, known, size = self.problem, self.unknowns, (abs(crank) if self.turned else crank.real) / a * self.unit
        values = sizes_of(problem.quantities)
        pivot = [values[name] for name in known.pivots] or [0.0, 0.0]
        places = [k for k, name in enumerate(known.pivots) if name in problem.free]
        for k, x in zip(places, linear, strict=False):
            pivot[k] = float(problem.centre[k] + self.unit * x)
        absolute = known.absolute if known.absolute is not None else float(np.angle(crank))
        if known.absolute is None and START in problem.free and known.direction and known.direction not in problem.free:
            direction = values[known.direction]
        elif known.absolute is None and problem.frame_angle is not None and not known.direction:
            direction = problem.frame_angle
        else:
            direction = math.remainder(absolute - start, TURN)
        if START in problem.free:
            values[START] = start if known.loop.frame_length else math.remainder(start + direction, TURN)
        arm = complex(linear[-2], linear[-1]) * np.exp(-1j * direction) * self.unit
        return values | known.values((size * a, size * b, size * c, size * d), pivot, direction, arm)

    # --- boxes ----------------------------------------------------------------------------------------------------

    def columns_over(self, low: Array, high: Array) -> tuple[Array, Array, Mask, Mask]:
        """Return the column of w over boxes, and the slacks of the transmission limits.

        Returns
        -------
        coefficients : array (boxes, 1 + n + n (n + 1) / 2, 2 N)
            Of real parts and imaginary parts, weighted.
        remainder : array (boxes, 2 N)
        corner : array of bool (boxes,)
            Whether a model is only an interval.
        violated : array of bool (boxes,)
            Whether no design of the box has the required transmission angles.
        """
        with np.errstate(all="ignore"):
            unknowns = TaylorModel.unknowns(low, high)
            eta, omega, chi, *others = unknowns
            start: Any = others[0] if others else TaylorModel.constant(np.full((len(low), 1), self.start), low.shape[1])
            a, d = np.cos(eta), np.sin(eta)
            sin_omega, cos_omega, sin_chi, cos_chi = np.sin(omega), np.cos(omega), np.sin(chi), np.cos(chi)
            nu = (a - d) * sin_omega
            fold = (a - d) * cos_omega
            short = cos_chi / (a + d)  # 1 / (b + c)
            product = 4.0 * (a * d)
            half = 0.5 * (start + self.t)
            s, c = np.sin(half), np.cos(half)
            ss, cc = s * s, c * c
            near = product * ss + fold * fold  # Q - nu^2
            far = sin_chi * sin_chi + (product * (short * short)) * cc  # 1 - Q / (b + c)^2
            root, corner = _root(near * far)
            if not self.reduced:  # the other assembly mode
                middle = 0.5 * (low[:, OMEGA] + high[:, OMEGA])
                root = root * np.where(np.cos(middle) >= 0.0, 1.0, -1.0)[:, None]
            cos, sin = cc - ss, 2.0 * (s * c)
            x, y = a * cos - d, a * sin
            inverse = 1.0 / ((a - d) * (a - d) + product * ss)
            re, im = (nu * x - root * y) * inverse, (nu * y + root * x) * inverse
            if not self.reduced:
                re, im = re - short * x, im - short * y
            violated = self._violated(a, d, sin_omega, cos_chi)
        n = low.shape[1]
        coefficients = np.zeros((len(low), 1 + n + len(pairs(n)), 2 * len(self.t)))
        remainder = np.zeros((len(low), 2 * len(self.t)))
        limit = (1.0 if self.reduced else 2.0) * (1.0 + SLACK)  # of the size of the column
        for k, part in enumerate((re, im)):
            span = slice(k * len(self.t), (k + 1) * len(self.t))
            poor = ~(part.remainder < limit)
            block = np.where(poor, 0.0, part.coefficients) * self.roots
            coefficients[:, :, span] = np.moveaxis(block, 0, 1)
            remainder[:, span] = np.where(poor, limit, part.remainder) * self.roots * UPWARD
            corner = corner | poor
        straddles = np.zeros(len(low), dtype=bool)
        if not self.reduced and self.high[OMEGA] - self.low[OMEGA] > 4.0:  # both modes
            straddles = (low[:, OMEGA] < 0.5 * math.pi - 1e-9) & (high[:, OMEGA] > 0.5 * math.pi + 1e-9)
            remainder[straddles] = 2.0 * limit * float(np.max(self.roots))
            coefficients[straddles] = 0.0
        return coefficients, remainder, np.any(corner, axis=1) | straddles, violated

    def _violated(self, a: TaylorModel, d: TaylorModel, sin_omega: TaylorModel, cos_chi: TaylorModel) -> Mask:
        """Return whether a transmission limit over the revolution, or the alignment, is violated everywhere in a box."""
        far, near, square = (a + d) * (a + d), (a - d) * (a - d), cos_chi * cos_chi
        fold = near * (sin_omega * sin_omega) * square
        violated = np.zeros(a.remainder.shape, dtype=bool)
        for limit in transmission_sides(self.problem, self.unknowns.loop.joint):
            if limit.over != "revolution":
                continue
            if math.isfinite(limit.high):
                violated |= (limit.high * (far - fold) - (far + fold) + 2.0 * (near * square)).high < 0.0
            if math.isfinite(limit.low):
                violated |= ((far + fold) - 2.0 * (far * square) - limit.low * (far - fold)).high < 0.0
        return violated[:, 0]

    def bounded(self, low: Array, high: Array, threshold: float) -> BoxRecord:
        """Bound a batch of boxes; those whose lower bound is not below the threshold [m^2] are discarded."""
        boxes = len(low)
        coefficients, remainder, corner, violated = self.columns_over(low, high)
        has_threshold, fit = math.isfinite(threshold), self.fit
        level = threshold / self.area * (1.0 + SLACK) if has_threshold else 0.0
        none = np.zeros(boxes, dtype=np.intp)
        bound, size, value, worst = fit.bounds(coefficients, remainder, none, level)
        left = np.flatnonzero((bound < level) & ~violated) if has_threshold else none[:0]
        dropped, worst = np.zeros((left.size, 0), dtype=np.intp), worst[left]
        for _ in range(fit.largest):  # leave out one more position
            if not left.size:
                break
            dropped = np.sort(np.concatenate([dropped, worst[:, None]], axis=1), axis=1)
            chosen = np.array([fit.index[tuple(row)] for row in dropped.tolist()], dtype=np.intp)
            other, _, _, worst = fit.bounds(coefficients[left], remainder[left], chosen, level)
            bound[left] = np.maximum(bound[left], other)
            go = other < level
            left, dropped, worst = left[go], dropped[go], worst[go]
        proven = (bound >= level) & has_threshold
        test = np.where(violated, TESTS.index("limits"), np.where(proven, TESTS.index("objective"), OPEN)).astype(np.int8)
        bound = np.where(proven, threshold, bound * self.area * (1.0 - SLACK) if has_threshold else 0.0)
        width = (high - low) / (self.high - self.low)
        # of what counts, and of the model itself, with which its remainder grows
        change = changes(size) * changes(np.sqrt(np.sum(coefficients * coefficients, axis=2)))
        split = np.where(np.max(width, axis=1) > WIDE, np.argmax(width, axis=1), np.argmax(change, axis=1))
        centre = np.where(corner | violated, np.inf, value * self.area)
        return BoxRecord(bound, test, np.zeros((boxes, 0)), split, centre, low.copy(), high.copy())


def _root(x: TaylorModel) -> tuple[TaylorModel, Mask]:
    """Return the square root, as an interval where its argument is not positive in the whole box, and where that is."""
    root = np.sqrt(x)
    corner = ~np.isfinite(root.remainder)
    if np.any(corner):
        low, high = np.sqrt(np.maximum(x.low, 0.0)), np.sqrt(np.maximum(x.high, 0.0))
        coefficients = np.where(corner, 0.0, root.coefficients)
        coefficients[0] = np.where(corner, 0.5 * (low + high), coefficients[0])
        root = TaylorModel(coefficients, np.where(corner, 0.5 * (high - low) + SLACK * high + TINY, root.remainder), x.count)
    return root, corner
