"""Infeasibility analysis: conflicting limits and the least relaxation of each that makes the problem feasible.

An elastic programme adds a slack to every limit. Limits with positive slack are enforced one after the other until the enforced
ones conflict (elastic filter); limits that are not needed for the conflict are removed (deletion filter); each of the rest is
relaxed alone, in its own unit, with all other limits enforced.

References
----------
J. W. Chinneck and E. W. Dravnieks, Locating minimal infeasible constraint sets in linear programs, ORSA J. Computing 3 (1991)
157-168.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import casadi
import numpy as np
from numpy.typing import NDArray

from optlink.linkage.fourbar import LENGTHS
from optlink.optimization.constraints import DEGREES, PLAIN, ConstraintRow, Scale
from optlink.optimization.nlp import NLP, Variable
from optlink.problem.function import EPIGRAPH
from optlink.solvers.contract import BACKENDS, backend
from optlink.solvers.multistart import starts
from optlink.solvers.solution import Relaxation, key_of

Array = NDArray[np.float64]

MET = 1e-6  # total slack, in scaled units, below which a set of limits counts as feasible
STARTS, LOOKED_AT = 6, 256  # starting points used, of those sampled: the first at which every limit is finite
FREE = 1e3  # upper bound of a slack, in scaled units
ENOUGH = 3  # number of searches that end at the same least slack before it is accepted
AGREEING = 2  # the same for the relaxation of one limit of a large NLP
SAME = 1e-4  # relative difference of slacks that count as equal
EXCHANGES, FOLLOWED = 5, 1e-4  # rounds of the exchange method, and the violation (scaled) at the peaks that ends them

Follow = Callable[[Array], Array]


@dataclass(frozen=True)
class LimitSide:
    """One side of one limit: the rows (and bounds) that share it."""

    key: str
    name: str
    upper: bool
    rows: tuple[int, ...]
    variables: tuple[int, ...]
    bound: float
    scale: Scale


@dataclass(frozen=True)
class Explanation:
    """Reason for infeasibility.

    `conflict`: limits that cannot be satisfied together, each with its least relaxation alone (all other limits enforced).
    `together`: the least relaxation of several limits at once (least sum, scaled), which the design `x` needs.
    """

    x: Array
    conflict: tuple[Relaxation, ...]
    together: tuple[Relaxation, ...]


def limit_sides(nlp: NLP) -> list[LimitSide]:
    """Return every side of every limit that can conflict; rows of one limit and one side are combined.

    Bounds of variables without influence on any limit are left out, as are bounds of an angle over a full revolution.
    """
    found: dict[tuple[str, str, bool], list[int]] = {}
    for j, row in enumerate(nlp.rows):
        if row.limit == EPIGRAPH or row.limit in nlp.states:
            continue
        for upper, bound in ((False, row.low), (True, row.high)):
            if math.isfinite(bound):
                found.setdefault((row.limit, row.label, upper), []).append(j)
    result = []
    for (key, name, upper), rows in found.items():
        row = nlp.rows[rows[0]]
        result.append(LimitSide(key, name, upper, tuple(rows), (), row.high if upper else row.low, row.scale))
    asked = [j for j, row in enumerate(nlp.rows) if row.limit != EPIGRAPH]
    used = casadi.which_depends(nlp.g_expression[asked], nlp.x_symbol, 1, False) if asked else [False] * len(nlp.variables)
    for i, variable in enumerate(nlp.variables):
        around = variable.scale is DEGREES and nlp.x_high[i] - nlp.x_low[i] >= 2.0 * math.pi
        if variable.name in nlp.helpers or variable.name in nlp.states or around or not used[i]:
            continue
        for upper, bound in ((False, nlp.x_low[i]), (True, nlp.x_high[i])):
            result.append(LimitSide(key_of(variable.name), variable.name, upper, (), (i,), float(bound), variable.scale))
    return result


def elastic_programme(nlp: NLP, limits: list[LimitSide]) -> NLP:
    """Return the elastic programme: minimise weights . s over x and slacks s >= 0, each limit relaxed by its s.

    Its parameters are the weights (k,), followed by those of the NLP.

    Parameters
    ----------
    nlp : NLP
    limits : list of LimitSide
        The k limits to relax.
    """
    n, k = len(nlp.variables), len(limits)
    x, s = casadi.SX.sym("x", n), casadi.SX.sym("s", k)
    g = casadi.substitute(nlp.g_expression, nlp.x_symbol, x)
    weights = casadi.SX.sym("weights", k)
    # a target value stays one equation with slack to either side: two inequalities would have no interior
    exact = {j: g[j] for side in limits for j in side.rows if nlp.rows[j].low == nlp.rows[j].high}
    for i, side in enumerate(limits):
        for j in exact.keys() & set(side.rows):
            exact[j] = exact[j] + (-s[i] if side.upper else s[i])
    rows = [replace(nlp.rows[j], value=value) for j, value in exact.items()]
    for i, side in enumerate(limits):
        give = -s[i] if side.upper else s[i]
        low, high = (-math.inf, side.bound) if side.upper else (side.bound, math.inf)
        rows += [ConstraintRow(side.key, side.name, g[j] + give, low, high, side.scale) for j in side.rows if j not in exact]
        rows += [ConstraintRow(side.key, side.name, x[j] + give, low, high, side.scale) for j in side.variables]
    rows += [replace(row, value=g[j]) for j, row in enumerate(nlp.rows) if row.limit in nlp.states]
    bounded = np.array([v.name not in nlp.helpers for v in nlp.variables])
    giving = {i for side in limits for i in side.variables}
    held = np.array([v.name in nlp.states or (bounded[i] and i not in giving) for i, v in enumerate(nlp.variables)])
    length = np.array([v.name in LENGTHS or v.name.endswith(".length") for v in nlp.variables])
    room = np.where(bounded, np.maximum(nlp.x_high - nlp.x_low, 1.0), 1.0)
    lowest = np.where(length, 1e-3 * nlp.x_low, nlp.x_low - room)  # a length may shrink towards zero, not below
    # helpers keep their bounds, except the largest error, which has no upper bound
    lowest = np.where(held, nlp.x_low, np.where(bounded, lowest, np.where(np.isfinite(nlp.x_low), nlp.x_low, 0.0)))
    highest = np.where(held, nlp.x_high, np.where(bounded, nlp.x_high + room, np.where(np.isfinite(nlp.x_high), nlp.x_high, 1.0)))
    return NLP(
        variables=(*nlp.variables, *(Variable(f"slack {i}", 1.0, PLAIN) for i in range(k))),
        fixed=(),
        rows=tuple(rows),
        measure=nlp.measure,
        x_start=np.concatenate([nlp.x_start, np.zeros(k)]),
        x_low=np.concatenate([lowest, np.zeros(k)]),
        x_high=np.concatenate([highest, np.full(k, FREE)]),
        p=np.concatenate([np.ones(k), nlp.p]),
        x_symbol=casadi.vertcat(x, s),
        p_symbol=casadi.vertcat(weights, nlp.p_symbol),
        f_expression=casadi.dot(weights, s),
        g_expression=casadi.vertcat(*[row.value for row in rows]),
        residual_expression=casadi.SX(1, 1),
    )


class _Search:
    """Searches for the least total slack: some limits are relaxed, others enforced, the rest dropped.

    Both back ends are used, so that the result does not depend on the back end selected. `follow` returns the parameters of the
    NLP with its exchange points at the peaks of a point.
    """

    def __init__(
        self,
        nlp: NLP,
        limits: list[LimitSide],
        points: list[Array],
        names: Sequence[str] = BACKENDS,
        follow: Follow | None = None,
    ) -> None:
        self.follow, self.p = follow, nlp.p.copy()
        self.programme, self.n, self.k = elastic_programme(nlp, limits), len(nlp.variables), len(limits)
        self.points = points
        self.last: list[Array] = []  # end of the previous search
        self.solvers = [backend(name) for name in reversed(names)]
        self.enough, self.amount, self.settled = ENOUGH, False, True

    def least(self, weights: Array, loose: Array) -> tuple[float, Array]:
        """Return the least weighted slack, and x with the slacks; `loose` (k,) are the upper bounds of the slacks.

        The exchange points are moved to the peaks of the solution until all limits hold there too (exchange method): always if
        the solution needs no slack, else if the `amount` is required. `settled` says whether the exchange converged.
        """
        self.programme.x_high[self.n :] = loose  # in place: the compiled functions of the NLP are kept
        total, found = self._searched(weights, loose, self.enough)
        self.settled = self.follow is None
        for _ in range(EXCHANGES):
            if self.follow is None or not math.isfinite(total) or (total > MET and not self.amount):
                break
            self.p = self.follow(found[: self.n]).copy()
            self.settled = self._missed(found, weights) <= FOLLOWED
            if self.settled:
                break
            total, found = self._searched(weights, loose, 1)
        return total, found

    def _missed(self, x: Array, weights: Array) -> float:
        """Return the violation of the relaxed limits at a point (scaled)."""
        nlp = self.programme
        g = nlp.at(x, np.concatenate([weights, self.p])).g
        return float(np.max([nlp.low - g, g - nlp.high, 0.0 * g])) if np.all(np.isfinite(g)) else math.inf

    def _searched(self, weights: Array, loose: Array, enough: int) -> tuple[float, Array]:
        """Return the least weighted slack for fixed exchange points; the search ends when `enough` runs agree."""
        nlp, p = self.programme, np.concatenate([weights, self.p])
        best, found = math.inf, np.full(self.n + self.k, math.inf)
        ends: list[float] = []
        points = [*self.last, *self.points]
        most = len(points)  # after this many searches without a feasible end there is none
        turns = range(len(self.solvers))
        for point, solver in [(point, self.solvers[(i + k) % len(turns)]) for k in turns for i, point in enumerate(points)]:
            x = self._slackened(point, weights, loose)
            for run in (None, solver):  # the point itself may be feasible
                end = x if run is None else run(nlp, x, p).x
                total = float(weights @ end[self.n :]) if self._missed(end, weights) <= MET else math.inf
                if total < best:
                    best, found, self.last = total, end, [end[: self.n]]
                if best <= 1e-9:
                    return best, found
            ends.append(total)
            settled = sum(total <= best * (1.0 + SAME) for total in ends) >= enough
            if settled if math.isfinite(best) else len(ends) >= most:
                break
        return best, found

    def _slackened(self, point: Array, weights: Array, loose: Array) -> Array:
        """Return a point with the slacks that it needs, up to their bounds."""
        nlp = self.programme
        x = np.concatenate([point, np.zeros(self.k)])
        here = nlp.at(x, np.concatenate([weights, self.p]))
        need = np.nan_to_num(np.maximum(0.0, nlp.low - here.g) - np.maximum(0.0, here.g - nlp.high))
        x[self.n :] = np.minimum(np.max(here.jacobian[:, self.n :] * need[:, None], axis=0, initial=0.0), loose)
        return x


def explain(
    nlp: NLP, seed: int = 0, points: list[Array] | None = None, *, quick: bool = False, follow: Follow | None = None
) -> Explanation | Array:
    """Identify the conflicting limits of an infeasible NLP; return the x of a feasible design if one is found.

    The analysis uses local searches from several starting points (`points`, or the start and Sobol points) by both back ends. It
    proves infeasibility only in the sense that none of them found a feasible design.

    Parameters
    ----------
    nlp : NLP
    seed : int
        Seed of the Sobol points.
    points : list of arrays (n,), optional
        Starting points.
    quick : bool
        For large NLPs: use the interior-point method alone, and after the first verdict one search per question, two per amount.
    follow : function, optional
        Function of a point x (n,) that returns the parameters of the NLP with its exchange points at the peaks there.
    """
    limits = limit_sides(nlp)
    k = len(limits)
    search = _Search(nlp, limits, _begin(nlp, seed) if points is None else points, ("ipopt",) if quick else BACKENDS, follow)
    free = np.full(k, FREE)
    search.enough = AGREEING if quick else ENOUGH
    total, x = search.least(np.ones(k), free)
    search.enough = 1 if quick else ENOUGH
    if total <= MET:
        return np.clip(x[: search.n], nlp.x_low, nlp.x_high)
    if not math.isfinite(total):
        return Explanation(search.points[0], (), ())
    slacks = x[search.n :]
    together = [_relaxation(side, float(slack)) for side, slack in zip(limits, slacks, strict=True) if slack > MET]
    together = [replace(item, approximate=follow is not None) for item in together]
    conflict = []
    named = _irreducible(search, free, slacks > MET)
    search.enough, search.amount = AGREEING if quick else ENOUGH, True
    for i in named:
        alone = np.eye(k)[i]
        slack, _ = search.least(alone, FREE * alone)
        conflict.append(replace(_relaxation(limits[i], slack), approximate=not search.settled))
    return Explanation(x[: search.n], tuple(conflict), tuple(together))


def _begin(nlp: NLP, seed: int) -> list[Array]:
    points = starts(nlp, LOOKED_AT, seed)
    return sorted(points, key=lambda point: not np.all(np.isfinite(nlp.values(point, nlp.p)[1])))[:STARTS]


def _irreducible(search: _Search, free: Array, giving: NDArray[np.bool_]) -> list[int]:
    """Return indices of an irreducible infeasible set of limits; `giving` (k,): limits with positive slack at first."""
    k = len(free)
    for i in np.argsort(~giving, kind="stable").tolist():  # a limit that is infeasible on its own is the simplest conflict
        if MET < search.least(np.eye(k)[i], free)[0] < math.inf:
            return [i]
    kept = _conflicting(search, free, giving)
    for i in map(int, np.flatnonzero(kept)):
        kept[i] = 0.0
        if not MET < search.least(kept, free)[0] < math.inf:
            kept[i] = 1.0
    return [int(i) for i in np.flatnonzero(kept)]


def _conflicting(search: _Search, free: Array, giving: NDArray[np.bool_]) -> Array:
    """Return 1 for limits of an infeasible set, 0 for the others (elastic filter); 1 for all if a search fails."""
    held = np.where(giving, 1.0, 0.0)
    while search.least(held, free)[0] <= MET:
        _, x = search.least(1.0 - held, np.where(held > 0.0, 0.0, free))
        giving = (x[search.n :] > MET) & (held == 0.0)
        if not np.all(np.isfinite(x)) or not np.any(giving):
            return np.ones(len(free))
        held[giving] = 1.0
    return held


def _relaxation(side: LimitSide, slack: float) -> Relaxation:
    upper = side.upper != side.scale.cosine
    bound = side.scale.to_display(side.bound)
    relaxed = side.scale.to_display(side.bound + (slack if side.upper else -slack)) if math.isfinite(slack) else math.nan
    return Relaxation(side.name, side.key, "<=" if upper else ">=", bound, relaxed, abs(relaxed - bound), side.scale.unit)
