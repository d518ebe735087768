"""Exact derivatives of outputs and errors with respect to dimensions."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any

import casadi

from optlink.linkage.mechanism import Mechanism
from optlink.linkage.vector2d import Array, Value, cross
from optlink.problem.design import DesignProblem
from optlink.problem.tolerances import residuals, with_deviating_pivots
from optlink.symbolic import NumpyEvaluator, symbols_in_numpy


def output_derivatives(
    mechanism: Mechanism, sizes: Mapping[str, Any], crank_angle: Any, output: str, by: Sequence[str]
) -> tuple[Any, list[Any]]:
    """Return an output and its derivatives by dimensions, as symbols; call it within `symbolic.symbols_in_numpy`.

    An output is the name of a body (its angle), or "P.x", "P.y" of a point.
    """
    pose = mechanism.at(sizes, crank_angle)
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
            parts = problem.deviation(linkage.at(symbols, angle), symbols, tuple(more))
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
