"""Problem files: TOML to problem models and back, shipped problems, `--set` overrides; errors name file and key."""

from __future__ import annotations

import copy
import itertools
import json
import math
import os
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import pydantic
from pydantic_core import PydanticKnownError, core_schema

from optlink.errors import OPTIONS_NAMED, InputError, shown
from optlink.io import data_files, load_extensions, shown_name, without
from optlink.linkage.vector2d import TURN
from optlink.problem.arguments import typed
from optlink.problem.base_model import DEEPEST, SPELLED, SPELLINGS, with_ranges, with_spellings, written
from optlink.problem.design import DesignProblem
from optlink.problem.enclosed import enclosing, identity, references
from optlink.problem.file_errors import (
    as_written,
    faults,
    keys_ending,
    known_keys,
    similar_name,
    text_fault,
    toml_fault,
)
from optlink.problem.limits import MARGINS
from optlink.problem.linked import states_links
from optlink.problem.machine.balance import with_terms
from optlink.problem.machine.model import FORMAT, Problem, marked_kinds
from optlink.problem.mechanism import read_near
from optlink.problem.overview import linkage_type
from optlink.problem.quantity import BOTH, input_of, nearest, quantity_key, write
from optlink.problem.requirements.base import DEFAULT_KIND, names_of
from optlink.problem.requirements.kinds import REQUIREMENTS
from optlink.problem.rounding import with_grid
from optlink.problem.targets.target_points import split_enclosed
from optlink.problem.tolerances import read_tolerance, with_tolerance
from optlink.units import in_si, is_unit, split, split_range

MAX_BYTES = 1_000_000
MOST_NESTED = 50
SHIPPED = "the shipped problem "
"""How errors name the file of a shipped problem where the present folder has one of that name."""
ANGLES = ("direction", "tilt", "from", "start", "psi0", "mark")
"""Last steps of the keys of quantities that are angles."""
SIDES = ("min", "max")
RANGE_KEYS = {"start", "bounds", "equals", "exactly", *SIDES}
"""Keys of a table that states one quantity: a free one, or a range of it."""


