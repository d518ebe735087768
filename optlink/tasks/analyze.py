"""Analyse a machine over its cycle: motion, reactions, torque and work at constant crank speed, and the result."""

from __future__ import annotations

import functools
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar, Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from optlink.dynamics.columns import FAULTS, MotionColumns, efforts, pin_columns, tabulated, unbounded_reactions
from optlink.dynamics.inverse import acting_on, depends_on_sense
from optlink.dynamics.machine import Machine, slider_names
from optlink.dynamics.strokes import StrokeLoad, acting_loads
from optlink.dynamics.work import Flywheel, Work, flywheel
from optlink.errors import InputError, UnknownName, nearest
from optlink.linkage.arguments import check_array, sweep as checked_sweep
from optlink.linkage.continuation import continue_through_singularities
from optlink.linkage.extrema import distinct, extremes_of_rows
from optlink.linkage.jet import Jet
from optlink.linkage.motion import Motion
from optlink.linkage.singular import AlignedPosition, near_alignment, near_singular, positions_text, strides
from optlink.linkage.stroke import Ranges, Travel, range_end_reason, reachable, travels, within_cycle
from optlink.linkage.vector2d import TURN, Array, Value, all_finite, whole_turns
from optlink.problem.arguments import typed
from optlink.problem.document import Renamed, Source, Tabled, reports
from optlink.problem.driving import Driving
from optlink.problem.file import AnyProblem, ProblemFile, problem_of
from optlink.problem.machine.bodies import SLOWNESS
from optlink.problem.quantity import Unusable, check_choice, check_range, read_scalar
from optlink.tasks.machine import (
    MARGIN,
    check_design,
    check_repeats,
    check_sizes,
    check_within_range,
    crank_speed,
    machine_of,
    motion_range,
    moved,
    start_value_notes,
    starting_angle,
    table_angles,
)
from optlink.tasks.results.extremes import Extremes, both_ways, distances
from optlink.tasks.results.strokes import stroke_records
from optlink.units import KINDS

if TYPE_CHECKING:
    import pandas

MAX_POINTS = 1_000_000
GRID = 720  # positions among which extremes are bracketed
SINGULAR_WIDTH = 1e-6  # rad from a singular position: rates and forces are rounding errors there


FLYWHEEL = ("mean_speed", "mean_torque", "fluctuation", "allowed", "inertia")


def _singular_documents(ranges: Ranges) -> list[dict[str, Any]]:
    """Return the positions at which the motion is not determined; `followed`: the mechanism is continued through it."""
    return [
        {
            "crank_angle_deg": math.degrees(position.crank_angle),
            "joint": position.group.joint,
            "alignment_deg": math.degrees(position.angle),
            "followed": position.followed,
        }
        for position in (*ranges.singular, *ranges.followed)
    ]


