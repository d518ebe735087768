"""Closed solids [mm] of parts and pins: triangles whose edges are each used twice, in opposite senses."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from optlink.linkage.vector2d import TURN, Array
from optlink.presentation.export.dxf import Vertex
from optlink.presentation.parts.model import FlatPart, Pin
from optlink.presentation.parts.outline import edges, middle
from optlink.presentation.shapes import cross, ways

CHORDS = 360  # of a circle: its area differs by 5e-5
TRIES = 12  # most directions in which an outline is triangulated


@dataclass(frozen=True, eq=False)
class Solid:
    """A named body: places (n, 3) [mm] and triangles (m, 3) of their numbers, counter-clockwise seen from outside."""

    name: str
    places: Array
    triangles: NDArray[np.intp]

    def moved(self, shift: Array, angle: float = 0.0) -> "Solid":
        """Return the solid turned by an angle [rad] about the z axis, then shifted by a vector (3,)."""
        c, s = math.cos(angle), math.sin(angle)
        return Solid(self.name, self.places @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) + shift, self.triangles)


def plate(part: FlatPart) -> Solid:
    """Return a part from z = 0 to its thickness; the polygon of a hole lies round the hole, that of an outer arc within it."""
    loops = [polygon(part.outline), *(polygon(one.outline, around=True) for one in part.openings)]
    flat = np.concatenate(loops)
    count = len(flat)
    places = np.concatenate([np.column_stack([flat, np.zeros(count)]), np.column_stack([flat, np.full(count, part.thickness)])])
    cap = _triangles(loops)
    walls = []
    first = 0
    for k, loop in enumerate(loops):
        numbers = first + np.arange(len(loop))
        following = np.roll(numbers, -1)
        begin, end = (numbers, following) if k == 0 else (following, numbers)
        walls += [np.column_stack([begin, end, end + count]), np.column_stack([begin, end + count, begin + count])]
        first += len(loop)
    return Solid(part.name, places, np.concatenate([cap[:, ::-1], cap + count, *walls]))


def stud(pin: Pin, low: float, high: float) -> Solid:
    """Return a pin through parts from one height to another [mm], with its heads beyond."""
    steps = profile(pin, low, high)
    turns = TURN * np.arange(CHORDS) / CHORDS
    rings = [np.column_stack([radius * np.cos(turns), radius * np.sin(turns), np.full(CHORDS, z)]) for radius, z in steps]
    places = np.concatenate([*rings, [[0.0, 0.0, steps[0][1]], [0.0, 0.0, steps[-1][1]]]])
    around = np.arange(CHORDS)
    beside = np.roll(around, -1)
    walls = []
    for k in range(len(rings) - 1):
        a, b, c, d = around + k * CHORDS, beside + k * CHORDS, beside + (k + 1) * CHORDS, around + (k + 1) * CHORDS
        walls += [np.column_stack([a, b, c]), np.column_stack([a, c, d])]
    bottom, top = len(places) - 2, len(places) - 1
    last = (len(rings) - 1) * CHORDS
    walls.append(np.column_stack([beside, around, np.full(CHORDS, bottom)]))
    walls.append(np.column_stack([around + last, beside + last, np.full(CHORDS, top)]))
    return Solid(f"pin {pin.name}", places, np.concatenate(walls))


def profile(pin: Pin, low: float, high: float) -> list[tuple[float, float]]:
    """Return radius and height [mm] of the corners of a pin through parts from one height to another, upwards."""
    r, head = 0.5 * pin.diameter, 0.5 * pin.head
    steps = [(r, low), (r, high)]
    return [(head, low - pin.height), (head, low), *steps, (head, high), (head, high + pin.height)] if pin.height else steps


def polygon(outline: Sequence[Vertex], around: bool = False, chords: int = CHORDS) -> Array:
    """Return corners (n, 2) of an outline with chords in place of its arcs, or with tangents around them."""
    corners: list[Array] = []
    for (x, y, bulge), (u, v, _) in edges(outline):
        begin, end = np.array([x, y]), np.array([u, v])
        corners.append(begin)
        if bulge == 0.0:
            continue
        turned = 4.0 * math.atan(bulge)
        centre = middle(begin, end, bulge)
        count = max(1, math.ceil(turned / TURN * chords - 1e-9))
        angles = turned * (np.arange(count) + 0.5 if around else np.arange(1, count)) / count
        arm = (begin - centre) / (math.cos(0.5 * turned / count) if around else 1.0)
        turns = ways(angles)
        corners += [*(centre + np.column_stack([turns @ (arm * [1.0, -1.0]), turns @ arm[::-1]]))]
    return np.array(corners)


def _triangles(loops: Sequence[Array]) -> NDArray[np.intp]:
    """Return triangles (m, 3), counter-clockwise, of an outline with openings by the numbers of their corners in turn.

    Of corners exactly in line the method leaves some out; where the number of triangles shows it, the outline is turned.
    """
    count = sum(map(len, loops)) + 2 * len(loops) - 4
    return next(found for turn in range(TRIES) if len(found := _triangles_turned(loops, 0.5 * turn)) == count)


def _triangles_turned(loops: Sequence[Array], angle: float) -> NDArray[np.intp]:
    from ezdxf.math.triangulation import mapbox_earcut_2d

    c, s = math.cos(angle), math.sin(angle)
    turned = [loop @ np.array([[c, s], [-s, c]]) for loop in loops]
    flat = np.concatenate(turned)
    numbers = {(float(x), float(y)): k for k, (x, y) in enumerate(flat)}
    found = mapbox_earcut_2d(turned[0].tolist(), [loop.tolist() for loop in turned[1:]])
    triangles = np.array([[numbers[corner.x, corner.y] for corner in corners] for corners in found], dtype=np.intp)
    a, b, c_ = (flat[triangles[:, k]] for k in range(3))
    area = np.sum(cross(b - a, c_ - a))
    return triangles[:, ::-1] if area < 0.0 else triangles
