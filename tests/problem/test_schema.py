"""The JSON schema of problem files: what loads validates against it; most of what is structurally wrong does not."""

from __future__ import annotations

import datetime
import functools
import re
import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import jsonschema
import pytest

import optlink
from optlink.errors import InputError
from optlink.problem.file_errors import MISSING, UNKNOWN
from optlink.problem.schema import problem_schema, text
from optlink.problem.templates import templates
from optlink.problem.terms import QUANTITIES
from optlink.units import KINDS, measures
from tests.messages import table

ROOT = Path(__file__).parents[2]


@functools.cache
def validator() -> Any:
    return jsonschema.Draft202012Validator(problem_schema())


def as_json(value: Any) -> Any:
    """Tables of TOML as an editor sees them: dates as text, names as text."""
    if isinstance(value, Mapping):
        return {str(key): as_json(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [as_json(item) for item in value]
    return value.isoformat() if isinstance(value, datetime.date | datetime.time) else value


def fault(raw: Any) -> str:
    """The first difference of tables from the schema; empty if there is none."""
    error = jsonschema.exceptions.best_match(validator().iter_errors(as_json(raw)))
    return "" if error is None else f"{'.'.join(map(str, error.absolute_path))}: {error.message[:300]}"


def blocks() -> Iterator[tuple[str, Any]]:
    """Complete problems in the documentation."""
    for page in [*sorted((ROOT / "docs").rglob("*.md")), ROOT / "README.md", ROOT / "README.zh.md"]:
        for k, block in enumerate(re.findall(r"```toml(?: design)?\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL)):
            raw = tomllib.loads(block)
            if {"mechanism"} < set(raw):
                yield f"{page.name} {k}", raw


def valid() -> dict[str, Any]:
    files = [*optlink.shipped().values(), *templates().values()]
    found = {path.stem: tomllib.loads(path.read_text(encoding="utf-8")) for path in files}
    found |= {f"base {name}": raw for name, raw in table.read("bases.toml").items()}
    for name, raw in blocks():
        try:
            optlink.read(raw)
        except InputError:  # a part, or with a file
            continue
        found[name] = raw
    return found


def test_what_loads_validates():
    found = valid()
    assert len(found) > 80
    assert {name: said for name, raw in found.items() if (said := fault(raw))} == {}


def test_older_and_american_spellings_validate():
    raw = dict(optlink.load("balance-four-bar").raw)
    goal = {key: value for key, value in raw["balance"].items() if key != "objective"}
    for key in ("objective", "minimise", "minimize"):
        own = raw | {"balance": goal | {key: {"rms driving torque": 1.0}, "limits": {"peak torque": "90 %"}}}
        assert optlink.read(own).task == "balance"
        assert not fault(own)
    law = optlink.load("crank-rocker").raw
    own = {**law, "requirement": {**law["requirement"], "from": "outer dead center"}}
    assert optlink.read(own).hash == optlink.load("crank-rocker").hash
    assert not fault(own)


STRUCTURAL = (
    UNKNOWN,
    MISSING,
    "not one of the choices",
    "unknown kind",
    "expected a table",
    "this is not a text",
    "this is not a whole number",
)


def structural() -> dict[str, Any]:
    """The problems of the table of messages of which a key or a type is wrong, without those of the command line alone."""
    bases, found = table.read("bases.toml"), {}
    for title, entry in table.read("problems.toml").items():
        says, name = entry["says"], entry.get("problem", "")
        if any(f": {words}" in str(says) for words in STRUCTURAL) and not name.endswith(".toml"):
            base = bases[name] if name in bases else optlink.load(name).raw if name else {}
            try:
                found[title] = table.altered(base, entry)
            except TypeError:  # a key below a value
                continue
    return found


def test_what_has_a_wrong_key_or_type_is_refused():
    wrong = structural()
    passed = {title for title, raw in wrong.items() if not fault(raw)}
    assert len(wrong) > 100
    assert passed <= {
        "six-bar: misspelled name of a load",  # a change of a table under a name of the user's choice, which would be new
        "points: unknown key of a drawing",  # a key of points by expressions
    }


@pytest.mark.parametrize(
    ("key", "value", "place"),
    [
        ("mechanism.frame", "500", "mechanism.frame"),
        ("mechanism.frame", 500, "mechanism.frame"),
        ("mechanism.frame", "500 deg", "mechanism.frame"),
        ("mechanism.frame", None, "mechanism"),
        ("mechanism.fram", "500 mm", "mechanism"),
        ("requirement.kind", "functoin", "requirement"),
        ("limits.transmission_angel", ["45 deg", "135 deg"], "limits.transmission_angel"),
        ("format", 2, "format"),
        ("titel", "x", ""),
    ],
)
def test_a_planted_fault_is_refused_at_its_place(key, value, place):
    entry = {"set": {key: value}} if value is not None else {"remove": [key]}
    said = fault(table.altered(optlink.load("crank-rocker").raw, entry))
    assert said.startswith(f"{place}:") or said.startswith(f"{place}."), said


def properties(part: Any, where: str = "") -> Iterator[tuple[str, Any]]:
    if isinstance(part, Mapping):
        if isinstance(part.get("properties"), Mapping):
            yield from ((f"{where}.{name}", form) for name, form in part["properties"].items())
        for name, item in part.items():
            yield from properties(item, f"{where}.{name}")
    elif isinstance(part, list):
        for k, item in enumerate(part):
            yield from properties(item, f"{where}.{k}")


def test_every_key_is_described_and_has_a_form():
    schema = problem_schema()
    jsonschema.Draft202012Validator.check_schema(schema)
    models = {name: part for name, part in schema["$defs"].items() if name[0].isupper()} | {"": schema}
    keys = {f"{name}.{key}": form for name, part in models.items() for key, form in part.get("properties", {}).items()}
    assert len(keys) > 200
    assert [key for key, form in keys.items() if not form.get("description")] == []
    assert [key for key, form in keys.items() if not set(form) & {"$ref", "type", "anyOf", "oneOf", "enum"}] == []
    assert all(part["additionalProperties"] is False for name, part in models.items() if name not in ("Limits", "LoadSection"))
    enums = [form["enum"] for _, form in properties(schema) if "enum" in form]
    assert list(QUANTITIES) in [*enums, *(part["enum"] for part in schema["$defs"].values() if "enum" in part)]


NUMBERS = ("5", "-5", "+5.", ".5", "1e-3", "\u22125", " 5")
UNITS = """
mm m um \u00b5m inches in ft deg \u00b0 rad rpm RPM rev/min 1/min min^-1 1/s rad/s rev Hz s ms kg kgs g kg/m^3
N kN lbf Nm N*m N-m lbf*in J W kW rad/s^2
bar kPa cm^3 cm\u00b3 N\u00b7m kg*m^2 kg\u00b7m\u00b2 kgm^2 m/s m/s^2 m/s\u00b2 m\u00b7s\u207b\u00b2
N/m N*s/m Pa GPa N/m^1.5 N*m/rad N*m*s/rad
"""


def test_every_spelling_of_a_quantity_that_is_read_validates():
    units = [*UNITS.split(), "N m", "kg m2", "kg m^2"]
    for kind in (kind.name for kind in KINDS.values() if kind.si):
        pattern = text(kind)["pattern"]
        read = {f"{number}{space}{unit}" for number in NUMBERS for unit in units for space in ("", " ", "\u00a0")}
        read = {quantity for quantity in read if measures(quantity, kind)}
        assert read
        assert {quantity for quantity in read if not re.search(pattern, quantity)} == set()
        assert not re.search(pattern, "5")
        assert not re.search(pattern, f"5 {'s' if kind != 'time' else 'mm'}")
