"""HTML of a result for notebooks: its table, and its linkage or first chart as SVG."""

from __future__ import annotations

import io
from typing import Any, get_args

from optlink.errors import InputError
from optlink.problem.file import ProblemFile
from optlink.report.html.shell import fragment
from optlink.report.registry import table_of, view_of
from optlink.report.report_model import resulting_machine
from optlink.report.scene import scene
from optlink.report.stored.loader import KNOWN
from optlink.tasks.analyze import analyze
from optlink.tasks.function import FunctionResult
from optlink.tasks.results.analysis import Analysis
from optlink.tasks.results.balance import Balance
from optlink.tasks.results.cycle import CycleResult
from optlink.tasks.results.path import PathResult


def notebook_html(result: Any) -> str | None:
    """Return the table and the drawing of a result as HTML; None for a kind without a table.

    Parameters
    ----------
    result : any result of `optlink`
    """
    [schema] = get_args(type(result).record.model_fields["format"].annotation)
    if schema not in KNOWN:
        return None
    _, kind = KNOWN[schema]
    shown = table_of(kind)(result)
    return fragment(shown.status, *shown.parts) + (_linkage(result) or _chart(kind, result))


def _linkage(result: Any) -> str:
    """Return the resulting linkage as SVG; an empty text if the result has none."""
    from optlink.report.export.svg import svg

    cycle: Analysis | None = result if isinstance(result, Analysis) else None
    machine: ProblemFile | None = result.balanced if isinstance(result, Balance) else None
    try:
        if isinstance(result, FunctionResult | PathResult | CycleResult):
            machine = resulting_machine(result)
        cycle = analyze(machine) if machine is not None else cycle
    except InputError:  # a design that cannot be assembled
        return ""
    return "" if cycle is None else svg(scene(cycle), result.problem.model.title)


def _chart(kind: str, result: Any) -> str:
    """Return the first chart or drawing of a result as SVG; an empty text if it has none."""
    from optlink.report.chart_mpl import draw

    view = view_of(kind)
    drawings = (made for drawing in view.drawings.values() if (made := drawing(result)) is not None)
    first = next((draw([chart]) for chart in view.charts(view.model(result))), None) or next(drawings, None)
    if first is None:
        return ""
    text = io.StringIO()
    first.savefig(text, format="svg")
    return text.getvalue()[text.getvalue().index("<svg") :]
