"""Sides of a group over the crank angle, and its Taylor series about singular positions.

At a singular position the formulas of a dyad are 0/0. The joint itself moves smoothly: there its position is a power series in
the crank angle, whose derivatives are the velocities and accelerations.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from optlink.linkage.jet import Jet, as_jet
from optlink.linkage.vector2d import Array, Value, Vector

CIRCLE = 2.0 * (1.0 + 1e-9)
"""Radius of the circle from which a series was computed, over its window."""


@dataclass(frozen=True)
class Passage:
    """Power series (2, terms) of two coordinates in crank angle - `crank_angle` [rad], accurate within `window` [rad]."""

    crank_angle: float
    window: float
    series: Array

    def place(self, angle: Value, delta: Value) -> Vector:
        """Evaluate the two coordinates at the distance `delta` [rad] from `crank_angle`.

        They are jets if `angle`, the crank angle, is one: of that only the derivatives are used.
        """
        if not isinstance(angle, Jet):
            x, y = _polynomials(self.series, delta)
            return x, y
        (x, y), (x_rate, y_rate), (x_bend, y_bend) = (_polynomials(rows, delta) for rows in self._derivatives)
        rate, square, acceleration = angle.rate, angle.rate * angle.rate, angle.acceleration
        return (
            Jet(x, x_rate * rate, x_bend * square + x_rate * acceleration),
            Jet(y, y_rate * rate, y_bend * square + y_rate * acceleration),
        )

    @cached_property
    def _derivatives(self) -> tuple[Array, Array, Array]:
        """The series, and its first and second derivative with respect to the crank angle."""
        first = self.series[:, 1:] * np.arange(1, self.series.shape[1])
        return self.series, first, first[:, 1:] * np.arange(1, first.shape[1])


def _polynomials(rows: Array, delta: Value) -> Iterator[Value]:
    """Yield the values of polynomials (polynomials, terms), by Horner's rule."""
    if isinstance(delta, np.ndarray):
        yield from np.polynomial.polynomial.polyval(delta, rows.T)
        return
    for row in rows:
        value = 0.0
        for coefficient in reversed(row.tolist()):
            value = value * delta + coefficient
        yield value


@dataclass(frozen=True)
class GroupPassages:
    """Sides and passages of a group over the crank angle [rad], from `origin` to `origin + cycle`; they repeat with this period.

    `sides` (n + 1,): assembly modes before, between and after the rising crank angles `breaks` (n,).
    """

    origin: float
    cycle: float
    breaks: Array
    sides: Array
    passages: tuple[Passage, ...]

    def side(self, angle: Value) -> Value:
        """Return the assembly mode at a crank angle."""
        value = as_jet(angle).value
        if _numeric(value):
            within = self.origin + np.remainder(np.real(value) - self.origin, self.cycle)
            return self.sides[np.searchsorted(self.breaks, within, side="right")]
        within = self.origin + np.remainder(value - self.origin, self.cycle)
        changes = zip(np.diff(self.sides), self.breaks, strict=True)
        return self.sides[0] + sum(float(change) * (within >= float(at)) for change, at in changes if change)

    def through(self, angle: Value, formula: Callable[[Value], tuple[Vector, Value]]) -> tuple[Vector, Value]:
        """Return the result of a dyad formula at a crank angle [rad], near singular positions replaced by its series.

        The formula maps the assembly mode to the joint [m], or the unit vector of the guide, and the assembly margin. Margins
        that are rounding errors near singular positions become zero.
        """
        value = as_jet(angle).value
        if not _numeric(value):
            return self._traced(angle, value, *formula(self.side(angle)))
        away = [value - passage.crank_angle for passage in self.passages]
        away = [delta - self.cycle * np.round(np.real(delta) / self.cycle) for delta in away]
        new, margin = formula(self._side_of_series(value, away, formula) if np.iscomplexobj(value) else self.side(angle))
        for passage, delta in zip(self.passages, away, strict=True):
            near = np.abs(delta) < passage.window
            if np.any(near):
                place = passage.place(angle, np.where(near, delta, 0.0))
                new = _either(near, place[0], new[0]), _either(near, place[1], new[1])
                margin = _either(near & ~(np.real(as_jet(margin).value) >= 0.0), 0.0, margin)
        return new, margin

    def _traced(self, angle: Value, value: Value, new: Vector, margin: Value) -> tuple[Vector, Value]:
        """Return the same for symbols, except the margin near a singular position."""
        for passage in self.passages:
            delta = value - passage.crank_angle
            delta = delta - self.cycle * np.round(delta / self.cycle)
            near, place = np.abs(delta) < passage.window, passage.place(angle, delta)
            new = _either(near, place[0], new[0]), _either(near, place[1], new[1])
        return new, margin

    def _side_of_series(self, value: Value, away: list[Value], formula: Callable[[Value], tuple[Vector, Value]]) -> Value:
        """Return the assembly mode at complex crank angles.

        Round a singular position the two solutions exchange their places where the square root has its branch cut, which is known
        only roughly; the one that continues the motion is the one closer to its series.
        """
        side = self.side(value)
        both = [formula(mode)[0] for mode in (1, -1)]
        for passage, delta in zip(self.passages, away, strict=True):
            near = np.abs(delta) <= CIRCLE * passage.window
            if np.any(near):
                place = passage.place(value, np.where(near, delta, 0.0))
                one, other = (sum(np.abs(x - y) ** 2 for x, y in zip(new, place, strict=True)) for new in both)
                side = np.where(near, np.where(one <= other, 1, -1), side)
        return side


def _either(which: Value, one: Value, other: Value) -> Value:
    """Elementwise selection, of jets too."""
    if not isinstance(one, Jet) and not isinstance(other, Jet):
        return np.where(which, one, other)
    return Jet(*(np.where(which, x, y) for x, y in zip(as_jet(one).parts, as_jet(other).parts, strict=True)))


def _numeric(x: Value) -> bool:
    """Return whether a value is a number or an array of numbers, not a symbol."""
    return isinstance(x, float | int | complex | np.ndarray | np.generic)
