"""Simulation with clearance by revolutions, folded onto the crank angle, and the axes and curves shared by its charts."""

import math
from functools import partial

import numpy as np
from numpy.typing import NDArray

from optlink.clearance.joint import Gap
from optlink.linkage.vector2d import TURN
from optlink.presentation.chart_spec import MUTED, RESULT, SHADE, Array, Axis, Curve, Line, Span, crank_angle
from optlink.presentation.format import Scale, round_below, scale
from optlink.presentation.shapes import finite_range
from optlink.tasks.results.clearance import ClearanceSimulation
from optlink.units import count_noun

Mask = NDArray[np.bool_]
FULL = 360.0
TORQUE = "input.torque_Nm"
WINDOW = 3  # number of revolutions drawn over time
LIMITS_PERCENTILE = 99.8  # percentile of the values that the limits of y include
CIRCLE = np.linspace(0.0, TURN, 181)


class RevolutionCurves:
    """Stored rows of a simulation with clearance, assigned to revolutions.

    If the simulation stopped early, its last rows belong to no complete revolution; "last revolution" then means the last period
    of rows.
    """

    def __init__(self, result: ClearanceSimulation) -> None:
        self.result = result
        self.time: Array = np.asarray(result.columns.get("time_s", np.zeros(0)))
        self.direction = 1.0 if result.speed > 0.0 else -1.0
        self.period = TURN / abs(result.speed)
        step = float(self.time[1] - self.time[0]) if len(self.time) > 1 else self.period
        self.points = max(1, round(self.period / step))
        self.kept = -(-len(self.time) // self.points)
        self.last = result.revolutions
        self.whole = int(np.searchsorted(self.time, self.last * self.period * (1.0 + 1e-9), side="right"))
        """How many rows belong to whole revolutions."""
        settled = int(result.figures["settled_revolutions"])
        self.begin = self.last - settled + 1 if settled else 1
        """The first revolution that the statistics count."""

    def __bool__(self) -> bool:
        return len(self.time) > 1

    @property
    def angle(self) -> Array:
        """Crank angle [deg], continuous over revolutions."""
        return self.result["crank_angle_deg"]

    @property
    def free(self) -> bool:
        """Whether the crank is driven by a torque; revolutions are then periods of the nominal speed."""
        return self.result.problem.model.drive.torque is not None

    @property
    def broken(self) -> bool:
        """Whether the last rows belong to an incomplete revolution."""
        return self.whole < len(self.time)

    @property
    def shown(self) -> int:
        """Number of revolutions after the running-in with stored rows."""
        return max(1, min(self.kept, self.last - self.begin + 1 + self.broken))

    def rows(self, count: int) -> slice:
        """Return the rows of the last revolutions and the row before them, if there is one."""
        return slice(max(0, len(self.time) - count * self.points - 1), len(self.time))

    def span(self, count: int) -> str:
        """Describe the last revolutions."""
        count = min(count, self.kept)
        if self.broken:
            return "the last revolution" if count == 1 else f"the last {count} revolutions"
        return f"revolution {self.last}" if count == 1 else f"revolutions {self.last - count + 1} to {self.last}"

    @property
    def overlaid(self) -> str:
        """Description of the revolutions that are drawn on one another."""
        return f"{self.span(self.shown)}, the last one bold" if self.shown > 1 else self.span(1)

    @property
    def counted(self) -> str:
        """Description of the revolutions that the statistics include."""
        return f"revolution {self.last}" if self.begin == self.last else f"revolutions {self.begin} to {self.last}"

    # --- output --------------------------------------------------------------------------------------------------------

    @property
    def output(self) -> Array:
        """Output [m, rad]; angles are unwrapped and start within the first turn."""
        values = self.result[self.result.output.column]
        if self.result.output.guide:
            return values
        values = np.unwrap(values)
        return np.asarray(values - TURN * math.floor(np.min(values[self.rows(WINDOW)]) / TURN + 0.5))

    @property
    def error(self) -> Array:
        """Deviation of the output from that of the ideal machine [m, rad]."""
        return self.result[f"{self.result.output.name}.error_{self.result.output.unit}"]

    @property
    def rms(self) -> float:
        """RMS deviation [m, rad] over the revolutions after the running-in, or over all if too few were simulated."""
        return self.result.figures[f"rms_{self.result.output.unit}"]

    @property
    def advance(self) -> float:
        """Increase of the output in every crank revolution [m, rad]: whole turns for a body that turns fully."""
        if self.result.output.guide:
            return 0.0
        rows = self.rows(1)
        values, turned = self.output[rows], (self.angle[rows.stop - 1] - self.angle[rows.start]) / FULL
        return TURN * round(float(values[-1] - values[0]) / (TURN * (turned or 1.0)))

    def shares(self, largest: float) -> Scale:
        """Return the display unit of the output or its deviation."""
        return scale(largest, "m" if self.result.output.guide else "deg")

    def peak(self, name: str, count: int) -> float:
        """Return the largest torque, normal force or penetration of the last revolutions, including peaks between rows."""
        values = self.result[name][self.rows(count)]
        peak = np.nanmax(np.abs(values) if name == TORQUE else values, initial=0.0)
        stem, _, unit = name.rpartition("_")
        exact = self.result.per_revolution[f"{stem}_max_{unit}".removeprefix("input.")] if self.last else np.zeros(0)
        complete = min(count - self.broken, len(exact))
        return max(peak, np.max(exact[-complete:])) if complete else peak

    # --- titles --------------------------------------------------------------------------------------------------------

    def title(self, what: str, more: str = "") -> str:
        """Compose the title of a picture: machine and subject, then speed, control and `more`."""
        result = self.result
        nominal, sense = "nominal " if self.free else "", "" if self.direction > 0.0 else " clockwise"
        parts = [f"{nominal}{abs(result.speed) * 30.0 / math.pi:.5g} rpm{sense}"]
        if result.control != "none":
            parts.append(f"control {result.control}")
        if not result.valid:
            parts.append(f"{result.ending.value} after {count_noun(self.last, 'revolution')}")
        return f"{result.problem.model.title}: {what}\n{', '.join([*parts, *filter(None, [more])])}"

    # --- the crank angle as abscissa -----------------------------------------------------------------------------------

    def fold(self, values: Array, rows: slice, advance: float = 0.0) -> tuple[Array, Array]:
        """Return crank angles within a revolution [deg] and values (n,), see `fold`."""
        return fold(self.angle[rows], values[rows], advance)

    @property
    def crank_axis(self) -> Axis:
        """Axis of the crank angle within a revolution, with time increasing to the right."""
        return crank_angle(clockwise=self.direction < 0.0, limits=(0.0, FULL))

    def overlay(self, values: Array, unit: Scale, name: str, colour: str = RESULT, advance: float = 0.0) -> list[Curve]:
        """Return every revolution after the running-in as a thin curve and the last one as a bold curve, of values (n,) [SI]."""
        curves = []
        if self.shown > 1:
            rows = slice(self.rows(self.shown).start, self.rows(1).start + 1)
            opacity = min(0.9, max(0.25, 6.0 / self.shown))
            x, y = self.fold(values * unit.factor, rows, advance * unit.factor)
            thin = partial(Curve, width=0.6, opacity=opacity, legend=False, hover=False, gid="revolutions")
            curves.append(thin(x, y, "earlier revolutions", MUTED))
        x, y = self.fold(values * unit.factor, self.rows(1), advance * unit.factor)
        return [*curves, Curve(x, y, name, colour, 1.7, gid="last revolution")]

    def bands(self, contact: Array, rows: slice, name: str) -> list[Span]:
        """Return the crank angles at which journal and bearing are in contact (1, else 0, at all rows) as shaded ranges."""
        x, touching = self.fold(contact, rows)
        spans: list[Span] = []
        for piece in np.split(np.arange(len(x)), np.flatnonzero(np.isnan(x))):
            finite_rows = piece[np.isfinite(x[piece])]
            at = x[finite_rows]
            for a, b in runs(touching[finite_rows] > 0.5):
                begin, end = 0.5 * (at[a] + at[max(0, a - 1)]), 0.5 * (at[b] + at[min(len(at) - 1, b + 1)])
                if begin != end:
                    low, high = sorted((float(begin), float(end)))
                    spans.append(Span(low, high, "" if spans else name, SHADE, 0.75, gid="contact"))
        return spans

    # --- time as abscissa ----------------------------------------------------------------------------------------------

    def ends(self, rows: slice) -> list[Line]:
        """Return the ends of the revolutions [s] within rows as vertical lines."""
        first, last = (self.time[rows][k] for k in (0, -1))
        times = [k * self.period for k in range(math.ceil(first / self.period - 1e-9), self.last + 1)]
        return [Line(at, "", MUTED, 0.9, "dot", gid="revolution") for at in times if first < at < last - 1e-6 * (last - first)]


def fold(angle: Array, values: Array, advance: float = 0.0) -> tuple[Array, Array]:
    """Return crank angles within a revolution [deg] and values, with NaN between revolutions.

    `angle` is continuous [deg]; `advance` is subtracted from the values for every whole turn of the crank.
    """
    turn = np.floor(angle / FULL + 1e-9)
    x, y = angle - FULL * turn, values - advance * turn
    at = np.flatnonzero(np.diff(turn) != 0.0)
    if not at.size:
        return x, y
    border = FULL * np.maximum(turn[at], turn[at + 1])
    share = (border - angle[at]) / (angle[at + 1] - angle[at])
    border_values = values[at] + share * (values[at + 1] - values[at])
    gaps = np.full(len(at), np.nan)
    at_ends = [(border - FULL * turn[at + side], border_values - advance * turn[at + side]) for side in (0, 1)]
    places = np.repeat(at + 1, 3)
    xs, ys = (np.stack([before, gaps, after], axis=1).ravel() for before, after in zip(*at_ends, strict=True))
    return np.insert(x, places, xs), np.insert(y, places, ys)


def rough(value: float, unit: str) -> str:
    """Format a value [SI] with four significant digits and its unit."""
    shown = scale(value, unit)
    return f"{value * shown.factor:.4g}{'°' if unit == 'deg' else ' ' + shown.unit}"


def runs(mask: Mask) -> list[tuple[int, int]]:
    """Return the first and last index of each run of true values."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8)))
    return [(int(a), int(b) - 1) for a, b in edges.reshape(-1, 2)]


def revolution_axis(numbers: Array) -> Axis:
    """Return the axis of revolution numbers, with whole numbers as ticks."""
    step = max(1, int(round_below(len(numbers) / 8.0)))
    ticks = [(float(number), f"{number:g}") for number in numbers if number % step == 0.0]
    return Axis("revolution", (numbers[0] - 0.5, numbers[-1] + 0.5), ticks=ticks)


def joint_name(gap: Gap) -> str:
    """Format the name of a joint with clearance."""
    return f"{gap.point}: {gap.journal} in {gap.bearing}"


# --- limits of y ---------------------------------------------------------------------------------------------------------


def from_zero(largest: float) -> tuple[float, float]:
    """Return limits from zero to slightly above the largest value."""
    return 0.0, 1.08 * largest if 0.0 < largest < math.inf else 1.0


def clipped_limits(turns: RevolutionCurves, values: Array, low: float, high: float) -> tuple[tuple[float, float], str]:
    """Return limits of the last revolution and most others, down to low and up to high, and ", cut off" if values exceed them."""
    every = values[turns.rows(turns.shown)]
    top = max(high, np.max(values[turns.rows(1)]), np.percentile(every, LIMITS_PERCENTILE))
    top = top if top > 0.0 else 1.0
    return (1.08 * low, 1.08 * top), ", cut off" if np.max(every) > 1.08 * top else ""


def padded_limits(values: Array, least: float = 0.0) -> tuple[float, float]:
    """Return limits of all finite values with a margin; the least range is a share of the largest absolute value."""
    low, high = finite_range(values)
    width = max(high - low, least * max(abs(low), abs(high))) or 1.0
    return 0.5 * (low + high) - 0.58 * width, 0.5 * (low + high) + 0.58 * width
