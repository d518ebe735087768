"""Branch and bound of four-bar function generators: which boxes to discard, and where to divide.

The rows and their proof are in `optlink.solvers.global_search.function_rows`; here multipliers, cuts and candidates are chosen.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from optlink.linkage.vector2d import Array
from optlink.solvers.global_search.function_rows import (
    LinkageSet,
    Rows,
    coupler_rows,
    grashof_rows,
    largest,
    loop_rows,
    most_k3,
    unit_vector,
)
from optlink.solvers.global_search.interior_point import least_violation
from optlink.solvers.global_search.lagrangian import OPEN, BoxRecord

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
    return np.remainder(output - psi0 - y + math.pi, 2.0 * math.pi) - math.pi, gamma, coupler[:, 0]


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
