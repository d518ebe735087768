"""Report models from result files: the design is read, everything else is recomputed and validated with its problem.

A result file contains only the name and hash of its problem, which is searched by name and must have that hash."""

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from optlink.errors import InputError, Status
from optlink.io import shown_name
from optlink.linkage.vector2d import TURN, Array
from optlink.optimization.nlp import NLP, build
from optlink.problem.base_model import Contradiction, ResultRecord, check_length
from optlink.problem.file import ProblemFile
from optlink.problem.path import PathProblem
from optlink.report.report_model import Outcome, ReportModel, report_model_of
from optlink.report.stored.stored_certificate import read_certificate
from optlink.report.stored.stored_study import named_si
from optlink.solvers import multistart
from optlink.solvers.global_search.lagrangian import TESTS
from optlink.solvers.solution import LimitState, Solution
from optlink.studies.sensitivity import SensitivitiesRecord, of_solution
from optlink.tasks.analyze import analyze
from optlink.tasks.function import FunctionRecord, FunctionResult, read_design, solve
from optlink.tasks.results.analysis import Analysis, AnalysisRecord
from optlink.tasks.results.certificate import Certificate, Cover, exact
from optlink.tasks.results.common import SingleRecord, check_entries
from optlink.tasks.results.cycle import CycleResult
from optlink.tasks.results.default_margins import MARGIN_NOTE
from optlink.tasks.results.path import PathDesign, PathDesignRecord, PathRecord, PathResult
from optlink.tasks.results.rejected import RejectedDesign, RejectedRecord
from optlink.tasks.run import validate
from optlink.units import UnitProblem, factor
from optlink.validation import Check
from optlink.validation.check import Validation
from optlink.validation.path import validate_path

RESTORED = "the certificate of the global optimum is that of the file; it is not recomputed"


def read_report_model(record: ResultRecord, file: ProblemFile, path: Path, *, priced: bool = True) -> ReportModel:
    """Return the report model of a stored result.

    Parameters
    ----------
    record : ResultRecord
        Of a solution, an analysis or a sensitivity study.
    file : ProblemFile
        Its problem.
    path : Path
        File of the record.
    priced : bool, optional
        Restore the solution of an optimum, with its shadow prices.

    Raises
    ------
    InputError
        If the design in the file is not one of the problem.
    Contradiction
        If the record does not fit the problem.
    """
    notes = [f"read from {shown_name(path.name)}; kinematics and checks are recomputed from the design in it"]
    if isinstance(record, SensitivitiesRecord):
        return _sensitivity_model(record, file, tuple(notes), priced=priced)
    outcome = _certified(_outcome(record, path, file), record)
    outcome = _solved(outcome) if priced else outcome
    if getattr(record, "certificate", None) is not None:
        if isinstance(outcome, FunctionResult | PathResult) and outcome.certificate is not None:
            notes.append(RESTORED)
            outcome = replace(outcome, certificate=_with_boxes(outcome.certificate, path.with_name("certificate.json"), file))
        else:
            notes.append("the certificate of the global optimum in the file is not that of this design")
    return report_model_of(file, outcome, _limits(record) if _optimal(outcome) else (), tuple(notes))


def _certified(outcome: Outcome, record: ResultRecord) -> Outcome:
    """Return an outcome with the certificate of its file, if it is that of its design."""
    if not isinstance(outcome, FunctionResult | PathResult) or not isinstance(record, FunctionRecord | PathRecord):
        return outcome
    if record.certificate is None:
        return outcome
    objective = outcome.objective if outcome.valid else math.inf
    unknowns = tuple(outcome.problem.model.free)
    try:
        certificate = record.certificate.certificate(unknowns, exact=exact(outcome.problem, objective))
    except Contradiction as error:
        raise Contradiction(f"certificate.{error.key}", str(error), error.value) from None
    return replace(outcome, certificate=certificate if certificate.belongs_to(objective) else None)


def _with_boxes(certificate: Certificate, path: Path, file: ProblemFile) -> Certificate:
    """Return a certificate with the boxes of its proof, if their file is there."""
    if not path.is_file():
        return certificate
    proof = read_certificate(file, path)
    if proof.status != certificate.status or (certificate.proven and proof.lower_bound != certificate.lower_bound):
        return certificate  # of another search
    covers = []
    for cover in proof.covers:
        test = np.array([TESTS.index(name) for name in cover.test], dtype=np.int8)
        covers.append(Cover(cover.assembly, cover.low, cover.high, test, np.zeros((len(test), 0)), ()))
    return replace(certificate, covers=tuple(covers))


def _solved(outcome: Outcome) -> Outcome:
    """Return an outcome with the solution of its optimum restored."""
    best = None if isinstance(outcome, Analysis) else outcome.best
    if isinstance(outcome, Analysis) or best is None or best.status is not Status.OPTIMAL:
        return outcome
    return outcome.with_best(solution=optimum(best))


