"""Tables, charts and page of a Pareto front: end points, knee and the design of every point."""

import itertools
import math
from collections.abc import Iterator, Sequence
from functools import partial
from typing import Any

import numpy as np

from optlink.presentation.chart_spec import LIMIT, MUTED, RESULT, TARGET, Array, Axis, ChartSpec, Curve, Mark, Panel, Picks
from optlink.presentation.format import change, figure, joined, number, pretty
from optlink.presentation.table_spec import (
    Inline,
    Line,
    Paragraph,
    Row,
    Summary,
    TableSpec,
    bad,
    good,
    quiet,
    summary,
    table,
)
from optlink.presentation.view import PageSection, StoredStudy, View
from optlink.problem.file import ProblemFile
from optlink.studies.fronts.design_objectives import ParetoObjective
from optlink.studies.fronts.epsilon_constraint import Pareto, ParetoPoint
from optlink.units import count_noun

RATIO_ABOVE = 3.0  # ratio above which a change is not given in per cent
MAX_POINTS = 24  # largest number of listed points, besides the end points and the knee

REFERENCE_NAMES = {"initial machine": "the initial machine", "limits of the file": "the optimum for the limits of the file"}


# --- the page ----------------------------------------------------------------------------------------------------------------


def page(front: Pareto) -> StoredStudy:
    """Return the page of a Pareto front."""
    file = front.problem
    shown = overview(front)
    chosen = front.chosen
    words = f"The design of point {chosen + 1}: {front.points[chosen].mark or 'the first'}." if chosen is not None else ""
    return StoredStudy(
        problem=file,
        kind=f"front of {len(front.objectives)} objectives",
        verdict="Every point of the front is a verified local optimum" if front.valid else "Not every point is verified",
        valid=front.valid,
        conclusion=conclusion(front),
        status=shown.status.lines,
        sections=[PageSection("Front", charts(front)), PageSection("Points and designs", (shown.parts,))],
        design=None if chosen is None else _design(front, chosen),
        by="local optima with limits on all objectives but one (epsilon-constraint method), each verified by the validator",
        drawn=words,
        after=1,
    )


def _design(front: Pareto, k: int) -> tuple[ProblemFile, dict[str, float]]:
    """Return the problem and the design [SI] of a point."""
    return front.problem, dict(front.points[k].design)


# --- charts ------------------------------------------------------------------------------------------------------------------


def charts(result: Pareto) -> list[ChartSpec]:
    """Return the front with its end points, its knee and the reference design; of three objectives, its three projections."""
    if len(result.points) < 2:
        return []
    values = np.array([result.displayed(point.values) for point in result.points])
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
    reference = None if result.reference is None else result.displayed(result.reference)
    if reference is not None:
        place = reference[x], reference[y]
        marks.append(Mark(*place, result.reference_label, TARGET, "square", 6.0, written=True, gid="reference"))
    every = values if reference is None else np.vstack([values, reference])
    axes = [Axis(_objective_label(result.objectives[k]), _widened(every[:, k].tolist())) for k in (x, y)]
    title = f"{result.objectives[x].name} against {result.objectives[y].name}"
    panel, picks = Panel(axes[1], traces, 2.0, marks=marks), _picks(result, across, up) if first else None
    heading = f"{result.problem.model.title}: {', '.join(objective.name for objective in result.objectives)}"
    title, width = title[0].upper() + title[1:], 7.6 if two else 4.4
    more: dict[str, Any] = {"picks": picks, "designs": partial(_design, result), "width": width}
    return ChartSpec("front", title, [panel], axes[0], heading, cursor=False, **more)


def _widened(values: Sequence[float]) -> tuple[float, float]:
    low, high = min(values), max(values)
    margin = 0.12 * (high - low)
    return low - margin, high + margin


def _point_label(result: Pareto, point: ParetoPoint) -> str:
    """Return the label of a marked point with its change from the reference design."""
    words = point.mark.replace(", ", ",\n")
    if len(result.objectives) == 2 and result.reference is not None:
        changes = map(relative_change, point.values, result.reference)
        words += f"\n{', '.join(filter(None, changes))}"
    return words


def _objective_label(objective: ParetoObjective) -> str:
    unit = f" [{pretty(objective.unit)}]" if objective.unit else ""
    return f"{objective.name}{unit}{'' if objective.sense > 0 else ' (more is better)'}"


def _picks(front: Pareto, x: Array, y: Array) -> Picks:
    """Tabulate the design of every point."""
    names: list[str] = []
    for objective in front.objectives:
        names.append(_objective_label(objective))
        names += [f"{objective.name}: change"] if front.reference is not None else []
    shown = {name: front.problem.model.display(name) for name in front.points[0].design}
    names += [f"{name} [{unit}]" for name, (_, unit) in shown.items()]
    rows = []
    for point in front.points:
        texts: list[str] = []
        for k, value in enumerate(front.displayed(point.values)):
            texts.append(number(value, 7))
            if front.reference is not None:
                texts.append(relative_change(point.values[k], front.reference[k]))
        texts += [number(value * shown[name][0], 7) for name, value in point.design.items()]
        rows.append((*texts, point.active or "nothing", point.mark or "–"))
    reference = REFERENCE_NAMES.get(front.reference_label, front.reference_label)
    what = f"point (changes relative to {reference})" if front.reference else "point"
    return Picks(what, (*names, "active constraints", "mark"), tuple(rows), x, y, front.chosen or 0, range(len(rows)))


