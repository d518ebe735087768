"""Study folder: one sqlite3 file with the definition, the documents and the completed chunks of a study, and the final table.

Each entry is a transaction of its own, with sqlite's rollback journal: it is complete or absent however the process ends, so an
interrupted run resumes from its completed chunks without loss or repetition. The folder is locked for one run by
`optlink.io.locked`, which names the process of the other run. A folder that holds another study is never written to.
"""

import contextlib
import csv
import errno
import io
import json
import os
import shutil
import sqlite3
import tempfile
import weakref
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, Protocol, Self, Unpack

from optlink.errors import InputError
from optlink.execution.options import Execution
from optlink.execution.runner import apart, cores, pool
from optlink.execution.worker import ChunkTask, Runs
from optlink.io import LOCK, check_link, check_sum, folder, locked, read_object, whole

STORE, JOURNAL, TABLE = "study.sqlite", "study.sqlite-journal", "sweep.csv"
NEW = """
PRAGMA auto_vacuum = FULL;  -- the file shrinks when the chunks are removed
BEGIN;
CREATE TABLE entries (name PRIMARY KEY, text TEXT, crc32 TEXT) WITHOUT ROWID;
"""
FORMER = "study.json"  # definition of a study of version 0.1
ABOUT, TABLE_SUM, SUM = "definition", "table", "crc32"  # names of documents, and a key

Rows = Iterator[list[str]]
Progress = Callable[[int, int], None]
"""(done, all)"""


class StudyTask(Protocol):
    """The task of a study."""

    def prepared(self, todo: list[int], runs: Runs) -> tuple[ChunkTask, float]:
        """Return the task of some chunks with what they share, and the processor time for that [s]."""


class TemporaryFolder:
    """A temporary folder that is removed with its owner."""

    def __init__(self) -> None:
        self.path = Path(tempfile.mkdtemp(prefix="optlink-sweep-"))
        weakref.finalize(self, shutil.rmtree, self.path, ignore_errors=True)


