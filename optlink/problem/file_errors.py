"""Faults of a problem file from the errors of its models, each with file, key, value and remedy."""

import contextlib
import datetime
import difflib
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import pydantic

from optlink.errors import Fault
from optlink.problem.base_model import ALSO_WRITTEN, Ends, Section, spellings, written
from optlink.problem.design import DesignProblem
from optlink.problem.limits import OF_QUANTITY, OF_REGION, Limits, RegionLimit, four_bar_limits
from optlink.problem.machine.loads import kind_of
from optlink.problem.machine.model import Problem, marked_kinds
from optlink.problem.mechanism import DyadsSection, FourBarSection
from optlink.problem.quantity import Unusable, nearest
from optlink.problem.requirements.base import DEFAULT_KIND
from optlink.problem.requirements.kinds import REQUIREMENTS, lacks
from optlink.problem.targets.law import SLIDE
from optlink.problem.targets.points import POINT_KEYS
from optlink.problem.targets.target_points import file_kind
from optlink.problem.terms import Limit
from optlink.units import split
from optlink.unsupported import unsupported_key

ELEMENTS = {
    "cylinders": 'lift = { joints = ["D", "B"], closed = "900 mm", open = "1500 mm" }',
    "slots": 'slot = { pin = "B", on = "rocker", through = "C" }',
    "gears": 'mesh = { bodies = ["crank", "wheel"], teeth = [20, 60] }',
    "racks": 'feed = { pinion = "sector", rack = "bar", radius = "80 mm" }',
    "belts": 'belt = { bodies = ["motor", "crank"], diameters = ["60 mm", "180 mm"] }',
    "cams": 'lift = { cam = "cam", follower = "rod", law = [{ to = "90 deg", rise = "9 mm" }, ...] }',
}
"""An entry of each table of elements beside links and guides."""


def as_written(fault: Fault, raw: object) -> Fault:
    """Return a fault with its key, and the value of a quantity or range, as they stand in the tables of the file."""
    fault = fault if fault.key is None else replace(fault, key=_indexed(written(fault.key, raw), raw))
    if isinstance(fault.value, Ends):
        return replace(fault, value=fault.value.text)
    if not isinstance(fault.value, str) or fault.key is None:
        return fault
    for step in fault.key.split("."):
        if not isinstance(raw, Mapping) or step not in raw:
            return fault
        raw = raw[step]
    raw = raw.get("bounds") if isinstance(raw, Mapping) else raw
    ends = raw if isinstance(raw, list) else [raw]
    if fault.value in ends:  # one end of a range
        return fault
    if isinstance(raw, Ends):
        return replace(fault, value=raw.text)
    quantities = all(isinstance(end, str) and split(end) for end in ends)
    return replace(fault, value=raw) if quantities else fault


def _indexed(key: str, raw: Any) -> str:
    """Return the key of a value in a list with its index in brackets; that of a table in a list can be set with its dots."""
    parent, _, last = key.rpartition(".")
    for step in parent.split("."):
        raw = raw.get(step) if isinstance(raw, Mapping) else None
    values = isinstance(raw, list) and not any(isinstance(item, Mapping) for item in raw)
    return f"{parent}[{last}]" if last.isdigit() and values else key


UNKNOWN, MISSING = "unknown key", "this key is missing"


def of_dyads(raw: Mapping[str, Any]) -> bool:
    """Return whether the linkage is defined by links and guides."""
    return isinstance(raw.get("mechanism"), dict) and raw["mechanism"].get("type") == "dyads"


def known_keys(path: tuple[str | int, ...], *kinds: type[Problem]) -> list[str]:
    """Return the keys that models of these kinds (default: any kind) have at a path of sections, the outermost first."""
    models: list[Any] = list(kinds) or [DesignProblem, Problem, *marked_kinds().values()]
    for step in path:
        fields = [field for model in models for name, field in model.model_fields.items() if step in spellings(name, field)]
        if fields:  # otherwise the step is the name of a body, a point ...: the models stay the same
            models = [model for f in fields for model in _models(f.annotation)]
        elif any(issubclass(model, Limits) for model in models):  # a limit of a quantity of the machine
            models = [Limit]
        if not models:
            return ["start", "bounds", "equals"]
    return list(dict.fromkeys(key for model in models for key in keys_of(model)))


def keys_of(model: type[pydantic.BaseModel]) -> list[str]:
    """Return the keys of a model, in all their spellings."""
    return [key for name, field in model.model_fields.items() for key in spellings(name, field)]


def keys_ending(raw: Mapping[str, Any], end: str, above: str = "") -> list[str]:
    """Return the dotted keys of a file that end with the given steps, for example `mechanism.crank` for `crank`.

    `above` are the steps that lead to `raw`, each followed by a dot.
    """
    keys = [f"{above}{name}" for name in raw if above and f".{above}{name}".endswith(f".{end}")]
    return keys + [
        key for name, item in raw.items() if isinstance(item, Mapping) for key in keys_ending(item, end, f"{above}{name}.")
    ]


