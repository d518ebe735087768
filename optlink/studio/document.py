"""The problem that is open on the page: its text with comments, and changes of single values."""

from __future__ import annotations

import base64
import binascii
import contextlib
import os
import stat
import tempfile
import tomllib
import zlib
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Generic, TypeVar

from optlink.errors import InputError
from optlink.problem import toml_text
from optlink.problem.enclosed import references
from optlink.problem.file import MAX_BYTES, ProblemFile, load, read, shipped
from optlink.problem.quantity import check_choice, file_key, quantity_key
from optlink.problem.renaming import renamed
from optlink.problem.targets.target_points import split_enclosed
from optlink.problem.templates import template, templates
from optlink.studies.grid import exact_text
from optlink.studio.design import Design
from optlink.version import VERSION

NO_FOLDER = Path(__file__)  # of a problem without files: below a file no other one can lie, whoever may write into which folder
SIZE_MARGIN = 0.5  # share of a size by which it may change where the file has no bounds for it


@dataclass(frozen=True)
class Document:
    """A problem file: its text, and where files that it names lie.

    `freed`: bounds, as written in the file, of the design variables that were locked.
    """

    name: str
    text: str
    folder: Path
    freed: Mapping[str, Any] = field(default_factory=dict)

    @cached_property
    def problem(self) -> ProblemFile:
        """The checked problem; InputError if the text is not a usable one."""
        return read(tables(self.text, self.file), self.name, self.file, self.folder)

    @property
    def files(self) -> list[str]:
        """Other files that the problem file names."""
        return [split_enclosed(table[key])[0] for table, key, _ in references(dict(self.problem.raw))]

    def message(self) -> dict[str, Any]:
        """Return the document as plain data, for `of`."""
        return {"name": self.name, "text": self.text, "folder": str(self.folder), "freed": dict(self.freed)}

    @classmethod
    def of(cls, message: Mapping[str, Any]) -> Document:
        """Return the document of a message."""
        return cls(message["name"], message["text"], Path(message["folder"]), message["freed"])

    @property
    def file(self) -> str:
        """Name of the file."""
        return f"{self.name}.toml"

    def changed_on_disk(self, known: Collection[str]) -> bool:
        """Return whether the file in its folder has other contents than these, as an editor has changed it."""
        file = self.folder / self.file
        return os.path.exists(file) and _file_text(file) not in known

    def with_changes(self, changes: Mapping[str, object]) -> Document:
        """Return the document with other values at dotted keys (see `ProblemFile.override`); comments and layout are kept."""
        if not changes:
            return self
        problem = self.problem.override(changes)
        return replace(self, text=toml_text.rewritten(self.text, self.problem.raw, problem.raw))

    def renamed(self, old: str, new: str) -> Document:
        """Return the document with another name for a part of the linkage (see `optlink.problem.renaming`)."""
        document = replace(self, text=renamed(self.text, self.problem, old, new))
        names = zip(self.problem.model.quantities, document.problem.model.quantities, strict=True)
        return replace(document, freed={now: self.freed[before] for before, now in names if before in self.freed})

    def locked(self, size: str, value: float | None) -> Document:
        """Return the document with a design variable fixed at a value [SI]; None for the starting value of the file."""
        quantity, key = self._quantity(size)
        self.check_not_linked(key)
        if not quantity.free:
            return self
        unit, value = quantity.display[1], quantity.value if value is None else value
        document = self.with_changes({key: exact_text(value / quantity.si_per_unit, unit)})
        return replace(document, freed={**self.freed, size: self.problem.at(key)})

    def released(self, size: str) -> Document:
        """Return the document with a fixed size as a design variable, within its former bounds."""
        quantity, key = self._quantity(size)
        if quantity.free:
            return self
        self.check_not_linked(key)
        per, unit = quantity.si_per_unit, quantity.display[1]
        value = quantity.value / per
        freed_text = self.freed.get(size)
        if not isinstance(freed_text, Mapping):
            room = SIZE_MARGIN * abs(value) or 100.0
            freed_text = {"bounds": [exact_text(value - room, unit), exact_text(value + room, unit)]}
        return self.with_changes({key: {**freed_text, "start": exact_text(value, unit)}})

    def check_not_linked(self, key: object) -> None:
        """Refuse the key of a linked quantity: it follows from others.

        Raises
        ------
        InputError
        """
        model = self.problem.model
        for name in model.links:
            if quantity_key(model, name) == key:
                message = f"{name} follows from other quantities: it equals {model.quantities[name].equals}"
                raise InputError(message, "Change those, or write a value in place of the link", self.file, str(key))

    def _quantity(self, size: str) -> Any:
        quantities = self.problem.model.mechanism.quantities
        if size not in quantities:
            raise InputError("no such dimension", f"Sizes: {', '.join(quantities)}", self.file, "lock", size)
        return quantities[size], file_key(self.problem.raw["mechanism"], size)


