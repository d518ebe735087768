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
from optlink.problem.quantity import Unusable
from optlink.problem.targets.law import read_output_law

LONG = "1+" * 5000 + "1"
DEEP = "(" * 1000 + "1" + ")" * 1000

BAD = {
    "missing unit": ({"mechanism.frame": 500}, "mechanism.frame", "needs a unit"),
    "text without unit": ({"mechanism.frame": "500"}, "mechanism.frame", "needs a unit"),
    "wrong dimension": ({"mechanism.frame": "500 kg"}, "mechanism.frame", "not a unit of length"),
    "angle for a length": ({"mechanism.frame": "30 deg"}, "mechanism.frame", "not a unit of length"),
    "unknown unit": ({"mechanism.frame": "500 furlongs"}, "mechanism.frame", "unknown"),
    "not a number": ({"mechanism.frame": math.nan}, "mechanism.frame", "finite"),
    "nan in text": ({"mechanism.frame": "nan mm"}, "mechanism.frame", "finite"),
    "infinite": ({"mechanism.frame": math.inf}, "mechanism.frame", "finite"),
    "overflow": ({"mechanism.frame": "1e999 mm"}, "mechanism.frame", "finite"),
    "negative": ({"mechanism.crank": "-100 mm"}, "mechanism.crank", "positive"),
    "zero": ({"mechanism.crank": "0 mm"}, "mechanism.crank", "positive"),
    "absurdly short": ({"mechanism.crank": "1e-300 m"}, "mechanism.crank", "no linkage has"),
    "absurdly long": ({"mechanism.crank": "1e300 km"}, "mechanism.crank", "no linkage has"),
    "zero bound": ({"mechanism.coupler.bounds": ["0 mm", "900 mm"]}, "mechanism.coupler.bounds", "positive"),
    "lower above upper": ({"mechanism.coupler.bounds": ["900 mm", "100 mm"]}, "mechanism.coupler.bounds", "not below"),
    "start outside": ({"mechanism.coupler.start": "95 mm"}, "mechanism.coupler.start", "outside the bounds"),
    "one bound": ({"mechanism.coupler.bounds": ["100 mm"]}, "mechanism.coupler.bounds", "two values"),
    "no bounds": ({"mechanism.coupler": {"start": "400 mm"}}, "mechanism.coupler.bounds", "needs bounds"),
    "a boolean": ({"mechanism.frame": True}, "mechanism.frame", "expected a length"),
    "a list": ({"mechanism.frame": ["500 mm"]}, "mechanism.frame", "this is not a length"),
    "bounds in a list": (
        {"mechanism.frame": ["5 mm", "9 mm"]},
        "mechanism.frame",
        'Write { bounds = ["5 mm", "9 mm"] } for a design variable',
    ),
    "free without bounds": ({"mechanism.frame": "free"}, "mechanism.frame", "for a design variable"),
    "same bounds": (
        {"mechanism.coupler": {"bounds": ["5 mm", "5 mm"]}},
        "mechanism.coupler.bounds",
        'Give one value to fix it: "5 mm"',
    ),
    "key of another section": (
        {"requirement.transmission_angle": ["40 deg", "140 deg"]},
        "requirement.transmission_angle",
        'Did you mean "limits.transmission_angle"',
    ),
    "dimension among the limits": (
        {"limits.coupler": ["5 mm", "9 mm"]},
        "limits.coupler",
        'Did you mean "mechanism.coupler"',
    ),
    "capital letter": ({"mechanism.Coupler": "5 mm"}, "mechanism.Coupler", 'mean "coupler"'),
    "section of another tool": ({"constraints": {}}, "constraints", "constraints: unknown key. Known: title, "),
    "title as a number": ({"title": 3}, "title", 'this is not a text. Write it in quotes: "3"'),
    "points as text": ({"requirement.points": "40"}, "requirement.points", "this is not a whole number"),
    "points out of range": ({"requirement.points": -1}, "requirement.points", "this is below 1. Give a whole number"),
    "mass alone": ({"bodies": {"rocker": "2 kg"}}, "bodies.rocker", 'Write rocker = { mass = "1.2 kg" }'),
    "kind of a path": (
        {"requirement": {"point": "C", "points": [["1 mm", "2 mm"], ["3 mm", "4 mm"]]}},
        "requirement.kind",
        'Add kind = "path"',
    ),
    "unknown key": ({"mechanism.copler": "4 mm"}, "mechanism.copler", 'Did you mean "coupler"'),
    "unknown section": ({"limit.crank": "span"}, "limit.crank", 'Did you mean "limits"'),
    "unknown key of a quantity": ({"mechanism.coupler.begin": "4 mm"}, "mechanism.coupler.begin", "start, bounds"),
    "unknown type": ({"mechanism.type": "fourbar"}, "mechanism.type", 'Did you mean "four-bar"'),
    "unknown start": ({"requirement.from": "outer dead point"}, "requirement.from", "outer dead centre"),
    "unknown measure": ({"requirement.measure": "least squares"}, "requirement.measure", "sum of squares"),
    "no points": ({"requirement.points": 0}, "requirement.points", "whole number"),
    "broken points": ({"requirement.points": 2.5}, "requirement.points", "whole number"),
    "too many points": ({"requirement.points": 10**9}, "requirement.points", "whole number"),
    "no span": ({"requirement.span": "0 deg"}, "requirement.span", "zero"),
    "start beyond a turn": ({"requirement.from": "700 deg"}, "requirement.from", "within -360 deg"),
    "too long a span": ({"requirement.span": "361 deg"}, "requirement.span", "one revolution"),
    "span is free": ({"requirement.span": {"bounds": ["1 deg", "2 deg"]}}, "requirement.span", "cannot be free"),
    "limits reversed": ({"limits.transmission_angle": ["135 deg", "45 deg"]}, "limits.transmission_angle", "above the upper"),
    "limit out of range": ({"limits.transmission_angle": ["-45 deg", "90 deg"]}, "limits.transmission_angle", "out of range"),
    "limit of three": ({"limits.transmission_angle": ["1 deg", "2 deg", "3 deg"]}, "limits.transmission_angle", "two values"),
    "empty limit": ({"limits.transmission_angle": {}}, "limits.transmission_angle", "empty"),
    "limited twice": ({"limits.transmission_cosine": [-0.7, 0.7]}, "limits.transmission_cosine", "twice"),
    "time ratio below one": ({"limits.time_ratio": [0.5, 2.0]}, "limits.time_ratio", "ratio is 1 or more. Write [1, 2]"),
    "time ratio all below one": ({"limits.time_ratio": [0.5, 0.8]}, "limits.time_ratio", "ratio is 1 or more. Give 1 or more"),
    "quick stroke above one": (
        {"limits.time_ratio": {"stroke": "quick", "min": 0.95, "max": 1.05}},
        "limits.time_ratio.max",
        "ratio is 1 or less. Give 1",
    ),
    "swing of a double-crank": (
        {"limits.crank": "double-crank", "requirement.from": "10 deg", "limits.swing_angle": "40 deg"},
        "limits.swing_angle",
        "a crank-rocker only",
    ),
    "dead centre of a double-crank": ({"limits.crank": "double-crank"}, "requirement.from", "no dead centres"),
    "revolution of a span": (
        {"limits.crank": "span", "limits.transmission_over": "revolution"},
        "limits.transmission_over",
        "whole revolution",
    ),
    "law: unknown name": ({"requirement.law": "psi0 + theta"}, "requirement.law", '"theta" is unknown'),
    "law: attribute": ({"requirement.law": "phi.__class__"}, "requirement.law", '"." does not belong'),
    "law: import": ({"requirement.law": "__import__('os').system('true')"}, "requirement.law", '"__import__" is unknown'),
    "law: too long": ({"requirement.law": LONG}, "requirement.law", "10,001 characters"),
    "law: too deep": ({"requirement.law": "(" * 500 + "1" + ")" * 500}, "requirement.law", "nested more than"),
    "law: deep and long": ({"requirement.law": DEEP}, "requirement.law", "characters"),
    "law: empty": ({"requirement.law": ""}, "requirement.law", "ends too early"),
    "law: a number": ({"requirement.law": 3}, "requirement.law", "expression or a table"),
    "law: pole between the points": ({"requirement.law": "psi0 + 1/(phi - phi0 - 0.7)"}, "requirement.law", "divides by zero"),
    "law: pole of even order": ({"requirement.law": "psi0 + 1/(phi - phi0 - 0.7)^2"}, "requirement.law", "exceeds"),
    "law: far too large": ({"requirement.law": "psi0 + 1e6*(phi - phi0)"}, "requirement.law", "exceeds 1000 rad"),
    "law: pole at the start": ({"requirement.law": "psi0 + 1/(phi - phi0)"}, "requirement.law", "divides by zero"),
    "law: logarithm of a negative": ({"requirement.law": "log(phi0 - phi - 1)"}, "requirement.law", "no finite real value"),
    "table: empty": ({"requirement.law": {}}, "requirement.law.phi", "list of angles"),
    "table: empty columns": ({"requirement.law": {"phi": [], "psi": []}}, "requirement.law.phi", "list of angles"),
    "table: one row": ({"requirement.law": {"phi": ["1 deg"], "psi": ["1 deg"]}}, "requirement.law.phi", "two rows"),
    "table: not monotone": (
        {"requirement.law": {"phi": ["0 deg", "20 deg", "10 deg"], "psi": ["0 deg"] * 3}},
        "requirement.law.phi",
        "row 3",
    ),
    "table: ragged": ({"requirement.law": {"phi": ["0 deg", "9 deg"], "psi": ["0 deg"] * 3}}, "requirement.law.psi", "3"),
    "table: no unit": ({"requirement.law": {"phi": [0, 9], "psi": ["0 deg"] * 2}}, "requirement.law.phi[0]", "needs a unit"),
    "table: other span": (
        {"requirement.law": {"phi": ["0 deg", "60 deg"], "psi": ["0 deg", "9 deg"]}},
        "requirement.span",
        "differs from that of the table",
    ),
    "table: no such file": ({"requirement.law": {"csv": "nowhere.csv"}}, "requirement.law.csv", "cannot read"),
    "table: twice": ({"requirement.law": {"csv": "a.csv", "phi": ["0 deg"]}}, "requirement.law.csv", "twice"),
    "section is a value": ({"limits": 3}, "limits", "expected a table"),
    "limit without a quantity": ({"limits.driving": {"max": "3 N*m"}}, "limits.driving", "unknown key"),
    "limit with an unknown key": (
        {"limits.driving": {"quantity": "torque", "max": "3 N*m", "bar": 2}},
        "limits.driving.bar",
        "unknown key",
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_values_are_reported_with_key_and_remedy(crank_rocker, name):
    changes, key, words = BAD[name]
    with pytest.raises(InputError) as caught:
        crank_rocker.override(changes)
    message = str(caught.value)
    assert "crank-rocker.toml" in message
    assert key in message
    assert words in message
    for fault in caught.value.faults:
        assert fault.remedy
        assert len(str(fault)) < 700
        assert "\n" not in str(fault)
    assert caught.value.exit_code == 2


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("frame = 250 mm\n", "Expected newline or end of document after a statement (at line 1, column 13)"),
        ("[limits]\n[limits]\n", "Cannot declare ('limits',) twice (at line 2, column 8)"),
        ("a = [1 mm]\n", "Unclosed array (at line 1, column 8)"),
        (f"a = {'9' * 5000}\n", "a number has thousands of digits"),
    ],
)
def test_toml_syntax_errors_have_their_place_and_the_rule_of_quotes(tmp_path, text, words):
    (tmp_path / "a.toml").write_text(text, encoding="utf-8", newline="\r\n")
    with pytest.raises(InputError) as caught:
        optlink.load(tmp_path / "a.toml")
    (fault,) = caught.value.faults
    assert fault.message == f"not valid TOML: {words}"
    assert ("in quotes" in fault.remedy) is ("at line" in words)


