"""Base models: tables of problem files, and records of results, which write themselves and are read with one check."""

import json
import math
import re
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import fields
from operator import attrgetter
from pathlib import Path
from types import FunctionType, NoneType
from typing import Annotated, Any, Literal, Self, TypeVar, get_args, get_origin

import numpy as np
from numpy.typing import NDArray
from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    PlainValidator,
    ValidationError,
    ValidationInfo,
    WithJsonSchema,
)
from pydantic.fields import FieldInfo

from optlink.errors import InputError
from optlink.io import finite
from optlink.linkage.mechanism import FRAME
from optlink.problem.quantity import Unusable
from optlink.units import split_range

_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,39}", re.ASCII)
DEEPEST = 10
"""Greatest depth of tables at which a range can be written."""
RESERVED = (FRAME, "input", "energy")


class Section(BaseModel):
    """A table of the problem file."""

    model_config = ConfigDict(extra="forbid", frozen=True, arbitrary_types_allowed=True, defer_build=True)  # most unused


def _folder_of(info: ValidationInfo) -> Path:
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
    return InFolder(lambda raw, info: None if raw is None else function(raw, _folder_of(info)))


LIMITED = (("requirement", "stroke"), ("requirement", "time_ratio"))
"""Keys outside the limits whose ranges are limits too, not bounds of a design variable."""


SPELLINGS = {
    "minimize": "minimise",
    "maximize": "maximise",
    "regularization": "regularisation",
    "outer dead center": "outer dead centre",
    "inner dead center": "inner dead centre",
}
"""American spellings of keys and values, with those of the documentation."""

SPELLED = ("balance", "control", "objective", "requirement")
"""Sections whose keys have such spellings; the names in them are never the user's."""


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
            key: SPELLINGS.get(item, item) if key in ("sense", "from") and isinstance(item, str) else item
            for key, item in table.items()
        }
        return {renamed[key]: one(item) if key == "terms" else item for key, item in values.items()}

    return {name: one(table) if name in SPELLED else table for name, table in raw.items()}


def with_ranges(raw: Any, path: tuple[str, ...] = (), skip: Collection[str] = ()) -> Any:
    """Write out ranges such as "40..140 deg" in nested tables.

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
    """
    if len(path) > DEEPEST or (path and path[0] in skip):
        return raw
    if isinstance(raw, Mapping):
        return {key: with_ranges(item, (*path, str(key)), skip) for key, item in raw.items()}
    if isinstance(raw, list):
        return raw if isinstance(raw, Ends) else [with_ranges(item, (*path, ""), skip) for item in raw]
    sides = split_range(raw) if isinstance(raw, str) else None
    if sides is None:
        return raw
    ends = Ends(sides.values()) if len(sides) == 2 else None
    if ends is not None:
        ends.text = raw
    if path[-1] == "bounds" or (path[0] == "requirement" and path[-1] == "x"):
        return ends or raw
    if path[0] in ("mechanism", "requirement") and path[:2] not in LIMITED:
        return {"bounds": ends} if ends else raw
    return ends if ends and path[0] == "limits" else sides


def _read_name(raw: object) -> str:
    if not isinstance(raw, str) or not _NAME.fullmatch(raw):
        raise Unusable("not a name", "Use letters, digits and _, beginning with a letter, for example link2", "", raw)
    return raw


Name = Annotated[str, BeforeValidator(_read_name)]
"""Of a body, a point, a guide or a load."""


AGAIN = "Write it again with --out"
LARGEST = 1e60  # bound on valid values; products of several of them do not overflow

R = TypeVar("R", bound="Record")
T = TypeVar("T")


class Contradiction(ValueError):
    """A value of a record that does not fit the others or the problem; `key` leads to it from where this is raised."""

    def __init__(self, key: str, message: str, value: object = None) -> None:
        super().__init__(message)
        self.key, self.value = key, value


def _array(value: Any) -> NDArray[np.float64]:
    if not isinstance(value, list) or not all(
        issubclass(kind, (int, float, NoneType)) and kind is not bool for kind in set(map(type, value))
    ):
        raise ValueError("this is not a list of numbers")
    return np.array(value, dtype=np.float64)  # None becomes NaN


