"""Problem files: what is wrong is named with file, key, value and remedy; a fuzz of 5,000 mutated files never gets past that."""

from __future__ import annotations

import copy
import math
import random
import string

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


def test_missing_file_and_folder_and_name(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        load(tmp_path / "nothing.toml")
    with pytest.raises(InputError, match="folder"):
        load(tmp_path)
    with pytest.raises(InputError, match='Did you mean "crank-rocker"'):
        load("crank-roker")
    with pytest.raises(InputError, match="cannot read"):
        load("a\0b.toml")


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


JUNK = [
    *(None, True, -1, 0, 1e308, -0.0, math.nan, math.inf, 10**30, "", " ", "mm", "1 mm", "-5 mm", "1e-300 m", "1e300 km"),
    *("5 deg", "90 rpm", "\0", "phi", "__import__('os')", "((", "9" * 400, "9" * 400 + " mm", "5 mm mm", "5 m*m/m", "5 /mm"),
    *("5 m**-1", "5 °", "5 m^9999", "٣ mm", "outer dead centre", "span", "max", [], {}, [[]], ["1 mm"], ["1 mm", "2 mm"]),
    *(["2 deg", "1 deg"], [1, 2], {"start": "1 mm"}, {"bounds": []}, {"bounds": ["1 mm", "2 mm"], "start": "3 mm"}),
    *("1..2 mm", "1 deg .. 2 deg", "<= 3", ">= 1 mm", "1,5 mm", "1-2 mm", "..", "1..", "5 Nm", "1..2..3", "2..1 m"),
    *({"min": 1}, {"csv": ".."}, {"csv": "/dev/null"}, {"phi": ["0 deg"], "psi": [0]}),
]


def _mutate(tree: dict, rng: random.Random) -> None:
    """One random change somewhere in nested tables and lists."""
    node, key = tree, rng.choice(list(tree) or [""])
    while isinstance(node.get(key), dict) and node[key] and rng.random() < 0.8:
        node, key = node[key], rng.choice(list(node[key]))
    action = rng.random()
    if action < 0.55:
        node[key] = copy.deepcopy(rng.choice(JUNK))
    elif action < 0.7:
        node.pop(key, None)
    elif action < 0.8:
        node["".join(rng.choices(string.printable, k=rng.randint(0, 12)))] = copy.deepcopy(rng.choice(JUNK))
    elif isinstance(node.get(key), str) and node[key]:
        text = list(node[key])
        for _ in range(rng.randint(1, 4)):
            text[rng.randrange(len(text))] = rng.choice(string.printable)
        node[key] = "".join(text)
    elif isinstance(node.get(key), list) and node[key]:
        node[key][rng.randrange(len(node[key]))] = copy.deepcopy(rng.choice(JUNK))


@pytest.mark.slow
def test_five_thousand_mutated_problems_never_break_the_loader(crank_rocker):
    """Every mutated problem either loads (and is usable) or is refused with faults; no other exception, ever."""
    rng = random.Random(7)
    loaded = refused = 0
    table = {"phi": ["0 deg", "30 deg", "90 deg"], "psi": ["0 deg", "3 deg", "30 deg"], "measured_from": "start"}
    for k in range(5000):
        raw = copy.deepcopy(dict(crank_rocker.raw))
        if k % 3 == 0:
            raw["requirement"] = {
                "law": dict(table),
                "from": {"start": "40 deg", "bounds": ["0 deg", "90 deg"]},
                "psi0": "100 deg",
            }
            raw["limits"] |= {"swing_angle": ["30 deg", "60 deg"], "time_ratio": {"max": 1.5}, "link_ratio": [0.1, 5]}
        for _ in range(rng.randint(1, 3)):
            _mutate(raw, rng)
        try:
            problem = read(raw)
        except InputError as error:
            refused += 1
            assert error.faults
            assert all(fault.remedy and fault.message for fault in error.faults)
            continue
        loaded += 1
        assert all(math.isfinite(bound) for q in problem.model.quantities.values() for bound in (q.value, *q.bounds))
        if "requirement" in raw:
            assert len(problem.spec.law.offsets) >= 1
            assert np.all(np.isfinite(problem.spec.law.tabulated))
    assert loaded > 200
    assert refused > 2000


@pytest.mark.slow
def test_mutated_bytes_never_break_the_loader(crank_rocker, tmp_path):
    """The same for the text of the file: 1,000 files with random bytes changed, cut or doubled."""
    original = (optlink.shipped()["crank-rocker"]).read_bytes()
    rng = random.Random(11)
    path = tmp_path / "mutated.toml"
    for _ in range(1000):
        data = bytearray(original)
        for _ in range(rng.randint(1, 5)):
            at = rng.randrange(len(data))
            choice = rng.random()
            if choice < 0.5:
                data[at] = rng.randrange(256)
            elif choice < 0.75:
                del data[at : at + rng.randint(1, 40)]
            else:
                data[at:at] = data[at : at + rng.randint(1, 40)]
        path.write_bytes(bytes(data))
        try:
            load(path)
        except InputError as error:
            assert "mutated.toml" in str(error)


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
