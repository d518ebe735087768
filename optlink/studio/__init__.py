"""The studio: a browser page on which a linkage is re-optimised while one of its handles is dragged."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from optlink.errors import InputError, extra_remedy
from optlink.problem.arguments import typed
from optlink.problem.file import ProblemFile, dump

if TYPE_CHECKING:
    from optlink.studio.widget import Canvas


@typed
def explore(problem: ProblemFile | str | Path) -> Canvas:
    """Show a problem in a notebook: the canvas of the studio, on which you drag the linkage and the optimum follows.

    Parameters
    ----------
    problem : ProblemFile, str or Path
        Problem, name of a shipped problem, or path of a problem file.

    Returns
    -------
    Canvas
        Shown by a notebook; `problem` and `result` are the current ones.

    Raises
    ------
    InputError
        If the package anywidget is not installed, or the problem cannot be used.
    """
    try:
        from optlink.studio.widget import Canvas
    except ImportError:
        raise InputError("explore needs the package anywidget, which is not installed", extra_remedy("notebook")) from None
    from optlink.studio.document import Document, named

    if isinstance(problem, ProblemFile):
        return Canvas(Document(problem.name, dump(problem), problem.folder))
    return Canvas(named(str(problem)))
