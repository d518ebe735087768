"""All four-bars through poses and points: counts, certificates, known linkages, cognates, and the compiled steps."""

import functools
import importlib.util

import numpy as np
import pytest

from optlink.errors import InputError
from optlink.synthesis import homotopy, poses_and_points
from optlink.synthesis.certificate import _with_80_digits, _with_doubles, certificate
from optlink.synthesis.homotopy import Problem, Roots, follow, track
from optlink.synthesis.pairs import Pair
from optlink.synthesis.poses_and_points import four_bars
from optlink.synthesis.start_problems import COUNTS, cognates, distinct, marks, packed, refined, stored, unpacked

NINE_POINTS = (
    "0.8961867 -0.09802917 1.2156535 -1.187491 1.5151435 -0.85449808 1.6754775 -0.48768058 1.713869 -0.30099232 1.7215236 "
    "0.03269953 1.6642029 0.33241088 1.4984171 0.74435576 1.3011834 0.92153806",
    "0 0 0.3 -0.1 0.7 0 0.82 0.2 0.9 0.4 0.9 0.7 0.6 0.7 0.1 0.5 0 0.3",
    "0.25 0 0.52 0.1 0.8 0.7 1.2 1 1.4 1.3 1.1 1.48 0.7 1.4 0.2 1 0.02 0.4",
)
"""Coordinates of problems 1 to 3 of Wampler, Morgan and Sommese: eight points near a circle, an oval, parts of two circles."""


def random_targets(kind, seed):
    rng = np.random.default_rng([seed, *kind])
    count = sum(kind)
    return rng.normal(size=count) + 1j * rng.normal(size=count), rng.uniform(-np.pi, np.pi, kind[0])


def known_targets(kind, seed):
    """Points and the first angles of a four-bar at random crank angles, and its pivots."""
    rng, count = np.random.default_rng([seed, *kind]), sum(kind)
    while True:
        a, b, x, y = rng.normal(size=4) + 1j * rng.normal(size=4)
        phi = np.sort(rng.uniform(0.0, 2.0 * np.pi, count))
        pin = a + (x - a) * np.exp(1j * (phi - phi[0]))
        far, coupler, rocker = b - pin, abs(y - x), abs(y - b)
        cosine = (abs(far) ** 2 + coupler**2 - rocker**2) / (2.0 * abs(far) * coupler)
        if np.max(np.abs(cosine)) < 0.98:
            side = np.sign(((y - x) * np.conj(b - x)).imag)
            turn = far / abs(far) * np.exp(1j * side * np.arccos(cosine)) * coupler / (y - x)
            return pin - turn * x, np.angle(turn)[: kind[0]], (a, b)


def gap(found, pivots):
    either = [np.max(np.abs(found.pivots - np.array(order)), axis=1) for order in (pivots, pivots[::-1])]
    return np.min(either)


def lengths(found, places):
    """The largest relative change of a crank length over the points."""
    rotation = np.exp(1j * (found.angles - found.angles[:, :1]))
    moved = places + rotation[:, None] * (found.joints - places[0])[..., None]
    bars = np.abs(moved - found.pivots[..., None])
    return np.max(np.ptp(bars, axis=2) / np.max(bars, axis=2))


@pytest.mark.parametrize("kind", [(4, 2), pytest.param((3, 4), marks=pytest.mark.slow)])
def test_the_full_number_of_four_bars_is_certified(kind):
    for seed in (0, 2):
        places, angles = random_targets(kind, seed)
        found = four_bars(places, angles)
        assert (found.found, found.missing) == (COUNTS[kind], 0)
        assert found.real > 0
        assert lengths(found, places) < 1e-9
        assert np.max(np.abs(np.exp(1j * (found.angles[:, : kind[0]] - angles)) - 1.0)) < 1e-12
        places, angles, pivots = known_targets(kind, seed)
        assert gap(four_bars(places, angles), pivots) < 1e-7


@pytest.mark.slow
@pytest.mark.parametrize(("points", "real"), list(zip(NINE_POINTS, (21, 45, 64), strict=True)))
def test_nine_points_of_wampler_morgan_and_sommese_have_their_real_triples(points, real):
    """The published numbers; the points as in FourBarLinkages.jl, those of problem 3 as in alphaCertified's example too."""
    places = np.fromstring(points, sep=" ").view(complex)
    found = four_bars(places)
    assert (found.found, found.real) == (1442, real)
    assert found.joints.shape == (3 * real, 2)
    assert lengths(found, places) < 1e-9
    if real == 21:
        order = np.random.default_rng(1).permutation(9)
        other = four_bars(places[order])
        assert (other.found, other.real) == (1442, real)
        near = np.abs(found.pivots[:, None, :, None] - other.pivots[None, :, None, :])  # either link may come first
        either = np.minimum(near[..., 0, 0] + near[..., 1, 1], near[..., 0, 1] + near[..., 1, 0])
        assert sorted(np.argmin(either, axis=1)) == list(range(3 * real))
        assert np.max(np.min(either, axis=1)) < 1e-7