def _models(annotation: Any) -> Iterator[Any]:
    """Yield the sections that a key can contain."""
    if isinstance(annotation, type) and issubclass(annotation, Section):
        yield from annotation.models().values()
    for inner in getattr(annotation, "__args__", ()):
        yield from _models(inner)


def _known(path: tuple[str | int, ...], model: type[Problem], raw: Mapping[str, Any]) -> list[str]:
    """Return the keys at a path of sections that are valid for the task of the file."""
    if path == ("requirement",) and model is DesignProblem:
        return keys_of(REQUIREMENTS[raw["requirement"].get("kind", DEFAULT_KIND)])
    if path[:1] == ("requirements",) and len(path) == 2 and isinstance(path[1], int):
        return keys_of(REQUIREMENTS[raw["requirements"][path[1]].get("kind", DEFAULT_KIND)])
    if path[:1] == ("limits",) and len(path) == 2 and {"region", "quantity"} & set(raw["limits"][path[1]]):
        return keys_of(RegionLimit if "region" in raw["limits"][path[1]] else Limit)
    if path[:1] == ("loads",) and len(path) == 2 and (kind := kind_of(raw["loads"][path[1]])):
        return keys_of(kind.form)
    keys, dyads = known_keys(path, model), of_dyads(raw)
    if path == ("mechanism",):
        fields = (DyadsSection if dyads else FourBarSection).model_fields
        keys = [key for key in keys if key in fields]
    if path == ("limits",) and dyads and model is DesignProblem:
        keys = [key for key in keys if key not in four_bar_limits()]
    return keys


def _nearest_key(path: list[str | int], model: type[Problem], raw: Mapping[str, Any]) -> str:
    """Return the remedy for an unknown key, which may belong to another section than the one where it stands."""
    key = str(path[-1])
    deeper = keys_ending(raw, key) if len(path) == 1 else []
    if not deeper and len(path) < 3:
        sections = [name for name in ("mechanism", "requirement", "limits", "drive") if name in model.model_fields]
        if path[0] == "limits" or keys_ending(raw, f"drive.{key}"):  # a limit of a torque is no torque of the drive
            sections.remove("drive")
        deeper = [f"{name}.{key}" for name in sections if name != path[0] and key in known_keys((name,), model)]
    if path[0] == "requirement" and isinstance(raw["requirement"].get("points"), dict):
        of_points = {name for keys in POINT_KEYS.values() for name in keys}
        deeper = [f"requirement.points.{key}"] if key in of_points else deeper
    elif path == ["requirement", "unit"]:
        deeper = []  # values have their own units; a unit of the drive is another matter
    remedy = nearest(key, _known(tuple(path[:-1]), model, raw), deeper)
    if path[0] == "limits" and len(path) == 2 and model is DesignProblem:
        remedy = f"A limit under a name of your own is a table with quantity or region. {remedy}"
    return remedy


def _needless(path: list[str | int], model: type[Problem], raw: Mapping[str, Any]) -> tuple[str, str]:
    """Return message and remedy for a key that is written twice, that another kind of requirement has, or that is unknown."""
    other, key = ALSO_WRITTEN.get(".".join(map(str, path))), str(path[-1])
    if other is not None and other.partition(".")[2] in raw["requirement"]:
        return f"{key} and {other.partition('.')[2]} are the same key", "Keep one of the two"
    of_kind = lacks(raw["requirement"].get("kind", DEFAULT_KIND), key) if path[:-1] == ["requirement"] else None
    if model is DesignProblem and of_kind is not None:
        return of_kind
    return UNKNOWN, _nearest_key(path, model, raw)


def faults(error: pydantic.ValidationError, model: type[Problem], raw: Mapping[str, Any], file: str) -> Iterator[Fault]:
    """Yield one fault per error of a model; a key that is missing because it is misspelt is not a separate fault."""
    result = list(_faults(error, model, raw, file))
    misspelt = {
        (str(fault.key).rpartition(".")[0], guess)
        for fault in result
        if fault.message == UNKNOWN
        for guess in re.findall('"(\\w+)"', fault.remedy.partition("?")[0])
    }
    for fault in result:
        section, _, key = str(fault.key).rpartition(".")
        # kind and type decide which keys their section needs
        if fault.message != MISSING or not misspelt & {(section, key), (section, "kind"), (section, "type")}:
            yield fault


