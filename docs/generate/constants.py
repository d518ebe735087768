"""Tables of the constants that steer the searches, made from the record that `benchmarks/constants.py --summary` writes."""

from __future__ import annotations

import itertools
import json
import re
from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

RECORD = Path(__file__).resolve().parents[2] / "benchmarks" / "constants_record.json"
CHOSEN = "chosen"
KINDS = {
    "rounding": "separates rounding errors of double precision from what counts",
    "proof": "bounds an error in a proof; only a larger value is safe",
    "accuracy": "follows from the accuracy that a result promises, or from another tolerance",
    "definition": "geometry, a standard, an index, a sign",
    "input": "the most, or the least, that a user may ask for",
    "output": "what a result says or draws; the design does not depend on it",
    "memory": "size of a block; the result does not depend on it",
    CHOSEN: "by judgement: neither measured nor derived",
}
LISTED = 12  # largest effects that are listed

Row = Mapping[str, Any]


def page() -> str:
    """Return the counts, the largest effects, a table for each search, and one of the constants that steer none."""
    record = json.loads(RECORD.read_text(encoding="utf-8"))
    rows = record["rows"]
    lines = [*_counts(rows), *_largest(rows), "## Every search", ""]
    others: list[Row] = []
    for module, group in itertools.groupby(rows, key=lambda row: _split(row)[0]):
        own = list(group)
        if all("reason" in row and "half" not in row for row in own):
            others += own
        else:
            lines += [f"### {module}", "", record["modules"][module], "", *_table(own, full=False)]
    lines += ["## Constants of modules without a search", "", *_table(others, full=True)]
    return "\n".join(lines).rstrip("\n") + "\n"


def _counts(rows: list[Row]) -> Iterator[str]:
    measured = [row for row in rows if "half" in row]
    without = sum(not any(effect for _, _, effect in _effects(row)) for row in measured)
    decided = sum(any(_decides(effect) for _, _, effect in _effects(row)) for row in measured)
    kinds = Counter(row["reason"].partition(":")[0] for row in rows if "reason" in row and "half" not in row)
    yield from (f"The source has {len(rows)} numeric constants:", "", "| constants | number | |", "|---|---|---|")
    yield f"| measured: they change the design or the verdict | {decided} | halved or doubled, in a search that reads them |"
    yield f"| measured: they change the work | {len(measured) - decided - without} | evaluations, starts, or twice the time |"
    yield f"| measured: nothing changes | {without} | in the searches that were tried |"
    for kind, meaning in KINDS.items():
        yield f"| {'' if kind == CHOSEN else 'derived: '}{kind} | {kinds[kind]} | {meaning} |"
    yield ""


def _largest(rows: list[Row]) -> Iterator[str]:
    """The effects on the design, then the largest ones on the work."""
    found = [(row, *one) for row in rows for one in _effects(row) if one[2]]
    design = [one for one in found if _decides(one[3])]
    work = sorted((one for one in found if one not in design), key=lambda one: -_work(one[3]))[:LISTED]
    yield from ("## The largest effects", "", "| constant | value | search | effect |", "|---|---|---|---|")
    for row, factor, case, effect in [*design, *work]:
        yield f"| `{row['constant']}` = {row['value']} | {factor} | {case} | {_cell(effect)} |"
    yield ""


def _table(rows: list[Row], *, full: bool) -> Iterator[str]:
    yield from ("| constant | meaning | halved, doubled, or reason |", "|---|---|---|")
    for row in rows:
        name = f"`{row['constant'] if full else _split(row)[1]} = {row['value']}`"
        yield f"| {' | '.join(map(_cell, (name, row['what'], _why(row))))} |"
    yield ""


def _why(row: Row) -> str:
    found = [row["reason"]] if "reason" in row else []
    found += [_measured(row)] if "half" in row else []
    return "; ".join(found)


def _measured(row: Row) -> str:
    if not any(effect for _, _, effect in _effects(row)):
        return f"nothing changes in {', '.join(row['half'])}"
    return "; ".join(f"{name}: {_told(row[factor])}" for name, factor in (("halved", "half"), ("doubled", "double")))


def _told(found: Mapping[str, str]) -> str:
    """Return what was changed in which search."""
    return ", ".join(f"{effect} ({case})" for case, effect in found.items() if effect) or "nothing"


def _effects(row: Row) -> list[tuple[str, str, str]]:
    return [(factor, case, effect) for factor in ("half", "double") for case, effect in row.get(factor, {}).items()]


def _decides(effect: str) -> bool:
    """Whether an effect is one on the design or the verdict, not on the work alone."""
    return bool(re.search(r"worse|better|valid|designs|->|Error|stopped", effect))


def _work(effect: str) -> float:
    """Ratio of the work, or its reciprocal, whichever is larger."""
    percents = re.findall(r"(?:evaluations|boxes) ([-+\d.e]+) %", effect)
    times = re.findall(r"x ([\d.e+-]+)", effect)
    starts = re.search(r"(\d+) starts instead of (\d+)", effect)
    ratios = [1.0 + float(percent) / 100.0 for percent in percents]
    ratios += map(float, times)
    ratios += [int(starts[1]) / int(starts[2])] if starts and int(starts[2]) else []
    return max((max(one, 1.0 / one) for one in ratios if one > 0.0), default=1.0)


def _split(row: Row) -> tuple[str, str]:
    module, _, name = row["constant"].rpartition(".")
    return module, name


def _cell(text: str) -> str:
    return text.replace("|", "/")
