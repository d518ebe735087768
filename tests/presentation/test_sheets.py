"""Workshop sheets read back: DXF by ezdxf, PDF by its page objects; texts are measured with a font, not estimated."""

from __future__ import annotations

import itertools
import math
import re
from dataclasses import dataclass
from pathlib import Path

import ezdxf
import numpy as np
import pytest
from matplotlib.font_manager import FontProperties
from matplotlib.textpath import TextPath

import optlink
from optlink.errors import InputError
from optlink.presentation.export.export import export
from optlink.presentation.parts import assembly, sheet
from optlink.presentation.parts.layers import stacked
from optlink.presentation.parts.model import part_set
from optlink.presentation.report_model import ReportModel, report_model_of
from optlink.problem.file import fixed_design
from tests.presentation.test_parts import holes_of, of, written
from tests.tiers import mostly_slow

MACHINES = ("crank-rocker", "shaper", "slider-crank", "watt-i", "toggle-press", "slotted-quick-return", "two-wipers", "six-bar")
UNSTACKED = ("function-sin", "whitworth", "path-closed18", "stephenson-iii")
SIZES = {"A4": (297.0, 210.0), "A3": (420.0, 297.0)}
STATED = re.compile(r"(\d+)  (\S+)   (\d+:\d+)")


@dataclass
class Text:
    text: str
    box: np.ndarray


@dataclass
class Page:
    """What one sheet of a DXF file contains; the border is the first rectangle of the size of a paper less its margins.

    `leaders` are those of labels and balloons, `ruled` the lines of dimensions by the box of their text.
    """

    border: np.ndarray
    texts: list[Text]
    dimensions: list[tuple[str, object]]
    circles: list[np.ndarray]
    centres: np.ndarray
    corners: np.ndarray
    leaders: list[np.ndarray]
    ruled: list[tuple[np.ndarray, np.ndarray]]

    @property
    def words(self) -> list[str]:
        return [one.text for one in self.texts]


def box_of(text) -> Text:
    """The letters of a TEXT entity in the font of the figures, whose capitals are as high as the entity says."""
    align, at, _ = text.get_placement()
    font = FontProperties(family="DejaVu Sans")
    box = TextPath((0.0, 0.0), text.dxf.text, size=text.dxf.height / 0.729, prop=font).get_extents()
    low = {"MIDDLE_LEFT": 0.0, "MIDDLE_CENTER": -0.5, "MIDDLE_RIGHT": -1.0}[align.name] * box.x1
    corners = np.array([[low, -0.5 * text.dxf.height], [low + box.x1, 0.5 * text.dxf.height]])
    if text.dxf.rotation:
        assert text.dxf.rotation == 90.0
        corners = np.array([-corners[::-1, 1], corners[:, 0]]).T
    return Text(text.dxf.text, np.array([at.x, at.y]) + corners)


def pages(path: Path) -> list[Page]:
    drawing = ezdxf.readfile(path)
    assert drawing.audit().errors == []
    space = drawing.modelspace()
    texts = [box_of(one) for one in space.query("TEXT")]
    dimensions, ruled = [], []
    for one in space.query("DIMENSION"):
        (printed,) = one.get_geometry_block().query("TEXT")
        texts.append(box_of(printed))
        dimensions.append((printed.dxf.text, one))
        boxes = texts[-1].box
        ruled += [
            (boxes, np.array(line.get_points("xy"))) for line in one.get_geometry_block().query("LWPOLYLINE") if not line.closed
        ]
    leaders = [np.array(one.get_points("xy")) for one in space.query('LWPOLYLINE[layer=="thin"]') if not one.closed]
    lines = {one: np.array([point[:2] for point in one.get_points("xy")]) for one in space.query("LWPOLYLINE")}
    for _, one in dimensions:
        lines |= {line: np.array(line.get_points("xy")) for line in one.get_geometry_block().query("LWPOLYLINE")}
    circles = [(np.array(one.dxf.center)[:2], one.dxf.radius, one.dxf.layer) for one in space.query("CIRCLE")]
    found = []
    for line in lines.values():
        low, high = line.min(axis=0), line.max(axis=0)
        if not any(np.allclose(high - low, np.array(size) - [30.0, 20.0], rtol=0, atol=1e-9) for size in SIZES.values()):
            continue

        def within(at, low=low, high=high) -> bool:
            return bool(np.all((np.asarray(at) > low - 25.0) & (np.asarray(at) < high + 15.0)))

        centres = [one.mean(axis=0) for key, one in lines.items() if key.dxf.layer == "centre"]
        corners = [point for one in lines.values() for point in one]
        corners += [at + way * radius for at, radius, _ in circles for way in (-1.0, 1.0)]
        found.append(
            Page(
                np.array([low, high]),
                [one for one in texts if within(one.box.mean(axis=0))],
                [one for one in dimensions if within(np.array(one[1].dxf.text_midpoint)[:2])],
                [at for at, _, layer in circles if layer == "outline" and within(at)],
                np.array([at for at in centres if within(at)]).reshape(-1, 2),
                np.array([at for at in corners if within(at)]),
                [line for line in leaders if within(line[0])],
                [(text, line) for text, line in ruled if within(line[0])],
            )
        )
    return sorted(found, key=lambda page: page.border[0, 0])


