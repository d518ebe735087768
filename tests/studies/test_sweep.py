"""Sweeps: rows against single solves, identical bytes after interruptions and failures, and every kind of bad input."""

from __future__ import annotations

import contextlib
import gc
import json
import math
import os
import pickle
import random
import re
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest
from typer.testing import CliRunner

import optlink
from optlink import io
from optlink.cli.app import app
from optlink.errors import InputError, SolverError
from optlink.execution import runner, store
from optlink.presentation.chart_mpl import draw
from optlink.presentation.views.sweep import charts
from optlink.studies.grid import read_axis, read_grid
from optlink.studies.optimum_parameters import FastOverride
from optlink.studies.reoptimise_task import oriented
from optlink.studies.sweeps import CHANGED, TableFile, sweep
from optlink.units import in_si
from optlink.validation import validate_batch as prove
from tests import chunks
from tests.solved import folder_once, once

ROOT = Path(__file__).parents[2]
FRAME = "mechanism.frame=450..550 mm"
LIMIT = "limits.transmission_angle.max"
POINTS = 400  # of four chunks


def problem(name: str = "crank-rocker", **overrides):
    return optlink.load(name, overrides)


# --- what is varied --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "unit", "values"),
    [
        ("a=450..550 mm:5", "mm", [450.0, 475.0, 500.0, 525.0, 550.0]),
        ("a = 450 mm..550 mm : 3", "mm", [450.0, 500.0, 550.0]),
        ('a="1..100 mm:3 log"', "mm", [1.0, 10.0, 100.0]),
        ("a=-10..10 deg:3", "deg", [-10.0, 0.0, 10.0]),
        ("a=0..1 mm step 0.25", "mm", [0.0, 0.25, 0.5, 0.75, 1.0]),
        ("a=450 mm, 470 mm,520 mm", "mm", [450.0, 470.0, 520.0]),
        ("a=120, 125, 130 deg", "deg", [120.0, 125.0, 130.0]),
        ("a=1.1..1.5:3", "", [1.1, 1.3, 1.5]),
        ("a=1e2..1.5e2 mm:2", "mm", [100.0, 150.0]),
        ("a=64..128 rad/s:2", "rad/s", [64.0, 128.0]),
        ("a=.5...75 mm:2", "mm", [0.5, 0.75]),
        ("a=5 \u2026 75\u00a0mm:2", "mm", [5.0, 75.0]),
        ("a=\u22125..5\u00b0:2", "deg", [-5.0, 5.0]),
        ("a=60..120 1/min:2", "1/min", [60.0, 120.0]),
    ],
)
def test_ranges_lists_and_ratios(text, unit, values):
    axis = read_axis(*map(str.strip, text.split("=")))
    assert (axis.key, axis.unit) == ("a", unit)
    assert axis.values == pytest.approx(values, abs=1e-12)
    assert (axis.values[0], axis.values[-1]) == (values[0], values[-1])


@pytest.mark.parametrize(
    ("text", "values"),
    [
        ("limits.transmission_angle.max=130..136 deg:4", (130.0, 132.0, 134.0, 136.0)),
        ("mechanism.frame=0.3..0.6 m:4", (0.3, 0.4, 0.5, 0.6)),
        ("mechanism.frame=0.45..0.55 m step 0.05", (0.45, 0.5, 0.55)),
        ("mechanism.frame=0.1..1000 m:5 log", (0.1, 1.0, 10.0, 100.0, 1000.0)),
    ],
)
def test_values_of_a_range_have_no_rounding_errors(text, values):
    """The table listed 0.39999999999999997."""
    assert read_axis(*text.split("=")).values == values


def test_a_balancing_problem_is_not_swept():
    with pytest.raises(InputError, match=r"does not optimise a balancing problem\..*optlink balance"):
        sweep(optlink.load("balance-four-bar"), ["mechanism.rocker=70..80 mm:2"])


@pytest.mark.slow
def test_a_million_million_points_are_refused_with_their_size():
    with pytest.raises(InputError) as error:
        sweep(problem(), [f"{FRAME}:1000000", f"{LIMIT}=120..140 deg:1000000"])
    text = str(error.value)
    assert "1,000,000 x 1,000,000 = 1,000,000,000,000 points" in text
    assert "days" in text
    assert "GB" in text


def test_a_tolerance_is_varied_for_a_robust_design_alone():
    with pytest.raises(InputError, match=r"vary tolerances\.coupler: no result depends on this key"):
        read_grid(problem(), ["tolerances.coupler=0.1..0.2 mm:3"])
    key = next(iter(optlink.load("crank-rocker-robust").model.tolerances))
    assert read_grid(problem("crank-rocker-robust"), [f"tolerances.{key}=0.1..0.2 mm:3"]).count == 3


def test_empty_and_duplicate_axes_are_refused():
    with pytest.raises(InputError, match="no parameter is varied"):
        read_grid(problem(), [])
    with pytest.raises(InputError, match="varied twice"):
        read_grid(problem(), [f"{FRAME}:3", "mechanism.frame=1 m, 2 m"])


# --- rows ------------------------------------------------------------------------------------------------------------


def test_rows_are_those_of_single_solves():
    result = sweep(problem(), [f"{FRAME}:21", f"{LIMIT}=125..140 deg:11"], workers=1)
    assert result.valid
    table = result.columns
    assert len(table["valid"]) == 231
    assert result.searched_points < 10
    for i in np.random.default_rng(3).choice(231, 6, replace=False):
        overrides = {"mechanism.frame": float(table["mechanism.frame_m"][i]), f"{LIMIT}": float(table[f"{LIMIT}_rad"][i])}
        single = optlink.solve(optlink.load("crank-rocker", overrides), certify=False)
        assert table["objective_rad2"][i] == pytest.approx(single.objective, rel=1e-9)
        for name in ("coupler", "rocker"):
            assert table[f"{name}_m"][i] == pytest.approx(single.design[name], abs=1e-9)


