"""Scrambled Sobol points are those of scipy."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from scipy.stats import qmc

from optlink.sobol import POLYNOMIALS, sobol_points


@pytest.mark.parametrize("dimensions", [1, 2, 7, len(POLYNOMIALS), len(POLYNOMIALS) + 1])
def test_points_are_those_of_scipy_to_the_bit(dimensions: int) -> None:
    mine, theirs = (sobol(dimensions, rng=np.random.default_rng(7)) for sobol in (sobol_points, qmc.Sobol))
    for count in (64, 1, 63, 200):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # scipy: counts that are not powers of two
            assert np.array_equal(mine.random(count), theirs.random(count))
