"""Largest error of a function over its whole range: found between the design positions and levelled by exchange (E. Remez)."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

from optlink.errors import Status
from optlink.linkage.extrema import extremes
from optlink.linkage.motion import sweep
from optlink.optimization.nlp import NLP
from optlink.problem.function import DesignProblem
from optlink.solvers import multistart
from optlink.solvers.solution import Solution

Array = NDArray[np.float64]

ALONG = 2001  # positions along the span at which an error curve is followed
EXCHANGES, LEVELLED = 12, 1e-8  # rounds, and the share by which an error may exceed those that the programme knows
APART = 1e-4  # rad; nearer than that two positions are one


def error_at(problem: DesignProblem, design: Mapping[str, float], offsets: Array) -> Array:
    """Prescribed minus generated rocker angle [rad], in (-pi, pi], at crank rotations [rad] from the start."""
    target = problem.law.curve(offsets, design["phi0"], design["psi0"])
    motion = sweep(problem.linkage, problem.sizes(design), design["phi0"] + offsets)
    angle = np.asarray(motion.body_angle("rocker").value, dtype=float)
    return np.asarray(np.remainder(target - angle + np.pi, 2.0 * np.pi) - np.pi, dtype=float)


def judged(problem: DesignProblem) -> Callable[[Mapping[str, float], Array], Array]:
    """Function of a design and crank rotations: the error, larger by what tolerances add to its size if they count [rad]."""
    if problem.requirement.robust is None or problem.requirement.measure != "max":
        return lambda design, offsets: error_at(problem, design, offsets)
    from optlink.optimization.output_derivatives import Judge

    judge = Judge(problem)

    def widened(design: Mapping[str, float], offsets: Array) -> Array:
        lower, upper = judge.band(design, offsets)
        return np.where(np.abs(upper) >= np.abs(lower), upper, lower)

    return widened


def level(problem: DesignProblem, nlp: NLP, solution: Solution, backend: str) -> Solution:
    """Add the largest errors between the design positions to the programme until none exceeds those it has.

    Those of earlier rounds stay as long as there is room: where the error is flat, two designs would exceed each other's in turn.
    The trust region of `optlink.solvers.minimax` stays at the optimum where it began; `backend` searches where it ends at none.
    """
    grid, error = np.sort(np.linspace(0.0, problem.span, ALONG)), judged(problem)
    known: list[float] = []
    ends = [0.0, problem.span]  # are positions already
    for _ in range(EXCHANGES):
        if not solution.usable:
            break
        design = problem.design(solution.design)
        peaks = _peaks(lambda at: np.abs(error(design, at)), grid, nlp.roaming)  # noqa: B023
        if max(height for _, height in peaks) <= solution.objective * (1.0 + LEVELLED) + 1e-12:
            break
        new = [at for at, _ in peaks if _apart(at, ends)]
        if not new:
            break
        known = [at for at in sorted(known, key=lambda at: -(error(design, np.array([at]))[0] ** 2)) if _apart(at, new)]
        known = (new + known)[: nlp.roaming]
        nlp.roam(np.array(known))
        found = multistart.solve_from(nlp, solution.x, multistart.MINIMAX)
        solution = found if found.status is Status.OPTIMAL else multistart.solve_from(nlp, solution.x, backend)
    return solution


def _peaks(size: Callable[[Array], Array], grid: Array, most: int) -> list[tuple[float, float]]:
    """Places and heights of the largest local peaks of a function of the crank rotation [rad]."""
    heights = size(grid)
    tops = np.flatnonzero((heights >= np.append(heights[1:], 0.0)) & (heights >= np.insert(heights[:-1], 0, 0.0)))
    found = []
    for k in tops[np.argsort(-heights[tops])][:most]:
        bracket = np.linspace(grid[max(int(k) - 1, 0)], grid[min(int(k) + 1, len(grid) - 1)], 9)
        at, height = extremes(lambda angles: size(angles)[None, :], bracket)
        found.append((float(at[0, 1]), float(height[0, 1])))
    return found


def _apart(at: float, others: list[float]) -> bool:
    """Whether a position [rad] is none of the others."""
    return min((abs(at - other) for other in others), default=math.inf) > APART
