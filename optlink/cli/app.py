"""Command line: registration of all commands, and the entry point.

Exit codes: those of `EXIT_CODES`, and 141: the output pipe is closed.
"""

import contextlib
import copy
import errno
import io
import os
import sys
from collections.abc import Sequence
from typing import Annotated, Any, TextIO, cast

import typer

from optlink.cli import report, show, simulate, solve, studio, study
from optlink.cli.command import COMMANDS, App
from optlink.cli.console import is_lost_output
from optlink.errors import visible
from optlink.execution import interrupts

CLOSED = 141
"""Exit code where the reader of a pipe has left: 128 and the number of SIGPIPE, as shells have it."""

COMPLETION = "_OPTLINK_COMPLETE"
"""Environment variable by which a shell asks for completions."""

EXIT_CODES = (
    "Exit codes: 0 done and valid; 1 not valid or not feasible; 2 invalid input; 3 solver failure; "
    "4 a fault of optlink; 130 interrupted."
)

app = App(
    name="optlink",
    help="Describe a planar linkage and its requirements; get a design that is optimised, verified and explained.",
    epilog=EXIT_CODES,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
app.command("list")(show.list_problems)
for command in (show.show, show.new, solve.solve, solve.validate, solve.analyze, solve.balance, simulate.simulate, report.report):
    app.command()(command)
app.command()(report.export)
app.command()(studio.studio)
app.add_typer(study.study, name="study")


def _version(requested: bool) -> None:
    if requested:
        from optlink import __version__

        print(f"optlink {__version__}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[bool, typer.Option("--version", callback=_version, is_eager=True, help="Show the version.")] = False,
) -> None:
    """Planar linkage design optimisation."""


class VisibleStream:
    """A stream that writes control characters visibly: texts of files and names do not steer the terminal.

    Tables and bars, which have escape sequences of their own, are written to `rich_proxied_file`; their texts are escaped before.
    """

    def __init__(self, stream: Any) -> None:
        self.rich_proxied_file = stream

    def write(self, text: str) -> int:
        """Write a text."""
        return int(self.rich_proxied_file.write(visible(text)))

    def __getattr__(self, name: str) -> Any:
        return getattr(self.rich_proxied_file, name)


def main() -> None:
    """Run the `optlink` command."""
    for name in ("stdin", "stdout", "stderr"):
        if getattr(sys, name) is None:  # closed by the caller: a file opened later must not take its number
            setattr(sys, name, open(os.devnull, "r+", encoding="utf-8"))  # noqa: SIM115
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")  # unsupported characters must not raise
    sys.stdout, sys.stderr = cast(TextIO, VisibleStream(sys.stdout)), cast(TextIO, VisibleStream(sys.stderr))
    sys.argv[1:] = rejoined(sys.argv[1:])
    interrupts.listen()
    output = sys.stdout
    try:
        try:
            command = typer.main.get_command(app if COMPLETION in os.environ else needed(app, sys.argv[1:]))
            command()  # not the Typer: it would replace the hook for exceptions
        finally:
            if sys.stdout is not output:  # typer has detected a closed pipe
                raise BrokenPipeError(errno.EPIPE, "the pipe is closed")
            output.flush()
    except KeyboardInterrupt:  # before the command began
        interrupts.leave()
    except SystemExit as end:
        if end.code == interrupts.EXIT_CODE:
            sys.stderr.flush()
            interrupts.leave()
        raise
    except OSError as error:
        if not is_lost_output(error):
            raise
        _discard(output)
        if error.errno == errno.EPIPE:
            _discard(sys.__stderr__)
            raise SystemExit(CLOSED) from None
        with contextlib.suppress(OSError):
            print(
                f"Error: cannot write the output: {error.strerror}. Choose another place for it", file=sys.__stderr__, flush=True
            )
        _discard(sys.__stderr__)
        raise SystemExit(2) from None


def needed(group: typer.Typer, words: Sequence[str]) -> typer.Typer:
    """Return a group with the command of `words` built, of the others names and summaries alone, as building takes time.

    `words` is the command line behind the name of the group; without a command, nothing is built.
    """
    first = COMMANDS.get(words[0], words[0]) if words else None
    short = copy.copy(group)
    short.registered_commands = [copy.copy(info) for info in group.registered_commands]
    short.registered_groups = [copy.copy(info) for info in group.registered_groups]
    for info in short.registered_commands:
        assert info.callback is not None
        info.name = info.name or info.callback.__name__.replace("_", "-")
        info.help = info.help or info.callback.__doc__
        if info.name != first:
            info.callback = lambda: None
    for part in short.registered_groups:
        assert part.typer_instance is not None
        part.typer_instance = needed(part.typer_instance, words[1:] if part.name == first else ())
    return short


def rejoined(arguments: list[str]) -> list[str]:
    """Return the arguments with each value in one piece where a shell has split it at blanks.

    A list or table continues up to its closing bracket (`--set limits.swing_angle=[40 deg, 140 deg]`), a number with its unit
    (`--speed 60 rpm`).
    """
    joined: list[str] = []
    for word in arguments:
        last = joined[-1] if joined else ""
        within = last.startswith("--") or (len(joined) > 1 and joined[-2].startswith("--"))
        if within and not word.startswith("--") and (_is_open(last) or _is_unit(last, word)):
            joined[-1] = f"{last} {word}"
        else:
            joined.append(word)
    return joined


def _is_open(text: str) -> bool:
    return ("=[" in text or "={" in text) and any(text.count(left) > text.count(right) for left, right in ("[]", "{}"))


def _is_unit(number: str, word: str) -> bool:
    unit, _, points = word.partition(":")  # "mm:101" ends the range of a sweep
    if not number[-1:].isdigit() or os.path.exists(word) or not (points or "0").isdigit():
        return False
    from optlink.units import is_unit

    return is_unit(unit)


def _discard(stream: TextIO | None) -> None:
    """Redirect a stream to the null device: Python flushes its buffer at exit."""
    if stream is not None:
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


if __name__ == "__main__":
    main()
