"""Pictures of an analysis show what they claim: drawn data against the analysis, shapes against kinematics, legible labels."""

from __future__ import annotations

import functools
import itertools
import math
import warnings
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.lines import Line2D
from matplotlib.patches import Polygon
from PIL import Image

import optlink
from optlink.dynamics.columns import MotionColumns
from optlink.linkage.motion import sweep
from optlink.linkage.vector2d import TURN
from optlink.presentation import style
from optlink.presentation.chart_mpl import pictures
from optlink.presentation.drawing import Sketch, merged_positions
from optlink.presentation.labels import Label, place_labels
from optlink.presentation.registry import view_of
from optlink.presentation.style import LettersNotDrawn
from optlink.presentation.views import analysis, analysis_charts
from optlink.presentation.views.analysis_charts import CycleCurves
from optlink.tasks.analyze import Analysis, analyze
from tests.tiers import mostly_slow

BAR = {"mass": "2 kg", "inertia": "uniform bar"}


def four_bar(crank: float, coupler: float, rocker: float, frame: float, unit: str = "mm", **more: object) -> dict:
    lengths = zip(("crank", "coupler", "rocker", "frame"), (crank, coupler, rocker, frame), strict=True)
    return {
        "title": "Four-bar",
        "gravity": "9.81 m/s^2",
        "mechanism": {"type": "four-bar", **{name: f"{length} {unit}" for name, length in lengths}},
        "bodies": dict.fromkeys(("crank", "coupler", "rocker"), BAR),
        "drive": {"speed": "60 rpm", "start": "30 deg"},
        **more,
    }


ROD = {
    "title": "Rod through a swinging block",
    "mechanism": {
        "type": "dyads",
        "ground": {"A": ["0 mm", "0 mm"], "D": ["200 mm", "0 mm"]},
        "links": {
            "crank": {"joints": ["A", "B"], "length": "60 mm"},
            "rod": {"joints": ["B", "E"], "length": "300 mm"},
            "block": {"joints": ["D"]},
        },
        "guides": {"G": {"slider": "rod", "on": "block"}},
        "assembly": {"G": "backward"},
    },
}
YOKE = {
    "title": "Scotch yoke",
    "mechanism": {
        "type": "dyads",
        "ground": {"A": ["0 mm", "0 mm"]},
        "links": {"crank": {"joints": ["A", "B"], "length": "40 mm"}, "block": {"joints": ["B"]}, "yoke": {"joints": ["Y"]}},
        "guides": {
            "S": {"slider": "block", "on": "yoke", "direction": "90 deg"},
            "R": {"slider": "yoke", "on": "frame", "through": "A"},
        },
    },
    "bodies": {"yoke": {"mass": "3 kg"}},
    "loads": {"drag": {"on": "yoke", "force": "50 N", "acts": "opposing"}},
    "drive": {"speed": "100 rpm"},
}
LEG = {
    "title": "Coupler point",
    "mechanism": {
        "type": "dyads",
        "ground": {"A": ["0 mm", "0 mm"], "D": ["150 mm", "0 mm"]},
        "links": {
            "crank": {"joints": ["A", "B"], "length": "40 mm"},
            "coupler": {"joints": ["B", "C"], "length": "120 mm", "points": {"P": ["60 mm", "70 mm"]}},
            "rocker": {"joints": ["D", "C"], "length": "80 mm"},
        },
        "assembly": {"C": "left of B-D"},
    },
    "bodies": {"rocker": BAR},
}


@functools.cache
def analysed(name: str) -> Analysis:
    """The machines of these tests, each analysed once."""
    made = {
        "six-bar": lambda: analyze(optlink.load("six-bar")),
        "shaper": lambda: analyze(optlink.load("shaper")),
        "clockwise": lambda: analyze(optlink.load("six-bar"), speed=-10.0),
        "partial": lambda: analyze(optlink.read(four_bar(300, 250, 280, 500))),
        "singular": lambda: analyze(optlink.read(four_bar(100, 300, 100, 300))),
        "yoke": lambda: analyze(optlink.read(YOKE)),
        "rod": lambda: analyze(optlink.read(ROD)),
        "leg": lambda: analyze(optlink.read(LEG)),
        "tiny": lambda: analyze(optlink.read(four_bar(1, 4.1, 2.3, 5, "um", bodies={"rocker": {**BAR, "mass": "1e-15 kg"}}))),
        "huge": lambda: analyze(optlink.read(four_bar(1000, 4100, 2300, 5000, "m"))),
        "no masses": lambda: analyze(optlink.load("crank-rocker")),
    }
    return made[name]()


@functools.cache
def course(name: str) -> CycleCurves:
    return CycleCurves(analysed(name))


@functools.cache
def picture(name: str, kind: str):
    if kind == "mechanism":
        return analysis.mechanism(course(name))
    return pictures([chart for chart in charts(name) if chart.file == kind]).get(kind)


@functools.cache
def charts(name: str):
    return analysis.charts(course(name))


def test_force_curves_are_distinguishable_without_colours():
    several = [chart for chart in charts("six-bar") if chart.file in ("reactions", "shaking", "torque")]
    looks = [[(one.dash, round(one.width, 2)) for one in panel.traces if one.name] for chart in several for panel in chart.panels]
    assert max(map(len, looks)) >= 7
    assert [look for look in looks if len(set(look)) < len(look)] == []


