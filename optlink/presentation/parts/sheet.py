"""Sheets for the workshop: the assembly with its parts list, and every part with its dimensions, at standard scales."""

import functools
import itertools
import math
import textwrap
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from optlink.errors import InputError
from optlink.linkage.mechanism import FRAME, Arm, Size
from optlink.linkage.motion import Motion
from optlink.linkage.vector2d import Array
from optlink.presentation.parts.assembly import AROUND, assembly_view, clearest
from optlink.presentation.parts.layers import Stacked, stacked
from optlink.presentation.parts.model import FlatPart, PartSet, number
from optlink.presentation.parts.part_view import part_view
from optlink.presentation.parts.view import (
    GAP,
    SAME,
    SMALL,
    Item,
    Line,
    Style,
    Words,
    box,
    scale_text,
    segment,
    width,
)
from optlink.problem.tolerances import CONTACT
from optlink.studies.tolerances.general import GENERAL, general_tolerance
from optlink.tasks.analyze import Analysis

PAPERS = {"A4": np.array([297.0, 210.0]), "A3": np.array([420.0, 297.0])}
SCALES = tuple(step * 10.0**power for power in (1, 0, -1, -2, -3, -4) for step in (5.0, 2.0, 1.0))
LOW, HIGH = np.array([20.0, 10.0]), np.array([10.0, 10.0])  # margins of the border: left and bottom, right and top
ROOM = 5.0  # between border, views and tables
SMALLEST = 3.0  # diameter of a hole on paper below which its part is enlarged
LABEL = 1.8  # height of the letters that name a cell
ROW = 6.0  # height of a row of the parts list
COLUMNS = {"Pos.": 12.0, "Qty": 10.0, "Name": 46.0, "Size": 60.0, "Layer": 16.0, "Material": 36.0}
BLOCK = (
    (9.0, {"general tolerance": 60.0, "unit": 25.0, "scale": 35.0, "paper": 25.0, "sheet": 35.0}),
    (9.0, {"part": 60.0, "revision": 25.0, "author": 60.0, "date": 35.0}),
    (14.0, {"company": 60.0, "title": 120.0}),
)
"""Rows of the title block from below: height, and widths by label."""


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


@dataclass(eq=False)
class _Row:
    """Views beside each other on a page, and where the next one begins."""

    page: int
    top: float
    bottom: float
    x: float


def sheets(
    parts: PartSet, cycle: Analysis, at: Motion, captions: Sequence[str], head: Mapping[str, str], further: Sequence[str] = ()
) -> tuple[list[Sheet], tuple[str, ...]]:
    """Return the sheets of parts: the assembly at one of the positions of `at`, with its caption, then the parts by their scales.

    The second result are the notes that stand on the first sheet.

    `head`: facts of the title block by name: title, company, author, part, revision, date; `further` notes.

    Raises
    ------
    InputError
        If a part has more dimensions than a sheet has room for.
    """
    layers: Stacked | None = None
    notes = (*parts.notes, *further)
    try:
        layers = stacked(parts)
        notes = (*notes, f"Layers are {number(parts.pitch)} mm apart.")
        bare = ", ".join(sorted({pin.name for pin in parts.pins} - {pin.name for pin, *_ in layers.spacers}))
        notes = (*notes, *([f"Without room for spacers: {bare}."] if bare else []))
    except InputError as error:  # the parts can be drawn; their order in the assembly and the lengths of the pins remain open
        message = error.faults[0].message
        notes = (*notes, f"{message[0].upper()}{message[1:]}.")
    entries = [*_entries(parts, layers)]
    levels = layers.layers if layers else {name: k for k, name in enumerate(parts.parts)}
    least = min(one.diameter for part in parts.parts.values() for one in part.openings)
    listed = [*_parts_list(entries, " ".join(notes))]

    papers = [paper for paper in PAPERS if cycle.problem.model.made.paper in (None, paper)]
    apart = papers == [*PAPERS][:1]  # the smallest paper has no room for an assembly and its parts list
    rows = 0 if apart else math.ceil(float(np.ptp(box(listed), axis=0)[1]) / ROW)

    def areas(paper: str) -> tuple[Array, Array]:
        return _above(paper, rows), _beside(paper)

    def scale(size: Array) -> float:
        free = [end - begin for paper in papers for begin, end in areas(paper)]
        fitting = (factor for factor in _scales(least) if any(np.all(one >= factor * size + AROUND) for one in free))
        return next(fitting, 0.0)

    k = clearest(parts, levels, at, scale)
    assembly = functools.partial(assembly_view, parts, levels, [one.members for one in entries], at, k, captions[k])
    first, paper = _fitting(assembly, parts.parts.values(), papers, areas, "the assembly", parts.file)
    table = View(first.factor, moved(listed, _corner(paper)))
    pages = [(paper, [first]), (paper, [table])] if apart else [(paper, [table, first])]
    tolerances, views, large = dict(_tolerances(parts, cycle)), list[View](), 0
    for k, (entry, part) in enumerate(zip(entries, parts.parts.values(), strict=False), 1):
        remarks = filter(None, ("   ".join(filter(None, (entry.size, entry.material))), part.note))
        draw = functools.partial(part_view, part, f"{k}  {part.name}", [*remarks], tolerances)
        view, paper = _fitting(draw, [part], papers, lambda paper: (_above(paper),), part.name, parts.file)
        views.append(view)
        large = max(large, papers.index(paper))
    tried = [_pages(paper, views) for paper in papers[large:]]
    for side in min(tried, key=len):
        packed = ((paper, _pages(paper, side)) for paper in papers if _holds(paper, side))
        pages.append(next((paper, alone) for paper, (alone, *more) in packed if not more))
    made = []
    for k, (paper, page) in enumerate(pages, 1):
        drawn = itertools.chain.from_iterable(view.items for view in page)
        made.append(Sheet(PAPERS[paper], (*drawn, *_frame(paper, page, f"{k} / {len(pages)}", head))))
    return made, notes


