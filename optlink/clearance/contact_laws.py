"""Contact forces between journal and bearing, as pure elementwise functions by name.

A normal law gives the force from the penetration delta, its rate, and the approach speed v0 at which the contact began; energy is
lost because the force is larger while the bodies approach than while they part. No law pulls: a force below zero is zero.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from optlink.linkage.vector2d import Value

EXPONENT = 1.5
"""Of the penetration, after Hertz, for smooth metal."""

SLOWEST = 1e-3
"""Least approach speed [m/s] that a contact is taken to begin with: the laws are singular at a grazing contact."""

Normal = Callable[[Value, Value, Value, Value, Value], Value]
"""(penetration [m], its rate [m/s], approach speed [m/s], stiffness [N/m^1.5], restitution [-]) -> force [N]"""


def compliance(modulus: Value, poisson: Value) -> Value:
    """Share of one material in the compliance of a contact, (1 - nu^2) / E [1/Pa]."""
    return (1.0 - poisson * poisson) / modulus


def stiffness(bearing: Value, journal: Value, first: Value, second: Value) -> Value:
    """Stiffness of a journal in a bearing [N/m^1.5].

    Parameters
    ----------
    bearing, journal : Value [m]
        Radii, the bearing's the larger.
    first, second : Value [1/Pa]
        `compliance` of the two materials.

    Notes
    -----
    Source: Hertz's contact of spheres with the curvature of the bearing negative, as used for revolute joints by H. M. Lankarani
    and P. E. Nikravesh (1990).
    """
    return 4.0 / (3.0 * (first + second)) * np.sqrt(bearing * journal / (bearing - journal))


def _normal(delta: Value, rate: Value, speed: Value, stiff: Value, share: Value) -> Value:
    """K delta^1.5 (1 + share rate / v0), zero without penetration and never negative."""
    depth = 0.5 * (delta + np.abs(delta))
    factor = 1.0 + share * (rate / speed)
    return stiff * np.power(depth, EXPONENT) * (0.5 * (factor + np.abs(factor)))


def hertz(delta: Value, rate: Value, speed: Value, stiff: Value, restitution: Value) -> Value:
    """Elastic contact: no energy is lost, whatever the coefficient of restitution.

    Source: H. Hertz, 1881.
    """
    return _normal(delta, rate, speed, stiff, 0.0)


def hunt_crossley(delta: Value, rate: Value, speed: Value, stiff: Value, restitution: Value) -> Value:
    """Damping 3 (1 - e) / 2: for restitutions near one.

    Source: K. H. Hunt, F. R. E. Crossley, 1975.
    """
    return _normal(delta, rate, speed, stiff, 1.5 * (1.0 - restitution))


def lankarani_nikravesh(delta: Value, rate: Value, speed: Value, stiff: Value, restitution: Value) -> Value:
    """Damping 3 (1 - e^2) / 4: for restitutions near one.

    Source: H. M. Lankarani, P. E. Nikravesh, 1990.
    """
    return _normal(delta, rate, speed, stiff, 0.75 * (1.0 - restitution * restitution))


def flores(delta: Value, rate: Value, speed: Value, stiff: Value, restitution: Value) -> Value:
    """Damping 8 (1 - e) / (5 e): for all restitutions.

    Source: P. Flores, M. Machado, M. T. Silva, J. M. Martins, 2011.
    """
    return _normal(delta, rate, speed, stiff, 1.6 * (1.0 - restitution) / restitution)


NORMAL: dict[str, Normal] = {
    "hertz": hertz,
    "hunt-crossley": hunt_crossley,
    "lankarani-nikravesh": lankarani_nikravesh,
    "flores": flores,
}


def friction(normal: Value, slip: Value, coefficient: Value, width: Value, damping: Value = 0.0) -> Value:
    """Tangential force [N] against the slip: Coulomb's, made smooth, and viscous damping while there is contact.

    Parameters
    ----------
    normal : Value [N]
        Normal force, zero without contact.
    slip : Value [m/s]
        Tangential velocity of the surfaces.
    coefficient : Value [-]
    width : Value [m/s]
        Slip at which tanh(slip / width) has 76 % of Coulomb's force.
    damping : Value [N s/m]
        Of the contact; acts while the normal force does.
    """
    touching = np.sign(normal)
    return -coefficient * normal * np.tanh(slip / width) - damping * slip * touching
