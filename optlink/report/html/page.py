"""HTML report of a design: linkage in motion, result and validation, sensitivities, charts, sources."""

import functools
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from optlink.errors import Status
from optlink.io import whole
from optlink.report.chart_spec import ChartSpec
from optlink.report.format import single_units
from optlink.report.html import chart_plotly
from optlink.report.html.moving_linkage import Moving, turning
from optlink.report.html.shell import PageSection, StoredStudy
from optlink.report.html.study_page import study_page
from optlink.report.registry import table_of, view_of
from optlink.report.report_model import ReportModel, verdict
from optlink.report.table_spec import Paragraph, Span, Summary
from optlink.report.views import (
    analysis_charts,
    analysis_forces,
    conclusions,
    sensitivity,
    study_tables,
)
from optlink.report.views.analysis_curves import CycleCurves
from optlink.studies.sensitivity import Sensitivities, of_solution
from optlink.tasks.analyze import Analysis


def write_page(model: ReportModel | StoredStudy, path: Path) -> None:
    """Write the HTML page of a report model or of a stored result.

    Parameters
    ----------
    model : ReportModel or StoredStudy
    path : Path

    Raises
    ------
    InputError
        If the file cannot be written; then no file is left behind.
    """
    text = page(model)
    with whole(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def page(model: ReportModel | StoredStudy) -> str:
    """Return the HTML page of a report model or of a stored result."""
    return study_page(model if isinstance(model, StoredStudy) else _report(model))


def _report(model: ReportModel) -> StoredStudy:
    effects = model.effects or sensitivities_of(model)
    with single_units():
        shown = table_of(model.result.kind)(model.result)
        return StoredStudy(
            problem=model.problem,
            kind=model.problem.kind,
            verdict=verdict(model),
            valid=model.valid,
            conclusion=_conclusion(model, shown),
            status=_status(model, shown),
            sections=list(_sections(model, shown, effects)),
            moving=functools.partial(animation_of, model),
            by=_method(model),
            after=1 if model.effects is not None else 0,  # the requested study comes first
            notes=model.notes,
        )


def animation_of(model: ReportModel, steps: int) -> Moving | None:
    """Return the animated machine of a report model; None if there is none.

    Parameters
    ----------
    steps : int
        Number of positions per revolution.
    """
    return None if model.cycle is None else turning(model.cycle, steps, model.regions)


# --- layout ------------------------------------------------------------------------------------------------------------------


def _sections(model: ReportModel, shown: Summary, effects: Sensitivities | None) -> Iterator[PageSection]:
    if effects is not None and model.effects is not None:
        yield _sensitivity_section(effects)
    if model.cycle is None and model.unmoved:
        yield PageSection("Linkage", (Paragraph(f"It cannot be shown in motion: {model.unmoved}."),))
    name = "Analysis" if isinstance(model.result, Analysis) else "Design and checks"
    yield PageSection(name, (list(shown.parts),))
    if effects is not None and model.effects is None:
        yield _sensitivity_section(effects)
    yield PageSection("Curves", chart_plotly.charts(charts(model)))


def _sensitivity_section(effects: Sensitivities) -> PageSection:
    """Return the section of the sensitivities."""
    figures = chart_plotly.charts(sensitivity.charts(effects))
    return PageSection("Sensitivities", (*figures, tuple(study_tables.sensitivity_parts(effects))))


def sensitivities_of(model: ReportModel) -> Sensitivities | None:
    """Return the sensitivities of an optimum to its parameters.

    None if there was no optimisation, no optimum, an exact solution, or no parameter with an effect.
    """
    best = getattr(model.result, "best", None)
    if best is None or best.solution is None or best.solution.status is not Status.OPTIMAL:
        return None
    if best.exact:
        return None
    result = of_solution(best.problem, best.solution)
    return result if result.moving else None


def _conclusion(model: ReportModel, shown: Summary) -> str:
    """Return the conclusion of the result; of the kind of an extension the first line of its status."""
    outcome: Any = model.result
    if isinstance(outcome, Analysis):
        return conclusions.analysis(outcome)
    if outcome.kind == "design":
        solution = None if outcome.best is None else outcome.best.solution
        text = conclusions.design(outcome, () if solution is None else solution.displayed_limits)
        return f"{conclusions.sensitivities(model.effects)} {text}" if model.effects is not None else text
    return "".join(span.text for line in shown.status.lines[:1] for span in line)


def _status(model: ReportModel, shown: Summary) -> Sequence[Sequence[Span]]:
    """Return the lines of the status, without what the conclusion states: a conflict, the change of one objective."""
    outcome = model.result
    if getattr(outcome, "refuted", ""):
        return shown.status.lines[1:]
    comparison = getattr(getattr(outcome, "best", None), "comparison", "")
    if not comparison or not (spec := outcome.problem.spec).single or not comparison.startswith(spec.goals[0].words):
        return shown.status.lines
    return [[span for span in line if span.text != f"; {comparison}"] for line in shown.status.lines]


def charts(model: ReportModel) -> list[ChartSpec]:
    """Return the charts of the result and, for a design, those of its machine over the cycle."""
    outcome: Any = model.result
    kind = outcome.kind
    view = view_of(kind)
    result = [*view.charts(view.model(outcome))]
    if model.cycle is not None and kind != "analysis":
        curves, cycle = CycleCurves(model.cycle), outcome.problem.model.of_cycle
        initial_analysis = outcome.best.initial_analysis if cycle else None
        initial = None if initial_analysis is None else CycleCurves(initial_analysis)
        if cycle or model.forces:
            result += analysis_charts.motion(curves, initial)
        if cycle:
            result += analysis_charts.transmission(curves)
        if model.forces:
            result += analysis_forces.forces(curves, initial)
    return result


def _method(model: ReportModel) -> str:
    outcome = model.result
    if isinstance(outcome, Analysis):
        return "analysis of the machine; nothing was optimised"
    if outcome.backend == "none":
        return "check of a given design; nothing was optimised"
    starts = f"{outcome.starts} start{'s' * (outcome.starts != 1)}, seed {outcome.seed}"
    return f"{outcome.backend}, {starts}; verified by an independent sweep of the kinematics"
