"""Placement of texts and their lines on a drawing: each where it covers least of the drawing and of the other ones.

The drawing is divided into cells. Two texts, or a text and a line, cost what they share of them; the places of all texts are
improved in turn until none has a cheaper one. Every share counts the same for both, so that each step lowers the total.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from optlink.linkage.vector2d import Array

CELL = 0.25  # side of a cell, in font sizes
HIGH, ROOM = 0.45, 0.15  # half the height of a text and the space around it, in font sizes
ON_TEXT, ON_LINK, ACROSS = 0.5, 0.35, 0.25  # costs of a cell that a text shares with another text, a link, a line
LINE = 0.08  # that a line shares with a link or another line
SWEEPS = 12

Cells = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Place:
    """One possible place of a text with its lines.

    `middle` (2,) and `along` (2,), a unit vector, are those of the text, `half` is half its width; `lines` are its lines, each
    (n, 2); `cost` is small where the place is preferred.
    """

    middle: Array
    along: Array
    half: float
    lines: tuple[Array, ...] = ()
    cost: float = 0.0

    def text(self, font: float, room: float = 0.0) -> Array:
        """Return points (n, 2) of the box of the text, with room around it, in the unit of the drawing."""
        wide, high = self.half + room, HIGH * font + room
        across = np.array([-self.along[1], self.along[0]])
        u, v = (np.linspace(-end, end, 2 + int(2.0 * end / (0.8 * CELL * font))) for end in (wide, high))
        return np.asarray(self.middle + (u[:, None, None] * self.along + v[:, None] * across).reshape(-1, 2))


def sampled(line: Array, step: float) -> Array:
    """Return points (n, 2) along a line (m, 2), at most a step apart along it."""
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
    at = np.linspace(0.0, along[-1], 1 + max(1, int(np.ceil(along[-1] / step))))
    return np.stack([np.interp(at, along, line[:, k]) for k in (0, 1)], axis=1)


def arrange(items: Sequence[Sequence[Place]], links: Sequence[Array], font: float) -> list[Place]:
    """Return the place of every text from its possible ones, clear of links (n, 2) that are already drawn."""
    cell = CELL * font
    drawn = [sampled(line, cell) for line in links]
    boxes = [[place.text(font, ROOM * font) for place in places] for places in items]
    lines = [[[sampled(line, cell) for line in place.lines] for place in places] for places in items]
    every = np.concatenate([*drawn, *(box for own in boxes for box in own), *(x for own in lines for each in own for x in each)])
    low = every.min(axis=0) - cell
    across, along = (int(n) + 1 for n in np.ceil((every.max(axis=0) + cell - low) / cell))

    def cells(pieces: Sequence[Array]) -> Cells:
        if not pieces:
            return np.empty(0, dtype=np.intp)
        column, row = np.floor((np.concatenate(pieces) - low) / cell).astype(np.intp).T
        return np.unique(column * (along + 1) + row)

    texts, rules, bars = np.zeros((3, (across + 1) * (along + 1)))
    wide = np.array([(x, y) for x in (-cell, 0.0, cell) for y in (-cell, 0.0, cell)])  # a link is about three cells wide
    bars[cells([(line[:, None] + wide).reshape(-1, 2) for line in drawn])] = 1.0
    covered = [[(cells([box]), cells(own)) for box, own in zip(*both, strict=True)] for both in zip(boxes, lines, strict=True)]
    fixed = [
        [place.cost + ON_LINK * bars[text].sum() + LINE * bars[rule].sum() for place, (text, rule) in zip(*both, strict=True)]
        for both in zip(items, covered, strict=True)
    ]

    def best(k: int) -> int:
        costs = [
            base + ON_TEXT * texts[text].sum() + ACROSS * (rules[text].sum() + texts[rule].sum()) + LINE * rules[rule].sum()
            for base, (text, rule) in zip(fixed[k], covered[k], strict=True)
        ]
        return int(np.argmin(costs))

    def put(k: int, choice: int, sign: float) -> None:
        text, rule = covered[k][choice]
        texts[text] += sign
        rules[rule] += sign

    chosen: list[int] = []
    for k in range(len(items)):
        chosen.append(best(k))
        put(k, chosen[k], 1.0)
    for _ in range(SWEEPS):
        before = list(chosen)
        for k in range(len(items)):
            put(k, chosen[k], -1.0)
            chosen[k] = best(k)
            put(k, chosen[k], 1.0)
        if chosen == before:
            break
    return [places[choice] for places, choice in zip(items, chosen, strict=True)]
