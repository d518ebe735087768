"""SciPy's SLSQP as a Backend: sequential least-squares quadratic programming with exact first derivatives."""

import math

import numpy as np
from scipy.optimize import fmin_slsqp

from optlink.linkage.vector2d import Array, all_finite, max_magnitude
from optlink.optimization.nlp import NLP, SMALLEST_SCALE, NLPValues
from optlink.problem.design import EPIGRAPH
from optlink.solvers.solution import Attempt

# SLSQP cannot handle undefined values: a very large finite one makes its line search step back
UNDEFINED = 1e20


class _View:
    """The NLP in SLSQP's form (f, c = 0, c >= 0), which evaluates each x once."""

    def __init__(self, nlp: NLP, x: Array, p: Array) -> None:
        self.nlp, self.p = nlp, p
        self.size = np.ones(len(x))  # the largest errors of a minimax NLP are small compared with all other variables
        levels = [i for i, variable in enumerate(nlp.variables) if variable.name.startswith(EPIGRAPH)]
        self.size[levels] = np.maximum(np.abs(x[levels]), SMALLEST_SCALE)
        low, high = nlp.low, nlp.high
        below = np.flatnonzero(np.isfinite(low) & (low != high))
        above = np.flatnonzero(np.isfinite(high) & (low != high))
        self.equalities = np.flatnonzero(low == high)
        self.inequalities = np.concatenate([below, above])
        self.target = low[self.equalities]
        self.sign: Array = np.concatenate([np.ones(below.size), -np.ones(above.size)])
        self.bound: Array = np.concatenate([low[below], -high[above]])
        self.signed = self.sign[:, None] * self.size
        self.weight, point = 1.0, nlp.at(x, p)
        if point.finite:  # SLSQP starts from a unit Hessian: scaling by the largest true curvature keeps its first step short
            hessian = nlp.hessian(x, p, np.zeros(len(low)))
            bend = max_magnitude(np.linalg.eigvalsh(hessian)) if all_finite(hessian) else math.nan
            self.weight = 1.0 / bend if math.isfinite(bend) and bend > 0.0 else 1.0
        self.slope = self.size * self.weight
        self.key, self.point = (x / self.size).tobytes(), _defined(point)

    def at(self, y: Array) -> NLPValues:
        """Evaluate the NLP at x = size * y, everything finite."""
        key = y.tobytes()
        if key != self.key:
            self.key, self.point = key, _defined(self.nlp.at(y * self.size, self.p))
        return self.point

    def f(self, y: Array) -> float:
        """Objective."""
        return self.at(y).f * self.weight

    def gradient(self, y: Array) -> Array:
        """Its derivatives with respect to y."""
        return self.at(y).gradient * self.slope

    def equal(self, y: Array) -> Array:
        """Rows that must vanish."""
        return self.at(y).g.take(self.equalities) - self.target

    def equal_jacobian(self, y: Array) -> Array:
        """Their derivatives with respect to y."""
        return self.at(y).jacobian.take(self.equalities, axis=0) * self.size

    def inside(self, y: Array) -> Array:
        """Rows that must not be negative."""
        return self.sign * self.at(y).g.take(self.inequalities) - self.bound

    def inside_jacobian(self, y: Array) -> Array:
        """Their derivatives with respect to y."""
        return self.signed * self.at(y).jacobian.take(self.inequalities, axis=0)


def _defined(point: NLPValues) -> NLPValues:
    """Replace undefined values by very large ones."""
    if point.finite:
        return point
    return NLPValues(
        point.f if math.isfinite(point.f) else UNDEFINED,
        np.nan_to_num(point.gradient),
        np.nan_to_num(point.g, nan=-UNDEFINED, posinf=UNDEFINED, neginf=-UNDEFINED),
        np.nan_to_num(point.jacobian),
    )


def slsqp(nlp: NLP, x: Array, p: Array, *, track: bool = False, tight: bool = False) -> Attempt:
    """Minimise from x with SLSQP until the objective changes only in its last digits: by 1e-11, if `tight` by 1e-16."""
    view = _View(nlp, x, p)
    path = [x.copy()]
    low, high = nlp.x_low / view.size, nlp.x_high / view.size
    end, _, count, _, message = fmin_slsqp(  # as `minimize` with less overhead
        view.f,
        x / view.size,
        fprime=view.gradient,
        f_eqcons=view.equal if view.equalities.size else None,
        fprime_eqcons=view.equal_jacobian,
        f_ieqcons=view.inside if view.inequalities.size else None,
        fprime_ieqcons=view.inside_jacobian,
        bounds=list(zip(low.tolist(), high.tolist(), strict=True)),
        callback=(lambda y: path.append(np.array(y) * view.size)) if track else None,
        acc=(1e-16 if tight else 1e-11) * min(1.0, view.weight),
        iter=300,
        iprint=0,
        full_output=True,
    )
    end = np.clip(np.asarray(end, dtype=float) * view.size, nlp.x_low, nlp.x_high)
    return Attempt(end, int(count), str(message), np.array(path) if track else None)
