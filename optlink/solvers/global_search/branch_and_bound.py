"""Branch and bound: a lower bound of the objective over all designs, or the proof that no design is feasible.

The box of all designs is divided until every part is discarded: because a limit is violated in it, or because the objective is at
least the threshold, the best known value less the permitted gap. What a search returns holds at whatever point it is stopped:
no design within the bounds is better than `lower`.

References
----------
R. Horst and H. Tuy, Global Optimization, 3rd ed., Springer 1996, chapter IV.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from copy import copy
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from optlink.execution.runner import ordered
from optlink.execution.worker import Runs
from optlink.linkage.vector2d import Array
from optlink.solvers.global_search.lagrangian import CUT, OPEN, BoxRecord

BATCH = 256  # boxes that are bounded together
LONG, WIDE = 10_000, 8  # boxes after which a search takes steps of several batches, for several processes; batches of a step
FEW = 64  # open boxes below which they are divided before they are bounded: small batches take nearly as long as larger ones
STEEP, NARROW = 1.5, 1e-4  # widths of the first boxes as multiples of their distance from the best known design, and least one
SMALLEST = 1e-12  # width of a box, relative to the bounds, below which it is not divided
MOST_OPEN = 1_000_000  # open boxes beyond which those with the highest bounds are taken first, so that memory is limited
CHANGING = ("open", "tiny", "leaves", "boxes", "discarded")  # what a batch changes
MOST_LEAVES = 200_000  # discarded boxes that are kept for the certificate


class Bounder(Protocol):
    """Lower bounds over boxes of unknowns, which are between `low` and `high` (n,)."""

    low: Array
    high: Array

    def bounded(self, low: Array, high: Array, threshold: float) -> BoxRecord:
        """Bound a batch of boxes with corners (boxes, n); those whose lower bound is not below the threshold are discarded."""


@dataclass
class Boxes:
    """Boxes with a lower bound of the objective each: `low`, `high` (boxes, n), `bound` (boxes,)."""

    low: Array
    high: Array
    bound: Array

    def __len__(self) -> int:
        return len(self.bound)

    def __getitem__(self, chosen: NDArray[np.bool_]) -> Boxes:
        rows = np.flatnonzero(chosen)  # ten times as fast as a mask
        return Boxes(self.low.take(rows, axis=0), self.high.take(rows, axis=0), self.bound.take(rows))

    @staticmethod
    def joined(parts: list[Boxes]) -> Boxes:
        """Return all boxes of several sets."""
        return Boxes(*(np.concatenate([getattr(part, name) for part in parts]) for name in ("low", "high", "bound")))

    def without(self, inner: Boxes) -> Boxes:
        """Return the parts of every box outside a smaller one within it, one for each face that moved."""
        low, high, parts = self.low.copy(), self.high.copy(), [self[np.zeros(len(self), dtype=bool)]]
        for k in range(low.shape[1]):
            moved = inner.low[:, k] > low[:, k]
            parts.append(Boxes(low[moved], _with(high[moved], k, inner.low[moved, k]), self.bound[moved]))
            low[moved, k] = inner.low[moved, k]
            moved = inner.high[:, k] < high[:, k]
            parts.append(Boxes(_with(low[moved], k, inner.high[moved, k]), high[moved], self.bound[moved]))
            high[moved, k] = inner.high[moved, k]
        return Boxes.joined(parts)

    def about(self, point: Array, width: Array) -> Boxes:
        """Return these boxes, divided into at most a batch of boxes that are about as wide as their distance from a point.

        Widths and distances are shares of `width` (n,), that of the bounds.
        """
        boxes = self
        while True:
            sizes = (boxes.high - boxes.low) / width
            distance = np.max(np.maximum(0.0, np.maximum(boxes.low - point, point - boxes.high)) / width, axis=1)
            wide = np.max(sizes, axis=1) > STEEP * (distance + NARROW)
            if not 0 < wide.sum() <= BATCH - len(boxes):
                return boxes
            boxes = Boxes.joined([boxes[~wide], boxes[wide].halves(np.argmax(sizes[wide], axis=1))])

    def halves(self, direction: NDArray[np.intp]) -> Boxes:
        """Return both halves of every box, divided along one unknown each (boxes,)."""
        rows = np.arange(len(self))
        middle = 0.5 * (self.low[rows, direction] + self.high[rows, direction])
        low, high = self.low.copy(), self.high.copy()
        low[rows, direction] = middle
        high[rows, direction] = middle
        return Boxes.joined([Boxes(self.low, high, self.bound), Boxes(low, self.high, self.bound)])


def _with(corners: Array, k: int, values: Array) -> Array:
    result = corners.copy()
    result[:, k] = values
    return result


@dataclass
class Leaves:
    """Discarded boxes: corners (boxes, n), index of the test in `TESTS`, multipliers (boxes, limits); empty if too many."""

    low: list[Array] = field(default_factory=list)
    high: list[Array] = field(default_factory=list)
    test: list[NDArray[np.int8]] = field(default_factory=list)
    multipliers: list[Array] = field(default_factory=list)
    count: int = 0

    def add(self, boxes: Boxes, discarded: NDArray[np.bool_], test: NDArray[np.int8], multipliers: Array) -> None:
        """Add those boxes of a batch that are discarded."""
        self.count += int(discarded.sum())
        self.low.append(boxes.low[discarded])
        self.high.append(boxes.high[discarded])
        self.test.append(test[discarded])
        self.multipliers.append(multipliers[discarded])
        if self.count > MOST_LEAVES:
            for part in (self.low, self.high, self.test, self.multipliers):
                part.clear()

    def __copy__(self) -> Leaves:
        """Return these boxes, to which others can be added without changing them here."""
        return Leaves([*self.low], [*self.high], [*self.test], [*self.multipliers], self.count)


@dataclass(frozen=True)
class BoundTask:
    """Bounds boxes with corners (boxes, n), `batch` of them in each chunk for `optlink.execution.runner`."""

    bounder: Bounder
    low: Array
    high: Array
    threshold: float
    batch: int

    def __call__(self, index: int) -> BoxRecord:
        """Bound the boxes of a chunk."""
        part = slice(index * self.batch, (index + 1) * self.batch)
        return self.bounder.bounded(self.low[part], self.high[part], self.threshold)


@dataclass
class BranchAndBound:
    """A search that can be stopped and continued at any batch.

    Parameters
    ----------
    best : float
        Objective of the best known design, infinite if none is known.
    gap : float
        Share of `best` by which a design may be better without being found.
    improve : function of a point (n,), optional
        Returns the objective of a valid design found from there, or infinity. Called where the centre of a box is better than
        the best known design.
    batch, few : int
        Boxes that are bounded together; open boxes below which they are divided before they are bounded.
    divisible : bool
        Whether batches may be bounded by copies of `bounder`: a long search then takes steps of several batches.
    runs : function, optional
        From `optlink.execution.runner.pool`, for these batches; it changes nothing in the result. Default: the present process.
    """

    bounder: Bounder
    best: float
    gap: float
    improve: Callable[[Array], float] | None = None
    batch: int = BATCH
    few: int = FEW
    divisible: bool = False
    runs: Runs | None = None
    boxes: int = 0  # bounded so far
    discarded: float = math.inf  # least bound of the boxes that were discarded for their objective
    open: Boxes = field(init=False)
    tiny: Boxes = field(init=False)
    leaves: Leaves = field(default_factory=Leaves)
    history: list[tuple[int, float, float]] = field(default_factory=list)  # boxes, lower, best
    next_attempt: int = 0  # number of boxes before which `improve` is not called again

    def __post_init__(self) -> None:
        self.open = self.tiny = self._bounds[np.zeros(1, dtype=bool)]
        self.open = self._enough(self._bounds)

    @property
    def threshold(self) -> float:
        """Objective from which a box is discarded."""
        return self.best * (1.0 - self.gap) if math.isfinite(self.best) else math.inf

    @property
    def lower(self) -> float:
        """Lower bound of the objective over all feasible designs; infinite if there are none."""
        remaining = (float(np.min(part.bound, initial=math.inf)) for part in (self.open, self.tiny))
        return min(self.best, self.discarded, *remaining)

    @property
    def closed(self) -> bool:
        """Whether every box is discarded."""
        return not len(self.open) and not len(self.tiny)

    def run(
        self, seconds: float = math.inf, boxes: float = math.inf, report: Callable[[BranchAndBound], None] | None = None
    ) -> None:
        """Search until every box is discarded, or the time or number of boxes is reached; `report` is called after every batch.

        Raises
        ------
        KeyboardInterrupt
            If the search is interrupted: what it has bounded until then holds.
        """
        begin = time.perf_counter()
        while len(self.open) and self.boxes < boxes and time.perf_counter() - begin < seconds:
            before = {name: copy(value) for name, value in vars(self).items() if name in CHANGING}
            try:
                self.step()
            except BaseException:  # the boxes of an interrupted batch are still open, each once: the bound and the volume hold
                vars(self).update(before)
                raise
            if not self.history or self.boxes >= 1.2 * self.history[-1][0] or not len(self.open):
                self.history.append((self.boxes, self.lower, self.best))
            if report is not None:
                report(self)

    def step(self) -> None:
        """Bound the next batch, the open boxes with the lowest bounds, and divide the boxes that are not discarded."""
        batch = self._next()
        record = self._bounded(batch)
        self.boxes += len(batch)
        batch = Boxes(batch.low, batch.high, np.maximum(batch.bound, record.bound))
        discarded = record.test != OPEN
        by_objective = discarded & (record.test > 0)
        self.discarded = min(self.discarded, float(np.min(batch.bound[by_objective], initial=math.inf)))
        self.leaves.add(batch, discarded, record.test, record.multipliers)
        self._better(batch, record)
        kept = batch[~discarded]
        left, direction = Boxes(record.low[~discarded], record.high[~discarded], kept.bound), record.split[~discarded]
        cut = kept.without(left)
        if len(cut):
            self.discarded = min(self.discarded, self.threshold)
            every = np.ones(len(cut), dtype=bool)
            self.leaves.add(cut, every, np.full(len(cut), CUT, dtype=np.int8), np.zeros((len(cut), record.multipliers.shape[1])))
        width = self._widths(left)
        small = np.max(width, axis=1) < SMALLEST
        bounded = np.max(self._widths(kept), axis=1) < SMALLEST  # else a cut has just made it small: it is bounded again
        rows = np.arange(len(left))
        direction = np.where(width[rows, direction] < SMALLEST, np.argmax(width, axis=1), direction)
        self.tiny = Boxes.joined([self.tiny, left[small & bounded]])
        halves = self._enough(left[~small].halves(direction[~small]))
        self.open = Boxes.joined([self.open, left[small & ~bounded], halves])

    def begin_about(self, point: Array) -> None:
        """Divide the bounds before the search: near the best known design (n,) small boxes alone can be discarded."""
        self.open = self._bounds.about(point, self.bounder.high - self.bounder.low)

    @property
    def _bounds(self) -> Boxes:
        return Boxes(self.bounder.low[None], self.bounder.high[None], np.zeros(1))

    def _enough(self, boxes: Boxes) -> Boxes:
        """Return boxes, divided until there are enough with the open ones."""
        while 0 < len(boxes) < self.few - len(self.open):
            boxes = boxes.halves(np.argmax(self._widths(boxes), axis=1))
        return boxes

    def _widths(self, boxes: Boxes) -> Array:
        """Return the widths (boxes, n) as shares of the bounds."""
        return (boxes.high - boxes.low) / (self.bounder.high - self.bounder.low)

    def _next(self) -> Boxes:
        wide = WIDE if self.divisible and self.boxes >= LONG else 1
        count = min(self.batch * wide, len(self.open))
        key = self.open.bound if len(self.open) <= MOST_OPEN else -self.open.bound
        order = np.argpartition(key, count - 1)[:count]
        chosen = np.zeros(len(self.open), dtype=bool)
        chosen[order] = True
        batch, self.open = self.open[chosen], self.open[~chosen]
        return batch

    def _bounded(self, boxes: Boxes) -> BoxRecord:
        """Bound boxes, in batches whose division does not depend on the number of processes."""
        task = BoundTask(self.bounder, boxes.low, boxes.high, self.threshold, self.batch)
        count = -(-len(boxes) // self.batch)
        parts = list(ordered(task, count, self.runs if count > 1 else None))
        return parts[0] if count == 1 else BoxRecord.joined(parts)

    def _better(self, batch: Boxes, record: BoxRecord) -> None:
        """Search for a better design from the best centre of the batch, if it is better than the best known design."""
        k = int(np.argmin(record.centre))
        if self.improve is None or not record.centre[k] < self.threshold or self.boxes < self.next_attempt:
            return
        before, self.best = self.best, min(self.best, self.improve(0.5 * (batch.low[k] + batch.high[k])))
        if not self.best < before:
            self.next_attempt = 2 * self.boxes  # so that their number grows with the logarithm of that of the boxes


def joint_history(searches: list[BranchAndBound]) -> list[tuple[int, float, float]]:
    """Return boxes, lower bound and best known objective over all searches, in the order in which they ran.

    Before a search has begun, its lower bound is zero.
    """
    rows, done, least = [], 0, math.inf
    for k, search in enumerate(searches):
        later = 0.0 if k + 1 < len(searches) else math.inf
        rows += [(done + boxes, min(least, low, later), best) for boxes, low, best in search.history]
        done, least = done + search.boxes, min(least, search.lower)
    return rows
