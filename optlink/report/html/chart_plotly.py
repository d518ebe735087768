"""Figures of a report in plotly's own words: curves, axes, panels above one another. What they show is told by `charts`."""

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
DIGITS = 7  # of a number in a chart: a thousand times finer than anybody sees
FONT = "system-ui, -apple-system, 'Segoe UI', 'DejaVu Sans', sans-serif"
CRANK_ANGLE = "crank angle φ [deg]"


@dataclass(frozen=True)
class Picks:
    """Points of a chart that can be picked: the figures of each as texts under common names, and where it is marked.

    `what`: what one is called; `first`: the one that is shown at the beginning.
    """

    what: str
    names: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    x: list[float | None]
    y: list[float | None]
    first: int = 0


@dataclass(frozen=True, eq=False)
class Chart:
    """A chart: its title, its figure, and whether its x axis is that of the slider, so that a cursor can follow.

    `picks`: what can be picked in it; `remark`: what a reader should know of it.
    """

    title: str
    figure: dict[str, Any]
    cranked: bool = True
    picks: Picks | None = None
    remark: str = ""


@dataclass(frozen=True)
class Panel:
    """Curves over a common x axis, with the name of their y axis; `share` is the height beside other panels."""

    name: str
    traces: Sequence[Trace]
    share: float = 1.0


def line(x: Array, y: Array, name: str, colour: str, *, width: float = 2.0, dash: str = "solid", mode: str = "lines") -> Trace:
    """A curve; broken where it has no value."""
    trace = {"type": "scatter", "mode": mode, "name": escape(name), "x": short(x), "y": short(y)}
    if mode == "markers":
        return trace | {"marker": {"color": colour, "size": width}}
    return trace | {"line": {"color": colour, "width": width, "dash": dash}}


def short(values: Array) -> list[float | None]:
    """Values to the digits of a chart; None where there is none."""
    size = float(np.max(np.abs(values), initial=0.0, where=np.isfinite(values)))
    decimals = DIGITS - math.floor(math.log10(size)) if size > 0.0 else DIGITS
    return finite(np.round(values, decimals))  # type: ignore[no-any-return]


def stacked(panels: Sequence[Panel], x_name: str = CRANK_ANGLE, *, reversed_x: bool = False) -> dict[str, Any]:
    """A figure of panels above one another that share the x axis."""
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
    """An axis with its name."""
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
    """The look of every chart [pixels]: white, a level legend above, figures of all curves under the pointer."""
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
    """A limit as a level line."""
    ends = np.array([np.nanmin(x), np.nanmax(x)])
    return line(ends, np.full(2, value), words, LIMIT, width=1.4, dash="dash")


def filled(colour: str) -> Trace:
    """What fills bars with a colour."""
    return {"marker": {"color": colour}}


# --- what is picked ----------------------------------------------------------------------------------------------------------


def mark(picks: Picks) -> Trace:
    """The mark of the picked point: always the last curve of a chart, where the script looks for it."""
    look = {"color": "rgba(0,0,0,0)", "size": 13.0, "line": {"color": WANTED, "width": 2.2}}
    at = {"x": [picks.x[picks.first]], "y": [picks.y[picks.first]]}
    return {"type": "scatter", "mode": "markers", "name": "", "showlegend": False, "hoverinfo": "skip", "marker": look} | at


# --- long curves -------------------------------------------------------------------------------------------------------------


def thinned(x: Array, y: Array, most: int = 2000) -> tuple[Array, Array]:
    """A long curve as at most about so many points: of each of its portions the least and the largest value, in their order."""
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
