"""The kinematics core against geometry written a second time: triangles, dense sweeps and differences, over random linkages."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, example, given, strategies as st

from optlink.linkage import dyads as groups_module
from optlink.linkage.dyads import RRR, rrr
from optlink.linkage.fourbar import (
    LENGTHS,
    Inversion,
    classify,
    crank_rocker_conditions,
    dead_centre,
    double_crank_conditions,
    four_bar,
    grashof,
    reachable,
    swing,
    time_ratio,
    transmission_cosine,
    turning_points,
)
from optlink.linkage.mechanism import BodyPoint, Link, Mechanism
from optlink.linkage.motion import Motion, sweep
from optlink.linkage.vector2d import unit
from tests.tiers import examples

seeded = examples(150)
fewer = examples(50)

REVOLUTION = np.linspace(0.0, 2.0 * np.pi, 361)

size = st.floats(0.05, 5.0)
share = st.floats(0.05, 0.95)
sides = st.sampled_from([1, -1])
angles = st.floats(-np.pi, np.pi)
any_lengths = st.tuples(size, size, size, size)


@st.composite
def crank_rockers(draw: Callable) -> tuple[float, float, float, float]:
    """Crank, coupler, rocker, frame: the crank is the shortest link and turns fully, never within 5 % of a change point."""
    crank = draw(st.floats(0.1, 1.0))
    coupler, rocker = (crank * (1.1 + 4.0 * draw(share)) for _ in range(2))
    least = crank + abs(coupler - rocker)
    return crank, coupler, rocker, least + draw(share) * (coupler + rocker - crank - least)


@st.composite
def turning(draw: Callable) -> tuple[float, float, float, float]:
    """A crank-rocker or a double-crank."""
    crank, coupler, rocker, frame = draw(crank_rockers())
    return (crank, coupler, rocker, frame) if draw(st.booleans()) else (frame, coupler, rocker, crank)


def sized(lengths: tuple[float, ...]) -> dict[str, float]:
    return dict(zip(LENGTHS, lengths, strict=True))


def slack_of(lengths: tuple[float, ...]) -> float:
    """Grashof's slack over the longest link."""
    ordered = sorted(lengths)
    return (ordered[1] + ordered[2] - ordered[0] - ordered[3]) / ordered[3]


# --- geometry, written again ---------------------------------------------------------------------------------------


def closes(lengths: tuple[float, ...], phi: np.ndarray | float) -> np.ndarray:
    """How far the triangle B-C-D is from falling apart, over the longest link: negative where it cannot be drawn.

    B is placed by the crank, the distance to D is measured, and the three triangle inequalities are asked.
    """
    crank, coupler, rocker, frame = lengths
    diagonal = np.hypot(crank * np.cos(phi) - frame, crank * np.sin(phi))
    least = np.minimum(coupler + rocker - diagonal, np.minimum(diagonal + rocker - coupler, diagonal + coupler - rocker))
    return least / max(lengths)


def rocker_angle(lengths: tuple[float, ...], phi: np.ndarray, side: int) -> np.ndarray:
    """Angle of D -> C by the angles of the triangle B-C-D, seen from D: C lies to the left of B -> D for side +1."""
    crank, coupler, rocker, frame = lengths
    x, y = crank * np.cos(phi) - frame, crank * np.sin(phi)
    diagonal = np.hypot(x, y)
    at_d = np.arccos((diagonal**2 + rocker**2 - coupler**2) / (2.0 * diagonal * rocker))
    return np.arctan2(y, x) - side * at_d


def extreme(function: Callable[[np.ndarray], np.ndarray]) -> tuple[float, float]:
    """Where a function of the crank angle is least over the revolution, and its value, by narrowing dense sweeps."""
    centre, width = math.pi, math.pi
    for _ in range(9):
        near = centre + width * np.linspace(-1.0, 1.0, 721)
        centre, width = float(near[np.argmin(function(near))]), width / 90.0
    return centre, float(function(np.array([centre]))[0])


def limit_positions(lengths: tuple[float, ...], side: int) -> tuple[tuple[float, float], tuple[float, float]]:
    """(phi, psi) where the rocker is farthest from the crank pivot (outer), and where it is nearest (inner)."""
    start = rocker_angle(lengths, np.array([0.0]), side)[0]

    def away(phi: np.ndarray) -> np.ndarray:  # counted from the position at phi = 0, where no branch cut is near
        return side * (np.remainder(rocker_angle(lengths, phi, side) - start + np.pi, 2.0 * np.pi) - np.pi)

    outer, inner = extreme(away), extreme(lambda phi: -away(phi))
    return (outer[0], start + side * outer[1]), (inner[0], start - side * inner[1])


