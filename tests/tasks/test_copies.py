"""Every result pickles, copies and crosses processes; the copy has the same figures and serves the same purposes."""

from __future__ import annotations

import copy
import json
import multiprocessing
import pickle
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import optlink
from optlink import load
from optlink.errors import Fault
from optlink.presentation.html.page import page
from optlink.presentation.registry import KINDS, read_result, view_of
from optlink.presentation.report_model import report_model_of
from optlink.problem.document import Document
from optlink.studies import pareto, sweep, tolerance
from optlink.studies.motion_sensitivity import OutputStudy, output_sensitivity
from optlink.studies.sensitivity import of_solution, sensitivities
from tests.tiers import mostly_slow


def _robust() -> Any:
    return tolerance(load("crank-rocker-robust"), samples=64, robust=3.0)


def _slopes() -> Any:
    machine = optlink.analyze(load("shaper")).machine
    return output_sensitivity(machine.mechanism, machine.sizes, [0.1, 0.2], "rocker")


RESULTS: dict[str, Callable[[], Any]] = {
    "law": lambda: optlink.solve(load("crank-rocker"), "both", track=True),
    "law, checked": lambda: optlink.validate(load("crank-rocker"), {"coupler": 0.4, "rocker": 0.32, "phi0": 0.8}),
    "points": lambda: optlink.solve(load("law-slider-crank")),
    "transmission": lambda: optlink.solve(load("transmission-optimal"), designs=1, starts=1),
    "cycle": lambda: optlink.solve(load("shaper-design"), starts=1),
    "balance": lambda: optlink.balance(load("balance-four-bar"), trade="force,torque", points=3),
    "analysis": lambda: optlink.analyze(load("shaper")),
    "batch": lambda: optlink.analyze_batch(load("slider-crank"), {"rod.length": np.array([0.3, 0.4])}),
    "simulation": lambda: optlink.simulate(load("slider-crank"), rows=50),
    "clearance": lambda: optlink.control.simulate_clearance(load("slider-crank-clearance"), 1),
    "comparison": lambda: optlink.control.compare(load("crank-rocker-clearance"), 1, 1),
    "tuning": lambda: optlink.control.tune(
        load("crank-rocker-clearance"), "pid", ("proportional",), evaluations=4, starts=1, revolutions=2, points=72
    ),
    "sensitivities": lambda: sensitivities(load("crank-rocker")),
    "output sensitivity": _slopes,
    "output study": lambda: OutputStudy(
        load("shaper"), "rocker", optlink.analyze(load("shaper")).machine.sizes, np.array([0.1, 0.2])
    ),
    "sweep": lambda: sweep(load("crank-rocker"), ["limits.transmission_angle.min=30..40 deg:2"], workers=1),
    "pareto": lambda: pareto(load("crank-rocker"), "error, limits.transmission_angle.max", points=3, workers=1),
    "tolerance": _robust,
}


@cache
def made(kind: str) -> Any:
    return RESULTS[kind]()


@pytest.fixture(
    scope="module",
    params=mostly_slow(RESULTS, "law", "law, checked", "balance", "batch", "simulation", "output sensitivity", "tolerance"),
)
def result(request: pytest.FixtureRequest) -> Any:
    return made(request.param)


def document(result: Any) -> Any:
    return result.to_dict() if hasattr(result, "to_dict") else repr(result)


def _ready() -> int:
    return 1


@pytest.fixture(scope="module")
def pool() -> Any:
    """A pool of processes that have not inherited anything."""
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as processes:
        assert processes.submit(_ready).result() == 1
        yield processes


def test_a_result_pickles(result: Any) -> None:
    assert document(pickle.loads(pickle.dumps(result))) == document(result)


def test_an_error_pickles_and_copies_with_its_faults() -> None:
    """A process pool passes errors on by pickling them; one that cannot be read breaks the pool."""
    for error in (
        optlink.InputError("a message", "a remedy", "file.toml", "a.key", 3.0),
        optlink.InputError([Fault("one", "do this"), Fault("two", "do that")]),
    ):
        for other in (pickle.loads(pickle.dumps(error)), copy.copy(error), copy.deepcopy(error)):
            assert (type(other), other.faults, str(other)) == (type(error), error.faults, str(error))


def test_a_result_copies(result: Any) -> None:
    assert document(copy.deepcopy(result)) == document(result)
    assert document(copy.copy(result)) == document(result)


def test_a_result_crosses_processes(result: Any, pool: ProcessPoolExecutor) -> None:
    assert pool.submit(document, result).result() == document(result)
    assert document(pool.submit(copy.copy, result).result()) == document(result)


