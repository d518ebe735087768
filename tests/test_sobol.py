"""Sobol points against those of SciPy."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import qmc

from optlink import sobol as module
from optlink.sobol import sobol


@pytest.mark.parametrize(("dimensions", "seed"), [(1, 0), (2, 7), (11, 1), (64, 3)])
def test_points_equal_those_of_scipy_to_the_bit(dimensions: int, seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    own, other = sobol(dimensions, seed), qmc.Sobol(dimensions, rng=np.random.default_rng(seed))
    monkeypatch.setattr(module, "PRIMITIVE", "nowhere")
    instead = sobol(dimensions, seed)
    assert isinstance(instead, qmc.Sobol)
    for count in (64, 64, 1, 3, 300):
        expected = other.random(count)
        np.testing.assert_array_equal(own.random(count), expected)
        np.testing.assert_array_equal(instead.random(count), expected)
