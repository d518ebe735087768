"""Results in a notebook: table, linkage and chart."""

from __future__ import annotations

import io
import itertools
import json
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

from optlink.errors import InputError
from optlink.problem.base_model import Contradiction
from optlink.report.html.moving_linkage import Moving
from optlink.report.html.page import animation_of
from optlink.report.html.shell import asset, fragment, templates
from optlink.report.registry import schema_of, table_of, view_of
from optlink.report.report_model import report_model_of
from optlink.report.stored.loader import STUDIES, WITH_PAGE
from optlink.tasks.function import FunctionResult
from optlink.tasks.results.analysis import Analysis
from optlink.tasks.results.cycle import CycleResult
from optlink.tasks.results.path import PathResult

if TYPE_CHECKING:
    from matplotlib.figure import Figure

STEPS = 120  # positions per revolution


def notebook_html(result: Any) -> str | None:
    """Return the drawings and the tables of a result as HTML; None for a kind without a table."""
    schema = schema_of(type(result).record)
    if schema not in WITH_PAGE:
        return None
    _, kind = WITH_PAGE[schema]
    shown = table_of(kind)(result)
    moving = _moving(kind, result, study=schema in STUDIES)
    linkage = "" if moving is None else _linkage(moving, result.problem.model.title)
    chart = _chart(kind, result) if moving is None or schema in STUDIES else ""
    return fragment(shown.status) + linkage + chart + fragment(*shown.parts)


def _linkage(moving: Moving, title: str) -> str:
    """Return a linkage that a slider moves, as HTML for any number of outputs of a notebook."""
    motion = json.dumps(moving.to_dict(), separators=(",", ":"), allow_nan=False)
    script = asset("motion.js") + asset("notebook.js")
    text = templates().get_template("notebook.html").render(moving=moving, title=title, motion=motion, script=script)
    return text.replace("\n\n", "\n")


def _moving(kind: str, result: Any, *, study: bool) -> Moving | None:
    """Return the moving linkage of a result; None if it has none, or cannot be assembled."""
    try:
        if study:
            return view_of(kind).page(type(result).record.of(result), result.problem, Path("result.json")).moving(STEPS)
        drawn = isinstance(result, FunctionResult | PathResult | CycleResult | Analysis)
        return animation_of(report_model_of(result.problem, result), STEPS) if drawn else None
    except (InputError, Contradiction):  # a design that cannot be assembled, a study without a design
        return None


def _chart(kind: str, result: Any) -> str:
    """Return the first chart or drawing of a result as SVG; an empty text if it has none."""
    from optlink.report.chart_mpl import draw

    view = view_of(kind)
    charts = (draw([chart]) for chart in view.charts(view.model(result)))
    drawings = (fig for drawing in view.drawings.values() if (fig := drawing(result)) is not None)
    return next(map(_svg, itertools.chain(charts, drawings)), "")


def _svg(figure: Figure) -> str:
    from matplotlib import rc_context
    from matplotlib.text import Text

    from optlink.report.style import apply_style

    text = io.StringIO()
    for text_artist in figure.findobj(Text):
        text_artist.set_path_effects([])
    # Letters as text have a tenth of the size of outlines; without a salt, no other picture has the same names.
    with apply_style(), rc_context({"svg.fonttype": "none", "svg.hashsalt": None}):
        figure.savefig(text, format="svg")
    shown = text.getvalue()[text.getvalue().index("<svg") :]
    return re.sub(r' d="[^"]*"', lambda path: re.sub(r"(\.\d\d)\d+", r"\1", path[0]), shown)  # a hundredth of a point is enough