@dataclass(frozen=True, repr=False, eq=False)
class Analysis(Tabled):
    """Result of the analysis of a machine over its cycle.

    `columns` by name (unit at the end), each an array over the sampled crank angles: `pandas.DataFrame(run.columns)`;
    `meanings` describe them; `extremes` are refined to their exact crank angles when they are read, one-sided at load jumps;
    `unbounded`: columns of reactions that grow without bound towards change points through which the motion is continued;
    `swings` of bodies and `strokes` of sliders (by slider name); `rms_torque`: torque of the drive [N m], root mean square over a
    cycle, by which the heating of a motor is rated; NaN unless the crank turns fully; `design`: the given values [SI]; `asked`:
    requested crank angle steps per revolution, or step [rad].
    """

    kind = "analysis"
    _stored = ("asked", "speed", "design")
    shown: ClassVar[Mapping[str, Source]] = {
        "notes": "notes",
        "groups": lambda result: [
            {"kind": group.kind, "joint": group.joint, "bodies": [link.body for link in group.links]}
            for group in result.machine.mechanism.groups
        ],
        "sizes": "machine.sizes",
        "speed_rad_s": "speed",
        "full_rotation": "full",
        "reachable_deg": lambda result: [list(map(math.degrees, ends)) for ends in result.ranges.ranges],
        "reactions": lambda result: reaction_conventions(result.machine),
        "strokes": lambda result: _travel_documents(result, result.strokes, "m"),
        "swings": lambda result: _travel_documents(result, result.swings, "rad"),
        "extremes": lambda result: {
            name: {"min": low, "max": high, "min_at_deg": math.degrees(low_at), "max_at_deg": math.degrees(high_at)}
            | {
                f"{end}_on_way_back": True
                for end, back in zip(("min", "max"), result.extremes.on_way_back(name), strict=True)
                if back
            }
            for name, (low, low_at, high, high_at) in result.extremes.items()
        },
        "load_jumps_deg": lambda result: _cycle_degrees(result, result.jumps),
        "work_J": "work",
        "singular_deg": lambda result: _cycle_degrees(result, result.singular),
        "singular_positions": lambda result: _singular_documents(result.ranges),
        "cycle_deg": lambda result: math.degrees(result.cycle) if result.full else None,
        "unbounded": "unbounded",
        "jammed_deg": lambda result: _cycle_degrees(result, result.jammed),
        "undefined_deg": lambda result: _cycle_degrees(result, result.undefined),
        "meanings": "meanings",
        "columns": "columns",
        "flywheel?": lambda result: (
            result.flywheel and {**{name: getattr(result.flywheel, name) for name in FLYWHEEL}, "mean_speed_over": "crank angle"}
        ),
        "design?": lambda result: dict(result.design) or None,
        "rms_torque_Nm?": lambda result: result.rms_torque if math.isfinite(result.rms_torque) else None,
    }

    problem: ProblemFile
    machine: Machine
    speed: float
    ranges: Ranges
    low: float
    high: float
    columns: Mapping[str, Array]
    meanings: Mapping[str, str]
    extremes: Extremes
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
    rms_torque: float = math.nan
    design: Mapping[str, float] = field(default_factory=dict)
    asked: tuple[int, float | None] = (360, None)

    @classmethod
    def _restored(cls, problem: ProblemFile, values: Mapping[str, Any]) -> Analysis:
        """Return the same analysis again."""
        points, step = values["asked"]
        return analyze(problem, points, step, values["speed"], values["design"] or None)

    @property
    def full(self) -> bool:
        """Whether the crank turns fully."""
        return self.ranges.full

    @property
    def static(self) -> bool:
        """Whether the motion is so slow that inertia has no effect; its velocities and powers have no meaning then."""
        return abs(self.speed) == SLOWNESS

    @property
    def cycle(self) -> float:
        """Crank rotation [rad] after which motion and loads repeat, if the crank turns fully."""
        return self.machine.cycle

    @property
    def extent(self) -> str:
        """Interval over which works and strokes are counted, in words."""
        if not self.full:
            return "over the range"
        return "per revolution" if self.cycle == TURN else "per cycle"

    @property
    def mean_torque(self) -> float:
        """Torque of the drive [N m], mean over a cycle: its work by the crank rotation; NaN unless the crank turns fully."""
        return self.work / math.copysign(self.cycle, self.speed) if self.full else math.nan

    @property
    def mean_power(self) -> float:
        """Power of the drive [W], mean over a cycle; NaN unless the crank turns fully."""
        return self.mean_torque * self.speed

    @property
    def positions(self) -> Array:
        """Crank angles, or values of the cycle variable of a drive along a line [rad], of the rows of the table."""
        return np.radians(next(iter(self.columns.values())))

    def at(self, crank_angle: ArrayLike, side: int = 1) -> dict[str, Array]:
        """Return the columns at crank angles, or at values of the cycle variable of a drive along a line [rad].

        Parameters
        ----------
        crank_angle : array (n,) [rad]
        side : int
            Where a load jumps, +1 gives the value just after the jump and -1 that just before it.

        Raises
        ------
        InputError
            If the angles are not finite numbers, or `side` is neither +1 nor -1.
        """
        if side not in (1, -1):
            raise InputError("neither side of a jump", "Give 1 or -1", key="side", value=side)
        angles = np.atleast_1d(check_array("crank_angle", crank_angle))
        found = MotionColumns(self.machine.moving(angles, self.speed, side=side))
        return {name: found[name] for name in found.meanings}

    sound = Renamed("valid")

    @property
    def valid(self) -> bool:
        """Whether it is sound: the motion is determined, and every position has finite reactions."""
        return self.singular.size == 0 and self.jammed.size == 0 and self.undefined.size == 0

    @property
    def status(self) -> str:
        """Short verdict."""
        if self.ranges.singular:
            return "motion not determined beyond a singular position"
        if not self.valid:
            return "no finite reactions at some positions"
        return "analysed, but for reactions at change points" if self.unbounded else "analysed"

    @property
    def figures(self) -> dict[str, float]:
        """Summary figures by name: extremes, strokes, swings, time ratios, work."""
        figures = {}
        for name, extreme in self.extremes.items():
            figures[f"{name}.min"], figures[f"{name}.max"] = extreme.least, extreme.largest
        for name, travel in self.strokes.items():
            figures[f"{name}.stroke_m"] = travel.span
            figures[f"{name}.time_ratio"] = travel.time_ratio
        for name, travel in self.swings.items():
            figures[f"{name}.swing_rad"] = travel.span
            figures[f"{name}.swing_time_ratio" if name in self.strokes else f"{name}.time_ratio"] = travel.time_ratio
        figures[f"input.work_{self.extent.replace('the ', '').replace(' ', '_')}_J"] = self.work
        return {name: value for name, value in figures.items() if math.isfinite(value)}

    @cached_property
    def acting(self) -> tuple[StrokeLoad, ...]:
        """Loads that act in one stroke only; empty if the crank cannot turn fully."""
        return acting_loads(self.machine, self.speed) if self.full else ()


def _cycle_degrees(result: Analysis, crank_angles: Array) -> list[float]:
    """Return crank angles [deg], without duplicates, reduced to one cycle if the crank turns fully."""
    angles = [within_cycle(at, result.cycle) if result.full else float(at) for at in crank_angles]
    return sorted({round(math.degrees(at), 9) for at in angles})


def _travel_documents(result: Analysis, travels: Mapping[str, Travel], unit: str) -> dict[str, dict[str, Any]]:
    """Return strokes [m] or swings [rad] as JSON, in `unit`."""
    return {
        name: {
            f"span_{unit}": travel.span,
            f"low_{unit}": travel.low,
            f"high_{unit}": travel.high,
            "low_at_deg": math.degrees(travel.low_at),
            "high_at_deg": math.degrees(travel.high_at),
            "dead_centres_deg": [math.degrees(at) for at in travel.dead_centres],
            "time_ratio": travel.time_ratio,
            **stroke_records(travel, result.speed, result.acting),
        }
        for name, travel in travels.items()
    }


def reaction_conventions(machine: Machine) -> dict[str, str]:
    """Return for every joint which body acts on which, as defined for the columns."""
    conventions = {}
    for point, (by, on) in acting_on(machine).items():
        bodies = machine.mechanism.pins[point]
        if len(bodies) == 2:
            conventions[point] = f"{by} on {on}"
        else:
            conventions |= {f"{point}.{body}": f"pin on {body}" for body in (on, *(b for b in bodies if b != on))}
    for guide in machine.mechanism.guides:
        conventions[guide.name] = f"{guide.on} on {guide.slider}, normal to the left of the line"
    return conventions


