"""The commands `solve`, `validate`, `analyze` and `balance`: parse, call one library function, print, exit code."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from optlink.cli import console
from optlink.cli.options import (
    Csv,
    Design,
    Engine,
    Film,
    Format,
    Json,
    Out,
    Problem,
    Quiet,
    Scheduler,
    Searcher,
    Seed,
    Set,
    Speed,
    Starts,
    flag,
    number,
    option,
    share_number,
)
from optlink.errors import InputError

if TYPE_CHECKING:
    from optlink.problem.file import ProblemFile
    from optlink.tasks.results.common import DesignResult
    from optlink.validation.check import Check

CERTIFY = (
    "Prove that no better design exists within the bounds, or find it. Default: motion laws of at most two design variables."
)
WORKERS = (
    "Processes that share a long search or proof (not the proof of a largest error, which uses one); if given, also a short "
    "search. Default: all cores."
)
GAP = "--certify: largest gap between design and lower bound, as a share of the objective. Default: 1e-6."
ROUND = (
    'Step of all free lengths, such as "0.1 mm", or NAME=STEP, or a stock of sizes, NAME=["50 mm", "60 mm"]; repeatable. '
    "The design has such sizes, and is validated with them. Default: [rounding] of the file; none: without rounding."
)
ALL = (
    "List all exact solutions of five poses, timed points or points of a function, of nine points, or of poses and points, each "
    "with what excludes it; of four poses the best ones."
)
BY = (
    '--all: quantity that ranks them, such as "total length". Default: that of the objective of the file; without one, the '
    "transmission angle."
)
DETAILS = "Print all checks, tables and times too; JSON and page always have them. A failed check is always printed."


def solve(
    problem: Problem,
    backend: Searcher = "ipopt",
    starts: Starts = None,
    seed: Seed = 0,
    designs: Annotated[int | None, number("Path and motion problems: number of distinct designs. Default: 3.")] = None,
    certify: Annotated[bool | None, flag(CERTIFY, "--certify/--no-certify")] = None,
    gap: Annotated[float | None, option("SHARE", GAP, "--gap", parser=share_number)] = None,
    time_limit: Annotated[
        str | None, option("TIME", '--certify: time for the proof, such as "5 min". Default: none.', "--time-limit")
    ] = None,
    engine: Engine = None,
    workers: Annotated[int | None, number(WORKERS, "--workers")] = None,
    scheduler: Scheduler = None,
    rounding: Annotated[list[str] | None, option("STEP", ROUND, "--round")] = None,
    every: Annotated[bool, flag(ALL, "--all")] = False,
    by: Annotated[str | None, option("MEASURE", BY, "--by")] = None,
    changes: Set = None,
    design: Design = None,
    details: Annotated[bool, flag(DETAILS, "--details")] = False,
    as_json: Json = False,
    quiet: Quiet = False,
    picture: Format = "png",
    film: Film = False,
    out: Out = None,
) -> None:
    """Optimise a design, verify it independently, and report the shadow prices of the active constraints."""
    console.places(out, "solve", problem)
    limits: dict[str, object] = {"--gap": gap, "--time-limit": time_limit}
    where: dict[str, object] = {"--engine": engine, "--workers": workers, "--scheduler": scheduler}
    steps = " ".join(rounding or ()) or None
    if design:
        console.refuse(
            {"--all": every, "--by": by, "--certify": certify, "--round": steps} | limits | where,
            "a given design is validated, not optimised",
            "Leave it out",
        )
        _validate(problem, design, changes, as_json, out, details=details)
        return
    from optlink.tasks.results.certificate import GLOBAL_GAP, share_text
    from optlink.tasks.run import design_task, solve as search

    file = console.load(problem, changes)
    if every:
        from optlink.tasks.exact import exact

        searched = {"--certify": certify, "--round": steps, "--starts": starts, "--designs": designs}
        console.refuse(searched | limits | where, "exact solutions are listed without a search", "Leave it out", file.file)
        console.deliver(exact(file, by), as_json, out)
        return
    console.refuse({"--by": by}, "only listed exact solutions are ranked by a quantity", "Add --all, or leave it out", file.file)
    if not (_automatic(file) if certify is None else certify):
        task = design_task(file)
        remedy = "Add --certify, or leave it out" if certify is None and task.certifies(file) else "Leave it out"
        if not task.divisible:
            console.refuse(where, "only multistart searches and certificates use several processes", remedy, file.file)
        console.refuse(limits, "the option applies to a certificate of the global optimum only", remedy, file.file)
    seconds = console.quantity(time_limit, "time", "--time-limit")
    rounds = steps or file.raw.get("rounding")
    with console.share("" if rounds else "searching", said=bool(rounds)) as shared, console.share("proving") as proving:
        progress = shared if shared is None or not rounds else partial(_in_halves, shared)
        options = console.given(engine=engine, workers=workers, scheduler=scheduler, rounding=_steps(rounding))
        options |= {"gap": GLOBAL_GAP if gap is None else gap, "time_limit": math.inf if seconds is None else seconds}
        options["proving"] = proving and (lambda share, gap: proving(share, f", gap {share_text(gap)}"))
        result = search(file, backend, starts, seed, progress, designs=designs, track=out is not None, certify=certify, **options)
    if result.interrupted:
        print(f"Interrupted: {_interrupted(result)}.", file=sys.stderr)
    console.deliver(result, as_json, out, details=details)


def _in_halves(progress: Callable[..., None], done: float) -> None:
    """Show the progress of a search, the first half, and of the rounding of what it found."""
    progress(done, "searching" if done < 0.5 else "rounding the sizes; Ctrl-C keeps the best ones so far")


def _steps(rounding: list[str] | None) -> str | dict[str, object] | None:
    """Return what --round states: one step of all sizes, or by the name of the size, with `step` for all others."""
    from optlink.problem.assignment import parse_assignments

    if not rounding:
        return None
    steps = [text for text in rounding if "=" not in text]
    if len(steps) > 1:
        remedy = "Give one, and those of single sizes as NAME=STEP"
        raise InputError("there are two steps for all sizes", remedy, key="--round", value=steps[1])
    named = parse_assignments([text for text in rounding if "=" in text], "--round")
    return {**({"step": steps[0]} if steps else {}), **named} if named else steps[0]


def _automatic(file: ProblemFile) -> bool:
    """Return whether the optimum of a problem is certified by default; see `optlink.tasks.certify.automatic`."""
    from optlink.tasks.run import design_task

    if not design_task(file).certifies(file):
        return False
    from optlink.tasks.certify import automatic

    return automatic(file)


def validate(
    problem: Problem,
    design: Design = None,
    changes: Set = None,
    as_json: Json = False,
    quiet: Quiet = False,
    picture: Format = "png",
    film: Film = False,
    out: Out = None,
) -> None:
    """Check a design against all requirements and limits."""
    console.places(out, "validate", problem)
    _validate(problem, design or [], changes, as_json, out)


def _validate(
    problem: str, design: list[str], changes: list[str] | None, as_json: bool, out: Path | None, *, details: bool = True
) -> None:
    from optlink.tasks.run import read_design, validate as check

    file = console.load(problem, changes)
    own = None if design else console.given_design(file, problem, changes, design)
    if own is not None:  # the file of the result is compared with what is measured
        design = [str(Path(problem) / "result.json" if Path(problem).is_dir() else problem)]
    values = read_design(file, design) if own is None else own
    hashes = [document.get("problem_hash") for _, document in _documents(design)]
    file = next((mode for mode in file.variants() if mode.hash in hashes), file)  # of a result file
    result = check(_in_mode(file, design), values)
    failed = _contradictions(design, file, result)
    console.deliver(result.with_checks(failed) if failed else result, as_json, out, details=details)


def _in_mode(file: ProblemFile, design: list[str]) -> ProblemFile:
    """Return a problem that leaves its assembly mode open in the mode of a result file: its mirror image may do as well."""
    for _, document in _documents(design)[:1]:
        designs = document.get("designs")
        best = designs[0] if isinstance(designs, list) and designs and isinstance(designs[0], dict) else document
        return file.variant(best.get("assembly")) or file
    return file


def _documents(design: list[str]) -> list[tuple[str, dict[str, Any]]]:
    """Return the result files used as the design, with their names."""
    return [(text, json.loads(Path(text).read_text(encoding="utf-8"))) for text in design if text.endswith(".json")]


def _contradictions(design: list[str], file: ProblemFile, result: DesignResult) -> tuple[Check, ...]:
    """Check a result file used as the design against the recomputed result; report a file of another problem."""
    from optlink.validation.consistency import contradictions

    failed: list[Check] = []
    for text, document in _documents(design):
        if document.get("problem_hash", file.hash) != file.hash:
            message = f"{text}: this is the result of another problem, or of this one before it was changed"
            print(f"Warning: {message} (problem_hash {document['problem_hash']}, here {file.hash})", file=sys.stderr)
        elif len(design) == 1:
            failed += contradictions(document, result.to_dict())
    return tuple(failed)


def _interrupted(result: DesignResult) -> str:
    """Describe what an interrupted search or proof has reached."""
    from optlink.tasks.results.certificate import NOT_CLOSED
    from optlink.units import count_noun

    if "rounding" in result.seconds:
        found = getattr(result, "rounding", None)
        return f"the sizes are {'not rounded' if found is None else 'the best ones found on the grid so far'}"
    if (certificate := result.certificate) is not None:
        finding = certificate.text.removeprefix(f"{NOT_CLOSED}: ")
        complete = "complete" if certificate.closed else "incomplete"
        return f"the design is complete, the proof that it is the global optimum is {complete}: {finding}"
    if "certify" in result.seconds:
        return "the design is complete, the proof that it is the global optimum had not begun"
    return f"the result is that of the first {count_noun(result.starts, 'start')}"


def analyze(
    problem: Problem,
    points: Annotated[int | None, number("Steps of the table per revolution. Default: 360.")] = None,
    step: Annotated[str | None, option("ANGLE", 'Step of the table, instead of --points: --step "5 deg".')] = None,
    speed: Speed = None,
    changes: Set = None,
    design: Design = None,
    csv: Csv = None,
    as_json: Json = False,
    quiet: Quiet = False,
    picture: Format = "png",
    film: Film = False,
    out: Out = None,
) -> None:
    """Analyse a machine: motion, joint reactions, driving torque and work over the cycle."""
    from optlink.tasks.analyze import analyze as run

    if step is not None:
        console.refuse({"--points": points}, "--step sets the rows of the table", "Give one of the two")
    file = console.load(problem, changes, definite=True)
    values = console.given_design(file, problem, changes, design)
    console.places(out, "analyze", problem, csv)
    turn, rate = console.quantity(step, "angle", "--step"), console.quantity(speed, "angular velocity", "--speed")
    result = run(file, step=turn, speed=rate, design=values, **console.given(points=points))
    console.deliver(result, as_json, out, csv)


MINIMISED = 'Term to minimise, instead of the objective of the problem: "rms force", "peak reaction at D".'


def balance(
    problem: Problem,
    minimise: Annotated[str | None, option("MEASURE", MINIMISED)] = None,
    trade: Annotated[str | None, option("A,B", "Compute the trade-off between two terms: --trade force,torque.")] = None,
    points: Annotated[int, number("Points of the trade-off.")] = 25,
    changes: Set = None,
    design: Design = None,
    csv: Csv = None,
    as_json: Json = False,
    quiet: Quiet = False,
    picture: Format = "png",
    film: Film = False,
    out: Out = None,
) -> None:
    """Optimise counterweights and springs: least shaking force, torque or reactions, with a lower bound and shadow prices."""
    from optlink.tasks.balance import balance as run

    file = console.load(problem, changes, definite=True)
    values = console.given_design(file, problem, changes, design)
    console.places(out, "balance", problem, csv)
    with console.share("balancing") as progress:
        result = run(file, minimise, trade, points, progress, values)
    console.deliver(result, as_json, out, csv)
