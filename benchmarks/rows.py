"""Rows of the benchmarks as a table and as a JSON document."""

from __future__ import annotations

import contextlib
import datetime
import importlib.metadata
import json
import math
import os
import platform
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table
from timing import Row

LOAD = os.getloadavg()[0] if hasattr(os, "getloadavg") else None  # programs that ran on the machine before the measurements began
PEERS = ("pylinkage", "fourbarhinge", "pymoo", "numba", "exudyn")
PACKAGES = ("numpy", "scipy", "casadi", "cvxpy-base", "distributed", *PEERS)


def show(parts: Mapping[str, list[Row]], file: Path | None) -> None:
    """Print one table; replace these parts in the JSON document if a file is given."""
    console = Console()
    if not console.is_terminal:
        console = Console(width=160)
    console.print(table([row for rows in parts.values() for row in rows]))
    if file:
        before = json.loads(file.read_text(encoding="utf-8"))["parts"] if file.exists() else {}
        document = {"schema": "optlink/benchmarks/2", "parts": before | {name: record(rows) for name, rows in parts.items()}}
        file.write_text(json.dumps(document, indent=2) + "\n", encoding="utf-8")


def table(rows: list[Row]) -> Table:
    """The rows as text."""
    result = Table(title="optlink: medians of this run; ratio > 1: optlink is better, unless the target begins with <=")
    result.add_column("what", ratio=3)
    for heading in ("ours", "theirs", "ratio", "target"):
        result.add_column(heading, justify="right", no_wrap=True)
    result.add_column("note", ratio=4)
    colours = {None: "", True: "green", False: "bold red"}
    for row in rows:
        ratio = ("> " if row.cut else "") + row.shown(row.ratio) + (" !" if row.holds is False else "")
        cells = (row.what, row.ours, row.theirs, f"[{colours[row.holds]}]{ratio}[/]" if colours[row.holds] else ratio)
        result.add_row(*cells, row.wanted, row.note)
    return result


def version(package: str) -> str | None:
    with contextlib.suppress(importlib.metadata.PackageNotFoundError):
        return importlib.metadata.version(package)
    return None


def record(rows: list[Row]) -> dict[str, Any]:
    """The rows of one part with what they were measured on; seconds, positions per second, ratios."""
    return {
        "date": datetime.datetime.now(datetime.UTC).date().isoformat(),
        "python": platform.python_version(),
        "system": f"{platform.system()} {platform.machine()}, {os.cpu_count()} processors",
        "load": LOAD,
        "packages": {name: found for name in PACKAGES if (found := version(name))},
        "rows": [
            {
                "what": row.what,
                "kind": row.kind,
                **row.figures,
                "ratio": None if math.isnan(row.ratio) else row.ratio,
                "percent": row.percent,
                "cut": row.cut,
                "target": row.target or None,
                "holds": row.holds,
                "note": row.note,
            }
            for row in rows
        ],
    }
