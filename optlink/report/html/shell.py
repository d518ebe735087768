"""HTML document of a report: one self-contained file without network access."""

from __future__ import annotations

import base64
import hashlib
import json
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from html import escape
from importlib.resources import files
from pathlib import Path
from string import Template
from typing import Any

from rich.table import Table
from rich.text import Text

from optlink.report.files import whole
from optlink.report.html import tables
from optlink.report.html.chart_plotly import Chart, Picks
from optlink.report.html.moving_linkage import Moving
from optlink.version import VERSION

LARGEST = 6_000_000  # largest size of a page [bytes]
STEPS = (360, 180, 90)  # numbers of positions per revolution, tried in this order
SHORT = 20  # rows up to which a table is not broken in print
WIDE, HUGE = 72, 105  # widths [characters] beyond which a table spans the page, and is too wide for paper
ASSETS = files("optlink.report").joinpath("assets")


@dataclass(frozen=True)
class Section:
    """Part of a page under a heading: HTML fragments and charts in order."""

    name: str
    parts: Sequence[str | Chart]


@dataclass(frozen=True)
class Sheet:
    """Content of a page: `kind` above the title, the verdict and whether it is positive, `status` as HTML below it."""

    title: str
    kind: str
    verdict: str
    good: bool
    status: str
    sections: Sequence[Section]
    moving: Moving | None = None

    @cached_property
    def charts(self) -> tuple[Chart, ...]:
        """Charts of all sections; charts are numbered in this order."""
        return tuple(part for section in self.sections for part in section.parts if isinstance(part, Chart))

    def html(self) -> str:
        """Return the complete document."""
        script, plotly = _asset("page.js"), _plotly()
        parts = {
            "policy": _policy(plotly, script),
            "version": VERSION,
            "title": escape(self.title),
            "kind": escape(self.kind),
            "style": _asset("page.css"),
            "verdict": escape(self.verdict),
            "verdict_class": "ok" if self.good else "fail",
            "sign": "✓" if self.good else "✗",
            "status": self.status,
            "links": "".join(f'<a href="#{_anchor(one.name)}">{escape(one.name)}</a>' for one in self.sections),
            "sections": "\n".join(self._section(one) for one in self.sections),
            "footer": f"Made by optlink {VERSION}. This page is complete: it loads nothing from anywhere.",
            "motion": _json(None if self.moving is None else self.moving.to_dict()),
            "charts": _json([_charted(chart) for chart in self.charts]),
            "plotly": plotly,
            "script": script,
        }
        return Template(_asset("page.html")).substitute(parts)

    def _section(self, section: Section) -> str:
        parts = [
            _figure(part, self.charts.index(part) + 1) if isinstance(part, Chart) else part for part in section.parts if part
        ]
        heading = f"<h2>{escape(section.name)}</h2>"
        return f'<section id="{_anchor(section.name)}">{heading}\n{"".join(parts)}</section>'


def fitted(made: Callable[[int], Sheet]) -> str:
    """Return the document of a sheet with the most positions per revolution that keep it below `LARGEST`."""
    for steps in STEPS:
        text = made(steps).html()
        if len(text.encode()) <= LARGEST:
            break
    return text


def write(text: str, path: Path) -> None:
    """Write a page.

    Parameters
    ----------
    text : str
        HTML document.
    path : Path

    Raises
    ------
    InputError
        If the file cannot be written; then no file is left behind.
    """
    with whole(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


# --- parts -------------------------------------------------------------------------------------------------------------------


def cards(parts: Iterable[Table | Text]) -> str:
    """Return tables as cards and texts as paragraphs; wide tables span the page, short ones are not broken in print."""
    found = []
    for part in parts:
        if isinstance(part, Table):
            width = tables.width(part)
            sizes = {"wide": width > WIDE, "huge": width > HUGE, "short": part.row_count <= SHORT}
            marks = ["card", *(name for name, holds in sizes.items() if holds)]
            found.append(f'<div class="{" ".join(marks)}">{tables.table(part)}</div>')
        else:
            found.append(tables.paragraph(part))
    return f'<div class="cards">{"".join(found)}</div>'


def facts(rows: Iterable[tuple[str, str]]) -> str:
    """Return names and values as a description list."""
    return f'<dl class="facts">{"".join(f"<dt>{escape(name)}</dt><dd>{escape(text)}</dd>" for name, text in rows)}</dl>'


def _figure(chart: Chart, number: int) -> str:
    height = int(chart.figure["layout"]["height"])
    names = dict.fromkeys(trace["name"] for trace in chart.figure["data"] if trace.get("name"))
    label = f"{escape(chart.title)}: {', '.join(names)}"  # names of traces are escaped already
    place = f'<div class="plot" id="chart-{number}" role="img" aria-label="{label}" style="min-height:{height}px"></div>'
    remark = f'<p class="quiet">{escape(chart.remark)}</p>' if chart.remark else ""
    picked = "" if chart.picks is None else _picked(chart.picks, number)
    return f"<figure><figcaption>{escape(chart.title)}</figcaption>{remark}{place}{picked}</figure>"


def _picked(picks: Picks, number: int) -> str:
    """Return the quantities of the selected point of a chart, and the slider that selects it."""
    shown = picks.rows[picks.first]
    listed = "".join(
        f"<div><dt>{escape(name)}</dt><dd data-pick>{escape(text)}</dd></div>"
        for name, text in zip(picks.names, shown, strict=True)
    )
    last, at = len(picks.rows) - 1, f"{picks.first + 1} of {len(picks.rows)}"
    slider = f'<input type="range" id="pick-{number}" min="0" max="{last}" step="1" value="{picks.first}" aria-valuetext="{at}">'
    controls = '<p class="quiet hint">Point at a place of the chart, or move the slider: what belongs to it is told here.</p>'
    controls += f'<div class="controls"><label for="pick-{number}">{escape(picks.what)}</label>{slider}'
    controls += f'<output for="pick-{number}">{at}</output></div>'
    return f'<div class="picked">{controls}<dl class="readouts" aria-live="polite">{listed}</dl></div>'


def _charted(chart: Chart) -> dict[str, Any]:
    """Return the data of a chart for the page script."""
    found: dict[str, Any] = {"figure": chart.figure, "cranked": chart.cranked}
    if chart.picks is not None:
        picks = chart.picks
        found["picks"] = {"rows": picks.rows, "x": picks.x, "y": picks.y, "first": picks.first}
    return found


# --- data for the page script ------------------------------------------------------------------------------------------------


def _json(document: object) -> str:
    """Serialise a document for a script element; characters that could end the element are escaped."""
    text = json.dumps(document, separators=(",", ":"), allow_nan=False)
    return text.replace("&", "\\u0026").replace("<", "\\u003c").replace(">", "\\u003e")


def _policy(*scripts: str) -> str:
    """Return the content security policy: only these scripts, no network access."""
    hashes = " ".join(f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'" for text in scripts)
    rest = "style-src 'unsafe-inline'; img-src data: blob:; base-uri 'none'; form-action 'none'"
    return f"default-src 'none'; script-src {hashes}; {rest}"


def _anchor(name: str) -> str:
    return name.lower().replace(" ", "-")


@cache
def _asset(name: str) -> str:
    return ASSETS.joinpath(name).read_text(encoding="utf-8")


@cache
def _plotly() -> str:
    """Return plotly.js as shipped with the Python package."""
    from plotly.offline import get_plotlyjs

    return get_plotlyjs()  # type: ignore[no-any-return]
