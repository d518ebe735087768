"""Characteristics of the whole motion: crank ranges, dead centres, strokes, swing angles, time ratios."""

import itertools
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from optlink.linkage.dyads import PRP
from optlink.linkage.extrema import distinct, zeros
from optlink.linkage.jet import Jet
from optlink.linkage.mechanism import Dyad, Mechanism
from optlink.linkage.motion import Motion, sweep
from optlink.linkage.singular import GRID, AlignedPosition, alignment_margin, least_alignments, least_margin
from optlink.linkage.vector2d import TURN, Array, Value, whole_turns

SEAM = 1e-6
"""Crank rotations [rad] that differ from a whole cycle by less count as one: the accuracy of flat extrema."""
PARALLEL_AT_END = 1e-4
"""Sine of the angle of two guides below which they count as parallel at the end of a range."""
LEAST_DIFFERENCE = math.radians(0.1)
"""Crank rotations [rad] of two strokes that differ by less count as equally long: neither is the slow one."""
ROUNDING = 1e-9
"""Rate of a body's angle [-], or of a slide as a share of its largest value, over the crank angle that is rounding: it stands."""
Direction = Literal["forward", "backward"]
Pace = Literal["slow", "quick", "equal"]
OTHER: dict[Direction, Direction] = {"forward": "backward", "backward": "forward"}
"""The opposite of each direction of motion."""


def within_cycle(crank_angle: float, cycle: float = TURN) -> float:
    """Reduce the crank angle [rad] of a periodic motion to one cycle [rad], from 0; those within rounding of it give 0."""
    angle = float(crank_angle) % cycle
    return 0.0 if cycle - angle < SEAM else angle


@dataclass(frozen=True)
class Failure:
    """A position that cannot be reached: the group that fails to close, and its gap [m]."""

    crank_angle: float
    group: Dyad
    gap: float

    def __str__(self) -> str:
        return self.at(f"crank angle {math.degrees(self.crank_angle):.6g} deg")

    def at(self, position: str) -> str:
        """Return what fails at a position in words."""
        first, second = (link.body for link in self.group.links)
        what, where = f"the {self.group.kind} group {first}-{second} (joint {self.group.joint})", f"at {position}"
        if self.group.least > 0.0:
            return f"{where} {what} has no defined position: its two guides are parallel"
        amount = f" by {self.gap * 1e3:.6g} mm" if self.gap > 0.0 else ""
        return f"{where} {what} fails to close{amount}"


def range_end_reason(mechanism: Mechanism, sizes: Mapping[str, Value], end: float, way: float) -> str:
    """Return the reason why the crank cannot turn beyond the end of a range [rad], or an empty string if it is unknown.

    `way` is +1 at the upper end of the range and -1 at the lower end.
    """
    if failed := failure(mechanism, sizes, end + way * math.radians(1.0)):
        return f"one degree further, {failed}"
    with np.errstate(all="ignore"):
        pose = mechanism.at(sizes, np.array([end]))
        for group in mechanism.groups:
            if isinstance(group, PRP) and float(np.abs(group.sine(pose)).item()) <= PARALLEL_AT_END:
                return f"{Failure(end, group, 0.0)}"
    return ""


