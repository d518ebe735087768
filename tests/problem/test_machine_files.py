"""Problem files of machines: what is wrong is named with file, key, value and remedy; a fuzz never gets past that."""

from __future__ import annotations

import json
import math
import re
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from optlink.cli.app import app
from optlink.dynamics.columns import MotionColumns
from optlink.errors import InputError
from optlink.problem.file import dump, load, read
from optlink.tasks.analyze import analyze
from optlink.tasks.machine import machine_of

ROOT = Path(__file__).parents[2]


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
    assert analysis.valid
    expected_notes = ("joints are treated as ideal", "the motion repeats after 3 revolutions")  # of the planet
    assert [note for note in analysis.notes if not note.startswith(expected_notes)] == []
    assert np.max(np.abs(analysis["input.power_W"])) > 0.0
    expected = problem.model.expected
    for name, value in expected.figures.items() if expected else ():
        assert analysis.figures[name] == pytest.approx(value, rel=expected.figure_tolerance)


def test_the_reference_page_lists_all_keys():
    from optlink.problem.machine.bodies import BodySection, DriveSection
    from optlink.problem.machine.loads import LOADS
    from optlink.problem.mechanism import GuideSection, LinkSection

    assert len(EXAMPLES) >= 5
    loads = [kind.form for kind in LOADS.values()]
    for section in (BodySection, DriveSection, *loads, GuideSection, LinkSection):
        for key in section.model_fields:
            assert f"`{key}`" in PAGE or re.search(rf"\b{key} = ", PAGE), f"{key} of {section.__name__} is not documented"
    told = {key for example in EXAMPLES for own in tomllib.loads(example).get("loads", {}).values() for key in own}
    assert {key for load in loads for key in load.model_fields} <= told


# --- fuzz ---------------------------------------------------------------------------------------------------------------------
