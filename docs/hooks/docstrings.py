"""Docstrings as the house writes them, for pages: after the name of a parameter stand words and units, not a Python type.

`crank, frame : float [m], positive` would be read as one annotation of two parameters. Here each parameter, and each returned
value, gets the annotation and the default of the signature, and the words begin its description.
"""

from __future__ import annotations

import re
from typing import Any

import griffe

HEADING = re.compile(r"-{3,}")
ENTRY = re.compile(r"(?P<names>\*{0,2}\w+(?:, \*{0,2}\w+)*)(?: : (?P<words>.+))?")
RETURNED = re.compile(r"(?:(?P<names>\w+(?:, \w+)*) : )?(?P<words>.+)")
ENTRIES = {"Parameters": (ENTRY, "{}"), "Returns": (RETURNED, "{} :"), "Yields": (RETURNED, "{} :")}
"""Sections with types: their entries, and how an entry is written without one."""
NAMED = r"(?:float|int|str|bool|None|object|mapping|sequence|list|tuple|iterable|collection|[A-Z]\w+)"
PLAIN = re.compile(rf"{NAMED}(?:,? (?:or|of|to) {NAMED}|, {NAMED})*(?:, optional)?(?= \[|$) ?")
"""A type that the signature says as well, alone or before the unit."""


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
