"""Solve or check a design problem of any kind: the one entry for every requirement, objective and balancing task."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from optlink.errors import Fault, InputError
from optlink.io import Registry
from optlink.problem.file import ProblemFile

if TYPE_CHECKING:
    from optlink.tasks.function import FunctionResult
    from optlink.tasks.results.balance import Balance
    from optlink.tasks.results.cycle import CycleResult
    from optlink.tasks.results.path import PathResult

Progress = Callable[[float], None]
"""Receives the share of the work that is done, from 0 to 1."""

Proving = Callable[[float, float], None]
"""Receives the share of the bounds that is done, and the present gap."""


@dataclass(frozen=True)
class Search:
    """Options of a search, see `solve`."""

    backend: str = "ipopt"
    starts: int | None = None
    seed: int = 0
    progress: Progress | None = None
    designs: int | None = None
    track: bool = False


@dataclass(frozen=True)
class Task:
    """How a kind of problem is solved, and how a given design of it is validated.

    The results have `problem`, `status`, `valid`, `interrupted`, `validation`, `with_checks` and `to_dict`; and, for the motion
    on their page, `machine`: the problem with all dimensions fixed, or None.
    """

    solve: Callable[[ProblemFile, Search], Any]
    validate: Callable[[ProblemFile, Mapping[str, float]], Any]


CERTIFIED = ("function", "path")
"""Kinds of problems whose global optimum can be certified."""

TASKS: Registry[Task] = Registry()
"""Tasks by the kind of problem (`ProblemFile.task`)."""


def solve(
    problem: ProblemFile,
    backend: str = "ipopt",
    starts: int | None = None,
    seed: int = 0,
    progress: Progress | None = None,
    *,
    designs: int | None = None,
    track: bool = False,
    certify: bool | None = None,
    gap: float = 1e-6,
    time_limit: float = math.inf,
    proving: Proving | None = None,
    folder: Path | None = None,
    resume: bool = False,
) -> FunctionResult | PathResult | CycleResult | Balance:
    """Find the best design for a problem and validate it.

    Parameters
    ----------
    problem : ProblemFile
        From `optlink.load`, with a `[requirement]` (motion law, function, path, motion, transmission), an `[objective]` over
        the cycle of a machine, or a section `[balance]`.
    backend : "ipopt", "slsqp" or "both"
        Local solver. With "both", each solver searches separately and the results must agree (laws, functions, cycles).
    starts : int, optional
        Number of starting points; more are never worse. Default: chosen by the kind of problem.
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
        Share of the objective by which a design may be better without being found.
    time_limit : float [s]
        Time of the proof; the bound that is reached then holds.
    proving : function of (share of the bounds that is done, present gap), optional
        Progress of the proof.
    folder : Path, optional
        Where the state of a long proof is kept, so that an interrupted one can continue.
    resume : bool
        Continue the proof that was interrupted in `folder`.

    Returns
    -------
    FunctionResult, PathResult, CycleResult or Balance
        Depends on the kind of problem. All have `valid`, `status`, `design`, `objective` and `to_dict()`.

    Raises
    ------
    InputError
        If the problem has no requirement, objective or balancing section, if it has no design variables, or if an argument
        does not apply.
    """
    if problem.task != "path" and designs is not None:
        remedy = "Leave it out; --starts N lists the distinct optima of a law"
        raise InputError(Fault("only points and poses have several designs", remedy, problem.file, "--designs", designs))
    if certify and problem.task not in CERTIFIED:
        message, remedy = "no certificate of the global optimum for this kind of problem", "Leave it out"
        raise InputError(Fault(message, remedy, problem.file, "--certify"))
    from optlink.tasks import certify as proof

    proof.check_options(gap, time_limit)
    if certify:
        proof.check_problem(problem)
    found: FunctionResult | PathResult | CycleResult | Balance
    found = TASKS[problem.task].solve(problem, Search(backend, starts, seed, progress, designs, track))
    if problem.task not in CERTIFIED or certify is False or found.interrupted:
        return found
    if certify is None and not proof.automatic(problem):
        return found
    boxes = proof.BUDGET if certify is None else math.inf
    return proof.certify(  # type: ignore[type-var]
        found, gap, time_limit, proving, seed, boxes, problem, folder, resume=resume
    )


def validate(problem: ProblemFile, design: Mapping[str, float]) -> FunctionResult | PathResult | CycleResult:
    """Check a design against all requirements and limits, without optimisation.

    Parameters
    ----------
    problem : ProblemFile
        From `optlink.load`, with a requirement or an objective.
    design : mapping of str to float [SI]
        Values of the design variables by name; `optlink.read_design` reads them from text or from a result file.

    Returns
    -------
    FunctionResult, PathResult or CycleResult
        Depends on the kind of problem; `valid` if all checks pass.

    Raises
    ------
    InputError
        If the problem has no requirement or objective.
    """
    found: FunctionResult | PathResult | CycleResult = TASKS[problem.task].validate(problem, design)
    return found


# --- the kinds of problems -------------------------------------------------------------------------------------------------


def _function(problem: ProblemFile, search: Search) -> FunctionResult:
    from optlink.tasks import function

    return function.solve(problem, search.backend, search.starts, search.seed, search.progress, track=search.track)


def _path(problem: ProblemFile, search: Search) -> PathResult:
    from optlink.tasks import path

    designs = 3 if search.designs is None else search.designs
    return path.solve(problem, search.backend, search.starts, search.seed, designs, search.progress)


def _cycle(problem: ProblemFile, search: Search) -> CycleResult:
    from optlink.tasks import cycle

    return cycle.solve(problem, search.backend, search.starts, search.seed, search.progress)


def _balance(problem: ProblemFile, search: Search) -> Balance:
    from optlink.tasks import balance

    if search.starts is not None:
        message = "balancing is a convex programme with one optimum: it has no starting points"
        raise InputError(Fault(message, "Leave it out", problem.file, "--starts", search.starts))
    return balance.balance(problem, progress=search.progress)


def _check_function(problem: ProblemFile, design: Mapping[str, float]) -> FunctionResult:
    from optlink.tasks import function

    return function.validate(problem, design)


def _check_path(problem: ProblemFile, design: Mapping[str, float]) -> PathResult:
    from optlink.tasks import path

    return path.validate(problem, design)


def _check_cycle(problem: ProblemFile, design: Mapping[str, float]) -> CycleResult:
    from optlink.tasks import cycle

    return cycle.validate(problem, design)


def _check_balance(problem: ProblemFile, design: Mapping[str, float]) -> Balance:
    remedy = "Run `optlink balance`: it verifies what it finds by inverse dynamics"
    raise InputError(Fault("a balancing problem has no design to validate", remedy, problem.file, "balance"))


TASKS["function"] = TASKS["analysis"] = Task(_function, _check_function)  # an analysis is refused: it has no requirement
TASKS["path"] = Task(_path, _check_path)
TASKS["cycle"] = Task(_cycle, _check_cycle)
TASKS["balance"] = Task(_balance, _check_balance)
