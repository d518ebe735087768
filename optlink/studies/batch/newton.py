"""Newton's method on the optimality conditions of many neighbouring problems at once, with changes of their active sets.

Points with the same active set share the linear algebra. Every point keeps its own iterates and stops on its own, so its result
does not depend on the others.
"""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from optlink.linkage.vector2d import Array
from optlink.optimization.batch_nlp import BatchValues, Evaluator
from optlink.optimization.multipliers import ACTIVE
from optlink.solvers.newton import newton
from optlink.solvers.solution import FEASIBLE
from optlink.studies.continuation import MAX_DISTANCE, MAX_RESIDUAL, MAX_STEPS

Bools = NDArray[np.bool_]
Index = NDArray[np.intp]

ACTIVE_SETS = 5  # that are tried at each point
LARGEST_STEP = 1.0  # of variables and multipliers; a larger one may come from dependent limits
ROUNDING = 1e-12  # residual of the optimality conditions at which the iterations end
MAX_RATIO = 0.1  # ratio of successive residuals above which a small one is rounding error
DUPLICATE_LIMIT = 1e-9  # difference of the derivatives of limits that are the same one
INDEPENDENT = 1e-9  # least diagonal element of the triangular factor of independent limits


@dataclass(frozen=True)
class BatchProblem:
    """Parameters (points, k) and bounds (points, n + m) of the variables, then of the rows, at every point."""

    p: Array
    lower: Array
    upper: Array

    def part(self, points: Index | Bools) -> BatchProblem:
        """Return the problem at some of the points."""
        return BatchProblem(self.p[points], self.lower[points], self.upper[points])

    def keeping(self, kept: Index, values: Array) -> BatchProblem:
        """Return the problem with other values (points, kept) of some parameters."""
        p = self.p.copy()
        p[:, kept] = values
        return BatchProblem(p, self.lower, self.upper)

    def towards(self, other: BatchProblem, share: float) -> BatchProblem:
        """Return the problem at a share of the way to another one; infinite bounds are those of the other one."""
        problems = []
        for begin, end in ((self.p, other.p), (self.lower, other.lower), (self.upper, other.upper)):
            with np.errstate(invalid="ignore"):
                change = end - begin
            problems.append(end - (1.0 - share) * np.where(np.isfinite(change), change, 0.0))
        return BatchProblem(*problems)


@dataclass(frozen=True)
class BatchOptima:
    """Ends of the iterations: scaled designs (points, n), multipliers and active sides (points, n + m), objectives (points,).

    Active sides: +1 upper bound, -1 lower bound, 2 equality, 0 inactive. `optimal` (points,): whether the first-order and
    second-order conditions of a local optimum hold there, with nothing but the active set within `ACTIVE` of its bound.
    """

    x: Array
    multipliers: Array
    sides: NDArray[np.int8]
    objective: Array
    optimal: Bools

    def part(self, points: Index | Bools | slice) -> BatchOptima:
        """Return some of the optima."""
        return BatchOptima(**{name: values[points] for name, values in vars(self).items()})

    @classmethod
    def joined(cls, count: int, parts: Sequence[tuple[Index, BatchOptima]]) -> BatchOptima:
        """Return optima of several programmes at their own ones of `count` points; the rows of the others end with zeros."""
        arrays = {}
        for name in (item.name for item in fields(cls)):
            each = [(points, getattr(optima, name)) for points, optima in parts]
            wide = tuple(max(values.shape[k] for _, values in each) for k in range(1, each[0][1].ndim))
            arrays[name] = np.zeros((count, *wide), dtype=each[0][1].dtype)
            for points, values in each:
                place: Any = points, *map(slice, values.shape[1:])
                arrays[name][place] = values
        return cls(**arrays)


def active_set_groups(sides: NDArray[np.int8]) -> list[tuple[Index, Index]]:
    """Return the points (indices) and the active entries of every active set that occurs."""
    if not len(sides):
        return []
    packed = np.packbits(sides != 0, axis=1)
    keys = packed.view(f"V{packed.shape[1]}").ravel() if packed.shape[1] > 1 else packed.ravel()
    _, first, group = np.unique(keys, return_index=True, return_inverse=True)
    return [(np.flatnonzero(group == k), np.flatnonzero(sides[row])) for k, row in enumerate(first)]


