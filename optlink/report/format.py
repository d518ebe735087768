"""Numbers as text, in tables, captions and charts."""

from __future__ import annotations

import math
from collections.abc import Mapping


def number(value: float, digits: int = 6) -> str:
    """Format a number with significant digits; a dash if it is not finite.

    Parameters
    ----------
    value : float
    digits : int, optional
        Significant digits; a number below 1e-5 has two.
    """
    if not math.isfinite(value):
        return "-"
    if abs(value) < 1e-300:
        return "0"
    return f"{value:.{digits}g}" if abs(value) >= 1e-5 else f"{value:.1e}"


def precise(value: float, digits: int) -> str:
    """Format a number with all its significant digits, however small it is.

    Parameters
    ----------
    value : float
    digits : int
    """
    return number(value, digits) if value == 0.0 or abs(value) >= 1e-5 else f"{value:.{digits - 1}e}"


def fixed(value: float, decimals: int = 3) -> str:
    """Format a number with fixed decimals; a dash if it is not finite.

    Parameters
    ----------
    value : float
    decimals : int, optional
    """
    return f"{round(value, decimals) + 0.0:.{decimals}f}" if math.isfinite(value) else "-"  # + 0.0: no negative zero


def significant(value: float) -> str:
    """Format a dimension with at least three decimals and six significant digits."""
    digits = 3 if abs(value) >= 100.0 or value == 0.0 else min(9, 5 - math.floor(math.log10(max(abs(value), 1e-6))))
    return fixed(value, digits)


def signed(value: float) -> str:
    """Format a change with its sign and four significant digits."""
    return f"{value:+.4g}" if value else "0"


def percent(share: float) -> str:
    """Format a share in per cent with three decimals; a dash if it is not finite."""
    return f"{100.0 * share:.3f} %" if math.isfinite(share) else "-"


def change(share: float) -> str:
    """Format a relative change in per cent with its sign and two decimals; a dash if it is not finite."""
    if not math.isfinite(share):
        return "-"
    return f"{round(100.0 * share, 2) + 0.0:+.2f} %".replace("-", "−")


def points(count: int) -> str:
    """Format a number of points, with its noun."""
    return f"{count:,} point{'' if count == 1 else 's'}"


def times(seconds: Mapping[str, float], decimals: int = 0) -> str:
    """List the stages that took time, in milliseconds.

    Parameters
    ----------
    seconds : mapping of str to float
        Wall time per stage [s].
    decimals : int, optional
    """
    return ", ".join(f"{name} {1e3 * value:.{decimals}f} ms" for name, value in seconds.items() if value > 0.0)
