"""Outlines of straight edges and arcs, and what becomes of the arcs where a part has no round ends."""

import itertools
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from optlink.linkage.vector2d import TURN, Array
from optlink.presentation.export.dxf import Vertex
from optlink.presentation.shapes import ways
from optlink.problem.machine.parts import End

Outline = tuple[Vertex, ...]
RIGHT, SHARP = 0.25 * TURN, 0.125 * TURN  # most that a corner turns, and beyond which it is chamfered
CHAMFER = 0.5  # leg of a chamfer, as a share of the edge from its corner to the arc: a quarter of the width of a bar
NEAR = 1e-9  # angle [rad] by which a corner may turn more


def edges(outline: Sequence[Vertex]) -> Iterable[tuple[Vertex, Vertex]]:
    """Return the two ends of each edge of a closed outline."""
    return itertools.pairwise((*outline, outline[0]))


def middle(begin: ArrayLike, end: ArrayLike, bulge: float) -> Array:
    """Return the centre (2,) of an arc."""
    x, y = np.subtract(end, begin)
    return np.asarray(0.5 * np.add(begin, end) + 0.25 * (1.0 / bulge - bulge) * np.array([-y, x]))


def _straight(cut: float, outline: Outline) -> Outline:
    """Return the outline with tangents in place of its arcs, of equal angles between them and no more than are needed.

    A share `cut` of both edges between a sharp corner and the arc is cut off.
    """
    corners: list[Array] = []
    for (x, y, bulge), (u, v, _) in edges(outline):
        if not bulge:
            continue
        turned, centre = 4.0 * math.atan(bulge), middle((x, y), (u, v), bulge)
        count = math.ceil((turned - NEAR) / RIGHT)
        angles = turned * np.arange(2 * count + 1) / (2 * count)
        turns = ways(angles)
        arm = np.array([x, y]) - centre
        touching = centre + np.column_stack([turns @ (arm * [1.0, -1.0]), turns @ arm[::-1]])
        for before, on, after in zip(touching[:-1:2], touching[1::2], touching[2::2], strict=True):
            corner = centre + (on - centre) / math.cos(0.5 * turned / count)
            sharp = cut if turned / count > SHARP + NEAR else 0.0
            corners += [corner + sharp * (end - corner) for end in ((before, after) if sharp else (corner,))]
    return tuple((float(x), float(y), 0.0) for x, y in corners)


def _as_it_is(outline: Outline) -> Outline:
    return outline


ENDS: Mapping[End, Callable[[Outline], Outline]] = {
    "round": _as_it_is,
    "square": partial(_straight, 0.0),
    "chamfered": partial(_straight, CHAMFER),
}
"""What becomes of a round outline, by the shape of the ends of its part."""
