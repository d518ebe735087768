"""Cognates against the Roberts diagram drawn in complex numbers, and against circles intersected a second time."""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, example, given, strategies as st

from optlink.errors import InputError
from optlink.linkage.fourbar import Inversion, four_bar, reachable
from optlink.linkage.jet import Jet
from optlink.linkage.mechanism import BodyPoint
from optlink.linkage.motion import sweep
from optlink.linkage.roberts import Cognate, Cognates, CouplerLinkage, cognates
from tests.tiers import examples

seeded = examples(80)

share = st.floats(0.05, 0.95)
REVOLUTION = np.linspace(-np.pi, np.pi, 181)
TURNED = {  # which of a crank-rocker's lengths are crank, coupler, rocker, frame of the inversion
    Inversion.CRANK_ROCKER: (0, 1, 2, 3),
    Inversion.DOUBLE_CRANK: (3, 1, 2, 0),
    Inversion.DOUBLE_ROCKER: (1, 0, 2, 3),
    Inversion.ROCKER_CRANK: (2, 1, 0, 3),
}
AT_A = {  # of the cognate at A and E, from the textbook: the lengths are those of the original in another order
    Inversion.CRANK_ROCKER: Inversion.DOUBLE_ROCKER,
    Inversion.DOUBLE_CRANK: Inversion.DOUBLE_CRANK,
    Inversion.DOUBLE_ROCKER: Inversion.CRANK_ROCKER,
    Inversion.ROCKER_CRANK: Inversion.CRANK_ROCKER,
    Inversion.TRIPLE_ROCKER: Inversion.TRIPLE_ROCKER,
}
AT_D = {
    Inversion.CRANK_ROCKER: Inversion.CRANK_ROCKER,
    Inversion.DOUBLE_CRANK: Inversion.DOUBLE_CRANK,
    Inversion.DOUBLE_ROCKER: Inversion.ROCKER_CRANK,
    Inversion.ROCKER_CRANK: Inversion.DOUBLE_ROCKER,
    Inversion.TRIPLE_ROCKER: Inversion.TRIPLE_ROCKER,
}


@st.composite
def linkages(draw: Callable, *kinds: Inversion) -> CouplerLinkage:
    """Any place, any mode, any coupler point off B and C, at least 5 % of the possible slack away from a change point."""
    kind = draw(st.sampled_from(kinds or tuple(AT_A)))
    least = draw(st.floats(0.1, 1.0))
    p, q = (least * (1.1 + 4.0 * draw(share)) for _ in range(2))
    low = least + abs(p - q)
    lengths = [least, p, q, low + draw(share) * (p + q - least - low)]
    if (
        kind is Inversion.TRIPLE_ROCKER
    ):  # the last one so long that Grashof's condition fails, and not so long that it cannot reach
        lengths[3] = p + q - least + draw(share) * 2.0 * least
        lengths = draw(st.permutations(lengths))
        assume(slack(lengths) < -0.01 * max(lengths))
    else:
        lengths = [lengths[i] for i in TURNED[kind]]
    z = cmath.rect(draw(st.floats(0.1, 3.0)), draw(st.floats(-np.pi, np.pi)))
    assume(abs(1.0 - z) > 0.1)
    x, y, direction = (draw(st.floats(-2.0, 2.0)) for _ in range(3))
    return CouplerLinkage(*lengths, z.real * lengths[1], z.imag * lengths[1], x, y, direction, draw(st.sampled_from([1, -1])))


def slack(lengths: tuple | list) -> float:
    ordered = sorted(lengths)
    return ordered[1] + ordered[2] - ordered[0] - ordered[3]


