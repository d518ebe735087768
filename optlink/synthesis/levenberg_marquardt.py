"""Levenberg-Marquardt for many designs at once; the crank angle of each point is an unknown that is eliminated exactly.

The crank angles are eliminated by the Schur complement of their diagonal block, as in bundle adjustment.

References
----------
D. W. Marquardt, An algorithm for least-squares estimation of nonlinear parameters, J. SIAM 11 (1963).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from optlink.synthesis.batch import Batch

Array = NDArray[np.float64]
Fit = Callable[[Array, Array, NDArray[np.int_]], tuple[Array, Array]]

FIRST_DAMPING = 1e-2
LEAST_DAMPING, MOST_DAMPING = 1e-14, 1e9
SLOW = 1e-5  # relative decrease of the cost below which a step counts as slow
PATIENCE = 4  # consecutive slow steps that terminate a design
LONGEST_TURN = 0.5  # rad per step of a crank angle
ZERO = 1e-28  # cost (square of a fraction of the curve size) that counts as zero


@dataclass(frozen=True)
class FinalDesigns:
    """Final designs: x (designs, n), crank angles (designs, points), total cost and weighted limit violations (designs,)."""

    x: Array
    t: Array
    cost: Array
    missed: Array

    def take(self, keep: NDArray[np.intp]) -> FinalDesigns:
        """Return a selection of the designs."""
        return FinalDesigns(self.x[keep], self.t[keep], self.cost[keep], self.missed[keep])


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
        return _State(*(getattr(self, name)[keep] for name in self.__dataclass_fields__))


def _look(batch: Batch, x: Array, t: Array, variant: NDArray[np.int_]) -> tuple[Array, Array, Array, Array, Array, Array]:
    angles = batch.crank_angles(x, t)
    r, by_x, by_t = batch.residuals(x, angles, variant)
    h, by_h = batch.violations(x, angles, variant)
    cost = np.einsum("bpk,bpk->b", r, r) + np.einsum("bm,bm->b", h, h)
    smooth = np.isfinite(cost) & np.isfinite(by_x.sum(axis=(1, 2, 3)) + by_t.sum(axis=(1, 2)))  # none where modes meet
    return r, by_x, by_t, h, by_h, np.where(smooth, cost, np.inf)


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
) -> FinalDesigns:
    """Minimise the sum of squares of residuals and limit violations for every design separately.

    Parameters
    ----------
    batch : Batch
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
        r, by_x, by_t, h, by_h, cost = _look(batch, x, t, variant)
    damping, steady = np.full(len(x), FIRST_DAMPING), np.zeros(len(x), dtype=int)
    state = _State(np.arange(len(x)), variant, group, x, t, r, by_x, by_t, h, by_h, cost, damping, steady).take(np.isfinite(cost))
    members = np.bincount(group)
    last = np.full(len(members), steps)
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
        with np.errstate(all="ignore"):  # a step to an undefined position is rejected
            _advance(batch, state, weight, fit, slow)
    return FinalDesigns(end_x, end_t, end_cost, end_missed)


def _advance(batch: Batch, state: _State, weight: Array, fit: Fit | None, slow: float) -> None:
    """Make one step for every design; accept it where it lowers the cost."""
    size, n = state.x.shape
    jacobian = state.by_x.reshape(size, -1, n)
    normal = np.matmul(jacobian.transpose(0, 2, 1), jacobian) + np.matmul(state.by_h.transpose(0, 2, 1), state.by_h)
    slope = np.einsum("bqn,bq->bn", jacobian, state.r.reshape(size, -1)) + np.einsum("bmn,bm->bn", state.by_h, state.h)
    diagonal = np.einsum("bii->bi", normal)
    damp = weight * np.maximum(diagonal, 1e-8 * np.max(diagonal, axis=1, keepdims=True) + 1e-300)
    system = normal + (state.damping[:, None] * damp)[:, :, None] * np.eye(n)
    right = -slope
    if batch.free_timing:
        own = np.einsum("bpk,bpk->bp", state.by_t, state.by_t) * (1.0 + state.damping[:, None]) + 1e-300
        along = np.einsum("bpk,bpk->bp", state.by_t, state.r)
        mixed = np.einsum("bpkn,bpk->bpn", state.by_x, state.by_t)
        system = system - np.matmul((mixed / own[..., None]).transpose(0, 2, 1), mixed)
        right = right + np.einsum("bpn,bp->bn", mixed, along / own)
    held = ((state.x <= batch.low) & (right < 0.0)) | ((state.x >= batch.high) & (right > 0.0))
    system = np.where(held[:, :, None] | held[:, None, :], 0.0, system)
    system[:, np.arange(n), np.arange(n)] += held + 1e-14 * np.max(diagonal, axis=1, keepdims=True) + 1e-300
    right = np.where(held, 0.0, right)
    step = np.linalg.solve(system, right[..., None])[..., 0]
    t = state.t
    if batch.free_timing:
        t = t + np.clip(-(along + np.einsum("bpn,bn->bp", mixed, step)) / own, -LONGEST_TURN, LONGEST_TURN)
    x = np.clip(state.x + step, batch.low, batch.high)
    if fit is not None:
        fitted, turned = fit(x, batch.crank_angles(x, t), state.variant)
        inside = np.all((fitted >= batch.low) & (fitted <= batch.high), axis=1)[:, None]
        x, t = np.where(inside, fitted, x), np.where(inside, turned, t) if batch.free_timing else t
    r, by_x, by_t, h, by_h, cost = _look(batch, x, t, state.variant)
    better = cost < state.cost
    decrease = np.where(better, (state.cost - np.where(better, cost, 0.0)) / np.maximum(state.cost, 1e-300), 0.0)
    state.slow = np.where(better & (decrease < slow), state.slow + 1, np.where(better, 0, state.slow))
    state.damping = np.where(better, np.maximum(0.2 * state.damping, LEAST_DAMPING), 6.0 * state.damping)
    new = {"x": x, "t": t, "r": r, "by_x": by_x, "by_t": by_t, "h": h, "by_h": by_h, "cost": cost}
    for name, value in new.items():
        old = getattr(state, name)
        mask = better.reshape(-1, *[1] * (old.ndim - 1))
        setattr(state, name, value if better.all() else np.where(mask, value, old))
