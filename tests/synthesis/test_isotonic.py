"""Isotonic regression: that of scipy to the last bit."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
from scipy.optimize import isotonic_regression

from optlink.synthesis.isotonic import isotonic


def test_regression_is_that_of_scipy():
    rng = np.random.default_rng(4)
    for k in range(3000):
        slope, count = rng.normal(), 1 + k % 40
        values = slope * np.arange(count) + 10.0 ** rng.uniform(-3, 2) * rng.normal(size=count)
        if k % 3 == 0:
            values = np.round(values)  # with equal ones
        found = isotonic(values)
        assert found.tobytes() == isotonic_regression(values).x.tobytes()
        assert np.all(np.diff(found) >= 0.0)


def test_the_search_of_a_path_does_not_import_scipy_optimize():
    code = (
        "import sys, optlink\n"
        "assert optlink.solve(optlink.load('path-vline6'), starts=200).designs\n"
        "assert 'scipy.optimize' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
