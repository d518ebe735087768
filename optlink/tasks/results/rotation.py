"""Bounds that let no crank turn: the inequality of Grashof that fails for all sizes, and which bound to change."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping
from typing import NamedTuple

from optlink.linkage.dyad_types import RRP
from optlink.linkage.fourbar import LENGTHS
from optlink.linkage.inner_four_bar import InnerFourBar, inner_four_bars, whole_four_bar
from optlink.linkage.mechanism import FRAME, Link, Mechanism
from optlink.problem.quantity import Quantity
from optlink.tasks.results.conflict import DIGITS, rounded

SHORTEST = {"full rotation": ("crank",), "double-crank": ("frame",), "": ("crank", "frame")}
"""Possible shortest links by `limits.crank`; empty: without this limit."""
INSIDE = 1e-4  # share of the longest link by which a changed bound goes beyond the least change, at first


class Length(NamedTuple):
    """A length between two bounds [m], with its name for display."""

    name: str
    low: float
    high: float
    free: bool = True


class Violation(NamedTuple):
    """An inequality sum(`left`) <= sum(`right`) of link lengths that no sizes within the bounds satisfy; `excess` [m]."""

    left: tuple[str, ...]
    right: tuple[str, ...]
    excess: float


Loop = Mapping[str, Length]  # by the names of `LENGTHS`


def cannot_turn(quantities: Mapping[str, Quantity], mechanism: Mechanism, crank: str, least_angle: float) -> tuple[str, ...]:
    """Return a sentence that no sizes within the bounds let the crank turn, with the change that does; else nothing.

    The first loop of the mechanism decides: crank, a link, and a link or slider on the frame. `quantities` are the dimensions,
    `crank` is `limits.crank` of the problem, empty if it has none; `least_angle` [rad] is the least angle of the two links of a
    joint off alignment.
    """
    if crank not in SHORTEST:
        return ()
    inversion = "" if whole_four_bar(mechanism) is None else crank
    loops = {four_bar.joint: four_bar for four_bar in inner_four_bars(mechanism)}
    for group in mechanism.groups:
        reason = ""
        if group.joint in loops and (loop := _four_bar(loops[group.joint], quantities)) is not None:
            reason = four_bar_conflict(loop, inversion, least_angle)
        elif isinstance(group, RRP):
            reason = _slider_conflict(group, mechanism, quantities, least_angle)
        if reason:
            span = ', or write limits.crank = "span"' * bool(crank)
            return (f"no sizes within the bounds let the crank turn: {reason}{span}",)
    return ()


def _length(link: Link, ends: set[str], quantities: Mapping[str, Quantity]) -> Length | None:
    """Return the length of a link between two of its joints; None if it is not one quantity."""
    quantity = quantities.get(str(link.length)) if {link.start, link.end} == ends else None
    return None if quantity is None else Length(link.body, *quantity.bounds, quantity.free)


def _four_bar(four_bar: InnerFourBar, quantities: Mapping[str, Quantity]) -> Loop | None:
    """Return the lengths of a four-bar; None if they are not those of its links."""
    places = (four_bar.frame_length,) if four_bar.frame_length else four_bar.ground
    if not four_bar.plain or not {*four_bar.names, *places} <= quantities.keys():
        return None
    bodies = (link.body for link in (four_bar.crank, four_bar.coupler, four_bar.rocker))
    each = ((body, quantities[name]) for body, name in zip(bodies, four_bar.names, strict=True))
    low, high = four_bar.frame_bounds({name: quantity.bounds for name, quantity in quantities.items()})
    frame = four_bar.frame_length or f"distance {four_bar.crank.start}-{four_bar.ground_pin}"
    lengths = [Length(body, *quantity.bounds, quantity.free) for body, quantity in each]
    return dict(zip(LENGTHS, [*lengths, Length(frame, low, high, any(quantities[name].free for name in places))], strict=True))


def _slider_conflict(group: RRP, mechanism: Mechanism, quantities: Mapping[str, Quantity], least_angle: float) -> str:
    """Return why the crank of a slider-crank cannot turn: crank and offset are longer than the rod; else an empty text."""
    (pin, guide), crank = group.outer, mechanism.crank
    own = crank.end == pin and guide.on == FRAME and guide.through == crank.start and guide.tilt == 0.0
    short, rod = (_length(link, {link.start, link.end}, quantities) for link in (crank, group.first))
    offset = quantities.get(str(guide.offset))
    if not own or short is None or rod is None or {group.first.start, group.first.end} != {pin, group.inner}:
        return ""
    low, high = (0.0, 0.0) if offset is None else offset.bounds
    aside = max(0.0, low, -high)
    if short.low + aside <= rod.high:
        return ""
    lengths = f"{short.name} {1e3 * short.low:.6g}" + f" + offset {1e3 * aside:.6g}" * (aside > 0.0)
    longer = _outward((short.low + aside) / math.cos(least_angle) * (1.0 + INSIDE), True)
    return f"{lengths} > {rod.name} {1e3 * rod.high:.6g} mm. Allow a {rod.name} of at least {1e3 * longer:.6g} mm"


def four_bar_conflict(loop: Loop, crank: str, least_angle: float) -> str:
    """Return which inequality of Grashof fails for all sizes, and the change that helps; empty if none does."""
    missed = [(shortest, violation) for shortest in SHORTEST[crank] if (violation := _violation(loop, shortest)) is not None]
    if len(missed) < len(SHORTEST[crank]):
        return ""
    ways = [(_remedies(loop, shortest, least_angle), violation) for shortest, violation in missed]
    remedies, violation = min(ways, key=lambda way: len(way[0]) or len(LENGTHS))
    remedy = f"Allow {' and '.join(remedies)}" if remedies else "Widen several bounds"
    return f"{_inequality(violation, loop)}. {remedy}"


def _violation(loop: Loop, shortest: str) -> Violation | None:
    """Return the inequality that fails for all sizes; the simplest one, else the one missed by most."""
    others = [name for name in LENGTHS if name != shortest]
    for count in (1, 2):
        found = []
        for right in itertools.combinations(others, count):
            left = (shortest, *(name for name in others if count == 2 and name not in right))
            excess = sum(loop[name].low for name in left) - sum(loop[name].high for name in right)
            if excess > 0.0:
                found.append(Violation(left, right, excess))
        if found:
            return max(found, key=lambda violation: violation.excess)
    return None


def _inequality(violation: Violation, loop: Loop) -> str:
    if len(violation.left) == 1:
        shortest, other = loop[violation.left[0]], loop[violation.right[0]]
        least, most = 1e3 * shortest.low, 1e3 * other.high
        between = f"cannot be the shortest link, as the {other.name} is at most {most:.6g} mm"
        return f"the {shortest.name}, at least {least:.6g} mm, {between}"
    left = " + ".join(f"{loop[name].name} {1e3 * loop[name].low:.6g}" for name in violation.left)
    right = " + ".join(f"{loop[name].name} {1e3 * loop[name].high:.6g}" for name in violation.right)
    return f"{left} > {right} mm"


def _remedies(loop: Loop, shortest: str, least_angle: float) -> list[str]:
    """Return the bounds to change so that no inequality fails; none if none are found."""
    changed = dict(loop)
    shown: dict[str, str] = {}
    while (violation := _violation(changed, shortest)) is not None and len(shown) < len(LENGTHS):
        role, value = next(_changes(violation, changed, least_angle), ("", math.nan))
        if not role:
            return []
        upper = role in violation.right
        changed[role] = changed[role]._replace(high=value) if upper else changed[role]._replace(low=value)
        shown[role] = f"a {changed[role].name} of {'at least' if upper else 'at most'} {1e3 * value:.6g} mm"
    return list(shown.values())


def _changes(violation: Violation, loop: Loop, least_angle: float) -> Iterator[tuple[str, float]]:
    """Yield lengths with the value that satisfies an inequality: free ones first, then the least relative change."""
    for role in sorted((*violation.left, *violation.right), key=lambda role: (not loop[role].free, -loop[role].high)):
        upper = role in violation.right
        extra = INSIDE * max(length.high for length in loop.values())
        for _ in range(40):
            change = violation.excess + extra
            value = _outward(loop[role].high + change if upper else loop[role].low - change, upper)
            if value <= 0.0:
                break
            corner = {one: loop[one].low if one in violation.left else loop[one].high for one in LENGTHS} | {role: value}
            if len(violation.left) == 1 or _angle(violation, corner) >= least_angle:
                yield role, value
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
    return rounded(1e3 * value, DIGITS, upper) * 1e-3
