"""A first step at its start position: the best error of its kind by convex programmes, with the bound that proves it.

With the start position given, the linkages that follow the wanted outputs y_i on the assembly mode `side` with no error above t
are those with

    side * F(x_i, y_i - t) >= 0 >= side * F(x_i, y_i + t)    for all i,

linear in the constants of F (`optlink.synthesis.loop_equations`) for every t: the smallest largest output error is the solution
of a quasi-convex programme. A few linear programmes find it and the multipliers of the last one prove it. (Left out of that
proof: linkages which come so near a dead position that their other mode lies within the same error.)

Source: the search for t as in the differential correction of E. W. Cheney and H. L. Loeb, Numerische Mathematik 3 (1961) 72-75.
"""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from optlink.synthesis.freudenstein_fit import Cells, Task, judge
from optlink.synthesis.loop_equations import EXACT, linear

Array = NDArray[np.float64]

CLOSE = 1e-4  # share of the output error up to which the largest one is proven to be the smallest
STEPS = 12  # convex programmes per start position
SHARES = 0.5 ** np.arange(6.0)  # of a step that are tried: the error is quasi-convex, so a part of a good step is good


@dataclass(frozen=True)
class Answer:
    """Step y (3,) and multipliers of the rows and of the limits, as the solver gave them."""

    step: Array
    rows: Array
    limits: Array
    status: str


class Programme:
    """minimise max(M y + m) or |M y + m|^2 subject to L y <= h, compiled once for all M, m, L, h."""

    def __init__(self, rows: int, limits: int, largest: bool) -> None:
        import cvxpy

        self.cvxpy: Any = cvxpy
        self.matrix, self.vector = self.cvxpy.Parameter((rows, 3)), self.cvxpy.Parameter(rows)
        self.limit_matrix, self.limit_vector = self.cvxpy.Parameter((limits, 3)), self.cvxpy.Parameter(limits)
        self.y = self.cvxpy.Variable(3)
        residual = self.matrix @ self.y + self.vector
        self.held = [self.limit_matrix @ self.y <= self.limit_vector]
        goal = self.cvxpy.sum_squares(residual)
        if largest:
            goal = self.cvxpy.Variable()
            self.held.append(residual <= goal)
        self.problem = self.cvxpy.Problem(self.cvxpy.Minimize(goal), self.held)

    def __call__(self, matrix: Array, vector: Array, limit_matrix: Array, limit_vector: Array) -> Answer | None:
        """Solve; None where the solver has no answer. What it claims of its answer is for the caller to check."""
        self.matrix.value, self.vector.value = matrix, vector
        self.limit_matrix.value, self.limit_vector.value = limit_matrix, limit_vector
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # an inaccurate answer is found out by its own numbers
            try:
                self.problem.solve(solver=self.cvxpy.CLARABEL)
            except self.cvxpy.error.SolverError:
                return None
        values = [self.y.value, *(one.dual_value for one in self.held)]
        if any(value is None or not np.all(np.isfinite(value)) for value in values):
            return None
        duals = [np.asarray(value, dtype=float) for value in values[1:]]
        rows = duals[1] if len(duals) > 1 else np.zeros(0)
        return Answer(np.asarray(self.y.value, dtype=float), rows, duals[0], str(self.problem.status))


