"""What a set of designs says as a front: which are dominated by others, where its ends are, and where its knee."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
SAME = 1e-6  # of a front's extent, or of the size of what has none: designs that are so near to each other are one
STRAIGHT = 1e-3  # of a front's extent: one that bulges less has no knee


def extent(costs: Array) -> Array:
    """Extent of a set along every axis (k,), its size where it has none but for rounding; `costs` (n, k)."""
    width, size = np.ptp(costs, axis=0), np.max(np.abs(costs), axis=0)
    return np.where(width > SAME * size, width, np.where(size > 0.0, size, 1.0))


def undominated(costs: Array) -> NDArray[np.bool_]:
    """Which points no other one beats.

    Parameters
    ----------
    costs : array (n, k)
        Smaller is better in every column. Of points that are the same but for rounding the first stays.
    """
    if not len(costs):
        return np.zeros(0, dtype=bool)
    share = costs / extent(costs)
    kept = np.ones(len(costs), dtype=bool)
    for i, point in enumerate(share):
        no_worse = np.all(share <= point + SAME, axis=1)
        better = np.any(share < point - SAME, axis=1)
        twin = no_worse & np.all(share >= point - SAME, axis=1) & kept & (np.arange(len(share)) < i)
        kept[i] = not np.any((no_worse & better) | twin)
    return kept


def ends(costs: Array) -> tuple[int, ...]:
    """The point with the least of every column, and the least of the others where several have it."""
    share = costs / extent(costs)
    found = []
    for column in range(costs.shape[1]):
        near = np.flatnonzero(share[:, column] <= np.min(share[:, column]) + SAME)
        found.append(int(near[np.argmin(np.sum(share[near], axis=1))]))
    return tuple(found)


def knee(costs: Array) -> tuple[int, float] | None:
    """The point of a front that lies furthest from the chord (of three columns: the plane) of its ends, and how far.

    Columns count by the extent of the front. The distance is towards the ideal point that has the least of everything
    (I. Das, "On characterizing the knee of the Pareto curve based on normal-boundary intersection", Structural
    Optimization 18 (1999) 107-115). None where the front is straight, bulges the other way, or its ends span no plane.
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
