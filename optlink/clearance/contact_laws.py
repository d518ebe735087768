"""Contact forces between journal and bearing, as elementwise functions.

A normal law gives the force from the penetration delta, its rate, and the approach speed v0 at the start of the contact. It
dissipates energy because the force is larger during approach than during separation. No law pulls: negative forces become zero.
"""

from collections.abc import Callable

import numpy as np

from optlink.linkage.vector2d import Value

EXPONENT = 1.5
"""Of the penetration, after Hertz, for smooth metal."""

SLOWEST = 1e-3
"""Least approach speed [m/s] at the start of a contact: the laws are singular for a grazing contact."""

DAMPING: dict[str, Callable[[Value], Value]] = {
    "hertz": lambda e: 0.0,
    "hunt-crossley": lambda e: 1.5 * (1.0 - e),
    "lankarani-nikravesh": lambda e: 0.75 * (1.0 - e * e),
    "flores": lambda e: 1.6 * (1.0 - e) / e,
}
"""Damping factor over the coefficient of restitution e by the normal law: hertz has none, those of Hunt and Crossley and of
Lankarani and Nikravesh hold for e near one, that of Flores for all e."""


def compliance(modulus: Value, poisson: Value) -> Value:
    """Return the contribution of one material to the compliance of a contact, (1 - nu^2) / E [1/Pa], from E [Pa] and nu."""
    return (1.0 - poisson * poisson) / modulus


def stiffness(bearing: Value, journal: Value, first: Value, second: Value) -> Value:
    """Return the stiffness of a journal in a bearing [N/m^1.5], from radii [m] and `compliance` [1/Pa] of the two materials.

    References
    ----------
    Hertz contact of spheres with the curvature of the bearing negative, as used for revolute joints by H. M. Lankarani
    and P. E. Nikravesh (1990).
    """
    return 4.0 / (3.0 * (first + second)) * np.sqrt(bearing * journal / (bearing - journal))


def normal_force(law: str, delta: Value, rate: Value, speed: Value, stiff: Value, restitution: Value) -> Value:
    """Return the normal force [N], stiffness delta^1.5 (1 + damping rate / speed): zero without penetration and never negative.

    `law` is one of `DAMPING`; `delta` [m] is the penetration, `rate` [m/s] its rate, `speed` [m/s] the approach speed at the
    start of the contact, `stiff` [N/m^1.5] the stiffness.

    References
    ----------
    H. Hertz, 1881. K. H. Hunt, F. R. E. Crossley, 1975. H. M. Lankarani, P. E. Nikravesh, 1990. P. Flores, M. Machado,
    M. T. Silva, J. M. Martins, 2011.
    """
    depth = 0.5 * (delta + np.abs(delta))
    factor = 1.0 + DAMPING[law](restitution) * (rate / speed)
    return stiff * np.power(depth, EXPONENT) * (0.5 * (factor + np.abs(factor)))


def friction(normal: Value, slip: Value, coefficient: Value, width: Value, damping: Value = 0.0) -> Value:
    """Return the tangential force [N] against the slip [m/s]: smoothed Coulomb friction, plus viscous damping during contact.

    At a slip of `width` [m/s] tanh(slip / width) reaches 76 % of the Coulomb force; the damping [N s/m] acts while the normal
    force [N] is positive.
    """
    return -coefficient * normal * np.tanh(slip / width) - damping * slip * np.sign(normal)
