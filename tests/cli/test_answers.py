"""Output of the command line where it could mislead, tested by exit codes, JSON and text only, without names of the package."""

from __future__ import annotations

import json
import math
import os
import re
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from optlink.cli.app import app
from tests.chunks import complete
from tests.tiers import mostly_slow

SPAN = """
title = "A law over a span, with no limit on the transmission"
[mechanism]
crank = "45 mm"
coupler = "64 mm"
rocker = "118 mm"
frame = { bounds = ["110 mm", "240 mm"] }
[requirement]
law = "psi0 - 0.4*(phi - phi0)"
from = { bounds = ["-120 deg", "10 deg"] }
psi0 = "-60 deg"
span = "-30 deg"
points = 12
measure = "max"
[limits]
crank = "span"
"""

PRESS = """
title = "Press with an offset guide"
[mechanism.ground]
A = ["0 mm", "0 mm"]
[mechanism.links]
crank = { joints = ["A", "B"], length = "52 mm" }
rod = { joints = ["B", "C"], length = "170 mm" }
ram = { joints = ["C"] }
[mechanism.guides]
G = { slider = "ram", direction = "0 deg", through = "A", offset = "41 mm" }
[mechanism.assembly]
C = "forward"
[loads]
pressing = { on = "ram", force = "1 kN", acts = "opposing", stroke = "STROKE" }
[drive]
speed = "60 rpm"
"""

FUNCTION = """
title = "Square root over 80 deg"
[mechanism]
type = "four-bar"
frame = "100 mm"
crank = { bounds = ["1 mm", "5000 mm"] }
coupler = { bounds = ["1 mm", "5000 mm"] }
rocker = { bounds = ["1 mm", "5000 mm"] }
assembly = "either"
[requirement]
kind = "function"
law = { function = "sqrt(x)", x = [1, 3], input = "80 deg", output = "60 deg" }
measure = "max"
[limits]
crank = "span"
transmission_angle = ["30 deg", "150 deg"]
link_ratio = [0.1, 10.0]
"""

PATH = """
title = "Corners of a zigzag, the crank pivot where it is by default"
[mechanism]
type = "four-bar"
crank = { bounds = ["10 mm", "300 mm"] }
coupler = { bounds = ["10 mm", "300 mm"] }
rocker = { bounds = ["10 mm", "300 mm"] }
frame = { bounds = ["10 mm", "300 mm"] }
points = { P = [{ bounds = ["-300 mm", "300 mm"] }, { bounds = ["-300 mm", "300 mm"] }] }
assembly = "left"
[requirement]
kind = "path"
[requirement.points]
x = "180 + 45*cos(2.4*t)"
y = "120 + 45*sin(2.4*t)"
unit = "mm"
t = [0, 6]
points = 7
[limits]
transmission_angle = ["40 deg", "140 deg"]
"""


def run(*arguments: object) -> Any:
    return CliRunner().invoke(app, list(map(str, arguments)))


def answer(*arguments: object) -> dict[str, Any]:
    return json.loads(run(*arguments, "--json").stdout)


@pytest.fixture
def file(tmp_path: Path) -> Any:
    def write(text: str) -> Path:
        path = tmp_path / "problem.toml"
        path.write_text(text)
        return path

    return write


def alignment(design: dict[str, float], span: float) -> float:
    """Least angle [deg] between coupler and rocker, or their extensions, over a span [rad], by the law of cosines."""
    r, a, b, f = (design[f"{name}_mm"] for name in ("crank", "coupler", "rocker", "frame"))
    phi = math.radians(design["phi0_deg"]) + span * np.linspace(0.0, 1.0, 20001)
    cosine = (a * a + b * b - r * r - f * f + 2.0 * r * f * np.cos(phi)) / (2.0 * a * b)
    return math.degrees(math.acos(np.max(np.abs(cosine))))


