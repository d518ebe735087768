"""Compare kinds of clearance control from several starts, and tune controller parameters."""

from collections.abc import Mapping, Sequence
from typing import Any, Unpack

import numpy as np

from optlink.clearance.columns import Output
from optlink.clearance.control import Control, resumed
from optlink.errors import InputError
from optlink.execution.options import Execution, ResumableExecution
from optlink.execution.runner import check as check_engine, pool
from optlink.execution.worker import Runs
from optlink.linkage.vector2d import TURN, Array
from optlink.problem.arguments import typed
from optlink.problem.base_model import SPELLINGS
from optlink.problem.file import AnyProblem, ProblemFile, problem_of
from optlink.problem.quantity import check_choice, check_range
from optlink.tasks.clearance import check_simulations
from optlink.tasks.machine import check_design, machine_of
from optlink.tasks.parallel_runs import RunJob, RunResult, run_jobs
from optlink.tasks.results.clearance import (
    Comparison,
    ComparisonCheckpoint,
    CompleteRun,
    Trials,
    Tuning,
    TuningCheckpoint,
    read_checkpoint,
)

KINDS = tuple(str(kind) for kind in Control)
ROUNDING = 1e-9  # relative difference of equal errors, beyond which a run stops early


def random_crank_angles(count: int, seed: int) -> Array:
    """Return uniformly distributed initial crank angles (count,) [rad]."""
    check_range("starts", count, 1, 10_000)
    if seed < 0:
        raise InputError("a seed must not be negative", "Give zero or more", key="seed", value=seed)
    return np.random.default_rng(seed).uniform(0.0, TURN, count)


def _trials(runs: Sequence[RunResult]) -> Trials:
    """Return the figures of one kind of control from its runs; NaN for a run that stalled."""
    unit = runs[0].unit
    names = (f"rms_{unit}", f"peak_{unit}", "correction_rms_rad", "torque_rms_Nm")
    rms, peak, correction, torque = np.array(
        [[run.figures[name] if run.finished else np.nan for name in names] for run in runs]
    ).T
    return Trials(rms, peak, correction, torque, all(run.finished for run in runs))


def _where(options: ResumableExecution) -> Execution:
    """Return where runs are computed: by default in the calling process."""
    engine, workers = options.get("engine", "local"), options.get("workers")
    workers = 1 if workers is None and engine == "local" else workers
    return {"engine": engine, "workers": workers, "scheduler": options.get("scheduler")}


