"""The command `simulate`: parse, call one library function, print, exit code.

It calls one of three library functions: for an ideal machine, for one with clearance, or for the comparison of all kinds of
control. Options without effect are refused.
"""

from __future__ import annotations

import contextlib
import functools
import json
import math
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from optlink.cli import console
from optlink.cli.options import (
    Csv,
    Design,
    Engine,
    Format,
    Json,
    Out,
    Problem,
    Quiet,
    Scheduler,
    Set,
    flag,
    number,
    option,
)
from optlink.errors import InputError
from optlink.execution import interrupts

if TYPE_CHECKING:
    from optlink.problem.file import ProblemFile

COMPARE = "compare"
CONTROLS = "With clearance, control: none, inverse, pid, inverse+pid; compare: all of them, from several starts."
TUNED = "Control parameter to tune: proportional, integral, derivative, regularisation, bandwidth. Repeatable."
TOLERANCE = "With clearance: relative tolerance of the integrator. Default: 1e-10; to compare or tune 1e-8."
INTEGRATOR = (
    "With clearance, integrator: cvodes, compiled (needs numba); auto (default): compiled for long work or if compiled already."
)
SPEED = 'Crank speed, as drive.speed; under a torque the one at the start: --speed "64 rpm"; negative: clockwise.'
TORQUE = 'Constant driving torque: --torque "5 N*m". The crank starts at --speed, else at initial_speed or speed of [drive].'
MEASURED = "With clearance: CSV file of the measured output to compare: time_s or angle_deg, displacement_mm or voltage_V."
CLEARANCE_EXAMPLE = "joints.B={ clearance = '0.5 mm', bearing_radius = '10 mm', modulus = '207 GPa' }"


def simulate(
    problem: Problem,
    duration: Annotated[str | None, option("TIME", 'Simulated time: --duration "2 s"; default: that of the problem.')] = None,
    points: Annotated[
        int | None, number("Steps of the table. Default: 1000; with clearance 360 per revolution, 200 to compare or tune.")
    ] = None,
    speed: Annotated[str | None, option("SPEED", SPEED, "--speed")] = None,
    torque: Annotated[str | None, option("TORQUE", TORQUE)] = None,
    flywheel: Annotated[str | None, option("INERTIA", 'Flywheel inertia at the crank: --flywheel "0.2 kg*m^2".')] = None,
    revolutions: Annotated[int | None, number("With clearance: number of revolutions. Default: 20.")] = None,
    control: Annotated[str | None, option("HOW", CONTROLS)] = None,
    tune: Annotated[list[str] | None, option("NAME", TUNED)] = None,
    evaluations: Annotated[int | None, number("With --tune: number of parameter sets. Default: 24.")] = None,
    starts: Annotated[
        int | None, number("To compare or tune: number of initial crank angles. Default: compare 5, tune 3.")
    ] = None,
    seed: Annotated[int | None, number("To compare or tune: seed of the initial crank angles. Default: 0.", metavar="S")] = None,
    workers: Annotated[int | None, number("To compare or tune: number of processes. Default: all cores.")] = None,
    engine: Engine = None,
    scheduler: Scheduler = None,
    tolerance: Annotated[float | None, option("X", TOLERANCE)] = None,
    integrator: Annotated[str | None, option("NAME", INTEGRATOR)] = None,
    resume: Annotated[bool, flag("With clearance: resume the interrupted run in --out DIR.", "--resume")] = False,
    ideal: Annotated[bool, flag("Ignore joint clearance.", "--ideal")] = False,
    measured: Annotated[Path | None, option("FILE", MEASURED)] = None,
    changes: Set = None,
    design: Design = None,
    csv: Csv = None,
    as_json: Json = False,
    quiet: Quiet = False,
    picture: Format = "png",
    out: Out = None,
) -> None:
    """Simulate a machine in time, under a torque or at constant speed, with joint clearance and control."""
    file = console.load(problem, [*(changes or []), *_series(measured)], definite=True)
    if torque is not None:
        file = file.override({"drive.torque": torque, "drive.servo": None})
    values = console.given_design(file, problem, changes, design)
    with_clearance = file.model.has_clearance and not ideal
    if not with_clearance:
        of_gaps: dict[str, Any] = {"--revolutions": revolutions, "--control": control, "--tolerance": tolerance}
        of_gaps |= {"--measured": measured, "--integrator": integrator, "--resume": resume, "--tune": tune}
        message = f"{'joints count as ideal' if ideal else 'no joint has clearance'}, so the option has no effect"
        console.refuse(of_gaps, message, "Leave --ideal out" if ideal else f'Give one: --set "{CLEARANCE_EXAMPLE}"', file.file)
    comparing = control == COMPARE
    if comparing and tune:
        message, remedy = "a comparison of controllers tunes no parameters", "Name the kind to tune: --control inverse+pid"
        raise InputError(message, remedy, file.file, "--tune")
    if not tune:
        message, remedy = "the option applies to --tune only", "Add --tune NAME, or leave it out"
        console.refuse({"--evaluations": evaluations}, message, remedy, file.file)
    if not comparing and not tune:
        remedy = "Leave it out" if not with_clearance else f"Add --control {COMPARE} or --tune NAME, or leave it out"
        message = "there is only one start, so the option has no effect"
        of_many = {"--starts": starts, "--seed": seed, "--workers": workers, "--engine": engine, "--scheduler": scheduler}
        console.refuse(of_many, message, remedy, file.file)
    else:
        message = "the option has no effect on a comparison of controllers or a parameter search"
        remedy = "Leave it out, or simulate one kind: --control inverse+pid"
        console.refuse({"--csv": csv, "--flywheel": flywheel, "--measured": measured}, message, remedy, file.file)
    console.places(out, "simulate", problem, csv)
    common: dict[str, Any] = {"speed": console.quantity(speed, "angular velocity", "--speed"), "design": values}
    time = console.quantity(duration, "time", "--duration")
    inertia = console.quantity(flywheel, "moment of inertia", "--flywheel") or 0.0
    if not with_clearance:
        from optlink.tasks.simulate import simulate as run

        with console.share("simulating") as progress:
            ideal_run = run(file, time, progress=progress, flywheel=inertia, **common, **console.given(rows=points))
        console.deliver(ideal_run, as_json, out, csv)
        return
    from optlink.presentation.files import CHECKPOINT

    whole_revolutions = _revolutions(file, revolutions, time, common["speed"])
    from optlink.tasks.clearance import COMPILING

    COMPILING.set(functools.partial(console.working, "Compiling the equations of motion (cached for the next time)"))
    common |= console.given(points=points, tolerance=tolerance, integrator=integrator)
    parallel = console.given(starts=starts, seed=seed, workers=workers, engine=engine, scheduler=scheduler)
    if comparing or tune:
        from optlink.execution.runner import cores

        parallel = {"workers": cores()} | parallel
    if comparing:
        from optlink.tasks.control_comparison import compare

        with _kept(out, resume, "runs", "comparing") as store:
            compared = compare(file, whole_revolutions, **common, **parallel, **store)
        console.deliver(compared, as_json, out, state=CHECKPOINT)
    elif tune:
        from optlink.tasks.control_comparison import tune as search

        with _kept(out, resume, "evaluations", "tuning") as store:
            common |= console.given(
                revolutions=None if revolutions is None and time is None else whole_revolutions, evaluations=evaluations
            )
            tuned = search(file, control or "inverse+pid", tuple(tune), **common, **parallel, **store)
        console.deliver(tuned, as_json, out, state=CHECKPOINT)
    else:
        from optlink.io import write_json
        from optlink.presentation.files import checkpoint, stream
        from optlink.tasks.clearance import simulate_clearance

        begun = checkpoint(out) if resume else None
        done = 0 if begun is None else _rows_done(begun, whole_revolutions, out)
        keep = None if out is None else functools.partial(write_json, out / CHECKPOINT)
        common |= {"control": control or "none", "flywheel": inertia, "checkpoint": keep, "resume": begun}
        table = contextlib.nullcontext() if csv is None else stream(csv, done)
        with table as rows, console.share("simulating") as progress:
            result = simulate_clearance(file, whole_revolutions, progress=progress, stream=rows, **common)
        console.deliver(result, as_json, out)


