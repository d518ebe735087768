"""Profiles of cams and rollers in every drawing: SVG, moving page, matplotlib, studio, DXF."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import ezdxf
import numpy as np
import pytest
from matplotlib.patches import Polygon

import optlink
from optlink.linkage.cams import DiscCam, Profile, Roller, Slide
from optlink.linkage.motion import sweep
from optlink.presentation.drawing import Sketch
from optlink.presentation.export.export import Options, export
from optlink.presentation.export.svg import motion_data, svg
from optlink.presentation.report_model import ReportModel
from optlink.presentation.scene import LOOKS, scene
from optlink.presentation.style import figure
from optlink.problem.file import fixed_design
from optlink.problem.mechanism import sizes_of
from optlink.studio.picture import Picture

SVG = "{http://www.w3.org/2000/svg}"
AT = math.radians(40.0)
ROLLER, BASE = 0.03, 0.2  # larger than the crank
CAM = DiscCam(
    lambda theta: (0.05 - 0.05 * np.cos(theta), 0.05 * np.sin(theta), 0.05 * np.cos(theta)), Slide(), Roller(ROLLER), BASE
)
LINE = CAM.polyline()


@pytest.fixture(scope="module")
def shown() -> ReportModel:
    """A slider-crank with a cam on its crank, and a roller about the pin of its slider."""
    problem = optlink.load("slider-crank")
    problem = fixed_design(problem, sizes_of(problem.model.mechanism.quantities))
    cycle = optlink.analyze(problem)
    origin = np.zeros((1, 2))
    slider = cycle.machine.mechanism.guides[0].slider
    profiles = {"crank": CAM.profiles, slider: (Profile(origin, ROLLER),)}
    cycle = replace(cycle, machine=cycle.machine.with_(profiles=profiles))
    return ReportModel(problem, cycle, cycle)


def placed(shown: ReportModel, at: float) -> np.ndarray:
    """The profile [mm] at a crank angle."""
    machine = shown.cycle.machine
    start = sweep(machine.mechanism, machine.sizes, [at]).position(machine.mechanism.crank.start)[0]
    c, s = math.cos(at), math.sin(at)
    return 1e3 * (start + LINE @ np.array([[c, s], [-s, c]]))


def numbers(path: str) -> np.ndarray:
    """Corners (n, 2) of the data of a path."""
    return np.array(re.findall(r"-?[\d.]+(?:e-?\d+)?", path), dtype=float).reshape(-1, 2)


def test_a_dxf_holds_the_profile_the_base_circle_and_the_roller(shown, tmp_path):
    export(shown, tmp_path / "a.dxf", Options(at=AT, hole=0.008))
    drawing = ezdxf.readfile(tmp_path / "a.dxf")
    assert drawing.audit().errors == []
    block = drawing.blocks["LINK crank"]
    (outline,) = block.query("LWPOLYLINE")  # the cam encloses both joints: it is the outline of the crank
    assert outline.closed
    assert outline.dxf.layer == "LINK crank"
    np.testing.assert_allclose(np.array(outline.get_points("xy")), 1e3 * LINE, atol=1e-9)
    circles = {round(circle.dxf.radius, 9): circle for circle in block.query("CIRCLE")}
    assert (circles[1e3 * BASE].dxf.layer, circles[1e3 * BASE].dxf.linetype) == ("MARKS", "CHAIN")
    (insert,) = (one for one in drawing.modelspace().query('INSERT[layer=="ASSEMBLY"]') if one.dxf.name == block.name)
    (turned,) = (part for part in insert.virtual_entities() if part.dxftype() == "LWPOLYLINE")
    np.testing.assert_allclose(np.array(turned.get_points("xy")), placed(shown, AT), atol=1e-6)
    slider = drawing.blocks[f"LINK {shown.cycle.machine.mechanism.guides[0].slider}"]
    assert [circle.dxf.layer for circle in slider.query("CIRCLE") if circle.dxf.radius == 1e3 * ROLLER] == [slider.name]
    assert slider.query("LWPOLYLINE")  # its own outline remains
    boxes = {}
    for part in drawing.modelspace().query('INSERT[layer=="PARTS"]'):
        x, y = list(part.dxf.insert)[:2]
        line = drawing.blocks[part.dxf.name].query("LWPOLYLINE")
        corners = np.concatenate([np.array(one.get_points("xy")) for one in line]) + np.array([x, y])
        boxes[part.dxf.name] = corners.min(axis=0), corners.max(axis=0)
    low, high = boxes.pop(block.name)
    assert boxes
    assert not any(np.all(np.minimum(high, other_high) > np.maximum(low, other_low)) for other_low, other_high in boxes.values())


def test_a_profile_beside_the_joints_leaves_the_outline_of_the_link(shown, tmp_path):
    far = Profile(LINE + np.array([2.0 * np.max(np.abs(LINE)), 0.0]))
    cycle = replace(shown.cycle, machine=shown.cycle.machine.with_(profiles={"crank": (far,)}))
    export(ReportModel(shown.problem, cycle, cycle), tmp_path / "a.dxf", Options())
    assert len(ezdxf.readfile(tmp_path / "a.dxf").blocks["LINK crank"].query("LWPOLYLINE")) == 2


def test_an_svg_draws_the_profile_where_it_is(shown, tmp_path):
    export(shown, tmp_path / "a.svg", Options(at=AT))
    root = ElementTree.parse(tmp_path / "a.svg").getroot()
    left, top, wide, high = map(float, root.get("viewBox").split())
    groups = [group for group in root.iter(f"{SVG}g") if group.get("data-body") == "crank"]
    paths = [(group, path) for group in groups for path in group.iter(f"{SVG}path")]
    ((group, profile),) = ((group, path) for group, path in paths if path.get("d").count("L") == len(LINE))
    x, y, turn = map(float, re.findall(r"-?[\d.]+", group.get("transform")))
    assert -turn == pytest.approx(math.degrees(AT))
    c, s = math.cos(math.radians(turn)), math.sin(math.radians(turn))
    corners = numbers(profile.get("d"))[:-1] @ np.array([[c, s], [-s, c]]) + [x, y]
    np.testing.assert_allclose(corners * [1.0, -1.0], placed(shown, AT), atol=0.02)
    assert profile.get("d").endswith("Z")
    assert profile.get("fill") != "none"
    assert np.all((corners > [left, top]) & (corners < [left + wide, top + high]))
    (dashed,) = (path for _, path in paths if path.get("stroke-dasharray"))
    np.testing.assert_allclose(np.linalg.norm(numbers(dashed.get("d")), axis=1), 1e3 * BASE, atol=0.02)
    assert dashed.get("fill") == "none"


def test_the_page_moves_the_profile_with_its_body(shown):
    moving = scene(shown.cycle)
    low, high = np.array(moving.limits).T
    for k in (0, 50, 200):
        corners = placed(shown, math.radians(moving.crank_angles[k]))
        assert np.all((corners > low) & (corners < high))
    text = svg(moving, "cam")
    assert 'data-body="crank"' in text[: text.index(numbers_of(moving))].rpartition("<g")[2]
    assert set(motion_data(moving)["bodies"]["crank"]) == {"x", "y", "a"}


def numbers_of(moving) -> str:
    """Beginning of the path of the cam at the first position of a page."""
    (profile,) = (part.outline for part in moving.parts["crank"] if part.kind == "profile")
    x, y = (f"{value:z.{moving.decimals}f}".rstrip("0").rstrip(".") for value in profile[0] * [1.0, -1.0])
    return f'd="M{x} {y} L'


def test_matplotlib_draws_the_profile(shown):
    machine = shown.cycle.machine
    motion = sweep(machine.mechanism, machine.sizes, [AT])
    sketch = Sketch(sweep(machine.mechanism, machine.sizes, np.linspace(0.0, 2.0 * math.pi, 73)), machine)
    axes = figure(4.0, 4.0).add_subplot()
    outlines = [
        artist.get_xy() for artist in sketch.pose(axes, motion) if isinstance(artist, Polygon) and artist.get_gid() == "crank"
    ]
    (outline,) = (xy for xy in outlines if len(xy) > len(LINE))
    np.testing.assert_allclose(outline[: len(LINE)], placed(shown, AT) * sketch.scale.factor / 1e3, rtol=1e-9, atol=1e-9)


def test_the_studio_draws_every_kind_of_part(shown):
    (crank,) = (body for body in Picture(shown.cycle.machine, 0.0).document()["bodies"] if body["name"] == "crank")
    kinds = {part["kind"]: part["closed"] for part in crank["parts"]}
    assert kinds.pop("profile")
    assert not kinds.pop("auxiliary")
    script = (Path(optlink.__file__).parent / "studio" / "assets" / "linkage.js").read_text(encoding="utf-8")
    (layers,) = re.findall(r"const LAYERS = \[(.*)\];", script)
    assert {*re.findall(r'"(\w+)"', layers)} == set(LOOKS)


def test_what_a_curve_encloses():
    square = Profile(np.array([[0.0, 0.0], [2.0, 0.0], [2.0, 2.0], [0.0, 2.0]]))
    assert square.encloses(np.array([[1.0, 1.0], [0.1, 1.9]]))
    assert not square.encloses(np.array([[1.0, 1.0], [2.1, 1.0]]))
    circle = Profile(np.array([[1.0, 1.0]]), 0.5).scaled(2.0)
    assert circle.encloses(np.array([[2.0, 2.9]]))
    assert not circle.encloses(np.array([[2.0, 3.1]]))
