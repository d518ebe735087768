"""The problem with all design variables fixed at a given design: a machine for `analyze`, `simulate` and pictures."""

import copy
import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from optlink.linkage.fourbar import LENGTHS
from optlink.linkage.vector2d import TURN
from optlink.problem.enclosed import references
from optlink.problem.file import ProblemFile
from optlink.problem.machine.model import Problem
from optlink.problem.targets.target_points import split_enclosed
from optlink.problem.tolerances import read_tolerance

REQUIREMENTS = ("requirement", "requirements", "objective", "limits", "expected")
"""Sections that state requirements; without them a problem is a machine."""


def fixed_design(file: ProblemFile, values: Mapping[str, float]) -> ProblemFile:
    """Return the machine of a problem with fixed quantities, without requirement, objective and limits.

    Parameters
    ----------
    values : mapping of str to float [m, rad]
        Value of every quantity of the mechanism.
    """
    file = file.override(file.located) if file.located else file  # a mode by the place of a joint is that of the start
    raw: dict[str, Any] = copy.deepcopy({key: value for key, value in file.raw.items() if key not in REQUIREMENTS})
    for name, quantity in file.model.mechanism.quantities.items():
        write(raw["mechanism"], name, f"{values[name] / quantity.si_per_unit!r} {quantity.display[1]}")
    return file.with_tables(raw)


def started(machine: ProblemFile, begin: float, way: float) -> ProblemFile:
    """Return a machine with another start of its crank.

    Parameters
    ----------
    begin : float [rad]
        Crank angle at the start; the machine is returned unchanged if it is not finite.
    way : float
        The sign of the crank speed; 0 for that of the machine.
    """
    if not math.isfinite(begin):
        return machine
    speed = math.copysign(machine.model.drive.speed.value, way) if way else machine.model.drive.speed.value
    return machine.override({"drive.start": f"{math.remainder(begin, TURN)!r} rad", "drive.speed": f"{speed!r} rad/s"})


def with_files_beside(file: ProblemFile) -> tuple[ProblemFile, dict[str, bytes]]:
    """Return the problem with every CSV or SVG file renamed to one beside it, and the contents of these files by name."""
    raw: dict[str, Any] = copy.deepcopy(dict(file.raw))
    files: dict[str, bytes] = {}
    for table, key, suffix in [*references(raw)]:
        source = table[key] if suffix else read_tolerance(table[key], file.folder).source
        name_in_file, content = split_enclosed(source)
        data, path = (content or file.files[name_in_file]).encode(), Path(name_in_file)
        stem, suffix_ = f"design-{path.stem[:60].lower()}", suffix or "csv"
        name, number = f"{stem}.{suffix_}", 1
        while files.get(name, data) != data:
            number += 1
            name = f"{stem}-{number}.{suffix_}"
        files[name], table[key] = data, name
    return replace(file, raw=raw), files


def write(mechanism: dict[str, Any], name: str, value: object) -> None:
    """Write one quantity into the section [mechanism] at its place.

    Parameters
    ----------
    mechanism : dict
        Section [mechanism] as nested tables, modified in place.
    name : str
        Name of the quantity.
    value : object
        New value as in a TOML file.
    """
    table, key = place_of(mechanism, name)
    table[key] = value


def place_of(mechanism: dict[str, Any], name: str) -> tuple[Any, str | int]:
    """Return the table or list of the section [mechanism] that contains a quantity, and its key or index there.

    Parameters
    ----------
    mechanism : dict
        Section [mechanism] as nested tables; a pivot that is not stated is added.
    name : str
        Name of the quantity.
    """
    *steps, last = key_path(mechanism, name)
    if steps == ["pivot"]:
        mechanism["pivot"] = list(mechanism.get("pivot") or ["0 mm", "0 mm"])
    table: Any = mechanism
    for step in steps:
        table = table[step]
    return table, last


def key_path(mechanism: Mapping[str, Any], name: str) -> list[str | int]:
    """Return the path of a quantity in the section [mechanism]: keys, and the index of a coordinate.

    Parameters
    ----------
    mechanism : mapping
        Section [mechanism] as nested tables.
    name : str
        Name of the quantity.
    """
    parts = name.split(".")
    if "links" not in mechanism:  # four-bar
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


def file_key(mechanism: Mapping[str, Any], name: str) -> str:
    """Return the dotted key of a quantity in the problem file.

    Parameters
    ----------
    mechanism : mapping
        Section [mechanism] as nested tables.
    name : str
        Name of the quantity.
    """
    steps = key_path(mechanism, name)
    if isinstance(steps[-1], int):
        steps[-1] = name.rpartition(".")[2]
    return ".".join(("mechanism", *map(str, steps)))


def quantity_key(problem: Problem, name: str) -> str:
    """Return the dotted key of a quantity of a problem in its file.

    Parameters
    ----------
    name : str
        Name of the quantity.
    """
    if name.startswith("tolerances."):
        return name
    for part in getattr(problem, "parts", ()):
        if part.prefix and name.startswith(part.prefix):
            return str(part.key) + quantity_key(part, name.removeprefix(part.prefix)).removeprefix("requirement")
    if name in ("psi0", "start", "mark", "zero"):
        return "requirement.psi0" if name == "zero" and not getattr(problem, "slides", True) else f"requirement.{name}"
    return "requirement.from" if name == "phi0" else file_key(vars(problem.mechanism), name)
