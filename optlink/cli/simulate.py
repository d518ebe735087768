"""The command `simulate`: parse, call one library function, print, exit code.

It calls one of three library functions: for an ideal machine, for one with clearance, or for the comparison of all kinds of
control. Options without effect are refused.
"""

from __future__ import annotations

import contextlib
import functools
import math
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from optlink.cli import console
from optlink.cli.options import Csv, Design, Engine, Format, Json, Out, Problem, Quiet, Scheduler, Set, Speed, whole_number
from optlink.errors import Fault, InputError

if TYPE_CHECKING:
    from optlink.problem.file import ProblemFile

COMPARE = "compare"
GAP = "joints.B={ clearance = '0.5 mm', bearing_radius = '10 mm', modulus = '207 GPa' }"


def register(app: typer.Typer) -> None:
    """Register the command."""
    app.command()(simulate)


@dataclass(frozen=True)
class Run:
    """Common inputs of all simulations [SI]: machine, duration, number of steps, and outputs.

    None stands for the default of the library.
    """

    file: ProblemFile
    design: dict[str, float] | None
    speed: float | None
    duration: float | None
    points: int | None
    flywheel: float
    csv: Path | None
    out: Path | None
    as_json: bool


def simulate(
    problem: Problem,
    duration: Annotated[
        str | None, typer.Option(metavar="TIME", help='Simulated time: --duration "2 s"; default: that of the problem.')
    ] = None,
    points: Annotated[
        int | None,
        typer.Option(
            parser=whole_number,
            metavar="N",
            help="Steps of the table. Default: 1000; with clearance 360 per revolution, 200 to compare or tune.",
        ),
    ] = None,
    speed: Speed = None,
    torque: Annotated[str | None, typer.Option(metavar="TORQUE", help='Constant driving torque: --torque "5 N*m".')] = None,
    flywheel: Annotated[
        str | None, typer.Option(metavar="J", help='Flywheel inertia at the crank: --flywheel "0.2 kg*m^2".')
    ] = None,
    revolutions: Annotated[
        int | None, typer.Option(parser=whole_number, metavar="N", help="With clearance: number of revolutions. Default: 20.")
    ] = None,
    control: Annotated[
        str | None,
        typer.Option(
            metavar="HOW",
            help="With clearance, control: none, inverse, pid, inverse+pid; compare: all of them, from several starts.",
        ),
    ] = None,
    tune: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME",
            help="Control parameter to tune: proportional, integral, derivative, regularisation, bandwidth. Repeatable.",
        ),
    ] = None,
    evaluations: Annotated[
        int | None, typer.Option(parser=whole_number, metavar="N", help="With --tune: number of parameter sets. Default: 24.")
    ] = None,
    starts: Annotated[
        int | None,
        typer.Option(
            parser=whole_number,
            metavar="N",
            help="To compare or tune: number of initial crank angles. Default: compare 5, tune 3.",
        ),
    ] = None,
    seed: Annotated[
        int | None,
        typer.Option(parser=whole_number, metavar="S", help="To compare or tune: seed of the initial crank angles. Default: 0."),
    ] = None,
    workers: Annotated[
        int | None,
        typer.Option(parser=whole_number, metavar="N", help="To compare or tune: number of processes. Default: all cores."),
    ] = None,
    engine: Engine = None,
    scheduler: Scheduler = None,
    tolerance: Annotated[
        float | None,
        typer.Option(
            metavar="X", help="With clearance: relative tolerance of the integrator. Default: 1e-10; to compare or tune 1e-8."
        ),
    ] = None,
    integrator: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="With clearance, integrator: cvodes, compiled (needs numba); auto (default): compiled for long work.",
        ),
    ] = None,
    resume: Annotated[bool, typer.Option("--resume", help="With clearance: resume the interrupted run in --out DIR.")] = False,
    ideal: Annotated[bool, typer.Option("--ideal", help="Ignore joint clearance.")] = False,
    changes: Set = None,
    design: Design = None,
    csv: Csv = None,
    as_json: Json = False,
    quiet: Quiet = False,
    picture: Format = "png",
    out: Out = None,
) -> None:
    """Simulate a machine in time, under a torque or at constant speed, with joint clearance and control."""
    with console.reported(as_json):
        file = console.load(problem, changes)
        if torque is not None:
            file = file.override({"drive.torque": torque, "drive.servo": None})
        given = console.read_design_option(file, design)
        loose = file.model.has_clearance and not ideal
        if not loose:
            of_gaps: dict[str, Any] = {
                "--revolutions": revolutions,
                "--control": control,
                "--tolerance": tolerance,
                "--integrator": integrator,
                "--resume": resume,
            }
            of_gaps["--tune"] = tune
            message = f"{'joints count as ideal' if ideal else 'no joint has clearance'}, so the option does nothing"
            console.refuse(of_gaps, message, "Leave --ideal out" if ideal else f'Give one: --set "{GAP}"', file.file)
        comparing = control == COMPARE
        if comparing and tune:
            message, remedy = "a comparison of all kinds of control tunes none", "Name the kind to tune: --control inverse+pid"
            raise InputError(Fault(message, remedy, file.file, "--tune"))
        if not tune:
            message, remedy = "only a search for parameters has evaluations", "Add --tune NAME, or leave it out"
            console.refuse({"--evaluations": evaluations}, message, remedy, file.file)
        if not comparing and not tune:
            remedy = "Leave it out" if not loose else f"Add --control {COMPARE} or --tune NAME, or leave it out"
            message = "there is one start, so the option does nothing"
            of_many = {"--starts": starts, "--seed": seed, "--workers": workers, "--engine": engine, "--scheduler": scheduler}
            console.refuse(of_many, message, remedy, file.file)
        else:
            message = "a comparison of all kinds of control, or a search for parameters, has no use for it"
            remedy = "Leave it out, or simulate one kind: --control inverse+pid"
            console.refuse({"--csv": csv, "--flywheel": flywheel}, message, remedy, file.file)
        console.places(csv, out, "simulate", problem)
        asked = Run(
            file,
            given,
            console.quantity(speed, "angular velocity", "--speed"),
            console.quantity(duration, "time", "--duration"),
            points,
            console.quantity(flywheel, "moment of inertia", "--flywheel") or 0.0,
            csv,
            out,
            as_json,
        )
        many: dict[str, Any] = {"starts": starts, "seed": seed, "workers": workers, "engine": engine, "scheduler": scheduler}
        many |= {"tolerance": tolerance, "integrator": integrator}
        if not loose:
            _ideal(asked)
        elif comparing:
            _compared(asked, revolutions, resume, **many)
        elif tune:
            _tuned(asked, revolutions, control or "inverse+pid", tune, resume, evaluations=evaluations, **many)
        else:
            _loose(asked, revolutions, control or "none", resume, tolerance=tolerance, integrator=integrator)


