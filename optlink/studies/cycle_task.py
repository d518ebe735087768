"""Sweep task that optimises a machine cycle at every point of a grid.

If only limits vary, the programme is built once: their bounds are its parameters. Within a chunk, each search starts from the
result of a neighbouring point and from the anchors of the task. Without either, the first search of a chunk starts from the
starting point of the problem and from random dimensions. So no chunk depends on another. Every machine is validated as by
`solve`.
"""

from __future__ import annotations

import copy
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

from optlink.errors import Status
from optlink.optimization.courses import TermCourse
from optlink.optimization.cycle_signals import TracedCycle
from optlink.problem.file import ProblemFile
from optlink.problem.quantity_keys import place_of
from optlink.solvers.event_orders import at_edge, misfit
from optlink.studies.continuation import FOLLOWED
from optlink.studies.grid import Grid
from optlink.studies.reoptimise_task import FOLLOWED_CHUNK, SEARCHED, SLOW_CHUNK, ReoptimiseTask, active
from optlink.studies.sweep_task import FoundOptimum, OptimumTask
from optlink.studies.target_programme import TargetProgramme
from optlink.tasks.design import solve as solve_cycle
from optlink.tasks.modes import possible_modes
from optlink.tasks.protocol import completed
from optlink.tasks.results.design import SynthesisResult, of_designs
from optlink.tasks.search import validated_design

BOUNDS = ("min", "max", "exactly")


@dataclass(frozen=True)
class CycleTask(OptimumTask):
    """Optimum at every point; `anchors`: dimensions [SI] of machines from which each search starts too."""

    anchors: tuple[tuple[tuple[str, float], ...], ...] = ()

    @cached_property
    def programme(self) -> CycleProgramme | None:
        """Common programme of all points; None if every point needs its own."""
        if possible_modes(self.problem) != [self.problem]:
            return None
        limits = [axis.key.rpartition(".") for axis in self.grid.axes]
        limit_keys = [f"limits.{name}" for name in self.problem.spec.limits.named]
        if not all(limit in limit_keys and side in BOUNDS for limit, _, side in limits):
            return None
        common = CycleProgramme(self.problem.override(self.grid.changes(0)), self.backend)
        return common if common.possible else None

    def lines(self, index: int) -> list[list[str]]:
        """Return the rows of a chunk."""
        results: dict[int, SynthesisResult] = {}
        rows = []
        for point in self.span(index):
            task = self.problem.override(self.grid.changes(point))
            near = results.get(point - 1 if point % self.grid.row else point - self.grid.row)
            begin = [*([] if near is None else [near.design]), *map(dict, self.anchors)]
            result = min(
                (self.near(point, task, sizes) for sizes in begin),
                key=lambda candidate: (not candidate.valid, candidate.objective),
                default=None,
            )
            how = FOLLOWED
            if result is None or not result.valid:
                result, how = self.searched(task), SEARCHED
            if result.valid:
                results[point] = result
            rows.append(self.result_row(point, result, how))
        return rows

    def near(self, point: int, file: ProblemFile, design: Mapping[str, float]) -> SynthesisResult:
        """Return the machine of a point, searched from given dimensions."""
        result = None if self.programme is None else self.programme.design(file, design)
        return completed(solve_cycle(with_starting_values(file, design), self.backend, starts=1)) if result is None else result

    def searched(self, task: ProblemFile) -> SynthesisResult:
        """Return the machine of a separate search, repeated once from its result if the peak exchange did not converge."""
        result = completed(solve_cycle(task, self.backend))
        if result.valid or result.status is not Status.OPTIMAL:
            return result
        repeated = completed(solve_cycle(with_starting_values(task, result.design), self.backend, starts=1))
        return repeated if repeated.valid else result

    def result_row(self, point: int, result: SynthesisResult, how: str) -> list[str]:
        """Return the row of a machine."""
        usable = result.solution is not None and result.status in (Status.OPTIMAL, Status.STALLED)
        failed = [item.name for item in result.conflict] or result.validation.failed
        limits = active(result.solution) if usable and result.solution is not None else ()
        row = FoundOptimum(result.design, result.objective, result.status, result.valid, dict.fromkeys(failed), limits, how)
        return self.optimum(point, row)


def optimum_task(
    problem: ProblemFile, grid: Grid, backend: str, chunk: int, anchors: Sequence[Mapping[str, float]] = ()
) -> CycleTask | ReoptimiseTask:
    """Return the task that optimises a problem at every point of a grid."""
    if problem.task == "cycle":
        return CycleTask(problem, grid, SLOW_CHUNK, backend, tuple(tuple(sizes.items()) for sizes in anchors))
    task = ReoptimiseTask(problem, grid, chunk, backend)
    shared = task.template.model.shares_programme([axis.key for axis in grid.axes])
    return task if shared else replace(task, chunk=FOLLOWED_CHUNK)


class CycleProgramme:
    """One programme for many bounds of its limits, traced and compiled once."""

    def __init__(self, problem: ProblemFile, backend: str) -> None:
        self.task, self.backend = problem.spec, backend
        self.trace = TracedCycle(self.task, slow=self.task.slow_assumed)
        self.start = {name: self.task.quantities[name].value for name in self.task.free}
        self.structure = self.trace.structure(self.start)
        self.possible = self.structure is not None and not any(term.integral for term in self.trace.terms)

    @cached_property
    def programme(self) -> TargetProgramme:
        """Programme with the limits of the problem."""
        assert self.structure is not None
        terms = TermCourse(self.task, self.start, self.trace, self.structure.definite)
        return TargetProgramme(self.task, 1, self.backend, terms=terms)

    def design(self, problem: ProblemFile, start_values: Mapping[str, float]) -> SynthesisResult | None:
        """Return the machine of a problem with other bounds; None if another order of its events may allow a better one.

        `start_values` [SI].
        """
        begin = time.perf_counter()
        structure = self.trace.structure(start_values)
        if structure is None or self.structure is None or not structure.like(self.structure):
            return None
        if not self.programme.bind(problem.spec):
            return None
        built = time.perf_counter()
        solution = self.programme.optimum(problem.spec, start_values)
        nlp, terms = solution.nlp, solution.nlp.terms
        if at_edge(solution) or (solution.usable and misfit(terms.trace, terms.structure, nlp.given | solution.design)):
            return None
        solved = time.perf_counter()
        design = validated_design(problem, solution)
        seconds = {"build": built - begin, "solve": solved - built, "validate": time.perf_counter() - solved}
        return replace(of_designs(problem, [design], 1, self.backend, seconds), seed=0, starts=1)


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
