"""Evaluate a design problem for many designs at once: least-squares residuals, limits and exact derivatives."""

from __future__ import annotations

import copy
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from typing import Any

import casadi
import numpy as np
from numpy.typing import NDArray

from optlink.linkage.dyads import ModalDyad
from optlink.linkage.fourbar import LENGTHS
from optlink.linkage.mechanism import Mechanism
from optlink.linkage.vector2d import TURN, Array
from optlink.optimization.parameters import path_variable
from optlink.optimization.terms import position_rows, region_rows, rows as limit_rows
from optlink.problem.base_model import RESERVED
from optlink.problem.design import DesignProblem
from optlink.problem.limits import MARGIN_KEYS, Reach
from optlink.problem.mechanism import FourBarSection
from optlink.problem.quantity import Quantity
from optlink.problem.requirements.base import START
from optlink.symbolic import NumpyEvaluator, symbols_in_numpy

Variant = int | NDArray[np.int_]

GRID = 24  # crank angles at which the closure of mechanisms other than four-bars is evaluated
INSIDE = 1e-3  # margin inside the crank condition: on its boundary lies a change-point linkage
STRUCTURAL = {"limits.crank", *MARGIN_KEYS}
WEIGHT = 10.0  # of a limit violation relative to the residuals; the NLP that refines the designs has exact limits


