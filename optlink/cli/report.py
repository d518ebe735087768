"""The commands `report` and `export`: parse, call one library function, print, exit code."""

from __future__ import annotations

import json
import os
import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from optlink.cli import console
from optlink.cli.options import Design, Json, Problem, Quiet, Searcher, Seed, Set, Starts, flag, number, option
from optlink.errors import InputError
from optlink.execution import interrupts
from optlink.io import head

if TYPE_CHECKING:
    from optlink.presentation.report_model import ReportModel
    from optlink.presentation.view import StoredStudy
    from optlink.problem.file import ProblemFile

SCHEMA = "optlink/written/1"
Words = list[str] | None


def report(
    source: Problem,
    output: Annotated[Path, option("FILE.html", "HTML file to write.", "-o", "--out")],
    backend: Searcher = "ipopt",
    starts: Starts = None,
    seed: Seed = 0,
    changes: Set = None,
    design: Design = None,
    title: Annotated[str | None, option("TEXT", "Title of the page; default: that of the problem.", "--title")] = None,
    company: Annotated[str | None, option("TEXT", "Company, at the head of the page.", "--company")] = None,
    author: Annotated[str | None, option("TEXT", "Author, at the head of the page.", "--author")] = None,
    part: Annotated[str | None, option("TEXT", "Name or number of the part.", "--part")] = None,
    revision: Annotated[str | None, option("TEXT", "Revision of the part.", "--revision")] = None,
    date: Annotated[str | None, option("TEXT", "Date; default: today.", "--date")] = None,
    brief: Annotated[
        bool, flag("Write the short page, two printed sheets: drawing, limits, motion, two charts.", "--brief")
    ] = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Write a self-contained HTML page of a design, simulation or study: results, checks, charts, animation, sources."""
    from optlink.presentation.files import check_target

    check_target(output, (".html", ".htm"), "report.html")
    facts = {"title": title, "company": company, "author": author, "part": part, "revision": revision, "date": date}
    changes = [*(changes or []), *(f"report.{key}={json.dumps(text)}" for key, text in facts.items() if text is not None)]
    with console.working("Reading or solving the problem"):
        about = _report_model(source, output, (backend, starts, seed), changes, design)
        interrupts.check()
    from optlink.presentation.html.page import write_page

    with console.working(f"Writing {output}"):
        write_page(about, output, brief=brief)
    _written(about, output, as_json)


def export(
    source: Problem,
    output: Annotated[
        Path,
        option(
            "FILE",
            "File to write; its ending selects: .dxf, .svg, .pdf, .stl, .3mf, .step, .csv, .json, .xml (MuJoCo), .txt (PMKS+).",
            "-o",
            "--out",
        ),
    ],
    content: Annotated[
        str | None,
        option(
            "WORD",
            "What to write: drawing (.dxf, .svg), parts to cut (.dxf, .svg) or as solids (.stl, .3mf, .step), "
            "assembly (.stl, .3mf, .step), sheet for the workshop (.pdf, .dxf).",
            "--content",
        ),
    ] = None,
    at: Annotated[
        str | None,
        option(
            "POSITION",
            'Crank angle of the drawing: --at "30 deg"; of a slide or cylinder its place or length: --at "250 mm".',
            "--at",
        ),
    ] = None,
    hole: Annotated[str | None, option("SIZE", 'DXF and parts: hole diameter: --hole "8 mm".', "--hole")] = None,
    width: Annotated[str | None, option("SIZE", 'DXF and parts: link width: --width "20 mm".', "--width")] = None,
    points: Annotated[int, number("CSV: steps of the table per revolution.", "--points")] = 360,
    even_invalid: Annotated[bool, flag("Write the design even if it is not valid.", "--even-invalid")] = False,
    backend: Searcher = "ipopt",
    starts: Starts = None,
    seed: Seed = 0,
    changes: Set = None,
    design: Design = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Export a design: drawing, parts to cut or print, workshop sheets, motion, geometry, a model of MuJoCo, a link of PMKS+."""
    from optlink.presentation.export.export import Options, contents_of, export as write

    contents_of(output, content)
    from optlink.units import measures

    kind = "coordinate" if at is not None and measures(at, "coordinate") else "angle"
    options = Options(
        console.quantity(at, kind, "--at"),
        console.quantity(hole, "length", "--hole"),
        console.quantity(width, "length", "--width"),
        points,
        content,
    )
    with console.working("Reading or solving the problem"):
        about = _report_model(source, output, (backend, starts, seed), changes, design, at)
        interrupts.check()
    from optlink.presentation.interface import single_design

    model = single_design(about, source)
    _check_unit(model.problem, at)
    if not (model.valid or even_invalid):
        _refuse(model, as_json)
    for note in write(model, output, options):
        print(f"Note: {note}", file=sys.stderr)
    _written(model, output, as_json)


def _report_model(
    text: str,
    output: Path,
    search: tuple[str, int | None, int],
    changes: Words,
    design: Words,
    at: str | None = None,
) -> ReportModel | StoredStudy:
    """Return the subject of the command: a stored result, or a problem with its solution."""
    from optlink.presentation.files import is_result
    from optlink.presentation.report_model import report_model_of, solve_or_validate

    place = os.path.join(text, "result.json") if os.path.isdir(text) else text
    if output.exists() and os.path.exists(place) and os.path.samefile(output, place):
        raise InputError("this would overwrite the input file", "Choose another name", key="--out", value=str(output))
    if is_result(text):
        from optlink.presentation.registry import read_result, stored_page
        from optlink.problem.assignment import parse_assignments

        remedy = "Leave it out, or name the problem instead of its result"
        facts = parse_assignments(changes or ())
        other = next((key for key in facts if not key.startswith("report.")), None)
        console.refuse({"--design": design, "--starts": search[1]}, "a result already contains its design", remedy, text)
        remedy = f"Leave it out, or name the problem with --design {shlex.quote(place)}"
        console.refuse({"--set": other}, "a result already contains its problem", remedy, text)
        return stored_page(read_result(text), facts, text)
    file = console.load(text, changes)
    _check_unit(file, at)
    return report_model_of(solve_or_validate(file, *search, console.read_design_option(file, design)))


def _check_unit(problem: ProblemFile, at: str | None) -> None:
    """Refuse a position in a unit that is not that of the drive."""
    console.quantity(at, "angle" if problem.model.driving.ends is None else "coordinate", "--at")


def _refuse(about: ReportModel, as_json: bool) -> None:
    """Report why an invalid design is not written."""
    message = f"{about.verdict}. Nothing was written; use --even-invalid to write it anyway"
    print(f"Error: {message}", file=sys.stderr)
    if as_json:
        document = head(SCHEMA, about.problem, "not valid")
        console.print_json(document | {"valid": False, "file": None, "bytes": 0, "message": message})
    raise typer.Exit(1)


def _written(about: ReportModel | StoredStudy, output: Path, as_json: bool) -> None:
    """Report the written file, and exit with code 1 for an invalid design."""
    size = output.stat().st_size
    if as_json:
        document = head(SCHEMA, about.problem, "valid" if about.valid else "not valid")
        console.print_json(document | {"valid": about.valid, "file": str(output), "bytes": size})
    else:
        moved = getattr(getattr(about, "result", None), "kind", "") == "analysis" and about.valid
        print(f"{output}: {size:,} bytes. {about.verdict}{'; the file states no requirement to check' if moved else ''}")
    if not about.valid:
        raise typer.Exit(1)
