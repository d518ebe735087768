"""The commands `report` and `export`: parse, call one library function, print, exit code. They are made known by `cli`."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from optlink.errors import Fault, InputError

if TYPE_CHECKING:
    from optlink.report.subject import Subject

SCHEMA = "optlink/written/1"

Subjected = Annotated[
    str,
    typer.Argument(metavar="PROBLEM|RESULT", help="A shipped problem, a TOML file, or a result.json that --out wrote."),
]
Of = Annotated[
    str | None, typer.Option("--problem", metavar="FILE", help="The problem of a RESULT, if it is neither shipped nor beside it.")
]
Starts = Annotated[int | None, typer.Option("--starts", metavar="N", help="Number of starts of the search.")]
Seed = Annotated[int, typer.Option("--seed", metavar="S", help="Seed of the starts.")]
Backend = Annotated[str, typer.Option("--backend", metavar="NAME", help="slsqp or ipopt; of a law and of a cycle also both.")]
Set = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="KEY=VALUE", help='Change a key: --set mechanism.frame="480 mm". Repeatable.'),
]
Design = Annotated[
    list[str] | None,
    typer.Option("--design", metavar="NAME=VALUE", help="A given design instead of a search; or a result.json. Repeatable."),
]
Json = Annotated[bool, typer.Option("--json", help="One JSON document on standard output and nothing else.")]


def register(app: typer.Typer) -> None:
    """Make the commands known."""
    app.command()(report)
    app.command()(export)


def report(
    subject: Subjected,
    output: Annotated[Path, typer.Option("-o", "--output", metavar="FILE.html", help="The page that is written.")],
    problem: Of = None,
    backend: Backend = "ipopt",
    starts: Starts = None,
    seed: Seed = 0,
    changes: Set = None,
    design: Design = None,
    as_json: Json = False,
) -> None:
    """Everything about a design on one page: figures, proof, charts, the moving linkage, sources."""
    from optlink import cli

    with cli._reported(as_json):
        from optlink.report.export import target

        target(output, (".html", ".htm"), "report.html")
        with cli._working("Reading or solving the problem"):
            about = _subject(subject, output, problem, backend, starts, seed, changes, design)
        from optlink.report.page import write_page

        with cli._working(f"Writing {output}"):
            write_page(about, output)
        _written(about, output, as_json)
        if not about.valid:
            raise typer.Exit(1)


def export(
    subject: Subjected,
    output: Annotated[
        Path, typer.Option("-o", "--output", metavar="FILE", help="The file; its ending chooses: .dxf, .svg, .csv or .json.")
    ],
    at: Annotated[
        str | None,
        typer.Option("--at", metavar="ANGLE", help='Crank angle of the drawing: --at "30 deg"; its start if not said.'),
    ] = None,
    hole: Annotated[str | None, typer.Option("--hole", metavar="SIZE", help='DXF: diameter of the holes: --hole "8 mm".')] = None,
    width: Annotated[
        str | None, typer.Option("--width", metavar="SIZE", help='DXF: width of the links: --width "20 mm".')
    ] = None,
    points: Annotated[int, typer.Option("--points", metavar="N", help="CSV: steps of the table per revolution.")] = 360,
    even_invalid: Annotated[bool, typer.Option("--even-invalid", help="Write a design that is not valid all the same.")] = False,
    problem: Of = None,
    backend: Backend = "ipopt",
    starts: Starts = None,
    seed: Seed = 0,
    changes: Set = None,
    design: Design = None,
    as_json: Json = False,
) -> None:
    """A design for other programs: DXF, SVG, CSV or JSON."""
    from optlink import cli

    with cli._reported(as_json):
        from optlink.report.export import FORMATS, Options, target
        from optlink.report.export import export as write

        target(output, tuple(FORMATS), "drawing.dxf")
        angle = cli._quantity(at, "angle", "--at")
        options = Options(angle, cli._quantity(hole, "length", "--hole"), cli._quantity(width, "length", "--width"), points)
        with cli._working("Reading or solving the problem"):
            about = _subject(subject, output, problem, backend, starts, seed, changes, design)
        if not (about.valid or even_invalid):
            _refuse(about, as_json)
        write(about, output, options)
        _written(about, output, as_json)
        if not about.valid:
            raise typer.Exit(1)


def _subject(
    text: str,
    output: Path,
    problem: str | None,
    backend: str,
    starts: int | None,
    seed: int,
    changes: list[str] | None,
    design: list[str] | None,
) -> Subject:
    """What is asked for: a result as it is, or a problem with its answer."""
    from optlink.report.recorded import is_result, read_subject
    from optlink.report.subject import answered, subject_of

    if output.exists() and Path(text).exists() and os.path.samefile(output, text):
        raise InputError(Fault("this would overwrite what it is made of", "Choose another name", key="-o", value=str(output)))
    if is_result(text):
        for option, value in {"--design": design, "--starts": starts}.items():
            if value is not None:
                remedy = "Leave it out, or name the problem instead of its result"
                raise InputError(Fault("a result has its design already", remedy, text, option, str(value)))
        return read_subject(Path(text), problem, changes or ())
    if problem is not None:
        remedy = "Leave it out, or name a result.json first"
        raise InputError(Fault("only a RESULT belongs to another problem", remedy, text, "--problem", problem))
    from optlink.design.files import load, parse_assignment

    file = load(text, dict(parse_assignment(change) for change in changes or []))
    given = None
    if design:
        from optlink.workflow import read_design

        given = read_design(file, design)
    return subject_of(file, answered(file, backend, starts, seed, given))


def _refuse(about: Subject, as_json: bool) -> None:
    """Say why an invalid design is not written."""
    from optlink import cli
    from optlink.documents import head
    from optlink.report.page import verdict

    message = f"{verdict(about)}. Nothing is written; --even-invalid writes it all the same"
    print(f"Error: {message}", file=sys.stderr)
    if as_json:
        document = head(SCHEMA, about.problem, "not valid")
        cli._print_json(document | {"valid": False, "file": None, "bytes": 0, "message": message})
    raise typer.Exit(1)


def _written(about: Subject, output: Path, as_json: bool) -> None:
    """Say what was written."""
    from optlink import cli
    from optlink.report.page import verdict

    size = output.stat().st_size
    if as_json:
        from optlink.documents import head

        document = head(SCHEMA, about.problem, "valid" if about.valid else "not valid")
        cli._print_json(document | {"valid": about.valid, "file": str(output), "bytes": size})
        return
    print(f"{output}: {size:,} bytes. {verdict(about)}")
