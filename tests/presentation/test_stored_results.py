"""Every kind of stored result in an empty folder of another user: page, drawings, tables, validation are those of the result."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import optlink
from optlink.presentation.export.export import export
from optlink.presentation.files import write_csv
from optlink.presentation.html.page import page
from optlink.presentation.registry import KINDS, read_result, stored_page, view_of
from optlink.presentation.report_model import ReportModel, report_model_of
from optlink.problem.document import Document
from optlink.studies import pareto, sensitivities, sweep, tolerance
from optlink.studies.motion_sensitivity import OutputStudy
from tests.cli.test_cli import run

PLAY = {"points": 60, "tolerance": 1e-6}
NARROW = ["88 deg", "92 deg"]
LAW = "mechanism.frame=495..505 mm:3"


def opposed() -> optlink.ProblemFile:
    """Limits that exclude each other."""
    return optlink.load("crank-rocker", {"limits.transmission_angle": ["85 deg", "95 deg"]})


def slopes() -> Document:
    with_out = run("study", "sensitivity", "crank-rocker", "--quantity", "rocker", "--angles", "0 deg, 90 deg", "--json")
    path = Path("slopes.json")
    path.write_text(with_out.stdout, encoding="utf-8")
    result = read_result(path)
    assert isinstance(result, OutputStudy)
    return result


MADE: dict[str, Callable[[], Any]] = {
    "design": lambda: optlink.solve(optlink.load("crank-rocker")),
    "design, conflict": lambda: optlink.solve(opposed()),
    "design, either mode": lambda: optlink.solve(optlink.load("crank-rocker", {"mechanism.assembly": "either"})),
    "design, points": lambda: optlink.solve(optlink.load("path-arc5"), starts=64),
    "design, points, conflict": lambda: optlink.solve(
        optlink.load("path-arc5", {"limits.transmission_angle": ["88 deg", "92 deg"]}), starts=64
    ),
    "design, cycle": lambda: optlink.solve(optlink.load("stroke-crank-rocker"), starts=2),
    "design, cycle, either mode": lambda: optlink.solve(
        optlink.load("stroke-crank-rocker", {"mechanism.assembly": "either"}), starts=2
    ),
    "analysis": lambda: optlink.analyze(optlink.load("shaper"), 60, speed=6.7),
    "simulation": lambda: optlink.simulate(optlink.load("six-bar"), 0.05, 40),
    "clearance": lambda: optlink.control.simulate_clearance(optlink.load("crank-rocker-clearance"), 1, **PLAY),
    "control comparison": lambda: optlink.control.compare("crank-rocker-clearance", starts=1, revolutions=1, **PLAY),
    "tuning": lambda: optlink.control.tune(
        optlink.load("crank-rocker-clearance"), evaluations=4, starts=1, revolutions=1, tolerance=1e-5
    ),
    "balance": lambda: optlink.balance(optlink.load("balance-four-bar"), trade="force,torque", points=4),
    "sensitivity": lambda: sensitivities(optlink.load("crank-rocker")),
    "output sensitivity": slopes,
    "sweep": lambda: sweep(optlink.load("crank-rocker"), [LAW], workers=1),
    "tolerance": lambda: tolerance(optlink.load("crank-rocker"), ["coupler=0.2 mm"], limit="2.33 deg", samples=256),
    "pareto": lambda: pareto(optlink.load("crank-rocker"), "error, limits.transmission_angle.max", points=3, workers=1),
}
"""A result of every kind, and some without a design or with several assembly modes."""


def shown(result: Any, folder: Path) -> dict[str, str]:
    """Page, drawings, tables and the document of a result, as texts by the name of the file."""
    texts = {"document": json.dumps(result.to_dict())}
    view = view_of(result.kind)
    if not view.no_page:
        about = stored_page(result, {}, "")
        texts["page"] = page(about)
        if isinstance(about, ReportModel) and about.cycle is not None:
            for suffix in ("svg", "csv", "json", "dxf"):
                export(about, folder / f"a.{suffix}")
                text = (folder / f"a.{suffix}").read_text(encoding="utf-8")
                drawn = text.partition("\nBLOCKS\n")[2].partition("\nOBJECTS\n")[0]  # without the time of writing
                texts[suffix] = drawn if suffix == "dxf" else text
    for name, columns in view.tables(result).items():
        write_csv(folder / name, columns)
        texts[f"table {name}"] = (folder / name).read_text(encoding="utf-8")
    file = result.definite if hasattr(result, "validation") else None
    if file is not None and result.kind != "balance":
        checked = optlink.validate(file, {name: result.design[name] for name in file.model.free}) if result.design else None
        texts["validation"] = "" if checked is None else repr((checked.objective, checked.validation.checks))
    return texts


ELSEWHERE = """
import json, sys
from pathlib import Path
import optlink
from tests.presentation.test_stored_results import shown
texts = {}
for file in sorted(Path.cwd().glob("*.json")):
    texts[file.stem] = shown(optlink.read_result(file), Path(sys.argv[1]))
