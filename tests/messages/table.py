"""The table of messages: what is refused, from a problem file or a command, and the whole sentence that says so.

After a message was reworded, `python -m tests.messages.table` writes the sentences anew; read the difference.
"""

from __future__ import annotations

import copy
import json
import math
import os
import re
import tempfile
import tomllib
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from typer.testing import CliRunner

import optlink
from optlink.cli.app import app

HERE = Path(__file__).parent
Entry = dict[str, Any]


def read(name: str) -> Entry:
    return tomllib.loads((HERE / name).read_text(encoding="utf-8"))


def altered(raw: Entry, entry: Entry) -> Entry:
    """A problem with the dotted keys of an entry set or removed; the elements of a list have their number as key."""
    raw = copy.deepcopy(dict(raw))
    for key, value in (entry.get("set", {}) | dict.fromkeys(entry.get("remove", ()))).items():
        *parents, last = key.split(".")
        section: Any = raw
        for name in parents:
            section = section[int(name)] if isinstance(section, list) else section.setdefault(name, {})
        if value is None:
            del section[last]
        else:
            section[int(last) if isinstance(section, list) else last] = value
    return raw


def with_files(entry: Entry, folder: Path) -> None:
    """Write the files of an entry; their bytes are the characters of its texts."""
    for name, text in entry.get("files", {}).items():
        (folder / name).write_bytes(text.encode("latin-1"))


def load(entry: Entry, bases: Entry, folder: Path) -> optlink.ProblemFile:
    with_files(entry, folder)
    name = entry.get("problem")
    if name in optlink.shipped() and "files" not in entry:
        return optlink.load(name, entry.get("set", {}) | dict.fromkeys(entry.get("remove", ())))
    if name is not None and name.endswith(".toml"):
        return optlink.load(folder / name)
    base = bases[name] if name in bases else optlink.load(name).raw if name else {}
    return optlink.read(altered(base, entry), folder=folder)


def faults(entry: Entry, bases: Entry, folder: Path) -> list[optlink.errors.Fault]:
    """What is wrong with a problem, without the names of files that differ from run to run."""
    try:
        load(entry, bases, folder)
    except optlink.InputError as error:
        assert error.exit_code == 2
        return [replace(fault, file=fault.file and Path(fault.file).name) for fault in error.faults]
    return []


def command(words: list[str], *more: str) -> Any:
    return CliRunner().invoke(app, [*words, *more], env={"COLUMNS": "80"})


def with_json(words: list[str]) -> list[str]:
    """The command with `--json`, which must not stand between an option and its value."""
    at = len(words) if len(words) == 1 or (words[-2].startswith("-") and "=" not in words[-2]) else len(words) - 1
    return [*words[:at], "--json", *words[at:]]


# --- writing the table -------------------------------------------------------------------------------------------------------


def toml(value: object) -> str:
    if isinstance(value, Mapping):
        keys = {key: key if re.fullmatch(r"[\w-]+", key, re.ASCII) else json.dumps(key) for key in value}
        return "{ " + ", ".join(f"{keys[key]} = {toml(one)}" for key, one in value.items()) + " }" if value else "{}"
    if isinstance(value, str) and '"' in value and "'" not in value and value.isprintable():
        return f"'{value}'"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(toml, value)) + "]"
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    return json.dumps(value, ensure_ascii=isinstance(value, str) and not value.isprintable())


def write(name: str, entries: Entry) -> None:
    blocks = [
        f"[{json.dumps(title)}]\n" + "".join(f"{key} = {toml(value)}\n" for key, value in entry.items())
        for title, entry in entries.items()
    ]
    (HERE / name).write_text("\n".join(blocks), encoding="utf-8")


def record() -> None:
    bases, before = read("bases.toml"), Path.cwd()
    for name in ("problems.toml", "commands.toml"):
        entries = read(name)
        for title, entry in entries.items():
            with tempfile.TemporaryDirectory() as folder:
                os.chdir(folder)
                try:
                    if name == "problems.toml":
                        says = [str(replace(fault, file=None)) for fault in faults(entry, bases, Path(folder))]
                    else:
                        with_files(entry, Path(folder))
                        says = command(entry["run"]).stderr.replace("Error: ", "").splitlines()
                finally:
                    os.chdir(before)
            assert says, f"{title} is not refused"
            entry["says"] = says[0] if len(says) == 1 else says
        write(name, entries)


if __name__ == "__main__":
    record()