def batch_newton(nlp: Evaluator, problem: BatchProblem, x: Array, multipliers: Array, sides: NDArray[np.int8]) -> BatchOptima:
    """Find the optima of neighbouring problems.

    `x` (points, n) are scaled; `multipliers` and `sides` (points, n + m), the latter the first active sets as in `BatchOptima`.
    """
    start, x, multipliers, sides = x, x.copy(), multipliers.copy(), sides.copy()
    objective, optimal = np.full(len(x), np.nan), np.zeros(len(x), dtype=bool)
    todo = np.arange(len(x))
    for _ in range(ACTIVE_SETS):
        if not todo.size:
            break
        part = problem.part(todo)
        ended = _iterated(nlp, part, x[todo], multipliers[todo], sides[todo], start[todo])
        x[todo], multipliers[todo] = ended.x, ended.multipliers
        with np.errstate(invalid="ignore"):
            beyond = np.maximum(part.lower - ended.values, ended.values - part.upper)
        wrong = (np.abs(sides[todo]) == 1) & (multipliers[todo] * sides[todo] < 0.0)
        violated = (beyond > FEASIBLE) & (sides[todo] == 0)
        right = ended.converged & ~np.any(wrong | violated, axis=1)
        objective[todo[right]] = ended.objective[right]
        optimal[todo[right]] = _second_order(ended, part, sides[todo], right)[right]
        changed_set = ended.converged & ~right
        changed, multiplier = sides[todo], multipliers[todo]
        row, at = _worst(wrong, np.abs(multiplier))
        changed[row, at], multiplier[row, at] = 0, 0.0
        row, at = _worst(violated, beyond)
        changed[row, at] = np.where(ended.values[row, at] > part.upper[row, at], 1, -1)
        changed[(changed != 0) & (part.lower == part.upper)] = 2
        sides[todo[changed_set]], multipliers[todo[changed_set]] = changed[changed_set], multiplier[changed_set]
        todo = todo[changed_set]
    return BatchOptima(x, multipliers, sides, objective, optimal)


def _worst(marked: Bools, size: Array) -> tuple[Index, Index]:
    """Return the points with marked entries, and the largest of these at each: entries change one by one.

    Two limits may be the same one at two positions, and without one limit another may not be in the way any more.
    """
    rows = np.flatnonzero(np.any(marked, axis=1))
    return rows, np.argmax(np.where(marked, size, -np.inf), axis=1)[rows]


@dataclass(frozen=True)
class _Ended:
    """Last iterates of an active set at each point, with the values there."""

    x: Array
    multipliers: Array
    values: Array
    jacobian: Array
    hessian: Array
    objective: Array
    converged: Bools


def _iterated(
    nlp: Evaluator, problem: BatchProblem, x: Array, multipliers: Array, sides: NDArray[np.int8], start: Array
) -> _Ended:
    """Iterate with fixed active sets; `x` and `multipliers` are changed in place."""
    count, n = x.shape
    bound = np.where(sides > 0, problem.upper, problem.lower)
    values, objective = np.full(problem.lower.shape, np.nan), np.full(count, np.nan)
    jacobian, hessian = np.full((*values.shape, n), np.nan), np.full((count, n, n), np.nan)
    converged, last = np.zeros(count, dtype=bool), np.full(count, np.inf)
    todo = np.arange(count)
    for step in range(MAX_STEPS + 1):
        if not todo.size:
            break
        values_at = nlp(x[todo], problem.p[todo], multipliers[todo])
        size = np.zeros(len(todo))
        moves: list[tuple[Index, Index, Array, Array]] = []
        for points, active in active_set_groups(sides[todo]):
            slope = values_at.jacobian[points][:, active]
            pull = np.sum(slope * multipliers[todo[points]][:, active, None], axis=1)
            missing = values_at.values[points][:, active] - bound[todo[points]][:, active]
            residual = np.concatenate([values_at.gradient[points] + pull, missing], axis=1)
            size[points] = np.max(np.abs(residual), axis=1)
            moves.append((points, active, slope, residual))
        ends = (size <= MAX_RESIDUAL) & ((size <= ROUNDING) | (size > MAX_RATIO * last[todo]))
        at, last[todo] = todo[ends], size
        converged[at], values[at], objective[at] = True, values_at.values[ends], values_at.objective[ends]
        jacobian[at], hessian[at] = values_at.jacobian[ends], values_at.hessian[ends]
        far = np.max(np.abs(x[todo] - start[todo]), axis=1) > MAX_DISTANCE
        on = ~ends & np.isfinite(size) & ~far
        if step == MAX_STEPS:
            break
        for points, active, slope, residual in moves:
            group = on[points]
            entries = todo[points[group]]
            step_x = _steps(values_at, points[group], slope[group], residual[group])
            x[entries] += step_x[:, :n]
            multipliers[np.ix_(entries, active)] += step_x[:, n:]
            fixed = active[active < n]  # exactly, without the rounding of the linear system
            x[np.ix_(entries, fixed)] = bound[np.ix_(entries, fixed)]
        todo = todo[on]
    return _Ended(x, multipliers, values, jacobian, hessian, objective, converged)


