"""Keys of the quantities of a problem in its file: of "link2.P.along" it is `mechanism.links.link2.points.P.along`."""

from collections.abc import Mapping
from typing import Any

from optlink.linkage.fourbar import LENGTHS


def write(mechanism: dict[str, Any], name: str, value: object) -> None:
    """Write one quantity into the section [mechanism] at its place.

    Parameters
    ----------
    mechanism : dict
        Section [mechanism] as nested tables, modified in place.
    name : str
        Name of the quantity.
    value : object
        New value as in a TOML file.
    """
    table, key = place_of(mechanism, name)
    table[key] = value


def place_of(mechanism: dict[str, Any], name: str) -> tuple[Any, str | int]:
    """Return the table or list of the section [mechanism] that contains a quantity, and its key or index there.

    Parameters
    ----------
    mechanism : dict
        Section [mechanism] as nested tables; a pivot that is not stated is added.
    name : str
        Name of the quantity.
    """
    *steps, last = key_path(mechanism, name)
    if steps == ["pivot"]:
        mechanism["pivot"] = list(mechanism.get("pivot") or ["0 mm", "0 mm"])
    table: Any = mechanism
    for step in steps:
        table = table[step]
    return table, last


def key_path(mechanism: Mapping[str, Any], name: str) -> list[str | int]:
    """Return the path of a quantity in the section [mechanism]: keys, and the index of a coordinate.

    Parameters
    ----------
    mechanism : mapping
        Section [mechanism] as nested tables.
    name : str
        Name of the quantity.
    """
    parts = name.split(".")
    if "links" not in mechanism:  # four-bar
        if name in (*LENGTHS, "direction"):
            return [name]
        if parts[0] == "A":
            return ["pivot", "xy".index(parts[1])]
        return ["points", parts[0], ("along", "across").index(parts[1])]
    if len(parts) == 3:
        return ["links", parts[0], "points", parts[1], ("along", "across").index(parts[2])]
    if parts[1] == "length":
        return ["links", parts[0], "length"]
    if parts[0] in mechanism["ground"]:
        return ["ground", parts[0], "xy".index(parts[1])]
    if parts[1] in ("x", "y"):
        return ["guides", parts[0], "through", "xy".index(parts[1])]
    return ["guides", *parts]


def file_key(mechanism: Mapping[str, Any], name: str) -> str:
    """Return the dotted key of a quantity in the problem file.

    Parameters
    ----------
    mechanism : mapping
        Section [mechanism] as nested tables.
    name : str
        Name of the quantity.
    """
    steps = key_path(mechanism, name)
    if isinstance(steps[-1], int):
        steps[-1] = name.rpartition(".")[2]
    return ".".join(("mechanism", *map(str, steps)))


def quantity_key(problem: Any, name: str) -> str:
    """Return the dotted key of a quantity of a problem in its file.

    Parameters
    ----------
    problem : Problem
    name : str
        Name of the quantity.
    """
    if name.startswith("tolerances."):
        return name
    for part in getattr(problem, "parts", ()):
        if part.prefix and name.startswith(part.prefix):
            return str(part.key) + quantity_key(part, name.removeprefix(part.prefix)).removeprefix("requirement")
    if name in ("phi0", "psi0", "start", "mark", "zero"):
        return f"requirement.{problem.requirement.key_of(problem, name)}"
    return file_key(vars(problem.mechanism), name)
