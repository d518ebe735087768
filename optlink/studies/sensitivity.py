"""What one more costs: derivatives of an optimum by everything that is given, and how far they hold.

At an optimum the gradient of the Lagrangian vanishes and the active limits are met; the implicit function theorem gives how the
design and the prices move with any number of that system (A. V. Fiacco, Introduction to Sensitivity and Stability Analysis in
Nonlinear Programming, 1983, ch. 3): exact second derivatives, one linear system, no search. The derivative of the objective is
that of the Lagrangian. Both hold until a price falls to zero or another limit is reached.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import casadi
import numpy as np
from numpy.typing import NDArray

from optlink.design.files import ProblemFile
from optlink.design.nlp import NLP
from optlink.design.problem import DesignProblem
from optlink.documents import finite, head
from optlink.errors import Fault, InputError, Status
from optlink.solvers.solution import STATIONARY, Solution, stationarity
from optlink.studies.keys import begun, text
from optlink.studies.parameters import Parameter, parameters
from optlink.symbolic import Compiled

Array = NDArray[np.float64]
SCHEMA = "optlink/sensitivity/1"
TIGHT = 1e-9  # scaled units; a limit this close is active: nearer than a neighbour of it in a finely divided span
STRONG = 1e-8  # of the objective's scale; a smaller price is none
STILL = 1e-11  # scaled units; a slower change is rounding
SMALL = 1e-2  # of the objective, by a change of the parameter by itself: where less changes, gaps are shares of this
ROUNDING = 1e-13  # share of the objective, or of a change in scaled units, that is none
CURVED = 1e-10  # share of the largest second derivative below which one is rounding
STEP = 3e-5  # of the value, by which the check solves again to either side
NEAR_END = 0.4  # share of the range of validity that such a step may use


@dataclass(frozen=True)
class End:
    """Where first-order reasoning ends: at `value` of the parameter, because of `event`; infinite where nothing ends it."""

    value: float
    event: str


@dataclass(frozen=True)
class Resolved:
    """Derivatives by central differences of `step` [unit of the parameter] between designs that were searched again."""

    step: float
    objective: float
    design: Mapping[str, float]
    gap: float  # largest difference to the exact ones, as a share of the largest of the kind


@dataclass(frozen=True)
class Sensitivity:
    """How an optimum answers to one number.

    `objective`: change of the objective [SI] per `parameter.unit`; `design`: change of each free quantity [its unit] per
    `parameter.unit`; `below`, `above`: how far this holds.
    """

    parameter: Parameter
    objective: float
    design: Mapping[str, float]
    below: End
    above: End
    check: Resolved | None = None

    @property
    def effect(self) -> float:
        """Change of the objective [SI] by one `parameter.step`."""
        return self.objective * self.parameter.step

    @property
    def moves(self) -> bool:
        """Whether anything changes at all."""
        return self.objective != 0.0 or any(self.design.values())


@dataclass(frozen=True)
class Sensitivities:
    """All of an optimum: `rows` by the size of their effect, largest first; `units` of the free quantities."""

    problem: ProblemFile
    solution: Solution
    unit: str
    rows: tuple[Sensitivity, ...]
    units: Mapping[str, str]
    notes: tuple[str, ...]

    def __getitem__(self, key: str) -> Sensitivity:
        return next(row for row in self.rows if key in (row.parameter.key, row.parameter.name))

    @property
    def moving(self) -> tuple[Sensitivity, ...]:
        """Those that change anything."""
        return tuple(row for row in self.rows if row.moves)

    @property
    def gap(self) -> float | None:
        """Largest difference to the derivatives of designs that were searched again; None if that was not asked for."""
        gaps = [row.check.gap for row in self.rows if row.check is not None]
        return max(gaps) if gaps else None

    @property
    def values(self) -> dict[str, float]:
        """The free quantities of the optimum, in their units."""
        return {v.name: v.scale.people(float(x)) for v, x in _shown(self.solution.nlp, self.solution.x)}

    def to_dict(self) -> dict[str, Any]:
        """As a JSON document: the objective in SI, everything else in the unit that stands beside it."""
        rows = []
        for row in self.rows:
            p = row.parameter
            entry = {
                "key": p.key,
                "name": p.name,
                "kind": "fixed quantity" if p.constant >= 0 else "limit",
                "value": p.value,
                "unit": p.unit,
                "step": p.step,
                "effect_of_step": row.effect,
                "objective_per_unit": row.objective,
                "design_per_unit": dict(row.design),
                "valid_from": row.below.value,
                "valid_from_because": row.below.event,
                "valid_to": row.above.value,
                "valid_to_because": row.above.event,
            }
            if row.check is not None:
                entry["searched_again"] = vars(row.check) | {"design": dict(row.check.design)}
            rows.append(entry)
        return finite(  # type: ignore[no-any-return]
            {
                **head(SCHEMA, self.problem, self.solution.status.value),
                "notes": list(self.notes),
                "objective": {"value": self.solution.objective, "unit": self.unit},
                "design": self.values,
                "design_units": dict(self.units),
                "largest_gap": self.gap,
                "parameters": rows,
            }
        )


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


class _System:
    """The optimality system at a solution: what is active, and how everything answers to a right-hand side."""

    def __init__(self, solution: Solution) -> None:
        nlp, x, p = solution.nlp, solution.x, solution.p
        self.nlp, self.x, self.price = nlp, x, solution.price
        n, m = len(x), len(nlp.rows)
        point = nlp.at(x, p)
        proof = stationarity(nlp, x, point, TIGHT)
        if proof.kkt > max(STATIONARY, solution.kkt):
            proof = solution.proof
        equal = nlp.lower == nlp.upper
        self.equal = equal
        self.active = np.array([i for i in proof.active if equal[i] or abs(proof.multipliers[i]) > STRONG], dtype=int)
        self.multipliers = np.zeros(n + m)
        self.multipliers[self.active] = proof.multipliers[self.active]
        self.values = np.concatenate([x, point.g])
        hessian, gradient, rows = lagrangian(nlp)(x, p, self.multipliers[n:])
        self.by_p = gradient[n:]
        whole = np.vstack([np.eye(n, n + len(p)), rows])  # of x and the rows, by x and p
        # positions of the largest error move along: they are unknowns, held by the vanishing slope of the error there
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

    def answer(self, parameter: Parameter) -> tuple[float, Array, Array]:
        """Per unit of a parameter: change of the objective, of the unknowns and of the multipliers."""
        rate, size = parameter.rate(), len(self.values)
        bounds = np.zeros(size)
        right = np.zeros(self.count + len(self.active))
        slope = 0.0
        if parameter.constant >= 0:
            column = self.free + 1 + parameter.constant
            right[: self.count] = -self.hessian[self.unknown, column] * rate
            right[self.count :] = -self.jacobian[self.active, column] * rate
            slope = self.by_p[1 + parameter.constant] * rate
        for entry in parameter.entries:
            upper = self.multipliers[entry] > 0.0
            if entry in self.active and (parameter.equal or upper == parameter.upper):
                bounds[entry] = rate
                slope -= self.multipliers[entry] * rate
        right[self.count :] += bounds[self.active]
        solved: Array = np.zeros(len(right))
        if np.any(right):
            if self.singular:
                solved = np.asarray(np.linalg.lstsq(self.matrix, right, rcond=1e-11)[0], dtype=float)
            else:
                solved = np.linalg.solve(self.matrix, right)
        multipliers = np.zeros(size)
        multipliers[self.active] = solved[self.count :]
        return float(slope * self.price), solved[: self.count], multipliers

    def ends(self, parameter: Parameter, moved: Array, prices: Array) -> tuple[End, End]:
        """How far a parameter can go, to first order, until a price falls to zero or another limit is reached."""
        rates = self.jacobian[:, self.unknown] @ moved
        rate = parameter.rate()
        if parameter.constant >= 0:
            rates = rates + self.jacobian[:, self.free + 1 + parameter.constant] * rate
        lower, upper = np.zeros(len(rates)), np.zeros(len(rates))
        for entry in parameter.entries:
            lower[entry] += rate * (parameter.equal or not parameter.upper)
            upper[entry] += rate * (parameter.equal or parameter.upper)
        least, most = (-math.inf, "nothing"), (math.inf, "nothing")
        held = set(self.active.tolist())
        for entry in range(len(rates)):
            events = []
            if entry in held:
                if not self.equal[entry] and abs(prices[entry]) > STILL * abs(self.multipliers[entry]):
                    events.append((-self.multipliers[entry] / prices[entry], "lets go"))
            else:
                for room, change in (
                    (self.nlp.upper[entry] - self.values[entry], upper[entry] - rates[entry]),
                    (self.values[entry] - self.nlp.lower[entry], rates[entry] - lower[entry]),
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


def _shown(nlp: NLP, x: Sequence[float] | Array) -> list[tuple[Any, float]]:
    """The free quantities (no helpers) with what belongs to them."""
    return [(v, float(value)) for v, value in zip(nlp.variables, x, strict=False) if v.name not in nlp.helpers]


def sensitivities(
    problem: ProblemFile,
    backend: str = "ipopt",
    starts: int | None = None,
    seed: int = 0,
    *,
    check: bool = False,
    progress: Callable[[float], None] | None = None,
) -> Sensitivities:
    """Find the optimum of a problem, and how it answers to everything that is given.

    Parameters
    ----------
    problem : ProblemFile
        With a requirement.
    backend, starts, seed
        As in `optlink.solve` and `optlink.generate`.
    check : bool
        Whether every parameter that matters is also moved a little to both sides and the design searched again.
    progress : function of the share that is done, optional

    Raises
    ------
    InputError
        when no optimum is found, whose sensitivity could be asked for; and as `optlink.solve` does.
    """
    from optlink.generation import generate
    from optlink.workflow import solve

    if problem.machined:
        remedy = "Change one figure at a time with --set and solve again"
        raise InputError(Fault("a machine that is designed by its cycle has no sensitivities yet", remedy, problem.file))
    if problem.generated:
        best = generate(problem, backend, starts, seed).best
        solution, file = (None, problem) if best is None else (best.solution, best.problem)
    else:
        result = solve(problem, backend, starts, seed)
        solution, file = result.solution, result.problem
    if solution is None or solution.status is not Status.OPTIMAL:
        how = "infeasible" if solution is None else solution.status.value
        remedy = f"See why: optlink solve {problem.name}"
        raise InputError(Fault(f"there is no optimum whose sensitivity could be told: {how}", remedy, problem.file))
    return of_solution(file, solution, backend, check=check, progress=progress)


def of_solution(
    problem: ProblemFile,
    solution: Solution,
    backend: str = "ipopt",
    *,
    check: bool = False,
    progress: Callable[[float], None] | None = None,
) -> Sensitivities:
    """How an optimum that is known answers to everything that is given; `problem` with a definite assembly mode."""
    nlp = solution.nlp
    system = _System(solution)
    factors = {v.name: v.scale.slope(x) for v, x in _shown(nlp, solution.x)}
    rows = []
    for parameter in parameters(nlp):
        objective, moved, prices = system.answer(parameter)
        below, above = system.ends(parameter, moved, prices)
        if abs(objective) * parameter.step <= ROUNDING * abs(solution.objective):
            objective = 0.0
        moved = np.where(np.abs(moved) <= ROUNDING * abs(parameter.rate()), 0.0, moved)
        design = {v.name: float(change * factors[v.name]) for v, change in _shown(nlp, moved)}
        rows.append(Sensitivity(parameter, objective, design, below, above))
    rows.sort(key=lambda row: -abs(row.effect))
    if check:
        asked = [row for row in rows if row.moves and (row.parameter.constant >= 0 or row.parameter.entries)]
        for done, row in enumerate(asked):
            rows[rows.index(row)] = replace(row, check=_searched_again(problem, solution, row, backend))
            if progress is not None:
                progress((done + 1) / len(asked))
    return Sensitivities(
        problem=problem,
        solution=solution,
        unit=nlp.measure.unit,
        rows=tuple(rows),
        units={v.name: v.scale.unit for v, _ in _shown(nlp, solution.x)},
        notes=tuple(_notes(system, solution)),
    )


def _notes(system: _System, solution: Solution) -> list[str]:
    found = []
    if system.singular:
        found.append("several designs are equally good, or limits depend on one another: the smallest change is shown")
    if solution.objective == 0.0 or float(np.max(np.abs(solution.nlp.residuals(solution.x)), initial=0.0)) <= solution.nlp.exact:
        found.append("the requirement is met exactly: nothing is left to gain, so every price is rounding")
    return found


def _searched_again(problem: ProblemFile, solution: Solution, row: Sensitivity, backend: str) -> Resolved | None:
    """Central differences between optima on either side; None where the range of validity leaves no room."""
    parameter = row.parameter
    size = abs(parameter.value) or 1.0
    room = min(parameter.value - row.below.value, row.above.value - parameter.value)
    step = min(STEP * size, NEAR_END * room)
    if step <= 1e-9 * size:
        return None
    again = _rebuilt if isinstance(problem.model, DesignProblem) and parameter.stated else _moved
    (low, below), (high, above) = (again(problem, solution, parameter, parameter.value + way, backend) for way in (-step, step))
    objective = (high - low) / (2.0 * step)
    design = {name: (above[name] - below[name]) / (2.0 * step) for name in row.design}
    small = SMALL * abs(solution.objective) / size
    gaps = [abs(objective - row.objective) / max(abs(objective), abs(row.objective), small, 1e-300)]
    largest = max(*(abs(d) for d in (*design.values(), *row.design.values())), 1e-300)
    gaps += [abs(design[name] - row.design[name]) / largest for name in design]
    return Resolved(step, objective, design, max(gaps))


def _rebuilt(
    problem: ProblemFile, solution: Solution, parameter: Parameter, value: float, backend: str
) -> tuple[float, dict[str, float]]:
    """Objective and design of the problem file with another value: built, scaled and searched anew."""
    from optlink.workflow import solve

    other = problem.override({parameter.key: text(value, parameter.unit)})
    found = solve(other, backend) if other.spec.everywhere else solve(begun(other, solution.design), backend, 1)
    assert found.solution is not None
    nlp = found.solution.nlp
    return found.objective, {v.name: v.scale.people(x) for v, x in _shown(nlp, found.solution.x)}


def _moved(
    problem: ProblemFile, solution: Solution, parameter: Parameter, value: float, backend: str
) -> tuple[float, dict[str, float]]:
    """Objective and design of the same programme with another value, which is taken back."""
    from optlink.solvers import search

    nlp = solution.nlp
    try:
        parameter.place(nlp, value)
        found = search.solve_from(nlp, solution.x, backend)
    finally:
        parameter.place(nlp, parameter.value)
    return found.objective, {v.name: v.scale.people(x) for v, x in _shown(nlp, found.x)}


__all__ = ["End", "Resolved", "Sensitivities", "Sensitivity", "of_solution", "sensitivities"]
