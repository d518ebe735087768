"""Drawing of any chain of dyads in any position, with its ground.

Bodies keep their shape, so each is built once from parts in its own axes (bars, plates, blocks, slots) and then placed.
"""

import math
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Polygon
from numpy.typing import NDArray

from optlink.dynamics.loads import Spring
from optlink.dynamics.machine import Machine
from optlink.linkage.jet import as_jet
from optlink.linkage.mechanism import FRAME, Guide
from optlink.linkage.motion import Motion
from optlink.linkage.vector2d import TURN, Array, Vector
from optlink.report.labels import Label
from optlink.report.regions import Outline, Region
from optlink.report.shapes import Part, finite, hatching, hull, in_line, rectangle, spread, stem, zigzag
from optlink.report.style import BODIES, CRANK, GROUND, HALO, LIMIT, MUTED, Scale, figure, scale, short_name

FAR_RATIO = 8.0  # positions beyond this multiple of the median distance from the crank pivot do not set the scale
SYMBOL_SHARE = 0.035  # height of a ground pivot
FACES = {"plate": (0.22, 2.2, 2.8, "round"), "slot": (0.13, 1.1, 2.6, "miter"), "block": (None, 1.5, 3.2, "round")}
"""Opacity (None: a tint without), line width, order and corners of the parts of bodies."""