def _steps(values: BatchValues, points: Index, slope: Array, residual: Array) -> Array:
    """Return the Newton steps (points, n + active) of the optimality conditions of one active set."""
    count, active, n = slope.shape
    system = np.zeros((count, n + active, n + active))
    system[:, :n, :n], system[:, n:, :n], system[:, :n, n:] = values.hessian[points], slope, np.swapaxes(slope, 1, 2)
    finite = np.all(np.isfinite(system), axis=(1, 2))
    steps = np.full(residual.shape, np.nan)
    with contextlib.suppress(np.linalg.LinAlgError):
        steps[finite] = np.linalg.solve(system[finite], -residual[finite, :, None])[..., 0]
    for k in np.flatnonzero(finite & ~(np.max(np.abs(steps), axis=1) < LARGEST_STEP)):
        change = newton(values.hessian[points[k]], slope[k], residual[k])
        steps[k] = np.nan if change is None else change
    return steps


def _second_order(ended: _Ended, problem: BatchProblem, sides: NDArray[np.int8], right: Bools) -> Bools:
    """Return where the reduced Hessian is not negative, and the active limits are independent.

    Further limits at their bounds must be the same as one of these at another position: a limit that is active or not by rounding
    is left to a search.
    """
    with np.errstate(invalid="ignore"):
        near = (problem.upper - ended.values <= ACTIVE) | (ended.values - problem.lower <= ACTIVE)
    optimal, n = right.copy(), ended.x.shape[1]
    for points, active in active_set_groups(sides):
        optimal_points = points[optimal[points]]
        slopes = ended.jacobian[optimal_points]
        for entry in np.flatnonzero(np.any(near[optimal_points], axis=0) & ~np.isin(np.arange(near.shape[1]), active)):
            difference = np.max(np.abs(slopes[:, active] - slopes[:, [entry]]), axis=2, initial=0.0)
            optimal[optimal_points] &= ~near[optimal_points, entry] | (
                np.min(difference, axis=1, initial=np.inf) <= DUPLICATE_LIMIT
            )
        optimal_points = optimal_points[optimal[optimal_points]]
        if not optimal_points.size:
            continue
        if active.size > n:
            optimal[optimal_points] = False
            continue
        basis = np.broadcast_to(np.eye(n), (optimal_points.size, n, n))
        if active.size:
            basis, factor = np.linalg.qr(np.swapaxes(ended.jacobian[optimal_points][:, active], 1, 2), mode="complete")
            diagonal = np.abs(np.diagonal(factor, axis1=1, axis2=2))
            optimal[optimal_points] &= np.min(diagonal, axis=1) > INDEPENDENT
        if active.size < n:
            free = basis[:, :, active.size :]
            bent = np.einsum("kia,kij,kjb->kab", free, ended.hessian[optimal_points], free)
            optimal[optimal_points] &= ~(np.linalg.eigvalsh(bent)[:, 0] < 0.0)
    return optimal
