"""Lookup of the problem of a result file, which contains only its name and hash."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from optlink.errors import Fault, InputError
from optlink.problem.file import ProblemFile, load, parse_assignment, shipped


def problem_of(name: str, wanted: str, path: Path, problem: str | None = None, changes: Sequence[str] = ()) -> ProblemFile:
    """Return the problem of a result, identified by its hash.

    Parameters
    ----------
    name, wanted : str
        Name and hash of the problem.
    path : Path
        File of the result.
    problem : str or None, optional
        Path or name of the problem; default: searched by name among the shipped problems, beside the file and in the
        working directory.
    changes : sequence of str, optional
        Assignments KEY=VALUE with which the problem was changed (`--set`).

    Raises
    ------
    InputError
        If the problem is not found or has a different hash.
    """
    places = [problem] if problem is not None else list(_places(name, path))
    overrides = dict(parse_assignment(text) for text in changes)
    hashes = []
    for place in places:
        file = load(place, overrides)
        for variant in (file, *file.variants()):
            if variant.hash == wanted:
                return variant
        hashes.append(file.hash)
    if not places:
        remedy = f"Name its problem file: --problem {name}.toml"
        raise InputError(Fault(f"the problem {name} of this result is not found", remedy, str(path), "problem", name))
    told = f"its problem has the hash {wanted}, {places[0]} has {hashes[0]}"
    remedy = "Name the problem file: --problem FILE, and repeat the --set of the search; or solve again"
    raise InputError(Fault(f"the result is that of another problem or version: {told}", remedy, str(path), "problem_hash"))


def _places(name: str, path: Path) -> Iterator[str]:
    """Yield the possible locations of the problem of a result."""
    if name in shipped():
        yield name
    for folder in (path.parent, path.parent.parent, Path()):
        beside = folder / f"{name}.toml"
        if "/" not in name and "\\" not in name and beside.is_file():
            yield str(beside)
