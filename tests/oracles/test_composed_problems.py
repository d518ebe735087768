"""The optima of problems with two demands: published figures, a second route to each, and neighbours that are worse."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from scipy.optimize import nnls

from tests.oracles import composed_problems as composed


@pytest.mark.slow
def test_the_straightest_line_with_equal_links() -> None:
    answer = composed.straight_line()
    assert answer.optimum == pytest.approx(2.1404e-4, rel=1e-4)
    assert answer.figures == pytest.approx({"frame": 2.49366, "coupler": 3.24050, "travel": 3.61834, "speed": 0.2030}, rel=1e-3)


def test_two_wipers_swing_as_far_as_they_must() -> None:
    answer = composed.two_wipers()
    wanted = {"crank": 60.0, "coupler 1": 395.4744, "rocker 1": 84.8528, "coupler 2": 239.5558, "rocker 2": 93.3434}
    assert {name: answer.figures[name] for name in wanted} == pytest.approx(wanted, abs=6e-5)
    assert answer.optimum == pytest.approx(44.3405, abs=6e-5)
    for number, frame, swing in ((1, 400.0, 90.0), (2, 250.0, 80.0)):  # by motion, not by the closed form
        b = 60.0 * np.exp(1j * np.linspace(0.0, 2.0 * math.pi, 20001))
        c = composed.third(b, complex(frame), answer.figures[f"coupler {number}"], answer.figures[f"rocker {number}"], 1.0)
        output = np.unwrap(np.angle(c - frame))
        assert math.degrees(np.ptp(output)) == pytest.approx(swing, abs=1e-5)
        first, last = np.argmax(output[:-1]), np.argmin(output[:-1])
        assert abs(int(first - last)) == pytest.approx(10000, abs=2)  # half a revolution
        gamma = np.degrees(np.abs(np.angle((b - c) / (frame - c))))
        assert min(np.min(gamma), 180.0 - np.max(gamma)) == pytest.approx(answer.figures[f"transmission {number}"], abs=1e-5)


def test_poses_and_a_law_of_one_four_bar() -> None:
    answer = composed.poses_and_law()
    assert answer.optimum < 1e-20
    assert answer.figures["least singular value"] > 0.1
    wanted = {
        **{"x 1": 64.4926, "y 1": 77.7208, "angle 1": 36.955, "x 2": 52.9819, "y 2": 93.4801, "angle 2": 21.8859},
        **{"x 3": 13.2776, "y 3": 79.5268, "angle 3": 20.5252, "rocker 1": 86.0653, "rocker 2": 89.8477, "rocker 3": 111.9832},
        **{"rocker 4": 141.018, "rocker 5": 143.3925, "rocker 6": 128.0609},
    }
    assert {name: answer.figures[name] for name in wanted} == pytest.approx(wanted, abs=6e-5)


def test_the_symmetric_steering_trapezoid() -> None:
    answer = composed.steering_trapezoid()
    assert answer.optimum == pytest.approx(0.8717, abs=6e-5)
    assert answer.figures == pytest.approx({"inner": 40.6013, "beta": 17.863, "tie rod": 2154.60}, rel=5e-5)
    outer = 1.0 / (1.0 / math.tan(math.radians(40.0)) + 0.5)
    narrower = composed.steering_trapezoid(outer=outer)
    assert narrower.figures["inner"] == pytest.approx(40.0)
    assert narrower.optimum == pytest.approx(0.82347, abs=1e-5)


def test_a_path_as_two_edges_misses_half_the_distances() -> None:
    answer = composed.path_of_two_edges()
    assert answer.optimum == pytest.approx(answer.figures["half the squared distances"], rel=1e-12)
    assert {name: answer.figures[name] for name in composed.PLANTED} == pytest.approx(composed.PLANTED, rel=1e-6)


@pytest.mark.slow
def test_no_smaller_machine_follows_the_law() -> None:
    answer = composed.smallest_machine()
    assert answer.optimum == pytest.approx(642.80545, abs=1e-4)
    assert answer.optimum < answer.figures["least of the grid"] < answer.optimum + 5.0
    assert composed.smallest_machine(2.6).optimum < answer.optimum < composed.smallest_machine(2.4).optimum


@pytest.mark.slow
def test_the_smallest_four_bar_of_five_poses() -> None:
    answer = composed.smallest_of_exact_poses()
    assert len(composed.dyads_of_poses()) == 4
    assert answer.figures["designs"] == 4.0
    assert answer.optimum == pytest.approx(58.954, abs=6e-4)
    assert answer.figures["transmission"] == pytest.approx(61.5, abs=0.05)


def test_the_torque_is_the_change_of_energy() -> None:
    """Energy by differences of positions; the torque of the path's optimum as an inverse dynamics told it."""
    x, phi, h = composed.PATH_OPTIMUM * 1e-3, np.linspace(0.0, 2.0 * math.pi, 37), 1e-5

    def energy(phi: np.ndarray) -> np.ndarray:
        turned = np.exp(1j * x[8])

        def places(phi: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            b = x[0] * np.exp(1j * phi)
            return b, composed.third(b, complex(x[3]), x[1], x[2], -1.0)

        before, after = places(phi - h), places(phi + h)
        ends = [(0.0 * b, b, c, x[3] + 0.0 * b) for b, c in (before, places(phi), after)]
        total = np.zeros(len(phi))
        for k, mass in enumerate(composed.MASSES):
            bars = [(each[k], each[k + 1]) for each in ends]
            rate = [composed.SPEED * (bars[2][i] - bars[0][i]) / (2.0 * h) for i in (0, 1)]
            total += (
                mass / 6.0 * (np.abs(rate[0]) ** 2 + np.abs(rate[1]) ** 2 + (rate[0] * np.conj(rate[1])).real)
            )  # a uniform bar
            total += mass * composed.GRAVITY * (0.5 * turned * (bars[1][0] + bars[1][1])).imag
        return total

    torque = (energy(phi + 1e-4) - energy(phi - 1e-4)) / 2e-4
    assert composed.driving_torque(x, phi) == pytest.approx(torque, abs=1e-5)
    assert composed.peak_torque(x) == pytest.approx(0.44633792, abs=1e-6)


@pytest.mark.slow
def test_the_path_of_a_limited_torque_and_the_torque_of_a_limited_path_are_the_same() -> None:
    alone = composed.path_alone()
    assert alone.optimum == pytest.approx(6.87692799e-7, rel=1e-8)  # best of 12000 starts of the shipped problem path-bean
    limit = 0.9 * alone.figures["peak torque"]
    limited = composed.path_within_torque(limit, starts=1)
    assert limited.figures["rms"] == pytest.approx(0.7581308, abs=1e-6)
    assert limited.figures["peak torque"] == pytest.approx(limit, rel=1e-7)
    back = composed.least_torque(limited.figures["rms"], "rms", starts=1)
    assert back.optimum == pytest.approx(limit, rel=1e-6)
    assert back.figures["rms"] == pytest.approx(limited.figures["rms"], rel=1e-7)


@pytest.mark.slow
def test_least_torque_within_half_a_millimetre() -> None:
    rms, largest = composed.least_torque(0.5, "rms", starts=4), composed.least_torque(0.5, starts=4)
    assert rms.optimum == pytest.approx(0.4143067, abs=1e-6)
    assert largest.optimum == pytest.approx(0.4251681, abs=1e-6)
    assert largest.figures["largest"] == pytest.approx(0.5, rel=1e-7)
    names = ("crank", "coupler", "rocker", "frame", "along", "across", "A.x", "A.y")
    x = np.array([*(1e-3 * largest.figures[name] for name in names), math.radians(largest.figures["direction"])])
    at = composed.peaks(x)

    def torques(x: np.ndarray) -> np.ndarray:
        return np.abs(composed.driving_torque(x, at)) / largest.optimum

    def slopes(function: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
        steps = 1e-6 * np.diag(composed.SIZE)
        return np.column_stack([(function(x + step) - function(x - step)) / 2e-6 for step in steps])

    high = slopes(torques)[torques(x) > 1.0 - 1e-6]  # Karush, Kuhn and Tucker: the slopes of what is active balance each other
    far = slopes(composed.distances)[composed.distances(x) > 0.5e-3 * (1.0 - 1e-6)] / 0.5e-3
    ends = np.eye(9)[x > composed.HIGH * (1.0 - 1e-9)]
    columns = np.vstack(
        [np.column_stack([high, np.ones(len(high))]), *(np.column_stack([part, np.zeros(len(part))]) for part in (far, ends))]
    )
    multipliers, residual = nnls(columns.T, np.append(np.zeros(9), 1.0))
    assert residual < 1e-5
    assert np.count_nonzero(multipliers) >= 3
