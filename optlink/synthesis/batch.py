"""Evaluate a path or motion synthesis problem for many designs at once: least-squares residuals, limits and exact derivatives."""

from __future__ import annotations

import copy
import math
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any

import casadi
import numpy as np
from numpy.typing import NDArray

from optlink.linkage.dyad_types import ModalDyad
from optlink.linkage.mechanism import Mechanism
from optlink.linkage.vector2d import TURN, Array, unit
from optlink.optimization.constraints import position_rows, rows as limit_rows
from optlink.optimization.programme import path_variable
from optlink.problem.design import DesignProblem
from optlink.problem.limits import MARGIN_KEYS, Reach
from optlink.problem.mechanism import FourBarSection
from optlink.problem.requirement import START
from optlink.symbolic import NumpyEvaluator, symbols_in_numpy

Variant = int | NDArray[np.int_]

GRID = 24  # crank angles at which the closure of mechanisms other than four-bars is evaluated
INSIDE = 1e-3  # margin inside the crank condition: on its boundary lies a change-point linkage
STRUCTURAL = {"limits.crank", *MARGIN_KEYS}
WEIGHT = 10.0  # of a limit violation relative to the residuals; the NLP that refines the designs has exact limits


class Batch:
    """Residuals of many designs of one problem with definite assembly modes, and of `others` that differ in these alone.

    `x` (designs, n) are the scaled design variables, `t` (designs, points) the crank angles [rad] of the points. With prescribed
    timing the crank angles follow from x, and `free_timing` is False. The designs may differ in their assembly modes: `variant`
    (designs,) is the index of each in `problems`.
    """

    def __init__(self, problem: DesignProblem, others: Sequence[DesignProblem] = ()) -> None:
        self.problem, self.data = problem, problem.data
        self.problems = (problem, *others)
        self.names = problem.free
        self.variables = [path_variable(problem, name) for name in self.names]
        self.free_timing = self.data.offsets is None
        self.start = self.names.index(START) if START in self.names else -1
        bounds = np.array([problem.quantities[name].bounds for name in self.names]).reshape(-1, 2)
        self.origin = np.array([v.origin for v in self.variables])
        self.scale = np.array([v.size for v in self.variables])
        self.low, self.high = ((side - self.origin) / self.scale for side in bounds.T)
        self.four_bar = isinstance(problem.mechanism, FourBarSection)
        self.crank_turns = problem.limits.crank != "span"
        per_group: Iterable[tuple[Any, ...]] = zip(*(each.linkage.groups for each in self.problems), strict=True)
        modal = [groups for groups in per_group if isinstance(groups[0], ModalDyad) and len({g.side for g in groups}) > 1]
        self.sides = np.array([[g.side for g in groups] for groups in modal], dtype=float).T
        self.side_symbols = {groups[0].joint: casadi.SX.sym(groups[0].joint) for groups in modal}
        self._trace()

    def linkage(self) -> Mechanism:
        """Return the linkage, with symbols for the assembly modes that differ between the designs."""
        linkage, symbols = self.problem.linkage, self.side_symbols
        dyads: tuple[Any, ...] = linkage.groups
        groups = [replace(g, side=symbols[g.joint]) if g.joint in symbols else g for g in dyads]
        return replace(linkage, groups=tuple(groups)) if symbols else linkage

    def side_columns(self, variant: Variant) -> list[Array]:
        """Return the assembly modes of designs that differ in them, one array per symbol."""
        if not self.side_symbols:
            return []
        return list(self.sides[variant].T[..., None] if np.ndim(variant) else self.sides[variant])

    def of_variant(self, variant: int) -> Batch:
        """Return the same functions for designs with one choice of the assembly modes."""
        batch = copy.copy(self)
        batch.problem, batch.problems = self.problems[variant], (self.problems[variant],)
        batch.sides, batch._limits = self.sides[variant : variant + 1], self._limits[variant : variant + 1]
        return batch

    def thinned(self, most: int) -> tuple[Batch, Array]:
        """Return the batch with at most `most` points, and the matrix (points, all points) that interpolates all crank angles.

        The retained points are spread evenly over the list; crank angles between them are interpolated by the distances of the
        points.
        """
        data, count = self.data, len(self.data.columns)
        if count <= most:
            return self, np.eye(count)
        pick = np.unique(np.linspace(0, count - 1, most).round().astype(int))
        thin = copy.copy(self)
        roots = data.roots[pick] * math.sqrt(count / len(pick))
        offsets = None if data.offsets is None else data.offsets[pick]
        thin.data = replace(data, columns=data.columns[pick], roots=roots, offsets=offsets, tolerances=data.tolerances[pick])
        chords = np.linalg.norm(np.diff(data.columns[:, :2], axis=0), axis=1)
        way = np.concatenate([[0.0], np.cumsum(chords + 1e-6 * self.problem.size)])
        return thin, np.array([np.interp(way, way[pick], row) for row in np.eye(len(pick))])

    def _trace(self) -> None:
        problem, n, width = self.problem, len(self.names), self.data.columns.shape[1]
        x, t, more = casadi.SX.sym("x", n), casadi.SX.sym("t"), casadi.SX.sym("more", width + 1)
        inputs, sides = casadi.vertsplit(x), list(self.side_symbols.values())
        *target, weight = casadi.vertsplit(more)
        with symbols_in_numpy():
            values = problem.complete({v.name: v.value(x[i]) for i, v in enumerate(self.variables)})
            pose = self.linkage().pose(values, unit(t))
            residual = casadi.vertcat(*problem.deviation(pose, values, tuple(target))) * (weight / problem.whole)
            self.width = int(residual.numel())
            slopes = casadi.jacobian(residual, casadi.vertcat(x, t))
            arguments = [*inputs, t, *target, weight, *sides]
            self._residual, self._value = (NumpyEvaluator(arguments, outputs) for outputs in ([residual, slopes], [residual]))
            self._begin = None  # a linked start of the crank angles, and its derivatives
            if START in problem.links:
                begin = values[START]
                self._begin = NumpyEvaluator(inputs, [begin, casadi.jacobian(begin, x)])
            span = casadi.SX.sym("span")
            reach = Reach(t, span, casadi.sign(span))
            self._limits = []
            for each in self.problems:  # a limit may depend on the assembly mode otherwise than by the positions
                rows = limit_rows(each, values, reach, problem.size) if self.crank_turns or not self.four_bar else []
                self.bounds = np.array([(row.low + INSIDE * (row.limit in STRUCTURAL), row.high) for row in rows]).reshape(-1, 2)
                g = casadi.vertcat(*[row.value for row in rows])
                self._limits += [NumpyEvaluator([*inputs, t, span], [g, casadi.jacobian(g, x)])] if rows else []
            self._grid = None
            if self.crank_turns and not self.four_bar:
                required = [row for row in position_rows(problem, pose) if not row.over_span]
                self.grid_bounds = np.array([(row.low + INSIDE, row.high) for row in required])
                g = casadi.vertcat(*[row.value for row in required])
                self._grid = NumpyEvaluator([*inputs, t, *sides], [g, casadi.jacobian(g, x)])
        self.angles = np.linspace(0.0, TURN, GRID, endpoint=False)

    def values(self, x: Array) -> dict[str, Array]:
        """Return the quantities [SI] of designs, each an array (designs, 1)."""
        real = self.origin + x * self.scale
        with np.errstate(all="ignore"):
            values = self.problem.complete({name: real[:, i : i + 1] for i, name in enumerate(self.names)})
        return {name: value + np.zeros((len(x), 1)) for name, value in values.items()}

    def crank_angles(self, x: Array, t: Array) -> Array:
        """Return the crank angles of the points (designs, points) [rad]: `t` itself where the timing is free."""
        if self.free_timing:
            return t
        assert self.data.offsets is not None
        begin = self._begin(*x.T[..., None])[0] if self._begin else x[:, self.start : self.start + 1]
        if self._begin is None and self.start < 0:
            begin = np.full((len(x), 1), self.problem.quantities[START].value if START in self.problem.quantities else 0.0)
        return begin + self.data.offsets

    def residuals(self, x: Array, t: Array, variant: Variant = 0) -> tuple[Array, Array, Array]:
        """Return residuals (designs, points, k) and their derivatives by x (..., k, n) and by the crank angle (..., k).

        Residuals are relative to the size of the curve.
        """
        n, k = x.shape[1], self.width
        out = self._residual(*self._columns(x, t, variant))
        r = np.moveaxis(out[:k], 0, -1)
        slopes = np.moveaxis(out[k:].reshape(n + 1, k, *t.shape), (0, 1), (-1, -2))
        by_x, by_t = slopes[..., :n], slopes[..., n]
        if self._begin:
            by_x = by_x + by_t[..., None] * np.moveaxis(self._begin(*x.T[..., None])[1:], 0, -1)[..., None, :]
        elif not self.free_timing and self.start >= 0:
            by_x = by_x.copy()
            by_x[..., self.start] += by_t
        return r, by_x, by_t

    def residual_values(self, x: Array, t: Array, variant: Variant = 0) -> Array:
        """Return the residuals (designs, points, k) without their derivatives; see `residuals`."""
        return np.moveaxis(self._value(*self._columns(x, t, variant)), 0, -1)

    def _columns(self, x: Array, t: Array, variant: Variant) -> list[Array]:
        """Return the inputs of the residuals."""
        return [*x.T[..., None], t, *self.data.columns.T, self.data.roots, *self.side_columns(variant)]

    def violations(self, x: Array, t: Array, variant: Variant = 0) -> tuple[Array, Array]:
        """Return weighted limit violations (designs, rows), zero where satisfied, and their derivatives (designs, rows, n)."""
        n = x.shape[1]
        parts = []
        if self._limits:
            parts.append((self._limit_values(x, t, variant), self.bounds))
        if self._grid is not None:
            out = self._grid(*x.T[..., None], self.angles[None, :], *self.side_columns(variant))
            rows = out.transpose(0, 2, 1).reshape(-1, len(x))
            parts.append((rows, np.repeat(self.grid_bounds, len(self.angles), axis=0)))
        if not parts:
            return np.zeros((len(x), 0)), np.zeros((len(x), 0, n))
        excesses = [self._excess(out, bounds, n) for out, bounds in parts]
        return np.concatenate([h for h, _ in excesses], axis=1), np.concatenate([s for _, s in excesses], axis=1)

    def _limit_values(self, x: Array, t: Array, variant: Variant) -> Array:
        """Return the limits and their derivatives (rows, designs)."""
        first, span = t[:, :1], t[:, -1:] - t[:, :1]
        out = np.empty((self._limits[0].outputs, len(x)))
        for k, evaluate in enumerate(self._limits):
            chosen = np.flatnonzero(np.broadcast_to(variant, len(x)) == k)
            if chosen.size:
                out[:, chosen] = evaluate(*x[chosen].T[..., None], first[chosen], span[chosen])[..., 0]
        return out

    @staticmethod
    def _excess(out: Array, bounds: Array, n: int) -> tuple[Array, Array]:
        m = len(bounds)
        g, slopes = out[:m].T, out[m:].reshape(n, m, -1).transpose(2, 1, 0)
        with np.errstate(invalid="ignore"):
            miss = np.minimum(g - bounds[:, 0], 0.0) + np.maximum(g - bounds[:, 1], 0.0)
        off = ~np.isfinite(miss) | (miss == 0.0)
        return np.where(off, 0.0, WEIGHT * miss), np.where(off[..., None], 0.0, WEIGHT * slopes)