def _rows(value: Any) -> NDArray[np.float64]:
    nested = isinstance(value, list) and bool(value) and all(isinstance(row, list) for row in value)
    return np.array([_array(row) for row in value]) if nested else _array(value)


def _equally_long(columns: dict[str, NDArray[np.float64]]) -> dict[str, NDArray[np.float64]]:
    if len({len(values) for values in columns.values()}) > 1:
        raise ValueError("its columns differ in length")
    return columns


_NUMBER: dict[str, Any] = {"anyOf": [{"type": "number"}, {"type": "null"}]}
Number = Annotated[float, BeforeValidator(lambda value: math.nan if value is None else value), WithJsonSchema(_NUMBER)]
"""A number, or null where it is not finite."""
Never = Annotated[float, BeforeValidator(lambda value: math.inf if value is None else value), WithJsonSchema(_NUMBER)]
"""A number, or null where it is infinite."""
_LIST = {"type": "array", "items": _NUMBER}
Column = Annotated[NDArray[np.float64], PlainValidator(_array), WithJsonSchema(_LIST)]
"""An array of numbers; null where one is not finite."""
Rows = Annotated[
    NDArray[np.float64], PlainValidator(_rows), WithJsonSchema({"anyOf": [_LIST, {"type": "array", "items": _LIST}]})
]
"""A column, or a table of equally long rows."""
Columns = Annotated[dict[str, Column], AfterValidator(_equally_long)]
"""A table: arrays of equal length by name."""


def check_length(values: Sequence[Any] | NDArray[Any], count: int, key: str) -> None:
    """Raise if a list has another length than another one.

    Parameters
    ----------
    key : str
        Key of the list.

    Raises
    ------
    Contradiction
        If it has not `count` entries.
    """
    if len(values) != count:
        raise Contradiction(key, f"expected {count} numbers, found {len(values)}")


def absent() -> Any:
    """Return the default of a key that is left out if it has no value."""
    return Field(None, exclude_if=lambda value: value is None)


def itself(result: T) -> T:
    """Return a result: the source of a field that has several of its values."""
    return result


