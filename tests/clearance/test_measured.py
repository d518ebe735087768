"""A measured series beside a simulation, and the inverse model alone: displacement in, crank speed out."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from typer.testing import CliRunner

import optlink
from optlink.cli.app import app
from optlink.errors import InputError
from optlink.studies import sweep
from tests.tiers import mostly_slow

POINTS, RPM = 72, 900.0
SPEED = RPM * math.pi / 30.0
PERIOD = 60.0 / RPM
WAVE = 0.2e-3  # [m, rad] added to the simulated output


def call(*words):
    return CliRunner().invoke(app, [*map(str, words)], env={"COLUMNS": "120"})


def written(path, **columns):
    lines = zip(*columns.values(), strict=True)
    path.write_text("\n".join([",".join(columns), *(",".join(f"{cell:.15g}" for cell in line) for line in lines)]) + "\n")
    return path


def simulated(problem, revolutions=3, **options):
    return optlink.control.simulate_clearance(
        problem, revolutions, POINTS, SPEED, tolerance=1e-8, check_predictability=False, integrator="cvodes", **options
    )


@pytest.fixture(scope="module")
def slider():
    return optlink.load("slider-crank-clearance", {"joints.C.clearance": "0.3 mm"})


@pytest.fixture(scope="module")
def plain(slider):
    return simulated(slider)


def last(run, column):
    """A column in the last revolution, with the row at its beginning."""
    return run[column][-POINTS - 1 :]


def waved(run):
    """Crank angle [rad] and output of the last revolution, with a known wave added, and the wave."""
    phase = 2.0 * math.pi * np.arange(POINTS + 1) / POINTS
    wave = WAVE * np.sin(3.0 * phase)
    return phase, last(run, run.output.column) + wave, wave


@pytest.mark.parametrize("form", mostly_slow(["time", "angle", "voltage", "column"], "column"))
def test_a_known_difference_is_found_again_in_every_form_of_the_series(tmp_path, slider, plain, form):
    phase, values, wave = waved(plain)
    keys = {}
    columns = {"time_s": phase / SPEED, "displacement_mm": 1e3 * values}
    if form == "angle":
        columns = {"angle_deg": np.degrees(phase), "displacement_m": values}
    elif form == "voltage":
        columns = {"crank_angle_deg": np.degrees(phase), "voltage_V": (values - 0.06) / 0.0125}
        keys = {"measured.per_volt": "12.5 mm", "measured.at_zero": "60 mm"}
    elif form == "column":
        columns = {"time_s": phase / SPEED, "other": phase, "slider.s_m": values}
        keys = {"measured.column": "slider.s"}
    file = written(tmp_path / "slide.csv", **columns)
    run = simulated(slider.override({"measured.csv": str(file), **keys}))
    figures, begin = run.figures, 2.0 * PERIOD
    assert figures["measured.rows"] == POINTS + 1
    assert figures["measured.rms_m"] == pytest.approx(math.sqrt(np.mean(wave**2)), rel=1e-6)
    assert figures["measured.peak_m"] == pytest.approx(np.max(np.abs(wave)), rel=1e-6)
    assert figures["measured.mean_m"] == pytest.approx(np.mean(wave), abs=1e-12)
    without = wave + last(run, "slider.error_m")
    assert figures["measured.ideal.rms_m"] == pytest.approx(math.sqrt(np.mean(without**2)), rel=1e-6)
    assert run.measured["time_s"] == pytest.approx(begin + phase / SPEED)
    assert run.measured["difference_m"] == pytest.approx(wave, abs=1e-10)
    assert run.figures["rms_m"] == plain.figures["rms_m"]


@pytest.mark.slow
def test_between_rows_the_simulation_is_interpolated(tmp_path, slider, plain):
    fine = optlink.control.simulate_clearance(slider, 3, 10 * POINTS, SPEED, tolerance=1e-8, check_predictability=False)
    rows = slice(-10 * POINTS + 5, None, 7)
    file = written(tmp_path / "slide.csv", time_s=fine["time_s"][rows], displacement_mm=1e3 * fine["slider.s_m"][rows])
    run = simulated(slider.override({"measured.csv": str(file)}))
    assert run.figures["measured.peak_m"] < 2e-5  # a line between two rows is up to 70 um off


@pytest.mark.slow
def test_an_angle_is_compared_across_its_jump(tmp_path):
    problem = optlink.load("crank-rocker-clearance")
    run = simulated(problem, 2)
    phase, values, wave = waved(run)
    turned = np.degrees(np.remainder(values + math.pi / 3.0, 2.0 * math.pi) - math.pi / 3.0)  # another range than -180..180
    file = written(tmp_path / "angle.csv", time_s=phase / SPEED, displacement_deg=turned)
    again = simulated(problem.override({"measured.csv": str(file)}), 2)
    assert again.figures["measured.rms_rad"] == pytest.approx(math.sqrt(np.mean(wave**2)), rel=1e-6)


@pytest.mark.slow
def test_rows_before_the_counted_revolutions_are_left_out(tmp_path, slider):
    long = simulated(slider, 12)
    file = written(tmp_path / "slide.csv", time_s=long["time_s"], displacement_mm=1e3 * long["slider.s_m"])
    run = simulated(slider.override({"measured.csv": str(file)}), 12)
    assert run.figures["measured.rows"] == 7 * POINTS
    assert run.figures["measured.ideal.rms_m"] == pytest.approx(run.figures["rms_m"], rel=1e-9)
    assert run.figures["measured.peak_m"] < 1e-12


@pytest.mark.slow
def test_a_sweep_finds_the_clearance_of_a_measured_series(tmp_path, slider, plain):
    phase, values = waved(plain)[0], last(plain, "slider.s_m")
    file = written(tmp_path / "slide.csv", time_s=phase / SPEED, displacement_mm=1e3 * values)
    options = {"revolutions": 3, "points": POINTS, "speed": SPEED}
    result = sweep(slider.override({"measured.csv": str(file)}), ["joints.C.clearance=0.2..0.4 mm:3"], simulate=options)
    rms = result.columns["measured.rms_m"]
    assert np.argmin(rms) == 1
    assert rms[1] < 0.1 * min(rms[0], rms[2])


@pytest.mark.slow
def test_the_command_compares_stores_and_draws(tmp_path, slider, plain):
    phase, values, wave = waved(plain)
    file = written(tmp_path / "slide.csv", time_s=phase / SPEED, displacement_mm=1e3 * values)
    words = ("simulate", "slider-crank-clearance", "--set", "joints.C.clearance=0.3 mm", "--speed", f"{RPM} rpm")
    words += ("--revolutions", 3, "--points", POINTS, "--tolerance", 1e-8, "--measured", file, "--integrator", "cvodes")
    done = call(*words, "--out", tmp_path / "out")
    assert done.exit_code == 0
    assert f"{1e3 * math.sqrt(np.mean(wave**2)):.4f}" in done.stdout
    assert (tmp_path / "out/measured.png").stat().st_size > 10_000
    document = json.loads((tmp_path / "out/result.json").read_text())
    assert len(document["measured"]["difference_m"]) == POINTS + 1
    page = call("report", tmp_path / "out", "--out", tmp_path / "page.html")
    assert page.exit_code == 0, page.output
    text = (tmp_path / "page.html").read_text()
    assert "measured minus simulated" in text
    file.unlink()  # the result contains the series
    assert call("report", tmp_path / "out", "--out", tmp_path / "page.html").exit_code == 0
    assert (tmp_path / "page.html").read_text() == text


@pytest.mark.parametrize(
    "more", [["--measured", "none.csv"], ["--ideal", "--measured", __file__], ["--control", "compare", "--measured", __file__]]
)
def test_an_option_that_cannot_be_used_is_refused(more):
    done = call("simulate", "slider-crank-clearance", "--revolutions", 1, *more)
    assert done.exit_code == 2
    assert "--measured" in done.stderr or "csv" in done.stderr


# --- the inverse model alone ------------------------------------------------------------------------------------------------


def ideal(angle, crank=0.05, rod=0.12):
    return crank * np.cos(angle) + np.sqrt(rod**2 - (crank * np.sin(angle)) ** 2)


def test_the_inverse_model_finds_the_crank_speed_of_a_displacement():
    """By the closed formula of the slider-crank, with a vanishing clearance: r1 of a known crank motion gives back omega2."""
    keys = {"joints.C.clearance": "2e-6 mm", "control.regularisation": "1e-4 mm", "joints.C.friction": 0}
    problem = optlink.load("slider-crank-clearance", keys)
    phase = 2.0 * math.pi * np.arange(240) / 240
    motion = optlink.control.inverse_model(problem, ideal(phase + 0.03 * np.sin(2.0 * phase)), speed=SPEED)
    wanted = SPEED * (1.0 + 0.06 * np.cos(2.0 * SPEED * motion.time))
    assert motion.speed == pytest.approx(wanted, rel=1e-4)
    assert motion.reached == pytest.approx(ideal(motion.angle), abs=1e-7)


@pytest.mark.slow
def test_the_speed_of_the_command_is_the_derivative_of_its_angle(slider):
    run = simulated(slider, 2, control="inverse")
    correction, time = run["command.correction_rad"], run["time_s"]
    rate = np.gradient(correction, time)[2:-2]
    assert run["command.speed_rad_s"][2:-2] == pytest.approx(SPEED + rate, abs=0.06 * np.max(np.abs(rate)))
    assert np.max(np.abs(rate)) > 1.0


@pytest.mark.parametrize("values", [[0.1, 0.2], [0.1, math.nan, 0.2], [[0.1, 0.2, 0.3]]])
def test_a_displacement_that_is_no_series_is_refused(values):
    with pytest.raises(InputError, match="displacement"):
        optlink.control.inverse_model(optlink.load("slider-crank-clearance"), values)


def test_a_machine_without_clearance_has_no_inverse_model():
    with pytest.raises(InputError, match="clearance"):
        optlink.control.inverse_model(optlink.load("slider-crank"))
