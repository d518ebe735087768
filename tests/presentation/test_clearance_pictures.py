"""Pictures of machines with clearance agree with the simulation: drawn data, limits, panels, labels."""

from __future__ import annotations

import functools
import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.patches import Circle, FancyArrowPatch
from matplotlib.text import Text

import optlink
from optlink.clearance import control as closed_loop
from optlink.clearance.integration import Integration
from optlink.presentation.chart_mpl import pictures
from optlink.presentation.drawing import Sketch
from optlink.presentation.format import single_units
from optlink.presentation.registry import view_of
from optlink.presentation.views import clearance, clearance_joints, clearance_joints as magnified_joints, control_comparison
from optlink.presentation.views.revolutions import FULL, RevolutionCurves, fold, rough, round_below, runs
from optlink.tasks.clearance import simulate_clearance
from optlink.tasks.control_comparison import compare
from optlink.tasks.results.clearance import ClearanceSimulation

pytestmark = pytest.mark.slow  # simulations of many revolutions

GAP = {"clearance": "0.5 mm", "bearing_radius": "10 mm", "modulus": "207 GPa", "friction": 0.1}
BAR = {"mass": "1 kg", "inertia": "uniform bar"}


def slider_crank(*gaps: str, friction: float = 0.1, journal: str = "rod", size: float = 1.0, **more: object) -> dict:
    """The slider-crank of the literature, times a size, with clearance at these joints."""
    return {
        "title": "Slider-crank",
        "gravity": "9.81 m/s^2",
        "mechanism": {
            "type": "dyads",
            "ground": {"A": ["0 m", "0 m"]},
            "links": {
                "crank": {"joints": ["A", "B"], "length": f"{50 * size} mm"},
                "rod": {"joints": ["B", "C"], "length": f"{120 * size} mm"},
                "slider": {"joints": ["C"]},
            },
            "guides": {"G": {"slider": "slider", "on": "frame", "through": "A", "direction": "0 deg"}},
            "assembly": {"C": "forward"},
        },
        "bodies": {
            "crank": {"mass": "0.3 kg", "inertia": "1e-4 kg*m^2"},
            "rod": {"mass": "0.21 kg", "inertia": "2.5e-4 kg*m^2"},
            "slider": {"mass": "0.14 kg"},
        },
        "joints": {gap: {**GAP, "friction": friction, "journal": "crank" if gap in "AB" else journal} for gap in gaps},
        "drive": {"speed": "1200 rpm"},
        **more,
    }


def crank_rocker(*gaps: str, unit: str = "mm", lengths: tuple[float, ...] = (100, 400, 250, 500), **more: object) -> dict:
    sides = zip(("crank", "coupler", "rocker", "frame"), lengths, strict=True)
    return {
        "title": "Crank-rocker",
        "mechanism": {"type": "four-bar", **{name: f"{length} {unit}" for name, length in sides}},
        "bodies": dict.fromkeys(("crank", "coupler", "rocker"), BAR),
        "joints": dict.fromkeys(gaps, GAP),
        "drive": {"speed": "300 rpm", "start": "30 deg"},
        **more,
    }


SERVO = {"speed": "1200 rpm", "servo": {"bandwidth": "300 Hz", "damping": 0.7}}
SEED = 3
CONTROL = {"regularisation": "5 mm", "sample_time": "0.5 ms", "proportional": 0.1, "integral": 30.0, "limit": "5 deg"}
LONG = "A machine whose title goes on and on, so that no line of any picture holds it, and which has clearance in its joint"


def run(problem: dict, revolutions: int = 1, **how: object) -> ClearanceSimulation:
    how = {"points": 72, "check_predictability": False, "tolerance": 1e-7, **how}
    return simulate_clearance(optlink.read(problem), revolutions, **how)  # type: ignore[arg-type]


def stopped(after: float) -> ClearanceSimulation:
    """Interrupted by the user after so many revolutions."""
    advance = Integration.advance

    def limited(self: Integration, count: int):
        for block in advance(self, count):
            if block.time[0] > 0.05 * after:
                raise KeyboardInterrupt
            yield block

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Integration, "advance", limited)
        return run(slider_crank("C"), 20)


