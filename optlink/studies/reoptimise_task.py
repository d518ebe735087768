"""Sweep task that finds an optimum at every point of a grid.

The programme is built once: what varies are its parameters and bounds. A search from the starting point of the problem is made
in the middle of every block of neighbouring points; Newton's method leads from there to the optima of all points of the block at
once (`optlink.studies.batch`). A point where it does not end at a verified optimum is searched. Every optimum is validated like a
single one. A row depends on the grid alone.

Other programmes, of largest errors over a range, points, poses or linkages of dyads, are searched at the first and the last point
of every chunk; their designs are followed from point to point from both ends, and the best one is kept.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from optlink.errors import InputError, Status
from optlink.linkage.vector2d import Array
from optlink.optimization.batch_nlp import BatchNLP
from optlink.optimization.constraints import rows as limit_rows
from optlink.optimization.courses import course_again
from optlink.optimization.multipliers import ACTIVE
from optlink.optimization.nlp import NLP
from optlink.optimization.programme import build
from optlink.problem.design import DesignProblem, is_parameter
from optlink.problem.file import ProblemFile
from optlink.problem.quantity import check_choice
from optlink.solvers import multistart
from optlink.solvers.contract import selectable
from optlink.solvers.solution import FEASIBLE, Solution
from optlink.studies.batch.blocks import MAX_BLOCK_POINTS, Blocks, coarse_block
from optlink.studies.batch.newton import BatchProblem
from optlink.studies.batch.optima import GridSearch
from optlink.studies.continuation import FOLLOWED, follow_optimum
from optlink.studies.fast_overrides import FastOverride
from optlink.studies.grid import Grid
from optlink.studies.sweep_task import FoundOptimum, OptimumTask
from optlink.studies.target_programme import TargetProgramme, limit_key, variables_of
from optlink.tasks import design as targets
from optlink.tasks.certify import automatic
from optlink.tasks.protocol import completed
from optlink.tasks.results.design import LinkageDesign, SynthesisResult, of_designs
from optlink.tasks.run import solve
from optlink.tasks.search import validated_design
from optlink.validation import validate, validate_batch

Index = NDArray[np.intp]
CHUNK, SLOW_CHUNK = 100, 4  # points per chunk; the second if every point needs a separate search
FOLLOWED_CHUNK = 8  # the same if the designs of searches at both ends are followed
FOLLOWED_RATIO = 1.5  # of the best objective at the end of a chunk, up to which its other designs are followed too
LARGEST_CHUNK, CHUNKS = 10_000, 10  # points of the chunks of a large grid, and the least number of chunks
BATCH = 2_000  # points per batch
STARTS, SEED = 6, 0  # searches in each of the few large blocks of a grid, from random points
SMALL_GRID = 1000  # points of a grid up to which a point that Newton's method does not reach has such searches of its own
SEARCHED = "searched"
MAX_SIZE_RATIO = 3.0  # ratio of sizes beyond which the scaling of the programme is unsuitable


def check_backend(name: str) -> None:
    """Check that studies support a solver."""
    if name == "both":
        remedy = "Give ipopt or slsqp, each in its own folder; `optlink solve --backend both` compares them for one design"
        raise InputError("a study searches with one back end", remedy, key="--backend", value=name)
    check_choice("--backend", name, selectable(), "unknown back end of a study")


def chunk_of(grid: Grid) -> int:
    """Return the number of points per chunk of a grid with one programme: large grids have large chunks."""
    return CHUNK * max(1, min(LARGEST_CHUNK // CHUNK, -(-grid.count // (CHUNKS * CHUNK))))


@dataclass(frozen=True)
class ReoptimiseTask(OptimumTask):
    """Optimum at every point; `starts`: starting points of each search; `most`: points of a block, at most."""

    starts: int = 1
    most: int | None = None

    @property
    def shared(self) -> bool:
        """Whether all points have one programme; if not, every point needs its own."""
        return self.template.model.shares_programme([axis.key for axis in self.grid.axes])

    @cached_property
    def programme(self) -> ParametricProgramme:
        """Common programme of all points."""
        return ParametricProgramme(self.template)

    @cached_property
    def fast_override(self) -> FastOverride | None:
        """Sets values in the model; None if the file has to be read again for each.

        Tolerances of a robust design are checked against each dimension, so each of its problems is read from the file.
        """
        if not self.shared or self.template.spec.requirement.robust is not None:
            return None
        override = FastOverride(self.template.spec, self.grid.axes)
        return override if override.possible else None

    @cached_property
    def grid_search(self) -> GridSearch:
        """Search for the optima of the common programme."""
        nlp = BatchNLP(self.programme.nlp, self.template.spec.law)
        large = Blocks(self.grid, self.grid.count)

        def searches(most: int | None, coarse: GridSearch | None = None) -> GridSearch:
            return GridSearch(nlp, Blocks(self.grid, most), self._problem, self._search, large, self._search_many, coarse)

        coarse = coarse_block(self.grid.count)
        return searches(self.most, searches(coarse) if self.most is None and coarse > MAX_BLOCK_POINTS else None)

    def lines(self, index: int) -> list[list[str]]:
        """Return the rows of a chunk."""
        if not self.shared:
            return self._apart(self.span(index))
        rows: dict[int, list[str]] = {}
        points = np.array(self.span(index))
        for first in range(0, len(points), BATCH):
            rows |= self._followed(points[first : first + BATCH])
        return [rows[point] if point in rows else self.optimum(point, self._again(point)) for point in self.span(index)]

    def _apart(self, points: range) -> list[list[str]]:
        """Return the rows of neighbouring points without a common programme of fixed positions."""
        files = {point: self.problem.override(self.grid.changes(point)) for point in points}
        found = {point: _searched(files[point], self.backend) for point in dict.fromkeys((points[0], points[-1]))}
        followed: dict[int, list[LinkageDesign]] = {point: [] for point in points}
        for end, way in ((points[0], 1), (points[-1], -1)):
            for design in found[end].designs:
                if design.solution is None or design.objective > FOLLOWED_RATIO * found[end].objective:
                    continue
                known = {end: design}
                for point in points[1:-1][::way]:
                    neighbour = known.get(point - way, known.get(point - way * self.grid.row))
                    near = None if neighbour is None else self._beside(neighbour, point)
                    if near is not None and near.valid:
                        known[point] = near
                        followed[point].append(near)
        rows = []
        for point in points:
            result, how = found.get(point), SEARCHED
            if result is None and followed[point]:
                result, how = of_designs(files[point], followed[point], len(followed[point]), self.backend), FOLLOWED
            rows.append(self.result_row(point, result or _searched(files[point], self.backend), how))
        return rows

    def _beside(self, near: LinkageDesign, point: int) -> LinkageDesign | None:
        """Return the validated optimum of a point near the design of a neighbour; None if its programme has other variables."""
        file, solution, angles = near.problem.override(self.grid.changes(point)), near.solution, near.crank_angles
        assert solution is not None
        key = (repr(file.at("mechanism.assembly")), -1 if near.task.data.offsets is None and angles[-1] < angles[0] else 1)
        limited = [limit_key(part) for part in file.spec.parts]
        kept = all(is_parameter(axis.key) or axis.key in limited for axis in self.grid.axes)
        like = solution.nlp
        key = (*key, *(() if like.terms is None else like.terms.structure.key))
        if key not in self._programmes:
            template = near.problem.override(self.grid.changes(0)).spec
            self._programmes[key] = TargetProgramme(template, key[1], self.backend, terms=course_again(template, like.recipe))
        programme = self._programmes[key]
        if not (kept and programme.bind(file.spec)):
            programme = TargetProgramme(file.spec, key[1], self.backend, terms=course_again(file.spec, like.recipe))
        values = variables_of(solution)
        if {v.name for v in programme.nlp.variables} != values.keys():
            return None
        return validated_design(file, programme.optimum(file.spec, values))

    @cached_property
    def _programmes(self) -> dict[tuple[Any, ...], TargetProgramme]:
        """Programmes at the first point of the grid by assembly modes, sense of rotation and order of ends of strokes."""
        return {}

    def near(self, point: int, file: ProblemFile, design: Mapping[str, float]) -> SynthesisResult:
        """Return the result of a search of a point from a design [SI]."""
        return completed(targets.solve(file, self.backend, begin=design))

    def result_row(self, point: int, result: SynthesisResult, how: str) -> list[str]:
        """Return the row of a result."""
        return self.optimum(point, _row(result, how))

    def model(self, point: int) -> DesignProblem:
        """Return the problem at a point of the grid."""
        if self.fast_override is not None:
            return self.fast_override.model(self.grid.values(point))
        return self.problem.override(self.grid.changes(point)).spec

    def _problem(self, points: Index) -> BatchProblem:
        """Return parameters and bounds of the programme at points of the grid."""
        if self.fast_override is not None:
            return self.programme.parameters(self.fast_override.model(self.grid.columns(points)), len(points))
        parts = [self.programme.parameters(self.model(point)) for point in points.tolist()]
        return BatchProblem(*(np.concatenate([vars(part)[name] for part in parts]) for name in ("p", "lower", "upper")))

    def _search(self, point: int) -> Solution:
        """Return the best result of the searches at a point, the first of which begins at the starting point of the problem."""
        self.programme.bind(self.model(point))
        nlp = self.programme.nlp
        begin = list(multistart.starts(nlp, self.starts, 0))
        if self.starts > 1 and automatic(problem := self.problem.override(self.grid.changes(point))):
            best = completed(solve(problem, self.backend)).design
            if best:  # globally optimal: local searches may all miss a narrow feasible region
                begin.append(nlp.x_of(best))
        return multistart.best([multistart.solve_from(nlp, x, self.backend) for x in begin])

    def _search_many(self, point: int) -> list[Solution]:
        """Return the distinct optima of searches at a point from points across the bounds, best first."""
        self.programme.bind(self.model(point))
        nlp, solutions = self.programme.nlp, list[Solution]()
        high = np.where(np.isfinite(nlp.x_high), nlp.x_high, 1.0)
        for x in itertools.islice(multistart.latin_hypercubes(nlp.x_low, high, SEED), STARTS):
            end = multistart.solve_from(nlp, nlp.lifted(x), self.backend, persistent=False)
            if end.status is Status.OPTIMAL and not any(multistart.compare(end, solution).same for solution in solutions):
                solutions.append(end)
        return sorted(solutions, key=lambda solution: solution.objective)

    def _followed(self, points: Index) -> dict[int, list[str]]:
        """Return the rows of the points at which Newton's method from a neighbouring optimum ends at a verified optimum."""
        nlp, optima = self.programme.nlp, self.grid_search.optima(points)
        solved = np.flatnonzero(optima.optimal)
        points, x, sides, objective = points[solved], optima.x[solved], optima.sides[solved], optima.objective[solved]
        if not len(points):
            return {}
        values = {v.name: v.origin + x[:, i] * v.size for i, v in enumerate(nlp.variables) if v.name not in nlp.helpers}
        if self.fast_override is not None:
            task = self.fast_override.model(self.grid.columns(points))
            validations = validate_batch(task, task.complete(values), objective=objective)
            valid = validations.valid
            failed = {k: validations.of(k).failed for k in np.flatnonzero(~valid).tolist()}
        else:
            tasks = [self.model(point) for point in points.tolist()]
            designs = [task.design({name: entries[k] for name, entries in values.items()}) for k, task in enumerate(tasks)]
            given = zip(tasks, designs, objective.tolist(), strict=True)
            single = [validate(task, design, objective=value) for task, design, value in given]
            valid, failed = (
                np.array([outcome.valid for outcome in single]),
                {k: outcome.failed for k, outcome in enumerate(single)},
            )
        keys = list(map(tuple, sides.tolist()))
        labels = {key: "; ".join(_labels(nlp, np.flatnonzero(key), np.array(key))) for key in set(keys)}
        methods = np.where(optima.searched[solved], SEARCHED, FOLLOWED).tolist()
        sizes = [values[name] / quantity.si_per_unit for name, quantity in self.free.items()]
        figures, status = (
            np.array([*self.grid.columns(points), *sizes, list(map(self.shown, objective.tolist()))]).T.tolist(),
            Status.OPTIMAL.value,
        )
        return {
            point: [
                *map(repr, figures[k]),
                status,
                "true" if valid[k] else "false",
                "" if valid[k] else "; ".join(failed[k]),
                labels[keys[k]],
                methods[k],
            ]
            for k, point in enumerate(points.tolist())
        }

    def _again(self, point: int) -> FoundOptimum:
        """Search for the optimum at a point, starting from a neighbour if there is one."""
        programme, near, corners = self.programme, self.grid_search.nearest(point), self.grid_search.branches(point)
        task = self.model(point)
        programme.bind(task)
        solution, how = programme.solve(near, self.backend)
        if solution.usable and self.grid.count <= SMALL_GRID:
            corners.append(self._search_many(point))
        for rank, neighbour in (pair for corner in corners for pair in enumerate(corner)):
            end = follow_optimum(programme.nlp, neighbour)
            if end is None and rank == 0:
                end = multistart.solve_from(programme.nlp, programme.within(neighbour.x), self.backend)
            if end is not None and multistart.best([solution, end]) is end and not multistart.compare(solution, end).same:
                solution, how = end, SEARCHED
        if not solution.usable and not 1.0 / MAX_SIZE_RATIO <= task.size / programme.size <= MAX_SIZE_RATIO:
            nlp = build(task)
            solution = multistart.best([solution, multistart.solve_from(nlp, nlp.x_start, self.backend)])
        if solution.status is not Status.OPTIMAL and (self.starts > 1 or solution.status is not Status.INFEASIBLE):
            anew = _searched(self.problem.override(self.grid.changes(point)), self.backend)
            if anew.valid:
                return _row(anew, SEARCHED)
        design = task.design(solution.design)
        validation = validate(task, design, objective=solution.objective)
        failed = validation.failed
        valid = solution.status is Status.OPTIMAL and not failed
        if solution.status is Status.INFEASIBLE:
            violated, at_bound = conflicting(solution)
            return FoundOptimum(solution.design, solution.objective, solution.status, valid, violated or failed, at_bound, how)
        return FoundOptimum(solution.design, solution.objective, solution.status, valid, failed, active(solution), how)


