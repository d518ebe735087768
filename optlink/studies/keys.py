"""Keys of a problem file that a study changes: those of the file, and `.min` and `.max` of a range or of a free quantity."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from optlink.design.files import ProblemFile

SIDES = ("min", "max")
Raw = str | float | int


def text(value: float, unit: str) -> Raw:
    """A value as problem files state it, every digit of it."""
    if unit:
        return f"{float(value)!r} {unit}"
    return int(value) if float(value).is_integer() and abs(value) < 1e15 else value


def raw_at(problem: ProblemFile, key: str) -> Any:
    """What the file says at a key; None where it says nothing."""
    found: Any = problem.raw
    for step in key.split("."):
        if not isinstance(found, Mapping) or step not in found:
            return None
        found = found[step]
    return found


def changed(problem: ProblemFile, values: Mapping[str, Raw]) -> ProblemFile:
    """The problem with other values at keys, `limits.transmission_angle.max` and `mechanism.coupler.min` among them.

    Raises
    ------
    InputError
        as for `--set`.
    """
    changes: dict[str, Any] = {}
    for key, value in values.items():
        above, _, side = key.rpartition(".")
        whole = changes.get(above, raw_at(problem, above)) if side in SIDES else None
        if isinstance(whole, list) and len(whole) == 2:
            changes[above] = _side(whole, side, value)
        elif isinstance(whole, Mapping) and "bounds" in whole:
            changes[above] = {**whole, "bounds": _side(whole["bounds"], side, value)}
        elif isinstance(whole, Mapping):
            changes[above] = {**whole, side: value}
        elif whole is not None:
            changes[above] = _side([whole, whole], side, value)
        else:
            changes[key] = value
    return problem.override(changes)


def _side(pair: list[Any], side: str, value: Raw) -> list[Any]:
    return [value, pair[1]] if side == "min" else [pair[0], value]


def begun(problem: ProblemFile, design: Mapping[str, float]) -> ProblemFile:
    """The problem with its free quantities starting at a design [SI], as far as the file states them."""
    from optlink.solvers.solution import key_of
    from optlink.units import KINDS

    changes: dict[str, Any] = {}
    for name, value in design.items():
        key = key_of(name)
        raw, quantity = raw_at(problem, key), problem.spec.quantities[name]
        if isinstance(raw, Mapping) and "bounds" in raw:
            low, high = quantity.bounds
            changes[key] = {**raw, "start": text(min(max(value, low), high), KINDS[quantity.kind].si)}
    return problem.override(changes) if changes else problem
