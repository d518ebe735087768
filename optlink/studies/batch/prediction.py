"""Polynomials through the optima at a few points of a block, for starting points of Newton's method at the others."""

import itertools
import math
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from optlink.linkage.vector2d import Array
from optlink.studies.batch.newton import BatchOptima

Index = NDArray[np.intp]

NODES = (7, 6, 5)  # along each axis, the first number for which a block has enough points
POINTS_PER_NODE = 6  # least number of points of a block for each of its nodes


def block_nodes(ends: list[tuple[int, int]]) -> list[Index] | None:
    """Return the places of the nodes of a block along every axis, close to Chebyshev's; None if it has too few points."""
    sizes = [last - first + 1 for first, last in ends]
    for most in NODES:
        counts = [min(most, size) for size in sizes]
        if math.prod(sizes) >= POINTS_PER_NODE * math.prod(counts):
            shares = [0.5 - 0.5 * np.cos(np.pi * np.arange(count) / max(1, count - 1)) for count in counts]
            return [
                first + np.rint(share * (last - first)).astype(np.intp) for share, (first, last) in zip(shares, ends, strict=True)
            ]
    return None


@dataclass(frozen=True)
class Prediction:
    """Polynomials in the places along the axes, through the optima at the nodes of a block.

    `nodes`: places along each axis; `values` (nodes, n + n + m): scaled designs and multipliers; `sides` (n + m,): the active set
    of all nodes.
    """

    nodes: list[Index]
    values: Array
    sides: NDArray[np.int8]

    @classmethod
    def through(cls, nodes: list[Index], optima: BatchOptima) -> Self | None:
        """Return the polynomials; None if a node has no optimum, or another active set than the others."""
        if not np.all(optima.optimal) or np.any(optima.sides != optima.sides[0]):
            return None
        return cls(nodes, np.hstack([optima.x, optima.multipliers]), optima.sides[0])

    def at(self, places: tuple[Index, ...]) -> tuple[Array, Array]:
        """Return scaled designs (points, n) and multipliers (points, n + m), each the same in any batch."""
        weights = [_lagrange(nodes, place) for nodes, place in zip(self.nodes, places, strict=True)]
        values = np.zeros((len(places[0]), self.values.shape[1]))
        for value, factors in zip(self.values, itertools.product(*weights), strict=True):
            values += math.prod(factors[1:], start=factors[0])[:, None] * value
        n = self.values.shape[1] - len(self.sides)
        return values[:, :n], values[:, n:]


def _lagrange(nodes: Index, places: Index) -> list[Array]:
    """Return the value of each Lagrange polynomial of the nodes at places (points,)."""
    return [
        np.prod(
            [(places - other_node) / (node - other_node) for other_node in nodes if other_node != node] or [np.ones(len(places))],
            axis=0,
        )
        for node in nodes
    ]