class ParametricProgramme:
    """One programme of a four-bar with a law for many values of its parameters and bounds, also for arrays of them."""

    def __init__(self, problem: ProblemFile) -> None:
        self.nlp: NLP = build(problem.spec)
        self.size = problem.spec.size

    def parameters(self, task: DesignProblem, count: int | None = None) -> BatchProblem:
        """Return parameters and bounds of the programme for problems of the same structure.

        The numbers of `task` may be arrays (count,).
        """
        nlp, quantities = self.nlp, task.quantities
        p: list[Any] = list(nlp.p)
        counted = task.counted
        for i, constant in enumerate(nlp.constants):
            value = quantities[constant.name].value if constant.name in quantities else counted[constant.name]
            p[1 + i] = (value - constant.origin) / constant.size
        bounds: list[tuple[Any, Any]] = list(zip(nlp.x_low, nlp.x_high, strict=True))
        for i, v in enumerate(nlp.variables):
            if v.name not in nlp.helpers:
                low, high = quantities[v.name].bounds
                bounds[i] = (low - v.origin) / v.size, (high - v.origin) / v.size
        values = {name: quantity.value for name, quantity in quantities.items()}
        with np.errstate(all="ignore"):
            rows = limit_rows(task, values, task.reach(values), self.size)
        bounds += [(row.low, row.high) for row in rows]
        bounds += zip(nlp.low[len(rows) :], nlp.high[len(rows) :], strict=True)
        lower, upper = zip(*bounds, strict=True)
        if count is None:
            return BatchProblem(*(np.array([array], dtype=float) for array in (p, lower, upper)))
        return BatchProblem(
            *(np.array([np.broadcast_to(array, count) for array in arrays], dtype=float).T for arrays in (p, lower, upper))
        )

    def bind(self, task: DesignProblem) -> None:
        """Set fixed quantities, bounds and limits from a problem of the same structure."""
        nlp, batch = self.nlp, self.parameters(task)
        nlp.p[:] = batch.p[0]
        for entry, (low, high) in enumerate(zip(batch.lower[0], batch.upper[0], strict=True)):
            nlp.limit(entry, low, high)

    def within(self, x: Array) -> Array:
        """Return the point within the present bounds that is nearest to x (n,)."""
        nlp = self.nlp
        return nlp.lifted(np.clip(x, nlp.x_low, nlp.x_high))

    def solve(self, near: Solution | None, backend: str) -> tuple[Solution, str]:
        """Return the optimum for the present parameters, and how it was found."""
        nlp = self.nlp
        if near is not None:
            solution = follow_optimum(nlp, near)
            if solution is not None:
                return solution, FOLLOWED
        starts = [nlp.x_start] if near is None else [near.x, nlp.x_start]
        tries = []
        for x in starts:
            tries.append(multistart.solve_from(nlp, self.within(x), backend))
            if tries[-1].status is Status.OPTIMAL:
                break
        return multistart.best(tries), SEARCHED


