"""Every result grades its error against the size of its task and explains a poor fit."""

from __future__ import annotations

import json
import math
import re
from types import SimpleNamespace

import numpy as np
import pytest
from typer.testing import CliRunner

import optlink
from optlink.cli.app import app
from optlink.errors import Status
from optlink.presentation import terminal
from optlink.presentation.html.page import page
from optlink.presentation.report_model import ReportModel
from optlink.presentation.views import design_tables
from optlink.problem.design import DesignProblem
from optlink.problem.file import dump
from optlink.solvers.solution import LimitState
from optlink.tasks.design import solve, solve as solve_cycle, validate
from optlink.tasks.results.certificate import message, verdict_words
from optlink.tasks.results.fit import Fit, PathFit, TransmissionFit, fit, fixed_effects, segment_of, transmission_fit, way_back
from tests.stated import document, four_bar_section, free

SIZES = dict.fromkeys(("crank", "coupler", "rocker", "frame"), free(10.0, 300.0))
SPOT = {"P": [free(-300.0, 300.0), free(-300.0, 300.0)]}
STAR = 50.0 * np.array([[math.cos(2.4 * k), math.sin(2.4 * k)] for k in range(7)])
TURNED = np.column_stack([[0.0, 60.0, 110.0, 90.0, 20.0], [0.0, 25.0, 70.0, 130.0, 110.0], np.radians([0, 80, 170, 260, 330])])


@pytest.fixture(scope="module")
def star() -> optlink.tasks.results.design.SynthesisResult:
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
    limited = [limit.key for limit in best.displayed_limits if limit.active and limit.multiplier]
    named = [each.remedy.removeprefix("widen ") for each in fit.reasons if each.remedy.startswith("widen")]
    assert set(named) <= set(limited)
    assert bool(named) == bool([key for key in limited if not key.startswith("requirement.points")])
    assert ReportModel(star.problem, star, None).verdict.startswith("Valid, poor fit: rms error is")


@pytest.mark.slow
def test_a_design_that_breaks_a_limit_has_no_grade(star) -> None:
    """Beside "no feasible design found", a grade of the nearest one reads like praise, and its reasons are no remedies."""
    narrow = star.problem.override({"limits.transmission_angle": ["89.99 deg", "90.01 deg"]})
    nearest = solve(narrow, starts=60, designs=1)
    assert nearest.status == "infeasible"
    for result in (star, nearest):
        console = terminal.console()
        with console.capture() as text:
            console.print(terminal.rendered(design_tables.design_result(result)))
        status = text.get().partition("Design")[0]
        assert ("fit" in status) == result.valid
        assert ("Nearest design found" in text.get()) != result.valid


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
    assert fit.error == pytest.approx(math.sqrt(float(np.mean(result.error() ** 2))))
    assert fit.size == pytest.approx(math.radians(30.0), rel=1e-12)  # 2 / (3 pi) of the square of a right angle
    assert result.to_dict()["fit"]["of"] == "the output range"


@pytest.mark.slow
def test_an_exact_design_is_optimal_without_a_certificate(star) -> None:
    """Nothing is less than zero; with an error, or another objective beside it, an optimum is a local one."""
    task = SimpleNamespace(spec=SimpleNamespace(composed=False))
    none_better = type(star).none_better.fget
    assert none_better(SimpleNamespace(valid=True, fit=Fit(1e-12, 0.4, "m", "the path"), problem=task))
    assert not none_better(SimpleNamespace(valid=False, fit=Fit(1e-12, 0.4, "m", "the path"), problem=task))
    assert not none_better(SimpleNamespace(valid=True, fit=PathFit(1e-12, 0.4, "m", "the path", (), 0.1), problem=task))
    task.spec.composed = True
    assert not none_better(SimpleNamespace(valid=True, fit=Fit(1e-12, 0.4, "m", "the path"), problem=task))
    assert str(star).splitlines()[1].startswith("locally optimal, valid, poor fit")
    assert verdict_words(Status.OPTIMAL, True, None, none_better=True) == ("optimal", "valid")
    assert message(Status.OPTIMAL, None, "", none_better=True).startswith("globally optimal: the design is exact to rounding")


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
    fit = transmission_fit(math.radians(30.0), {}, {}, SimpleNamespace(displayed_limits=limits))
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
    shown = ReportModel(result.problem, result, None).verdict
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
    crank, rod = result.design["crank.length"], result.design["rod.length"]
    initial = result.to_dict()["initial"]
    assert initial == {"objective": pytest.approx(torque(0.05, 0.13), rel=1e-6), "feasible": feasible}
    assert 2000.0 * crank < result.objective == pytest.approx(torque(crank, rod), rel=1e-6)
    console = terminal.console()
    with console.capture() as text:
        console.print(terminal.rendered(design_tables.design_result(result)))
    shown = " ".join(text.get().split())
    change = torque(crank, rod) / torque(0.05, 0.13) - 1.0
    assert f"initial design{' ' if feasible else ', '}{torque(0.05, 0.13):.5g} N·m" in shown
    assert ("does not meet the limits)" in shown) != feasible
    assert f"peak torque {torque(crank, rod):.5g} N·m" in shown
    assert (f"{100.0 * change:+.1f} %" in shown) == feasible  # not against a design that is none
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
    angle = math.degrees(math.acos(result.design["crank.length"] / result.design["rod.length"]))
    fit = result.to_dict()["fit"]
    assert 90.0 - math.degrees(fit["error"]) == pytest.approx(angle, abs=1e-4)
    assert fit["grade"] == "poor"
    assert "widen limits.stroke" in {each["remedy"] for each in fit["reasons"]}


