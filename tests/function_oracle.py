"""Four-bars that follow a function, by separate formulas and SciPy alone: the judge of what `optlink.solve` answers.

Angles of the rocker from complex numbers; least p-norms of rising p (Levenberg-Marquardt-like least squares) from many random
starts, then linear programming steps in a trust region on the largest error at many positions, limits included.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares, linprog

Array = NDArray[np.float64]
MANY, FEW = 401, 41  # positions
PENALTY = 10.0


@dataclass(frozen=True)
class Function:
    """y (n,) in [0, 1] at evenly spaced crank rotations; ranges [rad], limits of the transmission angle [rad] and of ratios."""

    y: object
    input: float
    output: float
    transmission: tuple[float, float]
    ratios: tuple[float, float]
    sides: tuple[int, ...] = (1, -1)

    def target(self, n: int) -> tuple[Array, Array]:
        """Rotations of the crank and of the rocker [rad]."""
        t = np.linspace(0.0, 1.0, n)
        least, most = self.values
        return self.input * t, self.output * (self.y(t) - least) / (most - least)

    @cached_property
    def values(self) -> tuple[float, float]:
        """Least and largest value of y."""
        fine = self.y(np.linspace(0.0, 1.0, 20001))
        return float(fine.min()), float(fine.max())


def rocker(x: Array, side: int, offsets: Array) -> tuple[Array, Array]:
    """Rocker angle and cosine of the transmission angle for log lengths and start angles x; NaN where it cannot close."""
    a, b, c = np.exp(x[:3])
    diagonal = 1.0 - a * np.exp(1j * (x[3] + offsets))  # from B to D, the frame is 1
    square = np.abs(diagonal) ** 2
    cosine = (b * b + c * c - square) / (2.0 * b * c)
    with np.errstate(invalid="ignore"):
        at_b = np.arccos((b * b + square - c * c) / (2.0 * b * np.sqrt(square)))
    point = a * np.exp(1j * (x[3] + offsets)) + b * np.exp(1j * (np.angle(diagonal) + side * at_b))
    return np.angle(point - 1.0), cosine


def errors(x: Array, side: int, task: Function, n: int) -> tuple[Array, Array]:
    """Error at n positions [rad], and every limit as a figure that must not exceed 0."""
    offsets, target = task.target(n)
    angle, cosine = rocker(x, side, offsets)
    error = np.remainder(target + x[4] - angle + np.pi, 2.0 * np.pi) - np.pi
    low, high = np.cos(task.transmission[1]), np.cos(task.transmission[0])
    logs = np.log(task.ratios)
    return error, np.concatenate([low - cosine, cosine - high, logs[0] - x[:3], x[:3] - logs[1]])


def largest(x: Array, side: int, task: Function, n: int = 20001) -> tuple[float, float]:
    """Largest error [rad] and the most by which a limit is missed."""
    error, misses = errors(x, side, task, n)
    return float(np.max(np.abs(error))), float(np.max(misses))


def _smooth(x: Array, side: int, task: Function) -> Array | None:
    def residuals(x: Array, p: float) -> Array:
        error, misses = errors(x, side, task, FEW)
        error = np.where(np.isfinite(error), error, 1.0)
        return np.concatenate([np.sign(error) * np.abs(error) ** p, PENALTY * np.maximum(misses, 0.0)])

    for p in (1.0, 2.0):
        x = least_squares(residuals, x, args=(p,), max_nfev=60).x
    return x if np.all(np.isfinite(errors(x, side, task, FEW)[0])) else None


def _slopes(x: Array, side: int, task: Function, n: int) -> tuple[Array, Array, Array, Array]:
    error, misses = errors(x, side, task, n)
    step = 1e-6
    columns = []
    for k in range(5):
        d = step * np.eye(5)[k]
        (e1, g1), (e0, g0) = errors(x + d, side, task, n), errors(x - d, side, task, n)
        columns.append((np.remainder(e1 - e0 + np.pi, 2 * np.pi) - np.pi, g1 - g0))
    return error, misses, np.stack([c[0] for c in columns], 1) / (2 * step), np.stack([c[1] for c in columns], 1) / (2 * step)


def _levelled(x: Array, side: int, task: Function, n: int, rounds: int) -> tuple[Array, float]:
    """Linear programmes in a trust region: the largest error at n positions; x and it, infinite where a limit is missed."""
    reach, best = 0.1, np.inf
    price = 10.0
    error, misses, by_e, by_g = _slopes(x, side, task, n)

    def merit(e: Array, g: Array) -> float:
        value = np.max(np.abs(e)) + price * max(0.0, float(np.max(g)))
        return float(value) if np.isfinite(value) else np.inf

    best = merit(error, misses)
    for _ in range(rounds):
        near = misses > -0.5
        one = np.ones((n, 1))
        a = np.block([[by_e, -one, 0 * one], [-by_e, -one, 0 * one]])
        g = np.hstack([by_g[near], np.zeros((near.sum(), 1)), -np.ones((near.sum(), 1))])
        b = np.concatenate([-error, error, -misses[near]])
        box = [(-reach, reach)] * 5 + [(0.0, None), (0.0, None)]
        result = linprog([0.0] * 5 + [1.0, price], np.vstack([a, g]), b, bounds=box, method="highs")
        if result.x is None:
            break
        there = x + result.x[:5]
        value = merit(*errors(there, side, task, n))
        if value < best - 1e-13:
            x, gained = there, best - value
            best = value
            error, misses, by_e, by_g = _slopes(x, side, task, n)
            reach = min(2.0 * reach, 0.5) if gained > 0.5 * (best + gained - result.fun) else reach
        else:
            reach *= 0.3
        if reach < 1e-9:
            break
    return x, best if np.max(misses) <= 1e-8 else np.inf


def oracle(task: Function, starts: int, seed: int) -> float:
    """Least largest error [rad] over the assembly modes that many random starts lead to."""
    rng = np.random.default_rng(seed)
    best = np.inf
    for side in task.sides:
        ends: list[tuple[float, Array]] = []
        for _ in range(starts):
            x = np.concatenate([rng.uniform(np.log(0.15), np.log(6.0), 3), rng.uniform(-np.pi, np.pi, 2)])
            computed = _smooth(x, side, task)
            if computed is not None:
                ends.append((float(np.max(np.abs(errors(computed, side, task, FEW)[0]))), computed))
        distinct: list[Array] = []
        for _, x in sorted(ends, key=lambda end: end[0]):
            if len(distinct) < 6 and all(np.max(np.abs(x[:3] - other[:3])) > 1e-2 for other in distinct):
                distinct.append(x)
        levelled = sorted(((value, tuple(x)) for x, value in (_levelled(x, side, task, FEW, 40) for x in distinct)))
        for value, x in levelled[:2]:
            if np.isfinite(value):
                best = min(best, _levelled(np.array(x), side, task, MANY, 25)[1])
    return best
