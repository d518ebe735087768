"""From a machine and what its cycle shall cost to a proven design: build, search from many starts, follow the peaks, prove."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from optlink.design.cycle import Bound, CycleProblem
from optlink.design.files import ProblemFile
from optlink.design.quantity import Unusable, nearest
from optlink.design.terms import Term
from optlink.designed import MachineDesign, measured, task_of
from optlink.errors import Fault, InputError, Status
from optlink.outcome import Optimum, optimality
from optlink.solvers.solution import Solution
from optlink.units import factor
from optlink.validation.check import Check, Validation
from optlink.validation.cycle import validate_cycle

if TYPE_CHECKING:
    from optlink.design.cycle_nlp import CycleNLP
    from optlink.design.cycle_trace import Structure, Trace
    from optlink.solvers.cycle_search import Begin

Array = NDArray[np.float64]

MAX_STARTS = 10_000
STARTS = 8
ORDERS = 3  # of reversals, in which a design is looked for where the first holds none
MOST_NODES, EXACT = 400, 1e-7  # positions per revolution, and the share to which an integral must be that of the fine sweep


def design_machine(
    problem: ProblemFile,
    backend: str = "ipopt",
    starts: int | None = None,
    seed: int = 0,
    progress: Callable[[int], None] | None = None,
) -> MachineDesign:
    """Find the sizes that make the objective least within the limits, and prove them.

    Parameters
    ----------
    problem : ProblemFile
        From `optlink.load`, with an [objective].
    backend : "slsqp", "ipopt" or "both"
        Both: each searches for itself, the better design is taken, and they must agree.
    starts : int, optional
        The given sizes, and random ones that move alike; 8 if left out.
    seed : int
        Of the random sizes.
    progress : function of the number of searches done, optional

    Raises
    ------
    InputError
        when nothing is free, or an argument is out of range.
    """
    from optlink.design.cycle_trace import Trace
    from optlink.solvers import search
    from optlink.solvers.cycle_search import SAMPLES, begins, explained, programme, rank, searched

    _check(problem, backend, starts, seed)
    task, count = task_of(problem), STARTS if starts is None else starts
    names = search.BACKENDS if backend == "both" else (backend,)
    for name in names:
        search.backend(name)  # imports are nobody's solving time
    clock = [time.perf_counter()]
    try:
        trace = Trace(task)
    except Unusable as error:
        raise InputError(Fault(error.message, error.remedy, problem.file, error.key, error.value)) from None
    orders = begins(trace, count, seed)
    if not orders:
        return _nowhere(problem, seed, count, time.perf_counter() - clock[0])
    orders = _to_and_fro(problem, trace, orders)
    nlp = programme(trace, orders[0])
    for name in names:
        search.prepare(nlp, name)
    clock.append(time.perf_counter())
    notes = []
    if len(orders[0].starts) < count:
        found_ = len(orders[0].starts)
        notes.append(f"only {found_} of {count} starts: among {SAMPLES * count} random sizes no more turn fully and move alike")
    done = 0

    def advance() -> None:
        nonlocal done
        done += 1
        if progress:
            progress(done)

    result = searched(nlp, orders[0], names, advance)
    if not result.usable:
        result = explained(result, orders[0], names)
    for order in orders[1:ORDERS] if not result.usable else ():
        other = searched(programme(trace, order), order, names, lambda: None)
        if other.usable:
            result = other
            notes.append("its motions reverse in another order than those of the given machine")
            break
    nlp, found = _dense(result.nlp, result.found)
    winner = min(found.values(), key=rank)
    chosen = next(name for name, solution in found.items() if solution is winner)
    clock.append(time.perf_counter())
    proof = validate_cycle(task, winner.design, winner.objective)
    checks = (*proof.checks, *optimality(winner), *(_agreement(found) if len(found) > 1 else ()))
    clock.append(time.perf_counter())
    clusters = search.cluster(nlp, [solution for run in result.runs.values() for solution in run])
    return MachineDesign(
        problem=problem,
        status=winner.status,
        backend=chosen,
        values=dict(winner.design),
        objective=winner.objective,
        validation=Validation(checks, proof.objective),
        seconds={name: b - a for name, a, b in zip(("build", "solve", "validate"), clock, clock[1:], strict=False)},
        seed=seed,
        starts=result.starts,
        solution=winner,
        backends=found,
        optima=tuple(Optimum(c.solution.design, c.solution.objective, c.count) for c in clusters),
        conflict=result.conflict,
        together=result.together,
        notes=tuple(notes),
    )


def check_machine(problem: ProblemFile, values: Mapping[str, float]) -> MachineDesign:
    """Prove given sizes [SI], or show where they fail; those that are not named are those of the file."""
    task, begin = task_of(problem), time.perf_counter()
    own = {name: values.get(name, task.quantities[name].value) for name in task.free}
    proof = validate_cycle(task, own)
    seconds = {"build": 0.0, "solve": 0.0, "validate": time.perf_counter() - begin}
    return MachineDesign(problem, Status.NOT_SEARCHED, "none", own, proof.objective, proof, seconds, 0, 0)


def _check(problem: ProblemFile, backend: str, starts: int | None, seed: int) -> None:
    from optlink.solvers import search

    known = [*search.BACKENDS, "both"]
    if backend not in known:
        raise InputError(Fault("unknown back end", nearest(backend, known), key="backend", value=backend))
    if starts is not None and not 1 <= starts <= MAX_STARTS:
        raise InputError(Fault("out of range", f"Give a number from 1 to {MAX_STARTS}", key="starts", value=starts))
    if seed < 0:
        raise InputError(Fault("a seed is not negative", "Give 0 or more", key="seed", value=seed))
    if not problem.model.free:
        example = 'Free one: length = { start = "120 mm", bounds = ["60 mm", "200 mm"] }, or `optlink analyze` the machine'
        raise InputError(Fault("nothing is free, there is nothing to find", example, problem.file, "mechanism"))


def _to_and_fro(problem: ProblemFile, trace: Trace, orders: list[Begin]) -> list[Begin]:
    """The orders of events in which every output whose stroke is told goes to and fro.

    Raises
    ------
    InputError
        when there is none.
    """
    wrong = [_strokeless(task_of(problem), trace, order.structure) for order in orders]
    if wrong[0] is not None and all(wrong):
        key, term, count = wrong[0]
        message = f"{term.of} reverses {count} times in a revolution" if count else f"{term.of} never reverses"
        remedy = "Name an output that goes to and fro, or start from other sizes"
        raise InputError(Fault(message, remedy, problem.file, f"{key}.of", term.of))
    return [order for order, fault in zip(orders, wrong, strict=True) if fault is None]


def _strokeless(task: CycleProblem, trace: Trace, structure: Structure) -> tuple[str, Term, int] | None:
    """A term of a stroke whose output has too few dead centres, with their number: a time ratio wants exactly two of them."""
    placed: list[tuple[str, Term]] = [("objective", goal) for goal in task.goals]
    for key, term in [*placed, *((bound.key, bound.term) for bound in task.bounds)]:
        if term.ended:
            count = structure.which.count(trace.event_of(term))
            if count < 2 or (term.quantity not in ("stroke", "end") and count != 2):
                return key, term, count
    return None


def _nowhere(problem: ProblemFile, seed: int, starts: int, seconds: float) -> MachineDesign:
    """No sizes within the bounds were found with which the crank turns fully."""
    from optlink.solvers.cycle_search import SAMPLES

    task = task_of(problem)
    values = {name: task.quantities[name].value for name in task.free}
    proof = validate_cycle(task, values)
    note = (
        f"none of {SAMPLES * starts} random sizes within the bounds lets the crank turn fully: "
        "widen the bounds, or begin from sizes that do"
    )
    times = {"build": 0.0, "solve": seconds, "validate": 0.0}
    return MachineDesign(problem, Status.INFEASIBLE, "none", values, proof.objective, proof, times, seed, starts, notes=(note,))


def _dense(nlp: CycleNLP, found: dict[str, Solution]) -> tuple[CycleNLP, dict[str, Solution]]:
    """Double the positions until integrals are those that are measured, and search on from what was found."""
    from optlink.design.cycle_nlp import NODES, build_cycle
    from optlink.solvers import search
    from optlink.solvers.levels import level, peaks

    trace = nlp.traced
    task, nodes = trace.problem, NODES
    while any(term.integral for term in trace.terms) and nodes < MOST_NODES:
        winner = search.best(list(found.values()))
        cycle = measured(task, winner.design) if winner.usable else None
        if cycle is None:
            break
        gaps = [abs(cycle.objective() - winner.objective) / max(abs(winner.objective), cycle.natural(), 1e-300)]
        values = {row.limit: row.scale.people(float(value)) for row, value in zip(nlp.rows, winner.g, strict=True)}
        for bound in task.bounds:
            if bound.term.integral:
                size = factor(bound.interval.unit, bound.interval.kind or "")
                told = values[bound.key] * size
                gaps.append(abs(cycle.figure(bound.term) - told) / max(abs(told), *map(abs, _ends(bound))))
        if max(gaps) <= EXACT:
            break
        nodes *= 2
        nlp = build_cycle(trace, nlp.structure, winner.design, nodes)
        nlp.roam(peaks(nlp, nlp.x_start).shares)
        found = {name: level(nlp, search.solve_from(nlp, nlp.x_of(solution.design), name)) for name, solution in found.items()}
    return nlp, found


def _ends(bound: Bound) -> list[float]:
    """What a figure is limited by [SI]; a millionth of nothing is no accuracy."""
    return [value for value in (bound.interval.low, bound.interval.high) if value] or [1e-300]


def _agreement(found: Mapping[str, Solution]) -> tuple[Check, ...]:
    """Both back ends found the same figure, and the same sizes unless several are equally good."""
    from optlink.solvers.search import SAME_DESIGN, compare

    one, other = found.values()
    same = compare(one, other).same
    count = len(one.design)
    gap = float(np.max(np.abs(one.x[:count] - other.x[:count])))
    alike = gap <= SAME_DESIGN
    words = "" if alike or not same else " (two of equal value)"
    return (
        Check("both back ends agree: objective", same, compare(one, other).objective, "<= 1e-06", ""),
        Check(f"both back ends agree: sizes{words}", same, gap, f"<= {SAME_DESIGN:.0e}" if alike else "-", "of the size"),
    )