@pytest.mark.slow
def test_nine_points_of_an_ellipse_have_120_real_triples_and_fewer_complex_ones(monkeypatch):
    """Problem 4 of the same authors: equal steps of x; the curve is special, and the shortfall is stated."""
    monkeypatch.setattr(poses_and_points, "ROUTES", 1)
    x = np.linspace(1.0, 0.0, 9)
    found = four_bars(x + 2j * np.sqrt(1.0 - x * x))
    assert found.real == 120
    assert found.missing > 50


def test_a_straight_line_between_given_pivots_has_15_real_four_bars(monkeypatch):
    """Five points of problem 7 of A. P. Morgan and C. W. Wampler, J. Mech. Design 112 (1990) 544-550: 33 of 36 are finite.

    Paths that end at infinite ones are not followed from another problem.
    """
    followed = []
    monkeypatch.setattr(poses_and_points, "track", lambda *given: followed.append(given) or track(*given))
    line = np.array([0.5 + 1.06j, -0.83 - 0.27j, -0.34 + 0.22j, -0.13 + 0.43j, 0.22 + 0.78j])
    found = four_bars(line, pivots=(0.0, 1.0))
    assert (found.found, found.real, found.missing, len(followed)) == (33, 15, 3, 1)
    assert lengths(found, line) < 1e-12
    assert np.max(np.abs(found.pivots - [0.0, 1.0])) < 1e-12


def test_five_points_between_given_pivots_have_36_four_bars():
    rng = np.random.default_rng(0)
    places, pivots = rng.normal(size=(2, 5)), rng.normal(size=(2, 2))
    found = four_bars(places[0] + 1j * places[1], pivots=pivots[0] + 1j * pivots[1])
    assert (found.found, found.missing) == (36, 0)


def test_stored_problems_have_as_many_different_four_bars():
    for kind, count in COUNTS.items():
        problem, roots = stored(*kind)
        assert problem.kind == kind
        assert len(distinct(marks(roots.dyads, problem))) == count


def test_packed_numbers_keep_their_value_to_the_stored_digits():
    values = np.random.default_rng(0).normal(size=(5, 2, 4, 2)).view(complex)[..., 0]
    assert np.max(np.abs(unpacked(packed(values)) / values - 1.0)) < 3e-5
    assert packed(values).nbytes == 5 * 8 * 6


def test_cognates_solve_the_same_problem_and_count_once():
    problem, roots = stored(1, 8)
    some = roots[:4]
    three = cognates(some, problem)
    by_dyads, by_turns = homotopy.steps(three.dyads, three.turns, problem.d, problem.e, 0)
    assert max(np.max(np.abs(by_dyads)), np.max(np.abs(by_turns))) < 1e-8
    swapped = Roots(three.dyads[:, ::-1], three.turns)
    both = Roots(np.concatenate([three.dyads, swapped.dyads]), np.concatenate([three.turns, swapped.turns]))
    assert distinct(marks(both.dyads, problem)) == [0, 1, 2, 3]


def test_pairs_have_twice_the_digits_of_floats():
    from fractions import Fraction

    rng = np.random.default_rng(1)
    parts = rng.normal(size=(2, 2, 9, 2)).view(complex)[..., 0] * np.array([1.0, 1e-17])[:, None]

    def exact(pair):
        numbers = [
            (Fraction(float(h)) + Fraction(float(low)))
            for h, low in zip(np.array(pair.high).view(float), np.array(pair.low).view(float), strict=True)
        ]
        return numbers[::2], numbers[1::2]

    one, other = (Pair(*each) for each in parts)
    (a, b), (c, d), (p, q), (s, t) = map(exact, (one, other, one * other, one + other))
    for k in range(9):
        assert abs(p[k] - (a[k] * c[k] - b[k] * d[k])) < 2.0**-98
        assert abs(q[k] - (a[k] * d[k] + b[k] * c[k])) < 2.0**-98
        assert max(abs(s[k] - a[k] - c[k]), abs(t[k] - b[k] - d[k])) < 2.0**-100


