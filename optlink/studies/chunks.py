"""The folder of a study: what it is (study.json), its chunks as they are done, and the one table that they become.

Every file is complete or not there, so a run that was killed goes on from the chunks that it left: nothing is lost and nothing
is done twice. A folder that holds another study is never written to.
"""

from __future__ import annotations

import csv
import json
import shutil
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from optlink.errors import Fault, InputError
from optlink.storage import folder, whole, write_json

ABOUT, TABLE, CHUNKS = "study.json", "sweep.csv", "chunks"
SPREAD = 1000  # chunks in one folder

Rows = Iterator[list[str]]


class Store:
    """The folder of one study.

    Parameters
    ----------
    path : Path
    about : mapping
        What the study is, fit for JSON: two studies are the same if and only if this is the same.
    sizes : function
        From the number of a chunk to its number of rows.
    count : int
        Number of chunks.
    resume : bool
        Go on with what is there.

    Raises
    ------
    InputError
        when the folder holds another study, or this one and `resume` is not said; when it cannot be written to.
    """

    def __init__(
        self, path: Path, about: Mapping[str, Any], sizes: Callable[[int], int], count: int, *, resume: bool = False
    ) -> None:
        self.path, self.sizes, self.count = folder(path), sizes, count
        about = dict(json.loads(json.dumps(about)))
        known = self._known()
        if known is None and resume and not any(path.iterdir()):
            raise InputError(Fault("there is no study to go on with", "Begin without --resume", str(path), "--resume"))
        if known is None and self.table.exists():
            raise InputError(Fault("the folder holds a table of another study", "Choose another folder", str(path), "--out"))
        if known is not None:
            self._compare(known, dict(about))
            if not resume:
                remedy = "Add --resume to go on with it (what is done is kept), or choose another folder"
                raise InputError(Fault("this very study is in the folder already", remedy, str(path), "--out"))
        self.chunks = path / CHUNKS
        self.chunks.mkdir(exist_ok=True)
        if known is None:
            write_json(path / ABOUT, dict(about))

    @property
    def table(self) -> Path:
        """The finished table."""
        return self.path / TABLE

    @property
    def finished(self) -> bool:
        """Whether the table is written."""
        return self.table.exists()

    def _known(self) -> dict[str, Any] | None:
        path = self.path / ABOUT
        if not path.exists():
            return None
        try:
            found = json.loads(path.read_text(encoding="utf-8"))
        except (OSError, ValueError):
            found = None
        if not isinstance(found, dict):
            raise InputError(Fault("what study the folder holds cannot be read", "Choose another folder", str(path), "--out"))
        return found

    def _compare(self, known: dict[str, Any], about: dict[str, Any]) -> None:
        for key in dict.fromkeys([*about, *known]):
            there, here = known.get(key), about.get(key)
            if there != here:
                what = key.replace("_", " ")
                shown = "" if isinstance(here, list | dict) else f", there {there}, here {here}"
                message = f"the folder holds another study: the {what} differs{shown}"
                remedy = "Choose another folder; nothing was overwritten"
                raise InputError(Fault(message, remedy, str(self.path), "--out"))

    def _file(self, index: int) -> Path:
        return self.chunks / f"{index // SPREAD:05d}" / f"{index:08d}.csv"

    def missing(self) -> list[int]:
        """Numbers of the chunks that are not done."""
        return [] if self.finished else [index for index in range(self.count) if not self._complete(index)]

    def _complete(self, index: int) -> bool:
        try:
            text = self._file(index).read_text(encoding="utf-8")
        except FileNotFoundError:
            return False
        return text.count("\n") == self.sizes(index) and text.endswith("\n")

    def write(self, index: int, text: str) -> None:
        """Keep a chunk: lines of CSV without a head, one per row."""
        path = self._file(index)
        path.parent.mkdir(exist_ok=True)
        with whole(path) as temporary:
            temporary.write_text(text, encoding="utf-8")

    def rows(self) -> Rows:
        """Rows of all chunks in their order, one at a time."""
        for index in range(self.count):
            with self._file(index).open(encoding="utf-8", newline="") as file:
                yield from csv.reader(file)

    def finish(self, columns: list[str], rows: Rows) -> None:
        """Write the table from all rows, then drop the chunks."""
        with whole(self.table) as temporary, temporary.open("w", encoding="utf-8", newline="") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(columns)
            writer.writerows(rows)
        self.drop()

    def drop(self) -> None:
        """Remove chunks that the table holds."""
        shutil.rmtree(self.chunks, ignore_errors=True)