@pytest.mark.slow
def test_a_valid_law_ends_at_a_stated_angle_from_alignment(file: Any) -> None:
    path = file(SPAN)
    computed = answer("solve", path)
    assert computed["valid"]
    assert alignment(computed["design"], math.radians(-30.0)) == pytest.approx(1.0, abs=1e-4)  # deg, the default limit


@pytest.mark.slow
def test_an_active_alignment_limit_is_shown(file: Any) -> None:
    path = file(SPAN)
    (line,) = (line for line in run("show", path).stdout.splitlines() if line.startswith("alignment"))
    assert "1 deg" in line
    assert "limits.alignment" in {limit["key"] for limit in answer("solve", path)["limits"] if limit["active"]}


def test_a_load_in_the_quick_stroke_is_noted(file: Any) -> None:
    notes = {
        stroke: [note for note in answer("analyze", file(PRESS.replace("STROKE", stroke)))["notes"] if "quick" in note]
        for stroke in ("forward", "backward")
    }
    assert sorted(map(len, notes.values())) == [0, 1]


@pytest.mark.slow
def test_a_function_result_has_its_assembly_mode_and_machine(file: Any, tmp_path: Path) -> None:
    result = answer("solve", file(FUNCTION), "--starts", 1, "--out", tmp_path / "out")
    assert result["valid"]
    assert result.get("assembly") in ("left", "right")
    assert run("validate", tmp_path / "problem.toml", "--design", tmp_path / "out" / "result.json").exit_code == 0
    assert run("analyze", tmp_path / "out" / "design.toml").exit_code in (0, 1)  # 1: the crank of a function need not turn fully


@pytest.mark.slow
def test_the_best_distinct_optimum_is_the_reported_objective(file: Any) -> None:
    computed = answer("solve", file(FUNCTION), "--starts", 8)
    assert computed["optima"][0]["objective"] == computed["objective"]["value"]


@pytest.mark.slow
def test_an_explicit_number_of_starts_is_no_worse_than_the_default(file: Any) -> None:
    text = FUNCTION.replace('"sqrt(x)", x = [1, 3], input = "80 deg"', '"tan(x)", x = [0, 0.7], input = "70 deg"')
    path = file(text.replace('"either"', '"right"'))
    default, stated = (answer("solve", path, *more) for more in ((), ("--starts", 8)))
    assert default["valid"]
    assert stated["valid"]
    assert stated["objective"]["value"] == pytest.approx(default["objective"]["value"], rel=1e-6)


@pytest.mark.slow
def test_a_poor_fit_is_marked_and_its_start_counts_as_a_hit(file: Any) -> None:
    path = file(PATH)
    done = run("solve", path, "--starts", 60, "--designs", 1)
    assert "poor fit" in done.stdout
    assert "0 of 60 starts" not in done.stdout  # the start of the answer itself reaches its value
    assert "fixed: 0 mm, 0 mm" in next(line for line in run("show", path).stdout.splitlines() if line.startswith("pivot"))


@pytest.mark.slow
def test_an_infeasible_path_lists_the_conflicting_limits(file: Any) -> None:
    narrow = PATH.replace('crank = { bounds = ["10 mm", "300 mm"] }', 'crank = "290 mm"').replace('"300 mm"] }', '"280 mm"] }')
    result = answer("solve", file(narrow), "--starts", 40)
    assert not result["valid"]
    assert result.get("conflict")
    assert any("cannot be the shortest link" in note for note in result["notes"])


def test_an_evaluated_sweep_without_valid_points_is_exit_code_1() -> None:
    vary = "mechanism.links.rod.length=50..80 mm:3"
    done = run("study", "sweep", "slider-crank", "--analyze", "--vary", vary, "--column", "input.torque_Nm")
    assert done.exit_code == 1
    assert "reachable" in done.stdout


