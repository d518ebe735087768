"""Optima at many points of a grid: a search in the middle of every block, Newton's method from there to all of its points.

The optimum of the search in the middle of a block is compared with those of the neighbouring blocks, continued to that point;
where they differ, every point of the block gets the best one. The comparison includes further optima, from multistart searches in
the middles of a few large blocks. A grid of many points also has coarse blocks: where their searches agree, their points need no
further searches. The result at a point depends on the grid only, not on the other points that are computed with it.
"""

from __future__ import annotations

import contextlib
import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any, Protocol, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from optlink.errors import Status
from optlink.linkage.vector2d import Array, all_finite, finite_or, max_magnitude
from optlink.optimization.multipliers import ACTIVE
from optlink.optimization.nlp import NLP, BatchValues, Evaluator
from optlink.solvers.multistart import CONVERGED, newton
from optlink.solvers.solution import FEASIBLE, SAME_OBJECTIVE, Attempt, Solution, verified_solution
from optlink.studies.grid import Grid

# Constants of the optima at the points of a grid.
# What a search finds, and how much longer it takes, if one of them is halved or doubled: docs/constants.md.
# Blocks:
MAX_BLOCK_POINTS = 100
"""Largest number of points of a block."""
MIN_BLOCKS = 3
"""Approximate least number of blocks, so that a small grid does not depend on a single search."""
# Newton's method:
MAX_STEPS = 8  # at most, before a search is made instead
MAX_DISTANCE = 0.3  # scaled units; largest distance of a neighbour
ACTIVE_SETS = 5  # that are tried at each point
LARGEST_STEP = 1.0  # of variables and multipliers; a larger one may come from dependent limits
ROUNDING = 1e-12  # residual of the optimality conditions at which the iterations end
MAX_RATIO = 0.1  # ratio of successive residuals above which a small one is rounding error
DUPLICATE_LIMIT = 1e-9  # difference of the derivatives of limits that are the same one
INDEPENDENT = 1e-9  # least diagonal element of the triangular factor of independent limits
# Predictions:
NODES = (7, 6, 5)  # along each axis, the first number for which a block has enough points
POINTS_PER_NODE = 6  # least number of points of a block for each of its nodes
# Searches:
SHARES = (0.25, 0.5, 0.75, 1.0)  # of the way to a problem that Newton's method does not reach at once
CACHED_SEARCHES = 4096  # searches that are kept for further blocks
MAX_DEVIATION = 1e-2  # scaled distance from its prediction at which an optimum may be another one
MIN_IMPROVEMENT = 1e-9  # share of the objective by which another optimum must be smaller
MAX_BRANCHES = 8  # optima of a large block, the best ones
CONTINUED_RATIO = 2.0
"""Optima of a large block up to this many times the objective in a block's middle are continued to its points."""

# Division of a grid into blocks of neighbouring points, each with one point in its middle.

Index = NDArray[np.intp]


def coarse_block(count: int) -> int:
    """Return the number of points of a coarse block in a grid of `count` points: 25 blocks in 10,000 points, 250 in a million."""
    return 4 * math.isqrt(count)


