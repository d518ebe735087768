"""Contact forces between journal and bearing, as elementwise functions by name.

A normal law gives the force from the penetration delta, its rate, and the approach speed v0 at the start of the contact. It
dissipates energy because the force is larger during approach than during separation. No law pulls: negative forces become zero.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from optlink.linkage.vector2d import Value

EXPONENT = 1.5
"""Of the penetration, after Hertz, for smooth metal."""

SLOWEST = 1e-3
"""Least approach speed [m/s] at the start of a contact: the laws are singular for a grazing contact."""

Normal = Callable[[Value, Value, Value, Value, Value], Value]
"""(penetration [m], its rate [m/s], approach speed [m/s], stiffness [N/m^1.5], restitution [-]) -> force [N]"""


def compliance(modulus: Value, poisson: Value) -> Value:
    """Return the contribution of one material to the compliance of a contact, (1 - nu^2) / E [1/Pa].

    Parameters
    ----------
    modulus : Value [Pa]
        Young's modulus E.
    poisson : Value [-]
        Poisson's ratio nu.
    """
    return (1.0 - poisson * poisson) / modulus


def stiffness(bearing: Value, journal: Value, first: Value, second: Value) -> Value:
    """Return the stiffness of a journal in a bearing [N/m^1.5].

    Parameters
    ----------
    bearing, journal : Value [m]
        Radii, the bearing's the larger.
    first, second : Value [1/Pa]
        `compliance` of the two materials.

    References
    ----------
    Hertz contact of spheres with the curvature of the bearing negative, as used for revolute joints by H. M. Lankarani
    and P. E. Nikravesh (1990).
    """
    return 4.0 / (3.0 * (first + second)) * np.sqrt(bearing * journal / (bearing - journal))


def _normal(delta: Value, rate: Value, speed: Value, stiff: Value, share: Value) -> Value:
    """K delta^1.5 (1 + share rate / v0), zero without penetration and never negative."""
    depth = 0.5 * (delta + np.abs(delta))
    factor = 1.0 + share * (rate / speed)
    return stiff * np.power(depth, EXPONENT) * (0.5 * (factor + np.abs(factor)))


def hertz(delta: Value, rate: Value, speed: Value, stiff: Value, restitution: Value) -> Value:
    """Return the normal force [N] of elastic contact, without dissipation for any coefficient of restitution.

    Parameters
    ----------
    delta : Value [m]
        Penetration.
    rate : Value [m/s]
        Rate of the penetration.
    speed : Value [m/s]
        Approach speed at the start of the contact.
    stiff : Value [N/m^1.5]
        Stiffness.
    restitution : Value [-]
        Coefficient of restitution; has no effect on this law.

    References
    ----------
    H. Hertz, 1881.
    """
    return _normal(delta, rate, speed, stiff, 0.0)


def hunt_crossley(delta: Value, rate: Value, speed: Value, stiff: Value, restitution: Value) -> Value:
    """Return the normal force [N] with the damping factor 3 (1 - e) / 2, for restitutions e near one.

    Parameters
    ----------
    delta : Value [m]
        Penetration.
    rate : Value [m/s]
        Rate of the penetration.
    speed : Value [m/s]
        Approach speed at the start of the contact.
    stiff : Value [N/m^1.5]
        Stiffness.
    restitution : Value [-]
        Coefficient of restitution e.

    References
    ----------
    K. H. Hunt, F. R. E. Crossley, 1975.
    """
    return _normal(delta, rate, speed, stiff, 1.5 * (1.0 - restitution))


def lankarani_nikravesh(delta: Value, rate: Value, speed: Value, stiff: Value, restitution: Value) -> Value:
    """Return the normal force [N] with the damping factor 3 (1 - e^2) / 4, for restitutions e near one.

    Parameters
    ----------
    delta : Value [m]
        Penetration.
    rate : Value [m/s]
        Rate of the penetration.
    speed : Value [m/s]
        Approach speed at the start of the contact.
    stiff : Value [N/m^1.5]
        Stiffness.
    restitution : Value [-]
        Coefficient of restitution e.

    References
    ----------
    H. M. Lankarani, P. E. Nikravesh, 1990.
    """
    return _normal(delta, rate, speed, stiff, 0.75 * (1.0 - restitution * restitution))


def flores(delta: Value, rate: Value, speed: Value, stiff: Value, restitution: Value) -> Value:
    """Return the normal force [N] with the damping factor 8 (1 - e) / (5 e), for all restitutions e.

    Parameters
    ----------
    delta : Value [m]
        Penetration.
    rate : Value [m/s]
        Rate of the penetration.
    speed : Value [m/s]
        Approach speed at the start of the contact.
    stiff : Value [N/m^1.5]
        Stiffness.
    restitution : Value [-]
        Coefficient of restitution e.

    References
    ----------
    P. Flores, M. Machado, M. T. Silva, J. M. Martins, 2011.
    """
    return _normal(delta, rate, speed, stiff, 1.6 * (1.0 - restitution) / restitution)


NORMAL: dict[str, Normal] = {
    "hertz": hertz,
    "hunt-crossley": hunt_crossley,
    "lankarani-nikravesh": lankarani_nikravesh,
    "flores": flores,
}


def friction(normal: Value, slip: Value, coefficient: Value, width: Value, damping: Value = 0.0) -> Value:
    """Return the tangential force [N] against the slip: smoothed Coulomb friction, plus viscous damping during contact.

    Parameters
    ----------
    normal : Value [N]
        Normal force, zero without contact.
    slip : Value [m/s]
        Tangential velocity of the surfaces.
    coefficient : Value [-]
        Coulomb friction coefficient.
    width : Value [m/s]
        Slip at which tanh(slip / width) reaches 76 % of the Coulomb force.
    damping : Value [N s/m]
        Tangential damping of the contact; acts while the normal force is positive.
    """
    touching = np.sign(normal)
    return -coefficient * normal * np.tanh(slip / width) - damping * slip * touching
