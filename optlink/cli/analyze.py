"""The commands `analyze` and `balance`: parse, call one library function, print, exit code."""

from __future__ import annotations

from typing import Annotated

import typer

from optlink.cli import console
from optlink.cli.options import Csv, Design, Format, Json, Out, Problem, Quiet, Set, Speed, number, option


def register(app: typer.Typer) -> None:
    """Register the commands."""
    app.command()(analyze)
    app.command()(balance)


def analyze(
    problem: Problem,
    points: Annotated[int, number("Steps of the table per revolution.")] = 360,
    step: Annotated[str | None, option("ANGLE", 'Step of the table, instead of --points: --step "5 deg".')] = None,
    speed: Speed = None,
    changes: Set = None,
    design: Design = None,
    csv: Csv = None,
    as_json: Json = False,
    quiet: Quiet = False,
    picture: Format = "png",
    out: Out = None,
) -> None:
    """Analyse a machine: motion, joint reactions, driving torque and work over the cycle."""
    from optlink.tasks.analyze import analyze as run

    file = console.load(problem, changes)
    given = console.read_design_option(file, design)
    console.places(out, "analyze", problem, csv)
    turn, rate = console.quantity(step, "angle", "--step"), console.quantity(speed, "angular velocity", "--speed")
    result = run(file, points, turn, rate, given)
    console.deliver(result, "analysis", as_json, out, csv)
    if not result.sound:
        raise typer.Exit(1)


MINIMISED = 'Measure to minimise, instead of that of the problem: "rms force", "largest reaction at D".'


def balance(
    problem: Problem,
    minimise: Annotated[str | None, option("MEASURE", MINIMISED)] = None,
    trade: Annotated[str | None, option("A,B", "Compute the trade-off between two measures: --trade force,torque.")] = None,
    points: Annotated[int, number("Points of the trade-off.")] = 25,
    changes: Set = None,
    design: Design = None,
    csv: Csv = None,
    as_json: Json = False,
    quiet: Quiet = False,
    picture: Format = "png",
    out: Out = None,
) -> None:
    """Optimise counterweights and springs: least shaking force, torque or reactions, with proof and shadow prices."""
    from optlink.tasks.balance import balance as run

    file = console.load(problem, changes)
    given = console.read_design_option(file, design)
    console.places(out, "balance", problem, csv)
    with console.share("balancing") as progress:
        result = run(file, minimise, trade, points, progress, given)
    console.deliver(result, "balance", as_json, out, csv)
    if not result.valid:
        raise typer.Exit(3 if result.status == "stalled" else 1)
