"""Continuation of an optimum while the problem changes: programmes that are traced once and whose parameters move.

A follower serves all problems of the same structure: what varies are parameters and bounds of its programme. Where the structure
changes, a new one is built.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import Protocol

import numpy as np

from optlink.linkage.vector2d import Array
from optlink.optimization.courses import TermCourse
from optlink.optimization.cycle_signals import TracedCycle
from optlink.optimization.nlp import NLP
from optlink.problem.design import DesignProblem
from optlink.problem.file import ProblemFile
from optlink.solvers import multistart
from optlink.solvers.contract import CLOSE, MINIMAX
from optlink.solvers.exchange import largest_excess, place_at_peaks, solve_semi_infinite
from optlink.solvers.solution import Solution, stationarity
from optlink.studies.continuation import follow_optimum
from optlink.studies.reoptimise_task import with_starting_values
from optlink.studies.target_programme import TargetProgramme

BACKEND = "ipopt"
EXACTLY = 1e-9  # scaled units: distance at which a row counts as active in the optimality conditions
PEAK_TOLERANCE = 1e-4  # share of its level by which a peak may exceed the values at the fixed positions while a hand moves


class Follower(Protocol):
    """Follows the optimum of problems with one structure."""

    def follow(self, problem: ProblemFile, near: Solution | None) -> Solution | None:
        """Return the optimum, usable or not, of a problem with definite assembly modes near the last one; None if it has none."""
        ...


class TargetsFollower:
    """Follower of laws, paths, motions and transmission of any linkage; its programme has the targets as parameters.

    `direction` is the sense of crank rotation from point to point, +1 or -1.
    """

    def __init__(self, problem: ProblemFile, direction: int) -> None:
        self.direction = direction
        self._build(problem.spec)

    def _build(self, task: DesignProblem) -> None:
        """Build the programme of a problem; it serves all problems with the same limits."""
        self.programme = TargetProgramme(task, self.direction, BACKEND, movable=True)

    def follow(self, problem: ProblemFile, near: Solution | None) -> Solution:
        """Return the optimum of a problem near the last one."""
        task = problem.spec
        if not self.programme.bind(task):
            self._build(task)
        nlp = self.programme.nlp
        x = start_of(nlp, near)
        if near is not None and near.nlp is nlp and not nlp.exchange_count:
            solution = follow_optimum(nlp, near)
            if solution is not None:
                return solution
        backend = MINIMAX if task.measure == "max" and not (task.law_given or task.composed) else BACKEND
        if nlp.exchange_count:
            start = multistart.solution_at(nlp, x, "the last optimum")
            return solve_semi_infinite(task, start, backend, near=start.usable)
        return multistart.solve_from(nlp, x, backend)


def start_of(nlp: NLP, near: Solution | None) -> Array:
    """Return the last optimum as a starting point of a programme with other variables or scaling; without one, its own start."""
    x = nlp.x_start.copy()
    if near is not None and near.nlp is nlp:
        x = near.x
    elif near is not None:
        values = {v.name: v.origin + v.size * float(value) for v, value in zip(near.nlp.variables, near.x, strict=True)}
        for i, variable in enumerate(nlp.variables):
            if variable.name in values:
                x[i] = variable.scaled(values[variable.name])
    return nlp.lifted(np.clip(x, nlp.x_low, nlp.x_high))


class CycleFollower:
    """Follower of designs for quantities of the cycle; limits, bounds and fixed sizes are parameters of its programme.

    Newton's method runs at fixed positions of the peaks, which hardly move. `values` [SI] are the last optimum, whose order of
    events is that of the programme.
    """

    def __init__(self, problem: ProblemFile, values: Mapping[str, float]) -> None:
        task = problem.spec
        start = {name: values[name] for name in task.free}
        begun = with_starting_values(problem, start).spec
        trace = TracedCycle(begun, slow=begun.slow_assumed)
        structure = trace.structure(start)
        self.task, self._near = task, None
        if structure is not None:
            self.programme = TargetProgramme(begun, 1, BACKEND, terms=TermCourse(begun, start, trace, structure.definite))
            self._near = self._first(values)
        self.follow(problem, None)  # the first search takes longer: it compiles

    def _first(self, values: Mapping[str, float]) -> Solution:
        nlp = self.programme.nlp
        x = nlp.x_of({name: values[name] for name in self.task.free})
        place_at_peaks(self.task, nlp, x)
        solution = multistart.solution_at(nlp, nlp.lifted(x), "the last optimum")
        return _with_active_rows(
            solution if solution.usable and solution.kkt <= PEAK_TOLERANCE else multistart.solve_from(nlp, x, BACKEND)
        )

    def follow(self, problem: ProblemFile, near: Solution | None) -> Solution | None:
        """Return the optimum of a problem near the last one, which the follower keeps; None if its events have another order."""
        last, task = self._near, problem.spec
        if last is None or not self.programme.bind(task):
            return None
        nlp = self.programme.nlp
        nlp.set_exchange_points(last.p[len(last.p) - nlp.exchange_count :])
        solution = follow_optimum(nlp, last) if last.usable else None
        if solution is None or largest_excess(task, nlp, solution.x) > PEAK_TOLERANCE:
            x = nlp.lifted(np.clip(last.x if solution is None else solution.x, nlp.x_low, nlp.x_high))
            place_at_peaks(task, nlp, x)
            solution = multistart.solve_from(nlp, x, BACKEND)
        if solution.usable:
            if nlp.terms.event_angles(nlp.given | solution.design) is None:
                return None
            self._near = _with_active_rows(solution)
        self.task = task
        return solution

    def refined(self, solution: Solution) -> Solution:
        """Return an optimum that satisfies its limits at every crank angle, from one at fixed positions of the peaks."""
        solution.nlp.p[:] = solution.p
        exchanged = solve_semi_infinite(self.task, solution, CLOSE, near=True)
        if exchanged.usable:
            self._near = _with_active_rows(exchanged)
        return exchanged


def _with_active_rows(solution: Solution) -> Solution:
    """Return an optimum whose optimality conditions use exactly active rows only: rows beside a peak would count twice."""
    if not solution.usable:
        return solution
    return replace(solution, conditions=stationarity(solution.nlp, solution.x, solution.nlp.at(solution.x, solution.p), EXACTLY))
