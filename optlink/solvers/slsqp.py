"""SciPy's SLSQP as a Backend: sequential least-squares quadratic programming with exact first derivatives."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.optimize import fmin_slsqp

from optlink.linkage.vector2d import Array
from optlink.optimization.nlp import NLP, NLPValues
from optlink.problem.function import EPIGRAPH
from optlink.solvers.solution import Attempt

# SLSQP cannot handle undefined values: a very large finite one makes its line search step back
UNDEFINED = 1e20


class _Seen(NamedTuple):
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
        self.target = low[self.equal]
        self.sign = np.concatenate([np.ones(below.size), -np.ones(above.size)])
        self.bound = np.concatenate([low[below], -high[above]])
        self.signed = self.sign[:, None] * self.size
        self.weight, point = 1.0, nlp.at(x, p)
        if point.finite:  # SLSQP starts from a unit Hessian: scaling by the largest true curvature keeps its first step short
            hessian = nlp.hessian(x, p, np.zeros(len(low)))
            bend = float(np.max(np.abs(np.linalg.eigvalsh(hessian)))) if np.all(np.isfinite(hessian)) else math.nan
            self.weight = 1.0 / bend if math.isfinite(bend) and bend > 0.0 else 1.0
        self.slope = self.size * self.weight
        y = x / self.size
        self.key, self.seen = y.tobytes(), self._look(point)

    def at(self, y: Array) -> _Seen:
        """Evaluate the NLP at x = size * y, with derivatives with respect to y."""
        key = y.tobytes()
        if key != self.key:
            self.key, self.seen = key, self._look(self.nlp.at(y * self.size, self.p))
        return self.seen

    def _look(self, point: NLPValues) -> _Seen:
        if not point.finite:
            point = NLPValues(
                point.f if math.isfinite(point.f) else UNDEFINED,
                np.nan_to_num(point.gradient),
                np.nan_to_num(point.g, nan=-UNDEFINED, posinf=UNDEFINED, neginf=-UNDEFINED),
                np.nan_to_num(point.jacobian),
            )
        return _Seen(
            point.f * self.weight,
            point.gradient * self.slope,
            point.g.take(self.equal) - self.target,
            point.jacobian.take(self.equal, axis=0) * self.size,
            self.sign * point.g.take(self.inside) - self.bound,
            self.signed * point.jacobian.take(self.inside, axis=0),
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
    path = [x.copy()]
    low, high = nlp.x_low / view.size, nlp.x_high / view.size
    found, _, count, _, message = fmin_slsqp(  # as `minimize` with less overhead
        lambda y: view.at(y).f,
        x / view.size,
        fprime=lambda y: view.at(y).gradient,
        f_eqcons=(lambda y: view.at(y).equal) if view.equal.size else None,
        fprime_eqcons=lambda y: view.at(y).equal_jacobian,
        f_ieqcons=(lambda y: view.at(y).inside) if view.inside.size else None,
        fprime_ieqcons=lambda y: view.at(y).inside_jacobian,
        bounds=list(zip(low.tolist(), high.tolist(), strict=True)),
        callback=(lambda y: path.append(np.array(y) * view.size)) if track else None,
        acc=(1e-16 if tight else 1e-11) * min(1.0, view.weight),
        iter=300,
        iprint=0,
        full_output=True,
    )
    end = np.clip(np.asarray(found, dtype=float) * view.size, nlp.x_low, nlp.x_high)
    return Attempt(end, int(count), str(message), np.array(path) if track else None)
