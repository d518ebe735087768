"""The section [balance] of a problem file: possible counterweights and springs, objective and limits."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import BeforeValidator, Field, field_validator

from optlink.dynamics.machine import Machine
from optlink.linkage.mechanism import FRAME, Pose
from optlink.problem.base_model import RESERVED, Name, Section
from optlink.problem.interval import Interval, LengthInterval, MassInterval, StiffnessInterval
from optlink.problem.machine.loads import spring_ends
from optlink.problem.quantity import (
    Density,
    FixedForce,
    FixedLength,
    Unusable,
    below,
    check_name,
    check_pair,
    is_number,
    read_fixed,
    read_scalar,
    where,
)
from optlink.units import read_number

if TYPE_CHECKING:
    from optlink.dynamics.counterweights import BalanceMeasure, Counterweight, FreeSpring, Kind

MAX_POSITIONS = 100_000
EXAMPLES = '"rms shaking force", "largest driving torque", "rms shaking moment", "largest reaction at D"'
_MEASURE = (
    r"(?a)(?:(?P<of>rms|largest)\s+)?"
    r"(?:(?:shaking\s+)?(?P<shaking>force|moment)|(?:driving\s+)?(?P<torque>torque)"
    r"|reaction\s+at\s+(?P<joint>\w+)(?:\s+on\s+(?P<on>\w+))?)"
    r"(?:\s+from\s+(?P<low>[-+.\d]+)(?:\s*(?:deg|°))?\s+to\s+(?P<high>[-+.\d]+)\s*(?:deg|°))?"
)


def read_measure(text: object) -> BalanceMeasure:
    """Read a measure, for example "rms shaking force" or "largest reaction at D from 90 to 180 deg"; default: rms.

    Raises
    ------
    Unusable
    """
    from optlink.dynamics.counterweights import KINDS, BalanceMeasure

    match = re.fullmatch(_MEASURE, " ".join(str(text).split())) if isinstance(text, str) else None
    if match is None:
        if isinstance(text, str) and re.match(r"\s*(?:maxim|largest\s+possible|most)", text):
            raise Unusable("only minimisation is a convex problem", f"Write for example {EXAMPLES}", "", text)
        raise Unusable("not a measure", f"Write for example {EXAMPLES}", "", text)
    kind: Kind = "reaction"
    if match["shaking"] or match["torque"]:
        kind = next(k for k in KINDS if k.endswith(match["shaking"] or match["torque"]))
    arc = None
    if match["low"]:
        arc = math.radians(read_number(match["low"])), math.radians(read_number(match["high"]))
        if math.isnan(arc[1] - arc[0]):
            raise Unusable("not a range of crank angles", "Write for example: from 90 to 180 deg", "", text)
        if not 0.0 < arc[1] - arc[0] < 2.0 * math.pi:
            raise Unusable(
                "a range of crank angles rises, by less than a turn", "Write for example: from 300 to 420 deg", "", text
            )
    return BalanceMeasure(kind, "largest" if match["of"] == "largest" else "rms", match["joint"] or "", match["on"] or "", arc)


def check_measure(measure: BalanceMeasure, machine: Machine) -> None:
    """Check that the machine has the elements of a measure and that the measure is linear in the masses.

    Raises
    ------
    Unusable
        when an element is missing, or friction makes the measure nonlinear.
    """
    mechanism = machine.mechanism
    guides = [guide.name for guide in mechanism.guides]
    if measure.kind == "reaction":
        check_name(measure.joint, (*mechanism.pins, *guides), "no such joint", value=str(measure))
        bodies = mechanism.pins.get(measure.joint, ())
        if measure.on:
            check_name(measure.on, bodies, "the joint is not one of that body", value=str(measure))
        elif len(bodies) > 2:
            remedy = f"Name the body: reaction at {measure.joint} on {bodies[0]}"
            raise Unusable(f"{len(bodies)} bodies meet there", remedy, "", str(measure))
    if machine.friction and measure.kind in ("reaction", "driving torque"):
        remedy = "Remove the friction of the guides, or choose the shaking force or moment"
        raise Unusable("with friction it is not linear in the masses, so the problem is not convex", remedy, "", str(measure))


def _read_goal(raw: object) -> tuple[tuple[BalanceMeasure, float], ...]:
    if isinstance(raw, str):
        return ((read_measure(raw), 1.0),)
    if not isinstance(raw, dict) or not raw:
        raise Unusable("not a measure", f"Write one of {EXAMPLES}, or a table of measures and their weights", "", raw)
    goal = []
    for text, weight in raw.items():
        measure = read_measure(text)
        if not is_number(weight) or not math.isfinite(weight):
            raise Unusable("expected the weight of the measure", f'Write {{ "{text}" = 1.0 }}', "", weight)
        if weight <= 0.0:
            raise Unusable("a weight must be positive", "Give a positive one, or remove the measure", "", f"{text} = {weight}")
        goal.append((measure, float(weight)))
    return tuple(goal)


@dataclass(frozen=True)
class MeasureLimit:
    """Upper bound of a measure: `value` [SI], or `share` of its value in the original machine; `text` as written."""

    measure: BalanceMeasure
    value: float | None
    share: float | None
    text: str

    def of(self, before: float) -> float:
        """Return the limit [SI] for the value of the measure in the original machine."""
        return self.share * before if self.share is not None else float(self.value or 0.0)


def read_measure_limit(name: str, raw: object) -> MeasureLimit:
    """Read the limit of a measure: "50 N", "5 N*m", or "80 %" of its value in the original machine.

    Raises
    ------
    Unusable
    """
    measure = read_measure(name)
    text = str(raw).strip()
    if isinstance(raw, str) and text.endswith("%"):
        share = read_number(text[:-1]) / 100.0
        if not 0.0 <= share < 1e6:
            raise Unusable("not a share", 'Write for example "80 %"', name, raw)
        return MeasureLimit(measure, None, share, text)
    value, _ = read_scalar(raw, "force" if measure.unit == "N" else "torque", name)
    if value < 0.0:
        raise Unusable("an upper bound of a magnitude must not be negative", "Give zero or more", name, raw)
    return MeasureLimit(measure, value, None, text)


def _read_place(raw: object) -> Any:
    """Read a point by name, or two coordinates."""
    if raw is None or isinstance(raw, str):
        return raw
    parts = check_pair(raw, "expected a point or two coordinates", 'Write its name, or ["100 mm", "0 mm"]')
    return tuple(read_fixed(part, "coordinate").value for part in parts)


Place = Annotated[Any, BeforeValidator(_read_place)]


_MASS = where(
    lambda mass: min(mass.bounds[1], mass.low or 0.0) >= 0.0,
    "a counterweight cannot have negative mass: removing material from a body is not a convex problem",
    "Give zero or more, and remove material in [bodies]",
)


def _ends(interval: Interval | None) -> tuple[float, float]:
    """Return the least and the largest value of an amount; default: from zero, without bound."""
    return (0.0, math.inf) if interval is None else (interval.low or 0.0, interval.bounds[1])


class CounterweightSection(Section):
    """A mass that can be added to a body: a disc, or one of any shape."""

    body: str
    """The body to which the counterweight is fixed."""
    kind: Literal["disc", "free"] = "disc"
    """A disc, or any shape with physically consistent mass properties."""
    mass: Annotated[MassInterval, _MASS] | None = None
    """Mass: one value or a range; default: from zero."""
    thickness: FixedLength | None = None
    """Thickness of a disc; its mass determines the radius."""
    radius: LengthInterval | None = None
    """Without a thickness: the radius, one value. With a thickness: bounds of the radius."""
    density: Density | None = None
    """Density of the disc; required with a thickness."""
    reach: FixedLength | None = None
    """Largest distance of its centre from `origin`."""
    extent: FixedLength | None = None
    """Largest distance of its edge from `origin`."""
    origin: str | None = None
    """Reference point of the body for `reach` and `extent`; default: its pivot on the frame, else its first joint."""
    at: Place = None
    """Fixed position: a point of the body, or coordinates along and across. One of `reach`, `extent`, `at` is required."""

    def counterweight(self, machine: Machine) -> Counterweight:
        """Return the counterweight for a machine.

        Raises
        ------
        Unusable
            with the key below the section.
        """
        from optlink.dynamics.counterweights import Counterweight

        mechanism = machine.mechanism
        check_name(self.body, mechanism.bodies, "no such body", "body")
        low, most = _ends(self.mass)
        thickness, density = (None if part is None else part.value for part in (self.thickness, self.density))
        radius: float | None = None
        if self.kind == "disc":
            low, most, radius = self._disc(low, most, thickness, density)
        else:
            for key in ("thickness", "radius", "density"):
                if (value := getattr(self, key)) is not None:
                    raise Unusable("a free counterweight has any shape", 'Remove it, or write kind = "disc"', key, str(value))
        if low > most:
            message = f"no mass is admissible: at least {low:.6g} kg, at most {most:.6g} kg"
            raise Unusable(message, "Widen mass, radius or thickness", "mass", str(self.mass))
        extent = math.inf if self.extent is None else self.extent.value
        if radius is not None and extent < radius:
            raise Unusable(
                "the disc is larger than its extent", "Give a smaller radius, or a larger extent", "extent", str(self.extent)
            )
        if self.at is None and self.reach is None and self.extent is None:
            message = "its position is unbounded: ever less mass at an ever larger radius would be optimal"
            raise Unusable(message, 'Add reach = "100 mm" (of its centre), extent (of its edge), or at (its place)', "reach")
        return Counterweight(
            self.body,
            self.kind,
            (low, most),
            thickness,
            radius,
            density,
            math.inf if self.reach is None else self.reach.value,
            extent,
            self._origin(machine),
            self._at(machine),
        )

    def _disc(self, low: float, most: float, thickness: float | None, density: float | None) -> tuple[float, float, float | None]:
        """Return the least and largest mass of a disc, and its radius if that is fixed."""
        if density is not None and density <= 0.0:
            raise Unusable(
                "a disc without density has no mass", 'Write density = "7850 kg/m^3" (steel)', "density", str(self.density)
            )
        if thickness is None and self.radius is None:
            remedy = 'Add thickness = "10 mm" and density = "7850 kg/m^3", or radius = "40 mm"; or write kind = "free"'
            raise Unusable("a disc has a thickness and density, or a radius", remedy, "thickness")
        if thickness is None:
            assert self.radius is not None
            if self.radius.low is None or self.radius.low != self.radius.high:
                message = "radius and thickness are both free: the moment of inertia is then no convex function of the mass"
                raise Unusable(
                    message, 'Give one radius, or a thickness and density, or kind = "free"', "radius", str(self.radius)
                )
            return low, most, self.radius.low
        if density is None:
            raise Unusable("the mass of a disc follows from its density", 'Add density = "7850 kg/m^3" (steel)', "density")
        if self.radius is not None:
            per = math.pi * density * thickness
            low = max(low, per * (self.radius.low or 0.0) ** 2)
            most = min(most, per * self.radius.high**2) if self.radius.high is not None else most
        return low, most, None

    def _points(self, machine: Machine) -> list[str]:
        return [point for point, bodies in machine.mechanism.owners.items() if self.body in bodies]

    def _local(self, machine: Machine, point: str, key: str) -> tuple[float, float]:
        """Return the coordinates of a point of the body in its own axes [m]."""
        check_name(point, self._points(machine), "the body has no such point", key)
        along, across = Pose(machine.mechanism, machine.sizes).local(self.body, point)
        return float(along), float(across)

    def _origin(self, machine: Machine) -> tuple[float, float]:
        if self.origin is not None:
            return self._local(machine, self.origin, "origin")
        fixed = [point for point in self._points(machine) if FRAME in machine.mechanism.owners[point]]
        return self._local(machine, fixed[0], "origin") if fixed else (0.0, 0.0)

    def _at(self, machine: Machine) -> tuple[float, float] | None:
        if self.at is None:
            return None
        if self.reach is not None:
            raise Unusable("the place is given, so it has no reach", "Remove one of the two", "reach", str(self.reach))
        if isinstance(self.at, str):
            return self._local(machine, self.at, "at")
        place: tuple[float, float] = self.at
        return place


def _read_free_length(raw: object) -> tuple[float, float] | None:
    if raw is None:
        return None
    texts = raw if isinstance(raw, list) else [raw, raw]
    check_pair(texts, "a range is a list of two lengths", 'Write ["50 mm", "200 mm"], or one length')
    low, high = (read_scalar(text, "coordinate")[0] for text in texts)
    if not 0.0 <= low <= high:
        remedy = 'Write ["0 mm", "200 mm"], or one length'
        raise Unusable("the range of a free length must rise, from zero or more", remedy, "", raw)
    return low, high


class SpringSection(Section):
    """A spring that can be added between two points: its stiffness, and its free length if that is a range, are optimised."""

    name: Name
    """Name of the spring among the loads of the balanced machine."""
    between: tuple[str, str]
    """The two points that the spring connects."""
    stiffness: StiffnessInterval | None = None
    """Stiffness: one value or a range; default: from zero."""
    free_length: Annotated[Any, BeforeValidator(_read_free_length)] = None
    """Free length: fixed, or optimised within a range of two values; default: 0."""
    force: FixedForce | None = None
    """Largest permitted spring force; default: unlimited."""

    def spring(self, machine: Machine) -> FreeSpring:
        """Return the spring for a machine.

        Raises
        ------
        Unusable
            with the key below the section.
        """
        from optlink.dynamics.counterweights import FreeSpring

        mechanism = machine.mechanism
        used_names = (*mechanism.bodies, *mechanism.owners, *(g.name for g in mechanism.guides), *(x.name for x in machine.loads))
        if self.name in (*used_names, *RESERVED):
            raise Unusable("the name is taken", "Choose another for the spring", "name", self.name)
        ends = spring_ends(mechanism, self.between)
        low, most = _ends(self.stiffness)
        if min(low, most) < 0.0:
            raise Unusable("a stiffness must not be negative", "Give zero or more", "stiffness", str(self.stiffness))
        free = self.free_length or (0.0, 0.0)
        return FreeSpring(self.name, (ends[0], ends[1]), (low, most), free, math.inf if self.force is None else self.force.value)


class BalanceSection(Section):
    """Optimal balancing with `optlink balance`."""

    minimise: Annotated[Any, BeforeValidator(_read_goal)]
    """Objective: a measure, or a table of measures and their weights."""
    counterweights: tuple[CounterweightSection, ...] = ()
    """Counterweights that can be added to bodies."""
    springs: tuple[SpringSection, ...] = ()
    """Springs that can be added between points."""
    limits: dict[str, Any] = Field(default_factory=dict)
    """Limits of measures: a quantity, or a share of the value of the original machine."""
    mass: Annotated[MassInterval, _MASS] | None = None
    """Total mass of all counterweights: one value or a range; default: any."""
    about: Place = None
    """Reference point of shaking moments on the frame; default: the crank pivot."""
    positions: int = Field(default=360, ge=8, le=MAX_POSITIONS)
    """Number of evenly spaced crank angles of the programme, 8 to 100000."""

    @field_validator("limits", mode="after")
    @classmethod
    def _ceilings(cls, limits: dict[str, Any]) -> dict[str, MeasureLimit]:
        return {name: raw if isinstance(raw, MeasureLimit) else read_measure_limit(name, raw) for name, raw in limits.items()}

    @field_validator("counterweights", "springs", mode="before")
    @classmethod
    def _list(cls, raw: object) -> object:
        if not isinstance(raw, list | tuple):
            raise Unusable("expected a list of tables", "Begin each with [[balance.counterweights]]", "", raw)
        return tuple(raw)

    @property
    def goal(self) -> tuple[tuple[BalanceMeasure, float], ...]:
        """Measures to minimise, with their weights."""
        measures: tuple[tuple[BalanceMeasure, float], ...] = self.minimise
        return measures

    @property
    def total(self) -> tuple[float, float]:
        """Least and largest mass of all counterweights together [kg]."""
        return _ends(self.mass)

    def build(self, machine: Machine) -> tuple[tuple[Counterweight, ...], tuple[FreeSpring, ...]]:
        """Return the counterweights and springs, with all names checked.

        Raises
        ------
        Unusable
            with the key below the section.
        """
        if not self.counterweights and not self.springs:
            example = '[[balance.counterweights]] with body = "crank", thickness = "10 mm", density = "7850 kg/m^3"'
            message = "no counterweights or springs are permitted, so balancing has no design variables"
            raise Unusable(message, f"Add {example}", "counterweights")
        weights, springs = [], []
        for k, section in enumerate(self.counterweights):
            with below(f"counterweights.{k}"):
                weights.append(section.counterweight(machine))
        for k, weight in enumerate(weights):
            if weight.kind == "free" and math.isinf(min(weight.mass[1], self.total[1])):
                message = "its mass is unbounded: ever more mass with ever less moment of inertia would be optimal"
                raise Unusable(message, 'Add mass = { max = "2 kg" }, to it or to [balance]', f"counterweights.{k}.mass")
            if weight.kind == "free" and math.isinf(weight.extent):
                message = "its moment of inertia is unbounded: ever less mass ever further from its centre would be optimal"
                raise Unusable(message, 'Add extent = "100 mm" (of its edge)', f"counterweights.{k}.extent")
        bodies = [weight.body for weight in weights]
        for k, body in enumerate(bodies):
            if body in bodies[:k]:
                remedy = "Together they are one counterweight: give that its mass and reach"
                raise Unusable("the body has two counterweights", remedy, f"counterweights.{k}.body", body)
        for k, spring in enumerate(self.springs):
            with below(f"springs.{k}"):
                springs.append(spring.spring(machine))
        with below("minimise"):
            for measure, _ in self.goal:
                check_measure(measure, machine)
        with below("limits"):
            for limit in self.limits.values():
                check_measure(limit.measure, machine)
        self.place(machine)
        return tuple(weights), tuple(springs)

    def place(self, machine: Machine) -> tuple[float, float]:
        """Return the reference point of shaking moments [m]; default: the crank pivot."""
        mechanism = machine.mechanism
        if isinstance(self.about, tuple):
            return self.about
        point = mechanism.crank.start if self.about is None else self.about
        check_name(point, mechanism.ground, "not a point of the frame", "about")
        x, y = machine.moving([0.0]).position(point)
        return float(x), float(y)
