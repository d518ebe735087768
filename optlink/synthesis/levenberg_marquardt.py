"""Levenberg-Marquardt for many designs at once; the crank angle of each point is an unknown that is eliminated exactly.

The crank angles are eliminated by the Schur complement of their diagonal block, as in bundle adjustment.

References
----------
D. W. Marquardt, An algorithm for least-squares estimation of nonlinear parameters, J. SIAM 11 (1963).
M. K. Transtrum, J. P. Sethna, Improvements to the Levenberg-Marquardt algorithm for nonlinear least-squares minimization,
arXiv:1201.5885 (2012), section 4: the second-order correction of the step (geodesic acceleration).
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterable
from dataclasses import dataclass

import casadi
import numpy as np
from numpy.typing import NDArray

from optlink.linkage.mechanism import FRAME
from optlink.linkage.vector2d import TURN, Array, minus, unit
from optlink.problem.requirements.base import START
from optlink.symbolic import NumpyEvaluator, symbols_in_numpy
from optlink.synthesis.batch import Batch, Variant

# Constants of the descents in batches.
# What a search finds, and how much longer it takes, if one of them is halved or doubled: docs/constants.md.
FIRST_DAMPING = 1e-2  # share of the diagonal of the normal equations
LEAST_DAMPING, MOST_DAMPING = 1e-14, 1e9  # least: rounding error of that diagonal; at the largest a design ends
SLOW = 1e-5  # relative decrease of the cost below which a step counts as slow
PATIENCE = 4  # consecutive slow steps that terminate a design
POOR, HOPELESS = 4.0, 1e-3  # times the cost of a good design: a poor one, and the decrease that counts as slow for it
LONGEST_TURN = 0.5  # rad per step of a crank angle
PROBE = 0.1  # share of a step at which the residuals show their second derivative
MOST_BEND = 0.75  # largest correction of a step by the second derivative, relative to the step
ZERO = 1e-28  # cost (square of a fraction of the curve size) that counts as zero

Fit = Callable[[Array, Array, NDArray[np.int_]], tuple[Array, Array]]


@dataclass(frozen=True)
class FinalDesigns:
    """Final designs: x (designs, n), crank angles (designs, points); cost, weighted limit violations, number of starts."""

    x: Array
    t: Array
    cost: Array
    missed: Array
    count: NDArray[np.int_]

    def take(self, keep: NDArray[np.intp]) -> FinalDesigns:
        """Return a selection of the designs."""
        return FinalDesigns(*(values[keep] for values in vars(self).values()))


@dataclass
class _State:
    """Designs that have not terminated."""

    index: NDArray[np.intp]
    variant: NDArray[np.int_]
    group: NDArray[np.int_]
    x: Array
    t: Array
    r: Array
    by_x: Array
    by_t: Array
    h: Array
    by_h: Array
    cost: Array
    damping: Array
    slow: Array

    def take(self, keep: NDArray[np.bool_]) -> _State:
        """Return a selection of the designs."""
        return _State(*(values[keep] for values in vars(self).values()))


def _look(batch: Batch, x: Array, t: Array, variant: NDArray[np.int_]) -> dict[str, Array]:
    """Return designs with their residuals, limit violations, derivatives and cost, as fields of a `_State`."""
    angles = batch.crank_angles(x, t, variant)
    r, by_x, by_t = batch.residuals(x, angles, variant)
    h, by_h = batch.violations(x, angles, variant)
    cost = np.einsum("bpk,bpk->b", r, r) + np.einsum("bm,bm->b", h, h)
    smooth = np.isfinite(cost) & np.isfinite(by_x.sum(axis=(1, 2, 3)) + by_t.sum(axis=(1, 2)))  # none where modes meet
    cost = np.where(smooth, cost, np.inf)
    return {"x": x, "t": t, "r": r, "by_x": by_x, "by_t": by_t, "h": h, "by_h": by_h, "cost": cost}


def minimise(
    batch: Batch,
    x: Array,
    t: Array,
    steps: int,
    fit: Fit | None = None,
    linear: list[int] | None = None,
    *,
    variant: NDArray[np.int_] | None = None,
    group: NDArray[np.int_] | None = None,
    slow: float = SLOW,
    zero: float = ZERO,
    left: float = 0.0,
    after: int | None = None,
    good: int | None = None,
) -> FinalDesigns:
    """Minimise the sum of squares of residuals and limit violations for every design separately.

    Parameters
    ----------
    x : array (designs, n)
        Scaled starting points; those without a finite cost are returned unchanged, with an infinite cost.
    t : array (designs, points) [rad]
        Crank angles of the starting points.
    steps : int
        Largest number of steps.
    fit : function (x, crank angles, variant) to (x, crank angles), optional
        Sets the linear variables to their optimum at every step (variable projection); fits outside the bounds are rejected.
    linear : list of int, optional
        Indices of the linear variables.
    variant : array (designs,) of int, optional
        Index of the assembly modes of each design in `batch.problems`. Default: the first.
    group : array (designs,) of int, optional
        Index of the group of each design, from zero: `left` and `after` hold within a group, so that the result of a design does
        not depend on the other groups. Default: one group.
    slow : float
        Relative decrease of the cost below which a step counts as slow.
    zero : float
        Cost at which a design counts as exact.
    left : float
        Share of the designs of a group that may remain unconverged: all stop once no more than this share remains.
    after : int, optional
        Steps that remain for all designs of a group once one has reached `zero`.
    good : int, optional
        Number of designs of a group that matter: one with more than `POOR` times the cost of the last of them ends as soon as its
        cost falls by less than `HOPELESS` per step, because the steps that are left cannot make it one of them.
    """
    n = x.shape[1]
    variant = np.zeros(len(x), dtype=int) if variant is None else variant
    group = np.zeros(len(x), dtype=int) if group is None else group
    weight = np.ones(n)
    if fit is not None and linear:
        weight[linear] = 1e-6  # the fit overrides their step: damping them would only slow the other variables
    end_x, end_t = x.copy(), t.copy()
    end_cost, end_missed = np.full(len(x), np.inf), np.full(len(x), np.inf)
    with np.errstate(all="ignore"):
        seen = _look(batch, x, t, variant)
    cost = seen["cost"]
    damping, steady = np.full(len(x), FIRST_DAMPING), np.zeros(len(x), dtype=int)
    state = _State(np.arange(len(x)), variant, group, **seen, damping=damping, slow=steady).take(np.isfinite(cost))
    members = np.bincount(group)
    last = np.full(len(members), steps)
    every, poor = np.where(np.isfinite(cost), cost, np.inf), np.full(len(members), np.inf)
    for step in range(steps + 1):
        none_left = state.cost <= zero
        if after is not None and none_left.any():
            exact = np.unique(state.group[none_left])
            last[exact] = np.minimum(last[exact], step + after)
        done = none_left | (state.slow >= PATIENCE) | (state.damping >= MOST_DAMPING)
        ended = (step >= last) | (np.bincount(state.group[~done], minlength=len(members)) <= left * members)
        done |= ended[state.group]
        if done.any():
            where = state.index[done]
            end_x[where], end_t[where], end_cost[where] = state.x[done], state.t[done], state.cost[done]
            end_missed[where] = np.einsum("bm,bm->b", state.h[done], state.h[done])
            state = state.take(~done)
        if not len(state.index):
            break
        if good is not None:
            every[state.index] = state.cost
            for k in np.flatnonzero(members > good):
                poor[k] = POOR * np.partition(every[group == k], good - 1)[good - 1]
        with np.errstate(all="ignore"):  # a step to an undefined position is rejected
            _advance(batch, state, weight, fit, np.where(state.cost > poor[state.group], HOPELESS, slow))
    return FinalDesigns(end_x, end_t, end_cost, end_missed, np.ones(len(x), dtype=int))


def _advance(batch: Batch, state: _State, weight: Array, fit: Fit | None, slow: Array) -> None:
    """Make one step for every design; accept it where it lowers the cost."""
    step, turn = _step(batch, state, weight)
    x = np.clip(state.x + step, batch.low, batch.high)
    t = state.t + np.clip(turn, -LONGEST_TURN, LONGEST_TURN) if batch.free_timing else state.t
    if fit is not None:
        fitted, turned = fit(x, batch.crank_angles(x, t, state.variant), state.variant)
        inside = np.all((fitted >= batch.low) & (fitted <= batch.high), axis=1)[:, None]
        x, t = np.where(inside, fitted, x), np.where(inside, turned, t) if batch.free_timing else t
    new = _look(batch, x, t, state.variant)
    cost = new["cost"]
    better = cost < state.cost
    decrease = np.where(better, (state.cost - np.where(better, cost, 0.0)) / np.maximum(state.cost, 1e-300), 0.0)
    state.slow = np.where(better & (decrease < slow), state.slow + 1, np.where(better, 0, state.slow))
    state.damping = np.where(better, np.maximum(0.2 * state.damping, LEAST_DAMPING), 6.0 * state.damping)
    for name, value in new.items():
        old = getattr(state, name)
        mask = better.reshape(-1, *[1] * (old.ndim - 1))
        setattr(state, name, value if better.all() else np.where(mask, value, old))


def _step(batch: Batch, state: _State, weight: Array) -> tuple[Array, Array]:
    """Return the steps of the variables (designs, n) and of free crank angles (designs, points), corrected to second order."""
    size, n = state.x.shape
    jacobian = state.by_x.reshape(size, -1, n)
    system = np.matmul(jacobian.transpose(0, 2, 1), jacobian) + np.matmul(state.by_h.transpose(0, 2, 1), state.by_h)
    diagonal = np.einsum("bii->bi", system)
    largest = np.max(diagonal, axis=1, keepdims=True)
    damp = state.damping[:, None] * weight * np.maximum(diagonal, 1e-8 * largest + 1e-300) + 1e-14 * largest + 1e-300
    system[:, np.arange(n), np.arange(n)] += damp
    block = mixed = np.zeros(0)
    if batch.free_timing:
        block = np.einsum("bpk,bpk->bp", state.by_t, state.by_t) * (1.0 + state.damping[:, None]) + 1e-300
        mixed = np.einsum("bpkn,bpk->bpn", state.by_x, state.by_t)
        system -= np.matmul((mixed / block[..., None]).transpose(0, 2, 1), mixed)

    def slopes(r: Array) -> tuple[Array, Array]:
        """Return the derivatives of half the squares by the variables and by the crank angles, which the former eliminate."""
        by_x, by_t = np.einsum("bqn,bq->bn", jacobian, r.reshape(size, -1)), np.einsum("bpk,bpk->bp", state.by_t, r)
        return (by_x - np.einsum("bpn,bp->bn", mixed, by_t / block), by_t) if batch.free_timing else (by_x, by_t)

    def turned(step: Array, slope: Array) -> Array:
        """Return the steps of the crank angles that belong to those of the variables."""
        return -(slope + np.einsum("bpn,bn->bp", mixed, step)) / block if batch.free_timing else np.zeros_like(state.t)

    slope, along = slopes(state.r)
    slope += np.einsum("bmn,bm->bn", state.by_h, state.h)
    step, active, system = _bounded_step(system, -slope, batch.low - state.x, batch.high - state.x)
    turn = turned(step, along)
    x = state.x + PROBE * step
    values = batch.residual_values(x, batch.crank_angles(x, state.t + PROBE * turn, state.variant), state.variant)
    linear = np.matmul(jacobian, step[..., None]).reshape(state.r.shape) + state.by_t * turn[..., None]
    slope, along = slopes(2.0 / PROBE * ((values - state.r) / PROBE - linear))  # of the second derivative along the step
    bend = np.asarray(np.linalg.solve(system, np.where(active, 0.0, -slope)[..., None])[..., 0], dtype=float)
    scale = np.sqrt(np.abs(np.einsum("bii->bi", system)))
    good = 2.0 * np.linalg.norm(scale * bend, axis=1) <= MOST_BEND * np.linalg.norm(scale * step, axis=1)
    half = np.where(good, 0.5, 0.0)[:, None]
    return step + half * np.where(good[:, None], bend, 0.0), turn + half * np.where(good[:, None], turned(bend, along), 0.0)


def _bounded_step(system: Array, right: Array, least: Array, most: Array) -> tuple[Array, NDArray[np.bool_], Array]:
    """Return steps (designs, n) within bounds, the variables that bounds determine, and the systems of the others.

    Variables at a bound that they would leave stay there; those that would pass a bound end at it, and the others follow.
    `system` and `right` are the damped normal equations; `least` is not positive, `most` not negative.
    """
    diagonal = np.arange(system.shape[1])
    active = ((least >= 0.0) & (right < 0.0)) | ((most <= 0.0) & (right > 0.0))
    step, reduced, left = np.zeros_like(right), np.empty_like(system), np.arange(len(right))
    while len(left):
        at_bound, matrix = active[left], system[left]
        part = np.where(at_bound[:, :, None] | at_bound[:, None, :], 0.0, matrix)
        part[:, diagonal, diagonal] += at_bound
        fixed = np.where(at_bound, step[left], 0.0)
        free = right[left] - np.einsum("bij,bj->bi", matrix, fixed)
        result = np.linalg.solve(part, np.where(at_bound, fixed, free)[..., None])[..., 0]
        low, high = least[left], most[left]
        hit = ~at_bound & ((result < low) | (result > high))
        step[left], active[left], reduced[left] = np.where(hit, np.clip(result, low, high), result), at_bound | hit, part
        left = left[hit.any(axis=1)]  # the others do not change any more
    return step, active, reduced


# Variable projection: position, size and direction of a linkage and its coupler point by linear least squares.
#
# As complex numbers the points of a body are P = a + w S + b u, with S the path of one of its joints and u its direction, both
# known from the proportions and the crank angles; a, w and b follow from linear least squares. The remaining nonlinear unknowns
# are the proportions (three numbers for a four-bar) and the crank angles.
#
# References
# ---------- G. H. Golub and V. Pereyra, The differentiation of pseudo-inverses and nonlinear least squares problems whose
# variables separate, SIAM J. Numer. Anal. 10 (1973).

Complex = NDArray[np.complex128]


class SimilarityFit:
    """Optimal position, direction and size of every design of a batch, and its optimal coupler point where that is free."""

    def __init__(self, batch: Batch) -> None:
        self.batch = batch
        problem = batch.problem
        names = list(batch.names)

        def indices(wanted: Iterable[str]) -> list[int]:
            return [names.index(name) for name in wanted if name in names]

        quantities = problem.mechanism.quantities
        mark = problem.linkage.marks.get((problem.body, problem.point))
        marks = () if mark is None else (str(mark.along), str(mark.across))
        self.point = indices(marks) if mark is not None and set(marks) <= set(names) else []
        ground = {name: q for name, q in quantities.items() if q.kind == "coordinate" and name.rpartition(".")[2] in ("x", "y")}
        angles = [name for name, q in quantities.items() if q.kind == "angle"]
        sizes = [
            name for name, q in quantities.items() if name not in ground and q.in_metres and (name not in marks or not self.point)
        ]
        on_frame = {f"{guide.name}.direction" for guide in problem.linkage.guides if guide.on == FRAME}
        turning = [name for name in angles if name in {"direction", *on_frame}]  # they turn with the frame
        self.lengths, self.turning = indices(sizes), indices(turning)
        bases = sorted({name.rpartition(".")[0] for name in ground})
        pivots = (indices((f"{base}.x", f"{base}.y")) for base in bases)
        self.ground = [(pivot[0], pivot[1]) for pivot in pivots if len(pivot) == 2]
        placed = getattr(problem.mechanism, "placed", True)
        free = [name for name in (*sizes, *ground, *turning) if name not in names and quantities[name].value != 0.0]
        bound = [name for name in (*ground, *turning) if name not in names]
        self.counted_from_x = problem.linkage.datum == 0.0
        timed = not batch.free_timing and batch.start < 0 and self.counted_from_x
        around = problem.linkage.limits is None and not problem.linkage.elements
        similar = around and placed and not (free or bound or problem.links)  # a link need not hold for a similar linkage
        self.applies = problem.requirement.kind == "path" and similar and not timed
        if self.applies:
            self._trace()

    def of(self, batch: Batch) -> SimilarityFit:
        """Return the same projection for a batch with fewer points, or with fewer assembly modes."""
        other = copy.copy(self)
        other.batch = batch
        return other

    def _trace(self) -> None:
        batch, problem = self.batch, self.batch.problem
        x, t = casadi.SX.sym("x", len(batch.names)), casadi.SX.sym("t")
        values = problem.complete({v.name: v.value(x[i]) for i, v in enumerate(batch.variables)})
        mechanism = batch.linkage(problem)
        with symbols_in_numpy():
            pose = mechanism.pose(values, unit(t))
            link = mechanism.link(problem.body)
            pivot = pose.point(mechanism.crank.start)
            at = pose.point(link.start if self.point else problem.point)
            arm, axis = minus(at, pivot), pose.direction(problem.body)
            outputs = [arm[0] / problem.size, arm[1] / problem.size, axis[0] + 0.0 * t, axis[1] + 0.0 * t]
            self._tape = NumpyEvaluator([*casadi.vertsplit(x), t, *batch.side_symbols.values()], outputs)
        self._pivot = [batch.names.index(f"{mechanism.crank.start}.{axis}") for axis in "xy"]

    def fit(self, x: Array, t: Array, variant: Variant = 0) -> tuple[Array, Array]:
        """Return designs with optimal linear variables, and their crank angles; designs without a finite fit stay unchanged."""
        batch = self.batch
        arm_x, arm_y, axis_x, axis_y = self._tape(*x.T[..., None], t, *batch.side_columns(variant))
        centre = np.array(batch.problem.centre)
        targets = ((batch.data.columns[:, 0] - centre[0]) + 1j * (batch.data.columns[:, 1] - centre[1])) / batch.problem.size
        arm, axis = arm_x + 1j * arm_y, axis_x + 1j * axis_y
        weights = batch.data.roots**2 / np.sum(batch.data.roots**2)

        def mean(z: Complex) -> Complex:
            return np.asarray((z * weights).sum(axis=-1, keepdims=True))

        with np.errstate(all="ignore"):
            s, u, z = arm - mean(arm), axis - mean(axis), targets - mean(targets)
            ss, sz = mean(s * s.conj()).real, mean(s.conj() * z)
            if self.point:
                uu, su, uz = mean(u * u.conj()).real, mean(s.conj() * u), mean(u.conj() * z)
                uu = uu + 1e-12
                w = (uu * sz - su * uz) / (ss * uu - np.abs(su) ** 2)
                b = (uz - su.conj() * w) / uu
            else:
                w, b = sz / ss, np.zeros_like(sz)
            a = mean(targets) - w * mean(arm) - b * mean(axis)
            size, turned = np.abs(w), w / np.abs(w)
            y = x.copy()
            pivot = x[:, self._pivot[0]] + 1j * x[:, self._pivot[1]]  # scaled, counted from the centre of the points
            for i, j in self.ground:
                place = a[:, 0] + w[:, 0] * (x[:, i] + 1j * x[:, j] - pivot)
                y[:, i], y[:, j] = place.real, place.imag
            y[:, self.lengths] *= size
            if self.point:
                local = (b / turned)[:, 0]
                y[:, self.point[0]], y[:, self.point[1]] = local.real, local.imag
            by = np.angle(turned)
            started = [batch.start] if self.counted_from_x and batch.start >= 0 else []
            turning = [*self.turning, *started]
            y[:, turning] = np.remainder(x[:, turning] + by + np.pi, TURN) - np.pi
            moved = t + by if self.counted_from_x and batch.free_timing else t
        good = np.all(np.isfinite(y), axis=1) & np.all(np.isfinite(moved), axis=1)
        return np.where(good[:, None], y, x), np.where(good[:, None], moved, t)

    @property
    def linear(self) -> list[int]:
        """Indices of the variables that follow from the others."""
        names = [*self.point, *self.turning, *(i for pair in self.ground for i in pair)]
        return [i for i in names if self.batch.names[i] != START]
