"""Arguments and options shared by several commands."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from optlink.cli import console
from optlink.cli.completion import keys, problem_names
from optlink.io import load_extensions
from optlink.solvers.contract import selectable

OVERVIEW: tuple[list[str], ...] = ([], ["-h"], ["--help"], ["--version"])
"""Command lines that show no option of a command and nothing of an extension."""

if sys.argv[1:] not in OVERVIEW:
    load_extensions()
BACK_ENDS = f"<{'|'.join((*selectable(), 'both'))}>"


def back_end(text: str) -> str:
    """Read the name of a back end.

    Raises
    ------
    typer.BadParameter
        If it is none; the command line then ends with exit code 2.
    """
    known = (*selectable(), "both")
    if text in known:
        return text
    raise typer.BadParameter(f"{text[:40]!r} is not one of {', '.join(map(repr, known))}.")


def whole_number(text: object) -> int:
    """Read a whole number.

    Raises
    ------
    typer.BadParameter
        If it is none; the command line then ends with exit code 2.
    """
    try:
        return int(str(text))
    except ValueError:
        raise typer.BadParameter(f'"{str(text)[:40]}" is not a whole number. Give for example 20') from None


def share_number(text: object) -> float:
    """Read a share, a number or a percentage.

    Raises
    ------
    typer.BadParameter
        If it is none; the command line then ends with exit code 2.
    """
    words = str(text).strip()
    try:
        return float(words.removesuffix("%")) / (100.0 if words.endswith("%") else 1.0)
    except ValueError:
        raise typer.BadParameter(f'"{words[:40]}" is not a number. Give for example 1e-6 or 0.01%') from None


PROBLEM_HELP = "A shipped problem (see `list`) or the path of a TOML file."
Problem = Annotated[str, typer.Argument(metavar="PROBLEM", help=PROBLEM_HELP, autocompletion=problem_names)]
Set = Annotated[
    list[str] | None,
    typer.Option(
        "--set", metavar="KEY=VALUE", autocompletion=keys, help='Change a key: --set mechanism.frame="480 mm". Repeatable.'
    ),
]
Design = Annotated[
    list[str] | None,
    typer.Option(
        "--design",
        metavar="NAME=VALUE",
        help='Design to use: --design coupler="412 mm", or a result.json. Repeatable.',
    ),
]


def _set_quiet(wanted: bool) -> bool:
    console.quiet = wanted
    return wanted


def _set_pictures(text: str) -> str:
    known = ("png", "svg", "pdf")
    if text not in known:
        raise typer.BadParameter(f"{text[:40]!r} is not one of {', '.join(map(repr, known))}.")
    console.pictures = text
    return text


Format = Annotated[
    str, typer.Option("--format", metavar="<png|svg|pdf>", callback=_set_pictures, help="Format of the pictures of --out.")
]
Quiet = Annotated[bool, typer.Option("-q", "--quiet", callback=_set_quiet, help="Print only the verdict and errors.")]
Json = Annotated[bool, typer.Option("--json", help="One JSON document on standard output and nothing else.")]
Out = Annotated[Path | None, typer.Option("-o", "--out", metavar="DIR", help="Folder for result.json, pictures and tables.")]
Csv = Annotated[Path | None, typer.Option("--csv", metavar="FILE", help="File for the complete table.")]
Speed = Annotated[
    str | None, typer.Option("--speed", metavar="SPEED", help='Crank speed: --speed "64 rpm"; negative: clockwise.')
]

# --- search ------------------------------------------------------------------------------------------------------------------

Searcher = Annotated[
    str,
    typer.Option(
        "--backend", parser=back_end, metavar=BACK_ENDS, help="Solver; both: SLSQP and IPOPT solve independently and must agree."
    ),
]
Starts = Annotated[
    int | None,
    typer.Option(
        "--starts",
        parser=whole_number,
        metavar="N",
        help="Number of starting points; more are never worse. Motion law or function: N per assembly mode; path: at least N. "
        "Default: as many as make a better design unlikely; 1 if a law's optimum is certified instead.",
    ),
]
Seed = Annotated[int, typer.Option("--seed", parser=whole_number, metavar="S", help="Seed of the starting points.")]

Engine = Annotated[
    str | None, typer.Option("--engine", metavar="NAME", help="local (default: processes of this computer) or dask.")
]
Scheduler = Annotated[
    str | None, typer.Option("--scheduler", metavar="ADDRESS", help="With --engine dask: address of a running scheduler.")
]

# --- reports and exports -----------------------------------------------------------------------------------------------------

Subjected = Annotated[
    str,
    typer.Argument(
        metavar="PROBLEM|RESULT",
        autocompletion=problem_names,
        help="A shipped problem, a TOML file, or a result.json that --out wrote, or its folder.",
    ),
]
Of = Annotated[
    str | None, typer.Option("--problem", metavar="FILE", help="Problem file of a RESULT that is neither shipped nor beside it.")
]