@functools.cache
def four_poses_and_two_points():
    places, angles = random_targets((4, 2), 0)
    d = places[1:] - places[0]
    problem = Problem(d, np.conj(d), np.exp(1j * (angles[1:] - angles[0])) - 1.0)
    start, roots = stored(4, 2)
    ends, at = track(roots, start, problem)
    assert np.all(at == 1.0)
    return problem, ends


def proofs(shift):
    problem, ends = four_poses_and_two_points()
    return certificate(problem, Roots(ends.dyads * (1.0 + shift), ends.turns))


def test_a_certificate_refines_and_refuses():
    proof = proofs(0.0)
    assert np.all(proof.proven)
    assert np.max(proof.existence) < 1e-20
    near = proofs(1e-9)
    assert np.all(near.proven)
    assert np.max(np.abs(near.roots.dyads - proof.roots.dyads)) < 1e-12
    assert not np.all(proofs(1e-1).proven)
    assert np.array_equal(proof.real, near.real)
    assert 0 < proof.real.sum() < 30


@pytest.mark.parametrize(("length", "enough"), [(1e5, True), (1e6, False)])
def test_a_nearly_infinite_link_is_certified_and_real(length, enough):
    """The end of such a rocker moves along a parabola that differs little from a line; doubles may not be `enough`."""
    x, y, a, along = 1.0 + 0.3j, -0.4 + 0.8j, 0.2 - 0.5j, np.exp(0.4j)
    pins, turns = a + (x - a) * np.exp(1j * np.linspace(0.0, 1.0, 9)), np.zeros(9, complex)
    for k in range(1, 9):
        angle = np.angle(1.0 + turns[k - 1])
        for _ in range(20):
            far = pins[k] + (y - x) * np.exp(1j * angle) - y
            by_angle = ((1j * (y - x) * np.exp(1j * angle)) * np.conj(along + far / length)).real
            angle -= ((far * np.conj(along)).real + abs(far) ** 2 / (2.0 * length)) / by_angle
        turns[k] = np.exp(1j * angle) - 1.0
    d = (pins - (1.0 + turns) * x)[1:] - (pins[0] - x)
    dyads = np.array(
        [[[x, x.conjugate(), x - a, (x - a).conjugate()], [y, y.conjugate(), *(length * along ** np.array([1, -1]))]]]
    )
    problem, root = Problem(d, np.conj(d), np.zeros(0, complex)), Roots(dyads, turns[None, 1:])
    assert _with_doubles(problem, root).proven[0] == enough
    proof = certificate(problem, root)
    assert proof.proven[0]
    assert proof.real[0]
    assert np.max(np.abs(proof.roots.dyads / dyads - 1.0)) < 1e-2  # a change of the points by rounding changes it by so much


def test_eighty_digits_and_doubles_prove_the_same():
    for problem, roots in (four_poses_and_two_points(), stored(1, 4)):
        one = certificate(problem, roots[:3])
        for k in range(3):
            other = _with_80_digits(problem, Roots(roots.dyads[k : k + 1] * (1.0 + 1e-9), roots.turns[k : k + 1]))
            assert np.max(np.abs(other.roots.dyads / one.roots.dyads[k] - 1.0)) < 1e-13
            assert np.max(np.abs(other.marks / one.marks[k] - 1.0)) < 1e-12
            assert 0.1 < other.uniqueness[0] / one.uniqueness[k] < 10.0
            assert other.existence[0] < 1e-40


def test_paths_continue_with_twice_the_digits():
    problem, roots = stored(4, 2)
    end = Problem(*(np.conj(each) for each in (problem.d, problem.e, problem.turns)))
    whole, ends = track(roots[:3], problem, end)
    halfway = Problem(*(0.5 * (getattr(problem, name) + getattr(end, name)) for name in ("d", "e", "turns")))
    middle, _ = track(roots[:3], problem, halfway)
    again, at = follow(middle, problem, end, np.full(3, 0.5), True)
    assert np.array_equal([ends, at], np.ones((2, 3)))
    assert np.max(np.abs(again.dyads - whole.dyads) / (1.0 + np.abs(whole.dyads))) < 1e-7


@pytest.mark.slow
def test_nearly_singular_four_bars_of_two_poses_and_six_points_are_found():
    """The body turns by 1.6 deg between its poses, two of the points nearly coincide: doubles lose 31 paths of 1112."""
    places, angles, pivots = known_targets((2, 6), 13)
    found = four_bars(places, angles)
    assert found.missing == 0
    assert gap(found, pivots) < 1e-5  # ten thousand times more sensitive to the points than others


