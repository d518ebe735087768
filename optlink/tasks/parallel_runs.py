"""Many clearance simulations as chunks of work: a run depends on its job only, so results are bit-identical for any engine."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from optlink.dynamics.forward import Ending
from optlink.execution.worker import Runs
from optlink.linkage.vector2d import Array
from optlink.problem.file import ProblemFile
from optlink.tasks.clearance import revolutions_counted, simulate_clearance
from optlink.tasks.results.clearance import ClearanceSimulation


class ErrorLimitExceeded(Exception):
    """The error of a run exceeds its limit, regardless of the remaining revolutions."""


@dataclass(frozen=True)
class RunJob:
    """One run from crank angle `start` [rad], with "cvodes" or "compiled" as integrator.

    It stops above an rms error of `limit` [m, rad]; an `example` returns the simulation for charts, not only its figures.
    """

    problem: ProblemFile
    control: str
    start: float
    revolutions: int
    points: int
    tolerance: float
    speed: float | None = None
    design: Mapping[str, float] | None = None
    integrator: str = "cvodes"
    limit: float = math.inf
    example: bool = False


@dataclass(frozen=True)
class RunResult:
    """Outcome of a run: figures, whether it finished or exceeded the error limit; optionally the simulation."""

    figures: Mapping[str, float]
    unit: str
    finished: bool
    hopeless: bool = False
    simulation: ClearanceSimulation | None = None


def run_job(job: RunJob) -> RunResult:
    """Perform a run."""
    count, seen, square = revolutions_counted(job.revolutions), 0, 0.0

    def judge(columns: Mapping[str, Array]) -> None:
        nonlocal seen, square
        seen += 1
        if seen > job.revolutions - count:
            square += sum(float(np.sum(values**2)) for name, values in columns.items() if ".error_" in name)
            if square > count * job.points * job.limit**2:
                raise ErrorLimitExceeded

    try:
        run = simulate_clearance(
            job.problem,
            job.revolutions,
            job.points,
            job.speed,
            job.control,
            start=job.start,
            design=job.design,
            tolerance=job.tolerance,
            check_predictability=False,
            integrator=job.integrator,
            stream=judge if math.isfinite(job.limit) else None,
        )
    except ErrorLimitExceeded:
        return RunResult({}, "", finished=False, hopeless=True)
    if run.ending is Ending.INTERRUPTED:
        raise KeyboardInterrupt
    return RunResult(dict(run.figures), run.output.unit, run.valid, simulation=_charted(run) if job.example else None)


def _charted(run: ClearanceSimulation) -> ClearanceSimulation:
    """Return a simulation with the columns that the charts of a comparison show."""
    output = run.output
    names = ("time_s", "crank_angle_deg", output.column, f"{output.name}.error_{output.unit}", "command.correction_rad")
    kept = [name for name in names if name in run.columns]
    return replace(run, columns={name: run.columns[name] for name in kept}, meanings={name: run.meanings[name] for name in kept})


@dataclass(frozen=True)
class RunTask:
    """Runs, each one a chunk for `optlink.execution.runner`."""

    jobs: tuple[RunJob, ...]

    def __call__(self, index: int) -> RunResult:
        """Perform a run."""
        return run_job(self.jobs[index])


def run_jobs(jobs: Sequence[RunJob], runs: Runs) -> Iterator[tuple[int, RunResult]]:
    """Perform jobs by the runs of `optlink.execution.runner.pool`, and yield each result with its index on completion."""
    for index, answer in runs(RunTask(tuple(jobs)), range(len(jobs))):
        yield index, answer.value
