"""Change points: positions in which the assembly modes of a group meet, named where the motion beyond them is not determined."""

from __future__ import annotations

import itertools
import json
import math

import numpy as np
import pytest
from typer.testing import CliRunner

import optlink
from optlink.cli import app
from optlink.design.files import dump
from optlink.linkage.cycle import reachable
from optlink.linkage.fourbar import four_bar

LENGTHS = ("crank", "coupler", "rocker", "frame")
runner = CliRunner()


def four_bar_problem(lengths, unit="mm", assembly="left", start="20 deg", **more):
    raw = {
        "title": "four-bar with a change point",
        "gravity": "9.81 m/s^2",
        "mechanism": {
            "type": "four-bar",
            **{name: f"{length!r} {unit}" for name, length in zip(LENGTHS, lengths, strict=True)},
            "assembly": assembly,
        },
        "bodies": {"coupler": {"mass": "2 kg", "inertia": "uniform bar"}, "rocker": {"mass": "1 kg", "inertia": "uniform bar"}},
        "drive": {"start": start, "speed": "2 rad/s"},
    }
    return optlink.read({**raw, **more})


def collinear(crank, coupler, rocker, frame):
    """Crank angles [deg] at which all four links lie on one line: there the distance of B and D is a sum or difference."""
    found = []
    for angle, distance in ((0.0, abs(frame - crank)), (180.0, frame + crank)):
        if min(abs(distance - (coupler + rocker)), abs(distance - abs(coupler - rocker))) < 1e-9 * frame:
            found.append(angle)
    return found


def drawn_change_points(count, seed):
    """Random lengths whose longest and shortest sum to the other two, in any order; parallelograms and kites among them."""
    rng = np.random.default_rng(seed)
    for k in range(count):
        short, one, other = np.sort(rng.uniform(20.0, 200.0, 3))
        four = [short, one, other, one + other - short]
        if k % 5 == 0:
            four = [one, other, one, other]  # parallelogram
        if k % 5 == 1:
            four = [one, other, other, one] if k % 2 else [one, one, other, other]  # kites
        else:
            four = [four[i] for i in rng.permutation(4)] if k % 5 else four
        yield [float(length) for length in four]


@pytest.mark.parametrize("lengths", list(drawn_change_points(25, 7)))
@pytest.mark.parametrize("scale", [1.0, 0.0254, 10.0 / 3.0])
def test_change_points_are_found_at_collinear_links_whatever_the_rounding(lengths, scale):
    sizes = dict(zip(LENGTHS, (scale * length for length in lengths), strict=True))
    ranges = reachable(four_bar(1), sizes)
    found = [math.degrees(p.crank_angle) for p in ranges.singular]
    expected = [at for at in collinear(*lengths) if ranges.holding(math.radians(at))]
    assert found == pytest.approx(expected, abs=1e-9)
    assert found
    crank, coupler, rocker, frame = lengths
    turns = all(abs(coupler - rocker) <= d + 1e-9 and d <= coupler + rocker + 1e-9 for d in (abs(frame - crank), frame + crank))
    assert ranges.full == turns


@pytest.mark.parametrize(
    ("lengths", "unit", "angles"),
    [
        ((5.0, 2.0, 4.0, 3.0), "in", [0.0]),
        ((60.0, 150.0, 60.0, 150.0), "mm", [0.0, 180.0]),
        ((70.0, 30.0, 70.0, 30.0), "mm", [0.0, 180.0]),
    ],
)
@pytest.mark.parametrize("start", ["20.5 deg", "-77 deg"])
def test_motion_that_is_not_determined_is_not_sound(tmp_path, lengths, unit, angles, start):
    problem = four_bar_problem(lengths, unit, start=start)
    result = optlink.analyze(problem, points=77)
    assert not result.sound
    assert result.status != "analysed"
    assert not result.extremes
    assert not result.swings
    assert not result.strokes
    assert math.isnan(result.work)
    assert np.sort(np.degrees(result.singular) % 360.0) == pytest.approx(angles, abs=1e-9)
    assert result.figures == {}
    path = tmp_path / "problem.toml"
    path.write_text(dump(problem))
    done = runner.invoke(app, ["analyze", str(path), "--json"])
    document = json.loads(done.stdout)
    assert done.exit_code == 1
    assert [p["crank_angle_deg"] for p in document["singular_positions"]] == pytest.approx(angles, abs=1e-9)
    done = runner.invoke(app, ["analyze", str(path)])
    assert done.exit_code == 1
    for angle in angles:
        assert f"{angle:g} deg" in " ".join(done.stdout.split())
    assert "Extremes" not in done.stdout


