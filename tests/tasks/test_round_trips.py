"""Round trips: a random crank-rocker's own curve brings back a linkage that passes it, whatever its size, place and timing."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import optlink
from optlink.tasks.design import solve
from tests import synthesis_oracle as oracle
from tests.random_linkages import RECOVERED, TIMINGS, VARIANTS, defects, four_bar_of, recover, round_trip
from tests.tiers import mostly_slow

COUNTS = (5, 9, 18, 60)
FEW = 3  # linkages


@pytest.mark.parametrize("seed", mostly_slow(range(FEW), 0))
@pytest.mark.parametrize("timing", TIMINGS)
def test_a_curve_of_a_known_four_bar_is_recovered(timing: str, seed: int) -> None:
    result = recover(round_trip(1000 + seed, COUNTS[0], timing), designs=1)
    assert not result.faults, result
    assert result.recovered, result


@pytest.mark.slow
@pytest.mark.parametrize("count", COUNTS)
@pytest.mark.parametrize("timing", TIMINGS)
def test_many_curves_are_recovered(timing: str, count: int) -> None:
    """Size and place do not matter: every timing and every number of points has plain, tiny, huge, turned and shifted curves."""
    names, first = list(VARIANTS), 2 * COUNTS.index(count) + TIMINGS.index(timing)
    for seed in (first, first + 1):
        result = recover(round_trip(seed, count, timing, **VARIANTS[names[seed % len(names)]]), designs=1)
        assert not result.faults, (seed, result)
        assert result.recovered, (seed, result)


def test_a_variant_is_the_same_linkage_moved() -> None:
    plain = round_trip(3, 12, "given")
    for changes in VARIANTS.values():
        trip = round_trip(3, 12, "given", **changes)
        scale = changes.get("scale", 1.0)
        assert trip.size == pytest.approx(scale * plain.size, rel=1e-9)
        turned = np.exp(1j * changes.get("turn", 0.0))
        one, other = (oracle.complex_points(t.points) for t in (plain, trip))
        np.testing.assert_allclose(other - other[0], scale * turned * (one - one[0]), atol=1e-9 * trip.size)
    assert abs(other[0] - one[0]) == pytest.approx(30.0 * np.hypot(*np.ptp(plain.points, axis=0)), rel=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("timing", TIMINGS)
def test_a_curve_of_no_four_bar_is_not_recovered(timing: str) -> None:
    """One point off the curve by a hundredth of its size: the best linkage misses the points and reports it."""
    trip = round_trip(1001, 18, timing)
    points = trip.points.copy()
    points[7] += 0.01 * trip.size
    result = recover(dataclasses.replace(trip, points=points), designs=1)
    assert not result.faults
    assert not result.recovered
    assert result.miss > 1e4 * RECOVERED


def test_the_other_assembly_mode_is_detected() -> None:
    """Of a design that was found, the mirrored assembly and the reversed order are defects."""
    trip = round_trip(1000, 9, "given")
    design = solve(optlink.read(trip.raw), designs=1).designs[0]
    linkage = four_bar_of(design)
    assert defects(oracle.judge_path(linkage, trip.points, design.crank_angles), turning=True) == []
    flipped = {**linkage, "mode": -linkage["mode"]}
    assert "branch" in defects(oracle.judge_path(flipped, trip.points, design.crank_angles), turning=True)
    mixed = design.crank_angles[[0, 2, 1, *range(3, 9)]]
    assert "order" in defects(oracle.judge_path(linkage, trip.points, mixed), turning=True)
    stuck = {**linkage, "frame": linkage["crank"] * 0.9}
    assert "does not turn" in defects(oracle.judge_path(stuck, trip.points, design.crank_angles), turning=True)