@typed
def analyze(
    problem: AnyProblem,
    points: int = 360,
    step: float | None = None,
    speed: float | None = None,
    design: Mapping[str, float | str] | None = None,
) -> Analysis:
    """Analyse a machine over its cycle at constant crank speed: motion, reactions, torque and work.

    Parameters
    ----------
    problem : ProblemFile, str or Path
        From `optlink.load`, the name of a shipped problem, or a file.
    points : int
        Crank angle steps per revolution, or over the range of a crank that cannot turn fully; the table has one row more.
    step : float [rad], optional
        Crank angle step, instead of `points`.
    speed : float [rad/s], optional
        Crank speed, negative clockwise. Default: that of the problem.
    design : mapping of str to float [SI] or str, optional
        Values of design variables. Default: their starting values.

    Returns
    -------
    Analysis
        Columns over the crank angle by name (`analysis["input.torque_Nm"]`), extremes, strokes, swings and work.

    Raises
    ------
    InputError
        If the mechanism cannot be assembled, or an argument is out of range.

    Examples
    --------
    >>> result = optlink.analyze(optlink.load("six-bar"), speed=10.0)
    >>> round(result.extremes["input.torque_Nm"].largest, 4), round(result.strokes["slider"].span, 6)  # [N m], [m]
    (278.8344, 0.373904)
    >>> result["crank_angle_deg"].shape, list(result.columns)[:3]
    ((361,), ['crank_angle_deg', 'time_s', 'crank.angle_rad'])
    """
    problem = moved(problem)
    sizes = check_design(problem, design)
    _check(points, step)
    analysis = _analysed(problem, points, step, crank_speed(problem, speed), sizes)
    machine = analysis.machine
    if not machine.mechanism.returns or not analysis.valid:
        return analysis
    if not depends_on_sense(machine, analysis.low, analysis.high, analysis.speed):
        return replace(analysis, extremes=both_ways(analysis.extremes))
    back = _analysed(problem, points, step, -analysis.speed, sizes)
    extremes = both_ways(analysis.extremes, back.extremes)
    return replace(analysis, extremes=extremes, notes=(*analysis.notes, _back_note(analysis, back)))


def _back_note(there: Analysis, back: Analysis) -> str:
    """Return a note with the effort and the work of the drive on the way back through a range."""
    driving, (begin, end) = there.problem.model.driving, there.positions[[0, -1]]
    way = f"{driving.shown(float(begin)):.6g} to {driving.shown(float(end)):.6g} {driving.unit}"
    effort = efforts(there.machine.mechanism)[0]
    extreme, unit = back.extremes[effort.column], effort.unit
    return (
        f"forces differ on the way back: their extremes are those of both ways, the rows those from {driving.coordinate} {way}; "
        f"on the way back the {effort.quantity} of the drive lies between {extreme.least:.5g} and {extreme.largest:.5g} {unit}, "
        f"and its work is {back.work:.5g} J (a speed of the opposite sign shows that motion)"
    )


def _analysed(
    problem: ProblemFile, points: int, step: float | None, speed: float, design: Mapping[str, float] | None
) -> Analysis:
    """Return the analysis at a crank speed [rad/s]; see `analyze`."""
    model, machine = problem.model, machine_of(problem, design)
    _check_stroke(problem, machine)
    start, begun = starting_angle(problem, machine, design)
    ranges, low, high = motion_range(problem, machine, start)
    check_repeats(problem, machine)
    cycle = machine.cycle
    angles = table_angles(start, low, high, speed, ranges, points, step)
    if not ranges.full:
        edge = 0.0 if ranges.complete else MARGIN * (high - low)
        low, high = low + edge, high - edge
        start = float(angles[0])
    elif speed < 0.0:
        low, high = start - cycle, start
    work = Work(machine, start, low, high, speed)
    columns, meanings, (singular, jammed, undefined) = _table(machine, angles, speed, work)
    swings: dict[str, Travel] = {}
    strokes: dict[str, Travel] = {}
    unbounded: tuple[str, ...] = ()
    count = GRID * (whole_turns(cycle) if ranges.full else 1)
    grid = even = np.asarray(low + (high - low) / count * np.arange(count + 1), dtype=float)
    if ranges.singular:  # two branches continue the motion: it is not determined as a whole
        singular = _undetermined(columns, singular, ranges.singular, low, high)
    else:
        unbounded = unbounded_reactions(machine, ranges.followed, speed)
        singular = _beyond(singular, ranges.followed, machine.mechanism.cycle)
        scanned = MotionColumns(machine.moving(even, speed))
        jammed, undefined = (
            rows if rows.size else even[between] for rows, between in ((jammed, scanned.jammed), (undefined, scanned.undefined))
        )
        grid = distinct(np.concatenate([even, work.breaks, work.peaks, _least_forces(scanned, even, pin_columns(machine))]))
        end = low + machine.mechanism.cycle if ranges.full and cycle > machine.mechanism.cycle else high
        swings, strokes = travels(machine.mechanism, machine.sizes, low, end, ranges.full)
    names = slider_names(machine)
    unsound = bool(ranges.singular or jammed.size or undefined.size or work.poles)
    share = None if unsound else model.drive.fluctuation
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
        Extremes(
            machine,
            ranges,
            grid,
            float(even[0]),
            float(even[-1]),
            speed,
            work,
            np.concatenate([jammed, undefined]),
            None if ranges.singular else unbounded,
        ),
        swings,
        {names[guide]: travel for guide, travel in strokes.items()},
        work.jumps,
        math.nan if unsound else float(work(np.array([end]))[0]),
        singular,
        jammed,
        distinct(np.concatenate([undefined, *work.poles.values()])),
        (
            *begun,
            *_notes(problem, ranges, design, machine, singular),
            *_missing_notes(problem.model.driving, machine, jammed, undefined, speed, work.poles),
            *_continuation_notes(problem.model.driving, machine, ranges, unbounded),
            *(quick_stroke_notes(problem, machine, speed) if ranges.full else ()),
        ),
        flywheel(machine, speed, share, low) if share is not None and ranges.full else None,
        unbounded,
        math.nan if unsound or not ranges.complete else work.rms_torque,
        design or {},
        (points, step),
    )