CASES: dict[str, CouplerLinkage] = {
    "crank-rocker": CouplerLinkage(0.1, 0.35, 0.3, 0.4, 0.2, 0.15, 0.02, -0.07, 0.3, 1),
    "crank-rocker, crossed": CouplerLinkage(0.1, 0.35, 0.3, 0.4, -0.1, 0.15, 0.0, 0.0, 2.0, -1),
    "double-crank": CouplerLinkage(0.4, 0.35, 0.3, 0.1, 0.2, -0.15, -1.0, 0.5, -2.5, 1),
    "double-rocker": CouplerLinkage(0.35, 0.1, 0.3, 0.4, 0.2, 0.15, 0.0, 0.1, 0.0, 1),
    "rocker-crank": CouplerLinkage(0.3, 0.35, 0.1, 0.4, 0.2, 0.15, 0.0, 0.1, 0.5, -1),
    "triple-rocker": CouplerLinkage(0.3, 0.35, 0.25, 0.6, 0.2, 0.15, 0.0, 0.1, 1.5, -1),
}

# --- geometry, written again in complex numbers --------------------------------------------------------------------


def ranges_inside(linkage: CouplerLinkage, inset: float = 0.02) -> list[np.ndarray]:
    """Crank angles in each range, a share of its width away from its ends unless the crank turns fully."""
    result = []
    for low, high in reachable(*linkage.lengths):
        keep = 0.0 if high - low > 6.28318 else inset * (high - low)
        result.append(np.linspace(low + keep, high - keep, 121))
    return result


def joints(linkage: CouplerLinkage, phi: np.ndarray, side: np.ndarray | int | None = None) -> tuple[np.ndarray, ...]:
    """A, B, C, D, P as complex numbers: C at its angle in the triangle B-C-D, seen from B."""
    forward, a = cmath.exp(1j * linkage.direction), complex(linkage.x, linkage.y)
    b, d = linkage.crank * forward * np.exp(1j * phi), linkage.frame * forward  # from A: no digits lost to where A lies
    gap = np.abs(d - b)
    cosine = (linkage.coupler**2 + gap**2 - linkage.rocker**2) / (2.0 * linkage.coupler * gap)
    coupler = (d - b) / gap * np.exp(1j * (linkage.side if side is None else side) * np.arccos(cosine))
    return a, a + b, a + b + linkage.coupler * coupler, a + d, a + b + complex(linkage.along, linkage.across) * coupler


def plane(v: tuple) -> np.ndarray:
    return np.asarray(v[0]) + 1j * np.asarray(v[1])


def extent(*linkage: CouplerLinkage) -> float:
    """A length that every coordinate, and so every rounding error, is measured by."""
    return max(max(abs(v) for v in (*one.lengths, one.along, one.across, one.x, one.y)) for one in linkage)


def sine_of(linkage: CouplerLinkage, phi: np.ndarray) -> np.ndarray:
    """Sine of the transmission angle: where it is small, the joint C is ill-conditioned by its reciprocal."""
    gap = linkage.crank**2 + linkage.frame**2 - 2.0 * linkage.crank * linkage.frame * np.cos(phi)
    cosine = (linkage.coupler**2 + linkage.rocker**2 - gap) / (2.0 * linkage.coupler * linkage.rocker)
    return np.sqrt(np.maximum(0.0, 1.0 - cosine * cosine))


def check_curve(
    cognate: Cognate, phi: np.ndarray, coupler_linkage: CouplerLinkage | None = None, side: np.ndarray | int | None = None
) -> int:
    """The cognate, solved by `joints` at its own crank angle, has its coupler point where the original has it.

    Only where its C is well conditioned (sine of the transmission angle above 0.01); returns at how many positions that was.
    """
    coupler_linkage = coupler_linkage or cognate.linkage
    angle = np.asarray(cognate.crank_angle(phi))
    good = sine_of(coupler_linkage, angle) > 0.01
    side = np.broadcast_to(coupler_linkage.side if side is None else side, phi.shape)
    expected, computed = joints(cognate.original, phi[good])[-1], joints(coupler_linkage, angle[good], side[good])[-1]
    np.testing.assert_allclose(np.abs(computed - expected), 0.0, atol=1e-12 * extent(coupler_linkage, cognate.original))
    return int(np.count_nonzero(good))


