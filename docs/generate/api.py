"""Reference of the Python interface: signatures and docstrings, read by griffe without importing a module.

After the name of a parameter a docstring states words and units, not a Python type: `crank, frame : float [m], positive` would be
read as one annotation of two parameters. Here each parameter, and each returned value, gets the annotation and the default of the
signature, and the words begin its description.
"""

from __future__ import annotations

import functools
import re
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any

import griffe

ROOT = Path(__file__).resolve().parents[2]
LINE = 100  # characters of a signature in one line

HEADING = re.compile(r"-{3,}")
ENTRY = re.compile(r"(?P<names>\*{0,2}\w+(?:, \*{0,2}\w+)*)(?: : (?P<words>.+))?")
RETURNED = re.compile(r"(?:(?P<names>\w+(?:, \w+)*) : )?(?P<words>.+)")
ENTRIES = {"Parameters": (ENTRY, "{}"), "Returns": (RETURNED, "{} :"), "Yields": (RETURNED, "{} :")}
"""Sections with types: their entries, and how an entry is written without one."""
NAMED = r"(?:float|int|str|bool|None|object|mapping|sequence|list|tuple|iterable|collection|[A-Z]\w+)"
PLAIN = re.compile(rf"{NAMED}(?:,? (?:or|of|to) {NAMED}|, {NAMED})*(?:, optional)?(?= \[|$) ?")
"""A type that the signature says as well, alone or before the unit."""
FACTORY = re.compile(r"\(lambda: (.+)\)\(\)")
"""A default that is made anew for each object."""
STORED, ROWS = "optlink.problem.document", "NDArray[np.float64]"
AS_READ = {
    **dict.fromkeys((f"{STORED}.Never", f"{STORED}.Number"), "float"),
    **dict.fromkeys((f"{STORED}.Column", f"{STORED}.Rows", "optlink.tasks.results.certificate.History"), ROWS),
    "optlink.tasks.results.certificate.DrawnCovers": "tuple[Cover, ...]",
}
"""Types of fields of results, whose names say how a document is read, and what the fields are."""
TEXT = re.compile(r"Annotated\[(.+), '(.+)'\]")
"""The annotation of an option, see `optlink.execution.options`: its type and what it is."""


def spelled(text: str) -> str:
    """A docstring whose entries stand one by one, without a type, their words at the beginning of what is said of them."""
    lines, found = text.split("\n"), []
    section, at = "", 0
    while at < len(lines):
        line = lines[at]
        at += 1
        if at < len(lines) and HEADING.fullmatch(lines[at].strip()):
            section = line.strip()
        pattern, form = ENTRIES.get(section, (None, ""))
        match = None if pattern is None or line == section or HEADING.fullmatch(line) else pattern.fullmatch(line)
        if match is None:
            found.append(line)
            continue
        body = []
        while at < len(lines) and lines[at].startswith("    "):
            body.append(lines[at])
            at += 1
        for name in (match["names"] or "").split(", "):
            found += [form.format(name).strip(), *_described(match["words"] or "", body)]
    return "\n".join(found)


def _described(words: str, body: list[str]) -> list[str]:
    words = words.strip("{}")
    further = PLAIN.sub("", words, count=1) if PLAIN.match(words) else words
    if not further:
        return body or [f"    {words}"]
    return [f"    {further}{'.' if body and not further.endswith('.') else ''}", *body]


class Words(griffe.Extension):  # type: ignore[misc, unused-ignore]  # griffe belongs to the documentation alone
    """Rewrite docstrings before they are read."""

    def on_object(self, *, obj: griffe.Object, **_: Any) -> None:
        """Every function and class that has a docstring."""
        if obj.docstring is not None and any(f"{title}\n---" in obj.docstring.value for title in ENTRIES):
            obj.docstring.value = spelled(obj.docstring.value)


@functools.cache
def package() -> Any:
    """Return optlink as griffe reads it."""
    words = griffe.load_extensions(Words())
    return griffe.load("optlink", search_paths=[ROOT], docstring_parser="numpy", extensions=words)


def reference(path: str, without: Collection[str] = ()) -> str:
    """Return the section of a function, class or module of optlink as Markdown.

    Parameters
    ----------
    path : str
        "optlink.solve"
    without : collection of str, optional
        Members of a module that another section has.
    """
    return "\n\n".join(_section(_found(package()[path.removeprefix("optlink.")]), "##", "", without))


def _found(item: Any) -> Any:
    return item.final_target if item.is_alias else item


def _section(item: Any, level: str, owner: str, without: Collection[str] = ()) -> Iterator[str]:
    name = item.path if item.is_module else owner + item.name
    yield f"{level} {name}"
    if not item.is_module and not _is_enum(item):
        yield f"```python\n{_signature(item, owner)}\n```"
    yield from _told(item)
    if _is_enum(item):
        yield f"Values: {', '.join(str(one.value) for one in item.members.values() if one.is_attribute and one.value)}".replace(
            "'", '"'
        )
    shown = [one for name, one in item.members.items() if not (one.is_alias or name.startswith("_")) and _meaning(one)]
    hidden = without if item.name == "Result" else ("to_dict", *without)
    shown = [one for one in shown if one.name not in hidden]
    plain = [one for one in shown if one.is_attribute]
    if plain:
        rows = [f"| `{one.name}` | {cell(code(one.annotation))} | {cell(_meaning(one))} |" for one in plain]
        yield "\n".join(["| attribute | type | meaning |", "|---|---|---|", *rows])
    for one in shown:
        if one.is_function or one.is_class:
            yield from _section(one, level + "#", "" if item.is_module else f"{name}.")


