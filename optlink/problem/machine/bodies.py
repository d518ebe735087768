"""Mass properties, gravity and drive of a problem file."""

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Annotated, Any, NamedTuple, Self

import numpy as np
from pydantic import BeforeValidator, Field, ValidationInfo, model_validator

from optlink.clearance.joint import DAMPING, Gap, compliance, stiffness
from optlink.dynamics.machine import Inertia
from optlink.io import without
from optlink.linkage.laws import MotionLaw
from optlink.linkage.mechanism import FRAME, Mechanism, Pose
from optlink.linkage.vector2d import TURN, Value
from optlink.problem.base_model import InFolder, Section, folder_of, in_folder
from optlink.problem.machine.control import ServoSection
from optlink.problem.machine.drives import paced_law, read_drive_law
from optlink.problem.machine.loads import read_size
from optlink.problem.quantity import (
    SHORTEST,
    ContactStiffness,
    Damping,
    Duration,
    FixedLength,
    Friction,
    Mass,
    Number,
    Quantity,
    Unusable,
    Velocity,
    check_name,
    check_pair,
    is_number,
    read_fixed,
    read_positive,
    read_scalar,
    reader,
    where,
)
from optlink.units import KINDS, measures, with_article
from optlink.unsupported import unsupported

# --- bodies ----------------------------------------------------------------------------------------------------------


def _read_centroid(raw: object) -> Any:
    if isinstance(raw, str):
        return raw
    parts = check_pair(raw, "a centroid is a point of the body", 'Write "middle", a point, or ["100 mm", "0 mm"]')
    return tuple(read_fixed(part, "coordinate") for part in parts)


_MOMENT = BeforeValidator(lambda raw: raw if raw == "uniform bar" else read_positive(raw, "moment of inertia"))


class BodySection(Section):
    """Mass properties of a body: mass, centroid in its own axes, moment of inertia about the centroid."""

    mass: Mass
    """Mass of the body."""
    centroid: Annotated[Any, BeforeValidator(_read_centroid)] = None
    """`middle`, a point of the body, or coordinates along and across; default: the middle, or the only joint."""
    inertia: Annotated[Any, _MOMENT] = None
    """Moment of inertia about the centroid, or `uniform bar`; required for a link with a mass."""

    def inertia_of(self, body: str, mechanism: Mechanism, sizes: Mapping[str, Value]) -> Inertia:
        """Return the mass properties of a body for given dimensions of the mechanism [m, rad].

        Raises
        ------
        Unusable
            when the properties are inconsistent, with the key below the body.
        """
        link, mass = mechanism.bodies[body], self.mass.value
        length = (sizes[link.length] if isinstance(link.length, str) else link.length) if link.end else 0.0
        along: Value = 0.5 * length
        across: Value = 0.0
        if isinstance(self.centroid, tuple):
            along, across = (part.value for part in self.centroid)
        elif self.centroid not in (None, "middle"):
            points = [point for point, bodies in mechanism.owners.items() if body in bodies]
            check_name(self.centroid, ["middle", *points], "the body has no such point", "centroid")
            along, across = Pose(mechanism, sizes).local(body, self.centroid)
        if self.inertia == "uniform bar":
            if not link.end:
                raise Unusable("only a link with two joints is a bar", 'Write inertia = "0.016 kg*m^2"', "inertia", self.inertia)
            moment: Value = mass * length * length / 12.0
        elif self.inertia is None:
            if mass > 0.0 and link.end:
                example = f'inertia = "{mass * float(np.max(length)) ** 2 / 12.0:.3g} kg*m^2", or "uniform bar"'
                raise Unusable("a link with a mass needs a moment of inertia about its centroid", f"Add {example}", "inertia")
            moment = 0.0
        else:
            moment = self.inertia.value
        if mass == 0.0 and np.any(np.asarray(moment) > 0.0):
            message = "a body without mass has no moment of inertia"
            raise Unusable(message, "Give it a mass, or remove inertia", "inertia", str(self.inertia))
        return Inertia(mass, along, across, moment)


# --- the drive --------------------------------------------------------------------------------------------------------


_SMALL = where(
    lambda share: 0.0 < share < 2.0,
    "out of range",
    "Give the share of the mean speed by which it may vary, for example 0.02",
)


