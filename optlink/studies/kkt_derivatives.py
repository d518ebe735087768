"""The optimality system at a design: how far everything moves with any number of it, and how far that holds.

At an optimum the gradient of the Lagrangian vanishes and the active limits are met; the implicit function theorem gives how the
design and the prices move with any number of that system (A. V. Fiacco, Introduction to Sensitivity and Stability Analysis in
Nonlinear Programming, 1983, ch. 3): exact second derivatives, one linear system, no search. The derivative of the objective is
that of the Lagrangian. Both hold until a price falls to zero or another limit is reached.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import casadi
import numpy as np
from numpy.typing import NDArray

from optlink.optimization.nlp import NLP
from optlink.solvers.solution import STATIONARY, Solution, stationarity
from optlink.studies.parameters import Parameter
from optlink.symbolic import Compiled

Array = NDArray[np.float64]
TIGHT = 1e-9  # scaled units; a limit this close is active: nearer than a neighbour of it in a finely divided span
STRONG = 1e-8  # of the objective's scale; a smaller price is none
STILL = 1e-11  # scaled units; a slower change is rounding
CURVED = 1e-10  # share of the largest second derivative below which one is rounding
SAME = 1e-6  # share of its slopes by which one of two equal rows may differ


@dataclass(frozen=True)
class End:
    """Where first-order reasoning ends: at `value` of the parameter, because of `event`; infinite where nothing ends it."""

    value: float
    event: str


@dataclass(frozen=True)
class Push:
    """What one unit of a parameter changes where everything else stays.

    `slope`: of the Lagrangian; `gradient` (unknowns,): of its derivatives by the unknowns; `entries` (n + rows,): of x and the
    rows; `lower`, `upper` (n + rows,): of their bounds.
    """

    slope: float
    gradient: Array
    entries: Array
    lower: Array
    upper: Array


@dataclass(frozen=True)
class Answer:
    """What follows from one unit of a parameter: change of the objective [SI], of the unknowns and of the multipliers."""

    objective: float
    moved: Array
    multipliers: Array


class _Lagrangian:
    """Second derivatives of a programme by its variables and its parameters, compiled once."""

    def __init__(self, nlp: NLP) -> None:
        both = casadi.vertcat(nlp.x_symbol, nlp.p_symbol)
        prices = casadi.SX.sym("prices", len(nlp.rows))
        whole = nlp.f_expression + casadi.dot(prices, nlp.g_expression)
        hessian, gradient = casadi.hessian(whole, both)
        inputs = [nlp.x_symbol, nlp.p_symbol, prices]
        self._call = Compiled(inputs, [hessian, gradient, casadi.jacobian(nlp.g_expression, both)])

    def __call__(self, x: Array, p: Array, prices: Array) -> tuple[Array, Array, Array]:
        """Hessian and gradient of f + prices . g by (x, p), and the Jacobian of g."""
        hessian, gradient, jacobian = self._call(x, p, prices)
        size = len(gradient)
        return hessian.reshape(size, size), gradient, jacobian.reshape((len(prices), size), order="F")


def lagrangian(nlp: NLP) -> _Lagrangian:
    """The second derivatives of a programme, made once."""
    if "lagrangian" not in nlp.cache:
        nlp.cache["lagrangian"] = _Lagrangian(nlp)
    return nlp.cache["lagrangian"]  # type: ignore[no-any-return]


class System:
    """The optimality system at a solution: what is active, and how everything answers to a push.

    `unknown`: places in (x, p) of what moves, x first, then positions of the largest error or force, which move along.
    """

    def __init__(self, solution: Solution) -> None:
        nlp, x, p = solution.nlp, solution.x, solution.p
        self.nlp, self.x, self.p, self.price = nlp, x, p, solution.price
        n, m = len(x), len(nlp.rows)
        point = nlp.at(x, p)
        proof = stationarity(nlp, x, point, TIGHT)
        if proof.kkt > max(STATIONARY, solution.kkt):
            proof = solution.proof
        self.equal = nlp.lower == nlp.upper
        strong = [i for i in proof.active if self.equal[i] or abs(proof.multipliers[i]) > STRONG]
        self.multipliers = np.zeros(n + m)
        self.multipliers[strong] = proof.multipliers[strong]
        self.values = np.concatenate([x, point.g])
        hessian, gradient, rows = lagrangian(nlp)(x, p, self.multipliers[n:])
        whole = np.vstack([np.eye(n, n + len(p)), rows])  # of x and the rows, by x and p
        self.active = self._distinct(strong, whole[:, :n])
        if len(self.active) < len(strong):
            hessian, gradient, _ = lagrangian(nlp)(x, p, self.multipliers[n:])
        self.by_p = gradient[n:]
        # such positions are held by the vanishing slope of what is largest there
        first, bend = 1 + len(nlp.constants), float(np.max(np.abs(hessian), initial=1.0))
        roaming = [n + k for k in range(first, len(p)) if abs(hessian[n + k, n + k]) > CURVED * bend and p[k] != 0.0]
        roaming = [k for k in roaming if abs(gradient[k]) <= 1e-4 * abs(hessian[k, k])]
        self.unknown = np.array([*range(n), *roaming], dtype=int)
        self.free, self.count = n, len(self.unknown)
        self.jacobian, self.hessian = whole, hessian
        held = whole[self.active][:, self.unknown]
        self.matrix = np.block([[hessian[np.ix_(self.unknown, self.unknown)], held.T], [held, np.zeros((len(held), len(held)))]])
        singular = np.linalg.svd(self.matrix, compute_uv=False)
        self.singular = bool(singular[-1] <= 1e-11 * singular[0])

    def _distinct(self, strong: list[int], slopes: Array) -> NDArray[np.int_]:
        """Those active entries that are not the same row once more, as where a position lies on another; their prices add up."""
        kept: list[int] = []
        for entry in strong:
            twin = next((k for k in kept if self._alike(entry, k, slopes)), None)
            if twin is None:
                kept.append(entry)
            else:
                self.multipliers[twin] += self.multipliers[entry]
                self.multipliers[entry] = 0.0
        return np.array(kept, dtype=int)

    def _alike(self, entry: int, other: int, slopes: Array) -> bool:
        n = len(self.x)
        if entry < n or other < n:
            return False
        one, two = self.nlp.rows[entry - n], self.nlp.rows[other - n]
        if (one.limit, one.low, one.high) != (two.limit, two.low, two.high):
            return False
        return bool(np.max(np.abs(slopes[entry] - slopes[other])) <= SAME * np.max(np.abs(slopes[entry])))

    def push(self, parameter: Parameter) -> Push:
        """What a parameter of the programme changes: a fixed quantity, or a bound."""
        rate, size = parameter.rate(), len(self.values)
        slope, gradient, entries = 0.0, np.zeros(self.count), np.zeros(size)
        if parameter.constant >= 0:
            column = self.free + 1 + parameter.constant
            slope = self.by_p[1 + parameter.constant] * rate
            gradient = self.hessian[self.unknown, column] * rate
            entries = self.jacobian[:, column] * rate
        lower, upper = np.zeros(size), np.zeros(size)
        own = list(parameter.entries)
        lower[own] += rate * (parameter.equal or not parameter.upper)
        upper[own] += rate * (parameter.equal or parameter.upper)
        return Push(float(slope), gradient, entries, lower, upper)

    def answer(self, push: Push) -> Answer:
        """How the optimum answers."""
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
        return Answer(slope * self.price, solved[: self.count], multipliers)

    def ends(self, parameter: Parameter, push: Push, answer: Answer) -> tuple[End, End]:
        """How far a parameter can go, to first order, until a price falls to zero or another limit is reached."""
        rates = self.jacobian[:, self.unknown] @ answer.moved + push.entries
        least, most = (-math.inf, "nothing"), (math.inf, "nothing")
        held = set(self.active.tolist())
        for entry in range(len(rates)):
            events = []
            if entry in held:
                change = answer.multipliers[entry]
                if not self.equal[entry] and abs(change) > STILL * abs(self.multipliers[entry]):
                    events.append((-self.multipliers[entry] / change, "lets go"))
            else:
                for room, change in (
                    (self.nlp.upper[entry] - self.values[entry], push.upper[entry] - rates[entry]),
                    (self.values[entry] - self.nlp.lower[entry], rates[entry] - push.lower[entry]),
                ):
                    if math.isfinite(room) and abs(change) > STILL:
                        events.append((-max(room, 0.0) / change, "is reached"))
            for at, what in events:
                if at == 0.0 and what == "is reached":  # a limit that is touched without a price ends one side at once
                    continue
                if 0.0 <= at < most[0]:
                    most = (at, f"{self._name(entry)} {what}")
                if least[0] < at <= 0.0:
                    least = (at, f"{self._name(entry)} {what}")
        return End(float(parameter.value + least[0]), least[1]), End(float(parameter.value + most[0]), most[1])

    def _name(self, entry: int) -> str:
        if entry < self.free:
            variable = self.nlp.variables[entry]
            return f"the bound of {variable.name}"
        return self.nlp.rows[entry - self.free].label
