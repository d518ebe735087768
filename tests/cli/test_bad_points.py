"""Bad points, poses, functions and transmissions at the command line: a clear message, exit code 2, nothing written."""

from __future__ import annotations

import copy
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomli_w
from click.testing import Result
from typer.testing import CliRunner

from optlink.cli.app import app
from tests.stated import SLIDER_CRANK, SPOTS, document, four_bar_section, free

Raw = dict[str, Any]

PATH = document(four_bar_section("either"), SPOTS)
POINTS: list[Raw] = PATH["requirement"]["points"]  # type: ignore[index]
MOTION = document(four_bar_section("either"), np.column_stack([SPOTS, 0.2 * np.arange(5)]))
LAW = {"function": "log10(x)", "x": [1, 2], "input": "60 deg", "output": "50 deg"}
FUNCTION: Raw = {
    "title": "f",
    "mechanism": {"type": "four-bar", "frame": "100 mm", **dict.fromkeys(("crank", "coupler", "rocker"), free(5.0, 500.0))},
    "requirement": {"kind": "function", "law": LAW},
    "limits": {"crank": "span"},
}
SLIDING: Raw = {
    "title": "s",
    "mechanism": {**SLIDER_CRANK, "ground": {"A": ["0 mm", "0 mm"]}},
    "requirement": {"kind": "function", "output": "F", "law": {**LAW, "output": "40 mm"}},
    "limits": {"crank": "span"},
}
CRANK_ALONE: Raw = {
    "type": "dyads",
    "ground": {"A": ["0 mm", "0 mm"]},
    "links": {"crank": {"joints": ["A", "B"], "length": free(5.0, 500.0)}},
}
TRANSMISSION: Raw = {
    "title": "t",
    "mechanism": FUNCTION["mechanism"],
    "requirement": {"kind": "transmission"},
    "limits": {"swing_angle": "60 deg"},
}
BASES = {"path": PATH, "motion": MOTION, "function": FUNCTION, "sliding": SLIDING, "transmission": TRANSMISSION}


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


def crank(*degrees: float) -> list[Raw]:
    return [{**point, "crank": f"{angle!r} deg"} for point, angle in zip(POINTS, degrees, strict=True)]


def drawn(**changes: object) -> Raw:
    return {"x": "20*cos(t)", "y": "10*sin(t)", "unit": "mm", "t": [0, "2*pi"], "points": 8, **changes}


