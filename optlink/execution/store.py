"""Study folder: its definition (study.json), its chunks as they complete, and the final table.

Every file is complete or absent, so an interrupted run resumes from its completed chunks without loss or repetition.
A folder that holds another study is never written to.
"""

import contextlib
import csv
import io
import json
import os
import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, Self

from optlink.errors import InputError
from optlink.execution.runner import run
from optlink.execution.worker import ChunkTask
from optlink.io import LOCK, check_link, check_sum, checked, folder, locked, read_object, whole, with_check_sum, write_json

ABOUT, TABLE, CHUNKS = "study.json", "sweep.csv", "chunks"
SPREAD = 1000  # chunks per folder
SUM = "crc32 "  # prefix of the last line of a chunk, the check sum of the others
TABLE_SUM = "table_crc32"  # key of the check sum of the table in the definition

Rows = Iterator[list[str]]
Progress = Callable[[int, int], None]
"""(done, all)"""


class Store:
    """The folder of one study, begun, or with `resume` continued with the completed chunks.

    Two studies are the same if and only if their definitions `about` (JSON compatible) are equal.

    Raises
    ------
    InputError
        If the folder contains another study, or this one without `resume`, or cannot be written to.
    """

    def __init__(self, path: Path, about: Mapping[str, Any], *, resume: bool = False) -> None:
        about = dict(json.loads(json.dumps(about)))
        if resume and not os.path.isdir(path):
            raise _nothing(path)
        self._is_new = not os.path.exists(path)
        self.path, self.chunks = folder(path), path / CHUNKS
        self.count, self.about = 0, about
        self.sizes: Callable[[int], int] = int
        try:
            with contextlib.ExitStack() as stack:
                stack.enter_context(locked(path))
                self._begin(about, resume)
                self._lock = stack.pop_all()
        except InputError:
            if self._is_new:
                with contextlib.suppress(OSError):
                    path.rmdir()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Release the folder to other runs."""
        self._lock.close()

    def _begin(self, about: dict[str, Any], resume: bool) -> None:
        """Check that the folder holds this study or none; write the definition."""
        path, stored = self.path, self._stored_definition()
        self._sum = None if stored is None else stored.pop(TABLE_SUM, None)
        if stored is None and resume and all(one.name == LOCK for one in path.iterdir()):
            raise _nothing(path)
        if stored is None and self.table.exists():
            raise InputError("the folder contains a table of another study", "Choose another folder", str(path), "--out")
        if stored is not None:
            self._compare(stored, about)
            if not resume:
                remedy = "Add --resume to continue it (completed points are kept), or choose another folder"
                raise InputError("the folder already contains this study", remedy, str(path), "--out")
        self._mine: list[Path] = []  # files written by this run; the first is the definition if it began the study
        self._begun = stored is None
        if self._begun:
            try:
                self.keep(ABOUT, about)
            except InputError:
                self._withdraw()
                raise

    def divide(self, sizes: Callable[[int], int], count: int) -> None:
        """Set the division of the study into chunks: how many rows a chunk has, by its number, and the number of chunks."""
        self.sizes, self.count = sizes, count
        if not self.finished:
            self._folder(self.chunks)

    @property
    def table(self) -> Path:
        """Path of the finished table."""
        return self.path / TABLE

    @property
    def finished(self) -> bool:
        """Whether the table is written."""
        return self.table.exists()

    def _stored_definition(self) -> dict[str, Any] | None:
        path = self.path / ABOUT
        if not path.exists():
            return None
        definition = read_object(path)
        if definition is None:
            message = "the description of the study in the folder cannot be read"
            raise InputError(message, "Choose another folder", str(path), "--out")
        return definition

    def _compare(self, stored: dict[str, Any], about: dict[str, Any]) -> None:
        for key in dict.fromkeys([*about, *stored]):
            there, here = stored.get(key), about.get(key)
            if there != here:
                difference = "" if isinstance(here, list | dict) else f", there {there}, here {here}"
                message = f"the folder contains another study: the {key.replace('_', ' ')} differs{difference}"
                remedy = "Choose another folder; nothing was overwritten"
                raise InputError(message, remedy, str(self.path), "--out")

    # --- documents ----------------------------------------------------------------------------------------------------------

    def document(self, name: str) -> dict[str, Any]:
        """Return a document of the study; empty if there is none, or if it was changed."""
        return checked(read_object(self.path / name) or {}) or {}

    def keep(self, name: str, document: Mapping[str, Any]) -> None:
        """Write a document of the study (JSON compatible) to a file of the folder."""
        write_json(self.path / name, dict(document) if name == ABOUT else with_check_sum(document))
        self._mine.append(self.path / name)

    def withdraw(self) -> None:
        """Restore the folder to its previous state, if this run began the study."""
        if self._begun:
            self._withdraw()
        self.close()
        if self._begun and self._is_new:
            with contextlib.suppress(OSError):  # other files remain in the folder
                self.path.rmdir()

    def _withdraw(self) -> None:
        for path in self._mine:
            path.unlink(missing_ok=True)
        self.drop()

    # --- chunks ------------------------------------------------------------------------------------------------------------

    def _file(self, index: int) -> Path:
        return self.chunks / f"{index // SPREAD:05d}" / f"{index:08d}.csv"

    def _folder(self, path: Path) -> None:
        check_link(path)
        try:
            path.mkdir(exist_ok=True)
        except OSError as error:
            remedy = "Free some space or choose another folder"
            raise InputError(f"cannot create the folder:  {error.strerror}", remedy, str(path), "--out") from None

    def missing(self) -> list[int]:
        """Return the numbers of the chunks that are not complete."""
        return [] if self.finished else [index for index in range(self.count) if self._lines(index) is None]

    def _lines(self, index: int) -> str | None:
        """Return the lines of a chunk; None if it is absent or corrupt."""
        try:
            text = self._file(index).read_text(encoding="utf-8")
        except (OSError, ValueError):
            return None
        lines, mark, checksum = text.rpartition(SUM)
        whole = mark and checksum == f"{check_sum(lines.encode())}\n" and lines.count("\n") == self.sizes(index)
        return lines if whole else None

    def write(self, index: int, text: str) -> None:
        """Write a chunk: lines of CSV without a header, one per row."""
        path = self._file(index)
        self._folder(path.parent)
        with whole(path) as temporary:
            temporary.write_text(f"{text}{SUM}{check_sum(text.encode())}\n", encoding="utf-8")
        self._mine.append(path)

    def fill(
        self, task: ChunkTask, engine: str, workers: int | None, scheduler: str | None, progress: Progress | None
    ) -> tuple[int, float]:
        """Run the missing chunks, see `optlink.execution.runner.run`.

        Return the rows completed by this call, and their processor time over all processes [s].
        """
        todo, total = self.missing(), sum(map(self.sizes, range(self.count)))
        before, mine, cpu = total - sum(map(self.sizes, todo)), 0, 0.0
        if progress is not None:
            progress(before, total)
        try:
            for index, answer in run(task, todo, engine, workers, scheduler) if todo else ():
                self.write(index, answer.value)
                mine, cpu = mine + self.sizes(index), cpu + answer.cpu
                if progress is not None:
                    progress(before + mine, total)
        except InputError:
            if len(self._mine) == 1:  # no chunk is lost
                self.withdraw()
            raise
        return mine, cpu

    def rows(self) -> Rows:
        """Yield the rows of all chunks in order.

        Raises
        ------
        InputError
            If the file of a chunk was changed.
        """
        for index in range(self.count):
            lines = self._lines(index)
            if lines is None:
                remedy = "Continue with --resume: it is computed again"
                raise InputError("a chunk has been changed", remedy, str(self._file(index)), "--out")
            yield from csv.reader(io.StringIO(lines, newline=""))

    def finish(self, columns: list[str], rows: Rows) -> None:
        """Write the table from its header and all rows, then remove the chunks."""
        with whole(self.table) as temporary, temporary.open("w", encoding="utf-8", newline="") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(columns)
            writer.writerows(rows)
        self._sum = _sum_of(self.table)
        self.keep(ABOUT, {**self.about, TABLE_SUM: self._sum})
        self.drop()

    def drop(self) -> None:
        """Remove the chunks that the table contains."""
        shutil.rmtree(self.chunks, ignore_errors=True)

    def finished_rows(self, columns: list[str]) -> Rows:
        """Yield the rows of the finished table.

        Raises
        ------
        InputError
            If the table was changed.
        """
        number, expected = 0, sum(map(self.sizes, range(self.count)))
        changed = self._sum not in (None, _sum_of(self.table))
        with self.table.open(encoding="utf-8", newline="", errors="replace") as file:
            rows: Iterable[list[str]] = () if changed else csv.reader(file)
            for number, row in enumerate(rows):
                if len(row) != len(columns) or (number == 0 and row != columns):
                    break
                if number:
                    yield row
            else:
                if number == expected and not changed:
                    return
        remedy = "Remove the folder and start again, or choose another one"
        raise InputError("the finished table has been changed or truncated", remedy, str(self.table), "--out")


def _sum_of(path: Path) -> str:
    """Return the check sum of a file."""
    checksum = "0"
    with path.open("rb") as file:
        while part := file.read(1 << 20):
            checksum = check_sum(part, int(checksum, 16))
    return checksum


def _nothing(path: Path) -> InputError:
    return InputError("there is no study to resume", "Start without --resume", str(path), "--resume")
