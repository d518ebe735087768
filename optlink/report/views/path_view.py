"""A generated design on its curve: what all its pictures share."""

from __future__ import annotations

import math
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from optlink.linkage.motion import Motion, sweep
from optlink.problem.path import MARK, TURN
from optlink.report.drawing import Sketch
from optlink.report.shapes import finite, spread
from optlink.report.views.path_tables import exact_places
from optlink.report.views.revolutions import round_below
from optlink.tasks.path_result import Design, Generation

Array = NDArray[np.float64]
FINE = 721  # positions of a revolution
STICK = 0.07  # of the extent of the points: the longest deviation as it is drawn


class Track:
    """A design on its curve: what all pictures share.

    `motion` is the whole motion, a revolution or all that is assembled around the points; `run` that from the first point to the
    last, once round if the points are closed; `at` the points themselves.
    """

    def __init__(self, design: Design) -> None:
        self.design, self.task = design, design.task
        angles = design.crank_angles
        self.begin, self.end = float(angles[0]), float(angles[-1])
        self.way = 1.0 if self.end >= self.begin else -1.0
        self.at = self.sweep(angles)
        self.reached = bool(np.any(self.at.assembled))
        self.first = int(np.argmax(self.at.assembled))
        around = self.task.closed and design.turns
        span = TURN if around else abs(self.end - self.begin)
        count = max(61, math.ceil(span / TURN * (FINE - 1)) + 1)
        self.run = self.sweep(self.begin + self.way * np.linspace(0.0, span, count))
        self.motion = self.sweep(self._whole())
        self.here = self.sweep(angles[self.first : self.first + 1])

    def sweep(self, angles: Array) -> Motion:
        """The mechanism at crank angles."""
        return sweep(self.task.linkage, self.design.values, angles)

    def _whole(self) -> Array:
        once = self.begin + self.way * np.linspace(0.0, TURN, FINE)
        if self.design.turns:
            return once
        low, high = sorted((self.begin, self.end))
        if self._farthest(high, low + TURN) == low + TURN:
            return once
        ends = self._farthest(low, high - TURN), self._farthest(high, low + TURN)
        return np.linspace(*(ends if self.way > 0.0 else ends[::-1]), FINE)

    def _farthest(self, start: float, stop: float) -> float:
        """The last angle on the way at which the mechanism is assembled."""
        for _ in range(4):
            grid = np.linspace(start, stop, FINE)
            apart = np.flatnonzero(~self.sweep(grid).assembled)
            if not apart.size:
                return stop
            if apart[0] == 0:
                return start
            start, stop = float(grid[apart[0] - 1]), float(grid[apart[0]])
        return start

    @cached_property
    def sketch(self) -> Sketch:
        """How the mechanism is drawn, with room for the points."""
        found = Sketch(self.motion)
        found.widen(self.wanted * found.scale.factor)
        return found

    @property
    def wanted(self) -> Array:
        """Wanted points [m], (points, 2); none of a function or the transmission."""
        places: Array = self.task.data.columns[:, :2] if self.task.pointed else np.empty((0, 2))
        return places

    @property
    def generated(self) -> Array:
        """Generated points [m], (points, 2)."""
        return self.position(self.at)

    def position(self, motion: Motion) -> Array:
        """The point on its curve [m]."""
        return motion.position(self.task.requirement.point)

    @property
    def colour(self) -> str:
        """Of the body that carries the point."""
        return self.sketch.colours[self.task.body]

    @property
    def exact(self) -> bool:
        """Whether every point is met but for rounding."""
        return exact_places(self.design)

    @property
    def tolerances(self) -> Array:
        """Of the points that have one [m]; infinite of the others."""
        return self.task.data.tolerances

    def angles(self, motion: Motion) -> Array:
        """Angle [rad] of the poses that the body takes."""
        return np.asarray(motion.body_angle(self.task.body).value) + self.design.values[MARK]

    @cached_property
    def size(self) -> float:
        """Extent of the points [m]."""
        extent = float(np.max(spread(finite(np.concatenate([self.wanted, self.generated])))))
        return extent if extent > 0.0 else self.task.size

    @cached_property
    def factor(self) -> float:
        """How many times as large as they are deviations and tolerances are drawn."""
        largest = 0.0 if self.exact else float(np.nanmax(self.design.measured.distances))
        limit = STICK * self.size / largest if largest > 0.0 else math.inf
        tolerances = self.tolerances[np.isfinite(self.tolerances)]
        if tolerances.size:
            apart = np.linalg.norm(np.diff(self.wanted, axis=0), axis=1)
            limit = min(limit, 0.45 * float(np.median(apart)) / float(np.max(tolerances)))
        return max(1.0, round_below(limit))


def best(result: Generation) -> Track | None:
    """The best design, or the nearest miss, if there is anything to draw."""
    if result.best is None:
        return None
    track = Track(result.best)
    return track if track.reached else None
