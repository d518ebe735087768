"""All exact solutions of problems with five targets: known linkages, reasons, the search that begins with them, the command."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import optlink
from optlink.cli.app import app
from optlink.linkage import four_bar, sweep
from optlink.presentation.report_model import report_model_of
from optlink.presentation.views import conclusions
from optlink.tasks.exact import given_pivots, poses_and_points
from tests.synthesis.test_five_poses import cranked

POSES = Path(__file__).parents[1] / "data" / "five-poses"
MIXED = Path(__file__).parents[1] / "data" / "poses-and-points" / "four-and-two.toml"
LENGTHS = {name: {"bounds": ["1 mm", "20 m"]} for name in ("crank", "coupler", "rocker", "frame")}
PLACED = {
    "type": "four-bar",
    **LENGTHS,
    "points": {"P": [{"bounds": ["-20 m", "20 m"]}] * 2},
    "pivot": [{"bounds": ["-20 m", "20 m"]}] * 2,
    "direction": {"bounds": ["-180 deg", "180 deg"]},
    "assembly": "either",
}


@pytest.mark.parametrize(("name", "angles"), [("known-0", [61.46, 27.49, 21.13, 20.75]), ("known-4", [39.18, 35.36, 15.74])])
def test_every_usable_four_bar_of_five_poses_is_listed(name, angles):
    result = optlink.synthesis.exact(POSES / f"{name}.toml")
    assert result.exact_solutions.certified == 4
    assert result.exact_solutions.usable == len(angles)
    assert [math.degrees(design.least_transmission) for design in result.designs] == pytest.approx(angles, abs=0.006)
    assert all(design.valid and design.exact for design in result.designs)
    assert result.valid


def test_six_four_bars_without_a_usable_one_have_their_defects():
    result = optlink.synthesis.exact(POSES / "all-real.toml")
    found = result.exact_solutions
    assert len(found.solutions) == 12  # six, driven at either link
    assert {reason for one in found.solutions for reason in one.reasons} == {"circuit", "branch", "order"}
    assert all(one.reasons for one in found.solutions)
    assert not result.valid
    model = report_model_of(result)
    assert (model.verdict, model.unmoved) == ("No feasible design found", "none of the exact solutions is usable")
    assert conclusions.design(result, ()) == "None of the 12 four-bars that meet the targets exactly is usable."
    counts = {name: sum(name in one.reasons for one in found.solutions) for name in ("branch", "circuit", "order")}
    assert counts == found.reasons
    told = ", ".join(f"{count} × {name}" for name, count in found.reasons.items())
    assert (
        f"6 four-bars, 12 with either link as the crank, 0 usable; reasons of the others (some have several): {told}"
        in result.notes[0]
    )


def test_limits_and_bounds_are_reasons():
    file = optlink.load(POSES / "known-0.toml")
    tight = optlink.synthesis.exact(file.override({"mechanism.rocker.bounds": ["2 mm", "100 mm"]}))
    assert tight.exact_solutions.usable == 2
    outside = sum(
        one.values["rocker"] > 0.1 and not {"branch", "order", "circuit"} & {*one.reasons}
        for one in tight.exact_solutions.solutions
    )
    assert tight.exact_solutions.reasons["outside your bounds (rocker 2 ... 100 mm)"] == outside > 0
    assert any(
        one.reasons == ("outside your bounds: rocker 210.2 mm, allowed 2 ... 100",) for one in tight.exact_solutions.solutions
    )
    strict = optlink.synthesis.exact(file.override({"limits.transmission_angle": ["45 deg", "135 deg"]}))
    assert strict.exact_solutions.usable == 1
    reasons = [reason for one in strict.exact_solutions.solutions for reason in one.reasons]
    assert sum(reason.startswith("smallest transmission angle: 27.49 deg") for reason in reasons) == 1
    left = optlink.synthesis.exact(file.override({"mechanism.assembly": "left"}))
    assert left.exact_solutions.usable == 2
    assert sum('assembly: it needs "right"' in one.reasons for one in left.exact_solutions.solutions) > 1
    ways = [optlink.synthesis.exact(file.override({"requirement.rotation": way})) for way in ("clockwise", "counter-clockwise")]
    assert sum(one.exact_solutions.usable for one in ways) == 4
    assert any(one.reasons == ("rotation: the crank does not turn clockwise",) for one in ways[0].exact_solutions.solutions)


def test_a_crank_that_turns_in_another_inversion_is_told():
    file = optlink.load("motion-5-poses").override({"limits.crank": "double-crank"})
    reasons = {reason for one in optlink.synthesis.exact(file).exact_solutions.solutions for reason in one.reasons}
    assert "crank: turns fully, but it is that of a crank-rocker; a double-crank is required" in reasons
    assert "crank: does not turn fully (triple-rocker (non-Grashof))" in reasons


def test_a_search_begins_with_the_exact_solutions(tmp_path):
    result = optlink.solve(optlink.load(POSES / "known-0.toml"), designs=4)
    assert [math.degrees(design.least_transmission) for design in result.designs] == pytest.approx(
        [61.46, 27.49, 21.13, 20.75], abs=0.006
    )
    assert result.starts == 4
    assert result.evidence is None
    stored = tmp_path / "result.json"
    stored.write_text(json.dumps(result.to_dict()), encoding="utf-8")
    assert optlink.read_result(stored).exact_solutions == result.exact_solutions


def test_a_search_for_the_least_size_begins_with_the_exact_solutions():
    """Its own starts find no four-bar within a micrometre of the poses."""
    file = optlink.load(POSES / "known-0.toml")
    small = file.override({"objective": {"quantity": "total length"}, "requirement.tolerance": "1 um"})
    result = optlink.solve(small, starts=4)
    least = min(figures(optlink.synthesis.exact(file, by="total length")))
    assert result.valid
    assert 1e3 * result.objective < least + 1e-6


def test_fewer_designs_than_asked_for_have_a_reason():
    result = optlink.solve(optlink.load(POSES / "known-0.toml"), designs=12)
    assert "12 designs asked for, 4 found: the search ended because they are all exact ones within the limits" in result.notes
    few = optlink.solve("path-scott-russell", designs=50, starts=10)
    assert any(note.startswith("50 designs asked for") and "starts asked for" in note for note in few.notes)


def test_a_file_may_want_exact_designs_alone():
    file = optlink.load(POSES / "known-0.toml").override({"requirement.exact": True})
    result = optlink.solve(file)
    assert (result.backend, result.starts, len(result.designs)) == ("none", 0, 4)
    with pytest.raises(optlink.InputError, match="no list of exact solutions of 3 poses"):
        optlink.solve(optlink.load("motion-3-poses").override({"requirement.exact": True}))


def figures(result):
    return [one.figure for one in result.exact_solutions.solutions if one.usable]


def test_any_quantity_ranks_them(tmp_path):
    """The total length against the sums of the sizes; the stroke of the rocker against steps through a revolution."""
    file = optlink.load(POSES / "known-0.toml")
    short = optlink.synthesis.exact(file, by="total length")
    sums = [1e3 * sum(design.values[name] for name in ("crank", "coupler", "rocker", "frame")) for design in short.designs]
    assert sums == sorted(sums)
    assert figures(short) == pytest.approx(sums, rel=1e-12)
    assert (short.exact_solutions.ranked_by, short.exact_solutions.unit) == ("total length of the links", "mm")
    wide = optlink.synthesis.exact(file, by="maximise stroke of rocker")
    strokes = []
    for design in wide.designs:
        turned = optlink.motion(design.machine, crank_angle=np.linspace(0.0, math.tau, 7201)).body_angle("rocker").value
        strokes.append(math.degrees(np.ptp(np.unwrap(turned))))
    assert strokes == sorted(strokes, reverse=True)
    assert figures(wide) == pytest.approx(strokes, abs=1e-4)
    stored = tmp_path / "result.json"
    stored.write_text(json.dumps(wide.to_dict()), encoding="utf-8")
    assert optlink.read_result(stored).exact_solutions == wide.exact_solutions
    assert json.loads(stored.read_text())["exact_solutions"]["ranked_by"] == "stroke of rocker"


def test_the_objective_of_the_file_ranks_them():
    file = optlink.load(POSES / "known-0.toml")
    asked = {"objective": {"quantity": "total length"}, "requirement.tolerance": "1 um", "requirement.exact": True}
    stated = optlink.solve(file.override(asked))
    assert figures(stated) == pytest.approx(figures(optlink.synthesis.exact(file, by="total length")), rel=1e-9)
    weighted = {"terms": [{"quantity": "total length", "scale": "1 m"}, {"quantity": "length", "of": "crank", "scale": "10 mm"}]}
    summed = optlink.synthesis.exact(file.override({"objective": weighted, "requirement.weight": 1.0}))
    assert summed.exact_solutions.ranked_by == "objective"
    names = ("crank", "coupler", "rocker", "frame")
    sums = [sum(one.values[name] for name in names) + 100.0 * one.values["crank"] for one in summed.designs]
    assert sums == sorted(sums)
    assert figures(summed) == pytest.approx(sums, rel=1e-9)


@pytest.mark.parametrize(
    ("by", "cause"),
    [("sugar", "not a quantity of the machine"), ("acceleration of Q", "no moving body"), ("least transmission angle", "joint")],
)
def test_an_unknown_quantity_is_told(by, cause):
    with pytest.raises(optlink.InputError, match=cause):
        optlink.synthesis.exact("motion-5-poses", by=by)


def motion_of(sizes, phi, side):
    """Rocker angles [rad] and points P of a four-bar with frame 1, and its point at 0.4 along and 0.3 across."""
    names = dict(zip(("crank", "coupler", "rocker"), sizes, strict=True)) | {"frame": 1.0, "P.along": 0.4, "P.across": 0.3}
    moved = sweep(four_bar(side=side, points=["P"]), names, phi)
    return np.unwrap(moved.body_angle("rocker").value), moved.position("P")


@pytest.mark.parametrize("seed", range(4))
def test_a_function_of_five_points_has_its_four_bar(seed):
    sizes, phi, *_ = cranked(np.random.default_rng(seed))
    psi, _ = motion_of(sizes, phi, 1)
    table = {
        "phi": [f"{math.degrees(x)!r} deg" for x in (phi - phi[0]).tolist()],
        "psi": [f"{math.degrees(y)!r} deg" for y in (psi - psi[0]).tolist()],
    }
    raw = {
        "title": "five points",
        "mechanism": {"type": "four-bar", **LENGTHS, "frame": "100 mm", "assembly": "either"},
        "requirement": {
            "kind": "function",
            "law": table,
            "from": {"bounds": ["-360 deg", "360 deg"]},
            "psi0": {"bounds": ["-360 deg", "360 deg"]},
        },
        "limits": {"transmission_angle": ["0.1 deg", "179.9 deg"], "alignment": "0.1 deg"},
    }
    result = optlink.synthesis.exact(optlink.read(raw))
    assert len(result.exact_solutions.solutions) in (1, 3)
    found = [[10.0 * design.values[name] for name in ("crank", "coupler", "rocker")] for design in result.designs]
    assert any(np.allclose(one, sizes, rtol=1e-6) for one in found)
    assert all(design.exact for design in result.designs)


@pytest.mark.parametrize("seed", range(4))
def test_a_slide_of_five_points_has_its_slider_crank(seed):
    """The guide is turned by 40 deg; the known linkage moves by formulas of this test."""
    rng = np.random.default_rng(seed)
    a, b, offset, forward = rng.uniform(0.02, 0.06), rng.uniform(0.1, 0.2), rng.uniform(-0.03, 0.03), seed % 2 == 0
    phi = rng.uniform(0.0, math.tau) + np.cumsum(rng.uniform(0.2, 0.7, 5))
    slide = a * np.cos(phi) + (1.0 if forward else -1.0) * np.sqrt(b * b - (offset - a * np.sin(phi)) ** 2)
    table = {
        "phi": [f"{math.degrees(x)!r} deg" for x in (phi - phi[0]).tolist()],
        "s": [f"{s!r} m" for s in (slide - slide[0]).tolist()],
    }
    raw = {
        "title": "five points of a slide",
        "mechanism": {
            "type": "dyads",
            "ground": {"A": ["3 mm", "-2 mm"]},
            "links": {
                "crank": {"joints": ["A", "B"], "length": LENGTHS["crank"]},
                "rod": {"joints": ["C", "B"], "length": LENGTHS["crank"]},
                "slider": {"joints": ["C"]},
            },
            "guides": {
                "G": {
                    "slider": "slider",
                    "through": "A",
                    "direction": "40 deg",
                    "offset": {"bounds": ["-20 m", "20 m"]},
                }
            },
            "assembly": {"C": "either"},
        },
        "requirement": {
            "kind": "function",
            "law": table,
            "output": "G",
            "start": {"bounds": ["-360 deg", "360 deg"]},
            "zero": {"bounds": ["-20 m", "20 m"]},
        },
        "limits": {"alignment": "0.1 deg"},
    }
    result = optlink.synthesis.exact(optlink.read(raw))
    names = ("crank.length", "rod.length", "G.offset", "start", "zero")
    found = [[design.values[name] for name in names] for design in result.designs]
    start = (phi[0] + math.radians(40.0)) % math.tau
    known = [[a, b, offset, start - turn, slide[0]] for turn in (0.0, math.tau)]
    assert any(np.allclose(one, each, atol=1e-6) for one in found for each in known)
    assert all(design.exact and design.valid for design in result.designs)
    assert "slider-crank" in result.notes[0]
    assert result.exact_solutions.sliders == 1


@pytest.mark.parametrize("seed", range(3))
def test_five_timed_points_have_their_four_bar(seed):
    rng = np.random.default_rng(seed)
    sizes, phi, *_ = cranked(rng)
    shift, turned = rng.normal(0.0, 1.0, 2), np.exp(1j * rng.uniform(-3.0, 3.0))
    _, points = motion_of(sizes, phi, -1)
    z = (points[:, 0] + 1j * points[:, 1]) * turned + complex(*shift)
    rows = [
        {"x": f"{w.real!r} m", "y": f"{w.imag!r} m", "crank": f"{math.degrees(at)!r} deg"}
        for w, at in zip(z.tolist(), (phi - phi[0]).tolist(), strict=True)
    ]
    raw = {
        "title": "five timed points",
        "mechanism": PLACED,
        "requirement": {"kind": "path", "timing": "from start", "points": rows},
        "limits": {"transmission_angle": ["0.1 deg", "179.9 deg"], "alignment": "0.1 deg"},
    }
    result = optlink.synthesis.exact(optlink.read(raw))
    found = [[design.values[name] for name in ("crank", "coupler", "rocker", "frame")] for design in result.designs]
    assert any(np.allclose(one, [*sizes, 1.0], rtol=1e-5) for one in found)
    assert all(design.exact for design in result.designs)


@pytest.mark.slow
def test_nine_points_of_a_crank_rocker_list_it_and_tell_why_others_are_no_use():
    sizes, *_ = cranked(np.random.default_rng(0))
    phi = np.linspace(0.0, 5.5, 9)
    _, points = motion_of(sizes, phi, -1)
    rows = [{"x": f"{float(x)!r} m", "y": f"{float(y)!r} m"} for x, y in points[:, :2]]
    raw = {
        "title": "nine points",
        "mechanism": PLACED,
        "requirement": {"kind": "path", "points": rows},
        "limits": {"transmission_angle": ["0.1 deg", "179.9 deg"], "alignment": "0.1 deg"},
    }
    result = optlink.synthesis.exact(optlink.read(raw))
    found = result.exact_solutions
    assert found.roots == 1442
    assert found.complete
    assert len(found.solutions) == 6 * found.real
    assert found.usable == len(result.designs)
    lengths = [[design.values[name] for name in ("crank", "coupler", "rocker", "frame")] for design in result.designs]
    assert any(np.allclose(one, [*sizes, 1.0], rtol=1e-6) for one in lengths)
    assert all(design.exact and design.valid for design in result.designs)
    reasons = {reason.partition(":")[0] for one in found.solutions for reason in one.reasons}
    assert {"circuit", "order"} <= reasons
    assert f"of 1442 triples of cognates are real (certified); {3 * found.real} four-bars" in found.sentence


def test_poses_and_points_have_their_four_bar():
    """Points among the poses have any angle."""
    result = optlink.synthesis.exact(optlink.load(MIXED))
    found = result.exact_solutions
    assert (found.roots, found.complete, found.usable) == (30, True, 1)
    assert len(found.solutions) == 2 * found.real > 2
    assert found.sentence.startswith("four poses and two points: 8 of 30 four-bars are real (certified); 8 four-bars, 16 with")
    check_mixed(result.best)


@pytest.mark.slow
def test_a_search_meets_poses_and_points():
    check_mixed(optlink.solve(optlink.load(MIXED), starts=60).best)


def check_mixed(design):
    """Check that a design is the four-bar that the poses and points come from."""
    assert design.valid
    assert design.exact
    lengths = [design.values[name] for name in ("crank", "coupler", "rocker", "frame", "P.along", "P.across")]
    assert lengths == pytest.approx([0.06, 0.15, 0.12, 0.17, 0.07, 0.06], rel=1e-6)
    assert np.max(np.abs(design.measured.turned)) < 1e-9
    assert np.isfinite(design.points["turned_deg"]).tolist() == [True, False, True, True, False, True]


@pytest.mark.parametrize("first", [0, 1])
def test_poses_and_points_in_any_order_are_the_same(first):
    """The first target may be a point; the pose that comes first among the others then counts."""
    raw = dict(optlink.load(MIXED).raw)
    rows = raw["requirement"]["points"]
    turned = [*rows[first:], *rows[:first]]
    found = optlink.synthesis.exact(optlink.read({**raw, "requirement": {**raw["requirement"], "points": turned}}))
    assert found.exact_solutions.usable == 1
    assert found.best.values["mark"] == pytest.approx(0.0, abs=1e-6)
    assert found.best.values["crank"] == pytest.approx(0.06, rel=1e-6)


def test_five_points_between_given_pivots_have_their_four_bar():
    raw = dict(optlink.load(MIXED).raw)
    fixed = {"frame": "170 mm", "pivot": ["0 mm", "0 mm"], "direction": "0 deg"}
    rows = [{axis: row[axis] for axis in "xy"} for row in raw["requirement"]["points"][:5]]
    path = {"kind": "path", "point": "P", "points": rows}
    result = optlink.synthesis.exact(optlink.read({**raw, "mechanism": {**raw["mechanism"], **fixed}, "requirement": path}))
    found = result.exact_solutions
    assert (found.roots, found.complete, found.either) == (36, True, False)
    assert len(found.solutions) == found.real
    assert any(design.values["crank"] == pytest.approx(0.06, rel=1e-6) for design in result.designs)
    assert all(design.exact and design.values["frame"] == 0.17 for design in result.designs)
    tilted = {"type": "dyads", "ground": {"A": ["1 mm", "2 mm"], "D": ["150 mm", "80 mm"]}}
    bounds = {"bounds": ["10 mm", "400 mm"]}
    point = {"P": [{"bounds": ["-300 mm", "300 mm"]}] * 2}
    tilted["links"] = {
        "crank": {"joints": ["A", "B"], "length": bounds},
        "coupler": {"joints": ["B", "C"], "length": bounds, "points": point},
        "rocker": {"joints": ["D", "C"], "length": bounds},
    }
    task = optlink.read({**raw, "mechanism": {**tilted, "assembly": {"C": "either"}}, "requirement": path}).variants()[0].spec
    assert given_pivots(task) == (0.001 + 0.002j, 0.15 + 0.08j)
    assert poses_and_points(task)


def test_a_repeated_point_is_told():
    rows = [{"x": f"{x} mm", "y": f"{x * x} mm"} for x in (1, 2, 3, 4, 5, 6, 7, 2, 9)]
    raw = {"title": "eight points", "mechanism": PLACED, "requirement": {"kind": "path", "points": rows}}
    result = optlink.synthesis.exact(optlink.read(raw))
    assert "points 2 and 8 are the same" in result.notes[0]
    assert not result.valid


def test_problems_of_other_kinds_are_refused():
    with pytest.raises(optlink.InputError, match="no list of exact solutions of 3 poses"):
        optlink.synthesis.exact("motion-3-poses")


def test_special_poses_are_told():
    raw = dict(optlink.load(POSES / "known-0.toml").raw)
    rows = [{"x": f"{x} mm", "y": f"{y} mm", "angle": "10 deg"} for x, y in ((0, 0), (10, 1), (22, 3), (30, 9), (35, 20))]
    result = optlink.synthesis.exact(optlink.read({**raw, "requirement": {**raw["requirement"], "points": rows}}))
    assert "does not turn" in result.notes[0]
    assert not result.valid
    assert result.to_dict()["exact_solutions"]["solutions"] == []


@pytest.mark.parametrize(
    ("places", "angles", "words"),
    [
        ([(0, 0), (10, 20), (35, 22), (50, -9)], (30, 30, 30, 30), "does not turn"),
        ([(0, 0), (10, 20), (35, 22)], (30, 30, 30), "does not turn"),
        ([(10, 0), (0, 10), (-10, 0), (0, -10)], (0, 90, 180, 270), "turns about one point"),
    ],
)
def test_special_poses_among_points_are_told(places, angles, words):
    raw = dict(optlink.load(POSES / "known-0.toml").raw)
    rows = [{"x": f"{x} mm", "y": f"{y} mm", "angle": f"{angle} deg"} for (x, y), angle in zip(places, angles, strict=True)]
    others = [["61 mm", "7 mm"], ["80 mm", "33 mm"], ["70 mm", "51 mm"], ["33 mm", "60 mm"]]
    points = [*rows, *others[: 10 - 2 * len(rows)]]
    result = optlink.synthesis.exact(optlink.read({**raw, "requirement": {**raw["requirement"], "points": points}}))
    assert words in result.notes[0]
    assert result.exact_solutions.solutions == ()


def invoke(*arguments):
    return CliRunner().invoke(app, list(arguments))


def test_the_command_lists_all():
    ended = invoke("solve", str(POSES / "known-0.toml"), "--all", "--json")
    document = json.loads(ended.stdout)["exact_solutions"]
    assert (ended.exit_code, document["certified"], document["usable"], len(document["solutions"])) == (0, 4, 4, 12)
    assert document["solutions"][-1]["reasons"] == ["branch", "order"]
    assert invoke("solve", str(POSES / "all-real.toml"), "--all").exit_code == 1
    refused = invoke("solve", "motion-3-poses", "--all")
    assert refused.exit_code == 2
    assert invoke("solve", "motion-5-poses", "--all", "--starts", "20").exit_code == 2
    assert invoke("solve", "motion-5-poses", "--by", "total length").exit_code == 2
    ranked = invoke("solve", str(POSES / "known-0.toml"), "--all", "--by", "total length")
    assert "total length of the links" in " ".join(ranked.stdout.split())
