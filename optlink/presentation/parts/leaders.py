"""Labels with leaders: each where neither its text nor its leader crosses what is drawn, if there is such a place.

The possible leaders of a label are straight lines of several directions and lengths. A crossing costs as much as a longer leader;
what may be crossed at all, and what a text may cover, is in `CROSSED` and `COVERED`. The labels are placed one after another.
"""

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from optlink.linkage.vector2d import TURN, Array
from optlink.presentation.parts.solids import polygon
from optlink.presentation.parts.view import GAP, TEXT, Item, Line, Measure, Words, arrow, box, segment, width
from optlink.presentation.shapes import cross

CHORDS = 24  # of a circle that a leader may cross
DIRECTIONS = np.radians([15.0, 30.0, 45.0, 60.0, 75.0])  # of leaders, in each quadrant
STEEP, SLANT = math.radians(60.0), 4.0  # the usual direction, and the cost [mm] of a quarter turn from it
DOWN, BACK = 12.0, 4.0  # costs [mm] of a leader that goes down, where the dimensions are, and of one to the left
AROUND = 2.5  # least room around a text
LENGTHS = np.array([7.0, 10.0, 14.0, 19.0, 25.0, 33.0, 45.0, 60.0, 80.0, 110.0, 150.0])  # of leaders
NEVER = 400.0
CROSSED = {"outline": 4.0, "opening": 60.0, "centre": 20.0}
COVERED = {"outline": 80.0, "opening": 150.0, "centre": 150.0}
"""Costs [mm] of crossings by a leader and by a text, by what is crossed; of all else `NEVER`."""
WITHIN, GROWTH = 30.0, 0.3  # costs [mm] of a text on the part, and of each millimetre by which it enlarges the view


@dataclass(frozen=True, eq=False)
class Target:
    """A place at which a leader may point: an arc of a radius about a centre (2,), between two angles."""

    centre: Array
    radius: float
    low: float = 0.0
    high: float = TURN


@dataclass(frozen=True, eq=False)
class Label:
    """A text whose leader points at one of some places."""

    text: str
    targets: Sequence[Target]


def labelled(labels: Iterable[Label], items: Sequence[Item], outline: Line, openings: Sequence[Line]) -> Iterator[Item]:
    """Yield texts and leaders clear of what is drawn, of which some are the outline and the openings of a part."""
    drawn = list(items)
    for label in labels:
        made = _placed(label, drawn, outline, openings)
        drawn += made
        yield from made


def _placed(label: Label, items: Sequence[Item], outline: Line, openings: Sequence[Line]) -> list[Item]:
    pieces, crossed, covered = _pieces(items, outline, openings)
    low, high = box(items)
    half = 0.5 * np.array([width(label.text), TEXT])
    tips, starts, ways = _leaders(label.targets)
    sides = np.sign(ways[:, 0])
    shelf = starts + sides[:, None] * [GAP, 0.0]
    middles = shelf + sides[:, None] * [GAP + half[0], 0.0]
    half = half + AROUND
    costs = np.linalg.norm(starts - tips, axis=1) + DOWN * (ways[:, 1] < 0.0) + BACK * (sides < 0.0)
    costs += SLANT * np.abs(np.abs(np.arcsin(ways[:, 1])) - STEEP) / (0.25 * TURN)
    costs += crossings(tips + 0.1 * ways, starts, pieces) @ crossed + crossings(starts, shelf, pieces) @ crossed
    costs += _overlaps(middles, half, pieces) @ covered
    costs += GROWTH * np.sum(np.maximum(0.0, low - middles + half) + np.maximum(0.0, middles + half - high), axis=1)
    corners = polygon(outline.vertices, chords=CHORDS)
    sides_of = np.roll(corners, -1, axis=0) - corners
    away = middles[:, None] - corners
    costs += WITHIN * np.all(cross(sides_of, away) > 0.0, axis=1)
    k = int(np.argmin(costs))
    text = Words(label.text, shelf[k] + sides[k] * np.array([GAP, 0.0]), align="left" if sides[k] > 0.0 else "right")
    return [segment(tips[k], starts[k], shelf[k]), arrow(tips[k], ways[k]), text]


