"""The view of an assembly on paper [mm]: what is seen of its parts and pins from above, with balloons."""

import itertools
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from operator import itemgetter

import numpy as np

from optlink.linkage.motion import Motion
from optlink.linkage.vector2d import Array
from optlink.presentation.export.dxf import Vertex, rounded
from optlink.presentation.parts.layers import convex
from optlink.presentation.parts.leaders import crossings
from optlink.presentation.parts.model import PartSet, distance, placed
from optlink.presentation.parts.solids import polygon
from optlink.presentation.parts.view import FIRST, SAME, Item, Line, Words, box, circle, letters, segment

BALLOON = 4.5  # radius
CROSS = 4.0  # half the arm of the cross at a point that is no joint
GRID = 41  # places for the tip of a balloon in each direction
COARSE = 11  # the same where positions of the assembly are compared
STEP = 0.5  # distance of the points at which the edges of an assembly are hidden or not
SIDES = ("tb", "tblr", "tbl", "tbr", "lr")  # sides of an assembly at which balloons may lie
SIDE, OVER, CROSSING = 30.0, 40.0, 400.0  # what a side with balloons, a leader over a pin and two crossing leaders cost [mm]
AROUND = np.array([36.0, 50.0])  # width and height of balloons and caption beside an assembly


@dataclass(frozen=True, eq=False)
class _Thing:
    """A part, pin or opening of an assembly [mm on paper]: within the distance `reach` of its core; `level` grows upwards."""

    level: float
    core: Array
    reach: float
    edges: tuple[tuple[Vertex, ...], ...] = ()
    openings: tuple["_Thing", ...] = ()

    def depth(self, points: Array) -> Array:
        """Return the distances of points (n, 2) from its edge, negative within it."""
        core = np.broadcast_to(self.core, (len(points), *self.core.shape))
        away, sides = distance(points[:, None], core), np.roll(self.core, -1, axis=0) - self.core
        if len(sides) > 2:  # counter-clockwise: the inside lies to the left of every side
            normals = np.column_stack([sides[:, 1], -sides[:, 0]]) / np.linalg.norm(sides, axis=1)[:, None]
            away = np.where(away > 0.0, away, np.max(np.sum((points[:, None] - self.core) * normals, axis=2), axis=1))
        return away - self.reach


def assembly_view(
    parts: PartSet, levels: Mapping[str, int], shown: Sequence[Sequence[str]], at: Motion, k: int, caption: str, factor: float
) -> tuple[Item, ...]:
    """Draw the visible edges of parts and pins at position `k` of a motion, with a balloon for each group of those `shown`.

    `levels`: the layers of the parts; `factor`: millimetres on paper for one of the assembly.
    """
    things = _things(parts, levels, at, k, factor)
    items: list[Item] = []
    for thing in things.values():
        above = [other for other in things.values() if other.level > thing.level]
        items += [line for edge in thing.edges for line in _visible(edge, above)]
    groups = [[things[name] for name in names] for names in shown if names[0] in things]
    targets = [max((_target(one, [*things.values()]) for one in alike), key=itemgetter(0))[1] for alike in groups]
    heads = [things[f"pin {pin.name}"] for pin in parts.pins]
    items += _balloons(np.array(targets), heads, box(items))
    seen = []
    for pin in parts.pins:
        own = things[f"pin {pin.name}"]
        if any(True for _ in _visible(own.edges[0], [other for other in things.values() if other.level > own.level])):
            seen.append((pin.name, own.core[0], own.reach))  # a letter alone would be that of the part that hides it
    for name, part in parts.parts.items():
        for mark, place in part.marks.items():
            tip = factor * placed(at, name, place[None])[k, 0]
            items += [replace(segment(tip - arm, tip + arm), style="centre") for arm in CROSS * np.eye(2)]
            seen.append((mark, tip, CROSS))
    items += letters(seen, items)
    low = box(items)[0]
    return *items, Words(caption, low - [0.0, FIRST], align="left")


def clearest(parts: PartSet, levels: Mapping[str, int], at: Motion, scale: Callable[[Array], float]) -> int:
    """Return the number of the position at which the most of parts and pins is seen, of those with the largest scale.

    Of each counts the largest circle on it that nothing hides, up to the head of a pin. `scale`: that of a view of a size (2,).
    """
    worth = list[tuple[float, float]]()
    enough = 0.5 * min(pin.head for pin in parts.pins)
    for k in range(len(at.crank_angle)):
        things = [*_things(parts, levels, at, k, 1.0).values()]
        extents = np.concatenate([one.core + way * one.reach for one in things for way in (-1.0, 1.0)])
        seen = sum(min(max(_target(one, things, COARSE)[0], -enough), 0.5 * enough) for one in things)
        worth.append((scale(np.ptp(extents, axis=0)), round(seen / enough, 6)))
    return worth.index(max(worth))