def check_lengths(linkage: CouplerLinkage, b: np.ndarray, c: np.ndarray, p: np.ndarray, tolerance: float) -> None:
    """Its links as long as it says, the coupler triangle not mirrored, from positions alone."""
    a, d = plane(linkage.pivots[0]), plane(linkage.pivots[1])
    for computed, expected in (
        (b - a, linkage.crank),
        (c - b, linkage.coupler),
        (c - d, linkage.rocker),
        (d - a, linkage.frame),
        (p - b, math.hypot(linkage.along, linkage.across)),
    ):
        np.testing.assert_allclose(np.abs(computed), expected, rtol=0.0, atol=tolerance)
    np.testing.assert_allclose((p - b) / (c - b) * linkage.coupler, complex(linkage.along, linkage.across), atol=10.0 * tolerance)


def roberts(linkage: CouplerLinkage, phi: np.ndarray) -> tuple[np.ndarray, ...]:
    """Roberts diagram at every position, from positions only: the joints M, X (at A and E), N, Y (at D and E) and the pivot E.

    Three parallelograms A-B-P-M, D-C-P-N, P-X-E-Y, and the triangles M-P-X and P-N-Y put on similar to B-C-P (P over B-C).
    """
    a, b, c, d, p = joints(linkage, phi)
    m, n = a + (p - b), d + (p - c)
    shape = (p - b) / (c - b)  # how the triangle stands over its base
    x = m + shape * (p - m)
    y = p + shape * (n - p)
    return m, x, n, y, x + y - p


# --- the construction ----------------------------------------------------------------------------------------------


def both(result: Cognates) -> tuple[Cognate, Cognate]:
    assert result.at_crank_pivot is not None
    assert result.at_rocker_pivot is not None
    return result.at_crank_pivot, result.at_rocker_pivot