def test_an_error_larger_than_the_path_has_no_exponent():
    """It stood as 7.1e+02 % on a page."""
    fit = PathFit(1e-6, 1e-3, "m", "the size of the path", excursion=7.1e-3, segment="points 11 and 12")
    assert fit.text == "poor fit: between points 11 and 12 the curve deviates by 7.1 mm, 710 % of the size of the path"
    assert PathFit(0.052, 1.0, "m", "the size").text == "poor fit: rms error is 5.2 % of the size"


# --- laws of two rows and dwells -------------------------------------------------------------------------------------------


def slide(law: dict[str, object]) -> optlink.ProblemFile:
    """A slider-crank whose slide follows a table."""
    raw = drag_link().raw | {"requirement": {"kind": "function", "output": "F", "law": law}}
    return optlink.read({key: value for key, value in raw.items() if key not in ("objective", "limits", "loads")})


def test_a_slider_that_must_stand_still_is_graded_by_its_links() -> None:
    """A range of zero made the scale of the programme zero."""
    result = solve(slide({"phi": ["0 deg", "60 deg", "120 deg"], "s": ["0 mm", "0 mm", "0 mm"]}), starts=60, designs=1)
    best = result.best
    crank, rod = best.values["crank.length"], best.values["rod.length"]
    angles = best.values["start"] + np.radians([0.0, 60.0, 120.0])
    slides = crank * np.cos(angles) + np.sqrt(rod**2 - (crank * np.sin(angles)) ** 2)
    rms = float(np.std(slides))
    assert best.fit.error == pytest.approx(rms, rel=1e-5)
    assert (best.fit.size, best.fit.of) == (max(crank, rod), "the longest link")
    assert best.fit.grade == ("good" if rms <= 0.01 * rod else "fair" if rms <= 0.05 * rod else "poor")


def test_poses_that_do_not_turn_have_a_grade_of_their_angles() -> None:
    """Their total rotation is zero: the error of the angles was left out."""
    poses = np.array([[0.0, 50.0, 0.0], [30.0, 50.0, 0.0], [60.0, 70.0, 0.0]])
    sizes = {"crank": free(10.0, 40.0), "coupler": free(60.0, 120.0), "rocker": free(60.0, 120.0), "frame": "100 mm"}
    section = four_bar_section("left", **sizes, points={"P": ["40 mm", "30 mm"]})
    best = solve(optlink.read(document(section, poses)), starts=60, designs=1).best
    turned = best.fit.unit == "rad"
    assert turned == (best.fit.of == "a radian")
    worst = math.sqrt(float(np.mean(best.measured.turned**2)))
    assert best.fit.share >= worst * (1.0 - 1e-12)


def rocker_angles(crank: float, coupler: float, rocker: float, frame: float, angles: np.ndarray) -> np.ndarray:
    """Angle of the rocker, to the left of B -> D, as the intersection of two circles; NaN where they do not meet."""
    pin = crank * np.exp(1j * angles)
    line = frame - pin
    gap = np.abs(line)
    with np.errstate(invalid="ignore"):
        along = (coupler**2 - rocker**2 + gap**2) / (2.0 * gap)
        joint = pin + line / gap * (along + 1j * np.sqrt(coupler**2 - along**2))
    return np.angle(joint - frame)