@dataclass(frozen=True, repr=False)
class ProblemFile:
    """A problem with its origin.

    `name` and `file`: for display; `raw`: the tables as written, with overrides; `model`: the checked problem; `overrides`:
    values by dotted key that replaced those of the file; `files`: contents of the CSV and SVG files that it names, as they were
    when it was read.
    """

    name: str
    file: str
    folder: Path
    raw: Mapping[str, Any]
    model: Problem
    overrides: Mapping[str, object] = field(default_factory=dict)
    files: Mapping[str, str] = field(default_factory=dict)

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: Any) -> Any:
        """Within a document a problem is stated by its changes of the document's problem; see `optlink.problem.document`."""

        def read_changes(value: Any, info: core_schema.ValidationInfo) -> ProblemFile:
            context: dict[str, ProblemFile] = info.context or {}
            if isinstance(value, ProblemFile):
                problem = value
            elif "problem" not in context:
                raise PydanticKnownError("is_instance_of", {"class": "ProblemFile"})
            else:
                problem = context["problem"].override(value) if value else context["problem"]
            context["present"] = problem  # that of the parts which follow
            return problem

        def changes(value: ProblemFile, info: core_schema.SerializationInfo) -> dict[str, Any]:
            common = info.context["problem"].overrides  # type: ignore[index]
            return {key: item for key, item in value.overrides.items() if key not in common or common[key] != item}

        return core_schema.with_info_plain_validator_function(
            read_changes, serialization=core_schema.plain_serializer_function_ser_schema(changes, info_arg=True)
        )

    @classmethod
    def __get_pydantic_json_schema__(cls, schema: Any, handler: Any) -> dict[str, Any]:
        return {"type": "object"}

    def __hash__(self) -> int:
        return hash((self.name, self.file, self.hash))

    @property
    def file_name(self) -> str:
        """Name of the file in documents; `file` is that in errors."""
        return f"{self.name}.toml" if self.file.startswith(SHIPPED) else self.file

    def __repr__(self) -> str:
        changes = "".join(f", {key} = {shown(value)}" for key, value in self.overrides.items())
        return f"<ProblemFile {self.name!r}: {self.kind}{changes}>"

    @property
    def spec(self) -> DesignProblem:
        """The model of a design problem.

        Raises
        ------
        InputError
            when the problem has no requirement.
        """
        if isinstance(self.model, DesignProblem):
            return self.model
        remedy = "Add one, or use `optlink analyze`, `study sweep --analyze` or --simulate, `study sensitivity --quantity NAME`"
        raise InputError("the problem has no [requirement], so there is nothing to solve", remedy, self.file)

    @property
    def task(self) -> str:
        """Kind of task: "function", "path", "cycle", "balance" or "analysis"; the name of its module in `optlink.tasks`."""
        return self.model.task

    @property
    def kind(self) -> str:
        """Type of the linkage and kind of the task, for display."""
        requirements = getattr(self.model, "requirements", ()) or filter(None, [getattr(self.model, "requirement", None)])
        kinds = " and ".join(dict.fromkeys(one.kind for one in requirements if one.kind))
        purpose = f"{kinds} design" if kinds else {"cycle": "cycle design", "balance": "balancing"}.get(self.task, self.task)
        return f"{self.model.mechanism.type}, {purpose}"

    @cached_property
    def hash(self) -> str:
        """Hash of everything that can change the result, the content of other files included; sixteen hexadecimal digits."""
        return identity(self.model, WORDS)

    def at(self, key: str) -> Any:
        """Return the value of the file at a dotted key, also that of a coordinate; None if there is none."""
        return _at(self.raw, key)

    def unit_at(self, key: str) -> str:
        """Return the unit in which the file states the quantity at a dotted key, or a side of it; empty if it has none."""
        return _unit(_at(self.raw, _whole_key(key))) or _linked_unit(self.raw, key)

    def variants(self) -> list[ProblemFile]:
        """Return the problem with definite assembly modes, one for each combination in which its sections are consistent.

        If there is none, the error of the first combination is raised.
        """
        variants, refused = list[ProblemFile](), list[InputError]()
        for change in self.model.mechanism.variants(self.model.linkage):
            try:
                definite = {**self.located, **change}
                variants.append(self.override(definite) if definite else self)
            except InputError as error:
                refused.append(error)
        if not variants:
            raise refused[0]
        return variants

    @property
    def located(self) -> dict[str, str]:
        """Assembly modes that follow from the place of a joint, by dotted key."""
        stated, chosen = self.raw["mechanism"].get("assembly", {}), self.model.mechanism.assembly
        if isinstance(stated, str) or isinstance(chosen, str):
            return {"mechanism.assembly": str(chosen)} if read_near(stated) else {}
        return {f"mechanism.assembly.{joint}": chosen[joint] for joint, words in stated.items() if read_near(words)}

    def mode(self, joint: str = "") -> str:
        """Return the assembly mode of a joint, with the place from which it follows in parentheses.

        Parameters
        ----------
        joint : str
            Name of the joint or guide; none for a four-bar.
        """
        modes, key = self.model.mechanism.assembly, f"mechanism.assembly.{joint}".rstrip(".")
        mode = modes if isinstance(modes, str) else modes.get(joint, "")
        return f"{mode} ({self.at(key)})" if key in self.located else mode

    def variant(self, assembly: object) -> ProblemFile | None:
        """Return the problem with the assembly mode of a result, in the words of its file; None if it has no such mode.

        Parameters
        ----------
        assembly : object
        """
        wanted = json.dumps(assembly, sort_keys=True)
        modes = ((json.dumps(one.raw["mechanism"].get("assembly", "left"), sort_keys=True), one) for one in self.variants())
        return next((one for mode, one in modes if mode == wanted), None)

    @typed
    def override(self, changes: Mapping[str, object]) -> ProblemFile:
        """Return a copy of the problem with other values.

        Parameters
        ----------
        changes : mapping of str to object
            Values by dotted key, for example {"mechanism.frame": "480 mm"}; None removes a key. One side of a range also has a
            key: "limits.transmission_angle.max", "mechanism.coupler.min". A float in place of a quantity that has a unit in
            the problem is SI, as all numbers of results are: {"mechanism.coupler": result.design["coupler"]}; one that must
            have been meant in millimetres or degrees is refused, as a whole number is. A change of any key that affects the
            result removes `[expected]`.

        Raises
        ------
        InputError
            If a key or value is invalid.
        """
        raw = copy.deepcopy(dict(self.raw))
        changes = _with_units(raw, _without_arrays(changes), self.file)
        _change(raw, changes, self.file)
        earlier = without(self.overrides, *changes)
        anew = {split_enclosed(text)[0] for text in _texts(changes)}  # a file that is named anew is read anew
        known = without(self.files, *anew)
        return replace(replace(self, files=known).with_tables(raw), overrides={**earlier, **changes})

    def with_tables(self, raw: Mapping[str, Any]) -> ProblemFile:
        """Return the problem of other nested tables, with the same name and files."""
        return read(raw, self.name, self.file, self.folder, self.files)


