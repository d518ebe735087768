"""Feasibility repair of a starting point by Gauss-Newton steps on the violated limits."""

import math

import numpy as np
from numpy.typing import NDArray

from optlink.linkage.vector2d import Array
from optlink.optimization.nlp import NLP
from optlink.problem.design import EPIGRAPH
from optlink.solvers.solution import FEASIBLE, violation

INSIDE = 1e-3  # distance (scaled units) to aim for inside a limit: at the limit a dead centre may have no derivative
MAX_STEPS = 60
LONGEST_STEP = 0.5


def repair(nlp: NLP, x: Array, p: Array, inside: float = INSIDE) -> Array | None:
    """Return a feasible x with a finite objective near a start, `inside` the limits if it moved; None if a violation remains."""
    low, high = nlp.low, nlp.high
    inset = np.minimum(inside, 0.25 * (high - low))
    low_inside, high_inside = low + inset, high - inset
    x = np.clip(x, nlp.x_low, nlp.x_high)
    limited = np.array([row.limit != EPIGRAPH for row in nlp.rows], dtype=bool)  # the others follow from lifting x
    for _ in range(MAX_STEPS):
        x = nlp.lifted(x)
        point = nlp.at(x, p)
        if math.isfinite(point.f) and violation(nlp, x, point.g) <= FEASIBLE:
            return x
        miss = np.maximum(low_inside - point.g, 0.0) + np.minimum(high_inside - point.g, 0.0)
        rows = np.flatnonzero(limited & np.isfinite(miss) & (miss != 0.0) & np.isfinite(point.jacobian).all(axis=1))
        if rows.size == 0:
            return None
        rows = _worst(nlp, rows, miss)
        step = _shortest(point.jacobian[rows], miss[rows], nlp.x_low - x, nlp.x_high - x)
        length = float(np.linalg.norm(step))
        if length < 1e-13:
            return None
        x = np.clip(x + step * min(1.0, LONGEST_STEP / length), nlp.x_low, nlp.x_high)
    return None


def _worst(nlp: NLP, rows: NDArray[np.intp], miss: Array) -> NDArray[np.intp]:
    """Return the most violated row of every limit.

    The rows of one limit at neighbouring positions are nearly dependent: a step that meets all of them exactly leads far away.
    """
    order = rows[np.argsort(-np.abs(miss[rows]), kind="stable")]
    worst = {(nlp.rows[j].limit, nlp.rows[j].label, bool(miss[j] > 0.0)): j for j in reversed(order.tolist())}
    return np.array(sorted(worst.values()), dtype=np.intp)


def _shortest(jacobian: Array, miss: Array, low: Array, high: Array) -> Array:
    """Return the least-norm step with jacobian @ step = miss (least squares), components limited to low ... high."""
    step = np.zeros(jacobian.shape[1])
    free = np.ones(step.size, dtype=bool)
    while free.any():
        rest = miss - jacobian[:, ~free] @ step[~free]
        step[free] = np.linalg.lstsq(jacobian[:, free], rest, rcond=1e-10)[0]
        out = free & ((step < low) | (step > high))
        if not out.any():
            break
        step[out] = np.clip(step[out], low[out], high[out])
        free &= ~out
    return step
