"""Certify the least largest error of a four-bar function generator: a lower bound over all linkages within bounds and limits."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from optlink.execution import interrupts
from optlink.linkage.fourbar import InnerFourBar
from optlink.linkage.vector2d import TURN, Array, finite_or, max_magnitude, wrapped
from optlink.optimization.taylor_model import UNIT
from optlink.problem.design import DesignProblem
from optlink.problem.targets.law import Function
from optlink.solvers.global_search.branch_and_bound import Boxes, BranchAndBound
from optlink.solvers.global_search.lagrangian import OPEN, BoxRecord, quadratic_bound

# Lower bounds of the largest output error of a four-bar function generator over boxes of start angles, by Farkas multipliers.
#
# With the frame as the unit of length, the constants K1 = 1/crank, K2 = 1/rocker, K3 and
#
#     F(x, y) = K1 cos(psi0 + y) - K2 cos(phi0 + x) + K3 - cos(phi0 - psi0 + x - y)
#
# (Freudenstein; F = 0 closes the loop), the output error of a linkage with the assembly mode s = +1 or -1 stays within t only if
#
#     s F(x_i, y_i - t) >= 0 >= s F(x_i, y_i + t)    at every position x_i.                                                (1)
#
# Proof: as a function of the output angle psi, F = R (cos(psi - theta) - cos alpha), where theta is the direction from crank pin
# to rocker pivot, R = K1 times their distance, and psi = theta + s alpha the output. With an error e, |e| <= t, the left side is
# s R (cos(alpha - s (e + t)) - cos alpha), 0 <= e + t <= 2 t: not negative if t <= alpha <= pi - t; likewise the right side.
# Nearer to a dead position, s F falls short by at most 2 R sin(t)^2 <= 2 (1 + K1) sin(t)^2. As sin(alpha) = coupler sin(gamma) /
# distance and distance <= coupler + rocker, 1 + crank, only long cranks and rockers come so near: they are searched apart, with
# the rows relaxed by that much (`near_dead`); their coupler is at most (1 + crank) sin(t) / sin(least gamma).
#
# The length b and the transmission angle gamma of the coupler are, in any position of the linkage and for every angle omega,
#
#     V = K1 cos(psi - s omega) + (K1 / K2) cos(omega) - cos(phi - psi + s omega) = (b / crank) cos(gamma - omega).        (2)
#
# Limits of gamma are V <= 0 at omega = gamma_low - pi/2 and gamma_high + pi/2; the longest coupler is V <= b_high K1 for every
# omega; the shortest one gives V >= b_low sin(gamma) K1 at omega = pi/2. At the prescribed instead of the actual output, V +
# kappa F differs by at most t times its largest slope, for any kappa (F = 0 at the actual output); the kappa with the least
# slope is taken.
#
# A box of (phi0, psi0, K1, K2) holds no linkage with an error within t if multipliers lambda >= 0 of these rows exist with sum
# lambda_i row_i < 0 everywhere in it (Farkas). The sum is linear in K1, K2, K3 and a sinusoid in each of phi0, psi0 and phi0 -
# psi0, so its maximum over the box follows from a second-order expansion with a bound of the third derivative. The multipliers
# come from the linear programme of the least violation at the centre, in which the products K1 (psi0 - centre), K2 (phi0 -
# centre) and K1 = (K1/K2) K2 are unknowns of their own within their envelopes; they need not be exact.
#
# References
# ---------- F. Freudenstein, Approximate synthesis of four-bar linkages, Trans. ASME 77 (1955) 853-861. G. P. McCormick,
# Computability of global solutions to factorable nonconvex programs I, Mathematical Programming 10 (1976) 147-175 (envelopes).

Complex = NDArray[np.complex128]

STEEPEST = 5.0  # largest |kappa|
ANGLES = 4  # angles omega of the rows of the longest coupler
FIELDS = ("output", "crank", "both", "k0", "k1", "k2", "k3", "ratio")
GRASHOF = {
    "span": (),
    "full rotation": ((1.0, 1.0, -1.0, -1.0), (-1.0, 1.0, 1.0, -1.0), (-1.0, 1.0, -1.0, 1.0), (0.0, 1.0, -1.0, 0.0)),
    "double-crank": ((1.0, 1.0, -1.0, -1.0), (1.0, -1.0, 1.0, -1.0), (1.0, -1.0, -1.0, 1.0)),
}
"""Rows (1, K1, K2, K3) of Grashof's conditions, not negative: each compares the squared coupler with the square of the sum or
difference of the three other lengths, both divided by 2 * crank * rocker; the last one of a crank-rocker is crank <= rocker."""


@dataclass(frozen=True)
class LinkageSet:
    """The linkages searched: one assembly mode and ranges of lengths over the frame.

    `low` and `high` bound phi0, psi0 [rad], K1 and K2; `coupler` has the least and largest coupler, `transmission` the same of
    the transmission angle [rad] over the span; `grashof` is a key of `GRASHOF`. `near_dead`: they may come nearer to a dead
    position than the error; `share` is the largest coupler over the sum of frame and crank of those that do.
    """

    side: int
    low: Array
    high: Array
    coupler: tuple[float, float]
    transmission: tuple[float, float]
    grashof: str = "span"
    near_dead: bool = False
    share: float = math.inf

    @property
    def least_sine(self) -> float:
        """Least sine of the transmission angle."""
        return min(math.sin(angle) for angle in self.transmission)

    def dead_part(self, error: float) -> LinkageSet | None:
        """Return the linkages that may come nearer to a dead position than an error [rad]; None if there are none."""
        share = math.sin(error) / self.least_sine  # coupler over distance, at most, in such a position
        distance = self.coupler[0] / share
        if error >= min(self.transmission[0], math.pi - self.transmission[1]) or share >= 1.0:
            return replace(self, near_dead=True)
        crank, rocker = distance - 1.0, distance * (1.0 - share)
        most = [1.0 / size if size > 0.0 else math.inf for size in (crank, rocker)]
        high = np.minimum(self.high, [math.inf, math.inf, most[0] * (1.0 + 1e-9), most[1] * (1.0 + 1e-9)])
        part = replace(self, high=high, near_dead=True, share=share * (1.0 + 1e-12))
        return part if np.all(high >= self.low) else None


@dataclass(frozen=True)
class Rows:
    """Rows that no wanted linkage makes negative, each array (boxes or 1, rows).

    Row = K1 (Re(output e^(i psi0)) + k1) + K2 (Re(crank e^(i phi0)) + k2) + K3 k3 + (K1 / K2) ratio
    + Re(both e^(i (phi0 - psi0))) + k0.
    """

    output: Complex
    crank: Complex
    both: Complex
    k0: Array
    k1: Array
    k2: Array
    k3: Array
    ratio: Array

    @staticmethod
    def joined(parts: list[Rows], boxes: int) -> Rows:
        """Return all rows of several sets."""

        def whole(name: str) -> Any:
            arrays = [getattr(part, name) for part in parts]
            return np.concatenate([np.broadcast_to(a, (boxes, a.shape[1])) for a in arrays], axis=1)

        return Rows(*(whole(name) for name in FIELDS))


def loop_rows(linkages: LinkageSet, x: Array, y: Array, t: float) -> Rows:
    """Return the rows (1) of an output error t at input and prescribed output rotations x and y (n,), all in rad."""
    signs = np.repeat([linkages.side, -linkages.side], x.size)[None]
    x, y = np.tile(x, 2)[None], np.concatenate([y - t, y + t])[None]
    short = np.full(x.shape, 2.0 * math.sin(t) ** 2 if linkages.near_dead else 0.0)
    zero = np.zeros(x.shape)
    return Rows(
        signs * unit_vector(y), -signs * unit_vector(x), -signs * unit_vector(x - y), short, short, zero, signs + zero, zero
    )


def grashof_rows(linkages: LinkageSet) -> Rows:
    """Return the rows of Grashof's conditions."""
    k0, k1, k2, k3 = np.array(GRASHOF[linkages.grashof], dtype=float).reshape(-1, 4).T[:, None]
    zero = np.zeros(k0.shape)
    return Rows(zero + 0.0j, zero + 0.0j, zero + 0.0j, k0, k1, k2, k3, zero)


