"""Final sections of every page: the complete problem and the sources."""

from __future__ import annotations

import datetime
import platform
from collections.abc import Iterable
from html import escape
from importlib.metadata import version

import numpy as np
from rich.table import Table

from optlink.problem.file import ProblemFile
from optlink.report.html import tables
from optlink.report.html.shell import Section, cards, facts
from optlink.report.views import function_tables
from optlink.version import VERSION


def closing(file: ProblemFile, by: str) -> Iterable[Section]:
    """Yield the section of the problem and the section of sources, versions and method.

    Parameters
    ----------
    file : ProblemFile
    by : str
        Method by which the result was found.
    """
    parts = [part for part in tables.flat(function_tables.problem(file)) if isinstance(part, Table)]
    about = "".join(f"<p>{escape(piece)}</p>" for piece in _paragraphs(file.model.about))
    yield Section("Problem", (f"{about}{cards(parts)}",))
    yield Section("Sources", (facts(_sources(file, by)),))


def _paragraphs(text: str) -> list[str]:
    return [" ".join(piece.split()) for piece in text.split("\n\n") if piece.strip()]


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
        ("Written on", datetime.datetime.now(tz=datetime.UTC).date().isoformat()),
    ]
