"""The commands `solve` and `validate`: parse, call one library function, print, exit code. They are made known by `cli`."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from optlink.cli import console
from optlink.cli.options import Backend, Design, Json, Out, Problem, Searcher, Seed, Set, Starts, whole_number
from optlink.errors import Status

if TYPE_CHECKING:
    from optlink.problem.file import ProblemFile
    from optlink.tasks.cycle_result import MachineDesign
    from optlink.tasks.function import Result
    from optlink.tasks.path_result import Generation
    from optlink.validation.check import Check


def register(app: typer.Typer) -> None:
    """Make the commands known."""
    app.command()(solve)
    app.command()(validate)


def solve(
    problem: Problem,
    backend: Searcher = Backend.ipopt,
    starts: Starts = None,
    seed: Seed = 0,
    designs: Annotated[
        int | None, typer.Option(parser=whole_number, metavar="N", help="Of points or poses: distinct designs; 3 if not said.")
    ] = None,
    changes: Set = None,
    design: Design = None,
    as_json: Json = False,
    out: Out = None,
) -> None:
    """Find the design, prove it, and say what each active limit costs."""
    with console.reported(as_json), console.made(out, "solve", problem):
        if design:
            _validate(problem, design, changes, as_json, out)
            return
        file = console.load(problem, changes)
        if file.generated:
            _generate(file, backend, starts, seed, 3 if designs is None else designs, as_json, out)
            return
        if file.machined and designs is None:
            _design(file, backend, starts, seed, as_json, out)
            return
        remedy = "Leave it out; --starts N lists the distinct optima of a law"
        console.refuse({"--designs": designs}, "only points and poses have several designs", remedy, file.file)
        from optlink.tasks.function import solve as search

        modes = 2 if file.spec.mechanism.assembly == "either" else 1
        with console.counted((1 if starts is None else starts) * _searches(backend) * modes) as progress:
            result = search(file, str(backend), starts, seed, progress, track=out is not None)
        if result.interrupted:
            _interrupted(result.starts, None if starts is None else starts * modes)
        _law(result, as_json, out)


def validate(problem: Problem, design: Design = None, changes: Set = None, as_json: Json = False, out: Out = None) -> None:
    """Prove a given design, or show where it fails."""
    with console.reported(as_json), console.made(out, "validate", problem):
        _validate(problem, design or [], changes, as_json, out)


def _validate(problem: str, design: list[str], changes: list[str] | None, as_json: bool, out: Path | None) -> None:
    from optlink.tasks.function import read_design
    from optlink.tasks.function import validate as prove

    file = console.load(problem, changes)
    given = read_design(file, design)
    if file.generated:
        from optlink.tasks.path import validate as check

        found = check(file, given)
        failed = _contradictions(design, file, found)
        if failed:
            flagged = [
                replace(d, validation=replace(d.validation, checks=(*d.validation.checks, *failed))) for d in found.designs
            ]
            found = replace(found, designs=(), nearest=next(iter(flagged), found.nearest))
        _generated(found, as_json, out)
        if failed:
            raise typer.Exit(1)
        return
    if file.machined:
        from optlink.tasks.cycle import check_machine

        machine = check_machine(file, given)
        proof = machine.validation
        failed = _contradictions(design, file, machine)
        _machine(replace(machine, validation=replace(proof, checks=(*proof.checks, *failed))), as_json, out)
        return
    law = prove(file, given)
    failed = _contradictions(design, file, law)
    _law(replace(law, validation=replace(law.validation, checks=(*law.validation.checks, *failed))), as_json, out)


def _contradictions(design: list[str], file: ProblemFile, found: Result | Generation | MachineDesign) -> tuple[Check, ...]:
    """What a result file that is the design says and its design does not have; a file of another problem is named."""
    from optlink.validation.consistency import contradictions

    failed: list[Check] = []
    for text in (text for text in design if text.endswith(".json")):
        document = json.loads(Path(text).read_text(encoding="utf-8"))
        if document.get("problem_hash", file.hash) != file.hash:
            message = f"{text}: this is the result of another problem, or of this one before it was changed"
            print(f"Warning: {message} (problem_hash {document['problem_hash']}, here {file.hash})", file=sys.stderr)
        elif len(design) == 1:
            failed += contradictions(document, found.to_dict())
    return tuple(failed)


# --- searches ----------------------------------------------------------------------------------------------------------------


def _searches(backend: Backend) -> int:
    """How many solvers search from every start."""
    return 2 if backend is Backend.both else 1


def _interrupted(done: int, wanted: int | None = None) -> None:
    of = "" if wanted is None else f"of {wanted} "
    print(f"Interrupted: the result is that of the first {done} {of}starts.", file=sys.stderr)


def _generate(
    file: ProblemFile, backend: Backend, starts: int | None, seed: int, designs: int, as_json: bool, out: Path | None
) -> None:
    """Find linkages for points or poses."""
    from optlink.tasks.path import generate

    with console.share("searching") as progress:
        result = generate(file, str(backend), starts, seed, designs, progress)
    if result.interrupted:
        _interrupted(result.starts)
    _generated(result, as_json, out)


def _design(file: ProblemFile, backend: Backend, starts: int | None, seed: int, as_json: bool, out: Path | None) -> None:
    """Design a machine by its cycle."""
    from optlink.solvers.cycle_search import STARTS
    from optlink.tasks.cycle import design_machine

    with console.counted(STARTS if starts is None else starts) as progress:
        result = design_machine(file, str(backend), starts, seed, progress)
    if starts is not None and result.interrupted:
        _interrupted(result.starts, starts)
    _machine(result, as_json, out)


# --- results -----------------------------------------------------------------------------------------------------------------


def _law(result: Result, as_json: bool, out: Path | None) -> None:
    """Show a linkage for a motion law that was found, or checked."""
    console.told(result, "views.function_tables.result", "views.function_pictures", None, as_json, out)
    _end(result.status, result.valid)


def _generated(result: Generation, as_json: bool, out: Path | None) -> None:
    """Show linkages that were found, or checked."""
    console.told(result, "views.path_tables.generation", "views.path_pictures", None, as_json, out)
    if not result.valid:
        raise typer.Exit(1)


def _machine(result: MachineDesign, as_json: bool, out: Path | None) -> None:
    """Show a machine that was designed by its cycle, or checked."""
    console.told(result, "views.cycle_tables.machine_design", "views.cycle_pictures", None, as_json, out)
    _end(result.status, result.valid)


def _end(status: Status, valid: bool) -> None:
    """The exit code of a search."""
    if status in (Status.STALLED, Status.NON_FINITE):
        raise typer.Exit(3)
    if not valid:
        raise typer.Exit(1)
