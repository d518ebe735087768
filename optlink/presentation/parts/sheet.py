"""Sheets for the workshop: the assembly with its parts list, and every part with its dimensions, at standard scales."""

import functools
import itertools
import math
import textwrap
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from operator import itemgetter

import numpy as np

from optlink.errors import InputError
from optlink.linkage.mechanism import FRAME, Arm, Size
from optlink.linkage.motion import Motion
from optlink.linkage.vector2d import Array
from optlink.presentation.export.dxf import Vertex, rounded
from optlink.presentation.parts.layers import Stacked, convex, stacked
from optlink.presentation.parts.model import PartSet, distance, number, placed
from optlink.presentation.parts.part_view import part_view
from optlink.presentation.parts.solids import polygon
from optlink.presentation.parts.view import (
    FIRST,
    GAP,
    SAME,
    SMALL,
    Item,
    Line,
    Style,
    Words,
    box,
    circle,
    letters,
    scale_text,
    segment,
    width,
)
from optlink.problem.tolerances import CONTACT
from optlink.tasks.analyze import Analysis

PAPERS = {"A4": np.array([297.0, 210.0]), "A3": np.array([420.0, 297.0])}
SCALES = tuple(step * 10.0**power for power in (1, 0, -1, -2, -3, -4) for step in (5.0, 2.0, 1.0))
LOW, HIGH = np.array([20.0, 10.0]), np.array([10.0, 10.0])  # margins of the border: left and bottom, right and top
ROOM = 5.0  # between border, views and tables
SMALLEST = 3.0  # diameter of a hole on paper below which its part is enlarged
LABEL = 1.8  # height of the letters that name a cell
TOLERANCE = "ISO 2768-m"
ROW = 6.0  # height of a row of the parts list
COLUMNS = {"Pos.": 12.0, "Qty": 10.0, "Name": 50.0, "Size": 50.0, "Layer": 25.0, "Material": 33.0}
BLOCK = (
    (9.0, {"general tolerance": 60.0, "unit": 25.0, "scale": 35.0, "paper": 25.0, "sheet": 35.0}),
    (9.0, {"part": 60.0, "revision": 25.0, "author": 60.0, "date": 35.0}),
    (14.0, {"company": 60.0, "title": 120.0}),
)
"""Rows of the title block from below: height, and widths by label."""
BALLOON = 4.5  # radius
GRID = 41  # places for the tip of a balloon in each direction
STEP = 0.5  # distance of the points at which the edges of an assembly are hidden or not


@dataclass(frozen=True, eq=False)
class Sheet:
    """A drawing of a paper size [mm]."""

    size: Array
    items: tuple[Item, ...]


@dataclass(frozen=True, eq=False)
class View:
    """What is drawn at a scale: `factor` millimetres on paper for one of the parts."""

    factor: float
    items: tuple[Item, ...]

    @functools.cached_property
    def box(self) -> Array:
        """Its lower left and upper right corner (2, 2)."""
        return box(self.items)


@dataclass(frozen=True)
class Entry:
    """A row of the parts list; `members` are the parts, pins or spacers that are such."""

    name: str
    size: str
    members: tuple[str, ...]
    layer: str = ""
    material: str = ""


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


@dataclass(eq=False)
class _Row:
    """Views beside each other on a page, and where the next one begins."""

    page: int
    top: float
    bottom: float
    x: float