@pytest.mark.parametrize(
    ("wrong", "right", "section"),
    [("coupelr", "coupler", "mechanism"), ("knd", "kind", "requirement"), ("lw", "law", "requirement")],
)
def test_a_misspelt_key_is_one_fault(crank_rocker, wrong, right, section):
    """The key that is missing for that reason, or that another kind would need, is not named beside it."""
    raw = copy.deepcopy(dict(crank_rocker.raw))
    if right == "kind":
        raw["requirement"] = {"kind": "transmission"}
    raw[section][wrong] = raw[section].pop(right)
    with pytest.raises(InputError) as caught:
        optlink.read(raw)
    (fault,) = caught.value.faults
    assert (fault.message, fault.key) == ("unknown key", f"{section}.{wrong}")
    assert f'"{right}"' in fault.remedy


def test_names_with_a_comma_are_quoted_in_a_list(crank_rocker):
    with pytest.raises(InputError, match='left, right, either, continue, "left, continue", "right, continue", parallelogram'):
        crank_rocker.override({"mechanism.assembly": "rigth"})


def test_a_value_out_of_range_names_the_range(crank_rocker):
    with pytest.raises(
        InputError, match='swing_angle = "400 deg": 400 deg is out of range; possible values: from 0 deg to 180 deg'
    ):
        crank_rocker.override({"limits.swing_angle": "400 deg"})