def _things(parts: PartSet, levels: Mapping[str, int], at: Motion, k: int, factor: float) -> dict[str, _Thing]:
    """Return parts and pins at a position."""
    things: dict[str, _Thing] = {}
    for name, part in parts.parts.items():
        core, reach = factor * placed(at, name, convex(part))[k], factor * part.reach
        ends = [(factor * placed(at, name, one.ends)[k], 0.5 * factor * one.diameter) for one in part.openings]
        edge = rounded(core, reach) if reach else tuple((float(x), float(y), 0.0) for x, y in core)
        edges = (edge, *itertools.starmap(rounded, ends))
        things[name] = _Thing(levels[name], core, reach, edges, tuple(_Thing(levels[name], *one) for one in ends))
    for pin in parts.pins:
        core, reach = factor * placed(at, pin.on, pin.at[None])[k], 0.5 * factor * pin.head
        level = max(levels[name] for name in pin.parts) + 0.5
        things[f"pin {pin.name}"] = _Thing(level, core, reach, (rounded(core, reach),))
    return things


def _visible(edge: tuple[Vertex, ...], above: Iterable[_Thing]) -> Iterator[Line]:
    """Yield the pieces of a closed edge that nothing above hides."""
    corners = polygon(edge)
    ends = np.concatenate([corners, corners[:1]])
    pieces = [
        np.linspace(a, b, max(1, math.ceil(np.linalg.norm(b - a) / STEP)), endpoint=False) for a, b in itertools.pairwise(ends)
    ]
    points = np.concatenate([*pieces, ends[-1:]])
    hidden = np.any([thing.depth(points) < -SAME for thing in above] or [np.zeros(len(points), dtype=bool)], axis=0)
    if not hidden.any():
        yield Line(edge, "outline", closed=True)
        return
    for run in np.split(np.arange(len(points)), np.flatnonzero(np.diff(hidden)) + 1):
        if not hidden[run[0]] and len(run) > 1:
            yield replace(segment(*points[run]), style="outline")


def _target(thing: _Thing, things: Sequence[_Thing], grid: int = GRID) -> tuple[float, Array]:
    """Return the place at which the balloon of a part or pin points, far from edges and from what hides it, near a middle.

    Its worth comes first: how far it is from them, negative where they hide the thing.
    """
    middle = thing.core.mean(axis=0)
    low, high = thing.core.min(axis=0) - thing.reach, thing.core.max(axis=0) + thing.reach
    places = np.stack(np.meshgrid(*np.linspace(low, high, grid).T), axis=2).reshape(-1, 2)
    places = np.concatenate([middle[None], places])
    others = [*thing.openings, *(other for other in things if other.level > thing.level)]
    clear = [-thing.depth(places), *(other.depth(places) for other in others)]
    worth = np.min(clear, axis=0) - 0.01 * np.linalg.norm(places - middle, axis=1)
    return float(worth.max()), places[int(np.argmax(worth))]


def _balloons(targets: Array, heads: Sequence[_Thing], within: Array) -> Iterator[Item]:
    """Yield numbers in circles beside a box, with leaders to their targets (n, 2): short ones clear of each other and of pins."""
    tried = [_around(targets, heads, within, sides) for sides in SIDES]
    for k, (middle, tip) in enumerate(zip(min(tried, key=itemgetter(0))[1], targets, strict=True), 1):
        way = (tip - middle) / np.linalg.norm(tip - middle)
        yield segment(middle + BALLOON * way, tip)
        yield circle(tip, 0.7, "solid")
        yield circle(middle, BALLOON)
        yield Words(str(k), middle)


def _around(targets: Array, heads: Sequence[_Thing], within: Array, sides: str) -> tuple[float, Array]:
    """Return the cost of placing balloons at some sides of a box, each at the nearest one, and their middles (n, 2)."""
    (left, bottom), (right, top) = within + 3.0 * BALLOON * np.array([[-1.0], [1.0]])
    lines = {"l": (0, left), "r": (0, right), "t": (1, top), "b": (1, bottom)}
    away = np.abs([targets[:, lines[side][0]] - lines[side][1] for side in sides])
    middles, used = targets.copy(), 0
    for k, side in enumerate(sides):
        axis, middles_at = lines[side]
        chosen = np.flatnonzero(np.argmin(away, axis=0) == k)
        order = chosen[np.argsort(targets[chosen, 1 - axis], kind="stable")]
        along = targets[order, 1 - axis].copy()
        for n in range(1, len(along)):
            along[n] = max(along[n], along[n - 1] + 3.0 * BALLOON)
        along += np.mean(targets[order, 1 - axis] - along) if len(along) else 0.0
        middles[order, axis], middles[order, 1 - axis] = middles_at, along
        used += bool(len(order))
    leaders = np.stack([middles, targets], axis=1)
    crossed = int(np.triu(crossings(middles, targets, leaders), 1).sum())
    over = sum(
        int(np.sum((distance(leaders, np.tile(one.core, (len(targets), 1, 1))) < one.reach) & (one.depth(targets) > 0.0)))
        for one in heads
    )
    length = float(np.linalg.norm(middles - targets, axis=1).sum())
    return length + SIDE * used + OVER * over + CROSSING * crossed, middles
