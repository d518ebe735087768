"""Charts described once: plain data that `chart_mpl` draws as a picture and `html.chart_plotly` as a chart of the page.

A chart is a stack of panels over one x axis. A panel holds traces (`Curve`, `Bars`, `Band`, `Boxes`, `HeatMap`), horizontal
lines and labelled points. The renderers choose fonts, grids, legends, limits and ticks, so that a view states only what it
shows::

    def charts(result):
        unit = scale(peak, "N m")
        torque = Curve(angles, values * unit.factor, "torque", CRANK)
        limit = Line(120.0, "limit", LIMIT)
        panel = Panel(Axis(f"torque of the drive [{unit.unit}]"), [torque], lines=[limit])
        return [ChartSpec("torque", "Driving torque", [panel], crank_angle(), heading=f"{title}: driving torque")]

    chart_mpl.pictures(charts(result))                  # {"torque": Figure}
    [chart_plotly.chart(one) for one in charts(result) if one.page]  # charts of the page

Charts with the same `file` share one picture: those with the same `row` stand side by side. A chart without `file` is on the page
only; with `page=False` it is a picture only. Values are in display units. NaN makes a gap in a curve.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from optlink.linkage.vector2d import Array as Array

if TYPE_CHECKING:
    from optlink.problem.driving import Driving
    from optlink.problem.file import ProblemFile

Dash = Literal["solid", "dash", "dot", "dashdot"]
Symbol = Literal["circle", "open circle", "square", "cross", "plus", "star", "triangle"]
SYMBOLS: dict[Symbol, tuple[str, str]] = {
    "circle": ("o", "circle"),
    "open circle": ("o", "circle-open"),
    "square": ("s", "square"),
    "cross": ("x", "x"),
    "plus": ("+", "cross-thin-open"),
    "star": ("*", "star"),
    "triangle": ("^", "triangle-up"),
}
"""Names of the symbols in matplotlib and in plotly."""
CRANK_ANGLE = "crank angle φ [deg]"
TIME = "time [s]"
INK = "#111111"
CRANK, COUPLER, ROCKER, GROUND = "#c0392b", "#2c6fbb", "#2e8b57", "#444444"
BODIES = (COUPLER, ROCKER, "#d07d00", "#7d55a8", "#17888f", "#a0522d", "#c2527f", "#6f7d22", "#5a6b7b")
"""Colours of the bodies after the crank, in the order in which they are placed."""
MUTED, TARGET, RESULT, LIMIT = "#9a9a9a", "#111111", "#2c6fbb", "#c0392b"
SHADE = "#f3e3c3"
ROUNDING = 1e-9  # variation of a curve, relative to its size, up to which it is constant
MAX_DESCRIBED = 8  # largest number of traces of a panel that are described in words


@dataclass(frozen=True, eq=False)
class Axis:
    """An axis: name with unit, limits, tick distance (used where it leaves at least four ticks), ticks as (place, text)."""

    name: str = ""
    limits: tuple[float, float] | None = None
    scale: Literal["linear", "log"] = "linear"
    reversed: bool = False
    step: float | None = None
    ticks: Sequence[tuple[float, str]] = ()


def crank_angle(*, clockwise: bool = False, limits: tuple[float, float] | None = None) -> Axis:
    """Return the axis of the crank angle [deg]; time increases to the right, so the angle of a clockwise crank decreases.

    Parameters
    ----------
    clockwise : bool
        Sense of crank rotation.
    limits : (float, float) or None [deg]
        Ends of the axis; None for those of the curves.
    """
    tenths = 6.0 if limits is None else min(6.0, math.ceil((limits[1] - limits[0]) / 60.0))
    return Axis(CRANK_ANGLE + (", clockwise to the right" if clockwise else ""), limits, reversed=clockwise, step=10.0 * tenths)


def drive_axis(driving: Driving, *, clockwise: bool = False, limits: tuple[float, float] | None = None) -> Axis:
    """Return the axis of the positions of a drive in their unit: crank angles, cycle angles, slides or lengths."""
    if driving.ends is not None:
        return Axis(f"{driving.coordinate} [{driving.unit}]", limits, reversed=clockwise)
    axis = crank_angle(clockwise=clockwise, limits=limits)
    return replace(axis, name=axis.name.replace("crank angle", driving.coordinate))


@dataclass(frozen=True, eq=False)
class Curve:
    """A line, markers, or both, over points (n,); `width` and `size` of the markers in points.

    `text` is shown when pointing at a point, `picks` are the numbers of the selectable points (see `Picks`), `shade` colours the
    markers by a value named `shade_name`. `gid` identifies the curve in a picture. Without `legend` it has no legend entry. The
    short page leaves out curves of the `initial` design.
    """

    x: Array
    y: Array
    name: str = ""
    colour: str = INK
    width: float = 1.6
    dash: Dash = "solid"
    mode: Literal["lines", "markers", "lines+markers"] = "lines"
    symbol: Symbol = "circle"
    size: float = 4.5
    opacity: float = 1.0
    legend: bool = True
    hover: bool = True
    text: Sequence[str] = ()
    picks: Sequence[int | None] = ()
    shade: Array | None = None
    shade_name: str = ""
    gid: str = ""
    initial: bool = False

    @classmethod
    def through(cls, places: Array, name: str = "", colour: str = INK, width: float = 1.6, **options: Any) -> Curve:
        """Return a curve through places.

        Parameters
        ----------
        places : array (n, 2)
        name, colour : str
        width : float
        **options : any
            Further attributes.
        """
        return cls(places[:, 0], places[:, 1], name, colour, width, **options)

    @classmethod
    def entry(cls, name: str, colour: str, **options: Any) -> Curve:
        """Return an entry in the legend without a curve.

        Parameters
        ----------
        name, colour : str
        **options : any
            Further attributes.
        """
        return cls(np.full(1, np.nan), np.full(1, np.nan), name, colour, **options)


@dataclass(frozen=True, eq=False)
class Bars:
    """Bars at places `x` with heights `y` from zero (lengths if `horizontal`); `colours` one for all or one each.

    `width` is that of a bar in the unit of `x`, one for all or (n,); `text` is shown when pointing at a bar.
    """

    x: Array
    y: Array
    name: str = ""
    colours: str | Sequence[str] = INK
    width: float | Array = 0.7
    horizontal: bool = False
    opacity: float = 1.0
    legend: bool = True
    text: Sequence[str] = ()
    gid: str = ""


@dataclass(frozen=True, eq=False)
class Band:
    """The area between two curves over points (n,); `values` (n,) are shown instead of `high` when pointing at it."""

    x: Array
    low: Array
    high: Array
    name: str = ""
    colour: str = INK
    opacity: float = 0.15
    values: Array | None = None
    gid: str = ""


@dataclass(frozen=True, eq=False)
class Boxes:
    """Filled rectangles from `x` (n, 2) and `y` (n, 2), their two sides, with an outline."""

    x: Array
    y: Array
    name: str = ""
    colour: str = INK
    opacity: float = 0.35
    gid: str = ""

    @property
    def corners(self) -> Array:
        """Corners (n, 4, 2) in order."""
        return np.stack([self.x[:, [0, 1, 1, 0]], self.y[:, [0, 0, 1, 1]]], axis=-1)


@dataclass(frozen=True, eq=False)
class HeatMap:
    """Values (m, n) over a grid of places `x` (n,) and `y` (m,), with a colour bar if it has a name; NaN is left grey.

    `limits` are the ends of the colour scale, `picks` (m, n) the numbers of the selectable points.
    """

    x: Array
    y: Array
    z: Array
    name: str
    limits: tuple[float, float] | None = None
    picks: Sequence[Sequence[int | None]] = ()


@dataclass(frozen=True, eq=False)
class Line:
    """A straight line across a panel at a y value, or across a chart at an x value; with a legend entry if it has a name."""

    at: float
    name: str = ""
    colour: str = INK
    width: float = 1.1
    dash: Dash = "dash"
    gid: str = ""


@dataclass(frozen=True, eq=False)
class Span:
    """A shaded range of x across a chart; with a legend entry if it has a name."""

    low: float
    high: float
    name: str = ""
    colour: str = "#f3e3c3"
    opacity: float = 0.55
    gid: str = ""


@dataclass(frozen=True, eq=False)
class Mark:
    """A labelled point. The picture places the label clear of curves, preferably in the direction `prefer` (x, y).

    The page shows the label when pointing at the mark, or beside it if `written`. `angle` [deg] turns a triangle to the left.
    """

    x: float
    y: float
    text: str = ""
    colour: str = INK
    symbol: Symbol = "circle"
    size: float = 4.5
    prefer: tuple[float, float] = (0.0, 0.0)
    written: bool = False
    angle: float = 0.0
    font: float = 8.5
    gid: str = ""


Trace = Curve | Bars | Band | Boxes | HeatMap


@dataclass(frozen=True, eq=False)
class Panel:
    """Traces over the x axis of the chart; `height` is relative to the other panels, `note` a remark in its corner."""

    y: Axis
    traces: Sequence[Trace]
    height: float = 1.0
    lines: Sequence[Line] = ()
    marks: Sequence[Mark] = ()
    note: str = ""

    def __post_init__(self) -> None:
        """Give curves that are constant but for rounding a scale on which they are a straight line."""
        low, high = self.rise
        most = max(abs(low), abs(high))
        alone = self.y.limits is None and not self.lines and all(isinstance(trace, Curve) for trace in self.traces)
        if alone and 0.0 < high - low < ROUNDING * most:
            object.__setattr__(self, "y", replace(self.y, limits=(low - 0.02 * most, high + 0.02 * most)))

    @property
    def rise(self) -> tuple[float, float]:
        """Range of y of the curves."""
        heights = np.concatenate([trace.y for trace in self.traces if isinstance(trace, Curve)] or [np.zeros(1)])
        return (float(np.nanmin(heights)), float(np.nanmax(heights))) if np.any(np.isfinite(heights)) else (0.0, 0.0)


@dataclass(frozen=True, eq=False)
class Picks:
    """Selectable points of a chart: quantities of each as text under common names, and their places in the first panel.

    `what` names one point; `first` is the point shown at the beginning; `sources` are the rows of the points in the study.
    """

    what: str
    names: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    x: Array
    y: Array
    first: int = 0
    sources: Sequence[int] = ()


@dataclass(frozen=True, eq=False)
class ChartSpec:
    """A chart: stacked panels over one x axis, with vertical lines and shaded ranges across all of them.

    `file` names the picture and `title` is the caption on the page and of its part of a picture. `heading` is the title of the
    picture (default: `title`), in red with `warning`; the first chart of a picture supplies it. `remark` is a sentence below the
    title. `equal` draws x and y on one scale. `cursor` lets the page mark the position of the slider, whose unit is that of the x
    axis. `width` [inch] is that in the picture. `designs` returns problem and design [m, rad] of a source of `picks`. The short
    page shows charts that are `brief` before others.
    """

    file: str
    title: str
    panels: Sequence[Panel]
    x: Axis
    heading: str = ""
    remark: str = ""
    lines: Sequence[Line] = ()
    spans: Sequence[Span] = ()
    equal: bool = False
    warning: bool = False
    picks: Picks | None = None
    designs: Callable[[int], tuple[ProblemFile, Mapping[str, float]]] | None = None
    cursor: bool = True
    page: bool = True
    brief: bool = False
    row: int = 0
    width: float = 7.6

    @property
    def reach(self) -> tuple[float, float]:
        """Range of x of the traces."""
        ends = [end for panel in self.panels for trace in panel.traces for end in _ends(trace)]
        return (min(ends), max(ends)) if ends else (0.0, 1.0)

    @property
    def words(self) -> str:
        """Description in words for readers who do not see the chart: axes, and extremes of the named traces."""
        sentences = [f"{_plain(self.title)}."]
        for panel in self.panels:
            parts = [sentence for trace in panel.traces if (sentence := _extremes(trace, panel.y.name))]
            parts += [f"{_plain(line.name)} at {line.at:.4g}" for line in panel.lines if line.name]
            if parts:
                across = f", over {_plain(self.x.name)}" if self.x.name else ""
                sentences.append(f"{_plain(panel.y.name) or 'Values'}{across}: {'; '.join(parts[:MAX_DESCRIBED])}.")
        return " ".join(sentences)


def _plain(text: str) -> str:
    return " ".join(text.split())


def _extremes(trace: Trace, default: str) -> str:
    """Describe a trace by its extremes; an empty text if it has no name or no finite value."""
    if isinstance(trace, Bars):
        sizes = [(float(value), k) for k, value in enumerate(trace.y) if np.isfinite(value)]
        value, at = max(sizes, key=lambda item: abs(item[0]), default=(0.0, 0))
        where = f" ({_plain(trace.text[at])})" if trace.text else ""
        return f"{_plain(trace.name)}: largest {value:.4g}{where}" if trace.name and sizes else ""
    if isinstance(trace, Boxes):
        return f"{_plain(trace.name)}: {len(trace.x)} boxes" if trace.name else ""
    heights = trace.z if isinstance(trace, HeatMap) else np.stack([trace.low, trace.high]) if isinstance(trace, Band) else trace.y
    finite_heights = np.asarray(heights, dtype=float)
    finite_heights = finite_heights[np.isfinite(finite_heights)]
    name = _plain(trace.name or (default if isinstance(trace, HeatMap) else ""))
    return f"{name} from {np.min(finite_heights):.4g} to {np.max(finite_heights):.4g}" if name and finite_heights.size else ""


def _ends(trace: Trace) -> list[float]:
    places = trace.y if isinstance(trace, Bars) and trace.horizontal else trace.x
    finite_values = places[np.isfinite(places)]
    return [float(np.min(finite_values)), float(np.max(finite_values))] if finite_values.size else []


def charts_per_row(count: int) -> int:
    """Return the number of charts or drawings in a row."""
    return 2 if count in (2, 4) else min(count, 3)


def max_abs(values: Array) -> float:
    """Return the largest absolute value that is finite; 0 if there is none."""
    return float(np.max(np.abs(values), initial=0.0, where=np.isfinite(values)))


def cells(places: Array, *, log: bool = False) -> Array:
    """Return the cell borders (n + 1,) around rising places (n,) of a heat map, on a logarithmic axis if `log`."""
    centres = np.log(places) if log else np.asarray(places, dtype=float)
    if len(centres) == 1:
        centres = np.array([centres[0] - 0.5, centres[0] + 0.5])
    else:
        centres = np.concatenate(
            [[1.5 * centres[0] - 0.5 * centres[1]], 0.5 * (centres[1:] + centres[:-1]), [1.5 * centres[-1] - 0.5 * centres[-2]]]
        )
    return np.exp(centres) if log else centres
