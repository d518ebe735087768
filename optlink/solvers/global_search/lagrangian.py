"""Bounds of a minimisation problem over boxes of designs, by Taylor models (`optlink.optimization.taylor_model`).

A box is discarded if

- a limit, or a combination of limits with multipliers that are not negative, is violated everywhere in it ("limits");
- the objective is at least the threshold everywhere in it ("objective");
- the Lagrangian, objective minus multipliers times slacks of the limits, is ("Lagrangian"): where no slack is negative it is a
  lower bound of the objective.

A box that is not discarded is reduced where possible: parts in which a limit is violated, or in which a single deviation makes
the objective too large, are cut off ("cut").

Any non-negative multipliers give a valid bound; a few cheap steps choose good ones. The objective is a weighted sum of squares.
For the largest of several deviations, any weights with the sum 1 give a lower bound of its square, and the best weights give the
largest one (Lawson); they too are chosen for every box.

References
----------
A. Neumaier, Complete search in continuous global optimization and constraint satisfaction, Acta Numerica 13 (2004) 271-369,
sections 11-16. C. L. Lawson, Contributions to the theory of linear least maximum approximation, thesis, UCLA 1961: weights of
a least-squares fit that make it the minimax fit.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Self

import numpy as np
from numpy.typing import NDArray

from optlink.linkage.vector2d import Array, finite_or
from optlink.optimization.taylor_model import ROUNDING, TINY, UNIT, UPWARD, BoxModels, DesignBoxes, TaylorModel, pairs

# Polynomials of second order and linear inequalities over the box -1 <= d <= 1: rigorous bounds, elementwise over many boxes.

DESCENT = 8  # rounds of coordinate descent towards the minimum of a convex quadratic form
WORTH = 0.15  # share of the width of a box that must be cut off


def quadratic_bound(constant: Array, linear: Array, quadratic: Array, remainder: Array) -> Array:
    """Return a lower bound, over -1 <= d <= 1, of polynomials of second order minus a remainder; -inf where there is none.

    The better of two: each unknown by itself, with the mixed terms at their worst; and the tangent plane, at about its minimum,
    of the polynomial made convex by a multiple of d^2 - 1. Coefficients: `constant` (boxes,), `linear` (boxes, n), `quadratic`
    (boxes, n (n + 1) / 2) in the order of `pairs`.
    """
    boxes, n = linear.shape
    hessian, mixed = np.zeros((boxes, n, n)), np.zeros(boxes)
    for k, (i, j) in enumerate(pairs(n)):
        hessian[:, i, j] += quadratic[:, k]
        hessian[:, j, i] += quadratic[:, k]
        mixed += np.abs(quadratic[:, k]) if i != j else 0.0
    size = np.abs(constant) + np.abs(linear).sum(axis=1) + np.abs(quadratic).sum(axis=1)
    with np.errstate(all="ignore"):
        curvature = np.einsum("bii->bi", hessian)
        inside = np.abs(linear) < curvature
        separate = np.where(inside, -0.5 * linear * linear / np.where(inside, curvature, 1.0), 0.5 * curvature - np.abs(linear))
        simple = constant + separate.sum(axis=1) - mixed
        scale = np.abs(hessian).sum(axis=(1, 2))
        clean = np.isfinite(scale)
        least = np.linalg.eigvalsh(np.where(clean[:, None, None], hessian, 0.0))[:, 0]
        shift = np.maximum(0.0, 1e-12 * scale - least)  # far beyond the error of a computed eigenvalue, so the sum is convex
        convex = hessian + shift[:, None, None] * np.eye(n)
        point = box_minimum(linear, convex)
        slope = linear + np.einsum("bij,bj->bi", convex, point)
        value = constant + 0.5 * np.sum((linear + slope) * point, axis=1)
        tangent = value - np.sum(np.abs(slope) + slope * point, axis=1) - 0.5 * n * shift
        rounding = 16.0 * n * n * ROUNDING * (size + n * shift)
        bound = (
            np.maximum(simple, np.where(clean & np.isfinite(tangent), tangent, -np.inf)) - rounding - remainder * UPWARD - TINY
        )
    return finite_or(bound, -np.inf)


def box_minimum(linear: Array, convex: Array) -> Array:
    """Return about the minimum (boxes, n) of linear . d + d' convex d / 2 over -1 <= d <= 1; `convex` is positive semidefinite.

    It starts from the minimum without bounds, which is the answer if it lies within, and goes on by coordinate descent.
    """
    n = linear.shape[1]
    clean = np.all(np.isfinite(convex), axis=(1, 2)) & np.all(np.isfinite(linear), axis=1)
    matrix = np.where(clean[:, None, None], convex, 0.0)
    firm = 1e-14 * np.trace(matrix, axis1=1, axis2=2) + TINY  # no matrix is singular
    with np.errstate(all="ignore"):
        point = -np.linalg.solve(matrix + firm[:, None, None] * np.eye(n), np.where(clean[:, None], linear, 0.0)[..., None])[
            ..., 0
        ]
        point = np.clip(finite_or(point, 0.0), -1.0, 1.0)
        slope = linear + np.einsum("bij,bj->bi", convex, point)
        for step in range(DESCENT * n):
            i = step % n
            curvature = convex[:, i, i]
            target = np.where(curvature > 0.0, point[:, i] - slope[:, i] / curvature, -np.sign(slope[:, i]))
            move = np.clip(finite_or(target, 0.0), -1.0, 1.0) - point[:, i]
            point[:, i] += move
            slope += convex[:, :, i] * move[:, None]
    return point


def cut_box(rows: Array, most: Array) -> tuple[Array, Array]:
    """Return bounds (boxes, n) within -1 ... 1 of the points d with rows . d <= most, rigorous; -1 and 1 where little is gained.

    `rows` (boxes, m, n), `most` (boxes, m).
    """
    size = np.abs(rows)
    total = size.sum(axis=2, keepdims=True)
    with np.errstate(all="ignore"):
        room = most[..., None] + (total - size)  # the other unknowns at their best
        rounding = 64.0 * UNIT * (np.abs(most)[..., None] + 2.0 * total) / size
        end = room / rows
        high = np.min(np.where(rows > 0.0, end + rounding, np.inf), axis=1, initial=np.inf)
        low = np.max(np.where(rows < 0.0, end - rounding, -np.inf), axis=1, initial=-np.inf)
    low = np.where(low > -1.0 + 2.0 * WORTH, low, -1.0)
    return low, np.where(high < 1.0 - 2.0 * WORTH, high, 1.0)


def least_squares(matrix: Array, vector: Array) -> Array:
    """Return x (n,) >= 0 with about the least |matrix x - vector|, by leaving out what becomes negative."""
    used = np.arange(matrix.shape[1])
    solution = np.zeros(matrix.shape[1])
    while used.size:
        x = np.linalg.lstsq(matrix[:, used], vector, rcond=None)[0]
        if np.all(x >= 0.0):
            solution[used] = x
            break
        used = used[x > np.min(x)]
    return solution


ROUNDS = 3  # multipliers that are raised for a box, one after the other
LAWSON = 6  # steps of the weights
TESTS = ("limits", "objective", "Lagrangian", "cut")
CUT = TESTS.index("cut")
OPEN = -1  # in place of the index of a test: the box is not discarded


@dataclass(frozen=True)
class BoxRecord:
    """Bounds of a batch of boxes.

    Parameters
    ----------
    bound : array (boxes,)
        Lower bound of the objective.
    test : array of int (boxes,)
        Index in `TESTS` of the test that discards a box, or `OPEN`.
    multipliers : array (boxes, limits)
    split : array of int (boxes,)
        Unknown along which a box that is not discarded should be halved.
    centre : array (boxes,)
        Objective at the centre, infinite where it is undefined or a limit is violated there; not rigorous.
    low, high : array (boxes, n)
        Corners of what is left of a box that is not discarded.
    """

    bound: Array
    test: NDArray[np.int8]
    multipliers: Array
    split: NDArray[np.intp]
    centre: Array
    low: Array
    high: Array

    @classmethod
    def joined(cls, parts: Sequence[Self]) -> Self:
        """Return the records of several batches as one."""
        return cls(**{one.name: np.concatenate([getattr(part, one.name) for part in parts]) for one in fields(cls)})


@dataclass(frozen=True)
class Guess:
    """The best design (n,), and multipliers (limits,) and weights (positions,) that are good near it."""

    point: Array
    multipliers: Array
    weights: Array


class LagrangianBounds:
    """Lower bounds of a problem over boxes of its designs, in terms of the squared size of its residuals."""

    def __init__(self, problem: DesignBoxes, guess: Guess | None = None) -> None:
        self.problem, self.guess = problem, guess
        self.low, self.high = problem.low, problem.high

    def bounded(self, low: Array, high: Array, threshold: float) -> BoxRecord:
        """Bound a batch of boxes; see `Bounder`."""
        models = self.problem.over(low, high)
        batch = _Batch(models, self.problem.measure, threshold)
        batch.violated_limits()
        for weights in self._weights(models):
            batch.weighted(weights, self.guess)
        batch.empty()
        inner = batch.cut(low, high)
        return batch.record((high - low) / (self.high - self.low), *inner)

    def _weights(self, models: BoxModels) -> list[Array]:
        positions = models.residuals.remainder.shape[1]
        if self.problem.measure != "max":
            return [np.full(positions, 1.0 / positions if self.problem.measure == "rms" else 1.0)]
        weights = [] if self.guess is None else [self.guess.weights]
        return [*weights, lawson_weights(models)]


class _Batch:
    """The tests of a batch of boxes, one after the other; each is applied to the boxes that are still open."""

    def __init__(self, models: BoxModels, measure: str, threshold: float) -> None:
        self.models, self.measure, self.threshold = models, measure, threshold
        boxes, limits = models.slacks.remainder.shape
        self.bound = np.zeros(boxes)
        self.test = np.full(boxes, OPEN, dtype=np.int8)
        self.multipliers = np.zeros((boxes, limits))
        self.objective: TaylorModel | None = None
        residuals = models.residuals
        self.least = least_size(residuals, periodic=models.periodic)
        usable = np.isfinite(residuals.remainder)
        if models.periodic:
            usable &= (residuals.high < math.pi) & (residuals.low > -math.pi)
        self.usable, self.whole = usable, np.all(usable, axis=(1, 2))
        if not np.all(usable):
            coefficients = np.where(usable, residuals.coefficients, 0.0)
            coefficients[0] = np.where(usable, residuals.value, self.least)
            residuals = TaylorModel(coefficients, np.where(usable, residuals.remainder, 0.0), residuals.count)
        self.squares = (residuals * residuals).sum()  # (boxes, positions)

    def violated_limits(self) -> None:
        """Discard boxes in which one limit is violated everywhere."""
        high = self.models.slacks.high
        if not high.size:
            return
        violated = np.any(high < 0.0, axis=1)
        self.test[violated] = 0
        self.multipliers[violated, np.argmin(high[violated], axis=1)] = 1.0

    def weighted(self, weights: Array, guess: Guess | None) -> None:
        """Bound the sum of squares with weights (positions,) or (boxes, positions), alone and with multipliers."""
        objective = (self.squares * weights).sum()
        squares = np.sum(self.least * self.least, axis=2)
        squares = np.max(squares, axis=1) if self.measure == "max" else np.sum(weights * squares, axis=1)
        self._raise(squares * (1.0 - 8.0 * UNIT * (8 + weights.shape[-1])), 1)
        self._raise(lagrangian_bound(objective, self.models.slacks, np.zeros_like(self.multipliers)), 1)
        self.objective = objective
        left = np.flatnonzero(self.test == OPEN)
        if not left.size or not self.multipliers.shape[1]:
            return
        goal, slacks = objective[left], self.models.slacks[left]
        first = goal.value, goal.linear.T, goal.radius - goal.sizes[0]
        tried = [raised_multipliers(first, _linear_parts(slacks))]
        if guess is not None:
            tried.append(np.tile(guess.multipliers, (left.size, 1)))
        for multipliers in tried:
            self._raise(lagrangian_bound(goal, slacks, multipliers), 2, left, multipliers)

    def empty(self) -> None:
        """Discard boxes in which a combination of limits is violated everywhere."""
        left = np.flatnonzero(self.test == OPEN)
        if not left.size or self.multipliers.shape[1] < 2:
            return
        slacks = self.models.slacks[left]
        value, linear, spread = _linear_parts(slacks)
        rows, worst = np.arange(left.size), np.argmin(np.where(np.isfinite(slacks.remainder), value, np.inf), axis=1)
        multipliers = raised_multipliers(
            (-value[rows, worst], -linear[rows, worst], spread[rows, worst]), (value, linear, spread)
        )
        multipliers[rows, worst] += 1.0
        empty = lagrangian_bound(None, slacks, multipliers) > 0.0
        self.test[left[empty]] = 0
        self.multipliers[left[empty]] = multipliers[empty]

    def cut(self, low: Array, high: Array) -> tuple[Array, Array]:
        """Return the corners (boxes, n) of the parts of the boxes that can hold a design below the threshold.

        From the linear parts: a feasible design d in -1 ... 1 satisfies a . d <= most for every row (a, most) below.
        """
        left = np.flatnonzero(self.test == OPEN)
        if not left.size:
            return low, high
        positions = self.models.residuals.remainder.shape[1]
        largest = math.sqrt(self.threshold * (positions if self.measure == "rms" else 1.0)) * (1.0 + 16.0 * UNIT)
        rows, most = [], []
        if self.measure and math.isfinite(largest):
            usable = self.usable[left].reshape(left.size, -1)
            residuals = self.models.residuals[left]
            flat = TaylorModel(
                residuals.coefficients.reshape(len(residuals.coefficients), left.size, -1),
                residuals.remainder.reshape(left.size, -1),
                residuals.count,
            )
            value, linear, rest = _linear_parts(flat)
            for sign in (1.0, -1.0):
                rows.append(np.where(usable[..., None], sign * linear, 0.0))
                most.append(np.where(usable, largest - sign * value + rest, np.inf))
        value, linear, rest = _linear_parts(self.models.slacks[left])
        bounded = np.isfinite(self.models.slacks.remainder[left])
        rows.append(-linear)
        most.append(np.where(bounded, value + rest, np.inf))
        inner_low, inner_high = cut_box(np.concatenate(rows, axis=1), np.concatenate(most, axis=1))
        centre, radius = 0.5 * (low[left] + high[left]), 0.5 * (high[left] - low[left])
        slack = 8.0 * UNIT * (np.abs(low[left]) + np.abs(high[left]))
        new_low, new_high = low.copy(), high.copy()
        new_low[left] = np.where(inner_low > -1.0, np.maximum(low[left], centre + inner_low * radius - slack), low[left])
        new_high[left] = np.where(inner_high < 1.0, np.minimum(high[left], centre + inner_high * radius + slack), high[left])
        empty = left[np.any(new_low[left] > new_high[left], axis=1)]
        self.test[empty] = CUT
        self.bound[empty] = np.maximum(self.bound[empty], self.threshold if math.isfinite(self.threshold) else 0.0)
        return new_low, new_high

    def _raise(self, bound: Array, test: int, left: NDArray[np.intp] | None = None, multipliers: Array | None = None) -> None:
        """Take a bound of the boxes `left` (default: all) where it is higher than that known."""
        left = np.arange(len(self.bound)) if left is None else left
        better = bound > self.bound[left]
        self.bound[left[better]] = bound[better]
        if multipliers is not None:
            self.multipliers[left[better]] = multipliers[better]
        self.test[left[(self.bound[left] >= self.threshold) & (self.test[left] == OPEN)]] = test

    def record(self, width: Array, low: Array, high: Array) -> BoxRecord:
        """Return the bounds, and for every box the unknown that changes the objective most; the widest if it is undefined.

        `width` (boxes, n) is that of the boxes, as shares of the bounds; `low` and `high` are the corners of what is left of
        them.
        """
        assert self.objective is not None
        objective, n = self.objective, width.shape[1]
        change = np.abs(objective.linear).T.copy()
        for k, (i, j) in enumerate(pairs(n)):
            change[:, i] += np.abs(objective.quadratic[k])
            change[:, j] += np.abs(objective.quadratic[k])
        clear = self.whole & np.all(np.isfinite(change), axis=1)
        split = np.where(clear, np.argmax(np.where(clear[:, None], change, 0.0), axis=1), np.argmax(width, axis=1))
        squares = self.squares.value
        centre = np.max(squares, axis=1) if self.measure == "max" else objective.value
        feasible = np.all(self.models.slacks.value >= 0.0, axis=1)
        return BoxRecord(
            self.bound, self.test, self.multipliers, split, np.where(self.whole & feasible, centre, np.inf), low, high
        )


def least_size(residuals: TaylorModel, *, periodic: bool) -> Array:
    """Return a lower bound of the size of every residual over every box, zero where there is none (`BoxModels.periodic`)."""
    low, high = residuals.low, residuals.high
    size = np.maximum(0.0, np.maximum(low, -high))
    if periodic:
        farthest = np.maximum(high, -low)
        beyond = np.maximum(0.0, 2.0 * math.pi * (1.0 - 8.0 * UNIT) - farthest)
        size = np.where(farthest > math.pi, np.minimum(size, beyond), size)
    return size


def lagrangian_bound(objective: TaylorModel | None, slacks: TaylorModel, multipliers: Array) -> Array:
    """Return the lower bound (boxes,) of objective - multipliers . slacks; without an objective, of the second part alone.

    The multipliers (boxes, limits) are not negative. Slacks that cannot be bounded are left out: their multiplier becomes zero in
    place.
    """
    multipliers[~np.isfinite(slacks.remainder)] = 0.0
    weighted = slacks.coefficients * multipliers
    remainder = np.where(multipliers > 0.0, slacks.remainder, 0.0) * multipliers
    rounding = (4.0 + multipliers.shape[1]) * ROUNDING * np.abs(weighted).sum(axis=(0, 2))
    coefficients, spread = -weighted.sum(axis=2), remainder.sum(axis=1) * UPWARD + rounding
    if objective is not None:
        rounding = ROUNDING * (np.abs(coefficients).sum(axis=0) + np.abs(objective.coefficients).sum(axis=0))
        coefficients, spread = coefficients + objective.coefficients, spread + objective.remainder + rounding
    n = slacks.count
    return quadratic_bound(coefficients[0], coefficients[1 : 1 + n].T, coefficients[1 + n :].T, spread)


Parts = tuple[Array, Array, Array]
"""Value at the centre, first-order coefficients (last axis), and a bound of the rest."""


def _linear_parts(slacks: TaylorModel) -> Parts:
    bounded = np.isfinite(slacks.remainder)
    linear = np.where(bounded[..., None], np.moveaxis(slacks.linear, 0, -1), 0.0)
    rest = np.where(bounded, slacks.radius - slacks.sizes[0], 0.0)
    return np.where(bounded, slacks.value, 0.0), linear, rest


def raised_multipliers(first: Parts, slack: Parts) -> Array:
    """Return multipliers (boxes, limits) that raise the bound of the linear part of the Lagrangian, from objective and slacks.

    In every round, each multiplier is tried at the values where a slope of the Lagrangian vanishes (its bound is concave and
    piecewise linear in one multiplier, with its maximum at one of them), and the best step of all is taken.
    """
    constant, linear, spread = first
    value, slope, rest = slack
    boxes, limits, n = slope.shape
    rows, multipliers = np.arange(boxes), np.zeros((boxes, limits))
    for _ in range(ROUNDS):
        now = constant - spread - np.sum(multipliers * (value + rest), axis=1)
        gradient = linear - np.einsum("bm,bmn->bn", multipliers, slope)
        with np.errstate(all="ignore"):
            step = gradient[:, None, :] / slope
        step = np.maximum(finite_or(step, 0.0), -multipliers[:, :, None])
        turned = gradient[:, None, None, :] - step[..., None] * slope[:, :, None, :]
        bound = now[:, None, None] - step * (value + rest)[:, :, None] - np.abs(turned).sum(axis=-1)
        flat = bound.reshape(boxes, -1)
        best = np.argmax(flat, axis=1)
        better = flat[rows, best] > now - np.abs(gradient).sum(axis=1)
        if not np.any(better):
            break
        multipliers[rows[better], (best // n)[better]] += step.reshape(boxes, -1)[rows, best][better]
    return np.maximum(multipliers, 0.0)


def lawson_weights(models: BoxModels) -> Array:
    """Return weights (boxes, positions) with the sum 1 (at most) that raise the least weighted sum of squares of every box.

    Each step multiplies the weight of a position by its deviation at the minimum of the sum, for the linear parts.
    """
    residuals = models.residuals
    usable = np.isfinite(residuals.remainder)
    value = np.where(usable, residuals.value, 0.0)
    slope = np.where(usable, residuals.linear, 0.0)  # (n, boxes, positions, components)
    boxes, positions, _ = value.shape
    weights = np.full((boxes, positions), 1.0 / positions)
    for _ in range(LAWSON):
        scaled = slope * weights[..., None]
        convex = 2.0 * np.einsum("ibpc,jbpc->bij", scaled, slope)
        point = box_minimum(2.0 * np.einsum("ibpc,bpc->bi", scaled, value), convex)
        size = np.sqrt(np.sum((value + np.einsum("ibpc,bi->bpc", slope, point)) ** 2, axis=2))
        total = np.sum(weights * size, axis=1, keepdims=True)
        weights = np.where(total > 0.0, weights * size / np.where(total > 0.0, total, 1.0), weights)
    total = np.maximum(weights.sum(axis=1, keepdims=True), TINY)
    return np.asarray(weights * (1.0 - 8.0 * UNIT * positions) / total)
