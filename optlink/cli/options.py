"""Arguments and options shared by several commands."""

import math
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from optlink.cli import console
from optlink.execution.options import Execution, meaning
from optlink.io import data_files, load_extensions
from optlink.solvers.contract import selectable

# Completion of arguments in the shell: problems, templates, keys of --set. Nothing heavy is imported, no file is checked.


def problem_names(incomplete: str) -> list[str]:
    """Return the shipped problems, and the TOML files and folders whose path begins so."""
    names = [name for name in data_files("problems") if name.startswith(incomplete)]
    folder = Path(incomplete if incomplete.endswith("/") else f"{incomplete}x").parent
    try:
        inside = sorted(folder.iterdir())
    except OSError:
        return names
    places = [f"{path}/" for path in inside if path.is_dir()] + [str(path) for path in inside if path.suffix == ".toml"]
    return names + [place for place in places if place.startswith(incomplete) and not Path(place).name.startswith(".")]


def template_names(incomplete: str) -> list[str]:
    """Return the templates whose name begins so."""
    return [name for name in data_files("templates") if name.startswith(incomplete)]


def keys(context: typer.Context, incomplete: str) -> list[str]:
    """Return the keys of the problem on the command line that begin with `incomplete`, each with "=", for --set."""
    import tomllib

    text = str(context.params.get("problem") or next(iter(context.args), ""))  # the arguments of an unfinished line
    try:
        tables = tomllib.loads(data_files("problems").get(text, Path(text)).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return []
    return [f"{key}=" for key in _leaves(tables) if key.startswith(incomplete) and not key.startswith(("expected.", "about"))]


def _leaves(table: Mapping[str, Any], above: str = "") -> Iterator[str]:
    """Yield the dotted keys of all values that are not tables."""
    for name, value in table.items():
        if isinstance(value, Mapping) and not {"start", "bounds", "equals"} & set(value):
            yield from _leaves(value, f"{above}{name}.")
        else:
            yield f"{above}{name}"


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
        If it is invalid; the command line then exits with code 2.
    """
    return _one_of(text, (*selectable(), "both"))


def _one_of(text: str, choices: tuple[str, ...]) -> str:
    if text in choices:
        return text
    raise typer.BadParameter(f"{text[:40]!r} is not one of {', '.join(map(repr, choices))}.")


def whole_number(text: object) -> int:
    """Read a whole number.

    Raises
    ------
    typer.BadParameter
        If it is invalid; the command line then exits with code 2.
    """
    words = str(text).strip()
    try:
        return int(words.replace("_", " ").encode("ascii"))
    except ValueError:
        raise typer.BadParameter(f'"{words[:40]}" is not a whole number. Give for example 20') from None


def share_number(text: object) -> float:
    """Read a share, a number or a percentage.

    Raises
    ------
    typer.BadParameter
        If it is invalid; the command line then exits with code 2.
    """
    from optlink.units import read_number

    words = str(text).strip()
    number = read_number(words.removesuffix("%"))
    if math.isnan(number):
        raise typer.BadParameter(f'"{words[:40]}" is not a number. Give for example 1e-6 or 0.01%')
    return number / (100.0 if words.endswith("%") else 1.0)


def option(metavar: str, text: str, *names: str, **more: Any) -> Any:
    """Declare an option with a value; without `names` it has that of the parameter."""
    return typer.Option(*names, metavar=metavar, help=text, **more)


def number(text: str, *names: str, metavar: str = "N") -> Any:
    """Declare an option that takes a whole number; without `names` it has that of the parameter."""
    return option(metavar, text, *names, parser=whole_number)


def flag(text: str, *names: str, **more: Any) -> Any:
    """Declare an option without a value."""
    return typer.Option(*names, help=text, **more)


PROBLEM_HELP = "A shipped problem (see `list`), the path of a TOML file, or a result.json that --out wrote, or its folder."
Problem = Annotated[str, typer.Argument(metavar="PROBLEM", help=PROBLEM_HELP, autocompletion=problem_names)]
Set = Annotated[
    list[str] | None,
    option("KEY=VALUE", 'Change a key: --set mechanism.frame="480 mm". Repeatable.', "--set", autocompletion=keys),
]
Design = Annotated[
    list[str] | None,
    option("NAME=VALUE", 'Design to use: --design coupler="412 mm", or a result.json. Repeatable.', "--design"),
]


def _set_quiet(chosen: bool) -> bool:
    console.quiet = chosen
    return chosen


def _set_pictures(text: str) -> str:
    console.pictures = _one_of(text, ("png", "svg", "pdf"))
    return text


Format = Annotated[str, option("<png|svg|pdf>", "Format of the pictures of --out.", "--format", callback=_set_pictures)]


def _set_film(chosen: bool) -> bool:
    console.film = chosen
    return chosen


Film = Annotated[bool, flag("With --out: draw the animation motion.gif too.", "--film", callback=_set_film)]
Quiet = Annotated[bool, flag("Print only the verdict and errors.", "-q", "--quiet", callback=_set_quiet)]
Json = Annotated[bool, flag("One JSON document on standard output and nothing else.", "--json")]
Out = Annotated[Path | None, option("DIR", "Folder for result.json, pictures and tables.", "-o", "--out")]
Csv = Annotated[Path | None, option("FILE", "File for the complete table.", "--csv")]
Speed = Annotated[str | None, option("SPEED", 'Crank speed: --speed "64 rpm"; negative: clockwise.', "--speed")]

# --- search ------------------------------------------------------------------------------------------------------------------

BACKEND_HELP = "Solver; both: SLSQP and IPOPT solve independently and must agree."
Searcher = Annotated[str, option(BACK_ENDS, BACKEND_HELP, "--backend", parser=back_end)]
STARTS_HELP = (
    "Number of starting points, at least N; a larger number is never worse. "
    "Default: until a better design is unlikely; 1 for a law with a certified optimum."
)
Starts = Annotated[int | None, number(STARTS_HELP, "--starts")]
Seed = Annotated[int, number("Seed of the starting points.", "--seed", metavar="S")]

Engine = Annotated[str | None, option("NAME", meaning(Execution, "engine"), "--engine")]
Scheduler = Annotated[str | None, option("ADDRESS", meaning(Execution, "scheduler"), "--scheduler")]

# --- reports and exports -----------------------------------------------------------------------------------------------------
