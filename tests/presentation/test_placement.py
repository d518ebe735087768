"""Texts are placed clear of lines and of one another, in still drawings and in motion."""

from __future__ import annotations

import numpy as np
import pytest

import optlink
from optlink.presentation.placement import Places, arrange, beside
from optlink.presentation.scene import scene
from tests.tiers import mostly_slow

HALF = np.array([2.0, 0.5])


def test_every_place_beside_a_point_is_as_far_away_as_asked() -> None:
    places = beside(np.array([[3.0, -1.0]]), HALF, np.array([0.4, 1.5]), 0.5, [], (0.3, 0.3))
    away = np.linalg.norm(np.maximum(np.abs(places.middles) - HALF, 0.0), axis=1)
    np.testing.assert_allclose(away, np.repeat([0.4, 1.5], 16), rtol=1e-12)


def test_a_text_keeps_clear_of_a_line_and_another_text() -> None:
    """A line crosses the first of three places: of two texts, one gets the second place and the other the third."""
    places = Places(np.zeros((1, 2)), np.array([[0.0, 0.0], [0.0, 2.0], [0.0, 4.0]]), HALF, np.array([[0.0, 0.1, 0.2]]))
    line = np.array([[[-20.0, 0.0], [20.0, 0.0]]])
    assert sorted(int(choice[0]) for choice in arrange([places, places], [(line, 3.0)], 1.0)) == [1, 2]
    assert [choice[0] for choice in arrange([places], [], 1.0)] == [0]


def test_a_moving_text_changes_its_place_only_for_long() -> None:
    """Left and right of its point: a line that passes one place is let pass, one that stays makes the text change once."""
    sides = np.array([[-3.0, 0.0], [3.0, 0.0]])
    places = Places(np.zeros((40, 2)), sides, HALF, np.array([[0.0, 0.1]]), moves=True)

    def met(left: range, right: range) -> np.ndarray:
        lines = np.full((2, 40, 2, 2), np.nan)
        for line, positions, middle in zip(lines, (left, right), sides, strict=True):
            line[positions] = middle + np.array([[-2.0, 0.0], [2.0, 0.0]])
        [choice] = arrange([places], [(line, 1.0) for line in lines], 1.0)
        return choice

    assert np.all(met(range(10, 12), range(0)) == 1)  # without a line the other place is as good
    assert np.all(met(range(10, 12), range(40)) == 0)
    np.testing.assert_array_equal(met(range(15, 40), range(15)), np.arange(40) >= 15)


@pytest.mark.parametrize(
    "name", mostly_slow(["shaper", "watt-i", "whitworth", "slider-crank", "two-wipers"], "whitworth", "slider-crank")
)
def test_names_of_points_hide_no_joint_and_no_ground(name: str) -> None:
    drawn = scene(optlink.analyze(optlink.load(name)), 90)
    ground = np.concatenate([line for line, _, _ in drawn.ground])
    for own, (middles, choice) in drawn.places_of_names.items():
        half = 0.5 * 9.0 / 8.0 * drawn.size * np.array([0.6 * len(own), 0.8])
        middle = drawn.points[own] + middles[choice]
        hidden = [np.all(np.abs(path - middle) < half, axis=1) for path in drawn.points.values()]
        assert np.mean(hidden) <= 0.02, own
        if own not in drawn.moving:
            assert not np.any(np.all(np.abs(ground - middle[0]) < half, axis=1)), own


def test_a_text_beside_a_point_does_not_seem_to_belong_to_another() -> None:
    """The other point lies where the text is preferred: the text is nearer to its own, on the other side."""
    own, other = np.array([[0.0, 0.0]]), np.array([[3.0, 0.5]])
    places = beside(own, HALF, np.array([0.4, 1.5]), 0.5, [other], (0.3, 0.3))
    [choice] = arrange([places], [], 1.0)
    gaps = [np.linalg.norm(np.maximum(np.abs(point[0] - places.middles[choice[0]]) - HALF, 0.0)) for point in (own, other)]
    assert gaps[0] < 0.8 * gaps[1]
