"""Batched multistart for path and motion synthesis: sample, screen by least squares, descend and remove duplicates, in rounds."""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from optlink.execution.runner import ordered
from optlink.execution.worker import Runs, built, packed
from optlink.linkage.vector2d import TURN, Array
from optlink.problem.design import STEP, DesignProblem
from optlink.synthesis import random_starts as starts
from optlink.synthesis.batch import Batch
from optlink.synthesis.by_lengths import ByLengths
from optlink.synthesis.levenberg_marquardt import ZERO, FinalDesigns, minimise
from optlink.synthesis.variable_projection import SimilarityFit

FIRST_ROUND, PER_ROUND = 60, 240  # starting points per round over all assembly modes: doubled from the first to the second number
POOL = 6  # samples per starting point; half of the starting points are the best samples, the others random ones
STEPS = 60
DISTINCT = 1e-3  # least difference of two designs, in scaled units and relative to variables above one
PERFECT = 1e-20  # cost (square of a fraction of the curve size) of a design that passes all points
MISSED = 1e-3  # weighted squares of limit violations up to which the NLP refines a design
COARSE_POINTS = 18  # points in the first descent; the second uses all
NEAR, STRAGGLERS = 1e-17, 0.1  # cost from which full steps converge at once; share of designs that are left unconverged before
FINISHED = 60  # best distinct designs of a round that are refined to full precision
GOOD = 3  # of them must reach it; poorer ones may stop where they hardly improve
VALLEY, FINISH = 200, 200  # steps with variable projection, then full steps
AFTER = 5  # remaining steps of all designs once one of them passes all points
MAX_CANDIDATES = 200  # distinct candidates, best first
REPAIRED = 12  # best distinct designs of a round that violate the order or a limit, reordered: they may still converge


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

    `repaired` are the designs of the last round that violated the order of the points or a limit and were reordered; `accepted`
    counts the starting points that did not end at such a design.
    """

    candidates: list[Candidate] = field(default_factory=list)
    repaired: list[Candidate] = field(default_factory=list)
    starts: int = 0
    accepted: int = 0
    rounds: int = 0


@dataclass(frozen=True)
class _Round:
    """Results of a round: the final designs of each combination of assembly modes, its reordered designs, and how many of its
    starting points ended in order and within the limits."""

    ends: list[FinalDesigns]
    repaired: list[Candidate]
    accepted: int


@dataclass(frozen=True)
class RoundTask:
    """Rounds of a search from the number `first` on; each one is a chunk for the runner. `stated`: the search, packed."""

    stated: bytes
    first: int

    def __call__(self, index: int) -> _Round:
        """Compute a round."""
        return built(Searcher, self.stated)._rounds(range(self.first + index, self.first + index + 1))[0]


class Searcher:
    """Multistart search of one problem; `variants` are its combinations of assembly modes, `runs` the processes for rounds.

    A round draws the same random numbers however many rounds follow: the starting points of a short search are a prefix of those
    of a longer one with the same seed.
    """

    def __init__(self, variants: list[DesignProblem], seed: int) -> None:
        self.by_lengths = [ByLengths(variant) for variant in variants]
        searched = [one.problem or one.stated for one in self.by_lengths]
        self.batch = Batch(searched[0], searched[1:])
        self.fit = SimilarityFit(self.batch)
        self.batches = [self.batch.of_variant(k) for k in range(len(variants))]
        self.thin, self.lift = self.batch.thinned(COARSE_POINTS)
        self.seed, self.variants = seed, variants
        self.runs: Runs | None = None
        self.exploration = Exploration()
        self._ready: list[_Round] = []

    def advance(self, ahead: int = 1) -> Exploration:
        """Run one round of starting points, and return all candidates so far.

        If no round is ready, `ahead` rounds are computed at a time: larger arrays take less time per design. The result of a
        round does not depend on it.
        """
        exploration = self.exploration
        if not self._ready:
            numbers = range(exploration.rounds, exploration.rounds + ahead)
            task = RoundTask(packed((self.variants, self.seed)), exploration.rounds)
            self._ready = list(ordered(task, ahead, self.runs)) if self.runs else self._rounds(numbers)
        finished = self._ready.pop(0)
        exploration.repaired = sorted(finished.repaired, key=lambda c: c.cost)
        for variant, ends in enumerate(finished.ends):
            self._keep(variant, ends)
        exploration.starts += self._share(exploration.rounds) * len(self.batches)
        exploration.accepted += finished.accepted
        exploration.rounds += 1
        return exploration

    def coarse(self) -> list[Candidate]:
        """Return the candidates of the first round before they are refined to full precision, cheapest first."""
        samples = [self._sample(variant, self._share(0), 0) for variant in range(len(self.batches))]
        groups = []
        for variant, ends in enumerate(self._descended(samples)):
            good, way = acceptable(self.batch, ends)
            ends = self._stated(variant, ends)
            groups += [Candidate(variant, ends.x[i], ends.t[i], float(ends.cost[i]), int(way[i])) for i in np.flatnonzero(good)]
        return sorted(groups, key=lambda candidate: candidate.cost)

    def _share(self, number: int) -> int:
        """Return the starting points of a round per combination of assembly modes."""
        return -(-min(PER_ROUND, FIRST_ROUND << min(number, 8)) // len(self.batches))

    def _rounds(self, numbers: range) -> list[_Round]:
        """Compute rounds; a group is what a round starts with one combination of assembly modes."""
        groups = [(number, variant) for number in numbers for variant in range(len(self.batches))]
        samples = [self._sample(variant, self._share(number), number) for number, variant in groups]
        firsts = self._descended(samples)
        ends = self._finished(firsts)
        rounds = []
        for k in range(0, len(groups), len(self.batches)):
            part = slice(k, k + len(self.batches))
            repaired = [c for variant, first in enumerate(firsts[part]) for c in self._repaired(variant, first)]
            accepted = sum(int(np.count_nonzero(acceptable(self.batch, first)[0])) for first in firsts[part])
            rounds.append(_Round(ends[part], repaired, accepted))
        return rounds

    def _sample(self, variant: int, count: int, number: int) -> tuple[Array, Array]:
        """Return starting points: of `POOL` times as many random designs, half are the best by least squares, half others."""
        batch, rng = self.thin.of_variant(variant), np.random.default_rng([self.seed, number, variant])
        fit = self.fit.of(batch)
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
        if not batch.free_timing:  # designs beyond several bounds end in the same corner
            distinct = np.sort(np.unique(x, axis=0, return_index=True)[1])
            x, t = x[distinct], t[distinct]
        r, _, _ = batch.residuals(x, batch.crank_angles(x, t))
        cost = np.einsum("bpk,bpk->b", r, r)
        order = np.argsort(np.where(np.isfinite(cost), cost, np.inf))
        best, rest = order[: count - count // 2], order[count - count // 2 :]
        chosen = np.concatenate([best, rng.permutation(rest)[: count // 2]])
        return x[chosen], t[chosen]

    def _minimise(
        self, batch: Batch, parts: list[tuple[Array, Array]], steps: int, fit: SimilarityFit | None, **options: Any
    ) -> list[FinalDesigns]:
        """Minimise the designs of all groups together, and return them by group."""
        sizes = [len(x) for x, _ in parts]
        if not sum(sizes):
            return [FinalDesigns(x, t, np.zeros(0), np.zeros(0), np.zeros(0, dtype=int)) for x, t in parts]
        group = np.repeat(np.arange(len(parts)), sizes)
        x, t = (np.concatenate(each) for each in zip(*parts, strict=True))
        projection = (None, None) if fit is None else (fit.fit, fit.linear)
        ends = minimise(batch, x, t, steps, *projection, variant=group % len(self.batches), group=group, **options)
        return [ends.take(np.flatnonzero(group == k)) for k in range(len(parts))]

    def _descended(self, samples: list[tuple[Array, Array]]) -> list[FinalDesigns]:
        """Minimise from the starting points, with few points of the path."""
        applies = self.fit.applies
        thin = self.fit.of(self.thin) if applies else None
        ends = self._minimise(self.thin, samples, STEPS if applies else 2 * STEPS, thin, zero=NEAR, left=STRAGGLERS)
        return [replace(end, t=end.t @ self.lift) for end in ends]

    def _finished(self, firsts: list[FinalDesigns]) -> list[FinalDesigns]:
        """Refine the best designs of each group to full precision, one for all that are alike.

        Near-circular curves have curved and narrow valleys. Variable projection (the fit) shortens them; full Levenberg-Marquardt
        steps give the last digits.
        """
        simple = len(self.batch.problem.linkage.groups) == 1  # with more dyads few designs converge in time
        good, zero = (GOOD, NEAR) if simple else (None, ZERO)
        parts, counts = [], []
        for ends in firsts:
            fine = acceptable(self.batch, ends)[0]
            order = np.argsort(np.where(fine, ends.cost, np.inf))
            ends = ends.take(order[fine[order]])
            first, count = distinct(ends, max(1, FINISHED // len(self.batches)))
            parts.append((ends.x[first], ends.t[first]))
            counts.append(count)
        if self.fit.applies:
            designs = self._minimise(
                self.batch, parts, VALLEY, self.fit, slow=1e-7, left=STRAGGLERS, after=AFTER, good=good, zero=zero
            )
            parts = [(ends.x, ends.t) for ends in designs]
        designs = self._minimise(
            self.batch, parts, FINISH if self.fit.applies else VALLEY, None, slow=1e-9, after=AFTER, good=good
        )
        return [replace(ends, count=count) for ends, count in zip(designs, counts, strict=True)]

    def _repaired(self, variant: int, ends: FinalDesigns) -> Iterator[Candidate]:
        """Reorder the crank angles of the best designs that violate the order of the points or a limit."""
        batch = self.batches[variant]
        good, way = acceptable(batch, ends)
        wrong = np.isfinite(ends.cost) & ~good
        order = np.argsort(np.where(wrong, ends.cost, np.inf))[: int(wrong.sum())]
        ends, way = ends.take(order), way[order]
        for i in distinct(ends, REPAIRED)[0]:
            t, direction = ends.t[i], int(way[i])
            if batch.free_timing:
                t = nearest_in_order(batch.problem, t)
                direction = 1 if t[-1] >= t[0] else -1
            angles = batch.crank_angles(ends.x[i : i + 1], t[None])
            r, _, _ = batch.residuals(ends.x[i : i + 1], angles)
            h, _ = batch.violations(ends.x[i : i + 1], angles)
            cost = float(np.sum(r * r) + np.sum(h * h))
            if np.isfinite(cost):
                end = self._stated(variant, replace(ends.take(np.array([i])), t=t[None]))
                yield Candidate(variant, end.x[0], end.t[0], cost, direction)

    def _stated(self, variant: int, ends: FinalDesigns) -> FinalDesigns:
        """Return designs in the variables of the stated problem."""
        how = self.by_lengths[variant]
        if how.problem is None or not len(ends.x):
            return ends
        x, t = how.stated_design(ends.x, ends.t)
        return replace(ends, x=x, t=t)

    def _keep(self, variant: int, ends: FinalDesigns) -> None:
        good, way = acceptable(self.batch, ends)
        ends, candidates = self._stated(variant, ends), self.exploration.candidates
        for i in np.argsort(ends.cost):
            if not good[i]:
                continue
            same = [c for c in candidates if c.variant == variant and alike(c.x, ends.x[i])]
            if not same:
                candidates.append(Candidate(variant, ends.x[i], ends.t[i], float(ends.cost[i]), int(way[i]), int(ends.count[i])))
                continue
            same[0].count += int(ends.count[i])
            if ends.cost[i] < same[0].cost:
                same[0].x, same[0].t, same[0].cost, same[0].direction = ends.x[i], ends.t[i], float(ends.cost[i]), int(way[i])
        candidates.sort(key=lambda c: c.cost)
        del candidates[MAX_CANDIDATES:]


def alike(x: Array, other: Array) -> Any:
    """Return whether designs (..., n) are practically the same as another one (n,)."""
    return np.all(np.abs(x - other) <= DISTINCT * np.maximum(1.0, np.abs(other)), axis=-1)


def distinct(ends: FinalDesigns, most: int) -> tuple[NDArray[np.intp], NDArray[np.int_]]:
    """Return the indices of at most `most` first designs that differ, and the number of designs like each; `ends`: best first."""
    left = np.arange(len(ends.x))
    first: list[int] = []
    counts: list[int] = []
    while len(left) and len(first) < most:
        same = alike(ends.x[left], ends.x[left[0]])
        first.append(int(left[0]))
        counts.append(int(np.count_nonzero(same)))
        left = left[~same]
    return np.array(first, dtype=np.intp), np.array(counts, dtype=int)


def acceptable(batch: Batch, ends: FinalDesigns) -> tuple[NDArray[np.bool_], NDArray[np.int_]]:
    """Return whether designs pass the points in order within one revolution and nearly meet all limits, and their direction.

    The direction of the crank is +1 or -1.
    """
    angles = batch.crank_angles(ends.x, ends.t)
    steps = np.diff(angles, axis=1)
    whole = angles[:, -1] - angles[:, 0]
    way = np.where(whole >= 0.0, 1, -1)
    proper = np.all(steps * way[:, None] >= STEP, axis=1) & (np.abs(whole) <= TURN + 1e-9)
    rotation = {"counter-clockwise": 1, "clockwise": -1}.get(batch.problem.rotation)
    if rotation is not None and batch.free_timing:
        proper &= way == rotation
    return (ends.missed <= MISSED) & (proper | (not batch.free_timing)), way


def nearest_in_order(problem: DesignProblem, t: Array) -> Array:
    """Return the crank angles (points,) [rad] nearest to `t` that pass the points in order within one revolution.

    Where the problem leaves the direction of the crank free, the direction with the smaller change is used.
    """
    from scipy.optimize import isotonic_regression

    least = 2.0 * STEP * np.arange(len(t))
    rotation = {"counter-clockwise": 1.0, "clockwise": -1.0}.get(problem.rotation)
    angles = []
    for way in (1.0, -1.0) if rotation is None else (rotation,):
        rising = isotonic_regression(way * t - least).x + least
        most = TURN - 2.0 * STEP
        if rising[-1] - rising[0] > most:
            rising = rising[0] + (rising - rising[0]) * most / (rising[-1] - rising[0])
        angles.append((float(np.sum((rising - way * t) ** 2)), way * rising))
    return np.asarray(min(angles, key=lambda each: each[0])[1], dtype=float)