@pytest.mark.slow
def test_a_small_grid_has_a_search_near_its_first_row():
    """From the middle of this grid Newton's method follows an optimum that is 2 % worse at its lower end."""
    mechanism = {"crank": "59.8 mm", "coupler": {"bounds": ["300 mm", "390 mm"]}, "rocker": "278 mm", "assembly": "right"}
    mechanism["frame"] = {"bounds": ["179 mm", "341 mm"]}
    requirement = {"law": "psi0 - (phi - phi0)", "span": "55.7 deg", "points": 3, "measure": "max"}
    requirement["from"] = {"bounds": ["93 deg", "133 deg"]}
    limits = {"crank": "span", "transmission_angle": ["35.6 deg", "134.7 deg"]}
    problem = optlink.read({"mechanism": mechanism, "requirement": {"kind": "function", **requirement}, "limits": limits})
    table = sweep(problem, ["mechanism.rocker=222.6..348 mm:7"], workers=1).columns
    single = optlink.solve(problem.override({"mechanism.rocker": "222.6 mm"}), starts=1, certify=False)
    assert table["objective_rad"][0] == pytest.approx(single.objective, rel=1e-9)


@pytest.mark.slow
def test_the_last_axis_changes_fastest():
    columns = sweep(problem(), [f"{LIMIT}=130, 135 deg", f"{FRAME}:3"], workers=1).columns
    assert columns["mechanism.frame_m"].tolist() == [0.45, 0.5, 0.55] * 2
    assert np.degrees(columns[f"{LIMIT}_rad"]) == pytest.approx([130.0] * 3 + [135.0] * 3, rel=1e-14)


@pytest.mark.slow
def test_active_set_changes_are_marked():
    """Freed, the coupler takes 412.865 mm: its bound holds it below, and not above."""
    result = sweep(problem(), ["mechanism.coupler.max=405..420 mm:61"], workers=1)
    table = result.columns
    (mark,) = np.flatnonzero(table[CHANGED])
    assert table["mechanism.coupler.max_m"][mark - 1] < 0.412865 < table["mechanism.coupler.max_m"][mark]
    (change,) = result.changes
    assert "coupler" in change.before
    assert "coupler" not in change.after
    assert "largest transmission angle" in change.after
    assert np.all(table["coupler_m"][mark:] == pytest.approx(0.41286542, abs=1e-8))
    assert result.searched_points == 4  # in the middle of each block; from there, Newton's method changes the active set itself


@pytest.mark.slow
def test_a_limit_that_an_optimum_nearly_touches_is_not_listed():
    """At 178.5 deg the margin of the crank's rotation is 0.2 um away, nearly parallel to the limit that is active."""
    assert sweep(problem(), [f"{LIMIT}=178..179 deg:3"], workers=1).columns["active"].tolist() == [
        "largest transmission angle",
        "largest transmission angle",
        "crank + frame <= coupler + rocker",
    ]


@pytest.mark.slow
def test_rows_do_not_depend_on_sweeps_before_in_the_same_process():
    vary = f"{LIMIT}=85..179 deg:21"
    first, _, again = [sweep(problem(), [own], workers=1) for own in (vary, f"{LIMIT}=80..150 deg:5", vary)]
    assert again.path.read_bytes() == first.path.read_bytes()


@pytest.mark.slow
def test_points_without_a_design_are_rows_too():
    result = sweep(problem(), [f"{LIMIT}=70, 100 deg"], workers=1)
    table = result.columns
    assert not result.valid
    assert set(table["status"]) >= {"infeasible"}
    bad = table["status"] == "infeasible"
    assert result.infeasible == np.count_nonzero(bad)
    assert not np.any(table[CHANGED][bad])  # nothing holds a design that is not there
    for point in np.flatnonzero(bad):  # limits alone, not what follows from them
        output = {*table["failed"][point].split("; "), *table["active"][point].split("; ")} - {""}
        single = optlink.solve(problem(**{LIMIT: float(table[f"{LIMIT}_rad"][point])}), certify=False)
        assert {item.name for item in single.conflict} & output
    assert np.all(np.isnan(table["objective_rad2"][bad]))
    assert not np.any(table["valid"][bad])


@pytest.mark.slow
def test_a_dimension_varied_by_decades_finds_every_design():
    """The programme is scaled by its first frame, of 1 mm; a single solve of the last one finds a design."""
    table = sweep(problem(), ["mechanism.frame=1..1000 mm:4 log"], workers=1).columns
    assert table["status"][0] == "infeasible"
    single = optlink.solve(problem(**{"mechanism.frame": "1000 mm"}), certify=False)
    assert single.valid
    assert table["valid"][3]
    assert table["objective_rad2"][3] == pytest.approx(single.objective, rel=1e-9)


@pytest.mark.slow
def test_keys_outside_the_programme_are_rebuilt_at_each_point():
    result = sweep(problem(), ["requirement.span=60..90 deg:3"], workers=1)
    assert result.valid
    single = optlink.solve(optlink.load("crank-rocker", {"requirement.span": "75 deg"}))
    assert result.columns["objective_rad2"][1] == pytest.approx(single.objective, rel=1e-9)


def test_a_row_that_the_validator_rejects_is_not_valid(monkeypatch):
    """Every point goes through the validator, which is independent of the programme: here it is stricter."""
    from optlink.studies import reoptimise_task

    stricter = problem(**{"limits.transmission_angle": ["45 deg", "120 deg"]}).spec
    monkeypatch.setattr(
        reoptimise_task, "validate_batch", lambda _, designs, objective: prove(stricter, designs, None, objective)
    )
    result = sweep(problem(), ["mechanism.frame=500 mm, 510 mm"], workers=1)
    assert result.valid_points == 0
    assert set(result.columns["status"]) == {"optimal"}
    assert "largest transmission angle" in result.columns["failed"][0]
    assert "frame" in result.columns["failed"][1]  # the sweep's own frame, not that of the file


@pytest.mark.parametrize(
    "vary",
    [
        [f"{FRAME}:3", f"{LIMIT}=130..135 deg:3"],
        ["mechanism.coupler.max=405..420 mm:3", "mechanism.coupler.min=4..5 in:2"],
        [f"{LIMIT}=130, 135 deg", "limits.transmission_angle.min=30..40 deg:3"],
        ["limits.time_ratio.max=1.05, 1.2", "limits.swing_angle=40..45 deg:3"],
        ["requirement.psi0=90, 95 deg", "requirement.from=20..30 deg:2", "mechanism.crank=3.9..4 in:2"],
    ],
)
def test_models_made_directly_are_those_of_the_file(vary):
    file = problem(**{"limits.time_ratio": {"max": 1.3}, "limits.swing_angle": "42 deg"})
    if "psi0" in vary[0]:
        file = file.override({"requirement.psi0": "90 deg", "requirement.from": "30 deg"})
    grid = read_grid(file, vary)
    template = file.override(grid.changes(0)).spec
    template.quantities, template.law  # noqa: B018 - what is derived must not be taken along
    direct = FastOverride(template, grid.axes)
    assert direct.possible
    for point in range(grid.count):
        direct_model, read = direct.model(grid.values(point)), file.override(grid.changes(point)).spec
        assert {k: (q.value, q.bounds) for k, q in direct_model.quantities.items()} == {
            k: (q.value, q.bounds) for k, q in read.quantities.items()
        }
        for key in ("transmission_angle", "time_ratio", "swing_angle"):
            one, other = getattr(direct_model.limits, key), getattr(read.limits, key)
            assert (one.low, one.high) == (other.low, other.high)
        assert direct_model.start_position({k: q.value for k, q in direct_model.quantities.items()}) == read.start_position(
            {k: q.value for k, q in read.quantities.items()}
        )


