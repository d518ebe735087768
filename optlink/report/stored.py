"""Stored results: a result.json of any command, or its folder, read as the result that the command returned."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from optlink.errors import InputError
from optlink.io import load_extensions
from optlink.problem.arguments import typed
from optlink.problem.document import Document, read_document
from optlink.report.format import single_units
from optlink.report.registry import KINDS, result_class, view_of

if TYPE_CHECKING:
    from collections.abc import Mapping

    from optlink.report.report_model import ReportModel
    from optlink.report.view import StoredStudy

RESULT = "result.json"
FORMER = ("function", "path", "cycle")
"""Kinds of results of earlier versions, which are now those of a design."""


@typed
def read_result(path: str | Path) -> Document:
    """Read a stored result: the one that the command or the function returned which made it.

    The file alone suffices: it contains its problem.

    Parameters
    ----------
    path : str or Path
        A result.json, or the folder that `--out` wrote.

    Returns
    -------
    Document
        `SynthesisResult`, `Analysis`, `Simulation`, ..., by the kind of result.

    Raises
    ------
    InputError
        If the file is no result of this version of optlink, or was changed since it was written.

    Examples
    --------
    >>> import json, tempfile
    >>> result = optlink.validate(optlink.load("crank-rocker"), {"coupler": 0.412, "rocker": 0.232})
    >>> with tempfile.NamedTemporaryFile("w", suffix=".json") as file:
    ...     _ = file.write(json.dumps(result.to_dict()))
    ...     file.flush()
    ...     optlink.read_result(file.name).valid == result.valid
    True
    """
    text = str(path)
    folder = os.path.isdir(text)
    place = Path(text) / RESULT if folder else Path(text)
    if folder and not place.exists():
        remedy = "Give the folder of a finished command; continue an interrupted study first"
        raise InputError(f"the folder contains no {RESULT}", remedy, text)
    if not place.is_file():
        message = "this is not a regular file" if place.exists() else "no such file"
        raise InputError(message, "Give a stored result.json, the folder it is in, or a problem", key="path", value=text)
    document = read_document(place)
    load_extensions()
    schema = document.get("schema")
    kind = str(schema).removeprefix("optlink/").rpartition("/")[0].replace("-", " ")
    known = result_class(kind)
    if known is None or known.schema() != schema:
        raise _unknown(schema, kind, place)
    return known.from_dict(document, place)


def _unknown(schema: object, kind: str, path: Path) -> InputError:
    """Return the error for a document of another schema."""
    if (command := KINDS.get(kind, "solve" if kind in FORMER else "")) != "":
        remedy = f"Run `{command}` again, or use the version of optlink that wrote it"
        return InputError("the result has the format of another version", remedy, str(path), "schema", schema)
    commands = ", ".join(dict.fromkeys(KINDS.values()))
    remedy = f"Give what --out of one of these wrote: {commands}; or the problem itself"
    return InputError("not a result of optlink", remedy, str(path), "schema", schema)


def stored_page(result: Document, facts: Mapping[str, Any], path: str) -> ReportModel | StoredStudy:
    """Return the content of the page of a stored result, with further facts at its head.

    Raises
    ------
    InputError
        If results of this kind have no page.
    """
    from optlink.report.report_model import report_model_of

    if facts:
        result = replace(result, problem=result.problem.override(facts))  # type: ignore[type-var]
    view = view_of(result.kind)
    if view.no_page:
        raise InputError("a result of this kind has no page", view.no_page, path, "schema", result.schema())
    if view.page is None:
        return report_model_of(result)  # type: ignore[arg-type]
    with single_units():
        return view.page(result)
