"""The shapes that bodies and the ground are drawn with, as plain points."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Part:
    """A piece of a body in the body's own axes, in the unit that is shown: a line of two points, or an outline."""

    kind: Literal["bar", "plate", "block", "slot"]
    outline: Array


def finite(points: Array) -> Array:
    """All points (n, 2) that are finite."""
    flat = points.reshape(-1, 2)
    return flat[np.all(np.isfinite(flat), axis=1)]


def spread(points: Array) -> Array:
    """Width and height of a cloud of points."""
    return np.ptp(points, axis=0) if len(points) else np.zeros(2)


def rectangle(point: Array, way: Array, low: float, high: float, half: float) -> Array:
    """Corners of a rectangle along a line, from `low` to `high` on it."""
    left = np.array([-way[1], way[0]])
    return np.array([point + a * way + b * half * left for a, b in ((low, -1.0), (high, -1.0), (high, 1.0), (low, 1.0))])


def hatching(begin: Array, way: Array, length: float, depth: float, spacing: float) -> Array:
    """Slanting strokes below a line, as one line with gaps."""
    left, gap = np.array([-way[1], way[0]]), np.full(2, np.nan)
    slant = abs(depth) * 0.75
    count = max(2, math.floor((length - slant) / spacing) + 1)
    starts = np.linspace(slant, length, count)
    return np.array([p for t in starts for p in (begin + t * way, begin + (t - slant) * way + depth * left, gap)])


def stem(own: Array, ends: Array) -> Array:
    """The shortest line from one of the points to a segment."""
    along = ends[1] - ends[0]
    shares = np.clip((own - ends[0]) @ along / max(float(along @ along), 1e-30), 0.0, 1.0)
    feet = ends[0] + shares[:, None] * along
    nearest = int(np.argmin(np.linalg.norm(own - feet, axis=1)))
    return np.array([own[nearest], feet[nearest]])


def hull(points: Array) -> Array:
    """Corners of the convex hull, counter-clockwise."""
    ordered = points[np.lexsort((points[:, 1], points[:, 0]))]

    def chain(run: Array) -> list[Array]:
        kept: list[Array] = []
        for p in run:
            while len(kept) > 1 and np.linalg.det(np.array([kept[-1] - kept[-2], p - kept[-1]])) <= 0.0:
                kept.pop()
            kept.append(p)
        return kept[:-1]

    return np.array([*chain(ordered), *chain(ordered[::-1])])
