"""Machines designed by their cycle: both back ends, the proof by inverse dynamics, what cannot be met, files and exit codes."""

from __future__ import annotations

import json
from functools import cache

import numpy as np
import pytest
from scipy.optimize import brentq

import optlink
from optlink.dynamics.columns import MotionColumns
from optlink.problem.terms import Limit
from optlink.tasks.design import solve, validate
from optlink.tasks.results.design import SynthesisResult
from optlink.validation import validate as validate_design
from optlink.validation.cycle import Cycle
from tests.solved import once
from tests.tasks.test_fit import drag_link, torque

SCALED = 500.0 / 545.454545454545


@cache
def shaper() -> SynthesisResult:
    return once("shaper by both back ends", lambda: solve(optlink.load("shaper-design"), "both", starts=3))


def given_shaper() -> optlink.Analysis:
    """The shaper of the literature, its lengths scaled to a stroke of 500 mm, at 64 rpm."""
    k = SCALED
    sizes = {"crank": 0.125, "rocker": 0.6, "coupler": 0.15}
    changes: dict[str, object] = {f"mechanism.links.{name}.length": f"{k * size} m" for name, size in sizes.items()}
    changes |= {"mechanism.ground.A": ["0 m", f"{k * 0.275} m"], "mechanism.guides.F.through": ["0 m", f"{k * 0.575} m"]}
    return optlink.analyze(optlink.load("shaper").override({**changes, "drive.speed": "64 rpm"}))


def peak(analysis: optlink.Analysis, column: str) -> float:
    return max(analysis.figures[f"{column}.max"], -analysis.figures[f"{column}.min"])


@pytest.mark.slow
def test_both_back_ends_design_the_same_shaper():
    result = shaper()
    assert result.valid
    expected = result.problem.spec.expected
    assert expected is not None
    assert result.objective == pytest.approx(expected.objective, abs=expected.objective_tolerance)
    one, other = result.backends["slsqp"], result.backends["ipopt"]
    assert one.objective == pytest.approx(other.objective, rel=1e-8)
    for name in result.problem.model.free:
        assert one.design[name] == pytest.approx(other.design[name], rel=1e-5)


@pytest.mark.slow
def test_optimal_shaper_beats_the_initial_one_of_equal_stroke():
    given, result = given_shaper(), shaper().best.analysis
    assert result is not None
    assert given.figures["ram.stroke_m"] == pytest.approx(0.5, rel=1e-12)
    assert result.figures["ram.stroke_m"] == pytest.approx(0.5, rel=1e-8)
    assert result.figures["ram.time_ratio"] == pytest.approx(1.8, rel=1e-8)
    assert peak(given, "input.torque_Nm") == pytest.approx(1015.358, rel=1e-6)
    assert peak(result, "input.torque_Nm") <= 0.976 * peak(given, "input.torque_Nm")
    assert result.figures["B.f_N.max"] <= 0.75 * given.figures["B.f_N.max"]
    assert peak(result, "F.normal_N") <= 1500.0 * (1.0 + 1e-6) < peak(given, "F.normal_N")


@pytest.mark.slow
def test_starting_values_are_the_published_shaper():
    given, start = given_shaper(), shaper().best.initial_analysis
    assert start is not None
    for name in ("input.torque_Nm.max", "F.normal_N.max", "B.f_N.max", "ram.time_ratio"):
        assert start.figures[name] == pytest.approx(given.figures[name], rel=1e-8)


ENOUGH = 5  # neighbours within the bounds


@pytest.mark.slow
def test_no_neighbour_that_meets_the_limits_is_better():
    """By the ordinary analysis alone: random steps, mended until stroke and time ratio hold, never improve."""
    result = shaper()
    task = result.problem.spec
    names = list(task.free)
    at = np.array([result.design[name] for name in names])
    low, high = np.array([task.quantities[name].bounds for name in names]).T

    def measured(x: np.ndarray) -> np.ndarray:
        cycle = Cycle(task, dict(zip(names, x, strict=True)))
        equal = [cycle.figure(task.limits.named[name]) for name in ("stroke", "time_ratio")]
        return np.array([*equal, cycle.figure(task.limits.named["guide"]), cycle.objective()])

    here = measured(at)
    slopes = np.array([(measured(at + h) - measured(at - h)) / 2e-6 for h in 1e-6 * np.eye(len(at))]).T[:2]
    mend = np.linalg.pinv(slopes)
    rng = np.random.default_rng(5)
    tried = 0
    for _ in range(40):
        step = rng.normal(size=len(at))
        step -= mend @ (slopes @ step)
        x = at + np.where((at >= high - 1e-9) | (at <= low + 1e-9), 0.0, 1e-3 * step / np.linalg.norm(step))
        for _ in range(3):
            x = x - mend @ (measured(x)[:2] - here[:2])
        there = measured(x)
        if np.all((low - 1e-9 <= x) & (x <= high + 1e-9)):
            tried += 1
            missed = max(0.0, there[2] - 1500.0)  # at more than twice the price of the limit
            assert there[3] + 1e-4 * missed >= here[3] * (1.0 - 1e-8), x - at
        if tried == ENOUGH:
            break
    assert tried == ENOUGH


