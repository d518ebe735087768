"""Certificate of the least largest error of function generators, against kinematics, sampling and convex programmes."""

import math

import numpy as np
import pytest
from scipy.optimize import linprog

import optlink
from optlink.linkage.fourbar import LENGTHS, crank_rocker_conditions, double_crank_conditions, four_bar
from optlink.linkage.vector2d import unit
from optlink.solvers.global_search.function_generator import (
    LinkageSet,
    Rows,
    certify_function,
    coupler_rows,
    grashof_rows,
    largest,
    least_violation,
    linkage_sets,
    loop_rows,
    unit_vector,
)
from optlink.synthesis.freudenstein import FitProblem, LoopEquation, first_steps
from optlink.tasks.certify import certify
from tests.tiers import mostly_slow

X = np.linspace(0.0, 1.2, 9)


def random_linkages(count, rng):
    """Yield side, phi0, psi0, lengths over the frame, output rotations and transmission angles, by the kinematics core."""
    while count:
        side, phi0 = int(rng.choice([-1, 1])), rng.uniform(-6.0, 6.0)
        sizes = dict(zip(LENGTHS, [*np.exp(rng.uniform(-2.0, 2.0, 3)), 1.0], strict=True))
        pose = four_bar(side).pose(sizes, unit(phi0 + X))
        b, c, d = (np.broadcast_arrays(*pose.point(name)) for name in "BCD")
        if not all(np.all(np.isfinite(part)) for part in (b, c)):
            continue
        count -= 1
        output = np.unwrap(np.arctan2(c[1] - d[1], c[0] - d[0]))
        ends = [(p[0] - c[0]) + 1j * (p[1] - c[1]) for p in (b, np.broadcast_arrays(*d))]
        yield side, phi0, output[0], sizes, output - output[0], np.abs(np.angle(ends[0] / ends[1]))


def values_at(rows, point, k3):
    """Return the rows at one linkage, written out again."""
    phi0, psi0, k1, k2 = point
    return (
        k1 * (np.real(rows.output * unit_vector(psi0)) + rows.k1)
        + k2 * (np.real(rows.crank * unit_vector(phi0)) + rows.k2)
        + k3 * rows.k3
        + k1 / k2 * rows.ratio
        + np.real(rows.both * unit_vector(phi0 - psi0))
        + rows.k0
    )


@pytest.mark.slow
def test_rows_hold_for_every_linkage_within_the_error():
    rng = np.random.default_rng(1)
    tightest = np.inf
    for side, phi0, psi0, sizes, rotation, gamma in random_linkages(100, rng):
        t = float(10.0 ** rng.uniform(-4.0, -0.5))
        crank, coupler, rocker, _ = sizes.values()
        share = [coupler * np.sin(gamma) / np.sqrt(crank**2 + 1.0 - 2.0 * crank * np.cos(phi0 + X))]
        dead = bool(np.min(share) < math.sin(t)) or t > 0.1
        y = rotation + rng.choice([-t, t, 0.3 * t], X.size)
        point = np.array([phi0, psi0, 1.0 / crank, 1.0 / rocker])
        k3 = (crank**2 - coupler**2 + rocker**2 + 1.0) / (2.0 * crank * rocker)
        near = rng.uniform(0.0, 0.1, 4) * [1.0, 1.0, point[2], point[3]]
        low, high = (point - rng.uniform(0.0, 1.0, 4) * near)[None], (point + rng.uniform(0.0, 1.0, 4) * near)[None]
        limits = float(np.min(gamma)), float(np.max(gamma))
        nearest = float(np.min(coupler / np.sqrt(crank**2 + 1.0 - 2.0 * crank * np.cos(phi0 + X)))) * (1.0 + 1e-12)
        one = LinkageSet(side, low[0], high[0], (coupler, coupler), limits, near_dead=dead, share=nearest)
        rows = Rows.joined([loop_rows(one, X, y, t), *coupler_rows(one, X, y, t, low, high)], 1)
        values = values_at(rows, point, k3)
        assert np.min(values) > -1e-9 * (1.0 + crank + 1.0 / crank + 1.0 / rocker + rocker / crank)
        tightest = min(tightest, float(np.min(values[0, : 2 * X.size])))
        weights = rng.uniform(0.0, 1.0, values.shape)
        assert largest(rows, weights, low, high)[0] >= np.sum(weights * values)
    assert tightest < 1e-9  # an error at its limit makes a row vanish: a smaller relaxation would be wrong


