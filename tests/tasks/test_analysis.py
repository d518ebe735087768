"""Analysis over the cycle: columns, extremes, work, ranges, batches, and the command line that shows them."""

from __future__ import annotations

import csv
import json
import math
import os
import pickle
import re
import tracemalloc

import casadi
import numpy as np
import pytest
from hypothesis import given, strategies as st
from typer.testing import CliRunner

import optlink
from optlink.cli.app import app
from optlink.dynamics.columns import MotionColumns
from optlink.dynamics.work import Work, jumps
from optlink.linkage import stroke as cycle
from optlink.linkage.extrema import SampledFunctions, extremes, zeros
from optlink.linkage.fourbar import four_bar, grashof, reachable as four_bar_reachable
from optlink.studies import sweep
from optlink.symbolic import symbols_in_numpy
from optlink.tasks.machine import machine_of
from tests.clearance.test_joint_clearance import ending_after
from tests.solved import loaded
from tests.tiers import examples, mostly_slow

TURN = 2.0 * math.pi
DESIGNED = {name for name in optlink.shipped() if loaded(name).task == "function"}
MACHINES = sorted(name for name in optlink.shipped() if name not in DESIGNED and loaded(name).task != "path")


@pytest.fixture(scope="module")
def six_bar():
    return optlink.analyze(optlink.load("six-bar"), points=72)


def run(*arguments):
    return CliRunner().invoke(app, list(arguments))


# --- columns --------------------------------------------------------------------------------------------------------------


def test_columns_are_named_as_documented(six_bar):
    expected = ["crank_angle_deg", "time_s"]
    for body in ("crank", "link2", "link3", "link5", "slider"):
        expected += [f"{body}.angle_rad", f"{body}.omega_rad_s", f"{body}.alpha_rad_s2"]
    for point in "BCE":
        expected += [f"{point}.{part}{axis}{unit}" for part, unit in (("", "_m"), ("v", "_m_s"), ("a", "_m_s2")) for axis in "xy"]
    expected += ["slider.s_m", "slider.v_m_s", "slider.a_m_s2", "F.normal_N", "F.moment_Nm"]
    expected += [f"{pin}.f{axis}_N" for pin in ("A", "B", "D", "E", "C.link2", "C.link3", "C.link5") for axis in "xy"]
    expected += [f"input.torque{part}_Nm" for part in ("", "_inertia", "_gravity", "_load")]
    expected += ["input.power_W", "input.work_J", "frame.shaking_fx_N", "frame.shaking_fy_N", "frame.shaking_moment_Nm"]
    assert set(expected) <= set(six_bar.columns)
    assert set(six_bar.columns) == set(six_bar.meanings)
    assert all(len(column) == 73 and np.all(np.isfinite(column)) for column in six_bar.columns.values())


def test_reaction_directions_are_documented(six_bar):
    text = six_bar.to_dict()["reactions"]
    assert text["A"] == "frame on crank"
    assert text["E"] == "slider on link5"
    assert text["C.link2"] == "pin on link2"
    assert text["F"].startswith("frame on slider")


def test_columns_at_any_crank_angle_are_those_of_the_table_and_one_sided_at_a_jump(six_bar):
    there = six_bar.at(six_bar.positions)
    assert set(there) == set(six_bar.columns) - {"crank_angle_deg", "time_s", "input.work_J"}
    assert all(np.allclose(there[name], six_bar[name], rtol=1e-12, atol=1e-12) for name in there)
    shaper = optlink.analyze("shaper", points=12)
    before, after = (np.abs(shaper.at(shaper.jumps, side)["cutting.fx_N"]) for side in (-1, 1))
    assert np.allclose([before, after], [[5880.0, 0.0], [0.0, 5880.0]])
    with pytest.raises(optlink.InputError, match=r"side = 0: neither side of a jump\. Give 1 or -1"):
        shaper.at(0.0, 0)
    with pytest.raises(optlink.InputError, match=r"crank_angle = .*: not a finite number or array"):
        shaper.at([math.nan])


def test_rates_agree_with_finite_differences(six_bar):
    fine = optlink.analyze(optlink.load("six-bar"), points=3600)
    time = fine["time_s"]
    for value, rate in (("slider.s_m", "slider.v_m_s"), ("C.vx_m_s", "C.ax_m_s2"), ("link3.omega_rad_s", "link3.alpha_rad_s2"),
                        ("link5.angle_rad", "link5.omega_rad_s"), ("input.work_J", "input.power_W")):  # fmt: skip
        steps = (fine[value][2:] - fine[value][:-2]) / (time[2:] - time[:-2])
        np.testing.assert_allclose(steps, fine[rate][1:-1], rtol=0.0, atol=2e-5 * np.max(np.abs(fine[rate])))


def test_json_is_plain_and_complete(six_bar):
    document = json.loads(json.dumps(six_bar.to_dict(), allow_nan=False))
    assert document["schema"] == "optlink/analysis/4"
    assert document["problem_hash"] == optlink.load("six-bar").hash
    assert len(document["columns"]["time_s"]) == 73
    assert document["groups"][0] == {"kind": "RRR", "joint": "C", "bodies": ["link2", "link3"]}


# --- extremes, zeros, work ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", mostly_slow(MACHINES, "shaper", "six-bar", "oscillating-cylinder"))
def test_extremes_are_those_of_a_brute_sweep_and_no_less(name):
    result = optlink.analyze(optlink.load(name), points=8)
    angles = np.linspace(result.low, result.high, 20_001)
    record = MotionColumns(result.machine.moving(angles, result.speed))
    checked = 0
    for column, extreme in result.extremes.items():
        size = float(np.nanmax(np.abs(record[column]))) if column in record.columns else 0.0
        if size < 1e-9:
            continue  # rounding of what is zero
        for sign, value, at in ((1.0, extreme.least, extreme.least_at), (-1.0, -extreme.largest, extreme.largest_at)):
            values = sign * record[column]
            jump = any(abs(math.remainder(at - jump, TURN)) < 1e-9 for jump in result.jumps)
            assert value <= np.nanmin(values) + 1e-12 * size, column
            assert np.nanmin(values) - value < (5e-3 if jump else 2e-4) * size, column  # beside a jump the sweep ends short
            checked += 1
    assert checked > 30


def test_extremes_of_a_known_function_are_exact():
    grid = np.linspace(0.0, TURN, 37)
    at, value = extremes(lambda phi: np.array([np.sin(phi - 0.1234), np.exp(np.cos(2.0 * phi - 0.4)), 3.0 + 0.0 * phi]), grid)
    np.testing.assert_allclose(at[0], [0.1234 + 1.5 * math.pi, 0.1234 + 0.5 * math.pi], rtol=0.0, atol=1e-8)
    np.testing.assert_allclose(value[0], [-1.0, 1.0], rtol=0.0, atol=1e-15)
    np.testing.assert_allclose(value[1], [math.exp(-1.0), math.exp(1.0)], rtol=1e-15)
    np.testing.assert_allclose(value[2], [3.0, 3.0])