def sheets(
    parts: PartSet, cycle: Analysis, at: Motion, caption: str, head: Mapping[str, str]
) -> tuple[list[Sheet], tuple[str, ...]]:
    """Return the sheets of parts: the assembly at the only position of `at` with a caption, then the parts by their scales.

    The second result are the notes that stand on the first sheet.

    `head`: facts of the title block by name: title, company, author, part, revision, date.

    Raises
    ------
    InputError
        If a part has more dimensions than a sheet has room for.
    """
    layers: Stacked | None = None
    notes = parts.notes
    try:
        layers = stacked(parts)
        notes = (*notes, f"Layers are {number(parts.pitch)} mm apart.")
        bare = ", ".join(sorted({pin.name for pin in parts.pins} - {pin.name for pin, *_ in layers.spacers}))
        notes = (*notes, *([f"Without room for spacers: {bare}."] if bare else []))
    except InputError as error:  # the parts can be drawn; their order in the assembly and the lengths of the pins remain open
        message = error.faults[0].message
        notes = (*notes, f"{message[0].upper()}{message[1:]}.")
    entries = [*_entries(parts, layers)]
    assembly = functools.partial(_assembly, parts, layers, entries, at, caption)
    least = min(one.diameter for part in parts.parts.values() for one in part.openings)
    listed = [*_parts_list(entries, " ".join(notes))]
    rows = math.ceil(float(np.ptp(box(listed), axis=0)[1]) / ROW)
    first, paper = _fitting(assembly, least, lambda paper: (_above(paper, rows), _beside(paper)), "the assembly", parts.file)
    pages = [(paper, [View(first.factor, moved(listed, _corner(paper))), first])]
    tolerances, views, large = dict(_tolerances(parts, cycle)), list[View](), 0
    for k, (entry, part) in enumerate(zip(entries, parts.parts.values(), strict=False), 1):
        remarks = filter(None, ("   ".join(filter(None, (entry.size, entry.material))), part.note))
        draw = functools.partial(part_view, part, f"{k}  {part.name}", [*remarks], tolerances)
        least = min(one.diameter for one in part.openings)
        view, paper = _fitting(draw, least, lambda paper: (_above(paper),), part.name, parts.file)
        views.append(view)
        large = max(large, [*PAPERS].index(paper))
    tried = [(paper, _pages(paper, views)) for paper in [*PAPERS][large:]]
    paper, sides = min(tried, key=lambda one: len(one[1]))
    pages += [(paper, side) for side in sides]
    made = []
    for k, (paper, page) in enumerate(pages, 1):
        drawn = itertools.chain.from_iterable(view.items for view in page)
        made.append(Sheet(PAPERS[paper], (*drawn, *_frame(paper, page, f"{k} / {len(pages)}", head))))
    return made, notes


def moved(items: Iterable[Item], shift: Array) -> tuple[Item, ...]:
    """Return what is drawn, shifted by a vector (2,)."""
    return tuple(item.moved(shift) for item in items)


def _tolerances(parts: PartSet, cycle: Analysis) -> Iterator[tuple[tuple[str, str, int], str]]:
    """Yield the tolerances of lengths and coordinates that the problem states, by part, joint and axis."""
    mechanism = cycle.machine.mechanism
    sizes: list[tuple[str, str, Iterable[Size]]] = [(link.body, link.end, (link.length,)) for link in mechanism.links]
    sizes += [(mark.body, mark.name, (mark.along, mark.across)) for mark in mechanism.marks.values()]
    for name, place in mechanism.ground.items():
        if isinstance(place, Arm):
            sizes.append((FRAME, name, (place.length,)))
        elif not parts.parts[FRAME].note:
            sizes.append((FRAME, name, place))
    for (part, joint, places), one in itertools.product(sizes, cycle.problem.model.deviations):
        for axis, size in enumerate(places):
            if one.size == size and one.shape != CONTACT and not one.values:
                yield (part, joint, axis), f" ±{number(1e3 * one.tolerance)}"


def _entries(parts: PartSet, layers: Stacked | None) -> Iterator[Entry]:
    """Yield the rows of the parts list: every part, pins and spacers of one size together."""
    for name, part in parts.parts.items():
        yield Entry(name, f"t = {number(part.thickness)}", (name,), str(layers.layers[name]) if layers else "", part.material)
    groups: dict[tuple[str, str, str], list[str]] = {}
    for pin in parts.pins:
        length, layer = "", ""
        if layers:
            among = [layers.layers[name] for name in pin.parts]
            low, high = layers.span(pin)
            length, layer = f" × {number(high - low)}", f"{min(among)}–{max(among)}"
        head = f"{' between' if layers else ','} heads Ø{number(pin.head)} × {number(pin.height)}" if pin.height else ""
        groups.setdefault(("pin", f"Ø{number(pin.diameter)}{length}{head}", layer), []).append(pin.name)
    for pin, _, tube in layers.spacers if layers else ():
        size = f"Ø{number(tube.width)} / Ø{number(pin.diameter)} × {number(tube.thickness)}"
        groups.setdefault(("spacer", size, ""), []).append(pin.name)
    for (kind, size, layer), names in groups.items():
        yield Entry(f"{kind} {', '.join(dict.fromkeys(names))}", size, tuple(f"{kind} {name}" for name in names), layer)


# --- the assembly ------------------------------------------------------------------------------------------------------------


