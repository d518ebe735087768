"""Infeasibility analysis: conflicting limits and the least relaxation of each that makes the problem feasible.

An elastic programme adds a slack to every limit; both sides of a range that several values must keep share one. Limits with
positive slack are enforced one after the other until the enforced ones conflict (elastic filter); limits that are not needed for
the conflict are removed (deletion filter); each of the rest is relaxed alone, in its own unit, with all other limits enforced.

References
----------
J. W. Chinneck and E. W. Dravnieks, Locating minimal infeasible constraint sets in linear programs, ORSA J. Computing 3 (1991)
157-168.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from optlink.linkage.vector2d import Array
from optlink.optimization.nlp import NLP
from optlink.solvers.contract import BACKENDS, backend
from optlink.solvers.elastic_programme import FEASIBLE_SLACK, FREE, Limit, elastic_programme, limit_sides, limits_of
from optlink.solvers.multistart import starts
from optlink.solvers.solution import EXACTLY_MET, FEASIBLE, Relaxation, violation

STARTS, LOOKED_AT = 6, 256  # starting points used, of those sampled: the first at which every limit is finite
FIRST_ORDER, EVEN, ROUNDS = 1e-4, 1e-4, 4
"""Amount [display unit] by which both sides of a range are relaxed first; relative difference of their amounts at which the
corrections of their shares end; largest number of corrections."""
AGREEING = 3  # number of searches that end at the same least slack before it is accepted
FEW_AGREEING = 2  # the same for the relaxation of one limit of a large NLP
EQUAL_SLACKS = 1e-4  # relative difference of slacks that count as equal
EXCHANGES, FOLLOWED = 5, 1e-4  # rounds of the exchange method, and the violation (scaled) at the peaks that ends them

Follow = Callable[[Array], Array]


@dataclass(frozen=True)
class Explanation:
    """Reason for infeasibility.

    `conflict`: limits that cannot be satisfied together, each with its least relaxation alone (all other limits enforced).
    `together`: the least relaxation of several limits at once (least sum, scaled), which the design `x` needs.
    """

    x: Array
    conflict: tuple[Relaxation, ...]
    together: tuple[Relaxation, ...]


class _Search:
    """Searches for the least total slack: some limits are relaxed, others enforced, the rest dropped.

    Both back ends are used, so that the result does not depend on the back end selected. `follow` returns the parameters of the
    NLP with its exchange points at the peaks of a point.

    `agreeing`: number of searches that must end at the same least slack. `exact_amount`: whether a positive slack must be the
    least one with the limits met at the peaks too. `feasible_slack`: total slack of a set of limits that counts as feasible.
    """

    def __init__(
        self,
        nlp: NLP,
        limits: Sequence[Limit],
        points: list[Array],
        names: Sequence[str] = BACKENDS,
        follow: Follow | None = None,
    ) -> None:
        self.nlp, self.follow, self.p = nlp, follow, nlp.p.copy()
        self.programme, self.n, self.k = elastic_programme(nlp, limits), len(nlp.variables), len(limits)
        self.limits, self.points = limits, points
        self.shares = [limit.shares(FIRST_ORDER) for limit in limits]
        self.last: list[Array] = []  # end of the previous search
        self.solvers = [backend(name) for name in reversed(names)]
        self.agreeing, self.exact_amount, self.exchange_converged = AGREEING, False, True
        self.tight, self.feasible_slack, self.permitted_violation = False, FEASIBLE_SLACK, FEASIBLE_SLACK

    def tighten(self, feasible_slack: float) -> None:
        """Search with the tightest tolerances, for limits that are missed by little."""
        self.tight, self.feasible_slack, self.permitted_violation = True, feasible_slack, 0.1 * feasible_slack

    def within_bounds(self, x: Array) -> Array:
        """Return the design (n,) of an end of a search, within its bounds."""
        return np.clip(x[: self.n], self.nlp.x_low, self.nlp.x_high)

    def least(self, weights: Array, most_slack: Array | float = FREE) -> tuple[float, Array]:
        """Return the least slack with weights (k,), and x with the slacks, of which `most_slack` (k,) are the upper bounds.

        The exchange points are moved to the peaks of the solution until all limits hold there too (exchange method): always if
        the solution needs no slack, else if `exact_amount`. `exchange_converged` says whether the exchange converged.
        """
        self.programme.x_high[self.n :] = most_slack  # in place: the compiled functions of the NLP are kept
        total, x = self._searched(weights, most_slack, self.agreeing)
        self.exchange_converged = self.follow is None
        for _ in range(EXCHANGES):
            if self.follow is None or not math.isfinite(total) or (total > self.feasible_slack and not self.exact_amount):
                break
            self.p = self.follow(x[: self.n]).copy()
            self.exchange_converged = self._violation(x, weights) <= FOLLOWED
            if self.exchange_converged:
                break
            total, x = self._searched(weights, most_slack, 1)
        return total, x

    def alone(self, i: int) -> tuple[Array, Array]:
        """Return the least slack of each side of a limit that is relaxed alone, and x with the slacks.

        Both sides of a range are relaxed by the same amount, which is at most the least amount of one of its sides.
        """
        limit, weights = self.limits[i], np.eye(self.k)[i]
        count = len(limit.sides)
        if count == 1:
            slack, x = self.least(weights, FREE * weights)
            return np.array([slack]), x
        ends = []
        for shares in np.eye(count):
            self.shares[i] = shares
            ends.append(self.least(weights, FREE * weights))
        amounts = [side.relaxation(slack).amount for side, (slack, _) in zip(limit.sides, ends, strict=True)]
        best = int(np.argmin(np.nan_to_num(amounts, nan=np.inf)))
        if math.isfinite(ends[best][0]):
            self.last = [ends[best][1][: self.n]]
        amount = FIRST_ORDER
        for _ in range(ROUNDS):
            self.shares[i] = limit.shares(amount)
            slack, x = self.least(weights, FREE * weights)
            slacks = slack * self.shares[i]
            amounts = [side.relaxation(each).amount for side, each in zip(limit.sides, slacks.tolist(), strict=True)]
            if not np.all(np.isfinite(amounts)) or np.ptp(amounts) <= EVEN * max(amounts):
                break
            amount = float(np.mean(amounts))
        return slacks, x

    def _parameters(self, weights: Array) -> Array:
        return np.concatenate([weights, *self.shares, self.p])

    def _violation(self, x: Array, weights: Array) -> float:
        """Return the violation of the relaxed limits at a point (scaled)."""
        nlp = self.programme
        g = nlp.at(x, self._parameters(weights)).g
        return float(np.max([nlp.low - g, g - nlp.high, 0.0 * g])) if np.all(np.isfinite(g)) else math.inf

    def _searched(self, weights: Array, most_slack: Array | float, agreeing: int) -> tuple[float, Array]:
        """Return the least weighted slack for fixed exchange points; the search ends when `agreeing` runs have the same end."""
        nlp, p = self.programme, self._parameters(weights)
        best, best_x = math.inf, np.full(self.n + self.k, math.inf)
        ends: list[float] = []
        points = [*self.last, *self.points]
        most = len(points)  # after this many searches without a feasible end there is none
        turns = range(len(self.solvers))
        for point, solver in [(point, self.solvers[(i + k) % len(turns)]) for k in turns for i, point in enumerate(points)]:
            x = self._slackened(point, weights, most_slack)
            for run in (None, solver):  # the point itself may be feasible
                end = x if run is None else run(nlp, x, p, tight=self.tight).x
                total = float(weights @ end[self.n :]) if self._violation(end, weights) <= self.permitted_violation else math.inf
                if total < best:
                    best, best_x, self.last = total, end, [end[: self.n]]
                if best <= min(1e-9, self.feasible_slack):
                    return best, best_x
            ends.append(total)
            repeated = sum(total <= best * (1.0 + EQUAL_SLACKS) for total in ends) >= agreeing
            if repeated if math.isfinite(best) else len(ends) >= most:
                break
        return best, best_x

    def _slackened(self, point: Array, weights: Array, most_slack: Array | float) -> Array:
        """Return a point with the slacks that it needs, up to their bounds."""
        nlp = self.programme
        x = np.concatenate([point, np.zeros(self.k)])
        here = nlp.at(x, self._parameters(weights))
        need = np.nan_to_num(np.maximum(0.0, nlp.low - here.g) - np.maximum(0.0, here.g - nlp.high))
        slopes = here.jacobian[:, self.n :]
        needed = np.divide(need[:, None], slopes, out=np.zeros_like(slopes), where=slopes != 0.0)
        x[self.n :] = np.minimum(np.max(needed, axis=0, initial=0.0), most_slack)
        return x


def explain(
    nlp: NLP,
    seed: int = 0,
    points: list[Array] | None = None,
    *,
    quick: bool = False,
    follow: Follow | None = None,
    exactly: bool = False,
) -> Explanation | Array:
    """Identify the conflicting limits of an infeasible NLP; return the x of a feasible design if one is found.

    Local searches by both back ends start at `points`, or at the start and Sobol points. They prove infeasibility only in the
    sense that none of them found a feasible design.

    `quick`, for large NLPs: the interior-point method alone, and after the first verdict one search per question, two per amount.
    `follow` returns the parameters of the NLP with its exchange points at the peaks of a point. `exactly`: limits that are missed
    by no more than the tolerance of a feasible design count as missed.
    """
    limits = limits_of(limit_sides(nlp))
    every = np.ones(len(limits))
    search = _Search(nlp, limits, _begin(nlp, seed) if points is None else points, ("ipopt",) if quick else BACKENDS, follow)
    search.agreeing = FEW_AGREEING if quick else AGREEING
    if exactly:
        search.tighten(EXACTLY_MET)
    total, x = search.least(every)
    if total <= search.feasible_slack and not exactly:
        inside = search.within_bounds(x)
        if violation(nlp, inside, nlp.values(inside, search.p)[1]) > FEASIBLE:  # a solution is as accurate as that
            search.tighten(0.5 * FEASIBLE)
            total, x = search.least(every)
    search.agreeing = 1 if quick else AGREEING
    if total <= search.feasible_slack:
        return search.within_bounds(x)
    if not math.isfinite(total):
        return Explanation(search.points[0], (), ())
    search.points, slacks = [x[: search.n], *search.points], x[search.n :]
    together: list[Relaxation] = []
    for limit, slack in zip(limits, slacks, strict=True):
        if slack > search.feasible_slack:
            together += limit.relaxations(slack * limit.shares(FIRST_ORDER), nlp, x[: search.n], search.p, follow is not None)
    conflict: list[Relaxation] = []
    conflicting = _irreducible(search, slacks > search.feasible_slack)
    search.agreeing, search.exact_amount = FEW_AGREEING if quick else AGREEING, True
    for i in conflicting:
        least, end = search.alone(i)
        conflict += limits[i].relaxations(least, nlp, end[: search.n], search.p, not search.exchange_converged)
    return Explanation(x[: search.n], tuple(conflict), tuple(together))


def feasible_point(nlp: NLP, seed: int = 0, *, exactly: bool = False) -> Array | None:
    """Return the x of a design that meets all limits, by local searches from the start and Sobol points; None if none is found.

    `exactly`: as in `explain`.
    """
    limits = limits_of(limit_sides(nlp))
    search = _Search(nlp, limits, _begin(nlp, seed), ("ipopt",))
    if exactly:
        search.tighten(EXACTLY_MET)
    search.agreeing = FEW_AGREEING
    total, x = search.least(np.ones(len(limits)))
    return search.within_bounds(x) if total <= search.feasible_slack else None


def tightest(nlp: NLP, key: str, sense: str, point: Array, follow: Follow | None = None) -> Array | None:
    """Return the x of a design that meets the limit with a key and sense most nearly, and all others; None if none is found.

    `point` is a design that meets all others; for `follow` see `explain`.
    """
    sides = limit_sides(nlp)
    matching = [side for side in sides if (side.key, side.sense) == (key, sense)]
    rows, variables = (tuple(i for side in matching for i in getattr(side, name)) for name in ("rows", "variables"))
    limits = [
        Limit((side,))
        for side in (replace(matching[0], rows=rows, variables=variables), *(s for s in sides if s not in matching))
    ]
    search = _Search(nlp, limits, [point, *_begin(nlp, 0)], follow=follow)
    _, x = search.least(np.ones(len(limits)))
    search.points += [x[: search.n]] if np.all(np.isfinite(x)) else []
    search.agreeing = len(search.points) * len(search.solvers)  # from each by every back end: these ends can be local ones
    search.exact_amount = True
    slacks, x = search.alone(0)
    return x[: search.n] if np.all(np.isfinite(slacks)) else None


def _begin(nlp: NLP, seed: int) -> list[Array]:
    points = starts(nlp, LOOKED_AT, seed)
    return sorted(points, key=lambda point: not np.all(np.isfinite(nlp.values(point, nlp.p)[1])))[:STARTS]


def _irreducible(search: _Search, giving: NDArray[np.bool_]) -> list[int]:
    """Return indices of an irreducible infeasible set of limits; `giving` (k,): limits with positive slack at first."""

    def infeasible(limits: Array) -> bool:
        return search.feasible_slack < search.least(limits)[0] < math.inf

    for i in np.argsort(~giving, kind="stable").tolist():  # a limit that is infeasible on its own is the simplest conflict
        if infeasible(np.eye(search.k)[i]):
            return [i]
    conflict = _conflicting(search, giving)
    for i in np.flatnonzero(conflict).tolist():
        conflict[i] = 0.0
        if not infeasible(conflict):
            conflict[i] = 1.0
    return [int(i) for i in np.flatnonzero(conflict)]


def _conflicting(search: _Search, giving: NDArray[np.bool_]) -> Array:
    """Return 1 for limits of an infeasible set, 0 for the others (elastic filter); 1 for all if a search fails."""
    conflicting = np.where(giving, 1.0, 0.0)
    while search.least(conflicting)[0] <= search.feasible_slack:
        _, x = search.least(1.0 - conflicting, np.where(conflicting > 0.0, 0.0, FREE))
        giving = (x[search.n :] > search.feasible_slack) & (conflicting == 0.0)
        if not np.all(np.isfinite(x)) or not np.any(giving):
            return np.ones(search.k)
        conflicting[giving] = 1.0
    return conflicting
