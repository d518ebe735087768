"""Extremes and zeros of many functions at once, against dense sampling and SciPy; work and memory of large machines."""

import itertools
import math
import tracemalloc

import numpy as np
import pytest
from scipy.optimize import brentq, minimize_scalar

import optlink
from optlink.linkage import extrema
from optlink.linkage.extrema import distinct, extremes, extremes_of_rows, maxima, zeros
from tests.tiers import mostly_slow

TURN = 2.0 * math.pi
GRID = np.linspace(0.0, TURN, 1441)


def test_distinct_values_are_those_of_numpy():
    for values in ([], [2.0], [3, 1, 3, 2, 1, 1], np.random.default_rng(0).integers(0, 9, (6, 7)) / 3.0):
        computed = distinct(np.asarray(values))
        np.testing.assert_array_equal(computed, np.unique(values), strict=True)


def family(seed, count=60):
    """Periodic functions of every sort that columns have: smooth, peaked, with a cusp, with a corner, flat."""
    rng = np.random.default_rng(seed)
    amplitudes, phases = rng.normal(size=(count, 7)), rng.uniform(0.0, TURN, (count, 7))
    sharp = 10.0 ** rng.uniform(-4.0, 1.0, count)
    sort = np.arange(count) % 5

    def function(angles):
        waves = sum(amplitudes[:, [k]] * np.cos((k + 1) * angles[None, :] + phases[:, [k]]) / (k + 1) for k in range(7))
        near = np.sin(0.5 * (angles[None, :] - phases[:, [0]]))
        sorts = [
            waves,
            waves / np.sqrt(near**2 + sharp[:, None]),
            np.hypot(np.sin(angles[None, :] - phases[:, [1]]), sharp[:, None] * waves),
            np.abs(waves),
            np.broadcast_to(amplitudes[:, [0]], waves.shape),
        ]
        return np.choose(sort[:, None], sorts)

    return function


def far(function, computed):
    """By how much an extreme is missed, as a share of the size of its function, and how untrue it is of the angle named."""
    angles, values = computed
    dense = np.linspace(0.0, TURN, 20_001)
    samples, step, missed, untrue = function(dense), dense[1], 0.0, 0.0
    for row, own in enumerate(samples):
        size = float(np.max(np.abs(own)))
        for k, sign in enumerate((1.0, -1.0)):
            centre = dense[np.argmin(sign * own)]
            bounds = (centre - step, centre + step)
            options = {"bounds": bounds, "method": "bounded", "options": {"xatol": 1e-12}}
            beside = minimize_scalar(lambda at, row=row, sign=sign: sign * float(function(np.array([at]))[row, 0]), **options)
            truth = min(float(np.min(sign * own)), beside.fun)
            missed = max(missed, (sign * values[row, k] - truth) / size)
            untrue = max(untrue, abs(float(function(angles[row, [k]])[row, 0]) - values[row, k]) / size)
    return missed, untrue


@pytest.mark.parametrize("seed", mostly_slow(range(3), 0))
def test_extremes_are_those_of_a_dense_search(seed):
    function = family(seed)
    missed, untrue = far(function, extremes(function, GRID))
    assert missed < 1e-9
    assert untrue < 1e-12


def test_the_comparison_detects_unverified_interpolants(monkeypatch):
    monkeypatch.setattr(extrema, "EXACT", 1.0)
    monkeypatch.setattr(extrema, "SMOOTH", 1e9)
    function = family(0)
    assert far(function, extremes(function, GRID))[0] > 1e-6


