"""Which limits of a function problem conflict, and by how much each would have to give: against a grid of linkages."""

from __future__ import annotations

import math

import numpy as np
import pytest

import optlink
from optlink.optimization.nlp import build
from optlink.solvers.infeasibility import Explanation, explain, limit_sides

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
    named = {(item.key, item.sense): item for item in found.conflict}
    both = ("<=", ">=")
    assert set(named) == {(f"limits.{key}", sense) for key in ("transmission_angle", "link_ratio") for sense in both}
    assert all(math.isfinite(item.relaxed) for item in found.conflict)


def test_a_relaxation_is_the_least_that_a_grid_of_linkages_shows(found: Explanation) -> None:
    least, largest = transmission()
    largest_of_those = float(np.nanmin(np.where(least >= 80.0, largest, np.nan)))
    relaxed = next(item.relaxed for item in found.conflict if item.key == "limits.transmission_angle" and item.sense == "<=")
    assert relaxed <= largest_of_those + 1e-6
    assert relaxed == pytest.approx(largest_of_those, abs=0.5)  # between the linkages of the grid


def test_what_has_no_part_in_a_limit_cannot_conflict() -> None:
    """The rocker's start angle moves no limit; the crank's may take every direction, so its bounds hold nothing back."""
    problem = optlink.load("function-sin", {"mechanism.assembly": "left", **LIMITS})
    assert {side.name for side in limit_sides(build(problem.spec))}.isdisjoint({"phi0", "psi0"})
    narrow = problem.override({"requirement.from": {"start": "10 deg", "bounds": ["0 deg", "20 deg"]}})
    assert "phi0" in {side.name for side in limit_sides(build(narrow.spec))}
