"""Parts read back from their files by readers of the tests: DXF by ezdxf, SVG, STL and 3MF by the standard library."""

from __future__ import annotations

import itertools
import math
import re
import zipfile
from collections import Counter
from importlib.util import find_spec
from pathlib import Path
from xml.etree import ElementTree

import ezdxf
import numpy as np
import pytest
from matplotlib.path import Path as Polygon

import optlink
from optlink.errors import InputError
from optlink.presentation.export.dxf import rounded as rounded_outline
from optlink.presentation.export.export import FORMATS, Options, export
from optlink.presentation.export.printing import KERNELS
from optlink.presentation.parts import solids
from optlink.presentation.parts.layers import stacked
from optlink.presentation.parts.layout import _turned, engraved, laid_out
from optlink.presentation.parts.model import FlatPart, part_set
from optlink.presentation.parts.solids import Solid, plate
from optlink.presentation.report_model import ReportModel, report_model_of
from tests.cli.test_cli import run
from tests.presentation.test_export import machine_as_stated
from tests.tiers import mostly_slow

SVG = "{http://www.w3.org/2000/svg}"
CORE = "{http://schemas.microsoft.com/3dmanufacturing/core/2015/02}"
REFUSED = {"path-scott-russell": "overlap", "scotch-yoke": "overlap"}
SHIPPED = [name for name in sorted(optlink.shipped()) if name not in REFUSED]


def of(name: str, changes: dict[str, object] | None = None) -> ReportModel:
    """The machine of a shipped problem as its file states it."""
    if changes is None:
        return machine_as_stated(name)
    return report_model_of(optlink.analyze(optlink.load(name, changes)))


def written(about: ReportModel, path: Path, **options) -> Path:
    export(about, path, Options(**options))
    return path


def distances(points: np.ndarray) -> list[float]:
    return sorted(float(np.linalg.norm(p - q)) for p, q in itertools.combinations(points, 2))


