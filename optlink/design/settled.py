"""A problem with every size settled: the machine alone, as a file that `analyze`, `simulate` and pictures take."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from typing import Any

from optlink.design.files import ProblemFile, read
from optlink.design.linkages import FourBarSection
from optlink.linkage.fourbar import LENGTHS
from optlink.units import KINDS, factor

ASKED = ("requirement", "objective", "limits", "expected")
"""Sections that say what is wanted; without them a problem is a machine."""


def settled(file: ProblemFile, values: Mapping[str, float]) -> ProblemFile:
    """The machine of a problem with its sizes [SI] written as fixed values, and nothing that is wanted of it."""
    raw: dict[str, Any] = copy.deepcopy({key: value for key, value in file.raw.items() if key not in ASKED})
    four_bar = isinstance(file.model.mechanism, FourBarSection)
    for name, quantity in file.model.mechanism.quantities.items():
        unit = KINDS[quantity.kind].people
        _write(raw["mechanism"], name, f"{values[name] / factor(unit, quantity.kind)!r} {unit}", four_bar=four_bar)
    return read(raw, file.name, file.file, file.folder)


def _write(mechanism: dict[str, Any], name: str, text: str, *, four_bar: bool) -> None:
    """Write one quantity in the section that it comes from."""
    parts = name.split(".")
    if four_bar:
        if name in (*LENGTHS, "direction"):
            mechanism[name] = text
        elif parts[0] == "A":
            place = list(mechanism.get("pivot") or ["0 mm", "0 mm"])
            place["xy".index(parts[1])] = text
            mechanism["pivot"] = place
        else:
            mechanism["points"][parts[0]][("along", "across").index(parts[1])] = text
    elif len(parts) == 3:
        mechanism["links"][parts[0]]["points"][parts[1]][("along", "across").index(parts[2])] = text
    elif parts[1] == "length":
        mechanism["links"][parts[0]]["length"] = text
    elif parts[0] in mechanism["ground"]:
        mechanism["ground"][parts[0]]["xy".index(parts[1])] = text
    elif parts[1] in ("x", "y"):
        mechanism["guides"][parts[0]]["through"]["xy".index(parts[1])] = text
    else:
        mechanism["guides"][parts[0]][parts[1]] = text
