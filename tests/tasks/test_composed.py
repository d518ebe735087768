"""Problems with two demands on one linkage: their optima against searches and formulas of `tests.oracles.composed_problems`."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

import optlink
from optlink.cli.app import app
from optlink.errors import InputError
from optlink.presentation.views import conclusions
from optlink.problem.file import read
from optlink.validation.consistency import contradictions
from tests.oracles import composed_problems as composed
from tests.solved import solution
from tests.tiers import mostly_slow

PATH = ["crank", "coupler", "rocker", "frame", "P.along", "P.across", "A.x", "A.y"]


def dimensions(result: optlink.SynthesisResult) -> np.ndarray:
    """Crank to A.y [m] and direction [rad] as `composed.driving_torque` takes them: with C to the right of B to D."""
    best = result.best
    assert best is not None
    sign = 1.0 if best.assembly == "right" else -1.0  # of two mirror images about the vertical through the middle of the bean
    turned = best.design["direction"] if sign > 0.0 else math.pi - best.design["direction"]
    mirrored = {"P.across": sign, "A.x": sign}
    return np.array([*(mirrored.get(name, 1.0) * best.design[name] for name in PATH), math.remainder(turned, math.tau)])


def measured(result: optlink.SynthesisResult, name: str) -> float:
    """Value of a check of the validation, in its display unit."""
    (check,) = [check for check in result.validation.checks if check.name == name]
    return float(check.value)


# --- the shipped problems ---------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_best_path_within_a_torque():
    result = solution("path-within-torque")
    assert result.valid
    own = composed.path_within_torque(0.4, starts=4)
    assert result.objective == pytest.approx(own.optimum, rel=1e-6)  # that of the search exceeds the torque by 1e-7
    x = dimensions(result)
    assert composed.peak_torque(x) == pytest.approx(0.4, rel=1e-7)
    assert float(np.sum(composed.distances(x) ** 2)) == pytest.approx(result.objective, rel=1e-9)
    assert measured(result, "driving_torque: peak torque") == pytest.approx(0.4, rel=1e-8)


@pytest.mark.slow
def test_the_least_torque_within_half_a_millimetre_of_the_path():
    result = solution("least-torque")
    assert result.valid
    assert result.objective == pytest.approx(composed.least_torque(0.5, starts=2).optimum, rel=1e-8)
    x = dimensions(result)
    assert composed.peak_torque(x) == pytest.approx(result.objective, rel=1e-9)
    assert 1e3 * float(np.max(composed.distances(x))) == pytest.approx(0.5, rel=1e-6)
    assert measured(result, "largest deviation") == pytest.approx(0.5, rel=1e-7)
    again = optlink.validate(result.best.problem, result.design)  # the timing of points within the tolerance is not unique
    assert contradictions(result.to_dict(), again.to_dict()) == ()


@pytest.mark.slow
def test_the_best_path_between_a_shaft_and_the_bottom():
    result, own = solution("path-in-trough"), composed.path_in_trough(2)
    assert result.valid
    assert result.objective == pytest.approx(own.optimum, rel=1e-9)
    x = dimensions(result)
    assert float(np.sum(composed.distances(x) ** 2)) == pytest.approx(result.objective, rel=1e-9)
    for name, value in zip(("crank", "coupler", "rocker", "frame", "along", "across", "A.x", "A.y"), 1e3 * x, strict=False):
        assert value == pytest.approx(own.figures[name], abs=1e-4)
    assert composed.least_clearances(x) == pytest.approx(0.0, abs=1e-8)  # of the shaft, and of the bottom
    assert result.objective > 1.6 * composed.path_in_trough(1, bottom=False).optimum > 16.0 * composed.PATH_SQUARES


@pytest.mark.slow
def test_a_finger_that_touches_the_shaft_between_positions_is_refused():
    """Planted: a clearance that is 0.3 micrometres larger is kept at every point of the path, but not between them."""
    best = solution("path-in-trough").best
    nearer = best.problem.override({"limits.shaft.clearance": "3.0003 mm"})
    x = dimensions(solution("path-in-trough"))
    assert np.min(composed.clearances(x, composed.nearest_angles(x))[0]) > 3e-7 > composed.least_clearances(x)[0]
    assert optlink.validate(best.problem, best.design).valid
    tested = optlink.validate(nearer, best.design)
    assert not tested.valid
    assert [check.name for check in tested.validation.checks if not check.passed] == ["P outside shaft"]


def test_poses_and_a_law_are_met_together():
    result, own = solution("poses-and-law"), composed.poses_and_law().figures
    best = result.best
    assert result.valid
    assert result.best.exact
    assert not result.notes
    planted = composed.PLANTED
    for name, wanted in zip(("crank", "coupler", "rocker", "frame", "P.along", "P.across"), planted.values(), strict=True):
        assert 1e3 * best.design[name] == pytest.approx(wanted, abs=1e-6)
    poses, law = best.parts
    assert [poses.task.prefix, law.task.prefix] == ["gripper.", "valve."]
    assert (
        pytest.approx(np.array([[own[f"{x} {k}"] for k in (1, 2, 3)] for x in "xy"]), abs=1e-6)
        == 1e3 * poses.measured.generated.T
    )
    assert np.degrees(law.measured.generated[:, 0]) == pytest.approx([own[f"rocker {k}"] for k in range(1, 7)], abs=1e-6)


@pytest.mark.parametrize("ratio", mostly_slow([0.1, 10.0], 10.0))
def test_a_weight_favours_its_requirement(ratio):
    """With a wrong frame not both can be met; the sum is that of squares divided by those of sizes, and each weight moves it."""
    problem = optlink.load("poses-and-law", {"mechanism.frame": "123 mm"})
    result = optlink.solve(problem.override({"requirements.gripper.weight": ratio}), starts=100)
    even = optlink.solve(problem, starts=100)
    assert result.valid
    squares, own = ([float(one.measured.objective) for one in each.best.parts] for each in (result, even))
    assert (squares[0] < own[0]) == (squares[1] > own[1]) == (ratio > 1.0)
    size = problem.spec.parts[0].size
    assert result.objective == pytest.approx(ratio * squares[0] / size**2 + squares[1], rel=1e-9)


@pytest.mark.slow
def test_the_smallest_machine_for_a_law():
    result, own = solution("law-smallest-machine"), composed.smallest_machine(2.5, positions=3000)
    assert result.valid
    assert 1e3 * result.objective == pytest.approx(own.optimum + 600.0, abs=1e-5)
    assert [1e3 * result.design[name] for name in ("coupler", "rocker")] == pytest.approx(
        [own.figures["coupler"], own.figures["rocker"]], abs=1e-4
    )
    assert measured(result, "largest deviation") == pytest.approx(2.5, rel=1e-7)
    wider = optlink.load("law-smallest-machine", {"requirement.tolerance": "3 deg"})
    assert 1e3 * optlink.solve(wider).objective == pytest.approx(composed.smallest_machine(3.0, 1000).optimum + 600.0, abs=1e-4)


def test_two_wipers_on_one_crank_pin():
    result, own = solution("two-wipers"), composed.two_wipers()
    assert result.valid
    assert 90.0 - math.degrees(result.objective) == pytest.approx(own.optimum, abs=1e-6)
    names = {"crank.length": "crank", "rod1.length": "coupler 1", "arm1.length": "rocker 1"}
    names |= {"rod2.length": "coupler 2", "arm2.length": "rocker 2"}
    for name, other in names.items():
        assert 1e3 * result.design[name] == pytest.approx(own.figures[other], abs=1e-4)


# --- what a user does with them ---------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_both_back_ends_agree():
    for name in ("poses-and-law", "law-smallest-machine"):
        assert optlink.solve(optlink.load(name), "both").valid


@pytest.mark.slow
def test_the_terminal_states_every_demand(tmp_path):
    done = CliRunner().invoke(app, ["solve", "law-smallest-machine", "--out", str(tmp_path), "--quiet"])
    assert done.exit_code == 0
    best = optlink.read_result(tmp_path)
    assert conclusions.design(best, ()).startswith("Total length of the links 1243 mm. The output follows")
    text = CliRunner().invoke(app, ["validate", str(tmp_path)])
    assert text.exit_code == 0
    words = " ".join(text.stdout.split())
    for part in ("total length of the links 1242.81 mm", "at most 2.5 deg", "given design, valid"):
        assert part in words
    assert (tmp_path / "points.csv").exists()


@pytest.mark.slow
def test_each_requirement_has_its_pictures_and_points(tmp_path):
    done = CliRunner().invoke(
        app, ["solve", "poses-and-law", "--set", "mechanism.frame=123 mm", "--starts", "60", "--out", str(tmp_path)]
    )
    assert done.exit_code == 0
    for part in ("minimised: weighted sum", "sum of squares of gripper", "sum of squares of valve"):
        assert part in " ".join(done.stdout.split())
    assert {"points-gripper", "points-valve", "errors", "law"} <= {file.stem for file in tmp_path.iterdir()}
    again = CliRunner().invoke(app, ["validate", str(tmp_path)])
    assert again.exit_code == 0


# --- input that is refused -------------------------------------------------------------------------------------------------


def torque(**changes: Any) -> Callable[[Any], Any]:
    return lambda raw: raw["limits"]["driving_torque"].update(changes)


def limits(**changes: Any) -> Callable[[Any], Any]:
    return lambda raw: raw["limits"].update(changes)


TWO, TORQUE, LEAST, SMALLEST = "poses-and-law", "path-within-torque", "least-torque", "law-smallest-machine"


def test_a_requirement_is_changed_by_its_name():
    problem = optlink.load("poses-and-law", {"requirements.valve.weight": 3.0, "requirements.0.weight": 2.0})
    assert [part.requirement.weight for part in problem.spec.parts] == [2.0, 3.0]
    assert problem.at("requirements.gripper.weight") == 2.0
    with pytest.raises(InputError, match=r'requirements has no key grip. Did you mean "gripper"'):
        problem.override({"requirements.grip.weight": 1.0})
    with pytest.raises(InputError, match=r"requirements.1.wait: unknown key"):
        problem.override({"requirements.valve.wait": 1.0})


@pytest.mark.slow
def test_lengths_are_not_called_arbitrary_beside_a_path():
    """A law alone has its ratios only; a path, a region or a quantity of the machine fixes the size."""
    free = {
        name: {"bounds": bounds}
        for name, bounds in {
            "crank": ["20 mm", "120 mm"],
            "coupler": ["60 mm", "400 mm"],
            "rocker": ["60 mm", "300 mm"],
            "frame": ["100 mm", "300 mm"],
        }.items()
    }
    law = {"kind": "function", "law": "psi0 + 0.3*(phi - phi0)", "from": "30 deg", "span": "100 deg", "tolerance": "3 deg"}
    points = [["160 mm", "120 mm"], ["120 mm", "140 mm"], ["80 mm", "140 mm"], ["40 mm", "120 mm"]]
    path = {"kind": "path", "points": points, "measure": "max"}
    point = {"P": [{"bounds": ["-200 mm", "300 mm"]}, {"bounds": ["-200 mm", "200 mm"]}]}
    raw = {"title": "t", "mechanism": {"type": "four-bar", **free, "points": point}, "requirements": [law, path]}
    result = optlink.solve(read(raw | {"limits": {"transmission_angle": ["40 deg", "140 deg"]}}), starts=1)
    assert result.valid
    assert not any("scaled together" in note for note in result.notes)


@pytest.mark.slow
def test_a_pressure_angle_that_is_zero_in_every_design_is_said_to_be_the_best():
    """A swinging guide: the force on it is always normal to the rocker."""
    links = {
        "crank": {"joints": ["A", "B"], "length": {"start": "100 mm", "bounds": ["50 mm", "140 mm"]}},
        "block": {"joints": ["B"]},
    }
    mechanism = {
        "type": "dyads",
        "ground": {"A": ["0 mm", "0 mm"], "C": ["0 mm", "-250 mm"]},
        "links": {**links, "rocker": {"joints": ["C", "D"], "length": "500 mm"}},
        "guides": {"G": {"slider": "block", "on": "rocker", "through": "C"}},
        "assembly": {"G": "forward"},
    }
    place = {"kind": "position", "output": "rocker", "at": "0 deg", "value": "60..75 deg"}
    result = optlink.solve(optlink.read({"mechanism": mechanism, "requirement": place}), starts=2)
    assert result.valid
    assert "no design can be better: the peak pressure angle is 0 deg" in result.notes
    assert result.evidence.missed < 0.05
    assert not [note for note in result.notes if note.startswith("search incomplete")]
    assert result.best.figures[0].result == 0.0
