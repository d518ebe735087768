"""What every command shares: errors become messages, results tables or JSON; bars, units of options, places for files."""

from __future__ import annotations

import contextlib
import importlib
import json
import os
import sys
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from optlink.errors import Fault, InputError, OptlinkError, shown
from optlink.solvers import interrupts

if TYPE_CHECKING:
    from optlink.problem.file import ProblemFile


printed = False  # whether the one JSON document is out
_kept: list[contextlib.ExitStack] = []  # what the command at work keeps until its end


# --- what is told ------------------------------------------------------------------------------------------------------------


@contextlib.contextmanager
def reported(as_json: bool) -> Iterator[None]:
    """Turn an error that optlink raises on purpose into a message on standard error (and JSON, if asked) and its exit code.

    An interrupted command ends with the exit code 130, also where it has shown what was complete.
    """
    try:
        with contextlib.ExitStack() as stack:
            _kept.append(stack)
            try:
                yield
            finally:
                _kept.remove(stack)
    except KeyboardInterrupt:
        message = "interrupted before there was a result"
        print(f"Error: {message}", file=sys.stderr)
        if as_json and not printed:
            print_failure(message, [])
        raise typer.Exit(interrupts.EXIT_CODE) from None
    except typer.Exit as end:
        raise typer.Exit(interrupts.EXIT_CODE if interrupts.interrupted() else end.exit_code) from None
    except OptlinkError as error:
        faults = error.faults if isinstance(error, InputError) else ()
        for line in [str(fault) for fault in faults] or [str(error)]:
            print(f"Error: {line}", file=sys.stderr)
        if as_json:
            listed = [
                {key: item if item is None or isinstance(item, str) else shown(item) for key, item in vars(fault).items()}
                for fault in faults
            ]
            print_failure(str(error), listed)
        raise typer.Exit(error.exit_code) from None
    if interrupts.interrupted():
        raise typer.Exit(interrupts.EXIT_CODE)


def print_json(document: dict[str, Any]) -> None:
    """Print the one JSON document of a command."""
    global printed  # noqa: PLW0603
    printed = True
    print(json.dumps(document, indent=2))


def print_failure(message: str, faults: list[dict[str, Any]]) -> None:
    """Print why there is no result, as JSON."""
    print_json({"schema": "optlink/error/1", "status": "error", "message": message, "faults": faults})


def told(result: Any, table: str, files: str, csv: Path | None, as_json: bool, out: Path | None) -> None:
    """Write a result where it is wanted, and show it as JSON or as a table.

    `table` is the function that shows it and `files` the module whose `write_all` writes its pictures, both of the report.
    """
    if csv is not None:
        from optlink.report.files import write_csv

        write_csv(csv, result.columns)
    if out is not None and interrupts.interrupted():
        from optlink.io import write_json

        write_json(out / "result.json", {**result.to_dict(), "interrupted": True})
        print(f"Interrupted: {out} has result.json alone, no pictures", file=sys.stderr)
    elif out is not None:
        with working(f"Drawing into {out}"):
            importlib.import_module(f"optlink.report.{files}").write_all(result, out)
    if as_json:
        print_json(result.to_dict())
    else:
        from optlink.report.views import function_tables

        room, _, name = table.rpartition(".")
        function_tables.console().print(getattr(importlib.import_module(f"optlink.report.{room}"), name)(result))


# --- while it works ----------------------------------------------------------------------------------------------------------


@contextlib.contextmanager
def working(what: str) -> Iterator[None]:
    """Say on standard error what is going on, where nobody knows how long it takes."""
    from optlink.report.views import function_tables

    with function_tables.console(stderr=True).status(what):
        yield


@contextlib.contextmanager
def share(what: str) -> Iterator[Callable[[float], None] | None]:
    """A bar with the share done and the time left on standard error; None where that is no terminal.

    The bar appears with the first share below 1: work of a single step shows none.
    """
    if not sys.stderr.isatty():
        yield None
        return
    with contextlib.ExitStack() as stack:
        shown: list[Callable[[float], None]] = []

        def advance(done: float) -> None:
            if not shown and done < 1.0:
                shown.append(stack.enter_context(_bar(what)))
            for update in shown:
                update(done)

        yield advance


