"""The parameters of an optimum, and the optima at changed values, found by a new search or from a changed file.

Dimensions and limits are parameters of the programme. Masses, loads, friction, speed and gravity of a machine enter its formulas:
the programme is built again with a slightly larger and smaller value of each; central differences of the optimality system at the
optimum give their effect.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Annotated, Any, Self, TypeVar

import casadi
import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, Field

from optlink.errors import InputError
from optlink.linkage.vector2d import TURN, Array, Value, max_magnitude
from optlink.optimization.courses import TermCourse, course_again
from optlink.optimization.cycle_signals import TracedCycle
from optlink.optimization.multipliers import MultiplierSet
from optlink.optimization.nlp import NLP
from optlink.optimization.programme import build
from optlink.optimization.terms import Scale, SIScale
from optlink.problem.design import EPIGRAPH, DesignProblem
from optlink.problem.document import Number
from optlink.problem.file import SIDES, ProblemFile
from optlink.problem.limits import MARGIN_KEYS
from optlink.problem.quantity import Interval, Quantity, file_key
from optlink.solvers import multistart
from optlink.solvers.contract import CLOSE
from optlink.solvers.exchange import sharpened
from optlink.solvers.solution import STATIONARY, Solution, Stationarity, stationarity
from optlink.studies.batch_optima import follow_optimum
from optlink.studies.grid import Axis, exact_text, read_figure
from optlink.studies.target_programme import TargetProgramme, variables_of
from optlink.symbolic import CompiledFunction
from optlink.units import UnitProblem, factor, in_si

# Parameters of an optimum: fixed quantities, and all bounds and limits, in display units.

ROUNDING = 1e-14  # of a scaled quantity: smaller values count as zero
SHARE = 0.01
"""Step of a length or a plain number by which effects are compared, as a share of its value; that of an angle is 1 deg."""


ANGULAR = {"deg": 1.0, "rad": math.radians(1.0)}
"""A degree in the units of angles."""


@dataclass(frozen=True)
class Parameter:
    """One parameter.

    `value` in `unit`; `constant`: its index among the fixed quantities of the programme, else -1; `entries`:
    indices in x, then in the rows, whose lower or `upper` bound it is (both for a prescribed value: `equal`).
    """

    key: str
    name: str
    value: Number
    unit: str
    scale: Annotated[Scale, Field(exclude=True)] = field(default=Scale(""), compare=False)  # of the programme
    constant: int = -1
    entries: tuple[int, ...] = ()
    upper: bool = False
    equal: bool = False
    in_file: bool = True  # whether the problem file contains this number, so that it can be changed there

    @property
    def kind(self) -> str:
        """Kind of the parameter, in words."""
        return "limit" if self.entries else "fixed quantity"

    @property
    def positive(self) -> bool:
        """Whether it is a mass, a force, a tolerance or another positive number that cannot or should not change its sign."""
        outside = self.constant < 0 and not self.entries
        return self.value > 0.0 and ((outside and self.unit not in ANGULAR) or self.key.startswith("tolerances."))

    @property
    def step(self) -> float:
        """Reference change for the comparison of effects: 1 deg of an angle, else 1 % of the value (0.01 of a zero)."""
        return ANGULAR.get(self.unit) or SHARE * (self.value or 1.0)

    @property
    def in_si(self) -> Parameter:
        """The same parameter in SI."""
        size, unit = in_si(self.unit)
        return replace(self, value=self.value * size, unit=unit, scale=SIScale.of(self.scale))

    def rate(self) -> float:
        """Return the change of the scaled number of the programme per unit of the parameter."""
        return 1.0 / self.scale.slope(self.scale.to_internal(self.value))

    def shifted(self, change: float) -> float:
        """Return the value after a first-order change [unit] of the number of the programme; infinite if it has no such value."""
        internal = self.scale.to_internal(self.value) + self.rate() * change
        value = float(self.scale.to_display(internal))
        exists = math.isclose(self.scale.to_internal(value), internal, rel_tol=1e-9, abs_tol=1e-9)
        return value if exists else math.copysign(math.inf, change)

    def place(self, nlp: NLP, value: float) -> None:
        """Set another value of the parameter in the programme.

        Parameters
        ----------
        nlp : NLP
        value : float
            In its unit.
        """
        internal = self.scale.to_internal(value)
        if self.constant >= 0:
            nlp.p[1 + self.constant] = internal
        for entry in self.entries:
            nlp.limit(entry, internal if self.equal or not self.upper else None, internal if self.equal or self.upper else None)


def displayed(nlp: NLP, x: Sequence[float] | NDArray[np.float64]) -> dict[str, float]:
    """Return the design variables (no auxiliary variables) in display units."""
    return {v.name: v.scale.to_display(float(value)) for v, value in design_variables(nlp, x)}


def design_variables(nlp: NLP, x: Sequence[float] | NDArray[np.float64]) -> list[tuple[Any, float]]:
    """Return the design variables (no auxiliary variables) of a programme with their scaled values."""
    return [(v, float(value)) for v, value in zip(nlp.variables, x, strict=False) if v.name not in nlp.helpers]


QUANTITIES = ("mechanism.", "requirement.from", "requirement.psi0", "requirement.start", "requirement.mark", "requirement.zero")
"""Beginnings of the keys of quantities; rows with such a key are the bounds of linked ones."""
GENERAL = ("limits.transmission_angle", "limits.pressure_angle")
"""Keys of limits with one value for several joints, whose rows are labelled "... at JOINT"."""


def parameters(nlp: NLP) -> list[Parameter]:
    """Return all fixed quantities, then all finite bounds of design variables and limits.

    Rows that share a limit and a label are one limit, with one bound; so are those of one value for several joints.
    """
    result = [
        Parameter(c.key or c.name, c.name, _displayed(float(nlp.p[1 + i]), c.scale), c.scale.unit, c.scale, constant=i)
        for i, c in enumerate(nlp.constants)
    ]
    n = len(nlp.variables)
    entries = [(v.key or v.name, v.name, i, v.scale) for i, v in enumerate(nlp.variables) if v.name not in nlp.helpers]
    entries += [(row.limit, row.label, n + j, row.scale) for j, row in enumerate(nlp.rows) if row.limit not in nlp.helpers]
    limits: dict[tuple[str, str, str, float], Parameter] = {}
    for key, name, entry, scale in entries:
        low, high = float(nlp.lower[entry]), float(nlp.upper[entry])
        for upper, bound in ((False, low), (True, high)):
            if not math.isfinite(bound) or (upper and low == high) or (scale.cosine and abs(bound) >= 1.0):
                continue
            side = "" if low == high else "max" if upper != scale.cosine else "min"
            what, _, joint = name.partition(" at ") if key in GENERAL else (name, "", "")
            mark = (key, what, side, bound)
            if mark in limits:
                limit = limits[mark]
                label = limit.name if joint in limit.name.split(" at ")[-1].split(", ") or not joint else f"{limit.name}, {joint}"
                limits[mark] = replace(limit, name=label, entries=(*limit.entries, entry))
                continue
            own = entry < n or key.startswith(QUANTITIES)
            whole = key in ("limits.crank", *MARGIN_KEYS) or key.endswith(".clearance")  # of one value, not of a range
            prescribed = own or key.endswith(".value") or (key.startswith("limits.") and not whole)
            bounds = f"{name}, {'largest' if side == 'max' else 'smallest'} allowed" if own else name
            limit_key = f"{key}.{side}" if side and prescribed else key
            limits[mark] = Parameter(
                limit_key, bounds, _displayed(bound, scale), scale.unit, scale, -1, (entry,), upper, not side, prescribed
            )
    return result + list(limits.values())


def _displayed(internal: float, scale: Scale) -> float:
    """Return a number of the programme in display units, without rounding errors of scaling."""
    value, size = scale.to_display(internal), abs(scale.to_display(1.0) - scale.to_display(0.0))
    digits = 12 if scale.cosine else 14  # that of 1 deg has 12: 0.9999999999999 deg was shown
    return 0.0 if abs(value) <= ROUNDING * size else float(f"{value:.{digits}g}")


# Derivatives of a design and its multipliers by parameters from the KKT system, and their range of validity.
#
# At an optimum the gradient of the Lagrangian vanishes and the active limits are satisfied; the implicit function theorem gives
# the derivatives of design and multipliers by any parameter of that system from exact second derivatives and one linear system,
# without a search. The derivative of the objective is that of the Lagrangian. Both hold until a multiplier vanishes or another
# limit becomes active.
#
# References
# ---------- A. V. Fiacco, Introduction to Sensitivity and Stability Analysis in Nonlinear Programming (1983), ch. 3.

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
        return bool(max_magnitude(slopes[entry] - slopes[other]) <= DUPLICATE_SLOPE * np.max(np.abs(slopes[entry])))

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


SECTIONS = ("bodies", "loads")  # joint parameters do not affect an ideal machine
SINGLE_KEYS = ("drive.speed", "gravity")
STEP = 1e-4  # relative step of central differences: most parameters enter linearly, the speed by its square
ANGLE_STEP = 0.01  # step of an angle of 0, in its unit
TABLE_UNIT = "%"  # unit of a table whose values are scaled together
CLOSE_BY = 1e-2  # scaled units: how far an optimum may move by a step of a difference in the first round
Optimum = tuple[float, dict[str, float]]
"""Objective [SI] and design variables in display units."""


class OptimumParameters:
    """The parameters of an optimum, which are those of its programme, and the optima at changed values.

    `share`, `most`: step of central differences relative to the value, and its largest share of the range of validity.
    """

    share, most = 3e-5, 0.4

    def __init__(self, problem: ProblemFile, system: KKTSystem) -> None:
        self.problem, self.system, self.nlp = problem, system, system.nlp

    @staticmethod
    def refined(solution: Solution) -> Solution:
        """Return an optimum with all digits."""
        return solution

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes on the derivatives."""
        return ()

    @cached_property
    def parameters(self) -> list[Parameter]:
        """All parameters, with the keys of the problem file."""
        return parameters(self.nlp)

    def push(self, parameter: Parameter) -> KKTPerturbation:
        """Return the change of the optimality system per unit of a parameter."""
        return self.system.push(parameter)

    def optimum_at(self, solution: Solution, parameter: Parameter, value: float, backend: str) -> Optimum | None:
        """Return the optimum with another value of a parameter; None if there is none, or a different one is found."""
        nlp = solution.nlp
        try:
            parameter.place(nlp, value)
            followed = follow_optimum(nlp, solution)  # has more digits where the search ends near many peaks of equal height
            optimum = multistart.best([multistart.solve_from(nlp, solution.x, backend), *([followed] if followed else [])])
        finally:
            parameter.place(nlp, parameter.value)
        return optimum.objective, displayed(nlp, optimum.x)


