"""Identity of a problem: a hash of its parsed model with every number that was read from any file."""

import datetime
import enum
import hashlib
import json
from collections.abc import Collection, Mapping, Set
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np
from pydantic import BaseModel

from optlink.problem.machine.model import Problem

DIGITS = 16


def identity(model: Problem, without: Collection[str] = ()) -> str:
    """Return the hash of a model, `DIGITS` hexadecimal digits: two models with the same hash have the same results.

    The files of points, laws, loads and drives are in the fields of the model; measured deviations are read once the linkage is
    known, so they are added.

    Parameters
    ----------
    without : collection of str
        Sections that do not change the result.
    """
    sections = {name: getattr(model, name) for name in type(model).model_fields if name not in without}
    measured = {deviation.name: deviation.values for deviation in model.deviations}
    text = json.dumps(_content([type(model), sections, measured]), sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:DIGITS]


def _content(value: Any) -> Any:
    """Return a value as plain lists, tables, numbers and words, without keys that have no value.

    Of a dataclass the fields that are compared count: two values that are equal have the same content.
    """
    if value is None or isinstance(value, str | int | float):
        return value
    if isinstance(value, np.ndarray | np.generic):
        return [value.dtype.str, value.tolist()]
    if isinstance(value, list | tuple):
        return [_content(item) for item in value]
    if isinstance(value, Set):
        return sorted((_content(item) for item in value), key=json.dumps)
    if isinstance(value, Mapping):
        return {str(key): _content(item) for key, item in value.items() if item is not None}
    names = _fields(value)
    if names is not None:
        return [_name(type(value)), _content({name: getattr(value, name) for name in names})]
    if isinstance(value, enum.Enum):
        return _content(value.value)
    if isinstance(value, datetime.date | datetime.time):
        return value.isoformat()
    if hasattr(value, "__qualname__"):  # a class or function
        return _name(value)
    raise TypeError(f"{type(value).__qualname__} is not part of the identity of a problem: make it a dataclass or a Section")


def _fields(value: Any) -> list[str] | None:
    """Return the names of the fields of a model or dataclass, without its cached values; None for another object.

    Those of a model with keys of the user's choice include these.
    """
    if isinstance(value, BaseModel):
        return [*type(value).model_fields, *(value.__pydantic_extra__ or ())]
    return [item.name for item in fields(value) if item.compare] if is_dataclass(value) and not isinstance(value, type) else None


def _name(value: Any) -> str:
    """Return the name of a class or function; those of optlink may move to another module."""
    own = value.__module__.partition(".")[0] == __name__.partition(".")[0]
    return str(value.__qualname__) if own else f"{value.__module__}.{value.__qualname__}"
