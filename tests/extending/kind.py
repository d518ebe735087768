"""A kind of problem and result: how near a point gets to the crank pivot, `[clearing] point = "C"`, `least = "300 mm"`."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from optlink import Status
from optlink.extending import (
    Check,
    DesignTask,
    FixedLength,
    Problem,
    ProblemKind,
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
    task = property(lambda self: "clearing")


@dataclass(frozen=True, eq=False, repr=False)
class ClearingResult(SingleResult):
    kind = "clearing"
    shown: ClassVar = {"valid": "valid", "distance_m": "objective"}
    machine = property(lambda self: self.problem)


def distances(problem, angles):
    motion = sweep(problem.model.linkage, problem.model.design({}), angles)
    pivot, point = motion.mechanism.crank.start, problem.model.clearing.point
    return np.linalg.norm(motion.position(point) - motion.position(pivot), axis=1)


class ClearingTask(DesignTask):
    def search(self, problem, search):
        computed = float(extremes(lambda at: distances(problem, at)[None, :], np.linspace(0.0, 2.0 * np.pi, 361))[1][0, 0])
        swept, least = float(np.min(distances(problem, np.linspace(0.0, 2.0 * np.pi, 20001)))), problem.model.clearing.least.value
        checks = (
            Check("least distance", computed >= least, computed * 1e3, f">= {least * 1e3:.6g}", "mm"),
            Check("agrees with a sweep", abs(computed - swept) <= 1e-6 * swept, abs(computed - swept) * 1e3, "<= 1e-06", ""),
        )
        return ClearingResult(problem, Status.NOT_SEARCHED, "none", {}, computed, Validation(checks, swept), {})


register(ProblemKind("clearing", ClearingTask, "clearing", ClearingProblem))
