"""Solve or check a design problem of any kind: the one entry for every requirement, objective and balancing task."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

from optlink.errors import Fault, InputError
from optlink.problem.file import ProblemFile

if TYPE_CHECKING:
    from optlink.tasks.function import FunctionResult
    from optlink.tasks.results.balance import Balance
    from optlink.tasks.results.cycle import CycleResult
    from optlink.tasks.results.path import PathResult

Progress = Callable[[float], None]
"""Receives the share of the work that is done, from 0 to 1."""


def solve(
    problem: ProblemFile,
    backend: str = "ipopt",
    starts: int | None = None,
    seed: int = 0,
    progress: Progress | None = None,
    *,
    designs: int | None = None,
    track: bool = False,
) -> FunctionResult | PathResult | CycleResult | Balance:
    """Find the best design for a problem and validate it.

    Parameters
    ----------
    problem : ProblemFile
        From `optlink.load`, with a `[requirement]` (motion law, function, path, motion, transmission), an `[objective]` over
        the cycle of a machine, or a section `[balance]`.
    backend : "ipopt", "slsqp" or "both"
        Local solver. With "both" each solver searches separately and the results must agree (laws, functions, cycles).
    starts : int, optional
        Number of starting points; more are never worse. Default: chosen by the kind of problem.
    seed : int
        Seed of the random starting points.
    progress : function of the share that is done, optional
    designs : int, optional
        Number of distinct designs of a path, motion or transmission problem (default 3).
    track : bool
        Keep the iterates of the first search (laws and functions).

    Returns
    -------
    FunctionResult, PathResult, CycleResult or Balance
        By the kind of problem. All have `valid`, `status`, `design`, `objective` and `to_dict()`.

    Raises
    ------
    InputError
        if the problem has no requirement, objective or balancing section, if no design variable is free, or if an argument
        does not apply.
    """
    if problem.task != "path" and designs is not None:
        remedy = "Leave it out; --starts N lists the distinct optima of a law"
        raise InputError(Fault("only points and poses have several designs", remedy, problem.file, "--designs", designs))
    if problem.task == "path":
        from optlink.tasks import path

        return path.solve(problem, backend, starts, seed, 3 if designs is None else designs, progress)
    if problem.task == "cycle":
        from optlink.tasks import cycle

        return cycle.solve(problem, backend, starts, seed, progress)
    if problem.task == "balance":
        from optlink.tasks import balance

        if starts is not None:
            message = "balancing is a convex programme with one optimum: it has no starting points"
            raise InputError(Fault(message, "Leave it out", problem.file, "--starts", starts))
        return balance.balance(problem, progress=progress)
    from optlink.tasks import function

    return function.solve(problem, backend, starts, seed, progress, track=track)


def validate(problem: ProblemFile, design: Mapping[str, float]) -> FunctionResult | PathResult | CycleResult:
    """Check a given design by the kinematics core, or show which requirement it fails.

    Parameters
    ----------
    problem : ProblemFile
        From `optlink.load`, with a requirement or an objective.
    design : mapping of design variable to value [SI]
        See `optlink.read_design`.

    Raises
    ------
    InputError
        if the problem has no requirement or objective.
    """
    if problem.task == "path":
        from optlink.tasks import path

        return path.validate(problem, design)
    if problem.task == "cycle":
        from optlink.tasks import cycle

        return cycle.validate(problem, design)
    if problem.task == "balance":
        remedy = "Run `optlink balance`: it verifies what it finds by inverse dynamics"
        raise InputError(Fault("a balancing problem has no design to validate", remedy, problem.file, "balance"))
    from optlink.tasks import function

    return function.validate(problem, design)
