"""certify(result) -> result: prove that no better design exists within the bounds, or find it."""

from __future__ import annotations

import functools
import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from optlink.errors import InputError
from optlink.execution import interrupts
from optlink.execution.worker import Runs
from optlink.linkage.vector2d import Array, max_magnitude
from optlink.optimization.multipliers import ACTIVE
from optlink.optimization.taylor_model import DesignBoxes, box_problem
from optlink.problem.file import ProblemFile
from optlink.solvers.global_search.branch_and_bound import BATCH, FEW, Bounder, BranchAndBound, joint_history
from optlink.solvers.global_search.function_generator import CLOSED, INTERRUPTED, MOST, certify_function
from optlink.solvers.global_search.lagrangian import Guess, LagrangianBounds, least_squares
from optlink.solvers.solution import SAME_OBJECTIVE
from optlink.tasks.design import certified_by_default
from optlink.tasks.protocol import Proving
from optlink.tasks.results.certificate import (
    GLOBAL,
    GLOBAL_GAP,
    INFEASIBLE,
    NOT_CLOSED,
    WITHIN_GAP,
    Certificate,
    Cover,
    exact,
    sides_of,
)
from optlink.tasks.results.common import INCOMPLETE, inexact

if TYPE_CHECKING:
    from optlink.solvers.global_search.timed_path import TimedPathBounds
    from optlink.tasks.results.design import SynthesisResult

NEAR_LARGEST = 1e-3  # share below the largest deviation within which others are as large
DERIVATIVE_WIDTH = 1e-8  # half width of the box about the best design in which derivatives are taken, as a share of the bounds
GAP_SHARE = 0.999  # share of the gap that the search uses, so that rounding does not decide whether it is kept
PATH_BOXES = 1024  # boxes of a timed path that are bounded together
AUTOMATIC_BOXES = 2_000  # boxes of a certificate that is made by default; they take about a second


def automatic(problem: ProblemFile) -> bool:
    """Return whether the optimum of a problem is certified by default."""
    return problem.task == "function" and certified_by_default(problem.spec)


def check_problem(problem: ProblemFile) -> None:
    """Raise if no lower bound is available for a problem, before it is searched."""
    bounded = bool(problem.model.parts) and problem.spec.error_bounded
    if not bounded and not _of_path(problem):
        box_problem(problem.variants()[0])


def _of_path(problem: ProblemFile) -> bool:
    """Return whether a problem is a timed path that is bounded over the proportions of its four-bar."""
    if problem.task != "path":
        return False
    from optlink.solvers.global_search.timed_path import unsuitable

    return not unsuitable(problem.spec)


def check_options(gap: float, time_limit: float) -> None:
    """Raise if an option of the proof is out of range.

    Raises
    ------
    InputError
        If the gap is not from 1e-12 to less than 1, or the time limit is not above zero.
    """
    if not 1e-12 <= gap < 1.0:
        raise InputError("out of range", "Give a share from 1e-12 to less than 1, such as 1e-6", key="--gap", value=gap)
    if not time_limit > 0.0:
        remedy = 'Give a time above zero, such as "5 min"'
        raise InputError("out of range", remedy, key="--time-limit", value=f"{time_limit:g} s")


def certify(
    result: SynthesisResult,
    gap: float = GLOBAL_GAP,
    time_limit: float = math.inf,
    progress: Proving = None,
    seed: int = 0,
    boxes: float = math.inf,
    original: ProblemFile | None = None,
    *,
    runs: Runs | None = None,
) -> SynthesisResult:
    """Compute a lower bound of the objective over all designs by branch and bound; a better design replaces that of the result.

    The search ends at the relative `gap`, after `time_limit` [s] or that many `boxes`. It includes the assembly modes that
    `original` (by default the problem of the result) leaves open. `runs` shares a long search and changes nothing in the result.
    A `gap` or `time_limit` out of range is refused, and a problem without a lower bound.
    """
    check_options(gap, time_limit)
    model, problem = result.problem.spec, original or result.problem
    of_function = model.error_bounded and result.valid and result.objective < MOST
    of_function = of_function and not exact(problem, result.objective)
    kind = _ErrorSearch if of_function else _PathSearch if _of_path(result.problem) else _Search
    found: SynthesisResult = kind(result, problem, gap, seed, runs).run(time_limit, boxes, progress)
    return found


