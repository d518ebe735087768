"""HTML report of a design: linkage in motion, result and validation, sensitivities, charts, sources."""

import functools
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from optlink.errors import InputError, Status
from optlink.io import whole
from optlink.presentation.chart_spec import ChartSpec
from optlink.presentation.format import single_units
from optlink.presentation.html.gallery import gallery
from optlink.presentation.html.moving_linkage import Moving, turning
from optlink.presentation.html.study_page import moving_of, study_page
from optlink.presentation.registry import view_of
from optlink.presentation.report_model import ReportModel, report_model_of
from optlink.presentation.table_spec import Paragraph, Span, Summary
from optlink.presentation.view import PageSection, StoredStudy, registered_charts
from optlink.presentation.views import analysis_charts, conclusions, sensitivity
from optlink.presentation.views.analysis_charts import CycleCurves
from optlink.studies.sensitivity import Sensitivities, of_solution
from optlink.tasks.analyze import Analysis
from optlink.units import count_noun


def write_page(model: ReportModel | StoredStudy, path: Path, *, brief: bool = False) -> None:
    """Write the HTML page of a report model or of a stored result.

    Parameters
    ----------
    model : ReportModel or StoredStudy
    path : Path
    brief : bool, optional
        Write the short page instead.

    Raises
    ------
    InputError
        If the file cannot be written; then no file is left behind.
    """
    text = page(model, brief=brief)
    with whole(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def page(model: ReportModel | StoredStudy, *, brief: bool = False) -> str:
    """Return the HTML page of a report model or of a stored result, or the short one."""
    return study_page(model if isinstance(model, StoredStudy) else _report(model), brief=brief)


def _report(model: ReportModel) -> StoredStudy:
    outcome: Any = model.result
    view, requested = view_of(outcome.kind), model.effects is not None
    effects = model.effects or sensitivities_of(model)
    with single_units():
        shown, proof = (
            view.table(outcome),
            getattr(getattr(outcome, "certificate", None), "text", ""),
        )  # stated once, by the table
        curves = [replace(one, remark="" if one.remark == proof else one.remark) for one in charts(model)]
        sections = [PageSection(view.heading, (list(shown.parts),)), PageSection("Curves", curves)]
        pictures = gallery(outcome) if getattr(outcome, "exact_solutions", None) is not None else None
        if pictures is not None:
            sections.insert(1, PageSection("Exact solutions", (pictures,)))
        if effects is not None:
            tornado = [replace(one, brief=requested) for one in sensitivity.charts(effects)]
            parts: list[Any] = [*tornado, tuple(sensitivity.parts(effects))]
            sections.insert(0 if requested else 1, PageSection("Sensitivities", parts))
        if model.cycle is None and model.unmoved:
            unmoved = PageSection("Linkage", (Paragraph(f"It cannot be shown in motion: {model.unmoved}."),))
            sections.insert(1 if requested else 0, unmoved)
        if view.conclusion is not None:
            conclusion = view.conclusion(outcome)
        else:
            conclusion = "".join(span.text for line in shown.status.lines[:1] for span in line)
        if model.effects is not None:
            conclusion = f"{sensitivity.conclusion(model.effects)} {conclusion}"
        return StoredStudy(
            problem=model.problem,
            kind=model.problem.kind,
            verdict=model.verdict,
            valid=model.valid,
            conclusion=conclusion,
            status=_status(model, shown),
            sections=sections,
            moving=functools.partial(animation_of, model),
            by=_method(model),
            after=1 if requested else 0,  # the requested study comes first
            notes=model.notes,
            achieved=_achieved(model),
            limits=view.limits(outcome),
        )


def _achieved(model: ReportModel) -> str:
    """Return in one sentence what the machine is and does."""
    outcome: Any = model.result
    view = view_of(outcome.kind)
    told = (view.achieved or view.conclusion or (lambda _: ""))(outcome)
    if model.cycle is None:
        return told
    best = getattr(outcome, "best", None)
    motions = [one for one in (() if best is None else conclusions.motions(best.validation.checks)) if one not in told]
    clauses = [*motions, *filter(None, told.rstrip(".").split(". "))]
    return f"{conclusions.machine(model.cycle)}: {'; '.join(clause[:1].lower() + clause[1:] for clause in clauses)}."


def animation_of(model: ReportModel, steps: int) -> Moving | None:
    """Return the animated machine of a report model for a number of positions per revolution; None if there is none."""
    return None if model.cycle is None else turning(model.cycle, steps, model.regions)


def moving_linkage(result: Any, steps: int) -> Moving | None:
    """Return the moving linkage of any result; None if it has none, or if it cannot be assembled."""
    try:
        page = view_of(result.kind).page
        about = report_model_of(result) if page is None else page(result)
        return animation_of(about, steps) if isinstance(about, ReportModel) else moving_of(about, steps)
    except InputError:  # a design that cannot be assembled, a study without a design
        return None


def sensitivities_of(model: ReportModel) -> Sensitivities | None:
    """Return the sensitivities of an optimum to its parameters.

    None if there was no optimisation, no optimum, an exact solution, or no parameter with an effect.
    """
    best = getattr(model.result, "best", None)
    if best is None or best.solution is None or best.solution.status is not Status.OPTIMAL:
        return None
    if getattr(best, "exact", False):  # a result of an extension has no such member
        return None
    result = of_solution(best.problem, best.solution)
    return result if result.moving else None


def _status(model: ReportModel, shown: Summary) -> Sequence[Sequence[Span]]:
    """Return the lines of the status, without what the conclusion states: a conflict, a proof, the change of one objective."""
    outcome: Any = model.result
    if getattr(outcome, "refuted", ""):
        return shown.status.lines[1:]
    proof = getattr(outcome, "certificate", None)
    if proof is not None and proof.closed and outcome.valid:
        shown = replace(shown, status=Paragraph(*(line for line in shown.status.lines if line[0].text != proof.text)))
    comparison = getattr(getattr(outcome, "best", None), "comparison", "")
    if not comparison or not (spec := outcome.problem.spec).single or not comparison.startswith(spec.goals[0].words):
        return shown.status.lines
    return [[span for span in line if span.text != f"; {comparison}"] for line in shown.status.lines]


def charts(model: ReportModel) -> list[ChartSpec]:
    """Return the charts of the result and, for a design, those of its machine over the cycle."""
    outcome: Any = model.result
    view = view_of(outcome.kind)
    result = [*view.charts(view.model(outcome))]
    if model.cycle is not None and model.cycle is not outcome:
        curves, of_cycle = CycleCurves(model.cycle), outcome.problem.model.of_cycle
        first = outcome.best.initial_analysis if of_cycle else None
        initial = None if first is None else CycleCurves(first)
        result += analysis_charts.motion(curves, initial) if of_cycle or model.forces else []
        result += analysis_charts.transmission(curves) if of_cycle else []
        result += analysis_charts.forces(curves, initial) if model.forces else []
    return result + registered_charts(outcome)


def _method(model: ReportModel) -> str:
    outcome = model.result
    if isinstance(outcome, Analysis):
        return "analysis of the machine; nothing was optimised"
    if getattr(outcome, "exact_solutions", None) is not None and outcome.backend == "none":
        return "exact solutions of equations; verified by an independent sweep of the kinematics"
    if outcome.backend == "none":
        return "check of a given design; nothing was optimised"
    starts = f"{count_noun(outcome.starts, 'start')}, seed {outcome.seed}"
    return f"{outcome.backend}, {starts}; verified by an independent sweep of the kinematics"
