"""Newton's method on the KKT system with exact second derivatives, to refine an optimum to rounding error.

A back end stops within its tolerance of the optimum; two or three Newton steps on the system of the active limits reach rounding
error, which makes two back ends comparable to 1e-6 mm and the multipliers exact.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from optlink.linkage.vector2d import Array
from optlink.optimization.nlp import NLP, NLPValues
from optlink.solvers.solution import FEASIBLE, Attempt, Stationarity, stationarity, violation

NEAR = 1e-4  # a limit this close (scaled units), with a multiplier of the right sign, counts as active
MAX_STEPS = 6
TRIES = 3  # active sets: a limit violated at the end is added to the next set
LONGEST_STEP = 1e-2  # a longer step is rejected: it leaves the neighbourhood of the optimum
CONVERGED = 1e-10
ROUNDING = 1e-14
SHORTEST_STEP = 1e-9  # after a step this short the error is its square: rounding
NOISE = 1e-14  # share of the largest second derivative: rounding error of the gradient


class Refined(NamedTuple):
    """A point (n,), the NLP there, and its optimality conditions if the point has moved."""

    x: Array
    point: NLPValues
    conditions: Stationarity | None = None


def polish(nlp: NLP, attempt: Attempt, p: Array, near: float = NEAR) -> Attempt:
    """Refine an attempt by Newton's method; see `refined`."""
    return replace(attempt, x=refined(nlp, attempt.x, p, nlp.at(attempt.x, p), near).x)


def refined(nlp: NLP, x: Array, p: Array, begin: NLPValues, near: float = NEAR) -> Refined:
    """Refine a point by Newton's method, with limits within `near` (scaled) active; return it unchanged without improvement."""
    same = Refined(x, begin)
    if not begin.finite:
        return same
    conditions = stationarity(nlp, x, begin, near)
    allowed = max(FEASIBLE, violation(nlp, x, begin.g))
    active = np.array(conditions.active, dtype=int)
    for _ in range(TRIES):
        converged = _converged(nlp, x, p, begin, active, conditions.multipliers.copy())
        if converged is not None:
            y, here, threshold = converged
            values = np.concatenate([y, here.g])
            missed = np.flatnonzero(np.maximum(nlp.lower - values, values - nlp.upper) > allowed)
            if missed.size:
                if np.any(np.isin(missed, active)):
                    return same
                active = np.sort(np.concatenate([active, missed]))
                continue
            end = stationarity(nlp, y, here)
            if end.kkt <= max(conditions.kkt, threshold) and here.f <= begin.f + 1e-3 * abs(begin.f):
                return Refined(y, here, end)
        touching = stationarity(nlp, x, begin, FEASIBLE).active
        if len(touching) >= active.size:
            return same
        active = np.array(touching, dtype=int)  # a limit that is only near can have a multiplier of zero
    return same


def _converged(
    nlp: NLP, x: Array, p: Array, begin: NLPValues, active: NDArray[np.intp], multipliers: Array
) -> tuple[Array, NLPValues, float] | None:
    """Return the best Newton iterate of an active set, its values, and the residual tolerance; None without convergence."""
    n, here = len(x), begin
    rows = active[active >= n] - n
    values = np.concatenate([x, begin.g])
    bound = np.where(nlp.upper - values <= values - nlp.lower, nlp.upper, nlp.lower)[active]
    unit = np.eye(n)
    y, last, stiffness, worse, best, moved = x, np.inf, 0.0, 0, (x, begin), np.inf
    for _ in range(MAX_STEPS):
        jacobian = np.vstack([unit, here.jacobian])[active]
        missing = np.concatenate([y, here.g])[active] - bound
        residual = np.concatenate([here.gradient + jacobian.T @ multipliers[active], missing])
        size = float(np.max(np.abs(residual), initial=0.0))
        worse = 0 if size < 0.5 * last else worse + 1
        if worse > 1:  # one increase is allowed: along a curved valley every other step restores the limits
            break
        if worse == 0:
            last, best = size, (y, here)
        if size <= ROUNDING or (moved <= SHORTEST_STEP and last <= CONVERGED):
            break
        weights = np.zeros(len(here.g))
        weights[rows] = multipliers[rows + n]
        hessian = nlp.hessian(y, p, weights)
        stiffness = max(stiffness, float(np.max(np.abs(hessian), initial=0.0)))
        step = newton(hessian, jacobian, residual)
        if step is None:
            break
        moved = float(np.max(np.abs(step[:n])))
        y = np.clip(y + step[:n], nlp.x_low, nlp.x_high)
        multipliers[active] += step[n:]
        here = nlp.at(y, p)
        if not here.finite or float(np.max(np.abs(y - x))) > LONGEST_STEP:
            return None
    threshold = max(CONVERGED, NOISE * stiffness)
    return (*best, threshold) if last <= threshold else None


def newton(hessian: Array, jacobian: Array, residual: Array) -> Array | None:
    """Return the Newton step of variables and multipliers (n + k,) of the KKT system; None if the system is not finite.

    `hessian` is that of the Lagrangian, `jacobian` (k, n) that of the active limits; `residual` (n + k,) is the gradient of the
    Lagrangian, then the active limits minus their bounds. A least-squares solution is used where limits are linearly dependent or
    the objective is flat.
    """
    n = len(hessian)
    system = np.zeros((len(residual), len(residual)))
    system[:n, :n], system[:n, n:], system[n:, :n] = hessian, jacobian.T, jacobian
    if not np.all(np.isfinite(system)):
        return None
    try:
        step = np.asarray(np.linalg.solve(system, -residual), dtype=float)
        if np.max(np.abs(step)) < 1.0:
            return step
    except np.linalg.LinAlgError:
        pass
    return np.asarray(np.linalg.lstsq(system, -residual, rcond=1e-12)[0], dtype=float)
