"""Namespaces of the Python interface: each lists its names with their modules, and imports a name at first use."""

import importlib
import sys
import warnings
from collections.abc import Callable
from typing import Any


def namespace(name: str, names: str, moved: str = "") -> tuple[list[str], Callable[[str], Any], Callable[[], list[str]]]:
    """Return `__all__`, `__getattr__` and `__dir__` of a package; its stub declares the same names for type checkers.

    Parameters
    ----------
    name : str
        `__name__` of the package.
    names : str
        Public names: `module: name name ...`, where the module may be the package itself, whose modules these are then.
    moved : str
        Former names: `successor: name name ...`. They are still found, with a DeprecationWarning that names the successor.
    """
    homes, successors = by_name(names), by_name(moved)

    def attribute(wanted: str) -> Any:
        if (module := homes.get(wanted)) is not None:
            if module == name:
                return importlib.import_module(f"{name}.{wanted}")
            return getattr(importlib.import_module(module), wanted)
        if (successor := successors.get(wanted)) is not None:
            warnings.warn(f"{name}.{wanted} is now {successor}", DeprecationWarning, stacklevel=2)
            home, _, own = successor.rpartition(".")
            return getattr(importlib.import_module(home), own)
        inner = () if wanted.startswith("_") else sorted(own for own, module in homes.items() if module == name)
        found = [f"{name}.{own}.{wanted}" for own in inner if wanted in importlib.import_module(f"{name}.{own}").__all__]
        hint = f". It is {' or '.join(found)}" if found else ""
        raise AttributeError(f"module {name!r} has no attribute {wanted!r}{hint}", name=wanted, obj=sys.modules[name])

    def listed() -> list[str]:
        return sorted({*homes, *(own for own in vars(sys.modules[name]) if own.startswith("__"))})

    return sorted(homes), attribute, listed


def by_name(table: str) -> dict[str, str]:
    """Return what stands before the colon, by each of the names behind it."""
    found, home = {}, ""
    for word in table.split():
        if word.endswith(":"):
            home = word.removesuffix(":")
        else:
            found[word] = home
    return found
