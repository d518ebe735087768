"""New names for the bodies, joints, points and guides of a problem file, wherever its text mentions them."""

from __future__ import annotations

import copy
import itertools
import re
import tomllib
from collections.abc import Callable, Iterator
from typing import Any

from optlink.errors import InputError, given_as
from optlink.linkage.bodies import FRAME
from optlink.problem.arguments import typed
from optlink.problem.base_model import NAME, RESERVED
from optlink.problem.file import AnyProblem, ProblemFile, dump, problem_of, read
from optlink.problem.terms import read_words
from optlink.problem.toml_text import rewritten, tables

MENTIONS = {
    *(
        "about",
        "against",
        "arm",
        "at",
        "bodies",
        "body",
        "between",
        "cam",
        "centroid",
        "cylinder",
        "follower",
        "joints",
        "journal",
    ),
    *("known", "of", "on", "origin", "output", "pin", "pinion", "point", "rack", "slide", "slider", "through"),
}
"""Keys whose texts name parts of the linkage, their quantities or coordinates."""
_ENTRIES = re.compile(
    r"(mechanism\.\w+|mechanism\.links\.\w+\.points|bodies|joints|parts\.(links|joints)|limits\.(transmission|pressure)_angle)\.\0"
    r"|(expected\.figures|rounding|tolerances)\.(\w+\.)?\0(\..*)?"
)
"""Keys of entries that belong to a part, or to a dimension of one."""
_NAMED = re.compile(r"\0(\.\w+){0,2}|\w+\.\0\.\w+")  # a part, or a dimension or coordinate of one
_SPARE = "part_in_place_of_a_name"
_MODE = re.compile(r"\s*\w+ of (\0-\w+|\w+-\0)\s*(,.*)?")


def kinds(problem: ProblemFile) -> dict[str, str]:
    """Return what a file can name, bodies, points, guides and the like, each with its kind."""
    mechanism, linkage = problem.model.mechanism, problem.model.linkage
    found = dict.fromkeys((*linkage.owners, *linkage.ground), "point") | dict.fromkeys(linkage.pins, "joint")
    found |= dict.fromkeys(linkage.bodies, "body") | {guide.name: "guide" for guide in linkage.guides}
    for table in () if mechanism.by_lengths else ("cylinders", "slots"):
        found |= dict.fromkeys(getattr(mechanism, table), table[:-1])
    return {FRAME: "body"} | found


def own_names(problem: ProblemFile) -> list[str]:
    """Return the names that a file has chosen; those of a four-bar by its lengths are those of a textbook."""
    mechanism: Any = problem.model.mechanism
    every = mechanism.points if mechanism.by_lengths else kinds(problem)
    return [name for name in every if re.fullmatch(NAME, name) and name not in RESERVED]


@typed
def rename(problem: AnyProblem, old: str, new: str) -> ProblemFile:
    """Give a body, joint, point, guide, cylinder or slot of a problem another name, wherever the problem mentions it.

    Parameters
    ----------
    problem : ProblemFile, str or Path
        As `load` returns it, the name of a shipped one, or the path of a problem file.
    old : str
        Present name of the part.
    new : str
        Its new name.

    Returns
    -------
    ProblemFile

    Raises
    ------
    InputError
        If there is no such part, its name cannot change, or the new name is invalid or taken.

    Examples
    --------
    >>> optlink.rename("six-bar", "slider", "ram").at("loads.process.on")
    'ram'
    """
    problem = problem_of(problem)
    with given_as(problem.file, *(("new", new) if old in own_names(problem) else ("old", old))):
        return problem.with_tables(tomllib.loads(renamed(dump(problem), problem, old, new)))


