"""Result files as subjects: the design is read, everything else is computed and proven again by the problem that it belongs to.

A result file names its problem and its hash, but does not hold it. It is looked for by that name, and must have that hash.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from optlink.analysis import SCHEMA as ANALYSIS
from optlink.analysis import Analysis, analyze
from optlink.design.files import ProblemFile, load, parse_assignment, shipped
from optlink.errors import Fault, InputError, Status
from optlink.generation import SCHEMA as GENERATION
from optlink.generation import Design, Generation, variants_of
from optlink.machine_design import SCHEMA as MACHINE
from optlink.machine_design import MachineDesign, check_machine
from optlink.report.subject import Outcome, Subject, subject_of
from optlink.solvers.conflict import Relaxation
from optlink.solvers.solution import LimitState
from optlink.units import factor
from optlink.validation import Check
from optlink.validation.check import Validation
from optlink.validation.generation import validate_generation
from optlink.version import VERSION
from optlink.workflow import SCHEMA as RESULT
from optlink.workflow import Relaxed, Result, read_design, validate

KNOWN = {RESULT: "solve", GENERATION: "solve", MACHINE: "solve", ANALYSIS: "analyze"}
"""Schemas that can be shown, and the command that writes them."""


def is_result(text: str) -> bool:
    """Whether an argument names a result file rather than a problem."""
    return text.endswith(".json")


def read_subject(path: Path, problem: str | None = None, changes: Sequence[str] = ()) -> Subject:
    """The subject of a result file.

    Parameters
    ----------
    path : Path
        What `solve --out` or `analyze --out` wrote as result.json.
    problem : str, optional
        Its problem; looked for by name if not said: shipped, beside the file, in the working directory.
    changes : texts KEY=VALUE
        With which the problem was changed (`--set`) when it was solved.

    Raises
    ------
    InputError
        when the file is none that can be shown, or its problem is not found or another one.
    """
    document = _document(path)
    schema = document.get("schema")
    if schema not in KNOWN:
        known = " or ".join(f"{name} ({command})" for name, command in KNOWN.items())
        message = "not a result that can be shown here" if isinstance(schema, str) else "not a result of optlink"
        raise InputError(Fault(message, f"Give one of {known}, or the problem itself", str(path), "schema", schema))
    file = _problem(document, path, problem, changes)
    notes = [f"read from {path.name}; kinematics and checks are computed anew from the design in it"]
    if document.get("optlink") != VERSION:
        notes.append(f"that file was written by optlink {document.get('optlink')}, this page by {VERSION}")
    try:
        outcome = _outcome(str(schema), document, path, file)
        limits = tuple(_limit(item) for item in _listed(document)) if _optimal(outcome) else ()
    except (KeyError, TypeError, ValueError, AttributeError, IndexError, OverflowError) as error:
        raise InputError(
            Fault(f"the result is damaged ({type(error).__name__}: {error})", "Write it again with --out", str(path))
        ) from None
    return subject_of(file, outcome, limits, tuple(notes))


def _document(path: Path) -> dict[str, Any]:
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        reason = getattr(error, "strerror", None) or "it holds no JSON"
        remedy = "Give a result.json that `solve --out` or `analyze --out` wrote, or a problem"
        raise InputError(Fault(f"cannot read a result: {reason}", remedy, str(path))) from None
    if not isinstance(found, dict):
        raise InputError(Fault("not a result of optlink", "Give a result.json that `solve --out` wrote", str(path)))
    return found


def _problem(document: Mapping[str, Any], path: Path, problem: str | None, changes: Sequence[str]) -> ProblemFile:
    """The problem that a result belongs to, by its hash."""
    name, wanted = str(document.get("problem")), document.get("problem_hash")
    places = [problem] if problem is not None else list(_places(name, path))
    overrides = dict(parse_assignment(text) for text in changes)
    for place in places:
        file = load(place, overrides)
        for variant in (file, *variants_of(file)):
            if variant.hash == wanted:
                return variant
    if not places:
        remedy = f"Name its problem file: --problem {name}.toml"
        raise InputError(Fault(f"the problem {name} of this result is not found", remedy, str(path), "problem", name))
    told = f"its problem has the hash {wanted}, {places[0]} has {load(places[0], overrides).hash}"
    remedy = "Name the problem file: --problem FILE, and repeat the --set of the search; or solve again"
    raise InputError(Fault(f"the result is that of another problem or version: {told}", remedy, str(path), "problem_hash"))


def _places(name: str, path: Path) -> Iterator[str]:
    """Where the problem of a result may be."""
    if name in shipped():
        yield name
    for folder in (path.parent, Path()):
        beside = folder / f"{name}.toml"
        if "/" not in name and "\\" not in name and beside.is_file():
            yield str(beside)


def _outcome(schema: str, document: Mapping[str, Any], path: Path, file: ProblemFile) -> Outcome:
    if schema == ANALYSIS:
        return _analysis(document, file)
    status = Status(document["status"])
    if schema == GENERATION:
        return _generation(document, file)
    given = read_design(file, [str(path)])
    made = check_machine(file, given) if schema == MACHINE else validate(file, given)
    known = {check.name for check in made.validation.checks}
    recorded = [check for check in _checks(document) if check.name not in known]
    proof = replace(made.validation, checks=(*made.validation.checks, *recorded))
    kind = Relaxation if isinstance(made, MachineDesign) else Relaxed
    about: dict[str, Any] = {key: document[key] for key in ("backend", "seed", "starts")}
    about |= {"status": status, "validation": proof, "seconds": {}}
    about["conflict"] = tuple(kind(**_relaxed(item)) for item in document.get("conflict", ()))
    about["together"] = tuple(kind(**_relaxed(item)) for item in document.get("relax_together", ()))
    if isinstance(made, MachineDesign):
        about["notes"] = tuple(document.get("notes", ()))
    return replace(made, **about)


def _relaxed(item: Mapping[str, Any]) -> dict[str, Any]:
    """The fields of a limit that would have to give."""
    numbers = {key: _number(item[key]) for key in ("bound", "relaxed", "amount")}
    return {**{key: str(item[key]) for key in ("name", "key", "sense", "unit")}, **numbers}


def _analysis(document: Mapping[str, Any], file: ProblemFile) -> Analysis:
    sizes = document["sizes"]
    design = {name: float(sizes[name]) for name in file.model.free}
    columns = document["columns"]["crank_angle_deg"]
    return analyze(file, max(1, len(columns) - 1), speed=float(document["speed_rad_s"]), design=design)


def _generation(document: Mapping[str, Any], file: ProblemFile) -> Generation:
    """The best design of a search for points, or its nearest miss, at the crank angles that were recorded."""
    found = [_generated(item, file) for item in document["designs"]]
    miss = document.get("nearest_miss")
    nearest = _generated(miss, file) if isinstance(miss, dict) else None
    valid = tuple(design for design in found if design.valid)
    return Generation(
        problem=file,
        designs=valid,
        nearest=nearest or next(iter(found), None),
        backend=str(document["backend"]),
        seed=int(document["seed"]),
        starts=int(document["starts"]),
        hits=int(document["starts_that_reached_the_best"]),
        seconds={},
        notes=tuple(document.get("notes", ())),
    )


def _generated(item: Mapping[str, Any], file: ProblemFile) -> Design:
    modes = {json.dumps(each.raw["mechanism"].get("assembly", "left"), sort_keys=True): each for each in variants_of(file)}
    variant = modes[json.dumps(item["assembly"], sort_keys=True)]
    task = variant.model
    quantities = task.quantities
    values = {}
    for key, value in item["design"].items():
        name, _, unit = key.rpartition("_")
        known = name if name in quantities else key  # a pure number has no unit
        values[known] = float(value) * (factor(unit, quantities[known].kind) if known == name and unit else 1.0)
    angles = np.radians(np.asarray(item["points"]["crank_deg"], dtype=float))
    proof = validate_generation(task, values, angles)  # type: ignore[arg-type]
    known_checks = {check.name for check in proof.checks}
    recorded = tuple(check for check in _checks(item) if check.name not in known_checks)
    checked = Validation((*proof.checks, *recorded), proof.objective)
    return Design(variant, values, angles, proof.objective, Status(item["status"]), checked)


def _checks(document: Mapping[str, Any]) -> list[Check]:
    """Checks that a result recorded."""
    return [
        Check(str(c["name"]), bool(c["passed"]), _number(c["value"]), str(c["limit"]), str(c["unit"]))
        for c in document["validation"]
    ]


def _listed(document: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """Limits of the design, of the best one if there are several."""
    if document.get("designs"):
        document = document["designs"][0]
    elif isinstance(document.get("nearest_miss"), dict):
        document = document["nearest_miss"]
    found = document.get("limits", [])
    return list(found)


def _limit(item: Mapping[str, Any]) -> LimitState:
    texts = {key: str(item[key]) for key in ("key", "name", "sense", "unit")}
    numbers = {key: _number(item[key]) for key in ("value", "bound", "multiplier", "slack")}
    return LimitState(**texts, **numbers, active=bool(item["active"]))  # type: ignore[arg-type]


def _optimal(outcome: Outcome) -> bool:
    """Whether limits have prices at all."""
    found = outcome.best if isinstance(outcome, Generation) else outcome
    return isinstance(found, Result | MachineDesign | Design) and found.status is Status.OPTIMAL


def _number(value: object) -> float:
    """A number of a document; null is none."""
    return math.nan if value is None else float(value)  # type: ignore[arg-type]
