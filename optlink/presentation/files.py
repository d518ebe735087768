"""Result files: CSV tables, designs and checkpoints."""

import contextlib
import csv
import itertools
import math
import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from optlink.errors import InputError
from optlink.io import check_link, checked, folder, read_object, whole
from optlink.problem.file import ProblemFile, dump, shipped, with_files_beside
from optlink.problem.quantity import input_of, nearest

MAX_NAME_BYTES = 255  # largest length of a file name on common systems [bytes]


CHECKPOINT = "checkpoint.json"
"""File of a folder from which a simulation is resumed."""


def is_result(text: str) -> bool:
    """Return whether an argument names a result file or its folder; the name of a shipped problem takes precedence."""
    return text.endswith(".json") or (os.path.isdir(text) and text not in shipped())


def check_target(path: Path, suffixes: tuple[str, ...], example: str, key: str = "--out") -> Path:
    """Check that a file can be written and return its path.

    Parameters
    ----------
    suffixes : tuple of str
        Permitted extensions with dot; none: any.
    example : str
        File name to suggest in messages.
    key : str
        Command-line option that the message names.

    Raises
    ------
    InputError
        If the extension is unknown, the folder does not exist or is not writable, or the name is a link out of it.
    """
    if len(os.fsencode(path.name)) > MAX_NAME_BYTES:
        raise InputError("the name is too long", f"Give a shorter one, for example {example}", key=key, value=str(path))
    if os.path.isdir(path):
        raise InputError("this is a folder", f"Give the name of a file, for example {example}", key=key, value=str(path))
    if suffixes and path.suffix.lower() not in suffixes:
        message = f'cannot write "{path.suffix}" files' if path.suffix else "the name has no ending"
        remedy = nearest(path.suffix, suffixes) if path.suffix else f"Write one of {', '.join(suffixes)}"
        raise InputError(message, remedy, key=key, value=str(path))
    if not os.path.isdir(path.parent):
        message = f"there is no folder {path.parent}"
        raise InputError(message, "Make it first, or choose another place", key=key, value=str(path))
    folder(path.parent, key)
    check_link(path)
    return path


def write_design(directory: Path, machine: ProblemFile, comment: str) -> list[Path]:
    """Write a design as design.toml with copies of the files that it refers to, so that the folder is portable.

    Parameters
    ----------
    comment : str
        First line of the file.

    Raises
    ------
    InputError
        If a file cannot be read or written.
    """
    with input_of(machine.file):
        moved, files = with_files_beside(machine)
    texts = {"design.toml": f"# {' '.join(comment.split())}\n{dump(moved)}".encode(), **files}
    for name, data in texts.items():
        with whole(directory / name) as temporary:
            temporary.write_bytes(data)
    return [directory / name for name in texts]


def verdict(status: str, valid: bool, reason: str) -> str:
    """Return the first line of a design file.

    Parameters
    ----------
    status : str
        Status of the solver.
    reason : str
        Why the design is not valid.
    """
    return f"{status}, valid" if valid else f"NOT VALID: {reason}"


def write_csv(path: Path, columns: Mapping[str, Iterable[float | str]]) -> None:
    """Write columns with a header in full precision; values that are not finite give empty cells.

    Parameters
    ----------
    columns : mapping of str to iterable of float or str
        All of the same length.
    """
    with stream(path) as append:
        append(columns)


@contextlib.contextmanager
def stream(path: Path, keep: int = 0) -> Iterator[Callable[[Mapping[str, Iterable[float | str]]], None]]:
    """Open a CSV file that is written in portions and replaces the target once it is complete.

    It starts with rows of the existing file. The function appends rows; its first call also writes the header.

    Parameters
    ----------
    keep : int, optional
        Number of rows to keep, if the existing file has them.
    """
    with whole(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        writer, begun = csv.writer(file, lineterminator="\n"), bool(keep) and _copied(path, file, keep)

        def append(columns: Mapping[str, Iterable[float | str]]) -> None:
            nonlocal begun
            if not begun:
                writer.writerow(columns)
            begun = True
            for row in zip(*columns.values(), strict=True):
                writer.writerow([one if isinstance(one, str) else repr(float(one)) if math.isfinite(one) else "" for one in row])

        yield append


def _copied(path: Path, file: Any, rows: int) -> bool:
    """Copy the header and `rows` rows; return False if there are fewer."""
    if not path.is_file():
        return False
    with path.open(encoding="utf-8") as old:
        lines = list(itertools.islice(old, rows + 1))
    if len(lines) == rows + 1 and lines[-1].endswith("\n"):
        file.writelines(lines)
        return True
    return False


def checkpoint(out: Path | None) -> dict[str, Any]:
    """Read the checkpoint of an output folder.

    Raises
    ------
    InputError
        If no folder is given or its checkpoint cannot be read.
    """
    if out is None:
        raise InputError("needs the folder of the run", "Add --out DIR", key="--resume")
    path = out / CHECKPOINT
    content = read_object(path)
    if content is None or checked(content) is None:
        raise InputError("there is no checkpoint, or it is damaged", "Start without --resume", str(path), "--resume")
    return content
