"""Find the design with the largest yield for a limit of the error.

The yield is that of common random samples, each moved exactly. It is smoothed by letting a sample
pass with the probability of a normal deviate about the limit, first a wide one, and maximised without derivatives, in coordinates
in which equal steps in any direction have equal effect on the error.

References
----------
T. M. Ragonneau, Z. Zhang, COBYQA (2024), as scipy.optimize.minimize(method="COBYQA").
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from optlink.errors import InputError
from optlink.execution.runner import ordered
from optlink.execution.worker import Runs
from optlink.linkage.vector2d import Array
from optlink.optimization.nlp import NLP
from optlink.optimization.programme import build
from optlink.problem.file import ProblemFile
from optlink.problem.tolerances import NORMAL, Deviation
from optlink.studies.tolerance.linear import linear_analysis
from optlink.studies.tolerance.monte_carlo import largest_errors, monte_carlo
from optlink.studies.tolerance.nominal import nominal_design
from optlink.studies.tolerance.options import read_deviations
from optlink.studies.tolerance.robust_design import RobustDesign, RobustSearch
from optlink.studies.tolerance.sampling import sample_deviations
from optlink.tasks.design import validate

SIGMAS = 2.0  # standard deviations of the robust starting design
STAGES = ((1 << 12, 1.0, 1.0), (1 << 14, 0.1, 0.3))  # samples, and relative to the scatter: smoothing width, first step
LAST_STEP, MAX_STEPS = 0.01, 300
SCRAP_OFFSET = 1e-5  # added to the scrap rate, so that single samples do not drive the search
MIN_SLOPE = 1e-3  # least slope, relative to that of the steepest direction
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
        return _Search(self.file, nlp, self.deviations, self.limit, self.seed, self.starts[index]).end()


class _Search:
    """Search from one design: x = x_start + steps @ z, where z = 1 changes the error by as much as it scatters."""

    def __init__(
        self,
        file: ProblemFile,
        nlp: NLP,
        deviations: Sequence[Deviation],
        limit: float,
        seed: int,
        start: Mapping[str, float],
    ) -> None:
        self.file, self.nlp, self.deviations, self.limit, self.seed = file, nlp, deviations, limit, seed
        self.x = nlp.x_of(dict(start))
        self.bounded = np.isfinite(nlp.lower), np.isfinite(nlp.upper)
        self.scatter = max(float(np.std(self._sizes(self.x, self._sampled_deviations(STAGES[0][0])))), 1e-3 * limit)
        slopes = nlp.residual_derivatives(self.x)
        _, size, axes = np.linalg.svd(slopes / math.sqrt(len(slopes)))
        self.steps = self.scatter * axes.T / np.maximum(np.pad(size, (0, len(axes) - len(size))), MIN_SLOPE * size[0])

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
