"""Motion laws against textbook peak factors, differences, complex steps, jets, casadi, and scipy's splines."""

from __future__ import annotations

import math
from dataclasses import replace

import casadi
import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy.interpolate import CubicSpline

from optlink.linkage.jet import Jet
from optlink.linkage.laws import SEGMENTS, Law, MotionLaw, Piece, Segment, accelerated, joined, spline
from optlink.symbolic import symbols_in_numpy
from tests.tiers import examples

seeded = examples(60)
NAMES = list(SEGMENTS)
MOVING = [name for name in NAMES if name != "dwell"]

# largest velocity, acceleration and jerk of a rise of 1 in a time of 1: Norton, Cam Design and Manufacturing Handbook, table 3-2;
# the jerk of a law whose acceleration jumps is infinite there and stands without its jumps here
PEAKS = {
    "constant": (1.0, 0.0, 0.0),
    "trapezoidal": (1.5, 4.5, 0.0),
    "harmonic": (math.pi / 2.0, math.pi**2 / 2.0, math.pi**3 / 2.0),
    "cycloidal": (2.0, 2.0 * math.pi, 4.0 * math.pi**2),
    "3-4-5": (15.0 / 8.0, 10.0 / math.sqrt(3.0), 60.0),
    "4-5-6-7": (35.0 / 16.0, 7.5132, 52.5),
    "modified sine": (4.0 * math.pi / (4.0 + math.pi), 5.5279, 69.4664),
    "modified trapezoidal": (2.0, 8.0 * math.pi / (2.0 + math.pi), 61.426),
}


def two_ways() -> Law:
    """Return a closed law of many kinds of pieces, from 2.5 to 6.3 s."""
    ways = [("modified sine", 0.4, 1.2), ("dwell", 0.2, 9.0), ("trapezoidal", 0.6, -0.4), ("modified trapezoidal", 0.5, 0.7)]
    ways += [("4-5-6-7", 0.7, 0.1), ("constant", 0.3, 0.3), ("cycloidal", 0.6, 0.8), ("harmonic", 0.5, 0.2)]
    return joined(0.2, [Segment(time, to, name) for name, time, to in ways], begin=2.5)


def samples(law: MotionLaw, count: int = 7) -> np.ndarray:
    """Return points between all knots, away from them."""
    knots = np.array(law.knots)
    return (knots[:-1, None] + np.diff(knots)[:, None] * np.linspace(0.07, 0.93, count)).ravel()


# --- the laws of a segment -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", MOVING)
def test_peak_factors_are_those_of_the_textbook(name: str) -> None:
    law = SEGMENTS[name]
    for order, peak in enumerate(PEAKS[name], start=1):
        extremes = law.extremes(order)
        assert max(-extremes.least, extremes.largest) == pytest.approx(peak, rel=2e-5 if order > 1 else 1e-12, abs=1e-12)
    assert set(PEAKS) == set(MOVING)


@pytest.mark.parametrize("name", NAMES)
def test_a_segment_goes_from_zero_to_one_at_rest(name: str) -> None:
    law, end = SEGMENTS[name], 0.0 if name == "dwell" else 1.0
    assert law(0.0) == pytest.approx(0.0, abs=1e-15)
    assert law(1.0) == pytest.approx(end, abs=2e-15)
    assert law.advance == pytest.approx(end, abs=2e-15)
    if name != "constant":
        assert law.jump(1)[0] == 0.0
        assert law.derivative(np.array([0.0, 1.0]), 1) == pytest.approx(0.0, abs=1e-14)
    x = np.linspace(0.0, 1.0, 41)
    assert law(x) + law(1.0 - x) == pytest.approx(end, abs=1e-14)  # all of them are symmetrical


def test_the_jumps_of_the_acceleration_are_found() -> None:
    jumps = {name: SEGMENTS[name].jump(2)[0] for name in NAMES}
    smooth = {"dwell", "constant", "3-4-5", "4-5-6-7", "cycloidal", "modified sine", "modified trapezoidal"}
    assert {name for name in NAMES if jumps[name] == 0.0} == smooth
    assert jumps["harmonic"] == pytest.approx(math.pi**2 / 2.0)
    assert jumps["trapezoidal"] == pytest.approx(4.5)
    assert SEGMENTS["constant"].jump(1) == (1.0, 0.0)
    assert SEGMENTS["cycloidal"].jump(3)[0] == pytest.approx(4.0 * math.pi**2)
    assert SEGMENTS["4-5-6-7"].jump(3)[0] == 0.0


