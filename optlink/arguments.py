"""Types of the arguments of public functions, checked against their annotations before any work begins."""

from __future__ import annotations

import functools
import inspect
import numbers
import os
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

from optlink.errors import Fault, InputError

P = ParamSpec("P")
R = TypeVar("R")

WRONG: dict[str, tuple[str, ...]] = {
    "int": ("not a whole number", "Give for example 20"),
    "float": ("not a number", "Give one in SI units, for example 0.5"),
    "bool": ("neither True nor False", "Give one of them"),
    "str": ("not a text", "Give one in quotes"),
    "Path": ("not a file or folder", 'Give its path, for example "out"'),
    "Sequence[str]": ("not a list of texts", "Give a list, also of one item"),
    "Mapping[str, float]": ("not a mapping of names to numbers", "Give SI values by name, for example result.design"),
    "Mapping[str, object]": ("not a mapping of names to values", 'Give for example {"mechanism.frame": "480 mm"}'),
    "Callable": ("not a function", "Give one, or leave it out"),
    "ProblemFile": ("not a problem", 'Load it: optlink.load("crank-rocker"), or optlink.load("mine.toml")'),
    "None": (),
}
"""What is wrong with a value that is not of a type, and the remedy, by the text of the annotation."""

SAME = {r"\bAny\b|\bArrayLike\b": "object", r"\blist\b": "Sequence", r"Callable\[.*\]": "Callable"}
"""Annotations that are checked as others are."""


def typed(function: Callable[P, R]) -> Callable[P, R]:
    """Refuse arguments of other types than the annotations of a function name, and convert numbers of numpy to those of Python.

    Parameters with an annotation that is not in `WRONG` are left as they are.
    """
    signature = inspect.signature(function)
    types = {name: _alternatives(str(parameter.annotation)) for name, parameter in signature.parameters.items()}

    @functools.wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> R:
        bound = signature.bind(*args, **kwargs)
        faults = []
        for name, value in bound.arguments.items():
            fitting = [found for kind in types[name] for found in _converted(value, kind)]
            if fitting:
                bound.arguments[name] = fitting[0]
            elif types[name]:
                message, remedy = WRONG[types[name][0]]
                faults.append(Fault(message, remedy, key=name, value=value))
        if faults:
            raise InputError(faults)
        return function(*bound.args, **bound.kwargs)

    return call


def _alternatives(annotation: str) -> list[str]:
    """Return the types of an annotation; none if one of them is unknown."""
    for pattern, other in SAME.items():
        annotation = re.sub(pattern, other, annotation)
    found = annotation.split(" | ")
    return found if set(found) <= set(WRONG) else []


def _converted(value: Any, kind: str) -> list[Any]:
    """Return a value as a type of an annotation; nothing if it is none of it."""
    boolean = type(value).__name__ in ("bool", "bool_")
    match kind:
        case "int" | "float":
            fits = isinstance(value, numbers.Real) and not boolean and (value % 1 == 0 if kind == "int" else value == value)
            return [int(value) if kind == "int" else float(value)] if fits else []
        case "bool":
            return [bool(value)] if boolean else []
        case "Path":
            return [Path(value)] if isinstance(value, str | os.PathLike) and str(value) else []
        case "Sequence[str]":
            fits = isinstance(value, Sequence) and not isinstance(value, str) and all(isinstance(item, str) for item in value)
        case "Mapping[str, float]" | "Mapping[str, object]":
            fits = isinstance(value, Mapping) and all(isinstance(name, str) for name in value)
            fits = fits and (kind.endswith("object]") or all(_converted(item, "float") for item in value.values()))
        case "ProblemFile":
            fits = type(value).__name__ == kind
        case "Callable":
            fits = callable(value)
        case _:
            fits = value is None if kind == "None" else isinstance(value, str)
    return [value] if fits else []
