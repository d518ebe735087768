"""Statistics of a simulation with joint clearance, by revolution: output error, contacts, energy balance, predictability."""

import copy
import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from optlink.clearance.columns import ClearanceColumns
from optlink.clearance.control import ClosedLoop, SimulatedRevolution
from optlink.clearance.integration import Impact, Stalled
from optlink.linkage.vector2d import Array, max_magnitude

RETAINED_REVOLUTIONS = 30
"""Number of the last revolutions whose rows stay in memory; `stream` receives the rows of all."""

MAX_SUMMARIES = 10_000
"""Revolutions whose summary stays in memory, and contacts; all of them are counted."""

DIVERGED_SHARE = 0.1
"""Difference of two outputs that counts as divergence, over the smallest clearance (for an angle: times the machine's size)."""

WATCHED = 25
"""Revolutions of the second run."""

_PLAIN = (
    "count", "contacts", "largest", "imbalance", "first", "datum", "sums",
    "every", "peak", "depths", "forces", "torque", "correction", "settled",
)  # fmt: skip
_COMPARED = "parted", "watched", "largest", "lost"
"""Attributes of `Statistics` and of `PredictabilityCheck` in a checkpoint."""


class Statistics:
    """Accumulated statistics of a simulation."""

    def __init__(self, closed_loop: ClosedLoop) -> None:
        self.closed_loop = closed_loop
        self.rows: deque[dict[str, Array]] = deque(maxlen=RETAINED_REVOLUTIONS)
        self.per_revolution: deque[dict[str, float]] = deque(maxlen=MAX_SUMMARIES)
        self.poincare_map: deque[dict[str, float]] = deque(maxlen=MAX_SUMMARIES)
        self.impacts: deque[Impact] = deque(maxlen=MAX_SUMMARIES)
        self.meanings: dict[str, str] = {}
        self.count = 0
        self.largest = self.imbalance = 0.0
        self.first: float | None = None  # energy at the start [J]
        self.datum = 0.0  # potential energy at the start [J]
        self.sums = dict.fromkeys(("square", "rows", "effort", "torque"), 0.0)
        self.every = dict.fromkeys(("square", "rows"), 0.0)
        self.peak = self.torque = self.correction = 0.0
        gaps = len(closed_loop.equations.gaps)
        self.depths, self.forces = [0.0] * gaps, [0.0] * gaps  # largest at every gap [m, N]
        self.contacts = [0] * gaps  # ended
        self.settled = 0

    def add(self, steady: bool) -> dict[str, Array]:
        """Simulate and add one revolution; return its rows.

        Raises
        ------
        Stalled
            The integration cannot continue.
        """
        closed_loop = self.closed_loop
        if self.first is None:
            begin = closed_loop.record(SimulatedRevolution(closed_loop.now(), np.zeros(1), ()))
            self.first, self.datum = float(begin.energy[0]), float(np.ravel(begin.motion.potential)[0])
            self.largest = self.first - self.datum
        turn = closed_loop.turn()
        record = closed_loop.record(turn)
        rows = self._rows(turn, record)
        self._sum(rows, turn, steady)
        self._energy(record, self.first)
        self.rows.append(rows)
        return rows

    def _rows(self, turn: SimulatedRevolution, record: ClearanceColumns) -> dict[str, Array]:
        """The columns, with the ideal output, the error and the correction."""
        closed_loop, output, columns, time = self.closed_loop, self.closed_loop.output, record.columns, turn.block.time
        drive, ideal_column = closed_loop.equations.drive, f"{output.name}.ideal_{output.unit}"
        # the ideal output is that at the nominal crank angle; with a driving torque at the actual one
        angle = closed_loop.start + closed_loop.nominal * time if drive.torque is None else np.asarray(record.motion.crank.value)
        ideal = np.broadcast_to(output.ideal(closed_loop.equations.machine.moving(angle))[0], time.shape)
        rows = {name: column.values for name, column in columns.items()}
        rows |= {ideal_column: ideal, output.error: output.difference(np.asarray(output.of(record.motion)), ideal)}
        self.meanings = {name: column.meaning for name, column in columns.items()} | {
            ideal_column: f"{output.name} of the machine without clearance",
            output.error: f"deviation of {output.name} from the machine without clearance",
        }
        command = drive.reference
        if command is not None:
            rows["command.correction_rad"] = command.correction(time) + turn.further
            rows["command.speed_rad_s"] = np.asarray(command.at(time)[1])
            self.meanings["command.speed_rad_s"] = "crank-speed command of the inverse model; constant without it"
            self.meanings["command.correction_rad"] = "crank-angle command minus the crank angle at constant speed"
        return rows

    def add_partial(self) -> None:
        """Store the rows of an interrupted revolution; the statistics ignore them."""
        partial = self.closed_loop.partial
        if partial is not None:
            rows = self._rows(partial, self.closed_loop.record(partial))
            if set(rows) == set(self.meanings):
                self.rows.append(rows)

    def save(self) -> dict[str, Any]:
        """Return a copy of the accumulated state as plain numbers, without the rows."""
        plain = {name: copy.copy(getattr(self, name)) for name in _PLAIN}
        lists = {name: list(getattr(self, name)) for name in ("per_revolution", "poincare_map")}
        return {**plain, **lists, "impacts": [list(impact) for impact in self.impacts]}

    def restore(self, saved: Mapping[str, Any]) -> None:
        """Continue from a saved state."""
        for name in _PLAIN:
            setattr(self, name, saved[name])
        self.per_revolution.extend(saved["per_revolution"])
        self.poincare_map.extend(saved["poincare_map"])
        self.impacts.extend(Impact(int(row[0]), *row[1:]) for row in saved["impacts"])

    def _sum(self, rows: Mapping[str, Array], turn: SimulatedRevolution, steady: bool) -> None:
        self.count += 1
        gaps, output = self.closed_loop.equations.gaps, self.closed_loop.output
        error, torque = rows[output.error], rows["input.torque_Nm"]
        square, peak, unit = float(np.sum(error * error)), max_magnitude(error), output.unit
        correction = rows.get("command.correction_rad", np.zeros(1))
        self.depths = [max(both) for both in zip(self.depths, turn.depths, strict=True)]
        self.forces = [max(both) for both in zip(self.forces, turn.forces, strict=True)]
        self.impacts.extend(turn.impacts)
        for impact in turn.impacts:
            self.contacts[impact.gap] += 1
        self.torque = max(self.torque, turn.torque)
        figures = {
            "revolution": float(self.count),
            f"rms_{unit}": math.sqrt(square / len(error)),
            f"peak_{unit}": peak,
            f"mean_{unit}": float(np.mean(error)),
            "impacts": float(len(turn.impacts)),
            "torque_rms_Nm": math.sqrt(float(np.mean(torque * torque))),
            "torque_max_Nm": turn.torque,
        }
        for gap, depth, force in zip(gaps, turn.depths, turn.forces, strict=True):
            figures[f"{gap.point}.contact_share"] = float(np.mean(rows[f"{gap.point}.contact"]))
            figures[f"{gap.point}.normal_max_N"] = force
            figures[f"{gap.point}.penetration_max_m"] = depth
        self.per_revolution.append(figures)
        names = [f"{gap.point}.{kind}" for gap in gaps for kind in ("ex_m", "ey_m", "approach_m_s")]
        last = {name: float(rows[name][-1]) for name in (output.error, *names)}
        self.poincare_map.append({"revolution": float(self.count), **last})
        if steady and not self.settled:  # what was summed until now is that of a run that ends before it settles
            self.sums = dict.fromkeys(self.sums, 0.0)
            self.peak = self.correction = 0.0
        self.settled += steady
        for sums in (self.every, self.sums):
            sums["square"] += square
            sums["rows"] += len(error)
        self.sums["effort"] += float(np.mean(correction * correction))
        self.sums["torque"] += float(np.mean(torque * torque))
        self.peak = max(self.peak, peak)
        self.correction = max(self.correction, max_magnitude(correction))

    def _energy(self, record: ClearanceColumns, first: float) -> None:
        energy, works = record.energy, record.block.works
        fed = 1 + len(self.closed_loop.equations.machine.loads)
        gained = works[:, :fed].sum(axis=1) - works[:, fed:].sum(axis=1)
        self.imbalance = max(self.imbalance, max_magnitude(energy - first - gained))
        raised = record.motion.potential - self.datum
        self.largest = max(self.largest, float(np.max(energy - record.motion.potential)), max_magnitude(raised))

    def figures(self) -> dict[str, float]:
        """Return the summary statistics by name (SI)."""
        unit = self.closed_loop.output.unit
        rows, every, turns = max(self.sums["rows"], 1.0), max(self.every["rows"], 1.0), max(self.settled or self.count, 1)
        equations, integration = self.closed_loop.equations, self.closed_loop.integration
        points = [gap.point for gap in equations.gaps]
        contacts = {f"{point}.contacts": float(self.contacts[k] + (k in integration.open)) for k, point in enumerate(points)}
        return {
            "revolutions": float(self.count),
            "settled_revolutions": float(self.settled),
            f"rms_{unit}": math.sqrt(self.sums["square"] / rows),
            f"mean_square_{unit}2": self.sums["square"] / rows,
            f"peak_{unit}": self.peak,
            f"rms_from_start_{unit}": math.sqrt(self.every["square"] / every),
            "contacts": sum(contacts.values()),
            **contacts,
            "largest_penetration_m": max(self.depths),
            "largest_normal_N": max(self.forces),
            **{f"{point}.penetration_max_m": depth for point, depth in zip(points, self.depths, strict=True)},
            **{f"{point}.normal_max_N": force for point, force in zip(points, self.forces, strict=True)},
            "torque_rms_Nm": math.sqrt(self.sums["torque"] / turns),
            "torque_max_Nm": self.torque,
            "correction_rms_rad": math.sqrt(self.sums["effort"] / turns),
            "correction_max_rad": self.correction,
            **{f"{name}.work_J": float(work) for name, work in zip(equations.losses, integration.works, strict=True)},
            "imbalance_J": self.imbalance,
            "largest_energy_J": self.largest,
        }


