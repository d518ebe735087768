"""Certify the least largest error of a four-bar function generator: a lower bound over all linkages within bounds and limits."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from optlink.execution import interrupts
from optlink.linkage.inner_four_bar import InnerFourBar
from optlink.linkage.vector2d import TURN, Array
from optlink.problem.design import DesignProblem
from optlink.problem.targets.function import Function
from optlink.solvers.global_search.branch_and_bound import Boxes, BranchAndBound
from optlink.solvers.global_search.function_bounds import FunctionBounds, followed
from optlink.solvers.global_search.function_rows import LinkageSet

Improve = Callable[[dict[str, float], int], float]
"""Receives a design [m, rad] that seems better than the best known one, and its assembly mode (+1 or -1); returns the objective
of the valid design found from there."""

MOST = 0.25 * math.pi  # rad, error up to which the proof holds
LEVELS = (0.3, 0.05)  # gaps that are proven before the requested one, so that a search that is stopped has a bound
POSITIONS = 25  # of the rows before those at the peaks of the error
DENSE, FINE = 401, 20_001  # positions at which candidates are judged, and better designs
CANDIDATE_SEPARATION = (
    0.05  # rad, and of the logarithms of K1 and K2: a candidate so near to one that was tried is not tried again
)
WIDEN = 1e-9  # relative or absolute [rad] enlargement of bounds, which leaves no box without width
CLOSED, STOPPED, INTERRUPTED = "closed", "stopped", "interrupted"


def certify_function(
    problem: DesignProblem,
    best: float,
    design: Mapping[str, float] | None = None,
    gap: float = 1e-3,
    seconds: float = math.inf,
    boxes: float = math.inf,
    progress: Callable[[float, float], None] | None = None,
    improve: Improve | None = None,
) -> FunctionSearch:
    """Bound the largest error of all linkages from below, both assembly modes where the problem leaves them open.

    `best` [rad], below `MOST`, is the largest error of the best known `design`; the proof of a share `gap` of it is shorter with
    the positions of its largest errors. The bound reached within the limit of time [s] or boxes holds; Ctrl-C stops as well.
    `progress` receives the share of the start angles that is done at the present level, and the gap that is proven. `improve`
    receives a better design [m, rad] and returns the objective of the valid one found from it; by default its own error.
    """
    search = FunctionSearch(problem, best, None if design is None else dict(design), improve)
    search.run([level for level in LEVELS if level > gap] + [gap], seconds, boxes, progress)
    return search


def linkage_sets(problem: DesignProblem, error: float) -> list[LinkageSet]:
    """Return the linkages that a problem admits, those that come nearer to a dead position than an error [rad] apart."""
    loop, turned = problem.four_bar, problem.frame_angle
    assert loop is not None
    assert turned is not None
    ratios = [_ratio(problem, name) for name in loop.names]
    low, high = (np.zeros(4) for _ in range(2))
    for k, name in enumerate((problem.start_name, problem.base_name)):
        start, end = problem.quantities[name].bounds
        low[k], high[k] = start - turned - WIDEN, min(end, start + TURN) - turned + WIDEN
    for k, (least, most) in ((2, ratios[0]), (3, ratios[2])):
        low[k], high[k] = (1.0 - WIDEN) / most, (1.0 + WIDEN) / least
    if problem.limits.crank == "full rotation":  # the crank is the shortest link
        low[2] = max(low[2], 1.0)
    if problem.limits.crank == "double-crank":  # the frame is
        high[2:] = np.minimum(high[2:], 1.0)
    shortest = {"full rotation": (1.0 - WIDEN) / high[2], "double-crank": 1.0 - WIDEN}.get(problem.limits.crank, 0.0)
    high[2:] = np.maximum(high[2:], low[2:] * (1.0 + WIDEN))
    limit, least = problem.limits.transmission_at(loop.joint), problem.limits.alignment.value
    ends = (None, None) if limit is None else (limit.low, limit.high)
    angles = max(ends[0] or 0.0, least) - WIDEN, min(math.pi if ends[1] is None else ends[1], math.pi - least) + WIDEN
    ratios[1] = max(ratios[1][0], shortest), ratios[1][1]
    coupler = ratios[1][0] * (1.0 - WIDEN), ratios[1][1] * (1.0 + WIDEN)
    sides = (1, -1) if len(problem.mechanism.variants(problem.linkage)) > 1 else (loop.side,)
    every = [LinkageSet(side, low, high, coupler, angles, problem.limits.crank) for side in sides]
    return every + [part for linkages in every if (part := linkages.dead_part(error)) is not None]


def _ratio(problem: DesignProblem, name: str) -> tuple[float, float]:
    """Return the least and largest length over that of the frame."""
    (low, high), (frame_low, frame_high) = problem.quantities[name].bounds, problem.frame_bounds
    limit = problem.limits.link_ratio
    least, most = (0.0, math.inf) if limit is None else limit.bounds
    return max(low / frame_high, least), min(high / frame_low, most)


@dataclass
class FunctionSearch:
    """Search of all linkages within the bounds and limits of a problem for one with a smaller largest output error.

    `proven` [rad] is the lower bound of the last gap that is proven; `status`: "closed" if the requested gap is, "stopped" at the
    limit of time or boxes, "interrupted" by Ctrl-C. `better` has the designs [m, rad] better than all known before and their
    assembly modes, `tried` the places (4,) of the candidates that were tried; `history`: boxes, lower, best. `searches` are those
    of the present gap.
    """

    problem: DesignProblem
    best: float
    design: dict[str, float] | None
    improve: Improve | None
    proven: float = 0.0
    boxes: int = 0
    status: str = STOPPED
    better: list[tuple[dict[str, float], int]] = field(default_factory=list)
    history: list[tuple[int, float, float]] = field(default_factory=list)
    tried: list[Array] = field(default_factory=list)
    searches: list[BranchAndBound] = field(default_factory=list)

    @property
    def loop(self) -> InnerFourBar:
        """The four-bar."""
        assert self.problem.four_bar is not None
        return self.problem.four_bar

    @property
    def lower(self) -> float:
        """Lower bound [rad]: no linkage has a smaller largest error."""
        return min(self.proven, self.best)

    @property
    def gap(self) -> float:
        """Share of `best` by which a better linkage may exist."""
        return 1.0 - self.lower / self.best

    @property
    def open(self) -> Array:
        """Corners of the boxes that are left (boxes, 2, 4): phi0, psi0 [rad], frame over crank, frame over rocker."""
        left = [np.stack([part.low, part.high], axis=1) for search in self.searches for part in (search.open, search.tiny)]
        return np.concatenate(left) if left else np.zeros((0, 2, 4))

    def run(self, levels: list[float], seconds: float, boxes: float, progress: Callable[[float, float], None] | None) -> None:
        """Prove one gap after the other, the largest first, within limits of time [s] and of the number of boxes."""
        begin = time.perf_counter()
        try:
            for level in levels:
                self.searches = self._searches(level)
                for k, search in enumerate(self.searches):
                    search.best = self.best
                    search.improve = lambda _, search=search: self._better(search)
                    report = None if progress is None else lambda one, k=k: self._report(one, k, progress)
                    before = search.boxes
                    search.run(seconds - (time.perf_counter() - begin), boxes - self.boxes, report)
                    self.boxes += search.boxes - before
                    self.best = min(self.best, search.best)
                if not all(search.closed for search in self.searches):
                    return
                self.proven = max(self.proven, min(search.lower for search in self.searches))
                self.history.append((self.boxes, self.proven, self.best))
            self.status = CLOSED
        except KeyboardInterrupt:
            interrupts.handled()
            self.status = INTERRUPTED

    def _searches(self, level: float) -> list[BranchAndBound]:
        """Return a search of every set of linkages; each begins with the boxes that the one before has discarded."""
        sets = linkage_sets(self.problem, self.best)
        searches = [BranchAndBound(self._bounds(linkages), self.best, level) for linkages in sets]
        for search, previous in zip(searches, self.searches, strict=False):
            bounder, before = search.bounder, previous.bounder
            if np.array_equal([bounder.low, bounder.high], [before.low, before.high]) and previous.leaves.low:
                low, high = np.concatenate(previous.leaves.low), np.concatenate(previous.leaves.high)
                search.open = Boxes(low, high, np.zeros(len(low)))
        return searches

    def _report(self, search: BranchAndBound, k: int, progress: Callable[[float, float], None]) -> None:
        whole = float(np.prod(search.bounder.high - search.bounder.low))
        left = float(np.sum(np.prod(search.open.high - search.open.low, axis=1))) / whole
        progress((k + 1.0 - min(left, 1.0)) / len(self.searches), self.gap)

    def _rise(self, at: Array) -> Array:
        law = self.problem.requirement.law
        assert isinstance(law, Function)
        return np.asarray(law.rise(at) + 0.0 * at, dtype=float)

    def _bounds(self, linkages: LinkageSet) -> FunctionBounds:
        x = self.problem.span * 0.5 * (1.0 - np.cos(np.linspace(0.0, math.pi, POSITIONS)))
        if self.design is not None:
            fine, error = self._errors(self.design)
            around = np.pad(error, 1, constant_values=-1.0)
            x = np.append(x, fine[(error >= around[:-2]) & (error >= around[2:])])
        dense = self.problem.span * np.linspace(0.0, 1.0, DENSE)
        return FunctionBounds(linkages, self._rise, np.unique(x), dense)

    def _errors(self, design: Mapping[str, float]) -> tuple[Array, Array]:
        """Return fine positions and the absolute errors [rad] of a design there, in its better assembly mode."""
        x = self.problem.span * np.linspace(0.0, 1.0, FINE)
        problem, loop = self.problem, self.loop
        turned, lengths = problem.frame_angle or 0.0, loop.lengths(design)
        a, b, c = (length / lengths[3] for length in lengths[:3])
        k3 = (a * a - b * b + c * c + 1.0) / (2.0 * a * c)
        phi0, psi0 = design[problem.start_name] - turned, design[problem.base_name] - turned
        point = np.array([[phi0, psi0, 1.0 / a, 1.0 / c, k3]])
        errors = [np.abs(followed(point, side, x, self._rise(x))[0][0]) for side in (1, -1)]
        return x, min(errors, key=lambda error: float(np.max(np.where(np.isfinite(error), error, np.inf))))

    def _better(self, search: BranchAndBound) -> float:
        """Return the best objective known after the candidate of a batch."""
        bounder = search.bounder
        assert isinstance(bounder, FunctionBounds)
        phi0, psi0, k1, k2, k3 = (float(value) for value in bounder.candidate)
        place = np.array([phi0, psi0, math.log(k1), math.log(k2)])
        if self.improve is not None and any(np.max(np.abs(place - other)) < CANDIDATE_SEPARATION for other in self.tried):
            return self.best
        self.tried.append(place)
        problem, loop, turned = self.problem, self.loop, self.problem.frame_angle or 0.0
        pivots = {name: problem.quantities[name].value for name in loop.ground}
        frame = loop.frame(pivots)[0]
        coupler = math.sqrt(1.0 / (k1 * k1) + 1.0 / (k2 * k2) + 1.0 - 2.0 * k3 / (k1 * k2))
        lengths = dict(zip(loop.names, (frame / k1, frame * coupler, frame / k2), strict=True))
        design = {**lengths, **pivots, problem.start_name: phi0 + turned, problem.base_name: psi0 + turned}
        error = float(np.max(self._errors(design)[1]))
        if error < self.best:
            value = error if self._within(design) else math.inf
            if self.improve is not None:
                value = self.improve(design, bounder.linkages.side)
            if value < self.best:
                self.best, self.design = value, design
                self.better.append((design, bounder.linkages.side))
        return self.best

    def _within(self, design: Mapping[str, float]) -> bool:
        """Return whether a candidate is within the bounds of its lengths, and has no limits that a candidate may violate."""
        bounds = ((design[name], *self.problem.quantities[name].bounds) for name in self.loop.names)
        return self.problem.limits.crank == "span" and all(low <= value <= high for value, low, high in bounds)
