"""Robust designs: minimise the largest error plus k standard deviations, or plus the worst case.

`optlink solve` does this for a robust problem file; here the tolerances may come from the command line, and the
nominal optimum is found as well.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from optlink.errors import InputError
from optlink.execution.runner import ordered
from optlink.execution.worker import Runs
from optlink.linkage.vector2d import Array
from optlink.optimization.nlp import NLP
from optlink.optimization.programme import build
from optlink.problem.document import Number, Source
from optlink.problem.file import ProblemFile
from optlink.problem.rounding import NO_GRID
from optlink.problem.tolerances import MAX_SIGMAS, NORMAL, WORST, Deviation
from optlink.studies.tolerances.monte_carlo import largest_errors, linear_analysis, monte_carlo
from optlink.studies.tolerances.nominal import nominal_design
from optlink.studies.tolerances.sampling import read_deviations, read_tolerances, sample_deviations
from optlink.tasks.design import solve, validate
from optlink.tasks.protocol import completed
from optlink.tasks.results.design import SynthesisResult
from optlink.tasks.run import solve as solve_nominal
from optlink.units import DISPLAYED

YIELD = "yield"
STEPS, LIMIT_TOLERANCE = 12, 1e-5  # of the search for the largest number of standard deviations, and its relative accuracy
MIN_SLOPE = 1e-12  # [SI] per standard deviation; least slope of the secants


@dataclass(frozen=True)
class RobustDesign:
    """A robust design, `result`, and the nominal optimum, `nominal` [SI]; `before` [SI]: objective of the latter.

    `sigmas`: number of standard deviations, None: the worst case; `by_yield`: the yield was maximised instead.
    """

    shown: ClassVar[Mapping[str, Source]] = {
        "counted": "counted",
        "status": "result.status",
        "valid": "result.valid",
        "kkt": lambda robust: getattr(robust.result.solution, "kkt", None),
        "design_SI": "result.design",
        "nominal_design_SI": "nominal",
        "largest_SI": "result.objective",
        "largest_of_the_nominal_design_SI": "before",
        "failed_checks?": lambda robust: robust.result.validation.failed or None,
    }

    result: SynthesisResult
    nominal: dict[str, Number]
    sigmas: float | None
    before: float
    by_yield: bool = False

    @property
    def counted(self) -> str:
        """Name of the term added to the error, or "yield" if it was maximised."""
        if self.by_yield:
            return YIELD
        return "the worst case" if self.sigmas is None else f"{self.sigmas:.4g} standard deviations"

    @property
    def free(self) -> dict[str, float]:
        """Design variables [SI]."""
        return {name: self.result.design[name] for name in self.result.problem.model.free}


def robust(problem: ProblemFile, tolerances: Sequence[str], sigmas: float | None = 3.0, *, shape: str = NORMAL) -> RobustDesign:
    """Minimise the largest error, including its scatter."""
    if sigmas is not None and not 0.0 <= sigmas <= MAX_SIGMAS:
        remedy = f"Give 0 to {MAX_SIGMAS:g} standard deviations, or worst, margin or yield"
        raise InputError("out of range", remedy, key="--robust", value=sigmas)
    return RobustSearch(problem, tolerances, shape).least(sigmas)


def most_reliable(problem: ProblemFile, tolerances: Sequence[str], limit: float, *, shape: str = NORMAL) -> RobustDesign:
    """Return the design that keeps a limit of its error with the largest number of standard deviations.

    Its number of standard deviations is that for which the minimised value equals the limit.
    """
    redesign = RobustSearch(problem, tolerances, shape)
    before = redesign.least(0.0)
    if before.result.objective > limit:
        factor, unit = DISPLAYED[problem.spec.unit]
        least, stated = (f"{factor * value:.4g} {unit}".strip() for value in (before.result.objective, limit))
        message = f"no design meets the limit, even without tolerances: the smallest largest error found is {least}"
        raise InputError(message, f"Give more than {least}", problem.file, "--limit", stated)
    current, sigmas = redesign.least(1.0, before.free), 1.0
    for _ in range(STEPS):  # secant method: the minimum is nearly linear in them
        rise = (current.result.objective - before.result.objective) / (sigmas - (before.sigmas or 0.0))
        proposed = min(max(sigmas + (limit - current.result.objective) / max(rise, MIN_SLOPE), 0.0), MAX_SIGMAS)
        if abs(current.result.objective - limit) <= LIMIT_TOLERANCE * limit or proposed == sigmas:
            break
        before, current, sigmas = current, redesign.least(proposed, current.free), proposed
    return current


def check_targets(problem: ProblemFile) -> None:
    """Check that the errors of one requirement are all that is minimised."""
    if not problem.model.parts or problem.spec.composed:
        message = "robust design minimises the error of one requirement alone, which this problem does not have"
        raise InputError(message, "Analyse its designs without --robust", problem.file, "--robust")


class RobustSearch:
    """Search of robust designs of one problem from its nominal optimum, `nominal` [SI]; `problem`: with its tolerances."""

    def __init__(self, problem: ProblemFile, tolerances: Sequence[str], shape: str) -> None:
        check_targets(problem)
        entries = {name: tolerance.raw for name, tolerance in read_tolerances(problem, tolerances, shape).items()}
        first: Any = completed(solve_nominal(problem.override({"requirement.robust": None}), rounding=NO_GRID))
        if not first.valid:
            raise InputError("no valid design was found to start from", "See `optlink solve`", problem.file)
        self.nominal = first.design
        try:
            self.problem = first.definite.override({"requirement.measure": "max", "tolerances": entries})
        except InputError as error:
            if not tolerances:
                raise
            keys = [(fault.key or "").replace("tolerances.", "--tolerance ", 1) for fault in error.faults]
            raise InputError([replace(fault, key=key) for fault, key in zip(error.faults, keys, strict=True)]) from None

    def least(self, sigmas: float | None, start: Mapping[str, float] | None = None) -> RobustDesign:
        """Minimise the largest error including its scatter."""
        problem = self.problem.override({"requirement.robust": WORST if sigmas is None else f"{sigmas!r} sigma"})
        result = completed(solve(problem, begin=self.nominal if start is None else start))
        return RobustDesign(result, dict(self.nominal), sigmas, validate(problem, self.nominal).objective)


# Find the design with the largest yield for a limit of the error.
#
# The yield is that of common random samples, each moved exactly. It is smoothed by letting a sample pass with the probability of
# a normal deviate about the limit, first a wide one, and maximised without derivatives, in coordinates in which equal steps in
# any direction have equal effect on the error.
#
# References
# ---------- T. M. Ragonneau, Z. Zhang, COBYQA (2024), as scipy.optimize.minimize(method="COBYQA").

SIGMAS = 2.0  # standard deviations of the robust starting design
STAGES = ((1 << 12, 1.0, 1.0), (1 << 14, 0.1, 0.3))  # samples, and relative to the scatter: smoothing width, first step
LAST_STEP, MAX_STEPS = 0.01, 300
SCRAP_OFFSET = 1e-5  # added to the scrap rate, so that single samples do not drive the search
MIN_YIELD_SLOPE = 1e-3  # least slope, relative to that of the steepest direction
UNASSEMBLED_ERROR = 10.0  # rad or m, error of a linkage that cannot be assembled


def maximise_yield(
    problem: ProblemFile,
    tolerances: Sequence[str],
    limit: float,
    samples: int,
    seed: int,
    *,
    shape: str = NORMAL,
    runs: Runs | None = None,
) -> RobustDesign:
    """Return the design with the largest yield, searched from the nominal optimum and a robust design and compared with both.

    `limit` [SI] of the error; `samples` of `seed` compare the designs, the search uses those of the next one.
    """
    redesign = RobustSearch(problem, tolerances, shape)
    file = redesign.problem.override({"requirement.robust": None})
    first = redesign.least(SIGMAS)
    starts = [{name: redesign.nominal[name] for name in file.model.free}, first.free]
    deviations = read_deviations(problem, nominal_design(file, None, None, starts[0]), tolerances, shape)

    def share(design: Mapping[str, float]) -> float:
        nominal = nominal_design(file, None, None, design)
        return monte_carlo(linear_analysis(file, nominal, deviations, limit), samples, seed, runs=runs).share

    task = YieldSearchTask(file, tuple(deviations), limit, seed + 1, tuple(starts))
    designs = list(ordered(task, len(starts), runs))
    able = [design for design in designs if validate(file, design).valid]
    best = max([*starts, *able], key=share)
    result = validate(file, best)
    return RobustDesign(result, redesign.nominal, 0.0, validate(file, redesign.nominal).objective, by_yield=True)


@dataclass(frozen=True)
class YieldSearchTask:
    """Searches from several designs [SI], each one a chunk for `optlink.execution.runner`."""

    file: ProblemFile
    deviations: tuple[Deviation, ...]
    limit: float
    seed: int
    starts: tuple[Mapping[str, float], ...]

    def __call__(self, index: int) -> dict[str, float]:
        """Return the design [SI] that is found from a start."""
        nlp = build(self.file.override({"requirement.measure": "sum of squares"}).spec)
        return _Search(self, nlp, self.starts[index]).end()


class _Search:
    """Search from one design: x = x_start + steps @ z, where z = 1 changes the error by as much as it scatters."""

    def __init__(self, task: YieldSearchTask, nlp: NLP, start: Mapping[str, float]) -> None:
        self.file, self.nlp, self.deviations, self.limit, self.seed = task.file, nlp, task.deviations, task.limit, task.seed
        self.x = nlp.x_of(dict(start))
        self.bounded = np.isfinite(nlp.lower), np.isfinite(nlp.upper)
        self.scatter = max(float(np.std(self._sizes(self.x, self._sampled_deviations(STAGES[0][0])))), 1e-3 * self.limit)
        slopes = nlp.residual_derivatives(self.x)
        _, size, axes = np.linalg.svd(slopes / math.sqrt(len(slopes)))
        self.steps = self.scatter * axes.T / np.maximum(np.pad(size, (0, len(axes) - len(size))), MIN_YIELD_SLOPE * size[0])

    def end(self) -> dict[str, float]:
        """Return the final design [SI]."""
        from scipy.optimize import minimize
        from scipy.special import ndtr

        z = np.zeros(len(self.x))
        for samples, width, step in STAGES:
            batches, wide = self._sampled_deviations(samples), width * self.scatter

            def scrap(z: Array, batches: list[Array] = batches, wide: float = wide) -> float:
                beyond = self._sizes(self.x + self.steps @ z, batches) - self.limit
                return math.log(float(np.mean(ndtr(beyond / wide))) + SCRAP_OFFSET)

            result = minimize(
                scrap,
                z,
                method="COBYQA",
                constraints=[{"type": "ineq", "fun": lambda z: self._room(self.x + self.steps @ z)}],
                options={"initial_tr_radius": step, "final_tr_radius": LAST_STEP * step, "maxfev": MAX_STEPS},
            )
            z = np.asarray(result.x, dtype=float)
        return self.nlp.design(self.x + self.steps @ z)

    def _sampled_deviations(self, samples: int) -> list[Array]:
        return list(sample_deviations(self.deviations, samples, self.seed))

    def _sizes(self, x: Array, batches: Sequence[Array]) -> Array:
        """Return the largest error of every sample [SI]."""
        try:
            nominal = nominal_design(self.file, None, None, self.nlp.design(x))
        except InputError:  # it cannot be assembled as drawn
            return np.full(sum(map(len, batches)), UNASSEMBLED_ERROR)
        errors = np.concatenate([largest_errors(nominal, self.deviations, batch) for batch in batches])
        return np.where(np.isfinite(errors), errors, UNASSEMBLED_ERROR)

    def _room(self, x: Array) -> Array:
        """Return the slack of bounds and limits; negative if violated."""
        entries = np.concatenate([x, self.nlp.values(x, self.nlp.p)[1]])
        low, high = self.bounded
        room = np.concatenate([(entries - self.nlp.lower)[low], (self.nlp.upper - entries)[high]])
        return np.where(np.isfinite(room), room, -1.0)
