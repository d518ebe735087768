"""Certificates of timed four-bar paths: stopped, resumed from a worse design, and closed."""

from __future__ import annotations

import numpy as np
import pytest

import optlink
from optlink.solvers.global_search.timed_path import TimedPathBounds
from optlink.tasks import design
from optlink.tasks.certify import _PathSearch, certify
from optlink.tasks.results.certificate import NOT_CLOSED, WITHIN_GAP

OPTIMUM = {"path-arc5": (1.07226, np.pi - 0.882651, 0.562827), "path-closed18": (1.18841202, -0.52414634, 0.21657324, 0.89155585)}
BEST = {"path-arc5": 7.41575131e-13, "path-closed18": 9.02888464e-9}


def near_optimum(name: str, off: float, **changes: object) -> tuple[optlink.SynthesisResult, TimedPathBounds, np.ndarray]:
    problem = optlink.load(name, changes)
    bounds = TimedPathBounds(problem.model)
    point = np.array(OPTIMUM[name])
    worse = point + off
    variant = next(one for one in problem.variants() if (one.model.four_bar.side > 0) == bounds.left(worse))
    values = bounds.design(worse)
    return design.validate(variant, {name: values[name] for name in variant.model.free}), bounds, point


@pytest.mark.parametrize("name", OPTIMUM)
def test_a_better_design_in_a_box_is_found_and_becomes_the_result(name: str) -> None:
    result, bounds, point = near_optimum(name, 0.003)
    assert result.valid
    assert result.objective > 1.0001 * BEST[name]
    search = _PathSearch(result, optlink.load(name), 1e-3, 0)
    assert search._from_box(bounds, point) == pytest.approx(BEST[name], rel=1e-6)
    assert search.improved
    assert search.result.objective == pytest.approx(BEST[name], rel=1e-6)
    assert search._from_box(bounds, point) == search._known  # no further improvement


def test_a_stopped_proof_states_the_remaining_share() -> None:
    result, _, _ = near_optimum("path-arc5", 0.0)
    outcome = certify(result, gap=0.9, boxes=5_000, original=optlink.load("path-arc5"))
    certificate = outcome.certificate
    assert certificate.status == NOT_CLOSED
    assert certificate.open_boxes > 0
    assert certificate.lower_bound <= BEST["path-arc5"]
    assert certificate.covers == ()


@pytest.mark.slow
def test_timed_arc_is_globally_optimal() -> None:
    """Within limits that the best design meets (transmission angle 18.6 deg); without them the proof takes ten times as long."""
    limits = {"limits.link_ratio": [0.333, 3.0], "limits.transmission_angle": ["18 deg", "162 deg"]}
    result, _, _ = near_optimum("path-arc5", 0.0, **limits)
    assert result.valid
    outcome = certify(result, gap=1e-3, original=optlink.load("path-arc5", limits))
    assert outcome.certificate.status == WITHIN_GAP
    assert outcome.certificate.lower_bound == pytest.approx(BEST["path-arc5"], rel=2e-3)
    assert outcome.certificate.lower_bound <= BEST["path-arc5"]