@dataclass
class _Search:
    """Branch and bound over every assembly mode, with the best design of all."""

    result: Any
    original: ProblemFile
    gap: float
    seed: int
    runs: Runs | None = None
    improved: bool = False

    def run(self, seconds: float, boxes: float, progress: Proving) -> Any:
        """Search every assembly mode, each with the best design found so far."""
        begin = time.perf_counter()
        variants = self.original.variants()
        searches: list[BranchAndBound] = []
        interrupted = False
        try:
            problems = [box_problem(variant, self._peaks) for variant in variants]
            for variant, problem in zip(variants, problems, strict=True):
                better = functools.partial(self._improve, variant, problem)
                searches.append(self._branches(LagrangianBounds(problem), math.inf, better))
            for k, search in enumerate(searches):
                if self._exact or search.closed:  # nothing is smaller than zero
                    continue
                guess = self._multiplier_estimate(problems[k])
                search.bounder = LagrangianBounds(problems[k], guess)
                if guess is not None:
                    search.begin_about(guess.point)
                search.best = min(search.best, self._squared)
                left = seconds - (time.perf_counter() - begin)
                report = functools.partial(self._report, progress, searches, k)
                search.run(left, boxes - sum(item.boxes for item in searches), report)
        except KeyboardInterrupt:
            interrupts.handled()
            interrupted = True
        return self._with(self._certificate(searches, variants), begin, interrupted=interrupted)

    def _with(self, certificate: Certificate | None, begin: float, *, interrupted: bool) -> Any:
        """Return the result with its certificate and the time since the start of the proof."""
        seconds = self.result.seconds | {"certify": time.perf_counter() - begin}
        changes: dict[str, Any] = {"seconds": seconds, "interrupted": self.result.interrupted or interrupted}
        if certificate is not None and certificate.proven and self.result.incomplete:
            changes["notes"] = tuple(note for note in self.result.notes if not note.startswith(INCOMPLETE))
        return replace(self.result, certificate=certificate, **changes)

    def _branches(self, bounds: Bounder, best: float, better: Callable[[Array], float], batch: int = BATCH) -> BranchAndBound:
        """Return a search in terms of squared deviations."""
        share = GAP_SHARE * self.gap
        share = share * (2.0 - share) if self._square else share
        return BranchAndBound(bounds, best, share, better, batch, 2 * FEW, divisible=True, runs=self.runs)

    @property
    def _peaks(self) -> Array | None:
        """Crank rotations [rad] from the start at which the error of the best design is largest, where its whole range counts."""
        model, solution = self.result.problem.model, self.result.solution
        if solution is None or not (model.everywhere and model.law_given):
            return None
        count = solution.nlp.exchange_count
        return np.asarray(np.unique(solution.p[len(solution.p) - count :]) * model.span)

    # --- the best known design -------------------------------------------------------------------------------------

    @property
    def _known(self) -> float:
        """Objective of the best valid design, infinite if there is none."""
        return float(self.result.objective) if self.result.valid else math.inf

    @property
    def _square(self) -> bool:
        return bool(self.result.problem.model.measure != "sum of squares")

    @property
    def _squared(self) -> float:
        """The objective in terms of squared deviations, in which the search bounds it."""
        return self._known**2 if self._square else self._known

    @property
    def _exact(self) -> bool:
        return exact(self.result.problem, self._known)

    def _search_locally(self, variant: ProblemFile, start: dict[str, float]) -> bool:
        """Search locally from a design [SI]; return whether the result improved."""
        candidate = _local(self.result, variant, start)
        if candidate is None or not candidate.valid or not candidate.objective < (1.0 - SAME_OBJECTIVE) * self._known:
            return False
        self.result, self.improved = candidate, True
        return True

    def _improve(self, variant: ProblemFile, boxes: DesignBoxes, x: Array) -> float:
        """Search from a point for a better design; return the objective (squared) of the best known one."""
        self._search_locally(variant, dict(zip(boxes.problem.free, (float(value) for value in x), strict=True)))
        return self._squared

    def _multiplier_estimate(self, problem: DesignBoxes) -> Guess | None:
        """Estimate multipliers and weights from the optimality conditions at the best design; None without a design."""
        if not self.result.valid or self._exact:
            return None
        quantities = self.result.definite.model.quantities
        x = np.array([self.result.design.get(name, quantity.value) for name, quantity in quantities.items() if quantity.free])
        width = problem.high - problem.low
        models = problem.over((x - DERIVATIVE_WIDTH * width)[None], (x + DERIVATIVE_WIDTH * width)[None])
        inside = np.minimum(x - problem.low, problem.high - x) > ACTIVE * width
        slopes, slacks = models.slacks.linear[:, 0], models.slacks.value[0]
        squares = (models.residuals * models.residuals).sum()
        active = np.flatnonzero((np.abs(slacks) < ACTIVE) & np.isfinite(models.slacks.remainder[0]))
        multipliers, weights = np.zeros(len(slacks)), np.ones(squares.remainder.shape[1])
        if problem.measure != "max":
            weights /= len(weights) if problem.measure == "rms" else 1.0
            gradient = (squares * weights).sum().linear[:, 0]
            multipliers[active] = least_squares(slopes[:, active][inside], gradient[inside])
            return Guess(x, multipliers, weights)
        sizes = squares.value[0]
        top = np.flatnonzero(sizes >= (1.0 - NEAR_LARGEST) * np.max(sizes))
        rows = np.hstack([squares.linear[:, 0][:, top], -slopes[:, active]])[inside]
        scale = 1e3 * max(max_magnitude(rows), 1e-300)
        total = np.concatenate([np.full(len(top), scale), np.zeros(len(active))])
        solution = least_squares(np.vstack([rows, total]), np.append(np.zeros(len(rows)), scale))
        weights[:] = 0.0
        weights[top] = solution[: len(top)] / max(float(solution[: len(top)].sum()), 1e-300) * (1.0 - 1e-14 * len(weights))
        multipliers[active] = solution[len(top) :]
        return Guess(x, multipliers, weights)

    # --- the finding -----------------------------------------------------------------------------------------------

    def _report(self, progress: Proving, searches: list[BranchAndBound], k: int, search: BranchAndBound) -> None:
        if progress is None:
            return
        volume = float(np.prod(search.bounder.high - search.bounder.low))
        left = float(np.sum(np.prod(search.open.high - search.open.low, axis=1))) / volume if volume > 0.0 else 0.0
        gap = (self._known - self._value(search.lower)) / self._known if math.isfinite(self._known) else math.nan
        progress((k + 1.0 - left) / len(searches), gap)

    def _value(self, squared: float) -> float:
        """Return the objective for its value in terms of squared deviations."""
        return math.sqrt(max(squared, 0.0)) * (1.0 - 1e-15) if self._square else squared

    def _status(self, closed: bool, lower: float) -> str:
        best = self._known
        if not closed:
            return NOT_CLOSED
        if not math.isfinite(best):
            return INFEASIBLE
        share = (best - lower) / best if best > 0.0 else 0.0
        return GLOBAL if self._exact or share <= GLOBAL_GAP * (1.0 + 1e-9) else WITHIN_GAP

    def _certificate(self, searches: list[BranchAndBound], variants: list[ProblemFile]) -> Certificate | None:
        """Return what the searches prove; None if interrupted before they began."""
        if len(searches) < len(variants):
            return None
        lower = 0.0 if self._exact else min(self._value(search.lower) for search in searches)
        closed = self._exact or all(search.closed for search in searches)
        kept = all(search.leaves.test and isinstance(search.bounder, LagrangianBounds) for search in searches)
        if self.result.valid and self.result.problem.model.everywhere:  # bounded at positions, the peaks of the error among them
            kept = kept and self._peaks is not None
        rows = [(boxes, self._value(low), self._value(best)) for boxes, low, best in joint_history(searches)]
        boxes, left = sum(item.boxes for item in searches), sum(len(item.open) + len(item.tiny) for item in searches)
        covers = tuple(_cover(item, file) for item, file in zip(searches, variants, strict=True)) if kept and closed else ()
        return self._proven(closed, lower, boxes, 0 if self._exact else left, rows, covers)

    def _proven(
        self,
        closed: bool,
        lower: float,
        boxes: int,
        left: int,
        rows: list[tuple[int, float, float]],
        covers: tuple[Cover, ...] = (),
    ) -> Certificate:
        """Return the certificate of the best known design for a lower bound of the objective."""
        return Certificate(
            status=self._status(closed, lower),
            objective=self._known,
            lower_bound=lower,
            asked=self.gap,
            boxes=boxes,
            open_boxes=left,
            unknowns=tuple(self.result.problem.model.free),
            improved=self.improved,
            history=np.array(rows, dtype=float).reshape(-1, 3),
            covers=covers,
            peaks=np.zeros(0) if self._peaks is None else self._peaks,
        )