@dataclass(frozen=True)
class Ranges:
    """Ranges of crank angle [rad] in which every group closes; `full` where that is the whole revolution.

    `aligned`: positions within the ranges in which a group is near alignment, or in a singular position; `limits`: the range that
    is asked for, beyond which nothing is examined; `cycle`: rotation [rad] after which they repeat.
    """

    ranges: tuple[tuple[float, float], ...]
    full: bool
    aligned: tuple[AlignedPosition, ...] = ()
    limits: tuple[float, float] | None = None
    cycle: float = TURN

    @property
    def complete(self) -> bool:
        """Whether the motion that is asked for is possible: every group closes in all of the range, or revolution."""
        return self.full or (self.limits is not None and self.ranges == (self.limits,))

    @property
    def singular(self) -> tuple[AlignedPosition, ...]:
        """Singular positions beyond which the motion is not determined, in the order of the crank angle."""
        return self._meeting(followed=False)

    @property
    def followed(self) -> tuple[AlignedPosition, ...]:
        """Singular positions through which a group is continued, in the order of the crank angle."""
        return self._meeting(followed=True)

    @property
    def text(self) -> str:
        """The ranges, for display."""
        return ", ".join(f"{math.degrees(a):.6g} ... {math.degrees(b):.6g} deg" for a, b in self.ranges)

    def _meeting(self, *, followed: bool) -> tuple[AlignedPosition, ...]:
        positions = [position for position in self.aligned if position.singular and position.followed == followed]
        return tuple(sorted(positions, key=lambda position: position.crank_angle))

    def holding(self, crank_angle: float) -> tuple[float, float] | None:
        """Return the range that contains a crank angle, shifted to it by whole cycles; None if there is none."""
        for low, high in self.ranges:
            shift = self.cycle * math.ceil((low - crank_angle) / self.cycle - 1e-12)
            if low - 1e-12 <= crank_angle + shift <= high + 1e-12:
                return low - shift, high - shift
        return None


def range_grid(low: float, high: float) -> Array:
    """Return the crank angles [rad] between which the ends of the ranges are bracketed."""
    return np.linspace(low, high, GRID * whole_turns(high - low) + 1)


@np.errstate(all="ignore")
def reachable(mechanism: Mechanism, sizes: Mapping[str, Value]) -> Ranges:
    """Compute the ranges in which the crank can turn as `optlink.linkage.reachable`, without a check of the arguments.

    Parameters
    ----------
    mechanism : Mechanism
    sizes : mapping of parameter name to float [m, rad]
    """
    aligned = least_alignments(mechanism, sizes)
    lowest = [position.crank_angle for position in aligned if not position.singular]
    limits, cycle = mechanism.limits, mechanism.cycle
    begin, end = limits or (0.0, cycle)
    grid = range_grid(begin, end)
    grid = distinct(np.concatenate([grid, [angle for angle in lowest if limits is None or begin < angle < end]]))
    crossing = [group for group in mechanism.groups if isinstance(group, PRP)]  # its lines may become parallel within the motion

    def function(angles: Array) -> Array:
        pose = mechanism.at(sizes, angles)
        sines = [np.broadcast_to(group.sine(pose), angles.shape) for group in crossing]
        margins = (pose.margins[group.joint] - group.least for group in mechanism.groups)
        return np.array([least_margin(pose, margins), *sines])

    def closed(angles: Array) -> bool:
        return bool(np.all(alignment_margin(mechanism.at(sizes, angles)) >= 0.0))

    failing = not closed(grid)
    whole = Ranges(((begin, end),), limits is None, tuple(aligned), limits, cycle)
    if not failing and not crossing:
        return whole
    margin, *sines = zeros(function, grid)
    ends = distinct(np.concatenate([margin if failing else [], *sines]))  # a margin that only touches zero is not an end
    if len(ends) == 0:
        return replace(whole, ranges=(), full=False, aligned=()) if failing else whole
    cuts = [*ends, ends[0] + cycle] if limits is None else distinct(np.concatenate([[begin], ends, [end]])).tolist()
    ranges = [
        (_inside(function, a, 1.0), _inside(function, b, -1.0))
        for a, b in itertools.pairwise(cuts)
        if function(np.array([0.5 * (a + b)]))[0, 0] >= 0.0
    ]
    if not sines and limits is None:
        ranges = _joined(ranges, cycle, closed)
    result = Ranges(tuple(ranges), False, limits=limits, cycle=cycle)
    held = [(position, result.holding(position.crank_angle)) for position in aligned]
    return replace(
        result,
        aligned=tuple(p for p, ends in held if ends and min(p.crank_angle - ends[0], ends[1] - p.crank_angle) > 1e-6),
    )