def _series(measured: Path | None) -> list[str]:
    """Return the change of the problem that names the file of a measured series."""
    if measured is None:
        return []
    if not measured.is_file():
        raise InputError("no such file", "Check the path", key="--measured", value=str(measured))
    return [f"measured.csv={json.dumps(str(measured.absolute()))}"]


def _rows_done(begun: Mapping[str, Any], revolutions: int, out: Path | None) -> int:
    """Return the number of rows of a simulation before those that follow; the last revolution is simulated again."""
    from optlink.cli.console import earlier_result
    from optlink.units import count_noun

    result = {} if out is None else earlier_result(out)
    if result.get("valid") and (result.get("figures") or {}).get("revolutions") == revolutions == begun.get("revolutions"):
        message, remedy = (
            f"{count_noun(revolutions, 'revolution is', 'revolutions are')} already complete",
            "Request more, or leave out --resume",
        )
        raise InputError(message, remedy, key="--revolutions", value=revolutions)
    return min(int(begun.get("revolutions", 0)), revolutions - 1) * int(begun.get("points", 0))


@contextlib.contextmanager
def _kept(out: Path | None, resume: bool, parts: str, what: str) -> Iterator[dict[str, Any]]:
    """Provide a comparison or a tuning with a progress bar, a checkpoint, and a message on interruption."""
    from optlink.io import write_json
    from optlink.presentation.files import CHECKPOINT, checkpoint

    place = None if out is None else out / CHECKPOINT
    begun = checkpoint(out) if resume else None
    done, of = (0, 0) if begun is None else (begun.get("complete", 0), begun.get("total", 0))

    def keep(document: dict[str, Any]) -> None:
        nonlocal done, of
        done, of = document["complete"], document["total"]
        if place is not None:
            write_json(place, document)

    try:
        with console.share(what) as progress:
            yield {"progress": progress, "checkpoint": keep, "resume": begun}
    except KeyboardInterrupt:
        interrupts.handled()
        message = f"interrupted: {done} of {of} {parts} are complete" if of else f"interrupted: no {parts} are complete"
        if done and place is not None:
            message += f" and kept in {place}; add --resume to continue"
        elif place is None:
            message += "; without --out DIR no results are kept"
        print(message, file=sys.stderr)
        raise typer.Exit(130) from None


def _revolutions(file: ProblemFile, revolutions: int | None, duration: float | None, speed: float | None) -> int:
    if revolutions is not None and duration is not None:
        raise InputError("revolutions and a duration are given", "Give one of the two", key="--duration")
    if revolutions is not None:
        return revolutions
    from optlink.tasks.machine import crank_speed, duration_of

    duration = duration_of(file, duration)
    if duration is None:
        return 20
    exact = duration * abs(crank_speed(file, speed)) / (2.0 * math.pi)
    count = max(1, math.ceil(exact * (1.0 - 1e-9)))
    if not (math.isclose(exact, count, rel_tol=1e-6) or console.quiet):
        what = f"{duration:.6g} s are {exact:.6g} revolutions"
        print(f"Note: {what}; with clearance whole revolutions are simulated: {count}", file=sys.stderr)
    return count
