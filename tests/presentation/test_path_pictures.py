"""Pictures, files and tables of generated linkages show what the designs do, by the formulas of the oracle."""

from __future__ import annotations

import csv
import functools
import io
import itertools
import json
import math
import re
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image
from rich.console import Console

import optlink
from optlink.errors import Status
from optlink.presentation import terminal
from optlink.presentation.chart_mpl import pictures
from optlink.presentation.registry import view_of
from optlink.presentation.style import LIMIT
from optlink.presentation.views import design as view, design_charts, design_tables as tables
from optlink.presentation.views.design_charts import CloseUp
from optlink.presentation.views.design_tables import decimals, words_of
from optlink.presentation.views.design_view import DesignView
from optlink.tasks.results.common import evidence
from optlink.tasks.results.design import LinkageDesign, SynthesisResult
from optlink.validation import validate as validate_path
from tests import synthesis_oracle as oracle
from tests.tiers import mostly_slow

MM = 1e-3
FREE = {"bounds": ["5 mm", "300 mm"]}
PLACE = {"bounds": ["-300 mm", "300 mm"]}
FOUR_BAR = {
    "type": "four-bar",
    **dict.fromkeys(("crank", "coupler", "rocker", "frame"), FREE),
    "points": {"P": [PLACE, PLACE]},
    "pivot": [PLACE, PLACE],
    "direction": {"bounds": ["-180 deg", "180 deg"]},
}
PLANTED = oracle.four_bar(100.0, 30.0, 80.0, 75.0, x=10.0, y=20.0, direction=0.3, along=50.0, across=40.0, mode=1)
ROUND = np.radians(30.0) + oracle.TURN * np.arange(12) / 12
PART = np.radians([40.0, 70.0, 95.0, 130.0, 170.0])
MISS = np.column_stack([1.5 * np.sin(2.0 * ROUND), 0.8 * np.cos(3.0 * ROUND) + 0.3])  # target minus generated [mm]
TOLERANCES = np.array([2.0, 1.0, math.inf, 3.0, 2.5, 2.0, 2.0, math.inf, 2.0, 3.0, 2.0, 2.0])
SLIDER = oracle.slider_crank(40.0, 110.0, x=5.0, y=-10.0, direction=0.2, offset=8.0, along=60.0, across=35.0, mode=1)


def values_of(design: dict) -> dict[str, float]:
    """Quantities [m, rad] of the oracle's four-bar [mm, rad]."""
    lengths = {name: design[name] * MM for name in ("crank", "coupler", "rocker", "frame")}
    place = {"P.along": design["along"] * MM, "P.across": design["across"] * MM, "A.x": design["x"] * MM, "A.y": design["y"] * MM}
    return {**lengths, **place, "direction": design["direction"]}


def oracle_of(design: LinkageDesign) -> dict[str, float]:
    """A four-bar design as the oracle [mm, rad] takes it."""
    v = design.values
    lengths = [v[name] / MM for name in ("frame", "crank", "coupler", "rocker")]
    names = {"x": "A.x", "y": "A.y", "along": "P.along", "across": "P.across"}
    more = {key: v[name] / MM for key, name in names.items()}
    return oracle.four_bar(*lengths, **more, direction=v["direction"], mode=design.task.four_bar.side)


def made(raw: dict, values: dict[str, float], angles: np.ndarray) -> LinkageDesign:
    """A given design with its proof."""
    problem = optlink.read(raw)
    full = {name: quantity.value for name, quantity in problem.model.quantities.items()} | values
    proof = validate_path(problem.model, full, angles)
    return LinkageDesign(problem, full, angles, proof.objective, Status.NOT_SEARCHED, proof)


def outcome(*computed: LinkageDesign, nearest: LinkageDesign | None = None) -> SynthesisResult:
    problem = (computed[0] if computed else nearest).problem
    return SynthesisResult(problem, tuple(computed), nearest, "ipopt", {}, 0, 100, evidence([10, 90]))


def path_raw(target: np.ndarray, tolerances: np.ndarray | None = None, side: str = "left", **more: object) -> dict:
    rows = [{"x": f"{x!r} mm", "y": f"{y!r} mm"} for x, y in target.tolist()]
    for row, tolerance in zip(rows, [] if tolerances is None else tolerances, strict=tolerances is not None):
        if math.isfinite(tolerance):
            row["tolerance"] = f"{tolerance} mm"
    task = {"kind": "path", "points": rows, **more}
    return {"title": "A path", "mechanism": {**FOUR_BAR, "assembly": side}, "requirement": task}


def motion_raw(poses: np.ndarray) -> dict:
    rows = [{"x": f"{x!r} mm", "y": f"{y!r} mm", "angle": f"{math.degrees(a)!r} deg"} for x, y, a in poses.tolist()]
    return {"title": "Poses", "mechanism": {**FOUR_BAR, "assembly": "left"}, "requirement": {"kind": "motion", "points": rows}}


