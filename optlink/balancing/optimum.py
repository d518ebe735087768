"""Optimal balancing: optimum, shadow prices of the limits, conflicting limits, trade-off between two measures."""

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from optlink.balancing.socp import CONSTRAINT_TOLERANCE, GAP, BalanceBound, BalancingProgramme, ConeCertificate, Price, solved
from optlink.errors import SolverError
from optlink.linkage.vector2d import Array, max_magnitude
from optlink.optimization.multipliers import MultiplierSet
from optlink.problem.terms import Term
from optlink.units import percent

Goal = Sequence[tuple[Term, float]]
NEGLIGIBLE = 1e-10
"""Share of the largest singular value below which parameters have no effect on a measure."""

CRUMB = 1e-4
"""Scaled mass below which the removal of a counterweight is tried."""

LIKE = (1e-8, 2e-8, 4e-8)
"""By how much a scaled measure may be larger for the sake of less mass: the first that leaves the solver room."""

LIGHTER = 5e-3
"""Least share of the mass that must be saved for an increase of a measure to be accepted."""

END = 5e-8
"""Accepted increase of the first scaled measure above its optimum at the end of a trade-off where the second one is minimised."""

ROUNDS = 60
"""Greatest number of linearisations of the moments of inertia of discs."""

PRICED = 1e-4
"""Share of the largest dual below which one is an inaccuracy of the interior-point method."""

LEAST_SQUARES_DIFFERENCE = 1e-6
"""Scaled difference from the least-squares optimum up to which it is tried in place of the solver's solution."""


@dataclass(frozen=True)
class Optimum:
    """An optimum: scaled parameters, scaled value, certificate with a lower bound, shadow prices.

    `exact` is true for a solution by linear least squares.
    """

    x: Array
    value: float
    certificate: ConeCertificate
    prices: tuple[Price, ...] = ()
    exact: bool = False

    @property
    def lower(self) -> float:
        """Proven lower bound of the objective, scaled."""
        return self.certificate.lower

    @property
    def gap(self) -> float:
        """Value minus lower bound, scaled."""
        return self.value - self.lower


def evaluate(programme: BalancingProgramme, goal: Goal, x: Array) -> float:
    """Return the weighted sum of measures at scaled parameters (n,), each divided by its value in the original machine."""
    return sum(weight * programme.evaluate(measure, x) for measure, weight in goal)


def optimum(programme: BalancingProgramme, goal: Goal) -> Optimum:
    """Return the global optimum of a weighted sum of measures.

    Of several optima, the one with the least added mass (and stiffness) is returned.
    """
    cp = programme.cp
    expression = sum(weight * programme.expression(measure) for measure, weight in goal)
    rows = [programme.row(bound) for bound in programme.bounds]
    problem = cp.Problem(cp.Minimize(expression), [*programme.cones, *programme.relaxed, *rows])
    certificate = solved(problem)
    if certificate.status != "optimal":
        return Optimum(np.full(programme.effects.count, np.nan), math.nan, certificate)
    x = programme.found
    duals = [max(float(np.max(row.dual_value)), 0.0) for row in (*rows, *(place.constraint for place in programme.hard))]
    value = evaluate(programme, goal, x)
    if len(goal) == 1 and goal[0][0].how == "rms":
        exact = _least_squares(programme, goal[0][0], value)
        if exact is not None:
            least = goal[0][1] * programme.evaluate(goal[0][0], exact)
            # the residual of least squares is a lower bound for all parameters, within limits or not
            proof = ConeCertificate("optimal", least, least, 0.0, certificate.iterations)
            return Optimum(exact, least, proof, _prices(programme, duals, exact), True)
    x = _without_crumbs(programme, goal, _Lightest(programme, [measure for measure, _ in goal]).like(x))
    return Optimum(x, evaluate(programme, goal, x), certificate, _prices(programme, duals, x))


def _without_crumbs(programme: BalancingProgramme, goal: Goal, x: Array) -> Array:
    """Remove tiny counterweights whose removal worsens neither the objective nor the constraint violation."""
    value, excess = evaluate(programme, goal, x), programme.excess(x)
    for k in range(len(programme.counterweights)):
        if 0.0 < x[4 * k] < CRUMB:
            without = x.copy()
            without[4 * k : 4 * k + 4] = 0.0
            as_good = evaluate(programme, goal, without) <= value + CONSTRAINT_TOLERANCE
            if as_good and programme.excess(without) <= max(excess, CONSTRAINT_TOLERANCE):
                x = without
    return x


