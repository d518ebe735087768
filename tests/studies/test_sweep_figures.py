"""Sweeps of the analysis: exact figures, a status and a reason for every point, and the output of the command."""

from __future__ import annotations

import csv
import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import minimize_scalar
from typer.testing import CliRunner

import optlink
from optlink.cli.app import app
from optlink.errors import InputError
from optlink.presentation.views import sweep as sweep_view
from optlink.presentation.views.sweep import charts
from optlink.studies import sweep
from optlink.tasks.analyze import batch_extremes

PUMP = """
title = "Offset pump"
source = "Invented for this test."

[mechanism]
type = "dyads"

[mechanism.ground]
A = ["0 mm", "0 mm"]

[mechanism.links]
crank = {{ joints = ["A", "B"], length = "47 mm" }}
rod = {{ joints = ["B", "E"], length = "131 mm" }}
plunger = {{ joints = ["E"] }}

[mechanism.guides]
F = {{ slider = "plunger", on = "frame", through = ["0 mm", "29 mm"], direction = "0 deg" }}

[mechanism.assembly]
E = "forward"

[bodies]
crank = {{ mass = "0.3 kg", inertia = "uniform bar" }}
plunger = {{ mass = "1.1 kg" }}
{loads}
[drive]
body = "crank"
start = "20 deg"
speed = "{speed}"
"""
W, R, OFFSET = 9.0, 0.047, 0.029


@pytest.fixture
def pump(tmp_path):
    def write(loads: str = "", speed: str = "9 rad/s") -> Path:
        path = tmp_path / "pump.toml"
        path.write_text(PUMP.format(loads=loads, speed=speed))
        return path

    return write


def run(*arguments: object):
    return CliRunner().invoke(app, ["study", "sweep", *map(str, arguments)])


# --- the pump by hand: slide, its rates, the work of its one mass ------------------------------------------------------


def slide(phi, rod: float):
    """Slide, velocity and acceleration of the plunger [m, m/s, m/s^2]."""
    drop = OFFSET - R * np.sin(phi)
    root = np.sqrt(rod**2 - drop**2)
    rate = R * np.cos(phi) * W
    first = drop * rate / root
    second = (-(rate**2) - drop * R * np.sin(phi) * W**2) / root - (drop * rate) ** 2 / root**3
    return R * np.cos(phi) + root, -R * np.sin(phi) * W + first, -R * np.cos(phi) * W**2 + second


def exact(of, sign: float) -> float:
    """The least value of sign * of over a revolution, closed in on by a bounded search from a fine grid."""
    grid = np.linspace(0.0, 2.0 * math.pi, 4001)
    at = grid[np.argmin(sign * of(grid))]
    result = minimize_scalar(
        lambda phi: sign * of(phi), bounds=(at - 0.01, at + 0.01), method="bounded", options={"xatol": 1e-11}
    )
    return sign * result.fun


@pytest.mark.parametrize("speed", ["9 rad/s", "-9 rad/s"])
def test_extremes_of_a_sweep_are_exact_however_few_angles_are_sampled(pump, speed):
    file = optlink.load(str(pump(speed=speed)))
    vary = ["mechanism.links.rod.length=95..160 mm:9"]
    table = sweep(file, vary, analyze=True, columns=["plunger.a_m_s2", "F.normal_N.max"], points=7, workers=1).columns
    sampled = optlink.analyze_batch(file, {"rod.length": table["mechanism.links.rod.length_m"]}, ["plunger.a_m_s2"], 7)
    for i, rod in enumerate(table["mechanism.links.rod.length_m"]):
        for sign, kind in ((1.0, "min"), (-1.0, "max")):
            expected = exact(lambda phi, rod=rod: slide(phi, rod)[2], sign)
            assert table[f"plunger.a_m_s2.{kind}"][i] == pytest.approx(expected, rel=1e-9)
        # rod without mass: the guide holds the tangent of its angle of the force along the guide
        normal = exact(
            lambda phi, rod=rod: 1.1 * slide(phi, rod)[2] * (R * np.sin(phi) - OFFSET) / (slide(phi, rod)[0] - R * np.cos(phi)),
            -1.0,
        )
        assert table["F.normal_N.max"][i] == pytest.approx(normal, rel=1e-9)
    assert np.all(np.abs(table["plunger.a_m_s2.min"] / sampled["plunger.a_m_s2"].min(axis=1) - 1.0) > 1e-3)
    assert set(table["status"]) == {"analysed"}
    assert not any(table["reason"])