def test_analysis_without_optimisation():
    file = problem("six-bar")
    name = next(key for key in file.model.mechanism.quantities if key.endswith(".length"))
    size = file.model.mechanism.quantities[name].value
    key = f"mechanism.links.{name}"
    result = sweep(file, [f"{key}={size!r}..{1.02 * size!r} m:5"], analyze=True, workers=1, points=90)
    values = np.linspace(size, 1.02 * size, 5)
    torque = optlink.analyze_batch(file, {name: values}, points=90)["input.torque_Nm"]
    assert np.all(result.columns["input.torque_Nm.min"] <= torque.min(axis=1))
    assert np.all(result.columns["input.torque_Nm.max"] >= torque.max(axis=1))
    for i, value in enumerate(values):
        exact = optlink.analyze(file, design={name: float(value)}).extremes["input.torque_Nm"]
        assert result.columns["input.torque_Nm.max"][i] == pytest.approx(exact.largest, rel=1e-12)
    np.testing.assert_allclose(result.columns["input.torque_Nm.rms"], np.sqrt((torque**2).mean(axis=1)), rtol=1e-12)


def test_only_dimensions_can_be_varied_in_an_analysis():
    with pytest.raises(InputError, match="varies dimensions of the mechanism only"):
        sweep(problem(), [f"{LIMIT}=120..130 deg:3"], analyze=True)
    with pytest.raises(InputError, match="no such column"):
        sweep(problem(), [f"{FRAME}:3"], analyze=True, columns=["torque"])


@pytest.mark.parametrize("points", [0, 1, -5, 10_001])
def test_the_number_of_crank_angles_is_limited(points):
    with pytest.raises(InputError, match=r"points = .*out of range.*2 to 10,000"):
        sweep(problem(), [f"{FRAME}:3"], analyze=True, points=points)


@pytest.mark.parametrize(("backend", "words"), [("both", "searches with one back end"), ("ipop", 'Did you mean "ipopt"')])
def test_a_back_end_that_no_study_has_is_refused(backend, words):
    with pytest.raises(InputError, match=words):
        sweep(problem(), [f"{FRAME}:3"], backend=backend)


def test_problems_that_cannot_be_swept_are_refused():
    with pytest.raises(InputError, match="nothing to solve"):
        sweep(problem("shaper"), ["mechanism.links.crank.length=0.1..0.11 m:3"])
    fixed = problem(**{"mechanism.coupler": "412 mm", "mechanism.rocker": "232 mm"})
    with pytest.raises(InputError, match="no design variables"):
        sweep(fixed, [f"{FRAME}:3"])


# --- identical bytes after failures ----------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory) -> bytes:
    def table() -> bytes:
        out = tmp_path_factory.mktemp("undisturbed")
        sweep(problem(), [f"{FRAME}:{POINTS}"], out, workers=1)
        assert sorted(path.name for path in out.iterdir()) == ["study.sqlite", "sweep.csv"]
        return (out / "sweep.csv").read_bytes()

    return once("undisturbed sweep", table)


@pytest.mark.slow
def test_workers_and_order_do_not_matter(undisturbed, tmp_path, monkeypatch):
    sweep(problem(), [f"{FRAME}:{POINTS}"], tmp_path / "two", workers=2)
    assert (tmp_path / "two" / "sweep.csv").read_bytes() == undisturbed
    monkeypatch.setattr(runner, "apart", lambda todo, workers: todo[::-1])
    sweep(problem(), [f"{FRAME}:{POINTS}"], tmp_path / "back", workers=1)
    assert (tmp_path / "back" / "sweep.csv").read_bytes() == undisturbed


def command(out: Path, *more: str, workers: int = 2) -> list[str]:
    vary = ["--vary", f"{FRAME}:{POINTS}", "--workers", str(workers)]
    return [sys.executable, "-m", "optlink", "study", "sweep", "crank-rocker", *vary, "--out", str(out), *more]


@pytest.mark.slow
def test_killed_twice_and_resumed(undisturbed, tmp_path):
    """SIGKILL, with one process and with two, each time a random while after the next chunk was written: nothing is lost."""
    out, rng, complete = tmp_path / "run", random.Random(7), 0
    for kill in range(2):
        arguments = command(out, *(["--resume"] if kill else []), workers=1 + kill)
        run = subprocess.Popen(arguments, cwd=ROOT, stdout=subprocess.DEVNULL)
        begin = time.monotonic()
        while chunks.complete(out) <= complete and time.monotonic() - begin < 60.0:
            assert run.poll() is None
            time.sleep(0.01)
        time.sleep(0.1 * rng.random())
        run.kill()
        run.wait()
        now = chunks.complete(out)
        assert complete < now <= 4
        complete = now
    done = subprocess.run([*command(out, "--resume"), "--json"], cwd=ROOT, capture_output=True, text=True, check=True)
    assert json.loads(done.stdout)["points_done_now"] == POINTS - 100 * complete
    assert (out / "sweep.csv").read_bytes() == undisturbed
    assert chunks.complete(out) == 0


@pytest.mark.slow
def test_a_finished_run_is_read_again(undisturbed, tmp_path):
    sweep(problem(), [f"{FRAME}:{POINTS}"], tmp_path, workers=1)
    again = sweep(problem(), [f"{FRAME}:{POINTS}"], tmp_path, resume=True)
    assert again.points_done_now == 0
    assert again.valid_points == POINTS
    assert (tmp_path / "sweep.csv").read_bytes() == undisturbed


def test_a_finished_run_reports_the_same_again(tmp_path):
    vary = ["mechanism.coupler.max=405..420 mm:61"]
    first = sweep(problem(), vary, tmp_path, workers=1)
    again = sweep(problem(), vary, tmp_path, resume=True)
    assert len(first.changes) == 1
    assert again.changes == first.changes
    assert (again.valid_points, again.searched_points, again.active_set_changes, again.best) == (
        61,
        first.searched_points,
        1,
        first.best,
    )