def _texts(value: Any, depth: int = 0) -> Iterator[str]:
    """Yield the texts in nested tables and lists, without those that are nested too deep to be read."""
    if isinstance(value, str):
        yield value
    nested = depth < DEEPEST and isinstance(value, Mapping | list | tuple)
    for item in (value.values() if isinstance(value, Mapping) else value) if nested else ():
        yield from _texts(item, depth + 1)


WORDS = ("format", "title", "source", "about", "report", "parts", "made", "expected")


def shipped() -> dict[str, Path]:
    """Return names and files of the shipped problems."""
    return data_files("problems")


AnyProblem: TypeAlias = ProblemFile | str | Path
"""A problem: as `load` returns it, the name of a shipped one, or the path of a problem file."""


def problem_of(problem: AnyProblem) -> ProblemFile:
    """Return a problem, loaded if it is a name or a path."""
    return problem if isinstance(problem, ProblemFile) else load(problem)


@typed
def load(problem: str | Path, overrides: Mapping[str, object] | None = None) -> ProblemFile:
    """Load a shipped problem by name or a problem file by path.

    Parameters
    ----------
    problem : str or Path
        "crank-rocker", or "my/problem.toml".
    overrides : mapping of str to object, optional
        Values by dotted key, for example {"mechanism.frame": "480 mm"}, as in `ProblemFile.override`. They replace the values
        of the file before it is checked.

    Returns
    -------
    ProblemFile
        The checked problem; argument of `solve`, `analyze` and the other tasks.

    Raises
    ------
    InputError
        If the problem does not exist, or the file or an override is invalid.
    """
    text = str(problem)
    names = shipped()
    if text in names:
        path, name = names[text], text
    else:
        path = Path(text)
        name = shown_name(path.stem)
        if not text.endswith(".toml") and not os.path.exists(text):  # False for a name that is too long
            if text in data_files("templates"):
                remedy = f"Write a problem file from it: optlink new {text} --out {text}.toml"
                raise InputError("this is a template, not a problem", remedy, key="PROBLEM", value=text)
            raise InputError("no such problem", similar_name(text, names), key="PROBLEM", value=text)
    file = shown_name(path.name if text in names else text)
    if text in names and os.path.exists(file):
        file = f"{SHIPPED}{text}"
    raw = _tables(_read_toml(path), file)
    changes = _with_units(raw, _without_arrays(overrides or {}), file)
    _change(raw, changes, file)
    return replace(read(raw, name, file, path.parent), overrides=changes)


