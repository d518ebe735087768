"""Contact laws: restitution recovered, energy never created, stiffness of the published joint; numpy, casadi and complex step."""

from __future__ import annotations

import math
from functools import partial

import casadi
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from optlink.clearance import joint as contact_laws
from optlink.symbolic import symbols_in_numpy

STIFF, MASS = 6.6102e10, 0.14
SPEEDS = (1e-2, 0.3, 4.0)
DAMPING = {
    "hertz": lambda e: 0.0,
    "hunt-crossley": lambda e: 1.5 * (1.0 - e),
    "lankarani-nikravesh": lambda e: 0.75 * (1.0 - e * e),
    "flores": lambda e: 1.6 * (1.0 - e) / e,
}


def impact(law, speed, restitution, mass=MASS, stiff=STIFF):
    """A mass runs into the contact; returns the speed at which it leaves, and largest penetration."""

    def motion(_, state):
        delta, rate = state
        return [rate, -float(law(delta, rate, speed, stiff, restitution)) / mass]

    def out(_, state):
        return state[0]

    out.terminal, out.direction = True, -1.0
    duration = 20.0 * (mass / stiff) ** 0.4 * speed**-0.2  # some times the period of the elastic impact
    result = solve_ivp(motion, (0.0, 100.0 * duration), [0.0, speed], events=out, method="DOP853", rtol=1e-11, atol=1e-16)
    assert result.status == 1
    return -result.y_events[0][0][1], float(np.max(result.y[0]))


def closed_form(share):
    """Restitution of F = K d^n (1 + c d'/v0): c (1 + e) = log((1 + c) / (1 - c e)), whatever n, K and the mass."""
    if share == 0.0:
        return 1.0
    return brentq(
        lambda e: share * (1.0 + e) - math.log((1.0 + share) / (1.0 - share * e)), 1e-12, min(1.0, (1.0 - 1e-12) / share)
    )


@pytest.mark.parametrize("name", contact_laws.DAMPING)
@pytest.mark.parametrize("restitution", [0.1, 0.5, 0.9, 0.99])
@pytest.mark.parametrize("speed", SPEEDS)
def test_impact_leaves_with_the_speed_of_the_closed_form(name, restitution, speed):
    left, _ = impact(partial(contact_laws.normal_force, name), speed, restitution)
    assert left / speed == pytest.approx(closed_form(DAMPING[name](restitution)), rel=1e-6)


@pytest.mark.parametrize(
    ("name", "lowest", "off"), [("hunt-crossley", 0.9, 0.01), ("lankarani-nikravesh", 0.9, 0.015), ("flores", 0.05, 0.05)]
)
def test_restitution_is_recovered_in_the_valid_range_of_the_law(name, lowest, off):
    for restitution in np.linspace(lowest, 1.0, 12)[:-1]:
        left, _ = impact(partial(contact_laws.normal_force, name), 1.0, float(restitution))
        assert left == pytest.approx(restitution, abs=off)


@pytest.mark.parametrize("name", contact_laws.DAMPING)
def test_no_impact_creates_energy_and_no_force_pulls(name):
    law = partial(contact_laws.normal_force, name)
    for restitution in (0.05, 0.4, 0.8, 1.0):
        for speed in SPEEDS:
            left, depth = impact(law, speed, restitution)
            assert 0.0 < left <= speed * (1.0 + 1e-9)
            rates = np.linspace(-3.0 * speed, 3.0 * speed, 61)
            assert np.all(law(depth, rates, speed, STIFF, restitution) >= 0.0)
            assert np.all(law(-1e-9, rates, speed, STIFF, restitution) == 0.0)


def test_restitution_check_detects_a_wrong_damping(monkeypatch):
    monkeypatch.setitem(contact_laws.DAMPING, "flores", contact_laws.DAMPING["lankarani-nikravesh"])
    left, _ = impact(partial(contact_laws.normal_force, "flores"), 1.0, 0.5)
    assert abs(left - 0.5) > 0.05


def test_elastic_impact_has_the_penetration_of_its_energy():
    """m v^2 / 2 = K d^2.5 / 2.5."""
    for speed in SPEEDS:
        _, depth = impact(partial(contact_laws.normal_force, "hertz"), speed, 1.0)
        assert depth == pytest.approx(
            (1.25 * MASS * speed**2 / STIFF) ** 0.4, rel=1e-3
        )  # the steps do not meet the largest exactly


def test_stiffness_of_the_published_joint():
    """Bearing 10 mm, journal 9.5 mm, steel on steel (207 GPa, 0.3): 6.6102e10 N/m^1.5 as printed."""
    steel = contact_laws.compliance(207e9, 0.3)
    assert contact_laws.stiffness(10e-3, 9.5e-3, steel, steel) == pytest.approx(6.6102e10, rel=1e-5)


def test_friction_opposes_the_slip_and_reaches_coulomb():
    slip = np.linspace(-1.0, 1.0, 101)
    force = contact_laws.friction(200.0, slip, 0.1, 0.01, 3.0)
    assert np.all(force * slip <= 0.0)
    np.testing.assert_allclose(force[[0, -1]], [20.0 + 3.0, -20.0 - 3.0], rtol=1e-12)
    assert contact_laws.friction(0.0, 0.5, 0.1, 0.01, 3.0) == 0.0


@pytest.mark.parametrize("name", contact_laws.DAMPING)
def test_casadi_evaluates_the_same_law(name):
    law, point = partial(contact_laws.normal_force, name), (2e-6, 0.05, 0.3, STIFF, 0.8)
    symbols = [casadi.SX.sym(f"x{k}") for k in range(5)]
    with symbols_in_numpy():
        force = law(*symbols)
    function = casadi.Function("law", symbols, [force, casadi.jacobian(force, casadi.vertcat(*symbols[:2]))])
    value, slope = function(*point)
    assert float(value) == pytest.approx(float(law(*point)), rel=1e-14)
    for k, step in ((0, 1e-11), (1, 1e-5)):
        high, low = list(point), list(point)
        high[k], low[k] = point[k] + step, point[k] - step
        assert float(slope[k]) == pytest.approx((law(*high) - law(*low)) / (2.0 * step), rel=1e-6, abs=1e-6 * STIFF * 1e-9)
    outside = function(-1e-9, *point[1:])[0]
    assert float(outside) == 0.0
