"""Templates: each is complete, explained line by line, and solved by the command that it names."""

from __future__ import annotations

import json
import re
import shlex
import tomllib
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import optlink
from optlink.cli.app import app
from optlink.linkage.motion import sweep
from optlink.problem.templates import NEXT, template, templates
from tests.solved import shared_searches
from tests.test_docs import answer

NAMES = sorted(templates())
QUICK = ("law",)  # the others take some seconds each


def run(*arguments: str):
    return CliRunner().invoke(app, list(arguments))


def test_every_machine_has_a_template():
    asked = {"law", "function", "path", "poses", "quick-return-press", "wiper", "walker", "pump", "toggle-press", "six-bar"}
    driven = {"large-swing", "lift", "cam-follower", "geared-five-bar", "hood", "excavator-arm"}
    assert asked | driven | {"clearance", "balance", "stroke"} <= set(NAMES)


@pytest.mark.parametrize("name", NAMES)
def test_template_is_a_problem_file(name):
    text = template(name)
    problem = optlink.read(tomllib.loads(text.text), name)
    assert not re.search(r"^$|[0-9]", problem.model.title)  # figures change, and the title would remain
    assert problem.model.about
    assert 20 < len(text.summary) < 80
    assert text.commands[0] in (f"optlink {verb} {name}.toml" for verb in ("solve", "analyze", "simulate"))
    assert len(text.commands) >= 2


def unexplained(text: str) -> list[str]:
    """Lines with a key and no comment, neither in the line nor above it."""
    lines = text.partition('"""\n')[2].partition('"""\n')[2].splitlines()
    keys = [(above, line) for above, line in zip(["", *lines], lines, strict=False) if line[:1].isalnum() and "=" in line]
    return [line for above, line in keys if "#" not in line and not above.startswith("#")]


@pytest.mark.parametrize("name", NAMES)
def test_every_line_is_explained(name):
    assert unexplained(template(name).text) == []


def test_a_line_without_comment_is_detected():
    assert unexplained(template("law").text + 'time_ratio = "1"\n') == ['time_ratio = "1"']


@pytest.mark.parametrize("name", [name if name in QUICK else pytest.param(name, marks=pytest.mark.slow) for name in NAMES])
def test_next_command_gives_a_valid_result(name, tmp_path, monkeypatch):
    """The command runs once for this test and for the recipe of the template."""
    monkeypatch.chdir(tmp_path)
    assert run("new", name, "--out", f"{name}.toml").exit_code == 0
    result, (command, *further) = answer(name), template(name, f"{name}.toml").commands
    assert Path(f"{name}.toml").read_text(encoding="utf-8") == result.made.text
    assert command == result.made.commands[0]
    assert result.result["valid"] is True
    assert not [note for note in result.result.get("notes", ()) if "incomplete" in note]
    if name in ("pump", "clearance"):
        for line in further:
            assert run(*shlex.split(line)[1:]).exit_code == 0, line
        assert Path(f"{name}.html").stat().st_size > 100_000


@pytest.mark.slow
def test_foot_of_the_walker_is_level_between_the_points():
    with shared_searches():
        result = optlink.solve(optlink.read(template("walker").text, "walker", "walker.toml"))
    design, points = result.best, result.definite.raw["requirement"]["points"]
    stance = [row["y"] == points[0]["y"] for row in points].index(False) - 1
    first, last = design.crank_angles[[0, stance]]
    assert last - first == pytest.approx(np.pi)  # two legs: one of them always carries
    foot = np.asarray(sweep(design.task.linkage, design.values, np.linspace(first, last, 1001)).position("P"))
    assert np.ptp(foot[:, 1]) < 0.15e-3
    assert np.all(np.diff(foot[:, 0]) > 0.0)
    assert foot[-1, 0] - foot[0, 0] == pytest.approx(0.2, abs=1e-3)
    whole = np.asarray(sweep(design.task.linkage, design.values, np.linspace(first, first + 2.0 * np.pi, 1001)).position("P"))
    assert np.min(whole[:, 1]) >= np.min(foot[:, 1]) - 1e-6  # the foot that returns stays above the ground
    assert np.max(whole[:, 1]) > np.max(foot[:, 1]) + 0.02


def test_written_file_names_itself(tmp_path):
    path = tmp_path / "my press.toml"
    done = run("new", "law", "--out", str(path))
    assert done.exit_code == 0
    assert f"Next: optlink solve '{path}'" in done.stdout
    text = path.read_text(encoding="utf-8")
    assert f"{NEXT}optlink solve '{path}'\n" in text
    assert text == optlink.new("law", path)
    assert [file.name for file in tmp_path.iterdir()] == ["my press.toml"]


def test_text_on_standard_output_is_the_template():
    done = run("new", "wiper")
    assert done.stdout == optlink.new("wiper")
    assert done.stderr == "Next: optlink new wiper --out wiper.toml\n"
    document = json.loads(run("new", "wiper", "--json").stdout)
    assert document["text"] == optlink.new("wiper")
    assert document["commands"][0] == "optlink solve wiper.toml"


def test_an_existing_file_is_kept_unless_forced(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text("mine")
    done = run("new", "law", "--out", str(path))
    assert done.exit_code == 2
    assert "add --force" in done.stderr
    assert path.read_text() == "mine"
    assert run("new", "law", "--out", str(path), "--force").exit_code == 0
    assert optlink.load(path).task == "function"


def test_list_names_every_template_with_its_command():
    for arguments in (("new",), ("new", "--list")):
        shown = run(*arguments).stdout
        assert all(name in shown for name in NAMES)
    rows = json.loads(run("new", "--list", "--json").stdout)["templates"]
    assert [row["name"] for row in rows] == NAMES
    assert all(row["commands"][0].endswith(f"{row['name']}.toml") for row in rows)
