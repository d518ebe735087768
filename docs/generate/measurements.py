"""Tables of measured ratios, made from the record that `benchmarks/run.py --json` writes."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

RECORD = Path(__file__).resolve().parents[2] / "benchmarks" / "measurements.json"
QUIET = 0.5  # load of a machine on which nothing else runs
HEADINGS = {
    "speed": ("Speed", "how many times as fast optlink is: the time of the other over that of optlink, or a rate over a rate"),
    "error": ("Errors", "the error of the other over that of optlink"),
    "result": ("Good results", "the share of good results of optlink over that of the other"),
    "cost": ("Cost", "the time of optlink over that of something it cannot do without; less is better"),
    "growth": ("Growth", "1 means that a large task takes no more time or memory for each of its parts than a small one"),
}
"""Heading and meaning of the ratio of each kind of row, in the order of the page."""
WORDS = {True: "met", False: "**missed**", None: "open"}


def page() -> str:
    """Return the tables, with the machine, its load and the versions with which each part was measured."""
    parts = json.loads(RECORD.read_text(encoding="utf-8"))["parts"]
    rows = [row for part in parts.values() for row in part["rows"]]
    judged = [row["holds"] for row in rows if row["target"]]
    counts = ", ".join(f"{judged.count(value)} {words.strip('*')}" for value, words in WORDS.items())
    lines = [*_origins(parts), f"Of {len(judged)} targets: {counts}.", ""]
    for kind, (heading, meaning) in HEADINGS.items():
        shown = [row for row in rows if row["kind"] == kind and (row["ratio"] is not None or row["target"])]
        if shown:
            lines += [
                f"## {heading}",
                "",
                f"The ratio is {meaning}.",
                "",
                "| what | ratio | target | result | note |",
                "|---|---|---|---|---|",
            ]
            lines += [_line((row["what"], _ratio(row), _target(row), _verdict(row), row["note"])) for row in shown]
            lines.append("")
    alone = [row for row in rows if row["ratio"] is None and not row["target"]]
    lines += ["## Times of optlink alone", "", "| what | median | note |", "|---|---|---|"]
    lines += [_line((row["what"], f"{row['ours']:.3g} s" if "ours" in row else "", row["note"])) for row in alone]
    return "\n".join(lines)


def _origins(parts: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """Return a line for each set of parts that were measured under the same conditions."""
    origins: dict[str, list[str]] = {}
    for name, part in parts.items():
        packages = ", ".join(f"{package} {version}" for package, version in part["packages"].items() if version)
        load = part["load"]
        busy = "the load of the machine was not recorded"
        if load is not None:
            busy = "nothing else ran" if load < QUIET else f"**other programs ran** (load {load:.1f} at the start)"
        text = f"on {part['date']} with Python {part['python']}, {packages}; {part['system']}; {busy}"
        origins.setdefault(text, []).append(name)
    return [line for text, names in origins.items() for line in (f"Measured {text}: {', '.join(names)}.", "")]


def _ratio(row: Mapping[str, Any]) -> str:
    if row["ratio"] is None:
        return "none"
    text = f"{100.0 * row['ratio']:.0f} %" if row["percent"] else f"{row['ratio']:.3g}"
    return f"> {text}" if row["cut"] else text


def _target(row: Mapping[str, Any]) -> str:
    relation, _, bound = (row["target"] or "").partition(" ")
    return f"{relation} {100.0 * float(bound):.0f} %" if bound and row["percent"] else row["target"] or ""


def _verdict(row: Mapping[str, Any]) -> str:
    return WORDS[row["holds"]] if row["target"] else ""


def _line(cells: tuple[str, ...]) -> str:
    return f"| {' | '.join(cell.replace('|', '/') for cell in cells)} |"