def _sensitivity_model(record: SensitivitiesRecord, file: ProblemFile, notes: tuple[str, ...], *, priced: bool) -> ReportModel:
    """Return the optimum of a sensitivity study with recomputed derivatives and stored checks."""
    values = {name: value * _size(file, record.design_units, name) for name, value in record.design.items()}
    check_entries("design", values, file.model.free)
    design = values if file.task == "path" else {name: values[name] for name in file.model.free}
    found = _validated(file, design).with_best(status=Status.OPTIMAL)
    if not priced:
        return report_model_of(file, found, (), notes)
    outcome = _solved(found)
    best = getattr(outcome, "best", None)
    if best is None or best.solution is None:
        raise Contradiction("design", "this is not the optimum of its problem")

    checks = {row.key: row.searched_again for row in record.parameters}
    sensitivities = of_solution(best.problem, best.solution)
    rows = tuple(replace(row, check=checks.get(row.parameter.key)) for row in sensitivities.rows)
    return replace(report_model_of(file, outcome, (), notes), effects=replace(sensitivities, rows=rows))


def _validated(file: ProblemFile, design: Mapping[str, float]) -> FunctionResult | PathResult | CycleResult:
    result = validate(file, design)
    assert isinstance(result, FunctionResult | PathResult | CycleResult)
    return result


def _size(file: ProblemFile, units: Mapping[str, str], name: str) -> float:
    """Return the SI value of a stored unit of a quantity; 1 if the name is not a quantity of the problem."""
    quantity, unit = file.model.quantities.get(name), units.get(name, "")
    if quantity is None or not unit:
        return 1.0
    try:
        return factor(unit, quantity.kind)
    except UnitProblem as error:
        raise Contradiction(f"design_units.{name}", error.message, unit) from None


def _outcome(record: ResultRecord, path: Path, file: ProblemFile) -> Outcome:
    if isinstance(record, AnalysisRecord):
        free = [name for name in file.model.free if name in file.model.mechanism.quantities]  # others determine a task alone
        check_entries("sizes", record.sizes, free)
        design = {**(record.design or {}), **{name: record.sizes[name] for name in free}}
        count = len(next(iter(record.columns.values()), ()))
        return analyze(file, max(1, count - 1), speed=record.speed_rad_s, design=design)
    if isinstance(record, PathRecord):
        return _path(record, file)
    assert isinstance(record, SingleRecord)
    result = _validated(file, read_design(file, [str(path)]))
    about: dict[str, Any] = {name: getattr(record, name) for name in ("status", "backend", "seed", "starts")}
    about |= {"validation": _with_stored(result.validation, record.validation), "seconds": {}}
    about |= {"conflict": record.conflict or (), "together": record.relax_together or ()}
    about |= {"rejected": _rejected(record.rejected, file)}
    if isinstance(result, FunctionResult):
        about |= {"margins": tuple(note for note in record.notes if note.startswith(MARGIN_NOTE))}
    return replace(result, **about | ({"notes": record.notes} if isinstance(result, CycleResult) else {}))


def _with_stored(validation: Validation, stored: tuple[Check, ...]) -> Validation:
    """Return a validation with the stored checks that it does not repeat."""
    repeated = {check.name for check in validation.checks}
    return replace(validation, checks=(*validation.checks, *(check for check in stored if check.name not in repeated)))


def _path(record: PathRecord, file: ProblemFile) -> PathResult:
    """Return the best design of a search, or its nearest miss, at the stored crank angles."""
    designs = [_path_design(design_record, f"designs[{k}]", file) for k, design_record in enumerate(record.designs)]
    nearest = None if record.nearest_miss is None else _path_design(record.nearest_miss, "nearest_miss", file)
    valid = tuple(design for design in designs if design.valid)
    return record.build(
        PathResult,
        problem=file,
        designs=valid,
        nearest=nearest or next(iter(designs), None),
        seconds={},
        conflict=record.conflict or (),
        together=record.relax_together or (),
        certificate=None,
        rejected=_rejected(record.rejected, file),
        backends={},
    )


def _rejected(record: RejectedRecord | None, file: ProblemFile) -> RejectedDesign | None:
    """Return the rejected design of a document; it may have other assembly modes than the best one."""
    if record is None:
        return None
    try:
        variant = file.override({"mechanism.assembly": record.assembly})
    except InputError as error:
        raise Contradiction("rejected.assembly", "the problem has no such assembly mode") from error
    values = named_si(variant, record.design)
    check_entries("rejected.design", values, variant.model.free)
    return RejectedDesign(variant, values, record.objective, record.failed)


