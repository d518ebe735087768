"""Studies as documents: the file alone gives the study that was found, with the same page."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

import optlink
from optlink.cli.app import app
from optlink.errors import InputError
from optlink.presentation.html.page import write_page
from optlink.presentation.registry import read_result, stored_page
from optlink.problem.document import Document
from optlink.studies import pareto, sensitivities, sweep, sweeps as sweep_module, tolerance
from optlink.studies.motion_sensitivity import OutputStudy
from tests.tiers import mostly_slow

TOLERANCES = ["coupler=0.3 mm", "rocker=0.2 mm uniform"]
ROD = "mechanism.links.rod.length"
DESIGN = {"coupler": 0.41, "rocker": 0.23}


def crank_rocker() -> optlink.ProblemFile:
    return optlink.load("crank-rocker")


STUDIES: dict[str, Callable[[], Document]] = {
    "sweep": lambda: sweep(crank_rocker(), ["limits.transmission_angle.max=110..179 deg:6"], workers=1),
    "sweep without a design": lambda: sweep(crank_rocker(), ["limits.transmission_angle.max=91 deg, 140 deg"], workers=1),
    "sweep of analyses": lambda: sweep(optlink.load("slider-crank"), [f"{ROD}=20..400 mm:3"], analyze=True, workers=1),
    "sweep of simulations": lambda: sweep(optlink.load("shaper"), ["drive.torque=1 N*m, 100 N*m"], simulate={}, workers=1),
    "front": lambda: pareto(crank_rocker(), "error, limits.transmission_angle.max", points=3, workers=1),
    "tolerance": lambda: tolerance(crank_rocker(), TOLERANCES, limit="2.33 deg", samples=1024, design=DESIGN),
    "linear tolerance": lambda: tolerance(crank_rocker(), ["C.clearance=0.2 mm"], "C.x", samples=0, design=DESIGN),
    "allocation": lambda: tolerance(crank_rocker(), TOLERANCES, limit="2.33 deg", samples=256, target_yield=0.8),
    "robust design": lambda: tolerance(crank_rocker(), TOLERANCES, limit="2.33 deg", samples=1024, robust=3),
    "sensitivity": lambda: sensitivities(crank_rocker(), check=True),
    "sensitivity of a path": lambda: sensitivities(optlink.load("path-scott-russell")),
    "sensitivity of a stroke": lambda: sensitivities(optlink.load("stroke-crank-rocker")),
}
SLOW = ("sweep", "sweep without a design", "sweep of simulations", "front", "allocation", "robust design")
SLOW += ("sensitivity of a path", "sensitivity of a stroke", "sensitivity", "linear tolerance")


def written(study: Document, folder: Path) -> Path:
    folder.mkdir(exist_ok=True)
    path = folder / "result.json"
    path.write_text(json.dumps(study.to_dict()), encoding="utf-8")
    return path


def page_text(study: Document, folder: Path) -> str:
    write_page(stored_page(study, {}, "result.json"), folder / "page.html")
    return (folder / "page.html").read_text(encoding="utf-8")


@pytest.mark.parametrize("name", [pytest.param(name, marks=pytest.mark.slow) if name in SLOW else name for name in STUDIES])
def test_a_study_is_read_as_it_was_written(name, tmp_path, monkeypatch):
    """Every digit, and the page, in an empty folder."""
    study = STUDIES[name]()
    path = written(study, tmp_path / "stored")
    monkeypatch.chdir(tmp_path / "stored")
    read = read_result(path)
    assert type(read) is type(study)
    assert json.dumps(read.to_dict()) == path.read_text(encoding="utf-8")
    assert page_text(read, tmp_path) == page_text(study, tmp_path)


def test_derivatives_of_an_output_are_computed_again(tmp_path):
    problem = crank_rocker()
    sizes = {name: quantity.value for name, quantity in problem.model.mechanism.quantities.items()}
    study = OutputStudy(problem, "rocker", sizes, np.radians([0.0, 60.0]))
    read = read_result(written(study, tmp_path))
    assert read.to_dict() == study.to_dict()
    np.testing.assert_array_equal(read.derivatives.by["frame"], study.derivatives.by["frame"])
    with pytest.raises(InputError, match="has no page"):
        stored_page(read, {}, "result.json")


def test_the_columns_of_a_sweep_are_those_of_its_table(tmp_path):
    study = sweep(optlink.load("slider-crank"), [f"{ROD}=20..400 mm:3"], analyze=True, workers=1)
    read = read_result(written(study, tmp_path))
    assert read.names == study.names == tuple(study.columns)
    for name, column in study.columns.items():
        assert read.columns[name].dtype == column.dtype
        np.testing.assert_array_equal(read.columns[name], column)
    assert np.isnan(read.columns["input.torque_Nm.min"][0])  # the rod is too short


@pytest.mark.slow
def test_a_large_sweep_is_read_with_its_table(tmp_path, monkeypatch):
    monkeypatch.setattr(sweep_module, "MAX_ROWS", 5)
    out = tmp_path / "out"
    study = sweep(optlink.load("slider-crank"), [f"{ROD}=200..400 mm:6"], out, analyze=True, workers=1)
    path = written(study, out)
    assert json.loads(path.read_text())["data"] is None
    page, moved = page_text(study, tmp_path), tmp_path / "moved"
    out.rename(moved)
    read = read_result(moved)
    assert "columns" not in vars(read.table)  # which is loaded when it is needed
    assert read.columns[f"{ROD}_m"].tolist() == [0.2, 0.24, 0.28, 0.32, 0.36, 0.4]
    assert page_text(read, tmp_path) == page
    table = (moved / "sweep.csv").read_text()
    for text, words in {
        table.replace("torque_Nm.min", "torque_Nm", 1): "the table of this sweep is missing: sweep.csv",
        None: "the table of this sweep is missing: sweep.csv",
    }.items():
        (moved / "sweep.csv").unlink()
        if text is not None:
            (moved / "sweep.csv").write_text(text)
        with pytest.raises(InputError, match=words) as caught:
            read_result(moved)
        assert len(caught.value.faults) == 1


def test_a_damaged_table_is_refused_in_a_sentence(tmp_path, monkeypatch):
    monkeypatch.setattr(sweep_module, "MAX_ROWS", 5)
    study = sweep(optlink.load("slider-crank"), [f"{ROD}=200..400 mm:6"], tmp_path, analyze=True, workers=1)
    written(study, tmp_path)
    head, *rows = (tmp_path / "sweep.csv").read_text().split("\n")
    for first in ("zero" + rows[0], rows[0] + ",1"):
        (tmp_path / "sweep.csv").write_text("\n".join([head, first, *rows[1:]]))
        with pytest.raises(InputError, match="cannot read the table of the sweep: it is damaged"):
            _ = read_result(tmp_path).columns


@pytest.mark.slow
def test_a_robust_design_with_measured_parts_needs_no_other_file(tmp_path):
    (tmp_path / "parts.csv").write_text("coupler_mm\n" + "\n".join(f"{0.01 * k:.2f}" for k in range(-9, 10)))
    raw: dict[str, Any] = dict(crank_rocker().raw) | {"tolerances": {"coupler": "parts.csv", "rocker": "0.1 mm"}}
    study = tolerance(optlink.read(raw, folder=tmp_path), limit="2.33 deg", samples=256, robust=3)
    path = written(study, tmp_path / "stored")
    document = study.to_dict()
    (tmp_path / "parts.csv").unlink()
    read = read_result(path)
    assert read.to_dict() == document
    assert read.deviations == study.deviations
    assert read.robust.result.valid


@pytest.mark.parametrize("name", mostly_slow(["sweep", "front", "tolerance", "sensitivity"], "tolerance"))
def test_a_changed_document_is_refused_in_a_sentence(name, tmp_path):
    document = STUDIES[name]().to_dict()
    document["status"] = "better"
    path = tmp_path / "result.json"
    path.write_text(json.dumps(document))
    done = CliRunner().invoke(app, ["report", str(path), "-o", str(tmp_path / "a.html")])
    assert done.exit_code == 2
    assert "the result was changed since it was written" in done.stderr
    assert done.stderr.count("Error:") == 1
