"""Quadratic model of a programme near a point, for searches on a grid, which solve it thousands of times.

The crank angles at which strokes end follow the other unknowns to first order. Negative curvature is left out: every model is
convex, and its minimum within bounds a lower bound of the model there.
"""

import contextlib
import io
from typing import Any

import casadi
import numpy as np

from optlink.linkage.vector2d import Array
from optlink.optimization.nlp import NLP

QUIET: dict[str, Any] = {"printLevel": "none", "error_on_fail": False, "sparse": False}


class QuadraticModel:
    """The programme near `x` with second-order terms of the Lagrangian and linear rows.

    Parameters
    ----------
    nlp : NLP
    x, p : array
        Scaled point and parameters.
    multipliers : array (rows,)
        Of the rows, for the Lagrangian.
    reach : array (n,)
        Largest change of each unknown, scaled.
    """

    def __init__(self, nlp: NLP, x: Array, p: Array, multipliers: Array, reach: Array) -> None:
        self.x, here = x, nlp.at(x, p)
        events = np.arange(nlp.first_event, nlp.first_level)
        self.unknowns = np.setdiff1d(np.arange(len(x)), events)
        follow = np.eye(len(x))
        states = np.array([row.limit in nlp.states and row.low == row.high for row in nlp.rows], dtype=bool)
        if events.size:
            own = here.jacobian[states]
            follow[events] = 0.0
            follow[np.ix_(events, self.unknowns)] = -np.linalg.lstsq(own[:, events], own[:, self.unknowns], rcond=None)[0]
        self.follow = follow[:, self.unknowns]
        hessian = self.follow.T @ nlp.hessian(x, p, multipliers) @ self.follow
        curvatures, directions = np.linalg.eigh(0.5 * (hessian + hessian.T))
        self.hessian = (directions * np.maximum(curvatures, 0.0)) @ directions.T
        self.objective, self.gradient = here.f, self.follow.T @ here.gradient
        slopes = here.jacobian @ self.follow
        self.least = np.maximum(nlp.x_low - x, -reach)[self.unknowns]
        self.most = np.minimum(nlp.x_high - x, reach)[self.unknowns]
        span = np.abs(slopes) @ np.maximum(-self.least, self.most)
        self.rows = np.flatnonzero(~states & ((here.g - span < nlp.low) | (here.g + span > nlp.high)))
        self.slopes, self.g = slopes[self.rows], here.g[self.rows]
        self.low, self.high = nlp.low[self.rows] - self.g, nlp.high[self.rows] - self.g
        shapes = {
            "h": casadi.Sparsity.dense(len(self.hessian), len(self.hessian)),
            "a": casadi.Sparsity.dense(*self.slopes.shape),
        }
        with contextlib.redirect_stdout(io.StringIO()):  # qpOASES prints its licence, whatever its options
            self._programme = casadi.conic("model", "qpoases", shapes, QUIET)
            self.minimum(self.least, self.most)

    def minimum(self, low: Array, high: Array) -> tuple[float, Array] | None:
        """Return the least objective (scaled) within bounds of the changes of `unknowns`, and these changes, if any."""
        bounds = {"lba": self.low, "uba": self.high, "lbx": low, "ubx": high}
        end = self._programme(h=self.hessian, g=self.gradient, a=self.slopes, **bounds)
        if not self._programme.stats()["success"]:
            return None
        return self.objective + float(end["cost"]), np.array(end["x"]).ravel()

    def tighten(self, change: Array, g: Array) -> None:
        """Tighten the rows by how much those of the programme, `g`, exceed the model after a change of the unknowns."""
        excess = g[self.rows] - self.g - self.slopes @ change
        self.low, self.high = self.low - np.minimum(excess, 0.0), self.high - np.maximum(excess, 0.0)