def check_lengths(mechanism: Mechanism, points: Mapping[str, tuple], sizes: Mapping[str, float]) -> None:
    """Every link as long as it is said to be, measured between its joints."""
    for link in mechanism.links:
        (x0, y0), (x1, y1) = points[link.start], points[link.end]
        expected = sizes[link.length] if isinstance(link.length, str) else link.length
        np.testing.assert_allclose(np.hypot(x1 - x0, y1 - y0), expected, rtol=1e-11, err_msg=link.body)


def same_angle(computed: float, expected: float, tolerance: float) -> None:
    assert abs(math.remainder(computed - expected, 2.0 * math.pi)) <= tolerance, (computed, expected)


# --- dyads and poses -----------------------------------------------------------------------------------------------

coordinate = st.floats(-3.0, 3.0)
plane = st.tuples(coordinate, coordinate)


@seeded
@given(plane, plane, size, size, sides)
def test_rrr_joint_lies_at_both_distances_and_on_its_side_or_nowhere(p, q, a, b, side):
    distance = math.dist(p, q)
    assume(distance > 0.01)
    apart = min(a + b - distance, distance + a - b, distance + b - a)
    assume(abs(apart) > 1e-3)
    (x, y), margin = rrr(p, q, a, b, side)
    assert (margin > 0.0) == (apart > 0.0)
    if apart > 0.0:
        np.testing.assert_allclose(math.dist(p, (x, y)), a, rtol=1e-10)
        np.testing.assert_allclose(math.dist(q, (x, y)), b, rtol=1e-10)
        cross = (q[0] - p[0]) * (y - p[1]) - (q[1] - p[1]) * (x - p[0])
        assert side * cross > 0.0
        np.testing.assert_allclose(margin, (cross / distance**2) ** 2, rtol=1e-8, atol=1e-12)
    else:
        assert math.isnan(x)
        assert math.isnan(y)


@pytest.mark.parametrize("side", [1, -1])
def test_rrr_by_hand(side):
    """A 3-4-5 triangle lying on its hypotenuse: the foot at 9/5, the height 12/5."""
    (x, y), margin = rrr((0.0, 0.0), (5.0, 0.0), 3.0, 4.0, side)
    np.testing.assert_allclose((x, y, margin), (1.8, side * 2.4, (2.4 / 5.0) ** 2), rtol=1e-14)


@pytest.mark.parametrize("number", [float, np.float64, lambda v: np.array([v])], ids=["float", "numpy", "array"])
def test_rrr_with_both_outer_joints_in_one_place_has_no_joint(number):
    """The docstring promises NaN where p = q, whatever kind of number comes."""
    p = (number(0.3), number(0.1))
    (x, y), margin = rrr(p, p, number(0.2), number(0.2), 1)
    assert np.all(np.isnan([x, y]))
    assert not np.any(margin > 0.0)


@seeded
@given(any_lengths, angles, sides)
def test_links_keep_their_length_or_the_joint_does_not_exist(lengths, phi, side):
    mechanism, sizes = four_bar(side), sized(lengths)
    assume(abs(closes(lengths, phi)) > 1e-4)
    pose = mechanism.pose(sizes, unit(phi))
    if closes(lengths, phi) > 0.0:
        assert pose.margins["C"] > 0.0
        check_lengths(mechanism, pose.points, sizes)
    else:
        assert not pose.margins["C"] > 0.0  # negative, or NaN where B lies on D
        assert np.all(np.isnan(pose.points["C"]))
        assert np.all(np.isfinite([*pose.points["B"], *pose.points["D"], *pose.points["A"]]))


@seeded
@given(any_lengths, sides)
@example((0.3, 0.2, 0.2, 0.45), 1)
@example((0.1, 0.9, 0.1, 0.5), -1)
def test_nan_and_only_nan_where_the_margin_is_negative(lengths, side):
    motion = sweep(four_bar(side), sized(lengths), REVOLUTION)
    margin, apart = motion.margin("C"), closes(lengths, REVOLUTION)
    clear = np.abs(apart) > 1e-6
    missing = ~(margin > 0.0)  # negative, or NaN where B lies on D
    np.testing.assert_array_equal(missing[clear], (apart < 0.0)[clear])
    for part in (motion.position("C"), motion.velocity("C"), motion.acceleration("C")):
        np.testing.assert_array_equal(np.isnan(part).any(axis=-1)[clear], missing[clear])
        np.testing.assert_array_equal(np.isnan(part).all(axis=-1)[clear], missing[clear])
    assert np.isfinite(motion.position("B")).all()


def test_the_two_kinds_of_missing_assembly_are_met():
    """The property above would be empty if no linkage ever failed to close, or none ever did."""
    assert closes((0.3, 0.2, 0.2, 0.45), 0.0) > 0.0 > closes((0.3, 0.2, 0.2, 0.45), math.pi)  # too far
    assert closes((0.3, 0.7, 0.2, 0.45), 0.0) < 0.0 < closes((0.3, 0.7, 0.2, 0.45), math.pi)  # too near