KINDS = ("mechanism", "motion", "bodies", "torque", "reactions", "guides", "work", "shaking")


def titles(figure) -> list[str]:
    """Titles of the parts of a picture."""
    return [part.get_suptitle() for part in (figure, *figure.subfigs, *(own for row in figure.subfigs for own in row.subfigs))]


def legend(figure) -> list[str]:
    return [text.get_text() for axes in figure.axes if axes.get_legend() for text in axes.get_legend().get_texts()]


def by_gid(figure, gid: str) -> list:
    return [artist for axes in figure.axes for artist in axes.get_children() if artist.get_gid() == gid]


def drawn(figure, column: str) -> np.ndarray:
    """The (x, y) that stand for a column, gaps included."""
    (line,) = by_gid(figure, column)
    return np.asarray(line.get_xydata(), dtype=float)


def at_rows(xy: np.ndarray, degrees: np.ndarray) -> np.ndarray:
    """Drawn values at the crank angles of the table."""
    known = xy[np.isfinite(xy[:, 0])]
    places = np.argmin(np.abs(known[:, 0][None, :] - degrees[:, None]), axis=1)
    np.testing.assert_allclose(known[places, 0], degrees, atol=1e-9)
    return known[places, 1]


MACHINES = ("six-bar", "shaper", "clockwise", "partial")
EVERY = {
    (name, kind) for name in MACHINES for kind in KINDS if not (name == "partial" and kind == "guides")
}  # a four-bar has no guides


# --- curves --------------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "kind", "column", "unit"),
    [
        ("six-bar", "torque", "input.torque_Nm", 1.0),
        ("six-bar", "torque", "input.torque_load_Nm", 1.0),
        ("six-bar", "motion", "slider.s_m", 1e3),
        ("six-bar", "bodies", "link5.omega_rad_s", 1.0),
        ("shaper", "bodies", "coupler.alpha_rad_s2", 1.0),
        ("partial", "bodies", "rocker.omega_rad_s", 1.0),
        ("six-bar", "motion", "slider.a_m_s2", 1.0),
        ("six-bar", "reactions", "A.fx_N", 1.0),
        ("six-bar", "guides", "F.normal_N", 1.0),
        ("six-bar", "work", "input.work_J", 1.0),
        ("six-bar", "work", "energy.kinetic_J", 1.0),
        ("six-bar", "shaking", "frame.shaking_moment_Nm", 1.0),
        ("shaper", "guides", "G.normal_N", 1e-3),
        ("shaper", "reactions", "A.fy_N", 1e-3),
        ("clockwise", "torque", "input.torque_Nm", 1.0),
        ("clockwise", "work", "input.work_J", 1.0),
        ("partial", "motion", "rocker.omega_rad_s", 1.0),
        ("partial", "torque", "input.torque_Nm", 1.0),
    ],
)
def test_curves_pass_through_every_row_of_the_table(name, kind, column, unit):
    result = analysed(name)
    rows = ~np.any(np.abs(np.radians(result["crank_angle_deg"])[:, None] - result.jumps) < 1e-6, axis=1)
    values = at_rows(drawn(picture(name, kind), column), result["crank_angle_deg"][rows])
    expected = result[column][rows] * unit
    np.testing.assert_allclose(values, expected, rtol=1e-9, atol=1e-9 * np.max(np.abs(expected)))


@pytest.mark.parametrize("points", [7, pytest.param(30_000, marks=pytest.mark.slow)])
def test_curves_are_smooth_for_any_table_step(points):
    """A coarse table makes no polygon, a fine one no heavy file."""
    coarse = CycleCurves(analyze(optlink.load("six-bar"), points=points))
    x, y = coarse.line("input.torque_Nm")
    assert 700 < len(x) < 3000
    np.testing.assert_allclose(np.interp(100.0, x, y), np.interp(100.0, *course("six-bar").line("input.torque_Nm")), rtol=1e-4)


@pytest.mark.slow
def test_torque_components_add_up_and_the_mean_is_the_work_per_revolution():
    figure = picture("shaper", "torque")
    parts = [drawn(figure, f"input.torque_{part}_Nm")[:, 1] for part in ("inertia", "gravity", "load")]
    np.testing.assert_allclose(np.sum(parts, axis=0), drawn(figure, "input.torque_Nm")[:, 1], atol=1e-6)
    (mean,) = by_gid(figure, "mean")
    assert mean.get_ydata()[0] == pytest.approx(3207.27272727 / TURN)
    assert "mean 510.5 N·m" in legend(figure)


