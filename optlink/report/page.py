"""The report: one HTML page that needs nothing but a browser - no network, no server, no other file."""

from __future__ import annotations

import base64
import datetime
import hashlib
import json
import platform
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from functools import cache
from html import escape
from importlib.metadata import version
from importlib.resources import files
from pathlib import Path
from string import Template
from typing import Any

import numpy as np
from rich.console import RenderableType
from rich.table import Table
from rich.text import Text

from optlink.analysis import Analysis
from optlink.design.files import ProblemFile
from optlink.errors import Status
from optlink.generation import Generation
from optlink.machine_design import MachineDesign
from optlink.report import designs, improved, machine, tables, terminal, whatif
from optlink.report.charts import Readout, charts, readouts, tornado
from optlink.report.figures import Chart
from optlink.report.scene import Scene, scene
from optlink.report.store import whole
from optlink.report.subject import Subject
from optlink.report.svg import svg, zigzag
from optlink.studies.sensitivity import Sensitivities, of_solution
from optlink.version import VERSION
from optlink.workflow import Result

LARGEST = 6_000_000  # bytes of a page
FLAT = 0.45  # height over width below which the figures stand below the drawing
SHORT = 20  # rows of a table that is never broken between sheets
WIDE, HUGE = 72, 105  # letters of a table that needs the width of the page, and of one for which a sheet of paper is narrow
STEPS = (360, 180, 90)  # positions of a revolution: as many as the page has room for
ASSETS = files("optlink.report").joinpath("assets")


