"""Shapes of bodies and ground as plain points."""

import itertools
import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from optlink.linkage.jet import as_jet
from optlink.linkage.vector2d import TURN, Array, Vector


@dataclass(frozen=True)
class Part:
    """Part of a body in the axes of the body and the display unit: a line of two points, or an outline."""

    kind: Literal["bar", "plate", "block", "slot", "profile", "auxiliary"]
    outline: Array


def finite(points: Array) -> Array:
    """Return the points (n, 2) that are finite."""
    flat = points.reshape(-1, 2)
    return flat[np.all(np.isfinite(flat), axis=1)]


def spread(points: Array) -> Array:
    """Return width and height of a set of points."""
    return np.ptp(points, axis=0) if len(points) else np.zeros(2)


def plain(vector: Vector) -> Array:
    """Return a vector of jets or numbers, at one position, as an array (2,)."""
    return np.array([float(np.squeeze(as_jet(part).value)) for part in vector])


def cross(first: Array, second: Array) -> Array:
    """Return the cross products of plane vectors (..., 2)."""
    return np.asarray(first[..., 0] * second[..., 1] - first[..., 1] * second[..., 0])


def distinct(points: Iterable[Array], near: float) -> Array:
    """Return those of some points that are not within a distance of an earlier one."""
    found: list[Array] = []
    for point in points:
        if all(np.linalg.norm(point - other) > near for other in found):
            found.append(point)
    return np.array(found).reshape(-1, 2)


def left_of(way: Array) -> Array:
    """Return a vector, turned by a right angle to the left."""
    return np.array([-way[1], way[0]])


def normed(vector: Array) -> Array:
    """Return a vector of length one, or zero."""
    return np.asarray(vector / max(float(np.linalg.norm(vector)), 1e-30))


def ways(angles: Array) -> Array:
    """Return the unit vectors (..., 2) in some directions [rad]."""
    return np.stack([np.cos(angles), np.sin(angles)], axis=-1)


def finite_range(values: Array) -> tuple[float, float]:
    """Return the smallest and the largest finite value; zeros if there is none."""
    known = values[np.isfinite(values)]
    return (float(known.min()), float(known.max())) if known.size else (0.0, 0.0)


def pieces(line: Array) -> Iterator[Array]:
    """Yield the pieces of a line (n, 2) with gaps at NaN."""
    known = np.all(np.isfinite(line), axis=1)
    for piece in np.split(line, np.flatnonzero(~known)):
        if len(kept := finite(piece)):
            yield kept


def rectangle(point: Array, direction: Array, low: float, high: float, half: float) -> Array:
    """Return the corners (4, 2) of a rectangle along a line, from `low` to `high` along its unit vector, `half` its width."""
    left = left_of(direction)
    return np.array([point + a * direction + b * half * left for a, b in ((low, -1.0), (high, -1.0), (high, 1.0), (low, 1.0))])


def hatching(begin: Array, direction: Array, length: float, depth: float, spacing: float) -> Array:
    """Return slanted strokes beside a line, as one line with gaps; they lie to its left if the depth is positive."""
    left, gap = left_of(direction), np.full(2, np.nan)
    slant = abs(depth) * 0.75
    count = max(2, math.floor((length - slant) / spacing) + 1)
    starts = np.linspace(slant, length, count)
    return np.array([p for t in starts for p in (begin + t * direction, begin + (t - slant) * direction + depth * left, gap)])


def strokes(line: Array, depth: float, spacing: float) -> Array:
    """Return slanted strokes to the left of a line (n, 2) with gaps at NaN, evenly spaced, as one line with gaps."""
    along = np.diff(line, axis=0)
    lengths = np.nan_to_num(np.linalg.norm(along, axis=1))
    ends = np.cumsum(lengths)
    shown: list[Array] = [np.empty((0, 2))]
    for at in np.arange(0.5 * spacing, ends[-1] if len(ends) else 0.0, spacing):
        k = int(np.searchsorted(ends, at))
        way = along[k] / lengths[k]
        begin = line[k] + (at - ends[k] + lengths[k]) * way
        shown.append(np.array([begin, begin + depth * (left_of(way) - 0.75 * way), [np.nan, np.nan]]))
    return np.concatenate(shown)


def clipped(line: Array, low: Array, high: Array) -> Array:
    """Return the parts of a line (n, 2) with gaps at NaN that lie in a rectangle, as one line with gaps."""
    shown: list[Array] = []
    for begin, end in itertools.pairwise(line):
        along = end - begin
        with np.errstate(divide="ignore", invalid="ignore"):
            shares = np.array([(low - begin) / along, (high - begin) / along])
        level = (along == 0.0) & (begin >= low) & (begin <= high)
        first, last = np.where(level, 0.0, np.min(shares, axis=0)), np.where(level, 1.0, np.max(shares, axis=0))
        a, b = max(0.0, float(np.max(first))), min(1.0, float(np.min(last)))
        if a < b and np.all(np.isfinite(along)):
            piece = [begin + a * along, end if b == 1.0 else begin + b * along]
            if shown and np.array_equal(shown[-1], piece[0]):
                shown.append(piece[1])
            else:
                shown += [np.full(2, np.nan)] * bool(shown) + piece
    return np.array(shown).reshape(-1, 2)


def stem(points: Array, ends: Array) -> Array:
    """Return the shortest line (2, 2) from one of several points (n, 2) to a segment (2, 2)."""
    along = ends[1] - ends[0]
    shares = np.clip((points - ends[0]) @ along / max(float(along @ along), 1e-30), 0.0, 1.0)
    feet = ends[0] + shares[:, None] * along
    nearest = int(np.argmin(np.linalg.norm(points - feet, axis=1)))
    return np.array([points[nearest], feet[nearest]])


def in_line(points: Array, near: float) -> NDArray[np.intp] | None:
    """Return the order of points (n, 2) along a line; None if one is farther than `near` from the line of the outer two."""
    arms = points - points[0]
    lengths = np.linalg.norm(arms, axis=1)
    along = arms[np.argmax(lengths)] / np.max(lengths)
    beside = np.abs(arms @ left_of(along))
    return None if np.max(beside) > near else np.argsort(arms @ along)


def hull(points: Array) -> Array:
    """Return the corners of the convex hull, counter-clockwise."""
    ordered = points[np.lexsort((points[:, 1], points[:, 0]))]

    def chain(run: Array) -> list[Array]:
        corners: list[Array] = []
        for p in run:
            while len(corners) > 1 and np.linalg.det(np.array([corners[-1] - corners[-2], p - corners[-1]])) <= 0.0:
                corners.pop()
            corners.append(p)
        return corners[:-1]

    return np.array([*chain(ordered), *chain(ordered[::-1])])


def zigzag(size: float) -> list[tuple[float, float]]:
    """Return a spring from (0, 0) to (1, 0): shares of its length and lateral offsets [mm]."""
    shares = [0.0, 0.18, *np.linspace(0.2, 0.8, 12).tolist(), 0.82, 1.0]
    sides = [0.0, 0.0, *(0.45 * size * (-1.0) ** i for i in range(12)), 0.0, 0.0]
    return list(zip(shares, sides, strict=True))


def spiral(size: float) -> Array:
    """Return a torsion spring about the origin (n, 2): two turns that widen from the ring of a joint."""
    turns = np.linspace(0.0, 2.0 * TURN, 73)
    return np.asarray(np.linspace(0.45, 1.1, 73)[:, None] * size * ways(turns))


def even(count: int, most: int) -> NDArray[np.intp]:
    """Return at most `most` evenly spaced indices of `count` items, including the first and the last."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(np.intp))
