"""Pictures of charts: `ChartSpec` drawn with matplotlib in the style of the project."""

import io
import itertools
import math
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure, SubFigure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import FuncFormatter, LogLocator, MultipleLocator, NullFormatter

from optlink.presentation.chart_spec import (
    INK,
    LIMIT,
    MUTED,
    SYMBOLS,
    Axis,
    Band,
    Bars,
    Boxes,
    ChartSpec,
    Curve,
    HeatMap,
    Line,
    Mark,
    Panel,
    Trace,
    cells,
)
from optlink.presentation.format import pretty
from optlink.presentation.labels import Label, place_labels
from optlink.presentation.style import HALO, figure, heading, legible, styled

DASHES: dict[str, Any] = {"solid": "-", "dash": "--", "dot": ":", "dashdot": "-."}
NO_VALUE = "#e4e4e4"  # colour of the cells of a heat map without a value
TITLE, FONT = 10.5, 8.5
MIN_ASPECT, MAX_ASPECT = 0.45, 1.1  # ratios of height to width that a chart with equal scales may have in a picture
PANEL_HEIGHT = 2.05  # height of a panel [inch]
PAPER_WIDTH, PAPER_HEIGHT = 7.1, (1.7, 0.7)  # of a chart on paper [inch]: its width; its height, without and for each panel
MAX_BARS = 40  # number of bars up to which they are drawn as bars


def by_file(charts: Iterable[ChartSpec]) -> dict[str, list[ChartSpec]]:
    """Return the charts of each picture by its file name."""
    files: dict[str, list[ChartSpec]] = {}
    for chart in charts:
        if chart.file:
            files.setdefault(chart.file, []).append(chart)
    return files


def pictures(charts: Iterable[ChartSpec]) -> dict[str, Figure]:
    """Draw charts; return the figures by file name without ending: charts of one file share a figure."""
    return {name: draw(group) for name, group in by_file(charts).items()}


@styled
def draw(charts: Sequence[ChartSpec]) -> Figure:
    """Draw charts into one figure, in rows of charts side by side."""
    rows = [list(group) for _, group in itertools.groupby(charts, lambda chart: chart.row)]
    width = max(sum(chart.width for chart in row) for row in rows)
    heights = [max(_height(chart) for chart in row) for row in rows]
    first = charts[0]
    title = first.heading or first.title
    title = heading(f"{title}\n{first.remark}" if first.remark and len(charts) == 1 else title, 0.95 * width, TITLE)
    fig = figure(width, sum(heights) + 0.35 + 0.17 * title.count("\n"))
    labels: list[Label] = []
    if len(charts) == 1:
        labels += _chart(fig, first)
    else:
        strips = fig.subfigures(len(rows), 1, height_ratios=heights, squeeze=False)[:, 0]
        for strip, row in zip(strips, rows, strict=True):
            widths = [chart.width for chart in row]
            rest = [width - sum(widths)] if sum(widths) < 0.9 * width else []  # empty, so that all rows have the same scale
            subfigures = strip.subfigures(1, len([*widths, *rest]), width_ratios=[*widths, *rest], squeeze=False)[0]
            for subfigure, chart in zip(subfigures, row, strict=False):
                labels += _chart(subfigure, chart)
                written = "\n".join(filter(None, (chart.title, chart.remark)))
                subfigure.suptitle(heading(written, chart.width - 0.7, 9.5), fontsize=9.5)
    fig.suptitle(title, fontsize=TITLE, color=LIMIT if first.warning else INK)
    if labels:
        place_labels(fig, labels)
    return fig


@styled
def paper(chart: ChartSpec) -> str:
    """Return a chart as the SVG text of a low picture without a title, for a printed page."""
    low = [replace(panel, height=0.45 * panel.height) for panel in chart.panels]  # names of axes break into lines
    chart, picture = replace(chart, width=PAPER_WIDTH, panels=low), io.StringIO()
    fig = figure(PAPER_WIDTH, PAPER_HEIGHT[0] + PAPER_HEIGHT[1] * len(chart.panels))
    place_labels(fig, _chart(fig, chart))
    legible(fig)
    fig.savefig(picture, format="svg", metadata={"Date": None})
    return picture.getvalue()


