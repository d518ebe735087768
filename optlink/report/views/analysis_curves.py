"""Time history of a machine over the crank angle, with exact extremes and gaps at load jumps."""

from collections.abc import Sequence

import numpy as np

from optlink.dynamics.columns import MotionColumns, pin_columns
from optlink.dynamics.work import Work
from optlink.linkage.motion import continuous
from optlink.linkage.vector2d import Array
from optlink.tasks.analyze import Analysis

POINTS = 720
MAX_TABLE_ROWS = 2000  # largest number of analysis rows that are added to the points of the curves
ROUNDING = 1e-9  # share of the largest value below which a value is rounding error


class CycleCurves:
    """Time history of a machine over the crank angle, in the order of the motion.

    It contains every row of the analysis table (if there are not too many), points between them, the crank angles of all
    extremes, and two points at each jump of a load: the values just before and just after it.
    """

    def __init__(self, result: Analysis) -> None:
        self.result = result
        self.direction = 1.0 if result.speed > 0.0 else -1.0
        table = np.radians(result["crank_angle_deg"])
        self.start = float(table[0])
        self.end = self.start + self.direction * result.cycle if result.full else float(table[-1])
        low, high = sorted((self.start, self.end))
        marks = [self.inside(at) for extreme in result.extremes.values() for at in (extreme.least_at, extreme.largest_at)]
        grid = np.concatenate([np.linspace(low, high, POINTS + 1), table if len(table) <= MAX_TABLE_ROWS else [], marks])
        grid = np.unique(grid[(grid >= low) & (grid <= high)])
        jumps = np.asarray(result.jumps, dtype=float)
        if jumps.size:
            grid = grid[np.min(np.abs(grid[:, None] - jumps), axis=1) > 1e-9]
        everywhere = np.concatenate([grid, jumps, jumps])
        order = np.argsort(self.direction * everywhere, kind="stable")
        self.angles: Array = everywhere[order]
        self.degrees = np.degrees(self.angles)
        machine, speed = result.machine, result.speed
        records = [MotionColumns(machine.moving(grid, speed))]
        if jumps.size:
            records += [MotionColumns(machine.moving(jumps, speed, side=side)) for side in (-1, 1)]
        self.columns = {name: np.concatenate([record[name] for record in records])[order] for name in records[0].columns}
        for name in self.columns:
            if name.endswith(".angle_rad"):
                self.columns[name] = continuous(self.columns[name])
        self.columns["input.work_J"] = Work(machine, self.start, low, high, speed)(self.angles)
        for name, _, _ in pin_columns(machine):
            self.columns[name] = np.hypot(*(self.columns[name.replace(".f_N", f".f{axis}_N")] for axis in "xy"))
        self._pairs = np.flatnonzero(np.diff(self.angles) == 0.0)

    def __getitem__(self, name: str) -> Array:
        return self.columns[name]

    @property
    def steady(self) -> bool:
        """Whether the crank turns fully and no quantity grows without bound."""
        return self.result.sound and self.result.full

    def peak(self, *names: str) -> float:
        """Return the largest absolute value of the columns [SI], restricted to the range of values that is drawn."""
        windows = [self.window(self.columns[name]) for name in names if name in self.columns]
        return max((max(abs(low), abs(high)) for low, high in windows), default=0.0)

    def window(self, values: Array) -> tuple[float, float]:
        """Return the least and largest value to draw.

        At singular positions or ends of the crank range, where values grow without bound, outliers are cut off.
        """
        finite_values = values[np.isfinite(values)]
        if finite_values.size == 0:
            return 0.0, 0.0
        low, high = float(finite_values.min()), float(finite_values.max())
        if not self.steady:
            first, last = (float(end) for end in np.percentile(finite_values, [8.0, 92.0]))
            if 0.0 < last - first < (high - low) / 8.0:
                low, high = max(low, 2.0 * first - last), min(high, 2.0 * last - first)
        return low, high

    def has(self, name: str, among: Sequence[str] = ()) -> bool:
        """Return whether a column exists and exceeds the rounding error of the others, whose level those in `among` set."""
        return self.peak(name) > ROUNDING * self.peak(name, *among) and self.peak(name) > 0.0

    def breaks(self, *names: str) -> list[int]:
        """Return the indices after which one of the columns jumps."""
        jumps = []
        for k in self._pairs:
            for name in names:
                values = self.columns[name]
                if abs(values[k + 1] - values[k]) > 1e-6 * self.peak(name):
                    jumps.append(int(k))
                    break
        return jumps

    def line(self, name: str, factor: float = 1.0) -> tuple[Array, Array]:
        """Return crank angles [deg] and scaled values, with NaN inserted at jumps."""
        at = [k + 1 for k in self.breaks(name)]
        return np.insert(self.degrees, at, np.nan), np.insert(self.columns[name] * factor, at, np.nan)

    def inside(self, crank_angle: float) -> float:
        """Return the crank angle [rad] shifted by whole periods into the range of the motion."""
        low, high = sorted((self.start, self.end))
        within = low <= crank_angle <= high or not self.result.full
        return crank_angle if within else low + (crank_angle - low) % self.result.cycle

    def in_order(self, crank_angles: Sequence[float]) -> list[float]:
        """Return crank angles [rad] shifted into the range of the motion, in the order of the motion."""
        return sorted((self.inside(at) for at in crank_angles), key=lambda at: self.direction * at)

    def at(self, crank_angle: float, name: str) -> float:
        """Interpolate a column at a crank angle [rad] within the range of the motion."""
        rising = slice(None) if self.direction > 0.0 else slice(None, None, -1)
        return float(np.interp(crank_angle, self.angles[rising], self.columns[name][rising]))