@typed
def read(
    raw: Mapping[str, Any] | str,
    name: str = "problem",
    file: str = "problem",
    folder: Path | None = None,
    files: Mapping[str, str] | None = None,
) -> ProblemFile:
    """Read and check a problem from nested tables (the content of a TOML file), or from the text of such a file.

    Parameters
    ----------
    raw : mapping or str
        Nested tables, or the text of a problem file such as `optlink.new("wiper")`.
    name : str
        Name of the problem.
    file : str
        Name of the file, for errors.
    folder : Path, optional
        Folder to which names of other files are relative; default: the working folder.
    files : mapping of str to str, optional
        Contents of other files by the names in the problem, in place of those in the folder.

    Raises
    ------
    InputError
        with one fault per error.
    """
    load_extensions()
    where = folder or Path()
    if isinstance(raw, str) and "=" not in raw:
        remedy = f"Load a file: optlink.load({shown(raw)})"
        raise InputError("not the text of a problem file", remedy, key="raw", value=raw)
    tables = _without_arrays(_parse(raw, file) if isinstance(raw, str) else raw)
    _check_values(tables, file)
    raw = _typed(_tables(tables, file))
    model = _model(raw, file)
    try:
        with input_of(file):
            enclosed, contents = enclosing(raw, where, files or {})
        tables, context = {"title": name[:200], **enclosed}, {"folder": where}
        problem = model.model_validate(tables, context=context)
        if states_links(raw):
            with input_of(file):
                tables = problem.with_links(tables)
            problem = model.model_validate(tables, context=context)
        with input_of(file):
            problem = problem.assembled()
            problem.check()
    except (pydantic.ValidationError, InputError) as error:
        errors = error.faults if isinstance(error, InputError) else faults(error, model, raw, file)
        raise InputError([as_written(fault, raw) for fault in errors]) from None
    return ProblemFile(name, file, where, raw, problem, files=contents)


def _tables(raw: Mapping[str, Any], file: str) -> dict[str, Any]:
    """Return the tables of a file in present words, with ranges written out."""
    stated = raw.get("format", FORMAT)
    if type(stated) is not int or stated < 1:
        raise InputError("not a format of problem files", f"Write format = {FORMAT}, or leave it out", file, "format", stated)
    if stated > FORMAT:
        message = f"the file has a later format than this version of optlink reads, {FORMAT}"
        raise InputError(message, "Update optlink", file, "format", stated)
    with input_of(file):
        return with_terms(with_ranges(with_spellings(raw), skip=WORDS))


def _model(raw: Mapping[str, Any], file: str) -> type[Problem]:
    """Return the model of a file: that of a registered section, else of its requirement, objective or limits."""
    requirement: Any = raw.get("requirement")
    registered = [model for section, model in marked_kinds().items() if section in raw]
    if "requirements" in raw:
        _check_requirements(raw["requirements"], file)
    kind = requirement.get("kind", DEFAULT_KIND) if isinstance(requirement, dict) else None
    if isinstance(requirement, dict) and not {"kind", "law"} & set(requirement):
        others = {key for one in REQUIREMENTS.values() for key in one.model_fields}
        if (others - set(REQUIREMENTS[DEFAULT_KIND].model_fields)) & set(requirement):
            raise InputError("this key is missing", 'Add kind = "path", "motion" or "stroke"', file, "requirement.kind")
    if kind is not None and str(kind) not in REQUIREMENTS:
        raise InputError("unknown kind", nearest(str(kind), REQUIREMENTS), file, "requirement.kind", kind)
    if registered:
        return registered[0]
    return DesignProblem if {"requirement", "requirements", "objective", "limits"} & set(raw) else Problem


def _check_requirements(stated: Any, file: str) -> None:
    """Refuse a list of requirements that is none, or one of an unknown kind."""
    if not isinstance(stated, list) or not stated or not all(isinstance(one, dict) for one in stated):
        remedy = "Begin each requirement with [[requirements]], or write one as [requirement]"
        raise InputError("not a list of requirements", remedy, file, "requirements")
    for k, one in enumerate(stated):
        kind = one.get("kind", DEFAULT_KIND)
        if str(kind) not in REQUIREMENTS:
            raise InputError("unknown kind", nearest(str(kind), REQUIREMENTS), file, f"requirements.{k}.kind", kind)


def _check_values(raw: Mapping[str, Any], file: str) -> None:
    """Refuse integers beyond the 64 bits of TOML, text that is not UTF-8, and tables or lists that are nested too deep."""
    todo: list[tuple[str, object, int]] = [("", raw, 0)]
    while todo:
        key, value, depth = todo.pop()
        if isinstance(value, int) and value.bit_length() > 64:
            raise InputError("the number is too large", "Write a number of at most 19 digits", file, key, value)
        if any(shown_name(text) != text for text in (key, value) if isinstance(text, str)):  # as a command line may pass bytes
            raise InputError("the text is not UTF-8", "Write it in UTF-8", file, key, value)
        if depth > MOST_NESTED:
            where = ".".join(key.split(".")[:3]).partition("[")[0]
            raise InputError(f"nested more than {MOST_NESTED} deep", "Simplify it", file, where)
        if isinstance(value, Mapping):
            todo += [(f"{key}.{name}" if key else str(name), item, depth + 1) for name, item in value.items()]
        elif isinstance(value, list | tuple):
            todo += [(f"{key}[{place}]", item, depth + 1) for place, item in enumerate(value)]


