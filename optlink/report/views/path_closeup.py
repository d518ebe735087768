"""Close-up of the coupler curve with precision points, tolerances, deviations and poses."""

from __future__ import annotations

import math

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from optlink.report.chart_mpl import into
from optlink.report.chart_spec import Axis, ChartSpec, Curve, Mark, Panel
from optlink.report.labels import Label
from optlink.report.shapes import finite
from optlink.report.style import BODIES, LIMIT, WANTED, scale
from optlink.report.views.path_view import PathView

Array = NDArray[np.float64]
NUMBERED = 20  # number of points up to which each is numbered
SAME = 5e-3  # distance below which points share a label, as a share of the extent of the points
FRAMED = 40  # largest number of poses drawn as frames
AWAY = 0.25  # distance up to which the curve is included, as a share of the extent of the points
FRAME = 0.13  # size of a pose frame, as a share of the extent of the points
ALLOWED = BODIES[2]
CIRCLE = np.array([(math.cos(t), math.sin(t)) for t in np.linspace(0.0, 2.0 * math.pi, 73)] + [(math.nan, math.nan)])


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
    axes.plot(*places.T, linestyle="none", marker="o", markersize=size, color=WANTED, mew=0.0, zorder=5, gid="target")


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


def _fold(magnified: float) -> str:
    return f", drawn {magnified:g}-fold" if magnified > 1.0 else ""


class Close:
    """Close-up of the coupler curve in its own axes: precision points, tolerances, deviations, poses."""

    def __init__(self, track: PathView) -> None:
        self.track = track
        self.unit = scale(float(np.nanmax(np.abs(np.concatenate([track.targets, track.generated])))), "m")
        self.length = FRAME * track.size * self.unit.factor
        self.motion = track.task.requirement.kind == "motion"
        self.shown = some(len(track.targets), FRAMED)

    def _ends(self) -> Array:
        """Return the end points of the deviation lines."""
        ends: Array = self.track.targets + self.track.factor * (self.track.generated - self.track.targets)
        return ends * self.unit.factor

    def _poses(self) -> tuple[Array, Array]:
        """Return the prescribed and the generated frames as lines."""
        track, k = self.track, self.shown
        aim = np.arctan2(track.task.data.columns[:, 3], track.task.data.columns[:, 2])
        wanted = small_frames(track.targets[k] * self.unit.factor, aim[k], self.length)
        return wanted, small_frames(track.generated[k] * self.unit.factor, track.angles(track.at)[k], self.length)

    def limits(self) -> tuple[Array, Array]:
        """Return the least and largest coordinates to show, with a margin; the aspect ratio is at most two.

        The curve is included as far as it stays near the points.
        """
        track, factor = self.track, self.unit.factor
        radii = np.where(np.isfinite(track.tolerances), track.tolerances * track.factor, 0.0)[:, None]
        seen = [track.targets - radii, track.targets + radii, track.generated]
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

    def chart(self, magnified: float | None = 1.0, *, points: bool = True) -> ChartSpec:
        """Return the close-up as a chart: the curve, points, tolerances, deviations and poses.

        Parameters
        ----------
        magnified : float or None, optional
            Magnification of tolerances and deviations; None leaves them out.
        points : bool, optional
            Draw the generated points and the whole curve instead of the surroundings of the points.
        """
        track, factor, unit = self.track, self.unit.factor, self.unit.unit
        whole, run = (track.position(motion) * factor for motion in (track.motion, track.run))
        wanted, found = track.targets * factor, track.generated * factor
        traces = [
            Curve.through(
                whole, "" if self.once else "rest of the curve", track.colour, 1.2, opacity=0.55, hover=False, gid="curve"
            ),
            Curve.through(run, "generated curve", track.colour, 2.0, gid="run"),
        ]
        if magnified is not None:
            traces += [*self._tolerances(magnified), *self._deviations(magnified)]
        if self.motion:
            aims, poses = self._poses()
            traces.append(Curve.through(poses, "generated pose", track.colour, 2.6, opacity=0.6, hover=False, gid="poses"))
            traces.append(Curve.through(aims, "target pose", WANTED, 1.1, hover=False, gid="target poses"))
        numbers = [f"point {k + 1}" for k in range(len(wanted))]
        if points:
            traces.append(Curve.through(found, "generated", LIMIT, mode="markers", symbol="plus", size=6.0, text=numbers))
        size = dots(len(wanted)) * (0.6 if magnified is not None and np.any(np.isfinite(track.tolerances)) else 1.0)
        words = f"target point{'s' if len(wanted) <= NUMBERED else f's, {len(wanted)}'}"
        traces.append(Curve.through(wanted, words, WANTED, mode="markers", size=size, text=numbers, gid="target"))
        (x0, y0), (x1, y1) = self.limits()
        x, y = Axis(f"x [{unit}]", None if points else (x0, x1)), Axis(f"y [{unit}]", None if points else (y0, y1))
        return ChartSpec("", "Path", [Panel(y, traces, marks=self._numbers(size))], x, equal=True, cursor=False)

    def draw(self, axes: Axes, magnified: float | None) -> list[Label]:
        """Draw the close-up without a legend and return the labels of the points.

        Parameters
        ----------
        axes : Axes
        magnified : float or None
            See `chart`.
        """
        labels = into(axes, self.chart(magnified, points=False), legend=False)
        axes.set_aspect("equal", adjustable="box")
        return labels

    def _tolerances(self, magnified: float) -> list[Curve]:
        """Return the tolerances as circles."""
        track = self.track
        known = np.isfinite(track.tolerances)
        if not np.any(known):
            return []
        circles = track.targets[known][:, None] + magnified * track.tolerances[known][:, None, None] * CIRCLE
        opacity = 0.9 if len(circles) <= 100 else 0.25
        places = circles.reshape(-1, 2) * self.unit.factor
        return [
            Curve.through(places, f"tolerance{_fold(magnified)}", ALLOWED, 0.9, opacity=opacity, hover=False, gid="tolerances")
        ]

    def _deviations(self, magnified: float) -> list[Curve]:
        """Return the deviations as lines from the prescribed points."""
        track = self.track
        if track.exact:
            return []
        ends = track.targets + magnified * (track.generated - track.targets)
        gaps = np.full_like(track.targets, np.nan)
        sticks = np.stack([track.targets, ends, gaps], axis=1).reshape(-1, 2) * self.unit.factor
        width = 1.4 if len(track.targets) <= 100 else 0.7
        return [Curve.through(sticks, f"deviation{_fold(magnified)}", LIMIT, width, hover=False, gid="deviations")]

    def _numbers(self, size: float) -> list[Mark]:
        """Return marks with the numbers of the points; every fifth, tenth, ... if there are many."""
        places = self.track.targets * self.unit.factor
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
            at, prefer = (float(places[k, 0]), float(places[k, 1])), (float(away[0]), float(away[1]))
            found.append(Mark(*at, _listed(numbers), WANTED, size=size, prefer=prefer, written=True, font=8.0))
        return found
