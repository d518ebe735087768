"""Sides of a group over the crank angle, and its Taylor series about singular positions.

At a singular position the formulas of a dyad are 0/0. The joint itself moves smoothly: there its position is a power series in
the crank angle, whose derivatives are the velocities and accelerations.
"""

from dataclasses import dataclass

import numpy as np

from optlink.linkage.jet import Jet, as_jet
from optlink.linkage.vector2d import Array, Value, Vector


@dataclass(frozen=True)
class Passage:
    """Power series (2, terms) of two coordinates in crank angle - `crank_angle` [rad], accurate within `window` [rad]."""

    crank_angle: float
    window: float
    series: Array

    def place(self, angle: Value, delta: Value) -> Vector:
        """Evaluate the two coordinates; jets where the crank angle is a jet.

        Parameters
        ----------
        angle : Value [rad]
            Crank angle; of a jet only the derivatives are used.
        delta : float or array [rad]
            Crank angle minus `crank_angle`.
        """
        away = Jet(delta, angle.rate, angle.acceleration) if isinstance(angle, Jet) else delta
        x, y = (np.polynomial.polynomial.polyval(away, row) for row in self.series)
        return x, y


@dataclass(frozen=True)
class GroupPassages:
    """Sides and passages of a group over the crank angle.

    Parameters
    ----------
    origin, cycle : float [rad]
        Sides and passages apply to the crank angles from `origin` to `origin + cycle` and repeat with this period.
    breaks : array (n,) [rad]
        Crank angles at which the side may change, rising.
    sides : array (n + 1,)
        Assembly mode before, between and after them: +1 or -1.
    passages : tuple of Passage, one for each break
    """

    origin: float
    cycle: float
    breaks: Array
    sides: Array
    passages: tuple[Passage, ...]

    def side(self, angle: Value) -> Value:
        """Return the assembly mode at a crank angle."""
        value = np.real(as_jet(angle).value)
        within = self.origin + np.remainder(value - self.origin, self.cycle)
        return self.sides[np.searchsorted(self.breaks, within, side="right")]

    def through(self, angle: Value, new: Vector, margin: Value) -> tuple[Vector, Value]:
        """Replace results near the singular positions by their series, and margins that are rounding errors there by zero.

        Parameters
        ----------
        angle : Value [rad]
            Crank angle.
        new : pair of Value [m or -]
            Result of the dyad formula: the joint, or the unit vector of the guide.
        margin : Value [-]
            Assembly margin.
        """
        value = as_jet(angle).value
        for passage in self.passages:
            turns = np.round((np.real(value) - passage.crank_angle) / self.cycle)
            delta = value - passage.crank_angle - self.cycle * turns
            near = np.abs(delta) < passage.window
            if np.any(near):
                place = passage.place(angle, np.where(near, delta, 0.0))
                new = _either(near, place[0], new[0]), _either(near, place[1], new[1])
                margin = _either(near & ~(np.real(as_jet(margin).value) >= 0.0), 0.0, margin)
        return new, margin


def _either(which: Value, one: Value, other: Value) -> Value:
    """Elementwise selection, of jets too."""
    if not isinstance(one, Jet) and not isinstance(other, Jet):
        return np.where(which, one, other)
    return Jet(*(np.where(which, x, y) for x, y in zip(as_jet(one).parts, as_jet(other).parts, strict=True)))