def test_stroke_time_ratio_and_work_are_columns(pump):
    names = ["plunger.stroke_m", "plunger.time_ratio", "rod.swing_rad", "input.work_per_revolution_J"]
    file = optlink.load(str(pump('\n[loads]\noil = { on = "plunger", damping = "40 N*s/m" }\n')))
    result = sweep(file, ["mechanism.links.rod.length=85, 131, 200 mm"], analyze=True, columns=names, workers=1)
    assert list(result.names[1:5]) == names
    for i, rod in enumerate((0.085, 0.131, 0.2)):
        far, near = math.acos(OFFSET / (rod + R)), math.acos(OFFSET / (rod - R))
        stroke = math.sqrt((rod + R) ** 2 - OFFSET**2) - math.sqrt((rod - R) ** 2 - OFFSET**2)
        assert result.columns["plunger.stroke_m"][i] == pytest.approx(stroke, rel=1e-9)
        turn = math.pi + far - near
        assert result.columns["plunger.time_ratio"][i] == pytest.approx(
            max(turn / (2 * math.pi - turn), (2 * math.pi - turn) / turn)
        )
        swing = math.asin((R + OFFSET) / rod) + math.asin((R - OFFSET) / rod)
        assert result.columns["rod.swing_rad"][i] == pytest.approx(swing, rel=1e-9)
        phi = np.linspace(0.0, 2.0 * math.pi, 720, endpoint=False)
        work = 40.0 * np.mean(slide(phi, rod)[1] ** 2) * 2.0 * math.pi / W
        assert result.columns["input.work_per_revolution_J"][i] == pytest.approx(work, rel=1e-8)


@pytest.mark.slow
def test_both_routes_to_a_row_agree(pump, monkeypatch):
    """Designs in batches, and one by one as `optlink analyze` does."""
    columns = ["B.f_N", "input.torque_Nm", "rod.omega_rad_s.min", "E.vx_m_s.max"]
    vary = ["mechanism.links.rod.length=80..160 mm:5", "mechanism.links.crank.length=12..47 mm:4"]
    file = optlink.load(str(pump()))
    batched = sweep(file, vary, analyze=True, columns=columns, workers=1).columns
    assert np.all(batched["valid"])
    monkeypatch.setattr("optlink.studies.sweep_task.AnalysisTask._batched", lambda *_: {})
    alone = sweep(file, vary, analyze=True, columns=columns, workers=1).columns
    for name in list(batched)[2:-3]:
        rounding = (
            1e-9 * float(np.max(batched["B.f_N.max"])) if name == "B.f_N.min" else 1e-12
        )  # the force at B vanishes somewhere
        np.testing.assert_allclose(batched[name], alone[name], rtol=1e-9, atol=rounding, err_msg=name)


def test_loads_that_jump_have_one_sided_extremes_in_a_sweep(pump):
    file = optlink.load(str(pump('\n[loads]\ncut = { on = "plunger", force = "90 N", acts = "opposing" }\n')))
    result = sweep(file, ["mechanism.links.rod.length=120..150 mm:3"], analyze=True, workers=1)
    for i in range(3):
        design = {"rod.length": float(result.columns["mechanism.links.rod.length_m"][i])}
        alone = optlink.analyze(file, design=design).extremes["input.torque_Nm"]
        assert result.columns["input.torque_Nm.min"][i] == alone.least
        assert result.columns["input.torque_Nm.max"][i] == alone.largest


# --- points without figures ----------------------------------------------------------------------------------------------


def test_every_point_has_a_status_and_the_reachable_range_where_it_does_not_turn(pump):
    file = optlink.load(str(pump()))
    table = sweep(file, ["mechanism.links.rod.length=20, 60, 131 mm"], analyze=True, workers=1).columns
    assert table["status"].tolist() == ["partial rotation", "partial rotation", "analysed"]
    assert table["valid"].tolist() == [False, False, True]
    # |offset - r sin(phi)| <= rod
    low = math.degrees(math.asin((OFFSET - 0.06) / R))
    assert table["reason"][1] == f"the crank does not turn fully; reachable: {low + 360:.6g} ... {540 - low:.6g} deg" or (
        f"reachable: {low:.6g} ... {180 - low:.6g} deg" in table["reason"][1]
    )
    assert np.isnan(table["input.torque_Nm.max"][:2]).all()


