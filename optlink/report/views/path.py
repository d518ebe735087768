"""View of a path, motion, function or transmission synthesis result of any linkage.

Path and motion: mechanism and curve with the precision points, deviations, alternative designs. Function and transmission:
mechanism, output or transmission angles, alternative designs.
"""

from functools import partial

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from PIL import Image

from optlink.linkage.dyad_types import transmitting
from optlink.linkage.motion import Motion
from optlink.linkage.vector2d import TURN
from optlink.report.animation import film, there_and_back
from optlink.report.causes import marked
from optlink.report.chart_spec import Array, ChartSpec
from optlink.report.drawing import Sketch
from optlink.report.labels import place_labels
from optlink.report.style import CRANK, LIMIT, TARGET, degrees, figure, heading, styled
from optlink.report.view import View
from optlink.report.views.certificate_view import certificate_charts
from optlink.report.views.path_charts import CloseUp, dots, errors, points_on, small_frames
from optlink.report.views.path_drawings import (
    LABEL_WIDTH,
    MAX_HEIGHT,
    curve,
    designs,
    function_values,
    initial_pose,
    output_film,
    trim,
)
from optlink.report.views.path_view import LINE, SMALL, TITLE, PathView, assembly, best, mechanism_title, with_verdict, wrapped
from optlink.tasks.results.design import LinkageDesign, SynthesisResult

FRAMES = 90
HIGHLIGHT = "#ffc20a"


def charts(result: SynthesisResult) -> list[ChartSpec]:
    """Return curve and deviations at every point, or the output of a law and y(x), or transmission angles; the global search."""
    view = best(result)
    if view is None:
        return []
    specs = [CloseUp(view).chart(), errors(view)] if view.task.pointed else [curve(view), *function_values(view)]
    task, design = view.task, view.design
    values, scale = design.values if design.valid else {}, task.shown_objective
    return specs + certificate_charts(result.certificate, task.title, scale, values, design.assembly, task.display)


def columns(design: LinkageDesign) -> dict[str, Array]:
    """Return prescribed and generated values at every position, by column name with SI unit."""
    task, data, measured = design.task, design.task.data, design.measured
    table: dict[str, Array] = {"point": np.arange(1.0, len(data.columns) + 1.0)}
    if task.requirement.kind == "transmission":
        joints = [group.joint for group in transmitting(task.linkage)]
        angles = {f"{joint}.transmission_rad": measured.generated[:, k] for k, joint in enumerate(joints)}
        return {**table, "crank_angle_rad": design.crank_angles, **angles}
    if task.requirement.kind == "function":
        target = task.prescribed_outputs(design.values)
        table |= {f"target_{task.unit}": target, f"generated_{task.unit}": measured.generated[:, 0]}
        return {**table, f"distance_{task.unit}": measured.distances, "crank_angle_rad": design.crank_angles}
    for name, places in (("target", data.columns), ("generated", measured.generated)):
        table |= {f"{name}.{axis}_m": places[:, k] for k, axis in enumerate("xy")}
    table |= {"distance_m": measured.distances, "crank_angle_rad": design.crank_angles}
    if np.any(np.isfinite(data.tolerances)):
        table["tolerance_m"] = data.tolerances
    if task.target_points.weights is not None:
        table["weight"] = data.roots**2
    if measured.turned is not None:
        target_angle = np.arctan2(data.columns[:, 3], data.columns[:, 2])
        table |= {
            "target.angle_rad": target_angle,
            "generated.angle_rad": target_angle + measured.turned,
            "turned_rad": measured.turned,
        }
    return table


