"""What is drawn of cylinders, gears, racks, belts and cams: each shape moves with its body and touches its neighbour."""

from __future__ import annotations

import math
import re
from pathlib import Path

import ezdxf
import numpy as np
import pytest

import optlink
from optlink.linkage.mechanism import FRAME
from optlink.presentation.export.export import Options, export
from optlink.presentation.export.svg import svg
from optlink.presentation.report_model import ReportModel
from optlink.presentation.scene import Scene, scene
from optlink.presentation.views import analysis_tables
from optlink.presentation.views.analysis_charts import CycleCurves, torque

BOOM = """
gravity = "9.81 m/s^2"
[mechanism.ground]
A = ["0 mm", "0 mm"]
D = ["600 mm", "-400 mm"]
[mechanism.links]
boom = { joints = ["A", "B"], length = "1500 mm" }
[mechanism.cylinders]
lift = { joints = ["D", "B"], closed = "1200 mm", open = "1900 mm", barrel = { mass = "20 kg" }, rod = { mass = "15 kg" } }
[mechanism.assembly]
B = "left of A-D"
[bodies]
boom = { mass = "300 kg", inertia = "60 kg*m^2" }
[drive]
cylinder = "lift"
speed = "100 mm/s"
"""
GEARS = """
[mechanism.ground]
A = ["0 mm", "0 mm"]
E = ["60 mm", "10 mm"]
[mechanism.links]
crank = { joints = ["A", "B"], length = "30 mm" }
wheel = { joints = ["E"] }
[mechanism.gears]
train = { bodies = ["crank", "wheel"], teeth = [20, 40] }
"""
PLANET = """
[mechanism.ground]
A = ["0 mm", "0 mm"]
[mechanism.links]
carrier = { joints = ["A", "B"], length = "26 mm" }
planet = { joints = ["B", "P"], length = "10 mm" }
[mechanism.gears]
ring = { bodies = ["planet", "frame"], teeth = [23, 29], internal = true, arm = "carrier" }
[drive]
body = "carrier"
"""
RACK = """
[mechanism.ground]
A = ["0 mm", "0 mm"]
[mechanism.links]
crank = { joints = ["A", "B"], length = "20 mm" }
rack = { joints = ["R"] }
[mechanism.guides]
rail = { slider = "rack", through = ["0 mm", "-35 mm"], direction = "20 deg" }
[mechanism.racks]
mesh = { rack = "rack", pinion = "crank", radius = "30 mm" }
[drive]
range = ["0 deg", "90 deg"]
"""
BELT = """
[mechanism.ground]
A = ["0 mm", "0 mm"]
D = ["300 mm", "50 mm"]
[mechanism.links]
crank = { joints = ["A", "B"], length = "50 mm" }
wheel = { joints = ["D", "E"], length = "50 mm" }
[mechanism.belts]
b = { bodies = ["crank", "wheel"], radii = ["40 mm", "80 mm"]%s }
"""
CAM = """
[mechanism.ground]
A = ["0 mm", "0 mm"]
F = ["90 mm", "20 mm"]
[mechanism.links]
cam = { joints = ["A"] }
follower = { joints = [%s }
%s
[mechanism.cams]
lift = { cam = "cam", follower = "follower", phase = "25 deg", %s }
[drive]
body = "cam"
"""
RISE = (
    'law = [{ to = "150 deg", rise = "%s", law = "3-4-5" }, { to = "300 deg", fall = "%s", law = "3-4-5" }, { to = "360 deg" }]'
)
RAIL = '[mechanism.guides]\nrail = { slider = "follower", through = ["8 mm", "0 mm"], direction = "70 deg" }'
ARMS = """
[mechanism.ground]
A = ["0 mm", "0 mm"]
E = ["150 mm", "0 mm"]
[mechanism.links]
left = { joints = ["A", "B"], length = "200 mm" }
right = { joints = ["E", "D"], length = "200 mm" }
fore1 = { joints = ["B", "P"], length = "250 mm" }
fore2 = { joints = ["D", "P"], length = "250 mm" }
[mechanism.assembly]
P = "left of D-B"
[drives.left]
body = "left"
law = [{ time = "0.5 s", to = "150 deg" }, { time = "0.5 s", to = "100 deg" }]
[drives.port]
body = "right"
law = { csv = "port.csv" }
"""


