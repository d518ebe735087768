"""Division of a grid into blocks of neighbouring points, each with one point in its middle."""

import math
from collections.abc import Iterator, Sequence
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from optlink.studies.grid import Grid

Index = NDArray[np.intp]
MAX_BLOCK_POINTS = 100
"""Largest number of points of a block."""
MIN_BLOCKS = 3
"""Approximate least number of blocks, so that a small grid does not depend on a single search."""


def coarse_block(count: int) -> int:
    """Return the number of points of a coarse block in a grid of `count` points: 25 blocks in 10,000 points, 250 in a million."""
    return 4 * math.isqrt(count)


class Blocks:
    """Blocks of few points, fewer in small grids, about as long along every axis; they depend on the grid alone.

    `most`: largest number of points of a block, by default `MAX_BLOCK_POINTS`; `least`: approximate least number of blocks.
    """

    def __init__(self, grid: Grid, most: int | None = None, least: float = MIN_BLOCKS) -> None:
        self.shape = tuple(len(axis.values) for axis in grid.axes)
        left = max(1, min(MAX_BLOCK_POINTS if most is None else most, int(math.prod(self.shape) / least)))
        edges = dict.fromkeys(range(len(self.shape)), 1)
        for divided, axis in enumerate(sorted(edges, key=lambda k: self.shape[k])):
            edge = math.floor(left ** (1.0 / (len(edges) - divided)) + 1e-9)
            edges[axis] = max(1, min(self.shape[axis], edge))
            left //= edges[axis]
        self.counts = tuple(-(-size // edges[k]) for k, size in enumerate(self.shape))

    def of(self, points: Index) -> Index:
        """Return the block (points,) of each point of the grid."""
        places = np.unravel_index(points, self.shape)
        return np.ravel_multi_index(
            [place * count // size for place, count, size in zip(places, self.counts, self.shape, strict=True)], self.counts
        )

    def middle(self, block: int) -> int:
        """Return the point in the middle of a block."""
        return self._point([(first + last) // 2 for first, last in self.ends(block)])

    def corners(self, block: int) -> tuple[int, ...]:
        """Return two opposite corners of a block, once if they are one point."""
        return tuple(dict.fromkeys(self._point(places) for places in zip(*self.ends(block), strict=True)))

    def ends(self, block: int) -> list[tuple[int, int]]:
        """Return the first and last place of a block along every axis."""
        indices = np.unravel_index(block, self.counts)
        return [
            (-(-int(k) * size // count), -(-(int(k) + 1) * size // count) - 1)
            for k, count, size in zip(indices, self.counts, self.shape, strict=True)
        ]

    def points(self, places: Sequence[Index]) -> Index:
        """Return the points at all combinations of places along the axes, the last axis varying fastest."""
        return np.ravel_multi_index(np.ix_(*places), self.shape).ravel()

    def _point(self, places: Sequence[int]) -> int:
        return int(np.ravel_multi_index(places, self.shape))

    def neighbours(self, block: int) -> list[int]:
        """Return the neighbours of a block along every axis."""
        indices = [int(place) for place in np.unravel_index(block, self.counts)]
        neighbours = ([*indices[:k], indices[k] + step, *indices[k + 1 :]] for k in range(len(indices)) for step in (-1, 1))
        return [
            int(np.ravel_multi_index(indices_of_block, self.counts))
            for indices_of_block in neighbours
            if self._inside(indices_of_block)
        ]

    def _inside(self, places: list[int]) -> bool:
        return all(0 <= place < count for place, count in zip(places, self.counts, strict=True))

    @cached_property
    def count(self) -> int:
        """Number of blocks."""
        return math.prod(self.counts)

    def __iter__(self) -> Iterator[int]:
        return iter(range(self.count))
