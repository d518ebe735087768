"""Allocate tolerances of least cost that keep a yield, where a tolerance t costs c/t.

To first order an output keeps its limit with a margin of k sigma at every crank angle if sum (s_i t_i d_ij)^2 <= (room_j / k)^2:
linear in t^2, while the cost is convex in it. Minimising the cost is a convex programme, proven by its dual value. All tolerances
scale with 1/k, so one programme gives their ratios, and samples of the exact linkage give k.

References
----------
K. W. Chase, Minimum-cost tolerance allocation, ADCATS report 99-5 (1999): one limit and a Lagrange multiplier.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from optlink.errors import InputError, SolverError
from optlink.execution.worker import Runs
from optlink.linkage.vector2d import Array
from optlink.problem.document import Column, Source
from optlink.studies.tolerances.monte_carlo import LinearAnalysis, MonteCarlo, monte_carlo

PROVEN = 1e-6  # largest relative duality gap of a proven cost
SEARCH_SAMPLES = 1 << 16  # samples of the exact linkage at each k
STEPS = 40  # of the bisection for k
FACTOR_ACCURACY = 1e-4  # relative accuracy of k
MAX_FACTOR = 1 << 20  # largest factor on the tolerances in the search of a bracket


@dataclass(frozen=True)
class Allocation:
    """Tolerances that keep a yield: `tolerances` [SI] in the order of the study, their `cost`, and the cost of the original ones.

    `gap`: relative duality gap of the cost; `monte_carlo`: independent samples that verify the yield; `free`: names
    of tolerances without effect on the output, which keep their given values.
    """

    shown: ClassVar[Mapping[str, Source]] = {
        **{name: name for name in ("target_yield", "cost", "achieved")},
        "tolerances_SI": "sizes",
        "cost_coefficients": "coefficients",
        "cost_of_specified": "before",
        "duality_gap": "gap",
        "without_effect": "free",
        "check": "monte_carlo",
    }

    target_yield: float
    names: tuple[str, ...]
    tolerances: Column
    costs: Column
    cost: float
    before: float
    gap: float
    monte_carlo: MonteCarlo
    free: tuple[str, ...]

    @property
    def achieved(self) -> bool:
        """Whether the required yield is within or below the confidence interval of the verification."""
        return self.target_yield <= self.monte_carlo.interval[1]

    @property
    def sizes(self) -> dict[str, float]:
        """Allocated tolerances by name [SI]."""
        return dict(zip(self.names, self.tolerances.tolist(), strict=True))

    @property
    def coefficients(self) -> dict[str, float]:
        """Cost coefficients by name."""
        return dict(zip(self.names, self.costs.tolist(), strict=True))


def least_cost(weights: Array, costs: Array) -> tuple[Array, float]:
    """Minimise the cost sum c/t of tolerances t subject to weights @ t^2 <= 1.

    `weights` (limits, tolerances) without a column of zeros. Returns the tolerances and the relative duality gap of their cost.
    """
    import cvxpy as module

    cvxpy: Any = module
    rough = 1.0 / np.sqrt(np.max(weights, axis=0))  # each tolerance alone at its tightest limit
    cost = costs / rough / np.mean(costs / rough)
    scaled = weights * np.square(rough)
    square = cvxpy.Variable(len(costs), pos=True)
    rule = scaled @ square <= 1.0
    programme = cvxpy.Problem(cvxpy.Minimize(cost @ cvxpy.power(square, -0.5)), [rule])
    programme.solve(solver=cvxpy.CLARABEL)
    if programme.status != cvxpy.OPTIMAL:
        raise SolverError(f"the least cost of tolerances was not found: {programme.status}")
    prices = np.maximum(np.asarray(rule.dual_value, dtype=float), 0.0)
    best = np.power(cost / (2.0 * (scaled.T @ prices)), 2.0 / 3.0)  # minimum of the Lagrangian over all tolerances
    dual = float(np.sum(cost / np.sqrt(best)) + prices @ (scaled @ best - 1.0))
    exact = [point / np.max(scaled @ point) for point in (best, np.asarray(square.value, dtype=float))]  # scaled to the limit
    least, index = min((float(np.sum(cost / np.sqrt(point))), i) for i, point in enumerate(exact))  # the first for a single limit
    return rough * np.sqrt(exact[index]), (least - dual) / least


def allocate(
    study: LinearAnalysis, target_yield: float, costs: Mapping[str, float], samples: int, seed: int, runs: Runs | None = None
) -> Allocation:
    """Return the tolerances of least cost with which a study keeps its limit with a required yield.

    The search uses the samples of `seed`, the verification those of the next one.
    """
    measured = [d.name for d in study.deviations if d.values]
    if measured:
        remedy = "Give it a tolerance and a distribution, or leave --allocate out"
        raise InputError("a measured deviation cannot be allocated", remedy, key="--tolerance", value=measured[0])
    limit, nominal = study.limit, study.nominal
    if limit is None:
        raise InputError("a yield needs a limit", 'Add for example --limit "0.5 deg"', key="--allocate")
    room = limit - np.abs(nominal.base)
    if np.min(room) <= 0.0:
        message = "the nominal design exceeds the limit, so no tolerances can meet it"
        raise InputError(message, "Give a wider --limit, or a better design", key="--limit")
    coefficients = np.array([costs.get(d.name, d.cost) for d in study.deviations], dtype=float)
    if not np.all(np.isfinite(coefficients)) or np.any(coefficients <= 0.0):
        raise InputError("a cost coefficient must be above zero", "Give for example --cost coupler=2", key="--cost")
    tolerances = np.array([d.tolerance for d in study.deviations])
    sigma_per_tolerance = np.array([d.sigma / d.tolerance for d in study.deviations])  # standard deviation per tolerance
    weights = np.square((sigma_per_tolerance[:, None] * study.effects / room).T)
    moves = np.max(weights, axis=0) > 0.0
    unit, gap = least_cost(weights[:, moves], coefficients[moves])
    if gap > PROVEN:
        raise SolverError(f"the least cost of tolerances is not proven: {gap:.1e} of it is open")

    def scaled(k: float) -> LinearAnalysis:
        values = tolerances.copy()
        values[moves] = unit / k
        wider = (replace(d, tolerance=float(t)) for d, t in zip(study.deviations, values, strict=True))
        return replace(study, deviations=tuple(wider))  # `by` depends on the nominal design only

    def yielded(k: float) -> float:
        return monte_carlo(scaled(k), SEARCH_SAMPLES, seed).share

    low, high = 1.0, 1.0  # bracket: yield below and above the requirement
    while yielded(high) < target_yield and high < MAX_FACTOR:
        low, high = high, 2.0 * high
    while low == high or (yielded(low) >= target_yield and low > 1.0 / MAX_FACTOR):
        high, low = low, 0.5 * low
    for _ in range(STEPS):
        middle = (low * high) ** 0.5
        if yielded(middle) >= target_yield:
            high = middle
        else:
            low = middle
        if high - low <= FACTOR_ACCURACY * high:
            break
    final = scaled(high)
    nominal_tolerances = np.array([d.tolerance for d in final.deviations])
    return Allocation(
        target_yield=target_yield,
        names=tuple(d.name for d in study.deviations),
        tolerances=nominal_tolerances,
        costs=coefficients,
        cost=float(np.sum(coefficients / nominal_tolerances)),
        before=float(np.sum(coefficients / tolerances)),
        gap=gap,
        monte_carlo=monte_carlo(final, samples, seed + 1, runs=runs),
        free=tuple(d.name for d, m in zip(study.deviations, moves, strict=True) if not m),
    )