def test_extremes_are_marked_at_their_exact_crank_angles():
    for name, sign in (("six-bar", 1.0), ("clockwise", -1.0)):
        figure = picture(name, "torque")
        marks = sorted((marker.get_xydata()[0] for marker in by_gid(figure, "extreme input.torque_Nm")), key=lambda xy: xy[1])
        extreme = analysed(name).extremes["input.torque_Nm"]
        for mark, at, value in zip(marks, (extreme.least_at, extreme.largest_at), (extreme.least, extreme.largest), strict=True):
            assert math.remainder(mark[0] - math.degrees(at), 360.0) == pytest.approx(0.0, abs=1e-6)
            assert mark[1] == pytest.approx(value)
        if sign > 0.0:
            words = [text.get_text() for text in figure.axes[0].texts]
            assert words == ["−320.05 N·m at 356.31°", "278.83 N·m at 67.02°"]
        curve = drawn(figure, "input.torque_Nm")
        assert np.min(np.abs(curve[:, 0] - marks[0][0])) < 1e-9  # the curve has that very point
        assert np.nanmin(curve[:, 1]) == pytest.approx(marks[0][1])


@pytest.mark.slow
@pytest.mark.parametrize("speed", [1.0, -1.0])
def test_the_work_of_a_whole_cycle_is_marked_at_its_end(speed):
    """Work does not repeat: its largest value at the end of the cycle does not lie at the start."""
    result = analyze(optlink.load("shaper"), speed=speed)
    extreme = result.extremes["input.work_J"]
    assert (extreme.least, extreme.least_at) == (0.0, 0.0)
    assert (extreme.largest, extreme.largest_at) == (pytest.approx(result.work), pytest.approx(speed * TURN))
    assert result.to_dict()["extremes"]["input.work_J"]["max_at_deg"] == pytest.approx(speed * 360.0)
    figure = pictures(analysis_charts.work(CycleCurves(result)))["work"]
    curve = drawn(figure, "input.work_J")
    for marker in by_gid(figure, "extreme input.work_J"):
        assert np.min(np.hypot(*((curve - marker.get_xydata()[0]) / [360.0, result.work]).T)) < 1e-9


def test_a_shaking_moment_of_rounding_is_not_drawn():
    """The shaking force of a Scotch yoke passes through the crank pivot."""
    figure = pictures(analysis_charts.shaking(CycleCurves(analyze(optlink.load("scotch-yoke")))))["shaking"]
    assert by_gid(figure, "frame.shaking_fx_N")
    assert not by_gid(figure, "frame.shaking_moment_Nm")
    assert not [words for words in titles(figure) if "crank pivot" in words]


def slopes(xy: np.ndarray) -> float:
    """The steepest finite piece of a curve, in heights of the curve per degree."""
    rises = np.diff(xy[:, 1])
    runs = np.abs(np.diff(xy[:, 0]))
    known = np.isfinite(rises) & np.isfinite(runs)
    return float(np.max(np.abs(rises[known]) / np.maximum(runs[known], 1e-3))) / float(np.nanmax(xy[:, 1]) - np.nanmin(xy[:, 1]))


def test_jumps_of_loads_are_gaps_between_one_sided_values():
    result, figure = analysed("shaper"), picture("shaper", "guides")
    curve = drawn(figure, "F.normal_N")
    assert len(result.jumps) == 2
    for jump in result.jumps:
        (gap,) = np.flatnonzero(np.isnan(curve[:, 0]) & (np.abs(np.roll(curve[:, 0], 1) - math.degrees(jump)) < 1e-9))
        for side, place in ((-1, gap - 1), (1, gap + 1)):
            one_sided = MotionColumns(result.machine.moving(np.array([jump]), result.speed, side=side))["F.normal_N"][0]
            assert curve[place] == pytest.approx([math.degrees(jump), one_sided], rel=1e-9)
    assert slopes(curve) < 0.2
    assert len(by_gid(figure, "jump F.normal_N")) == 2
    assert by_gid(picture("shaper", "torque"), "jump input.torque_Nm") == []  # at a dead centre the torque does not jump


def test_a_jump_drawn_as_a_slope_is_detected():
    blind = CycleCurves(replace(analysed("shaper"), jumps=np.empty(0)))
    x, y = blind.line("F.normal_N")
    assert slopes(np.stack([x, y], axis=-1)) > 0.2


def test_time_increases_to_the_right_for_a_clockwise_crank():
    for name, way in (("six-bar", 1.0), ("clockwise", -1.0)):
        axes = picture(name, "torque").axes[0]
        first, last = axes.get_xlim()
        assert first == pytest.approx(62.0)
        assert last - first == pytest.approx(360.0 * way)
        curve = drawn(picture(name, "torque"), "input.torque_Nm")
        assert np.all(way * np.diff(curve[:, 0]) >= 0.0)
    assert "clockwise" in picture("clockwise", "torque").axes[0].get_xlabel()


@pytest.mark.slow
def test_dead_centres_and_the_quick_stroke():
    result, figure = analysed("shaper"), picture("shaper", "motion")
    column = figure.axes[3]  # of the ram
    assert any("stroke 545.45 mm, time ratio 1.8588" in title for title in titles(figure))
    centres = sorted(line.get_xdata()[0] for line in column.get_lines() if line.get_gid() == "dead centre")
    assert centres == pytest.approx(sorted(math.degrees(at) for at in result.strokes["ram"].dead_centres))
    (shade,) = (patch for patch in column.patches if patch.get_gid() == "shade")
    assert (shade.get_x(), shade.get_x() + shade.get_width()) == pytest.approx(centres)  # 207 ... 333 deg, the quicker one
    assert "quick 125.93°, slow 234.07°" in legend(figure)
    assert legend(figure).count("dead centre") == 2  # once for each output
    wrapped = [patch for patch in picture("six-bar", "motion").axes[0].patches if patch.get_gid() == "shade"]
    assert sum(patch.get_width() for patch in wrapped) == pytest.approx(
        360.0 / (1.0 + analysed("six-bar").strokes["slider"].time_ratio)
    )


