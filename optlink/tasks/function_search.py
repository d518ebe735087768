"""Multistart search for a motion law or a function: each start leads to a validated local optimum, the best valid one is kept.

The first N of M starts equal those of a search with N starts, and the result of a start does not depend on later ones: more
starts are never worse.
"""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from optlink.errors import Status
from optlink.execution import interrupts
from optlink.execution.runner import ordered
from optlink.execution.worker import Runs
from optlink.linkage.fourbar import LENGTHS
from optlink.linkage.vector2d import TURN, Array
from optlink.optimization.nlp import NLP
from optlink.optimization.programme import build
from optlink.problem.design import DesignProblem
from optlink.problem.targets.function import Function
from optlink.solvers import multistart
from optlink.solvers.contract import BACKENDS, CLOSE
from optlink.solvers.exchange import solve_semi_infinite
from optlink.solvers.solution import Solution
from optlink.tasks.protocol import Progress
from optlink.tasks.results.common import ROUNDED, Optimum, inexact, verified, with_optimality
from optlink.tasks.results.evidence import evidence, tally
from optlink.validation import Validation, validate as validate_law

if TYPE_CHECKING:
    from optlink.synthesis.freudenstein import FirstStep

STARTS_PER_ROUND = 24  # random starts between evaluations of the evidence
MAX_RANDOM_STARTS = 144  # their largest number by default
SHARED_STARTS = 500
"""Starting points that several processes share by default; fewer take no longer than the start of the processes."""
CHUNK = 6  # random starts in a chunk of work for one process
BLOCK = 240  # random starts of all chunks at a time, if the number of starts is prescribed
MISSED_CHANCE = 0.025  # estimated chance of a missed better optimum at which a search ends by default
MAX_CERTIFIED_VARIABLES = 2
"""Design variables of a motion law up to which the global optimum is certified by default, without random starts."""
REFINE_RATIO = 2.0  # times the best objective, up to which an optimum at the design positions is refined over the whole range


def certified_by_default(problem: DesignProblem) -> bool:
    """Return whether the optimum is certified by default: that of a motion law of few design variables."""
    return problem.requirement.robust is None and 0 < len(problem.free) <= MAX_CERTIFIED_VARIABLES


@dataclass(frozen=True)
class SearchStart:
    """Starting point `x` of a local search, whether it is random, and whether it is close to an optimum."""

    x: Array
    random: bool
    close: bool


@dataclass(frozen=True)
class FunctionCandidate:
    """A local optimum over the whole range with its design [SI] and its validation."""

    solution: Solution
    design: dict[str, float]
    validation: Validation

    @property
    def rank(self) -> tuple[int, float]:
        """Sort key: valid before invalid before infeasible; then by objective, or violation."""
        solution = self.solution
        if not solution.usable:
            return (3 if solution.status is Status.NON_FINITE else 2), solution.violation
        return int(not self.verified), solution.objective

    @property
    def verified(self) -> bool:
        """Whether it is an optimum that passes its validation."""
        return verified(self.solution.status, self.validation)

    @property
    def exact(self) -> bool:
        """Whether it is one without errors, up to the rounding of the decimals of the law: no design is better."""
        residuals = self.solution.nlp.residuals(self.solution.x)
        return self.verified and float(np.sqrt(np.mean(residuals**2))) <= ROUNDED


@dataclass
class DistinctOptimum:
    """A distinct optimum at the design positions, and the resulting candidate over the whole range.

    `count`: searches that ended there; `random`: those of them with a random start.
    """

    coarse: Solution
    candidate: FunctionCandidate | None
    count: int
    random: int


@dataclass(frozen=True)
class StartSequence:
    """The first starts, always complete, then an unlimited sequence of random ones; `step` is the best convex first design."""

    first: list[SearchStart]
    rest: Callable[[], Iterator[SearchStart]]
    step: FirstStep | None


def start_sequence(problem: DesignProblem, nlp: NLP, seed: int, begin: Mapping[str, float] | None) -> StartSequence:
    """Return the sequence of starts: convex first designs and the given start; then random fits of a function and Sobol points.

    `begin` [SI] is the only start if it is given.
    """
    if begin is not None:
        return StartSequence([SearchStart(nlp.x_of(dict(begin)), random=False, close=False)], lambda: iter(()), None)
    start = SearchStart(multistart.starts(nlp, 1, seed)[0], random=False, close=False)

    def bounds() -> Iterator[SearchStart]:
        return (SearchStart(x, random=True, close=False) for x in multistart.sobol(nlp.x_low, nlp.x_high, seed))

    from optlink.synthesis import function_starts

    if not function_starts.fittable(problem):
        return StartSequence([start], bounds, None)
    steps = function_starts.steps(problem)
    first = [SearchStart(nlp.x_of(function_starts.values(problem, step)), random=False, close=True) for step in steps]

    def rest() -> Iterator[SearchStart]:
        for sizes in function_starts.fits(problem, seed):
            yield SearchStart(nlp.x_of(sizes), random=True, close=True)
        yield from bounds()

    return StartSequence([*first, start], rest, steps[0] if steps else None)