def test_extremes_stay_on_their_side_of_a_jump():
    """A saw: rises to 1 before the jump at 2, falls to -1 after it; neither value is mixed."""
    grid = np.linspace(0.0, 4.0, 31)

    def saw(phi):
        return np.array([np.where(phi < 2.0, phi / 2.0, phi / 2.0 - 2.0)])

    at, value = extremes(saw, np.unique([*grid, 2.0]), (2.0,))
    assert value[0, 0] == pytest.approx(-1.0, abs=1e-12)
    assert value[0, 1] == pytest.approx(1.0, abs=1e-8)
    assert at[0, 0] == 2.0


def test_extremes_without_a_value_are_nan():
    at, value = extremes(lambda phi: np.array([np.nan * phi, np.where(phi > 1.0, np.nan, phi)]), np.linspace(0.0, 2.0, 11))
    assert np.all(np.isnan(value[0]))
    assert np.all(np.isnan(at[0]))
    np.testing.assert_allclose(value[1], [0.0, 1.0], atol=1e-6)


def test_zeros_are_exact_and_gaps_are_none():
    computed = zeros(
        lambda phi: np.array([np.cos(phi), np.where(phi > 3.0, np.nan, phi - 2.0), 1.0 + phi * phi]), np.linspace(0, 6, 50)
    )
    np.testing.assert_allclose(computed[0], [0.5 * math.pi, 1.5 * math.pi], rtol=0.0, atol=2e-15)
    np.testing.assert_allclose(computed[1], [2.0], atol=1e-15)
    assert len(computed[2]) == 0


@pytest.mark.parametrize("speed", [3.0, -3.0])
def test_work_equals_the_change_of_energy_plus_the_load_work(speed):
    """A constant force is conservative, so W = d(T + V) - F ds at every angle; opposing it takes F |ds|."""
    problem = optlink.load("six-bar")
    result = optlink.analyze(problem, points=50, speed=speed)
    energy = result["energy.kinetic_J"] + result["energy.potential_J"] - 1000.0 * result["slider.s_m"]
    np.testing.assert_allclose(result["input.work_J"], energy - energy[0], rtol=0.0, atol=1e-10 * np.ptp(energy))
    opposing = optlink.analyze(problem.override({"loads.process.acts": "opposing", "loads.process.direction": None}), speed=speed)
    assert math.copysign(1.0, speed) * opposing.work == pytest.approx(math.copysign(1.0, speed) * 747.808316959, rel=1e-11)
    assert opposing.work > 0.0


def test_work_detects_an_omitted_jump(monkeypatch):
    machine = machine_of(optlink.load("shaper"))
    exact = float(Work(machine, 0.0, 0.0, TURN, 1.0)(np.array([TURN]))[0])
    assert exact == pytest.approx(5880.0 * 1.2 * 125.0 / 275.0, rel=1e-12)
    monkeypatch.setattr("optlink.dynamics.work.jumps", lambda *_: np.empty(0))
    assert abs(float(Work(machine, 0.0, 0.0, TURN, 1.0)(np.array([TURN]))[0]) / exact - 1.0) > 1e-9


def test_jumps_are_the_dead_centres_of_the_shaper():
    computed = jumps(machine_of(optlink.load("shaper")), 0.0, TURN)
    limit = math.asin(125.0 / 275.0)
    np.testing.assert_allclose(computed, [math.pi + limit, TURN - limit], rtol=0.0, atol=1e-14)


# --- ranges, strokes ------------------------------------------------------------------------------------------------------


@examples(150)
@given(*(st.floats(0.05, 1.0) for _ in range(4)))
def test_reachable_ranges_are_those_of_the_four_bar_theory(crank, coupler, rocker, frame):
    sizes = {"crank": crank, "coupler": coupler, "rocker": rocker, "frame": frame}
    theory = four_bar_reachable(crank, coupler, rocker, frame)
    if "change-point" in grashof(crank, coupler, rocker, frame, 1e-3).inversion.value:
        return  # there both modes meet
    if any(high - low < 0.02 for low, high in theory) or (abs(sum(b - a for a, b in theory) - TURN) < 0.04 and len(theory) > 1):
        return  # narrower than the grid
    if theory and theory[0][1] - theory[0][0] > TURN - 0.02:
        theory = [(0.0, TURN)] if theory[0][1] - theory[0][0] > TURN - 1e-9 else theory
    result = cycle.reachable(four_bar(), sizes)
    assert len(result.ranges) == len(theory) or (result.full and len(theory) == 1)
    if not result.full:
        starts = sorted(math.remainder(low, TURN) for low, _ in result.ranges)
        expected = sorted(math.remainder(low, TURN) for low, _ in theory)
        assert all(abs(math.remainder(a - b, TURN)) < 1e-6 for a, b in zip(starts, expected, strict=True))
        assert sum(b - a for a, b in result.ranges) == pytest.approx(sum(b - a for a, b in theory), abs=2e-6)


def offset_slider_crank(offset):
    return optlink.read(
        {
            "title": "offset slider-crank",
            "mechanism": {
                "ground": {"A": ["0 m", "0 m"]},
                "links": {
                    "crank": {"joints": ["A", "B"], "length": "0.1 m"},
                    "rod": {"joints": ["B", "C"], "length": "0.3 m"},
                    "slider": {"joints": ["C"]},
                },
                "guides": {"F": {"slider": "slider", "through": "A", "offset": f"{offset} m"}},
                "assembly": {"C": "forward"},
            },
        }
    )


@examples(25)
@given(st.floats(-0.15, 0.15))
def test_stroke_and_time_ratio_of_the_offset_slider_crank(offset):
    """Limits at sqrt((l +- r)^2 - e^2); the strokes take pi +- (asin(e / (l - r)) - asin(e / (l + r)))."""
    result = optlink.analyze(offset_slider_crank(offset), points=4)
    travel = result.strokes["slider"]
    far, near = (math.sqrt((0.3 + sign * 0.1) ** 2 - offset**2) for sign in (1.0, -1.0))
    assert travel.low == pytest.approx(near, abs=1e-12)
    assert travel.high == pytest.approx(far, abs=1e-12)
    more = abs(math.asin(offset / 0.2) - math.asin(offset / 0.4))
    assert travel.time_ratio == pytest.approx((math.pi + more) / (math.pi - more), rel=1e-9)


def test_crank_that_cannot_turn_is_analysed_in_its_range():
    """Rod 0.3 against offset 0.25: reachable where 0.1 sin(phi) >= 0.25 - 0.3, that is phi > asin(-0.5)."""
    result = optlink.analyze(offset_slider_crank(0.25), points=40)
    assert not result.full
    np.testing.assert_allclose(np.degrees(result.ranges.ranges), [[330.0, 570.0]], rtol=0.0, atol=1e-7)
    assert any("fails to close by" in note for note in result.notes)
    assert np.all(np.isfinite(result["slider.v_m_s"]))
    assert result.strokes["slider"].span > 0.0


