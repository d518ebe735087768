"""Check whether a result file agrees with its design: objective, angles and figures are recomputed."""

import math
from collections.abc import Iterator, Mapping
from typing import Any, TypeGuard

from optlink.validation.check import Check

SHARE, FLOOR = 1e-5, 1e-16
"""Relative and absolute [SI] difference that two computations of one objective may have."""

FIGURE = 1e-9
"""Absolute difference, in its display unit, that two computations of one figure of a machine may have."""

LENGTH = 1e-6
"""Absolute difference [mm] that a length of the design may have."""

ANGLE = 0.05
"""Difference [deg] that two computations of one angle may have."""


def contradictions(recorded: Mapping[str, Any], computed: Mapping[str, Any]) -> tuple[Check, ...]:
    """Return the failed checks: values of a result file that differ from those of the recomputed document of its design."""
    documents = recorded, computed
    checks = []
    for both in (documents, tuple(map(_best, documents))):  # the result states the objective of its best design too
        theirs, ours = map(_objective, both)
        if theirs is not None and ours is not None and not abs(theirs - ours) <= SHARE * max(abs(theirs), abs(ours)) + FLOOR:
            checks.append(Check("objective of the result file", False, theirs, f"= {ours:.9g}", ""))
            break
    angles = _angles(computed)
    pairs = [(f"{key} of the result file", value, angles.get(key)) for key, value in _angles(recorded).items()]
    at = [_part(_best(document), "points").get("crank_deg") for document in documents]
    largest = _part(_best(computed), "objective").get("measure") == "max"  # other points may then be passed at many crank angles
    if not largest and all(isinstance(values, list) for values in at):
        pairs += [(f"crank angle of point {k} in the result file", *both) for k, both in enumerate(zip(*at, strict=False), 1)]
    for name, value, expected in pairs:
        if _number(value) and _number(expected) and not abs((value - expected + 180.0) % 360.0 - 180.0) <= ANGLE:
            checks.append(Check(name, False, float(value), f"= {expected:.9g}", "deg"))
    return (*checks, *_lengths(recorded, computed), *_figures(recorded, computed))


def _angles(document: Mapping[str, Any]) -> dict[str, Any]:
    """Return the angles [deg] of the design, and the crank angles of its strokes."""
    angles = {key: value for key, value in _part(document, "design").items() if key.endswith("_deg")}
    for output, strokes in _part(document, "strokes").items():
        for name in ("forward", "backward"):
            stroke = _part(strokes, name) if isinstance(strokes, dict) else {}
            angles |= {f"{key} of {output} {name}": value for key, value in stroke.items() if key.endswith("_deg")}
    return angles


def _lengths(recorded: Mapping[str, Any], computed: Mapping[str, Any]) -> Iterator[Check]:
    """Yield lengths for which the problem prescribes another value."""
    ours = _part(computed, "design")
    for key, value in _part(recorded, "design").items():
        other = ours.get(key)
        if key.endswith("_mm") and _number(value) and _number(other) and not abs(value - other) <= SHARE * abs(other) + LENGTH:
            yield Check(f"{key} of the result file", False, float(value), f"= {other:.9g}", "mm")


def _figures(recorded: Mapping[str, Any], computed: Mapping[str, Any]) -> Iterator[Check]:
    """Yield figures of a machine, matched by name, that differ from those of the design."""
    theirs, ours = (_by_name(document.get("figures")) for document in (recorded, computed))
    for name in theirs.keys() & ours.keys():
        row, unit = ours[name], ours[name].get("unit")
        value, expected, start = theirs[name].get("result"), row.get("result"), row.get("initial")
        if not (_number(value) and _number(expected)) or theirs[name].get("unit") != unit:
            continue
        size = max(abs(value), abs(expected), abs(start) if _number(start) else 0.0)
        if not abs(value - expected) <= SHARE * size + FIGURE:
            words = f"{row.get('words', name)} of the result file"
            yield Check(words, False, float(value), f"= {expected:.9g}", str(unit or ""))


def _by_name(rows: object) -> dict[str, dict[str, Any]]:
    entries = rows if isinstance(rows, list) else []
    return {str(row["name"]): row for row in entries if isinstance(row, dict) and "name" in row and row["name"] != "objective"}


def _best(document: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return the part about the best design, or the nearest miss; the document itself if it is about one design."""
    designs = document.get("designs")
    if isinstance(designs, list) and designs and isinstance(designs[0], dict):
        return designs[0]
    return _part(document, "nearest_miss") or document


def _objective(document: Mapping[str, Any]) -> float | None:
    objective = document.get("objective")
    value = objective.get("value") if isinstance(objective, dict) else objective
    return float(str(value)) if _number(value) else None


def _part(document: Mapping[str, Any], key: str) -> Mapping[str, Any]:
    part = document.get(key)
    return part if isinstance(part, dict) else {}


def _number(value: object) -> TypeGuard[float]:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