# --- opening ----------------------------------------------------------------------------------------------------------------


def named(name: str) -> Document:
    """Open a shipped problem by name, or a file by path.

    Raises
    ------
    InputError
        If it does not exist or is not usable.
    """
    path = shipped().get(name, Path(name))
    if os.path.exists(path) and not os.path.isfile(path) and not os.path.isdir(path):
        remedy = "Write it into a .toml file: the studio reads it again whenever a page is opened"
        raise InputError("this is a pipe or a device, not a file", remedy, name)
    problem, text = load(name), _file_text(path)
    if text is None:
        raise InputError("the file was changed while it was read", "Open it again", name)
    return Document(problem.name, text, problem.folder)


def _file_text(path: Path) -> str | None:
    """Return the text of a problem file; None if there is none, also for a pipe, which waits, and a device, which may not end."""
    with contextlib.suppress(OSError, ValueError), open(path, encoding="utf-8-sig", opener=_without_waiting) as stream:
        if stat.S_ISREG(os.fstat(stream.fileno()).st_mode) and len(text := stream.read(MAX_BYTES + 1)) <= MAX_BYTES:
            return text
    return None


def _without_waiting(path: str, flags: int) -> int:
    return os.open(path, flags | getattr(os, "O_NONBLOCK", 0))


def shipped_problem(name: str) -> Document:
    """Open a shipped problem: a page may name no other file of this machine."""
    check_choice("name", name, shipped(), "no such shipped problem")
    return named(name)


def from_template(name: str) -> Document:
    """Open a template as a new problem."""
    return Document(name, template(name).text, NO_FOLDER)


def from_text(text: str, title: str) -> Document:
    """Open a text of unknown origin: it must not name other files.

    Raises
    ------
    InputError
        If the text is too long, is not a usable problem, or names another file.
    """
    name = "".join(sign for sign in Path(title).stem if sign.isalnum() or sign in "-_")[:60] or "problem"
    file = f"{name}.toml"
    if len(text.encode(errors="replace")) > MAX_BYTES:
        raise InputError(f"the text is longer than {MAX_BYTES:,} bytes", "Open a shorter file", file)
    raw = tables(text, file)
    file_reference = next((split_enclosed(table[key])[0] for table, key, _ in references(raw)), None)
    if file_reference is not None:
        remedy = f"Open it from its folder: optlink studio {file}"
        raise InputError("a problem that is opened in the page cannot read other files", remedy, file, value=file_reference)
    document = Document(name, text, NO_FOLDER)
    _ = document.problem
    return document


def hello(opened: str | None) -> dict[str, Any]:
    """Return the first message to a page: what it can open, and the problem that is opened without its request."""
    problems = []
    for name, path in shipped().items():
        raw = tomllib.loads(path.read_text(encoding="utf-8"))
        requirement: dict[str, Any] = raw.get("requirement") or next(iter(raw.get("requirements") or []), {})
        kind = requirement.get("kind") or ("machine" if "objective" in raw else "analysis")
        problems.append({"name": name, "title": raw.get("title", name), "kind": kind})
    drafts = [{"name": name, "title": template(name).summary} for name in templates()]
    return {"type": "hello", "version": VERSION, "problems": problems, "templates": drafts, "opened": opened}


