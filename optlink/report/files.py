"""Tables and checkpoints as files."""

from __future__ import annotations

import contextlib
import csv
import itertools
import json
import math
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from optlink.errors import Fault, InputError
from optlink.io import folder, whole, write_json
from optlink.problem.file import ProblemFile, dump
from optlink.problem.fixed_design import portable
from optlink.problem.quantity import Unusable

__all__ = ["Stream", "checkpoint", "folder", "stream", "whole", "write_csv", "write_design", "write_json"]


def write_design(directory: Path, machine: ProblemFile, comment: str) -> list[Path]:
    """Write a design as design.toml, and beside it the files that it refers to, so that the directory can be moved.

    Parameters
    ----------
    directory : Path
    machine : ProblemFile
    comment : str
        First line of the file.

    Raises
    ------
    InputError
        when a file cannot be read or written.
    """
    try:
        moved, files = portable(machine)
    except Unusable as error:
        raise InputError(Fault(error.message, error.remedy, machine.file, error.key, error.value)) from None
    texts = {"design.toml": f"# {' '.join(comment.split())}\n{dump(moved)}".encode(), **files}
    for name, data in texts.items():
        with whole(directory / name) as temporary:
            temporary.write_bytes(data)
    return [directory / name for name in texts]


def verdict(status: str, valid: bool, reason: str) -> str:
    """First line of a design's file; `reason` why it is not valid."""
    return f"{status}, valid" if valid else f"NOT VALID: {reason}"


def write_csv(path: Path, columns: Mapping[str, Iterable[float]]) -> None:
    """Write columns under their names, every digit of a number, nothing where there is no finite value."""
    with whole(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(columns)
        _write_rows(writer, columns)


def _write_rows(writer: Any, columns: Mapping[str, Iterable[float]]) -> None:
    for row in zip(*columns.values(), strict=True):
        writer.writerow([repr(float(value)) if math.isfinite(value) else "" for value in row])


class Stream:
    """A CSV file that is written revolution by revolution, and stands under its name once all is done."""

    def __init__(self, file: Any, *, begun: bool = False) -> None:
        self._writer, self._begun = csv.writer(file, lineterminator="\n"), begun

    def __call__(self, columns: Mapping[str, Iterable[float]]) -> None:
        """Write rows; the names of their columns come first."""
        if not self._begun:
            self._writer.writerow(columns)
            self._begun = True
        _write_rows(self._writer, columns)


@contextlib.contextmanager
def stream(path: Path, keep: int = 0) -> Iterator[Stream]:
    """Write a CSV file in portions; the first `keep` rows of one that is there already are kept, if it has them."""
    with whole(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        yield Stream(file, begun=bool(keep) and _copied(path, file, keep))


def _copied(path: Path, file: Any, rows: int) -> bool:
    """Copy the head and so many rows, if there are so many."""
    if not path.is_file():
        return False
    with path.open(encoding="utf-8") as old:
        lines = list(itertools.islice(old, rows + 1))
    if len(lines) == rows + 1 and lines[-1].endswith("\n"):
        file.writelines(lines)
        return True
    return False


def checkpoint(out: Path | None) -> dict[str, Any]:
    """The checkpoint of an output folder.

    Raises
    ------
    InputError
        when there is none that can be read.
    """
    if out is None:
        raise InputError(Fault("which run is to go on is not said", "Name its folder: --out DIR", key="--resume"))
    path = out / "checkpoint.json"
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        found = None
    if not isinstance(found, dict):
        raise InputError(Fault("there is no checkpoint that can be read", "Begin without --resume", str(path), "--resume"))
    return found
