"""Minimax optimisation: a trust-region method whose every step is a second-order cone programme.

The largest of many distances |e_i(x)| is not differentiable where several points are equally far. With the deviations linearised
and their distances kept, |e_i + J_i d| <= t is a cone for each point, so a step accounts for every point at once. The curvature
of the deviations enters with the multipliers of the previous step. Limits are linearised; their remaining violation is penalised.
If a step decreases the merit too little, a second-order correction is tried, then the trust region is reduced.

References
----------
K. Madsen and H. Schjaer-Jacobsen, Linearly constrained minimax optimization, Math. Programming 14 (1978) 208-223.
R. Fletcher, Second order corrections for non-differentiable optimization, Lecture Notes in Mathematics 912 (1982) 85-114.
"""

import math
from dataclasses import dataclass, replace
from typing import Any

import casadi
import numpy as np

from optlink.linkage.vector2d import Array, all_finite, max_magnitude
from optlink.optimization.nlp import NLP
from optlink.problem.design import EPIGRAPH
from optlink.solvers.solution import FEASIBLE, Attempt
from optlink.symbolic import CompiledFunction

# Constants of the search for the least largest deviation.
# What a search finds, and how much longer it takes, if one of them is halved or doubled: docs/constants.md.
MOST_STEPS = 100  # cone programmes of a search
FIRST_REACH, LEAST_REACH, MOST_REACH = 0.1, 1e-9, 1.0  # trust-region radius, in scaled units
GOOD, POOR = 0.75, 0.25  # share of the predicted decrease above which the radius may grow, and below which it shrinks
ACCEPTED_DECREASE = 1e-3  # share of the predicted decrease above which a step is accepted
PRICE, DEAREST = 10.0, 1e6  # penalty of a violated limit (scaled) relative to the largest deviation, which is 1 at the start
SPARE = 4.0  # times the multipliers: a sufficient penalty
TOLERANCE = 1e-11  # tolerance of the cone programme
CONVERGED = 1e-10  # predicted decrease, as a share of the deviation, that ends the search


@dataclass(frozen=True)
class _Linearisation:
    """Deviations e (points, k), divided by the first largest one, and limits g (m,) at an x, with their derivatives.

    Derivatives are with respect to all variables but the last.
    """

    e: Array
    by_e: Array
    g: Array
    by_g: Array
    violation: float

    @property
    def largest(self) -> float:
        """Largest distance."""
        return float(np.max(np.linalg.norm(self.e, axis=1)))

    def merit(self, price: float) -> float:
        """Return the merit function: largest distance plus penalised violation."""
        return self.largest + price * self.violation


@dataclass(frozen=True)
class _Step:
    """A step, its predicted merit and violation, and its multipliers: of the deviations (points * k) and of the limits (m,)."""

    d: Array
    merit: float
    violation: float
    by_e: Array
    by_g: Array


class _View:
    """A minimax NLP in terms of deviations and limits."""

    def __init__(self, nlp: NLP, p: Array) -> None:
        self.nlp, self.p, self.width = nlp, p, nlp.measure.width
        keep = [j for j, row in enumerate(nlp.rows) if row.limit != EPIGRAPH]
        self.low, self.high = nlp.low[keep], nlp.high[keep]
        if "minimax" not in nlp.cache:
            x, e = nlp.x_symbol[:-1], nlp.residual_expression
            g = nlp.g_expression[keep] if keep else casadi.SX(0, 1)
            first = CompiledFunction([nlp.x_symbol, nlp.p_symbol], [e, casadi.jacobian(e, x), g, casadi.jacobian(g, x)])
            of_errors, of_limits = casadi.SX.sym("of_errors", e.numel()), casadi.SX.sym("of_limits", g.numel())
            bend = casadi.hessian(casadi.dot(of_errors, e) + casadi.dot(of_limits, g), x)[0]
            nlp.cache["minimax"] = first, CompiledFunction([nlp.x_symbol, nlp.p_symbol, of_errors, of_limits], [bend])
        self.first, self.second = nlp.cache["minimax"]
        self.size = 1.0

    def at(self, y: Array) -> _Linearisation:
        """Evaluate deviations, limits and derivatives at y, which is x without its last component."""
        e, by_e, g, by_g = self.first(np.append(y, 0.0), self.p)
        by_e, by_g = (slopes.reshape(len(y), -1).T for slopes in (by_e, by_g))
        finite = all(all_finite(a) for a in (e, by_e, g, by_g))
        points = e.reshape(-1, self.width) / self.size
        return _Linearisation(points, by_e / self.size, g, by_g, self.violation(g) if finite else math.inf)

    def violation(self, g: Array) -> float:
        """Return the largest violation of a limit."""
        return float(np.max([self.low - g, g - self.high], initial=0.0))

    def bend(self, y: Array, step: _Step) -> Array:
        """Return the positive semidefinite part (n, n) of the Hessian of deviations and limits, weighted with multipliers."""
        n = len(y)
        hessian = self.second(np.append(y, 0.0), self.p, step.by_e / self.size, step.by_g)[0].reshape(n, n)
        if not all_finite(hessian):
            return np.zeros((n, n))
        values, vectors = np.linalg.eigh(0.5 * (hessian + hessian.T))
        return np.asarray((vectors * np.maximum(values, 0.0)) @ vectors.T)


