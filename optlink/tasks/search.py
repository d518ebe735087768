"""Refine starting points of any source with all limits, and collect distinct valid designs."""

import itertools
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property, partial
from typing import Any

import numpy as np

from optlink.errors import InputError, Status
from optlink.execution.runner import ordered
from optlink.execution.worker import Runs, built, packed
from optlink.linkage.vector2d import TURN, Array
from optlink.optimization.courses import NODES, ErrorCourse, TermCourse
from optlink.optimization.cycle_signals import EventOrder, TracedCycle
from optlink.optimization.nlp import NLP
from optlink.optimization.parameters import path_variable
from optlink.optimization.programme import angle_name, build, build_again, solved_values
from optlink.problem.design import DesignProblem
from optlink.problem.file import ProblemFile
from optlink.problem.quantity import input_of
from optlink.problem.terms import Term
from optlink.solvers import multistart
from optlink.solvers.contract import BACKENDS, CLOSE, FOUND, MINIMAX, SOLVED
from optlink.solvers.exchange import (
    CROSSINGS,
    FURTHER,
    SAMPLES,
    OrderedStart,
    OrderedStarts,
    at_edge,
    best_slow_stroke,
    integral_error,
    misfit,
    orders_beside,
    place_at_peaks,
    rank,
    solve_semi_infinite,
    with_accurate_integrals,
)
from optlink.solvers.solution import SAME_OBJECTIVE, Solution
from optlink.synthesis.batch import Batch
from optlink.synthesis.batch_search import Candidate, Exploration, acceptable
from optlink.synthesis.growth import ContainedFourBar, grow_from_four_bar
from optlink.synthesis.levenberg_marquardt import minimise
from optlink.tasks.results.common import (
    OPTIMALITY_CHECK,
    ROUNDED,
    Evidence,
    Optimum,
    RejectedDesign,
    best_rejected,
    evidence,
    inexact,
    tally,
    with_optimality,
)
from optlink.tasks.results.design import LinkageDesign
from optlink.tasks.results.fit import FINE
from optlink.validation import validate
from optlink.validation.timing import in_first_cycle, passing

# Constants of the refinement of candidates.
# What a search finds, and how much longer it takes, if one of them is halved or doubled: docs/constants.md.
TRIES = 6  # candidates refined in the first round per requested design, while too few are valid
PER_ROUND = 10  # candidates refined in a later round
REORDERED = 2  # reordered candidates of a round, and unsuccessful refinements of a later round
COMPOUND_TRIES = 4  # refinements for a linkage of several dyads, unsuccessful ones of the first round: each takes seconds
IDLE_ROUNDS = 3  # rounds in a row whose reordered candidates improve no design: the last with any, unless the fit is poor
POOR_FIT_TRIES = 3  # candidates and reordered candidates of a later round refined at any cost, while the fit is poor
FIT_RATIO = 2.0  # objective at the positions, relative to the best one, up to which a fit is refined over the range
COUNTED_RATIO = 1.5  # largest error of counted optima, relative to the least one: a better one would be among them
ANY_ORDER = 3  # points that every crank passes in their order, in one direction or the other
MISSING = 0.25  # how far counts can be relied on where the best design misses the points
MOST_IN_ORDER = 0.5  # share of starts that end in order from which the order does not decide which optima are found
SAME_COST = 1e-4  # relative difference of equal costs of candidates
ROUNDING = 1e-9  # relative difference of equal errors of one coupler curve
MOST_PROGRAMMES = 24  # programmes that are kept: assembly modes, directions of the crank, orders of ends of strokes
KINKED, LEAST_ACCURACY = 4.0, 1e-3  # factor on the change of integrals by twice as many positions, and their accuracy at least
SLACK = 1e-3  # share of the breadth of an output that counts as unused
# Designs from those of a four-bar:
STARTS = 12  # per design of the four-bar and combination of assembly modes
STEPS = 120  # of the descent from each of them


def mode_of(problem: ProblemFile) -> str:
    """Return the assembly modes of a problem in words, such as "left", or "C left of B-D, E forward"."""
    assembly = problem.raw["mechanism"].get("assembly", "left")
    return assembly if isinstance(assembly, str) else ", ".join(f"{joint} {mode}" for joint, mode in assembly.items())


BEGUN = "exchange points of the first design"


class DesignOrders:
    """The orders in which the ends of strokes occur in designs of a problem with definite assembly modes."""

    def __init__(self, file: ProblemFile) -> None:
        self.file = file

    @cached_property
    def trace(self) -> TracedCycle:
        """The functions of the machine at one crank angle."""
        with input_of(self.file.file):
            return TracedCycle(self.file.spec, slow=self.file.spec.slow_assumed)

    def of(self, design: Mapping[str, float] | None) -> tuple[TracedCycle, EventOrder, Mapping[str, float]]:
        """Return the trace, the order in a design [SI] and the design; those of the first design that turns if it does not."""
        if not self.trace.events:
            return self.trace, self.trace.assumed, design or {}
        structure = None if design is None else self.trace.structure(design)
        if design is None or structure is None or self.trace.strokeless(structure) is not None:
            return self.first
        return self.trace, structure.definite, design

    @cached_property
    def first(self) -> tuple[TracedCycle, EventOrder, Mapping[str, float]]:
        """The trace, the order in the design of the file or the first random one that turns, and this design.

        Raises
        ------
        InputError
            If an output reciprocates in none of the designs that turn.
        """
        samples = OrderedStarts(self.trace, 0)
        for sample in samples.samples(SAMPLES):
            if sample.structure is not None and samples.fits(sample.structure):
                return self.trace, sample.structure.definite, sample.values
        if samples.fault is not None:
            raise InputError(*no_stroke(samples.fault, self.file))
        return self.trace, self.trace.assumed, {}