def _height(chart: ChartSpec) -> float:
    """Return the height of a chart in the figure [inch]."""
    if chart.equal:
        return (chart.width - 1.0) * min(max(_ratio(chart), MIN_ASPECT), MAX_ASPECT) + 1.45
    return 0.75 + PANEL_HEIGHT * sum(panel.height for panel in chart.panels)


def _ratio(chart: ChartSpec) -> float:
    """Return height divided by width of the first panel in the unit of the axes."""
    (left, right), (low, high) = chart.x.limits or chart.reach, chart.panels[0].y.limits or chart.panels[0].rise
    return (high - low) / (right - left) if right > left else 1.0


def _widened(chart: ChartSpec) -> bool:
    """Return whether equal scales widen the limits to fill the panel: unless both axes have limits of a suitable ratio."""
    fixed = chart.x.limits is not None and chart.panels[0].y.limits is not None
    return chart.equal and not (fixed and MIN_ASPECT <= _ratio(chart) <= MAX_ASPECT)


def _chart(place: Figure | SubFigure, chart: ChartSpec) -> list[Label]:
    """Draw the panels of a chart and return the labels still to place."""
    heights = [panel.height for panel in chart.panels]
    grid = place.subplots(len(chart.panels), 1, sharex=True, squeeze=False, height_ratios=heights)[:, 0]
    labels = [label for axes, panel in zip(grid, chart.panels, strict=True) for label in _panel(axes, chart, panel)]
    _x_axis(grid[-1], chart)
    place.align_ylabels()
    return labels


def draw_into(axes: Axes, spec: ChartSpec, *, legend: bool = True) -> list[Label]:
    """Draw the first panel of a chart into axes and return the labels still to place."""
    labels = _panel(axes, spec, spec.panels[0], legend=legend)
    _x_axis(axes, spec)
    return labels


def _x_axis(axes: Axes, chart: ChartSpec) -> None:
    _scaled(
        axes, "x", chart.x, chart.x.limits or (chart.reach if _tight(chart) else None), chart.width - 1.0, widened=_widened(chart)
    )


def _tight(chart: ChartSpec) -> bool:
    """Return whether the x axis ends with the traces: for bands and curves without markers."""
    traces = [trace for panel in chart.panels for trace in panel.traces]
    return not chart.equal and all(isinstance(t, Band) or (isinstance(t, Curve) and t.mode == "lines") for t in traces[:1])


def _panel(axes: Axes, chart: ChartSpec, panel: Panel, *, legend: bool = True) -> list[Label]:
    for trace in panel.traces:
        _trace(axes, trace, chart, panel)
    for line in panel.lines:
        axes.axhline(line.at, zorder=2, **_line_style(line))
    top = panel is chart.panels[0]
    for line in chart.lines:
        axes.axvline(line.at, zorder=1.5, **_line_style(line) | ({} if top else {"label": None}))
    for span in chart.spans:
        named = _named(span, span.name if top else "")
        axes.axvspan(span.low, span.high, color=span.colour, alpha=span.opacity, linewidth=0.0, zorder=0.5, **named)
    flat = any(isinstance(trace, HeatMap) for trace in panel.traces)
    if not flat and not chart.equal:
        axes.margins(y=0.16 if panel.marks else 0.06)
    for mark in panel.marks:
        _mark(axes, mark, inside=chart.equal)
    _scaled(axes, "y", panel.y, panel.y.limits, 0.85 * PANEL_HEIGHT * panel.height, widened=_widened(chart))
    low, high = sorted(axes.get_ylim())
    if chart.equal:
        axes.set_aspect("equal", adjustable="datalim" if _widened(chart) else "box")
    if low < 0.0 < high and panel.y.scale == "linear" and not flat and not chart.equal:
        axes.axhline(0.0, color=MUTED, linewidth=0.8, zorder=1)
    if panel.y.limits is not None:
        for trace in panel.traces:
            if isinstance(trace, Bars) and not trace.horizontal:
                _label_cut_bars(axes, trace)
    if panel.note:
        axes.text(0.99, 0.03, pretty(panel.note), transform=axes.transAxes, ha="right", va="bottom", fontsize=FONT)
    if legend:
        _legend(axes, chart.width)
    return [Label(axes, (m.x, m.y), m.text, m.colour, m.font, 0.6 * m.size, m.prefer) for m in panel.marks if m.text]


