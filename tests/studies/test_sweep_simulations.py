"""Sweeps of simulations: clearance, friction and speed varied, the same rows however they are computed."""

from __future__ import annotations

import csv
import math

import pytest
from typer.testing import CliRunner

import optlink
from optlink.cli.app import app
from optlink.errors import InputError
from optlink.studies import sweep
from optlink.tasks.clearance import simulate_clearance

OPTIONS = {"revolutions": 1, "points": 60}


@pytest.mark.slow
def test_clearance_varied_over_simulations_gives_the_figures_of_single_runs(tmp_path):
    file = optlink.load("slider-crank-clearance")
    (joint,) = (name for name, section in file.model.joints.items() if section.has_clearance)
    vary = [f"joints.{joint}.clearance=0.2, 0.4 mm"]
    one = sweep(file, vary, tmp_path / "one", simulate=OPTIONS, workers=1)
    assert one.valid
    for i, gap in enumerate((0.2, 0.4)):
        single = simulate_clearance(file.override({f"joints.{joint}.clearance": f"{gap} mm"}), 1, 60, check_predictability=False)
        assert one.columns["largest_normal_N"][i] == single.figures["largest_normal_N"]
    two = sweep(file, vary, tmp_path / "two", simulate=OPTIONS, workers=2)
    assert two.path.read_bytes() == one.path.read_bytes()
    assert sweep(file, vary, tmp_path / "one", simulate=OPTIONS, workers=1, resume=True).points_done_now == 0
    with pytest.raises(InputError, match="another study"):
        sweep(file, vary, tmp_path / "one", simulate={**OPTIONS, "points": 72}, workers=1, resume=True)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("key", "values", "unit"), [("drive.speed", (100.0, 200.0), " rpm"), ("joints.C.friction", (0.0, 0.1), "")]
)
def test_the_command_varies_speed_and_friction_of_a_machine_with_clearance(key, values, unit, tmp_path):
    vary = f"{key}={values[0]!r}, {values[1]!r}{unit}"
    arguments = ["slider-crank-clearance", "--simulate", "--vary", vary, "--revolutions", "1", "--points", "60", "--workers", "1"]
    done = CliRunner().invoke(app, ["study", "sweep", *arguments, "--out", str(tmp_path / "run")])
    assert done.exit_code == 0, done.output
    with (tmp_path / "run" / "sweep.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["status"] for row in rows] == ["finished"] * 2
    for row, value in zip(rows, values, strict=True):
        varied = optlink.load("slider-crank-clearance", {key: f"{value!r}{unit}" if unit else value})
        single = simulate_clearance(varied, 1, 60, check_predictability=False)
        for name in ("largest_normal_N", "C.friction.work_J", "drive.work_J"):
            assert float(row[name]) == single.figures[name]
    low, high = ({name: float(row[name]) for name in ("largest_normal_N", "C.friction.work_J")} for row in rows)
    if key == "drive.speed":  # forces of inertia grow with the square of the speed
        assert high["largest_normal_N"] > low["largest_normal_N"]
    else:
        assert low["C.friction.work_J"] == 0.0 < high["C.friction.work_J"]


def test_torque_varied_over_simulations_of_an_ideal_machine():
    """Without load the work of a constant torque is torque times angle, and a larger one turns it further."""
    result = sweep(optlink.load("slider-crank"), ["drive.torque=0.1, 0.2 N*m"], simulate={}, workers=1)
    table = result.columns
    assert table["status"].tolist() == ["finished", "finished"]
    for i, torque in enumerate((0.1, 0.2)):
        assert table["input.work_J"][i] == pytest.approx(torque * table["end.crank_angle_rad"][i], rel=1e-6)
    assert table["end.crank_angle_rad"][1] > table["end.crank_angle_rad"][0]


def test_points_that_cannot_be_simulated_are_rows_with_a_reason():
    """A rod shorter than the crank stops it: at sin(phi) = rod / crank the crank can go no further."""
    vary = ["mechanism.links.rod.length=0.3, 0.05 m"]
    table = sweep(optlink.load("slider-crank"), vary, simulate={}, workers=1).columns
    assert table["valid"].tolist() == [True, False]
    assert table["reason"][1]
    assert abs(table["end.crank_angle_rad"][1]) == pytest.approx(math.pi / 6, abs=1e-3) or not math.isfinite(
        table["end.crank_angle_rad"][1]
    )


def test_the_command_simulates_a_sweep_and_refuses_options_without_it():
    def run(*arguments: str):
        return CliRunner().invoke(app, ["study", "sweep", "slider-crank", "--vary", "drive.torque=0.1, 0.2 N*m", *arguments])

    done = run("--simulate", "--workers", "1")
    assert done.exit_code == 0, done.output
    assert "2 finished" in done.stdout
    refused = run("--revolutions", "3")
    assert refused.exit_code == 2
    assert "Add --simulate" in refused.output
    analysed = run("--analyze")
    assert analysed.exit_code == 2
    assert "Add --simulate" in " ".join(analysed.output.split())


def test_an_analysis_refuses_a_requirement_and_names_what_varies_it():
    with pytest.raises(InputError, match="Leave analyze out, to optimise at every point"):
        sweep(optlink.load("crank-rocker"), ["requirement.span=80..90 deg:2"], analyze=True)


@pytest.mark.parametrize("speed", ["1 rpm", "2 rpm", "7 rpm"])
def test_a_run_of_one_revolution_has_a_last_revolution_at_any_speed(speed):
    """Its end is one revolution within rounding: at 2 rpm the figures were missing."""
    result = optlink.simulate(optlink.load("crank-rocker", {"drive.speed": speed}))
    assert result.figures["last_turn.mean_speed_rad_s"] == pytest.approx(float(speed.split()[0]) * math.pi / 30.0)