def _prices(programme: BalancingProgramme, duals: Sequence[float], x: Array) -> tuple[Price, ...]:
    """Return the shadow price of every limit from its dual variable: scaled objective per SI unit of the limit."""
    programme.put(x)
    prices = []
    sides = {(bound.name, bound.sense): dual for bound, dual in zip(programme.bounds, duals, strict=False)}
    # both sides of a prescribed value share any dual
    net = [max(d - sides.get((b.name, -b.sense), 0.0), 0.0) for b, d in zip(programme.bounds, duals, strict=False)]
    alone = _alone(programme, [*net, *duals[len(net) :]])
    for bound, (dual, others) in zip(programme.bounds, alone, strict=False):
        value = float(bound.expression.value) * bound.scale
        prices.append(Price(bound.name, bound.kind, bound.bound, value, bound.sense, dual / bound.scale, others))
    for place, (dual, others) in zip(programme.hard, alone[len(net) :], strict=True):
        prices.append(Price(place.name, "length", place.bound, place.reached, 1, dual * place.rate, others))
    return tuple(prices)


def _alone(programme: BalancingProgramme, duals: Sequence[float]) -> list[tuple[float, tuple[str, ...]]]:
    """Return the dual of each limit that is relaxed alone, and the names of limits that depend on it.

    An interior-point method divides the dual of limits whose gradients are linearly dependent among them.
    """
    constraints = [*map(programme.row, programme.bounds), *(place.constraint for place in programme.hard)]
    names = [*(bound.name for bound in programme.bounds), *(place.name for place in programme.hard)]
    gradients = np.zeros((len(duals), programme.effects.count))
    for k, constraint in enumerate(constraints):
        slope = constraint.expr.grad.get(programme.x) if constraint.expr.size == 1 else None
        gradients[k] = 0.0 if slope is None else slope.toarray().ravel()
    known = np.array(duals)
    priced = known > PRICED * np.max(known, initial=0.0)
    multiplier_set = MultiplierSet.from_gradients(gradients, known, priced, np.ones(len(duals)))
    if not multiplier_set.directions.size:
        return [(dual, ()) for dual in duals]
    linked = np.abs(multiplier_set.directions @ np.linalg.pinv(multiplier_set.directions)) > PRICED
    alone: list[tuple[float, tuple[str, ...]]] = []
    for k, (dual, weights) in enumerate(zip(duals, np.eye(len(duals)), strict=True)):
        least = multiplier_set.least(weights)[0]
        depends = least < dual * (1.0 - PRICED)
        others = tuple(name for j, name in enumerate(names) if j != k and linked[k, j])
        alone.append((least, others) if depends else (dual, ()))
    return alone


def _span(rows: Array) -> tuple[Array, Array]:
    """Return orthonormal bases of the row space (n, r) and of the null space (n, n - r)."""
    _, sizes, directions = np.linalg.svd(rows, full_matrices=True)
    rank = int(np.sum(sizes > NEGLIGIBLE * max(float(np.max(sizes, initial=0.0)), 1e-300)))
    return directions[:rank].T, directions[rank:].T


def _least_squares(programme: BalancingProgramme, measure: Term, value: float) -> Array | None:
    """Return the least-squares optimum of a root mean square with the least mass; None if the limits do not allow it."""
    rows, offset = programme.rows(measure)
    matters, _ = _span(rows)
    x = -matters @ np.linalg.lstsq(rows @ matters, offset, rcond=None)[0]
    if value - float(np.linalg.norm(rows @ x + offset)) > LEAST_SQUARES_DIFFERENCE:
        return None
    return _Lightest(programme, [measure]).same(x)


