"""Notebooks as they are stored: run from top to bottom without sliders, their pictures with few colours."""

from __future__ import annotations

import base64
import io
from pathlib import Path
from typing import Any

FOLDER = Path(__file__).resolve().parents[2] / "notebooks"
COLOURS = 32  # of a picture
NO_SLIDERS = 'import sys\nsys.modules["ipywidgets"] = None'  # as if it were not installed: then there is a picture in their place
WIDGET = "application/vnd.jupyter.widget-view+json"


def books() -> list[Path]:
    """Return the notebooks."""
    return sorted(FOLDER.glob("*.ipynb"))


def write(path: Path) -> None:
    """Run a notebook in a new kernel and store it."""
    import nbformat
    from nbclient import NotebookClient

    book = nbformat.read(path, as_version=4)
    first = nbformat.v4.new_code_cell(NO_SLIDERS if any("= live(" in cell.source for cell in book.cells) else "")
    book.cells.insert(0, first)
    settings = {"metadata": {"path": str(FOLDER)}}
    NotebookClient(book, timeout=600, kernel_name="python3", resources=settings, record_timing=False).execute()
    book.cells.remove(first)
    code = [cell for cell in book.cells if cell.cell_type == "code" and cell.source.strip()]
    for count, cell in enumerate(code, start=1):
        cell.execution_count = count
        for output in cell.outputs:
            output.get("data", {}).pop(WIDGET, None)  # does not outlive its kernel
            if "execution_count" in output:
                output.execution_count = count
    book.metadata.pop("widgets", None)
    reduce(book)
    nbformat.write(book, path)


def reduce(book: Any) -> None:
    """Store the pictures of a notebook with few colours, a third of their size."""
    for cell in book["cells"]:
        for output in cell.get("outputs", ()):
            data = output.get("data", {})
            if "image/png" in data:
                text = data["image/png"]
                png = base64.b64decode(text if isinstance(text, str) else "".join(text))
                data["image/png"] = base64.b64encode(few_colours(png)).decode() + "\n"


def few_colours(png: bytes) -> bytes:
    """Return a picture with a palette; one that has a palette as it is."""
    from PIL import Image

    with Image.open(io.BytesIO(png)) as picture, io.BytesIO() as stream:
        if picture.mode == "P":
            return png
        few = picture.convert("RGB").quantize(COLOURS, method=Image.Quantize.MAXCOVERAGE, kmeans=2, dither=Image.Dither.NONE)
        few.save(stream, format="png", optimize=True)
        return stream.getvalue()
