"""Base models: tables of problem files, and records of results, which write themselves and are read with one check."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Mapping
from pathlib import Path
from typing import Annotated, Any

from pydantic import (
    AliasChoices,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    GetCoreSchemaHandler,
    ValidationInfo,
)
from pydantic.fields import FieldInfo
from pydantic_core import CoreSchema

from optlink.linkage.mechanism import FRAME
from optlink.problem.quantity import Unusable
from optlink.units import is_sweep, is_toleranced, split_range

NAME = "[A-Za-z][A-Za-z0-9_]{0,39}"
DEEPEST = 10
"""Greatest depth of tables at which a range can be written."""
RESERVED = (FRAME, "input", "energy", "stops")


def _strict(schema: Any) -> None:
    """Let whole numbers and truth values of a schema be written as such alone."""
    if isinstance(schema, dict):
        if schema.get("type") in ("int", "bool"):
            schema["strict"] = True
        for part in schema.values():
            _strict(part)
    elif isinstance(schema, list):
        for part in schema:
            _strict(part)


class Section(BaseModel):
    """A table of the problem file."""

    model_config = ConfigDict(extra="forbid", frozen=True, arbitrary_types_allowed=True, defer_build=True)  # most unused

    @classmethod
    def models(cls) -> dict[str, type[Section]]:
        """Return the models that read such a table, by the key that marks each; of most tables there is one."""
        return {"": cls}

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Return the schema of the fields, in which a text is neither a whole number nor true or false."""
        schema = handler(source)
        _strict(schema)
        return schema


def spellings(name: str, field: FieldInfo) -> list[str]:
    """Return the keys of a file that state a field, the usual one first."""
    also = field.validation_alias
    return [str(key) for key in also.choices] if isinstance(also, AliasChoices) else [name]


def folder_of(info: ValidationInfo) -> Path:
    """Return the folder of the problem file that is read; the working folder for a table that is not in a file."""
    return (info.context or {}).get("folder", Path())  # type: ignore[no-any-return]


class InFolder(BeforeValidator):
    """Annotation of a field whose value can be in another file."""


def in_folder(function: Callable[[object, Path], Any]) -> InFolder:
    """Return a reading function as the annotation of a field.

    Parameters
    ----------
    function : function of (raw value, folder to which the names of files are relative)
    """
    return InFolder(lambda raw, info: None if raw is None else function(raw, folder_of(info)))


LIMITED = {"stroke", "time_ratio"}
"""Keys of requirements whose ranges are limits, not bounds of a design variable."""


SPELLINGS = {
    "minimize": "minimise",
    "maximize": "maximise",
    "regularization": "regularisation",
    "outer dead center": "outer dead centre",
    "inner dead center": "inner dead centre",
}
"""American spellings of keys and values, with those of the documentation."""

SPELLED = ("balance", "control", "objective", "requirement", "requirements")
"""Sections whose keys have such spellings; the names in them are never the user's."""


ALSO_WRITTEN = {
    "requirement.from": "requirement.start",
    "requirement.start": "requirement.from",
    "drive.law": "drive.speed",  # over the angle
}
"""Keys with two spellings that are both documented."""


def written(key: str, raw: object) -> str:
    """Return a dotted key in the spelling that the tables of a file have; unchanged if they have none of the two."""
    head = ".".join(key.split(".")[:2])
    other = ALSO_WRITTEN.get(head)
    section, _, name = head.partition(".")
    table = raw.get(section) if isinstance(raw, Mapping) else None
    if other is None or not isinstance(table, Mapping) or name in table or other.partition(".")[2] not in table:
        return key
    return other + key[len(head) :]


class Ends(list[Any]):
    """The two ends of a range, with the text of the file that states them."""

    text = ""


def with_spellings(raw: Mapping[str, Any]) -> dict[str, Any]:
    """Replace American spellings of keys and values in the tables of a problem; a key that is there twice remains."""

    def one(table: Any) -> Any:
        if isinstance(table, list):
            return [one(item) for item in table]
        if not isinstance(table, Mapping):
            return table
        standard = {key: SPELLINGS.get(key, key) for key in table}
        renamed = {key: key if standard[key] != key and standard[key] in table else standard[key] for key in table}
        values = {
            key: SPELLINGS.get(item, item) if key in ("sense", "from", "start") and isinstance(item, str) else item
            for key, item in table.items()
        }
        return {renamed[key]: one(item) if key in ("terms", "objective") else item for key, item in values.items()}

    return {name: one(table) if name in SPELLED else table for name, table in raw.items()}


def with_ranges(raw: Any, path: tuple[str, ...] = (), skip: Collection[str] = ()) -> Any:
    """Write out ranges such as "40..140 deg" and values with a tolerance such as "100 deg +- 0.5 deg" in nested tables.

    Those of limits and bounds become lists of their two ends, those of other quantities of the mechanism and of the
    requirement bounds, all others (`LIMITED` too) and ranges with one side tables of min and max.

    Parameters
    ----------
    raw : object
        Tables, lists and values as read from a file.
    path : tuple of str
        Keys that lead to it.
    skip : collection of str
        Sections that are left as they are.

    Raises
    ------
    Unusable
        If a text is a range with a number of values, which only a sweep has.
    """
    if len(path) > DEEPEST or (path and path[0] in skip):
        return raw
    if isinstance(raw, Mapping):
        table = {key: with_ranges(item, (*path, str(key)), skip) for key, item in raw.items()}
        exactly = raw.get("exactly")
        if isinstance(exactly, str) and is_toleranced(exactly) and raw.keys().isdisjoint(("min", "max")):
            table |= split_range(exactly) or {}
            del table["exactly"]
        return table
    if isinstance(raw, list):
        return raw if isinstance(raw, Ends) else [with_ranges(item, (*path, ""), skip) for item in raw]
    if isinstance(raw, str) and is_sweep(raw):
        vary = f'{".".join(path)}="{raw}"'
        raise Unusable(
            "one value or a range is needed here", f"To try several: optlink study sweep FILE --vary {vary}", ".".join(path), raw
        )
    sides = split_range(raw) if isinstance(raw, str) else None
    if sides is None or path[-1] == "exactly":  # a tolerance there belongs to its table
        return raw
    ends = Ends(sides.values()) if len(sides) == 2 else None
    if ends is not None:
        ends.text = raw
    required = path[0] in ("requirement", "requirements")
    if path[-1] == "bounds" or (required and path[-1] == "x"):
        return ends or raw
    if path[0] == "mechanism" or (required and LIMITED.isdisjoint(path)):
        if ends and is_toleranced(raw):
            message, remedy = (
                "a tolerance is no range of a design variable",
                f'Write bounds = ["{ends[0]}", "{ends[1]}"], or the value alone',
            )
            raise Unusable(message, f"{remedy}: optlink study tolerance takes the tolerances of parts", ".".join(path), raw)
        return {"bounds": ends} if ends else raw
    return ends if ends and path[0] == "limits" else sides


def _read_name(raw: object) -> str:
    if not isinstance(raw, str) or not re.fullmatch(NAME, raw):
        raise Unusable("not a name", "Use letters, digits and _, beginning with a letter, for example link2", "", raw)
    return raw


Name = Annotated[str, BeforeValidator(_read_name)]
"""Of a body, a point, a guide or a load."""
Fact = Annotated[str, Field(max_length=200)]
"""A text that has no effect on the result."""
