"""Bounds of a four-bar that let no crank turn: the inequality of Grashof that fails for all sizes, and which bound to change."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping
from decimal import ROUND_CEILING, ROUND_FLOOR, Context
from typing import NamedTuple

from optlink.linkage.fourbar import LENGTHS
from optlink.problem.quantity import Quantity

SHORTEST = {"full rotation": ("crank",), "double-crank": ("frame",), "": ("crank", "frame")}
"""Possible shortest links by `limits.crank`; empty: without this limit."""
INSIDE = 1e-4  # share of the longest link by which a changed bound goes beyond the least change, at first
DIGITS = 4

Bounds = Mapping[str, tuple[float, float]]


class Violation(NamedTuple):
    """An inequality sum(`left`) <= sum(`right`) of link lengths that no sizes within the bounds satisfy; `excess` [m]."""

    left: tuple[str, ...]
    right: tuple[str, ...]
    excess: float


def cannot_turn(quantities: Mapping[str, Quantity], crank: str, least_angle: float) -> tuple[str, ...]:
    """Return a sentence that no sizes within the bounds let the crank turn, with the change that does; else nothing.

    Parameters
    ----------
    quantities : mapping of str to Quantity
        The four lengths.
    crank : str
        `limits.crank` of the problem; empty if it has none.
    least_angle : float [rad]
        Least angle of coupler and rocker off alignment.
    """
    if crank not in SHORTEST or not quantities.keys() >= set(LENGTHS):
        return ()
    bounds = {name: quantities[name].bounds for name in LENGTHS}
    missed = [(shortest, violation) for shortest in SHORTEST[crank] if (violation := _violation(bounds, shortest)) is not None]
    if len(missed) < len(SHORTEST[crank]):
        return ()
    free = {name for name in LENGTHS if quantities[name].free}
    ways = [(_remedies(bounds, shortest, free, least_angle), violation) for shortest, violation in missed]
    remedies, violation = min(ways, key=lambda way: len(way[0]) or len(LENGTHS))
    remedy = f"Allow {' and '.join(remedies)}" if remedies else "Widen several bounds"
    span = ', or write limits.crank = "span"' * bool(crank)
    return (f"no sizes within the bounds let the crank turn: {_inequality(violation, bounds)}. {remedy}{span}",)


def _violation(bounds: Bounds, shortest: str) -> Violation | None:
    """Return the inequality that fails for all sizes; the simplest one, else the one missed by most."""
    others = [name for name in LENGTHS if name != shortest]
    for count in (1, 2):
        found = []
        for names in itertools.combinations(others, count):
            right = names
            left = (shortest, *(name for name in others if count == 2 and name not in names))
            excess = sum(bounds[name][0] for name in left) - sum(bounds[name][1] for name in right)
            if excess > 0.0:
                found.append(Violation(left, right, excess))
        if found:
            return max(found, key=lambda violation: violation.excess)
    return None


def _inequality(violation: Violation, bounds: Bounds) -> str:
    if len(violation.left) == 1:
        (shortest,), (other,) = violation.left, violation.right
        least, most = 1e3 * bounds[shortest][0], 1e3 * bounds[other][1]
        return f"the {shortest}, at least {least:.6g} mm, cannot be the shortest link, as the {other} is at most {most:.6g} mm"
    left, right = (
        " + ".join(f"{name} {1e3 * bounds[name][side]:.6g}" for name in names)
        for side, names in enumerate((violation.left, violation.right))
    )
    return f"{left} > {right} mm"


def _remedies(bounds: Bounds, shortest: str, free: set[str], least_angle: float) -> list[str]:
    """Return the bounds to change so that no inequality fails; none if none are found."""
    changed = dict(bounds)
    shown: dict[str, str] = {}
    while (violation := _violation(changed, shortest)) is not None and len(shown) < len(LENGTHS):
        name, value = next(_changes(violation, changed, free, least_angle), ("", math.nan))
        if not name:
            return []
        upper = name in violation.right
        changed[name] = (changed[name][0], value) if upper else (value, changed[name][1])
        shown[name] = f"a {name} of {'at least' if upper else 'at most'} {1e3 * value:.6g} mm"
    return list(shown.values())


def _changes(violation: Violation, bounds: Bounds, free: set[str], least_angle: float) -> Iterator[tuple[str, float]]:
    """Yield lengths with the value that satisfies an inequality: free ones first, then the least relative change."""
    names = sorted((*violation.left, *violation.right), key=lambda name: (name not in free, -max(bounds[name])))
    for name in names:
        upper = name in violation.right
        extra = INSIDE * max(high for _, high in bounds.values())
        for _ in range(40):
            value = bounds[name][1] + violation.excess + extra if upper else bounds[name][0] - violation.excess - extra
            value = _outward(value, upper)
            if value <= 0.0:
                break
            corner = {one: bounds[one][0 if one in violation.left else 1] for one in LENGTHS} | {name: value}
            if len(violation.left) == 1 or _angle(violation, corner) >= least_angle:
                yield name, value
                break
            extra *= 1.5


def _angle(violation: Violation, sizes: Mapping[str, float]) -> float:
    """Return the angle of coupler and rocker off alignment where the inequality is nearest to failing; -1 if they do not meet."""
    crank, coupler, rocker, frame = (sizes[name] for name in LENGTHS)
    gap = frame + crank if {"crank", "frame"} in (set(violation.left), set(violation.right)) else abs(frame - crank)
    cosine = abs(coupler**2 + rocker**2 - gap**2) / (2.0 * coupler * rocker)
    return math.acos(cosine) if cosine <= 1.0 else -1.0


def _outward(value: float, upper: bool) -> float:
    """Return a length with few digits [m], rounded so that the bound becomes wider."""
    rounding = ROUND_CEILING if upper else ROUND_FLOOR
    return float(Context(DIGITS, rounding).create_decimal_from_float(1e3 * value)) * 1e-3