def _leaders(targets: Sequence[Target]) -> tuple[Array, Array, Array]:
    """Return the tips, the other ends and the directions (n, 2) of possible leaders."""
    tips, ways = list[Array](), list[Array]()
    quadrants = np.concatenate([0.25 * TURN * k + DIRECTIONS for k in range(4)])
    for one in targets:
        free = (quadrants - one.low) % TURN
        free = free[free <= one.high - one.low] if np.any(free <= one.high - one.low) else np.array([0.5 * (one.high - one.low)])
        for angle in one.low + free:
            ways.append(np.array([math.cos(angle), math.sin(angle)]))
            tips.append(one.centre + one.radius * ways[-1])
    begin, way = (np.repeat(found, len(LENGTHS), axis=0) for found in (tips, ways))
    return begin, begin + np.tile(LENGTHS, len(tips))[:, None] * way, way


def _pieces(items: Sequence[Item], outline: Line, openings: Sequence[Line]) -> tuple[Array, Array, Array]:
    """Return the straight pieces (n, 2, 2) of what is drawn, and what a leader and a text pay for each."""
    found, crossed, covered = list[Array](), list[float](), list[float]()
    for item in items:
        if isinstance(item, Line):
            corners = polygon(item.vertices, chords=CHORDS)
            traces: Sequence[Array] = [np.concatenate([corners, corners[: int(item.closed)]])]
            kind: str = "outline" if item is outline else "opening" if item in openings else item.style
        else:
            traces, kind = item.traces, type(item).__name__
        for trace in traces:
            found += [*np.stack([trace[:-1], trace[1:]], axis=1)]
            crossed += [CROSSED.get(kind, NEVER)] * (len(trace) - 1)
            covered += [COVERED.get(kind, NEVER)] * (len(trace) - 1)
    return np.array(found), np.array(crossed), np.array(covered)


def crossings(begin: Array, end: Array, pieces: Array) -> Array:
    """Return where lines (n, 2) to (n, 2) cross pieces (m, 2, 2): (n, m)."""
    first, last = pieces[:, 0], pieces[:, 1]

    def sides(a: Array, b: Array, c: Array) -> Array:
        return cross(b - a, c - a)

    p, q = begin[:, None], end[:, None]
    return np.asarray((sides(p, q, first) * sides(p, q, last) <= 0.0) & (sides(first, last, p) * sides(first, last, q) <= 0.0))


def _overlaps(middles: Array, half: Array, pieces: Array) -> Array:
    """Return where level rectangles about middles (n, 2) meet pieces (m, 2, 2): (n, m)."""
    centre, arm = 0.5 * pieces.sum(axis=1), 0.5 * (pieces[:, 1] - pieces[:, 0])
    away = middles[:, None] - centre
    apart = np.any(np.abs(away) > half + np.abs(arm), axis=2)
    across = np.abs(cross(away, arm))
    return np.asarray(~(apart | (across > np.abs(arm[:, ::-1]) @ half)))


def clear(measures: Sequence[Measure]) -> list[Measure]:
    """Return dimensions, of which the text of a short one lies at the end where it covers less of the others."""
    found = list(measures)
    for k, one in enumerate(found):
        others = [trace for other in (*found[:k], *found[k + 1 :]) for trace in other.traces]
        if one.tight and others:
            pieces = np.concatenate([np.stack([trace[:-1], trace[1:]], axis=1) for trace in others])
            boxes = [box([turned.words]) for turned in (one, replace(one, turned=True))]
            covered = [
                int(_overlaps(corners.mean(axis=0)[None], 0.5 * np.ptp(corners, axis=0), pieces).sum()) for corners in boxes
            ]
            found[k] = replace(one, turned=covered[1] < covered[0])
    return found
