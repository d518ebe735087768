"""Terms over the cycle of a machine, each to be optimised or limited: torque, forces, motion, strokes, work, dimensions."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, Literal, Protocol, Self, TypeAlias, get_args

import numpy as np
from pydantic import BeforeValidator, model_validator

from optlink.dynamics.inverse import ForceBalance, Reactions, shaking
from optlink.dynamics.machine import Moving, slider_names
from optlink.io import Entry, register
from optlink.linkage.cams import CamContact
from optlink.linkage.dyads import RPR, RRP, RRR, Transmitting, transmitting
from optlink.linkage.elements import FLATTEST, Cam, Drive
from optlink.linkage.jet import as_jet
from optlink.linkage.mechanism import FRAME, Mechanism, Pose
from optlink.linkage.vector2d import TURN, Array, Value, Vector, cross, dot, magnitude, minus
from optlink.problem.base_model import SPELLINGS, Section
from optlink.problem.mechanism import moving_points
from optlink.problem.quantity import (
    SIDES,
    STROKES,
    AngleInterval,
    FixedAngle,
    Interval,
    Number,
    Quantity,
    Unusable,
    check_name,
    check_pair,
    check_time_ratio,
    nearest,
    read_figure,
    read_fixed,
    where,
)
from optlink.units import KINDS, with_article

if TYPE_CHECKING:
    from optlink.dynamics.columns import MotionColumns


# Quantities of a machine cycle that can be optimised or limited: one `QuantityType` per value of the key `quantity`.
#
# An entry contains the formula of the optimiser (`signal`, elementwise on floats, arrays and symbols) and, written separately,
# the columns from which the validator reads it (`history`).


class ElementTerm(Protocol):
    """A term, of which a quantity reads the name `of` its element, the body `on` which a reaction acts, the reference point."""

    @property
    def of(self) -> str | None:
        """Name of the element."""

    @property
    def on(self) -> str | None:
        """Name of the body."""

    @property
    def about(self) -> str | tuple[float, float] | None:
        """Reference point of a moment: a point of the frame or its coordinates [m]; None for the crank pivot."""


Signal: TypeAlias = Callable[[Moving, Reactions, ElementTerm], tuple[Value, ...]]
"""Formula of a quantity at one crank angle, elementwise: one component, or two of a vector [SI]."""
Course: TypeAlias = "Callable[[MotionColumns, ElementTerm], Array]"
"""Measurement of a quantity at all crank angles [SI], from the columns of a motion, such as `record["rocker.omega_rad_s"]`."""


@dataclass(frozen=True)
class Element:
    """A type of element that `of` can name: the names in a mechanism, and the error message for any other name."""

    names: Callable[[Mechanism], Collection[str]]
    missing: str


def guide_of(name: str, mechanism: Mechanism) -> str | None:
    """Return the guide of that name, or the only guide of a slider of that name; None if there is none."""
    if any(guide.name == name for guide in mechanism.guides):
        return name
    guides = [guide.name for guide in mechanism.guides if guide.slider == name]
    return guides[0] if len(guides) == 1 else None


def linear_drives(mechanism: Mechanism) -> list[Drive]:
    """Return the drives that act along a line: slides and cylinders."""
    return [drive for drive in mechanism.drives if drive.kind != "angle"]


def turning_drives(mechanism: Mechanism) -> list[Drive]:
    """Return the drives that turn a body by a law, or beside others."""
    return [drive for drive in mechanism.drives if drive.kind == "angle"]


PIN = Element(lambda mechanism: mechanism.pins, "no such pin joint")
GUIDE = Element(lambda mechanism: [guide.name for guide in mechanism.guides], "no such guide")
POINT = Element(moving_points, "no moving body has such a point")
DRIVE = Element(
    lambda mechanism: [drive.name for drive in linear_drives(mechanism)], "no slide or cylinder is a drive of that name"
)
MOTOR = Element(lambda mechanism: [drive.name for drive in turning_drives(mechanism)], "no drive of that name turns a body")
POWERED = Element(lambda mechanism: [drive.name for drive in mechanism.drives] or ["input"], "no drive of that name")
CAM = Element(lambda mechanism: _cams(mechanism), "no such cam")
ROUND = Element(
    lambda mechanism: [name for name, cam in _cams(mechanism).items() if cam.contact],
    "no cam of that name moves its follower by a roller or a knife edge",
)
JOINT = Element(lambda mechanism: [group.joint for group in transmitting(mechanism)], "no dyad has its transmission angle there")
Measure = Literal["peak", "rms", "mean", "largest", "least"]
_SIGNED = get_args(Measure)
_SIZE = ("peak", "rms")
_EXTREMES = ("least", "largest")


@dataclass(frozen=True)
class QuantityType(Entry):
    """A quantity of the cycle of a machine, as objective or limit: a value of the key `quantity`.

    Parameters
    ----------
    name : str
        As it stands in a file.
    kind : str
        Physical kind, one of `KINDS` of `optlink.units`; empty for a plain number.
    measures : tuple of str
        Measures that reduce it to one value, the default first; empty for a quantity with a single value.
    of : str
        Element that `of` must name, for display; empty if it belongs to the whole machine.
    element : Element, optional
        The names that `of` may take.
    signal : function of (machine in motion, reactions, term), optional
        Formula at one crank angle [SI]; two components for a vector, of which only the magnitude counts.
    history : function of (columns of a motion, term), optional
        Measurement at all crank angles [SI].
    forces : bool
        Whether `signal` needs the reactions; it can then also be evaluated without the inertia of the bodies.
    vector : bool
        Whether the signal has two components.
    general : bool
        Whether `of` may be left out: the signal then has one component per element, and the worst of all counts.
    at : str
        Preposition before the element, for display.
    sole : bool
        Whether `of` may be left out where there is only one element.
    """

    name: str
    kind: str
    measures: tuple[str, ...]
    of: str = ""
    element: Element | None = None
    signal: Signal | None = None
    history: Course | None = None
    forces: bool = False
    vector: bool = False
    general: bool = False
    at: str = "of"
    sole: bool = False

    def fault(self) -> tuple[str, str] | None:
        """Refuse unknown physical kinds and measures, and a course that the optimiser or the validator lacks."""
        if self.kind and self.kind not in KINDS:
            return f'the physical kind "{self.kind}" is unknown', nearest(self.kind, KINDS)
        if unknown := sorted(set(self.measures) - set(get_args(Measure))):
            return f'the measure "{unknown[0]}" is unknown', nearest(unknown[0], get_args(Measure))
        if (self.signal is None) != (self.history is None):
            return "only one of signal and history is given", "Give both: what one optimises, the other validates"
        return None

    @property
    def cyclic(self) -> bool:
        """Whether it has a value at every crank angle."""
        return self.signal is not None

    @property
    def affine(self) -> bool:
        """Whether its signal is an affine function of the inertial parameters of the bodies: a force or a moment."""
        return self.cyclic and self.kind in ("force", "torque")


QUANTITIES: dict[str, QuantityType] = QuantityType.registry


def _name(term: ElementTerm, drives: Iterable[Drive]) -> str:
    """Return the name of the drive of a term; default: the first one, or the input of a linkage without drives."""
    return term.of or next((drive.name for drive in drives), "input")


def _drive(moving: Moving, term: ElementTerm) -> str:
    return _name(term, linear_drives(moving.machine.mechanism))


def _motor(moving: Moving, term: ElementTerm) -> str:
    return _name(term, turning_drives(moving.machine.mechanism))


def _power(moving: Moving, reactions: Reactions, term: ElementTerm) -> Value:
    name = _name(term, moving.machine.mechanism.drives)
    for drive in moving.machine.mechanism.drives:
        if drive.name == name:
            return reactions.efforts[name] * as_jet(drive.value(moving.pose)).rate
    return reactions.torque * moving.motion.speed


def _guide(moving: Moving, term: ElementTerm) -> str:
    return str(guide_of(str(term.of), moving.machine.mechanism))


def _column(suffix: str, *, of_slider: bool = False) -> Course:
    """Return a function that reads a column of a guide, or of its slider."""

    def read(record: MotionColumns, term: ElementTerm) -> Array:
        guide = _guide(record.moving, term)
        return record[f"{slider_names(record.moving.machine)[guide] if of_slider else guide}.{suffix}"]

    return read


def _size(x: str, y: str) -> Course:
    """Return a function that reads the magnitude of two columns; {} is the element."""
    return lambda record, term: np.hypot(record[x.format(term.of)], record[y.format(term.of)])


def _pin(record: MotionColumns, term: ElementTerm) -> Array:
    force = record.reactions.pin(record.moving.machine, str(term.of), term.on)
    return np.hypot(*(record.full(part) for part in force))


def _reference(moving: Moving, term: ElementTerm) -> Vector:
    """Return the reference point of a moment [m]."""
    if isinstance(term.about, tuple):
        return term.about
    return moving.position(term.about or moving.machine.mechanism.crank.start)


def _shaking_moment(moving: Moving, reactions: Reactions, term: ElementTerm) -> tuple[Value, ...]:
    return (shaking(moving).about(moving.position(moving.machine.mechanism.crank.start), _reference(moving, term)),)


def _shaking_moment_measured(record: MotionColumns, term: ElementTerm) -> Array:
    x, y = minus(record.moving.position(record.machine.mechanism.crank.start), _reference(record.moving, term))
    return np.asarray(record["frame.shaking_moment_Nm"] + x * record["frame.shaking_fy_N"] - y * record["frame.shaking_fx_N"])


def _groups(moving: Moving, term: ElementTerm) -> list[Transmitting]:
    """Return the dyad with the joint of a term, or all that have a transmission angle."""
    return [group for group in transmitting(moving.machine.mechanism) if term.of in (None, group.joint)]


def _pressure(moving: Moving, reactions: Reactions, term: ElementTerm) -> tuple[Value, ...]:
    """Return 90 deg less the transmission angle [rad], of one dyad or of all."""
    return tuple(0.5 * np.pi - _transmission_angle(moving, group) for group in _groups(moving, term))


def _transmission_angle(moving: Moving, group: Transmitting) -> Value:
    """Return the transmission angle of a dyad [rad], see `optlink.linkage.dyads.Transmitting`; 90 deg is best."""
    p, q = ForceBalance(moving, {}).directions(group, {})
    return np.arctan2(magnitude(cross(p, q)), dot(p, q))


def _pressure_measured(record: MotionColumns, term: ElementTerm) -> Array:
    angles = [_measured(record, group) for group in _groups(record.moving, term)]
    return np.asarray(np.max([np.abs(0.5 * np.pi - angle) for angle in angles], axis=0))


def _measured(record: MotionColumns, group: Transmitting) -> Array:
    motion = record.moving.motion
    if isinstance(group, RRR):
        return record[f"{group.joint}.transmission_rad"]
    lines = [record.moving.line(guide.name) for guide in group.prismatic]
    if isinstance(group, RRP | RPR):
        ends = (group.joint, group.outer[0]) if isinstance(group, RRP) else group.outer
        arm = np.asarray(motion.position(ends[0]) - motion.position(ends[1]))
        cosine = (lines[0][0] * arm[:, 1] - lines[0][1] * arm[:, 0]) / np.linalg.norm(arm, axis=1)
    else:
        cosine = lines[0][0] * lines[1][0] + lines[0][1] * lines[1][1] + 0.0 * motion.crank_angle
    return np.asarray(np.arccos(np.clip(cosine, -1.0, 1.0)))  # values beyond +-1 are rounding errors


def _cams(mechanism: Mechanism) -> dict[str, Cam]:
    """Return the cams of a mechanism by name."""
    return {element.name: element for element in mechanism.elements if isinstance(element, Cam)}


def _on_cam(part: int) -> Signal:
    """Return a function for one of the figures of the contact of a cam with its follower."""

    def signal(moving: Moving, reactions: Reactions, term: ElementTerm) -> tuple[Value, ...]:
        mechanism, motion = moving.machine.mechanism, moving.motion
        cam = _cams(mechanism)[str(term.of)]
        turned = as_jet(cam.knots(motion.pose)[0]).value
        return (cam.contact_at(Pose(mechanism, motion.sizes), turned)[part],)

    return signal


def _measured_on_cam(read: Callable[[CamContact], Array]) -> Course:
    """Return a function that reads a figure from the disc cam, whose profile is an envelope."""

    def course(record: MotionColumns, term: ElementTerm) -> Array:
        motion = record.moving.motion
        cam, pose = _cams(motion.mechanism)[str(term.of)], motion.pose
        angles = as_jet(pose.turned(cam.cam) - pose.turned(cam.against)).value
        return read(cam.disc(Pose(motion.mechanism, motion.sizes)).at(record.full(angles)))

    return course


def _bulging_radius(contact: CamContact) -> Array:
    """Return the radius of curvature of a profile, very large where it is flat or hollow, as in `Cam.contact_at`."""
    largest = FLATTEST * np.abs(contact.point)
    return np.where(contact.turning > 0.0, np.minimum(contact.radius, largest), largest)


def _lever_arm(record: MotionColumns, term: ElementTerm) -> Array:
    return np.asarray(np.abs(_column("v_m_s", of_slider=True)(record, term) / record.moving.motion.speed))


register(
    QuantityType(
        "torque",
        "torque",
        _SIGNED,
        "drive that turns a body",
        MOTOR,
        lambda moving, reactions, term: (reactions.efforts.get(_motor(moving, term), reactions.torque),),
        lambda record, term: record[f"{_motor(record.moving, term)}.torque_Nm"],
        forces=True,
        sole=True,
    ),
    QuantityType(
        "drive force",
        "force",
        _SIGNED,
        "slide or cylinder that drives",
        DRIVE,
        lambda moving, reactions, term: (reactions.efforts[_drive(moving, term)],),
        lambda record, term: record[f"{_drive(record.moving, term)}.force_N"],
        forces=True,
        sole=True,
    ),
    QuantityType(
        "power",
        "power",
        _SIGNED,
        "drive",
        POWERED,
        lambda moving, reactions, term: (_power(moving, reactions, term),),
        lambda record, term: record[f"{_name(term, record.machine.mechanism.drives)}.power_W"],
        forces=True,
        sole=True,
    ),
    QuantityType(
        "reaction",
        "force",
        _SIZE,
        "pin joint",
        PIN,
        lambda moving, reactions, term: reactions.pin(moving.machine, str(term.of), term.on),
        _pin,
        forces=True,
        vector=True,
        at="at",
    ),
    QuantityType(
        "guide force",
        "force",
        _SIGNED,
        "guide",
        GUIDE,
        lambda moving, reactions, term: (reactions.guides[_guide(moving, term)].normal,),
        _column("normal_N"),
        forces=True,
        at="in",
    ),
    QuantityType(
        "guide moment",
        "torque",
        _SIGNED,
        "guide",
        GUIDE,
        lambda moving, reactions, term: (reactions.guides[_guide(moving, term)].moment,),
        _column("moment_Nm"),
        forces=True,
        at="in",
    ),
    QuantityType(
        "shaking force",
        "force",
        _SIZE,
        signal=lambda moving, reactions, term: shaking(moving).force,
        history=_size("frame.shaking_fx_N", "frame.shaking_fy_N"),
        vector=True,
    ),
    QuantityType(
        "shaking moment",
        "torque",
        _SIGNED,
        signal=_shaking_moment,
        history=_shaking_moment_measured,
    ),
    QuantityType(
        "velocity",
        "velocity",
        _SIZE,
        "moving point",
        POINT,
        lambda moving, reactions, term: moving.velocity(str(term.of)),
        _size("{}.vx_m_s", "{}.vy_m_s"),
        vector=True,
    ),
    QuantityType(
        "acceleration",
        "acceleration",
        _SIZE,
        "moving point",
        POINT,
        lambda moving, reactions, term: moving.acceleration(str(term.of)),
        _size("{}.ax_m_s2", "{}.ay_m_s2"),
        vector=True,
    ),
    QuantityType(
        "transmission angle",
        "angle",
        _EXTREMES,
        "joint of a dyad",
        JOINT,
        lambda moving, reactions, term: (_transmission_angle(moving, _groups(moving, term)[0]),),
        lambda record, term: _measured(record, _groups(record.moving, term)[0]),
        at="at",
    ),
    QuantityType(
        "pressure angle", "angle", ("peak",), "joint of a dyad", JOINT, _pressure, _pressure_measured, general=True, at="at"
    ),
    QuantityType(
        "cam pressure angle",
        "angle",
        ("peak",),
        "cam",
        ROUND,
        _on_cam(0),
        _measured_on_cam(lambda contact: contact.pressure_angle),
    ),
    QuantityType("profile radius", "length", ("least",), "cam", CAM, _on_cam(1), _measured_on_cam(_bulging_radius)),
    QuantityType(
        "slide",
        "coordinate",
        _EXTREMES,
        "guide",
        GUIDE,
        lambda moving, reactions, term: (moving.slides[_guide(moving, term)][0],),
        _column("s_m", of_slider=True),
        at="in",
    ),
    QuantityType(
        "lever arm",
        "length",
        _SIZE,
        "guide",
        GUIDE,
        lambda moving, reactions, term: (moving.slides[_guide(moving, term)][1] / moving.motion.speed,),
        _lever_arm,
    ),
    QuantityType("stroke", "length", (), "slider, body or point"),
    QuantityType("end", "coordinate", (), "slider or point"),
    QuantityType("time ratio", "", (), "slider, body or point"),
    QuantityType("work", "energy", (), "slider", GUIDE, sole=True),
    QuantityType("length", "coordinate", (), "size"),
    QuantityType("total length", "length", ()),
)


def _check_quantity(raw: object) -> object:
    check_name(raw, QUANTITIES, "not one of the choices")
    return raw


What = Annotated[str, BeforeValidator(_check_quantity)]
"""One of `QUANTITIES`."""
BACK = " on the way back"
"""What follows an extreme that occurs on the way back through a range."""
EXTREME = ("peak", "largest", "least")
"""Measures that a single position decides: as many rows as positions, rather than one figure."""


def _read_place(raw: object) -> Any:
    """Read a point by name, or two coordinates."""
    if raw is None or isinstance(raw, str):
        return raw
    parts = check_pair(raw, "expected a point or two coordinates", 'Write its name, or ["100 mm", "0 mm"]')
    return tuple(read_fixed(part, "coordinate").value for part in parts)


Place = Annotated[Any, BeforeValidator(_read_place)]


class TermSection(Section):
    """Keys of a term."""

    quantity: What | None = None
    """Quantity that is minimised."""
    of: str | None = None
    """Name of the pin, guide, slider, body, point or dimension to which the quantity belongs."""
    on: str | None = None
    """Body on which a reaction acts."""
    measure: Measure | None = None
    """Measure that reduces the values over the cycle to one number; default: the first one of the quantity."""
    static: bool = False
    """Whether the inertia of the bodies is excluded; weights and loads remain."""
    direction: FixedAngle | None = None
    """Direction of the stroke of a point, from +x."""
    stroke: Literal["forward", "backward", "slow", "quick"] | None = None
    """For an end, and for the work of a slider: the stroke, forward or backward. For a time ratio: the stroke whose time is
    divided by that of the other one; default: the slow one."""
    about: Place = None
    """Reference point of a shaking moment: a point of the frame, or two coordinates; default: the crank pivot."""
    over: AngleInterval | None = None
    """In `[balance]`: the range of crank angles that counts, for example `["90 deg", "180 deg"]`; default: all."""


class Term(TermSection):
    """A value computed from the cycle: a quantity, the element where it is evaluated, and the measure that reduces it."""

    quantity: What
    """Quantity of the cycle."""
    _whole: str = "per revolution"

    def counted(self, whole: str) -> None:
        """State over what the term is counted, in words: "over the range"."""
        self._whole = whole

    def check_keys(self) -> Self:
        """Check that the keys are consistent.

        Raises
        ------
        Unusable
            with the key below the term.
        """
        nature, what, a_what = self.nature, self.quantity, with_article(self.quantity)
        if self.measure is not None and not nature.cyclic:
            raise Unusable(f"{a_what} is one figure, it has no measure", "Leave it out", "measure", self.measure)
        if self.measure is None and nature.cyclic and len(nature.measures) > 1 and nature.measures[0] != "peak":
            remedy = f'Add measure = "{nature.measures[0]}" or "{nature.measures[1]}"'
            raise Unusable(f"the measure of {a_what} is missing", remedy, "measure")
        if self.measure is not None:
            check_name(self.measure, nature.measures, f"not a measure of {a_what}", "measure")
        if nature.of and self.of is None and not nature.sole and not nature.general:
            raise Unusable(f"the {nature.of} is missing", 'Add of = "..."', "of")
        if not nature.of and self.of is not None:
            raise Unusable(f"the {what} is that of the whole machine", "Leave it out", "of", self.of)
        if self.on is not None and what != "reaction":
            raise Unusable("only a reaction acts on a body", "Leave it out", "on", self.on)
        if self.static and not nature.forces:
            static = ", ".join(name for name, quantity in QUANTITIES.items() if quantity.forces)
            raise Unusable(f"{a_what} has no static part", f"Leave it out; only {static} have one", "static")
        if self.stroke is not None and what not in ("end", "time ratio") and (what != "work" or self.of is None):
            message = "only an end, a time ratio, and the work during a stroke of a slider refer to a stroke"
            raise Unusable(message, 'Write quantity = "work" and of', "stroke")
        if self.stroke in ("slow", "quick") and what != "time ratio":
            raise Unusable(f"{a_what} has its stroke by direction", 'Write "forward" or "backward"', "stroke", self.stroke)
        if (what == "end" or (what == "work" and self.of is not None)) and self.stroke is None:
            raise Unusable("the stroke is missing", 'Add stroke = "forward" or "backward"', "stroke")
        if self.about is not None and what != "shaking moment":
            raise Unusable(f"{a_what} has no reference point", "Leave it out; only a shaking moment has one", "about", self.about)
        if self.over is not None:
            low, high = self.over.bounds
            if not nature.cyclic:
                raise Unusable(f"{a_what} is one figure of the whole cycle", "Leave it out", "over", str(self.over))
            if not 0.0 < high - low < TURN:
                message = "a range of crank angles rises, by less than a turn"
                raise Unusable(message, 'Write for example over = ["300 deg", "420 deg"]', "over", str(self.over))
        return self

    _checked = model_validator(mode="after")(check_keys)

    @property
    def nature(self) -> QuantityType:
        """Properties of the quantity."""
        return QUANTITIES[self.quantity]

    @property
    def how(self) -> str:
        """The measure, with the default of the quantity; empty for a quantity with a single value."""
        return (self.measure or self.nature.measures[0]) if self.nature.cyclic else ""

    @property
    def extreme(self) -> bool:
        """Whether a single position determines the term."""
        return self.how in EXTREME

    @property
    def integral(self) -> bool:
        """Whether the term is an integral over the cycle."""
        return self.how in ("rms", "mean") or self.quantity == "work"

    @property
    def ended(self) -> bool:
        """Whether the term depends on the ends of an output's strokes."""
        return self.quantity in ("stroke", "end", "time ratio") or self.stroke is not None

    @property
    def by_pace(self) -> bool:
        """Whether the dimensions determine the direction of its stroke: a time ratio of the slow or the quick stroke."""
        return self.quantity == "time ratio" and self.stroke in (None, "slow", "quick")

    def __str__(self) -> str:
        return self.words

    @property
    def words(self) -> str:
        """Name of the term for display."""
        return f"{self.how} {self.subject}" if self.how else self.subject

    @property
    def subject(self) -> str:
        """Name of the term without its measure, for display."""
        words = f"{'static ' if self.static else ''}{self.quantity}"
        if self.quantity == "work":
            return words + (f" in the {self.stroke} stroke of {self.of}" if self.of else f" {self._whole}")
        if self.quantity == "end":
            along = f" along {self.direction}" if self.direction is not None else ""
            return f"end of the {self.stroke} stroke of {self.of}{along}"
        if self.quantity == "length":
            return str(self.of)
        if self.quantity == "total length":
            return "total length of the links"
        words += f" {self.nature.at} {self.of}" if self.of else ""
        words += f" on {self.on}" if self.on else ""
        words += f", {self.stroke} over {STROKES[self.stroke]}" if self.quantity == "time ratio" and self.stroke else ""
        words += f" along {self.direction}" if self.direction is not None else ""
        words += f" about {self.about}" if isinstance(self.about, str) else ""
        return words + ("" if self.over is None else " from {:.12g} to {:.12g} deg".format(*map(math.degrees, self.over.bounds)))

    def kind(self, mechanism: Mechanism) -> str:
        """Return the physical kind: the stroke of a rotating body is an angle, and a quantity of the file may be an angle."""
        if self.quantity == "stroke" and output_of(self, mechanism)[0] == "body":
            return "angle"
        return self.nature.kind


