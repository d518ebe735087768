"""The result of a simulation with joint clearance, as data and JSON."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Literal

from pydantic import Field

from optlink.clearance.controller import Control
from optlink.clearance.integration import Impact
from optlink.clearance.joint import Gap
from optlink.clearance.output import Output
from optlink.clearance.statistics import Prediction
from optlink.dynamics.ending import Ending
from optlink.dynamics.machine import Machine
from optlink.linkage.vector2d import Array
from optlink.problem.base_model import Columns, Number, Record, ResultRecord, Tabled
from optlink.problem.file import ProblemFile

RUNNING_IN = 5
"""Revolutions at the beginning that the statistics leave out, where there are more than twice as many."""


class ImpactRecord(Record):
    """One contact; the joint by its name."""

    gap: str
    begin: float
    crank_angle: float
    approach: float
    penetration: Number
    end: Number
    departure: Number


class PredictionRecord(Record):
    """Time for which the trajectory is predictable; null where it is so to the end."""

    chaotic: bool
    parted_revolutions: Annotated[float | None, "parted"]
    watched: int


class ClearanceRecord(ResultRecord):
    """Document of a simulation with joint clearance: SI, or the unit that ends the key."""

    format: Literal["optlink/clearance/2"] = Field(alias="schema")
    status: Annotated[Ending, "ending"]
    message: str
    finished: bool
    control: Control
    output: Annotated[str, "output.name"]
    speed_rad_s: Annotated[float, "speed"]
    start_rad: Annotated[float, "start"]
    sample_time_s: Annotated[float | None, "sample_time"]
    tolerance: float
    integrator: str = "cvodes"
    gaps: tuple[Gap, ...]
    notes: tuple[str, ...]
    figures: dict[str, Number]
    stopped_s: Annotated[Number, "stopped"]
    prediction: PredictionRecord | None
    per_revolution: Columns
    impacts: Annotated[
        tuple[ImpactRecord, ...],
        lambda result: tuple(ImpactRecord.of(one, gap=result.gaps[one.gap].point) for one in result.impacts),
    ]
    poincare_map: Columns
    meanings: dict[str, str]
    columns: Columns
    measured: Columns = Field(default_factory=dict)


@dataclass(frozen=True, repr=False, eq=False)
class ClearanceSimulation(Tabled):
    """Simulation of a machine with joint clearance.

    `columns` by name over the rows of the retained revolutions, `meanings` describe them; `per_revolution`: figures of each
    revolution, (revolutions,) arrays; `impacts` ordered by their ends, those still in contact last; `poincare_map`: one row per
    revolution, at its end; `measured`: rows of a measured series beside the simulated output, by name.
    """

    record = ClearanceRecord

    problem: ProblemFile
    machine: Machine
    gaps: tuple[Gap, ...]
    output: Output
    control: Control
    speed: float
    start: float
    sample_time: float | None
    columns: Mapping[str, Array]
    meanings: Mapping[str, str]
    per_revolution: Mapping[str, Array]
    impacts: tuple[Impact, ...]
    poincare_map: Mapping[str, Array]
    figures: Mapping[str, float]
    prediction: Prediction | None
    ending: Ending
    stopped: float
    message: str
    notes: tuple[str, ...]
    tolerance: float
    integrator: str = "cvodes"
    measured: Mapping[str, Array] = field(default_factory=dict)

    @property
    def finished(self) -> bool:
        """Whether all revolutions were simulated."""
        return self.ending is Ending.FINISHED

    @property
    def revolutions(self) -> int:
        """Number of complete revolutions."""
        return int(self.figures["revolutions"])