@dataclass(frozen=True)
class Prediction:
    """Time for which a trajectory is predictable: `parted` [revolutions] at which a run with another tolerance diverged from it.

    `parted` is None if both agreed for all `watched` revolutions; `largest` [m, rad]: difference of the outputs in the last
    revolution compared.
    """

    parted: float | None
    watched: int
    largest: float

    @property
    def chaotic(self) -> bool:
        """Whether the trajectory is not predictable point by point; its statistics may still be meaningful."""
        return self.parted is not None


class PredictabilityCheck:
    """The same motion with another tolerance, simulated until it diverges."""

    def __init__(self, closed_loop: ClosedLoop) -> None:
        self.closed_loop, self.output = closed_loop, closed_loop.output
        least = min(gap.clearance for gap in closed_loop.equations.gaps)
        self.apart = DIVERGED_SHARE * (least if self.output.guide else least / float(np.max(closed_loop.equations.machine.size)))
        self.parted: float | None = None
        self.watched, self.largest, self.lost = 0, 0.0, False

    def follow(self, output: Array) -> None:
        """Simulate one revolution and compare the outputs."""
        if self.parted is not None or self.watched >= WATCHED or self.lost:
            return
        try:
            turn = self.closed_loop.turn()
        except Stalled:
            self.lost = True
            return
        values = np.asarray(self.output.of(self.closed_loop.record(turn).motion))
        away = np.abs(self.output.difference(values, output))
        self.largest = float(np.max(away))
        far = np.flatnonzero(away > self.apart)
        if far.size:
            self.parted = self.watched + (int(far[0]) + 1) / len(away)
        self.watched += 1

    def save(self) -> dict[str, Any]:
        """Return the state as plain numbers."""
        return {name: getattr(self, name) for name in _COMPARED} | {"plant": self.closed_loop.save()}

    def restore(self, saved: Mapping[str, Any]) -> None:
        """Continue from a saved state."""
        for name in _COMPARED:
            setattr(self, name, saved[name])
        self.closed_loop.restore(saved["plant"])

    @property
    def prediction(self) -> Prediction:
        """Result of the comparison."""
        return Prediction(self.parted, self.watched, self.largest)


def table(rows: deque[dict[str, float]]) -> dict[str, Array]:
    """Convert rows of statistics to columns."""
    return {name: np.array([row[name] for row in rows]) for name in rows[0]} if rows else {}