def holes_of(about: ReportModel) -> dict[str, list[float]]:
    """Distances of the pins of every body [mm] at some crank angle, from the motion alone; bodies with slots are left out."""
    mechanism, cycle = about.cycle.machine.mechanism, about.cycle
    motion = optlink.linkage.sweep(mechanism, cycle.machine.sizes, [float(cycle.positions[len(cycle.positions) // 3])])
    slid = {body for guide in mechanism.guides for body in guide.bodies}
    found = {}
    for body in {"frame", *mechanism.bodies} - slid:
        points = [1e3 * motion.position(pin)[0] for pin, owners in mechanism.pins.items() if body in owners]
        found[body] = distances(np.array(points))
    return found


# --- readers ---------------------------------------------------------------------------------------------------------------


def read_stl(path: Path) -> np.ndarray:
    """Corners (triangles, 3, 3)."""
    data = path.read_bytes()
    count = int.from_bytes(data[80:84], "little")
    assert len(data) == 84 + 50 * count
    rows = np.frombuffer(data[84:], np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("more", "<u2")]))
    return rows["corners"]


def read_3mf(path: Path) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Places and triangles of every object by its name."""
    with zipfile.ZipFile(path) as archive:
        assert archive.testzip() is None
        assert {"[Content_Types].xml", "_rels/.rels"} < {*archive.namelist()}
        start = ElementTree.fromstring(archive.read("_rels/.rels"))[0].attrib["Target"]
        model = ElementTree.fromstring(archive.read(start.lstrip("/")))
    assert model.attrib["unit"] == "millimeter"
    found = {}
    for one in model.iter(f"{CORE}object"):
        places = [[float(at.attrib[axis]) for axis in "xyz"] for at in one.iter(f"{CORE}vertex")]
        faces = [[int(at.attrib[key]) for key in ("v1", "v2", "v3")] for at in one.iter(f"{CORE}triangle")]
        found[one.attrib["name"]] = np.array(places), np.array(faces)
    assert [item.attrib["objectid"] for item in model.iter(f"{CORE}item")] == [str(k + 1) for k in range(len(found))]
    return found


def volume(corners: np.ndarray) -> float:
    corners = corners.astype(float)
    return float(np.sum(corners[:, 0] * np.cross(corners[:, 1], corners[:, 2])) / 6.0)


def open_edges(faces: np.ndarray) -> int:
    """Number of directed edges whose opposite does not occur exactly once, or that occur twice."""
    edges = Counter((face[k], face[(k + 1) % 3]) for face in faces.tolist() for k in range(3))
    return sum(count != 1 or edges[end, begin] != 1 for (begin, end), count in [*edges.items()])


def numbered(corners: np.ndarray) -> np.ndarray:
    """Triangles by numbers of their corners, equal ones of which have one number."""
    _, numbers = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
    return numbers.reshape(-1, 3)


def circles(places: np.ndarray, faces: np.ndarray, radius: float) -> list[np.ndarray]:
    """Centres of the round holes: rings of walls whose corners are equally far from their mean."""
    neighbours: dict[int, set[int]] = {}
    low = places[:, 2] == places[:, 2].min()
    for face in faces:
        a = [k for k in face if low[k]]
        if len(a) == 2:  # a wall
            neighbours.setdefault(a[0], set()).add(a[1])
            neighbours.setdefault(a[1], set()).add(a[0])
    centres, left = [], set(neighbours)
    while left:
        ring, todo = set(), [left.pop()]
        while todo:
            k = todo.pop()
            ring.add(k)
            todo += neighbours[k] - ring
        left -= ring
        points = places[[*ring], :2]
        middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
        away = np.linalg.norm(points - middle, axis=1)
        if np.ptp(away) < 0.2 * radius:
            assert np.median(away) >= radius  # the corners lie round the hole
            chords = np.array([0.5 * (places[k, :2] + places[other, :2]) for k in ring for other in neighbours[k]])
            assert np.linalg.norm(chords - middle, axis=1).min() >= radius * (1.0 - 1e-9)
            centres.append(middle)
    return centres


# --- solids ----------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", mostly_slow(SHIPPED, "crank-rocker", "press-toggle", "slotted-quick-return"))
def test_parts_are_closed_solids_of_their_volume(name, tmp_path):
    """Every edge twice; the volume is the area of outline less holes, arcs included, times the thickness."""
    about = of(name)
    read = read_3mf(written(about, tmp_path / "a.3mf"))
    whole = read_stl(written(about, tmp_path / "a.stl"))
    parts = part_set(about.cycle).parts
    assert read.keys() == parts.keys()
    assert open_edges(numbered(whole)) == 0
    total = 0.0
    for body, (places, faces) in read.items():
        assert open_edges(faces) == 0
        exact = parts[body].thickness * (area(parts[body].outline) - sum(area(one.outline) for one in parts[body].openings))
        assert volume(places[faces]) == pytest.approx(exact, rel=1e-4)
        total += exact
    assert volume(whole) == pytest.approx(total, rel=1e-4)


def area(outline) -> float:
    """Area within straight edges and arcs."""
    total = 0.0
    for (x, y, bulge), (u, v, _) in zip(outline, (*outline[1:], outline[0]), strict=True):
        turned, chord = 4.0 * math.atan(bulge), math.hypot(u - x, v - y)
        total += 0.5 * (x * v - u * y)
        if bulge:
            radius = 0.5 * chord / math.sin(0.5 * turned)
            total += 0.5 * radius**2 * (turned - math.sin(turned))
    return total


def area_of(part: FlatPart) -> float:
    """Area of a part from its holes by closed forms: hull, strip and corners, of which those of straight ends are kites."""
    corners, r = part.core[_hull_order(part.core)], 0.5 * part.width
    edges = np.roll(corners, -1, axis=0) - corners
    total = 0.5 * float(np.sum(corners[:, 0] * np.roll(corners[:, 1], -1) - corners[:, 1] * np.roll(corners[:, 0], -1)))
    total += r * float(np.linalg.norm(edges, axis=1).sum())
    ways = np.arctan2(edges[:, 1], edges[:, 0])
    for turned in (ways - np.roll(ways, 1)) % (2.0 * np.pi):
        count = 1 if turned <= 0.5 * np.pi + 1e-9 else 2
        each = turned / count
        leg = r * math.tan(0.5 * each)
        cut = 0.125 * leg**2 * math.sin(each) if part.end == "chamfered" and each > 0.25 * np.pi + 1e-9 else 0.0
        total += 0.5 * turned * r**2 if part.end == "round" else count * (r * leg - cut)
    holes = (
        np.pi * (0.5 * one.diameter) ** 2 + one.diameter * np.linalg.norm(one.ends[1] - one.ends[0]) for one in part.openings
    )
    return total - float(sum(holes))


def _hull_order(points: np.ndarray) -> list[int]:
    """Corners of the hull, counter-clockwise, by wrapping it: from the lowest point always to the rightmost one in sight."""
    points = np.round(points, 9)
    start = min(range(len(points)), key=lambda k: (points[k, 1], points[k, 0]))
    order, way = [start], 0.0
    while True:
        away = points - points[order[-1]]
        far = np.linalg.norm(away, axis=1)
        turns = np.where(far > 1e-6, (np.arctan2(away[:, 1], away[:, 0]) - way + 1e-9) % (2.0 * np.pi), np.inf)
        near = np.flatnonzero(turns < turns.min() + 2e-9)
        following = int(near[np.argmax(far[near])])
        way = math.atan2(away[following, 1], away[following, 0])
        if np.allclose(points[following], points[start]):
            return order
        order.append(following)


ENDED = [("crank-rocker", "square"), ("path-watt-leg", "chamfered"), ("shaper", "square"), ("shaper", "chamfered")]
ENDED += [("path-watt-leg", "round"), ("straight-line", "chamfered")]


@pytest.mark.parametrize(("name", "end"), mostly_slow(ENDED, ENDED[0], ENDED[1]))
def test_parts_with_straight_ends_have_the_volumes_of_closed_forms(name, end, tmp_path):
    """Meshes to 1e-4; the outlines of the files for cutting, which share their vertices, to 1e-9."""
    about = of(name, {"parts.end": end})
    parts = part_set(about.cycle).parts
    read = read_3mf(written(about, tmp_path / "a.3mf"))
    whole = read_stl(written(about, tmp_path / "a.stl"))
    assert open_edges(numbered(whole)) == 0
    drawing = ezdxf.readfile(written(about, tmp_path / "a.dxf", content="parts"))
    cut = [area(one.get_points("xyb")) for one in drawing.modelspace().query("LWPOLYLINE")]
    svg = written(about, tmp_path / "a.svg", content="parts").read_text()
    outlines = dict(re.findall(r'<g id="([^"]+)">\n<path d="([^"]+)"', svg))
    assert outlines.keys() == parts.keys()
    assert volume(whole) == pytest.approx(sum(area_of(part) * part.thickness for part in parts.values()), rel=1e-4)
    for body, part in parts.items():
        places, faces = read[body]
        assert open_edges(faces) == 0
        assert volume(places[faces]) == pytest.approx(area_of(part) * part.thickness, rel=1e-4)
        holes = sum(area(one.outline) for one in part.openings)
        assert min(abs(one - holes - area_of(part)) for one in cut) < 1e-9 * area_of(part)
        assert ("A" in outlines[body]) == (end == "round")
        if end != "round":
            corners = [(float(x), -float(y), 0.0) for x, y in re.findall(r"(-?[\d.]+) (-?[\d.]+)", outlines[body])]
            assert area(corners) - holes == pytest.approx(area_of(part), rel=1e-9)
        inner = rounded_outline(part.core, 0.5 * part.width - 1e-6)
        assert Polygon(solids.polygon(part.outline)).contains_points(solids.polygon(inner)).all()  # as wide as a round one


def test_the_end_of_one_link_differs():
    """A bar of 100 mm and width 50 mm with square ends is 150 mm long; its chamfers have legs of a quarter of the width."""
    changes = {"parts": {"end": "square", "links": {"coupler": {"end": "round"}, "rocker": {"end": "chamfered"}}}}
    parts = part_set(of("crank-rocker", changes).cycle).parts
    assert {name: part.end for name, part in parts.items()} == {
        "frame": "square",
        "crank": "square",
        "coupler": "round",
        "rocker": "chamfered",
    }
    assert np.array(parts["crank"].outline) == pytest.approx(np.array([[-25, 25, 0], [-25, -25, 0], [125, -25, 0], [125, 25, 0]]))
    corners = np.array(parts["rocker"].outline)[:, :2]
    assert [tuple(np.round(np.abs(edge), 6)) for edge in np.diff(corners, axis=0)].count((12.5, 12.5)) == 4


@pytest.mark.parametrize("name", mostly_slow(SHIPPED, "crank-rocker", "watt-i", "six-bar"))
def test_distances_of_holes_are_those_of_the_motion(name, tmp_path):
    """In the 3MF and in the file for cutting, to 1e-6 mm; holes are not undersized by their chords."""
    about = of(name)
    read = read_3mf(written(about, tmp_path / "a.3mf"))
    drawing = ezdxf.readfile(written(about, tmp_path / "a.dxf", content="parts"))
    assert drawing.audit().errors == []
    cut = np.array([one.dxf.center for one in drawing.modelspace().query("CIRCLE")])[:, :2]
    outlines = list(drawing.modelspace().query("LWPOLYLINE"))
    assert len(cut) + len(outlines) == sum(1 + len(one.openings) for one in part_set(about.cycle).parts.values())
    compared = 0
    for body, wanted in holes_of(about).items():
        part = part_set(about.cycle).parts[body]
        places, faces = read[body]
        found = distances(np.array(circles(places, faces, 0.5 * part.openings[0].diameter)))
        np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-6)
        placed = next(one for one in laid_out(part_set(about.cycle).parts.values()).parts if one.part.name == body)
        low, high = (corner + placed.shift for corner in placed.part.corners)
        np.testing.assert_allclose(distances(cut[np.all((cut > low) & (cut < high), axis=1)]), wanted, rtol=0, atol=1e-6)
        compared += len(wanted)
    assert compared


def test_a_planted_defect_opens_a_solid():
    """A triangle that is left out, and one that is turned over."""
    part = next(iter(part_set(of("crank-rocker").cycle).parts.values()))
    faces = plate(part).triangles
    assert open_edges(faces) == 0
    assert open_edges(faces[1:]) == 3
    assert open_edges(np.concatenate([faces[:1, ::-1], faces[1:]])) > 0


def test_corners_in_line_that_a_triangulation_leaves_out_are_found(monkeypatch):
    """Such a triangulation is rejected, and another direction is tried."""
    part = part_set(of("crank-rocker").cycle).parts["coupler"]
    plain, tried = solids._triangles_turned, []

    def short(loops, angle):
        tried.append(angle)
        return plain(loops, angle)[1:] if len(tried) == 1 else plain(loops, angle)

    monkeypatch.setattr(solids, "_triangles_turned", short)
    assert open_edges(plate(part).triangles) == 0
    assert tried == [0.0, 0.5]


# --- cutting ---------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", mostly_slow(SHIPPED, "shaper", "path-watt-leg"))
def test_outlines_lie_apart_and_names_within_them(name):
    """Rectangles round the parts do not touch; the rectangle of a name lies within its outline and outside its openings."""
    parts = part_set(of(name).cycle).parts
    sheet = laid_out(parts.values())
    boxes = [[corner + one.shift for corner in one.part.corners] for one in sheet.parts]
    for (low, high), (other_low, other_high) in itertools.combinations(boxes, 2):
        assert np.any((low >= other_high) | (other_low >= high))
    assert np.min([low for low, _ in boxes]) > 0.0
    assert np.all(np.max([high for _, high in boxes], axis=0) < sheet.size)
    assert {one.part.name for one in sheet.parts} == parts.keys()
    for part in parts.values():
        if label := engraved(part):
            assert label.text == part.name
            half = np.array([0.3 * len(label.text), 0.5]) * label.height
            c, s = math.cos(label.angle), math.sin(label.angle)
            corners = [label.at + np.array([[c, -s], [s, c]]) @ (half * sign) for sign in itertools.product((-1, 1), (-1, 1))]
            assert Polygon(solids.polygon(part.outline)).contains_points(corners).all()
            for opening in part.openings:
                assert not Polygon(solids.polygon(opening.outline)).contains_points(corners).any()


def test_a_part_that_lies_askew_is_turned_to_save_room():
    """A bar at 53 deg takes the room of one that lies along the sheet, with the same holes; a part that saves little stays."""
    parts = part_set(of("crank-rocker").cycle).parts
    askew = _turned(parts["frame"], np.array([0.6, 0.8]))
    (one,) = laid_out([askew]).parts
    assert np.ptp(np.array(askew.corners), axis=0) == pytest.approx([350.0, 450.0])
    assert np.ptp(np.array(one.part.corners), axis=0) == pytest.approx([550.0, 50.0])
    ends = [opening.ends[0] for opening in one.part.openings]
    assert ends[1][1] - ends[0][1] == pytest.approx(0.0, abs=1e-9)
    assert abs(ends[1][0] - ends[0][0]) == pytest.approx(500.0)
    assert laid_out([parts["frame"]]).parts[0].part is parts["frame"]


def test_a_part_without_room_for_its_name_is_told(tmp_path):
    """10 mm are left between the holes of the crank."""
    about = of("crank-rocker")
    assert "Without room for an engraved name: crank." in export(
        about, tmp_path / "a.svg", Options(None, 0.09, 0.2, 360, "parts")
    )
    assert not any("engraved" in note for note in export(about, tmp_path / "a.svg", Options(content="parts")))


def test_an_svg_is_at_true_size(tmp_path):
    """Width, height and view box agree in millimetres; a straight link has the arcs of its ends; red is cut, blue engraved."""
    root = ElementTree.parse(written(of("crank-rocker"), tmp_path / "a.svg", content="parts")).getroot()
    left, top, wide, high = map(float, root.attrib["viewBox"].split())
    assert (root.attrib["width"], root.attrib["height"]) == (f"{wide:g}mm", f"{high:g}mm")
    cut, engrave = root.findall(f"{SVG}g")
    assert [(one.attrib["id"], one.attrib["stroke"]) for one in (cut, engrave)] == [("CUT", "#ff0000"), ("ENGRAVE", "#0000ff")]
    assert [one.attrib["id"] for one in cut] == ["frame", "crank", "coupler", "rocker"]
    for group, length in zip(cut, (500.0, 100.0, 400.0, 400.0), strict=True):
        first, second = (float(one.attrib["cx"]) for one in group.iter(f"{SVG}circle"))
        assert second - first == pytest.approx(length, abs=1e-9)
        path = group.find(f"{SVG}path").attrib["d"]
        assert re.findall(r"A([\d.]+) ([\d.]+) 0 (\d) (\d)", path) == [("25", "25", "0", "0")] * 2
        xs = [float(x) for x in re.findall(r"(?:M|L | 0 0 )([\d.]+) -", path)]
        assert min(xs) > left
        assert max(xs) < left + wide
    assert {one.text for one in engrave.iter(f"{SVG}text")} == {"frame", "crank", "coupler", "rocker"}
    assert top == -high


# --- the model -------------------------------------------------------------------------------------------------------------


def test_sizes_of_the_file_are_those_of_the_parts():
    changes = {
        "parts": {
            "width": "30 mm",
            "thickness": "4 mm",
            "hole": "8 mm",
            "pin": "7.8 mm",
            "links": {"rocker": {"width": "36 mm", "thickness": "5 mm"}},
            "joints": {"C": {"hole": "10 mm", "pin": "9.8 mm"}},
        }
    }
    made = part_set(of("crank-rocker", changes).cycle)
    assert [*made.parts] == ["frame", "crank", "coupler", "rocker"]
    assert [part.width for part in made.parts.values()] == pytest.approx([30, 30, 30, 36])
    assert [part.thickness for part in made.parts.values()] == pytest.approx([4, 4, 4, 5])
    holes = {(name, one.joint): one.diameter for name, part in made.parts.items() for one in part.openings}
    assert holes["coupler", "B"] == pytest.approx(8.0)
    assert holes["coupler", "C"] == holes["rocker", "C"] == pytest.approx(10.0)
    assert {pin.name: pin.diameter for pin in made.pins} == pytest.approx({"A": 7.8, "D": 7.8, "B": 7.8, "C": 9.8})
    wide = part_set(of("crank-rocker", changes).cycle, hole=9e-3, width=20e-3)
    assert wide.parts["crank"].width == pytest.approx(20.0)
    assert wide.parts["crank"].openings[0].diameter == pytest.approx(9.0)


@pytest.mark.parametrize(("stated", "beyond", "most"), [({}, 3.0, 3.5), ({"parts.overtravel": "7 mm"}, 7.0, 8.0)])
def test_a_block_becomes_a_pin_in_a_slot_of_its_travel(stated, beyond, most):
    """The slot of a slider-crank is longer than the stroke, twice the crank of 100 mm, at each end; the block is no part."""
    made = part_set(of("slider-crank", stated).cycle)
    assert "slider" not in made.parts
    assert "Pin E stands for slider, which is no part, and runs in a slot of frame." in made.notes
    slot = next(one for one in made.parts["frame"].openings if np.ptp(one.ends, axis=0).max() > 0.0)
    assert np.sort(slot.ends[:, 0]) == pytest.approx([200.0 - beyond, 400.0 + beyond], abs=1e-6)
    assert f"Slots are {beyond:g} to {most:g} mm longer than the travel at each end." in made.notes


def test_the_ends_of_a_slot_are_rounded_outwards():
    """The ram of the shaper travels from -417.14 to 128.32 mm; the slot ends at whole millimetres, at least 5 mm beyond."""
    about = of("shaper")
    slot = next(one for one in part_set(about.cycle).parts["frame"].openings if np.ptp(one.ends, axis=0).max() > 0.0)
    slid = 1e3 * optlink.linkage.sweep(
        about.cycle.machine.mechanism, about.cycle.machine.sizes, np.linspace(0.0, 2.0 * np.pi, 2000)
    ).position("E")
    away = np.sort(slot.ends[:, 0]) - [slid[:, 0].min(), slid[:, 0].max()]
    assert np.all((away * [-1.0, 1.0] >= 5.0 - 1e-3) & (away * [-1.0, 1.0] < 6.0))
    assert np.sort(slot.ends[:, 0]) == pytest.approx([-423.0, 134.0], abs=1e-9)


@pytest.mark.parametrize("name", mostly_slow(SHIPPED, "shaper", "whitworth", "slotted-quick-return", "oscillating-cylinder"))
def test_pins_stay_in_their_openings_over_the_motion(name):
    """Every pin lies between the ends of the hole or slot of each of its parts, at all positions."""
    made = part_set(of(name).cycle)
    motion = made.motion
    for pin in made.pins:
        at = absolute(motion, pin.on, pin.at)
        for body in pin.parts:
            fits = []
            for one in made.parts[body].openings:
                begin, end = (absolute(motion, body, place) for place in one.ends)
                along, away = end - begin, at - begin
                share = np.clip(np.sum(along * away, axis=1) / np.maximum(np.sum(along**2, axis=1), 1e-30), 0.0, 1.0)
                fits.append(np.nanmax(np.linalg.norm(away - share[:, None] * along, axis=1)))
            assert min(fits) < 1e-6, (pin.name, body)


def absolute(motion, body: str, at: np.ndarray) -> np.ndarray:
    """Places (positions, 2) [mm] of a point of a body over the motion."""
    if body == "frame":
        return np.tile(at, (len(motion.crank_angle), 1))
    turned = np.exp(1j * np.broadcast_to(np.asarray(motion.body_angle(body).value), len(motion.crank_angle)))
    moved = turned * complex(*at)
    return 1e3 * motion.position(motion.mechanism.origin(body)) + np.column_stack([moved.real, moved.imag])


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"parts.width": "5 mm"}, 'parts.width = "5 mm": frame is not wider than its hole at A, which measures 20 mm'),
        ({"parts": {"links": {"crank": {"width": "8 mm"}}}}, 'parts.links.crank.width = "8 mm": crank is not wider'),
        ({"parts.pin": "25 mm"}, 'parts.pin = "25 mm": the pin of A is thicker than its holes, which measure 20 mm'),
        (
            {"parts": {"hole": "120 mm", "width": "0.5 m"}},
            "the openings A and B of crank overlap: their centres are 100 mm apart",
        ),
        ({"parts": {"links": {"cranc": {}}}}, 'parts.links.cranc = "cranc": no such link. Did you mean "crank"?'),
        ({"parts": {"joints": {"Z": {}}}}, 'parts.joints.Z = "Z": no such pin joint. Known: A, D, B, C'),
        ({"parts.end": "squared"}, 'parts.end = "squared"'),
        ({"parts": {"links": {"crank": {"end": "flat"}}}}, 'parts.links.crank.end = "flat"'),
        ({"parts.widht": "5 mm"}, 'parts.widht: unknown key. Did you mean "width"?'),
        ({"parts.width": "5"}, 'parts.width = "5": a length needs a unit'),
    ],
)
def test_what_cannot_be_made_is_refused_in_a_sentence(changes, says):
    with pytest.raises(InputError, match=re.escape(says)):
        part_set(of("crank-rocker", changes).cycle)


def test_a_link_that_is_no_part_has_no_shape():
    says = 'parts.links = "slider": slider is no part: a pin stands for it. Leave it out'
    with pytest.raises(InputError, match=re.escape(says)):
        part_set(of("slider-crank", {"parts": {"links": {"slider": {"end": "square"}}}}).cycle)


@pytest.mark.parametrize("name", REFUSED)
def test_slots_across_pivots_are_refused(name):
    with pytest.raises(InputError, match=REFUSED[name]):
        part_set(of(name).cycle)


@pytest.mark.parametrize(("name", "says"), [("lift", "lift is a cylinder"), ("cam-follower", "cam has the profile")])
def test_cylinders_and_cams_are_refused_by_name(name, says):
    problem = optlink.read(optlink.new(name))
    about = report_model_of(optlink.analyze(problem))
    with pytest.raises(InputError, match=says):
        part_set(about.cycle)


def test_the_section_changes_no_result():
    assert optlink.load("crank-rocker", {"parts.width": "30 mm"}).hash == optlink.load("crank-rocker").hash


# --- layers ----------------------------------------------------------------------------------------------------------------


def test_an_assembly_lies_in_its_layers(tmp_path):
    """Heights of the links are multiples of thickness and washer; pins pass through what they join, heads beyond."""
    about = of("crank-rocker")
    stack = stacked(part_set(about.cycle))
    read = read_3mf(written(about, tmp_path / "a.3mf", content="assembly", at=1.0))
    assert read.keys() == {*stack.parts.parts, *(f"{kind} {pin.name}" for pin in stack.parts.pins for kind in ("pin", "spacer"))}
    pitch = max(part.thickness for part in stack.parts.parts.values()) + stack.parts.spacer
    for name, layer in stack.layers.items():
        heights = read[name][0][:, 2]
        assert (heights.min(), heights.max()) == pytest.approx((layer * pitch, layer * pitch + stack.parts.parts[name].thickness))
    mechanism, sizes = about.cycle.machine.mechanism, about.cycle.machine.sizes
    motion = optlink.linkage.sweep(mechanism, sizes, [1.0])
    for pin in stack.parts.pins:
        places, faces = read[f"pin {pin.name}"]
        assert open_edges(faces) == 0
        assert volume(places[faces]) > 0.0
        np.testing.assert_allclose(places[:, :2].mean(axis=0), 1e3 * motion.position(pin.name)[0], atol=1e-6)
        ends = [read[name][0][:, 2] for name in pin.parts]
        lower, upper = sorted((one.min(), one.max()) for one in ends)
        spacer, around = read[f"spacer {pin.name}"]
        assert open_edges(around) == 0
        assert (spacer[:, 2].min(), spacer[:, 2].max()) == pytest.approx((lower[1], upper[0]))  # fills the gap
        assert np.linalg.norm(spacer[:, :2] - places[:, :2].mean(axis=0), axis=1).min() == pytest.approx(
            0.5 * pin.diameter, rel=1e-3
        )
        assert places[:, 2].min() == pytest.approx(min(one.min() for one in ends) - 0.6 * pin.diameter)
        assert places[:, 2].max() == pytest.approx(max(one.max() for one in ends) + 0.6 * pin.diameter)
        assert np.linalg.norm(places[:, :2] - 1e3 * motion.position(pin.name)[0], axis=1).max() == pytest.approx(
            0.8 * pin.diameter
        )


# --- the command -----------------------------------------------------------------------------------------------------------


def test_the_same_design_gives_the_same_file(tmp_path):
    about = of("crank-rocker")
    for ending in (".3mf", ".stl", ".svg"):
        once, again = (written(about, tmp_path / f"{name}{ending}", content="parts").read_bytes() for name in "ab")
        assert once == again


def test_the_command_says_what_the_parts_leave_open(tmp_path):
    """A press loses its ram; a drawing and a table have no such notes."""
    result = run("export", "toggle-press", "-o", str(tmp_path / "a.pdf"))
    assert result.exit_code == 0
    assert "Note: Strength is not considered." in result.stderr
    assert "Note: Pin E stands for ram, which is no part, and runs in a slot of frame." in result.stderr
    assert "Note" not in run("export", "toggle-press", "-o", str(tmp_path / "a.dxf")).stderr
    clear = run("export", "toggle-press", "-o", str(tmp_path / "a.svg"), "--content", "parts", "--set", 'parts.pin="19 mm"')
    assert "Holes have no clearance" in result.stderr
    assert "Holes have no clearance" not in clear.stderr


@pytest.mark.parametrize(
    ("file", "content", "says"),
    [
        ("a.csv", "parts", "a .csv file cannot have this content. Write a .dxf or .svg or .stl or .3mf or .step file"),
        ("a.stl", "pieces", "a .stl file cannot have this content. Known: parts, assembly"),
    ],
)
def test_an_unknown_content_is_refused(file, content, says, tmp_path):
    result = run("export", "crank-rocker", "-o", str(tmp_path / file), "--content", content)
    assert result.exit_code == 2
    assert says in " ".join(result.stderr.split())
    assert not [*tmp_path.iterdir()]


def test_every_content_has_a_writer(tmp_path):
    """All entries of the registry write a file of a machine that has parts and layers."""
    about = of("six-bar")
    missing = set() if find_spec("OCP") else {".step"}
    for ending, contents in FORMATS.items():
        for content in contents if ending not in missing else ():
            assert written(about, tmp_path / f"{content}{ending}", content=content).stat().st_size > 150


def test_solids_on_a_plate_lie_apart():
    """Flat on z = 0, in the order of the sheet."""
    on = [*KERNELS[".stl"]().on_plate(part_set(of("crank-rocker").cycle))]
    assert all(isinstance(one, Solid) and one.places[:, 2].min() == 0.0 for one in on)
    boxes = [(one.places.min(axis=0)[:2], one.places.max(axis=0)[:2]) for one in on]
    assert all(np.any((a >= d) | (c >= b)) for (a, b), (c, d) in itertools.combinations(boxes, 2))