def slider_raw(task: dict, *, point: bool) -> dict:
    rod: dict = {"joints": ["B", "C"], "length": FREE}
    if point:
        rod["points"] = {"P": [PLACE, PLACE]}
    return {
        "title": "A slider-crank",
        "mechanism": {
            "type": "dyads",
            "ground": {"A": ["5 mm", "-10 mm"]},
            "links": {"crank": {"joints": ["A", "B"], "length": "40 mm"}, "rod": rod, "slider": {"joints": ["C"]}},
            "guides": {"G": {"slider": "slider", "through": "A", "direction": f"{math.degrees(0.2)!r} deg", "offset": PLACE}},
            "assembly": {"C": "forward"},
        },
        "requirement": task,
    }


SLIDER_SIZES = {"rod.length": 110.0 * MM, "G.offset": 8.0 * MM}
PLACED = oracle.planted_path(PLANTED, ROUND)


@functools.cache
def result(name: str) -> SynthesisResult:
    """The results of these tests, each made once."""
    exact = values_of(PLANTED)
    match name:
        case "path":
            return outcome(made(path_raw(PLACED + MISS, closed=True), exact, ROUND))
        case "tolerances":
            return outcome(made(path_raw(PLACED + MISS, TOLERANCES, closed=True), exact, ROUND))
        case "lift":  # a point far away that has no tolerance
            target = PLACED + 0.1 * MISS
            target[7] += (0.0, 60.0)
            return outcome(made(path_raw(target, np.where(np.arange(12) == 7, math.inf, 1.0), closed=True), exact, ROUND))
        case "exact":
            return outcome(made(path_raw(PLACED, closed=True), exact, ROUND))
        case "two poses":
            return outcome(made(motion_raw(oracle.planted_poses(PLANTED, PART[:2])), exact, PART[:2]))
        case "poses":
            poses = oracle.planted_poses(PLANTED, PART) + np.column_stack([MISS[:5], [0.02, -0.01, 0.03, 0.0, -0.02]])
            return outcome(made(motion_raw(poses), exact, PART))
        case "slider":
            target = oracle.planted_path(SLIDER, ROUND) + MISS
            rows = [[f"{x!r} mm", f"{y!r} mm"] for x, y in target.tolist()]
            raw = slider_raw({"kind": "path", "points": rows, "closed": True}, point=True)
            return outcome(made(raw, {**SLIDER_SIZES, "rod.P.along": 60.0 * MM, "rod.P.across": 35.0 * MM}, ROUND))
        case "six-bar":
            file = optlink.load("path-watt-leg")
            sizes = {"coupler.E.along": 48, "coupler.E.across": -124, "rocker.F.along": 168, "rocker.F.across": 85}
            sizes |= {"rod.length": 147, "leg.length": 138, "leg.P.along": 151, "leg.P.across": 124}
            return outcome(made(file.raw, {k: v * MM for k, v in sizes.items()}, np.radians(20.0 * np.arange(18))))
        case "many":
            phi = oracle.TURN * np.arange(400) / 400
            wave = np.column_stack([np.sin(7.0 * phi), np.zeros(400)])
            return outcome(made(path_raw(oracle.planted_path(PLANTED, phi) + wave, closed=True), exact, phi))
        case "cognates":
            one = result("path").best
            other = one.cognates[0]  # the one that turns as the crank, with the other assembly mode
            own = {name: getattr(other.linkage, name) for name in ("crank", "coupler", "rocker", "frame", "direction")}
            own |= {
                "P.along": other.linkage.along,
                "P.across": other.linkage.across,
                "A.x": other.linkage.x,
                "A.y": other.linkage.y,
            }
            raw = path_raw(PLACED + MISS, closed=True, side="left" if other.linkage.side > 0 else "right")
            two = made(raw, own, np.asarray(other.crank_angle(ROUND)))
            third = made(path_raw(PLACED + MISS, closed=True), {**exact, "coupler": 0.084}, ROUND)
            return outcome(one, two, third)
        case "miss":
            missed = made(path_raw(PLACED + MISS, np.full(12, 0.5), closed=True), exact, ROUND)
            return outcome(nearest=missed)
        case "transmission":
            return optlink.solve(optlink.load("transmission-optimal"), starts=50, designs=2)
        case "function":
            law = {"function": "sqrt(x)", "x": [0.1, 1], "input": "90 deg", "output": "40 mm"}
            raw = slider_raw({"kind": "function", "output": "G", "law": law, "points": 24}, point=False)
            start, zero = math.radians(-70.0), 75.0 * MM
            problem = optlink.read(raw)
            names = {q.kind: n for n, q in problem.model.quantities.items() if n not in problem.model.mechanism.quantities}
            assert set(names) == {"angle", "coordinate"}
            angles = start + np.radians(90.0) * np.linspace(0.0, 1.0, 25)
            return outcome(made(raw, {**SLIDER_SIZES, names["angle"]: start, names["coordinate"]: zero}, angles))
    raise AssertionError(name)