_NAME = r"[A-Za-z][\w.\-]*"
_NUMBER = r"[-+]?[.\d]+"


def read_words(text: str) -> dict[str, Any] | None:
    """Return the keys of the term that a text names as `Term.words` does, and its `sense` if it has one; None for another text.

    For example "rms reaction at B on ram", "maximise stroke of ram", "peak torque from 90 to 180 deg".
    """
    quantities = "|".join(sorted(QUANTITIES, key=len, reverse=True))
    match = re.fullmatch(
        rf"(?:(?P<sense>minimi[sz]e|maximi[sz]e)\s+)?(?:(?P<measure>{'|'.join(get_args(Measure))})\s+)?(?:(?P<static>static)\s+)?"
        rf"(?P<quantity>{quantities})(?:\s+(?:per\s+(?:revolution|cycle)|over\s+the\s+(?:range|stroke|motion)))?"
        r"(?:\s+(?:of|in)\s+the\s+(?P<stroke>forward|backward)\s+stroke)?"
        rf"(?:\s+(?:of|at|in)\s+(?P<of>{_NAME}))?(?:\s+on\s+(?P<on>{_NAME}))?(?:\s+about\s+(?P<about>{_NAME}))?"
        rf"(?:\s+from\s+(?P<low>{_NUMBER})(?:\s*(?:deg|°))?\s+to\s+(?P<high>{_NUMBER})\s*(?:deg|°))?"
        r"(?:\s+along\s+(?P<direction>\S.*))?",
        text,
        re.IGNORECASE,
    )
    if match is None:
        return None
    keys: dict[str, Any] = {key: value for key, value in match.groupdict().items() if value is not None}
    keys |= {key: keys[key].lower() for key in ("sense", "quantity", "measure", "stroke") if key in keys}
    if "sense" in keys:
        keys["sense"] = SPELLINGS.get(keys["sense"], keys["sense"])
    if "static" in keys:
        keys["static"] = True
    ends = [f"{keys.pop(side)} deg" for side in ("low", "high") if side in keys]
    return {**keys, "over": ends} if ends else keys


