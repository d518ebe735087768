"""Final sections of every page: the complete problem and the sources."""

from __future__ import annotations

import datetime
import platform
from collections.abc import Iterable
from importlib.metadata import version

import numpy as np

from optlink.problem.file import ProblemFile
from optlink.report.html.shell import PageSection
from optlink.report.table_spec import Paragraph
from optlink.report.views import function_tables
from optlink.version import VERSION


def closing(file: ProblemFile, by: str) -> Iterable[PageSection]:
    """Yield the last sections of the appendix: the problem, and sources, versions and method.

    Parameters
    ----------
    file : ProblemFile
    by : str
        Method by which the result was found.
    """
    about = (" ".join(piece.replace("`", "").split()) for piece in file.model.about.split("\n\n") if piece.strip())
    yield PageSection("Problem", (Paragraph(*about), function_tables.problem(file).parts))
    yield PageSection("Sources", (dict(_sources(file, by)),))


def letterhead(file: ProblemFile) -> dict[str, str]:
    """Return the facts at the head of a page by name, without the empty ones; the date is that of today unless it is stated."""
    facts = file.model.report.model_dump()
    facts["date"] = facts["date"] or datetime.datetime.now(tz=datetime.UTC).date().isoformat()
    return {name: " ".join(text.split()) for name, text in facts.items() if text.strip()}


def _sources(file: ProblemFile, by: str) -> list[tuple[str, str]]:
    found = [("Problem", file.model.source or "no source is given")]
    if file.model.expected is not None:
        found.append(("Expected values", file.model.expected.source))
    return [
        *found,
        ("Problem file", file.file),
        ("Hash of the problem", file.hash),
        ("Found by", by),
        ("optlink", f"{VERSION}, with Python {platform.python_version()}, numpy {np.__version__}"),
        ("Charts", f"plotly.js of plotly {version('plotly')}, in this page"),
    ]
