"""Deviation of the traced curve between neighbouring target points.

There is no target between two points, so the distance of the curve from the straight segment between the two traced points is
measured. Twice the sagitta of an arc with the local curvature of the points is permitted, because a smooth curve through the
points has this distance. The excess over it is the excursion. It is zero for points on a circle, however far apart they are, and
equals the whole distance for collinear points.
"""

from collections.abc import Mapping

import numpy as np

from optlink.linkage.vector2d import TURN, Array
from optlink.problem.design import DesignProblem
from optlink.validation.linkage_motion import placed

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
    return np.asarray(heights if closed else heights[:-1])
