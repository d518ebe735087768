"""Folder of one run: locked during the run, refused to another command or problem, cleared of files of an earlier run."""

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from optlink.errors import InputError
from optlink.io import check_link, check_sum, locked, read_object, write_json, written_files

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
    from optlink.report.registry import KINDS

    kind = schema.removeprefix("optlink/").rpartition("/")[0].replace("-", " ")
    command = KINDS.get(kind, "").partition(" --")[0].rpartition(" ")[2]
    return ["solve", "validate"] if command == "solve" else [command] if command else []


def _sum(path: Path) -> str | None:
    try:
        return check_sum(path.read_bytes())
    except OSError:
        return None
