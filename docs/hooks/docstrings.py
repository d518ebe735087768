"""Docstrings as the house writes them, for pages: after the name of a parameter stand words and units, not a Python type.

`crank, frame : float [m], positive` would be read as one annotation of two parameters. Here each parameter gets the annotation
and the default of the signature, and the words begin its description.
"""

from __future__ import annotations

import re
from typing import Any

import griffe

HEADING = re.compile(r"-{3,}")
PARAMETER = re.compile(r"(?P<names>\*{0,2}\w+(?:, \*{0,2}\w+)*) : (?P<words>.+)")
PLAIN = re.compile(r"(?:float|int|str|bool|Value)(?= \[)\s*")
"""A type that the signature says as well, before the unit."""


def spelled(text: str) -> str:
    """A docstring whose parameters stand one by one, without a type, their words at the beginning of what is said of them."""
    lines, found = text.split("\n"), []
    section, at = "", 0
    while at < len(lines):
        line = lines[at]
        at += 1
        if at < len(lines) and HEADING.fullmatch(lines[at].strip()):
            section = line.strip()
        match = PARAMETER.fullmatch(line) if section == "Parameters" else None
        if match is None:
            found.append(line)
            continue
        body = []
        while at < len(lines) and lines[at].startswith("    "):
            body.append(lines[at])
            at += 1
        for name in match["names"].split(", "):
            found += [name, *_described(match["words"], body)]
    return "\n".join(found)


def _described(words: str, body: list[str]) -> list[str]:
    words = PLAIN.sub("", words.strip("{}"))
    if re.fullmatch(r"[\w.]+(?:, optional)?", words):
        return body or [f"    {words}"]
    return [f"    {words}{'.' if body and not words.endswith('.') else ''}", *body]


class Words(griffe.Extension):  # type: ignore[misc, unused-ignore]  # griffe belongs to the documentation alone
    """Rewrite docstrings before they are read."""

    def on_object(self, *, obj: griffe.Object, **_: Any) -> None:
        """Every function and class that has a docstring."""
        if obj.docstring is not None and "Parameters\n---" in obj.docstring.value:
            obj.docstring.value = spelled(obj.docstring.value)
