"""Servo reference: constant speed plus a Fourier-series correction."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from optlink.linkage.vector2d import Value


@dataclass(frozen=True)
class ReferenceSignal:
    """Reference angle = start + speed t + a Fourier series of the revolution; its derivative is the reference speed.

    `harmonics` (h,): complex [rad], by default none. The correction is the real part of their sum with exp(i k |speed| t).
    """

    start: float
    speed: float
    harmonics: NDArray[np.complex128] = field(default_factory=lambda: np.zeros(0, dtype=complex))

    def at(self, time: Value) -> tuple[Value, Value]:
        """Return the reference angle [rad] and speed [rad/s] at a time [s] (float, array or symbol)."""
        angle, speed = self.start + self.speed * time, self.speed + 0.0 * time
        for k, harmonic in enumerate(self.harmonics.tolist()):
            rate = k * abs(self.speed)
            c, s = np.cos(rate * time), np.sin(rate * time)
            angle = angle + harmonic.real * c - harmonic.imag * s
            speed = speed - rate * (harmonic.real * s + harmonic.imag * c)
        return angle, speed

    def correction(self, time: Value) -> Value:
        """Return the reference angle minus that of constant speed [rad]."""
        return self.at(time)[0] - (self.start + self.speed * time)
