"""Places of the names of points in a drawing that moves: beside their own point, clear of links and of other names.

Every name has a few sides of its point to choose from. The cost of a side at a position counts
what the name would hide, and whether it would lie nearer to another point than to its own; the course of sides over the motion
is the cheapest one, where a change of side costs as much as a few positions with a link behind the name.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from optlink.linkage.vector2d import Array

LETTER = 9.0 / 8.0
"""Height of a letter, as a share of the height of a ground pivot, and below its width as a share of its height."""
WIDTH = 0.6
ROOM = 0.42, 1.05
"""Distances of a name from its point, near and farther, as shares of the height of a ground pivot."""
WAYS = np.array([[1, 1], [-1, 1], [1, -1], [-1, -1], [1, 0], [-1, 0], [0, 1], [0, -1]], dtype=float)
"""Sides of a point, the preferred first."""
BESIDE = np.array([[1.15, -0.95], [-1.15, -0.95]])
"""Further sides of a point of the frame: beside its support."""
SPACING = 0.35
"""Distance of the samples along lines, as a share of the height of a letter."""
LINK, TRACE, NAME, POINT, WRONG, OUTSIDE, LATER, CHANGE = 1.0, 0.15, 4.0, 2.0, 4.0, 20.0, 0.02, 5.0
"""Costs: a letter's height of a link or trace behind the name, another name, another point there or nearer, a name that leaves
the drawing, the next side in the order, a change of side."""
MOST = 4_000_000
"""Comparisons of samples with places, beyond which not every position is examined."""
MAX_LETTERS = 12
"""Most letters of the name of a point in a drawing."""


def short_name(name: str) -> str:
    """Return a name as drawings show it: without the middle if it is long, as the ends of similar names differ."""
    return name if len(name) <= MAX_LETTERS else f"{name[:6]}\u2026{name[-5:]}"


@dataclass(frozen=True, eq=False)
class NamePlaces:
    """Places of a name: its middle relative to its point (sides, 2) [mm], and the number of the side at each position."""

    middles: Array
    sides: NDArray[np.intp]

    @property
    def code(self) -> str:
        """The sides, one digit to the base 36 for each position."""
        return "".join(np.array([*"0123456789abcdefghijklmnopqrstuvwxyz"])[self.sides])

    def at(self, k: int) -> tuple[float, float]:
        """Return the middle of the name relative to its point at position `k` [mm]."""
        x, y = self.middles[self.sides[k]]
        return float(x), float(y)


def place_names(
    points: Mapping[str, Array],
    still: Collection[str],
    links: Sequence[Array],
    ground: Sequence[Array],
    traces: Collection[str],
    box: tuple[float, float, float, float],
    size: float,
) -> dict[str, NamePlaces]:
    """Return the places of the names of all points.

    Points (positions, 2), links that move (positions, corners, 2), ground lines (corners, 2) with gaps at NaN, the box of the
    drawing and the height of a ground pivot are in mm. The names of `still` points do not move; of `traces` the paths are drawn.
    """
    letter = LETTER * size
    moving = np.concatenate(
        [np.zeros((len(next(iter(points.values()))), 0, 2)), *(_sampled(line, SPACING * letter) for line in links)], axis=1
    )
    fixed = np.concatenate([np.zeros((0, 2)), *(_sampled(line[None], SPACING * letter)[0] for line in ground)])
    paths = np.concatenate([np.zeros((0, 2)), *(points[name][:: max(1, len(points[name]) // 60)] for name in traces)])
    count = len(moving)
    samples = moving.shape[1] + len(fixed) + len(paths)
    every = max(1, -(-count * samples * len(points) * len(ROOM) * len(WAYS) // MOST))
    some = np.arange(0, count, every)
    rim = 0.3 * letter
    corners = np.array([[box[0] + rim, box[1] + rim], [box[0] + box[2] - rim, box[1] + box[3] - rim]])
    taken: list[tuple[Array, Array]] = []
    places: dict[str, NamePlaces] = {}
    for name in sorted(points, key=lambda each: each not in still):
        half = 0.5 * np.array([WIDTH * letter * len(short_name(name)), letter])
        diagonal = np.where(np.all(WAYS != 0.0, axis=1, keepdims=True), 0.7, 1.0)
        middles = np.concatenate([WAYS * (half + room * size * diagonal) for room in ROOM])
        if name in still:
            middles = np.concatenate([BESIDE * size + np.sign(BESIDE) * half * [1.0, 0.0], middles])
        own = points[name][some]
        at = own[:, None, :] + middles  # (positions, sides, 2)
        with np.errstate(invalid="ignore"):
            cost = LATER * np.arange(len(middles)) + np.zeros(at.shape[:2])
            cost += LINK * SPACING * (_inside(moving[some], at, half) + _inside(fixed[None], at, half))
            cost += TRACE * _inside(paths[None], at, half)
            for other, path in points.items():
                if other != name:
                    cost += _near_other(path[some], own, at, half, size)
            for middle, extent in taken:
                common = np.minimum(at + half, (middle + extent)[:, None]) - np.maximum(at - half, (middle - extent)[:, None])
                shared = np.prod(np.maximum(common, 0.0), axis=-1) / np.prod(2.0 * half)
                cost += NAME * (shared + 0.5 * (shared > 0.0))
            cost += OUTSIDE * np.any((at - half < corners[0]) | (at + half > corners[1]), axis=2)
        cost = np.nan_to_num(cost)
        chosen = np.full(len(some), int(np.argmin(cost.sum(axis=0)))) if name in still else _course(cost)
        taken.append((at[np.arange(len(some)), chosen], half))
        places[name] = NamePlaces(middles, chosen[np.arange(count) // every])
    return places


def _sampled(line: Array, spacing: float) -> Array:
    """Return points along a line (positions, corners, 2), about as far apart as given, without gaps."""
    lengths = np.nanmax(np.linalg.norm(np.diff(line, axis=1), axis=2), axis=0, initial=0.0)
    parts = [np.zeros((len(line), 0, 2))]
    for k, length in enumerate(lengths):
        if np.isfinite(length) and length > 0.0:
            shares = np.linspace(0.0, 1.0, max(2, int(np.ceil(length / spacing)) + 1))[:-1, None]
            parts.append(line[:, k : k + 1] + shares * (line[:, k + 1 : k + 2] - line[:, k : k + 1]))
    return np.concatenate(parts, axis=1)


def _inside(samples: Array, middles: Array, half: Array) -> Array:
    """Count the samples (positions, n, 2) in boxes about middles (positions, sides, 2)."""
    count = np.empty(middles.shape[:2])
    for side in range(middles.shape[1]):
        away = np.abs(samples - middles[:, side, None])
        count[:, side] = np.count_nonzero((away[..., 0] <= half[0]) & (away[..., 1] <= half[1]), axis=1)
    return count


def _near_other(other: Array, own: Array, middles: Array, half: Array, size: float) -> Array:
    """Cost of another point (positions, 2) that a name hides, or to which it would seem to belong."""
    apart = np.linalg.norm(other - own, axis=1) > 0.5 * size
    away = np.abs(other[:, None] - middles)
    hidden = np.all(away <= half + 0.3 * size, axis=2)
    outer = np.linalg.norm(np.maximum(np.abs(other[:, None] - middles) - half, 0.0), axis=2)
    nearest = np.linalg.norm(np.maximum(np.abs(own[:, None] - middles) - half, 0.0), axis=2)
    wrong = np.clip(1.25 - outer / np.maximum(nearest, 1e-9 * size), 0.0, 1.0)
    return np.asarray((POINT * hidden + WRONG * wrong) * apart[:, None])


def _course(cost: Array) -> NDArray[np.intp]:
    """Return the sides (positions,) of least total cost (positions, sides), changes included (Viterbi's algorithm)."""
    count, sides = cost.shape
    before = np.zeros((count, sides), dtype=np.intp)
    total = cost[0]
    for k in range(1, count):
        best = int(np.argmin(total))
        changed = total > total[best] + CHANGE
        before[k] = np.where(changed, best, np.arange(sides))
        total = np.where(changed, total[best] + CHANGE, total) + cost[k]
    course = np.empty(count, dtype=np.intp)
    course[-1] = int(np.argmin(total))
    for k in range(count - 1, 0, -1):
        course[k - 1] = before[k, course[k]]
    return course
