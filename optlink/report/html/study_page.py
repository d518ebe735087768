"""The page of a result: its head, its sections with the linkage in motion, the problem and the sources."""

import platform
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from importlib.metadata import version

import numpy as np

from optlink.errors import InputError
from optlink.problem.file import ProblemFile
from optlink.problem.fixed_design import fixed_design
from optlink.report.export.dimensions import Drawing, dimensioned
from optlink.report.format import single_units
from optlink.report.html import moving_linkage
from optlink.report.html.chart_plotly import Chart
from optlink.report.html.moving_linkage import Moving
from optlink.report.html.shell import MAX_BYTES, STEPS, PageContent, PageSection, StoredStudy, arrange
from optlink.report.shapes import even
from optlink.report.table_spec import Paragraph
from optlink.report.views import problem_tables
from optlink.tasks.analyze import Analysis, analyze
from optlink.version import VERSION

MAX_DRAWINGS = 60  # largest number of selectable points with a drawing of their own


def study_page(studied: StoredStudy) -> str:
    """Return the HTML page of a result with the most positions per revolution that keep it below `MAX_BYTES`."""
    for steps in STEPS:
        with single_units():
            text = _page(studied, steps).html()
        if len(text.encode()) <= MAX_BYTES:
            break
    return text


def _page(studied: StoredStudy, steps: int) -> PageContent:
    file, moving = studied.problem, studied.moving(steps)
    sections = list(studied.sections)  # those without parts are left out
    if moving is not None:
        picked = any(isinstance(part, Chart) and part.draw for section in sections for part in section.parts)
        shown = [] if picked else [PageSection("Dimensions", (dimensioned(moving.cycle, file.model.title),))]
        caption = [Paragraph(studied.drawn, lead=True)] if studied.drawn else []
        shown.append(PageSection("Linkage in motion", (*caption, moving)))
        sections[studied.after : studied.after] = shown
    return PageContent(studied, arrange(sections, closing_sections(file, studied.by)), moving)


# --- parts -------------------------------------------------------------------------------------------------------------------


def named_si(file: ProblemFile, columns: Mapping[str, float]) -> dict[str, float]:
    """Return the quantities of a problem [SI] from columns with unit suffix such as "coupler_mm".

    Parameters
    ----------
    columns : mapping of str to float
        In display units; columns that are not quantities are ignored.
    """
    values = {}
    for name, quantity in file.model.quantities.items():
        unit = quantity.display[1]
        column = f"{name}_{unit}" if unit else name
        if column in columns:
            values[name] = columns[column] * quantity.si_per_unit
    return values


def cycle_of(file: ProblemFile, design: Mapping[str, float]) -> Analysis | None:
    """Analyse the machine of a problem with a design; None if it cannot be assembled.

    Parameters
    ----------
    design : mapping of str to float [m, rad]
        Replaces dimensions of the problem.
    """
    try:
        return analyze(fixed_design(file, file.model.sizes(design)))
    except InputError:
        return None


def with_drawings(chart: Chart, designs: Callable[[int], tuple[ProblemFile, Mapping[str, float]]]) -> Chart:
    """Return a chart with selectable points whose dimensioned drawing follows the selected point.

    Parameters
    ----------
    designs : function
        Returns the problem and the design [m, rad] of a row of the study.
    """
    picks = chart.picks
    if picks is None:
        return chart
    chosen = sorted({picks.first, *even(len(picks.rows), MAX_DRAWINGS).tolist()})

    def draw() -> Mapping[int, Drawing]:
        cycles = {k: cycle_of(*designs(picks.sources[k])) for k in chosen}
        return {k: dimensioned(cycle, f"Point {k + 1}") for k, cycle in cycles.items() if cycle is not None}

    return replace(chart, draw=draw)


def turning_linkage(file: ProblemFile, design: Mapping[str, float], steps: int) -> Moving | None:
    """Animate the machine of a problem over its crank angle; None if it cannot be assembled.

    Parameters
    ----------
    design : mapping of str to float [m, rad]
        Replaces dimensions of the problem.
    steps : int
        Number of positions per revolution.
    """
    cycle = cycle_of(file, design)
    return None if cycle is None else moving_linkage.turning(cycle, steps)


def no_animation(_: int) -> None:
    """Return None: there is no linkage to animate."""


def closing_sections(file: ProblemFile, by: str) -> Iterable[PageSection]:
    """Yield the last sections of the appendix: the problem, and sources, versions and method.

    Parameters
    ----------
    by : str
        Method by which the result was found.
    """
    about = (" ".join(piece.replace("`", "").split()) for piece in file.model.about.split("\n\n") if piece.strip())
    yield PageSection("Problem", (Paragraph(*about), problem_tables.problem(file).parts))
    yield PageSection("Sources", (dict(_sources(file, by)),))


def _sources(file: ProblemFile, by: str) -> list[tuple[str, str]]:
    rows = [("Problem", file.model.source or "no source is given")]
    if file.model.expected is not None:
        rows.append(("Expected values", file.model.expected.source))
    return [
        *rows,
        ("Problem file", file.file),
        ("Hash of the problem", file.hash),
        ("Found by", by),
        ("optlink", f"{VERSION}, with Python {platform.python_version()}, numpy {np.__version__}"),
        ("Charts", f"plotly.js of plotly {version('plotly')}, in this page"),
    ]