def outer_dead_centre(crank: float, coupler: float, rocker: float, frame: float) -> float:
    """Crank angle at which crank and coupler form one line, the rocker to the left of it."""
    reach = crank + coupler
    cosine = (reach**2 + frame**2 - rocker**2) / (2.0 * reach * frame)
    return math.acos(cosine) if abs(cosine) <= 1.0 else math.nan


def turns_well(crank: float, coupler: float, rocker: float, frame: float) -> bool:
    """Whether the crank turns fully, with a transmission angle clearly above the default limit of 1 deg."""
    least, *middle, most = sorted((crank, coupler, rocker, frame))
    inner = [(coupler**2 + rocker**2 - (frame + way * crank) ** 2) / (2.0 * coupler * rocker) for way in (-1.0, 1.0)]
    return crank == least and least + most < sum(middle) - 0.1 and max(map(abs, inner)) < math.cos(math.radians(1.1))


def law_error(sizes: dict[str, float], start: float | None, phi: np.ndarray, psi: np.ndarray, relative: bool) -> float:
    """Root mean square error of a four-bar [rad] at the rows of a table; at its own start it has none."""
    begin = outer_dead_centre(**sizes) if start is None else start
    turn = np.concatenate([[begin], begin + phi if relative else phi])
    angle = rocker_angles(**sizes, angles=turn)
    error = psi - (angle[1:] - angle[0] if relative else angle[1:])
    error = (error + np.pi) % (2.0 * np.pi) - np.pi
    left_out = relative and phi[0] == 0.0 and psi[0] == 0.0
    return float(np.sqrt(np.mean(error[int(left_out) :] ** 2)))


@pytest.mark.slow
@pytest.mark.parametrize("block", range(4))
def test_no_law_of_two_rows_and_no_dwell_is_without_a_grade(block: int) -> None:
    """200 random ones: error, grade and optimum against own kinematics and a search of all rockers of the grid."""
    random = np.random.default_rng(360 + block)
    for _ in range(50):
        frame, crank = 100.0, float(random.uniform(10.0, 45.0))
        coupler = float(random.uniform(60.0, 140.0))
        low = float(random.uniform(40.0, 100.0))
        high = low + float(random.uniform(5.0, 50.0))
        dwell, relative, clockwise = (bool(random.integers(2)) for _ in range(3))
        rows = int(random.integers(2, 5)) if dwell else 2
        turned, near = (5.0, 170.0) if random.integers(2) else (1.0, 12.0), bool(random.integers(2))
        phi = np.sort(np.r_[0.0, random.uniform(*turned, rows - 1)]) * (-1.0 if clockwise else 1.0)
        phi = phi if relative else phi + float(random.uniform(-90.0, 90.0))
        level = 0.0 if relative else float(random.uniform(20.0, 160.0))
        psi = np.full(rows, level) if dwell else level + np.array([0.0, float(random.uniform(2.0, 120.0))])
        start = float(random.uniform(-180.0, 180.0)) if relative and random.integers(2) else None
        begin = None if start is None else math.radians(start)
        if near:  # a linkage of the bounds meets it, or nearly
            sizes = {"crank": crank, "coupler": coupler, "rocker": float(random.uniform(low, high)), "frame": frame}
            at = np.radians(phi) + ((outer_dead_centre(**sizes) if begin is None else begin) if relative else 0.0)
            actual = np.degrees(np.unwrap(rocker_angles(**sizes, angles=at)))
            if np.all(np.isfinite(actual)):
                noise = 1.0 + float(random.choice([0.0, 1e-4, 0.03])) * random.uniform(-1.0, 1.0)
                psi = np.full(rows, level) if dwell else actual - (actual[0] if relative else 0.0)
                psi = psi + (0.0 if relative or not dwell else np.mean(actual) - level)
                psi[1:] *= noise
        law = {"phi": [f"{x!r} deg" for x in phi.tolist()], "psi": [f"{x!r} deg" for x in psi.tolist()]}
        given = {} if start is None else {"from": f"{start!r} deg"}
        raw = {
            "title": "two rows",
            "mechanism": {
                "type": "four-bar",
                "frame": "100 mm",
                "crank": f"{crank!r} mm",
                "coupler": f"{coupler!r} mm",
                "rocker": {"bounds": [f"{low!r} mm", f"{high!r} mm"]},
                "assembly": "left",
            },
            "requirement": {"kind": "function", "law": law | ({} if relative else {"measured_from": "frame"}), **given},
        }
        result = optlink.solve(optlink.read(raw))

        law = (begin, np.radians(phi), np.radians(psi), relative)
        grid = [{"crank": crank, "coupler": coupler, "rocker": x, "frame": frame} for x in np.linspace(low, high, 301).tolist()]
        best = min(law_error(sizes, *law) if turns_well(**sizes) else math.inf for sizes in grid)
        if not result.valid:
            assert best == math.inf, raw
            continue
        sizes = {"crank": crank, "coupler": coupler, "rocker": 1e3 * result.design["rocker"], "frame": frame}
        fit = result.fit
        assert fit is not None, raw
        assert fit.error == pytest.approx(law_error(sizes, *law), rel=1e-6, abs=1e-9), raw
        assert fit.error <= best + 1e-9, raw
        moved = np.radians(np.ptp(psi))
        share = fit.error / (1.0 if moved <= 1e-3 else moved)
        grade = "exact" if share <= 1e-9 else "good" if share <= 0.01 else "fair" if share <= 0.05 else "poor"
        assert fit.grade == grade or min(abs(share - edge) for edge in (1e-9, 0.01, 0.05)) < 1e-8, raw
        shown = ReportModel(result.problem, result, None).verdict
        assert shown.startswith("Valid, poor fit" if grade == "poor" else "Valid: every check passed"), raw


