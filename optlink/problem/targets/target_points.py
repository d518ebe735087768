"""Points that a path shall pass through, or poses of a body, as they are known once they are read; and what all readers share."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from optlink.problem.quantity import Unusable
from optlink.units import UnitProblem, factor

Array = NDArray[np.float64]

MAX_POINTS = 400
MAX_BYTES = 50_000_000
DEFAULT_POINTS = 60  # of a drawing or an expression
COINCIDENT = 1e-9  # of the size of the whole path
HEAVIEST = 1e9  # of plain numbers, such as weights


@dataclass(frozen=True)
class Wanted:
    """Points [m] that a path shall pass through, in their order; with `angles`, poses of a body.

    `crank`, `angles` [rad]: the crank angle and the angle of the body at each point, None where they are left to the design.
    `weights` of the squared distances, None where all are 1. `tolerances` [m]: the largest distance allowed, inf where none is.
    `unit`: the one that people wrote. `loop`: sampled from a closed curve, whose first point is not repeated at the end.
    `note`: what was done to what the file states, for people.
    """

    points: tuple[tuple[float, float], ...]
    crank: tuple[float, ...] | None = None
    angles: tuple[float, ...] | None = None
    weights: tuple[float, ...] | None = None
    tolerances: tuple[float, ...] | None = None
    unit: str = "mm"
    note: str = ""
    loop: bool = False

    @property
    def size(self) -> float:
        """Diagonal [m] of the rectangle around the points."""
        return diagonal(np.asarray(self.points))


def closed(wanted: Wanted) -> bool:
    """Whether the points go round: sampled from a closed curve, or listed with the last on the first."""
    if wanted.loop:
        return True
    first, last = wanted.points[0], wanted.points[-1]
    return len(wanted.points) > 2 and math.dist(first, last) <= COINCIDENT * wanted.size


def asked_count(raw: Mapping[str, Any]) -> int:
    """Number of points that a curve shall be sampled at."""
    count = raw.get("points", DEFAULT_POINTS)
    if isinstance(count, bool) or not isinstance(count, int) or not 2 <= count <= MAX_POINTS:
        raise Unusable(f"expected a whole number from 2 to {MAX_POINTS}", "Write points = 60, for example", "points", count)
    return count


def metres(raw: Mapping[str, Any]) -> float:
    """Metres of one unit."""
    if not isinstance(raw["unit"], str):
        raise Unusable("expected a unit of length", 'Write unit = "mm"', "unit", raw["unit"])
    try:
        return factor(raw["unit"], "length")
    except UnitProblem as problem:
        raise Unusable(problem.message, problem.remedy, "unit", raw["unit"]) from None


def diagonal(points: Array) -> float:
    """Diagonal of the rectangle around points (n, 2)."""
    return float(np.hypot(*np.ptp(points, axis=0)))


def cut(value: object) -> str:
    """A piece of what people wrote that goes into a line of a message."""
    text = str(value)
    shown = "".join(sign if sign.isprintable() else " " for sign in text[:60])
    return shown if len(text) <= 60 else f"{shown}..."


def contents(raw: Mapping[str, Any], key: str, folder: Path) -> tuple[str, bytes]:
    """Name, for people, and bytes of the file that `raw[key]` names; devices and pipes would never end."""
    name = raw[key]
    if not isinstance(name, str) or not name.strip() or "\0" in name:
        raise Unusable(f"expected the name of a file ending in .{key}", f'Write {key} = "curve.{key}"', key, name)
    path, remedy = folder / name, "Give the path relative to the problem file"
    try:
        if not path.is_file():
            reason = "it is a folder" if path.is_dir() else "it is no plain file" if path.exists() else "no such file"
            raise Unusable(f"cannot read the file: {reason}", remedy, key, cut(name))
        with path.open("rb") as file:
            data = file.read(MAX_BYTES + 1)
    except OSError as error:
        raise Unusable(f"cannot read the file: {error.strerror}", remedy, key, cut(name)) from None
    if len(data) > MAX_BYTES:
        raise Unusable(f"{cut(name)} is larger than {MAX_BYTES / 1e6:g} MB", "Thin it out", key, cut(name))
    return cut(name), data


def csv_text(raw: Mapping[str, Any], folder: Path) -> tuple[str, str]:
    """Name, for messages, and text of the file that `raw["csv"]` names."""
    name, data = contents(raw, "csv", folder)
    try:
        return name, data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise Unusable(f"{name} is not a CSV text file: {error.reason}", "Save it as CSV, UTF-8", "csv", name) from None


def pairs(points: Array) -> tuple[tuple[float, float], ...]:
    """Points (n, 2) as plain numbers."""
    return tuple((x, y) for x, y in points.tolist())
