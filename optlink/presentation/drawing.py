"""Drawing of a mechanism in any position by matplotlib."""

import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Polygon
from PIL import Image

from optlink.linkage.motion import Motion
from optlink.linkage.vector2d import TURN, Array
from optlink.presentation.chart_mpl import draw_into
from optlink.presentation.chart_spec import ChartSpec
from optlink.presentation.labels import Label
from optlink.presentation.scene import LAYERS, Scene, Shape
from optlink.presentation.shapes import finite
from optlink.presentation.style import CRANK, GROUND, HALO, figure, heading, legible, one_palette, styled


class Sketch(Scene):
    """A scene drawn into axes."""

    def bare_figure(self, width: float, height: float, *, traces: bool = True) -> tuple[Figure, Axes]:
        """Return a figure [inch] that the fixed parts of the drawing fill, without scales, and its axes."""
        fig = figure(width, height, None)
        self.stage(axes := fig.add_axes((0.0, 0.0, 1.0, 1.0)), traces=traces)
        half = 0.5 * np.max(np.ptp(self.limits, axis=1) / (width, height)) * np.array([[width], [height]])
        axes.axis((*(np.mean(self.limits, axis=1, keepdims=True) + half * [-1.0, 1.0]).ravel(),))
        axes.set_axis_off()
        return fig, axes

    def stage(self, axes: Axes, *, traces: bool = True) -> None:
        """Draw the fixed parts: equal scales, ground with rails, traces of the moving points, regions."""
        for shape in self.fixed_shapes(traces=traces):
            axes.add_artist(_artist(shape, shape.line))
        for region in self.outlines:
            if np.all(np.isfinite(region.label)):
                text = axes.text(
                    region.label[0], region.label[1], region.name, ha="center", va="center", color=region.colour, fontsize=8.5
                )
                text.set(zorder=LAYERS["regions"], path_effects=HALO, clip_on=True)
        axes.set(xlim=self.limits[0], ylim=self.limits[1], xlabel=f"x [{self.scale.unit}]", ylabel=f"y [{self.scale.unit}]")
        axes.set_aspect("equal")

    def pose(self, axes: Axes, motion: Motion, k: int = 0) -> list[Artist]:
        """Draw position `k` of a motion and return the artists; the gid of each is its body, point or spring."""
        joints = finite(np.array([self.position(motion, name)[k] for name in self.names]))
        artists: list[Artist] = []
        for shape in self.moving_shapes:
            xy = self.located(shape, motion)[k]
            if not np.all(np.isfinite(xy[[0, -1]])):
                continue
            away = np.linalg.norm(joints - np.nanmean(xy, axis=0), axis=1)
            if shape.layer != "centroid" or np.min(away) > 0.4 * self.size:
                artists.append(axes.add_artist(_artist(shape, xy)))
        return artists

    def letters(self, axes: Axes, motion: Motion) -> list[Label]:
        """Return labels with the names of all points at the first position, for `labels.place_labels`."""
        return [
            Label(axes, (float(x), float(y)), self.captions[name], GROUND, clear=2.5)
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
        entries: dict[str, Any] = {
            body: Line2D([], [], color=self.colours[body], linewidth=3.0) for body in self.mechanism.bodies
        }
        entries |= {"centroid": tuple(_centroid())} if self.centroids else {}
        entries |= {name.replace("_", " "): artist for name, artist in extra.items()}
        columns = min(len(entries), columns)
        fig.legend(entries.values(), entries, loc="outside lower center", ncols=columns, frameon=False, fontsize=8.5)

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
    """Return named crank angles [rad]; equal ones share a name, other ones of one name are numbered.

    `periodic` angles are equal a whole turn apart.
    """
    merged: dict[str, float] = {}
    for name, at in positions:
        same = next((k for k, v in merged.items() if abs(math.remainder(v - at, TURN) if periodic else v - at) < 1e-6), None)
        if same is None:
            count = sum(k == name or k.startswith(f"{name} (") for k in merged)
            merged[f"{name} ({count + 1})" if count else name] = at
        elif name not in same.split(" = "):
            merged = {f"{k} = {name}" if k == same else k: v for k, v in merged.items()}
    return merged


def _artist(shape: Shape, xy: Array) -> Artist:
    """Return the artist of a shape at places (n, 2) of its points."""
    look: dict[str, Any] = {"zorder": LAYERS[shape.layer], "linewidth": shape.width}
    look["gid"] = {"traces": f"trace {shape.name}", "centroid": f"centroid {shape.name}"}.get(shape.layer, shape.name or None)
    if shape.radius:
        look |= {"linestyle": "none", "marker": "o", "markersize": 2.0 * shape.radius}
        return Line2D(*xy.T, mfc=shape.fill, mec=shape.colour, mew=shape.width, **look)
    if shape.fill:
        joint = "miter" if shape.layer == "slot" else "round"
        rgb, face = np.array(to_rgb(shape.fill)), shape.face
        tint = (*(1.0 - face * (1.0 - rgb)), 1.0) if shape.layer == "block" else (*rgb, face)  # a block hides its slot
        return Polygon(xy, closed=True, facecolor=tint, edgecolor=shape.colour, joinstyle=joint, **look)
    look |= {"linestyle": (0, shape.dashes) if shape.dashed else "-", "solid_capstyle": "round"}
    return Line2D(*xy.T, color=shape.colour, alpha=shape.opacity, **look)


def _centroid() -> list[Line2D]:
    """Return the centroid symbol: a ring and a cross."""
    return [Line2D([], [], linestyle="none", marker=m, markersize=5.5, mfc="white", mec=GROUND, mew=0.9) for m in ("o", "+")]


# Animation of a mechanism beside a curve with a moving marker.

STACKED_RATIO = 0.42  # ratio of height to width below which the curve is drawn below the mechanism


@styled
def film(
    sketch: Sketch,
    steps: Motion,
    curve: ChartSpec | Callable[[Axes], object],
    marks: Array,
    titles: Sequence[str],
    *,
    more: Callable[[Axes], object] | None = None,
) -> list[Image.Image]:
    """Draw every position of a motion, one frame each with a common palette, beside a curve with a moving marker.

    `curve` is a chart, or draws itself into axes; `marks` (frames, 2) are the places of the marker there, NaN for none; `more`
    draws further fixed parts into the axes of the mechanism.
    """
    flat = sketch.ratio < STACKED_RATIO
    if flat:
        fig = figure(7.8, 7.2 * sketch.ratio + 3.0)
        stage, strip = fig.subplots(2, 1, height_ratios=(7.2 * sketch.ratio + 0.5, 1.9))
    else:
        fig = figure(8.4, min(max(4.3 * sketch.ratio + 0.9, 3.5), 5.2))
        stage, strip = fig.subplots(1, 2, width_ratios=(1.25, 1.0))
    fig.set_dpi(80)
    canvas = FigureCanvasAgg(fig)
    sketch.stage(stage)
    if more:
        more(stage)
    draw_into(strip, curve) if isinstance(curve, ChartSpec) else curve(strip)
    mark = Line2D([], [], linestyle="none", marker="o", markersize=7, color=CRANK, zorder=8, animated=True)
    strip.add_artist(mark)
    fig.suptitle(heading("\n".join(titles), fig.get_figwidth(), 10.0), fontsize=10)
    legible(fig)
    canvas.draw()  # all that stands still is drawn once
    fig.set_layout_engine("none")
    still = canvas.copy_from_bbox(fig.bbox)
    pictures = []
    for k in range(len(steps.crank_angle)):
        canvas.restore_region(still)
        moving = sketch.pose(stage, steps, k)
        for artist in sorted(moving, key=lambda item: item.get_zorder()):
            artist.set_animated(True)
            stage.draw_artist(artist)
            artist.remove()
        mark.set_data([marks[k, 0]], [marks[k, 1]])
        strip.draw_artist(mark)
        buffer = canvas.buffer_rgba()
        pictures.append(np.array(np.asarray(buffer)[..., :3]))
    return one_palette(pictures)


def there_and_back(low: float, high: float, count: int) -> Array:
    """Return crank angles [rad] that swing smoothly through a range and back."""
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    return np.asarray(middle - half * np.cos(np.linspace(0.0, TURN, count, endpoint=False)))
