"""SciPy's SLSQP behind the Backend contract: sequential least-squares quadratic programming with exact first derivatives."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from optlink.design.nlp import NLP, Point
from optlink.solvers.solution import Attempt

Array = NDArray[np.float64]

# SLSQP has no notion of a point without a value: a very bad finite one makes its line search step back
UNDEFINED = 1e20


def slsqp(nlp: NLP, x: Array, p: Array, *, track: bool = False) -> Attempt:
    """Minimise from x. Iterations stop where the objective no longer changes in its last digits."""
    cache: dict[bytes, Point] = {}

    def at(y: Array) -> Point:
        key = y.tobytes()
        if key not in cache:
            cache.clear()
            cache[key] = nlp.at(y, p)
        return cache[key]

    # SLSQP takes the unit matrix as its first Hessian: measured in the largest true curvature its first step is no leap
    bend = np.linalg.norm(nlp.hessian(x, p, np.zeros(len(nlp.rows))), 2) if at(x).finite else 1.0
    weight = 1.0 / bend if math.isfinite(bend) and bend > 0.0 else 1.0
    low, high = nlp.low, nlp.high
    equal = low == high
    below, above = np.isfinite(low) & ~equal, np.isfinite(high) & ~equal

    def finite(values: Array) -> Array:
        return np.nan_to_num(values, nan=-UNDEFINED, posinf=UNDEFINED, neginf=-UNDEFINED)

    constraints = []
    if equal.any():
        constraints.append(
            {
                "type": "eq",
                "fun": lambda y: finite(at(y).g[equal] - low[equal]),
                "jac": lambda y: np.nan_to_num(at(y).jacobian[equal]),
            }
        )
    if below.any() or above.any():
        constraints.append(
            {
                "type": "ineq",
                "fun": lambda y: finite(np.concatenate([at(y).g[below] - low[below], high[above] - at(y).g[above]])),
                "jac": lambda y: np.nan_to_num(np.vstack([at(y).jacobian[below], -at(y).jacobian[above]])),
            }
        )
    path = [x.copy()]

    def objective(y: Array) -> float:
        f = float(at(y).f * weight)
        return f if math.isfinite(f) else UNDEFINED

    result = minimize(
        objective,
        x,
        jac=lambda y: np.nan_to_num(at(y).gradient * weight),
        bounds=list(zip(nlp.x_low, nlp.x_high, strict=True)),
        constraints=constraints,
        method="SLSQP",
        callback=(lambda y: path.append(np.array(y))) if track else None,
        options={"ftol": 1e-11, "maxiter": 300},
    )
    end = np.clip(np.asarray(result.x, dtype=float), nlp.x_low, nlp.x_high)
    return Attempt(end, int(result.nit), str(result.message), np.array(path) if track else None)
