"""Motion and deviations of a synthesised design, shared by all its figures."""

from __future__ import annotations

import math
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from optlink.linkage.motion import Motion, sweep
from optlink.linkage.vector2d import TURN
from optlink.problem.path import MARK
from optlink.report.drawing import Sketch
from optlink.report.shapes import finite, spread
from optlink.report.views.path_tables import exact_places
from optlink.report.views.revolutions import round_below
from optlink.tasks.results.path import PathDesign, PathResult

Array = NDArray[np.float64]
FINE = 721  # positions per revolution
STICK = 0.07  # length of the largest magnified deviation, as a share of the extent of the points


class PathView:
    """Motion of a synthesised design relative to its precision points.

    `motion` is the whole motion: a revolution, or the assembled range around the points. `run` is the motion from the first point
    to the last, or a revolution if the points are closed. `at` contains the positions at the points.
    """

    def __init__(self, design: PathDesign) -> None:
        self.design, self.task = design, design.task
        angles = design.crank_angles
        self.begin, self.end = float(angles[0]), float(angles[-1])
        self.way = 1.0 if self.end >= self.begin else -1.0
        self.at = self.sweep(angles)
        self.reached = bool(np.any(self.at.assembled))
        self.first = int(np.argmax(self.at.assembled))
        around = self.task.closed and design.crank_turns
        span = TURN if around else abs(self.end - self.begin)
        count = max(61, math.ceil(span / TURN * (FINE - 1)) + 1)
        self.run = self.sweep(self.begin + self.way * np.linspace(0.0, span, count))
        self.motion = self.sweep(self._whole())
        self.here = self.sweep(angles[self.first : self.first + 1])

    def sweep(self, angles: Array) -> Motion:
        """Return the motion of the mechanism at crank angles [rad]."""
        return sweep(self.task.linkage, self.design.values, angles)

    def _whole(self) -> Array:
        once = self.begin + self.way * np.linspace(0.0, TURN, FINE)
        if self.design.crank_turns:
            return once
        low, high = sorted((self.begin, self.end))
        if self._farthest(high, low + TURN) == low + TURN:
            return once
        ends = self._farthest(low, high - TURN), self._farthest(high, low + TURN)
        return np.linspace(*(ends if self.way > 0.0 else ends[::-1]), FINE)

    def _farthest(self, start: float, stop: float) -> float:
        """Return the last angle from `start` towards `stop` at which the mechanism is assembled."""
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
        """Sketch of the mechanism, with room for the points."""
        found = Sketch(self.motion)
        found.widen(self.targets * found.scale.factor)
        return found

    @property
    def targets(self) -> Array:
        """Precision points [m], shape (points, 2); empty for function and transmission synthesis."""
        places: Array = self.task.data.columns[:, :2] if self.task.pointed else np.empty((0, 2))
        return places

    @property
    def generated(self) -> Array:
        """Generated points [m], shape (points, 2)."""
        return self.position(self.at)

    def position(self, motion: Motion) -> Array:
        """Return the positions of the coupler point [m], shape (positions, 2)."""
        return motion.position(self.task.requirement.point)

    @property
    def colour(self) -> str:
        """Colour of the body that carries the coupler point."""
        return self.sketch.colours[self.task.body]

    @property
    def exact(self) -> bool:
        """Whether every point is met to rounding."""
        return exact_places(self.design)

    @property
    def tolerances(self) -> Array:
        """Tolerances of the points [m]; infinite where there is none."""
        return self.task.data.tolerances

    def angles(self, motion: Motion) -> Array:
        """Return the pose angles of the guided body [rad]."""
        return np.asarray(motion.body_angle(self.task.body).value) + self.design.values[MARK]

    @cached_property
    def size(self) -> float:
        """Extent of the points [m]."""
        extent = float(np.max(spread(finite(np.concatenate([self.targets, self.generated])))))
        return extent if extent > 0.0 else self.task.size

    @cached_property
    def factor(self) -> float:
        """Magnification of deviations and tolerances in the figures."""
        largest = 0.0 if self.exact else float(np.nanmax(self.design.measured.distances))
        limit = STICK * self.size / largest if largest > 0.0 else math.inf
        tolerances = self.tolerances[np.isfinite(self.tolerances)]
        if tolerances.size:
            apart = np.linalg.norm(np.diff(self.targets, axis=0), axis=1)
            limit = min(limit, 0.45 * float(np.median(apart)) / float(np.max(tolerances)))
        return max(1.0, round_below(limit))


def best(result: PathResult) -> PathView | None:
    """Return the best design or the nearest miss; None if there is nothing to draw."""
    if result.best is None:
        return None
    track = PathView(result.best)
    return track if track.reached else None