def clash(one: np.ndarray, other: np.ndarray) -> bool:
    return bool(np.all((one[0] < other[1]) & (other[0] < one[1])))


@pytest.fixture(scope="module")
def sheet_of(tmp_path_factory):
    """The file of a machine and its sheets, each written and read once."""
    known = {}

    def read(name: str):
        if name not in known:
            path = written(of(name), tmp_path_factory.mktemp("sheets") / f"{name}.dxf", content="sheet")
            known[name] = of(name), pages(path), path
        return known[name]

    return read


CASES = mostly_slow((*MACHINES, *UNSTACKED), "crank-rocker", "shaper", "function-sin")


@pytest.mark.parametrize("name", CASES)
def test_printed_dimensions_are_the_distances(name, sheet_of):
    """Text of the block = what ezdxf prints when it measures again = distance of the ends; the ends are centres, to 1e-6 mm."""
    _, sheets, path = sheet_of(name)
    drawing = ezdxf.readfile(path)
    again = {one.dxf.handle: one for one in drawing.modelspace().query("DIMENSION")}
    compared = 0
    for page in sheets:
        for printed, one in page.dimensions:
            axis = int(one.dxf.angle == 90.0)
            ends = np.array([one.dxf.defpoint2, one.dxf.defpoint3])[:, axis]
            factor = drawing.dimstyles.get(one.dxf.dimstyle).dxf.dimlfac
            assert f"{abs(ends[1] - ends[0]) * factor:.2f}".rstrip("0").rstrip(".") == printed
            override = again[one.dxf.handle].override()
            override.render()
            (measured,) = again[one.dxf.handle].get_geometry_block().query("MTEXT")
            assert measured.plain_text() == printed
            compared += all(np.abs(page.centres[:, axis] - end).min() < 1e-6 for end in ends)
    assert compared >= len(part_set(of(name).cycle).parts)


@pytest.mark.parametrize("name", CASES)
def test_hole_distances_are_those_of_the_motion_at_the_stated_scale(name, sheet_of):
    """Circles of the view above the caption of a part, divided by the scale that it states; and the dimensions of all holes."""
    about, sheets, _ = sheet_of(name)
    wanted, compared = holes_of(about), 0
    for page in sheets[1:]:
        captions = [(match, one.box) for one in page.texts if (match := STATED.fullmatch(one.text))]
        for match, box in captions:
            enlarged, reduced = map(int, match[3].split(":"))
            above = [b[1, 1] for _, b in captions if b[0, 0] <= box[0, 0] + 1.0 and b[1, 1] > box[1, 1] + 1.0]
            top = min([*above, page.border[1, 1]])
            beside = [b[0, 0] for _, b in captions if b[0, 0] > box[0, 0] + 1.0 and box[1, 1] - 1.0 < b[1, 1] < top]
            low = np.array([box[0, 0], box[1, 1]])
            high = np.array([min([*beside, page.border[1, 0]]), top])
            holes = np.array([at for at in page.circles if np.all((at > low) & (at < high))]).reshape(-1, 2)
            if match[2] not in wanted or len(holes) < 2:
                continue
            found = sorted(math.dist(p, q) * reduced / enlarged for p, q in itertools.combinations(holes, 2))
            np.testing.assert_allclose(found, wanted[match[2]], rtol=0, atol=1e-6)
            printed = {text.partition(" ")[0] for text, _ in page.dimensions}
            away = np.abs(holes[:, None] - holes) * reduced / enlarged
            texts = [{f"{each:.2f}".rstrip("0").rstrip(".") for each in row.flat if each > 1e-6} for row in away]
            assert any(row <= printed for row in texts), match[2]  # from one of the holes, along and across the part
            compared += len(found)
    assert compared