POINTED = ("path", "tolerances", "lift", "exact", "two poses", "poses", "slider", "six-bar", "many", "miss")


@functools.cache
def picture(name: str, kind: str) -> Figure:
    draw, computed = view.VIEW.drawings.get(kind), result(name)
    drawn = draw(computed) if draw else pictures([chart for chart in view.charts(computed) if chart.file == kind])[kind]
    assert drawn is not None
    return drawn


def drawings(computed: SynthesisResult) -> dict[str, Figure | None]:
    """Every picture of a result by its file name."""
    return {name: draw(computed) for name, draw in view.VIEW.drawings.items()} | pictures(view.charts(computed))


def line(axes, gid: str) -> np.ndarray:
    (computed,) = (each for each in axes.get_lines() if each.get_gid() == gid)
    return np.asarray(computed.get_xydata())


def columns(name: str) -> dict[str, np.ndarray]:
    """The columns of points.csv."""
    best = result(name).best
    return words_of(best).columns(best)


def generated(name: str) -> np.ndarray:
    """Rows (x, y) [mm] by the oracle."""
    best = result(name).best
    return oracle.rows_of(oracle.direct(SLIDER if name == "slider" else oracle_of(best), best.crank_angles).p)


def fold(axes) -> float:
    """How many times as large deviations are drawn, as the legend says."""
    (label,) = (text for text in axes.get_legend_handles_labels()[1] if text.startswith("deviation"))
    return float(re.search(r"drawn ([\d.e+]+)-fold", label)[1]) if "drawn" in label else 1.0


# --- on the curve --------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("name", POINTED)
def test_target_points_are_drawn_at_their_coordinates(name):
    target = np.array(result(name).problem.model.target_points.points) * 1e3
    for axes in picture(name, "path").axes:
        np.testing.assert_allclose(line(axes, "target"), target, atol=1e-9)
        assert axes.get_xlabel() == "x [mm]"
        low, high = np.array([axes.get_xlim(), axes.get_ylim()]).T
        assert np.all((target > low) & (target < high))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["path", "tolerances", "poses", "slider", "many"])
def test_the_curve_agrees_with_the_oracle(name):
    linkage = SLIDER if name == "slider" else oracle_of(result(name).best)
    for axes in picture(name, "path").axes:
        drawn = line(axes, "run")[:: 7 if len(line(axes, "run")) > 200 else 1]
        assert np.max(oracle.distance_to_curve(drawn, linkage, 360)[0]) < 1e-6
        away = np.linalg.norm(line(axes, "run")[:, None] - generated(name)[None], axis=-1).min(axis=0)
        assert np.max(away) < 1.0  # the curve is drawn past every generated point


@pytest.mark.slow
def test_a_curve_through_all_points_of_a_six_bar():
    axes = picture("six-bar", "path").axes[1]
    target, drawn = line(axes, "target"), line(axes, "run")
    along = np.diff(drawn, axis=0)
    share = np.clip(np.sum((target[:, None] - drawn[:-1]) * along, axis=-1) / np.sum(along**2, axis=-1), 0.0, 1.0)
    feet = drawn[:-1] + share[..., None] * along
    assert np.max(np.linalg.norm(target[:, None] - feet, axis=-1).min(axis=1)) < 5e-3  # chords of half a degree


@pytest.mark.parametrize("name", mostly_slow(("path", "tolerances", "poses", "slider", "miss"), "path"))
def test_deviation_lines_connect_target_and_generated_points(name):
    axes = picture(name, "path").axes[1]
    times = fold(axes)
    sticks = line(axes, "deviations").reshape(-1, 3, 2)
    target = np.array(result(name).problem.model.target_points.points) * 1e3
    np.testing.assert_allclose(sticks[:, 0], target, atol=1e-9)
    np.testing.assert_allclose(sticks[:, 1], target + times * (generated(name) - target), atol=1e-6 * times)


def test_tolerances_are_circles_with_their_radius():
    axes = picture("tolerances", "path").axes[1]
    known = np.isfinite(TOLERANCES)
    circles = line(axes, "tolerances").reshape(np.count_nonzero(known), -1, 2)[:, :-1]  # without the gap behind each
    away = np.linalg.norm(circles - (PLACED + MISS)[known][:, None], axis=-1)
    np.testing.assert_allclose(away, np.broadcast_to(fold(axes) * TOLERANCES[known][:, None], away.shape))
    assert not [each for each in picture("path", "path").axes[1].get_lines() if each.get_gid() == "tolerances"]