def _ideal(asked: Run) -> None:
    """Simulate a machine without joint clearance."""
    from optlink.tasks.simulate import simulate as run

    with console.share("simulating") as progress:
        result = run(
            asked.file,
            asked.duration,
            speed=asked.speed,
            design=asked.design,
            progress=progress,
            flywheel=asked.flywheel,
            **console.given(rows=asked.points),
        )
    console.deliver(result, "simulation", asked.csv, asked.as_json, asked.out)
    if not result.finished:
        raise typer.Exit(3 if result.run.ending.value == "stalled" else 1)


def _loose(asked: Run, revolutions: int | None, control: str, resume: bool, **options: Any) -> None:
    """Simulate a machine with joint clearance."""
    from optlink.report.files import checkpoint, write_json
    from optlink.tasks.clearance import simulate_clearance

    turns = _revolutions(asked, revolutions)
    begun = checkpoint(asked.out) if resume else None
    done = 0 if begun is None else int(begun.get("revolutions", 0)) * int(begun.get("points", 0))
    with _streamed(asked.csv, done) as stream, console.share("simulating") as progress:
        found = simulate_clearance(
            asked.file,
            turns,
            speed=asked.speed,
            control=control,
            design=asked.design,
            flywheel=asked.flywheel,
            progress=progress,
            stream=stream,
            checkpoint=None if asked.out is None else functools.partial(write_json, asked.out / "checkpoint.json"),
            resume=begun,
            compiling=_compiling,
            **console.given(points=asked.points, **options),
        )
    console.deliver(found, "clearance", None, asked.as_json, asked.out)
    if not found.finished:
        raise typer.Exit(3 if found.ending.value == "stalled" else 1)


