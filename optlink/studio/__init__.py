"""The studio: a browser page on which a linkage is re-optimised while one of its handles is dragged."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from optlink.errors import InputError
from optlink.problem.arguments import typed
from optlink.problem.file import ProblemFile, dump, load

if TYPE_CHECKING:
    from optlink.report.html.notebook import Explorer
    from optlink.studio.widget import Canvas


@typed
def explore(
    problem: ProblemFile | str | Path, design: Mapping[str, float] | None = None, *, sliders: bool = False
) -> Canvas | Explorer:
    """Show a problem in a notebook: the canvas of the studio, on which you drag the linkage and the optimum follows.

    Parameters
    ----------
    problem : ProblemFile, str or Path
        Problem, name of a shipped problem, or path of a problem file.
    design : mapping of str to float [m, rad], optional
        Initial design of the sliders.
    sliders : bool
        Show a slider for every dimension and limit instead of the canvas; a slider of a design variable validates the design
        that it makes (see `optlink.report.html.notebook.Explorer`). A given `design` implies it.

    Returns
    -------
    Canvas or Explorer
        Shown by a notebook; `problem` and `result` are the current ones.

    Raises
    ------
    InputError
        If a package of the notebook is not installed, or the problem cannot be used.
    """
    if sliders or design is not None:
        from optlink.report.html.notebook import Explorer

        return Explorer(problem if isinstance(problem, ProblemFile) else load(problem), design)
    try:
        from optlink.studio.widget import Canvas
    except ImportError:
        remedy = 'Install it: pip install "optlink[notebook]"'
        raise InputError("explore needs the package anywidget, which is not installed", remedy) from None
    from optlink.studio.document import Document, named

    if isinstance(problem, ProblemFile):
        return Canvas(Document(problem.name, dump(problem), problem.folder))
    return Canvas(named(str(problem)))