@pytest.mark.slow
def test_exact_designs_have_no_deviations_to_draw():
    axes = picture("exact", "path").axes[1]
    assert not any(each.get_gid() == "deviations" for each in axes.get_lines())
    assert "all 12 points met exactly, to rounding" in picture("exact", "path").get_suptitle()
    assert "both poses met exactly" in picture("two poses", "path").get_suptitle()
    assert "mm²" in picture("path", "path").get_suptitle()


def test_poses_are_frames_at_their_angle():
    axes = picture("poses", "path").axes[1]
    poses = oracle.planted_poses(PLANTED, PART)
    aims = np.array(result("poses").problem.model.target_points.angles)
    places = {"target poses": np.array(result("poses").problem.model.target_points.points) * 1e3, "poses": poses[:, :2]}
    for gid, angles in (("target poses", aims), ("poses", poses[:, 2])):
        strokes = line(axes, gid).reshape(5, -1, 2)
        np.testing.assert_allclose(strokes[:, 0], places[gid], atol=1e-6)
        ahead = strokes[:, 1] - strokes[:, 0]
        np.testing.assert_allclose(oracle.wrapped(np.arctan2(ahead[:, 1], ahead[:, 0]) - angles), 0.0, atol=1e-8)
    ghosts = [patch for patch in picture("poses", "path").axes[0].patches if patch.get_gid() == "ghost"]
    assert len(ghosts) == 4  # the fifth is the mechanism itself


def test_the_close_up_omits_distant_parts_of_the_curve():
    """A few points on a part of a large curve: they fill the picture."""
    phi = np.radians([60.0, 70.0, 80.0, 90.0])
    tight = made(path_raw(oracle.planted_path(PLANTED, phi)), values_of(PLANTED), phi)
    low, high = CloseUp(DesignView(tight)).limits()
    reach = np.ptp(oracle.planted_path(PLANTED, phi), axis=0).max()
    assert np.max(high - low) < 2.0 * reach
    closed = made(path_raw(oracle.planted_path(PLANTED, phi), closed=True), values_of(PLANTED), phi)
    low, high = CloseUp(DesignView(closed)).limits()
    assert np.max(high - low) < 2.2 * reach < 0.7 * np.ptp(PLACED, axis=0).max()


@pytest.mark.parametrize(("numbers", "label"), [([1, 2, 3, 4], "1–4"), ([1, 10], "1, 10"), ([7], "7"), ([3, 4], "3, 4")])
def test_coincident_points_share_a_label(numbers, label):
    from optlink.presentation.views.design_charts import _listed

    assert _listed(numbers) == label


# --- how far off ---------------------------------------------------------------------------------------------------------


def bars(axes, gid: str) -> np.ndarray:
    return np.array([patch.get_height() for patch in axes.patches if patch.get_gid() == gid])


@pytest.mark.slow
@pytest.mark.parametrize("name", ["path", "tolerances", "poses", "slider", "miss", "lift"])
def test_bars_are_the_deviations(name):
    panels = picture(name, "errors").axes
    target = np.array(result(name).problem.model.target_points.points) * 1e3
    miss = generated(name) - target
    np.testing.assert_allclose(bars(panels[0], "distances"), np.linalg.norm(miss, axis=1), rtol=1e-7)
    linkage = SLIDER if name == "slider" else oracle_of(result(name).best)
    phi, step = result(name).best.crank_angles, 1e-5
    ahead = oracle.rows_of(oracle.direct(linkage, phi + step).p) - oracle.rows_of(oracle.direct(linkage, phi - step).p)
    along = ahead / np.linalg.norm(ahead, axis=1)[:, None]
    np.testing.assert_allclose(bars(panels[1], "along the curve"), np.sum(miss * along, axis=1), atol=1e-6)
    left = np.column_stack([-along[:, 1], along[:, 0]])
    np.testing.assert_allclose(bars(panels[1], "across, to the left"), np.sum(miss * left, axis=1), atol=1e-6)
    assert "[mm]" in panels[0].get_ylabel()


def test_bars_of_angles():
    axes = picture("poses", "errors").axes[2]
    turned = oracle.wrapped(
        oracle.planted_poses(PLANTED, PART)[:, 2] - np.array(result("poses").problem.model.target_points.angles)
    )
    np.testing.assert_allclose(bars(axes, "turned"), np.degrees(turned), atol=1e-8)
    assert "[deg]" in axes.get_ylabel()


def test_bars_beyond_the_tolerance_are_red():
    axes = picture("tolerances", "errors").axes[0]
    beyond = np.linalg.norm(MISS, axis=1) > TOLERANCES
    assert 0 < np.count_nonzero(beyond) < 12
    red = [patch.get_facecolor()[:3] == pytest.approx((0.753, 0.224, 0.169), abs=2e-3) for patch in axes.patches]
    np.testing.assert_array_equal(red, beyond)
    heights = line(axes, "tolerance").reshape(-1, 3, 2)[:, 0, 1]
    np.testing.assert_allclose(heights, TOLERANCES[np.isfinite(TOLERANCES)])


