"""The page of a result: its head, its sections with the linkage in motion, the problem and the sources."""

import platform
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from optlink.dynamics.machine import Machine
from optlink.linkage.vector2d import Array
from optlink.presentation.chart_mpl import paper
from optlink.presentation.chart_spec import ChartSpec, Curve, Panel
from optlink.presentation.export.dimensions import Drawing, dimensioned
from optlink.presentation.format import Scale, single_units
from optlink.presentation.html import chart_plotly, moving_linkage
from optlink.presentation.html.chart_plotly import Chart
from optlink.presentation.html.moving_linkage import Moving, cycle_of
from optlink.presentation.html.shell import MAX_BYTES, STEPS, WIDE, PageContent, arrange, plotly_version, table_width
from optlink.presentation.scene import MM, Scene, scene_at
from optlink.presentation.shapes import even
from optlink.presentation.table_spec import Paragraph, Span, TableSpec
from optlink.presentation.view import PageSection, StoredStudy
from optlink.presentation.views import problem_tables
from optlink.problem.file import ProblemFile
from optlink.version import VERSION

CHARTS, PANELS, ROWS = 2, 2, 8  # largest numbers of charts, of panels of one, and of lines of a table, of the short page
MAX_DRAWINGS = 60  # largest number of selectable points with a drawing of their own


def study_page(studied: StoredStudy, *, brief: bool = False) -> str:
    """Return the HTML page of a result with the most positions per revolution that keep it below `MAX_BYTES`.

    With `brief` it is the short page: a selection of the parts that fits two printed sheets.
    """
    with single_units():
        studied = abridged(studied) if brief else replace(studied, sections=drawn(studied.sections))
        for steps in STEPS:
            text = content_of(studied, steps, brief=brief).html()
            if len(text.encode()) <= MAX_BYTES:
                break
    return text


def abridged(studied: StoredStudy) -> StoredStudy:
    """Return the parts of a result that the short page shows: limits, or else the first table, and two charts.

    The charts are those marked for it, or else the first ones. Their points cannot be selected: of designs the first one turns.
    """
    grouped = (item if isinstance(item, tuple | list) else (item,) for section in studied.sections for item in section.parts)
    parts = [part for group in grouped for part in group]
    specs = sorted((one for one in parts if isinstance(one, ChartSpec) and one.page), key=lambda one: not one.brief)[:CHARTS]
    tables = [one for one in parts if isinstance(one, TableSpec) and not one.appendix and table_width(one) <= WIDE]
    figures = [replace(one, rows=_first_rows(one)) for one in tables[:1]]
    shown = PageSection("Limits", (studied.limits,)) if studied.limits else PageSection("Figures", (figures,))
    charts = [replace(one, panels=[*map(_of_the_design, one.panels[:PANELS])], picks=None, designs=None) for one in specs]
    picked = (one.designs(one.picks.sources[one.picks.first]) for one in specs if one.designs and one.picks)
    return replace(
        studied,
        conclusion=studied.achieved or studied.conclusion,
        status=(),
        notes=(),
        design=studied.design or next(picked, None),
        sections=[
            *([shown] if studied.limits or figures else []),
            *([PageSection("Curves", [replace(_chart(one), paper=paper(one)) for one in charts])] if charts else []),
        ],
    )


def _of_the_design(panel: Panel) -> Panel:
    """Return a panel without curves of the initial design."""
    return replace(panel, traces=[one for one in panel.traces if not (isinstance(one, Curve) and one.initial)])


def _first_rows(spec: TableSpec) -> tuple[tuple[Span, ...], ...]:
    """Return the first rows of a table, up to `ROWS` lines."""
    lines = np.cumsum([max(cell.text.count("\n") + 1 for cell in row) for row in spec.rows])
    return spec.rows[: max(1, int(np.sum(lines <= ROWS)))]


def content_of(studied: StoredStudy, steps: int, *, brief: bool = False) -> PageContent:
    """Return the content of the page of a result for a number of positions per revolution."""
    if brief:
        return _brief_content(studied, steps)
    file, moving, sections = studied.problem, moving_of(studied, steps), drawn(studied.sections)
    if moving is not None:
        picked = any(isinstance(part, Chart) and part.draw for section in sections for part in section.parts)
        shown = [] if picked else [_dimensions(moving, file.model.title)]
        caption = [Paragraph(text, lead=True) for text in (studied.drawn, *_datum(moving)) if text]
        shown.append(PageSection("Linkage in motion", (*caption, moving)))
        sections[studied.after : studied.after] = shown
    return PageContent(studied, arrange(sections, closing_sections(file, studied.by)), moving)


