"""Sobol points against those of SciPy."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy.stats import qmc

from optlink.sobol import DIRECTIONS, sobol_points

TABLE = DIRECTIONS.count("/") + 2


@pytest.mark.parametrize("dimensions", [1, 2, 6, TABLE, TABLE + 1])
@pytest.mark.parametrize(("block", "begin"), [(64, 0), (1024, 0), (128, 128 * 81)])
def test_the_points_are_those_of_scipy(dimensions: int, block: int, begin: int) -> None:
    """To the last bit, from the first block on and after a skip, also in more dimensions than the table has."""
    expected = qmc.Sobol(dimensions, rng=np.random.default_rng(7))
    if begin:
        expected.fast_forward(begin)
    own = np.random.default_rng(7)
    for points in itertools.islice(sobol_points(dimensions, own if dimensions > TABLE else own.spawn(1)[0], block, begin), 3):
        np.testing.assert_array_equal(points, expected.random(block))