@pytest.mark.slow
def test_an_oversized_bar_is_cut_off_and_labelled_with_its_value():
    axes = picture("lift", "errors").axes[0]
    off = np.linalg.norm(generated("lift") - np.array(result("lift").problem.model.target_points.points) * 1e3, axis=1)
    assert axes.get_ylim()[1] < 2.0 < 50.0 < off[7]
    (label,) = (text for text in axes.texts if text.get_gid() == "cut off")
    assert float(label.get_text().split()[1]) == pytest.approx(off[7], rel=1e-3)
    assert label.xy[0] == 8.0
    assert not [text for axes in picture("tolerances", "errors").axes for text in axes.texts if text.get_gid() == "cut off"]


def test_there_is_no_picture_of_rounding_errors():
    assert [chart.file for chart in view.charts(result("exact"))] == ["", "transmission"]
    assert [chart.file for chart in view.charts(result("path"))] == ["", "errors", "transmission"]


@pytest.mark.slow
def test_many_points_are_a_line():
    panels = picture("many", "errors").axes
    off = np.abs(np.sin(7.0 * result("many").best.crank_angles))
    np.testing.assert_allclose(line(panels[0], "distances")[:, 1], off, atol=1e-7)
    numbers = [text.get_text() for text in picture("many", "path").axes[1].texts]
    assert "20" in numbers
    assert len(numbers) == 21  # the first and every twentieth


# --- functions and transmission ------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_transmission_angles_are_those_of_the_cosine_law():
    best = result("transmission").best
    a, b, c, d = (best.values[name] for name in ("crank", "coupler", "rocker", "frame"))
    drawn = line(picture("transmission", "transmission").axes[0], "transmission C")
    diagonal = a * a + d * d - 2.0 * a * d * np.cos(np.radians(drawn[:, 0]))
    np.testing.assert_allclose(drawn[:, 1], np.degrees(np.arccos((b * b + c * c - diagonal) / (2.0 * b * c))), atol=1e-9)
    assert np.ptp(drawn[:, 0]) == pytest.approx(360.0)
    legend = picture("transmission", "transmission").axes[0].get_legend().get_texts()[0].get_text()
    assert legend == f"at C: {drawn[:, 1].min():.2f}° to {drawn[:, 1].max():.2f}°"
    heading = picture("transmission", "mechanism").get_suptitle()
    assert f"{math.degrees(best.least_transmission):.4g}°" in heading.partition("transmission angle")[2]
    assert "cosine" not in heading
    assert not {"path", "errors"} & {name for name, drawn in drawings(result("transmission")).items() if drawn}


def test_generated_output_is_drawn_with_its_law():
    panels = picture("function", "law").axes
    computed, target = line(panels[0], "generated"), line(panels[0], "target")
    np.testing.assert_allclose(computed[:, 1], oracle.direct(SLIDER, np.radians(computed[:, 0])).output, atol=1e-7)
    share = (np.radians(target[:, 0]) - math.radians(-70.0)) / (0.5 * math.pi)
    root = np.sqrt(0.1 + 0.9 * share)
    law = 75.0 + 40.0 * (root - math.sqrt(0.1)) / (1.0 - math.sqrt(0.1))
    np.testing.assert_allclose(target[:, 1], law, atol=1e-7)
    np.testing.assert_allclose(line(panels[1], "error")[:, 1], computed[:, 1] - law, atol=1e-7)
    offsets = np.radians(np.abs(computed[:, 0] - computed[0, 0]))
    np.testing.assert_allclose(line(panels[1], "error")[:, 1], 1e3 * result("function").error(offsets), atol=1e-7)
    assert panels[0].get_ylabel() == "place along G [mm]"
    assert len(line(panels[0], "positions")) == len(line(panels[1], "errors at the positions")) == 25


# --- several designs -----------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_designs_are_drawn_side_by_side_with_cognates_named():
    computed = result("cognates").designs
    one, two = oracle_of(computed[0]), oracle_of(computed[1])
    assert abs(one["coupler"] - two["coupler"]) > 1.0
    same, _ = oracle.distance_to_curve(oracle.planted_path(two, np.linspace(0.1, 6.2, 40)), one, 720)
    assert np.max(same) < 1e-8
    assert tables.cognate_sources(computed) == {1: 0}
    panels = picture("cognates", "designs").axes
    assert len(panels) == 3
    titles = [axes.get_title() for axes in panels]
    assert ["cognate of 1: the same curve" in title for title in titles] == [False, True, False]
    assert [title.split(":")[0] for title in titles] == ["1", "2", "3"]
    assert np.ptp([np.ptp(axes.get_xlim()) for axes in panels]) < 1e-9  # one scale
    assert "3 distinct designs" in picture("cognates", "designs").get_suptitle()
    assert view.designs(result("path")) is None


