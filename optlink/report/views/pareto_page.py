"""HTML sections of a Pareto study: the front with its end points, its knee and the design of every point."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from optlink.problem.file import ProblemFile
from optlink.record import Contradiction
from optlink.report.format import number
from optlink.report.html.chart_plotly import Chart, Picks, Trace, axis, line, mark, sheet, short
from optlink.report.html.shell import Section
from optlink.report.stored.stored_study import Studied, figures_of, named_si, still, turning
from optlink.report.style import FOUND, LIMIT, QUIET, WANTED
from optlink.report.views import pareto_tables
from optlink.studies.grid import MAX_POINTS, Axis, Grid
from optlink.studies.pareto.epsilon_constraint import Pareto, ParetoPoint, ParetoRecord
from optlink.studies.pareto.objective import ParetoObjective

Array = NDArray[np.float64]
OTHERS = {"given machine": "the given machine", "as the file asks": "what the file asks"}
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
        raise Contradiction("front", "its designs differ in what is free")
    places: dict[str, Mapping[str, object]] = {"ends": record.ends if record.front else dict.fromkeys(columns, 0)}
    places |= {f"front[{k}].objectives": point.objectives for k, point in enumerate(record.front)}
    places |= {} if record.given is None else {"given": record.given}
    for where, told in places.items():
        for name in columns:
            if not isinstance(told.get(name), int | float):
                raise Contradiction(f"{where}.{name}", "this is missing or not a number")
    ends = tuple(record.ends[name] for name in columns) if record.front else ()
    knee = None if record.knee is None else (record.knee.point, record.knee.distance)
    if any(not 0 <= k < len(record.front) for k in (*ends, *([knee[0]] if knee else []))):
        raise Contradiction("ends", "an end or the knee is no point of the front")
    for k, axis_ in enumerate(record.held):
        if not 0 < axis_.values <= MAX_POINTS:
            raise Contradiction(f"held[{k}].values", "no front has so many", axis_.values)
    axes = tuple(Axis(one.key, one.unit, tuple(np.linspace(one.first, one.last, one.values).tolist())) for one in record.held)
    points = [
        ParetoPoint(tuple(one.objectives[name] for name in columns), one.design, "; ".join(one.active), one.mark or "")
        for one in record.front
    ]
    given = record.given or {}
    return record.build(
        Pareto,
        problem=file,
        aims=aims,
        minimised=columns.index(record.minimised),
        points=tuple(points),
        ends=ends,
        knee=knee,
        given=tuple(float(given[name]) for name in columns) if given else None,
        given_words=str(given.get("what", "")),
        grid=Grid(axes),
        path=path,
    )


# --- the page ----------------------------------------------------------------------------------------------------------------


def studied(record: ParetoRecord, file: ProblemFile, path: Path) -> Studied:
    """Build the report of a stored Pareto front.

    Parameters
    ----------
    record : ParetoRecord
    file : ProblemFile
        The problem of the study.

    Raises
    ------
    InputError
        If the record is damaged.
    """
    found = read(record, file, path)
    shown = pareto_tables.front(found)
    chosen = _chosen(found)
    words = f"The design of point {chosen + 1}: {found.points[chosen].mark or 'the first'}." if chosen is not None else ""
    charts = (_front(found),) if len(found.points) > 1 else ()
    return Studied(
        problem=file,
        kind=f"front of {len(found.aims)} objectives",
        verdict="Every point of the front is proven" if found.complete else "Not every point could be proven",
        valid=found.complete,
        status=shown.status.lines,
        sections=[*([Section("Front", charts)] if charts else []), *figures_of(shown.parts, "Points and designs")],
        moving=still if chosen is None else turning(file, named_si(file, found.points[chosen].design)),
        by="optima along limits on all objectives but one, each proven by the validator (epsilon constraint method)",
        drawn=words,
        after=1 if charts else 0,
    )


def _chosen(found: Pareto) -> int | None:
    """Return the index of the point whose machine is drawn: the knee, otherwise the best point of the first objective."""
    if not found.points:
        return None
    return found.ends[0] if found.knee is None else found.knee[0]


def _named(aim: ParetoObjective) -> str:
    unit = f" [{aim.unit.replace('*', ' ')}]" if aim.unit else ""
    return f"{aim.name}{unit}{'' if aim.sense > 0 else ' (more is better)'}"


def _front(found: Pareto) -> Chart:
    """Plot two objectives as a curve, or three as points coloured by the third."""
    values = np.array([point.values for point in found.points])
    x, y = values[:, 0], values[:, 1]
    picks = _picks(found, x, y)
    numbers = list(range(len(values)))
    layout = sheet(480) | {"hovermode": "closest"}
    if len(found.aims) == 2:
        curve: Trace = line(x, y, "front", FOUND, width=2.2) | {"mode": "lines+markers", "customdata": numbers}
        ends = list(found.ends)
        chord = line(x[ends], y[ends], "chord of the ends", QUIET, width=1.0, dash="dash") | {"hoverinfo": "skip"}
        curves = [chord, curve]
    else:
        cloud = line(x, y, "front", FOUND, width=9.0, mode="markers") | {"customdata": numbers}
        bar = {"title": {"text": escape(_named(found.aims[2])), "side": "right"}, "thickness": 16}
        curves = [cloud | {"marker": {"size": 9, "color": short(values[:, 2]), "colorscale": "Viridis", "colorbar": bar}}]
    marked = [k for k, point in enumerate(found.points) if point.mark]
    stars = line(x[marked], y[marked], "ends and knee", LIMIT, width=11.0, mode="markers+text") | {"customdata": marked}
    words = [escape(found.points[k].mark) for k in marked]
    stars |= {"mode": "markers+text", "marker": {"size": 11, "color": "rgba(0,0,0,0)", "line": {"color": LIMIT, "width": 2}}}
    stars |= {"text": words, "textposition": [_side(x, y, k) for k in marked], "textfont": {"color": LIMIT, "size": 11}}
    curves.append(stars)
    if found.given is not None:
        given = line(np.array([found.given[0]]), np.array([found.given[1]]), found.given_words, WANTED, width=9.0, mode="markers")
        curves.append(given | {"marker": given["marker"] | {"symbol": "square"}})
    layout["xaxis"], layout["yaxis"] = axis(_named(found.aims[0])), axis(_named(found.aims[1]))
    curves.append(mark(picks))
    title = f"{found.aims[0].name} against {' and '.join(aim.name for aim in found.aims[1:])}"
    return Chart(title[0].upper() + title[1:], {"data": curves, "layout": layout}, False, picks)


def _side(x: Array, y: Array, k: int) -> str:
    """Return the text position of a point label, towards the centre of the chart."""
    across = "right" if x[k] < 0.5 * (np.min(x) + np.max(x)) else "left"
    return f"{'bottom' if y[k] > 0.5 * (np.min(y) + np.max(y)) else 'top'} {across}"


def _picks(found: Pareto, x: Array, y: Array) -> Picks:
    """Tabulate the design of every point."""
    names: list[str] = []
    for aim in found.aims:
        names += [_named(aim), f"{aim.name}: change"] if found.given is not None else [_named(aim)]
    names += ["{} [{}]".format(*name.rpartition("_")[::2]) for name in found.points[0].design]
    rows = []
    for point in found.points:
        told: list[str] = []
        for k, value in enumerate(point.values):
            told.append(number(value, 7))
            if found.given is not None:
                told.append(pareto_tables.against(value, found.given[k]))
        told += [number(value, 7) for value in point.design.values()]
        rows.append((*told, point.active or "nothing", point.mark or "–"))
    told_words = f"point (changes: against {OTHERS.get(found.given_words, found.given_words)})" if found.given else "point"
    return Picks(told_words, (*names, "held by", "mark"), tuple(rows), short(x), short(y), _chosen(found) or 0)