STATIC = "static"
"""Speed of a drive that is so slow that inertia has no effect."""
SLOWNESS = 1e-6
"""Rate of the cycle variable of a static analysis [rad/s]: inertia forces are 1e-12 of those at 1 rad/s."""


def _either(raw: object, angular: str, linear: str) -> Quantity:
    """Read a fixed quantity of a drive that turns or slides; the unit decides."""
    return read_fixed(raw, linear if isinstance(raw, str) and measures(raw, linear) else angular)


def _read_speed(raw: object) -> Quantity:
    if isinstance(raw, str) and raw.strip() == STATIC:
        return Quantity(SLOWNESS, STATIC, "")
    if isinstance(raw, dict) and "expression" in raw:
        remedy = 'Give the position over the time t: law = { expression = "45*sin(2*pi*t)", unit = "deg" }'
        raise Unusable("a speed is constant, or a table over phi", remedy, value=raw)
    return _either(raw, "angular velocity", "velocity")


MOST_TURNS = 24
"""Revolutions in the range of a drive, at most."""


def _read_range(raw: object) -> tuple[Quantity, Quantity]:
    if isinstance(raw, dict) and set(raw) == {"min", "max"}:
        raw = [raw["min"], raw["max"]]
    remedy = 'Write range = ["15 deg", "60 deg"], for a slide or cylinder ["0 mm", "250 mm"]'
    low, high = (_either(end, "angle", "coordinate") for end in check_pair(raw, "a range has two ends", remedy))
    if low.kind != high.kind:
        raise Unusable("the two ends have units of different kinds", remedy, "", raw)
    if not low.value < high.value:
        raise Unusable("the range must rise", 'Exchange its ends, or begin below zero: ["-10 deg", "30 deg"]', "", raw)
    if low.kind == "angle" and high.value - low.value > MOST_TURNS * TURN:
        raise Unusable(f"the range is more than {MOST_TURNS} revolutions", "Leave it out for a crank that turns fully", "", raw)
    return low, high


class Stated(NamedTuple):
    """The law of a drive as the file states it, and whether the file states where it starts."""

    raw: object
    start: bool


def _read_law(stated: object, info: ValidationInfo) -> MotionLaw | None:
    """Read the law of a drive; the fields before it say what it moves and from where."""
    if not isinstance(stated, Stated):
        return None
    data, folder, (raw, start) = info.data, folder_of(info), stated
    kind = "length" if data.get("cylinder") else "coordinate" if data.get("slide") else "angle"
    if isinstance(raw, dict) and raw.get("over") in ("t", "time"):
        remedy = 'Write law = [{ time = "1 s", to = "30 deg" }, { time = "1 s", to = "0 deg" }], or { csv = "law.csv" }'
        raise Unusable("the law of a drive over the time is a list of motions, or a CSV file", remedy, "over", raw["over"])
    if isinstance(raw, dict) and "over" in raw:
        return paced_law(read_size(raw, folder, "angular velocity", ("phi",)), kind)
    begin = data["start"].value if start and "start" in data else None
    return read_drive_law(raw, folder, kind, start=begin, unit=data.get("unit"))


Acceleration = Annotated[Quantity, reader(read_fixed, "angular acceleration")]
Pace = Annotated[Quantity, BeforeValidator(_read_speed)]
Position = Annotated[Quantity, BeforeValidator(partial(_either, angular="angle", linear="coordinate"))]


_Speed = Annotated[Quantity, BeforeValidator(partial(_either, angular="angular velocity", linear="velocity"))]
_Stiffness = Annotated[Quantity, BeforeValidator(partial(_either, angular="torsional stiffness", linear="stiffness"))]
_Damping = Annotated[Quantity, BeforeValidator(partial(_either, angular="torsional damping", linear="damping"))]
_Effort = Annotated[Quantity, BeforeValidator(partial(_either, angular="torque", linear="force"))]
LINEAR = {"torsional stiffness": "stiffness", "torsional damping": "damping", "torque": "force", "angular velocity": "velocity"}
"""Kinds of quantities of a drive that turns, and those of one that moves along a line."""


