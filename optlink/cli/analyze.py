"""The commands `analyze` and `balance`: parse, call one library function, print, exit code."""

from __future__ import annotations

from typing import Annotated

import typer

from optlink.cli import console
from optlink.cli.options import Csv, Design, Format, Json, Out, Problem, Quiet, Set, Speed, whole_number


def register(app: typer.Typer) -> None:
    """Register the commands."""
    app.command()(analyze)
    app.command()(balance)


def analyze(
    problem: Problem,
    points: Annotated[int, typer.Option(parser=whole_number, metavar="N", help="Steps of the table per revolution.")] = 360,
    step: Annotated[
        str | None, typer.Option(metavar="ANGLE", help='Step of the table, instead of --points: --step "5 deg".')
    ] = None,
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
    with console.reported(as_json):
        from optlink.tasks.analyze import analyze as run

        file = console.load(problem, changes)
        given = console.read_design_option(file, design)
        console.places(csv, out, "analyze", problem)
        turn, rate = console.quantity(step, "angle", "--step"), console.quantity(speed, "angular velocity", "--speed")
        result = run(file, points, turn, rate, given)
        console.deliver(result, "analysis", csv, as_json, out)
        if not result.sound:
            raise typer.Exit(1)


def balance(
    problem: Problem,
    minimise: Annotated[
        str | None,
        typer.Option(
            metavar="MEASURE", help='Measure to minimise, instead of that of the problem: "rms force", "largest reaction at D".'
        ),
    ] = None,
    trade: Annotated[
        str | None, typer.Option(metavar="A,B", help="Compute the trade-off between two measures: --trade force,torque.")
    ] = None,
    points: Annotated[int, typer.Option(parser=whole_number, metavar="N", help="Points of the trade-off.")] = 25,
    changes: Set = None,
    design: Design = None,
    csv: Csv = None,
    as_json: Json = False,
    quiet: Quiet = False,
    picture: Format = "png",
    out: Out = None,
) -> None:
    """Optimise counterweights and springs: least shaking force, torque or reactions, with proof and shadow prices."""
    with console.reported(as_json):
        from optlink.tasks.balance import balance as run

        file = console.load(problem, changes)
        given = console.read_design_option(file, design)
        console.places(csv, out, "balance", problem)
        with console.share("balancing") as progress:
            result = run(file, minimise, trade, points, progress, given)
        console.deliver(result, "balance", csv, as_json, out)
        if not result.valid:
            raise typer.Exit(3 if result.status == "stalled" else 1)