@pytest.mark.slow
def test_without_sliders_the_last_swinging_body_is_shown():
    figure = picture("partial", "motion")
    assert len(figure.axes) == 3
    assert "rocker: swing 115.5" in figure.get_suptitle()
    marks = [marker.get_xydata()[0] for marker in by_gid(figure, "extreme rocker.angle_rad")]
    curve = drawn(figure, "rocker.angle_rad")
    for x, y in marks:  # on the curve, not a turn away
        assert np.min(np.hypot(curve[:, 0] - x, curve[:, 1] - y)) < 1e-6


@pytest.mark.slow
def test_all_reactions_with_their_largest_amounts():
    result, figure = analysed("six-bar"), picture("six-bar", "reactions")
    curve = drawn(figure, "C.link5.f_N")
    np.testing.assert_allclose(
        at_rows(curve, result["crank_angle_deg"]), np.hypot(result["C.link5.fx_N"], result["C.link5.fy_N"]), rtol=1e-9
    )
    words = legend(figure)
    assert "D:  2109.7 N at 18.19°" in words
    assert "C on link3:  2090.6 N at 17.96°" in words
    assert "A, B:  14.848 kN at 332.96°" in legend(picture("shaper", "reactions"))  # a massless crank hands on what it gets


@pytest.mark.slow
def test_hodograph_is_the_force_over_the_force_on_equal_scales():
    result, figure = analysed("six-bar"), picture("six-bar", "reactions")
    path = drawn(figure, "hodograph A.fx_N")
    for x, y in zip(result["A.fx_N"][::10], result["A.fy_N"][::10], strict=True):
        assert np.min(np.hypot(path[:, 0] - x, path[:, 1] - y)) < 1e-9 * 1633.0
    axes = next(axes for axes in figure.axes if any(line.get_gid() == "hodograph A.fx_N" for line in axes.get_lines()))
    assert axes.get_aspect() == 1.0
    (low, high), (bottom, top) = axes.get_xlim(), axes.get_ylim()
    assert low < path[:, 0].min() < path[:, 0].max() < high
    assert bottom < path[:, 1].min() < path[:, 1].max() < top
    (mark,) = by_gid(picture("six-bar", "shaking"), "largest")
    fine = MotionColumns(result.machine.moving(np.linspace(0.0, TURN, 7201), result.speed))
    most = np.hypot(fine["frame.shaking_fx_N"], fine["frame.shaking_fy_N"]).max()
    assert np.hypot(*mark.get_xydata()[0]) == pytest.approx(most, rel=1e-6)


# --- the mechanism ------------------------------------------------------------------------------------------------------------


def panels(name: str) -> dict[str, object]:
    """Axes of the positions by the first line of their title."""
    return {axes.get_title().splitlines()[0]: axes for axes in picture(name, "mechanism").axes}


def bodies_in(axes) -> dict[str, list]:
    """Lines and outlines of each body."""
    result: dict[str, list] = {}
    for artist in axes.get_children():
        if isinstance(artist, Line2D | Polygon) and artist.get_gid() and artist.get_zorder() < 3.5:
            result.setdefault(artist.get_gid(), []).append(artist)
    return result


@pytest.mark.slow
def test_characteristic_positions_are_drawn():
    extreme = analysed("six-bar").extremes["input.torque_Nm"]
    named = analysis.positions(course("six-bar"))
    assert list(named) == ["start", "dead centre 1 of slider", "dead centre 2 of slider", "largest torque", "least torque"]
    assert [math.degrees(at) for at in named.values()] == pytest.approx(
        [62.0, 200.3641, 389.6863, math.degrees(extreme.largest_at), math.degrees(extreme.least_at)], abs=1e-4
    )
    assert "φ 67.02°   s 706.10 mm   M 278.83 N·m" in panels("six-bar")["largest torque"].get_title()
    assert "M " not in panels("shaper")["dead centre 1 of ram"].get_title()  # there the load jumps, no one value is right
    partial = analysis.positions(course("partial"))
    assert [name.split(" = ")[0] for name in partial][:3] == ["start of the range", "middle of the range", "end of the range"]


@pytest.mark.parametrize(
    "name",
    mostly_slow(("six-bar", "shaper", "clockwise", "partial", "yoke", "rod", "leg"), "shaper"),
)
def test_every_body_is_drawn_once_in_every_position_and_inside_the_limits(name):
    result = analysed(name)
    sketch = Sketch(sweep(result.machine.mechanism, result.machine.sizes, course(name).angles), result.machine)
    shown = list(picture(name, "mechanism").axes)
    assert len({(axes.get_xlim(), axes.get_ylim()) for axes in shown}) == 1  # one scale
    for axes in shown:
        computed = bodies_in(axes)
        for body in result.machine.mechanism.bodies:
            assert len(computed[body]) == len(sketch.parts[body]) > 0, body
        for artist in axes.get_children():
            if isinstance(artist, Line2D | Polygon) and artist.get_transform() == axes.transData:
                xy = np.asarray(artist.get_xydata() if isinstance(artist, Line2D) else artist.get_xy(), dtype=float)
                xy = xy[np.all(np.isfinite(xy), axis=1)]
                for values, (low, high) in zip(xy.T, (axes.get_xlim(), axes.get_ylim()), strict=True):
                    assert np.all((values >= low) & (values <= high)), artist.get_gid()
    low, high = np.array(sketch.limits).T
    for body, parts in sketch.parts.items():  # and in every position of the film
        for part in parts:
            xy = sketch.placed(sketch.motion, body, part.outline)
            assert np.all((xy > low) & (xy < high)), body


