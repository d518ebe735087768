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

import casadi
import numpy as np
from numpy.typing import NDArray

from optlink.linkage.fourbar import LENGTHS
from optlink.linkage.vector2d import Array, all_finite, finite_or
from optlink.optimization.nlp import NLP, Variable
from optlink.optimization.terms import DEGREES, PLAIN, ConstraintRow, Scale
from optlink.problem.design import EPIGRAPH
from optlink.solvers.contract import BACKENDS, backend
from optlink.solvers.multistart import starts
from optlink.solvers.solution import EXACTLY_MET, FEASIBLE, Relaxation, violation

# Constants of the search for the least slack.
# What a search finds, and how much longer it takes, if one of them is halved or doubled: docs/constants.md.
FEASIBLE_SLACK = 1e-6  # total slack, in scaled units, below which a set of limits counts as feasible
FREE = 1e3  # upper bound of a slack, in scaled units
STARTS, LOOKED_AT = 6, 256  # starting points used, of those sampled: the first at which every limit is finite
FIRST_ORDER, ROUNDS = 1e-4, 4
"""Amount [display unit] by which both sides of a range are relaxed first; largest number of corrections of their shares."""
AGREEING = 3  # number of searches that end at the same least slack before it is accepted
FEW_AGREEING = 2  # the same for the relaxation of one limit of a large NLP
EQUAL_SLACKS = 1e-4  # relative difference of slacks, and of the amounts of both sides of a range, that count as equal
EXCHANGES, FOLLOWED = 5, 1e-4  # rounds of the exchange method, and the violation (scaled) at the peaks that ends them

# The elastic programme of infeasibility analysis: every limit of an NLP, or both sides of a range, relaxed by a slack.


@dataclass(frozen=True)
class LimitSide:
    """One side of one limit: the rows (and bounds) that share one number of the problem file, or one condition."""

    key: str
    name: str
    upper: bool
    rows: tuple[int, ...]
    variables: tuple[int, ...]
    bound: float
    scale: Scale
    equation: bool = False

    @property
    def sense(self) -> str:
        """Sense in display units: "<=", ">=" or "="."""
        return "=" if self.equation else "<=" if self.upper != self.scale.cosine else ">="

    def nearest(self, nlp: NLP, g: Array) -> "LimitSide":
        """Return the side under the name of that of its rows which is furthest beyond it at a design with the values g."""
        beyond = {nlp.rows[j].label: (g[j] - self.bound) * (1.0 if self.upper else -1.0) for j in reversed(self.rows)}
        return replace(self, name=max(beyond, key=beyond.__getitem__)) if all_finite(g) and beyond else self

    def displaced(self, amount: float) -> float:
        """Return the bound moved outward by an amount, in display units; an angle between 0 and 180 deg for a cosine."""
        moved = self.scale.to_display(self.bound) + (amount if self.upper != self.scale.cosine else -amount)
        return min(max(moved, 0.0), 180.0) if self.scale.cosine else moved

    def relaxation(self, slack: float, approximate: bool = False, both_sides: bool = False) -> Relaxation:
        """Return the side relaxed by a slack, infinite if no slack suffices, in display units; for the flags see `Relaxation`."""
        bound = self.scale.to_display(self.bound)
        relaxed = self.scale.to_display(self.bound + (slack if self.upper else -slack)) if math.isfinite(slack) else math.nan
        amount = abs(relaxed - bound)
        return Relaxation(self.name, self.key, self.sense, bound, relaxed, amount, self.scale.unit, approximate, both_sides)


