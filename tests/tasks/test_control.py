"""Compensation of clearance: inverse model by hand, PID by its equation, servo by its lag, resumed runs, tables."""

from __future__ import annotations

import json
import math
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace

import numpy as np
import pytest

import optlink
from optlink.clearance.columns import default_output
from optlink.clearance.control import DENSE, PID, POINTS, ClosedLoop, Controller, Gains, Inverse, installed, leverage, predicted
from optlink.clearance.equations import Drive, ReferenceSignal, Servo
from optlink.dynamics.inverse import reactions
from optlink.errors import InputError
from optlink.presentation import files
from optlink.presentation.views import control_comparison as comparison_view
from optlink.tasks import control_comparison, parallel_runs
from optlink.tasks.results.clearance import Comparison

CRANK, ROD = 0.05, 0.12
SPEED = 1200.0 * math.pi / 30.0


@pytest.fixture(scope="module")
def problem():
    return optlink.load("slider-crank-clearance")


@pytest.fixture(scope="module")
def parts(problem):
    machine = problem.model.machine()
    return machine, problem.model.gaps(machine), default_output(machine)


# --- PID ---------------------------------------------------------------------------------------------------------------


def test_pid_follows_its_equation():
    gains = Gains(0.5, 20.0, 3e-4)
    pid, sample = PID(gains, 1e-3), 1e-3
    errors = [0.1, 0.3, -0.2, 0.05]
    total = 0.0
    for before, error in zip([None, *errors[:-1]], errors, strict=True):
        total += error * sample
        slope = 0.0 if before is None else (error - before) / sample
        assert pid(error) == pytest.approx(0.5 * error + 20.0 * total + 3e-4 * slope, rel=1e-13)


def test_pid_keeps_its_limit_and_does_not_wind_up():
    pid = PID(Gains(0.0, 100.0, 0.0, limit=0.2), 1e-2)
    computed = [pid(1.0) for _ in range(50)]
    assert max(computed) <= 0.2
    wound = PID(Gains(0.0, 100.0, 0.0), 1e-2)
    for _ in range(50):
        wound(1.0)
    assert wound.integral == pytest.approx(50.0)
    assert pid.integral <= 0.2
    assert pid(-0.1) < 0.2  # it leaves the limit with the first error of the other sign


@pytest.mark.parametrize("points", [72, 200, 360, 500])
@pytest.mark.parametrize("rpm", [50.0, 900.0, 1300.0, 1800.0, 10_000.0])
def test_sample_time_is_near_the_requested_one(problem, parts, rpm, points):
    """With any number of rows: gains of half the sample time are those of another controller."""
    machine, gaps, output = parts
    speed = rpm * math.pi / 30.0
    options = {"start": 0.0, "speed": speed, "nominal": speed, "points": points, "tolerance": 1e-6, "sample_time": 2.5e-4}
    plant = ClosedLoop(machine, gaps, Drive(Servo(2e3, 0.7), ReferenceSignal(0.0, speed)), output, **options)
    assert plant.samples * plant.sample_time == pytest.approx(60.0 / rpm)
    assert plant.sample_time == pytest.approx(2.5e-4, rel=0.03)
    assert plant.rows % points == plant.rows % plant.samples == 0
    assert plant.rows <= 20 * max(points, plant.samples, DENSE)


def test_controller_converts_the_error_to_the_crank_and_unwraps_angles():
    plain = Controller(PID(Gains(1.0), 1e-3), np.array([0.3, 0.4]), np.array([2.0, -5.0]))
    assert plain(0, 0.1) == pytest.approx(0.4)
    assert plain(3, 0.1) == pytest.approx(-1.5)
    angular = Controller(PID(Gains(1.0), 1e-3), np.array([math.pi - 0.01]), np.ones(1), angular=True)
    assert angular(0, -math.pi + 0.01) == pytest.approx(-0.02)


# --- command and servo ----------------------------------------------------------------------------------------------------


