"""Charts of the HTML page: `ChartSpec` as a plotly figure."""

import itertools
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from html import escape as escaped
from typing import Any

import numpy as np

from optlink.io import finite
from optlink.presentation.chart_spec import (
    SYMBOLS,
    TARGET,
    Array,
    Axis,
    Band,
    Bars,
    Boxes,
    ChartSpec,
    Curve,
    HeatMap,
    Mark,
    Panel,
    Picks,
    max_abs,
)
from optlink.presentation.export.dimensions import Drawing
from optlink.presentation.format import pretty
from optlink.presentation.html.theme import readable

Trace = dict[str, Any]
DIGITS = 6  # significant digits of a number in a chart, far below the visible resolution
FONT = "system-ui, -apple-system, 'Segoe UI', 'DejaVu Sans', sans-serif"
THIN_ABOVE = 1200  # number of points from which a curve is thinned, about two per pixel of a wide page
MAX_CELLS = 150  # largest number of rows and columns of a map
PIXELS_PER_POINT = 4.0 / 3.0  # pixels per point
LAYOUT: dict[str, Any] = {
    "margin": {"l": 70, "r": 20, "t": 24, "b": 50},
    "font": {"family": FONT, "size": 12, "color": "#22262b"},
    "paper_bgcolor": "#ffffff",
    "plot_bgcolor": "#ffffff",
    "hovermode": "x unified",
    "showlegend": True,
}
LEGEND = {"orientation": "h", "x": 0.0, "xanchor": "left", "yanchor": "bottom"}
AXIS = {
    "gridcolor": "#e7e9ec",
    "zerolinecolor": "#b9bec5",
    "linecolor": "#8a9099",
    "ticks": "outside",
    "tickcolor": "#8a9099",
    "automargin": True,
    "exponentformat": "none",
    "separatethousands": True,
}
PANEL_GAP = 0.07  # least distance of panels as a share of the height
NARROW, ENTRY, LETTER, ROW = 270.0, 45.0, 6.5, 19.0  # pixels: axes of a chart on a phone; symbol, letter and row of a legend


@dataclass(frozen=True, eq=False)
class Chart:
    """A chart: title, plotly figure, and whether its x axis is that of the slider, so that a cursor can follow.

    `picks` are its selectable points; `remark` is a note to the reader; `words` describes it for a screen reader; `draw`
    returns the drawings of selectable points by number; `paper` is a picture (SVG) to print in its place.
    """

    title: str
    figure: dict[str, Any]
    cranked: bool = True
    picks: Picks | None = None
    remark: str = ""
    words: str = ""
    draw: Callable[[], Mapping[int, Drawing]] | None = None
    paper: str = ""

    @cached_property
    def drawings(self) -> Mapping[int, Drawing]:
        """Drawings of selectable points by number, made when they are needed."""
        return {} if self.draw is None else self.draw()


def _legend_room(panel: Panel) -> float:
    """Return the height [pixel] of the legend above a panel where the page is narrow: it must not cover the panel before it."""
    names = [trace.name for trace in panel.traces if trace.name and getattr(trace, "legend", True)]
    if not names:
        return 0.0
    columns = max(1, int(NARROW / (ENTRY + LETTER * max(map(len, names)))))
    return ROW * math.ceil(len(names) / columns) + 0.5 * ROW


def _marker(part: Curve | Mark) -> dict[str, Any]:
    """Return the look of the symbols of a curve, or of a mark."""
    size, symbol = round(PIXELS_PER_POINT * part.size, 1), SYMBOLS[part.symbol][1]
    return {"color": part.colour, "size": size, "symbol": symbol}


def _colour_bar(name: str) -> dict[str, Any]:
    return {"title": {"text": escape(name), "side": "right"}, "thickness": 16}


def _lines(text: str) -> str:
    """Return a text of several lines for HTML."""
    return escape(text).replace("\n", "<br>")


def escape(text: str) -> str:
    """Write a text with the signs of units, safe for plotly."""
    return escaped(pretty(text))