@pytest.mark.parametrize("name", CASES)
def test_nothing_overlaps_or_leaves_the_border(name, sheet_of):
    for page in sheet_of(name)[1]:
        boxes = [one.box for one in page.texts]
        assert [(a.text, b.text) for a, b in itertools.combinations(page.texts, 2) if clash(a.box, b.box)] == []
        corners = np.concatenate([page.corners, *boxes])
        assert np.all(corners >= page.border[0] - 1e-9)
        assert np.all(corners <= page.border[1] + 1e-9)


def crosses(line: np.ndarray, box: np.ndarray) -> bool:
    """Whether a line enters a box, by the share of each of its pieces that lies between both pairs of sides."""
    for begin, end in itertools.pairwise(line):
        shares = [0.0, 1.0]
        for a, b, low, high in zip(begin, end, *(box + np.array([[0.05], [-0.05]])), strict=True):
            if a == b:
                shares = shares if low < a < high else [1.0, 0.0]
            else:
                first, last = sorted(((low - a) / (b - a), (high - a) / (b - a)))
                shares = [max(shares[0], first), min(shares[1], last)]
        if shares[0] < shares[1]:
            return True
    return False


def cut(one: np.ndarray, other: np.ndarray) -> bool:
    """Whether two lines have a point in common, by solving for the shares of their pieces."""
    for (a, b), (c, d) in itertools.product(itertools.pairwise(one), itertools.pairwise(other)):
        matrix = np.column_stack([b - a, c - d])
        if abs(np.linalg.det(matrix)) > 1e-9:
            share = np.linalg.solve(matrix, c - a)
            if np.all((share > 1e-6) & (share < 1.0 - 1e-6)):
                return True
    return False


def crossings(page: Page) -> list[object]:
    """Leaders and texts that cross one another, and lines of dimensions that cross leaders or the text of another one."""
    found: list[object] = [("leaders", *pair) for pair in itertools.combinations(page.leaders, 2) if cut(*pair)]
    found += [("leader", one.text) for one in page.texts for line in page.leaders if crosses(line, one.box)]
    found += [("dimension", line) for _, line in page.ruled for leader in page.leaders if cut(line, leader)]
    return found + [
        ("dimension", a.text) for a in page.texts for box, line in page.ruled if box is not a.box and crosses(line, a.box)
    ]


CROSSED = ("toggle-press", "whitworth", "path-watt-leg", "law-six-bar", "press-toggle", "straight-line", "stephenson-iii")
CROSSED += ("balance-six-bar", "path-arc5", "shaper")


@pytest.mark.parametrize("name", mostly_slow(CROSSED, "shaper", "toggle-press"))
def test_no_leader_and_no_dimension_crosses_a_text_or_a_leader(name, sheet_of):
    assert [crossings(page) for page in sheet_of(name)[1]] == [[] for _ in sheet_of(name)[1]]


