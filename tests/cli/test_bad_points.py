"""Points, functions and given designs at the command line that are refused, or not valid: nothing is written."""

from __future__ import annotations

import copy
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomli_w
from typer.testing import CliRunner, Result

from optlink.cli.app import app
from tests.stated import SPOTS, document, four_bar_section, free

Raw = dict[str, Any]

PATH = document(four_bar_section("either"), SPOTS)
MOTION = document(four_bar_section("either"), np.column_stack([SPOTS, 0.2 * np.arange(5)]))
LAW = {"function": "log10(x)", "x": [1, 2], "input": "60 deg", "output": "50 deg"}
FUNCTION: Raw = {
    "title": "f",
    "mechanism": {"type": "four-bar", "frame": "100 mm", **dict.fromkeys(("crank", "coupler", "rocker"), free(5.0, 500.0))},
    "requirement": {"kind": "function", "law": LAW},
    "limits": {"crank": "span"},
}
BASES = {"path": PATH, "motion": MOTION}


def altered(base: Raw, changes: dict[str, object]) -> Raw:
    """A problem with dotted keys set, or removed by None."""
    raw = copy.deepcopy(base)
    for key, value in changes.items():
        *parents, last = key.split(".")
        section: Any = raw
        for name in parents:
            section = section[int(name)] if isinstance(section, list) else section.setdefault(name, {})
        if value is None:
            del section[last]
        elif isinstance(section, list):
            section[int(last)] = value
        else:
            section[last] = value
    return raw


def run(*arguments: str) -> Result:
    return CliRunner().invoke(app, list(arguments))


def written(raw: Raw, folder: Path) -> str:
    path = folder / "problem.toml"
    path.write_text(tomli_w.dumps(raw), encoding="utf-8")
    return str(path)


def refused(folder: Path, raw: Raw, *words: str) -> None:
    """Exit code 2 with one message per fault that names the file and all the words; JSON on demand; no folder is made."""
    file, out, options = written(raw, folder), folder / "results", ("--starts", "8")  # few, should it not be refused
    done = run("solve", file, "--out", str(out), *options)
    assert done.exit_code == 2, (done.exit_code, done.exception, done.stdout[:500], done.stderr[:500])
    assert isinstance(done.exception, SystemExit)
    assert done.stdout == ""
    lines = done.stderr.splitlines()
    assert all(line.startswith("Error: ") for line in lines), done.stderr
    named = [line for line in lines if all(word in line for word in (file, *words))]
    assert named, done.stderr
    assert all(line.rstrip().rpartition(". ")[2] for line in named)  # the fault, then the remedy
    assert all(len(line) < 700 for line in lines)
    assert not out.exists()
    document = json.loads(run("solve", file, "--out", str(out), "--json", *options).stdout)
    assert document["status"] == "error"
    assert all(fault["remedy"] for fault in document["faults"])
    assert not out.exists()


def drawn(**changes: object) -> Raw:
    return {"x": "20*cos(t)", "y": "10*sin(t)", "unit": "mm", "t": [0, "2*pi"], "points": 8, **changes}


ROWS = "requirement.points"


def dense(count: int) -> np.ndarray:
    """Points of a bean, in mm."""
    t = 2.0 * math.pi * np.arange(count) / count
    return np.column_stack([30.0 + 20.0 * np.cos(t), 10.0 * np.sin(t) + 5.0 * np.sin(2.0 * t)])


@pytest.mark.slow
def test_a_hundred_thousand_rows_are_reduced_with_a_note(tmp_path: Path) -> None:
    np.savetxt(tmp_path / "curve.csv", dense(100_000), "%.9f", ",", header="x_mm,y_mm", comments="")
    file = written(altered(PATH, {ROWS: {"csv": "curve.csv", "points": 30}}), tmp_path)
    done = run("solve", file, "--starts", "6", "--designs", "1", "--json")
    assert done.exit_code in (0, 1), done.stderr
    result = json.loads(done.stdout)
    assert any("100,000" in note and "30" in note for note in result["notes"])
    shown = run("solve", file, "--starts", "6", "--designs", "1")
    assert "100,000 points of curve.csv were reduced to 30" in " ".join(shown.stdout.split())


@pytest.mark.slow
def test_a_hundred_thousand_listed_points_are_beyond_a_limit(tmp_path: Path) -> None:
    rows = [[f"{x:.9f} mm", f"{y:.9f} mm"] for x, y in dense(100_000).tolist()]
    refused(tmp_path, altered(PATH, {ROWS: rows}), "larger than 1,000,000 bytes", "CSV")


def test_expressions_are_not_executed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for text in ("__import__('pathlib').Path('made').touch()", 'exec(\'open("made", "w")\')', "().__class__.__base__"):
        refused(tmp_path, altered(PATH, {ROWS: drawn(x=text)}), f"{ROWS}.x")
        refused(tmp_path, altered(FUNCTION, {"requirement.law.function": text}), "requirement.law.function")
    assert {path.name for path in tmp_path.iterdir()} == {"problem.toml"}


@pytest.mark.slow
def test_an_infeasible_problem_gives_a_result(tmp_path: Path) -> None:
    """Nothing within the limits: exit code 1, why, and a result.json."""
    narrow = {"limits": {"link_ratio": [0.9, 1.0], "transmission_angle": ["85 deg", "95 deg"]}}
    done = run("solve", written(altered(PATH, narrow), tmp_path), "--starts", "60", "--out", str(tmp_path / "out"), "--json")
    assert done.exit_code == 1, done.stderr
    result = json.loads(done.stdout)
    assert result["valid"] is False
    assert result["designs"] == []
    assert json.loads((tmp_path / "out" / "result.json").read_text(encoding="utf-8")) == result


# --- given designs -----------------------------------------------------------------------------------------------------------

GIVEN: Raw = {
    **{"crank": "10 mm", "coupler": "30 mm", "rocker": "25 mm", "frame": "35 mm", "P.along": "10 mm", "P.across": "8 mm"},
    **{"A.x": "20 mm", "A.y": "20 mm", "direction": "0 deg"},
}


def proven(file: str, given: dict[str, str | None], *more: str) -> Result:
    texts = [part for name, value in given.items() if value is not None for part in ("--design", f"{name}={value}")]
    return run("validate", file, *texts, *more)


@pytest.mark.parametrize("base", ["path", "motion"])
def test_a_given_linkage_that_cannot_be_assembled_fails(tmp_path: Path, base: str) -> None:
    done = proven(written(BASES[base], tmp_path), {**GIVEN, "frame": "300 mm", **({"mark": "0 deg"} if base == "motion" else {})})
    assert done.exit_code == 1, (done.exit_code, done.exception, done.stderr)
    assert isinstance(done.exception, SystemExit)
    assert "FAIL" in done.stdout