def analysed(text: str, folder: Path) -> ReportModel:
    path = folder / "problem.toml"
    path.write_text(f'title = "Drawn"\n{text}', encoding="utf-8")
    problem = optlink.load(path)
    cycle = optlink.analyze(problem, points=72)
    return ReportModel(problem, cycle, cycle)


def curves(drawn: Scene, body: str, kind: str) -> list[np.ndarray]:
    """Places (positions, corners, 2) [mm] of the curves of a body."""
    return [drawn.placed(drawn.shown, body, part.outline) for part in drawn.parts[body] if part.kind == kind]


def apart(point: np.ndarray, line: np.ndarray) -> np.ndarray:
    """Distances of points (positions, 2) from lines through the first two corners of curves (positions, corners, 2)."""
    along = line[:, 1] - line[:, 0]
    offset = point - line[:, 0]
    return np.abs(along[:, 0] * offset[:, 1] - along[:, 1] * offset[:, 0]) / np.linalg.norm(along, axis=1)


def round_about(curve: np.ndarray, centre: np.ndarray) -> float:
    """Radius of a circle about a moving point."""
    radii = np.linalg.norm(curve - centre[:, None], axis=2)
    np.testing.assert_allclose(radii, radii[0, 0], rtol=1e-9)
    return float(radii[0, 0])


def test_a_cylinder_telescopes(tmp_path):
    drawn = scene(analysed(BOOM, tmp_path).cycle)
    (barrel,), (rod,) = curves(drawn, "lift", "profile"), curves(drawn, "lift.rod", "profile")
    d, b = drawn.points["D"], drawn.points["B"]
    length = np.linalg.norm(b - d, axis=1)
    assert np.ptp(length) > 600.0
    along = ((b - d) / length[:, None])[:, None]
    in_barrel, in_rod = (np.sum((curve - d[:, None]) * along, axis=2) for curve in (barrel, rod))
    gland = in_barrel.max(axis=1)
    np.testing.assert_allclose(in_barrel.min(axis=1), 0.0, atol=1e-6)
    np.testing.assert_allclose(in_rod.max(axis=1), length, rtol=1e-9)
    assert np.all((gland > 900.0) & (gland < 1200.0))
    assert np.all(in_rod.min(axis=1) > 0.0)
    assert np.all(in_rod.min(axis=1) < gland - 10.0)
    assert not [part for part in drawn.parts["lift"] if part.kind == "bar"]
    assert drawn.colours["lift"] == drawn.colours["lift.rod"]


@pytest.mark.slow
def test_gears_touch_at_their_pitch_circles(tmp_path):
    drawn = scene(analysed(GEARS, tmp_path).cycle)
    radii = [round_about(curves(drawn, body, "auxiliary")[0], drawn.points[at]) for body, at in (("crank", "A"), ("wheel", "E"))]
    assert radii[1] == pytest.approx(2.0 * radii[0])
    assert sum(radii) == pytest.approx(math.hypot(60.0, 10.0))
    (mark,) = curves(drawn, "wheel", "auxiliary")[1:]
    assert np.max(np.ptp(mark[:, 1], axis=0)) == pytest.approx(2.0 * radii[1], rel=1e-2)  # it turns
    dashes = re.findall(r'stroke-dasharray="([^"]*)"', svg(drawn, "gears"))
    assert {len(one.split()) for one in dashes} == {4}


@pytest.mark.slow
def test_a_planet_rolls_in_its_ring(tmp_path):
    drawn = scene(analysed(PLANET, tmp_path).cycle)
    planet = round_about(curves(drawn, "planet", "auxiliary")[0], drawn.points["B"])
    ring = round_about(curves(drawn, FRAME, "auxiliary")[0], drawn.points["A"])
    assert ring - planet == pytest.approx(26.0)
    assert ring / planet == pytest.approx(29.0 / 23.0)
    (rim,) = curves(drawn, FRAME, "profile")
    assert np.min(np.linalg.norm(rim, axis=2)) > ring
    assert np.all(drawn.poses(FRAME) == 0.0)
    assert drawn.high[0] >= np.max(rim[..., 0])


