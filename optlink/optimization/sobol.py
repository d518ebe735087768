"""Scrambled Sobol points, bit for bit those of `scipy.stats.qmc`, whose import takes longer than many a search.

References
----------
S. Joe, F. Y. Kuo, Constructing Sobol sequences with better two-dimensional projections, SIAM J. Sci. Comput. 30 (2008) 2635-2654.
J. Matousek, On the L2-discrepancy for anchored boxes, J. Complexity 14 (1998) 527-556: scrambling by random matrices and shifts.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from optlink.linkage.vector2d import Array

BITS = 30
DIRECTIONS: tuple[tuple[int, tuple[int, ...]], ...] = (
    (3, (1,)),
    (7, (1, 3)),
    (11, (1, 3, 1)),
    (13, (1, 1, 1)),
    (19, (1, 1, 3, 3)),
    (25, (1, 3, 5, 13)),
    (37, (1, 1, 5, 5, 17)),
    (41, (1, 1, 5, 5, 5)),
    (47, (1, 1, 7, 11, 19)),
    (55, (1, 1, 5, 1, 1)),
    (59, (1, 1, 1, 3, 11)),
    (61, (1, 3, 5, 5, 31)),
    (67, (1, 3, 3, 9, 7, 49)),
    (91, (1, 1, 1, 15, 21, 21)),
    (97, (1, 3, 1, 13, 27, 49)),
    (103, (1, 1, 1, 15, 7, 5)),
    (109, (1, 3, 1, 15, 13, 25)),
    (115, (1, 1, 5, 5, 19, 61)),
)
"""Primitive polynomial and first direction numbers of the second dimension and those after it (Joe and Kuo)."""


def sobol_blocks(dimensions: int, seed: int, block: int, begin: int = 0) -> Iterator[Array]:
    """Generate scrambled Sobol points in the unit cube, without end, in arrays (block, dimensions).

    Parameters
    ----------
    dimensions : int
    seed : int
        Seed of the scrambling.
    block : int
        A power of two.
    begin : int
        Number of points to skip, a multiple of `block`.
    """
    rng = np.random.default_rng(seed)
    if dimensions > 1 + len(DIRECTIONS):
        from scipy.stats import qmc

        points = qmc.Sobol(dimensions, rng=rng)
        if begin:  # scipy cannot skip none
            points.fast_forward(begin)
        while True:
            yield np.asarray(points.random(block), dtype=float)
    rng = rng.spawn(1)[0]  # as scipy does
    powers = 2 ** np.arange(BITS, dtype=np.uint32)
    shift = rng.integers(2, size=(dimensions, BITS), dtype=np.uint32) @ powers
    matrices = np.tril(rng.integers(2, size=(dimensions, BITS, BITS), dtype=np.uint32), -1) | np.eye(BITS, dtype=np.uint32)
    bits = _directions(dimensions)[..., None] // powers[::-1] & 1  # the highest first
    directions = (bits @ matrices.transpose(0, 2, 1) & 1) @ powers[::-1]
    number = np.arange(block)
    steps = directions.T[np.log2(np.maximum(number & -number, 1)).astype(int)]  # by the lowest bit (Gray code)
    steps[0] = 0
    within = np.bitwise_xor.accumulate(steps)
    for first in range(begin, 2**BITS, block):
        gray = first ^ first >> 1
        ahead = [directions[:, bit] for bit in range(BITS) if gray >> bit & 1]
        yield (within ^ np.bitwise_xor.reduce([shift, *ahead])) * 2.0**-BITS


def _directions(dimensions: int) -> NDArray[np.uint32]:
    """Return the direction numbers (dimensions, BITS) as integers below 2**BITS."""
    found = np.ones((dimensions, BITS), dtype=np.uint32)
    for own, (polynomial, first) in zip(found[1:], DIRECTIONS, strict=False):
        degree = len(first)
        own[:degree] = first
        for j in range(degree, BITS):
            terms = [own[j - k] << k for k in range(1, degree + 1) if polynomial >> (degree - k) & 1]
            own[j] = np.bitwise_xor.reduce([own[j - degree], *terms])
    return found << np.arange(BITS, dtype=np.uint32)[::-1]