class _Lightest:
    """Parameters with the least mass (and stiffness) among all that are as good in some measures, within all limits.

    "As good" means equal effect on the measures or, if that is lighter, values that are at most `LIKE` larger.
    """

    def __init__(self, programme: BalancingProgramme, measures: Sequence[Term]) -> None:
        cp, self.programme, self.measures = programme.cp, programme, measures
        rows = np.concatenate([programme.rows(measure)[0].reshape(-1, programme.effects.count) for measure in measures])
        self.idle = _span(np.asarray(np.linalg.qr(rows, mode="r")))[1]
        self.limits = [*programme.relaxed, *(programme.row(bound) for bound in programme.bounds)]
        every = [*programme.cones, *self.limits]
        if self.idle.shape[1]:
            self.free, self.given = cp.Variable(self.idle.shape[1]), cp.Parameter(programme.effects.count)
            same = programme.x == self.given + self.idle @ self.free
            self.exact = cp.Problem(cp.Minimize(programme.size), [*every, same])
        self.values = cp.Parameter(len(measures))
        alike = [programme.expression(measure) <= self.values[k] for k, measure in enumerate(measures)]
        self.near = cp.Problem(cp.Minimize(programme.size), [*every, *alike])

    def same(self, x: Array) -> Array | None:
        """Return the lightest parameters with the same effects as `x`; None if the limits allow none."""
        if not self.idle.shape[1]:
            return x if self.programme.satisfies(x, self.limits) else None
        self.given.value = x
        certificate = solved(self.exact)
        if certificate.status != "optimal" or certificate.outside > CONSTRAINT_TOLERANCE:
            return None
        return np.asarray(x + self.idle @ np.atleast_1d(self.free.value))

    def like(self, x: Array) -> Array:
        """Return the lightest parameters that are as good as `x`; `x` itself if none are lighter."""
        same = self.same(x)
        best = x if same is None else same
        values = np.array([self.programme.evaluate(measure, x) for measure in self.measures])
        for room in LIKE:
            self.values.value = values + room
            if solved(self.near).status != "optimal":
                continue
            near = self.programme.found
            measured = [self.programme.evaluate(measure, near) for measure in self.measures]
            if np.all(measured <= values + room + CONSTRAINT_TOLERANCE) and self.programme.excess(near) <= GAP:
                return near if self._size(near) < self._size(best) * (1.0 - LIGHTER) else best
        return best

    def _size(self, x: Array) -> float:
        self.programme.put(x)
        return float(self.programme.size.value)


# --- discs -----------------------------------------------------------------------------------------------------------------


def realised_discs(programme: BalancingProgramme, goal: Goal, x: Array) -> Array:
    """Return feasible discs near the optimum `x` of their relaxation, by successive linearisation of the moments of inertia.

    The step is limited by a trust region. If discs reach the value of the relaxation, that point is returned directly.
    """
    best = min(map(programme.realised, (x, programme.with_mass(x))), key=lambda y: _merit(programme, goal, y))
    if not programme.relaxed or _merit(programme, goal, best) <= _merit(programme, goal, x) + GAP:
        return best
    cp, n = programme.cp, programme.effects.count
    here, width = cp.Parameter(n), cp.Parameter(nonneg=True)
    discs = [k for k, weight in enumerate(programme.counterweights) if weight.kind == "disc"]
    slopes, levels = cp.Parameter((len(discs), n)), cp.Parameter(len(discs))
    rows = [programme.row(bound) for bound in programme.bounds]
    tangent = [programme.x[[4 * k + 3 for k in discs]] == slopes @ programme.x + levels, cp.norm_inf(programme.x - here) <= width]
    expression = sum(weight * programme.expression(measure) for measure, weight in goal)
    problem = cp.Problem(cp.Minimize(expression), [*programme.cones, *rows, *tangent])
    reach = 0.1 * max(1.0, max_magnitude(best))
    for _ in range(ROUNDS):
        slopes.value, levels.value = (np.array(part) for part in zip(*(programme.tangent(best, k) for k in discs), strict=True))
        here.value, width.value = best, reach
        certificate = solved(problem)
        if certificate.status == "optimal":
            step = programme.realised(programme.found)
            if _merit(programme, goal, step) < _merit(programme, goal, best) - 1e-12:
                best, reach = step, 2.0 * reach
                continue
        reach *= 0.25
        if reach < 1e-9:
            break
    return best


def _merit(programme: BalancingProgramme, goal: Goal, x: Array) -> float:
    """Return the objective plus a hundred times the constraint violation."""
    return evaluate(programme, goal, x) + 100.0 * programme.excess(x)


# --- conflicting limits -----------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Conflict:
    """A limit that conflicts with others: the value that makes it feasible [SI], relaxed `together` with others or `alone`."""

    bound: BalanceBound
    together: float
    alone: float


def conflict(programme: BalancingProgramme) -> tuple[Conflict, ...]:
    """Return the conflicting limits and their least feasible values, relaxed together and each alone."""
    cp, bounds = programme.cp, programme.bounds
    slack = cp.Variable(len(bounds), nonneg=True)
    sizes = [abs(bound.bound) / bound.scale or 1.0 for bound in bounds]
    rows = [programme.row(bound, slack[k] * sizes[k]) for k, bound in enumerate(bounds)]
    elastic = solved(cp.Problem(cp.Minimize(cp.sum(slack)), [*programme.cones, *programme.relaxed, *rows]))
    amounts = np.array(slack.value, dtype=float) if elastic.status == "optimal" else np.full(len(bounds), np.inf)
    conflicts = []
    for k, bound in enumerate(bounds):
        single = solved(cp.Problem(cp.Minimize(bound.sense * bound.expression), programme.constraints(bound)))
        value = float(bound.expression.value) * bound.scale if single.status == "optimal" else math.inf
        together = bound.bound + bound.sense * float(amounts[k]) * sizes[k] * bound.scale
        if math.isfinite(value) or amounts[k] > CONSTRAINT_TOLERANCE:
            conflicts.append(Conflict(bound, together if amounts[k] > CONSTRAINT_TOLERANCE else bound.bound, value))
    return tuple(conflicts)


