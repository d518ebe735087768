"""The slow and the quick stroke: named with their crank ranges, chosen by `stroke`, never by rounding."""

from __future__ import annotations

import itertools
import json
import math
import tomllib

import numpy as np
import pytest
from typer.testing import CliRunner

import optlink
from optlink.cli.app import app
from optlink.errors import InputError
from optlink.linkage.stroke import LEAST_DIFFERENCE
from optlink.problem.file import ProblemFile, dump, read
from tests.tiers import mostly_slow

SHAPER_PRESS = """
title = "Offset slider-crank press"
gravity = "9.81 m/s^2"
[mechanism.ground]
A = ["0 mm", "0 mm"]
[mechanism.links]
crank = { joints = ["A", "B"], length = "45 mm" }
rod = { joints = ["B", "C"], length = "190 mm" }
ram = { joints = ["C"] }
[mechanism.guides]
G = { slider = "ram", direction = "0 deg", through = "A", offset = "35 mm" }
[mechanism.assembly]
C = "forward"
[bodies]
ram = { mass = "6 kg" }
[loads]
pressing = { on = "ram", force = "3 kN", acts = "opposing", stroke = "forward" }
[drive]
speed = "50 rpm"
"""


def press(**changes: object) -> ProblemFile:
    return read(tomllib.loads(SHAPER_PRESS), "press").override({key.replace("__", "."): value for key, value in changes.items()})


def by_hand(crank: float, rod: float, offset: float) -> tuple[float, float]:
    """Crank angles [rad] at which the slider is farthest and nearest: crank and rod in line."""
    return math.asin(offset / (rod + crank)), math.pi + math.asin(offset / (rod - crank))


@pytest.mark.parametrize(
    ("offset", "sense"), mostly_slow(itertools.product((35.0, -35.0), (1.0, -1.0)), (35.0, 1.0), (-35.0, -1.0))
)
def test_strokes_are_named_with_their_crank_ranges(sense, offset):
    """Dead centres by hand; which stroke is slow changes with the side of the offset and with the sense of the crank."""
    result = optlink.analyze(press(drive__speed=f"{50 * sense} rpm", mechanism__guides__G__offset=f"{offset} mm"), points=720)
    far, near = (math.degrees(at) for at in by_hand(0.045, 0.190, 1e-3 * offset))
    record = json.loads(json.dumps(result.to_dict(), default=list))["strokes"]["ram"]
    turned = sense * (far - near) % 360.0
    assert record["forward"]["crank_rotation_deg"] == pytest.approx(turned, abs=1e-9)
    assert record["forward"]["crank_from_deg"] == pytest.approx(near % 360.0, abs=1e-9)
    assert record["forward"]["crank_to_deg"] == pytest.approx(near % 360.0 + sense * turned, abs=1e-9)
    assert record["backward"]["crank_from_deg"] == pytest.approx(far % 360.0, abs=1e-9)
    assert record["slow_stroke"] == ("forward" if turned > 180.0 else "backward")
    assert (record["working_stroke"], record["working_loads"]) == ("forward", ["pressing"])
    share = float(np.mean(result["ram.v_m_s"][:-1] > 0.0))  # the independent route: how long the ram moves forward
    assert turned == pytest.approx(360.0 * share, abs=0.6)


@pytest.mark.slow
def test_a_load_in_the_quick_stroke_gets_a_note():
    def notes(**changes: object) -> list[str]:
        return [note for note in optlink.analyze(press(**changes)).notes if "quick" in note]

    quick = next(s.name for s in optlink.analyze(press()).strokes["ram"].strokes() if s.pace == "quick")
    slow = {"forward": "backward", "backward": "forward"}[quick]
    assert len(notes(loads__pressing__stroke=quick)) == 1
    assert notes(loads__pressing__stroke=slow) == []
    assert notes(loads__pressing__stroke="quick") == []
    assert notes(loads__pressing__stroke="slow") == []
    assert len(notes(loads__pressing__stroke=slow, drive__speed="-50 rpm")) == 1
    assert notes(loads__pressing__stroke=quick, drive__speed="-50 rpm") == []


@pytest.mark.parametrize("speed", ["50 rpm", "-50 rpm"])
def test_a_load_of_the_slow_stroke_follows_the_sense_of_the_crank(speed):
    result = optlink.analyze(press(loads__pressing__stroke="slow", drive__speed=speed), points=3600)
    acting = np.abs(result["pressing.fx_N"]) > 0.0
    strokes = {stroke.pace: stroke for stroke in result.strokes["ram"].strokes(result.speed)}
    (item,) = result.acting
    assert item.pace == "slow"
    assert item.stroke == strokes["slow"].name
    assert 360.0 * float(np.mean(acting)) == pytest.approx(math.degrees(strokes["slow"].rotation), abs=0.5)