def coupler_rows(linkages: LinkageSet, x: Array, y: Array, t: float, low: Array, high: Array) -> list[Rows]:
    """Return the rows (2) of the limits of transmission angle and coupler, relaxed so that they hold in the whole of each box.

    x, y and t: as in `loop_rows`, the ends of the span first and last.
    """
    ends, (least, most), right = linkages.transmission, linkages.coupler, 0.5 * math.pi
    row, two = _CouplerRow(linkages.side, t, low, high), [0, -1]
    rows = [row(x, y, -1.0, right, least * linkages.least_sine)]
    for omega in (ends[0] - right, ends[1] + right):
        rows += [row(x, y, 1.0, omega, 0.0, shift) for shift in (-t, 0.0, t)]
    for omega in np.linspace(*ends, ANGLES):
        rows.append(row(x[two], y[two], 1.0, float(omega), -most))
        if math.isfinite(linkages.share):
            rows.append(row(x, y, 1.0, float(omega), -linkages.share, constant=linkages.share))
    return rows


@dataclass(frozen=True)
class _CouplerRow:
    side: int
    t: float
    low: Array
    high: Array

    def __call__(
        self, x: Array, y: Array, sign: float, omega: float, share: float, shift: float = 0.0, constant: float = 0.0
    ) -> Rows:
        """Return the rows constant - (sign V + kappa F + share K1) + relaxation >= 0 at outputs `shift` off the prescribed ones.

        F = 0 and sign V + share K1 <= constant at the actual output, which is at most d = t + |shift| away. So the relaxation is
        d times the largest slope of sign V + kappa F, plus d^2 / 2 times its largest curvature downwards.
        """
        x, y, turn, away = x[None], y[None] + shift, self.side * omega, self.t + abs(shift)
        centre, radius = 0.5 * (self.low + self.high)[:, :, None], 0.5 * (self.high - self.low)[:, :, None]
        psi, phi, k1, most = unit_vector(centre[:, 1]), unit_vector(centre[:, 0]), centre[:, 2], self.high[:, 2, None]
        across = phi * np.conj(psi)

        def slope(output: Complex, both: Complex) -> Array:
            return -k1 * np.imag(output * psi) + np.imag(both * across)

        v = sign * unit_vector(y - turn), -sign * unit_vector(x - y + turn)
        f = unit_vector(y), -unit_vector(x - y)
        with np.errstate(divide="ignore", invalid="ignore"):
            kappa = np.nan_to_num(np.clip(-slope(*v) / slope(*f), -STEEPEST, STEEPEST))
        output, both = v[0] + kappa * f[0], v[1] + kappa * f[1]
        turned = most * np.abs(output) * radius[:, 1] + np.abs(both) * (radius[:, 0] + radius[:, 1])
        steepest = np.abs(slope(output, both)) + np.abs(np.imag(output * psi)) * radius[:, 2] + turned
        curved = k1 * np.real(output * psi) + np.real(both * across) + np.abs(np.real(output * psi)) * radius[:, 2] + turned
        curved = np.maximum(0.0, curved + (most * np.abs(output) + np.abs(both)) * away)
        room = constant + (away * steepest + 0.5 * away * away * curved) * (1.0 + 1e-12)
        zero = np.zeros(kappa.shape)
        return Rows(-output, kappa * unit_vector(x), -both, room, zero - share, zero, -kappa, zero - sign * math.cos(omega))


