"""Problem files of machines: what is wrong is named with file, key, value and remedy; a fuzz never gets past that."""

from __future__ import annotations

import copy
import json
import math
import random
import re
import string
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

import optlink
from optlink.cli.app import app
from optlink.dynamics.columns import MotionColumns
from optlink.errors import InputError
from optlink.problem.file import dump, load, read
from optlink.tasks.analyze import analyze
from optlink.tasks.machine import machine_of

ROOT = Path(__file__).parents[2]


N12 = ["1 N", "2 N"]


# --- what only the motion shows -----------------------------------------------------------------------------------------


def test_start_that_cannot_be_assembled_lists_what_can_be_reached():
    """A long crank: the group C closes within 90 deg of the ground line alone."""
    problem = load("six-bar", {"mechanism.links.link2.length": "0.75 m", "drive.start": "180 deg"})
    with pytest.raises(InputError) as caught:
        analyze(problem)
    (fault,) = caught.value.faults
    assert (fault.file, fault.key, fault.value) == ("six-bar.toml", "drive.start", "180 deg")
    assert "the RRR group link2-link3 (joint C) fails to close by 350 mm" in fault.message  # 1.9 - (0.75 + 0.8) m
    low, high = (float(text) for text in re.search(r"reached: (\S+) \.\.\. (\S+) deg", fault.remedy).groups())
    edge = math.degrees(math.acos((0.4**2 + 1.5**2 - 1.55**2) / (2 * 0.4 * 1.5)))  # |BD| = 0.75 + 0.8 m: the law of cosines
    assert high - 360.0 == pytest.approx(edge, abs=1e-3)
    assert low == pytest.approx(360.0 - edge, abs=1e-3)
    assert not analyze(problem.override({"drive.start": "0 deg"})).full


def test_dimensions_that_never_assemble():
    with pytest.raises(InputError, match="No crank angle can be reached: change the dimensions") as caught:
        analyze(load("six-bar", {"mechanism.links.link2.length": "0.1 m"}))
    assert "six-bar.toml: drive.start" in str(caught.value)


@pytest.mark.parametrize("speed", ["1e9 rad/s", "1e-12 rad/s"])
def test_absurd_speeds(speed):
    with pytest.raises(InputError, match="out of range"):
        analyze(load("six-bar", {"drive.speed": speed}))


@pytest.mark.parametrize(
    ("name", "changes"),
    [
        ("toggle-press", {"bodies": None}),  # a flywheel for a machine without masses
        ("six-bar", {"loads.process.force": "1e30 N"}),  # the largest that is read
    ],
)
def test_numbers_that_break_the_arithmetic_do_not_warn(name, changes):
    analyze(load(name, changes), points=12)


# --- files ----------------------------------------------------------------------------------------------------------------


def test_csv_is_the_table_in_the_file(tmp_path):
    (tmp_path / "force.csv").write_text("force_kN; s_mm\n0; 500\n\n2; 600\n1; 700\n")
    base = load("six-bar").raw
    table = {"over": "s", "at": ["500 mm", "600 mm", "700 mm"], "values": ["0 kN", "2 kN", "1 kN"]}
    loads = [{"on": "slider", "force": size} for size in ({"over": "s", "csv": "force.csv"}, table)]
    one, other = (read({**base, "loads": {"process": own}}, folder=tmp_path) for own in loads)
    assert one.model.loads == other.model.loads
    before = one.hash
    (tmp_path / "force.csv").write_text("force_kN, s_mm\n0, 500\n2, 600\n1, 701\n")
    assert read(one.raw, folder=tmp_path).hash != before  # what the file beside it says counts


# --- the command line -----------------------------------------------------------------------------------------------------


