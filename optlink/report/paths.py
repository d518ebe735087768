"""Files and pictures of path and motion generation: the mechanism on its curve, how far it misses, other designs, a film."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from functools import cached_property
from pathlib import Path

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import EllipseCollection
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import FancyArrowPatch, Polygon
from matplotlib.path import Path as Outline
from matplotlib.ticker import FixedLocator, FuncFormatter, MaxNLocator
from numpy.typing import NDArray
from PIL import Image

from optlink.design.files import dump
from optlink.design.generation import MARK, TURN
from optlink.generation import LEVEL, Design, Generation
from optlink.linkage.cognates import CouplerLinkage
from optlink.linkage.motion import Motion, sweep
from optlink.report.designs import words
from optlink.report.draw import Sketch
from optlink.report.film import film, there_and_back
from optlink.report.labels import Label, settle
from optlink.report.shapes import finite, spread
from optlink.report.store import whole, write_csv, write_json
from optlink.report.style import (
    BODIES,
    CRANK,
    FOUND,
    LIMIT,
    QUIET,
    WANTED,
    Scale,
    figure,
    heading,
    save,
    save_film,
    scale,
    styled,
)
from optlink.report.turns import beside, round_below

Array = NDArray[np.float64]
FINE = 721  # positions of a revolution
FRAMES = 90
NUMBERED = 20  # points up to which each has its number
GHOSTS = 8  # poses in which the body is drawn
FRAMED = 40  # poses that are drawn as frames
SIZES = 14  # sizes that fit below a title
PANELS = 9  # designs beside one another
BARS = 40  # points up to which each has a bar
STICK = 0.07  # of the extent of the points: the longest deviation as it is drawn
FRAME = 0.13  # of the extent of the points: the frame of a pose
APART = 4.0  # times as large as the smallest: designs that are drawn on one scale
LIT, ALLOWED = "#ffc20a", BODIES[2]
NOTHING = 1e-3  # of the largest deviation: a component that is not shown
ALIKE = 1e-3  # of the frame: difference of two four-bars that are the same


def write_all(result: Generation, folder: Path) -> list[Path]:
    """Write result.json and, of the best design or the nearest miss, points.csv, design.toml, every picture and the film."""
    written = [folder / "result.json"]
    write_json(written[0], result.to_dict())
    design = result.best
    if design is None:
        return written
    written += [folder / "points.csv", folder / "design.toml"]
    write_csv(written[1], columns(design))
    with whole(written[2]) as temporary:
        temporary.write_text(machine(design), encoding="utf-8")
    for name, draw in PICTURES.items():
        drawn = draw(result)
        if drawn is not None:
            written.append(folder / f"{name}.png")
            save(drawn, written[-1])
    pictures = frames(result)
    if pictures:
        written.append(folder / "motion.gif")
        save_film(pictures, written[-1])
    return written


def columns(design: Design) -> dict[str, Array]:
    """What is wanted and what is generated at every point, by name and SI unit."""
    data, measured = design.task.data, design.measured
    found: dict[str, Array] = {"point": np.arange(1.0, len(data.columns) + 1.0)}
    for name, places in (("wanted", data.columns), ("generated", measured.generated)):
        found |= {f"{name}.{axis}_m": places[:, k] for k, axis in enumerate("xy")}
    found |= {"distance_m": measured.distances, "crank_angle_rad": design.crank_angles}
    if np.any(np.isfinite(data.tolerances)):
        found["tolerance_m"] = data.tolerances
    if design.task.wanted.weights is not None:
        found["weight"] = data.roots**2
    if measured.turned is not None:
        wanted = np.arctan2(data.columns[:, 3], data.columns[:, 2])
        found |= {"wanted.angle_rad": wanted, "generated.angle_rad": wanted + measured.turned, "turned_rad": measured.turned}
    return found


def machine(design: Design) -> str:
    """The design as a problem file with every size fixed."""
    told = f"# {design.status.value}, valid" if design.valid else f"# NOT VALID: {_failed(design)}"
    return f"{told}\n{dump(design.machine)}"


# --- a design on its curve -----------------------------------------------------------------------------------------------


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
        reached = np.isfinite(self.generated).all(axis=1)
        self.reached = bool(np.any(reached))
        self.first = int(np.argmax(reached))
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
        """Wanted points [m], (points, 2)."""
        places: Array = self.task.data.columns[:, :2]
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
        return bool(np.max(self.design.measured.distances) <= LEVEL * self.task.size)

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


def _fit(value: float, unit: Scale) -> Scale:
    """The unit of the picture; for what is small in it, one that suits it."""
    return unit if value == 0.0 or not math.isfinite(value) or value * unit.factor >= 0.01 else scale(value, "m")


def _length(value: float, unit: Scale) -> str:
    fit = _fit(value, unit)
    return f"{value * fit.factor:.4g} {fit.unit}"


def _degrees(angle: float) -> str:
    return f"{math.degrees(angle):.4g}°"


def _failed(design: Design) -> str:
    """Why a design is not valid."""
    failed = [check.name for check in design.validation.checks if not check.passed]
    more = f" and {len(failed) - 2} more checks" if len(failed) > 3 else ""
    return f"fails {', '.join(failed[: 2 if more else 3])}{more}" if failed else design.status.text


def _objective(track: Track) -> str:
    """The measure of the deviations."""
    design, unit, task = track.design, track.sketch.scale, track.task
    if track.exact and _exact_angles(track):
        return "exact to rounding"
    weighted = ", weighted" if task.wanted.weights is not None else ""
    if task.measure != "sum of squares":
        return f"{task.measure}{weighted} {_length(design.objective, unit)}"
    fit = _fit(math.sqrt(max(design.objective, 0.0)), unit)
    return f"sum of squares{weighted} {design.objective * fit.factor**2:.4g} {fit.unit}²"


def _exact_angles(track: Track) -> bool:
    turned = track.design.measured.turned
    return turned is None or bool(np.max(np.abs(turned)) <= LEVEL)


def _assembly(design: Design) -> str:
    return f"assembly {words(design)}"


def _transmission(design: Design) -> str:
    least = design.least_transmission
    return f"least transmission angle {math.degrees(least):.1f}°" if math.isfinite(least) else ""


def _figures(track: Track) -> list[str]:
    """Objective, deviations, transmission angle."""
    design, task, unit = track.design, track.task, track.sketch.scale
    distances, turned = design.measured.distances, design.measured.turned
    told = []
    if track.exact and _exact_angles(track):
        told.append(f"all {len(distances)} {'points' if turned is None else 'poses'} met exactly, to rounding")
    else:
        plain = turned is None and task.wanted.weights is None
        rms, largest = math.sqrt(float(np.mean(distances**2))), float(np.max(distances))
        if not (plain and task.measure in ("rms", "max")):
            told.append(_objective(track))
        told.append(f"distances: rms {_length(rms, unit)}, largest {_length(largest, unit)}")
        if turned is not None:
            told.append(f"angles: largest {_degrees(float(np.max(np.abs(turned))))}")
        if np.any(np.isfinite(track.tolerances)):
            told.append(f"at most {100.0 * float(np.max(distances / track.tolerances)):.3g} % of the tolerance")
    return [*told, *filter(None, [_transmission(design)])]


def _sizes(track: Track) -> list[str]:
    """Sizes of the design; the free ones if all are too many."""
    task, unit = track.task, track.sketch.scale
    names = [*task.mechanism.quantities, *([MARK] if MARK in task.quantities else [])]
    if len(names) > SIZES:
        names = [name for name in names if task.quantities[name].free]
    told = []
    for name in names:
        angle, value = task.quantities[name].kind == "angle", track.design.values[name]
        shown = f"{math.degrees(value):.5g}°" if angle else f"{value * unit.factor:.5g}"
        told.append(f"{name} {shown.replace('-', '−') if 'e' not in shown else shown}")
    if not told or len(told) > SIZES:
        return []
    return [f"in {unit.unit}: {told[0]}", *told[1:]]


def _wrapped(items: Sequence[str], width: float, size: float, gap: str) -> str:
    """Items in lines of about the same length that fit into a width [inch]; no item is broken."""
    most = max(16, int(72.0 * width / (0.56 * size)))

    def lines(limit: int) -> list[str]:
        found = [""]
        for item in items:
            longer = f"{found[-1]}{gap if found[-1] else ''}{item}"
            if found[-1] and len(longer) > limit:
                found.append(item)
            else:
                found[-1] = longer
        return found

    count = len(lines(most))
    return "\n".join(next(found for limit in range(1, most + 1) if len(found := lines(limit)) == count))


def _title(made: Figure, track: Track, width: float, title: str, *more: str, size: float = 10.0) -> None:
    """Title and figures; in red what is not valid."""
    design = track.design
    text = [heading(title, width, size)]
    if not design.valid:
        text.append(heading(f"NOT VALID: {_failed(design)}", width, size))
    text += filter(None, more)
    made.suptitle("\n".join(text), fontsize=size, color="black" if design.valid else LIMIT)


# --- pieces of pictures --------------------------------------------------------------------------------------------------


def _dots(count: int) -> float:
    """Size of the mark of a point [pt]."""
    return 3.8 if count <= NUMBERED else 3.0 if count <= 100 else 2.0


def _points(axes: Axes, places: Array) -> None:
    """The wanted points."""
    size = _dots(len(places))
    axes.plot(*places.T, linestyle="none", marker="o", markersize=size, color=WANTED, mew=0.0, zorder=5, gid="wanted")


def _frames(places: Array, angles: Array, length: float) -> Array:
    """Little frames, an arrow along x and a short line along y, as one line with gaps, (n, 2)."""
    x, y = np.stack([np.cos(angles), np.sin(angles)], axis=-1), np.stack([-np.sin(angles), np.cos(angles)], axis=-1)
    gap = (math.nan, math.nan)
    strokes = [(0.0, 0.0), (1.0, 0.0), gap, (0.8, 0.11), (1.0, 0.0), (0.8, -0.11), gap, (0.0, 0.0), (0.0, 0.45), gap]
    return np.stack([places + length * (a * x + b * y) for a, b in strokes], axis=1).reshape(-1, 2)


def _some(count: int, most: int) -> NDArray[np.intp]:
    """At most so many indices, evenly, the first and the last among them."""
    return np.unique(np.round(np.linspace(0.0, count - 1.0, min(count, most))).astype(int))


def _turning(axes: Axes, track: Track) -> None:
    """An arrow on the circle of the crank: which way it turns."""
    crank = track.sketch.mechanism.crank
    pivot, pin = (track.sketch.position(track.here, name)[0] for name in (crank.start, crank.end))
    arm = pin - pivot
    radius = max(float(np.linalg.norm(arm)), 1.7 * track.sketch.size)
    start = math.atan2(arm[1], arm[0])
    turn = min(math.radians(50.0), 5.0 * track.sketch.size / radius)
    if not track.design.turns:
        turn = min(turn, 0.8 * abs(track.end - track.begin))
    angles = start + track.way * np.linspace(0.25 * turn, 1.25 * turn, 33)
    arc = pivot + radius * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    drawn = FancyArrowPatch(path=Outline(arc), arrowstyle="-|>", mutation_scale=11.0, linewidth=1.5, color=CRANK)
    drawn.set(zorder=3.9, gid="turning")
    axes.add_patch(drawn)


def _ghosts(axes: Axes, track: Track) -> None:
    """The body in the poses that it takes."""
    sketch, body = track.sketch, track.task.body
    for part in sketch.parts[body]:
        if part.kind in ("bar", "plate"):
            places = sketch.placed(track.at, body, part.outline)
            for k in _some(len(places), GHOSTS):
                if k != track.first and np.all(np.isfinite(places[k])):
                    colour = to_rgb(track.colour)
                    ghost = Polygon(places[k], closed=part.kind == "plate", facecolor=(*colour, 0.06), edgecolor=(*colour, 0.35))
                    ghost.set(linewidth=1.2, zorder=1.2, gid="ghost")
                    axes.add_patch(ghost)


def _mechanism(axes: Axes, track: Track) -> list[Label]:
    """The mechanism at the first point, with the curve and the points."""
    sketch = track.sketch
    factor = sketch.scale.factor
    sketch.stage(axes)
    axes.plot(*(track.position(track.run) * factor).T, color=track.colour, linewidth=2.3, zorder=1.5, gid="run")
    if track.task.requirement.kind == "motion":
        _ghosts(axes, track)
    _points(axes, track.wanted * factor)
    sketch.pose(axes, track.here)
    _turning(axes, track)
    return sketch.letters(axes, track.here)


class Close:
    """The curve seen from near, in axes of its own: points, tolerances, deviations, poses."""

    def __init__(self, track: Track) -> None:
        self.track = track
        self.unit = scale(float(np.nanmax(np.abs(np.concatenate([track.wanted, track.generated])))), "m")
        self.length = FRAME * track.size * self.unit.factor
        self.motion = track.task.requirement.kind == "motion"
        self.shown = _some(len(track.wanted), FRAMED)

    def _ends(self) -> Array:
        """Where the lines from the wanted points end."""
        ends: Array = self.track.wanted + self.track.factor * (self.track.generated - self.track.wanted)
        return ends * self.unit.factor

    def _poses(self) -> tuple[Array, Array]:
        """Wanted and generated frames."""
        track, k = self.track, self.shown
        aim = np.arctan2(track.task.data.columns[:, 3], track.task.data.columns[:, 2])
        wanted = _frames(track.wanted[k] * self.unit.factor, aim[k], self.length)
        return wanted, _frames(track.generated[k] * self.unit.factor, track.angles(track.at)[k], self.length)

    def limits(self) -> tuple[Array, Array]:
        """Least and largest coordinates of what must be seen, with a margin, never thinner than half of their length."""
        track, factor = self.track, self.unit.factor
        radii = np.where(np.isfinite(track.tolerances), track.tolerances * track.factor, 0.0)[:, None]
        seen = [track.wanted - radii, track.wanted + radii, track.generated, track.position(track.run)]
        together = np.concatenate([*(part * factor for part in seen), self._ends(), *(self._poses() if self.motion else ())])
        low, high = finite(together).min(axis=0), finite(together).max(axis=0)
        size = high - low
        half = 0.5 * np.maximum(1.16 * size, 0.5 * 1.16 * float(np.max(size)))
        return 0.5 * (low + high) - half, 0.5 * (low + high) + half

    @property
    def ratio(self) -> float:
        """Height over width."""
        low, high = self.limits()
        return float((high - low)[1] / (high - low)[0])

    def draw(self, axes: Axes, *, sticks: bool = True) -> list[Label]:
        """Draw all of it."""
        track, factor, unit = self.track, self.unit.factor, self.unit.unit
        axes.plot(*(track.position(track.motion) * factor).T, color=track.colour, linewidth=1.2, alpha=0.55, gid="curve")
        axes.plot(*(track.position(track.run) * factor).T, color=track.colour, linewidth=2.0, label="generated curve", gid="run")
        if sticks:
            self._tolerances(axes)
            self._sticks(axes)
        if self.motion:
            wanted, found = self._poses()
            axes.plot(*found.T, color=track.colour, linewidth=2.6, alpha=0.6, zorder=4.6, label="generated pose", gid="poses")
            axes.plot(*wanted.T, color=WANTED, linewidth=1.1, zorder=4.8, label="wanted pose", gid="wanted poses")
        _points(axes, track.wanted * factor)
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
        axes.plot(*sticks.T, color=LIMIT, linewidth=1.4, zorder=4.2, label=f"deviation{self._fold}", gid="deviations")

    @property
    def _fold(self) -> str:
        return f", drawn {self.track.factor:g}-fold" if self.track.factor > 1.0 else ""

    def _numbers(self, axes: Axes) -> list[Label]:
        """Numbers of the points: of all if they are few."""
        places = self.track.wanted * self.unit.factor
        count = len(places)
        every = next(step for step in (1, 5, 10, 20, 50) if count <= NUMBERED * step or step == 50)
        chosen = [k for k in range(count) if k == 0 or (k + 1) % every == 0]
        middle = np.mean(places, axis=0)
        following = np.roll(places, -1, axis=0) - np.roll(places, 1, axis=0)
        if not self.track.task.closed:
            following[0], following[-1] = places[1] - places[0], places[-1] - places[-2]
        found = []
        for k in chosen:  # off the curve, outwards
            away = np.array([-following[k, 1], following[k, 0]])
            away = away / max(float(np.linalg.norm(away)), 1e-300)
            away = -away if float(away @ (places[k] - middle)) < 0.0 else away
            at = (float(places[k, 0]), float(places[k, 1]))
            found.append(Label(axes, at, str(k + 1), WANTED, 8.0, 2.0, (float(away[0]), float(away[1]))))
        return found


# --- the pictures --------------------------------------------------------------------------------------------------------


def _best(result: Generation) -> Track | None:
    """The best design, or the nearest miss, if there is anything to draw."""
    if result.best is None:
        return None
    track = Track(result.best)
    return track if track.reached else None


@styled
def path(result: Generation) -> Figure | None:
    """The mechanism at the first point with the curve that it draws; beside it the curve from near, with the points."""
    track = _best(result)
    if track is None:
        return None
    sketch, close = track.sketch, Close(track)
    height = 4.3
    widths = [min(max(height / ratio, 3.6), 6.6) for ratio in (sketch.ratio, close.ratio)]
    width = sum(widths) + 1.0
    made = figure(width, height + 1.75)
    left, right = made.subplots(1, 2, width_ratios=widths)
    labels = _mechanism(left, track) + close.draw(right)
    crank = f"point {track.first + 1}: crank at {math.degrees(track.design.crank_angles[track.first]):.2f}°"
    left.set_title(heading(f"{crank}; {_assembly(track.design)}", widths[0], 9.5), fontsize=9.5)
    what = "poses" if close.motion else "points"
    right.set_title(heading(f"{what} and generated curve", widths[1], 9.5), fontsize=9.5)
    told = _wrapped(_figures(track), width - 0.4, 10.0, "; "), _wrapped(_sizes(track), width - 0.4, 10.0, "   ")
    _title(made, track, width - 0.4, track.task.title, *told)
    made.legend(*right.get_legend_handles_labels(), loc="outside lower center", ncols=5, frameon=False, fontsize=8.5)
    settle(made, labels)
    return made


@styled
def errors(result: Generation) -> Figure | None:
    """Deviation at every point: how far, in which direction, and of poses by which angle."""
    track = _best(result)
    if track is None:
        return None
    turned = track.design.measured.turned
    count = 1 + (not track.exact) + (turned is not None)
    made = figure(7.6, 1.5 + 1.95 * count)
    panels = made.subplots(count, 1, sharex=True, squeeze=False)[:, 0]
    _distances(panels[0], track)
    if not track.exact:
        _directions(panels[1], track)
    if turned is not None:
        _turned(panels[-1], track)
    numbers = len(track.wanted)
    panels[-1].set_xlim(0.4, numbers + 0.6)
    every = FixedLocator(range(1, numbers + 1)) if numbers <= NUMBERED else MaxNLocator(12, integer=True)
    panels[-1].xaxis.set_major_locator(every)
    panels[-1].set_xlabel("pose" if turned is not None else "point")
    _title(made, track, 7.2, f"{track.task.title}: deviations", _wrapped(_figures(track), 7.2, 10.0, "; "))
    made.align_ylabels()
    return made


def _bars(
    axes: Axes, values: Array, colour: str, gid: str, label: str | None = None, place: float = 0.0, wide: float = 0.6
) -> None:
    """A bar for each point; a stepped line where they are many."""
    numbers = np.arange(1.0, len(values) + 1.0)
    if len(values) <= BARS:
        drawn = axes.bar(numbers + place, values, width=wide, color=colour, label=label, zorder=2)
        for bar in drawn:
            bar.set_gid(gid)
    else:
        axes.plot(numbers, values, drawstyle="steps-mid", color=colour, linewidth=1.2, label=label, gid=gid)


def _rounding(axes: Axes, values: Array, level: float, unit: str) -> None:
    """Deviations that are nothing but rounding, on a logarithmic axis, with the level below which they are."""
    numbers = np.arange(1.0, len(values) + 1.0)
    low = 1e-9 * level
    axes.plot(numbers, np.maximum(values, low), linestyle="none", marker="o", markersize=4, color=QUIET, gid="exact")
    axes.axhline(level, color=FOUND, linewidth=1.1, linestyle="--", gid="level")
    axes.text(
        0.99, 0.96, f"exact to rounding: all below {level:.1e} {unit}", transform=axes.transAxes, ha="right", va="top", fontsize=9
    )
    axes.set_yscale("log")
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:.0e}"))
    axes.set_ylim(low / 3.0, 1e4 * level)


def _distances(axes: Axes, track: Track) -> None:
    distances, tolerances = track.design.measured.distances, track.tolerances
    if track.exact:
        unit = track.sketch.scale
        _rounding(axes, distances * unit.factor, LEVEL * track.task.size * unit.factor, unit.unit)
        axes.set_ylabel(f"distance [{unit.unit}]")
        return
    largest = float(np.nanmax(distances))
    unit = _fit(largest, track.sketch.scale)
    _bars(axes, distances * unit.factor, FOUND, "distances")
    known = np.isfinite(tolerances)
    top = largest
    if np.any(known):
        seen = known & (tolerances <= 4.0 * largest)
        top = max(top, float(np.max(tolerances[seen], initial=0.0)))
        numbers = np.arange(1.0, len(distances) + 1.0)[seen]
        edges = np.stack([numbers - 0.5, numbers + 0.5, np.full_like(numbers, np.nan)], axis=1).ravel()
        heights = np.repeat(tolerances[seen] * unit.factor, 3)
        axes.plot(edges, heights, color=ALLOWED, linewidth=1.8, label="tolerance", gid="tolerance")
        if not np.all(seen[known]):
            least = _length(float(np.min(tolerances[known & ~seen])), track.sketch.scale)
            axes.plot(
                [],
                [],
                linestyle="none",
                label=f"tolerances from {least} on lie above" if np.any(seen) else f"tolerance, {least}, lies above",
            )
        axes.legend(loc="upper right", frameon=False, fontsize=8.5, ncols=2)
    axes.set_ylim(0.0, 1.25 * top * unit.factor)
    axes.set_ylabel(f"distance [{unit.unit}]")


def _directions(axes: Axes, track: Track) -> None:
    """Components along the curve, in the direction of motion, and across, to the left of it; x and y where it stands still."""
    miss = track.generated - track.wanted
    speed = track.way * track.at.velocity(track.task.requirement.point)
    fast = np.linalg.norm(speed, axis=1)
    largest = float(np.nanmax(np.linalg.norm(miss, axis=1)))
    unit = _fit(largest, track.sketch.scale)
    parts = {"in x": miss[:, 0], "in y": miss[:, 1]}
    if np.all(np.isfinite(fast)) and float(np.min(fast)) > 1e-9 * track.task.size:
        (tx, ty), (x, y) = (speed / fast[:, None]).T, miss.T
        parts = {"along the curve": tx * x + ty * y, "across, to the left": tx * y - ty * x}
        if float(np.max(np.abs(parts["along the curve"]))) < NOTHING * largest:
            parts = {"across the curve, to the left; along it none": parts["across, to the left"]}
    two = len(parts) > 1
    for k, (name, values) in enumerate(parts.items()):
        place, wide = ((k - 0.5) * 0.36, 0.34) if two else (0.0, 0.6)
        _bars(axes, values * unit.factor, QUIET if two and k == 0 else FOUND, name, name, place, wide)
    axes.axhline(0.0, color=WANTED, linewidth=0.8)
    low, high = axes.get_ylim()
    axes.set_ylim(low, high + 0.3 * (high - low))
    axes.set_ylabel(f"generated\nminus wanted [{unit.unit}]")
    axes.legend(loc="upper right", frameon=False, fontsize=8.5, ncols=2)


def _turned(axes: Axes, track: Track) -> None:
    turned = track.design.measured.turned
    assert turned is not None
    if _exact_angles(track):
        _rounding(axes, np.degrees(np.abs(turned)), math.degrees(LEVEL), "deg")
    else:
        _bars(axes, np.degrees(turned), FOUND, "turned")
        axes.axhline(0.0, color=WANTED, linewidth=0.8)
    axes.set_ylabel("generated minus\nwanted angle [deg]")


# --- several designs -----------------------------------------------------------------------------------------------------


def kin(designs: tuple[Design, ...]) -> dict[int, int]:
    """Of designs, by number from 0, the earlier one whose cognate they are: another four-bar that draws the same curve."""
    linkages = [design.coupler_linkage for design in designs]
    found: dict[int, int] = {}
    for j, linkage in enumerate(linkages):
        for i in range(j):
            if linkage is not None and any(_alike(linkage, other) for other in _relatives(designs[i])):
                found[j] = i
                break
    return found


def _relatives(design: Design) -> Iterator[CouplerLinkage]:
    for cognate in design.cognates:
        yield cognate.linkage
        yield cognate.driven_from_rocker.linkage


def _alike(one: CouplerLinkage, other: CouplerLinkage) -> bool:
    names = ("crank", "coupler", "rocker", "frame", "along", "across", "x", "y")
    size = max(*one.lengths, abs(one.along), abs(one.across))
    return all(abs(getattr(one, name) - getattr(other, name)) <= ALIKE * size for name in names)


@styled
def designs(result: Generation) -> Figure | None:
    """The distinct designs side by side on one scale, and which of them are cognates."""
    if len(result.designs) < 2:
        return None
    related = kin(result.designs)
    tracks = [Track(design) for design in result.designs[:PANELS]]
    sizes = np.array([np.ptp(track.sketch.limits, axis=1) / track.sketch.scale.factor for track in tracks])
    reach = sizes.max(axis=1)
    common = sizes[reach <= APART * float(np.min(reach))].max(axis=0)
    columns = beside(len(tracks))
    rows = -(-len(tracks) // columns)
    panel = 3.9 if columns > 2 else 4.6
    tall = min(max(float(common[1] / common[0]), 0.4), 1.5)
    made = figure(panel * columns, ((panel - 0.6) * tall + 1.3) * rows + 0.6)
    labels: list[Label] = []
    panels = list(made.subplots(rows, columns, squeeze=False).flat)
    for number, (axes, track) in enumerate(zip(panels, tracks, strict=False)):
        labels += _mechanism(axes, track)
        smaller = max(1.0, float(np.max(sizes[number] / common)))
        half = 0.5 * common * smaller * track.sketch.scale.factor
        middle = np.mean(track.sketch.limits, axis=1)
        axes.set(xlim=(middle[0] - half[0], middle[0] + half[0]), ylim=(middle[1] - half[1], middle[1] + half[1]))
        told = [f"{number + 1}: {_objective(track)}", f"{_transmission(track.design)}", _assembly(track.design)]
        if number in related:
            told.append(f"cognate of {related[number] + 1}: the same curve")
        if smaller > 1.0:
            told.append(f"drawn {smaller:.2g} times smaller than the others")
        axes.set_title("\n".join(heading(line, panel - 0.3, 9.0) for line in told if line), fontsize=9.0)
    for axes in panels[len(tracks) :]:
        axes.remove()
    count = len(result.designs)
    many = f"{count} distinct designs, best first" + (f"; the first {PANELS}" if count > PANELS else "")
    made.suptitle(heading(f"{tracks[0].task.title}: {many}", panel * columns - 0.4, 10.5), fontsize=10.5)
    settle(made, labels)
    return made


# --- film ----------------------------------------------------------------------------------------------------------------


class Passing(Sketch):
    """A mechanism whose point passes the wanted points, which light up."""

    def __init__(self, track: Track) -> None:
        super().__init__(track.motion)
        self.widen(track.wanted * self.scale.factor)
        self.track, self.close = track, Close(track)
        self.strip: Axes | None = None

    def lay(self, axes: Axes) -> None:
        """Draw the curve from near; there the points light up too."""
        self.strip = axes
        self.close.draw(axes, sticks=False)

    def pose(self, axes: Axes, motion: Motion, k: int = 0) -> list[Artist]:
        """Draw the k-th position, the points that are passed, the pose of the body."""
        found = super().pose(axes, motion, k)
        track = self.track
        assert self.strip is not None
        passed = track.way * (motion.crank_angle[k] - track.design.crank_angles) >= -1e-9
        for place, factor in ((axes, self.scale.factor), (self.strip, self.close.unit.factor)):
            x, y = (track.wanted[passed] * factor).T
            size = _dots(len(track.wanted)) + 1.0
            lit = Line2D(x, y, linestyle="none", marker="o", markersize=size, color=LIT, mec=WANTED, mew=0.6, zorder=6, gid="lit")
            more = [lit]
            if self.close.motion:
                length = self.close.length * factor / self.close.unit.factor
                frame = _frames(track.position(motion)[k : k + 1] * factor, track.angles(motion)[k : k + 1], length)
                more.append(Line2D(*frame.T, color=CRANK, linewidth=1.8, zorder=7, gid="pose"))
            for artist in more:
                place.add_artist(artist)
            found += more
        return found


@styled
def frames(result: Generation, count: int = FRAMES) -> list[Image.Image]:
    """The best design on its way along the curve, once round or to and fro between the first point and the last."""
    track = _best(result)
    if track is None:
        return []
    sketch = Passing(track)
    steps = track.begin + track.way * np.linspace(0.0, TURN, count, endpoint=False)
    if not track.design.turns:
        steps = there_and_back(track.begin, track.end, count)
    motion = track.sweep(steps)
    marks = track.position(motion) * sketch.close.unit.factor

    def points(axes: Axes) -> None:
        _points(axes, track.wanted * sketch.scale.factor)

    title = track.task.title if track.design.valid else f"NOT VALID: {track.task.title}"
    return film(sketch, motion, sketch.lay, marks, title, more=points)


PICTURES: dict[str, Callable[[Generation], Figure | None]] = {"path": path, "errors": errors, "designs": designs}