def _joined(ranges: list[tuple[float, float]], cycle: float, closed: Callable[[Array], bool]) -> list[tuple[float, float]]:
    """Merge ranges that are separated only by rounding at a singular position."""
    joined: list[tuple[float, float]] = []
    for low, high in ranges:
        if joined and closed(np.linspace(joined[-1][1], low, 9)):
            joined[-1] = joined[-1][0], high
        else:
            joined.append((low, high))
    if len(joined) > 1 and closed(np.linspace(joined[-1][1], joined[0][0] + cycle, 9)):
        (_, high), (low, _) = joined.pop(0), joined.pop()
        joined.append((low, high + cycle))
    return joined


def _inside(function: Callable[[Array], Array], end: float, way: float) -> float:
    """The end of a range, on the side where the mechanism closes."""
    for step in (0.0, 1e-15, 1e-14, 1e-13, 1e-12, 1e-7, 1e-6):  # the last two for lines that are almost parallel
        at = end + way * step * TURN
        if function(np.array([at]))[0, 0] >= 0.0:
            return float(at)
    return float(end)


def failure(mechanism: Mechanism, sizes: Mapping[str, Value], crank_angle: float) -> Failure | None:
    """Return the first group that fails to close at a crank angle [rad], or None."""
    with np.errstate(all="ignore"):
        pose = mechanism.at(sizes, np.array([crank_angle]))
        for group in mechanism.groups:
            margin = np.asarray(pose.margins[group.joint]).item()
            if not margin >= group.least:
                return Failure(crank_angle, group, np.asarray(group.gap(pose)).item())
    return None


def slow_stroke(forward: float, backward: float) -> Direction | None:
    """Return which stroke, of crank rotations [rad], is the slow one at constant crank speed, None if both are equally long.

    Rotations that differ by less than `LEAST_DIFFERENCE` count as equally long, so that rounding never decides.
    """
    if not abs(forward - backward) >= LEAST_DIFFERENCE:
        return None
    return "forward" if forward > backward else "backward"


@dataclass(frozen=True)
class StrokeRange:
    """One stroke of an output at constant crank speed.

    `name`: "forward" where the output moves along its guide or counter-clockwise, else "backward"; `begin`, `end`: crank angles
    [rad] of its start (0 ... 2 pi) and end, the end beyond the start in the sense of crank rotation; `pace`: "slow", "quick", or
    "equal" where the two strokes are equally long.
    """

    name: Direction
    begin: float
    end: float
    pace: Pace

    @property
    def rotation(self) -> float:
        """Crank rotation during the stroke [rad], positive."""
        return abs(self.end - self.begin)


@dataclass(frozen=True)
class Travel:
    """The limited motion of a body or slider.

    `dead_centres`: crank angles [rad] at which it reverses, rising within a revolution; `low`, `high`: its limits, and `low_at`,
    `high_at` the crank angles there; `span` = high - low: stroke [m] or swing [rad]; `time_ratio`: duration of the slow stroke
    over that of the quick one, for two dead centres and constant crank speed (NaN otherwise).
    """

    dead_centres: tuple[float, ...]
    low: float
    high: float
    low_at: float
    high_at: float
    time_ratio: float

    @property
    def span(self) -> float:
        """Stroke [m] or swing angle [rad]."""
        return self.high - self.low

    def strokes(self, speed: float = 1.0) -> tuple[StrokeRange, ...]:
        """Return the forward and the backward stroke; empty unless there are two dead centres in a full revolution.

        Only the sign of the crank speed is used, negative clockwise.
        """
        if not math.isfinite(self.time_ratio):
            return ()
        sense = math.copysign(1.0, speed)
        forward = (sense * (self.high_at - self.low_at)) % TURN
        slow, low, high = slow_stroke(forward, TURN - forward), self.low_at % TURN, self.high_at % TURN
        return (
            StrokeRange("forward", low, low + sense * forward, pace_of("forward", slow)),
            StrokeRange("backward", high, high + sense * (TURN - forward), pace_of("backward", slow)),
        )


