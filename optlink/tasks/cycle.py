"""Optimise cycle quantities of a machine: build, multistart search, exchange of peak positions, validation."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from optlink.errors import InputError, Status
from optlink.execution import interrupts
from optlink.linkage.vector2d import Array
from optlink.problem.design import EPIGRAPH, DesignProblem
from optlink.problem.file import ProblemFile
from optlink.problem.quantity import input_of
from optlink.solvers.solution import Solution
from optlink.tasks.analyze import quick_stroke_notes
from optlink.tasks.modes import each_mode, mode_of, possible_modes
from optlink.tasks.protocol import DesignTask, Search, agreement
from optlink.tasks.results.common import Optimum, with_optimality
from optlink.tasks.results.design import LinkageDesign, SynthesisResult, of_designs
from optlink.tasks.results.evidence import tally
from optlink.tasks.results.rotation import cannot_turn
from optlink.validation import Check, validate as validate_design
from optlink.validation.cycle import cycle_of

if TYPE_CHECKING:
    from optlink.optimization.courses import TermCourse
    from optlink.optimization.nlp import NLP
    from optlink.solvers.continuum import Continuum
    from optlink.solvers.cycle_search import CycleSearchResult
    from optlink.solvers.cycle_starts import StartGroup, StartSequence


EQUAL_OBJECTIVE = 1e-6  # relative difference of the objectives of two designs of one continuum
COARSE_NODES, COARSE_STARTS = 24, 2  # positions per revolution, and starts, of the infeasibility analysis
SHARED_STARTS = 200
"""Starting points that several processes share by default; fewer take no longer than the start of the processes."""


class CycleTask(DesignTask[SynthesisResult]):
    """Optimisation of cycle quantities of a machine.

    Starting points: the given dimensions, and random ones with the same order of reversals. Default: 8.
    """

    most_starts = 10_000
    divisible = True
    free_example = 'length = { start = "120 mm", bounds = ["60 mm", "200 mm"] }'
    without_free = "`optlink analyze` the machine"

    def search(self, problem: ProblemFile, search: Search) -> SynthesisResult:
        """Return the dimensions that minimise the objective within the limits; see `DesignTask.search`."""
        results = each_mode(problem, search, _search)
        result = min(results, key=_better)
        if result.problem is problem:
            return result
        optima = sorted((optimum for one in results for optimum in one.optima), key=lambda optimum: optimum.objective)
        return replace(
            result,
            problem=problem,
            starts=sum(one.starts for one in results),
            interrupted=any(one.interrupted for one in results),
            seconds={key: sum(one.seconds[key] for one in results) for key in result.seconds},
            optima=tuple(optima),
            notes=(f"assembly mode: {mode_of(result.problem)}, the best of those left open", *result.notes),
        )

    def programme(self, problem: ProblemFile) -> NLP:
        """Return the programme of the order of events at the start; see `DesignTask.programme`.

        Raises
        ------
        InputError
            If no dimensions within the bounds let the crank turn fully.
        """
        from optlink.optimization.cycle_signals import TracedCycle
        from optlink.solvers.cycle_search import build_programme
        from optlink.solvers.cycle_starts import StartSequence

        with input_of(problem.file):
            trace = TracedCycle(problem.spec, slow=problem.spec.slow_assumed)
        groups = _first_starts(problem, StartSequence(trace, 0), 1)
        if not groups:
            message = "no dimensions were found within the bounds with which the crank turns fully"
            raise InputError(message, "Widen the bounds, or start from a design that turns", problem.file, "mechanism")
        return build_programme(trace, groups[0])

    def place(self, problem: ProblemFile, nlp: NLP, x: Array) -> None:
        """Move the exchange points to the peaks of limits and of the objective; see `DesignTask.place`."""
        from optlink.solvers.exchange import place_at_peaks

        place_at_peaks(problem.spec, nlp, nlp.lifted(x))

    def validate(self, problem: ProblemFile, design: Mapping[str, float]) -> SynthesisResult:
        """Validate given dimensions; those not named have their value in the file.

        Another value of a fixed dimension is a failed check.
        """
        begin, designs = time.perf_counter(), []
        for file in possible_modes(problem):
            values = file.spec.design(design)
            checked = validate_design(file.spec, values)
            designs.append(LinkageDesign(file, values, np.zeros(0), checked.objective, Status.NOT_SEARCHED, checked))
        seconds = {"build": 0.0, "solve": 0.0, "validate": time.perf_counter() - begin}
        return of_designs(problem, designs, 1, seconds=seconds)


TASK = CycleTask()
solve, validate = TASK.solve, TASK.validate


def _better(result: SynthesisResult) -> tuple[bool, bool, float]:
    """Return a sort key: valid before invalid before infeasible, then by objective."""
    return not result.valid, result.status in (Status.INFEASIBLE, Status.NON_FINITE), result.objective


def _search(problem: ProblemFile, search: Search) -> SynthesisResult:
    """Return the best design in one assembly mode."""
    from optlink.optimization.cycle_signals import TracedCycle
    from optlink.solvers.continuum import continuum
    from optlink.solvers.cycle_search import search_all
    from optlink.solvers.cycle_starts import STARTS, StartSequence, further_start_groups, start_groups
    from optlink.solvers.exchange import rank, with_accurate_integrals

    names, seed, timer, progress = search.names, search.seed, search.timer, search.progress
    task, count = problem.spec, STARTS if search.starts is None else search.starts
    with input_of(problem.file):
        trace = TracedCycle(task, slow=task.slow_assumed)
    samples = StartSequence(trace, seed)

    firsts = _first_starts(problem, samples, count)
    if not firsts:
        timer.lap("solve")
        return _no_rotatable_design(problem, seed, count, timer.seconds)
    interrupts.check()
    timer.lap("build")
    result = search_all(
        trace,
        firsts,
        names,
        lambda completed: progress(min(completed / count, 1.0)) if progress else None,
        lambda: further_start_groups(samples, firsts, count),
        lambda order: start_groups(samples, count, order),
        search.runs if search.shared or count >= SHARED_STARTS else None,
    )
    if not result.usable:
        result = _explained(result, names)
    of_course = partial(_of_course, task)
    solutions = {name: with_accurate_integrals(solution, name, of_course) for name, solution in result.best.items()}
    winner = min(solutions.values(), key=rank)
    chosen = next(name for name, solution in solutions.items() if solution is winner)
    equal = continuum(winner.nlp, winner, chosen) if result.usable else None
    timer.lap("solve")
    best = validated_design(problem, winner, _agreement(solutions) if len(solutions) > 1 else ())
    timer.lap("validate")
    return replace(
        of_designs(problem, [best], 1, chosen, timer.seconds),
        seed=seed,
        starts=result.starts,
        backends=solutions,
        optima=_optima(task, winner, result.solutions, equal) if result.usable else (),
        conflict=result.conflict,
        together=result.together,
        notes=tuple(_notes(problem, result, best, count, equal)),
        interrupted=result.interrupted,
    )


def validated_design(problem: ProblemFile, solution: Solution, checks: Sequence[Check] = ()) -> LinkageDesign:
    """Return a solution as a design with its validation, and further checks."""
    values, task = problem.spec.design(solution.design), problem.spec
    cycle = cycle_of(task, values)
    checked = with_optimality(validate_design(task, values, objective=solution.objective, cycle=cycle), solution)
    proof = checked.with_checks(checks)
    design = LinkageDesign(problem, values, np.zeros(0), solution.objective, solution.status, proof, solution)
    vars(design)["cycle"] = cycle  # cached, as its figures are shown too
    return design


def _of_course(task: DesignProblem, terms: TermCourse) -> NLP:
    """Return the programme with the positions of a course."""
    from optlink.optimization.programme import build

    return build(task, terms=terms)


def _explained(result: CycleSearchResult, names: Sequence[str]) -> CycleSearchResult:
    """Return the conflicting limits and the nearest design of an infeasible problem, or a feasible design if one is found.

    The conflict among [limits] is analysed on an NLP with fewer positions; the bounds of the design variables are kept.
    """
    from optlink.optimization.courses import TermCourse
    from optlink.optimization.programme import build
    from optlink.solvers import multistart
    from optlink.solvers.contract import CLOSE
    from optlink.solvers.exchange import place_at_peaks, reconcile_backends, solve_semi_infinite
    from optlink.solvers.infeasibility import Explanation, explain

    nlp, order = result.orders[0].nlp, result.orders[0]
    task, terms = nlp.terms.problem, nlp.terms
    start = nlp.design(nlp.x_start)
    coarse = build(task, terms=TermCourse(task, start, terms.trace, terms.structure, COARSE_NODES))
    required = {bound.key for bound in task.bounds}
    kept = coarse.states.union(task.free, {row.limit for row in coarse.rows} - required - {EPIGRAPH})
    ends = [nlp.design(solution.x) for solution in next(iter(order.runs.values()))[:COARSE_STARTS]]
    points = [coarse.x_of(values) for values in (*order.begin.starts[:COARSE_STARTS], *ends)]

    def follow(x: Array) -> Array:
        place_at_peaks(task, coarse, x)
        return coarse.p

    reason = explain(replace(coarse, states=kept), points=points, quick=True, follow=follow)
    if isinstance(reason, Explanation):
        miss = multistart.infeasible_at(nlp, nlp.x_of(coarse.design(reason.x)), "nearest design")
        return replace(result, nlp=nlp, best=dict.fromkeys(names, miss), conflict=reason.conflict, together=reason.together)
    x = nlp.x_of(coarse.design(reason))
    repeated = {name: solve_semi_infinite(task, multistart.solve_from(nlp, x, name), CLOSE) for name in names}
    return replace(result, nlp=nlp, best=reconcile_backends(repeated))


def _first_starts(problem: ProblemFile, samples: StartSequence, count: int) -> list[StartGroup]:
    """Return starting points: dimensions that move like the first ones in which every output with a stroke reciprocates.

    An output that reciprocates in none of the dimensions that turn fully is refused.
    """
    from optlink.solvers.cycle_starts import start_groups
    from optlink.tasks.search import no_stroke

    groups = start_groups(samples, count)
    if not groups and samples.fault is not None:
        raise InputError(*no_stroke(samples.fault, problem))
    return groups


def _notes(
    problem: ProblemFile, result: CycleSearchResult, best: LinkageDesign, count: int, equal: Continuum | None
) -> Iterator[str]:
    """Yield notes on the search and the design."""
    from optlink.solvers.cycle_starts import SAMPLES

    most = max(len(order.begin.starts) for order in result.orders)
    if most < count:
        why = f"no others of {SAMPLES * count} random designs turn fully with the same order of events"
        yield f"only {most} of {count} starts: {why}"
    if result.usable:
        if not result.nlp.terms.structure.like(result.orders[0].begin.structure):
            rows = any(event.key[0] == "corner" for event in result.nlp.terms.trace.events)
            what = "reverse, or pass the rows of a load table," if rows else "reverse"
            yield f"its motions {what} in another order than those of the initial machine"
        if equal is not None:
            yield _continuum_note(equal)
        if best.cycle is not None and best.cycle.full:
            yield from quick_stroke_notes(problem, best.cycle.machine, best.cycle.speed)


def _continuum_note(equal: Continuum) -> str:
    """Return a note that a continuum of designs is equally good, and how to select one."""
    if equal.scale:
        return f"all lengths may be scaled together: the objective and the limits stay the same; fix one, for example {equal.fix}"
    changes = ", ".join(f"{name} {share:+.3g}" for name, share in equal.changes.items() if name != equal.fix)
    together = f" ({changes} per {equal.fix} +1, in SI units)" if changes else ""
    return f"a continuum of designs is equally good: {equal.fix} may change{together}; fix {equal.fix} to pick one of them"


def _optima(task: DesignProblem, winner: Solution, solutions: list[Solution], equal: Continuum | None) -> tuple[Optimum, ...]:
    """Return distinct validated designs, the solution first; a continuum of equally good ones counts as one."""
    from optlink.solvers.multistart import SAME_DESIGN

    free = len(task.free)

    def alike(first: Solution, second: Solution) -> bool:
        near = bool(np.max(np.abs(first.x[:free] - second.x[:free])) <= 10.0 * SAME_DESIGN)
        equally_good = abs(first.objective - second.objective) <= EQUAL_OBJECTIVE * max(abs(first.objective), 1e-300)
        return near or (equally_good and equal is not None)

    optimal = sorted((s for s in solutions if s.status is Status.OPTIMAL), key=lambda s: s.objective)
    kept = tally([(winner, 0), *((solution, 1) for solution in optimal)], alike)
    return tuple(Optimum(solution.design, solution.objective, max(hits, 1)) for solution, hits in kept)


def _no_rotatable_design(problem: ProblemFile, seed: int, starts: int, seconds: dict[str, float]) -> SynthesisResult:
    """Return the result for a problem without dimensions within the bounds for which the crank turns fully."""
    from optlink.solvers.cycle_starts import SAMPLES

    note = (
        f"none of {SAMPLES * starts} random designs within the bounds lets the crank turn fully: "
        "widen the bounds, or start from a design that does"
    )
    task = problem.spec
    notes = cannot_turn(task.mechanism.quantities, task.linkage, "", task.limits.alignment.value) or (note,)
    result = TASK.validate(problem, {}).with_best(status=Status.INFEASIBLE)
    return replace(result, seconds=result.seconds | seconds, seed=seed, starts=starts, notes=notes)


def _agreement(solutions: Mapping[str, Solution]) -> tuple[Check, ...]:
    """Check that both solvers found the same objective, and the same dimensions unless several are equally good."""
    from optlink.solvers.multistart import SAME_DESIGN, compare

    first, second = solutions.values()
    count = len(first.design)
    gap = float(np.max(np.abs(first.x[:count] - second.x[:count])))
    gaps = replace(compare(first, second), design=gap)
    return agreement("sizes", gaps, SAME_DESIGN, f"<= {SAME_DESIGN:.0e}", "of the size")
