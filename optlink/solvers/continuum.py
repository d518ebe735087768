"""Continua of equally good designs: a flat direction at an optimum, confirmed by a search from a shifted design."""

from dataclasses import dataclass

import numpy as np

from optlink.errors import Status
from optlink.linkage.vector2d import Array, all_finite, max_magnitude
from optlink.problem.design import DesignProblem
from optlink.solvers import multistart
from optlink.solvers.contract import CLOSE
from optlink.solvers.exchange import solve_semi_infinite
from optlink.solvers.solution import SAME_OBJECTIVE, Solution, tangent_space

STRONG = 1e-9  # share of the largest multiplier above which a limit counts as determining the design
FLAT = 1e-6  # share of the largest curvature below which a direction is tried
SHIFT = 0.05  # shift for the confirming search, as a share of the range of the quantity that changes most
MOVES = 1e-4  # scaled units: least change of a quantity that is reported


@dataclass(frozen=True)
class Continuum:
    """A one-parameter family of equally good designs.

    `fix`: the design variable whose value selects one of them; `changes`: change of each design variable per change of that one
    [SI per SI]; `scale`: whether all lengths are scaled together.
    """

    fix: str
    changes: dict[str, float]
    scale: bool


def continuum(task: DesignProblem, solution: Solution, name: str) -> Continuum | None:
    """Return the continuum of equally good designs through a refined optimum; None if there is none.

    `name`: the back end that searches from a shifted design.
    """
    if solution.status is not Status.OPTIMAL:
        return None
    for direction in _flat(solution):
        lead = int(np.argmax(np.abs(direction[: len(task.free)])))
        if abs(direction[lead]) < MOVES:
            continue
        other = _shifted(task, solution, direction, lead, name)
        if other is not None:
            return _continuum(task, solution, other, lead)
    return None


def _flat(solution: Solution) -> list[Array]:
    """Return directions with neither a curvature of the Lagrangian nor a priced limit, flattest first."""
    nlp = solution.nlp
    n, point = len(solution.x), nlp.at(solution.x, solution.p)
    multipliers = solution.conditions.multipliers
    size = max_magnitude(multipliers)
    equal = nlp.lower == nlp.upper
    holding = [i for i in solution.conditions.active if equal[i] or abs(multipliers[i]) > STRONG * size]
    basis = tangent_space(point, holding)
    if basis.shape[1] == 0:
        return []
    hessian = nlp.hessian(solution.x, solution.p, multipliers[n:])
    reduced = basis.T @ hessian @ basis
    if not all_finite(reduced):
        return []
    values, vectors = np.linalg.eigh(reduced)
    stiff = max(max_magnitude(hessian), 1.0)
    return [basis @ vectors[:, k] for k in np.argsort(np.abs(values)) if abs(values[k]) <= FLAT * stiff]


def _shifted(task: DesignProblem, solution: Solution, direction: Array, lead: int, name: str) -> Solution | None:
    """Return an equally good design with a different value of one design variable; None if there is none.

    It is sought from a point along the flat direction, then from one that differs in this variable alone.
    """
    nlp = solution.nlp
    low, high = float(nlp.x_low[lead]), float(nlp.x_high[lead])
    at = float(solution.x[lead])
    step = SHIFT * (high - low)
    target = at + step if high - at >= at - low else at - step
    places = nlp.exchange_points
    nlp.set_exchange_points(solution.p[len(nlp.p) - nlp.exchange_count :])
    try:
        nlp.limit(lead, target, target)
        alone = np.where(np.arange(len(solution.x)) == lead, target, solution.x)
        for x in (solution.x + direction * (target - at) / direction[lead], alone):
            other = multistart.solve_from(nlp, nlp.lifted(np.clip(x, nlp.x_low, nlp.x_high)), name)
            other = solve_semi_infinite(task, other, CLOSE) if other.usable else other
            same = abs(other.objective - solution.objective) <= SAME_OBJECTIVE * max(abs(solution.objective), 1e-300)
            if other.usable and same:
                return other
    finally:
        nlp.limit(lead, low, high)
        nlp.set_exchange_points(places)
    return None


def _continuum(task: DesignProblem, solution: Solution, other: Solution, lead: int) -> Continuum:
    count = len(task.free)
    moved = other.x[:count] - solution.x[:count]
    changed = {
        v.name: (other.design[v.name] - solution.design[v.name])
        / (other.design[task.free[lead]] - solution.design[task.free[lead]])
        for v, by in zip(solution.nlp.variables[:count], moved, strict=True)
        if abs(by) > MOVES
    }
    ratios = {name: other.design[name] / value for name, value in solution.design.items() if abs(value) > 0.0}
    quantities = task.quantities
    lengths = [name for name in task.free if quantities[name].in_metres]
    sized = {name for name, quantity in quantities.items() if quantity.in_metres and quantity.value != 0.0}
    whole = sized <= set(lengths)  # a length fixed at zero scales too
    factors = [ratios.get(name, 1.0) for name in lengths if abs(solution.design[name]) > 1e-6 * task.longest]
    scale = whole and set(changed) <= set(lengths) and bool(np.ptp(factors) <= 1e-3 * abs(np.mean(factors) - 1.0))
    return Continuum(task.free[lead], changed, scale)
