"""Close-up of the coupler curve with precision points, tolerances, deviations and poses."""

from __future__ import annotations

import math

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import EllipseCollection
from matplotlib.colors import to_rgb
from numpy.typing import NDArray

from optlink.report.labels import Label
from optlink.report.shapes import finite
from optlink.report.style import BODIES, LIMIT, WANTED, scale
from optlink.report.views.path_view import Track

Array = NDArray[np.float64]
NUMBERED = 20  # number of points up to which each is numbered
SAME = 5e-3  # distance below which points share a label, as a share of the extent of the points
FRAMED = 40  # largest number of poses drawn as frames
AWAY = 0.25  # distance up to which the curve is included, as a share of the extent of the points
FRAME = 0.13  # size of a pose frame, as a share of the extent of the points
ALLOWED = BODIES[2]


def dots(count: int) -> float:
    """Return the marker size of a point [pt]."""
    return 3.8 if count <= NUMBERED else 3.0 if count <= 100 else 2.0


def points_on(axes: Axes, places: Array, size: float = 1.0) -> None:
    """Draw the precision points.

    Parameters
    ----------
    axes : Axes
    places : array (n, 2)
        In the unit of the axes.
    size : float, optional
        Factor on the marker size.
    """
    size *= dots(len(places))
    axes.plot(*places.T, linestyle="none", marker="o", markersize=size, color=WANTED, mew=0.0, zorder=5, gid="wanted")


def small_frames(places: Array, angles: Array, length: float) -> Array:
    """Return small coordinate frames, an arrow along x and a short line along y, as one line with gaps, shape (10 n, 2).

    Parameters
    ----------
    places : array (n, 2)
        Origins, in the unit of the axes.
    angles : array (n,) [rad]
    length : float
        Length of the arrow, in the unit of the axes.
    """
    x, y = np.stack([np.cos(angles), np.sin(angles)], axis=-1), np.stack([-np.sin(angles), np.cos(angles)], axis=-1)
    gap = (math.nan, math.nan)
    strokes = [(0.0, 0.0), (1.0, 0.0), gap, (0.8, 0.11), (1.0, 0.0), (0.8, -0.11), gap, (0.0, 0.0), (0.0, 0.45), gap]
    return np.stack([places + length * (a * x + b * y) for a, b in strokes], axis=1).reshape(-1, 2)


def some(count: int, most: int) -> NDArray[np.intp]:
    """Return at most `most` evenly spaced indices of `count` items, including the first and the last.

    Parameters
    ----------
    count : int
    most : int
    """
    return np.unique(np.round(np.linspace(0.0, count - 1.0, min(count, most))).astype(int))


def _listed(numbers: list[int]) -> str:
    """Format point numbers; consecutive numbers as a range."""
    if len(numbers) > 2 and numbers[-1] - numbers[0] == len(numbers) - 1:
        return f"{numbers[0]}–{numbers[-1]}"
    return ", ".join(map(str, numbers))


