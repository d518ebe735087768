"""Errors and result status, each with a remedy for the user.

    OptlinkError
    ├── InputError    the user's file, key or value is not usable; also a ValueError    exit code 2
    │   └── UnknownName   no part or column has this name; also a KeyError
    └── SolverError   unexpected breakdown of a solver                                  exit code 3

An infeasible problem or a design that fails its validation raises no exception: it is a result (`Status`). Any other exception is
a fault of optlink: exit code 4.
"""

from __future__ import annotations

import contextlib
import contextvars
import enum
import json
import re
from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

SHOWN = 80  # maximum number of characters shown of an invalid value


_UNSEEN = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069]")


def visible(text: str) -> str:
    """Return a text whose control characters, those of the direction of writing too, are written as in Python, such as \\x1b.

    Lines and tabs stay.
    """
    return _UNSEEN.sub(lambda match: ascii(match[0])[1:-1], text)


def on_one_line(text: str) -> str:
    """Return a text with visible control characters, ends of lines too."""
    return visible(text).replace("\n", "\\n")


def shown(value: object) -> str:
    """Format a value for a message: short, on one line."""
    if isinstance(value, int) and value.bit_length() > 256:  # Python refuses to print the largest ones
        return f"an integer of {value.bit_length():,} bits"
    text = f'"{value}"' if isinstance(value, str) else repr(value) if hasattr(value, "to_dict") else str(value)
    if isinstance(value, bool | list | dict):  # as in the file
        with contextlib.suppress(TypeError, ValueError, RecursionError):
            text = json.dumps(value, ensure_ascii=False, default=str)
    text = " ".join(text.split())
    return text if len(text) <= SHOWN else text[: SHOWN - 4] + " ..."


def extra_remedy(extra: str) -> str:
    """Return what to do where the packages of an extra are missing."""
    return f'Install the extra {extra}: pip install ".[{extra}]" in a checkout of optlink, or its wheel with [{extra}]'


@dataclass(frozen=True)
class Fault:
    """One error in the input: its place (file, key, value), the message and the remedy."""

    message: str
    remedy: str
    file: str | None = None
    key: str | None = None
    value: object = None

    def __str__(self) -> str:
        where = on_one_line(self.key or "")
        if where and self.value is not None:
            where += f" = {shown(self.value)}"
        return ": ".join(part for part in (on_one_line(self.file or ""), where, f"{self.message}. {self.remedy}") if part)

    def in_python(self, names: Collection[str] = ()) -> Fault:
        """Return the fault with the arguments of a function, some of whose `names` are those of options, in place of options."""
        message, remedy = (arguments_for_options(text, names) for text in (self.message, self.remedy))
        key = "problem" if self.key == "PROBLEM" else self.key
        if key is not None and key.startswith("--"):  # "--vary mechanism.frame" is vary.mechanism.frame
            key = arguments_for_options(key, names).replace(" ", ".", 1)
        return replace(self, message=message, remedy=remedy, key=key)


OPTIONS_NAMED = contextvars.ContextVar("options named", default=False)
"""Whether errors name the options of a command, not the arguments of the function that it calls."""

ARGUMENTS = {
    "allocate": "target_yield",
    "angles": "crank_angles",
    "cost": "costs",
    "column": "columns",
    "distribution": "shape",
    "out": "folder",
    "quantity": "output",
    "round": "rounding",
    "set": "overrides",
    "tolerance": "tolerances",
    "tune": "names",
}
"""Arguments of functions with another name than the option of the command."""

_OPTION = re.compile(
    r'(`[^`]*`)|(?<![\w-])--([a-z][a-z-]*)(?: (?:([a-z][\w.]*)=)?("[^"]*"|\d[\w.]*(?![\w=])|(?<!=)[A-Z][\w.]*(?![\w=])))?'
)


def arguments_for_options(text: str, names: Collection[str] = ()) -> str:
    """Replace the options of commands by arguments: `--time-limit` by time_limit; commands in backticks remain as they are.

    `names` of arguments that are those of options.
    """

    def argument(match: re.Match[str]) -> str:
        command, option, key, value = match.groups()
        if command:
            return command
        name = option.replace("-", "_")
        name = name if name in names else ARGUMENTS.get(option, name)
        return f'{name}={{"{key}": {value}}}' if key else f"{name}={value}" if value else name

    return _OPTION.sub(argument, text)


