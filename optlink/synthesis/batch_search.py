"""Batched multistart for path and motion synthesis: sample, screen by least squares, descend and remove duplicates, in rounds."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from optlink.execution.runner import ordered
from optlink.execution.worker import Runs, built, packed
from optlink.linkage.fourbar import InnerFourBar, inner_four_bars
from optlink.linkage.vector2d import TURN, Array
from optlink.optimization.parameters import path_variable
from optlink.problem.design import STEP, DesignProblem
from optlink.synthesis.batch import Batch, ByLengths
from optlink.synthesis.levenberg_marquardt import ZERO, FinalDesigns, SimilarityFit, minimise

# Constants of the search of paths and poses in batches.
# What a search finds, and how much longer it takes, if one of them is halved or doubled: docs/constants.md.
SPREAD = 0.35  # relative standard deviation of a dimension about its value in the file
FIRST_ROUND, PER_ROUND = 60, 240  # starting points per round over all assembly modes: doubled from the first to the second number
POOL = 6  # samples per starting point; half of the starting points are the best samples, the others random ones
STEPS = 60  # of the first descent, with variable projection; twice as many without
DISTINCT = 1e-3  # least difference of two designs, in scaled units and relative to variables above one
PERFECT = 1e-20  # cost (square of a fraction of the curve size) of a design that passes all points
MISSED = 1e-3  # weighted squares of limit violations up to which the NLP refines a design
COARSE_POINTS = 18  # points in the first descent; the second uses all
NEAR, STRAGGLERS = 1e-17, 0.1  # cost from which full steps converge at once; share of designs that are left unconverged before
FINISHED = 60  # best distinct designs of a round that are refined to full precision
GOOD = 3  # of them must reach it; poorer ones may stop where they hardly improve
FULL_STEPS = 200  # of a descent to full precision: first with variable projection, then without
AFTER = 5  # remaining steps of all designs once one of them passes all points
MAX_CANDIDATES = 200  # distinct candidates, best first
REPAIRED = 12  # best distinct designs of a round that violate the order or a limit, reordered: they may still converge

# Random starting points of path synthesis: proportions that can turn and timing along the points.


def random_designs(batch: Batch, count: int, rng: np.random.Generator) -> Array:
    """Return random design variables (count, n), scaled and within their bounds."""
    problem = batch.problem
    n = len(batch.names)
    x = np.empty((count, n))
    for i, name in enumerate(batch.names):
        quantity = problem.quantities[name]
        low, high = batch.low[i], batch.high[i]
        if quantity.kind == "angle":
            most = min(high, low + TURN) if problem.is_periodic(name) else high
            x[:, i] = rng.uniform(low, most, count) if low < most else low
        elif problem.four_bar is not None:
            x[:, i] = rng.standard_normal(count) * 1.5
        else:
            fixed = (quantity.value - batch.origin[i]) / batch.scale[i]
            size = max(abs(fixed), 0.1)
            near = fixed + size * SPREAD * rng.standard_normal(count)
            wide = rng.uniform(np.maximum(low, fixed - 3.0 * size), np.minimum(high, fixed + 3.0 * size), count)
            x[:, i] = np.where(rng.random(count) < 0.6, near, wide)
    loop = problem.four_bar
    if loop is None:
        _turning(batch, x, rng)
        return np.clip(x, batch.low, batch.high)
    frame = _sized(batch, loop, x, rng)
    if not loop.frame_length:  # the frame has any direction, or lies along x
        tilts = {loop.ground[1], loop.ground[3]} & set(batch.names)
        _spaced(batch, loop, x, frame, rng.uniform(0.0, TURN, count) if tilts else np.zeros(count))
    return np.clip(x, batch.low, batch.high)


def _turning(batch: Batch, x: Array, rng: np.random.Generator) -> None:
    """Give half of the designs (count, n) a four-bar whose crank can turn, if all dimensions of the first one are free."""
    loop = next(inner_four_bars(batch.problem.linkage), None)
    if loop is None or not loop.plain or not batch.crank_turns or not {*loop.names, *loop.ground} <= set(batch.names):
        return
    half = x[: len(x) // 2]
    frame = _sized(batch, loop, half, rng)
    direction = rng.uniform(0.0, TURN, len(half))
    half[:, [batch.names.index(name) for name in loop.ground[:2]]] = rng.standard_normal((2, len(half))).T * 1.5
    _spaced(batch, loop, half, frame, direction)


def _sized(batch: Batch, loop: InnerFourBar, x: Array, rng: np.random.Generator) -> Array:
    """Give the designs (count, n) random lengths of a four-bar, where they are free; return that of the frame (count,)."""
    size = math.log(0.5), math.log(4.0)
    shape = random_proportions(batch, len(x), rng) * np.exp(rng.uniform(*size, (len(x), 1)))
    for k, name in enumerate((*loop.names, loop.frame_length)):
        if name in batch.names:
            x[:, batch.names.index(name)] = shape[:, k]
    return shape[:, 3]


def _spaced(batch: Batch, loop: InnerFourBar, x: Array, frame: Array, direction: Array) -> None:
    """Move the rocker pivots of the designs (count, n), or the crank pivots if they are fixed, to the lengths of the frame."""
    names, quantities = batch.names, batch.problem.quantities
    for axis, way in enumerate((np.cos(direction), np.sin(direction))):
        pair = [loop.ground[axis], loop.ground[axis + 2]]
        one, other = (
            x[:, names.index(name)] if name in names else path_variable(batch.problem, name).scaled(quantities[name].value)
            for name in pair
        )
        if pair[1] in names:
            x[:, names.index(pair[1])] = one + frame * way
        elif pair[0] in names:
            x[:, names.index(pair[0])] = other - frame * way


def random_proportions(batch: Batch, count: int, rng: np.random.Generator) -> Array:
    """Return random lengths of crank, coupler, rocker and frame (count, 4), relative to the frame.

    The lengths of all crank-rockers are crank a, coupler a + v + w, rocker a + u + w, frame a + u + v with a, u, v, w > 0:
    each of Grashof's sums has one of these numbers, twice, as its slack. In a double-crank crank and frame are interchanged.
    """
    crank = batch.problem.limits.crank
    if crank == "span":
        lengths = np.exp(rng.uniform(math.log(0.2), math.log(3.0), (count, 4)))
    else:
        a, u, v, w = np.where(
            rng.random(count) < 0.7, rng.exponential(size=(4, count)), np.exp(1.7 * rng.standard_normal((4, count)))
        )
        lengths = np.stack([a, a + v + w, a + u + w, a + u + v], axis=1)
        if crank == "double-crank":
            lengths = lengths[:, [3, 1, 2, 0]]
    return lengths / lengths[:, 3:]


def random_crank_angles(batch: Batch, count: int, rng: np.random.Generator) -> Array:
    """Return random crank angles (count, points) [rad] in order, with steps that loosely follow the distances of the points.

    Zeros with prescribed timing.
    """
    problem, points = batch.problem, batch.data.columns[:, :2]
    number = len(points)
    if not batch.free_timing:
        return np.zeros((count, number))
    chords = np.linalg.norm(np.diff(points, axis=0), axis=1)
    if problem.closed:
        chords = np.append(chords, np.linalg.norm(points[0] - points[-1]))
    chords = chords / max(float(np.mean(chords)), 1e-300) + 1e-3
    noise = 0.4 * min(1.0, math.sqrt(9.0 / number))
    steps = chords ** rng.uniform(0.0, 1.0, (count, 1)) * np.exp(noise * rng.standard_normal((count, len(chords))))
    if problem.closed and problem.meets_again:
        steps[:, -1] = 0.0
    low, high = problem.linkage.extent
    span = np.full((count, 1), TURN) if problem.closed else (high - low) * rng.uniform(0.1, 0.97, (count, 1))
    steps = np.maximum(steps / steps.sum(axis=1, keepdims=True) * span, 2.0 * STEP * (steps > 0.0))
    either = len(problem.ways) > 1
    ways = np.where(rng.random((count, 1)) < 0.5, *problem.ways) if either else np.full((count, 1), problem.ways[0])
    turned = np.concatenate([np.zeros((count, 1)), np.cumsum(steps[:, : number - 1], axis=1)], axis=1)
    begin = rng.uniform(-math.pi, math.pi, (count, 1))
    if problem.linkage.limits is not None:
        room = high - low - turned[:, -1:]
        begin = np.where(ways > 0.0, low, high - room) + room * (begin / TURN + 0.5)
    return np.asarray(begin + ways * turned, dtype=float)


def within_reach(batch: Batch, x: Array, t: Array, rng: np.random.Generator) -> Array:
    """Shift and shorten crank angles of four-bars without full rotation to the range where they can be assembled."""
    loop = batch.problem.four_bar
    if batch.crank_turns or loop is None or not batch.free_timing:
        return t
    values = batch.values(x)
    crank, coupler, rocker, frame = (length[:, 0] for length in loop.lengths(values))
    turned = loop.turned(values)
    square, twice = crank**2 + frame**2, 2.0 * crank * frame
    near = np.arccos(np.clip((square - (coupler - rocker) ** 2) / twice, -1.0, 1.0))  # at smaller angles B is too near to D
    far = np.arccos(np.clip((square - (coupler + rocker) ** 2) / twice, -1.0, 1.0))  # at larger angles B is too far from D
    mirrored = rng.random(len(x)) < 0.5
    low = np.where(near <= 0.0, -far, np.where(far >= math.pi, near, np.where(mirrored, -far, near)))
    high = np.where(near <= 0.0, far, np.where(far >= math.pi, TURN - near, np.where(mirrored, -near, far)))
    span = np.abs(t[:, -1] - t[:, 0])
    room = 0.98 * (high - low)
    share = np.minimum(1.0, room * rng.uniform(0.3, 1.0, len(x)) / np.maximum(span, 1e-9))
    begin = low + 0.01 * (high - low) + rng.random(len(x)) * np.maximum(room - share * span, 0.0)
    least = np.minimum(t[:, 0], t[:, -1])
    limited = (near > 0.0) | (far < math.pi)
    moved = turned + begin[:, None] + (t - least[:, None]) * share[:, None]
    return np.where(limited[:, None], moved, t)


def assembles_everywhere(batch: Batch, x: Array, t: Array) -> NDArray[np.bool_]:
    """Return which designs can be assembled at all points, and over the whole revolution if the crank must turn."""
    mechanism, values = batch.problem.linkage, batch.values(x)
    angles = batch.crank_angles(x, t)
    with np.errstate(all="ignore"):
        angle_sets = [angles]
        if batch.crank_turns and batch.problem.four_bar is None:
            angle_sets.append(np.broadcast_to(batch.angles, (len(x), len(batch.angles))))
        assembled = np.ones(len(x), dtype=bool)
        for at in angle_sets:
            pose = mechanism.at(values, at)
            for group in mechanism.groups:
                margin = np.broadcast_to(pose.margins[group.joint], at.shape)
                assembled &= np.all(margin > group.least, axis=1)
    return assembled


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
        x, t = random_designs(batch, many, rng), random_crank_angles(batch, many, rng)
        t = within_reach(batch, x, t, rng)
        whole = assembles_everywhere(batch, x, t)
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
                self.batch, parts, FULL_STEPS, self.fit, slow=1e-7, left=STRAGGLERS, after=AFTER, good=good, zero=zero
            )
            parts = [(ends.x, ends.t) for ends in designs]
        designs = self._minimise(self.batch, parts, FULL_STEPS, None, slow=1e-9, after=AFTER, good=good)
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
    proper &= np.isin(way, batch.problem.ways)
    if (limits := batch.problem.linkage.limits) is not None:
        proper &= np.all((angles >= limits[0]) & (angles <= limits[1]), axis=1)
    return (ends.missed <= MISSED) & (proper | (not batch.free_timing)), way


def nearest_in_order(problem: DesignProblem, t: Array) -> Array:
    """Return the crank angles (points,) [rad] nearest to `t` that pass the points in order within one revolution.

    Where the problem leaves the direction of the crank free, the direction with the smaller change is used.
    """
    from scipy.optimize import isotonic_regression

    low, high = problem.linkage.limits or (-math.inf, math.inf)
    t, least, most = np.clip(t, low, high), 2.0 * STEP * np.arange(len(t)), min(TURN, high - low) - 2.0 * STEP
    angles = []
    for way in problem.ways:
        rising = isotonic_regression(way * t - least).x + least
        if rising[-1] - rising[0] > most:
            rising = rising[0] + (rising - rising[0]) * most / (rising[-1] - rising[0])
        angles.append((float(np.sum((rising - way * t) ** 2)), way * rising))
    return np.asarray(min(angles, key=lambda each: each[0])[1], dtype=float)