def compare(one: Any, other: Any) -> None:
    """Fail unless two documents are equal, apart from the last digits of numbers."""
    assert type(one) is type(other)
    if isinstance(one, dict):
        assert one.keys() == other.keys()
        for key in one:
            compare(one[key], other[key])
    elif isinstance(one, list):
        assert len(one) == len(other)
        for left, right in zip(one, other, strict=True):
            compare(left, right)
    else:
        assert one == (pytest.approx(other, rel=1e-7, abs=1e-12) if isinstance(one, float) else other)


@pytest.mark.parametrize("kind", mostly_slow(["law", "points", "cycle"], "law"))
def test_a_copied_optimum_has_its_proof(kind: str) -> None:
    """The programme in the copy is alive: limits, curvature and sensitivities are computed from it.

    It generates its own Hessian, where the original has that of the back end: the last digits may differ.
    """
    result = made(kind)
    again = pickle.loads(pickle.dumps(result))
    assert again.solution.limits == result.solution.limits
    assert again.solution.curvature == pytest.approx(result.solution.curvature, rel=1e-9, nan_ok=True)
    one, other = (of_solution(each.definite, each.solution).to_dict() for each in (result, again))
    compare(one, other)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["law", "analysis"])
def test_a_copy_is_reported(kind: str, tmp_path: Path) -> None:
    result = pickle.loads(pickle.dumps(made(kind)))
    view_of(result.kind).write(result, tmp_path)
    assert any(tmp_path.iterdir())
    assert "<svg" in page(report_model_of(result))


def test_a_result_is_shown_in_notebooks(result: Any) -> None:
    """With its table and a drawing in well-formed HTML, and a short text."""
    if not isinstance(result, Document):
        return
    html = result._repr_html_()
    if view_of(result.kind).no_page:
        assert html is None
        return
    assert html is not None
    assert html.count("<table") == html.count("</table>") > 0
    assert html.count("<svg") == html.count("</svg>") in (1, 2)  # linkage, chart or both
    assert len(repr(result)) < 120


def test_every_kind_of_result_has_a_published_schema() -> None:
    published = json.loads((Path(__file__).parents[2] / "docs/reference/result.schema.json").read_text())
    schemas = [one["properties"]["schema"]["const"] for one in published["anyOf"]]
    assert schemas == [kind.result().schema() for kind in KINDS.values()]


@cache
def schema() -> Any:
    """Validator of documents of results."""
    import jsonschema  # not needed by the processes of the pool

    published = json.loads((Path(__file__).parents[2] / "docs/reference/result.schema.json").read_text())
    kind = jsonschema.validators.validator_for(published)
    kind.check_schema(published)
    return kind(published)


def test_a_result_reads_itself(result: Any, tmp_path: Path) -> None:
    """The result of a written document has the same class and writes the same document, which is one of the published schema."""
    if not isinstance(result, Document):
        return
    path = tmp_path / "result.json"
    path.write_text(json.dumps(result.to_dict()), encoding="utf-8")
    again = read_result(path)
    assert type(again) is type(result)
    written = json.loads(path.read_text(encoding="utf-8"))
    assert json.loads(json.dumps(again.to_dict())) == written
    schema().validate(written)
    assert written["schema"] == result.schema()
    for wrong in ({"schema": "optlink/design/1"}, {"problem_file": {}}, {"title": 3}):
        assert not schema().is_valid(written | wrong)
    for name in ("schema", "problem_hash", "problem_file", "crc32"):
        assert not schema().is_valid({key: item for key, item in written.items() if key != name})


def test_notes_of_others_are_kept_beside_the_check_sum(tmp_path: Path) -> None:
    notes = {"order": 17, "by": ["A", "B"]}
    document = optlink.validate("crank-rocker", {"coupler": 0.412, "rocker": 0.232}).to_dict()
    assert "meta" not in document
    path = tmp_path / "result.json"
    path.write_text(json.dumps(document | {"meta": notes}), encoding="utf-8")
    stored = optlink.read_result(path)
    assert stored.meta == notes
    assert stored.to_dict() == document | {"meta": notes}
    assert schema().is_valid(stored.to_dict())
    assert not schema().is_valid(stored.to_dict() | {"meta": [1]})
    stored.write(tmp_path / "again")
    assert json.loads((tmp_path / "again" / "result.json").read_text(encoding="utf-8"))["meta"] == notes
    path.write_text(json.dumps(document | {"note": "mine"}), encoding="utf-8")
    with pytest.raises(optlink.InputError, match="the result was changed"):
        optlink.read_result(path)
    path.write_text(json.dumps(document | {"meta": "mine"}), encoding="utf-8")
    with pytest.raises(optlink.InputError, match="the notes of a result are an object"):
        optlink.read_result(path)