@dataclass(frozen=True)
class Limit:
    """A limit that is relaxed as one: one side, or both sides of a range."""

    sides: tuple[LimitSide, ...]

    def shares(self, amount: float) -> Array:
        """Return the slack of each side relative to the first one if all sides are relaxed by an amount [display unit]."""
        slacks = [abs(side.scale.to_internal(side.displaced(amount)) - side.bound) for side in self.sides]
        shares = np.array([slack / slacks[0] if slacks[0] else 1.0 for slack in slacks])
        return np.asarray(np.clip(shares, 0.1, 10.0))  # a root has no slope at zero

    def relaxations(self, slacks: Array, nlp: NLP, x: Array, p: Array, approximate: bool) -> list[Relaxation]:
        """Return the relaxation of each side that a design x needs, from the slack of each; infinite slacks do not suffice."""
        g = nlp.values(x, p)[1]
        slacks_by_side = [(side.nearest(nlp, g), slack) for side, slack in zip(self.sides, slacks.tolist(), strict=True)]
        if len(slacks_by_side) > 1 and all_finite(slacks):
            over = [max((g[j] - side.bound) * (1.0 if side.upper else -1.0) for j in side.rows) for side in self.sides]
            needed = [pair for pair, excess in zip(slacks_by_side, over, strict=True) if excess > FEASIBLE_SLACK]
            slacks_by_side = needed or slacks_by_side
        return [side.relaxation(slack, approximate, len(slacks_by_side) > 1) for side, slack in slacks_by_side]


def limit_sides(nlp: NLP) -> list[LimitSide]:
    """Return every side of every limit that can conflict; rows of one number of the problem file and one side are combined.

    Limits at zero are conditions: each label of one key is a side of its own.

    Bounds of variables without influence on any limit are left out, as are bounds of an angle over a full revolution.
    """
    sides: dict[tuple[str, str | float, bool], list[int]] = {}
    for j, row in enumerate(nlp.rows):
        if row.limit == EPIGRAPH or row.limit in nlp.states:
            continue
        for upper, bound in ((False, row.low), (True, row.high)):
            if math.isfinite(bound):
                sides.setdefault((row.limit, bound or row.label, upper), []).append(j)
    result = []
    for (key, _, upper), rows in sides.items():
        row = nlp.rows[rows[0]]
        bound, equation = row.high if upper else row.low, row.low == row.high
        result.append(LimitSide(key, row.label, upper, tuple(rows), (), bound, row.scale, equation))
    indices = [j for j, row in enumerate(nlp.rows) if row.limit != EPIGRAPH]
    used = casadi.which_depends(nlp.g_expression[indices], nlp.x_symbol, 1, False) if indices else [False] * len(nlp.variables)
    for i, variable in enumerate(nlp.variables):
        around = variable.scale is DEGREES and nlp.x_high[i] - nlp.x_low[i] >= 2.0 * math.pi
        if variable.name in nlp.helpers or variable.name in nlp.states or around or not used[i]:
            continue
        for upper, bound in ((False, nlp.x_low[i]), (True, nlp.x_high[i])):
            result.append(LimitSide(variable.key or variable.name, variable.name, upper, (), (i,), float(bound), variable.scale))
    return result


def limits_of(sides: Sequence[LimitSide]) -> list[Limit]:
    """Combine the two sides of each range that several values must keep; every other side is a limit of its own.

    The sides belong together if they have the same name, or if they are the only ones of their key. A single value is never
    beyond both sides of its range, and an equation has a slack for each side.
    """
    result: list[Limit] = []
    paired: set[int] = set()
    for i, side in enumerate(sides):
        same_key = [k for k, other in enumerate(sides) if other.key == side.key and other.rows]
        same_key = [k for k in same_key if sides[k].name == side.name] if len(same_key) > 2 else same_key
        if i in paired:
            continue
        values = {row for k in same_key for row in sides[k].rows}
        two_sided = sorted(sides[k].upper for k in same_key) == [False, True]
        if side.rows and not side.equation and len(values) > 1 and two_sided:
            paired.update(same_key)
            # in display units the lower side comes first
            result.append(Limit(tuple(sorted((sides[k] for k in same_key), key=lambda one: one.upper != one.scale.cosine))))
        else:
            result.append(Limit((side,)))
    return result