@pytest.mark.parametrize(
    "damage",
    [
        lambda b: b[:-40],
        lambda b: b + b"1,2\n",
        lambda b: b.replace(b",", b";", 1),
        lambda b: b"",
        lambda b: b.replace(b"0.", b"x.", 1),
        lambda b: b.replace(b"\n0.4", b"\n0.5", 1),
    ],
)
def test_a_changed_table_is_rejected(tmp_path, damage):
    sweep(problem(), [f"{FRAME}:3"], tmp_path, workers=1)
    table = tmp_path / "sweep.csv"
    table.write_bytes(damage(table.read_bytes()))
    with pytest.raises(InputError, match=r"changed or truncated.*start again"):
        sweep(problem(), [f"{FRAME}:3"], tmp_path, resume=True)


@pytest.fixture(scope="module")
def begun(tmp_path_factory) -> Path:
    """A sweep of two chunks interrupted after the first, and its complete table."""

    def fill(out: Path) -> None:
        with pytest.raises(KeyboardInterrupt):
            sweep(problem(), [f"{FRAME}:150"], out, workers=1, progress=interrupted_after(1))
        sweep(problem(), [f"{FRAME}:150"], out / "whole", workers=1)
        (out / "whole" / "sweep.csv").rename(out / "whole.csv")

    return folder_once("begun sweep", tmp_path_factory.mktemp("begun"), fill)