def _named(part: Any, name: str) -> dict[str, Any]:
    """Return the entry of a part of a chart in the legend, if it has a name, and its mark for programs."""
    return {"label": name or None, "gid": part.gid or None}


def _line_style(line: Line) -> dict[str, Any]:
    return {"color": line.colour, "linewidth": line.width, "linestyle": DASHES[line.dash], **_named(line, line.name)}


def _trace(axes: Axes, trace: Trace, chart: ChartSpec, panel: Panel) -> None:
    """Draw a trace."""
    if isinstance(trace, Curve):
        _curve(axes, trace)
    elif isinstance(trace, Band):
        look = {"color": trace.colour, "alpha": trace.opacity, "linewidth": 0.0, **_named(trace, trace.name)}
        axes.fill_between(trace.x, trace.low, trace.high, **look)
    elif isinstance(trace, Boxes):
        fill, edge = to_rgba(trace.colour, trace.opacity), to_rgba(trace.colour, min(1.0, 2.0 * trace.opacity))
        axes.grid(visible=False)
        look = {"facecolors": fill, "edgecolors": edge, "linewidths": 0.5, "zorder": 1.5, **_named(trace, trace.name)}
        axes.add_collection(PolyCollection(list(trace.corners), **look))
    elif isinstance(trace, HeatMap):
        low, high = trace.limits or (None, None)
        edges = [cells(at, log=axis.scale == "log") for at, axis in ((trace.x, chart.x), (trace.y, panel.y))]
        axes.set_facecolor(NO_VALUE)
        axes.grid(visible=False)
        shaded = axes.pcolormesh(*edges, np.ma.masked_invalid(trace.z), cmap="viridis", vmin=low, vmax=high, rasterized=True)
        if trace.name:
            axes.figure.colorbar(shaded, ax=axes, label=pretty(trace.name))
    else:
        _bars(axes, trace)


def _curve(axes: Axes, trace: Curve) -> None:
    style = _named(trace, trace.name if trace.legend else "") | {"color": trace.colour}
    if trace.shade is not None:
        shaded = axes.scatter(trace.x, trace.y, c=trace.shade, cmap="viridis", s=trace.size**2, zorder=3, gid=trace.gid or None)
        axes.figure.colorbar(shaded, ax=axes, label=trace.shade_name, pad=0.02)
        style = {"color": "none"}  # unseen, so that labels keep clear of the points
    style |= {"markerfacecolor": "none"} if trace.symbol == "open circle" else {}
    axes.plot(
        trace.x,
        trace.y,
        alpha=None if trace.opacity == 1.0 else trace.opacity,
        linestyle=DASHES[trace.dash] if "lines" in trace.mode else "none",
        linewidth=trace.width,
        marker=SYMBOLS[trace.symbol][0] if "markers" in trace.mode else "",
        markersize=trace.size,
        markeredgewidth=0.0 if trace.symbol == "circle" else 1.2,
        zorder=3,
        **style,
    )


def _bars(axes: Axes, trace: Bars) -> None:
    """Draw bars, or a stepped line if there are many."""
    colour = trace.colours if isinstance(trace.colours, str) else list(trace.colours)
    style: dict[str, Any] = {
        "color": colour,
        "alpha": trace.opacity,
        "zorder": 2,
        **_named(trace, trace.name if trace.legend else ""),
    }
    if len(trace.x) > MAX_BARS and isinstance(colour, str) and not trace.horizontal and np.ndim(trace.width) == 0:
        axes.plot(trace.x, trace.y, drawstyle="steps-mid", linewidth=1.2, **style)
        return
    if trace.horizontal:
        axes.barh(trace.x, trace.y, height=trace.width, **style)
        axes.grid(visible=False, axis="y")
    else:
        axes.bar(trace.x, trace.y, width=trace.width, **style)


