"""What is refused is refused with the sentence of the table: key, value, what is wrong and what would do."""

from __future__ import annotations

import json
import re
from dataclasses import replace

import pytest

from tests.messages.table import command, faults, read, with_files, with_json

BASES, PROBLEMS, COMMANDS = (read(f"{name}.toml") for name in ("bases", "problems", "commands"))


def lines(says: str | list[str]) -> list[str]:
    return says if isinstance(says, list) else [says]


@pytest.mark.parametrize("title", PROBLEMS)
def test_a_problem_is_refused_with_its_sentence(title, tmp_path):
    found = faults(PROBLEMS[title], BASES, tmp_path)
    assert [str(replace(fault, file=None)) for fault in found] == lines(PROBLEMS[title]["says"])
    assert all(fault.remedy and len(str(fault)) < 700 and "\n" not in str(fault) for fault in found)
    name = PROBLEMS[title].get("problem", "")
    assert name in BASES or "files" in PROBLEMS[title] or all(fault.file.startswith(name) for fault in found if name)


@pytest.mark.parametrize("title", COMMANDS)
def test_a_command_is_refused_with_its_sentence(title, tmp_path, monkeypatch):
    """Exit code 2, nothing on standard output, nothing written; and the same as one document."""
    monkeypatch.chdir(tmp_path)
    entry = COMMANDS[title]
    with_files(entry, tmp_path)
    before = {path.name for path in tmp_path.iterdir()}
    done = command(entry["run"])
    assert (done.exit_code, done.stdout) == (2, "")
    assert isinstance(done.exception, SystemExit)
    assert done.stderr.splitlines() == [f"Error: {line}" for line in lines(entry["says"])]
    document = json.loads(command(with_json(entry["run"])).stdout)
    assert document["status"] == "error"
    assert [fault["remedy"] for fault in document["faults"] if not fault["remedy"]] == []
    assert {path.name for path in tmp_path.iterdir()} == before


ROWS, CSV = "requirement.points", {"csv": "a.csv"}
WITHOUT_END = {  # too long, or too large, for the table: problem, what is changed, content of its file, words of the sentence
    "expression of a load": (
        "six-bar",
        {"loads.process.force": {"expression": "1+" * 6000 + "1", "unit": "N"}},
        "12,001 characters",
    ),
    "expression of a law": ("crank-rocker", {"requirement.law": "1+" * 5000 + "1"}, "10,001 characters"),
    "nested law": ("crank-rocker", {"requirement.law": "(" * 1000 + "1" + ")" * 1000}, "characters"),
    "expression of points": ("path", {ROWS: {"x": "1+" * 5000 + "1", "y": "t", "unit": "mm", "t": [0, 1]}}, "characters"),
    "nested file": ("a.toml", "a = " + "[" * 5000, "TOML|nested"),
    "number in a file": ("a.toml", f"a = {'9' * 6000}", "thousands of digits. Write a number of at most 19 digits"),
    "file": ("a.toml", "# " + "x" * 1_100_000, "larger than"),
    "count": ("balance-four-bar", {"balance.positions": "9" * 5000}, "this is not a whole number"),
    "rows of a law": ("crank-rocker", {"requirement": {"law": CSV}}, "phi_deg,psi_deg\n" + "0,0\n" * 10_001, "more than 10,000"),
    "rows of a load": (
        *("six-bar", {"loads": {"process": {"on": "slider", "force": {"over": "phi", **CSV}}}}),
        *("phi_deg,force_N\n" + "0,0\n" * 10_001, "more than 10,000"),
    ),
    "rows in one place": ("path", {ROWS: CSV}, "x_mm,y_mm\n" + "3,4\n" * 1000, "all points coincide"),
    "quotation": ("path", {ROWS: CSV}, 'x_mm,y_mm\n1,"2\n' + "3,4\n" * 40_000, "not a CSV text file"),
}


@pytest.mark.parametrize("title", WITHOUT_END)
def test_what_has_no_end_is_refused_in_a_short_sentence(title, tmp_path):
    problem, *changes, words = WITHOUT_END[title]
    entry = {"problem": problem} | ({"set": changes[0]} if isinstance(changes[0], dict) else {})
    if isinstance(changes[-1], str):
        entry["files"] = {"a.toml" if problem == "a.toml" else "a.csv": changes[-1]}
    (fault,) = faults(entry, BASES, tmp_path)
    assert re.search(words, str(fault))
    assert fault.remedy
    assert len(str(fault)) < 700


@pytest.mark.parametrize("name", BASES)
def test_what_is_changed_there_is_accepted_without_the_change(name, tmp_path):
    assert faults({"problem": name}, BASES, tmp_path) == []


def test_a_wrong_sentence_is_noticed(tmp_path):
    """Planted: another value, and another key."""
    title = "six-bar: negative mass"
    entry = PROBLEMS[title]
    for change in ({"bodies.link2.mass": "-4 kg"}, {"bodies.link3.mass": "-3 kg"}):
        (fault,) = faults({**entry, "set": change}, BASES, tmp_path)
        assert str(replace(fault, file=None)) != entry["says"]
