"""Curves sampled evenly by arc length, and curves defined by expressions in t."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from optlink.linkage.vector2d import Array
from optlink.problem.quantity import LONGEST, SHORTEST, Unusable, below, check_pair, is_number
from optlink.problem.targets.expression import Expression, LawError, parse
from optlink.problem.targets.point_table import PointRows, check_apart
from optlink.problem.targets.target_points import COINCIDENT, HEAVIEST, TargetPoints, metres, pairs, read_count, shortened
from optlink.units import show

FINE = 100_000  # chords that approximate a curve; for a full circle the length error is 2e-10


@dataclass(frozen=True)
class CurvePiece:
    """A piece of a curve: `at` returns its points (n, 2) [m] at u (n,) from 0 to 1; `chords` chords approximate it."""

    at: Callable[[Array], Array]
    chords: int


def resample(pieces: Sequence[CurvePiece], count: int) -> tuple[Array, bool, float]:
    """Return points (count, 2) [m] exactly on a curve, evenly by arc length, whether it is closed, and its length [m].

    The first point of a closed curve is not repeated.

    Raises
    ------
    Unusable
        when the curve is too large or has no length.
    """
    traced = [piece.at(np.linspace(0.0, 1.0, piece.chords + 1)) for piece in pieces]
    chords = np.concatenate([np.hypot(*np.diff(points, axis=0).T) for points in traced])
    starts = np.concatenate([[0], np.cumsum([piece.chords for piece in pieces])])
    here = np.concatenate([[0.0], np.cumsum(chords)])
    low = np.min([points.min(axis=0) for points in traced], axis=0)
    high = np.max([points.max(axis=0) for points in traced], axis=0)
    size = float(np.hypot(*(high - low)))
    if not max(np.max(np.abs(low)), np.max(np.abs(high))) <= LONGEST:  # NaN too
        raise Unusable("the curve is too large for a linkage", "Check its numbers and its unit")
    if size < SHORTEST:
        raise Unusable("the curve has no length", "Check its numbers and its unit")
    loop = bool(np.hypot(*(traced[-1][-1] - traced[0][0])) <= COINCIDENT * size)
    targets = np.linspace(0.0, here[-1], count, endpoint=not loop)
    index = np.clip(np.searchsorted(here, targets, side="right") - 1, 0, len(chords) - 1)
    fraction = (targets - here[index]) / np.where(chords[index] > 0.0, chords[index], 1.0)
    piece = np.clip(np.searchsorted(starts, index, side="right") - 1, 0, len(pieces) - 1)
    u = np.clip([(i - starts[p] + f) / pieces[p].chords for i, f, p in zip(index, fraction, piece, strict=True)], 0.0, 1.0)
    return np.concatenate([pieces[p].at(at[None]) for p, at in zip(piece, u, strict=True)]), loop, float(here[-1])


def sampled_targets(points: Array, unit: str, loop: bool, note: str) -> TargetPoints:
    """Return points (n, 2) [m] sampled from a curve as targets; `loop`: the curve is closed."""
    check_apart(PointRows(dict(zip("xy", points.T, strict=True)), unit, key="points"))
    return TargetPoints(pairs(points), unit=unit, note=f"{note}; closed, the first is not repeated" if loop else note, loop=loop)


def expression_curve(raw: Mapping[str, Any]) -> TargetPoints:
    """Return points of a curve whose coordinates are expressions in t.

    Raises
    ------
    Unusable
        If a key is missing or invalid, or an expression is not finite or too large in the range of t.
    """
    for key, example in (("x", '"20*cos(t)"'), ("y", '"10*sin(t)"'), ("t", '[0, "2*pi"]'), ("unit", '"mm"')):
        if key not in raw:
            remedy = f'Add {key} = {example}; listed points are written [["20 mm", "25 mm"], ...]'
            raise Unusable(f"expressions of points need {key}", remedy, key)
    unit, size, count = raw["unit"], metres(raw), read_count(raw)
    spacing = raw.get("spacing", "t")
    if spacing not in ("t", "arc length"):
        raise Unusable("unknown spacing of the points", 'Write "t" or "arc length"', "spacing", spacing)
    x, y = (_expression(raw[key], ("t",), key) for key in ("x", "y"))
    bounds = raw["t"]
    check_pair(bounds, "t needs two values, first and last", 'Write t = [0, "2*pi"]', "t")
    begin, end = (_bound(bound, f"t[{number}]") for number, bound in enumerate(bounds))
    if begin == end:
        raise Unusable("t starts where it ends", 'Write t = [0, "2*pi"], for example', "t[1]", bounds[1])
    fine = np.linspace(begin, end, FINE + 1)
    for key, law in (("x", x), ("y", y)):
        worry = law.hazards({"t": fine})
        if not worry and np.max(np.abs(np.asarray(law({"t": fine}), dtype=float))) * size > LONGEST:
            worry = f"exceeds {LONGEST / 1e3:g} km"
        if worry:
            message = f"{key} {worry} between t = {begin:.6g} and t = {end:.6g}"
            raise Unusable(message, "Choose another range of t", key, shortened(raw[key]))

    def at(u: Array) -> Array:
        variables = {"t": begin + (end - begin) * u}
        return np.stack([np.broadcast_to(np.asarray(law(variables), dtype=float), u.shape) for law in (x, y)], axis=1) * size

    points, loop, length = resample([CurvePiece(at, FINE)], count)
    if spacing == "t":
        points = at(np.linspace(0.0, 1.0, count, endpoint=not loop))
    note = f"a curve {show(length, 'length', unit)} long, sampled at {count} points evenly by {spacing}"
    return sampled_targets(points, unit, loop, note)


def _expression(raw: object, names: Iterable[str], key: str) -> Expression:
    if not isinstance(raw, str):
        raise Unusable("an expression is text", f'Write {key} = "20*cos(t)", for example', key, raw)
    with below(key, shortened(raw)):
        return parse(raw, names)


def _bound(raw: object, key: str) -> float:
    remedy = 'Write a plain number or a constant expression, for example 0 or "2*pi"'
    value: Any = raw
    if isinstance(raw, str):
        try:
            value = parse(raw, ())({})
        except LawError as error:
            raise Unusable(error.message, remedy, key, shortened(raw)) from None
    elif not is_number(raw):
        raise Unusable("expected a bound of t", remedy, key, raw)
    if not abs(value) <= HEAVIEST:  # NaN too
        raise Unusable("the bound of t is not finite, or too large", remedy, key, shortened(raw))
    return float(value)