def near_optimum(problem: DesignProblem, design: Mapping[str, float], backend: str) -> Solution:
    """Return the local optimum near a design [m, rad], over the whole range."""
    nlp = build(problem)
    return FunctionSearch(problem, nlp, backend).everywhere(multistart.solve_from(nlp, nlp.x_of(design), CLOSE))


def _alike(first: Solution, second: Solution) -> bool:
    """Return whether two solutions are one design, up to whole turns of its angles, and up to scale if only ratios matter."""
    if not (second.usable and multistart.compare(first, second).same):
        return False
    difference = first.x - second.x
    names = [variable.name for variable in first.nlp.variables]
    if set(LENGTHS) <= set(names):
        lengths = [names.index(name) for name in LENGTHS]
        difference[lengths] = first.x[lengths] / first.x[lengths[-1]] - second.x[lengths] / second.x[lengths[-1]]
    turning = [names.index(name) for name in ("phi0", "psi0") if name in names]
    difference[turning] -= TURN * np.round(difference[turning] / TURN)
    return float(np.max(np.abs(difference), initial=0.0)) <= multistart.SAME_DESIGN


@dataclass(frozen=True)
class LocalSearchTask:
    """Searches at the design positions from points, with the solver beside each; a piece of them is a chunk for the runner."""

    nlp: NLP
    pieces: tuple[list[tuple[Array, str]], ...]

    def __call__(self, index: int) -> list[dict[str, Any]]:
        """Return the fields of the solutions of a piece, without the programme."""
        self.nlp.spread_exchange_points()
        return [multistart.solve_from(self.nlp, self.nlp.lifted(x), name).parts for x, name in self.pieces[index]]