def test_speed_command_is_the_derivative_of_the_angle_command():
    command = ReferenceSignal(0.3, -40.0, np.array([0.01, 0.02 - 0.01j, -0.005 + 0.003j]))
    time, step = np.linspace(0.0, 0.3, 11), 1e-5
    angle = [command.at(time + shift)[0] for shift in (-step, step)]
    np.testing.assert_allclose((angle[1] - angle[0]) / (2.0 * step), command.at(time)[1], rtol=1e-8)
    np.testing.assert_allclose(command.at(time)[0], 0.3 - 40.0 * time + command.correction(time), rtol=1e-13)
    assert ReferenceSignal(1.0, 2.0).at(3.0) == (7.0, 2.0)


@pytest.mark.slow
def test_servo_follows_the_inverse_model(problem):
    """The command is ahead of the servo's lag: the crank itself follows the required correction."""
    run = optlink.control.simulate_clearance(problem, 3, 180, control="inverse", check_predictability=False)
    machine = run.machine
    inverse = Inverse(machine, run.gaps, run.output, 0.0, SPEED)
    order = int(0.5 * 300.0 / 20.0)
    expected = ReferenceSignal(0.0, SPEED, inverse.solve(5e-3, order))
    time = run["time_s"][-180:]
    np.testing.assert_allclose(np.radians(run["crank_angle_deg"][-180:]), expected.at(time)[0], atol=1e-6)
    correction = run["command.correction_rad"][-180:]
    assert np.max(np.abs(correction - expected.correction(time))) > 1e-3  # and that of the command differs


# --- inverse model --------------------------------------------------------------------------------------------------------


def test_predicted_journal_position_follows_the_ideal_reaction(parts):
    """The contact force at the predicted place, normal and friction, has the direction of the ideal reaction."""
    machine, gaps, _ = parts
    angles = np.linspace(0.1, 6.2, 37)
    place = predicted(machine, gaps, angles, SPEED)
    moving = machine.moving(angles, SPEED)
    force = np.stack(reactions(moving).pins["C"]["rod"])
    size = np.hypot(*place.T)
    x, y = place.T / size
    slip = gaps[0].radius * (np.asarray(moving.state("rod").omega))
    rub = -gaps[0].friction * np.tanh(slip / gaps[0].slip_speed)
    push = np.stack([-x - rub * y, -y + rub * x])
    push, force = (vector / np.hypot(*vector) for vector in (push, force))
    np.testing.assert_allclose(push, force, atol=1e-12)
    load = np.hypot(*np.stack(reactions(moving).pins["C"]["rod"]))
    np.testing.assert_allclose(size - gaps[0].clearance, (load / gaps[0].stiffness) ** (2.0 / 3.0), rtol=1e-12)


def test_loops_close_with_the_gap_vector(parts):
    """The slider's place by hand: the rod ends at the slider plus the gap vector."""
    machine, gaps, output = parts
    inverse = Inverse(machine, gaps, output, 0.2, SPEED)
    crank = inverse.angles + 0.01 * np.sin(3.0 * inverse.angles)
    value, slope = inverse.close(crank)
    ex, ey = inverse.gaps.T
    height = ey - CRANK * np.sin(crank)
    by_hand = CRANK * np.cos(crank) + np.sqrt(ROD**2 - height**2) - ex
    np.testing.assert_allclose(value, by_hand, atol=1e-14)
    step = 1e-6
    ahead, behind = inverse.close(crank + step)[0], inverse.close(crank - step)[0]
    np.testing.assert_allclose(slope, (ahead - behind) / (2.0 * step), atol=1e-9)


