"""Regions of limits in drawings: where their lines lie, and that a violated one is red, in every format."""

from __future__ import annotations

import math
import re
from pathlib import Path

import ezdxf
import numpy as np
import pytest

import optlink
from optlink.presentation.export.export import export
from optlink.presentation.html.page import animation_of
from optlink.presentation.report_model import ReportModel, report_model_of
from optlink.presentation.scene import Region, regions_of
from optlink.presentation.shapes import clipped
from optlink.presentation.style import GROUND, LIMIT
from optlink.presentation.views.design_drawings import beside_curve
from optlink.problem.limits import RegionLimit
from optlink.studio.picture import Picture
from tests.tiers import mostly_slow

LOW, HIGH, SIZE = np.array([-0.1, -0.1]), np.array([0.1, 0.1]), 0.005
SIDES = {"outside": -1.0, "inside": 1.0}
SHAPES = {
    "circle": {"region": "circle", "centre": ["10 mm", "20 mm"], "radius": "15 mm"},
    "box": {"region": "box", "x": ["-12 mm", "60 mm"], "y": ["7 mm", "40 mm"]},
    "open box": {"region": "box", "x": ["-12 mm", "60 mm"], "y": {"min": "7 mm"}},
    "half-plane": {"region": "half-plane", "through": ["0 mm", "20 mm"], "direction": "30 deg"},
}
DESIGN = {"crank": 0.01916797, "coupler": 0.03692093, "rocker": 0.2, "frame": 0.19805286, "P.along": 0.11010458} | {
    "P.across": -0.02533714,
    "A.x": -0.00572051,
    "A.y": 0.10503266,
    "direction": -2.83796735,
}
"""Nearly the best design of path-in-trough."""


@pytest.fixture(scope="module", params=mostly_slow([False, True], False), ids=["kept", "violated"])
def shown(request) -> tuple[bool, ReportModel]:
    changes = {"limits.shaft.clearance": "2.99 mm", "limits.bottom.clearance": "1.99 mm", "mechanism.assembly": "left"}
    changes |= {"limits.shaft.radius": "14 mm"} if request.param else {}
    problem = optlink.load("path-in-trough", changes)
    return request.param, report_model_of(optlink.validate(problem, DESIGN))


@pytest.mark.parametrize("side", SIDES)
@pytest.mark.parametrize("shape", SHAPES)
def test_the_lines_lie_at_their_distances(shape: str, side: str) -> None:
    """By the distances that the validator measures: the edge at zero, the clearance at 3 mm, the hatching beyond the edge."""
    limit = RegionLimit.model_validate(SHAPES[shape] | {"of": "P", "side": side, "clearance": "3 mm"})
    drawn = Region("zone", limit).outline(LOW, HIGH, SIZE)

    def away(line: np.ndarray) -> np.ndarray:
        known = line[np.isfinite(line[:, 0])]
        assert len(known) > 1
        assert np.all((known > LOW - 1e-12) & (known < HIGH + 1e-12))
        return np.min(limit.measured(known), axis=0)

    assert away(drawn.edge) == pytest.approx(0.0, abs=1e-12)
    assert away(drawn.clearance) == pytest.approx(0.003, abs=1e-12)
    ends = np.min(limit.measured(drawn.hatching.reshape(-1, 3, 2)[:, 1]), axis=0)
    assert np.median(ends) < -0.2 * SIZE
    assert np.mean(ends < 0.0) > 0.9  # a stroke at a corner may lie beside it
    if side == "inside":
        assert np.min(limit.measured(drawn.label), axis=0) < 0.0