ROWS = "requirement.points"
# name: (problem, what is changed, words of the message: key, value, what is wrong or what would do)
BAD: dict[str, tuple[str, dict[str, object], tuple[str, ...]]] = {
    # too few, or in one place
    "no point": ("path", {ROWS: []}, (ROWS, "no point", "Give at least one")),
    "points left out": ("path", {ROWS: None}, (ROWS,)),
    "one point": ("path", {ROWS: POINTS[:1]}, (ROWS, "1 point", "Give at least 2")),
    "one pose": ("motion", {ROWS: MOTION["requirement"]["points"][:1]}, (ROWS, "1 point", "Give at least 2")),
    "two points of a closed curve": (
        "path",
        {ROWS: POINTS[:2], "requirement.closed": True},
        ("requirement.points", "closed curve", "Give"),
    ),
    "two points coincide": ("path", {f"{ROWS}.1": POINTS[0]}, (ROWS, "points 1 and 2 coincide")),
    "all points coincide": ("path", {ROWS: [POINTS[0]] * 4}, (ROWS, "coincide")),
    "all points in one place, timed": (
        "path",
        {ROWS: [{**POINTS[0], "crank": f"{10 * k} deg"} for k in range(4)]},
        (ROWS, "all points coincide"),
    ),
    "far from the origin": (
        "path",
        {ROWS: [[f"{1e8 + i} mm", f"{i * i} mm"] for i in range(5)]},
        (ROWS, "times their own size away", "Check the units"),
    ),
    "beyond all linkages": ("path", {f"{ROWS}.1.x": "2e9 mm"}, (f"{ROWS}[1].x", "2e+09 mm", "check its unit")),
    # numbers and units
    "not a number": ("path", {f"{ROWS}.2.x": "nan mm"}, (f"{ROWS}[2].x", "nan mm", "finite")),
    "infinite": ("path", {f"{ROWS}.2.y": "inf mm"}, (f"{ROWS}[2].y", "inf mm")),
    "a bare nan": ("path", {f"{ROWS}.0": [math.nan, "1 mm"]}, (f"{ROWS}[0].x", "nan")),
    "a bare number": ("path", {f"{ROWS}.0": [1.0, 2.0]}, (f"{ROWS}[0].x", "1.0", "unit")),
    "an angle for a length": ("path", {f"{ROWS}.3.x": "20 deg"}, (f"{ROWS}[3].x", "20 deg", '"deg" is not a unit')),
    "a length for a crank angle": (
        "path",
        {ROWS: [{**point, "crank": "3 mm"} for point in POINTS]},
        (f"{ROWS}[0].crank", "3 mm", "not a unit of angle"),
    ),
    "a length for the angle of a pose": ("motion", {f"{ROWS}.1.angle": "3 mm"}, (f"{ROWS}[1].angle", "3 mm", "angle")),
    "a pose at no angle": ("motion", {f"{ROWS}.1.angle": "nan deg"}, (f"{ROWS}[1].angle", "nan deg")),
    "a length for the mark": ("motion", {"requirement.mark": "3 mm"}, ("requirement.mark", "3 mm", "angle")),
    "an angle as its length": ("motion", {"requirement.angle_length": "30 deg"}, ("requirement.angle_length", "30 deg")),
    "a radian that counts as nothing": ("motion", {"requirement.angle_length": "0 mm"}, ("requirement.angle_length", "0 mm")),
    "negative weight": ("path", {f"{ROWS}.1.weight": -1.0}, (f"{ROWS}[1].weight", "-1", "above zero")),
    "no weight": ("path", {f"{ROWS}.1.weight": 0.0}, (f"{ROWS}[1].weight", "0", "above zero")),
    "no tolerance": ("path", {f"{ROWS}.4.tolerance": "0 mm"}, (f"{ROWS}[4].tolerance", "0 mm", "positive")),
    "bounds the wrong way round": (
        "path",
        {"mechanism.crank": {"bounds": ["90 mm", "10 mm"]}},
        ("mechanism.crank", "90 mm", "10 mm"),
    ),
    "bounds of an angle": ("path", {"mechanism.crank": {"bounds": ["1 deg", "9 deg"]}}, ("mechanism.crank", "deg")),
    "nothing free": (
        "path",
        {
            "mechanism": {
                **{"type": "four-bar", "crank": "20 mm", "coupler": "60 mm", "rocker": "50 mm", "frame": "70 mm"},
                "points": {"P": ["20 mm", "10 mm"]},
            }
        },
        ("mechanism", "no design variables", "bounds"),
    ),
    # timing
    "crank angles in no order": ("path", {ROWS: crank(0, 40, 30, 60, 80)}, (ROWS, "crank", "30")),
    "equal crank angles": ("path", {ROWS: crank(0, 40, 40, 60, 80)}, (ROWS, "crank", "40")),
    "crank angles of two turns": ("path", {ROWS: crank(0, 40, 130, 260, 480)}, (ROWS, "crank")),
    "a crank angle of some": ("path", {f"{ROWS}.0.crank": "0 deg"}, (f"{ROWS}[1].crank", "point 2 has no crank")),
    "from start without crank angles": (
        "path",
        {"requirement.timing": "from start"},
        ("requirement.timing", "from start", "no crank angles", "free"),
    ),
    "given without crank angles": (
        "path",
        {"requirement.timing": "given"},
        ("requirement.timing", "given", "no crank angles", "free"),
    ),
    "unknown timing": ("path", {"requirement.timing": "fre"}, ("requirement.timing", "fre", '"free"')),
    "a rotation against the crank angles": (
        "path",
        {ROWS: crank(0, 40, 130, 260, 300), "requirement.rotation": "clockwise"},
        ("requirement.rotation", "clockwise", 'timing = "free"'),
    ),
    "unknown rotation": ("path", {"requirement.rotation": "left"}, ("requirement.rotation", "left", "clockwise")),
    "a start of free points": ("path", {"requirement.start": "20 deg"}, ("requirement.start", "20", "from start")),
    # names
    "unknown point": ("path", {"requirement.point": "Q"}, ("requirement.point", "Q", "P")),
    "a point of the frame": ("path", {"requirement.point": "A"}, ("requirement.point", "A", "moving")),
    "unknown kind": ("path", {"requirement.kind": "pth"}, ("requirement.kind", "pth", "path")),
    "unknown measure": ("path", {"requirement.measure": "mean"}, ("requirement.measure", "mean", "rms")),
    "unknown key": ("path", {"requirement.pionts": 1}, ("requirement.pionts", "points")),
    "unknown key of a point": ("path", {f"{ROWS}.0.wieght": 1.0}, (f"{ROWS}[0].wieght", "weight")),
    "poses without angles": ("path", {"requirement.kind": "motion"}, (ROWS, "angles are missing", "angle =")),
    "a path with angles": ("motion", {"requirement.kind": "path"}, (ROWS, "a path has no angles", "motion")),
    "a law of a path": ("path", {"requirement.law": LAW}, ("requirement.law", 'kind = "function"')),
    "a mark of a path": ("path", {"requirement.mark": "3 deg"}, ("requirement.mark", 'kind = "motion"')),
    # limits
    "unknown limit": ("path", {"limits.transmision_angle": ["30 deg", "150 deg"]}, ("transmision_angle", '"transmission_angle"')),
    "limits out of range": ("path", {"limits.transmission_angle": ["-30 deg", "190 deg"]}, ("limits.transmission_angle", "-30")),
    "limits the wrong way round": (
        "path",
        {"limits.transmission_angle": ["150 deg", "30 deg"]},
        ("limits.transmission_angle", "150 deg", "30 deg"),
    ),
    "limits in another unit": ("path", {"limits.transmission_angle": ["30 mm", "150 mm"]}, ("limits.transmission_angle", "mm")),
    "a region the wrong way round": ("path", {"limits.pivots.x": ["9 mm", "1 mm"]}, ("limits.pivots.x", "9 mm", "1 mm")),
    "unknown crank": ("path", {"limits.crank": "spam"}, ("limits.crank", "spam", "span")),
    "a negative ratio": ("path", {"limits.link_ratio": [-1.0, 2.0]}, ("limits.link_ratio", "-1")),
    "a whole revolution of a span": (
        "path",
        {"limits.crank": "span", "limits.transmission_over": "revolution"},
        ("limits.transmission_over", "revolution", "full rotation"),
    ),
    # expressions and drawings
    "an import": ("path", {ROWS: drawn(x="__import__('os').getcwd()")}, (f"{ROWS}.x", "__import__")),
    "an attribute": ("path", {ROWS: drawn(x="t.__class__")}, (f"{ROWS}.x", "t.__class__")),
    "an unknown name": ("path", {ROWS: drawn(y="tt*2")}, (f"{ROWS}.y", "tt")),
    "a call of a file": ("path", {ROWS: drawn(y="open('problem.toml')")}, (f"{ROWS}.y", "open")),
    "a syntax error": ("path", {ROWS: drawn(y="2*(t")}, (f"{ROWS}.y", "2*(t")),
    "nan somewhere": ("path", {ROWS: drawn(x="sqrt(t - 1)")}, (f"{ROWS}.x", "sqrt(t - 1)")),
    "a pole somewhere": ("path", {ROWS: drawn(x="1/(t - 1)")}, (f"{ROWS}.x", "1/(t - 1)")),
    "no unit of expressions": ("path", {ROWS: {"x": "t", "y": "t^2", "t": [0, 1]}}, (ROWS, "unit")),
    "an angle as unit of expressions": ("path", {ROWS: drawn(unit="deg")}, (f"{ROWS}.unit", "deg")),
    "an empty range of t": ("path", {ROWS: drawn(t=[1, 1])}, (f"{ROWS}.t[1] = 1", "starts where it ends")),
    "too many sampled points": ("path", {ROWS: drawn(points=100_000)}, (f"{ROWS}.points", "100000", "400")),
    "a missing file": ("path", {ROWS: {"csv": "nowhere.csv"}}, (f"{ROWS}.csv", "nowhere.csv", "no such file")),
    "a missing drawing": ("path", {ROWS: {"svg": "nowhere.svg"}}, (f"{ROWS}.svg", "nowhere.svg", "no such file")),
    # functions
    "no function": ("function", {"requirement.law": None}, ("requirement.law", "missing", "Add law =")),
    "an import as function": (
        "function",
        {"requirement.law.function": "__import__('os').getcwd()"},
        ("requirement.law.function", "__import__"),
    ),
    "an attribute as function": ("function", {"requirement.law.function": "x.real"}, ("requirement.law.function", "x.real")),
    "nan in the range": ("function", {"requirement.law.x": [-1, 2]}, ("requirement.law.function", "log10(x)", "range")),
    "a pole in the range": (
        "function",
        {"requirement.law": {**LAW, "function": "1/(x - 1.5)"}},
        ("requirement.law.function", "1/(x - 1.5)"),
    ),
    "a constant": ("function", {"requirement.law.function": "3"}, ("requirement.law.function", "constant")),
    "a range that falls": ("function", {"requirement.law.x": [2, 1]}, ("requirement.law.x", "[2, 1]")),
    "an endless range": ("function", {"requirement.law.x": [1, math.inf]}, ("requirement.law.x", "inf")),
    "a crank that stands": ("function", {"requirement.law.input": "0 deg"}, ("requirement.law.input", "0 deg")),
    "a crank of two turns": ("function", {"requirement.law.input": "720 deg"}, ("requirement.law.input", "720 deg")),
    "a crank turned by a length": ("function", {"requirement.law.input": "60 mm"}, ("requirement.law.input", "60 mm")),
    "an output that stands": ("function", {"requirement.law.output": "0 deg"}, ("requirement.law.output", "0 deg")),
    "a rocker that slides": ("function", {"requirement.law.output": "40 mm"}, ("requirement.law.output", "40 mm")),
    "points of a function": ("function", {"requirement.points": 0}, ("requirement.points", "0")),
    "unknown measure of a function": ("function", {"requirement.measure": "mean"}, ("requirement.measure", "mean", "rms")),
    "nothing free for a function": (
        "function",
        {"mechanism": {"type": "four-bar", "frame": "9 mm", "crank": "3 mm", "coupler": "8 mm", "rocker": "7 mm"}}
        | {"requirement.from": "40 deg", "requirement.psi0": "60 deg"},
        ("mechanism", "no design variables"),
    ),
    "no output": ("sliding", {"requirement.output": None}, ("requirement.output", "F")),
    "an output of no name": ("sliding", {"requirement.output": "H"}, ("requirement.output", "H", "F")),
    "a slider that turns": ("sliding", {"requirement.law.output": "40 deg"}, ("requirement.output", "F")),
    "points listed for a function": ("sliding", {ROWS: POINTS}, (ROWS, "whole number")),
    "timing of a function": ("sliding", {"requirement.timing": "free"}, ("requirement.timing", 'kind = "path"')),
    # transmission
    "points of a transmission": ("transmission", {ROWS: POINTS}, (ROWS, "Leave")),
    "a span of a transmission": ("transmission", {"limits.crank": "span"}, ("limits.crank", "span", "full rotation")),
    "a swing out of range": ("transmission", {"limits.swing_angle": "200 deg"}, ("limits.swing_angle", "200")),
    "a time ratio below one": ("transmission", {"limits.time_ratio": 0.5}, ("limits.time_ratio", "0.5")),
    "a transmission without one": (
        "transmission",
        {"mechanism": CRANK_ALONE, "limits.swing_angle": None},
        ("requirement.kind", "transmission angle"),
    ),
    "a pressure angle of no dyad": (
        "transmission",
        {"mechanism": SLIDER_CRANK, "limits.swing_angle": None, "limits.pressure_angle": {"F": "30 deg"}},
        ("limits.pressure_angle.F", "Known: E, min, max"),
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_is_refused(tmp_path: Path, name: str) -> None:
    base, changes, words = BAD[name]
    refused(tmp_path, altered(BASES[base], changes), *words)


@pytest.mark.parametrize("base", BASES)
def test_valid_points_are_accepted(tmp_path: Path, base: str) -> None:
    done = run("show", written(BASES[base], tmp_path), "--json")
    assert done.exit_code == 0, done.stderr


BAD_TABLES: dict[str, tuple[str | bytes, tuple[str, ...]]] = {
    "a word": ("x_mm,y_mm\n1,2\n3,abc\n4,5\n", ("row 3", "abc", "y_mm")),
    "a word after empty rows": ("x_mm,y_mm\n\n1,2\n\n3,abc\n", ("row 5", "abc")),
    "no number": ("x_mm,y_mm\n1,2\nnan,3\n4,4\n", ("row 3", "nan", "x_mm")),
    "infinite": ("x_mm,y_mm\n1,2\n2,3\n4,inf\n", ("row 4", "inf", "y_mm")),
    "a missing cell": ("x_mm,y_mm\n1,2\n2\n4,3\n", ("row 3", "y_mm")),
    "a cell too many": ("x_mm,y_mm\n1,2\n2,5,3\n4,3\n", ("row 3", "3 cells")),
    "decimal commas": ("x_mm;y_mm\n1,5;2,5\n2,5;3,5\n", ("row 2", "point")),
    "coincident rows": ("x_mm,y_mm\n1,2\n2,5\n2,5\n4,3\n", ("rows 3 and 4", "coincide")),
    "a negative weight": ("x_mm,y_mm,weight\n1,2,1\n2,5,-1\n4,3,1\n", ("row 3", "-1")),
    "crank angles in no order": ("x_mm,y_mm,crank_deg\n1,2,0\n2,5,40\n4,3,30\n", ("crank", "row", "4")),
    "unknown columns": ("a,b\n1,2\n", ("x_mm",)),
    "no unit in the title": ("x,y\n1,2\n3,4\n", ("x_mm",)),
    "a unit of angle": ("x_deg,y_deg\n1,2\n3,4\n", ("x_mm",)),
    "no titles": ("1,2\n3,4\n", ("x_mm",)),
    "only titles": ("x_mm,y_mm\n", ("no rows", "x_mm")),
    "empty": ("", ("no rows",)),
    "no text": (b"\x00\x01\x02\xff\xfe", ("CSV",)),
    "one row": ("x_mm,y_mm\n1,2\n", ("1 point", "at least 2")),
}


@pytest.mark.parametrize("name", BAD_TABLES)
def test_bad_table_is_refused(tmp_path: Path, name: str) -> None:
    content, words = BAD_TABLES[name]
    (tmp_path / "curve.csv").write_bytes(content if isinstance(content, bytes) else content.encode())
    refused(tmp_path, altered(PATH, {ROWS: {"csv": "curve.csv"}}), ROWS, *words)


BAD_DRAWINGS: dict[str, tuple[str, tuple[str, ...]]] = {
    "no path": ('<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 9 9"><text>curve</text></svg>', ("path",)),
    "broken": ('<svg xmlns="http://www.w3.org/2000/svg"><path d="M 0 0', ("curve.svg",)),
    "no drawing": ("x_mm,y_mm\n1,2\n", ("curve.svg",)),
    "empty": ("", ("curve.svg",)),
    "a path of one point": ('<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 9 9"><path d="M 1 1"/></svg>', ("length",)),
    "an entity": (
        '<!DOCTYPE svg [<!ENTITY a SYSTEM "problem.toml">]><svg xmlns="http://www.w3.org/2000/svg"><text>&a;</text></svg>',
        ("curve.svg",),
    ),
}


@pytest.mark.parametrize("name", BAD_DRAWINGS)
def test_bad_drawing_is_refused(tmp_path: Path, name: str) -> None:
    content, words = BAD_DRAWINGS[name]
    (tmp_path / "curve.svg").write_text(content, encoding="utf-8")
    refused(tmp_path, altered(PATH, {ROWS: {"svg": "curve.svg", "unit": "mm"}}), ROWS, *words)


OPTIONS = [
    "seed -1",
    "seed 1.5",
    "starts 0",
    "starts 9999999",
    "designs 0",
    "designs 51",
    "designs x",
    "backend foo",
]


@pytest.mark.parametrize("option", OPTIONS)
def test_bad_options_are_reported(tmp_path: Path, option: str) -> None:
    name, value = option.split()
    done = run("solve", written(PATH, tmp_path), f"--{name}", value)
    assert done.exit_code == 2
    assert isinstance(done.exception, SystemExit)
    assert done.stdout == ""
    assert name in done.stderr
    assert value in done.stderr


def test_bad_option_makes_no_folder(tmp_path: Path) -> None:
    assert run("solve", written(PATH, tmp_path), "--out", str(tmp_path / "results"), "--designs", "0").exit_code == 2
    assert not (tmp_path / "results").exists()


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


def test_a_file_of_fifty_megabytes_is_refused(tmp_path: Path) -> None:
    with (tmp_path / "curve.csv").open("wb") as file:
        file.truncate(50_000_001)
    refused(tmp_path, altered(PATH, {ROWS: {"csv": "curve.csv"}}), f"{ROWS}.csv", "larger than 50 MB", "Reduce its size")


def test_expressions_are_not_executed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for text in ("__import__('pathlib').Path('made').touch()", 'exec(\'open("made", "w")\')', "().__class__.__base__"):
        refused(tmp_path, altered(PATH, {ROWS: drawn(x=text)}), f"{ROWS}.x")
        refused(tmp_path, altered(FUNCTION, {"requirement.law.function": text}), "requirement.law.function")
    assert {path.name for path in tmp_path.iterdir()} == {"problem.toml"}


def test_a_folder_that_is_a_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)  # a long path would be shortened in the message
    (tmp_path / "results").write_text("kept", encoding="utf-8")
    done = run("solve", written(PATH, tmp_path), "--out", "results")
    assert done.exit_code == 2
    assert isinstance(done.exception, SystemExit)
    assert "results" in done.stderr
    assert (tmp_path / "results").read_text(encoding="utf-8") == "kept"


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
BAD_DESIGNS: dict[str, tuple[dict[str, str | None], tuple[str, ...]]] = {
    "a quantity left out": ({"coupler": None}, ("--design", "lacks coupler", "--design coupler=")),
    "unknown quantity": ({"cuopler": "3 mm"}, ("--design", "cuopler", '"coupler"')),
    "a wrong unit": ({"crank": "10 deg"}, ("--design crank", "10 deg", "length")),
    "no unit": ({"crank": "10"}, ("--design crank", "10", "unit")),
    "no number": ({"crank": "nan mm"}, ("--design crank", "nan mm")),
    "infinite": ({"A.x": "inf mm"}, ("--design A.x", "inf mm")),
    "negative": ({"crank": "-3 mm"}, ("--design crank", "-3 mm")),
    "a quantity that is nothing": ({"crank": ""}, ("--design", "crank=")),
    "a quantity that is free": ({"crank": '{ bounds = ["1 mm", "2 mm"] }'}, ("--design crank",)),
}


def proven(file: str, given: dict[str, str | None], *more: str) -> Result:
    texts = [part for name, value in given.items() if value is not None for part in ("--design", f"{name}={value}")]
    return run("validate", file, *texts, *more)


def test_a_given_design_is_validated(tmp_path: Path) -> None:
    done = proven(written(PATH, tmp_path), GIVEN, "--json")
    assert done.exit_code in (0, 1), done.stderr
    assert json.loads(done.stdout)["status"] == "not searched"


@pytest.mark.parametrize("name", BAD_DESIGNS)
def test_bad_given_design_is_refused(tmp_path: Path, name: str) -> None:
    changes, words = BAD_DESIGNS[name]
    done = proven(written(PATH, tmp_path), {**GIVEN, **changes}, "--out", str(tmp_path / "results"))
    assert done.exit_code == 2, (done.exit_code, done.exception, done.stdout[:300])
    assert isinstance(done.exception, SystemExit)
    assert done.stdout == ""
    assert all(word in done.stderr for word in words), done.stderr
    assert not (tmp_path / "results").exists()


@pytest.mark.parametrize("content", [None, "", "{", "[]", '{"design": {}}', '{"design": {"crank_mm": "ten"}}'])
def test_bad_result_file_is_refused(tmp_path: Path, content: str | None) -> None:
    path = tmp_path / "result.json"
    if content is not None:
        path.write_text(content, encoding="utf-8")
    done = run("validate", written(PATH, tmp_path), "--design", str(path))
    assert done.exit_code == 2
    assert isinstance(done.exception, SystemExit)
    assert "--design" in done.stderr


@pytest.mark.parametrize("base", ["path", "motion"])
def test_a_given_linkage_that_cannot_be_assembled_fails(tmp_path: Path, base: str) -> None:
    done = proven(written(BASES[base], tmp_path), {**GIVEN, "frame": "300 mm", **({"mark": "0 deg"} if base == "motion" else {})})
    assert done.exit_code == 1, (done.exit_code, done.exception, done.stderr)
    assert isinstance(done.exception, SystemExit)
    assert "FAIL" in done.stdout
