"""Common functions of the commands: error messages, tables or JSON, progress bars, units of options, output folders."""

from __future__ import annotations

import contextlib
import errno
import json
import os
import sys
import warnings
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from optlink.cli import FAULT, traced
from optlink.errors import OPTIONS_NAMED, Fault, InputError, OptlinkError, shown, visible
from optlink.execution import interrupts
from optlink.io import check_link, check_sum, folder, locked, read_object, write_json, written_files

if TYPE_CHECKING:
    from rich.progress import Progress, ProgressColumn, TaskID

    from optlink.presentation.table_spec import Summary, TableSpec
    from optlink.problem.file import ProblemFile


quiet = False  # whether only the verdict and errors are printed
pictures = "png"  # format of the pictures of --out
film = False  # whether --out has an animation
printed = False  # whether the JSON document is printed
_kept: list[contextlib.ExitStack] = []  # contexts held until the command ends

FAILED = ("stalled", "non-finite")  # words of a status for which a solver or an integrator is the reason
NO_OUTPUT = (errno.EPIPE, errno.ENOSPC, errno.EIO, errno.EFBIG)
"""Errors that make standard output or standard error unusable."""


# --- output ------------------------------------------------------------------------------------------------------------------


@contextlib.contextmanager
def reported(as_json: bool, options: Mapping[str, tuple[str, str]] | None = None) -> Iterator[None]:
    """Print an error as a message on standard error (and as JSON on request), and exit with its code.

    An interrupted command ends with the exit code 130, also if it has shown complete results. Errors of the output streams are
    passed on. `options` gives, by the parameter that a library function names, the option and its value as typed.
    """
    global printed  # noqa: PLW0603
    printed = bool(_kept) and printed
    try:
        with contextlib.ExitStack() as stack:
            _kept.append(stack)
            stack.callback(OPTIONS_NAMED.reset, OPTIONS_NAMED.set(True))
            try:
                yield
            finally:
                _kept.remove(stack)
    except typer.Exit as end:
        raise typer.Exit(interrupts.EXIT_CODE if interrupts.interrupted() else end.exit_code) from None
    except OptlinkError as error:
        faults = [_as_typed(fault, options or {}) for fault in error.faults] if isinstance(error, InputError) else []
        lines = [str(fault) for fault in faults] or [str(error)]
        for line in lines:
            print(f"Error: {line}", file=sys.stderr)
        if as_json:
            entries = [
                {key: item if item is None or isinstance(item, str) else shown(item) for key, item in vars(fault).items()}
                for fault in faults
            ]
            print_failure("\n".join(lines), entries)
        raise typer.Exit(error.exit_code) from None
    except (Exception, KeyboardInterrupt) as error:
        if interrupts.interrupted() or isinstance(error, KeyboardInterrupt):
            interrupts.handled()  # other errors follow from it, as those of a module that was not loaded to its end
            message, code = "interrupted before there was a result", interrupts.EXIT_CODE
        elif is_lost_output(error):
            raise
        else:
            message, code = _as_fault(error), FAULT
        print(f"Error: {message}", file=sys.stderr)
        if as_json and not printed:
            print_failure(message, [])
        raise typer.Exit(code) from None
    if interrupts.interrupted():
        raise typer.Exit(interrupts.EXIT_CODE)


def is_lost_output(error: BaseException) -> bool:
    """Return whether standard output or standard error cannot be written."""
    return isinstance(error, OSError) and error.filename is None and error.errno in NO_OUTPUT


def _as_fault(error: BaseException) -> str:
    """Return the message of an unexpected exception; its traceback is printed on request."""
    report = traced(error)
    what = ": ".join(text for text in (type(error).__name__, shown(error)) if text)
    return f"unexpected {what}. This is a fault of optlink, please report it with the command and its files; {report}"


OPTIONS = {"rows": "points"}
"""Options with another name than the argument of the function that refuses them."""


def _as_typed(fault: Fault, options: Mapping[str, tuple[str, str]]) -> Fault:
    """Return a fault with the option that it is about, and its value, as typed."""
    key = OPTIONS.get(fault.key or "", fault.key or "")
    if key not in options or (fault.file is not None and not key.startswith("-")):  # a key of the file
        return fault
    option, text = options[key]
    return replace(fault, key=option, value=None if fault.value is None else text)


def print_json(document: dict[str, Any]) -> None:
    """Print the single JSON document of a command."""
    global printed  # noqa: PLW0603
    printed = True
    print(json.dumps(document, indent=2))


