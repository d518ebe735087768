"""Exports of the studio: drawings, tables and the report of the present design, and links that contain the problem."""

import base64
import binascii
import tempfile
import zlib
from pathlib import Path
from typing import Any

from optlink.errors import InputError
from optlink.problem.file import MAX_BYTES
from optlink.studio.design import Design

MEDIA = {"dxf": "image/vnd.dxf", "svg": "image/svg+xml", "html": "text/html", "csv": "text/csv"}


def exported(design: Design, name: str, format: str) -> dict[str, Any]:
    """Return a file of a design: its name, media type and text.

    Raises
    ------
    InputError
        If the format is unknown, or the design cannot be drawn.
    """
    if format not in MEDIA:
        raise InputError("unknown format", f"One of: {', '.join(MEDIA)}", key="format", value=format)
    if design.result is None:
        raise InputError("there is no verified design yet", "Release the handle, or wait for the search", key="export")
    from optlink.report.export.export import export
    from optlink.report.html.page import page
    from optlink.report.report_model import report_model_of

    model = report_model_of(design.result)
    if format == "html":
        text = page(model)
    else:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / f"{name}.{format}"
            export(model, path)
            text = path.read_text(encoding="utf-8")
    return {"name": f"{name}.{format}", "media": MEDIA[format], "text": text}


def deflated(text: str) -> str:
    """Return a text, compressed, in the letters of a link."""
    return base64.urlsafe_b64encode(zlib.compress(text.encode(), 9)).decode().rstrip("=")


def inflated(fragment: str) -> str:
    """Return the text of a link.

    Raises
    ------
    InputError
        If it is not a compressed text, or too long.
    """
    try:
        data = base64.urlsafe_b64decode(fragment + "=" * (-len(fragment) % 4))
        unpacker = zlib.decompressobj()
        text = unpacker.decompress(data, MAX_BYTES + 1)
        if len(text) > MAX_BYTES:
            raise InputError(f"the problem of the link is longer than {MAX_BYTES:,} bytes", "Open its file instead")
        if not unpacker.eof:
            raise ValueError
        return text.decode()
    except (ValueError, binascii.Error, zlib.error):
        raise InputError("the link contains no problem", "Copy the whole link") from None
