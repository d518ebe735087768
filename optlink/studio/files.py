"""Files that the page saves: drawings, tables and the report of the present design."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

from optlink.errors import Fault, InputError
from optlink.studio.design import Design

MEDIA = {"dxf": "image/vnd.dxf", "svg": "image/svg+xml", "html": "text/html", "csv": "text/csv"}


def exported(design: Design, name: str, format: Any) -> dict[str, Any]:
    """Return a file of a design: its name, media type and text.

    Parameters
    ----------
    design : Design
        With the result of a task.
    name : str
        Name of the document.
    format : str
        "dxf", "svg", "html" or "csv".

    Raises
    ------
    InputError
        If the format is unknown, or the design cannot be drawn.
    """
    if format not in MEDIA:
        raise InputError(Fault("unknown format", f"One of: {', '.join(MEDIA)}", key="format", value=format))
    if design.result is None:
        raise InputError(Fault("there is no verified design yet", "Release the handle, or wait for the search", key="export"))
    from optlink.report.export.export import export
    from optlink.report.html.page import page
    from optlink.report.report_model import report_model_of

    subject = report_model_of(design.problem, design.result)
    if format == "html":
        text = page(subject)
    else:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / f"{name}.{format}"
            export(subject, path)
            text = path.read_text(encoding="utf-8")
    return {"name": f"{name}.{format}", "media": MEDIA[format], "text": text}
