"""The oracle of synthesis: against published and own reference designs, its two routes against one another, planted defects."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.optimize import least_squares

from tests import synthesis_oracle as oracle
from tests.synthesis_oracle import TURN, four_bar, judge_function, judge_motion, judge_path, slider_crank

DEG = math.pi / 180.0
CLOSED18 = np.array(
    [
        *[(0.5, 1.1), (0.4, 1.1), (0.3, 1.1), (0.2, 1.0), (0.1, 0.9), (0.05, 0.75), (0.02, 0.6), (0, 0.5), (0, 0.4)],
        *[(0.03, 0.3), (0.1, 0.25), (0.15, 0.2), (0.2, 0.3), (0.3, 0.4), (0.4, 0.5), (0.5, 0.7), (0.6, 0.9), (0.6, 1.0)],
    ]
)
CLOSED18_DESIGN = four_bar(
    *(0.77763390, 0.31274881, 0.44190043, 0.67456341),
    x=0.54830861,
    y=0.71651210,
    direction=-0.34872302,
    along=-0.04078607,
    across=-0.35456335,
    mode=-1,
)
CLOSED18_STEPS = 20.0 * DEG * np.arange(18)
ARC5 = np.array([(3, 3), (2.759, 3.363), (2.372, 3.663), (1.89, 3.862), (1.355, 3.943)])
ARC5_STEPS = DEG * np.array([30.0, 45.0, 60.0, 75.0, 90.0])
LOG10 = four_bar(1.0, 3.35102208, 0.84612397, 3.48434525, mode=-1)

KINDS = {
    "crank-rocker": oracle.random_crank_rocker,
    "double crank": oracle.random_double_crank,
    "slider-crank": oracle.random_slider_crank,
}
# crank pins of these swing only: (frame, crank, coupler, rocker)
ONE_CIRCUIT = four_bar(100.0, 80.0, 60.0, 70.0, x=5.0, y=-3.0, direction=0.4, along=40.0, across=30.0)  # not Grashof
TWO_CIRCUITS = four_bar(100.0, 80.0, 30.0, 70.0, x=5.0, y=-3.0, direction=0.4, along=40.0, across=30.0)  # coupler shortest


@pytest.fixture(params=KINDS)
def kind(request: pytest.FixtureRequest) -> str:
    return str(request.param)


def designs(kind: str, n: int, seed: int = 0) -> list[dict[str, float]]:
    rng = np.random.default_rng([seed, *map(ord, kind)])
    return [KINDS[kind](rng) for _ in range(n)]


def inside(design: oracle.Design, n: int, share: float = 0.9, which: int = 0) -> np.ndarray:
    """Crank angles in the middle of a range over which the linkage assembles."""
    low, high = oracle.assembled(design)[which]
    return 0.5 * (low + high) + 0.5 * share * (high - low) * np.linspace(-1.0, 1.0, n)


# --- reference values --------------------------------------------------------------------------------------------------------


def test_closed18() -> None:
    report = judge_path(CLOSED18_DESIGN, CLOSED18, 0.89155582 + CLOSED18_STEPS, closed=True, timed=CLOSED18_STEPS)
    assert report.sse == pytest.approx(0.0090288846, abs=1e-10)
    assert report.free
    assert report.rotation == 1
    assert report.timing < 1e-12
    assert report.start == pytest.approx(0.89155582)
    assert np.sum(report.nearest**2) < 0.6 * report.sse  # untimed, the same curve is nearer
    assert np.all(report.nearest <= report.local + 1e-12)
    assert np.all(report.local <= report.errors + 1e-12)
    whole, _ = oracle.distance_to_curve(CLOSED18, CLOSED18_DESIGN)
    assert np.all(whole <= report.nearest + 1e-12)


def test_closed18_is_at_a_minimum() -> None:
    names = ("frame", "crank", "coupler", "rocker", "x", "y", "direction", "along", "across")
    for name in names:
        for by in (-1e-4, 1e-4):
            moved = {**CLOSED18_DESIGN, name: CLOSED18_DESIGN[name] + by}
            errors = oracle.direct(moved, 0.89155582 + CLOSED18_STEPS).p - oracle.complex_points(CLOSED18)
            assert np.sum(np.abs(errors) ** 2) > 0.0090288846


def test_arc5_is_found_again() -> None:
    targets = oracle.complex_points(ARC5)

    def design(v: np.ndarray) -> dict[str, float]:
        return four_bar(*v[:4], along=v[4], across=v[5])

    def errors(v: np.ndarray) -> np.ndarray:
        result = oracle.direct(design(v), ARC5_STEPS).p - targets
        return np.concatenate([result.real, result.imag])

    result = least_squares(errors, [3.6, 2.0, 3.9, 2.7, 1.6, 1.7], xtol=1e-15, ftol=1e-15, gtol=1e-15)
    report = judge_path(design(result.x), ARC5, ARC5_STEPS, timed=ARC5_STEPS)
    assert report.sse == pytest.approx(7.4158e-7, rel=1e-5)
    assert report.free
    assert report.start == pytest.approx(0.0, abs=1e-12)


def test_log10() -> None:
    x = np.linspace(1.0, 2.0, 2001)
    report = judge_function(LOG10, 51.753277 * DEG, 77.847630 * DEG, 60.0 * DEG * (x - 1.0), 60.0 * DEG * np.log2(x))
    assert report.largest / DEG == pytest.approx(0.003676, abs=1e-6)
    assert report.branch_ok
    assert report.circuit_ok
    assert report.margin >= 0.5
    error = report.errors
    turns = np.flatnonzero(np.diff(np.sign(np.diff(error)))) + 1
    peaks = error[[0, *turns, -1]]
    assert len(peaks) == 6
    assert np.all(peaks[1:] * peaks[:-1] < 0.0)
    assert np.max(np.abs(peaks)) - np.min(np.abs(peaks)) < 2e-5 * DEG
    swapped = judge_function(
        {**LOG10, "mode": 1}, 51.753277 * DEG, 77.847630 * DEG, 60.0 * DEG * (x - 1.0), 60.0 * DEG * np.log2(x)
    )
    assert swapped.largest > 10.0 * DEG
    assert not swapped.branch_ok


def test_best_transmission_for_a_swing() -> None:
    design = four_bar(120.0, 46.67, 116.16, 73.88)
    turning = oracle.turns_fully(design)
    assert turning.turns
    assert math.asin(turning.margin) / DEG == pytest.approx(37.733, abs=0.01)
    output = oracle.planted_outputs(design, np.linspace(0.0, TURN, 20001))
    assert np.ptp(output) / DEG == pytest.approx(80.0, abs=0.02)
    ratio = np.mod(np.argmax(output) - np.argmin(output), 20000) / 20000.0  # of the revolution in which it swings one way
    assert max(ratio, 1.0 - ratio) / min(ratio, 1.0 - ratio) == pytest.approx(10.0 / 9.0, abs=2e-3)


def test_sensitivities() -> None:
    table = np.array(
        [
            (0, 103.533936, -0.382699, -0.457120, 0.153498, 0.382699),
            (60, 105.157531, -0.328158, -0.431796, 0.032414, 0.407123),
            (120, 129.480461, 0.140934, -0.481177, -0.214789, 0.468903),
            (240, 147.377012, 0.420297, -0.481177, -0.214789, 0.413031),
        ]
    )
    bars = {"crank": 1.0, "coupler": 4.12865417, "rocker": 2.3224617, "frame": 5.0}

    def output(**changed: float) -> np.ndarray:
        return oracle.direct(four_bar(**{**bars, **changed}), table[:, 0] * DEG).output

    np.testing.assert_allclose(output() / DEG, table[:, 1], atol=1e-6)
    for column, (name, length) in enumerate(bars.items(), start=2):
        rate = (output(**{name: length + 1e-5}) - output(**{name: length - 1e-5})) / 2e-5
        np.testing.assert_allclose(rate, table[:, column], atol=1e-6)


# --- the two routes -----------------------------------------------------------------------------------------------------------


def test_routes_agree(kind: str) -> None:
    for design in designs(kind, 25):
        phi = np.linspace(-0.3, 6.5, 60)
        at = oracle.direct(design, phi)
        p, angle = oracle.curve(design, phi)
        assert np.max(np.abs(p - at.p)) < 1e-11 * oracle.size(design)
        assert np.max(np.abs(oracle.wrapped(angle - at.angle))) < 1e-11
        assert np.max(np.abs(np.diff(angle))) < math.pi  # continuous
        result = oracle.follow(design, phi)
        assert np.max(np.abs(result.sine**2 - at.closure)) < 1e-11
        assert np.all(result.sine * design["mode"] > 0.0)


@pytest.mark.parametrize(("base", "mode"), [(ONE_CIRCUIT, 1), (TWO_CIRCUITS, -1)])
def test_routes_agree_where_it_swings(base: dict[str, float], mode: int) -> None:
    design = {**base, "mode": mode}
    ranges = oracle.assembled(design)
    assert len(ranges) == (1 if base is ONE_CIRCUIT else 2)
    phi = np.linspace(0.0, TURN, 180)
    at, (p, _) = oracle.direct(design, phi), oracle.curve(design, phi)
    within = np.any([(phi >= low) & (phi <= high) | (phi + TURN <= high) for low, high in ranges], axis=0)
    assert np.array_equal(np.isfinite(at.p), within)
    assert np.array_equal(np.isfinite(p), within)
    assert np.max(np.abs(p - at.p)[within]) < 1e-9 * oracle.size(design)


def test_links_have_their_lengths(kind: str) -> None:
    """Closure, mode and coupler point by the definitions."""
    for design in designs(kind, 10, seed=1):
        at = oracle.direct(design, np.linspace(0.0, TURN, 100))
        a, e = complex(design["x"], design["y"]), np.exp(1j * design["direction"])
        tolerance = 1e-11 * oracle.size(design)
        assert np.max(np.abs(np.abs(at.b - a) - design["crank"])) < tolerance
        assert np.max(np.abs(np.abs(at.c - at.b) - design["coupler"])) < tolerance
        rod = (at.c - at.b) / design["coupler"]
        assert np.max(np.abs(at.p - at.b - complex(design["along"], design["across"]) * rod)) < tolerance
        assert np.max(np.abs(np.exp(1j * at.angle) - rod)) < 1e-12
        if kind == "slider-crank":
            from_guide = (at.c - complex(design["guide_x"], design["guide_y"])) / e
            assert np.max(np.abs(from_guide - at.output - 1j * design["offset"])) < tolerance
            assert np.all((rod / e).real * design["mode"] > 0.0)
            assert abs(at.b[0] - a - design["crank"]) < tolerance
        else:
            d = a + design["frame"] * e
            assert np.max(np.abs(at.c - d - design["rocker"] * e * np.exp(1j * at.output))) < tolerance
            assert np.all(((d - at.b).conj() * (at.c - at.b)).imag * design["mode"] > 0.0)
            assert abs(at.b[0] - a - design["crank"] * e) < tolerance


@pytest.mark.slow
def test_random_swinging_linkages() -> None:
    """Whole range of the crank, all but the ends, is one branch and one circuit; the ends are where the modes meet."""
    rng = np.random.default_rng(20)
    swinging = 0
    for k in range(16):
        place = {"direction": rng.uniform(-3.0, 3.0), "along": rng.uniform(-80.0, 80.0), "mode": int(rng.choice([-1, 1]))}
        if k % 2:
            design = four_bar(*rng.uniform(10.0, 100.0, 4), **place)
        else:
            design = slider_crank(*rng.uniform(10.0, 100.0, 2), offset=rng.uniform(-60.0, 60.0), **place)
        ranges = oracle.assembled(design)
        assert (ranges == [(0.0, TURN)]) == oracle.turns_fully(design, 180).turns
        for low, high in ranges if ranges != [(0.0, TURN)] else []:
            swinging += 1
            assert np.max(np.abs(oracle.direct(design, [low, high]).closure)) < 1e-11
            assert np.all(np.isnan(oracle.direct(design, [low - 1e-6, high + 1e-6]).p))
            phi = low + (high - low) * np.linspace(0.001, 0.999, 12)
            report = judge_path(design, oracle.planted_path(design, phi), phi)
            assert report.sse < 1e-20
            assert report.order_ok
            assert report.branch_ok
            assert report.circuit_ok
            assert not report.turns
    assert swinging >= 6


def test_coupler_pin_stays_on_the_guide() -> None:
    design = slider_crank(20.0, 60.0, x=3.0, y=4.0, guide=(10.0, -7.0), direction=0.7, offset=15.0, along=60.0)
    p = (oracle.curve(design, np.linspace(0.0, TURN, 50))[0] - complex(10.0, -7.0)) * np.exp(-0.7j)
    assert np.max(np.abs(p.imag - 15.0)) < 1e-11


# --- turning ------------------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_turning_against_grashof() -> None:
    rng = np.random.default_rng(3)
    both = [0, 0]
    for _ in range(80):
        frame, crank, coupler, rocker = rng.uniform(10.0, 100.0, 4)
        # the crank turns if its two positions along the frame assemble
        closes = all(abs(coupler - rocker) < long < coupler + rocker for long in (abs(frame - crank), frame + crank))
        turning = oracle.turns_fully(four_bar(frame, crank, coupler, rocker, mode=int(rng.choice([-1, 1]))), 180)
        assert turning.turns == closes
        assert (turning.margin > 0.0) == closes
        both[closes] += 1
    assert min(both) > 10


def test_margin_of_the_slider_crank() -> None:
    turning = oracle.turns_fully(slider_crank(20.0, 60.0, offset=10.0))
    assert turning.turns
    assert turning.margin == pytest.approx(math.sqrt(1.0 - 0.25), abs=1e-12)
    assert not oracle.turns_fully(slider_crank(20.0, 60.0, offset=45.0)).turns


@pytest.mark.parametrize(("share", "turns"), [(1.0 - 1e-9, True), (1.0 + 1e-9, False)])
def test_turning_at_the_limit(share: float, turns: bool) -> None:
    """Frame + crank equals coupler + rocker but for 1e-9: the continuation neither jumps a gap nor stops at a narrow place."""
    design = four_bar(100.0, 50.0 * share, 90.0, 60.0)
    assert oracle.turns_fully(design).turns == turns
    assert oracle.follow(design, [2.0, -2.0]).reached  # the way round that does not pass pi
    assert oracle.follow(design, [2.0, TURN - 2.0]).reached == turns


def test_parallelogram_does_not_turn() -> None:
    assert not oracle.turns_fully(four_bar(100.0, 40.0, 100.0, 40.0)).turns


def test_linkage_that_never_assembles() -> None:
    design = four_bar(100.0, 10.0, 20.0, 15.0)
    assert oracle.assembled(design) == []
    assert np.all(np.isnan(oracle.curve(design, [0.0, 1.0])[0]))
    report = judge_path(design, [(0.0, 0.0), (1.0, 1.0)], [0.0, 1.0])
    assert report.gain == math.inf
    assert report.sse == math.inf
    assert not any([report.branch_ok, report.circuit_ok, report.turns])


# --- distances ----------------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_distance_along_the_normal(kind: str) -> None:
    rng = np.random.default_rng(4)
    for design in designs(kind, 6, seed=2):
        phi = rng.uniform(0.0, TURN, 15)
        ahead, here, behind = (oracle.direct(design, phi + by).p for by in (1e-6, 0.0, -1e-6))
        normal = 1j * (ahead - behind) / np.abs(ahead - behind)
        on, _ = oracle.distance_to_curve(here, design)
        assert np.max(on) < 1e-12 * oracle.size(design)
        off, foot = oracle.distance_to_curve(here + 1e-3 * normal, design)
        clear = np.abs(oracle.wrapped(foot - phi)) < 1e-4  # of loops and tight bends
        assert np.count_nonzero(clear) >= 12
        np.testing.assert_allclose(off[clear], 1e-3, rtol=1e-8)
        np.testing.assert_allclose(off, np.abs(oracle.direct(design, foot).p - here - 1e-3 * normal), atol=1e-11)


@pytest.mark.parametrize("base", [CLOSED18_DESIGN, ONE_CIRCUIT, TWO_CIRCUITS])
def test_distance_against_dense_samples(base: dict[str, float]) -> None:
    rng = np.random.default_rng(5)
    reach = oracle.size(base)
    points = rng.uniform(-reach, reach, (20, 2))
    computed, _ = oracle.distance_to_curve(points, base)
    phi = np.concatenate(
        [0.5 * (h + low) - 0.5 * (h - low) * np.cos(np.linspace(0, math.pi, 20000)) for low, h in oracle.assembled(base)]
    )
    p = oracle.direct(base, phi).p
    dense = np.array([np.nanmin(np.abs(p - point)) for point in oracle.complex_points(points)])
    assert np.all(computed <= dense + 1e-7 * reach)
    np.testing.assert_allclose(computed, dense, atol=1e-5 * reach)


def test_feet() -> None:
    """Claimed angles beside the feet: what is lost is seen, point by point, and the part of the error along the curve."""
    rng = np.random.default_rng(6)
    design = designs("crank-rocker", 1, seed=7)[0]
    phi = oracle.random_angles(rng, 12)
    targets = oracle.planted_path(design, phi)
    exact = judge_path(design, targets, phi)
    assert exact.sse == 0.0
    assert exact.gain == 0.0
    aside = phi.copy()
    aside[4] += 0.01
    report = judge_path(design, targets, aside)
    assert report.free
    assert report.gain == pytest.approx(report.errors[4], rel=1e-9)
    assert report.nearest[4] < 1e-11 * oracle.size(design)
    assert report.local[4] < 1e-11 * oracle.size(design)
    assert report.foot[4] == pytest.approx(phi[4], abs=1e-10)
    assert report.tangential[4] == pytest.approx(report.errors[4], rel=1e-2)
    assert np.max(np.abs(np.delete(report.tangential, 4))) < 1e-11 * oracle.size(design)


# --- judges -------------------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("n", [1, 2, 5, 9, 18, 60])
def test_planted_designs_have_zero_error(kind: str, n: int) -> None:
    rng = np.random.default_rng(n)
    for design in designs(kind, 1, seed=n):
        phi = oracle.random_angles(rng, n)
        step = phi - phi[0]
        for angles in (phi, np.mod(phi, TURN), phi - 4.0 * math.pi):
            report = judge_path(design, oracle.planted_path(design, phi), angles, closed=n > 2, timed=step)
            assert report.free
            assert report.sse < (1e-12 * oracle.size(design)) ** 2
            assert report.timing < 1e-12
        if n > 2:  # of two, either way round is in order
            assert judge_path(design, oracle.planted_path(design, phi)[::-1], phi[::-1]).rotation == -1
        poses = oracle.planted_poses(design, phi, 0.3)
        for mark in (0.3, None):
            motion = judge_motion(design, poses, phi, mark, weight=50.0)
            assert motion.free
            assert motion.sse < (1e-12 * oracle.size(design)) ** 2
            assert motion.largest_angle < 1e-12
            assert motion.mark == pytest.approx(0.3)
            assert np.max(np.abs(motion.tangential)) < 1e-9 * oracle.size(design)
            assert np.max(motion.nearest) < 1e-9 * oracle.size(design)
        outputs = oracle.planted_outputs(design, phi)
        function = judge_function(design, phi[0], outputs[0], step, outputs - outputs[0])
        assert function.free
        assert function.largest < 1e-12 * oracle.size(design)


def test_closed_path_that_repeats_its_first_point() -> None:
    design = designs("crank-rocker", 1)[0]
    phi = 0.4 + np.linspace(0.0, TURN, 10)
    targets = oracle.planted_path(design, phi)
    assert judge_path(design, targets, phi, closed=True).free
    targets[-1] += 1.0
    assert not judge_path(design, targets, phi, closed=True).order_ok


@pytest.mark.slow
def test_swapped_mode() -> None:
    rng = np.random.default_rng(10)
    for name in KINDS:
        for design in designs(name, 2, seed=11):
            phi = oracle.random_angles(rng, 9)
            other = {**design, "mode": -design["mode"]}
            report = judge_path(other, oracle.planted_path(design, phi), phi)
            assert report.sse > 1.0
            assert report.other_sse < 1e-18
            assert not report.branch_ok
            assert np.all(report.modes == design["mode"])
            motion = judge_motion(other, oracle.planted_poses(design, phi), phi, 0.0)
            assert not motion.branch_ok
            mixed = np.where(np.arange(9)[:, None] < 5, oracle.planted_path(design, phi), oracle.planted_path(other, phi))
            report = judge_path(design, mixed, phi)
            assert not report.branch_ok
            assert report.modes.tolist() == [design["mode"]] * 5 + [other["mode"]] * 4
            outputs = oracle.planted_outputs(design, phi)
            assert not judge_function(other, 0.0, 0.0, phi, outputs).branch_ok


def test_wrong_order() -> None:
    rng = np.random.default_rng(12)
    design = designs("crank-rocker", 1, seed=13)[0]
    phi = oracle.random_angles(rng, 9)
    targets = oracle.planted_path(design, phi)
    swapped = np.array([0, 1, 2, 4, 3, 5, 6, 7, 8])
    report = judge_path(design, targets[swapped], phi[swapped])
    assert report.sse == 0.0
    assert report.rotation == 0
    assert not report.order_ok
    assert report.branch_ok
    assert report.circuit_ok
    assert judge_path(design, targets[swapped], phi[swapped], order=False).free
    assert not judge_path(design, targets[[0, *range(9)]], phi[[0, *range(9)]]).order_ok  # one angle twice
    assert not judge_path(design, targets[[*range(9), 1]], phi[[*range(9), 1]]).order_ok  # more than a revolution
    assert judge_path(design, targets[::-1], phi, timed=phi).sse > 1.0
    backwards = judge_path(design, targets[::-1], phi[::-1], timed=phi)
    assert backwards.rotation == -1
    assert backwards.timing > 0.1


def test_crank_that_does_not_turn() -> None:
    phi = inside(ONE_CIRCUIT, 9)
    targets = oracle.planted_path(ONE_CIRCUIT, phi)
    report = judge_path(ONE_CIRCUIT, targets, phi)
    assert report.sse < 1e-20
    assert report.order_ok
    assert report.branch_ok
    assert report.circuit_ok
    assert not report.turns
    assert not report.free
    assert report.turn_margin < 0.0 < report.margin
    closed = judge_path(ONE_CIRCUIT, targets, phi, closed=True)
    assert not closed.branch_ok
    assert not closed.circuit_ok
    shifted = phi + (phi[-1] - phi[0]) * 0.8
    beyond = judge_path(ONE_CIRCUIT, targets, shifted)
    assert beyond.sse == math.inf
    assert not beyond.branch_ok
    assert not beyond.circuit_ok
    # in the order in which the crank would have to pass through the gap
    through = np.array([6, 7, 8, 0, 1, 2])
    gap = judge_path(ONE_CIRCUIT, targets[through], phi[through])
    assert gap.sse < 1e-20
    assert gap.order_ok
    assert not gap.branch_ok
    assert not gap.circuit_ok


def test_two_circuits() -> None:
    one, two = inside(TWO_CIRCUITS, 4), inside(TWO_CIRCUITS, 4, which=1)
    assert judge_path(TWO_CIRCUITS, oracle.planted_path(TWO_CIRCUITS, one), one).circuit_ok
    phi = np.concatenate([one, two])
    targets = oracle.planted_path(TWO_CIRCUITS, phi)
    report = judge_path(TWO_CIRCUITS, targets, phi)
    assert report.sse < 1e-20
    assert report.order_ok
    assert not report.circuit_ok
    assert not report.branch_ok
    assert not judge_path(TWO_CIRCUITS, targets, phi, order=False).circuit_ok
    assert not judge_motion(TWO_CIRCUITS, oracle.planted_poses(TWO_CIRCUITS, phi), phi).circuit_ok
    function = judge_function(TWO_CIRCUITS, 0.0, 0.0, phi, oracle.direct(TWO_CIRCUITS, phi).output)
    assert function.largest < 1e-12
    assert not function.circuit_ok
    assert not function.branch_ok


def test_wrong_angles_of_a_motion() -> None:
    design = designs("double crank", 1, seed=14)[0]
    phi = oracle.random_angles(np.random.default_rng(15), 5)
    poses = oracle.planted_poses(design, phi, 0.2)
    poses[2, 2] += 0.01 + TURN
    report = judge_motion(design, poses, phi, 0.2)
    assert report.sse < 1e-20
    np.testing.assert_allclose(report.angle_errors, [0.0, 0.0, -0.01, 0.0, 0.0], atol=1e-12)
    assert judge_motion(design, poses, phi, None).largest_angle == pytest.approx(0.008, rel=1e-3)
    weighted = judge_motion(design, poses, phi, 0.2, weight=50.0)  # the place gives way for the angle, if only a little
    assert 0.0 < weighted.gain < 0.5
    assert weighted.nearest[2] < 0.5
    assert abs(weighted.tangential[2]) > 1e-3


# --- random tasks -------------------------------------------------------------------------------------------------------------


def test_random_designs(kind: str) -> None:
    assert designs(kind, 5) == designs(kind, 5)
    modes = set()
    for design in designs(kind, 25, seed=16):
        modes.add(design["mode"])
        turning = oracle.turns_fully(design, 120)
        assert turning.turns
        assert turning.margin >= math.sin(15.0 * DEG) - 1e-12
        assert max(abs(design["along"]), abs(design["across"])) <= 150.0
        assert all(type(value) in (int, float) for value in design.values())
        lengths = sorted(design[key] for key in ("crank", "coupler", "frame", "rocker") if key in design)
        assert lengths[-1] <= 20.0 * lengths[0]
        if kind != "slider-crank":
            assert design["frame"] == 100.0
            assert lengths[0] == design["crank" if kind == "crank-rocker" else "frame"]
            assert lengths[0] + lengths[3] <= 0.98 * (lengths[1] + lengths[2])
    assert modes == {-1, 1}


def test_random_requirements() -> None:
    for seed in range(20):
        same = [np.random.default_rng(seed) for _ in range(2)]
        curves = [oracle.random_closed_curve(rng, 40) for rng in same]
        assert np.array_equal(*curves)
        steps = np.abs(np.diff(curves[0], axis=0, append=curves[0][:1])).max(axis=1)
        assert steps.max() < 0.5 * np.ptp(curves[0])  # the end is as near the start as any two points
        assert oracle.random_points(same[0], 7).shape == (7, 2)
        assert oracle.random_poses(same[0], 7).shape == (7, 3)
        phi = oracle.random_angles(same[0], 18)
        assert np.all(np.diff(phi) > 0.2 * TURN / 18 - 1e-12)
        assert phi[-1] - phi[0] < TURN


@pytest.mark.parametrize("monotone", [True, False])
def test_random_laws(monotone: bool) -> None:
    names = set()
    for seed in range(60):
        law = oracle.random_law(np.random.default_rng(seed), monotone)
        names.add(law.name)
        phi, psi = law.offsets(201)
        assert phi[0] == 0.0
        assert phi[-1] == pytest.approx(law.input_range)
        assert psi.min() >= -1e-15
        assert psi.max() <= law.output_range * (1.0 + 1e-12)
        assert psi.max() - psi.min() == pytest.approx(law.output_range, rel=1e-3)
        assert bool(np.all(np.diff(psi) > 0.0) or np.all(np.diff(psi) < 0.0)) == monotone
        names_known = {name: getattr(np, name) for name in ("exp", "log", "log10", "sin", "cos", "tan", "sqrt")}
        x = np.linspace(law.low, law.high, 7)
        text = law.expression.replace("^", "**")
        np.testing.assert_allclose(eval(text, {**names_known, "x": x}), law.value(x), rtol=1e-14)  # noqa: S307
    assert len(names) > (7 if monotone else 3)
