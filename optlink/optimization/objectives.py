"""Objective terms: each gives residuals that vanish for a perfect design, elementwise, with their name and unit."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from optlink.linkage.vector2d import Value, angle_from, turn, unit
from optlink.problem.function import DesignProblem, StartPosition


@dataclass(frozen=True)
class Measure:
    """How residuals become one figure: `unit` of that figure, and `width`, the components that one position has."""

    name: str
    unit: str
    width: int = 1

    def sizes(self, residuals: ArrayLike) -> NDArray[np.float64]:
        """Size of the residual at each position."""
        r = np.asarray(residuals, dtype=float)
        found = np.abs(r) if self.width == 1 else np.sqrt(np.sum(np.square(r.reshape(-1, self.width)), axis=1))
        return np.asarray(found, dtype=float)

    def of(self, residuals: ArrayLike) -> float:
        """The figure."""
        r = np.asarray(residuals, dtype=float).ravel()
        if self.name == "max":
            return float(np.max(self.sizes(r)))
        square = float(r @ r)
        return square if self.name == "sum of squares" else float(np.sqrt(square * self.width / r.size))

    def slope(self, residuals: ArrayLike) -> float:
        """Change of the figure per change of what the programme minimises (sum of squares, mean square, largest)."""
        return 0.5 / max(self.of(residuals), 1e-150) if self.name == "rms" else 1.0


def measures(unit: str, width: int = 1) -> dict[str, Measure]:
    """Every measure of residuals in a unit."""
    units = {"sum of squares": f"{unit}^2", "rms": unit, "max": unit}
    return {name: Measure(name, own, width) for name, own in units.items()}


MEASURES = measures("rad")


def output_error(
    problem: DesignProblem, values: Mapping[str, Value], start: StartPosition, offset: Value, tabulated: Value
) -> Value:
    """Wanted minus actual rocker angle [rad] at a crank rotation `offset` [rad] from the start; elementwise.

    Measured as the angle between two unit vectors, so no branch cut of either angle is ever met; in (-pi, pi].
    `tabulated` is `Law.tabulated` there.
    """
    pose = problem.linkage.pose(values, turn(start.crank, unit(offset)))
    wanted = problem.law.wanted(offset, tabulated, start.phi0, start.psi0)
    return angle_from(pose.direction("rocker"), unit(wanted))