# --- the trade-off ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class TradeOffPoint:
    """A point of the trade-off: scaled parameters, both measures and the duality gap (scaled).

    `rate`: decrease of the first measure per increase of the second, from the dual variables.
    """

    x: Array
    first: float
    second: float
    gap: float
    rate: float


@dataclass(frozen=True)
class TradeOffCurve:
    """The trade-off between two measures, from the least first to the least second measure.

    The solution times [s] of the first point and of a further point (median) are recorded.
    """

    points: tuple[TradeOffPoint, ...]
    first_seconds: float
    further_seconds: float


def curve(programme: BalancingProgramme, first: Term, second: Term, count: int) -> TradeOffCurve:
    """Return Pareto-optimal points of two measures, evenly spaced along the front, `count` with both ends.

    The ends are the optima of each measure, with the other as small as that allows. For the points between, evenly spaced
    points of the chord are the reference points of a Pascoletti-Serafini scalarisation (J. Optim. Theory Appl. 42 (1984)
    499-524): one programme with the reference point as parameter.

    Raises
    ------
    SolverError
        when the solver finds no optimum for a point of the front.
    """
    cp = programme.cp
    ends = [_end(programme, first, second), _end(programme, second, first)]
    (a0, b0), (a1, b1) = ((programme.evaluate(first, end.x), programme.evaluate(second, end.x)) for end in ends)
    start = TradeOffPoint(ends[0].x, a0, b0, a0 - ends[0].lower, math.nan)
    stop = TradeOffPoint(ends[1].x, a1, b1, b1 - ends[1].lower, math.nan)
    if min(a1 - a0, b0 - b1) <= 10.0 * LEAST_SQUARES_DIFFERENCE:  # no conflict: one point minimises both
        return TradeOffCurve((start,), math.nan, math.nan)
    at, depth = cp.Parameter(2), cp.Variable()
    rows = [programme.expression(first) <= at[0] + depth * (a1 - a0), programme.expression(second) <= at[1] + depth * (b0 - b1)]
    problem = cp.Problem(cp.Minimize(depth), [*programme.constraints(), *rows])
    assert problem.is_dcp(dpp=True)
    inner, seconds, lightest = [], [], _Lightest(programme, [first, second])
    for share in np.linspace(0.0, 1.0, count)[1:-1]:
        at.value = np.array([a0 + share * (a1 - a0), b0 - share * (b0 - b1)])
        begin = time.perf_counter()
        certificate = solved(problem)
        seconds.append(time.perf_counter() - begin)
        if certificate.status != "optimal":
            raise SolverError(f"the trade-off stopped at {percent(share, 0)} of its length: {certificate.status}")
        x = programme.found
        first_dual, second_dual = (float(np.max(row.dual_value)) for row in rows)
        values = programme.evaluate(first, x), programme.evaluate(second, x)
        x = lightest.like(x)
        pair = programme.evaluate(first, x), programme.evaluate(second, x)
        worse = max(pair[0] - values[0], pair[1] - values[1], 0.0)  # increase accepted for less mass
        gap, rate = certificate.gap * max(a1 - a0, b0 - b1) + worse, second_dual / first_dual if first_dual > 0.0 else math.inf
        inner.append(TradeOffPoint(x, *pair, gap, rate))
    return TradeOffCurve((start, *inner, stop), seconds[0], float(np.median(seconds[1:])) if len(seconds) > 1 else math.nan)


def _end(programme: BalancingProgramme, first: Term, second: Term) -> Optimum:
    """Return the optimum of the first measure and, at that value, of the second one."""
    best = optimum(programme, [(first, 1.0)])
    if best.certificate.status != "optimal":
        return best
    cp = programme.cp
    bound = programme.expression(first) <= best.value + END
    then = solved(cp.Problem(cp.Minimize(programme.expression(second)), [*programme.constraints(), bound]))
    if then.status != "optimal":
        return best
    x = _Lightest(programme, [first, second]).like(programme.found)
    return Optimum(x, best.value, best.certificate, best.prices)