def _faults(error: pydantic.ValidationError, model: type[Problem], raw: Mapping[str, Any], file: str) -> Iterator[Fault]:
    of_types = ("str", "Quantity", "function-before[<lambda>(), Quantity]", "[key]")
    for item in error.errors(include_url=False):
        path = [step for step in item["loc"] if step not in of_types]
        if path[:1] in (["mechanism"], ["requirement"]) and len(path) > 1 and path[1] in ("four-bar", "dyads", *REQUIREMENTS):
            del path[1]  # the tag of the union type
        if path[:1] == ["requirements"] and len(path) > 2 and path[2] in REQUIREMENTS:
            del path[2]
        if path[:1] == ["limits"] and len(path) > 2 and path[2] in (OF_QUANTITY, OF_REGION):
            del path[2]
        key = ".".join(map(str, path))
        value, problem = _plain(getattr(item["input"], "raw", item["input"])), item.get("ctx", {}).get("error")
        if isinstance(problem, Unusable):
            below = f".{problem.key}" if problem.key and not problem.key.startswith("[") else problem.key
            yield Fault(problem.message, problem.remedy, file, (key + below).lstrip("."), problem.value if problem.key else value)
        elif path[:1] == ["limits"] and model is DesignProblem and _unknown_limit(item["type"], path, raw):
            if len(path) == 2 or item["type"] == "missing":
                key = ".".join(map(str, path[:2]))
                yield Fault(*(unsupported_key(key) or _needless(path[:2], model, raw)), file, key)
        elif item["type"] == "extra_forbidden":
            yield Fault(*(unsupported_key(key) or _needless(path, model, raw)), file, key)
        elif item["type"] == "union_tag_invalid":
            linkage_type = raw["mechanism"].get("type")
            known = nearest(str(linkage_type), ("four-bar", "dyads"))
            remedy = f"{known} (slider-crank, six-bar and others: `optlink new --list`)"
            yield Fault("not a type of linkage", remedy, file, f"{key}.type", _plain(linkage_type))
        elif item["type"] == "missing" and isinstance(path[-1], int):
            if path[-1] == len(item["input"]):  # the first that is missing
                yield Fault("a value is missing in the list", _example(key), file, key.rpartition(".")[0], value)
        elif item["type"] == "missing":
            yield Fault(MISSING, _example(key), file, key)
        else:
            yield Fault(*_wrong(item, path, key), file, key, value)


def _unknown_limit(kind: str, path: list[str | int], raw: Mapping[str, Any]) -> bool:
    """Return whether an error is due to a key of the limits that neither is known nor limits a quantity of the machine."""
    if len(path) < 2 or path[1] in Limits.model_fields:
        return False
    stated = raw["limits"][path[1]]
    kinds = {"quantity", "region"} & set(stated if isinstance(stated, Mapping) else ())
    return kind == "model_type" or (kind in ("missing", "extra_forbidden") and not kinds)


def _wrong(item: Any, path: list[str | int], key: str) -> tuple[str, str]:
    """Return the message and the remedy for a value of the wrong type or out of range."""
    value, kind, context = item["input"], item["type"], item.get("ctx", {})
    if kind == "literal_error":
        return "not one of the choices", nearest(str(value), re.findall("'([^']*)'", str(context.get("expected", ""))))
    if kind in ("model_type", "model_attributes_type"):
        if path[:-1] == ["limits"]:
            limit = f'{path[1]} = {{ quantity = "torque", max = "10 N*m" }}'
            return "not a limit of this kind of problem", f"Leave it out, or limit a quantity of the cycle: {limit}"
        if path[:-1] == ["bodies"]:
            return "expected a table", f'Write {path[-1]} = {{ mass = "1.2 kg" }}'
        return "expected a table", f"Begin it with [{key}]" if key else "Write the sections"
    if kind == "bool_type":
        return "neither true nor false", f"Write {path[-1]} = true, or leave it out"
    if kind == "string_type":
        plain_text = isinstance(value, int | float) and len(path) == 1
        return "this is not a text", f'Write it in quotes: "{value}"' if plain_text else _example(key)
    message = _WRONG[kind].format(**context) if kind in _WRONG else item["msg"][0].lower() + item["msg"][1:]
    return message, _example(key)


_WRONG = {
    "int_type": "this is not a whole number",
    **dict.fromkeys(("list_type", "tuple_type"), "this is not a list"),
    "dict_type": "expected a table",
    "too_long": "a list of {max_length} is needed, and {actual_length} are given",
    "greater_than": "this is not above {gt}",
    "greater_than_equal": "this is below {ge}",
    "less_than": "this is not below {lt}",
    "less_than_equal": "this is above {le}",
}
"""What is wrong with a value, by the type of pydantic's error."""


def similar_name(text: str, names: Iterable[str]) -> str:
    """Return the remedy for a name that is not a shipped problem: a file or a problem with a similar name."""
    with contextlib.suppress(OSError, ValueError):
        files = sorted(path.name for path in Path().glob("*.toml"))
        if meant := [f"{text}.toml"] * (f"{text}.toml" in files) or difflib.get_close_matches(text, files, n=1, cutoff=0.8):
            return f'Did you mean the file "{meant[0]}"?'
    guess = nearest(text, names).partition("Known: ")[0]
    return f"{guess}`optlink list` names the shipped ones; or give the path of a .toml file"