def _check(points: int, step: float | None) -> None:
    check_range("points", points, 1, MAX_POINTS)
    if step is not None and not TURN / MAX_POINTS <= step <= TURN:
        raise InputError("out of range", "Give a step from 0.001 deg to 360 deg", key="step", value=f"{step:.6g} rad")


PLACES = ("_deg", "_rad", "_m", "time_s", "energy.potential_J")
"""Endings of the columns that a position alone determines, and time."""

CONTINUED = 'assembly = "continue" (or ", continue" behind a mode)'


def _check_stroke(problem: ProblemFile, machine: Machine) -> None:
    """Refuse a design whose drive has another stroke than the file states: its positions are called by those of the file."""
    ends = problem.model.driving.ends
    if ends is None:
        return
    (drive,) = machine.mechanism.drives
    own = [float(machine.sizes[end]) if isinstance(end, str) else float(end or 0.0) for end in (drive.begin, drive.end)]
    if not np.allclose(own, ends, rtol=1e-12):
        message = f"the {problem.model.driving.coordinate} has other ends than in the file"
        raise InputError(message, "Change closed and open in the file, or by --set", problem.file, "design")


def _table(machine: Machine, angles: Array, speed: float, work: Work) -> tuple[dict[str, Array], dict[str, str], list[Array]]:
    """Return the columns of the table, their meanings, and the positions without finite reactions (by `FAULTS`)."""
    table = tabulated(lambda rows: machine.moving(angles[rows], speed), len(angles))
    driven = machine.mechanism.drives
    first, what = ("cycle_deg", "cycle of the drive, 0 and 180 deg at the ends") if driven else ("crank_angle_deg", "crank angle")
    columns = {first: np.degrees(angles), "time_s": np.abs(angles - angles[0]) / abs(speed)}
    meanings = {first: what, "time_s": "time since the first row"}
    for name, column in table.columns.items():
        columns[name], meanings[name] = column.values, column.meaning
        if name == "input.power_W":
            columns["input.work_J"], meanings["input.work_J"] = work(angles), "work of the drive since the first row"
    return columns, meanings, [angles[table.faults[kind]] for kind in FAULTS]


def _undetermined(columns: dict[str, Array], rows: Array, positions: Iterable[AlignedPosition], low: float, high: float) -> Array:
    """Remove values without a meaning at singular positions from the table; return the crank angles [rad] of these positions."""
    angles = np.radians(next(iter(columns.values())))
    exact = np.array([low + (position.crank_angle - low) % TURN for position in positions])
    exact = np.where(exact - low > TURN - SINGULAR_WIDTH, low, exact)
    singular = np.any(distances(angles, exact, TURN) <= SINGULAR_WIDTH, axis=1)
    for name, column in columns.items():
        if name == "input.work_J":
            columns[name] = np.full(column.shape, np.nan)
        elif not name.endswith(PLACES):
            columns[name] = np.where(singular, np.nan, column)
    remaining = rows[np.all(np.abs(rows[:, None] - exact) > SINGULAR_WIDTH, axis=1)]
    return distinct(np.concatenate([remaining, exact[exact <= high + SINGULAR_WIDTH]]))


def _beyond(rows: Array, positions: Iterable[AlignedPosition], cycle: float) -> Array:
    """Return crank angles [rad] of rows without finite reactions other than positions through which the motion is continued."""
    return rows[np.all(distances(rows, [position.crank_angle for position in positions], cycle) > SINGULAR_WIDTH, axis=1)]


def _least_forces(record: MotionColumns, angles: Array, pins: Iterable[tuple[str, str, str]]) -> Array:
    """Return the crank angles between positions at which the chord of the force at a pin is closest to zero.

    The magnitude has a minimum there that may be too sharp for the positions to show which of several minima is the least.
    """
    places = [np.empty(0)]
    for _, point, body in pins:
        share = chord_shares(np.array([record.full(part) for part in record.reactions.pins[point][body]]))
        inside = (share > 1e-3) & (share < 1.0 - 1e-3)
        places.append((angles[:-1] + share * np.diff(angles))[inside])
    return distinct(np.concatenate(places).round(9))


def chord_shares(force: Array) -> Array:
    """Return where, as shares (..., n - 1) between samples (2, ..., n), the chord of a force is closest to zero.

    Shares may lie below 0 or above 1; they are NaN where the force does not change.
    """
    change = np.diff(force, axis=-1)
    with np.errstate(all="ignore"):
        return np.asarray(-np.sum(force[..., :-1] * change, axis=0) / np.sum(change * change, axis=0))