class Batch:
    """Residuals of many designs of one problem with definite assembly modes, and of `others` that differ in these alone.

    `x` (designs, n) are the scaled design variables, `t` (designs, points) the crank angles [rad] of the points. With prescribed
    timing the crank angles follow from x, and `free_timing` is False; `start` is the design variable from which they count, -1 if
    there is none. The designs may differ in their assembly modes: `variant` (designs,) is the index of each in `problems`.
    """

    def __init__(self, problem: DesignProblem, others: Sequence[DesignProblem] = ()) -> None:
        self.problem, self.data = problem, problem.data
        self.problems = (problem, *others)
        self.names = problem.free
        self.variables = [path_variable(problem, name) for name in self.names]
        self.free_timing = self.data.offsets is None
        self.start = self.names.index(problem.start_name) if problem.start_name in self.names else -1
        derived = problem.complete({}).keys() - problem.quantities.keys()  # follow from others, by the modes
        self.derived = bool(derived) or problem.start_name in problem.links
        bounds = np.array([problem.quantities[name].bounds for name in self.names]).reshape(-1, 2)
        self.origin = np.array([v.origin for v in self.variables])
        self.scale = np.array([v.size for v in self.variables])
        self.low, self.high = ((side - self.origin) / self.scale for side in bounds.T)
        self.crank_turns = problem.limits.crank != "span"
        per_group: Iterable[tuple[Any, ...]] = zip(*(each.linkage.groups for each in self.problems), strict=True)
        modal = [groups for groups in per_group if isinstance(groups[0], ModalDyad) and len({g.side for g in groups}) > 1]
        self.sides = np.array([[g.side for g in groups] for groups in modal], dtype=float).T
        self.side_symbols = {} if self.derived else {groups[0].joint: casadi.SX.sym(groups[0].joint) for groups in modal}
        self._trace()

    def linkage(self, problem: DesignProblem) -> Mechanism:
        """Return the linkage of a problem, with symbols for the assembly modes that differ between the designs."""
        linkage, symbols = problem.linkage, self.side_symbols
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
        if self.derived:
            one = slice(variant, variant + 1)
            batch._residual, batch._value, batch._begin = self._residual[one], self._value[one], self._begin[one]
            batch._grid = self._grid[one]
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
        """Trace the functions: once with symbols for the assembly modes, or for each of them if values are derived from them.

        A limit may always depend on the modes otherwise than by the positions.
        """
        problem, n = self.problem, len(self.names)
        x = casadi.SX.sym("x", n)
        free = {v.name: v.value(x[i]) for i, v in enumerate(self.variables)}
        self._residual, self._value, self._begin = list[NumpyEvaluator](), list[NumpyEvaluator](), list[NumpyEvaluator]()
        self._limits, self._grid = list[NumpyEvaluator](), list[NumpyEvaluator]()
        with symbols_in_numpy():
            for k, each in enumerate(self.problems):
                values = each.complete(free)
                if self.derived or k == 0:
                    self._trace_positions(each, x, values)
                t, span = casadi.SX.sym("t"), casadi.SX.sym("span")
                reach = Reach(t, span, casadi.sign(span))
                rows = limit_rows(each, values, reach, each.size) if self.crank_turns or not each.four_bar else []
                if rows:
                    g = casadi.vertcat(*[row.value for row in rows])
                    self._limits.append(NumpyEvaluator([*casadi.vertsplit(x), t, span], [g, casadi.jacobian(g, x)]))
                self.bounds = np.array([(row.low + INSIDE * (row.limit in STRUCTURAL), row.high) for row in rows]).reshape(-1, 2)
        self.angles = np.linspace(*problem.linkage.extent, GRID, endpoint=problem.linkage.limits is not None)
        self.timed = 0.0 if problem.timing != "from start" else 1.0

    def _trace_positions(self, problem: DesignProblem, x: Any, values: dict[str, Any]) -> None:
        """Trace what depends on the positions of the linkage of a problem."""
        t, more = casadi.SX.sym("t"), casadi.SX.sym("more", self.data.columns.shape[1] + 1)
        inputs, sides = casadi.vertsplit(x), list(self.side_symbols.values())
        *target, weight = casadi.vertsplit(more)
        pose = self.linkage(problem).at(values, t)
        residual = casadi.vertcat(*problem.deviation(pose, values, tuple(target))) * (weight / problem.whole)
        self.width = int(residual.numel())
        slopes = casadi.jacobian(residual, casadi.vertcat(x, t))
        arguments = [*inputs, t, *target, weight, *sides]
        self._residual.append(NumpyEvaluator(arguments, [residual, slopes]))
        self._value.append(NumpyEvaluator(arguments, [residual]))
        if self.derived:
            begin = casadi.SX(values[problem.start_name])
            self._begin.append(NumpyEvaluator(inputs, [begin, casadi.jacobian(begin, x)]))
        required = [] if problem.four_bar else [row for row in position_rows(problem, pose) if not row.over_span]
        required += region_rows(problem, pose, over_span=False)
        if self.crank_turns and required:
            self.grid_bounds = np.array([(row.low + INSIDE, row.high) for row in required])
            g = casadi.vertcat(*[row.value for row in required])
            self._grid.append(NumpyEvaluator([*inputs, t, *sides], [g, casadi.jacobian(g, x)]))

    def values(self, x: Array) -> dict[str, Array]:
        """Return the quantities [SI] of designs, each an array (designs, 1); those of the first assembly modes."""
        real = self.origin + x * self.scale
        full = self.problem.complete({name: real[:, i : i + 1] for i, name in enumerate(self.names)})
        return {name: value + np.zeros((len(x), 1)) for name, value in full.items()}

    def _started(self, x: Array, variant: Variant) -> Array:
        """Return the derived start of designs and its derivatives, (1 + n, designs)."""
        out = np.empty((1 + x.shape[1], len(x)))
        for chosen, k in self._groups(self._begin, len(x), variant):
            out[:, chosen] = self._begin[k](*x[chosen].T)
        return out

    @staticmethod
    def _groups(evaluators: list[NumpyEvaluator], count: int, variant: Variant) -> Iterator[tuple[NDArray[np.intp], int]]:
        """Yield the indices of designs with the same assembly modes, and the index of their functions."""
        for k in range(len(evaluators)):
            chosen = np.flatnonzero(np.broadcast_to(variant, count) == k) if len(evaluators) > 1 else np.arange(count)
            if chosen.size:
                yield chosen, k

    def crank_angles(self, x: Array, t: Array, variant: Variant = 0) -> Array:
        """Return the crank angles of the points (designs, points) [rad]: `t` itself where the timing is free."""
        if self.free_timing:
            return t
        assert self.data.offsets is not None
        if self.derived:
            return np.asarray(self._started(x, variant)[0][:, None] + self.data.offsets)
        fixed = self.problem.quantities.get(self.problem.start_name)
        begin = x[:, self.start : self.start + 1] if self.start >= 0 else np.full((len(x), 1), fixed.value if fixed else 0.0)
        return begin * self.timed + self.data.offsets

    def residuals(self, x: Array, t: Array, variant: Variant = 0) -> tuple[Array, Array, Array]:
        """Return residuals (designs, points, k) and their derivatives by x (..., k, n) and by the crank angle (..., k).

        Residuals are relative to the size of the curve.
        """
        n, k = x.shape[1], self.width
        out = self._at_positions(self._residual, x, t, variant)
        r = np.moveaxis(out[:k], 0, -1)
        slopes = np.moveaxis(out[k:].reshape(n + 1, k, *t.shape), (0, 1), (-1, -2))
        by_x, by_t = slopes[..., :n], slopes[..., n]
        if not self.free_timing and self.derived:
            by_x = by_x + by_t[..., None] * self._started(x, variant)[1:].T[:, None, None, :]
        elif not self.free_timing and self.start >= 0:
            by_x = by_x.copy()
            by_x[..., self.start] += by_t
        return r, by_x, by_t

    def residual_values(self, x: Array, t: Array, variant: Variant = 0) -> Array:
        """Return the residuals (designs, points, k) without their derivatives; see `residuals`."""
        return np.moveaxis(self._at_positions(self._value, x, t, variant), 0, -1)

    def _at_positions(self, evaluators: list[NumpyEvaluator], x: Array, t: Array, variant: Variant) -> Array:
        """Return functions of the position (outputs, designs, points) at the crank angles t."""
        shared = [*self.data.columns.T, self.data.roots]
        if len(evaluators) == 1:
            return evaluators[0](*x.T[..., None], t, *shared, *self.side_columns(variant))
        out = np.empty((evaluators[0].outputs, *t.shape))
        for chosen, k in self._groups(evaluators, len(x), variant):
            out[:, chosen] = evaluators[k](*x[chosen].T[..., None], t[chosen], *shared)
        return out

    def violations(self, x: Array, t: Array, variant: Variant = 0) -> tuple[Array, Array]:
        """Return weighted limit violations (designs, rows), zero where satisfied, and their derivatives (designs, rows, n)."""
        n = x.shape[1]
        parts = []
        if self._limits:
            first, span = t[:, :1], t[:, -1:] - t[:, :1]
            out = np.empty((self._limits[0].outputs, len(x)))
            for chosen, k in self._groups(self._limits, len(x), variant):
                out[:, chosen] = self._limits[k](*x[chosen].T[..., None], first[chosen], span[chosen])[..., 0]
            parts.append((out, self.bounds))
        if self._grid:
            out = np.empty((self._grid[0].outputs, len(x), len(self.angles)))
            for chosen, k in self._groups(self._grid, len(x), variant):
                sides = self.side_columns(variant)
                out[:, chosen] = self._grid[k](*x[chosen].T[..., None], self.angles[None, :], *sides)
            rows = out.transpose(0, 2, 1).reshape(-1, len(x))
            parts.append((rows, np.repeat(self.grid_bounds, len(self.angles), axis=0)))
        if not parts:
            return np.zeros((len(x), 0)), np.zeros((len(x), 0, n))
        excesses = [self._excess(out, bounds, n) for out, bounds in parts]
        return np.concatenate([h for h, _ in excesses], axis=1), np.concatenate([s for _, s in excesses], axis=1)

    @staticmethod
    def _excess(out: Array, bounds: Array, n: int) -> tuple[Array, Array]:
        m = len(bounds)
        g, slopes = out[:m].T, out[m:].reshape(n, m, -1).transpose(2, 1, 0)
        with np.errstate(invalid="ignore"):
            miss = np.minimum(g - bounds[:, 0], 0.0) + np.maximum(g - bounds[:, 1], 0.0)
        off = ~np.isfinite(miss) | (miss == 0.0)
        off_slopes = off[..., None] | ~np.isfinite(slopes)  # where pivots coincide, the length of the frame has none
        return np.where(off, 0.0, WEIGHT * miss), np.where(off_slopes, 0.0, WEIGHT * slopes)


