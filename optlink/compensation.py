"""What control makes of clearance: all kinds of control from several starts in one table, and the tuning of its parameters."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from optlink.clearance.control import Control
from optlink.clearances import LooseSimulation, simulate_clearance
from optlink.design.files import ProblemFile
from optlink.documents import finite, head
from optlink.errors import Fault, InputError

Array = NDArray[np.float64]
SCHEMA = "optlink/compensation/1"
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


@dataclass(frozen=True)
class Comparison:
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


def trials(
    problem: ProblemFile,
    kind: str,
    starts: Array,
    revolutions: int,
    *,
    speed: float | None = None,
    points: int = 200,
    tolerance: float = 1e-8,
    design: Mapping[str, float] | None = None,
    done: Callable[[], None] | None = None,
) -> tuple[Trials, LooseSimulation]:
    """One kind of control from several starts, and the simulation from the first."""
    found = []
    for start in starts:
        found.append(
            simulate_clearance(
                problem, revolutions, points, speed, kind, start=float(start), design=design, tolerance=tolerance, twin=False
            )
        )
        if done is not None:
            done()
    unit = found[0].output.unit
    table = np.array(
        [[run.figures[name] for name in (f"rms_{unit}", f"peak_{unit}", "correction_rms_rad", "torque_rms_Nm")] for run in found]
    )
    rms, peak, correction, torque = table.T
    return Trials(rms, peak, correction, torque, all(run.finished for run in found)), found[0]


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
    progress: Callable[[float], None] | None = None,
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

    Raises
    ------
    InputError
    """
    angles = starts_of(starts, seed)
    count, done = len(kinds) * len(angles), 0

    def tick() -> None:
        nonlocal done
        done += 1
        if progress is not None:
            progress(done / count)

    every: dict[str, Trials] = {}
    examples: dict[str, LooseSimulation] = {}
    for kind in kinds:
        every[kind], examples[kind] = trials(
            problem, kind, angles, revolutions, speed=speed, points=points, tolerance=tolerance, design=design, done=tick
        )
    unit = next(iter(examples.values())).output.unit
    return Comparison(problem, every, angles, seed, revolutions, examples, unit)


RANGES: dict[str, tuple[float, float]] = {
    "regularisation": (1e-3, 3e-2),
    "bandwidth": (0.1, 1.0),
    "proportional": (1e-2, 1.0),
    "integral": (1.0, 1e3),
    "derivative": (1e-6, 1e-3),
}
"""Where parameters are sought, in their logarithm; regularisation per size of the machine, bandwidth per that of the servo."""


@dataclass(frozen=True)
class Tuning:
    """A search for the parameters of a controller: `tried` values by name (evaluations,), their costs and scatters [m, rad].

    `problem`: the one with the `best` values, which are empty where its own were better. A cost is the mean root mean square of
    the error over the starts; of two costs that differ by less than the scatter neither is better.
    """

    problem: ProblemFile
    best: Mapping[str, str | float]
    cost: float
    scatter: float
    before: float
    tried: Mapping[str, Array]
    costs: Array
    scatters: Array


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
    tolerance: float = 1e-8,
    design: Mapping[str, float] | None = None,
    progress: Callable[[float], None] | None = None,
) -> Tuning:
    """Find parameters of a controller that make the mean error over several starts small.

    Half of the evaluations are Sobol points over `RANGES`, the others draw nearer and nearer to the best so far: the cost of a
    chaotic machine is noisy, so no slope is trusted. Every value is compared from the same starts. Where none is better than the
    problem's own parameters, these stay.

    Parameters
    ----------
    names : sequence of str
        Of `RANGES`.
    evaluations, starts, revolutions : int
        What the search may cost: their product, in revolutions.

    Raises
    ------
    InputError
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
    options: dict[str, Any] = {"speed": speed, "tolerance": tolerance, "design": design}
    before, first = trials(problem, control, angles, revolutions, **options)
    size = _sizes(first)
    tried: list[Array] = []
    costs: list[float] = []
    scatters: list[float] = []
    for k in range(evaluations):
        if k < evaluations // 2:
            share = sobol[k]
        else:
            width = 0.3 * 0.5 ** (4.0 * (k - evaluations // 2) / max(1, evaluations - evaluations // 2))
            share = np.clip(tried[int(np.argmin(costs))] + width * generator.standard_normal(len(names)), 0.0, 1.0)
        changed = problem.override(_values(names, np.exp(low + share * (high - low)), size, first.output.unit))
        found, _ = trials(changed, control, angles, revolutions, **options)
        tried.append(share)
        costs.append(found.mean if found.finished else np.inf)
        scatters.append(found.scatter)
        if progress is not None:
            progress((k + 1) / evaluations)
    values = np.exp(low + np.array(tried) * (high - low)) * np.array([size.get(name, 1.0) for name in names])
    best = int(np.argmin(costs))
    better = costs[best] < before.mean
    chosen = _values(names, np.exp(low + tried[best] * (high - low)), size, first.output.unit) if better else {}
    return Tuning(
        problem.override(chosen) if better else problem,
        {key.partition(".")[2]: value for key, value in chosen.items()},
        float(costs[best]) if better else before.mean,
        float(scatters[best]) if better else before.scatter,
        before.mean,
        dict(zip(names, values.T, strict=True)),
        np.array(costs),
        np.array(scatters),
    )


def _sizes(run: LooseSimulation) -> dict[str, float]:
    """What the relative parameters are measured by [SI]."""
    servo = run.problem.model.drive.servo
    return {
        "regularisation": float(np.max(run.machine.size)) if run.output.guide else 1.0,
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
