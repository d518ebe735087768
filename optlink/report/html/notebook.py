"""HTML of a result for notebooks: its table, its linkage with a slider, and the first chart of a study."""

from __future__ import annotations

import io
import json
import re
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

from optlink.errors import InputError
from optlink.problem.base_model import Contradiction
from optlink.report.chart_spec import ChartSpec
from optlink.report.html.moving_linkage import Moving
from optlink.report.html.page import moved
from optlink.report.html.shell import asset, fragment, templates
from optlink.report.registry import table_of, view_of
from optlink.report.report_model import Outcome, report_model_of
from optlink.report.stored.loader import KNOWN, STUDIES

if TYPE_CHECKING:
    from matplotlib.figure import Figure

STEPS = 120  # positions per revolution


def notebook_html(result: Any) -> str | None:
    """Return the drawings and the tables of a result as HTML; None for a kind without a table.

    Parameters
    ----------
    result : any result of `optlink`
    """
    [schema] = get_args(type(result).record.model_fields["format"].annotation)
    if schema not in KNOWN:
        return None
    _, kind = KNOWN[schema]
    shown = table_of(kind)(result)
    moving = _moving(kind, result, study=schema in STUDIES)
    linkage = "" if moving is None else moving_html(moving, result.problem.model.title)
    chart = _chart(kind, result) if moving is None or schema in STUDIES else ""
    return fragment(shown.status) + linkage + chart + fragment(*shown.parts)


def moving_html(moving: Moving, title: str) -> str:
    """Return a linkage that a slider moves, as HTML for any number of outputs of a notebook.

    Parameters
    ----------
    moving : Moving
    title : str
        Accessible name of the drawing.
    """
    motion = json.dumps(moving.to_dict(), separators=(",", ":"), allow_nan=False)
    script = asset("motion.js") + asset("notebook.js")
    made = templates().get_template("notebook.html").render(moving=moving, title=title, motion=motion, script=script)
    return made.replace("\n\n", "\n")


def _moving(kind: str, result: Any, *, study: bool) -> Moving | None:
    """Return the moving linkage of a result; None if it has none, or cannot be assembled."""
    try:
        if study:
            return view_of(kind).page(type(result).record.of(result), result.problem, Path("result.json")).moving(STEPS)
        return moved(report_model_of(result.problem, result), STEPS) if isinstance(result, Outcome) else None
    except (InputError, Contradiction):  # a design that cannot be assembled, a study without a design
        return None


def _chart(kind: str, result: Any) -> str:
    """Return the first chart or drawing of a result as SVG; an empty text if it has none."""
    view = view_of(kind)
    drawings = (made for drawing in view.drawings.values() if (made := drawing(result)) is not None)
    return chart_svg(view.charts(view.model(result))) or next(map(_svg, drawings), "")


def chart_svg(charts: Iterable[ChartSpec]) -> str:
    """Return the first of several charts as SVG; an empty text if there is none."""
    from optlink.report.chart_mpl import draw

    return next((_svg(draw([chart])) for chart in charts), "")


def _svg(figure: Figure) -> str:
    from matplotlib import rc_context
    from matplotlib.text import Text

    text = io.StringIO()
    for words in figure.findobj(Text):
        words.set_path_effects([])
    with rc_context({"svg.fonttype": "none"}):  # letters as text: a tenth of the size of outlines
        figure.savefig(text, format="svg")
    shown = text.getvalue()[text.getvalue().index("<svg") :]
    return re.sub(r' d="[^"]*"', lambda path: re.sub(r"(\.\d\d)\d+", r"\1", path[0]), shown)  # a hundredth of a point is enough