@pytest.mark.slow
def test_a_path_that_slopes_in_doubles_do_not_lead_on_is_followed_by_its_last_points():
    """Nine points of a four-bar: slopes alone end behind 400 steps at 0.82 of this path, a polynomial leads to the end in 254."""
    phi = np.array([0.08, 0.32, 0.94, 1.24, 1.46, 5.09, 5.21, 5.47, 5.61])
    pins = 1.78 * np.exp(1j * phi)
    far = 2.79 - pins
    turn = far / np.abs(far) * np.exp(1j * np.arccos((1.26**2 + np.abs(far) ** 2 - 2.21**2) / (2.52 * np.abs(far))))
    places = pins + (0.77 - 0.12j) * 1.26 * turn
    d = (places[1:] - places[0]) / np.sqrt(np.mean(np.abs(places[1:] - places[0]) ** 2))
    start, roots = stored(1, 8)
    problem = Problem(d, np.conj(d), np.zeros(0, complex))
    ends, at = track(roots[[1092]], start, problem)
    assert at[0] == 1.0
    assert certificate(problem, ends).proven[0]


def test_a_polynomial_predicts_a_polynomial():
    rng = np.random.default_rng(0)
    factors, places = rng.normal(size=(6, 3, 4)) + 1j, rng.normal(size=(6, 3))

    def values(s):
        return sum(factor * s[..., None] ** k for k, factor in enumerate(factors))

    s = rng.normal(size=3)
    assert np.max(np.abs(homotopy.extrapolated(places, values(places), s) - values(s))) < 1e-9


def test_a_double_root_has_no_certificate():
    """Near a dead centre of the problem two four-bars join; at it none is proven to be there."""
    dyads = np.zeros((1, 2, 4), complex)
    dyads[:, :] = [1.0 + 1j, 1.0 - 1j, 2.0, 2.0]  # equal dyads are not isolated
    problem = Problem(*[np.zeros(8, complex) + [0.1 * k for k in range(1, 9)]] * 2, np.zeros(0, complex))
    assert not np.any(certificate(problem, Roots(dyads, np.exp(1j * np.linspace(0.1, 0.8, 8))[None] - 1.0)).proven)


def test_singular_equations_give_no_step_and_prove_nothing():
    dyads, turns, nothing = np.ones((2, 2, 4), complex), np.zeros((2, 5), complex), np.zeros(5, complex)
    assert np.all(np.isnan(homotopy.steps(dyads, turns, nothing, nothing, 3)[0]))
    assert not np.any(certificate(Problem(nothing, nothing, nothing[:3]), Roots(dyads, turns)).proven)
    assert len(certificate(Problem(nothing, nothing, nothing[:3]), Roots(dyads[:0], turns[:0])).roots) == 0


def test_missing_four_bars_are_told(monkeypatch):
    monkeypatch.setattr(poses_and_points, "ROUTES", 1)
    whole = stored(4, 2)
    monkeypatch.setattr(poses_and_points, "stored", lambda *_: (whole[0], whole[1][:28]))
    assert four_bars(*random_targets((4, 2), 0)).missing == 2


@pytest.mark.slow
@pytest.mark.skipif(importlib.util.find_spec("numba") is None, reason="needs numba")
def test_compiled_steps_are_the_same():
    from optlink.synthesis import compiled_steps

    rng = np.random.default_rng(0)
    for poses, count in ((3, 5), (0, 8)):
        z, t, d, e = (
            rng.normal(size=(*shape, 2)).view(complex)[..., 0] for shape in ((9, 2, 4), (9, count), (9, count), (9, count))
        )
        rates = d[0], e[0], np.concatenate([t[0, :poses], np.zeros(count - poses)])
        for each in (None, rates):
            for one, other in zip(
                homotopy.steps(z, t, d, e, poses, each), compiled_steps.steps(z, t, d, e, poses, each), strict=True
            ):
                assert np.max(np.abs(one - other)) < 1e-11 * np.max(np.abs(one))


def test_refinement_ends_at_the_stored_four_bars():
    problem, roots = stored(4, 2)
    again = refined(problem, roots.dyads * (1.0 + 1e-5))
    assert np.max(np.abs(again.dyads - roots.dyads)) < 1e-10


def test_numbers_of_targets_without_finitely_many_four_bars_are_refused():
    with pytest.raises(InputError, match=r"1 poses and 7 points .* or 9 and 1"):
        four_bars(np.exp(1j * np.arange(8)))
    with pytest.raises(InputError, match="or 5 points and both pivots"):
        four_bars(np.exp(1j * np.arange(5)))