def pace_of(stroke: Direction, slow: Direction | None) -> Pace:
    """Return the pace of a stroke; `slow` is the slow one, None if both are equally long."""
    return "equal" if slow is None else "slow" if stroke == slow else "quick"


def travels(
    mechanism: Mechanism, sizes: Mapping[str, Value], low: float, high: float, full: bool
) -> tuple[dict[str, Travel], dict[str, Travel]]:
    """Compute limited motions as `optlink.linkage.travels`, without a check of the arguments.

    Parameters
    ----------
    mechanism : Mechanism
    sizes : mapping of parameter name to float [m, rad]
    low, high : float [rad]
    full : bool
    """
    outputs = [*((link.body, True) for link in mechanism.links), *((guide.name, False) for guide in mechanism.guides)]
    count = GRID * (whole_turns(mechanism.cycle) if full else 1)
    grid = low + (high - low) * np.linspace(0.0, 1.0, count + 1)
    if full:
        grid = grid + 0.37 * (grid[1] - grid[0])  # so that no dead centre at a round angle lies on the seam

    def place(angle: float) -> float:
        return within_cycle(angle, mechanism.cycle) if full else float(angle)

    def course(motion: Motion, name: str, turning: bool) -> Jet:
        return motion.body_angle(name) if turning else motion.slide(name)

    motion = sweep(mechanism, sizes, grid)
    jets = {output: course(motion, *output) for output in outputs}
    sizes_of = {output: 1.0 if output[1] else np.nanmax(np.abs(jet.value), initial=1e-12) for output, jet in jets.items()}
    moving = [one for one, jet in jets.items() if np.nanmax(np.abs(jet.rate), initial=0.0) > ROUNDING * sizes_of[one]]

    def rates(angles: Array) -> Array:
        at = sweep(mechanism, sizes, angles)
        velocities = [at.body_rate(name) if turning else at.slide(name).rate for name, turning in moving]
        return np.array(velocities).reshape(-1, len(angles))

    samples = np.array([jets[output].rate for output in moving]).reshape(-1, len(grid))
    reversals: dict[tuple[str, bool], Array] = {}
    for output, centres in zip(moving, zeros(rates, grid, still=True, samples=samples), strict=True):
        values = jets[output].value
        turns = output[1] and full and (len(centres) == 0 or abs(values[-1] - values[0]) > math.pi)
        if not turns and (len(centres) or not full):
            reversals[output] = centres
    ends_of = [np.sort(np.concatenate([centres, [] if full else [low, high]])) for centres in reversals.values()]
    there = sweep(mechanism, sizes, np.concatenate([grid[:1], *ends_of]))
    swings: dict[str, Travel] = {}
    strokes: dict[str, Travel] = {}
    done = 1
    for ((name, turning), centres), ends in zip(reversals.items(), ends_of, strict=True):
        values = np.asarray(course(there, name, turning).value)[done : done + len(ends)]
        done += len(ends)
        if turning:
            near = np.interp(ends, grid, np.asarray(jets[name, turning].value))
            values = values + TURN * np.round((near - values) / TURN)
            values = values - TURN * np.round(0.5 * (np.min(values) + np.max(values)) / TURN)
        ratio = math.nan
        if full and len(centres) == 2 and mechanism.cycle == TURN:
            forward = float(centres[1] - centres[0])
            ratio = max(forward, TURN - forward) / min(forward, TURN - forward)
        first, last = int(np.argmin(values)), int(np.argmax(values))
        limits = float(values[first]), float(values[last]), place(ends[first]), place(ends[last])
        (swings if turning else strokes)[name] = Travel(tuple(map(place, centres)), *limits, ratio)
    return swings, strokes