def unit_vector(angle: Array) -> Complex:
    """Return e^(i angle)."""
    return np.asarray(np.exp(1j * angle))


def most_k3(high: Array) -> Array:
    """Return the largest |K3|: F = 0 in some position."""
    return (1.0 + high[:, 2] + high[:, 3]) * (1.0 + 1e-12)


def largest(rows: Rows, weights: Array, low: Array, high: Array) -> Array:
    """Return a rigorous upper bound (boxes,) of the sum of the rows over each box; negative weights (boxes, rows) are zero."""
    weights = np.maximum(weights, 0.0)
    centre, radius = 0.5 * (low + high), 0.5 * (high - low)
    output, crank, both, k0, k1, k2, k3, ratio = (np.sum(weights * getattr(rows, name), axis=1) for name in FIELDS)
    f, p, k1_high, k2_high, k3_high = radius[:, 0], radius[:, 1], high[:, 2], high[:, 3], most_k3(high)
    output, crank = output * unit_vector(centre[:, 1]), crank * unit_vector(centre[:, 0])
    both = both * unit_vector(centre[:, 0] - centre[:, 1])
    most, steepest = np.full(len(low), -np.inf), np.zeros(len(low))
    middle = np.sqrt(low[:, 3] * high[:, 3])
    for first in (low[:, 2], high[:, 2]):  # the sum is linear in K1, and convex or linear in K2: largest at a corner
        for second in (low[:, 3], high[:, 3]):
            tangent = first * (2.0 * middle - second) / (middle * middle)  # below K1 / K2, a convex function of K2
            quotient = np.where(ratio >= 0.0, first / second, tangent)
            value = first * (output.real + k1) + second * (crank.real + k2) + both.real + k0 + ratio * quotient
            linear = np.stack([-(second * crank.imag + both.imag) * f, -(first * output.imag - both.imag) * p], axis=1)
            curved = (second * crank.real + both.real) * f * f, both.real * f * p, (first * output.real + both.real) * p * p
            quadratic = np.stack([0.5 * curved[0], -curved[1], 0.5 * curved[2]], axis=1)
            most = np.maximum(most, -quadratic_bound(-value, -linear, quadratic, np.zeros(len(low))))
            steepest = np.maximum(steepest, np.abs(quotient))
    third = (k1_high * np.abs(output) * p**3 + k2_high * np.abs(crank) * f**3 + np.abs(both) * (f + p) ** 3) / 6.0
    factors = k1_high, k2_high, 1.0, 1.0, k1_high, k2_high, k3_high, steepest
    total = (1.0 + STEEPEST) * np.sum(weights, axis=1) * (1.0 + k1_high + k2_high + k3_high)  # of the sums within a coefficient
    for name, factor in zip(FIELDS, factors, strict=True):
        total = total + factor * np.sum(weights * np.abs(getattr(rows, name)), axis=1)
    rounding = (128.0 + 8.0 * weights.shape[1]) * UNIT * total
    return np.asarray(most + np.abs(k3) * k3_high + third * (1.0 + 1e-12) + rounding)


# Many small linear programmes at once, by an interior-point method (Mehrotra's predictor and corrector).

STEPS = 40  # iterations at most
ENOUGH = 1e-12  # sum of the duality gap and of the dual infeasibility at which a programme counts as solved
BACK = 0.99  # share of the way to the boundary
SINGULAR = 1e-11  # regularisation of the scaling of the unknowns, relative


