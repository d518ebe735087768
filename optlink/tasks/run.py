"""Solve or check a design problem of any kind: the one entry for every requirement, objective and balancing task."""

from __future__ import annotations

import contextlib
import json
import math
from collections.abc import Collection, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Unpack, cast, overload

from optlink.errors import OPTIONS_NAMED, InputError
from optlink.execution.options import Execution
from optlink.io import checked
from optlink.linkage.fourbar import LENGTHS
from optlink.problem.arguments import typed
from optlink.problem.assignment import parse_assignments
from optlink.problem.file import AnyProblem, ProblemFile, problem_of
from optlink.problem.machine.model import TASKS, ProblemKind
from optlink.problem.quantity import Quantity, check_choice, input_of, read_quantity
from optlink.problem.upgrades import upgraded
from optlink.tasks.machine import UNKNOWN_QUANTITY
from optlink.tasks.protocol import DesignTask, Progress, Proving, Search, part
from optlink.units import KINDS, show

if TYPE_CHECKING:
    from optlink.optimization.nlp import NLP
    from optlink.tasks.results.balance import Balance
    from optlink.tasks.results.common import DesignResult
    from optlink.tasks.results.design import SynthesisResult


IN_FILE = "sizes rounded as [rounding] of the file states; without: --round none"
MAX_UNKNOWNS = 3  # most design variables of a certificate that is made after an incomplete search


def design_task(problem: ProblemFile) -> DesignTask[Any]:
    """Return the task of a problem; an error says that a machine to be analysed states nothing to solve."""
    kind = TASKS.get(problem.task) or TASKS[problem.spec.task]
    task: DesignTask[Any] = kind.load()
    return task


class _Options(Execution, total=False):
    """Options of `solve` that do not determine the kind of its result."""

    track: bool
    gap: float
    time_limit: float
    proving: Proving
    rounding: str | Mapping[str, object] | None


@overload
def solve(
    problem: AnyProblem,
    backend: str = ...,
    starts: int | None = ...,
    seed: int = ...,
    progress: Progress = ...,
    *,
    designs: int | None = ...,
    certify: Literal[True],
    **options: Unpack[_Options],
) -> SynthesisResult: ...
@overload
def solve(
    problem: AnyProblem,
    backend: str = ...,
    starts: int | None = ...,
    seed: int = ...,
    progress: Progress = ...,
    *,
    designs: int,
    certify: bool | None = ...,
    **options: Unpack[_Options],
) -> SynthesisResult: ...
@overload
def solve(
    problem: AnyProblem,
    backend: str = ...,
    starts: int | None = ...,
    seed: int = ...,
    progress: Progress = ...,
    *,
    designs: int | None = ...,
    certify: bool | None = ...,
    **options: Unpack[_Options],
) -> DesignResult: ...
@typed
def solve(
    problem: AnyProblem,
    backend: str = "ipopt",
    starts: int | None = None,
    seed: int = 0,
    progress: Progress = None,
    *,
    designs: int | None = None,
    track: bool = False,
    certify: bool | None = None,
    gap: float = 1e-6,
    time_limit: float = math.inf,
    proving: Proving = None,
    rounding: str | Mapping[str, object] | None = None,
    **execution: Unpack[Execution],
) -> DesignResult:
    """Find the best design for a problem and validate it.

    Parameters
    ----------
    problem : ProblemFile, str or Path
        From `optlink.load`, the name of a shipped problem, or a file, with a `[requirement]` (motion law, function, path, motion,
        transmission), an `[objective]` over the cycle of a machine, or a section `[balance]`.
    backend : "ipopt", "slsqp" or "both"
        Local solver. With "both", each solver searches separately and the results must agree.
    starts : int, optional
        Number of starting points; a larger number never gives a worse result. Default: chosen by the kind of problem.
    seed : int
        Seed of the random starting points.
    progress : function of the completed fraction, optional
    designs : int, optional
        Number of distinct designs of a path, motion or transmission problem (default 3).
    track : bool
        Keep the iterates of the first search (laws and functions).
    certify : bool, optional
        Prove that no better design exists within the bounds, or find it: `result.certificate` has a lower bound of the objective.
        For motion laws, functions, timed paths and transmission problems. Default: motion laws of at most two design variables,
        with at most 2000 boxes (about a second).
    gap : float
        Relative optimality gap: the proof ends when no design can be better by more than this fraction of the objective.
    time_limit : float [s]
        Time limit of the proof. The lower bound reached by then is valid.
    proving : function of (completed fraction of the proof, current gap), optional
        Called with the progress of the proof.
    rounding : str or mapping of str to object, optional
        Sizes that can be made, in place of the section `[rounding]` of the file: the step of all free lengths, such as
        `"0.1 mm"`, a table like that section, or `"none"`. The designs have such sizes and are validated with them.
    **execution : Execution
        Where long searches and proofs run; if an option is set, short searches too.

    Returns
    -------
    DesignResult
        `SynthesisResult` or `Balance`, by the kind of problem; with `designs` or `certify=True` a `SynthesisResult`.

    Raises
    ------
    InputError
        If the problem has no requirement, objective or balancing section, if it has no design variables, or if an argument
        does not apply.

    Examples
    --------
    >>> result = optlink.solve(optlink.load("crank-rocker"))
    >>> result.valid, round(1e3 * result.design["coupler"], 3)  # [mm]
    (True, 412.865)
    >>> [limit.name for limit in result.limits if limit.active]
    ['largest transmission angle']
    """
    problem = problem_of(problem)
    from optlink.execution.runner import alone, check, known_here, pool

    task = design_task(problem)
    certified = task.certifies(problem)
    if certify and not certified:
        message, remedy = "no certificate of the global optimum for this kind of problem", "Leave it out"
        raise InputError(message, remedy, problem.file, "--certify")
    if certified or (gap, time_limit) != (1e-6, math.inf):  # its import takes time
        from optlink.tasks import certify as proof

        proof.check_options(gap, time_limit)
    if certify:
        proof.check_problem(problem)
    result: DesignResult
    shared = any(value not in (None, "local") for value in execution.values())
    execution = known_here(problem, execution)
    check(**execution)
    grids = task.grids(problem, rounding)
    if certify and grids:
        remedy = "Leave it out, or solve without rounding"
        raise InputError("a proof is one of sizes that are not rounded", remedy, problem.file, "--certify")
    with contextlib.ExitStack() as ends:
        runs = ends.enter_context(pool(**execution)) if task.divisible and not alone(**execution) else None
        kept: dict[str, Any] = {"designs": designs, "track": track, "runs": runs, "shared": shared}
        result = task.solve(problem, backend, starts, seed, part(progress, 0, 2) if grids else progress, **kept)
        proven = certified and certify is not False and not result.interrupted and (certify or not grids)
        boxes = 0.0 if not proven else math.inf if certify else _default_boxes(problem, result)
        if boxes:
            result = proof.certify(cast("SynthesisResult", result), gap, time_limit, proving, seed, boxes, problem, runs=runs)
    if not grids:
        return result
    made: SynthesisResult = task.rounded(result, grids, backend, part(progress, 1, 2))
    return replace(made, notes=(*made.notes, IN_FILE)) if rounding is None and made.rounding else made


