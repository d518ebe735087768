"""Every result grades its error against the size of its task and explains a poor fit."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from typer.testing import CliRunner

import optlink
from optlink.cli.app import app
from optlink.problem.file import dump
from optlink.report import terminal
from optlink.report.html.page import page, verdict
from optlink.report.report_model import ReportModel
from optlink.report.views import cycle_tables, path_tables
from optlink.solvers.solution import LimitState
from optlink.tasks.cycle import solve as solve_cycle
from optlink.tasks.path import solve, validate
from optlink.tasks.results.fit import Fit, PathFit, TransmissionFit, transmission_fit
from tests.stated import document, four_bar_section, free

SIZES = dict.fromkeys(("crank", "coupler", "rocker", "frame"), free(10.0, 300.0))
SPOT = {"P": [free(-300.0, 300.0), free(-300.0, 300.0)]}
STAR = 50.0 * np.array([[math.cos(2.4 * k), math.sin(2.4 * k)] for k in range(7)])
TURNED = np.column_stack([[0.0, 60.0, 110.0, 90.0, 20.0], [0.0, 25.0, 70.0, 130.0, 110.0], np.radians([0, 80, 170, 260, 330])])


@pytest.fixture(scope="module")
def star() -> optlink.tasks.results.path.PathResult:
    """A zigzag that no four-bar draws, with the crank pivot where it is by default."""
    section = four_bar_section("left", **SIZES, points=SPOT, pivot=None, direction=None)
    raw = document(section, STAR + 150.0, {"transmission_angle": ["40 deg", "140 deg"]})
    return solve(optlink.read(raw), starts=60, designs=1)


@pytest.mark.parametrize(("share", "grade"), [(0.0, "exact"), (1e-6, "good"), (0.01, "good"), (0.049, "fair"), (0.051, "poor")])
def test_grades_are_shares_of_the_size(share: float, grade: str) -> None:
    assert Fit(share * 0.4, 0.4, "m", "the size of the path").grade == grade


def test_a_poor_path_is_called_poor(star) -> None:
    best = star.best
    assert star.valid
    fit = best.fit
    gaps = STAR[:, None] - STAR[None]
    size = float(np.max(np.hypot(gaps[..., 0], gaps[..., 1])))
    rms = math.sqrt(star.objective / len(STAR)) * 1e3
    assert fit.share == pytest.approx(rms / size, rel=1e-9)
    assert fit.grade == "poor"
    assert star.to_dict()["fit"]["grade"] == "poor"
    assert any("limits.crank" in each.remedy for each in fit.reasons)
    assert any("A.x" in each.reason or "crank pivot is fixed" in each.reason for each in fit.reasons)
    limited = [limit.key for limit in best.limits if limit.active and limit.multiplier]
    named = [each.remedy.removeprefix("widen ") for each in fit.reasons if each.remedy.startswith("widen")]
    assert set(named) <= set(limited)
    assert bool(named) == bool([key for key in limited if not key.startswith("requirement.points")])
    assert verdict(ReportModel(star.problem, star, None)).startswith("Valid, poor fit: rms error is")


def test_a_design_that_breaks_a_limit_has_no_grade(star) -> None:
    """Beside "no feasible design found", a grade of the nearest one reads like praise, and its reasons are no remedies."""
    narrow = star.problem.override({"limits.transmission_angle": ["89.99 deg", "90.01 deg"]})
    nearest = solve(narrow, starts=60, designs=1)
    assert nearest.status == "infeasible"
    for result in (star, nearest):
        console = terminal.console()
        with console.capture() as text:
            console.print(terminal.rendered(path_tables.path_result(result)))
        status = text.get().partition("Design")[0]
        assert ("fit" in status) == result.valid
        assert ("the nearest design is shown" in status) != result.valid


def test_points_passed_out_of_order_are_a_reason(star) -> None:
    steps = np.degrees(np.abs(np.diff(star.best.crank_angles)))
    named = [each.reason for each in star.best.fit.reasons if "order of the points" in each.reason]
    assert bool(named) == bool(np.any(steps < 0.0115))
    first = int(np.argmin(steps)) + 1
    assert not named or f"{first} and {first + 1}" in named[0]
    assert named


@pytest.mark.slow
def test_poses_that_rotate_farther_than_the_coupler_are_a_reason() -> None:
    section = four_bar_section("left", **SIZES, points=SPOT)
    result = solve(optlink.read(document(section, TURNED)), starts=60, designs=1)
    best = result.best
    assert best is not None
    assert best.fit.grade == "poor"
    reason = next(each for each in best.fit.reasons if "the poses turn through 330 deg" in each.reason)
    assert "double-crank" in reason.remedy


def test_a_wrong_timing_is_a_reason() -> None:
    """A planted linkage, its points given at crank angles a third of a turn late."""
    sizes = {"crank": 30.0, "coupler": 80.0, "rocker": 70.0, "frame": 90.0}
    angles = np.linspace(0.0, 4.0, 7)
    section = four_bar_section("left", **{k: f"{v} mm" for k, v in sizes.items()}, points={"P": ["40 mm", "30 mm"]})
    section |= {"pivot": ["0 mm", "0 mm"], "direction": "0 deg"}
    raw = document(section, np.zeros((7, 2)) + np.arange(7)[:, None], crank=angles)
    planted = validate(optlink.read(raw), {}).best.measured.generated * 1e3
    late = validate(optlink.read(document(section, planted, crank=angles + 2.0)), {}).best
    assert late.fit.grade == "poor"
    assert any('requirement.timing = "free"' in each.remedy for each in late.fit.reasons)
    there = validate(optlink.read(document(section, planted, crank=angles)), {}).best
    assert there.fit.grade == "exact"
    assert there.fit.reasons == ()


def test_a_fixed_pivot_is_a_reason_with_its_gain() -> None:
    sizes = {"crank": 30.0, "coupler": 80.0, "rocker": 70.0, "frame": 90.0}
    angles = np.linspace(0.0, 4.0, 7)
    section = four_bar_section("left", **{k: f"{v} mm" for k, v in sizes.items()}, points={"P": ["40 mm", "30 mm"]})
    section = {k: v for k, v in section.items() if k not in ("pivot", "direction")}
    raw = document(section, np.zeros((7, 2)) + np.arange(7)[:, None], crank=angles)
    planted = validate(optlink.read(raw), {}).best.measured.generated * 1e3
    away = validate(optlink.read(document(section, planted + np.array([25.0, -40.0]), crank=angles)), {}).best
    (reason,) = [each for each in away.fit.reasons if "moved as a whole" in each.reason]
    assert "the crank pivot is fixed at (0 mm, 0 mm)" in reason.reason
    assert "mechanism.pivot" in reason.remedy


def test_a_law_is_graded_by_its_output_range() -> None:
    result = optlink.solve(optlink.load("crank-rocker"))
    fit = result.fit
    motion = optlink.load("crank-rocker").spec.law
    assert fit.error == pytest.approx(math.sqrt(float(np.mean(result.error() ** 2))))
    assert fit.size == pytest.approx(abs(float(np.ptp(motion.curve(motion.offsets, 0.0, 0.0)))))
    assert result.to_dict()["fit"]["of"] == "the output range"


@pytest.mark.slow
def test_verdict_and_json_contain_the_grade(tmp_path) -> None:
    section = four_bar_section("left", **SIZES, points=SPOT, pivot=None, direction=None)
    file = tmp_path / "star.toml"
    file.write_text(dump(optlink.read(document(section, STAR + 150.0))))
    run = CliRunner().invoke(app, ["solve", str(file), "--starts", "60", "--designs", "1"])
    assert run.exit_code == 0
    assert "valid, poor fit: rms error is" in " ".join(run.stdout.split())
    assert "Poor fit, likely reason:" in run.stdout
    answer = json.loads(CliRunner().invoke(app, ["solve", str(file), "--starts", "60", "--designs", "1", "--json"]).stdout)
    assert answer["fit"]["grade"] == "poor"
    assert answer["fit"]["share"] == pytest.approx(answer["fit"]["error"] / answer["fit"]["size"])


def test_show_lists_defaults_of_omitted_keys() -> None:
    shown = CliRunner().invoke(app, ["show", "path-arc5"]).stdout
    line = next(line for line in shown.splitlines() if line.startswith("pivot"))
    assert "fixed: 0 mm, 0 mm" in line
    assert "fixed: 0 deg" in next(line for line in shown.splitlines() if line.startswith("direction"))
    requirement = shown.partition("[requirement]")[2].partition("[limits]")[0]
    assert "no limit" not in requirement


@pytest.mark.parametrize(("least", "grade"), [(90.0, "good"), (45.0, "good"), (44.9, "fair"), (40.0, "fair"), (39.9, "poor")])
def test_transmission_angles_are_graded_by_recommended_ones(least: float, grade: str) -> None:
    right = 0.5 * math.pi
    fit = TransmissionFit(right - math.radians(least), right, "rad", "a right angle")
    assert fit.grade == grade
    assert f"{least:.4g} deg" in fit.text


def test_a_poor_transmission_angle_is_not_explained_by_its_own_limit() -> None:
    def limit(key: str, name: str, sense: str) -> LimitState:
        return LimitState(key, name, 40.0, 40.0, sense, "deg", True, 0.01, 0.0)

    limits = [
        limit("limits.transmission_angle.C", "smallest transmission angle at C", ">="),
        limit("limits.grip", "largest pressure angle", "<="),
        limit("limits.swing_angle", "swing angle of the rocker", "="),
        limit("mechanism.rocker", "rocker", ">="),
    ]
    fit = transmission_fit(math.radians(30.0), {}, {}, limits)
    assert fit is not None
    assert {each.remedy for each in fit.reasons} == {"change limits.swing_angle", "widen mechanism.rocker"}


@pytest.mark.slow
@pytest.mark.parametrize(("swing", "ratio", "grade"), [(40.0, 1.05, "good"), (95.0, 1.15, "poor")])
def test_a_linkage_of_the_best_transmission_is_graded(swing: float, ratio: float, grade: str) -> None:
    """By its least transmission angle, of crank and frame in line; a poor one names the limits that hold it."""
    changes = {"limits.swing_angle": f"{swing} deg", "limits.time_ratio": ratio, "mechanism.frame": "200 mm"}
    result = solve(optlink.load("transmission-optimal", changes), starts=60, designs=1)
    assert result.valid
    s = result.best.values
    angles = []
    for reach in (s["frame"] - s["crank"], s["frame"] + s["crank"]):
        cosine = (s["coupler"] ** 2 + s["rocker"] ** 2 - reach**2) / (2.0 * s["coupler"] * s["rocker"])
        angles.append(math.degrees(math.acos(abs(cosine))))
    fit = result.to_dict()["fit"]
    assert fit["grade"] == grade
    assert 90.0 - math.degrees(fit["error"]) == pytest.approx(min(angles), abs=1e-6)
    assert ("good" if min(angles) >= 45.0 else "fair" if min(angles) >= 40.0 else "poor") == grade
    remedies = {each["remedy"] for each in fit["reasons"]}
    assert remedies >= ({"change limits.swing_angle", "change limits.time_ratio"} if grade == "poor" else set())
    shown = verdict(ReportModel(result.problem, result, None))
    assert shown.startswith("Valid, poor transmission" if grade == "poor" else "Valid: every check passed")


def drag_link(**changes: object) -> optlink.ProblemFile:
    """A slider-crank under a constant force, its crank and rod free."""
    raw = {
        "title": "Slider-crank under a constant force",
        "mechanism": {
            "type": "dyads",
            "ground": {"A": ["0 mm", "0 mm"]},
            "links": {
                "crank": {"joints": ["A", "B"], "length": {"start": "50 mm", "bounds": ["20 mm", "60 mm"]}},
                "rod": {"joints": ["B", "C"], "length": {"start": "130 mm", "bounds": ["100 mm", "200 mm"]}},
                "ram": {"joints": ["C"]},
            },
            "guides": {"F": {"slider": "ram", "through": "A", "direction": "0 deg"}},
            "assembly": {"C": "forward"},
        },
        "loads": {"press": {"on": "ram", "force": "2 kN", "acts": "opposing"}},
        "objective": {"quantity": "torque", "measure": "peak"},
        "limits": {"stroke": {"quantity": "stroke", "of": "ram", "min": "70 mm"}},
    }
    return optlink.read(raw).override(changes)


def torque(crank: float, rod: float) -> float:
    """Peak torque of that slider-crank by virtual work [N m]."""
    phi = np.linspace(0.0, math.tau, 100_001)
    rate = crank * np.sin(phi) * (1.0 + crank * np.cos(phi) / np.sqrt(rod**2 - (crank * np.sin(phi)) ** 2))
    return 2000.0 * float(np.max(np.abs(rate)))


@pytest.mark.parametrize(("least", "feasible"), [("70 mm", True), ("110 mm", False)])
def test_an_objective_without_a_target_is_compared_with_the_initial_design(least: str, feasible: bool) -> None:
    result = solve_cycle(drag_link(**{"limits.stroke.min": least}), starts=1)
    assert result.valid
    assert result.fit is None
    crank, rod = result.values["crank.length"], result.values["rod.length"]
    initial = result.to_dict()["initial"]
    assert initial == {"objective": pytest.approx(torque(0.05, 0.13), rel=1e-6), "feasible": feasible}
    assert 2000.0 * crank < result.objective == pytest.approx(torque(crank, rod), rel=1e-6)
    console = terminal.console()
    with console.capture() as text:
        console.print(terminal.rendered(cycle_tables.cycle_result(result)))
    shown = " ".join(text.get().split())
    change = torque(crank, rod) / torque(0.05, 0.13) - 1.0
    assert f"initial design{' ' if feasible else ', '}{torque(0.05, 0.13):.5g} N·m" in shown
    assert ("does not meet the limits)" in shown) != feasible
    header = page(ReportModel(result.problem, result, None)).partition("<h1")[2].partition("<h2")[0]
    assert header.count(f"(−{-100.0 * change:.1f} %)" if change < 0.0 else f"(+{100.0 * change:.1f} %)") == 1
    assert header.count("%") == 1  # the change is stated once
    assert ("; the initial design does not meet the limits." in header) != feasible


def test_a_machine_with_the_best_transmission_angle_is_graded() -> None:
    """A slider-crank: the angle of its rod with the guide's normal, by the crank over the rod."""
    goal = {"quantity": "transmission angle", "of": "C", "measure": "least", "sense": "maximise"}
    changes = {
        "objective": goal,
        "mechanism.links.rod.length.bounds": ["60 mm", "64 mm"],
        "mechanism.links.rod.length.start": "62 mm",
    }
    result = solve_cycle(drag_link(**changes, **{"limits.stroke.min": "100 mm"}), starts=1)
    assert result.valid
    angle = math.degrees(math.acos(result.values["crank.length"] / result.values["rod.length"]))
    fit = result.to_dict()["fit"]
    assert 90.0 - math.degrees(fit["error"]) == pytest.approx(angle, abs=1e-4)
    assert fit["grade"] == "poor"
    assert "widen limits.stroke" in {each["remedy"] for each in fit["reasons"]}


def test_an_error_larger_than_the_path_has_no_exponent():
    """It stood as 7.1e+02 % on a page."""
    fit = PathFit(1e-6, 1e-3, "m", "the size of the path", excursion=7.1e-3, after=10, count=18)
    assert fit.text == "poor fit: between points 11 and 12 the curve deviates by 7.1 mm, 710 % of the size of the path"
    assert PathFit(0.052, 1.0, "m", "the size").text == "poor fit: rms error is 5.2 % of the size"