def minimax(nlp: NLP, x: Array, p: Array, *, track: bool = False, tight: bool = False) -> Attempt:
    """Minimise the largest deviation, the last component of x, of an NLP with the measure "max"; always to tight tolerances."""
    view, y, path = _View(nlp, p), x[:-1], [x]
    here = view.at(y)
    if not math.isfinite(here.violation):
        return Attempt(x, 0, "undefined at the start")
    view.size = max(here.largest, nlp.exact)
    here = view.at(y)
    low, high = nlp.x_low[:-1], nlp.x_high[:-1]
    price, reach, message = PRICE, FIRST_REACH, "too many steps"
    bend = np.zeros((len(y), len(y)))
    count = 0
    while count < MOST_STEPS:
        count += 1
        box = np.maximum(low - y, -reach), np.minimum(high - y, reach)
        step = _step(view, here, bend, box, price)
        if step is None:
            message = "no step found"
            break
        price, step = _priced(view, here, bend, box, price, step)
        decrease = here.merit(price) - step.merit
        if decrease <= CONVERGED * here.largest:
            message = "converged"
            break
        there = view.at(np.clip(y + step.d, low, high))
        gained = _gained(here, there, price, decrease)
        if gained < POOR and math.isfinite(there.violation):
            e, g = there.e - (here.by_e @ step.d).reshape(there.e.shape), there.g - here.by_g @ step.d
            corrected = _step(view, replace(here, e=e, g=g), bend, box, price)
            if corrected is not None:
                other = view.at(np.clip(y + corrected.d, low, high))
                if _gained(here, other, price, decrease) > gained:
                    there, step, gained = other, corrected, _gained(here, other, price, decrease)
        length = max_magnitude(step.d)
        if gained > ACCEPTED_DECREASE:
            y, here = np.clip(y + step.d, low, high), there
            bend = view.bend(y, step)
            path += [nlp.lifted(np.append(y, 0.0))] if track else []
        if gained < POOR:
            reach = (0.5 if gained > 0.0 else 0.25) * length
        elif gained > GOOD and length > 0.9 * reach:
            reach = min(2.5 * reach, MOST_REACH)
        if reach < LEAST_REACH or here.largest * view.size <= nlp.exact:
            message = "the steps became too short" if reach < LEAST_REACH else "nothing left to improve"
            break
    return Attempt(nlp.lifted(np.append(y, 0.0)), count, message, np.array(path) if track else None)


def _priced(
    view: _View, here: _Linearisation, bend: Array, box: tuple[Array, Array], price: float, step: _Step
) -> tuple[float, _Step]:
    """Return a penalty weight that halves the reducible violation or is large enough, and the step for it."""
    if here.violation <= FEASIBLE:
        return min(price, max(PRICE, SPARE * float(np.sum(np.abs(step.by_g))))), step
    if step.violation > 0.5 * here.violation:
        most = _step(view, here, bend, box, DEAREST)
        enough = here.violation if most is None else 0.5 * (here.violation + most.violation)
        while step.violation > enough and price < DEAREST:
            price *= 10.0
            step = _step(view, here, bend, box, price) or step
    return price, step


def _gained(here: _Linearisation, there: _Linearisation, price: float, promised: float) -> float:
    """Return the actual decrease of the merit as a share of the predicted one."""
    return (here.merit(price) - there.merit(price)) / promised if math.isfinite(there.violation) else -1.0


def _sparse(dense: Array) -> Any:
    """Return a matrix for the cone programme; scipy takes three times as long from the array itself."""
    from scipy.sparse import csc_matrix

    columns, rows = np.nonzero(dense.T)
    ends = np.searchsorted(columns, np.arange(dense.shape[1] + 1))
    return csc_matrix((dense[rows, columns], rows, ends), dense.shape)


def _step(view: _View, here: _Linearisation, bend: Array, box: tuple[Array, Array], price: float) -> _Step | None:
    """Return the best step within a box; None if the solver finds none."""
    import clarabel

    (points, width), n = here.e.shape, len(box[0])
    cones = np.zeros((points, width + 1, n + 2))
    cones[:, 0, n] = -1.0
    cones[:, 1:, :n] = -here.by_e.reshape(points, width, n)
    above, below = np.isfinite(view.high), np.isfinite(view.low)
    limits = np.concatenate([here.by_g[above], -here.by_g[below], np.zeros((1, n))])
    room = np.concatenate([(view.high - here.g)[above], (here.g - view.low)[below], [0.0]])
    linear = np.hstack([limits, np.zeros((len(limits), 1)), -np.ones((len(limits), 1))])
    sides = np.hstack([np.vstack([np.eye(n), -np.eye(n)]), np.zeros((2 * n, 2))])
    matrix = _sparse(np.vstack([cones.reshape(-1, n + 2), linear, sides]))
    right = np.concatenate([np.column_stack([np.zeros(points), here.e]).ravel(), room, box[1], -box[0]])
    kinds = [clarabel.SecondOrderConeT(width + 1)] * points + [clarabel.NonnegativeConeT(len(room) + 2 * n)]
    square, cost = np.zeros((n + 2, n + 2)), np.zeros(n + 2)
    square[:n, :n] = bend
    cost[n:] = 1.0, price
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = TOLERANCE
    solution = clarabel.DefaultSolver(_sparse(np.triu(square)), cost, matrix, right, kinds, settings).solve()
    z, dual = np.asarray(solution.x, dtype=float), np.asarray(solution.z, dtype=float)
    if not (all_finite(z) and all_finite(dual)):
        return None
    d = np.clip(z[:n], *box)
    e, g = here.e + (here.by_e @ d).reshape(points, width), here.g + here.by_g @ d
    violated = view.violation(g)
    merit = float(np.max(np.linalg.norm(e, axis=1))) + price * violated + 0.5 * float(d @ bend @ d)
    tips = -dual[: points * (width + 1)].reshape(points, width + 1)[:, 1:].ravel()
    box_duals = dual[points * (width + 1) :]
    by_g = np.zeros(len(view.low))
    by_g[above] += box_duals[: above.sum()]
    by_g[below] -= box_duals[above.sum() : above.sum() + below.sum()]
    return _Step(d, merit, violated, tips, by_g)
