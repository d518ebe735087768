"""Continuation of an optimum while the problem changes: programmes that are traced once and whose parameters move.

A follower serves all problems of the same structure: what varies are parameters and bounds of its programme. Where the structure
changes, a new one is built.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np

from optlink.errors import Status
from optlink.problem.file import ProblemFile
from optlink.problem.function import DesignProblem
from optlink.problem.limits import MARGINS
from optlink.problem.path import PathProblem
from optlink.problem.quantity import Quantity
from optlink.solvers import multistart
from optlink.solvers.solution import Solution
from optlink.studies.reoptimise_task import ParametricProgramme

BACKEND = "ipopt"
WORDS = ("crank", "transmission_over", *MARGINS)  # limits that change the structure of a programme


class Follower(Protocol):
    """Follows the optimum of problems with one structure."""

    def follow(self, problem: ProblemFile, near: Solution | None) -> Solution:
        """Return the optimum of a problem near the last one, usable or not."""
        ...


class FunctionFollower:
    """Follower of motion laws and functions of a four-bar."""

    def __init__(self, problem: ProblemFile) -> None:
        self.programme = ParametricProgramme(problem)
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
            return programme.solve(near, BACKEND)[0]
        from optlink.solvers.function_exchange import add_peak_errors

        nlp.set_exchange_points(np.zeros(nlp.exchange_count))
        x = nlp.x_start if near is None else near.x
        found = multistart.solve_from(nlp, nlp.lifted(np.clip(x, nlp.x_low, nlp.x_high)), BACKEND)
        return add_peak_errors(task, nlp, found, BACKEND) if found.usable else found


def structure(problem: ProblemFile) -> Any:
    """Return what a programme of a problem depends on beyond its parameters and bounds; equal for problems that can share one."""
    model, raw = problem.model, problem.raw
    limits = {key: repr(value) if key in WORDS else _shape(value) for key, value in (raw.get("limits") or {}).items()}
    parts: list[Any] = [problem.task, tuple(model.quantities), tuple(model.free), limits, raw["mechanism"].get("assembly")]
    requirement = dict(raw.get("requirement") or {})
    if isinstance(model, DesignProblem):
        parts += [{key: value for key, value in requirement.items() if not _moves(model, key)}, _shape(raw.get("tolerances"))]
    return tuple(map(repr, parts))


def _moves(model: DesignProblem, key: str) -> bool:
    """Return whether a key of the requirement is a parameter of the programme."""
    held = {"from": model.requirement.start, "psi0": model.requirement.psi0}.get(key)
    return isinstance(held, Quantity)


def _shape(value: Any) -> Any:
    """Return a value of the file without its numbers."""
    if isinstance(value, Mapping):
        return {key: _shape(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_shape(item) for item in value]
    return type(value).__name__


def follower(problem: ProblemFile) -> Follower | None:
    """Return a follower of a problem; None if designs of its kind are only carried along while a hand moves.

    Parameters
    ----------
    problem : ProblemFile
        With definite assembly modes.
    """
    if not problem.model.free:
        return None
    if isinstance(problem.model, DesignProblem):
        return FunctionFollower(problem)
    return None


__all__ = ["BACKEND", "Follower", "PathProblem", "Status", "follower", "structure"]
