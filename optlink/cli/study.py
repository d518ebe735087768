"""The commands of `study`: parse, call one library function, print, exit code."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from optlink.cli import console
from optlink.cli.command import App
from optlink.cli.options import Engine, Format, Json, Problem, Quiet, Scheduler, Set, flag, number, option
from optlink.errors import InputError
from optlink.execution import interrupts
from optlink.solvers.contract import selectable

if TYPE_CHECKING:
    from optlink.problem.driving import Driving
    from optlink.problem.file import ProblemFile

SIMULATED = ("the option applies to simulations", "Add --simulate")
DEFAULT_ANGLES = "0..330 deg:12"  # default crank angles of an output

Backend = Annotated[str, option("NAME", f"One of: {', '.join(selectable())}.", "--backend")]
Workers = Annotated[int | None, number("Number of processes. Default: all cores.", "--workers")]
OUT_HELP = "Folder for completed chunks, and for table, result.json and picture at the end."
StudyFolder = Annotated[Path | None, option("DIR", OUT_HELP, "-o", "--out")]
Resume = Annotated[bool, flag("Resume the interrupted run in --out DIR.", "--resume")]
DEVIATIONS = 'coupler="0.1 mm", D.x="0.05 mm uniform", rocker=parts.csv. Default: as in the file. Repeatable.'
SHAPE = "Default distribution: normal (the tolerance is 3 sigma), uniform, triangular."
ROBUST = "Optimise the design for the error plus K sigma, the worst case, the most sigma, or the largest yield."
VARIED = 'Key to vary and its range or list of values: mechanism.frame="450..550 mm:101". Repeatable.'
OBJECTIVES_HELP = 'Machine: "peak torque, guide force in F=1300..1600 N"; requirement: "error, limits.transmission_angle.max".'
POINTS = "Number of points; with three objectives along each of two axes. Default: 15; with three objectives 7."

study = App(no_args_is_help=True, help="Parametric studies: sensitivity, sweep, tolerance analysis, Pareto front.")


@study.command()
def sensitivity(
    problem: Problem,
    check: Annotated[bool, flag("Verify each sensitivity by re-optimising on both sides.", "--check")] = False,
    output: Annotated[
        str | None,
        option("BODY|P.x", "Sensitivity of an output angle or point to every dimension, instead of the objective.", "--quantity"),
    ] = None,
    angles: Annotated[
        str | None, option("LIST", f'With --quantity, crank angles: "0 deg, 60 deg" or "{DEFAULT_ANGLES}" (default).', "--angles")
    ] = None,
    backend: Backend = "ipopt",
    starts: Annotated[int | None, option("N", "Number of starting points.")] = None,
    seed: Annotated[int, option("S", "Seed of the starting points.")] = 0,
    changes: Set = None,
    design: Annotated[list[str] | None, option("NAME=VALUE", "With --quantity: design to use. Repeatable.", "--design")] = None,
    as_json: Json = False,
    quiet: Quiet = False,
    picture: Format = "png",
    out: Annotated[Path | None, option("DIR", "Folder for result.json, table and tornado chart.", "-o", "--out")] = None,
) -> None:
    """Sensitivity of the optimum to each fixed parameter and limit, with the range over which it holds."""
    console.places(out, "sensitivity", problem)
    from optlink.studies.reoptimise_task import check_backend

    file = console.load(problem, changes, definite=output is not None)
    check_backend(backend)
    if output is not None:
        remedy = "Leave --check out; it re-optimises"
        console.refuse({"--check": check}, "the sensitivity of an output involves no optimisation", remedy, file.file)
        given = console.given_design(file, problem, changes, design)
        _output(file, output, DEFAULT_ANGLES if angles is None else angles, given, as_json, out)
        return
    console.refuse({"--angles": angles}, "the option applies to --quantity only", "Add for example --quantity rocker", file.file)
    if design:
        remedy = "Leave --design out; --quantity takes one"
        raise InputError("sensitivities are computed at the optimum, not at a given design", remedy, key="--design")
    from optlink.studies.sensitivity import sensitivities

    with console.share("searching again" if check else "searching") as progress:
        result = sensitivities(file, backend, starts, seed, check=check, progress=progress)
    console.deliver(result, as_json, out)


def _crank_angles(text: str, driving: Driving) -> Any:
    """Read crank angles [rad] such as "0 deg, 60 deg" or "0..330 deg:12"; of a drive along a line its slides or lengths."""
    import numpy as np

    from optlink.studies.grid import read_axis
    from optlink.units import UnitProblem, factor

    kind, remedy = "angle", 'Write for example "0 deg, 60 deg" or "0..330 deg:12"'
    if driving.ends is not None:
        low, high = (f"{1e3 * end:.6g}" for end in driving.ends)
        kind, remedy = "length", f'Write for example "{low} mm, {high} mm" or "{low}..{high} mm:12"'
    try:
        axis = read_axis("angles", text)
        return driving.at(np.asarray(axis.values) * factor(axis.unit, kind) / factor(driving.unit, kind))
    except (InputError, UnitProblem) as error:
        message = error.faults[0].message if isinstance(error, InputError) else error.message
        raise InputError(message, remedy, key="--angles", value=text) from None


def _output(
    file: ProblemFile, output: str, angles: str, design: Mapping[str, float] | None, as_json: bool, out: Path | None
) -> None:
    """Print the derivatives of an output by every dimension."""
    import numpy as np

    from optlink.problem.quantity import check_choice
    from optlink.studies.motion_sensitivity import OutputStudy, output_names
    from optlink.tasks.design import solve
    from optlink.tasks.machine import check_within_range
    from optlink.tasks.protocol import completed

    driving = file.model.driving
    check_choice("--quantity", output, output_names(file.model.linkage), "unknown output", file.file)
    if driving.mechanism.limits is not None and angles == DEFAULT_ANGLES:
        crank = np.linspace(*driving.mechanism.limits, 12)
    else:
        crank = _crank_angles(angles, driving)
    check_within_range(file, crank)
    if not design and file.model.free and file.task != "path" and file.task != "cycle":
        design = completed(solve(file)).design
    sizes = file.model.sizes(design or {})
    result = OutputStudy(file, output, sizes, crank)
    found = result.derivatives
    if out is not None:
        from optlink.io import write_json
        from optlink.presentation.files import write_csv

        write_json(out / "result.json", result.to_dict())
        columns = {f"per_{name}_SI": column for name, column in found.by.items()}
        value = f"{found.name}_{found.unit}"
        write_csv(out / "sensitivity.csv", {driving.column: driving.shown(crank), value: found.value} | columns)
    if as_json:
        console.print_json(result.to_dict())
        return
    from optlink.presentation.views.sensitivity import outputs

    console.show(outputs(result))


@study.command()
def sweep(
    problem: Problem,
    vary: Annotated[list[str] | None, option("KEY=VALUES", VARIED, "--vary")] = None,
    analyze: Annotated[bool, flag("Analyse the machine at every point, without optimisation.", "--analyze")] = False,
    simulate: Annotated[
        bool, flag("Simulate the machine at every point, with joint clearance, without optimisation.", "--simulate")
    ] = False,
    revolutions: Annotated[int | None, number("With --simulate and joint clearance: number of revolutions. Default: 20.")] = None,
    control: Annotated[str | None, option("HOW", "With --simulate, control: none, inverse, pid, inverse+pid.")] = None,
    column: Annotated[
        list[str] | None,
        option("NAME", "With --analyze: column of the analysis, or a figure such as slider.stroke_m. Repeatable.", "--column"),
    ] = None,
    points: Annotated[int | None, number("With --analyze: crank angles per revolution. Default: 360.")] = None,
    design: Annotated[
        list[str] | None,
        option("NAME=VALUE", "With --analyze: values of design variables that are not varied. Repeatable.", "--design"),
    ] = None,
    backend: Backend = "ipopt",
    engine: Engine = None,
    workers: Workers = None,
    scheduler: Scheduler = None,
    resume: Resume = False,
    changes: Set = None,
    as_json: Json = False,
    quiet: Quiet = False,
    picture: Format = "png",
    out: StudyFolder = None,
) -> None:
    """Solve, analyse or simulate a problem at every point of a grid, on one machine or a cluster; resumable."""
    from optlink.studies.sweeps import sweep as run

    file = console.load(problem, changes, definite=analyze or simulate)
    varied = {text.partition("=")[0].strip().removeprefix("mechanism.") for text in vary or []}
    values = console.given_design(file, problem, changes, design, varied) if design or analyze or simulate else None
    if column and not analyze:
        raise InputError("the option applies to an analysis", "Add --analyze", key="--column", value=column[0])
    if analyze and simulate:
        raise InputError("--analyze and --simulate exclude each other", "Give one of them", key="--simulate")
    console.refuse({} if simulate else {"--revolutions": revolutions, "--control": control}, *SIMULATED, file.file)
    if not analyze and not simulate:
        remedy = "Add --analyze; the number of swept values is part of --vary KEY=LOW..HIGH UNIT:N"
        console.refuse({"--points": points}, "the option applies to an analysis or a simulation", remedy, file.file)
    runs = console.given(revolutions=revolutions, control=control, points=points) if simulate else None
    mode: dict[str, Any] = {"analyze": analyze, "columns": column or None, "design": values, "simulate": runs}
    parallel = console.given(backend=backend, engine=engine, workers=workers, scheduler=scheduler)
    with _resuming(out, "sweep", problem, "sweeping", resume) as options:
        result = run(file, vary or [], out, points=360 if points is None else points, **mode, **parallel, **options)
    console.deliver(result, as_json, out)


@study.command()
def tolerance(
    problem: Problem,
    tolerances: Annotated[list[str] | None, option("NAME=T", DEVIATIONS, "--tolerance")] = None,
    output: Annotated[
        str | None, option("BODY|P.x|error", "Output to analyse. Default: the error of a motion law.", "--quantity")
    ] = None,
    angles: Annotated[str | None, option("LIST", 'Crank angles: "0 deg, 60 deg" or "0..330 deg:12".', "--angles")] = None,
    limit: Annotated[str | None, option("SIZE", 'Permitted error or deviation, for the yield: "0.5 deg".')] = None,
    samples: Annotated[int, number("Number of sampled linkages; 0: linear analysis only.")] = 131072,
    seed: Annotated[int, number("Seed of the samples.", metavar="S")] = 0,
    distribution: Annotated[str, option("NAME", SHAPE)] = "normal",
    allocate: Annotated[str | None, option("YIELD", 'Find the least costly tolerances that reach a yield: "99.7 %".')] = None,
    cost: Annotated[
        list[str] | None, option("NAME=C", "With --allocate: a tolerance t costs C/t. Default: 1. Repeatable.")
    ] = None,
    robust: Annotated[str | None, option("K|worst|margin|yield", ROBUST)] = None,
    engine: Engine = None,
    workers: Workers = None,
    scheduler: Scheduler = None,
    changes: Set = None,
    design: Annotated[
        list[str] | None, option("NAME=VALUE", "Design to analyse, instead of the optimum. Repeatable.", "--design")
    ] = None,
    as_json: Json = False,
    quiet: Quiet = False,
    picture: Format = "png",
    out: Annotated[Path | None, option("DIR", "Folder for result.json, table and pictures.", "-o", "--out")] = None,
) -> None:
    """Tolerance analysis: worst case, statistical scatter, yield, tolerance allocation, robust design."""
    console.places(out, "tolerance", problem)
    from optlink.studies.tolerances.analysis import tolerance as run
    from optlink.studies.tolerances.sampling import read_costs, read_sigmas, read_yield

    file = console.load(problem, changes, definite=True)
    values = None if robust is not None and not design else console.given_design(file, problem, changes, design)
    if cost and allocate is None:
        raise InputError("the option applies to --allocate only", 'Add for example --allocate "99 %"', key="--cost")
    crank = None if angles is None else _crank_angles(angles, file.model.driving)
    sampling: dict[str, Any] = {"samples": samples, "seed": seed, "shape": distribution, "design": values}
    goals: dict[str, Any] = {"target_yield": None if allocate is None else read_yield(allocate), "costs": read_costs(cost or [])}
    goals["robust"] = None if robust is None else read_sigmas(robust)
    parallel = console.given(engine=engine, workers=workers, scheduler=scheduler)
    with console.share("building") as progress:
        result = run(file, tolerances or [], output, crank, limit, progress=progress, **sampling, **goals, **parallel)
    console.deliver(result, as_json, out)


@study.command()
def pareto(
    problem: Problem,
    objectives: Annotated[str, option("A,B[,C]", OBJECTIVES_HELP, "--objectives")] = "",
    points: Annotated[int | None, number(POINTS)] = None,
    backend: Backend = "ipopt",
    engine: Engine = None,
    workers: Workers = None,
    scheduler: Scheduler = None,
    resume: Resume = False,
    changes: Set = None,
    as_json: Json = False,
    quiet: Quiet = False,
    picture: Format = "png",
    out: StudyFolder = None,
) -> None:
    """Pareto front of two or three objectives, with its ends and knee; every point is validated."""
    from optlink.studies.fronts.epsilon_constraint import pareto as run

    file = console.load(problem, changes)
    parallel = console.given(backend=backend, engine=engine, workers=workers, scheduler=scheduler)
    with _resuming(out, "pareto", problem, "computing the front", resume) as options:
        result = run(file, objectives, out, points=points, **parallel, **options)
    console.deliver(result, as_json, out)


@contextlib.contextmanager
def _resuming(out: Path | None, command: str, problem: str, what: str, resume: bool) -> Iterator[dict[str, Any]]:
    """Lock the folder of a study, provide its progress and whether it resumes, and report on interruption what is kept of it."""
    if resume and out is None:
        raise InputError("needs the folder of the run", "Add --out DIR", key="--resume")
    if out is not None and os.path.isdir(out):
        console.study_place(out, command, problem)
    try:
        with _points(what) as progress:
            yield {"resume": resume, "progress": progress}
    except KeyboardInterrupt:
        interrupts.handled()
        message = "no results were kept: --out is not given" if out is None else "completed points are kept; "
        print(f"Interrupted: {message}{'' if out is None else f'resume with --resume --out {out}'}.", file=sys.stderr)
        raise typer.Exit(130) from None


@contextlib.contextmanager
def _points(what: str) -> Iterator[Callable[[int, int], None]]:
    """Show a bar with the completed points, their rate and the remaining time on standard error."""
    from rich.progress import MofNCompleteColumn, TextColumn

    columns = MofNCompleteColumn(), TextColumn("{task.fields[rate]}")
    with console.progress_bar(*columns, what=what, total=None, rate="") as (bar, task):

        def advance(done: int, total: int) -> None:
            speed = bar.tasks[0].speed
            bar.update(task, completed=done, total=total, rate=f"{speed:z,.0f} a second" if speed else "")

        yield advance
