"""Namespaces of the Python interface: the stub beside each, `__init__.pyi`, lists its names, which are imported at first use."""

import importlib
import re
import sys
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any


def namespace(name: str, file: str) -> tuple[list[str], Callable[[str], Any], Callable[[], list[str]]]:
    """Return `__all__`, `__getattr__` and `__dir__` of a package.

    Its stub declares former names as deprecated; they are still found, with a DeprecationWarning that names the successor.

    Parameters
    ----------
    name, file : str
        `__name__` and `__file__` of the package.
    """
    text = Path(file).with_suffix(".pyi").read_text(encoding="utf-8")
    moved: dict[str, str] = dict(re.findall(r'^@deprecated\("\S+\.(\w+) is now (\S+)"\)$', text, re.MULTILINE))
    homes: dict[str, tuple[str, str]] = {}
    for module, names in re.findall(r"^from (\S+) import (\([^)]*\)|.*)$", text, re.MULTILINE):
        homes |= {shown: (module, own) for own, shown in re.findall(r"(\w+) as (\w+)", names)}

    def attribute(wanted: str) -> Any:
        package = sys.modules[name]
        if wanted in homes:
            module, own = homes[wanted]
            return importlib.import_module(f"{name}.{own}") if module == name else getattr(importlib.import_module(module), own)
        if (successor := moved.get(wanted)) is not None:
            warnings.warn(f"{name}.{wanted} is now {successor}", DeprecationWarning, stacklevel=2)
            home, _, own = successor.rpartition(".")
            return getattr(importlib.import_module(home), own)
        wanted_there = re.compile(rf"\bas {re.escape(wanted)}\b")
        inner = () if wanted.startswith("_") else sorted(Path(file).parent.glob("*/__init__.pyi"))
        homes_within = [
            f"{name}.{stub.parent.name}.{wanted}" for stub in inner if wanted_there.search(stub.read_text(encoding="utf-8"))
        ]
        hint = f". It is {' or '.join(homes_within)}" if homes_within else ""
        raise AttributeError(f"module {name!r} has no attribute {wanted!r}{hint}", name=wanted, obj=package)

    def listed() -> list[str]:
        return sorted({*homes, *(own for own in vars(sys.modules[name]) if own.startswith("__"))})

    return sorted(homes), attribute, listed