class _ErrorSearch(_Search):
    """The search of a function whose largest error is minimised: over start angles, with all link lengths at once."""

    def run(self, seconds: float, boxes: float, progress: Proving) -> Any:
        """Search all assembly modes."""
        begin = time.perf_counter()
        model, share = self.original.spec, GAP_SHARE * self.gap
        proof = certify_function(model, self._known, self.result.design, share, seconds, boxes, progress, self._from_candidate)
        certificate = self._proven(proof.status == CLOSED, proof.lower, proof.boxes, len(proof.open), proof.history)
        return self._with(certificate, begin, interrupted=proof.status == INTERRUPTED)

    def _from_candidate(self, design: dict[str, float], side: int) -> float:
        """Search from a candidate [m, rad] of an assembly mode; return the objective of the best known design."""
        variant = next(file for file in self.original.variants() if file.spec.four_bar and file.spec.four_bar.side == side)
        self._search_locally(variant, {name: design[name] for name in self.original.model.free})
        return self._known


class _PathSearch(_Search):
    """The search of a timed path of a four-bar: over its proportions, all assembly modes at once."""

    def run(self, seconds: float, boxes: float, progress: Proving) -> Any:
        """Search all assembly modes."""
        from optlink.solvers.global_search.timed_path import TimedPathBounds

        begin, interrupted = time.perf_counter(), False
        bounds = TimedPathBounds(self.original.spec)
        search = self._branches(bounds, self._squared, functools.partial(self._from_box, bounds), PATH_BOXES)
        try:
            if not self._exact:  # else nothing is smaller
                search.run(seconds, boxes, functools.partial(self._report, progress, [search], 0))
        except KeyboardInterrupt:
            interrupts.handled()
            interrupted = True
        return self._with(self._certificate([search], [self.original]), begin, interrupted=interrupted)

    def _from_box(self, bounds: TimedPathBounds, x: Array) -> float:
        """Search from the four-bar at a point, if it is within the bounds."""
        values, free = bounds.design(x), bounds.problem.free
        quantities = bounds.problem.quantities
        inside = all(quantities[name].bounds[0] <= values[name] <= quantities[name].bounds[1] for name in free)
        if inside:
            variants, left = self.original.variants(), bounds.left(x)
            sides = [file.spec.four_bar is not None and file.spec.four_bar.side > 0 for file in variants]
            variant = variants[sides.index(left) if left in sides else 0]
            self._search_locally(variant, {name: values[name] for name in free})
        return self._squared