def test_singular_positions_are_reported_not_divided_by():
    """A parallelogram folds at 0 and 180 degrees: no finite reaction there."""
    problem = optlink.read(
        {
            "title": "parallelogram",
            "mechanism": {"type": "four-bar", "crank": "0.1 m", "coupler": "0.3 m", "rocker": "0.1 m", "frame": "0.3 m"},
            "bodies": {"coupler": {"mass": "1 kg", "inertia": "uniform bar"}},
            "gravity": "9.81 m/s^2",
        }
    )
    result = optlink.analyze(problem, points=8)
    assert not result.valid
    assert 0.0 in np.round(np.degrees(result.singular) % 180.0, 6)
    assert np.isnan(result["input.torque_Nm"][0])
    assert np.isfinite(result["input.torque_Nm"][1])
    assert any("singular position" in note for note in result.notes)
    json.dumps(result.to_dict(), allow_nan=False)


# --- batches --------------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("name", MACHINES)
def test_batch_agrees_with_single_analyses(name):
    problem = optlink.load(name)
    lengths = [key for key, q in problem.model.quantities.items() if q.kind == "length"][:2]
    rng = np.random.default_rng(5)
    designs = {key: problem.model.quantities[key].value * (1.0 + 0.003 * rng.uniform(-1, 1, 37)) for key in lengths}
    columns = ["input.torque_Nm", "input.torque_gravity_Nm", "frame.shaking_fx_N"]
    columns += [
        name for name in MotionColumns(machine_of(problem).moving(np.array([1.0]))).columns if name.endswith((".fx_N", ".s_m"))
    ]
    computed = optlink.analyze_batch(problem, designs, columns, points=500)
    for k in (0, 20, 36):
        alone = optlink.analyze(problem, 500, design={key: float(values[k]) for key, values in designs.items()})
        for column in columns:
            scale = np.max(np.abs(alone[column])) + 1e-9
            np.testing.assert_allclose(computed[column][k], alone[column][:-1], rtol=0.0, atol=1e-10 * scale, err_msg=column)


@pytest.mark.slow
def test_batch_memory_does_not_exceed_its_result():
    problem, extra = optlink.load("six-bar"), []
    for count in (100, 1000):
        designs = {"link2.length": np.linspace(1.15, 1.25, count)}
        tracemalloc.start()
        computed = optlink.analyze_batch(problem, designs)
        extra.append(tracemalloc.get_traced_memory()[1] - computed["input.torque_Nm"].nbytes)
        tracemalloc.stop()
    assert extra[1] < 1.2 * extra[0]


def test_batch_has_no_value_where_a_design_cannot_be_assembled():
    computed = optlink.analyze_batch(optlink.load("six-bar"), {"link3.length": [0.8, 0.3]})["input.torque_Nm"]
    assert np.all(np.isfinite(computed[0]))
    assert np.any(np.isnan(computed[1]))
    assert np.any(np.isfinite(computed[1]))


@pytest.mark.parametrize("name", ["crank-rocker", "six-bar"])
def test_a_batch_says_as_one_analysis_that_there_are_no_forces(name):
    problem = optlink.load(name)
    size = next(key for key, quantity in problem.model.mechanism.quantities.items() if quantity.kind == "length")
    forceless = [note for note in optlink.analyze(problem).notes if "no forces" in note]
    assert optlink.analyze_batch(problem, {size: [problem.model.quantities[size].value]}).notes == forceless
    assert len(forceless) == (name == "crank-rocker")


@pytest.mark.parametrize(
    ("designs", "columns", "says"),
    [
        ({}, ("input.torque_Nm",), "no quantity"),
        ({"link9.length": [1.0]}, ("input.torque_Nm",), "unknown quantity"),
        ({"link2.length": [1.0], "link3.length": [1.0, 2.0]}, ("input.torque_Nm",), "one value per design"),
        ({"link2.length": [-1.0]}, ("input.torque_Nm",), "not a size"),
        ({"link2.length": [math.nan]}, ("input.torque_Nm",), "not a size"),
        ({"link2.length": [1.2]}, ("input.torqe_Nm",), "no such column"),
    ],
)
def test_bad_batches(designs, columns, says):
    with pytest.raises(optlink.InputError, match=says):
        optlink.analyze_batch(optlink.load("six-bar"), designs, columns)


# --- command line ---------------------------------------------------------------------------------------------------------


def test_analyze_writes_every_digit_of_the_table(tmp_path):
    file = tmp_path / "cycle.csv"
    done = run("analyze", "six-bar", "--step", "15 deg", "--csv", str(file))
    assert done.exit_code == 0
    rows = list(csv.DictReader(file.read_text().splitlines()))
    result = optlink.analyze(optlink.load("six-bar"), step=math.radians(15.0))
    assert len(rows) == 25
    for name, column in result.columns.items():
        assert [float(row[name]) for row in rows] == list(column)
    assert "least since the start" in done.stdout


@pytest.mark.slow
def test_mean_torque_and_power_are_those_of_the_work():
    for speed in (math.tau, -math.tau):  # one revolution per second
        result = optlink.analyze(optlink.load("shaper"), speed=speed)
        assert result.mean_power == pytest.approx(result.work, rel=1e-12)
        assert result.mean_torque == pytest.approx(result.work / speed, rel=1e-12)
        even = result["input.power_W"][:-1]
        assert result.mean_power == pytest.approx(float(np.mean(even)), rel=2e-2)  # the load jumps between the rows
    shown = run("analyze", "shaper", "--speed=-60 rpm").stdout
    assert re.search(rf"mean power +{result.mean_power:.2f} +W\s", shown)
    assert re.search(rf"mean torque +{result.mean_torque:.3f} +N·m\s", shown)


@pytest.mark.slow
def test_rms_torque_is_that_of_closed_forms_and_of_the_table():
    """Of a crank that lifts its own weight, m g r cos(phi), and of a load with jumps."""
    raw = optlink.load("scotch-yoke").raw
    lone = {
        **raw,
        "bodies": {"crank": {"mass": "2 kg", "centroid": ["30 mm", "0 mm"], "inertia": "1 kg*m^2"}},
        "gravity": "9.81 m/s^2",
        "loads": {},
    }
    crank = optlink.analyze(optlink.read(lone), speed=3.0)
    assert crank.rms_torque == pytest.approx(2.0 * 9.81 * 0.03 / math.sqrt(2.0), rel=1e-12)
    shaper = optlink.analyze(optlink.load("shaper"), 9_000)
    squares = shaper["input.torque_Nm"][:-1] ** 2
    assert shaper.rms_torque == pytest.approx(math.sqrt(np.mean(squares)), rel=1e-4)
    assert abs(shaper.mean_torque) < shaper.rms_torque < shaper.extremes["input.torque_Nm"].largest
    assert isinstance(shaper, optlink.Result)
    with pytest.raises(optlink.UnknownName, match=r"no column input\.torque\b.*input\.torque_Nm"):
        _ = shaper.extremes["input.torque"]
    assert shaper.to_dict()["rms_torque_Nm"] == shaper.rms_torque
    shown = run("analyze", "shaper").stdout
    assert re.search(rf"rms torque +{shaper.rms_torque:.3f} +N·m\s", shown)
    partial = optlink.analyze(optlink.load("slider-crank").override({"mechanism.links.rod.length": "90 mm"}))
    assert not partial.full
    assert "rms_torque_Nm" not in partial.to_dict()


