"""Columns of tables in the units of a problem file."""

import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from typing import NamedTuple

import numpy as np

from optlink.presentation.format import column_unit
from optlink.problem.file import ProblemFile
from optlink.units import KINDS, in_si, kind_of_unit, plain, split

MEASURE = re.compile(r"\.(min|max|rms)$")
"""End of the columns of a sweep that are a figure of a column of an analysis."""


class UnitColumn(NamedTuple):
    """A column of a table: its key, which ends with its unit, its name without that, its unit, its values."""

    key: str
    name: str
    unit: str
    values: list[float | str]


def file_units(problem: ProblemFile) -> dict[str, str]:
    """Return the units of a problem file, those that stand there most often, by the SI unit of what they measure."""
    counts: dict[str, Counter[str]] = {}
    for text in leaves(problem.raw):
        _, unit = split(text) or (0.0, "")
        if kind := unit and kind_of_unit(unit):
            counts.setdefault(KINDS[kind].si, Counter())[unit] += 1
    units = {si: counted.most_common(1)[0][0] for si, counted in counts.items()}
    length, angle = units.get("m", "m"), units.get("rad", "rad")
    motion = {f"{si}{more}": f"{unit}{more}" for si, unit in (("m", length), ("rad", angle)) for more in ("/s", "/s^2")}
    motion["m^2"] = f"{length}^2"  # squares of angles remain rad^2, as everywhere
    return {si.replace("**", "^"): unit for si, unit in {**motion, **units}.items()}


def leaves(value: object) -> Iterator[str]:
    """Yield the texts in tables and lists."""
    if isinstance(value, str):
        yield value
    elif isinstance(value, Mapping | list | tuple):
        for item in value.values() if isinstance(value, Mapping) else value:
            yield from leaves(item)


def in_units(key: str, values: Iterable[float | str], units: Mapping[str, str]) -> UnitColumn:
    """Return a column of a table in other units, which are given by those of SI; a figure of a column ends its key."""
    measure = found[0] if (found := MEASURE.search(key)) else ""
    name, unit = column_unit(key.removesuffix(measure))
    listed = np.asarray(values).tolist() if isinstance(values, np.ndarray) else [*values]
    size, si = in_si(plain(unit)) if unit else (1.0, "")
    if si not in units:
        return UnitColumn(key, name + measure, unit, listed)
    wanted = units[si]
    ending = wanted.replace("*", "").replace("^", "").replace("/", "_")
    shown = wanted.replace("*", " ").replace("^2", "²")
    factor = size / in_si(wanted)[0]
    return UnitColumn(f"{name}_{ending}{measure}", name + measure, shown, [factor * float(value) for value in listed])
