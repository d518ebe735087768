"""Check the distance of a mechanism from singular positions, measured in motion as angles and lengths.

The optimiser's formulas are not used: the angle between two links follows from measured distances of their joints.
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
    """Check whether a value reaches a least margin; NaN does not.

    Parameters
    ----------
    name : str
        Name of the check.
    value : float [unit]
    limit : float [unit]
        Least margin.
    unit : str
        Display unit.
    """
    return Check(name, bool(value >= limit * (1.0 - SHORT)), value, f">= {limit:.6g}", unit)


def grashof_check(design: Mapping[str, float], limits: Limits) -> Check:
    """Check whether the crank of a four-bar turns fully.

    The sum of shortest and longest link must be below that of the other two by the length margin.

    Parameters
    ----------
    design : mapping of str to float [m]
        Contains crank, coupler, rocker and frame.
    limits : Limits
        Kind of crank rotation and length margin.
    """
    lengths = [design[name] for name in LENGTHS]
    kind = grashof(*lengths)
    wanted = Inversion.DOUBLE_CRANK if limits.crank == "double-crank" else Inversion.CRANK_ROCKER
    check = at_least(f"Grashof: {kind.inversion.value}", kind.slack * 1e3, limits.length_margin * max(lengths) * 1e3, "mm")
    return replace(check, passed=check.passed and kind.inversion is wanted)


def squared_sines(motion: Motion) -> Array:
    """Return the squared sine of the angle of each group from alignment (groups, positions); negative or NaN if not closed."""
    found, crank = [], motion.mechanism.crank
    for group in motion.mechanism.groups:
        if isinstance(group, RPR):  # the slide, relative to the crank length
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
    """Check that every group keeps its least angle from alignment.

    Parameters
    ----------
    sweep : function of crank angles (n,) [rad] to Motion
    grid : array (n,) [rad]
        Required motion, rising; extremes are refined between its positions.
    limits : Alignment
        Least angle from alignment.
    where : str
        Name of the required motion.
    """
    groups = sweep(grid[:1]).mechanism.groups
    turns = math.isclose(grid[-1] - grid[0], math.tau)
    least = extremes(lambda angles: squared_sines(sweep(angles)), grid, periodic=turns)[1][:, 0] if groups else ()
    closed = np.all(np.isfinite(squared_sines(sweep(grid))), axis=1)
    for group, value, whole in zip(groups, least, closed, strict=True):
        joint = "coupler and rocker" if group.joint == "C" and len(groups) == 1 and isinstance(group, RRR) else group.joint
        angle = math.degrees(math.asin(math.sqrt(min(value, 1.0)))) if whole and value >= 0.0 else math.nan
        yield at_least(f"{joint} off alignment over {where}", angle, math.degrees(limits.alignment.value), "deg")
