"""HTML document of a report: one self-contained file without network access."""

from __future__ import annotations

import base64
import datetime
import gzip
import hashlib
import json
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from importlib.resources import files
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from optlink.presentation.export.dimensions import Drawing
from optlink.presentation.format import pretty
from optlink.presentation.html import theme
from optlink.presentation.html.chart_plotly import Chart, short
from optlink.presentation.html.gallery import Gallery
from optlink.presentation.html.moving_linkage import Moving
from optlink.presentation.table_spec import Paragraph, Part, TableSpec
from optlink.presentation.view import PageSection, StoredStudy
from optlink.problem.file import ProblemFile
from optlink.version import VERSION

MAX_BYTES = 2_000_000  # largest size of a page [bytes]
STEPS = (360, 180, 90)  # numbers of positions per revolution, tried in this order
UNBROKEN_ROWS = 20  # rows up to which a table is not broken in print
UNBROKEN_LENGTH = 36  # length up to which a text is not broken [characters]
NARROW, WIDE, HUGE = 46, 72, 105  # widths [characters] beyond which a table is too wide for a telephone, a column, paper
DIGITS = 4  # significant digits of numbers outside the appendix
_KEY_DOT = re.compile(r"(?<=[a-z_]\.)(?=[a-z_])")  # where a key such as mechanism.frame may be broken
_DECIMAL = re.compile(r"(?<![\w.,])(\d+\.\d+)(e[-+]\d+)?(?![\w]|\.\d)")


@dataclass(frozen=True)
class PageContent:
    """Content of a page: what it is about, its sections with the appendix, the linkage in motion; whether it is short."""

    about: StoredStudy
    sections: Sequence[PageSection]
    moving: Moving | None
    brief: bool = False

    @cached_property
    def charts(self) -> tuple[Chart, ...]:
        """Charts of all sections; charts are numbered in this order."""
        return tuple(part for section in self.sections for part in section.parts if isinstance(part, Chart))

    def html(self) -> str:
        """Return the complete document."""
        script, (library, packed) = asset("motion.js") + asset("page.js"), plotly()
        charts = [_chart_data(chart) for chart in self.charts]
        drawings = [part.svg for section in self.sections for part in section.parts if isinstance(part, Drawing | Gallery)]
        drawn = [json.dumps(charts), "" if self.moving is None else self.moving.svg(""), *drawings]
        colours = theme.palette(drawn)  # in dark mode
        swapped = "".join(f"--c{colour[1:]}:{other};" for colour, other in colours.items())
        return (
            templates()
            .get_template("page.html")
            .render(
                sheet=self,
                about=self.about,
                status=Paragraph(*self.about.status, *(f"Note: {note}" for note in self.about.notes)),
                letterhead=letterhead(self.about.problem),
                policy=_policy(library, script),
                version=VERSION,
                style=asset("page.css").replace("/*drawn*/", swapped),
                motion=None if self.moving is None else self.moving.to_dict(),
                charts={"charts": charts, "dark": colours},
                plotly=packed,
                script=script,
            )
        )


def letterhead(file: ProblemFile) -> dict[str, str]:
    """Return the facts at the head of a page by name, without the empty ones; the default date is today."""
    facts = file.model.report.model_dump()
    facts["date"] = facts["date"] or datetime.datetime.now(tz=datetime.UTC).date().isoformat()
    return {name: " ".join(text.split()) for name, text in facts.items() if text.strip()}


def arrange(sections: Iterable[PageSection], closing: Iterable[PageSection]) -> tuple[PageSection, ...]:
    """Return the sections with numbers of four digits, and the appendix.

    The appendix contains the tables marked for it, the tables that lost digits with all their digits, and the closing sections.
    """
    arranged_sections, moved, exact = list[PageSection](), list[Part](), list[Part]()
    for section in sections:
        parts = list[Any]()
        for item in section.parts:
            group = item if isinstance(item, list | tuple) else (item,)
            moved += (part for part in group if _appended(part))
            stay = tuple(part for part in group if not _appended(part))
            brief = tuple(_rounded_table(part) for part in stay)
            exact += (part for part, short_ in zip(stay, brief, strict=True) if part != short_)
            parts += [brief] if group is item and brief else brief
        arranged_sections += [replace(section, parts=tuple(parts))] if parts else []
    tables = [PageSection("Checks and solution", (tuple(moved),))] if moved else []
    tables += [PageSection("All digits", (tuple(exact),))] if exact else []
    return (*arranged_sections, PageSection("Appendix", (*tables, *closing)))


def _appended(part: object) -> bool:
    return isinstance(part, Paragraph | TableSpec) and part.appendix


def _rounded_table(part: Any) -> Any:
    """Return a table with numbers of four digits, unless it needs all; anything else as it is."""
    if not isinstance(part, TableSpec) or part.exact:
        return part
    return replace(part, rows=tuple(tuple(replace(cell, text=four_digits(cell.text)) for cell in row) for row in part.rows))


