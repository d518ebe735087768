"""Distance from positions where a mechanism locks or its assembly modes meet, measured in motion: angles and lengths.

Nothing here knows the optimiser's formulas: the angle between two links comes from measured distances of their joints.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from optlink.linkage.dyad_types import RPR, RRR
from optlink.linkage.extrema import extremes
from optlink.linkage.fourbar import LENGTHS, Inversion, grashof
from optlink.linkage.motion import Motion
from optlink.problem.limits import Alignment, Limits
from optlink.validation.check import Check

Array = NDArray[np.float64]

SHORT = 5e-3
"""Share by which a design may fall short of a least margin: solvers meet the cosine of 0.1 deg to 1e-8, which is 3e-3 of it."""


def at_least(name: str, value: float, limit: float, unit: str) -> Check:
    """Whether a figure reaches a least margin, both in `unit`; NaN does not."""
    return Check(name, bool(value >= limit * (1.0 - SHORT)), value, f">= {limit:.6g}", unit)


def grashof_check(design: Mapping[str, float], limits: Limits) -> Check:
    """Whether the crank of a four-bar turns fully: shortest and longest link below the other two by the length margin."""
    lengths = [design[name] for name in LENGTHS]
    kind = grashof(*lengths)
    wanted = Inversion.DOUBLE_CRANK if limits.crank == "double-crank" else Inversion.CRANK_ROCKER
    check = at_least(f"Grashof: {kind.inversion.value}", kind.slack * 1e3, limits.length_margin * max(lengths) * 1e3, "mm")
    return replace(check, passed=check.passed and kind.inversion is wanted)


def squared_sines(motion: Motion) -> Array:
    """Squared sine of every group's angle from alignment (groups, positions); negative or NaN where it cannot close."""
    found, crank = [], motion.mechanism.crank
    for group in motion.mechanism.groups:
        if isinstance(group, RPR):  # the slide, in lengths of the crank
            places = [motion.position(name) for name in (*group.outer, crank.start, crank.end)]
            apart, arm = (np.sum((places[k] - places[k + 1]) ** 2, axis=-1) for k in (0, 2))
            found.append(motion.margin(group.joint) * apart / arm)
            continue
        if not isinstance(group, RRR):
            found.append(motion.margin(group.joint))
            continue
        p, q = (motion.position(name) for name in group.pins)
        lengths = (np.linalg.norm(motion.position(group.joint) - pin, axis=-1) for pin in (p, q))
        one, other = (np.median(length[np.isfinite(length)]) if np.any(np.isfinite(length)) else math.nan for length in lengths)
        cosine = (one * one + other * other - np.sum((q - p) ** 2, axis=-1)) / (2.0 * one * other)
        found.append(1.0 - cosine * cosine)
    return np.array(found).reshape(len(motion.mechanism.groups), len(motion.crank_angle))


def alignment_checks(sweep: Callable[[Array], Motion], grid: Array, limits: Alignment, where: str) -> Iterator[Check]:
    """Whether every group keeps its least angle from alignment.

    Parameters
    ----------
    sweep : crank angles (n,) [rad] -> the mechanism in motion
    grid : array (n,) [rad], rising
        The required motion; extremes are refined between its positions.
    limits : Alignment
    where : str
        Name of the required motion.
    """
    groups = sweep(grid[:1]).mechanism.groups
    least = extremes(lambda angles: squared_sines(sweep(angles)), grid)[1][:, 0] if groups else ()
    closed = np.all(np.isfinite(squared_sines(sweep(grid))), axis=1)
    for group, value, whole in zip(groups, least, closed, strict=True):
        joint = "coupler and rocker" if group.joint == "C" and len(groups) == 1 and isinstance(group, RRR) else group.joint
        angle = math.degrees(math.asin(math.sqrt(min(value, 1.0)))) if whole and value >= 0.0 else math.nan
        yield at_least(f"{joint} off alignment over {where}", angle, math.degrees(limits.alignment.value), "deg")
