"""Check the distance of a mechanism from singular positions, measured in motion as angles and lengths.

The optimiser's formulas are not used: the angle between two links follows from measured distances of their joints.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from optlink.linkage.dyad_types import RPR, RRR
from optlink.linkage.fourbar import LENGTHS, classify
from optlink.linkage.mechanism import Dyad
from optlink.linkage.motion import Motion
from optlink.linkage.vector2d import Array
from optlink.problem.limits import Limits
from optlink.validation.check import Checks, Text, text

SHORT = 5e-3
"""Share by which a design may fall short of a least margin: solvers meet the cosine of 0.1 deg to 1e-8, which is 3e-3 of it."""


def at_least(name: Text, value: ArrayLike, limit: ArrayLike, unit: str) -> Checks:
    """Check whether a value [unit] reaches a least margin [unit]; NaN does not."""
    value, limit = np.asarray(value, dtype=float), np.asarray(limit, dtype=float)
    return Checks(name, value >= limit * (1.0 - SHORT), value, text(">= {:.6g}", limit), unit)


def grashof_check(each: Sequence[ArrayLike], limits: Limits) -> Checks:
    """Check whether the crank of a four-bar turns fully; `each`: lengths [m] of crank, coupler, rocker and frame.

    The sum of shortest and longest link must be below that of the other two by the length margin.
    """
    lengths = np.array(np.broadcast_arrays(*map(np.atleast_1d, each)), dtype=float)
    shortest, second, third, longest = np.sort(lengths, axis=0)
    turning = "frame" if limits.crank == "double-crank" else "crank"  # the shortest link of the required inversion
    slack, margin = second + third - shortest - longest, limits.length_margin * longest
    check = at_least(lambda k: f"Grashof: {classify(*lengths[:, k].tolist()).inversion.value}", slack * 1e3, margin * 1e3, "mm")
    return replace(check, passed=check.passed & (slack > 0.0) & (np.argmin(lengths, axis=0) == LENGTHS.index(turning)))


def included_cosine(one: ArrayLike, other: ArrayLike, square: Array) -> Array:
    """Return the cosine of the angle between two links, by the law of cosines; beyond -1 ... 1 where they do not meet.

    From their measured lengths [m], and the square of the distance of their ends [m^2].
    """
    one, other = np.asarray(one), np.asarray(other)
    return np.asarray((one * one + other * other - square) / (2.0 * one * other))


def squared_sines(motion: Motion) -> Array:
    """Return the squared sine of the angle of each group from alignment (groups, ...); negative or NaN if not closed."""
    sines, crank = [], motion.mechanism.crank
    for group in motion.mechanism.groups:
        if isinstance(group, RRR):
            (p, q), c = (motion.position(name) for name in group.outer), motion.position(group.joint)
            first, second = (_median(np.linalg.norm(c - pin, axis=-1)) for pin in (p, q))
            cosine = included_cosine(first, second, np.sum((q - p) ** 2, axis=-1))
            sines.append(1.0 - cosine * cosine)
        elif isinstance(group, RPR):  # the slide, relative to the crank length
            places = [motion.position(name) for name in (*group.outer, crank.start, crank.end)]
            apart, arm = (np.sum((places[k] - places[k + 1]) ** 2, axis=-1) for k in (0, 2))
            sines.append(motion.margin(group.joint) * apart / arm)
        else:
            sines.append(motion.margin(group.joint))
    return np.array(sines).reshape(len(motion.mechanism.groups), *motion.shape)


def _median(values: Array) -> Array:
    """Return the median (..., 1) of the finite ones of values (..., n), without numpy's masked arrays; NaN if there is none."""
    rising = np.sort(np.where(np.isfinite(values), values, np.nan), axis=-1)
    count = np.count_nonzero(np.isfinite(values), axis=-1, keepdims=True)
    low, high = (np.take_along_axis(rising, np.maximum(place, 0), axis=-1) for place in ((count - 1) // 2, count // 2))
    return np.asarray(0.5 * (low + high))


def alignment_check(group: Dyad, single: bool, sine: ArrayLike, limits: Limits, where: str) -> Checks:
    """Check that a group, the `single` one or one of several, keeps its least angle from alignment over the motion `where`.

    `sine`: least squared sine of that angle; negative or NaN if the group does not close.
    """
    joint = " and ".join(link.body for link in group.links) if single and isinstance(group, RRR) else group.joint
    with np.errstate(invalid="ignore"):
        angle = np.degrees(np.arcsin(np.sqrt(np.minimum(sine, 1.0))))
    return at_least(f"{joint} off alignment over {where}", angle, math.degrees(limits.alignment.value), "deg")