def four_digits(text: str) -> str:
    """Round the decimal numbers of a text to four significant digits, whole parts to the unit."""

    def rounded(match: re.Match[str]) -> str:
        digits, power = match[1], match[2] or ""
        if len(digits.replace(".", "").lstrip("0")) <= DIGITS:
            return match[0]
        value = float(digits)
        shown = f"{value:z.0f}" if value >= 10**DIGITS else f"{value:#.{DIGITS}g}".rstrip(".")
        return shown + power

    return _DECIMAL.sub(rounded, text)


# --- templates ---------------------------------------------------------------------------------------------------------------


@cache
def templates() -> Environment:
    """Return the templates of pages and notebooks."""
    environment = Environment(
        loader=PackageLoader("optlink.presentation"),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=StrictUndefined,
    )
    kinds = {
        "paragraph": Paragraph,
        "table": TableSpec,
        "chart": Chart,
        "linkage": Moving,
        "drawing": Drawing,
        "section": PageSection,
        "gallery": Gallery,
    }
    environment.tests.update({name: lambda shown, kind=kind: isinstance(shown, kind) for name, kind in kinds.items()})
    environment.tests["short"] = lambda cell: max(map(len, cell.text.split("\n"))) <= UNBROKEN_LENGTH  # must not be broken
    environment.policies["json.dumps_kwargs"] = {"separators": (",", ":"), "allow_nan": False}
    environment.filters.update(lines=_lines, card_classes=_card_classes, row_header=_row_header)
    environment.filters.update(four=four_digits, coloured=lambda text: Markup(theme.variable(text)))
    return environment


def fragment(*parts: Part) -> str:
    """Return tables and paragraphs as HTML without a page around them."""
    module = templates().get_template("parts.html").module
    return "".join(module.part(part) for part in parts)  # type: ignore[attr-defined]


def _lines(text: str) -> Markup:
    return Markup("<br>").join(Markup("<wbr>").join(_KEY_DOT.split(line)) for line in pretty(text).split("\n"))


def _card_classes(spec: TableSpec) -> str:
    """Return the classes of a table: a wide one spans the page, a short one is not broken in print."""
    width = table_width(spec)
    sizes = {
        "stack": width > NARROW and spec.header,
        "wide": width > WIDE,
        "huge": width > HUGE,
        "short": len(spec.rows) <= UNBROKEN_ROWS,
    }
    return " ".join(["card", *(name for name, holds in sizes.items() if holds)])


def table_width(spec: TableSpec) -> int:
    """Return the least width of a table in characters, with numbers and short texts unbroken."""
    width = 0
    for k, column in enumerate(spec.columns):
        lines = [line for text in (column.name, *(row[k].text for row in spec.rows)) for line in text.split("\n")]
        pieces = (piece for line in lines for piece in ([line] if column.right or len(line) <= UNBROKEN_LENGTH else line.split()))
        width += 2 + max(map(len, pieces), default=0)
    return width


def _row_header(spec: TableSpec) -> int:
    """Return the column that names the rows: the first of texts that are no verdicts; -1 if there is none."""
    texts = (
        k
        for k, column in enumerate(spec.columns)
        if not column.right and not any(row[k].role in ("good", "bad") for row in spec.rows)
    )
    first = next(texts, -1)
    return first if first < len(spec.columns) - 1 else -1


def _chart_data(chart: Chart) -> dict[str, Any]:
    """Return the data of a chart for the page script."""
    data: dict[str, Any] = {"figure": chart.figure, "cranked": chart.cranked}
    if chart.picks is not None:
        picks = chart.picks
        data["drawings"] = {k: drawing.svg for k, drawing in chart.drawings.items()}
        data["picks"] = {
            "rows": [[four_digits(text) for text in row] for row in picks.rows],
            "x": short(picks.x),
            "y": short(picks.y),
            "first": picks.first,
        }
    return data


# --- data for the page script ------------------------------------------------------------------------------------------------


def _policy(*scripts: str) -> str:
    """Return the content security policy: only these scripts, no network access."""
    hashes = " ".join(f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'" for text in scripts)
    rest = "style-src 'unsafe-inline'; img-src data: blob:; base-uri 'none'; form-action 'none'"
    return f"default-src 'none'; script-src {hashes}; {rest}"


@cache
def asset(name: str) -> str:
    """Return a script or style sheet of the package."""
    return files("optlink.presentation").joinpath("assets", name).read_text(encoding="utf-8")


@cache
def plotly() -> tuple[str, str]:
    """Return plotly.js, and the same compressed for a page: of the npm package plotly.js-cartesian-dist-min, by `gzip -9n`."""
    packed = files("optlink.presentation").joinpath("assets", "plotly-cartesian.min.js.gz").read_bytes()
    return gzip.decompress(packed).decode(), base64.b64encode(packed).decode()


def plotly_version() -> str:
    """Return the version of plotly.js, which its first lines name."""
    return plotly()[0].partition(" v")[2].partition("\n")[0]