def test_inverse_solution_is_the_best_of_its_harmonics(parts):
    """No harmonic of the correction can be changed for the better, and more harmonics are better still."""
    machine, gaps, output = parts
    inverse = Inverse(machine, gaps, output, 0.0, SPEED)

    def cost(harmonics, regularisation=3e-3):
        turned = ReferenceSignal(0.0, SPEED, harmonics).correction(np.arange(POINTS) * 2.0 * np.pi / (POINTS * SPEED))
        missing = inverse.close(inverse.angles + turned)[0] - inverse.target
        return float(np.mean(missing**2 + (regularisation * turned) ** 2))

    result = inverse.solve(3e-3, 4)
    best = cost(result)
    assert best < 0.5 * cost(np.zeros(1, dtype=complex))
    for k in range(5):
        for change in (1e-4, -1e-4, 1e-4j, -1e-4j):
            other = result.copy()
            other[k] += change
            assert cost(other) >= best - 1e-18
    assert cost(inverse.solve(3e-3, 8)) < best


def test_leverage_stays_finite_at_the_dead_centres(parts):
    machine, _, output = parts
    computed = leverage(machine, output, np.array([0.0, np.pi, 0.5 * np.pi]), 5e-3)
    np.testing.assert_allclose(computed[:2], 0.0, atol=1e-12)
    slope = -CRANK  # of the slider over the crank angle at 90 deg
    assert computed[2] == pytest.approx(slope / (slope**2 + 5e-3**2), rel=1e-12)


@pytest.mark.slow
def test_inverse_command_follows_a_clockwise_crank(problem):
    forward = optlink.control.simulate_clearance(problem, 8, 180, control="inverse", check_predictability=False, tolerance=1e-8)
    back = optlink.control.simulate_clearance(
        problem, 8, 180, speed=-SPEED, control="inverse", check_predictability=False, tolerance=1e-8
    )
    alone = optlink.control.simulate_clearance(problem, 8, 180, speed=-SPEED, check_predictability=False, tolerance=1e-8)
    for run in (forward, back):
        assert run.figures["rms_m"] < 0.7 * alone.figures["rms_m"]


# --- what it comes to -----------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_resumed_run_is_the_uninterrupted_one_to_the_last_digit(problem):
    for control in ("none", "inverse+pid"):
        whole = optlink.control.simulate_clearance(problem, 3, 100, control=control, tolerance=1e-8)
        checkpoints: list[dict] = []
        optlink.control.simulate_clearance(problem, 2, 100, control=control, tolerance=1e-8, checkpoint=checkpoints.append)
        saved = json.loads(json.dumps(checkpoints[-1]))
        on = optlink.control.simulate_clearance(problem, 3, 100, control=control, tolerance=1e-8, resume=saved)
        assert dict(on.figures) == dict(whole.figures)
        assert on.prediction == whole.prediction
        np.testing.assert_array_equal(on["slider.s_m"], whole["slider.s_m"][200:])
        with pytest.raises(InputError, match="another command"):
            optlink.control.simulate_clearance(problem, 3, 100, speed=100.0, control=control, tolerance=1e-8, resume=saved)


@pytest.mark.slow
def test_compare_tabulates_all_kinds_of_control(problem):
    result = optlink.control.compare(problem, 2, 2, seed=3, points=100)
    assert list(result.trials) == ["none", "inverse", "pid", "inverse+pid"]
    assert result.valid
    assert result.gain("none") == 0.0
    np.testing.assert_array_equal(result.starts, control_comparison.random_crank_angles(2, 3))
    assert not np.array_equal(result.starts, control_comparison.random_crank_angles(2, 4))
    for trials in result.trials.values():
        assert trials.rms.shape == (2,)
        assert trials.mean == pytest.approx(np.mean(trials.rms))
    assert np.all(result.trials["none"].correction == 0.0)
    assert result.gain("inverse") > 0.25
    document = result.to_dict()
    assert document["schema"] == "optlink/control-comparison/4"
    json.dumps(document, allow_nan=False)