def wrong_sign(p, q, a, b, side):
    """The dyad with one sign turned: what a slip of the pen would give."""
    (x, y), margin = rrr(p, q, a, b, side)
    return (x + 2.0 * side * np.sqrt(margin) * (q[1] - p[1]), y), margin


def swapped_links(p, q, a, b, side):
    return rrr(p, q, b, a, side)


@pytest.mark.parametrize("defect", [wrong_sign, swapped_links])
def test_length_check_detects_a_defective_dyad(defect, monkeypatch):
    mechanism, sizes = four_bar(1), sized((0.1, 0.41, 0.23, 0.5))
    check_lengths(mechanism, mechanism.pose(sizes, unit(1.0)).points, sizes)
    monkeypatch.setattr(groups_module, "rrr", defect)
    points = mechanism.pose(sizes, unit(1.0)).points
    assert np.isfinite(points["C"]).all()
    with pytest.raises(AssertionError, match="coupler"):
        check_lengths(mechanism, points, sizes)


def test_length_check_detects_swapped_links():
    honest, sizes = four_bar(1), sized((0.1, 0.41, 0.23, 0.5))
    group = honest.groups[0]
    swapped = replace(group, first=replace(group.first, length="rocker"), second=replace(group.second, length="coupler"))
    points = replace(honest, groups=(swapped,)).pose(sizes, unit(1.0)).points
    with pytest.raises(AssertionError, match="coupler"):
        check_lengths(honest, points, sizes)


# --- what a change of place, size or side does -----------------------------------------------------------------------

POINTS = (BodyPoint("P", "coupler", 0.2, 0.15), BodyPoint("Q", "rocker", 0.07, -0.02))


def placed(side: int, a: tuple[float, float], d: tuple[float, float], points: tuple[BodyPoint, ...]) -> Mechanism:
    """The four-bar with its ground joints anywhere in the plane."""
    return replace(four_bar(side), ground={"A": a, "D": d}, points=points)


@seeded
@given(turning(), angles, sides)
def test_mirror(lengths, phi, side):
    """Reflected in the frame line: the other assembly mode at the mirrored crank angle, body points to the other side."""
    sizes, frame = sized(lengths), (lengths[3], 0.0)
    mirrored = tuple(replace(point, across=-point.across) for point in POINTS)
    one = placed(side, (0.0, 0.0), frame, POINTS).pose(sizes, unit(phi))
    other = placed(-side, (0.0, 0.0), frame, mirrored).pose(sizes, unit(-phi))
    for name in "BCDPQ":
        x, y = one.points[name]
        np.testing.assert_allclose(other.points[name], (x, -y), rtol=1e-10, atol=1e-12, err_msg=name)
    np.testing.assert_allclose(other.margins["C"], one.margins["C"], rtol=1e-12)


@seeded
@given(turning(), angles, sides, angles, plane)
def test_rotate_and_shift(lengths, phi, side, turned, shift):
    sizes, frame = sized(lengths), lengths[3]
    c, s = math.cos(turned), math.sin(turned)

    def moved(x: float, y: float) -> tuple[float, float]:
        return shift[0] + c * x - s * y, shift[1] + s * x + c * y

    one = placed(side, (0.0, 0.0), (frame, 0.0), POINTS).pose(sizes, unit(phi))
    other = placed(side, moved(0.0, 0.0), moved(frame, 0.0), POINTS).pose(sizes, unit(phi + turned))
    for name in "BCDPQ":
        expected = moved(*(float(v) for v in one.points[name]))
        np.testing.assert_allclose(other.points[name], expected, rtol=1e-9, atol=1e-11, err_msg=name)
    np.testing.assert_allclose(other.margins["C"], one.margins["C"], rtol=1e-8)


@seeded
@given(turning(), angles, sides, st.floats(0.001, 1000.0))
def test_scale(lengths, phi, side, factor):
    larger = tuple(factor * length for length in lengths)
    points = tuple(replace(p, along=factor * p.along, across=factor * p.across) for p in POINTS)
    one = placed(side, (0.0, 0.0), (lengths[3], 0.0), POINTS).pose(sized(lengths), unit(phi))
    other = placed(side, (0.0, 0.0), (larger[3], 0.0), points).pose(sized(larger), unit(phi))
    for name in "BCDPQ":
        expected = factor * np.array(one.points[name], dtype=float)
        np.testing.assert_allclose(other.points[name], expected, rtol=1e-9, atol=1e-12 * factor, err_msg=name)
    np.testing.assert_allclose(other.margins["C"], one.margins["C"], rtol=1e-9)


