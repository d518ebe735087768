"""Types of the arguments of public functions, checked against their annotations before any work begins."""

import functools
import inspect
import types
import typing
from collections.abc import Callable, Iterable
from dataclasses import is_dataclass
from pathlib import Path
from typing import Annotated, Any, ParamSpec, TypeVar

import numpy as np
import pydantic
from numpy.typing import ArrayLike

from optlink.errors import OPTIONS_NAMED, Fault, InputError
from optlink.linkage.arguments import bind

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
    "_buffer": ("not an array of numbers", "Give a list or an array of them, in SI units"),
    "axes": ("no axes of matplotlib", "Give one such as figure.add_subplot(), of several axes one: ax=axes[0]"),
    "is": ("not a problem", "Give what optlink.load returns, the name of a shipped problem, or the path of a file"),
}
"""Message and remedy by the first word of the type of pydantic's error."""


def typed(function: Callable[P, R]) -> Callable[P, R]:
    """Refuse unknown and missing arguments, and those that are not of the types of a function's annotations.

    Numbers of numpy are converted to those of Python. Errors name the arguments of functions, but options within a command.
    """
    signature, options = _with_options(function)

    @functools.cache
    def model() -> type[pydantic.BaseModel]:
        # the type of the result may be unknown here
        hints = _hints(function, (name for name in signature.parameters if name in function.__annotations__)) | options
        given = {name: Annotated[hint, pydantic.Strict(False)] if hint == Path | None else hint for name, hint in hints.items()}
        for name, hint in given.items():
            if is_dataclass(hint):  # its fields are checked already
                given[name] = pydantic.InstanceOf[hint]  # type: ignore[misc, valid-type]
        fields: dict[str, Any] = {
            name: (hint, pydantic.Field(default=None)) for name, hint in given.items()
        }  # a path may be a text
        return pydantic.create_model("Arguments", __config__={"arbitrary_types_allowed": True, "strict": True}, **fields)

    @functools.wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> R:
        bound = bind(function.__name__, signature, args, kwargs)
        absent = options.keys() - bound.arguments.keys()
        bound.apply_defaults()
        arguments = {name: value.item() if isinstance(value, np.generic) else value for name, value in bound.arguments.items()}
        for name in absent:  # their defaults are those of the functions that take them
            del arguments[name], bound.arguments[name]
        try:
            checked = model().model_validate(arguments)
        except pydantic.ValidationError as error:
            told: dict[Any, Any] = {}  # by argument the error of the type that it is most likely meant to have
            for item in error.errors():
                before = told.setdefault(item["loc"][0], item)
                told[item["loc"][0]] = max(before, item, key=lambda one: len(one["loc"]))
            raise InputError([_fault(item) for item in told.values()]) from None
        bound.arguments.update({name: value for name, value in checked if name in arguments})
        try:
            return function(*bound.args, **bound.kwargs)
        except InputError as error:
            if OPTIONS_NAMED.get():
                raise
            said = [fault.in_python(signature.parameters) for fault in error.faults]
            raise type(error)(said).with_traceback(error.__traceback__) from None

    vars(call)["__signature__"] = signature
    return call


def _hints(function: Callable[..., Any], names: Iterable[str]) -> dict[str, Any]:
    """Return the types of arguments of a function."""
    annotations = {name: function.__annotations__[name] for name in names}
    numbers = {"ArrayLike": ArrayLike | float}  # pydantic takes its complex for complex numbers alone
    return typing.get_type_hints(types.SimpleNamespace(__annotations__=annotations), function.__globals__, numbers)


DEFAULTS = {"engine": "local"}
"""Defaults of the options of `optlink.execution.options` other than None, for signatures."""


def _with_options(function: Callable[..., Any]) -> tuple[inspect.Signature, dict[str, Any]]:
    """Return the signature of a function with every option of a `**options: Unpack[...]`, and the types of these."""
    signature = inspect.signature(function)
    named = list(signature.parameters.values())
    if not named or named[-1].kind is not inspect.Parameter.VAR_KEYWORD:
        return signature, {}
    name = named.pop().name
    (dictionary,) = typing.get_args(_hints(function, [name])[name])
    options = typing.get_type_hints(dictionary)
    kind = inspect.Parameter.KEYWORD_ONLY
    more = [inspect.Parameter(key, kind, default=DEFAULTS.get(key), annotation=hint) for key, hint in options.items()]
    return signature.replace(parameters=[*named, *more]), options


def _fault(item: Any) -> Fault:
    kind = item["type"].partition("_")[0]
    kind = item["ctx"]["class"].lower() if kind == "is" and item["ctx"]["class"] != "ProblemFile" else kind
    message, remedy = WRONG.get(kind, (item["msg"], "See the description of the function"))
    if kind == "literal":
        message, remedy = "no such value", f"Known: {item['ctx']['expected']}"
    if kind == "dict" and hasattr(item["input"], "changes"):
        remedy = "Give its changes"
    if message == WRONG["is"][0] and hasattr(item["input"], "problem"):
        remedy = "Of a result give its problem, or its machine, which has the dimensions of the design"
    if isinstance(item["input"], dict) and item["type"].startswith("string"):
        remedy = "Give one in quotes, or nested tables to optlink.read"
    steps = [str(step) for step in item["loc"] if step not in ("str", "float")]  # members of unions are not keys
    return Fault(message, remedy, key=".".join(step for step in steps if "[" not in step), value=item["input"])