def test_all_faults_are_reported(crank_rocker):
    with pytest.raises(InputError) as caught:
        crank_rocker.override({"mechanism.crank": "1 kg", "requirement.points": 0, "limits.crank": "half"})
    assert {fault.key for fault in caught.value.faults} == {"mechanism.crank", "requirement.points", "limits.crank"}


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"title = ", "not valid TOML"),
        (b'{"schema": "optlink/result/3"}', "this is JSON.*optlink show FILE --toml"),
        ("title = 'x'".encode("utf-16"), "byte 0 .it is UTF-16"),
        ("title = 'x'".encode("utf-16-le"), "NUL characters"),
        (b"title = 'x'\r[mechanism]\r", "carriage returns"),
        (b"\xff\xfe\x00", "not UTF-8"),
        (b"a = " + b"[" * 5000, "TOML|nested"),
        (b"a = " + b"9" * 6000, "not valid TOML"),
        (b"# " + b"x" * 1_100_000, "larger than"),
        (b"", "the file has no keys.*optlink new --list"),
        (b"# nothing\n", "the file has no keys"),
        (b"PK\x03\x04\x14\x00\x06\x00", "a ZIP archive, such as an Excel"),
        (b"PK\x03\x04\x14\x00\xe2\x00", "a ZIP archive, such as an Excel"),
        (b"\x00\x01\xff", "this is not a text file"),
        ("title = 'x'\nabout = 'f\u00fcr'".encode("latin-1"), "byte 0xFC in line 2"),
    ],
)
def test_broken_files(tmp_path, content, words):
    path = tmp_path / "broken.toml"
    path.write_bytes(content)
    with pytest.raises(InputError, match=words) as caught:
        load(path)
    assert "broken.toml" in str(caught.value)


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


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("phi_deg,psi_deg\n0,0\n15,abc\n", "row 3"),
        ("phi_deg,psi_deg\n0,0\n15\n", "row 3"),
        ("phi_deg,psi_deg\n0,0\n15,nan\n", "row 3"),
        (
            "phi_deg,psi_deg\n0,0\n15,2,5\n",
            "row 3 of law.csv has 3 cells, the title row has 2. Correct the row; decimals have a point",
        ),
        ("phi_deg,psi_deg,psi_rad\n0,0,0\n15,2,0.03\n", "two columns of psi"),
        ("phi_deg;psi_deg\n0;0\n15;2,5\n", "row 3 of law.csv has a decimal comma in column psi_deg"),
        ("x,y\n0,0\n", "no column phi_deg"),
        ("", "no column phi_deg"),
        ("phi_deg,psi_deg\n0,0\n0,1\n", "row 3 of law.csv has phi_deg = 0 after 0"),
        ("phi_deg,psi_deg\n0,0\n5,1e300\n", "row 3 of law.csv has too large a value in column psi_deg"),
        ("phi_deg,psi_deg\n0,0\n3.1416,1\n6.2832,2\n", "this is one revolution in radians. Name the column phi_rad"),
        ("phi_deg,psi_deg\n" + "0,0\n" * 10_001, "more than 10,000"),
    ],
)
def test_bad_csv_names_the_row(crank_rocker, tmp_path, content, words):
    (tmp_path / "law.csv").write_text(content)
    with pytest.raises(InputError, match=words):
        read({**crank_rocker.raw, "requirement": {"law": {"csv": "law.csv"}}}, folder=tmp_path)


