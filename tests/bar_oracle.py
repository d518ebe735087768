"""A four-bar of a textbook in complex numbers: shaking force and moment, driving torque. Nothing of the package is used.

Crank pivot in the origin, rocker pivot at d on the real axis, crank at a constant speed; of a body its mass m, first moment
mr = m (x + i y) in axes along its link, and moment of inertia j about the start of the link. Closed-form loops and derivatives.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Body:
    """Mass [kg], first moment [kg m] (complex: along + i across), moment of inertia about the start [kg m^2]."""

    m: float
    mr: complex
    j: float

    def __add__(self, other: Body) -> Body:
        return Body(self.m + other.m, self.mr + other.mr, self.j + other.j)


def bar(length: float, density: float = 1.0) -> Body:
    """A uniform bar of so many kg/m."""
    m = density * length
    return Body(m, 0.5 * m * length, m * length**2 / 3.0)


def disc(mass: float, place: complex, thickness: float, density: float) -> Body:
    """A disc at a place of the body."""
    radius = np.sqrt(mass / (np.pi * density * thickness))
    return Body(mass, mass * place, mass * abs(place) ** 2 + 0.5 * mass * radius**2)


class Motion:
    """Angles, their rates and accelerations, at crank angles phi [rad] and crank speed w [rad/s]; open mode."""

    def __init__(self, a: float, b: float, c: float, d: float, phi: np.ndarray, w: float) -> None:
        self.a, self.b, self.c, self.d, self.w = a, b, c, d, w
        self.e1 = np.exp(1j * phi)
        tie = d - a * self.e1
        size = np.abs(tie)
        # cosine rule at B, the joint to the left of B -> D
        self.e2 = tie / size * np.exp(1j * np.arccos((b * b + size**2 - c * c) / (2.0 * b * size)))
        self.e3 = (a * self.e1 + b * self.e2 - d) / c
        # derivative of a e1 + b e2 = d + c e3, resolved across each unknown link
        cross = lambda p, q: (np.conj(p) * q).imag  # noqa: E731
        dot = lambda p, q: (np.conj(p) * q).real  # noqa: E731
        sine = cross(self.e2, self.e3)
        self.w2 = -a * w * cross(self.e1, self.e3) / (b * sine)
        self.w3 = -a * w * cross(self.e1, self.e2) / (c * sine)
        known = -a * w**2 * self.e1 - b * self.w2**2 * self.e2 + c * self.w3**2 * self.e3
        # known + i (b alpha2 e2 - c alpha3 e3) = 0: against e3 and e2
        self.alpha2 = -dot(self.e3, known) / (b * dot(self.e3, 1j * self.e2))
        self.alpha3 = dot(self.e2, known) / (c * dot(self.e2, 1j * self.e3))

    def _bodies(self, crank: Body, coupler: Body, rocker: Body):
        """Body, place of its start with rate and acceleration, axis, angular velocity and acceleration."""
        joint = self.a * self.e1
        yield crank, (0.0 * joint, 0.0 * joint, 0.0 * joint), self.e1, self.w, 0.0
        yield coupler, (joint, 1j * self.w * joint, -(self.w**2) * joint), self.e2, self.w2, self.alpha2
        yield rocker, (self.d + 0.0 * joint, 0.0 * joint, 0.0 * joint), self.e3, self.w3, self.alpha3

    def force(self, *bodies: Body) -> np.ndarray:
        """Shaking force, complex [N]: minus the rate of momentum."""
        total = 0.0
        for body, (_, _, s2), e, w, alpha in self._bodies(*bodies):
            total = total + body.m * s2 + body.mr * e * (1j * alpha - w**2)
        return -total

    def moment(self, *bodies: Body) -> np.ndarray:
        """Shaking moment about the crank pivot [N m]: minus the rate of the angular momentum."""
        total = 0.0
        for body, (s, _, s2), e, w, alpha in self._bodies(*bodies):
            turned = body.mr * e
            total = (
                total + (np.conj(s) * (body.m * s2 + turned * (1j * alpha - w**2)) + np.conj(turned) * s2).imag + body.j * alpha
            )
        return -total

    def torque(self, *bodies: Body) -> np.ndarray:
        """Driving torque [N m] without gravity and loads: the power that goes into kinetic energy, over the crank speed."""
        power = 0.0
        for body, (_, s1, s2), e, w, alpha in self._bodies(*bodies):
            turned = body.mr * e
            rate = body.m * s2 + turned * (1j * alpha - w**2)
            power = power + (np.conj(s1) * rate).real + w * ((np.conj(turned) * s2).imag + body.j * alpha)
        return power / self.w


def rms(values: np.ndarray) -> float:
    """Root mean square of amounts."""
    return float(np.sqrt(np.mean(np.abs(values) ** 2)))
