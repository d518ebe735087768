"""Problem files: what is wrong is named with file, key, value and remedy; spellings of keys and values that mean the same."""

from __future__ import annotations

import math

import numpy as np
import pytest

import optlink
from optlink.errors import InputError
from optlink.problem.assignment import parse_assignment
from optlink.problem.file import load, read


@pytest.mark.parametrize(("name", "remedy"), [("mine", 'the file "mine.toml"'), ("mine.tml", 'the file "mine.toml"')])
def test_a_missing_suffix_is_suggested(tmp_path, monkeypatch, name, remedy):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match="`optlink list` names the shipped ones; or give the path"):
        load(name)
    (tmp_path / "mine.toml").write_text("", encoding="utf-8")
    with pytest.raises(InputError, match=f"no such problem. Did you mean {remedy}"):
        load(name)


def test_table_from_csv(crank_rocker, tmp_path):
    angles = np.linspace(0.0, 90.0, 7)
    rows = [f"{phi},{math.degrees(2 / (3 * math.pi) * math.radians(phi) ** 2)!r}" for phi in angles]
    (tmp_path / "law.csv").write_text("phi_deg, psi_deg\n" + "\n".join(rows) + "\n")
    text = {**crank_rocker.raw, "requirement": {"law": {"csv": "law.csv"}, "from": "outer dead centre"}}
    problem = read(text, folder=tmp_path).spec
    assert math.degrees(problem.span) == pytest.approx(90.0)
    np.testing.assert_allclose(np.degrees(problem.law.offsets), angles[1:])
    np.testing.assert_allclose(problem.law.tabulated, 2 / (3 * math.pi) * np.radians(angles[1:]) ** 2, rtol=1e-12)


def test_table_rows_or_points_between_them(crank_rocker):
    table = {"phi": ["0 deg", "30 deg", "60 deg", "90 deg"], "psi": ["0 deg", "3 deg", "13 deg", "30 deg"]}
    raw = {**crank_rocker.raw, "requirement": {"law": table}}
    assert len(read(raw).spec.law.offsets) == 3
    raw["requirement"] = {"law": table, "points": 18}
    law = read(raw).spec.law
    assert len(law.offsets) == 18
    assert math.degrees(law.tabulated[5]) == pytest.approx(3.0)
    assert math.degrees(law.tabulated[-1]) == pytest.approx(30.0)
    assert np.all(np.diff(law.tabulated) > 0)


@pytest.mark.parametrize(
    ("text", "key", "value"),
    [
        ('mechanism.frame="480 mm"', "mechanism.frame", "480 mm"),
        ("mechanism.frame=480 mm", "mechanism.frame", "480 mm"),
        ("requirement.points=50", "requirement.points", 50),
        ('limits.transmission_angle=["50 deg", "130 deg"]', "limits.transmission_angle", ["50 deg", "130 deg"]),
        ("requirement.law=psi0 + 0.3*(phi - phi0)", "requirement.law", "psi0 + 0.3*(phi - phi0)"),
        ("requirement.measure = max", "requirement.measure", "max"),
        ("a = b = c", "a", "b = c"),
    ],
)
def test_assignments(text, key, value):
    assert parse_assignment(text) == (key, value)


@pytest.mark.parametrize("text", ["", "=", "mechanism.frame", "mechanism.frame=", "=3", "a=[1", 'a="x', "a={"])
def test_bad_assignments(text):
    with pytest.raises(InputError):
        parse_assignment(text)


@pytest.mark.parametrize("nest", [lambda inner: {"a": inner}, lambda inner: [inner]], ids=["tables", "lists"])
def test_values_that_are_nested_deep_are_refused(nest, crank_rocker, tmp_path):
    deep = nest(3)
    for _ in range(5000):
        deep = nest(deep)
    file = tmp_path / "deep.toml"
    file.write_text(f"[mechanism.{'.'.join('a' * 5000)}]\n")
    for refused in (
        lambda: optlink.read({"mechanism": deep}),
        lambda: optlink.load("crank-rocker", {"mechanism.crank": deep}),
        lambda: crank_rocker.override({"mechanism.crank": deep}),
        lambda: optlink.load(str(file)),
    ):
        with pytest.raises(InputError, match=r"mechanism.*: nested more than 50 deep") as error:
            refused()
        assert len(str(error.value)) < 200


# --- spellings ------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "key", "ours", "theirs"),
    [
        ("crank-rocker-clearance", "control.{}", "regularisation", "regularization"),
    ],
)
def test_american_keys_are_those_of_the_documentation(name, key, ours, theirs):
    section = key.partition(".")[0]
    raw = optlink.load(name).raw
    table = {theirs if k == ours else k: value for k, value in raw[section].items()}
    assert optlink.read({**raw, section: table}).model == optlink.read(raw).model
    assert optlink.load(name, {key.format(theirs): "2 deg"}).model == optlink.load(name, {key.format(ours): "2 deg"}).model
    with pytest.raises(optlink.InputError, match=theirs):
        optlink.read({**raw, section: {**raw[section], theirs: "both"}})


def test_american_values_are_those_of_the_documentation():
    law, design = optlink.load("crank-rocker"), optlink.load("shaper-design")
    inner = law.override({"requirement.from": "inner dead centre"})
    assert law.override({"requirement.from": "inner dead center"}).model == inner.model != law.model
    terms = [{**term, "sense": "minimize"} for term in design.raw["objective"]["terms"]]
    assert design.override({"objective.terms": terms}).model.goals == design.model.goals


def test_names_of_the_user_keep_their_spelling():
    raw = optlink.load("shaper-design").raw
    limits = {"regularization": raw["limits"]["stroke"], "time_ratio": raw["limits"]["time_ratio"]}
    assert "regularization" in optlink.read({**raw, "limits": limits}).model.limits.named


def test_an_error_of_a_shipped_problem_names_no_file_of_the_same_name(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match=r"^toggle-press\.toml: "):
        optlink.solve("toggle-press")
    before = optlink.analyze("toggle-press", 12).to_dict()
    (tmp_path / "toggle-press.toml").write_text("")
    with pytest.raises(InputError, match=r"^the shipped problem toggle-press: "):
        optlink.solve("toggle-press")
    assert optlink.analyze("toggle-press", 12).to_dict() == before