def print_failure(message: str, faults: list[dict[str, Any]]) -> None:
    """Print a failure as JSON, with the fields of each `Fault`."""
    print_json({"schema": "optlink/error/1", "status": "error", "message": message, "faults": faults})


def deliver(
    result: Any,
    as_json: bool,
    out: Path | None,
    csv: Path | None = None,
    *,
    details: bool = True,
    state: str = "",
) -> None:
    """Write result files, print JSON or a table, and exit with code 1 unless the result is valid, 3 if a solver failed.

    After an interrupt the folder gets result.json only. Without `details` a design is printed as its short text. `state` is the
    file in the folder from which the run can be resumed: it is removed when all files are written.
    """
    from optlink.presentation.registry import table_of, view_of

    if csv is not None:
        from optlink.presentation.files import write_csv

        write_csv(csv, result.columns)
    lacking = "contains result.json, but no pictures" if interrupts.interrupted() else ""
    if out is not None and not lacking:
        try:
            with noted_letters(), working(f"Drawing into {out}"):
                view_of(result.kind).write(result, out, pictures, film=film)
            if state:
                (out / state).unlink(missing_ok=True)
        except KeyboardInterrupt:
            interrupts.handled()
            lacking = "contains result.json, but not all pictures"
    if out is not None and lacking:
        from optlink.presentation.files import CHECKPOINT

        write_json(out / "result.json", result.to_dict())
        begun = not result.valid and (out / CHECKPOINT).is_file()
        print(f"Interrupted: {out} {lacking}{'; add --resume to continue' if begun else ''}", file=sys.stderr)
    if as_json:
        print_json(result.to_dict())
    else:
        shown = table_of(result.kind)(result)
        show(shown if details or shown.short is None else shown.short)
    if not result.valid:  # of the several designs of a path one may stall
        raise typer.Exit(3 if result.status in FAILED and result.problem.task != "path" else 1)


@contextlib.contextmanager
def noted_letters() -> Iterator[None]:
    """Print warnings about letters that no font has as notes on standard error, in the end."""
    from optlink.presentation.style import LettersNotDrawn

    notes: list[str] = []
    others = warnings.showwarning

    def note(message: Warning | str, category: type[Warning], *place: Any, **options: Any) -> None:
        if issubclass(category, LettersNotDrawn):
            notes.append(str(message))
        else:
            others(message, category, *place, **options)

    with warnings.catch_warnings():
        warnings.simplefilter("always", LettersNotDrawn)
        warnings.showwarning = note
        yield
    for words in notes:
        print(f"Note: {words}", file=sys.stderr)


def show(content: Summary | TableSpec) -> None:
    """Print a summary or a table on standard output; of a quiet command only its verdict."""
    from optlink.presentation import terminal

    terminal.show(content.verdict if quiet else content)


# --- progress ----------------------------------------------------------------------------------------------------------------


@contextlib.contextmanager
def working(what: str) -> Iterator[None]:
    """Show on standard error what is in progress, without an estimate of its duration."""
    from optlink.presentation import terminal

    with contextlib.nullcontext() if quiet else terminal.console(stderr=True).status(visible(what)):
        yield


@contextlib.contextmanager
def share(what: str, *, said: bool = False) -> Iterator[Callable[..., None] | None]:
    """Yield a progress function for a bar with the remaining time on standard error; None if that is not a terminal.

    The bar appears with the first fraction below 1: work of a single step shows none. The function takes the completed fraction,
    and optionally a text that follows `what`. `said`: without a terminal a line says what has begun, after all input was checked,
    and one each new text.
    """
    if quiet or not sys.stderr.isatty():
        begun: list[str] = []

        def say(_done: float, text: str = "") -> None:
            if what + text not in begun:
                begun.append(what + text)
                print(f"{what}{text} ...", file=sys.stderr, flush=True)

        yield say if said and not quiet else None
        return
    with contextlib.ExitStack() as stack:
        updates: list[Callable[[float, str], None]] = []

        def advance(done: float, text: str = "") -> None:
            if not updates and done < 1.0:
                updates.append(stack.enter_context(_bar(what)))
            for update in updates:
                update(done, text)

        yield advance


@contextlib.contextmanager
def _bar(what: str) -> Iterator[Callable[[float, str], None]]:
    from rich.progress import TextColumn

    with progress_bar(TextColumn("{task.percentage:>3.0f} %"), what=what, total=1.0) as (bar, task):
        yield lambda done, text: bar.update(task, completed=done, description=what + text)


