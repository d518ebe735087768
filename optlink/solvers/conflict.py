"""Why no design is feasible: which limits conflict, and the least relaxation of each that would make the problem feasible.

An elastic programme gives every limit a slack of its own; a deletion filter finds an irreducible conflicting set; then each of
its members is relaxed alone, in its own unit, while all other limits hold.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import casadi
import numpy as np
from numpy.typing import NDArray

from optlink.design.constraints import PLAIN, Row, Scale
from optlink.design.nlp import NLP, Variable
from optlink.design.problem import EPIGRAPH
from optlink.linkage.fourbar import LENGTHS
from optlink.solvers.search import BACKENDS, backend, starts
from optlink.solvers.solution import key_of

Array = NDArray[np.float64]

MET = 1e-6  # total slack, in scaled units, below which a set of limits counts as feasible
STARTS = 6
FREE = 1e3  # upper bound of a slack, in scaled units


@dataclass(frozen=True)
class Side:
    """One side of one limit: the rows (and the bounds) that share it."""

    key: str
    name: str
    upper: bool
    rows: tuple[int, ...]
    variables: tuple[int, ...]
    bound: float
    scale: Scale


@dataclass(frozen=True)
class Relaxation:
    """A limit that would have to give, in people's units: from `bound` to `relaxed`, which is `amount` further.

    NaN where relaxing this limit alone does not make the problem feasible.
    """

    key: str
    name: str
    sense: str
    bound: float
    relaxed: float
    amount: float
    unit: str


@dataclass(frozen=True)
class Explanation:
    """Why there is no design. `conflict`: limits that cannot hold together, each with its least relaxation alone (all other
    limits of the problem held). `together`: the least relaxation when several may give at once (least sum, scaled), which the
    design `x` needs.
    """

    x: Array
    conflict: tuple[Relaxation, ...]
    together: tuple[Relaxation, ...]


def sides(nlp: NLP) -> list[Side]:
    """Every side of every limit that can conflict: rows of one limit and one side go together."""
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
        result.append(Side(key, name, upper, tuple(rows), (), row.high if upper else row.low, row.scale))
    for i, variable in enumerate(nlp.variables):
        if variable.name in nlp.helpers or variable.name in nlp.states:
            continue
        for upper, bound in ((False, nlp.x_low[i]), (True, nlp.x_high[i])):
            result.append(Side(key_of(variable.name), variable.name, upper, (), (i,), float(bound), variable.scale))
    return result


def elastic(nlp: NLP, limits: list[Side]) -> NLP:
    """minimise weights . s over x and slacks s >= 0, each limit relaxed by its s; the weights are the parameters p[0:k]."""
    n, k = len(nlp.variables), len(limits)
    x, s = casadi.SX.sym("x", n), casadi.SX.sym("s", k)
    g = casadi.substitute(nlp.g_expression, nlp.x_symbol, x)
    g = casadi.substitute(g, nlp.p_symbol, casadi.SX(nlp.p))
    weights = casadi.SX.sym("weights", k)
    # a wanted value stays one equation, which may be missed to either side: two inequalities would have no inside
    exact = {j: g[j] for side in limits for j in side.rows if nlp.rows[j].low == nlp.rows[j].high}
    for i, side in enumerate(limits):
        for j in exact.keys() & set(side.rows):
            exact[j] = exact[j] + (-s[i] if side.upper else s[i])
    rows = [replace(nlp.rows[j], value=value) for j, value in exact.items()]
    for i, side in enumerate(limits):
        give = -s[i] if side.upper else s[i]
        low, high = (-math.inf, side.bound) if side.upper else (side.bound, math.inf)
        rows += [Row(side.key, side.name, g[j] + give, low, high, side.scale) for j in side.rows if j not in exact]
        rows += [Row(side.key, side.name, x[j] + give, low, high, side.scale) for j in side.variables]
    rows += [replace(row, value=g[j]) for j, row in enumerate(nlp.rows) if row.limit in nlp.states]
    bounded = np.array([v.name not in nlp.helpers for v in nlp.variables])
    state = np.array([v.name in nlp.states for v in nlp.variables])
    length = np.array([v.name in LENGTHS or v.name.endswith(".length") for v in nlp.variables])
    room = np.where(bounded, np.maximum(nlp.x_high - nlp.x_low, 1.0), 1.0)
    lowest = np.where(length, 1e-3 * nlp.x_low, nlp.x_low - room)  # a length gives way towards zero, never beyond
    lowest = np.where(state, nlp.x_low, np.where(bounded, lowest, 0.0))
    highest = np.where(state, nlp.x_high, np.where(bounded, nlp.x_high + room, 1.0))
    return NLP(
        variables=(*nlp.variables, *(Variable(f"slack {i}", 1.0, PLAIN) for i in range(k))),
        fixed=(),
        rows=tuple(rows),
        measure=nlp.measure,
        x_start=np.concatenate([nlp.x_start, np.zeros(k)]),
        x_low=np.concatenate([lowest, np.zeros(k)]),
        x_high=np.concatenate([highest, np.full(k, FREE)]),
        p=np.ones(k),
        x_symbol=casadi.vertcat(x, s),
        p_symbol=weights,
        f_expression=casadi.dot(weights, s),
        g_expression=casadi.vertcat(*[row.value for row in rows]),
        residual_expression=casadi.SX(1, 1),
    )


class _Search:
    """Least total slack of the limits that may give, the others hard, the dropped ones free.

    Both back ends are asked, so that the answer does not depend on which one the user chose.
    """

    def __init__(self, nlp: NLP, limits: list[Side], points: list[Array]) -> None:
        self.programme, self.n, self.k = elastic(nlp, limits), len(nlp.variables), len(limits)
        self.points = points
        self.solvers = [backend(name) for name in reversed(BACKENDS)]

    def least(self, weights: Array, loose: Array) -> tuple[float, Array]:
        """The least weighted slack, and x with the slacks; `loose` (k,) are the upper bounds of the slacks."""
        nlp = self.programme
        nlp.x_high[self.n :] = loose  # in place: what is compiled for the programme is kept
        best, found = math.inf, np.full(self.n + self.k, math.inf)
        for point in self.points:
            x = np.concatenate([point, np.zeros(self.k)])
            here = nlp.at(x, weights)
            need = np.nan_to_num(np.maximum(0.0, nlp.low - here.g) - np.maximum(0.0, here.g - nlp.high))
            x[self.n :] = np.minimum(np.max(here.jacobian[:, self.n :] * need[:, None], axis=0, initial=0.0), loose)
            for solver in (None, *self.solvers):  # the point itself may do already
                end = x if solver is None else solver(nlp, x, weights).x
                g = nlp.at(end, weights).g
                missed = float(np.max([nlp.low - g, g - nlp.high, 0.0 * g])) if np.all(np.isfinite(g)) else math.inf
                total = float(weights @ end[self.n :])
                if missed <= MET and total < best:
                    best, found = total, end
                if best <= 1e-9:
                    return best, found
        return best, found


def explain(nlp: NLP, seed: int = 0, points: list[Array] | None = None) -> Explanation | Array:
    """Name the conflict of an infeasible programme, or give the x of a feasible design where there is one after all.

    Local searches from several starts by both back ends (from `points`, or the start and Sobol points): a proof only in the sense
    that none of them found a design.
    """
    limits = sides(nlp)
    k = len(limits)
    search = _Search(nlp, limits, starts(nlp, STARTS, seed) if points is None else points)
    free = np.full(k, FREE)
    total, x = search.least(np.ones(k), free)
    if total <= MET:
        return np.clip(x[: search.n], nlp.x_low, nlp.x_high)
    slacks = x[search.n :]
    together = [_relaxation(side, float(slack)) for side, slack in zip(limits, slacks, strict=True) if slack > MET]
    conflict = []
    for i in _irreducible(search, k, free):
        alone = np.eye(k)[i]
        slack, _ = search.least(alone, FREE * alone)
        conflict.append(_relaxation(limits[i], slack))
    return Explanation(x[: search.n], tuple(conflict), tuple(together))


def _irreducible(search: _Search, k: int, free: Array) -> list[int]:
    """Indices of limits that cannot hold together while every part of them can (deletion filter)."""
    for i in range(k):  # a limit that nothing can meet is the clearest of all conflicts
        if search.least(np.eye(k)[i], free)[0] > MET:
            return [i]
    kept = np.ones(k)
    for i in range(k):
        kept[i] = 0.0
        if search.least(kept, free)[0] <= MET:
            kept[i] = 1.0
    return [int(i) for i in np.flatnonzero(kept)]


def _relaxation(side: Side, slack: float) -> Relaxation:
    upper = side.upper != side.scale.cosine
    bound = side.scale.people(side.bound)
    relaxed = side.scale.people(side.bound + (slack if side.upper else -slack)) if math.isfinite(slack) else math.nan
    return Relaxation(side.key, side.name, "<=" if upper else ">=", bound, relaxed, abs(relaxed - bound), side.scale.unit)
