"""Remez exchange for function synthesis: locate the error peaks between the design positions and level them."""

import math
from collections.abc import Callable, Mapping

import numpy as np

from optlink.errors import Status
from optlink.linkage.extrema import maxima
from optlink.linkage.motion import sweep
from optlink.linkage.vector2d import Array
from optlink.optimization.nlp import NLP
from optlink.problem.function import DesignProblem
from optlink.solvers import multistart
from optlink.solvers.contract import MINIMAX
from optlink.solvers.solution import Solution

ALONG = 2001  # positions along the span at which the error is sampled
EXCHANGES, LEVELLED = 12, 1e-8  # rounds, and the share by which an error may exceed those at the positions of the NLP
POSITION_SEPARATION = 1e-4  # rad; closer positions count as one


def error_at(problem: DesignProblem, design: Mapping[str, float], offsets: Array) -> Array:
    """Return prescribed minus generated rocker angle [rad], in (-pi, pi].

    Parameters
    ----------
    problem : DesignProblem
    design : mapping of str to float [m, rad]
        Quantities by name, including `phi0` and `psi0`.
    offsets : array (n,) [rad]
        Crank rotations from the start.
    """
    target = problem.law.curve(offsets, design["phi0"], design["psi0"])
    motion = sweep(problem.linkage, problem.sizes(design), design["phi0"] + offsets)
    angle = np.asarray(motion.body_angle("rocker").value, dtype=float)
    return np.asarray(np.remainder(target - angle + np.pi, 2.0 * np.pi) - np.pi, dtype=float)


def error_function(problem: DesignProblem) -> Callable[[Mapping[str, float], Array], Array]:
    """Return the error [rad] as a function of design and crank rotations, enlarged by the tolerances for a robust requirement."""
    if problem.requirement.robust is None or problem.measure != "max":
        return lambda design, offsets: error_at(problem, design, offsets)
    from optlink.optimization.output_derivatives import ErrorResiduals

    judge = ErrorResiduals(problem)

    def widened(design: Mapping[str, float], offsets: Array) -> Array:
        lower, upper = judge.band(design, offsets)
        return np.where(np.abs(upper) >= np.abs(lower), upper, lower)

    return widened


def add_peak_errors(problem: DesignProblem, nlp: NLP, solution: Solution, backend: str) -> Solution:
    """Add the largest errors between the design positions to the NLP until no error exceeds those at its positions.

    Positions of earlier rounds are kept as far as there is room: where the error is flat, two designs would otherwise alternate.
    The trust-region method of `optlink.solvers.minimax` stays at the optimum where it started.

    Parameters
    ----------
    problem : DesignProblem
    nlp : NLP
    solution : Solution
        Optimum at the design positions.
    backend : str
        Back end used if the minimax method does not end at an optimum.
    """
    grid, error = np.sort(np.linspace(0.0, problem.span, ALONG)), error_function(problem)
    offsets: list[float] = []
    ends = [0.0, problem.span]  # already positions of the NLP
    for _ in range(EXCHANGES):
        if not solution.usable:
            break
        design = problem.design(solution.design)
        peaks = _peaks(lambda at: np.abs(error(design, at)), grid, nlp.exchange_count)  # noqa: B023
        if max(height for _, height in peaks) <= solution.objective * (1.0 + LEVELLED) + 1e-12:
            break
        new = [at for at, _ in peaks if _apart(at, ends)]
        if not new:
            break
        offsets = [at for at in sorted(offsets, key=lambda at: -(error(design, np.array([at]))[0] ** 2)) if _apart(at, new)]
        offsets = (new + offsets)[: nlp.exchange_count]
        nlp.set_exchange_points(np.array(offsets))
        solved = multistart.solve_from(nlp, solution.x, MINIMAX)
        solution = solved if solved.status is Status.OPTIMAL else multistart.solve_from(nlp, solution.x, backend)
    return solution


def _peaks(size: Callable[[Array], Array], grid: Array, most: int) -> list[tuple[float, float]]:
    """Return positions and heights of the largest local maxima of a function of the crank rotation [rad]."""
    heights = size(grid)
    tops = np.flatnonzero((heights >= np.append(heights[1:], 0.0)) & (heights >= np.insert(heights[:-1], 0, 0.0)))
    peaks = []
    for k in tops[np.argsort(-heights[tops])][:most]:
        bracket = np.linspace(grid[max(int(k) - 1, 0)], grid[min(int(k) + 1, len(grid) - 1)], 9)
        at, height = maxima(lambda angles: size(angles)[None, :], bracket)
        peaks.append((float(at[0]), float(height[0])))
    return peaks


def _apart(at: float, others: list[float]) -> bool:
    """Return whether a position [rad] differs from all others."""
    return min((abs(at - other) for other in others), default=math.inf) > POSITION_SEPARATION
