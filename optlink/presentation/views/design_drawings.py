"""Drawings of a synthesised mechanism: beside its curve, at its characteristic positions, and several designs side by side."""

import math
from collections.abc import Callable
from functools import partial

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import FancyArrowPatch, Polygon
from matplotlib.path import Path as Outline

from optlink.linkage.dyads import transmitting
from optlink.linkage.motion import Motion
from optlink.linkage.stroke import travels, within_cycle
from optlink.linkage.vector2d import TURN
from optlink.presentation.chart_spec import CRANK, LIMIT, TARGET, charts_per_row
from optlink.presentation.drawing import merged_positions
from optlink.presentation.format import degrees
from optlink.presentation.labels import Label, place_labels
from optlink.presentation.shapes import even, ways
from optlink.presentation.style import figure, heading, panels, styled
from optlink.presentation.view import SomeDrawing
from optlink.presentation.views.design_charts import MAX_NUMBERED, CloseUp, points_on
from optlink.presentation.views.design_tables import captions, cognate_sources, modes, transmission, words_of
from optlink.presentation.views.design_view import LINE, SMALL, TITLE, DesignView, mechanism_title, views, wrapped
from optlink.tasks.results.design import SynthesisResult

MAX_HEIGHT, LABEL_WIDTH = 4.3, 0.75  # largest height of a panel and width of its axis labels [inch]
MAX_POSES = 8  # largest number of poses in which the body is drawn


def _turning(axes: Axes, view: DesignView, pose: Motion) -> None:
    """Draw an arrow on the crank circle in the direction of rotation, at the end of a range that of the way back."""
    crank = view.sketch.mechanism.crank
    pivot, pin = (view.sketch.position(pose, name)[0] for name in (crank.start, crank.end))
    arm = pin - pivot
    radius = max(float(np.linalg.norm(arm)), 1.7 * view.sketch.size)
    start = math.atan2(arm[1], arm[0])
    turn, sense = min(math.radians(50.0), 5.0 * view.sketch.size / radius), view.direction
    if not view.design.crank_turns:
        turn = min(turn, 0.8 * abs(view.end - view.begin))
        sense = sense if sense * (view.end - pose.crank_angle[0]) >= 1.25 * turn - 1e-9 else -sense
    angles = start + sense * np.linspace(0.25 * turn, 1.25 * turn, 33)
    arc = pivot + radius * ways(angles)
    arrow = FancyArrowPatch(path=Outline(arc), arrowstyle="-|>", mutation_scale=11.0, linewidth=1.5, color=CRANK)
    arrow.set(zorder=3.9, gid="turning")
    axes.add_patch(arrow)


def _draw_poses(axes: Axes, view: DesignView) -> None:
    """Draw the guided body in its poses."""
    sketch, body = view.sketch, view.task.body
    for part in sketch.parts[body]:
        if part.kind in ("bar", "plate"):
            places = sketch.placed(view.at, body, part.outline)
            for k in even(len(places), MAX_POSES):
                if k != view.first and np.all(np.isfinite(places[k])):
                    colour = to_rgb(view.colour)
                    ghost = Polygon(places[k], closed=part.kind == "plate", facecolor=(*colour, 0.06), edgecolor=(*colour, 0.35))
                    ghost.set(linewidth=1.2, zorder=1.2, gid="ghost")
                    axes.add_patch(ghost)


def trim(fig: Figure, rows: int = 1) -> None:
    """Reduce the height of a figure by the empty space above and below its rows of panels."""
    fig.draw_without_rendering()
    empty = math.inf
    for axes in fig.axes:
        slot, needed = axes.get_position(original=True).transformed(fig.transFigure), axes.get_tightbbox()
        assert needed is not None
        empty = min(empty, max(0.0, slot.y1 - needed.y1) + max(0.0, needed.y0 - slot.y0))
    if 0.0 < empty < math.inf:
        fig.set_figheight(fig.get_figheight() - rows * empty / fig.dpi)


def _draw_points(axes: Axes, view: DesignView) -> None:
    """Draw the coupler curve and the precision points."""
    factor = view.sketch.scale.factor
    axes.plot(*(view.position(view.run) * factor).T, color=view.colour, linewidth=2.3, zorder=1.5, gid="run")
    points_on(axes, view.targets * factor, 1.0 if len(view.targets) <= MAX_NUMBERED else 0.55)