class Goal(Term):
    """A term of the objective: weight * value / scale."""

    weight: Annotated[
        Number,
        where(
            lambda w: w > 0.0, "a weight is positive", 'Give one above zero; `solve` makes a quantity large by sense = "maximise"'
        ),
    ] = 1.0
    """Weight of the term, positive."""
    scale: Any = None
    """Divisor that makes the term dimensionless, in the unit of the term; required with several terms."""
    sense: Literal["minimise", "maximise"] = "minimise"
    """Whether the value is minimised or maximised."""

    def check_sense(self) -> Self:
        """Check that a largest value is minimised and a least value maximised: raising one peak does not bound the others.

        Raises
        ------
        Unusable
        """
        possible = {"peak": "minimise", "largest": "minimise", "least": "maximise"}.get(self.how)
        if possible is not None and self.sense != possible:
            message = f"the {self.how} value over the cycle can only be {possible}d"
            raise Unusable(message, f'Write sense = "{possible}"', "sense", self.sense)
        return self

    _minimised = model_validator(mode="after")(check_sense)


def read_scale(goal: Goal, kind: str) -> float | None:
    """Return the scale of a term of a physical kind [SI]; None if the file gives none.

    Raises
    ------
    Unusable
        with the key below the term.
    """
    scale = None if goal.scale is None else read_figure(goal.scale, kind, "scale")[0]
    if scale is not None and scale <= 0.0:
        raise Unusable("a scale must be positive", "Give one above zero", "scale", goal.scale)
    return scale


