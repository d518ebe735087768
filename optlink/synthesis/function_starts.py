"""Starting points of function synthesis: Freudenstein fits and convex first designs (`optlink.synthesis.freudenstein`)."""

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from optlink.linkage.fourbar import transmission_cosine
from optlink.linkage.vector2d import TURN, Array, unit
from optlink.problem.design import DesignProblem
from optlink.problem.quantity import Quantity
from optlink.problem.targets.function import Function
from optlink.synthesis.freudenstein import FirstStep, first_steps, fit_pairs
from optlink.synthesis.freudenstein_fit import FitProblem, Keep
from optlink.synthesis.loop_equations import LoopEquation

UNLIMITED = (1e-3, 1e3)  # ratios beyond a thousand are not practical
BLOCK, BLOCKS = 1024, 8  # random start angles per block, and number of blocks
GRID = 36  # start angles of crank and rocker that are scanned, each over half a turn
WIDER = 2.0 * math.pi / 180.0  # relaxation of the transmission-angle limits: the nearest start may just violate them


def fittable(problem: DesignProblem) -> bool:
    """Return whether a function has convex first designs: free lengths, a range of ratios, and three positions at least."""
    loop, law = problem.four_bar, problem.requirement.law
    if loop is None or problem.links or not isinstance(law, Function) or not set(loop.names) <= set(problem.free):
        return False
    low, high = _ratios(problem)
    return low < high and len(problem.law.offsets) > 2


def _ratios(problem: DesignProblem) -> tuple[float, float]:
    """Return the limits of crank, coupler and rocker over the frame."""
    ratio = problem.limits.link_ratio
    return UNLIMITED if ratio is None else (ratio.low or UNLIMITED[0], ratio.high or UNLIMITED[1])


def steps(problem: DesignProblem) -> list[FirstStep]:
    """Return the best first designs with the assembly mode of the problem, by increasing error."""
    free, ranges = _ranges(problem)
    phi0, psi0 = (_grid(low, high, free) for low, high in ranges)
    return first_steps(_fit_problem(problem, free), phi0, psi0)


def fits(problem: DesignProblem, seed: int) -> Iterator[dict[str, float]]:
    """Yield fitted linkages at random start angles (scrambled Sobol points) as quantities of the problem.

    Only linkages that keep the assembly mode of the problem are yielded; at most `BLOCK` times `BLOCKS` points are tried.
    """
    from scipy.stats import qmc

    free, ranges = _ranges(problem)
    if all(low == high for low, high in ranges):
        return
    task, points = _fit_problem(problem, free), qmc.Sobol(2, rng=np.random.default_rng(seed))
    low = np.array([start[0] for start in ranges])
    size = np.array([math.pi if free else start[1] - start[0] for start in ranges])
    for _ in range(BLOCKS):
        phi0, psi0 = (low + size * points.random(BLOCK)).T
        for step in fit_pairs(task, phi0, psi0):
            yield values(problem, step)


def _fit_problem(problem: DesignProblem, free: bool) -> FitProblem:
    """Return the fit of a function; `free`: of start angles that are free over at least half a turn."""
    law, offsets = problem.requirement.law, problem.law.offsets
    assert isinstance(law, Function)
    rise = np.asarray(law.rise(offsets), dtype=float)
    return FitProblem(LoopEquation(_ratios(problem)), offsets, rise, problem.measure == "max", free, _keep(problem, offsets))


def _ranges(problem: DesignProblem) -> tuple[bool, list[tuple[float, float]]]:
    """Return whether both start angles are free over at least half a turn, and their bounds [rad]."""
    starts = [problem.quantities[name] for name in (problem.start_name, problem.base_name)]
    turned = problem.frame_angle or 0.0
    ranges = [(start.bounds[0] - turned, start.bounds[1] - turned) for start in starts]
    return all(start.free and start.bounds[1] - start.bounds[0] >= math.pi for start in starts), ranges


def values(problem: DesignProblem, step: FirstStep) -> dict[str, float]:
    """Return a first design as quantities [m, rad] of the problem."""
    loop, turned, quantities = problem.four_bar, problem.frame_angle or 0.0, problem.quantities
    assert loop is not None
    pivots = {name: quantities[name].value for name in loop.ground}
    frame = loop.frame(pivots)[0]
    lengths = dict(zip(loop.names, (step.crank * frame, step.coupler * frame, step.rocker * frame), strict=True))
    starts = (problem.start_name, step.phi0), (problem.base_name, step.psi0)
    return {**lengths, **pivots, **{name: _into(quantities[name], angle + turned) for name, angle in starts}}


def _grid(low: float, high: float, whole: bool) -> Array:
    if low == high:
        return np.array([low])
    if whole:
        return np.linspace(0.0, math.pi, GRID, endpoint=False) + low
    return np.linspace(low, high, GRID)


def _into(start: Quantity, angle: float) -> float:
    """Shift an angle by whole revolutions into the bounds of its quantity if possible, as near to zero as possible."""
    low, high = start.bounds
    turned = [angle + TURN * k for k in range(-2, 3)]
    return min(turned, key=lambda a: (not low <= a <= high, abs(a)))


def _keep(problem: DesignProblem, offsets: Array) -> Keep:
    """Return a filter for linkages with the assembly mode of the problem that nearly satisfy its transmission-angle limits."""
    assert problem.four_bar is not None
    interval, mode = problem.limits.transmission_at(problem.four_bar.joint), problem.four_bar.side
    low = 0.0 if interval is None or interval.low is None else interval.low - WIDER
    high = math.pi if interval is None or interval.high is None else interval.high + WIDER

    def keep(crank: Array, coupler: Array, rocker: Array, phi0: Array, psi0: Array, side: Array) -> NDArray[np.bool_]:
        cos_phi = unit(phi0[:, None] + offsets)[0]
        cosine = transmission_cosine(crank[:, None], coupler[:, None], rocker[:, None], 1.0, cos_phi)
        inside = np.all((cosine <= math.cos(max(low, 0.0))) & (cosine >= math.cos(min(high, math.pi))), axis=1)
        return np.asarray(inside & (side == mode))

    return keep