class StopsSection(Section):
    """End stops of a drive under a torque or force, at the ends of its range: rigid ones, or with a stiffness."""

    restitution: Annotated[
        Number, where(lambda e: 0.0 <= e <= 1.0, "a coefficient of restitution lies between 0 and 1", "Give for example 0.4")
    ] = 0.0
    """Coefficient of restitution: the speed after an impact over that before it."""
    stiffness: (
        Annotated[_Stiffness, where(lambda k: k > 0.0, "a stop needs a stiffness", "Leave it out for rigid stops")] | None
    ) = None
    """Stiffness of the stops, which otherwise are rigid; they give back the square of the restitution of the energy."""


class ControllerSection(Section):
    """Controller of a drive for `simulate`: its torque or force is the proportional gain times the distance of the drive from its
    law, and the derivative gain times that of its speed."""

    proportional: Annotated[_Stiffness, where(lambda gain: gain > 0.0, "a gain is positive", 'Give for example "200 N*m/rad"')]
    """Proportional gain, a torsional stiffness, or of a slide or cylinder a stiffness."""
    derivative: _Damping | None = None
    """Derivative gain, a torsional damping or a damping."""
    limit: Annotated[_Effort, where(lambda most: most > 0.0, "the limit is not positive", 'Give for example "50 N*m"')] | None = (
        None
    )
    """Largest torque or force of the drive."""
    feedforward: bool = False
    """Whether it adds the torque or force that the laws need."""


class DriveMotion(Section):
    """One of several drives: what it moves, and its law or constant speed; without either it is held where it starts."""

    body: str | None = None
    """The driven body; default: the body called `crank`."""
    slide: str | None = None
    """Instead of a body: the guide along which the drive acts."""
    cylinder: str | None = None
    """Instead of a body: the cylinder that drives."""
    against: str = FRAME
    """The body that carries the drive; default: the frame."""
    range: Annotated[tuple[Quantity, Quantity], BeforeValidator(_read_range)] | None = None
    """Range of the driven angle, slide or length, to which all results refer; default: as far as it can move."""
    start: Position = Quantity(0.0, "angle", "deg")
    """Position of the drive in the first row; with a range, the default is the end from which it moves."""
    unit: str | None = None
    """Unit of an expression that is the law."""
    law: Annotated[Any, InFolder(_read_law)] = None
    """Instead of a constant speed: the driven angle, slide or length over the time, segment by segment; an expression of t, or a
    CSV file."""
    speed: Pace = Quantity(1.0, "angular velocity", "rad/s")
    """Constant speed of the crank, negative clockwise, or of a slide or cylinder; `static` is without inertia. For
    `optlink simulate` under a torque the speed at the start."""
    torque: Annotated[Any, in_folder(partial(read_size, kind="torque", names=("phi", "omega")))] = None
    """For `optlink simulate`, instead of the constant speed: a torque, or a table or expression over phi or omega."""
    force: Annotated[Any, in_folder(partial(read_size, kind="force", names=("s", "v")))] = None
    """For `optlink simulate`, of a slide or cylinder: a force, positive along the guide or where it extends the cylinder, or a
    table or expression over its slide or length s and its speed v."""
    stops: Annotated[StopsSection | None, BeforeValidator(lambda raw: {} if raw == "rigid" else raw)] = None
    """End stops of a drive under a torque or force: `{ restitution = 0.4 }`, with `stiffness` elastic ones; default: `rigid` ones
    at the ends of its range, from which it does not rebound."""
    controller: ControllerSection | None = None
    """For `optlink simulate`: the drive follows its law by a controller, in place of exactly."""
    initial_speed: _Speed | None = None
    """Speed at the start of `optlink simulate` under a torque, force or controller; default: `speed` if that is given, with a
    controller that of the law, else at rest."""

    @model_validator(mode="before")
    @classmethod
    def _supported(cls, raw: object) -> object:
        for key, value in raw.items() if isinstance(raw, dict) else ():
            if key in ("body", "speed", "start") and isinstance(value, list):
                remedy = 'Give each its section: [drives.left] body = "left", law = [...]; [drives.right] ...'
                raise Unusable("a drive moves one body", remedy, key, value)
        if isinstance(raw, dict) and isinstance(raw.get("speed"), dict) and "over" in raw["speed"]:  # a law
            if "law" in raw:
                raise Unusable("the drive has a law and a speed", "Give one of the two", "speed", raw["speed"])
            return {**without(raw, "speed"), "law": Stated(raw["speed"], True)}
        if isinstance(raw, dict) and raw.get("law") is not None:
            return {**raw, "law": Stated(raw["law"], "start" in raw)}
        return raw

    @model_validator(mode="after")
    def _moves(self) -> Self:
        if sum(one is not None for one in (self.body, self.slide, self.cylinder)) > 1:
            raise Unusable("the drive acts in one place", "Give one of body, slide and cylinder", "body", self.body)
        if self.effort is not None and self.law is not None:
            key = "torque" if self.force is None else "force"
            raise Unusable(f"the drive has a prescribed motion and a {key}", "Give one of the two", key, str(self.effort))
        if self.torque is not None and self.linear:
            raise Unusable("the drive moves along a line", 'Give force = "10 kN" instead', "torque", str(self.torque))
        if self.controller is not None and self.law is None:
            remedy = 'Give the law that it follows: law = { expression = "45*sin(2*pi*t)", unit = "deg" }'
            raise Unusable("the controller has no law", remedy, "controller")
        if self.stops is not None and not (self.free and (self.range or self.linear)):
            message = "end stops hold a drive under a torque or force at the ends of its range"
            raise Unusable(message, 'Give range = ["0 deg", "90 deg"], and torque = "0 N*m" if it moves freely', "stops")
        stated = [("initial_speed", self.initial_speed)]
        stated += [(f"{section}.{key}", of) for section in ("stops", "controller") for key, of in getattr(self, section) or ()]
        for key, of in stated:
            if isinstance(of, Quantity) and self.linear != (of.kind in LINEAR.values()):
                kind = next(b if self.linear else a for a, b in LINEAR.items() if of.kind in (a, b))
                remedy = f'Give {with_article(kind)} such as "{KINDS[kind].example}"'
                raise Unusable("the drive moves along a line" if self.linear else "the drive turns", remedy, key, str(of))
        return self

    @property
    def effort(self) -> Any:
        """The torque or force under which the drive moves freely in `simulate`, if it does."""
        return self.torque if self.force is None else self.force

    @property
    def free(self) -> bool:
        """Whether the drive moves freely in `simulate`, under a torque, force or controller."""
        return self.effort is not None or self.controller is not None

    @property
    def linear(self) -> bool:
        """Whether the file states a drive along a line: a slide or cylinder, or positions and speeds of one."""
        return bool(self.slide or self.cylinder or self.stated_linear[0])

    @property
    def stated_linear(self) -> tuple[str, str]:
        """Key and value of the first position, speed or force along a line that the file states; empty without one."""
        stated = [("speed", self.speed), ("start", self.start), *(("range", end) for end in self.range or ())]
        force = ("", "") if self.force is None else ("force", str(self.force))
        return next(((key, str(one)) for key, one in stated if one.kind in ("velocity", "coordinate")), force)


