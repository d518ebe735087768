"""Table of measured ratios, made from the record that `benchmarks/run.py --json` writes. MkDocs calls `on_page_markdown`."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

RECORD = Path(__file__).resolve().parents[2] / "benchmarks" / "measurements.json"
MARKER = "<!-- measurements -->"


def page() -> str:
    """Return the table of the ratios and the versions with which they were measured."""
    record = json.loads(RECORD.read_text(encoding="utf-8"))
    packages = ", ".join(f"{name} {version}" for name, version in record["packages"].items() if version)
    lines = [
        f"Measured on {record['date']} with Python {record['python']}, {packages}; {record['system']}.",
        "",
        "| what | ratio | target | note |",
        "|---|---|---|---|",
    ]
    for row in record["rows"]:
        if row["ratio"] is not None:
            cells = (row["what"], f"{row['ratio']:.3g}", row["target"] or "", row["note"])
            lines.append(f"| {' | '.join(cell.replace('|', '/') for cell in cells)} |")
    return "\n".join(lines)


def on_page_markdown(markdown: str, **_: Any) -> str:
    """MkDocs: replace the marker of a page by the table."""
    return markdown.replace(MARKER, page()) if MARKER in markdown else markdown


if __name__ == "__main__":
    sys.stdout.write(page() + "\n")
