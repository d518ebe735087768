"""Short text of a design, which `solve` prints: verdict, objective, proof, design and what limits it; all else is a detail."""

from collections.abc import Iterable, Sequence
from dataclasses import replace

from optlink.report.table_spec import Line, Paragraph, Part, Span, Summary, TableSpec, quiet, strong, summary, table

LINES = 25
"""Lines that the short text of a valid design has at most, 80 characters wide."""
MAX_DIMENSIONS = 8  # rows of a design; a longer one is written as text
MAX_LIMITS = 4  # rows of the active limits
SENSES = ("minimised", "maximised")  # remarks on what is optimised beside other demands
DETAILS = "--details shows the rest"


def short_text(
    title: str,
    status: Iterable[Line],
    design: Part,
    limits: Part | None,
    checks: TableSpec | None = None,
    conflict: TableSpec | None = None,
) -> Summary:
    """Return the short text of a design: verdict, objective, proof, dimensions, and active limits with failed checks.

    Conflicting limits take the place of these two.
    """
    return summary(title, status, design, conflict or first_rows(limits), _failed(None if conflict else checks))


def verdict_lines(lines: Sequence[Line]) -> list[Line]:
    """Return a verdict with the first one of the reasons that follow it."""
    if len(lines) <= 2:
        return list(lines)
    reason = [lines[1]] if isinstance(lines[1], str | Span) else list(lines[1])
    return [lines[0], [*reason, quiet(f" {len(lines) - 2} more: --details")]]


def objective_line(objective: TableSpec) -> Line:
    """Return a table of the objective as one line: name, value, unit and the remark on the first row.

    Of several demands the line begins with what is minimised or maximised. Rows without a name are the same value in other units.
    """
    first, *others = objective.rows
    sense = first[3].text if first[3].text in SENSES else ""
    pieces = [Span(f"{sense or 'objective'}: {first[0].text} "), first[1], Span(f" {first[2].text}".rstrip())]
    for _, value, unit, _ in (row for row in others if not row[0].text):
        pieces += [Span(" = "), value, Span(f" {unit.text}")]
    if first[3].text and not sense:
        pieces.append(replace(first[3], text=f" ({first[3].text})"))
    for name, value, unit, _ in (row for row in others if row[0].text):
        pieces += [Span(f"; {name.text} "), value, Span(f" {unit.text}".rstrip())]
    return pieces


def dimensions(design: TableSpec) -> Part:
    """Return a design as a table without a heading, or as text where it has many dimensions."""
    if len(design.rows) <= MAX_DIMENSIONS:
        return table(design.title, "<><", [row[:3] for row in design.rows]) if design.header else design
    pieces: list[Span] = []
    for name, value, unit, *_ in design.rows:
        pieces += [Span(f"{', ' if pieces else ''}{name.text} "), value, Span(f" {unit.text}".rstrip())]
    return Paragraph(strong(design.title), pieces)


def first_rows(limits: Part | None) -> Part | None:
    """Return the table of active limits with its first rows."""
    if limits is None or isinstance(limits, Paragraph) or len(limits.rows) <= MAX_LIMITS:
        return limits
    left = len(limits.rows) - MAX_LIMITS + 1
    return replace(limits, rows=limits.rows[: MAX_LIMITS - 1], notes=(quiet(f"and {left} more: --details"),), sections=())


def _failed(checks: TableSpec | None) -> Part:
    """Return how many checks are passed, and the failed ones."""
    if checks is None:
        return Paragraph(quiet(DETAILS))
    failed = tuple(row for row in checks.rows if row[0].role == "bad")
    if failed:
        return replace(checks, rows=failed, notes=(quiet(DETAILS),))
    return Paragraph([f"{checks.title}; ", quiet(DETAILS)])
