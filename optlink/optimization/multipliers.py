"""Lagrange multipliers of a nonlinear programme: which limits are active, and all multipliers if they are not unique."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from optlink.linkage.vector2d import Array, max_magnitude
from optlink.problem.design import EPIGRAPH

if TYPE_CHECKING:
    from optlink.optimization.nlp import NLP, NLPValues

LEAST_PRICE = 1e-6
"""Least change of the objective, as a share of its value, for a bound moved by one scaled unit (the frame, 1 rad): else it has no
price. Multipliers are recomputed to about this accuracy."""
ACTIVE = 1e-6  # distance, in scaled units, at which a limit counts as active
DEPENDENT = 1e-6  # least singular value of linearly independent gradients of active limits, relative to the largest
FLAT = 1e-12  # gradient of a limit, in scaled units, that counts as none
SAME_SUM = 1e-4  # relative change of a sum of multipliers that counts as none: of rows beside one peak of a limit


def active_sides(nlp: NLP, x: Array, point: NLPValues, within: float = ACTIVE) -> tuple[Array, NDArray[np.bool_]]:
    """Return the side at which each bound and row is active (1: upper, -1: lower, 0: neither), and which are equalities.

    The bounds of an angle free over a full turn do not limit, nor does that of the largest error of a minimax problem. `within`
    is the distance (scaled) at which a limit counts as active.
    """
    values, low, high = np.concatenate([x, point.g]), nlp.lower, nlp.upper
    sign = (high - values <= within) * 1.0 - (values - low <= within)
    sign[: len(x)][nlp.around] = 0.0
    sign[[k for k, variable in enumerate(nlp.variables) if variable.name.startswith(EPIGRAPH)]] = 0.0
    return sign, low == high


@dataclass(frozen=True)
class MultiplierSet:
    """All multipliers of an optimum: `multipliers` (n + m,), and others if gradients of active limits are linearly dependent.

    These are `multipliers + directions @ t` with the signs of their limits: `sign` (n + m,) is zero of equalities and inactive
    limits. `directions` (n + m, k) has no columns if the multipliers are unique.

    References
    ----------
    J. Gauvin, F. Dubeau, Differential properties of the marginal function in mathematical programming (1982): the derivative of
    the optimal value by a change of the bounds is extreme over all multipliers.
    """

    multipliers: Array
    directions: Array
    sign: Array

    @classmethod
    def unique(cls, multipliers: Array) -> MultiplierSet:
        """Return a set of one element, for multipliers (n + m,) that are shown and not changed."""
        return cls(multipliers, np.zeros((len(multipliers), 0)), np.zeros(len(multipliers)))

    @classmethod
    def of(cls, nlp: NLP, x: Array, point: NLPValues, multipliers: Array) -> MultiplierSet:
        """Return all multipliers of an optimum of which some (n + m,), of bounds, then rows, are known."""
        jacobian = np.concatenate([np.eye(len(x)), point.jacobian])
        sign, equal = active_sides(nlp, x, point)
        return cls.from_gradients(jacobian, multipliers, (sign != 0.0) | equal, np.where(equal, 0.0, sign))

    @classmethod
    def from_gradients(cls, gradients: Array, multipliers: Array, active: NDArray[np.bool_], sign: Array) -> MultiplierSet:
        """Return all multipliers of an optimum from the gradients (limits, n) of its limits; for `sign` see the class."""
        norms = np.linalg.norm(gradients, axis=1)
        moving = norms > FLAT
        rows = np.flatnonzero(active & (moving | (sign == 0.0)))  # an equation without gradient can have any multiplier
        norms = np.where(moving, norms, 1.0)
        left, singular, _ = np.linalg.svd(np.where(moving[rows, None], gradients[rows] / norms[rows, None], 0.0))
        null = left[:, np.sum(singular > DEPENDENT * np.max(singular, initial=0.0)) :]
        null[np.linalg.norm(null, axis=1) <= SAME_SUM] = 0.0  # these gradients do not depend on others
        directions = np.zeros((len(multipliers), null.shape[1]))
        directions[rows] = null / norms[rows, None]
        return cls(multipliers, directions, sign)

    def least(self, weights: Array) -> tuple[float, Array]:
        """Return the least weighted sum of multipliers, -inf if there is none, and multipliers with this sum."""
        value, size = float(weights @ self.multipliers), max_magnitude(self.multipliers)
        if not self.directions.size or not size or not self.changes(weights):
            return value, self.multipliers
        from scipy.optimize import linprog

        limited = self.sign != 0.0
        sides = self.sign[limited, None] * self.directions[limited]
        room = np.maximum((self.sign * self.multipliers)[limited] / size, 0.0)
        solved = linprog(weights @ self.directions, A_ub=-sides, b_ub=room, bounds=(None, None))
        if solved.status in (2, 3, 4):  # unbounded
            return -math.inf, self.multipliers
        multipliers = self.multipliers + size * (self.directions @ solved.x)
        multipliers[np.abs(multipliers) <= LEAST_PRICE * size] = 0.0
        return float(weights @ multipliers), multipliers

    def changes(self, weights: Array) -> bool:
        """Return whether a weighted sum differs between the multipliers, apart from their signs."""
        change = np.abs(weights) @ np.abs(self.directions)
        return bool(np.any(np.abs(weights @ self.directions) > SAME_SUM * np.max(change, initial=0.0)))