def test_another_profile_of_the_acceleration() -> None:
    quarter = math.pi / 2.0
    law = accelerated([(0.2, quarter, quarter), (0.6, 0.0, 0.0), (0.2, -quarter, -quarter)])
    assert law.extremes(1).largest == pytest.approx(1.25)
    assert law.extremes(2)[::2] == pytest.approx((-6.25, 6.25))
    assert (law.jump(1)[0], law.jump(2)[0]) == (0.0, pytest.approx(6.25))


# --- derivatives and number types ------------------------------------------------------------------------------------


def test_derivatives_are_those_of_a_complex_step_and_of_differences() -> None:
    law = two_ways()
    x = samples(law)
    step = np.repeat(0.015 * np.diff(law.knots), 7)
    weights = np.array([3, -32, 168, -672, 0, 672, -168, 32, -3]) / 840.0
    for order in range(4):
        derivative = law.derivative(x, order + 1)
        complex_step = np.imag(law.derivative(x + 1e-30j, order)) / 1e-30
        assert derivative == pytest.approx(complex_step, rel=1e-13, abs=1e-10)
        scale = np.max(np.abs(derivative))
        difference = sum(w * law.derivative(x + k * step, order) / step for k, w in enumerate(weights, start=-4))
        assert difference == pytest.approx(derivative, rel=1e-9, abs=1e-9 * scale)


@pytest.mark.parametrize("repeats", [True, False])
def test_jets_follow_the_chain_rule(repeats: bool) -> None:
    law = replace(two_ways(), repeats=repeats)
    x = np.concatenate([samples(law), samples(law) + law.period, samples(law) - 2.0 * law.period])
    for order in range(2):
        jet = law.derivative(Jet(x, 1.7, -0.6), order)
        y, first, second = (law.derivative(x, order + k) for k in range(3))
        assert jet.value == pytest.approx(y)
        assert jet.rate == pytest.approx(1.7 * first)
        assert jet.acceleration == pytest.approx(first * -0.6 + second * 1.7**2)
    assert law(Jet(3.0, 1.0)).rate == pytest.approx(law.derivative(3.0, 1))


@pytest.mark.parametrize("repeats", [True, False])
@pytest.mark.parametrize("advance", [0.0, 0.7])
def test_symbols_and_numbers_give_the_same(repeats: bool, advance: float) -> None:
    law = two_ways()
    law = replace(law, repeats=repeats, advance=advance)
    x = casadi.SX.sym("x")
    points = np.concatenate([samples(law, 3), samples(law, 3) + law.period, samples(law, 3) - 3.0 * law.period])
    with symbols_in_numpy():
        y = law(x)
        jet = law(Jet(x, 2.0, 3.0))
        results = [y, *(law.derivative(x, order) for order in (1, 2, 3))]
    gradient = casadi.gradient(y, x)
    function = casadi.Function("f", [x], [casadi.vertcat(*results, gradient, casadi.gradient(gradient, x), *jet.parts[1:])])
    found = np.array(function.map(len(points))(points))
    expected = [law.derivative(points, order) for order in (0, 1, 2, 3, 1, 2)]
    motion = law(Jet(points, 2.0, 3.0))
    for row, numbers in zip(found, [*expected, motion.rate, motion.acceleration], strict=True):
        assert row == pytest.approx(numbers, rel=1e-11, abs=1e-10)


def test_values_of_segments_may_be_symbols_and_arrays() -> None:
    names = [("modified sine", 0.3), ("dwell", 0.2), ("3-4-5", 0.5)]

    def law(rise: object, start: object) -> Law:
        return joined(start, [Segment(time, to, name) for (name, time), to in zip(names, [rise, rise, start], strict=True)])

    x, rise, start = (casadi.SX.sym(name) for name in ("x", "rise", "start"))
    points = np.linspace(-0.4, 1.7, 23)
    with symbols_in_numpy():
        whole, part, scaled = law(rise, start)(x), law(rise, start)(0.1), law(1.0, 0.0).scaled(rise - start, start)(x)
    function = casadi.Function("f", [x, rise, start], [whole, casadi.gradient(whole, rise), part, scaled])
    value, slope, at, other = (np.array(row).ravel() for row in function.map(len(points))(points, 2.5, 0.4))
    numbers = law(2.5, 0.4)
    assert value == pytest.approx(numbers(points), rel=1e-13)
    assert other == pytest.approx(numbers(points), rel=1e-13)
    assert at == pytest.approx(float(numbers(0.1)), rel=1e-13)
    assert slope == pytest.approx(law(1.0, 0.0)(points), abs=1e-13)
    rises = np.array([[0.5], [2.5], [4.0]])
    batch = law(rises, 0.4)
    assert batch(points).shape == (3, len(points))
    assert batch(points)[1] == pytest.approx(numbers(points), rel=1e-13)
    assert batch.derivative(points, 2)[2] == pytest.approx(law(4.0, 0.4).derivative(points, 2), rel=1e-12, abs=1e-11)
    with pytest.raises(AssertionError, match="only a law of numbers"):
        batch.extremes()