def no_stroke(fault: tuple[str, Term, int], file: ProblemFile) -> tuple[str, str, str | None, str, str]:
    """Return message, remedy, file, key and value of the error about an output that reciprocates in no design."""
    key, term, reversals = fault
    message = f"{term.of} reverses {reversals} times in a revolution" if reversals else f"{term.of} never reverses"
    return message, "Name an output with two reversals, or change the starting point", file.file, f"{key}.of", str(term.of)


def has_several_dyads(task: DesignProblem) -> bool:
    """Return whether a linkage has several dyads."""
    return len(task.linkage.groups) > 1


@dataclass(frozen=True)
class PolishTask:
    """Candidates to refine; each one is a chunk for the runner. `polisher`: the polisher, packed."""

    polisher: bytes
    candidates: tuple[Candidate, ...]
    near: bool

    def __call__(self, index: int) -> dict[str, Any]:
        """Return the fields of a refined and validated design, without problem and programme."""
        design = built(Polisher, self.polisher).polish(self.candidates[index], near=self.near)
        parts = {field.name: getattr(design, field.name) for field in fields(design) if field.name != "problem"}
        solution = design.solution
        return parts | {"solution": None if solution is None else {**solution.parts, "recipe": solution.nlp.recipe}}


@dataclass(frozen=True)
class StartTask:
    """Starting points with an order of events, each one a chunk for the runner. `polisher`: the polisher, packed."""

    polisher: bytes
    variant: int
    starts: tuple[OrderedStart, ...]

    def __call__(self, index: int) -> dict[str, Any]:
        """Return the fields of the local optimum at the positions of the programme, without the programme."""
        return built(Polisher, self.polisher).at_start(self.variant, self.starts[index]).parts


