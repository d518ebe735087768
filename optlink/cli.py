"""The command line: parse, call one library function, print, exit code.

0: done and valid. 1: solved, but not valid or not feasible. 2: bad input. 3: the solver failed.
"""

from __future__ import annotations

import contextlib
import enum
import functools
import importlib
import io
import json
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from optlink import page_command, study_command
from optlink.errors import InputError, OptlinkError, Status, shown

if TYPE_CHECKING:
    from optlink.design.files import ProblemFile
    from optlink.generation import Generation
    from optlink.machine_design import MachineDesign
    from optlink.workflow import Result


class Backend(enum.StrEnum):
    """Which solver searches."""

    slsqp = "slsqp"
    ipopt = "ipopt"
    both = "both"


def _whole_number(text: object) -> int:
    try:
        return int(str(text))
    except ValueError:
        raise typer.BadParameter(f'"{str(text)[:40]}" is not a whole number. Give for example 20') from None


app = typer.Typer(
    name="optlink",
    help="State a planar linkage and what it must do; get a design that is optimal, verified and explained.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)

_printed = False

Problem = Annotated[str, typer.Argument(metavar="PROBLEM", help="A shipped problem (see `list`) or the path of a TOML file.")]
Set = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="KEY=VALUE", help='Change a key: --set mechanism.frame="480 mm". Repeatable.'),
]
Json = Annotated[bool, typer.Option("--json", help="One JSON document on standard output and nothing else.")]
Out = Annotated[Path | None, typer.Option("--out", metavar="DIR", help="Write result.json, pictures and tables there.")]
Csv = Annotated[Path | None, typer.Option("--csv", metavar="FILE", help="Write the whole table there.")]
Speed = Annotated[
    str | None, typer.Option("--speed", metavar="SPEED", help='Of the crank: --speed "64 rpm"; negative: clockwise.')
]
Design = Annotated[
    list[str] | None,
    typer.Option(
        "--design",
        metavar="NAME=VALUE",
        help='A given design: --design coupler="412 mm", or a result.json. Repeatable.',
    ),
]


@contextlib.contextmanager
def _reported(as_json: bool) -> Iterator[None]:
    """Turn an error that optlink raises on purpose into a message on standard error (and JSON, if asked) and its exit code."""
    try:
        yield
    except OptlinkError as error:
        faults = error.faults if isinstance(error, InputError) else ()
        for line in [str(fault) for fault in faults] or [str(error)]:
            print(f"Error: {line}", file=sys.stderr)
        if as_json:
            listed = [
                {key: item if item is None or isinstance(item, str) else shown(item) for key, item in vars(fault).items()}
                for fault in faults
            ]
            _print_json({"schema": "optlink/error/1", "status": "error", "message": str(error), "faults": listed})
        raise typer.Exit(error.exit_code) from None


def _print_json(document: dict[str, Any]) -> None:
    global _printed  # noqa: PLW0603 - whether the one document is out
    _printed = True
    print(json.dumps(document, indent=2))


def _load(problem: str, changes: list[str] | None) -> ProblemFile:
    from optlink.design.files import load, parse_assignment

    return load(problem, dict(parse_assignment(text) for text in changes or []))


def _finish(result: Result, as_json: bool, out: Path | None) -> None:
    if out is not None:
        from optlink.report.plot import write_all

        with _working(f"Drawing into {out}"):
            write_all(result, out)
    if as_json:
        _print_json(result.to_dict())
    else:
        from optlink.report import terminal

        terminal.console().print(terminal.result(result))
    if result.status in (Status.STALLED, Status.NON_FINITE):
        raise typer.Exit(3)
    if not result.valid:
        raise typer.Exit(1)


@contextlib.contextmanager
def _working(what: str) -> Iterator[None]:
    from optlink.report import terminal

    with terminal.console(stderr=True).status(what):
        yield