def _compared(asked: Run, revolutions: int | None, resume: bool, **options: Any) -> None:
    """Compare all kinds of control."""
    from optlink.tasks.control_comparison import compare

    turns = _revolutions(asked, revolutions)
    with _kept(asked, resume, "runs", "comparing") as common:
        found = compare(asked.file, turns, **common, **_many(options))
    if asked.out is not None:
        from optlink.report.registry import view_of

        with console.working(f"Drawing into {asked.out}"):
            view_of("control comparison").write(found, asked.out, console.pictures)
    _shown(asked, found, "control comparison")
    if not found.finished:
        raise typer.Exit(3)


def _tuned(asked: Run, revolutions: int | None, control: str, names: list[str], resume: bool, **options: Any) -> None:
    """Tune controller parameters."""
    from optlink.tasks.control_comparison import tune

    turns: dict[str, Any] = (
        {} if revolutions is None and asked.duration is None else {"revolutions": _revolutions(asked, revolutions)}
    )
    with _kept(asked, resume, "evaluations", "tuning") as common:
        found = tune(asked.file, control, tuple(names), **turns, **common, **_many(options))
    if asked.out is not None:
        from optlink.report.files import write_json

        write_json(asked.out / "result.json", found.to_dict())
    _shown(asked, found, "tuning")


def _compiling() -> contextlib.AbstractContextManager[None]:
    """Show that the equations are being compiled."""
    return console.working("Compiling the equations of motion (cached for the next time)")


def _many(options: dict[str, Any]) -> dict[str, Any]:
    """Return the options of many runs: as many processes as cores by default."""
    from optlink.execution.runner import cores

    return {"workers": cores(), **console.given(**options)}


def _shown(asked: Run, found: Any, table: str) -> None:
    if asked.as_json:
        console.print_json(found.to_dict())
        return
    from optlink.report.registry import table_of

    console.show(table_of(table)(found))


@contextlib.contextmanager
def _kept(asked: Run, resume: bool, parts: str, what: str) -> Iterator[dict[str, Any]]:
    """Provide a comparison or a tuning with a progress bar, a checkpoint, and a message on interruption."""
    from optlink.report.files import checkpoint, write_json

    place = None if asked.out is None else asked.out / "checkpoint.json"
    begun = checkpoint(asked.out) if resume else None
    done, of = (0, 0) if begun is None else (begun.get("complete", 0), begun.get("total", 0))

    def keep(document: dict[str, Any]) -> None:
        nonlocal done, of
        done, of = document["complete"], document["total"]
        if place is not None:
            write_json(place, document)

    try:
        with console.share(what) as progress:
            yield {
                "speed": asked.speed,
                "design": asked.design,
                "progress": progress,
                "compiling": _compiling,
                "checkpoint": keep,
                "resume": begun,
                **console.given(points=asked.points),
            }
    except KeyboardInterrupt:
        message = f"interrupted: {done} of {of} {parts} are complete" if of else f"interrupted: no {parts} are complete"
        if done and place is not None:
            message += f" and kept in {place}; add --resume to continue"
        elif place is None:
            message += "; without --out DIR no results are kept"
        print(message, file=sys.stderr)
        raise typer.Exit(130) from None
    if place is not None:
        place.unlink(missing_ok=True)


def _revolutions(asked: Run, revolutions: int | None) -> int:
    """Return the number of revolutions."""
    duration, drive = asked.duration, asked.file.model.drive
    if revolutions is not None and duration is not None:
        raise InputError(Fault("revolutions and a duration are given", "Give one of the two", key="--duration"))
    if duration is None and revolutions is None and drive.duration is not None:
        duration = drive.duration.value
    if duration is None:
        return 20 if revolutions is None else revolutions
    from optlink.tasks.machine import crank_speed

    period = 2.0 * math.pi / abs(asked.speed or crank_speed(asked.file))
    return max(1, math.ceil(duration / period * (1.0 - 1e-9)))


@contextlib.contextmanager
def _streamed(csv: Path | None, done: int) -> Iterator[Any]:
    """Provide a table that is written during the simulation."""
    if csv is None:
        yield None
        return
    from optlink.report.files import stream

    with stream(csv, done) as rows:
        yield rows