class Sketch:
    """Drawing of a mechanism with one scale, symbol size and set of colours for all its positions.

    Extent, traces and slider strokes are those of the whole motion; centroids and springs those of the machine; `regions`
    those of the limits; `share` is the height of a ground pivot as a share of the extent.
    """

    def __init__(
        self,
        motion: Motion,
        machine: Machine | None = None,
        share: float = SYMBOL_SHARE,
        regions: Sequence[Region] = (),
    ) -> None:
        self.motion, self.mechanism = motion, motion.mechanism
        self.names = list(self.mechanism.owners)
        self.points = np.array([motion.position(name) for name in self.names])  # m, (points, positions, 2)
        self.near = self._in_sight()
        extent = max(np.max(spread(finite(self.points[:, self.near]))), 1e-30)
        self.scale: Scale = scale(extent, "m")
        self.size = share * extent * self.scale.factor
        bodies = [body for body in self.mechanism.bodies if body != self.mechanism.crank.body]
        self.colours = {body: BODIES[k % len(BODIES)] for k, body in enumerate(bodies)}
        self.colours[self.mechanism.crank.body] = CRANK
        self.travel = {guide.name: self._travel(guide) for guide in self.mechanism.guides}
        self.parts = {body: self._parts(body) for body in self.mechanism.bodies}
        self.springs = [load for load in machine.loads if isinstance(load, Spring)] if machine else []
        inertias = machine.inertias if machine else {}
        self.centroids = {
            body: np.array([[i.along, i.across]], dtype=float) * self.scale.factor for body, i in inertias.items() if i.mass > 0.0
        }
        self.ground = self._ground_lines()
        self.low, self.high = self._extent()
        self.regions = tuple(regions)
        factor = self.scale.factor
        ends = self.low / factor, self.high / factor, self.size / factor
        for region in self.regions:
            self.widen(region.features(*ends) * factor)

    # --- positions ---------------------------------------------------------------------------------------------------

    def _in_sight(self) -> NDArray[np.bool_]:
        """Return the positions in which no point is so far away (parallel lines) that the others would vanish."""
        crank = self.motion.position(self.mechanism.crank.start)
        distance = np.where(np.isfinite(self.points).all(axis=-1), np.linalg.norm(self.points - crank, axis=-1), 0.0).max(axis=0)
        near: NDArray[np.bool_] = distance <= FAR_RATIO * np.median(distance)
        return near

    def position(self, motion: Motion, name: str) -> Array:
        """Return the positions of a point in the display unit, shape (positions, 2)."""
        return motion.position(name) * self.scale.factor

    def placed(self, motion: Motion, body: str, outline: Array) -> Array:
        """Return the positions (positions, corners, 2) of an outline (corners, 2) in the axes of a body, in the display unit."""
        shape = motion.crank_angle.shape
        with np.errstate(all="ignore"):  # at a dead centre of a group its rates are infinite or NaN
            direction = motion.pose.direction(body)
        x, y = (np.broadcast_to(as_jet(part).value, shape)[:, None] for part in direction)
        start = self.position(motion, self.mechanism.bodies[body].start)[:, None, :]
        along, across = outline[:, 0], outline[:, 1]
        return np.asarray(start + np.stack([along * x - across * y, along * y + across * x], axis=-1))

    def _vector(self, vector: Vector) -> Array:
        return np.array([float(as_jet(part).value) for part in vector]) * self.scale.factor

    def _points_of(self, body: str) -> Array:
        """Return the named points of a body in its own axes, without duplicates."""
        pose = self.motion.pose
        points: list[Array] = []
        for point, bodies in self.mechanism.owners.items():
            if body in bodies:
                at = self._vector(pose.local(body, point))
                if all(np.max(np.abs(at - other)) > 1e-3 * self.size for other in points):
                    points.append(at)
        return np.array(points).reshape(-1, 2)

    def _line(self, guide: Guide, body: str) -> tuple[Array, Array]:
        point, direction = self.motion.pose.local_line(guide, body)
        return self._vector(point), self._vector(direction) / self.scale.factor

    def _travel(self, guide: Guide) -> tuple[float, float]:
        slides = np.asarray(self.motion.slide(guide.name).value) * self.scale.factor
        finite_slides = slides[np.isfinite(slides) & self.near]
        return (float(finite_slides.min()), float(finite_slides.max())) if finite_slides.size else (0.0, 0.0)

    # --- shapes of the bodies ------------------------------------------------------------------------------------------

    def _is_rod(self, guide: Guide) -> bool:
        """Return whether the slider is a rod along the line in a small guide, which is then drawn as the block."""
        if guide.on == FRAME or len(self._points_of(guide.on)) > 1:
            return False
        points, (point, direction) = self._points_of(guide.slider), self._line(guide, guide.slider)
        off = (points - point) @ np.array([-direction[1], direction[0]])
        return len(points) > 1 and bool(np.all(np.abs(off) < 0.05 * self.size))

    def _parts(self, body: str) -> list[Part]:
        points = self._points_of(body)
        parts: list[Part] = []
        half = np.array([1.0, 0.62]) * self.size
        for guide in self.mechanism.guides:
            if body not in guide.bodies:
                continue
            rod = self._is_rod(guide)
            point, direction = self._line(guide, body)
            low, high = self.travel[guide.name]
            if rod and body == guide.slider:  # long enough to reach through its block
                points = np.concatenate([points, [point - (high + half[0]) * direction, point - (low - half[0]) * direction]])
            elif (body == guide.slider) != rod:
                parts.append(Part("block", rectangle(point, direction, -half[0], half[0], half[1])))
            else:
                low, high = low - 1.25 * half[0], high + 1.25 * half[0]
                parts.append(Part("slot", rectangle(point, direction, low, high, 1.2 * half[1])))
                arm = stem(points, np.array([point + low * direction, point + high * direction]))
                if np.linalg.norm(arm[1] - arm[0]) > 0.5 * self.size:
                    parts.append(Part("bar", arm))
        if len(points) > 1:
            order = in_line(points, 0.05 * self.size)
            parts.append(Part("plate", hull(points)) if order is None else Part("bar", points[order[[0, -1]]]))
        return parts

    # --- ground ----------------------------------------------------------------------------------------------------------

    def _ground_lines(self) -> list[tuple[Array, float, bool]]:
        """Return the ground pivots and rails as (line, width, filled white)."""
        lines: list[tuple[Array, float, bool]] = []
        middle = np.mean(finite(self.points[:, self.near] * self.scale.factor), axis=0)
        s = self.size
        anchors = {point for spring in self.springs for body, point in spring.ends if body == FRAME}
        for name in self.mechanism.ground:
            at = self._vector(self.motion.pose.points[name])
            if name in self.mechanism.pins or name in anchors:
                lines.append((at + s * np.array([[0.0, 0.0], [-0.55, -1.0], [0.55, -1.0], [0.0, 0.0]]), 1.1, True))
                lines.append((at + s * np.array([[-0.9, -1.0], [0.9, -1.0]]), 1.1, False))
                strokes = hatching(at - s * np.array([0.9, 1.0]), np.array([1.0, 0.0]), 1.8 * s, -0.35 * s, 0.25 * s)
                lines.append((strokes, 0.8, False))
            else:
                cross = np.array([[-1.0, 0.0], [1.0, 0.0], [np.nan, np.nan], [0.0, -1.0], [0.0, 1.0]])
                lines.append((at + 0.35 * s * cross, 1.0, False))
        for guide in self.mechanism.guides:
            if guide.on == FRAME:
                point, direction = self._line(guide, FRAME)
                left = np.array([-direction[1], direction[0]])
                offset = float((middle - point) @ left)
                side = -math.copysign(1.0, offset if abs(offset) > 0.5 * s else left[1] + 1e-9 * left[0])
                low, high = (end + room * 1.5 * s for end, room in zip(self.travel[guide.name], (-1.0, 1.0), strict=True))
                begin = point + low * direction + side * 0.62 * s * left
                lines.append((np.array([begin, begin + (high - low) * direction]), 1.3, False))
                lines.append((hatching(begin, direction, high - low, side * 0.35 * s, 0.35 * s), 0.8, False))
        return lines

    # --- extent ----------------------------------------------------------------------------------------------------------

    def _extent(self) -> tuple[Array, Array]:
        """Return the least and largest coordinates of everything that is drawn."""
        corners = [finite(self.points[:, self.near] * self.scale.factor), *(finite(line) for line, _, _ in self.ground)]
        for body, parts in self.parts.items():
            outlines = [part.outline for part in parts] + ([self.centroids[body]] if body in self.centroids else [])
            corners += [finite(self.placed(self.motion, body, outline)[self.near]) for outline in outlines]
        together = np.concatenate(corners)
        return np.min(together, axis=0), np.max(together, axis=0)

    def widen(self, points: Array) -> None:
        """Extend the drawing to further points (n, 2), in the display unit."""
        kept = finite(points)
        if kept.size:
            self.low, self.high = np.minimum(self.low, kept.min(axis=0)), np.maximum(self.high, kept.max(axis=0))

    @property
    def limits(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Limits of x and y with a margin; the aspect ratio is limited."""
        size = self.high - self.low
        room = 0.07 * np.max(size)
        widths = np.maximum(size + 2.0 * room, 0.22 * np.max(size))
        middle = 0.5 * (self.low + self.high)
        (x0, y0), (x1, y1) = middle - 0.5 * widths, middle + 0.5 * widths
        return (float(x0), float(x1)), (float(y0), float(y1))

    @property
    def outlines(self) -> list[Outline]:
        """The regions, as far as they are in the drawing."""
        factor = self.scale.factor
        low, high = np.array(self.limits).T / factor
        return [region.outline(low, high, self.size / factor).scaled(np.full(2, factor)) for region in self.regions]

    @property
    def ratio(self) -> float:
        """Height divided by width."""
        (x0, x1), (y0, y1) = self.limits
        return (y1 - y0) / (x1 - x0)

    def bare_figure(self, width: float, height: float, *, traces: bool = True) -> tuple[Figure, Axes]:
        """Return a figure [inch] that the fixed parts of the drawing fill, without scales, and its axes."""
        fig = figure(width, height, None)
        self.stage(axes := fig.add_axes((0.0, 0.0, 1.0, 1.0)), traces=traces)
        half = 0.5 * np.max(np.ptp(self.limits, axis=1) / (width, height)) * np.array([[width], [height]])
        axes.axis((*(np.mean(self.limits, axis=1, keepdims=True) + half * [-1.0, 1.0]).ravel(),))
        axes.set_axis_off()
        return fig, axes

    # --- drawing -----------------------------------------------------------------------------------------------------------

    def stage(self, axes: Axes, *, traces: bool = True) -> None:
        """Draw the fixed parts: equal scales, ground with rails, traces of the moving points."""
        for line, width, filled in self.ground:
            if filled:
                axes.add_patch(Polygon(line, closed=True, facecolor="white", edgecolor=GROUND, linewidth=width, zorder=2))
            else:
                axes.plot(line[:, 0], line[:, 1], color=GROUND, linewidth=width, zorder=2)
        for region in self.outlines:
            colour = LIMIT if region.violated else GROUND
            for line, width, dashed in region.lines:
                style = (0, (4, 3)) if dashed else "-"
                axes.plot(line[:, 0], line[:, 1], color=colour, linewidth=width, linestyle=style, zorder=0.9, gid=region.name)
            if np.all(np.isfinite(region.label)):
                text = axes.text(
                    float(region.label[0]),
                    float(region.label[1]),
                    region.name,
                    color=colour,
                    fontsize=8.5,
                    ha="center",
                    va="center",
                    zorder=0.9,
                )
                text.set(path_effects=HALO, clip_on=True)
        if traces:
            for name, bodies in self.mechanism.owners.items():
                if FRAME not in bodies:
                    path = np.where(self.near[:, None], self.position(self.motion, name), np.nan)
                    free = len(bodies) == 1 and name != self.mechanism.bodies[bodies[0]].start
                    width, alpha = (1.3, 0.7) if free else (0.9, 0.45)
                    color = self.colours[bodies[0] if bodies[0] == self.mechanism.crank.body else bodies[-1]]
                    axes.plot(path[:, 0], path[:, 1], color=color, linewidth=width, alpha=alpha, zorder=1, gid=f"trace {name}")
        axes.set(xlim=self.limits[0], ylim=self.limits[1], xlabel=f"x [{self.scale.unit}]", ylabel=f"y [{self.scale.unit}]")
        axes.set_aspect("equal")

    def pose(self, axes: Axes, motion: Motion, k: int = 0) -> list[Artist]:
        """Draw position `k` of a motion and return the artists; the gid of each is its body, point or spring."""
        artists: list[Artist] = []
        for body, parts in self.parts.items():
            color = self.colours[body]
            first = body == self.mechanism.crank.body
            tint = tuple(1.0 - 0.35 * (1.0 - c) for c in to_rgb(color))
            for part in parts:
                xy = self.placed(motion, body, part.outline)[k]
                if not np.all(np.isfinite(xy)):
                    continue
                if part.kind == "bar":
                    width, above = (3.8, 3.4) if first else (3.0, 3.0)
                    artists.append(Line2D(*xy.T, color=color, linewidth=width, solid_capstyle="round", zorder=above, gid=body))
                    continue
                opacity, width, above, joint = FACES[part.kind]
                face = tint if opacity is None else (*to_rgb(color), opacity)
                look: dict[str, Any] = {"facecolor": face, "edgecolor": color, "linewidth": width, "joinstyle": joint}
                artists.append(Polygon(xy, closed=True, zorder=above, gid=body, **look))
        artists += self._springs(motion, k)
        artists += self._markers(motion, k)
        for artist in artists:
            axes.add_artist(artist)
        return artists

    def _springs(self, motion: Motion, k: int) -> Iterable[Line2D]:
        for spring in self.springs:
            p, q = (self.position(motion, point)[k] for _, point in spring.ends)
            along, across = q - p, np.array([p[1] - q[1], q[0] - p[0]]) / max(float(np.linalg.norm(q - p)), 1e-30)
            xy = np.array([p + share * along + swing * across for share, swing in zigzag(self.size)])
            yield Line2D(xy[:, 0], xy[:, 1], color=MUTED, linewidth=1.2, zorder=2.9, gid=spring.name)

    def _markers(self, motion: Motion, k: int) -> Iterable[Line2D]:
        """Yield pins as rings, free points as dots in the colour of their body, and centroids as rings with a cross."""
        for body, centroid in self.centroids.items():
            at = self.placed(motion, body, centroid)[k, 0]
            points = finite(np.array([self.position(motion, name)[k] for name in self.names]))
            if np.all(np.isfinite(at)) and np.min(np.linalg.norm(points - at, axis=1)) > 0.4 * self.size:
                for artist in _centroid(self.colours[body]):
                    artist.set(xdata=[at[0]], ydata=[at[1]], zorder=3.6, gid=f"centroid {body}")
                    yield artist
        for name, bodies in self.mechanism.owners.items():
            if len(bodies) == 1 and bodies[0] != FRAME:
                x, y = self.position(motion, name)[k]
                color = self.colours[bodies[0]]
                yield Line2D([x], [y], linestyle="none", marker="o", markersize=3.6, mfc=color, mec=color, zorder=4, gid=name)
        pins = np.array([self.position(motion, name)[k] for name in self.mechanism.pins]).reshape(-1, 2)
        yield Line2D(
            pins[:, 0], pins[:, 1], linestyle="none", marker="o", markersize=5.5, mfc="white", mec=GROUND, zorder=4, gid="pins"
        )

    def letters(self, axes: Axes, motion: Motion) -> list[Label]:
        """Return labels with the names of all points at the first position, for `labels.place_labels`."""
        return [
            Label(axes, (float(x), float(y)), short_name(name), GROUND, clear=2.5)
            for name in self.names
            for x, y in self.position(motion, name)[:1]
        ]

    def show(self, axes: Axes, motion: Motion, *, traces: bool = True) -> list[Label]:
        """Draw the fixed parts and the first position of a motion, and return the labels of its points."""
        self.stage(axes, traces=traces)
        self.pose(axes, motion)
        return self.letters(axes, motion)

    def add_legend(self, fig: Figure, columns: int = 9, **extra: Artist) -> None:
        """Draw the legend below a figure: bodies by colour, the centroid symbol, and others (underscores stand for spaces)."""
        entries: dict[str, Any] = {body: Line2D([], [], color=self.colours[body], linewidth=3.0) for body in self.parts}
        entries |= {"centroid": tuple(_centroid(GROUND))} if self.centroids else {}
        entries |= {name.replace("_", " "): artist for name, artist in extra.items()}
        style: dict[str, Any] = {"loc": "outside lower center", "frameon": False, "fontsize": 8.5}
        fig.legend([*entries.values()], [*entries], ncols=min(len(entries), columns), **style)

    def arrows(self, motion: Motion, names: Sequence[str], longest: float) -> dict[str, tuple[Array, Array]]:
        """Return velocity arrows (begin, end) of points by name at the first position; slow points are left out.

        `longest` is the length of the arrow of the fastest point, in the display unit.
        """
        speeds = {name: motion.velocity(name)[0] for name in names}
        top = max((np.linalg.norm(v) for v in speeds.values() if np.all(np.isfinite(v))), default=0.0)
        arrows = {}
        for name, v in speeds.items():
            if np.all(np.isfinite(v)) and np.linalg.norm(v) > 0.01 * top:
                at = self.position(motion, name)[0]
                arrows[name] = (at, at + v * longest / top)
        return arrows


def merged_positions(positions: Iterable[tuple[str, float]], *, periodic: bool = True) -> dict[str, float]:
    """Return named crank angles [rad], where equal angles share a name; `periodic` angles are equal a whole turn apart."""
    merged: dict[str, float] = {}
    for name, at in positions:
        same = next((k for k, v in merged.items() if abs(math.remainder(v - at, TURN) if periodic else v - at) < 1e-6), name)
        merged = {f"{k} = {name}" if k == same else k: v for k, v in merged.items()} if same in merged else {**merged, name: at}
    return merged


def _centroid(colour: str) -> list[Line2D]:
    """Return the centroid symbol: a ring and a cross."""
    return [Line2D([], [], linestyle="none", marker=m, markersize=5.5, mfc="white", mec=colour, mew=0.9) for m in ("o", "+")]
