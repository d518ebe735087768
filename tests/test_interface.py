"""The Python interface: namespaces with names that complete, problems by name or path, one interface of all results."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

import optlink
from optlink.errors import InputError
from optlink.presentation.registry import KINDS as REGISTERED_RESULTS
from optlink.problem.document import Document, Result
from optlink.tasks.results.common import DesignResult
from tests.test_docs import ROOT

FILE = ROOT / "problems" / "slider-crank.toml"


@pytest.mark.parametrize("given", ["slider-crank", FILE, str(FILE)])
def test_a_problem_is_given_by_name_path_or_object(given: str | Path) -> None:
    expected = optlink.analyze(optlink.load("slider-crank"), points=12)["input.torque_Nm"]
    np.testing.assert_array_equal(optlink.analyze(given, points=12)["input.torque_Nm"], expected)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: optlink.solve("crank-rokcer"), 'no such problem. Did you mean "crank-rocker"'),
        (lambda: optlink.solve(3), "problem = 3: not a problem. Give what optlink.load returns"),
        (lambda: optlink.simulate(optlink.analyze("six-bar", 12)), "not a problem. Of a result give its problem, or its machine"),
        (lambda: optlink.studies.sweep("no.toml", ["a=1"]), "no.toml"),
    ],
)
def test_what_is_no_problem_is_refused_in_a_sentence(call, message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        call()
    assert len(str(caught.value).splitlines()) == 1


def test_motion_of_a_problem_is_that_of_its_linkage() -> None:
    angles = np.linspace(0.0, 6.0, 9)
    moved = optlink.motion("slider-crank", angles, speed=10.0)
    assert moved.position("B").shape == (9, 2)
    cycle = optlink.analyze("slider-crank", speed=10.0)
    whole = optlink.motion("slider-crank", np.radians(cycle["crank_angle_deg"]), speed=10.0)
    for k, axis in enumerate("xy"):
        np.testing.assert_allclose(whole.velocity("B")[:, k], cycle[f"B.v{axis}_m_s"], rtol=0, atol=1e-12)
        np.testing.assert_allclose(whole.acceleration("B")[:, k], cycle[f"B.a{axis}_m_s2"], rtol=0, atol=1e-10)


RESULTS = {
    "design": lambda: optlink.validate("crank-rocker", {"coupler": 0.412, "rocker": 0.232}),
    "analysis": lambda: optlink.analyze("shaper", 36),
    "simulation": lambda: optlink.simulate("six-bar", 0.05, 40),
    "sweep": lambda: optlink.studies.sweep("crank-rocker", ["limits.transmission_angle.min=30..40 deg:2"], workers=1),
    "sensitivity": lambda: optlink.studies.sensitivities("crank-rocker"),
}


@pytest.fixture(scope="module", params=RESULTS)
def result(request: pytest.FixtureRequest) -> Document:
    found: Document = RESULTS[request.param]()
    return found


MEMBERS = {name for kind in (Result, DesignResult) for name in vars(kind) if not name.startswith("_")}


def members_of(kind: str) -> set[str]:
    """What a registered class of results has, as a field or otherwise."""
    known = REGISTERED_RESULTS[kind].result()
    return {*dir(known), *(item.name for item in dataclasses.fields(known))}  # type: ignore[arg-type]


@pytest.mark.parametrize("kind", REGISTERED_RESULTS)
def test_every_kind_of_result_keeps_the_protocol(kind: str) -> None:
    """`tests/test_types_of_examples.py` has a type checker compare the types too."""
    expected = {name for name in vars(Result) if not name.startswith("_")} | {"kind"}
    assert {"valid", "status", "plots"} <= expected
    assert (MEMBERS if kind in ("design", "balance") else expected) - members_of(kind) == set()


def test_every_result_is_valid_or_not_and_says_how_it_ended(result: Document) -> None:
    assert type(result.valid) is bool
    assert isinstance(result.status, str)
    document = result.to_dict()
    assert (document["valid"], document["status"]) == (result.valid, result.status)
    assert ("not valid" in repr(result)) is not result.valid


@pytest.mark.parametrize(("kind", "former"), [("analysis", "sound"), ("simulation", "finished"), ("sweep", "successful")])
def test_a_member_of_a_former_name_warns(kind: str, former: str) -> None:
    result = RESULTS[kind]()
    with pytest.warns(DeprecationWarning, match=rf"\.{former} is now valid$") as caught:
        assert getattr(result, former) == result.valid
    assert caught[0].filename == __file__


def test_every_result_is_plotted(result: Document) -> None:
    from matplotlib.figure import Figure

    assert result.plots
    assert isinstance(result.plot(), Figure)
    assert isinstance(result.plot(result.plots[0]), Figure)
    with pytest.raises(InputError, match=r"has no picture nothing\. Known: "):
        result.plot("nothing")


def test_every_result_is_a_frame(result: Document, tmp_path: Path) -> None:
    import pandas

    frame = result.to_frame()
    assert len(frame) > 0
    for path in result.write(tmp_path / "out"):
        if path.suffix == ".csv":
            there = result.to_frame(path.stem).replace([np.inf, -np.inf], np.nan)  # empty cells
            pandas.testing.assert_frame_equal(there, pandas.read_csv(path), check_dtype=False)
    with pytest.raises(InputError, match=r"has no table nothing\. Known: "):
        result.to_frame("nothing")


def test_a_missing_pandas_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    import sys

    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(InputError, match=r'pip install "\.\[frame\]"'):
        optlink.analyze("shaper", 12).to_frame()


@pytest.mark.slow
def test_report_and_export_take_results_and_problems(tmp_path: Path) -> None:
    result = RESULTS["analysis"]()
    assert optlink.report(result, tmp_path / "one.html", {"author": "A. Designer"}).read_text().count("A. Designer") >= 1
    assert optlink.report("shaper", str(tmp_path / "two.html")).is_file()
    for suffix in ("dxf", "svg", "csv", "json"):
        assert optlink.export(result, tmp_path / f"shaper.{suffix}").stat().st_size > 100
    sources = optlink.analyze("shaper"), "shaper"
    one, other = (optlink.export(source, tmp_path / f"{k}.svg", at=0.5) for k, source in enumerate(sources))
    assert one.read_text() == other.read_text()
    with pytest.raises(InputError, match="not a single design"):
        optlink.export(RESULTS["sweep"](), tmp_path / "no.svg")
    invalid = optlink.validate("crank-rocker", {"coupler": 0.412, "rocker": 0.232})
    with pytest.raises(InputError, match="Nothing was written"):
        optlink.export(invalid, tmp_path / "no.svg")
    assert optlink.export(invalid, tmp_path / "yes.svg", even_invalid=True).is_file()
    with pytest.raises(InputError, match=r"unknown key|facts"):
        optlink.report("shaper", tmp_path / "no.html", {"autor": "x"})
    assert not (tmp_path / "no.svg").exists()
    assert not (tmp_path / "no.html").exists()


def test_first_designs_of_a_search() -> None:
    one, two = (optlink.synthesis.starts("path-arc5", rounds) for rounds in (1, 2))
    assert [first.cost for first in one] == sorted(first.cost for first in one)
    assert len(two) >= len(one)
    problem = optlink.load("path-arc5", {"mechanism.assembly": one[0].assembly})
    checked = optlink.validate(problem, one[0].design)
    assert checked.objective < 1e-4  # [m]
    with pytest.raises(InputError, match="no targets"):
        optlink.synthesis.starts("shaper-design")
