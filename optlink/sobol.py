"""Scrambled Sobol points, those of `scipy.stats.qmc.Sobol` to the bit, without the import of scipy.stats, which takes longer.

References
----------
S. Joe, F. Y. Kuo, Constructing Sobol sequences with better two-dimensional projections, SIAM J. Sci. Comput. 30 (2008) 2635-2654:
direction numbers. J. Matousek, On the L2-discrepancy for anchored boxes, J. Complexity 14 (1998) 527-556: scrambling.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

BITS = 30
POLYNOMIALS = (1, 3, 7, 11, 13, 19, 25, 37, 41, 47, 55, 59, 61, 67, 91, 97, 103, 109, 115, 131)
"""Primitive polynomials modulo 2 of the dimensions, the coefficients as bits."""
FIRST = (
    *((), (1,), (1, 3), (1, 3, 1), (1, 1, 1), (1, 1, 3, 3), (1, 3, 5, 13), (1, 1, 5, 5, 17), (1, 1, 5, 5, 5)),
    *((1, 1, 7, 11, 19), (1, 1, 5, 1, 1), (1, 1, 1, 3, 11), (1, 3, 5, 5, 31), (1, 3, 3, 9, 7, 49), (1, 1, 1, 15, 21, 21)),
    *((1, 3, 1, 13, 27, 49), (1, 1, 1, 15, 7, 5), (1, 3, 1, 15, 13, 25), (1, 1, 5, 5, 19, 61), (1, 3, 7, 11, 23, 15, 103)),
)
"""First direction numbers of the dimensions."""


def sobol_points(dimensions: int, rng: np.random.Generator) -> Any:
    """Return a generator of scrambled Sobol points in the unit cube; its method `random` takes a number of points.

    Parameters
    ----------
    dimensions : int
    rng : numpy.random.Generator
        Draws the scrambling.
    """
    if dimensions <= len(POLYNOMIALS):
        return _Sobol(dimensions, rng)
    from scipy.stats import qmc

    return qmc.Sobol(dimensions, rng=rng)


class _Sobol:
    """Scrambled Sobol points of few dimensions."""

    def __init__(self, dimensions: int, rng: np.random.Generator) -> None:
        rng = rng.spawn(1)[0]  # as scipy does
        powers = 1 << np.arange(BITS, dtype=np.int64)
        shift = rng.integers(2, size=(dimensions, BITS), dtype=np.uint32).astype(np.int64)
        lower = np.tril(rng.integers(2, size=(dimensions, BITS, BITS), dtype=np.uint32)).astype(np.int64) | np.eye(
            BITS, dtype=int
        )
        numbers = np.array([_direction_numbers(k) for k in range(dimensions)]) * powers[::-1]
        bits = numbers[:, :, None] // powers[::-1] % 2  # (dimensions, number, bit), the largest bit first
        self._directions = (np.einsum("dpk,djk->djp", lower, bits) % 2) @ powers[::-1]
        self._last, self._count = shift @ powers, 0

    def random(self, count: int) -> NDArray[np.float64]:
        """Return the next points (count, dimensions)."""
        numbers = np.arange(self._count + 1, self._count + count + 1)
        changes = np.log2(numbers & -numbers).astype(int)  # Gray code: the bit that changes after each point
        states = np.bitwise_xor.accumulate(np.vstack([self._last, self._directions.T[changes]]), axis=0)
        self._last, self._count = states[-1], self._count + count
        return np.asarray(states[:-1] / 2.0**BITS)


def _direction_numbers(dimension: int) -> list[int]:
    """Return the direction numbers of a dimension, before they are shifted to their bit."""
    if not dimension:
        return [1] * BITS
    polynomial, found = POLYNOMIALS[dimension], list(FIRST[dimension])
    degree = len(found)
    while len(found) < BITS:
        new = found[-degree]
        for k in range(1, degree + 1):
            if polynomial >> (degree - k) & 1:
                new ^= found[-k] << k
        found.append(new)
    return found
