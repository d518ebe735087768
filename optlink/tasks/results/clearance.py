"""The result of a simulation with joint clearance, as data and JSON."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Any, ClassVar

from pydantic import PlainValidator, WithJsonSchema

from optlink.clearance.controller import Control
from optlink.clearance.integration import Impact
from optlink.clearance.joint import Gap
from optlink.clearance.output import Output
from optlink.clearance.statistics import Prediction
from optlink.dynamics.ending import Ending
from optlink.dynamics.machine import Machine
from optlink.problem.document import Columns, Number, Source, Tabled
from optlink.problem.file import ProblemFile
from optlink.tasks.machine import machine_of, with_flywheel

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
        "status": "ending",
        "finished": "finished",
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

    @property
    def finished(self) -> bool:
        """Whether all revolutions were simulated."""
        return self.ending is Ending.FINISHED

    @cached_property
    def machine(self) -> Machine:
        """The machine."""
        return with_flywheel(machine_of(self.problem, self.design or None), self.flywheel)

    @property
    def revolutions(self) -> int:
        """Number of complete revolutions."""
        return int(self.figures["revolutions"])