class Record(BaseModel):
    """Part of a JSON document.

    A text in the annotation of a field is the attribute of the result that it comes from, a function returns its value for a
    result; a field with one possible value has that.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, serialize_by_alias=True, validate_by_name=True, defer_build=True)

    @classmethod
    def of(cls, result: Any, **values: Any) -> Self:
        """Return the record of a result.

        Parameters
        ----------
        result : object
            Its attributes are the values of the fields that are not given.
        **values
            Values of fields.
        """
        for name, field in cls.model_fields.items():
            if name not in values:
                values[name] = _source(name, field)(result)
            if (kind := _part(field.annotation)) is not None:
                values[name] = _records(kind, values[name])
        return cls.model_construct(**values)  # type: ignore[return-value]

    def build(self, kind: type[T], **values: Any) -> T:
        """Return a result, a dataclass, from the fields of this record that it has under the name of their source.

        Parameters
        ----------
        **values
            Values of its other attributes.
        """
        for name, field in type(self).model_fields.items():
            values.setdefault(next((text for text in field.metadata if isinstance(text, str)), name), getattr(self, name))
        return kind(**{field.name: values[field.name] for field in fields(kind) if field.name in values})  # type: ignore[arg-type]

    def document(self) -> dict[str, Any]:
        """Return the JSON document: SI, or the unit that ends the key; null where there is no finite value."""
        return finite(self.model_dump(warnings=False))  # type: ignore[no-any-return]


def _source(name: str, field: FieldInfo) -> Callable[[Any], Any]:
    """Return the function of a result that is the value of a field."""
    if get_origin(field.annotation) is Literal and len(choices := get_args(field.annotation)) == 1:
        return lambda _: choices[0]
    source = next((mark for mark in field.metadata if isinstance(mark, str | FunctionType)), name)
    return attrgetter(source) if isinstance(source, str) else source


def _part(annotation: Any) -> type[Record] | None:
    """Return the type of the records in a field, if it has any."""
    if isinstance(annotation, type) and issubclass(annotation, Record):
        return annotation
    return next(filter(None, map(_part, get_args(annotation))), None)


def _records(kind: type[Record], value: Any) -> Any:
    """Return the records of one part of a result, or of several in a tuple or a dictionary."""
    if value is None or isinstance(value, Record):
        return value
    if isinstance(value, Mapping):
        return {name: _records(kind, item) for name, item in value.items()}
    return tuple(_records(kind, item) for item in value) if type(value) in (list, tuple) else kind.of(value)


def read_document(path: Path) -> dict[str, Any]:
    """Read the JSON object of a result file.

    Raises
    ------
    InputError
        If the file cannot be read or is not a JSON object.
    """
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        reason = getattr(error, "strerror", None) or "it is not a JSON document"
        remedy = "Give a result.json that --out wrote, the folder it is in, or a problem"
        raise InputError(f"cannot read a result: {reason}", remedy, str(path)) from None
    if not isinstance(document, dict):
        raise InputError("not a result of optlink", "Give a result.json that --out wrote", str(path))
    return document


def read_record(kind: type[R], document: Mapping[str, Any], path: Path) -> R:
    """Read a document as a record.

    Parameters
    ----------
    path : Path
        File of the document.

    Raises
    ------
    InputError
        If a key is missing or unknown, or a value does not belong there.
    """
    _check_numbers(document, (), path)
    try:
        return kind.model_validate(document)
    except ValidationError as error:
        raise damaged(error, path) from None


def _check_numbers(values: Mapping[str, Any] | list[Any], place: tuple[str | int, ...], path: Path) -> None:
    """Refuse numbers that are not finite or too large, anywhere in a document."""
    for key, item in enumerate(values) if isinstance(values, list) else values.items():
        if isinstance(item, (float, int)):
            if not -LARGEST <= item <= LARGEST:
                raise _fault("this is not finite or too large", _key((*place, key)), item, path)
        elif isinstance(item, (dict, list)):
            _check_numbers(item, (*place, key), path)


WORDS = {
    "missing": "this is missing",
    "extra_forbidden": "no result has this key",
    "float": "this is not a number",
    "int": "this is not a whole number",
    "string": "this is not a text",
    "bool": "this is not true or false",
    "list": "this is not a list",
    "tuple": "this is not a list",
    "dict": "this is not an object",
    "model": "this is not an object",
    "dataclass": "this is not an object",
    "greater": "this is not above zero",
    "too": "it has another number of entries",
}
"""What a type of pydantic's errors, or its first word, says of a value."""


def damaged(error: ValidationError | Contradiction, path: Path) -> InputError:
    """Return the error for a record that does not pass its checks, in one sentence.

    Parameters
    ----------
    path : Path
        File of the record.
    """
    if isinstance(error, Contradiction):
        return _fault(str(error), error.key, error.value, path)
    first = error.errors()[0]
    cause, place, value = first.get("ctx", {}).get("error"), _key(first["loc"]), first["input"]
    if isinstance(cause, Contradiction):
        return _fault(str(cause), ".".join(filter(None, (place, cause.key))), cause.value, path)
    words = (
        getattr(cause, "message", str(cause))
        if cause is not None
        else WORDS.get(first["type"], WORDS.get(first["type"].partition("_")[0], ""))
    )
    return _fault(words or first["msg"][:1].lower() + first["msg"][1:], place, value, path)


def _fault(message: str, key: str, value: object, path: Path) -> InputError:
    displayed = None if isinstance(value, dict | list) else value
    return InputError(f"the result is damaged: {message}", AGAIN, str(path), key or None, displayed)


def _key(place: Sequence[str | int]) -> str:
    """Return the key of a place in a document, such as `points[2].gap`."""
    return "".join(f"[{step}]" if isinstance(step, int) else f".{step}" for step in place).removeprefix(".")