@typed
def compare(
    problem: AnyProblem,
    revolutions: int = 15,
    starts: int = 5,
    seed: int = 0,
    *,
    kinds: Sequence[str] = KINDS,
    speed: float | None = None,
    points: int = 200,
    tolerance: float = 1e-8,
    design: Mapping[str, float | str] | None = None,
    integrator: str = "auto",
    **execution: Unpack[ResumableExecution],
) -> Comparison:
    """Compare kinds of clearance control by simulations from several random initial crank angles.

    Parameters
    ----------
    problem : ProblemFile, str or Path
        From `optlink.load`, the name of a shipped problem, or a file, with joint clearance, `[drive] servo` and `[control]`.
    revolutions : int
        Revolutions per run. With more than ten, the statistics omit the first five.
    starts : int
        Number of initial crank angles.
    seed : int
        Seed of the initial crank angles.
    kinds : sequence of str
        Kinds of control: "none", "inverse", "pid", "inverse+pid".
    speed : float [rad/s], optional
        Nominal crank speed. Default: that of the problem.
    points : int
        Rows per revolution.
    tolerance : float
        Relative tolerance of the integrator.
    design : mapping of str to float [SI] or str, optional
        Values of design variables. Default: their starting values.
    integrator : str
        As in `simulate_clearance`; "auto" counts all runs.
    **execution : ResumableExecution
        Where the runs are computed, by default in the calling process only. A checkpoint is made after every run; its runs are
        not repeated.

    Returns
    -------
    Comparison
        Mean error and scatter of every kind of control, and the statistics of every run.

    Raises
    ------
    InputError
        If the problem has no clearance, servo or controller, or the checkpoint belongs to other options.
    KeyboardInterrupt
        On interruption; the last checkpoint contains all complete runs.

    Examples
    --------
    >>> problem = optlink.load("crank-rocker-clearance")
    >>> result = optlink.control.compare(problem, revolutions=2, starts=1, kinds=["none", "pid"], points=36)
    >>> round(result.gain("pid"), 3)  # share by which the mean error decreases
    0.124
    """
    problem = problem_of(problem)
    angles = random_crank_angles(starts, seed)
    if not kinds:
        raise InputError("no control is compared", f"Give some of {', '.join(KINDS)}", key="kinds")
    for kind in kinds:
        check_choice("kinds", kind, KINDS, "no such control")
    where, progress = _where(execution), execution.get("progress")
    checkpoint, resume = execution.get("checkpoint"), execution.get("resume")
    check_engine(**where)
    common: dict[str, Any] = {"revolutions": revolutions, "points": points, "tolerance": tolerance, "speed": speed}
    common["design"] = check_design(problem, design)
    integrator = resumed(integrator, resume)
    for kind in kinds:  # refuse options that no run accepts, before any process starts; and compile, once for all
        _, integrator = check_simulations(problem, control=kind, integrator=integrator, runs=starts * len(kinds), **common)
    common["integrator"] = integrator
    label = {**common, "problem_hash": problem.hash, "kinds": list(kinds), "starts": starts, "seed": seed}
    kept = {} if resume is None else _runs(read_checkpoint(ComparisonCheckpoint, resume, label))
    # ordered by start, so that the progress predicts the remaining time; figures need the whole first run of each kind
    order = [(kind, k) for k in range(starts) for kind in kinds]
    runs: dict[tuple[str, int], RunResult] = {key: kept[key] for key in order if key in kept and key[1] > 0}
    todo = [key for key in order if key not in runs]
    jobs = [RunJob(problem, control=kind, start=float(angles[k]), example=k == 0, **common) for kind, k in todo]
    if progress is not None:
        progress(len(runs) / len(order))
    with pool(**where) as work:
        for index, ran in run_jobs(jobs, work):
            runs[todo[index]] = kept[todo[index]] = ran
            if checkpoint is not None:
                finished = [_run(key, kept[key]) for key in order if key in kept]
                checkpoint(ComparisonCheckpoint(**label, complete=len(kept), total=len(order), runs=finished).document())
            if progress is not None:
                progress(len(runs) / len(order))
    every = {kind: _trials([runs[kind, k] for k in range(starts)]) for kind in kinds}
    examples = {kind: run for kind in kinds if (run := runs[kind, 0].simulation) is not None}
    return Comparison(problem, every, angles, seed, revolutions, examples, runs[kinds[0], 0].unit)


def _run(key: tuple[str, int], ran: RunResult) -> CompleteRun:
    figures = {name: value for name, value in ran.figures.items() if np.isfinite(value)}
    return CompleteRun(control=key[0], start=key[1], unit=ran.unit, finished=ran.finished, figures=figures)


def _runs(begun: ComparisonCheckpoint) -> dict[tuple[str, int], RunResult]:
    """Return the runs of a checkpoint."""
    return {(run.control, run.start): RunResult(run.figures, run.unit, run.finished) for run in begun.runs}


RANGES: dict[str, tuple[float, float]] = {
    "regularisation": (1e-3, 3e-2),
    "bandwidth": (0.1, 1.0),
    "proportional": (1e-2, 1.0),
    "integral": (1.0, 1e3),
    "derivative": (1e-6, 1e-3),
}
"""Where parameters are sought, in their logarithm; regularisation per size of the machine, bandwidth per that of the servo."""


