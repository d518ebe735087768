"""Scrambled Sobol points: those of `scipy.stats.qmc`, the import of which takes longer than many a search."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

BITS = 30

DIRECTIONS = """
3 1 / 7 1 3 / 11 1 3 1 / 13 1 1 1 / 19 1 1 3 3 / 25 1 3 5 13 / 37 1 1 5 5 17 / 41 1 1 5 5 5 / 47 1 1 7 11 19 / 55 1 1 5 1 1 /
59 1 1 1 3 11 / 61 1 3 5 5 31 / 67 1 3 3 9 7 49 / 91 1 1 1 15 21 21 / 97 1 3 1 13 27 49 / 103 1 1 1 15 7 5 / 109 1 3 1 15 13 25 /
115 1 1 5 5 19 61 / 131 1 3 7 11 23 15 103 / 137 1 3 7 13 13 15 69 / 143 1 1 3 13 7 35 63 / 145 1 3 5 9 1 25 53 /
157 1 3 1 13 9 35 107 / 167 1 3 1 5 27 61 31 / 171 1 1 5 11 19 41 61 / 185 1 3 5 3 3 13 69 / 191 1 1 7 13 1 19 1 /
193 1 3 7 5 13 19 59 / 203 1 1 3 9 25 29 41 / 211 1 3 5 13 23 1 55 / 213 1 3 7 3 13 59 17 / 229 1 3 1 3 5 53 69 /
239 1 1 5 5 23 33 13 / 241 1 1 7 7 1 61 123 / 247 1 1 7 9 13 61 49 / 253 1 3 3 5 3 55 33
"""
"""Primitive polynomial (its coefficients as bits) and first direction numbers of the second dimension, of the third and so on."""


def sobol_points(dimensions: int, rng: np.random.Generator, block: int, begin: int = 0) -> Iterator[NDArray[np.float64]]:
    """Generate scrambled Sobol points within the unit cube in blocks (block, dimensions), up to 2^30 points.

    Parameters
    ----------
    dimensions : int
    rng : numpy.random.Generator
        Of the scrambling: a random lower triangular matrix and a shift in every dimension.
    block : int
        Number of points of a block, a power of two.
    begin : int
        Number of points to skip.

    References
    ----------
    S. Joe, F. Y. Kuo, Constructing Sobol sequences with better two-dimensional projections, SIAM J. Sci. Comput. 30 (2008);
    J. Matousek, On the L2-discrepancy for anchored boxes, J. Complexity 14 (1998).
    """
    rows = [[int(number) for number in row.split()] for row in DIRECTIONS.split("/")]
    if dimensions > len(rows) + 1:
        from scipy.stats import qmc

        points = qmc.Sobol(dimensions, rng=rng)
        if begin:
            points.fast_forward(begin)
        while True:
            yield np.asarray(points.random(block), dtype=float)
    powers = 1 << np.arange(BITS)
    shift = rng.integers(2, size=(dimensions, BITS), dtype=np.uint32) @ powers
    scrambling = np.tril(rng.integers(2, size=(dimensions, BITS, BITS), dtype=np.uint32), -1) + np.eye(BITS, dtype=np.int64)
    numbers = np.array([[1] * BITS, *(_direction_numbers(*row) for row in rows[: dimensions - 1])]) * powers[::-1]
    digits = numbers[:, None, :] >> np.arange(BITS)[::-1, None] & 1  # the first row: those of one half
    numbers = np.tensordot(powers[::-1], scrambling @ digits & 1, axes=(0, 1))
    for first in range(begin, 1 << BITS, block):
        count = np.arange(first, first + block)
        steps = numbers[:, np.bitwise_count((count & -count) - 1)]  # of the Gray code: that of the lowest set bit
        steps[:, 0] = shift ^ np.bitwise_xor.reduce(numbers[:, (first ^ first >> 1) >> np.arange(BITS) & 1 == 1], axis=1)
        yield np.bitwise_xor.accumulate(steps, axis=1).T / (1 << BITS)


def _direction_numbers(polynomial: int, *first: int) -> list[int]:
    """Return the direction numbers of a dimension, `BITS` odd integers, by the recurrence of its polynomial."""
    found, degree = list(first), len(first)
    while len(found) < BITS:
        number = found[-degree]
        for back in range(1, degree + 1):
            number ^= (polynomial >> (degree - back) & 1) * found[-back] << back
        found.append(number)
    return found
