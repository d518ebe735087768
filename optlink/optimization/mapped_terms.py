"""Derivatives of a programme whose terms are values of one function at many crank angles.

casadi differentiates the function once, at one crank angle, and evaluates it in a loop over the angles; the chain rule joins
the results. Differentiating the whole expression instead takes twenty times longer, and its second derivatives are slower.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any

import casadi

from optlink.symbolic import CompiledFunction, elementwise


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
        made = replace(self, x=x, known=known, angles=angles, senses=senses, f=f, g=casadi.vertcat(g, rows))
        vars(made)["_everywhere"] = self._everywhere
        return made

    # --- one position ----------------------------------------------------------------------------------------------------

    @cached_property
    def _one(self) -> tuple[list[Any], Any, Any, Any]:
        """Inputs (own components of x, p, crank angle, senses) at one position, the values there, own components, angle."""
        own, angle = casadi.SX.sym("own", self.local), casadi.SX.sym("angle")
        senses = casadi.SX.sym("senses", self.senses.shape[0])
        known = casadi.substitute(self.known, self.x[: self.local], own)
        return [own, self.p, angle, senses], self.at(casadi.vertcat(known, angle), senses), own, angle

    @cached_property
    def _everywhere(self) -> _Everywhere:
        """The functions of one position at all of them; `substituted` terms use the same."""
        return _Everywhere(*self._one, self.angles.shape[1])

    # --- the whole programme ---------------------------------------------------------------------------------------------

    @cached_property
    def _given(self) -> tuple[Any, Any, list[Any]]:
        """Symbols x and p, and the inputs at all positions as expressions of them."""
        x, p = casadi.MX.sym("x", self.x.shape[0]), casadi.MX.sym("p", self.p.shape[0])
        places = casadi.Function("places", [self.x, self.p], [self.angles.T, self.senses.T])
        return x, p, [x[: self.local].T, p.T, *places(x, p)]

    @cached_property
    def programme(self) -> dict[str, Any]:
        """The programme for casadi.nlpsol."""
        x, p, given = self._given
        z = self._everywhere.values.call(given, True, False)[0].T
        f, g = (self._evaluated([part], z)[0] for part in (self.f, self.g))
        return {"x": x, "p": p, "f": f, "g": g}

    def _evaluated(self, expressions: list[Any], z: Any) -> list[Any]:
        """Evaluate expressions at values of z; what does not depend on z is computed without it."""
        symbols, given = [self.x, self.p, self.z], [*self._given[:2], z]
        count = 3 if any(casadi.which_depends(casadi.vertcat(*map(casadi.vec, expressions)), casadi.vec(self.z), 1, False)) else 2
        return list(casadi.Function("terms", symbols[:count], expressions).call(given[:count]))

    @cached_property
    def _rates(self) -> Any:
        """Derivatives of the crank angles by the other components of x (positions, others)."""
        rates = casadi.densify(casadi.jacobian(self.angles, self.x[self.local :]))
        return casadi.Function("rates", [self.x, self.p], [rates])(*self._given[:2])

    @cached_property
    def _first(self) -> tuple[Any, Any, Any, Any, Any, Any]:
        """Values at all positions and their derivatives by x (values * positions, n); objective, gradient, rows, Jacobian."""
        x, p, given = self._given
        values, by_own, by_angle = self._everywhere.slopes(*given)
        z, width = values.T, values.shape[1]
        own = [casadi.vec(part.T) for part in casadi.horzsplit(by_own, width)] if self.local else []
        others = [casadi.vec(casadi.mtimes(casadi.diag(rate), by_angle).T) for rate in casadi.horzsplit(self._rates)]
        by_x = casadi.horzcat(*own, *others)
        f, f_x, f_z = self._parts(self.f, z)
        g, g_x, g_z = self._parts(self.g, z)
        gradient = casadi.densify(f_x + casadi.mtimes(f_z, by_x) if f_z.nnz() else f_x).T
        depends = casadi.Function("rows", [x, p], [self.programme["g"]]).jac_sparsity(0, 0)
        return z, by_x, f, gradient, casadi.densify(g), casadi.project(g_x + casadi.mtimes(g_z, by_x), depends)

    def _parts(self, expression: Any, z: Any) -> list[Any]:
        """Return an expression and its derivatives by x and by z."""
        return self._evaluated(
            [expression, casadi.jacobian(expression, self.x), casadi.jacobian(expression, casadi.vec(self.z))], z
        )

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
        angles = casadi.Function("angles", [self.x, self.p, weights], [turned])(x, p, by_angle.T)
        chained = casadi.vertcat(casadi.MX.eye(count), by_x)
        total = casadi.mtimes([chained.T, bend, chained]) + found + angles
        return casadi.Function("hessian", [x, p, *symbols], [casadi.triu(casadi.densify(total))])

    def _bent(self, given: list[Any], prices: Any) -> tuple[Any, Any]:
        """Return the second derivatives by x of all values times their prices, and the derivatives of these by the angles."""
        by_own, by_both, by_angles, by_angle = self._everywhere.curvatures(*given, prices.T)
        mixed = casadi.mtimes(by_both.T, self._rates)
        own = casadi.reshape(casadi.sum1(by_own), self.local, self.local)
        others = casadi.mtimes([self._rates.T, casadi.diag(by_angles), self._rates])
        return casadi.vertcat(casadi.horzcat(own, mixed), casadi.horzcat(mixed.T, others)), by_angle

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


@dataclass(frozen=True)
class _Everywhere:
    """A function of one position and its derivatives, evaluated at all positions; the results have a row for each."""

    inputs: list[Any]
    outputs: Any
    own: Any
    angle: Any
    positions: int

    def _made(self, inputs: list[Any], outputs: list[Any]) -> Any:
        return elementwise(casadi.Function("one", inputs, outputs), 2, self.positions)

    @cached_property
    def values(self) -> Any:
        return self._made(self.inputs, [self.outputs])

    @cached_property
    def slopes(self) -> Any:
        """Values, their derivatives by the own components of x (a column after the other) and by the angle."""
        by = [casadi.jacobian(self.outputs, one) for one in (self.own, self.angle)]
        return self._made(self.inputs, [self.outputs, *by])

    @cached_property
    def curvatures(self) -> Any:
        """Second derivatives of the values times their prices, the last input: by own components, by one and the angle, by the
        angle; derivative by the angle."""
        price, count = casadi.SX.sym("price", self.outputs.shape[0]), self.own.shape[0]
        bent, slope = casadi.hessian(casadi.dot(price, self.outputs), casadi.vertcat(self.own, self.angle))
        parts = [bent[:count, :count], bent[:count, count], bent[count, count], slope[count]]
        return self._made([*self.inputs, price], parts)