def _typed(raw: Mapping[str, Any]) -> Mapping[str, Any]:
    """Add the format of a file without one, as the first key, and the type of a mechanism without one."""
    raw, mechanism = {"format": FORMAT, **raw}, raw.get("mechanism")
    if isinstance(mechanism, dict) and "type" not in mechanism:
        return {**raw, "mechanism": {"type": linkage_type(raw), **mechanism}}
    return raw


def dump(problem: ProblemFile) -> str:
    """Return the problem as TOML text that `load` can read."""
    import tomli_w

    return tomli_w.dumps(problem.raw)


def complete(problem: ProblemFile) -> dict[str, Any]:
    """Return the problem as nested tables, including default limits."""
    raw = copy.deepcopy(dict(problem.raw))
    inapplicable = getattr(problem.model, "inapplicable", None)
    if inapplicable is not None:
        margins = {key: value for key, value in MARGINS.items() if f"limits.{key}" not in inapplicable}
        raw["limits"] = {**margins, **raw.get("limits", {})}
    return raw


def _read_toml(path: Path) -> dict[str, Any]:
    file = str(path)
    try:
        with path.open("rb") as stream:
            data = stream.read(MAX_BYTES + 1)
    except FileNotFoundError:
        raise InputError("no such file", "Check the path; `optlink list` names the shipped problems", file) from None
    except IsADirectoryError:
        raise InputError("this is a folder", "Give the path of a .toml file", file) from None
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise InputError(f"cannot read the file: {reason}", "Check the path and its permissions", shown(file)) from None
    if len(data) > MAX_BYTES:
        raise InputError(f"the file is larger than {MAX_BYTES:,} bytes", "Put long tables into a CSV file", file)
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(text_fault(data, error, file)) from None
    return _parse(text, file)


def _parse(text: str, file: str) -> dict[str, Any]:
    try:
        raw = tomllib.loads(text)
    except RecursionError:
        raise InputError("brackets are nested too deep", "Simplify the file", file) from None
    except ValueError as error:  # TOMLDecodeError, and integers of thousands of digits
        raise InputError(toml_fault(str(error), file, text)) from None
    _check_values(raw, file)
    if not raw:
        raise InputError("the file has no keys: all sections are missing", "Begin with a template: `optlink new --list`", file)
    return raw


def _without_arrays(raw: Any, depth: int = 0) -> Any:
    """Return nested tables with the numbers and lists of Python in place of those of numpy and pandas, and of tuples."""
    if hasattr(raw, "__array__"):
        return np.asarray(raw).tolist()
    if isinstance(raw, Mapping) and depth < DEEPEST:
        stated = ((key, value) for key, value in raw.items() if value is not None or depth == 0)
        return {key: _without_arrays(value, depth + 1) for key, value in stated}
    return [_without_arrays(value, depth + 1) for value in raw] if type(raw) in (list, tuple) and depth < DEEPEST else raw


IMPLAUSIBLE = {"m": 10.0, "rad": 2.0 * TURN}
"""Numbers in SI from which on another unit was meant: of lengths by the largest one of the mechanism, angles beyond two turns."""
INSTEAD = {"m": (1e-3, "mm"), "rad": (TURN / 360.0, "deg")}
"""That unit, and its SI value."""


def check_plausible(tables: Mapping[str, Any], values: Any, unit: str, file: str, key: str, *, texts: bool = True) -> None:
    """Refuse numbers in SI that were meant in millimetres or degrees, by the lengths in the tables of a problem.

    `texts`: whether a text with a unit is accepted in their place.

    Raises
    ------
    InputError
        If there is such a number.
    """
    if unit not in IMPLAUSIBLE or not np.size(values):
        return
    value = float(np.ravel(values)[np.argmax(np.abs(values))])
    size = max(map(_length, _texts(tables.get("mechanism", {}))), default=0.0) if unit == "m" else 1.0
    if not abs(value) > IMPLAUSIBLE[unit] * size > 0.0:
        return
    (per, meant), share = INSTEAD[unit], abs(value) / size
    message = f"{share / TURN:.3g} turns" if unit == "rad" else f"{share:.3g} times the largest length of the mechanism"
    remedy = f"Numbers are SI: {value:g} {meant} are {value * per:.6g}"
    remedy += f', or the text "{value:g} {meant}"' if texts else ""
    raise InputError(f"{value:g} {unit} are {message}", remedy, file, key, value)