def quick_stroke_notes(problem: ProblemFile, machine: Machine, speed: float) -> list[str]:
    """Return a note for every load that acts in the quick stroke although the file does not specify "quick"."""
    notes = []
    for item in acting_loads(machine, speed):
        if item.pace == "quick" and getattr(problem.model.loads[item.load], "stroke", "quick") != "quick":
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
    singular: Array,
) -> list[str]:
    notes, driving = start_value_notes(problem, design), problem.model.driving
    modes, *others = problem.model.mechanism.variants(problem.model.linkage)
    if others:
        chosen = " and ".join(f'{key} = "{mode}"' for key, mode in modes.items())
        notes.append(f'the assembly mode "either" is left open; analysed is {chosen}: state the mode of the machine')
    if not ranges.complete:
        notes.append(f"the crank cannot turn fully; reachable: {ranges.text} (without the last 0.1 % at either end)")
        for low, high in ranges.ranges[:1]:
            for end, direction in ((low, -1.0), (high, 1.0)):
                reason = range_end_reason(machine.mechanism, machine.sizes, end, direction)
                if reason:
                    notes.append(reason)
    for position in ranges.aligned:
        if not position.singular:
            notes.append(_alignment_note(driving, machine, position))
    if ranges.singular:
        notes.append(
            f"singular position at {positions_text(ranges.singular, driving.text)}: the assembly modes meet, and the motion "
            "beyond it is not determined, so extremes, strokes and work are left out. Change the lengths, or follow the smooth "
            f"motion: write {CONTINUED}"
        )
        singular = np.empty(0)
    if singular.size:
        notes.append(f"a group is in a singular position: its reactions are infinite at {driving.texts(singular)}")
    notes += _force_notes(machine)
    with_clearance = [name for name, joint in problem.model.joints.items() if joint.has_clearance]
    if with_clearance:
        notes.append(f"joints are treated as ideal; `optlink simulate` includes the clearance of {', '.join(with_clearance)}")
    return notes


def _force_notes(machine: Machine) -> list[str]:
    """Return a note if nothing in a machine causes forces."""
    return [] if machine.inertias or machine.loads else ["no masses and no loads are given, so there are no forces"]


def _missing_notes(
    driving: Driving, machine: Machine, jammed: Array, undefined: Array, speed: float, poles: Mapping[str, Array]
) -> Iterator[str]:
    """Yield notes on the positions without forces: friction has no solution or several, or a load has no finite value."""
    several, guilty = np.zeros(jammed.shape, dtype=bool), set[str]()
    if jammed.size:
        several = np.broadcast_to(MotionColumns(machine.moving(jammed, speed)).reactions.several, jammed.shape).astype(bool)
    if undefined.size:
        columns = MotionColumns(machine.moving(undefined, speed)).columns
        guilty = {name.rpartition(".")[0] for name, column in columns.items() if not all_finite(column.values)}
    loads = ", ".join(load.name for load in machine.loads if load.name in guilty) or "a load"
    for angles, what in (
        (jammed[~several], "friction jams a guide: no forces satisfy its law"),
        (jammed[several], "different forces satisfy the law of friction, so they are not determined,"),
        (undefined, f"{loads} has no finite value"),
    ):
        if angles.size:
            yield f"{what} at {driving.texts(angles)}"
    for name, angles in poles.items():
        yield f"{name} grows without bound at {driving.texts(angles)}"
    if jammed.size or undefined.size or poles:
        yield "extremes of the forces that have no value there, and works, are left out"


def _continuation_notes(driving: Driving, machine: Machine, ranges: Ranges, unbounded: tuple[str, ...]) -> Iterator[str]:
    """Yield notes on the revolutions of a cycle, and on motion through change points and what it leaves undetermined."""
    revolutions = round(machine.mechanism.cycle / TURN)
    if ranges.followed:
        yield f"the motion is followed smoothly through the change points at {positions_text(ranges.followed, driving.text)}"
    if ranges.full and machine.cycle > machine.mechanism.cycle:
        what = "the loads repeat" if revolutions == 1 else "motion and loads repeat together"
        yield f"{what} after {machine.revolutions} revolutions of the crank, which are one cycle here"
    elif revolutions > 1:
        yield f"the motion repeats after {revolutions} revolutions of the crank, which are one cycle here"
    if unbounded:
        names = ", ".join(dict.fromkeys(name.split(".")[0] for name in unbounded))
        yield (
            f"reactions at {names} grow without bound towards the change points: links in line cannot hold a force across them "
            "(their extremes are left out; the torque of the drive stays finite)"
        )


def _alignment_note(driving: Driving, machine: Machine, position: AlignedPosition) -> str:
    """Return a note on a joint whose near-alignment causes force peaks."""
    joint, amount = position.group.joint, f"{math.degrees(position.angle):.3g} deg"
    where = f"at {driving.text(position.crank_angle)}"
    name = f"{joint}.transmission_rad"
    columns = MotionColumns(machine.moving(np.array([position.crank_angle])))
    if name in columns.columns:
        what = f"the transmission angle at {joint} is {math.degrees(float(columns[name][0])):.6g} deg,"
    else:
        what = f"the {position.group.kind} group of {joint} is"
    return f"{where} {what} {amount} from alignment: accelerations and forces peak there"


# Analyse thousands of designs of one machine in one call: selected columns of the analysis, in cache-sized blocks.

BLOCK_SIZE = 12_000
"""Positions per block: a few dozen intermediate arrays of this size fit in the processor's cache."""

LARGE_BATCH = 60_000
"""Positions per block of `batch_extremes`, whose refinement takes many short calls."""

MIN_SINE = 0.1
"""Least sine of every group (of a transmission angle 5.7 deg) above which a design is far from singular positions, also between
the samples."""


CHORD_TOLERANCE = 1e-9
"""Share of the largest force below which a difference of its least values is rounding error."""

SAMPLES = 360
"""Crank angles per revolution, at least, at which designs are examined for singular positions."""