def least_violation(matrix: Array, vector: Array, elastic: Array) -> tuple[Array, Array]:
    """Minimise tau subject to matrix @ z + tau * elastic >= vector; return z (boxes, n) and the multipliers (boxes, rows).

    `matrix` (boxes, rows, n), `vector` (boxes, rows), `elastic` (rows,): 1 for rows that tau relaxes, 0 for others. The results
    are not exact; the multipliers are not negative.
    """
    boxes, rows, n = matrix.shape
    square = np.matmul(np.swapaxes(matrix, 1, 2), matrix)
    size = np.maximum(np.sqrt(np.einsum("bii->bi", square)), 1e-9)
    square = square / size[:, :, None] / size[:, None, :] + SINGULAR * np.eye(n)
    straight = np.swapaxes(np.linalg.inv(np.linalg.cholesky(square)), 1, 2) / size[:, :, None]  # z = straight @ own unknowns
    g = np.concatenate([np.matmul(matrix, straight), np.broadcast_to(elastic[None, :, None], (boxes, rows, 1))], axis=2)
    gt = np.ascontiguousarray(np.swapaxes(g, 1, 2))
    cost, eye = np.append(np.zeros(n), 1.0), np.eye(n + 1)
    z = np.zeros((boxes, n + 1))
    z[:, -1] = np.max(np.maximum(vector, 0.0), axis=1) + 1.0
    slack = np.maximum(_times(g, z) - vector, 1e-3)
    dual = 1.0 / slack
    dual /= np.sum(dual * elastic, axis=1, keepdims=True)
    kept, kept_z, merit = dual.copy(), z.copy(), np.full(boxes, np.inf)
    with np.errstate(all="ignore"):
        for _ in range(STEPS):
            primal, stationarity = _times(g, z) - vector - slack, _times(gt, dual) - cost
            mean = np.mean(slack * dual, axis=1)
            now = mean * rows + np.sum(np.abs(stationarity), axis=1)
            better = now < merit
            kept[better], kept_z[better] = dual[better], z[better]
            merit = np.minimum(merit, now)
            if np.max(merit) < ENOUGH:
                break
            mean = np.maximum(mean, 1e-12)
            normal = np.matmul(gt * (dual / slack)[:, None, :], g)
            normal = normal + 1e-14 * np.einsum("bii->bi", normal)[:, :, None] * eye + 1e-300
            affine = slack * dual
            for corrector in (False, True):
                right = stationarity - _times(gt, (affine + dual * primal) / slack)
                try:
                    dz = np.linalg.solve(normal, right[..., None])[..., 0]
                except np.linalg.LinAlgError:
                    return _times(straight, kept_z[:, :-1]), kept
                ds = _times(g, dz) + primal
                dl = (-affine - dual * ds) / slack
                ahead, dual_ahead = _length(slack, ds), _length(dual, dl)
                if not corrector:
                    after = np.mean((slack + ahead * ds) * (dual + dual_ahead * dl), axis=1)
                    affine = affine + ds * dl - (np.minimum(1.0, after / mean) ** 3 * mean)[:, None]
            z = z + BACK * ahead * dz
            slack = np.maximum(slack + BACK * ahead * ds, 1e-14)
            dual = np.maximum(dual + BACK * dual_ahead * dl, 1e-14)
    return _times(straight, kept_z[:, :-1]), kept


def _times(matrices: Array, vectors: Array) -> Array:
    return np.asarray(np.matmul(matrices, vectors[..., None])[..., 0])


