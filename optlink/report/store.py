"""Files that are complete or not there: everything is written to a temporary name beside its place, then renamed."""

from __future__ import annotations

import contextlib
import csv
import itertools
import json
import math
import os
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from optlink.errors import Fault, InputError


def folder(path: Path, option: str = "--out") -> Path:
    """Make an output folder and try to write there, before any work is done; `option` is named if that fails.

    Raises
    ------
    InputError
        when nothing can be written there.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=path):
            pass
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise InputError(
            Fault(f"cannot write there: {reason}", "Give a folder that you may write to", key=option, value=str(path))
        ) from None
    return path


@contextlib.contextmanager
def whole(path: Path) -> Iterator[Path]:
    """Give a temporary name to write to; rename it to `path` if all went well, remove it if not.

    What a link points to is replaced, not the link; a pipe or device is written to as it is.
    """
    path = path.resolve() if path.is_symlink() else path
    if path.exists() and not path.is_file():
        try:
            yield path
        except OSError as error:
            raise InputError(Fault(f"cannot write there: {error.strerror}", "Choose another place", str(path))) from None
        return
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.stem}-", suffix=path.suffix)
    os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
        temporary.chmod(0o644)
        temporary.replace(path)
    except OSError as error:
        raise InputError(
            Fault(f"cannot write the file: {error.strerror}", "Free some space or choose another folder", str(path))
        ) from None
    finally:
        temporary.unlink(missing_ok=True)


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


def write_json(path: Path, document: dict[str, Any]) -> None:
    """Write a JSON document."""
    with whole(path) as temporary:
        temporary.write_text(json.dumps(document, indent=2, ensure_ascii=False) + "\n", encoding="utf-8")


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
