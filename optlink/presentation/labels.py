"""Labels of pictures, placed clear of lines and of one another."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import FancyArrowPatch, Polygon
from matplotlib.text import Text
from matplotlib.ticker import FixedLocator

from optlink.linkage.vector2d import Array
from optlink.presentation.placement import DIRECTIONS, Places, arrange, beside, written
from optlink.presentation.style import HALO, TARGET

DISTANCES = np.array([2.0, 5.0, 9.0, 15.0, 24.0, 36.0])  # distances tried between point and label [pt]
LEADER_DISTANCE = 14.0  # distance beyond which a leader line is drawn [pt]
PRICE, PREFERENCE = 1.5, 1.0  # costs of a distance of one font size between point and label, and of another direction


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
    return float(length * axes.get_window_extent().width / np.ptp(axes.get_xlim()) * 72.0 / axes.figure.dpi)


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
    point = axes.figure.dpi / 72.0
    area = axes.get_window_extent()
    font = labels[0].size * point
    anchors = np.array([axes.transData.transform(label.at) for label in labels])
    former = [text for text in axes.texts if text.get_text()]
    texts, places = list[Text](), list[Places]()
    for k, label in enumerate(labels):
        text = axes.text(*label.at, label.text, ha="center", va="center", color=label.colour, fontsize=label.size, zorder=9)
        text.set_path_effects(HALO)
        text.set_in_layout(False)
        texts.append(text)
        half = 0.5 * np.array(text.get_window_extent().size)
        others = np.delete(anchors, k, axis=0)[:, None]
        prefer = PREFERENCE * np.asarray(label.prefer)
        places.append(beside(anchors[[k]], half, (DISTANCES + label.clear) * point, PRICE / font, others, prefer))
    boxes = [text.get_window_extent().get_points() for text in former]
    fixed = [written(box.mean(axis=0), 0.5 * np.ptp(box, axis=0)) for box in boxes]
    chosen = arrange([*fixed, *places], _lines_of(axes, point), font, area.bounds)[len(fixed) :]
    for label, text, at, place, [choice] in zip(labels, texts, anchors, places, chosen, strict=True):
        middle = at + place.middles[choice]
        near = np.clip(at, middle - place.half, middle + place.half)
        text.set_position(tuple(axes.transData.inverted().transform(middle)))
        if np.linalg.norm(near - at) > LEADER_DISTANCE * point:  # too far to be attributed without a leader line
            ends = np.array([label.at, axes.transData.inverted().transform(near)])
            leader = Line2D(*ends.T, color=label.colour, linewidth=0.6, alpha=0.7, zorder=8, gid="leader")
            leader.set_in_layout(False)
            axes.add_artist(leader)


def _lines_of(axes: Axes, point: float) -> list[tuple[Array, float]]:
    """Return the lines, outlines and markers of a picture [pixel], with weights for hiding them."""
    lines: list[tuple[Array, float]] = []
    for child in axes.get_children():
        if isinstance(child, Line2D) and child.get_visible():
            path = child.get_transform().transform(np.asarray(child.get_xydata(), dtype=float))
            if child.get_linestyle() not in ("None", "none", ""):
                lines.append((path, 1.0 if child.get_linewidth() > 1.35 else 0.4))
            if child.get_marker() not in ("None", "none", "", None):
                ring = 0.5 * child.get_markersize() * point * DIRECTIONS[::2]
                lines += [(at + ring, 1.0) for at in path[:200]]
        elif isinstance(child, FancyArrowPatch):
            lines.append((axes.transData.transform(np.asarray(child.get_path().vertices)), 1.0))
        elif isinstance(child, Polygon) and child.get_gid() != "shade":
            lines.append((child.get_transform().transform(child.get_xy()), 0.7))
    return [(line[None], 5.0 * weight) for line, weight in lines]
