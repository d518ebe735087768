"""Which limits of a function problem conflict, and by how much each would have to give: against a grid of linkages."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

import optlink
from optlink.optimization.nlp import build
from optlink.report.views.relaxations import outward
from optlink.solvers.infeasibility import Explanation, explain, limit_sides
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
def found() -> Explanation:
    problem = optlink.load("function-sin", {"mechanism.assembly": "left", **LIMITS})
    reason = explain(build(problem.spec))
    assert isinstance(reason, Explanation)
    return reason


@pytest.mark.slow
def test_the_limits_of_transmission_and_proportions_are_named(found: Explanation) -> None:
    named = {(item.key, item.sense) for item in found.conflict}
    assert {key for key, _ in named} == {"limits.transmission_angle", "limits.link_ratio"}
    assert {("limits.transmission_angle", sense) for sense in ("<=", ">=")} <= named  # the ratios need one side alone
    assert all(math.isfinite(item.relaxed) for item in found.conflict)


def test_a_relaxation_is_the_least_that_a_grid_of_linkages_shows(found: Explanation) -> None:
    """Both sides of the range give by the same angle, although the rows are cosines."""
    least, largest = transmission()
    needed = float(np.nanmin(np.maximum(80.0 - least, largest - 82.0)))
    sides = {item.sense: item for item in found.conflict if item.key == "limits.transmission_angle"}
    assert all(side.both_sides for side in sides.values())
    for side in sides.values():
        assert side.amount == pytest.approx(needed, abs=0.5)  # between the linkages of the grid
        assert side.amount <= needed + 1e-6


def test_what_has_no_part_in_a_limit_cannot_conflict() -> None:
    """The rocker's start angle moves no limit; the crank's may take every direction, so its bounds hold nothing back."""
    problem = optlink.load("function-sin", {"mechanism.assembly": "left", **LIMITS})
    assert {side.name for side in limit_sides(build(problem.spec))}.isdisjoint({"phi0", "psi0"})
    narrow = problem.override({"requirement.from": {"start": "10 deg", "bounds": ["0 deg", "20 deg"]}})
    assert "phi0" in {side.name for side in limit_sides(build(narrow.spec))}


@pytest.mark.slow
def test_both_sides_of_a_range_are_relaxed_as_one() -> None:
    """A wiper with 45..135 deg: either side gives to the best transmission angle of its swing.

    With equal strokes frame^2 + crank^2 = coupler^2 + rocker^2 and crank = rocker sin(swing/2), hence the worst cosine is
    sin(swing/2) frame/coupler, least for the shortest rocker.
    """
    file = optlink.load(TEMPLATES / "wiper.toml", {"limits.swing_angle": "100 deg"})
    found = solve(file.override({"limits.transmission_angle": ["45 deg", "135 deg"]}), starts=5)
    low, high = (item for item in found.conflict if item.key == "limits.transmission_angle")
    assert low.both_sides
    assert high.both_sides
    frame, rocker, half = 250.0, 30.0, math.radians(50.0)
    coupler = math.sqrt(frame**2 - (rocker * math.cos(half)) ** 2)
    best = math.degrees(math.acos(math.sin(half) * frame / coupler))
    assert low.relaxed == pytest.approx(best, abs=1e-4)
    assert high.relaxed == pytest.approx(180.0 - best, abs=1e-4)
    printed = [f"{outward(item, 6)!r} deg" for item in (low, high)]
    assert solve(file.override({"limits.transmission_angle": printed}), starts=5).valid
