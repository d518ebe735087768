"""Charts and page of a Pareto front: end points, knee and the design of every point."""

from __future__ import annotations

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
from optlink.report.stored.stored_study import named_si, still, turning, with_drawings
from optlink.report.style import FOUND, LIMIT, QUIET, TARGET
from optlink.report.view import View
from optlink.report.views import conclusions, study_tables
from optlink.studies import grid
from optlink.studies.pareto.epsilon_constraint import Pareto, ParetoPoint, ParetoRecord
from optlink.studies.pareto.objective import ParetoObjective

OTHERS = {"initial machine": "the initial machine", "limits of the file": "the optimum for the limits of the file"}
SENSES = {"minimise": 1, "maximise": -1}


def read(record: ParetoRecord, file: ProblemFile, path: Path) -> Pareto:
    """Return a stored Pareto front.

    Parameters
    ----------
    record : ParetoRecord
    file : ProblemFile
        The problem of the study.
    path : Path
        File of the record.

    Raises
    ------
    Contradiction
        If its parts do not belong together.
    """
    aims = tuple(ParetoObjective(one.name, one.name, one.unit, SENSES[one.sense]) for one in record.objectives)
    columns = [aim.column for aim in aims]
    for k, (aim, one) in enumerate(zip(aims, record.objectives, strict=True)):
        if aim.column != one.column:
            raise Contradiction(f"objectives[{k}].column", f"this is not the column of {aim.name} [{aim.unit}]", one.column)
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
    spans = [(one.key, one.unit, np.linspace(one.first, one.last, one.values)) for one in record.constrained]
    points = [
        ParetoPoint(tuple(one.objectives[name] for name in columns), one.design, "; ".join(one.active), one.mark or "")
        for one in record.front
    ]
    given = record.reference or {}
    return record.build(
        Pareto,
        problem=file,
        objectives=aims,
        minimised=columns.index(record.minimised),
        points=tuple(points),
        ends=ends,
        knee=knee,
        reference=tuple(float(given[name]) for name in columns) if given else None,
        reference_label=str(given.get("what", "")),
        grid=grid.Grid(tuple(grid.Axis(key, unit, tuple(values.tolist())) for key, unit, values in spans)),
        path=path,
    )


# --- the page ----------------------------------------------------------------------------------------------------------------


def stored_study(record: ParetoRecord, file: ProblemFile, path: Path) -> StoredStudy:
    """Build the report of a stored Pareto front.

    Parameters
    ----------
    record : ParetoRecord
    file : ProblemFile
        The problem of the study.
    path : Path
        File of the record.

    Raises
    ------
    InputError
        If the record is damaged.
    """
    found = read(record, file, path)
    shown = study_tables.pareto_front(found)
    chosen = _chosen(found)
    words = f"The design of point {chosen + 1}: {found.points[chosen].mark or 'the first'}." if chosen is not None else ""
    drawn = [
        with_drawings(chart, lambda k: (file, named_si(file, found.points[k].design)))
        for chart in chart_plotly.charts(charts(found))
    ]
    return StoredStudy(
        problem=file,
        kind=f"front of {len(found.objectives)} objectives",
        verdict="Every point of the front is a verified local optimum" if found.complete else "Not every point is verified",
        valid=found.complete,
        conclusion=conclusions.pareto(found),
        status=shown.status.lines,
        sections=[PageSection("Front", drawn), PageSection("Points and designs", (shown.parts,))],
        moving=still if chosen is None else partial(turning, file, named_si(file, found.points[chosen].design)),
        by="local optima with limits on all objectives but one (epsilon-constraint method), each verified by the validator",
        drawn=words,
        after=1,
    )