@pytest.mark.slow
def test_a_second_run_cannot_write_to_the_folder_of_the_first(tmp_path: Path) -> None:
    out = tmp_path / "out"
    sweep = ["study", "sweep", "crank-rocker", "--vary", "mechanism.frame=450..550 mm:30000", "--workers", "1", "--out", str(out)]
    command = [sys.executable, "-m", "optlink", *sweep]
    with subprocess.Popen(command, stderr=subprocess.DEVNULL) as first:
        try:
            while not complete(out):
                assert first.poll() is None
                time.sleep(0.05)
            done = subprocess.run([*command, "--resume"], capture_output=True, text=True, timeout=60, check=False)
        finally:
            first.kill()
    assert done.returncode == 2
    assert f"process {first.pid}" in done.stderr


UNSEEN = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069]")
HOSTILE = "\x1b]0;renamed\x07\x1b[31mred\u202e\x9b2J\r\u2066"
SEEN = r"\x1b]0;renamed\x07\x1b[31mred\u202e\x9b2J\r\u2066"
TITLE = SEEN.replace(r"\r", " ")  # of one line


HOSTILE_PLACES = {
    "show": (("show", "mine.toml"), TITLE),
    "title": (("analyze", "mine.toml", "--points", "12"), TITLE),
    "file": (("analyze", f"{HOSTILE}.toml", "--points", "12", "--set", "mechanism.crank=3"), f"{SEEN}.toml: mechanism.crank"),
    "key": (("analyze", "mine.toml", "--set", f"mech{HOSTILE}=3"), f"mech{SEEN.split(']')[0]}"),
    "line": (("analyze", f"{HOSTILE}\nError: no.toml"), rf"{SEEN}\nError: no.toml: no such file"),
    "option": (("analyze", "mine.toml", f"--{HOSTILE}"), "no such option"),
    "page": (("report", "mine.toml", "-o", f"{HOSTILE}.html"), f"{SEEN}.html"),
    "name": (("analyze", "name.toml"), f"bodies.{SEEN[:5]}"),
}


@pytest.mark.parametrize("place", mostly_slow(HOSTILE_PLACES, "name"))
def test_control_characters_do_not_reach_the_terminal(place, tmp_path):
    """Of a title, a name, a key, a file: they could rename the window, turn text around or hide a verdict."""
    arguments, words = HOSTILE_PLACES[place]
    title, sides = json.dumps(HOSTILE), 'crank = "100 mm"\nframe = "500 mm"\ncoupler = "412 mm"\nrocker = "232 mm"'
    for name in ("mine", HOSTILE):
        (tmp_path / f"{name}.toml").write_text(f"title = {title}\n[mechanism]\n{sides}\n", encoding="utf-8")
    (tmp_path / "name.toml").write_text(f"[mechanism]\n{sides}\n[bodies]\n{title} = {{}}\n", encoding="utf-8")
    environment = {**os.environ, "PYTHONIOENCODING": "utf-8", "COLUMNS": "200"}
    options = {"capture_output": True, "timeout": 120, "cwd": tmp_path, "env": environment}
    done = subprocess.run([sys.executable, "-m", "optlink", *arguments], check=False, **options)
    text = (done.stdout + done.stderr).decode()
    assert UNSEEN.sub("", text) == text
    assert words in text, text


@pytest.mark.slow
def test_colours_and_json_are_as_before(tmp_path):
    words = [sys.executable, "-m", "optlink", "analyze", "slider-crank", "--points", "12"]
    coloured = subprocess.run(words, capture_output=True, check=True, env={**os.environ, "FORCE_COLOR": "1", "NO_COLOR": ""})
    assert b"\x1b[1m" in coloured.stdout
    (tmp_path / "mine.toml").write_text(
        f'title = {json.dumps(HOSTILE)}\n[mechanism]\ncrank = "1 mm"\nframe = "5 mm"\ncoupler = "4 mm"\nrocker = "3 mm"\n',
        encoding="utf-8",
    )
    assert answer("analyze", tmp_path / "mine.toml")["title"] == " ".join(HOSTILE.splitlines())