@contextlib.contextmanager
def progress_bar(*columns: ProgressColumn, what: str, **options: Any) -> Iterator[tuple[Progress, TaskID]]:
    """Show a bar with its remaining time on standard error; none if that is not a terminal, or of a quiet command.

    The text `what` precedes the bar, `columns` follow it; the options are those of `rich.progress.Progress.add_task`.
    """
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    from optlink.presentation import terminal

    bar_console = terminal.console(stderr=True)
    layout = (TextColumn("{task.description}"), BarColumn(), *columns, TimeRemainingColumn())
    with Progress(*layout, console=bar_console, transient=True, disable=quiet or not bar_console.is_terminal) as bar:
        yield bar, bar.add_task(what, **options)


# --- input -------------------------------------------------------------------------------------------------------------------


def load(problem: str, changes: list[str] | None, *, definite: bool = False) -> ProblemFile:
    """Load a problem with the changes of `--set`: a shipped one by name, a file, or that of a stored result.

    With `definite`, the problem of a result has the assembly modes of its design.
    """
    from optlink.presentation.files import is_result
    from optlink.problem.assignment import parse_assignments
    from optlink.problem.file import load as read

    assignments = parse_assignments(changes or [])
    if not is_result(problem):
        return read(problem, assignments)
    from optlink.presentation.registry import read_result

    result = read_result(problem)
    file: ProblemFile = getattr(result, "definite", result.problem) if definite else result.problem
    return file.override(assignments) if assignments else file


def given_design(
    file: ProblemFile, problem: str, changes: list[str] | None, design: list[str] | None, varied: Collection[str] = ()
) -> dict[str, float] | None:
    """Return the design of `--design` [SI]; without it that of the stored result which is named in place of a problem.

    Quantities of a result that `--set` changes have the values stated there, and linked ones follow. None if there is no design.
    """
    from optlink.presentation.files import is_result

    if design or not is_result(problem):
        return read_design_option(file, design, varied)
    from optlink.presentation.registry import read_result
    from optlink.problem.assignment import parse_assignments
    from optlink.problem.quantity import quantity_key

    result = read_result(problem)
    values = getattr(result, "design", None) or getattr(getattr(result, "solution", None), "design", {})
    changed = [key.removeprefix("mechanism.") for key in (*parse_assignments(changes or []), *varied)]
    kept = {}
    for name in (name for name in file.model.quantities if name in values):
        key = quantity_key(file.model, name).removeprefix("mechanism.")
        if changed and name in file.model.links:
            continue
        if not any(f"{key}.".startswith(f"{one}.") or f"{one}.".startswith(f"{key}.") for one in changed):
            kept[name] = values[name]
    return kept or None


def read_design_option(file: ProblemFile, design: list[str] | None, varied: Collection[str] = ()) -> dict[str, float] | None:
    """Read the design of `--design` [SI], which may leave `varied` out; None without the option."""
    if not design:
        return None
    from optlink.tasks.run import read_design

    return read_design(file, design, varied)


def quantity(text: str | None, kind: str, option: str) -> float | None:
    """Read an option that is a number with a unit [SI], of a kind in `optlink.units.KINDS`; None without the option."""
    if text is None:
        return None
    from optlink.problem.quantity import input_of, read_scalar

    with input_of(None, option, text):
        return read_scalar(text, kind)[0]


def given(**options: Any) -> dict[str, Any]:
    """Return the options that are not None; the library has defaults for the others."""
    return {name: value for name, value in options.items() if value is not None}


def refuse(options: Mapping[str, object], message: str, remedy: str, file: str | None = None) -> None:
    """Raise an error for the first of these options that is used, neither None nor False: it would have no effect.

    Raises
    ------
    InputError
        If one of the options is used.
    """
    for option, value in options.items():
        if value is not None and value is not False:
            raise InputError(message, remedy, file, option, None if value is True else str(value))


# --- output folders ----------------------------------------------------------------------------------------------------------


def places(out: Path | None, command: str, problem: str, csv: Path | None = None) -> None:
    """Check before any work that results can be written, and lock their folder until the command ends.

    A new folder is removed again if the input is invalid.
    """
    if out is None:
        unused = {"--format": None if pictures == "png" else pictures, "--film": film}
        refuse(unused, "pictures need a folder", "Add --out DIR")
    else:
        _kept[-1].enter_context(_result_folder(out, command, problem))
    if csv is not None:
        from optlink.presentation.files import check_target

        check_target(csv, (), "motion.csv", "--csv")


def study_place(out: Path, command: str, problem: str) -> None:
    """Lock an existing folder for a study until the command ends; it may hold the study to be resumed."""
    _kept[-1].enter_context(locked(out))
    check_owner(out, command, problem)


