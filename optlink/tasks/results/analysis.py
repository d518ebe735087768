"""The result of the analysis of a machine over its cycle, as data and JSON."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar

from optlink.dynamics.flywheel import Flywheel
from optlink.dynamics.inverse import acting_on
from optlink.dynamics.machine import Machine
from optlink.dynamics.strokes import StrokeLoad, acting_loads, named_travels, use_of, working_stroke
from optlink.linkage.stroke import Ranges, Travel, within_cycle
from optlink.linkage.vector2d import TURN, Array
from optlink.problem.document import Source, Tabled
from optlink.problem.file import ProblemFile
from optlink.tasks.results.extremes import Extremes

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
    stored = ("asked", "speed", "design")
    shown: ClassVar[Mapping[str, Source]] = {
        "sound": "sound",
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
        "strokes": lambda result: result.documents(result.strokes, "m"),
        "swings": lambda result: result.documents(result.swings, "rad"),
        "extremes": lambda result: {
            name: {"min": low, "max": high, "min_at_deg": math.degrees(low_at), "max_at_deg": math.degrees(high_at)}
            for name, (low, low_at, high, high_at) in result.extremes.items()
        },
        "load_jumps_deg": lambda result: result.within(result.jumps),
        "work_J": "work",
        "singular_deg": lambda result: result.within(result.singular),
        "singular_positions": lambda result: _singular_documents(result.ranges),
        "cycle_deg": lambda result: math.degrees(result.cycle) if result.full else None,
        "unbounded": "unbounded",
        "jammed_deg": lambda result: result.within(result.jammed),
        "undefined_deg": lambda result: result.within(result.undefined),
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
    def restored(cls, problem: ProblemFile, values: Mapping[str, Any]) -> Analysis:
        """Return the same analysis again.

        Parameters
        ----------
        problem : ProblemFile
        values : mapping of str to object
            The attributes that `stored` names.
        """
        from optlink.tasks.analyze import analyze

        points, step = values["asked"]
        return analyze(problem, points, step, values["speed"], values["design"] or None)

    @property
    def full(self) -> bool:
        """Whether the crank turns fully."""
        return self.ranges.full

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

    def within(self, crank_angles: Array) -> list[float]:
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

    def documents(self, travels: Mapping[str, Travel], unit: str) -> dict[str, dict[str, Any]]:
        """Return strokes or swings as JSON, in `unit`.

        Parameters
        ----------
        travels : mapping of str to Travel
            [m, rad]
        unit : "m" or "rad"
        """
        return {
            name: {
                f"span_{unit}": travel.span,
                f"low_{unit}": travel.low,
                f"high_{unit}": travel.high,
                "low_at_deg": math.degrees(travel.low_at),
                "high_at_deg": math.degrees(travel.high_at),
                "dead_centres_deg": [math.degrees(at) for at in travel.dead_centres],
                "time_ratio": travel.time_ratio,
                **stroke_records(travel, self.speed, self.acting),
            }
            for name, travel in travels.items()
        }


def stroke_records(travel: Travel, speed: float, acting: tuple[StrokeLoad, ...]) -> dict[str, Any]:
    """Return the working, slow, forward and backward stroke of an output as JSON, with crank ranges in the direction of rotation.

    `acting` are the loads that act in one stroke only; of the speed only the sign matters.
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


def stroke_document(machine: Machine, speed: float) -> dict[str, Any]:
    """Return the strokes of every output of a machine whose crank turns fully, as JSON."""
    acting = acting_loads(machine, speed)
    return {
        name: {"time_ratio": travel.time_ratio, **stroke_records(travel, speed, acting)}
        for part in named_travels(machine)
        for name, travel in part.items()
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
