"""Pictures show what they claim: data of the drawn lines against the kinematics, not just that a file exists."""

from __future__ import annotations

import itertools
import json
import math

import numpy as np
import pytest
from matplotlib.contour import ContourSet
from matplotlib.text import Text
from PIL import Image

import optlink
from optlink.errors import InputError
from optlink.io import whole, write_json
from optlink.presentation.chart_mpl import draw
from optlink.presentation.registry import view_of
from optlink.presentation.report_model import report_model_of, solve_or_validate
from optlink.presentation.views import design_cycle
from optlink.presentation.views.design import charts, frames
from optlink.presentation.views.design_drawings import at_positions
from optlink.presentation.views.design_tables import from_flat
from optlink.presentation.views.objective_map import objective_map


def chart(result, name: str):
    """The charts of a file."""
    return [one for one in charts(result) if one.file == name]


def test_mechanism_is_drawn_at_its_characteristic_positions(solved):
    figure = at_positions(solved)
    titles = [axes.get_title() for axes in figure.axes]
    assert len(titles) == 5
    assert any("start = outer dead centre" in title and "26.47" in title for title in titles)
    assert any("largest transmission angle" in title and "γ 135.00" in title for title in titles)
    for axes in figure.axes:
        links = [line.get_xydata() for line in axes.get_lines() if line.get_linewidth() >= 3.0]
        lengths = sorted(float(np.linalg.norm(xy[1] - xy[0])) for xy in links)
        assert lengths == pytest.approx([100.0, 232.246171, 412.865416], abs=1e-5)


@pytest.mark.slow
def test_point_names_avoid_links_and_stay_inside(solved):
    figure = at_positions(solved)
    figure.draw_without_rendering()
    for axes in figure.axes:
        letters = {text.get_text(): text.get_window_extent() for text in axes.texts}
        assert set(letters) == set("ABCD")
        area = axes.get_window_extent()
        for name, box in letters.items():
            assert area.x0 <= box.x0 < box.x1 <= area.x1, name
            assert area.y0 <= box.y0 < box.y1 <= area.y1, name
            for line in axes.get_lines():
                if line.get_linewidth() >= 3.0:
                    (x0, y0), (x1, y1) = axes.transData.transform(line.get_xydata())
                    share = np.linspace(0.0, 1.0, 400)
                    assert not any(
                        box.contains(x, y) for x, y in zip(x0 + share * (x1 - x0), y0 + share * (y1 - y0), strict=True)
                    )
        assert [line.get_gid() for line in axes.get_lines() if line.get_linewidth() >= 3.0] == ["coupler", "rocker", "crank"]


@pytest.mark.slow
def test_a_large_four_bar_is_drawn_in_metres(crank_rocker):
    raw = {**crank_rocker.raw, "limits": {"crank": "full rotation"}}
    raw["mechanism"] = {"crank": "10 m", "frame": "50 m", "coupler": "41.3 m", "rocker": "23.2 m"}
    figure = at_positions(optlink.validate(optlink.read(raw), {}))
    assert figure.axes[0].get_xlabel() == "x [m]"
    assert "in m: crank 10.000   coupler 41.300   rocker 23.200   frame 50.000" in figure.get_suptitle()
    lengths = sorted(
        float(np.linalg.norm(np.diff(line.get_xydata(), axis=0)))
        for line in figure.axes[0].get_lines()
        if line.get_linewidth() >= 3
    )
    assert lengths == pytest.approx([10.0, 23.2, 41.3])


def test_law_chart_shows_target_generated_and_error(solved):
    top, bottom = draw(chart(solved, "law")).axes
    target, computed, marks = (line.get_xydata() for line in top.get_lines()[:3])
    start = math.degrees(solved.design["phi0"])
    assert target[0] == pytest.approx([start, math.degrees(solved.design["psi0"])])
    assert target[-1, 1] - target[0, 1] == pytest.approx(30.0)
    assert len(marks) == 30
    (error,) = (line.get_ydata() for line in bottom.get_lines() if line.get_gid() == "error")
    np.testing.assert_allclose(error, computed[:, 1] - target[:, 1], atol=1e-9)
    assert np.max(np.abs(error)) == pytest.approx(2.29005, abs=1e-4)


def test_transmission_touches_its_limit(solved):
    axes = draw(chart(solved, "transmission")).axes[0]
    gamma = max((line.get_ydata() for line in axes.get_lines()), key=len)
    assert np.max(gamma) == pytest.approx(135.0, abs=1e-6)
    assert np.min(gamma) == pytest.approx(70.3792, abs=1e-3)
    marks = [mark.text for mark in chart(solved, "transmission")[0].panels[0].marks]
    assert marks == ["smallest 70.38°", "largest 135.00°, 45° from 180°"]
    assert (from_flat(44.0, 135.0), from_flat(45.0, 135.0), from_flat(math.nan, math.nan)) == ("", "", "")