def test_no_interpolant_reaches_across_a_jump_or_a_gap():
    def function(angles):
        step = np.where(angles >= 2.0, 1.0, 0.0)
        return np.array(
            [
                np.sin(angles) + step,  # rises at once beside its largest value
                np.cos(angles - 1.99) - 0.9 * step,  # falls at once beside its largest value
                np.where(np.abs(angles - 1.5) < 0.3, np.nan, np.sin(angles)),  # has no value near there
            ]
        )

    grid = np.unique([*GRID, 2.0])
    angles, values = extremes(function, grid, (2.0,))
    assert values[0, 1] == pytest.approx(1.0 + math.sin(2.0), abs=1e-12)
    assert angles[0, 1] == pytest.approx(2.0, abs=1e-12)
    assert values[1, 1] == pytest.approx(1.0, abs=1e-12)
    assert values[2, 1] == pytest.approx(math.sin(1.8), abs=1e-4)
    assert values[2, 1] <= math.sin(1.8)
    assert values[2, 0] == pytest.approx(-1.0, abs=1e-12)


def test_a_jump_beside_an_extremum_costs_no_further_rounds():
    calls = []

    def function(angles):
        calls.append(len(angles))
        after = angles >= 2.0
        return np.array([np.where(after, -1.0, 1.0) * np.exp(-((angles - 2.0) ** 2)), np.where(after, np.cos(angles - 2.0), 0.0)])

    angles, values = extremes(function, GRID, (2.0,))
    assert values[0] == pytest.approx([-1.0, 1.0], abs=1e-12)
    assert angles[0] == pytest.approx([2.0, 2.0], abs=2e-9)
    assert function(angles[0])[0].tolist() == values[0].tolist()  # each on its side of the jump
    assert (angles[1, 1], values[1, 1]) == (2.0, 1.0)
    assert len(calls) < 6


@pytest.mark.parametrize("seed", range(3))
def test_maxima_are_the_larger_extremes(seed):
    function, breaks = family(seed), (1.0, 2.5)
    angles, values = extremes(function, GRID, breaks, periodic=True)
    for one, both in zip(maxima(function, GRID, breaks, periodic=True), (angles, values), strict=True):
        np.testing.assert_allclose(one, both[:, 1], rtol=1e-12)


def test_a_function_without_values_has_no_extremes():
    angles, values = extremes(lambda at: np.full((1, len(at)), np.nan), GRID)
    assert np.all(np.isnan(angles))
    assert np.all(np.isnan(values))


def test_rounding_beside_others_of_its_kind_is_not_refined():
    calls = []

    def function(angles):
        calls.append(len(angles))
        return np.array([np.cos(angles), 1e-15 * np.random.default_rng(len(angles)).normal(size=len(angles))])

    extremes(function, GRID, kinds=("m", "m"))
    alike, calls[:] = sum(calls), []
    extremes(function, GRID, kinds=("m", "rad"))
    assert sum(calls) > alike + 100


@pytest.mark.parametrize("seed", range(3))
def test_zeros_are_those_of_brentq(seed):
    function = family(seed, 20)
    values = function(GRID)
    for row, computed in enumerate(zeros(function, GRID)):
        change = np.flatnonzero(values[row, :-1] * values[row, 1:] < 0.0)
        brackets = [(GRID[k], GRID[k + 1]) for k in change]
        roots = [brentq(lambda at, row=row: function(np.array([at]))[row, 0], a, b, xtol=1e-15, rtol=1e-15) for a, b in brackets]
        assert computed == pytest.approx(roots, abs=1e-12)


def test_zeros_end_behind_the_change_of_sign():
    def function(angles):
        return np.array([np.tanh(1e6 * (angles - 1.0)), np.where(angles < 2.5, -1.0, 1.0), (angles - 3.0) ** 3])

    for row, (computed, at) in enumerate(zip(zeros(function, GRID), (1.0, 2.5, 3.0), strict=True)):
        assert len(computed) == 1
        assert computed[0] == pytest.approx(at, abs=1e-14 if row else 1e-12)
        assert function(computed)[row, 0] >= 0.0
        assert function(computed - 2e-15 * at)[row, 0] <= 0.0