class TargetParameters(OptimumParameters):
    """The parameters of a design, whose file is read, built and optimised again near it with another value.

    The largest error and limits hold between the positions of the programme again. Where the programme has quantities of the
    machine, masses, loads, speed and gravity are parameters too.
    """

    @cached_property
    def parameters(self) -> list[Parameter]:
        """Parameters of the programme, then those that enter its formulas."""
        own = [replace(parameter, key=key) for parameter in parameters(self.nlp) if (key := self._key(parameter))]
        return [*own, *(_figures(self.problem) if self.nlp.terms is not None else ())]

    def _key(self, parameter: Parameter) -> str:
        return parameter.key

    def optimum_at(self, solution: Solution, parameter: Parameter, value: float, backend: str) -> Optimum | None:
        """Return the optimum with another value; see `OptimumParameters.optimum_at`."""
        if not parameter.in_file:
            return super().optimum_at(solution, parameter, value, backend)
        changed, recipe = self.changed(parameter, value).spec, solution.nlp.recipe
        programme = TargetProgramme(changed, recipe["direction"], backend, terms=course_again(changed, recipe))
        optimum = programme.optimum(changed, variables_of(solution), CLOSE_BY)
        optimum = optimum if optimum.usable else programme.optimum(changed, variables_of(solution))
        optimum = sharpened(changed, optimum, backend) if optimum.usable else optimum
        return (optimum.objective, displayed(programme.nlp, optimum.x)) if optimum.usable else None

    def push(self, parameter: Parameter) -> KKTPerturbation:
        """Return the change of the optimality system per unit of a parameter."""
        if parameter.constant >= 0 or parameter.entries:
            return self.system.push(parameter)
        step = STEP * abs(parameter.value) or ANGLE_STEP
        (low, below, under), (high, above, over) = (
            self._perturbed(parameter, parameter.value + change) for change in (-step, step)
        )
        still = np.zeros(len(self.system.values))
        entries = still.copy()
        entries[self.system.free :] = (over - under) / (2.0 * step)
        return KKTPerturbation(
            (high - low) / (2.0 * step), (above - below)[self.system.unknown] / (2.0 * step), entries, still, still
        )

    def changed(self, parameter: Parameter, value: float) -> ProblemFile:
        """Return the problem with another value of a parameter."""
        stated, written = self.problem.at(parameter.key), exact_text(value, parameter.unit)
        if parameter.unit == TABLE_UNIT:
            pairs, share = [read_figure(text) for text in stated], value / parameter.value
            return self.problem.override({parameter.key: [exact_text(component * share, unit) for component, unit in pairs]})
        ends = stated if isinstance(stated, Mapping) else {}
        sides = [f".{end}" for end in ("exactly", "min", "max") if end in ends and parameter.equal] or [""]
        return self.problem.override({f"{parameter.key}{side}": written for side in sides})

    def _perturbed(self, parameter: Parameter, value: float) -> tuple[float, Array, Array]:
        """Return the Lagrangian, its gradient by (x, p) and the rows at the optimum, with another value in the file."""
        system, nlp = self.system, self.nlp
        task, terms = self.changed(parameter, value).spec, nlp.terms
        trace = terms.trace and TracedCycle(task, slow=terms.trace.slow)
        course = TermCourse(task, nlp.design(system.x), trace, terms.structure, terms.count, terms.sizes)
        perturbed = build(task, nlp.recipe["direction"], terms=course)
        if [row.label for row in perturbed.rows] != [row.label for row in nlp.rows]:
            message = "at a neighbouring value the motions reverse in another order"
            raise InputError(message, "Change it with --set", self.problem.file, parameter.key)
        prices = casadi.DM(system.multipliers[system.free :])
        lagrangian = perturbed.f_expression + casadi.dot(prices, perturbed.g_expression)
        variables = casadi.vertcat(perturbed.x_symbol, perturbed.p_symbol)
        functions = CompiledFunction(
            [perturbed.x_symbol, perturbed.p_symbol], [lagrangian, casadi.gradient(lagrangian, variables), perturbed.g_expression]
        )
        value_, gradient, rows = functions(system.x, system.p)
        return float(value_[0]), gradient, rows


