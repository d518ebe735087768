"""Tables and texts of a result on a terminal."""

import copy
import os
import re
import sys
from collections.abc import Iterator, Sequence
from dataclasses import fields, is_dataclass
from typing import Literal, TypeVar

from rich import box
from rich.console import Console, ConsoleDimensions, ConsoleOptions, Group, RenderableType, RenderResult
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

from optlink.errors import visible
from optlink.presentation.format import product
from optlink.presentation.table_spec import Paragraph, Part, Span, Summary, TableSpec

T = TypeVar("T")

STYLES = {"": "", "good": "green", "bad": "bold red", "quiet": "dim", "strong": "bold"}
GAP = 2  # gap between columns [characters]
MIN_WIDTH = 20  # characters of a line; a narrower terminal breaks it
WIDEST_TITLE = 79  # a table is at least as wide as its title, up to this width
INDENT = 4  # indentation of the values below the name of a row
_WORD = re.compile(r"\S+(?: %(?!\S))?")  # a figure and its % stay on one line


class _Console(Console):
    """Console that leaves a closed pipe to the command line, which sets the exit code."""

    def on_broken_pipe(self) -> None:
        """Re-raise the error."""
        raise  # noqa: PLE0704  (rich calls this while it handles the error)


def console(*, stderr: bool = False) -> Console:
    """Return a console that prints text verbatim, without markup or highlighting."""
    colours: Literal["auto"] | None = None if os.environ.get("NO_COLOR") else "auto"
    place = sys.stderr if stderr else None  # kept, so that a bar is drawn while casadi's reports are suppressed
    result = _Console(file=place, stderr=stderr, highlight=False, markup=False, emoji=False, color_system=colours)
    columns = os.environ.get("COLUMNS", "")  # rich does not ask for it where TERM is dumb
    result.size = ConsoleDimensions(max(int(columns) if columns.isdigit() else result.width, MIN_WIDTH), result.height)
    return result


def show(content: Summary | Part) -> None:
    """Print a summary or a table on standard output, with visible control characters."""
    console().print(rendered(_visible(content)))


def text(content: Summary | Part) -> str:
    """Return what `show` prints, without colours."""
    printer = console()
    printer.is_jupyter = False  # in a notebook rich would show an empty output of its own beside the text
    with printer.capture() as printed:
        printer.print(rendered(_visible(content)))
    return re.sub(r"\x1b\[[\d;]*m| +$", "", printed.get().rstrip("\n"), flags=re.MULTILINE)


def _visible(content: T) -> T:
    """Return a copy of a content with visible control characters in its texts."""
    if isinstance(content, str):
        return visible(content)  # type: ignore[return-value]
    if isinstance(content, tuple | list):
        return type(content)(map(_visible, content))
    if not is_dataclass(content):
        return content
    result = copy.copy(content)
    for item in fields(content):
        object.__setattr__(result, item.name, _visible(getattr(content, item.name)))
    return result


def rendered(content: Summary | Part) -> RenderableType:
    """Return the rich counterpart of a summary, a table or a paragraph."""
    if isinstance(content, Summary):
        status = [_paragraph(content.status)] if content.status.lines else []
        parts = (piece for part in content.parts for piece in (Text(), rendered(part)))
        return Group(Text(content.title, style=STYLES["strong"]), *status, *parts)
    if isinstance(content, Paragraph):
        return _paragraph(content)
    return _Fitted(content)


def _paragraph(paragraph: Paragraph) -> Text:
    return Text("\n").join(Text.assemble(*map(_styled, line)) for line in paragraph.lines)


def _styled(span: Span) -> tuple[str, str]:
    return product(span.text), STYLES[span.role]


def _table(spec: TableSpec, title: str, chosen: Sequence[int], width: int) -> Table | None:
    """Return a table of the chosen columns; None if it would be wider than the terminal."""
    widths = _widths(spec, chosen, width)
    if widths is None:
        return None
    result = Table(
        title=Text(title, style=STYLES["strong"]),
        title_justify="left",
        min_width=min(len(title), width, WIDEST_TITLE),
        box=box.SIMPLE_HEAD if spec.header else None,
        show_header=spec.header,
        header_style=STYLES["quiet"],
        pad_edge=False,
        padding=(0, GAP, 0, 0),
        caption=Text("\n").join(Text(*_styled(note)) for note in spec.notes) if spec.notes else None,
        caption_justify="left",
    )
    for k, wide in zip(chosen, widths, strict=True):
        column = spec.columns[k]
        fits = max(map(len, column.name.split("\n"))) <= max((len(row[k].text) for row in spec.rows), default=0)
        justify: Literal["left", "right"] = "right" if column.right else "left"
        result.add_column(product(column.name), justify=justify, overflow="fold", no_wrap=column.unbroken and fits, width=wide)
    for number, row in enumerate(spec.rows):
        if number in spec.sections:
            result.add_section()
        result.add_row(*(Text(*_styled(row[k]), no_wrap=spec.columns[k].unbroken or None) for k in chosen))
    return result


