"""The view of a part on paper [mm]: its edges, the dimensions of its holes and outline, and what stands below it."""

import itertools
import math
import textwrap
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from operator import itemgetter

import numpy as np

from optlink.linkage.mechanism import FRAME
from optlink.linkage.vector2d import Array
from optlink.presentation.export.dxf import Vertex
from optlink.presentation.parts.leaders import Label, Target, clear, labelled
from optlink.presentation.parts.model import FlatPart, Opening, number
from optlink.presentation.parts.outline import middle
from optlink.presentation.parts.view import FIRST, GAP, SAME, TEXT, Item, Line, Measure, Words, box, letters, scale_text, segment

ROW = 7.5  # distance of two dimension lines
CROSS = 2.0  # of a centre line beyond its hole
LYING = 1.4  # height of a part that lies on its side, in widths
LINE = 60  # most letters of a line below a part
ASIDE = math.radians(30.0)  # most angle of a leader to the normal of the edge at which it points

Paper = Callable[[Array], Array]
"""Where a point of a part is on paper."""


def part_view(
    part: FlatPart, caption: str, remarks: Iterable[str], tolerances: Mapping[tuple[str, str, int], str], factor: float
) -> tuple[Item, ...]:
    """Draw a part with its dimensions: the coordinates of all holes in its axes, and its outline.

    The caption, with the scale, and the remarks stand below it. `tolerances` of coordinates by part, joint and axis; `factor`:
    millimetres on paper for one of the part. A part that is rather higher than wide lies on its side.
    """
    axes = np.array([part.along, [-part.along[1], part.along[0]]])
    wide, high = np.ptp(part.core @ axes.T, axis=0)
    lying = bool(high > LYING * wide)
    turn = factor * (np.array([axes[1], -axes[0]]) if lying else axes)

    def paper(at: Array) -> Array:
        return np.asarray((at - part.origin) @ turn.T)

    def drawn(vertices: Iterable[Vertex]) -> Line:
        corners = ((*paper(np.array([x, y])), bulge) for x, y, bulge in vertices)
        return Line(tuple((float(x), float(y), bulge) for x, y, bulge in corners), "outline", closed=True)

    places = [(one.joint, paper(end), 0.5 * factor * one.diameter) for one in part.openings for end in one.ends[: 2 - one.round]]
    marks = [(name, paper(at), 0.0) for name, at in part.marks.items()]
    outline, openings = drawn(part.outline), [drawn(one.outline) for one in part.openings]
    low, high = box([outline])
    bar = bool(np.ptp(paper(part.core)[:, 1]) < SAME) and not (part.reach and wide < SAME)
    items: list[Item] = [outline, *openings]
    for _, at, radius in (*places, *marks):
        items += [replace(segment(at - arm, at + arm), style="centre") for arm in (radius + CROSS) * np.eye(2)]
    edges = (
        [] if part.reach or not bar else [("", np.array([low[0], 0.5 * (low[1] + high[1])]), 0.5 * (high[1] - low[1]) - CROSS)]
    )
    measures = list[Measure]()
    for upright in (False, True):
        rows: dict[float, list[tuple[str, Array]]] = {}  # by distance, the points with the ends of their extension lines
        for name, at, radius in (*places, *marks, *(edges if not upright else ())):
            foot = at - (radius + CROSS + GAP) * np.eye(2)[1 - upright]
            rows.setdefault(round(float(at[int(upright)]), 6), []).append((name, foot))
        near = {key: min((foot for _, foot in row), key=itemgetter(1 - upright)) for key, row in rows.items()}
        for k, key in enumerate(sorted((key for key in rows if abs(key) > SAME), key=abs)):
            tolerance = max(tolerances.get((part.name, name, int(upright != lying)), "") for name, _ in rows[key])
            line = float(low[1 - upright]) - FIRST - ROW * k
            measures.append(Measure(np.array([near[0.0], near[key]]), line, bool(upright), factor, tolerance))
    if edges:
        ends = np.array([[low[0], low[1] - GAP], [high[0], low[1] - GAP]])
        line = min((one.line for one in measures if not one.upright), default=float(low[1]) - FIRST + ROW) - ROW
        measures.append(Measure(ends, line, False, factor))
    if bar:
        edge = float(high[0]) - (0.5 * factor * part.width if part.reach else 0.0) + GAP
        measures.append(Measure(np.array([[edge, low[1]], [edge, high[1]]]), float(high[0]) + FIRST, True, factor))
    items += clear(measures)
    items += labelled([*_diameters(part, paper, factor), *_shape(part, outline, factor, bar)], items, outline, openings)
    items += letters([*{name: (name, at, radius) for name, at, radius in (*places, *marks)}.values()], items)
    left, bottom = box(items)[0]
    turned = round(math.degrees(math.atan2(turn[1, 0], turn[0, 0])), 2)
    way = "counter-clockwise" if turned > 0.0 else "clockwise"
    words = [f"{caption}   {scale_text(factor)}", *(line for one in remarks for line in textwrap.wrap(one, LINE))]
    words += [f"turned by {number(abs(turned))}° {way} from the assembly"] if part.name == FRAME and turned else []
    words += [] if part.reach or bar else textwrap.wrap(_corners(part, outline, factor), LINE)
    for k, text in enumerate(words):
        items.append(Words(text, np.array([left, bottom - FIRST - 2.0 * TEXT * k]), align="left"))
    return tuple(items)


