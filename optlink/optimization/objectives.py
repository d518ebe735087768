"""Objective terms: residuals that vanish for a perfect design, elementwise, with name and unit."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from optlink.linkage.vector2d import Value, angle_from, turn, unit
from optlink.problem.design import DesignProblem
from optlink.problem.requirements.base import StartPosition


@dataclass(frozen=True)
class ErrorMeasure:
    """Reduction of residuals to one value: `unit` of that value, and `width`, the number of components per position."""

    name: str
    unit: str
    width: int = 1

    def sizes(self, residuals: ArrayLike) -> NDArray[np.float64]:
        """Return the size of the residual at each position."""
        r = np.asarray(residuals, dtype=float)
        sizes = np.abs(r) if self.width == 1 else np.sqrt(np.sum(np.square(r.reshape(-1, self.width)), axis=1))
        return np.asarray(sizes, dtype=float)

    def of(self, residuals: ArrayLike) -> float:
        """Return the value of the measure."""
        r = np.asarray(residuals, dtype=float).ravel()
        if self.name == "max":
            return float(np.max(self.sizes(r)))
        square = float(r @ r)
        return square if self.name == "sum of squares" else float(np.sqrt(square * self.width / r.size))

    @property
    def smooth_unit(self) -> str:
        """Unit of the objective of the NLP: of an rms the mean square."""
        return f"{self.unit}^2" if self.name == "rms" and self.unit else self.unit

    def slope(self, residuals: ArrayLike) -> float:
        """Return the derivative with respect to the objective of the NLP (sum of squares, mean square, largest)."""
        return 0.5 / max(self.of(residuals), 1e-150) if self.name == "rms" else 1.0


@dataclass(frozen=True)
class Figure(ErrorMeasure):
    """An objective with a single value."""

    def sizes(self, residuals: ArrayLike) -> NDArray[np.float64]:
        """Return the absolute value of the residuals."""
        return np.asarray(np.abs(np.asarray(residuals, dtype=float)), dtype=float)

    def of(self, residuals: ArrayLike) -> float:
        """Return the value of the objective."""
        return float(np.asarray(residuals, dtype=float).ravel()[0])

    def slope(self, residuals: ArrayLike) -> float:
        """Return the derivative of the objective with respect to that of the NLP."""
        return 1.0


def error_measures(unit: str, width: int = 1) -> dict[str, ErrorMeasure]:
    """Return every measure of residuals in a unit, by name; `width` is the number of components per position."""
    units = {"sum of squares": f"{unit}^2", "rms": unit, "max": unit}
    return {name: ErrorMeasure(name, display_unit, width) for name, display_unit in units.items()}


MEASURES = error_measures("rad")


def output_error(
    problem: DesignProblem, values: Mapping[str, Value], start: StartPosition, offset: Value, tabulated: Value
) -> Value:
    """Return prescribed minus actual rocker angle [rad], in (-pi, pi], elementwise.

    It is computed as the angle between two unit vectors, which avoids the branch cuts of both angles. `offset` [rad] is the crank
    rotation from the start, `tabulated` is `Law.tabulated` there.
    """
    pose = problem.linkage.pose(values, turn(start.crank, unit(offset)))
    target = problem.law.target(offset, tabulated, start.phi0, start.psi0)
    return angle_from(pose.direction(problem.output), unit(target))