@pytest.mark.slow
@pytest.mark.parametrize(
    "clearance", [(), ("--set", "joints.B={ clearance = '0.5 mm', bearing_radius = '10 mm', modulus = '0.2 GPa' }")]
)
def test_a_simulation_names_the_design_variables_at_their_start_values(clearance):
    masses = (
        "--set",
        "bodies.coupler={mass='1 kg', inertia='uniform bar'}",
        "--set",
        "bodies.rocker={mass='1 kg', inertia='uniform bar'}",
    )
    words = ("simulate", "crank-rocker", *masses, *clearance, *(("--revolutions", "1") if clearance else ()))
    with ending_after(0.05):
        assert "Note: design variables are at their start values: coupler, rocker" in run(*words).output
        done = run(*words, "--design", "coupler=412 mm", "--design", "rocker=232 mm")
    assert done.exit_code == 0, done.output
    assert "start values" not in done.output


def test_simulate_under_a_torque_from_the_command_line():
    done = run("simulate", "six-bar", "--torque", "600 N*m", "--duration", "0.1 s", "--flywheel", "5 kg*m^2", "--points", "5")
    assert done.exit_code == 0
    assert "Energy account" in done.stdout


def test_analyze_exits_1_where_no_finite_reaction_exists(tmp_path):
    file = tmp_path / "fold.toml"
    file.write_text(
        'title = "parallelogram"\n[mechanism]\ncrank = "0.1 m"\ncoupler = "0.3 m"\nrocker = "0.1 m"\nframe = "0.3 m"\n'
        '[bodies]\ncoupler = { mass = "1 kg", inertia = "uniform bar" }\n[drive]\nspeed = "5 rad/s"\n'
    )
    done = run("analyze", str(file), "--points", "8")
    assert done.exit_code == 1
    assert "singular position" in " ".join(done.stdout.split())


def test_design_problems_are_analysed_at_a_given_design():
    done = run("analyze", "crank-rocker", "--design", "coupler=412.86542 mm", "--design", "rocker=232.24617 mm", "--json")
    document = json.loads(done.stdout)
    assert done.exit_code == 0
    assert document["extremes"]["C.transmission_rad"]["max"] == pytest.approx(math.radians(135.0), abs=1e-6)


@pytest.mark.parametrize("speed", [1.0, -1.0])
def test_slow_stroke_is_the_slow_one_in_either_sense(speed):
    """It takes pi + 2 asin(125 / 275) of the turn, whichever way the crank turns."""
    result = optlink.analyze(optlink.load("shaper"), points=3600, speed=speed)
    share = 0.5 + math.asin(125.0 / 275.0) / math.pi
    assert np.mean(result["cutting.fx_N"][:-1] != 0.0) == pytest.approx(share, abs=5e-4)
    assert np.all(result["cutting.fx_N"] * result["ram.v_m_s"] <= 0.0)
    assert result.work == pytest.approx(5880.0 * 1.2 * 125.0 / 275.0, rel=1e-11)


def test_slider_that_stands_still_does_not_reverse_with_every_rounding():
    """Crank and rod of one length: the slider rests on the crank's pivot for half a turn."""
    raw = dict(offset_slider_crank(0.0).raw)
    raw["mechanism"] = {
        **raw["mechanism"],
        "links": {**raw["mechanism"]["links"], "rod": {"joints": ["B", "C"], "length": "0.1 m"}},
    }
    raw["loads"] = {"drag": {"on": "slider", "force": "3 N", "acts": "opposing"}}
    result = optlink.analyze(optlink.read(raw), points=36)
    assert len(result.jumps) <= 4
    machine = result.machine
    stroke = cycle.travels(machine.mechanism, machine.sizes, result.low, result.high, True)[1]["F"]
    assert len(stroke.dead_centres) <= 4
    assert stroke.span == pytest.approx(0.2, abs=1e-9)
    assert np.degrees(result.singular) == pytest.approx([90.0, 270.0])  # where it may go either way


# --- regressions -----------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_friction_without_normal_force_does_not_jam():
    """A slider-crank without gravity: the guide is not loaded at its dead centres."""
    result = optlink.analyze(optlink.load("slider-crank").override({"mechanism.guides.F.friction": 0.1}), points=36)
    assert result.valid
    assert np.all(np.isfinite(result["input.work_J"]))
    np.testing.assert_allclose(np.abs(result["F.friction_N"]), 0.1 * np.abs(result["F.normal_N"]), rtol=1e-9, atol=1e-9)
    still = optlink.simulate(optlink.load("slider-crank").override({"mechanism.guides.F.friction": 0.1}), duration=0.2)
    assert still.ending.value == "finished"


def test_friction_that_jams_between_the_rows_is_reported_and_has_no_extremes_of_forces():
    """A massless rod at the angle beta pushes a slider against F: S (cos beta - mu sin beta) = F, which jams for mu tan beta > 1.

    Where F pulls the slider along, S = -F / (cos beta + mu sin beta) and S = F / (mu sin beta - cos beta) satisfy the law there.
    """
    raw = {
        "title": "wedge",
        "mechanism": {
            "ground": {"A": ["0 m", "0 m"]},
            "links": {
                "crank": {"joints": ["A", "B"], "length": "0.1 m"},
                "rod": {"joints": ["B", "E"], "length": "0.3 m"},
                "slider": {"joints": ["E"]},
            },
            "guides": {"F": {"slider": "slider", "through": "A", "friction": 3.0}},
            "assembly": {"E": "forward"},
        },
        "bodies": {"crank": {"mass": "1 kg", "inertia": "0.1 kg*m^2"}},
        "loads": {"press": {"on": "slider", "force": "100 N", "direction": "180 deg"}},
        "drive": {"start": "30 deg", "speed": "10 rad/s", "fluctuation": 0.02},
    }
    result = optlink.analyze(optlink.read(raw), points=4)
    assert np.all(np.isfinite(result["input.torque_Nm"]))  # all rows lie beside the ranges
    edge = np.degrees(np.arcsin(np.sin(np.arctan(1 / 3.0)) / (0.1 / 0.3)))
    inside = np.sort(np.degrees(result.jammed) % 360.0)
    expected = np.r_[np.arange(0.0, 360.0, 0.5)]
    expected = expected[np.abs(np.sin(np.radians(expected))) > np.sin(np.radians(edge))]
    np.testing.assert_allclose(inside, expected, atol=1e-9)
    assert not result.valid
    text = " ".join(result.notes)
    assert "friction jams a guide: no forces satisfy its law at crank angle 252" in text
    assert "different forces satisfy the law of friction, so they are not determined, at crank angle 72" in text
    assert {"input.torque_Nm", "F.normal_N", "B.f_N", "input.work_J"}.isdisjoint(result.extremes)  # S is unbounded at the edges
    assert result.extremes["slider.s_m"].largest == pytest.approx(0.4)
    assert math.isnan(result.work)
    assert result.flywheel is None  # its search did not end
    smooth = optlink.analyze(optlink.read(raw).override({"mechanism.guides.F.friction": 2.8}), points=4)
    assert smooth.valid
    sine = 1 / 3.0
    cosine = math.sqrt(1.0 - sine * sine)
    normal = 100.0 * sine / (cosine - 2.8 * sine)
    assert smooth.extremes["F.normal_N"].least == pytest.approx(-normal, rel=1e-9)