def renamed(text: str, problem: ProblemFile, old: str, new: str) -> str:
    """Return the text of a problem file with another name for a part of its linkage; comments and layout are kept.

    Raises
    ------
    InputError
        If there is no such part, its name cannot change, or the new name cannot be used.
    """
    known, own = kinds(problem), own_names(problem)
    if old not in own:
        fixed = "the parts of a four-bar by its lengths have fixed names" if problem.model.mechanism.by_lengths else ""
        message = fixed if fixed and old in known else f"the linkage has no part {old} that can be renamed"
        remedy = "Write it with its links, [mechanism.links], to choose them" if message == fixed else f"Parts: {', '.join(own)}"
        raise InputError(message, remedy, problem.file)
    if not re.fullmatch(NAME, new):
        remedy = "Use up to 40 letters, digits and _, beginning with a letter, for example link2"
        raise InputError(f'"{new[:60]}" is not a name', remedy, problem.file)
    taken = dict.fromkeys(problem.model.loads, "the name of a load") | {
        name: f"the name of a {kind}" for name, kind in known.items()
    }
    taken |= dict.fromkeys(RESERVED, "a reserved name")
    if new in taken:
        raise InputError(f"{new} is {taken[new]}", f"Choose another name for the {known[old]} {old}", problem.file)
    if (explicit := _explicit(problem, old)) != problem.raw:
        text = rewritten(text, problem.raw, explicit)
    sign = next(sign for k in itertools.count(1) if (sign := "Z" * k) not in text)
    pieces = re.split(rf"(?<!\w)(?<!= ){old}(?!\w)", text)
    marked = pieces[0] + "".join(f"{sign}{k}_{piece}" for k, piece in enumerate(pieces[1:]))
    found = set(_mentions(tomllib.loads(marked), "", re.compile(rf"{sign}(\d+)_"), old))
    text = pieces[0] + "".join(f"{new if k in found else old}{piece}" for k, piece in enumerate(pieces[1:]))
    read(tables(text), problem.name, problem.file, problem.folder, problem.files)
    return text


def _explicit(problem: ProblemFile, old: str) -> dict[str, Any]:
    """Return the tables of a problem with the keys that are left out because the part has the name that they have by default."""
    raw, model, drive = copy.deepcopy(dict(problem.raw)), problem.model, problem.model.drive
    if old == "crank" and not (model.drives or drive.body or drive.slide or drive.cylinder):
        raw.setdefault("drive", {})["body"] = old
    several, single = getattr(model, "requirements", ()), getattr(model, "requirement", None)
    tables_of = raw["requirements"] if several else [raw.get("requirement")]
    for one, table in zip(several or [single], tables_of, strict=True):
        if getattr(one, "point", None) == old:
            table["point"] = old
    return raw


def _mentions(value: Any, path: str, mark: re.Pattern[str], old: str) -> Iterator[int]:
    """Yield the numbers of the marks, which stand for a name in the tables of a file, that mean the part."""

    def meant(text: str, names: Callable[[str], object]) -> Iterator[int]:
        for one in mark.finditer(text):
            first, rest = (mark.sub(old, side) for side in (text[: one.start()], text[one.end() :]))
            if names(f"{first}\0{rest}"):
                yield int(one[1])

    if isinstance(value, list):
        for item in value:
            yield from _mentions(item, path, mark, old)
    elif isinstance(value, dict):
        for key, item in value.items():
            yield from meant(
                key, lambda key: _ENTRIES.fullmatch(f"{path}.{key}") or (path.startswith("balance") and _in_words(key))
            )
            yield from _mentions(item, f"{path}.{mark.sub(old, key)}".lstrip("."), mark, old)
    elif isinstance(value, str):
        yield from meant(value, lambda text: _in_text(text.strip(), path))


def _in_text(text: str, path: str) -> bool:
    """Return whether a text of a file means the part for which it has a null character."""
    section, _, key = path.rpartition(".")
    if section == "mechanism.assembly":
        return bool(_MODE.fullmatch(text))
    if section and key in MENTIONS:
        return bool(_NAMED.fullmatch(text))
    if key == "equals":
        first, rest = re.split(r"[\w.]*\0[\w.]*", text, maxsplit=1)
        word = text[len(first) : len(text) - len(rest)]
        return bool(_NAMED.fullmatch(word)) and not re.search(r"\d\s*$", first) and not rest.startswith("(")
    return path.startswith("balance") and _in_words(text)


def _in_words(text: str) -> bool:
    """Return whether the words of a term mean the part for which they have a null character."""
    keys = read_words(text.replace("\0", _SPARE)) or {}
    return any(_NAMED.fullmatch(str(keys.get(key)).replace(_SPARE, "\0")) for key in ("of", "on", "about"))