def _no_study(out: Path) -> None:
    """Refuse a folder that holds a sweep or a Pareto front: its table would remain beside another result."""
    from optlink.execution.store import definition

    about = definition(out)
    if about is None:
        return
    problem = about.get("problem")
    whose = f" of {problem}" if isinstance(problem, str) else ""
    what = "a front" if "objectives" in about else "a sweep"
    message = f"the folder contains {what}{whose}; another result cannot be written there"
    raise InputError(message, "Choose another folder; nothing was overwritten", str(out), "--out")


FILES = (".html", ".htm", ".pdf", ".png", ".svg", ".gif", ".json", ".toml", ".csv", ".dxf", ".txt")
"""Extensions of files, which are not accepted as names of result folders."""


@contextlib.contextmanager
def _result_folder(out: Path, command: str, problem: str) -> Iterator[None]:
    """Create and lock the result folder; remove it again if it is new and the input is invalid."""
    new = [place for place in (out, *out.parents) if not os.path.exists(place)]
    if new and out.suffix.lower() in FILES:
        remedy = "Give the name of a folder, for example out; `optlink report` writes a page, `optlink export` a drawing or table"
        raise InputError("this is the name of a file, and the results are several", remedy, key="--out", value=str(out))
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


# Folder of one run: locked during the run, refused to another command or problem, cleared of files of an earlier run.

MANIFEST = ".optlink-run.json"
"""File that records the command of an earlier run in the folder, and the files that it wrote with their check sums."""

RESULT = "result.json"


def check_owner(path: Path, command: str, problem: str) -> None:
    """Refuse a folder that holds the result of another command or another problem, given by its name or file.

    Raises
    ------
    InputError
        If it does.
    """
    about = read_object(path / MANIFEST) or {}
    if not (path / RESULT).is_file():
        return
    stem = Path(problem).stem
    if isinstance(about.get("command"), str) and isinstance(about.get("problem"), str):
        commands, owner = [about["command"]], about["problem"]
    else:
        result = read_object(path / RESULT) or {}
        commands, owner = _writers(str(result.get("schema", ""))), Path(str(result.get("problem", stem))).stem
    if (commands and command not in commands) or owner != stem:
        message = f"the folder contains the result of `{' or '.join(commands) or 'optlink'}` for {owner}"
        remedy = "Choose another folder, or remove this one; nothing was overwritten"
        raise InputError(message, remedy, str(path), "--out")


def earlier_result(path: Path) -> dict[str, Any]:
    """Return the result of the earlier run in a folder; empty if there is none, or if that run did not write all its files."""
    files = (read_object(path / MANIFEST) or {}).get("files")
    written = isinstance(files, dict) and RESULT in files and files[RESULT] == _sum(path / RESULT)
    return (read_object(path / RESULT) or {}) if written else {}


@contextlib.contextmanager
def run_folder(path: Path, command: str, problem: str) -> Iterator[None]:
    """Lock an existing folder for a run; afterwards remove files of an earlier run that this one did not rewrite.

    Only files unchanged since the earlier run are removed, and only if this run has written its result. A folder of another run,
    command or problem is refused, and one whose result is a link out of it.
    """
    with locked(path):
        check_link(path / RESULT)
        check_owner(path, command, problem)
        before = (read_object(path / MANIFEST) or {}).get("files")
        with written_files() as written:
            try:
                yield
            finally:
                _replaced(path, before, written, {"schema": "optlink/run/1", "command": command, "problem": Path(problem).stem})


def _replaced(path: Path, before: Any, written: set[Path], about: dict[str, Any]) -> None:
    """Remove files of the earlier run that this one did not write; record the files of this one."""
    names = {file.name for file in written if file.parent.resolve() == path.resolve()}
    if RESULT not in names:
        return
    for name, total in before.items() if isinstance(before, dict) else ():
        if name not in names and Path(name).name == name and _sum(path / name) == total:
            (path / name).unlink(missing_ok=True)
    with contextlib.suppress(InputError):  # the results are complete; the disk may be full
        write_json(path / MANIFEST, {**about, "files": {name: _sum(path / name) for name in sorted(names)}})


def _writers(schema: str) -> list[str]:
    """Return the commands that write results of a schema: for folders without a manifest."""
    from optlink.presentation.registry import KINDS
    from optlink.problem.upgrades import kind_of

    kind = kind_of(schema)[0]
    command = (KINDS[kind].command if kind in KINDS else "").partition(" --")[0].rpartition(" ")[2]
    return ["solve", "validate"] if command == "solve" else [command] if command else []


def _sum(path: Path) -> str | None:
    try:
        return check_sum(path.read_bytes())
    except OSError:
        return None