def _widths(spec: TableSpec, chosen: Sequence[int], width: int) -> list[int] | None:
    """Share out the width of a terminal: longer texts are wrapped between words, not before "%"; None if it is too narrow."""
    frame = (len(chosen) - 1) * (GAP + spec.header) + 2 * spec.header
    texts = [(spec.columns[k], [spec.columns[k].name, *(row[k].text for row in spec.rows)]) for k in chosen]
    full = [max(len(line) for text in cells for line in text.split("\n")) for _, cells in texts]
    words = [max((len(word) for text in cells for word in _WORD.findall(text)), default=0) for _, cells in texts]
    least = [
        max(longest, *(len(line) for text in cells[1:] for line in text.split("\n") if column.unbroken), 0)
        for (column, cells), longest in zip(texts, words, strict=True)
    ]
    free = width - frame - sum(least)
    if free < 0:
        return None
    for rest, k in zip(range(len(full), 0, -1), sorted(range(len(full)), key=lambda k: full[k] - least[k]), strict=True):
        extra = min(full[k] - least[k], free // rest)
        least[k] += extra
        free -= extra
    return least


class _Fitted:
    """A table; where the terminal is too narrow, several tables below each other, or rows written as lines."""

    def __init__(self, spec: TableSpec) -> None:
        self.spec = spec

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """Yield tables or lines that fit the width of the terminal."""
        spec, width = self.spec, options.max_width
        columns = range(len(spec.columns))
        if spec.leading:
            widths = [
                max(len(text) for text in (spec.columns[k].name, *(row[k].text for row in spec.rows))) + GAP for k in columns
            ]
            tables = list(self._tables(widths, width))
        else:
            tables = [_table(spec, spec.title, columns, width)]
        yield from (part for part in tables if part) if all(tables) else self._lines(console, width)

    def _tables(self, widths: list[int], width: int) -> Iterator[Table | None]:
        spec = self.spec
        head, title = list(range(spec.leading)), spec.title
        first = spec.leading
        while first < len(widths):
            last = first + 1
            while last < len(widths) and sum(widths[k] for k in (*head, *range(first, last + 1))) <= width:
                last += 1
            yield _table(spec, title, [*head, *range(first, last)], width)
            first, title = last, ""

    def _lines(self, console: Console, width: int) -> Iterator[RenderableType]:
        """Yield each row as a line with its name, and its values below."""
        spec = self.spec
        figures = next((k for k, column in enumerate(spec.columns) if column.right), 1) or 1
        heads = [product(" ".join(column.name.split())) for column in spec.columns]
        units = [k for k in range(figures + 1, len(heads)) if not heads[k] and heads[k - 1].endswith("]")]  # units of a whole row
        yield Text(spec.title, style=STYLES["strong"])
        for row in spec.rows:
            name = Text(f"{heads[0]} " if spec.columns[0].right else "")
            name += Text("  ").join(Text(*_styled(cell)) for cell in row[:figures] if cell.text)
            for cell in (row[k] for k in units if row[k].text):
                name.append(product(f" [{cell.text}]"), STYLES[cell.role])
            for number, line in enumerate(name.wrap(console, width - INDENT)):
                yield Padding(line, (0, 0, 0, INDENT)) if number else line
            values = Text()
            for k, (head, cell) in enumerate(zip(heads, row, strict=True)):
                if cell.text and k >= figures and k not in units:
                    values.append(("; " if values and head else " " if values else "") + (f"{head} " if head else ""))
                    values.append(product(", ".join(cell.text.split("\n"))), STYLES[cell.role])
            if values:
                yield Padding(values, (0, 0, 0, INDENT))
        yield from (Text(*_styled(note)) for note in spec.notes)
