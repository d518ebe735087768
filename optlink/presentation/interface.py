"""What Python does with any result: write its page or a drawing, plot it, tabulate it, show it in a notebook."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO, TypeAlias

from optlink.errors import InputError, UnknownName, extra_remedy, nearest
from optlink.io import folder as made, whole
from optlink.presentation.columns import file_units, in_units
from optlink.presentation.files import check_target
from optlink.presentation.registry import stored_page, table_of as table_of_kind, view_of
from optlink.presentation.view import registered_charts
from optlink.problem.arguments import typed
from optlink.problem.document import Document, Result
from optlink.problem.file import AnyProblem, ProblemFile, problem_of
from optlink.problem.quantity import check_choice

if TYPE_CHECKING:
    import pandas
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from optlink.presentation.linkage_mpl import LinkageAnimation
    from optlink.presentation.report_model import ReportModel
    from optlink.presentation.view import StoredStudy

    Subject: TypeAlias = AnyProblem | Result
else:
    Subject = AnyProblem | Document  # all results are documents


def page_content(source: Subject, facts: Mapping[str, Any], name: str = "") -> ReportModel | StoredStudy:
    """Return what the page of a result shows; a problem is solved first, or analysed if it has nothing to design.

    `facts` are keys of `[report]`, such as the title, which stand at its head; `name` is the file of the result, for errors.
    """
    if isinstance(source, Document):
        return stored_page(source, facts, name)
    from optlink.presentation.report_model import report_model_of, solve_or_validate

    assert isinstance(source, ProblemFile | str | Path)
    return report_model_of(solve_or_validate(problem_of(source).override(facts)))


@typed
def report(source: Subject, file: str | Path, facts: Mapping[str, str] | None = None, *, brief: bool = False) -> Path:
    """Write a self-contained HTML page: results, checks, charts, animation, sources.

    Parameters
    ----------
    source : Result, ProblemFile, str or Path
        Any result; or a problem, which is solved first, or analysed if it has nothing to design.
    file : str or Path
        HTML file to write.
    facts : mapping of str to str, optional
        Entries at the head of the page: title, company, author, part, revision, date.
    brief : bool, optional
        Write the short page: what the linkage is and does, its drawing, limits, positions and two charts, on two printed sheets.

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
    from optlink.presentation.html.page import write_page

    path = check_target(Path(file), (".html", ".htm"), "report.html", "file")
    write_page(page_content(source, {f"report.{key}": text for key, text in (facts or {}).items()}), path, brief=brief)
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
    content: str | None = None,
) -> Path:
    """Export a design: a drawing at a crank angle as DXF or SVG, its parts to cut or print, its motion as CSV, geometry as JSON.

    Parameters
    ----------
    source : Result, ProblemFile, str or Path
        Result of `solve`, `validate` or `analyze`; or a problem, which is solved first, or analysed if it has nothing to design.
    file : str or Path
        File to write; its suffix selects the format: .dxf, .svg, .pdf, .stl, .3mf, .step, .csv, .json, .xml (MuJoCo) or .txt
        (PMKS+).
    at : float [rad] or [m], optional
        Crank angle of the drawing; of a slide or cylinder that drives, its slide or length. Default: the start of the motion.
    hole, width : float [m], optional
        Hole diameter and link width of the DXF drawing and of the parts.
    points : int
        Steps of the CSV table per revolution.
    even_invalid : bool
        Write the design even if it is not valid.
    content : str, optional
        "drawing" (.dxf, .svg), "parts" (.dxf, .svg, .stl, .3mf, .step), "assembly" (.stl, .3mf, .step) or "sheet" (.pdf, .dxf);
        default: the first for the suffix.

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
    from optlink.presentation.export.export import FORMATS, Options, check_unit_of_place, export as write

    path = check_target(Path(file), tuple(FORMATS), "drawing.dxf", "file")
    options = Options(at, hole, width, points, content)
    model = single_design(page_content(source, {}))
    if not (model.valid or even_invalid):
        raise InputError(f"{model.verdict}. Nothing was written", "Set even_invalid to write it anyway", model.problem.file)
    if model.cycle is not None:
        check_unit_of_place(model.cycle, at, "at")
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
    from optlink.presentation.chart_mpl import by_file, draw

    view = view_of(result.kind)
    model = view.model(result)
    drawn: dict[str, Callable[[], Figure | None]] = {
        name: partial(draw, group) for name, group in by_file((*view.charts(model), *registered_charts(result))).items()
    }
    for name, drawing in view.drawings.items():
        if getattr(drawing, "of", lambda _: True)(model):
            drawn[name] = partial(drawing, model)
    return drawn


def picture(result: Document, name: str) -> Figure:
    """Return a picture of a result by its name; see `Document.plot`."""
    known = figures(result)
    if name not in known:
        raise UnknownName(f"this {result.kind} has no picture {name}", nearest(str(name), known), key="name", value=name)
    if (drawn := known[name]()) is None:
        raise InputError(
            "there is no such picture of this result", f"Plot one of: {', '.join(other for other in known if other != name)}"
        )
    return drawn


def plot(result: Document, name: str | None, ax: Axes | None, angle: float | None) -> Figure | Axes:
    """Draw a picture of a result by its name, or its linkage; see `Document.plot`."""
    if name is None:
        from optlink.presentation.linkage_mpl import draw_linkage

        return draw_linkage(result, ax, angle)
    if not isinstance(name, str):
        raise InputError(
            "not the name of a picture", "Axes are given as ax=axes, a crank angle as angle=1.2", key="name", value=name
        )
    if ax is not None or angle is not None:
        message = "a picture by name has axes and positions of its own"
        raise InputError(message, "Leave the name out to draw the linkage", key="ax" if angle is None else "angle")
    return picture(result, name)


def animate(result: Document, frames: int) -> LinkageAnimation:
    """Return the linkage of a result in motion; see `Document.animate`."""
    from optlink.presentation.linkage_mpl import animate_linkage

    return animate_linkage(result, frames)


def write(result: Document, place: Path, pictures: str) -> list[Path]:
    """Write the files of a result; see `Document.write`."""
    check_choice("pictures", pictures, ("png", "svg", "pdf"), "no format of pictures")
    return view_of(result.kind).write(result, made(place, "folder"), pictures)


def printed(result: Document) -> str:
    """Return what the command of a result prints."""
    from optlink.presentation.terminal import text

    shown = table_of_kind(result.kind)(result)
    return text(shown.short or shown)


def tables_of(result: Document) -> dict[str, Mapping[str, Iterable[float | str]]]:
    """Return the tables of a result by name: columns by name."""
    own = getattr(result, "columns", None)
    return dict(view_of(result.kind).tables(result)) or ({"columns": own} if own else {})


def table_of(result: Document, name: str | None) -> Mapping[str, Iterable[float | str]]:
    """Return a table of a result, by default the first one."""
    tables = tables_of(result)
    if name is not None and name not in tables:
        raise UnknownName(f"this {result.kind} has no table {name}", nearest(name, tables), key="name", value=name)
    if not tables:
        raise InputError(f"this {result.kind} has no table", "See its to_dict()")
    return tables[name or next(iter(tables))]


def to_frame(result: Document, name: str | None = None, units: str = "SI") -> pandas.DataFrame:
    """Return a table of a result; see `Document.to_frame`."""
    return in_frame(table_of(result, name), result.problem, units)


def to_latex(result: Document, buf: str | Path | TextIO | None, name: str | None, columns: Sequence[str] | None) -> str:
    """Return a table of a result, or those of a design, for LaTeX; see `Document.to_latex`."""
    from optlink.presentation.latex import columns_to_latex, parts_to_latex

    view = view_of(result.kind)
    if name is None and columns is None and (view.design(result) is not None or not tables_of(result)):
        text = parts_to_latex(view.table(result).parts)
    else:
        table, units = table_of(result, name), file_units(result.problem)
        keys = {key: key for key in table} | {in_units(key, (), units).key: key for key in table}
        for key in columns or ():
            check_choice("columns", key, keys, "no such column")
        text = columns_to_latex({keys[key]: table[keys[key]] for key in (columns or table)}, units)
    if isinstance(buf, str | Path):
        with whole(Path(buf)) as temporary:
            temporary.write_text(text, encoding="utf-8")
    elif buf is not None:
        if not hasattr(buf, "write"):
            raise InputError("no file", 'Give its path, for example "table.tex", or an open one', key="buf", value=buf)
        buf.write(text)
    return text


def in_frame(table: Mapping[str, Iterable[float | str]], problem: ProblemFile, units: str) -> pandas.DataFrame:
    """Return a table as a data frame with its units in `attrs`: "SI", or those of the "file" of a problem.

    Raises
    ------
    InputError
        If pandas is not installed.
    """
    check_choice("units", units, ("SI", "file"), "no such units")
    try:
        import pandas
    except ImportError:
        raise InputError("to_frame needs the package pandas, which is not installed", extra_remedy("frame")) from None
    wanted = file_units(problem) if units == "file" else {}
    columns = [in_units(key, values, wanted) for key, values in table.items()]
    frame = pandas.DataFrame({column.key: column.values for column in columns})
    frame.attrs["units"] = {column.key: column.unit for column in columns if column.unit}
    return frame