def test_validation_fails_on_planted_defects():
    result = shaper()
    good = result.best.values
    assert validate_design(result.problem.spec, good, objective=result.objective).valid
    for change, words in (
        ({"crank.length": good["crank.length"] * 1.001}, "stroke"),
        ({"F.y": 0.46}, "within its bounds"),
        ({"crank.length": 0.5}, "turns fully"),
    ):
        proof = validate_design(result.problem.spec, {**good, **change}, objective=result.objective)
        assert any(words in check.name for check in proof.checks if not check.passed), words
    wrong = validate_design(result.problem.spec, good, objective=result.objective * (1.0 + 1e-5))
    assert [check.name for check in wrong.checks if not check.passed] == ["objective measured in motion"]


def test_the_extremes_of_a_design_share_the_positions_at_which_they_are_measured(monkeypatch):
    task = shaper().problem.spec
    terms = [*task.goals, *(item.term for item in task.bounds)]
    cycle, records = Cycle(task, {}), []
    fine = np.concatenate([np.linspace(0.0, 2.0 * np.pi, 20_001), cycle.work.jumps])
    monkeypatch.setattr("optlink.validation.cycle.MotionColumns", lambda moving: records.append(moving) or MotionColumns(moving))
    for term in (term for term in terms if term.extreme):
        machine, read = cycle.history(term)
        dense = float(np.max(np.abs(read(MotionColumns(machine.moving(fine, cycle.speed))))))
        assert dense == pytest.approx(cycle.figure(term), rel=1e-6)
        assert dense <= cycle.figure(term)
    assert len(records) < 6  # once round, at the peaks, before jumps; for three terms


def test_largest_values_between_the_positions_are_met():
    """The level of the programme is the peak over the cycle to 1e-8, although it has only a few dozen positions."""
    result = shaper()
    cycle = Cycle(result.problem.spec, result.best.values)
    assert cycle.objective() == pytest.approx(result.objective, rel=2e-8)


@pytest.mark.slow
def test_conflicting_limits_are_listed_with_their_relaxations():
    file = optlink.load("shaper-design").override({"limits.guide.max": "200 N"})
    result = solve(file, "slsqp", starts=1)
    assert not result.valid
    assert result.status is optlink.Status.INFEASIBLE
    (item,) = result.conflict
    assert (item.key, item.sense, item.bound, item.unit) == ("limits.guide", "<=", 200.0, "N")
    assert 300.0 < item.relaxed < 900.0
    enough = file.override({"limits.guide.max": f"{1.03 * item.relaxed} N"})
    assert solve(enough, "slsqp", starts=1).valid


@pytest.mark.slow
def test_toggle_press_with_corners_in_its_load():
    """The table of the force has corners: the crank angles at which they are met cut the strokes, so derivatives stay exact."""
    result = solve(optlink.load("press-toggle"), "slsqp")
    assert result.valid
    expected = result.problem.spec.expected
    assert expected is not None
    assert result.objective == pytest.approx(expected.objective, abs=expected.objective_tolerance)
    assert result.best.initial_analysis is not None
    assert result.best.analysis is not None
    given, computed = (peak(analysis, "input.torque_Nm") for analysis in (result.best.initial_analysis, result.best.analysis))
    assert computed <= 0.95 * given
    assert result.best.analysis.figures["ram.s_m.max"] == pytest.approx(0.5989, rel=1e-8)
    assert result.best.analysis.figures["F.normal_N.max"] <= 3500.0 * (1.0 + 1e-6)


@pytest.mark.slow
def test_epsilon_constraint_bounds_the_loss_of_the_weighted_sum():
    """Least RMS torque alone, then least guide force with the RMS torque a little above it: a point of the trade-off."""
    file = optlink.load("shaper-design").override({"limits.guide": None, "objective": {"quantity": "torque", "measure": "rms"}})
    least = solve(file, "slsqp", starts=1)
    assert least.valid
    limit = {"quantity": "torque", "measure": "rms", "max": f"{1.01 * least.objective} N*m"}
    other = file.override({"objective": {"quantity": "guide force", "of": "F"}, "limits.torque": limit})
    traded = solve(other, "slsqp", starts=1)
    assert traded.valid
    guide = Limit(quantity="guide force", of="F", max="1 N")
    assert traded.objective < 0.9 * Cycle(least.problem.spec, least.best.values).figure(guide)