def test_a_pitch_line_rolls_on_its_pinion(tmp_path):
    drawn = scene(analysed(RACK, tmp_path).cycle)
    (line,) = curves(drawn, "rack", "auxiliary")
    np.testing.assert_allclose(apart(drawn.points["A"], line), 30.0, rtol=1e-9)
    moved = np.linalg.norm(line[-1, 0] - line[0, 0])
    assert moved == pytest.approx(30.0 * 0.5 * math.pi)
    foot = np.sum((drawn.points["A"] - line[:, 0]) * (line[:, 1] - line[:, 0]), axis=1)
    assert np.all((foot > 0.0) & (foot < np.sum((line[:, 1] - line[:, 0]) ** 2, axis=1)))


def test_a_pinion_rolls_on_a_fixed_rack_and_on_one_that_moves():
    file = Path(__file__).parents[1] / "data" / "mechanisms" / "pinion-between-racks.toml"
    drawn = scene(optlink.analyze(optlink.load(file), points=24))
    for body, side in ((FRAME, 30.0), ("bar", -30.0)):
        (line,) = curves(drawn, body, "auxiliary")
        np.testing.assert_allclose(drawn.points["C"][:, 1] - line[..., 1].T, side, rtol=1e-9)
        assert np.all((line[:, 0, 0] < drawn.points["C"][:, 0]) & (drawn.points["C"][:, 0] < line[:, 1, 0]))


@pytest.mark.parametrize(("crossed", "apart_by"), [("", 40.0), (", crossed = true", 120.0)])
def test_the_strands_of_a_belt_touch_both_wheels(crossed, apart_by, tmp_path):
    drawn = scene(analysed(BELT % crossed, tmp_path).cycle)
    strands = curves(drawn, FRAME, "auxiliary")
    assert len(strands) == 2
    for strand in strands:
        for name, radius in (("A", 40.0), ("D", 80.0)):
            np.testing.assert_allclose(apart(drawn.points[name], strand), radius, rtol=1e-9)
        length = math.sqrt(300.0**2 + 50.0**2 - apart_by**2)
        np.testing.assert_allclose(np.linalg.norm(strand[:, 1] - strand[:, 0], axis=1), length, rtol=1e-9)


@pytest.mark.parametrize(
    ("joints", "guide", "form"),
    [
        ('"R"]', RAIL, f'roller = "6 mm", base_radius = "30 mm", {RISE % ("15 mm", "15 mm")}'),
        ('"R"]', RAIL, f'roller = "6 mm", start = "36 mm", {RISE % ("15 mm", "15 mm")}'),
        ('"F", "R"], length = "80 mm"', "", f'roller = "6 mm", base_radius = "30 mm", {RISE % ("12 deg", "12 deg")}'),
        (
            '"F", "R"], length = "80 mm"',
            "",
            f'roller = "6 mm", side = "right", base_radius = "30 mm", {RISE % ("9 deg", "9 deg")}',
        ),
    ],
)
def test_a_roller_stays_on_its_cam(joints, guide, form, tmp_path):
    drawn = scene(analysed(CAM % (joints, guide, form), tmp_path).cycle)
    profile, roller = curves(drawn, "cam", "profile")[0], drawn.points["R"]
    gaps = [np.min(np.linalg.norm(_dense(corners) - at, axis=1)) for corners, at in zip(profile[::7], roller[::7], strict=True)]
    np.testing.assert_allclose(gaps, 6.0, atol=0.02)
    assert round_about(curves(drawn, "follower", "profile")[0], roller) == pytest.approx(6.0)


def _dense(corners: np.ndarray) -> np.ndarray:
    shares = np.linspace(0.0, 1.0, 20, endpoint=False)[:, None, None]
    return ((1.0 - shares) * corners[:-1] + shares * corners[1:]).reshape(-1, 2)


def test_a_flat_face_stays_on_its_cam(tmp_path):
    form = f'flat = true, base_radius = "30 mm", {RISE % ("15 mm", "15 mm")}'
    drawn = scene(analysed(CAM % ('"R"]', RAIL, form), tmp_path).cycle)
    way = np.array([math.cos(math.radians(70.0)), math.sin(math.radians(70.0))])
    profile, face = curves(drawn, "cam", "profile")[0], curves(drawn, "follower", "profile")[0]
    np.testing.assert_allclose(np.max(profile @ way, axis=1), np.min(face @ way, axis=1), atol=0.02)
    left = np.array([-way[1], way[0]])
    contact = np.array([(corners @ left)[np.argmax(corners @ way)] for corners in profile])
    assert np.all((contact > np.min(face @ left, axis=1)) & (contact < np.max(face @ left, axis=1)))


