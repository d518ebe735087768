"""The loosest tolerances that keep a yield: least cost over all of them, where a tolerance t costs c/t.

To first order an output keeps its limit with a margin of k sigma at every crank angle if sum (s_i t_i d_ij)^2 <= (room_j / k)^2:
linear in t^2, while the cost is convex in it. Least cost is a convex programme, proven by its dual value. All tolerances scale
with 1/k alike, so one programme gives their ratios, and samples of the exact linkage give k.

Source: K. W. Chase, Minimum-cost tolerance allocation, ADCATS report 99-5 (1999), which has one limit and Lagrange's multiplier.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from optlink.errors import Fault, InputError, SolverError
from optlink.studies.monte_carlo import Carlo, monte_carlo, sampled_document

if TYPE_CHECKING:
    from optlink.studies.tolerance import Tolerance

Array = NDArray[np.float64]
PROVEN = 1e-6  # share of the cost between it and the dual value
SEARCHED = 1 << 16  # samples of the exact linkage at each k
STEPS = 40  # of the bisection for k
CLOSE = 1e-4  # share to which k is found
MOST = 1 << 20  # times looser than what is given by which a bracket is sought


@dataclass(frozen=True)
class Allocation:
    """Tolerances that keep a yield: `tolerances` [SI] in the order of the study's, `cost`, and that of those given.

    `gap`: share of the cost between it and the dual value; `carlo`: samples of other seed that check the yield; `free`: names
    of tolerances that do not move the output, and stay as given.
    """

    wanted: float
    names: tuple[str, ...]
    tolerances: Array
    costs: Array
    cost: float
    before: float
    gap: float
    carlo: Carlo
    free: tuple[str, ...]

    @property
    def kept(self) -> bool:
        """Whether the wanted yield lies within the confidence interval of the check, or below it."""
        return self.wanted <= self.carlo.interval[1]

    def to_dict(self) -> dict[str, Any]:
        """As part of a JSON document."""
        return {
            "wanted_yield": self.wanted,
            "tolerances_SI": dict(zip(self.names, self.tolerances.tolist(), strict=True)),
            "cost_coefficients": dict(zip(self.names, self.costs.tolist(), strict=True)),
            "cost": self.cost,
            "cost_of_those_given": self.before,
            "duality_gap": self.gap,
            "without_effect": list(self.free),
            "kept": self.kept,
            "check": sampled_document(self.carlo),
        }


def least_cost(weights: Array, costs: Array) -> tuple[Array, float]:
    """Tolerances t that cost least, sum c/t, under weights @ t^2 <= 1.

    Parameters
    ----------
    weights : array (limits, tolerances), none negative, no column of zeros
    costs : array (tolerances,), positive

    Returns
    -------
    t : array
    gap : share of the cost by which the dual value lies below it

    Raises
    ------
    SolverError
        when the programme is not solved.
    """
    import cvxpy as module

    cvxpy: Any = module
    rough = 1.0 / np.sqrt(np.max(weights, axis=0))  # alone on its sharpest limit
    cost = costs / rough / np.mean(costs / rough)
    scaled = weights * np.square(rough)
    square = cvxpy.Variable(len(costs), pos=True)
    rule = scaled @ square <= 1.0
    programme = cvxpy.Problem(cvxpy.Minimize(cost @ cvxpy.power(square, -0.5)), [rule])
    programme.solve(solver=cvxpy.CLARABEL)
    if programme.status != cvxpy.OPTIMAL:
        raise SolverError(f"the least cost of tolerances was not found: {programme.status}")
    prices = np.maximum(np.asarray(rule.dual_value, dtype=float), 0.0)
    best = np.power(cost / (2.0 * (scaled.T @ prices)), 2.0 / 3.0)  # least of cost + prices over all tolerances
    dual = float(np.sum(cost / np.sqrt(best)) + prices @ (scaled @ best - 1.0))
    exact = [point / np.max(scaled @ point) for point in (best, np.asarray(square.value, dtype=float))]  # on the limit
    own, found = min((float(np.sum(cost / np.sqrt(point))), i) for i, point in enumerate(exact))  # the first, of one limit
    return rough * np.sqrt(exact[found]), (own - dual) / own


def allocate(study: Tolerance, wanted: float, costs: Mapping[str, float], samples: int, seed: int) -> Allocation:
    """The loosest tolerances of a study with which a share `wanted` of the linkages keeps its limit.

    Raises
    ------
    InputError
        measured deviations (they are as they are); a design that breaks the limit as drawn.
    """
    measured = [d.name for d in study.deviations if d.values]
    if measured:
        remedy = "Give it a tolerance and a distribution, or leave --allocate out"
        raise InputError(Fault("a measured deviation cannot be allocated", remedy, key="--tolerance", value=measured[0]))
    limit, nominal = study.limit, study.nominal
    if limit is None:
        raise InputError(Fault("a yield needs a limit", 'Add for example --limit "0.5 deg"', key="--allocate"))
    room = limit - np.abs(nominal.base)
    if np.min(room) <= 0.0:
        raise InputError(
            Fault(
                "the design breaks the limit as it is drawn, so no tolerances keep it",
                "Give a wider --limit, or a better design",
                key="--limit",
            )
        )
    coefficients = np.array([costs.get(d.name, d.cost) for d in study.deviations], dtype=float)
    if not np.all(np.isfinite(coefficients)) or np.any(coefficients <= 0.0):
        raise InputError(Fault("a cost coefficient is above zero", "Give for example --cost coupler=2", key="--cost"))
    tolerances = np.array([d.tolerance for d in study.deviations])
    each = np.array([d.sigma / d.tolerance for d in study.deviations])  # standard deviation per tolerance
    weights = np.square((each[:, None] * study.by / room).T)
    moves = np.max(weights, axis=0) > 0.0
    if not np.any(moves):
        raise InputError(Fault("none of the tolerances moves the output", "Choose another --output", key="--allocate"))
    unit, gap = least_cost(weights[:, moves], coefficients[moves])
    if gap > PROVEN:
        raise SolverError(f"the least cost of tolerances is not proven: {gap:.1e} of it is open")

    def scaled(k: float) -> Tolerance:
        found = tolerances.copy()
        found[moves] = unit / k
        wider = (replace(d, tolerance=float(t)) for d, t in zip(study.deviations, found, strict=True))
        return replace(study, deviations=tuple(wider))  # `by` is that of the drawing, whatever the tolerances

    def yielded(k: float) -> float:
        return monte_carlo(scaled(k), SEARCHED, seed).share

    low, high = 1.0, 1.0  # from so loose that it fails to so tight that it keeps
    while yielded(high) < wanted and high < MOST:
        low, high = high, 2.0 * high
    while low == high or (yielded(low) >= wanted and low > 1.0 / MOST):
        high, low = low, 0.5 * low
    for _ in range(STEPS):
        middle = (low * high) ** 0.5
        if yielded(middle) >= wanted:
            high = middle
        else:
            low = middle
        if high - low <= CLOSE * high:
            break
    final = scaled(high)
    found = np.array([d.tolerance for d in final.deviations])
    return Allocation(
        wanted=wanted,
        names=tuple(d.name for d in study.deviations),
        tolerances=found,
        costs=coefficients,
        cost=float(np.sum(coefficients / found)),
        before=float(np.sum(coefficients / tolerances)),
        gap=gap,
        carlo=monte_carlo(final, samples, seed + 1),
        free=tuple(d.name for d, m in zip(study.deviations, moves, strict=True) if not m),
    )