def test_load_without_a_value_between_the_rows_is_reported_and_has_no_extremes():
    force = {"expression": "100*sqrt(0.9+cos(phi))", "unit": "N"}
    problem = optlink.load("slider-crank").override(
        {"loads.press": {"on": "slider", "force": force}, "drive.fluctuation": 0.02, "drive.start": "30 deg"}
    )
    result = optlink.analyze(problem, points=3)
    assert np.all(np.isfinite(result["input.torque_Nm"]))
    np.testing.assert_allclose(np.degrees(result.undefined), np.arange(154.5, 206.0, 0.5), atol=1e-9)  # arccos(-0.9) = 154.16
    assert "press has no finite value at crank angle 154.5, 155," in result.notes[0]
    assert {"input.torque_Nm", "press.fx_N", "B.f_N"}.isdisjoint(result.extremes)
    assert result.flywheel is None
    assert not result.valid


def on_the_crank(torque):
    """The slider-crank with a torque on its crank over a revolution from 30 deg."""
    changes = {
        "loads.brake": {"on": "crank", "torque": {"expression": torque, "unit": "N*m"}},
        "drive.fluctuation": 0.02,
        "drive.start": "30 deg",
    }
    return optlink.load("slider-crank").override(changes)


@pytest.mark.parametrize(
    ("torque", "poles"),
    [
        ("1/(theta - 1.0)", [1.0]),  # two infinite ends of opposite sign
        ("1e-6/(1 - cos(phi - 2.0))", [2.0]),  # its denominator touches zero
        ("(1 + cos(phi - 0.1))^-0.5", [math.pi + 0.1]),
        ("tan(phi)", [0.5 * math.pi, 1.5 * math.pi]),
        ("log(abs(sin(phi/2 - 0.5)))", [1.0]),
    ],
)
def test_load_with_a_pole_between_the_rows_is_reported_and_has_no_extremes(torque, poles):
    result = optlink.analyze(on_the_crank(torque), points=77)
    assert np.all(np.isfinite(result["input.torque_Nm"]))
    np.testing.assert_allclose(result.undefined, poles, atol=1e-6)
    where = ", ".join(f"{math.degrees(pole):.6g}" for pole in poles)
    assert result.notes[0] == f"brake grows without bound at crank angle {where} deg"
    assert {"input.torque_Nm", "brake.torque_Nm", "input.work_J"}.isdisjoint(result.extremes)
    assert {"slider.s_m", "B.f_N"} <= set(result.extremes)  # they do not depend on it
    assert not result.valid
    assert math.isnan(result.work)
    assert result.flywheel is None


def test_sweep_of_a_machine_with_a_pole_in_a_load_has_no_figures():
    table = sweep(on_the_crank("1/(theta - 1.0)"), ["mechanism.links.rod.length=300..310 mm:2"], analyze=True)
    assert list(table.columns["status"]) == ["no finite reactions"] * 2
    assert "a load has no finite value at crank angle 57.2958 deg" in table.columns["reason"][0]


@pytest.mark.parametrize(
    ("torque", "integral", "largest"),
    [
        ("sin(phi - 1.0)^2/sin(phi/2 - 0.5)^2", 2.0 * TURN, 4.0),  # no pole
        ("5 + 5*abs(sin(phi - 1.0))/sin(phi - 1.0)", 5.0 * TURN, 10.0),  # jumps
        ("2/(phi/2 - 1.0001)^0", 2.0 * TURN, 2.0),
        ("1/(4*sin(phi/2 - 0.5)^2 + 1e-8)", TURN / math.sqrt(4e-8 + 1e-16), 1e8),  # a peak of 0.006 deg
        ("abs(cos(phi))", 4.0, 1.0),
    ],
)
def test_work_and_extremes_of_a_load_with_corners_jumps_and_peaks(torque, integral, largest):
    result = optlink.analyze(on_the_crank(torque).override({"bodies": {}}), points=8)
    assert result.valid
    assert result.work == pytest.approx(-integral, rel=1e-11)
    assert result.extremes["brake.torque_Nm"].largest == pytest.approx(largest, rel=1e-9)


@pytest.mark.parametrize("start", ["0 deg", "30 deg"])
@pytest.mark.parametrize(
    ("at", "values", "work"),
    [
        ((0, 360), (0, 100), 100 * math.pi),  # a sawtooth
        ((0, 90, 360), (0, 5, 10), 2.5 * math.pi / 2 + 7.5 * math.pi * 3 / 2),
        ((-180, 180), (-30, 50), 20 * math.pi),
        ((20, 100, 380), (-50, 30, 40), -10 * math.radians(80) + 35 * math.radians(280)),
        ((0, 359.9, 360), (0, 1, 300), 0.5 * math.radians(359.9) + 150.5 * math.radians(0.1)),
    ],
)
def test_a_load_table_of_a_revolution_may_jump_at_its_end(start, at, values, work):
    table = {"over": "phi", "at": [f"{angle} deg" for angle in at], "values": [f"{value} N*m" for value in values]}
    changes = {"loads.brake": {"on": "crank", "torque": table}, "bodies": {}, "drive.start": start}
    problem = optlink.load("slider-crank").override(changes)
    result = optlink.analyze(problem, points=8)
    assert result.work == pytest.approx(-work, rel=1e-11)
    outcome = result.extremes["brake.torque_Nm"]
    assert (outcome.least, outcome.largest) == pytest.approx((min(values), max(values)), rel=1e-6)
    load, phi, angle = problem.model.loads["brake"].torque, np.linspace(-7.0, 14.0, 500), casadi.SX.sym("angle")
    with symbols_in_numpy():
        traced = casadi.Function("table", [angle], [load({"phi": angle})])
    np.testing.assert_allclose(load({"phi": phi}), np.asarray(traced(phi[None, :]))[0], atol=1e-9)


def tangent_mechanism(height):
    """A slot on the crank, a pin in it that slides on a rail: x = height cot(phi), nowhere at 0 and 180 degrees."""
    return optlink.read(
        {
            "title": "tangent mechanism",
            "mechanism": {
                "ground": {"A": ["0 m", "0 m"]},
                "links": {"crank": {"joints": ["A"]}, "block": {"joints": ["C"]}, "bar": {"joints": ["C"]}},
                "guides": {
                    "slot": {"slider": "block", "on": "crank"},
                    "rail": {"slider": "bar", "on": "frame", "through": ["0 m", f"{height} m"]},
                },
            },
            "drive": {"start": "50 deg"},
            "bodies": {"bar": {"mass": "1 kg"}},
        }
    )


