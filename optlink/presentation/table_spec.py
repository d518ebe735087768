"""Tables and texts of a result, described independently of terminal and HTML page."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Literal, Self

Role = Literal["", "good", "bad", "quiet", "strong"]


@dataclass(frozen=True)
class Span:
    """A piece of text in one role."""

    text: str
    role: Role = ""


Inline = str | Span
Row = Sequence[Inline]
Line = Inline | Row


good = partial(Span, role="good")  # a text that reports a success
bad = partial(Span, role="bad")  # a text that reports a failure
quiet = partial(Span, role="quiet")  # a remark
strong = partial(Span, role="strong")  # an emphasised text


def verdict(word: str, positive: bool) -> Inline:
    """Return a verdict as good or bad."""
    return good(word) if positive else bad(word)


def noted(notes: Iterable[str]) -> Iterator[str]:
    """Yield notes as lines."""
    return (f"Note: {note}" for note in notes)


@dataclass(frozen=True, init=False)
class Paragraph:
    """Lines of text, each a sequence of spans; `lead` marks the introduction of what follows.

    With `appendix`, a page shows it in its appendix.
    """

    lines: tuple[tuple[Span, ...], ...]
    lead: bool
    appendix: bool

    def __init__(self, *lines: Line, lead: bool = False, appendix: bool = False) -> None:
        object.__setattr__(self, "lines", tuple(_spans(line) for line in lines))
        object.__setattr__(self, "lead", lead)
        object.__setattr__(self, "appendix", appendix)


@dataclass(frozen=True)
class Column:
    """A column: its name, whether its cells are right-aligned, and whether they must stay on one line."""

    name: str = ""
    right: bool = False
    unbroken: bool = False


@dataclass(frozen=True)
class TableSpec:
    """A table of cells (`rows`) under `columns`, whose names are shown unless all are empty, with lines below it (`notes`).

    `sections` are rows that begin a further section. `leading` columns are repeated where a table too wide for a terminal is
    split; 0: its cells are wrapped instead. A page shows it in its appendix if `appendix` (checks and details of the solver), and
    with all digits if `exact` (of bounds, which must not be rounded up).
    """

    title: str
    columns: tuple[Column, ...]
    rows: tuple[tuple[Span, ...], ...]
    notes: tuple[Span, ...] = ()
    sections: tuple[int, ...] = ()
    leading: int = 0
    appendix: bool = False
    exact: bool = False

    @property
    def verdict(self) -> Paragraph:
        """Text that a command prints with --quiet."""
        return Paragraph(self.title)

    @property
    def header(self) -> bool:
        """Whether the columns have names."""
        return any(column.name for column in self.columns)


Part = TableSpec | Paragraph


@dataclass(frozen=True)
class Summary:
    """Summary of a result: title, status below it, tables and paragraphs; `short` is its short text, if it has one."""

    title: str
    status: Paragraph
    parts: tuple[Part, ...] = ()
    short: Self | None = None

    @property
    def verdict(self) -> Paragraph:
        """First line of the status, which a command prints with --quiet."""
        return Paragraph(self.status.lines[0] if self.status.lines else self.title)


def summary(title: str, status: Iterable[Line], *parts: Part | None) -> Summary:
    """Return a summary without the parts that are None."""
    return Summary(title, Paragraph(*status), tuple(part for part in parts if part is not None))


def table(
    title: str,
    columns: Iterable[str | Column],
    rows: Iterable[Row],
    *,
    notes: Iterable[Inline] = (),
    sections: Sequence[int] = (),
    leading: int = 0,
    unbroken: bool = False,
    appendix: bool = False,
    exact: bool = False,
) -> TableSpec:
    """Return a table with the attributes of `TableSpec`; with `unbroken`, no right-aligned cell is broken into lines.

    The name of a right-aligned column begins with ">", that of a left-aligned one may begin with "<". A string such as "<><"
    describes columns without names.
    """
    header_cells = tuple(
        column if isinstance(column, Column) else Column(column.lstrip("<>"), column[:1] == ">", unbroken and column[:1] == ">")
        for column in columns
    )
    return TableSpec(
        title, header_cells, tuple(_spans(row) for row in rows), _spans(tuple(notes)), tuple(sections), leading, appendix, exact
    )


def _spans(line: Line) -> tuple[Span, ...]:
    pieces = [line] if isinstance(line, str | Span) else line
    return tuple(piece if isinstance(piece, Span) else Span(piece) for piece in pieces)