class DriveSection(DriveMotion):
    """Drive of the machine: a constant speed, a law over the time, or (for `simulate`) a torque, force or motor curve."""

    acceleration: Acceleration | None = None
    """Constant angular acceleration of the crank, from `start` and `speed` on, for one revolution or to the end of its range."""
    servo: ServoSection | None = None
    """For `optlink simulate` with clearance: the crank follows a reference signal; not together with `torque`."""
    duration: Duration | None = None
    """Duration of `optlink simulate`."""
    fluctuation: Annotated[Number, _SMALL] | None = None
    """Permitted speed fluctuation relative to the mean speed, 0.02 or "2 %"; `optlink analyze` computes the flywheel for it."""

    @model_validator(mode="after")
    def _turns(self) -> Self:
        if self.speed.value == 0.0 and self.effort is None:
            remedy = 'Give a speed, or "static" for statics; from rest the drive needs a torque'
            raise Unusable("the crank speed is zero", remedy, "speed", str(self.speed))
        if self.effort is not None and self.acceleration is not None:
            raise Unusable("the drive has an acceleration and a torque", "Give one of the two", "torque", str(self.effort))
        if self.fluctuation is not None and (self.range or self.linear or self.law or self.acceleration):
            message = "the fluctuation is that of a crank that turns fully, near a constant speed"
            raise Unusable(message, "Leave it out, or range and law", "fluctuation", self.fluctuation)
        return self


