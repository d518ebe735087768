"""Derivatives of a programme whose terms are values of functions at many crank angles.

casadi differentiates each function once, at one crank angle, and evaluates it for vectors of crank angles; the chain rule joins
the results. Differentiating the whole expression instead takes twenty times longer, and its second derivatives are slower.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any

import casadi
import numpy as np

from optlink.symbolic import CompiledFunction, elementwise


@dataclass(frozen=True)
class MappedTerms:
    """Objective and rows as expressions of x, p and the values `z` of functions, each at its own positions.

    `at`, `angles`, `senses` and `z` have an element for each function.

    Parameters
    ----------
    x, p : casadi symbols (n,), (q,)
    at : tuple of casadi.Function
        (inputs, senses) -> values: the inputs are the known quantities followed by the crank angle.
    known : casadi expression (k,)
        Known quantities as a function of the first `local` components of x, and of p.
    angles : tuple of casadi expression (1, positions)
        Crank angles as a function of the other components of x, and of p.
    senses : tuple of casadi expression (senses, positions)
        Piecewise constant as functions of x.
    z : tuple of casadi symbols (values, positions)
    f, g : casadi expressions
        Objective and rows.
    """

    x: Any
    p: Any
    at: tuple[Any, ...]
    known: Any
    local: int
    angles: tuple[Any, ...]
    senses: tuple[Any, ...]
    z: tuple[Any, ...]
    f: Any
    g: Any

    @property
    def parts(self) -> dict[str, Any]:
        """The arguments from which the terms are made."""
        return {field.name: getattr(self, field.name) for field in fields(self)}

    def expanded(self, expressions: list[Any]) -> list[Any]:
        """Return expressions of x, p and z as expressions of x and p alone."""
        values = []
        for at, angles, senses in zip(self.at, self.angles, self.senses, strict=True):
            columns = [at(casadi.vertcat(self.known, angles[i]), senses[:, i]) for i in range(angles.shape[1])]
            values.append(casadi.horzcat(*columns))
        return list(casadi.Function("expand", [self.x, self.p, *self.z], expressions).call([self.x, self.p, *values]))

    def substituted(self, x: Any, moved: tuple[list[Any], list[Any]], rows: Any) -> MappedTerms:
        """Return the terms as functions of other variables `x`, the first ones unchanged, with further rows.

        `moved`: what to replace by what. `rows` is an expression of `x`, p and z.
        """
        count = len(self.at)
        expressions = casadi.substitute([self.known, self.f, self.g, *self.angles, *self.senses], *moved)
        (known, f, g), angles, senses = expressions[:3], tuple(expressions[3 : 3 + count]), tuple(expressions[3 + count :])
        terms = replace(self, x=x, known=known, angles=angles, senses=senses, f=f, g=casadi.vertcat(g, rows))
        vars(terms)["_mapped_functions"] = self._mapped_functions
        return terms

    def of_rows(self, rows: Sequence[int]) -> MappedTerms:
        """Return the terms with some of the rows, without positions on which they do not depend."""
        g, parts = self.g[rows], []
        for z, angles, senses in zip(self.z, self.angles, self.senses, strict=True):
            used = np.reshape(casadi.which_depends(casadi.vertcat(self.f, g), casadi.vec(z), 1, False), z.shape, order="F")
            keep = np.flatnonzero(used.any(axis=0)).tolist()
            parts.append((angles[:, keep], senses[:, keep], z[:, keep]))
        angles, senses, z = zip(*parts, strict=True)
        return replace(self, angles=angles, senses=senses, z=z, g=g)

    def with_slopes(self, heights: Sequence[Any], places: Sequence[Any]) -> tuple[MappedTerms, Any]:
        """Return the terms with the derivatives of the functions by the crank angle as further values, and slopes made of these.

        Each height, an expression of x, p and z, is differentiated by its own one of the `places`, components of p.
        """
        at, values = [], []
        slopes = [casadi.jacobian(height, place) for height, place in zip(heights, places, strict=True)]
        for function, angles, z in zip(self.at, self.angles, self.z, strict=True):
            if any(casadi.which_depends(angles, casadi.vertcat(*places), 1, True)):
                inputs, senses = function.sx_in()
                outputs, rates = function(inputs, senses), casadi.SX.sym("rates", *z.shape)
                for k, (height, place) in enumerate(zip(heights, places, strict=True)):
                    moved = rates * casadi.repmat(casadi.jacobian(angles, place).T, rates.shape[0], 1)
                    slopes[k] += casadi.mtimes(casadi.jacobian(height, casadi.vec(z)), casadi.vec(moved))
                more = casadi.vertcat(outputs, casadi.jacobian(outputs, inputs[-1]))
                function, z = casadi.Function("rates", [inputs, senses], [more]), casadi.vertcat(z, rates)
            at.append(function)
            values.append(z)
        return replace(self, at=tuple(at), z=tuple(values)), casadi.vertcat(*slopes)

    # --- one position ----------------------------------------------------------------------------------------------------

    @cached_property
    def _mapped_functions(self) -> tuple[_MappedFunction, ...]:
        """Each function of one position at all of its positions; `substituted` terms use the same."""
        functions = []
        for at, angles, senses in zip(self.at, self.angles, self.senses, strict=True):
            local_x, angle = casadi.SX.sym("own", self.local), casadi.SX.sym("angle")
            sense = casadi.SX.sym("senses", senses.shape[0])
            quantities = casadi.substitute(self.known, self.x[: self.local], local_x)
            values = casadi.densify(at(casadi.vertcat(quantities, angle), sense))
            functions.append(_MappedFunction([local_x, self.p, angle, sense], values, local_x, angle, angles.shape[1]))
        return tuple(functions)

    # --- the whole programme ---------------------------------------------------------------------------------------------

    @cached_property
    def _symbols(self) -> tuple[Any, Any]:
        """Symbols x and p of the whole programme."""
        return casadi.MX.sym("x", self.x.shape[0]), casadi.MX.sym("p", self.p.shape[0])

    @cached_property
    def _inputs_at_positions(self) -> list[list[Any]]:
        """For each function its inputs at all positions."""
        x, p = self._symbols
        places = casadi.Function("places", [self.x, self.p], [part.T for part in (*self.angles, *self.senses)]).call([x, p])
        count = len(self.at)
        return [[x[: self.local].T, p.T, *each] for each in zip(places[:count], places[count:], strict=True)]

    @cached_property
    def programme(self) -> dict[str, Any]:
        """The programme for casadi.nlpsol."""
        z = [
            each.values.call(inputs, True, False)[0].T
            for each, inputs in zip(self._mapped_functions, self._inputs_at_positions, strict=True)
        ]
        f, g = (self._evaluated([part], z)[0] for part in (self.f, self.g))
        x, p = self._symbols
        return {"x": x, "p": p, "f": f, "g": g}

    def _evaluated(self, expressions: list[Any], z: list[Any]) -> list[Any]:
        """Evaluate expressions at values of z; only the functions on which they depend are evaluated."""
        whole, pairs = casadi.veccat(*expressions), zip(self.z, z, strict=True)
        used = [pair for pair in pairs if any(casadi.which_depends(whole, casadi.vec(pair[0]), 1, False))]
        symbols, values = [self.x, self.p, *(symbol for symbol, _ in used)], [*self._symbols, *(value for _, value in used)]
        return list(casadi.Function("terms", symbols, expressions).call(values))

    @cached_property
    def _rates(self) -> list[Any]:
        """Derivatives of the crank angles of each function by the other components of x (positions, others)."""
        rates = [casadi.jacobian(angles, self.x[self.local :]) for angles in self.angles]
        return list(casadi.Function("rates", [self.x, self.p], rates).call(list(self._symbols)))

    @cached_property
    def _first(self) -> tuple[list[Any], Any, Any, Any, Any, Any]:
        """Values of each function at all positions; derivatives of all by x; objective, gradient, rows, Jacobian."""
        x, p = self._symbols
        z, slopes = [], []
        for each, inputs, rates in zip(self._mapped_functions, self._inputs_at_positions, self._rates, strict=True):
            values, local_derivatives, by_angle = each.slopes(*inputs)
            z.append(values.T)
            slopes.append(casadi.horzcat(each.local_derivatives(local_derivatives), each.other_derivatives(by_angle, rates)))
        (f, by_f), (g, by_g) = (self._sloped(expression, z, slopes) for expression in (self.f, self.g))
        depends = casadi.Function("rows", [x, p], [self.programme["g"]]).jac_sparsity(0, 0)
        return z, casadi.vertcat(*slopes), f, casadi.densify(by_f).T, casadi.densify(g), casadi.project(by_g, depends)

    def _sloped(self, expression: Any, z: list[Any], slopes: list[Any]) -> tuple[Any, Any]:
        """Return an expression and its derivatives by x; `slopes` are those of the values of each function."""
        parts = [casadi.jacobian(expression, by) for by in (self.x, *map(casadi.vec, self.z))]
        value, total, *by_z = self._evaluated([expression, *parts], z)
        for part, slope in zip(by_z, slopes, strict=True):
            total = total + casadi.mtimes(part, slope) if part.nnz() else total
        return value, total

    @cached_property
    def values(self) -> CompiledFunction:
        """(x, p) -> objective, gradient, rows, Jacobian."""
        return CompiledFunction(list(self._symbols), list(self._first[2:]))

    @cached_property
    def hessian(self) -> Any:
        """(x, p, factor of the objective, multipliers) -> upper triangle of the Hessian of the Lagrangian."""
        x, p = self._symbols
        z, by_x = self._first[:2]
        factor, multipliers = casadi.SX.sym("factor"), casadi.SX.sym("multipliers", self.g.shape[0])
        symbols = [casadi.MX.sym("factor"), casadi.MX.sym("multipliers", self.g.shape[0])]
        whole, both = factor * self.f + casadi.dot(multipliers, self.g), casadi.veccat(self.x, *self.z)
        bent, slope = casadi.hessian(whole, both)
        count = self.x.shape[0]
        ends = np.cumsum([count, *(part.numel() for part in self.z)]).tolist()
        prices = [casadi.reshape(slope[a:b], *part.shape) for a, b, part in zip(ends[:-1], ends[1:], self.z, strict=True)]
        outer = casadi.Function("outer", [self.x, self.p, *self.z, factor, multipliers], [bent, *map(casadi.densify, prices)])
        bend, *prices = outer(x, p, *z, *symbols)
        chained = casadi.vertcat(casadi.MX.eye(count), by_x)
        total = casadi.mtimes([chained.T, bend, chained])
        for each, inputs, rates, price, angles in zip(
            self._mapped_functions, self._inputs_at_positions, self._rates, prices, self.angles, strict=True
        ):
            curvatures, by_angle = each.bent(inputs, price.T, rates)
            weights = casadi.SX.sym("weights", *angles.shape)
            turned = casadi.hessian(casadi.dot(weights, angles), self.x)[0]
            total += curvatures + casadi.Function("angles", [self.x, self.p, weights], [turned])(x, p, by_angle.T)
        return casadi.Function("hessian", [x, p, *symbols], [casadi.triu(casadi.densify(total))])

    @property
    def options(self) -> dict[str, Any]:
        """Options of casadi.nlpsol: the derivatives."""
        symbols = list(self._symbols)
        _, _, f, gradient, g, jacobian = self._first
        return {
            "grad_f": casadi.Function("gradient", symbols, [f, gradient]),
            "jac_g": casadi.Function("jacobian", symbols, [g, jacobian]),
            "hess_lag": self.hessian,
        }


@dataclass(frozen=True)
class _MappedFunction:
    """A function of one position and its derivatives, evaluated at all positions; the results have a row for each."""

    inputs: list[Any]
    outputs: Any
    own: Any
    angle: Any
    positions: int

    def _compiled(self, inputs: list[Any], outputs: list[Any]) -> Any:
        return elementwise(casadi.Function("one", inputs, outputs), 2, self.positions)

    @cached_property
    def values(self) -> Any:
        return self._compiled(self.inputs, [self.outputs])

    @cached_property
    def _local_jacobian(self) -> Any:
        return casadi.jacobian(self.outputs, self.own)

    @cached_property
    def slopes(self) -> Any:
        """Values, their derivatives by the own components of x (those that do not vanish) and by the angle."""
        by_angle = casadi.densify(casadi.jacobian(self.outputs, self.angle))
        return self._compiled(self.inputs, [self.outputs, casadi.vertcat(*self._local_jacobian.nonzeros()), by_angle])

    def local_derivatives(self, slopes: Any) -> Any:
        """Return the derivatives (values * positions, local) of the values by the own components of x."""
        pattern = self._local_jacobian.sparsity()
        ends = pattern.colind()
        repeated = casadi.repmat(pattern, self.positions, 1)
        parts = [casadi.vec(part.T) for part in casadi.horzsplit(slopes, ends)] if pattern.nnz() else []
        return casadi.MX(repeated, casadi.vertcat(*parts)) if pattern.nnz() else casadi.MX(*repeated.shape)

    def other_derivatives(self, slopes: Any, rates: Any) -> Any:
        """Return the derivatives (values * positions, others) of the values by the other components of x.

        They are the product of those by the angle (positions, values) and the rates of the angles (positions, others).
        """
        count = self.outputs.shape[0]
        every = casadi.kron(rates.sparsity(), casadi.Sparsity.dense(count, 1))
        if not rates.nnz() or not count:
            return casadi.MX(*every.shape)
        each = casadi.vec(rates.nz[:])
        return casadi.MX(every, casadi.vec((slopes[rates.sparsity().row(), :] * casadi.repmat(each, 1, count)).T))

    @cached_property
    def _curvatures(self) -> tuple[Any, Any]:
        """Second derivatives of the values times their prices, the last input: by own components (those that do not vanish), by
        one and the angle, by the angle; derivative by the angle. With them the pattern of the first."""
        price, count = casadi.SX.sym("price", self.outputs.shape[0]), self.own.shape[0]
        bent, slope = casadi.hessian(casadi.dot(price, self.outputs), casadi.vertcat(self.own, self.angle))
        by_local: Any = casadi.triu(bent[:count, :count])
        parts = [casadi.densify(part) for part in (bent[:count, count], bent[count, count], slope[count])]
        return self._compiled([*self.inputs, price], [casadi.vertcat(*by_local.nonzeros()), *parts]), by_local.sparsity()

    def bent(self, inputs: list[Any], prices: Any, rates: Any) -> tuple[Any, Any]:
        """Return the second derivatives by x of all values times their prices, and the derivatives of these by the angles.

        `prices` (positions, values); `rates` (positions, others) of the angles by the other components of x.
        """
        function, pattern = self._curvatures
        local_derivatives, by_both, by_angles, by_angle = function(*inputs, prices)
        mixed = casadi.mtimes(by_both.T, rates)
        by_local = casadi.triu2symm(casadi.MX(pattern, casadi.sum1(local_derivatives).T))
        others = casadi.mtimes([rates.T, casadi.diag(by_angles), rates])
        return casadi.vertcat(casadi.horzcat(by_local, mixed), casadi.horzcat(mixed.T, others)), by_angle