def _assembly(
    parts: PartSet, layers: Stacked | None, entries: Sequence[Entry], at: Motion, caption: str, factor: float
) -> tuple[Item, ...]:
    """Draw the visible edges of parts and pins, with balloons."""
    levels = layers.layers if layers else {name: k for k, name in enumerate(parts.parts)}
    things: dict[str, _Thing] = {}
    for name, part in parts.parts.items():
        core, reach = factor * placed(at, name, convex(part))[0], factor * part.reach
        ends = [(factor * placed(at, name, one.ends)[0], 0.5 * factor * one.diameter) for one in part.openings]
        edge = rounded(core, reach) if reach else tuple((float(x), float(y), 0.0) for x, y in core)
        edges = (edge, *itertools.starmap(rounded, ends))
        things[name] = _Thing(levels[name], core, reach, edges, tuple(_Thing(levels[name], *one) for one in ends))
    for pin in parts.pins:
        core, reach = factor * placed(at, pin.on, pin.at[None])[0], 0.5 * factor * pin.head
        level = max(levels[name] for name in pin.parts) + 0.5
        things[f"pin {pin.name}"] = _Thing(level, core, reach, (rounded(core, reach),))
    items: list[Item] = []
    for thing in things.values():
        above = [other for other in things.values() if other.level > thing.level]
        items += [line for edge in thing.edges for line in _visible(edge, above)]
    shown = [[things[name] for name in one.members] for one in entries if one.members[0] in things]
    targets = [_target(alike, [*things.values()]) for alike in shown]
    items += _balloons(np.array(targets), box(items))
    seen = []
    for pin in parts.pins:
        own = things[f"pin {pin.name}"]
        if any(True for _ in _visible(own.edges[0], [other for other in things.values() if other.level > own.level])):
            seen.append((pin.name, own.core[0], own.reach))  # a letter alone would be that of the part that hides it
    items += letters(seen, items)
    low = box(items)[0]
    return *items, Words(caption, low - [0.0, FIRST], align="left")


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


def _target(alike: Iterable[_Thing], things: Sequence[_Thing]) -> Array:
    """Return the place at which the balloon of parts or pins points: far from edges and from what hides it, near a middle."""
    found: list[tuple[float, Array]] = []
    for thing in alike:
        middle = thing.core.mean(axis=0)
        sides = [
            np.linspace(low, high, GRID)
            for low, high in zip(
                *(thing.reach * way + end for way, end in ((-1.0, thing.core.min(axis=0)), (1.0, thing.core.max(axis=0)))),
                strict=True,
            )
        ]
        places = np.concatenate([middle[None], np.stack(np.meshgrid(*sides), axis=2).reshape(-1, 2)])
        others = [*thing.openings, *(other for other in things if other.level > thing.level)]
        clear = [-thing.depth(places), *(other.depth(places) for other in others)]
        worth = np.min(clear, axis=0) - 0.01 * np.linalg.norm(places - middle, axis=1)
        found.append((float(worth.max()), places[int(np.argmax(worth))]))
    return max(found, key=itemgetter(0))[1]


def _balloons(targets: Array, within: Array) -> Iterator[Item]:
    """Yield numbers in circles above and below a box, with leaders to their targets (n, 2)."""
    upper = targets[:, 1] >= np.mean(within[:, 1])
    for chosen, y in ((upper, within[1, 1] + 3.0 * BALLOON), (~upper, within[0, 1] - 3.0 * BALLOON)):
        order = np.flatnonzero(chosen)[np.argsort(targets[chosen, 0], kind="stable")]
        xs = targets[order, 0].copy()
        for k in range(1, len(xs)):
            xs[k] = max(xs[k], xs[k - 1] + 3.0 * BALLOON)
        xs += np.mean(targets[order, 0] - xs) if len(xs) else 0.0
        for k, x in zip(order, xs, strict=True):
            middle, tip = np.array([x, y]), targets[k]
            way = (tip - middle) / np.linalg.norm(tip - middle)
            yield segment(middle + BALLOON * way, tip)
            yield circle(tip, 0.7, "solid")
            yield circle(middle, BALLOON)
            yield Words(str(k + 1), middle)


# --- tables and layout -------------------------------------------------------------------------------------------------------


def _parts_list(entries: Sequence[Entry], notes: str) -> Iterator[Item]:
    """Yield the parts list from its lower left corner upwards, without empty columns, and the notes above it."""
    facts = [(str(k), str(len(one.members)), one.name, one.size, one.layer, one.material) for k, one in enumerate(entries, 1)]
    table = {name: texts for name, *texts in zip(COLUMNS, *facts, strict=True) if any(texts)}
    spare, x = sum(COLUMNS[name] for name in COLUMNS if name not in table), 0.0
    for name, texts in table.items():
        wide = COLUMNS[name] + spare * (name == "Size")
        for k, text in enumerate([name, *texts]):
            yield from _cell("", text, np.array([x, k * ROW]), np.array([wide, ROW]))
        x += wide
    high = 4.5 * GAP + 1.5 * SMALL * math.ceil(width(notes, SMALL) / (0.9 * x))
    yield from _cell("notes", notes, np.array([0.0, (len(entries) + 1) * ROW]), np.array([x, high]))


