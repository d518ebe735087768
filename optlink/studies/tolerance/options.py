"""Tolerances from the command line, or from the problem file, as deviations of a linkage."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from optlink.errors import InputError
from optlink.problem.file import ProblemFile
from optlink.problem.quantity import Unusable
from optlink.problem.tolerances import CLEARANCE, EXAMPLE, NORMAL, Deviation, ToleranceEntry, deviations, read_tolerance
from optlink.studies.tolerance.nominal import Nominal

OPTION = "--tolerance"


def read_tolerances(problem: ProblemFile, texts: Sequence[str], shape: str = NORMAL) -> dict[str, ToleranceEntry]:
    """Return tolerances by name from texts NAME=TOLERANCE; without texts, those of the file.

    Files of measured deviations are read from the working folder.
    """
    entries: dict[str, ToleranceEntry] = {} if texts else dict(problem.model.tolerances)
    if not texts and not entries:
        raise InputError("no tolerance is given", f"{EXAMPLE}, or give the file [tolerances]", problem.file, OPTION)
    for assignment in texts:
        name, equals, text = assignment.partition("=")
        name = name.strip().removeprefix("mechanism.")
        if not equals or not name or not text.strip():
            raise InputError("expected NAME=TOLERANCE", EXAMPLE, key=OPTION, value=assignment)
        if name in entries:
            raise InputError("a tolerance is given twice", "Give each once", problem.file, OPTION, name)
        try:
            entries[name] = read_tolerance(text, Path())
        except Unusable as error:
            raise InputError(error.message, error.remedy, key=f"{OPTION} {name}", value=error.value) from None
    entry = {
        name: entry.shape or (None if entry.measured or name.endswith(CLEARANCE) else shape) for name, entry in entries.items()
    }
    return {name: replace(entries[name], shape=distribution) for name, distribution in entry.items()}


def identified(problem: ProblemFile, texts: Sequence[str], shape: str, *, robust: bool) -> ProblemFile:
    """Return the problem of a study: with its tolerances, if measured ones are among those given, or of a robust design."""
    entries = read_tolerances(problem, texts, shape) if texts or robust else {}
    if not any(entry.measured for entry in entries.values()):
        return problem
    return problem.override({"tolerances": {name: entry.raw for name, entry in entries.items()}})


def read_deviations(problem: ProblemFile, nominal: Nominal, texts: Sequence[str], shape: str = NORMAL) -> tuple[Deviation, ...]:
    """Return the deviations of a nominal linkage; see `read_tolerances`."""
    entries = read_tolerances(problem, texts, shape)
    try:
        quantities, output = problem.model.mechanism.quantities, nominal.output
        return deviations(entries, nominal.mechanism, quantities, nominal.sizes, shape, output)
    except Unusable as error:
        key = f"{OPTION} {error.key}" if texts else f"tolerances.{error.key}"
        raise InputError(error.message, error.remedy, problem.file, key, error.value) from None
