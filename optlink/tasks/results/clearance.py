"""The result of a simulation with joint clearance, as data and JSON."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Annotated, Any, ClassVar, TypeVar

import numpy as np
from pydantic import AfterValidator, PlainValidator, WithJsonSchema

from optlink.clearance.columns import Output
from optlink.clearance.control import Control
from optlink.clearance.integration import Impact
from optlink.clearance.joint import Gap
from optlink.clearance.statistics import Prediction
from optlink.dynamics.forward import Ending
from optlink.dynamics.machine import Machine
from optlink.errors import InputError
from optlink.io import checked, finite, with_check_sum
from optlink.problem.document import Column, Columns, Document, Never, Number, Renamed, Source, Tabled, adapter
from optlink.problem.file import ProblemFile
from optlink.tasks.machine import machine_of, with_flywheel
from optlink.version import VERSION

RUNNING_IN = 5
"""Revolutions at the beginning that the statistics leave out, where there are more than twice as many."""


def _read_impacts(rows: Iterable[Iterable[Any]]) -> tuple[Impact, ...]:
    return tuple(Impact._make(math.nan if value is None else value for value in row) for row in rows)


Impacts = Annotated[tuple[Impact, ...], PlainValidator(_read_impacts), WithJsonSchema({"type": "array"})]


def _prediction(result: "ClearanceSimulation") -> dict[str, Any] | None:
    if (found := result.prediction) is None:
        return None
    return {"chaotic": found.chaotic, "parted_revolutions": found.parted, "watched": found.watched}


@dataclass(frozen=True, repr=False, eq=False)
class ClearanceSimulation(Tabled):
    """Simulation of a machine with joint clearance.

    `columns` by name over the rows of the retained revolutions, `meanings` describe them; `per_revolution`: figures of each
    revolution, (revolutions,) arrays; `impacts` ordered by their ends, those still in contact last; `poincare_map`: one row per
    revolution, at its end; `measured`: rows of a measured series beside the simulated output, by name; `design`: the given values
    [SI]; `flywheel`: the added moment of inertia [kg m^2].
    """

    kind = "clearance"
    shown: ClassVar[Mapping[str, Source]] = {
        "output": "output.name",
        "speed_rad_s": "speed",
        "start_rad": "start",
        "sample_time_s": "sample_time",
        "stopped_s": "stopped",
        "prediction": _prediction,
        "impacts": lambda result: [one._asdict() | {"gap": result.gaps[one.gap].point} for one in result.impacts],
    }

    problem: ProblemFile
    design: dict[str, float]
    flywheel: float
    gaps: tuple[Gap, ...]
    output: Output
    control: Control
    speed: float
    start: float
    sample_time: float | None
    columns: Columns
    meanings: dict[str, str]
    per_revolution: Columns
    impacts: Impacts
    poincare_map: Columns
    figures: dict[str, Number]
    prediction: Prediction | None
    ending: Ending
    stopped: float
    message: str
    notes: tuple[str, ...]
    tolerance: float
    integrator: str
    measured: Columns

    finished = Renamed("valid")

    @property
    def valid(self) -> bool:
        """Whether all revolutions were simulated."""
        return self.ending is Ending.FINISHED

    @property
    def status(self) -> str:
        """Why the simulation ended, in words."""
        return self.ending.value

    @cached_property
    def machine(self) -> Machine:
        """The machine."""
        return with_flywheel(machine_of(self.problem, self.design or None), self.flywheel)

    @property
    def revolutions(self) -> int:
        """Number of complete revolutions."""
        return int(self.figures["revolutions"])


# The results of a control comparison and of a tuning, as data and JSON.

Costs = Annotated[Column, AfterValidator(lambda costs: np.where(np.isnan(costs), np.inf, costs))]
"""A column; null where a cost is infinite."""


@dataclass(frozen=True)
class Trials:
    """One kind of control from several starts: rms and peak of the error [m, rad], correction, torque; arrays (starts,).

    `correction` [rad] and `torque` [N m] are root mean squares of the control effort. A run that stalled has no figures: NaN.
    """

    shown: ClassVar[Mapping[str, Source]] = {
        name: name for name in ("rms", "peak", "correction", "torque", "finished", "mean", "scatter")
    }

    rms: Column
    peak: Column
    correction: Column
    torque: Column
    finished: bool

    @property
    def stalled(self) -> int:
        """Number of runs that stalled."""
        return int(np.sum(np.isnan(self.rms)))

    @property
    def mean(self) -> float:
        """Mean of the rms errors; NaN if a run stalled."""
        return float(np.mean(self.rms))

    @property
    def scatter(self) -> float:
        """Standard deviation of the rms errors."""
        return float(np.std(self.rms, ddof=1)) if len(self.rms) > 1 else 0.0


@dataclass(frozen=True, repr=False)
class Comparison(Document):
    """Comparison of control: `trials` by kind of control, from initial crank angles `starts` (starts,) [rad].

    `examples`: the simulations from the first start, with the columns that charts show.
    """

    kind = "control comparison"
    shown: ClassVar[Mapping[str, Source]] = {"starts_rad": "starts", "trials": "trials"}

    problem: ProblemFile
    trials: dict[str, Trials]
    starts: Column
    seed: int
    revolutions: int
    examples: dict[str, ClearanceSimulation]
    unit: str

    finished = Renamed("valid")

    @property
    def valid(self) -> bool:
        """Whether every run finished."""
        return all(trials.finished for trials in self.trials.values())

    @property
    def status(self) -> str:
        """Whether every run finished, in a word."""
        return "finished" if self.valid else "stalled"

    def gain(self, kind: str) -> float:
        """Return the fraction of the uncompensated error (mean over the starts) that a kind of control removes."""
        return 1.0 - self.trials[kind].mean / self.trials["none"].mean


@dataclass(frozen=True, repr=False)
class Tuning(Document):
    """Tuning of controller parameters: `tried` values by name (evaluations,), their costs and scatters [m, rad].

    `problem`: the problem with the `best` values, which are empty if its own were better. The cost is the mean rms
    error over the starts; costs that differ by less than the scatter are equivalent. It is infinite if a run
    stalled, or if the mean exceeds the best so far: the runs then stop early. `check`: figures from as many starts that the
    search did not use (those of the next seed), with the parameters of the problem and with the best ones; None if its own are
    the best.
    """

    kind = "tuning"
    shown: ClassVar[Mapping[str, Source]] = {"other_starts?": "_other_starts"}

    problem: ProblemFile
    best: dict[str, str | float]
    cost: Never
    scatter: Number
    before: Never
    tried: Columns
    costs: Costs
    scatters: Column
    control: str
    starts: int
    seed: int
    revolutions: int
    unit: str
    check: tuple[Trials, Trials] | None

    @property
    def _other_starts(self) -> dict[str, float] | None:
        """Means and scatters of `check` (SI): of the parameters of the problem, and of the best ones."""
        if self.check is None:
            return None
        before, best = self.check
        return {"before": before.mean, "before_scatter": before.scatter, "cost": best.mean, "scatter": best.scatter}

    finished = Renamed("valid")

    @property
    def valid(self) -> bool:
        """Whether the runs of some parameter set finished."""
        return math.isfinite(self.cost)

    @property
    def status(self) -> str:
        """Whether the runs of some parameter set finished, in a word."""
        return "finished" if self.valid else "stalled"


# Checkpoints of clearance simulations, control comparisons and tunings: what an interrupted run needs to resume.

C = TypeVar("C", bound="Checkpoint")


@dataclass(frozen=True, kw_only=True)
class Checkpoint:
    """The common entries of the checkpoints: problem and options of the run."""

    schema: ClassVar[str]

    problem_hash: str
    points: int
    tolerance: float
    design: dict[str, float] | None

    def document(self) -> dict[str, Any]:
        """Return the JSON document, with its check sum; NaN stays, as the end of a contact that lasts."""
        return with_check_sum({"schema": self.schema, "optlink": VERSION, **asdict(self)})


@dataclass(frozen=True)
class RevolutionState:
    """State of a clearance simulation between two revolutions: of its integrators and of its statistics."""

    closed_loop: dict[str, Any]
    predictability: dict[str, Any] | None
    statistics: dict[str, Any]


@dataclass(frozen=True, kw_only=True)
class ClearanceCheckpoint(Checkpoint):
    """Options of a clearance simulation, its complete revolutions, and its state after them.

    `before`: of a complete run the state before its last revolution, which is simulated again if its results were not written.
    """

    schema = "optlink/clearance-checkpoint/5"

    speed_rad_s: float
    start_rad: float
    control: str
    skipped: int
    integrator: str
    flywheel_kg_m2: float
    check_predictability: bool
    revolutions: int
    state: RevolutionState
    before: RevolutionState | None

    def state_for(self, revolutions: int) -> RevolutionState | None:
        """Return the state from which a run of so many revolutions continues; None if it has been longer."""
        if revolutions > self.revolutions:
            return self.state
        return self.before if revolutions == self.revolutions else None


@dataclass(frozen=True, kw_only=True)
class RunsCheckpoint(Checkpoint):
    """Options of many runs, and how many of them are `complete`."""

    speed: float | None
    revolutions: int
    starts: int
    seed: int
    integrator: str
    complete: int
    total: int

    def document(self) -> dict[str, Any]:
        """Return the JSON document, with its check sum; null where a number is not finite."""
        return with_check_sum(finite({"schema": self.schema, "optlink": VERSION, **asdict(self)}))


@dataclass(frozen=True)
class CompleteRun:
    """A complete run: control, index of its start, figures [SI]."""

    control: str
    start: int
    unit: str
    finished: bool
    figures: dict[str, float]


@dataclass(frozen=True, kw_only=True)
class ComparisonCheckpoint(RunsCheckpoint):
    """Complete runs of a comparison of control."""

    schema = "optlink/comparison-checkpoint/3"

    kinds: list[str]
    runs: list[CompleteRun]


@dataclass(frozen=True, kw_only=True)
class TuningCheckpoint(RunsCheckpoint):
    """Cost and scatter of the parameters of the problem, then of every complete evaluation."""

    schema = "optlink/tuning-checkpoint/3"

    control: str
    names: list[str]
    evaluations: int
    costs: list[tuple[Never, Number]]


def read_checkpoint(kind: type[C], document: Mapping[str, Any], options: Mapping[str, Any]) -> C:
    """Read a checkpoint.

    Parameters
    ----------
    options : mapping
        Entries that must be those of the run that resumes.

    Raises
    ------
    InputError
        If the checkpoint is that of other options or of another version, or was changed.
    """
    for name, value in {"schema": kind.schema, "optlink": VERSION, **options}.items():
        if document.get(name) != value:
            own = {
                "schema": "has another format",
                "optlink": "is that of another version",
                "problem_hash": "is that of another problem",
            }
            whose = own.get(name, "is that of another command")
            message = f"the checkpoint {whose}: its {name} is {document.get(name)!r}, not {value!r}"
            remedy = "Resume with the command and version of optlink that wrote it, or start again without --resume"
            raise InputError(message, remedy, key="resume")
    content = checked(document)
    if content is None:
        raise InputError("the checkpoint was changed since it was written", "Start again without --resume", key="resume")
    return adapter(kind).validate_python(content)  # type: ignore[no-any-return]
