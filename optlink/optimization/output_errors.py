"""The error of a law on arrays, with its scatter, of which the derivatives are those of `output_derivatives`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

import numpy as np

from optlink.linkage.vector2d import Array, Value
from optlink.problem.design import DesignProblem
from optlink.problem.targets.law import Table
from optlink.problem.tolerances import EXPECTED, residuals, sizes_of

if TYPE_CHECKING:
    from optlink.optimization.output_derivatives import ErrorDerivatives


class ErrorResiduals:
    """Residuals of the objective of a law or of the transmission on numpy arrays, with their scatter if the problem is robust.

    The error of a law is prescribed minus actual.
    """

    def __init__(self, problem: DesignProblem) -> None:
        self.problem, self.robust = problem, problem.robust
        self.slopes: ErrorDerivatives | None = None
        if self.robust is not None:
            from optlink.optimization.output_derivatives import ErrorDerivatives

            self.slopes = ErrorDerivatives(problem)

    def objective(self, values: Mapping[str, Value]) -> Array:
        """Return the objective at the design positions; arrays of dimensions have a last axis of one."""
        law, measure = self.problem.law, self.problem.measure
        parts = self.parts(values, law.offsets, law.tabulated)
        if measure == "max":
            return np.asarray(np.max(sizes_of(parts), axis=-1), dtype=float)
        square = np.sum([np.sum(part * part, axis=-1) for part in parts], axis=0)
        return np.asarray(np.sqrt(square / len(law.offsets)) if measure == "rms" else square, dtype=float)

    def band(self, values: Mapping[str, Value], offsets: Array) -> tuple[Array, Array]:
        """Return the lower and upper end [rad or m] of the error at offsets (n,); for an expected square one sigma."""
        mean, *rest = parts = self.parts(values, offsets, _tabulated(self.problem, offsets))
        if self.robust is not None and self.robust.text == EXPECTED:
            sigma = np.sqrt(np.sum(np.square(rest), axis=0))
            return mean - sigma, mean + sigma
        return parts[-1], mean

    def parts(self, values: Mapping[str, Value], offsets: Array, tabulated: Array) -> list[Array]:
        """Return the residuals at crank rotations [rad] from the start (`optlink.problem.tolerances.residuals`)."""
        problem = self.problem
        with np.errstate(all="ignore"):
            values = problem.complete(values)
            angle, target = values[problem.start_name] + offsets, (offsets, tabulated)
            if self.slopes is None:
                return [-part for part in problem.deviation(problem.linkage.at(values, angle), values, target)]
            (error,), (slopes,) = self.slopes.numeric(values, angle, target)
            return residuals(self.robust, problem.deviations, [-error], [[-slope for slope in slopes]])

    def cosines(self, values: Mapping[str, Value], angles: Array) -> list[Array]:
        """Return the cosines of the transmission angles at crank angles [rad]; of a robust problem both ends of each."""
        problem = self.problem
        with np.errstate(all="ignore"):
            if self.slopes is None:
                return problem.deviation(problem.linkage.at(values, angles), values, ())
            errors, slopes = self.slopes.numeric(values, angles, (0.0,))
            return residuals(self.robust, problem.deviations, errors, slopes, separate=True)


def _tabulated(problem: DesignProblem, offsets: Array) -> Array:
    """Return the output of a table at crank rotations [rad] from the start; zeros for an expression or function."""
    source = problem.requirement.law
    return source.at(offsets) if isinstance(source, Table) else np.zeros(len(offsets))


def error_at(problem: DesignProblem, design: Mapping[str, float], offsets: Array) -> Array:
    """Return prescribed minus actual output of a law [rad or m] at crank rotations (n,) [rad] from the start.

    An angle is in (-pi, pi].
    """
    values = problem.complete(design)
    with np.errstate(all="ignore"):
        pose = problem.linkage.at(values, values[problem.start_name] + offsets)
        (error,) = problem.deviation(pose, values, (offsets, _tabulated(problem, offsets)))
    return np.asarray(-error + 0.0 * offsets, dtype=float)


def error_function(problem: DesignProblem) -> Callable[[Mapping[str, float], Array], Array]:
    """Return the error [rad or m] as a function of design and crank rotations, for a robust largest error with its scatter."""
    if problem.robust is None or problem.measure != "max":
        return lambda design, offsets: error_at(problem, design, offsets)
    judge = ErrorResiduals(problem)

    def widened(design: Mapping[str, float], offsets: Array) -> Array:
        lower, upper = judge.band(design, offsets)
        return np.where(np.abs(upper) >= np.abs(lower), upper, lower)

    return widened