def test_a_singular_position_and_a_design_out_of_reach_are_statuses(pump):
    file = optlink.load(str(pump()))
    vary = ["mechanism.links.rod.length=76, 77 mm", "mechanism.guides.F.through.y=29, 200 mm"]
    table = sweep(file, vary, analyze=True, workers=1).columns
    assert table["status"].tolist() == ["singular position", "not assembled", "analysed", "not assembled"]
    assert (
        "singular position at crank angle 270 deg" in table["reason"][0]
    )  # rod = offset + crank: it stands across the guide there
    assert "no crank angle can be reached" in table["reason"][1]


def test_a_missing_figure_is_reported(tmp_path):
    """A crank-rocker's rocker swings; that of a double crank turns."""
    vary = ["mechanism.frame=30, 500 mm"]
    result = sweep(
        optlink.load("crank-rocker"),
        vary,
        analyze=True,
        columns=["rocker.swing_rad"],
        design={"coupler": 0.41, "rocker": 0.4},
        workers=1,
    )
    assert result.columns["status"].tolist() == ["no value", "analysed"]
    assert "rocker.swing_rad has no value" in result.columns["reason"][0]


def test_a_sweep_without_any_valid_point_is_exit_code_1(pump, tmp_path):
    path = pump()
    out = tmp_path / "out"
    done = run(path, "--analyze", "--vary", "mechanism.links.rod.length=30..60 mm:4", "--out", out)
    assert done.exit_code == 1
    assert "4 partial rotation" in done.stdout
    assert done.stdout.count("the crank does not turn fully; reachable:") == 4
    document = json.loads((out / "result.json").read_text())
    assert document["status"] == "not valid anywhere"
    assert (document["valid_points"], document["statuses"]) == (0, {"partial rotation": 4})
    rows = list(csv.DictReader((out / "sweep.csv").read_text().splitlines()))
    assert all(row["valid"] == "false" and row["reason"] for row in rows)
    some = run(path, "--analyze", "--vary", "mechanism.links.rod.length=60..150 mm:4", "--json")
    assert some.exit_code == 0
    assert json.loads(some.stdout)["status"] == "not valid everywhere"
    again = run(path, "--analyze", "--vary", "mechanism.links.rod.length=30..60 mm:4", "--out", out, "--resume")
    assert again.exit_code == 1


@pytest.mark.slow
def test_the_table_of_the_command_shows_the_columns(pump):
    vary = "mechanism.links.rod.length=131, 150 mm"
    done = run(pump(), "--analyze", "--vary", vary, "--column", "plunger.stroke_m", "--column", "plunger.v_m_s.max")
    stroke = [math.sqrt((rod + R) ** 2 - OFFSET**2) - math.sqrt((rod - R) ** 2 - OFFSET**2) for rod in (0.131, 0.15)]
    for value in stroke:
        assert f"{value:.6g}" in done.stdout
    assert "stroke_m" in done.stdout
    many = run(pump(), "--analyze", "--vary", "mechanism.links.rod.length=60..150 mm:40", "--column", "plunger.stroke_m")
    assert "Extremes over all valid points" in many.stdout
    assert "Points that are not valid: 7" in many.stdout


def test_unknown_figures_are_refused_with_the_nearest(pump):
    with pytest.raises(InputError, match=r'columns = "plunger.strok_m": no such column. Did you mean "plunger.stroke_m"'):
        sweep(optlink.load(str(pump())), ["mechanism.links.rod.length=120..150 mm:3"], analyze=True, columns=["plunger.strok_m"])


def test_dimensions_that_move_no_joint_can_be_varied(pump):
    """A point that the plunger carries closes no loop: it only moves aside."""
    path = pump()
    text = path.read_text().replace('joints = ["E"] }', 'joints = ["E"], points = { Q = ["40 mm", "10 mm"] } }')
    path.write_text(text)
    file = optlink.load(str(path))
    (name,) = (name for name in file.model.mechanism.quantities if name.endswith(("Q.along", "Q.x")))
    computed, clear = batch_extremes(file, {name: [0.04, 0.055]}, ["Q.x_m", "input.torque_Nm"])
    assert clear.all()
    assert computed["Q.x_m"][:, 1] == pytest.approx(
        [math.sqrt((0.131 + R) ** 2 - OFFSET**2) + x for x in (0.04, 0.055)], rel=1e-9
    )
    assert computed["input.torque_Nm"][0].tolist() == computed["input.torque_Nm"][1].tolist()


