"""Many starts in one batch: sampled, screened by least squares, advanced together, told apart; in rounds until it is enough."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from optlink.design.generation import STEP, TURN, GenerationProblem
from optlink.synthesis import starts
from optlink.synthesis.batch import Batch
from optlink.synthesis.marquardt import Ends, descend
from optlink.synthesis.similarity import Similarity

Array = NDArray[np.float64]

FIRST_ROUND, PER_ROUND = 60, 240  # starts that a round advances, all assembly modes together: rounds double up to the second
POOL = 6  # candidates per start; the better half of the starts are the best of them, the others any
STEPS = 60
FINISH = 60
LEAST_ROUNDS, MOST_ROUNDS = 6, 12
OFTEN = 3  # starts per design that passes all points after which a search expects no other one
HITS, SURE = 10, 40  # independent starts that must have reached the best value before a search ends early, or very early
SAME = 1e-6  # relative, costs that count as the same optimum
DISTINCT = 1e-3  # least difference, in scaled units, of two designs
PERFECT = 1e-20  # cost, as the square of a share of the size, of a design that passes all points
MISSED = 1e-3  # weighted squares of missed limits up to which the polishing programme is worth its time
FEW = 18  # points that a first descent looks at; the second looks at all
FINISHED = 24  # best of a round that are followed to the last digits
NEAR, STRAGGLERS = 1e-17, 0.1  # cost at which the first descent leaves the rest to the second; share that it leaves behind
AFTER = 5  # steps of all others once one of them passes all points
PROMISING = 1e-8  # cost below which a design may be on its way along a narrow valley to one that passes all points
DEEP, DEEPENED = 600, 12  # steps on that way, and designs of a round that go it
REPAIRED = 12  # best of a round that break the order or a limit: put in order, they may still lead to an answer


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
    """What was searched: distinct candidates, best first, starts made, and how many of them reached the best value.

    `repaired` ended out of order or beyond a limit and were put in order: what to try when the candidates do not do.
    """

    candidates: list[Candidate] = field(default_factory=list)
    repaired: list[Candidate] = field(default_factory=list)
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
        few = [batch.thinned(FEW) for batch in self.batches]
        self.thin, self.lifts = [fit.of(thin) for fit, (thin, _) in zip(self.fits, few, strict=True)], [lift for _, lift in few]
        self.rng = np.random.default_rng(seed)
        self.found = Exploration()
        self._costs: list[float] = []
        self._deep: list[Candidate] = []
        self._news = 0  # the last round that brought a new design that passes all points

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
                count = min(PER_ROUND, FIRST_ROUND << self.found.rounds)
                self._round(count if total is None else min(count, total - self.found.starts))
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
        if found.perfect:
            return (
                found.rounds > self._news or found.hits >= OFTEN * found.perfect
            )  # a round in vain, or the same again and again
        least = LEAST_ROUNDS if found.hits < SURE else LEAST_ROUNDS // 2
        return found.rounds >= least and found.hits >= HITS

    def _round(self, count: int) -> None:
        perfect = self.found.perfect
        share = max(1, -(-count // len(self.batches)))
        for variant, (batch, fit) in enumerate(zip(self.batches, self.thin, strict=True)):
            x, t = self._sample(fit.batch, fit, share)
            if len(x):
                self._keep(variant, batch, self._run(variant, batch, fit, x, t))
        self.found.starts += share * len(self.batches)
        self.found.rounds += 1
        if not self.found.perfect and self.found.best <= PROMISING:
            self._deepen()
        if self.found.perfect > perfect:
            self._news = self.found.rounds

    def _sample(self, batch: Batch, fit: Similarity, count: int) -> tuple[Array, Array]:
        many = POOL * count
        x, t = starts.designs(batch, many, self.rng), starts.timing(batch, many, self.rng)
        t = starts.within_reach(batch, x, t, self.rng)
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

    def _run(self, variant: int, batch: Batch, fit: Similarity, x: Array, t: Array) -> Ends:
        with_fit = (fit.fit, fit.linear) if fit.applies else (None, None)
        steps = STEPS if fit.applies else 2 * STEPS
        ends = descend(fit.batch, x, t, steps, *with_fit, zero=NEAR, left=STRAGGLERS)
        ends = replace(ends, t=ends.t @ self.lifts[variant])
        self._repair(variant, batch, ends)
        return self._finish(batch, ends)

    def _deepen(self) -> None:
        """Follow the best along their valley.

        Near-circular curves leave valleys that are curved and narrow; with what is linear put to its best at every step (the
        fit) they are short, and the last digits come from a step in everything at once.
        """
        for variant, (batch, fit) in enumerate(zip(self.batches, self.fits, strict=True)):
            ways = [c for c in self.found.candidates if c.variant == variant and c not in self._deep]
            ways = [c for c in ways if c.cost <= PROMISING][:DEEPENED]
            if not ways:
                continue
            x, t = np.array([c.x for c in ways]), np.array([c.t for c in ways])
            if fit.applies:
                ends = descend(batch, x, t, DEEP, fit.fit, fit.linear, slow=1e-7)
                x, t = ends.x, ends.t
            kept = list(self.found.candidates)
            self._keep(variant, batch, descend(batch, x, t, DEEP if not fit.applies else STEPS, slow=1e-9))
            self._deep += [*ways, *(c for c in self.found.candidates if c not in kept)]

    def _finish(self, batch: Batch, ends: Ends) -> Ends:
        """Follow the best of a round, with everything at once, to the last digits."""
        proper = self._ordered(batch, ends)[0] & (ends.missed <= MISSED)
        order = np.argsort(np.where(proper, ends.cost, np.inf))[:FINISHED]
        order = order[np.isfinite(ends.cost[order]) & proper[order]]
        if not len(order):
            return ends.take(order)
        return descend(batch, ends.x[order], ends.t[order], FINISH, slow=1e-9, after=AFTER)

    def _repair(self, variant: int, batch: Batch, ends: Ends) -> None:
        """Put the best of those that are out of order, or beyond a limit, in order: the nearest crank angles that are."""
        proper, way = self._ordered(batch, ends)
        wrong = np.isfinite(ends.cost) & ~(proper & (ends.missed <= MISSED))
        for i in np.argsort(np.where(wrong, ends.cost, np.inf))[: min(REPAIRED, int(wrong.sum()))]:
            t, direction = (in_order(batch.problem, ends.t[i]), int(way[i])) if batch.own else (ends.t[i], int(way[i]))
            if batch.own:
                direction = 1 if t[-1] >= t[0] else -1
            angles = batch.crank_angles(ends.x[i : i + 1], t[None])
            r, _, _ = batch.residuals(ends.x[i : i + 1], angles)
            h, _ = batch.misses(ends.x[i : i + 1], angles)
            cost = float(np.sum(r * r) + np.sum(h * h))
            if np.isfinite(cost):
                self.found.repaired.append(Candidate(variant, ends.x[i], t, cost, direction))
        self.found.repaired.sort(key=lambda c: c.cost)
        del self.found.repaired[50:]

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


def in_order(problem: GenerationProblem, t: Array) -> Array:
    """The crank angles nearest to t (points,) that pass the points in order within one revolution, the better way round."""
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
