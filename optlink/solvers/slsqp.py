"""SciPy's SLSQP as a Backend: sequential least-squares quadratic programming with exact first derivatives."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from optlink.optimization.nlp import NLP, NLPValues
from optlink.problem.function import EPIGRAPH
from optlink.solvers.solution import Attempt

Array = NDArray[np.float64]

# SLSQP cannot handle undefined values: a very large finite one makes its line search step back
UNDEFINED = 1e20


@dataclass(frozen=True)
class _Seen:
    """The NLP at one x in SLSQP's form: f, c_eq = 0, c_in >= 0, everything finite."""

    f: float
    gradient: Array
    equal: Array
    equal_jacobian: Array
    inside: Array
    inside_jacobian: Array


class _View:
    """Adapter of the NLP for SLSQP that evaluates each x once."""

    def __init__(self, nlp: NLP, x: Array, p: Array) -> None:
        self.nlp, self.p = nlp, p
        self.size = np.ones(len(x))  # the largest error of a minimax NLP is small compared with all other variables
        if nlp.variables[-1].name == EPIGRAPH:
            self.size[-1] = p[0]
        low, high = nlp.low, nlp.high
        below = np.flatnonzero(np.isfinite(low) & (low != high))
        above = np.flatnonzero(np.isfinite(high) & (low != high))
        self.equal = np.flatnonzero(low == high)
        self.inside = np.concatenate([below, above])
        self.sign = np.concatenate([np.ones(below.size), -np.ones(above.size)])
        self.bound = np.concatenate([low[below], -high[above]])
        self.signed = self.sign[:, None] * self.size
        # SLSQP starts from a unit Hessian: scaling by the largest true curvature keeps its first step short
        bend = np.linalg.norm(nlp.hessian(x, p, np.zeros(len(low))), 2) if nlp.at(x, p).finite else 1.0
        self.weight = float(1.0 / bend) if math.isfinite(bend) and bend > 0.0 else 1.0
        self.key, self.seen = b"", self._look(x)

    def at(self, y: Array) -> _Seen:
        """Evaluate the NLP at x = size * y, with derivatives with respect to y."""
        x = y * self.size
        key = x.tobytes()
        if key != self.key:
            self.key, self.seen = key, self._look(x)
        return self.seen

    def _look(self, x: Array) -> _Seen:
        point = self.nlp.at(x, self.p)
        if not point.finite:
            point = NLPValues(
                point.f if math.isfinite(point.f) else UNDEFINED,
                np.nan_to_num(point.gradient),
                np.nan_to_num(point.g, nan=-UNDEFINED, posinf=UNDEFINED, neginf=-UNDEFINED),
                np.nan_to_num(point.jacobian),
            )
        return _Seen(
            point.f * self.weight,
            point.gradient * self.size * self.weight,
            point.g[self.equal] - self.nlp.low[self.equal],
            point.jacobian[self.equal] * self.size,
            self.sign * point.g[self.inside] - self.bound,
            self.signed * point.jacobian[self.inside],
        )


def slsqp(nlp: NLP, x: Array, p: Array, *, track: bool = False, tight: bool = False) -> Attempt:
    """Minimise from x with SLSQP until the objective changes only in its last digits.

    Parameters
    ----------
    nlp : NLP
    x : array (n,)
        Starting point, scaled.
    p : array
        Parameters of the NLP.
    track : bool
        Record the iterates.
    tight : bool
        Use an objective tolerance of 1e-16 instead of 1e-11.
    """
    view = _View(nlp, x, p)
    constraints = []
    if view.equal.size:
        constraints.append({"type": "eq", "fun": lambda y: view.at(y).equal, "jac": lambda y: view.at(y).equal_jacobian})
    if view.inside.size:
        constraints.append({"type": "ineq", "fun": lambda y: view.at(y).inside, "jac": lambda y: view.at(y).inside_jacobian})
    path = [x.copy()]
    low, high = nlp.x_low / view.size, nlp.x_high / view.size
    result = minimize(
        lambda y: view.at(y).f,
        x / view.size,
        jac=lambda y: view.at(y).gradient,
        bounds=list(zip(low, high, strict=True)),
        constraints=constraints,
        method="SLSQP",
        callback=(lambda y: path.append(np.array(y) * view.size)) if track else None,
        options={"ftol": (1e-16 if tight else 1e-11) * min(1.0, view.weight), "maxiter": 300},
    )
    end = np.clip(np.asarray(result.x, dtype=float) * view.size, nlp.x_low, nlp.x_high)
    return Attempt(end, int(result.nit), str(result.message), np.array(path) if track else None)
