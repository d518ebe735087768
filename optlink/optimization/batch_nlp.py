"""A nonlinear programme at many points, with many values of its parameters; every figure of a point is the same in any batch.

The residual of a motion law at one fixed position is traced once with its derivatives, and evaluated by numpy at all positions of
all points. Other programmes are evaluated point by point.
"""

from dataclasses import dataclass
from typing import Any, Protocol

import casadi
import numpy as np

from optlink.linkage.vector2d import Array
from optlink.optimization.nlp import NLP
from optlink.problem.design import EPIGRAPH
from optlink.problem.targets.law import Law
from optlink.symbolic import NumpyEvaluator


@dataclass(frozen=True)
class BatchValues:
    """A programme at many points: arrays over the points.

    `objective` (points,) is that of the measure; `gradient` (points, n) belongs to the scaled objective, `values` (points, n + m)
    are the variables and the rows, `jacobian` (points, n + m, n) their derivatives, `hessian` (points, n, n) is that of the
    Lagrangian.
    """

    objective: Array
    gradient: Array
    values: Array
    jacobian: Array
    hessian: Array


class Evaluator(Protocol):
    """Evaluates a programme of `size` variables at x (points, n).

    p (points, k) are its parameters, the multipliers (points, n + m) those of the bounds of the variables and of the rows.
    """

    size: int

    def __call__(self, x: Array, p: Array, multipliers: Array) -> BatchValues:
        """Evaluate the programme."""
        ...


class PointwiseNLP:
    """Evaluates any programme, one point after the other."""

    def __init__(self, nlp: NLP) -> None:
        self.nlp, self.size = nlp, len(nlp.variables)

    def __call__(self, x: Array, p: Array, multipliers: Array) -> BatchValues:
        """Evaluate the programme; see `Evaluator`."""
        each, unit = [], np.eye(self.size)
        for y, q, prices in zip(x, p, multipliers, strict=True):
            point, objective = self.nlp.at(y, q), self.nlp.measure.of(self.nlp.residuals(y, q))
            values, jacobian = np.concatenate([y, point.g]), np.concatenate([unit, point.jacobian])
            each.append((objective, point.gradient, values, jacobian, self.nlp.hessian(y, q, prices[self.size :])))
        return BatchValues(*map(np.array, zip(*each, strict=True)))


class BatchNLP:
    """Evaluates a programme without exchange points at the positions of its law."""

    def __init__(self, nlp: NLP, law: Law) -> None:
        self.nlp, self.size, self.offsets, self.tabulated = nlp, len(nlp.variables), law.offsets, law.tabulated
        self.minimax = nlp.variables[-1].name == EPIGRAPH
        self.limits = sum(row.limit != EPIGRAPH for row in nlp.rows)
        self.pairs = [(i, j) for i in range(self.size) for j in range(i, self.size)]
        x, p, position = nlp.x_symbol, nlp.p_symbol, nlp.position_expression
        self.width = position.numel()
        parts: list[Any] = []
        for k in range(self.width):
            hessian, gradient = casadi.hessian(position[k], x)
            parts += [position[k], gradient, *(hessian[i, j] for i, j in self.pairs)]
        self._residuals = NumpyEvaluator([x, p, nlp.position_symbol], parts)
        multipliers, rows = casadi.SX.sym("multipliers", self.limits), nlp.g_expression[: self.limits]
        hessian = casadi.hessian(casadi.dot(multipliers, rows), x)[0]
        second = [hessian[i, j] for i, j in self.pairs]
        self._limits = NumpyEvaluator([x, p, multipliers], [rows, casadi.jacobian(rows, x).T, *second])

    def __call__(self, x: Array, p: Array, multipliers: Array) -> BatchValues:
        """Evaluate the programme; see `Evaluator`."""
        n, count, scale = self.size, len(x), p[:, :1]
        of_rows = multipliers[:, n:]
        positions = [np.broadcast_to(axis, (count, len(axis))) for axis in (self.offsets, self.tabulated)]
        inputs = [*x.T[:, :, None], *p.T[:, :, None], *positions]
        residuals = self._residuals(*inputs).reshape(self.width, -1, count, len(self.offsets))
        error, first, second = residuals[:, 0], residuals[:, 1 : 1 + n], residuals[:, 1 + n :]
        limits = self._limits(*x.T, *p.T, *of_rows[:, : self.limits].T).reshape(-1, count)
        rows, slopes = limits[: self.limits].T, limits[self.limits : self.limits * (1 + n)].T.reshape(count, -1, n)
        bent = limits[self.limits * (1 + n) :]
        if self.minimax:
            objective = np.max(np.abs(error), axis=(0, 2))
            gradient = np.zeros((count, n))
            gradient[:, -1] = 1.0 / scale[:, 0]
            signed = np.stack([-error[0], error[-1]], axis=-1)
            steep = np.stack([-first[0], first[-1]], axis=-1)  # (n, points, positions, 2)
            steep[-1] += 1.0
            rows = np.concatenate([rows, (x[:, -1:] + signed.reshape(count, -1)) / scale], axis=1)
            slopes = np.concatenate([slopes, np.moveaxis(steep, 0, -1).reshape(count, -1, n) / scale[:, :, None]], axis=1)
            weights = (of_rows[:, self.limits :] / scale).reshape(count, -1, 2)
            bent = bent + np.sum(weights[..., 1] * second[-1] - weights[..., 0] * second[0], axis=-1)
        else:
            mean = len(self.offsets) if self.nlp.measure.name == "rms" else 1
            total = np.sum(np.sum(error * error, axis=-1), axis=0)
            objective = np.sqrt(total / mean) if mean > 1 else total
            factor = 2.0 / (mean * scale[:, 0])
            gradient = (factor * np.sum(np.sum(error[:, None] * first, axis=-1), axis=0)).T
            bent = bent + factor * np.array(
                [
                    np.sum(np.sum(first[:, i] * first[:, j] + error * second[:, k], axis=-1), axis=0)
                    for k, (i, j) in enumerate(self.pairs)
                ]
            )
        hessian = np.empty((count, n, n))
        for k, (i, j) in enumerate(self.pairs):
            hessian[:, i, j] = hessian[:, j, i] = bent[k]
        unit = np.broadcast_to(np.eye(n), (count, n, n))
        values, jacobian = np.concatenate([x, rows], axis=1), np.concatenate([unit, slopes], axis=1)
        return BatchValues(objective, gradient, values, jacobian, hessian)