def test_strokes_that_take_equally_long_have_no_slow_one():
    centred = optlink.analyze(press(mechanism__guides__G__offset="0 mm"))
    assert centred.to_dict()["strokes"]["ram"]["slow_stroke"] is None
    assert {stroke.pace for stroke in centred.strokes["ram"].strokes()} == {"equal"}
    with pytest.raises(InputError, match=r"loads.pressing.stroke.*neither stroke is the slow one"):
        press(mechanism__guides__G__offset="0 mm", loads__pressing__stroke="slow")


@pytest.mark.parametrize(("factor", "equal"), [(0.99, True), (1.01, False)])
def test_the_least_difference_of_the_strokes_decides_not_rounding(factor, equal):
    """The offset at which both strokes differ by a little less or more than the documented crank rotation."""
    crank, rod = 0.045, 0.190
    low, high = 0.0, 0.01
    for _ in range(100):
        offset = 0.5 * (low + high)
        far, near = by_hand(crank, rod, offset)
        low, high = (offset, high) if abs(2.0 * (near - far - math.pi)) < factor * LEAST_DIFFERENCE else (low, offset)
    for turned in ("0 deg", "33 deg", "-90 deg"):
        changes = {"mechanism__guides__G__offset": f"{offset!r} m", "mechanism__guides__G__direction": turned}
        result = optlink.analyze(press(**changes))
        assert (result.to_dict()["strokes"]["ram"]["slow_stroke"] is None) is equal
        if equal:
            with pytest.raises(InputError, match="equally long"):
                press(**changes, loads__pressing__stroke="quick")
        else:
            assert press(**changes, loads__pressing__stroke="quick").model.machine().loads


def test_each_design_of_a_batch_has_its_own_slow_stroke():
    """The slow stroke changes with the side of the offset; every row is that of the design alone, none where neither is slow."""
    file, offsets = press(loads__pressing__stroke="slow"), np.array([35.0, -35.0, 0.0, 12.0, -3.0]) * 1e-3
    computed = optlink.analyze_batch(file, {"G.offset": offsets}, points=90)["input.torque_Nm"]
    assert np.all(np.isnan(computed[2]))
    for k in (0, 1, 3, 4):
        alone = optlink.analyze(file, 90, design={"G.offset": float(offsets[k])})["input.torque_Nm"][:-1]
        np.testing.assert_allclose(computed[k], alone, rtol=1e-9, atol=1e-9 * np.max(np.abs(alone)))


def test_solved_linkages_name_their_strokes():
    """A four-bar for a law, its crank turning either way: the swing by the law of cosines, the slow stroke with the sense."""
    result = optlink.solve(optlink.load("crank-rocker"))
    (record,) = (own for name, own in result.to_dict()["strokes"].items() if name == "rocker swings")
    r, a, b, f = (result.design[name] for name in ("crank", "coupler", "rocker", "frame"))

    def at(reach: float) -> float:
        return math.acos((reach**2 + f**2 - b**2) / (2.0 * reach * f))

    theta = math.degrees(at(a - r) - at(a + r))
    turned = sorted((record["forward"]["crank_rotation_deg"], record["backward"]["crank_rotation_deg"]))
    assert turned == pytest.approx([180.0 - abs(theta), 180.0 + abs(theta)], abs=1e-6)
    assert record["slow_stroke"] == max(("forward", "backward"), key=lambda name: record[name]["crank_rotation_deg"])


# --- what the tables show ------------------------------------------------------------------------------------------------------

SIX_BAR = """
title = "Crank-rocker that drives a slide"
[mechanism.ground]
A = ["0 mm", "0 mm"]
D = ["210 mm", "-15 mm"]
[mechanism.links]
crank = { joints = ["A", "B"], length = "60 mm" }
coupler = { joints = ["B", "C"], length = "190 mm" }
rocker = { joints = ["D", "C"], length = "120 mm" }
rod = { joints = ["C", "P"], length = "260 mm" }
ram = { joints = ["P"] }
[mechanism.guides]
G = { slider = "ram", direction = "5 deg", through = "D", offset = "130 mm" }
[mechanism.assembly]
C = "left of B-D"
P = "forward"
[drive]
speed = "50 rpm"
"""