def test_a_table_of_two_outputs_is_ambiguous(tmp_path):
    (tmp_path / "law.csv").write_text("phi_deg,s_in,psi_deg\n0,0,0\n5,1,1\n")
    with pytest.raises(Unusable, match="columns of two outputs, s_in and psi_deg"):
        read_output_law({"csv": "law.csv"}, tmp_path)


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


@pytest.mark.parametrize(
    ("key", "value", "most"),
    [
        ("drive.start", "1e300 deg", "1e+06 rad"),
        ("drive.start", "1e9 deg", "1e+06 rad"),
        ("bodies.crank.mass", "1e300 kg", "1e+30 kg"),
        ("bodies.crank.inertia", "1e40 kg*m^2", "1e+30 kg*m**2"),
        ("loads.process.force", "-1e305 N", "1e+30 N"),
        ("gravity", "1e300 m/s^2", "1e+30 m/s**2"),
        ("drive.torque", "1e300 N*m", "1e+30 N*m"),
    ],
)
def test_values_that_overflow_are_refused(key: str, value: str, most: str) -> None:
    """They gave energies of 1e304 J, or an error of the interpolation between two equal angles."""
    with pytest.raises(InputError, match="the value is too large") as caught:
        load("six-bar", {key: value})
    assert f'{key} = "{value}"' in str(caught.value)
    assert f"Give at most {most}" in str(caught.value)


@pytest.mark.parametrize("requirement", [{}, {"points": 5}, {"output": "slider"}, {"kind": "function", "span": "90 deg"}])
@pytest.mark.parametrize("name", ["slider-crank", "six-bar", "shaper"])
def test_a_function_without_a_law_names_what_is_missing(name, requirement):
    with pytest.raises(InputError, match=r"requirement\.law: (the law of the output|this key) is missing\. (Write|Add) law = "):
        load(name, {"requirement": requirement})


def test_an_integer_of_thousands_of_digits_is_refused(tmp_path):
    path = tmp_path / "long.toml"
    path.write_text(f"title = 'x'\nmechanism = {{ crank = {'9' * 5000} }}\n", encoding="utf-8")
    with pytest.raises(InputError, match=r"a number has thousands of digits\. Write a number of at most 19 digits"):
        load(path)
    with pytest.raises(InputError, match=r"balance\.positions = .*the number is too large"):
        load("balance-four-bar", {"balance.positions": "9" * 5000})
