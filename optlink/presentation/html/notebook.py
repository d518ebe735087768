"""Results in a notebook: table, linkage and chart."""

from __future__ import annotations

import io
import itertools
import json
import re
from typing import TYPE_CHECKING, Any

from optlink.presentation.html.moving_linkage import Moving
from optlink.presentation.html.page import moving_linkage
from optlink.presentation.html.shell import asset, fragment, templates
from optlink.presentation.registry import view_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

STEPS = 120  # positions per revolution


def notebook_html(result: Any) -> str | None:
    """Return the drawings and the tables of a result as HTML; None for a kind without a table."""
    view = view_of(result.kind)
    if view.no_page:
        return None
    shown = view.table(result)
    moving = moving_linkage(result, STEPS)
    linkage = "" if moving is None else _linkage(moving, result.problem.model.title)
    chart = _chart(result) if moving is None or view.page is not None else ""
    return fragment(shown.status) + linkage + chart + fragment(*shown.parts)


def _linkage(moving: Moving, title: str) -> str:
    """Return a linkage that a slider moves, as HTML for any number of outputs of a notebook."""
    motion = json.dumps(moving.to_dict(), separators=(",", ":"), allow_nan=False)
    script = asset("motion.js") + asset("notebook.js")
    text = templates().get_template("notebook.html").render(moving=moving, title=title, motion=motion, script=script)
    return text.replace("\n\n", "\n")


def _chart(result: Any) -> str:
    """Return the first chart or drawing of a result as SVG; an empty text if it has none."""
    from optlink.presentation.chart_mpl import draw

    view = view_of(result.kind)
    charts = (draw([chart]) for chart in view.charts(view.model(result)))
    drawings = (fig for drawing in view.drawings.values() if (fig := drawing(result)) is not None)
    return next(map(_svg, itertools.chain(charts, drawings)), "")


def _svg(figure: Figure) -> str:
    from matplotlib import rc_context
    from matplotlib.text import Text

    from optlink.presentation.style import apply_style

    text = io.StringIO()
    for text_artist in figure.findobj(Text):
        text_artist.set_path_effects([])
    # Letters as text have a tenth of the size of outlines; without a salt, no other picture has the same names.
    with apply_style(), rc_context({"svg.fonttype": "none", "svg.hashsalt": None}):
        figure.savefig(text, format="svg")
    shown = text.getvalue()[text.getvalue().index("<svg") :]
    return re.sub(r' d="[^"]*"', lambda path: re.sub(r"(\.\d\d)\d+", r"\1", path[0]), shown)  # a hundredth of a point is enough