def chart(spec: ChartSpec) -> Chart:
    """Return a chart of the page."""
    traces = [trace for panel in spec.panels for trace in panel.traces]
    kinds, total = set(map(type, traces)), sum(panel.height for panel in spec.panels)
    height = 480 if spec.equal or kinds & {HeatMap, Boxes} else int(110 + 200 * total)
    inner = height - LAYOUT["margin"]["t"] - LAYOUT["margin"]["b"]
    least = max(PANEL_GAP, 3.0 * PANEL_GAP / len(spec.panels)) * inner
    gaps = [max(least, _legend_room(panel)) for panel in spec.panels[1:]]
    height, inner = height + round(sum(gaps) - least * len(gaps)), inner + sum(gaps) - least * len(gaps)
    unit = (1.0 - sum(gaps) / inner) / total
    layout: dict[str, Any] = LAYOUT | {"height": height}
    lined = any(isinstance(trace, Band) or (isinstance(trace, Curve) and "lines" in trace.mode) for trace in traces)
    if spec.equal or spec.picks is not None or not lined:
        layout["hovermode"] = "closest"
    if HeatMap in kinds:
        layout["plot_bgcolor"] = "#eceef1"
    if Bars in kinds:
        layout |= {"barmode": "overlay", "bargap": 0.0}
    layout |= {"shapes": _vertical_shapes(spec)}
    data, top, key = [], 1.0, ""
    for number, panel in enumerate(spec.panels, 1):
        key = "" if number == 1 else str(number)
        bottom = max(0.0, top - unit * panel.height)
        layout[f"yaxis{key}"] = _axis(panel.y) | {"domain": [bottom, top]}
        if spec.equal:
            layout[f"yaxis{key}"] |= {"scaleanchor": "x", "constrain": "domain"}
        layout[f"legend{key}"] = LEGEND | {"y": top + 0.01} | ({"bgcolor": "#e3e6ea"} if HeatMap in kinds else {})
        data += [trace | {"yaxis": f"y{key}", "legend": f"legend{key}"} for trace in _traces(spec, panel)]
        top = bottom - (gaps[number - 1] / inner if number <= len(gaps) else 0.0)
    layout["xaxis"] = _axis(spec.x, spec.reach) | {"anchor": f"y{key}", "hoverformat": ".2f"}
    if spec.equal:
        layout["xaxis"] |= {"constrain": "domain"}
    picks = spec.picks
    if picks is not None:
        picks = replace(picks, x=np.round(picks.x, _decimals(picks.x)), y=np.round(picks.y, _decimals(picks.y)))
        data.append(_selected_marker(picks, "#ffffff" if HeatMap in kinds else TARGET))
    remark = "; ".join(filter(None, [spec.remark, *(panel.note for panel in spec.panels)]))
    return Chart(spec.title, {"data": data, "layout": layout}, spec.cursor, picks, remark, spec.words)


def _selected_marker(picks: Picks, colour: str) -> Trace:
    """Return the marker of the selected point; the page script expects it as the last trace of a chart."""
    look = {"color": "rgba(0,0,0,0)", "size": 13.0, "line": {"color": colour, "width": 2.2}}
    at = {"x": short(picks.x[[picks.first]]), "y": short(picks.y[[picks.first]]), "yaxis": "y"}
    return {"type": "scatter", "mode": "markers", "name": "", "showlegend": False, "hoverinfo": "skip", "marker": look} | at


def _axis(axis: Axis, reach: tuple[float, float] | None = None) -> dict[str, Any]:
    """Return an axis; `reach` are the ends of what is shown without limits."""
    name = axis.name if reach is not None else axis.name.replace("\n", " ")
    layout: dict[str, Any] = AXIS | {"title": {"text": _lines(name), "font": {"size": 13}, "standoff": 8}}
    if axis.scale == "log":
        layout |= {"type": "log", "exponentformat": "power"} | ({"dtick": 1} if axis.limits is None else {})
    if axis.limits is not None:
        ends = [math.log10(end) for end in axis.limits] if axis.scale == "log" else list(axis.limits)
        layout |= {"range": ends[::-1] if axis.reversed else ends}
    elif axis.reversed:
        layout |= {"autorange": "reversed"}
    if axis.ticks:
        layout |= {
            "tickmode": "array",
            "tickvals": [at for at, _ in axis.ticks],
            "ticktext": [_lines(text) for _, text in axis.ticks],
        }
    elif axis.step and (reach := axis.limits or reach) is not None and reach[1] - reach[0] >= 3.0 * axis.step:
        layout |= {"dtick": axis.step}
    return layout


def short(values: Array) -> list[float | None]:
    """Return the values rounded to the digits of a chart; None where they are not finite."""
    return finite(np.round(values, _decimals(values)))  # type: ignore[no-any-return]


def _decimals(values: Array) -> int:
    """Return the decimals that give the largest value the digits of a chart."""
    size = max_abs(values)
    return DIGITS - math.floor(math.log10(size)) if size > 0.0 else DIGITS