def _length(value: Array, change: Array) -> Array:
    """Return the share of a change, at most 1, up to which all values stay positive."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.minimum(1.0, np.min(np.where(change < 0.0, -value / change, np.inf), axis=1, keepdims=True)))


# Branch and bound of four-bar function generators: which boxes to discard, and where to divide.
#
# The rows and their proof are in `optlink.solvers.global_search.function_generator`; here multipliers, cuts and candidates are
# chosen.

Tested = tuple[Array, NDArray[np.intp], NDArray[np.bool_]]

PROVEN = 1  # index of the test "objective" of `lagrangian.TESTS`
PLACES = 7  # positions of the rows of the coupler at first
SLAB = 0.1  # least width of a slab of K1 or K2 that is cut off, of the logarithm
COARSE = 0.2  # rad; half width of the start angles from which K1 and K2 are cut and halved
SMALL = 1e-3  # rad; half width of the start angles of a box whose candidate may add a position to the rows
MOST_POSITIONS = 96
POSITION_SEPARATION = 0.2  # least distance of such a position from the others, in steps of the dense positions
LAW_ROUNDING = 1e-12  # rad; bounds the error of a prescribed output in floating point


@dataclass
class FunctionBounds:
    """Lower bounds of the largest output error over boxes of (phi0, psi0, K1, K2); a `Bounder` of `branch_and_bound`.

    `rise` is the prescribed output rotation [rad] at input rotations, `x` (n,) the input rotations of the rows. Candidates are
    judged at `dense` ones, evenly spaced; the worst of these join the rows. `candidate` is the best one of the last batch: phi0,
    psi0, K1, K2, K3.
    """

    linkages: LinkageSet
    rise: Callable[[Array], Array]
    x: Array
    dense: Array
    candidate: Array = field(default_factory=lambda: np.zeros(5))

    def __post_init__(self) -> None:
        self.low, self.high = self.linkages.low, self.linkages.high
        self.y, self.target = self.rise(self.x), self.rise(self.dense)
        self.places = np.linspace(float(self.dense[0]), float(self.dense[-1]), PLACES)

    def bounded(self, low: Array, high: Array, threshold: float) -> BoxRecord:
        """Discard the boxes of a batch that hold no linkage with an error below the threshold [rad]."""
        t = threshold + LAW_ROUNDING
        z, split, discarded = self._tested([], low, high, t)
        left = np.flatnonzero(~discarded)
        if left.size:  # with the limits of the coupler as well
            z[left], split[left], discarded[left] = self._with_coupler(low[left], high[left], t)
        inner = self._cut(low, high, z, ~discarded, t)
        points, errors = self._candidates(z, low, high, ~discarded)
        k = int(np.argmin(errors))
        self.candidate = points[k]
        test = np.where(discarded, PROVEN, OPEN).astype(np.int8)
        return BoxRecord(np.where(discarded, threshold, 0.0), test, np.zeros((len(low), 0)), split, errors, *inner)

    def _with_coupler(self, low: Array, high: Array, t: float) -> Tested:
        return self._tested(coupler_rows(self.linkages, self.places, self.rise(self.places), t, low, high), low, high, t)

    def _tested(self, further: list[Rows], low: Array, high: Array, t: float) -> Tested:
        """Return the solutions of the programmes with further rows, the unknowns to halve, and which boxes are discarded."""
        rows = Rows.joined([loop_rows(self.linkages, self.x, self.y, t), grashof_rows(self.linkages), *further], len(low))
        z, weights, split = _solved(rows, low, high)
        return z, split, largest(rows, weights, low, high) < 0.0

    def _cut(self, low: Array, high: Array, z: Array, target: NDArray[np.bool_], t: float) -> tuple[Array, Array]:
        """Return the boxes without slabs of K1 and K2, far from the solutions of the programmes, that hold no linkage."""
        low, high = low.copy(), high.copy()
        for k in (2, 3):
            near = np.clip(z[:, k - 2], low[:, k], high[:, k])
            small = target & (np.max(high[:, :2] - low[:, :2], axis=1) < 2.0 * COARSE)
            for corner in (low, high):
                end = np.sqrt(corner[:, k] * near)
                tried = np.flatnonzero(small & (np.abs(np.log(end / corner[:, k])) > SLAB))
                if not tried.size:
                    continue
                slab = [low[tried], high[tried]]
                slab[0 if corner is high else 1][:, k] = end[tried]
                discarded = tried[self._with_coupler(slab[0], slab[1], t)[2]]
                corner[discarded, k] = end[discarded]
        return low, high

    # --- candidates ------------------------------------------------------------------------------------------------

    def _candidates(self, z: Array, low: Array, high: Array, target: NDArray[np.bool_]) -> tuple[Array, Array]:
        """Return the linkages (boxes, 5) at the solutions of the programmes and their errors, infinite beyond the limits.

        The worst positions of those in small boxes join the rows.
        """
        radius = 0.5 * (high - low)
        points = np.concatenate([0.5 * (low + high)[:, :2] + np.clip(z[:, 5:7], -1.0, 1.0) * radius[:, :2], z[:, :3]], axis=1)
        points[:, 2:4] = np.clip(points[:, 2:4], low[:, 2:], high[:, 2:])
        errors = np.full(len(low), np.inf)
        if not np.any(target):
            return points, errors
        deviations, gamma, coupler = followed(points[target], self.linkages.side, self.dense, self.target)
        deviations = np.abs(deviations)
        size = np.max(deviations, axis=1)
        least, most = self.linkages.coupler
        ends = self.linkages.transmission
        fits = (coupler >= least) & (coupler <= most) & (np.min(gamma, axis=1) >= ends[0]) & (np.max(gamma, axis=1) <= ends[1])
        errors[target] = np.where(fits & np.isfinite(size), size, np.inf)
        small = np.isfinite(size) & (np.max(radius[target, :2], axis=1) < SMALL)
        self.x = self._exchanged(self.x, deviations[small])
        self.y = self.rise(self.x)
        for beyond in (gamma - ends[1], ends[0] - gamma):
            self.places = self._exchanged(self.places, beyond[small & (np.max(beyond, axis=1) > 0.0)])
        return points, errors

    def _exchanged(self, errors: Array, sizes: Array) -> Array:
        """Add the positions of the largest values (m, dense positions), refined by parabolas, between the ends of those known."""
        k = np.argmax(sizes, axis=1)
        at = np.clip(k, 1, self.dense.size - 2)
        before, here, after = (sizes[np.arange(len(at)), at + i] for i in (-1, 0, 1))
        with np.errstate(divide="ignore", invalid="ignore"):
            shift = np.clip(np.nan_to_num(0.5 * (before - after) / (before - 2.0 * here + after)), -1.0, 1.0)
        step = self.dense[1] - self.dense[0]
        for x in np.unique(np.where(k == at, self.dense[at] + shift * step, self.dense[k])):
            if errors.size < MOST_POSITIONS and not np.any(np.abs(errors - x) < POSITION_SEPARATION * abs(step)):
                errors = np.insert(errors, 1, x)
        return errors


def followed(points: Array, side: int, x: Array, y: Array) -> tuple[Array, Array, Array]:
    """Return output errors and transmission angles (m, n) [rad] and couplers (m,) of linkages; NaN where one cannot be assembled.

    `points` (m, 5) are phi0, psi0 [rad], K1, K2, K3; x and y (n,) [rad] are input and prescribed output rotations.
    """
    phi0, psi0, k1, k2, k3 = (points[:, k, None] for k in range(5))
    crank, rocker, phi = 1.0 / k1, 1.0 / k2, phi0 + x
    with np.errstate(all="ignore"):
        coupler = np.sqrt(crank * crank + rocker * rocker + 1.0 - 2.0 * crank * rocker * k3)
        output = np.arctan2(-np.sin(phi), k1 - np.cos(phi)) + side * np.arccos(
            (k2 * np.cos(phi) - k3) / np.hypot(k1 - np.cos(phi), np.sin(phi))
        )
        square = crank * crank + 1.0 - 2.0 * crank * np.cos(phi)
        gamma = np.arccos((coupler * coupler + rocker * rocker - square) / (2.0 * coupler * rocker))
    return wrapped(output - psi0 - y), gamma, coupler[:, 0]


def _solved(rows: Rows, low: Array, high: Array) -> tuple[Array, Array, NDArray[np.intp]]:
    """Return the solutions of the programmes, the multipliers of the rows, and the unknown along which to halve each box."""
    centre, radius = 0.5 * (low + high), 0.5 * (high - low)
    psi, phi = unit_vector(centre[:, 1, None]), unit_vector(centre[:, 0, None])
    across = phi * np.conj(psi)
    output, crank, both = rows.output * psi, rows.crank * phi, rows.both * across
    columns = (
        output.real + rows.k1,
        crank.real + rows.k2,
        rows.k3,
        -output.imag * radius[:, 1, None],  # K1 (psi0 - centre) / radius
        -crank.imag * radius[:, 0, None],
        -both.imag * radius[:, 0, None],  # (phi0 - centre) / radius
        both.imag * radius[:, 1, None],
        rows.ratio,
    )
    extra, right = _envelopes(low, high)
    matrix = np.concatenate([np.stack(columns, axis=-1), extra], axis=1)
    vector = np.concatenate([-(both.real + rows.k0), right], axis=1)
    count = rows.k3.shape[1]
    elastic = np.concatenate([np.ones(count), np.zeros(extra.shape[1])])
    start = np.zeros((len(low), 8))
    start[:, :2] = centre[:, 2:]
    start[:, 7] = centre[:, 2] / centre[:, 3]
    z, dual = least_violation(matrix, vector - np.einsum("bmn,bn->bm", matrix, start), elastic)
    z = z + start
    weights = np.maximum(dual[:, :count], 0.0)
    weights = weights / np.sum(weights, axis=1, keepdims=True)
    price = [np.sum(dual[:, count + 4 * k : count + 4 * k + 4], axis=1) for k in range(3)]
    miss = [np.abs(z[:, 3] - z[:, 0] * z[:, 6]), np.abs(z[:, 4] - z[:, 1] * z[:, 5]), np.abs(z[:, 0] - z[:, 7] * z[:, 1])]
    angles, lengths = price[0] * miss[0] + price[1] * miss[1], price[2] * miss[2]
    widest = np.argmax(radius[:, :2], axis=1)
    longest = 2 + np.argmax(high[:, 2:] / low[:, 2:], axis=1)
    return z, weights, np.where((lengths > angles) & (radius[:, :2].max(axis=1) < COARSE), longest, widest)


def _envelopes(low: Array, high: Array) -> tuple[Array, Array]:
    """Return matrix and right side of the envelopes of the three products, four rows each, and of the bounds of K3."""
    (l1, l2), (h1, h2) = low[:, 2:].T, high[:, 2:].T
    a, b = l1 / h2, h1 / l2  # of the ratio K1 / K2
    envelopes: list[tuple[dict[int, Array | float], Array]] = []
    for k, product, angle, lo, hi in ((0, 3, 6, l1, h1), (1, 4, 5, l2, h2)):
        envelopes += [
            ({product: 1.0, k: 1.0, angle: -lo}, lo),
            ({product: 1.0, k: -1.0, angle: -hi}, -hi),
            ({product: -1.0, k: 1.0, angle: lo}, lo),
            ({product: -1.0, k: -1.0, angle: hi}, -hi),
        ]
    envelopes += [
        ({0: 1.0, 7: -l2, 1: -a}, -a * l2),
        ({0: 1.0, 7: -h2, 1: -b}, -b * h2),
        ({0: -1.0, 7: h2, 1: a}, a * h2),
        ({0: -1.0, 7: l2, 1: b}, b * l2),
    ]
    most = most_k3(high)
    envelopes += [({2: 1.0}, -most), ({2: -1.0}, -most)]
    matrix = np.zeros((len(low), len(envelopes), 8))
    for i, (row, _) in enumerate(envelopes):
        for j, value in row.items():
            matrix[:, i, j] = value
    size = np.max(np.abs(matrix), axis=2)
    return matrix / size[:, :, None], np.stack([right for _, right in envelopes], axis=1) / size


Improve = Callable[[dict[str, float], int], float]
"""Receives a design [m, rad] that seems better than the best known one, and its assembly mode (+1 or -1); returns the objective
of the valid design found from there."""

MOST = 0.25 * math.pi  # rad, error up to which the proof holds
LEVELS = (0.3, 0.05)  # gaps that are proven before the requested one, so that a search that is stopped has a bound
POSITIONS = 25  # of the rows before those at the peaks of the error
DENSE, FINE = 401, 20_001  # positions at which candidates are judged, and better designs
CANDIDATE_SEPARATION = (
    0.05  # rad, and of the logarithms of K1 and K2: a candidate so near to one that was tried is not tried again
)
WIDEN = 1e-9  # relative or absolute [rad] enlargement of bounds, which leaves no box without width
CLOSED, STOPPED, INTERRUPTED = "closed", "stopped", "interrupted"


def certify_function(
    problem: DesignProblem,
    best: float,
    design: Mapping[str, float] | None = None,
    gap: float = 1e-3,
    seconds: float = math.inf,
    boxes: float = math.inf,
    progress: Callable[[float, float], None] | None = None,
    improve: Improve | None = None,
) -> FunctionSearch:
    """Bound the largest error of all linkages from below, both assembly modes where the problem leaves them open.

    `best` [rad], below `MOST`, is the largest error of the best known `design`; the proof of a share `gap` of it is shorter with
    the positions of its largest errors. The bound reached within the limit of time [s] or boxes holds; Ctrl-C stops as well.
    `progress` receives the share of the start angles that is done at the present level, and the gap that is proven. `improve`
    receives a better design [m, rad] and returns the objective of the valid one found from it; by default its own error.
    """
    search = FunctionSearch(problem, best, None if design is None else dict(design), improve)
    search.run([level for level in LEVELS if level > gap] + [gap], seconds, boxes, progress)
    return search


def linkage_sets(problem: DesignProblem, error: float) -> list[LinkageSet]:
    """Return the linkages that a problem admits, those that come nearer to a dead position than an error [rad] apart."""
    loop, turned = problem.four_bar, problem.frame_angle
    assert loop is not None
    assert turned is not None
    ratios = [_ratio(problem, name) for name in loop.names]
    low, high = (np.zeros(4) for _ in range(2))
    for k, name in enumerate((problem.start_name, problem.base_name)):
        start, end = problem.quantities[name].bounds
        low[k], high[k] = start - turned - WIDEN, min(end, start + TURN) - turned + WIDEN
    for k, (least, most) in ((2, ratios[0]), (3, ratios[2])):
        low[k], high[k] = (1.0 - WIDEN) / most, (1.0 + WIDEN) / least
    if problem.limits.crank == "full rotation":  # the crank is the shortest link
        low[2] = max(low[2], 1.0)
    if problem.limits.crank == "double-crank":  # the frame is
        high[2:] = np.minimum(high[2:], 1.0)
    shortest = {"full rotation": (1.0 - WIDEN) / high[2], "double-crank": 1.0 - WIDEN}.get(problem.limits.crank, 0.0)
    high[2:] = np.maximum(high[2:], low[2:] * (1.0 + WIDEN))
    limit, least = problem.limits.transmission_at(loop.joint), problem.limits.alignment.value
    ends = (None, None) if limit is None else (limit.low, limit.high)
    angles = max(ends[0] or 0.0, least) - WIDEN, min(math.pi if ends[1] is None else ends[1], math.pi - least) + WIDEN
    ratios[1] = max(ratios[1][0], shortest), ratios[1][1]
    coupler = ratios[1][0] * (1.0 - WIDEN), ratios[1][1] * (1.0 + WIDEN)
    sides = (1, -1) if len(problem.mechanism.variants(problem.linkage)) > 1 else (loop.side,)
    every = [LinkageSet(side, low, high, coupler, angles, problem.limits.crank) for side in sides]
    return every + [part for linkages in every if (part := linkages.dead_part(error)) is not None]


def _ratio(problem: DesignProblem, name: str) -> tuple[float, float]:
    """Return the least and largest length over that of the frame."""
    (low, high), (frame_low, frame_high) = problem.quantities[name].bounds, problem.frame_bounds
    limit = problem.limits.link_ratio
    least, most = (0.0, math.inf) if limit is None else limit.bounds
    return max(low / frame_high, least), min(high / frame_low, most)


@dataclass
class FunctionSearch:
    """Search of all linkages within the bounds and limits of a problem for one with a smaller largest output error.

    `proven` [rad] is the lower bound of the last gap that is proven; `status`: "closed" if the requested gap is, "stopped" at the
    limit of time or boxes, "interrupted" by Ctrl-C. `better` has the designs [m, rad] better than all known before and their
    assembly modes, `tried` the places (4,) of the candidates that were tried; `history`: boxes, lower, best. `searches` are those
    of the present gap.
    """

    problem: DesignProblem
    best: float
    design: dict[str, float] | None
    improve: Improve | None
    proven: float = 0.0
    boxes: int = 0
    status: str = STOPPED
    better: list[tuple[dict[str, float], int]] = field(default_factory=list)
    history: list[tuple[int, float, float]] = field(default_factory=list)
    tried: list[Array] = field(default_factory=list)
    searches: list[BranchAndBound] = field(default_factory=list)

    @property
    def loop(self) -> InnerFourBar:
        """The four-bar."""
        assert self.problem.four_bar is not None
        return self.problem.four_bar

    @property
    def lower(self) -> float:
        """Lower bound [rad]: no linkage has a smaller largest error."""
        return min(self.proven, self.best)

    @property
    def gap(self) -> float:
        """Share of `best` by which a better linkage may exist."""
        return 1.0 - self.lower / self.best

    @property
    def open(self) -> Array:
        """Corners of the boxes that are left (boxes, 2, 4): phi0, psi0 [rad], frame over crank, frame over rocker."""
        left = [np.stack([part.low, part.high], axis=1) for search in self.searches for part in (search.open, search.tiny)]
        return np.concatenate(left) if left else np.zeros((0, 2, 4))

    def run(self, levels: list[float], seconds: float, boxes: float, progress: Callable[[float, float], None] | None) -> None:
        """Prove one gap after the other, the largest first, within limits of time [s] and of the number of boxes."""
        begin = time.perf_counter()
        try:
            for level in levels:
                self.searches = self._searches(level)
                for k, search in enumerate(self.searches):
                    search.best = self.best
                    search.improve = lambda _, search=search: self._better(search)
                    report = None if progress is None else lambda one, k=k: self._report(one, k, progress)
                    before = search.boxes
                    search.run(seconds - (time.perf_counter() - begin), boxes - self.boxes, report)
                    self.boxes += search.boxes - before
                    self.best = min(self.best, search.best)
                if not all(search.closed for search in self.searches):
                    return
                self.proven = max(self.proven, min(search.lower for search in self.searches))
                self.history.append((self.boxes, self.proven, self.best))
            self.status = CLOSED
        except KeyboardInterrupt:
            interrupts.handled()
            self.status = INTERRUPTED

    def _searches(self, level: float) -> list[BranchAndBound]:
        """Return a search of every set of linkages; each begins with the boxes that the one before has discarded."""
        sets = linkage_sets(self.problem, self.best)
        searches = [BranchAndBound(self._bounds(linkages), self.best, level) for linkages in sets]
        for search, previous in zip(searches, self.searches, strict=False):
            bounder, before = search.bounder, previous.bounder
            if np.array_equal([bounder.low, bounder.high], [before.low, before.high]) and previous.leaves.low:
                low, high = np.concatenate(previous.leaves.low), np.concatenate(previous.leaves.high)
                search.open = Boxes(low, high, np.zeros(len(low)))
        return searches

    def _report(self, search: BranchAndBound, k: int, progress: Callable[[float, float], None]) -> None:
        whole = float(np.prod(search.bounder.high - search.bounder.low))
        left = float(np.sum(np.prod(search.open.high - search.open.low, axis=1))) / whole
        progress((k + 1.0 - min(left, 1.0)) / len(self.searches), self.gap)

    def _rise(self, at: Array) -> Array:
        law = self.problem.requirement.law
        assert isinstance(law, Function)
        return np.asarray(law.rise(at) + 0.0 * at, dtype=float)

    def _bounds(self, linkages: LinkageSet) -> FunctionBounds:
        x = self.problem.span * 0.5 * (1.0 - np.cos(np.linspace(0.0, math.pi, POSITIONS)))
        if self.design is not None:
            fine, error = self._errors(self.design)
            around = np.pad(error, 1, constant_values=-1.0)
            x = np.append(x, fine[(error >= around[:-2]) & (error >= around[2:])])
        dense = self.problem.span * np.linspace(0.0, 1.0, DENSE)
        return FunctionBounds(linkages, self._rise, np.unique(x), dense)

    def _errors(self, design: Mapping[str, float]) -> tuple[Array, Array]:
        """Return fine positions and the absolute errors [rad] of a design there, in its better assembly mode."""
        x = self.problem.span * np.linspace(0.0, 1.0, FINE)
        problem, loop = self.problem, self.loop
        turned, lengths = problem.frame_angle or 0.0, loop.lengths(design)
        a, b, c = (length / lengths[3] for length in lengths[:3])
        k3 = (a * a - b * b + c * c + 1.0) / (2.0 * a * c)
        phi0, psi0 = design[problem.start_name] - turned, design[problem.base_name] - turned
        point = np.array([[phi0, psi0, 1.0 / a, 1.0 / c, k3]])
        errors = [np.abs(followed(point, side, x, self._rise(x))[0][0]) for side in (1, -1)]
        return x, min(errors, key=lambda error: float(np.max(finite_or(error, np.inf))))

    def _better(self, search: BranchAndBound) -> float:
        """Return the best objective known after the candidate of a batch."""
        bounder = search.bounder
        assert isinstance(bounder, FunctionBounds)
        phi0, psi0, k1, k2, k3 = (float(value) for value in bounder.candidate)
        place = np.array([phi0, psi0, math.log(k1), math.log(k2)])
        if self.improve is not None and any(max_magnitude(place - other) < CANDIDATE_SEPARATION for other in self.tried):
            return self.best
        self.tried.append(place)
        problem, loop, turned = self.problem, self.loop, self.problem.frame_angle or 0.0
        pivots = {name: problem.quantities[name].value for name in loop.ground}
        frame = loop.frame(pivots)[0]
        coupler = math.sqrt(1.0 / (k1 * k1) + 1.0 / (k2 * k2) + 1.0 - 2.0 * k3 / (k1 * k2))
        lengths = dict(zip(loop.names, (frame / k1, frame * coupler, frame / k2), strict=True))
        design = {**lengths, **pivots, problem.start_name: phi0 + turned, problem.base_name: psi0 + turned}
        error = float(np.max(self._errors(design)[1]))
        if error < self.best:
            value = error if self._within(design) else math.inf
            if self.improve is not None:
                value = self.improve(design, bounder.linkages.side)
            if value < self.best:
                self.best, self.design = value, design
                self.better.append((design, bounder.linkages.side))
        return self.best

    def _within(self, design: Mapping[str, float]) -> bool:
        """Return whether a candidate is within the bounds of its lengths, and has no limits that a candidate may violate."""
        bounds = ((design[name], *self.problem.quantities[name].bounds) for name in self.loop.names)
        return self.problem.limits.crank == "span" and all(low <= value <= high for value, low, high in bounds)
