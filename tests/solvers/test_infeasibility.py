"""Which limits of a function problem conflict, and by how much each would have to give: against a grid of linkages."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

import optlink
from optlink.optimization.programme import build
from optlink.solvers.infeasibility import Explanation, explain, limit_sides, tightest
from optlink.solvers.solution import Relaxation
from optlink.tasks.results.conflict import outward
from optlink.tasks.run import solve

TEMPLATES = Path(__file__).parents[2] / "templates"
LIMITS = {"limits.transmission_angle": ["80 deg", "82 deg"], "limits.link_ratio": [0.95, 1.05]}
SPAN = 90.0  # deg, of the crank in function-sin


def transmission() -> tuple[np.ndarray, np.ndarray]:
    """Least and largest transmission angle [deg] over the span, of linkages within the ratios, by the law of cosines."""
    r, a, b = (side[..., None] for side in np.meshgrid(*[np.linspace(0.95, 1.05, 9)] * 3))
    begin = np.radians(np.arange(-360.0, 1.0, 1.0))
    end = begin + math.radians(SPAN)
    turn = 2.0 * math.pi
    top = np.where(np.ceil(begin / turn) * turn <= end, 1.0, np.maximum(np.cos(begin), np.cos(end)))
    bottom = np.where(np.ceil((begin - math.pi) / turn) * turn + math.pi <= end, -1.0, np.minimum(np.cos(begin), np.cos(end)))
    near, far = ((a**2 + b**2 - r**2 - 1.0 + 2.0 * r * cosine) / (2.0 * a * b) for cosine in (top, bottom))
    with np.errstate(invalid="ignore"):
        return np.degrees(np.arccos(near)), np.degrees(np.arccos(far))


@pytest.fixture(scope="module")
def reason() -> Explanation:
    problem = optlink.load("function-sin", {"mechanism.assembly": "left", **LIMITS})
    explanation = explain(build(problem.spec))
    assert isinstance(explanation, Explanation)
    return explanation


@pytest.mark.slow
def test_conflicting_transmission_and_ratio_limits_are_listed(reason: Explanation) -> None:
    named = {(item.key, item.sense) for item in reason.conflict}
    assert {key for key, _ in named} == {"limits.transmission_angle", "limits.link_ratio"}
    assert {("limits.transmission_angle", sense) for sense in ("<=", ">=")} <= named  # the ratios need one side alone
    assert all(math.isfinite(item.relaxed) for item in reason.conflict)


@pytest.mark.slow
def test_a_relaxation_is_the_least_that_a_grid_of_linkages_shows(reason: Explanation) -> None:
    """Both sides of the range give by the same angle, although the rows are cosines."""
    least, largest = transmission()
    needed = float(np.nanmin(np.maximum(80.0 - least, largest - 82.0)))
    sides = {item.sense: item for item in reason.conflict if item.key == "limits.transmission_angle"}
    assert all(side.both_sides for side in sides.values())
    for side in sides.values():
        assert side.amount == pytest.approx(needed, abs=0.5)  # between the linkages of the grid
        assert side.amount <= needed + 1e-6


def test_independent_limits_cannot_conflict() -> None:
    """The rocker's start angle moves no limit; the crank's may take every direction, so its bounds hold nothing back."""
    problem = optlink.load("function-sin", {"mechanism.assembly": "left", **LIMITS})
    assert {side.name for side in limit_sides(build(problem.spec))}.isdisjoint({"phi0", "psi0"})
    narrow = problem.override({"requirement.from": {"start": "10 deg", "bounds": ["0 deg", "20 deg"]}})
    assert "phi0" in {side.name for side in limit_sides(build(narrow.spec))}


@pytest.mark.parametrize("miss", [2e-5, 2e-6])
def test_limits_missed_by_little_more_than_the_solver_tolerance_are_listed(miss: float) -> None:
    """Of crank-rockers with crank r, frame d and coupler a, that of equal strokes has the best worst transmission angle.

    Its rocker is b with d^2 + r^2 = a^2 + b^2, and its worst cosine r d / (a b).
    """
    r, d, a = 0.1, 0.5, 0.4  # m
    best = math.degrees(math.acos(r * d / (a * math.sqrt(d**2 + r**2 - a**2))))
    limit = [f"{best + miss!r} deg", f"{180.0 - best - miss!r} deg"]
    result = solve(optlink.load("crank-rocker", {"mechanism.coupler": "400 mm", "limits.transmission_angle": limit}))
    assert result.status.value == "infeasible"
    assert {item.key for item in result.conflict} == {"limits.transmission_angle"}
    assert all(item.amount == pytest.approx(miss, abs=math.degrees(2e-8)) for item in result.conflict)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("key", "miss"),
    [("limits.pressure_angle", 3e-7), ("limits.pressure_angle", 1e-8), ("limits.transmission_angle", 6e-7)],
)
def test_limits_missed_by_the_solver_tolerance_are_listed(key: str, miss: float) -> None:
    """Where the limits leave no design, or only one within a tolerance, the search ends at no optimum ("stalled")."""
    best = math.degrees(math.asin(5.0 / 13.0))  # pressure angle of the crank-rocker with coupler and rocker of equal length
    limit = f"{best - miss!r} deg" if "pressure" in key else [f"{90.0 - best + miss!r} deg", f"{90.0 + best - miss!r} deg"]
    result = solve(optlink.load("crank-rocker", {"limits.transmission_angle": None, key: limit}))
    assert result.status.value == "infeasible"
    assert {item.key for item in result.conflict} == {key}
    assert all(item.amount == pytest.approx(miss, abs=math.degrees(5e-9)) for item in result.conflict)


@pytest.mark.slow
def test_a_limit_of_a_path_problem_that_only_the_validator_resolves_is_listed() -> None:
    """The squared sine of a small pressure angle has a flat slope: the solver meets a limit that no design has."""
    best = math.degrees(math.asin(5.0 / 300.0))  # of the shortest crank and the longest rod
    result = optlink.solve(optlink.load("law-slider-crank", {"limits.pressure_angle": f"{best - 1e-6!r} deg"}))
    assert result.status.value == "infeasible"
    amounts = {item.name: item.amount for item in result.conflict}
    assert amounts["pressure angle at C"] == pytest.approx(1e-6, rel=0.01)
    assert amounts["crank.length"] == pytest.approx(300.0 * math.cos(math.radians(best)) * math.radians(1e-6), rel=0.01)


@pytest.mark.slow
def test_both_sides_of_a_range_are_relaxed_as_one() -> None:
    """A wiper with 45..135 deg: either side gives to the best transmission angle of its swing.

    With equal strokes frame^2 + crank^2 = coupler^2 + rocker^2 and crank = rocker sin(swing/2), hence the worst cosine is
    sin(swing/2) frame/coupler, least for the shortest rocker.
    """
    file = optlink.load(TEMPLATES / "wiper.toml", {"limits.swing_angle": "100 deg"})
    result = solve(file.override({"limits.transmission_angle": ["45 deg", "135 deg"]}), starts=5)
    low, high = (item for item in result.conflict if item.key == "limits.transmission_angle")
    assert low.both_sides
    assert high.both_sides
    frame, rocker, half = 250.0, 30.0, math.radians(50.0)
    coupler = math.sqrt(frame**2 - (rocker * math.cos(half)) ** 2)
    best = math.degrees(math.acos(math.sin(half) * frame / coupler))
    assert low.relaxed == pytest.approx(best, abs=1e-4)
    assert high.relaxed == pytest.approx(180.0 - best, abs=1e-4)
    printed = [f"{outward(item, 6)!r} deg" for item in (low, high)]
    assert solve(file.override({"limits.transmission_angle": printed}), starts=5).valid


def crank_rockers(ratio: float, least: float, count: int = 801) -> np.ndarray:
    """Couplers and rockers (2, n) [mm] of a grid whose crank turns fully, with a least transmission angle and time ratio."""
    a, b = (part.ravel() for part in np.meshgrid(*2 * [np.linspace(100.0, 900.0, count)[1:]], indexing="ij"))
    turns = (np.maximum(a, b) + 100.0 <= 500.0 + np.minimum(a, b)) & (a + b >= 600.0)
    a, b = a[turns], b[turns]
    with np.errstate(all="ignore"):
        inner, outer = ((a * a + b * b - side * side) / (2.0 * a * b) for side in (400.0, 600.0))
        ends = [np.arccos((way**2 + 500.0**2 - b * b) / (1000.0 * way)) for way in (a - 100.0, a + 100.0)]
    lag = np.abs(ends[0] - ends[1])
    fits = (np.maximum(abs(inner), abs(outer)) <= math.cos(math.radians(least))) & (math.pi + lag >= ratio * (math.pi - lag))
    return np.array([a[fits], b[fits]])


@pytest.mark.parametrize(
    ("name", "sense", "other"), [("coupler", "<=", 1), ("coupler", ">=", 1), ("rocker", "<=", 0), ("rocker", ">=", 0)]
)
def test_the_tightest_limit_is_that_of_a_grid(name, sense, other):
    """From one design that meets the other limits, far from the end."""
    limits = {"limits.time_ratio": {"min": 1.331}, "limits.transmission_angle": ["38 deg", "142 deg"]}
    ends = ["100 mm", "100.001 mm"] if sense == "<=" else ["899.999 mm", "900 mm"]
    problem = optlink.load("crank-rocker").override({**limits, f"mechanism.{name}": {"bounds": ends}})
    grid = crank_rockers(1.331, 38)
    point = dict(zip(("coupler", "rocker"), 1e-3 * grid[:, np.argsort(grid[other])[grid.shape[1] // 2]], strict=True))
    nlp = build(problem.spec)
    end = tightest(nlp, f"mechanism.{name}", sense, nlp.x_of(point, bounded=False))
    assert end is not None
    computed = 1e3 * nlp.design(end)[name]
    best = np.min(grid[1 - other]) if sense == "<=" else np.max(grid[1 - other])
    assert 0.0 <= (best - computed) * (1.0 if sense == "<=" else -1.0) <= 2.0  # two steps of the grid


def test_a_relaxed_value_within_rounding_of_zero_is_zero() -> None:
    assert outward(Relaxation("output", "requirements", ">=", 60.0, -1.8e-13, 60.0, "mm"), 4) == 0.0
    assert outward(Relaxation("output", "requirements", ">=", 60.0, -1.8e-3, 60.0018, "mm"), 4) == pytest.approx(
        -1.8e-3, rel=1e-3
    )
