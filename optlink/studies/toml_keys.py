"""Values at keys of a problem file, as a study writes them there."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from optlink.problem.file import ProblemFile

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
