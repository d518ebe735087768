"""Search the best designs for a requirement: starts of every source, refined with all limits, until a better one is unlikely."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import cached_property, partial
from itertools import islice, repeat, zip_longest
from typing import Any

import numpy as np

from optlink.errors import OPTIONS_NAMED, InputError, Status
from optlink.execution import interrupts
from optlink.linkage.vector2d import Array
from optlink.optimization.courses import TermCourse
from optlink.optimization.cycle_signals import CORNER
from optlink.optimization.nlp import NLP
from optlink.optimization.programme import angle_name, build
from optlink.problem.design import EPIGRAPH, DesignProblem
from optlink.problem.file import ProblemFile
from optlink.problem.targets.law import Function
from optlink.solvers import multistart
from optlink.solvers.continuum import Continuum, continuum
from optlink.solvers.contract import BACKENDS, METHODS
from optlink.solvers.exchange import SAMPLES, STARTS, OrderedStarts, one_of_each, place_at_peaks, solve_semi_infinite
from optlink.solvers.infeasibility import Explanation, Follow, explain, feasible_point
from optlink.solvers.solution import Solution
from optlink.synthesis.batch_search import PER_ROUND, PERFECT, Exploration, Searcher
from optlink.synthesis.freudenstein import FirstStep
from optlink.tasks.four_poses import CHEAP
from optlink.tasks.protocol import DesignTask, Progress, Search, Timer, agreement, completed, part
from optlink.tasks.results.common import INCOMPLETE
from optlink.tasks.results.conflict import cannot_turn, margin_notes
from optlink.tasks.results.design import LinkageDesign, SynthesisResult, of_designs
from optlink.tasks.results.exact import ExactSolutions
from optlink.tasks.search import (
    DesignCollection,
    Polisher,
    designs_from_four_bar,
    feasible,
    has_several_dyads,
    mode_of,
    no_stroke,
    validated_design,
)
from optlink.units import count_noun
from optlink.validation import validate as validate_design
from optlink.validation.design import deviations
from optlink.validation.timing import passing

# Constants of the rounds of a search.
# What a search finds, and how much longer it takes, if one of them is halved or doubled: docs/constants.md.
MAX_CERTIFIED_VARIABLES = 2
"""Design variables of a motion law up to which the global optimum is certified by default, without random starts."""
NONE_MOVES = "none of {} random designs within the bounds lets {}: widen the bounds, or start from a design that does"
MISSED_CHANCE = 0.02  # estimated chance that a better design was missed at which a search ends
FITS_PER_ROUND = 24  # random fits of a function per assembly mode
MIN_ROUNDS, MAX_ROUNDS = 3, 20  # of random starting points, while a better design is not unlikely
MAX_ROUNDS_POOR_FIT = 40  # largest number, while the best design fits poorly
SHARED_BATCH_ROUNDS = 4  # rounds that several processes compute together after the first one, while no design is exact
SLOW_VARIABLES = 12  # design variables of a linkage of several dyads from which on its refinements take seconds
SHARED_FROM_ROUND = 6  # round from which on several processes share a search of four-bars, of which most are at an end by then
COMPOUND_ROUNDS = 3  # largest number for a linkage of several dyads, whose starts and limits take longer
COMPOSED_ROUNDS = 6  # largest number of a problem with several demands, each of whose candidates is refined
PART_STARTS = 400  # of the four-bar that a linkage contains
MAX_FAILED_ROUNDS = 12  # rounds without a valid design
SHARED_STARTS = 200
"""Random designs, each refined by itself, that several processes share by default; fewer take no longer than their start."""
COARSE_NODES, COARSE_STARTS = 24, 2  # positions per revolution, and starts, of the analysis of limits of a machine
STARTS_PER_EXACT = 3  # starts per exact design after which no other one is expected

NEAREST = "nearest design"
NONE_TURNS = (
    "none of {} random designs within the bounds lets the crank turn fully: widen the bounds, or start from a design that does"
)
NO_FOUR_BAR = "no four-bar within this linkage carries {}: the search had random starts only, no starts from four-bar designs"
FOUR_BAR_BETTER = (
    "the four-bar within this linkage misses the points by {:.4g} mm (rms) within the same limits: no linkage that repeats its "
    "coupler curve was found within all limits, and no other design is as good"
)


class SynthesisTask(DesignTask[SynthesisResult]):
    """Design of a linkage for a law, points, poses, the best transmission, or quantities of its machine.

    The start of the file and convex first designs of a function come first, then rounds of random ones, which batches of least
    squares lead to candidates; the back end refines them with all limits. `starts`: least number of starts, rounded up to whole
    rounds. Default: rounds until a better design is unlikely; none for a law of at most two design variables, which
    `optlink.solve` certifies. Without targets, from which no batch leads to candidates, the starts are the design of the file and
    random ones with the same order of the ends of strokes, by default 16.
    """

    most_starts = 1_000_000
    designs = 3
    divisible = True

    def certifies(self, problem: ProblemFile) -> bool:
        """Return whether there are targets, the deviations from which have a lower bound."""
        return not problem.model.of_cycle

    def search(self, problem: ProblemFile, search: Search) -> SynthesisResult:
        """Return the best distinct designs, or all exact ones alone; see `DesignTask.search`."""
        if getattr(problem.spec.requirement, "exact", False):  # a key of some kinds
            from optlink.tasks.exact import exact

            return exact(problem)
        if search.backend == "both":
            return _compared(problem, search, self.search)
        timer, rounds = search.timer, SearchRounds(problem, search)
        for name in search.names if not problem.spec.composed else ():  # whose programme depends on its first start
            multistart.prepare(rounds.collection.polisher.programme(0, rounds.directions[0]), name)
        timer.lap("build")
        rounds.run()
        collection, task = rounds.collection, problem.spec
        reason = None if collection.designs or rounds.interrupted else rounds.explained()
        near, notes = collection.nearest, tuple(_notes(task, rounds))
        best = next(iter(collection.designs), near)
        timer.lap("search, polish and validate")
        return SynthesisResult(
            problem=problem,
            designs=tuple(collection.designs),
            nearest=near if near is None or reason is None else replace(near, status=Status.INFEASIBLE),
            backend=_method(collection),
            seed=search.seed,
            starts=rounds.starts,
            evidence=collection.evidence() if rounds.exploration.rounds else None,
            seconds=timer.seconds,
            interrupted=rounds.interrupted,
            notes=notes,
            conflict=() if reason is None else reason.conflict,
            together=() if reason is None else reason.together,
            rejected=collection.rejected,
            backends={search.backend: best.solution} if best is not None and best.solution and not task.parts else {},
            optima=collection.optima() if search.begin is None else (),
            first_step=rounds.first_step,
            exact_solutions=rounds.exact_solutions,
        )

    def grids(self, problem: ProblemFile, rounding: object) -> dict[str, Any]:
        """Return the grid of every rounded size; see `DesignTask.grids`."""
        from optlink.tasks.rounding import read_steps

        return read_steps(problem, rounding)

    def rounded(self, result: SynthesisResult, grids: Mapping[str, Any], backend: str, progress: Progress) -> SynthesisResult:
        """Return the best designs on the grids; see `DesignTask.rounded`."""
        from optlink.tasks.rounding import rounded

        return rounded(result, grids, backend, progress)

    def programme(self, problem: ProblemFile) -> NLP:
        """Return the programme of one sense of crank rotation, and of the first order of events; see `DesignTask.programme`.

        Raises
        ------
        InputError
            If the crank may turn either way, or if no dimensions within the bounds of a machine let it turn fully.
        """
        task = problem.spec
        polisher = Polisher([problem], BACKENDS[0])
        if not task.parts:
            trace, order, near = polisher.orders[0].first
            if not near:
                moves = "the crank turns fully" if task.linkage.limits is None else "the drive moves through its range"
                message = f"no dimensions were found within the bounds with which {moves}"
                raise InputError(message, "Widen the bounds, or start from a design that does", problem.file, "mechanism")
            return polisher.of_order(0, 1, trace, order, near)
        if task.data.offsets is None and task.rotation == "either":
            message = "the crank may pass the points in either direction: each has its own programme"
            key = f"{task.each[0].key}.rotation"
            raise InputError(message, f'Choose one: problem.override({{"{key}": "clockwise"}})', problem.file, key)
        return polisher.programme(0, -1 if task.rotation == "clockwise" else 1)

    def place(self, problem: ProblemFile, nlp: NLP, x: Array) -> None:
        """Move the exchange points to the peaks of limits and of largest values; see `DesignTask.place`."""
        place_at_peaks(problem.spec, nlp, x)

    def unknowns(self, problem: ProblemFile, nlp: NLP, design: Mapping[str, float]) -> Array:
        """Return the scaled unknowns; free crank angles are those with the least deviation."""
        task = problem.spec
        values = task.design(design)
        free = () if task.data.offsets is not None else passing(task, values)
        angles = {angle_name(k): float(angle) for k, angle in enumerate(free)}
        return super().unknowns(problem, nlp, {**values, **angles})

    def validate(self, problem: ProblemFile, design: Mapping[str, float]) -> SynthesisResult:
        """Validate a given design; with free timing, at the crank angles with the least deviation.

        If the problem leaves the assembly mode open, valid designs come first, then the one with the least objective.
        """
        clock = time.perf_counter()
        designs = []
        for file in problem.variants():
            task = file.spec
            values = task.design(design)
            angles = passing(task, values)
            checked = validate_design(task, values, angles)
            designs.append(LinkageDesign(file, values, angles, checked.objective, Status.NOT_SEARCHED, checked))
        result = of_designs(problem, designs, 1, seconds={"validate": time.perf_counter() - clock})
        ways = [] if result.best is None else [part.way_back for part in result.best.parts]
        notes = [problem.spec.target_points.note, *(way.note for way in ways if way is not None)]
        return replace(result, notes=tuple(filter(None, notes)))


TASK = SynthesisTask()
solve, validate = TASK.solve, TASK.validate


def _notes(task: DesignProblem, rounds: SearchRounds) -> Iterator[str]:
    """Yield notes on the targets, on what excludes a better design, and on other designs that are as good."""
    collection = rounds.collection
    best, coverage = next(iter(collection.designs), None), collection.evidence()
    yield from filter(None, [task.target_points.note])
    if rounds.exact_solutions is not None:
        yield rounds.exact_solutions.sentence
    yield from rounds.notes
    found, asked = len(collection.designs), rounds.options.designs
    if rounds.options.asked and task.parts and 0 < found < asked:
        yield f"{asked} designs asked for, {found} found: the search ended because {rounds.ended}"
    if rounds.better is not None and not collection.no_worse(rounds.better):
        error = math.sqrt(float(np.mean(rounds.better.measured.distances**2)))
        yield FOUR_BAR_BETTER.format(1e3 * error)
    if collection.rejected is not None:
        yield collection.rejected.note
    shown = best or collection.nearest
    if rounds.sampled and shown is not None:
        yield from _notes_on_sampling(rounds, shown)
    if best is None:
        crank = task.limits.crank if task.parts else ""
        limited = task.linkage.limits is not None
        reasons = () if limited else cannot_turn(task.mechanism.quantities, task.linkage, crank, task.limits.alignment.value)
        moves, count = "the drive move through its range" if limited else "the crank turn fully", rounds.options.starts or STARTS
        none = () if task.parts or rounds.sampled else (NONE_MOVES.format(SAMPLES * count, moves),)
        yield from reasons or none
        return
    if best.perfect:
        yield f"no design can be better: the {best.whole.goals[0].words} is 0 deg"
    yield from (part.way_back.note for part in best.parts if part.way_back is not None)
    yield from margin_notes(best.problem, best.values, best.limits, best.objective, collection.polisher.relaxed(best))
    if best.solution and _movable(best):
        equal = continuum(best.whole, best.solution, rounds.options.backend)
        yield from () if equal is None else [_continuum_note(equal)]
    if best.whole.of_cycle and best.cycle is not None and best.cycle.complete and best.cycle.limits is None:
        from optlink.tasks.analyze import quick_stroke_notes

        yield from quick_stroke_notes(best.problem, best.cycle.machine, best.cycle.speed)
    if rounds.exploration.rounds and coverage.missed > MISSED_CHANCE:
        count = rounds.starts
        more = min(4 * count, SynthesisTask.most_starts)
        option = f"--starts {more}" if OPTIONS_NAMED.get() else f"starts={more}"
        yield f"{INCOMPLETE}: {count_noun(count, 'start')}, {coverage.chance}; search with {option}"


def _notes_on_sampling(rounds: SearchRounds, best: LinkageDesign) -> Iterator[str]:
    """Yield notes on a search from random designs without targets: its assembly mode, its starts, the order of its events."""
    samples, terms = rounds.sampled[rounds.collection.polisher.key_of(best)[0]], best.solution and best.solution.nlp.terms
    if len(rounds.files) > 1:
        yield f"assembly mode: {mode_of(best.problem)}, the best of those left open"
    if samples.most < samples.count:
        move = "turn fully" if best.whole.linkage.limits is None else "move through the range"
        why = f"no others of {SAMPLES * samples.count} random designs {move} with the same order of events"
        yield f"only {samples.most} of {samples.count} starts: {why}"
    if best.valid and terms and not terms.structure.like(samples.begun[0][0].order):
        rows = any(event.key[0] == CORNER for event in terms.trace.events)
        what = "reverse, or pass the rows of a load table," if rows else "reverse"
        yield f"its motions {what} in another order than those of the initial machine"


def _movable(best: LinkageDesign) -> bool:
    """Return whether a continuum of designs may be equally good: of a machine, and of a four-bar of which only ratios count."""
    task, loop = best.whole, best.whole.four_bar
    if not task.parts:
        return True
    sized = task.objective or task.limits.named or task.limits.regions or any(part.unit == "m" for part in task.parts)
    free = set(task.free)
    scaled = loop is not None and free.issuperset(loop.names) and bool(free & {loop.frame_length, *loop.ground})
    return not sized and scaled


def _continuum_note(equal: Continuum) -> str:
    """Return a note that a continuum of designs is equally good, and how to select one."""
    if equal.scale:
        return f"all lengths may be scaled together: the objective and the limits stay the same; fix one, for example {equal.fix}"
    changes = ", ".join(f"{name} {share:+.3g}" for name, share in equal.changes.items() if name != equal.fix)
    together = f" ({changes} per {equal.fix} +1, in SI units)" if changes else ""
    return f"a continuum of designs is equally good: {equal.fix} may change{together}; fix {equal.fix} to pick one of them"


def _method(collection: DesignCollection) -> str:
    """Return the name of the method that found the best design."""
    solution = collection.designs[0].solution if collection.designs else None
    return METHODS.get(solution.message if solution else "", collection.polisher.method)


def _compared(problem: ProblemFile, search: Search, one: Callable[[ProblemFile, Search], SynthesisResult]) -> SynthesisResult:
    """Search with each back end; return the better result, in which both must agree."""
    results = {
        name: one(problem, replace(search, backend=name, timer=Timer(), progress=part(search.progress, k, len(search.names))))
        for k, name in enumerate(search.names)
    }
    winner = min(results.values(), key=lambda result: (not result.valid, result.objective))
    seconds = {key: sum(result.seconds[key] for result in results.values()) for key in winner.seconds}
    winner = replace(winner, seconds=seconds, interrupted=any(result.interrupted for result in results.values()))
    best = winner.best
    if best is None or best.solution is None or not winner.valid:
        return winner
    solutions = {}
    for name, result in results.items():
        solution = result.solution if result.definite.hash == winner.definite.hash else None  # None in another assembly mode
        if solution is None or not multistart.compare(solution, best.solution).same:  # a true optimum does not move
            again = solve_semi_infinite(best.whole, best.solution, name, near=True)
            solution = again if solution is None else multistart.best([solution, again])
        solutions[name] = solution
    gaps = multistart.compare(*solutions.values())
    checks = agreement(
        "design" if best.whole.parts else "sizes", gaps, multistart.SAME_DESIGN, f"<= {multistart.SAME_DESIGN:.0e} of the size"
    )
    judged = replace(best, validation=best.validation.with_checks(checks))
    return replace(
        winner,
        designs=(judged, *winner.designs[1:]) if judged.valid else (),
        nearest=None if judged.valid else judged,
        backends=solutions,
    )


class SearchRounds:
    """Starts of all sources that a problem has, each followed by refinement, until the stopping criterion holds."""

    def __init__(self, problem: ProblemFile, options: Search) -> None:
        self.files = problem.variants()
        self.collection = DesignCollection(Polisher(self.files, options.backend, len(options.names) > 1), options.designs)
        self.problem, self.options, self.interrupted = problem, options, False
        self.task = self.files[0].spec
        self.compound = has_several_dyads(self.task)
        self.exploration = Exploration()
        self.given = 0  # starts that are not random
        self.ended = ""  # why the search ended
        self.first_step: FirstStep | None = None
        self.exact_solutions: ExactSolutions | None = None
        self.notes: list[str] = []
        self.sampled: dict[int, OrderedStarts] = {}  # random designs of each assembly mode, if there are no targets
        self.better: LinkageDesign | None = None  # the best four-bar, if no linkage that repeats its curve satisfies all limits

    @cached_property
    def searcher(self) -> Searcher:
        """The rounds of random starts, built when the first one is needed."""
        searcher = Searcher([file.spec.parts[0] for file in self.files], self.options.seed)
        searcher.exploration = self.exploration
        return searcher

    @property
    def starts(self) -> int:
        """Number of starts so far."""
        return self.given + self.exploration.starts

    @property
    def directions(self) -> tuple[int, ...]:
        """Directions of the crank that free timing permits; +1 where the timing is prescribed."""
        if self.task.data.offsets is not None:
            return (1,)
        return {"counter-clockwise": (1,), "clockwise": (-1,)}.get(self.task.rotation or "", (1, -1))

    def run(self) -> None:
        """Search until the number of starts is complete; without one, until a better design is unlikely."""
        exact, starts, progress = -1, self.options.starts, self.options.progress
        try:
            self._given()
            while self.task.parts and not self._enough(exact):
                self._share()
                exact = self.collection.exact
                if not self._fitted():
                    self.searcher.advance(self._ahead(exact))
                    self._share()
                    self.collection.add(self.exploration)
                if self.exploration.rounds == 1 and self.compound and not self.collection.exact:
                    self._grow()
                share = self.starts / starts if starts else self.exploration.rounds / self._most
                if progress and share < 1.0:
                    progress(share)
            if progress:
                progress(1.0)
        except KeyboardInterrupt:
            interrupts.handled()
            if not self.collection.designs:
                raise
            self.interrupted, self.ended = True, "it was interrupted"

    def _given(self) -> None:
        """Refine the starts that are not random: `begin` alone, or exact solutions, convex first designs and that of the file.

        The middle of all bounds is no start for points and poses: batched random ones are better. Without targets, from which
        batches lead to candidates, random designs are refined by themselves.
        """
        begin, polisher = self.options.begin, self.collection.polisher
        if not self.task.parts:
            self._sampled()
            return
        kind = next((kind for kind, suits in CHEAP if suits(self.task)), None)
        if begin is None and kind is not None:
            targets = kind(self.files)
            self.exact_solutions = targets.summary
            for variant, design in targets.usable:
                near = polisher.from_values(variant, design.values, design.crank_angles, close=True)
                self.collection.take(near)
                exact = polisher.itself(variant, design.values, design.crank_angles)
                if exact.valid:  # which the local search may leave for another exact design, and a worse one
                    self.collection.insert(exact)
                elif not near.valid and feasible(exact).valid:
                    self.collection.insert(feasible(exact))
                self.given += 1
        for variant, file in enumerate(self.files):
            task = file.spec
            starts: list[tuple[Mapping[str, float], bool]] = [({} if begin is None else begin, False)]
            if begin is None and has_first_steps(task):
                from optlink.synthesis import freudenstein

                steps = freudenstein.steps(task)
                self.first_step = min(filter(None, (self.first_step, *steps[:1])), key=lambda step: step.error, default=None)
                starts = [*((freudenstein.values(task, step), True) for step in steps), *starts]
            if begin is None and not task.law_given and not any(quantity.begun for quantity in task.quantities.values()):
                continue
            for values, close in starts:
                full, first = task.design(values), task.parts[0]
                angles = passing(first, first.own(full)) if first.data.offsets is None else None
                if angles is None or np.all(np.isfinite(deviations(first, first.own(full), angles).distances)):
                    track = self.options.track and not self.given
                    self.collection.take(polisher.from_values(variant, full, angles, close=close, track=track))
                    self.given += 1
                if self._met:
                    return

    def _sampled(self) -> None:
        """Refine the design of the file and random ones with the same order of the ends of strokes, in each assembly mode.

        An output that reciprocates in none of the designs that turn fully is refused, if it is in every assembly mode.
        """
        options, polisher, refused = self.options, self.collection.polisher, list[InputError]()
        count = options.starts or STARTS
        runs = options.runs if options.shared or count >= SHARED_STARTS else None
        for k, file in enumerate(self.files):
            progress = part(options.progress, k, len(self.files)) or (lambda _: None)
            try:
                samples = OrderedStarts(polisher.orders[k].trace, options.seed, count)
                if not samples.begun and samples.fault is not None:
                    raise InputError(*no_stroke(samples.fault, file))
            except InputError as error:
                refused.append(error)
                continue
            if not samples.begun:
                self.given += count
                continue
            self.sampled[k] = samples
            begun = [start for n in range(count) for start in one_of_each(samples.begun, n)]
            ahead, done = polisher.at_starts(k, begun, runs), 0
            for starts in samples.rounds(partial(self.collection.order_of, k)):
                first = any(start.first for start in starts)
                self.collection.refine_starts(k, islice(ahead, len(starts)) if first else polisher.at_starts(k, starts))
                self.given, done = self.given + first, done + first
                progress(min(done / count, 1.0))
        if len(refused) == len(self.files):
            raise refused[0]
        if not self.sampled and (given := validate(self.problem, {}).best):
            self.collection.nearest = replace(given, status=Status.INFEASIBLE)

    @cached_property
    def fits(self) -> Iterator[tuple[int, Mapping[str, float]]]:
        """Random linkages that fit a function of a four-bar, with their assembly modes in turn; none for other problems."""
        if not has_first_steps(self.task):
            return iter(())
        from optlink.synthesis import freudenstein

        sources = [zip(repeat(k), freudenstein.fits(f.spec, self.options.seed)) for k, f in enumerate(self.files)]
        return (fit for each in zip_longest(*sources) for fit in each if fit is not None)

    def _fitted(self) -> bool:
        """Refine a round of fits; return whether there were any."""
        chosen = list(islice(self.fits, FITS_PER_ROUND * len(self.files)))
        for variant, values in chosen:
            self.collection.refine_fit(variant, values)
            self.exploration.starts += 1
        self.exploration.rounds += bool(chosen)
        return bool(chosen)

    def _share(self) -> None:
        """Let several processes share the search from where it is long enough to pay for their start."""
        exploration, polisher = self.exploration, self.collection.polisher
        if self.compound and len(self.task.free) >= SLOW_VARIABLES:  # a long search, unless a design is exact
            long = exploration.rounds > 0 and not any(candidate.cost <= PERFECT for candidate in exploration.candidates[:1])
        else:
            long = exploration.rounds >= SHARED_FROM_ROUND
        if self.options.shared or long:
            self.searcher.runs = polisher.runs = self.options.runs

    def _ahead(self, exact: int) -> int:
        """Return the number of rounds to compute together."""
        exploration, starts = self.exploration, self.options.starts
        if exploration.rounds == 0 or exact or self.searcher.runs is None:
            return 1
        left = math.ceil((starts - self.starts) / PER_ROUND) if starts else self._most - exploration.rounds
        return max(1, min(left, SHARED_BATCH_ROUNDS))

    def explained(self, *, exactly: bool = False) -> Explanation | None:
        """Return limits of the linkage that conflict, or refine a design that meets all of them, regardless of its deviations.

        All assembly modes and senses of rotation are tried, those of the nearest design first. The order of the points and their
        tolerances are kept while limits are relaxed. If no design is optimal although limits are met within the tolerance of a
        solution, limits that are missed by less count as conflicting (`exactly`).
        """
        polisher, near, seed = self.collection.polisher, self.collection.nearest, self.options.seed
        some = range(len(self.files)) if self.task.parts else self.sampled
        keys = [(k, direction) for direction in self.directions for k in some]
        nearest = None if near is None or near.solution is None else near.solution
        own = None if near is None or not keys else polisher.key_of(near)
        keys.sort(key=lambda key: key != own)
        reason: Explanation | None = None
        possible = False
        for k, sense in keys:
            end = nearest if (k, sense) == own else None
            follow: Follow | None = None
            if self.task.parts:
                nlp = polisher.programme(k, sense) if end is None else end.nlp.copy()
                nlp.spread_exchange_points()
                kept = replace(nlp, states=nlp.states | {f"{part.key}.points" for part in self.task.parts})
                points = None if end is None else [end.x, nlp.x_start]
            else:
                nlp, kept, points, follow = self._coarse(k, end)
            outcome: Explanation | Array | None
            if reason is not None or possible:
                outcome = feasible_point(kept, seed, exactly=exactly)
            else:
                outcome = explain(kept, seed, points, quick=follow is not None, follow=follow, exactly=exactly)
            if outcome is None:
                continue
            found = outcome.x if isinstance(outcome, Explanation) else outcome
            values = {v.name: v.value(float(y)) for v, y in zip(kept.variables, found, strict=True)}
            x = nlp.x_of(values, bounded=not isinstance(outcome, Explanation))  # a conflict may be about bounds: beyond them
            if isinstance(outcome, Explanation):
                reason = outcome
                self.collection.take(validated_design(self.files[k], multistart.infeasible_at(nlp, x, NEAREST)))
            else:
                possible = True
                near_it = polisher.from_feasible(k, nlp, x)
                valid = next((design for design in near_it if design.valid), None)
                if valid is not None and (exactly or valid.status is Status.OPTIMAL):
                    self.collection.insert(valid)
                    break
        if possible and not (exactly or self.collection.designs):
            return self.explained(exactly=True)
        return reason if reason is not None and reason.conflict and not possible else None

    def _coarse(self, k: int, end: Solution | None) -> tuple[NLP, NLP, list[Array], Follow]:
        """Return a programme of the machine, the same with few positions, some of its points, and a function that moves these to
        the peaks of a point; bounds of the design variables and limits that no requirement states are kept.
        """
        starts = self.sampled[k].begun[0][:COARSE_STARTS]
        nlp = self.collection.polisher.at_first_peaks(k, starts[0])
        task, terms = nlp.terms.problem, nlp.terms
        coarse = build(task, terms=TermCourse(task, nlp.design(nlp.x_start), terms.trace, terms.structure, COARSE_NODES))
        required = {bound.key for bound in task.bounds}
        kept = coarse.states.union(task.free, {row.limit for row in coarse.rows} - required - {EPIGRAPH})
        points = [coarse.x_of(start.values) for start in starts]
        points += [] if end is None else [coarse.x_of(end.design)]

        def follow(x: Array) -> Array:
            place_at_peaks(task, coarse, x)
            return coarse.p

        return nlp, replace(coarse, states=kept), points, follow

    def _grow(self) -> None:
        """Add designs derived from the best four-bars that the linkage contains."""
        from optlink.synthesis.growth import contained_four_bar

        part = contained_four_bar(self.problem)
        if part is None:
            if self.task.requirement.kind == "path":
                self.notes.append(NO_FOUR_BAR.format(self.task.point))
            return
        options, polisher = self.options, self.collection.polisher
        shared = polisher.runs is not None
        files = [part.file]
        if part.file.spec.limits.crank == "full rotation":  # of the linkage: either inversion of the four-bar turns fully
            files.append(part.file.override({"limits.crank": "double-crank"}))
        results = [solve(file, options.backend, PART_STARTS, options.seed, runs=options.runs, shared=shared) for file in files]
        four_bars = sorted((one for result in results for one in completed(result).designs), key=lambda one: one.objective)
        for design in designs_from_four_bar(part, four_bars, polisher, options.seed):
            self.collection.insert(design)
        if four_bars and not self.task.composed and not self.collection.no_worse(four_bars[0]):
            self.better = four_bars[0]

    @property
    def _most(self) -> int:
        """Largest number of rounds, if no number of starts is prescribed; none for a law that is certified instead."""
        if self.options.begin is not None or certified_by_default(self.task):
            return 0
        if self.compound and not self.collection.exact:
            return COMPOUND_ROUNDS
        if self.task.composed and self.collection.designs:
            return COMPOSED_ROUNDS
        if not self.collection.designs:
            return MAX_FAILED_ROUNDS
        return MAX_ROUNDS_POOR_FIT if self.collection.poor_fit else MAX_ROUNDS

    @property
    def _met(self) -> bool:
        """Whether a law is met, so that no start leads to a better design, and others are not asked for."""
        options = self.options
        return bool(self.collection.exact) and self.task.law_given and not options.asked and options.starts is None

    def _enough(self, exact: int) -> bool:
        """Return whether to stop; `exact` is the number of exact designs before the latest round."""
        if self.options.starts:
            self.ended = f"it had the {count_noun(self.starts, 'start')} asked for" if self.starts >= self.options.starts else ""
        else:
            self.ended = self._ended(exact)
        return bool(self.ended)

    def _ended(self, exact: int) -> str:
        """Return why no more random starts are needed, or nothing."""
        rounds, collection = self.exploration.rounds, self.collection
        if self.exact_solutions is not None and self.exact_solutions.complete and collection.exact > 0:
            return "they are all exact ones within the limits"
        if rounds >= self._most or self._met:
            return f"it had all {count_noun(self.starts, 'start')} that it may have"
        if collection.exact:
            if collection.exact >= self.options.designs:
                return "they are as many as asked for"
            if collection.exact == exact:
                return f"its latest starts, of {self.starts}, led to no other exact one"
            often = collection.evidence().hits >= STARTS_PER_EXACT * collection.exact
            return f"its starts led to each of them {STARTS_PER_EXACT} times on average" if often else ""
        if rounds < MIN_ROUNDS:
            return ""
        if not collection.designs and collection.beyond_tolerances(self.exploration.candidates) <= MISSED_CHANCE:
            return "a design within the tolerances is unlikely"
        unlikely = collection.evidence().missed <= MISSED_CHANCE * collection.in_order
        return f"a better design than those of its {count_noun(self.starts, 'start')} is unlikely" if unlikely else ""


def has_first_steps(task: DesignProblem) -> bool:
    """Return whether a problem has convex first designs: a function of a four-bar."""
    if not task.has_error:
        return False
    from optlink.synthesis import freudenstein

    return freudenstein.fittable(task)


def certified_by_default(task: DesignProblem) -> bool:
    """Return whether the optimum is certified instead of searched: that of a motion law of few design variables."""
    few = 0 < len(task.free) <= MAX_CERTIFIED_VARIABLES
    plain = task.robust is None and not task.limits.regions
    return few and task.has_error and plain and not isinstance(task.requirement.law, Function)
