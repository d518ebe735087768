"""Exact derivatives of an output with respect to dimensions, and the error of a law with its scatter."""

from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any

import casadi
import numpy as np

from optlink.linkage.mechanism import Mechanism
from optlink.linkage.vector2d import Array, Value, Vector, cross, turn, unit
from optlink.optimization.objectives import output_error
from optlink.problem.design import DesignProblem
from optlink.problem.robust import EXPECTED, residuals, sizes_of
from optlink.problem.targets.law import Table
from optlink.problem.tolerances import Deviation, with_deviating_pivots
from optlink.symbolic import NumpyEvaluator, symbols_in_numpy


def output_derivatives(
    mechanism: Mechanism, sizes: Mapping[str, Any], crank: Vector, output: str, by: Sequence[str]
) -> tuple[Any, list[Any]]:
    """Return an output and its derivatives by dimensions, as symbols; call it within `symbolic.symbols_in_numpy`.

    An output is the name of a body (its angle), or "P.x", "P.y" of a point.
    """
    pose = mechanism.pose(sizes, crank)
    if output in mechanism.bodies:
        x, y = axis = pose.direction(output)
        slopes = [cross(axis, (casadi.jacobian(x, sizes[n]), casadi.jacobian(y, sizes[n]))) for n in by]
        return casadi.atan2(y, x), slopes
    point, _, axis_name = output.rpartition(".")
    value = casadi.SX(pose.point(point)["xy".index(axis_name)])
    return value, [casadi.jacobian(value, sizes[n]) for n in by]


class ErrorDerivatives:
    """Derivatives of the error of a law (prescribed minus actual) with respect to the dimension of every deviation."""

    def __init__(self, problem: DesignProblem) -> None:
        self.deviations: tuple[Deviation, ...] = problem.deviations
        mechanism, self._pivots = with_deviating_pivots(problem.mechanism, problem.linkage)
        self._names = [*problem.mechanism.quantities, *self._pivots]
        symbols = {name: casadi.SX.sym(name) for name in self._names}
        crank = casadi.SX.sym("crank direction", 2)
        by = list(dict.fromkeys(d.size for d in self.deviations))
        with symbols_in_numpy():
            _, slopes = output_derivatives(mechanism, symbols, (crank[0], crank[1]), "rocker", by)
        self._inputs, self._outputs = [*symbols.values(), crank[0], crank[1]], [-slope for slope in slopes]
        self._place = [by.index(d.size) for d in self.deviations]

    def _arguments(self, values: Mapping[str, Value], crank: Vector) -> list[Value]:
        return [*(values.get(name, self._pivots.get(name, 0.0)) for name in self._names), *crank]

    def symbolic(self, values: Mapping[str, Value], crank: Vector) -> list[Any]:
        """Return the derivatives as symbols, one for each deviation [SI]."""
        function = casadi.Function("slopes", [casadi.vertcat(*self._inputs)], [casadi.vertcat(*self._outputs)])
        outputs = function(casadi.vertcat(*self._arguments(values, crank)))
        return [outputs[i] for i in self._place]

    @cached_property
    def _numeric(self) -> NumpyEvaluator:
        return NumpyEvaluator(self._inputs, self._outputs)

    def numeric(self, values: Mapping[str, Value], crank: Vector) -> list[Array]:
        """Return the derivatives as arrays, one for each deviation [SI]; dimensions broadcast with the direction of the crank."""
        outputs = self._numeric(*self._arguments(values, crank))
        return [outputs[i] for i in self._place]


class ErrorResiduals:
    """Residuals of a problem's objective on numpy arrays: the error, or its combination with the scatter of a robust design."""

    def __init__(self, problem: DesignProblem) -> None:
        self.problem, self.robust = problem, problem.requirement.robust
        self.slopes = None if self.robust is None else ErrorDerivatives(problem)

    def objective(self, values: Mapping[str, Value]) -> Array:
        """Return the objective at the design positions; arrays of dimensions have a last axis of one."""
        law, measure = self.problem.law, self.problem.measure
        parts = self.parts(values, law.offsets, law.tabulated)
        if measure == "max":
            return np.asarray(np.max(sizes_of(parts), axis=-1), dtype=float)
        square = np.sum([np.sum(part * part, axis=-1) for part in parts], axis=0)
        return np.asarray(np.sqrt(square / len(law.offsets)) if measure == "rms" else square, dtype=float)

    def band(self, values: Mapping[str, Value], offsets: Array) -> tuple[Array, Array]:
        """Return the lower and upper end [rad] of the error at offsets (n,); for an expected square, one standard deviation."""
        source = self.problem.requirement.law
        tabulated = source.at(offsets) if isinstance(source, Table) else np.zeros(len(offsets))
        mean, *rest = parts = self.parts(values, offsets, tabulated)
        if self.robust is not None and self.robust.text == EXPECTED:
            sigma = np.sqrt(np.sum(np.square(rest), axis=0))
            return mean - sigma, mean + sigma
        return parts[-1], mean

    def parts(self, values: Mapping[str, Value], offsets: Array, tabulated: Array) -> list[Array]:
        """Return the residuals at crank rotations [rad] from the start (`optlink.problem.robust.residuals`)."""
        problem = self.problem
        with np.errstate(all="ignore"):
            start = problem.start_position(values)
            error = output_error(problem, values, start, offsets, tabulated)
            slopes = [] if self.slopes is None else self.slopes.numeric(values, turn(start.crank, unit(offsets)))
            return residuals(self.robust, problem.deviations, error, slopes)
