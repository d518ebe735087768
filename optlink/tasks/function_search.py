"""Multistart search for a motion law or a function: each start leads to a validated local optimum, the best valid one is kept.

The first N of M starts equal those of a search with N starts, and the result of a start does not depend on later ones: more
starts are never worse.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from optlink.errors import Status
from optlink.execution import interrupts
from optlink.execution.runner import ordered
from optlink.execution.worker import Runs
from optlink.linkage.fourbar import LENGTHS
from optlink.linkage.vector2d import TURN, Array
from optlink.optimization.nlp import NLP
from optlink.problem.function import DesignProblem
from optlink.problem.targets.function import Function
from optlink.solvers import multistart
from optlink.solvers.contract import CLOSE
from optlink.solvers.function_exchange import add_peak_errors
from optlink.solvers.solution import Solution
from optlink.tasks.results.common import Optimum, optimality, verified
from optlink.tasks.results.evidence import evidence, tally
from optlink.validation import Validation, validate as validate_law

if TYPE_CHECKING:
    from optlink.synthesis.freudenstein import FirstStep

Progress = Callable[[float], None] | None

ROUND, MOST = 24, 144  # random starts between evaluations of the evidence, and their largest number by default
MANY = 500  # starting points that several processes share by default; fewer take no longer than the start of the processes
PIECE, BLOCK = 6, 240  # random starts of a piece for one process, and of all pieces at a time if their number is prescribed
MISSED = 0.025  # estimated chance of a missed better optimum at which a search ends by default
CERTIFIED = 2  # design variables of a motion law up to which the global optimum is certified by default, without random starts
NEARBY = 2.0  # times the best objective, up to which an optimum at the design positions is refined over the whole range


def certified_by_default(problem: DesignProblem) -> bool:
    """Return whether the optimum is certified by default: that of a motion law of few design variables."""
    return problem.requirement.robust is None and 0 < len(problem.free) <= CERTIFIED


@dataclass(frozen=True)
class SearchStart:
    """Starting point `x` of a local search, whether it is random, and whether it is close to an optimum."""

    x: Array
    drawn: bool
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
        return int(not verified(solution.status, self.validation)), solution.objective


@dataclass
class DistinctOptimum:
    """A distinct optimum at the design positions, and the resulting candidate over the whole range.

    `count`: searches that ended there; `drawn`: those of them with a random start.
    """

    coarse: Solution
    candidate: FunctionCandidate | None
    count: int
    drawn: int


@dataclass(frozen=True)
class StartSequence:
    """The first starts, always complete, then an unlimited sequence of random ones; `step` is the best convex first design."""

    first: list[SearchStart]
    rest: Callable[[], Iterator[SearchStart]]
    step: FirstStep | None


def start_sequence(problem: DesignProblem, nlp: NLP, seed: int, begin: Mapping[str, float] | None) -> StartSequence:
    """Return the sequence of starts: convex first designs and the given start; then random fits of a function and Sobol points.

    Parameters
    ----------
    problem : DesignProblem
    nlp : NLP
    seed : int
        Seed of the Sobol points.
    begin : mapping of str to float [SI], or None
        Design variables of the only starting point.
    """
    if begin is not None:
        return StartSequence([SearchStart(nlp.x_of(dict(begin)), drawn=False, close=False)], lambda: iter(()), None)
    given = SearchStart(multistart.starts(nlp, 1, seed)[0], drawn=False, close=False)

    def bounds() -> Iterator[SearchStart]:
        return (SearchStart(x, drawn=True, close=False) for x in multistart.sobol(nlp.x_low, nlp.x_high, seed))

    from optlink.synthesis import function_starts

    if not function_starts.fittable(problem):
        return StartSequence([given], bounds, None)
    steps = function_starts.steps(problem)
    first = [SearchStart(nlp.x_of(function_starts.values(problem, step)), drawn=False, close=True) for step in steps]

    def rest() -> Iterator[SearchStart]:
        for sizes in function_starts.fits(problem, seed):
            yield SearchStart(nlp.x_of(sizes), drawn=True, close=True)
        yield from bounds()

    return StartSequence([*first, given], rest, steps[0] if steps else None)


def _alike(one: Solution, other: Solution) -> bool:
    """Return whether two solutions are one design, up to whole turns of its angles, and up to scale if only ratios matter."""
    if not (other.usable and multistart.compare(one, other).same):
        return False
    away = one.x - other.x
    names = [variable.name for variable in one.nlp.variables]
    if set(LENGTHS) <= set(names):
        own = [names.index(name) for name in LENGTHS]
        away[own] = one.x[own] / one.x[own[-1]] - other.x[own] / other.x[own[-1]]
    turning = [names.index(name) for name in ("phi0", "psi0") if name in names]
    away[turning] -= TURN * np.round(away[turning] / TURN)
    return float(np.max(np.abs(away), initial=0.0)) <= multistart.SAME_DESIGN


@dataclass(frozen=True)
class LocalSearchTask:
    """Searches at the design positions from points, with the solver beside each; a piece of them is a chunk for the runner."""

    nlp: NLP
    pieces: tuple[list[tuple[Array, str]], ...]

    def __call__(self, index: int) -> list[dict[str, Any]]:
        """Return the fields of the solutions of a piece, without the programme."""
        self.nlp.set_exchange_points(np.zeros(self.nlp.exchange_count))
        return [multistart.solve_from(self.nlp, self.nlp.lifted(x), name).parts for x, name in self.pieces[index]]


class FunctionSearch:
    """Search with one solver: distinct `optima` in the order of their discovery, and the `best` candidate."""

    def __init__(self, problem: DesignProblem, nlp: NLP, backend: str, *, track: bool = False) -> None:
        self.problem, self.nlp, self.backend, self.track = problem, nlp, backend, track
        self.best: FunctionCandidate | None = None
        self.optima: list[DistinctOptimum] = []
        self.starts = 0
        self.validating = 0.0  # s

    def advance(self, start: SearchStart, found: Solution | None = None) -> None:
        """Search from a start, refine the solution over the whole range and validate it.

        Parameters
        ----------
        start : SearchStart
        found : Solution, optional
            The solution at the design positions, if it is known already.
        """
        nlp = self.nlp
        nlp.set_exchange_points(np.zeros(nlp.exchange_count))
        method = self._method(start)
        if found is None:
            found = multistart.solve_from(nlp, nlp.lifted(start.x), method, track=self.track and self.starts == 0)
        known = next((one for one in self.optima if _alike(one.coarse, found)), None)
        if known is None:
            if method == CLOSE and self.backend != "ipopt" and found.usable:
                again = multistart.solve_from(nlp, found.x, self.backend)
                found = again if again.status is Status.OPTIMAL else found
            candidate = self._followed(found)
            if found.status is Status.OPTIMAL:
                self.optima.append(DistinctOptimum(found, candidate, 1, int(start.drawn)))
            if candidate is not None and (self.best is None or candidate.rank < self.best.rank):
                self.best = candidate
        else:
            known.count += 1
            known.drawn += start.drawn
        self.starts += 1

    def _advance(self, start: SearchStart, progress: Progress, total: int, found: Solution | None = None) -> None:
        self.advance(start, found)
        if progress is not None:
            progress(min(self.starts / total, 1.0))

    def judge(self, solution: Solution) -> FunctionCandidate:
        """Return a solution with its validation."""
        begin = time.perf_counter()
        design = self.problem.design(solution.design)
        checked = validate_law(self.problem, design, solution.objective)
        candidate = FunctionCandidate(solution, design, replace(checked, checks=(*checked.checks, *optimality(solution))))
        self.validating += time.perf_counter() - begin
        return candidate

    def _method(self, start: SearchStart) -> str:
        """Return the solver: IPOPT near a close start, also before SLSQP, which is slow with the many rows of a largest error."""
        if start.close and (self.backend == "ipopt" or (start.drawn and self.problem.everywhere)):
            return CLOSE
        return self.backend

    def _followed(self, found: Solution) -> FunctionCandidate | None:
        """Return the candidate of a new solution; None if it is clearly worse than the best one."""
        best = self.best
        if not found.usable:
            return None if best is not None and best.solution.usable else self.judge(found)
        valid = best is not None and verified(best.solution.status, best.validation)
        if self.problem.everywhere:
            if best is not None and valid and found.objective > NEARBY * best.solution.objective + multistart.SAME_ERROR:
                return None
            found = add_peak_errors(self.problem, self.nlp, found, self.backend)
        return self.judge(found)

    @property
    def result(self) -> FunctionCandidate:
        """The best candidate of a completed search."""
        assert self.best is not None
        return self.best

    @property
    def drawn(self) -> bool:
        """Whether a random start led to an optimum."""
        return any(one.drawn for one in self.optima)

    def distinct_optima(self, assembly: str) -> tuple[Optimum, ...]:
        """Return distinct optima over the whole range, best first, without those far above the best."""
        ends = sorted(((c, one.count) for one in self.optima if (c := one.candidate)), key=lambda one: one[0].rank)
        found = tally(ends, lambda known, candidate: _alike(known.solution, candidate.solution))
        return tuple(Optimum(c.design, c.solution.objective, count, assembly) for c, count in found)

    @property
    def usable(self) -> bool:
        """Whether there is a feasible solution."""
        return self.best is not None and self.best.solution.usable

    @property
    def counts(self) -> list[int]:
        """Random starts that ended at each objective value, that of the best design first; at least 1 each.

        Designs of equal value count as one: where only ratios matter there are as many designs as starts.
        """

        def equal(one: DistinctOptimum, other: DistinctOptimum) -> bool:
            return multistart.compare(one.coarse, other.coarse).same

        groups = tally(((one, one.drawn) for one in self.optima), equal)
        best = [one for one in self.optima if one.candidate is not None and one.candidate is self.best]
        groups.sort(key=lambda group: (not any(equal(group[0], one) for one in best), group[0].coarse.objective))
        return [max(1, drawn) for _, drawn in groups]

    def run(
        self,
        starts: StartSequence,
        count: int | None,
        rescue: Callable[[], Array | None],
        progress: Progress,
        runs: Runs | None = None,
    ) -> bool:
        """Search from the first starts and random ones.

        Parameters
        ----------
        starts : StartSequence
        count : int, optional
            Total number of starts. Default: until the evidence suffices.
        rescue : function
            Returns a feasible point (n,) if no first start led to one, or None.
        progress : function of the completed fraction, optional
        runs : function, optional
            From `optlink.execution.runner.pool`, for the searches from random starts. Default: the present process.

        Returns
        -------
        bool
            Whether it was interrupted (Ctrl-C); complete searches are kept, if there are any.
        """
        total = count or len(starts.first) + self._most
        try:
            for start in starts.first:
                self._advance(start, progress, total)
            x = None if self.usable else rescue()
            if x is not None:
                self.advance(SearchStart(x, drawn=False, close=False))
                self.starts -= 1
            rest = starts.rest() if self.usable or count is not None else iter(())
            while not self._enough(drawn := self.starts - len(starts.first), len(starts.first), count):
                block = ROUND if count is None else min(BLOCK, count - len(starts.first) - drawn)
                some = list(itertools.islice(rest, 1 if runs is None else block))
                if not some:
                    break
                for start, found in zip(some, self.coarse(some, runs), strict=True):
                    self._advance(start, progress, total, found)
        except KeyboardInterrupt:
            interrupts.handled()
            if self.best is None:
                raise
            return True
        return False

    def coarse(self, starts: list[SearchStart], runs: Runs | None) -> Iterator[Solution | None]:
        """Yield the solutions at the design positions from starts, each as soon as possible; None for each without processes.

        Parameters
        ----------
        starts : list of SearchStart
        runs : function, optional
            From `optlink.execution.runner.pool`.
        """
        if runs is None:
            yield from itertools.repeat(None, len(starts))
            return
        points = [(start.x, self._method(start)) for start in starts]
        task = LocalSearchTask(self.nlp, tuple(points[k : k + PIECE] for k in range(0, len(points), PIECE)))
        for piece in ordered(task, len(task.pieces), runs):
            yield from (Solution(nlp=self.nlp, **part) for part in piece)

    @property
    def _most(self) -> int:
        """Largest number of random starts by default; none for a law that is certified instead."""
        certified = certified_by_default(self.problem) and not isinstance(self.problem.requirement.law, Function)
        return 0 if certified else MOST

    def _enough(self, drawn: int, first: int, count: int | None) -> bool:
        """Return whether so many random starts suffice: the prescribed number, else by the evidence."""
        if count is not None:
            return drawn >= count - first
        if drawn >= self._most:
            return True
        return drawn > 0 and drawn % ROUND == 0 and evidence(self.counts).missed <= MISSED
