"""Names, kinds and titles of the shipped problems, without the models that check a file: these take longer to load."""

import tomllib
from collections.abc import Mapping
from typing import Any, NamedTuple

from optlink.io import data_files

COMMANDS = {"analysis": "analyze"}
"""Commands by kind of task, other than `solve`."""


class Entry(NamedTuple):
    """A shipped problem: its name, the type of its linkage, the kind of its task, and its title."""

    name: str
    linkage: str
    purpose: str
    title: str

    @property
    def kind(self) -> str:
        """Type of the linkage and kind of the task, as `ProblemFile.kind`."""
        return f"{self.linkage}, {self.purpose}"

    @property
    def command(self) -> str:
        """Command that answers it."""
        return f"optlink {COMMANDS.get(self.purpose, 'solve')} NAME"


def overview() -> list[Entry]:
    """Return the shipped problems in the order of their names."""
    entries = []
    for name, path in data_files("problems").items():
        raw = tomllib.loads(path.read_text(encoding="utf-8"))
        entries.append(Entry(name, linkage_type(raw), _purpose(raw), raw["title"]))
    return entries


def linkage_type(raw: Mapping[str, Any]) -> str:
    """Return the type of a linkage, also where the file leaves it out: dyads if it has links, ground or guides, else four-bar."""
    mechanism = raw["mechanism"]
    return str(mechanism.get("type", "dyads" if {"links", "ground", "guides"} & set(mechanism) else "four-bar"))


def _purpose(raw: Mapping[str, Any]) -> str:
    if "requirement" in raw:
        return f"{raw['requirement'].get('kind', 'function')} design"
    if "requirements" in raw:
        return f"{' and '.join(dict.fromkeys(one.get('kind', 'function') for one in raw['requirements']))} design"
    return "cycle design" if "objective" in raw else "balancing" if "balance" in raw else "analysis"