class Blocks:
    """Blocks of few points, fewer in small grids, about as long along every axis; they depend on the grid alone.

    `most`: largest number of points of a block, by default `MAX_BLOCK_POINTS`; `least`: approximate least number of blocks.
    """

    def __init__(self, grid: Grid, most: int | None = None, least: float = MIN_BLOCKS) -> None:
        self.shape = tuple(len(axis.values) for axis in grid.axes)
        left = max(1, min(MAX_BLOCK_POINTS if most is None else most, int(math.prod(self.shape) / least)))
        edges = dict.fromkeys(range(len(self.shape)), 1)
        for divided, axis in enumerate(sorted(edges, key=lambda k: self.shape[k])):
            edge = math.floor(left ** (1.0 / (len(edges) - divided)) + 1e-9)
            edges[axis] = max(1, min(self.shape[axis], edge))
            left //= edges[axis]
        self.counts = tuple(-(-size // edges[k]) for k, size in enumerate(self.shape))

    def of(self, points: Index) -> Index:
        """Return the block (points,) of each point of the grid."""
        places = np.unravel_index(points, self.shape)
        return np.ravel_multi_index(
            [place * count // size for place, count, size in zip(places, self.counts, self.shape, strict=True)], self.counts
        )

    def middle(self, block: int) -> int:
        """Return the point in the middle of a block."""
        return self._point([(first + last) // 2 for first, last in self.ends(block)])

    def corners(self, block: int) -> tuple[int, ...]:
        """Return two opposite corners of a block, once if they are one point."""
        return tuple(dict.fromkeys(self._point(places) for places in zip(*self.ends(block), strict=True)))

    def ends(self, block: int) -> list[tuple[int, int]]:
        """Return the first and last place of a block along every axis."""
        indices = np.unravel_index(block, self.counts)
        return [
            (-(-int(k) * size // count), -(-(int(k) + 1) * size // count) - 1)
            for k, count, size in zip(indices, self.counts, self.shape, strict=True)
        ]

    def points(self, places: Sequence[Index]) -> Index:
        """Return the points at all combinations of places along the axes, the last axis varying fastest."""
        return np.ravel_multi_index(np.ix_(*places), self.shape).ravel()

    def _point(self, places: Sequence[int]) -> int:
        return int(np.ravel_multi_index(places, self.shape))

    def neighbours(self, block: int) -> list[int]:
        """Return the neighbours of a block along every axis."""
        indices = [int(place) for place in np.unravel_index(block, self.counts)]
        neighbours = ([*indices[:k], indices[k] + step, *indices[k + 1 :]] for k in range(len(indices)) for step in (-1, 1))
        return [
            int(np.ravel_multi_index(indices_of_block, self.counts))
            for indices_of_block in neighbours
            if self._inside(indices_of_block)
        ]

    def _inside(self, places: list[int]) -> bool:
        return all(0 <= place < count for place, count in zip(places, self.counts, strict=True))

    @cached_property
    def count(self) -> int:
        """Number of blocks."""
        return math.prod(self.counts)

    def __iter__(self) -> Iterator[int]:
        return iter(range(self.count))


# Newton's method on the optimality conditions of a neighbouring problem with a fixed active set. The first step equals the
# prediction by sensitivities, further steps remove the residual. If the neighbour has another active set, the final point
# violates the optimality conditions; the caller detects this and starts a search.

FOLLOWED = "followed from a neighbour"


def follow_optimum(nlp: NLP, near: Solution) -> Solution | None:
    """Return the optimum of a programme after a change of its parameters or bounds; None if a search is needed."""
    p = np.array([near.p[0], *nlp.p[1:]])
    x, n = near.x, len(near.x)
    active = np.array(near.conditions.active, dtype=int)
    rows = active[active >= n] - n
    multipliers = near.conditions.multipliers[active]
    bound = np.where(multipliers > 0.0, nlp.upper[active], nlp.lower[active])
    if not all_finite(bound):
        return None
    unit, steps = np.eye(n), 0
    while steps < MAX_STEPS:
        values = nlp.at(x, p)
        if not values.finite or max_magnitude(x - near.x) > MAX_DISTANCE:
            return None
        jacobian = np.vstack([unit, values.jacobian])[active]
        missing = np.concatenate([x, values.g])[active] - bound
        residual = np.concatenate([values.gradient + jacobian.T @ multipliers, missing])
        if max_magnitude(residual) <= CONVERGED:
            break
        weights = np.zeros(len(values.g))
        weights[rows] = multipliers[len(active) - len(rows) :]
        step = newton(nlp.hessian(x, p, weights), jacobian, residual)
        if step is None:
            return None
        x, steps = x + step[:n], steps + 1
        multipliers = multipliers + step[n:]
    solution = verified_solution(nlp, Attempt(nlp.lifted(np.clip(x, nlp.x_low, nlp.x_high)), steps, FOLLOWED), p)
    return solution if solution.status is Status.OPTIMAL and not solution.curvature < 0.0 else None


# Newton's method on the optimality conditions of many neighbouring problems at once, with changes of their active sets.
#
# Points with the same active set share the linear algebra. Every point keeps its own iterates and stops on its own, so its
# result does not depend on the others.

Bools = NDArray[np.bool_]


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
            problems.append(end - (1.0 - share) * finite_or(change, 0.0))
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
        ends = (size <= CONVERGED) & ((size <= ROUNDING) | (size > MAX_RATIO * last[todo]))
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


# Polynomials through the optima at a few points of a block, for starting points of Newton's method at the others.


def block_nodes(ends: list[tuple[int, int]]) -> list[Index] | None:
    """Return the places of the nodes of a block along every axis, close to Chebyshev's; None if it has too few points."""
    sizes = [last - first + 1 for first, last in ends]
    for most in NODES:
        counts = [min(most, size) for size in sizes]
        if math.prod(sizes) >= POINTS_PER_NODE * math.prod(counts):
            shares = [0.5 - 0.5 * np.cos(np.pi * np.arange(count) / max(1, count - 1)) for count in counts]
            return [
                first + np.rint(share * (last - first)).astype(np.intp) for share, (first, last) in zip(shares, ends, strict=True)
            ]
    return None


@dataclass(frozen=True)
class Prediction:
    """Polynomials in the places along the axes, through the optima at the nodes of a block.

    `nodes`: places along each axis; `values` (nodes, n + n + m): scaled designs and multipliers; `sides` (n + m,): the active set
    of all nodes.
    """

    nodes: list[Index]
    values: Array
    sides: NDArray[np.int8]

    @classmethod
    def through(cls, nodes: list[Index], optima: BatchOptima) -> Self | None:
        """Return the polynomials; None if a node has no optimum, or another active set than the others."""
        if not np.all(optima.optimal) or np.any(optima.sides != optima.sides[0]):
            return None
        return cls(nodes, np.hstack([optima.x, optima.multipliers]), optima.sides[0])

    def at(self, places: tuple[Index, ...]) -> tuple[Array, Array]:
        """Return scaled designs (points, n) and multipliers (points, n + m), each the same in any batch."""
        weights = [_lagrange(nodes, place) for nodes, place in zip(self.nodes, places, strict=True)]
        values = np.zeros((len(places[0]), self.values.shape[1]))
        for value, factors in zip(self.values, itertools.product(*weights), strict=True):
            values += math.prod(factors[1:], start=factors[0])[:, None] * value
        n = self.values.shape[1] - len(self.sides)
        return values[:, :n], values[:, n:]


def _lagrange(nodes: Index, places: Index) -> list[Array]:
    """Return the value of each Lagrange polynomial of the nodes at places (points,)."""
    return [
        np.prod(
            [(places - other_node) / (node - other_node) for other_node in nodes if other_node != node] or [np.ones(len(places))],
            axis=0,
        )
        for node in nodes
    ]


K = TypeVar("K")
T = TypeVar("T")


class GridProgramme(Protocol):
    """One programme for many points of a grid: `evaluate` it, and its parameters and bounds at points (points,).

    `kept`: indices of the parameters that have the values of the optimum that is continued, such as its exchange points.
    """

    @property
    def evaluate(self) -> Evaluator:
        """Evaluates the programme."""

    @property
    def kept(self) -> Index:
        """Indices of parameters."""

    def problem(self, points: Index) -> BatchProblem:
        """Return the problem at points."""


@dataclass
class GridOptima:
    """Optima at some points of a grid: see `BatchOptima`. `searched` (points,): whether the optimum is that of a search there.

    `near` (points,) are the solutions from which the optima were continued; rows of x and of the sides end with those of the
    programmes of these.
    """

    x: Array
    sides: NDArray[np.int8]
    objective: Array
    optimal: Bools
    searched: Bools
    near: NDArray[Any]

    @classmethod
    def empty(cls, count: int) -> Self:
        """Return points without an optimum."""
        x, sides = np.empty((count, 0)), np.empty((count, 0), dtype=np.int8)
        none = np.zeros(count, dtype=bool)
        return cls(x, sides, np.full(count, np.inf), none, none.copy(), np.full(count, None))

    def take(self, at: Index, other: BatchOptima | GridOptima, which: Index | Bools, near: NDArray[Any]) -> None:
        """Take some of other optima at some of these points."""
        for name in ("x", "sides"):
            rows, more = getattr(self, name), getattr(other, name)[which]
            rows = np.pad(rows, ((0, 0), (0, max(0, more.shape[1] - rows.shape[1]))))
            rows[at, : more.shape[1]] = more
            setattr(self, name, rows)
        self.objective[at], self.optimal[at], self.near[at] = other.objective[which], True, near
        self.searched[at] = other.searched[which] if isinstance(other, GridOptima) else False


class GridSearch:
    """Optima at the points of a grid.

    `programme` returns the one of a solution for all points. `search` returns the solution of a point, `search_many` its distinct
    optima, best first; both depend on the point alone. `large`: a few large blocks; each of their optima has a number like a
    block, from the number of blocks on. `coarse`: search of the same grid with larger blocks, whose optima are taken where its
    searches agree.
    """

    def __init__(
        self,
        programme: Callable[[NLP], GridProgramme],
        blocks: Blocks,
        search: Callable[[int], Solution | None],
        large: Blocks,
        search_many: Callable[[int], list[Solution]],
        coarse: GridSearch | None = None,
    ) -> None:
        self.programme, self.blocks, self.search = programme, blocks, search
        self.large, self.search_many, self.coarse = large, search_many, coarse
        self._searches: dict[int, tuple[Solution | None, NDArray[np.int8]]] = {}
        self._branches: dict[int, list[tuple[Solution, NDArray[np.int8]]]] = {} if coarse is None else coarse._branches
        self._predictions: dict[int, Prediction | None] = {}
        self._others_of: dict[int, set[int]] = {}

    def at_middle(self, block: int) -> Solution | None:
        """Return the usable result of the search in the middle of a block, if there is one."""
        return self._searched(block)[0]

    def _optimum(self, block: int) -> tuple[Solution, NDArray[np.int8]]:
        """Return a usable result, see `at_middle`, and its active sides."""
        solution, sides = self._searched(block)
        assert solution is not None
        return solution, sides

    def branches(self, point: int) -> list[list[Solution]]:
        """Return the optima at two opposite corners of the block of a point, best first."""
        block = int(self.blocks.of(np.array([point]))[0])
        return [[solution for solution, _ in self._many(corner)] for corner in self.blocks.corners(block)]

    def _many(self, point: int) -> list[tuple[Solution, NDArray[np.int8]]]:
        if point not in self._branches:
            keep(
                self._branches, point, [(solution, active_sides(solution)) for solution in self.search_many(point)[:MAX_BRANCHES]]
            )
        return self._branches[point]

    def _further(self, block: int) -> list[int]:
        """Return the numbers of the optima of the large blocks around a block."""
        large_block = int(self.large.of(np.array([self.blocks.middle(block)]))[0])
        return [
            self.blocks.count + neighbour * MAX_BRANCHES + rank
            for neighbour in (large_block, *self.large.neighbours(large_block))
            for rank in range(len(self._many(self.large.middle(neighbour))))
        ]

    def _middle(self, block: int) -> int:
        """Return the point of an optimum."""
        further = block - self.blocks.count
        return self.blocks.middle(block) if further < 0 else self.large.middle(further // MAX_BRANCHES)

    def _searched(self, block: int) -> tuple[Solution | None, NDArray[np.int8]]:
        if block >= self.blocks.count:
            large_block, rank = divmod(block - self.blocks.count, MAX_BRANCHES)
            return self._many(self.large.middle(large_block))[rank]
        if block not in self._searches:
            solution = self.search(self.blocks.middle(block))
            if solution is None or not solution.usable:
                keep(self._searches, block, (None, np.zeros(0, dtype=np.int8)))
            else:
                keep(self._searches, block, (solution, active_sides(solution)))
        return self._searches[block]

    def nearest(self, point: int) -> Solution | None:
        """Return the usable result of a search in the block of a point or beside it, if there is one."""
        home = int(self.blocks.of(np.array([point]))[0])
        optima = (self.at_middle(block) for block in (home, *self.blocks.neighbours(home)))
        return next((solution for solution in optima if solution is not None), None)

    def optima(self, points: Index) -> GridOptima:
        """Return the best optima found at points of the grid (points,)."""
        if self.coarse is None:
            return self._optima(points)
        of_point = self.coarse.blocks.of(points)
        blocks, block_of_point = np.unique(of_point, return_inverse=True)
        calm_points = np.flatnonzero(self.coarse.calm(blocks)[block_of_point])
        coarse, optima = self.coarse._optima(points[calm_points]), GridOptima.empty(len(points))
        known = np.flatnonzero(coarse.optimal)
        optima.take(calm_points[known], coarse, known, coarse.near[known])
        remaining = np.flatnonzero(~optima.optimal)
        further = self._optima(points[remaining])
        known = np.flatnonzero(further.optimal)
        optima.take(remaining[known], further, known, further.near[known])
        return optima

    def calm(self, blocks: Index) -> Bools:
        """Return for each block (blocks,) whether its search and those of its neighbours lead to one optimum in its middle."""
        neighbours_of_block = [self.blocks.neighbours(block) for block in blocks.tolist()]
        return np.array(
            [
                differing.isdisjoint(neighbours) and None not in map(self.at_middle, (block, *neighbours))
                for block, neighbours, differing in zip(
                    blocks.tolist(), neighbours_of_block, self._differing(blocks), strict=True
                )
            ],
            dtype=bool,
        )

    def _optima(self, points: Index) -> GridOptima:
        """Return the best optima that are found from these blocks, and from the large ones."""
        of_point, count = self.blocks.of(points), len(points)
        optima = GridOptima.empty(count)
        self._follow(optima, points, np.arange(count), of_point, predicted=True)
        blocks, block_of_point = np.unique(of_point, return_inverse=True)
        at_middle = points == np.array([self.blocks.middle(int(block)) for block in blocks])[block_of_point]
        optima.searched[:] = optima.optimal & at_middle
        nearby, differing = [self._around(block) for block in blocks.tolist()], self._differing(blocks)
        for rank in range(max(map(len, nearby), default=0)):
            begin = np.array([middle[rank] if rank < len(middle) else -1 for middle in nearby])
            differs = np.array(
                [start_block in different for start_block, different in zip(begin.tolist(), differing, strict=True)]
            )
            beyond = begin >= self.blocks.count
            selected = np.flatnonzero(
                (begin[block_of_point] >= 0) & (differs[block_of_point] | (~optima.optimal & ~beyond[block_of_point]))
            )
            self._follow(optima, points, selected, begin[block_of_point[selected]])
        for k in np.flatnonzero(at_middle & optima.optimal):  # keep the optimum of a search that Newton's method left
            middle = self.at_middle(int(of_point[k]))
            optima.optimal[k] = not (
                middle is not None and middle.objective < optima.objective[k] - MIN_IMPROVEMENT * abs(middle.objective)
            )
        return optima

    def _follow(self, optima: GridOptima, points: Index, indices: Index, blocks: Index, *, predicted: bool = False) -> None:
        """Continue the optima in the middle of blocks to some of the points, and keep those that are better.

        `predicted`: the points lie in these blocks, and the iterations begin at the predictions of the blocks.
        """
        distinct, block_of_point = np.unique(blocks, return_inverse=True)
        near = np.array([self.at_middle(block) for block in distinct.tolist()] or [None], dtype=object)
        usable = np.array([one is not None for one in near.tolist()])[block_of_point]
        indices, blocks, block_of_point = indices[usable], blocks[usable], block_of_point[usable]
        ended = self._continued(points[indices], blocks, predicted=predicted)
        with np.errstate(invalid="ignore"):
            better = ended.optimal & (ended.objective < optima.objective[indices] - MIN_IMPROVEMENT * np.abs(ended.objective))
        optima.take(indices[better], ended, better, near[block_of_point[better]])

    def _around(self, block: int) -> list[int]:
        """Return the blocks beside a block, then the numbers of the optima of the large blocks around it."""
        return [*self.blocks.neighbours(block), *self._further(block)]

    def _differing(self, blocks: Index) -> list[set[int]]:
        """Return for every block those around it that have another optimum, see `_others`."""
        new = [block for block in blocks.tolist() if block not in self._others_of]
        neighbours = {block: self._others_of[block] for block in blocks.tolist() if block not in new}
        neighbours |= zip(new, self._others(np.array(new, dtype=np.intp), [self._around(block) for block in new]), strict=True)
        for block in new:
            keep(self._others_of, block, neighbours[block])
        return [neighbours[block] for block in blocks.tolist()]

    def _others(self, blocks: Index, neighbours_of_block: list[list[int]]) -> list[set[int]]:
        """Return for every block the neighbours whose optimum, continued to its middle, differs from its own.

        Each optimum of a large block counts once, if it is reached and not much worse.
        """
        pairs = [
            (k, start_block)
            for k, neighbours in enumerate(neighbours_of_block)
            for start_block in neighbours
            if self.at_middle(start_block) is not None
        ]
        differing: list[set[int]] = [set() for _ in neighbours_of_block]
        if not pairs:
            return differing
        source, begin = np.array(pairs).T
        middles = np.array([self.blocks.middle(int(block)) for block in blocks])
        ended = self._continued(middles[source], begin)
        at_middles = [self.at_middle(int(block)) for block in blocks]
        objective = np.array([np.inf if one is None else one.objective for one in at_middles])[source]
        with np.errstate(invalid="ignore"):
            same = ended.optimal & (np.abs(ended.objective - objective) <= SAME_OBJECTIVE * np.abs(objective))
            near = (begin < self.blocks.count) | (ended.optimal & (ended.objective <= CONTINUED_RATIO * objective))
        objectives: list[list[float]] = [[] for _ in neighbours_of_block]
        for at in np.flatnonzero(~same & near).tolist():
            k, start_block, value = int(source[at]), int(begin[at]), float(ended.objective[at])
            if start_block >= self.blocks.count:
                if any(abs(value - known) <= SAME_OBJECTIVE * abs(value) for known in objectives[k]):
                    continue
                objectives[k].append(value)
            differing[k].add(start_block)
        return differing

    def _predictions_of(self, blocks: Index) -> dict[int, Prediction]:
        """Return the predictions of blocks (blocks,) of one programme that have one."""
        new = [block for block in blocks.tolist() if block not in self._predictions]
        predictions = dict.fromkeys(new) | {block: self._predictions[block] for block in blocks.tolist() if block not in new}
        nodes = {block: nodes_of_block for block in new if (nodes_of_block := block_nodes(self.blocks.ends(block))) is not None}
        if nodes:
            points = [self.blocks.points(nodes_of_block) for nodes_of_block in nodes.values()]
            sizes = [len(nodes_of_block) for nodes_of_block in points]
            ended = self._continued(np.concatenate(points), np.repeat([*nodes], sizes))
            for (block, nodes_of_block), last, size in zip(nodes.items(), np.cumsum(sizes), sizes, strict=True):
                predictions[block] = Prediction.through(nodes_of_block, ended.part(slice(last - size, last)))
        for block in new:
            keep(self._predictions, block, predictions[block])
        return {block: prediction for block, prediction in predictions.items() if prediction is not None}

    def _continued(self, points: Index, blocks: Index, *, predicted: bool = False) -> BatchOptima:
        """Continue the optima in the middle of blocks (points,) to points of the grid; see `_follow`."""
        if not len(points):
            return BatchOptima(
                np.empty((0, 0)), np.empty((0, 0)), np.empty((0, 0), dtype=np.int8), np.empty(0), np.empty(0, bool)
            )
        distinct, block_of_point = np.unique(blocks, return_inverse=True)
        groups: dict[GridProgramme, list[int]] = {}
        for k, block in enumerate(distinct.tolist()):
            groups.setdefault(self.programme(self._optimum(block)[0].nlp), []).append(k)
        parts = []
        for programme, members in groups.items():
            part = np.flatnonzero(np.isin(block_of_point, members))
            parts.append((part, self._continued_by(programme, points[part], blocks[part], predicted=predicted)))
        return parts[0][1] if len(parts) == 1 else BatchOptima.joined(len(points), parts)

    def _continued_by(self, programme: GridProgramme, points: Index, blocks: Index, *, predicted: bool) -> BatchOptima:
        """Continue optima of one programme; see `_continued`."""
        distinct, block_of_point = np.unique(blocks, return_inverse=True)
        begin, sides_of_block = zip(*(self._optimum(block) for block in distinct.tolist()), strict=True)
        kept, sides = np.array([optimum.p[programme.kept] for optimum in begin]), np.array(sides_of_block)[block_of_point]
        batch = programme.problem(points).keeping(programme.kept, kept[block_of_point])
        multipliers = np.array([optimum.conditions.multipliers for optimum in begin])[block_of_point]
        x = np.array([optimum.x for optimum in begin])[block_of_point]
        first, foretold = (x.copy(), multipliers.copy(), sides.copy()), np.zeros(len(x), dtype=bool)
        if predicted:
            for block, prediction in self._predictions_of(distinct).items():
                part = blocks == block
                first[0][part], first[1][part] = prediction.at(np.unravel_index(points[part], self.blocks.shape))
                first[2][part], foretold[part] = prediction.sides, True
        equal = batch.lower == batch.upper
        for array in (sides, first[2]):
            array[(array != 0) & equal] = 2
        direct = batch_newton(programme.evaluate, batch, *first)
        direct.optimal[foretold & ~(np.max(np.abs(direct.x - first[0]), axis=1) <= MAX_DEVIATION)] = False
        far = np.flatnonzero(~direct.optimal)
        if far.size:
            middles = programme.problem(np.array([self._middle(int(block)) for block in distinct]))
            middles = middles.keeping(programme.kept, kept).part(block_of_point[far])
            start = BatchOptima(x[far], multipliers[far], sides[far], direct.objective[far], direct.optimal[far])
            for share in SHARES:
                between = middles.towards(batch.part(far), share)
                start = batch_newton(programme.evaluate, between, start.x, start.multipliers, start.sides)
            for name, values in vars(direct).items():
                values[far] = getattr(start, name)
        return direct


def active_sides(solution: Solution) -> NDArray[np.int8]:
    """Return the active sides (n + m,) of an optimum, +1 upper and -1 lower; of dependent limits only the first ones."""
    multipliers, n = solution.conditions.multipliers, len(solution.x)
    sides, basis = np.zeros(len(multipliers), dtype=np.int8), np.zeros((0, n))
    jacobian = np.vstack([np.eye(n), solution.nlp.at(solution.x, solution.p).jacobian])
    for entry in solution.active:
        rest = jacobian[entry] - basis.T @ (basis @ jacobian[entry])
        size = np.linalg.norm(rest)
        if size > INDEPENDENT * np.linalg.norm(jacobian[entry]):
            sides[entry] = 1 if multipliers[entry] > 0.0 else -1
            basis = np.vstack([basis, rest / size])
    return sides


def keep(cache: dict[K, T], key: K, value: T, most: int = CACHED_SEARCHES) -> None:
    """Keep a value, in place of the oldest one if there are `most`."""
    if len(cache) >= most:
        del cache[next(iter(cache))]
    cache[key] = value
