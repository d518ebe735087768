"""Whether a result file agrees with the design in it: objective and angles against those that are computed from the design."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from optlink.validation.check import Check

SHARE, FLOOR = 1e-5, 1e-16
"""Relative and absolute [SI] difference that two computations of one objective may have."""

ANGLE = 0.05
"""Difference [deg] that two computations of one angle may have."""


def contradictions(recorded: Mapping[str, Any], computed: Mapping[str, Any]) -> tuple[Check, ...]:
    """Checks that fail: figures of a result file that its design does not have.

    Parameters
    ----------
    recorded : mapping
        The document of the file.
    computed : mapping
        The document of the same design, computed anew.
    """
    found = []
    theirs, ours = _objective(recorded), _objective(computed)
    if theirs is not None and ours is not None and not abs(theirs - ours) <= SHARE * max(abs(theirs), abs(ours)) + FLOOR:
        found.append(Check("objective of the result file", False, theirs, f"= {ours:.9g}", ""))
    pairs = [(f"{key} of the result file", value, _part(computed, "design").get(key)) for key, value in _angles(recorded)]
    theirs_at, ours_at = (_part(_best(one), "points").get("crank_deg") for one in (recorded, computed))
    if isinstance(theirs_at, list) and isinstance(ours_at, list):
        pairs += [(f"crank angle of point {k + 1} in the result file", *both) for k, both in enumerate(zip(theirs_at, ours_at))]  # noqa: B905
    for name, value, expected in pairs:
        if _number(value) and _number(expected) and not abs((value - expected + 180.0) % 360.0 - 180.0) <= ANGLE:
            found.append(Check(name, False, float(value), f"= {expected:.9g}", "deg"))
    return tuple(found)


def _angles(document: Mapping[str, Any]) -> list[tuple[str, Any]]:
    return [(key, value) for key, value in _part(document, "design").items() if key.endswith("_deg")]


def _best(document: Mapping[str, Any]) -> Mapping[str, Any]:
    """The part about the best design, or the nearest miss; the document itself where it is about one design."""
    designs = document.get("designs")
    if isinstance(designs, list) and designs and isinstance(designs[0], dict):
        return designs[0]
    return _part(document, "nearest_miss") or document


def _objective(document: Mapping[str, Any]) -> float | None:
    objective = _best(document).get("objective")
    value = objective.get("value") if isinstance(objective, dict) else objective
    return float(str(value)) if _number(value) else None


def _part(document: Mapping[str, Any], key: str) -> Mapping[str, Any]:
    found = document.get(key)
    return found if isinstance(found, dict) else {}


def _number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