@pytest.mark.parametrize("name", CASES)
def test_every_part_and_pin_is_listed_and_drawn(name, sheet_of):
    """Quantities of the list; a balloon for every row; a caption of every part, once; sheets are counted."""
    about, sheets, _ = sheet_of(name)
    parts = part_set(about.cycle)
    first = sheets[0]
    rows: dict[float, list[Text]] = {}
    for one in first.texts:
        if one.box[0, 0] > first.border[1, 0] - 181.0:
            rows.setdefault((one.box[0, 1] - 42.0) // sheet.ROW, []).append(one)
    listed = [[one.text for one in sorted(row, key=lambda one: one.box[0, 0])] for row in rows.values()]
    listed = [row for row in listed if len(row) >= 4 and [text.isdigit() for text in row[:3]] == [True, True, False]]
    assert sorted(int(row[0]) for row in listed) == list(range(1, len(listed) + 1))
    tubes = [row for row in listed if row[2].startswith("spacer ")]
    listed = [row for row in listed if row not in tubes]
    assert {row[2] for row in listed if not row[2].startswith("pin ")} == parts.parts.keys()
    if name in UNSTACKED[:3]:
        assert (tubes, "Layer" in first.words) == ([], False)
        assert any("cannot be stacked" in word for word in first.words)
    else:
        stack = stacked(parts)
        assert {row[2]: row[4] for row in listed if row[2] in parts.parts} == {body: str(k) for body, k in stack.layers.items()}
        assert sum(int(row[1]) for row in tubes) == sum(len(pin.parts) - 1 for pin in parts.pins)
        assert all(re.fullmatch(r"Ø[\d.]+ / Ø[\d.]+ × [\d.]+", row[3]) for row in tubes)
    pins = {name: int(row[1]) for row in listed if row[2].startswith("pin ") for name in row[2][4:].split(", ")}
    assert pins.keys() == {pin.name for pin in parts.pins}
    assert sum(int(row[1]) for row in listed if row[2].startswith("pin ")) == len(parts.pins)
    lengths = [" × " in row[3].partition(",")[0] for row in listed if row[2].startswith("pin ")]
    assert all(lengths) == any(lengths) == (name not in UNSTACKED[:3])
    assert {pin.name for pin in parts.pins} - {*first.words} == set()  # letters at the pins: all are seen
    assert any(word.startswith("Strength is not considered.") for word in first.words)
    counted = [word for word in first.words if word.isdigit()]
    assert all(counted.count(row[0]) >= 2 for row in listed)
    captions = [match[2] for page in sheets[1:] for word in page.words if (match := STATED.fullmatch(word))]
    assert sorted(captions) == sorted(parts.parts)
    for k, page in enumerate(sheets, 1):
        assert f"{k} / {len(sheets)}" in page.words
        assert {"ISO 2768-m", "mm"} < {*page.words}


@pytest.mark.parametrize("name", mostly_slow(MACHINES, "crank-rocker"))
def test_pdf_pages_are_the_sheets_at_true_size(name, sheet_of, tmp_path):
    about, sheets, _ = sheet_of(name)
    data = written(about, tmp_path / "a.pdf", content="sheet").read_bytes()
    media = [tuple(map(float, found)) for found in re.findall(rb"/MediaBox \[ 0 0 ([\d.]+) ([\d.]+) \]", data)]
    sizes = [tuple(np.diff(page.border, axis=0)[0] + [30.0, 20.0]) for page in sheets]
    assert len(media) == len(re.findall(rb"/Type /Page\b", data)) == len(sheets)
    np.testing.assert_allclose(media, np.array(sizes) * 72.0 / 25.4, atol=1e-4)
    assert {tuple(np.round(size, 6)) for size in sizes} <= {*SIZES.values()}
    assert data == written(about, tmp_path / "b.pdf", content="sheet").read_bytes()


@pytest.mark.slow
def test_a_machine_of_forty_metres_is_drawn_at_scales_at_which_it_fits(tmp_path):
    """Scales at which it cannot fit are not tried: at true size its drawing took tens of gigabytes."""
    lengths = {"crank": "9.5 m", "coupler": "31 m", "rocker": "22.25 m", "frame": "37 m"}
    about = report_model_of(optlink.analyze(optlink.read({"mechanism": {"type": "four-bar", **lengths}})))
    words = [word for page in pages(written(about, tmp_path / "a.dxf", content="sheet")) for word in page.words]
    scales = {match[2]: match[3] for word in words if (match := STATED.fullmatch(word))}
    assert scales == {"frame": "1:200", "coupler": "1:100", "rocker": "1:100", "crank": "1:50"}


def test_what_the_file_states_is_printed(tmp_path):
    """Facts of the title block, fits, materials and tolerances of the lengths; nothing of them where nothing is stated."""
    facts = {"company": "Example Works", "author": "A. Designer", "part": "W-17", "revision": "B", "date": "2026-01-02"}
    changes = {
        "report": {"title": "轴 and 连杆", **facts},
        "parts": {"fit": "H7", "material": "S235JR", "links": {"crank": {"material": "C45"}}, "joints": {"C": {"fit": "H8"}}},
        "tolerances": {"coupler": "0.1 mm"},
    }
    sheets = pages(written(of("crank-rocker", changes), tmp_path / "a.dxf", content="sheet"))
    for page in sheets:
        assert {*facts.values(), "轴 and 连杆"} <= {*page.words}
    words = {word for page in sheets for word in page.words}
    assert {"400 ±0.1", "400", "2× Ø20 H7", "Ø20 H8", "t = 10   S235JR", "t = 10   C45", "Material", "C45"} <= words
    assert not any(word.endswith("…") for word in words)  # sizes of pins and heads have room beside materials
    bare = {word for page in pages(written(of("crank-rocker"), tmp_path / "b.dxf", content="sheet")) for word in page.words}
    assert {"2× Ø20", "t = 10"} <= bare
    assert not {"Material", "H7"} & bare


def rounded(name: str) -> ReportModel:
    """The machine of a shipped problem whose lengths are multiples of 0.1 mm."""
    file = optlink.load(name)
    sizes = {
        key: round(one.value, 4) if one.kind == "length" else one.value for key, one in file.model.mechanism.quantities.items()
    }
    cycle = optlink.analyze(fixed_design(next(iter(file.variants())), sizes))
    return ReportModel(cycle.problem, cycle, cycle)


def lengths_of(about: ReportModel) -> list[str]:
    """The lengths and coordinates of a design; not where the slide of a guide begins and what no link is joined to."""
    machine = about.cycle.machine
    counted = {size for guide in machine.mechanism.guides if not isinstance(guide.through, str) for size in guide.through}
    counted |= {f"{name}.{axis}" for name in machine.mechanism.ground if name not in machine.mechanism.pins for axis in "xy"}
    kinds = {name: one.kind for name, one in about.problem.model.mechanism.quantities.items()}
    sizes = [value for name, value in machine.sizes.items() if kinds[name] in ("length", "coordinate") and name not in counted]
    return [f"{1e3 * value:z.2f}".rstrip("0").rstrip(".") for value in sizes if abs(value) > 1e-9]


ROUNDED = sorted({*MACHINES, *UNSTACKED, "path-watt-leg", "path-within-torque", "path-slider-egg", "press-toggle"})


@pytest.mark.parametrize("name", mostly_slow(ROUNDED, "watt-i", "path-within-torque", "path-slider-egg"))
def test_rounded_sizes_are_printed(name, tmp_path):
    """Every length of the design is a dimension, or a coordinate of a pivot in the words below the frame."""
    about = rounded(name)
    check_printed(about, tmp_path)


def check_printed(about: ReportModel, folder: Path) -> None:
    sheets = pages(written(about, folder / "a.dxf", content="sheet"))
    printed = {text.partition(" ")[0] for page in sheets for text, _ in page.dimensions}
    words = " ".join(word for page in sheets for word in page.words if word.startswith("x, y in the problem"))
    printed |= {*re.findall(r"-?[\d.]*\d", words)}
    wanted = lengths_of(about)
    assert len(wanted) > 1
    assert [text for text in wanted if text not in printed and text.lstrip("-") not in printed] == []


@pytest.mark.slow
@pytest.mark.parametrize("name", ["path-arc5", "path-slider-egg"])
def test_sizes_of_a_rounded_optimum_are_printed(name, tmp_path):
    about = report_model_of(optlink.solve(optlink.load(name, {"rounding.step": "0.1 mm"})))
    assert about.valid
    assert all(len(text.partition(".")[2]) < 2 for text in lengths_of(about))
    check_printed(about, tmp_path)


def test_a_design_that_is_not_valid_says_so(tmp_path, monkeypatch):
    about = of("crank-rocker")
    monkeypatch.setattr(type(about), "valid", property(lambda self: False))
    assert any("NOT VALID" in word for word in pages(written(about, tmp_path / "a.dxf", content="sheet"))[0].words)


def test_small_parts_are_enlarged(tmp_path):
    """A hole of 1 mm is drawn 5 mm wide; the printed distance stays that of the part."""
    small = {f"mechanism.{name}": "20 mm" for name in ("frame", "coupler", "rocker")} | {"mechanism.crank": "5 mm"}
    sheets = pages(written(of("crank-rocker", small | {"parts.hole": "1 mm"}), tmp_path / "a.dxf", content="sheet"))
    assert {match[3] for page in sheets[1:] for word in page.words if (match := STATED.fullmatch(word))} == {"5:1"}
    assert {"20", "5"} <= {text for page in sheets for text, _ in page.dimensions}


def test_long_texts_stay_in_their_cells(tmp_path):
    report = {"company": "W" * 200, "title": "long words " * 18}
    for page in pages(written(of("crank-rocker", {"report": report}), tmp_path / "a.dxf", content="sheet")):
        assert any(word.endswith("…") for word in page.words)
        assert not any(clash(a.box, b.box) for a, b in itertools.combinations(page.texts, 2) if "W" not in a.text + b.text)


def test_a_drawing_without_room_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(sheet, "SCALES", (1.0,))
    with pytest.raises(InputError, match="the drawing of the assembly does not fit on an A3 sheet"):
        export(of("crank-rocker"), tmp_path / "a.pdf")
    assert not [*tmp_path.iterdir()]


def test_a_place_where_a_linkage_does_not_close_is_not_drawn(tmp_path):
    """Links of equal lengths fold at the start of the motion, where their positions are open."""
    about = of("path-closed18")
    for content in ("sheet", "drawing"):
        assert "nan" not in written(about, tmp_path / "a.dxf", content=content).read_text().lower()
        with pytest.raises(InputError, match=r"at crank angle 0 deg the RRR group coupler-rocker .* fails to close"):
            written(about, tmp_path / "b.dxf", content=content, at=0.0)


def test_an_assembly_is_drawn_where_its_parts_are_seen(tmp_path, monkeypatch):
    """At the start of the motion, rod and crank of a slider-crank cover the frame and each other; a stated angle is taken."""
    about = of("slider-crank")
    words = pages(written(about, tmp_path / "a.dxf", content="sheet"))[0].words
    assert not {"assembly, crank angle 0 deg", "assembly, crank angle 180 deg"} & {*words}
    stated = pages(written(about, tmp_path / "b.dxf", content="sheet", at=0.0))[0].words
    assert "assembly, crank angle 0 deg" in stated
    assert "A" in words
    monkeypatch.setattr(assembly, "_target", lambda one, things, grid=9: (1.0, one.core.mean(axis=0)))  # all are seen alike
    assert "assembly, crank angle 0 deg" in pages(written(about, tmp_path / "c.dxf", content="sheet"))[0].words


def test_a_traced_point_is_named_in_the_assembly_and_small_paper_is_used(tmp_path):
    """The foot of a leg; on A4 the assembly, at no smaller scale than its own, and the parts list are sheets of their own."""
    a3 = pages(written(of("path-crank-rocker"), tmp_path / "a.dxf", content="sheet"))
    a4 = pages(written(of("path-crank-rocker", {"parts.paper": "A4"}), tmp_path / "b.dxf", content="sheet"))
    point = next(one for one in a3[0].texts if one.text == "P")
    assert np.min(np.linalg.norm(a3[0].centres - point.box.mean(axis=0), axis=1)) < 12.0
    assert {tuple(np.round(page.border[1] - page.border[0])) for page in a4} == {(267.0, 190.0)}
    assert "notes" in a3[0].words
    assert ("notes" in a4[0].words, "notes" in a4[1].words) == (False, True)


def test_a_frame_that_is_turned_on_its_sheet_says_so(tmp_path):
    """The frame of a Stephenson III linkage is higher than wide in the assembly, that of a crank-rocker is level."""
    words = {word for page in pages(written(of("stephenson-iii"), tmp_path / "a.dxf", content="sheet")) for word in page.words}
    assert "turned by 90° clockwise from the assembly" in words
    level = {word for page in pages(written(of("crank-rocker"), tmp_path / "b.dxf", content="sheet")) for word in page.words}
    assert not any(word.startswith("turned") for word in level)
