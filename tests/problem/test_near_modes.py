"""Assembly modes given by the place of a joint: `near [12 mm, 40 mm]`."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest
from typer.testing import CliRunner

import optlink
from optlink.cli.app import app
from optlink.problem.file import dump

runner = CliRunner()


def circles(p, q, a, b):
    """Both intersections of two circles, that to the left of p -> q first: the angle at p by the law of cosines."""
    along, towards = math.dist(p, q), math.atan2(q[1] - p[1], q[0] - p[0])
    turn = math.acos((along**2 + a**2 - b**2) / (2.0 * along * a))
    return [(p[0] + a * math.cos(towards + s * turn), p[1] + a * math.sin(towards + s * turn)) for s in (1.0, -1.0)]


def near(place, shift=(0.0, 0.0), follow=False):
    x, y = (1e3 * (c + d) for c, d in zip(place, shift, strict=True))
    return f"near [{x:.7g} mm, {y:.7g} mm]" + (", continue" if follow else "")


def drawn(seed):
    """A six-bar: crank, two-link group at C, rod and slider at E on a line through the origin; with both places of C and of E."""
    rng = np.random.default_rng([5, seed])
    start, tilt = rng.uniform(-3.0, 3.0, 2)
    crank, coupler, rocker = rng.uniform(0.02, 0.04), rng.uniform(0.09, 0.12), rng.uniform(0.07, 0.1)
    ground = (rng.uniform(0.07, 0.09), rng.uniform(-0.02, 0.02))
    joint = (crank * math.cos(start), crank * math.sin(start))
    places = circles(joint, ground, coupler, rocker)
    rod = 0.3

    def raw(modes):
        return {
            "title": "six-bar",
            "mechanism": {
                "ground": {"A": ["0 mm", "0 mm"], "D": [f"{ground[0]!r} m", f"{ground[1]!r} m"]},
                "links": {
                    "crank": {"joints": ["A", "B"], "length": f"{crank!r} m"},
                    "coupler": {"joints": ["B", "C"], "length": f"{coupler!r} m"},
                    "rocker": {"joints": ["D", "C"], "length": f"{rocker!r} m"},
                    "rod": {"joints": ["C", "E"], "length": f"{rod!r} m"},
                    "slider": {"joints": ["E"]},
                },
                "guides": {"F": {"slider": "slider", "through": "A", "direction": f"{math.degrees(tilt)!r} deg"}},
                "assembly": modes,
            },
            "drive": {"start": f"{math.degrees(start)!r} deg"},
        }

    def of_slider(c):
        way = (math.cos(tilt), math.sin(tilt))
        along, across = c[0] * way[0] + c[1] * way[1], way[0] * c[1] - way[1] * c[0]
        reach = math.sqrt(rod**2 - across**2)
        return [((along + s * reach) * way[0], (along + s * reach) * way[1]) for s in (1.0, -1.0)]

    return raw, places, of_slider


@pytest.mark.parametrize("seed", range(12))
def test_the_mode_is_that_of_the_nearest_position(seed):
    raw, places, of_slider = drawn(seed)
    for i, side in enumerate(("left", "right")):
        for k, way in enumerate(("forward", "backward")):
            e = of_slider(places[i])
            rng = np.random.default_rng([seed, i, k])
            shifts = []
            for both in (places, e):
                angle, size = rng.uniform(0.0, 6.0), rng.uniform(0.0, 0.24) * math.dist(*both)
                shifts.append((size * math.cos(angle), size * math.sin(angle)))
            stated = optlink.read(raw({"C": f"{side} of B-D", "E": way}))
            placed = optlink.read(raw({"C": near(places[i], shifts[0]), "E": near(e[k], shifts[1])}))
            assert placed.model.mechanism.assembly == stated.model.mechanism.assembly
            one, other = (optlink.analyze(problem, points=24) for problem in (stated, placed))
            assert np.array_equal(one["E.x_m"], other["E.x_m"])
            assert math.dist((one["C.x_m"][0], one["C.y_m"][0]), places[i]) < 1e-12


@pytest.mark.parametrize("side", ["left", "right"])
@pytest.mark.parametrize("follow", [False, True])
def test_a_four_bar_takes_a_place_too(side, follow, tmp_path):
    lengths, start = (0.03, 0.11, 0.08, 0.1), math.radians(-70.0)
    joint = (lengths[0] * math.cos(start), lengths[0] * math.sin(start))
    place = circles(joint, (lengths[3], 0.0), lengths[1], lengths[2])[side == "right"]
    names = ("crank", "coupler", "rocker", "frame")
    raw = {
        "title": "four-bar",
        "mechanism": {
            **{n: f"{1e3 * v!r} mm" for n, v in zip(names, lengths, strict=True)},
            "assembly": near(place, (2e-3, 1e-3), follow),
        },
        "drive": {"start": "-70 deg"},
    }
    problem = optlink.read(raw)
    assert problem.model.mechanism.assembly == (f"{side}, continue" if follow else side)
    result = optlink.analyze(problem, points=12)
    assert math.dist((result["C.x_m"][0], result["C.y_m"][0]), place) < 1e-12
    path = tmp_path / "four-bar.toml"
    path.write_text(dump(problem))
    again = optlink.load(path)
    assert again.raw["mechanism"]["assembly"] == raw["mechanism"]["assembly"]
    assert again.hash == problem.hash
    shown = runner.invoke(app, ["show", str(path)])
    assert f"{problem.model.mechanism.assembly} ({raw['mechanism']['assembly']})" in " ".join(shown.stdout.split())
    drawing = tmp_path / "four-bar.svg"
    assert runner.invoke(app, ["export", str(path), "--out", str(drawing)]).exit_code == 0
    assert drawing.stat().st_size > 0
    run = optlink.simulate(problem, duration=0.1, rows=4)
    assert math.dist((run["C.x_m"][0], run["C.y_m"][0]), place) < 1e-12


def test_a_place_near_neither_names_both_positions():
    raw, places, _ = drawn(3)
    middle = tuple(0.5 * (a + b) for a, b in zip(*places, strict=True))
    with pytest.raises(optlink.InputError) as error:
        optlink.read(raw({"C": near(middle), "E": "forward"}))
    fault = error.value.faults[0]
    assert fault.key == "mechanism.assembly.C"
    offered = re.findall(r'"(near [^"]*)"', fault.remedy)
    assert len(offered) == 2
    for k, words in enumerate(offered):
        problem = optlink.read(raw({"C": words, "E": "forward"}))
        result = optlink.analyze(problem, points=4)
        assert math.dist((result["C.x_m"][0], result["C.y_m"][0]), places[k]) < 1e-9
        x, y = (float(number) for number in re.findall(r"(-?[\d.]+) mm", words))
        assert math.dist((x, y), [1e3 * c for c in places[k]]) < 1e-3
        assert f"[{x:.6g} mm, {y:.6g} mm]" in fault.message


def test_a_place_where_the_group_cannot_be_assembled_or_of_a_guide_is_refused():
    with pytest.raises(optlink.InputError, match=r"C has no position where the drive starts \(crank angle 180 deg\)"):
        optlink.read(
            {
                "mechanism": {
                    "crank": "60 mm",
                    "coupler": "50 mm",
                    "rocker": "50 mm",
                    "frame": "60 mm",
                    "assembly": "near [1 mm, 2 mm]",
                },
                "drive": {"start": "180 deg"},
            }
        )
    with pytest.raises(optlink.InputError, match="this is a guide") as error:
        optlink.load("shaper", {"mechanism.assembly.G": "near [1 mm, 2 mm]"})
    assert '"forward" or "backward"' in str(error.value)


@pytest.mark.slow
def test_a_design_takes_the_mode_of_its_start_and_states_it():
    """The law of the crank-rocker is left: its place at the starting values, in place of the word, gives the same design."""
    problem = optlink.load("crank-rocker")
    size = {name: problem.model.quantities[name].value for name in ("crank", "coupler", "rocker", "frame")}
    places = circles((size["crank"], 0.0), (size["frame"], 0.0), size["coupler"], size["rocker"])
    for side, place in zip(("left", "right"), places, strict=True):
        placed = problem.override({"mechanism.assembly": near(place)})
        assert [variant.raw["mechanism"]["assembly"] for variant in placed.variants()] == [side]
    stated = optlink.solve(problem.override({"mechanism.assembly": "left"}), starts=6)
    found = optlink.solve(problem.override({"mechanism.assembly": near(places[0])}), starts=6)
    assert found.assembly == stated.assembly == "left"
    assert found.design == stated.design


def test_an_open_assembly_mode_is_analysed_in_the_first_and_named():
    """It was taken silently."""
    raw = {"crank": "40 mm", "coupler": "120 mm", "rocker": "80 mm", "frame": "120 mm"}
    left, right, either = (
        optlink.analyze(optlink.read({"title": "A crank-rocker", "mechanism": {**raw, "assembly": mode}}))
        for mode in ("left", "right", "either")
    )
    assert [note for note in left.notes if "assembly" in note] == []
    assert [note for note in either.notes if "assembly" in note] == [
        'the assembly mode "either" is left open; analysed is mechanism.assembly = "left": state the mode of the machine'
    ]
    assert either["rocker.angle_rad"] == pytest.approx(left["rocker.angle_rad"])
    assert either["rocker.angle_rad"] != pytest.approx(right["rocker.angle_rad"])
