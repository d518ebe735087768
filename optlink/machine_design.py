"""From a machine and what its cycle shall cost to a proven design: build, search from many starts, follow the peaks, prove."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from optlink.analysis import Analysis, analyze
from optlink.design.cycle import CycleProblem
from optlink.design.files import ProblemFile
from optlink.design.linkages import sizes_of
from optlink.design.quantity import Unusable, nearest
from optlink.design.settled import settled
from optlink.design.terms import Term
from optlink.documents import finite, head
from optlink.errors import Fault, InputError, Status
from optlink.solvers.solution import FEASIBLE, STATIONARY, Attempt, Solution, examine
from optlink.units import KINDS, factor
from optlink.validation.check import Check, Validation
from optlink.validation.cycle import Cycle, validate_cycle

if TYPE_CHECKING:
    from optlink.design.cycle_nlp import CycleNLP, Watched
    from optlink.design.cycle_trace import Structure, Trace
    from optlink.solvers.conflict import Relaxation

Array = NDArray[np.float64]

SCHEMA = "optlink/machine-design/1"
MAX_STARTS = 10_000
STARTS = 8
SAMPLES = 64  # per start: random sizes, of which only those are searched from that move as the given machine does
MOST_NODES, EXACT = 400, 1e-7  # positions per revolution, and the share to which an integral must be that of the fine sweep
COARSE, TRIED = 24, 2  # positions per revolution, and starts, where a conflict is looked for
ALONG = 241  # positions per stroke at which a peak is looked for
EXCHANGES, LEVELLED = 16, 1e-10  # rounds, and the share by which a peak may exceed those that the programme knows
SAME = 1e-9  # of a stroke: two peaks that near to one another are one
NEAR = 0.3  # share of its level by which a local peak may be lower and yet be followed


@dataclass(frozen=True)
class Told:
    """A figure of the machine as people read it, of the given start and of the design found."""

    name: str
    words: str
    given: float
    found: float
    limit: str
    unit: str


@dataclass(frozen=True)
class Optimum:
    """A distinct optimum of the search: free sizes [SI], objective, number of searches that ended there."""

    design: Mapping[str, float]
    objective: float
    count: int


@dataclass(frozen=True, eq=False)
class MachineDesign:
    """A machine with its proof, or why there is none.

    `values`: free sizes [SI]; `objective`: what is minimised [SI], negative where a term shall be large.
    """

    problem: ProblemFile
    status: Status
    backend: str
    values: dict[str, float]
    objective: float
    validation: Validation
    seconds: dict[str, float]
    seed: int
    starts: int
    solution: Solution | None = None
    backends: dict[str, Solution] = field(default_factory=dict)
    optima: tuple[Optimum, ...] = ()
    conflict: tuple[Relaxation, ...] = ()
    together: tuple[Relaxation, ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def task(self) -> CycleProblem:
        """The model of the problem."""
        return _task(self.problem)

    @property
    def valid(self) -> bool:
        """Whether the design is proven, and an optimum if one was searched."""
        return self.status in (Status.OPTIMAL, Status.NOT_SEARCHED) and self.validation.valid

    @property
    def unit(self) -> str:
        """Unit in which people read the objective."""
        return KINDS[self.task.unit_kind].people if self.task.unit_kind else ""

    @cached_property
    def machine(self) -> ProblemFile:
        """The machine found, as a problem with every size settled: what `analyze` and `simulate` take."""
        return settled(self.problem, self._all(self.values))

    @cached_property
    def given(self) -> Analysis | None:
        """The cycle of the machine that the file starts from; None where its crank cannot turn fully."""
        return self._analysed(self._all({}))

    @cached_property
    def found(self) -> Analysis | None:
        """The cycle of the machine found; None where its crank cannot turn fully."""
        return self._analysed(self._all(self.values))

    def _all(self, values: Mapping[str, float]) -> dict[str, float]:
        return {**sizes_of(self.problem.model.quantities), **values}

    def _analysed(self, values: Mapping[str, float]) -> Analysis | None:
        try:
            made = analyze(settled(self.problem, values))
        except InputError:
            return None
        return made if made.full else None

    @cached_property
    def figures(self) -> tuple[Told, ...]:
        """The terms of the objective, then the limits, of the given machine and of the one found."""
        given, found = (_cycle(self.task, values) for values in ({}, self.values))
        told = []
        for k, goal in enumerate(self.task.goals):
            name = "objective" if self.task.single else f"objective {k + 1}"
            told.append(self._told(name, goal, given, found, f"{goal.sense}d"))
        for item in self.task.bounds:
            told.append(self._told(item.name, item.term, given, found, str(item.interval), item.interval.unit))
        return tuple(told)

    def _told(self, name: str, term: Term, given: Cycle | None, found: Cycle | None, limit: str, unit: str = "") -> Told:
        kind = self.task.kind(term)
        unit = unit or (KINDS[kind].people if kind else "")
        size = 1.0 / factor(unit, kind) if kind else 1.0
        values = [math.nan if cycle is None else cycle.figure(term) * size for cycle in (given, found)]
        return Told(name, term.words, values[0], values[1], limit, unit)

    def to_dict(self) -> dict[str, Any]:
        """The result as a JSON document: SI, or the unit that the key ends in; null where there is no finite value."""
        document = head(SCHEMA, self.problem, self.status.value, self.seed)
        document |= {
            "message": self.status.text,
            "valid": self.valid,
            "notes": list(self.notes),
            "backend": self.backend,
            "design": _people(self.task, self._all(self.values)),
            "free": list(self.task.free),
            "objective": {"value": self.objective, "unit": KINDS[self.task.unit_kind].si if self.task.unit_kind else ""},
            "figures": [vars(told) | {} for told in self.figures],
            "limits": [vars(limit) | {} for limit in self.solution.limits] if self.solution else [],
            "validation": [vars(check) | {} for check in self.validation.checks],
            "iterations": self.solution.iterations if self.solution else 0,
            "seconds": self.seconds,
            "starts": self.starts,
        }
        if self.solution:
            document |= {"kkt": self.solution.kkt, "violation": self.solution.violation, "curvature": self.solution.curvature}
        document["backends"] = {
            name: {
                "status": solution.status.value,
                "design": _people(self.task, solution.design),
                "objective": solution.objective,
                "iterations": solution.iterations,
                "kkt": solution.kkt,
                "violation": solution.violation,
                "message": solution.message,
            }
            for name, solution in self.backends.items()
        }
        document["optima"] = [
            {"design": _people(self.task, o.design), "objective": o.objective, "count": o.count} for o in self.optima
        ]
        if self.conflict:
            document["conflict"] = [vars(item) | {} for item in self.conflict]
            document["relax_together"] = [vars(item) | {} for item in self.together]
        return finite(document)  # type: ignore[no-any-return]


def _task(problem: ProblemFile) -> CycleProblem:
    assert isinstance(problem.model, CycleProblem)
    return problem.model


def _cycle(task: CycleProblem, values: Mapping[str, float]) -> Cycle | None:
    try:
        return Cycle(task, values)
    except Unusable:
        return None


def people_unit(task: CycleProblem, name: str) -> tuple[float, str]:
    """Factor from SI, and unit, in which people read a quantity."""
    kind = task.quantities[name].kind
    return 1.0 / factor(KINDS[kind].people, kind), KINDS[kind].people


def _people(task: CycleProblem, values: Mapping[str, float]) -> dict[str, float]:
    return {f"{name}_{people_unit(task, name)[1]}": value * people_unit(task, name)[0] for name, value in values.items()}


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
    from optlink.design.cycle_nlp import build_cycle
    from optlink.design.cycle_trace import Trace
    from optlink.solvers import search

    _check(problem, backend, starts, seed)
    task, count = _task(problem), STARTS if starts is None else starts
    names = search.BACKENDS if backend == "both" else (backend,)
    for name in names:
        search.backend(name)  # imports are nobody's solving time
    clock = [time.perf_counter()]
    try:
        trace = Trace(task)
    except Unusable as error:
        raise InputError(Fault(error.message, error.remedy, problem.file, error.key, error.value)) from None
    begin, structure = _begin(trace, count, seed)
    if structure is None:
        return _nowhere(problem, seed, count, time.perf_counter() - clock[0])
    _check_strokes(problem, trace, structure)
    nlp = build_cycle(trace, structure, begin[0])
    nlp.roam(peaks(nlp, nlp.lifted(nlp.x_start))[0])
    for name in names:
        search.prepare(nlp, name)
    clock.append(time.perf_counter())
    notes: tuple[str, ...] = ()
    if len(begin) < count:
        notes = (f"only {len(begin)} of {count} starts: among {SAMPLES * count} random sizes no more turn fully and move alike",)
    points, done = [nlp.x_of(values) for values in begin], 0

    def advance(_: int) -> None:
        nonlocal done
        done += 1
        if progress:
            progress(done)

    runs: dict[str, list[Solution]] = {}
    for name in names:
        runs[name] = search.multistart(nlp, name, points, advance)
        points = points[: len(runs[name])]  # fewer if interrupted
    found = {name: search.best(run) for name, run in runs.items()}
    conflict: tuple[Relaxation, ...] = ()
    together: tuple[Relaxation, ...] = ()
    if not any(solution.usable for solution in found.values()):
        found, conflict, together = _explained(nlp, names, points)
    found = {name: level(nlp, solution, name) for name, solution in found.items()}
    if len(found) > 1:
        found = search.reconcile(nlp, found)
        found = {name: level(nlp, solution, name) for name, solution in found.items()}
    nlp, found = _dense(nlp, found)
    winner = search.best(list(found.values()))
    chosen = next(name for name, solution in found.items() if solution is winner)
    clock.append(time.perf_counter())
    proof = validate_cycle(task, winner.design, winner.objective)
    checks = (*proof.checks, *_optimality(winner), *(_agreement(found) if len(found) > 1 else ()))
    clock.append(time.perf_counter())
    clusters = search.cluster(nlp, [s for run in runs.values() for s in run])
    return MachineDesign(
        problem=problem,
        status=winner.status,
        backend=chosen,
        values=dict(winner.design),
        objective=winner.objective,
        validation=Validation(checks, proof.objective),
        seconds={name: b - a for name, a, b in zip(("build", "solve", "validate"), clock, clock[1:], strict=False)},
        seed=seed,
        starts=len(points),
        solution=winner,
        backends=found,
        optima=tuple(Optimum(c.solution.design, c.solution.objective, c.count) for c in clusters),
        conflict=conflict,
        together=together,
        notes=notes,
    )


def check_machine(problem: ProblemFile, values: Mapping[str, float]) -> MachineDesign:
    """Prove given sizes [SI], or show where they fail; those that are not named are those of the file."""
    task, begin = _task(problem), time.perf_counter()
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


def _check_strokes(problem: ProblemFile, trace: Trace, structure: Structure) -> None:
    """A stroke ends at dead centres; a time ratio wants two of them."""
    task = _task(problem)
    placed = [("objective", goal) for goal in task.goals] + [(bound.key, bound.term) for bound in task.bounds]
    for key, term in placed:
        if term.ended:
            count = structure.which.count(trace.event_of(term))
            if count < 2 or (term.quantity not in ("stroke", "end") and count != 2):
                message = f"{term.of} reverses {count} times in a revolution" if count else f"{term.of} never reverses"
                remedy = "Name an output that goes to and fro, or start from other sizes"
                raise InputError(Fault(message, remedy, problem.file, f"{key}.of", term.of))


def _begin(trace: Trace, count: int, seed: int) -> tuple[list[dict[str, float]], Structure | None]:
    """Sizes to search from: the given ones, then random ones whose motions reverse in the same order."""
    task = trace.problem
    given = {name: task.quantities[name].value for name in task.free}
    structure = trace.structure(given)
    found = [given] if structure is not None else []
    for values in _samples(task, count, seed):
        if len(found) >= count:
            break
        own = trace.structure(values)
        if own is None:
            continue
        if structure is None:
            structure = own
        if own.like(structure):
            found.append(values)
    return found, structure


def _samples(task: CycleProblem, count: int, seed: int) -> Iterator[dict[str, float]]:
    """Random sizes within the bounds (scrambled Sobol points)."""
    from scipy.stats import qmc

    sobol = qmc.Sobol(len(task.free), rng=np.random.default_rng(seed))
    low, high = np.array([task.quantities[name].bounds for name in task.free]).T
    for share in sobol.random_base2(math.ceil(math.log2(SAMPLES * count))):
        yield dict(zip(task.free, (low + share * (high - low)).tolist(), strict=True))


def _nowhere(problem: ProblemFile, seed: int, starts: int, seconds: float) -> MachineDesign:
    """No sizes within the bounds were found with which the crank turns fully."""
    task = _task(problem)
    values = {name: task.quantities[name].value for name in task.free}
    proof = validate_cycle(task, values)
    note = (
        f"none of {SAMPLES * starts} random sizes within the bounds lets the crank turn fully: "
        "widen the bounds, or begin from sizes that do"
    )
    times = {"build": 0.0, "solve": seconds, "validate": 0.0}
    return MachineDesign(problem, Status.INFEASIBLE, "none", values, proof.objective, proof, times, seed, starts, notes=(note,))


def _explained(
    nlp: CycleNLP, names: tuple[str, ...], points: list[Array]
) -> tuple[dict[str, Solution], tuple[Relaxation, ...], tuple[Relaxation, ...]]:
    """Why no design is feasible, with the nearest one; or a feasible one after all.

    Which of the [limits] conflict is asked of a programme with fewer positions; the bounds of the sizes hold.
    """
    from optlink.design.cycle_nlp import build_cycle
    from optlink.design.problem import EPIGRAPH
    from optlink.solvers import search
    from optlink.solvers.conflict import Explanation, explain

    coarse = build_cycle(nlp.traced, nlp.structure, nlp.design(nlp.x_start), nodes=COARSE, slots=2)
    asked = {bound.key for bound in coarse.traced.problem.bounds}
    held = coarse.states.union(coarse.free, {row.limit for row in coarse.rows} - asked - {EPIGRAPH})
    points = [coarse.x_of(nlp.design(x)) for x in points[:TRIED]]
    reason = explain(replace(coarse, states=held), points=points)
    if isinstance(reason, Explanation):
        miss = replace(search.given(nlp, nlp.x_of(coarse.design(reason.x)), "nearest design"), status=Status.INFEASIBLE)
        return dict.fromkeys(names, miss), reason.conflict, reason.together
    return {name: search.solve_from(nlp, nlp.x_of(coarse.design(reason)), name) for name in names}, (), ()


def _optimality(solution: Solution) -> tuple[Check, ...]:
    return (
        Check("all limits met (scaled)", solution.violation <= FEASIBLE, solution.violation, f"<= {FEASIBLE:.0e}", ""),
        Check("optimality (KKT residual)", solution.status is Status.OPTIMAL, solution.kkt, f"<= {STATIONARY:.0e}", ""),
    )


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


def _dense(nlp: CycleNLP, found: dict[str, Solution]) -> tuple[CycleNLP, dict[str, Solution]]:
    """Double the positions until integrals are those that are measured, and search on from what was found."""
    from optlink.design.cycle_nlp import NODES, build_cycle
    from optlink.solvers import search

    trace = nlp.traced
    task, nodes = trace.problem, NODES
    while any(term.integral for term in trace.terms) and nodes < MOST_NODES:
        winner = search.best(list(found.values()))
        cycle = _cycle(task, winner.design) if winner.usable else None
        if cycle is None:
            break
        gaps = [abs(cycle.objective() / winner.objective - 1.0)]
        values = {row.limit: row.scale.people(float(value)) for row, value in zip(nlp.rows, winner.g, strict=True)}
        for bound in task.bounds:
            if bound.term.integral:
                size = factor(bound.interval.unit, bound.interval.kind or "")
                gaps.append(abs(cycle.figure(bound.term) / (values[bound.key] * size) - 1.0))
        if max(gaps) <= EXACT:
            break
        nodes *= 2
        nlp = build_cycle(trace, nlp.structure, winner.design, nodes)
        nlp.roam(peaks(nlp, nlp.x_start)[0])
        found = {
            name: level(nlp, search.solve_from(nlp, nlp.x_of(solution.design), name), name) for name, solution in found.items()
        }
    return nlp, found


# --- peaks between the positions that the programme knows ------------------------------------------------------------------


def level(nlp: CycleNLP, solution: Solution, name: str) -> Solution:
    """Move the roaming positions to the peaks, and search on, until no peak exceeds what the programme knows (E. Remez)."""
    from optlink.solvers import search
    from optlink.solvers.polish import polish

    for _ in range(EXCHANGES):
        if not solution.usable:
            break
        shares, excess = peaks(nlp, solution.x)
        if excess <= LEVELLED:
            break
        nlp.roam(shares)
        x = nlp.lifted(solution.x)
        p = search.scaled(nlp, x)
        near = examine(nlp, polish(nlp, Attempt(x, solution.iterations, solution.message), p), p)
        solution = near if near.status is Status.OPTIMAL else search.solve_from(nlp, solution.x, name)
    return solution


def peaks(nlp: CycleNLP, x: Array) -> tuple[Array, float]:
    """Where terms are largest along every stroke, and by which share of its level the worst exceeds it.

    Returns
    -------
    shares : array (slots,)
        Positions within the strokes, 0 at the begin and 1 at the end.
    excess : float
    """
    trace, edges, slots = nlp.traced, nlp.edges(x), nlp.slots // nlp.strokes
    known = trace.known(nlp.design(x))
    grid = np.linspace(0.0, 1.0, ALONG)
    shares = nlp.p[len(nlp.p) - nlp.slots :].copy()  # what was a peak before stays as long as there is room
    worst = -math.inf
    for j in range(nlp.strokes):
        begin, span = edges[j], edges[j + 1] - edges[j]
        senses = np.asarray(trace.sensed([*known, begin + 0.5 * span]), dtype=float).ravel()

        def signals(at: Array, begin: float = begin, span: float = span, senses: Array = senses) -> Array:
            return trace.signals(*known, begin + span * at, *senses)

        found: list[tuple[float, float]] = []
        whole = signals(grid)
        for watched in nlp.watched:
            top = x[watched.level] if watched.level is not None else watched.bound
            size = max(abs(top), 1e-9)
            least = top - 1.1 * NEAR * size
            found += [((height - top) / size, at) for height, at in _local(watched, least, whole, grid, signals)]
        if found:
            worst = max(worst, max(found)[0])
        chosen: list[float] = []
        for excess, at in sorted(found, reverse=True):
            if excess < -NEAR or len(chosen) == slots:
                break
            if all(abs(at - other) > SAME for other in chosen):
                chosen.append(at)
        kept = [at for at in shares[j * slots : (j + 1) * slots].tolist() if all(abs(at - other) > SAME for other in chosen)]
        shares[j * slots : (j + 1) * slots] = [*chosen, *kept][:slots]
    return shares, worst


def _local(
    watched: Watched, least: float, whole: Array, grid: Array, signals: Callable[[Array], Array]
) -> Iterator[tuple[float, float]]:
    """Local peaks (height, place) of a term along a stroke that are at least so high, closed in on."""
    from optlink.linkage.refine import extremes

    score = watched.score(whole)
    left, right = np.insert(score[:-1], 0, -np.inf), np.append(score[1:], -np.inf)
    for k in np.flatnonzero((score >= left) & (score > right) & (score >= least)).tolist():
        bracket = np.linspace(grid[max(k - 1, 0)], grid[min(k + 1, len(grid) - 1)], 9)
        at, values = extremes(lambda u: watched.score(signals(u))[None, :], bracket)
        yield float(values[0, 1]), float(at[0, 1])