class CycleParameters(TargetParameters):
    """The parameters of a machine without a requirement.

    Its optima are less accurate than those of other programmes, and more strongly curved.
    """

    share, most = 3e-4, 0.02

    @staticmethod
    def refined(solution: Solution) -> Solution:
        """Return an optimum at the exact positions of its peaks."""
        return sharpened(solution.nlp.terms.problem, solution, CLOSE)

    @property
    def notes(self) -> tuple[str, ...]:
        """Note on the sign of a maximised quantity."""
        maximised = any(goal.sense == "maximise" for goal in self.nlp.terms.problem.goals)
        return ("a maximised quantity is listed with the opposite sign: its negative is minimised",) * maximised

    def _key(self, parameter: Parameter) -> str:
        """Return the key in the problem file; empty for a row that the file does not state."""
        entry = parameter.entries[0] if parameter.entries else 0
        side = "" if parameter.constant >= 0 else ".max" if parameter.upper else ".min"
        if parameter.constant < 0 and entry >= len(self.nlp.variables):
            limit = self.nlp.rows[entry - len(self.nlp.variables)].limit
            if not limit.startswith(("limits.", "requirement.", "mechanism.")) or limit in MARGIN_KEYS:
                return ""
            value = self.problem.at(limit)
            exactly = isinstance(value, Mapping) and "exactly" in value
            return f"{limit}.exactly" if exactly else limit if parameter.equal else f"{limit}{side}"
        name = parameter.name if parameter.constant >= 0 else self.nlp.variables[entry].name
        if name not in self.problem.model.mechanism.quantities:
            return f"{parameter.key}{side}"
        return file_key(self.problem.raw["mechanism"], name) + side