# Search a four-bar between free pivots by its lengths, the direction of its frame, and crank angles from the frame.
#
# A rotation of the linkage changes one of these unknowns, and both coordinates of the rocker pivot and every crank angle
# otherwise: least squares converge from far more starting points.

SHORTEST = 1e-3  # of the size of the curve: least length of a frame that has none


class ByLengths:
    """A problem, and the same one of a four-bar by its lengths, `problem`: None if the linkage cannot be written so.

    All coordinates of its pivots and of a point on its coupler are free, and the crank angles of the points, or their start.
    """

    def __init__(self, stated: DesignProblem) -> None:
        self.stated, loop, free = stated, stated.four_bar, set(stated.free)
        self.problem: DesignProblem | None = None
        mark = None if loop is None else stated.linkage.marks.get((loop.coupler.body, stated.point))
        if loop is None or mark is None or loop.frame_length or loop.coupler.start != loop.pin:
            return
        timed = stated.data.offsets is None or START in free
        limits, named = stated.limits, stated.point in {*"ABCD", *LENGTHS, *RESERVED}
        if not timed or named or not set(loop.ground) <= free or stated.links or stated.robust is not None:
            return
        if limits.regions or loop.joint != "C":
            return
        quantities, (along, across) = stated.quantities, (str(mark.along), str(mark.across))
        if not {along, across} <= quantities.keys():
            return
        low, high = stated.frame_bounds if limits.frame_length is None else limits.frame_length.bounds
        low, high = max(low, stated.frame_bounds[0], SHORTEST * stated.size), min(high, stated.frame_bounds[1])
        ax, ay = (quantities[name] for name in loop.ground[:2])
        bars: dict[str, Any] = {name: quantities[size] for name, size in zip(LENGTHS, loop.names, strict=False)}
        section = FourBarSection.model_construct(
            **bars,
            frame=Quantity(0.5 * (low + high), "length", "mm", low, high),
            points={stated.point: (quantities[along], quantities[across])},
            pivot=(ax, ay),
            direction=Quantity(0.0, "angle", "deg", -math.pi, math.pi),
            assembly="left" if loop.side > 0 else "right",
        )
        fields: dict[str, Any] = {name: getattr(stated, name) for name in type(stated).model_fields}
        drive = stated.drive.model_copy(update={"body": None})
        kept = limits.model_copy(update={"frame_length": None})
        self.problem = type(stated).model_construct(**(fields | {"mechanism": section, "drive": drive, "limits": kept}))
        self.names = dict(zip(loop.names, LENGTHS, strict=False)) | dict(zip(loop.ground[:2], ("A.x", "A.y"), strict=True))
        self.names |= {along: f"{stated.point}.along", across: f"{stated.point}.across"}
        self.pivot = loop.ground[2:]

    def stated_design(self, x: Array, t: Array) -> tuple[Array, Array]:
        """Return the scaled variables (designs, n) and crank angles (designs, points) [rad] of the stated problem."""
        assert self.problem is not None
        stated, problem = self.stated, self.problem
        values = {name: path_variable(problem, name).value(x[:, i]) for i, name in enumerate(problem.free)}
        frame, direction = values["frame"], values["direction"]
        values[self.pivot[0]] = values["A.x"] + frame * np.cos(direction)
        values[self.pivot[1]] = values["A.y"] + frame * np.sin(direction)
        if START in values:
            values[START] = np.remainder(values[START] + direction + math.pi, TURN) - math.pi
        y = np.empty_like(x)
        for i, name in enumerate(stated.free):
            low, high = stated.quantities[name].bounds
            y[:, i] = path_variable(stated, name).scaled(np.clip(values[self.names.get(name, name)], low, high))
        return y, t + direction[:, None] if stated.data.offsets is None else t
