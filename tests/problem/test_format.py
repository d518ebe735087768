"""The format of problem files: stated first in everything that is written, without effect on results, refused if it is later."""

from __future__ import annotations

import json
import tomllib

import pytest
from typer.testing import CliRunner

import optlink
from optlink.cli.app import app
from optlink.problem.document import VERSION_OF_SCHEMAS, stored_problem
from optlink.problem.file import dump
from optlink.problem.machine.model import FORMAT
from optlink.problem.templates import templates
from optlink.problem.toml_text import rewritten
from optlink.studio.document import from_text

OLD = optlink.new("law").replace(f"format = {FORMAT}\n", "")
"""A file from before there was a format."""


@pytest.mark.parametrize("path", [*optlink.shipped().values(), *templates().values()], ids=lambda path: path.stem)
def test_every_file_begins_with_its_format(path):
    assert next(iter(tomllib.loads(path.read_text(encoding="utf-8")).items())) == ("format", FORMAT)


def test_what_is_written_begins_with_the_format(tmp_path):
    assert "format" not in OLD
    file = tmp_path / "old.toml"
    file.write_text(OLD, encoding="utf-8")
    problem = optlink.load(file)
    shown = CliRunner().invoke(app, ["show", str(file), "--toml"]).stdout
    changed = problem.override({"mechanism.frame": "480 mm"})
    edited = rewritten(OLD, problem.raw, changed.raw)
    studio = from_text(OLD, "old").with_changes({"mechanism.frame": "480 mm"}).text
    for text in (dump(problem), stored_problem(problem)["toml"], shown, edited, studio, dump(changed)):
        assert next(iter(tomllib.loads(text).items())) == ("format", FORMAT)
    assert edited.count("#") == OLD.count("#")  # all comments
    assert edited == f"format = {FORMAT}\n{OLD}".replace('frame = "300 mm"', 'frame = "480 mm"')


def test_the_format_does_not_change_what_a_problem_is():
    assert optlink.read(OLD).hash == optlink.read(optlink.new("law")).hash
    assert optlink.load("crank-rocker").hash == "1b8006b71cb50e4f"  # stored results and unfinished studies depend on it
    assert optlink.load("crank-rocker", {"format": 1}).raw["expected"]  # no change of the result


def test_a_later_format_is_one_error(tmp_path):
    """Whatever else this version does not know in the file."""
    file = tmp_path / "later.toml"
    file.write_text(f"format = {FORMAT + 1}\nnovel = 3\n[mechanism]\nkind = 'robot'\n", encoding="utf-8")
    for command in ("show", "solve", "analyze", "simulate", "balance", "validate"):
        done = CliRunner().invoke(app, [command, str(file), "--json"])
        fault = json.loads(done.stdout)["faults"]
        assert done.exit_code == 2
        assert len(fault) == 1
        assert (fault[0]["file"], fault[0]["key"], fault[0]["value"]) == (str(file), "format", str(FORMAT + 1))
        assert fault[0]["remedy"] == "Update optlink"


@pytest.mark.parametrize(
    ("number", "remedy"), [(VERSION_OF_SCHEMAS + 1, "Update optlink"), (VERSION_OF_SCHEMAS - 1, "Run `solve` again")]
)
def test_a_result_of_another_format_is_one_error(tmp_path, number, remedy):
    result = optlink.validate(optlink.load("crank-rocker"), {"coupler": 0.412, "rocker": 0.232})
    file = tmp_path / "result.json"
    file.write_text(json.dumps(result.to_dict() | {"schema": f"optlink/design/{number}", "novel": 3}))
    with pytest.raises(optlink.InputError, match=remedy) as refused:
        optlink.read_result(file)
    assert [(fault.file, fault.key, fault.value) for fault in refused.value.faults] == [
        (str(file), "schema", f"optlink/design/{number}")
    ]
    assert CliRunner().invoke(app, ["report", str(file), "-o", str(tmp_path / "a.html")]).exit_code == 2
