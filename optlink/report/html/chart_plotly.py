"""Building blocks of plotly charts: curves, axes, stacked panels."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from typing import Any

import numpy as np
from numpy.typing import NDArray

from optlink.io import finite
from optlink.report.style import LIMIT, WANTED

Array = NDArray[np.float64]
Trace = dict[str, Any]
DIGITS = 7  # significant digits of a number in a chart, far below the visible resolution
FONT = "system-ui, -apple-system, 'Segoe UI', 'DejaVu Sans', sans-serif"
CRANK_ANGLE = "crank angle φ [deg]"


@dataclass(frozen=True)
class Picks:
    """Selectable points of a chart: quantities of each as text under common names, and their positions.

    `what` names one point; `first` is the point shown at the beginning.
    """

    what: str
    names: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    x: list[float | None]
    y: list[float | None]
    first: int = 0


@dataclass(frozen=True, eq=False)
class Chart:
    """A chart: title, plotly figure, and whether its x axis is that of the slider, so that a cursor can follow.

    `picks` are its selectable points; `remark` is a note to the reader.
    """

    title: str
    figure: dict[str, Any]
    cranked: bool = True
    picks: Picks | None = None
    remark: str = ""


@dataclass(frozen=True)
class Panel:
    """Curves over a common x axis with the name of their y axis; `share` is the relative height."""

    name: str
    traces: Sequence[Trace]
    share: float = 1.0


def line(x: Array, y: Array, name: str, colour: str, *, width: float = 2.0, dash: str = "solid", mode: str = "lines") -> Trace:
    """Return a curve or markers, with gaps at NaN.

    Parameters
    ----------
    x : array (n,)
    y : array (n,)
    name : str
        Entry in the legend.
    colour : str
    width : float [pixel], optional
        Line width, or marker size in mode "markers".
    dash : str, optional
        Line style of plotly.
    mode : str, optional
        "lines", "markers" or "lines+markers".
    """
    trace = {"type": "scatter", "mode": mode, "name": escape(name), "x": short(x), "y": short(y)}
    if mode == "markers":
        return trace | {"marker": {"color": colour, "size": width}}
    return trace | {"line": {"color": colour, "width": width, "dash": dash}}


def short(values: Array) -> list[float | None]:
    """Return the values rounded to the digits of a chart; None where they are not finite."""
    size = float(np.max(np.abs(values), initial=0.0, where=np.isfinite(values)))
    decimals = DIGITS - math.floor(math.log10(size)) if size > 0.0 else DIGITS
    return finite(np.round(values, decimals))  # type: ignore[no-any-return]


def stacked(panels: Sequence[Panel], x_name: str = CRANK_ANGLE, *, reversed_x: bool = False) -> dict[str, Any]:
    """Return a plotly figure of stacked panels with a common x axis.

    Parameters
    ----------
    panels : sequence of Panel
        From top to bottom.
    x_name : str, optional
        Label of the x axis.
    reversed_x : bool, optional
        Let x increase to the left.
    """
    gap = 0.07
    heights = [panel.share for panel in panels]
    unit = (1.0 - gap * (len(panels) - 1)) / sum(heights)
    layout: dict[str, Any] = sheet(int(110 + 200 * sum(heights)))
    traces, top = [], 1.0
    for number, panel in enumerate(panels, 1):
        key = "" if number == 1 else str(number)
        bottom = max(0.0, top - unit * panel.share)
        layout[f"yaxis{key}"] = axis(panel.name) | {"domain": [bottom, top]}
        top = bottom - gap
        traces += [trace | {"yaxis": f"y{key}"} for trace in panel.traces]
    layout["xaxis"] = axis(x_name) | {"anchor": f"y{len(panels) if len(panels) > 1 else ''}", "hoverformat": ".2f"}
    if x_name == CRANK_ANGLE:
        layout["xaxis"] |= {"dtick": 30 if _span(traces) <= 200.0 else 60}
    if reversed_x:
        layout["xaxis"]["autorange"] = "reversed"
    return {"data": traces, "layout": layout}


def _span(traces: Sequence[Trace]) -> float:
    values = [x for trace in traces for x in trace["x"] if x is not None]
    return max(values) - min(values) if values else 0.0


def axis(name: str) -> dict[str, Any]:
    """Return the layout of an axis."""
    return {
        "title": {"text": escape(name), "font": {"size": 13}, "standoff": 8},
        "gridcolor": "#e7e9ec",
        "zerolinecolor": "#b9bec5",
        "linecolor": "#8a9099",
        "ticks": "outside",
        "tickcolor": "#8a9099",
        "automargin": True,
    }


def sheet(height: int) -> dict[str, Any]:
    """Return the common layout of all charts; `height` in pixels."""
    return {
        "height": height,
        "margin": {"l": 70, "r": 20, "t": 34, "b": 50},
        "font": {"family": FONT, "size": 12, "color": "#22262b"},
        "paper_bgcolor": "#ffffff",
        "plot_bgcolor": "#ffffff",
        "hovermode": "x unified",
        "legend": {"orientation": "h", "x": 0.0, "y": 1.01, "xanchor": "left", "yanchor": "bottom"},
        "showlegend": True,
    }


def level(x: Array, value: float, words: str) -> Trace:
    """Return a limit as a horizontal line.

    Parameters
    ----------
    x : array (n,)
        Range of the line.
    value : float
    words : str
        Entry in the legend.
    """
    ends = np.array([np.nanmin(x), np.nanmax(x)])
    return line(ends, np.full(2, value), words, LIMIT, width=1.4, dash="dash")


def filled(colour: str) -> Trace:
    """Return the trace attributes for bars of a colour."""
    return {"marker": {"color": colour}}


# --- selection ---------------------------------------------------------------------------------------------------------------


def mark(picks: Picks) -> Trace:
    """Return the marker of the selected point; the page script expects it as the last trace of a chart."""
    look = {"color": "rgba(0,0,0,0)", "size": 13.0, "line": {"color": WANTED, "width": 2.2}}
    at = {"x": [picks.x[picks.first]], "y": [picks.y[picks.first]]}
    return {"type": "scatter", "mode": "markers", "name": "", "showlegend": False, "hoverinfo": "skip", "marker": look} | at


# --- long curves -------------------------------------------------------------------------------------------------------------


def thinned(x: Array, y: Array, most: int = 2000) -> tuple[Array, Array]:
    """Reduce a long curve to at most about `most` points, keeping the extremes of each portion.

    Parameters
    ----------
    x : array (n,)
    y : array (n,)
    most : int, optional
    """
    if len(x) <= most:
        return x, y
    edges = np.linspace(0, len(x), most // 2 + 1).astype(int)
    kept: set[int] = {0, len(x) - 1}
    for first, last in itertools.pairwise(edges.tolist()):
        portion = y[first:last]
        if np.all(np.isnan(portion)):
            kept.add(first)
            continue
        kept |= {first + int(np.nanargmin(portion)), first + int(np.nanargmax(portion))}
    rows = np.array(sorted(kept))
    return x[rows], y[rows]