def _length(text: str) -> float:
    """Return the length that a text of a file states, the larger one of a range [m]; 0 for any other text."""
    sides = (text, *map(str, (split_range(text) or {}).values()))
    parts = [parts for side in sides if (parts := split(side)) is not None]
    return max((abs(value) * size for value, unit in parts for size, si in [in_si(unit)] if si == "m"), default=0.0)


def _whole_key(key: str) -> str:
    """Return the key of the range to whose side a key belongs, or the key itself."""
    return key.removesuffix(".min").removesuffix(".max")


def _with_units(raw: Mapping[str, Any], changes: Mapping[str, Any], file: str) -> Mapping[str, Any]:
    """Return changes with the SI unit after each float that replaces a quantity with a unit; a command has no numbers in SI.

    A whole number remains without a unit and is refused: it was meant in the unit of the file.
    """
    if OPTIONS_NAMED.get():
        return changes
    stated = {}
    for key, value in changes.items():
        present = _at(raw, _whole_key(key))
        unit = si_unit(present) or _linked_unit(raw, key)
        floats = [item for item in _items(value) if type(item) is float and math.isfinite(item)] if unit else []
        check_plausible(raw, floats, unit, file, key)
        stated[key] = _stated(value, present, unit)
    return stated


def _linked_unit(raw: Mapping[str, Any], key: str) -> str:
    """Return the SI unit of a linked quantity at a key of a file; empty for anything else."""
    value = _at(raw, key)
    if not isinstance(value, Mapping) or "equals" not in value:
        return ""
    return "rad" if key.rpartition(".")[2] in ANGLES else "m"


def si_unit(value: Any) -> str:
    """Return the SI unit of a quantity, a range or a list in a file; empty if it has none."""
    return in_si(_unit(value))[1]


def _unit(value: Any) -> str:
    """Return the unit of the first quantity in a value, a range or a list of a file; empty if there is none."""
    if isinstance(value, str):
        parts = split(value)
        return parts[1] if parts is not None and is_unit(parts[1]) else ""
    items = value if isinstance(value, list) else value.values() if _is_range(value) else ()
    return next(filter(None, map(_unit, itertools.islice(items, 2))), "")


def _is_range(value: Any) -> bool:
    return isinstance(value, Mapping) and RANGE_KEYS.issuperset(value)


def _items(value: Any) -> list[Any]:
    """Return a value, or the values of a range or a list in place of one."""
    return list(value.values()) if _is_range(value) else value if isinstance(value, list) else [value]


def _stated(value: Any, present: Any, unit: str) -> Any:
    """Return a value, or a range or pair in place of one, with a unit after each number."""
    if not unit:
        return value
    if _is_range(value):
        return {key: _stated(item, [], unit) for key, item in value.items()}
    if isinstance(value, list):
        pair = isinstance(present, list) and any(type(item) is float for item in value)
        return [f"{item!r} {unit}" if pair and type(item) in (int, float) else item for item in value]
    return f"{value!r} {unit}" if type(value) is float else value


def _change(raw: dict[str, Any], changes: Mapping[str, object], file: str) -> None:
    """Set values by dotted key; a change of any key that affects the result removes `[expected]`."""
    for key, value in changes.items():
        _assign(raw, key, value, file)
    if any(key.split(".")[0] not in ("expected", *WORDS) for key in changes):
        raw.pop("expected", None)


NAMED = {"tolerances": with_tolerance, "rounding": with_grid}
"""Sections of values by the name of a size, which can have dots; with the function that assigns one."""


