"""Searches with independent equations: those that hold wherever the others do are left out, as solvers expect.

An example is the stroke of 100 mm of an in-line slider whose crank is fixed at 50 mm: every design meets it, and its gradient is
zero. The systems of linear equations of the solvers are then singular.
"""

import math

import numpy as np
from numpy.typing import NDArray

from optlink.linkage.vector2d import Array
from optlink.optimization.nlp import NLP
from optlink.solvers.solution import Attempt, Backend

DEPENDENT = 1e-7  # distance of a gradient (or, above 1, share of it) from a combination of others that counts as dependent
MET = 1e-6  # violation, in scaled units, up to which an equation that was left out holds


def independent(solver: Backend) -> Backend:
    """Return a back end that leaves out dependent equations, unless they fail at the end of the search."""

    def search(nlp: NLP, x: Array, p: Array, *, track: bool = False, tight: bool = False) -> Attempt:
        rows = dependent_equations(nlp, x, p)
        if rows.size:
            entries, values = len(nlp.x_low) + rows, nlp.low[rows]
            try:
                for entry in entries.tolist():
                    nlp.limit(entry, -math.inf, math.inf)
                attempt = solver(nlp, x, p, track=track, tight=tight)
            finally:
                for entry, value in zip(entries.tolist(), values.tolist(), strict=True):
                    nlp.limit(entry, value, value)
            if np.all(np.abs(nlp.values(attempt.x, p)[1][rows] - values) <= MET):
                return attempt
        return solver(nlp, x, p, track=track, tight=tight)

    return search


def dependent_equations(nlp: NLP, x: Array, p: Array) -> NDArray[np.intp]:
    """Return the rows of equations that hold at a point and whose gradients there depend on those of earlier ones."""
    equations = np.flatnonzero(nlp.low == nlp.high)
    if not equations.size:
        return equations
    point = nlp.at(x, p)
    if not point.finite:
        return equations[:0]
    basis, dependent = np.zeros((0, len(x))), []
    for j in equations.tolist():
        gradient = point.jacobian[j]
        rest = gradient - basis.T @ (basis @ gradient)
        rest -= basis.T @ (basis @ rest)
        size = float(np.linalg.norm(rest))
        if size > DEPENDENT * max(1.0, float(np.linalg.norm(gradient))):
            basis = np.vstack([basis, rest / size])
        elif abs(point.g[j] - nlp.low[j]) <= MET:
            dependent.append(j)
    return np.array(dependent, dtype=np.intp)
