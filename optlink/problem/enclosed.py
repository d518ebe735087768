"""Files to which a problem refers, CSV tables and SVG drawings, with their contents: read once, with the problem."""

import codecs
import copy
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from optlink.problem.quantity import Unusable
from optlink.problem.targets.target_points import enclosed, file_kind, read_file, split_enclosed
from optlink.problem.tolerances import read_tolerance


def references(raw: Any, within: str = "") -> Iterator[tuple[dict[str, Any], str, str]]:
    """Yield tables and keys that name another file, with its suffix; "" for the value of a tolerance.

    `raw`: tables and lists of a problem file, of the section `within`.
    """
    if isinstance(raw, list):
        for value in raw:
            yield from references(value, within)
    for key, value in raw.items() if isinstance(raw, dict) else ():
        if isinstance(value, str):
            measured = within == "tolerances" and read_tolerance(value, Path()).measured
            if measured or key in ("csv", "svg"):
                yield raw, key, "" if measured else key
        else:
            yield from references(value, within or key)


def enclosing(raw: Mapping[str, Any], folder: Path, known: Mapping[str, str]) -> tuple[dict[str, Any], dict[str, str]]:
    """Return the tables of a problem with the contents of files in place of their names, and the contents by name.

    Files that are not `known` are read; one that cannot be read keeps its name, so that the reader of its key refuses it.
    """
    tables: dict[str, Any] = copy.deepcopy(dict(raw))
    contents: dict[str, str] = {}
    for table, key, suffix in [*references(tables)]:
        source = table[key] if suffix else read_tolerance(table[key], folder).source
        name, content = split_enclosed(source)
        if not content and name in known:
            content = known[name]
        elif not content:
            try:
                content = _text(read_file({suffix or "csv": name}, suffix or "csv", folder)[1])
            except (Unusable, UnicodeDecodeError):
                continue
        contents[name], table[key] = content, enclosed(name, content)
    return tables, contents


def _text(data: bytes) -> str:
    """Return the text of a file; of one that is not UTF-8, with UTF-8 as the encoding that it declares.

    Raises
    ------
    UnicodeDecodeError
        If it is no text.
    """
    wide = data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    if not wide and (file_kind(data) or b"\0" in data):
        raise UnicodeDecodeError("utf-8", data[:1], 0, 1, "no text")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        declared = re.match(rb"""\s*<\?xml[^>]*encoding=["']([\w.-]+)""", data)
        text = data.decode("utf-16" if wide else _known(declared[1].decode()) if declared else "latin-1", errors="replace")
        return re.sub(r"""(<\?xml[^>]*encoding=)["'][^"']*["']""", r'\1"UTF-8"', text, count=1)


def _known(encoding: str) -> str:
    """Return the name of an encoding, or "latin-1" for one that Python does not know."""
    try:
        return codecs.lookup(encoding).name
    except LookupError:
        return "latin-1"
