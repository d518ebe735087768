"""Results of changed problems: the record knows the changes, so pages need no `--set`."""

from __future__ import annotations

import json

import pytest
from typer.testing import CliRunner

from optlink.cli.app import app
from optlink.presentation.registry import read_result
from optlink.problem.file import load

FRAME = "mechanism.frame"


def run(*arguments: object):
    return CliRunner().invoke(app, list(map(str, arguments)))


@pytest.mark.slow
def test_the_page_of_a_changed_problem_needs_no_set(tmp_path):
    """From its folder, and from its file elsewhere."""
    out, elsewhere = tmp_path / "out", tmp_path / "elsewhere.json"
    assert run("solve", "crank-rocker", "--set", "mechanism.frame=480 mm", "--out", out).exit_code == 0
    elsewhere.write_text((out / "result.json").read_text())
    for subject in (out, elsewhere):
        done = run("report", subject, "-o", tmp_path / "page.html")
        assert done.exit_code == 0, done.output
        assert read_result(subject).problem.model.quantities["frame"].value == pytest.approx(0.48)


@pytest.mark.slow
def test_a_result_states_its_changes_and_takes_no_others(tmp_path):
    out = tmp_path / "out"
    assert run("analyze", "slider-crank", "--points", "12", "--set", "gravity=0 m/s^2", "--out", out).exit_code == 0
    assert json.loads((out / "result.json").read_text())["overrides"] == {"gravity": "0 m/s^2"}
    done = run("report", out, "-o", tmp_path / "page.html", "--set", "gravity=1 m/s^2")
    assert done.exit_code == 2
    assert "a result already contains its problem" in done.output


def test_overrides_of_overrides_are_recorded_in_their_order():
    once = load("crank-rocker", {FRAME: "480 mm", "mechanism.crank": "90 mm"})
    twice = once.override({FRAME: "470 mm"})
    assert list(twice.overrides.items()) == [("mechanism.crank", "90 mm"), (FRAME, "470 mm")]
    assert load("crank-rocker", twice.overrides).hash == twice.hash != once.hash
