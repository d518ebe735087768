"""Assignments KEY=VALUE of the command line, such as those of `--set` and `--design`."""

import contextlib
import os
import re
import tomllib
from collections.abc import Sequence

from optlink.errors import InputError
from optlink.units import plain, split, split_range

EXPECTED = {
    "--set": ("KEY=VALUE", 'Write for example mechanism.frame="480 mm"'),
    "--design": (
        "NAME=VALUE or a result.json",
        'Write for example coupler="400 mm", or give a result.json that `solve --out` wrote',
    ),
}
"""What the value of an option must be, and its remedy."""


def parse_assignments(texts: Sequence[str], option: str = "--set") -> dict[str, object]:
    """Read assignments KEY=VALUE of different keys; `option` is that of the command, for errors.

    Raises
    ------
    InputError
    """
    values: dict[str, object] = {}
    for key, value in (parse_assignment(text, option) for text in texts):
        if key in values:
            raise InputError("the key is given twice", "Give every key once", key=f"{option} {key}", value=value)
        values[key] = value
    return values


def parse_assignment(text: str, option: str = "--set") -> tuple[str, object]:
    """Split KEY=VALUE; the value is read as TOML, or as plain text if it is not TOML (quotes are optional).

    Raises
    ------
    InputError
        when there is no "=" or no key, or when a list or table is malformed.
    """
    key, equals, value = text.partition("=")
    key, value = key.strip(), value.strip()
    if not equals or not key or not value:
        words, remedy = EXPECTED.get(option, EXPECTED["--set"])
        result = os.path.join(text.strip(), "result.json")
        remedy = f"Write {option} {result}" if option == "--design" and os.path.isfile(result) else remedy
        raise InputError(f"expected {words}", remedy, key=option, value=text)
    try:
        read_back = tomllib.loads(f"value = {value}")
    except (tomllib.TOMLDecodeError, ValueError, RecursionError):
        repaired = _BARE.sub(_quoted, value) if value[0] in "[{" and len(value) <= MOST_BARE else plain(value)
        with contextlib.suppress(tomllib.TOMLDecodeError, ValueError, RecursionError):
            if repaired != value:
                return key, tomllib.loads(f"value = {repaired}")["value"]
        if value[0] in "[{\"'":
            remedy = f"""Put it into single quotes, and texts in it into double quotes: {option} '{key}=["40 deg", "140 deg"]'"""
            raise InputError("the value is not valid TOML", remedy, key=key, value=value) from None
        return key, value
    if len(read_back) > 1:
        raise InputError("a value must be on one line", f"Repeat {option} for every key", key=key, value=value)
    return key, read_back["value"]


_BARE = re.compile(r"""(?<=[\[,=])(\s*)([^\s\[\]{},="'](?:[^\[\]{},="']*[^\s\[\]{},="'])?)(?=\s*[\],}])""")
MOST_BARE = 1000
"""Longest list or table, in characters, in which the shell may have removed the quotes."""


def _quoted(bare: re.Match[str]) -> str:
    """Put the quotes back around a name, a quantity or a range; numbers and logical values have none."""
    text = bare[2]
    parts = split(text)
    if text in ("true", "false") or (parts is not None and not parts[1]):
        return bare[0]
    is_name = re.fullmatch(r"[A-Za-z][\w -]*", text) is not None
    return f'{bare[1]}"{text}"' if is_name or parts is not None or split_range(text) is not None else bare[0]
