"""Continuation of an optimum while the problem changes: programmes that are traced once and whose parameters move.

A follower serves all problems of the same structure: what varies are parameters and bounds of its programme. Where the structure
changes, a new one is built.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from optlink.linkage.vector2d import unit
from optlink.optimization.constraints import position_rows
from optlink.optimization.constraints import rows as limit_rows
from optlink.optimization.nlp import NLP
from optlink.optimization.path_nlp import build_path_nlp, constant_values, has_position_limits
from optlink.problem.cycle.model import CycleProblem
from optlink.problem.file import WORDS as PROSE
from optlink.problem.file import ProblemFile
from optlink.problem.function import DesignProblem
from optlink.problem.limits import MARGINS, Reach
from optlink.problem.path import PathProblem
from optlink.problem.quantity import Quantity
from optlink.problem.targets.expression import Expression
from optlink.solvers import multistart
from optlink.solvers.contract import MINIMAX
from optlink.solvers.path_exchange import solve_semi_infinite
from optlink.solvers.solution import Solution
from optlink.studies.continuation import follow_optimum
from optlink.studies.reoptimise_task import ParametricProgramme
from optlink.tasks.path_search import path_model

Array = NDArray[np.float64]

BACKEND = "ipopt"
WORDS = ("crank", "transmission_over", *MARGINS)  # limits that change the structure of a programme


class Follower(Protocol):
    """Follows the optimum of problems with one structure."""

    def follow(self, problem: ProblemFile, near: Solution | None) -> Solution | None:
        """Return the optimum of a problem near the last one, usable or not; None if it cannot be followed.

        Parameters
        ----------
        problem : ProblemFile
            With definite assembly modes.
        near : Solution, optional
            Last optimum.
        """
        ...


class FunctionFollower:
    """Follower of motion laws and functions of a four-bar."""

    def __init__(self, problem: ProblemFile) -> None:
        self.programme = ParametricProgramme(problem, movable=True)
        multistart.prepare(self.programme.nlp, BACKEND)

    def follow(self, problem: ProblemFile, near: Solution | None) -> Solution:
        """Return the optimum of a problem near the last one.

        Parameters
        ----------
        problem : ProblemFile
            With definite assembly modes.
        near : Solution, optional
            Last optimum.
        """
        task, programme = problem.spec, self.programme
        nlp = programme.nlp
        programme.bind(task)
        if not task.everywhere:
            if near is None or near.nlp is nlp:
                return programme.solve(near, BACKEND)[0]
            return multistart.solve_from(nlp, start_of(nlp, near), BACKEND)
        from optlink.solvers.function_exchange import add_peak_errors

        nlp.set_exchange_points(np.zeros(nlp.exchange_count))
        found = multistart.solve_from(nlp, start_of(nlp, near), BACKEND)
        return add_peak_errors(task, nlp, found, BACKEND) if found.usable else found


class PathFollower:
    """Follower of paths, motions, laws and transmission of any linkage; its programme has the targets as parameters.

    Parameters
    ----------
    problem : ProblemFile
        With definite assembly modes.
    way : int
        Sense of crank rotation from point to point, +1 or -1.
    """

    def __init__(self, problem: ProblemFile, way: int) -> None:
        self.way = way
        self._build(path_model(problem))

    def _build(self, task: PathProblem) -> None:
        """Build the programme of a problem; it serves all problems with the same limits."""
        self.task, self.nlp = task, build_path_nlp(task, self.way, movable=True)
        multistart.prepare(self.nlp, BACKEND)

    def follow(self, problem: ProblemFile, near: Solution | None) -> Solution:
        """Return the optimum of a problem near the last one.

        Parameters
        ----------
        problem : ProblemFile
            With definite assembly modes.
        near : Solution, optional
            Last optimum.
        """
        task = path_model(problem)
        if not self._bind(task):
            self._build(task)
        nlp, x = self.nlp, start_of(self.nlp, near)
        if near is not None and near.nlp is nlp and not nlp.exchange_count:
            found = follow_optimum(nlp, near)
            if found is not None:
                return found
        backend = MINIMAX if task.measure == "max" else BACKEND
        if nlp.exchange_count:
            start = multistart.solution_at(nlp, x, "the last optimum")
            return solve_semi_infinite(task, start, backend, near=start.usable)
        return multistart.solve_from(nlp, x, backend)

    def _bind(self, task: PathProblem) -> bool:
        """Set parameters, bounds and limits; return whether the limits of the programme are those of the problem."""
        nlp, n = self.nlp, len(self.nlp.variables)
        values = {name: quantity.value for name, quantity in task.quantities.items()}
        with np.errstate(all="ignore"):
            rows = limit_rows(task, values, Reach(0.0, 1.0, self.way), self.task.size)
            placed = position_rows(task, task.linkage.pose(values, unit(0.0))) if has_position_limits(task) else []
        if [row.limit for row in rows] != [row.limit for row in nlp.rows[: len(rows)]]:
            return False
        anywhere = {(row.limit, row.label): row for row in placed}
        nlp.p[1 : 1 + len(nlp.constants)] = constant_values(task, nlp.constants)
        for i, v in enumerate(nlp.variables):
            if v.name not in nlp.helpers:
                low, high = task.quantities[v.name].bounds
                nlp.limit(i, v.scaled(low), upper=False)
                nlp.limit(i, v.scaled(high), upper=True)
        for j, own in enumerate(nlp.rows):
            row = rows[j] if j < len(rows) else anywhere.get((own.limit, own.label))
            if row is not None:
                nlp.limit(n + j, row.low, upper=False)
                nlp.limit(n + j, row.high, upper=True)
        return True


def structure(problem: ProblemFile) -> Any:
    """Return what a programme of a problem depends on beyond its parameters and bounds; equal for problems that can share one."""
    model, raw = problem.model, problem.raw
    limits = {key: repr(value) if key in WORDS else _shape(value) for key, value in (raw.get("limits") or {}).items()}
    parts: list[Any] = [problem.task, tuple(model.quantities), tuple(model.free), limits, raw["mechanism"].get("assembly")]
    requirement = dict(raw.get("requirement") or {})
    told = ("mechanism", "limits", "requirement", *PROSE)
    parts += [{key: value for key, value in raw.items() if key not in told}]
    if isinstance(model, CycleProblem):
        parts += [_shape(requirement)]
    if isinstance(model, PathProblem):
        data = model.data
        places = data.columns.shape if model.pointed else data.columns.tolist()
        parts += [{key: value for key, value in requirement.items() if key != "points"}, places]
        parts += [None if data.offsets is None else data.offsets.tolist(), data.roots.tolist(), data.tolerances.tolist()]
    if isinstance(model, DesignProblem):
        parts += [{key: value for key, value in requirement.items() if not _moves(model, key)}, model.sense]
    return tuple(map(repr, parts))


def _moves(model: DesignProblem, key: str) -> bool:
    """Return whether a key of the requirement is a parameter of the programme."""
    if key == "span":
        return isinstance(model.requirement.law, Expression)
    held = {"from": model.requirement.start, "psi0": model.requirement.psi0}.get(key)
    return isinstance(held, Quantity)


def _shape(value: Any) -> Any:
    """Return a value of the file without its numbers."""
    if isinstance(value, Mapping):
        return {key: _shape(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_shape(item) for item in value]
    return type(value).__name__


def start_of(nlp: NLP, near: Solution | None) -> Array:
    """Return the design of the last optimum as a starting point of a programme; without one the start of the programme.

    Parameters
    ----------
    nlp : NLP
    near : Solution, optional
        Of this programme, or of another one with other variables or another scaling.
    """
    x = nlp.x_start.copy()
    if near is not None and near.nlp is nlp:
        x = near.x
    elif near is not None:
        known = {v.name: v.origin + v.size * float(value) for v, value in zip(near.nlp.variables, near.x, strict=True)}
        for i, variable in enumerate(nlp.variables):
            if variable.name in known:
                x[i] = variable.scaled(known[variable.name])
    return nlp.lifted(np.clip(x, nlp.x_low, nlp.x_high))


def follower(problem: ProblemFile, values: Mapping[str, float], way: int = 1) -> Follower | None:
    """Return a follower of a problem; None if designs of its kind are only carried along while a hand moves.

    Parameters
    ----------
    problem : ProblemFile
        With definite assembly modes.
    values : mapping of str to float [SI]
        The last design.
    way : int
        Sense of its crank rotation, +1 or -1.
    """
    if not problem.model.free:
        return None
    if isinstance(problem.model, DesignProblem):
        return FunctionFollower(problem)
    if isinstance(problem.model, PathProblem):
        return PathFollower(problem, way)
    if isinstance(problem.model, CycleProblem):
        from optlink.studio.follow_cycle import CycleFollower

        return CycleFollower(problem, values)
    return None
