"""Checks of a validation, and the tolerances of limits."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from optlink.linkage.mechanism import Link
from optlink.linkage.motion import Motion
from optlink.problem.base_model import Number
from optlink.problem.limits import Limits, Moved, TransmissionLimit, limits_in_file
from optlink.problem.quantity import Interval, Quantity

POSITIONS = 1440  # per revolution: every quarter of a degree; dead centres and extremes are refined
ANGLE_TOLERANCE = 1e-6  # deg; solvers satisfy limits to 1e-8 of a radian
LENGTH_TOLERANCE = 1e-9  # of the frame, or of the size of a curve
RATIO_TOLERANCE = 1e-7


@dataclass(frozen=True)
class Check:
    """One check: the measured `value` and the allowed `limit`, in `unit`."""

    name: str
    passed: bool
    value: Number
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


def link_lengths(motion: Motion, wanted: Callable[[Link], float], size: float) -> Check:
    """Check that all links keep their lengths in motion.

    Parameters
    ----------
    motion : Motion
    wanted : function of Link
        Returns its length [m].
    size : float [m]
        Reference length.
    """
    worst = 0.0
    for link in motion.mechanism.links:
        if link.end:
            measured = np.linalg.norm(motion.position(link.end) - motion.position(link.start), axis=-1)
            miss = float(np.max(np.abs(measured - wanted(link)))) if np.all(np.isfinite(measured)) else math.nan
            worst = max(worst, miss, key=nan_last)
    limit = LENGTH_TOLERANCE * size * 1e3
    return Check("link lengths re-measured in motion", bool(worst * 1e3 <= limit), worst * 1e3, f"<= {limit:.1e}", "mm")


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


def registered_checks(moved: Moved, limits: Limits, size: float) -> Iterator[Check]:
    """Yield the checks of the limits of `optlink.problem.limits` that a file states.

    Parameters
    ----------
    moved : Moved
        The design in motion.
    limits : Limits
    size : float [m]
        Reference length of tolerances.
    """
    for term, interval in limits_in_file(limits):
        tolerance, factor, unit = {
            "angle": (ANGLE_TOLERANCE, math.degrees(1.0), "deg"),
            "length": (1e-8 * size * 1e3, 1e3, "mm"),
        }.get(str(interval.kind), (RATIO_TOLERANCE, 1.0, ""))
        for name, value in term.measure(moved, interval):
            yield from limit_checks(name, value * factor, interval, tolerance, factor, unit)


def transmission_checks(least: float, largest: float, limit: TransmissionLimit | None, where: str = "") -> Iterator[Check]:
    """Yield the checks of the extreme transmission angles, or of the largest pressure angle if the file limits that.

    Parameters
    ----------
    least, largest : float [deg]
    limit : TransmissionLimit or None
        Limit of the file.
    where : str
        Joint, if there are several.
    """
    if limit is None:
        return
    low, high = (None if bound is None else math.degrees(bound) for bound in (limit.low, limit.high))
    if limit.pressure and high is not None:
        pressure, most = max(90.0 - least, largest - 90.0), high - 90.0
        name = f"largest pressure angle{where}"
        yield Check(name, bool(pressure <= most + ANGLE_TOLERANCE), pressure, f"<= {most:.6g}", "deg")
        return
    if low is not None:
        yield Check(f"smallest transmission angle{where}", bool(least >= low - ANGLE_TOLERANCE), least, f">= {low:.6g}", "deg")
    if high is not None:
        yield Check(
            f"largest transmission angle{where}", bool(largest <= high + ANGLE_TOLERANCE), largest, f"<= {high:.6g}", "deg"
        )