def _read_gravity(raw: object) -> Any:
    """Read gravity: a value along -y, or two components."""
    if isinstance(raw, list):
        check_pair(raw, "gravity has two components", 'Write "9.81 m/s^2" (downwards) or ["0 m/s^2", "-9.81 m/s^2"]')
        return tuple(read_fixed(part, "acceleration").value for part in raw)
    return 0.0, -read_fixed(raw, "acceleration").value


Gravity = Annotated[Any, BeforeValidator(_read_gravity)]


# The joints of a problem file: the body whose reaction is reported, and the clearance of a pin.

RADII_AGREE = 1e-6
"""Share of the clearance by which the difference of two given radii may differ from it."""

EXAMPLE = 'clearance = "0.5 mm", bearing_radius = "10 mm", modulus = "207 GPa", poisson = 0.3'


def _read_clearance(raw: object) -> Quantity:
    value, unit = read_scalar(raw, "coordinate")
    if value <= 0.0:
        message = "a clearance is positive: the radius of the bearing minus that of the journal"
        raise Unusable(message, 'Give one such as "0.5 mm", or remove the key for an ideal joint')
    if value < SHORTEST:
        raise Unusable("no joint has such a clearance", "Give 1e-9 m or more, and check its unit")
    return Quantity(value, "length", unit)


def _read_pair(raw: object, kind: str) -> tuple[float, float]:
    """Read one value for both parts, or the values of the journal and of the bearing."""
    if isinstance(raw, list):
        check_pair(raw, "one value, or two: of the journal and of the bearing", "Give one or two")
        return _one(raw[0], kind), _one(raw[1], kind)
    value = _one(raw, kind)
    return value, value


def _one(raw: object, kind: str) -> float:
    if kind:
        value = read_positive(raw, kind).value
        if value == 0.0:
            raise Unusable(f"a {kind} of the contact must be positive", 'Give for example "207 GPa"')
        return value
    if not is_number(raw):
        raise Unusable("expected a plain number", "Write a number without a unit, for example 0.3")
    if not -1.0 < raw <= 0.5:
        raise Unusable("Poisson's ratio lies above -1 and not above 0.5", "Give for example 0.3, that of steel")
    return float(raw)


