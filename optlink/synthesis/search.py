"""Many starts in one batch: sampled, screened by least squares, advanced together, told apart; in rounds until it is enough."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from optlink.design.generation import STEP, TURN, GenerationProblem
from optlink.linkage.cycle import closing
from optlink.synthesis import starts
from optlink.synthesis.batch import Batch
from optlink.synthesis.marquardt import Ends, descend
from optlink.synthesis.similarity import Similarity

Array = NDArray[np.float64]

PER_ROUND = 240  # starts that a round advances, all assembly modes together
POOL = 6  # candidates per start; the better half of the starts are the best of them, the others any
STEPS = 60
FINISH = 60
LEAST_ROUNDS, MOST_ROUNDS = 4, 10
HITS = 4  # independent starts that must have reached the best value before a search ends early
SAME = 1e-6  # relative, costs that count as the same optimum
DISTINCT = 1e-3  # least difference, in scaled units, of two designs
PERFECT = 1e-20  # cost, as the square of a share of the size, of a design that passes all points
MISSED = 1e-3  # weighted squares of missed limits up to which the polishing programme is worth its time
FINISHED = 40  # best of a round that are followed to the last digits


@dataclass(frozen=True, eq=False)
class Candidate:
    """A design that a search found: scaled x, crank angles of the points [rad], cost, its variant and the crank's direction."""

    variant: int
    x: Array
    t: Array
    cost: float
    direction: int


@dataclass
class Exploration:
    """What was searched: distinct candidates, best first, starts made, and how many of them reached the best value."""

    candidates: list[Candidate] = field(default_factory=list)
    starts: int = 0
    rounds: int = 0
    hits: int = 0
    interrupted: bool = False

    @property
    def best(self) -> float:
        """Least cost so far."""
        return self.candidates[0].cost if self.candidates else np.inf

    @property
    def perfect(self) -> int:
        """Distinct designs that pass all points."""
        return sum(c.cost <= PERFECT for c in self.candidates)


class Searcher:
    """The search of one problem; `variants` are its combinations of assembly modes."""

    def __init__(self, variants: list[GenerationProblem], seed: int) -> None:
        self.batches = [Batch(variant) for variant in variants]
        self.fits = [Similarity(batch) for batch in self.batches]
        self.rng = np.random.default_rng(seed)
        self.found = Exploration()
        self._costs: list[float] = []

    def explore(self, total: int | None, wanted: int, progress: Callable[[float], None] | None = None) -> Exploration:
        """Search until `total` starts are made; without a total, until the best value came up often enough.

        Parameters
        ----------
        total : int, optional
        wanted : int
            Distinct perfect designs that are enough.
        """
        try:
            while not self._enough(total, wanted):
                count = PER_ROUND if total is None else min(PER_ROUND, total - self.found.starts)
                self._round(count)
                if progress:
                    done = self.found.starts / total if total else self.found.rounds / MOST_ROUNDS
                    progress(min(done, 1.0))
        except KeyboardInterrupt:
            if not self.found.candidates:
                raise
            self.found.interrupted = True
        return self.found

    def _enough(self, total: int | None, wanted: int) -> bool:
        found = self.found
        if total is not None:
            return found.starts >= total
        if found.perfect >= wanted or found.rounds >= MOST_ROUNDS:
            return True
        return found.rounds >= LEAST_ROUNDS and found.hits >= HITS and not found.perfect

    def _round(self, count: int) -> None:
        share = max(1, -(-count // len(self.batches)))
        for variant, (batch, fit) in enumerate(zip(self.batches, self.fits, strict=True)):
            x, t = self._sample(batch, fit, share)
            if len(x):
                self._keep(variant, batch, self._run(batch, fit, x, t))
        self.found.starts += share * len(self.batches)
        self.found.rounds += 1

    def _sample(self, batch: Batch, fit: Similarity, count: int) -> tuple[Array, Array]:
        many = POOL * count
        x, t = starts.designs(batch, many, self.rng), starts.timing(batch, many, self.rng)
        whole = starts.assembled(batch, x, t)
        x, t = x[whole], t[whole]
        if not len(x):
            return x, t
        if fit.applies:
            fitted, turned = fit.fit(x, batch.crank_angles(x, t))
            x, t = np.clip(fitted, batch.low, batch.high), turned if batch.own else t
        r, _, _ = batch.residuals(x, batch.crank_angles(x, t))
        cost = np.einsum("bpk,bpk->b", r, r)
        order = np.argsort(np.where(np.isfinite(cost), cost, np.inf))
        best, rest = order[: count - count // 2], order[count - count // 2 :]
        chosen = np.concatenate([best, self.rng.permutation(rest)[: count // 2]])
        return x[chosen], t[chosen]

    def _run(self, batch: Batch, fit: Similarity, x: Array, t: Array) -> Ends:
        if not fit.applies:
            return self._finish(batch, descend(batch, x, t, 2 * STEPS))
        return self._finish(batch, descend(batch, x, t, STEPS, fit.fit, fit.linear))

    def _finish(self, batch: Batch, ends: Ends) -> Ends:
        """Follow the best of a round, with everything at once, to the last digits."""
        proper = self._ordered(batch, ends)[0] & (ends.missed <= MISSED)
        order = np.argsort(np.where(proper, ends.cost, np.inf))[:FINISHED]
        order = order[np.isfinite(ends.cost[order]) & proper[order]]
        return descend(batch, ends.x[order], ends.t[order], FINISH, slow=1e-9)

    def _ordered(self, batch: Batch, ends: Ends) -> tuple[NDArray[np.bool_], NDArray[np.int_]]:
        """Whether the points are met in order within one revolution, and which way the crank turns."""
        angles = batch.crank_angles(ends.x, ends.t)
        steps = np.diff(angles, axis=1)
        whole = angles[:, -1] - angles[:, 0]
        way = np.where(whole >= 0.0, 1, -1)
        proper = np.all(steps * way[:, None] >= STEP, axis=1) & (np.abs(whole) <= TURN + 1e-9)
        rotation = {"counter-clockwise": 1, "clockwise": -1}.get(batch.problem.requirement.rotation)
        if rotation is not None and batch.own:
            proper &= way == rotation
        return proper if batch.own else np.ones(len(whole), dtype=bool), way

    def _keep(self, variant: int, batch: Batch, ends: Ends) -> None:
        proper, way = self._ordered(batch, ends)
        known = self.found.candidates
        for i in np.argsort(ends.cost):
            if not proper[i] or ends.missed[i] > MISSED or not np.isfinite(ends.cost[i]):
                continue
            cost = float(ends.cost[i])
            same = [c for c in known if c.variant == variant and np.max(np.abs(c.x - ends.x[i])) <= DISTINCT]
            self._costs.append(cost)
            if same and min(c.cost for c in same) <= cost:
                continue
            for c in same:
                known.remove(c)
            known.append(Candidate(variant, ends.x[i], ends.t[i], cost, int(way[i])))
        known.sort(key=lambda c: c.cost)
        del known[200:]
        best = self.found.best
        self.found.hits = sum(c <= best * (1.0 + SAME) + PERFECT for c in self._costs)


def turns(batch: Batch, candidate: Candidate) -> bool:
    """A quick look whether the crank turns fully; the proof comes later."""
    values = {name: float(v[0, 0]) for name, v in batch.values(candidate.x[None]).items()}
    angles = np.linspace(0.0, TURN, 360, endpoint=False)
    return bool(np.all(closing(batch.problem.linkage, values, angles) > 0.0))
