"""Least and largest values of the columns of an analysis over the motion, each refined when it is read."""

import copy
import math
from collections.abc import ItemsView, Iterable, Iterator, Mapping, Sequence, ValuesView
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from optlink.dynamics.columns import ANGLE, MotionColumns, pin_columns
from optlink.dynamics.machine import Machine
from optlink.dynamics.strokes import without_values
from optlink.dynamics.work import Work
from optlink.errors import UnknownName, nearest
from optlink.linkage.extrema import Index, SampledFunctions, distinct, zeros
from optlink.linkage.stroke import Ranges, within_cycle
from optlink.linkage.vector2d import Array, all_finite, finite_or

CHANGE_POINT_WIDTH = 1e-5  # rad from a passed change point: reactions are inaccurate there
WORK = "input.work_J"
POWER = ".power_W"
"""Ending of the columns that differ on the way back through a range wherever they are not zero."""
SAME = 1e-9  # of the larger force on the way back, by which that on the way there may differ from rounding


def distances(angles: Array, positions: ArrayLike, cycle: float) -> Array:
    """Return the distances (angles, positions) [rad] of crank angles from positions, either way round the cycle."""
    return np.asarray(np.abs(np.remainder(angles[:, None] - np.asarray(positions) + 0.5 * cycle, cycle) - 0.5 * cycle))


class Extreme(NamedTuple):
    """Least and largest value of a column over the motion, and the crank angles [rad] at which they occur.

    If the crank turns fully, the angles lie within one cycle from 0 on, except the end of the cycle for the work since the start;
    otherwise within the range.
    """

    least: float
    least_at: float
    largest: float
    largest_at: float