def _searched(file: ProblemFile, backend: str) -> SynthesisResult:
    """Return the result of a search of one problem."""
    result: Any = completed(solve(file, backend))
    return result.oriented  # type: ignore[no-any-return]


def _row(result: SynthesisResult, how: str) -> FoundOptimum:
    """Return the row of a result."""
    result = result.oriented
    failed = tuple(item.name for item in result.conflict) or result.validation.failed
    limits = () if result.solution is None else active(result.solution)
    return FoundOptimum(result.design, result.objective, result.status, result.valid, failed, limits, how)


def conflicting(solution: Solution) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the labels of the violated limits, and of the other limits at their bound, each once."""
    nlp, g = solution.nlp, solution.g
    with np.errstate(invalid="ignore"):
        beyond = np.maximum(nlp.low - g, g - nlp.high)
        off, near = (beyond > FEASIBLE) | ~np.isfinite(g), np.abs(beyond) <= ACTIVE
    names = [
        [nlp.rows[j].label for j in np.flatnonzero(mask) if nlp.rows[j].limit not in nlp.helpers] for mask in (off, near & ~off)
    ]
    return tuple(dict.fromkeys(names[0])), tuple(label for label in dict.fromkeys(names[1]) if label not in names[0])


def active(solution: Solution) -> tuple[str, ...]:
    """Return the labels of the active limits and bounds of a design, each once."""
    return _labels(solution.nlp, solution.active, solution.conditions.multipliers)


def _labels(nlp: NLP, entries: Iterable[int], sides: Array) -> tuple[str, ...]:
    """Return labels of limits and bounds, each once; a positive entry of `sides` is an upper bound."""
    n = len(nlp.variables)
    names = []
    for entry in entries:
        if entry >= n and nlp.rows[entry - n].limit not in nlp.helpers:
            names.append(nlp.rows[entry - n].label)
        elif entry < n and nlp.variables[entry].name not in nlp.helpers:
            names.append(f"{nlp.variables[entry].name} {'<=' if sides[entry] > 0.0 else '>='} its bound")
    return tuple(dict.fromkeys(names))