def bars(axes, gid: str) -> list[float]:
    return [float(np.linalg.norm(np.ptp(line.get_xydata(), axis=0))) for line in bodies_in(axes)[gid] if isinstance(line, Line2D)]


def check_lengths(axes) -> None:
    lengths = {"crank": 400.0, "link2": 1200.0, "link3": 800.0, "link5": 1200.0}
    assert {gid: bars(axes, gid) for gid in lengths} == {gid: [pytest.approx(length)] for gid, length in lengths.items()}


@pytest.mark.slow
def test_drawn_links_keep_their_length_and_pins_follow_the_motion():
    for title, at in analysis.positions(course("six-bar")).items():
        axes = panels("six-bar")[title]
        check_lengths(axes)
        motion = sweep(analysed("six-bar").machine.mechanism, analysed("six-bar").machine.sizes, np.array([at]))
        drawn = {line.get_gid(): line.get_xydata() for line in axes.get_lines()}
        for name in analysed("six-bar").machine.mechanism.pins:
            np.testing.assert_allclose(drawn[name], motion.position(name) * 1e3, atol=1e-9)


def test_a_wrong_length_is_detected():
    result = analysed("six-bar")
    wrong = {**result.machine.sizes, "link3.length": 0.81}
    motion = sweep(result.machine.mechanism, wrong, course("six-bar").angles)
    figure = style.figure(4.0, 4.0)
    axes = figure.subplots()
    Sketch(motion).pose(axes, motion)
    with pytest.raises(AssertionError):
        check_lengths(axes)


def contains(outline: np.ndarray, point: np.ndarray) -> bool:
    """Whether a point lies in a convex outline that runs counter-clockwise."""
    edges = np.roll(outline, -1, axis=0) - outline
    away = point - outline
    return bool(np.all(edges[:, 0] * away[:, 1] - edges[:, 1] * away[:, 0] >= -1e-9))


@pytest.mark.parametrize(
    ("name", "carrier", "slider", "joint"),
    [("shaper", "rocker", "block", "B"), ("yoke", "yoke", "block", "B"), ("rod", "rod", "block", "D")],
)
def test_a_block_stays_in_its_slot_over_the_whole_revolution(name, carrier, slider, joint):
    machine = analysed(name).machine
    sketch = Sketch(sweep(machine.mechanism, machine.sizes, course(name).angles), machine)
    pins = sketch.position(sketch.motion, joint)
    (block,) = (part for part in sketch.parts[slider] if part.kind == "block")
    blocks = sketch.placed(sketch.motion, slider, block.outline)
    np.testing.assert_allclose(blocks.mean(axis=1), pins, atol=1e-6)
    if name == "rod":  # the rod is drawn as a rod, long enough to reach through
        (bar,) = (part for part in sketch.parts[carrier] if part.kind == "bar")
        ends = sketch.placed(sketch.motion, carrier, bar.outline)
        along = np.diff(ends, axis=1)[:, 0]
        share = np.sum((pins - ends[:, 0]) * along, axis=1) / np.sum(along * along, axis=1)
        assert np.all((share > 0.0) & (share < 1.0))
    else:
        (slot,) = (part for part in sketch.parts[carrier] if part.kind == "slot")
        slots = sketch.placed(sketch.motion, carrier, slot.outline)
        assert all(contains(outline, corner) for outline, corners in zip(slots, blocks, strict=True) for corner in corners)


def test_rails_on_the_frame_reach_as_far_as_the_slider():
    axes = panels("six-bar")["start"]
    rails = [line.get_xydata() for line in axes.get_lines() if line.get_linewidth() == 1.3 and line.get_gid() is None]
    (rail,) = (xy for xy in rails if len(xy) == 2)
    assert rail[:, 0].min() < (1.5 + 0.417261753) * 1e3 < (1.5 + 0.791165911) * 1e3 < rail[:, 0].max()
    assert rail[0, 1] == rail[1, 1] < 0.0  # below the blocks, away from the links


