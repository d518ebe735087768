"""Checkpoints of clearance simulations, control comparisons and tunings: what an interrupted run needs to resume."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, ClassVar, TypeVar

from optlink.errors import InputError
from optlink.io import checked, finite, with_check_sum
from optlink.problem.document import Never, Number, adapter
from optlink.version import VERSION

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