class Polisher:
    """Refines candidates to designs by the NLP with all limits, built once per assembly mode and crank direction.

    The largest deviation is minimised by the minimax method, unless this back end `alone` is to be compared with another one.
    `runs`: processes that refine several candidates at a time, if any.
    """

    def __init__(self, files: list[ProblemFile], backend: str, alone: bool = False) -> None:
        self.files, self.backend, self.alone = files, backend, alone
        self.task = files[0].spec
        self.method = (
            MINIMAX if self.task.measure == "max" and not (alone or self.task.composed or self.task.law_given) else backend
        )
        self.programmes: dict[tuple[Any, ...], NLP] = {}
        self.runs: Runs | None = None

    def programme(self, variant: int, direction: int, near: Mapping[str, float] | None = None) -> NLP:
        """Return the NLP of a file with definite assembly modes; the crank direction, +1 or -1, matters with free timing only.

        With ends of strokes it is that of the order in which they occur in the design `near` [SI], else in the first design that
        turns; the extreme values of quantities of the machine at the first design are their units.
        """
        direction, task = direction if self.task.data.offsets is None else 1, self.files[variant].spec
        if not (task.goals or task.bounds):
            return self._kept((variant, direction), lambda: build(task, direction))
        orders = self.orders[variant]
        trace, structure, at = orders.of(near)
        return self.of_order(variant, direction, trace, structure, at)

    def of_order(self, variant: int, direction: int, trace: TracedCycle, structure: EventOrder, near: Mapping[str, float]) -> NLP:
        """Return the NLP of an order of ends of strokes, that of a design `near` [SI]."""
        task = self.files[variant].spec
        key = (variant, direction, *structure.key, trace.values and tuple(trace.values.items()), NODES)
        return self._kept(key, lambda: build(task, direction, terms=TermCourse(task, near, trace, structure)))

    def _of_course(self, variant: int, direction: int, terms: TermCourse) -> NLP:
        """Return the NLP with the positions of a course, which are more than those of its order."""
        values = terms.trace.values
        key = (variant, direction, *terms.structure.key, values and tuple(values.items()), terms.count)
        return self._kept(key, lambda: build(terms.problem, direction, terms=terms))

    def _again(self, variant: int, recipe: Mapping[str, Any]) -> NLP:
        """Return the NLP that another process has built."""
        if "near" not in recipe:
            return self.programme(variant, recipe["direction"])
        return self._kept((variant, repr(recipe)), lambda: build_again(self.files[variant].spec, recipe))

    def _kept(self, key: tuple[Any, ...], make: Callable[[], NLP]) -> NLP:
        """Return a programme that is made once, and kept unless many others were needed since."""
        self.programmes[key] = self.programmes.pop(key) if key in self.programmes else make()
        if len(self.programmes) > MOST_PROGRAMMES:
            del self.programmes[next(iter(self.programmes))]
        return self.programmes[key]

    @cached_property
    def orders(self) -> list[DesignOrders]:
        """For each file, the orders in which the ends of strokes occur."""
        return [DesignOrders(file) for file in self.files]

    def key_of(self, design: LinkageDesign) -> tuple[int, int]:
        """Return the number of the file of a design, and the crank direction."""
        angles = design.crank_angles
        free = self.task.data.offsets is None
        variant = next(k for k, file in enumerate(self.files) if file is design.problem)
        return variant, -1 if free and angles[-1] < angles[0] else 1

    def polish(self, candidate: Candidate, *, near: bool = False) -> LinkageDesign:
        """Return the nearest local optimum with all limits, validated; `near`: the candidate meets its limits everywhere."""
        return self.polished(candidate.variant, self._scaled_point(candidate), near=near)

    def from_values(
        self, variant: int, values: Mapping[str, float], angles: Array | None, *, close: bool = False, track: bool = False
    ) -> LinkageDesign:
        """Return the local optimum near quantities [SI] and, with free timing, crank angles [rad], validated.

        `close`: they are nearly optimal; `track`: keep the iterates of the search.
        """
        solution = self.at_positions(variant, values, angles, close=close, track=track)
        design = self.polished(variant, solution)
        if design.solution is None or solution.path is None:
            return design
        return replace(design, solution=replace(design.solution, path=solution.path, iterations=solution.iterations))

    def at_positions(
        self, variant: int, values: Mapping[str, float], angles: Array | None = None, *, close: bool = True, track: bool = False
    ) -> Solution:
        """Return the local optimum at the positions of the programme alone; see `from_values`."""
        full = self.files[variant].spec.design(values)
        nlp, x = self._point(variant, full, angles, 1 if angles is None or angles[-1] >= angles[0] else -1)
        nlp.spread_exchange_points()
        task = self.files[variant].spec
        easy = self.backend == "ipopt" or task.measure == "max"  # SLSQP stalls at many a largest error; it refines the ends
        method = CLOSE if close and easy else self.backend
        rounds = {"continuations": multistart.CONTINUATIONS if task.law_given else 0}  # batched starts of points are better
        return multistart.solve_from(nlp, x, method, track=track, persistent=task.law_given, **rounds)

    def _point(self, variant: int, values: Mapping[str, float], angles: Array | None, direction: int) -> tuple[NLP, Array]:
        """Return the programme, and its x for all quantities [SI] and the crank angles [rad] of the first requirement, if free.

        Those of other requirements are the angles at which the linkage passes them best.
        """
        task = self.files[variant].spec
        named = dict(values)
        for part in task.parts:
            if part.data.offsets is None:
                there = angles if part is task.parts[0] and angles is not None else passing(part, part.own(values))
                named |= {angle_name(k, part.suffix): float(angle) for k, angle in enumerate(there)}
        nlp = self.programme(variant, direction, values if task.goals or task.bounds else None)
        return nlp, nlp.x_of(named)

    def polished(self, variant: int, start: Solution, *, near: bool = False) -> LinkageDesign:
        """Return the local optimum from a point of the programme, validated; see `polish`."""
        task, minimax = self.files[variant].spec, self.method == MINIMAX
        solution = solve_semi_infinite(task, start, self.method, near=near)
        if minimax and solution.status is not Status.OPTIMAL:
            solution = multistart.best([solution, solve_semi_infinite(task, start, self.backend, near=near)])
        if minimax and start.usable:
            begun = multistart.solution_at(start.nlp, start.x, start.message)  # with the exchange points of the solution
            if solution.objective > begun.objective * (1.0 + 1e-9):
                solution = replace(solution, status=Status.STALLED)  # an optimum, but not that near the start
        if start.nlp.terms is not None and start.nlp.terms.events:
            solution = min(self.over_orders(variant, [solution, *self.other_paces(variant, start)]), key=rank)
        return self.finished(variant, solution)

    def other_paces(self, variant: int, start: Solution) -> Iterator[Solution]:
        """Yield the optima near a point in which other strokes are the slow ones."""
        first = start.nlp.terms
        for slow in itertools.product((True, False), repeat=len(first.trace.paced)) if first is not None else ():
            order = replace(first.structure, slow=slow)
            if order.key != first.structure.key:
                yield self._searched(variant, start, first.trace, order, start.design)

    def finished(self, variant: int, solution: Solution) -> LinkageDesign:
        """Return the end of a search with accurate integrals and the better slow stroke, validated."""
        of_course = partial(self._of_course, variant, solution.nlp.recipe["direction"])
        solution = with_accurate_integrals(solution, self.method, of_course)
        file = self.files[variant]
        return validated_design(file, best_slow_stroke(file.spec, solution, self.method))

    def over_orders(self, variant: int, ends: Sequence[Solution], best: Solution | None = None) -> list[Solution]:
        """Return the ends of searches, and of those in other orders of ends of strokes to which they lead; some are infeasible.

        A design with other ends of strokes than its programme, which does not describe it, is searched again with its own ones.
        Where the best design, of these or known before, ends at the edge of its order, so that a better one would have another,
        the orders beside it are searched too.
        """
        ahead, judged, beside = list(ends), list[Solution](), set[tuple[Any, ...]]()
        while ahead and len(judged) < CROSSINGS + len(ends):
            end = min(ahead, key=rank)
            ahead.remove(end)
            terms, begins = end.nlp.terms, list[tuple[TracedCycle, EventOrder, Mapping[str, float]]]()
            message = misfit(terms.trace, terms.structure, end.design) if end.usable else ""
            judged.append(replace(end, status=Status.INFEASIBLE, message=message) if message else end)
            if message and message != FURTHER:
                trace = TracedCycle(terms.problem, end.design, terms.trace.slow)
                own = trace.structure(end.design)
                begins = [] if own is None else [(trace, replace(own, slow=terms.structure.slow), end.design)]
            elif min([*([best] if best else []), *judged], key=rank) is end and at_edge(end):
                begins = [(terms.trace, *each) for each in orders_beside(terms.trace, terms.structure, end.design)]
            for trace, order, values in begins:
                key = (order.key, trace.values and tuple(trace.values.items()))  # loads count angles from the traced design
                if key not in beside:
                    beside.add(key)
                    ahead.append(self._searched(variant, end, trace, order, values))
        return judged

    def _searched(
        self, variant: int, end: Solution, trace: TracedCycle, order: EventOrder, values: Mapping[str, float]
    ) -> Solution:
        """Return the optimum in another order of ends of strokes, from dimensions [SI] beside the end of a search."""
        task = self.files[variant].spec
        if not task.parts:
            return self.exchanged(self.at_start(variant, OrderedStart(order, values, values, first=False), trace))
        nlp = self.of_order(variant, end.nlp.recipe["direction"], trace, order, values)
        return solve_semi_infinite(task, self._moved(end, nlp, values), self.method)

    def at_start(self, variant: int, start: OrderedStart, trace: TracedCycle | None = None) -> Solution:
        """Return the local optimum at the positions of the programme from a starting point with an order of events.

        Every search in a programme begins with the same exchange points: the peaks of its first design.
        """
        nlp = self.at_first_peaks(variant, start, trace)
        return multistart.solve_beside(nlp, nlp.x_of(start.values), self.backend, insist=start.insists)

    def at_starts(self, variant: int, starts: Sequence[OrderedStart], runs: Runs | None = None) -> Iterator[Solution]:
        """Yield the local optima of `at_start` in order; `runs`: processes that find them, if any."""
        if runs is None:
            yield from (self.at_start(variant, start) for start in starts)
            return
        task = StartTask(packed((self.files, self.backend, self.alone)), variant, tuple(starts))
        for start, parts in zip(starts, ordered(task, len(starts), runs), strict=True):
            yield Solution(source=self.of_start(variant, start), **parts)

    def of_start(self, variant: int, start: OrderedStart, trace: TracedCycle | None = None) -> NLP:
        """Return the NLP of a starting point with an order of events."""
        return self.of_order(variant, 1, trace or self.orders[variant].trace, start.order, start.near)

    def at_first_peaks(self, variant: int, start: OrderedStart, trace: TracedCycle | None = None) -> NLP:
        """Return the NLP of a starting point with its exchange points at the peaks of its first design."""
        nlp = self.of_start(variant, start, trace)
        if BEGUN not in nlp.cache:
            place_at_peaks(self.files[variant].spec, nlp, nlp.lifted(nlp.x_start))
            nlp.cache[BEGUN] = nlp.exchange_points
        nlp.set_exchange_points(nlp.cache[BEGUN])
        return nlp

    def exchanged(self, end: Solution) -> Solution:
        """Return a local optimum at the positions of a programme without targets as one that holds between them too."""
        return solve_semi_infinite(end.nlp.terms.problem, end, CLOSE) if end.usable else end

    @staticmethod
    def _moved(solution: Solution, nlp: NLP, values: Mapping[str, float]) -> Solution:
        """Return a solution as a point of another programme of the problem, with other dimensions [SI]."""
        other = {v.name: v.value(float(y)) for v, y in zip(solution.nlp.variables, solution.x, strict=True)}
        return multistart.solution_at(nlp, nlp.x_of(other | dict(values)), "in another order of the ends of strokes")

    def refined(self, design: LinkageDesign) -> LinkageDesign:
        """Return a design that fails only by inexact figures, refined by another back end and validated again."""
        solution = design.solution
        assert solution is not None
        backend = next(name for name in BACKENDS if name != self.backend)
        again = validated_design(design.problem, solve_semi_infinite(design.whole, solution, backend, near=True))
        return min(design, again, key=lambda one: (not one.valid, one.objective))

    def relaxed(self, design: LinkageDesign) -> Callable[[ProblemFile], float]:
        """Return a function of a problem with other margins: the objective of its local optimum near a design."""

        def objective(other: ProblemFile) -> float:
            solution = design.solution
            assert solution is not None
            nlp = build_again(other.spec, solution.nlp.recipe)
            start = multistart.solution_at(nlp, solution.x, solution.message)
            return solve_semi_infinite(other.spec, start, self.method, near=True).objective

        return objective

    def each(self, candidates: Sequence[Candidate], *, near: bool = False) -> Iterator[LinkageDesign]:
        """Yield the refined designs of candidates in order; see `polish`. The caller may leave the iterator at any of them."""
        if self.runs is None:
            yield from (self.polish(candidate, near=near) for candidate in candidates)
            return
        task = PolishTask(packed((self.files, self.backend, self.alone)), tuple(candidates), near)
        for candidate, parts in zip(candidates, ordered(task, len(candidates), self.runs), strict=True):
            if parts["solution"] is not None:
                recipe = parts["solution"].pop("recipe")
                parts["solution"] = Solution(source=self._again(candidate.variant, recipe), **parts["solution"])
            yield LinkageDesign(problem=self.files[candidate.variant], **parts)

    def unpolished(self, candidate: Candidate) -> LinkageDesign:
        """Return the candidate itself, validated: a feasible design if it satisfies its limits everywhere."""
        start = self._scaled_point(candidate)
        return feasible(validated_design(self.files[candidate.variant], start))

    def itself(self, variant: int, values: Mapping[str, float], angles: Array | None) -> LinkageDesign:
        """Return quantities [SI] and crank angles [rad] that meet the targets exactly themselves as a design, validated."""
        nlp, x = self._point(variant, values, angles, 1 if angles is None or angles[-1] >= angles[0] else -1)
        return validated_design(self.files[variant], multistart.solution_at(nlp, nlp.lifted(x), SOLVED))

    def from_feasible(self, variant: int, nlp: NLP, x: Array) -> Iterator[LinkageDesign]:
        """Yield the local optimum near a point that meets all limits at the positions of its NLP, then the point itself."""
        file, start = self.files[variant], multistart.solution_at(nlp, nlp.lifted(x), "found by the analysis of limits")
        yield validated_design(file, solve_semi_infinite(file.spec, start, self.backend))
        yield feasible(validated_design(file, start))

    def _scaled_point(self, candidate: Candidate) -> Solution:
        """Return a candidate, a design for the first requirement, as a point of its NLP."""
        task = self.files[candidate.variant].spec
        first = task.parts[0]
        named = zip(first.free, candidate.x.tolist(), strict=True)
        own = {name: path_variable(first, name).value(value) for name, value in named}
        values = task.design({name if name in task.quantities else f"{first.prefix}{name}": own[name] for name in own})
        nlp, x = self._point(candidate.variant, values, candidate.t, candidate.direction)
        return multistart.solution_at(nlp, x, FOUND)


