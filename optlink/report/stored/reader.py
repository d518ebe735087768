"""Strict reader of JSON documents: every value is checked for presence and type."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from optlink.errors import Fault, InputError

Array = NDArray[np.float64]
AGAIN = "Write it again with --out"
LARGEST = 1e60  # bound on valid values; products of several of them do not overflow


class Record:
    """Object of a JSON document; `path` of the file and `where` in it are used in messages.

    Raises
    ------
    InputError
        By every reading method, if the key is missing or has a value of another type.
    """

    def __init__(self, document: Mapping[str, Any], path: Path, where: str = "") -> None:
        self.document, self.path, self.where = document, path, where

    def fault(self, key: str, message: str, value: object = None) -> InputError:
        """Return the error for a damaged value.

        Parameters
        ----------
        key : str
        message : str
            What is wrong.
        value : object, optional
            The value found.
        """
        return InputError(Fault(f"the result is damaged: {message}", AGAIN, str(self.path), self._key(key), value))

    def old(self, key: str, message: str) -> InputError:
        """Return the error for a value that an earlier version did not write.

        Parameters
        ----------
        key : str
        message : str
            What is missing.
        """
        return InputError(Fault(message, "Run the command again with --out", str(self.path), self._key(key)))

    def _key(self, key: str) -> str:
        return f"{self.where}.{key}" if self.where else key

    def has(self, key: str) -> bool:
        """Return whether a key exists and is not null."""
        return self.document.get(key) is not None

    def any(self, key: str) -> Any:
        """Return a value of any type, including null."""
        if key not in self.document:
            raise self.fault(key, "this is missing")
        return self.document[key]

    def _of(self, key: str, kind: type | tuple[type, ...], words: str) -> Any:
        found = self.any(key)
        if not isinstance(found, kind) or (isinstance(found, bool) and kind is not bool):
            raise self.fault(key, f"this is not {words}", None if isinstance(found, dict | list) else found)
        return found

    def text(self, key: str) -> str:
        """Return a string."""
        return str(self._of(key, str, "a text"))

    def flag(self, key: str) -> bool:
        """Return a boolean."""
        return bool(self._of(key, bool, "true or false"))

    def whole(self, key: str) -> int:
        """Return an integer."""
        found = int(self._of(key, int, "a whole number"))
        if abs(found) > LARGEST:
            raise self.fault(key, "this is too large")
        return found

    def number(self, key: str) -> float:
        """Return a finite number."""
        found = self._of(key, (int, float), "a number")
        if isinstance(found, float) and not math.isfinite(found):
            raise self.fault(key, "this is not finite", found)
        if abs(found) > LARGEST:
            raise self.fault(key, "this is too large", found)
        return float(found)

    def maybe(self, key: str) -> float:
        """Return a number, NaN for null."""
        return math.nan if self.any(key) is None else self.number(key)

    def numbers(self, key: str, count: int | None = None) -> Array:
        """Return an array of numbers, NaN for null.

        Parameters
        ----------
        key : str
        count : int or None, optional
            Required length.
        """
        found = self._of(key, list, "a list")
        if not all(one is None or (isinstance(one, int | float) and not isinstance(one, bool)) for one in found):
            raise self.fault(key, "this is not a list of numbers")
        if not all(one is None or abs(one) <= LARGEST for one in found):
            raise self.fault(key, "a number of it is not finite or too large")
        if count is not None and len(found) != count:
            raise self.fault(key, f"there are {len(found)} numbers where {count} belong")
        return np.array([math.nan if one is None else float(one) for one in found])

    def texts(self, key: str) -> tuple[str, ...]:
        """Return a list of strings."""
        found = self._of(key, list, "a list")
        if not all(isinstance(one, str) for one in found):
            raise self.fault(key, "this is not a list of texts")
        return tuple(found)

    def record(self, key: str) -> Record:
        """Return a nested object."""
        return Record(self._of(key, dict, "an object"), self.path, self._key(key))

    def records(self, key: str) -> list[Record]:
        """Return a list of objects."""
        found = self._of(key, list, "a list")
        if not all(isinstance(one, dict) for one in found):
            raise self.fault(key, "this is not a list of objects")
        return [Record(one, self.path, f"{self._key(key)}[{k}]") for k, one in enumerate(found)]

    def figures(self, key: str) -> dict[str, float]:
        """Return an object of numbers by name, NaN for null."""
        below = self.record(key)
        return {name: below.maybe(name) for name in below.document}

    def columns(self, key: str) -> dict[str, Array]:
        """Return a table: arrays of equal length by name."""
        below = self.record(key)
        found = {name: below.numbers(name) for name in below.document}
        if len({len(values) for values in found.values()}) > 1:
            raise self.fault(key, "its columns differ in length")
        return found

    def column(self, columns: Mapping[str, Array], name: str) -> Array:
        """Return a required column of a table.

        Parameters
        ----------
        columns : mapping of str to array (n,)
        name : str
        """
        if name not in columns:
            raise self.fault(f"columns.{name}", "this is missing")
        return columns[name]


def read(path: Path) -> Record:
    """Read a result file.

    Raises
    ------
    InputError
        If the file cannot be read or is not a JSON object.
    """
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        reason = getattr(error, "strerror", None) or "it is not a JSON document"
        remedy = "Give a result.json that --out wrote, the folder it is in, or a problem"
        raise InputError(Fault(f"cannot read a result: {reason}", remedy, str(path))) from None
    if not isinstance(found, dict):
        raise InputError(Fault("not a result of optlink", "Give a result.json that --out wrote", str(path)))
    return Record(found, path)
