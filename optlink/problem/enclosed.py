"""Files to which a problem refers, CSV tables and SVG drawings, with their contents: read once, with the problem."""

import codecs
import copy
import datetime
import enum
import hashlib
import json
import re
from collections.abc import Collection, Iterator, Mapping, Set
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel

from optlink.problem.machine.loads import LoadSection
from optlink.problem.machine.model import Problem
from optlink.problem.quantity import Unusable
from optlink.problem.targets.target_points import decoded, enclosed, read_file, split_enclosed
from optlink.problem.tolerances import read_tolerance


def references(raw: Any, within: str = "") -> Iterator[tuple[dict[str, Any], str, str]]:
    """Yield tables and keys that name another file, with its suffix; "" for the value of a tolerance.

    `raw`: tables and lists of a problem file, of the section `within`.
    """
    if isinstance(raw, list):
        for value in raw:
            yield from references(value, within)
    for key, value in raw.items() if isinstance(raw, dict) else ():
        if isinstance(value, str):
            measured = within == "tolerances" and read_tolerance(value, Path()).measured
            if measured or key in ("csv", "svg"):
                yield raw, key, "" if measured else key
        else:
            yield from references(value, within or key)


def enclosing(raw: Mapping[str, Any], folder: Path, known: Mapping[str, str]) -> tuple[dict[str, Any], dict[str, str]]:
    """Return the tables of a problem with the contents of files in place of their names, and the contents by name.

    Files that are not `known` are read; one that cannot be read keeps its name, so that the reader of its key refuses it.
    """
    tables: dict[str, Any] = copy.deepcopy(dict(raw))
    contents: dict[str, str] = {}
    for table, key, suffix in [*references(tables)]:
        source = table[key] if suffix else read_tolerance(table[key], folder).source
        name, content = split_enclosed(source)
        if not content and name in known:
            content = known[name]
        elif not content:
            try:
                content = _text(read_file({suffix or "csv": name}, suffix or "csv", folder)[1])
            except (Unusable, ValueError):
                continue
        contents[name], table[key] = content, enclosed(name, content)
    return tables, contents


def _text(data: bytes) -> str:
    """Return the text of a file, with UTF-8 as the encoding that it declares; see `decoded`."""
    declared = re.match(rb"""\s*<\?xml[^>]*encoding=["']([\w.-]+)""", data)
    text = decoded(data, _known(declared[1].decode()) if declared else "latin-1")
    return re.sub(r"""(<\?xml[^>]*encoding=)["'][^"']*["']""", r'\1"UTF-8"', text, count=1)


def _known(encoding: str) -> str:
    """Return the name of an encoding, or "latin-1" for one that Python does not know."""
    try:
        return codecs.lookup(encoding).name
    except LookupError:
        return "latin-1"


# Identity of a problem: a hash of its parsed model with every number that was read from any file.

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
    sections = {name: getattr(model, name) for name in _stated(model) if name not in without}
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
        return [
            _name(LoadSection if isinstance(value, LoadSection) else type(value)),
            _content({name: getattr(value, name) for name in names}),
        ]
    if isinstance(value, enum.Enum):
        return _content(value.value)
    if isinstance(value, datetime.date | datetime.time):
        return value.isoformat()
    if hasattr(value, "__qualname__"):  # a class or function
        return _name(value)
    raise TypeError(f"{type(value).__qualname__} is not part of the identity of a problem: make it a dataclass or a Section")


def _stated(model: BaseModel) -> list[str]:
    """Return the names of the fields that have another value than their default: a key that is added later changes no hash."""
    fields = type(model).model_fields
    values = ((name, getattr(model, name), field.get_default(call_default_factory=True)) for name, field in fields.items())
    return [name for name, value, default in values if type(value) is not type(default) or value != default]


def _fields(value: Any) -> list[str] | None:
    """Return the names of the fields of a model or dataclass, without its cached values; None for another object.

    Those of a model with keys of the user's choice include these.
    """
    if isinstance(value, BaseModel):
        return [*_stated(value), *(value.__pydantic_extra__ or ())]
    return [item.name for item in fields(value) if item.compare] if is_dataclass(value) and not isinstance(value, type) else None


def _name(value: Any) -> str:
    """Return the name of a class or function; those of optlink may move to another module."""
    own = value.__module__.partition(".")[0] == __name__.partition(".")[0]
    return str(value.__qualname__) if own else f"{value.__module__}.{value.__qualname__}"