def _figures(problem: ProblemFile) -> list[Parameter]:
    """Return all numbers of bodies and loads in the file, guide friction, the speed and gravity as parameters."""
    keys = [*(leaf for key in SINGLE_KEYS for leaf in _leaves(key, problem.at(key)))]
    for section in SECTIONS:
        keys += _leaves(section, problem.raw.get(section, {}))
    guides = problem.raw["mechanism"].get("guides", {})
    keys += [(f"mechanism.guides.{name}.friction", guide.get("friction")) for name, guide in guides.items()]
    figures = []
    for key, raw in keys:
        value, unit = (100.0, TABLE_UNIT) if isinstance(raw, list) else read_figure(raw)
        if value or _angular(unit):  # other zeros have no relative step
            name = key.removeprefix("mechanism.guides.").split(".", 1)
            short = name[-1] if name[0] in (*SECTIONS, "drive") else ".".join(name)
            figures.append(Parameter(key, short, value, unit, Scale(unit, 1.0)))
    return figures


def _leaves(key: str, raw: Any) -> Iterator[tuple[str, Any]]:
    """Yield keys with their numbers: the coordinates of a pair, the values of a table together."""
    if isinstance(raw, Mapping):
        for name, part in raw.items():
            yield from _leaves(f"{key}.{name}", part)
    elif isinstance(raw, list) and len(raw) == 2 and (key == "gravity" or key.endswith(".centroid")):
        names = ("x", "y") if key == "gravity" else ("along", "across")
        yield from ((f"{key}.{name}", part) for name, part in zip(names, raw, strict=True))
    elif not isinstance(raw, list) or (key.startswith("loads.") and key.endswith(".values") and any(map(_number, raw))):
        yield key, raw


