"""Report models from result files: the design is read, everything else is recomputed and validated with its problem.

A result file contains only the name and hash of its problem, which is searched by name and must have that hash.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from optlink.errors import Fault, InputError, Status
from optlink.problem.file import ProblemFile
from optlink.report.report_model import Outcome, ReportModel, report_model_of
from optlink.report.stored.problem_lookup import problem_of
from optlink.report.stored.reader import AGAIN, Record, read
from optlink.report.stored.resolved_result import generated_optimum, law_optimum, machine_optimum
from optlink.solvers.evidence import Evidence, evidence
from optlink.solvers.solution import LimitState, Relaxation
from optlink.studies.sensitivity import SCHEMA as SENSITIVITY
from optlink.studies.sensitivity import DifferenceCheck
from optlink.tasks.analyze import analyze
from optlink.tasks.cycle import validate as validate_cycle
from optlink.tasks.function import SCHEMA as RESULT
from optlink.tasks.function import FunctionResult, read_design, validate
from optlink.tasks.results.analysis import SCHEMA as ANALYSIS
from optlink.tasks.results.analysis import Analysis
from optlink.tasks.results.cycle import SCHEMA as MACHINE
from optlink.tasks.results.cycle import CycleResult
from optlink.tasks.results.path import SCHEMA as GENERATION
from optlink.tasks.results.path import PathDesign, PathResult
from optlink.units import UnitProblem, factor
from optlink.validation import Check
from optlink.validation.check import Validation
from optlink.validation.path import validate_path
from optlink.version import VERSION

KNOWN = {RESULT: "solve", GENERATION: "solve", MACHINE: "solve", ANALYSIS: "analyze", SENSITIVITY: "study sensitivity"}
"""Schemas that can be shown, and the command that writes them."""


def read_subject(path: Path, problem: str | None = None, changes: Sequence[str] = ()) -> ReportModel:
    """Return the report model of a result file.

    Parameters
    ----------
    path : Path
        The result.json of a solution, an analysis or a sensitivity study.
    problem : str or None, optional
        Its problem; default: searched by name among the shipped problems, beside the file and in the working directory.
    changes : sequence of str, optional
        Assignments KEY=VALUE with which the problem was changed (`--set`).

    Raises
    ------
    InputError
        If the file cannot be shown or is damaged, or its problem is missing or a different one.
    """
    record = read(path)
    document, schema = record.document, record.document.get("schema")
    if schema not in KNOWN:
        known = " or ".join(f"{name} ({command})" for name, command in KNOWN.items())
        message = "not a result that can be shown here" if isinstance(schema, str) else "not a result of optlink"
        raise InputError(Fault(message, f"Give one of {known}, or the problem itself", str(path), "schema", schema))
    file = problem_of(record.text("problem"), record.text("problem_hash"), path, problem, changes)
    notes = [f"read from {path.name}; kinematics and checks are computed anew from the design in it"]
    if document.get("optlink") != VERSION:
        notes.append(f"that file was written by optlink {document.get('optlink')}, this page by {VERSION}")
    if schema == SENSITIVITY:
        return _sensitive(record, file, tuple(notes))
    try:
        outcome = _solved(_outcome(str(schema), document, path, file))
        limits = tuple(_limit(item) for item in _listed(document)) if _optimal(outcome) else ()
    except (KeyError, TypeError, ValueError, AttributeError, IndexError, OverflowError) as error:
        told = f"the key {error} is missing" if isinstance(error, KeyError) else f"a value is none that belongs there ({error})"
        raise InputError(Fault(f"the result is damaged: {told}", AGAIN, str(path))) from None
    return report_model_of(file, outcome, limits, tuple(notes))


def _solved(outcome: Outcome) -> Outcome:
    """Return an outcome with the solution of its optimum restored."""
    if isinstance(outcome, FunctionResult) and outcome.status is Status.OPTIMAL:
        return replace(outcome, solution=law_optimum(outcome.problem, outcome.design))
    if isinstance(outcome, CycleResult) and outcome.status is Status.OPTIMAL:
        return replace(outcome, solution=machine_optimum(outcome.problem, outcome.values))
    if isinstance(outcome, PathResult) and outcome.designs and outcome.designs[0].status is Status.OPTIMAL:
        return replace(outcome, designs=(generated_optimum(outcome.designs[0]), *outcome.designs[1:]))
    return outcome


def _sensitive(record: Record, file: ProblemFile, notes: tuple[str, ...]) -> ReportModel:
    """Return the optimum of a sensitivity study with recomputed derivatives and stored checks."""
    units = record.record("design_units")
    values = {name: value * _size(file, units, name) for name, value in record.figures("design").items()}
    if missing := [name for name in file.model.free if name not in values]:
        raise record.fault(f"design.{missing[0]}", "this is missing")
    outcome: Outcome
    if file.task == "cycle":
        known = {name: values[name] for name in file.model.free}
        outcome = _solved(replace(validate_cycle(file, known), status=Status.OPTIMAL))
        problem, solution = file, outcome.solution if isinstance(outcome, CycleResult) else None
    elif file.task == "path":
        from optlink.tasks.path import validate as validate_path

        outcome = _solved(_optimum(validate_path(file, values)))
        best = outcome.best if isinstance(outcome, PathResult) else None
        problem, solution = (file, None) if best is None else (best.problem, best.solution)
    else:
        given = replace(validate(file, {name: values[name] for name in file.model.free}), status=Status.OPTIMAL)
        outcome = _solved(given)
        problem, solution = file, outcome.solution if isinstance(outcome, FunctionResult) else None
    if solution is None:
        raise record.fault("design", "this is not the optimum of its problem")
    from optlink.studies.sensitivity import of_solution

    told = {row.text("key"): row for row in record.records("parameters")}
    found = of_solution(problem, solution)
    rows = tuple(replace(row, check=_checked(told[key])) if (key := row.parameter.key) in told else row for row in found.rows)
    return replace(report_model_of(file, outcome, (), notes), answers=replace(found, rows=rows))


def _size(file: ProblemFile, units: Record, name: str) -> float:
    """Return the SI value of a stored unit of a quantity; 1 if the name is not a quantity of the problem."""
    quantity, unit = file.model.quantities.get(name), units.text(name)
    if quantity is None or not unit:
        return 1.0
    try:
        return factor(unit, quantity.kind)
    except UnitProblem as error:
        raise units.fault(name, error.message, unit) from None


def _optimum(found: PathResult) -> PathResult:
    """Return validated designs with the status of optima."""
    return replace(found, designs=tuple(replace(design, status=Status.OPTIMAL) for design in found.designs))


def _checked(record: Record) -> DifferenceCheck | None:
    """Return the derivatives that were found by solving again, if they were stored."""
    if not record.has("searched_again"):
        return None
    found = record.record("searched_again")
    return DifferenceCheck(found.number("step"), found.number("objective"), found.figures("design"), found.number("gap"))


def _outcome(schema: str, document: Mapping[str, Any], path: Path, file: ProblemFile) -> Outcome:
    if schema == ANALYSIS:
        return _analysis(document, file)
    status = Status(document["status"])
    if schema == GENERATION:
        return _generation(document, file)
    given = read_design(file, [str(path)])
    made = validate_cycle(file, given) if schema == MACHINE else validate(file, given)
    known = {check.name for check in made.validation.checks}
    recorded = [check for check in _checks(document) if check.name not in known]
    proof = replace(made.validation, checks=(*made.validation.checks, *recorded))
    about: dict[str, Any] = {key: document[key] for key in ("backend", "seed", "starts")}
    about |= {"status": status, "validation": proof, "seconds": {}}
    about["conflict"] = tuple(Relaxation(**_relaxed(item)) for item in document.get("conflict", ()))
    about["together"] = tuple(Relaxation(**_relaxed(item)) for item in document.get("relax_together", ()))
    if isinstance(made, CycleResult):
        about["notes"] = tuple(document.get("notes", ()))
    return replace(made, **about)


def _relaxed(item: Mapping[str, Any]) -> dict[str, Any]:
    """Return the fields of a relaxed limit."""
    numbers = {key: _number(item[key]) for key in ("bound", "relaxed", "amount")}
    return {**{key: str(item[key]) for key in ("name", "key", "sense", "unit")}, **numbers}


def _analysis(document: Mapping[str, Any], file: ProblemFile) -> Analysis:
    sizes = document["sizes"]
    design = {name: float(sizes[name]) for name in file.model.free}
    columns = document["columns"]["crank_angle_deg"]
    return analyze(file, max(1, len(columns) - 1), speed=float(document["speed_rad_s"]), design=design)


def _generation(document: Mapping[str, Any], file: ProblemFile) -> PathResult:
    """Return the best design of a search, or its nearest miss, at the stored crank angles."""
    found = [_generated(item, file) for item in document["designs"]]
    miss = document.get("nearest_miss")
    nearest = _generated(miss, file) if isinstance(miss, dict) else None
    valid = tuple(design for design in found if design.valid)
    return PathResult(
        problem=file,
        designs=valid,
        nearest=nearest or next(iter(found), None),
        backend=str(document["backend"]),
        seed=int(document["seed"]),
        starts=int(document["starts"]),
        evidence=Evidence(**document["evidence"]) if "evidence" in document else evidence(()),
        seconds={},
        notes=tuple(document.get("notes", ())),
    )


def _generated(item: Mapping[str, Any], file: ProblemFile) -> PathDesign:
    modes = {json.dumps(each.raw["mechanism"].get("assembly", "left"), sort_keys=True): each for each in file.variants()}
    variant = modes[json.dumps(item["assembly"], sort_keys=True)]
    task = variant.model
    quantities = task.quantities
    values = {}
    for key, value in item["design"].items():
        name, _, unit = key.rpartition("_")
        known = name if name in quantities else key  # dimensionless quantities have no unit suffix
        values[known] = float(value) * (factor(unit, quantities[known].kind) if known == name and unit else 1.0)
    angles = np.radians(np.asarray(item["points"]["crank_deg"], dtype=float))
    proof = validate_path(task, values, angles)  # type: ignore[arg-type]
    known_checks = {check.name for check in proof.checks}
    recorded = tuple(check for check in _checks(item) if check.name not in known_checks)
    checked = Validation((*proof.checks, *recorded), proof.objective)
    return PathDesign(variant, values, angles, proof.objective, Status(item["status"]), checked)


def _checks(document: Mapping[str, Any]) -> list[Check]:
    """Return the stored checks."""
    return [
        Check(str(c["name"]), bool(c["passed"]), _number(c["value"]), str(c["limit"]), str(c["unit"]))
        for c in document["validation"]
    ]


def _listed(document: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """Return the limits of the design, or of the best of several designs."""
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
    """Return whether the outcome is an optimum, so that its limits have shadow prices."""
    found = outcome.best if isinstance(outcome, PathResult) else outcome
    return isinstance(found, FunctionResult | CycleResult | PathDesign) and found.status is Status.OPTIMAL


def _number(value: object) -> float:
    """Convert a number of a document; null gives NaN."""
    return math.nan if value is None else float(value)  # type: ignore[arg-type]
