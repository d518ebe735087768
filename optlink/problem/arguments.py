"""Types of the arguments of public functions, checked against their annotations before any work begins."""

import functools
import inspect
import types
import typing
from collections.abc import Callable, Mapping, Sequence
from dataclasses import is_dataclass
from pathlib import Path
from typing import Annotated, Any, ParamSpec, TypeVar

import numpy as np
import pydantic

from optlink.errors import OPTIONS_NAMED, Fault, InputError, nearest

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
    "is": ("not a problem", "Give what optlink.load returns, the name of a shipped problem, or the path of a file"),
}
"""Message and remedy by the first word of the type of pydantic's error."""


def typed(function: Callable[P, R]) -> Callable[P, R]:
    """Refuse unknown and missing arguments, and those that are not of the types of a function's annotations.

    Numbers of numpy are converted to those of Python. Errors name the arguments of functions, but options within a command.
    """
    signature = inspect.signature(function)

    @functools.cache
    def model() -> type[pydantic.BaseModel]:
        # the type of the result may be unknown here
        annotations = {name: text for name, text in function.__annotations__.items() if name != "return"}
        hints = typing.get_type_hints(types.SimpleNamespace(__annotations__=annotations), function.__globals__)
        given = {name: Annotated[hint, pydantic.Strict(False)] if hint == Path | None else hint for name, hint in hints.items()}
        for name, hint in given.items():
            if is_dataclass(hint):  # its fields are checked already
                given[name] = pydantic.InstanceOf[hint]  # type: ignore[misc, valid-type]
        fields: dict[str, Any] = {name: (hint, pydantic.Field()) for name, hint in given.items()}  # a path may be a text
        return pydantic.create_model("Arguments", __config__={"arbitrary_types_allowed": True, "strict": True}, **fields)

    @functools.wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> R:
        try:
            bound = signature.bind(*args, **kwargs)
        except TypeError:
            raise InputError(_faults_of_call(function.__name__, signature, args, kwargs)) from None
        bound.apply_defaults()
        arguments = {name: value.item() if isinstance(value, np.generic) else value for name, value in bound.arguments.items()}
        try:
            checked = model().model_validate(arguments)
        except pydantic.ValidationError as error:
            raise InputError(list({item["loc"][0]: _fault(item) for item in reversed(error.errors())}.values())[::-1]) from None
        bound.arguments.update(dict(checked))
        try:
            return function(*bound.args, **bound.kwargs)
        except InputError as error:
            if OPTIONS_NAMED.get():
                raise
            raise type(error)([fault.in_python() for fault in error.faults]).with_traceback(error.__traceback__) from None

    return call


def _faults_of_call(
    function: str, signature: inspect.Signature, args: Sequence[object], kwargs: Mapping[str, object]
) -> list[Fault]:
    """Return the faults of a call whose arguments are not those of the function: unknown, given twice, too many, or missing."""
    parameters = {name: parameter for name, parameter in signature.parameters.items() if name != "self"}
    names, count = list(parameters), len(args) - (len(parameters) < len(signature.parameters))
    places = sum(parameter.kind is not inspect.Parameter.KEYWORD_ONLY for parameter in parameters.values())
    remedy = f"Known: {', '.join(names)}"
    unknown = [
        Fault(f"unknown argument of {function}", nearest(name, names), key=name, value=value)
        for name, value in kwargs.items()
        if name not in parameters
    ]
    twice = [Fault(f"given twice to {function}", "Give it once", key=name) for name in names[:count] if name in kwargs]
    many = [Fault(f"{function} takes at most {places} arguments without a name", remedy)] if count > places else []
    missing = [
        Fault(f"{function} needs this argument", remedy, key=name)
        for name in names[count:]
        if name not in kwargs and parameters[name].default is inspect.Parameter.empty
    ]
    return [*unknown, *twice, *many] or missing


def _fault(item: Any) -> Fault:
    kind = item["type"].partition("_")[0]
    kind = item["ctx"]["class"].lower() if kind == "is" and item["ctx"]["class"] != "ProblemFile" else kind
    message, remedy = WRONG.get(kind, (item["msg"], "See the description of the function"))
    if message == WRONG["is"][0] and hasattr(item["input"], "problem"):
        remedy = "Of a result give its problem, or its machine, which has the dimensions of the design"
    if isinstance(item["input"], dict) and item["type"].startswith("string"):
        remedy = "Give one in quotes, or nested tables to optlink.read"
    steps = [str(step) for step in item["loc"] if step not in ("str", "float")]  # members of unions are not keys
    return Fault(message, remedy, key=".".join(step for step in steps if "[" not in step), value=item["input"])