@pytest.mark.parametrize("turned", [0.0, 0.1234567])
def test_lines_that_become_parallel_between_two_positions_end_the_range(turned):
    problem = tangent_mechanism(0.2)
    raw = dict(problem.raw)
    raw["mechanism"] = {**raw["mechanism"], "guides": {**raw["mechanism"]["guides"]}}
    raw["mechanism"]["guides"]["rail"] = {**raw["mechanism"]["guides"]["rail"], "direction": f"{turned} deg"}
    result = optlink.analyze(optlink.read(raw), points=20)
    assert not result.full
    ends = np.degrees(result.ranges.ranges).ravel() % 180.0
    assert all(min(abs(end - turned), abs(end - turned - 180.0)) < 1e-3 for end in ends)
    if not turned:
        np.testing.assert_allclose(result["C.x_m"], 0.2 / np.tan(np.radians(result["crank_angle_deg"])), rtol=1e-12)
    assert optlink.simulate(optlink.read(raw), duration=4.0, rows=10).ending.value == "dead position"


def test_a_singular_start_ends_the_simulation():
    raw = {
        "title": "parallelogram",
        "mechanism": {"type": "four-bar", "crank": "0.1 m", "coupler": "0.3 m", "rocker": "0.1 m", "frame": "0.3 m"},
        "bodies": {"coupler": {"mass": "1 kg", "inertia": "uniform bar"}},
        "drive": {"torque": "1 N*m", "duration": "1 s"},
    }
    result = optlink.simulate(optlink.read(raw), rows=5)
    assert result.ending.value == "singular position"
    assert not result.valid


def test_internal_force_pushes_on_the_body_that_carries_the_guide():
    """Oil between piston and cylinder: on the pivot of the cylinder the whole force is felt; from outside it is not."""
    raw = {
        "title": "cylinder",
        "mechanism": {
            "ground": {"A": ["0 m", "0 m"], "D": ["0.22 m", "0 m"]},
            "links": {
                "crank": {"joints": ["A", "B"], "length": "0.06 m"},
                "piston": {"joints": ["B"]},
                "cylinder": {"joints": ["D"]},
            },
            "guides": {"G": {"slider": "piston", "on": "cylinder"}},
            "assembly": {"G": "forward"},
        },
        "loads": {"oil": {"on": "piston", "force": "1000 N", "against": "cylinder"}},
    }
    inside = optlink.analyze(optlink.read(raw), points=12)
    np.testing.assert_allclose(np.hypot(inside["D.fx_N"], inside["D.fy_N"]), 1000.0, rtol=1e-12)
    np.testing.assert_allclose(inside["D.fx_N"], -inside["A.fx_N"], atol=1e-9)
    slide, torque = inside["piston.v_m_s"], inside["input.torque_Nm"]
    np.testing.assert_allclose(torque * inside.speed, -1000.0 * slide, atol=1e-9)
    del raw["loads"]["oil"]["against"]
    outside = optlink.analyze(optlink.read(raw), points=12)
    np.testing.assert_allclose(np.hypot(outside["D.fx_N"], outside["D.fy_N"]), 0.0, atol=1e-9)


def test_torsion_spring_across_the_branch_of_the_angle():
    """The rocker swings about 180 degrees from +x; a spring that is free there stays linear across it."""
    raw = {
        "title": "four-bar that swings about -x",
        "mechanism": {"type": "four-bar", "crank": "0.1 m", "coupler": "0.3 m", "rocker": "0.25 m", "frame": "0.3 m"},
        "loads": {"spring": {"on": "rocker", "torsional_stiffness": "10 N*m/rad", "free_angle": "-60 deg"}},
    }
    result = optlink.analyze(optlink.read(raw), points=90)
    rocker = np.unwrap(result["rocker.angle_rad"])
    computed = -result["spring.torque_Nm"] / 10.0
    np.testing.assert_allclose(np.diff(computed), np.diff(rocker), atol=1e-12)
    assert abs(result.work) < 1e-9
    np.testing.assert_allclose(np.remainder(computed - rocker - math.radians(60.0) + 1.0, TURN), 1.0, atol=1e-9)


@pytest.mark.parametrize("direction", [0.0, 70.0, 100.0])
def test_a_torque_over_theta_is_continuous_where_its_body_swings_across_180_degrees(direction):
    """A torque proportional to theta is that of a torsion spring: it has no work over a revolution, in any direction."""
    x, y = 300.0 * math.cos(math.radians(direction)), 300.0 * math.sin(math.radians(direction))
    links = {"crank": {"joints": ["A", "B"], "length": "40 mm"}, "coupler": {"joints": ["B", "C"], "length": "290 mm"}}
    links["rocker"] = {"joints": ["D", "C"], "length": "160 mm"}
    mechanism = {"ground": {"A": ["0 mm", "0 mm"], "D": [f"{x!r} mm", f"{y!r} mm"]}, "links": links}
    mechanism |= {"assembly": {"C": "left of B-D"}}
    load = {"on": "rocker", "torque": {"expression": "-5*theta", "unit": "N*m"}}
    result = optlink.analyze(optlink.read({"mechanism": mechanism, "loads": {"spring": load}}), points=90)
    torque, rocker = result["spring.torque_Nm"], np.unwrap(result["rocker.angle_rad"])
    np.testing.assert_allclose(np.diff(torque), -5.0 * np.diff(rocker), atol=1e-12)
    assert abs(-np.mean(torque) / 5.0) < math.pi
    assert abs(result.work) < 1e-9


def test_torsion_spring_across_the_branch_of_the_angle_in_a_batch():
    """Turned by 70 degrees, the rocker swings across 180 degrees from +x; a batch has the torques of its single designs."""
    x, y = 0.3 * math.cos(math.radians(70.0)), 0.3 * math.sin(math.radians(70.0))
    links = {"crank": {"joints": ["A", "B"], "length": "40 mm"}, "coupler": {"joints": ["B", "C"], "length": "290 mm"}}
    links["rocker"] = {"joints": ["D", "C"], "length": "160 mm"}
    ground = {"A": ["0 m", "0 m"], "D": [f"{x!r} m", f"{y!r} m"]}
    raw = {
        "mechanism": {"ground": ground, "links": links, "assembly": {"C": "left of B-D"}},
        "loads": {"spring": {"on": "rocker", "torsional_stiffness": "5 N*m/rad", "free_angle": "-170 deg"}},
    }
    problem, cranks = optlink.read(raw), [0.04, 0.045]
    batch = optlink.analyze_batch(problem, {"crank.length": np.array(cranks)}, points=90)
    for crank, torque in zip(cranks, batch["input.torque_Nm"], strict=True):
        alone = optlink.analyze(problem.override({"mechanism.links.crank.length": f"{crank!r} m"}), points=90)
        np.testing.assert_allclose(torque, alone["input.torque_Nm"][: len(torque)], atol=1e-12)