def _brief_content(studied: StoredStudy, steps: int) -> PageContent:
    moving, sections = moving_of(studied, steps), list(studied.sections)
    if moving is not None:
        drawing = _dimensions(moving, studied.problem.model.title)
        sections[:0] = [drawing, PageSection("Motion", (*map(Paragraph, _datum(moving)), moving))]
    return PageContent(studied, sections, moving, brief=True)


def _dimensions(moving: Moving, title: str) -> PageSection:
    drawing = dimensioned(moving.cycle, title)
    return PageSection("Dimensions", (drawing, Paragraph(drawing.caption)))


def _datum(moving: Moving) -> list[str]:
    """Return from where the crank angle of a moving linkage is measured, in a sentence; none of other drives."""
    datum = moving.cycle.problem.model.driving.datum
    return [f"Crank angles are measured from {datum}, counter-clockwise."] if datum and moving.stops.turn else []


def moving_of(studied: StoredStudy, steps: int) -> Moving | None:
    """Return the animated linkage of a result; None if it has none, or if it cannot be assembled."""
    if studied.moving is not None:
        return studied.moving(steps)
    cycle = None if studied.design is None else cycle_of(*studied.design)
    return None if cycle is None else moving_linkage.turning(cycle, steps)


def drawn(sections: Iterable[PageSection]) -> list[PageSection]:
    """Return sections with their charts as those of a page, without the charts that are pictures only."""
    return [
        replace(
            section,
            parts=[
                _chart(part) if isinstance(part, ChartSpec) else part
                for part in section.parts
                if not isinstance(part, ChartSpec) or part.page
            ],
        )
        for section in sections
    ]


def _chart(spec: ChartSpec) -> Chart:
    """Return a chart; the dimensioned drawing of its selectable points, if they are designs, follows the selected one."""
    chart = chart_plotly.chart(spec)
    picks, designs = chart.picks, spec.designs
    if picks is None or designs is None:
        return chart
    chosen = sorted({picks.first, *even(len(picks.rows), MAX_DRAWINGS).tolist()})

    def draw() -> Mapping[int, Drawing]:
        cycles = {k: cycle_of(*designs(picks.sources[k])) for k in chosen}
        return {k: dimensioned(cycle, f"Point {k + 1}") for k, cycle in cycles.items() if cycle is not None}

    return replace(chart, draw=draw)


def in_time(
    file: ProblemFile,
    design: Mapping[str, float],
    time: Array,
    crank: Array,
    shown: Sequence[tuple[str, Scale, Array]],
    freed: Machine | None = None,
) -> Moving | None:
    """Return the linkage of a design [m, rad] at crank angles [deg] over time [s]; None if it cannot be assembled.

    `shown` are quantities that follow the slider: name, display unit, values [SI]. `freed` is the machine with the coordinates of
    free drives at these times, whose path alone is drawn.
    """
    cycle, at = cycle_of(file, design), np.radians(crank)
    if cycle is None:
        return None
    if freed is None:
        return moving_linkage.in_time(cycle, scene_at(cycle, at), time, shown)
    motion = freed.motion(at, cycle.speed)
    return moving_linkage.in_time(cycle, Scene(motion, cycle.machine, unit=MM), time, shown)


def closing_sections(file: ProblemFile, by: str) -> Iterable[PageSection]:
    """Yield the last sections of the appendix: the problem, and sources, versions and the method of the result."""
    about = (" ".join(piece.replace("`", "").split()) for piece in file.model.about.split("\n\n") if piece.strip())
    yield PageSection("Problem", (Paragraph(*about), problem_tables.problem(file).parts))
    expected = {} if file.model.expected is None else {"Expected values": file.model.expected.source}
    sources = {
        "Problem": file.model.source or "no source is given",
        **expected,
        "Problem file": file.file_name,
        "Hash of the problem": file.hash,
        "Found by": by,
        "optlink": f"{VERSION}, with Python {platform.python_version()}, numpy {np.__version__}",
        "Charts": f"plotly.js {plotly_version()}, in this page",
    }
    yield PageSection("Sources", (sources,))