def test_numbers_and_arrays_of_any_shape() -> None:
    law = two_ways()
    x = samples(law)[:12].reshape(3, 1, 4)
    for order in range(4):
        assert law.derivative(x, order).shape == x.shape
        assert law.derivative(float(x[1, 0, 2]), order) == law.derivative(x, order)[1, 0, 2]
    assert np.ndim(law(3.0)) == 0
    assert law(3) == law(3.0)


# --- periods, rests, extremes ----------------------------------------------------------------------------------------


def test_a_law_repeats_or_rests_beyond_its_ends() -> None:
    closed = two_ways()
    assert closed.advance == 0.0
    x = samples(closed)
    assert closed(x + 5.0 * closed.period) == pytest.approx(closed(x), abs=1e-12)
    assert closed.derivative(x - closed.period, 2) == pytest.approx(closed.derivative(x, 2), abs=1e-9)

    turning = joined(0.0, [Segment(0.5, 2.0, "cycloidal"), Segment(0.5, 2.0 * math.pi, "3-4-5")])
    x = samples(turning)
    assert turning.advance == 2.0 * math.pi
    assert turning(x + 3.0) == pytest.approx(turning(x) + 6.0 * math.pi)
    assert turning(x - 1.0) == pytest.approx(turning(x) - 2.0 * math.pi)
    assert turning.jump(0)[0] == 0.0

    once = joined(1.0, [Segment(2.0, 3.0, "constant")], begin=-1.0, repeats=False)
    assert once(np.array([-9.0, -1.0, 0.0, 1.0, 8.0])).tolist() == [1.0, 1.0, 2.0, 3.0, 3.0]
    assert once.derivative(np.array([-9.0, -1.0, 0.0, 1.0, 8.0]), 1).tolist() == [0.0, 1.0, 1.0, 1.0, 0.0]
    assert once.jump(1) == (1.0, -1.0)
    assert replace(once, repeats=True).jump(1)[0] == 0.0
    assert replace(once, repeats=True, advance=0.0).jump(0) == (2.0, -1.0)


def test_derivatives_at_a_knot_are_those_after_it() -> None:
    law, x = SEGMENTS["trapezoidal"], casadi.SX.sym("x")
    knots = np.array(law.knots)
    after = law.derivative(knots + 1e-9, 2)[:-1]
    assert law.derivative(knots, 2)[:-1] == pytest.approx(after, abs=1e-12)
    with symbols_in_numpy():
        symbols = casadi.Function("f", [x], [law.derivative(x, 2)])
    assert np.array(symbols.map(len(knots))(knots)).ravel() == pytest.approx(law.derivative(knots, 2), abs=1e-12)
    assert law.derivative(1.0, 2) == pytest.approx(-4.5)  # it rests beyond


def test_extremes_are_exact() -> None:
    law = two_ways()
    x = np.linspace(law.begin, law.end, 400_001)
    for order in range(4):
        extremes, values = law.extremes(order), law.derivative(x, order)
        spread = np.ptp(values)
        assert extremes.least == pytest.approx(np.min(values), abs=1e-4 * spread)
        assert extremes.least <= np.min(values) + 1e-12 * spread
        assert extremes.largest >= np.max(values) - 1e-12 * spread
    wave = Law((1.0, 3.0), pieces=(Piece((0.0, -0.3), 1.0, 7.0, 0.2),))
    angle = math.acos(0.3 / 7.0)  # 7 u + 0.2 where the slope 7 cos(7 u + 0.2) - 0.3 is zero, and the same below zero
    u = [(2.0 * math.pi - angle - 0.2) / 7.0, (angle - 0.2) / 7.0]
    expected = [(math.sin(7.0 * x + 0.2) - 0.3 * x, 1.0 + 2.0 * x) for x in u]
    assert wave.extremes() == pytest.approx((*expected[0], *expected[1]), abs=1e-13)


def test_knots_must_rise() -> None:
    for knots in ((0.0,), (0.0, 0.0), (0.0, 1.0, 0.5), (0.0, math.nan)):
        with pytest.raises(ValueError, match="must rise"):
            Law(knots, pieces=(Piece((0.0,)),))


