"""Conversion of terminal tables and texts to HTML."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from html import escape
from itertools import pairwise

from rich.console import Console, Group, RenderableType
from rich.style import Style
from rich.table import Table
from rich.text import Text

from optlink.report.views.function_tables import BAD, GOOD, HEAD, QUIET

WIDE = 10_000  # width of a terminal that breaks no table [characters]
WHOLE = 36  # length up to which a text is not broken [characters]
CLASSES = {GOOD: "good", BAD: "bad", QUIET: "quiet", HEAD: "strong"}


def flat(told: RenderableType) -> Iterator[Table | Text]:
    """Yield the texts and tables of a renderable in order."""
    if isinstance(told, Group):
        for part in told.renderables:
            yield from flat(part)
    elif isinstance(told, Table | Text):
        yield told
    elif isinstance(told, str):
        yield Text(told)
    else:  # a renderable that adapts to the width of the terminal
        console = Console(width=WIDE)
        made: Iterable[object] = told.__rich_console__(console, console.options)  # type: ignore[union-attr]
        for piece in made:
            if isinstance(piece, Group | Table | Text):
                yield from flat(piece)


def paragraph(text: Text, *, plain: bool = False) -> str:
    """Return the lines of a text as HTML paragraphs.

    Parameters
    ----------
    text : Text
    plain : bool, optional
        Drop the style that applies to the whole text.
    """
    lines = [line for line in text.split("\n") if line.plain.strip()]
    for line in lines if plain else []:
        line.style = ""
    return "".join(f"<p>{_inline(line)}</p>" for line in lines)


def table(told: Table) -> str:
    """Return a table with its title and caption as HTML."""
    title = _inline(_text(told.title)).strip() if told.title else ""
    remark = f'<p class="quiet">{_inline(_text(told.caption))}</p>' if told.caption else ""
    columns = told.columns
    right = [' class="num"' if column.justify == "right" else "" for column in columns]
    lines = [f"<h3>{title}</h3>" if title else "", '<div class="scroll"><table>']
    if told.show_header:
        heads = (
            f'<th scope="col"{where}>{_inline(_text(column.header))}</th>' for column, where in zip(columns, right, strict=True)
        )
        lines.append(f"<thead><tr>{''.join(heads)}</tr></thead>")
    lines.append("<tbody>")
    for row in zip(*(list(column.cells) for column in columns), strict=True):
        cells = (f"<td{where or _kept(_text(cell))}>{_lines(_text(cell))}</td>" for cell, where in zip(row, right, strict=True))
        lines.append(f"<tr>{''.join(cells)}</tr>")
    lines.append(f"</tbody></table></div>{remark}")
    return "\n".join(filter(None, lines))


def width(told: Table) -> int:
    """Return the least width of a table in characters, with numbers and short texts unbroken."""
    found = 0
    for column in told.columns:
        cells = [line for cell in (column.header, *column.cells) for line in _text(cell).plain.split("\n")]
        pieces = (
            piece for cell in cells for piece in ([cell] if column.justify == "right" or len(cell) <= WHOLE else cell.split())
        )
        found += 2 + max(map(len, pieces), default=0)
    return found


def _kept(text: Text) -> str:
    """Return the class attribute of a cell that must not be broken."""
    return ' class="whole"' if max(map(len, text.plain.split("\n"))) <= WHOLE else ""


def _text(told: object) -> Text:
    return told if isinstance(told, Text) else Text(str(told))


def _lines(text: Text) -> str:
    return "<br>".join(_inline(line) for line in text.split("\n"))


def _inline(text: Text) -> str:
    """Return a line with its styles as HTML; its content is escaped."""
    plain = text.plain
    edges = sorted({0, len(plain), *(edge for span in text.spans for edge in (span.start, span.end) if edge <= len(plain))})
    found = []
    for begin, end in pairwise(edges):
        styles = [text.style, *(span.style for span in text.spans if span.start <= begin and end <= span.end)]
        marks = [CLASSES[name] for style in styles if (name := _named(style)) in CLASSES]
        piece = escape(plain[begin:end])
        found.append(f'<span class="{" ".join(marks)}">{piece}</span>' if marks else piece)
    return "".join(found)


def _named(style: str | Style) -> str:
    return style if isinstance(style, str) else str(style)