@pytest.mark.parametrize(
    "load", [{"torque": {"expression": "5*theta", "unit": "N*m"}}, {"torsional_stiffness": "5 N*m/rad", "free_angle": "-60 deg"}]
)
def test_a_design_of_a_batch_has_the_branch_of_the_angle_that_it_has_alone(load):
    """The swings lie on both sides of 180 degrees from +x and across it; one design cannot be assembled."""
    sizes = {"crank": "100 mm", "coupler": "400 mm", "rocker": "300 mm", "frame": "400 mm"}
    mechanism = {"type": "four-bar", **sizes, "direction": "0 deg"}
    problem = optlink.read({"mechanism": mechanism, "loads": {"load": {"on": "rocker", **load}}})
    directions, rockers = [0.0, 30.0, 75.0, 170.0, 170.0, 250.0, 340.0], [0.3, 0.3, 0.3, 0.3, 2.0, 0.48, 0.22]
    columns, designs = ("load.torque_Nm", "input.torque_Nm"), {"direction": np.radians(directions), "rocker": np.array(rockers)}
    batch = optlink.analyze_batch(problem, designs, columns, points=36)
    for row, (direction, rocker) in enumerate(zip(directions, rockers, strict=True)):
        if row == 4:
            assert np.all(np.isnan(batch["input.torque_Nm"][row]))
            continue
        alone = optlink.analyze(problem, 36, design={"direction": math.radians(direction), "rocker": rocker})
        for name in columns:
            np.testing.assert_allclose(batch[name][row], alone[name][:36], atol=1e-12, err_msg=f"{name}, {direction} deg")


@pytest.mark.parametrize("mode", ["left", "right"])
def test_a_crank_that_turns_fast_against_the_rocker_near_alignment_turns_fully(mode):
    """The relative angle changes by more than 0.02 rad from sample to sample, and the samples do not close the revolution."""
    sizes = {"crank": "232 mm", "coupler": "262 mm", "rocker": "330 mm", "frame": "302.5 mm"}
    spring = {"on": "crank", "against": "rocker", "torsional_stiffness": "5 N*m/rad"}
    with pytest.raises(optlink.InputError, match="crank turns fully against rocker"):
        optlink.read({"mechanism": {"type": "four-bar", **sizes, "assembly": mode}, "loads": {"spring": spring}})
    swinging = {**spring, "on": "rocker", "against": "frame"}
    assert optlink.read({"mechanism": {"type": "four-bar", **sizes, "assembly": mode}, "loads": {"spring": swinging}})


@pytest.mark.parametrize(("rocker", "full"), [("292.6 mm", True), ("250 mm", False)])
def test_work_is_exact_near_alignment_and_near_the_ends_of_a_limited_range(rocker, full):
    """The drive's work is the change of the kinetic energy: nothing else takes or gives any."""
    sizes = {"crank": "232 mm", "coupler": "262 mm", "rocker": rocker, "frame": "302.5 mm"}
    bodies = {name: {"mass": "2 kg", "inertia": "uniform bar"} for name in ("crank", "coupler", "rocker")}
    mechanism = {"type": "four-bar", **sizes, "assembly": "right"}
    result = optlink.analyze(optlink.read({"mechanism": mechanism, "bodies": bodies, "drive": {"start": "90 deg"}}))
    energy, work = result["energy.kinetic_J"], result["input.work_J"]
    assert result.full is full
    np.testing.assert_allclose(work, energy - energy[0], rtol=0.0, atol=1e-9 * np.max(np.abs(energy)))


def test_extremes_at_a_dead_centre_with_load_jumps_are_one_sided():
    """Ram, its friction and a drag reverse with the arm; a normal force that changes its sign by the jump has no corner there."""
    mechanism = {
        "ground": {"A": ["0.1 m", "-0.05 m"], "D": ["-0.259 m", "0.1252 m"]},
        "links": {
            "crank": {"joints": ["A", "B"], "length": "0.1188 m"},
            "block": {"joints": ["B"]},
            "arm": {"joints": ["D", "T"], "length": "0.3548 m"},
            "rod": {"joints": ["T", "E"], "length": "0.8015 m"},
            "ram": {"joints": ["E"]},
        },
        "guides": {
            "G": {"slider": "block", "on": "arm", "through": "D", "offset": "-0.014 m", "friction": 0.215},
            "F": {"slider": "ram", "direction": "249.7 deg", "through": ["-0.586 m", "0.254 m"], "friction": 0.2},
        },
        "assembly": {"G": "forward", "E": "forward"},
    }
    drag = {"on": "crank", "at": "A", "force": "10.49 N", "direction": "-91.4 deg", "acts": "opposing", "against": "rod"}
    loads = {"drag": drag, "spring": {"between": ["A", "E"], "stiffness": "47 N/m", "free_length": "76 mm"}}
    bodies = {"arm": {"mass": "1.34 kg", "inertia": "0.042 kg*m^2"}}
    result = optlink.analyze(
        optlink.read({"mechanism": mechanism, "bodies": bodies, "loads": loads, "drive": {"speed": "2.745 rad/s"}})
    )
    work = Work(result.machine, result.low, result.low, result.high, result.speed)
    apart = np.abs(work.breaks[:, None] - result.jumps)
    assert not np.any((apart > 0.0) & (apart < 1e-8))
    beside = np.concatenate([result.jumps + gap for gap in (-1e-7, 1e-7)])
    angles = np.concatenate([np.linspace(result.low, result.high, 4001), beside])
    torque = MotionColumns(result.machine.moving(angles, result.speed))["input.torque_Nm"]
    extreme = result.extremes["input.torque_Nm"]
    assert extreme.least == pytest.approx(np.min(torque), abs=1e-4 * np.ptp(torque))
    assert extreme.largest == pytest.approx(np.max(torque), abs=1e-4 * np.ptp(torque))


def test_immovable_outputs_are_refused():
    fault = {"loads.spring": {"on": "crank", "torsional_stiffness": "1 N*m/rad"}}
    with pytest.raises(optlink.InputError, match="turns fully against frame"):
        optlink.load("slider-crank", fault)
    with pytest.raises(optlink.InputError, match="does not turn"):
        optlink.load("slider-crank", {"loads.brake": {"on": "slider", "torque": "1 N*m", "acts": "opposing"}})


@pytest.mark.skipif(os.name != "posix", reason="pipes of POSIX; links need a privilege on Windows")
def test_table_is_written_into_a_pipe_and_through_a_link(tmp_path):
    import threading

    from optlink.presentation.files import write_csv

    pipe, link, real = tmp_path / "pipe", tmp_path / "link.csv", tmp_path / "real.csv"
    os.mkfifo(pipe)
    got: list[str] = []
    reader = threading.Thread(target=lambda: got.append(pipe.read_text()))
    reader.start()
    write_csv(pipe, {"a": [1.0], "b": [math.nan]})
    reader.join(10.0)
    assert got == ["a,b\n1.0,\n"]
    real.write_text("old")
    link.symlink_to(real)
    write_csv(link, {"a": [2.0]})
    assert link.is_symlink()
    assert real.read_text() == "a\n2.0\n"


