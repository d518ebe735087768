"""Exact derivatives of outputs and errors with respect to dimensions, and the error of a law with its scatter."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any

import casadi
import numpy as np

from optlink.linkage.mechanism import Mechanism
from optlink.linkage.vector2d import Array, Value, Vector, cross, unit
from optlink.problem.design import DesignProblem
from optlink.problem.targets.law import Table
from optlink.problem.tolerances import EXPECTED, residuals, sizes_of, with_deviating_pivots
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
    """Components of the deviation at one position, and their derivatives with respect to dimensions.

    `sizes`: their names; by default the dimension of every deviation of the problem.
    """

    def __init__(self, problem: DesignProblem, sizes: Sequence[str] | None = None) -> None:
        sizes = [d.size for d in problem.deviations] if sizes is None else sizes
        linkage, self._pivots = with_deviating_pivots(problem.mechanism, problem.linkage)
        start = {problem.start_name, problem.base_name}
        self._names = list(dict.fromkeys([*problem.quantities, *start, *self._pivots]))
        symbols = {name: casadi.SX.sym(name) for name in self._names}
        angle, more = casadi.SX.sym("crank angle"), [casadi.SX.sym(f"target {k}") for k in range(problem.data.columns.shape[1])]
        by = list(dict.fromkeys(sizes))
        with symbols_in_numpy():
            parts = problem.deviation(linkage.pose(symbols, unit(angle)), symbols, tuple(more))
            slopes = [casadi.jacobian(part, symbols[name]) for part in parts for name in by]
        self._inputs, self._outputs, self._count = [*symbols.values(), angle, *more], [*parts, *slopes], len(parts)
        self._place = [by.index(size) for size in sizes]
        self._each = len(by)

    def _arguments(self, values: Mapping[str, Value], angle: Value, target: tuple[Value, ...]) -> list[Value]:
        return [*(values.get(name, self._pivots.get(name, 0.0)) for name in self._names), angle, *target]

    def _split(self, outputs: Any) -> tuple[list[Any], list[list[Any]]]:
        parts = [outputs[k] for k in range(self._count)]
        first = [self._count + k * self._each for k in range(self._count)]
        return parts, [[outputs[begin + i] for i in self._place] for begin in first]

    def symbolic(self, values: Mapping[str, Value], angle: Any, target: tuple[Any, ...]) -> tuple[list[Any], list[list[Any]]]:
        """Return the components at a crank angle, and for each its derivatives [1/SI] by every deviation, as symbols."""
        function = casadi.Function("slopes", [casadi.vertcat(*self._inputs)], [casadi.vertcat(*self._outputs)])
        return self._split(function(casadi.vertcat(*self._arguments(values, angle, target))))

    @cached_property
    def _numeric(self) -> NumpyEvaluator:
        return NumpyEvaluator(self._inputs, self._outputs)

    def numeric(
        self, values: Mapping[str, Value], angle: Value, target: tuple[Value, ...]
    ) -> tuple[list[Array], list[list[Array]]]:
        """Return the same as arrays; dimensions broadcast with the crank angle."""
        return self._split(self._numeric(*self._arguments(values, angle, target)))


def traced_residuals(
    problem: DesignProblem, known: Mapping[str, Any], angle: Any, target: tuple[Any, ...], smoothed: Value
) -> list[Any]:
    """Return the residuals of a robust problem at one position as symbols, see `optlink.problem.tolerances.residuals`.

    `known` has the quantities and, by their keys, the tolerances that count.
    """
    deviations = [replace(d, tolerance=known.get(f"tolerances.{d.name}", d.tolerance)) for d in problem.deviations]
    errors, slopes = ErrorDerivatives(problem).symbolic(known, angle, target)
    return residuals(problem.robust, deviations, errors, slopes, smoothed, separate=problem.separate)


class ErrorResiduals:
    """Residuals of the objective of a law or of the transmission on numpy arrays, with their scatter if the problem is robust.

    The error of a law is prescribed minus actual.
    """

    def __init__(self, problem: DesignProblem) -> None:
        self.problem, self.robust = problem, problem.robust
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
                return [-part for part in problem.deviation(problem.linkage.pose(values, unit(angle)), values, target)]
            (error,), (slopes,) = self.slopes.numeric(values, angle, target)
            return residuals(self.robust, problem.deviations, [-error], [[-slope for slope in slopes]])

    def cosines(self, values: Mapping[str, Value], angles: Array) -> list[Array]:
        """Return the cosines of the transmission angles at crank angles [rad]; of a robust problem both ends of each."""
        problem = self.problem
        with np.errstate(all="ignore"):
            if self.slopes is None:
                return problem.deviation(problem.linkage.pose(values, unit(angles)), values, ())
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
        pose = problem.linkage.pose(values, unit(values[problem.start_name] + offsets))
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
