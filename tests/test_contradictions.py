"""Result files whose figures contradict the design in them."""

from __future__ import annotations

import json

import pytest
from typer.testing import CliRunner

from optlink.cli import app


def run(*arguments: object):
    return CliRunner().invoke(app, list(map(str, arguments)))


@pytest.fixture(scope="module", params=["crank-rocker", "path-arc5"])
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
    own = json.loads(json.dumps(document))
    for part in (own, *own.get("designs", [])):
        if "objective" in part:
            part["objective"]["value"] *= 0.98
    path.write_text(json.dumps(own))
    done = run("validate", name, "--design", path)
    assert done.exit_code == 1
    assert "objective of the result" in " ".join(done.output.split())


def test_a_result_file_with_other_angles_is_not_valid(solved):
    name, document, path = solved
    own = json.loads(json.dumps(document))
    if name == "crank-rocker":
        own["design"]["psi0_deg"] += 0.2
    else:
        own["designs"][0]["points"]["crank_deg"][2] += 0.2
    path.write_text(json.dumps(own))
    assert run("validate", name, "--design", path).exit_code == 1


def test_a_result_file_of_another_problem_is_named(solved):
    name, document, path = solved
    path.write_text(json.dumps({**document, "problem_hash": "0123456789abcdef"}))
    done = run("validate", name, "--design", path)
    assert "result of another problem" in done.output
    assert "0123456789abcdef" in done.output