@pytest.mark.slow
def test_tuning_is_never_worse_than_reported(problem):
    result = optlink.control.tune(problem, "inverse", ("regularisation", "bandwidth"), evaluations=4, starts=1, revolutions=2)
    assert result.cost == min(result.before, np.min(result.costs))
    assert bool(result.best) == (np.min(result.costs) < result.before)
    assert result.costs.shape == (4,)
    again = optlink.control.simulate_clearance(
        result.problem,
        2,
        200,
        control="inverse",
        start=float(control_comparison.random_crank_angles(1, 0)[0]),
        tolerance=1e-8,
        check_predictability=False,
    )
    assert again.figures["rms_m"] == pytest.approx(result.cost, rel=1e-12)
    if result.best:
        assert result.to_dict()["other_starts"]["cost"] == result.check[1].mean
    with pytest.raises(InputError, match="no such parameter"):
        optlink.control.tune(problem, names=("gain",))


@pytest.mark.slow
def test_shipped_gains_are_better_than_either_part_alone(problem):
    """The PID on top of the inverse model takes away more than the inverse model."""
    kinds = ("inverse", "inverse+pid")
    result = optlink.control.compare(problem, 4, 1, seed=5, kinds=kinds, tolerance=1e-7)
    assert result.trials["inverse+pid"].mean < 0.97 * result.trials["inverse"].mean


SHORT = {"revolutions": 2, "points": 60, "tolerance": 1e-6}
QUICK = {"integrator": "compiled" if installed() else "cvodes"}
"""For what holds with either integrator."""


def rocker():
    return optlink.load("crank-rocker-clearance", {"drive.speed": "400 rpm", "joints.C.friction": 0.2})


@pytest.mark.slow
@pytest.mark.parametrize("engine", ["local", "dask"])
def test_comparison_in_processes_is_the_same_to_the_bit(engine):
    if engine == "dask":
        pytest.importorskip("distributed")
    ways = ({}, {"workers": 2, "engine": engine})
    alone, shared = (optlink.control.compare(rocker(), starts=2, seed=7, kinds=("none", "pid"), **way, **SHORT) for way in ways)
    for kind in ("none", "pid"):
        for name in ("rms", "peak", "correction", "torque"):
            np.testing.assert_array_equal(getattr(alone.trials[kind], name), getattr(shared.trials[kind], name))
        np.testing.assert_array_equal(alone.examples[kind]["rocker.error_rad"], shared.examples[kind]["rocker.error_rad"])


@pytest.mark.slow
def test_interrupted_comparison_resumes_from_completed_runs(monkeypatch):
    checkpoints: list[dict] = []
    options = {"starts": 3, "seed": 2, "kinds": ("none", "inverse"), **SHORT, **QUICK}
    whole = optlink.control.compare(rocker(), **options)

    def stop(document: dict) -> None:
        checkpoints.append(json.loads(json.dumps(document, allow_nan=False)))
        if document["complete"] == 4:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        optlink.control.compare(rocker(), checkpoint=stop, **options)
    assert (checkpoints[-1]["complete"], checkpoints[-1]["total"]) == (4, 6)
    performed = []
    perform = parallel_runs.run_job
    monkeypatch.setattr(parallel_runs, "run_job", lambda job: performed.append((job.control, job.start)) or perform(job))
    on = optlink.control.compare(rocker(), resume=checkpoints[-1], **options)
    assert len(performed) == 4  # the first start of each kind, for the pictures, and the two that were missing
    for kind, trials in whole.trials.items():
        np.testing.assert_array_equal(on.trials[kind].rms, trials.rms)
    with pytest.raises(InputError, match="another command"):
        optlink.control.compare(rocker(), resume=checkpoints[-1], **{**options, "seed": 3})
    with pytest.raises(InputError, match="was changed since it was written"):
        optlink.control.compare(rocker(), resume={**checkpoints[-1], "runs": checkpoints[-1]["runs"][:3]}, **options)


