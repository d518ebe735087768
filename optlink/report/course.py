"""Files of a simulation."""

from __future__ import annotations

from pathlib import Path

from optlink.report.store import write_csv, write_json
from optlink.simulation import Simulation


def write_all(result: Simulation, folder: Path) -> list[Path]:
    """Write result.json, course.csv and every picture; return the files."""
    written = [folder / "result.json", folder / "course.csv"]
    write_json(written[0], result.to_dict())
    write_csv(written[1], result.columns)
    return written