@pytest.mark.slow
def test_a_coupler_point_makes_a_plate_and_is_traced():
    result = analysed("leg")
    axes = panels("leg")["start"]
    (plate,) = (artist for artist in bodies_in(axes)["coupler"] if isinstance(artist, Polygon))
    corners = sorted(map(tuple, np.round(plate.get_xy()[:-1], 6)))
    motion = sweep(result.machine.mechanism, result.machine.sizes, np.array([course("leg").start]))
    np.testing.assert_allclose(corners, sorted(tuple(motion.position(name)[0] * 1e3) for name in "BCP"), atol=1e-5)
    (trace,) = (line for line in axes.get_lines() if line.get_gid() == "trace P")
    np.testing.assert_allclose(trace.get_xydata()[:, 0], course("leg")["P.x_m"] * 1e3, atol=1e-9)
    centroids = [line for line in axes.get_lines() if line.get_gid() == "centroid rocker"]
    middle = 0.5 * (motion.position("C")[0] + motion.position("D")[0]) * 1e3
    assert centroids[0].get_xydata()[0] == pytest.approx(middle)
    assert not any(line.get_gid() == "centroid crank" for line in axes.get_lines())  # it has no mass


def test_velocity_arrows_are_to_their_scale():
    axes = next(axes for title, axes in panels("six-bar").items() if title.startswith("velocities"))
    arrows = {patch.get_gid(): np.array(patch._posA_posB) for patch in axes.patches if "FancyArrow" in type(patch).__name__}
    assert set(arrows) == {"velocity B", "velocity C", "velocity E", "scale"}
    (label,) = (text.get_text() for text in axes.texts if "m/s" in text.get_text())
    per_speed = np.linalg.norm(np.diff(arrows["scale"], axis=0)) / float(label.split()[0])
    at = analysed("six-bar").extremes["input.torque_Nm"].largest_at
    motion = sweep(analysed("six-bar").machine.mechanism, analysed("six-bar").machine.sizes, np.array([at]), 10.0)
    for point in "BCE":
        begin, end = arrows[f"velocity {point}"]
        np.testing.assert_allclose((end - begin) / per_speed, motion.velocity(point)[0], rtol=1e-6, atol=1e-9)


# --- displayed texts ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("name", "kind"), mostly_slow(sorted(EVERY), *(one for one in sorted(EVERY) if one[0] == "six-bar")))
def test_labels_stay_in_their_axes_and_off_one_another(name, kind):
    figure = picture(name, kind)
    assert figure is not None
    with style.apply_style():  # as `save` does
        figure.draw_without_rendering()
    edge = figure.bbox
    for axes in figure.axes:
        area = axes.get_window_extent().padded(1.5)
        boxes = []
        for text in axes.texts:
            if text.get_text() and text.get_zorder() == 9:  # those that were placed
                box = text.get_window_extent()
                assert box.x0 >= area.x0, text
                assert box.x1 <= area.x1, text
                assert box.y0 >= area.y0, text
                assert box.y1 <= area.y1, text
                boxes.append(box)
        for one, other in itertools.combinations(boxes, 2):
            assert not one.overlaps(other)
        for text in (axes.title, axes.xaxis.label, axes.yaxis.label):
            if text.get_text():
                box = text.get_window_extent()
                assert edge.x0 - 1.0 <= box.x0 < box.x1 <= edge.x1 + 1.0, text
                assert edge.y0 - 1.0 <= box.y0 < box.y1 <= edge.y1 + 1.0, text


def test_labels_avoid_curves_and_stay_inside_the_axes():
    """In a corner with a line through every near place: the label keeps inside, clear, and a thin line leads to it."""
    figure = style.figure(4.0, 3.0)
    axes = figure.subplots()
    axes.set(xlim=(0.0, 1.0), ylim=(0.0, 1.0))
    axes.plot([0.95, 0.95], [0.0, 1.0], linewidth=3.0)
    axes.plot([0.6, 1.0], [0.95, 0.95], linewidth=3.0)
    label = Label(axes, (1.0, 1.0), "a label as long as this")
    place_labels(figure, [label, replace(label, text="another of them"), replace(label, at=(math.nan, 0.0))])
    assert len(axes.texts) == 2  # what has no place gets no label
    area, (one, other) = axes.get_window_extent(), (text.get_window_extent() for text in axes.texts)
    assert not one.overlaps(other)
    for box in (one, other):
        assert area.x0 <= box.x0 < box.x1 <= area.x1 + 1.0
        assert area.y0 <= box.y0 < box.y1 <= area.y1 + 1.0
        assert box.x1 < axes.transData.transform((0.95, 0.0))[0] or box.x0 > axes.transData.transform((0.95, 0.0))[0]
    assert len([line for line in axes.get_lines() if line.get_gid() == "leader"]) == 2


@pytest.mark.parametrize(
    ("largest", "unit", "shown", "factor"),
    [
        (2.9, "m", "mm", 1e3),
        (60.0, "m", "m", 1.0),
        (0.5, "m", "mm", 1e3),
        (5e-6, "m", "µm", 1e6),
        (6e4, "m", "km", 1e-3),
        (1633.0, "N", "N", 1.0),
        (14848.0, "N", "kN", 1e-3),
        (0.002, "N m", "mN·m", 1e3),
        (0.0, "N", "N", 1.0),
        (math.nan, "J", "J", 1.0),
        (2.5, "m/s", "m/s", 1.0),
        (0.1, "m/s²", "mm/s²", 1e3),
        (1.0, "deg", "deg", 180.0 / math.pi),
        (1e-30, "N", "aN", 1e18),
        (1e20, "N", "GN", 1e-9),
    ],
)
def test_units_suit_the_size(largest, unit, shown, factor):
    result = style.scale(largest, unit)
    assert (result.unit, result.factor) == (shown, pytest.approx(factor))
    assert style.scale(-largest, unit) == result