@pytest.mark.slow
def test_runs_that_stall_have_no_figures():
    """A run that stalls at once has no deviation: it must not count as one without deviation, which no control could beat."""
    sinking = {"joints.C.modulus": None, "joints.C.poisson": None, "joints.C.stiffness": "1 N/m^1.5"}
    problem = optlink.load("crank-rocker-clearance", sinking)
    result = optlink.control.compare(problem, starts=1, kinds=("none", "pid"), **SHORT)
    assert (result.valid, result.status) == (False, "stalled")
    for trials in result.trials.values():
        assert math.isnan(trials.mean)
        assert trials.stalled == 1
    text = str(comparison_view.overview(result))
    assert "Stalled: 1 of 1 runs with control pid, which therefore has no mean" in text
    assert result.to_dict()["trials"]["pid"]["mean"] is None
    assert comparison_view.charts(result) == []
    assert comparison_view.conclusion(result) == "No controller completed its runs."
    tuned = optlink.control.tune(problem, "pid", evaluations=4, starts=1, **SHORT)
    assert (tuned.valid, tuned.status, dict(tuned.best)) == (False, "stalled", {})
    assert "No result: with every parameter set, that of the problem too, a run stalled" in str(comparison_view.tuning(tuned))


def test_one_run_of_several_that_stalls_leaves_its_control_without_a_mean():
    figures = {"rms_m": 1e-3, "peak_m": 2e-3, "correction_rms_rad": 0.0, "torque_rms_Nm": 1.0}
    runs = [parallel_runs.RunResult(figures | {"rms_m": rms}, "m", finished) for rms, finished in ((1e-3, True), (1e-6, False))]
    trials = control_comparison._trials(runs)
    assert (trials.finished, trials.stalled, trials.rms[0]) == (False, 1, 1e-3)
    assert math.isnan(trials.mean)
    full = control_comparison._trials(runs[:1] * 2)
    computed = Comparison(optlink.load("slider-crank-clearance"), {"none": full, "pid": trials}, np.zeros(2), 0, 2, {}, "m")
    [chart] = comparison_view.charts(computed)
    assert [label for _, label in chart.panels[0].y.ticks] == ["no control"]
    assert comparison_view.conclusion(computed).endswith("Not every run was completed.")


@pytest.fixture(scope="module")
def saved():
    """The checkpoints of a simulation and of a comparison, as read from their files."""
    checkpoints: list[dict] = []
    optlink.control.simulate_clearance(rocker(), 1, 60, tolerance=1e-6, checkpoint=checkpoints.append)
    optlink.control.compare(rocker(), starts=1, kinds=("none",), checkpoint=checkpoints.append, **SHORT)
    return [json.loads(json.dumps(document)) for document in checkpoints]


@pytest.mark.slow
def test_checkpoints_of_other_kinds_are_refused(saved):
    """Of another version, of another kind, or of another run: one sentence before any run."""
    options = {"starts": 1, "kinds": ("none",), **SHORT}
    simulation, comparison = saved
    assert optlink.control.compare(rocker(), resume=comparison, **options).valid
    for changes, message in (
        ({"schema": "optlink/trials/1"}, r"has another format: its schema is 'optlink/trials/1'.*resume"),
        ({"optlink": "0.0.1"}, r"is that of another version: its optlink is '0\.0\.1'"),
        ({"seed": 1}, "is that of another command: its seed is 1, not 0"),
        (simulation, "has another format"),
    ):
        with pytest.raises(InputError, match=message):
            optlink.control.compare(rocker(), resume={**comparison, **changes}, **options)
    with pytest.raises(InputError, match="is that of another command: its check_predictability is True, not False"):
        optlink.control.simulate_clearance(rocker(), 2, 60, tolerance=1e-6, check_predictability=False, resume=simulation)


@pytest.mark.slow
def test_a_complete_run_is_resumed_at_its_last_revolution():
    """Its results may not have been written: the statistics are those of the whole run, the rows those of its end."""
    kept: list[dict] = []
    for count, control in ((1, "none"), (3, "inverse+pid")):
        whole = optlink.control.simulate_clearance(rocker(), count, 60, control=control, tolerance=1e-6, checkpoint=kept.append)
        options = {"resume": json.loads(json.dumps(kept[-1])), "checkpoint": kept.append}
        again = optlink.control.simulate_clearance(rocker(), count, 60, control=control, tolerance=1e-6, **options)
        one, other = whole.to_dict(), again.to_dict()
        rows, end = one["columns"], other["columns"]
        assert {**one, "columns": {}, "crc32": ""} == {**other, "columns": {}, "crc32": ""}
        assert end == {name: values[-60:] for name, values in rows.items()}
        assert json.dumps(kept[-1]) == json.dumps(kept[-2])


