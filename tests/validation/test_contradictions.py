"""Result files whose figures contradict the design in them."""

from __future__ import annotations

import json

import pytest
from typer.testing import CliRunner

from optlink.cli.app import app
from tests.tiers import mostly_slow


def run(*arguments: object):
    return CliRunner().invoke(app, list(map(str, arguments)))


@pytest.fixture(scope="module", params=mostly_slow(["crank-rocker", "path-arc5"], "crank-rocker"))
def solved(request, tmp_path_factory):
    out = tmp_path_factory.mktemp("solved")
    done = run("solve", request.param, "--json")
    assert done.exit_code == 0
    return request.param, json.loads(done.stdout), out / "result.json"


def test_a_result_file_that_agrees_with_its_design_is_valid(solved):
    name, document, path = solved
    path.write_text(json.dumps(document))
    done = run("validate", name, "--design", path)
    assert done.exit_code == 0, done.output
    assert "result file" not in done.output


def test_a_result_file_with_another_objective_is_not_valid(solved):
    name, document, path = solved
    changed_document = json.loads(json.dumps(document))
    for part in (changed_document, *changed_document.get("designs", [])):
        if "objective" in part:
            part["objective"]["value"] *= 0.98
    path.write_text(json.dumps(changed_document))
    done = run("validate", name, "--design", path)
    assert done.exit_code == 1
    assert "objective of the result" in " ".join(done.output.split())


def test_a_result_file_with_other_angles_is_not_valid(solved):
    name, document, path = solved
    changed_document = json.loads(json.dumps(document))
    if name == "crank-rocker":
        changed_document["design"]["psi0_deg"] += 0.2
    else:
        changed_document["designs"][0]["points"]["crank_deg"][2] += 0.2
    path.write_text(json.dumps(changed_document))
    assert run("validate", name, "--design", path).exit_code == 1


def test_a_result_file_of_another_problem_is_refused(solved):
    name, document, path = solved
    path.write_text(json.dumps({**document, "problem_hash": "0123456789abcdef"}))
    done = run("validate", name, "--design", path)
    assert "result of another problem" in done.output
    assert "0123456789abcdef" in done.output


# --- machines designed by their cycle ------------------------------------------------------------------------------------------

SLIDER_CRANK = """
title = "Offset slider-crank with a free rod"
gravity = "9.81 m/s^2"
[mechanism.ground]
A = ["0 mm", "0 mm"]
[mechanism.links]
crank = { joints = ["A", "B"], length = { start = "40 mm", bounds = ["30 mm", "60 mm"] } }
rod = { joints = ["B", "C"], length = { start = "180 mm", bounds = ["150 mm", "230 mm"] } }
ram = { joints = ["C"] }
[mechanism.guides]
G = { slider = "ram", direction = "12 deg", through = "A", offset = "20 mm" }
[mechanism.assembly]
C = "forward"
[bodies]
ram = { mass = "4 kg" }
[loads]
pressing = { on = "ram", force = "1.5 kN", acts = "opposing", stroke = "forward" }
[drive]
speed = "60 rpm"
[objective]
quantity = "torque"
measure = "peak"
[limits]
stroke = { quantity = "stroke", of = "ram", exactly = "90 mm" }
bearing = { quantity = "reaction", of = "B", max = "3 kN" }
"""


@pytest.fixture(scope="module")
def machine(tmp_path_factory):
    folder = tmp_path_factory.mktemp("machine")
    path = folder / "press.toml"
    path.write_text(SLIDER_CRANK)
    done = run("solve", path, "--json")
    assert done.exit_code == 0, done.output
    return path, json.loads(done.stdout), folder / "result.json"


def changed(machine, change):
    """Exit code, names of the checks that fail and warnings of `validate` for the result file after a change."""
    problem, document, path = machine
    copy = json.loads(json.dumps(document))
    change(copy)
    path.write_text(json.dumps(copy))
    done = run("validate", problem, "--design", path, "--json")
    failed = [check["name"] for check in json.loads(done.stdout)["validation"] if not check["passed"]]
    return done.exit_code, f"{'; '.join(failed)} {done.stderr}"


@pytest.mark.slow
def test_a_result_of_a_cycle_that_agrees_is_valid(machine):
    code, output = changed(machine, lambda own: None)
    assert code == 0, output
    assert "result file" not in output


@pytest.mark.slow
def test_contradictions_in_the_result_of_a_cycle_are_not_valid(machine):
    """Each planted alone: the objective, crank angles of a stroke, figures of limits, sizes, an angle of the design."""

    def objective(own):
        own["objective"]["value"] *= 1.0 + 1e-4

    def rotation(own):
        own["strokes"]["ram slides"]["backward"]["crank_rotation_deg"] += 0.1

    def begin(own):
        own["strokes"]["rod swings"]["forward"]["crank_from_deg"] -= 0.2

    def figure(own):
        next(row for row in own["figures"] if row["name"] == "bearing")["result"] *= 0.999

    def size(own):
        own["design"]["rod.length_mm"] *= 1.01

    def fixed(own):
        own["design"]["G.offset_mm"] += 0.1

    def angle(own):
        own["design"]["G.direction_deg"] += 0.2

    for change, words in (
        (objective, "objective of the result file"),
        (rotation, "crank_rotation_deg of ram slides backward"),
        (begin, "crank_from_deg of rod swings forward"),
        (figure, "peak reaction at B of the result file"),
        (size, "objective of the result file"),
        (angle, "G.direction within its bounds"),
        (fixed, "G.offset within its bounds"),
    ):
        code, output = changed(machine, change)
        assert code == 1, change.__name__
        assert words in output, output


def test_crank_angles_that_differ_by_whole_revolutions_agree(machine):
    def turned(own):
        own["strokes"]["ram slides"]["forward"]["crank_from_deg"] += 360.0

    assert changed(machine, turned)[0] == 0


def test_a_result_of_another_cycle_problem_is_refused(machine):
    """Its figures are not compared; the design itself is judged by the problem."""

    def other(own):
        own["problem_hash"] = "0123456789abcdef"
        own["objective"]["value"] *= 2.0

    code, output = changed(machine, other)
    assert code == 0
    assert "result of another problem" in output
    assert "0123456789abcdef" in output
