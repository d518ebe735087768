"""Atomic files, JSON documents, and `register`, by which further modules add to optlink.

A file is written under a temporary name in its folder, then renamed. Only installed Python packages can extend optlink, through
the entry-point group `optlink.extensions`: problem files cannot name code.
"""

from __future__ import annotations

import contextlib
import dataclasses
import datetime
import enum
import functools
import json
import math
import os
import sys
import tempfile
import threading
import zlib
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, TypeVar

from optlink.errors import InputError, UnknownName, nearest
from optlink.version import VERSION

T = TypeVar("T")

GROUP = "optlink.extensions"

SUM = "crc32"  # key of the check sum of a document
META = "meta"  # key of a document that is free for notes of others: the check sum does not cover it
LOCK = ".optlink.lock"
LOCKED_BYTE = 1 << 30  # on Windows, whose locks forbid reading: far behind the process number in the file
_records: list[set[Path]] = []
_locked: set[tuple[str, int]] = set()


def data_folder(name: str) -> Path:
    """Return a folder of shipped data files ("problems"): inside the installed package, or beside it in a checkout."""
    package = Path(__file__).resolve().parent
    inside = package / name
    return inside if inside.is_dir() else package.parent / name


def data_files(name: str) -> dict[str, Path]:
    """Return names and files of the TOML files of a folder of shipped data."""
    return {path.stem: path for path in sorted(data_folder(name).glob("*.toml"), key=lambda path: path.stem)}


