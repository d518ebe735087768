"""Derivatives of a programme whose terms are values of one function at many crank angles.

casadi differentiates the function once, at one crank angle, and evaluates it in a loop over the angles; the chain rule joins
the results. Differentiating the whole expression instead takes twenty times longer, and its second derivatives are slower.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any

import casadi

from optlink.symbolic import CompiledFunction


@dataclass(frozen=True)
class MappedTerms:
    """Objective and rows as expressions of x, p and the values `z` of a function at every position.

    Parameters
    ----------
    x, p : casadi symbols (n,), (q,)
    at : casadi.Function
        (inputs, senses) -> values: the inputs are the known quantities followed by the crank angle.
    known : casadi expression (k,)
        Known quantities as a function of the first `local` components of x, and of p.
    local : int
    angles : casadi expression (1, positions)
        Crank angles as a function of the other components of x, and of p.
    senses : casadi expression (senses, positions)
        Piecewise constant.
    z : casadi symbols (values, positions)
    f, g : casadi expressions
        Objective and rows.
    """

    x: Any
    p: Any
    at: Any
    known: Any
    local: int
    angles: Any
    senses: Any
    z: Any
    f: Any
    g: Any

    @property
    def parts(self) -> dict[str, Any]:
        """The arguments from which the terms are made."""
        return {field.name: getattr(self, field.name) for field in fields(self)}

    def expanded(self, expressions: list[Any]) -> list[Any]:
        """Return expressions of x, p and z as expressions of x and p alone."""
        columns = [self.at(casadi.vertcat(self.known, self.angles[i]), self.senses[:, i]) for i in range(self.angles.shape[1])]
        return list(
            casadi.Function("expand", [self.x, self.p, self.z], expressions).call([self.x, self.p, casadi.horzcat(*columns)])
        )

    def substituted(self, x: Any, moved: tuple[list[Any], list[Any]], rows: Any) -> MappedTerms:
        """Return the terms as functions of other variables, with further rows.

        Parameters
        ----------
        x : casadi symbols
            The variables, the first ones unchanged.
        moved : (list of casadi symbols, list of casadi expressions)
            What to replace by what.
        rows : casadi expression
            Further rows, as a function of `x` and p.
        """
        known, angles, senses, f, g = casadi.substitute([self.known, self.angles, self.senses, self.f, self.g], *moved)
        return replace(self, x=x, known=known, angles=angles, senses=senses, f=f, g=casadi.vertcat(g, rows))

    # --- one position ----------------------------------------------------------------------------------------------------

    @cached_property
    def _one(self) -> tuple[list[Any], Any, Any]:
        """Inputs (own components of x, p, crank angle, senses) at one position, the values there, what they depend on."""
        own, angle = casadi.SX.sym("own", self.local), casadi.SX.sym("angle")
        senses = casadi.SX.sym("senses", self.senses.shape[0])
        known = casadi.substitute(self.known, self.x[: self.local], own)
        return [own, self.p, angle, senses], self.at(casadi.vertcat(known, angle), senses), casadi.vertcat(own, angle)

    @cached_property
    def _rates(self) -> Any:
        """Derivatives of the crank angles by the other components of x."""
        return casadi.Function("rates", [self.x, self.p], [casadi.densify(casadi.jacobian(self.angles, self.x[self.local :]).T)])

    def _chain(self) -> tuple[Any, Any]:
        """Symbol for the derivatives of a crank angle by the other components of x, and those of (own, angle) by x."""
        others = self.x.shape[0] - self.local
        rate = casadi.SX.sym("rate", others)
        return rate, casadi.diagcat(casadi.SX.eye(self.local), rate.T)

    def _mapped(
        self,
        name: str,
        function: Any,
        given: list[Any],
    ) -> list[Any]:
        """Evaluate a function at all positions; its first two inputs are the same at each."""
        many = function.map(name, "serial", self.angles.shape[1], [0, 1], [])
        return list(many.call(given))

    # --- the whole programme ---------------------------------------------------------------------------------------------

    @cached_property
    def _given(self) -> tuple[Any, Any, list[Any]]:
        """Symbols x and p, and the inputs at all positions as expressions of them."""
        x, p = casadi.MX.sym("x", self.x.shape[0]), casadi.MX.sym("p", self.p.shape[0])
        places = casadi.Function("places", [self.x, self.p], [self.angles, self.senses])
        return x, p, [x[: self.local], p, *places(x, p)]

    @cached_property
    def programme(self) -> dict[str, Any]:
        """The programme for casadi.nlpsol."""
        x, p, given = self._given
        inputs, values, _ = self._one
        (z,) = self._mapped("values", casadi.Function("value", inputs, [values]), given)
        f, g = casadi.Function("rows", [self.x, self.p, self.z], [self.f, self.g])(x, p, z)
        return {"x": x, "p": p, "f": f, "g": g}

    @cached_property
    def _first(self) -> tuple[Any, Any, Any, Any, Any, Any]:
        """Values at all positions and their derivatives by x (n, values * positions); objective, gradient, rows, Jacobian."""
        x, p, given = self._given
        inputs, values, own = self._one
        rate, chain = self._chain()
        slope = casadi.mtimes(casadi.jacobian(values, own), chain).T
        function = casadi.Function("slope", [*inputs, rate], [values, casadi.densify(slope)])
        z, slopes = self._mapped("slopes", function, [*given, self._rates(x, p)])
        f, f_x, f_z = self._parts(self.f, z)
        g, g_x, g_z = self._parts(self.g, z)
        by_x = slopes.T
        gradient = casadi.densify(f_x + casadi.mtimes(f_z, by_x) if f_z.nnz() else f_x).T
        depends = casadi.Function("rows", [x, p], [self.programme["g"]]).jac_sparsity(0, 0)
        return z, by_x, f, gradient, casadi.densify(g), casadi.project(g_x + casadi.mtimes(g_z, by_x), depends)

    def _parts(self, expression: Any, z: Any) -> list[Any]:
        """Return an expression and its derivatives by x and by z; what does not depend on z is computed without it."""
        x, p, _ = self._given
        by_z = casadi.jacobian(expression, casadi.vec(self.z))
        parts = [expression, casadi.jacobian(expression, self.x), by_z]
        symbols, values = ([self.x, self.p, self.z], [x, p, z]) if by_z.nnz() else ([self.x, self.p], [x, p])
        return list(casadi.Function("parts", symbols, parts).call(values))

    @cached_property
    def values(self) -> CompiledFunction:
        """(x, p) -> objective, gradient, rows, Jacobian."""
        x, p, _ = self._given
        return CompiledFunction([x, p], list(self._first[2:]))

    @cached_property
    def hessian(self) -> Any:
        """(x, p, factor of the objective, multipliers) -> upper triangle of the Hessian of the Lagrangian."""
        x, p, given = self._given
        z, by_x = self._first[:2]
        factor, multipliers = casadi.SX.sym("factor"), casadi.SX.sym("multipliers", self.g.shape[0])
        symbols = [casadi.MX.sym("factor"), casadi.MX.sym("multipliers", self.g.shape[0])]
        whole, both = factor * self.f + casadi.dot(multipliers, self.g), casadi.vertcat(self.x, casadi.vec(self.z))
        bent, slope = casadi.hessian(whole, both)
        count = self.x.shape[0]
        outer = casadi.Function("outer", [self.x, self.p, self.z, factor, multipliers], [bent, slope[count:]])
        bend, prices = outer(x, p, z, *symbols)
        found, by_angle = self._bent(given, casadi.reshape(prices, *self.z.shape))
        weights = casadi.SX.sym("weights", *self.angles.shape)
        turned = casadi.hessian(casadi.dot(weights, self.angles), self.x)[0]
        angles = casadi.Function("angles", [self.x, self.p, weights], [turned])(x, p, by_angle)
        chained = casadi.vertcat(casadi.MX.eye(count), by_x)
        total = casadi.mtimes([chained.T, bend, chained]) + found + angles
        return casadi.Function("hessian", [x, p, *symbols], [casadi.triu(casadi.densify(total))])

    def _bent(self, given: list[Any], prices: Any) -> tuple[Any, Any]:
        """Return the second derivatives by x of all values times their prices, and the derivatives of these by the angles."""
        inputs, values, own = self._one
        price = casadi.SX.sym("price", values.shape[0])
        bent, slope = casadi.hessian(casadi.dot(price, values), own)
        rate, chain = self._chain()
        outputs = [casadi.densify(casadi.mtimes([chain.T, bent, chain])), slope[self.local :]]
        function = casadi.Function("bent", [*inputs, price, rate], outputs)
        many = function.map("bent", "serial", self.angles.shape[1], [0, 1], [0])
        found, by_angle = many(*given, prices, self._rates(*self._given[:2]))
        return found, by_angle

    @property
    def options(self) -> dict[str, Any]:
        """Options of casadi.nlpsol: the derivatives."""
        x, p, _ = self._given
        _, _, f, gradient, g, jacobian = self._first
        return {
            "grad_f": casadi.Function("gradient", [x, p], [f, gradient]),
            "jac_g": casadi.Function("jacobian", [x, p], [g, jacobian]),
            "hess_lag": self.hessian,
        }