def test_a_zero_at_zero_costs_no_more_than_another():
    calls = []

    def function(angles):
        calls.append(len(angles))
        return np.array([np.sin(angles) * (1.0 + 0.3 * angles)])

    grid = np.linspace(-0.01, 6.0, 300)
    samples = function(grid)
    for shift in (0.0, 1.0):
        computed = zeros(lambda angles: function(angles - shift), grid + shift, samples=samples)[0]  # noqa: B023
        assert computed == pytest.approx([shift, shift + math.pi], abs=1e-15 + 4e-16 * shift)
    assert len(calls) < 20
    assert max(calls[1:]) == 2  # the samples are known


def chain(dyads):
    """A crank-rocker that drives parallelograms in a row, all links with mass."""
    ground = {"G0": ["0 mm", "0 mm"]}
    links = {"crank": {"joints": ["G0", "P0"], "length": "50 mm"}}
    modes = {}
    for k in range(1, dyads + 1):
        ground[f"G{k}"] = [f"{200 * k} mm", "0 mm"]
        links[f"c{k}"] = {"joints": [f"P{k - 1}", f"P{k}"], "length": "220 mm" if k == 1 else "200 mm"}
        links[f"r{k}"] = {"joints": [f"G{k}", f"P{k}"], "length": "120 mm"}
        modes[f"P{k}"] = f"left of P{k - 1}-G{k}"
    bodies = {name: {"mass": "1 kg", "inertia": "uniform bar"} for name in links}
    return {"title": "chain", "mechanism": {"ground": ground, "links": links, "assembly": modes}, "bodies": bodies}


def work_and_memory(dyads, monkeypatch, *, traced=True):
    """Positions at which motions are computed by one analysis, its largest memory [byte] or 0, and the analysis."""
    from optlink.linkage import motion, stroke

    positions = 0
    sweep = motion.sweep

    def counting(mechanism, sizes, crank_angle, *rest, **more):
        nonlocal positions
        positions += np.size(crank_angle)
        return sweep(mechanism, sizes, crank_angle, *rest, **more)

    for module in (stroke, __import__("optlink.dynamics.machine", fromlist=["sweep"])):
        monkeypatch.setattr(module, "sweep", counting)
    problem = optlink.read(chain(dyads))
    if traced:  # takes three times as long as the analysis
        tracemalloc.start()
    try:
        result = optlink.analyze(problem, points=8)
        return positions, tracemalloc.get_traced_memory()[1], result
    finally:
        tracemalloc.stop()


@pytest.mark.slow
def test_work_grows_in_proportion_to_the_links_and_memory_stays_small(monkeypatch):
    _, less, small = work_and_memory(10, monkeypatch)
    half, more, _ = work_and_memory(20, monkeypatch)
    whole, _, result = work_and_memory(40, monkeypatch, traced=False)
    assert len(result.machine.mechanism.links) == 81
    assert whole < 2.5 * half < 25_000
    assert more < 2.5 * less < 30e6
    for name in ("r1.omega_rad_s", "r10.omega_rad_s", "P1.ay_m_s2"):  # a parallelogram more changes no motion before it
        assert result.extremes[name].largest == pytest.approx(small.extremes[name].largest, rel=1e-9)


@pytest.mark.parametrize("phase", [1.0, 0.2], ids=["Newton converges", "Newton leaves the bracket"])
def test_zeros_with_derivatives_are_those_without(phase: float) -> None:
    """Where Newton's method leaves the bracket, here for another zero, the rounds of interpolation and bisection answer."""

    def slope(_k: int, angle: float) -> tuple[float, float]:
        return math.sin(3.1 * angle - phase), 3.1 * math.cos(3.1 * angle - phase)

    computed = zeros(lambda angles: np.sin(3.1 * angles - phase)[None], np.array([0.0, 1.0]), slope=slope)
    assert computed[0] == pytest.approx([phase / 3.1], abs=1e-15)


