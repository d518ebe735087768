"""Newton's method on the optimality conditions, with exact second derivatives: the last digits of an optimum.

A back end stops within its tolerance of the optimum; from there two or three steps on the system of the active limits reach
rounding error, which is what makes two back ends comparable to 1e-6 mm and multipliers exact.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from optlink.optimization.nlp import NLP, Point
from optlink.solvers.solution import FEASIBLE, Attempt, stationarity, violation

Array = NDArray[np.float64]

NEAR = 1e-4  # a limit this close (scaled units), with a multiplier of the right sign, is taken as active
MAX_STEPS = 6
TRIES = 3  # active sets: a limit that is missed at the end joins the next
LONGEST_STEP = 1e-2  # further away is no polishing but another search
CONVERGED = 1e-10
ROUNDING = 1e-14
NOISE = 1e-14  # of the largest second derivative: how exactly a gradient can vanish


def polish(nlp: NLP, attempt: Attempt, p: Array, near: float = NEAR) -> Attempt:
    """Refine an attempt, limits that are `near` being active; one that does not become better is returned as it was."""
    x = attempt.x
    begin = nlp.at(x, p)
    if not begin.finite:
        return attempt
    proof = stationarity(nlp, x, begin, near)
    allowed = max(FEASIBLE, violation(nlp, x, begin.g))
    active = np.array(proof.active, dtype=int)
    for _ in range(TRIES):
        found = _refined(nlp, x, p, begin, active, proof.multipliers.copy())
        if found is None:
            return attempt
        y, here, settled = found
        values = np.concatenate([y, here.g])
        missed = np.flatnonzero(np.maximum(nlp.lower - values, values - nlp.upper) > allowed)
        if not missed.size:
            worse = stationarity(nlp, y, here).kkt > max(proof.kkt, settled) or here.f > begin.f + 1e-3 * abs(begin.f)
            return attempt if worse else replace(attempt, x=y)
        if np.any(np.isin(missed, active)):
            return attempt
        active = np.sort(np.concatenate([active, missed]))
    return attempt


def _refined(
    nlp: NLP, x: Array, p: Array, begin: Point, active: NDArray[np.intp], multipliers: Array
) -> tuple[Array, Point, float] | None:
    """The best of Newton's steps with an active set, what is there, and how far the residual can settle; None if it does not."""
    n, here = len(x), begin
    rows = active[active >= n] - n
    values = np.concatenate([x, begin.g])
    bound = np.where(nlp.upper - values <= values - nlp.lower, nlp.upper, nlp.lower)[active]
    unit = np.eye(n)
    y, last, stiffness, worse, best = x, np.inf, 0.0, 0, (x, begin)
    for _ in range(MAX_STEPS):
        jacobian = np.vstack([unit, here.jacobian])[active]
        missing = np.concatenate([y, here.g])[active] - bound
        residual = np.concatenate([here.gradient + jacobian.T @ multipliers[active], missing])
        size = float(np.max(np.abs(residual), initial=0.0))
        worse = 0 if size < 0.5 * last else worse + 1
        if worse > 1:  # once may be: along a curved valley every other step mends what the one before did to the limits
            break
        if worse == 0:
            last, best = size, (y, here)
        if size <= ROUNDING:
            break
        weights = np.zeros(len(here.g))
        weights[rows] = multipliers[rows + n]
        hessian = nlp.hessian(y, p, weights)
        stiffness = max(stiffness, float(np.max(np.abs(hessian), initial=0.0)))
        step = newton(hessian, jacobian, residual)
        if step is None:
            break
        y = np.clip(y + step[:n], nlp.x_low, nlp.x_high)
        multipliers[active] += step[n:]
        here = nlp.at(y, p)
        if not here.finite or float(np.max(np.abs(y - x))) > LONGEST_STEP:
            return None
    settled = max(CONVERGED, NOISE * stiffness)
    return (*best, settled) if last <= settled else None


def newton(hessian: Array, jacobian: Array, residual: Array) -> Array | None:
    """Step of the optimality system; least squares where limits depend on one another or the objective is flat."""
    k = len(jacobian)
    system = np.block([[hessian, jacobian.T], [jacobian, np.zeros((k, k))]])
    if not np.all(np.isfinite(system)):
        return None
    try:
        step = np.linalg.solve(system, -residual)
        if np.max(np.abs(step)) < 1.0:
            return step
    except np.linalg.LinAlgError:
        pass
    return np.asarray(np.linalg.lstsq(system, -residual, rcond=1e-12)[0], dtype=float)