@contextlib.contextmanager
def _bar(what: str) -> Iterator[Callable[[float], None]]:
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    from optlink.report.views import function_tables

    columns = (TextColumn(what), BarColumn(), TextColumn("{task.percentage:>3.0f} %"), TimeRemainingColumn())
    with Progress(*columns, console=function_tables.console(stderr=True), transient=True) as bar:
        task = bar.add_task(what, total=1.0)
        yield lambda done: bar.update(task, completed=done)


# --- what is given -----------------------------------------------------------------------------------------------------------


def load(problem: str, changes: list[str] | None) -> ProblemFile:
    """Load a problem with the changes of `--set`."""
    from optlink.problem.file import load as read
    from optlink.problem.file import parse_assignment

    return read(problem, dict(parse_assignment(text) for text in changes or []))


def given(file: ProblemFile, design: list[str] | None) -> dict[str, float] | None:
    """The design of `--design` [SI]; None if there is none."""
    if not design:
        return None
    from optlink.tasks.function import read_design

    return read_design(file, design)


def quantity(text: str | None, kind: str, option: str) -> float | None:
    """An option that is a number with a unit [SI]."""
    if text is None:
        return None
    from optlink.units import UnitProblem, parse

    try:
        return parse(text, kind)[0]
    except UnitProblem as error:
        raise InputError(Fault(error.message, error.remedy, key=option, value=text)) from None


def refuse(options: Mapping[str, object], message: str, remedy: str, file: str | None = None) -> None:
    """Refuse the first of these options that is given: it would do nothing here."""
    for option, value in options.items():
        if value is not None and value is not False:
            raise InputError(Fault(message, remedy, file, option, None if value is True else str(value)))


# --- where it goes -----------------------------------------------------------------------------------------------------------


def places(csv: Path | None, out: Path | None, command: str, problem: str) -> None:
    """Make sure that results can be written before any work is done, and keep their folder until the command ends.

    Parameters
    ----------
    csv, out : Path, optional
    command : str
    problem : str
        Name of the problem, or its file.

    Raises
    ------
    InputError
        where nothing can be written, or the folder holds or takes the results of something else.
    """
    _table(csv)
    if out is not None:
        kept(out, command, problem)
    if csv is not None:
        from optlink.io import folder

        folder(csv.parent, "--csv")


def _table(csv: Path | None) -> None:
    if csv is not None and csv.is_dir():
        remedy = "Give the name of a file, for example motion.csv"
        raise InputError(Fault("this is a folder", remedy, key="--csv", value=str(csv)))


def kept(out: Path, command: str, problem: str) -> None:
    """Make a folder and keep it for this command until that ends; see `optlink.cli.run_folder`."""
    from optlink.cli.run_folder import run_folder
    from optlink.io import folder

    _no_study(out)
    folder(out)
    _kept[-1].enter_context(run_folder(out, command, problem))


def kept_for_study(out: Path, command: str, problem: str) -> None:
    """Keep a folder that exists for a study until the command ends; it may hold the study that is to be resumed."""
    from optlink.cli.run_folder import check_owner
    from optlink.io import locked

    _kept[-1].enter_context(locked(out))
    check_owner(out, command, problem)


def _no_study(out: Path) -> None:
    """Refuse a folder that holds a sweep or a front: its table would stay beside the result of something else."""
    from optlink.studies.store import ABOUT

    place = out / ABOUT
    if not os.path.lexists(place):
        return
    try:
        about = json.loads(place.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        about = None
    problem = about.get("problem") if isinstance(about, dict) else None
    whose = f" of {problem}" if isinstance(problem, str) else ""
    what = "a front" if isinstance(about, dict) and "objectives" in about else "a sweep"
    message = f"the folder holds {what}{whose}, and takes no other result"
    raise InputError(Fault(message, "Choose another folder; nothing was overwritten", str(out), "--out"))


@contextlib.contextmanager
def made(out: Path | None, command: str, problem: str) -> Iterator[None]:
    """The folder of the results, kept for this command; gone again where it is new and the input is refused."""
    if out is None:
        yield
        return
    from optlink.cli.run_folder import run_folder
    from optlink.io import folder

    new = [place for place in (out, *out.parents) if not place.exists()]
    _no_study(out)
    folder(out)
    try:
        with run_folder(out, command, problem):
            yield
    except InputError:
        for place in new:
            with contextlib.suppress(OSError):
                place.rmdir()
        raise
