"""Continuation of an optimum of cycle quantities: Newton's method at fixed positions of the peaks, which hardly move."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from optlink.optimization.cycle_nlp import CycleNLP
from optlink.optimization.cycle_signals import TracedCycle
from optlink.problem.cycle.model import Bound, CycleProblem
from optlink.problem.file import ProblemFile
from optlink.solvers import multistart
from optlink.solvers.semi_infinite import EXACTLY, exchange, peaks
from optlink.solvers.solution import Solution, stationarity
from optlink.studies.continuation import follow_optimum
from optlink.studies.cycle_task import CycleProgramme, with_bounds, with_starting_values
from optlink.tasks.results.cycle import task_of
from optlink.units import factor

BACKEND = "ipopt"
EXCESS = 1e-4  # share of its level by which a peak may exceed the values at the fixed positions while a hand moves


class CycleFollower:
    """Follower of designs for quantities of the cycle; limits, bounds and fixed sizes are parameters of its programme.

    Parameters
    ----------
    problem : ProblemFile
    values : mapping of str to float [SI]
        The last optimum; its order of events is that of the programme.
    """

    def __init__(self, problem: ProblemFile, values: Mapping[str, float]) -> None:
        task = task_of(problem)
        begun = with_starting_values(problem, {name: values[name] for name in task.free})
        self.programme = CycleProgramme(begun, BACKEND)
        self.task = task
        self._near = None if self.programme.structure is None else self._first(values)
        self.follow(problem, None)  # the first search takes longer: it compiles

    def _first(self, values: Mapping[str, float]) -> Solution:
        nlp = self.programme.nlp
        x = nlp.x_of({name: values[name] for name in self.task.free})
        nlp.set_exchange_points(peaks(nlp, x).shares)
        found = multistart.solution_at(nlp, nlp.lifted(x), "the last optimum")
        return _sharp(found if found.usable and found.kkt <= EXCESS else multistart.solve_from(nlp, x, BACKEND))

    def follow(self, problem: ProblemFile, near: Solution | None) -> Solution | None:
        """Return the optimum of a problem near the last one; None if its events have another order.

        Parameters
        ----------
        problem : ProblemFile
        near : Solution, optional
            Not used: the follower keeps its last optimum.
        """
        last = self._near
        if last is None:
            return None
        nlp = self._bound(task_of(problem), last)
        found = follow_optimum(nlp, last) if last.usable else None
        if found is None or peaks(nlp, found.x).excess > EXCESS:
            x = nlp.lifted(np.clip(last.x if found is None else found.x, nlp.x_low, nlp.x_high))
            nlp.set_exchange_points(peaks(nlp, x).shares)
            found = multistart.solve_from(nlp, x, BACKEND)
            self.programme.nlp.cache.update(nlp.cache)
        if found.usable:
            order = nlp.traced.structure(found.design)
            if order is None or not order.like(nlp.structure):
                return None
            self._near = _sharp(found)
        return found

    def refined(self, found: Solution) -> Solution:
        """Return an optimum that satisfies its limits at every crank angle, from one at fixed positions of the peaks."""
        nlp = found.nlp
        assert isinstance(nlp, CycleNLP)
        nlp.p[:] = found.p
        settled = exchange(nlp, found)
        if settled.usable:
            self._near = _sharp(settled)
        return settled

    def _bound(self, task: CycleProblem, last: Solution) -> CycleNLP:
        """Return the programme with the fixed sizes, bounds and limits of a problem, and the last positions of the peaks."""
        trace = object.__new__(TracedCycle)  # its copy would be traced again
        vars(trace).update(vars(self.programme.trace) | {"problem": task})
        nlp = with_bounds(replace_trace(self.programme.nlp, trace), dict(_moved(self.task, task)))
        nlp.p[:] = last.p
        quantities = task.quantities
        for i, constant in enumerate(nlp.constants):
            nlp.p[1 + i] = (quantities[constant.name].value - constant.origin) / constant.size
        for i, v in enumerate(nlp.variables[: len(nlp.free)]):
            low, high = quantities[v.name].bounds
            nlp.limit(i, v.scaled(low), upper=False)
            nlp.limit(i, v.scaled(high), upper=True)
        return nlp


def replace_trace(nlp: CycleNLP, trace: TracedCycle) -> CycleNLP:
    """Return a programme with another trace of the same structure, and all compiled parts.

    Parameters
    ----------
    nlp : CycleNLP
    trace : TracedCycle
    """
    made = replace(nlp, trace=trace)
    for name, value in vars(nlp).items():
        if name not in vars(made):
            vars(made)[name] = value
    for name in ("low", "high", "lower", "upper"):
        vars(made).pop(name, None)
    return replace_bounds(made)


def replace_bounds(nlp: CycleNLP) -> CycleNLP:
    """Return a programme whose bounds of the variables may be moved without moving those of another one."""
    vars(nlp)["x_low"], vars(nlp)["x_high"] = nlp.x_low.copy(), nlp.x_high.copy()
    return nlp


def _moved(old: CycleProblem, new: CycleProblem) -> list[tuple[str, float]]:
    """Return the limits that differ, as key with side and value in the unit of the file."""
    found: list[tuple[str, float]] = []
    for before, now in zip(old.bounds, new.bounds, strict=True):
        for side, one, other in zip(("min", "max"), _ends(before), _ends(now), strict=True):
            if one != other and other is not None:
                size = factor(now.interval.unit, now.interval.kind) if now.interval.kind else 1.0
                found.append((f"{now.key}.{side}", other / size))
    return found


def _ends(bound: Bound) -> tuple[float | None, float | None]:
    return bound.interval.low, bound.interval.high


def _sharp(found: Solution) -> Solution:
    """Return an optimum in whose proof only exactly active rows count: those beside a peak would count twice."""
    if not found.usable:
        return found
    return replace(found, proof=stationarity(found.nlp, found.x, found.nlp.at(found.x, found.p), EXACTLY))
