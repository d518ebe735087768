"""Sweep task that finds an optimum at every point of a grid.

Programmes are built once: what varies are their parameters and bounds. Searches are made in the middle of every block of
neighbouring points; Newton's method leads from there to the optima of all points of the block at once
(`optlink.studies.batch_optima`).
A point where it does not end at a verified optimum is searched. Every optimum is validated like a single one. A row depends on
the grid alone.

The programme of a law at fixed positions takes arrays of points, and its searches are single ones. Other programmes have the
places of their peaks as unknowns; each search is that of the problem. Where what varies is no parameter of a programme, every
point has its own, and begins at the optima in the middle of a small block.
"""

from __future__ import annotations

import copy
import itertools
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from optlink.errors import InputError, Status
from optlink.execution.worker import Runs
from optlink.linkage.vector2d import TURN, Array, finite_or
from optlink.optimization.courses import course_again
from optlink.optimization.multipliers import ACTIVE
from optlink.optimization.nlp import NLP, BatchNLP
from optlink.optimization.parameters import constant_values
from optlink.optimization.programme import build
from optlink.optimization.terms import rows as limit_rows
from optlink.problem.design import DesignProblem, is_parameter
from optlink.problem.file import ProblemFile
from optlink.problem.mechanism import sizes_of
from optlink.problem.quantity import Quantity, check_choice, place_of
from optlink.problem.rounding import NO_GRID
from optlink.solvers import multistart
from optlink.solvers.contract import selectable
from optlink.solvers.exchange import with_peaks
from optlink.solvers.solution import FEASIBLE, SAME_OBJECTIVE, Attempt, Solution
from optlink.studies.batch_optima import (
    FOLLOWED,
    MAX_BLOCK_POINTS,
    BatchProblem,
    Blocks,
    GridSearch,
    coarse_block,
    follow_optimum,
    keep,
)
from optlink.studies.grid import Grid, column_name
from optlink.studies.optimum_parameters import FastOverride
from optlink.studies.sweep_task import FROM_KNOWN, OPTIMISE, OUTCOME, SweepTask
from optlink.studies.target_programme import PeakProgramme, TargetProgramme, in_order, limit_key, variables_of
from optlink.tasks import design as targets
from optlink.tasks.certify import automatic
from optlink.tasks.protocol import completed
from optlink.tasks.results.design import DISTINCT, NO_ANGLE, LinkageDesign, SynthesisResult, of_designs
from optlink.tasks.run import design_task, solve
from optlink.tasks.search import validated_design
from optlink.units import in_si
from optlink.validation import validate, validate_batch