class FunctionSearch:
    """Search with one solver: distinct `optima` in the order of their discovery, and the `best` candidate."""

    def __init__(self, problem: DesignProblem, nlp: NLP, backend: str, *, track: bool = False) -> None:
        self.problem, self.nlp, self.backend, self.track = problem, nlp, backend, track
        self.best: FunctionCandidate | None = None
        self.rejected: FunctionCandidate | None = None  # feasible, but it fails a check: the one with the least objective
        self.optima: list[DistinctOptimum] = []
        self.starts = 0
        self.validating = 0.0  # s

    def advance(self, start: SearchStart, solution: Solution | None = None) -> None:
        """Search from a start, refine the solution over the whole range and validate it.

        `solution` is that at the design positions, if it is known already.
        """
        nlp = self.nlp
        nlp.spread_exchange_points()
        method = self._method(start)
        if solution is None:
            solution = multistart.solve_from(nlp, nlp.lifted(start.x), method, track=self.track and self.starts == 0)
        optimum = next((item for item in self.optima if _alike(item.coarse, solution)), None)
        if optimum is None:
            if method == CLOSE and self.backend != "ipopt" and solution.usable:
                repeated = multistart.solve_from(nlp, solution.x, self.backend)
                solution = repeated if repeated.status is Status.OPTIMAL else solution
            candidate = self._followed(solution)
            if solution.status is Status.OPTIMAL:
                self.optima.append(DistinctOptimum(solution, candidate, 1, int(start.random)))
            if candidate is not None:
                self._keep(candidate)
        else:
            optimum.count += 1
            optimum.random += start.random
        self.starts += 1

    def _keep(self, candidate: FunctionCandidate) -> None:
        """Keep a candidate if it is the best one, or the best one that is feasible but fails a check."""
        if self.best is None or candidate.rank < self.best.rank:
            self.best = candidate
        if candidate.solution.usable and not candidate.verified:
            self.rejected = min(filter(None, (self.rejected, candidate)), key=lambda one: one.solution.objective)

    def _advance(self, start: SearchStart, progress: Progress, total: int, solution: Solution | None = None) -> None:
        self.advance(start, solution)
        if progress is not None:
            progress(min(self.starts / total, 1.0))

    def judge(self, solution: Solution) -> FunctionCandidate:
        """Return a solution with its validation."""
        begin = time.perf_counter()
        design = self.problem.design(solution.design)
        checked = with_optimality(validate_law(self.problem, design, objective=solution.objective), solution)
        candidate = FunctionCandidate(solution, design, checked)
        self.validating += time.perf_counter() - begin
        return candidate

    def _method(self, start: SearchStart) -> str:
        """Return the solver: IPOPT near a close start, also before SLSQP, which is slow with the many rows of a largest error."""
        if start.close and (self.backend == "ipopt" or (start.random and self.problem.everywhere)):
            return CLOSE
        return self.backend

    def _followed(self, solution: Solution) -> FunctionCandidate | None:
        """Return the candidate of a new solution; None if it is clearly worse than the best one."""
        best = self.best
        if not solution.usable:
            return None if best is not None and best.solution.usable else self.judge(solution)
        least = best.solution.objective if best is not None and best.verified else math.inf
        if self.problem.everywhere and solution.objective > REFINE_RATIO * least + multistart.SAME_ERROR:
            return None
        candidate = self.judge(self.everywhere(solution))
        if candidate.solution.objective >= least or not inexact(candidate.solution.status, candidate.validation):
            return candidate
        other = next(name for name in BACKENDS if name != self.backend)
        again = multistart.solve_from(self.nlp, candidate.solution.x, other)
        return min(candidate, self.judge(self.everywhere(again, other)), key=lambda one: one.rank)

    def everywhere(self, solution: Solution, backend: str = "") -> Solution:
        """Return a solution whose largest error is that of the whole range, where it is the objective."""
        if not (self.problem.everywhere and solution.usable):
            return solution
        return solve_semi_infinite(self.problem, solution, backend or self.backend)

    @property
    def result(self) -> FunctionCandidate:
        """The best candidate of a completed search."""
        assert self.best is not None
        return self.best

    @property
    def random(self) -> bool:
        """Whether a random start led to an optimum."""
        return any(optimum.random for optimum in self.optima)

    def distinct_optima(self, assembly: str) -> tuple[Optimum, ...]:
        """Return distinct optima over the whole range, best first, without those far above the best."""
        ends = sorted(((c, item.count) for item in self.optima if (c := item.candidate)), key=lambda item: item[0].rank)
        distinct = tally(ends, lambda first, candidate: _alike(first.solution, candidate.solution))
        return tuple(Optimum(c.design, c.solution.objective, count, assembly) for c, count in distinct)

    @property
    def usable(self) -> bool:
        """Whether there is a feasible solution."""
        return self.best is not None and self.best.solution.usable

    @property
    def counts(self) -> list[int]:
        """Random starts that ended at each objective value, that of the best design first; at least 1 each.

        Designs of equal value count as one: where only ratios matter there are as many designs as starts.
        """

        def equal(optimum: DistinctOptimum, other: DistinctOptimum) -> bool:
            return multistart.compare(optimum.coarse, other.coarse).same

        groups = tally(((optimum, optimum.random) for optimum in self.optima), equal)
        best = [optimum for optimum in self.optima if optimum.candidate is not None and optimum.candidate is self.best]
        groups.sort(key=lambda group: (not any(equal(group[0], optimum) for optimum in best), group[0].coarse.objective))
        return [max(1, random) for _, random in groups]

    def run(
        self,
        starts: StartSequence,
        count: int | None,
        rescue: Callable[[], Array | None],
        progress: Progress,
        runs: Runs | None = None,
    ) -> bool:
        """Search from the first starts and random ones; return whether it was interrupted (Ctrl-C).

        Without a total `count` of starts, the search ends when the evidence suffices. `rescue` returns a feasible point (n,), if
        no first start led to one, or None. Interrupted, it keeps complete searches, if there are any.
        """
        total = count or len(starts.first) + self._most
        try:
            for start in starts.first:
                self._advance(start, progress, total)
            x = None if self.usable else rescue()
            if x is not None:
                self.advance(SearchStart(x, random=False, close=False))
                self.starts -= 1
            rest = starts.rest() if self.usable or count is not None else iter(())
            while not self._enough(random := self.starts - len(starts.first), len(starts.first), count):
                block = STARTS_PER_ROUND if count is None else min(BLOCK, count - len(starts.first) - random)
                chunk = list(itertools.islice(rest, 1 if runs is None else block))
                if not chunk:
                    break
                for start, solution in zip(chunk, self.coarse(chunk, runs), strict=True):
                    self._advance(start, progress, total, solution)
                    if count is None and self._exact:
                        break
        except KeyboardInterrupt:
            interrupts.handled()
            if self.best is None:
                raise
            return True
        return False

    def coarse(self, starts: list[SearchStart], runs: Runs | None) -> Iterator[Solution | None]:
        """Yield the solutions at the design positions from starts, each as soon as possible; None for each without processes."""
        if runs is None:
            yield from itertools.repeat(None, len(starts))
            return
        points = [(start.x, self._method(start)) for start in starts]
        task = LocalSearchTask(self.nlp, tuple(points[k : k + CHUNK] for k in range(0, len(points), CHUNK)))
        for piece in ordered(task, len(task.pieces), runs):
            yield from (Solution(source=self.nlp, **part) for part in piece)

    @property
    def _exact(self) -> bool:
        """Whether no start can lead to a better design than the best one."""
        return self.best is not None and self.best.exact

    @property
    def _most(self) -> int:
        """Largest number of random starts by default; none for a law that is certified instead."""
        certified = certified_by_default(self.problem) and not isinstance(self.problem.requirement.law, Function)
        return 0 if certified else MAX_RANDOM_STARTS

    def _enough(self, random: int, first: int, count: int | None) -> bool:
        """Return whether the random starts suffice: the prescribed number of them, or by the evidence."""
        if count is not None:
            return random >= count - first
        if random >= self._most or self._exact:
            return True
        return random > 0 and random % STARTS_PER_ROUND == 0 and evidence(self.counts).missed <= MISSED_CHANCE
