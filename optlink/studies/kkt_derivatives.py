"""Derivatives of a design and its multipliers by parameters from the KKT system, and their range of validity.

At an optimum the gradient of the Lagrangian vanishes and the active limits are satisfied; the implicit function theorem gives the
derivatives of design and multipliers by any parameter of that system from exact second derivatives and one linear system,
without a search. The derivative of the objective is that of the Lagrangian. Both hold until a multiplier vanishes or another
limit becomes active.

References
----------
A. V. Fiacco, Introduction to Sensitivity and Stability Analysis in Nonlinear Programming (1983), ch. 3.
"""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Self

import casadi
import numpy as np
from numpy.typing import NDArray

from optlink.linkage.vector2d import TURN, Array
from optlink.optimization.multipliers import MultiplierSet
from optlink.optimization.nlp import NLP
from optlink.problem.design import EPIGRAPH
from optlink.problem.document import Number
from optlink.solvers.solution import STATIONARY, Solution, Stationarity, stationarity
from optlink.studies.parameters import Parameter
from optlink.symbolic import CompiledFunction

ACTIVE_TOLERANCE = 1e-9  # scaled units; tolerance of active limits, less than the distance of neighbours in a finely divided span
MIN_MULTIPLIER = 1e-8  # relative to the scale of the objective; smaller multipliers count as zero
MIN_RATE = 1e-11  # scaled units; slower changes are rounding errors
MIN_CHANGE = 1e-10  # scaled units, or of a multiplier, per change of a parameter by its value; slower ones end no range
MIN_CURVATURE = 1e-10  # relative to the largest second derivative; smaller ones are rounding errors
DUPLICATE_SLOPE = 1e-6  # relative difference of the slopes of duplicate rows
SINGULAR = 1e-11  # relative to the largest singular value of the system; smaller ones are zero
MIN_SHARE = 1e-6  # component of an undetermined direction; smaller ones are rounding errors
LIMIT_EVENTS = "is no longer active", "is reached"
PEAK_EVENTS = "no longer determines the objective", "determines the objective"
"""Ends of the validity at a limit, and at one of the values of which the objective is the largest."""


@dataclass(frozen=True)
class ValidityEnd:
    """End of the first-order validity: at `value` of the parameter, because of `event`; infinite if unlimited."""

    value: Number
    event: str


@dataclass(frozen=True)
class KKTPerturbation:
    """Change of the optimality system per unit of a parameter at fixed unknowns.

    `slope`: of the Lagrangian; `gradient` (unknowns,): of its derivatives by the unknowns; `entries` (n + rows,): of x and the
    rows; `lower`, `upper` (n + rows,): of their bounds.
    """

    slope: float
    gradient: Array
    entries: Array
    lower: Array
    upper: Array


@dataclass(frozen=True)
class KKTResponse:
    """Response to one unit of a parameter: change of the objective [SI], of the unknowns and of the multipliers."""

    objective: float
    moved: Array
    multipliers: Array


def _lagrangian(nlp: NLP, x: Array, p: Array, prices: Array) -> tuple[Array, Array, Array]:
    """Return Hessian and gradient of f + prices . g by (x, p), and the Jacobian of g; compiled once for a programme."""
    if "lagrangian" not in nlp.cache:
        variables = casadi.vertcat(nlp.x_symbol, nlp.p_symbol)
        symbols = casadi.SX.sym("prices", len(nlp.rows))
        hessian, gradient = casadi.hessian(nlp.f_expression + casadi.dot(symbols, nlp.g_expression), variables)
        inputs = [nlp.x_symbol, nlp.p_symbol, symbols]
        nlp.cache["lagrangian"] = CompiledFunction(inputs, [hessian, gradient, casadi.jacobian(nlp.g_expression, variables)])
    hessian, gradient, jacobian = nlp.cache["lagrangian"](x, p, prices)
    size = len(gradient)
    return hessian.reshape(size, size), gradient, jacobian.reshape((len(prices), size), order="F")