def _meaning(item: Any) -> str:
    """The docstring of a member without its errors, or the text in its annotation."""
    if item.docstring:
        return str(item.docstring.value).partition("\n\nRaises\n---")[0]
    text = TEXT.fullmatch(str(item.annotation)) if item.is_attribute else None
    return text[2] if text else ""


def _is_enum(item: Any) -> bool:
    return item.is_class and any("Enum" in str(base) for base in item.bases)


def _is_named_tuple(item: Any) -> bool:
    return item.is_class and any(str(base) == "NamedTuple" for base in item.bases)


def _signature(item: Any, owner: str) -> str:
    """Return a signature as it stands in a stub, with a line for each parameter if it is long."""
    parts: list[str] = []
    seen: set[str] = set()
    for one in item.members.values() if _is_named_tuple(item) else ():
        if one.is_attribute and not one.is_alias and "instance-attribute" in one.labels:
            parts.append(f"{one.name}: {_type(one.annotation)}{f' = {one.value}' if one.value is not None else ''}")
    for one in item.parameters:
        kind = one.kind.value if one.kind else ""
        if kind == "keyword-only" and not seen & {kind, "variadic positional"}:
            parts.append("*")
        seen.add(kind)
        if one.name in ("self", "cls"):
            continue
        mark = {"variadic positional": "*", "variadic keyword": "**"}.get(kind, "")
        typed = f": {_type(one.annotation)}" if one.annotation is not None else ""
        default = _default(one.default)
        default = (f" = {default}" if typed else f"={default}") if one.default is not None and not mark else ""
        parts.append(f"{mark}{one.name}{typed}{default}")
    head = ("class " if item.is_class else "") + owner + item.name
    tail = f" -> {item.returns}" if item.is_function and item.returns is not None else ""
    line = f"{head}({', '.join(parts)}){tail}"
    return line if len(line) <= LINE else "\n    ".join([f"{head}(", *(f"{part}," for part in parts)]) + f"\n){tail}"


def _told(item: Any) -> Iterator[str]:
    """The docstring of an item as Markdown, section by section."""
    for section in item.docstring.parse("numpy", warnings=False) if item.docstring else ():
        kind = section.kind.value
        if kind == "text":
            yield section.value
        elif kind == "examples":
            yield from (text if part.value == "text" else f"```pycon\n{text}\n```" for part, text in section.value)
        elif kind == "admonition":
            yield f"**{section.title}.** {section.value.contents}"
        else:
            yield f"**{kind.replace('_', ' ').capitalize()}**"
            yield "\n".join(_entry(one) for one in section.value)


def _entry(one: Any) -> str:
    name = getattr(one, "name", "")
    default = getattr(one, "default", None)
    stated = default not in (None, "None") and not name.startswith("**")
    typed = (
        f" ({code(one.annotation)}{f', default {code(_default(default))}' if stated else ''})"
        if one.annotation is not None
        else ""
    )
    if not name:
        name, typed = str(one.annotation), ""
    told = " ".join(one.description.split())
    if one.annotation is not None and _letters(told.replace(" of ", " ")) == _letters(_type(one.annotation)):
        told = ""  # the type again
    return f"- `{name}`{typed}: {told}".removesuffix(": ")


def _default(default: Any) -> str:
    """A default as the program has it, a constant by its value."""
    if isinstance(default, griffe.ExprName) and default.name.isupper():
        for path in (default.canonical_path, f"{getattr(default.parent, 'path', '')}.{default.name}"):
            try:
                value = str(_found(package()[path.removeprefix("optlink.")]).value)
            except (KeyError, AttributeError, griffe.AliasResolutionError):
                continue
            if "(" not in value:
                return value
    return FACTORY.sub(r"\1", str(default))


def _letters(text: str) -> str:
    return re.sub("[^a-z]", "", text.lower())


def _type(text: Any) -> str:
    plain = re.sub(r"\bUnpack\[(\w+)\]", r"\1", str(text))
    plain = re.sub(r"\bAnnotated\[(\w+), .*\]", r"\1", TEXT.sub(r"\1", plain))  # without how it is read
    for one in text.iterate(flat=True) if isinstance(text, griffe.Expr) else ():
        if isinstance(one, griffe.ExprName) and one.canonical_path in AS_READ:
            plain = re.sub(rf"\b{one.name}\b", AS_READ[one.canonical_path], plain)
    return plain


def code(text: Any) -> str:
    """Return a type as code."""
    return f"`{_type(text)}`" if text is not None else ""


def cell(text: str) -> str:
    """Return a text as the cell of a table."""
    return " ".join(text.split()).replace("|", "\\|")
