"""Comparison of a measured series with the simulated output: the series ends in the last simulated revolution."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from optlink.clearance.output import Output
from optlink.linkage.vector2d import Array


@dataclass(frozen=True, eq=False)
class MeasuredComparison:
    """Rows of a measured series beside the simulation, each (n,): time of the simulation [s], outputs [m, rad]."""

    time: Array
    measured: Array
    simulated: Array
    ideal: Array
    output: Output

    @property
    def difference(self) -> Array:
        """Measured minus simulated output [m, rad]."""
        return np.asarray(self.output.difference(self.measured, self.simulated))

    @property
    def columns(self) -> dict[str, Array]:
        """The rows by name, with their units."""
        unit = self.output.unit
        names = {"measured": self.measured, "simulated": self.simulated, "ideal": self.ideal, "difference": self.difference}
        return {"time_s": self.time, **{f"{name}_{unit}": values for name, values in names.items()}}

    @property
    def figures(self) -> dict[str, float]:
        """Root mean square, largest and mean difference from the simulation, and from the machine without clearance."""
        unit, found = self.output.unit, {"measured.rows": float(len(self.time))}
        without = np.asarray(self.output.difference(self.measured, self.ideal))
        for name, values in (("measured", self.difference), ("measured.ideal", without)):
            found[f"{name}.rms_{unit}"] = math.sqrt(float(np.mean(values * values)))
            found[f"{name}.peak_{unit}"] = float(np.max(np.abs(values)))
            found[f"{name}.mean_{unit}"] = float(np.mean(values))
        return found


def measured_comparison(
    times: Sequence[float],
    measured: Sequence[float],
    rows: Mapping[str, Array],
    output: Output,
    period: float,
    counted: tuple[int, int],
) -> MeasuredComparison | None:
    """Compare a measured series [s; m, rad] with the rows of a simulation; None if no row of the series lies within them.

    The times of the series, from the start angle of the crank, are moved by whole revolutions of duration `period` [s], so that
    the last one lies in the last simulated revolution. `counted`: numbers of revolutions before the counted ones, and of all
    simulated ones; other rows of the series are left out.
    """
    time, values = rows["time_s"], rows[output.column]
    rate = rows[f"{output.name}.v_m_s" if output.guide else f"{output.name}.omega_rad_s"]
    values = values if output.guide else np.unwrap(values)
    begin, end = counted[0] * period, counted[1] * period
    at = np.asarray(times, dtype=float)
    at = at + period * math.floor((end - np.max(at)) / period + 1e-6)
    near = 1e-6 * period
    within = (at > begin + near) & (at >= float(time[0]) - near) & (at <= float(time[-1]) + near)
    if not np.any(within):
        return None
    at = np.clip(at[within], time[0], time[-1])
    simulated = np.asarray(CubicHermiteSpline(time, values, rate)(at))
    error = np.interp(at, time, rows[output.error])
    return MeasuredComparison(at, np.asarray(measured, dtype=float)[within], simulated, simulated - error, output)
