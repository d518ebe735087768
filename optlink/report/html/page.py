"""HTML report of a design: linkage in motion, result and validation, sensitivities, charts, sources."""

from __future__ import annotations

import functools
from collections.abc import Iterator
from pathlib import Path

from optlink.errors import Status
from optlink.io import whole
from optlink.report.chart_spec import ChartSpec
from optlink.report.format import product, single_units
from optlink.report.html import chart_plotly
from optlink.report.html.moving_linkage import Moving, turning
from optlink.report.html.shell import PageSection, StoredStudy
from optlink.report.registry import table_of, view_of
from optlink.report.report_model import ReportModel
from optlink.report.stored.stored_study import study_page
from optlink.report.table_spec import Paragraph, Part, Summary, TableSpec
from optlink.report.views import (
    analysis_charts,
    analysis_forces,
    conclusions,
    function_tables,
    path_tables,
    sensitivity,
    study_tables,
)
from optlink.report.views.analysis_curves import CycleCurves
from optlink.studies.sensitivity import Sensitivities, of_solution
from optlink.tasks.function import FunctionResult
from optlink.tasks.results.analysis import Analysis
from optlink.tasks.results.cycle import CycleResult
from optlink.tasks.results.path import PathDesign, PathResult


def write_page(subject: ReportModel | StoredStudy, path: Path) -> None:
    """Write the HTML page of a report model or of a stored result.

    Parameters
    ----------
    subject : ReportModel or StoredStudy
    path : Path

    Raises
    ------
    InputError
        If the file cannot be written; then no file is left behind.
    """
    text = page(subject)
    with whole(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def page(subject: ReportModel | StoredStudy) -> str:
    """Return the HTML page of a report model or of a stored result."""
    return study_page(subject if isinstance(subject, StoredStudy) else _report(subject))


def _report(subject: ReportModel) -> StoredStudy:
    effects = subject.effects or sensitivities_of(subject)
    with single_units():
        shown = table_of(_kind(subject))(subject.result)
        return StoredStudy(
            problem=subject.problem,
            kind=subject.problem.kind,
            verdict=verdict(subject),
            valid=subject.valid,
            conclusion=_conclusion(subject, shown),
            status=shown.status.lines,
            sections=list(_sections(subject, shown, effects)),
            moving=functools.partial(moved, subject),
            by=_by(subject),
            after=1 if subject.effects is not None else 0,  # the requested study comes first
            notes=subject.notes,
        )


def moved(subject: ReportModel, steps: int) -> Moving | None:
    """Return the animated machine of a report model; None if there is none.

    Parameters
    ----------
    subject : ReportModel
    steps : int
        Number of positions per revolution.
    """
    return None if subject.cycle is None else turning(subject.cycle, steps)


# --- layout ------------------------------------------------------------------------------------------------------------------


def _sections(subject: ReportModel, shown: Summary, effects: Sensitivities | None) -> Iterator[PageSection]:
    if effects is not None and subject.effects is not None:
        yield _matters(effects)
    if subject.cycle is None and subject.unmoved:
        yield PageSection("Linkage", (Paragraph(f"It cannot be shown in motion: {subject.unmoved}."),))
    name = "Analysis" if isinstance(subject.result, Analysis) else "Design and checks"
    yield PageSection(name, (_with_recorded_limits(subject, shown),))
    if effects is not None and subject.effects is None:
        yield _matters(effects)
    yield PageSection("Curves", chart_plotly.charts(charts(subject)))


def _matters(effects: Sensitivities) -> PageSection:
    """Return the section of the sensitivities."""
    drawn = chart_plotly.charts(sensitivity.charts(effects))
    return PageSection("Sensitivities", (*drawn, tuple(study_tables.sensitivity_parts(effects))))


def sensitivities_of(subject: ReportModel) -> Sensitivities | None:
    """Return the sensitivities of an optimum to its parameters.

    None if there was no optimisation, no optimum, an exact solution, or no parameter with an effect.
    """
    best = getattr(subject.result, "best", None)
    if best is None or best.solution is None or best.solution.status is not Status.OPTIMAL:
        return None
    if isinstance(best, PathDesign) and path_tables.exact(best):
        return None
    found = of_solution(best.problem, best.solution)
    return found if found.moving else None


def verdict(subject: ReportModel | StoredStudy) -> str:
    """Return the verdict: whether the design is valid, and which checks failed."""
    if isinstance(subject, StoredStudy):
        return subject.verdict
    if isinstance(subject.result, Analysis):
        return f"{subject.result.status[0].upper()}{subject.result.status[1:]}"
    if subject.valid:
        best = getattr(subject.result, "best", None)
        fit, comparison = (getattr(best, name, None) for name in ("fit", "comparison"))
        beside = f"; {product(comparison)}" if comparison else ""
        return (f"Valid, {fit.text}" if fit is not None and fit.grade == "poor" else "Valid: every check passed") + beside
    if subject.result.status is Status.INFEASIBLE:
        return "No feasible design found"
    failed = _failed(subject)
    return f"Not valid: {failed}" if failed else f"Not valid: {subject.result.status.value}"


def _conclusion(subject: ReportModel, shown: Summary) -> str:
    """Return the conclusion of the result; of the kind of an extension the first line of its status."""
    outcome = subject.result
    if isinstance(outcome, Analysis):
        return conclusions.analysis(outcome)
    if isinstance(outcome, FunctionResult | PathResult | CycleResult):
        solution = None if outcome.best is None else outcome.best.solution
        text = conclusions.design(outcome, subject.limits if solution is None else solution.limits)
        return f"{conclusions.sensitivities(subject.effects)} {text}" if subject.effects is not None else text
    return "".join(span.text for line in shown.status.lines[:1] for span in line)


def _failed(subject: ReportModel) -> str:
    """Return the names of the failed checks."""
    checked = getattr(subject.result, "validation", None)
    names = checked.failed if checked else ()
    return ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")


def _kind(subject: ReportModel) -> str:
    return "analysis" if isinstance(subject.result, Analysis) else subject.problem.task


def charts(subject: ReportModel) -> list[ChartSpec]:
    """Return the charts of the result and, for a design, those of its machine over the cycle."""
    outcome, kind = subject.result, _kind(subject)
    view = view_of(kind)
    found = [*view.charts(view.model(outcome))]
    if subject.cycle is not None and kind != "analysis":
        course, cycle = CycleCurves(subject.cycle), isinstance(outcome, CycleResult)
        initial = outcome.initial_analysis if isinstance(outcome, CycleResult) else None
        given = None if initial is None else CycleCurves(initial)
        if cycle or subject.forces:
            found += analysis_charts.motion(course, given)
        if cycle or (isinstance(outcome, PathResult) and outcome.best is not None and outcome.best.task.pointed):
            found += analysis_charts.transmission(course)
        if subject.forces:
            found += analysis_forces.forces(course, given)
    return found


def _with_recorded_limits(subject: ReportModel, shown: Summary) -> list[Part]:
    """Return the tables of the result, with the stored active constraints before the validation."""
    parts = list(shown.parts)
    if subject.limits and getattr(subject.result, "solution", None) is None:  # it has no shadow prices of its own
        titles = [part.title if isinstance(part, TableSpec) else "" for part in parts]
        parts.insert(
            next((k for k, title in enumerate(titles) if "Validation" in title), len(parts)),
            function_tables.active(subject.problem.model, subject.objective, subject.limits),
        )
    return parts


def _by(subject: ReportModel) -> str:
    outcome = subject.result
    if isinstance(outcome, Analysis):
        return "analysis of the machine; nothing was optimised"
    if outcome.backend == "none":
        return "check of a given design; nothing was optimised"
    starts = f"{outcome.starts} start{'s' * (outcome.starts != 1)}, seed {outcome.seed}"
    return f"{outcome.backend}, {starts}; verified by an independent sweep of the kinematics"