class Objective(TermSection):
    """The objective: one term, or a weighted sum of several under `terms`."""

    sense: Literal["minimise", "maximise"] = "minimise"
    """Whether the value is minimised or maximised."""
    terms: tuple[Goal, ...] = ()
    """Instead of all keys above: the terms of a weighted sum."""

    @model_validator(mode="after")
    def _one_way(self) -> Self:
        keys = [key for key in type(self).model_fields if key != "terms" and key in self.model_fields_set]
        if self.terms and keys:
            raise Unusable("the objective is one term or a sum of terms", "Put all of them under [[objective.terms]]", keys[0])
        if not self.terms and self.quantity is None:
            raise Unusable("there is no objective", f'Add quantity = "torque"; known: {", ".join(QUANTITIES)}', "quantity")
        if not self.terms:
            _ = self.goals  # runs its checks
        return self

    @property
    def goals(self) -> tuple[Goal, ...]:
        """Terms of the sum."""
        if self.terms:
            return self.terms
        values = {key: getattr(self, key) for key in type(self).model_fields if key != "terms"}
        return (Goal.model_construct(weight=1.0, scale=None, **values).check_keys().check_sense(),)


class Limit(Term):
    """A term that must stay within bounds: `min`, `max` or both, or `exactly` a value."""

    min: Any = None
    """Lower bound, in the unit of the term."""
    max: Any = None
    """Upper bound, in the unit of the term."""
    exactly: Any = None
    """Prescribed value, instead of both bounds."""

    @model_validator(mode="after")
    def _bounded(self) -> Self:
        if self.min is None and self.max is None and self.exactly is None:
            example = f'"{KINDS[self.nature.kind].example}"' if self.nature.kind else "1.8"
            raise Unusable("the limit has no value", f"Add max = {example}, min or exactly", "max")
        if self.exactly is not None and (self.min is not None or self.max is not None):
            message = "exactly and min or max are given together"
            raise Unusable(message, "Give either exactly, or min and max", "exactly", self.exactly)
        if self.extreme:
            wrong, right = ("max", "min") if self.how == "least" else ("min", "max")
            for key in (wrong, "exactly"):
                if getattr(self, key) is not None:
                    message = f"the {self.how} value over the cycle can only be limited by {right}"
                    raise Unusable(message, f"Write {right}", key, getattr(self, key))
        return self

    def interval(self, mechanism: Mechanism, quantities: Mapping[str, Quantity]) -> Interval:
        """Return the bounds [SI]; `quantities` are those of the file.

        Raises
        ------
        Unusable
            with the key below the limit.
        """
        quantity = quantities.get(str(self.of)) if self.quantity == "length" else None
        kind = self.kind(mechanism) if quantity is None else quantity.kind
        stated = {key: getattr(self, key) for key in SIDES}
        sides = {key: read_figure(value, kind, key) for key, value in stated.items() if value is not None}
        low, high = (sides.get(key, sides.get("exactly")) for key in ("min", "max"))
        if low and high and low[0] > high[0]:
            raise Unusable("min is above max", "Exchange them", "min", self.min)
        for key, (value, _) in sides.items():
            if self.how == "peak" and value <= 0.0:
                raise Unusable("a limit of the largest magnitude must be positive", "Give a limit above zero", key, stated[key])
            if self.quantity == "time ratio":
                check_time_ratio(self.stroke, value, key, low and low[0], high and high[0])
            if self.quantity == "stroke":
                if value < 0.0 or (value == 0.0 and key != "min"):
                    raise Unusable("a stroke must be positive", "Give one above zero", key, stated[key])
                if key != "max" and value >= math.pi and mechanism.limits is None and self.of in rockers(mechanism):
                    message = "a rocker between crank and frame swings by less than 180 deg"
                    raise Unusable(message, 'Give less, for example "60 deg"', key, stated[key])
            most = {"transmission angle": 180.0, "pressure angle": 90.0, "cam pressure angle": 90.0}.get(self.quantity)
            if most is not None and not 0.0 < value < math.radians(most):
                raise Unusable("out of range", f'Give an angle between 0 and {most:g} deg, for example "45 deg"', key, str(value))
        first = next(iter(sides.values()))
        return Interval(low[0] if low else None, high[0] if high else None, kind or None, first[1])