def _label_cut_bars(axes: Axes, trace: Bars) -> None:
    """Write the values of bars that exceed the axes."""
    low, high = axes.get_ylim()
    for at, value in zip(trace.x, trace.y, strict=True):
        if not low <= value <= high and math.isfinite(value):
            up = value > high
            written = f"{'↑' if up else '↓'} {value:.4g}".replace("-", "−")
            end = (float(at), high if up else low)
            text = axes.annotate(written, end, (0, -3 if up else 3), textcoords="offset points", ha="center", fontsize=8.0)
            text.set(va="top" if up else "bottom", path_effects=HALO, gid="cut off", zorder=5)


def _mark(axes: Axes, mark: Mark, *, inside: bool) -> None:
    """Draw a marked point; clip it at the edge of the axes if `inside`."""
    marker = axes.plot([mark.x], [mark.y], linestyle="none", color=mark.colour, markersize=mark.size, clip_on=inside, zorder=5)[0]
    look: Any = (3, 0, mark.angle) if mark.symbol == "triangle" else SYMBOLS[mark.symbol][0]
    marker.set_marker(look)
    marker.set_markerfacecolor("none" if mark.symbol == "open circle" else mark.colour)
    marker.set_markeredgewidth(0.0 if mark.symbol == "circle" else 1.0)
    marker.set_gid(mark.gid or None)


def _scaled(axes: Axes, direction: str, axis: Axis, limits: tuple[float, float] | None, room: float, *, widened: bool) -> None:
    """Set name, scale, limits, direction and ticks of an axis that is `room` long [inch].

    If `widened`, the limits may be widened for equal scales.
    """
    side = axes.xaxis if direction == "x" else axes.yaxis
    name = pretty(axis.name)
    side.set_label_text(name if "\n" in name else heading(name, room, 10.0))
    if axis.scale == "log":
        (axes.set_xscale if direction == "x" else axes.set_yscale)("log")
        low, high = limits or side.get_view_interval()
        if high / max(low, 1e-300) < 1e4:
            side.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        side.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}" if 1e-3 <= value < 1e5 else f"{value:.0e}"))
        side.set_minor_formatter(NullFormatter())
    if limits is not None and limits[1] > limits[0]:
        (axes.set_xlim if direction == "x" else axes.set_ylim)(*limits, auto=widened)
    if axis.reversed:
        side.set_inverted(True)
    low, high = sorted(side.get_view_interval())
    if axis.step and high - low >= 4.0 * axis.step:
        side.set_major_locator(MultipleLocator(axis.step))
    if axis.ticks:
        side.set_ticks([place for place, _ in axis.ticks], [text for _, text in axis.ticks])


def _legend(axes: Axes, width: float) -> None:
    """Place the legend above the axes, or beside them if it is long."""
    entries = {pretty(name): handle for handle, name in zip(*axes.get_legend_handles_labels(), strict=True)}
    if not entries:
        return
    letters, room = [max(len(line) for line in name.splitlines()) + 6 for name in entries], (width - 0.8) / 0.067
    rows = 1 if sum(letters) <= room else -(-len(entries) // max(1, int(room / max(letters))))
    place: dict[str, Any] = {"loc": "center left", "bbox_to_anchor": (1.0, 0.5)}
    if rows <= 3 and not any("\n" in name for name in entries):
        place = {"loc": "lower right", "bbox_to_anchor": (1.0, 1.0), "ncols": -(-len(entries) // rows)}
    axes.legend(map(_proxy, entries.values()), entries, frameon=False, fontsize=FONT, borderaxespad=0.1, **place)


def _proxy(handle: Any) -> Any:
    """Return the legend handle: that of white markers is outlined."""
    if isinstance(handle, Line2D) and handle.get_color() in ("white", "#ffffff"):
        return Line2D(
            [], [], linestyle="none", marker=handle.get_marker(), color="white", markeredgecolor="#111111", markersize=6.0
        )
    return handle if not hasattr(handle, "patches") else Patch(color=handle.patches[0].get_facecolor())
