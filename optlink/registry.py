"""Registries of the parts that further modules can add, and loading of installed extensions.

Only installed Python packages can extend optlink, through the entry-point group `optlink.extensions`: problem files cannot name
code.
"""

from __future__ import annotations

import functools
import sys
from typing import TypeVar

GROUP = "optlink.extensions"
Item = TypeVar("Item")


class Registry(dict[str, Item]):
    """Parts by name, in the order of registration."""

    def add(self, name: str, item: Item) -> Item:
        """Register a part.

        Parameters
        ----------
        name : str
        item : Item

        Raises
        ------
        ValueError
            if the name is already taken.
        """
        if name in self:
            raise ValueError(f"{name!r} is already registered")
        self[name] = item
        return item


@functools.cache
def load_extensions() -> None:
    """Import the modules that installed packages name in the entry-point group `optlink.extensions`, once.

    A module that cannot be imported, or registers a name that is taken, is reported on standard error.
    """
    from importlib.metadata import entry_points

    for entry in entry_points(group=GROUP):
        try:
            entry.load()
        except (ImportError, AttributeError, ValueError) as error:
            message = f"the extension {entry.name} ({entry.value}) cannot be loaded: {error}"
            print(f"Warning: {message}. Repair or uninstall its package", file=sys.stderr)
