"""Newton's method on the optimality conditions, with exact second derivatives: the last digits of an optimum.

A back end stops within its tolerance of the optimum; from there two or three steps on the system of the active limits reach
rounding error, which is what makes two back ends comparable to 1e-6 mm and multipliers exact.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from optlink.design.nlp import NLP
from optlink.solvers.solution import FEASIBLE, Attempt, stationarity, violation

Array = NDArray[np.float64]

NEAR = 1e-4  # a limit this close (scaled units), with a multiplier of the right sign, is taken as active
MAX_STEPS = 6
LONGEST_STEP = 1e-2  # further away is no polishing but another search
ROUNDING = 1e-14


def polish(nlp: NLP, attempt: Attempt, p: Array) -> Attempt:
    """Refine an attempt; one that does not become better is returned as it was."""
    x = attempt.x
    point = nlp.at(x, p)
    if not point.finite:
        return attempt
    proof = stationarity(nlp, x, point, NEAR)
    active = proof.active
    multipliers = proof.multipliers[active]
    lower, upper = nlp.lower, nlp.upper
    n, k = len(x), len(active)
    values = np.concatenate([x, point.g])
    bound = np.where(upper - values <= values - lower, upper, lower)[active]
    y, best = x, np.inf
    for _ in range(MAX_STEPS):
        here = nlp.at(y, p)
        if not here.finite:
            break
        jacobian = np.vstack([np.eye(n), here.jacobian])[active]
        rows = np.concatenate([y, here.g])[active] - bound
        residual = np.concatenate([here.gradient + jacobian.T @ multipliers, rows])
        size = float(np.max(np.abs(residual), initial=0.0))
        if size >= 0.5 * best:
            break
        best = size
        if size <= ROUNDING:
            break
        full = np.zeros(len(values) - n)
        for i, multiplier in zip(active, multipliers, strict=True):
            if i >= n:
                full[i - n] = multiplier
        hessian = nlp.hessian(y, p, full)
        if not np.all(np.isfinite(hessian)):
            break
        system = np.block([[hessian, jacobian.T], [jacobian, np.zeros((k, k))]])
        step = np.linalg.lstsq(system, -residual, rcond=1e-12)[0]
        y, multipliers = np.clip(y + step[:n], nlp.x_low, nlp.x_high), multipliers + step[n:]
        if float(np.max(np.abs(y - x))) > LONGEST_STEP:
            return attempt
    there = nlp.at(y, p)
    if not there.finite or violation(nlp, y, there.g) > max(FEASIBLE, violation(nlp, x, point.g)):
        return attempt
    after, before = stationarity(nlp, y, there).kkt, stationarity(nlp, x, point).kkt
    worse = after >= before or there.f > point.f + 1e-3 * abs(point.f)
    return attempt if worse else replace(attempt, x=y)
