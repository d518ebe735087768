"""The problem that a result file belongs to: the file names it and its hash, but does not hold it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from optlink.errors import Fault, InputError
from optlink.problem.file import ProblemFile, load, parse_assignment, shipped
from optlink.report.stored.reader import Record
from optlink.tasks.path import variants_of


def problem_of(record: Record, problem: str | None = None, changes: Sequence[str] = ()) -> ProblemFile:
    """The problem of a result, by its hash.

    Parameters
    ----------
    record : Record
    problem : str, optional
        Where it is; looked for by name if not said: shipped, beside the file, in the working directory.
    changes : texts KEY=VALUE
        With which the problem was changed (`--set`) when it was solved.

    Raises
    ------
    InputError
        when it is not found, or has another hash.
    """
    name, wanted, path = record.text("problem"), record.text("problem_hash"), record.path
    places = [problem] if problem is not None else list(_places(name, path))
    overrides = dict(parse_assignment(text) for text in changes)
    hashes = []
    for place in places:
        file = load(place, overrides)
        for variant in (file, *variants_of(file)):
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
    """Where the problem of a result may be."""
    if name in shipped():
        yield name
    for folder in (path.parent, path.parent.parent, Path()):
        beside = folder / f"{name}.toml"
        if "/" not in name and "\\" not in name and beside.is_file():
            yield str(beside)