def write_page(subject: Subject, path: Path) -> None:
    """Write the report of a subject.

    Raises
    ------
    InputError
        when nothing can be written there; then no file is left behind.
    """
    text = page(subject)
    with whole(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def page(subject: Subject) -> str:
    """The report of a subject as HTML."""
    for steps in STEPS:
        text = _page(subject, steps)
        if len(text) <= LARGEST:
            break
    return text


def _page(subject: Subject, steps: int) -> str:
    model = subject.problem.model
    drawn = None if subject.cycle is None else scene(subject.cycle, steps)
    figures = charts(subject)
    answers = sensitivities_of(subject)
    if answers is not None:
        figures.append(tornado(answers))
    sections = list(_sections(subject, drawn, figures, answers))
    script, plotly = _asset("page.js"), _plotly()
    motion = None if drawn is None or subject.cycle is None else _motion(subject, drawn)
    parts = {
        "policy": _policy(plotly, script),
        "version": VERSION,
        "title": escape(model.title),
        "kind": escape(f"{subject.problem.name} · {subject.problem.kind}"),
        "style": _asset("page.css"),
        "verdict": escape(verdict(subject)),
        "verdict_class": "ok" if subject.valid else "fail",
        "sign": "✓" if subject.valid else "✗",
        "status": "".join(_status(subject)),
        "links": "".join(f'<a href="#{_anchor(name)}">{escape(name)}</a>' for name, _ in sections),
        "sections": "\n".join(
            f'<section id="{_anchor(name)}"><h2>{escape(name)}</h2>\n{html}</section>' for name, html in sections
        ),
        "footer": f"Made by optlink {VERSION}. This page is complete: it loads nothing from anywhere.",
        "motion": _json(motion),
        "charts": _json([{"figure": chart.figure, "cranked": chart.cranked} for chart in figures]),
        "plotly": plotly,
        "script": script,
    }
    return Template(_asset("page.html")).substitute(parts)


# --- what stands where -------------------------------------------------------------------------------------------------------


def _sections(
    subject: Subject, drawn: Scene | None, figures: Sequence[Chart], answers: Sensitivities | None
) -> Iterator[tuple[str, str]]:
    if drawn is not None:
        yield "Linkage in motion", _linkage(subject, drawn)
    elif subject.unmoved:
        yield "Linkage", f"<p>It cannot be shown in motion: {escape(subject.unmoved)}.</p>"
    result = [*_result(subject)]
    if result:
        yield "Analysis" if isinstance(subject.outcome, Analysis) else "Design and proof", _cards(result)
    if answers is not None:
        rest = [part for part in tables.flat(whatif.sensitivities(answers)) if not _known(part)]
        yield "What matters", _figure(figures[-1], len(figures)) + _cards(rest)
    curves = figures if answers is None else figures[:-1]
    if curves:
        yield "Curves", "\n".join(_figure(chart, number) for number, chart in enumerate(curves, 1))
    yield "Problem", _problem(subject.problem)
    yield "Sources", _sources(subject)


def _known(part: Table | Text) -> bool:
    """Whether a part of the sensitivities has been told before: title and optimum."""
    return str(part.title) == "Optimum" if isinstance(part, Table) else "bold" in str(part.style)


def sensitivities_of(subject: Subject) -> Sensitivities | None:
    """How the optimum answers to what is given; None where none was searched, or where nothing is left to gain."""
    outcome = subject.outcome
    if isinstance(outcome, Result):
        file, solution = outcome.problem, outcome.solution
    elif isinstance(outcome, Generation) and outcome.best is not None and not designs.exact(outcome.best):
        file, solution = outcome.best.problem, outcome.best.solution
    else:
        return None
    if solution is None or solution.status is not Status.OPTIMAL:
        return None
    found = of_solution(file, solution)
    return found if found.moving else None


def verdict(subject: Subject) -> str:
    """Whether the design is valid, and which checks failed."""
    if isinstance(subject.outcome, Analysis):
        return "Analysed" if subject.valid else "No finite reactions at some positions"
    if subject.valid:
        return "Valid: every check passed"
    failed = _failed(subject)
    return f"Not valid: {failed}" if failed else f"Not valid: {subject.outcome.status.value}"


def _failed(subject: Subject) -> str:
    """Names of the checks that failed."""
    outcome = subject.outcome
    if isinstance(outcome, Generation):
        proof = None if outcome.best is None else outcome.best.validation
    else:
        proof = None if isinstance(outcome, Analysis) else outcome.validation
    names = [check.name for check in proof.checks if not check.passed] if proof else []
    return ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")


def told(subject: Subject) -> RenderableType:
    """What a terminal is told of the answer."""
    outcome = subject.outcome
    if isinstance(outcome, Result):
        return terminal.result(outcome)
    if isinstance(outcome, Generation):
        return designs.generation(outcome)
    if isinstance(outcome, MachineDesign):
        return improved.machine_design(outcome)
    return machine.analysis(outcome)


def _status(subject: Subject) -> Iterator[str]:
    """What the terminal says below the title; and what a recorded result adds."""
    first = next(part for part in tables.flat(told(subject)) if isinstance(part, Text))
    for text in first.split("\n")[1:]:
        yield tables.paragraph(text, plain=True)
    for note in subject.notes:
        yield f"<p>Note: {escape(note)}</p>"


def _result(subject: Subject) -> Iterator[Table | Text]:
    """The tables of the answer, the active limits after the first of them if a result file recorded them."""
    parts = list(tables.flat(told(subject)))[1:]
    if subject.limits:
        recorded = list(tables.flat(_recorded(subject)))
        place = next((k for k, part in enumerate(parts) if "Validation" in str(getattr(part, "title", ""))), len(parts))
        parts[place:place] = recorded
    return iter(parts)


def _recorded(subject: Subject) -> RenderableType:
    """Active limits with their prices as a result file recorded them, in the units that the terminal tells them in."""
    outcome, limits = subject.outcome, subject.limits
    if isinstance(outcome, Generation) and outcome.best is not None:
        best = outcome.best
        shown = designs.people_objective(best)
        size = shown / best.objective if best.objective > 0.0 else 1.0
        scaled = [replace(limit, multiplier=limit.multiplier * size) for limit in limits]
        return terminal.active(scaled, shown, designs.people_objective_unit(best))
    unit = outcome.unit if isinstance(outcome, Result | MachineDesign) else ""
    return terminal.active(limits, subject.objective, unit)


def _cards(parts: Iterable[Table | Text]) -> str:
    """Tables as cards, wide ones across the page, short ones never broken between sheets of paper; texts as paragraphs."""
    found = []
    for part in parts:
        if isinstance(part, Table):
            width = tables.width(part)
            sizes = {"wide": width > WIDE, "huge": width > HUGE, "short": part.row_count <= SHORT}
            marks = ["card", *(name for name, holds in sizes.items() if holds)]
            found.append(f'<div class="{" ".join(marks)}">{tables.table(part)}</div>')
        else:
            found.append(tables.paragraph(part))
    return f'<div class="cards">{"".join(found)}</div>'


def _figure(chart: Chart, number: int) -> str:
    height = int(chart.figure["layout"]["height"])
    label = escape(f"{chart.title}: {', '.join(trace['name'] for trace in chart.figure['data'])}")
    place = f'<div class="plot" id="chart-{number}" role="img" aria-label="{label}" style="min-height:{height}px"></div>'
    return f"<figure><figcaption>{escape(chart.title)}</figcaption>{place}</figure>"


def _linkage(subject: Subject, drawn: Scene) -> str:
    assert subject.cycle is not None
    _, _, width, height = drawn.box
    flat = " flat" if height < FLAT * width else ""
    picture = svg(drawn, f"{subject.problem.model.title}, drawn to scale")
    legend = "".join(f'<li><i style="background:{body.colour}"></i>{escape(body.name)}</li>' for body in drawn.bodies)
    listed = _readouts(subject, drawn)
    figures = "".join(
        f"<div><dt>{escape(one.name)}</dt><dd><span data-readout>{_first(one)}</span> {escape(_unit(one))}</dd></div>"
        for one in listed
    )
    ticks = "".join(
        f'<label class="tick"><input type="checkbox" checked data-toggle="{layer}"> {words}</label>'
        for layer, words in (("traces", "paths of the points"), ("names", "names of the points"))
    )
    last = len(drawn.angles) - 1
    begin = f"{drawn.angles[0]:.1f}°".replace("-", "−")
    return f"""<div class="linkage{flat}">
<div><div class="stage">{picture}</div>
<div class="controls"><button type="button" id="play" aria-pressed="false">▶ Play</button>
<label for="crank">crank angle</label>
<input type="range" id="crank" min="0" max="{last}" step="1" value="0">
<output id="crank-angle" for="crank">{begin}</output></div></div>
<div class="aside"><ul class="legend">{legend}</ul>
<dl class="readouts">{figures}</dl>{ticks}</div>
</div>"""


def _readouts(subject: Subject, drawn: Scene) -> list[Readout]:
    assert subject.cycle is not None
    return readouts(subject.cycle, drawn.angles, forces=subject.forces)


def _unit(one: Readout) -> str:
    return "°" if one.unit == "deg" else one.unit


def _decimals(one: Readout) -> int:
    """Decimals that tell a figure to four digits."""
    largest = max((abs(value) for value in one.values if value is not None), default=0.0)
    return 3 if largest < 10.0 else 2 if largest < 1000.0 else 1


def _first(one: Readout) -> str:
    value = one.values[0]
    return "–" if value is None else f"{value:.{_decimals(one)}f}".replace("-", "−")


def _problem(file: ProblemFile) -> str:
    """What is wanted, in words and tables; its title and its source stand elsewhere."""
    parts = [part for part in tables.flat(terminal.problem(file)) if isinstance(part, Table)]
    about = "".join(f"<p>{escape(piece)}</p>" for piece in _paragraphs(file.model.about))
    return f"{about}{_cards(parts)}"


def _paragraphs(text: str) -> list[str]:
    return [" ".join(piece.split()) for piece in text.split("\n\n") if piece.strip()]


def _sources(subject: Subject) -> str:
    file = subject.problem
    facts = [("Problem", file.model.source or "no source is given")]
    if file.model.expected is not None:
        facts.append(("Expected values", file.model.expected.source))
    facts += [
        ("Problem file", file.file),
        ("Hash of the problem", file.hash),
        ("Found by", _by(subject)),
        ("optlink", f"{VERSION}, with Python {platform.python_version()}, numpy {np.__version__}"),
        ("Charts", f"plotly.js of plotly {version('plotly')}, in this page"),
        ("Written on", datetime.datetime.now(tz=datetime.UTC).date().isoformat()),
    ]
    return f'<dl class="facts">{"".join(f"<dt>{escape(name)}</dt><dd>{escape(text)}</dd>" for name, text in facts)}</dl>'


def _by(subject: Subject) -> str:
    outcome = subject.outcome
    if isinstance(outcome, Analysis):
        return "nothing was searched: the machine is analysed as it is given"
    if outcome.backend == "none":
        return "nothing was searched: a given design was checked"
    starts = f"{outcome.starts} start{'s' * (outcome.starts != 1)}, seed {outcome.seed}"
    return f"{outcome.backend}, {starts}; proven by a sweep of the kinematics that the search takes no part in"


# --- what a script reads -----------------------------------------------------------------------------------------------------


def _motion(subject: Subject, drawn: Scene) -> dict[str, Any]:
    listed = [{"values": one.values, "decimals": _decimals(one)} for one in _readouts(subject, drawn)]
    return drawn.to_dict() | {"zigzag": zigzag(drawn.size), "readouts": listed}


def _json(document: object) -> str:
    """A document for a script element: nothing in it can end the element or begin another."""
    text = json.dumps(document, separators=(",", ":"), allow_nan=False)
    return text.replace("&", "\\u0026").replace("<", "\\u003c").replace(">", "\\u003e")


def _policy(*scripts: str) -> str:
    """What the browser lets the page do: run these scripts and no others, and load nothing from anywhere."""
    hashes = " ".join(f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'" for text in scripts)
    rest = "style-src 'unsafe-inline'; img-src data: blob:; base-uri 'none'; form-action 'none'"
    return f"default-src 'none'; script-src {hashes}; {rest}"


def _anchor(name: str) -> str:
    return name.lower().replace(" ", "-")


@cache
def _asset(name: str) -> str:
    return ASSETS.joinpath(name).read_text(encoding="utf-8")


@cache
def _plotly() -> str:
    """plotly.js: the one bundle that the Python package brings."""
    from plotly.offline import get_plotlyjs

    return get_plotlyjs()  # type: ignore[no-any-return]
