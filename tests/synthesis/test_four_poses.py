"""Curves of the dyads of four poses: own sampling of the cubic, lengths, order and defects against stepping, special sets."""

import math
import time

import numpy as np
import pytest

from optlink.synthesis import four_poses
from optlink.synthesis.five_poses import link
from optlink.synthesis.four_poses import DEFECTS, curves
from tests.synthesis.test_five_poses import steps_through


def random_poses(seed, step=0.9):
    rng = np.random.default_rng(seed)
    z = rng.normal(0.0, 1.0, (4, 2)) @ np.array([1.0, 1j])
    return z, np.concatenate([[0.3], 0.3 + np.cumsum(rng.uniform(0.1, step, 3))])


def determinant(z, turn, a):
    """Zero where equal distances of a body point from a pivot in all poses are three consistent linear equations of the point."""
    rows = []
    for k in range(1, 4):
        back = np.exp(-1j * (turn[k] - turn[0])) * (z[k] - a) - (z[0] - a)
        rows.append([2.0 * back.real, 2.0 * back.imag, np.abs(z[k] - a) ** 2 - np.abs(z[0] - a) ** 2])
    return np.linalg.det(np.moveaxis(np.array(rows), (0, 1), (-2, -1)))


def off_circle(z, turn, p):
    """Zero where the four places of a body point lie on a circle or a line: the imaginary part of their cross ratio."""
    q = [z[k] + np.exp(1j * (turn[k] - turn[0])) * (p - z[0]) for k in range(4)]
    return ((q[0] - q[2]) * (q[1] - q[3]) * np.conj((q[0] - q[3]) * (q[1] - q[2]))).imag


def crossings(z, turn, half, lines=24, determinant=determinant):
    """Places on horizontal and vertical lines at which the determinant changes its sign, by bisection of a dense grid."""
    along = np.linspace(-half, half, 1501)
    for level in np.linspace(-half, half, lines):
        for turned in (1.0, 1j):
            place = z[0] + turned * (along + 1j * level)
            value = determinant(z, turn, place)
            for k in np.flatnonzero(np.sign(value[1:]) != np.sign(value[:-1])):
                low, high = place[k], place[k + 1]
                for _ in range(40):
                    middle = 0.5 * (low + high)
                    same = np.sign(determinant(z, turn, middle)) == np.sign(value[k])
                    low, high = (middle, high) if same else (low, middle)
                yield 0.5 * (low + high)


def distance(line, place):
    """Least distance of a place from a line with gaps, by segments."""
    one, other = line[:-1], line[1:]
    share = np.clip((np.conj(other - one) * (place - one)).real / np.maximum(np.abs(other - one) ** 2, 1e-300), 0.0, 1.0)
    return float(np.nanmin(np.abs(one + share * (other - one) - place)))


@pytest.mark.parametrize("seed", range(6))
def test_every_crossing_of_a_grid_lies_on_the_curve(seed):
    z, turn = random_poses(seed)
    found = curves(z, turn)
    half = 2.0 * found.size
    seen = [distance(found.dyads[1], place) for place in crossings(z, turn, half)]
    assert len(seen) > 30
    assert max(seen) < 5e-3 * found.size


SPECIALS = {
    "mirrored": ([1 + 0.4j, 0.6 - 0.2j, -0.6 - 0.2j, -1 + 0.4j], [0.9, 0.3, -0.3, -0.9]),
    "doubly symmetric": ([1, np.exp(1j), -1, -np.exp(1j)], [0.0, 0.6, 0.0, 0.6]),
    "one pole of two pairs": (
        np.exp([0j, 0.5j, 1.1j, 1.9j]) * [1 + 0.5j, 1 + 0.5j, 0.2j - 0.4, 0.2j - 0.4],
        [0.0, 0.5, 1.1, 1.9],
    ),
    "one point at two pairs": (np.exp([0j, 0.5j, 1.1j, 1.9j]) * (0.8 - 0.1j) + [0, 0, 1.3, 1.3], [0.0, 0.5, 1.1, 1.9]),
}


@pytest.mark.parametrize("name", SPECIALS)
def test_no_straight_part_of_the_curves_is_lost(name):
    """Poses with lines of pivots, of points, or of points that have one pivot: the pole that is used may lie on them."""
    z, turn = map(np.array, SPECIALS[name])
    for order in ([0, 1, 2, 3], [2, 0, 3, 1]):
        found = curves(z[order], turn[order])
        assert not found.special
        assert lengths_kept(found) < 1e-10
        for line, zero in zip(found.dyads, (off_circle, determinant), strict=True):
            seen = [np.nanmin(np.abs(line - at)) for at in crossings(found.places, found.angles, 2.0 * found.size, 8, zero)]
            assert len(seen) >= 8
            assert max(seen) < 0.1 * found.size


@pytest.mark.parametrize("near", [0.0, 1e-7])
@pytest.mark.parametrize("odd", range(4))
def test_three_poses_about_one_point_are_told_in_any_order(odd, near):
    angles = np.array([0.2, 1.5, -0.7, 0.9])
    places = np.exp(1j * angles) * (1 + 0.5j) + 2 + near * np.array([1, 1j, -1, 2j])
    places[odd] = 0.3 - 1.2j
    assert curves(places, angles).special == four_poses.CENTRE_OF_THREE.format(odd + 1)
    angles = np.insert(np.zeros(3), odd, 0.4)
    assert curves(np.insert([0.0, 1 + 1j, 3 + 3j], odd, 1j), angles).special == four_poses.LINE_OF_THREE.format(odd + 1)
    assert not curves(np.insert([0.0, 1 + 1j, 3 + 2j], odd, 1j), angles).special


