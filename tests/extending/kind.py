"""A kind of problem and result: how near a point gets to the crank pivot, `[clearing] point = "C"`, `least = "300 mm"`."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from optlink import ProblemFile, Status
from optlink.extending import (
    Array,
    Check,
    DesignTask,
    FixedLength,
    Problem,
    ProblemKind,
    Search,
    Section,
    SingleResult,
    Validation,
    extremes,
    register,
)
from optlink.linkage import sweep


class Clearing(Section):
    point: str
    least: FixedLength


class ClearingProblem(Problem):
    clearing: Clearing

    @property
    def task(self) -> str:
        return "clearing"


@dataclass(frozen=True, eq=False, repr=False)
class ClearingResult(SingleResult):
    kind: ClassVar = "clearing"
    shown: ClassVar = {"valid": "valid", "distance_m": "objective"}

    @property
    def machine(self) -> ProblemFile:
        return self.problem


def distances(model: ClearingProblem, angles: Array) -> Array:
    motion = sweep(model.linkage, model.design({}), angles)
    pivot, point = motion.mechanism.crank.start, model.clearing.point
    return np.asarray(np.linalg.norm(motion.position(point) - motion.position(pivot), axis=1))


class ClearingTask(DesignTask[ClearingResult]):
    def search(self, problem: ProblemFile, search: Search) -> ClearingResult:
        model = problem.model
        assert isinstance(model, ClearingProblem)
        computed = float(extremes(lambda at: distances(model, at)[None, :], np.linspace(0.0, 2.0 * np.pi, 361))[1][0, 0])
        swept, least = float(np.min(distances(model, np.linspace(0.0, 2.0 * np.pi, 20001)))), model.clearing.least.value
        checks = (
            Check("least distance", computed >= least, computed * 1e3, f">= {least * 1e3:.6g}", "mm"),
            Check("agrees with a sweep", abs(computed - swept) <= 1e-6 * swept, abs(computed - swept) * 1e3, "<= 1e-06", ""),
        )
        return ClearingResult(problem, Status.NOT_SEARCHED, "none", {}, computed, Validation(checks, swept), {})


register(ProblemKind("clearing", ClearingTask, "clearing", ClearingProblem))