# --- what would help ---------------------------------------------------------------------------------------------------------

BUCKET = {
    "title": "80 deg in, 110 deg out",
    "mechanism": {
        "type": "four-bar",
        "frame": "330 mm",
        "crank": "300 mm",
        "coupler": {"bounds": ["60 mm", "1000 mm"]},
        "rocker": {"bounds": ["60 mm", "1000 mm"]},
        "assembly": "left",
    },
    "requirement": {"kind": "function", "law": {"phi": ["0 deg", "80 deg"], "psi": ["0 deg", "110 deg"]}},
    "limits": {"crank": "span", "transmission_angle": ["30 deg", "150 deg"]},
}


def rms_from(result: optlink.SynthesisResult, start: float) -> float:
    """Error [deg] of the design at the second row if the law begins at a crank angle [deg]."""
    sizes = {name: 1e3 * result.design[name] for name in ("crank", "coupler", "rocker", "frame")}
    angles = rocker_angles(**sizes, angles=np.radians([start, start + 80.0]))
    return abs(math.degrees(math.remainder(math.radians(110.0) - (angles[1] - angles[0]), math.tau)))


@pytest.mark.slow
def test_the_default_start_of_a_law_is_named_and_its_remedy_works() -> None:
    file = optlink.read(BUCKET)
    result = optlink.solve(file)
    assert result.fit.grade == "poor"
    reason = result.fit.reasons[0]
    assert reason.reason.startswith("the law starts at the outer dead centre, the default of requirement.from")
    told = re.search(
        r"from ([\d.]+) deg the same linkage has an rms error of ([\d.]+) deg instead of ([\d.]+) deg", reason.reason
    )
    start, best, here = map(float, told.groups())
    assert here == pytest.approx(math.degrees(result.fit.error), rel=1e-3)
    assert best == pytest.approx(rms_from(result, start), rel=1e-3)
    assert (
        best <= min(rms_from(result, angle) for angle in np.arange(0.0, 360.0, 5.0)[1:] if rms_from(result, angle) >= 0.0) + 1e-3
    )
    free_start = reason.remedy.removeprefix("free the start: requirement.from = ")
    assert free_start == '{ bounds = ["0 deg", "360 deg"] }'
    assert optlink.solve(file.override({"requirement.from": {"bounds": ["0 deg", "360 deg"]}})).fit.grade == "exact"
    shown = CliRunner().invoke(app, ["solve", "crank-rocker"]).stdout
    assert "the default start" not in shown  # its file states the start


