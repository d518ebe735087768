"""Many small linear programmes at once, by an interior-point method (Mehrotra's predictor and corrector)."""

import numpy as np

from optlink.linkage.vector2d import Array

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