def _assign(raw: dict[str, Any], key: str, value: object, file: str) -> None:
    if key.partition(".")[0] in SPELLED:
        key = written(".".join(SPELLINGS.get(step, step) for step in key.split(".")), raw)
    key = "balance.objective" if key == "balance.minimise" else key
    with input_of(file):
        value = with_ranges(value, tuple(key.split(".")), WORDS)
    key, value = _whole(raw, key, value, file)
    section, _, name = key.partition(".")
    if section in NAMED and name and isinstance(raw.setdefault(section, {}), dict):
        NAMED[section](raw[section], name, value)
        return
    steps = key.split(".")
    table: Any = raw
    for depth, step in enumerate(steps[:-1]):
        path = tuple(steps[:depth])
        place = _coordinate(path, table, step)
        if place is None and step not in table:
            common = not path and step in Problem.model_fields  # no other kind is imported for it
            keys = [step] if common else known_keys(path) if _fixed(path) else list(table)
            if step not in keys:
                remedies = [nearest(step, keys, [] if path else keys_ending(raw, key))] if keys else []
                if not _fixed(path):
                    remedies.append(f"Give a new table as a whole:  {'.'.join(steps[: depth + 1])}={{ ... }}")
                raise InputError("unknown key", ". ".join(remedies), file, key)
            table[step] = {}
        table = table[step if place is None else place]
        following = steps[depth + 1]
        if not isinstance(table, dict) and _coordinate(tuple(steps[: depth + 1]), table, following) is None:
            above = ".".join(steps[: depth + 1])
            listed = above == "requirements" and isinstance(table, list)
            remedy = nearest(following, _names_of(table)) if listed else f"Set {above} itself"
            raise InputError(f"{above} has no key {following}", remedy, file, key, value)
    place = _coordinate(tuple(steps[:-1]), table, steps[-1])
    if place is not None:
        table[place] = value
    elif value is None:
        table.pop(steps[-1], None)
    else:
        table[steps[-1]] = value


def _coordinate(path: tuple[str, ...], table: Any, step: str) -> int | None:
    """Return the index of an element of a list: a coordinate, as in `mechanism.ground.A.x`, or a requirement by name or number.

    None if the key is neither.
    """
    if path == ("requirements",) and isinstance(table, list):
        listed = _names_of(table)
        return listed.index(step) if step in listed else int(step) if step.isdecimal() and int(step) < len(table) else None
    placed = path[:1] == ("mechanism",) or path == ("gravity",) or path[-1:] == ("centroid",)
    if not placed or not isinstance(table, list) or len(table) != 2 or path[-1] in ("bounds", "joints"):
        return None
    names = ("along", "across") if "points" in path or path[-1] == "centroid" else ("x", "y")
    names = BOTH if path[-1] in ("diameters", "radii") else names
    return names.index(step) if step in names else None


def _names_of(requirements: list[Any]) -> list[str]:
    """Return the names of a list of requirements."""
    tables = [one if isinstance(one, dict) else {} for one in requirements]
    return names_of([(one.get("name"), str(one.get("kind", DEFAULT_KIND))) for one in tables])


def _at(raw: Mapping[str, Any], key: str) -> Any:
    """Return the value at a dotted key; None if there is none."""
    value: Any = raw
    steps = written(key, raw).split(".")
    for depth, step in enumerate(steps):
        place = _coordinate(tuple(steps[:depth]), value, step)
        value = value[place] if place is not None else value.get(step) if isinstance(value, Mapping) else None
    return value


def _whole(raw: Mapping[str, Any], key: str, value: object, file: str) -> tuple[str, object]:
    """Return key and value of a whole range for one side of it: `limits.transmission_angle.max`, `mechanism.coupler.min`."""
    above, _, side = key.rpartition(".")
    content = _at(raw, above)
    if side not in SIDES or value is None or content is None:
        return key, value
    if isinstance(content, Mapping):
        bounds = content.get("bounds")
        if "exactly" in content:  # an equality becomes a range
            both = dict.fromkeys(SIDES, content["exactly"]) | {side: value}
            return above, {**without(content, "exactly"), **both}
        return (above, {**content, "bounds": _side(bounds, side, value)}) if isinstance(bounds, list) else (key, value)
    if not isinstance(content, list):
        if above.startswith("mechanism."):
            message = f"{above.removeprefix('mechanism.')} is fixed at {content}, it has no bounds"
            raise InputError(message, f"Name {above} itself, or free it", file, key, value)
        if above.startswith("limits.pressure_angle") and side == "max":
            return above, value
        content = [content, content]  # an equality becomes a range
    return above, _side(content, side, value)