@pytest.mark.slow
@pytest.mark.parametrize(
    "damage",
    [
        lambda text: text[:-30],
        lambda text: text.replace("0.00", "0.01", 1),
        lambda text: "\x00" * len(text),
        lambda text: text.encode() + b"\xff\xfe",
        lambda text: "",
        lambda text: None,
    ],
)
def test_a_damaged_chunk_is_recomputed(begun, tmp_path, damage):
    out = tmp_path / "run"
    shutil.copytree(begun, out)
    chunks.change(out, 0, damage)
    resumed = sweep(problem(), [f"{FRAME}:150"], out, resume=True, workers=1)
    assert resumed.points_done_now == 150
    assert (out / "sweep.csv").read_bytes() == (begun / "whole.csv").read_bytes()


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="Windows has neither this signal nor this limit")
def test_ctrl_c_states_how_to_resume(undisturbed, tmp_path):
    out = tmp_path / "run"
    run = subprocess.Popen(command(out), cwd=ROOT, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    begin = time.monotonic()
    while not chunks.complete(out) and time.monotonic() - begin < 60.0:
        time.sleep(0.01)
    run.send_signal(signal.SIGINT)
    _, output = run.communicate(timeout=60)
    assert run.returncode == 130
    assert f"resume with --resume --out {out}" in output
    assert "Traceback" not in output
    sweep(problem(), [f"{FRAME}:{POINTS}"], out, resume=True, workers=1)
    assert (out / "sweep.csv").read_bytes() == undisturbed


LIMITED = """
import resource, sys
resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[1]),) * 2)
from optlink.cli.app import main
vary = ["--vary", "mechanism.frame=450..550 mm:400", "--workers", "1"]
sys.argv = ["optlink", "study", "sweep", "crank-rocker", *vary, *sys.argv[2:]]
main()
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="Windows has neither this signal nor this limit")
@pytest.mark.parametrize(("bytes_left", "kept"), [(4_000, 0), (26_000, 0), (60_000, 2)])
def test_a_full_disk_for_definition_or_chunk_keeps_finished_chunks(undisturbed, tmp_path, bytes_left, kept):
    out = tmp_path / "run"
    done = subprocess.run(
        [sys.executable, "-c", LIMITED, str(bytes_left), "--out", str(out)], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 2, done.stderr
    assert re.fullmatch(r".*cannot write the file: [a-zIO/ ]+\. Free some space or choose another folder\n", done.stderr)
    assert chunks.complete(out) == kept
    assert out.exists() == bool(kept)  # of a study of which nothing was done nothing stays
    sweep(problem(), [f"{FRAME}:{POINTS}"], out, resume=bool(kept), workers=1)
    assert (out / "sweep.csv").read_bytes() == undisturbed


@pytest.mark.slow
def test_a_truncated_chunk_is_recomputed(undisturbed, tmp_path):
    stopped = interrupted_after(3)
    with pytest.raises(KeyboardInterrupt):
        sweep(problem(), [f"{FRAME}:{POINTS}"], tmp_path, workers=1, progress=stopped)
    chunks.change(tmp_path, 0, lambda text: text[:-30])
    resumed = sweep(problem(), [f"{FRAME}:{POINTS}"], tmp_path, resume=True, workers=1)
    assert resumed.points_done_now == 200
    assert (tmp_path / "sweep.csv").read_bytes() == undisturbed


def interrupted_after(count: int):
    """A progress that is interrupted (Ctrl-C) when so many chunks are written."""
    calls = [0]

    def progress(done: int, total: int) -> None:
        calls[0] += 1
        if calls[0] > count:
            raise KeyboardInterrupt

    return progress


@pytest.mark.slow
def test_a_full_disk_keeps_finished_chunks(undisturbed, tmp_path, monkeypatch):
    real, written = store.Store.write, []

    def full(self, name, text):
        written.append(name)
        if len(written) > 3:  # the definition and two chunks
            self._database.execute("PRAGMA max_page_count = 1")  # sqlite takes the present size of the file
        real(self, name, text)

    with monkeypatch.context() as patch:
        patch.setattr(store.Store, "write", full)
        with pytest.raises(InputError, match=r"No space left on device.*Free some space"):
            sweep(problem(), [f"{FRAME}:{POINTS}"], tmp_path, workers=2)
    assert chunks.complete(tmp_path) == 2
    assert sweep(problem(), [f"{FRAME}:{POINTS}"], tmp_path, resume=True, workers=2).points_done_now == 200
    assert (tmp_path / "sweep.csv").read_bytes() == undisturbed


@pytest.mark.parametrize(
    ("other", "vary", "words"),
    [
        ({"mechanism.crank": "101 mm"}, f"{FRAME}:3", "problem hash differs"),
        ({}, f"{FRAME}:4", "axes differs"),
        ({}, "mechanism.crank=100..101 mm:3", "axes differs"),
    ],
)
def test_a_folder_of_another_study_is_refused_and_unchanged(tmp_path, other, vary, words):
    sweep(problem(), [f"{FRAME}:3"], tmp_path, workers=1)
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    for resume in (False, True):
        with pytest.raises(InputError, match=f"{words}.*nothing was overwritten"):
            sweep(problem(**other), [vary], tmp_path, resume=resume)
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before


def test_a_study_of_another_version_is_refused(tmp_path):
    sweep(problem(), [f"{FRAME}:3"], tmp_path, workers=1)
    chunks.change(tmp_path, store.ABOUT, lambda text: text.replace(optlink.__version__, "0.0.1"))
    with pytest.raises(InputError, match=r"optlink differs, there 0\.0\.1"):
        sweep(problem(), [f"{FRAME}:3"], tmp_path, resume=True)


@pytest.mark.parametrize("resume", [True, False])
def test_a_study_in_the_files_of_an_earlier_version_is_refused_and_unchanged(tmp_path, resume):
    files = {tmp_path / "study.json": '{"mode": "optimise"}', tmp_path / "chunks" / "00000" / "00000000.csv": "1,2\n"}
    for path, text in files.items():
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    with pytest.raises(InputError, match=r"earlier version of optlink.*Choose another folder, or continue it with that version"):
        sweep(problem(), [f"{FRAME}:3"], tmp_path, resume=resume)
    assert {path: path.read_text() for path in tmp_path.rglob("*") if path.is_file()} == files


@pytest.mark.parametrize("damage", [lambda data: b"mine", lambda data: data[:100], lambda data: data[:4096] + b"x" * 4096])
def test_a_damaged_file_of_a_study_is_refused_and_unchanged(tmp_path, damage):
    sweep(problem(), [f"{FRAME}:3"], tmp_path, workers=1)
    place = tmp_path / store.STORE
    place.write_bytes(damage(place.read_bytes()))
    before = place.read_bytes()
    with pytest.raises(InputError, match=r"description of the study in the folder cannot be read\. Choose another folder"):
        sweep(problem(), [f"{FRAME}:3"], tmp_path, resume=True)
    assert place.read_bytes() == before


def test_a_run_killed_before_its_first_entry_is_begun_again(tmp_path):
    (tmp_path / store.STORE).touch()
    with pytest.raises(InputError, match="no study to resume"):
        sweep(problem(), [f"{FRAME}:3"], tmp_path, resume=True)
    assert sweep(problem(), [f"{FRAME}:3"], tmp_path, workers=1).valid


@pytest.mark.slow
def test_a_killed_run_without_a_folder_leaves_no_temporary_files(tmp_path):
    code = "import optlink\nfrom optlink.studies import sweep\n"
    code += f"sweep(optlink.load('crank-rocker'), ['{FRAME}:9000'], workers=1, progress=lambda *at: print(*at, flush=True))"
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "TMPDIR": str(tmp_path), "TEMP": str(tmp_path)}
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True, env=environment) as run:
        for _ in range(3):
            assert run.stdout.readline().endswith(" 9000\n")
        run.kill()
    assert not list(tmp_path.iterdir())


def test_a_study_is_not_restarted_without_resume(tmp_path):
    sweep(problem(), [f"{FRAME}:3"], tmp_path, workers=1)
    with pytest.raises(InputError, match="resume"):
        sweep(problem(), [f"{FRAME}:3"], tmp_path)
    with pytest.raises(InputError, match="no study to resume"):
        sweep(problem(), [f"{FRAME}:3"], tmp_path / "empty", resume=True)


def test_a_table_that_is_no_study_is_not_overwritten(tmp_path):
    (tmp_path / "sweep.csv").write_text("mine\n")
    with pytest.raises(InputError, match="another study"):
        sweep(problem(), [f"{FRAME}:3"], tmp_path)
    assert (tmp_path / "sweep.csv").read_text() == "mine\n"


# --- engines ---------------------------------------------------------------------------------------------------------


class Square:
    """A task for engines: squares, and ways to fail."""

    def __init__(self, folder: Path, deadly: int = -1, always: bool = False, faulty: int = -1) -> None:
        self.folder, self.deadly, self.always, self.faulty = folder, deadly, always, faulty

    def __call__(self, index: int) -> int:
        with (self.folder / f"done-{index}").open("a") as file:
            file.write("x")
        if index == self.deadly and (self.always or (self.folder / f"done-{index}").read_text() == "x"):
            os._exit(9)
        if index == self.faulty:
            raise ZeroDivisionError("no inverse of zero")
        time.sleep(0.02)
        return index * index


def answers_of(task: Square, count: int, workers: int) -> Iterator[tuple[int, Any]]:
    with runner.pool(workers=workers) as runs:
        yield from runs(task, runner.apart(list(range(count)), workers))


@pytest.mark.slow
def test_a_worker_that_dies_costs_only_its_chunk(tmp_path):
    computed = {index: answer.value for index, answer in answers_of(Square(tmp_path, deadly=3), 12, 2)}
    assert computed == {index: index * index for index in range(12)}
    done = {index: len((tmp_path / f"done-{index}").read_text()) for index in range(12)}
    assert done == {index: 2 if index == 3 else 1 for index in range(12)}


@pytest.mark.slow
def test_a_chunk_that_kills_every_worker_is_named(tmp_path):
    with pytest.raises(SolverError, match=r"chunk 3 .* terminated 3 processes"):
        list(answers_of(Square(tmp_path, deadly=3, always=True), 6, 2))


@pytest.mark.slow
@pytest.mark.parametrize("workers", [1, 2])
def test_a_failure_is_reported_with_its_point(tmp_path, workers):
    with pytest.raises(SolverError, match=r"(?s)chunk 2.*no inverse of zero"):
        list(answers_of(Square(tmp_path, faulty=2), 4, workers))


@pytest.mark.slow
def test_no_process_outlives_an_abandoned_run(tmp_path):
    before = threading.active_count()
    answers = answers_of(Square(tmp_path), 1000, 2)
    next(answers)
    answers.close()
    assert threading.active_count() == before
    done = len(list(tmp_path.iterdir()))
    time.sleep(0.3)
    assert len(list(tmp_path.iterdir())) == done < 1000


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"engine": "dusk"}, 'Did you mean "dask"'),
        ({"workers": 0}, "out of range"),
        ({"workers": 5000}, "out of range"),
        ({"scheduler": "tcp://127.0.0.1:8786"}, "Add engine dask"),
    ],
)
def test_bad_engines(options, words, tmp_path):
    with pytest.raises(InputError, match=words):
        sweep(problem(), [f"{FRAME}:3"], tmp_path / "new", **options)
    assert not (tmp_path / "new").exists()  # so that the same folder serves once the option is mended


def test_missing_dask_is_reported_with_its_installation(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(InputError, match=r'pip install "\.\[dask\]"'):
        sweep(problem(), [f"{FRAME}:3"], engine="dask")


def children() -> set[int]:
    """Processes that this one has started and that have not ended."""
    return {child.pid for child in psutil.Process().children() if child.status() != psutil.STATUS_ZOMBIE}


DASK = """
import os, signal, sys, time
from pathlib import Path
from typing import Any
import optlink
from optlink.studies import sweep
from tests.studies.test_sweep import children

killed = []

def kill_one(done, wanted):
    if not killed and 0 < done < wanted:
        worker = next(iter(children()))
        os.kill(worker, signal.SIGKILL)
        killed.append(worker)
        print("killed")

if __name__ == "__main__":
    vary, file = ["mechanism.frame=450..550 mm:400"], optlink.load("crank-rocker")
    sweep(file, vary, Path(sys.argv[1], "killed"), engine="dask", workers=2, progress=kill_one)
    begin = time.monotonic()
    try:
        sweep(file, vary, engine="dask", scheduler="tcp://127.0.0.1:9")
    except optlink.InputError as error:
        print(error, time.monotonic() - begin < 20)
"""


@pytest.mark.slow
def test_a_cluster_whose_worker_is_killed_gives_the_same_bytes(undisturbed, tmp_path):
    pytest.importorskip("distributed")
    script = tmp_path / "cluster.py"
    script.write_text(DASK)
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        [sys.executable, str(script), str(tmp_path)], check=False, capture_output=True, text=True, env=environment, timeout=300
    )
    assert done.returncode == 0, done.stderr
    assert "killed" in done.stdout
    assert (tmp_path / "killed" / "sweep.csv").read_bytes() == undisturbed
    assert "no scheduler answers there within 10 s" in done.stdout
    assert done.stdout.rstrip().endswith("True")


SCHEDULER = """
import sys
from distributed import LocalCluster

if __name__ == "__main__":
    with LocalCluster(
        n_workers=1, threads_per_worker=1, processes=False, protocol="tcp", host="127.0.0.1", dashboard_address=":0"
    ) as cluster:
        print(cluster.scheduler_address, flush=True)
        sys.stdin.read()
"""


@pytest.mark.slow
def test_a_dead_scheduler_gives_one_sentence_and_loses_no_chunk(undisturbed, tmp_path):
    pytest.importorskip("distributed")
    script, out = tmp_path / "scheduler.py", tmp_path / "run"
    script.write_text(SCHEDULER)
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    with subprocess.Popen([sys.executable, str(script)], env=environment, **pipes) as scheduler:
        try:
            address = scheduler.stdout.readline().strip()
            arguments = command(out, "--engine", "dask", "--scheduler", address)
            with subprocess.Popen(arguments, cwd=ROOT, **pipes) as run:
                while not chunks.complete(out):
                    assert run.poll() is None
                    time.sleep(0.01)
                scheduler.kill()
                output = run.communicate(timeout=60)[1]
        finally:
            scheduler.kill()
    assert run.returncode == 3
    sentences = [line for line in output.splitlines() if line.strip()]
    assert len(sentences) == 1, output
    assert f"the Dask scheduler {address} did not answer" in sentences[0]
    complete = chunks.complete(out)
    assert 1 <= complete < 4
    resumed = sweep(problem(), [f"{FRAME}:{POINTS}"], out, resume=True, workers=1)
    assert resumed.points_done_now == POINTS - 100 * complete
    assert (out / "sweep.csv").read_bytes() == undisturbed


def listening(processes: set[int]) -> set[str]:
    """Local addresses of the TCP sockets, of IPv4 and IPv6, on which some of these processes listen."""
    sockets = set()
    for process in processes:
        for handle in Path(f"/proc/{process}/fd").iterdir():
            with contextlib.suppress(FileNotFoundError):
                sockets.add(os.readlink(handle))
    rows = [
        line.split() for name in ("tcp", "tcp6") for line in Path("/proc/net", name).read_text(encoding="utf-8").splitlines()[1:]
    ]
    return {row[1] for row in rows if row[3] == "0A" and f"socket:[{row[9]}]" in sockets}


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/net/tcp").exists(), reason="reads the tables of Linux")
def test_a_cluster_of_this_machine_listens_on_no_port(tmp_path):
    pytest.importorskip("distributed")
    own = {os.getpid()}
    with socket.create_server(("127.0.0.1", 0)):
        assert len(listening(own)) == 1  # such a port would be seen
    seen = []

    def look(done: int, expected: int) -> None:
        workers = children() - others
        if 0 < done < expected:
            seen.append((len(workers), listening(own | workers)))

    before, others = listening(own), children()  # the browser of other tests among them
    sweep(problem(), [f"{FRAME}:400"], tmp_path, engine="dask", workers=2, progress=look)
    assert seen == [(2, before)] * 3
    assert not children() - others


# --- cost ------------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="resident memory as POSIX counts it")
def test_memory_is_flat():
    """Resident memory after 200 and after 1200 points, in a process of its own."""
    code = """
import resource, optlink
from optlink.studies import sweep
file = optlink.load("crank-rocker")
peak = lambda: resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
sweep(file, ["mechanism.frame=450..550 mm:200"], workers=1)
early = peak()
sweep(file, ["mechanism.frame=450..550 mm:1200"], workers=1)
print(peak() - early)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    assert float(done.stdout) < 4.0  # MB


# --- the command -----------------------------------------------------------------------------------------------------


def run(*arguments: str):
    return CliRunner().invoke(app, ["study", "sweep", *arguments])


def test_the_command_prints_and_writes(tmp_path):
    done = run("crank-rocker", "--vary", f"{FRAME}:11", "--out", str(tmp_path), "--json")
    assert done.exit_code == 0
    document = json.loads(done.stdout)
    assert document["schema"] == "optlink/sweep/4"
    assert document["valid_points"] == 11
    assert document["best"]["mechanism.frame_m"] == 0.55
    assert {"result.json", "study.sqlite", "sweep.csv", "sweep.png"} == {path.name for path in tmp_path.iterdir()}
    text = run("crank-rocker", "--vary", f"{FRAME}:5", "--vary", f"{LIMIT}=130, 135 deg")
    assert text.exit_code == 0
    assert "every point a verified local optimum" in text.stdout


def test_varied_values_are_described_by_the_least_and_the_largest():
    """Of an unsorted list the first and the last were shown, of one value both: "500 ... 500 mm  1 values"."""
    text = run("crank-rocker", "--vary", f"{LIMIT}=135, 140, 130 deg", "--vary", "mechanism.frame=500 mm").stdout
    lines = [" ".join(line.split()) for line in text.splitlines()]
    assert f"{LIMIT} 130 ... 140 deg 3 points" in lines
    assert "mechanism.frame 500 mm 1 point" in lines


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "arguments", "panels", "legend"),
    [
        ("crank-rocker", [f"{FRAME}:5"], 2, ""),
        ("crank-rocker", [f"{LIMIT}=60..100 deg:5"], 2, "no design"),
        (
            "crank-rocker",
            ["mechanism.frame=550 mm, 450 mm, 500 mm", f"{LIMIT}=85..135 deg:4"],
            1,
            "other constraints become active",
        ),
        (
            "crank-rocker",
            ["mechanism.crank=100..140 mm:3", "mechanism.frame=460 mm, 500 mm", f"{LIMIT}=85, 135 deg"],
            3,
            "no design",
        ),
        ("crank-rocker", ["mechanism.crank=100 mm", f"{FRAME}:5"], 2, ""),
        ("slider-crank", ["mechanism.links.rod.length=50..300 mm:9 log"], 1, "no valid result"),
        ("slider-crank", ["mechanism.links.rod.length=150..300 mm:3 log", "mechanism.links.crank.length=0.05..0.1 m:3"], 3, ""),
    ],
)
def test_pictures_over_one_two_and_three_parameters(name, arguments, panels, legend):
    result = sweep(problem(name), arguments, analyze=name == "slider-crank", workers=1)
    drawn = draw([chart for chart in charts(result) if chart.file])
    axes = [axes for axes in drawn.axes if axes.get_label() != "<colorbar>" and axes.axison]
    assert len(axes) == panels
    entries = {text.get_text() for one in axes if one.get_legend() is not None for text in one.get_legend().get_texts()}
    assert not legend or legend in entries
    assert bool(entries & {"no design", "no valid result", "other constraints become active", "not verified"}) == bool(legend)
    for one in axes:
        label = one.xaxis.get_label_text()
        assert not label or label.endswith(("[mm]", "[deg]", "[m]"))
    if len(axes) == 1 and name == "crank-rocker":  # rows in rising order, though they were asked for in another
        low, high = axes[0].get_ylim()
        assert (low, high) == pytest.approx((425.0, 575.0))
        shown = axes[0].collections[0].get_array().reshape(3, 4)
        table = result.columns["objective_rad2"].reshape(3, 4)
        np.testing.assert_array_equal(np.ma.filled(shown, np.nan), table[[1, 2, 0]])