@typed
def tune(
    problem: AnyProblem,
    control: str = "inverse+pid",
    names: Sequence[str] = ("proportional", "integral"),
    *,
    evaluations: int = 24,
    starts: int = 3,
    seed: int = 0,
    revolutions: int = 11,
    speed: float | None = None,
    points: int = 200,
    tolerance: float = 1e-8,
    design: Mapping[str, float | str] | None = None,
    integrator: str = "auto",
    **execution: Unpack[ResumableExecution],
) -> Tuning:
    """Tune controller parameters: minimise the mean error over several initial crank angles.

    The search uses no derivatives, because the error of a chaotic machine is noisy. Half of the evaluations are Sobol points
    over `RANGES`; the others contract around the best point. All parameter sets are evaluated from the same initial crank
    angles. An evaluation stops as soon as its runs so far raise the mean above the best one. If no set is better than the
    parameters of the problem, these are the result. The least of many noisy errors is too small, so the best set and the
    parameters of the problem are compared again, from as many other initial angles, those of the next seed.

    Parameters
    ----------
    problem : ProblemFile, str or Path
        From `optlink.load`, the name of a shipped problem, or a file, with joint clearance, `[drive] servo` and `[control]`.
    control : str
        Kind of control: "inverse", "pid" or "inverse+pid".
    names : sequence of str
        Parameters to tune, from `RANGES`.
    evaluations : int
        Number of parameter sets, 4 to 100,000.
    starts : int
        Number of initial crank angles.
    seed : int
        Seed of the initial crank angles and of the search.
    revolutions : int
        Revolutions per run.
    speed, points, tolerance, design, integrator
        As in `compare`.
    **execution : ResumableExecution
        As in `compare`; a checkpoint is made after every evaluation.

    Returns
    -------
    Tuning
        Best parameters, their error from the starts of the search and from others, and all evaluations.

    Raises
    ------
    InputError
        If an argument is out of range, a parameter has no effect with this control, the problem has no clearance, servo or
        controller, or the checkpoint belongs to other options.
    KeyboardInterrupt
        On interruption; the last checkpoint contains all complete evaluations.

    Examples
    --------
    >>> problem = optlink.load("crank-rocker-clearance")
    >>> result = optlink.control.tune(problem, "pid", ["proportional"], evaluations=4, starts=1, revolutions=2, points=36)
    >>> list(result.best), result.cost <= result.before
    (['proportional'], True)
    """
    problem = problem_of(problem)
    from scipy.stats import qmc

    names = list(dict.fromkeys(SPELLINGS.get(name, name) for name in names))
    unknown = [name for name in names if name not in RANGES]
    if unknown or not names:
        raise InputError("no such parameter", f"Known: {', '.join(RANGES)}", key="--tune", value=", ".join(unknown))
    check_range("evaluations", evaluations, 4, 100_000)
    where, progress = _where(execution), execution.get("progress")
    checkpoint, resume = execution.get("checkpoint"), execution.get("resume")
    check_engine(**where)
    angles, verification_angles = random_crank_angles(starts, seed), random_crank_angles(starts, seed + 1)
    low, high = (np.log([RANGES[name][side] for name in names]) for side in (0, 1))
    generator = np.random.default_rng(seed)
    sobol = qmc.Sobol(len(names), seed=seed).random(1 << int(np.ceil(np.log2(max(2, evaluations // 2)))))
    common: dict[str, Any] = {"revolutions": revolutions, "points": points, "tolerance": tolerance, "speed": speed}
    common["design"] = check_design(problem, design)
    integrator = resumed(integrator, resume)
    runs = starts * (evaluations + 1)
    output, integrator = check_simulations(problem, control=control, integrator=integrator, runs=runs, **common)
    common["integrator"] = integrator
    idle = next((name for name in names if not _has_effect(name, Control(control))), None)
    if idle is not None:
        raise InputError(f"the parameter has no effect with control {control}", "Tune inverse+pid", key="--tune", value=idle)
    label = {**common, "problem_hash": problem.hash, "control": control, "names": list(names)}
    label |= {"evaluations": evaluations, "starts": starts, "seed": seed}
    kept = [] if resume is None else read_checkpoint(TuningCheckpoint, resume, label).costs
    scores: list[tuple[float, float]] = []  # cost and scatter: of the parameters of the problem, then of every evaluation

    tested: list[Array] = []
    costs: list[float] = []
    together = where.get("workers") or starts

    def outcome(changed: ProblemFile, work: Runs) -> tuple[float, float]:
        """Return mean and scatter; infinite if a run stalls or the mean exceeds the best one, which stops it early."""
        most, room = starts * min((mean for mean, _ in scores), default=np.inf), starts * min(costs, default=np.inf)
        ran: dict[int, RunResult] = {}
        for first in range(0, starts, together):
            spent = sum(ran[k].figures[f"rms_{output.unit}"] for k in range(first))
            limit = min(most, room * (1.0 + ROUNDING) - spent)
            chunk = angles[first : first + together] if limit > 0.0 else angles[:0]
            jobs = [RunJob(changed, control=control, start=float(start), limit=limit, **common) for start in chunk]
            ran |= {first + k: run for k, run in run_jobs(jobs, work)}
            if not jobs or any(run.hopeless or not run.finished for run in ran.values()):
                return np.inf, np.nan
        trials = _trials([ran[k] for k in range(starts)])
        return (np.inf, np.nan) if trials.mean > min(costs, default=np.inf) else (trials.mean, trials.scatter)

    def cost(changed: ProblemFile, work: Runs) -> float:
        if len(scores) < len(kept):
            scores.append(kept[len(scores)])
        else:
            scores.append(outcome(changed, work))
            if checkpoint is not None:
                checkpoint(TuningCheckpoint(**label, complete=len(scores) - 1, total=evaluations, costs=scores).document())
        if progress is not None:
            progress(len(scores) / (evaluations + 3))
        return scores[-1][0]

    def verified(changed: ProblemFile, work: Runs) -> Trials:
        """Return the figures from the starts that the search does not use."""
        jobs = [RunJob(changed, control=control, start=float(start), **common) for start in verification_angles]
        ran = dict(run_jobs(jobs, work))
        return _trials([ran[k] for k in range(starts)])

    size = _reference_values(problem, output, common["design"])
    with pool(**where) as work:
        before = cost(problem, work)
        for k in range(evaluations):
            if k < evaluations // 2:
                share = sobol[k]
            else:
                width = 0.3 * 0.5 ** (4.0 * (k - evaluations // 2) / max(1, evaluations - evaluations // 2))
                share = np.clip(tested[int(np.argmin(costs))] + width * generator.standard_normal(len(names)), 0.0, 1.0)
            tested.append(share)
            costs.append(cost(problem.override(_values(names, np.exp(low + share * (high - low)), size, output.unit)), work))
        best = int(np.argmin(costs))
        better = costs[best] < before
        chosen = _values(names, np.exp(low + tested[best] * (high - low)), size, output.unit) if better else {}
        best_problem = problem.override(chosen) if better else problem
        check = (verified(problem, work), verified(best_problem, work)) if better else None
    if progress is not None:
        progress(1.0)
    values = np.exp(low + np.array(tested) * (high - low)) * np.array([size.get(name, 1.0) for name in names])
    cost_of_best, scatter = scores[best + 1 if better else 0]
    return Tuning(
        best_problem,
        {key.partition(".")[2]: value for key, value in chosen.items()},
        cost_of_best,
        scatter,
        before,
        dict(zip(names, values.T, strict=True)),
        np.array(costs),
        np.array([scatter for _, scatter in scores[1:]]),
        control,
        starts,
        seed,
        revolutions,
        output.unit,
        check,
    )


def _has_effect(name: str, kind: Control) -> bool:
    """Return whether a parameter has an effect on a kind of control."""
    return {"regularisation": kind is not Control.NONE, "bandwidth": kind.inverted}.get(name, kind.fed_back)


def _reference_values(problem: ProblemFile, output: Output, design: Mapping[str, float] | None) -> dict[str, float]:
    """Return the reference values of relative parameters [SI]."""
    servo = problem.model.drive.servo
    return {
        "regularisation": float(np.max(machine_of(problem, design).size)) if output.guide else 1.0,
        "bandwidth": servo.bandwidth.value if servo is not None else 1.0,
    }


def _values(names: Sequence[str], values: Array, size: Mapping[str, float], unit: str) -> dict[str, str | float]:
    """Return parameters in the form of a problem file."""
    units = {"regularisation": unit, "bandwidth": "rad/s"}
    settings: dict[str, str | float] = {}
    for name, value in zip(names, values, strict=True):
        rounded = float(f"{value * size.get(name, 1.0):.4g}")
        settings[f"control.{name}"] = f"{rounded!r} {units[name]}" if name in units else rounded
    return settings