def test_the_bound_of_a_sum_of_rows_exceeds_all_samples_and_is_close():
    rng = np.random.default_rng(2)
    for _ in range(12):
        size = 10.0 ** rng.uniform(-3.0, 0.0)
        centre = np.array([*rng.uniform(-3.0, 3.0, 2), *np.exp(rng.uniform(-1.0, 1.0, 2))])
        radius = size * rng.uniform(0.3, 1.0, 4) * [1.0, 1.0, 0.5 * centre[2], 0.5 * centre[3]]
        low, high = (centre - radius)[None], (centre + radius)[None]
        one = LinkageSet(1, low[0], high[0], (0.1, 5.0), (0.5, 2.5))
        rows = Rows.joined([loop_rows(one, X, 0.8 * X, 1e-3), *coupler_rows(one, X, 0.8 * X, 1e-3, low, high)], 1)
        weights = rng.uniform(0.0, 1.0, rows.k3.shape) * (rng.uniform(0.0, 1.0, rows.k3.shape) < 0.1)
        computed = largest(rows, weights, low, high)[0]
        ends = [np.linspace(low[0, k], high[0, k], 5) for k in range(4)]
        points = np.stack(np.meshgrid(*ends), axis=-1).reshape(-1, 4)
        reach = 1.0 + points[:, 2] + points[:, 3]  # of K3
        sums = [np.sum(weights * values_at(rows, p, k3)) for p, r in zip(points, reach, strict=True) for k3 in (-r, r)]
        assert computed >= max(sums)
        assert largest(rows, weights - 2.0 * (weights == 0.0), low, high)[0] == computed  # no negative multiplier takes part
        if size < 0.01:
            assert computed <= max(sums) + 60.0 * size * (1.0 + centre[2] + centre[3]) ** 2 * np.sum(weights)


@pytest.mark.parametrize(
    ("ratio", "widths"),
    mostly_slow(
        [(0.0, [0.8, 0.8, 0.0, 0.0]), (-1.0, [0.0, 0.0, 0.6, 0.6]), (1.0, [0.4, 0.4, 0.6, 0.6])], (0.0, [0.8, 0.8, 0.0, 0.0])
    ),
)
def test_the_bound_of_one_row_exceeds_a_dense_sample(ratio, widths):
    rng = np.random.default_rng(4)
    for _ in range(60):
        size = rng.uniform(0.2, 1.0)
        centre = np.array([*rng.uniform(-3.0, 3.0, 2), 1.0, 1.0])
        low, high = (centre - size * np.array(widths))[None], (centre + size * np.array(widths))[None]
        parts = rng.normal(size=(3, 1, 1)) + 1j * rng.normal(size=(3, 1, 1))
        k0, k1, zero = rng.normal(size=(1, 1)), rng.normal(size=(1, 1)), np.zeros((1, 1))
        row = Rows(*parts, k0, k1, zero, zero, zero + 4.0 * ratio)
        ends = [np.linspace(low[0, k], high[0, k], 13 if widths[k] else 1) for k in range(4)]
        points = np.stack(np.meshgrid(*ends), axis=-1).reshape(-1, 4)
        assert largest(row, np.ones((1, 1)), low, high)[0] >= np.max(values_at(row, points.T, 0.0))


def test_the_relaxation_near_a_dead_position_is_exact_at_one():
    crank, rocker, t, side = 3.0, 4.0, 0.02, 1  # B, D and C in line, crank pin farthest from D, the error at its limit
    psi, coupler = 0.0, 1.0 + crank + rocker
    k3 = (crank**2 - coupler**2 + rocker**2 + 1.0) / (2.0 * crank * rocker)
    point = np.array([math.pi, psi, 1.0 / crank, 1.0 / rocker])
    one = LinkageSet(side, point, point, (coupler, coupler), (1e-9, math.pi - 1e-9), near_dead=True)
    values = values_at(loop_rows(one, np.zeros(1), np.array([-t]), t), point, k3)
    assert np.min(values) == pytest.approx(0.0, abs=1e-14)


def test_the_rows_of_grashof_hold_exactly_for_linkages_that_satisfy_them():
    rng = np.random.default_rng(5)
    kinds = {"full rotation": crank_rocker_conditions, "double-crank": double_crank_conditions}
    seen = {(kind, holds): 0 for kind in kinds for holds in (True, False)}
    for crank, coupler, rocker in np.exp(rng.uniform(-1.5, 1.5, (3000, 3))):
        k1, k2, k3 = 1.0 / crank, 1.0 / rocker, (crank**2 - coupler**2 + rocker**2 + 1.0) / (2.0 * crank * rocker)
        point = np.array([0.0, 0.0, k1, k2])
        for kind, conditions in kinds.items():
            rows = grashof_rows(LinkageSet(1, point, point, (coupler, coupler), (0.1, 3.0), kind))
            holds = min(conditions(crank, coupler, rocker, 1.0).values()) >= 0.0
            least = float(np.min(values_at(rows, point, k3)))
            seen[kind, holds] += least >= -1e-12
            assert least >= -1e-12 or not holds
    assert seen["full rotation", True] > 50 < seen["double-crank", True]
    assert seen["full rotation", False] + seen["double-crank", False] < 3000  # the rows exclude linkages