@styled
def drawing(result: SynthesisResult, *, pointed: bool) -> Figure | None:
    """Draw the mechanism at its first point or position; of a path or motion beside it a close-up of the curve.

    None if the result is not of the wanted kind: `pointed`, a path or a motion, or else a function or a transmission.
    """
    view = best(result)
    if view is None or view.task.pointed != pointed:
        return None
    close = CloseUp(view) if pointed else None
    ratios = [view.sketch.ratio] if close is None else [view.sketch.ratio, close.ratio]
    least, most, below = (5.0, 7.6, 1.0) if close is None else (3.6, 6.2, 1.3)
    widths = [min(max(MAX_HEIGHT / ratio + LABEL_WIDTH, least), most) for ratio in ratios]
    height = min(MAX_HEIGHT, max((width - LABEL_WIDTH) * ratio for width, ratio in zip(widths, ratios, strict=True)))
    width = sum(widths)
    title = mechanism_title(view, width - 0.4)
    fig = figure(width, height + below + LINE * (title.count("\n") + 1))
    fig.suptitle(title, fontsize=TITLE, color=TARGET if view.design.valid else LIMIT)
    left, *others = fig.subplots(1, len(ratios), width_ratios=widths, squeeze=False)[0]
    labels = initial_pose(left, view)
    crank = f"crank at {degrees(float(view.design.crank_angles[view.first]))}"
    if close is not None:
        right, what = others[0], "pose" if close.motion else "point"
        crank = f"{what} {view.first + 1}: {crank}"
        labels += close.draw(right, view.factor)
        right.set_title(heading(f"{what}s and generated curve", widths[1] - 0.6, SMALL), fontsize=SMALL)
        handles, names = right.get_legend_handles_labels()
        long = sum(0.55 + 0.068 * len(name) for name in names)  # inch
        ncols = len(names) if long < width else -(-len(names) // 2)
        fig.legend(handles, names, loc="outside lower center", ncols=ncols, frameon=False, fontsize=8.5)
    left.set_title(wrapped([crank, *assembly(view.design)], widths[0] - 0.6, ", ", SMALL), fontsize=SMALL)
    trim(fig)
    place_labels(fig, labels)
    return fig


class Passing(Sketch):
    """Sketch of a mechanism that highlights the precision points it has passed."""

    def __init__(self, view: PathView) -> None:
        super().__init__(view.motion)
        self.widen(view.targets * self.scale.factor)
        self.track, self.close = view, CloseUp(view)
        self.strip: Axes | None = None

    def lay(self, axes: Axes) -> None:
        """Draw the close-up of the curve, in which passed points are highlighted too."""
        self.strip = axes
        self.close.draw(axes, None)

    def pose(self, axes: Axes, motion: Motion, k: int = 0) -> list[Artist]:
        """Draw position `k`, the points passed so far and the pose of the guided body."""
        artists = super().pose(axes, motion, k)
        view = self.track
        assert self.strip is not None
        passed = view.direction * (motion.crank_angle[k] - view.design.crank_angles) >= -1e-9
        for place, factor in ((axes, self.scale.factor), (self.strip, self.close.unit.factor)):
            x, y = (view.targets[passed] * factor).T
            size = dots(len(view.targets)) + 1.0
            lit = Line2D(
                x, y, linestyle="none", marker="o", markersize=size, color=HIGHLIGHT, mec=TARGET, mew=0.6, zorder=6, gid="lit"
            )
            more = [lit]
            if self.close.motion:
                length = self.close.length * factor / self.close.unit.factor
                frame = small_frames(view.position(motion)[k : k + 1] * factor, view.angles(motion)[k : k + 1], length)
                more.append(Line2D(*frame.T, color=CRANK, linewidth=1.8, zorder=7, gid="pose"))
            for artist in more:
                place.add_artist(artist)
            artists += more
        return artists


@styled
def frames(result: SynthesisResult, count: int = FRAMES) -> list[Image.Image]:
    """Draw the frames of the best design moving along its curve, or its output.

    The crank turns once, or back and forth between the first and the last point.
    """
    view = best(result)
    if view is None:
        return []
    titles = marked(view.task.title, view.design, view.refuted)
    steps = view.begin + view.direction * np.linspace(0.0, TURN, count, endpoint=False)
    if view.task.requirement.kind == "function" or (view.task.pointed and not view.design.crank_turns):
        steps = there_and_back(view.begin, view.end, count)
    if not view.task.pointed:
        return output_film(view, steps, titles)
    sketch, motion = Passing(view), view.sweep(steps)
    marks = view.position(motion) * sketch.close.unit.factor

    def points(axes: Axes) -> None:
        points_on(axes, view.targets * sketch.scale.factor)

    return film(sketch, motion, sketch.lay, marks, titles, more=points)


VIEW = View(
    charts=charts,
    drawings={"path": partial(drawing, pointed=True), "mechanism": partial(drawing, pointed=False), "designs": designs},
    tables=lambda result: {} if result.best is None else {"points": columns(result.best)},
    design=lambda result: with_verdict(result.machine, result.best, result.refuted),
    frames=frames,
    result=SynthesisResult,
)
