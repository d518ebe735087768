"""Whether boxes cover a larger box completely: exact, in floating-point numbers."""

import numpy as np

from optlink.linkage.vector2d import Array


def uncovered(low: Array, high: Array, within: tuple[Array, Array]) -> tuple[Array, Array] | None:
    """Return a part of a box that is not proven to be covered by smaller boxes; None if they cover it.

    Boxes that come from repeated cuts through a whole box form a guillotine partition: there is a plane that cuts no box, and
    either side has one too, until one box is left. Each step sorts the boxes along every unknown and divides at all such planes
    of the unknown that has most of them. Nothing is added or rounded: coordinates are only compared.

    Parameters
    ----------
    low, high : array (boxes, n)
        Corners.
    within : pair of array (n,)
        Corners of the larger box.
    """
    every = np.flatnonzero(np.all((low < within[1]) & (high > within[0]) | (within[0] == within[1]), axis=1))
    stack = [(every, within[0].copy(), within[1].copy())]
    while stack:
        index, least, most = stack.pop()
        a, b = low[index], high[index]
        if np.any(np.all((a <= least) & (b >= most), axis=1)):
            continue
        best: tuple[int, Array] | None = None
        for k in range(len(least)):
            planes = _planes(a[:, k], b[:, k], float(least[k]), float(most[k]))
            if planes is None:
                return least, most
            if planes.size and (best is None or planes.size > best[1].size):
                best = k, planes
        if best is None:
            return least, most
        k, planes = best
        for begin, end in zip((least[k], *planes), (*planes, most[k]), strict=True):
            part = index[(a[:, k] < end) & (b[:, k] > begin)]
            first, last = least.copy(), most.copy()
            first[k], last[k] = begin, end
            stack.append((part, first, last))
    return None


def _planes(low: Array, high: Array, least: float, most: float) -> Array | None:
    """Return the coordinates strictly inside least ... most that no interval contains in its interior; None if there is a gap."""
    order = np.argsort(low)
    low, highest = low[order], np.maximum.accumulate(high[order])
    if not low.size or low[0] > least or highest[-1] < most:
        return None
    if np.any((low[1:] > highest[:-1]) & (low[1:] > least) & (highest[:-1] < most)):
        return None
    planes = low[1:][(low[1:] >= highest[:-1]) & (low[1:] > least) & (low[1:] < most)]
    return np.unique(planes)