def moved(items: Iterable[Item], shift: Array) -> tuple[Item, ...]:
    """Return what is drawn, shifted by a vector (2,)."""
    return tuple(item.moved(shift) for item in items)


def permitted(parts: PartSet, cycle: Analysis) -> dict[str, float]:
    """Return the tolerances [m] of sizes on the sheets: that of the problem, else the general one of the dimension drawn."""
    stated = {one.size: one.tolerance for one in cycle.problem.model.deviations if one.shape != CONTACT and not one.values}
    drawn = {size: 1e-3 * general_tolerance(length) for *_, size, length in _dimensions(parts, cycle)}
    return {size: stated.get(size, by) for size, by in drawn.items() if size in stated or by}


def _dimensions(parts: PartSet, cycle: Analysis) -> Iterator[tuple[str, str, int, str, float]]:
    """Yield the dimensions that are sizes of the linkage: part, joint, axis, name of the size, and length [mm]."""
    mechanism, values = cycle.machine.mechanism, cycle.machine.sizes
    sizes: list[tuple[str, str, Iterable[Size]]] = [(link.body, link.end, (link.length,)) for link in mechanism.links]
    sizes += [(mark.body, mark.name, (mark.along, mark.across)) for mark in mechanism.marks.values()]
    sizes += [(FRAME, name, (place.length,) if isinstance(place, Arm) else place) for name, place in mechanism.ground.items()]
    for part, joint, places in sizes:
        origin = parts.parts[FRAME].origin if part == FRAME and len(list(places)) > 1 else np.zeros(2)
        for axis, size in enumerate(places):
            if isinstance(size, str):
                yield part, joint, axis, size, abs(1e3 * float(values[size]) - float(origin[axis]))


def _tolerances(parts: PartSet, cycle: Analysis) -> Iterator[tuple[tuple[str, str, int], str]]:
    """Yield the tolerances of lengths and coordinates that the problem states, by part, joint and axis."""
    turned = bool(parts.parts[FRAME].note)  # its dimensions are not the coordinates
    for (part, joint, axis, size, _), one in itertools.product(_dimensions(parts, cycle), cycle.problem.model.deviations):
        coordinate = part == FRAME and not isinstance(cycle.machine.mechanism.ground[joint], Arm)
        if one.size == size and one.shape != CONTACT and not one.values and not (turned and coordinate):
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
            facts = {"general tolerance": GENERAL, "unit": "mm", "scale": scale, "paper": paper, "sheet": count, **head}
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


def _scales(hole: float, extent: float = 0.0) -> tuple[float, ...]:
    """Return scales from the largest one: a view is enlarged only as far as its hole [mm] needs, and an extent [mm] fits."""
    largest = min((factor for factor in SCALES if factor >= 1.0 and factor * hole >= SMALLEST), default=SCALES[0])
    most = float(np.linalg.norm(PAPERS["A3"]))
    return tuple(factor for factor in SCALES if factor <= largest and factor * extent <= most)


def _holds(paper: str, views: Iterable[View]) -> bool:
    """Return whether each of several views fits on a paper."""
    room = np.ptp(_above(paper), axis=0) + SAME
    return all(np.all(np.ptp(view.box, axis=0) <= room) for view in views)


def _fitting(
    draw: Callable[[float], tuple[Item, ...]],
    parts: Collection[FlatPart],
    papers: Sequence[str],
    areas: Callable[[str], Iterable[Array]],
    name: str,
    file: str,
) -> tuple[View, str]:
    """Return a view of parts in the middle of a free area, at the largest scale at which it fits, and its paper."""
    holes = [one.diameter for part in parts for one in part.openings]
    for factor in _scales(min(holes), max(float(np.ptp(part.core, axis=0).max()) for part in parts)):
        view = View(factor, draw(factor))
        low, high = view.box
        for paper in papers:
            for begin, end in areas(paper):
                if np.all(end - begin >= high - low):
                    return View(factor, moved(view.items, 0.5 * (begin + end - low - high))), paper
    raise InputError(
        f"the drawing of {name} does not fit on an {papers[-1]} sheet",
        "Write the parts without dimensions: --content parts",
        file,
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