def test_internal_drag_opposes_the_relative_motion():
    """A drag in x between crank and rocker of a double-crank takes energy from the two together, whichever is faster."""
    raw = {
        "title": "drag link with a drag between crank and rocker",
        "mechanism": {"type": "four-bar", "crank": "0.25 m", "coupler": "0.28 m", "rocker": "0.3 m", "frame": "0.1 m"},
        "loads": {
            "drag": {"on": "crank", "at": "B", "force": "5 N", "direction": "0 deg", "acts": "opposing", "against": "rocker"}
        },
    }
    result = optlink.analyze(optlink.read(raw), points=90)
    at = np.stack([result["B.x_m"] - 0.1, result["B.y_m"]])  # of the rocker's pivot D
    relative = result["B.vx_m_s"] + result["rocker.omega_rad_s"] * at[1]
    power = result["drag.fx_N"] * relative
    assert np.all(power <= 1e-12)
    np.testing.assert_allclose(result["input.power_W"], -power, atol=1e-9)
    assert np.any(result["drag.fx_N"] * result["B.vx_m_s"] > 1e-3)  # against the frame alone it would be another sign


@pytest.mark.parametrize(
    ("name", "speed", "joint"), [pytest.param("six-bar", 35.0, "E", marks=pytest.mark.slow), ("whitworth", 32.0, "C")]
)
def test_least_joint_force_is_found_where_the_force_almost_vanishes(name, speed, joint):
    """Two sharp minima: between even positions the deeper one may look the higher."""
    result = optlink.analyze(optlink.load(name), points=36_000, speed=speed)
    least = float(np.min(np.hypot(result[f"{joint}.fx_N"], result[f"{joint}.fy_N"])))
    assert 0.9 * least <= result.extremes[f"{joint}.f_N"].least <= least * (1.0 + 1e-9)


@pytest.mark.parametrize(
    ("torque", "speed", "where"),
    [
        ("log(abs(phi - 2.0))", 30.0, "114.592"),  # integrable: the integrator steps over it
        ("log(abs(phi + 2.0))", -30.0, "-114.592"),
        ("1/sqrt(abs(phi - 2.0))", 30.0, "114.592"),  # it stops before
        ("log(abs(theta - 1.0))", 30.0, "57.2958"),
        ("log(abs(phi - 9.0))", 30.0, None),  # beyond the end
        ("1e-3*log(abs(phi - 2.0))", "torque", "114.592"),
    ],
)
def test_a_simulation_names_loads_that_grow_without_bound(torque, speed, where):
    driven = speed == "torque"
    problem = on_the_crank(torque).override({"drive.start": "0 deg", "drive.torque": "20 N*m" if driven else None})
    result = optlink.simulate(problem, 0.22, 10, None if driven else speed)
    computed = [note for note in result.notes if "grows without bound" in note]
    words = f"brake grows without bound at crank angle {where} deg: forces and torque have no largest value there"
    assert computed == ([words] if where else [])


# --- memory and effort -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", mostly_slow(["six-bar", "shaper", "toggle-press"], "six-bar"))
def test_extremes_are_refined_only_where_they_are_read(name, monkeypatch):
    """One column at a time has the digits of all together, whatever the order of reading."""
    refined = []
    whole = SampledFunctions.extremes

    def counted(self, rows, *others):
        refined.append(len(rows))
        return whole(self, rows, *others)

    monkeypatch.setattr(SampledFunctions, "extremes", counted)
    problem = optlink.load(name)
    together = dict(optlink.analyze(problem, points=10).extremes.items())
    assert refined == [len(together) - 1]  # all but the work of the drive
    refined.clear()
    alone = optlink.analyze(problem, points=10).extremes
    assert refined == []
    assert list(alone) == list(together)
    for column in sorted(together, reverse=True)[::5]:
        assert alone[column] == together[column]
        assert alone[column] == alone.get(column)
    assert set(refined) <= {1}
    assert len(refined) <= 1 + len(together) // 5
    assert "no such column" not in alone
    assert pickle.loads(pickle.dumps(alone))["input.torque_Nm"] == together["input.torque_Nm"]


@pytest.mark.parametrize("points", mostly_slow([3_000, 25_000], 3_000))
def test_a_long_table_takes_little_more_memory_than_its_columns(points):
    problem = optlink.load("six-bar")
    optlink.analyze(problem, points=10)
    tracemalloc.start()
    result = optlink.analyze(problem, points=points)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    size = sum(column.nbytes for column in result.columns.values())
    assert peak < 3.0 * size + 20e6  # that of a block, whatever the length


def test_angles_of_a_long_table_are_continuous_over_its_blocks():
    result = optlink.analyze(optlink.load("crank-rocker-clearance"), points=5_000, speed=-7.0)
    few = optlink.analyze(optlink.load("crank-rocker-clearance"), points=500, speed=-7.0)
    for name in (name for name in result.columns if name.endswith(".angle_rad")):
        assert np.max(np.abs(np.diff(result[name]))) < 0.02
        np.testing.assert_allclose(result[name][::10], few[name], rtol=0.0, atol=1e-13)


def test_a_batch_marks_the_designs_that_close_and_has_a_row_for_each() -> None:
    lengths = {"coupler.length": [0.14, 1e-4, 0.16]}  # the second one closes nowhere
    batch = optlink.analyze_batch("shaper", lengths, ["input.torque_Nm", "crank.angle_rad"])
    assert batch.valid.tolist() == [True, False, True]
    frame = batch.to_frame()
    assert frame["valid"].tolist() == batch.valid.tolist()
    assert frame["coupler.length_m"].tolist() == lengths["coupler.length"]
    assert frame.attrs["units"]["coupler.length_m"] == "m"
    torque = batch["input.torque_Nm"]
    assert frame["input.torque_Nm.max"].tolist()[::2] == torque.max(axis=1).tolist()[::2]
    assert frame["input.torque_Nm.min"].tolist()[::2] == torque.min(axis=1).tolist()[::2]
    assert frame["input.torque_Nm.rms"][2] == pytest.approx(np.sqrt(np.mean(torque[2] ** 2)))
    assert frame["input.torque_Nm.max"].isna().tolist() == [False, True, False]
    assert frame.attrs["units"]["input.torque_Nm.rms"] == "N m"
    in_file = batch.to_frame(units="file")
    assert in_file["crank.angle_deg.max"].tolist()[::2] == np.degrees(frame["crank.angle_rad.max"]).tolist()[::2]
    assert in_file.attrs["units"]["crank.angle_deg.max"] == "deg"
    with pytest.raises(optlink.UnknownName, match=r'no column input\.torque.*Did you mean "input\.torque_Nm"'):
        _ = batch["input.torque"]
    assert repr(batch) == "<BatchAnalysis 'shaper': input.torque_Nm, crank.angle_rad; 2 of 3 designs valid>"
    other = optlink.analyze_batch("crank-rocker", {"coupler": [0.42]}, ["rocker.angle_rad"], 12).to_frame(units="file")
    assert {"coupler_mm", "rocker.angle_deg.max"} < {*other}
    assert other["coupler_mm"][0] == pytest.approx(420.0)


def test_a_number_is_that_of_all_designs() -> None:
    lengths = [0.14, 0.16]
    keys = {"mechanism.coupler.length": lengths, "crank.length": 0.12}
    one, other = (
        optlink.analyze_batch("shaper", given, ["B.x_m"], 12)
        for given in (keys, {"coupler.length": lengths, "crank.length": [0.12] * 2})
    )
    np.testing.assert_array_equal(one["B.x_m"], other["B.x_m"])