def _path_design(record: PathDesignRecord, where: str, file: ProblemFile) -> PathDesign:
    variant = file.variant(record.assembly)
    if variant is None:
        raise Contradiction(f"{where}.assembly", "the problem has no such assembly mode")
    values = named_si(variant, record.design)
    check_entries(f"{where}.design", values, variant.model.quantities)
    check_entries(f"{where}.points", record.points, ["crank_deg"])
    angles = np.radians(record.points["crank_deg"])
    assert isinstance(variant.model, PathProblem)
    check_length(angles, len(variant.model.data.columns), f"{where}.points.crank_deg")
    validation = validate_path(variant.model, values, angles)
    return PathDesign(variant, values, angles, validation.objective, record.status, _with_stored(validation, record.validation))


def _limits(record: ResultRecord) -> tuple[LimitState, ...]:
    """Return the limits of the design, or of the best of several designs."""
    if isinstance(record, PathRecord):
        best = record.designs[0] if record.designs else record.nearest_miss
        return () if best is None else best.limits
    return record.limits if isinstance(record, SingleRecord) else ()


def _optimal(outcome: Outcome) -> bool:
    """Return whether the outcome is an optimum, so that its limits have shadow prices."""
    best = getattr(outcome, "best", None)
    return best is not None and best.status is Status.OPTIMAL


SOLUTION_TOLERANCE = 1e-5  # tolerance in scaled units; a larger step leads to a different optimum


def optimum(design: FunctionResult | CycleResult | PathDesign) -> Solution | None:
    """Return the optimum at a design; None if the design is not an optimum."""
    if isinstance(design, PathDesign):
        return _path_optimum(design)
    return _machine_optimum(design) if isinstance(design, CycleResult) else _law_optimum(design)


def _law_optimum(result: FunctionResult) -> Solution | None:
    file, design = result.problem, result.design
    if not file.spec.everywhere:
        return _optimum_at(build(file.spec), dict(design))
    # the positions of the largest errors belong to the nonlinear program: solve from the optimum, which must not move
    solution = solve(file, "ipopt", begin={name: design[name] for name in file.spec.free}).solution
    return None if solution is None else _if_unmoved(solution, solution.nlp.x_of(dict(design)))


def _machine_optimum(result: CycleResult) -> Solution | None:
    """Return the optimum of a cycle optimisation.

    The crank angles of the peaks belong to the nonlinear program, which is therefore solved from the design; it must not move.
    """
    from optlink.optimization.cycle_nlp import CycleNLP
    from optlink.studies.cycle_parameters import BACK_END
    from optlink.studies.cycle_task import with_starting_values
    from optlink.tasks.cycle import solve as solve_cycle

    solution = solve_cycle(with_starting_values(result.problem, result.design), BACK_END, starts=1).solution
    if solution is None or solution.status is not Status.OPTIMAL:
        return None
    assert isinstance(solution.nlp, CycleNLP)
    count = len(solution.nlp.free)
    deviation = solution.x[:count] - solution.nlp.x_of(result.design)[:count]
    return solution if float(np.max(np.abs(deviation))) <= SOLUTION_TOLERANCE else None


def _path_optimum(design: PathDesign) -> Solution | None:
    from optlink.optimization.path_nlp import angle_name, build_path_nlp
    from optlink.solvers.path_exchange import solve_semi_infinite

    angles = design.crank_angles
    nlp = build_path_nlp(design.task, 1 if angles[-1] >= angles[0] else -1)
    crank_values = {angle_name(k): float(angle) for k, angle in enumerate(angles)}
    x = nlp.x_of({**design.values, **crank_values})
    start = multistart.solution_at(nlp, x, "read from a result file")
    return _if_unmoved(solve_semi_infinite(design.task, start, "ipopt", near=True), x)


def _optimum_at(nlp: NLP, values: dict[str, float]) -> Solution | None:
    """Return the optimum at given values, directly or after an optimisation that must not move them."""
    x = nlp.x_of(values)
    solution = multistart.solution_at(nlp, x, "read from a result file")
    if solution.status is not Status.OPTIMAL:
        solution = multistart.solve_from(nlp, x, "ipopt")
    return _if_unmoved(solution, x)


def _if_unmoved(solution: Solution, x: Array) -> Solution | None:
    """Return a solution if it is optimal and coincides with the stored one at `x`; None otherwise."""
    deviation = solution.x - x
    angular = np.array([variable.scale.unit == "deg" for variable in solution.nlp.variables])
    turns = TURN / np.array([variable.size for variable in solution.nlp.variables])
    deviation -= np.where(angular, turns * np.round(deviation / turns), 0.0)  # angles are equal modulo a turn
    close = float(np.max(np.abs(deviation), initial=0.0)) <= SOLUTION_TOLERANCE
    return solution if solution.status is Status.OPTIMAL and close else None