@typed
def motion(
    problem: AnyProblem,
    crank_angle: ArrayLike,
    *,
    speed: float | None = None,
    acceleration: float = 0.0,
    design: Mapping[str, float | str] | None = None,
) -> Motion:
    """Compute the motion of a linkage at crank angles: positions, velocities and accelerations, without forces.

    Parameters
    ----------
    problem : ProblemFile, str or Path
        From `optlink.load`, the name of a shipped problem, or a file.
    crank_angle : array (angles,) [rad]
    speed : float [rad/s], optional
        Crank speed, negative clockwise. Default: that of the problem.
    acceleration : float [rad/s^2]
    design : mapping of str to float [SI] or str, optional
        Values of design variables. Default: their starting values.

    Returns
    -------
    Motion
        By the names of points and bodies; NaN where the mechanism cannot be assembled.

    Raises
    ------
    InputError
        If an argument is out of range.

    Examples
    --------
    >>> moved = optlink.motion("slider-crank", [0.0, 0.5 * np.pi], speed=10.0)
    >>> moved.velocity("B").round(3) + 0.0  # [m/s]
    array([[ 0.,  1.],
           [-1.,  0.]])
    """
    problem = problem_of(problem)
    sizes = check_design(problem, design) or {}
    machine = machine_of(problem, {name: sizes[name] for name in sizes if name in problem.model.mechanism.quantities})
    moved = checked_sweep(machine.mechanism, machine.sizes, crank_angle, crank_speed(problem, speed), acceleration)
    check_within_range(problem, np.ravel(np.asarray(moved.crank_angle, dtype=float)))
    return moved


@runtime_checkable
class Frame(Protocol):
    """A data frame of pandas, or another table with named columns."""

    columns: Any

    def items(self) -> Iterable[tuple[Any, Any]]:
        """Return the columns by name."""


class BatchAnalysis(dict[str, Array]):
    """Columns of an analysis by name, arrays (designs, points) of as many designs of `problem` as `valid` has entries.

    `valid` (designs,): whether a design can be assembled at every crank angle and its motion is determined; `singular`: message
    by design index where the motion is not determined; `designs`: what was varied, arrays (designs,) [SI] by name with SI unit;
    `notes`: what holds for all designs, as in `Analysis.notes`.
    """

    def __init__(self, problem: ProblemFile, count: int, designs: Mapping[str, Array]) -> None:
        super().__init__()
        self.problem = problem
        self.valid = np.zeros(count, dtype=bool)
        self.singular: dict[int, str] = {}
        self.designs = dict(designs)
        self.notes: list[str] = []

    def __repr__(self) -> str:
        return (
            f"<BatchAnalysis {self.problem.name!r}: {', '.join(self)}; {np.sum(self.valid)} of {len(self.valid)} designs valid>"
        )

    def __missing__(self, name: str) -> Array:
        raise UnknownName(f"no column {name}", nearest(str(name), self))

    def to_frame(self, *, units: str = "SI") -> pandas.DataFrame:
        """Return a data frame of pandas with a row per design: its sizes, `valid`, then least, largest and rms of each column.

        These are those of the points. Their names end in ".min", ".max" and ".rms"; those of a design that is not valid are NaN
        where a value is. `frame.attrs["units"]` has the unit of each column with one.

        Parameters
        ----------
        units : "SI" or "file"
            As in `Document.to_frame`.

        Raises
        ------
        InputError
            If pandas is not installed.
        """
        table: dict[str, Any] = {**self.designs, "valid": self.valid}
        for name, values in self.items():
            table[f"{name}.min"], table[f"{name}.max"] = np.min(values, axis=1), np.max(values, axis=1)
            table[f"{name}.rms"] = np.sqrt(np.mean(np.square(values), axis=1))
        frame: pandas.DataFrame = reports("interface").in_frame(table, self.problem, units)
        return frame


