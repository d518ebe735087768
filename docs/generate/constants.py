"""Tables of the constants that steer the searches, made from the record that `benchmarks/constants.py --summary` writes."""

from __future__ import annotations

import itertools
import json
from collections.abc import Mapping
from pathlib import Path

RECORD = Path(__file__).resolve().parents[2] / "benchmarks" / "constants_record.json"


def page() -> str:
    """Return a table for each module."""
    record = json.loads(RECORD.read_text(encoding="utf-8"))
    rows = record["rows"]
    without = sum(not any((*row["half"].values(), *row["double"].values())) for row in rows)
    measured = f"Of {record['listed']} numeric constants of the source {len(rows)} were halved and doubled so far"
    lines = [f"{measured}; {without} of them change nothing in the searches that were tried.", ""]
    for module, own in itertools.groupby(rows, key=lambda row: row["constant"].rpartition(".")[0]):
        lines += [f"## {module}", "", "| constant | meaning | half | double |", "|---|---|---|---|"]
        for row in own:
            name = f"`{row['constant'].rpartition('.')[2]} = {row['value']}`"
            lines.append(f"| {' | '.join(map(_cell, (name, row['what'], _effect(row['half']), _effect(row['double']))))} |")
        lines.append("")
    return "\n".join(lines)


def _effect(found: Mapping[str, str]) -> str:
    """Return what was changed in which search; without any change, in which searches nothing was."""
    told = [f"{case}: {effect}" for case, effect in found.items() if effect]
    return "; ".join(told) or f"nothing ({', '.join(found)})"


def _cell(text: str) -> str:
    return text.replace("|", "/")