@contextlib.contextmanager
def _progress(total: int) -> Iterator[Callable[[int], None] | None]:
    """A bar with rate and time left on standard error, for work of more than a few starts."""
    if total < 8:
        yield None
        return
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    from optlink.report import terminal

    columns = (TextColumn("searching"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    console = terminal.console(stderr=True)
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task("starts", total=total)
        yield lambda done: bar.update(task, completed=done)


@app.command("list")
def list_problems(as_json: Json = False) -> None:
    """Shipped problems: name, kind, one line."""
    with _reported(as_json):
        from optlink.design.files import load, shipped

        files = [load(name) for name in shipped()]
        if as_json:
            rows = [{"name": f.name, "kind": f.kind, "title": f.model.title} for f in files]
            _print_json({"schema": "optlink/list/1", "problems": rows})
            return
        from optlink.report import terminal

        terminal.console().print(terminal.listing(files))


@app.command()
def show(
    problem: Problem,
    changes: Set = None,
    as_toml: Annotated[bool, typer.Option("--toml", help="As a problem file, to begin your own with.")] = False,
    as_json: Json = False,
) -> None:
    """The problem in full, with units and defaults."""
    with _reported(as_json):
        file = _load(problem, changes)
        if as_json:
            _print_json({"schema": "optlink/problem/1", "name": file.name, "problem_hash": file.hash, "problem": dict(file.raw)})
            return
        if as_toml:
            from optlink.design.files import dump

            print(dump(file), end="")
            return
        from optlink.report import terminal

        terminal.console().print(terminal.problem(file))


@app.command()
def solve(
    problem: Problem,
    backend: Annotated[Backend, typer.Option(help="Both: each searches for itself, and they must agree.")] = Backend.ipopt,
    starts: Annotated[
        int | None,
        typer.Option(
            parser=_whole_number,
            metavar="N",
            help="Number of starts. Of a law: the given one (the default) and Sobol points; of points: as many as it takes.",
        ),
    ] = None,
    seed: Annotated[int, typer.Option(parser=_whole_number, metavar="S", help="Seed of the starts.")] = 0,
    designs: Annotated[
        int | None, typer.Option(parser=_whole_number, metavar="N", help="Of points or poses: distinct designs; 3 if not said.")
    ] = None,
    changes: Set = None,
    design: Design = None,
    as_json: Json = False,
    out: Out = None,
) -> None:
    """Find the design, prove it, and say what each active limit costs."""
    with _reported(as_json), _made(out):
        if design:
            _validate(problem, design, changes, as_json, out)
            return
        file = _load(problem, changes)
        if file.generated:
            _generate(file, str(backend), starts, seed, 3 if designs is None else designs, as_json, out)
            return
        if file.machined and designs is None:
            _design(file, backend, starts, seed, as_json, out)
            return
        if designs is not None:
            from optlink.errors import Fault

            remedy = "Leave it out; --starts N lists the distinct optima of a law"
            raise InputError(Fault("only points and poses have several designs", remedy, file.file, "--designs", designs))
        from optlink.workflow import solve as search

        searches = (1 if starts is None else starts) * (2 if backend is Backend.both else 1)
        with _progress(searches) as progress:
            result = search(file, str(backend), starts, seed, progress, track=out is not None)
        if starts is not None and result.starts < starts:
            print(f"Interrupted: the result is that of the first {result.starts} of {starts} starts.", file=sys.stderr)
        _finish(result, as_json, out)


def _generate(
    file: ProblemFile, backend: str, starts: int | None, seed: int, designs: int, as_json: bool, out: Path | None
) -> None:
    """Find linkages for points or poses."""
    from optlink.generation import generate

    with _share("searching") as progress:
        result = generate(file, backend, starts, seed, designs, progress)
    if result.interrupted:
        print(f"Interrupted: the result is that of the first {result.starts} starts.", file=sys.stderr)
    _generated(result, as_json, out)


def _generated(result: Generation, as_json: bool, out: Path | None) -> None:
    """Show linkages that were found, or checked."""
    _told(result, "designs.generation", "paths", None, as_json, out)
    if not result.valid:
        raise typer.Exit(1)


def _design(file: ProblemFile, backend: Backend, starts: int | None, seed: int, as_json: bool, out: Path | None) -> None:
    """Design a machine by its cycle."""
    from optlink.machine_design import STARTS, design_machine

    searches = (STARTS if starts is None else starts) * (2 if backend is Backend.both else 1)
    with _progress(searches) as progress:
        result = design_machine(file, str(backend), starts, seed, progress)
    if starts is not None and result.starts < starts and not result.notes:
        print(f"Interrupted: the result is that of the first {result.starts} of {starts} starts.", file=sys.stderr)
    _machine(result, as_json, out)


def _machine(result: MachineDesign, as_json: bool, out: Path | None) -> None:
    """Show a machine that was designed by its cycle, or checked."""
    _told(result, "improved.machine_design", "improvement", None, as_json, out)
    if result.status in (Status.STALLED, Status.NON_FINITE):
        raise typer.Exit(3)
    if not result.valid:
        raise typer.Exit(1)


@app.command()
def validate(problem: Problem, design: Design = None, changes: Set = None, as_json: Json = False, out: Out = None) -> None:
    """Prove a given design, or show where it fails."""
    with _reported(as_json), _made(out):
        _validate(problem, design or [], changes, as_json, out)


def _validate(problem: str, design: list[str], changes: list[str] | None, as_json: bool, out: Path | None) -> None:
    from optlink.workflow import read_design
    from optlink.workflow import validate as prove

    file = _load(problem, changes)
    given = read_design(file, design)
    if file.generated:
        from optlink.generation import validate as check

        _generated(check(file, given), as_json, out)
        return
    if file.machined:
        from optlink.machine_design import check_machine

        _machine(check_machine(file, given), as_json, out)
        return
    _finish(prove(file, given), as_json, out)


@app.command()
def analyze(
    problem: Problem,
    points: Annotated[int, typer.Option(parser=_whole_number, metavar="N", help="Steps of the table per revolution.")] = 360,
    step: Annotated[str | None, typer.Option(metavar="ANGLE", help='Instead of --points: --step "5 deg".')] = None,
    speed: Annotated[
        str | None, typer.Option(metavar="SPEED", help='Of the crank: --speed "64 rpm"; negative: clockwise.')
    ] = None,
    changes: Set = None,
    design: Design = None,
    csv: Csv = None,
    as_json: Json = False,
    out: Out = None,
) -> None:
    """Motion, joint reactions, driving torque and work over the cycle."""
    with _reported(as_json):
        from optlink.analysis import analyze as run
        from optlink.workflow import read_design

        file = _load(problem, changes)
        given = read_design(file, design) if design else None
        _places(csv, out)
        result = run(file, points, _quantity(step, "angle", "--step"), _quantity(speed, "angular velocity", "--speed"), given)
        _told(result, "machine.analysis", "cycle", csv, as_json, out)
        if not result.sound:
            raise typer.Exit(1)


@app.command()
def balance(
    problem: Problem,
    minimise: Annotated[
        str | None, typer.Option(metavar="MEASURE", help='In place of the problem\'s: "rms force", "largest reaction at D".')
    ] = None,
    trade: Annotated[
        str | None, typer.Option(metavar="A,B", help="The curve between two measures: --trade force,torque.")
    ] = None,
    points: Annotated[int, typer.Option(parser=_whole_number, metavar="N", help="Of that curve.")] = 25,
    changes: Set = None,
    csv: Csv = None,
    as_json: Json = False,
    out: Out = None,
) -> None:
    """Counterweights and springs that make shaking, torque or reactions least: proven, verified and priced."""
    with _reported(as_json):
        from optlink.balancing import balance as run

        file = _load(problem, changes)
        _places(csv, out)
        with _share("balancing") as progress:
            result = run(file, minimise, trade, points, progress)
        _told(result, "balance.balance", "counterweights", csv, as_json, out)
        if not result.valid:
            raise typer.Exit(3 if result.status == "stalled" else 1)


@app.command()
def simulate(
    problem: Problem,
    duration: Annotated[str | None, typer.Option(metavar="TIME", help='--duration "2 s"; that of the problem else.')] = None,
    points: Annotated[
        int | None,
        typer.Option(parser=_whole_number, metavar="N", help="Steps of the table: 1000, with clearance 360 a revolution."),
    ] = None,
    speed: Speed = None,
    torque: Annotated[str | None, typer.Option(metavar="TORQUE", help='A constant driving torque: --torque "5 N*m".')] = None,
    flywheel: Annotated[str | None, typer.Option(metavar="J", help='At the crank: --flywheel "0.2 kg*m^2".')] = None,
    revolutions: Annotated[
        int | None, typer.Option(parser=_whole_number, metavar="N", help="With clearance: how many; 20 if not said.")
    ] = None,
    control: Annotated[
        str | None,
        typer.Option(metavar="HOW", help="With clearance: none, inverse, pid, inverse+pid; compare: all, from several starts."),
    ] = None,
    starts: Annotated[
        int, typer.Option(parser=_whole_number, metavar="N", help="With --control compare: number of crank angles at the start.")
    ] = 5,
    seed: Annotated[int, typer.Option(parser=_whole_number, metavar="S", help="Of these crank angles.")] = 0,
    tolerance: Annotated[float, typer.Option(metavar="X", help="With clearance: relative, of the integrator.")] = 1e-10,
    resume: Annotated[
        bool, typer.Option("--resume", help="With clearance: go on with the run that was interrupted in --out DIR.")
    ] = False,
    ideal: Annotated[bool, typer.Option("--ideal", help="As if no joint had clearance.")] = False,
    changes: Set = None,
    design: Design = None,
    csv: Csv = None,
    as_json: Json = False,
    out: Out = None,
) -> None:
    """Motion in time, under a torque or at a constant speed; with clearance in joints, and control, if the problem has them."""
    with _reported(as_json):
        from optlink.workflow import read_design

        file = _load(problem, changes)
        if torque is not None:
            file = file.override({"drive.torque": torque, "drive.servo": None})
        given = read_design(file, design) if design else None
        loose = file.model.loose and not ideal
        for option, value in {"--revolutions": revolutions, "--control": control}.items():
            if value is not None and not loose:
                from optlink.errors import Fault

                gap = "joints.B={ clearance = '0.5 mm', bearing_radius = '10 mm', modulus = '207 GPa' }"
                remedy = "Leave --ideal out" if ideal else f'Give one: --set "{gap}"'
                message = "joints count as ideal" if ideal else "no joint has clearance"
                raise InputError(Fault(f"{message}, so the option does nothing", remedy, file.file, option, str(value)))
        _places(csv, out)
        rate = _quantity(speed, "angular velocity", "--speed")
        span = _quantity(duration, "time", "--duration")
        wheel = _quantity(flywheel, "moment of inertia", "--flywheel") or 0.0
        if not loose:
            from optlink.simulation import simulate as run

            with _share("simulating") as progress:
                result = run(file, span, 1000 if points is None else points, rate, given, progress, wheel)
            _told(result, "machine.simulation", "course", csv, as_json, out)
            if not result.finished:
                raise typer.Exit(3 if result.run.ending.value == "stalled" else 1)
            return
        turns = _revolutions(file, revolutions, span, rate)
        if control == "compare":
            _compare(file, turns, rate, starts, seed, given, as_json, out)
            return
        from optlink.clearances import simulate_clearance
        from optlink.report.store import checkpoint, write_json

        begun = checkpoint(out) if resume else None
        done = 0 if begun is None else int(begun.get("revolutions", 0)) * int(begun.get("points", 0))
        with _streamed(csv, done) as stream, _share("simulating") as progress:
            found = simulate_clearance(
                file,
                turns,
                360 if points is None else points,
                rate,
                control or "none",
                design=given,
                flywheel=wheel,
                tolerance=tolerance,
                progress=progress,
                stream=stream,
                checkpoint=None if out is None else functools.partial(write_json, out / "checkpoint.json"),
                resume=begun,
            )
        _told(found, "loose.simulation", "play", None, as_json, out)
        if not found.finished:
            raise typer.Exit(3 if found.ending.value == "stalled" else 1)


def _compare(
    file: ProblemFile,
    revolutions: int,
    speed: float | None,
    starts: int,
    seed: int,
    given: dict[str, float] | None,
    as_json: bool,
    out: Path | None,
) -> None:
    """All kinds of control in one table."""
    from optlink.compensation import compare

    with _share("simulating") as progress:
        found = compare(file, revolutions, starts, seed, speed=speed, design=given, progress=progress)
    if out is not None:
        from optlink.report.play import write_comparison

        with _working(f"Drawing into {out}"):
            write_comparison(found, out)
    if as_json:
        _print_json(found.to_dict())
    else:
        from optlink.report import loose, terminal

        terminal.console().print(loose.comparison(found))
    if not found.finished:
        raise typer.Exit(3)


def _revolutions(file: ProblemFile, revolutions: int | None, duration: float | None, speed: float | None) -> int:
    """How many revolutions are asked for."""
    if revolutions is not None and duration is not None:
        from optlink.errors import Fault

        raise InputError(Fault("revolutions and a duration are given", "Give one of the two", key="--duration"))
    if duration is None and revolutions is None and file.model.drive.duration is not None:
        duration = file.model.drive.duration.value
    if duration is None:
        return 20 if revolutions is None else revolutions
    import math

    period = 2.0 * math.pi / abs(speed or file.model.drive.speed.value)
    return max(1, math.ceil(duration / period * (1.0 - 1e-9)))


@contextlib.contextmanager
def _streamed(csv: Path | None, done: int) -> Iterator[Any]:
    """A table that is written while the work goes on."""
    if csv is None:
        yield None
        return
    from optlink.report.store import stream

    with stream(csv, done) as rows:
        yield rows


def _told(result: Any, table: str, files: str, csv: Path | None, as_json: bool, out: Path | None) -> None:
    """Write a result where it is wanted, and show it as JSON or as a table; its `files` are those of a module of the report."""
    if csv is not None:
        from optlink.report.store import write_csv

        write_csv(csv, result.columns)
    if out is not None:
        with _working(f"Drawing into {out}"):
            importlib.import_module(f"optlink.report.{files}").write_all(result, out)
    if as_json:
        _print_json(result.to_dict())
    else:
        from optlink.report import terminal

        room, _, name = table.rpartition(".")
        terminal.console().print(getattr(importlib.import_module(f"optlink.report.{room}"), name)(result))


@contextlib.contextmanager
def _share(what: str) -> Iterator[Callable[[float], None]]:
    """A bar with the time left on standard error."""
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    from optlink.report import terminal

    columns = (TextColumn(what), BarColumn(), TextColumn("{task.percentage:>3.0f} %"), TimeRemainingColumn())
    console = terminal.console(stderr=True)
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task(what, total=1.0)
        yield lambda share: bar.update(task, completed=share)


def _quantity(text: str | None, kind: str, option: str) -> float | None:
    """An option that is a number with a unit."""
    if text is None:
        return None
    from optlink.errors import Fault
    from optlink.units import UnitProblem, parse

    try:
        return parse(text, kind)[0]
    except UnitProblem as error:
        raise InputError(Fault(error.message, error.remedy, key=option, value=text)) from None


def _places(csv: Path | None, out: Path | None) -> None:
    """Make sure that results can be written before any work is done."""
    if csv is not None and csv.is_dir():
        from optlink.errors import Fault

        raise InputError(
            Fault("this is a folder", "Give the name of a file, for example motion.csv", key="--csv", value=str(csv))
        )
    if out is not None:
        _folder(out)
    if csv is not None:
        _folder(csv.parent, "--csv")


@contextlib.contextmanager
def _made(out: Path | None) -> Iterator[None]:
    """The folder of the results; gone again where it is new and the input is refused."""
    new = [] if out is None else [place for place in (out, *out.parents) if not place.exists()]
    if out is not None:
        _folder(out)
    try:
        yield
    except InputError:
        for place in new:
            with contextlib.suppress(OSError):
                place.rmdir()
        raise


def _folder(out: Path, option: str = "--out") -> None:
    from optlink.report.store import folder

    folder(out, option)


page_command.register(app)
study_command.register(app)


def _version(wanted: bool) -> None:
    if wanted:
        from optlink import __version__

        print(f"optlink {__version__}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[bool, typer.Option("--version", callback=_version, is_eager=True, help="Show the version.")] = False,
) -> None:
    """Planar linkage design optimisation."""


def main() -> None:
    """Entry point of the `optlink` command."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")  # a terminal that lacks a letter is no reason to break down
    try:
        app()
    except SystemExit as end:
        if end.code == 2 and "--json" in sys.argv and not _printed:
            message = "the command line cannot be used; the reason is on standard error"
            _print_json({"schema": "optlink/error/1", "status": "error", "message": message, "faults": []})
        raise


if __name__ == "__main__":
    main()
