"""A problem with every size settled: the machine alone, as a file that `analyze`, `simulate` and pictures take."""

from __future__ import annotations

import copy
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from optlink.linkage.fourbar import LENGTHS
from optlink.problem.file import ProblemFile, read
from optlink.problem.targets.target_points import contents
from optlink.problem.tolerances import read_stated
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


def portable(file: ProblemFile) -> tuple[ProblemFile, dict[str, bytes]]:
    """The problem with every CSV or SVG file that it refers to renamed to one beside it, and the contents of these files by name.

    Raises
    ------
    Unusable
        when a file cannot be read any more.
    """
    raw: dict[str, Any] = copy.deepcopy(dict(file.raw))
    files: dict[str, bytes] = {}
    for table, key, suffix in [*_references(raw)]:
        named = read_stated(table[key], file.folder).text if suffix == "" else table[key]
        suffix = suffix or "csv"
        data = contents({suffix: named}, suffix, file.folder)[1]
        stem = f"design-{Path(named).stem[:60].lower()}"
        name, number = f"{stem}.{suffix}", 1
        while files.get(name, data) != data:
            number += 1
            name = f"{stem}-{number}.{suffix}"
        files[name], table[key] = data, name
    return replace(file, raw=raw), files


def _references(raw: Any, within: str = "") -> Iterator[tuple[dict[str, Any], str, str]]:
    """Tables and keys that name another file, with its suffix; "" where the value of a tolerance decides it."""
    if isinstance(raw, list):
        for value in raw:
            yield from _references(value, within)
    for key, value in raw.items() if isinstance(raw, dict) else ():
        if isinstance(value, str):
            measured = within == "tolerances" and read_stated(value, Path()).measured
            if measured or key in ("csv", "svg"):
                yield raw, key, "" if measured else key
        else:
            yield from _references(value, within or key)


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