def same_end(one: Solution, other: Solution) -> bool:
    """Return whether two solutions of one programme are one design, up to whole turns of its angles."""
    if not (other.usable and multistart.compare(one, other).same):
        return False
    count = one.nlp.first_event
    gaps, periodic = (
        np.abs(one.x[:count] - other.x[:count]),
        np.array([v.periodic for v in one.nlp.variables[:count]], dtype=bool),
    )
    gaps[periodic] = np.abs(np.remainder(gaps[periodic] + math.pi, TURN) - math.pi)
    return bool(np.max(gaps) <= multistart.SAME_DESIGN)


def feasible(design: LinkageDesign) -> LinkageDesign:
    """Return a design that is not a local optimum as one that only has to satisfy all limits."""
    checks = tuple(check for check in design.validation.checks if check.name != OPTIMALITY_CHECK)
    checked = replace(design.validation, checks=checks)
    return replace(design, status=Status.FEASIBLE, validation=checked, solution=None)  # no shadow prices without an optimum


def centred(task: DesignProblem, solution: Solution) -> Solution:
    """Return a solution in which outputs that stay in a band broader than they need lie evenly about its free middle.

    Nothing else determines such a middle: a search leaves it anywhere, also where the deviation from it reaches its limit.
    """
    x, nlp = solution.x.copy(), solution.nlp
    for part in task.parts:
        name = part.prefix + part.base_name
        tolerance, loose = part.tolerance, part.law_given and part.everywhere and not task.links and part.robust is None
        if tolerance is None or not loose or name not in task.free or not part.requirement.centred:
            continue
        above = ErrorCourse(part).sizes(part.own(task.complete(solution.design)), np.linspace(0.0, 1.0, FINE))
        below, beyond = (float(side) * part.whole for side in np.max(above, axis=1))
        if beyond + below < 2.0 * tolerance * (1.0 - SLACK):
            k = task.free.index(name)
            x[k] = nlp.variables[k].scaled(solution.design[name] - 0.5 * (beyond - below))
    moved = np.clip(x, nlp.x_low, nlp.x_high)
    return solution if np.array_equal(moved, solution.x) else multistart.solution_at(nlp, moved, solution.message)


