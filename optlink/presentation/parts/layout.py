"""Parts beside each other on a sheet."""

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from optlink.linkage.vector2d import Array
from optlink.presentation.parts.model import FlatPart, distance

MARGIN = 0.4  # distance of two parts, as a share of the width of a link
LETTER_WIDTH = 0.65  # width of a letter in heights
LETTERS = 0.4  # height of a name as a share of the width of its link
SAVING = 0.95  # share of the rectangle round a part from which turning the part is worth it


@dataclass(frozen=True, eq=False)
class Placed:
    """A part on a sheet: its axes begin at `shift` (2,) [mm] and are those of the sheet."""

    part: FlatPart
    shift: Array


@dataclass(frozen=True, eq=False)
class Sheet:
    """Parts on a sheet whose lower left corner is the origin; `size` (2,) [mm]."""

    parts: tuple[Placed, ...]
    size: Array


@dataclass(frozen=True)
class Engraved:
    """A text with its middle and height [mm], turned by an angle [rad]."""

    text: str
    at: Array
    height: float
    angle: float


def laid_out(parts: Iterable[FlatPart]) -> Sheet:
    """Arrange parts in rows, the deepest first, on a sheet about as high as it is wide; each lies along it if that saves room."""
    boxes = [(part, *part.corners) for part in map(_lying, parts)]
    gap = MARGIN * max(part.width for part, *_ in boxes)
    area = sum(float(np.prod(high - low + gap)) for _, low, high in boxes)
    wide = max(1.2 * math.sqrt(area), *(float((high - low)[0]) + 2.0 * gap for _, low, high in boxes))
    placed: list[Placed] = []
    x, y, deep, right = gap, gap, 0.0, 0.0
    for part, low, high in sorted(boxes, key=lambda box: -float((box[2] - box[1])[1])):
        if x > gap and x + float((high - low)[0]) + gap > wide:
            x, y, deep = gap, y + deep + gap, 0.0
        placed.append(Placed(part, np.array([x, y]) - low))
        x += float((high - low)[0]) + gap
        deep, right = max(deep, float((high - low)[1])), max(right, x)
    return Sheet(tuple(placed), np.array([right, y + deep + gap]))


def _lying(part: FlatPart) -> FlatPart:
    """Return a part turned to the smallest rectangle round it, its longer side along the sheet; as it is if none is smaller."""
    best, least = part, SAVING * float(np.prod(np.subtract(*part.corners)))
    corners = np.array([vertex[:2] for vertex in part.outline])
    for way in np.roll(corners, -1, axis=0) - corners:
        for along in (way, np.array([-way[1], way[0]])):
            turned = _turned(part, along / np.linalg.norm(along))
            low, high = turned.corners
            if np.prod(high - low) < least and (high - low)[0] >= (high - low)[1]:
                best, least = turned, SAVING * float(np.prod(high - low))
    return best


def _turned(part: FlatPart, along: Array) -> FlatPart:
    """Return a part turned so that a direction (2,) of it lies along the sheet."""
    axes = np.array([along, [-along[1], along[0]]]).T
    openings = tuple(replace(one, ends=one.ends @ axes) for one in part.openings)
    marks = {name: at @ axes for name, at in part.marks.items()}
    return replace(part, openings=openings, marks=marks, origin=part.origin @ axes, along=part.along @ axes)


def engraved(part: FlatPart) -> Engraved | None:
    """Return the name of a part on its longest free stretch between two openings; None if it has no room there."""
    ends = [(end, 0.5 * one.diameter) for one in part.openings for end in one.ends]
    ends += [(at, 0.0) for at in part.marks.values()]
    best: Engraved | None = None
    for k, (first, radius) in enumerate(ends):
        for other, beyond in ends[:k]:
            along, middle = other - first, 0.5 * (first + other)
            length = float(np.linalg.norm(along)) - radius - beyond
            height = min(LETTERS * part.width, length / (LETTER_WIDTH * len(part.name) + 1.1))
            if height < 0.1 * part.width or (best is not None and height <= best.height):
                continue
            middle = middle + 0.5 * (radius - beyond) * along / np.linalg.norm(along)
            half = 0.5 * LETTER_WIDTH * len(part.name) * height * along / np.linalg.norm(along)
            line = np.array([middle - half, middle + half])
            if all(_clear(line, one.ends, 0.5 * (one.diameter + height)) for one in part.openings):
                angle = math.atan2(along[1], along[0])
                upright = (angle + 0.5 * math.pi - 1e-9) % math.pi - 0.5 * math.pi + 1e-9
                best = Engraved(part.name, middle, height, upright)
    return best


def _clear(line: Array, ends: Array, radius: float) -> bool:
    return float(distance(line[None], ends[None])[0]) > radius
