"""Optima at many points of a grid: a search in the middle of every block, Newton's method from there to all of its points.

The optimum of the search in the middle of a block is compared with those of the neighbouring blocks, continued to that point;
where they differ, every point of the block gets the best one. The comparison includes further optima, from multistart searches in
the middles of a few large blocks. A grid of many points also has coarse blocks: where their searches agree, their points need no
further searches. The result at a point depends on the grid only, not on the other points that are computed with it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from optlink.linkage.vector2d import Array
from optlink.optimization.batch_nlp import Evaluator
from optlink.optimization.nlp import NLP
from optlink.solvers.multistart import SAME_OBJECTIVE
from optlink.solvers.solution import Solution
from optlink.studies.batch.blocks import Blocks
from optlink.studies.batch.newton import INDEPENDENT, BatchOptima, BatchProblem, batch_newton
from optlink.studies.batch.prediction import Prediction, block_nodes

K = TypeVar("K")
T = TypeVar("T")
Index = NDArray[np.intp]
Bools = NDArray[np.bool_]

SHARES = (0.25, 0.5, 0.75, 1.0)  # of the way to a problem that Newton's method does not reach at once
CACHED_SEARCHES = 4096  # searches that are kept for further blocks
MAX_DEVIATION = 1e-2  # scaled distance from its prediction at which an optimum may be another one
MIN_IMPROVEMENT = 1e-9  # share of the objective by which another optimum must be smaller
MAX_BRANCHES = 8  # optima of a large block, the best ones
CONTINUED_RATIO = 2.0
"""Optima of a large block up to this many times the objective in a block's middle are continued to its points."""


class GridProgramme(Protocol):
    """One programme for many points of a grid: `evaluate` it, and its parameters and bounds at points (points,).

    `kept`: indices of the parameters that have the values of the optimum that is continued, such as its exchange points.
    """

    @property
    def evaluate(self) -> Evaluator:
        """Evaluates the programme."""
        ...

    @property
    def kept(self) -> Index:
        """Indices of parameters."""
        ...

    def problem(self, points: Index) -> BatchProblem:
        """Return the problem at points."""
        ...


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