@pytest.mark.slow
def test_map_holds_the_iterations_and_the_optimum(solved):
    axes = objective_map(solved).axes[0]
    labels = {line.get_label(): line.get_xydata() for line in axes.get_lines()}
    assert labels["design"][0] == pytest.approx([412.865416, 232.246171], abs=1e-5)
    for name in ("slsqp", "ipopt"):
        path = labels[f"{name}, iterations"]
        assert path[0] == pytest.approx([400.0, 400.0], abs=60.0)
        assert path[-1] == pytest.approx([412.865416, 232.246171], abs=0.1)


@pytest.mark.slow
def test_the_infeasible_region_of_a_map_is_veiled_up_to_its_edge(solved):
    """And not in steps of the grid of the map."""
    sets = [each for each in objective_map(solved).axes[0].collections if isinstance(each, ContourSet)]
    (veil,) = (each for each in sets if each.filled and each.get_alpha() == 0.62)
    (edge,) = (each for each in sets if not each.filled and list(each.levels) == [0.0])
    veiled, along = (np.concatenate([path.vertices for path in each.get_paths()]) for each in (veil, edge))
    assert len(along) > 100
    assert max(np.min(np.hypot(*(veiled - place).T)) for place in along) < 1e-6


@pytest.mark.slow
def test_map_only_for_two_free_quantities(crank_rocker):
    changed = crank_rocker.override({"mechanism.frame": {"bounds": ["450 mm", "550 mm"]}})
    assert objective_map(optlink.solve(changed)) is None


@pytest.mark.slow
def test_film_moves_through_the_revolution(solved, tmp_path):
    pictures = frames(solved, count=12)
    assert len(pictures) == 12
    arrays = [np.asarray(picture.convert("RGB")) for picture in pictures]
    assert all(np.any(a != b) for a, b in itertools.pairwise(arrays))
    files = view_of("design").write(solved, tmp_path, film=True)
    with Image.open(tmp_path / "motion.gif") as film:
        assert film.n_frames == 90
    assert {file.name for file in files} == {path.name for path in tmp_path.iterdir()}


def test_a_design_that_cannot_be_assembled_leaves_out_its_pictures(crank_rocker, tmp_path):
    result = optlink.validate(crank_rocker, {"coupler": 0.12, "rocker": 0.12})
    assert not result.valid
    files = view_of("design").write(result, tmp_path)
    assert [file.name for file in files] == ["result.json", "points.csv", "design.toml"]
    assert json.loads((tmp_path / "result.json").read_text())["objective"]["value"] is None


@pytest.mark.slow
def test_an_oscillating_crank_is_drawn_over_its_range(crank_rocker, tmp_path):
    """A triple-rocker: the pictures cover the range of the requirement, and no more."""
    raw = {**crank_rocker.raw, "limits": {"crank": "span"}}
    raw["mechanism"] = {
        name: f"{value} mm" for name, value in zip(("crank", "coupler", "rocker", "frame"), (300, 250, 280, 500), strict=True)
    }
    raw["requirement"] = {**raw["requirement"], "from": "30 deg", "span": "20 deg"}
    result = optlink.validate(optlink.read(raw), {})
    assert result.valid
    axes = draw(chart(result, "transmission")).axes[0]
    angles = max((line.get_xdata() for line in axes.get_lines()), key=len)
    assert (angles[0], angles[-1]) == pytest.approx((30.0, 50.0))
    view_of("design").write(result, tmp_path, film=True)
    assert (tmp_path / "motion.gif").exists()


def test_a_failed_write_leaves_no_files(tmp_path):
    target = tmp_path / "result.json"
    target.write_text("before")

    def fail_half_way():
        with whole(target) as temporary:
            temporary.write_text("half")
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fail_half_way()
    assert target.read_text() == "before"
    assert [path.name for path in tmp_path.iterdir()] == ["result.json"]


def test_a_full_disk_is_reported_and_leaves_no_files(tmp_path, monkeypatch):
    target = tmp_path / "result.json"

    def full(*_args, **_kwargs):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("pathlib.Path.write_text", full)
    with pytest.raises(InputError, match="No space left on device"):
        write_json(target, {})
    assert list(tmp_path.iterdir()) == []


def test_the_page_of_a_balancing_problem_says_that_it_shows_the_machine_before() -> None:
    problem = optlink.load("balance-four-bar")
    (note,) = report_model_of(solve_or_validate(problem)).notes
    assert "before balancing" in note


def test_the_picture_of_an_optimised_machine_names_its_points() -> None:
    """Its tables speak of the guide force in F, the pressure angle at C or A.x."""
    design = {"crank.length": 0.047, "rod.length": 0.128, "G.offset": 0.04}  # [m]
    picture = design_cycle.beside_initial(optlink.validate(optlink.load("stroke-slider-crank"), design))
    assert {"A", "B", "C"} <= {text.get_text() for text in picture.findobj(Text)}
