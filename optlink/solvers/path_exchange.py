"""Exchange method for limits over a whole range: exchange points move to the violated positions, and the search resumes.

References
----------
R. Hettich, K. O. Kortanek, Semi-infinite programming: theory, methods, and applications, SIAM Review 35 (1993) 380-429.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from optlink.errors import Status
from optlink.linkage.extrema import Function, extremes
from optlink.optimization.nlp import NLP
from optlink.optimization.path_nlp import has_sampled_objective, limit_excesses, objective_excess, solved_values
from optlink.problem.path import PathProblem
from optlink.solvers import contract
from optlink.solvers import multistart as local
from optlink.solvers.newton import polish
from optlink.solvers.semi_infinite import with_places
from optlink.solvers.solution import Solution

Array = NDArray[np.float64]

ALONG = 1441  # positions along the required motion at which limits are sampled
EXCEEDED = 2e-9  # permitted excess over a limit, in the unit of its row: less than the validator's tolerance
EXCHANGES = 16  # rounds
RADIUS, SMALLEST = 0.3, 1e-3  # scaled units: trust-region radius of the first round, and the one that ends the rounds
NEAR = 0.1  # in the unit of the row: a peak this far below its limit may exceed it in the next round
CLOSE = 0.02  # the same for peaks whose positions are unknowns of the NLP
REACH = 0.02  # share of the motion by which such a position may move in a round
EDGE = 1e-3  # share of the motion: this close to its ends the derivative at a peak need not vanish
APART = 1e-4  # share of the motion; closer positions count as one
MISSED = 1e3  # penalty of exceeding a limit by one, in multiples of the objective


@dataclass(frozen=True)
class RowPeak:
    """A local maximum of a row, at a share of the required motion."""

    at: float
    height: float
    row: int


def solve_semi_infinite(task: PathProblem, start: Solution, backend: str, *, near: bool = False) -> Solution:
    """Return an optimum near a start that satisfies its limits also between the positions of the NLP.

    In every round the exchange points move to where limits are exceeded or nearly so, and the NLP is solved within a radius, in
    which these positions hardly move; a step is accepted only if the merit over all positions decreases.

    Parameters
    ----------
    task : PathProblem
    start : Solution
        Start; its `nlp` is solved.
    backend : str
        Back end.
    near : bool
        Whether the start satisfies its limits everywhere, so that the first search stays within the radius too.
    """
    nlp = start.nlp
    if not nlp.exchange_count:
        return start if start.status is Status.OPTIMAL else local.solve_from(nlp, start.x, backend, resume_infeasible=False)
    nlp.set_exchange_points((np.arange(nlp.exchange_count) + 0.5) / nlp.exchange_count)
    found = local.solution_at(nlp, start.x, start.message)
    if not near and found.status is not Status.OPTIMAL:
        found = local.solve_from(nlp, start.x, backend, resume_infeasible=False)
    radius, tops = RADIUS, _tops(task, found)
    for _ in range(EXCHANGES):
        if not math.isfinite(found.objective):
            break
        nlp.set_exchange_points(_places(tops, nlp.exchange_count))
        found = local.solution_at(nlp, found.x, found.message)
        if (found.status is Status.OPTIMAL and tops[0].height <= 0.0) or radius < SMALLEST:
            break
        moved = _followed(nlp, found, len(task.free), radius, backend, tops)
        there = _tops(task, moved)
        if _merit(moved, there) < _merit(found, tops):
            found, tops = moved, there
        else:
            radius *= 0.25
    settled = tops[0].height <= 0.0 or not found.usable
    return found if settled else replace(found, status=Status.STALLED, message="limits are exceeded between the positions")


def _followed(nlp: NLP, start: Solution, count: int, radius: float, backend: str, tops: list[RowPeak]) -> Solution:
    """Return the optimum with the first `count` variables within a radius, the positions of active peaks being unknowns."""
    chosen = [top for top in tops[: nlp.exchange_count] if top.height > -CLOSE and EDGE < top.at < 1.0 - EDGE]
    chosen.sort(key=lambda top: (top.row, top.at))
    rows = tuple(top.row for top in chosen)
    key = f"following {rows}"
    nlp.set_exchange_points(_places([*chosen, *tops], nlp.exchange_count))
    if key not in nlp.cache:
        first, each = nlp.exchange_rows
        heights = {k: nlp.g_expression[first + k * each + row] for k, row in enumerate(rows)}
        nlp.cache[key] = with_places(nlp, nlp.exchange_count, heights)
    moving: NLP = nlp.cache[key]
    moving.p[:] = nlp.p
    x, n = np.concatenate([start.x, [top.at for top in chosen]]), len(start.x)
    low = np.concatenate([nlp.x_low, x[n:] - REACH])
    high = np.concatenate([nlp.x_high, x[n:] + REACH])
    low[:count], high[:count] = np.maximum(low[:count], x[:count] - radius), np.minimum(high[:count], x[:count] + radius)
    for i in range(len(x)):
        moving.limit(i, low[i], upper=False)
        moving.limit(i, high[i], upper=True)
    p = local.scaled_parameters(moving, x)
    end = polish(moving, contract.backend(backend)(moving, x, p), p)
    return local.solution_at(nlp, end.x[:n], end.message)


def _merit(found: Solution, tops: list[RowPeak]) -> float:
    """Return the objective plus a penalty on violated limits, at the positions of the NLP or between them."""
    missed = max(found.violation, tops[0].height, 0.0)
    return found.objective + MISSED * missed * abs(found.objective) if math.isfinite(missed) else math.inf


def _tops(task: PathProblem, found: Solution) -> list[RowPeak]:
    """Return the peaks where limits are exceeded or nearly so, largest first."""
    return peaks(excess_over(task, found), np.linspace(0.0, 1.0, ALONG), NEAR) or [RowPeak(0.0, -math.inf, 0)]


def _places(tops: list[RowPeak], count: int) -> Array:
    """Return the positions of the first peaks, and evenly spaced ones where there is room."""
    chosen: list[float] = []
    for at in [*(top.at for top in tops if top.height > -NEAR), *((np.arange(count) + 0.5) / count).tolist()]:
        if len(chosen) < count and all(abs(at - other) > APART for other in chosen):
            chosen.append(at)
    return np.array(chosen + chosen[:1] * (count - len(chosen)))


def excess_over(task: PathProblem, found: Solution) -> Function:
    """Return the excess over limits and sampled objective, minus the permitted one, as a function of shares (n,) of the motion.

    Parameters
    ----------
    task : PathProblem
    found : Solution
        The design.
    """
    values, angles = solved_values(task, found.design, found.x)

    def excess(shares: Array) -> Array:
        over = limit_excesses(task, values, angles, shares)
        if has_sampled_objective(task):
            over = np.vstack([over, objective_excess(task, values, float(found.x[-1]), shares)])
        return over - EXCEEDED

    return excess


def peaks(heights: Function, grid: Array, near: float = 0.0) -> list[RowPeak]:
    """Return the local maxima of all rows above -near, largest first.

    Parameters
    ----------
    heights : function of positions (n,) that returns values (rows, n)
    grid : array (n,)
        Positions, increasing.
    near : float
        Depth below zero down to which maxima are returned, in the unit of the rows.
    """
    values = heights(grid)
    padded = np.pad(values, ((0, 0), (1, 1)), constant_values=-np.inf)
    top = (values >= padded[:, :-2]) & (values > padded[:, 2:]) & (values > -2.0 * near)
    found: list[RowPeak] = []
    for row, k in np.argwhere(top).tolist():
        bracket = np.linspace(grid[max(k - 1, 0)], grid[min(k + 1, len(grid) - 1)], 9)
        at, value = extremes(lambda u: heights(u)[row : row + 1], bracket)  # noqa: B023
        found.append(RowPeak(float(at[0, 1]), float(value[0, 1]), row))
    found.sort(key=lambda peak: -peak.height)
    return [peak for k, peak in enumerate(found) if all(abs(peak.at - other.at) > APART for other in found[:k])]