def test_terms_can_be_maximised():
    changes = {"objective": {"quantity": "slide", "of": "G", "measure": "least", "sense": "maximise"}, "limits.guide": None}
    result = solve(optlink.load("shaper-design").override(changes), "ipopt", starts=1)
    assert result.valid
    assert -result.objective > 1.2 * Cycle(result.problem.spec, {}).figure(result.problem.spec.goals[0])


def test_given_sizes_are_checked():
    file = optlink.load("shaper-design")
    assert validate(file, shaper().best.values).valid
    assert not validate(file, {}).valid  # the given shaper returns too fast


@pytest.mark.slow
def test_result_is_json_and_the_design_a_machine(tmp_path):
    from optlink.presentation.registry import view_of

    files = view_of("design").write(shaper(), tmp_path)
    assert {path.name for path in files} == {"result.json", "design.toml", "cycle.csv", "courses.png", "mechanisms.png"}
    document = json.loads((tmp_path / "result.json").read_text())
    assert document["schema"] == "optlink/design/4"
    assert document["valid"] is True
    machine = optlink.load(tmp_path / "design.toml")
    assert machine.model.free == ()
    assert peak(optlink.analyze(machine), "input.torque_Nm") == pytest.approx(
        peak(shaper().best.analysis, "input.torque_Nm"), rel=1e-12
    )


@pytest.mark.slow
def test_the_relaxation_of_an_infeasible_machine_is_that_of_its_whole_cycle():
    """A slider-crank whose peak torque is limited too low for its stroke: the least torque is that of crank 35 mm and rod 200 mm.

    By virtual work, also between the positions of the programme; the stroke that the torque allows, by bisection.
    """
    file = drag_link(**{"limits.torque": {"quantity": "torque", "measure": "peak", "max": "50 N*m"}})
    file = file.override({"objective": {"quantity": "reaction", "of": "B", "measure": "peak"}})
    result = solve(file, starts=1)
    assert result.status is optlink.Status.INFEASIBLE
    named = {item.key: item for item in result.conflict}
    assert set(named) == {"limits.torque", "limits.stroke"}
    assert not any(item.approximate for item in named.values())
    least = torque(0.035, 0.2)
    assert named["limits.torque"].relaxed == pytest.approx(least, rel=1e-3)
    crank = brentq(lambda crank: torque(crank, 0.2) - 50.0, 0.02, 0.035)
    assert named["limits.stroke"].relaxed == pytest.approx(2e3 * crank, rel=1e-3)
    for share, feasible in ((1.003, True), (0.997, False)):
        again = solve(file.override({"limits.torque.max": f"{share * named['limits.torque'].relaxed} N*m"}), starts=2)
        assert again.valid is feasible


GUIDED = """
gravity = "9.81 m/s^2"

[mechanism]
type = "dyads"
ground = { A = ["0 mm", "0 mm"] }
guides = { G = { slider = "slider", through = "A", direction = { bounds = ["-180 deg", "180 deg"] }, offset = "10 mm" } }
assembly = { C = "forward" }

[mechanism.links]
crank = { joints = ["A", "B"], length = "50 mm" }
rod = { joints = ["B", "C"], length = "200 mm" }
slider = { joints = ["C"] }

[bodies]
slider = { mass = "5 kg" }
rod = { mass = "1 kg", inertia = "0.003 kg*m^2" }

[loads]
push = { on = "slider", force = "80 N", direction = "100 deg" }

[drive]
body = "crank"
speed = "60 rpm"

[objective]
quantity = "torque"
measure = "peak"
"""
"""A slider-crank whose guide may have any direction."""


@pytest.mark.parametrize(
    ("begin", "push"), [("147.9 deg", "105.7 deg"), pytest.param("-179 deg", "172.7 deg", marks=pytest.mark.slow)]
)
def test_a_search_passes_the_jump_of_the_direction_of_a_guide(begin: str, push: str, tmp_path) -> None:
    """Searches and the exchange of peaks stopped at -180 or 180 deg, with up to ten times the torque called optimal."""
    (tmp_path / "guided.toml").write_text(GUIDED)
    changes = {"mechanism.guides.G.direction.start": begin, "loads.push.direction": push}
    problem = optlink.load(tmp_path / "guided.toml", changes)
    result = solve(problem, starts=1)
    assert result.valid
    at = result.design["G.direction"]
    assert abs(np.degrees(at)) < 179.0
    for step in (-0.01, 0.01):
        torque_beside = optlink.analyze(problem, design={"G.direction": at + step}).extremes["input.torque_Nm"]
        assert max(torque_beside.largest, -torque_beside.least) > result.objective
