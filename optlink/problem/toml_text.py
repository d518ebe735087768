"""Changes to the text of a problem file that keep its comments and layout."""

import contextlib
import tomllib
from collections.abc import Mapping
from typing import Any

from optlink.problem.base_model import with_ranges, with_spellings
from optlink.problem.file import WORDS


def tables(text: str) -> dict[str, Any]:
    """Return the nested tables of a problem file in the standard spelling; ValueError if the text is not valid TOML."""
    result: dict[str, Any] = with_ranges(with_spellings(tomllib.loads(text)), skip=WORDS)
    return result


def rewritten(text: str, old: Mapping[str, Any], new: Mapping[str, Any]) -> str:
    """Return a text with changed values of its nested tables, and with its comments, its spellings and its layout.

    A section whose layout cannot be kept is written again.
    """
    import tomli_w
    import tomlkit
    from tomlkit.exceptions import TOMLKitError

    for edit in (_edit, _replace_sections):
        with contextlib.suppress(TOMLKitError, LookupError, TypeError, ValueError):  # such as rare orders of tables
            if "format" in new and "format" not in tables(text):
                text = f"format = {new['format']}\n{text}"
            page = tomlkit.parse(text)
            edit(page, old, new)
            result = page.as_string()
            if _without_type(tables(result)) == _without_type(new):
                return result
    return tomli_w.dumps(new)


def _without_type(raw: Mapping[str, Any]) -> dict[str, Any]:
    """Return the tables of a problem without the type of its mechanism, which may be left out."""
    mechanism = raw.get("mechanism")
    if not isinstance(mechanism, Mapping):
        return dict(raw)
    return {**raw, "mechanism": {key: value for key, value in mechanism.items() if key != "type"}}


def _replace_sections(page: Any, old: Mapping[str, Any], new: Mapping[str, Any]) -> None:
    """Write the sections that differ again, at the end of the document."""
    import tomli_w
    import tomlkit

    for key in dict.fromkeys((*old, *new)):
        if old.get(key) != new.get(key):
            page.pop(key, None)
            if key in new:
                page.update(tomlkit.parse(tomli_w.dumps({key: new[key]})))


def _edit(place: Any, old: Any, new: Any) -> None:
    """Change a table or a list of a document where the values differ, in place."""
    from tomlkit import TOMLDocument, nl
    from tomlkit.items import AoT, Table

    named, top, last = isinstance(new, Mapping), isinstance(place, TOMLDocument), None
    sections = named and any(isinstance(item, AoT | Table) for item in place.values())
    if named:
        for key in old.keys() - new.keys():
            del place[key]
        kept = [key for key in old if key in new and key in place]  # a file can leave the type of its mechanism out
        last = next((key for key in reversed(kept) if not isinstance(place[key], AoT | Table)), None)
    for key, value in new.items() if named else enumerate(new):
        old_value = old.get(key) if named else old[key]
        if value == old_value:
            continue
        if old_value is not None and _alike(old_value, value, place[key]):
            _edit(place[key], old_value, value)
        elif sections and isinstance(value, Mapping) and not top:
            place.append(key, _item(value, section=True).add(nl()))
        elif old_value is not None or top or last is None:
            place[key] = _item(value, section=top)
        else:  # before the blank lines and the comment above the next section
            place.value._insert_after(last, key, _item(value))
            last = key


def _alike(*values: Any) -> bool:
    """Return whether values are all tables, or lists of equal length."""
    if all(isinstance(value, list) for value in values):
        return len(set(map(len, values))) == 1
    return all(isinstance(value, Mapping) for value in values)


def _item(value: Any, *, section: bool = False) -> Any:
    """Return a value as an item of a document: a table in one line, or as a section of its own."""
    import tomlkit

    if isinstance(value, Mapping):
        table = tomlkit.table() if section else tomlkit.inline_table()
        table.update({key: _item(item) for key, item in value.items()})
        return table
    if isinstance(value, list):
        array = tomlkit.array()
        array.extend(map(_item, value))
        return array
    return tomlkit.item(value)