SOFT = slider_crank("C", drive={"speed": "10000 rpm"})
SOFT["joints"]["C"]["modulus"] = "0.1 GPa"
MACHINES = {
    "periodic": lambda: run(slider_crank("C"), 13, check_predictability=True),
    "chaotic": lambda: run(slider_crank("C", friction=0.0, drive={"speed": "5000 rpm"}), 8, check_predictability=True),
    "three gaps": lambda: run(slider_crank("A", "B", "C")),
    "four-bar": lambda: run(crank_rocker("C"), 2),
    "drag link": lambda: run(crank_rocker("B", lengths=(300, 200, 250, 100)), 2),
    "large": lambda: run(slider_crank("C", size=20.0, title=LONG, drive={"speed": "60 rpm"})),
    "clockwise": lambda: run(slider_crank("C", drive={"speed": "-1200 rpm", "start": "50 deg"}), 2),
    "fast": lambda: run(slider_crank("C", drive={"speed": "10000 rpm"})),
    "torque": lambda: run(slider_crank("C", drive={"speed": "600 rpm", "torque": "0.3 N*m", "initial_speed": "500 rpm"}), 2),
    "interrupted": lambda: stopped(2.4),
    "stalled": lambda: run(SOFT, 3, points=360),
}


@functools.cache
def simulated(name: str) -> ClearanceSimulation:
    return MACHINES[name]()


KINDS = ("mechanism", "displacement", "error", "orbit", "force", "impacts", "section", "torque", "energy")


def test_the_conclusion_separates_the_running_in_force() -> None:
    result = simulated("periodic")
    forces = result.per_revolution["C.normal_max_N"]
    last = float(np.max(forces[-int(result.figures["settled_revolutions"]) :]))
    assert float(np.max(forces)) > 2.0 * last
    with single_units():
        text = clearance.conclusion(result).partition("contact force reaches ")[2]
    assert float(text.split()[0]) == pytest.approx(last, rel=1e-3)
    assert float(text.partition("(")[2].split()[0]) == pytest.approx(float(np.max(forces)), rel=1e-3)
    assert text.endswith("while it runs in).")


def drawn(result: ClearanceSimulation) -> dict[str, Figure]:
    """Return the pictures of a simulation."""
    return pictures(clearance.charts(result))


@functools.cache
def all_pictures(name: str) -> dict[str, Figure | None]:
    return {**drawn(simulated(name)), "mechanism": clearance.VIEW.drawings["mechanism"](simulated(name))}


def picture(name: str, kind: str) -> Figure | None:
    return all_pictures(name).get(kind)


def shown(name: str, kind: str) -> Figure:
    figure = picture(name, kind)
    assert figure is not None
    return figure


def by_gid(figure: Figure, gid: str) -> list:
    return [artist for axes in figure.axes for artist in axes.get_children() if artist.get_gid() == gid]


def words(figure: Figure) -> str:
    """Everything that is written, titles with their lines joined."""
    return " ".join(" ".join(text.get_text() for text in figure.findobj(Text) if text.get_visible()).split())


# --- folding onto the crank angle --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_fold_breaks_where_a_revolution_ends(way: float) -> None:
    angle = way * np.arange(30.0, 1110.0, 7.0)
    x, y = fold(angle, np.sin(np.radians(angle)))
    assert np.nanmin(x) == 0.0
    assert np.nanmax(x) == FULL
    assert np.sum(np.isnan(x)) == 3 if way > 0.0 else 4
    known = np.isfinite(x)
    np.testing.assert_allclose(y[known], np.sin(np.radians(x[known])), atol=4e-3)  # chords at the borders
    steps = np.diff(x)
    assert np.all(way * steps[np.isfinite(steps)] >= 0.0)


def test_fold_subtracts_full_turns_of_rotating_outputs() -> None:
    angle = np.arange(1.0, 1081.0)
    x, y = fold(angle, np.radians(angle), 2.0 * math.pi)
    np.testing.assert_allclose(y, np.radians(x), atol=1e-12)


def test_small_helpers() -> None:
    assert runs(np.array([True, False, True, True])) == [(0, 0), (2, 3)]
    assert [round_below(value) for value in (0.0, 7.9, 1.0, 23.0, math.inf)] == [0.0, 6.0, 1.0, 20.0, 0.0]
    assert rough(1.23456e-5, "m") == "12.35 µm"
    assert rough(math.radians(0.123456), "deg") == "0.1235°"


