"""Charts and page of a Pareto front: end points, knee and the design of every point."""

import itertools
from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np

from optlink.report.chart_spec import Array, Axis, ChartSpec, Curve, Mark, Panel, Picks
from optlink.report.format import number
from optlink.report.html import chart_plotly
from optlink.report.html.shell import PageSection, StoredStudy
from optlink.report.html.study_page import named_si, no_animation, turning_linkage, with_drawings
from optlink.report.style import LIMIT, MUTED, RESULT, TARGET
from optlink.report.view import View
from optlink.report.views import conclusions, study_tables
from optlink.studies.pareto.epsilon_constraint import Pareto, ParetoPoint
from optlink.studies.pareto.objective import ParetoObjective

REFERENCE_NAMES = {"initial machine": "the initial machine", "limits of the file": "the optimum for the limits of the file"}


# --- the page ----------------------------------------------------------------------------------------------------------------


def page(front: Pareto) -> StoredStudy:
    """Return the page of a Pareto front."""
    file = front.problem
    shown = study_tables.pareto_front(front)
    chosen = _initial_point(front)
    words = f"The design of point {chosen + 1}: {front.points[chosen].mark or 'the first'}." if chosen is not None else ""
    figures = [
        with_drawings(chart, lambda k: (file, named_si(file, front.points[k].design)))
        for chart in chart_plotly.charts(charts(front))
    ]
    return StoredStudy(
        problem=file,
        kind=f"front of {len(front.objectives)} objectives",
        verdict="Every point of the front is a verified local optimum" if front.complete else "Not every point is verified",
        valid=front.complete,
        conclusion=conclusions.pareto(front),
        status=shown.status.lines,
        sections=[PageSection("Front", figures), PageSection("Points and designs", (shown.parts,))],
        moving=no_animation if chosen is None else partial(turning_linkage, file, named_si(file, front.points[chosen].design)),
        by="local optima with limits on all objectives but one (epsilon-constraint method), each verified by the validator",
        drawn=words,
        after=1,
    )


def _initial_point(front: Pareto) -> int | None:
    """Return the index of the point whose machine is drawn: the knee, otherwise the best point of the first objective."""
    if not front.points:
        return None
    return front.ends[0] if front.knee is None else front.knee[0]


# --- charts ------------------------------------------------------------------------------------------------------------------


def charts(result: Pareto) -> list[ChartSpec]:
    """Return the front with its end points, its knee and the reference design; of three objectives, its three projections."""
    if len(result.points) < 2:
        return []
    values = np.array([point.values for point in result.points])
    pairs = list(itertools.combinations(range(len(result.objectives)), 2))
    return [_front(result, values, x, y) for x, y in pairs]


def _front(result: Pareto, values: Array, x: int, y: int) -> ChartSpec:
    """Plot two objectives as a curve, or as points coloured by the third objective."""
    two, first = len(result.objectives) == 2, (x, y) == (0, 1)
    across, up = values[:, x], values[:, y]
    numbers = range(len(values)) if first else ()
    if two:
        ends = list(result.ends)
        traces = [
            Curve(across, up, "front", RESULT, mode="lines+markers", picks=numbers, gid="front"),
            Curve(across[ends], up[ends], "chord of the ends", MUTED, 1.0, "dash", hover=False, gid="chord"),
        ]
    else:
        third = 3 - x - y
        shade: dict[str, Any] = {"shade": values[:, third], "shade_name": _objective_label(result.objectives[third])}
        traces = [Curve(across, up, "front", RESULT, mode="markers", picks=numbers, legend=False, **shade, gid="front")]
    outward = (0.7 * result.objectives[x].sense, 0.7 * result.objectives[y].sense)  # away from the unattainable side of the front
    style: dict[str, Any] = {"symbol": "circle" if two else "open circle", "size": 7.0, "prefer": outward}
    style |= {"font": 8.5 if two else 7.5, "written": True}
    marks = [
        Mark(across[k], up[k], _point_label(result, point), LIMIT, gid=point.mark, **style)
        for k, point in enumerate(result.points)
        if point.mark
    ]
    if result.reference is not None:
        place = result.reference[x], result.reference[y]
        marks.append(Mark(*place, result.reference_label, TARGET, "square", 6.0, written=True, gid="reference"))
    every = values if result.reference is None else np.vstack([values, result.reference])
    axes = [Axis(_objective_label(result.objectives[k]), _widened(every[:, k].tolist())) for k in (x, y)]
    title = f"{result.objectives[x].name} against {result.objectives[y].name}"
    panel, picks = Panel(axes[1], traces, 2.0, marks=marks), _picks(result, across, up) if first else None
    heading = f"{result.problem.model.title}: {', '.join(objective.name for objective in result.objectives)}"
    title, width = title[0].upper() + title[1:], 7.6 if two else 4.4
    return ChartSpec("front", title, [panel], axes[0], heading, picks=picks, cursor=False, width=width)


def _widened(values: Sequence[float]) -> tuple[float, float]:
    low, high = min(values), max(values)
    margin = 0.12 * (high - low)
    return low - margin, high + margin


def _point_label(result: Pareto, point: ParetoPoint) -> str:
    """Return the label of a marked point with its change from the reference design."""
    words = point.mark.replace(", ", ",\n")
    if len(result.objectives) == 2 and result.reference is not None:
        changes = map(study_tables.relative_change, point.values, result.reference)
        words += f"\n{', '.join(filter(None, changes))}"
    return words


def _objective_label(objective: ParetoObjective) -> str:
    unit = f" [{objective.unit.replace('*', ' ').replace('^2', '²')}]" if objective.unit else ""
    return f"{objective.name}{unit}{'' if objective.sense > 0 else ' (more is better)'}"


def _picks(front: Pareto, x: Array, y: Array) -> Picks:
    """Tabulate the design of every point."""
    names: list[str] = []
    for objective in front.objectives:
        names.append(_objective_label(objective))
        names += [f"{objective.name}: change"] if front.reference is not None else []
    names += ["{} [{}]".format(*name.rpartition("_")[::2]) for name in front.points[0].design]
    rows = []
    for point in front.points:
        texts: list[str] = []
        for k, value in enumerate(point.values):
            texts.append(number(value, 7))
            if front.reference is not None:
                texts.append(study_tables.relative_change(value, front.reference[k]))
        texts += [number(value, 7) for value in point.design.values()]
        rows.append((*texts, point.active or "nothing", point.mark or "–"))
    reference = REFERENCE_NAMES.get(front.reference_label, front.reference_label)
    what = f"point (changes relative to {reference})" if front.reference else "point"
    return Picks(what, (*names, "active constraints", "mark"), tuple(rows), x, y, _initial_point(front) or 0, range(len(rows)))


VIEW = View(charts=charts, tables=lambda result: {"front": result.columns}, page=page, result=Pareto)