@pytest.mark.slow
def test_pictures_and_pages_of_a_sweep_with_gaps(pump, tmp_path):
    out = tmp_path / "out"
    columns = ("--column", "plunger.stroke_m", "--column", "plunger.v_m_s")
    done = run(pump(), "--analyze", "--vary", "mechanism.links.rod.length=60..150 mm:13", *columns, "--out", out)
    assert done.exit_code == 0
    assert (out / "sweep.png").stat().st_size > 10_000
    page = tmp_path / "page.html"
    done = CliRunner().invoke(app, ["report", str(out / "result.json"), "-o", str(page)])
    assert done.exit_code == 0, done.output
    text = page.read_text()
    assert "partial rotation" in text
    assert "plunger.stroke" in text


@pytest.mark.slow
def test_batches_find_the_least_force_and_skip_ambiguous_samples():
    """At 35 rad/s a minimum between samples of the six-bar is the deepest."""
    for name, joint, speed, decided in (
        ("six-bar", "E", 35.0, False),
        ("six-bar", "E", 20.0, True),
        ("whitworth", "C", 32.0, True),
        ("whitworth", "C", 20.0, True),
    ):
        file = optlink.load(name).override({"drive.speed": f"{speed} rad/s"})
        least = optlink.analyze(file).extremes[f"{joint}.f_N"].least
        size, quantity = next(iter(file.model.mechanism.quantities.items()))
        computed, clear = batch_extremes(file, {size: [quantity.value]}, [f"{joint}.f_N"])
        assert clear.tolist() == [decided]
        assert computed[f"{joint}.f_N"][0, 0] == pytest.approx(least, rel=1e-6)


@pytest.mark.slow
def test_a_peak_at_a_row_of_a_load_table_is_that_of_the_analysis(pump):
    """Two catches push the plunger within 0.04 mm each: the positions of a sweep are farther apart."""
    table = 'force = { over = "s", at = ["90 mm", "90.02 mm", "90.04 mm", "130 mm", "130.02 mm", "130.04 mm"], '
    table += 'values = ["0 N", "300 N", "0 N", "0 N", "310 N", "0 N"] }'
    problem = optlink.load(pump(f'[loads.stop]\non = "plunger"\n{table}\n'))
    names = ["input.torque_Nm.max", "input.torque_Nm.min"]
    computed = sweep(problem, ["mechanism.links.rod.length=131..133 mm:3"], analyze=True, columns=names, workers=1).columns
    for i, rod in enumerate((131, 132, 133)):
        figures = optlink.analyze(problem.override({"mechanism.links.rod.length": f"{rod} mm"})).figures
        assert [computed[name][i] for name in names] == pytest.approx([figures[name] for name in names], rel=1e-9)


def test_the_pace_of_a_slow_sweep_is_not_zero():
    computed = sweep(optlink.load("crank-rocker"), ["mechanism.frame=490..500 mm:2"])
    for seconds, done, pace in ((80.0, 5, "(0.062 a second"), (4.0, 3600, "(900 a second")):
        said = str(sweep_view.overview(replace(computed, seconds=seconds, points_done_now=done, searched_points=2)).parts[-1])
        assert pace in said
        assert "all by a search" in said


@pytest.mark.slow
def test_a_sweep_of_simulations_draws_what_varies_in_units_of_a_drawing():
    options = {"revolutions": 2, "points": 36}
    result = sweep(optlink.load("slider-crank-clearance"), ["drive.speed=900..1500 rpm:3"], simulate=options)
    (chart,) = charts(result)
    names = [panel.y.name for panel in chart.panels]
    assert names[0] == "rms [µm]"
    assert names[1] == "mean_square [µm²]"
    assert not [name for name in names if "revolutions" in name]
    assert 100.0 < np.max(chart.panels[0].traces[0].y) < 1000.0
    assert np.allclose(chart.panels[1].traces[0].y, chart.panels[0].traces[0].y ** 2)