TOML_FILE = "Give the path of a problem file, a .toml text file"


def text_fault(data: bytes, error: UnicodeDecodeError, file: str) -> Fault:
    """Return the fault of a file that is not UTF-8 text."""
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        return Fault(f"not UTF-8 text: byte {error.start} (it is UTF-16)", "Save the file as UTF-8", file)
    if (kind := file_kind(data)) or b"\0" in data:
        return Fault(f"this is {kind or 'not a text file'}", TOML_FILE, file)
    line = data.count(b"\n", 0, error.start) + 1
    return Fault(f"not UTF-8 text: byte 0x{data[error.start]:02X} in line {line}", "Save the file as UTF-8", file)


def toml_fault(message: str, file: str, text: str = "") -> Fault:
    """Return the fault of a file that is not valid TOML; the message of the parser ends with the place in brackets."""
    if text.lstrip().startswith("{"):
        remedy = "Give the problem; the other commands take a result too, and `optlink show FILE --toml` prints the problem in it"
        return Fault("this is JSON, not a problem file in TOML", remedy, file)
    if kind := file_kind(text[:8].encode()):
        return Fault(f"this is {kind}", TOML_FILE, file)
    if "\0" in text:
        return Fault("not UTF-8 text: it contains NUL characters", "Save the file as UTF-8", file)
    if "\r" in text and "\n" not in text:
        return Fault("the lines end with carriage returns alone", "Save the file with the line ends LF or CRLF", file)
    if message.startswith("Exceeds the limit"):  # of digits of an integer, in Python
        return Fault("not valid TOML: a number has thousands of digits", "Write a number of at most 19 digits", file)
    remedy = 'Correct that line; texts and values with a unit stand in quotes: "250 mm"'
    return Fault(f"not valid TOML: {message}", remedy, file)


def _plain(value: object) -> object:
    if isinstance(value, datetime.date | datetime.time):
        return value.isoformat()
    return value if isinstance(value, str | int | float | list | dict) else type(value).__name__


_EXAMPLES = {
    "mechanism": "Add the section [mechanism]",
    "requirement": "Add the section [requirement]",
    "balance.objective": 'Add objective = { quantity = "shaking force", measure = "rms" }',
    "requirement.law": f'Add law = "psi0 + 0.5*(phi - phi0)", or for a slider {SLIDE}',
    "requirement.point": 'Add point = "P", a point of a moving body',
    "requirement.at": 'Add at = "90 deg"',
    "requirement.value": 'Add value = "55 deg", or a range: value = ["50 deg", "60 deg"]',
    "requirement.over": 'Add over = ["100 deg", "160 deg"]',
    "requirement.stroke": 'Add stroke = "60 deg", or "100 mm" for a slider',
    "requirement.points": "Give a whole number from 1 to 10000, for example points = 30",
    "expected.source": "State the source of the expected values",
}


def _example(key: str) -> str:
    section, _, last = key.partition(".")[0], *key.rpartition(".")[1:]
    if section in ("bodies", "mechanism") and last == "mass":
        return 'Add mass = "1.2 kg"'
    if section == "drives":
        return 'Write for example elbow = { body = "forearm", against = "upper_arm", speed = "20 rpm" }'
    if last == "joints":
        return 'Add joints = ["B", "C"], or joints = ["E"] for a body that a guide carries'
    if key.startswith("mechanism.assembly"):
        return 'Write for example "left of B-D", "forward" or "either"'
    if last in ("bore", "pressure"):
        return 'Write for example gas = { pressure = "120 bar", bore = "10 mm" }'
    if last == "slider":
        return 'Add slider = "NAME", with the name of the body that slides'
    if key.startswith(
        ("mechanism.links", "mechanism.guides", "mechanism.ground", "bodies", "joints", "loads", "drive", "gravity")
    ):
        return "See `optlink show six-bar --toml` for an example"
    if key.startswith("mechanism."):
        part = key.split(".")[1]
        if part in ELEMENTS:
            return f"Write for example {ELEMENTS[part]}"
        return f'Add {part} = "100 mm", or {{ start = "400 mm", bounds = ["100 mm", "900 mm"] }}'
    examples = {"balance": "balance-four-bar", "objective": "shaper-design", "control": "slider-crank-three-gaps"}
    examples |= {"limits": "path-in-trough"}  # where a required key is missing in a region
    stated = f"requirement.{last}" if section == "requirements" else key
    return _EXAMPLES.get(stated, f"See `optlink show {examples.get(section, 'crank-rocker')} --toml` for an example")