LIKE = 0.62
"""Least similarity of a name that an unknown one may mean: above that of difflib, 0.6, at which --resume suggests --set."""


def nearest(key: str, choices: Iterable[str], deeper: Sequence[str] = ()) -> str:
    """Return a remedy for an unknown name: the shortest that contain it, or else the closest one, and all known ones.

    `deeper` are full names that end with it, which are meant rather than others.
    """
    import difflib

    names, quoted = list(choices), '"{}"'.format
    same = [name for name in names if name.lower() == key.lower()]
    inside = sorted((name for name in names if len(key) > 2 and key in name), key=len)
    close = same or deeper or inside or difflib.get_close_matches(key, names, n=1, cutoff=LIKE)
    guess = f"Did you mean {' or '.join(map(quoted, close[:3]))}? " if close else ""
    return f"{guess}Known: {', '.join(quoted(name) if ',' in name else name for name in names)}"


class InvalidValue(ValueError):
    """A value that cannot be used: `message`, `remedy`, and the faulty `key` below that of the reader, with its `value`."""

    def __init__(self, message: str, remedy: str, key: str = "", value: object = None) -> None:
        super().__init__(f"{message}. {remedy}")
        self.message, self.remedy, self.key, self.value = message, remedy, key, value


class OptlinkError(Exception):
    """Base class of all errors that optlink raises intentionally."""

    exit_code = 3


class InputError(OptlinkError, ValueError):
    """The input is not usable, also a `ValueError`; `faults` has one entry for each error to correct.

    Parameters
    ----------
    faults : str, Fault or sequence of Fault
        The faults, or the message of the only one.
    *place
        Of a message: remedy, file, key and value, as in `Fault`.
    **named
        The same by name.
    """

    exit_code = 2

    def __init__(self, faults: str | Fault | Sequence[Fault], *place: Any, **named: Any) -> None:
        entries = Fault(faults, *place, **named) if isinstance(faults, str) else faults
        self.faults: tuple[Fault, ...] = (entries,) if isinstance(entries, Fault) else tuple(entries)
        super().__init__("\n".join(str(fault) for fault in self.faults))

    def __reduce__(self) -> tuple[type[InputError], tuple[tuple[Fault, ...]]]:
        """Return what copies and pickles are made from."""
        return type(self), (self.faults,)


@contextlib.contextmanager
def given_as(file: str | None, key: str, value: object) -> Iterator[None]:
    """Raise an error of what was made of an option as one of this key and value.

    Raises
    ------
    InputError
    """
    try:
        yield
    except InputError as error:
        fault = error.faults[0]
        raise InputError(fault.message, fault.remedy, file, key, value) from None


class UnknownName(InputError, KeyError):
    """A name that nothing has: of a point, a body, a column, a dimension."""

    __str__ = Exception.__str__  # that of KeyError would quote the sentence


class SolverError(OptlinkError):
    """A solver broke down without returning a usable point."""

    exit_code = 3


class Status(enum.StrEnum):
    """Status of an optimisation; `text` describes it and the next step."""

    OPTIMAL = "optimal"
    RELAXED = "relaxed"
    STALLED = "stalled"
    INFEASIBLE = "infeasible"
    NON_FINITE = "non-finite"
    FEASIBLE = "feasible"
    ROUNDED = "rounded"
    NOT_SEARCHED = "not searched"

    @property
    def text(self) -> str:
        """Description in one sentence."""
        return _STATUS_TEXT[self]


_STATUS_TEXT = {
    Status.OPTIMAL: "a local optimum: feasible, and no small change of the design improves the objective",
    Status.RELAXED: "a design near the proven bound, which no design was found to reach",
    Status.STALLED: "the search stopped at a feasible design that is not an optimum; try another start, or 20 starts",
    Status.INFEASIBLE: "no design was found that meets all limits",
    Status.NON_FINITE: "the objective or a limit has no finite value or derivative at the design found; "
    "try another start or tighter bounds",
    Status.ROUNDED: "a design with sizes on a grid, near an optimum without rounding",
    Status.FEASIBLE: "a design that meets all limits but is not a local optimum: no local search from it ended at a better one; "
    "try more starts",
    Status.NOT_SEARCHED: "the given design was checked, not optimised",
}
