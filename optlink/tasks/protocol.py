"""`DesignTask`, which each kind of design problem has, and common parts of searches: checked options, stages, progress."""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar, Generic, TypeVar

from optlink.errors import InputError
from optlink.execution import interrupts
from optlink.execution.worker import Runs
from optlink.problem.file import ProblemFile
from optlink.problem.quantity import check_choice, check_range
from optlink.problem.rounding import NO_GRID
from optlink.solvers import contract
from optlink.validation.check import Check

if TYPE_CHECKING:
    from optlink.linkage.vector2d import Array
    from optlink.optimization.nlp import NLP
    from optlink.solvers.multistart import Agreement
    from optlink.tasks.results.common import DesignResult

R = TypeVar("R", bound="DesignResult")
MAX_DESIGNS = 50
Progress = Callable[[float], None] | None
"""Receives the share of the work that is done, from 0 to 1."""
Proving = Callable[[float, float], None] | None
"""Receives the share of the bounds that is done, and the present gap (NaN without a design)."""


class Timer:
    """Wall time per stage [s], in `seconds`."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._last = time.perf_counter()

    def lap(self, stage: str) -> None:
        """End a stage."""
        now = time.perf_counter()
        self.seconds[stage], self._last = now - self._last, now


def agreement(what: str, gaps: Agreement, nearest_design: float, limit: str, unit: str = "") -> tuple[Check, ...]:
    """Check that two back ends found the same objective, and the same design unless several are equally good.

    Up to `nearest_design`, shown as `limit`, two designs are the same.
    """
    equal = gaps.design <= nearest_design
    words = "" if equal or not gaps.same else " (two of equal value)"
    return (
        Check("both back ends agree: objective", gaps.same, gaps.objective, "<= 1e-06", ""),
        Check(f"both back ends agree: {what}{words}", gaps.same, gaps.design, limit if equal else "-", unit),
    )


def part(progress: Progress, k: int, count: int) -> Progress:
    """Return the progress function of the k-th of several searches."""
    return None if progress is None else lambda share: progress((k + share) / count)


def completed(result: R) -> R:
    """Return the result of a search that is a part of other work.

    Raises
    ------
    KeyboardInterrupt
        If the search was interrupted: its best design so far is not the result.
    """
    if result.interrupted:
        raise KeyboardInterrupt
    return result


@dataclass(frozen=True)
class Search:
    """Checked options of a search, see `DesignTask.solve`; `names`: the back ends to use; `timer`: begun with the search.

    `runs`: processes for independent parts, from `optlink.execution.runner.pool`, that change nothing in the result; `shared`:
    whether they are requested, not only for long searches. `asked`: whether a number of designs is.
    """

    names: tuple[str, ...]
    backend: str
    starts: int | None
    seed: int
    progress: Progress
    designs: int
    track: bool
    begin: Mapping[str, float] | None
    runs: Runs | None = None
    shared: bool = False
    asked: bool = False
    timer: Timer = field(default_factory=Timer)


class DesignTask(ABC, Generic[R]):
    """A kind of problem: how it is searched, and how a given design of it is validated.

    The results are `DesignResult`s; on their page they show the motion of their `machine`.
    """

    most_starts: ClassVar[int | None] = None
    """Largest number of starting points; None for a kind without starting points and design variables."""
    no_starts: ClassVar[str] = "this kind of problem has no starting points"
    """Error message where a number of starting points is given nevertheless."""
    designs: ClassVar[int | None] = None
    """Default number of distinct designs of a `SynthesisResult`; None if only one is found."""
    divisible: ClassVar[bool] = False
    """Whether several processes can share a search."""

    @abstractmethod
    def search(self, problem: ProblemFile, search: Search) -> R:
        """Return the best design with its validation, or the reason why there is none.

        Parameters
        ----------
        problem : ProblemFile
        search : Search
        """

    def validate(self, problem: ProblemFile, design: Mapping[str, float]) -> R:
        """Validate a given design; kinds without design variables return the result of `solve`.

        Parameters
        ----------
        problem : ProblemFile
        design : mapping of str to float [m, rad]
            All design variables; see `read_design`.

        Raises
        ------
        InputError
            If a design is given for a kind that cannot be validated.
        """
        if design:
            message = "a given design of this kind of problem cannot be validated"
            raise InputError(message, "State its dimensions in the file", problem.file, "--design", ", ".join(design))
        return self.solve(problem)

    def programme(self, problem: ProblemFile) -> NLP:
        """Return the scaled nonlinear programme of a problem with definite assembly modes.

        Parameters
        ----------
        problem : ProblemFile

        Raises
        ------
        InputError
            If this kind of problem has none, or several.
        """
        message = "this kind of problem has no nonlinear programme of its dimensions"
        raise InputError(message, "Use optlink.solve", problem.file)

    def unknowns(self, problem: ProblemFile, nlp: NLP, design: Mapping[str, float]) -> Array:
        """Return the scaled unknowns of the programme at a design: those that the formulation adds follow from it.

        Parameters
        ----------
        problem : ProblemFile
        nlp : NLP
            From `programme`.
        design : mapping of str to float [SI]
        """
        return nlp.x_of(design, bounded=False)

    def place(self, problem: ProblemFile, nlp: NLP, x: Array) -> None:
        """Move the exchange points of the programme to the peaks of limits and of the objective at x, if it has any.

        Parameters
        ----------
        problem : ProblemFile
        nlp : NLP
        x : array (n,)
            Scaled point.
        """

    def grids(self, problem: ProblemFile, rounding: object) -> dict[str, Any]:
        """Return the grids of sizes to which `rounded` rounds a result, none without; see `optlink.tasks.rounding.read_steps`.

        Parameters
        ----------
        problem : ProblemFile
        rounding : object
            As given to `optlink.solve`.

        Raises
        ------
        InputError
            If it cannot be read, or this kind of problem cannot be rounded.
        """
        if rounding in (None, NO_GRID):
            return {}
        raise InputError("the sizes of this kind of problem are not rounded", "Leave it out", problem.file, "--round")

    def rounded(self, result: R, grids: Mapping[str, Any], backend: str, progress: Progress) -> R:
        """Return a result whose sizes lie on the `grids`, validated as built.

        Parameters
        ----------
        result : DesignResult
        grids : mapping
        backend : str
        progress : function of the completed fraction, optional
        """
        raise NotImplementedError

    def certifies(self, problem: ProblemFile) -> bool:
        """Return whether the global optimum of such a problem can be certified; not by default.

        Parameters
        ----------
        problem : ProblemFile
        """
        return False

    def solve(
        self,
        problem: ProblemFile,
        backend: str = "ipopt",
        starts: int | None = None,
        seed: int = 0,
        progress: Progress = None,
        *,
        designs: int | None = None,
        track: bool = False,
        begin: Mapping[str, float] | None = None,
        runs: Runs | None = None,
        shared: bool = False,
    ) -> R:
        """Check the options, search, and validate the result.

        Parameters
        ----------
        problem : ProblemFile
            From `optlink.load`.
        backend : "slsqp", "ipopt" or "both"
            With "both" each solver searches separately, the better design is used, and the results must agree.
        starts : int, optional
            Number of starting points; a larger number includes those of a smaller one, so it is never worse.
        seed : int
            Seed of the random starting points.
        progress : function of the completed fraction, optional
        designs : int, optional
            Number of distinct designs, for kinds of problems with several.
        track : bool
            Keep the iterates of the first search (laws and functions).
        begin : mapping of str to float [SI], optional
            Design variables of the only starting point (laws and functions).
        runs : function, optional
            From `optlink.execution.runner.pool`: processes that share a long search.
        shared : bool
            Whether they share a short one too.

        Raises
        ------
        InputError
            If there are no design variables, or an option is out of range or does not apply.
        """
        interrupts.check()
        default = 1 if problem.model.of_cycle else self.designs
        if designs is not None and (self.designs is None or problem.model.of_cycle):
            message = "only laws, points, poses and transmissions have several designs"
            raise InputError(message, "Leave it out", problem.file, "--designs", designs)
        check_range("designs", 1 if designs is None else designs, 1, MAX_DESIGNS)
        names = self._back_ends(problem, backend, starts, seed)
        count = designs or default or 1
        options = Search(names, backend, starts, seed, progress, count, track, begin, runs, shared, asked=designs is not None)
        return self.search(problem, options)

    def _back_ends(self, problem: ProblemFile, backend: str, starts: int | None, seed: int) -> tuple[str, ...]:
        """Check the options of the search, import its back ends and return their names."""
        if self.most_starts is None:
            if starts is not None:
                raise InputError(self.no_starts, "Leave it out", problem.file, "--starts", starts)
            return ()
        check_choice("backend", backend, [*contract.selectable(), "both"], "unknown back end")
        check_range("starts", 1 if starts is None else starts, 1, self.most_starts)
        if seed < 0:
            raise InputError("a seed must not be negative", "Give 0 or more", key="seed", value=seed)
        self.check_free(problem)
        names = contract.BACKENDS if backend == "both" else (backend,)
        for name in names:
            contract.backend(name)  # imports do not count as solving time
        return names

    def check_free(self, problem: ProblemFile) -> None:
        """Refuse a problem without design variables.

        Parameters
        ----------
        problem : ProblemFile

        Raises
        ------
        InputError
            If every dimension is fixed.
        """
        if not problem.model.free:
            message = "no design variables: every dimension is fixed"
            example = 'coupler = { bounds = ["100 mm", "900 mm"] }'
            if problem.model.of_cycle:
                example = 'length = { start = "120 mm", bounds = ["60 mm", "200 mm"] }'
            raise InputError(message, f"Free one: {example}, or check the design: optlink validate", problem.file, "mechanism")
