"""Find the crank angles at which a linkage best passes points or poses in order, by dynamic programming.

References
----------
R. Bellman, Dynamic Programming, Princeton University Press (1957).
"""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from optlink.linkage.vector2d import TURN, Array, finite_or
from optlink.problem.design import STEP, DesignProblem
from optlink.validation.design import point_deviations
from optlink.validation.motion import placed

GRID = 720  # crank angles of the coarse search
REFINED_ANGLES = 25  # crank angles per point and round of the refinement
ROUNDS = 16  # of the refinement: with `SHRINK` to 4e-13 of a step of the coarse search
SHRINK = 6.0  # ratio of the ranges of two rounds: the next one reaches two of the last one's twelve steps to either side
PARTS = 24  # of the grid, the starts of which are tried at once
ROUNDING = 1e-12  # relative
FAR = 1e3  # sizes of the curve: distance assigned to a position that does not exist


def passing(problem: DesignProblem, design: Mapping[str, float]) -> Array:
    """Return the crank angles [rad] at which a design best passes the targets, monotonic, within one revolution.

    The problem has definite assembly modes; the design [m, rad] has all quantities.
    """
    if not problem.parts:
        return np.zeros(0)
    if problem.requirements:
        return np.concatenate([passing(part, part.own(design)) for part in problem.parts])
    if problem.data.offsets is not None or not problem.pointed:
        return problem.crank_angles(design, None)
    return in_first_cycle(problem, min((_one_way(problem, design, way) for way in problem.ways), key=lambda each: each[1])[0])


def in_first_cycle(problem: DesignProblem, angles: Array) -> Array:
    """Return crank angles [rad] of all positions, at points without prescribed timing counted from the first cycle.

    The first angle of a requirement is in it, or less than `STEP` before it.
    """
    cycle, counted = problem.linkage.cycle, [angles[:0]]
    for part, own in problem.of_parts(angles):
        assert own is not None
        free = part.data.offsets is None and part.linkage.limits is None
        counted.append(own - free * cycle * np.floor((own[0] + STEP) / cycle) if len(own) else own)
    return np.concatenate(counted)


def _squares(problem: DesignProblem, design: Mapping[str, float], angles: Array) -> Array:
    """Return the weighted squares of the deviations of every point (points, k) at crank angles (points, k) or (points,)."""
    data, motion = problem.data, placed(problem.linkage, design, np.atleast_2d(angles.T).T)
    squares, far = point_deviations(problem, motion, design, data.columns[:, None])[-1], (FAR * problem.size) ** 2
    return finite_or(squares, far) * data.roots[:, None] ** 2


def _one_way(problem: DesignProblem, design: Mapping[str, float], way: float) -> tuple[Array, float]:
    """Return the best crank angles in one direction of the crank, and their objective.

    The best starting point on a grid by dynamic programming over all of them at once, then the best course from there, refined
    between its neighbours in rounds.
    """
    count, limits = len(problem.data.columns), problem.linkage.limits
    low, high = (0.0, TURN) if limits is None else sorted(way * end for end in limits)
    grid = low + (high - low) * np.arange(GRID) / (GRID - (limits is not None))
    cost = _squares(problem, design, np.broadcast_to(way * grid, (count, GRID)))
    joined = np.maximum if problem.measure == "max" else np.add

    def least(starts: NDArray[np.intp]) -> Array:
        """Return the least total from each start (starts,)."""
        ahead = (starts[:, None] + np.arange(GRID)) % GRID  # (starts, steps from the start)
        best = np.where(np.arange(GRID) == 0, cost[0][ahead], np.inf)
        for row in cost[1:]:
            cumulative = np.minimum.accumulate(best, axis=1)
            best = joined(np.concatenate([np.full((len(starts), 1), np.inf), cumulative[:, :-1]], axis=1), row[ahead])
        return np.asarray(np.min(best, axis=1))

    if limits is not None:
        angles, _ = _ordered(cost, np.broadcast_to(grid, cost.shape), joined)
        return _refined(problem, design, way, angles, (low, high))
    bound = joined(cost[0], joined.reduce(np.min(cost[1:], axis=1), initial=0.0))  # of the total from each start
    totals = np.full(GRID, np.inf)
    for starts in np.array_split(np.argsort(bound, kind="stable"), PARTS):  # until no other start can be better
        if bound[starts[0]] > np.min(totals) * (1.0 + ROUNDING):
            break
        totals[starts] = least(starts)
    start = int(np.argmin(totals))
    rolled = np.roll(cost, -start, axis=1)
    rolled[0, 1:] = np.inf
    if problem.meets_again:  # the last point equals the first, and may be passed there
        rolled = np.concatenate([rolled, np.where(np.arange(count) == count - 1, rolled[:, 0], np.inf)[:, None]], axis=1)
    steps = TURN / GRID * np.arange(rolled.shape[1])
    angles, _ = _ordered(rolled, np.full((count, 1), grid[start]) + steps, joined)
    angles, figure = _refined(problem, design, way, angles, (-np.inf, np.inf))
    return way * np.minimum(way * angles, way * angles[0] + TURN), figure


