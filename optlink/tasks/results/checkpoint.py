"""Checkpoints of clearance simulations, control comparisons and tunings: what an interrupted run needs to resume."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal, TypeVar, get_args

from pydantic import Field, ValidationError

from optlink.errors import InputError
from optlink.problem.base_model import Never, Number, Record

C = TypeVar("C", bound="Checkpoint")


class Checkpoint(Record):
    """The common entries of the checkpoints: problem and options of the run."""

    format: str = Field(alias="schema")
    problem_hash: str
    points: int
    tolerance: float
    design: dict[str, float] | None


class ClearanceCheckpoint(Checkpoint):
    """Options of a clearance simulation, its complete revolutions, and the states of its integrators."""

    format: Literal["optlink/clearance-checkpoint/2"] = Field("optlink/clearance-checkpoint/2", alias="schema")
    speed_rad_s: float
    start_rad: float
    control: str
    skipped: int
    integrator: str = "cvodes"
    flywheel_kg_m2: float
    revolutions: int
    closed_loop: dict[str, Any]
    predictability: dict[str, Any] | None
    statistics: dict[str, Any]


class ManyRuns(Checkpoint):
    """Options of many runs, and how many of them are `complete`."""

    speed: float | None
    revolutions: int
    starts: int
    seed: int
    integrator: str = "cvodes"
    complete: int
    total: int


class RunRecord(Record):
    """A complete run: control, index of its start, figures [SI]."""

    control: str
    start: int
    unit: Literal["m", "rad"]
    finished: bool
    figures: dict[str, float]


class ComparisonCheckpoint(ManyRuns):
    """Complete runs of a comparison of control."""

    format: Literal["optlink/comparison-checkpoint/2"] = Field("optlink/comparison-checkpoint/2", alias="schema")
    kinds: list[str]
    runs: list[RunRecord]


class TuningCheckpoint(ManyRuns):
    """Cost and scatter of the parameters of the problem, then of every complete evaluation."""

    format: Literal["optlink/tuning-checkpoint/2"] = Field("optlink/tuning-checkpoint/2", alias="schema")
    control: str
    names: list[str]
    evaluations: int
    costs: list[tuple[Never, Number]]


def read_checkpoint(kind: type[C], document: Mapping[str, Any], options: Mapping[str, Any]) -> C:
    """Read a checkpoint.

    Parameters
    ----------
    kind : type of Checkpoint
    document : mapping
    options : mapping
        Entries that must be those of the run that resumes.

    Raises
    ------
    InputError
        If the checkpoint is that of other options or of another version, or damaged.
    """
    [schema] = get_args(kind.model_fields["format"].annotation)
    document = {"integrator": "cvodes", **document}  # that of versions without another one
    for name, value in {"schema": schema, **options}.items():
        if document.get(name) != value:
            whose = "has another format" if name == "schema" else "is that of another command"
            message = f"the checkpoint {whose}: its {name} is {document.get(name)!r}, not {value!r}"
            remedy = "Resume with the command and version of optlink that wrote it, or start again without --resume"
            raise InputError(message, remedy, key="resume")
    try:
        return kind.model_validate(document)
    except ValidationError as error:
        place = ".".join(map(str, error.errors()[0]["loc"]))
        raise damaged(place) from None


def damaged(place: str) -> InputError:
    """Return the error for a checkpoint that cannot be resumed because of an entry."""
    return InputError(f"the checkpoint is damaged: {place} cannot be read", "Start again without --resume", key="resume")