def elastic_programme(nlp: NLP, limits: Sequence[Limit]) -> NLP:
    """Return the elastic programme: minimise weights . s over x and slacks s >= 0, each of the k limits relaxed by its s.

    Its parameters are the weights (k,) and the shares of every side in the slack of its limit, followed by those of the NLP.
    """
    sides = [(i, side) for i, limit in enumerate(limits) for side in limit.sides]
    shares = casadi.SX.sym("shares", len(sides))
    n, k = len(nlp.variables), len(limits)
    x, s = casadi.SX.sym("x", n), casadi.SX.sym("s", k)
    g = casadi.substitute(nlp.g_expression, nlp.x_symbol, x)
    weights = casadi.SX.sym("weights", k)
    # a target value stays one equation with slack to either side: two inequalities would have no interior
    exact = {j: g[j] for _, side in sides for j in side.rows if side.equation}
    for i, side in sides:
        for j in exact.keys() & set(side.rows):
            exact[j] = exact[j] + (-s[i] if side.upper else s[i])
    rows = [replace(nlp.rows[j], value=value) for j, value in exact.items()]
    for m, (i, side) in enumerate(sides):
        give = -shares[m] * s[i] if side.upper else shares[m] * s[i]
        low, high = (-math.inf, side.bound) if side.upper else (side.bound, math.inf)
        rows += [ConstraintRow(side.key, side.name, g[j] + give, low, high, side.scale) for j in side.rows if j not in exact]
        rows += [ConstraintRow(side.key, side.name, x[j] + give, low, high, side.scale) for j in side.variables]
    rows += [replace(row, value=g[j]) for j, row in enumerate(nlp.rows) if row.limit in nlp.states]
    bounded = np.array([v.name not in nlp.helpers for v in nlp.variables])
    giving = {i for _, side in sides for i in side.variables}
    fixed_variables = np.array([v.name in nlp.states or (bounded[i] and i not in giving) for i, v in enumerate(nlp.variables)])
    length = np.array([v.name in LENGTHS or v.name.endswith(".length") for v in nlp.variables])
    room = np.where(bounded, np.maximum(nlp.x_high - nlp.x_low, 1.0), 1.0)
    lowest = np.where(length, 1e-3 * nlp.x_low, nlp.x_low - room)  # a length may shrink towards zero, not below
    # helpers keep their bounds, except the largest error, which has no upper bound
    lowest = np.where(fixed_variables, nlp.x_low, np.where(bounded, lowest, finite_or(nlp.x_low, 0.0)))
    highest = np.where(fixed_variables, nlp.x_high, np.where(bounded, nlp.x_high + room, finite_or(nlp.x_high, 1.0)))
    return NLP(
        variables=(*nlp.variables, *(Variable(f"slack {i}", 1.0, PLAIN) for i in range(k))),
        fixed=(),
        rows=tuple(rows),
        measure=nlp.measure,
        x_start=np.concatenate([nlp.x_start, np.zeros(k)]),
        x_low=np.concatenate([lowest, np.zeros(k)]),
        x_high=np.concatenate([highest, np.full(k, FREE)]),
        p=np.concatenate([np.ones(k + len(sides)), nlp.p]),
        x_symbol=casadi.vertcat(x, s),
        p_symbol=casadi.vertcat(weights, shares, nlp.p_symbol),
        f_expression=casadi.dot(weights, s),
        g_expression=casadi.vertcat(*[row.value for row in rows]),
        residual_expression=casadi.SX(1, 1),
    )


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
            if not all_finite(amounts) or np.ptp(amounts) <= EQUAL_SLACKS * max(amounts):
                break
            amount = float(np.mean(amounts))
        return slacks, x

    def _parameters(self, weights: Array) -> Array:
        return np.concatenate([weights, *self.shares, self.p])

    def _violation(self, x: Array, weights: Array) -> float:
        """Return the violation of the relaxed limits at a point (scaled)."""
        nlp = self.programme
        g = nlp.at(x, self._parameters(weights)).g
        return float(np.max([nlp.low - g, g - nlp.high, 0.0 * g])) if all_finite(g) else math.inf

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
    search.points += [x[: search.n]] if all_finite(x) else []
    search.agreeing = len(search.points) * len(search.solvers)  # from each by every back end: these ends can be local ones
    search.exact_amount = True
    slacks, x = search.alone(0)
    return x[: search.n] if all_finite(slacks) else None


def _begin(nlp: NLP, seed: int) -> list[Array]:
    points = starts(nlp, LOOKED_AT, seed)
    return sorted(points, key=lambda point: not all_finite(nlp.values(point, nlp.p)[1]))[:STARTS]


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
        if not all_finite(x) or not np.any(giving):
            return np.ones(search.k)
        conflicting[giving] = 1.0
    return conflicting
