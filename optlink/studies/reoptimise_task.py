"""Sweep task that finds an optimum at every point of a grid.

The programme is built once: what varies are its parameters and bounds. Within a chunk each search starts from the optimum of a
completed neighbour, and usually ends after a few Newton steps; the first search of a chunk starts from the start of the problem,
so that no chunk depends on another. Every optimum is validated like a single one.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from optlink.errors import Fault, InputError, Status
from optlink.linkage.assur import EITHER
from optlink.optimization.constraints import rows as limit_rows
from optlink.optimization.nlp import NLP, build
from optlink.problem.file import ProblemFile
from optlink.problem.function import DesignProblem
from optlink.problem.limits import MARGIN_KEYS
from optlink.problem.quantity import nearest
from optlink.solvers import multistart
from optlink.solvers.contract import selectable
from optlink.solvers.solution import ACTIVE, FEASIBLE, Solution
from optlink.studies.continuation import FOLLOWED, follow_optimum
from optlink.studies.fast_overrides import FastOverride
from optlink.studies.sweep_task import OptimumTask
from optlink.tasks.results.balance import Balance
from optlink.tasks.run import solve
from optlink.validation import validate

Array = NDArray[np.float64]
CHUNK, SLOW_CHUNK = 100, 4  # points per chunk; the second if every point needs a separate search
NUMBERS = ("mechanism.", "limits.", "tolerances.", "requirement.from", "requirement.psi0")  # keys of parameters of a programme
SEARCHED = "searched"
OTHER = 3.0  # ratio of sizes beyond which the scaling of the programme is unsuitable


def check_backend(name: str) -> None:
    """Check that studies support a solver.

    Raises
    ------
    InputError
        If they do not.
    """
    if name == "both":
        remedy = "Give ipopt or slsqp, each in its own folder; `optlink solve --backend both` compares them for one design"
        raise InputError(Fault("a study searches with one back end", remedy, key="--backend", value=name))
    if name not in selectable():
        raise InputError(Fault("unknown back end of a study", nearest(name, selectable()), key="--backend", value=name))


def one_programme_suffices(problem: ProblemFile, keys: tuple[str, ...]) -> bool:
    """Return whether one programme serves all values of these keys.

    Parameters
    ----------
    problem : ProblemFile
    keys : tuple of str
        Keys of the file, including the side of a limit.
    """
    task = problem.model
    if not isinstance(task, DesignProblem) or task.everywhere or task.mechanism.assembly == EITHER:
        return False
    return all(key.startswith(NUMBERS) and key not in ("limits.crank", "limits.transmission_over", *MARGIN_KEYS) for key in keys)


@dataclass(frozen=True)
class _Optimum:
    """Contents of a row; `design` [SI] by design variable."""

    design: Mapping[str, float]
    objective: float
    status: Status
    valid: bool
    failed: tuple[str, ...]
    active: tuple[str, ...]
    method: str


@dataclass(frozen=True)
class ReoptimiseTask(OptimumTask):
    """Optimum at every point."""

    @property
    def objective_column(self) -> str:
        """Name of the column of the objective."""
        from optlink.studies.sweep import objective_column

        return objective_column(self.template)

    @cached_property
    def programme(self) -> ParametricProgramme | None:
        """Common programme of all points; None if every point needs its own."""
        keys = tuple(axis.key for axis in self.grid.axes)
        return ParametricProgramme(self.template) if one_programme_suffices(self.template, keys) else None

    @cached_property
    def direct(self) -> FastOverride | None:
        """Sets values in the model; None if the file has to be read again for each."""
        found = FastOverride(self.template.spec, self.grid.axes) if self.programme is not None else None
        return found if found is not None and found.possible else None

    def lines(self, index: int) -> list[list[str]]:
        """Return the rows of a chunk."""
        done: dict[int, Solution] = {}
        rows = []
        for point in self.span(index):
            if self.programme is None:
                found = _alone(self.problem.override(self.grid.changes(point)), self.backend)
            else:
                found = self._again(self.programme, point, done)
            rows.append(self.optimum(point, **vars(found)))
        return rows

    def model(self, point: int) -> DesignProblem:
        """Return the problem at a point of the grid."""
        if self.direct is not None:
            return self.direct.model(self.grid.values(point))
        return self.problem.override(self.grid.changes(point)).spec

    def _again(self, programme: ParametricProgramme, point: int, done: dict[int, Solution]) -> _Optimum:
        """Return the optimum at a point, from that of a neighbour of this chunk if available."""
        task = self.model(point)
        programme.bind(task)
        before = point - 1 if point % self.grid.row else point - self.grid.row
        solution, found = programme.solve(done.get(before), self.backend)
        if solution.usable:
            done[point] = solution
        elif not 1.0 / OTHER <= task.quantities["frame"].value / programme.size <= OTHER:
            own = build(task)
            solution = multistart.best([solution, multistart.solve_from(own, own.x_start, self.backend)])
        design = task.design(solution.design)
        proof = validate(task, design, solution.objective)
        optimal = solution.status is Status.OPTIMAL
        failed = tuple(check.name for check in proof.checks if not check.passed)
        valid = optimal and not failed
        if solution.status is Status.INFEASIBLE:
            missed, against = conflicting(solution)
            return _Optimum(solution.design, solution.objective, solution.status, valid, missed or failed, against, found)
        return _Optimum(solution.design, solution.objective, solution.status, valid, failed, active(solution), found)


class ParametricProgramme:
    """One programme for many values of its parameters and bounds."""

    def __init__(self, problem: ProblemFile) -> None:
        self.nlp: NLP = build(problem.spec)
        self.size = problem.spec.quantities["frame"].value

    def bind(self, task: DesignProblem) -> None:
        """Set fixed quantities, bounds and limits from a problem of the same structure."""
        nlp, quantities = self.nlp, task.quantities
        for i, constant in enumerate(nlp.constants):
            value = quantities[constant.name].value if constant.name in quantities else task.counted[constant.name]
            nlp.p[1 + i] = (value - constant.origin) / constant.size
        n = len(nlp.variables)
        for i, v in enumerate(nlp.variables):
            if v.name not in nlp.helpers:
                low, high = quantities[v.name].bounds
                nlp.limit(i, (low - v.origin) / v.size, upper=False)
                nlp.limit(i, (high - v.origin) / v.size, upper=True)
        values = {name: quantity.value for name, quantity in quantities.items()}
        with np.errstate(all="ignore"):
            rows = limit_rows(task, values, task.reach(values), self.size)
        for j, row in enumerate(rows):
            nlp.limit(n + j, row.low, upper=False)
            nlp.limit(n + j, row.high, upper=True)

    def solve(self, near: Solution | None, backend: str) -> tuple[Solution, str]:
        """Return the optimum for the present parameters, and how it was found.

        Parameters
        ----------
        near : Solution, optional
            Optimum of a neighbour.
        backend : "slsqp" or "ipopt"
        """
        nlp = self.nlp
        if near is not None:
            solution = follow_optimum(nlp, near)
            if solution is not None:
                return solution, FOLLOWED
        starts = [nlp.x_start] if near is None else [near.x, nlp.x_start]
        tries = []
        for x in starts:
            tries.append(multistart.solve_from(nlp, nlp.lifted(np.clip(x, nlp.x_low, nlp.x_high)), backend))
            if tries[-1].status is Status.OPTIMAL:
                break
        return multistart.best(tries), SEARCHED


def _alone(task: ProblemFile, backend: str) -> _Optimum:
    """Return the optimum of a problem that is built and searched separately."""
    result = solve(task, backend)
    assert not isinstance(result, Balance)
    failed = tuple(check.name for check in result.validation.checks if not check.passed)
    failed = tuple(item.name for item in result.conflict) or failed
    held = () if result.solution is None else active(result.solution)
    return _Optimum(result.design, result.objective, result.status, result.valid, failed, held, SEARCHED)


def conflicting(solution: Solution) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the labels of the violated limits, and of the other limits at their bound, each once."""
    nlp, g = solution.nlp, solution.g
    with np.errstate(invalid="ignore"):
        beyond = np.maximum(nlp.low - g, g - nlp.high)
        off, near = (beyond > FEASIBLE) | ~np.isfinite(g), np.abs(beyond) <= ACTIVE
    named = [
        [nlp.rows[j].label for j in np.flatnonzero(mask) if nlp.rows[j].limit not in nlp.helpers] for mask in (off, near & ~off)
    ]
    return tuple(dict.fromkeys(named[0])), tuple(label for label in dict.fromkeys(named[1]) if label not in named[0])


def active(solution: Solution) -> tuple[str, ...]:
    """Return the labels of the active limits and bounds of a design, each once."""
    nlp, prices = solution.nlp, solution.proof.multipliers
    n = len(nlp.variables)
    names = []
    for entry in solution.proof.active:
        if entry >= n and nlp.rows[entry - n].limit not in nlp.helpers:
            names.append(nlp.rows[entry - n].label)
        elif entry < n and nlp.variables[entry].name not in nlp.helpers:
            names.append(f"{nlp.variables[entry].name} {'<=' if prices[entry] > 0.0 else '>='} its bound")
    return tuple(dict.fromkeys(names))
