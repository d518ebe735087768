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
    """Return the failed checks: values of a result file that differ from those of its design.

    Parameters
    ----------
    recorded : mapping
        Document of the file.
    computed : mapping
        Recomputed document of the same design.
    """
    checks = []
    theirs, ours = _objective(recorded), _objective(computed)
    if theirs is not None and ours is not None and not abs(theirs - ours) <= SHARE * max(abs(theirs), abs(ours)) + FLOOR:
        checks.append(Check("objective of the result file", False, theirs, f"= {ours:.9g}", ""))
    ours_by_key = _angles(computed)
    pairs = [(f"{key} of the result file", value, ours_by_key.get(key)) for key, value in _angles(recorded).items()]
    theirs_at, ours_at = (_part(_best(one), "points").get("crank_deg") for one in (recorded, computed))
    if isinstance(theirs_at, list) and isinstance(ours_at, list):
        pairs += [(f"crank angle of point {k + 1} in the result file", *both) for k, both in enumerate(zip(theirs_at, ours_at))]  # noqa: B905
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
        recorded_value, computed_value = theirs[name].get("result"), ours[name].get("result")
        if not (_number(recorded_value) and _number(computed_value)) or theirs[name].get("unit") != ours[name].get("unit"):
            continue
        start = ours[name].get("initial")
        size = max(abs(recorded_value), abs(computed_value), abs(start) if _number(start) else 0.0)
        if not abs(recorded_value - computed_value) <= SHARE * size + FIGURE:
            words = f"{ours[name].get('words', name)} of the result file"
            yield Check(words, False, float(recorded_value), f"= {computed_value:.9g}", str(ours[name].get("unit") or ""))


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
    objective = _best(document).get("objective")
    value = objective.get("value") if isinstance(objective, dict) else objective
    return float(str(value)) if _number(value) else None


def _part(document: Mapping[str, Any], key: str) -> Mapping[str, Any]:
    part = document.get(key)
    return part if isinstance(part, dict) else {}


def _number(value: object) -> TypeGuard[float]:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
