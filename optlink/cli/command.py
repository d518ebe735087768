"""Commands and groups of the command line: further spellings of options and commands, which the help does not list."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any, TypeVar

import typer
from typer.core import TyperCommand, TyperGroup

Function = TypeVar("Function", bound=Callable[..., Any])

RENAMED = {"--output": ("--quantity", "--out")}
"""Former names of options, with the present ones; the first that a command has is meant."""

SPELLED = {"--minimize": ("--minimise",), "--analyse": ("--analyze",)}
"""Other spellings of options."""

COMMANDS = {"analyse": "analyze"}
"""Other spellings of commands."""


class Command(TyperCommand):
    """A command that also takes former names and other spellings of its options."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        for param in self.params:
            if getattr(param, "is_flag", False) and param.metavar is None:
                param.metavar = ""  # not <bool>: a flag has no value

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Replace other names of options, then parse.

        Parameters
        ----------
        ctx : typer.Context
        args : list of str
        """
        known = {name for param in self.params for name in param.opts}
        end = args.index("--") if "--" in args else len(args)
        return super().parse_args(ctx, [*(_present(word, known) for word in args[:end]), *args[end:]])


def _present(word: str, known: set[str]) -> str:
    """Return an option under its present name."""
    name, equals, value = word.partition("=")
    if name in known:
        return word
    for one in (*RENAMED.get(name, ()), *SPELLED.get(name, ())):
        if one in known:
            if name in RENAMED:
                print(f"Note: {name} is now called {one}", file=sys.stderr)
            return f"{one}{equals}{value}"
    return word


class Group(TyperGroup):
    """A group that also takes other spellings of its commands."""

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Return a command by its name or another spelling of it.

        Parameters
        ----------
        ctx : typer.Context
        cmd_name : str
        """
        return super().get_command(ctx, COMMANDS.get(cmd_name, cmd_name))


class App(typer.Typer):
    """An application or group of `Command`s."""

    def __init__(self, **options: Any) -> None:
        super().__init__(cls=Group, **options)

    def command(self, name: str | None = None, **options: Any) -> Callable[[Function], Function]:
        """Register a command.

        Parameters
        ----------
        name : str, optional
        **options
            As for `typer.Typer.command`.
        """
        return super().command(name, **{"cls": Command, **options})
