"""The problem with all design variables fixed at a given design: a machine for `analyze`, `simulate` and pictures."""

import copy
import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from optlink.linkage.vector2d import TURN
from optlink.problem.enclosed import references
from optlink.problem.file import ProblemFile
from optlink.problem.quantity_keys import write
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
