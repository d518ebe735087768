"""The validator of generated linkages sees every planted defect, and agrees with the oracle on random linkages."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest

from optlink.errors import InputError
from optlink.linkage.fourbar import LENGTHS
from optlink.problem.design import DesignProblem
from optlink.validation.design import deviations, validate as validate_path
from optlink.validation.timing import passing
from tests import synthesis_oracle as oracle
from tests.stated import document, four_bar_section, model

Array = np.ndarray
TURN = 2.0 * math.pi


CHECKS = {
    "within its bounds": "bounds",
    "link lengths": "lengths",
    "Grashof": "grashof",
    "off alignment": "assembled",
    "one branch": "branch",
    "one circuit": "circuit",
    "met in order": "order",
    "one revolution": "one revolution",
    "crank turns": "rotation",
    "crank angles as given": "timing",
    "position for every": "reached",
    "tolerances": "tolerance",
    "smallest transmission angle": "smallest",
    "largest transmission angle": "largest",
    "swing angle": "swing",
    "time ratio": "time ratio",
    "frame length": "frame length",
    " / frame": "link ratio",
    "pivot A.": "pivots",
    "pivot D.": "pivots",
    "objective": "objective",
}
DESIGN = oracle.four_bar(100.0, 35.0, 90.0, 80.0, x=-30.0, y=12.0, direction=0.35, along=40.0, across=55.0, mode=1)
PHI = 0.4 + np.arange(6) * 0.9
PLANTED = oracle.planted_path(DESIGN, PHI)
LOOSE = {"transmission_angle": ["30 deg", "150 deg"], "link_ratio": [0.2, 3.0]}


def quantities(design: Mapping[str, float]) -> dict[str, float]:
    """A design of the oracle [mm] as one of ours [m]."""
    computed = {name: 1e-3 * design[name] for name in LENGTHS}
    computed |= {"A.x": 1e-3 * design["x"], "A.y": 1e-3 * design["y"], "direction": design["direction"]}
    return computed | {"P.along": 1e-3 * design["along"], "P.across": 1e-3 * design["across"]}


def planted(limits: Mapping[str, object] = LOOSE, **more: Any) -> DesignProblem:
    return model(document(four_bar_section("left"), more.pop("points", PLANTED), limits, **more))


def failed(
    problem: DesignProblem, design: Mapping[str, float], angles: Array, objective: float | None = None, **more: float
) -> set[str]:
    proof = validate_path(problem, quantities(design) | more, angles, objective)
    kinds = {next(kind for word, kind in CHECKS.items() if word in check.name) for check in proof.checks if not check.passed}
    assert proof.valid == (not kinds)
    return kinds


def test_valid_designs_pass() -> None:
    problem = planted(closed=True)
    proof = validate_path(problem, quantities(DESIGN), PHI, 0.0)
    assert proof.valid
    assert proof.objective < 1e-20
    assert all(check.limit for check in proof.checks)
    report = oracle.judge_path(DESIGN, PLANTED, PHI, closed=True)
    assert report.free
    assert report.sse < 1e-20


@pytest.mark.parametrize("rotation", ["counter-clockwise", "clockwise"])
@pytest.mark.parametrize("start", [0.4, 2.9, -2.9])
def test_free_crank_angles_start_in_the_first_turn(rotation: str, start: float) -> None:
    """The crank angles of a given design are those at which it was made, but for whole revolutions."""
    angles = start + (PHI - PHI[0]) * (1.0 if rotation == "counter-clockwise" else -1.0)
    problem = planted(points=oracle.planted_path(DESIGN, angles), rotation=rotation)
    np.testing.assert_allclose(passing(problem, quantities(DESIGN)), angles - angles[0] + start % math.tau, atol=1e-5)


def test_the_figures_are_those_of_the_oracle() -> None:
    rng = np.random.default_rng(5)
    for mode in ("path", "motion"):
        off = PLANTED + rng.normal(size=PLANTED.shape)
        poses = np.column_stack([off, oracle.direct(DESIGN, PHI).angle + 0.1 * rng.normal(size=6) + 0.3])
        expected = off if mode == "path" else poses
        problem = planted(points=expected, **({} if mode == "path" else {"angle_length": "25 mm"}))
        extra = {} if mode == "path" else {"mark": 0.3}
        measured = deviations(problem, quantities(DESIGN) | extra, PHI)
        if mode == "path":
            report = oracle.judge_path(DESIGN, off, PHI)
            assert 1e6 * measured.objective == pytest.approx(report.sse, rel=1e-9)
        else:
            report = oracle.judge_motion(DESIGN, poses, PHI, 0.3)
            assert measured.turned is not None
            np.testing.assert_allclose(measured.turned, report.angle_errors, atol=1e-9)
            square = report.sse + 625.0 * float(np.sum(report.angle_errors**2))
            assert 1e6 * measured.objective == pytest.approx(square, rel=1e-9)
        np.testing.assert_allclose(1e3 * measured.distances, report.errors, atol=1e-9)


def test_the_other_assembly_mode() -> None:
    """The figures are those of the mode that the problem states; the claim of the other one is found out."""
    other = {**DESIGN, "mode": -1}
    problem = planted()
    spots = oracle.planted_path(other, PHI)
    assert failed(planted(points=spots), other, PHI) == set()  # nobody claimed anything
    assert failed(planted(points=spots), other, PHI, 0.0) == {"objective"}
    report = oracle.judge_path(DESIGN, spots, PHI)
    assert not report.branch_ok
    assert 1e6 * deviations(planted(points=spots), quantities(other), PHI).objective == pytest.approx(report.sse, rel=1e-9)
    assert failed(problem, DESIGN, PHI, 0.0) == set()


def test_coupler_and_rocker_swapped() -> None:
    swapped = {**DESIGN, "coupler": DESIGN["rocker"], "rocker": DESIGN["coupler"]}
    assert failed(planted(), swapped, PHI, 0.0) == {"objective"}
    assert oracle.judge_path(swapped, PLANTED, PHI).rms > 1.0


def test_crank_and_frame_swapped() -> None:
    swapped = {**DESIGN, "crank": DESIGN["frame"], "frame": DESIGN["crank"]}
    assert {"grashof", "objective"} <= failed(planted(limits={}), swapped, PHI, 0.0)
    assert failed(planted(limits={"crank": "double-crank"}), swapped, PHI) == set()


def test_crank_angles_out_of_order() -> None:
    mixed = PHI.copy()
    mixed[[2, 3]] = PHI[[3, 2]]
    spots = oracle.planted_path(DESIGN, mixed)
    assert failed(planted(points=spots), DESIGN, mixed, 0.0) == {"order"}
    assert not oracle.judge_path(DESIGN, spots, mixed).order_ok


def test_more_than_one_revolution() -> None:
    wide = 0.4 + np.arange(6) * 1.5
    spots = oracle.planted_path(DESIGN, wide)
    assert failed(planted(points=spots), DESIGN, wide, 0.0) == {"one revolution"}
    assert not oracle.judge_path(DESIGN, spots, wide).order_ok


def test_the_wrong_way_round() -> None:
    assert failed(planted(rotation="clockwise"), DESIGN, PHI, 0.0) == {"rotation"}
    assert failed(planted(rotation="counter-clockwise"), DESIGN, PHI, 0.0) == set()
    back, turned = PHI[::-1].copy(), PLANTED[::-1].copy()
    assert failed(planted(points=turned, rotation="clockwise"), DESIGN, back, 0.0) == set()
    assert oracle.judge_path(DESIGN, turned, back).rotation == -1


def test_a_wrong_claim_fails() -> None:
    off = PLANTED + 0.5
    right = deviations(planted(points=off), quantities(DESIGN), PHI).objective
    assert failed(planted(points=off), DESIGN, PHI, right) == set()
    for wrong in (0.0, 0.5 * right, 1.00001 * right, math.nan):
        assert failed(planted(points=off), DESIGN, PHI, wrong) == {"objective"}


def test_not_grashof() -> None:
    """Over the points it assembles; over the revolution it does not."""
    long = {**DESIGN, "coupler": 60.0, "rocker": 65.0}
    phi = 0.3 + 0.2 * np.arange(5)
    assert np.all(np.isfinite(oracle.direct(long, phi).output))
    spots = oracle.planted_path(long, phi)
    computed = failed(planted(points=spots, limits={}), long, phi, 0.0)
    assert {"grashof", "assembled"} <= computed
    assert "objective" not in computed
    assert not oracle.judge_path(long, spots, phi).turns
    assert failed(planted(points=spots, limits={"crank": "span"}), long, phi, 0.0) == set()


def test_a_gap_between_the_points() -> None:
    """All points are reached, but on the way from one to the next the linkage comes apart: no span, two circuits."""
    design = oracle.four_bar(100.0, 80.0, 30.0, 70.0, x=5.0, y=-3.0, direction=0.4, along=40.0, across=30.0)
    ranges = oracle.assembled(design)
    assert len(ranges) == 2
    phi = np.sort(np.concatenate([0.5 * (low + high) + 0.2 * (high - low) * np.array([-1.0, 0.0, 1.0]) for low, high in ranges]))
    spots = oracle.planted_path(design, phi)
    computed = failed(planted(points=spots, limits={"crank": "span"}), design, phi, 0.0)
    assert "assembled" in computed
    assert "objective" not in computed
    assert not oracle.judge_path(design, spots, phi).circuit_ok


def test_a_kite_passes_its_change_point_on_no_side() -> None:
    """crank = coupler, frame = rocker: at phi = 0 all links lie in line, and nothing says which way it goes on."""
    kite = oracle.four_bar(150.0, 118.0, 118.0, 150.0, along=-14.0, across=27.0, mode=-1)
    phi = np.array([-1.0, -0.5, 0.5, 1.0])
    spots = oracle.planted_path(kite, phi)
    section = four_bar_section("right")
    problem = model(document(section, spots, {"crank": "span"}))
    assert not oracle.judge_path(kite, spots, phi).branch_ok
    proof = validate_path(problem, quantities(kite), phi, 0.0)
    assert not proof.valid


CHANGE_POINTS = [  # frame, crank, coupler, rocker: in line at phi = 0
    (162.66, 32.532, 813.299, 683.171),
    (157.474, 126.287, 126.287, 157.474),
    (100.0, 50.0, 80.0, 130.0),
    (100.0, 50.0, 80.0, 130.0 - 1e-12),
    (100.0, 50.0, 80.0, 130.0 + 1e-12),
    (100.0, 50.0, 80.0, 130.0 + 1e-9),
]


@pytest.mark.parametrize("bars", CHANGE_POINTS)
@pytest.mark.parametrize("mode", ["left", "right"])
def test_a_change_point_on_the_way_is_detected(bars: tuple[float, ...], mode: str) -> None:
    """Its margin is 0, or what rounding makes of 0: no proof that the linkage keeps its assembly mode there."""
    design = oracle.four_bar(*bars, along=40.0, across=30.0, mode=1 if mode == "left" else -1)
    phi = np.array([-2.0, -1.2, -0.4, 0.4, 1.2, 2.0])
    if not np.all(np.isfinite(oracle.direct(design, phi).output)):
        phi = phi + math.pi
    spots = oracle.planted_path(design, phi)
    if not np.all(np.isfinite(spots)):
        pytest.skip("does not assemble at the points")
    problem = model(document(four_bar_section(mode), spots, {"crank": "span"}))
    report = oracle.judge_path(design, spots, phi)
    assert not report.branch_ok
    assert not validate_path(problem, quantities(design), phi, 0.0).valid


@pytest.mark.parametrize("more", [0.0, 0.02, 0.05])
def test_a_narrow_gap_between_positions_is_detected(more: float) -> None:
    """Crank and frame all but equal: around phi = 0 the linkage comes apart within a few tenths of a degree."""
    design = oracle.four_bar(60.0, 60.3, 350.0, 350.3 + more, along=40.0, across=30.0, mode=-1)
    phi = np.array([-2.0, -1.2, -0.4, 0.37, 1.2, 2.2])
    spots = oracle.planted_path(design, phi)
    problem = model(document(four_bar_section("right"), spots, {"crank": "span"}))
    assert not oracle.judge_path(design, spots, phi).circuit_ok
    assert not validate_path(problem, quantities(design), phi, 0.0).valid


def test_two_points_at_the_same_crank_angle() -> None:
    """After a whole revolution the crank is where it began: two different points cannot both be met there."""
    phi = 0.4 + np.array([0.0, 1.0, 3.0, TURN])
    spots = oracle.planted_path(DESIGN, phi)
    spots[3] += 7.0
    assert failed(planted(points=spots), DESIGN, phi) & {"order", "one revolution"}
    assert not oracle.judge_path(DESIGN, spots, phi).order_ok
    again = oracle.planted_path(DESIGN, phi)
    assert failed(planted(points=again, closed=True), DESIGN, phi, 0.0) == set()  # the first point, listed again


@pytest.mark.parametrize(("tolerance", "expected"), [(1.0, set()), (0.25, {"tolerance"})])
def test_point_out_of_its_tolerance(tolerance: float, expected: set[str]) -> None:
    off = PLANTED.copy()
    off[3, 0] += 0.5
    allowed = np.full(6, 10.0)
    allowed[3] = tolerance
    assert failed(planted(points=off, tolerances=allowed), DESIGN, PHI) == expected


def test_transmission_angle_missed() -> None:
    def angle(phi: float) -> float:
        square = 35.0**2 + 100.0**2 - 7000.0 * math.cos(phi)
        return math.degrees(math.acos((90.0**2 + 80.0**2 - square) / (2.0 * 90.0 * 80.0)))

    low, high = angle(0.0), angle(math.pi)

    def limits(at_least: float, at_most: float, **more: object) -> dict[str, object]:
        return {"transmission_angle": [f"{at_least} deg", f"{at_most} deg"], **more}

    assert failed(planted(limits=limits(low - 0.01, high + 0.01)), DESIGN, PHI) == set()
    assert failed(planted(limits=limits(low + 0.01, high + 0.01)), DESIGN, PHI) == {"smallest"}
    assert failed(planted(limits=limits(low - 0.01, high - 0.01)), DESIGN, PHI) == {"largest"}
    part = np.linspace(1.0, 2.0, 6)
    inner = limits(angle(1.0) - 0.01, angle(2.0) + 0.01)
    assert failed(planted(limits=inner), DESIGN, part) == {"smallest", "largest"}
    assert failed(planted(limits={**inner, "transmission_over": "span"}), DESIGN, part) == set()


def test_proportions_missed() -> None:
    assert failed(planted(limits={"link_ratio": [0.36, 3.0]}), DESIGN, PHI) == {"link ratio"}
    assert failed(planted(limits={"link_ratio": [0.2, 0.89]}), DESIGN, PHI) == {"link ratio"}
    assert failed(planted(limits={"frame_length": ["101 mm", "200 mm"]}), DESIGN, PHI) == {"frame length"}
    swings = oracle.direct(DESIGN, np.linspace(0.0, TURN, 100_001)).output
    swing = math.degrees(float(np.ptp(np.unwrap(swings))))
    assert failed(planted(limits={"swing_angle": [f"{swing - 0.01} deg", f"{swing + 0.01} deg"]}), DESIGN, PHI) == set()
    assert failed(planted(limits={"swing_angle": [f"{swing + 0.01} deg", "170 deg"]}), DESIGN, PHI) == {"swing"}
    assert failed(planted(limits={"time_ratio": [3.0, 4.0]}), DESIGN, PHI) == {"time ratio"}


def test_pivot_outside_its_region() -> None:
    d = DESIGN["x"] + 100.0 * math.cos(DESIGN["direction"])
    for low, high, expected in ((-31.0, d + 0.1, set()), (-29.9, d + 0.1, {"pivots"}), (-31.0, d - 0.1, {"pivots"})):
        region = {"pivots": {"x": [f"{low} mm", f"{high} mm"]}}
        assert failed(planted(limits=region), DESIGN, PHI) == expected
    assert failed(planted(limits={"pivots": {"y": ["13 mm", "200 mm"]}}), DESIGN, PHI) == {"pivots"}


def test_degrees_for_radians() -> None:
    turned = {**DESIGN, "direction": math.degrees(DESIGN["direction"])}
    assert "objective" in failed(planted(), turned, PHI, 0.0)
    assert "bounds" in failed(planted(), turned, PHI, 0.0)
    assert "one revolution" in failed(planted(), DESIGN, np.degrees(PHI), 0.0)
    poses = oracle.planted_poses(DESIGN, PHI, 0.3)
    assert failed(planted(points=poses), DESIGN, PHI, 0.0, mark=0.3) == set()
    assert {"objective", "bounds"} <= failed(planted(points=poses), DESIGN, PHI, 0.0, mark=math.degrees(0.3))
    assert "objective" in failed(planted(points=poses), DESIGN, PHI, 0.0, mark=-0.3)


def test_crank_angles_that_were_not_prescribed() -> None:
    problem = planted(crank=PHI)
    assert failed(problem, DESIGN, PHI, 0.0) == set()
    late = PHI.copy()
    late[2] += 1e-6
    assert failed(problem, DESIGN, late) == {"timing"}
    begun = planted(crank=PHI - PHI[0], timing="from start")
    assert failed(begun, DESIGN, PHI, 0.0, start=float(PHI[0])) == set()
    assert "timing" in failed(begun, DESIGN, PHI, 0.0, start=float(PHI[0]) + 0.01)


def test_points_at_close_crank_angles_are_met_in_order() -> None:
    """The least crank rotation between two points is one of the search: prescribed angles can be closer."""
    close = np.append(PHI, PHI[-1] + np.array([2e-5, 4e-5]))
    assert failed(planted(points=oracle.planted_path(DESIGN, close), crank=close), DESIGN, close, 0.0) == set()
    assert failed(planted(points=oracle.planted_path(DESIGN, close)), DESIGN, close, 0.0) == {"order"}


@pytest.mark.parametrize("way", [1.0, -1.0])
@pytest.mark.parametrize("timing", ["given", "from start"])
def test_another_point_one_revolution_later_is_refused(way: float, timing: str) -> None:
    crank = way * np.append(PHI[:-1], PHI[0] + TURN)
    spots = oracle.planted_path(DESIGN, crank)
    planted(points=spots, crank=crank, timing=timing)
    spots[-1, 0] += 0.01
    with pytest.raises(
        InputError, match=r"requirement\.points: point 6, at .* deg, lies one revolution after point 1, but elsewhere"
    ):
        planted(points=spots, crank=crank, timing=timing)


def test_a_size_beyond_its_bound() -> None:
    assert failed(planted(), {**DESIGN, "rocker": 401.0, "frame": 400.0, "coupler": 90.0}, PHI) & {"bounds"}
    shifted = {**DESIGN, "x": 401.0}
    assert failed(planted(limits={}), shifted, PHI) == {"bounds"}


def test_linkages_that_never_assemble() -> None:
    """No exception and no pass: figures that are not numbers fail."""
    apart = {**DESIGN, "coupler": 5.0, "rocker": 6.0}
    computed = failed(planted(limits={}), apart, PHI, 0.0)
    assert {"reached", "assembled", "objective"} <= computed


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(15))
def test_validator_and_oracle_agree_on_random_linkages(seed: int) -> None:
    """Any four lengths, any points, in and out of order: valid by the one is free of defects by the other."""
    rng = np.random.default_rng(seed)
    for _ in range(4):
        bars = [float(v) for v in rng.uniform(20.0, 120.0, 4)]
        x, y, along, across = (float(v) for v in rng.uniform(-50.0, 50.0, 4))
        mode = int(rng.choice([-1, 1]))
        design = oracle.four_bar(*bars, x=x, y=y, direction=float(rng.uniform(-3.0, 3.0)), along=along, across=across, mode=mode)
        count = int(rng.integers(3, 8))
        phi = oracle.random_angles(rng, count, float(rng.uniform(0.5, TURN)))
        if rng.random() < 0.3:
            rng.shuffle(phi)
        spots = oracle.random_points(rng, count)
        crank = str(rng.choice(["full rotation", "double-crank", "span"]))
        problem = model(document(four_bar_section("left" if mode > 0 else "right"), spots, {"crank": crank}))
        proof = validate_path(problem, quantities(design), phi)
        report = oracle.judge_path(design, spots, phi)
        if abs(report.margin) < 1e-3 or abs(report.turn_margin) < 1e-3:
            continue
        whole = report.order_ok and report.circuit_ok and report.branch_ok
        if crank != "span":
            shortest = "crank" if crank == "full rotation" else "frame"
            whole = whole and report.turns and design[shortest] == min(bars)
        assert proof.valid == whole, (crank, [check.name for check in proof.checks if not check.passed])
        if np.all(np.isfinite(report.errors)):
            assert 1e6 * proof.objective == pytest.approx(report.sse, rel=1e-8)
