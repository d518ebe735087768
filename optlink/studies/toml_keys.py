"""Read and write values at keys of a problem file; the numbers of a file that can be changed by hand, with their ranges."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from optlink.problem.file import ProblemFile
from optlink.problem.quantity_keys import file_key
from optlink.units import is_unit, split

Raw = str | float | int

ANGLE = 45.0  # deg, half of the range of an angle that is not a design variable


def exact_text(value: float, unit: str) -> Raw:
    """Return a value with all its digits as written in a problem file."""
    if unit:
        return f"{float(value)!r} {unit}"
    return int(value) if float(value).is_integer() and abs(value) < 1e15 else value


def read_figure(raw: Any) -> tuple[float, str]:
    """Return a value and its unit; 0 and no unit for anything else."""
    if isinstance(raw, int | float) and not isinstance(raw, bool):
        return float(raw), ""
    parts = split(raw) if isinstance(raw, str) else None
    return parts if parts is not None and is_unit(parts[1]) else (0.0, "")


@dataclass(frozen=True)
class Knob:
    """A number at a key of the problem file: its name, and its value and range in a unit."""

    name: str
    value: float
    low: float
    high: float
    unit: str
    key: str


def knobs(problem: ProblemFile) -> tuple[Knob, ...]:
    """Return the adjustable numbers of a problem file that are not design variables: fixed dimensions and limits."""
    return (*_dimensions(problem), *_limits(problem))


def _dimensions(problem: ProblemFile) -> Iterator[Knob]:
    """Yield the fixed dimensions, from half to one and a half times their values."""
    largest = max((abs(q.value) for q in problem.model.mechanism.quantities.values() if q.kind != "angle"), default=1.0)
    for name, quantity in problem.model.mechanism.quantities.items():
        if not quantity.fixed:
            continue
        value, unit = quantity.value / quantity.si_per_unit, quantity.display[1]
        room = (
            ANGLE if quantity.kind == "angle" else 0.5 * (value if quantity.kind == "length" else largest / quantity.si_per_unit)
        )
        yield Knob(name, value, value - room, value + room, unit, file_key(problem.raw["mechanism"], name))


def _limits(problem: ProblemFile) -> Iterator[Knob]:
    """Yield the numbers of the limits of the file, from half to one and a half times their values."""
    for name, raw in (problem.raw.get("limits") or {}).items():
        pair = zip(("min", "max"), raw, strict=True) if isinstance(raw, list) else [("", raw)]
        for side, text in raw.items() if isinstance(raw, dict) else pair:
            value, unit = read_figure(text)
            if side not in ("", "min", "max", "exactly") or not (value or unit == "deg"):
                continue
            words = f"{name} {side}".rstrip().replace("_", " ")
            low, high = sorted((0.5 * value, 1.5 * value))
            if unit == "deg":
                low, high = max(0.0, value - ANGLE), min(180.0, value + ANGLE)
            yield Knob(words, value, low, high, unit, f"limits.{name}.{side}".rstrip("."))