@pytest.mark.slow
def test_the_fixed_dimension_with_the_largest_effect_is_named() -> None:
    """Its first-order effect is the slope of the optimum, solved again with other values."""
    file = optlink.read(BUCKET)
    result = optlink.solve(file)
    effects = fixed_effects(result.solution, file.spec)
    slopes = {}
    for name in ("crank", "frame"):
        size = 1e3 * result.design[name]
        sides = [optlink.solve(file.override({f"mechanism.{name}": f"{size + way} mm"})).objective for way in (0.02, -0.02)]
        slopes[name] = (sides[0] - sides[1]) / 0.04 / result.objective
        assert effects[name] == pytest.approx(slopes[name], rel=2e-3)
    largest = max(slopes, key=lambda name: abs(slopes[name]))
    reason = result.fit.reasons[-1]
    way = "less" if slopes[largest] > 0.0 else "more"
    assert f"{largest} has the largest effect: 1 mm {way} improves the objective by" in reason.reason
    assert reason.remedy == f"free {largest} by bounds"


def test_the_other_assembly_mode_is_named_where_the_same_lengths_are_better() -> None:
    raw = {
        "title": "the mirrored law",
        "mechanism": {**BUCKET["mechanism"], "crank": "80 mm", "coupler": "300 mm", "rocker": {"bounds": ["195 mm", "205 mm"]}},
        "requirement": {"kind": "function", "law": "psi0 - 0.35*sin(phi - phi0)", "span": "90 deg", "from": "40 deg"},
    }
    left, right, either = (
        optlink.solve(optlink.read(raw).override({"mechanism.assembly": m})) for m in ("left", "right", "either")
    )
    worse, better = sorted((left, right), key=lambda result: -result.objective)
    assert worse.fit.grade == "poor"
    named = [each for each in worse.fit.reasons if each.remedy == 'write mechanism.assembly = "either"']
    assert len(named) == 1
    assert f"with C to the {better.assembly} the same sizes" in named[0].reason
    assert not any("either" in each.remedy for each in better.fit.reasons)
    assert either.objective == pytest.approx(better.objective, rel=1e-9)


@pytest.mark.slow
def test_prices_of_a_transmission_angle_are_angles() -> None:
    """The headline is an angle, and the price of a limit is the change of that angle: solved again beside it."""
    result = solve(optlink.load("transmission-optimal"), starts=60, designs=1)
    console = terminal.console()
    with console.capture() as text:
        console.print(terminal.rendered(design_tables.design_result(result)))
    shown = " ".join(text.get().split())
    assert "worst transmission angle 37.73 deg 52.27 deg from ideal" in shown
    assert "cosine" not in shown
    for key, values, moved, per in (
        ("limits.swing_angle", ("80.02 deg", "79.98 deg"), 0.04, "deg"),
        ("limits.time_ratio", (10.0 / 9.0 + 2e-4, 10.0 / 9.0 - 2e-4), 0.04, "0.01"),
    ):
        files = [result.problem.override({key: value}) for value in values]
        above, below = (math.degrees(solve(file, starts=60, designs=1).best.least_transmission) for file in files)
        told = re.search(rf"\+(\S+) deg per {per} ", shown)
        assert float(told[1]) == pytest.approx((below - above) / moved, rel=5e-3)
    assert result.to_dict()["designs"][0]["objective"]["value"] == pytest.approx(math.cos(math.radians(37.73)), abs=1e-3)


def coupler_points(side: float, angles: np.ndarray) -> np.ndarray:
    """Points [mm] of a coupler of own sizes, with C to the left (+1) or right (-1) of B -> D."""
    crank, coupler, rocker, frame, along, across = 30.0, 95.0, 80.0, 100.0, 50.0, 35.0
    b = crank * np.exp(1j * angles)
    line = frame - b
    inside = np.arccos((coupler**2 + np.abs(line) ** 2 - rocker**2) / (2.0 * coupler * np.abs(line)))
    p = b + (along + 1j * across) * np.exp(1j * (np.angle(line) + side * inside))
    return np.column_stack([p.real, p.imag])


