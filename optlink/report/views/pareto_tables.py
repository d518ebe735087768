"""Tables of a Pareto front of two or three objectives."""

from __future__ import annotations

import math
from collections.abc import Iterator

from optlink.report.format import change, number, points
from optlink.report.table_spec import Inline, Line, Paragraph, Row, Summary, TableSpec, bad, good, quiet, summary, table
from optlink.studies.pareto.epsilon_constraint import Pareto

MANY = 3.0  # ratio above which a change is not given in per cent
SHOWN = 24  # largest number of listed points, besides the end points and the knee


def pareto_front(result: Pareto) -> Summary:
    """Summarise a Pareto front: points, end points, knee, and the change of each objective from the reference design."""
    title = result.problem.model.title
    if not result.points:
        return summary(title, _status(result))
    rate = f"; {1e3 * result.cpu / result.done:z.0f} ms of processor time each" if result.done else ""
    knee = "knee by the distance from the chord of the ends (Das 1999)"
    effort = Paragraph(quiet(f"{points(result.done)} done in {result.seconds:z.1f} s{rate}; {knee}"), appendix=True)
    return summary(title, _status(result), _points(result), _designs(result), effort)


def _status(result: Pareto) -> Iterator[Line]:
    names = [aim.name for aim in result.objectives]
    found = f"{points(len(result.points))} of the front of {', '.join(names[:-1])} and {names[-1]}, "
    yield found, good("every one proven")
    missed = result.solved - result.valid - result.infeasible
    empty = f"; {result.infeasible} hold no design" if result.infeasible else ""
    beaten = f"{result.solved} solved; {result.dominated} {'is' if result.dominated == 1 else 'are'} beaten by others{empty}"
    yield beaten, bad(f"; {missed} could not be proven and are left out" if missed else "")
    if len(result.points) == 1:
        yield "No trade-off: one design is best in every objective"
    elif result.points and result.knee is None:
        yield "No knee: the front is straight or bulges the other way"


def _shown(result: Pareto) -> list[int]:
    """Return the indices of the listed points."""
    step = max(1, math.ceil(len(result.points) / SHOWN))
    return [k for k, point in enumerate(result.points) if k % step == 0 or point.mark]


def _points(result: Pareto) -> TableSpec:
    """Tabulate the objectives of the points and their change from the reference design."""
    rows: list[Row] = [(str(k + 1), *_cells(result, result.points[k].values), result.points[k].mark) for k in _shown(result)]
    if result.reference is not None:
        rows.append(("", *_cells(result, result.reference), quiet(result.reference_label)))
    columns = [">"]
    for aim in result.objectives:
        columns += [f">{aim.name}\n[{aim.unit}]" if aim.unit else f">{aim.name}", *([">"] if _compared(result) else [])]
    return table("Front", [*columns, ""], rows, unbroken=True)


def _designs(result: Pareto) -> TableSpec:
    """Tabulate the design variables of the points."""
    free = list(result.points[0].design)
    rows = [(str(k + 1), *(number(result.points[k].design[name], 5) for name in free)) for k in _shown(result)]
    return table("Designs", [">", *(">{}\n[{}]".format(*name.rpartition("_")[::2]) for name in free)], rows)


def _compared(result: Pareto) -> bool:
    """Return whether the table has columns for the change from the reference design."""
    return result.reference is not None and len(result.objectives) == 2


def _cells(result: Pareto, values: tuple[float, ...]) -> Iterator[Inline]:
    for k, value in enumerate(values):
        yield number(value, 6)
        if result.reference is not None and _compared(result):
            yield quiet("" if values is result.reference else against(value, result.reference[k]))


def against(value: float, before: float) -> str:
    """Format the change of a value: in per cent, or as a ratio if it is large.

    Parameters
    ----------
    value : float
    before : float
        Reference in the same unit; zero gives an empty text.
    """
    if not before:
        return ""
    ratio = value / before
    return f"x {ratio:.3g}" if ratio >= MANY else change(ratio - 1.0)
