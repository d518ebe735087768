"""Scrambled Sobol points, equal to those of scipy.stats.qmc to the bit, without the second that importing scipy.stats takes."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
BITS = 30
PRIMITIVE = "stats/_sobol_direction_numbers.npz"
"""Primitive polynomials and first direction numbers (Joe and Kuo 2008) within SciPy."""


class Sequence(Protocol):
    """A sequence of points."""

    def random(self, n: int) -> Array:
        """Return the next points (n, dimensions), from 0 to below 1."""
        ...


def sobol(dimensions: int, seed: int) -> Sequence:
    """Return a Sobol sequence with a random linear scramble and a digital shift.

    Parameters
    ----------
    dimensions : int
    seed : int
        Seed of the scrambling.

    References
    ----------
    S. Joe, F. Y. Kuo, Constructing Sobol sequences with better two-dimensional projections, SIAM J. Sci. Comput. 30 (2008)
    2635-2654. J. Matousek, On the L2-discrepancy for anchored boxes, J. Complexity 14 (1998) 527-556.
    """
    scipy = find_spec("scipy")
    numbers = Path((scipy and scipy.origin) or "").parent / PRIMITIVE
    if numbers.is_file():
        return _Sobol(_directions(dimensions, numbers), seed)
    from scipy.stats import qmc  # a SciPy that keeps its table elsewhere

    other: Sequence = qmc.Sobol(dimensions, rng=np.random.default_rng(seed))
    return other


class _Sobol:
    """The sequence of direction numbers (dimensions, bits)."""

    def __init__(self, directions: NDArray[np.uint32], seed: int) -> None:
        dimensions = len(directions)
        generator = np.random.default_rng(seed).spawn(1)[0]
        powers = np.left_shift(np.uint32(1), np.arange(BITS, dtype=np.uint32))
        draw = generator.integers(2, size=(dimensions, BITS), dtype=np.uint32)
        self._last = (draw @ powers).astype(np.uint32)
        lower = np.tril(generator.integers(2, size=(dimensions, BITS, BITS), dtype=np.uint32))
        lower[:, np.arange(BITS), np.arange(BITS)] = 1
        bits = (directions[:, None, :] >> np.arange(BITS - 1, -1, -1, dtype=np.uint32)[:, None]) & 1  # the highest first
        self._directions = (powers[::-1] @ (lower @ bits & 1)).astype(np.uint32)
        self._count = 0

    def random(self, n: int) -> Array:
        """Return the next points (n, dimensions), from 0 to below 1."""
        first = max(self._count - 1, 0)
        number = np.arange(first, max(self._count + n - 1, first))
        turned = np.bitwise_count((number ^ (number + 1)) >> 1)  # index of the lowest zero bit
        begin = [self._last] if self._count == 0 else []
        rows = [*begin, *np.take(self._directions, turned, axis=1).T]
        if self._count:
            rows[0] = rows[0] ^ self._last
        points = np.bitwise_xor.accumulate(np.array(rows), axis=0)
        self._last, self._count = points[-1], self._count + n
        return np.asarray(points * 2.0**-BITS)


def _directions(dimensions: int, numbers: Path) -> NDArray[np.uint32]:
    """Return the direction numbers (dimensions, bits), not scrambled."""
    with np.load(numbers) as file:
        polynomials, starts = file["poly"][:dimensions].tolist(), file["vinit"][:dimensions].tolist()
    found = np.ones((dimensions, BITS), dtype=np.uint32)
    for row, polynomial, start in zip(found[1:], polynomials[1:], starts[1:], strict=True):
        degree = polynomial.bit_length() - 1
        values = start[:degree]
        for j in range(degree, BITS):
            new = values[j - degree]
            for k in range(degree):
                if polynomial >> (degree - 1 - k) & 1:
                    new ^= values[j - k - 1] << (k + 1)
            values.append(new)
        row[:] = values[:BITS]
    return found << np.arange(BITS - 1, -1, -1, dtype=np.uint32)