class KKTSystem:
    """The optimality system at a solution: its active set, and its response to parameters.

    `unknown`: indices in (x, p) of the unknowns, x first, then positions of the largest error or force, which move along;
    `several`: whether several designs or multipliers satisfy the system; `loose`: indices of crank angles that it leaves open.
    """

    def __init__(self, solution: Solution, conditions: Stationarity | None = None) -> None:
        nlp, x, p = solution.nlp, solution.x, solution.p
        self.solution = solution
        self.nlp, self.x, self.p, self.price = nlp, x, p, solution.price
        n, m = len(x), len(nlp.rows)
        point = nlp.at(x, p)
        conditions = conditions or stationarity(nlp, x, point, ACTIVE_TOLERANCE)
        if conditions.kkt > max(STATIONARY, solution.kkt):
            conditions = solution.conditions
        self.equal = nlp.lower == nlp.upper
        strong = [i for i in conditions.active if self.equal[i] or abs(conditions.multipliers[i]) > MIN_MULTIPLIER]
        self.multipliers = np.zeros(n + m)
        self.multipliers[strong] = conditions.multipliers[strong]
        self.multiplier_set = MultiplierSet.of(nlp, x, point, self.multipliers)
        self.values = np.concatenate([x, point.g])
        hessian, gradient, rows = _lagrangian(nlp, x, p, self.multipliers[n:])
        slopes = np.vstack([np.eye(n, n + len(p)), rows])  # derivatives of x and the rows by x and p
        self.active = self._distinct(strong, slopes[:, :n])
        self.duplicates = set(strong) - set(self.active.tolist())
        if len(self.active) < len(strong):
            hessian, gradient, _ = _lagrangian(nlp, x, p, self.multipliers[n:])
        self.by_p = gradient[n:]
        # such positions are determined by the vanishing slope of the quantity that is largest there
        first, bend = len(p) - nlp.exchange_count, float(np.max(np.abs(hessian), initial=1.0))
        exchange = [n + k for k in range(first, len(p)) if abs(hessian[n + k, n + k]) > MIN_CURVATURE * bend and p[k] != 0.0]
        exchange = [k for k in exchange if abs(gradient[k]) <= 1e-4 * abs(hessian[k, k])]
        self.unknown = np.array([*range(n), *exchange], dtype=int)
        self.free, self.count = n, len(self.unknown)
        self.jacobian, self.hessian = slopes, hessian
        jacobian_active = slopes[self.active][:, self.unknown]
        self.matrix = np.block(
            [
                [hessian[np.ix_(self.unknown, self.unknown)], jacobian_active.T],
                [jacobian_active, np.zeros((len(jacobian_active), len(jacobian_active)))],
            ]
        )
        _, singular, axes = np.linalg.svd(self.matrix)
        undetermined = axes[singular <= SINGULAR * singular[0]]
        self.singular = bool(len(undetermined))
        # crank angles of points that do not count may be any: they belong to the same design
        states = np.array([name.name in nlp.helpers for name in nlp.variables])
        loose = np.any(np.abs(undetermined[:, :n]) > MIN_SHARE, axis=0) if self.singular else np.zeros(n, dtype=bool)
        self.loose = np.flatnonzero(loose & states)
        others = np.delete(undetermined, self.loose, axis=1)
        self.several = self.singular and bool(np.any(np.abs(others) > MIN_SHARE))

    def _distinct(self, strong: list[int], slopes: Array) -> NDArray[np.int_]:
        """Return the active entries without duplicate rows, as where two positions coincide; their multipliers are added."""
        distinct: list[int] = []
        for entry in strong:
            duplicate = next((k for k in distinct if self._alike(entry, k, slopes)), None)
            if duplicate is None:
                distinct.append(entry)
            else:
                self.multipliers[duplicate] += self.multipliers[entry]
                self.multipliers[entry] = 0.0
        return np.array(distinct, dtype=int)

    def _alike(self, entry: int, other: int, slopes: Array) -> bool:
        n = len(self.x)
        if entry < n or other < n:
            return False
        first, second = self.nlp.rows[entry - n], self.nlp.rows[other - n]
        if (first.limit, first.low, first.high) != (second.limit, second.low, second.high):
            return False
        return bool(np.max(np.abs(slopes[entry] - slopes[other])) <= DUPLICATE_SLOPE * np.max(np.abs(slopes[entry])))

    def push(self, parameter: Parameter) -> KKTPerturbation:
        """Return the effect of a parameter of the programme: a fixed quantity, or a bound."""
        rate, size = parameter.rate(), len(self.values)
        slope, gradient, entries = 0.0, np.zeros(self.count), np.zeros(size)
        if parameter.constant >= 0:
            column = self.free + 1 + parameter.constant
            slope = self.by_p[1 + parameter.constant] * rate
            gradient = self.hessian[self.unknown, column] * rate
            entries = self.jacobian[:, column] * rate
        lower, upper = np.zeros(size), np.zeros(size)
        indices = list(parameter.entries)
        lower[indices] += rate * (parameter.equal or not parameter.upper)
        upper[indices] += rate * (parameter.equal or parameter.upper)
        return KKTPerturbation(float(slope), gradient, entries, lower, upper)

    def beside(self, push: KKTPerturbation) -> Self | None:
        """Return the system with the multipliers that apply if a parameter is increased; None if the problem is then infeasible.

        It is another one where active limits depend on one another: the derivatives then differ between the two directions.
        """
        change = np.where(self.multiplier_set.sign + np.sign(self.multipliers) > 0.0, push.upper, push.lower) - push.entries
        if not self.multiplier_set.directions.size or not self.multiplier_set.changes(change):
            return self
        value, multipliers = self.multiplier_set.least(change)
        if not math.isfinite(value):
            return None
        return type(self)(self.solution, Stationarity(multipliers, np.flatnonzero(multipliers).tolist(), 0.0))

    def response(self, push: KKTPerturbation) -> KKTResponse:
        """Return the response of the optimum to a change of the optimality system."""
        size = len(self.values)
        bounds = np.where(self.multipliers > 0.0, push.upper, push.lower)
        slope = push.slope - float(self.multipliers[self.active] @ bounds[self.active])
        right = np.concatenate([-push.gradient, (bounds - push.entries)[self.active]])
        solved: Array = np.zeros(len(right))
        if np.any(right):
            if self.singular:
                solved = np.asarray(np.linalg.lstsq(self.matrix, right, rcond=1e-11)[0], dtype=float)
            else:
                solved = np.linalg.solve(self.matrix, right)
        multipliers = np.zeros(size)
        multipliers[self.active] = solved[self.count :]
        return KKTResponse(slope * self.price, solved[: self.count], multipliers)

    def ends(self, parameter: Parameter, push: KKTPerturbation, response: KKTResponse) -> tuple[ValidityEnd, ValidityEnd]:
        """Return the first-order range of a parameter, until a multiplier vanishes or another limit becomes active."""
        rates = self.jacobian[:, self.unknown] @ response.moved + push.entries
        least, most = (-math.inf, "nothing"), (math.inf, "nothing")
        slowest = MIN_CHANGE / (abs(parameter.value) or 1.0)
        rows, rooms = set(self.active.tolist()), self.rooms
        for entry in range(len(rates)):
            if entry in self.unlimited - rows and push.lower[entry] == push.upper[entry] == 0.0:
                continue
            if entry not in rows and np.any(self.jacobian[entry, self.loose]):
                continue
            events = []
            peak = entry >= self.free and self.nlp.rows[entry - self.free].limit == EPIGRAPH  # of an objective, not a limit
            leaves, arrives = PEAK_EVENTS if peak else LIMIT_EVENTS
            if entry in rows:
                change = response.multipliers[entry]
                if not self.equal[entry] and abs(change) > slowest * abs(self.multipliers[entry]):
                    events.append((-self.multipliers[entry] / change, leaves))
            else:
                changes = push.upper[entry] - rates[entry], rates[entry] - push.lower[entry]
                for room, change in zip(rooms[:, entry], changes, strict=True):
                    if math.isfinite(room) and abs(change) > slowest and entry not in self.duplicates:
                        events.append((-(room if room > ACTIVE_TOLERANCE else 0.0) / change, arrives))
            for at, what in events:  # a limit at its bound with a zero multiplier: a zero with the sign of the side that it ends
                if math.copysign(1.0, at) < 0.0:
                    least = max(least, (at, f"{self._name(entry)} {what}"), key=lambda end: end[0])
                else:
                    most = min(most, (at, f"{self._name(entry)} {what}"), key=lambda end: end[0])
        ends = ((parameter.shifted(at), event) for at, event in (least, most))
        lower, upper = (ValidityEnd(value, event if math.isfinite(value) else "nothing") for value, event in ends)
        return lower, upper

    @cached_property
    def unlimited(self) -> set[int]:
        """Entries that do not limit: bounds of unrestricted angles, one revolution apart, and those of the events of a cycle."""
        indices = {k for k, variable in enumerate(self.nlp.variables) if variable.name in self.nlp.states}
        for k, (variable, low, high) in enumerate(zip(self.nlp.variables, self.nlp.x_low, self.nlp.x_high, strict=True)):
            width = variable.size * (high - low)
            if variable.name not in self.nlp.helpers and variable.scale.unit == "deg" and width >= TURN - 1e-9:
                indices.add(k)
        return indices

    @cached_property
    def rooms(self) -> Array:
        """Distances (2, n + rows) to the upper and lower bounds; infinite away from the peaks of a limit over a motion.

        To first order such a limit changes with its peaks only: near a moving peak a linear prediction exceeds it.
        """
        rooms = np.array([self.nlp.upper - self.values, self.values - self.nlp.lower])
        limits: dict[tuple[str, str, float, float], list[int]] = {}
        for k, row in enumerate(self.nlp.rows):
            if row.periodic is not None:
                limits.setdefault((row.limit, row.label, row.low, row.high), []).append(k)
        symbols = [self.nlp.x_symbol, self.nlp.p_symbol]
        places = CompiledFunction(symbols, [self.nlp.place_expression])(self.x, self.p)[0] if limits else np.empty(0)
        for peak_rows in limits.values():
            periodic = self.nlp.rows[peak_rows[0]].periodic
            order = np.argsort(places[peak_rows] % TURN if periodic else places[peak_rows])
            entries = self.free + np.array(peak_rows)[order]
            near = np.pad(rooms[:, entries], ((0, 0), (1, 1)), "wrap" if periodic else "edge")
            off_peak = rooms[:, entries] > np.minimum(near[:, :-2], near[:, 2:]) + MIN_RATE
            rooms[:, entries] = np.where(off_peak, math.inf, rooms[:, entries])
        return rooms

    def _name(self, entry: int) -> str:
        if entry < self.free:
            variable = self.nlp.variables[entry]
            return f"the bound of {variable.name}"
        return self.nlp.rows[entry - self.free].label
