"""View of a kind of result: its summary, charts, drawings, tables, design and animation, and the writer of its files."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from optlink.io import Entry, write_json
from optlink.presentation.files import write_csv, write_design
from optlink.presentation.table_spec import Line, Paragraph, Part, Summary

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from PIL import Image

    from optlink.presentation.chart_spec import ChartSpec
    from optlink.presentation.export.dimensions import Drawing
    from optlink.presentation.html.chart_plotly import Chart
    from optlink.presentation.html.gallery import Gallery
    from optlink.presentation.html.moving_linkage import Moving
    from optlink.presentation.report_model import ReportModel
    from optlink.problem.file import ProblemFile


@dataclass(frozen=True)
class PageSection:
    """Part of a page under a heading.

    Its parts are further sections, charts, drawings, galleries, the moving linkage, paragraphs, facts by name, groups of tables.
    """

    name: str
    parts: Sequence[PageSection | Part | ChartSpec | Chart | Drawing | Gallery | Moving | Mapping[str, str] | Sequence[Part]]

    @property
    def anchor(self) -> str:
        """Name of the section in links."""
        return self.name.lower().replace(" ", "-")


@dataclass(frozen=True, eq=False)
class StoredStudy:
    """Report of a result.

    `kind` describes the task; `conclusion` says in a sentence what was found; `status` are lines below the verdict;
    `sections` contain tables and charts; `by` is the method. The linkage of a `design` [m, rad] turns, or `moving` returns an
    animated one for a number of positions per revolution; `drawn` is its caption, `after` the number of sections before it. The
    short page shows `achieved`, or else the conclusion, and `limits`, or else the first table.
    """

    problem: ProblemFile
    kind: str
    verdict: str
    valid: bool
    conclusion: str
    status: Sequence[Line]
    sections: Sequence[PageSection]
    by: str
    design: tuple[ProblemFile, Mapping[str, float]] | None = None
    moving: Callable[[int], Moving | None] | None = None
    drawn: str = ""
    after: int = 0
    notes: tuple[str, ...] = ()
    achieved: str = ""
    limits: Sequence[Part] = ()


@dataclass(frozen=True)
class ResultChart(Entry):
    """A chart of results: a picture of `plots`, `plot` and `--out`, and a chart of their page.

    Parameters
    ----------
    name : str
        File name of the picture.
    kind : str
        Kind of the results: "analysis", "design", "simulation", "sweep", ...
    build : function of (result)
        Returns the chart, or None if this result has none.
    """

    name: str
    kind: str
    build: Callable[[Any], ChartSpec | None]


def registered_charts(result: Any) -> list[ChartSpec]:
    """Return the charts of a result that extensions have registered, each with the name of its picture."""
    found = [(one.name, one.build(result)) for one in ResultChart.registry.values() if one.kind == result.kind]
    return [replace(spec, file=name) for name, spec in found if spec is not None]


@dataclass(frozen=True)
class SomeDrawing:
    """A drawing of some results: `of` returns what is drawn, or something false; a decorator as `partial(SomeDrawing, of)`."""

    of: Callable[[Any], object]
    draw: Callable[[Any], Figure | None]

    def __call__(self, model: Any) -> Figure | None:
        """Return the figure; None if the result has none."""
        return self.draw(shown) if (shown := self.of(model)) else None


@dataclass(frozen=True)
class View:
    """How results of a kind are shown.

    Parameters
    ----------
    table : function
        Returns the summary that the terminal shows.
    conclusion : function, optional
        Returns the conclusion of a result. Default: the first line of its status.
    heading : str
        Heading of the tables on the page.
    model : function
        Returns what `charts`, `drawings` and `frames` take, such as the motion of the result, computed once; default: the result.
    charts : function
        Returns the charts, which the page shows too.
    drawings : mapping of str to function
        Functions by file name that return a figure that is not a chart, or None.
    tables : function
        Returns CSV tables of a result by file name: columns of equal length by name.
    design : function
        Returns the machine of a result and a comment on it for design.toml, or None.
    frames : function
        Returns the frames of the animation motion.gif; none if there is nothing to move.
    page : function, optional
        Returns the page of a result. Default: the page of a design with the motion of its machine.
    no_page : str
        Where to read results of a kind without a page.
    achieved : function, optional
        Returns what a result achieves, without words of the search, for the short page. Default: the conclusion.
    limits : function
        Returns the tables of the short page, of limits with values and margins; if there are none, it shows the first table.
    """

    table: Callable[[Any], Summary] = lambda _: Summary("", Paragraph())
    conclusion: Callable[[Any], str] | None = None
    heading: str = "Design and checks"
    model: Callable[[Any], Any] = lambda result: result
    charts: Callable[[Any], Iterable[ChartSpec]] = lambda _: ()
    drawings: Mapping[str, Callable[[Any], Figure | None]] = field(default_factory=dict)
    tables: Callable[[Any], Mapping[str, Mapping[str, Iterable[float | str]]]] = lambda _: {}
    design: Callable[[Any], tuple[ProblemFile, str] | None] = lambda _: None
    frames: Callable[[Any], list[Image.Image]] = lambda _: []
    page: Callable[[Any], StoredStudy | ReportModel] | None = None
    no_page: str = ""
    achieved: Callable[[Any], str] | None = None
    limits: Callable[[Any], Sequence[Part]] = lambda _: ()

    def write(self, result: Any, folder: Path, pictures: str = "png", *, film: bool = False) -> list[Path]:
        """Write result.json, the certificate, the tables, the design and the pictures; return the paths.

        Parameters
        ----------
        result : any result
        folder : Path
            Existing folder to write to.
        pictures : str, optional
            Format of the pictures: "png", "svg" or "pdf".
        film : bool, optional
            Write the animation too, which takes as long as all pictures.

        Raises
        ------
        InputError
            If a file cannot be written.
        """
        from optlink.presentation import chart_mpl
        from optlink.presentation.style import save, save_film

        written = [folder / "result.json"]
        write_json(written[0], result.to_dict())
        certificate = getattr(result, "certificate", None)
        if certificate is not None and certificate.covers and all(cover.whole for cover in certificate.covers):
            from optlink.tasks.results.certificate import certificate_document

            written.append(folder / "certificate.json")
            write_json(written[-1], certificate_document(certificate, result))
        for name, columns in self.tables(result).items():
            written.append(folder / f"{name}.csv")
            write_csv(written[-1], columns)
        design = self.design(result)
        if design is not None:
            written += write_design(folder, *design)
        model = self.model(result)
        drawings = {name: draw(model) for name, draw in self.drawings.items()}
        for name, fig in {**drawings, **chart_mpl.pictures([*self.charts(model), *registered_charts(result)])}.items():
            if fig is not None:
                written.append(folder / f"{name}.{pictures}")
                save(fig, written[-1])
        frames = self.frames(model) if film else []
        if frames:
            written.append(folder / "motion.gif")
            save_film(frames, written[-1])
        return written