def overview(result: Pareto) -> Summary:
    """Summarise a Pareto front: points, end points, knee, and the change of each objective from the reference design."""
    title = result.problem.model.title
    if not result.points:
        return summary(title, _status(result))
    rate = (
        f"; {1e3 * result.processor_seconds / result.points_done_now:z.0f} ms of processor time each"
        if result.points_done_now
        else ""
    )
    knee = "knee by the distance from the chord of the ends (Das 1999)"
    effort = Paragraph(
        quiet(f"{count_noun(result.points_done_now, 'point')} done in {result.seconds:z.1f} s{rate}; {knee}"), appendix=True
    )
    return summary(title, _status(result), _points(result), _designs(result), effort)


def _status(result: Pareto) -> Iterator[Line]:
    names = [objective.name for objective in result.objectives]
    yield f"Front of {', '.join(names[:-1])} and {names[-1]}"
    missed = result.solved - result.valid_points - result.infeasible
    empty = f", {result.infeasible} without a feasible design" if result.infeasible else ""
    counted = f": {result.solved} solved, {result.dominated} dominated by others{empty}"
    left_out = bad(f", {missed} not verified and left out" if missed else "")
    yield f"{count_noun(len(result.points), 'point')}, ", good("each a verified local optimum"), counted, left_out
    if result.single_point:
        yield result.single_point
    elif result.points and result.knee is None:
        yield "No knee: the front is straight or curved away from the ideal point"


def _shown(result: Pareto) -> list[int]:
    """Return the indices of the listed points."""
    step = max(1, math.ceil(len(result.points) / MAX_POINTS))
    return [k for k, point in enumerate(result.points) if k % step == 0 or point.mark]


def _points(result: Pareto) -> TableSpec:
    """Tabulate the objectives of the points and their change from the reference design."""
    rows: list[Row] = [(str(k + 1), *_cells(result, result.points[k].values), result.points[k].mark) for k in _shown(result)]
    if result.reference is not None:
        rows.append(("", *_cells(result, result.reference), quiet(result.reference_label)))
    columns = [">"]
    for objective in result.objectives:
        columns.append(f">{objective.name}\n[{objective.unit}]" if objective.unit else f">{objective.name}")
        columns += [">change"] if _compared(result) else []
    return table("Front", [*columns, ""], rows, unbroken=True)


def _designs(result: Pareto) -> TableSpec:
    """Tabulate the design variables of the points."""
    free = {name: result.problem.model.display(name) for name in result.points[0].design}
    rows = [
        (str(k + 1), *(number(result.points[k].design[name] * factor, 5) for name, (factor, _) in free.items()))
        for k in _shown(result)
    ]
    return table("Designs", [">", *(f">{name}\n[{unit}]" for name, (_, unit) in free.items())], rows)


def _compared(result: Pareto) -> bool:
    """Return whether the table has columns for the change from the reference design."""
    return result.reference is not None and len(result.objectives) == 2


def _cells(result: Pareto, values: tuple[float, ...]) -> Iterator[Inline]:
    for k, value in enumerate(result.displayed(values)):
        yield number(value, 6)
        if result.reference is not None and _compared(result):
            yield quiet("" if values is result.reference else relative_change(values[k], result.reference[k]))


def relative_change(value: float, before: float) -> str:
    """Format the change of a value: in per cent, or as a ratio if it is large; empty if it was zero before."""
    if not before:
        return ""
    ratio = value / before
    return f"x {ratio:.3g}" if ratio >= RATIO_ABOVE else change(ratio - 1.0)


def conclusion(result: Pareto) -> str:
    """Return the conclusion of a Pareto front: ranges of the objectives, and the knee."""
    if not result.points:
        return "No point of the front has a verified design: relax the limits or widen the ranges of the objectives."
    if result.single_point:
        return f"{result.single_point}."
    spans = []
    for k, objective in enumerate(result.objectives):
        values = [point.values[k] / objective.si_per_unit for point in result.points]
        spans.append(f"{objective.name} {figure(min(values))} ... {figure(max(values), objective.unit)}")
    text = f"{len(result.points)} verified designs trade {' against '.join(spans)}."
    if result.knee is not None:
        at = result.displayed(result.points[result.knee[0]].values)
        knee = joined(
            [f"{objective.name} {figure(value, objective.unit)}" for objective, value in zip(result.objectives, at, strict=True)]
        )
        text += f" The knee of the front is point {result.knee[0] + 1}: {knee}."
    return text if result.valid else f"{text} Not every point is verified."


VIEW = View(overview, charts=charts, tables=lambda result: {"front": result.columns}, page=page)
