"""Batched multistart for path and motion synthesis: sample, screen by least squares, descend and remove duplicates, in rounds."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from optlink.problem.path import STEP, TURN, PathProblem
from optlink.synthesis import random_starts as starts
from optlink.synthesis.batch import Batch
from optlink.synthesis.levenberg_marquardt import FinalDesigns, minimise
from optlink.synthesis.variable_projection import SimilarityFit

Array = NDArray[np.float64]

FIRST_ROUND, PER_ROUND = 60, 240  # starting points per round over all assembly modes: doubled from the first to the second number
POOL = 6  # samples per starting point; half of the starting points are the best samples, the others random ones
STEPS = 60
DISTINCT = 1e-3  # least difference, in scaled units, of two designs
PERFECT = 1e-20  # cost (square of a fraction of the curve size) of a design that passes all points
MISSED = 1e-3  # weighted squares of limit violations up to which the NLP refines a design
FEW = 18  # points in the first descent; the second uses all
NEAR, STRAGGLERS = 1e-17, 0.1  # cost at which the first descent stops; share of designs that it leaves unconverged
FINISHED = 60  # best designs of a round that are refined to full precision
VALLEY, FINISH = 200, 200  # steps with variable projection, then full steps
AFTER = 5  # remaining steps of all designs once one of them passes all points
KEPT = 200  # distinct candidates, best first
REPAIRED = 12  # best designs of a round that violate the order or a limit: reordered, they may still converge to a solution


@dataclass(eq=False)
class Candidate:
    """A distinct design: scaled x, crank angles of the points [rad], cost, assembly variant, crank direction (+1, -1).

    `count` starting points converged to it.
    """

    variant: int
    x: Array
    t: Array
    cost: float
    direction: int
    count: int = 1


@dataclass
class Exploration:
    """Distinct candidates, best first, and the number of starting points and rounds.

    `repaired` are the designs of the last round that violated the order of the points or a limit and were reordered.
    """

    candidates: list[Candidate] = field(default_factory=list)
    repaired: list[Candidate] = field(default_factory=list)
    starts: int = 0
    rounds: int = 0


class Searcher:
    """Multistart search of one problem; `variants` are its combinations of assembly modes.

    A round draws the same random numbers however many rounds follow: the starting points of a short search are a prefix of those
    of a longer one with the same seed.
    """

    def __init__(self, variants: list[PathProblem], seed: int) -> None:
        self.batches = [Batch(variant) for variant in variants]
        self.fits = [SimilarityFit(batch) for batch in self.batches]
        few = [batch.thinned(FEW) for batch in self.batches]
        self.thin, self.lifts = [fit.of(thin) for fit, (thin, _) in zip(self.fits, few, strict=True)], [lift for _, lift in few]
        self.seed = seed
        self.exploration = Exploration()

    def advance(self) -> Exploration:
        """Run one round of starting points, and return all candidates so far."""
        found = self.exploration
        share = -(-min(PER_ROUND, FIRST_ROUND << min(found.rounds, 8)) // len(self.batches))
        found.repaired = []
        for variant, (batch, fit) in enumerate(zip(self.batches, self.thin, strict=True)):
            rng = np.random.default_rng([self.seed, found.rounds, variant])
            x, t = self._sample(fit.batch, fit, share, rng)
            if len(x):
                self._keep(variant, batch, self._run(variant, batch, fit, x, t))
        found.starts += share * len(self.batches)
        found.rounds += 1
        return found

    def _sample(self, batch: Batch, fit: SimilarityFit, count: int, rng: np.random.Generator) -> tuple[Array, Array]:
        many = POOL * count
        x, t = starts.random_designs(batch, many, rng), starts.random_crank_angles(batch, many, rng)
        t = starts.within_reach(batch, x, t, rng)
        whole = starts.assembles_everywhere(batch, x, t)
        x, t = x[whole], t[whole]
        if not len(x):
            return x, t
        if fit.applies:
            fitted, turned = fit.fit(x, batch.crank_angles(x, t))
            x, t = np.clip(fitted, batch.low, batch.high), turned if batch.free_timing else t
        r, _, _ = batch.residuals(x, batch.crank_angles(x, t))
        cost = np.einsum("bpk,bpk->b", r, r)
        order = np.argsort(np.where(np.isfinite(cost), cost, np.inf))
        best, rest = order[: count - count // 2], order[count - count // 2 :]
        chosen = np.concatenate([best, rng.permutation(rest)[: count // 2]])
        return x[chosen], t[chosen]

    def _run(self, variant: int, batch: Batch, fit: SimilarityFit, x: Array, t: Array) -> FinalDesigns:
        with_fit = (fit.fit, fit.linear) if fit.applies else (None, None)
        steps = STEPS if fit.applies else 2 * STEPS
        ends = minimise(fit.batch, x, t, steps, *with_fit, zero=NEAR, left=STRAGGLERS)
        ends = replace(ends, t=ends.t @ self.lifts[variant])
        self._repair(variant, batch, ends)
        return self._finish(variant, batch, ends)

    def _finish(self, variant: int, batch: Batch, ends: FinalDesigns) -> FinalDesigns:
        """Refine the best designs of a round to full precision.

        Near-circular curves have curved and narrow valleys. Variable projection (the fit) shortens them; full Levenberg-Marquardt
        steps give the last digits.
        """
        proper = pass_in_order(batch, ends)[0] & (ends.missed <= MISSED)
        order = np.argsort(np.where(proper, ends.cost, np.inf))[: max(1, FINISHED // len(self.batches))]
        order = order[np.isfinite(ends.cost[order]) & proper[order]]
        fit = self.fits[variant]
        if len(order) and fit.applies:
            ends = minimise(
                batch, ends.x[order], ends.t[order], VALLEY, fit.fit, fit.linear, slow=1e-7, left=STRAGGLERS, after=AFTER
            )
            order = np.arange(len(order))
        if not len(order):
            return ends.take(order)
        return minimise(batch, ends.x[order], ends.t[order], FINISH if fit.applies else VALLEY, slow=1e-9, after=AFTER)

    def _repair(self, variant: int, batch: Batch, ends: FinalDesigns) -> None:
        """Reorder the crank angles of the best designs that violate the order of the points or a limit."""
        proper, way = pass_in_order(batch, ends)
        wrong = np.isfinite(ends.cost) & ~(proper & (ends.missed <= MISSED))
        for i in np.argsort(np.where(wrong, ends.cost, np.inf))[: min(REPAIRED, int(wrong.sum()))]:
            t, direction = (
                (nearest_in_order(batch.problem, ends.t[i]), int(way[i])) if batch.free_timing else (ends.t[i], int(way[i]))
            )
            if batch.free_timing:
                direction = 1 if t[-1] >= t[0] else -1
            angles = batch.crank_angles(ends.x[i : i + 1], t[None])
            r, _, _ = batch.residuals(ends.x[i : i + 1], angles)
            h, _ = batch.violations(ends.x[i : i + 1], angles)
            cost = float(np.sum(r * r) + np.sum(h * h))
            if np.isfinite(cost):
                self.exploration.repaired.append(Candidate(variant, ends.x[i], t, cost, direction))
        self.exploration.repaired.sort(key=lambda c: c.cost)

    def _keep(self, variant: int, batch: Batch, ends: FinalDesigns) -> None:
        proper, way = pass_in_order(batch, ends)
        known = self.exploration.candidates
        for i in np.argsort(ends.cost):
            if not proper[i] or ends.missed[i] > MISSED or not np.isfinite(ends.cost[i]):
                continue
            same = [c for c in known if c.variant == variant and np.max(np.abs(c.x - ends.x[i])) <= DISTINCT]
            if not same:
                known.append(Candidate(variant, ends.x[i], ends.t[i], float(ends.cost[i]), int(way[i])))
                continue
            same[0].count += 1
            if ends.cost[i] < same[0].cost:
                same[0].x, same[0].t, same[0].cost, same[0].direction = ends.x[i], ends.t[i], float(ends.cost[i]), int(way[i])
        known.sort(key=lambda c: c.cost)
        del known[KEPT:]


def pass_in_order(batch: Batch, ends: FinalDesigns) -> tuple[NDArray[np.bool_], NDArray[np.int_]]:
    """Return whether the points are passed in order within one revolution, and the direction of the crank, both (designs,).

    Parameters
    ----------
    batch : Batch
    ends : FinalDesigns
        Designs and their crank angles.
    """
    angles = batch.crank_angles(ends.x, ends.t)
    steps = np.diff(angles, axis=1)
    whole = angles[:, -1] - angles[:, 0]
    way = np.where(whole >= 0.0, 1, -1)
    proper = np.all(steps * way[:, None] >= STEP, axis=1) & (np.abs(whole) <= TURN + 1e-9)
    rotation = {"counter-clockwise": 1, "clockwise": -1}.get(batch.problem.requirement.rotation)
    if rotation is not None and batch.free_timing:
        proper &= way == rotation
    return proper if batch.free_timing else np.ones(len(whole), dtype=bool), way


def nearest_in_order(problem: PathProblem, t: Array) -> Array:
    """Return the crank angles (points,) [rad] nearest to `t` that pass the points in order within one revolution.

    Where the problem leaves the direction of the crank free, the direction with the smaller change is used.

    Parameters
    ----------
    problem : PathProblem
    t : array (points,) [rad]
        Crank angles of the points.
    """
    from scipy.optimize import isotonic_regression

    least = 2.0 * STEP * np.arange(len(t))
    rotation = {"counter-clockwise": 1.0, "clockwise": -1.0}.get(problem.requirement.rotation)
    found = []
    for way in (1.0, -1.0) if rotation is None else (rotation,):
        rising = isotonic_regression(way * t - least).x + least
        most = TURN - 2.0 * STEP
        if rising[-1] - rising[0] > most:
            rising = rising[0] + (rising - rising[0]) * most / (rising[-1] - rising[0])
        found.append((float(np.sum((rising - way * t) ** 2)), way * rising))
    return np.asarray(min(found, key=lambda each: each[0])[1], dtype=float)