def the_ones(linkage: CouplerLinkage, phi: np.ndarray) -> list[Cognate]:
    """Both four-bars, each driven from both ends, for the range of `phi`."""
    computed = both(cognates(linkage, float(phi[len(phi) // 2])))
    return [*computed, *(cognate.driven_from_rocker for cognate in computed)]


@seeded
@given(linkages())
def test_joints_are_those_of_the_roberts_diagram(linkage):
    shape = complex(linkage.along, linkage.across) / linkage.coupler
    a, d = (complex(*pivot) for pivot in linkage.pivots)
    for phi in ranges_inside(linkage):
        m, x, n, y, e = roberts(linkage, phi)
        p = joints(linkage, phi)[-1]
        known = the_ones(linkage, phi)
        atol = 2e-12 * extent(linkage, *(cognate.linkage for cognate in known))
        np.testing.assert_allclose(e, a + shape * (d - a), rtol=0.0, atol=atol)  # it stands still; A-D-E is similar to B-C-P
        for cognate in known:
            at_a = cognate.follows[2] != "crank" and cognate.follows[0] != "crank"
            expected = {True: (a, e[0], m, x), False: (d, e[0], n, y)}[at_a]
            if cognate.turns_as != "coupler":
                expected = expected[1], expected[0], expected[3], expected[2]
            pose = cognate.pose(phi)
            for computed, place in zip((*cognate.linkage.pivots, pose.b, pose.c, pose.p), (*expected, p), strict=True):
                np.testing.assert_allclose(np.abs(plane(computed) - place), 0.0, atol=atol)


@seeded
@given(linkages())
def test_links_keep_their_length_and_solve_the_loop_in_their_mode(linkage):
    for phi in ranges_inside(linkage):
        for cognate in the_ones(linkage, phi):
            coupler_linkage, pose = cognate.linkage, cognate.pose(phi)
            b, c, p = (plane(v) for v in (pose.b, pose.c, pose.p))
            check_lengths(coupler_linkage, b, c, p, 2e-12 * extent(coupler_linkage, linkage))
            clear = sine_of(coupler_linkage, np.asarray(cognate.crank_angle(phi))) > 0.01
            reach = complex(*coupler_linkage.pivots[1]) - b
            left = np.where((np.conj(reach) * (c - b)).imag > 0.0, 1, -1)
            np.testing.assert_array_equal(left[clear], cognate.side_at(phi)[clear])
            solved = coupler_linkage.pose(cognate.crank_angle(phi), cognate.side_at(phi))
            np.testing.assert_allclose(np.asarray(solved.margin)[clear], np.asarray(pose.margin)[clear], rtol=1e-8, atol=1e-9)
            crank = coupler_linkage.crank * np.exp(1j * (coupler_linkage.direction + np.asarray(cognate.crank_angle(phi))))
            np.testing.assert_allclose(
                np.abs(b - complex(coupler_linkage.x, coupler_linkage.y) - crank),
                0.0,
                atol=2e-12 * extent(coupler_linkage, linkage),
            )


# --- the same curve, at the same time ------------------------------------------------------------------------------


@seeded
@given(linkages())
@example(CASES["crank-rocker"])
@example(CASES["crank-rocker, crossed"])
@example(CASES["double-crank"])
def test_cognate_at_the_rocker_pivot_traces_the_curve_in_one_mode_at_the_same_crank_angle(linkage):
    for phi in ranges_inside(linkage):
        second = both(cognates(linkage, float(phi[60])))[1]
        assert (second.turns_as, second.offset, second.linkage.side) == ("crank", 0.0, -linkage.side)
        assert second.keeps_side
        np.testing.assert_array_equal(second.crank_angle(phi), phi)
        np.testing.assert_allclose(sine_of(second.linkage, phi), sine_of(linkage, phi), atol=1e-7)  # the same transmission
        assert check_curve(second, phi) > 100


@seeded
@given(linkages())
@example(CASES["double-crank"])
@example(CASES["double-rocker"])
@example(CASES["rocker-crank"])
def test_every_drive_traces_the_curve_in_its_stated_modes(linkage):
    for phi in ranges_inside(linkage):
        for cognate in the_ones(linkage, phi):
            check_curve(cognate, phi, side=cognate.side_at(phi))
            if cognate.keeps_side:
                check_curve(cognate, phi)
            check_curve(cognate, phi[60:61])  # `linkage.side` is the mode at the angle that was asked for


@seeded
@given(linkages(Inversion.DOUBLE_CRANK, Inversion.DOUBLE_ROCKER, Inversion.ROCKER_CRANK))
def test_cognate_at_the_crank_pivot_turns_fully_where_it_can_and_drives_throughout(linkage):
    for phi in ranges_inside(linkage):
        first = both(cognates(linkage, float(phi[60])))[0]
        assert first.crank_turns
        assert first.keeps_side
        assert first.turns_as == ("coupler" if linkage.inversion is Inversion.DOUBLE_ROCKER else "rocker")
        assert check_curve(first, phi) > 100


@seeded
@given(linkages())
def test_inversions_are_those_of_the_textbook(linkage):
    first, second = both(cognates(linkage))
    assert (first.inversion, second.inversion) == (AT_A[linkage.inversion], AT_D[linkage.inversion])
    assert second.crank_turns == linkage.crank_turns
    if not first.crank_turns:  # nor does its other end drive it throughout
        assert len(first.turning_back) == 2 if linkage.crank_turns else first.turning_back
        assert first.driven_from_rocker.turning_back
    ratio = abs(complex(linkage.along, linkage.across)) / linkage.coupler, second.linkage.frame / linkage.frame
    for cognate, scale in zip((first, second), ratio, strict=True):
        np.testing.assert_allclose(slack(cognate.linkage.lengths), scale * slack(linkage.lengths), rtol=1e-9)
        np.testing.assert_allclose(sorted(cognate.linkage.lengths), scale * np.sort(linkage.lengths), rtol=1e-12)


@seeded
@given(linkages())
def test_its_crank_stops_where_it_is_said_to_turn_back_and_nowhere_else(linkage):
    for phi in ranges_inside(linkage, 0.0):
        full = phi[-1] - phi[0] > 6.28318
        dense = np.linspace(phi[0], phi[-1], 6001)[slice(None) if full else slice(3, -3)]
        for cognate in the_ones(linkage, phi):
            backs = np.array(cognate.turning_back)
            gaps = np.diff(np.sort([*backs, *((backs[0] + 2.0 * np.pi,) if full and len(backs) else (dense[0], dense[-1]))]))
            assume(np.all(gaps > 0.01))
            modes = cognate.side_at(dense)
            changes = np.flatnonzero(modes[1:] != modes[:-1])
            between = [
                any(low <= back <= high for back in backs) for low, high in zip(dense[changes], dense[changes + 1], strict=True)
            ]
            assert all(between)
            assert len(changes) in ({len(backs), len(backs) - 1} if full else {len(backs)})  # one may lie where the sweep begins
            if len(backs):
                rate = cognate.crank_angle(Jet(backs, 1.0)).rate
                np.testing.assert_allclose(rate, 0.0, atol=1e-6 * np.max(np.abs(cognate.crank_angle(Jet(dense, 1.0)).rate)))
            assert cognate.keeps_side == (len(changes) == 0)


@pytest.mark.parametrize("name", CASES)
def test_timed_cognates_keep_angular_velocity_and_point_motion(name):
    """Speeds from the package's own sweep of a four-bar, which knows nothing of cognates."""
    linkage = CASES[name]
    sizes = dict(zip(("crank", "coupler", "rocker", "frame"), linkage.lengths, strict=True))
    for phi in ranges_inside(linkage, 0.1):
        motion = sweep(four_bar(linkage.side), sizes, phi)
        reference = linkage.pose(Jet(phi, 1.0)).p
        for cognate in the_ones(linkage, phi):
            coupler_linkage, angle = cognate.linkage, cognate.crank_angle(Jet(phi, 1.0))
            turned = motion.body_angle(cognate.turns_as)
            np.testing.assert_allclose(angle.rate, turned.rate, atol=1e-11)
            np.testing.assert_allclose(angle.acceleration, turned.acceleration, atol=1e-10)
            good = sine_of(coupler_linkage, angle.value) > 0.2
            solved = coupler_linkage.pose(angle, cognate.side_at(phi)).p
            for parallel, computed, expected in zip(cognate.pose(Jet(phi, 1.0)).p, solved, reference, strict=True):
                for part in ("value", "rate", "acceleration"):
                    np.testing.assert_allclose(getattr(parallel, part), getattr(expected, part), atol=1e-10)
                    np.testing.assert_allclose(getattr(computed, part)[good], getattr(expected, part)[good], atol=1e-9)


@pytest.mark.parametrize("name", ["crank-rocker", "crank-rocker, crossed", "double-crank"])
def test_a_cognate_is_an_ordinary_mechanism_of_the_package(name):
    linkage = CASES[name]
    coupler_linkage = both(cognates(linkage))[1].linkage
    bar = replace(
        four_bar(coupler_linkage.side), points=(BodyPoint("P", "coupler", coupler_linkage.along, coupler_linkage.across),)
    )
    motion = sweep(bar, dict(zip(("crank", "coupler", "rocker", "frame"), coupler_linkage.lengths, strict=True)), REVOLUTION)
    computed = motion.position("P") @ (1.0, 1j) * cmath.exp(1j * coupler_linkage.direction) + complex(
        coupler_linkage.x, coupler_linkage.y
    )
    np.testing.assert_allclose(computed, joints(linkage, REVOLUTION)[-1], atol=1e-14)


# --- the family ----------------------------------------------------------------------------------------------------


def signature(linkage: CouplerLinkage) -> np.ndarray:
    """Pivots, lengths and coupler point, the same whichever end is driven: begun at the pivot that is farther left."""
    a, d = (complex(*pivot) for pivot in linkage.pivots)
    z = complex(linkage.along, linkage.across) / linkage.coupler
    ends = [(a, linkage.crank, z, linkage.rocker, d), (d, linkage.rocker, 1.0 - z, linkage.crank, a)]
    return np.array([*min(ends, key=lambda end: end[0].real), linkage.coupler, linkage.frame])


def same(one: CouplerLinkage, other: CouplerLinkage) -> bool:
    return bool(np.all(np.abs(signature(one) - signature(other)) <= 1e-9 * extent(one, other)))


@seeded
@given(linkages())
def test_cognates_of_a_cognate_are_the_other_two_of_the_three(linkage):
    first, second = both(cognates(linkage))
    assume(abs(math.cos(linkage.direction)) > 1e-3 and min(abs(math.cos(c.linkage.direction)) for c in (first, second)) > 1e-3)
    family = [linkage, first.linkage, second.linkage]
    for member in family:
        computed = [member, *(cognate.linkage for cognate in both(cognates(member)))]
        assert sorted([same(one, other) for other in family].index(True) for one in computed) == [0, 1, 2]


@seeded
@given(linkages())
def test_the_timed_cognate_of_the_timed_cognate_is_the_original(linkage):
    second = both(cognates(linkage))[1]
    back = both(cognates(second.linkage))[1].linkage
    for name in ("crank", "coupler", "rocker", "frame", "along", "across", "x", "y"):
        assert abs(getattr(back, name) - getattr(linkage, name)) <= 1e-12 * extent(linkage, second.linkage), name
    assert abs(math.remainder(back.direction - linkage.direction, 2.0 * math.pi)) <= 1e-14
    assert back.side == linkage.side


@seeded
@given(linkages())
def test_driven_from_either_end_it_is_one_four_bar(linkage):
    for cognate in both(cognates(linkage)):
        other = cognate.driven_from_rocker
        assume(abs(math.cos(cognate.linkage.direction)) > 1e-3)
        assert same(cognate.linkage, other.linkage)
        assert other.follows == cognate.follows[::-1] or other.follows[1] == cognate.follows[1]
        assert other.driven_from_rocker == cognate


def test_chebyshevs_linkage_has_the_lambda_linkage_as_cognate():
    """Chebyshev's straight-line linkage 5-2-5-4 (crossed, middle of its coupler) and his lambda linkage 1-2.5-2.5-2.

    Proportions, and that they are cognates: Norton, Design of Machinery, chapter 3 (the second one there as Hoeken's linkage).
    """
    linkage = CouplerLinkage(5.0, 2.0, 5.0, 4.0, 1.0, 0.0, side=-1)
    first, second = both(cognates(linkage, math.atan2(4.0, 3.0)))
    assert linkage.inversion is Inversion.DOUBLE_ROCKER
    lambda_linkage = (1.0, 2.5, 2.5, 2.0, 5.0, 0.0, 0.0, 0.0, 0.0)
    coupler_linkage = first.linkage
    assert (
        *coupler_linkage.lengths,
        coupler_linkage.along,
        coupler_linkage.across,
        coupler_linkage.x,
        coupler_linkage.y,
        coupler_linkage.direction,
    ) == pytest.approx(lambda_linkage, abs=1e-14)
    assert first.inversion is Inversion.CRANK_ROCKER
    assert first.turns_as == "coupler"
    mirrored = second.driven_from_rocker.linkage
    assert mirrored.lengths == pytest.approx(lambda_linkage[:4])
    assert mirrored.pivots[0] == pytest.approx((4.0, 0.0))
    assert mirrored.pivots[1] == pytest.approx((2.0, 0.0))
    pose = coupler_linkage.pose(np.linspace(np.pi / 2.0, 1.5 * np.pi, 181))  # the straight part: half a turn of the crank
    x, y = pose.p
    assert np.ptp(x) == pytest.approx(4.0, abs=1e-9)
    assert np.ptp(y) < 0.02 * np.ptp(x)


# --- special places of the coupler point, and what cannot be ---------------------------------------------------------


@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("share_of_coupler", [-0.7, 0.3, 0.5, 2.5])
def test_coupler_point_on_the_line_of_its_joints(name, share_of_coupler):
    linkage = replace(CASES[name], along=share_of_coupler * CASES[name].coupler, across=0.0)
    for phi in ranges_inside(linkage):
        for cognate in the_ones(linkage, phi):
            assert cognate.linkage.across == pytest.approx(0.0, abs=1e-15)
            check_curve(cognate, phi, side=cognate.side_at(phi))
            line = plane(cognate.linkage.pivots[0]) - plane(linkage.pivots[0])
            assert (line * cmath.exp(-1j * linkage.direction)).imag == pytest.approx(0.0, abs=1e-14)


@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("off", [0.0, 1e-12])
def test_coupler_point_in_a_joint_leaves_one_cognate_out(name, off):
    at_b = replace(CASES[name], along=0.0, across=off)
    at_c = replace(at_b, along=at_b.coupler)
    none, second = cognates(at_b)
    first, neither = cognates(at_c)
    assert none is None
    assert neither is None
    for cognate in (first, second):
        assert isinstance(cognate, Cognate)
        for phi in ranges_inside(cognate.original)[-1:]:
            check_curve(cognate, phi, side=cognate.side_at(phi))
            pose = cognate.pose(phi)
            assert np.all(np.isfinite([*pose.b, *pose.c, *pose.p]))


@pytest.mark.parametrize("off", [1e-3, 1e-6])
def test_coupler_point_near_a_joint_gives_a_small_cognate(off):
    linkage = replace(CASES["double-crank"], along=off, across=0.0)
    first, second = both(cognates(linkage))
    assert first.linkage.frame == pytest.approx(linkage.frame * off / linkage.coupler)
    for cognate in (first, second):
        assert check_curve(cognate, REVOLUTION) > 100


@pytest.mark.parametrize("lengths", [(0.1, 0.3, 0.1, 0.3), (0.3, 0.1, 0.3, 0.1), (0.1, 0.1, 0.3, 0.3), (0.3, 0.1, 0.1, 0.3)])
@pytest.mark.parametrize("side", [1, -1])
def test_change_point_linkages_have_cognates_too(lengths, side):
    """Parallelograms and kites: away from the positions where their links lie on one line."""
    linkage = CouplerLinkage(*lengths, 0.05, 0.12, 0.1, 0.2, 0.3, side)
    span = reachable(*lengths)[-1]
    phi = np.linspace(0.1, min(span[1], np.pi) - 0.1, 41)
    for cognate in the_ones(linkage, phi):
        pose = cognate.pose(phi)
        b, c, p = (plane(v) for v in (pose.b, pose.c, pose.p))
        check_lengths(cognate.linkage, b, c, p, 1e-13)
        np.testing.assert_allclose(p, joints(linkage, phi)[-1], atol=1e-13)
    second = both(cognates(linkage, float(phi[20])))[1]
    assert check_curve(second, phi) > 20


def test_scalars_give_scalars():
    cognate = both(cognates(CASES["crank-rocker"]))[0]
    assert np.ndim(cognate.crank_angle(0.3)) == np.ndim(cognate.side_at(0.3)) == np.ndim(cognate.pose(0.3).p[0]) == 0


@seeded
@given(linkages(Inversion.DOUBLE_ROCKER, Inversion.ROCKER_CRANK, Inversion.TRIPLE_ROCKER))
def test_the_ends_of_a_range_belong_to_it(linkage):
    for low, high in reachable(*linkage.lengths):
        first, second = both(cognates(linkage, 0.999 * low + 0.001 * high))
        assert second.linkage.side == -linkage.side
        for at in (low, high, low + 2.0 * np.pi, high - 4.0 * np.pi):
            computed = both(cognates(linkage, at))
            assert computed[1] == second
            assert computed[0] == first or not first.keeps_side


@seeded
@given(linkages())
def test_left_alone_the_mode_is_read_where_the_transmission_is_best(linkage):
    low, high = reachable(*linkage.lengths)[-1]
    phi = np.linspace(low, high, 2001)[1:-1]
    for cognate in both(cognates(linkage)):
        sine, modes = sine_of(cognate.linkage, np.asarray(cognate.crank_angle(phi))), cognate.side_at(phi)
        best, other = (max(sine[modes == mode], default=0.0) for mode in (cognate.linkage.side, -cognate.linkage.side))
        assert best > other - 0.01


def test_outside_its_range_the_cognate_is_nowhere():
    linkage = CASES["triple-rocker"]
    for cognate in the_ones(linkage, ranges_inside(linkage)[0]):
        assert np.isnan(cognate.pose(np.pi).p[0])
        assert np.isnan(cognate.pose(np.pi).margin)


def test_two_ranges_are_two_curves():
    """A double-rocker driven at its rocker: the range that `at` names decides the mode of the cognate that turns fully."""
    linkage = CASES["double-rocker"]
    below, above = ranges_inside(linkage)
    sides = [both(cognates(linkage, float(phi[60])))[0].linkage.side for phi in (below, above)]
    assert sides[0] == -sides[1]
    assert cognates(linkage)[0].linkage.side == sides[1]


@pytest.mark.parametrize("lengths", [(1.0, 1.0, 1.0, 3.0), (3.0, 1.0, 1.0, 1.0)])
def test_a_four_bar_that_can_only_lie_flat_is_refused(lengths):
    with pytest.raises(InputError, match="cannot be assembled so that it moves"):
        cognates(CouplerLinkage(*lengths, 0.5, 0.5))


def test_unusable_input_is_refused():
    with pytest.raises(InputError, match="positive"):
        CouplerLinkage(0.0, 1.0, 1.0, 1.0, 0.0, 0.0)
    with pytest.raises(InputError, match="finite"):
        CouplerLinkage(1.0, 1.0, 1.0, 1.0, math.nan, 0.0)
    with pytest.raises(InputError, match="mode"):
        CouplerLinkage(1.0, 1.0, 1.0, 1.0, 0.0, 0.0, side=0)
    with pytest.raises(InputError, match="cannot be assembled"):
        cognates(CouplerLinkage(1.0, 1.0, 1.0, 3.5, 0.5, 0.5))
    with pytest.raises(InputError, match="cannot be assembled at this crank angle"):
        cognates(CASES["triple-rocker"], at=np.pi)


# --- the checks would notice -----------------------------------------------------------------------------------------

DEFECTS = {
    "the other mode": lambda own: {"side": -own.side},
    "a length": lambda own: {"rocker": own.rocker * (1.0 + 1e-9)},
    "the coupler point mirrored": lambda own: {"across": -own.across},
    "coupler and rocker exchanged": lambda own: {"coupler": own.rocker, "rocker": own.coupler},
    "the frame turned": lambda own: {"direction": own.direction + 1e-9},
    "the frame about": lambda own: {"direction": own.direction + math.pi},
    "the pivot": lambda own: {"x": own.x + 1e-9},
}


@pytest.mark.parametrize("name", ["crank-rocker", "crank-rocker, crossed", "double-crank"])
@pytest.mark.parametrize("defect", DEFECTS)
def test_a_planted_defect_is_noticed(name, defect):
    second = both(cognates(CASES[name]))[1]
    assert check_curve(second, REVOLUTION) > 100
    with pytest.raises(AssertionError, match="Not equal to tolerance"):
        check_curve(second, REVOLUTION, replace(second.linkage, **DEFECTS[defect](second.linkage)))


@pytest.mark.parametrize("name", CASES)
def test_a_wrong_phase_is_noticed(name):
    phi = ranges_inside(CASES[name])[-1]
    for cognate in the_ones(CASES[name], phi):
        with pytest.raises(AssertionError, match="Not equal to tolerance"):
            check_curve(replace(cognate, offset=cognate.offset + 1e-9), phi, side=cognate.side_at(phi))


def test_one_mode_is_not_enough_for_the_double_rocker_of_a_crank_rocker():
    first = both(cognates(CASES["crank-rocker"]))[0]
    assert len(first.turning_back) == 2
    check_curve(first, REVOLUTION, side=first.side_at(REVOLUTION))
    for side in (1, -1):
        with pytest.raises(AssertionError, match="Not equal to tolerance"):
            check_curve(first, REVOLUTION, side=side)
