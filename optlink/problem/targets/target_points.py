"""Target points of a path or poses of a body, and functions shared by their readers."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from optlink.linkage.vector2d import Array
from optlink.problem.quantity import Unusable, below
from optlink.units import factor

MAX_POINTS = 400
MAX_BYTES = 50_000_000
DEFAULT_POINTS = 60  # for a drawing or an expression
COINCIDENT = 1e-9  # share of the size of the whole path
HEAVIEST = 1e9  # largest plain number, such as a weight
BINARY = {
    b"PK\x03\x04": "a ZIP archive, such as an Excel or Word file",
    b"%PDF": "a PDF file",
    b"\x89PNG": "a picture",
    b"\xff\xd8\xff": "a picture",
    b"GIF8": "a picture",
    b"\xd0\xcf\x11\xe0": "an Office file",
}
"""Kinds of files that are not text, by their first bytes."""


@dataclass(frozen=True)
class TargetPoints:
    """Target points [m] of a path, in order; with `angles`, poses of a body.

    `crank`, `angles` [rad]: the crank angle and the angle of the body at each point, None if not prescribed. `weights` of the
    squared distances, None where all are 1. `tolerances` [m]: the largest permitted distance, inf where there is none. `unit` for
    display. `loop`: sampled from a closed curve, whose first point is not repeated at the end. `note`: description of the
    sampling or reduction, for display.
    """

    points: tuple[tuple[float, float], ...]
    crank: tuple[float, ...] | None = None
    angles: tuple[float, ...] | None = None
    weights: tuple[float, ...] | None = None
    tolerances: tuple[float, ...] | None = None
    unit: str = "mm"
    note: str = field(default="", compare=False)
    loop: bool = False

    @property
    def size(self) -> float:
        """Diagonal [m] of the rectangle around the points."""
        return diagonal(np.asarray(self.points))


def closed(targets: TargetPoints) -> bool:
    """Return whether the points form a closed curve: sampled from one, or listed with the last on the first."""
    if targets.loop:
        return True
    first, last = targets.points[0], targets.points[-1]
    return len(targets.points) > 2 and math.dist(first, last) <= COINCIDENT * targets.size


def read_count(raw: Mapping[str, Any]) -> int:
    """Read the number of points at which a curve is sampled.

    Raises
    ------
    Unusable
    """
    count = raw.get("points", DEFAULT_POINTS)
    if isinstance(count, bool) or not isinstance(count, int) or not 2 <= count <= MAX_POINTS:
        raise Unusable(f"expected a whole number from 2 to {MAX_POINTS}", "Write points = 60, for example", "points", count)
    return count


def metres(raw: Mapping[str, Any]) -> float:
    """Return the length of one unit [m].

    Raises
    ------
    Unusable
    """
    if not isinstance(raw["unit"], str):
        raise Unusable("expected a unit of length", 'Write unit = "mm"', "unit", raw["unit"])
    with below("unit", raw["unit"]):
        return factor(raw["unit"], "length")


def diagonal(points: Array) -> float:
    """Return the diagonal of the rectangle around points (n, 2)."""
    return float(np.hypot(*np.ptp(points, axis=0)))


def shortened(value: object) -> str:
    """Return a shortened printable piece of an input value, for messages."""
    text = str(value)
    printable = "".join(sign if sign.isprintable() else " " for sign in text[:60])
    return printable if len(text) <= 60 else f"{printable}..."


def file_kind(data: bytes) -> str:
    """Return the kind of a file that is not text, by its first bytes; empty for any other file."""
    return next((words for start, words in BINARY.items() if data.startswith(start)), "")


ENCLOSED = "data:"
"""Beginning of a value that encloses a file, as stored results do: then its name and, from the next line on, its content."""


def split_enclosed(value: str) -> tuple[str, str]:
    """Return name and content of an enclosed file, or the name of another file and an empty text."""
    if not value.startswith(ENCLOSED) or "\n" not in value:
        return value, ""
    name, _, content = value.removeprefix(ENCLOSED).partition("\n")
    return name, content


def enclosed(name: str, content: str) -> str:
    """Return the value that encloses a file."""
    return f"{ENCLOSED}{name}\n{content}"


def read_file(raw: Mapping[str, Any], key: str, folder: Path) -> tuple[str, bytes]:
    """Return the display name and the bytes of a file; devices and pipes are refused.

    It may be enclosed in the value itself, see `ENCLOSED`.

    Parameters
    ----------
    key : str
        Key of `raw` with the name of the file; also its suffix.
    folder : Path
        Folder to which the name is relative.

    Raises
    ------
    Unusable
        when the file cannot be read or is too large.
    """
    name = raw[key]
    if isinstance(name, str) and name.startswith(ENCLOSED) and "\n" in name:
        title, content = split_enclosed(name)
        return shortened(title), content.encode()
    if not isinstance(name, str) or not name.strip() or "\0" in name:
        raise Unusable(f"expected the name of a file ending in .{key}", f'Write {key} = "curve.{key}"', key, name)
    path, remedy = folder / name, "Give the path relative to the problem file"
    try:
        if not path.is_file():
            reason = "it is a folder" if path.is_dir() else "it is not a regular file" if path.exists() else "no such file"
            raise Unusable(f"cannot read the file: {reason}", remedy, key, shortened(name))
        with path.open("rb") as file:
            data = file.read(MAX_BYTES + 1)
    except OSError as error:
        raise Unusable(f"cannot read the file: {error.strerror}", remedy, key, shortened(name)) from None
    if len(data) > MAX_BYTES:
        raise Unusable(f"{shortened(name)} is larger than {MAX_BYTES / 1e6:g} MB", "Reduce its size", key, shortened(name))
    return shortened(name), data


def pairs(points: Array) -> tuple[tuple[float, float], ...]:
    """Return points (n, 2) as plain numbers."""
    return tuple((x, y) for x, y in points.tolist())
