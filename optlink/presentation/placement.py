"""Places of the texts of a drawing: each where it hides least of the drawing and of the other texts, still or in motion.

Every text has possible places. The drawing is divided into cells, at each position of a motion: a place costs the lines and texts
in the cells that it covers, and more where it is far from its point or seems to belong to another one. The texts are improved in
turn until none has a cheaper place; of a text that moves, the cheapest course of places over the motion is taken, where a change
of place costs as much as a few positions with a line behind the text. A cell that two texts share counts the same for both, so
that each step lowers the total.
"""

from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from optlink.linkage.vector2d import TURN, Array

CELL = 0.25  # side of a cell, in font sizes: half the width of a letter, less than which is not seen
HIGH, ROOM = 0.45, 0.15  # half the height of a text, from p to b, and the space around it, in font sizes
ON_TEXT, ON_LINE, ACROSS = 0.5, 0.35, 0.25
"""Costs of a cell that a text shares with a text, with a line of the drawing, with a line of a text: more if less is legible."""
LINES = 0.08  # cost of a cell that a line of a text shares with another line: both remain visible
OUTSIDE, WRONG, HIDDEN, CHANGE = 100.0, 20.0, 10.0, 25.0
"""Costs of a text that leaves the drawing, seems to belong to another point, hides a point, changes its place.

To leave the drawing is by far the worst; a change costs as much as some positions on a line of the drawing.
"""
FIRST = 0.25  # share of the motion as which the first position counts for a text at rest: pages show and print it still
SWEEPS = 12  # most rounds in which the texts are improved: each lowers the total, the later ones by little
MOST = 3_000_000  # points of all possible places, some 50 MB, beyond which not every position is examined
DIRECTIONS = np.array([[np.cos(t), np.sin(t)] for t in np.linspace(0.0, TURN, 16, endpoint=False)])
SIDES = np.clip(1.5 * DIRECTIONS, -1.0, 1.0)  # where the middle of a text lies in these directions, in halves of its size
WAYS = np.where(np.abs(SIDES) == 1.0, DIRECTIONS, 0.0)
WAYS /= np.linalg.norm(WAYS, axis=1, keepdims=True)  # from a point to the near side or corner of the text
LEVEL = DIRECTIONS[:1]

Choice = NDArray[np.intp]
"""The number of the place of a text at each position."""

MAX_LETTERS = 12
"""Most letters of the name of a point in a drawing: six at its beginning, five at its end."""


def short_name(name: str) -> str:
    """Return a name as drawings show it: without the middle if it is long, as the ends of similar names differ."""
    return name if len(name) <= MAX_LETTERS else f"{name[:6]}\u2026{name[-5:]}"


@dataclass(frozen=True, eq=False)
class Places:
    """The possible places of a text: middles (places, 2) relative to a point (positions or 1, 2), and their costs.

    `half` (2,) is half the size of the text; the costs are (positions or 1, places); `along` (places, 2) are unit vectors
    along the text, which else is level; `lines` (places, n, 2) are points of its lines, NaN for none.
    A text that does not move has one place at all positions.
    """

    at: Array
    middles: Array
    half: Array
    costs: Array
    along: Array | None = None
    lines: Array | None = None
    moves: bool = False

    def covered(self, room: float, step: float) -> Array:
        """Return points (positions, places, n, 2) of the box with room around it, at most a step apart."""
        u, v = (np.linspace(-end, end, 2 + int(2.0 * end / step)) for end in self.half + room)
        along = LEVEL if self.along is None else self.along
        grid = u[:, None, None, None] * along + v[:, None, None] * along[:, ::-1] * [-1.0, 1.0]
        around = self.middles[:, None] + grid.reshape(-1, len(along), 2).swapaxes(0, 1)
        return np.asarray(self.at[:, None, None] + around)


