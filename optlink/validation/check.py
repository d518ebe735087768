"""What a validation is: checks, each a question with its answer; and how closely limits must be met."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

from optlink.problem.quantity import Interval, Quantity, StrokeRatio

POSITIONS = 1440  # per revolution: every quarter of a degree, dead centres and extremes refined from there
ANGLE_TOLERANCE = 1e-6  # deg; solvers meet limits to 1e-8 of a radian
LENGTH_TOLERANCE = 1e-9  # of the frame, or of the size of a curve
RATIO_TOLERANCE = 1e-7


@dataclass(frozen=True)
class Check:
    """One question and its answer: `value` was found, `limit` is allowed, in `unit`."""

    name: str
    passed: bool
    value: float
    limit: str
    unit: str


@dataclass(frozen=True)
class Validation:
    """All checks of a design, and what was measured on the way (SI): objective, extremes, dead centres."""

    checks: tuple[Check, ...]
    objective: float

    @property
    def valid(self) -> bool:
        """Whether every check passed."""
        return all(check.passed for check in self.checks)


def nan_last(value: float) -> float:
    """A key that sorts what has no value last."""
    return math.inf if math.isnan(value) else value


def bound(name: str, quantity: Quantity, value: float, size: float) -> Check:
    """Whether a quantity [SI] lies within its bounds, to 1e-8 of a reference length [m] or of a radian."""
    low, high = quantity.bounds
    length = quantity.kind in ("length", "coordinate")
    factor, unit = (1e3, "mm") if length else (math.degrees(1.0), "deg")
    tolerance = 1e-8 * (size if length else 1.0)
    limit = f"{low * factor:.6g} ... {high * factor:.6g}" if quantity.free else f"= {low * factor:.6g}"
    return Check(f"{name} within its bounds", bool(low - tolerance <= value <= high + tolerance), value * factor, limit, unit)


def time_ratio(forward: float, backward: float, stroke: str | None) -> float:
    """Time of a stroke over that of the other at constant crank speed.

    Parameters
    ----------
    forward, backward : float
        Crank rotation of the two strokes [rad], positive.
    stroke : "forward", "backward", "slow", "quick" or None
        Whose time is divided by the other's; None is the slow one.
    """
    if stroke in ("forward", "backward"):
        return forward / backward if stroke == "forward" else backward / forward
    quick, slow = sorted((forward, backward))
    return quick / slow if stroke == "quick" else slow / quick


def time_ratio_checks(forward: float, backward: float, limit: StrokeRatio) -> Iterator[Check]:
    """Checks of a limit of the time ratio by the crank rotations of the two strokes [rad]; NaN where there are no strokes."""
    name = f"time ratio, {limit.strokes}" if limit.stroke else "time ratio"
    yield from limit_checks(name, time_ratio(forward, backward, limit.stroke), limit, RATIO_TOLERANCE, 1.0, "")


def limit_checks(name: str, value: float, interval: Interval, tolerance: float, factor: float, unit: str) -> Iterator[Check]:
    """One check per side of an interval; value and tolerance in people's unit, `factor` people per SI."""
    if interval.low is not None:
        low = interval.low * factor
        yield Check(f"{name}, least", bool(value >= low - tolerance), value, f">= {low:.6g}", unit)
    if interval.high is not None:
        high = interval.high * factor
        yield Check(f"{name}, largest", bool(value <= high + tolerance), value, f"<= {high:.6g}", unit)
