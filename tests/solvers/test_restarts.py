"""Restarts of a local search, and the Hessian that it shares with IPOPT."""

from __future__ import annotations

import numpy as np
import pytest

import optlink
from optlink.errors import Status
from optlink.optimization.programme import build
from optlink.solvers import multistart
from optlink.solvers.ipopt import compiled
from optlink.solvers.multistart import LEAST_VIOLATION, OUT_OF_STEPS, solve_from
from optlink.solvers.solution import Attempt, stationarity


@pytest.mark.parametrize(
    ("message", "step", "persistent", "runs"),
    [
        (LEAST_VIOLATION, 0.01, True, 2),
        (LEAST_VIOLATION, 0.01, False, 1),
        ("stopped early", 0.01, False, 2),
        ("stopped early", 1.0, True, 2),
        ("stopped early", 1.0, False, 1),
        (OUT_OF_STEPS, 0.01, True, 2),
        (OUT_OF_STEPS, 0.01, False, 1),
    ],
)
def test_a_search_is_not_resumed_where_little_is_to_be_expected(
    monkeypatch: pytest.MonkeyPatch, message: str, step: float, persistent: bool, runs: int
) -> None:
    """A least violation, a large one, and no decrease of the objective."""
    nlp = build(optlink.load("crank-rocker").spec)
    called = []

    def search(nlp: object, x: np.ndarray, p: np.ndarray, **options: bool) -> Attempt:
        called.append(options)
        return Attempt(np.clip(x + step, nlp.x_low, nlp.x_high), 1, message)  # type: ignore[attr-defined]

    monkeypatch.setattr(multistart, "backend", lambda _name: search)
    monkeypatch.setattr(multistart, "repair", lambda _nlp, x, _p, **_: x)
    solve_from(nlp, nlp.x_start, "ipopt", persistent=persistent)
    assert len(called) == runs


def test_an_optimum_far_below_the_start_is_not_searched_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """Newton's method confirms it at the new scale of the objective; from a point beside it the back end runs again."""
    nlp = build(optlink.load("path-arc5").variants()[0].model)  # type: ignore[arg-type]
    best = solve_from(nlp, nlp.x_start, "ipopt")
    assert best.status is Status.OPTIMAL
    assert best.objective < 1e-3 * multistart.solution_at(nlp, nlp.x_start, "").objective
    for beside, runs in ((0.0, 1), (1e-2, 4)):
        called = []

        def search(_nlp: object, _x: object, _p: object, beside: float = beside, **options: bool) -> Attempt:
            called.append(options)  # noqa: B023
            return Attempt(best.x + beside, 1, "")

        monkeypatch.setattr(multistart, "backend", lambda _name, search=search: search)
        solve_from(nlp, nlp.x_start, "ipopt")
        assert len(called) == runs


def test_the_hessian_taken_from_ipopt_is_that_of_the_programme() -> None:
    generated, taken = (build(optlink.load("path-closed18").variants()[0].model) for _ in range(2))  # type: ignore[arg-type]
    compiled(taken)
    multipliers = np.linspace(-1.0, 1.0, len(generated.rows))
    x = generated.x_start + 0.01
    expected = generated.hessian(x, generated.p, multipliers)
    assert np.max(np.abs(expected - expected.T)) == 0.0
    assert taken.hessian(x, taken.p, multipliers) == pytest.approx(expected, rel=1e-9, abs=1e-9)
    assert "_hessian" in vars(taken)


@pytest.mark.parametrize("name", ["slsqp", "ipopt"])
def test_the_conditions_of_an_optimum_are_those_of_its_design(name: str) -> None:
    """Refinement computes them; they are not computed again."""
    nlp = build(optlink.load("crank-rocker").spec)
    result = solve_from(nlp, nlp.x_start, name)
    point = nlp.at(result.x, result.p)
    conditions = stationarity(nlp, result.x, point)
    assert result.conditions.active == conditions.active
    assert result.kkt == conditions.kkt <= 1e-12
    np.testing.assert_array_equal(result.conditions.multipliers, conditions.multipliers)
    np.testing.assert_array_equal(result.g, point.g)


def test_ipopt_begins_at_its_start_where_the_interior_of_the_bounds_has_no_value() -> None:
    """Only rockers within 0.03 mm of the upper bound turn fully: IPOPT moved its start away from it, and no design was found."""
    raw = {
        "title": "nearly no crank-rocker",
        "mechanism": {"crank": "57.8763 mm", "frame": "100 mm", "coupler": "20..300 mm", "rocker": "20..58.24 mm"},
        "requirement": {"law": "psi0 + 1.1147*sin(phi - phi0)", "span": "-353.788 deg", "points": 10},
        "limits": {"transmission_angle": ["5 deg", "175 deg"]},
    }
    result = optlink.solve(optlink.read(raw), "ipopt")
    assert result.status is Status.OPTIMAL
    assert result.valid
    b, r = (1e3 * result.design[name] for name in ("coupler", "rocker"))
    assert r <= 58.24 + 1e-9
    least = np.degrees(np.arccos((b * b + r * r - (100.0 - 57.8763) ** 2) / (2.0 * b * r)))
    assert least == pytest.approx(5.0, abs=1e-6)
