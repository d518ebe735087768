"""Minimise the output error at a fixed start position by convex programmes, with a lower bound that proves optimality.

With the start position fixed, the linkages that follow the target outputs y_i on the assembly mode `side` with no error above t
are those with

    side * F(x_i, y_i - t) >= 0 >= side * F(x_i, y_i + t)    for all i,

linear in the constants of F (`optlink.synthesis.loop_equations`) for every t: the minimax output error is the solution of a
quasi-convex programme. A few linear programmes solve it and the multipliers of the last one prove it. (The proof excludes
linkages so near a dead position that their other assembly mode lies within the same error.)

References
----------
E. W. Cheney and H. L. Loeb, Numerische Mathematik 3 (1961) 72-75: differential correction, as used in the search for t.
"""

import math
import warnings
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from optlink.linkage.vector2d import Array
from optlink.synthesis.freudenstein_fit import Cells, FitProblem, fit_error
from optlink.synthesis.loop_equations import EXACT, linear_form

PROVEN_GAP = 1e-4  # relative gap of the output error at which it counts as proven optimal
STEPS = 12  # convex programmes per start position
SHARES = 0.5 ** np.arange(6.0)  # trial fractions of a step: the error is quasi-convex, so a fraction of a descent step descends


@dataclass(frozen=True)
class ConvexStep:
    """Step y (3,) and multipliers of the rows and of the limits, as returned by the solver."""

    step: Array
    rows: Array
    limits: Array
    status: str


class ConvexFit:
    """Convex programme: minimise max(M y + m) or |M y + m|^2 subject to L y <= h, compiled once for all M, m, L, h."""

    def __init__(self, rows: int, limits: int, largest: bool) -> None:
        import cvxpy

        self.cvxpy: Any = cvxpy
        self.matrix, self.vector = self.cvxpy.Parameter((rows, 3)), self.cvxpy.Parameter(rows)
        self.limit_matrix, self.limit_vector = self.cvxpy.Parameter((limits, 3)), self.cvxpy.Parameter(limits)
        self.y = self.cvxpy.Variable(3)
        residual = self.matrix @ self.y + self.vector
        self.constraints = [self.limit_matrix @ self.y <= self.limit_vector]
        goal = self.cvxpy.sum_squares(residual)
        if largest:
            goal = self.cvxpy.Variable()
            self.constraints.append(residual <= goal)
        self.problem = self.cvxpy.Problem(self.cvxpy.Minimize(goal), self.constraints)

    def __call__(self, matrix: Array, vector: Array, limit_matrix: Array, limit_vector: Array) -> ConvexStep | None:
        """Solve the programme of (M, m, L, h); None on failure. The caller must verify the optimality of the answer."""
        self.matrix.value, self.vector.value = matrix, vector
        self.limit_matrix.value, self.limit_vector.value = limit_matrix, limit_vector
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the caller detects inaccurate answers
            try:
                self.problem.solve(solver=self.cvxpy.CLARABEL)
            except self.cvxpy.error.SolverError:
                return None
        values = [self.y.value, *(one.dual_value for one in self.constraints)]
        if any(value is None or not np.all(np.isfinite(value)) for value in values):
            return None
        duals = [np.asarray(value, dtype=float) for value in values[1:]]
        rows = duals[1] if len(duals) > 1 else np.zeros(0)
        return ConvexStep(np.asarray(self.y.value, dtype=float), rows, duals[0], str(self.problem.status))