steps = st.tuples(st.floats(0.01, 5.0), st.floats(-3.0, 3.0), st.sampled_from(NAMES))


@seeded
@given(st.floats(-2.0, 2.0), st.lists(steps, min_size=1, max_size=6), st.floats(-4.0, 4.0), st.booleans())
def test_joined_laws_are_continuous_and_reach_their_ends(
    start: float, ways: list[tuple[float, float, str]], begin: float, repeats: bool
) -> None:
    law = joined(start, [Segment(*way) for way in ways], begin=begin, repeats=repeats)
    assert law.jump(0)[0] == 0.0
    assert law(law.begin) == pytest.approx(start, abs=1e-12)
    value, x = start, begin
    for time, to, name in ways:
        value, x = value if name == "dwell" else to, x + time
        assert law(x - 1e-9 * time) == pytest.approx(value, abs=1e-7)
    assert law.advance == pytest.approx(value - start, abs=1e-12)
    if all(name != "constant" for _, _, name in ways):
        assert law.jump(1)[0] == 0.0
    extremes, values = law.extremes(), law(np.linspace(law.begin, law.end, 50))
    assert extremes.least - 1e-12 <= np.min(values)
    assert np.max(values) <= extremes.largest + 1e-12


@seeded
@given(st.sampled_from(MOVING), st.floats(-3.0, 3.0), st.floats(-3.0, 3.0))
def test_scaling_is_linear(name: str, factor: float, offset: float) -> None:
    law, x = SEGMENTS[name], np.linspace(-0.5, 1.5, 31)
    scaled = law.scaled(factor, offset)
    assert scaled(x) == pytest.approx(offset + factor * law(x), abs=1e-13)
    assert scaled.derivative(x, 2) == pytest.approx(factor * law.derivative(x, 2), abs=1e-12)
    assert scaled.advance == pytest.approx(factor * law.advance)


# --- splines ---------------------------------------------------------------------------------------------------------


@seeded
@given(
    st.lists(st.tuples(st.floats(0.05, 3.0), st.floats(-5.0, 5.0)), min_size=1, max_size=30),
    st.floats(-3.0, 3.0),
    st.booleans(),
)
def test_splines_are_those_of_scipy(rows: list[tuple[float, float]], begin: float, repeats: bool) -> None:
    x = begin + np.cumsum([0.0, *(step for step, _ in rows)])
    y = np.array([0.3, *(value for _, value in rows)])
    if repeats:
        y[-1] = y[0]
    law = spline(x, y, repeats=repeats)
    reference = CubicSpline(x, y, bc_type="periodic" if repeats else "not-a-knot")
    at = samples(law, 5)
    for order in range(3):
        expected = reference(at, order)
        assert law.derivative(at, order) == pytest.approx(expected, rel=1e-8, abs=1e-9 * max(1.0, np.max(np.abs(expected))))
    assert law(x) == pytest.approx(y, abs=1e-12)
    assert law.repeats is repeats
    if repeats:
        assert law.jump(1)[0] < 1e-8
        assert law.jump(2)[0] < 1e-6


def test_a_spline_that_turns_on() -> None:
    x = np.linspace(0.0, 2.0, 21)
    law = spline(x, math.pi * x + 0.2 * np.sin(math.pi * x), repeats=True)
    assert law.advance == pytest.approx(2.0 * math.pi)
    at = np.linspace(-3.0, 5.0, 101)
    assert law(at) == pytest.approx(math.pi * at + 0.2 * np.sin(math.pi * at), abs=1e-5)
    assert law.derivative(at, 1) == pytest.approx(math.pi + 0.2 * math.pi * np.cos(math.pi * at), abs=1e-3)
    assert max(law.jump(order)[0] for order in range(3)) == 0.0


def test_a_long_spline() -> None:
    x = np.linspace(0.0, 1.0, 10_000)
    law = spline(x, np.cos(2.0 * math.pi * x), repeats=True)
    at = np.linspace(0.0, 3.0, 777)
    assert law.derivative(at, 2) == pytest.approx(-4.0 * math.pi**2 * np.cos(2.0 * math.pi * at), abs=1e-5)
    assert law.extremes(1).largest == pytest.approx(2.0 * math.pi, rel=1e-10)


def test_a_wrong_derivative_would_be_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("optlink.linkage.laws.math.perm", lambda n, k: n**k)
    with pytest.raises(AssertionError):
        test_derivatives_are_those_of_a_complex_step_and_of_differences()
