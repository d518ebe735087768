"""A problem with every size settled: the machine alone, as a file that `analyze`, `simulate` and pictures take."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from typing import Any

from optlink.design.files import ProblemFile, read
from optlink.linkage.fourbar import LENGTHS
from optlink.units import KINDS, factor

ASKED = ("requirement", "objective", "limits", "expected")
"""Sections that say what is wanted; without them a problem is a machine."""


def settled(file: ProblemFile, values: Mapping[str, float]) -> ProblemFile:
    """The machine of a problem with its sizes [SI] written as fixed values, and nothing that is wanted of it."""
    raw: dict[str, Any] = copy.deepcopy({key: value for key, value in file.raw.items() if key not in ASKED})
    for name, quantity in file.model.mechanism.quantities.items():
        unit = KINDS[quantity.kind].people
        write(raw["mechanism"], name, f"{values[name] / factor(unit, quantity.kind)!r} {unit}")
    return read(raw, file.name, file.file, file.folder)


def write(mechanism: dict[str, Any], name: str, value: object) -> None:
    """Write one quantity in the section that it comes from."""
    *steps, last = place(mechanism, name)
    if steps == ["pivot"]:
        mechanism["pivot"] = list(mechanism.get("pivot") or ["0 mm", "0 mm"])
    section: Any = mechanism
    for step in steps:
        section = section[step]
    section[last] = value


def place(mechanism: Mapping[str, Any], name: str) -> list[str | int]:
    """Where a quantity stands in the section [mechanism]: keys, and the number of a coordinate."""
    parts = name.split(".")
    if "links" not in mechanism:  # a four-bar
        if name in (*LENGTHS, "direction"):
            return [name]
        if parts[0] == "A":
            return ["pivot", "xy".index(parts[1])]
        return ["points", parts[0], ("along", "across").index(parts[1])]
    if len(parts) == 3:
        return ["links", parts[0], "points", parts[1], ("along", "across").index(parts[2])]
    if parts[1] == "length":
        return ["links", parts[0], "length"]
    if parts[0] in mechanism["ground"]:
        return ["ground", parts[0], "xy".index(parts[1])]
    if parts[1] in ("x", "y"):
        return ["guides", parts[0], "through", "xy".index(parts[1])]
    return ["guides", *parts]
