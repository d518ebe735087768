"""Analyse a machine over its cycle: motion, reactions, torque and work at constant crank speed."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from optlink.dynamics.change_points import pin_columns, unbounded_reactions
from optlink.dynamics.columns import Record, slider_names
from optlink.dynamics.flywheel import Flywheel, flywheel
from optlink.dynamics.inertia import Inertia
from optlink.dynamics.inverse import acting_on
from optlink.dynamics.machine import Machine
from optlink.dynamics.strokes import Acting, acting_loads, travels_by_use, use_of, working_stroke
from optlink.dynamics.work import Work
from optlink.errors import Fault, InputError
from optlink.io import Summary, finite, head
from optlink.linkage.alignment import Aligned, listed
from optlink.linkage.extrema import extremes, zeros
from optlink.linkage.stroke import TURN, Ranges, Travel, failure, reachable, stopping, travels, within_cycle
from optlink.linkage.vector2d import Value
from optlink.problem.file import ProblemFile
from optlink.problem.fixed_design import settled
from optlink.problem.quantity import Unusable

Array = NDArray[np.float64]
SCHEMA = "optlink/analysis/1"
MAX_POINTS = 1_000_000
GRID = 720  # positions among which extremes are bracketed
ROUNDED = 1e-5  # rad from a passed change point: reactions are inaccurate there
BESIDE = 1e-6  # rad from a singular position: rates and forces are rounding errors there
MARGIN = 1e-3  # fraction of a limited range omitted at either end: speeds are infinite at a dead position


class Extreme(NamedTuple):
    """Least and largest value of a column over the motion, and the crank angles [rad] at which they occur.

    If the crank turns fully, the angles lie within one cycle from 0 on; otherwise within the range.
    """

    least: float
    least_at: float
    largest: float
    largest_at: float


@dataclass(frozen=True, repr=False)
class Analysis(Summary):
    """Result of the analysis of a machine over its cycle.

    `columns` by name (unit at the end), each an array over the sampled crank angles; `meanings` describe them; `extremes` are
    refined to their exact crank angles, one-sided at load jumps; `unbounded`: columns of reactions that grow without bound
    towards change points through which the motion is continued; `swings` of bodies and `strokes` of sliders (by slider name).
    """

    problem: ProblemFile
    machine: Machine
    speed: float
    ranges: Ranges
    low: float
    high: float
    columns: Mapping[str, Array]
    meanings: Mapping[str, str]
    extremes: Mapping[str, Extreme]
    swings: Mapping[str, Travel]
    strokes: Mapping[str, Travel]
    jumps: Array
    work: float
    singular: Array
    jammed: Array
    undefined: Array
    notes: tuple[str, ...]
    flywheel: Flywheel | None = None
    unbounded: tuple[str, ...] = ()

    def __getitem__(self, name: str) -> Array:
        return self.columns[name]

    @property
    def full(self) -> bool:
        """Whether the crank turns fully."""
        return self.ranges.full

    @property
    def cycle(self) -> float:
        """Crank rotation [rad] after which the motion repeats, if the crank turns fully."""
        return self.machine.mechanism.cycle

    @property
    def extent(self) -> str:
        """Interval over which works and strokes are counted, in words."""
        if not self.full:
            return "over the range"
        return "per revolution" if self.cycle == TURN else "per cycle"

    def _within(self, crank_angles: Array) -> list[float]:
        """Return crank angles [deg], without duplicates, reduced to one cycle if the crank turns fully."""
        angles = [within_cycle(at, self.cycle) if self.full else float(at) for at in crank_angles]
        return sorted({round(math.degrees(at), 9) for at in angles})

    @property
    def sound(self) -> bool:
        """Whether the motion is determined and every position has finite reactions."""
        return self.singular.size == 0 and self.jammed.size == 0 and self.undefined.size == 0

    @property
    def status(self) -> str:
        """Short verdict."""
        if self.ranges.singular:
            return "motion not determined beyond a singular position"
        if not self.sound:
            return "no finite reactions at some positions"
        return "analysed, but for reactions at change points" if self.unbounded else "analysed"

    @property
    def figures(self) -> dict[str, float]:
        """Summary figures by name: extremes, strokes, swings, time ratios, work."""
        found = {}
        for name, extreme in self.extremes.items():
            found[f"{name}.min"], found[f"{name}.max"] = extreme.least, extreme.largest
        for name, travel in self.strokes.items():
            found[f"{name}.stroke_m"] = travel.span
            found[f"{name}.time_ratio"] = travel.time_ratio
        for name, travel in self.swings.items():
            found[f"{name}.swing_rad"] = travel.span
            found[f"{name}.swing_time_ratio" if name in self.strokes else f"{name}.time_ratio"] = travel.time_ratio
        found[f"input.work_{self.extent.replace('the ', '').replace(' ', '_')}_J"] = self.work
        return {name: value for name, value in found.items() if math.isfinite(value)}

    @cached_property
    def acting(self) -> tuple[Acting, ...]:
        """Loads that act in one stroke only; empty if the crank cannot turn fully."""
        return acting_loads(self.machine, self.speed) if self.full else ()

    def _travel(self, travel: Travel, unit: str) -> dict[str, Any]:
        return {
            f"span_{unit}": travel.span,
            f"low_{unit}": travel.low,
            f"high_{unit}": travel.high,
            "low_at_deg": math.degrees(travel.low_at),
            "high_at_deg": math.degrees(travel.high_at),
            "dead_centres_deg": [math.degrees(at) for at in travel.dead_centres],
            "time_ratio": travel.time_ratio,
            **stroke_records(travel, self.speed, self.acting),
        }

    def to_dict(self) -> dict[str, Any]:
        """Return the analysis as a JSON document: SI, or the unit that ends the key; null where there is no finite value."""
        mechanism = self.machine.mechanism
        deg = math.degrees
        document = {
            **head(SCHEMA, self.problem, self.status),
            "sound": self.sound,
            "notes": list(self.notes),
            "groups": [{"kind": g.kind, "joint": g.joint, "bodies": [link.body for link in g.links]} for g in mechanism.groups],
            "sizes": dict(self.machine.sizes),
            "speed_rad_s": self.speed,
            "full_rotation": self.full,
            "reachable_deg": [[deg(low), deg(high)] for low, high in self.ranges.ranges],
            "reactions": reactions_told(self.machine),
            "strokes": {name: self._travel(travel, "m") for name, travel in self.strokes.items()},
            "swings": {name: self._travel(travel, "rad") for name, travel in self.swings.items()},
            "extremes": {
                name: {"min": e.least, "min_at_deg": deg(e.least_at), "max": e.largest, "max_at_deg": deg(e.largest_at)}
                for name, e in self.extremes.items()
            },
            "load_jumps_deg": self._within(self.jumps),
            "work_J": self.work,
            "singular_deg": self._within(self.singular),
            "singular_positions": [
                {
                    "crank_angle_deg": deg(p.crank_angle),
                    "joint": p.group.joint,
                    "alignment_deg": deg(p.angle),
                    "followed": p.followed,
                }
                for p in (*self.ranges.singular, *self.ranges.followed)
            ],
            "cycle_deg": deg(self.cycle) if self.full else None,
            "unbounded": list(self.unbounded),
            "jammed_deg": self._within(self.jammed),
            "undefined_deg": self._within(self.undefined),
            "meanings": dict(self.meanings),
            "columns": dict(self.columns),
        }
        if self.flywheel:
            document["flywheel"] = vars(self.flywheel) | {"mean_speed_over": "crank angle"}
        return finite(document)  # type: ignore[no-any-return]


def stroke_records(travel: Travel, speed: float, acting: tuple[Acting, ...]) -> dict[str, Any]:
    """Return the working, slow, forward and backward stroke of an output as JSON, with crank ranges in the direction of rotation.

    Parameters
    ----------
    travel : Travel
    speed : float [rad/s]
        Crank speed; only its sign matters.
    acting : tuple of Acting
        Loads that act in one stroke only.
    """
    working, loads = working_stroke(travel, speed, acting)
    strokes = travel.strokes(speed)
    return {
        "slow_stroke": next((stroke.name for stroke in strokes if stroke.pace == "slow"), None),
        "working_stroke": working,
        "working_loads": list(loads),
        **{
            stroke.name: {
                "crank_from_deg": math.degrees(stroke.begin),
                "crank_to_deg": math.degrees(stroke.end),
                "crank_rotation_deg": math.degrees(stroke.rotation),
                "pace": stroke.pace,
                "use": use_of(stroke, working) or None,
            }
            for stroke in strokes
        },
    }


def named_travels(machine: Machine) -> tuple[dict[str, Travel], dict[str, Travel]]:
    """Return travels of the outputs and of the other bodies and sliders of a machine whose crank turns fully, by name."""
    swings, strokes = travels(machine.mechanism, machine.sizes, 0.0, TURN, True)
    names = slider_names(machine)
    return travels_by_use(machine, swings, {names[guide]: travel for guide, travel in strokes.items()})


def stroke_document(machine: Machine, speed: float, acting: tuple[Acting, ...] | None = None) -> dict[str, Any]:
    """Return the strokes of every output of a machine whose crank turns fully, as JSON.

    Parameters
    ----------
    machine : Machine
    speed : float [rad/s]
        Crank speed; only its sign matters.
    acting : tuple of Acting, optional
        Loads that act in one stroke only. Default: the loads of the machine.
    """
    acting = acting_loads(machine, speed) if acting is None else acting
    return {
        name: {"time_ratio": travel.time_ratio, **stroke_records(travel, speed, acting)}
        for part in named_travels(machine)
        for name, travel in part.items()
    }


def turning(problem: ProblemFile, design: Mapping[str, float]) -> Machine | None:
    """Return the machine of a design if its crank turns fully, else None.

    Parameters
    ----------
    problem : ProblemFile
    design : mapping of str to float [SI]
    """
    if not all(math.isfinite(value) for value in design.values()):
        return None
    try:
        machine = machine_of(settled(problem, design))
    except InputError:
        return None
    return machine if reachable(machine.mechanism, machine.sizes).full else None


def reactions_told(machine: Machine) -> dict[str, str]:
    """Return for every joint which body acts on which, as defined for the columns."""
    found = {}
    for point, (by, on) in acting_on(machine).items():
        bodies = machine.mechanism.pins[point]
        if len(bodies) == 2:
            found[point] = f"{by} on {on}"
        else:
            found |= {f"{point}.{body}": f"pin on {body}" for body in (on, *(b for b in bodies if b != on))}
    for guide in machine.mechanism.guides:
        found[guide.name] = f"{guide.on} on {guide.slider}, normal to the left of the line"
    return found


def machine_of(problem: ProblemFile, design: Mapping[str, Value] | None = None) -> Machine:
    """Return the machine of a problem at a given design.

    Parameters
    ----------
    problem : ProblemFile
    design : mapping of str to float or array [SI], optional
        Design variables. Default: fixed values and starting values of the file.

    Raises
    ------
    InputError
        If the machine cannot be built.
    """
    try:
        return problem.model.machine(design)
    except Unusable as error:
        raise InputError(Fault(error.message, error.remedy, problem.file, error.key, error.value)) from None


def crank_speed(problem: ProblemFile) -> float:
    """Return the constant speed of the crank [rad/s].

    Raises
    ------
    InputError
        If it is zero, as in a file that is simulated from rest.
    """
    speed = problem.model.drive.speed
    if speed.value == 0.0:
        remedy = "Give another one: a revolution at constant speed is asked for"
        raise InputError(Fault("the crank stands still", remedy, problem.file, "drive.speed", str(speed)))
    return speed.value


def with_flywheel(machine: Machine, inertia: float) -> Machine:
    """Return the machine with a flywheel on its crank, balanced about the crank pivot.

    Parameters
    ----------
    machine : Machine
    inertia : float [kg m^2]

    Raises
    ------
    InputError
        If the inertia is out of range.
    """
    if not 0.0 <= inertia < 1e12:
        raise InputError(Fault("out of range", "Give a moment of inertia from 0 to 1e12 kg*m^2", key="flywheel", value=inertia))
    crank = machine.mechanism.crank.body
    own = machine.inertias.get(crank, Inertia())
    return machine.with_(inertias={**machine.inertias, crank: replace(own, moment=own.moment + inertia)})


def motion_range(problem: ProblemFile, machine: Machine, start: float) -> tuple[Ranges, float, float]:
    """Return the reachable crank ranges, and the limits [rad] of the motion that contains `start`.

    If the crank turns fully, the motion is one cycle from `start` on.

    Parameters
    ----------
    problem : ProblemFile
        Names the file in error messages.
    machine : Machine
    start : float [rad]
        Crank angle.

    Raises
    ------
    InputError
        If the mechanism cannot be assembled at the start.
    """
    ranges = reachable(machine.mechanism, machine.sizes)
    if ranges.full:
        return ranges, start, start + machine.mechanism.cycle
    holding = ranges.holding(start)
    if holding is None:
        failed = failure(machine.mechanism, machine.sizes, start)
        reach = ", ".join(f"{math.degrees(a):.6g} ... {math.degrees(b):.6g} deg" for a, b in ranges.ranges)
        remedy = f"Start in a range that can be reached: {reach}" if reach else "No crank angle can be reached: change the sizes"
        message = f"{failed}" if failed else "the mechanism cannot be assembled"
        raise InputError(Fault(message, remedy, problem.file, "drive.start", f"{math.degrees(start):.6g} deg"))
    low, high = holding
    return ranges, low, high


def check_regular(problem: ProblemFile, ranges: Ranges, what: str) -> None:
    """Refuse mechanisms with singular positions, continued or not: reactions may grow without bound towards them.

    Parameters
    ----------
    problem : ProblemFile
        Names the file in error messages.
    ranges : Ranges
    what : str
        End of the error message.

    Raises
    ------
    InputError
        If there is a singular position.
    """
    positions = (*ranges.singular, *ranges.followed)
    if positions:
        message = f"singular position at crank angle {listed(positions)}, where reactions have no bound: {what}"
        remedy = "Change the lengths so that coupler and rocker, or a link and the normal of its guide, are never in line"
        raise InputError(Fault(message, remedy, problem.file, "mechanism"))


def sampled(start: float, low: float, high: float, speed: float, full: bool, points: int, step: float | None) -> Array:
    """Return the crank angles [rad] of the table: one cycle from the start in the direction of rotation, or through the range.

    Parameters
    ----------
    start : float [rad]
        First crank angle if the crank turns fully.
    low, high : float [rad]
        Limits of the motion. A limited range is shortened by `MARGIN` at either end.
    speed : float [rad/s]
        Crank speed; only its sign matters.
    full : bool
        Whether the crank turns fully.
    points : int
        Steps per revolution, or over the limited range.
    step : float [rad], optional
        Step instead of `points`.
    """
    way = 1.0 if speed > 0.0 else -1.0
    if not full:
        edge = MARGIN * (high - low)
        first, last = (low + edge, high - edge) if way > 0.0 else (high - edge, low + edge)
        count = points if step is None else max(1, round((high - low) / step))
        return np.asarray(first + (last - first) * (np.arange(count + 1) / count), dtype=float)
    if step is None:
        rows = points * max(1, round((high - low) / TURN))
        return np.asarray(start + way * TURN * np.arange(rows + 1) / points, dtype=float)
    count = math.floor((high - low) / step * (1.0 + 1e-12))
    return np.asarray(start + way * step * np.arange(count + 1), dtype=float)


def analyze(
    problem: ProblemFile,
    points: int = 360,
    step: float | None = None,
    speed: float | None = None,
    design: Mapping[str, float] | None = None,
) -> Analysis:
    """Analyse a machine over its cycle at constant crank speed: motion, reactions, torque, work.

    Parameters
    ----------
    problem : ProblemFile
        From `optlink.load`.
    points : int
        Steps of the table per revolution (or over the range); it has one row more.
    step : float [rad], optional
        Step instead of `points`.
    speed : float [rad/s], optional
        Crank speed, negative clockwise. Default: that of the problem.
    design : mapping of str to float [SI], optional
        Design variables. Default: their starting values.

    Raises
    ------
    InputError
        If the mechanism cannot be assembled, or an argument is out of range.
    """
    model = problem.model
    speed = crank_speed(problem) if speed is None else speed
    _check(points, step, speed)
    machine, start = machine_of(problem, design), model.drive.start.value
    ranges, low, high = motion_range(problem, machine, start)
    cycle = machine.mechanism.cycle
    angles = sampled(start, low, high, speed, ranges.full, points, step)
    if not ranges.full:
        edge = MARGIN * (high - low)
        low, high = low + edge, high - edge
        start = float(angles[0])
    elif speed < 0.0:
        low, high = start - cycle, start
    work = Work(machine, start, low, high, speed)
    columns, meanings, (singular, jammed, undefined) = _table(machine, angles, speed, work)
    found: dict[str, Extreme] = {}
    swings: dict[str, Travel] = {}
    strokes: dict[str, Travel] = {}
    unbounded: tuple[str, ...] = ()
    if ranges.singular:  # two branches continue the motion: it is not determined as a whole
        singular = _undetermined(columns, singular, ranges.singular, low, high)
    else:
        unbounded = unbounded_reactions(machine, ranges.followed, speed)
        singular = _beyond(singular, ranges.followed, cycle)
        found = _extremes(machine, low, high, ranges, speed, work)
        found = {name: extreme for name, extreme in found.items() if name not in unbounded}
        swings, strokes = travels(machine.mechanism, machine.sizes, low, high, ranges.full)
    names = slider_names(machine)
    share = None if ranges.singular else model.drive.fluctuation
    end = start + math.copysign(cycle, speed) if ranges.full else float(angles[-1])
    return Analysis(
        problem,
        machine,
        speed,
        ranges,
        low,
        high,
        columns,
        meanings,
        found,
        swings,
        {names[guide]: travel for guide, travel in strokes.items()},
        work.jumps,
        math.nan if ranges.singular else float(work(np.array([end]))[0]),
        singular,
        jammed,
        undefined,
        (
            *_notes(problem, ranges, design, machine, columns, singular, jammed, undefined),
            *_followed_notes(machine, ranges, unbounded),
            *(quick_stroke_notes(problem, machine, speed) if ranges.full else ()),
        ),
        flywheel(machine, speed, share, low) if share is not None and ranges.full else None,
        unbounded,
    )


def _check(points: int, step: float | None, speed: float) -> None:
    if not 1 <= points <= MAX_POINTS:
        raise InputError(Fault("out of range", f"Give a number from 1 to {MAX_POINTS:,}", key="points", value=points))
    if step is not None and not TURN / MAX_POINTS <= step <= TURN:
        raise InputError(Fault("out of range", "Give a step from 0.001 deg to 360 deg", key="step", value=f"{step:.6g} rad"))
    if not 1e-9 <= abs(speed) <= 1e6:
        remedy = 'Give one between 1e-9 and 1e6 rad/s, for statics a low one such as "0.01 rpm"'
        raise InputError(Fault("out of range", remedy, key="speed", value=f"{speed:.6g} rad/s"))


PLACES = ("_deg", "_rad", "_m", "time_s", "energy.potential_J")
"""Endings of the columns that a position alone determines, and time."""

CONTINUED = 'assembly = "continue" (or ", continue" behind a mode)'
FAULTS = ("singular", "jammed", "undefined")
CHUNK = 20_000  # positions of the table per block


def _table(machine: Machine, angles: Array, speed: float, work: Work) -> tuple[dict[str, Array], dict[str, str], list[Array]]:
    """Return the columns of the table, their meanings, and the positions without finite reactions (by `FAULTS`)."""
    parts = [Record(machine.moving(angles[k : k + CHUNK], speed)) for k in range(0, len(angles), CHUNK)]
    columns = {"crank_angle_deg": np.degrees(angles), "time_s": np.abs(angles - angles[0]) / abs(speed)}
    meanings = {"crank_angle_deg": "crank angle", "time_s": "time since the first row"}
    for name, column in parts[0].columns.items():
        columns[name] = np.concatenate([part[name] for part in parts])
        meanings[name] = column.meaning
        if name.endswith(".angle_rad") and len(parts) > 1:
            columns[name] = np.unwrap(columns[name])
        if name == "input.power_W":
            columns["input.work_J"], meanings["input.work_J"] = work(angles), "work of the drive since the first row"
    return columns, meanings, [angles[np.concatenate([getattr(p, kind) for p in parts])] for kind in FAULTS]


def _undetermined(columns: dict[str, Array], rows: Array, positions: Iterable[Aligned], low: float, high: float) -> Array:
    """Remove values without a meaning at singular positions from the table; return the crank angles [rad] of these positions."""
    angles = np.radians(columns["crank_angle_deg"])
    exact = np.array([low + (position.crank_angle - low) % TURN for position in positions])
    exact = np.where(exact - low > TURN - BESIDE, low, exact)
    apart = np.abs(np.remainder(angles[:, None] - exact + math.pi, TURN) - math.pi)
    beside = np.any(apart <= BESIDE, axis=1)
    for name, column in columns.items():
        if name == "input.work_J":
            columns[name] = np.full(column.shape, np.nan)
        elif not name.endswith(PLACES):
            columns[name] = np.where(beside, np.nan, column)
    others = rows[np.all(np.abs(rows[:, None] - exact) > BESIDE, axis=1)] if rows.size else rows
    return np.unique(np.concatenate([others, exact[exact <= high + BESIDE]]))


def _beyond(rows: Array, positions: Iterable[Aligned], cycle: float) -> Array:
    """Return crank angles [rad] of rows without finite reactions other than positions through which the motion is continued."""
    for position in positions:
        rows = rows[np.abs(np.remainder(rows - position.crank_angle + 0.5 * cycle, cycle) - 0.5 * cycle) > BESIDE]
    return rows


def _extremes(machine: Machine, low: float, high: float, ranges: Ranges, speed: float, work: Work) -> dict[str, Extreme]:
    """Return the least and largest value of every column over the motion, one-sided at load jumps."""
    pins, full, cycle = pin_columns(machine), ranges.full, machine.mechanism.cycle
    passed = np.array([position.crank_angle for position in ranges.followed])

    def values(angles: Array, side: int = 1) -> Array:
        record = Record(machine.moving(angles, speed, side=side))
        apart = np.abs(np.remainder(angles[:, None] - passed + 0.5 * cycle, cycle) - 0.5 * cycle)
        singular = record.singular | np.any(apart < ROUNDED, axis=1)
        rows = [
            np.where(singular, np.nan, column.values) if name in record.held else column.values
            for name, column in record.columns.items()
            if not name.endswith(".angle_rad")
        ]
        for _, point, body in pins:
            x, y = (record.full(part) for part in record.reactions.pins[point][body])
            rows.append(np.where(singular, np.nan, np.hypot(x, y)))
        return np.array(rows)

    first = Record(machine.moving(np.array([low]), speed))
    names = [name for name in first.columns if not name.endswith(".angle_rad")]
    names += [name for name, _, _ in pins]
    count = GRID * (max(1, round(cycle / TURN)) if full else 1)
    step, seam = (high - low) / count, int(full)  # a full rotation is periodic: one further step on either side
    even = low + step * np.arange(-seam, count + 1 + seam)
    grid = np.unique(np.concatenate([even, work.jumps]))
    at, best = extremes(values, grid, tuple(work.jumps), [name.rpartition("_")[2] for name in names])
    if work.jumps.size:
        before = values(work.jumps, side=-1)
        for k, sign in ((0, 1.0), (1, -1.0)):
            scored = np.where(np.isfinite(before), before * sign, np.inf)
            place = np.argmin(scored, axis=1)
            other = before[np.arange(len(before)), place]
            better = np.isfinite(other) & ~(best[:, k] * sign <= other * sign)
            best[:, k], at[:, k] = np.where(better, other, best[:, k]), np.where(better, work.jumps[place], at[:, k])

    def placed(angle: float) -> float:
        return within_cycle(angle, cycle) if full and math.isfinite(angle) else float(angle)

    found = {
        name: Extreme(float(best[i, 0]), placed(at[i, 0]), float(best[i, 1]), placed(at[i, 1])) for i, name in enumerate(names)
    }
    inside = grid[(grid >= low) & (grid <= high)]
    turning = zeros(lambda angles: work.torque(angles)[None, :], inside)[0]
    places = np.unique(np.concatenate([[low, high], turning, work.jumps]))
    amounts = work(places)
    if np.any(np.isfinite(amounts)):
        i, j = int(np.nanargmin(amounts)), int(np.nanargmax(amounts))
        found["input.work_J"] = Extreme(float(amounts[i]), placed(places[i]), float(amounts[j]), placed(places[j]))
    return found


def quick_stroke_notes(problem: ProblemFile, machine: Machine, speed: float) -> list[str]:
    """Return a note for every load that acts in the quick stroke although the file does not specify "quick".

    Parameters
    ----------
    problem : ProblemFile
    machine : Machine
    speed : float [rad/s]
        Crank speed.
    """
    notes = []
    for item in acting_loads(machine, speed):
        if item.pace == "quick" and problem.model.loads[item.load].stroke != "quick":
            rotation = math.degrees(math.fsum(end - begin for begin, end in item.ranges))
            share = f"{rotation:.5g} of {math.degrees(machine.mechanism.cycle):.5g} deg"
            notes.append(
                f"{item.load} acts in the {item.stroke} stroke of {item.body}, which is the quick one: {share} "
                f'of crank rotation (loads.{item.load}.stroke = "slow" is the other one, "quick" confirms this one)'
            )
    return notes


def _notes(
    problem: ProblemFile,
    ranges: Ranges,
    design: Mapping[str, float] | None,
    machine: Machine,
    columns: Mapping[str, Array],
    singular: Array,
    jammed: Array,
    undefined: Array,
) -> list[str]:
    notes = []
    free = [name for name in problem.model.free if design is None or name not in design]
    if free:
        notes.append(f"free quantities stand at their start values: {', '.join(free)} (--design takes a result)")
    if not ranges.full:
        reach = ", ".join(f"{math.degrees(a):.6g} ... {math.degrees(b):.6g} deg" for a, b in ranges.ranges)
        notes.append(f"the crank cannot turn fully; reachable: {reach} (the last 0.1 % at either end is left out)")
        for low, high in ranges.ranges[:1]:
            for end, way in ((low, -1.0), (high, 1.0)):
                reason = stopping(machine.mechanism, machine.sizes, end, way)
                if reason:
                    notes.append(reason)
    for position in ranges.aligned:
        if not position.singular:
            notes.append(_near(machine, position))
    if ranges.singular:
        notes.append(
            f"singular position at crank angle {listed(ranges.singular)}: the assembly modes meet, and the motion beyond it is "
            "not determined, so extremes, strokes and work are left out. Change the lengths, or follow the smooth motion: write "
            f"{CONTINUED}"
        )
        singular = np.empty(0)
    guilty = {name.rpartition(".")[0] for name, column in columns.items() if not np.all(np.isfinite(column))}
    loads = ", ".join(load.name for load in machine.loads if load.name in guilty) or "a load"
    for angles, what in (
        (singular, "a group is in a singular position, no finite reaction holds it"),
        (jammed, "friction jams a guide, or has no single answer,"),
        (undefined, f"{loads} has no finite value"),
    ):
        if angles.size:
            shown = ", ".join(f"{math.degrees(angle):.6g}" for angle in angles[:6]) + (" ..." if angles.size > 6 else "")
            notes.append(f"{what} at crank angle {shown} deg")
    if not machine.inertias and not machine.loads:
        notes.append("no masses and no loads are given, so there are no forces")
    loose = [name for name, joint in problem.model.joints.items() if joint.loose]
    if loose:
        notes.append(f"joints count as ideal here; `optlink simulate` has the clearance of {', '.join(loose)}")
    return notes


def _followed_notes(machine: Machine, ranges: Ranges, unbounded: tuple[str, ...]) -> Iterator[str]:
    """Yield notes on the continuation of the motion through change points, and on what it leaves undetermined."""
    turns = round(machine.mechanism.cycle / TURN)
    if ranges.followed:
        yield f"the motion is followed smoothly through the change points at crank angle {listed(ranges.followed)}"
    if turns > 1:
        yield f"the motion repeats after {turns} revolutions of the crank, which are one cycle here"
    if unbounded:
        names = ", ".join(dict.fromkeys(name.split(".")[0] for name in unbounded))
        yield (
            f"reactions at {names} grow without bound towards the change points: links in line cannot hold a force across them "
            "(their extremes are left out; the torque of the drive stays finite)"
        )


def _near(machine: Machine, position: Aligned) -> str:
    """Return a note on a joint whose near-alignment causes force peaks."""
    joint, amount = position.group.joint, f"{math.degrees(position.angle):.3g} deg"
    where = f"at crank angle {math.degrees(position.crank_angle):.6g} deg"
    name = f"{joint}.transmission_rad"
    found = Record(machine.moving(np.array([position.crank_angle])), (name,))
    if name in found.columns:
        what = f"the transmission angle at {joint} is {math.degrees(float(found[name][0])):.6g} deg,"
    else:
        what = f"the {position.group.kind} group of {joint} is"
    return f"{where} {what} {amount} from alignment: accelerations and forces peak there"