@pytest.mark.slow
def test_a_longer_run_is_not_resumed():
    kept: list[dict] = []
    optlink.control.simulate_clearance(rocker(), 3, 60, tolerance=1e-6, checkpoint=kept.append)
    with pytest.raises(InputError, match=r"3 revolutions are already complete\. Request more, or leave out resume"):
        optlink.control.simulate_clearance(rocker(), 2, 60, tolerance=1e-6, resume=kept[-1])


@pytest.mark.parametrize(
    ("part", "entry", "value"),
    [
        ("closed_loop", "row", 360),
        ("closed_loop", "works", [0.0, 0.0, 0.0]),
        ("closed_loop", "further", 0.3),
        ("closed_loop", "open", [[7, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]]),
        ("statistics", "count", "x"),
        ("statistics", "sums", {}),
        ("predictability", "parted", "x"),
    ],
)
def test_checkpoint_that_was_changed_is_refused(saved, tmp_path, part, entry, value):
    """A changed state would continue with other numbers; a changed type would end in a traceback."""
    simulation = saved[0]
    state = simulation["state"]
    simulation = {**simulation, "state": {**state, part: {**state[part], entry: value}}}
    with pytest.raises(InputError, match="was changed since it was written"):
        optlink.control.simulate_clearance(rocker(), 2, 60, tolerance=1e-6, resume=simulation)
    for document in (simulation, {**saved[0], "revolutions": "x"}, {}):
        (tmp_path / "checkpoint.json").write_text(json.dumps(document), encoding="utf-8")
        with pytest.raises(InputError, match="there is no checkpoint, or it is damaged"):
            files.checkpoint(tmp_path)


@pytest.mark.parametrize(
    ("control", "names", "idle"),
    [
        ("none", ("regularisation",), "regularisation"),
        ("inverse", ("regularisation", "integral"), "integral"),
        ("pid", ("proportional", "bandwidth"), "bandwidth"),
    ],
)
def test_parameter_without_effect_is_not_tuned(monkeypatch, control, names, idle):
    """It would find that nothing is better."""
    monkeypatch.setattr(control_comparison, "run_jobs", None)
    with pytest.raises(InputError, match=f"{idle}.*: the parameter has no effect with control {control}"):
        optlink.control.tune(rocker(), control, names, evaluations=4, **SHORT)


def test_best_parameters_of_a_tuning_are_compared_from_other_starts(monkeypatch):
    """The error is made up: its share of noise depends on the start, so the best set of the search is no better elsewhere."""
    used: dict[bool, set[float]] = {False: set(), True: set()}
    searched = set(control_comparison.random_crank_angles(2, 3))

    def run_jobs(jobs, runs):
        for k, job in enumerate(jobs):
            gain = float(job.problem.raw["control"].get("proportional", 0.1))
            used[job.start in searched].add(job.start)
            rms = 1e-3 * (1.0 + (0.1 if job.start in searched else -0.1) * math.cos(1e3 * gain))
            figures = {"rms_rad": rms, "peak_rad": rms, "correction_rms_rad": 0.0, "torque_rms_Nm": 1.0}
            yield k, parallel_runs.RunResult(figures, "rad", True)

    monkeypatch.setattr(control_comparison, "run_jobs", run_jobs)
    result = optlink.control.tune(rocker(), "pid", ("proportional",), evaluations=8, starts=2, seed=3, **SHORT)
    assert result.best
    assert result.cost < result.before
    before, best = result.check
    assert (best.mean - before.mean) == pytest.approx(result.before - result.cost)
    assert used == {True: searched, False: set(control_comparison.random_crank_angles(2, 4))}
    assert result.to_dict()["other_starts"]["cost"] == best.mean
    text = str(comparison_view.tuning(result))
    assert "The best parameters are not better from other starts" in text
    assert "Use them" not in text