class Refinement:
    """Betters linkages at their start positions; its programme is compiled when it is first needed."""

    def __init__(self, task: Task) -> None:
        self.task = task

    def __call__(self, cell: Cells) -> tuple[Cells, float, str]:
        """The linkage of the least error, a lower bound of that error as `Step` tells, and the solver's status."""
        return (self._smallest_largest if self.task.largest else self._least_squares)(self._least(cell))

    @cached_property
    def programme(self) -> Programme:
        """The convex programme of every step."""
        task = self.task
        return Programme(task.x.size * (1 + task.largest), task.chain.limits[1].size, task.largest)

    def _moved(self, cell: Cells, change: Array) -> Cells:
        """The cell after the largest of some shares of a change (3,) of its constants that betters it; itself where none does."""
        task = self.task
        same = np.ones(len(SHARES))
        others = judge(task, cell.x0 * same, cell.y0 * same, cell.k + SHARES[:, None] * change)
        better = np.flatnonzero((others.error < cell.error) & (others.x0 == cell.x0) & (others.y0 == cell.y0))
        return others[better[0]] if better.size else cell

    def _least(self, cell: Cells) -> Cells:
        """The weighted fit again, by orthogonal factors: all digits of the constants."""
        task = self.task
        x, y = cell.x0 + task.x, cell.y0 + task.y
        a, w = linear(task.chain, x, y)
        weight = 1.0 / np.abs(task.chain.slope(x, y, cell.k))
        change = np.linalg.lstsq(a * weight[:, None], (w - a @ cell.k) * weight, rcond=None)[0]
        return self._moved(cell, np.asarray(change, dtype=float))

    def _smallest_largest(self, cell: Cells) -> tuple[Cells, float, str]:
        """The smallest largest output error: the linkage, a proven lower bound of the error, and the solver's status.

        Is there a linkage whose error is below (1 - CLOSE) times the one at hand? The linear programme (least excess over that
        band, each position in units of its own slope) either finds one, and the search goes on from its error, or its
        multipliers prove that there is none.
        """
        task = self.task
        chain, x, y = task.chain, cell.x0 + task.x, cell.y0 + task.y
        rows, bounds = chain.limits
        status = "closed form"
        for _ in range(STEPS):
            if cell.error <= EXACT * task.unit:
                break
            aim = (1.0 - CLOSE) * float(cell.error)
            weight = cell.side / np.abs(chain.slope(x, y, cell.k))
            below, above = linear(chain, x, y - aim), linear(chain, x, y + aim)
            matrix = np.concatenate([-weight[:, None] * below[0], weight[:, None] * above[0]])
            vector = matrix @ cell.k + np.concatenate([weight * below[1], -weight * above[1]])
            straight = np.linalg.inv(np.linalg.qr(matrix, mode="r")) * aim  # constants change by straight @ step
            room = bounds - rows @ cell.k
            answer = self.programme(matrix @ straight / aim, vector / aim, rows @ straight, room)
            if answer is None:
                return cell, 0.0, "no answer"
            status = answer.status
            box = (chain.box[0] - cell.k, chain.box[1] - cell.k)
            if proven(matrix, vector, rows, room, box, answer.rows, answer.limits * aim) > 0.0:
                return cell, aim, status
            better = self._moved(cell, straight @ answer.step)
            if better is cell:
                break
            cell = better
        return cell, 0.0, status

    def _least_squares(self, cell: Cells) -> tuple[Cells, float, str]:
        """The least root mean square of the output error: the linkage, a bound for its linearised model, the solver's status.

        Gauss-Newton; each step is a convex quadratic programme, solved in closed form where no ratio limits it.
        """
        task = self.task
        chain, x, y = task.chain, cell.x0 + task.x, cell.y0 + task.y
        rows, bounds = chain.limits
        status, bound = "closed form", 0.0
        for _ in range(STEPS):
            if cell.error <= EXACT * task.unit:
                bound = 0.0
                break
            actual = chain.follow(x, cell.k, cell.side)
            error = chain.difference(actual, y)
            factor, r = np.linalg.qr(-linear(chain, x, actual)[0] / chain.slope(x, actual, cell.k)[:, None])
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
            if better is cell or bound >= (1.0 - CLOSE) * cell.error:
                break
            cell, bound = better, 0.0  # that bound was one of the model about the linkage before
        return cell, bound, status


def proven(matrix: Array, vector: Array, rows: Array, room: Array, box: tuple[Array, Array], *multipliers: Array) -> float:
    """Lower bound of max(matrix @ d + vector) over rows @ d <= room, box[0] <= d <= box[1], by weak duality.

    Any multipliers that are not negative give one; the solver's are moved to where the constants balance, in proportion to
    themselves.
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
