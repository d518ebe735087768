"""What control makes of clearance: all kinds of control from several starts in one table, and the tuning of its parameters."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from optlink.clearance.controller import Control
from optlink.clearance.output import Output
from optlink.errors import Fault, InputError
from optlink.io import Summary, finite, head
from optlink.problem.file import ProblemFile
from optlink.tasks.analyze import machine_of
from optlink.tasks.clearance import LooseSimulation, checked_output
from optlink.tasks.parallel_runs import Ran, job_of, perform_all

Array = NDArray[np.float64]
SCHEMA = "optlink/compensation/1"
TRIALS = "optlink/trials/1"
TUNING = "optlink/tuning/1"
TURN = 2.0 * np.pi
KINDS = tuple(str(kind) for kind in Control)


@dataclass(frozen=True)
class Trials:
    """One kind of control from several starts: root mean square and peak of the error [m, rad], correction, torque; (starts,).

    `correction` [rad] and `torque` [N m]: root mean squares, what the control costs.
    """

    rms: Array
    peak: Array
    correction: Array
    torque: Array
    finished: bool

    @property
    def mean(self) -> float:
        """Mean of the root mean squares."""
        return float(np.mean(self.rms))

    @property
    def scatter(self) -> float:
        """Standard deviation of the root mean squares."""
        return float(np.std(self.rms, ddof=1)) if len(self.rms) > 1 else 0.0


@dataclass(frozen=True, repr=False)
class Comparison(Summary):
    """What control makes of clearance: `trials` by kind of control, from crank angles `starts` (starts,) [rad].

    `examples`: the simulations from the first start, for pictures.
    """

    problem: ProblemFile
    trials: Mapping[str, Trials]
    starts: Array
    seed: int
    revolutions: int
    examples: Mapping[str, LooseSimulation]
    unit: str

    @property
    def finished(self) -> bool:
        """Whether every run was finished."""
        return all(trials.finished for trials in self.trials.values())

    def gain(self, kind: str) -> float:
        """Share of the uncompensated error (mean of the starts) that a kind of control takes away."""
        return 1.0 - self.trials[kind].mean / self.trials["none"].mean

    def to_dict(self) -> dict[str, Any]:
        """The comparison as a JSON document (SI)."""
        return finite(  # type: ignore[no-any-return]
            {
                **head(SCHEMA, self.problem, "finished" if self.finished else "stalled", self.seed),
                "revolutions": self.revolutions,
                "unit": self.unit,
                "starts_rad": self.starts,
                "trials": {name: {**vars(one), "mean": one.mean, "scatter": one.scatter} for name, one in self.trials.items()},
            }
        )


def starts_of(count: int, seed: int) -> Array:
    """Crank angles at the start [rad] (count,), drawn evenly from a revolution.

    Raises
    ------
    InputError
    """
    if not 1 <= count <= 10_000:
        raise InputError(Fault("out of range", "Give a number from 1 to 10,000", key="starts", value=count))
    if seed < 0:
        raise InputError(Fault("a seed is not negative", "Give zero or more", key="seed", value=seed))
    return np.random.default_rng(seed).uniform(0.0, TURN, count)


def _trials(runs: Sequence[Ran]) -> Trials:
    """One kind of control from its runs."""
    unit = runs[0].unit
    names = (f"rms_{unit}", f"peak_{unit}", "correction_rms_rad", "torque_rms_Nm")
    rms, peak, correction, torque = np.array([[run.figures[name] for name in names] for run in runs]).T
    return Trials(rms, peak, correction, torque, all(run.finished for run in runs))


def compare(
    problem: ProblemFile,
    revolutions: int = 15,
    starts: int = 5,
    seed: int = 0,
    *,
    kinds: Sequence[str] = KINDS,
    speed: float | None = None,
    points: int = 200,
    tolerance: float = 1e-8,
    design: Mapping[str, float] | None = None,
    workers: int | None = None,
    progress: Callable[[float], None] | None = None,
    checkpoint: Callable[[dict[str, Any]], None] | None = None,
    resume: Mapping[str, Any] | None = None,
) -> Comparison:
    """Run every kind of control from several random starts of the crank.

    Parameters
    ----------
    problem : ProblemFile
        With clearance, a servo and a controller.
    revolutions : int
        Of each run; the first five are left out of its statistics where there are more than ten.
    starts, seed : int
        Number of crank angles at the start, and the seed that they are drawn with.
    kinds : sequence of str
        Which kinds of control.
    workers : int, optional
        Processes to begin, which share the runs; left out: this process does all. Results are the same for any number. A script
        that begins processes must keep its own work below `if __name__ == "__main__":`.
    progress : function of the share that is done, optional
        All kinds run from the first start first, so that what is left takes about as long as the share says.
    checkpoint : function of a document, optional
        Called after every run with all that are complete; plain numbers, fit for JSON.
    resume : mapping, optional
        Such a document: runs that are in it are not repeated.

    Raises
    ------
    InputError
    KeyboardInterrupt
        when it is interrupted; the last checkpoint has what is complete.
    """
    angles = starts_of(starts, seed)
    common: dict[str, Any] = {
        "revolutions": revolutions,
        "points": points,
        "tolerance": tolerance,
        "speed": speed,
        "design": design,
    }
    label = {**common, "schema": TRIALS, "problem_hash": problem.hash, "kinds": list(kinds), "starts": starts, "seed": seed}
    label["design"] = None if design is None else dict(design)
    _check_options(problem, kinds, common)
    kept = {} if resume is None else _kept(resume, label)
    # start by start, so that what is done says how long the rest takes; pictures need the first start of each kind whole
    order = [(kind, k) for k in range(starts) for kind in kinds]
    runs: dict[tuple[str, int], Ran] = {key: kept[key] for key in order if key in kept and key[1] > 0}
    todo = [key for key in order if key not in runs]
    jobs = [job_of(problem, control=kind, start=float(angles[k]), whole=k == 0, **common) for kind, k in todo]
    if progress is not None:
        progress(len(runs) / len(order))
    for index, ran in perform_all(jobs, workers):
        runs[todo[index]] = kept[todo[index]] = ran
        if checkpoint is not None:
            checkpoint(
                {
                    **label,
                    "complete": len(kept),
                    "of": len(order),
                    "runs": [_document(key, kept[key]) for key in order if key in kept],
                }
            )
        if progress is not None:
            progress(len(runs) / len(order))
    every = {kind: _trials([runs[kind, k] for k in range(starts)]) for kind in kinds}
    examples = {kind: runs[kind, 0].simulation(problem, design) for kind in kinds}
    return Comparison(problem, every, angles, seed, revolutions, examples, runs[kinds[0], 0].unit)


def _check_options(problem: ProblemFile, kinds: Sequence[str], options: Mapping[str, Any]) -> None:
    """Refuse what no run can be made of before any process is begun."""
    for kind in kinds:
        checked_output(problem, control=kind, **options)


def _document(key: tuple[str, int], ran: Ran) -> dict[str, Any]:
    figures = {name: value for name, value in ran.figures.items() if np.isfinite(value)}
    return {"control": key[0], "start": key[1], "unit": ran.unit, "finished": ran.finished, "figures": figures}


def _kept(resume: Mapping[str, Any], label: Mapping[str, Any]) -> dict[tuple[str, int], Ran]:
    """The runs of a checkpoint.

    Raises
    ------
    InputError
        when it is damaged, or that of other options.
    """
    _same(resume, label)
    try:
        found = {}
        for one in resume["runs"]:
            figures = {str(name): float(value) for name, value in one["figures"].items()}
            ran = Ran(figures, str(one["unit"]), one["finished"] is True)
            _trials([ran])
            found[str(one["control"]), int(one["start"])] = ran
    except (KeyError, TypeError, ValueError, AttributeError):
        raise _damaged() from None
    return found


def _same(resume: Mapping[str, Any], label: Mapping[str, Any]) -> None:
    for name, value in label.items():
        if resume.get(name) != value:
            message = f"the checkpoint is that of another command: its {name} is {resume.get(name)!r}, not {value!r}"
            remedy = "Resume with the options of the interrupted command, or choose another folder"
            raise InputError(Fault(message, remedy, key="resume"))


def _damaged() -> InputError:
    return InputError(Fault("the checkpoint is damaged", "Start again without --resume", key="resume"))


RANGES: dict[str, tuple[float, float]] = {
    "regularisation": (1e-3, 3e-2),
    "bandwidth": (0.1, 1.0),
    "proportional": (1e-2, 1.0),
    "integral": (1.0, 1e3),
    "derivative": (1e-6, 1e-3),
}
"""Where parameters are sought, in their logarithm; regularisation per size of the machine, bandwidth per that of the servo."""


@dataclass(frozen=True, repr=False)
class Tuning(Summary):
    """A search for the parameters of a controller: `tried` values by name (evaluations,), their costs and scatters [m, rad].

    `problem`: the one with the `best` values, which are empty where its own were better. A cost is the mean root mean square of
    the error over the starts; of two costs that differ by less than the scatter neither is better. It is infinite where a run
    stalled, or was stopped because its error alone made the mean exceed the best so far.
    """

    problem: ProblemFile
    best: Mapping[str, str | float]
    cost: float
    scatter: float
    before: float
    tried: Mapping[str, Array]
    costs: Array
    scatters: Array
    control: str = "inverse+pid"
    starts: int = 1
    seed: int = 0
    revolutions: int = 11
    unit: str = "m"

    def to_dict(self) -> dict[str, Any]:
        """The search as a JSON document (SI)."""
        return finite(  # type: ignore[no-any-return]
            {
                **head(TUNING, self.problem, "finished", self.seed),
                **{
                    name: getattr(self, name)
                    for name in ("control", "starts", "revolutions", "unit", "before", "cost", "scatter")
                },
                "best": dict(self.best),
                "tried": dict(self.tried),
                "costs": self.costs,
                "scatters": self.scatters,
            }
        )


def tune(
    problem: ProblemFile,
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
    design: Mapping[str, float] | None = None,
    workers: int | None = None,
    progress: Callable[[float], None] | None = None,
    checkpoint: Callable[[dict[str, Any]], None] | None = None,
    resume: Mapping[str, Any] | None = None,
) -> Tuning:
    """Find parameters of a controller that make the mean error over several starts small.

    Half of the evaluations are Sobol points over `RANGES`, the others draw nearer and nearer to the best so far: the cost of a
    chaotic machine is noisy, so no slope is trusted. Every value is compared from the same starts. A run stops as soon as its
    error alone makes the mean exceed the best so far. Where none is better than the problem's own parameters, these stay.

    Parameters
    ----------
    problem : ProblemFile
        With clearance, a servo and a controller.
    control : str
        Kind of control: "inverse", "pid" or "inverse+pid".
    names : sequence of str
        Of `RANGES`.
    evaluations, starts, revolutions : int
        What the search may cost: their product, in revolutions.
    workers, progress, checkpoint, resume
        As in `compare`; the checkpoint has every evaluation that is complete.

    Raises
    ------
    InputError
    KeyboardInterrupt
        when it is interrupted; the last checkpoint has what is complete.
    """
    from scipy.stats import qmc

    unknown = [name for name in names if name not in RANGES]
    if unknown or not names:
        raise InputError(Fault("no such parameter", f"Known: {', '.join(RANGES)}", key="names", value=", ".join(unknown)))
    if not 4 <= evaluations <= 100_000:
        raise InputError(Fault("out of range", "Give a number from 4 to 100,000", key="evaluations", value=evaluations))
    angles = starts_of(starts, seed)
    low, high = (np.log([RANGES[name][side] for name in names]) for side in (0, 1))
    generator = np.random.default_rng(seed)
    sobol = qmc.Sobol(len(names), seed=seed).random(1 << int(np.ceil(np.log2(max(2, evaluations // 2)))))
    common: dict[str, Any] = {
        "revolutions": revolutions,
        "points": points,
        "tolerance": tolerance,
        "speed": speed,
        "design": design,
    }
    output = checked_output(problem, control=control, **common)
    label = {**common, "schema": TUNING, "problem_hash": problem.hash, "control": control, "names": list(names)}
    label |= {"evaluations": evaluations, "starts": starts, "seed": seed, "design": None if design is None else dict(design)}
    kept = [] if resume is None else _kept_costs(resume, label)
    done: list[tuple[float, float]] = []  # cost and scatter: of the problem's own parameters, then of every evaluation

    def cost(changed: ProblemFile) -> float:
        if len(done) < len(kept):
            done.append(kept[len(done)])
        else:
            limit = starts * min((one for one, _ in done), default=np.inf)
            jobs = [job_of(changed, control=control, start=float(start), limit=limit, **common) for start in angles]
            runs = dict(perform_all(jobs, workers))
            useless = any(run.hopeless or not run.finished for run in runs.values())
            found = None if useless else _trials([runs[k] for k in range(starts)])
            done.append((np.inf, np.nan) if found is None else (found.mean, found.scatter))
            if checkpoint is not None:
                checkpoint(
                    {**label, "complete": len(done) - 1, "of": evaluations, "costs": [[finite(x) for x in one] for one in done]}
                )
        if progress is not None:
            progress(len(done) / (evaluations + 1))
        return done[-1][0]

    before, size = cost(problem), _sizes(problem, output, design)
    tried: list[Array] = []
    costs: list[float] = []
    for k in range(evaluations):
        if k < evaluations // 2:
            share = sobol[k]
        else:
            width = 0.3 * 0.5 ** (4.0 * (k - evaluations // 2) / max(1, evaluations - evaluations // 2))
            share = np.clip(tried[int(np.argmin(costs))] + width * generator.standard_normal(len(names)), 0.0, 1.0)
        tried.append(share)
        costs.append(cost(problem.override(_values(names, np.exp(low + share * (high - low)), size, output.unit))))
    values = np.exp(low + np.array(tried) * (high - low)) * np.array([size.get(name, 1.0) for name in names])
    best = int(np.argmin(costs))
    better = costs[best] < before
    chosen = _values(names, np.exp(low + tried[best] * (high - low)), size, output.unit) if better else {}
    return Tuning(
        problem.override(chosen) if better else problem,
        {key.partition(".")[2]: value for key, value in chosen.items()},
        done[best + 1 if better else 0][0],
        done[best + 1 if better else 0][1],
        before,
        dict(zip(names, values.T, strict=True)),
        np.array(costs),
        np.array([scatter for _, scatter in done[1:]]),
        control,
        starts,
        seed,
        revolutions,
        output.unit,
    )


def _kept_costs(resume: Mapping[str, Any], label: Mapping[str, Any]) -> list[tuple[float, float]]:
    """The costs and scatters of a checkpoint."""
    _same(resume, label)
    try:
        return [
            (np.inf if cost is None else float(cost), np.nan if scatter is None else float(scatter))
            for cost, scatter in resume["costs"]
        ]
    except (KeyError, TypeError, ValueError):
        raise _damaged() from None


def _sizes(problem: ProblemFile, output: Output, design: Mapping[str, float] | None) -> dict[str, float]:
    """What the relative parameters are measured by [SI]."""
    servo = problem.model.drive.servo
    return {
        "regularisation": float(np.max(machine_of(problem, design).size)) if output.guide else 1.0,
        "bandwidth": servo.bandwidth.value if servo is not None else 1.0,
    }


def _values(names: Sequence[str], values: Array, size: Mapping[str, float], unit: str) -> dict[str, str | float]:
    """Parameters as a problem file states them."""
    units = {"regularisation": unit, "bandwidth": "rad/s"}
    found: dict[str, str | float] = {}
    for name, value in zip(names, values, strict=True):
        stated = float(f"{value * size.get(name, 1.0):.4g}")
        found[f"control.{name}"] = f"{stated!r} {units[name]}" if name in units else stated
    return found