def test_rows_are_assigned_to_revolutions() -> None:
    turns = RevolutionCurves(simulated("periodic"))
    assert (turns.points, turns.kept, turns.begin, turns.shown) == (72, 13, 6, 8)
    assert turns.counted == "revolutions 6 to 13"
    assert turns.rows(1) == slice(12 * 72 - 1, 13 * 72)
    assert turns.span(3) == "revolutions 11 to 13"
    assert turns.rms == simulated("periodic").figures["rms_m"]
    early = RevolutionCurves(simulated("interrupted"))
    assert (early.kept, early.begin, early.shown, early.whole, early.broken) == (3, 1, 3, 144, True)
    assert early.span(1) == "the last revolution"
    assert early.rms == early.result.figures["rms_from_start_m"]
    assert math.isclose(RevolutionCurves(simulated("drag link")).advance, 2.0 * math.pi)
    assert RevolutionCurves(simulated("four-bar")).advance == 0.0


# --- every picture of every machine ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", MACHINES)
def test_every_chart_is_drawn_with_units(name: str) -> None:
    for kind in KINDS:
        figure = picture(name, kind)
        if figure is None:
            assert {"impacts": not simulated(name).impacts, "error": name == "stalled", "section": name == "stalled"}[kind]
            continue
        figure.draw_without_rendering()
        for axes in figure.axes:
            for label in (axes.get_xlabel(), axes.get_ylabel()):
                assert not label or "[" in label or label in ("revolution", "revolutions since the start", "imbalance / largest")
            below = axes.xaxis.label.get_window_extent()
            assert not axes.get_xlabel() or not any(below.overlaps(legend.get_window_extent()) for legend in figure.legends)
        width = figure.get_figwidth() * figure.dpi
        for text in (figure._suptitle, *(legend for legend in figure.legends)):
            box = text.get_window_extent()
            assert box.x0 >= -1.0
            assert box.x1 <= width + 1.0