class Extremes(Mapping[str, Extreme]):
    """The extremes of all columns by name, one-sided at load jumps; only those that are read are refined.

    Parameters
    ----------
    machine : Machine
    ranges : Ranges
    grid : array (n,) [rad]
        Crank angles between which extremes are sought.
    low, high : float [rad]
        Ends of the motion.
    speed : float [rad/s]
        Crank speed.
    work : Work
        Of the drive.
    without : array (m,) [rad]
        Crank angles at which some columns have no value: their extremes, and of loads with a pole, are left out.
    unbounded : sequence of str, optional
        Further columns without extremes. Default: all.
    """

    def __init__(
        self,
        machine: Machine,
        ranges: Ranges,
        grid: Array,
        low: float,
        high: float,
        speed: float,
        work: Work,
        without: Array,
        unbounded: Sequence[str] | None,
    ) -> None:
        self._machine, self._ranges, self._grid, self._ends = machine, ranges, grid, (low, high)
        self._speed, self._work, self._without, self._unbounded = speed, work, without, unbounded
        self._found: dict[str, Extreme] = {}
        self._back: tuple[Extremes, str] | None = None
        self._ways: dict[str, tuple[bool, bool]] = {}

    def __getitem__(self, name: str) -> Extreme:
        if name not in self._names:
            raise UnknownName(f"no column {name}", nearest(str(name), self._names))
        return self.select([name])[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __len__(self) -> int:
        return len(self._names)

    def items(self) -> ItemsView[str, Extreme]:
        """Return the names and extremes, all refined together."""
        return self.select(self).items()

    def values(self) -> ValuesView[Extreme]:
        """Return the extremes, all refined together."""
        return self.select(self).values()

    def select(self, names: Iterable[str]) -> dict[str, Extreme]:
        """Return the extremes of some columns, refined together.

        Parameters
        ----------
        names : iterable of str
        """
        wanted = list(names)
        missing = [name for name in wanted if name not in self._found]
        rows = np.array(sorted(self._numbers[name] for name in missing if name != WORK), dtype=np.intp)
        if rows.size:
            self._refine(rows)
        if WORK in missing:
            self._found[WORK] = self._of_work()
        return {name: self._found[name] for name in wanted}

    def on_way_back(self, name: str) -> tuple[bool, bool]:
        """Return whether the least and the largest value of a column occur on the way back through a range.

        Parameters
        ----------
        name : str
        """
        self.select([name])
        return self._ways.get(name, (False, False))

    @property
    def amounts(self) -> dict[str, float]:
        """Largest magnitude of every column with extremes, from samples of the motion."""
        values = np.abs(self._sampled.values)
        largest = np.max(finite_or(values, 0.0), axis=1, initial=0.0)
        return {name: float(largest[self._numbers[name]]) for name in self._names if name != WORK}

    def __getstate__(self) -> dict[str, Any]:
        """Return the attributes without the samples."""
        return {name: value for name, value in vars(self).items() if name != "_sampled"}

    # --- evaluation ------------------------------------------------------------------------------------------------------------

    @cached_property
    def _all(self) -> tuple[list[str], dict[str, tuple[str, str]]]:
        """Names of all columns with extremes, and the pin and body of those that are magnitudes of joint forces."""
        pins = {name: (point, body) for name, point, body in pin_columns(self._machine)}
        meanings = MotionColumns(self._machine.moving(self._grid[:1], self._speed)).meanings
        return [*(name for name in meanings if not name.endswith(ANGLE)), *pins], pins

    @cached_property
    def _numbers(self) -> dict[str, int]:
        """Numbers of the columns."""
        return {name: k for k, name in enumerate(self._all[0])}

    def _evaluate(self, angles: Array, rows: Index | None = None, side: int = 1, machine: Machine | None = None) -> Array:
        """Columns (rows, n) at crank angles; by default all."""
        names, pins = self._all
        record = MotionColumns((machine or self._machine).moving(angles, self._speed, side=side))
        passed, unknown = [position.crank_angle for position in self._ranges.followed], None
        values = np.empty((len(names) if rows is None else len(rows), len(angles)))
        for row, name in zip(values, names if rows is None else [names[k] for k in rows], strict=True):
            if name in pins:
                point, body = pins[name]
                with np.errstate(all="ignore"):
                    row[:] = np.hypot(*(record.full(part) for part in record.reactions.pins[point][body]))
            else:
                row[:] = record[name]
            if name in pins or name in record.reaction_names:
                if unknown is None:
                    near = distances(angles, passed, self._machine.mechanism.cycle) < CHANGE_POINT_WIDTH
                    unknown = record.singular | np.any(near, axis=1)
                row[unknown] = np.nan
        return values

    @cached_property
    def _sampled(self) -> SampledFunctions:
        """All columns on the grid."""
        kinds = [name.rpartition("_")[2] for name in self._all[0]]
        return SampledFunctions(self._evaluate, self._grid, tuple(self._work.breaks), kinds, periodic=self._ranges.full)

    @cached_property
    def _names(self) -> dict[str, None]:
        """Names of the columns with extremes."""
        if self._unbounded is None:
            return {}
        names = [name for name in self._all[0] if name not in self._unbounded]
        work, low = self._work, np.array(self._ends[:1])
        if self._without.size or work.poles:
            defined = np.all(np.isfinite(self._evaluate(self._without)), axis=1)
            if work.poles:
                defined &= np.isfinite(self._evaluate(low, machine=without_values(self._machine, work.poles)))[:, 0]
            return dict.fromkeys(name for name in names if defined[self._numbers[name]])
        return dict.fromkeys([*names, *([WORK] if all_finite(work(low)) else [])])

    # --- extremes --------------------------------------------------------------------------------------------------------------

    def _placed(self, angle: float) -> float:
        if self._ranges.full and math.isfinite(angle):
            return within_cycle(angle, self._machine.cycle)
        return float(angle)

    def _refine(self, rows: Index) -> None:
        at, best = self._sampled.extremes(rows, self._evaluate)
        jumps = self._work.jumps
        if jumps.size:
            before = self._evaluate(jumps, rows, side=-1)
            for k, sign in ((0, 1.0), (1, -1.0)):
                scored = np.where(np.isfinite(before), before * sign, np.inf)
                place = np.argmin(scored, axis=1)
                one_sided = before[np.arange(len(before)), place]
                better = np.isfinite(one_sided) & ~(best[:, k] * sign <= one_sided * sign)
                best[:, k], at[:, k] = np.where(better, one_sided, best[:, k]), np.where(better, jumps[place], at[:, k])
        for k, (low, high), (low_at, high_at) in zip(rows, best, at, strict=True):
            self._found[self._all[0][k]] = Extreme(float(low), self._placed(low_at), float(high), self._placed(high_at))
        if self._back is not None:
            back, ending = self._back
            motion = MotionColumns(self._machine.moving(self._grid[:1], self._speed)).motion_names
            names = [name for k in rows if (name := self._all[0][k]).endswith(ending) and name not in motion and name in back]
            for name, other in back.select(names).items():
                own, amount = self._found[name], max(map(abs, (other.least, other.largest)))
                lower, higher = own.least - other.least > SAME * amount, other.largest - own.largest > SAME * amount
                self._ways[name] = lower, higher
                self._found[name] = Extreme(*(other if lower else own)[:2], *(other if higher else own)[2:])

    def _of_work(self) -> Extreme:
        work, (low, high) = self._work, self._ends
        inside = self._grid[(self._grid >= low) & (self._grid <= high)]
        turning = zeros(lambda angles: work.torque(angles)[None, :], inside)[0]
        places = distinct(np.concatenate([[low, high], turning, work.jumps]))
        amounts = work(places)
        i, j = int(np.nanargmin(amounts)), int(np.nanargmax(amounts))
        end = high if self._speed > 0.0 else low  # work does not repeat: the end of the cycle is not its start
        rounding = 1e-10 * float(np.nanmax(np.abs(amounts)))
        at_least, at_largest = (
            float(end) if self._ranges.full and places[k] == end and abs(amounts[k]) > rounding else self._placed(places[k])
            for k in (i, j)
        )
        return Extreme(float(amounts[i]), at_least, float(amounts[j]), at_largest)


def both_ways(there: Extremes, back: Extremes | None = None) -> Extremes:
    """Return the extremes of both ways through a range.

    Without those of the way `back` its forces are the same, and only powers differ.
    """
    made, ending = copy.copy(there), POWER if back is None else ""
    if back is None:
        back = copy.copy(there)
        back._speed, back._found = -there._speed, {}
        back.__dict__.pop("_sampled", None)
    made._found, made._back = {}, (back, ending)
    return made