@typed
def analyze_batch(
    problem: AnyProblem,
    designs: Mapping[str, ArrayLike | float] | Frame,
    columns: Sequence[str] | None = None,
    points: int = 360,
    speed: float | None = None,
) -> BatchAnalysis:
    """Analyse many designs of a machine at once and return selected columns.

    Parameters
    ----------
    problem : ProblemFile, str or Path
        From `optlink.load`, the name of a shipped problem, or a file.
    designs : mapping of str to array (designs,) or float [SI], or Frame
        Values by the name of the dimension, for example {"coupler.length": [0.14, 0.15]}; `optlink show` lists the names. Texts
        have units: ["140 mm", "150 mm"]. One value is that of all designs; other dimensions keep the value of the problem.
    columns : sequence of str, optional
        Names as in `Analysis.columns`. Default: the torque or force of each drive.
    points : int
        Number of crank angles per revolution, starting at `drive.start`; the last one lies one step before the full revolution.
        Over the range of a drive there are `points` steps, and one crank angle more. A
        machine whose motion or loads repeat after several revolutions has all those of the longest cycle of all designs.
    speed : float [rad/s], optional
        Crank speed. Default: that of the problem.

    Returns
    -------
    BatchAnalysis
        Arrays (designs, points of all revolutions) by name; `valid` marks the designs that can be assembled everywhere, `notes`
        says where there are no forces, and `to_frame()` has a row for each design. A value is NaN where the design cannot be
        assembled. All values of a design are NaN if a load acts in the slow stroke and the design has none, or if the motion is
        not determined beyond a singular position (`singular` contains the message). Apart from these arrays, memory does not grow
        with the number of designs.

    Raises
    ------
    InputError
        For unknown quantities or columns, arrays of different length, or values that are not finite.

    Examples
    --------
    >>> lengths = {"coupler.length": [0.14, 0.15, 0.16]}  # [m]
    >>> columns = optlink.analyze_batch(optlink.load("shaper"), lengths, ["input.torque_Nm"])
    >>> columns["input.torque_Nm"].shape
    (3, 360)
    """
    problem = moved(problem)
    check_range("points", points, 1, MAX_POINTS)
    arrays = _read(problem, designs)
    count = len(next(iter(arrays.values())))
    direction = crank_speed(problem, speed)
    follows = problem.model.mechanism.follows
    given = machine_of(problem)
    check_repeats(problem, given)
    revolutions = math.lcm(_longest_cycle(problem, arrays) if follows else 1, given.revolutions or 1)
    angles = problem.model.driving.first + np.copysign(TURN, direction) * np.arange(revolutions * points) / points
    if (limits := given.mechanism.limits) is not None:
        angles = np.linspace(*(limits if direction > 0.0 else limits[::-1]), points + 1)
    available = MotionColumns(given.moving(angles[:1], direction)).columns
    columns = [effort.column for effort in efforts(given.mechanism)] if columns is None else columns
    for name in columns:
        check_choice("columns", name, available, "no such column", problem.file)
    kinds = problem.model.mechanism.quantities
    sizes = {f"{name}_{KINDS[kinds[name].kind].si}".rstrip("_"): values for name, values in arrays.items()}
    result = BatchAnalysis(problem, count, sizes)
    result.update({name: np.empty((count, len(angles))) for name in columns})
    result.notes += _force_notes(given)
    samples = angles
    if points < SAMPLES and limits is None:
        samples = problem.model.driving.first + TURN * np.arange(revolutions * SAMPLES) / SAMPLES
    few = strides(given.mechanism.at(given.sizes, samples))
    step = 1 if follows else max(1, BLOCK_SIZE // points)
    for first in range(0, count, step):
        for part, defined in _by_slow_stroke(problem, arrays, np.arange(first, min(first + step, count)), single=follows):
            if not defined:
                for name in columns:
                    result[name][part] = np.nan
                continue
            machine = machine_of(problem, _designs(arrays, part, single=follows))
            record = MotionColumns(machine.moving(angles, direction))
            for name in columns:
                result[name][part] = record[name]
            result.valid[part] = np.all(np.broadcast_to(record.moving.motion.assembled, (len(part), len(angles))), axis=1)
            result.singular |= _singular(problem.model.driving, machine, part, few, samples)
    for name in columns:
        result[name][list(result.singular)] = np.nan
    result.valid[list(result.singular)] = False
    return result


def _singular(driving: Driving, machine: Machine, part: NDArray[np.intp], few: Array, angles: Array) -> dict[int, str]:
    """Return for designs whose motion is not determined, by index, the reason; `few` crank angles clear most of them."""
    mechanism, numbers, reasons = machine.mechanism, np.arange(len(part)), {}

    def sizes(some: NDArray[np.intp]) -> dict[str, Value]:
        return {name: np.asarray(size)[some] if np.size(size) > 1 else size for name, size in machine.sizes.items()}

    for suspect, at, count in ((near_alignment, few, len(few)), (near_singular, Jet(angles, 1.0), len(angles))):
        blocks = np.array_split(numbers, math.ceil(len(numbers) * count / BLOCK_SIZE) or 1)
        found = [np.broadcast_to(suspect(mechanism.at(sizes(some), at)), some.shape) for some in blocks if some.size]
        numbers = numbers[np.concatenate(found)] if found else numbers
    for k in numbers:
        singular = reachable(mechanism, {name: float(np.ravel(size)[0]) for name, size in sizes(np.array([k])).items()}).singular
        if singular:
            where = positions_text(singular, driving.text)
            reasons[int(part[k])] = f"singular position at {where}: the motion beyond it is not determined"
    return reasons


def _designs(arrays: Mapping[str, Array], part: NDArray[np.intp], *, single: bool) -> dict[str, Value]:
    """Return the quantities of a block of designs as arrays (designs, 1), or as numbers of its only design."""
    return {name: float(values[part[0]]) if single else values[part, None] for name, values in arrays.items()}


def _longest_cycle(problem: ProblemFile, arrays: Mapping[str, Array]) -> int:
    """Return the number of revolutions of the longest cycle of all designs."""
    model, count = problem.model, len(next(iter(arrays.values())))
    start, designs = model.driving.first, (_designs(arrays, np.array([k]), single=True) for k in range(count))
    turns = (continue_through_singularities(model.linkage, model.sizes(design), start).cycle / TURN for design in designs)
    return max(map(round, turns))


def _by_slow_stroke(
    problem: ProblemFile, arrays: Mapping[str, Array], part: NDArray[np.intp], *, single: bool
) -> Iterator[tuple[NDArray[np.intp], bool]]:
    """Group the designs of a block by the direction of their slow strokes, with whether every load that needs one has one."""
    if not any(load.by_pace for load in problem.model.loads.values()):
        yield part, True
        return
    senses = problem.model.slow_senses(_designs(arrays, part, single=single))
    senses = np.broadcast_to(senses, (len(senses), len(part)))
    keys, group = np.unique(senses, axis=1, return_inverse=True)
    for k, key in enumerate(keys.T):
        yield part[np.ravel(group) == k], bool(np.all(key != 0.0))


def batch_extremes(
    problem: ProblemFile, designs: Mapping[str, ArrayLike], columns: Sequence[str]
) -> tuple[dict[str, Array], NDArray[np.bool_]]:
    """Return exact extremes of columns over the revolution for many designs at once, as those of `optlink.analyze`.

    The machine must have no loads that jump (`Machine.switching`) or have corners (`Machine.cornered`). Columns are those of
    `Analysis.columns` except angles of bodies, or `B.f_N` for the magnitude of a reaction.

    Returns
    -------
    extremes : mapping of str to array (designs, 2), of the least and the largest value
    clear : array (designs,) of bool
        Designs that are clear of singular positions, and have the least of each reaction beside its smallest sample. The
        extremes of the others are meaningless.
    """
    arrays = _read(problem, designs)
    count = len(next(iter(arrays.values())))
    direction, start = crank_speed(problem), problem.model.driving.first
    given = machine_of(problem)
    check_repeats(problem, given)
    step, revolutions = TURN / GRID, given.revolutions or 1
    first_angle = min(start, start + math.copysign(TURN * revolutions, direction))
    grid = np.asarray(first_angle + step * np.arange(GRID * revolutions + 1), dtype=float)
    extremes = {name: np.full((count, 2), np.nan) for name in columns}
    clear = np.zeros(count, dtype=bool)
    portion = max(1, LARGE_BATCH // (len(grid) - 1))
    for first in range(0, count, portion):
        machine = machine_of(problem, {name: values[first : first + portion, None] for name, values in arrays.items()})
        moving = machine.moving(grid, direction)
        record = MotionColumns(moving)
        with np.errstate(all="ignore"):
            regular = [np.min(np.abs(record.full(sine)), axis=1) > MIN_SINE for sine in record.reactions.singularity.values()]
            regular.append(np.all(moving.motion.assembled, axis=1))
        regular += [np.all(np.isfinite(record[part]), axis=1) for name in columns for part in reaction_parts(name)]
        numbers = first + np.flatnonzero(np.all(regular, axis=0))
        clear[numbers] = True
        if numbers.size:
            batch_machine = machine_of(problem, {name: values[numbers, None] for name, values in arrays.items()})
            for name in columns:
                extremes[name][numbers] = extremes_of_rows(functools.partial(_column, batch_machine, direction, name), grid)
                if len(parts := reaction_parts(name)) == 2:
                    force = np.array([record[part][numbers - first] for part in parts])
                    clear[numbers] &= ~_smaller_elsewhere(force, extremes[name][numbers, 0])
    return extremes, clear


def _smaller_elsewhere(force: Array, least: Array) -> NDArray[np.bool_]:
    """Return the designs whose force (2, designs, n) almost vanishes between samples, but not beside its smallest one.

    Its least magnitude (designs,) then lies elsewhere than the refined minimum at that sample.
    """
    size, last = np.hypot(*force), force.shape[-1] - 1
    share = np.nan_to_num(np.clip(chord_shares(force), 0.0, 1.0))
    chord = np.hypot(*(force[..., :-1] + share * np.diff(force, axis=-1)))
    lowest, smallest = np.argmin(chord, axis=1), np.argmin(size[:, :last], axis=1)  # the last sample is the first one again
    at_smallest = (lowest == smallest) | (lowest == (smallest - 1) % last)
    return np.asarray(~at_smallest & (np.min(chord, axis=1) < least - CHORD_TOLERANCE * np.max(size, axis=1)))


def reaction_parts(name: str) -> tuple[str, ...]:
    """Return the columns whose root sum square is the named column: reaction components, else the column itself."""
    return (f"{name[:-4]}.fx_N", f"{name[:-4]}.fy_N") if name.endswith(".f_N") else (name,)


def _column(machine: Machine, speed: float, name: str, angles: Array) -> Array:
    """Return a column of a batch of designs at crank angles (1, n) or (designs, n)."""
    record = MotionColumns(machine.moving(angles, speed))
    values = [record[part] for part in reaction_parts(name)]
    return values[0] if len(values) == 1 else np.hypot(*values)


def _without_units(values: NDArray[Any], kind: str) -> NDArray[Any]:
    """Return an array of numbers and texts with the numbers [SI] of the texts."""
    read = [read_scalar(one, kind)[0] if isinstance(one, str) else one for one in values.flat]
    return np.array(read, dtype=object).reshape(values.shape)


def _read(problem: ProblemFile, designs: Mapping[str, ArrayLike | float] | Frame) -> dict[str, Array]:
    quantities, given = problem.model.mechanism.quantities, dict[str, Array]()
    for key, values in designs.items():
        name = str(key).removeprefix("mechanism.")
        check_choice("designs", name, quantities, "unknown quantity", problem.file)
        try:
            raw = np.asarray(values)
            if raw.dtype.kind in "OU":
                raw = _without_units(np.asarray(values, dtype=object), quantities[name].kind)
            given[name] = np.asarray(raw, dtype=float)
        except Unusable as error:
            raise InputError(error.message, error.remedy, problem.file, f"designs.{name}", error.value) from None
        except (TypeError, ValueError) as error:
            remedy = "Give SI values, or texts with units"
            raise InputError(f"not an array of numbers: {error}", remedy, problem.file, f"designs.{name}") from None
    count = max((values.size for values in given.values()), default=1)
    arrays = {name: values if values.ndim else np.full(count, values) for name, values in given.items()}
    if not arrays:
        raise InputError("no quantity is varied", f"Name one of: {', '.join(quantities)}", problem.file, "designs")
    sizes = {len(values) for values in arrays.values()}
    for name, values in arrays.items():
        if values.ndim != 1 or len(sizes) > 1:
            raise InputError("one value per design is needed", "Give arrays of one length", problem.file, name)
        wrong = np.flatnonzero(~np.isfinite(values) | ((quantities[name].kind == "length") & (values <= 0.0)))
        if wrong.size:
            where, value = f"designs.{name}[{wrong[0]}]", float(values[wrong[0]])
            raise InputError("not a size", "Give finite values, lengths above zero", problem.file, where, value)
        check_sizes(problem, name, values, f"designs.{name}")
    return arrays