def test_newton_ends_at_rounding_noise_of_the_function():
    """A rate rounded to 1e-14 never lets the steps fall below a few units of the last place; no bracketing round follows."""
    root, noise, calls = 1.2345678901234567, itertools.cycle([3e-15, -3e-15]), []

    def values(angles):
        calls.append(len(angles))
        return np.sin(angles - root)[None, :]

    grid = np.linspace(0.0, 2.0, 11)
    (computed,) = zeros(values, grid, slope=lambda _, at: (math.sin(at - root) + next(noise), math.cos(at - root)))
    assert computed == pytest.approx([root], abs=1e-14)
    assert sum(calls) == len(grid)


def test_the_least_of_two_nearly_equal_minima_is_found_between_the_samples():
    """The higher minimum lies on a sample, the lower one half-way between two, where both samples are above the other."""
    grid = np.linspace(0.0, TURN, 721)
    middle = math.pi + 0.5 * grid[1]

    def function(angles):
        second = -(1.0 + 1e-6) * np.cos(2.0 * (angles - middle))
        first = -np.cos(2.0 * angles)
        return np.array([np.where(np.abs(angles - math.pi) < 0.5 * math.pi, second, first)])

    at, value = extremes(function, grid, (0.5 * math.pi, 1.5 * math.pi))
    assert value[0, 0] == pytest.approx(-1.0 - 1e-6, abs=1e-12)
    assert at[0, 0] == pytest.approx(middle, abs=1e-7)
    seen = maxima(lambda angles: -function(angles), grid, (0.5 * math.pi, 1.5 * math.pi))
    assert seen[1][0] == pytest.approx(1.0 + 1e-6, abs=1e-12)


def test_nearly_equal_extremes_of_random_fourier_series_are_those_of_all_their_zeros_of_slope():
    rng = np.random.default_rng(3)
    orders, count = np.arange(1, 9), 60
    sizes, phases = rng.normal(size=(count, 8)) / orders**1.5, rng.uniform(0.0, TURN, (count, 8))
    sizes[:, ::2] *= 10.0 ** rng.uniform(-6.0, -3.0, (count, 1))  # almost of half the period

    def series(angles, kind):
        arguments = orders[:, None] * angles + phases[:, :, None]
        return np.einsum("ik,ikn->in", sizes * orders**kind, (np.cos, np.sin)[kind](arguments))

    grid = np.linspace(0.0, TURN, 722)  # an odd number of steps
    computed = extremes(lambda angles: series(angles, 0), grid, periodic=True)[1]
    for row, flat in enumerate(zeros(lambda angles: series(angles, 1), np.linspace(0.0, TURN, 4001))):
        values = series(flat, 0)[row]
        np.testing.assert_allclose(computed[row], [values.min(), values.max()], rtol=0.0, atol=1e-12 * np.ptp(values))


@pytest.mark.slow
def test_rows_with_several_nearly_equal_extremes_and_rows_without_a_value():
    """Five dips a revolution that differ by 1e-5: the lowest sample is seldom beside the lowest dip."""
    phases = np.random.default_rng(4).uniform(0.0, 2.0 * math.pi, (2, 20, 1))

    def values(angles):
        return np.cos(5.0 * angles + phases[0]) + 1e-5 * np.cos(angles + phases[1])

    grid, dense = np.linspace(0.0, 2.0 * math.pi, 97), np.linspace(0.0, 2.0 * math.pi, 400_001)[None, :]
    exact = np.stack([np.min(values(dense), axis=1), np.max(values(dense), axis=1)], axis=1)
    assert np.max(np.abs(extremes_of_rows(values, grid) - exact)) < 1e-9
    assert np.max(np.abs(extremes(values, grid, periodic=True)[1] - exact)) < 1e-9
    samples = values(grid[None, :-1])
    assert np.count_nonzero(np.argmin(samples, axis=1) // 20 != np.argmin(values(dense), axis=1) // 80_000) > 3
    assert np.all(np.isnan(extremes_of_rows(lambda angles: np.nan * values(angles), grid)))