@pytest.mark.slow
def test_a_given_design_may_omit_varied_keys(tmp_path):
    arguments = ["--analyze", "--vary", "mechanism.coupler=400..420 mm:2", "--column", "rocker.angle_rad"]
    assert run("crank-rocker", *arguments, "--design", "rocker=232 mm", "--out", str(tmp_path)).exit_code == 0
    rows = (tmp_path / "sweep.csv").read_text().splitlines()[1:]
    for row, coupler in zip(rows, (400.0, 420.0), strict=True):  # crank and coupler in line: law of cosines
        dead = math.pi - math.acos((232.0**2 + 500.0**2 - (coupler + 100.0) ** 2) / (2.0 * 232.0 * 500.0))
        assert float(row.split(",")[1]) == pytest.approx(dead, abs=1e-4)
    assert run("crank-rocker", *arguments).exit_code == 0
    assert run("crank-rocker", *arguments, "--design", "coupler=400 mm").exit_code == 2  # the rocker is missing


@pytest.mark.slow
def test_some_points_not_valid_is_exit_code_1():
    assert run("crank-rocker", "--vary", f"{LIMIT}=70, 135 deg").exit_code == 1


def half_written(path: Path) -> None:
    with io.whole(path) as temporary:
        temporary.write_text("half")
        raise ZeroDivisionError


