"""Isotonic regression, bit for bit that of `scipy.optimize`, whose import takes as long as many a search of a path."""

from __future__ import annotations

import numpy as np

from optlink.linkage.vector2d import Array


def isotonic(values: Array) -> Array:
    """Return the sequence (n,) without a decrease that is nearest to the values (n,) in the sense of least squares.

    References
    ----------
    F. M. T. A. Busing, Monotone regression: a simple and fast O(n) PAVA implementation, J. Stat. Softw. 102 (2022).
    """
    x, means, counts, i = values.tolist(), list[float](), list[int](), 0
    while i < len(x):
        mean, count = x[i], 1
        if means and means[-1] >= mean:  # pooled with the block before, then with what follows, then with earlier blocks
            before = counts.pop()
            total = before * means.pop() + mean
            count += before
            mean = total / count
            while i + 1 < len(x) and mean >= x[i + 1]:
                i += 1
                total, count = total + x[i], count + 1
                mean = total / count
            while means and means[-1] >= mean:
                before = counts.pop()
                total, count = total + before * means.pop(), count + before
                mean = total / count
        means.append(mean)
        counts.append(count)
        i += 1
    return np.repeat(np.array(means, dtype=float), counts)