@seeded
@given(turning(), angles, sides)
def test_points_of_a_body_keep_their_place_on_it(lengths, phi, side):
    sizes = sized(lengths)
    mechanism = placed(side, (0.0, 0.0), (lengths[3], 0.0), POINTS)
    points = {name: np.array(p, dtype=float) for name, p in mechanism.pose(sizes, unit(phi)).points.items()}
    for point in POINTS:
        link = mechanism.link(point.body)
        along = (points[link.end] - points[link.start]) / sizes[link.length]
        arm = points[point.name] - points[link.start]
        np.testing.assert_allclose(arm @ along, point.along, rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(along[0] * arm[1] - along[1] * arm[0], point.across, rtol=1e-9, atol=1e-12)


def test_unknown_body():
    with pytest.raises(KeyError, match="flywheel"):
        four_bar().link("flywheel")


@fewer
@given(turning(), sides)
def test_pose_agrees_with_the_triangle(lengths, side):
    motion = sweep(four_bar(side), sized(lengths), REVOLUTION)
    c, d = motion.position("C"), motion.position("D")
    computed = np.arctan2(c[:, 1] - d[:, 1], c[:, 0] - d[:, 0])
    gap = np.remainder(computed - rocker_angle(lengths, REVOLUTION, side) + np.pi, 2.0 * np.pi) - np.pi
    np.testing.assert_allclose(gap, 0.0, atol=1e-9)


def test_six_bar_of_two_groups_closes():
    """Dyads are solved one after the other: a second one may stand on a body of the first."""
    base = four_bar(1)
    lever, rod = Link("rod", "C", "F", 0.3), Link("lever", "G", "F", 0.25)
    six = replace(base, ground={**base.ground, "G": (0.7, 0.1)}, groups=(*base.groups, RRR(lever, rod, ("C", "G"), "F", -1)))
    sizes = sized((0.1, 0.41, 0.23, 0.5))
    motion = sweep(six, sizes, REVOLUTION)
    assert (motion.margin("F") > 0.0).all()
    check_lengths(six, {name: motion.position(name).T for name in ("A", "B", "C", "D", "F", "G")}, sizes)


# --- dead centres, swing, time ratio, transmission angle -------------------------------------------------------------


@fewer
@given(crank_rockers(), sides)
def test_dead_centres_are_the_extremes_of_the_rocker_angle(lengths, side):
    outer, inner = limit_positions(lengths, side)
    for (phi, psi), is_outer in ((outer, True), (inner, False)):
        limit = dead_centre(*lengths, side, is_outer)
        assert limit.margin > 0.0
        same_angle(float(limit.psi), psi, 1e-10)
        same_angle(float(limit.phi), phi, 1e-6)  # flat there: an angle is found to the root of the rounding error
        np.testing.assert_allclose(np.hypot(*limit.crank), 1.0, rtol=1e-12)
        np.testing.assert_allclose(np.hypot(*limit.rocker), 1.0, rtol=1e-9)
        crank, coupler, rocker, frame = lengths
        joint = (frame + rocker * limit.rocker[0], rocker * limit.rocker[1])
        np.testing.assert_allclose(np.hypot(*joint), coupler + (crank if is_outer else -crank), rtol=1e-9)
    assert float(swing(*lengths, side)) == pytest.approx(side * math.remainder(inner[1] - outer[1], math.tau), abs=1e-9)
    assert float(swing(*lengths, side)) > 0.0


@fewer
@given(crank_rockers(), sides)
def test_time_ratio_is_that_of_the_sweep(lengths, side):
    (a, _), (b, _) = limit_positions(lengths, side)
    turned = (b - a) % math.tau
    slow, fast = max(turned, math.tau - turned), min(turned, math.tau - turned)
    computed = float(time_ratio(*lengths, side))
    np.testing.assert_allclose(computed, slow / fast, rtol=1e-5)
    assert computed >= 1.0
    np.testing.assert_allclose(time_ratio(*lengths, -side), computed, rtol=1e-12)


def test_time_ratio_is_one_for_a_centric_linkage_and_theirs_differ():
    """crank^2 + frame^2 = coupler^2 + rocker^2 makes both strokes equal (a centric crank-rocker)."""
    crank, coupler, rocker = 0.1, 0.4, 0.3
    frame = math.sqrt(coupler**2 + rocker**2 - crank**2)
    assert float(time_ratio(crank, coupler, rocker, frame, 1)) == pytest.approx(1.0, abs=1e-12)
    assert float(time_ratio(crank, coupler, rocker, 0.9 * frame, 1)) > 1.05


def test_dead_centre_check_detects_a_wrong_one():
    """Inner for outer, or the other side, is far outside the tolerances above."""
    lengths = (0.1, 0.41, 0.23, 0.5)
    outer, _ = limit_positions(lengths, 1)
    same_angle(float(dead_centre(*lengths, 1, True).psi), outer[1], 1e-10)
    for side, is_outer in ((1, False), (-1, True)):
        with pytest.raises(AssertionError):
            same_angle(float(dead_centre(*lengths, side, is_outer).psi), outer[1], 1e-10)


def test_dead_centres_by_hand():
    """Crank and coupler 4, frame 3, rocker 5: stretched at a right angle to the frame."""
    limit = dead_centre(0.5, 3.5, 5.0, 3.0, 1, True)
    np.testing.assert_allclose([limit.phi, limit.psi, limit.margin], [math.pi / 2, math.atan2(4.0, -3.0), 1.0], rtol=1e-14)


@pytest.mark.parametrize(("lengths", "outer"), [((0.3, 0.9, 0.1, 0.3), True), ((0.1, 0.2, 0.9, 0.3), False)])
def test_a_missing_dead_centre_is_reported(lengths, outer):
    limit = dead_centre(*lengths, 1, outer)
    assert limit.margin < 0.0
    assert math.isnan(limit.phi)
    assert math.isnan(limit.psi)


@pytest.mark.parametrize("lengths", [(0.1, 0.1, 0.3, 0.3), (0.2, 0.2, 0.15, 0.4)])
def test_inner_dead_centre_of_equal_crank_and_coupler_has_no_value(lengths):
    """C lies on A there, in no direction: not a position, but no reason to break down either."""
    limit = dead_centre(*lengths, 1, False)
    assert not limit.margin > 0.0
    assert not math.isfinite(limit.phi)


@fewer
@given(turning(), sides)
def test_transmission_angle_has_its_extremes_at_0_and_pi(lengths, side):
    motion = sweep(four_bar(side), sized(lengths), np.linspace(-np.pi, np.pi, 721))
    b, c, d = (motion.position(name) for name in "BCD")
    cosine = np.sum((b - c) * (d - c), axis=-1) / (np.linalg.norm(b - c, axis=-1) * np.linalg.norm(d - c, axis=-1))
    np.testing.assert_allclose(transmission_cosine(*lengths, np.cos(motion.crank_angle)), cosine, atol=1e-9)
    assert np.argmax(cosine) == 360  # phi = 0: the smallest angle
    assert np.argmin(cosine) in (0, 720)  # phi = pi: the largest
    np.testing.assert_allclose(transmission_cosine(*lengths, 1.0), np.max(cosine), atol=1e-9)
    np.testing.assert_allclose(transmission_cosine(*lengths, -1.0), np.min(cosine), atol=1e-9)


@seeded
@given(st.floats(-2.0 * np.pi, 2.0 * np.pi), st.floats(-2.0 * np.pi, 2.0 * np.pi))
@example(2.0 * np.pi, 2.0 * np.pi)
@example(-2.0 * np.pi, -2.0 * np.pi)
def test_turning_points_hold_the_extremes_of_every_function_of_the_cosine(start, span):
    cosine = np.cos(start + span * np.linspace(0.0, 1.0, 2001))
    points = np.array(turning_points(start, span), dtype=float)
    low, high = min(start, start + span), max(start, start + span)
    assert np.all((points >= low) & (points <= high))
    assert np.max(np.cos(points)) >= np.max(cosine) - 1e-12
    assert np.min(np.cos(points)) <= np.min(cosine) + 1e-12


# --- Grashof ---------------------------------------------------------------------------------------------------------

TEXTBOOK = [  # crank, coupler, rocker, frame; in order of the definition s + l < p + q, > and =
    *(((40, 120, 80, 100), Inversion.CRANK_ROCKER, 20.0), ((100, 120, 80, 40), Inversion.DOUBLE_CRANK, 20.0)),
    *(((100, 40, 80, 120), Inversion.DOUBLE_ROCKER, 20.0), ((80, 100, 40, 120), Inversion.ROCKER_CRANK, 20.0)),
    *(((60, 120, 80, 70), Inversion.TRIPLE_ROCKER, -30.0), ((50, 120, 50, 120), Inversion.PARALLELOGRAM, 0.0)),
    *(((70, 70, 70, 70), Inversion.PARALLELOGRAM, 0.0), ((50, 50, 120, 120), Inversion.KITE, 0.0)),
    *(((120, 50, 50, 120), Inversion.KITE, 0.0), ((40, 120, 70, 90), Inversion.CHANGE_POINT, 0.0)),
    *(((40, 250, 70, 90), Inversion.IMPOSSIBLE, -130.0), ((40, 70, 90, 201), Inversion.IMPOSSIBLE, -81.0)),
]


@pytest.mark.parametrize("lengths", [(math.nan, 2, 3, 4), (1, 2, 3, math.nan), (1, math.inf, 3, 4)])
def test_a_length_that_is_not_finite_cannot_be_assembled(lengths):
    assert classify(*lengths).inversion is Inversion.IMPOSSIBLE


@pytest.mark.parametrize(("lengths", "inversion", "slack"), TEXTBOOK)
@pytest.mark.parametrize("scale", [1.0, 1e-3, 1e-6])
def test_textbook_classes(lengths, inversion, slack, scale):
    result = grashof(*(scale * length for length in lengths))
    assert result.inversion is inversion
    assert result.slack == pytest.approx(scale * slack, abs=1e-9 * scale)
    assert result.inversion.crank_turns == (inversion in (Inversion.CRANK_ROCKER, Inversion.DOUBLE_CRANK))


def test_every_class_has_its_own_name_and_is_met_above():
    assert {inversion for _, inversion, _ in TEXTBOOK} == set(Inversion)
    assert len({inversion.value for inversion in Inversion}) == len(Inversion)
    wording = {
        Inversion.CRANK_ROCKER: "crank-rocker",
        Inversion.DOUBLE_CRANK: "double-crank",
        Inversion.DOUBLE_ROCKER: "double-rocker",
        Inversion.ROCKER_CRANK: "rocker-crank",
        Inversion.TRIPLE_ROCKER: "triple-rocker",
        Inversion.PARALLELOGRAM: "parallelogram",
        Inversion.KITE: "kite",
        Inversion.CHANGE_POINT: "change-point",
        Inversion.IMPOSSIBLE: "cannot be assembled",
    }
    assert all(inversion.value.startswith(words) for inversion, words in wording.items())


@seeded
@given(any_lengths)
@example((1.0, 3.0, 2.0, 2.5))
@example((2.5, 3.0, 2.0, 1.0))
@example((2.5, 1.0, 2.0, 3.0))
def test_crank_turns_iff_the_sweep_assembles_everywhere(lengths):
    assume(abs(slack_of(lengths)) > 1e-6)
    inversion = grashof(*lengths).inversion
    apart = closes(lengths, REVOLUTION)  # holds 0 and pi, where it is decided
    assume(np.min(np.abs(apart)) > 1e-9)
    assert inversion.crank_turns == bool(np.all(apart > 0.0))
    assert (inversion is Inversion.IMPOSSIBLE) == (reachable(*lengths) == [])
    if inversion is Inversion.IMPOSSIBLE:
        assert np.all(apart < 0.0)


@seeded
@given(any_lengths)
def test_grashof_conditions_agree_with_the_class(lengths):
    assume(abs(slack_of(lengths)) > 1e-6)
    ordered = sorted(lengths)
    assume(ordered[1] - ordered[0] > 1e-9)
    inversion = grashof(*lengths).inversion
    crank_rocker = all(slack >= 0.0 for slack in crank_rocker_conditions(*lengths).values())
    double_crank = all(slack >= 0.0 for slack in double_crank_conditions(*lengths).values())
    assert crank_rocker == (inversion is Inversion.CRANK_ROCKER)
    assert double_crank == (inversion is Inversion.DOUBLE_CRANK)


def test_conditions_are_labelled_by_what_they_compare():
    """Each label read as arithmetic gives its slack."""
    values = dict(zip(LENGTHS, (0.31, 0.52, 0.47, 0.23), strict=True))
    for conditions in (crank_rocker_conditions, double_crank_conditions):
        result = conditions(**values)
        assert len(result) == 6
        for label, slack in result.items():
            left, right = (sum(values[name] for name in part.split(" + ")) for part in label.split(" <= "))
            assert slack == pytest.approx(right - left, abs=1e-15), label


def test_random_linkages_meet_every_generic_class():
    rng = np.random.default_rng(5)
    met = Counter(grashof(*lengths).inversion for lengths in rng.uniform(0.05, 1.0, (400, 4)))
    generic = set(Inversion) - {Inversion.PARALLELOGRAM, Inversion.KITE, Inversion.CHANGE_POINT}
    assert set(met) == generic


# --- the range of the crank ------------------------------------------------------------------------------------------


def kind_of(ranges: list[tuple[float, float]]) -> str:
    if not ranges:
        return "none"
    if len(ranges) == 2:
        return "two mirrored ranges"
    (low, high), full = ranges[0], 2.0 * math.pi
    if high - low == pytest.approx(full, abs=1e-12):
        return "full rotation"
    return "around 0" if low + high == pytest.approx(0.0, abs=1e-12) else "around pi"


def check_reachable(lengths: tuple[float, ...], ranges: list[tuple[float, float]]) -> None:
    """Every crank angle of a dense sweep lies in a range exactly if the triangle closes there."""
    phi = np.linspace(-np.pi, np.pi, 1441)
    inside = np.zeros(phi.shape, dtype=bool)
    for low, high in ranges:
        assert low < high
        for turn in (-math.tau, 0.0, math.tau):
            inside |= (phi + turn >= low) & (phi + turn <= high)
    apart = closes(lengths, phi)
    clear = np.abs(apart) > 1e-9
    np.testing.assert_array_equal(inside[clear], (apart > 0.0)[clear])
    for bound in (bound for pair in ranges for bound in pair):
        if kind_of(ranges) != "full rotation":
            assert closes(lengths, bound) == pytest.approx(0.0, abs=1e-9)


KINDS = {
    "full rotation": (0.1, 0.41, 0.23, 0.5),
    "around 0": (0.3, 0.2, 0.2, 0.45),
    "around pi": (0.3, 0.7, 0.2, 0.45),
    "two mirrored ranges": (0.45, 0.15, 0.4, 0.5),
    "none": (0.1, 0.9, 0.1, 0.5),
}


@pytest.mark.parametrize(("kind", "lengths"), KINDS.items())
def test_every_kind_of_range(kind, lengths):
    ranges = reachable(*lengths)
    assert kind_of(ranges) == kind
    check_reachable(lengths, ranges)


@seeded
@given(any_lengths)
def test_range_of_the_crank_is_that_of_the_sweep(lengths):
    check_reachable(lengths, reachable(*lengths))


def test_random_linkages_meet_every_kind_of_range():
    rng = np.random.default_rng(6)
    met: Counter[str] = Counter()
    for lengths in rng.uniform(0.05, 1.0, (400, 4)):
        ranges = reachable(*map(float, lengths))
        check_reachable(tuple(lengths), ranges)
        met[kind_of(ranges)] += 1
    assert set(met) == set(KINDS)
    assert min(met.values()) >= 10


def test_range_check_detects_a_wrong_range():
    lengths = KINDS["two mirrored ranges"]
    ranges = reachable(*lengths)
    with pytest.raises(AssertionError):
        check_reachable(lengths, ranges[:1])
    with pytest.raises(AssertionError):
        check_reachable(lengths, [(low + 0.02, high) for low, high in ranges])
    with pytest.raises(AssertionError):
        check_reachable(lengths, [(-math.pi, math.pi)])


# --- motion ----------------------------------------------------------------------------------------------------------


def check_rates(motion: Motion, point: str) -> None:
    """Velocity and acceleration against five-point differences of positions."""
    h = 1e-3

    def at(offset: float) -> np.ndarray:
        return sweep(motion.mechanism, motion.sizes, motion.crank_angle + offset * h).position(point)

    near, far = at(1.0), at(2.0)
    back, beyond = at(-1.0), at(-2.0)
    first = (8.0 * (near - back) - (far - beyond)) / (12.0 * h) * motion.speed
    second = (16.0 * (near + back) - (far + beyond) - 30.0 * at(0.0)) / (12.0 * h**2) * motion.speed**2
    for computed, expected, tolerance in ((motion.velocity(point), first, 1e-7), (motion.acceleration(point), second, 1e-5)):
        scale = float(np.max(np.abs(expected)))
        np.testing.assert_allclose(computed, expected, rtol=tolerance, atol=tolerance * scale)


@fewer
@given(turning(), sides, st.sampled_from([1.0, -2.5, 7.0]))
def test_velocities_and_accelerations_are_the_differences_of_positions(lengths, side, speed):
    mechanism = replace(four_bar(side), points=POINTS)
    assume(np.min(closes(lengths, REVOLUTION)) > 0.05)  # differences over a finite step need a smooth motion
    motion = sweep(mechanism, sized(lengths), np.linspace(0.0, 2.0 * np.pi, 25), speed)
    for point in "BCPQ":
        check_rates(motion, point)
    for point in "AD":
        np.testing.assert_array_equal(motion.velocity(point), 0.0)
        np.testing.assert_array_equal(motion.acceleration(point), 0.0)


def test_rate_check_detects_a_wrong_speed():
    motion = sweep(four_bar(1), sized((0.1, 0.41, 0.23, 0.5)), REVOLUTION[::15], 2.0)
    check_rates(motion, "C")
    with pytest.raises(AssertionError):
        check_rates(replace(motion, speed=-2.0), "C")


@fewer
@given(turning(), sides, st.floats(-3.0, 3.0))
def test_body_angles_are_continuous_and_have_their_rates(lengths, side, start):
    mechanism, sizes = four_bar(side), sized(lengths)
    phi = start + np.linspace(0.0, 4.0 * np.pi, 1441)
    assume(np.min(closes(lengths, REVOLUTION)) > 0.05)
    motion = sweep(mechanism, sizes, phi, 1.5)
    turned = {}
    for body in ("crank", "coupler", "rocker"):
        angle = motion.body_angle(body)
        steps = np.diff(angle.value)
        # the largest rate bounds every step; a jump of the branch cut would be a whole turn
        assert np.max(np.abs(steps)) <= 1.01 * np.max(np.abs(angle.rate)) / motion.speed * (phi[1] - phi[0])
        link = mechanism.link(body)
        arm = motion.position(link.end) - motion.position(link.start)
        gap = angle.value - np.arctan2(arm[:, 1], arm[:, 0])
        np.testing.assert_allclose(np.remainder(gap + 1.0, math.tau), 1.0, atol=1e-9)
        h = 1e-3
        ahead, behind = (np.unwrap(sweep(mechanism, sizes, phi + k * h).body_angle(body).value) for k in (1, -1))
        rate = (np.remainder(ahead - behind + np.pi, math.tau) - np.pi) / (2.0 * h) * motion.speed
        np.testing.assert_allclose(angle.rate, rate, rtol=1e-3, atol=1e-3 * np.max(np.abs(rate)))
        smooth = np.gradient(angle.rate, phi[1] - phi[0])[1:-1] * motion.speed
        scale = np.max(np.abs(smooth))
        np.testing.assert_allclose(angle.acceleration[1:-1], smooth, rtol=0.01, atol=0.01 * scale + 1e-9)
        turned[body] = round((angle.value[-1] - angle.value[0]) / math.tau, 6)
    full = 2.0 if grashof(*lengths).inversion is Inversion.DOUBLE_CRANK else 0.0
    assert turned["crank"] == 2.0
    assert turned["rocker"] == full


def test_body_angle_returns_after_a_gap_in_the_assembly():
    """NaN where the linkage cannot be assembled, and only there."""
    motion = sweep(four_bar(1), sized((0.3, 0.2, 0.2, 0.45)), np.linspace(-np.pi, 3.0 * np.pi, 721))
    missing = motion.margin("C") < 0.0
    assert missing[[0, 360, 720]].all()  # at -pi, pi, 3 pi
    assert not missing[[180, 540]].any()  # at 0 and 2 pi, between the gaps
    angle = motion.body_angle("rocker")
    np.testing.assert_array_equal(np.isnan(angle.rate), missing)
    np.testing.assert_array_equal(np.isnan(angle.value), missing)


@pytest.mark.parametrize("lengths", [(0.1, 0.3, 0.1, 0.3), (0.1, 0.3, 0.2, 0.4), (0.3, 0.1, 0.1, 0.3), (0.2, 0.2, 0.3, 0.3)])
def test_change_point_linkages_move_without_a_warning(lengths):
    """Where the margin is zero the velocity has no value, and warnings are errors here."""
    motion = sweep(four_bar(1), sized(lengths), np.linspace(0.0, 2.0 * np.pi, 8, endpoint=False))
    stuck = ~(motion.margin("C") > 1e-12)
    assert stuck.any()
    angle = motion.body_angle("rocker")
    assert np.isfinite(angle.rate[~stuck]).all()
    assert np.isfinite(motion.velocity("C")[~stuck]).all()


@fewer
@given(st.lists(any_lengths, min_size=2, max_size=5), sides)
def test_batch_is_the_loop(linkages, side):
    mechanism = replace(four_bar(side), points=POINTS)
    columns = {name: np.array([row[k] for row in linkages])[:, None] for k, name in enumerate(LENGTHS)}
    phi = np.linspace(0.01, 6.0, 17)
    batch = sweep(mechanism, columns, phi, 2.0)
    angle = batch.body_angle("coupler")
    for k, row in enumerate(linkages):
        one = sweep(mechanism, sized(row), phi, 2.0)
        for point in "ABCDPQ":
            for part in (Motion.position, Motion.velocity, Motion.acceleration):
                assert part(batch, point).shape == (len(linkages), 17, 2)
                np.testing.assert_allclose(part(batch, point)[k], part(one, point), rtol=1e-12, atol=1e-13)
        np.testing.assert_allclose(batch.margin("C")[k], one.margin("C"), rtol=1e-12, atol=1e-13)
        alone = one.body_angle("coupler")
        for part in ("value", "rate", "acceleration"):
            np.testing.assert_allclose(getattr(angle, part)[k], getattr(alone, part), rtol=1e-12, atol=1e-13)


def test_batch_check_detects_exchanged_designs():
    phi = np.linspace(0.01, 6.0, 17)
    batch = sweep(four_bar(1), {**sized((0.1, 0.4, 0.2, 0.5)), "coupler": np.array([[0.4], [0.42]])}, phi)
    one = sweep(four_bar(1), sized((0.1, 0.42, 0.2, 0.5)), phi)
    np.testing.assert_allclose(batch.position("C")[1], one.position("C"), rtol=1e-12)
    assert np.max(np.abs(batch.position("C")[0] - one.position("C"))) > 1e-3