@pytest.mark.slow
def test_several_drives_are_named_and_a_law_from_a_file_is_part_of_the_problem(tmp_path):
    (tmp_path / "port.csv").write_text("time_s,angle_deg\n0,60\n0.5,80\n1,60\n", encoding="utf-8")
    first = analysed(ARMS, tmp_path)
    drawn = scene(first.cycle)
    assert (drawn.captions["A"], drawn.captions["E"], drawn.captions["P"]) == ("A: left", "E: port", "P")
    assert ">E: port<" in svg(drawn, "arms")
    (tmp_path / "port.csv").write_text("time_s,angle_deg\n0,60\n0.5,81\n1,60\n", encoding="utf-8")
    assert optlink.load(tmp_path / "problem.toml").hash != first.problem.hash


def test_a_dxf_holds_barrel_and_rod(tmp_path):
    shown = analysed(BOOM, tmp_path)
    export(shown, tmp_path / "a.dxf", Options())
    drawing = ezdxf.readfile(tmp_path / "a.dxf")
    inserts = {insert.dxf.name: insert for insert in drawing.modelspace().query('INSERT[layer=="ASSEMBLY"]')}
    barrel, rod = inserts["LINK lift"], inserts["LINK lift.rod"]
    assert rod.dxf.rotation == pytest.approx(barrel.dxf.rotation)
    away = np.subtract(rod.dxf.insert, barrel.dxf.insert)
    assert np.linalg.norm(away) == pytest.approx(1200.0)
    for name in ("LINK lift", "LINK lift.rod"):
        block = drawing.blocks[name]
        assert len(block.query("CIRCLE")) == 1
        assert {entity.dxf.layer for entity in block} == {name}


def test_a_dxf_holds_the_pitch_circles(tmp_path):
    export(analysed(GEARS, tmp_path), tmp_path / "a.dxf", Options())
    drawing = ezdxf.readfile(tmp_path / "a.dxf")
    circles = drawing.blocks["LINK wheel"].query('CIRCLE[layer=="MARKS"]')
    assert [circle.dxf.linetype for circle in circles] == ["CHAIN"]
    assert circles[0].dxf.radius == pytest.approx(2.0 / 3.0 * math.hypot(60.0, 10.0))


def test_the_force_of_a_cylinder_is_charted_and_exported(tmp_path):
    shown = analysed(BOOM, tmp_path)
    curve = CycleCurves(shown.cycle)
    (force,) = torque(curve)
    assert force.title == "Driving force"
    for ending in ("svg", "json", "csv"):
        export(shown, tmp_path / f"a.{ending}", Options())
    assert '"lift.rod"' in (tmp_path / "a.json").read_text(encoding="utf-8")


def test_a_lever_with_one_joint_is_drawn(tmp_path):
    lever = '[mechanism.ground]\nA = ["0 m", "0 m"]\n[mechanism.links]\nlid = { joints = ["A"] }\n[drive]\nbody = "lid"\n'
    drawn = scene(analysed(lever, tmp_path).cycle)
    assert [part.kind for part in drawn.parts["lid"]] == ["bar"]


def test_show_lists_elements_in_the_order_of_solution_and_drives_with_their_laws(tmp_path):
    def rows(text: str) -> dict[str, list[tuple[str, ...]]]:
        path = tmp_path / "problem.toml"
        path.write_text(f'title = "Shown"\n{text}', encoding="utf-8")
        shown = analysis_tables.machine(optlink.load(path))
        return {spec.title: [tuple(cell.text for cell in row) for row in spec.rows] for spec in shown}

    lift = rows(BOOM)
    assert lift["Order of solution"][0][:2] == ("driven length", "lift")
    assert lift["[drive] and loads"][0] == ("drive", "length of lift between 1200 mm and 1900 mm at 100 mm/s")
    gears = rows(GEARS)["Order of solution"]
    assert [row[:3] for row in gears] == [("crank", "crank", "pivot A"), ("gears", "crank, wheel", "train")]
    (tmp_path / "port.csv").write_text("time_s,angle_deg\n0,60\n0.5,80\n1,60\n", encoding="utf-8")
    drives = rows(ARMS)["[drive] and loads"]
    assert drives[0] == ("drive left", "angle of left by a law of 1 s, from 100 deg to 150 deg")
    assert drives[1][0] == "drive port"