@pytest.mark.parametrize("timing", ["free", "from start", "given"])
def test_the_other_assembly_mode_of_a_path_is_named_and_helps(timing: str) -> None:
    """Points that the same four-bar passes in the other mode, at any, at shifted or at the prescribed crank angles."""
    angles = np.radians([0.0, 50.0, 110.0, 170.0, 240.0])
    points = coupler_points(-1.0, angles + (np.radians(35.0) if timing == "from start" else 0.0))
    rows = [{"x": f"{x} mm", "y": f"{y} mm"} for x, y in points]
    if timing != "free":
        rows = [{**row, "crank": f"{math.degrees(angle)} deg"} for row, angle in zip(rows, angles, strict=True)]
    requirement = {"kind": "path", "point": "P", "timing": timing, "points": rows}
    mechanism = {
        "type": "four-bar",
        "crank": "30 mm",
        "coupler": {"bounds": ["94 mm", "96 mm"]},
        "rocker": "80 mm",
        "frame": "100 mm",
        "points": {"P": ["50 mm", "35 mm"]},
        "assembly": "left",
    }
    file = optlink.read({"title": "the other side", "mechanism": mechanism, "requirement": requirement})
    given = {"coupler": 0.095, **({"start": math.radians(10.0)} if timing == "from start" else {})}
    fit = validate(file, given).best.fit
    assert fit.grade == "poor"
    (named,) = [each for each in fit.reasons if each.remedy == 'write mechanism.assembly = "either"']
    told = re.fullmatch(r"with C to the right the same sizes have an rms error of (\S+) mm instead of (\S+) mm", named.reason)
    assert told is not None
    assert float(told[1]) < (0.5 if timing == "free" else 4.0 if timing == "from start" else 1e-3)
    assert float(told[2]) == pytest.approx(1e3 * fit.error, rel=1e-3)
    assert solve(file.override({"mechanism.assembly": "either"}), starts=20).best.fit.grade in ("exact", "good")


def test_the_other_assembly_mode_of_a_law_of_dyads_is_named() -> None:
    """A slide that the rod gives in the other mode, at another start and from another place."""
    turned = "(phi - phi0 + 0.4)"
    slide = f"s0 + 30*cos{turned} - sqrt(90**2 - (30*sin{turned} - 12)**2)"
    mechanism = {
        "type": "dyads",
        "ground": {"A": ["0 mm", "0 mm"]},
        "links": {
            "crank": {"joints": ["A", "B"], "length": "30 mm"},
            "rod": {"joints": ["B", "C"], "length": {"bounds": ["89 mm", "91 mm"]}},
            "slider": {"joints": ["C"]},
        },
        "guides": {"G": {"slider": "slider", "through": "A", "direction": "0 deg", "offset": "12 mm"}},
        "assembly": {"C": "forward"},
    }
    law = {"kind": "function", "law": {"slide": slide, "unit": "mm"}, "span": "80 deg", "points": 20, "output": "G"}
    file = optlink.read({"title": "backwards", "mechanism": mechanism, "requirement": law})
    given = {name: quantity.value for name, quantity in file.model.quantities.items() if quantity.free}
    fit = validate(file, {**given, "rod.length": 0.09}).best.fit
    assert fit.grade == "poor"
    (named,) = [each for each in fit.reasons if each.remedy == 'write mechanism.assembly.C = "either"']
    assert named.reason.startswith("with C backward the same sizes have an rms error of")


def test_the_worst_pressure_angle_as_the_only_objective_of_several_demands_is_graded():
    """An in-line slider-crank: its worst pressure angle is asin(crank / rod)."""
    mechanism = {
        "type": "dyads",
        "ground": {"A": ["0 mm", "0 mm"]},
        "links": {
            "crank": {"joints": ["A", "B"], "length": "70 mm"},
            "rod": {"joints": ["B", "C"], "length": {"bounds": ["75 mm", "400 mm"]}},
            "ram": {"joints": ["C"]},
        },
        "guides": {"G": {"slider": "ram", "through": "A"}},
        "assembly": {"C": "forward"},
    }
    station = {"kind": "position", "output": "G", "at": "0 deg", "value": {"min": "100 mm"}}
    raw = {"title": "t", "mechanism": mechanism, "requirement": station}
    for rod, grade in ((0.075, "poor"), (0.095, "fair"), (0.2, "good")):
        result = optlink.validate(optlink.read(raw), {"rod.length": rod})
        assert result.valid
        assert result.fit.grade == grade
        assert result.fit.angle == pytest.approx(math.acos(0.07 / rod), abs=1e-9)
    raw["objective"] = {"quantity": "total length"}
    assert optlink.validate(optlink.read(raw), {"rod.length": 0.075}).fit is None


# --- paths: the rest of the curve, and remedies ------------------------------------------------------------------------------