def lengths_kept(found):
    """Largest relative change of the length of a dyad between the poses, by displacing its point as part of the body."""
    points, pivots = (part[~np.isnan(part)] for part in found.dyads)
    moved = found.places + np.exp(1j * (found.angles - found.angles[0])) * (points[:, None] - found.places[0])
    lengths = np.abs(moved - pivots[:, None])
    return float(np.max(np.ptp(lengths**2, axis=1) / np.max(lengths**2 + found.size**2, axis=1)))


@pytest.mark.parametrize("alike", [(), (1, 2), (0, 3), (0, 1, 2)])
def test_every_dyad_keeps_its_length(alike):
    """Also with poses that do not turn against each other, whose poles lie at infinity."""
    for seed in range(30):
        z, turn = random_poses(seed)
        turn[list(alike)] = turn[list(alike[:1])]
        found = curves(z, turn)
        assert lengths_kept(found) < 1e-10
        assert len(found.poles) == 6 - len(alike) * (len(alike) - 1) // 2
        assert all(distance(found.dyads[1], complex(*pole)) < 5e-3 * found.size for pole in found.poles)


def test_both_kinds_of_curves_are_closed_and_evenly_traced():
    counts = set()
    for poses in [*map(random_poses, range(20)), *(SPECIALS[name] for name in SPECIALS.keys() - {"doubly symmetric"})]:
        found = curves(*poses)
        counts.add(found.count)
        ends = np.flatnonzero(np.isnan(found.homogeneous[0][:, 0]))
        for part in found.homogeneous:
            for first, last in zip([0, *(ends[:-1] + 1)], ends, strict=True):
                steps = np.linalg.norm(np.cross(part[first : last - 1], part[first + 1 : last]), axis=1)
                assert np.linalg.norm(np.cross(part[first], part[last - 1])) < 1e-6
                assert np.max(steps) < 0.04
    assert counts == {1, 2}


def test_defects_and_order_equal_stepping():
    compared, usable = 0, 0
    for seed in range(60):
        z, turn = random_poses(seed, 0.6)
        found = curves(z, turn)
        rows = np.random.default_rng(seed).choice(np.flatnonzero(~np.isnan(found.points[:, 0])), 6, replace=False)
        every = found.partners(rows, rows)
        dyads = [link(*(part[k] for part in found.dyads), found.size) for k in rows]
        for i, j in np.argwhere(every.defect < DEFECTS.index("no four-bar")):
            passes = steps_through(z, turn, dyads[i], dyads[j])
            assert passes == (every.defect[i, j] == 0)
            assert found.in_order[rows[i]] or not passes
            compared, usable = compared + 1, usable + passes
    assert compared > 1500
    assert usable > 40


def test_turning_and_transmission_equal_a_sweep():
    z, turn = random_poses(3)
    found = curves(z, turn)
    rows = np.flatnonzero(~np.isnan(found.points[:, 0]))[::40]
    every, seen = found.partners(rows, rows), set()
    for i, j in np.argwhere(every.defect < DEFECTS.index("no four-bar")):
        (b0, e0), (a, c) = (part[[rows[i], rows[j]]] for part in found.dyads)
        gap = np.abs(a + abs(b0 - a) * np.exp(1j * np.linspace(0.0, math.tau, 721)) * (c - a) / abs(c - a) - c)
        coupler, rocker = abs(e0 - b0), abs(e0 - c)
        cosine = (coupler**2 + rocker**2 - gap**2) / (2.0 * coupler * rocker)
        turns = bool(np.all(np.abs(cosine) < 1.0))
        assert turns == every.turns[i, j]
        assert every.around[i, j] == pytest.approx(np.min(np.arccos(np.abs(cosine))) if turns else 0.0, abs=1e-9)
        seen.add(turns)
    assert seen == {True, False}


@pytest.mark.parametrize(
    ("places", "turns", "words"),
    [
        ([0, 1, 1j, 1], [0.0, 0.3, 0.6, 0.3], "poses 2 and 4 are the same: three poses"),
        ([0, 1, 1j, 2], [0.2] * 4, "does not turn"),
        ([2 + 1j - (2 + 1j) * np.exp(1j * t) for t in (0.0, 0.3, 0.5, 0.9)], [0.0, 0.3, 0.5, 0.9], "about one point"),
        ([0, 0, 0, 1], [0.0, 0.3, 0.5, 0.9], "in all poses but 4 the body turns about one point: each dyad"),
    ],
)
def test_special_poses_give_a_sentence(places, turns, words):
    found = curves(places, turns)
    assert words in found.special
    assert (len(found.points), found.count) == (0, 0)


def test_the_curves_take_less_than_50_ms():
    poses = next(poses for poses in map(random_poses, range(20)) if curves(*poses).count == 2)
    spent = []
    for _ in range(5):
        begin = time.process_time()
        curves(*poses)
        spent.append(time.process_time() - begin)
    assert min(spent) < 0.05
