"""The smallest largest deviation: smallest circles found by trying all pairs and triples, and programmes solved by SciPy."""

from __future__ import annotations

import itertools
import math

import casadi
import numpy as np
import pytest
from scipy.optimize import minimize_scalar

import optlink
from optlink.errors import Status
from optlink.optimization.nlp import NLP, Variable
from optlink.optimization.programme import build
from optlink.optimization.terms import PLAIN, ConstraintRow, error_measures
from optlink.problem.design import EPIGRAPH
from optlink.solvers import contract, multistart
from optlink.solvers.minimax import minimax

Array = np.ndarray


def circle(points: Array, least: float = -math.inf) -> NLP:
    """The centre (x, y) nearest to the farthest of the points, x >= least."""
    x, p = casadi.SX.sym("x", 3), casadi.SX.sym("p", 1)
    errors = [x[:2] - casadi.SX(row) for row in points.tolist()]
    rows = [
        ConstraintRow(EPIGRAPH, "distance", (x[2] ** 2 - casadi.sumsqr(error)) / p[0] ** 2, 0.0, math.inf, PLAIN)
        for error in errors
    ]
    if math.isfinite(least):
        rows.append(ConstraintRow("limits.x", "x", x[0], least, math.inf, PLAIN))
    return NLP(
        variables=(Variable("x", 1.0, PLAIN), Variable("y", 1.0, PLAIN), Variable(EPIGRAPH, 1.0, PLAIN)),
        fixed=(),
        rows=tuple(rows),
        measure=error_measures("m", 2)["max"],
        x_start=np.array([5.0, -4.0, 10.0]),
        x_low=np.array([-20.0, -20.0, 0.0]),
        x_high=np.array([20.0, 20.0, math.inf]),
        p=np.array([1.0]),
        x_symbol=x,
        p_symbol=p,
        f_expression=x[2] / p[0],
        g_expression=casadi.vertcat(*[row.value for row in rows]),
        residual_expression=casadi.vertcat(*errors),
        level_symbols=(casadi.vertcat(*[casadi.norm_2(error) for error in errors]),),
        first_level=2,
        level_slopes=(1.0,),
    )


def smallest_radius(points: Array) -> float:
    """Of a circle around all points: one through two or three of them is the smallest."""
    result = []
    for pair in itertools.combinations(points, 2):
        result.append((0.5 * np.add(*pair), 0.5 * float(np.linalg.norm(np.subtract(*pair)))))
    for a, b, c in itertools.combinations(points, 3):
        system = 2.0 * np.array([b - a, c - a])
        centre = np.linalg.solve(system, [b @ b - a @ a, c @ c - a @ a])
        result.append((centre, float(np.linalg.norm(centre - a))))
    around = [radius for centre, radius in result if np.all(np.linalg.norm(points - centre, axis=1) <= radius * (1.0 + 1e-12))]
    return min(around)


def test_a_small_largest_deviation_is_no_optimum_because_it_is_small() -> None:
    """The bound of the largest deviation at zero is not active, however near it is: the deviation can still be halved."""
    points = 1e-7 * np.array([[-1.0, 0.0], [1.0, 0.0]])
    nlp = circle(points)
    ends = [multistart.solution_at(nlp, nlp.lifted(np.array([x, 0.0, 0.0])), "") for x in (1e-7, 0.0)]
    assert [end.objective for end in ends] == pytest.approx([2e-7, 1e-7])
    assert [end.status for end in ends] == [Status.STALLED, Status.OPTIMAL]


@pytest.mark.parametrize("seed", range(8))
def test_smallest_circle(seed):
    points = np.random.default_rng(seed).normal(size=(7, 2))
    nlp = circle(points)
    end = minimax(nlp, nlp.lifted(nlp.x_start), nlp.p)
    assert end.x[2] == pytest.approx(smallest_radius(points), rel=1e-9)
    assert end.iterations < 40


@pytest.mark.parametrize("seed", range(4))
def test_smallest_circle_beyond_a_limit(seed):
    """The centre is held at x = 2, beside all points: one unknown is left."""
    points = np.random.default_rng(seed).normal(size=(7, 2))
    nlp = circle(points, least=2.5)

    def largest(y: float) -> float:
        return float(np.max(np.hypot(2.5 - points[:, 0], y - points[:, 1])))

    expected = minimize_scalar(largest, bounds=(-5.0, 5.0), method="bounded", options={"xatol": 1e-12}).fun
    for x in (nlp.x_start, np.array([-3.0, 2.0, 0.0])):  # a start within the limit, and one that misses it
        end = minimax(nlp, nlp.lifted(x), nlp.p)
        assert end.x[2] == pytest.approx(expected, rel=1e-7)
        assert end.x[0] == pytest.approx(2.5, abs=1e-8)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["path-arc5", "path-ellipse10"])
def test_slsqp_finds_no_better_design_nearby(name):
    """SciPy's method on the same programme, from the design and from around it, with limits and free crank angles."""
    file = optlink.load(name, {"requirement.measure": "max"})
    best = optlink.solve(file, starts=240, designs=1).best
    nlp, own = best.solution.nlp, best.solution
    rng = np.random.default_rng(1)
    for spread in (0.0, 1e-3, 1e-3, 1e-2):
        x = np.clip(own.x + spread * rng.standard_normal(len(own.x)), nlp.x_low, nlp.x_high)
        other = multistart.solve_from(nlp, nlp.lifted(x), "slsqp")
        assert not other.usable or other.objective >= own.objective * (1.0 - 1e-7)


BEST = {"path-ellipse10": 7.88636153e-6, "path-arc5": 5.01620959e-7, "path-bean": 2.09034401e-4, "path-conveyor": 2.17564088e-3}


@pytest.mark.slow
@pytest.mark.parametrize("name", BEST)
def test_largest_distance_is_no_more_than_the_best_known(name):
    """Values of IPOPT and SLSQP from the same candidates, which took them up to a hundred times as long."""
    result = optlink.solve(optlink.load(name, {"requirement.measure": "max"}), designs=1)
    assert result.valid
    assert result.backend == contract.MINIMAX
    assert result.objective <= BEST[name]


def test_a_start_without_a_value_is_returned():
    (file,) = optlink.load("path-arc5", {"requirement.measure": "max", "mechanism.assembly": "left"}).variants()
    nlp = build(file.model)
    x = np.where(np.isfinite(nlp.x_high), nlp.x_high, 1.0)
    x[[v.name for v in nlp.variables].index("coupler")] = nlp.x_low[[v.name for v in nlp.variables].index("coupler")]
    end = minimax(nlp, x, nlp.p)
    assert end.iterations == 0
    np.testing.assert_array_equal(end.x, x)
    assert multistart.solution_at(nlp, x, "").status is not Status.OPTIMAL