@pytest.mark.parametrize("lengths", [(100.0, 300.0, 200.0, 400.0 * (1.0 - 1e-4)), (100.0, 300.0 * (1.0 + 1e-5), 200.0, 400.0)])
def test_near_change_points_are_sound_and_name_the_peak(lengths):
    result = optlink.analyze(four_bar_problem(lengths, start="20.5 deg"))
    crank, coupler, rocker, frame = lengths
    reach = frame + crank
    angle = math.degrees(math.acos((coupler**2 + rocker**2 - reach**2) / (2.0 * coupler * rocker)))
    assert result.sound
    assert "C.f_N" in result.extremes
    assert any(f"at crank angle 180 deg the transmission angle at C is {angle:.6g} deg" in note for note in result.notes)


def test_crank_that_misses_a_thousandth_of_a_degree_between_rows_does_not_turn_fully():
    """The frame is 1e-10 too long: still a change point; 1e-7 too long: 0.01 deg of the turn is missing, between two rows."""
    sizes = {"crank": 1.0, "coupler": 3.0, "rocker": 2.0}
    assert reachable(four_bar(1), {**sizes, "frame": 4.0 + 1e-11}).full
    missed = reachable(four_bar(1), {**sizes, "frame": 4.0 + 1e-7})
    assert not missed.full
    ((low, high),) = missed.ranges
    expected = math.acos(((3.0 + 2.0) ** 2 - 1.0 - (4.0 + 1e-7) ** 2) / (-2.0 * (4.0 + 1e-7)))
    assert (math.degrees(low) - 180.0) == pytest.approx(180.0 - math.degrees(expected), rel=1e-6)
    assert high - low < 2.0 * math.pi


def slider_crank_problem(crank, rod, offset, **more):
    raw = {
        "title": "slider-crank",
        "mechanism": {
            "type": "dyads",
            "ground": {"A": ["10 mm", "-20 mm"]},
            "links": {
                "crank": {"joints": ["A", "B"], "length": f"{crank!r} mm"},
                "rod": {"joints": ["B", "C"], "length": f"{rod!r} mm"},
                "slider": {"joints": ["C"]},
            },
            "guides": {"F": {"slider": "slider", "through": "A", "offset": f"{offset!r} mm", "direction": "17 deg"}},
            "assembly": {"C": "forward"},
        },
        "bodies": {"slider": {"mass": "3 kg"}},
        "drive": {"start": "30 deg"},
    }
    return optlink.read({**raw, **more})


@pytest.mark.parametrize(
    ("crank", "rod", "offset", "angles"),
    [(80.0, 80.0, 0.0, (107.0, 287.0)), (50.0, 70.0, 20.0, (287.0,)), (50.0, 70.0, -20.0, (107.0,))],
)
def test_slider_cranks_whose_rod_stands_across_the_guide_are_singular(crank, rod, offset, angles):
    """The rod is at a right angle to the guide where crank and offset together are as long as the rod."""
    result = optlink.analyze(slider_crank_problem(crank, rod, offset), points=50)
    assert not result.sound
    assert np.degrees(result.singular) % 360.0 == pytest.approx(angles, abs=1e-9)


@pytest.mark.parametrize(
    ("crank", "offset", "singular"), [(90.0, 0.0, True), (89.9, 0.0, False), (60.0, 30.0, True), (60.0, 29.9, False)]
)
def test_guides_through_a_pin_are_singular_where_the_pins_are_as_near_as_the_offset(crank, offset, singular):
    """Crank and frame of one length: the pin of the slider passes the pivot of the arm; with an offset it comes that near."""
    raw = {
        "title": "arm on a slider",
        "mechanism": {
            "type": "dyads",
            "ground": {"A": ["0 mm", "0 mm"], "D": ["90 mm", "0 mm"]},
            "links": {
                "crank": {"joints": ["A", "B"], "length": f"{crank!r} mm"},
                "block": {"joints": ["B"]},
                "arm": {"joints": ["D", "E"], "length": "300 mm"},
            },
            "guides": {"G": {"slider": "block", "on": "arm", "through": "D", "offset": f"{offset!r} mm"}},
            "assembly": {"G": "forward"},
        },
        "bodies": {"arm": {"mass": "2 kg", "inertia": "uniform bar"}},
        "drive": {"start": "100 deg"},
    }
    result = optlink.analyze(optlink.read(raw), points=90)
    assert result.sound != singular
    assert list(np.degrees(result.singular) % 360.0) == ([0.0] if singular else [])


def test_every_permutation_of_four_one_three_two_is_judged():
    for lengths in itertools.permutations((4.0, 1.0, 3.0, 2.0)):
        ranges = reachable(four_bar(-1), dict(zip(LENGTHS, lengths, strict=True)))
        assert ranges.singular, lengths