def _default_boxes(problem: ProblemFile, result: Any) -> int:
    """Return the number of boxes of a certificate that is made by default; zero if none is made."""
    from optlink.solvers.global_search.branch_and_bound import LONG
    from optlink.tasks import certify as proof

    if proof.automatic(problem):
        return proof.AUTOMATIC_BOXES
    if result.incomplete and len(problem.model.free) <= MAX_UNKNOWNS:
        with contextlib.suppress(InputError):
            proof.check_problem(problem)
            return LONG
    return 0


@typed
def validate(problem: AnyProblem, design: Mapping[str, float | str]) -> DesignResult:
    """Check a design against all requirements and limits, without optimisation.

    Parameters
    ----------
    problem : ProblemFile, str or Path
        From `optlink.load`, the name of a shipped problem, or a file, with a requirement or an objective.
    design : mapping of str to float [SI] or str
        Value of every design variable by name, for example `result.design` or {"coupler": "412 mm", "rocker": "232 mm"};
        `optlink.read_design` reads them from a result file.

    Returns
    -------
    DesignResult
        `SynthesisResult`; `valid` if all checks pass.

    Raises
    ------
    InputError
        If the problem has no requirement or objective, or if the design has unknown names or lacks a design variable.

    Examples
    --------
    >>> result = optlink.validate(optlink.load("crank-rocker"), {"coupler": 0.412, "rocker": 0.232})  # [m]
    >>> result.valid, [check.name for check in result.validation.checks if not check.passed]
    (False, ['largest transmission angle'])
    """
    problem = problem_of(problem)
    from optlink.tasks.machine import check_design

    task = design_task(problem)
    sizes = check_design(problem, design) or {}
    if task.most_starts is not None:  # a kind with design variables
        check_complete(problem, design)
    result: DesignResult = task.validate(problem, sizes)
    return result


# --- the kinds of problems -------------------------------------------------------------------------------------------------


def _synthesis() -> DesignTask[SynthesisResult]:
    from optlink.tasks.design import TASK

    return TASK


