"""Placement of labels clear of lines and of one another."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import FancyArrowPatch, Polygon
from matplotlib.ticker import FixedLocator
from numpy.typing import NDArray

from optlink.linkage.vector2d import TURN, Array
from optlink.report.style import HALO, TARGET

DIRECTIONS = np.array([[np.cos(t), np.sin(t)] for t in np.linspace(0.0, TURN, 16, endpoint=False)])
DISTANCES = np.array([2.0, 5.0, 9.0, 15.0, 24.0, 36.0])  # distances tried between point and label [pt]
LEADER_DISTANCE = 14.0  # distance beyond which a leader line is drawn [pt]
SAMPLING = 3.0  # sampling distance along lines [pixel]


@dataclass(frozen=True)
class Label:
    """Text beside a point (data coordinates); `clear` [pt] is the radius to keep free, `prefer` a preferred direction (x, y)."""

    axes: Axes
    at: tuple[float, float]
    text: str
    colour: str = TARGET
    size: float = 9.0
    clear: float = 3.0
    prefer: tuple[float, float] = (0.0, 0.0)


def in_points(axes: Axes, length: float) -> float:
    """Return a length along x in the unit of the axes in points; the figure must have its final layout."""
    fig = axes.get_figure()
    assert fig is not None
    return float(length * axes.get_window_extent().width / np.ptp(axes.get_xlim()) * 72.0 / fig.dpi)


def lay_out(figure: Figure) -> None:
    """Finish the layout of a figure, once, without drawing it: sizes in it are then known."""
    engine = figure.get_layout_engine()
    if engine is not None:
        engine.execute(figure)
        for axes in figure.axes:  # ticks depend on the size of the axes, and its margins on the ticks: keep these
            for side in (axes.xaxis, axes.yaxis):
                side.set_major_locator(FixedLocator(side.get_majorticklocs().tolist()))
        engine.execute(figure)
    figure.set_layout_engine("none")
    for axes in figure.axes:
        axes.apply_aspect()


def place_labels(figure: Figure, labels: Iterable[Label]) -> None:
    """Finish the layout of a figure and place every label where it hides least; those outside their axes are left out."""
    lay_out(figure)
    by_axes: dict[Axes, list[Label]] = {}
    for label in labels:
        if _in_sight(label):
            by_axes.setdefault(label.axes, []).append(label)
    for axes, group in by_axes.items():
        _place(axes, group)


def _in_sight(label: Label) -> bool:
    if not np.all(np.isfinite(label.at)):
        return False
    x, y = label.axes.transData.transform(label.at)
    return label.axes.get_window_extent().padded(2.0).contains(x, y)


def _place(axes: Axes, labels: list[Label]) -> None:
    figure = axes.get_figure()
    assert figure is not None
    point = figure.dpi / 72.0
    area = axes.get_window_extent()
    inside = np.array([area.x0, area.y0, area.x1, area.y1])
    crowd, weights = _occupied_pixels(axes, inside, point)
    occupied: list[Array] = []
    for label in labels:
        text = axes.text(*label.at, label.text, ha="center", va="center", color=label.colour, fontsize=label.size, zorder=9)
        text.set_path_effects(HALO)
        text.set_in_layout(False)
        extent = text.get_window_extent()
        half = np.array([0.5 * extent.width, 0.5 * extent.height])
        anchor = axes.transData.transform(label.at)
        reach = (DISTANCES + label.clear) * point
        # shift the box along each direction until its near side is `reach` away
        centres = anchor + (DIRECTIONS * reach[:, None, None] + DIRECTIONS * half).reshape(-1, 2)
        boxes = np.concatenate([centres - half, centres + half], axis=1)
        outside = np.maximum(inside[:2] - boxes[:, :2], 0.0).sum(axis=1) + np.maximum(boxes[:, 2:] - inside[2:], 0.0).sum(axis=1)
        hidden = _within(boxes, crowd, 1.0) @ weights
        overlap = np.zeros(len(boxes))
        for box in occupied:
            low, high = np.maximum(boxes[:, :2], box[:2]), np.minimum(boxes[:, 2:], box[2:])
            overlap += np.prod(np.maximum(high - low + 1.0, 0.0), axis=1)
        misplaced = 1.0 - DIRECTIONS @ np.asarray(label.prefer) if any(label.prefer) else np.zeros(len(DIRECTIONS))
        cost = (
            40.0 * outside
            + 5.0 * hidden
            + 2.0 * overlap
            + np.repeat(0.6 * reach, len(DIRECTIONS))
            + 5.0 * np.tile(misplaced, len(reach))
        )
        best = int(np.argmin(cost))
        occupied.append(boxes[best])
        text.set_position(tuple(axes.transData.inverted().transform(centres[best])))
        if np.repeat(reach, len(DIRECTIONS))[best] > LEADER_DISTANCE * point:  # too far to be attributed without a leader line
            near = axes.transData.inverted().transform(np.clip(anchor, boxes[best, :2], boxes[best, 2:]))
            leader = Line2D(*np.array([label.at, near]).T, color=label.colour, linewidth=0.6, alpha=0.7, zorder=8, gid="leader")
            leader.set_in_layout(False)
            axes.add_artist(leader)


def _within(boxes: Array, points: Array, room: float) -> NDArray[np.bool_]:
    low, high = boxes[:, :2, None] - room, boxes[:, 2:, None] + room
    in_columns, in_rows = ((places >= low[:, k]) & (places <= high[:, k]) for k, places in enumerate(points.T))
    within: NDArray[np.bool_] = in_columns & in_rows
    return within


def _occupied_pixels(axes: Axes, inside: Array, point: float) -> tuple[Array, Array]:
    """Return pixels covered by lines, outlines and markers, with weights for hiding them."""
    points_list, weights = [np.empty((0, 2))], [np.empty(0)]

    def add(points: Array, weight: float) -> None:
        points_list.append(points)
        weights.append(np.full(len(points), weight))

    for child in axes.get_children():
        if isinstance(child, Line2D) and child.get_visible():
            path = child.get_transform().transform(np.asarray(child.get_xydata(), dtype=float))
            if child.get_linestyle() not in ("None", "none", ""):
                add(_sampled_line(path, inside), 1.0 if child.get_linewidth() > 1.35 else 0.4)
            if child.get_marker() not in ("None", "none", "", None):
                ring = 0.5 * child.get_markersize() * point * DIRECTIONS[::2]
                add((path[:200, None, :] + ring).reshape(-1, 2), 1.0)
        elif isinstance(child, FancyArrowPatch):
            add(_sampled_line(axes.transData.transform(np.asarray(child.get_path().vertices)), inside), 1.0)
        elif isinstance(child, Polygon) and child.get_gid() != "shade":
            add(_sampled_line(child.get_transform().transform(child.get_xy()), inside), 0.7)
    points = np.concatenate(points_list)
    visible = np.all(np.isfinite(points), axis=1)
    return points[visible], np.concatenate(weights)[visible]


def _sampled_line(path: Array, inside: Array) -> Array:
    """Return points every few pixels along a line with gaps."""
    near = np.clip(path, inside[:2] - 50.0, inside[2:] + 50.0)  # points far outside do not matter
    lengths = np.linalg.norm(np.diff(near, axis=0), axis=1)
    finite_lengths = np.isfinite(lengths)
    count = np.where(finite_lengths, np.ceil(np.where(finite_lengths, lengths, 0.0) / SAMPLING).astype(int), 0)
    segment = np.repeat(np.arange(len(count)), count)
    share = (np.arange(len(segment)) - np.repeat(np.cumsum(count) - count, count)) / np.maximum(count[segment], 1)
    points: Array = near[segment] + share[:, None] * (near[segment + 1] - near[segment])
    return points