def _chosen(found: Pareto) -> int | None:
    """Return the index of the point whose machine is drawn: the knee, otherwise the best point of the first objective."""
    if not found.points:
        return None
    return found.ends[0] if found.knee is None else found.knee[0]


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
    along, up = values[:, x], values[:, y]
    numbers = range(len(values)) if first else ()
    if two:
        ends = list(result.ends)
        traces = [
            Curve(along, up, "front", FOUND, mode="lines+markers", picks=numbers, gid="front"),
            Curve(along[ends], up[ends], "chord of the ends", QUIET, 1.0, "dash", hover=False, gid="chord"),
        ]
    else:
        third = 3 - x - y
        shade: dict[str, Any] = {"shade": values[:, third], "shade_name": _named(result.objectives[third])}
        traces = [Curve(along, up, "front", FOUND, mode="markers", picks=numbers, legend=False, **shade, gid="front")]
    outward = (0.7 * result.objectives[x].sense, 0.7 * result.objectives[y].sense)  # away from the unattainable side of the front
    look: dict[str, Any] = {"symbol": "circle" if two else "open circle", "size": 7.0, "prefer": outward}
    look |= {"font": 8.5 if two else 7.5, "written": True}
    marks = [
        Mark(float(along[k]), float(up[k]), _words(result, point), LIMIT, gid=point.mark, **look)
        for k, point in enumerate(result.points)
        if point.mark
    ]
    if result.reference is not None:
        place = result.reference[x], result.reference[y]
        marks.append(Mark(*place, result.reference_label, TARGET, "square", 6.0, written=True, gid="reference"))
    every = values if result.reference is None else np.vstack([values, result.reference])
    axes = [Axis(_named(result.objectives[k]), _widened(every[:, k].tolist())) for k in (x, y)]
    title = f"{result.objectives[x].name} against {result.objectives[y].name}"
    panel, picks = Panel(axes[1], traces, 2.0, marks=marks), _picks(result, along, up) if first else None
    heading = f"{result.problem.model.title}: {', '.join(aim.name for aim in result.objectives)}"
    title, width = title[0].upper() + title[1:], 7.6 if two else 4.4
    return ChartSpec("front", title, [panel], axes[0], heading, picks=picks, cursor=False, width=width)


def _widened(values: Sequence[float]) -> tuple[float, float]:
    low, high = min(values), max(values)
    margin = 0.12 * (high - low)
    return low - margin, high + margin


def _words(result: Pareto, point: ParetoPoint) -> str:
    """Return the label of a marked point with its change from the reference design."""
    words = point.mark.replace(", ", ",\n")
    if len(result.objectives) == 2 and result.reference is not None:
        changes = [study_tables.against(value, before) for value, before in zip(point.values, result.reference, strict=True)]
        words += f"\n{', '.join(filter(None, changes))}"
    return words


def _named(aim: ParetoObjective) -> str:
    unit = f" [{aim.unit.replace('*', ' ').replace('^2', '²')}]" if aim.unit else ""
    return f"{aim.name}{unit}{'' if aim.sense > 0 else ' (more is better)'}"


def _picks(found: Pareto, x: Array, y: Array) -> Picks:
    """Tabulate the design of every point."""
    names: list[str] = []
    for aim in found.objectives:
        names += [_named(aim), f"{aim.name}: change"] if found.reference is not None else [_named(aim)]
    names += ["{} [{}]".format(*name.rpartition("_")[::2]) for name in found.points[0].design]
    rows = []
    for point in found.points:
        texts: list[str] = []
        for k, value in enumerate(point.values):
            texts.append(number(value, 7))
            if found.reference is not None:
                texts.append(study_tables.against(value, found.reference[k]))
        texts += [number(value, 7) for value in point.design.values()]
        rows.append((*texts, point.active or "nothing", point.mark or "–"))
    against = OTHERS.get(found.reference_label, found.reference_label)
    what = f"point (changes relative to {against})" if found.reference else "point"
    return Picks(what, (*names, "active constraints", "mark"), tuple(rows), x, y, _chosen(found) or 0, range(len(rows)))


VIEW = View(charts=charts, tables=lambda result: {"front": result.columns}, page=stored_study)