class _BalanceTask(DesignTask["Balance"]):
    no_starts = "balancing is a convex programme with one optimum: it has no starting points"

    def programme(self, problem: ProblemFile) -> NLP:
        message = "balancing is a cone programme of masses, not a nonlinear programme of dimensions"
        raise InputError(message, "Use optlink.balance", problem.file, "balance")

    def search(self, problem: ProblemFile, search: Search) -> Balance:
        from optlink.tasks.balance import balance

        return balance(problem, progress=search.progress)

    def validate(self, problem: ProblemFile, design: Mapping[str, float]) -> Balance:
        remedy = "Run `optlink balance`: it verifies what it finds by inverse dynamics"
        raise InputError("a balancing problem has no design to validate", remedy, problem.file, "balance")


_BUILT_IN = {**dict.fromkeys(("function", "path", "cycle"), _synthesis), "balance": _BalanceTask}
TASKS |= {name: ProblemKind(name, load) for name, load in _BUILT_IN.items()}  # their sections are those of `DesignProblem`


# Designs that a user gives: read from texts or result files, and checked for completeness.


def _stored(text: str, quantities: Mapping[str, Quantity]) -> list[tuple[str, object]]:
    """Return the assignments of a result.json, one per quantity (phi0 and psi0 only if not derived)."""
    try:
        document = json.loads(Path(text).read_text(encoding="utf-8"))
        content = checked(document)
        state = {} if content is None else upgraded(content).get("state", {})  # of a changed file the displayed design
        best = (state.get("designs") or [document.get("nearest") or {}])[0] if "designs" in state else {}
        exact = state.get("design") or best.get("values")  # [SI]
        if isinstance(exact, dict):
            return [
                (name, f"{float(value)!r} {KINDS[quantities[name].kind].si}")
                for name, value in exact.items()
                if name in quantities
            ]
        design = document["design"].items()
        parts = [(*key.rpartition("_"), float(value)) for key, value in design if not isinstance(value, bool)]
        return [(name, f"{value!r} {unit}") for name, _, unit, value in parts if name in quantities or name in LENGTHS]
    except (OSError, ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError) as error:
        reason = getattr(error, "strerror", None) or "no design in it"
        raise InputError(
            f"cannot read a design: {reason}", "Give a result.json that `solve --out` wrote", text, "--design"
        ) from None


@typed
def read_design(problem: AnyProblem, assignments: list[str], varied: Collection[str] = ()) -> dict[str, float]:
    """Read a design from texts such as "coupler=412.26 mm", or from the name of a result.json.

    Parameters
    ----------
    problem : ProblemFile, str or Path
    assignments : list of str
        "NAME=VALUE", or the path of a result.json.
    varied : collection of str
        Design variables that need no value.

    Returns
    -------
    mapping of str to float [m, rad]

    Raises
    ------
    InputError
        For unknown or missing names, or values that are not quantities.
    """
    problem = problem_of(problem)
    quantities = problem.model.quantities
    design: dict[str, float] = {}
    stored = [pair for text in assignments if text.endswith(".json") for pair in _stored(text, quantities)]
    assigned = parse_assignments([text for text in assignments if not text.endswith(".json")], "--design")
    for key, value in (*stored, *assigned.items()):
        name = key.removeprefix("mechanism.")
        check_choice("--design", name, quantities, UNKNOWN_QUANTITY, problem.file)
        if isinstance(value, dict | list):
            remedy = f'Give one value, such as {name}="{show(quantities[name].value, quantities[name].kind)}"'
            raise InputError("a given design has no bounds", remedy, problem.file, f"--design {name}", value)
        with input_of(problem.file, f"--design {name}", value):
            design[name] = float(read_quantity(value, quantities[name].kind).value)
    for k, name in enumerate(varied):
        if not isinstance(name, str):
            raise InputError("not a text", 'Give the name of a design variable, such as "coupler"', key=f"varied.{k}", value=name)
    check_complete(problem, {*design, *varied})
    return design


def check_complete(problem: ProblemFile, names: Collection[str]) -> None:
    """Refuse a design without a value for each of the design variables.

    Raises
    ------
    InputError
        If one is missing.
    """
    quantities = problem.model.quantities
    missing = [name for name in problem.model.free if name not in names]
    if missing:
        starts = [(name, quantities[name]) for name in missing]
        if OPTIONS_NAMED.get():
            example = " ".join(f'--design {name}="{show(start.value, start.kind)}"' for name, start in starts)
        else:
            example = f"design={json.dumps({name: float(f'{start.value:.6g}') for name, start in starts})}"
        raise InputError(f"the design lacks {', '.join(missing)}", f"Add for example {example}", problem.file, "--design")
