"""Files that are complete or not there: everything is written to a temporary name beside its place, then renamed."""

from __future__ import annotations

import contextlib
import json
import os
import tempfile
from collections.abc import Iterator
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
    temporary = None
    try:
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.stem[:40]}-", suffix=path.suffix)
        os.close(handle)
        temporary = Path(name)
        yield temporary
        temporary.chmod(0o644)
        temporary.replace(path)
    except OSError as error:
        raise InputError(
            Fault(f"cannot write the file: {error.strerror}", "Free some space or choose another folder", str(path))
        ) from None
    finally:
        if temporary is not None:
            temporary.unlink(missing_ok=True)


def write_json(path: Path, document: dict[str, Any]) -> None:
    """Write a JSON document."""
    with whole(path) as temporary:
        temporary.write_text(json.dumps(document, indent=2, ensure_ascii=False) + "\n", encoding="utf-8")
