"""Table and picture of the page on certificates of global optima.

The table comes from the record that `benchmarks/certificates.py --json` writes, the picture from a proof of the crank-rocker.
MkDocs calls `on_files` and `on_page_markdown`; as a script, the module writes the picture into the folder that it is given.
"""

from __future__ import annotations

import functools
import io
import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import optlink
from optlink.report.chart_mpl import pictures
from optlink.report.style import apply_style
from optlink.report.views.design import charts

if TYPE_CHECKING:
    from mkdocs.config.defaults import MkDocsConfig
    from mkdocs.structure.files import Files

RECORD = Path(__file__).resolve().parents[2] / "benchmarks" / "certificates_record.json"
MARKER = "<!-- certificates -->"
PICTURE = "images/certificates/boxes.png"


def page() -> str:
    """Return the table of boxes and seconds, with what they were measured on."""
    record = json.loads(RECORD.read_text(encoding="utf-8"))
    lines = [
        f"Measured on {record['date']} with Python {record['python']} on one of the processors of {record['system']}; other "
        "programs ran at the same time.",
        "",
        "| problem | unknowns | gap | boxes | seconds | finding |",
        "|---|---|---|---|---|---|",
    ]
    for row in record["rows"]:
        cells = (row["what"], row["unknowns"], f"{row['gap']:g}", f"{row['boxes']:,}", f"{row['seconds']:.2f}", row["text"])
        lines.append(f"| {' | '.join(map(str, cells))} |")
    return "\n".join(lines)


@functools.cache
def picture() -> bytes:
    """Return the picture of the boxes of the crank-rocker as PNG."""
    found = optlink.solve(optlink.load("crank-rocker"))
    assert isinstance(found, optlink.SynthesisResult)
    drawn = pictures(chart for chart in charts(found) if chart.file == "boxes")["boxes"]
    with apply_style(), io.BytesIO() as stream:
        drawn.savefig(stream, dpi=130)
        return stream.getvalue()


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """MkDocs: add the picture."""
    from mkdocs.structure.files import File

    files.append(File.generated(config, PICTURE, content=picture()))
    return files


def on_page_markdown(markdown: str, **_: Any) -> str:
    """MkDocs: replace the marker of a page by the table."""
    return markdown.replace(MARKER, page()) if MARKER in markdown else markdown


if __name__ == "__main__":
    Path(sys.argv[1], "boxes.png").write_bytes(picture())
    sys.stdout.write(page() + "\n")