def test_without_rows_there_are_no_pictures(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def never(self: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(closed_loop.ClosedLoop, "turn", never)
    result = run(slider_crank("C"), 3)
    assert result.revolutions == 0
    assert [path.name for path in view_of("clearance").write(result, tmp_path)] == ["result.json"]
    assert control_comparison.compensation({"none": result}) == []


def test_all_files_are_written(tmp_path: Path) -> None:
    result = simulated("interrupted")
    written = view_of("clearance").write(result, tmp_path)
    assert {path.name for path in written} == {
        "result.json",
        "play.csv",
        *(f"{kind}.png" for kind in KINDS),
    }
    assert all(path.stat().st_size > 0 for path in written)
    assert json.loads((tmp_path / "result.json").read_text(encoding="utf-8"))["status"] == "interrupted"
    lines = (tmp_path / "play.csv").read_text(encoding="utf-8").splitlines()
    assert lines[0].split(",")[:2] == ["time_s", "crank_angle_deg"]
    assert len(lines) == 1 + len(result["time_s"])
    assert 2 * 72 < len(result["time_s"]) < 3 * 72
    assert "interrupted after 2 revolutions" in words(shown("interrupted", "error"))


# --- what they show ------------------------------------------------------------------------------------------------------------


def test_displacement() -> None:
    result, figure = simulated("periodic"), shown("periodic", "displacement")
    assert len(figure.axes) == 4
    (line,) = by_gid(figure, "error")
    np.testing.assert_allclose(line.get_ydata(), result["slider.error_m"][-217:] * 1e6)
    np.testing.assert_allclose(line.get_xdata(), result["time_s"][-217:])
    (output,) = by_gid(figure, "output")
    np.testing.assert_allclose(output.get_ydata(), result["slider.s_m"][-217:] * 1e3)
    assert figure.axes[0].get_ylabel() == "slider: slide [mm]"
    assert figure.axes[3].get_xlim() == (0.0, 360.0)
    assert len(by_gid(figure, "revolution")) == 4  # two ends of revolutions in each panel over time
    assert "revolutions 6 to 13, the last one bold" in words(figure)


def test_an_angle_is_shown_in_degrees() -> None:
    figure = shown("four-bar", "displacement")
    assert figure.axes[0].get_ylabel() == "rocker: angle [deg]"
    assert figure.axes[1].get_ylabel() == "deviation [deg]"
    (output,) = by_gid(figure, "output")
    np.testing.assert_allclose(output.get_ydata(), np.degrees(np.unwrap(simulated("four-bar")["rocker.angle_rad"])))
    turning = shown("drag link", "displacement")
    bold = by_gid(turning, "last revolution")[0].get_ydata()
    assert 0.0 <= np.nanmin(bold) < 360.0  # within one turn
    assert np.nanmax(bold) - np.nanmin(bold) < 361.0


def test_clockwise_motion_is_drawn_to_the_right() -> None:
    for kind in ("displacement", "force", "torque"):
        axes = shown("clockwise", kind).axes[-1]
        assert axes.get_xlim() == (360.0, 0.0)
        assert axes.get_xlabel() == "crank angle φ [deg], clockwise to the right"
    assert "1200 rpm clockwise" in words(shown("clockwise", "error"))


def test_error_states_the_statistics() -> None:
    result, figure = simulated("periodic"), shown("periodic", "error")
    np.testing.assert_allclose(by_gid(figure, "rms")[0].get_ydata(), result.per_revolution["rms_m"] * 1e6)
    np.testing.assert_allclose(by_gid(figure, "peak")[0].get_ydata(), result.per_revolution["peak_m"] * 1e6)
    np.testing.assert_allclose(by_gid(figure, "whole")[0].get_ydata(), result.figures["rms_m"] * 1e6)
    assert f"RMS {rough(result.figures['rms_m'], 'm')}" in words(figure)
    assert "running-in, left out" in words(figure)
    assert "running-in" not in words(shown("fast", "error"))


def test_orbit_has_contact_outside_the_circle_and_flight_inside() -> None:
    for name, count in (("chaotic", 1), ("three gaps", 3)):
        result, figure = simulated(name), shown(name, "orbit")
        assert len(figure.axes) == count
        for gap, axes in zip(result.gaps, figure.axes, strict=True):
            assert axes.get_aspect() == 1.0
            radius = gap.clearance * 1e6
            lines = {line.get_gid(): np.hypot(*line.get_data()) for line in axes.lines if line.get_gid()}
            np.testing.assert_allclose(lines["clearance"], radius)
            assert np.nanmax(lines["apart"]) < radius * (1.0 + 1e-6)
            assert np.nanmin(lines["in contact"]) > radius * (1.0 - 1e-6)
            np.testing.assert_allclose(lines["impact"], radius)
            depth = result[f"{gap.point}.penetration_m"][RevolutionCurves(result).rows(3)]
            deepest = float(np.max(result.per_revolution[f"{gap.point}.penetration_max_m"][-3:]))
            assert deepest >= np.max(depth)
            factor = clearance_joints.magnification(gap, deepest)
            assert factor > 1.0
            assert f"beyond the circle {factor:g}-fold" in words(figure)
            assert math.isclose(np.nanmax(lines["in contact"]), radius + factor * np.max(depth) * 1e6, rel_tol=1e-9)
            assert np.nanmax(lines["in contact"]) < axes.get_xlim()[1]
    gap = simulated("chaotic").gaps[0]
    assert clearance_joints.magnification(gap, 0.0) == 1.0
    assert clearance_joints.magnification(gap, gap.clearance) == 1.0


def test_force_shades_the_contact() -> None:
    result, figure = simulated("chaotic"), shown("chaotic", "force")
    assert len(figure.axes) == 2
    top, bottom = figure.axes
    last = RevolutionCurves(result).rows(1)
    normal = result["C.normal_N"][last]
    (bold,) = (line for line in top.lines if line.get_gid() == "last revolution")
    assert math.isclose(np.nanmax(bold.get_ydata()), np.max(normal) * 1e-3)
    assert top.get_ylim()[1] > np.nanmax(bold.get_ydata())
    spans = sum(patch.get_width() for patch in top.patches if patch.get_gid() == "contact")
    share = np.mean(result["C.contact"][last])
    assert abs(spans / 360.0 - share) < 0.02
    assert top.get_ylabel().startswith("force [kN]")
    assert bottom.get_ylabel().startswith("penetration [µm]")
    assert bottom.get_ylim()[0] == 0.0
    assert len(shown("three gaps", "force").axes) == 6
    assert not by_gid(figure, "friction")  # there is none
    assert by_gid(shown("periodic", "force"), "friction")


def test_torque_against_the_ideal_machine() -> None:
    result, figure = simulated("periodic"), shown("periodic", "torque")
    ideal = by_gid(figure, "ideal")[0]
    analysis = optlink.analyze(result.problem, 360)
    torque = analysis["input.torque_Nm"]
    x = analysis["crank_angle_deg"]
    np.testing.assert_allclose(np.interp(x, *ideal.get_data()), torque, atol=1e-3 * np.max(np.abs(torque)))
    (last,) = by_gid(figure, "last revolution")
    assert math.isclose(np.nanmax(np.abs(last.get_ydata())), np.max(np.abs(result["input.torque_Nm"][-73:])))
    assert len(figure.axes) == 1
    hit = shown("fast", "torque")
    assert len(hit.axes) in (1, 2)
    given = shown("torque", "torque")
    assert not by_gid(given, "ideal")
    assert given.axes[0].get_ylim()[0] == 0.0  # a constant torque, not its rounding


def test_two_views_of_a_torque_that_hides_the_ideal_one() -> None:
    result = simulated("periodic")
    columns = {**result.columns, "input.torque_Nm": np.where(np.arange(13 * 72) % 72 == 10, 500.0, 1.0)}
    figure = drawn(replace(result, columns=columns))["torque"]
    assert len(figure.axes) == 2
    assert figure.axes[0].get_ylim()[1] > 500.0 > 20.0 > figure.axes[1].get_ylim()[1]
    assert "cut off" in " ".join(text.get_text() for text in figure.axes[1].texts)


def test_energy_account_closes() -> None:
    for name in ("periodic", "three gaps", "torque"):
        result, figure = simulated(name), shown(name, "energy")
        assert len(figure.axes) == 3
        fed, gained = by_gid(figure, "work drive")[0].get_ydata(), by_gid(figure, "gained")[0].get_ydata()
        lost = [
            line for gap in result.gaps for kind in ("impact", "friction") for line in by_gid(figure, f"lost {gap.point}.{kind}")
        ]
        assert len(lost) >= len(result.gaps)
        factor = by_gid(figure, "total")[0].get_ydata()[-1] / (fed - gained)[-1]  # another prefix
        missing = (fed - gained) * factor - sum(line.get_ydata() for line in lost)
        assert np.max(np.abs(missing)) < 1e-3 * np.max(np.abs(fed)) * factor
        share = by_gid(figure, "imbalance")[0].get_ydata()
        assert np.max(share) <= 2.1 * result.figures["imbalance_J"] / result.figures["largest_energy_J"]
        assert "of the largest energy" in words(figure)


def test_poincare_section_detects_periodic_motion() -> None:
    figure = shown("periodic", "section")
    assert len(figure.axes) == 2
    texts = words(figure)
    assert "periodic: the journals' positions repeat every revolution" in texts
    assert "agree over the 13 revolutions compared" in texts
    assert clearance_joints.repetition(RevolutionCurves(simulated("periodic")))[0] == 1
    assert len(by_gid(figure, "early")[0].get_xdata()) == 5
    texts = words(shown("chaotic", "section"))
    assert "not periodic" in texts
    assert "sensitive: runs at two tolerances diverge after" in texts
    assert "too few revolutions" in words(shown("fast", "section"))
    assert "nominal periods" in words(shown("torque", "section"))
    assert len(shown("three gaps", "section").axes) == 4


def test_poincare_section_detects_longer_periods() -> None:
    result = simulated("periodic")
    count = 12
    places = {"C.ex_m": np.tile([0.0, 1e-4, 2e-4], 4), "C.ey_m": np.zeros(count)}
    other = replace(result, poincare_map={"revolution": np.arange(1.0, 13.0), "slider.error_m": np.zeros(count), **places})
    assert clearance_joints.repetition(RevolutionCurves(other))[0] == 3


def test_impacts() -> None:
    result, figure = simulated("three gaps"), shown("three gaps", "impacts")
    for k, gap in enumerate(result.gaps):
        of_gap = [impact for impact in result.impacts if impact.gap == k]
        (line,) = by_gid(figure, f"approach {gap.point}")
        np.testing.assert_allclose(line.get_ydata(), [impact.approach for impact in of_gap])
        np.testing.assert_allclose(line.get_xdata(), [impact.begin * 20.0 for impact in of_gap])
        assert f"{gap.point}: {gap.journal} in {gap.bearing}: {len(of_gap)}" in words(figure)
    assert "impacts" not in drawn(replace(result, impacts=()))


def test_close_ups_show_the_journal_positions() -> None:
    for name in ("three gaps", "four-bar", "clockwise"):
        result, figure = simulated(name), shown(name, "mechanism")
        stage, strip = figure.axes
        turns = RevolutionCurves(result)
        last = slice(len(turns.time) - turns.points, None)
        forces = np.max([result[f"{gap.point}.normal_N"][last] for gap in result.gaps], axis=0)
        row = len(turns.time) - turns.points + int(np.argmax(forces))
        for gap in result.gaps:
            e = np.array([result[f"{gap.point}.e{axis}_m"][row] for axis in "xy"])
            for axes, inside in ((stage, False), (strip, True)):
                circles = {patch.get_gid(): patch for patch in axes.patches if isinstance(patch, Circle)}
                journal, bearing = circles[f"journal {gap.point}"], circles[f"bearing {gap.point}"]
                off = np.subtract(journal.center, bearing.center)
                assert abs(math.remainder(math.atan2(off[1], off[0]) - math.atan2(e[1], e[0]), 2.0 * math.pi)) < 1e-6
                room = bearing.radius - journal.radius
                np.testing.assert_allclose(np.hypot(*off) / room, np.hypot(*e) / gap.clearance, rtol=1e-6)
                assert inside == (abs(bearing.radius - 1.0) < 1e-9)
        arrows = [patch for patch in strip.patches if isinstance(patch, FancyArrowPatch)]
        assert 1 <= len(arrows) <= len(result.gaps)
        assert "-fold" in words(figure)


def test_ideal_joints_stay_closed_with_magnified_deviations() -> None:
    for name, pin, bodies in (("four-bar", "B", ("crank", "coupler")), ("clockwise", "B", ("crank", "rod"))):
        turns = RevolutionCurves(simulated(name))
        sketch = magnified_joints.MagnifiedMachine(turns, np.arange(72, 144, 5))
        assert sketch.factor > 1.0
        ends = []
        for body in bodies:
            local = np.array([[float(np.asarray(part)) for part in sketch.motion.pose.local(body, pin)]]) * sketch.scale.factor
            ends.append(sketch.placed(sketch.steps, body, local)[:, 0])
        extent = float(np.max(sketch.high - sketch.low))
        assert np.max(np.linalg.norm(ends[0] - ends[1], axis=1)) < 0.01 * extent
        ideal = Sketch(sketch.motion)
        np.testing.assert_allclose(sketch.position(sketch.motion, "C"), ideal.position(ideal.motion, "C"))


# --- control ------------------------------------------------------------------------------------------------------------------


@functools.cache
def compared():
    problem = optlink.read(slider_crank("C", drive=SERVO, control=CONTROL))
    return compare(problem, 2, 2, SEED, kinds=("none", "inverse+pid"), points=60, tolerance=1e-6)


def test_compensation() -> None:
    figure = pictures(control_comparison.compensation(compared().examples))["compensation"]
    assert len(figure.axes) == 2
    examples = compared().examples
    before = examples["none"].figures["rms_m"]
    unit = figure.axes[0].get_ylabel().removeprefix("deviation of slider ")
    factor = {"[mm]": 1e3, "[µm]": 1e6}[unit]
    for name, result in examples.items():
        (line,) = by_gid(figure, f"mean {name}")
        mean = np.mean(result["slider.error_m"].reshape(2, 60), axis=0) * factor
        assert set(np.round(mean, 6)) <= set(np.round(line.get_ydata(), 6))
        rms = f"{'no control' if name == 'none' else name}: RMS {result.figures['rms_m'] * factor:.4g} {unit.strip('[]')}"
        assert rms in words(figure)
        assert bool(by_gid(figure, f"correction {name}")) == (name != "none")
    assert f"({(examples['inverse+pid'].figures['rms_m'] / before - 1.0) * 100.0:+.0f} %)".replace("-", "−") in words(figure)
    at = sorted({round(line.get_xdata()[0]) % 360 for line in by_gid(figure, "standstill")})
    assert at == [0, 180]
    assert figure.axes[1].get_ylabel().endswith("[deg]")
    [alone] = control_comparison.compensation({"none": simulated("periodic")})
    assert len(alone.panels) == 1


def test_comparison_files(tmp_path: Path) -> None:
    written = view_of("control comparison").write(compared(), tmp_path)
    assert [path.name for path in written] == ["result.json", "compensation.png", "trials.png"]
    figure = pictures([control_comparison.trials(compared())])["trials"]
    points = by_gid(figure, "root mean square")
    assert len(points) == 2
    factor = {"deviation [mm]": 1e3, "deviation [µm]": 1e6}[figure.axes[0].get_xlabel()]
    np.testing.assert_allclose(points[0].get_xdata(), compared().trials["none"].rms * factor)
    assert "2 revolutions from each of 2 starts" in words(figure)
