"""Charts and page of a Pareto front: end points, knee and the design of every point."""

import itertools
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from optlink.problem.base_model import Contradiction
from optlink.problem.file import ProblemFile
from optlink.report.chart_spec import Array, Axis, ChartSpec, Curve, Mark, Panel, Picks
from optlink.report.format import number
from optlink.report.html import chart_plotly
from optlink.report.html.shell import PageSection, StoredStudy
from optlink.report.stored.stored_study import named_si, no_animation, turning_linkage, with_drawings
from optlink.report.style import LIMIT, MUTED, RESULT, TARGET
from optlink.report.view import View
from optlink.report.views import conclusions, study_tables
from optlink.studies import grid
from optlink.studies.pareto.epsilon_constraint import Pareto, ParetoPoint, ParetoRecord
from optlink.studies.pareto.objective import ParetoObjective

REFERENCE_NAMES = {"initial machine": "the initial machine", "limits of the file": "the optimum for the limits of the file"}
SENSES = {"minimise": 1, "maximise": -1}


def read(record: ParetoRecord, file: ProblemFile, path: Path) -> Pareto:
    """Return a stored Pareto front.

    Parameters
    ----------
    file : ProblemFile
        The problem of the study.
    path : Path
        File of the record.

    Raises
    ------
    Contradiction
        If its parts do not belong together.
    """
    objectives = tuple(
        ParetoObjective(objective_record.name, objective_record.name, objective_record.unit, SENSES[objective_record.sense])
        for objective_record in record.objectives
    )
    columns = [objective.column for objective in objectives]
    for k, (objective, objective_record) in enumerate(zip(objectives, record.objectives, strict=True)):
        if objective.column != objective_record.column:
            message = f"this is not the column of {objective.name} [{objective.unit}]"
            raise Contradiction(f"objectives[{k}].column", message, objective_record.column)
    if record.minimised not in columns:
        raise Contradiction("minimised", "this is none of the objectives", record.minimised)
    if len({tuple(point.design) for point in record.front}) > 1:
        raise Contradiction("front", "its designs have different design variables")
    places: dict[str, Mapping[str, object]] = {"ends": record.ends if record.front else dict.fromkeys(columns, 0)}
    places |= {f"front[{k}].objectives": point.objectives for k, point in enumerate(record.front)}
    places |= {} if record.reference is None else {"reference": record.reference}
    for where, texts in places.items():
        for name in columns:
            if not isinstance(texts.get(name), int | float):
                raise Contradiction(f"{where}.{name}", "this is missing or not a number")
    ends = tuple(record.ends[name] for name in columns) if record.front else ()
    knee = None if record.knee is None else (record.knee.point, record.knee.distance)
    if any(not 0 <= k < len(record.front) for k in (*ends, *([knee[0]] if knee else []))):
        raise Contradiction("ends", "an end or the knee is not a point of the front")
    for k, axis_ in enumerate(record.constrained):
        if not 0 < axis_.values <= grid.MAX_POINTS:
            raise Contradiction(f"constrained[{k}].values", "there are too many", axis_.values)
    spans = [
        (
            objective_record.key,
            objective_record.unit,
            np.linspace(objective_record.first, objective_record.last, objective_record.values),
        )
        for objective_record in record.constrained
    ]
    points = [
        ParetoPoint(
            tuple(objective_record.objectives[name] for name in columns),
            objective_record.design,
            "; ".join(objective_record.active),
            objective_record.mark or "",
        )
        for objective_record in record.front
    ]
    reference = record.reference or {}
    return record.build(
        Pareto,
        problem=file,
        objectives=objectives,
        minimised=columns.index(record.minimised),
        points=tuple(points),
        ends=ends,
        knee=knee,
        reference=tuple(float(reference[name]) for name in columns) if reference else None,
        reference_label=str(reference.get("what", "")),
        grid=grid.Grid(tuple(grid.Axis(key, unit, tuple(values.tolist())) for key, unit, values in spans)),
        path=path,
    )


# --- the page ----------------------------------------------------------------------------------------------------------------


def stored_study(record: ParetoRecord, file: ProblemFile, path: Path) -> StoredStudy:
    """Build the report of a stored Pareto front.

    Parameters
    ----------
    file : ProblemFile
        The problem of the study.
    path : Path
        File of the record.

    Raises
    ------
    InputError
        If the record is damaged.
    """
    front = read(record, file, path)
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


VIEW = View(charts=charts, tables=lambda result: {"front": result.columns}, page=stored_study)