def shown_and_recorded(path, **changes):
    """First words of the rows of both stroke tables, and the JSON document."""
    file = read(tomllib.loads(SIX_BAR), "six-bar").override({key.replace("__", "."): value for key, value in changes.items()})
    path.write_text(dump(file))
    lines = CliRunner().invoke(app, ["analyze", str(path)]).stdout.splitlines()
    tables = [
        next(k for k, line in enumerate(lines) if line.startswith(title)) for title in ("Strokes of", "Working and", "Extremes")
    ]
    computed = [
        [" ".join(line.split()[:2]) for line in lines[a:b] if line.split()[1:2] in (["slides"], ["swings"])]
        for a, b in itertools.pairwise(tables)
    ]
    return *computed, json.loads(CliRunner().invoke(app, ["analyze", str(path), "--json"]).stdout)


@pytest.mark.parametrize(
    ("changes", "outputs"),
    [
        ({}, ["ram slides"]),
        pytest.param(
            {"loads": {"cutting": {"on": "ram", "force": "90 N", "acts": "opposing"}}}, ["ram slides"], marks=pytest.mark.slow
        ),
        ({"loads": {"work": {"on": "rocker", "torque": "9 N*m", "stroke": "forward"}}}, ["rocker swings"]),
        ({"loads": {"a": {"on": "rod", "torque": "9 N*m"}, "b": {"on": "ram", "force": "9 N"}}}, ["rod swings", "ram slides"]),
        pytest.param({"loads": {"a": {"on": "crank", "torque": "9 N*m"}}}, ["ram slides"], marks=pytest.mark.slow),
        ({"loads": {"a": {"on": "rocker", "torsional_stiffness": "2 N*m/rad"}}}, ["ram slides"]),
    ],
)
def test_stroke_tables_show_the_output_first_and_json_keeps_all(tmp_path, changes, outputs):
    """The output: the bodies that forces and torques act on, else the slide at the end; springs and the crank are none."""
    first, second, document = shown_and_recorded(tmp_path / "six-bar.toml", **changes)
    assert first[: len(outputs)] == outputs
    assert sorted(first) == ["coupler swings", "ram slides", "rocker swings", "rod swings"]
    assert second == [name for name in outputs for _ in range(2) if name != "rod swings"]  # which reverses four times
    assert sorted([*document["strokes"], *document["swings"]]) == ["coupler", "ram", "rocker", "rod"]
    assert all(
        "forward" in own for own in (document["strokes"]["ram"], *(document["swings"][name] for name in ("coupler", "rocker")))
    )


def test_work_at_the_end_differs_from_work_at_the_start(tmp_path):
    path = tmp_path / "press.toml"
    path.write_text(dump(press()))
    lines = CliRunner().invoke(app, ["analyze", str(path)]).stdout.splitlines()
    whole, least, largest = (
        next(line.split() for line in lines if line.startswith(word)) for word in ("per rev", "least s", "largest s")
    )
    assert least[-1] == "deg"
    assert largest[4] == whole[2]
    assert largest[-2:] == ["360.0000", "deg"]


@pytest.mark.parametrize(("direction", "share"), [("30 deg", 0.63), ("75 deg", 1.0)])
def test_the_slow_stroke_of_a_force_against_another_body_is_that_of_their_relative_motion(direction, share):
    """A force on the rocker against the crank acts more than half of the time; at 75 deg they never reverse."""
    raw = {
        "mechanism": {"crank": "100 mm", "coupler": "410 mm", "rocker": "230 mm", "frame": "500 mm"},
        "bodies": {"rocker": {"mass": "2 kg", "inertia": "uniform bar"}},
        "loads": {
            "push": {"on": "rocker", "at": "C", "force": "20 N", "direction": direction, "stroke": "slow", "against": "crank"}
        },
    }
    computed = optlink.analyze(optlink.read(raw))
    assert float(np.mean(computed["push.crank.fx_N"] != 0.0)) == pytest.approx(share, abs=0.01)


def test_a_force_that_opposes_the_motion_of_a_pin_against_a_body_of_the_pin_is_refused():
    raw = {
        "mechanism": {"crank": "100 mm", "coupler": "410 mm", "rocker": "230 mm", "frame": "500 mm"},
        "bodies": {"rocker": {"mass": "2 kg", "inertia": "uniform bar"}},
        "loads": {
            "drag": {"on": "crank", "at": "B", "force": "20 N", "direction": "9 deg", "acts": "opposing", "against": "coupler"}
        },
    }
    with pytest.raises(InputError, match="what it opposes does not move in this direction"):
        optlink.read(raw)