def _number(raw: Any) -> float:
    return read_figure(raw)[0]


def _angular(unit: str) -> bool:
    try:
        return factor(unit, "angle") > 0.0
    except UnitProblem:
        return False


# Change numbers in the model of a problem without reading the file again, ten times faster for thousands of points.
#
# Valid only between values that were read and checked; results must equal those of `ProblemFile.override`.

M = TypeVar("M", bound=BaseModel)
Setter = Callable[[Any, float], Any]
"""(what a field holds, value [SI]) -> what it holds then"""

_FIELDS = {"from": "start"}  # fields of the requirement with a different key in the file


def copy_model(model: M, **update: object) -> M:
    """Return a copy of a checked model with other fields, without values cached from the old ones."""
    copy = model.model_copy(update=update)
    for name in set(vars(copy)) - set(type(copy).model_fields):
        del vars(copy)[name]
    return copy


class FastOverride:
    """Sets values of axes in the model of a problem; `possible` states whether all of them are plain numbers of the model."""

    def __init__(self, template: DesignProblem, axes: Sequence[Axis]) -> None:
        linked = bool(template.links)  # their values would have to follow
        self.template, self.places = template, [None if linked else _place(template, axis) for axis in axes]

    @property
    def possible(self) -> bool:
        """Whether every axis is a number of a section."""
        return all(place is not None for place in self.places)

    def model(self, values: Sequence[Value]) -> DesignProblem:
        """Return the model at values in the units of the axes, floats or arrays (points,)."""
        sections: dict[str, dict[str, Any]] = {}
        for place, value in zip(self.places, values, strict=True):
            assert place is not None
            section, name, setter, size = place
            changes = sections.setdefault(section, {})
            changes[name] = setter(changes.get(name, getattr(getattr(self.template, section), name)), value * size)
        return copy_model(self.template, **{s: copy_model(getattr(self.template, s), **fields) for s, fields in sections.items()})


def _place(template: DesignProblem, axis: Axis) -> tuple[str, str, Setter, float] | None:
    """Return section, field, setter, and SI units per unit of the axis."""
    section, *rest = axis.key.split(".")
    side = rest.pop() if rest and rest[-1] in SIDES else ""
    if section not in ("mechanism", "limits", "requirement") or not rest:
        return None
    name, *path = _FIELDS.get(rest[0], rest[0]), *rest[1:]
    value = getattr(getattr(template, section), name, None)
    for key in path:
        value = _inside(value, key)
    if isinstance(value, Quantity) and value.free == bool(side):
        setter = _bound(side) if side else (lambda q, v: replace(q, value=v))
        return section, name, _nested(path, setter), factor(axis.unit, value.kind)
    if isinstance(value, Interval) and not path:
        side = "max" if name == "pressure_angle" else side
        return section, name, _limit(side), factor(axis.unit, value.kind) if value.kind else 1.0
    return None


_PLACES = {"x": 0, "y": 1, "along": 0, "across": 1}  # coordinates in a place


def _inside(value: Any, key: str) -> Any:
    """Return an entry of a table, a section or a place; None if there is none."""
    if isinstance(value, tuple):
        return value[_PLACES[key]] if key in _PLACES else None
    return value.get(key) if isinstance(value, dict) else getattr(value, key, None)


def _nested(path: Sequence[str], setter: Setter) -> Setter:
    """Return a function that sets an entry of a nested table, and copies what contains it."""
    if not path:
        return setter
    key, inner = path[0], _nested(path[1:], setter)

    def outer(value: Any, number: float) -> Any:
        entry = inner(_inside(value, key), number)
        if isinstance(value, tuple):
            return tuple(entry if k == _PLACES[key] else part for k, part in enumerate(value))
        return {**value, key: entry} if isinstance(value, dict) else copy_model(value, **{key: entry})

    return outer


def _bound(side: str) -> Setter:
    return lambda q, v: replace(q, low=v) if side == "min" else replace(q, high=v)


def _limit(side: str) -> Setter:
    if not side:
        return lambda i, v: replace(i, low=v, high=v)
    return lambda i, v: replace(i, low=v) if side == "min" else replace(i, high=v)