@pytest.mark.slow
def test_tuning_resumes_and_stops_runs_that_cannot_win():
    checkpoints: list[dict] = []
    options = {"evaluations": 5, "starts": 2, "seed": 4, **SHORT, **QUICK}
    whole = optlink.control.tune(rocker(), "pid", ("proportional",), checkpoint=checkpoints.append, **options)
    middle = json.loads(json.dumps(checkpoints[2], allow_nan=False))
    on = optlink.control.tune(rocker(), "pid", ("proportional",), resume=middle, **options)
    np.testing.assert_array_equal(on.costs, whole.costs)
    assert dict(on.best) == dict(whole.best)
    finite = np.isfinite(whole.costs)
    assert 0 < np.count_nonzero(finite) < len(finite)
    assert np.all(np.diff(whole.costs[finite]) <= 0.0)  # whatever is worse than the best so far was abandoned
    shared = optlink.control.tune(rocker(), "pid", ("proportional",), workers=2, **options)
    np.testing.assert_array_equal(shared.costs, whole.costs)
    job = parallel_runs.RunJob(rocker(), control="none", start=0.3, limit=1e-9, **SHORT)
    assert parallel_runs.run_job(job).hopeless
    assert not parallel_runs.run_job(replace(job, limit=1.0)).hopeless


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="a signal of POSIX")
def test_interrupt_stops_a_comparison_and_keeps_completed_runs(tmp_path):
    """One sentence, exit code 130, no result that looks whole; the runs that are complete stay for --resume."""
    code = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler); from optlink.cli.app import main; main()"
    options = ["--control", "compare", "--starts", "200", "--revolutions", "2", "--points", "60", "--tolerance", "1e-6"]
    command = [
        sys.executable,
        "-c",
        code,
        "simulate",
        "crank-rocker-clearance",
        *options,
        "--workers",
        "1",
        "--out",
        str(tmp_path),
    ]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        while not (tmp_path / "checkpoint.json").exists() and process.poll() is None:
            time.sleep(0.05)
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=60)
    assert process.returncode == 130
    assert out == ""
    assert err.count("\n") == 1
    assert "of 800 runs are complete and kept in" in err
    assert not [*tmp_path.glob("*.png"), *tmp_path.glob("result*")]


@pytest.mark.slow
def test_control_compensates_three_clearances():
    """At 1200 rpm: the inverse model takes away a quarter at least, PID on top of it more; means of three starts and of one."""
    file = optlink.load("slider-crank-three-gaps")
    result = optlink.control.compare(file, 11, 3, kinds=("none", "inverse"), tolerance=1e-6, **QUICK)
    assert result.valid
    assert result.trials["none"].mean == pytest.approx(1.307e-3, rel=0.02)
    assert result.gain("inverse") > 0.25
    both = optlink.control.compare(
        file, 11, 1, kinds=("inverse+pid",), tolerance=1e-6, **QUICK
    )  # seven times the work of a run without PID
    assert both.valid
    assert both.trials["inverse+pid"].mean < 0.9 * result.trials["inverse"].mean


def test_a_tuning_that_finds_nothing_better_is_written(monkeypatch):
    def run_jobs(jobs, runs):
        for k, job in enumerate(jobs):
            rms = 2e-3 if any(key.startswith("control.") for key in job.problem.overrides) else 1e-3
            figures = {"rms_rad": rms, "peak_rad": rms, "correction_rms_rad": 0.0, "torque_rms_Nm": 1.0}
            yield k, parallel_runs.RunResult(figures, "rad", True)

    monkeypatch.setattr(control_comparison, "run_jobs", run_jobs)
    result = optlink.control.tune(rocker(), "pid", ("proportional",), evaluations=4, starts=1, **SHORT)
    assert not result.best
    assert result.check is None
    assert "other_starts" not in result.to_dict()