def test_programmes_equal_an_independent_solver():
    rng = np.random.default_rng(3)
    matrix, vector = rng.normal(size=(20, 30, 4)), rng.normal(size=(20, 30))
    elastic = np.append(np.ones(22), np.zeros(8))
    vector[:, 22:] -= 3.0
    z, dual = least_violation(matrix, vector, elastic)
    for m, v, x, multipliers in zip(matrix, vector, z, dual, strict=True):
        exact = linprog([0, 0, 0, 0, 1], -np.column_stack([m, elastic]), -v, bounds=(None, None)).fun
        assert np.max((v - m @ x)[:22]) == pytest.approx(exact, abs=1e-8)
        assert multipliers @ v == pytest.approx(exact, abs=1e-8)
        assert np.min(multipliers) >= 0.0
        assert np.max(np.abs(multipliers @ m)) < 1e-8


def test_linkages_near_a_dead_position_are_searched_where_the_lengths_permit_them():
    sine, logarithm = optlink.load("function-sin").spec, optlink.load("function-log10").spec
    sets = linkage_sets(sine, 0.00332)
    assert [(one.side, one.near_dead) for one in sets] == [(1, False), (-1, False), (1, True), (-1, True)]
    assert sets[2].high[2] == pytest.approx(1.0 / (0.05 * 0.5 / math.sin(0.00332) - 1.0), rel=1e-6)
    assert not any(one.near_dead for one in linkage_sets(logarithm, 6.4e-5))  # 0.05 / 21 frames, times sin 30 deg, exceeds it


@pytest.mark.slow
def test_a_search_without_a_good_design_finds_one_and_bounds_it():
    file = optlink.load("function-sin", overrides={"mechanism.assembly": "left"})
    seen = []
    result = certify_function(file.spec, 0.006, gap=0.3, progress=lambda share, gap: seen.append((share, gap)))
    best = optlink.load("function-sin").spec.expected.objective
    assert result.status == "closed"
    assert 0.7 * best <= 0.7 * result.best == pytest.approx(result.lower)
    assert result.lower <= best < result.best < 0.006
    design, side = result.better[-1]
    assert side == 1
    assert optlink.validate(file, design).objective == pytest.approx(result.best, rel=1e-6)  # measured in motion
    assert all(0.0 <= share <= 1.0 and 0.0 <= gap <= 1.0 for share, gap in seen)


@pytest.mark.slow
def test_a_search_that_is_stopped_claims_nothing_beyond_its_last_level():
    problem = optlink.load("function-exp").spec
    result = certify_function(problem, problem.expected.objective, boxes=300)
    assert (result.status, result.lower, result.gap) == ("stopped", 0.0, 1.0)
    assert len(result.open) > 0

    def interrupt(share, gap):
        raise KeyboardInterrupt

    assert certify_function(problem, problem.expected.objective, progress=interrupt).status == "interrupted"


@pytest.mark.slow
def test_a_function_that_no_four_bar_follows_is_bounded_over_boxes_of_designs():
    """Beyond 45 deg the rows do not hold: the proof is that of any other problem."""
    law = {"function": "sin(8*x)", "x": [0.0, 6.283], "input": "90 deg", "output": "170 deg"}
    problem = optlink.load("function-sin", {"requirement.law": law, "mechanism.assembly": "left"})
    result = optlink.solve(problem, starts=1, certify=False)
    assert result.valid
    assert result.objective > 0.25 * math.pi
    assert certify(result, boxes=100.0).certificate.status == "not closed"


RECIPROCAL = {"function": "1/x", "x": [1, 2], "input": "90 deg", "output": "-90 deg"}


@pytest.mark.slow
@pytest.mark.parametrize("name", ["function-log10", "function-sin", "function-exp"])
def test_the_shipped_designs_are_global_optima(name):
    problem = optlink.load(name).spec
    best = problem.expected.objective
    result = certify_function(problem, best, gap=1e-3)
    assert (result.status, len(result.better)) == ("closed", 0)
    assert (1.0 - 1.001e-3) * best <= result.lower < best
    x = problem.span * 0.5 * (1.0 - np.cos(np.linspace(0.0, np.pi, 121)))
    grid = np.arange(0.0, 2.0 * np.pi, 0.35)
    task = FitProblem(LoopEquation((0.05, 20.0)), x, problem.requirement.law.rise(x), largest=True, shift=True, keep=None)
    steps = first_steps(task, grid, grid, count=12)
    assert min(step.bound for step in steps if step.proven) >= result.lower  # convex programmes, with bounds of their own


@pytest.mark.slow
def test_an_optimum_at_its_transmission_limit_is_certified():
    problem = optlink.load("function-sin", overrides={"requirement.law": RECIPROCAL}).spec
    result = certify_function(problem, 0.0028877333, gap=1e-3)
    assert result.status == "closed"
    assert result.lower == pytest.approx(0.0028877333, rel=1.001e-3)
    free = optlink.load(
        "function-sin", overrides={"requirement.law": RECIPROCAL, "limits.transmission_angle": ["20 deg", "160 deg"]}
    )
    wider = certify_function(free.spec, 0.0028877333, gap=0.05)
    assert wider.better  # the limit is what keeps linkages with a smaller error out
    assert wider.lower < result.lower