def written(middle: Array, half: Array) -> Places:
    """Return the only place of a text that is drawn already."""
    return Places(middle[None], np.zeros((1, 2)), half, np.zeros((1, 1)))


def beside(
    at: Array,
    half: Array,
    reaches: Array,
    price: float,
    others: Iterable[Array],
    prefer: Array | tuple[float, float],
    moves: bool = False,
) -> Places:
    """Return the places of a text beside a point (positions, 2): `reaches` away in all directions.

    They cost a price for each unit of distance, and what is missing of a preferred direction (x, y); `others` are points
    (positions, 2) to which the text must not seem to belong.
    """
    offsets = np.concatenate([reach * WAYS + half * SIDES for reach in reaches])
    costs = np.repeat(price * reaches, len(DIRECTIONS)) - np.tile(DIRECTIONS @ prefer, len(reaches))
    total = np.tile(costs, (len(at), 1))

    def away(way: Array) -> Array:
        return np.asarray(np.linalg.norm(np.maximum(np.abs(way[:, None] - offsets) - half, 0.0), axis=2))

    own = away(np.zeros((1, 2)))
    for other in others:
        distance = away(other - at)
        wrong = WRONG * np.clip(1.25 - distance / own, 0.0, 1.0) + HIDDEN * (distance < 0.5 * reaches[0])
        total += np.where(np.linalg.norm(other - at, axis=1)[:, None] > reaches[0], wrong, 0.0)
    return Places(at, offsets, half, total, moves=moves)


def sampled(line: Array, step: float) -> Array:
    """Return points (positions, n, 2) along a line (positions, corners, 2) with gaps at NaN, about a step apart."""
    lengths = np.fmax.reduce(np.linalg.norm(np.diff(line, axis=1), axis=2), axis=0, initial=0.0)
    count = np.ceil(lengths / step).astype(int)
    segment = np.repeat(np.arange(len(count)), count)
    shares = ((np.arange(len(segment)) - np.repeat(np.cumsum(count) - count, count)) / count[segment])[:, None]
    between = (1.0 - shares) * line[:, segment] + shares * line[:, segment + 1]
    return np.concatenate([between, line], axis=1)


def joined(lines: Iterable[Array]) -> Array:
    """Return lines (positions, corners, 2) as one with gaps, which takes much less time to sample than many short ones."""
    return np.concatenate([piece for line in lines for piece in (line, np.full((len(line), 1, 2), np.nan))], axis=1)