def thinned(x: Array, y: Array, most: int = THIN_ABOVE) -> tuple[Array, Array]:
    """Reduce a long curve to at most about `most` points, keeping the extremes of each portion and all gaps.

    A curve that runs back in x, such as an orbit, keeps the extremes in x too.
    """
    if len(x) <= most:
        return x, y
    run = np.diff(x[np.isfinite(x)])
    coordinates = (y,) if np.all(run >= 0.0) or np.all(run <= 0.0) else (y, x)
    edges = np.linspace(0, len(x), most // (2 * len(coordinates)) + 1).astype(int)
    gaps = np.flatnonzero(np.diff(np.isnan(y).astype(np.int8)) > 0) + 1
    kept: set[int] = {0, len(x) - 1, *gaps.tolist()}
    for first, last in itertools.pairwise(edges.tolist()):
        for values in coordinates:
            portion = values[first:last]
            if not np.all(np.isnan(portion)):
                kept |= {first + int(np.nanargmin(portion)), first + int(np.nanargmax(portion))}
    rows = np.array(sorted(kept))
    return x[rows], y[rows]


def _vertical_shapes(spec: ChartSpec) -> list[dict[str, Any]]:
    """Return the vertical lines and shaded ranges of a chart."""
    full_height = {"yref": "paper", "y0": 0, "y1": 1, "layer": "below"}
    shapes: list[dict[str, Any]] = []
    for span in spec.spans:
        look: dict[str, Any] = {"fillcolor": span.colour, "opacity": span.opacity, "line": {"width": 0}}
        shapes.append({"type": "rect", "x0": span.low, "x1": span.high, **look, **full_height})
    for line in spec.lines:
        look = {"line": {"color": line.colour, "width": line.width, "dash": line.dash}}
        shapes.append({"type": "line", "x0": line.at, "x1": line.at, **look, **full_height})
    return shapes


def _traces(spec: ChartSpec, panel: Panel) -> list[Trace]:
    """Return the traces of a panel."""
    traces: list[Trace] = []
    for trace in panel.traces:
        if isinstance(trace, Curve):
            traces.append(_curve(trace))
        elif isinstance(trace, Band):
            traces += _band(trace)
        elif isinstance(trace, Boxes):
            traces.append(_boxes(trace))
        elif isinstance(trace, HeatMap):
            traces.append(_heat_map(spec, panel, trace))
        else:
            traces.append(_bars(trace))
    ends = np.array(spec.x.limits or spec.reach)
    for line in panel.lines:
        traces.append(
            _curve(Curve(ends, np.full(2, line.at), line.name, line.colour, line.width, line.dash, hover=bool(line.name)))
        )
    if panel is spec.panels[0]:
        square, entry = {"symbol": "square", "size": 11}, {"x": [None], "y": [None], "hoverinfo": "skip"}
        looks: list[tuple[str, Trace]] = [
            *((line.name, {"mode": "lines", "line": {"color": line.colour, "dash": line.dash}}) for line in spec.lines),
            *(
                (span.name, {"mode": "markers", "marker": square | {"color": span.colour, "opacity": span.opacity}})
                for span in spec.spans
            ),
        ]
        traces += [{"type": "scatter", "name": escape(name)} | entry | look for name, look in looks if name]
    return traces + _marks(spec, panel)


def _curve(trace: Curve) -> Trace:
    most = 3 * THIN_ABOVE if np.any(np.isnan(trace.y)) else THIN_ABOVE  # gaps: several passes over the same width
    x, y = (trace.x, trace.y) if trace.picks or trace.text else thinned(trace.x, trace.y, most)
    data: Trace = {"type": "scatter", "mode": trace.mode, "name": escape(trace.name), "x": short(x), "y": short(y)}
    data |= {} if trace.legend and trace.name else {"showlegend": False}
    if "lines" in trace.mode:
        data["line"] = {
            "color": trace.colour,
            "width": round(PIXELS_PER_POINT * trace.width, 2),
            "dash": trace.dash,
            "simplify": False,
        }
    if "markers" in trace.mode:
        data["marker"] = _marker(trace)
        if trace.symbol in ("open circle", "plus"):
            data["marker"]["line"] = {"width": 1.7, "color": trace.colour}
    if trace.shade is not None:
        data["marker"] |= {"color": short(trace.shade), "colorscale": "Viridis", "colorbar": _colour_bar(trace.shade_name)}
    if trace.opacity != 1.0:
        data["opacity"] = trace.opacity
    if trace.text:
        data["text"] = [escape(text) for text in trace.text]
    if trace.picks:
        data["customdata"] = list(trace.picks)
    return data if trace.hover else data | {"hoverinfo": "skip"}


def _band(trace: Band) -> list[Trace]:
    """Return the two edges of a band, filled in between."""
    edge: Trace = {"type": "scatter", "mode": "lines", "line": {"width": 0, "color": trace.colour}, "x": short(trace.x)}
    edge |= {"name": escape(trace.name), "legendgroup": escape(trace.name)}
    upper = edge | {"y": short(trace.high), "fill": "tonexty", "fillcolor": f"{trace.colour}{round(255 * trace.opacity):02x}"}
    upper |= {"showlegend": bool(trace.name)}
    if trace.values is not None:
        upper |= {"customdata": short(trace.values), "hovertemplate": "%{customdata:.4g}"}
    elif not trace.name:
        upper |= {"hoverinfo": "skip"}
    lower = edge | {"y": short(trace.low), "showlegend": False}
    return [lower | ({"hoverinfo": "skip"} if trace.values is not None or not trace.name else {}), upper]


def _boxes(trace: Boxes) -> Trace:
    """Return rectangles as one filled line with gaps."""
    around = np.concatenate([trace.corners, trace.corners[:, :1], np.full((len(trace.x), 1, 2), np.nan)], axis=1).reshape(-1, 2)
    x, y = map(short, around.T)
    look: Trace = {"type": "scatter", "mode": "lines", "name": escape(trace.name), "x": x, "y": y}
    look |= {"fill": "toself", "fillcolor": f"{trace.colour}{round(255 * trace.opacity):02x}", "hoverinfo": "skip"}
    return look | {"line": {"width": 0.7, "color": trace.colour}, "showlegend": bool(trace.name)}


def _heat_map(spec: ChartSpec, panel: Panel, trace: HeatMap) -> Trace:
    template = f"{escape(spec.x.name)}: %{{x:.6g}}<br>{escape(panel.y.name)}: %{{y:.6g}}<br>%{{z:.6g}}<extra></extra>"
    rows, columns = (slice(None, None, max(1, -(-size // MAX_CELLS))) for size in trace.z.shape)
    data: Trace = {"type": "heatmap", "name": escape(trace.name), "x": short(trace.x[columns]), "y": short(trace.y[rows])}
    data |= {"z": [short(row) for row in trace.z[rows, columns]], "colorscale": "Viridis", "hovertemplate": template}
    data["colorbar"] = _colour_bar(trace.name)
    if trace.limits is not None:
        data |= {"zmin": trace.limits[0], "zmax": trace.limits[1]}
    return data | ({"customdata": [list(row)[columns] for row in trace.picks[rows]]} if trace.picks else {})


def _bars(trace: Bars) -> Trace:
    places, sizes = ("y", "x") if trace.horizontal else ("x", "y")
    colour = trace.colours if isinstance(trace.colours, str) else list(trace.colours)
    data: Trace = {"type": "bar", "name": escape(trace.name), places: short(trace.x), sizes: short(trace.y)}
    data |= {"marker": {"color": colour}, "opacity": trace.opacity, "showlegend": trace.legend and bool(trace.name)}
    data["width"] = short(np.broadcast_to(np.asarray(trace.width, dtype=float), np.shape(trace.x)))
    data |= {"orientation": "h"} if trace.horizontal else {}
    if trace.text:
        data |= {"text": [escape(text) for text in trace.text], "textposition": "none"}
        data["hovertemplate"] = f"%{{text}}: %{{{sizes}:.4g}}<extra></extra>"
    return data


def _marks(spec: ChartSpec, panel: Panel) -> list[Trace]:
    """Return the labelled points of a panel, one trace for all of one look."""
    groups: dict[tuple[object, ...], list[Mark]] = {}
    for mark in (mark for mark in panel.marks if math.isfinite(mark.x + mark.y)):
        groups.setdefault((mark.colour, mark.symbol, mark.size, mark.written), []).append(mark)
    middle = [0.5 * sum(ends) for ends in (spec.x.limits or spec.reach, panel.y.limits or panel.rise)]
    traces = []
    for group in groups.values():
        first = group[0]
        look = _marker(first)
        if any(mark.angle for mark in group):
            look["angle"] = [-mark.angle for mark in group]
        mode = "markers+text" if first.written else "markers"
        data: Trace = {"type": "scatter", "mode": mode, "name": "", "showlegend": False, "marker": look}
        data |= {"x": [mark.x for mark in group], "y": [mark.y for mark in group]}
        data |= {"text": [_lines(mark.text) for mark in group], "hovertemplate": "%{text}<extra></extra>"}
        if first.written:
            ups = [mark.prefer[1] or middle[1] - mark.y for mark in group]  # sideways inwards, so that no label leaves the chart
            sides = [
                f"{'top' if up > 0.0 else 'bottom'} {'right' if mark.x < middle[0] else 'left'}"
                for mark, up in zip(group, ups, strict=True)
            ]
            data |= {"textposition": sides, "textfont": {"color": readable(first.colour), "size": 11}}
        hoverable = first.text and not (first.written and spec.picks is not None)  # otherwise hovering shows the points below
        traces.append(data | ({} if hoverable else {"hoverinfo": "skip", "hovertemplate": None}))
    return traces
