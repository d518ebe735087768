"""Read and write values at keys of a problem file."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from optlink.problem.file import ProblemFile
from optlink.units import is_unit, split

Raw = str | float | int


def exact_text(value: float, unit: str) -> Raw:
    """Return a value with all its digits as written in a problem file.

    Parameters
    ----------
    value : float [unit]
    unit : str
        Empty for a plain number.
    """
    if unit:
        return f"{float(value)!r} {unit}"
    return int(value) if float(value).is_integer() and abs(value) < 1e15 else value


def value_at(problem: ProblemFile, key: str) -> Any:
    """Return the value of the file at a key, or None.

    Parameters
    ----------
    problem : ProblemFile
    key : str
        Names separated by dots.
    """
    found: Any = problem.raw
    for step in key.split("."):
        if not isinstance(found, Mapping) or step not in found:
            return None
        found = found[step]
    return found


def read_figure(raw: Any) -> tuple[float, str]:
    """Return a value and its unit; 0 and no unit for anything else."""
    if isinstance(raw, int | float) and not isinstance(raw, bool):
        return float(raw), ""
    known = split(raw) if isinstance(raw, str) else None
    return known if known is not None and is_unit(known[1]) else (0.0, "")