def test_numbers_have_five_digits_and_a_minus_sign():
    assert style.scale(1105.74, "N m").text(-25.85165) == "−25.9 N·m"
    assert style.scale(278.83, "N m").text(278.8344391) == "278.83 N·m"
    assert style.scale(10.0, "N").text(-1e-12) == "0.000 N"
    assert style.scale(1.0, "deg").text(math.pi / 3.0) == "60.00°"
    assert style.scale(10.0, "N").text(66167.971) == "66168 N"  # beyond what is shown
    assert style.scale(10.0, "N").text(9e13) == "9.000e+13 N"


@pytest.mark.slow
def test_axes_are_labelled_in_the_unit_that_is_drawn():
    for name, unit in (("six-bar", "mm"), ("tiny", "µm"), ("huge", "km")):
        factor = style.scale({"six-bar": 2.9, "tiny": 5e-6, "huge": 6e3}[name], "m").factor
        axes = panels(name)["start"]
        assert axes.get_xlabel() == f"x [{unit}]"
        assert bars(axes, "crank") == [pytest.approx({"six-bar": 0.4, "tiny": 1e-6, "huge": 1e3}[name] * factor)]
    assert picture("tiny", "reactions").axes[0].get_ylabel() == "force [fN]"
    assert picture("huge", "torque").axes[0].get_ylabel() == "torque on crank [MN·m]"


def test_titles_accept_dollar_signs_and_foreign_letters(tmp_path):
    raw = four_bar(100, 412.865, 232.246, 500, title="Costs $5 or $6_{x}: 连杆机构 🙂 " + "and so on " * 15)
    strange = CycleCurves(analyze(optlink.read(raw)))
    figure = pictures(analysis_charts.torque(strange))["torque"]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", LettersNotDrawn)  # a machine without such fonts
        style.save(figure, tmp_path / "torque.png")  # no warning of matplotlib
    assert "$5 or $6_{x}" in figure.get_suptitle()
    assert len(figure.get_suptitle().splitlines()) > 2
    assert figure._suptitle.get_parse_math() is False


def test_every_body_that_turns_unevenly_is_drawn_with_its_extremes():
    """In the colours of the drawing; a block has the angular velocity of its rocker, and a slider has none."""
    speeds, _ = pictures(analysis_charts.bodies(course("shaper")))["bodies"].axes
    result = analysed("shaper")
    texts = [text.get_text() for text in speeds.get_legend().get_texts()]
    assert [text.partition(":")[0] for text in texts] == ["block, rocker", "coupler"]
    low, high = (np.max(sign * result["coupler.omega_rad_s"]) for sign in (-1.0, 1.0))
    numbers = texts[1].partition(":")[2].removesuffix(" rad/s").replace("−", "-").split(" to ")
    np.testing.assert_allclose([float(number) for number in numbers], [-low, high], rtol=1e-3)
    (curve,) = by_gid(picture("shaper", "bodies"), "coupler.omega_rad_s")
    sketch = Sketch(sweep(result.machine.mechanism, result.machine.sizes, course("shaper").angles, result.speed), result.machine)
    assert curve.get_color() == sketch.colours["coupler"]


def test_bodies_that_slide_or_turn_alike_have_no_curves_of_their_own():
    assert analysis_charts.bodies(course("yoke")) == []  # block and yoke slide
    (chart,) = analysis_charts.bodies(course("rod"))
    assert [curve.name.partition(":")[0] for curve in chart.panels[0].traces] == ["rod, block"]


# --- what is left out, and what breaks down ------------------------------------------------------------------------------------


@pytest.mark.slow
def test_no_force_charts_without_forces(tmp_path):
    files = view_of("analysis").write(analysed("no masses"), tmp_path, film=True)
    assert [file.name for file in files] == [
        "result.json",
        "cycle.csv",
        "mechanism.png",
        "motion.png",
        "bodies.png",
        "motion.gif",
    ]
    assert {file.name for file in files} == {path.name for path in tmp_path.iterdir()}


def test_a_massless_four_bar_has_no_guide_or_shaking_charts():
    assert picture("partial", "guides") is None
    loaded = analyze(optlink.read({**YOKE, "bodies": {}}))
    assert analysis_charts.shaking(CycleCurves(loaded)) == []
    assert analysis_charts.guides(CycleCurves(loaded))


@pytest.mark.slow
def test_singular_positions_are_gaps_and_do_not_set_the_scale():
    result = analysed("singular")
    assert not result.valid
    curve = drawn(picture("singular", "reactions"), "A.f_N")
    for singular in result.singular:
        near = np.abs(curve[:, 0] - math.degrees(singular)) < 1e-7
        assert near.any()
        assert not np.any(np.isfinite(curve[near, 1]))
    axes = next(axes for axes in picture("singular", "reactions").axes if "amount" in axes.get_ylabel())
    assert "cut off" in axes.get_ylabel()
    assert axes.get_ylim()[1] < np.nanmax(curve[:, 1])


