"""What the file of a study holds, also while the study is running."""

import contextlib
import sqlite3
from collections.abc import Callable, Iterator
from pathlib import Path

from optlink.execution.store import STORE


@contextlib.contextmanager
def opened(out: Path) -> Iterator[sqlite3.Connection]:
    """The file of a study, to be read and changed."""
    with contextlib.closing(sqlite3.connect(f"{(out / STORE).absolute().as_uri()}?mode=rw", uri=True)) as database, database:
        yield database


def complete(out: Path) -> int:
    """Number of complete chunks; none where there is no study yet."""
    with contextlib.suppress(sqlite3.OperationalError), opened(out) as database:
        return int(*database.execute("SELECT count(*) FROM entries WHERE typeof(name) = 'integer'").fetchone())
    return 0


def text(out: Path, name: str | int) -> str:
    """A document by its name, or a chunk by its number; empty where there is none yet."""
    with contextlib.suppress(sqlite3.OperationalError, TypeError), opened(out) as database:
        return str(*database.execute("SELECT text FROM entries WHERE name = ?", (name,)).fetchone())
    return ""


def change(out: Path, name: str | int, damage: Callable[[str], object]) -> None:
    """Damage a document or a chunk, but not its check sum."""
    damaged = damage(text(out, name))
    with opened(out) as database:
        assert database.execute("UPDATE entries SET text = ? WHERE name = ?", (damaged, name)).rowcount == 1
