"""Pictures of an analysis."""

from __future__ import annotations

from pathlib import Path

from optlink.analysis import Analysis
from optlink.report.store import write_csv, write_json


def write_all(result: Analysis, folder: Path) -> list[Path]:
    """Write result.json, cycle.csv and every picture; return the files."""
    written = [folder / "result.json", folder / "cycle.csv"]
    write_json(written[0], result.to_dict())
    write_csv(written[1], result.columns)
    return written
