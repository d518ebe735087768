"""What Python does with any result: write its page or a drawing, plot it, tabulate it, show it in a notebook."""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

from optlink.errors import InputError, UnknownName, extra_remedy, nearest
from optlink.io import folder as made
from optlink.presentation.format import column_unit
from optlink.presentation.registry import stored_page, view_of
from optlink.presentation.view import registered_charts
from optlink.problem.arguments import typed
from optlink.problem.document import Document, Result
from optlink.problem.file import AnyProblem, ProblemFile, problem_of
from optlink.problem.quantity import check_choice

if TYPE_CHECKING:
    import pandas
    from matplotlib.figure import Figure

    from optlink.presentation.report_model import ReportModel
    from optlink.presentation.view import StoredStudy

    Subject: TypeAlias = AnyProblem | Result
else:
    Subject = AnyProblem | Document  # all results are documents


MEASURE = re.compile(r"\.(min|max|rms)$")
"""End of the columns of a sweep that are a figure of a column of an analysis."""


def content(source: Subject, facts: Mapping[str, Any], name: str = "") -> ReportModel | StoredStudy:
    """Return what the page of a result shows; a problem is solved first, or analysed if it has nothing to design.

    `facts` are keys of `[report]`, such as the title, which stand at its head; `name` is the file of the result, for errors.
    """
    if isinstance(source, Document):
        return stored_page(source, facts, name)
    from optlink.presentation.report_model import report_model_of, solve_or_validate

    assert isinstance(source, ProblemFile | str | Path)
    return report_model_of(solve_or_validate(problem_of(source).override(facts)))


@typed
def report(source: Subject, file: str | Path, facts: Mapping[str, str] | None = None) -> Path:
    """Write a self-contained HTML page: results, checks, charts, animation, sources.

    Parameters
    ----------
    source : Result, ProblemFile, str or Path
        Any result; or a problem, which is solved first, or analysed if it has nothing to design.
    file : str or Path
        HTML file to write.
    facts : mapping of str to str, optional
        Entries at the head of the page: title, company, author, part, revision, date.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    InputError
        If results of this kind have no page, or the file cannot be written.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     page = optlink.report("crank-rocker", pathlib.Path(folder) / "page.html", {"author": "A. Designer"})
    ...     page.stat().st_size > 100_000
    True
    """
    from optlink.presentation.files import check_target
    from optlink.presentation.html.page import write_page

    path = check_target(Path(file), (".html", ".htm"), "report.html", "file")
    write_page(content(source, {f"report.{key}": text for key, text in (facts or {}).items()}), path)
    return path


@typed
def export(
    source: Subject,
    file: str | Path,
    *,
    at: float | None = None,
    hole: float | None = None,
    width: float | None = None,
    points: int = 360,
    even_invalid: bool = False,
) -> Path:
    """Export a design: a drawing at a crank angle as DXF or SVG, its motion as CSV, its geometry as JSON.

    Parameters
    ----------
    source : Result, ProblemFile, str or Path
        Result of `solve`, `validate` or `analyze`; or a problem, which is solved first, or analysed if it has nothing to design.
    file : str or Path
        File to write; its suffix selects the format: .dxf, .svg, .csv or .json.
    at : float [rad], optional
        Crank angle of the drawing. Default: the start of the motion.
    hole, width : float [m], optional
        Hole diameter and link width of the DXF drawing.
    points : int
        Steps of the CSV table per revolution.
    even_invalid : bool
        Write the design even if it is not valid.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    InputError
        If there is no single design, the design is not valid or cannot be assembled, or an option is out of range; nothing is
        written then.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     optlink.export("shaper", pathlib.Path(folder) / "shaper.dxf", hole=8e-3).name  # [m]
    'shaper.dxf'
    """
    from optlink.presentation.export.export import FORMATS, Options, export as write
    from optlink.presentation.files import check_target

    path = check_target(Path(file), tuple(FORMATS), "drawing.dxf", "file")
    options = Options(at, hole, width, points)
    model = single_design(content(source, {}))
    if not (model.valid or even_invalid):
        raise InputError(f"{model.verdict}. Nothing was written", "Set even_invalid to write it anyway", model.problem.file)
    write(model, path, options)
    return path


def single_design(about: ReportModel | StoredStudy, name: str = "") -> ReportModel:
    """Return the content of the page of a single design.

    Raises
    ------
    InputError
        If it is a study.
    """
    from optlink.presentation.report_model import ReportModel

    if isinstance(about, ReportModel):
        return about
    remedy = f"Export the problem with one design:  optlink export {about.problem.name} --design NAME=VALUE"
    raise InputError(f"a {about.kind} is not a single design, so it cannot be drawn", remedy, name or about.problem.file)


def figures(result: Document) -> dict[str, Callable[[], Figure | None]]:
    """Return what draws each picture of a result, by file name."""
    from optlink.presentation.chart_mpl import draw

    view = view_of(result.kind)
    model = view.model(result)
    named = [chart for chart in (*view.charts(model), *registered_charts(result)) if chart.file]
    groups = itertools.groupby(
        sorted(named, key=lambda chart: [one.file for one in named].index(chart.file)), lambda chart: chart.file
    )
    charts = {name: list(group) for name, group in groups}
    return {
        **{name: (lambda group=group: draw(group)) for name, group in charts.items()},  # type: ignore[misc]
        **{name: (lambda drawing=drawing: drawing(model)) for name, drawing in view.drawings.items()},  # type: ignore[misc]
    }


def plot(result: Document, name: str | None = None) -> Figure:
    """Return a picture of a result; see `Document.plot`."""
    known = figures(result)
    for key in [name] if name is not None else known:
        if key not in known:
            raise UnknownName(f"this {result.kind} has no picture {key}", nearest(str(key), known), key="name", value=key)
        if (picture := known[key]()) is not None:
            return picture
    message = "there is no such picture of this result" if name else "there is no picture of this result"
    raise InputError(message, f"Plot one of: {', '.join(known)}" if name else "Write its page: optlink.report(result, file)")


def write(result: Document, place: Path, pictures: str) -> list[Path]:
    """Write the files of a result; see `Document.write`."""
    check_choice("pictures", pictures, ("png", "svg", "pdf"), "no format of pictures")
    return view_of(result.kind).write(result, made(place, "folder"), pictures)


def to_frame(result: Document, name: str | None = None) -> pandas.DataFrame:
    """Return a table of a result; see `Document.to_frame`."""
    tables: dict[str, Mapping[str, Iterable[float | str]]] = dict(view_of(result.kind).tables(result))
    own = getattr(result, "columns", None)
    tables = tables or ({"columns": own} if own else {})
    if name is not None and name not in tables:
        raise UnknownName(f"this {result.kind} has no table {name}", nearest(name, tables), key="name", value=name)
    if not tables:
        raise InputError(f"this {result.kind} has no table", "See its to_dict()")
    return frame_of(tables[name or next(iter(tables))])


def frame_of(table: Mapping[str, Iterable[float | str]]) -> pandas.DataFrame:
    """Return a table as a data frame with its units in `attrs`.

    Raises
    ------
    InputError
        If pandas is not installed.
    """
    try:
        import pandas
    except ImportError:
        raise InputError("to_frame needs the package pandas, which is not installed", extra_remedy("frame")) from None
    frame = pandas.DataFrame({key: list(column) for key, column in table.items()})
    frame.attrs["units"] = {key: unit for key in frame for unit in [column_unit(MEASURE.sub("", key))[1]] if unit}
    return frame