def _cover(search: BranchAndBound, variant: ProblemFile) -> Cover:
    leaves, bounds = search.leaves, search.bounder
    assert isinstance(bounds, LagrangianBounds)
    if not bounds.problem.limits:  # unnamed if other processes bounded every box
        bounds.problem.over(bounds.low[None], bounds.high[None])
    return Cover(
        variant.raw["mechanism"].get("assembly", "left"),
        np.concatenate(leaves.low),
        np.concatenate(leaves.high),
        np.concatenate(leaves.test),
        np.concatenate(leaves.multipliers),
        bounds.problem.limits,
        sides_of(variant.model.linkage),
    )


def _local(result: SynthesisResult, variant: ProblemFile, start: dict[str, float]) -> SynthesisResult | None:
    """Return the result with the local optimum near a point as its design; None if it is not valid."""
    from optlink.solvers.contract import BACKENDS
    from optlink.tasks.search import Polisher

    polisher = Polisher([variant], result.backend if result.backend in BACKENDS else "ipopt")
    design = polisher.from_values(0, start, None)
    if not design.valid and inexact(design.status, design.validation):
        design = polisher.refined(design)
    if not design.valid:
        return None
    return replace(result, designs=(design, *result.designs)[: max(1, len(result.designs))], nearest=None)
