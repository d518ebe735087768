"""HTML document of a report: one self-contained file without network access."""

from __future__ import annotations

import base64
import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from html import unescape
from importlib.resources import files
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from optlink.report.files import whole
from optlink.report.html.chart_plotly import Chart, short
from optlink.report.html.moving_linkage import Moving
from optlink.report.table_spec import Paragraph, Part, Span, TableSpec
from optlink.version import VERSION

LARGEST = 6_000_000  # largest size of a page [bytes]
STEPS = (360, 180, 90)  # numbers of positions per revolution, tried in this order
SHORT = 20  # rows up to which a table is not broken in print
WHOLE = 36  # length up to which a text is not broken [characters]
WIDE, HUGE = 72, 105  # widths [characters] beyond which a table spans the page, and is too wide for paper


@dataclass(frozen=True)
class PageSection:
    """Part of a page under a heading: charts, the moving linkage, paragraphs, facts by name, and groups of tables in order."""

    name: str
    parts: Sequence[Part | Chart | Moving | Mapping[str, str] | Sequence[Part]]

    @property
    def anchor(self) -> str:
        """Name of the section in links."""
        return self.name.lower().replace(" ", "-")


@dataclass(frozen=True)
class PageContent:
    """Content of a page: `kind` above the title, the verdict and whether it is positive, and the status below it."""

    title: str
    kind: str
    verdict: str
    good: bool
    status: Paragraph
    sections: Sequence[PageSection]
    moving: Moving | None = None

    @cached_property
    def charts(self) -> tuple[Chart, ...]:
        """Charts of all sections; charts are numbered in this order."""
        return tuple(part for section in self.sections for part in section.parts if isinstance(part, Chart))

    def html(self) -> str:
        """Return the complete document."""
        script, plotly = _asset("page.js"), _plotly()
        return (
            _templates()
            .get_template("page.html")
            .render(
                sheet=self,
                policy=_policy(plotly, script),
                version=VERSION,
                style=_asset("page.css"),
                motion=None if self.moving is None else self.moving.to_dict(),
                charts=[_charted(chart) for chart in self.charts],
                plotly=plotly,
                script=script,
            )
        )


def fitted(made: Callable[[int], PageContent]) -> str:
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


# --- templates ---------------------------------------------------------------------------------------------------------------


@cache
def _templates() -> Environment:
    made = Environment(
        loader=PackageLoader("optlink.report"),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=StrictUndefined,
    )
    kinds = {"paragraph": Paragraph, "table": TableSpec, "chart": Chart, "linkage": Moving}
    made.tests.update({name: lambda shown, kind=kind: isinstance(shown, kind) for name, kind in kinds.items()})
    made.tests["short"] = _is_short
    made.filters.update(json=_json, lines=_lines, card_classes=_card_classes, trace_names=_trace_names)
    return made


def fragment(*parts: Part) -> str:
    """Return tables and paragraphs as HTML without a page around them."""
    made = _templates().get_template("parts.html").module
    return "".join(made.part(one) for one in parts)  # type: ignore[attr-defined]


def _lines(text: str) -> Markup:
    return Markup("<br>").join(text.split("\n"))


def _is_short(cell: Span) -> bool:
    """Return whether a cell must not be broken."""
    return max(map(len, cell.text.split("\n"))) <= WHOLE


def _card_classes(spec: TableSpec) -> str:
    """Return the classes of a table: a wide one spans the page, a short one is not broken in print."""
    width = table_width(spec)
    sizes = {"wide": width > WIDE, "huge": width > HUGE, "short": len(spec.rows) <= SHORT}
    return " ".join(["card", *(name for name, holds in sizes.items() if holds)])


def table_width(spec: TableSpec) -> int:
    """Return the least width of a table in characters, with numbers and short texts unbroken."""
    found = 0
    for k, column in enumerate(spec.columns):
        lines = [line for text in (column.name, *(row[k].text for row in spec.rows)) for line in text.split("\n")]
        pieces = (piece for line in lines for piece in ([line] if column.right or len(line) <= WHOLE else line.split()))
        found += 2 + max(map(len, pieces), default=0)
    return found


def _trace_names(chart: Chart) -> str:
    names = dict.fromkeys(trace["name"] for trace in chart.figure["data"] if trace.get("name"))
    return unescape(", ".join(names))  # plotly needs the names of traces escaped


def _charted(chart: Chart) -> dict[str, Any]:
    """Return the data of a chart for the page script."""
    found: dict[str, Any] = {"figure": chart.figure, "cranked": chart.cranked}
    if chart.picks is not None:
        picks = chart.picks
        found["picks"] = {"rows": picks.rows, "x": short(picks.x), "y": short(picks.y), "first": picks.first}
    return found


# --- data for the page script ------------------------------------------------------------------------------------------------


def _json(document: object) -> Markup:
    """Serialise a document for a script element; characters that could end the element are escaped."""
    text = json.dumps(document, separators=(",", ":"), allow_nan=False)
    return Markup(text.replace("&", "\\u0026").replace("<", "\\u003c").replace(">", "\\u003e"))


def _policy(*scripts: str) -> str:
    """Return the content security policy: only these scripts, no network access."""
    hashes = " ".join(f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'" for text in scripts)
    rest = "style-src 'unsafe-inline'; img-src data: blob:; base-uri 'none'; form-action 'none'"
    return f"default-src 'none'; script-src {hashes}; {rest}"


@cache
def _asset(name: str) -> str:
    return files("optlink.report").joinpath("assets", name).read_text(encoding="utf-8")


@cache
def _plotly() -> str:
    """Return plotly.js as shipped with the Python package."""
    from plotly.offline import get_plotlyjs

    return get_plotlyjs()  # type: ignore[no-any-return]