TARGETS: dict[str, tuple[Callable[[Axes, DesignView], None], ...]] = {
    "path": (_draw_points,),
    "motion": (_draw_points, _draw_poses),
}
"""What is drawn of the targets, by kind of requirement."""


def initial_pose(axes: Axes, view: DesignView) -> list[Label]:
    """Draw the mechanism at its first position with its targets, and return the labels."""
    labels = view.sketch.show(axes, view.here)
    for draw in TARGETS.get(view.task.requirement.kind, ()):
        draw(axes, view)
    _turning(axes, view, view.here)
    return labels


def _view(result: SynthesisResult, pointed: bool) -> DesignView | None:
    """Return the view of the first requirement with, or without, target points."""
    return next((view for view in views(result) if view.task.pointed == pointed), None)


@partial(SomeDrawing, partial(_view, pointed=True))
@styled
def beside_curve(view: DesignView) -> Figure:
    """Draw the mechanism at its first target beside a close-up of its curve."""
    close = CloseUp(view)
    widths = [min(max(MAX_HEIGHT / ratio + LABEL_WIDTH, 3.6), 6.2) for ratio in (view.sketch.ratio, close.ratio)]
    ratios = zip(widths, (view.sketch.ratio, close.ratio), strict=True)
    height, width = min(MAX_HEIGHT, max((width - LABEL_WIDTH) * ratio for width, ratio in ratios)), sum(widths)
    title = mechanism_title(view, width - 0.4)
    fig = figure(width, height + 1.3 + LINE * (title.count("\n") + 1))
    fig.suptitle(title, fontsize=TITLE, color=TARGET if view.design.valid else LIMIT)
    left, right = fig.subplots(1, 2, width_ratios=widths)
    labels, what = [*initial_pose(left, view), *close.draw(right, view.factor)], words_of(view.design).spot
    at = f"{what} {view.first + 1}: crank at {degrees(float(view.design.crank_angles[view.first]))}"
    datum = view.design.whole.driving.datum
    at += f" from {datum}" * bool(datum)
    left.set_title(wrapped([at, *map(" ".join, modes(view.design).items())], widths[0] - 0.6, ", ", SMALL), fontsize=SMALL)
    right.set_title(heading(f"{what}s and generated curve", widths[1] - 0.6, SMALL), fontsize=SMALL)
    handles, names = right.get_legend_handles_labels()
    long = sum(0.55 + 0.068 * len(name) for name in names)  # inch
    columns = len(names) if long < width else -(-len(names) // 2)
    fig.legend(handles, names, loc="outside lower center", ncols=columns, frameon=False, fontsize=8.5)
    trim(fig)
    place_labels(fig, labels)
    return fig


# --- characteristic positions --------------------------------------------------------------------------------------------------


def positions(view: DesignView) -> dict[str, float]:
    """Return the characteristic crank angles [rad] by name: ends of the range, dead centres, extreme transmission angles."""
    named = [("start", view.begin), ("end of the span", view.end)] if view.started and view.design.follows_law else []
    if not view.turns:
        return merged_positions(named)
    if view.output is not None:
        travel = travels(view.task.linkage, view.design.values, 0.0, TURN, True)[view.slides].get(view.output)
        ends = [] if travel is None else [("forward", travel.high_at), ("backward", travel.low_at)]
        named += [(_dead_centre(view, at) or f"end of the {way} stroke", at) for way, at in ends]
    places, values = view.transmission_extremes
    groups = transmitting(view.task.linkage)
    for group, at, angles in zip(groups, places, values, strict=True):
        if len(groups) == 1:
            named += zip(("smallest transmission angle", "largest transmission angle"), at.tolist(), strict=True)
        else:
            worst = int(np.argmax(np.abs(angles - 0.5 * math.pi)))
            named.append((f"worst transmission angle at {group.joint}", at[worst]))
    return merged_positions(named)


def _dead_centre(view: DesignView, at: float) -> str:
    """Return the name of a dead centre in which the crank and the link that it drives are in line; empty if they are not."""
    motion, linkage, crank = view.sweep(np.array([at])), view.task.linkage, view.task.linkage.crank
    joint = next((group.joint for group in linkage.groups if crank.end in getattr(group, "outer", ())), None)
    if joint not in linkage.owners:  # that of a swinging guide is the guide
        return ""
    a, b, c = (motion.position(name)[0] for name in (crank.start, crank.end, joint))
    (x, y), (u, v) = b - a, c - b
    if abs(x * v - y * u) > 1e-5 * math.hypot(x, y) * math.hypot(u, v):
        return ""
    return "outer dead centre" if x * u + y * v > 0.0 else "inner dead centre"


@partial(SomeDrawing, partial(_view, pointed=False))
@styled
def at_positions(view: DesignView) -> Figure:
    """Draw the mechanism at its characteristic positions side by side, on one scale."""
    named = positions(view) or {"the reachable range begins": view.motion.crank_angle[0]}
    columns = 3 if len(named) > 4 else min(len(named), 2)
    rows, width = -(-len(named) // columns), 3.9 * columns
    title = mechanism_title(view, max(width, 5.0) - 0.4)
    height = (3.3 * min(max(view.sketch.ratio, 0.45), 1.3) + 0.95) * rows
    fig = figure(max(width, 5.0), height + LINE * (title.count("\n") + 2))
    labels: list[Label] = []
    for axes, (name, phi) in zip(panels(fig, len(named), columns), named.items(), strict=True):
        pose = view.sweep(np.array([phi]))
        labels += view.sketch.show(axes, pose)
        _turning(axes, view, pose)
        gamma = ", ".join(f"{math.degrees(angle):z.2f}°" for angle in view.transmission(np.array([phi]))[0])
        figures = [f"φ {math.degrees(within_cycle(phi)):z.2f}°", *view.output_at(pose), *([f"γ {gamma}"] if gamma else [])]
        axes.set_title(f"{name}\n{'   '.join(figures)}", fontsize=SMALL)
    fig.suptitle(title, fontsize=TITLE, color=TARGET if view.design.valid else LIMIT)
    place_labels(fig, labels)
    return fig


# --- several designs -----------------------------------------------------------------------------------------------------------

MAX_DESIGNS = 9  # largest number of designs
SCALE_RATIO = 4.0  # designs up to this multiple of the smallest size share one scale


@partial(SomeDrawing, lambda result: len(result.designs) > 1 and result)
@styled
def designs(result: SynthesisResult) -> Figure:
    """Draw the distinct designs side by side on one scale and name their cognates."""
    related = cognate_sources(result.designs)
    tracks = [DesignView(design) for design in result.designs[:MAX_DESIGNS]]
    sizes = np.array([np.ptp(view.sketch.limits, axis=1) / view.sketch.scale.factor for view in tracks])
    reach = sizes.max(axis=1)
    common = sizes[reach <= SCALE_RATIO * np.min(reach)].max(axis=0)
    columns = charts_per_row(len(tracks))
    rows = -(-len(tracks) // columns)
    panel = 3.9 if columns > 2 else 4.6
    tall = min(max(float(common[1] / common[0]), 0.4), 1.5)
    fig = figure(panel * columns, ((panel - LABEL_WIDTH) * tall + 1.35) * rows + 0.4)
    labels: list[Label] = []
    for number, (axes, view) in enumerate(zip(panels(fig, len(tracks), columns), tracks, strict=True)):
        labels += initial_pose(axes, view)
        smaller = max(1.0, np.max(sizes[number] / common))
        half = 0.5 * common * smaller * view.sketch.scale.factor
        middle = np.mean(view.sketch.limits, axis=1)
        axes.set(xlim=(middle[0] - half[0], middle[0] + half[0]), ylim=(middle[1] - half[1], middle[1] + half[1]))
        headline, least = captions(view.design)[0], transmission(view.design)
        texts = [heading(f"{number + 1}: {headline}", panel - 0.3, 9.0), least * (least != headline)]
        texts.append(wrapped([*map(" ".join, modes(view.design).items())], panel - 0.3, ", ", 9.0))
        if number in related:
            texts.append(f"cognate of {related[number] + 1}: the same curve")
        if smaller > 1.0:
            texts.append(f"drawn {smaller:.2g} times smaller than the others")
        axes.set_title("\n".join(filter(None, texts)), fontsize=9.0)
    count = len(result.designs)
    subtitle = f"{count} distinct designs, best first" + (f"; the first {MAX_DESIGNS}" if count > MAX_DESIGNS else "")
    fig.suptitle(heading(f"{tracks[0].task.title}: {subtitle}", panel * columns - 0.4, 10.5), fontsize=10.5)
    trim(fig, rows)
    place_labels(fig, labels)
    return fig