class Refinement:
    """Refine linkages at their start positions; the convex programme is compiled on first use."""

    def __init__(self, task: FitProblem) -> None:
        self.task = task

    def __call__(self, cell: Cells) -> tuple[Cells, float, str]:
        """Return the linkage of least error, a lower bound of that error (see `FirstStep`) and the solver status."""
        return (self._smallest_largest if self.task.largest else self._least_squares)(self._least(cell))

    @cached_property
    def programme(self) -> ConvexFit:
        """Convex programme of every step."""
        task = self.task
        return ConvexFit(task.x.size * (1 + task.largest), task.chain.limits[1].size, task.largest)

    def _moved(self, cell: Cells, change: Array) -> Cells:
        """Apply the largest improving fraction of a change (3,) of the constants; return the same cell if none improves it."""
        task = self.task
        same = np.ones(len(SHARES))
        others = fit_error(task, cell.x0 * same, cell.y0 * same, cell.k + SHARES[:, None] * change)
        better = np.flatnonzero((others.error < cell.error) & (others.x0 == cell.x0) & (others.y0 == cell.y0))
        return others[better[0]] if better.size else cell

    def _least(self, cell: Cells) -> Cells:
        """Repeat the weighted fit by orthogonal factorisation, for full precision of the constants."""
        task = self.task
        x, y = cell.x0 + task.x, cell.y0 + task.y
        a, w = linear_form(task.chain, x, y)
        weight = 1.0 / np.abs(task.chain.slope(x, y, cell.k))
        change = np.linalg.lstsq(a * weight[:, None], (w - a @ cell.k) * weight, rcond=None)[0]
        return self._moved(cell, np.asarray(change, dtype=float))

    def _smallest_largest(self, cell: Cells) -> tuple[Cells, float, str]:
        """Minimise the largest output error; return the linkage, a proven lower bound of the error and the solver status.

        Each linear programme minimises the excess over the band of (1 - PROVEN_GAP) times the current error, with each position
        scaled by its own slope. It either finds a linkage within the band, which becomes the next iterate, or its multipliers
        prove that there is none.
        """
        task = self.task
        chain, x, y = task.chain, cell.x0 + task.x, cell.y0 + task.y
        rows, bounds = chain.limits
        status = "closed form"
        for _ in range(STEPS):
            if cell.error <= EXACT:
                break
            target = (1.0 - PROVEN_GAP) * float(cell.error)
            weight = cell.side / np.abs(chain.slope(x, y, cell.k))
            below, above = linear_form(chain, x, y - target), linear_form(chain, x, y + target)
            matrix = np.concatenate([-weight[:, None] * below[0], weight[:, None] * above[0]])
            vector = matrix @ cell.k + np.concatenate([weight * below[1], -weight * above[1]])
            straight = np.linalg.inv(np.linalg.qr(matrix, mode="r")) * target  # constants change by straight @ step
            room = bounds - rows @ cell.k
            answer = self.programme(matrix @ straight / target, vector / target, rows @ straight, room)
            if answer is None:
                return cell, 0.0, "no answer"
            status = answer.status
            box = (chain.box[0] - cell.k, chain.box[1] - cell.k)
            if lower_bound(matrix, vector, rows, room, box, answer.rows, answer.limits * target) > 0.0:
                return cell, target, status
            better = self._moved(cell, straight @ answer.step)
            if better is cell:
                break
            cell = better
        return cell, 0.0, status

    def _least_squares(self, cell: Cells) -> tuple[Cells, float, str]:
        """Minimise the rms output error; return the linkage, a bound for its linearised model and the solver status.

        Gauss-Newton; each step is a convex quadratic programme, in closed form where no ratio limit is active.
        """
        task = self.task
        chain, x, y = task.chain, cell.x0 + task.x, cell.y0 + task.y
        rows, bounds = chain.limits
        status, bound = "closed form", 0.0
        for _ in range(STEPS):
            if cell.error <= EXACT:
                bound = 0.0
                break
            actual = chain.follow(x, cell.k, cell.side)
            error = chain.difference(actual, y)
            factor, r = np.linalg.qr(-linear_form(chain, x, actual)[0] / chain.slope(x, actual, cell.k)[:, None])
            size = float(np.linalg.norm(error))
            straight = np.linalg.inv(r) * size
            limit_matrix, room = rows @ straight, bounds - rows @ cell.k
            inner = factor.T @ error / size
            step, multipliers, status = -inner, np.zeros(room.size), "closed form"
            if np.any(limit_matrix @ step > room):
                answer = self.programme(factor, error / size, limit_matrix, room)
                if answer is None:
                    return cell, 0.0, "no answer"
                step, multipliers, status = answer.step, np.maximum(answer.limits, 0.0), answer.status
            free = -inner - 0.5 * limit_matrix.T @ multipliers  # least point of the Lagrangian: weak duality
            square = 1.0 - inner @ inner + np.sum((free + inner) ** 2) + multipliers @ (limit_matrix @ free - room)
            bound = math.sqrt(max(0.0, float(square))) * float(cell.error)
            better = self._moved(cell, straight @ step)
            if better is cell or bound >= (1.0 - PROVEN_GAP) * cell.error:
                break
            cell, bound = better, 0.0  # the bound belonged to the model about the previous linkage
        return cell, bound, status


def lower_bound(matrix: Array, vector: Array, rows: Array, room: Array, box: tuple[Array, Array], *multipliers: Array) -> float:
    """Return a lower bound of max(matrix @ d + vector) subject to rows @ d <= room and box[0] <= d <= box[1], by weak duality.

    Any non-negative multipliers of the m rows and the r limits give a bound; those of the solver are first shifted, in proportion
    to themselves, to satisfy stationarity.
    """
    both = np.concatenate([matrix, rows])
    p = np.maximum(np.concatenate(multipliers), 0.0)
    for _ in range(3):
        weighed = both * p[:, None]
        p = np.maximum(p - weighed @ np.linalg.lstsq(both.T @ weighed, both.T @ p, rcond=None)[0], 0.0)
    total = float(np.sum(p[: vector.size]))
    if not total > 0.0:
        return -math.inf
    p /= total
    pull = both.T @ p
    return float(p @ np.concatenate([vector, -room]) + np.sum(np.minimum(pull * box[0], pull * box[1])))