@pytest.mark.parametrize("change", [{"P.across": -1.0}, {"direction": 0.9}, {"P.along": 1.5}, {"A.y": 0.9}])
def test_similar_linkages_are_not_taken_for_cognates(change):
    one, two, _ = result("cognates").designs
    other = replace(two, values={**two.values, **{name: two.values[name] * factor for name, factor in change.items()}})
    assert tables.cognate_sources((one, two)) == {1: 0}
    assert tables.cognate_sources((one, other)) == {}


# --- what is not valid, and what is not there ----------------------------------------------------------------------------------


@pytest.mark.slow
def test_invalid_designs_are_marked_everywhere(tmp_path, monkeypatch):
    for kind in ("path", "errors"):
        figure = picture("miss", kind)
        assert "NOT VALID: a point is missed by" in figure.get_suptitle()
        assert figure._suptitle.get_color() == LIMIT
        assert "NOT VALID" not in picture("path", kind).get_suptitle()
    caught = []
    monkeypatch.setattr(view, "film", lambda sketch, steps, curve, marks, title, *, more=None: caught.append(title) or [])
    view.frames(result("miss"), 4)
    ((title, cause),) = caught
    assert title == "A path"
    assert cause.startswith("NOT VALID: a point is missed by")
    written = view_of("design").write(result("miss"), tmp_path)
    assert [path.name for path in written] == [
        "result.json",
        "points.csv",
        "design.toml",
        "path.png",
        "errors.png",
        "transmission.png",
    ]
    assert (tmp_path / "design.toml").read_text(encoding="utf-8").startswith("# NOT VALID: a point is missed by")


def test_no_pictures_without_a_design(tmp_path):
    nothing = SynthesisResult(result("path").problem, (), None, "ipopt", {}, 0, 100, evidence([]))
    assert [path.name for path in view_of("design").write(nothing, tmp_path)] == ["result.json"]
    assert {path.name for path in tmp_path.iterdir()} == {"result.json"}
    assert not json.loads((tmp_path / "result.json").read_text(encoding="utf-8"))["valid"]
    assert not any(drawings(nothing).values())
    assert view.frames(nothing) == []
    assert "no linkage found" in printed(nothing, 80)


def test_a_design_that_never_assembles_is_not_drawn(tmp_path):
    apart = made(path_raw(PLACED), {**values_of(PLANTED), "frame": 0.290}, ROUND)
    assert not np.any(np.isfinite(apart.measured.generated))
    lost = outcome(nearest=apart)
    assert not any(drawings(lost).values())
    assert view.frames(lost) == []
    assert [path.name for path in view_of("design").write(lost, tmp_path)] == ["result.json", "points.csv", "design.toml"]
    assert "not valid" in printed(lost, 80)