def test_files_are_written_completely_or_not_at_all(tmp_path):
    with pytest.raises(ZeroDivisionError):
        half_written(tmp_path / "a.txt")
    assert list(tmp_path.iterdir()) == []


def test_crank_angles_without_an_analysis_are_refused():
    done = run("crank-rocker", "--vary", f"{FRAME}:3", "--points", "90")
    assert done.exit_code == 2
    assert "--points" in done.stderr
    assert "Add --analyze" in done.stderr


@pytest.mark.parametrize(
    "other",
    [
        pytest.param(["study", "tolerance", "--tolerance", "coupler=0.1 mm", "--samples", "0"], marks=pytest.mark.slow),
        pytest.param(["study", "sensitivity"], marks=pytest.mark.slow),
        ["solve"],
    ],
)
def test_a_sweep_is_not_overwritten_by_another_result(tmp_path, other):
    assert run("crank-rocker", "--vary", f"{FRAME}:2", "--out", str(tmp_path)).exit_code == 0
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    done = CliRunner().invoke(app, [*other, "crank-rocker", "--out", str(tmp_path)])
    assert done.exit_code == 2
    assert "the folder contains a sweep of crank-rocker" in done.stderr
    assert "Choose another folder" in done.stderr
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before
    front = json.dumps({"mode": "pareto", "problem": "shaper", "objectives": []})
    chunks.change(tmp_path, store.ABOUT, lambda _: front)
    assert "a front of shaper" in CliRunner().invoke(app, [*other, "crank-rocker", "--out", str(tmp_path)]).stderr


@pytest.mark.parametrize(
    ("objectives", "words"),
    [
        ("error, coupler=1..2 mm", "the range exceeds the bounds of coupler, 100 to 900 mm"),
        ("error, coupler.min=0.4..1 m", "the range exceeds the bounds of coupler, 100 to 900 mm"),
        ("error, coupler=300..200 mm", "its ends are in the wrong order"),
    ],
)
def test_fronts_stay_within_the_bounds_of_sizes(objectives, words):
    done = CliRunner().invoke(app, ["study", "pareto", "crank-rocker", "--objectives", objectives, "--points", "3"])
    assert done.exit_code == 2
    assert words in done.stderr