# --- changing a problem -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "key", "value", "path"),
    [
        ("six-bar", "mechanism.links.link2.length", "1.25 m", ("mechanism", "links", "link2", "length")),
        ("six-bar", "mechanism.ground.D", ["1.45 m", "0.02 m"], ("mechanism", "ground", "D")),
        ("six-bar", "bodies.link5.mass", "4 kg", ("bodies", "link5", "mass")),
        ("six-bar", "loads.process.force", "1200 N", ("loads", "process", "force")),
        ("six-bar", "drive.speed", "-64 rpm", ("drive", "speed")),
        ("shaper", "loads.cutting.force", "6 kN", ("loads", "cutting", "force")),
        ("shaper", "mechanism.guides.F.friction", 0.1, ("mechanism", "guides", "F", "friction")),
        (
            "toggle-press",
            "loads.pressing.force.values",
            ["0 N", "1 kN", "2 kN", "3 kN"],
            ("loads", "pressing", "force", "values"),
        ),
        ("watt-i", "mechanism.links.leg.points.P", ["150 mm", "120 mm"], ("mechanism", "links", "leg", "points", "P")),
    ],
)
def test_override_round_trip(name, key, value, path, tmp_path):
    """A dotted key changes that value and nothing else, the answer with it; the changed problem is written and read back."""
    base = load(name)
    changed = base.override({key: value})
    node: Any = changed.raw
    for step in path:
        node = node[step]
    assert node == value
    assert changed.hash != base.hash
    assert changed.model.expected is None
    (tmp_path / "changed.toml").write_text(dump(changed), encoding="utf-8")
    again = load(tmp_path / "changed.toml")
    assert again.model == changed.model
    assert again.hash == changed.hash
    back = changed.override({key: _value(base.raw, path)})
    assert back.model == base.override({"expected": None}).model
    positions = np.linspace(0.0, 6.0, 5)
    records = [MotionColumns(machine_of(p).moving(positions, p.model.drive.speed.value)) for p in (base, changed, again)]
    torques = [record["input.torque_Nm"] for record in records]
    assert np.max(np.abs(torques[1] - torques[0])) > 1e-6
    np.testing.assert_array_equal(torques[2], torques[1])


def _value(raw: Any, path: tuple[str, ...]) -> object:
    for step in path:
        raw = raw.get(step) if isinstance(raw, Mapping) else None
    return raw


def test_command_line_override_is_that_of_the_library():
    arguments = ["--set", "mechanism.links.link2.length=1.25 m", "--set", "loads.process.acts=opposing", "--points", "12"]
    done = CliRunner().invoke(app, ["analyze", "six-bar", *arguments, "--json"])
    assert done.exit_code == 0
    document = json.loads(done.stdout)
    changed = load("six-bar", {"mechanism.links.link2.length": "1.25 m", "loads.process.acts": "opposing"})
    assert document["problem_hash"] == changed.hash
    assert document["columns"]["input.torque_Nm"] == pytest.approx(
        list(analyze(changed, points=12)["input.torque_Nm"]), rel=1e-12
    )
    assert document["sizes"]["link2.length"] == 1.25


def test_words_do_not_change_the_hash():
    base = load("shaper")
    assert base.override({"title": "Another"}).hash == base.hash
    assert base.override({"title": "Another"}).model.expected is not None
    assert base.override({"mechanism.type": None}).model.mechanism == base.model.mechanism  # links make it dyads


# --- the reference page -------------------------------------------------------------------------------------------------------

PAGE = (ROOT / "docs" / "problem-files.md").read_text(encoding="utf-8")
EXAMPLES = re.findall(r"```toml\n(.*?)```", PAGE, re.DOTALL)


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda text: tomllib.loads(text)["title"])
def test_every_example_of_the_reference_page_runs(example):
    problem = read(tomllib.loads(example))
    analysis = analyze(problem, points=24)
    assert analysis.full
    assert analysis.sound
    assert [note for note in analysis.notes if not note.startswith("joints are treated as ideal")] == []
    assert np.max(np.abs(analysis["input.torque_Nm"])) > 0.0
    expected = problem.model.expected
    for name, value in expected.figures.items() if expected else ():
        assert analysis.figures[name] == pytest.approx(value, rel=expected.figure_tolerance)


def test_the_reference_page_lists_all_keys():
    from optlink.problem.machine.bodies import BodySection, DriveSection
    from optlink.problem.machine.loads import LoadSection
    from optlink.problem.mechanism import GuideSection, LinkSection

    assert len(EXAMPLES) >= 5
    for section in (BodySection, DriveSection, LoadSection, GuideSection, LinkSection):
        for key in section.model_fields:
            assert f"`{key}`" in PAGE or re.search(rf"\b{key} = ", PAGE), f"{key} of {section.__name__} is not documented"
    told = {key for example in EXAMPLES for own in tomllib.loads(example).get("loads", {}).values() for key in own}
    assert set(LoadSection.model_fields) <= told


# --- fuzz ---------------------------------------------------------------------------------------------------------------------

