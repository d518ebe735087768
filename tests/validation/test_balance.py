"""Balancing against published theory and separately computed numbers.

Berkof and Lowen (1969): a four-bar is force-balanced when the coefficients of the two independent time-dependent vectors in the
moment of its mass vanish, which two counterweights can do:

    R. S. Berkof, G. G. Lowen, A New Method for Completely Force Balancing Simple Linkages, J. Eng. Ind. 91(1), 1969, 21-26.

The case (in-line bars of 1 kg/m, 2, 6 and 3 inches on a frame of 5.5 inches, 1 rad/s) and its numbers were computed apart from
this package; they are noted with 6 to 9 digits, hence the tolerance of 1e-6 (relative), or of half the last digit.
"""

from __future__ import annotations

import numpy as np
import pytest

import optlink
from tests.bar_oracle import Body, Motion, bar, disc, rms

LENGTHS = A, B, C, D = 0.0508, 0.1524, 0.0762, 0.1397
BARS = [bar(length) for length in LENGTHS[:3]]
ANGLES = 2.0 * np.pi * np.arange(360) / 360
UNBALANCED, LARGEST = 0.01102811, 0.02513242
ALONE, ALONE_RATIO, ALONE_MR = 0.007391318, 0.670225, -0.0080645 + 0.00139695j
CRANK_MR, ROCKER_MR = -0.00516128, -0.00870966


@pytest.fixture(scope="module")
def both() -> optlink.Balance:
    return optlink.balance(optlink.load("balance-four-bar"))


@pytest.fixture(scope="module")
def alone() -> optlink.Balance:
    one = {"body": "crank", "thickness": "10 mm", "density": "7850 kg/m^3", "reach": "60 mm"}
    return optlink.balance(optlink.load("balance-four-bar", {"balance.counterweights": [one]}))


def closed_form(crank: Body, coupler: Body, rocker: Body) -> tuple[complex, complex]:
    """Berkof and Lowen (1969): first moments of crank and rocker that balance a coupler of mass m and first moment mr.

    The centre of mass moves as (mr1 + m2 a) e1 + mr2 e2 + mr3 e3; with b e2 = c e3 - a e1 + d the coefficients of e1 and e3
    vanish for mr1 = -a m2 (1 - mr2 / (m2 b)) and mr3 = -c mr2 / b.
    """
    share = coupler.mr / B
    return -A * (coupler.m - share), -C * share


def added(result: optlink.Balance) -> dict[str, complex]:
    return {one.body: complex(one.parameters.along, one.parameters.across) for one in result.added}


def test_the_given_machine(both):
    rows = {str(row.measure): row.before for row in both.rows}
    assert rows["rms shaking force"] == pytest.approx(UNBALANCED, rel=1e-6)
    analysis = optlink.analyze(optlink.load("balance-four-bar"), 3600)
    force = np.hypot(analysis["frame.shaking_fx_N"], analysis["frame.shaking_fy_N"])
    assert np.max(force) == pytest.approx(LARGEST, rel=1e-6)
    assert both.before == pytest.approx(rms(Motion(*LENGTHS, ANGLES, 1.0).force(*BARS)), rel=1e-13)


def test_one_counterweight_on_the_crank(alone):
    assert alone.valid
    assert alone.proven
    assert alone.objective == pytest.approx(ALONE, rel=1e-6)
    assert alone.objective / alone.before == pytest.approx(ALONE_RATIO, rel=1e-6)
    mr = added(alone)["crank"]
    assert mr.real == pytest.approx(ALONE_MR.real, rel=1e-6)
    assert mr.imag == pytest.approx(ALONE_MR.imag, abs=5e-9)  # half of its last digit
    total = mr + BARS[0].mr
    assert total == pytest.approx(-0.00677418 + 0.00139695j, abs=7e-9)


def test_one_counterweight_is_that_of_least_squares_in_complex_numbers(alone):
    """The force is (given) + (added m r) (w^2 e1): the best complex number is a projection."""
    motion = Motion(*LENGTHS, ANGLES, 1.0)
    given, unit = motion.force(*BARS), motion.e1
    best = -np.vdot(unit, given) / np.vdot(unit, unit)
    assert added(alone)["crank"] == pytest.approx(best, rel=1e-12)
    assert alone.objective == pytest.approx(rms(given + best * unit), rel=1e-12)


def test_complete_balance(both):
    assert both.valid
    assert both.proven
    assert both.exact
    assert both.objective < 1e-10 * both.before
    assert both.gap < 1e-7
    computed, expected = added(both), closed_form(*BARS)
    assert expected == pytest.approx((BARS[0].mr + CRANK_MR, BARS[2].mr + ROCKER_MR), rel=1e-9)
    for body, bare, moment, noted in zip(("crank", "rocker"), (BARS[0], BARS[2]), expected, (CRANK_MR, ROCKER_MR), strict=True):
        assert computed[body] + bare.mr == pytest.approx(moment, rel=1e-10, abs=1e-13)
        assert computed[body] == pytest.approx(noted, rel=1e-9, abs=1e-13)


def test_complete_balance_in_complex_numbers(both):
    """The discs that were found, in a separate four-bar: no shaking force; moment and torque as the table says."""
    discs = {one.body: disc(one.mass, complex(*one.place), 0.010, 7850.0) for one in both.added}
    bodies = [BARS[0] + discs["crank"], BARS[1], BARS[2] + discs["rocker"]]
    motion = Motion(*LENGTHS, ANGLES, 1.0)
    assert rms(motion.force(*bodies)) < 1e-10 * both.before
    rows = {str(row.measure): row.after for row in both.rows}
    assert rows["rms shaking moment"] == pytest.approx(rms(motion.moment(*bodies)), rel=1e-11)
    assert rows["rms torque"] == pytest.approx(rms(motion.torque(*bodies)), rel=1e-11)


def test_a_wrong_sign_is_detected(both):
    discs = {one.body: disc(one.mass, -complex(*one.place), 0.010, 7850.0) for one in both.added}
    bodies = [BARS[0] + discs["crank"], BARS[1], BARS[2] + discs["rocker"]]
    assert rms(Motion(*LENGTHS, ANGLES, 1.0).force(*bodies)) > both.before