def test_a_line_is_clipped_at_the_window() -> None:
    """A square about a corner of the window, and lines that miss it, touch it or run along it."""
    square = np.array([(0.05, 0.05), (0.15, 0.05), (0.15, 0.15), (0.05, 0.15), (0.05, 0.05)])
    kept = clipped(square, LOW, HIGH)
    assert kept[np.isfinite(kept[:, 0])] == pytest.approx(np.array([(0.05, 0.05), (0.1, 0.05), (0.05, 0.1), (0.05, 0.05)]))
    assert len(clipped(np.array([(0.2, -1.0), (0.2, 1.0)]), LOW, HIGH)) == 0
    assert clipped(np.array([(-1.0, 0.1), (1.0, 0.1)]), LOW, HIGH) == pytest.approx(np.array([(-0.1, 0.1), (0.1, 0.1)]))
    gap = np.array([(0.0, 0.0), (0.01, 0.0), (np.nan, np.nan), (0.02, 0.0), (0.03, 0.0)])
    assert clipped(gap, LOW, HIGH) == pytest.approx(gap, nan_ok=True)


def test_a_region_far_away_does_not_enlarge_the_drawing() -> None:
    for through, seen in (("-120 mm", True), ("-900 mm", False)):
        limit = {"region": "half-plane", "through": ["0 mm", through], "direction": "0 deg", "of": "P"}
        places = Region("floor", RegionLimit.model_validate(limit)).features(LOW, HIGH, SIZE)
        assert (len(places) > 0) is seen


def test_pictures_show_the_regions(shown) -> None:
    violated, about = shown
    drawn = beside_curve(about.result)
    assert drawn is not None
    colours = {line.get_gid(): line.get_color() for line in drawn.axes[0].lines if line.get_gid() in ("shaft", "bottom")}
    assert colours == {"shaft": LIMIT if violated else GROUND, "bottom": GROUND}
    assert {"shaft", "bottom"} <= {text.get_text() for text in drawn.axes[0].texts}


def test_the_page_and_svg_files_show_the_regions(shown, tmp_path: Path) -> None:
    violated, about = shown
    moving = animation_of(about, 90)
    assert moving is not None
    export(about, tmp_path / "a.svg")
    for text in (moving.svg("title"), (tmp_path / "a.svg").read_text(encoding="utf-8")):
        lines = re.findall(r'<path data-region="(\w+)"[^>]* stroke="(#\w+)"', text)
        assert set(lines) == {("shaft", LIMIT if violated else GROUND), ("bottom", GROUND)}
        assert len(lines) == 6  # edge, hatching and clearance of both
        assert len(re.findall("stroke-dasharray", text)) == 2
        assert text.count(">shaft</text>") == 2  # with its rim


def test_dxf_files_have_a_layer_of_regions(shown, tmp_path: Path) -> None:
    violated, about = shown
    export(about, tmp_path / "a.dxf")
    space = ezdxf.readfile(tmp_path / "a.dxf").modelspace()
    [edge, clearance, *_] = space.query('LWPOLYLINE[layer=="REGIONS"]')
    radius = 14.0 if violated else 10.0
    for line, wanted in ((edge, radius), (clearance, radius + 2.99)):
        assert [math.hypot(x, y - 24.0) for x, y in line.get_points("xy")] == pytest.approx([wanted] * len(line), abs=1e-9)
    assert (edge.dxf.linetype, clearance.dxf.linetype) == ("Continuous", "DASHED")
    assert (edge.dxf.color == 1) is violated
    assert sorted(text.dxf.text for text in space.query('TEXT[layer=="REGIONS"]')) == ["bottom", "shaft"]


def test_the_studio_draws_the_regions(shown) -> None:
    violated, about = shown
    best = about.result.best
    picture = Picture(about.cycle.machine, 0.0, 1.0, regions_of(best.problem, best.validation.checks)).document()
    assert [(region["name"], region["violated"]) for region in picture["regions"]] == [("shaft", violated), ("bottom", False)]
    [edge, _, clearance] = picture["regions"][0]["lines"]
    assert [clearance["dashed"], edge["dashed"]] == [True, False]
    x, y = np.array(edge["line"]).T
    assert np.hypot(x, y - 24.0) == pytest.approx(14.0 if violated else 10.0, abs=0.01)