def _corners(part: FlatPart, outline: Line, factor: float) -> str:
    """Return the corners of an outline without arcs in words, which define it: its dimensions would hide those of the holes."""
    places = " ".join(f"({number(x / factor)},\N{NO-BREAK SPACE}{number(y / factor)})" for x, y, _ in outline.vertices)
    return f"corners from {part.openings[0].joint}, right and up: {places}"


def _diameters(part: FlatPart, paper: Paper, factor: float) -> Iterator[Label]:
    """Yield the labels of holes and slots of equal sizes, each at any of them."""
    groups: dict[tuple[bool, float, str], list[Opening]] = {}
    for one in part.openings:
        groups.setdefault((one.round, round(one.diameter, 9), one.fit), []).append(one)
    for (whole, diameter, fit), members in groups.items():
        count = f"{len(members)}× " if len(members) > 1 else ""
        text = f"{count}{'Ø' if whole else 'slot, width '}{number(diameter)} {fit}"
        ends = [end for one in members for end in one.ends[: 2 - one.round]]
        yield Label(text.strip(), [Target(paper(end), 0.5 * factor * diameter) for end in ends])


def _shape(part: FlatPart, outline: Line, factor: float, bar: bool) -> Iterator[Label]:
    """Yield the label of the outer arcs, auxiliary of a bar, or of the chamfers of a bar."""
    vertices = [np.array(one) for one in outline.vertices]
    pairs = [*itertools.pairwise((*vertices, vertices[0]))]
    if part.reach:
        radius, targets = 0.5 * part.width, list[Target]()
        for begin, end in ((one, other) for one, other in pairs if one[2]):
            arm = begin[:2] - middle(begin[:2], end[:2], begin[2])
            low = math.atan2(arm[1], arm[0])
            targets.append(Target(begin[:2] - arm, factor * radius, low, low + 4.0 * math.atan(begin[2])))
        size = f"(R{number(radius)})" if bar else f"R{number(radius)}"
        yield Label(f"{len(targets)}× {size}" if len(pairs) > 2 else f"Ø{number(part.width)}", targets)
        return
    slanted = [(one[:2], other[:2]) for one, other in pairs if np.abs(other - one)[:2].min() > SAME]
    if bar and slanted:
        normals = [math.atan2(one[0] - other[0], other[1] - one[1]) for one, other in slanted]
        targets = [
            Target(0.5 * (one + other), 0.0, at - ASIDE, at + ASIDE) for (one, other), at in zip(slanted, normals, strict=True)
        ]
        yield Label(f"{len(slanted)}× {number(abs(slanted[0][1] - slanted[0][0])[0] / factor)} × 45°", targets)