def _side(pair: list[Any], side: str, value: object) -> list[Any]:
    return [value, *pair[1:]] if side == SIDES[0] else [*pair[:1], value]


def _fixed(path: tuple[str, ...]) -> bool:
    """Return whether the keys at a path are those of a section, not names defined by the file."""
    return path not in {
        ("mechanism", "ground"),
        ("mechanism", "links"),
        ("mechanism", "guides"),
        ("mechanism", "points"),
        ("bodies",),
        ("joints",),
        ("loads",),
        ("parts", "links"),
        ("parts", "joints"),
    }


# The problem with all design variables fixed at a given design: a machine for `analyze`, `simulate` and pictures.

DESIGN_SECTIONS = ("requirement", "requirements", "objective", "limits")
"""Sections of a design; without them a problem is a machine."""


def fixed_design(file: ProblemFile, values: Mapping[str, float], *, checked: bool = False) -> ProblemFile:
    """Return the machine of a problem with fixed quantities.

    Parameters
    ----------
    values : mapping of str to float [m, rad]
        Value of every quantity of the mechanism.
    checked : bool, optional
        Keep requirement, objective and limits, so that `optlink.validate` checks the design, with its angles in `values`.
    """
    file = file.override(file.located) if file.located else file  # a mode by the place of a joint is that of the start
    left_out = {"rounding", "expected", *(() if checked else DESIGN_SECTIONS)}
    raw: dict[str, Any] = copy.deepcopy(without(file.raw, *left_out))
    sizes = file.model.mechanism.quantities
    angles = {name: one for name, one in file.model.quantities.items() if checked and one.free and name not in sizes}
    for name, quantity in {**sizes, **angles}.items():
        number = values[name] / quantity.si_per_unit
        short = float(f"{number:.12g}")  # 53.5, not 53.50000000000001
        number = short if math.isclose(short, number, rel_tol=1e-15) else number
        text = f"{number!r} {quantity.display[1]}"
        if name in sizes:
            write(raw["mechanism"], name, text)
        else:
            _assign(raw, quantity_key(file.model, name), text, file.file)
    return file.with_tables(raw)


def started(machine: ProblemFile, begin: float, way: float, ends: tuple[float, float] | None = None) -> ProblemFile:
    """Return a machine with another start of its crank.

    Parameters
    ----------
    begin : float [rad]
        Crank angle at the start; the machine is returned unchanged if it is not finite.
    way : float
        The sign of the crank speed; 0 for that of the machine.
    ends : tuple of float [rad], optional
        The crank angles between which it swings, the start among them.
    """
    if not math.isfinite(begin):
        return machine
    speed = math.copysign(machine.model.driving.pace, way) if way else machine.model.driving.pace
    start = begin if ends or abs(begin) <= TURN else math.remainder(begin, TURN)  # counted as in tables and charts
    swing = {"drive.range": [f"{end!r} rad" for end in ends]} if ends else {}
    return machine.override({"drive.start": f"{start!r} rad", "drive.speed": f"{speed!r} rad/s", **swing})


def with_files_beside(file: ProblemFile) -> tuple[ProblemFile, dict[str, bytes]]:
    """Return the problem with every CSV or SVG file renamed to one beside it, and the contents of these files by name."""
    raw: dict[str, Any] = copy.deepcopy(dict(file.raw))
    files: dict[str, bytes] = {}
    for table, key, suffix in [*references(raw)]:
        source = table[key] if suffix else read_tolerance(table[key], file.folder).source
        name_in_file, content = split_enclosed(source)
        data, path = (content or file.files[name_in_file]).encode(), Path(name_in_file)
        stem, suffix_ = f"design-{path.stem[:60].lower()}", suffix or "csv"
        name, number = f"{stem}.{suffix_}", 1
        while files.get(name, data) != data:
            number += 1
            name = f"{stem}-{number}.{suffix_}"
        files[name], table[key] = data, name
    return replace(file, raw=raw), files