class Close:
    """Close-up of the coupler curve in its own axes: precision points, tolerances, deviations, poses."""

    def __init__(self, track: Track) -> None:
        self.track = track
        self.unit = scale(float(np.nanmax(np.abs(np.concatenate([track.wanted, track.generated])))), "m")
        self.length = FRAME * track.size * self.unit.factor
        self.motion = track.task.requirement.kind == "motion"
        self.shown = some(len(track.wanted), FRAMED)

    def _ends(self) -> Array:
        """Return the end points of the deviation lines."""
        ends: Array = self.track.wanted + self.track.factor * (self.track.generated - self.track.wanted)
        return ends * self.unit.factor

    def _poses(self) -> tuple[Array, Array]:
        """Return the prescribed and the generated frames as lines."""
        track, k = self.track, self.shown
        aim = np.arctan2(track.task.data.columns[:, 3], track.task.data.columns[:, 2])
        wanted = small_frames(track.wanted[k] * self.unit.factor, aim[k], self.length)
        return wanted, small_frames(track.generated[k] * self.unit.factor, track.angles(track.at)[k], self.length)

    def limits(self) -> tuple[Array, Array]:
        """Return the least and largest coordinates to show, with a margin; the aspect ratio is at most two.

        The curve is included as far as it stays near the points.
        """
        track, factor = self.track, self.unit.factor
        radii = np.where(np.isfinite(track.tolerances), track.tolerances * track.factor, 0.0)[:, None]
        seen = [track.wanted - radii, track.wanted + radii, track.generated]
        must = finite(np.concatenate([*(part * factor for part in seen), self._ends(), *(self._poses() if self.motion else ())]))
        low, high = must.min(axis=0), must.max(axis=0)
        size = high - low
        room = AWAY * float(np.max(size))
        run = np.clip(finite(track.position(track.run) * factor), low - room, high + room)
        low, high = np.minimum(low, run.min(axis=0)), np.maximum(high, run.max(axis=0))
        size = high - low
        half = 0.5 * np.maximum(1.16 * size, 0.5 * 1.16 * float(np.max(size)))
        return 0.5 * (low + high) - half, 0.5 * (low + high) + half

    @property
    def ratio(self) -> float:
        """Height divided by width."""
        low, high = self.limits()
        return float((high - low)[1] / (high - low)[0])

    @property
    def once(self) -> bool:
        """Whether the run from the first to the last point is the whole curve."""
        track = self.track
        return bool(np.ptp(track.run.crank_angle) >= np.ptp(track.motion.crank_angle) - 1e-9)

    def draw(self, axes: Axes, *, sticks: bool = True) -> list[Label]:
        """Draw the curve, points, tolerances, deviations and poses, and return the labels of the points.

        Parameters
        ----------
        axes : Axes
        sticks : bool, optional
            Draw tolerances and deviations.
        """
        track, factor, unit = self.track, self.unit.factor, self.unit.unit
        rest = None if self.once else "rest of the curve"
        whole = track.position(track.motion) * factor
        axes.plot(*whole.T, color=track.colour, linewidth=1.2, alpha=0.55, label=rest, gid="curve")
        axes.plot(*(track.position(track.run) * factor).T, color=track.colour, linewidth=2.0, label="generated curve", gid="run")
        if sticks:
            self._tolerances(axes)
            self._sticks(axes)
        if self.motion:
            wanted, found = self._poses()
            axes.plot(*found.T, color=track.colour, linewidth=2.6, alpha=0.6, zorder=4.6, label="generated pose", gid="poses")
            axes.plot(*wanted.T, color=WANTED, linewidth=1.1, zorder=4.8, label="wanted pose", gid="wanted poses")
        points_on(axes, track.wanted * factor, 0.6 if sticks and np.any(np.isfinite(track.tolerances)) else 1.0)
        axes.get_lines()[-1].set_label(f"wanted point{'s' if len(track.wanted) <= NUMBERED else f's, {len(track.wanted)}'}")
        (x0, y0), (x1, y1) = self.limits()
        axes.set(xlim=(x0, x1), ylim=(y0, y1), xlabel=f"x [{unit}]", ylabel=f"y [{unit}]")
        axes.set_aspect("equal")
        return self._numbers(axes)

    def _tolerances(self, axes: Axes) -> None:
        track = self.track
        known = np.isfinite(track.tolerances)
        if np.any(known):
            widths = 2.0 * track.factor * track.tolerances[known] * self.unit.factor
            crowded = np.count_nonzero(known) > 100
            circles = EllipseCollection(
                widths,
                widths,
                np.zeros(len(widths)),
                units="xy",
                offsets=track.wanted[known] * self.unit.factor,
                offset_transform=axes.transData,
                facecolors=(*to_rgb(ALLOWED), 0.04 if crowded else 0.13),
                edgecolors=(*to_rgb(ALLOWED), 0.0 if crowded else 0.9),
                linewidths=0.9,
                zorder=1.4,
                gid="tolerances",
            )
            axes.add_collection(circles)
            axes.plot(
                [],
                [],
                linestyle="none",
                marker="o",
                markersize=9,
                mfc=(*to_rgb(ALLOWED), 0.13),
                mec=ALLOWED,
                label=f"tolerance{self._fold}",
            )

    def _sticks(self, axes: Axes) -> None:
        track = self.track
        if track.exact:
            return
        gaps = np.full_like(track.wanted, np.nan)
        sticks = np.stack([track.wanted * self.unit.factor, self._ends(), gaps], axis=1).reshape(-1, 2)
        axes.plot(
            *sticks.T,
            color=LIMIT,
            linewidth=1.4 if len(track.wanted) <= 100 else 0.7,
            zorder=4.2,
            label=f"deviation{self._fold}",
            gid="deviations",
        )

    @property
    def _fold(self) -> str:
        return f", drawn {self.track.factor:g}-fold" if self.track.factor > 1.0 else ""

    def _numbers(self, axes: Axes) -> list[Label]:
        """Return labels with the numbers of the points; every fifth, tenth, ... if there are many."""
        places = self.track.wanted * self.unit.factor
        count = len(places)
        every = next(step for step in (1, 5, 10, 20, 50) if count <= NUMBERED * step or step == 50)
        chosen = [k for k in range(count) if k == 0 or (k + 1) % every == 0]
        middle = np.mean(places, axis=0)
        following = np.roll(places, -1, axis=0) - np.roll(places, 1, axis=0)
        if not self.track.task.closed:
            following[0], following[-1] = places[1] - places[0], places[-1] - places[-2]
        names: dict[int, list[int]] = {}
        same = SAME * float(np.max(np.ptp(places, axis=0)))
        for k in chosen:  # coincident points share a label
            first = next((i for i in names if np.linalg.norm(places[i] - places[k]) <= same), k)
            names.setdefault(first, []).append(k + 1)
        found = []
        for k, numbers in names.items():  # prefer the outer side of the curve
            away = np.array([-following[k, 1], following[k, 0]])
            away = away / max(float(np.linalg.norm(away)), 1e-300)
            away = -away if float(away @ (places[k] - middle)) < 0.0 else away
            at = (float(places[k, 0]), float(places[k, 1]))
            found.append(Label(axes, at, _listed(numbers), WANTED, 8.0, 2.0, (float(away[0]), float(away[1]))))
        return found