def arrange(
    texts: Sequence[Places],
    drawing: Sequence[tuple[Array, float]],
    font: float,
    box: tuple[float, float, float, float] | None = None,
) -> list[Choice]:
    """Return the places of texts, clear of the drawing: lines (positions or 1, corners, 2) and how much each of them counts.

    `box` is the extent of the drawing: lower left corner, width, height.
    """
    step = CELL * font
    count = max((len(text.at) for text in texts), default=0)
    boxes = [text.covered(ROOM * font, step) for text in texts]
    every = max(1, -(-sum(one.size for one in boxes) // (2 * MOST)))
    some = np.arange(0, count, every)

    def examined(values: Array) -> Array:
        return values[some] if len(values) > 1 else values

    boxes = [examined(one) for one in boxes]
    lines = [np.empty((1, 1, 0, 2)) if text.lines is None else text.lines[None] for text in texts]
    every_point = np.concatenate([np.zeros((0, 2)), *(one.reshape(-1, 2) for one in (*boxes, *lines))])
    low = np.array([np.fmin.reduce(values, initial=np.inf) for values in every_point.T]) - step  # an axis of two numbers is slow
    high = np.array([np.fmax.reduce(values, initial=-np.inf) for values in every_point.T]) + step
    columns, rows = (int(n) + 2 for n in (high - low) / step)
    here = np.arange(len(some))[:, None, None]

    def around(points: Array) -> NDArray[np.intp]:
        """Return the cell of each point (..., 2); the others are in a further one, in which nothing is."""
        x, y = ((points[..., k] - low[k]) / step for k in range(2))
        known = (x >= 0.0) & (x < columns) & (y >= 0.0) & (y < rows)
        column, row = (np.where(known, at, 0.0).astype(np.intp) for at in (x, y))
        return np.where(known, column * rows + row, columns * rows)

    def cells(points: Array) -> NDArray[np.intp]:
        """Return the cells of points (..., n, 2), each once, the further one in place of the others."""
        found = np.sort(around(points), axis=-1)
        found[..., 1:][found[..., 1:] == found[..., :-1]] = columns * rows
        return found

    words, rules, bars = np.zeros((3, len(some), columns * rows + 1))
    alike = defaultdict[tuple[float, int], list[Array]](list)
    for line, weight in drawing:
        alike[weight, len(line)].append(np.clip(examined(line), low - 50.0 * step, high + 50.0 * step))
    for (weight, _), pieces in alike.items():
        taken = around(sampled(joined(pieces), step))
        bars[here[:, 0], taken] = np.maximum(bars[here[:, 0], taken], weight)
    bars[:, -1] = 0.0
    covered = [(cells(one), cells(own)) for one, own in zip(boxes, lines, strict=True)]

    def under(layer: Array, place: NDArray[np.intp]) -> Array:
        return np.asarray(layer[here, place].sum(axis=2))

    fixed = []
    for text, points, (word, rule) in zip(texts, boxes, covered, strict=True):
        cost = examined(text.costs) + ON_LINE * under(bars, word) + LINES * under(bars, rule)
        if box is not None:
            x, y = points[..., 0], points[..., 1]
            beyond = (x < box[0]) | (x > box[0] + box[2]) | (y < box[1]) | (y > box[1] + box[3])
            cost = cost + OUTSIDE * (np.any(beyond, axis=2) + np.mean(beyond, axis=2))
        fixed.append(cost)

    def best(k: int) -> Choice:
        word, rule = covered[k]
        shared = ON_TEXT * under(words, word) + ACROSS * (under(rules, word) + under(words, rule)) + LINES * under(rules, rule)
        costs = np.nan_to_num(fixed[k] + shared)
        at_rest = costs.sum(axis=0) + FIRST * len(costs) * costs[0]
        return _course(costs) if texts[k].moves else np.full(len(some), np.argmin(at_rest))

    def put(k: int, choice: Choice, sign: float) -> None:
        for layer, places in zip((words, rules), covered[k], strict=True):
            at = here[:, 0, 0]
            own = places[at if len(places) > 1 else 0, choice if places.shape[1] > 1 else 0]
            np.add.at(layer, (here[:, 0], own), sign)
            layer[:, -1] = 0.0

    chosen: list[Choice] = []
    for k in range(len(texts)):
        chosen.append(best(k))
        put(k, chosen[k], 1.0)
    for _ in range(SWEEPS):
        before = list(chosen)
        for k in range(len(texts)):
            put(k, chosen[k], -1.0)
            chosen[k] = best(k)
            put(k, chosen[k], 1.0)
        if all(map(np.array_equal, before, chosen)):
            break
    return [choice[np.arange(count) // every] for choice in chosen]


def _course(cost: Array) -> Choice:
    """Return the places (positions,) of least total cost (positions, places), changes included (Viterbi's algorithm)."""
    count, places = cost.shape
    before = np.zeros((count, places), dtype=np.intp)
    total = cost[0]
    for k in range(1, count):
        best = int(np.argmin(total))
        changed = total > total[best] + CHANGE
        before[k] = np.where(changed, best, np.arange(places))
        total = np.where(changed, total[best] + CHANGE, total) + cost[k]
    course = np.empty(count, dtype=np.intp)
    course[-1] = int(np.argmin(total))
    for k in range(count - 1, 0, -1):
        course[k - 1] = before[k, course[k]]
    return course