def tables(text: str, file: str) -> dict[str, Any]:
    """Return the nested tables of a text in the standard spelling; errors name the file.

    Raises
    ------
    InputError
        If the text is not valid TOML.
    """
    try:
        return toml_text.tables(text)
    except (tomllib.TOMLDecodeError, ValueError, RecursionError) as error:
        reason = "nested too deeply" if isinstance(error, RecursionError) else str(error)
        raise InputError(f"the text is not valid TOML: {reason}", "Correct the text", file) from None


# Undo and redo: the steps of a document. The server keeps a copy, so that a failed computation does not lose them.

Step = TypeVar("Step")

MAX_STEPS = 200


class History(Generic[Step]):
    """Documents in the order of their changes, and the index of the present one."""

    def __init__(self, steps: Sequence[Step], at: int) -> None:
        self.steps, self.at = list(steps), at

    @property
    def present(self) -> Step:
        """The present document."""
        return self.steps[self.at]

    def add(self, document: Step) -> None:
        """Add a step after the present one, and drop what was undone."""
        self.steps[self.at + 1 :] = [document]
        del self.steps[:-MAX_STEPS]
        self.at = len(self.steps) - 1

    def move(self, step: int) -> None:
        """Undo (-1) or redo (+1) a step, if there is one."""
        self.at = min(max(self.at + step, 0), len(self.steps) - 1)

    @property
    def ends(self) -> tuple[bool, bool]:
        """Whether a step can be undone, and redone."""
        return self.at > 0, self.at < len(self.steps) - 1


# Exports of the studio: drawings, tables and the report of the present design, and links that contain the problem.

FORMATS = {
    "dxf": ("drawing", "image/vnd.dxf"),
    "svg": ("drawing", "image/svg+xml"),
    "parts.svg": ("parts", "image/svg+xml"),
    "parts.dxf": ("parts", "image/vnd.dxf"),
    "parts.stl": ("parts", "model/stl"),
    "parts.3mf": ("parts", "model/3mf"),
    "sheet.pdf": ("sheet", "application/pdf"),
    "csv": ("motion", "text/csv"),
    "html": ("", "text/html"),
}
"""Endings of the files, with their contents (see `optlink.presentation.export.export.FORMATS`) and media types."""


def exported(design: Design, document: Document, format: str) -> dict[str, Any]:
    """Return a file of a design: its name, media type and contents, in base 64.

    Raises
    ------
    InputError
        If the format is unknown, the design cannot be drawn, or parts of a design that is not valid are asked for.
    """
    if format not in FORMATS:
        raise InputError("unknown format", f"One of: {', '.join(FORMATS)}", key="format", value=format)
    from optlink.presentation.export.export import Options, export
    from optlink.presentation.html.page import page
    from optlink.studio.parts import model_of

    content, media = FORMATS[format]
    model = model_of(design, document.problem)
    if content == "parts" and not model.valid:
        raise InputError(f"{model.verdict}. Nothing was written", "Change the problem until the design is valid", document.file)
    if content:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / f"{document.name}.{format}"
            export(model, path, Options(content=content))
            data = path.read_bytes()
    else:
        data = page(model).encode()
    return {"name": f"{document.name}.{format}", "media": media, "data": base64.b64encode(data).decode()}


def deflated(text: str) -> str:
    """Return a text, compressed, in the letters of a link."""
    return base64.urlsafe_b64encode(zlib.compress(text.encode(), 9)).decode().rstrip("=")


def inflated(fragment: str) -> str:
    """Return the text of a link.

    Raises
    ------
    InputError
        If it is not a compressed text, or too long.
    """
    try:
        data = base64.urlsafe_b64decode(fragment + "=" * (-len(fragment) % 4))
        unpacker = zlib.decompressobj()
        text = unpacker.decompress(data, MAX_BYTES + 1)
        if len(text) > MAX_BYTES:
            raise InputError(f"the problem of the link is longer than {MAX_BYTES:,} bytes", "Open its file instead")
        if not unpacker.eof:
            raise ValueError
        return text.decode()
    except InputError:
        raise
    except (ValueError, binascii.Error, zlib.error):
        raise InputError("the link contains no problem", "Copy the whole link") from None
