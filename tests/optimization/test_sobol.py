"""Sobol points: those of scipy to the last bit, also of later blocks and beyond the own direction numbers."""

from __future__ import annotations

import itertools
import subprocess
import sys

import numpy as np
import pytest
from scipy.stats import qmc

from optlink.optimization.sobol import DIRECTIONS, sobol_blocks

OWN = 1 + len(DIRECTIONS)


@pytest.mark.parametrize("seed", [0, 1, 20260101])
@pytest.mark.parametrize("dimensions", [1, 2, 3, 7, OWN, OWN + 1])
def test_points_are_those_of_scipy(dimensions, seed):
    whole = qmc.Sobol(dimensions, rng=np.random.default_rng(seed)).random(1024)
    for block in (1, 64, 256):
        found = np.concatenate(list(itertools.islice(sobol_blocks(dimensions, seed, block), 512 // block)))
        assert found.tobytes() == whole[:512].tobytes()
        assert next(sobol_blocks(dimensions, seed, block, 768)).tobytes() == whole[768 : 768 + block].tobytes()


def test_points_of_large_numbers_are_those_of_scipy():
    begin = 5 << 20
    points = qmc.Sobol(4, rng=np.random.default_rng(3))
    points.fast_forward(begin)
    assert next(sobol_blocks(4, 3, 4096, begin)).tobytes() == points.random(4096).tobytes()


def test_the_random_starts_of_a_search_do_not_import_scipy_stats():
    code = (
        "import sys, optlink\n"
        "result = optlink.solve(optlink.load('crank-rocker'), starts=3)\n"
        "assert result.valid\n"
        "assert 'scipy.stats' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