JUNK: list[Any] = [
    *(None, True, -1, 0, 1e308, -0.0, math.nan, math.inf, 10**30, "", " ", "mm", "1 mm", "-5 mm", "1e-300 m", "1e300 km"),
    *("5 deg", "90 rpm", "\0", "phi", "crank", "frame", "A", "B", "C", "E", "slider", "left of B-D", "forward", "backward"),
    *("1 kg", "1e-200 kg", "5 N", "-5 kN", "3 N*m", "500 N/m", "20 N*s/m", "1 s", "slow", "opposing", "uniform bar", "middle"),
    *("((", "9" * 400, "9" * 400 + " mm", [], {}, [[]], ["A"], ["A", "B"], ["B", "C"], ["E"], ["1 mm", "2 mm"], ["0 mm", "0 mm"]),
    *({"mass": "1 kg"}, {"joints": ["B", "C"], "length": "1 m"}, {"joints": ["E"]}, {"slider": "slider", "through": "D"}),
    *({"on": "slider", "force": "5 N"}, {"on": "slider", "damping": "5 N*s/m"}, {"between": ["A", "C"], "stiffness": "5 N/m"}),
    *({"on": "link2", "torsional_stiffness": "5 N*m/rad"}, {"bounds": ["1 mm", "2 mm"]}, {"csv": ".."}),
    {"start": "1 m", "bounds": ["0.1 m", "2 m"]},
    *({"over": "s", "at": ["0 m", "1 m"], "values": N12}, {"over": "phi", "at": ["0 deg", "100 deg"], "values": N12}),
    *({"over": "omega", "csv": "/dev/null"}, {"expression": "1/(s-0.5)", "unit": "N"}, {"expression": "log(phi)", "unit": "N*m"}),
]


def mutate(tree: dict[str, Any], rng: random.Random) -> None:
    """One random change somewhere in nested tables and lists."""
    node, key = tree, rng.choice(list(tree) or [""])
    while isinstance(node.get(key), dict) and node[key] and rng.random() < 0.85:
        node, key = node[key], rng.choice(list(node[key]))
    action = rng.random()
    if action < 0.55:
        node[key] = copy.deepcopy(rng.choice(JUNK))
    elif action < 0.65:
        node.pop(key, None)
    elif action < 0.75:
        node["".join(rng.choices(string.printable, k=rng.randint(0, 12)))] = copy.deepcopy(rng.choice(JUNK))
    elif action < 0.8:
        node[rng.choice(list(node) or ["x"])] = copy.deepcopy(node.get(key))
    elif isinstance(node.get(key), str) and node[key]:
        text = list(node[key])
        for _ in range(rng.randint(1, 4)):
            text[rng.randrange(len(text))] = rng.choice(string.printable)
        node[key] = "".join(text)
    elif isinstance(node.get(key), list) and node[key]:
        node[key][rng.randrange(len(node[key]))] = copy.deepcopy(rng.choice(JUNK))


@pytest.mark.slow
def test_fifteen_hundred_mutated_machines_never_break_the_loader():
    """Every mutated machine either loads, and moves, or is refused with faults; no other exception (or warning), ever."""
    rng = random.Random(23)
    bases = [dict(load(name).raw) for name in ("six-bar", "shaper", "toggle-press")]
    loaded = refused = analysed = 0
    for k in range(1500):
        raw = copy.deepcopy(bases[k % 3])
        for _ in range(rng.randint(1, 3)):
            mutate(raw, rng)
        try:
            problem = read(raw)
        except InputError as error:
            refused += 1
            assert error.faults
            assert all(fault.remedy and fault.message for fault in error.faults)
            continue
        loaded += 1
        assert all(math.isfinite(q.value) for q in problem.model.quantities.values())
        drive = problem.model.drive
        MotionColumns(machine_of(problem).moving(np.linspace(drive.start.value, drive.start.value + 6.0, 7), drive.speed.value))
        if loaded % 15 == 0:
            try:
                analysis = analyze(problem, points=12)
            except InputError as error:
                assert {fault.key for fault in error.faults} <= {"drive.start", "speed"}
                continue
            analysed += 1
            json.dumps(analysis.to_dict(), allow_nan=False)
    assert loaded > 150
    assert refused > 750
    assert analysed > 7


def test_mutated_bytes_never_break_the_loader(tmp_path):
    """The same for the text of the files: 600 with random bytes changed, cut or doubled."""
    rng = random.Random(29)
    originals = [optlink.shipped()[name].read_bytes() for name in ("six-bar", "shaper", "toggle-press")]
    path = tmp_path / "mutated.toml"
    loaded = 0
    for k in range(600):
        data = bytearray(originals[k % 3])
        for _ in range(rng.randint(1, 5)):
            at, choice = rng.randrange(len(data)), rng.random()
            if choice < 0.5:
                data[at] = rng.randrange(256)
            elif choice < 0.75:
                del data[at : at + rng.randint(1, 40)]
            else:
                data[at:at] = data[at : at + rng.randint(1, 40)]
        path.write_bytes(bytes(data))
        try:
            load(path)
            loaded += 1
        except InputError as error:
            assert "mutated.toml" in str(error)
    assert loaded > 30