def drawn(points: object, **limits: object) -> DesignProblem:
    """A four-bar whose point P may lie in the crank pin B, with a path."""
    sizes = {"crank": "30 mm", "coupler": "80 mm", "rocker": "70 mm", "frame": "90 mm", "assembly": "left"}
    mechanism = {"type": "four-bar", **sizes, "points": {"P": ["0 mm", {"bounds": ["-9 mm", "9 mm"]}]}}
    requirement = {"kind": "path", "point": "P", "points": points}
    return optlink.read({"title": "A path", "mechanism": mechanism, "requirement": requirement, "limits": limits}).spec


QUARTER = [[f"{30 * math.cos(a)} mm", f"{30 * math.sin(a)} mm"] for a in (0.0, 0.25 * math.pi, 0.5 * math.pi)]


@pytest.mark.parametrize("way", [1, -1])
def test_the_rest_of_the_curve_beyond_an_open_path_is_that_of_the_circle_of_the_crank_pin(way):
    task = drawn(QUARTER[::way])
    rest = way_back(task, task.design({"P.across": 0.0}), np.radians([0.0, 45.0, 90.0])[::way])
    assert rest is not None
    assert rest.drawn == pytest.approx(0.03 * math.pi / 2, rel=1e-5)
    assert rest.whole == pytest.approx(0.03 * math.tau, rel=1e-5)
    assert rest.away == pytest.approx(0.06 * math.sin(math.radians(67.5)), rel=1e-5)  # from the end of the arc to its opposite
    assert "47.1 of 188 mm" in rest.note
    assert "region" in rest.note


def test_only_an_open_path_of_a_turning_crank_leaves_a_rest():
    box = {"region": "circle", "of": "P", "centre": ["0 mm", "0 mm"], "radius": "40 mm", "side": "inside"}
    for task, expected in (
        (drawn([*QUARTER, QUARTER[0]]), False),
        (drawn(QUARTER, crank="span"), False),
        (drawn(QUARTER, box=box), True),
    ):
        angles = np.linspace(0.0, 0.5 * math.pi, len(task.data.columns))
        rest = way_back(task, task.design({"P.across": 0.0}), angles)
        assert (rest is not None) == expected
        assert rest is None or "region" not in rest.note  # a remedy that the file has


def test_the_remedy_between_points_of_a_drawing_is_their_number_and_names_places():
    listed, sampled = drawn(QUARTER), drawn({"x": "30*cos(t)", "y": "30*sin(t)", "unit": "mm", "t": [0, "pi/2"], "points": 3})
    assert segment_of(listed, 1)[1] == "prescribe further points between points 2 and 3, or more weight beside them"
    assert segment_of(sampled, 0) == (
        "(30, 0) and (21.21, 21.21) mm",
        "take more points of the curve: requirement.points.points = 9 in the file, or --set requirement.points.points=9",
    )
    chord = math.dist((30.0, 0.0), (30.0 * math.cos(0.25 * math.pi), 30.0 * math.sin(0.25 * math.pi)))
    assert segment_of(sampled, 0, 1e-3 * chord * 0.999)[1].startswith("take more points")
    assert segment_of(sampled, 0, 1e-3 * chord * 1.001)[1] == "give the curve wider bends near (30, 0) and (21.21, 21.21) mm"


def test_a_curve_that_leaves_the_path_between_points_is_explained_by_the_limit_that_holds_it():
    """Points met badly on account of a limit come before the curve between them; limits without a price worth it do not."""
    problem = optlink.load("path-bean")
    task, count = problem.spec, len(problem.spec.data.columns)

    def reasons(price: float, error: float) -> list[str]:
        limit = LimitState("limits.pivots", "pivot D.y", -20.0, -20.0, "<=", "mm", True, price * 1e-4, 0.0)
        measured = SimpleNamespace(distances=np.full(count, error), turned=None)
        solution = SimpleNamespace(displayed_limits=[limit], objective=1e-4)
        found = fit(problem, task.design({}), np.zeros(count), measured, np.full(count, 0.2), solution)
        return [one.reason.partition(" ")[0] for one in found.reasons]

    size = max(math.dist(p, q) for p in task.data.columns[:, :2] for q in task.data.columns[:, :2])
    assert reasons(0.6 / max(20.0, 1e3 * size), 0.03 * size) == ["pivot", "the"]
    assert reasons(0.4 / max(20.0, 1e3 * size), 0.03 * size) == ["the"]
    assert reasons(0.6 / max(20.0, 1e3 * size), 1e-4 * size) == ["the"]