def folder(path: Path, option: str = "--out") -> Path:
    """Create an output folder and check that it is writable, before any computation; `option` names it in the error message.

    Raises
    ------
    InputError
        The folder is not writable.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=path):
            pass
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise InputError(
            f"cannot write there: {reason}", "Give a folder that you may write to", key=option, value=str(path)
        ) from None
    return path


def check_link(path: Path) -> Path:
    """Return the file that is written under a name: the target of a symbolic link.

    Raises
    ------
    InputError
        If the name is a link out of its folder, whose target the user did not name; but links to standard output are followed.
    """
    if not path.is_symlink():
        return path
    target, home = Path(os.path.realpath(path)), os.path.realpath(path.parent)
    if not target.is_relative_to(home) and not os.path.abspath(path).startswith(("/dev/", "/proc/")):
        message, remedy = f"this is a link out of its folder, to {target}", "Remove the link, or choose another place"
        raise InputError(message, remedy, str(path))
    return target


@contextlib.contextmanager
def whole(path: Path) -> Iterator[Path]:
    """Yield a temporary file name; rename it to `path` on success, remove it on failure.

    For a symbolic link within its folder the target is replaced, not the link; a pipe or device, such as /dev/stdout, is written
    directly.

    Raises
    ------
    InputError
        If the file cannot be written, or is a link out of its folder.
    BrokenPipeError
        If the reader has closed the pipe.
    """
    target = check_link(path)
    if path.exists() and not path.is_file():
        try:
            yield path
        except BrokenPipeError:
            raise
        except OSError as error:
            raise InputError(f"cannot write there: {error.strerror}", "Choose another place", str(path)) from None
        return
    path, temporary = target, None
    try:
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.stem[:40]}-", suffix=path.suffix)
        os.close(handle)
        temporary = Path(name)
        yield temporary
        temporary.chmod(0o644)
        temporary.replace(path)
        for record in _records:
            record.add(path)
    except OSError as error:
        raise InputError(
            f"cannot write the file: {error.strerror}", "Free some space or choose another folder", str(path)
        ) from None
    finally:
        if temporary is not None:
            temporary.unlink(missing_ok=True)


def shown_name(name: str) -> str:
    """Return the name of a file as a text; bytes of it that are not UTF-8 are escaped."""
    return name.encode("utf-8", "backslashreplace").decode("utf-8")


def write_json(path: Path, document: dict[str, Any]) -> None:
    """Write a document of plain Python values."""
    with whole(path) as temporary:
        temporary.write_text(
            json.dumps(document, indent=2, ensure_ascii=False) + "\n", encoding="utf-8", errors="backslashreplace"
        )


def read_object(path: Path) -> dict[str, Any] | None:
    """Return the JSON object of a file; None if there is none that can be read."""
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return None
    return document if isinstance(document, dict) else None


def check_sum(data: bytes, begin: int = 0) -> str:
    """Return the check sum of data, continued from that of the data before; it detects a changed file, not a forged one."""
    return f"{zlib.crc32(data, begin):08x}"


def with_check_sum(document: Mapping[str, Any]) -> dict[str, Any]:
    """Return a JSON document with the check sum of its entries."""
    return {**document, SUM: check_sum(_canonical(document))}


def checked(document: Mapping[str, Any]) -> dict[str, Any] | None:
    """Return a document without its check sum and the notes of others; None if it was changed.

    The check sum of its text is accepted too: documents were written with it before there was a canonical form.
    """
    content = {name: value for name, value in document.items() if name not in (SUM, META)}
    stated = document.get(SUM)
    known = stated == check_sum(_canonical(content)) or stated == check_sum(json.dumps(content).encode())
    return content if known else None


def _canonical(document: Mapping[str, Any]) -> bytes:
    """Return the text of a JSON document in a form that is the same for every order of its keys and spelling of its numbers."""
    return json.dumps(_alike(document), sort_keys=True, separators=(",", ":")).encode()


def _alike(value: Any) -> Any:
    """Return a document with floats for all numbers, and 0.0 for -0.0: other programs write 1 for 1.0, and 0 for -0.0."""
    if isinstance(value, float):
        return value + 0.0
    if isinstance(value, list | tuple):
        return [_alike(item) for item in value]
    if isinstance(value, Mapping):
        return {str(key): _alike(item) for key, item in value.items()}
    return float(str(value)) if type(value) is int else value


@contextlib.contextmanager
def written_files() -> Iterator[set[Path]]:
    """Collect the paths of all files that `whole` writes within the context."""
    record: set[Path] = set()
    _records.append(record)
    try:
        yield record
    finally:
        _records.remove(record)


@contextlib.contextmanager
def locked(path: Path) -> Iterator[None]:
    """Lock an existing folder for one run; a second run, of this or of another process, is refused.

    This is a lock of the operating system on a file in the folder. The system releases it when the process ends in any way; a
    file left behind by a crash locks nothing. A file system without locks gives no protection. The same thread may take the lock
    again.

    Raises
    ------
    InputError
        Another run has locked the folder.
    """
    key = (os.path.realpath(path), threading.get_ident())
    if key in _locked:
        yield
        return
    place = path / LOCK
    handle = _opened(path, place)
    _locked.add(key)
    try:
        yield
    finally:
        _locked.discard(key)
        if sys.platform == "win32":  # which removes no open file, so that the lock file of another run stays
            os.close(handle)
        with contextlib.suppress(OSError):
            place.unlink()
        if sys.platform != "win32":
            os.close(handle)


def _opened(path: Path, place: Path) -> int:
    """Open and lock the lock file; return its handle."""
    while True:
        try:
            handle = os.open(place, os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0), 0o644)
        except OSError as error:
            message, remedy = f"cannot write there: {error.strerror}", "Give a folder that you may write to"
            raise InputError(message, remedy, key="--out", value=str(path)) from None
        if not _lock(handle):
            number = ""
            with contextlib.suppress(OSError, UnicodeDecodeError):
                number = os.read(handle, 20).decode()
            os.close(handle)
            who = f" (process {number})" if number.isdigit() else ""
            message = f"another run of optlink{who} is writing into this folder"
            raise InputError(message, "Wait until it has ended, or choose another folder", key="--out", value=str(path))
        with contextlib.suppress(OSError):
            if os.path.samestat(os.fstat(handle), os.stat(place)):  # the file has not just been removed by its owner
                os.ftruncate(handle, 0)
                os.write(handle, str(os.getpid()).encode())
                return handle
        os.close(handle)


def _lock(handle: int) -> bool:
    """Try to lock an open file; return whether the lock is now held by this process."""
    if sys.platform == "win32":
        import msvcrt

        os.lseek(handle, LOCKED_BYTE, os.SEEK_SET)
        try:
            msvcrt.locking(handle, msvcrt.LK_NBLCK, 1)
        except OSError:
            return False
        finally:
            os.lseek(handle, 0, os.SEEK_SET)
        return True
    import fcntl

    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:  # a file system without locks
        return True
    return True


def without(table: Mapping[str, T], *names: str) -> dict[str, T]:
    """Return the entries of a table under all other names."""
    return {name: item for name, item in table.items() if name not in names}


def keeping(table: Mapping[str, T], *names: str) -> dict[str, T]:
    """Return the entries of a table under these names, in the order of the table."""
    return {name: item for name, item in table.items() if name in names}


def finite(value: Any) -> Any:
    """Return a document with plain Python numbers, and null for non-finite ones."""
    if type(value) is float:
        return value if math.isfinite(value) else None
    if value is None or type(value) in (str, int, bool):
        return value
    if isinstance(value, dict):
        return {key: finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [finite(item) for item in value]
    import numpy as np  # not at the top: `optlink --help` needs none

    if isinstance(value, np.ndarray):
        return finite(value.tolist())
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, enum.Enum):
        return value.value
    if isinstance(value, datetime.date | datetime.time):
        return value.isoformat()
    return None if isinstance(value, float) and not math.isfinite(value) else value


def head(schema: str, problem: Any, status: str) -> dict[str, Any]:
    """Return the common first entries of every JSON document about a problem file."""
    return {
        "schema": schema,
        "optlink": VERSION,
        "problem": problem.name,
        "title": problem.model.title,
        "problem_hash": problem.hash,
        "overrides": dict(problem.overrides),
        "seed": None,
        "status": status,
    }


def _read_only(value: Any) -> Any:
    """Return a view of an array that cannot be written to; any other value unchanged."""
    if type(value).__name__ == "ndarray":  # without an import of numpy, which takes time
        value = value.view()
        value.setflags(write=False)
    return value


class Frozen(dict[Any, Any]):
    """A dictionary of a result: it cannot be changed, and an unknown name is refused with the nearest."""

    def __missing__(self, name: Any) -> Any:
        raise UnknownName("unknown name", nearest(str(name), map(str, self)), key=str(name))

    def __reduce__(self) -> tuple[type[Frozen], tuple[dict[Any, Any]]]:
        """Return what copies and pickles are made from."""
        return type(self), (dict(self),)

    def _refuse(self, *args: Any, **more: Any) -> Any:
        raise TypeError("a result cannot be changed: change a copy, dict(...)")

    __setitem__ = __delitem__ = clear = pop = popitem = setdefault = update = _refuse

    def __ior__(self, other: Any) -> dict[Any, Any]:  # type: ignore[override,misc]
        return {**self, **other}


class Summary:
    """Base class of results, with a one-line `repr`: problem, status, validity, objective and certificate of the optimum.

    Dictionaries of a result cannot be changed, nor can their arrays.
    """

    def __post_init__(self) -> None:
        for item in dataclasses.fields(self):  # type: ignore[arg-type]
            if type(value := getattr(self, item.name)) is dict:
                object.__setattr__(self, item.name, Frozen({key: _read_only(entry) for key, entry in value.items()}))

    if not TYPE_CHECKING:  # a type checker knows the names

        def __getattr__(self, name: str) -> Any:
            """Refuse an unknown name with the closest one, and repeat the error of a property that failed."""
            from difflib import get_close_matches

            if hasattr(type(self), name):
                return object.__getattribute__(self, name)
            known = [*dir(type(self)), *type(self).__dataclass_fields__]
            close = get_close_matches(name, (one for one in known if not one.startswith("_")), n=1)
            hint = f'. Did you mean "{close[0]}"?' if close else ""
            raise AttributeError(f"{type(self).__name__} has no attribute {name!r}{hint}", name=name, obj=self)

    def _verdict(self) -> Iterable[str]:
        """Yield how the work ended, and whether its result is valid."""
        yield str(getattr(self, "status", ""))
        if (valid := getattr(self, "valid", None)) is not None:
            yield "valid" if valid else "not valid"

    def __repr__(self) -> str:
        words = [*self._verdict()]
        if isinstance(objective := getattr(self, "objective", None), float):
            words.append(f"objective {objective:.6g}")
        if (certificate := getattr(self, "certificate", None)) is not None:
            words.append(certificate.brief)
        problem = getattr(self, "problem", None)
        name = f" {problem.name!r}" if problem is not None else ""
        summary = ", ".join(filter(None, words))
        return f"<{type(self).__name__}{name}{f': {summary}' if summary else ''}>"


class Entry:
    """Base class of what extends optlink: a dataclass with a `name`, which `register` puts into the `registry` of its kind."""

    name: Any
    registry: ClassVar[dict[str, Any]]

    def __init_subclass__(cls) -> None:
        if Entry in cls.__bases__:
            cls.registry = {}

    def fault(self) -> tuple[str, str] | None:
        """Return what is wrong with the entry, and the remedy; None if nothing is."""
        return None

    def entered(self) -> None:
        """Adapt what depends on the registry, once the entry is in it."""


def register(*entries: Entry) -> None:
    """Add entries to optlink: limits, quantities, kinds of loads, back ends, dyads, kinds of problems and results, charts.

    Parameters
    ----------
    *entries : Entry
        Of the classes in `optlink.extending`.

    Raises
    ------
    InputError
        If an entry is faulty, or if its name is already taken.

    Examples
    --------
    >>> from optlink.extending import QuantityType, register
    >>> register(QuantityType("torque", "torque", ("peak",)))
    Traceback (most recent call last):
    optlink.errors.InputError: QuantityType = "torque": this name is already registered. Choose another name
    """
    for entry in entries:
        kind = type(entry).__name__
        if not isinstance(entry, Entry):
            raise InputError("not an entry", "Register one of the classes of optlink.extending", key="register", value=kind)
        fault = ("this name is already registered", "Choose another name") if entry.name in entry.registry else entry.fault()
        if fault is not None:
            raise InputError(*fault, key=kind, value=entry.name)
        entry.registry[entry.name] = entry
        entry.entered()


@functools.cache
def load_extensions() -> None:
    """Import the modules that installed packages name in the entry-point group `optlink.extensions`, once.

    A module that cannot be imported, or registers a faulty entry, is reported on standard error.
    """
    if not _extended():
        return
    from importlib.metadata import entry_points

    for entry in entry_points(group=GROUP):
        try:
            entry.load()
        except Exception as error:  # noqa: BLE001 - it is code of others
            message = f"the extension {entry.name} ({entry.value}) cannot be loaded: {type(error).__name__}: {error}"
            print(f"Warning: {message}. Repair or uninstall its package", file=sys.stderr)


def _extended() -> bool:
    """Return whether an installed package names the group: reading the metadata of all packages takes far longer."""
    for place in (path or "." for path in sys.path):
        if os.path.isfile(place):  # an archive
            return True
        with contextlib.suppress(OSError):
            for name in os.listdir(place):
                if not name.endswith((".dist-info", ".egg-info")):
                    continue
                about = Path(place, name, "entry_points.txt")
                if about.is_file() and GROUP.encode() in about.read_bytes():
                    return True
    return False