def validated_design(file: ProblemFile, solution: Solution) -> LinkageDesign:
    """Return a solution of the NLP as a validated design."""
    solution = centred(file.spec, solution) if solution.status is Status.OPTIMAL else solution
    values, angles = solved_values(file.spec, solution.design, solution.x)
    angles = in_first_cycle(file.spec, angles)
    cycle = None
    if file.spec.of_cycle:
        from optlink.validation.cycle import cycle_of

        cycle = cycle_of(file.spec, values)
    accuracy = min(KINKED * integral_error(solution), LEAST_ACCURACY) if solution.usable else 0.0
    checked = validate(file.spec, values, angles, solution.objective, cycle=cycle, accuracy=accuracy)
    checked = with_optimality(checked, solution)
    if solution.nlp.exchange_count:  # a programme with the positions of this solution
        nlp = solution.nlp.copy()
        nlp.p[1:] = solution.p[1:]
        solution = replace(solution, source=nlp)
    design = LinkageDesign(file, values, angles, solution.objective, solution.status, checked, solution)
    if cycle is not None:
        vars(design)["cycle"] = cycle  # cached, as its figures are shown too
    return design


class DesignCollection:
    """The `requested` best distinct valid designs, and the optima of all refined candidates.

    Candidates are refined after every round, so that a search of few rounds collects a subset of what a longer one with
    the same seed collects: more starts never give a worse design.
    """

    def __init__(self, polisher: Polisher, requested: int) -> None:
        self.polisher, self.requested, self.task = polisher, requested, polisher.task
        self.designs: list[LinkageDesign] = []
        self.nearest: LinkageDesign | None = None
        self._ends: dict[Candidate, LinkageDesign] = {}
        self._fits: list[tuple[Candidate, Solution]] = []  # with the optimum at the positions from which it was refined
        self._best: dict[int, Solution] = {}
        self._given: list[LinkageDesign] = []  # ends of starts that are not random
        self._compound = has_several_dyads(self.task)
        self._tries = COMPOUND_TRIES if self._compound else PER_ROUND
        self._failures = (COMPOUND_TRIES, 1) if self._compound else (TRIES * requested, REORDERED)
        self._allowed = _allowed_cost(self.task)
        self._exact_cost = ROUNDED**2 * len(self.task.data.columns)
        self._first = True
        self._accepted = 1.0  # share of the starting points that end in the order of the points and within the limits
        self._idle = 0  # rounds in a row whose reordered candidates improved no design

    @property
    def exact(self) -> int:
        """Number of distinct exact designs."""
        return sum(design.exact for design in self.designs)

    def add(self, exploration: Exploration) -> None:
        """Refine the candidates of the latest round."""
        self._accepted = exploration.accepted / max(1, exploration.starts)
        failures = self._failures[0] if self._first else self._failures[1]
        far = POOR_FIT_TRIES if self.poor_fit and not self._first else 0
        bounded = not self.designs and math.isfinite(self._allowed)
        costly = TRIES * self._first if bounded else far
        self._follow(exploration.candidates, failures if self._first else self._tries, max(failures, far), costly)
        if far:
            self._follow(exploration.repaired[:: max(1, len(exploration.repaired) // far)], far, far, far)
        elif not self.exact and self._idle < IDLE_ROUNDS:
            costly = (TRIES if self._first else REORDERED) if bounded and not self.designs else 0
            tries = self._failures[1] if self.designs else failures
            self._follow_reordered(exploration.repaired, tries, failures, costly)
        self._first = False

    @property
    def grade(self) -> str:
        """How well the best design fits at the points; exact without design, for several dyads and for several demands."""
        fit = self.designs[0].fit if self.designs and not (self._compound or self.task.composed) else None
        return "exact" if fit is None else fit.at_points

    @property
    def poor_fit(self) -> bool:
        """Whether the best design fits poorly: the order of the points then dominates, and costs without it are uninformative."""
        return self.grade == "poor"

    @property
    def in_order(self) -> float:
        """How far the counts of optima can be relied on: 1, or less where the order of untimed points decides which ones exist.

        It divides the designs into many small regions, so that counts look complete too early: where few starts pass the points
        in their order, and where the best design misses them. Any crank passes three points in their order, in one direction or
        the other.
        """
        data = self.task.data
        if data.offsets is not None or len(data.columns) <= ANY_ORDER:
            return 1.0
        share = min(1.0, self._accepted / MOST_IN_ORDER)
        return min(share, MISSING) if self.grade in ("fair", "poor") else share

    def _follow_reordered(self, candidates: list[Candidate], tries: int, failures: int, costly: int) -> None:
        """Refine reordered candidates as in `_follow`, and count the rounds in which this improves no design."""
        before, refined = [design.error for design in self.designs], len(self._ends)
        self._follow(candidates, tries, failures, costly)
        after = [design.error for design in self.designs]
        better = len(after) > len(before) or any(b < a * (1.0 - SAME_OBJECTIVE) for a, b in zip(before, after, strict=True))
        self._idle = 0 if better or not after else self._idle + (len(self._ends) > refined)

    def _follow(self, candidates: list[Candidate], tries: int, failures: int, costly: int = 0) -> None:
        """Refine candidates in order: `tries` at most, `failures` without a valid design, `costly` above the largest cost."""
        left = [candidate for candidate in candidates if candidate not in self._ends][:tries]
        designs = self.polisher.each(left[: self._worth_refining(left, costly)])
        while failures and self._worth_refining(left, costly):
            candidate, costly = left[0], costly - (left[0].cost > self._largest_cost())
            design = self._ends[candidate] = next(designs, None) or self.polisher.polish(candidate)
            del left[0]
            design = self._ends[candidate] = self._taken(design)
            failures -= not design.valid

    def take(self, design: LinkageDesign) -> None:
        """Take the end of a start that is not random."""
        self._given.append(self._taken(design))

    def refine_fit(self, variant: int, values: Mapping[str, float]) -> None:
        """Refine a random linkage that fits a function [SI]; ends at the positions that are known already are counted only.

        Several optima of the largest error may belong to one of the least squares, so that each fit is refined by itself.
        """
        solution = self.polisher.at_positions(variant, values)
        if self._known(variant, solution):
            return
        candidate = self._fit(variant, solution)
        worth = not self.designs or solution.objective <= FIT_RATIO * self.designs[0].objective
        if worth and solution.usable:
            self._ends[candidate] = self._taken(self.polisher.polished(variant, solution))

    def refine_starts(self, variant: int, found: Iterable[Solution]) -> None:
        """Refine the optima at the positions that a round of random designs has found, with the orders of events beside them."""
        polisher, best = self.polisher, self._best.get(variant)
        ends: list[tuple[Candidate, Solution]] = []
        for end in found:
            if not self._known(variant, end):
                ends.append((self._fit(variant, end), end if self._worse(end, best) else polisher.exchanged(end)))
        for end in polisher.over_orders(variant, [end for _, end in ends], best):
            candidate = next((one for one, other in ends if other is end), None) or self._fit(variant, end)
            if end.usable and not self._worse(end, best):
                self._best[variant] = min(filter(None, (self._best.get(variant), end)), key=rank)
                same = (d for c, d in self._ends.items() if c.variant == variant and d.solution and same_end(d.solution, end))
                self._ends[candidate] = next(same, None) or self._taken(polisher.finished(variant, end))
            elif not self.nearest and not self.designs:
                self._taken(validated_design(polisher.files[variant], end))

    def order_of(self, variant: int) -> EventOrder | None:
        """Return the order of events of the best end of the starts of a file; None if none meets all limits."""
        return self._best[variant].nlp.terms.structure if variant in self._best else None

    @staticmethod
    def _worse(end: Solution, best: Solution | None) -> bool:
        """Return whether the end of a search is no optimum, and worse than the best one."""
        return best is not None and end.status is not Status.OPTIMAL and rank(best) < rank(end)

    def _known(self, variant: int, end: Solution) -> bool:
        """Return whether an optimum at the positions is known, and count it."""
        known = next((c for c, other in self._fits if c.variant == variant and same_end(other, end)), None)
        if known is not None:
            known.count += 1
        return known is not None

    def _fit(self, variant: int, end: Solution) -> Candidate:
        """Return an optimum at the positions as a candidate, and remember it."""
        candidate = Candidate(variant, end.x, np.zeros(0), end.objective, 1)
        if end.status is Status.OPTIMAL:
            self._fits.append((candidate, end))
        return candidate

    def _taken(self, design: LinkageDesign) -> LinkageDesign:
        """Insert a design, or note it as the nearest one; return it, refined where only figures were inexact."""
        if not design.valid and self._better(design) and inexact(design.status, design.validation):
            design = self.polisher.refined(design)
        if design.valid:
            self.insert(design)
        else:
            nearest = filter(None, (self.nearest, design))
            self.nearest = min(nearest, key=lambda one: (len(one.validation.failures), one.objective))
        return design

    def _better(self, design: LinkageDesign) -> bool:
        """Return whether a design has a lower objective than the best valid one."""
        return not self.designs or (design.objective < self.designs[0].objective * (1.0 - SAME_OBJECTIVE) and not self.exact)

    def _fails(self, design: LinkageDesign) -> bool:
        """Return whether a design is an optimum that fails a check, better than the best valid one."""
        return design.status is Status.OPTIMAL and not design.valid and self._better(design)

    @property
    def rejected(self) -> RejectedDesign | None:
        """The best optimum that is better than the best valid design but fails a check."""
        if not self.designs or self.exact:
            return None
        failing = filter(self._fails, (*self._given, *self._ends.values()))
        rejected = (RejectedDesign(d.problem, d.values, d.objective, d.validation.failures) for d in failing)
        return best_rejected(rejected, self.designs[0].objective)

    def _worth_refining(self, candidates: list[Candidate], costly: int) -> int:
        """Return how many of the first candidates are worth refining, `costly` of them above the largest cost.

        A better design only reduces their number, and inexact candidates are irrelevant beside an exact design.
        """
        most, exact = self._largest_cost(), self.exact
        for number, candidate in enumerate(candidates):
            beyond = candidate.cost > most
            if (beyond and not costly) or (exact and candidate.cost > self._exact_cost):
                return number
            costly -= beyond
        return len(candidates)

    def _largest_cost(self) -> float:
        """Return the largest cost of a candidate worth refining: limits only increase it, where nothing else is minimised."""
        if self.task.composed:
            return math.inf
        if len(self.designs) < self.requested:
            return self._allowed
        return max(_cost(self.designs[0]) * COUNTED_RATIO**2, _cost(self.designs[-1]))

    def no_worse(self, reference: LinkageDesign) -> bool:
        """Return whether the best design is as good as another design of the same curve, within rounding."""
        return any(no_worse_fit(design, reference) for design in self.designs[:1])

    def insert(self, design: LinkageDesign) -> None:
        """Add a valid design, unless a better one is practically the same."""
        duplicate = next((existing for existing in self.designs if design.alike(existing)), None)
        if duplicate is not None:
            if _rank(design) >= _rank(duplicate):
                return
            self.designs.remove(duplicate)
        self.designs.append(design)
        self.designs.sort(key=_rank)
        del self.designs[self.requested :]

    def evidence(self) -> Evidence:
        """Return how many starts reached the best optimum, and how likely a better one was missed.

        Only starts whose refined designs are valid and come near the best one (`COUNTED_RATIO`) are counted, as a better optimum
        would be one of these, and those of better optima that fail a check.
        """
        ends = sorted(((d.error, c.count) for c, d in self._ends.items() if d.valid), key=lambda end: end[0])
        if not ends:
            return evidence(())
        best = self.designs[0]
        level = 0.0 if best.exact else best.error
        errors = [(0.0 if best.exact and error <= best.level else error, count) for error, count in ends]
        if errors[0][0] > level * (1.0 + SAME_OBJECTIVE):
            errors.insert(0, (level, 1))  # no random start reached the best design
        ratio = math.inf if self._fits else COUNTED_RATIO  # every fit is refined
        near = (one for one in errors if one[0] <= ratio * level)
        failing = sorted(((d.error, c.count) for c, d in self._ends.items() if self._fails(d)), key=lambda end: end[0])
        found_evidence = evidence(
            [
                count
                for some in (near, failing)
                for _, count in tally(some, lambda known, error: error <= known * (1.0 + SAME_OBJECTIVE))
            ]
        )
        return replace(found_evidence, missed=0.0) if best.exact else found_evidence  # no design is better than an exact one

    def optima(self) -> tuple[Optimum, ...]:
        """Return the distinct values of the valid ends, best first, with the number of starts that reached each."""
        ends = [(design, 1) for design in self._given if design.valid]
        ends += [(design, candidate.count) for candidate, design in self._ends.items() if design.valid]
        ends.sort(key=lambda end: _rank(end[0]))
        distinct = tally(
            ends, lambda known, end: (known.exact and end.exact) or end.error <= known.error * (1.0 + SAME_OBJECTIVE)
        )
        return tuple(Optimum(one.values, one.objective, count, mode_of(one.problem)) for one, count in distinct)

    def beyond_tolerances(self, candidates: list[Candidate]) -> float:
        """Return the estimated chance that a candidate within the tolerances was missed; 1 if one of all, cheapest first, is."""
        near = [(c.cost, c.count) for c in candidates if c.cost <= COUNTED_RATIO**2 * candidates[0].cost]
        if not near or near[0][0] <= self._allowed:
            return 1.0
        return evidence([count for _, count in tally(near, lambda known, cost: cost <= known * (1.0 + SAME_COST))]).missed


def no_worse_fit(design: LinkageDesign, reference: LinkageDesign) -> bool:
    """Return whether a design is no worse than another one for the same points, within rounding."""
    return design.exact or design.error <= reference.error * (1.0 + ROUNDING)


def _cost(design: LinkageDesign) -> float:
    """Return an upper bound of the batch cost of a candidate with the error of a design."""
    task = design.task
    share = (design.error / task.whole) ** 2
    return share if task.measure == "sum of squares" else share * len(task.data.columns)


def _allowed_cost(task: DesignProblem) -> float:
    """Return the largest batch cost near which a candidate can become a design within the tolerances of all points of a path, or
    within that of the first requirement.
    """
    if has_several_dyads(task) or not task.parts:  # candidates have not converged, or there are none
        return math.inf
    first = task.parts[0]
    if first.tolerance is not None:
        return COUNTED_RATIO**2 * len(first.data.columns) * (first.tolerance / first.whole) ** 2
    if task.composed or task.requirement.kind != "path":
        return math.inf
    return COUNTED_RATIO**2 * float(np.sum((task.data.roots * task.data.tolerances) ** 2)) / task.whole**2


def _rank(design: LinkageDesign) -> tuple[float, float, str]:
    """Return a sort key: the objective; exact designs by decreasing worst transmission angle; equal ones by assembly modes.

    Mirror images are equal but for rounding, which decides nothing.
    """
    transmission = design.least_transmission if design.exact else 0.0
    objective = 0.0 if design.exact else float(f"{design.objective:.8e}")
    return objective, round(-transmission, 9) if math.isfinite(transmission) else 0.0, mode_of(design.problem)


def designs_from_four_bar(
    part: ContainedFourBar, four_bars: Sequence[LinkageDesign], polisher: Polisher, seed: int
) -> list[LinkageDesign]:
    """Return valid designs derived from those of the four-bar, best first; empty if its curve cannot be repeated.

    If no local search ends at an optimum as good as the best four-bar, the starts themselves and the feasible designs
    at which the searches stalled are included. `polisher` is for the whole linkage.
    """
    if not four_bars:
        return []
    files, best = polisher.files, min(four_bars, key=lambda design: design.objective)
    rng = np.random.default_rng([seed, len(files)])
    begun: list[Candidate] = []
    ended: list[Candidate] = []
    for variant, file in enumerate(files):
        batch = Batch(file.spec)
        grown = [
            grow_from_four_bar(
                replace(part, file=part_design.problem), batch, part_design.values, part_design.crank_angles, STARTS, rng
            )
            for part_design in four_bars
        ]
        x, t = np.concatenate([x for x, _ in grown]), np.concatenate([t for _, t in grown])
        if not len(x):
            continue
        begun += _candidates(variant, batch, x, t)
        ends = minimise(batch, x, t, STEPS, slow=1e-9)
        good = acceptable(batch, ends)[0]
        ended += _candidates(variant, batch, ends.x[good], ends.t[good])
    polished: list[LinkageDesign] = []
    for near, candidates in ((False, ended), (True, begun)):
        if not any(design.valid and no_worse_fit(design, best) for design in polished):
            candidates.sort(key=lambda candidate: candidate.cost)
            for design in polisher.each(candidates[:COMPOUND_TRIES], near=near):
                polished.append(design)
                if _agree([design for design in polished if design.valid and no_worse_fit(design, best)]):
                    break
    valid = [design for design in polished if design.valid]
    if not any(no_worse_fit(design, best) for design in valid):
        valid += [design for end in polished if (design := feasible(end)).valid]
        valid += itertools.islice(filter(lambda start: start.valid, map(polisher.unpolished, begun)), 1)
    return sorted(valid, key=lambda design: design.objective)


def _agree(designs: Sequence[LinkageDesign]) -> bool:
    """Return whether the best of some designs was reached several times."""
    least = min((design.error for design in designs), default=math.inf)
    return sum(design.error <= least * (1.0 + SAME_OBJECTIVE) for design in designs) > 1


def _candidates(variant: int, batch: Batch, x: np.ndarray, t: np.ndarray) -> list[Candidate]:
    angles = batch.crank_angles(x, t)
    r = batch.residuals(x, angles)[0]
    cost = np.einsum("bpk,bpk->b", r, r)
    direction = np.where(angles[:, -1] >= angles[:, 0], 1, -1)
    return [Candidate(variant, x[i], t[i], float(cost[i]), int(direction[i])) for i in range(len(x))]