def rockers(mechanism: Mechanism) -> list[str]:
    """Return the bodies that are pinned to the frame and swing with one link between them and the crank."""
    names = []
    for group in mechanism.groups:
        if len(pins := dict(group.outer_pins)) == 2:
            bodies = {body: mechanism.owners[pin] for body, pin in pins.items()}
            if any(mechanism.crank.body in owners for owners in bodies.values()):
                names += [body for body, owners in bodies.items() if FRAME in owners]
    return names


# --- elements named by `of` --------------------------------------------------------------------------------------------


def output_of(term: Term, mechanism: Mechanism) -> tuple[str, str]:
    """Return the output of a term: ("guide" | "body" | "point", name).

    Raises
    ------
    Unusable
        with the key below the term.
    """
    name = str(term.of)
    points = moving_points(mechanism)
    if name in points:
        if term.direction is None:
            raise Unusable("the stroke of a point needs a direction", 'Add a direction: direction = "0 deg"', "direction")
        return "point", name
    if term.direction is not None:
        raise Unusable("only the stroke of a point has a direction", "Leave it out", "direction", str(term.direction))
    guide = guide_of(name, mechanism)
    if guide is not None:
        return "guide", guide
    if name in mechanism.bodies:
        return "body", name
    names = [*mechanism.bodies, *(guide.name for guide in mechanism.guides), *points]
    raise Unusable("no such slider, body or point", nearest(name, names), "of", term.of)


