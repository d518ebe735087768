"""Terminal tables of a Pareto front of two or three objectives."""

from __future__ import annotations

import math

from rich.console import Group, RenderableType
from rich.text import Text

from optlink.report.views.balance_tables import percent
from optlink.report.views.function_tables import BAD, GOOD, HEAD, QUIET, grid, number, points
from optlink.studies.pareto.epsilon_constraint import Pareto

MANY = 3.0  # ratio above which a change is not given in per cent
SHOWN = 24  # largest number of listed points, besides the end points and the knee


def front(result: Pareto) -> RenderableType:
    """Summarise a Pareto front: points, end points, knee, and the change of each objective from the reference design."""
    title = Text(result.problem.model.title, style=HEAD)
    title.append(f"\n{points(len(result.points))} of the front of {_and([aim.name for aim in result.aims])}, ")
    title.append("every one proven", style=GOOD)
    empty = f"; {result.infeasible} hold no design" if result.infeasible else ""
    title.append(
        f"\n{result.solved} solved; {result.dominated} {'is' if result.dominated == 1 else 'are'} beaten by others{empty}"
    )
    missed = result.solved - result.valid - result.infeasible
    if missed:
        title.append(f"; {missed} could not be proven and are left out", style=BAD)
    if not result.points:
        return Group(title)
    if len(result.points) == 1:
        title.append("\nNo trade-off: one design is best in every objective")
    elif result.knee is None:
        title.append("\nNo knee: the front is straight or bulges the other way")
    parts: list[RenderableType] = [title, Text(), _points(result), Text(), _designs(result)]
    rate = f"; {1e3 * result.cpu / result.done:.0f} ms of processor time each" if result.done else ""
    line = (
        f"{points(result.done)} done in {result.seconds:.1f} s{rate}; knee by the distance from the chord of the ends (Das 1999)"
    )
    return Group(*parts, Text(), Text(line, style=QUIET))


def _and(names: list[str]) -> str:
    return f"{', '.join(names[:-1])} and {names[-1]}"


def _shown(result: Pareto) -> list[int]:
    """Return the indices of the listed points."""
    step = max(1, math.ceil(len(result.points) / SHOWN))
    return [k for k, point in enumerate(result.points) if k % step == 0 or point.mark]


def _points(result: Pareto) -> RenderableType:
    """Tabulate the objectives of the points and their change from the reference design."""
    columns = [("", "right")]
    for aim in result.aims:
        columns += [(f"{aim.name}\n[{aim.unit}]" if aim.unit else aim.name, "right")]
        columns += [("", "right")] if _compared(result) else []
    table = grid("Front", [*columns, ("", "left")], header=True)
    for k in _shown(result):
        table.add_row(str(k + 1), *_cells(result, result.points[k].values), result.points[k].mark)
    if result.given is not None:
        table.add_row("", *_cells(result, result.given), Text(result.given_words, style=QUIET))
    return table


def _designs(result: Pareto) -> RenderableType:
    """Tabulate the design variables of the points."""
    free = list(result.points[0].design)
    heads = [("{}\n[{}]".format(*name.rpartition("_")[::2]), "right") for name in free]
    table = grid("Designs", [("", "right"), *heads], header=True)
    for k in _shown(result):
        table.add_row(str(k + 1), *(number(result.points[k].design[name], 5) for name in free))
    return table


def _compared(result: Pareto) -> bool:
    """Return whether the table has columns for the change from the reference design."""
    return result.given is not None and len(result.aims) == 2


def _cells(result: Pareto, values: tuple[float, ...]) -> list[RenderableType]:
    cells: list[RenderableType] = []
    for k, value in enumerate(values):
        cells.append(Text(number(value, 6), no_wrap=True))
        if result.given is not None and _compared(result):
            cells.append(Text("" if values is result.given else against(value, result.given[k]), style=QUIET, no_wrap=True))
    return cells


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
    return f"x {ratio:.3g}" if ratio >= MANY else percent(ratio - 1.0)
