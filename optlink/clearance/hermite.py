"""Quintic Hermite interpolation between two rows: zero crossing and maximum.

The path is given by its value, slope and second derivative at both ends, and the span of time between them.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from optlink.linkage.vector2d import Array


def _quintic(begin: Sequence[float], end: Sequence[float], span: float) -> Array:
    """The polynomial over a row (0 ... 1)."""
    (y0, s0, c0), (y1, s1, c1) = begin, end
    a, b = s0 * span, s1 * span
    c, d = 0.5 * c0 * span * span, 0.5 * c1 * span * span
    p, q, r = y1 - y0 - a - c, b - a - 2.0 * c, d - c
    return np.array([6.0 * p - 3.0 * q + r, -15.0 * p + 7.0 * q - 2.0 * r, 10.0 * p - 4.0 * q + r, c, a, y0])


def _real_roots(polynomial: Any) -> Array:
    roots = np.roots(polynomial)
    return np.sort(roots.real[(np.abs(roots.imag) < 1e-9) & (roots.real > 0.0) & (roots.real < 1.0)])


def crossing(begin: Sequence[float], end: Sequence[float], span: float) -> float:
    """Estimate the first upward zero crossing of a path that ends above zero, as a share of the row."""
    path = _quintic(begin, end, span)
    rising = [u for u in _real_roots(path) if np.polyval(np.polyder(path), u) > 0.0]
    return float(rising[0]) if rising else 0.5


def summit(begin: Sequence[float], end: Sequence[float], span: float) -> float:
    """Estimate the maximum of a path that rises at its start and falls at its end, as a share of the row."""
    path = _quintic(begin, end, span)
    tops = _real_roots(np.polyder(path))
    return float(tops[np.argmax(np.polyval(path, tops))]) if tops.size else begin[1] / (begin[1] - end[1])
