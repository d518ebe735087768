"""Completion of arguments in the shell: problems, templates, keys of --set. Nothing heavy is imported, no file is checked."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import typer

from optlink.io import data_files


def problem_names(incomplete: str) -> list[str]:
    """Return the shipped problems, and the TOML files and folders whose path begins so."""
    names = [name for name in data_files("problems") if name.startswith(incomplete)]
    folder = Path(incomplete if incomplete.endswith("/") else f"{incomplete}x").parent
    try:
        inside = sorted(folder.iterdir())
    except OSError:
        return names
    places = [f"{path}/" for path in inside if path.is_dir()] + [str(path) for path in inside if path.suffix == ".toml"]
    return names + [place for place in places if place.startswith(incomplete) and not Path(place).name.startswith(".")]


def template_names(incomplete: str) -> list[str]:
    """Return the templates whose name begins so."""
    return [name for name in data_files("templates") if name.startswith(incomplete)]


def keys(context: typer.Context, incomplete: str) -> list[str]:
    """Return the keys of the problem on the command line that begin with `incomplete`, each with "=", for --set."""
    import tomllib

    text = str(context.params.get("problem") or next(iter(context.args), ""))  # the arguments of an unfinished line
    try:
        tables = tomllib.loads(data_files("problems").get(text, Path(text)).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return []
    return [f"{key}=" for key in _leaves(tables) if key.startswith(incomplete) and not key.startswith(("expected.", "about"))]


def _leaves(table: Mapping[str, Any], above: str = "") -> Iterator[str]:
    """Yield the dotted keys of all values that are not tables."""
    for name, value in table.items():
        if isinstance(value, Mapping) and not {"start", "bounds", "equals"} & set(value):
            yield from _leaves(value, f"{above}{name}.")
        else:
            yield f"{above}{name}"