def check_term(term: Term, mechanism: Mechanism, quantities: Mapping[str, Quantity]) -> None:
    """Check that the elements named by a term exist; `quantities` are those of the file.

    Raises
    ------
    Unusable
        with the key below the term.
    """
    what, name = term.quantity, str(term.of)
    if mechanism.limits is not None:
        _check_range(term, mechanism)
    if what in ("stroke", "end", "time ratio"):
        kind, body = output_of(term, mechanism)
        if kind == "body" and (what == "end" or (body == mechanism.crank.body and mechanism.limits is None)):
            why = "rotates, so it has no end of a stroke" if what == "end" else "turns fully, so it has no stroke"
            raise Unusable(f"{body} {why}", "Name a slider or a point", "of", term.of)
    elif term.direction is not None:
        raise Unusable("only the stroke of a point has a direction", "Leave it out", "direction", str(term.direction))
    element = None if term.of is None else term.nature.element
    if element is not None:
        names = list(element.names(mechanism))
        if name not in names and not (element is GUIDE and guide_of(name, mechanism)):
            none = "Leave it out" if term.nature.sole else "This machine has none"
            raise Unusable(element.missing, nearest(name, names) if names else none, "of", term.of)
    if isinstance(term.about, str):
        check_name(term.about, mechanism.ground, "not a point of the frame", "about")
    several = {"torque": turning_drives(mechanism), "power": mechanism.drives}.get(what, ())
    if term.of is None and len(several) > 1:
        remedy = f"Add of, one of: {', '.join(drive.name for drive in several)}"
        raise Unusable("several drives turn a body" if what == "torque" else "there are several drives", remedy, "of")
    if what == "drive force" and term.of is None and len(linear_drives(mechanism)) != 1:
        many = ", ".join(drive.name for drive in linear_drives(mechanism))
        message = "several slides and cylinders drive" if many else "no slide and no cylinder drives: the drive turns a body"
        raise Unusable(message, f"Add of, one of: {many}" if many else 'Write quantity = "torque"', "of" if many else "quantity")
    if term.on is not None:
        check_name(term.on, mechanism.pins[name], "the joint is not one of that body", "on")
    if what == "length":
        check_name(name, quantities, "no such dimension", "of", term.of)