@pytest.mark.slow
def test_a_failed_write_leaves_no_partial_files(tmp_path, monkeypatch):
    def half(image, path, *_, **__):
        path.write_bytes(b"half")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("PIL.Image.Image.save", half)
    with pytest.raises(optlink.InputError, match="No space left"):
        view_of("design").write(result("path"), tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {"result.json", "points.csv", "design.toml"}


# --- files ---------------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_all_files_are_written_and_the_animation_is_complete(tmp_path):
    written = view_of("design").write(result("cognates"), tmp_path, film=True)
    names = ["result.json", "points.csv", "design.toml", "path.png", "designs.png", "errors.png", "transmission.png"]
    names.append("motion.gif")
    assert [path.name for path in written] == names
    assert {path.name for path in tmp_path.iterdir()} == set(names)
    with Image.open(tmp_path / "motion.gif") as film:
        assert film.n_frames == view.FRAMES
        assert film.info["duration"] == 40
    with (tmp_path / "points.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.reader(file))
    assert rows[0] == ["point", "target.x_m", "target.y_m", "generated.x_m", "generated.y_m", "distance_m", "crank_angle_rad"]
    numbers = np.array(rows[1:], dtype=float)
    np.testing.assert_allclose(numbers[:, 1:3], (PLACED + MISS) * MM, atol=1e-12)
    np.testing.assert_allclose(numbers[:, 3:5], PLACED * MM, atol=1e-12)
    np.testing.assert_allclose(numbers[:, 5], np.linalg.norm(MISS, axis=1) * MM, atol=1e-12)
    np.testing.assert_allclose(numbers[:, 6], ROUND)
    machine = optlink.load(tmp_path / "design.toml").model
    for name, value in values_of(PLANTED).items():
        assert machine.quantities[name].value == pytest.approx(value, rel=1e-12)


@pytest.mark.slow
def test_columns_of_poses_tolerances_functions_and_transmission():
    turned = columns("poses")["turned_rad"]
    aims = np.array(result("poses").problem.model.target_points.angles)
    np.testing.assert_allclose(turned, oracle.wrapped(oracle.planted_poses(PLANTED, PART)[:, 2] - aims), atol=1e-10)
    np.testing.assert_allclose(columns("tolerances")["tolerance_m"], TOLERANCES * MM)
    computed = columns("function")
    outputs_ = oracle.direct(SLIDER, computed["crank_angle_rad"]).output * MM
    np.testing.assert_allclose(computed["generated_m"], outputs_, atol=1e-10)
    np.testing.assert_allclose(computed["distance_m"], np.abs(computed["generated_m"] - computed["target_m"]), atol=1e-12)
    assert list(columns("transmission")) == ["point", "crank_angle_rad", "C.transmission_rad"]


# --- film ----------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "name", mostly_slow(["path", "poses", "slider", "function", "transmission"], "path", "poses", "slider", "function")
)
def test_the_mark_of_the_film_is_the_mechanism(name, monkeypatch):
    caught = {}

    def catch(sketch, steps, curve, marks, title, *, more=None):
        caught.update(steps=steps.crank_angle, marks=marks)
        return []

    monkeypatch.setattr(view, "film", catch)
    monkeypatch.setattr(design_charts, "film", catch)
    view.frames(result(name), 24)
    steps, marks = caught["steps"], caught["marks"]
    assert len(steps) == len(marks) == 24
    if name in ("function", "transmission"):
        np.testing.assert_allclose(oracle.wrapped(np.radians(marks[:, 0]) - steps), 0.0, atol=1e-9)
        if name == "function":
            np.testing.assert_allclose(marks[:, 1], oracle.direct(SLIDER, steps).output, atol=1e-2)
            assert np.ptp(steps) == pytest.approx(2.0 * math.pi * 23 / 24)  # the crank turns fully
    else:
        linkage = SLIDER if name == "slider" else PLANTED
        np.testing.assert_allclose(marks, oracle.rows_of(oracle.direct(linkage, steps).p), atol=1e-6)


def test_passed_points_are_highlighted():
    track = DesignView(result("path").best)
    sketch = view.Passing(track)
    from optlink.presentation.style import figure

    stage, strip = figure(6.0, 3.0).subplots(1, 2)
    sketch.stage(stage)
    sketch.lay(strip)
    motion = track.sweep(np.array([ROUND[4] + 0.01]))
    lit = [artist for artist in sketch.pose(stage, motion) if artist.get_gid() == "lit"]
    assert [len(artist.get_xdata()) for artist in lit] == [5, 5]


# --- labels ------------------------------------------------------------------------------------------------------------------

DRAWN = [(name, "path") for name in POINTED]
DRAWN += [(name, "errors") for name in POINTED if name not in ("exact", "two poses", "six-bar")]
DRAWN += [(name, kind) for name in ("function", "transmission") for kind in ("mechanism", "transmission")]
DRAWN += [("function", "law"), ("cognates", "designs")]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "kind"), DRAWN)
def test_labels_stay_inside_and_do_not_overlap(name, kind):
    figure = picture(name, kind)
    figure.draw_without_rendering()
    edge = figure.bbox
    whole = [figure._suptitle, *figure.legends]
    for axes in figure.axes:
        whole += [text for text in (axes.title, axes.xaxis.label, axes.yaxis.label) if text.get_text()]
        whole += [axes.get_legend()] if axes.get_legend() else []
        area = axes.get_window_extent().padded(1.5)
        boxes = [text.get_window_extent() for text in axes.texts if text.get_text() and text.get_zorder() == 9]
        assert all(area.x0 <= box.x0 < box.x1 <= area.x1 and area.y0 <= box.y0 < box.y1 <= area.y1 for box in boxes)
        for one, other in itertools.combinations(boxes, 2):
            assert not one.overlaps(other)
    boxes = [each.get_window_extent() for each in whole]
    assert all(edge.x0 - 1 <= box.x0 < box.x1 <= edge.x1 + 1 and edge.y0 - 1 <= box.y0 < box.y1 <= edge.y1 + 1 for box in boxes)
    titles = [figure._suptitle.get_window_extent(), *(axes.title.get_window_extent() for axes in figure.axes if axes.get_title())]
    for one, other in itertools.combinations(titles, 2):
        assert not one.overlaps(other)
    for axes in figure.axes:
        if axes.get_aspect() == 1.0:
            (x0, x1), (y0, y1) = axes.transData.transform([(0.0, 0.0), (1.0, 1.0)]).T
            assert x1 - x0 == pytest.approx(y1 - y0)


# --- terminal ----------------------------------------------------------------------------------------------------------------