def test_rounding_errors_are_not_drawn_as_motion():
    """A crank alone turns evenly: its acceleration is a line at zero, without extremes."""
    alone = {
        "title": "Crank",
        "mechanism": {
            "type": "dyads",
            "ground": {"A": ["0 m", "0 m"]},
            "links": {"crank": {"joints": ["A", "B"], "length": "1 m"}},
        },
    }
    figure = pictures(analysis_charts.motion(CycleCurves(analyze(optlink.read(alone)))))["motion"]
    bottom = figure.axes[-1]
    assert not [line for line in bottom.get_lines() if str(line.get_gid()).startswith("extreme")]
    curve = drawn(figure, "crank.alpha_rad_s2")
    assert np.ptp(curve[:, 1]) < 1e-3 * np.ptp(bottom.get_ylim())


# --- film ----------------------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("name", ["six-bar", "partial"])
def test_film_is_smooth_small_and_does_not_flicker(name, tmp_path):
    if name == "six-bar":
        files = view_of("analysis").write(analysed(name), tmp_path, film=True)
        assert {file.name for file in files} == {path.name for path in tmp_path.iterdir()}
        assert {"torque.png", "reactions.png", "work.png", "shaking.png", "mechanism.png", "motion.png", "bodies.png"} <= {
            f.name for f in files
        }
        for file in files:
            if file.suffix == ".png":
                with Image.open(file) as image:
                    assert image.info["dpi"] == pytest.approx((150, 150), abs=0.1)
    else:
        style.save_film(analysis.frames(course(name)), tmp_path / "motion.gif")
    with Image.open(tmp_path / "motion.gif") as film:
        assert film.n_frames == 80
        assert film.info["duration"] == 40
        shown = []
        for k in range(film.n_frames):
            film.seek(k)
            shown.append(np.asarray(film.convert("RGB")))
    assert (tmp_path / "motion.gif").stat().st_size < 1.5e6
    stack = np.stack(shown)
    still = np.all(stack == stack[0], axis=(0, 3))
    assert np.all(still[:, :20])  # the names of the axes
    assert np.all(still[:20])  # the title
    assert 0.3 < still.mean() < 0.97
    assert tuple(stack[0, 0, 0]) == (255, 255, 255)
    changes = [np.any(a != b, axis=-1).mean() for a, b in itertools.pairwise([*stack, stack[0]])]
    assert all(change > 0.0 for change in changes)
    assert max(changes) < 3.0 * np.median(changes) + 0.01  # it also closes smoothly


def test_the_mark_runs_along_the_curve(monkeypatch):
    """Positions of the film and of its mark belong together, in the sense of the speed, and to and fro over a range."""
    caught = {}

    def catch(sketch, steps, curve, marks, title, *, more=None):
        caught["steps"], caught["marks"] = steps.crank_angle, marks
        return []

    monkeypatch.setattr(analysis, "film", catch)
    for name in ("six-bar", "clockwise", "partial"):
        analysis.frames(course(name), count=24)
        steps, marks = caught["steps"], caught["marks"]
        np.testing.assert_allclose(marks[:, 0], np.degrees(steps))
        record = MotionColumns(analysed(name).machine.moving(steps, analysed(name).speed))
        np.testing.assert_allclose(
            marks[:, 1], record["input.torque_Nm"], rtol=2e-2, atol=1e-3 * course(name).peak("input.torque_Nm")
        )
        turns = np.diff(steps)
        if name == "partial":
            assert steps[0] == pytest.approx(course(name).start)
            assert steps[12] == pytest.approx(course(name).end)
            np.testing.assert_allclose(steps[1:12], steps[:12:-1], atol=1e-12)
        else:
            np.testing.assert_allclose(turns, np.sign(analysed(name).speed) * TURN / 24)


def test_large_animations_drop_frames(tmp_path, monkeypatch):
    noise = np.random.default_rng(0)
    pictures = [noise.integers(0, 255, (20, 20, 3), dtype=np.uint8) for _ in range(80)]
    film = style.one_palette(pictures)
    style.save_film(film, tmp_path / "motion.gif")
    monkeypatch.setattr(style, "MAX_GIF_BYTES", 0.7 * (tmp_path / "motion.gif").stat().st_size)
    style.save_film(film, tmp_path / "motion.gif")
    with Image.open(tmp_path / "motion.gif") as film:
        assert film.n_frames == 40
        assert film.info["duration"] == 80


def test_the_palette_keeps_the_frequent_colours_exactly():
    plain = np.full((40, 40, 3), 255, dtype=np.uint8)
    plain[10:20, 10:20] = (192, 57, 43)
    plain[30, :, 0] = np.arange(40)
    (kept,) = style.one_palette([plain], colours=16)
    again = np.asarray(kept.convert("RGB"))
    assert tuple(again[0, 0]) == (255, 255, 255)
    assert tuple(again[15, 15]) == (192, 57, 43)
    assert np.max(np.abs(again.astype(int) - plain)) < 40


def test_positions_of_one_name_are_all_drawn():
    named = [("limit of x", 0.1), ("limit of x", 2.0), ("start", 2.0 + 2.0 * math.pi), ("limit of x", 0.1), ("limit of x", 3.0)]
    assert merged_positions(named) == {"limit of x": 0.1, "limit of x (2) = start": 2.0, "limit of x (3)": 3.0}
    assert len(merged_positions(named, periodic=False)) == 4