def _frame(paper: str, page: Sequence[View], count: str, head: Mapping[str, str]) -> Iterator[Item]:
    """Yield border and title block."""
    scale = ", ".join(map(scale_text, sorted({view.factor for view in page})))
    yield _rectangle(LOW, PAPERS[paper] - LOW - HIGH)
    y = LOW[1]
    for high, row in BLOCK:
        x = _corner(paper)[0]
        for label, wide in row.items():
            facts = {"general tolerance": TOLERANCE, "unit": "mm", "scale": scale, "paper": paper, "sheet": count, **head}
            yield from _cell(label, facts.get(label, ""), np.array([x, y]), np.array([wide, high]))
            x += wide
        y += high


def _rectangle(low: Array, size: Array, style: Style = "outline") -> Line:
    corners = low + np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]) * size
    return replace(segment(*corners), style=style, closed=True)


def _cell(label: str, text: str, low: Array, size: Array) -> Iterator[Item]:
    """Yield a cell with its label and its text, in lines of the largest letters that fit; what has no room is an ellipsis."""
    yield _rectangle(low, size, "thin")
    room = size - [3.0 * GAP, 3.5 * GAP if label else GAP]
    if label:
        yield Words(label, low + np.array([GAP, size[1] - GAP - 0.5 * LABEL]), LABEL, align="left")
    lines: list[str] = []
    most, height = 0, LABEL
    for height in (5.0, 3.5, SMALL, LABEL) if label else (SMALL, LABEL):
        most = int(room[1] / (1.5 * height))
        letters = int(room[0] * max(1, len(text)) / max(width(text, height), SAME))
        lines = textwrap.wrap(text, max(1, letters))
        if len(lines) <= most:
            break
    else:
        lines = [*lines[: most - 1], lines[most - 1][:-1] + "…"]
    for k, line in enumerate(reversed(lines)):
        yield Words(line, low + np.array([1.5 * GAP, 0.5 * GAP + 0.75 * height + 1.5 * height * k]), height, align="left")


def _corner(paper: str) -> Array:
    """Return the upper left corner of the title block."""
    return np.array([PAPERS[paper][0] - HIGH[0] - sum(BLOCK[0][1].values()), LOW[1] + sum(high for high, _ in BLOCK)])


def _above(paper: str, rows: int = 0) -> Array:
    """Return the free rectangle (2, 2) above the title block with a list of so many rows."""
    return np.array([[LOW[0] + ROOM, _corner(paper)[1] + rows * ROW + ROOM], PAPERS[paper] - HIGH - ROOM])


def _beside(paper: str) -> Array:
    """Return the free rectangle (2, 2) to the left of the title block."""
    return np.array([LOW + ROOM, [_corner(paper)[0] - ROOM, PAPERS[paper][1] - HIGH[1] - ROOM]])


def _fitting(
    draw: Callable[[float], tuple[Item, ...]], hole: float, areas: Callable[[str], Iterable[Array]], name: str, file: str
) -> tuple[View, str]:
    """Return a view in the middle of a free area, at the largest scale at which it fits, and its paper.

    A view is enlarged only as far as its hole [mm] needs.
    """
    largest = min((factor for factor in SCALES if factor >= 1.0 and factor * hole >= SMALLEST), default=SCALES[0])
    for factor in SCALES[SCALES.index(largest) :]:
        view = View(factor, draw(factor))
        low, high = view.box
        for paper in PAPERS:
            for begin, end in areas(paper):
                if np.all(end - begin >= high - low):
                    return View(factor, moved(view.items, 0.5 * (begin + end - low - high))), paper
    raise InputError(
        f"the drawing of {name} does not fit on an A3 sheet", "Write the parts without dimensions: --content parts", file
    )


def _pages(paper: str, views: Iterable[View]) -> list[list[View]]:
    """Return the views of every sheet: in rows from the top, the deepest first, each in the first place with room."""
    (left, low), (right, high) = _above(paper)
    pages: list[list[View]] = []
    rows: list[_Row] = []
    for view in sorted(views, key=lambda view: -float(np.ptp(view.box, axis=0)[1])):
        wide, deep = np.ptp(view.box, axis=0)
        row = next((row for row in rows if row.x + wide <= right + SAME), None)
        if row is None:
            bottoms = {row.page: row.bottom - 2.0 * ROOM for row in rows}
            page = next((page for page, bottom in bottoms.items() if bottom - deep >= low - SAME), len(pages))
            top = bottoms.get(page, high)
            row = _Row(page, top, top - deep, left)
            rows.append(row)
            pages += [[]] * (page == len(pages))
        pages[row.page] = [
            *pages[row.page],
            View(view.factor, moved(view.items, np.array([row.x - view.box[0, 0], row.top - view.box[1, 1]]))),
        ]
        row.x += wide + 2.0 * ROOM
    return pages
