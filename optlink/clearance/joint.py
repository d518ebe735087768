"""A revolute joint with clearance: motion of the journal in the bearing, and contact forces."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from optlink.dynamics.machine import Acting
from optlink.linkage.vector2d import Value, Vector, cross, dot, minus

# Contact forces between journal and bearing, as elementwise functions.
#
# A normal law gives the force from the penetration delta, its rate, and the approach speed v0 at the start of the contact. It
# dissipates energy because the force is larger during approach than during separation. No law pulls: negative forces become
# zero.

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


CENTRED = 1e-24
"""Square of an eccentricity [m^2] that keeps the direction of a centred journal finite."""

LEAST_DEPTH = 1e-14
"""Penetration [m] below which the force is that of this one: the power 1.5 has no second derivative at zero."""


@dataclass(frozen=True)
class Gap:
    """Clearance in the pin `point`, between the bodies that carry `journal` and `bearing`; either may be the frame.

    Parameters
    ----------
    clearance : float [m]
        Radius of the bearing minus that of the journal.
    radius : float [m]
        Of the journal.
    stiffness : float [N/m^1.5]
        Of the contact.
    restitution : float [-]
        Coefficient of restitution.
    law : str
        One of `contact_laws.DAMPING`.
    friction : float [-]
        Coulomb friction coefficient.
    slip_speed : float [m/s]
        Slip above which friction is fully developed (see `contact_laws.friction`).
    damping : float [N s/m]
        Tangential damping during contact.
    """

    point: str
    journal: str
    bearing: str
    clearance: float
    radius: float
    stiffness: float
    restitution: float = 0.9
    law: str = "lankarani-nikravesh"
    friction: float = 0.0
    slip_speed: float = field(default=0.01, kw_only=True)
    damping: float = field(default=0.0, kw_only=True)


class JournalMotion(NamedTuple):
    """Motion of a journal in its bearing: eccentricity and its rate (of the centres), angular velocities of both bodies."""

    eccentricity: Vector
    rate: Vector
    journal: Value
    bearing: Value

    @property
    def distance(self) -> Value:
        """Distance of the centres [m]."""
        return np.sqrt(dot(self.eccentricity, self.eccentricity) + CENTRED)

    @property
    def normal(self) -> Vector:
        """Unit vector from the centre of the bearing towards that of the journal."""
        away = self.distance
        return self.eccentricity[0] / away, self.eccentricity[1] / away

    @property
    def approach(self) -> Value:
        """Rate of the distance of the centres [m/s]."""
        return dot(self.normal, self.rate)

    def slip(self, radius: float) -> Value:
        """Return the tangential velocity of the journal's surface relative to the bearing's at the contact point [m/s]."""
        x, y = self.normal
        return cross((x, y), self.rate) + radius * self.journal - (radius + self.distance) * self.bearing


class Touch(NamedTuple):
    """A contact: penetration [m] (negative: distance), its rate, slip [m/s], normal force and friction [N] on the journal.

    `elastic` [J]: stored energy; `loss` and `rubbing` [W]: power dissipated in the normal and in the tangential direction.
    """

    penetration: Value
    rate: Value
    slip: Value
    normal: Value
    friction: Value
    force: Vector
    elastic: Value
    loss: Value
    rubbing: Value


def touch(gap: Gap, motion: JournalMotion, speed: Value, closed: Value = 1.0) -> Touch:
    """Compute the contact between journal and bearing, from the approach speed at its start [m/s].

    `closed`: 1 in contact, 0 apart; then there is no force, even where a trial motion penetrates the bearing.
    """
    delta, rate, slip = motion.distance - gap.clearance, motion.approach, motion.slip(gap.radius)
    depth = np.maximum(delta, LEAST_DEPTH)
    normal, spring = (
        closed * normal_force(law, depth, rate, speed, gap.stiffness, gap.restitution) for law in (gap.law, "hertz")
    )
    rub = closed * friction(normal, slip, gap.friction, gap.slip_speed, gap.damping)
    x, y = motion.normal
    force = -normal * x - rub * y, -normal * y + rub * x
    elastic = spring * depth / (EXPONENT + 1.0)
    return Touch(delta, rate, slip, normal, rub, force, elastic, (normal - spring) * rate, -rub * slip)


def acting(gap: Gap, motion: JournalMotion, journal: Vector, contact: Touch) -> tuple[Acting, Acting]:
    """Return the contact forces on both bodies, journal first, at one point so that their moments cancel.

    `journal` [m] is the centre of the journal.
    """
    x, y = motion.normal
    at = journal[0] + gap.radius * x, journal[1] + gap.radius * y
    back = minus((0.0, 0.0), contact.force)
    return Acting(gap.journal, at, contact.force, 0.0), Acting(gap.bearing, at, back, 0.0)
