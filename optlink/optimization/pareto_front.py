"""Pareto fronts of a set of designs: non-dominated points, ends, knee."""

import numpy as np
from numpy.typing import NDArray

from optlink.linkage.vector2d import Array

DUPLICATE = 1e-6  # share of a front's extent (or magnitude): closer designs count as one
STRAIGHT = 1e-3  # share of a front's extent: least bulge of a front with a knee


def extent(costs: Array) -> Array:
    """Return the extent of a set along every axis (k,), its magnitude where the extent vanishes; `costs` (n, k)."""
    width, size = np.ptp(costs, axis=0), np.max(np.abs(costs), axis=0)
    return np.where(width > DUPLICATE * size, width, np.where(size > 0.0, size, 1.0))


def undominated(costs: Array) -> NDArray[np.bool_]:
    """Return which points (n, k) are not dominated; smaller is better. Of points equal within rounding the first is kept."""
    if not len(costs):
        return np.zeros(0, dtype=bool)
    share = costs / extent(costs)
    kept = np.ones(len(costs), dtype=bool)
    for i, point in enumerate(share):
        no_worse = np.all(share <= point + DUPLICATE, axis=1)
        better = np.any(share < point - DUPLICATE, axis=1)
        duplicate = no_worse & np.all(share >= point - DUPLICATE, axis=1) & kept & (np.arange(len(share)) < i)
        kept[i] = not np.any((no_worse & better) | duplicate)
    return kept


def ends(costs: Array) -> tuple[int, ...]:
    """Return the index of the least value of every column; among equal ones, that with the least sum of all columns."""
    share = costs / extent(costs)
    indices = []
    for column in range(costs.shape[1]):
        near = np.flatnonzero(share[:, column] <= np.min(share[:, column]) + DUPLICATE)
        indices.append(int(near[np.argmin(np.sum(share[near], axis=1))]))
    return tuple(indices)


def knee(costs: Array) -> tuple[int, float] | None:
    """Return the index of the knee of a front and its distance; None where there is no knee.

    The knee is the point furthest from the chord (for three columns: the plane) of the ends, towards the ideal point; columns are
    scaled by the extent of the front. There is none if the front is straight or bulges the other way, or its ends span no plane.

    References
    ----------
    I. Das, On characterizing the knee of the Pareto curve based on normal-boundary intersection, Structural Optimization 18
    (1999) 107-115.
    """
    if len(costs) < 3:
        return None
    share = (costs - np.min(costs, axis=0)) / extent(costs)
    corners = share[list(ends(costs))]
    if abs(np.linalg.det(corners)) < STRAIGHT:
        return None
    normal = np.linalg.solve(corners, np.ones(len(corners)))
    away = (1.0 - share @ normal) / np.linalg.norm(normal)
    best = int(np.argmax(away))
    return (best, float(away[best])) if away[best] > STRAIGHT else None
