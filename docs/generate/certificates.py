"""Table and picture of the page on certificates of global optima.

The table comes from the record that `benchmarks/certificates.py --json` writes, the picture from a proof of the crank-rocker.
"""

from __future__ import annotations

import io
import json
from pathlib import Path

import matplotlib as mpl

import optlink
from optlink.presentation.chart_mpl import pictures
from optlink.presentation.style import apply_style
from optlink.presentation.views.design import charts

RECORD = Path(__file__).resolve().parents[2] / "benchmarks" / "certificates_record.json"
PICTURE = "images/certificates/boxes.svg"
DYADS = "images/dyads-of-four-poses.svg"


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


def boxes() -> bytes:
    """Return the picture of the boxes of the crank-rocker as SVG."""
    found = optlink.solve(optlink.load("crank-rocker"))
    assert isinstance(found, optlink.SynthesisResult)
    return picture(found, "boxes")


def dyads() -> bytes:
    """Return the picture of the curves of four poses as SVG."""
    return picture(optlink.synthesis.exact("motion-4-poses"), "dyads")


def picture(found: optlink.SynthesisResult, name: str) -> bytes:
    """Return a picture of a result as SVG."""
    drawn = pictures(chart for chart in charts(found) if chart.file == name)[name]
    with apply_style(), mpl.rc_context({"svg.hashsalt": name}), io.BytesIO() as stream:
        drawn.savefig(stream, format="svg", metadata={"Date": None})
        return stream.getvalue()