def _check_range(term: Term, mechanism: Mechanism) -> None:
    """Refuse a term that has no value over a range of the drive.

    Raises
    ------
    Unusable
        with the key below the term.
    """
    what = term.quantity
    if what == "time ratio" or (what == "work" and term.of is not None):
        message = f"{with_article(what)} of a stroke belongs to a crank that turns fully, and the drive has a range"
        raise Unusable(message, "Leave drive.range out" + ", or of and stroke" * (what == "work"), "quantity", what)
    if mechanism.drives and term.over is not None:
        message = "the drive is no crank, so it has no crank angles"
        raise Unusable(message, "Leave it out, and state drive.range", "over", str(term.over))
    if term.over is not None and mechanism.limits is not None:
        (low, high), (begin, end) = term.over.bounds, mechanism.limits
        turns = TURN * math.ceil((begin - low) / TURN - 1e-9)
        if high + turns > end + 1e-9:
            message = "the drive does not move through all of this"
            remedy = f"Give angles from {math.degrees(begin):.6g} to {math.degrees(end):.6g} deg, or change drive.range"
            raise Unusable(message, remedy, "over", str(term.over))
    if what == "shaking moment" and mechanism.drives and term.about is None:
        message, remedy = "there is no crank pivot about which it acts", f'Add about = "{next(iter(mechanism.ground))}"'
        raise Unusable(message, remedy, "about")
    linear = linear_drives(mechanism) if not turning_drives(mechanism) else []
    if linear and what in ("torque", "lever arm"):
        remedy = 'Write "drive force", which is positive where the drive pushes' if what == "torque" else 'Write "velocity"'
        raise Unusable("a slide or cylinder drives, not a crank", remedy, "quantity", what)
