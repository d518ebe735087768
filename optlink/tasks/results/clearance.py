"""The result of a simulation with joint clearance, as data and JSON."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from optlink.clearance.controller import Control
from optlink.clearance.integration import Impact
from optlink.clearance.joint import Gap
from optlink.clearance.output import Output
from optlink.clearance.statistics import Prediction
from optlink.dynamics.forward import Ending
from optlink.dynamics.machine import Machine
from optlink.io import Summary, finite, head
from optlink.problem.file import ProblemFile

Array = NDArray[np.float64]


SCHEMA = "optlink/clearance/1"
SETTLED = 5
"""Revolutions at the beginning that the statistics leave out, where there are more than twice as many."""


@dataclass(frozen=True, repr=False)
class ClearanceSimulation(Summary):
    """Simulation of a machine with joint clearance.

    `columns` by name over the rows of the retained revolutions, `meanings` describe them; `turns`: figures of each
    revolution, (revolutions,) arrays; `impacts` ordered by their ends, those still in contact last; `section`: one row per
    revolution, at its end.
    """

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
    turns: Mapping[str, Array]
    impacts: tuple[Impact, ...]
    section: Mapping[str, Array]
    figures: Mapping[str, float]
    prediction: Prediction | None
    ending: Ending
    stopped: float
    message: str
    notes: tuple[str, ...]
    tolerance: float

    def __getitem__(self, name: str) -> Array:
        return self.columns[name]

    @property
    def finished(self) -> bool:
        """Whether all revolutions were simulated."""
        return self.ending is Ending.FINISHED

    @property
    def revolutions(self) -> int:
        """Number of complete revolutions."""
        return int(self.figures["revolutions"])

    def to_dict(self) -> dict[str, Any]:
        """Return the simulation as a JSON document: SI, or the unit that ends the key; null where there is no finite value."""
        predicted = self.prediction
        return finite(  # type: ignore[no-any-return]
            {
                **head(SCHEMA, self.problem, self.ending.value),
                "message": self.message,
                "finished": self.finished,
                "control": str(self.control),
                "output": self.output.name,
                "speed_rad_s": self.speed,
                "start_rad": self.start,
                "sample_time_s": self.sample_time,
                "tolerance": self.tolerance,
                "gaps": [vars(gap) for gap in self.gaps],
                "notes": list(self.notes),
                "figures": dict(self.figures),
                "stopped_s": self.stopped,
                "prediction": None
                if predicted is None
                else {"chaotic": predicted.chaotic, "parted_revolutions": predicted.parted, "watched": predicted.watched},
                "turns": dict(self.turns),
                "impacts": [{**impact._asdict(), "gap": self.gaps[impact.gap].point} for impact in self.impacts],
                "section": dict(self.section),
                "meanings": dict(self.meanings),
                "columns": dict(self.columns),
            }
        )