def printed(computed: SynthesisResult, width: int) -> str:
    page = Console(file=io.StringIO(), width=width, highlight=False, markup=False, emoji=False)
    page.print(terminal.rendered(tables.design_result(computed)))
    return page.file.getvalue()


@pytest.mark.parametrize("width", [80, 120])
@pytest.mark.parametrize("name", ["path", "cognates", "poses", "exact", "slider", "six-bar", "function", "transmission", "miss"])
def test_numbers_are_not_wrapped(name, width):
    text = printed(result(name), width)
    assert max(len(row) for row in text.splitlines()) <= width
    assert "…" not in text
    for design in result(name).designs:
        for key, quantity in design.task.quantities.items():
            if quantity.free:
                value = design.values[key] * (1e3 if quantity.kind != "angle" else math.degrees(1.0))
                rows = [row for row in text.splitlines() if row.split()[:1] == [key]]
                shown = [float(word) for row in rows for word in re.findall(r"-?\d+\.?\d*(?:e[-+]\d+)?", row)]
                precision = 5e-4 if quantity.kind == "angle" else 1e-8
                assert any(each == pytest.approx(value, rel=1e-5, abs=precision) for each in shown), key


def table_of(text: str) -> dict[str, list[str]]:
    """Rows of the table of designs: values by name."""
    computed: dict[str, list[str]] = {}
    after = text[text.index("Designs, best first") :]
    for row in after[: after.index("Cognates") if "Cognates" in after else None].splitlines():
        cells = re.split(r"\s{2,}", row.strip())
        computed.setdefault(cells[0], []).extend(cells[1:])
    return computed


@pytest.mark.parametrize("width", [80, 120])
def test_designs_are_columns_with_unbroken_numbers(width):
    computed = result("cognates").designs
    rows = table_of(printed(result("cognates"), width))
    for name in ("crank", "P.across", "A.x"):
        assert [float(cell) for cell in rows[name][1:]] == pytest.approx([d.values[name] * 1e3 for d in computed], rel=1e-5)
    assert [float(cell) for cell in rows["sum of squares"][1:]] == pytest.approx([d.objective * 1e6 for d in computed], rel=1e-4)
    assert rows["same curve as"] == ["cognate of 1"]
    assert rows["assembly"] == ["left", "right", "left"]
    assert "design 2" in printed(result("cognates"), width)


def test_text_wraps_before_numbers():
    text = printed(result("path"), 48)
    for cognate in result("path").best.cognates:
        lengths = [getattr(cognate.linkage, name) * 1e3 for name in ("crank", "coupler", "rocker", "frame")]
        shown = [float(cell) for cell in re.findall(r"\d+\.\d+", text[text.index("Cognates") :])]
        assert any(shown[k : k + 4] == pytest.approx(lengths, rel=1e-5) for k in range(len(shown) - 3))
    assert "crank-rocker" in text


def test_many_designs_are_split_into_blocks():
    one = result("exact").best
    several = outcome(*[replace(one, values={**one.values, "A.x": k * 1.25e-3}) for k in range(9)])
    text = printed(several, 80)
    rows = [row.split()[2:] for row in text[text.index("Designs, best first") :].splitlines() if row.split()[:1] == ["A.x"]]
    assert len(rows) > 1
    assert [float(cell) for row in rows for cell in row] == pytest.approx([1.25 * k for k in range(9)])
    assert max(len(row) for row in text.splitlines()) <= 80


def test_exact_designs_are_marked_in_the_table():
    one = result("exact").best
    several = outcome(one, replace(one, values={**one.values, "coupler": 0.084}, objective=1e-6))
    (row,) = (
        row for row in printed(several, 80).splitlines() if row.strip().startswith("sum of squares") and "exact" in row.split()
    )
    assert row.split()[3:5][1] == "exact"
    assert row.count("exact") == 1


def test_passed_bounds_share_a_row_and_failed_bounds_have_their_own():
    text = printed(result("path"), 80)
    assert "9 dimensions within bounds" in text
    assert "crank within its bounds" not in text
    count = len(result("path").best.validation.checks)
    assert f"Validation: {count} of {count} checks passed" in text
    long = made(path_raw(PLACED, closed=True), {**values_of(PLANTED), "coupler": 0.301}, ROUND)
    text = printed(outcome(nearest=long), 80)
    assert "FAIL" in text
    assert "coupler within its bounds" in text
    assert "8 dimensions within bounds" in text


@pytest.mark.parametrize(
    ("largest", "digits"), [(100.0, 3), (1.5, 3), (0.02, 5), (3e5, 2), (2e8, 0), (0.0, 3), (1e-9, 8), (99999.0, 3)]
)
def test_decimals_of_coordinates_follow_their_size(largest, digits):
    assert decimals(largest) == digits