@pytest.mark.slow
def test_a_single_point_is_reported_in_the_singular(tmp_path):
    aims = "error, coupler=500..900 mm"  # at both the coupler of the best design is shorter: one point
    done = CliRunner().invoke(app, ["study", "pareto", "crank-rocker", "--objectives", aims, "--points", "2"])
    assert done.exit_code == 0
    assert "\n1 point, each a verified local optimum" in done.stdout
    assert "\n2 points done" in done.stdout


def test_an_interrupted_search_gives_no_row(monkeypatch):
    """A search that Ctrl-C ended with its best design so far ends the study: nothing of it is kept as the optimum."""
    from types import SimpleNamespace

    from optlink.studies import reoptimise_task

    monkeypatch.setattr(reoptimise_task, "solve", lambda *_, **__: SimpleNamespace(interrupted=True))
    file = optlink.load("shaper-design")
    task = reoptimise_task.optimum_task(file, read_grid(file, ["drive.speed=50,60 rpm"]), "ipopt", 1)
    with pytest.raises(KeyboardInterrupt):
        task.lines(0)


@pytest.mark.slow
def test_rows_of_a_symmetric_path_do_not_alternate_between_mirror_images(tmp_path):
    """The bean is symmetric about the y axis: a search finds either of two mirror images first."""
    swept = sweep(optlink.load("path-bean"), ["limits.transmission_angle.min=34 deg, 36 deg"], tmp_path)
    for name in ("P.across_m", "A.x_m", "direction_rad"):
        first, second = swept.columns[name]
        assert first == pytest.approx(second, abs=1e-6)
    result = optlink.solve(optlink.load("path-bean"))
    best, mirrored, *others = result.designs
    assert best.values["P.across"] == pytest.approx(-mirrored.values["P.across"], abs=1e-9)
    ends = [
        oriented(replace(result, designs=designs)).design for designs in ((best, mirrored, *others), (mirrored, best, *others))
    ]
    assert ends[0] == ends[1]
    assert ends[0]["P.across"] > 0.0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "vary", "unit"),
    [
        ("stroke-slider-crank", "requirement.stroke=100 mm, 110 mm", "deg"),
        ("path-scott-russell", "limits.alignment=1 deg, 2 deg", "mm^2"),
        ("transmission-optimal", "limits.swing_angle=80 deg, 81 deg", "deg"),
    ],
)
def test_the_objective_of_a_sweep_is_that_of_a_single_design_in_si(name, vary, unit, tmp_path):
    swept, single = sweep(optlink.load(name), [vary], tmp_path), optlink.solve(optlink.load(name))
    shown = single.problem.model.shown_objective(single.objective)
    assert shown.unit == unit
    size, si = in_si(unit)
    assert swept.columns[f"objective_{si.replace('^', '')}"][0] == pytest.approx(size * shown.value, rel=1e-6, abs=1e-12)


@pytest.mark.slow
def test_a_sweep_over_arrays_is_that_over_texts():
    """One grid has one table, in SI, whether its values are arrays, texts, or a text as on the command line, in any unit."""
    problem, frames, angles = optlink.load("crank-rocker"), np.linspace(0.48, 0.52, 3), np.radians([128.0, 135.0])
    arrays = sweep(problem, {"mechanism.frame": frames, LIMIT: angles})
    texts = sweep(problem, {"mechanism.frame": "480..520 mm:3", LIMIT: ["128 deg", "135 deg"]})
    metres = sweep(problem, ["mechanism.frame=0.48..0.52 m:3", f"{LIMIT}=128, 135 deg"])
    assert np.array_equal(arrays.columns["mechanism.frame_m"], np.repeat(frames, 2))
    assert arrays.columns[f"{LIMIT}_rad"] == pytest.approx(np.tile(angles, 3), rel=1e-14)
    assert arrays.grid == texts.grid
    for other in (texts, metres):
        assert other.names == arrays.names
        for name in arrays.names[:5]:
            assert np.allclose(arrays.columns[name], other.columns[name], rtol=1e-9)
        assert list(arrays.columns["status"]) == list(other.columns["status"])


def test_the_best_point_is_a_row_with_the_types_of_the_columns():
    result = sweep(optlink.load("crank-rocker"), {"mechanism.frame": [0.48, 0.5]})
    assert result.best == {name: column[1] for name, column in result.columns.items()}
    assert [type(value) for value in result.best.values()] == [float] * 4 + [str, bool, str, str, str, bool]


def test_a_copied_sweep_without_a_folder_keeps_its_table():
    """Its file is temporary and goes with the first object."""
    result = sweep(optlink.load("crank-rocker"), {"mechanism.frame": [0.48, 0.5]})
    columns, gone = result.columns, result.path
    packed = pickle.dumps(result)
    del result
    gc.collect()
    assert not gone.exists()
    again = pickle.loads(packed)
    assert again.names == tuple(columns)
    assert all(np.array_equal(again.columns[name], column) for name, column in columns.items())
    assert again.path.exists()
    again.path.unlink()
    with pytest.raises(InputError, match=r"cannot read the table of the sweep: No such file or directory\. Run the sweep again"):
        _ = replace(again, table=TableFile(again.path)).names


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ([480, 500], 'vary.mechanism.frame = 480: a length needs a unit. Write "480 mm" or "480 m"'),
        ([480.0, 500.0], "500 m are 556 times the largest length of the mechanism. Numbers are SI: 500 mm are 0.5, or the text "),
        (["480 mm", "0.5"], "a text without a unit"),
        ([0.48, math.nan], "not a list of finite numbers"),
    ],
)
def test_values_of_an_axis_are_si_or_have_a_unit(values, message):
    with pytest.raises(InputError, match=re.escape(message)):
        sweep(optlink.load("crank-rocker"), {"mechanism.frame": values})


@pytest.mark.slow
def test_a_sweep_of_transmission_angles_has_angles() -> None:
    """The objective of the search is a cosine; the column is the angle that `solve` shows, and has its unit in its name."""
    problem = optlink.load("transmission-optimal")
    result = sweep(problem, ["limits.swing_angle=60 deg, 70 deg"], workers=1)
    for swing, angle in zip((60.0, 70.0), np.degrees(result.columns["objective_rad"]), strict=True):
        single = optlink.solve(problem.override({"limits.swing_angle": f"{swing} deg"}), starts=60)
        assert angle == pytest.approx(90.0 - math.degrees(single.best.least_transmission), abs=1e-6)