Index = NDArray[np.intp]
CHUNK, DESIGN_CHUNK = 100, 25  # points per chunk, of the programme of a law at fixed positions and of others
FOLLOWED_CHUNK = 8  # points per chunk, and per block, if every point has its own programme
DESIGN_CHUNKS = 8  # least number of chunks of larger grids than that, which several processes share
MOST_AHEAD = 16  # searches whose results each process gets
FOLLOWED_RATIO = 1.5  # of the best objective of a search, up to which its other designs are followed too
FEWEST_BLOCKS = 1.5  # approximate least number of blocks, each with a search of the problem: two for three points
LARGEST_CHUNK, CHUNKS = 10_000, 10  # points of the chunks of a large grid, and the least number of chunks
BATCH, FILES = 2_000, 500  # points per batch; if each is read from the file, and files and results of searches that are kept
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
class ReoptimiseTask(SweepTask):
    """Optimum at every point; `starts`: starting points of each search; `anchors`: designs [SI] from which it begins too.

    `found`: results of searches by their points.
    """

    mode = OPTIMISE

    backend: str
    starts: int = 1
    anchors: tuple[tuple[tuple[str, float], ...], ...] = ()
    found: tuple[tuple[int, SynthesisResult], ...] = field(default=(), compare=False)

    @property
    def options(self) -> dict[str, Any]:
        """The back end."""
        return {"backend": self.backend}

    @cached_property
    def template(self) -> ProblemFile:
        """The problem at the first point, whose design variables are those of all points."""
        return self.problem.override(self.grid.changes(0))

    @cached_property
    def free(self) -> dict[str, Quantity]:
        """Design variables."""
        model = self.template.model
        return {name: model.quantities[name] for name in model.free}

    @property
    def columns(self) -> list[str]:
        """The axes, the design variables and the objective [SI], and the outcome."""
        free = [column_name(name, quantity.display[1]) for name, quantity in self.free.items()]
        return [*(axis.column for axis in self.grid.axes), *free, self.objective_column, *OUTCOME]

    @property
    def objective_column(self) -> str:
        """Name of the column of the objective."""
        return column_name("objective", self.template.model.shown_objective(0.0).unit)

    def shown(self, objective: float) -> float:
        """Return the value of the column [SI] for a minimised value, which is not always that of the objective."""
        shown = self.template.model.shown_objective(objective)
        return shown.value * in_si(shown.unit)[0]

    def from_known(self, point: int, design: Mapping[str, float]) -> list[str] | None:
        """Return the row of the optimum near a design [SI], or of the design itself; None if it is not valid at the point."""
        file = self.problem.override(self.grid.changes(point))
        known: Any = design_task(file).validate(file, design)
        if not known.valid:
            return None
        near = near_design(file, design, self.backend)
        return self.result_row(point, near if near.valid else known, FROM_KNOWN)

    def optimum(
        self, point: int, end: SynthesisResult | Solution, how: str, valid: bool, failed: Iterable[str], limits: Iterable[str]
    ) -> list[str]:
        """Return the row of an optimum: names of failed checks and of active limits, how it was found.

        Design and objective are empty unless the search is optimal or stalled.
        """
        usable = valid or end.status in (Status.OPTIMAL, Status.STALLED)
        sizes = [end.design.get(name, math.nan) for name in self.free]
        figures = [value if usable else math.nan for value in (*sizes, self.shown(end.objective))]
        return self.row(point, figures, end.status.value, str(valid).lower(), "; ".join(failed), "; ".join(limits), how)

    @cached_property
    def shared(self) -> bool:
        """Whether all points have one programme of a law at fixed positions, and take arrays of their numbers."""
        template = self.template.model
        return template.shares_programme([axis.key for axis in self.grid.axes]) and self.fast_override.possible

    @cached_property
    def programme(self) -> ParametricProgramme:
        """Common programme of all points."""
        return ParametricProgramme(self.template, self.fast_override, self.grid)

    @cached_property
    def fast_override(self) -> FastOverride:
        """Sets values in the model."""
        return FastOverride(self.template.spec, self.grid.axes)

    @property
    def parametric(self) -> bool:
        """Whether what varies are parameters of the programmes of all designs."""
        limited = [limit_key(part) for part in getattr(self.template.model, "parts", ())]
        return all(is_parameter(axis.key) or axis.key in limited for axis in self.grid.axes)

    @cached_property
    def grid_search(self) -> GridSearch:
        """Search for the optima of the common programmes."""

        def searches(most: int | None, coarse: GridSearch | None = None) -> GridSearch:
            if self.shared:
                blocks, large = Blocks(self.grid, most), Blocks(self.grid, self.grid.count)
                return GridSearch(lambda _: self.programme, blocks, self._search, large, self._search_many, coarse)
            blocks = Blocks(self.grid, most if self.parametric else FOLLOWED_CHUNK, FEWEST_BLOCKS)
            return GridSearch(lambda nlp: self._peak_programmes[id(nlp)], blocks, self._optimum, blocks, self._optima, coarse)

        coarse = coarse_block(self.grid.count)
        return searches(None, searches(coarse) if coarse > MAX_BLOCK_POINTS else None)

    def prepared(self, todo: list[int], runs: Runs) -> tuple[ReoptimiseTask, float]:
        """Return the task with the searches in the middles of few blocks, each made once, not in every process."""
        search = None if self.shared else self.grid_search
        if search is None or search.coarse is not None:
            return self, 0.0
        homes = search.blocks.of(np.concatenate([self.span(index) for index in todo])).tolist()
        around = {block for home in homes for block in (home, *search.blocks.neighbours(home))}
        if len(around) > MOST_AHEAD:
            return self, 0.0
        points = [search.blocks.middle(block) for block in sorted(around)]
        answers = list(runs(self.searched, points))
        found = tuple((point, answer.value) for point, answer in answers)
        return replace(self, found=found), sum(answer.cpu for _, answer in answers)

    def lines(self, index: int) -> list[list[str]]:
        """Return the rows of a chunk."""
        rows: dict[int, list[str]] = {}
        points, batch, followed = np.array(self.span(index)), FILES, self._designs
        if self.shared:
            batch, followed = BATCH, self._followed
        for first in range(0, len(points) if self.shared or self.parametric else 0, batch):
            rows |= followed(points[first : first + batch])
        again = self._again if self.shared else self._beside_row
        return [rows[point] if point in rows else again(point) for point in self.span(index)]

    # --- programmes with the places of their peaks as unknowns -----------------------------------------------------------

    def _designs(self, points: Index) -> dict[int, list[str]]:
        """Return the rows of the points at which Newton's method from the optimum of a search ends at a valid optimum."""
        optima, rows = self.grid_search.optima(points), dict[int, list[str]]()
        for k in np.flatnonzero(optima.optimal).tolist():
            point, near = int(points[k]), optima.near[k]
            programme = self._peak_programmes[id(near.nlp)]
            solution = programme.solution(point, near, optima.x[k])
            design = None if solution is None else validated_design(programme.file(point), solution)
            if design is not None and design.valid:
                rows[point] = self._design_row(point, [design], SEARCHED if optima.searched[k] else FOLLOWED)
        return rows

    def _design_row(self, point: int, designs: list[LinkageDesign], how: str) -> list[str]:
        return self.result_row(point, of_designs(designs[0].problem, designs, len(designs), self.backend), how)

    def _beside_row(self, point: int) -> list[str]:
        """Return the row of a point beside those that were searched: of the best valid design near theirs, else of a search."""
        search = self.grid_search
        home = int(search.blocks.of(np.array([point]))[0])
        for block in (home, *search.blocks.neighbours(home)) if point != search.blocks.middle(home) else ():
            ends = [self._beside(design, point) for design in self._branches(search.blocks.middle(block))]
            if valid := [end for end in ends if end is not None and end.valid]:
                return self._design_row(point, valid, FOLLOWED)
        return self.result_row(point, self.searched(point), SEARCHED)

    def searched(self, point: int) -> SynthesisResult:
        """Return the result of a search of a point, from the anchors if there are any; it is kept.

        That of a machine is repeated once from its design if the peak exchange did not converge.
        """
        if point not in self._results:
            file = self.problem.override(self.grid.changes(point))
            near = (near_design(file, dict(sizes), self.backend) for sizes in self.anchors)
            result: Any = min(near, key=lambda result: (not result.valid, result.objective), default=None)
            if result is None or not result.valid:
                result = completed(solve(file, self.backend, rounding=NO_GRID))
                if file.task == "cycle" and not result.valid and result.status is Status.OPTIMAL:
                    again = near_design(file, result.design, self.backend)
                    result = again if again.valid else result
                result = oriented(result)
            keep(self._results, point, result, FILES)
        return self._results[point]

    def _branches(self, point: int) -> list[LinkageDesign]:
        """Return the designs of a search that are followed, best first."""
        designs = [design for design in self.searched(point).designs if design.solution is not None]
        room = (FOLLOWED_RATIO - 1.0) * abs(designs[0].objective) if designs else 0.0
        return [design for design in designs if design.objective <= designs[0].objective + room]

    def _optima(self, point: int) -> list[Solution]:
        """Return the designs of a search as optima of programmes of all points."""
        optima = []
        for design in self._branches(point):
            solution, target, task = design.solution, self._target(design), design.problem.spec
            assert solution is not None
            if not target.bind(task):
                continue
            start = multistart.solution_at(target.nlp, target.nlp.x_of(variables_of(solution)), solution.message)
            begin, rows = with_peaks(task, start)
            end = multistart.conclude(begin.nlp, Attempt(begin.x, 0, begin.message), begin.p)
            if end.status is Status.OPTIMAL:
                made = PeakProgramme(target, partial(self._file, design.problem), end.nlp, rows)
                self._peak_programmes.setdefault(id(end.nlp), made)
                optima.append(end)
        return optima

    def _optimum(self, point: int) -> Solution | None:
        return next(iter(self._optima(point)), None)

    def _target(self, near: LinkageDesign) -> TargetProgramme:
        """Return the programme of designs of the same assembly modes, sense of rotation and order of strokes as another."""
        assert near.solution is not None
        recipe = near.solution.nlp.recipe
        key = repr((near.problem.at("mechanism.assembly"), recipe))
        if key not in self._targets:
            template = near.problem.override(self.grid.changes(0)).spec
            terms = course_again(template, recipe)
            self._targets[key] = TargetProgramme(template, recipe["direction"], self.backend, terms=terms)
        return self._targets[key]

    def _file(self, definite: ProblemFile, point: int) -> ProblemFile:
        """Return the problem of a point with definite assembly modes."""
        key = repr(definite.at("mechanism.assembly")), point
        if key not in self._files:
            keep(self._files, key, definite.override(self.grid.changes(point)), FILES)
        return self._files[key]

    @cached_property
    def _files(self) -> dict[tuple[str, int], ProblemFile]:
        return {}

    @cached_property
    def _results(self) -> dict[int, SynthesisResult]:
        return dict(self.found)

    @cached_property
    def _targets(self) -> dict[str, TargetProgramme]:
        return {}

    @cached_property
    def _peak_programmes(self) -> dict[int, PeakProgramme]:
        return {}

    def _beside(self, near: LinkageDesign, point: int) -> LinkageDesign | None:
        """Return the validated optimum of a point near another design; None if its programme has other variables or strokes."""
        file, solution = self._file(near.problem, point), near.solution
        assert solution is not None
        programme = self._target(near) if self.parametric else None
        if programme is None or not programme.bind(file.spec):
            recipe = solution.nlp.recipe
            programme = TargetProgramme(file.spec, recipe["direction"], self.backend, terms=course_again(file.spec, recipe))
        values = variables_of(solution)
        if {v.name for v in programme.nlp.variables} != values.keys():
            return None
        end = programme.optimum(file.spec, values)
        return validated_design(file, end) if end.usable and in_order(end) else None

    def result_row(self, point: int, result: SynthesisResult, how: str) -> list[str]:
        """Return the row of a result."""
        result = oriented(result)
        failed = tuple(dict.fromkeys(item.name for item in result.conflict)) or result.validation.failed
        solution = result.solution
        limits = () if solution is None or not (result.problem.spec.parts or solution.usable) else active(solution)
        return self.optimum(point, result, how, result.valid, failed, limits)

    # --- the programme of a law at fixed positions ---------------------------------------------------------------------------

    def model(self, point: int) -> DesignProblem:
        """Return the problem at a point of the grid."""
        return self.fast_override.model(self.grid.values(point))

    def _search(self, point: int) -> Solution:
        """Return the best result of the searches at a point, the first of which begins at the starting point of the problem."""
        self.programme.bind(self.model(point))
        nlp = self.programme.nlp
        begin = [*multistart.starts(nlp, self.starts, 0), *(nlp.x_of(dict(sizes)) for sizes in self.anchors)]
        return multistart.best([multistart.solve_from(nlp, x, self.backend) for x in begin])

    def _search_many(self, point: int) -> list[Solution]:
        """Return the distinct optima of searches at a point from points across the bounds, best first."""
        self.programme.bind(self.model(point))
        nlp, solutions = self.programme.nlp, list[Solution]()
        high = finite_or(nlp.x_high, 1.0)
        begin = [nlp.lifted(x) for x in itertools.islice(multistart.latin_hypercubes(nlp.x_low, high, SEED), STARTS)]
        if self.starts > 1 and automatic(problem := self.problem.override(self.grid.changes(point))):
            best = completed(solve(problem, self.backend, rounding=NO_GRID)).design
            if best:  # globally optimal: local searches may all miss a narrow feasible region
                begin.append(nlp.x_of(best))
        for x in begin:
            end = multistart.solve_from(nlp, x, self.backend, persistent=False)
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
        task = self.fast_override.model(self.grid.columns(points))
        validations = validate_batch(task, task.complete(values), objective=objective)
        valid = validations.valid
        failed = {k: validations.of(k).failed for k in np.flatnonzero(~valid).tolist()}
        keys = list(map(tuple, sides.tolist()))
        labels = {key: "; ".join(_labels(nlp, np.flatnonzero(key), np.array(key))) for key in set(keys)}
        methods = np.where(optima.searched[solved], SEARCHED, FOLLOWED).tolist()
        sizes = [values[name] for name in self.free]
        figures, status = (
            np.array([*self.grid.in_si(points), *sizes, list(map(self.shown, objective.tolist()))]).T.tolist(),
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

    def _again(self, point: int) -> list[str]:
        """Return the row of a search for the optimum at a point, starting from a neighbour if there is one."""
        programme, near, corners = self.programme, self.grid_search.nearest(point), self.grid_search.branches(point)
        task = self.model(point)
        programme.bind(task)
        nlp, how = programme.nlp, FOLLOWED
        followed = None if near is None else follow_optimum(nlp, near)
        if followed is None:
            how, tries = SEARCHED, list[Solution]()
            for x in [nlp.x_start] if near is None else [near.x, nlp.x_start]:
                tries.append(multistart.solve_from(nlp, programme.within(x), self.backend))
                if tries[-1].status is Status.OPTIMAL:
                    break
            followed = multistart.best(tries)
        solution = followed
        if solution.usable and self.grid.count <= SMALL_GRID:
            corners.append(self._search_many(point))
        for rank, neighbour in (pair for corner in corners for pair in enumerate(corner)):
            end = follow_optimum(nlp, neighbour)
            if end is None and rank == 0:
                end = multistart.solve_from(nlp, programme.within(neighbour.x), self.backend)
            if end is not None and multistart.best([solution, end]) is end and not multistart.compare(solution, end).same:
                solution, how = end, SEARCHED
        scaled = 1.0 / MAX_SIZE_RATIO <= task.size / programme.size <= MAX_SIZE_RATIO
        doubtful = self.starts > 1 or not scaled or solution.status is not Status.INFEASIBLE
        if solution.status is not Status.OPTIMAL and doubtful and (anew := self.searched(point)).valid:
            return self.result_row(point, anew, SEARCHED)
        failed = validate(task, task.design(solution.design), objective=solution.objective).failed
        valid = solution.status is Status.OPTIMAL and not failed
        violated, limits = conflicting(solution) if solution.status is Status.INFEASIBLE else ((), active(solution))
        return self.optimum(point, solution, how, valid, violated or failed, limits)


class ParametricProgramme:
    """One programme of a law at fixed positions for many values of its parameters and bounds; see `GridProgramme`."""

    def __init__(self, problem: ProblemFile, override: FastOverride, grid: Grid) -> None:
        self.nlp: NLP = build(problem.spec)
        self.size, self.override, self.grid = problem.spec.size, override, grid
        self.evaluate, self.kept = BatchNLP(self.nlp, problem.spec.law), np.zeros(1, dtype=np.intp)

    def problem(self, points: Index) -> BatchProblem:
        """Return parameters and bounds at points of the grid."""
        return self.parameters(self.override.model(self.grid.columns(points)), len(points))

    def parameters(self, task: DesignProblem, count: int = 1) -> BatchProblem:
        """Return parameters and bounds of the programme for problems of the same structure.

        The numbers of `task` may be arrays (count,).
        """
        nlp, quantities = self.nlp, task.quantities
        p: list[Any] = list(nlp.p)
        p[1 : 1 + len(nlp.constants)] = constant_values(task, nlp.constants)
        bounds: list[tuple[Any, Any]] = list(zip(nlp.x_low, nlp.x_high, strict=True))
        for i, v in enumerate(nlp.variables):
            if v.name not in nlp.helpers:
                low, high = quantities[v.name].bounds
                bounds[i] = v.scaled(low), v.scaled(high)
        values = sizes_of(quantities)
        with np.errstate(all="ignore"):
            rows = limit_rows(task, values, task.reach(values), self.size)
        bounds += [(row.low, row.high) for row in rows]
        bounds += zip(nlp.low[len(rows) :], nlp.high[len(rows) :], strict=True)
        lower, upper = zip(*bounds, strict=True)
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


def optimum_task(
    problem: ProblemFile, grid: Grid, backend: str, chunk: int, anchors: Sequence[Mapping[str, float]] = ()
) -> ReoptimiseTask:
    """Return the task that optimises a problem at every point of a grid."""
    task = ReoptimiseTask(problem, grid, chunk, backend, anchors=tuple(tuple(sizes.items()) for sizes in anchors))
    most = DESIGN_CHUNK if task.parametric else FOLLOWED_CHUNK
    return task if task.shared else replace(task, chunk=min(most, -(-grid.count // DESIGN_CHUNKS)))


def near_design(file: ProblemFile, design: Mapping[str, float], backend: str) -> SynthesisResult:
    """Return the result of a search of a problem from a design [SI]."""
    if file.task == "cycle":
        return completed(targets.solve(with_starting_values(file, design), backend, starts=1))
    return completed(targets.solve(file, backend, begin=design))


def with_starting_values(problem: ProblemFile, values: Mapping[str, float]) -> ProblemFile:
    """Return the problem with other starting values of its design variables, clipped to their bounds."""
    mechanism = copy.deepcopy(problem.raw["mechanism"])
    for name, value in values.items():
        quantity = problem.model.quantities[name]
        low, high = quantity.bounds
        start = f"{min(max(value, low), high) / quantity.si_per_unit!r} {quantity.display[1]}"
        if quantity.free:
            table, key = place_of(mechanism, name)
            table[key] = {**table[key], "start": start}
    return problem.with_tables({**problem.raw, "mechanism": mechanism})


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


def oriented(result: SynthesisResult) -> SynthesisResult:
    """Return a result with the same one of several equally good designs first, whichever of them a search finds first.

    These are mirror images for a symmetric path, for example. The one with the largest first design variable in which they
    differ is chosen, so that results of neighbouring problems belong together. An angle of -180 deg is 180 deg.
    """
    if not result.designs:
        return result
    first = result.designs[0]
    equal = [d for d in result.designs if d.error <= first.error * (1.0 + SAME_OBJECTIVE) or (d.exact and first.exact)]
    equal = [d for d in equal if str(d.assembly) == min(str(other.assembly) for other in equal)]
    for name in first.whole.free:
        most = max(_unwrapped(design, name) for design in equal)
        within = DISTINCT * max(first.task.size if first.whole.quantities[name].in_metres else 1.0, abs(most))
        equal = [design for design in equal if _unwrapped(design, name) >= most - within]
    chosen = replace(equal[0], values={name: _unwrapped(equal[0], name) for name in equal[0].values})
    return replace(result, designs=(chosen, *(design for design in result.designs if design is not equal[0])))


def _unwrapped(design: LinkageDesign, name: str) -> float:
    """Return a quantity [SI]: of an angle free over a full turn, 180 deg instead of -180 deg."""
    value, quantity = design.values[name], design.whole.quantities.get(name)
    if quantity is None or not quantity.free or not design.whole.is_periodic(name):
        return value
    turned = value + math.pi <= NO_ANGLE and quantity.bounds[1] >= math.pi - NO_ANGLE
    return min(value + TURN, quantity.bounds[1]) if turned else value
