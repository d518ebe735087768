"""Checks of a validation, and the tolerances of limits."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

from optlink.problem.quantity import Interval, Quantity, StrokeRatio

POSITIONS = 1440  # per revolution: every quarter of a degree; dead centres and extremes are refined
ANGLE_TOLERANCE = 1e-6  # deg; solvers satisfy limits to 1e-8 of a radian
LENGTH_TOLERANCE = 1e-9  # of the frame, or of the size of a curve
RATIO_TOLERANCE = 1e-7


@dataclass(frozen=True)
class Check:
    """One check: the measured `value` and the allowed `limit`, in `unit`."""

    name: str
    passed: bool
    value: float
    limit: str
    unit: str


@dataclass(frozen=True)
class Validation:
    """All checks of a design, and its measured objective [SI]."""

    checks: tuple[Check, ...]
    objective: float

    @property
    def valid(self) -> bool:
        """Whether every check passed."""
        return all(check.passed for check in self.checks)


def nan_last(value: float) -> float:
    """Return a sort key that places NaN last."""
    return math.inf if math.isnan(value) else value


def bound(name: str, quantity: Quantity, value: float, size: float) -> Check:
    """Check whether a quantity lies within its bounds, to 1e-8 of a reference length or of a radian.

    Parameters
    ----------
    name : str
        Name of the quantity.
    quantity : Quantity
    value : float [m, rad]
    size : float [m]
        Reference length.
    """
    low, high = quantity.bounds
    length = quantity.kind in ("length", "coordinate")
    factor, unit = (1e3, "mm") if length else (math.degrees(1.0), "deg")
    tolerance = 1e-8 * (size if length else 1.0)
    limit = f"{low * factor:.6g} ... {high * factor:.6g}" if quantity.free else f"= {low * factor:.6g}"
    return Check(f"{name} within its bounds", bool(low - tolerance <= value <= high + tolerance), value * factor, limit, unit)


def time_ratio(forward: float, backward: float, stroke: str | None) -> float:
    """Return the time ratio of two strokes at constant crank speed.

    Parameters
    ----------
    forward, backward : float [rad]
        Positive crank rotation of the two strokes.
    stroke : "forward", "backward", "slow", "quick" or None
        Stroke in the numerator. None: the slow one.
    """
    if stroke in ("forward", "backward"):
        return forward / backward if stroke == "forward" else backward / forward
    quick, slow = sorted((forward, backward))
    return quick / slow if stroke == "quick" else slow / quick


def time_ratio_checks(forward: float, backward: float, limit: StrokeRatio) -> Iterator[Check]:
    """Yield the checks of a limit of the time ratio.

    Parameters
    ----------
    forward, backward : float [rad]
        Crank rotation of the two strokes; NaN if there are no strokes.
    limit : StrokeRatio
    """
    name = f"time ratio, {limit.strokes}" if limit.stroke else "time ratio"
    yield from limit_checks(name, time_ratio(forward, backward, limit.stroke), limit, RATIO_TOLERANCE, 1.0, "")


def limit_checks(name: str, value: float, interval: Interval, tolerance: float, factor: float, unit: str) -> Iterator[Check]:
    """Yield one check per side of an interval.

    Parameters
    ----------
    name : str
        Name of the limited quantity.
    value : float [unit]
    interval : Interval
        Limits [SI].
    tolerance : float [unit]
        Permitted violation.
    factor : float
        Display units per SI unit.
    unit : str
        Display unit.
    """
    if interval.low is not None:
        low = interval.low * factor
        yield Check(f"{name}, least", bool(value >= low - tolerance), value, f">= {low:.6g}", unit)
    if interval.high is not None:
        high = interval.high * factor
        yield Check(f"{name}, largest", bool(value <= high + tolerance), value, f"<= {high:.6g}", unit)