print(json.dumps(texts))
"""


def test_every_kind_is_here():
    assert {name.partition(",")[0] for name in MADE} == set(KINDS)


@pytest.mark.slow
def test_results_are_the_same_elsewhere(tmp_path, monkeypatch):
    """In a folder with the results alone, read by a process with another home and user, under a path that is not in them."""
    home, away, scratch = (tmp_path / name for name in ("home", "away", "scratch"))
    for folder in (home, away, scratch):
        folder.mkdir()
    monkeypatch.chdir(home)
    results = {name: make() for name, make in MADE.items()}
    for name, result in results.items():
        (away / f"{name}.json").write_text(json.dumps(result.to_dict()), encoding="utf-8")
        assert str(tmp_path) not in (away / f"{name}.json").read_text(encoding="utf-8")
    environment = os.environ | {"HOME": str(scratch), "USER": "someone", "LOGNAME": "someone", "MPLCONFIGDIR": str(scratch)}
    environment["PYTHONPATH"] = str(Path(optlink.__file__).parents[1])
    words = [sys.executable, "-c", ELSEWHERE, str(scratch)]
    done = subprocess.run(words, cwd=away, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    for name, result in results.items():
        expected = shown(result, scratch)
        assert found[name].keys() == expected.keys()
        assert {key for key, text in expected.items() if found[name][key] != text} == set(), name
        again = read_result(away / f"{name}.json")
        assert type(again) is type(result)
    assert found["design, points, conflict"]["page"].count("Conflicting limits") > 0
    assert found["design, conflict"]["page"].count("Conflicting limits") > 0


@pytest.mark.slow
def test_a_result_is_a_problem_for_every_command(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert run("solve", "crank-rocker", "--out", "out").exit_code == 0
    assert (tmp_path / "out" / "result.json").stat().st_size < 60_000
    solved = optlink.read_result("out")
    folder = str(tmp_path / "alone")
    Path(folder).mkdir()
    (Path(folder) / "result.json").write_bytes(Path("out/result.json").read_bytes())
    assert run("validate", folder).exit_code == 0
    analysis = json.loads(run("analyze", folder, "--points", "12", "--json").stdout)
    assert analysis["sizes"]["coupler"] == solved.design["coupler"]
    output = json.loads(run("study", "sensitivity", folder, "--quantity", "rocker", "--angles", "90 deg", "--json").stdout)
    assert output["sizes_SI"]["coupler"] == solved.design["coupler"]
    scatter = run("study", "tolerance", folder, "--tolerance", "coupler=0.1 mm", "--samples", "64", "--json")
    assert json.loads(scatter.stdout)["sizes_SI"]["coupler"] == solved.design["coupler"]
    again = json.loads(run("solve", folder, "--json").stdout)
    assert again["objective"]["value"] == pytest.approx(solved.objective, rel=1e-12)
    assert "mechanism" in run("show", folder, "--toml").stdout
    done = run("export", folder, "-o", "links.dxf")
    assert done.exit_code == 0, done.stderr


def test_the_order_of_keys_is_that_of_the_file():
    """On it depends that of the unknowns of a stored optimum."""
    problem = optlink.load("crank-rocker-robust")
    result = optlink.validate(problem, {"coupler": 0.412, "rocker": 0.232})
    stored = result.to_dict()["problem_file"]["toml"]
    again = optlink.read(stored, problem.name)
    assert list(again.model.tolerances) == list(problem.model.tolerances)
    assert [one.name for one in again.model.deviations] == [one.name for one in problem.model.deviations]


@pytest.mark.slow
def test_files_of_a_problem_are_enclosed(tmp_path, monkeypatch):
    """Tables in several encodings, measured deviations and a drawing: the result is read after the files are gone."""
    monkeypatch.chdir(tmp_path)
    angles = np.linspace(0.0, 120.0, 9)
    table = "# größe\nphi_deg;psi_deg\n" + "\n".join(f"{a:.6f};{60.0 + 0.4 * a:.6f}" for a in angles)
    for encoding in ("utf-8", "utf-8-sig", "latin-1", "utf-16"):
        Path("law.csv").write_bytes(table.encode(encoding))
        Path("parts.csv").write_text("coupler_mm\n0.1\n-0.1\n0.05\n", encoding="utf-8")
        Path("mine.toml").write_text(optlink.shipped()["crank-rocker"].read_text(encoding="utf-8"), encoding="utf-8")
        changes = {"requirement.law": {"csv": "law.csv"}, "requirement.span": None, "tolerances": {"coupler": "parts.csv"}}
        problem = optlink.load("mine.toml", changes)
        result = optlink.validate(problem, {"coupler": 0.412, "rocker": 0.232})
        Path("result.json").write_text(json.dumps(result.to_dict()), encoding="utf-8")
        Path("law.csv").unlink(), Path("parts.csv").unlink()
        again = read_result("result.json")
        assert again.problem.hash == problem.hash
        assert again.to_dict() == result.to_dict()
        assert page(report_model_of(again)) == page(report_model_of(result)) if encoding == "utf-8" else True


def sizes(*words: str) -> dict[str, float]:
    done = run("analyze", *words, "--points", "12", "--json")
    assert done.exit_code in (0, 1), done.stderr
    return json.loads(done.stdout)["sizes"]


@pytest.mark.slow
def test_a_change_of_a_result_counts(tmp_path, monkeypatch):
    """Of a fixed length, and of one that was found; all others are those of the result."""
    monkeypatch.chdir(tmp_path)
    design = ("--design", "coupler=420 mm", "--design", "rocker=240 mm")
    assert run("validate", "crank-rocker", *design, "--out", "given").exit_code in (0, 1)
    assert sizes("given", "--set", "mechanism.crank=90 mm")["crank"] == 0.09
    both = sizes("given", "--set", "mechanism.coupler=450 mm", "--set", "mechanism.frame=480 mm")
    assert (both["coupler"], both["rocker"], both["frame"]) == (0.45, 0.24, 0.48)
    for words in (("tolerance", "given", "--tolerance", "coupler=0.1 mm", "--samples", "0"),):
        done = json.loads(run("study", *words, "--json").stdout)
        assert (done["sizes_SI"]["coupler"], done["sizes_SI"]["rocker"]) == (0.42, 0.24)
    words = ("given", "--analyze", "--column", "rocker.swing_rad", "--vary", "mechanism.frame=500, 501 mm")
    swept = run("study", "sweep", *words, "--json")
    swing = optlink.analyze(optlink.load("crank-rocker"), design={"coupler": 0.42, "rocker": 0.24}).swings["rocker"].span
    assert json.loads(swept.stdout)["data"]["rocker.swing_rad"][0] == pytest.approx(swing, rel=1e-9)


def test_a_file_that_is_named_anew_is_read_anew(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("mine.toml").write_text(optlink.shipped()["crank-rocker"].read_text(encoding="utf-8"), encoding="utf-8")
    Path("parts.csv").write_text("coupler_mm\n0.1\n-0.1\n", encoding="utf-8")
    problem = optlink.load("mine.toml", {"tolerances": {"coupler": "parts.csv"}})
    Path("parts.csv").write_text("coupler_mm\n0.3\n-0.3\n", encoding="utf-8")
    assert problem.override({"mechanism.frame": "490 mm"}).model.deviations[0].tolerance == 1e-4
    assert problem.override({"tolerances.coupler": "parts.csv"}).model.deviations[0].tolerance == 3e-4


@pytest.mark.slow
def test_solutions_of_both_back_ends_have_the_programme_of_their_mode(tmp_path):
    result = optlink.solve(optlink.load("path-crank-rocker"), "both", starts=60)
    (tmp_path / "result.json").write_text(json.dumps(result.to_dict()), encoding="utf-8")
    again = read_result(tmp_path)
    for name, one in result.backends.items():
        other = again.backends[name]
        assert other.nlp.values(other.x, other.p)[0] == one.nlp.values(one.x, one.p)[0]


@pytest.mark.slow
def test_what_is_drawn_of_a_proof_is_no_certificate(tmp_path):
    result = optlink.solve(optlink.load("crank-rocker"))
    (tmp_path / "result.json").write_text(json.dumps(result.to_dict()), encoding="utf-8")
    (tmp_path / "again").mkdir()
    view_of("design").write(read_result(tmp_path), tmp_path / "again")
    assert not (tmp_path / "again" / "certificate.json").exists()
    assert (tmp_path / "again" / "boxes.png").exists()


def test_a_drawing_in_another_code_is_enclosed(tmp_path):
    text = '<?xml version="1.0" encoding="windows-1251"?><svg xmlns="http://www.w3.org/2000/svg" width="100mm" height="100mm" '
    text += 'viewBox="0 0 100 100"><path id="кривая" d="M 10 10 L 40 20 L 30 60 Z"/></svg>'
    (tmp_path / "k.svg").write_bytes(text.encode("windows-1251"))
    template = optlink.load("path-arc5").raw
    requirement = {"kind": "path", "point": "P", "points": {"svg": "k.svg", "path": "кривая", "points": 6}}
    problem = optlink.read({**template, "requirement": requirement}, folder=tmp_path)
    assert optlink.read({**problem.raw}, files=problem.files).hash == problem.hash