def _refined(
    problem: DesignProblem, design: Mapping[str, float], way: float, angles: Array, ends: tuple[float, float]
) -> tuple[Array, float]:
    """Return the crank angles about rising ones (points,), all times `way`, that pass the points best, and their objective."""
    reach, figure, joined = TURN / GRID, np.inf, np.maximum if problem.measure == "max" else np.add
    for _ in range(ROUNDS):
        near = np.clip(angles[:, None] + reach * np.linspace(-1.0, 1.0, REFINED_ANGLES), *ends)
        angles, figure = _ordered(_squares(problem, design, way * near), near, joined)
        reach /= SHRINK
    return way * angles, figure


def _ordered(cost: Array, angles: Array, joined: np.ufunc) -> tuple[Array, float]:
    """Choose one angle of every row (points, k), rising by at least STEP, that minimises the total of the costs (points, k)."""
    best, origins = cost[0], []
    for row, at, before in zip(cost[1:], angles[1:], angles[:-1], strict=True):
        least = np.minimum.accumulate(best)
        where = np.maximum.accumulate(np.where(best == least, np.arange(len(best)), 0))
        last = np.searchsorted(before, at - STEP * (1.0 - 1e-9), side="right") - 1
        best = np.where(last >= 0, joined(least[np.maximum(last, 0)], row), np.inf)
        origins.append(where[np.maximum(last, 0)])
    k = int(np.argmin(best))
    figure, chosen = float(best[k]), [k]
    for origin in reversed(origins):
        chosen.append(int(origin[chosen[-1]]))
    return angles[np.arange(len(angles)), chosen[::-1]], figure


# Deviation of the traced curve between neighbouring target points.
#
# There is no target between two points, so the distance of the curve from the straight segment between the two traced points is
# measured. Twice the sagitta of an arc with the local curvature of the points is permitted, because a smooth curve through the
# points has this distance. The excess over it is the excursion. It is zero for points on a circle, however far apart they are,
# and equals the whole distance for collinear points.

FEWEST = 3  # points: two have no curvature
BETWEEN = 32  # positions between two points
REPEATED = 1e-9  # of the longest segment: a shorter one joins repeated points
ALLOWED = 2.0  # sagittas of the circle through three points


def excursions(problem: DesignProblem, design: Mapping[str, float], crank_angles: Array) -> Array | None:
    """Return the excursion (segments,) [m] of the traced curve between each target point and the next; None for other tasks.

    The last segment of a closed curve leads back to its first point. NaN where the points say nothing about the curve: from a
    dwell (repeated points) to a single point. The problem has definite assembly modes, the design [m, rad] all quantities; the
    points are passed at the crank angles [rad].
    """
    targets = problem.data.columns[:, :2] if problem.requirement.kind == "path" else np.zeros((0, 2))
    if len(targets) < FEWEST:
        return None
    around = problem.closed and not problem.meets_again
    first, last = crank_angles[0], crank_angles[-1]
    angles = np.append(crank_angles, first + np.sign(last - first) * TURN) if around else crank_angles
    at = angles[:-1, None] + np.diff(angles)[:, None] * np.linspace(0.0, 1.0, BETWEEN + 2)
    traced = placed(problem.linkage, design, at).position(problem.point)
    begin, chord = traced[:, :1], traced[:, -1:] - traced[:, :1]
    square = np.maximum(np.sum(chord**2, axis=-1, keepdims=True), 1e-300)
    along = np.clip(np.sum((traced - begin) * chord, axis=-1, keepdims=True) / square, 0.0, 1.0)
    far = np.max(np.linalg.norm(traced - begin - along * chord, axis=-1), axis=1)
    return np.asarray(np.maximum(far - ALLOWED * sagittas(targets, closed=problem.closed, around=around), 0.0))


def sagittas(points: Array, *, closed: bool, around: bool) -> Array:
    """Return the sagitta (segments,) [m] of each segment as an arc, of the more curved one of its ends.

    The arc has the curvature of the circle through the end and its two neighbours, or turns by half the angle by which the
    polyline turns there on either side of the end, whichever is larger: the two are equal for even steps. It is zero between
    repeated points, and NaN for other segments of which both ends lie beside repeated points or at the end of the curve.

    `closed`: the first of the points (points, 2) [m] follows the last one. `around`: the segment from the last point to the first
    is one of them; the two may also be the same point.
    """
    inner = points if around or not closed else points[:-1]
    before, after = inner - np.roll(inner, 1, axis=0), np.roll(inner, -1, axis=0) - inner
    chord = np.linalg.norm(after, axis=-1)
    cross = np.abs(before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0])
    turning = np.arctan2(cross, np.sum(before * after, axis=-1))
    across = np.linalg.norm(before + after, axis=-1)
    curvature = 2.0 * np.sin(turning) / np.maximum(across, 1e-300)
    repeated = chord <= REPEATED * float(np.max(chord))
    unknown = repeated | np.roll(repeated, 1)
    if not closed:
        unknown[[0, -1]] = True
    turning[unknown] = curvature[unknown] = np.nan
    turning, curvature = (np.fmax(one, np.roll(one, -1)) for one in (turning, curvature))
    half = np.maximum(0.5 * turning, np.arcsin(np.minimum(0.5 * curvature * chord, 1.0)))
    heights = np.where(repeated, 0.0, 0.5 * chord * np.tan(0.5 * half))
    return heights if closed else heights[:-1]
