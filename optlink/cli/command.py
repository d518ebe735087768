"""Commands and groups of the command line: further spellings of options and commands, and one sentence for each mistake."""

import re
import sys
from collections.abc import Callable
from typing import Any, TypeVar, cast

import typer
from typer.core import TyperCommand, TyperGroup

from optlink.cli.console import reported
from optlink.errors import LIKE, InputError

Function = TypeVar("Function", bound=Callable[..., Any])

SPELLED = {"--minimize": "--minimise", "--analyse": "--analyze"}
"""Other spellings of options."""

COMMANDS = {"analyse": "analyze"}
"""Other spellings of commands."""


class Command(TyperCommand):
    """A command that also takes other spellings of its options."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        for param in self.params:
            if getattr(param, "is_flag", False) and param.metavar is None:
                param.metavar = ""  # not <bool>: a flag has no value

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Replace other spellings of options, then parse; an option with an empty value is refused: Path("") is this folder.

        Raises
        ------
        typer.BadParameter
            If the value of an option is empty.
        """
        options = {name for param in self.params for name in param.opts}
        end = args.index("--") if "--" in args else len(args)
        words = [*(_spelled(word, options) for word in args[:end]), *args[end:]]
        try:
            rest = super().parse_args(ctx, words.copy())
        except UsageError as error:
            error.ctx = error.ctx or ctx  # an option without its value does not say of which command
            raise
        values, _, _ = self.make_parser(ctx).parse_args(words)  # before they are converted
        for param in self.params:
            if param.param_type_name == "option" and isinstance(text := values.get(param.name), str):
                if not text.strip():
                    raise typer.BadParameter("the value is empty. Give one or leave the option out", ctx, cast(Any, param))
                option = max(param.opts, key=len)
                ctx.meta.update(dict.fromkeys((param.name, *param.opts), (option, text)))
        return rest

    def collect_usage_pieces(self, ctx: Any) -> list[str]:
        """Return the names of arguments as they are, without braces."""
        return [piece.strip("{}") for piece in super().collect_usage_pieces(ctx)]

    def get_short_help_str(self, limit: int = 0) -> str:
        """Return the whole summary for the overview, whatever the limit."""
        return " ".join((self.help or "").split())

    def invoke(self, ctx: Any) -> Any:
        """Run the command, and report errors."""
        with reported(bool(ctx.params.get("as_json")), ctx.meta):
            return super().invoke(ctx)


def _spelled(word: str, options: set[str]) -> str:
    """Return an option in the spelling of the command."""
    name, equals, value = word.partition("=")
    return f"{SPELLED[name]}{equals}{value}" if SPELLED.get(name) in options else word


class Group(TyperGroup):
    """A group that also takes other spellings of its commands."""

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Return a command by its name or another spelling of it."""
        return super().get_command(ctx, COMMANDS.get(cmd_name, cmd_name))

    get_short_help_str = Command.get_short_help_str

    def main(self, *arguments: Any, **options: Any) -> Any:
        """Run the command line; one that cannot be used is reported as other invalid input is."""
        words = next(iter(arguments), None) or options.get("args") or sys.argv[1:]
        try:
            with reported("--json" in words):
                try:
                    code = super().main(*arguments, **options | {"standalone_mode": False})
                except UsageError as error:
                    raise _failure(error) from None
        except typer.Exit as end:
            code = end.exit_code
        sys.exit(code if isinstance(code, int) else 0)


UsageError: type[Any] = typer.BadParameter.__bases__[0]  # of click, or of typer's own copy of it
"""A command line that cannot be used."""


def _failure(error: Any) -> BaseException:
    """Return what is wrong with a command line, with the remedy."""
    param, context = getattr(error, "param", None), error.ctx
    if type(error).__name__ == "NoArgsIsHelpError":
        print(context.get_help())
        return typer.Exit(error.exit_code)
    if not error.message and param is None:
        return typer.Exit(error.exit_code)  # the help was shown, since there were no arguments
    command = context.command_path if context else "optlink"
    remedy = f"`{command} --help` lists its options"
    message, _, better = error.message.rstrip(".").partition(". ")
    if param is not None:
        argument = param.param_type_name == "argument"
        key = (param.metavar or param.name.upper()) if argument else max(param.opts, key=len)
        if not message and not argument:
            message, better = "this option is required", f"Add {key} {param.metavar}"
        return InputError(message or "the argument is missing", better or remedy, command, key)
    option = getattr(error, "option_name", None)
    message = message[:1].lower() + message[1:].removesuffix(f": {option}").replace(f" '{option}'", "")
    return InputError(message, _meant(error, message) or better or remedy, command, option)


def _meant(error: Any, message: str) -> str:
    """Return a remedy that names the command, option or form that is meant, if one is recognised."""
    if unknown := re.fullmatch("no such command '(.*)'", message):
        inner = [name for name, group in error.ctx.command.commands.items() if unknown[1] in getattr(group, "commands", ())]
        meant = "solve" if unknown[1].endswith(".toml") else next(iter(inner), "")
        return f"Did you mean '{meant} {unknown[1]}'?" if meant else ""
    if extra := re.fullmatch(r"got unexpected extra arguments?(?:\(s\))? \((.*)\)", message):
        key, equals, value = extra[1].partition("=")
        if equals:
            return f'Write --set {key}="{value}"'
        return 'Write key and value in one, --set mechanism.frame="480 mm"' if re.match(r"[-+.\d]", extra[1]) else ""
    import difflib

    option, possible = getattr(error, "option_name", None) or "", getattr(error, "possibilities", None) or ()
    like = sorted(name for name in possible if difflib.SequenceMatcher(None, name, option).ratio() >= LIKE)
    return f"Did you mean {' or '.join(like)}?" if like else ""


class App(typer.Typer):
    """An application or group of `Command`s."""

    def __init__(self, **options: Any) -> None:
        super().__init__(cls=Group, rich_markup_mode=None, **options)  # its tables cut words on a narrow terminal

    def command(self, name: str | None = None, **options: Any) -> Callable[[Function], Function]:
        """Register a command with the options of `typer.Typer.command`."""
        return super().command(name, **{"cls": Command, **options})