class JointSection(Section):
    """A joint: `on` is the body whose reaction is reported; `clearance` and the following keys define a journal in a bearing."""

    on: str | None = None
    """The body on which the reported reaction acts; default: the one that is placed last."""
    clearance: Annotated[Quantity, BeforeValidator(_read_clearance)] | None = None
    """Radial clearance: radius of the bearing minus that of the journal."""
    bearing_radius: FixedLength | None = None
    """Radius of the bearing; one of the two radii together with `clearance`, or both without it."""
    journal_radius: FixedLength | None = None
    """Radius of the journal."""
    journal: str | None = None
    """The body with the journal; default: the one that is placed last. Required where three or more bodies meet."""
    modulus: Annotated[Any, BeforeValidator(lambda raw: _read_pair(raw, "pressure"))] = None
    """Modulus of elasticity of both parts, or of journal and bearing; it determines the Hertz stiffness."""
    poisson: Annotated[Any, BeforeValidator(lambda raw: _read_pair(raw, ""))] = Field(default=(0.3, 0.3))
    """Poisson's ratio of both parts, or of journal and bearing."""
    stiffness: (
        Annotated[ContactStiffness, where(lambda k: k > 0.0, "a contact needs a stiffness", 'Give for example "6.6e+10 N/m^1.5"')]
        | None
    ) = None
    """Instead of `modulus`: contact force divided by penetration to the power 1.5."""
    restitution: Annotated[
        Number,
        where(lambda e: 0.0 < e <= 1.0, "a coefficient of restitution lies above 0 and not above 1", "Give for example 0.9"),
    ] = 0.9
    """Coefficient of restitution, above 0 and at most 1."""
    law: str = "lankarani-nikravesh"
    """Contact law."""
    friction: Friction = 0.0
    """Coulomb friction coefficient, below 10."""
    slip_speed: Annotated[
        Velocity,
        where(
            lambda v: v >= 1e-6, "friction changes its sign over some speed, of 1e-6 m/s at least", 'Give for example "0.01 m/s"'
        ),
    ] = Quantity(0.01, "velocity", "m/s")
    """The friction force is `friction` times normal force times tanh(slip / `slip_speed`)."""
    damping: Damping = Quantity(0.0, "damping", "N*s/m")
    """Tangential viscous damping during contact."""

    @property
    def has_clearance(self) -> bool:
        """Whether the joint has clearance."""
        both = self.bearing_radius is not None and self.journal_radius is not None
        return self.clearance is not None or both

    def gap(self, point: str, mechanism: Mechanism) -> Gap:
        """Return the pin `point` as a joint with clearance.

        Raises
        ------
        Unusable
            with the key below the joint.
        """
        bodies = mechanism.pins[point]
        journal = self.journal if self.journal is not None else bodies[-1] if len(bodies) == 2 else None
        if journal is None:
            message = f"the pin joins {', '.join(bodies)}, and only one of them can have the journal"
            raise Unusable(message, f'Add journal = "{bodies[-1]}"', "journal")
        check_name(journal, bodies, "the joint is not one of that body", "journal")
        clearance, radius = self._radii()
        check_name(self.law, DAMPING, "no such contact law", "law")
        return Gap(
            point,
            journal,
            next(body for body in bodies if body != journal),
            clearance,
            radius,
            self._stiffness(clearance, radius),
            self.restitution,
            self.law,
            self.friction,
            slip_speed=self.slip_speed.value,
            damping=self.damping.value,
        )

    def _radii(self) -> tuple[float, float]:
        """Return clearance and radius of the journal [m]."""
        bearing, journal, clearance = self.bearing_radius, self.journal_radius, self.clearance
        if bearing is not None and journal is not None:
            difference = bearing.value - journal.value
            if difference <= 0.0:
                message = f"the journal ({journal}) is not smaller than the bearing ({bearing})"
                raise Unusable(message, "Exchange the radii, or make the bearing larger", "journal_radius", str(journal))
            if clearance is not None and abs(difference - clearance.value) > RADII_AGREE * difference:
                message = f"the radii differ by {difference * 1e3:.6g} mm, but the clearance is stated as {clearance}"
                raise Unusable(message, "Remove one of the three", "clearance", str(clearance))
            return difference, journal.value
        if clearance is None:
            raise Unusable("the joint has radii, but no clearance", f"Add the other radius, or {EXAMPLE}", "clearance")
        if bearing is not None:
            if clearance.value >= bearing.value:
                message = f"the clearance ({clearance}) is not smaller than the bearing ({bearing}): no journal is left"
                raise Unusable(message, "Check both", "clearance", str(clearance))
            return clearance.value, bearing.value - clearance.value
        if journal is None:
            message = "the sizes of journal and bearing are missing"
            raise Unusable(message, 'Add bearing_radius = "10 mm" (or journal_radius)', "bearing_radius")
        return clearance.value, journal.value

    def _stiffness(self, clearance: float, radius: float) -> float:
        if self.stiffness is not None:
            if self.modulus is not None:
                message = "the contact has a stiffness and a modulus of elasticity"
                raise Unusable(message, "Give one of the two", "stiffness", str(self.stiffness))
            return self.stiffness.value
        if self.modulus is None:
            message = "the contact has no stiffness and no material"
            raise Unusable(message, 'Add modulus = "207 GPa" (and poisson = 0.3), or stiffness = "6.6e+10 N/m^1.5"', "stiffness")
        first, second = (compliance(e, nu) for e, nu in zip(self.modulus, self.poisson, strict=True))
        return float(stiffness(radius + clearance, radius, first, second))

    def check_unused(self, point: str, bodies: Sequence[str]) -> None:
        """Refuse keys without effect in a pin without clearance that joins these bodies.

        Raises
        ------
        Unusable
            with the first such key.
        """
        unused = sorted(key for key in self.model_fields_set - {"on"} if getattr(self, key) is not None)
        if "friction" in unused and not self.has_clearance:
            other, body = bodies[0], bodies[-1]
            raise Unusable(*unsupported("pin friction", point=point, body=body, other=other), "friction")
        if unused and not self.has_clearance:
            message = f"the joint has no clearance, so {unused[0]} has no effect"
            raise Unusable(message, f"Add {EXAMPLE}, or remove the key", unused[0])
