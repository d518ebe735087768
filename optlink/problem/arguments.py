"""Types of the arguments of public functions, checked against their annotations before any work begins."""

from __future__ import annotations

import functools
import inspect
import types
import typing
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, ParamSpec, TypeVar

import numpy as np
import pydantic

from optlink.errors import Fault, InputError

P = ParamSpec("P")
R = TypeVar("R")

WRONG = {
    "int": ("not a whole number", "Give for example 20"),
    "float": ("not a number", "Give one in SI units, for example 0.5"),
    "bool": ("neither True nor False", "Give one of them"),
    "string": ("not a text", "Give one in quotes"),
    "path": ("not a file or folder", 'Give its path, for example "out"'),
    "sequence": ("not a list", "Give a list, also of one item"),
    "list": ("not a list", "Give a list, also of one item"),
    "mapping": ("not a mapping of names to values", "Give SI values by name, for example result.design"),
    "dict": ("not a mapping of names to values", "Give SI values by name, for example result.design"),
    "callable": ("not a function", "Give one, or leave it out"),
    "is": ("not a problem", 'Load it: optlink.load("crank-rocker"), or optlink.load("mine.toml")'),
}
"""What is wrong with a value, and the remedy, by the first word of the type of pydantic's error."""


def typed(function: Callable[P, R]) -> Callable[P, R]:
    """Refuse arguments that are not of the types of a function's annotations, and convert numbers of numpy to those of Python."""
    signature = inspect.signature(function)

    @functools.cache
    def model() -> type[pydantic.BaseModel]:
        annotations = {
            name: text for name, text in function.__annotations__.items() if name != "return"
        }  # it may be unknown here
        hints = typing.get_type_hints(types.SimpleNamespace(__annotations__=annotations), function.__globals__)
        fields: dict[str, Any] = {name: (_accepted(hint), pydantic.Field()) for name, hint in hints.items()}
        return pydantic.create_model("Arguments", __config__={"arbitrary_types_allowed": True, "strict": True}, **fields)

    @functools.wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> R:
        bound = signature.bind(*args, **kwargs)
        bound.apply_defaults()
        given = {name: value.item() if isinstance(value, np.generic) else value for name, value in bound.arguments.items()}
        try:
            checked = model().model_validate(given)
        except pydantic.ValidationError as error:
            raise InputError(list({item["loc"][0]: _fault(item) for item in reversed(error.errors())}.values())[::-1]) from None
        bound.arguments.update(dict(checked))
        return function(*bound.args, **bound.kwargs)

    return call


def _accepted(hint: Any) -> Any:
    """Return an annotation for the check: a path may be given as text."""
    return Annotated[hint, pydantic.Strict(False)] if hint == Path | None else hint


def _fault(item: Any) -> Fault:
    message, remedy = WRONG.get(item["type"].partition("_")[0], (item["msg"], "See the description of the function"))
    if isinstance(item["input"], dict) and item["type"].startswith("string"):
        remedy = "Give one in quotes, or nested tables to optlink.read"
    steps = [str(step) for step in item["loc"] if step not in ("str", "float")]  # members of unions are no keys
    return Fault(message, remedy, key=".".join(step for step in steps if "[" not in step), value=item["input"])