class Store:
    """The folder of one study, begun, or with `resume` continued with the completed chunks.

    Two studies are the same if and only if their definitions `about` (JSON compatible) are equal. Without a folder the file has
    no name, so that a killed run leaves nothing, and the finished table lies in a `temporary` folder.

    Raises
    ------
    InputError
        If the folder contains another study, or this one without `resume`, or cannot be written to.
    """

    def __init__(self, path: Path | None, about: Mapping[str, Any], *, resume: bool = False) -> None:
        if resume and path is not None and not os.path.isdir(path):
            raise _nothing(path)
        self.path, self.count = path, 0
        self.temporary: TemporaryFolder | None = None
        self.about: dict[str, Any] = json.loads(json.dumps(about))
        self.sizes: Callable[[int], int] = int
        self._is_new = path is not None and not os.path.exists(path)
        self._begun = False
        self._ends = contextlib.ExitStack()
        try:
            self._begin(resume)
        except BaseException:
            self.withdraw()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Release the folder to other runs."""
        self._ends.close()

    def _begin(self, resume: bool) -> None:
        """Check that the folder holds this study or none; write the definition."""
        stored, place = None, ""
        if self.path is not None:
            self._ends.enter_context(locked(folder(self.path)))
            place = str(check_link(self.path / STORE))
            check_link(self.path / JOURNAL)
            stored = self._stored(self.path, resume)
        with self._writing():
            self._database = sqlite3.connect(place, timeout=60.0, isolation_level=None)  # for who looks into the file
            self._ends.callback(self._database.close)
            if stored is None:
                self._begun = self.path is not None
                self._database.executescript(NEW)
                self.keep(ABOUT, self.about)
                self._database.execute("COMMIT")
        self._has_entries = False  # of this run, beside the definition

    def _stored(self, path: Path, resume: bool) -> dict[str, Any] | None:
        """Return the definition of this study in its folder; None if there is none yet."""
        stored = definition(path)
        if stored is None and resume and all(one.name in (LOCK, STORE, JOURNAL) for one in path.iterdir()):
            raise _nothing(path)
        if stored is None and self.finished:
            raise InputError("the folder contains a table of another study", "Choose another folder", str(path), "--out")
        if os.path.lexists(path / FORMER):
            message = "the folder contains a study of an earlier version of optlink, which this version does not continue"
            raise InputError(message, "Choose another folder, or continue it with that version", str(path), "--out")
        if stored == {}:
            message = "the description of the study in the folder cannot be read"
            raise InputError(message, "Choose another folder", str(path), "--out")
        if stored is not None:
            self._compare(stored, path)
            if not resume:
                remedy = "Add --resume to continue it (completed points are kept), or choose another folder"
                raise InputError("the folder already contains this study", remedy, str(path), "--out")
        return stored

    def _compare(self, stored: dict[str, Any], path: Path) -> None:
        for key in dict.fromkeys([*self.about, *stored]):
            there, here = stored.get(key), self.about.get(key)
            if there != here:
                difference = "" if isinstance(here, list | dict) else f", there {there}, here {here}"
                message = f"the folder contains another study: the {key.replace('_', ' ')} differs{difference}"
                raise InputError(message, "Choose another folder; nothing was overwritten", str(path), "--out")

    def divide(self, sizes: Callable[[int], int], count: int) -> None:
        """Set the division of the study into chunks: how many rows a chunk has, by its number, and the number of chunks."""
        self.sizes, self.count = sizes, count

    @property
    def table(self) -> Path:
        """Path of the finished table."""
        assert self.path is not None
        return self.path / TABLE

    @property
    def finished(self) -> bool:
        """Whether the table is written."""
        return self.path is not None and self.table.exists()

    def withdraw(self) -> None:
        """Restore the folder to its previous state, if this run began the study."""
        if self._begun and self.path is not None:
            self._database.close()
            for name in (STORE, JOURNAL):
                (self.path / name).unlink(missing_ok=True)
        self.close()
        if self._is_new and self.path is not None:
            with contextlib.suppress(OSError):  # other files remain in the folder
                self.path.rmdir()

    # --- entries -------------------------------------------------------------------------------------------------------------

    @contextlib.contextmanager
    def _writing(self) -> Iterator[None]:
        """Report what sqlite cannot write."""
        try:
            yield
        except sqlite3.Error as error:
            full = getattr(error, "sqlite_errorcode", None) == sqlite3.SQLITE_FULL
            reason = os.strerror(errno.ENOSPC) if full else str(error)
            place = tempfile.gettempdir() if self.path is None else str(self.path / STORE)
            remedy = "Free some space or choose another folder"
            raise InputError(f"cannot write the file: {reason}", remedy, place) from None

    def write(self, name: str | int, text: str) -> None:
        """Write a document by its name, or a chunk by its number: lines of CSV without a header, one per row."""
        with self._writing():
            self._database.execute("REPLACE INTO entries VALUES (?, ?, ?)", (name, text, check_sum(text.encode())))
        self._has_entries = True

    def _text(self, name: str | int) -> str | None:
        """Return the text of an entry; None if it is absent or was changed."""
        with contextlib.suppress(sqlite3.DatabaseError):  # damaged
            entries = self._database.execute("SELECT text, crc32 FROM entries WHERE name = ?", (name,)).fetchall()
            return next((text for text, sum_ in entries if check_sum(str(text).encode()) == sum_), None)
        return None

    def document(self, name: str) -> dict[str, Any]:
        """Return a document of the study; empty if there is none, or if it was changed."""
        document: dict[str, Any] = json.loads(self._text(name) or "{}")
        return document

    def keep(self, name: str, document: Mapping[str, Any]) -> None:
        """Keep a document of the study (JSON compatible)."""
        self.write(name, json.dumps(document))

    def missing(self) -> list[int]:
        """Return the numbers of the chunks that are not complete."""
        return [] if self.finished else [index for index in range(self.count) if self._lines(index) is None]

    def _lines(self, index: int) -> str | None:
        """Return the lines of a chunk; None if it is absent or was changed."""
        text = self._text(index)
        return text if text is not None and text.count("\n") == self.sizes(index) else None

    def fill(
        self,
        task: StudyTask,
        progress: Progress | None,
        **execution: Unpack[Execution],
    ) -> tuple[int, float]:
        """Run the missing chunks, see `optlink.execution.runner.pool`, neighbouring ones in one process.

        Return the rows completed by this call, and their processor time over all processes [s].
        """
        todo, total = self.missing(), sum(map(self.sizes, range(self.count)))
        before, mine, cpu = total - sum(map(self.sizes, todo)), 0, 0.0
        if progress is not None:
            progress(before, total)
        if not todo:
            return mine, cpu
        try:
            with pool(**execution) as runs:
                chunks, cpu = task.prepared(todo, runs)
                for index, answer in runs(chunks, apart(todo, execution.get("workers") or cores())):
                    self.write(index, answer.value)
                    mine, cpu = mine + self.sizes(index), cpu + answer.cpu
                    if progress is not None:
                        progress(before + mine, total)
        except InputError:
            if not self._has_entries:
                self.withdraw()
            raise
        return mine, cpu

    def rows(self) -> Rows:
        """Yield the rows of all chunks in order.

        Raises
        ------
        InputError
            If a chunk was changed.
        """
        for index in range(self.count):
            lines = self._lines(index)
            if lines is None:
                remedy = "Continue with --resume: it is computed again"
                raise InputError(f"chunk {index} has been changed", remedy, str(self.path), "--out")
            yield from csv.reader(io.StringIO(lines, newline=""))

    def finish(self, columns: list[str], rows: Rows) -> None:
        """Write the table from its header and all rows, then remove the chunks."""
        if self.path is None:
            self.temporary = TemporaryFolder()
            self.path = self.temporary.path
        with whole(self.table) as temporary, temporary.open("w", encoding="utf-8", newline="") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(columns)
            writer.writerows(rows)
        self.keep(TABLE_SUM, {SUM: _sum_of(self.table)})
        self.drop()

    def drop(self) -> None:
        """Remove the chunks that the table contains."""
        with self._writing():
            self._database.execute("DELETE FROM entries WHERE typeof(name) = 'integer'")

    def finished_rows(self, columns: list[str]) -> Rows:
        """Yield the rows of the finished table.

        Raises
        ------
        InputError
            If the table was changed.
        """
        number, expected = 0, sum(map(self.sizes, range(self.count)))
        changed = self.document(TABLE_SUM).get(SUM, current := _sum_of(self.table)) != current
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


def definition(path: Path) -> dict[str, Any] | None:
    """Return the definition of the study in a folder; empty if it cannot be read, None if there is no study."""
    if os.path.lexists(path / FORMER):
        return read_object(path / FORMER) or {}
    if not os.path.lexists(path / STORE):
        return None
    try:
        uri = f"{(path / STORE).absolute().as_uri()}?mode=rw"
        with contextlib.closing(sqlite3.connect(uri, uri=True)) as database:
            if database.execute("SELECT 1 FROM sqlite_master").fetchone() is None:  # of a run that was killed as it began
                return None
            text = database.execute("SELECT text FROM entries WHERE name = ?", (ABOUT,)).fetchone()
            return dict(json.loads(*text))
    except (sqlite3.Error, TypeError, ValueError):
        return {}


def _nothing(path: Path) -> InputError:
    return InputError("there is no study to resume", "Start without --resume", str(path), "--resume")
