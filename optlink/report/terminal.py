"""Tables and texts of a result on a terminal."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal

from rich import box
from rich.console import Console, ConsoleOptions, Group, RenderableType, RenderResult
from rich.table import Table
from rich.text import Text

from optlink.report.table_spec import Paragraph, Part, Span, Summary, TableSpec

STYLES = {"": "", "good": "green", "bad": "bold red", "quiet": "dim", "strong": "bold"}
GAP = 2  # gap between columns [characters]
NARROWEST = 79  # columns that a table needs; a narrower terminal breaks its lines rather than lose digits


class _Console(Console):
    """Console that leaves a closed pipe to the command line, which sets the exit code."""

    def on_broken_pipe(self) -> None:
        """Re-raise the error."""
        raise  # noqa: PLE0704  (rich calls this while it handles the error)


def console(*, stderr: bool = False) -> Console:
    """Return a console that prints text verbatim, without markup or highlighting."""
    made = _Console(stderr=stderr, highlight=False, markup=False, emoji=False)
    made.width = max(made.width, NARROWEST)
    return made


def show(shown: Summary | Part) -> None:
    """Print a summary or a table on standard output."""
    console().print(rendered(shown))


def rendered(shown: Summary | Part) -> RenderableType:
    """Return the rich counterpart of a summary, a table or a paragraph."""
    if isinstance(shown, Summary):
        status = [_paragraph(shown.status)] if shown.status.lines else []
        parts = (piece for part in shown.parts for piece in (Text(), rendered(part)))
        return Group(Text(shown.title, style=STYLES["strong"]), *status, *parts)
    if isinstance(shown, Paragraph):
        return _paragraph(shown)
    return _Split(shown) if shown.leading else _table(shown, shown.title, range(len(shown.columns)))


def _paragraph(shown: Paragraph) -> Text:
    return Text("\n").join(Text.assemble(*map(_styled, line)) for line in shown.lines)


def _styled(span: Span) -> tuple[str, str]:
    return span.text, STYLES[span.role]


def _table(spec: TableSpec, title: str, chosen: range | list[int]) -> Table:
    """Return a table of the chosen columns."""
    made = Table(
        title=Text(title, style=STYLES["strong"]),
        title_justify="left",
        min_width=min(len(title), NARROWEST),
        box=box.SIMPLE_HEAD if spec.header else None,
        show_header=spec.header,
        header_style=STYLES["quiet"],
        pad_edge=False,
        padding=(0, GAP, 0, 0),
        caption=Text("\n").join(Text(*_styled(note)) for note in spec.notes) if spec.notes else None,
        caption_justify="left",
    )
    for k in chosen:
        column = spec.columns[k]
        fits = max(map(len, column.name.split("\n"))) <= max((len(row[k].text) for row in spec.rows), default=0)
        justify: Literal["left", "right"] = "right" if column.right else "left"
        made.add_column(column.name, justify=justify, overflow="fold", no_wrap=column.unbroken and fits)
    for number, row in enumerate(spec.rows):
        if number in spec.sections:
            made.add_section()
        made.add_row(*(Text(*_styled(row[k]), no_wrap=spec.columns[k].unbroken or None) for k in chosen))
    return made


class _Split:
    """A table side by side as far as the terminal is wide enough, and below otherwise."""

    def __init__(self, spec: TableSpec) -> None:
        self.spec = spec

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """Yield tables of as many columns as fit."""
        yield from self._tables(options.max_width)

    def _tables(self, width: int) -> Iterator[Table]:
        spec = self.spec
        widths = [
            max(len(text) for text in (column.name, *(row[k].text for row in spec.rows))) + GAP
            for k, column in enumerate(spec.columns)
        ]
        head, title = list(range(spec.leading)), spec.title
        first = spec.leading
        while first < len(widths):
            last = first + 1
            while last < len(widths) and sum(widths[k] for k in (*head, *range(first, last + 1))) <= width:
                last += 1
            yield _table(spec, title, [*head, *range(first, last)])
            first, title = last, ""
