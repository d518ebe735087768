"""Quantities of a machine cycle that can be optimised or limited: one entry of `QUANTITIES` per value of the key `quantity`.

An entry contains the formula of the optimiser (`signal`, elementwise on floats, arrays and symbols) and, written separately, the
columns from which the validator reads it (`history`).
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol, TypeAlias

import numpy as np

from optlink.dynamics.dyad_balances import RemainingWrenches
from optlink.dynamics.inverse import Reactions, shaking
from optlink.dynamics.machine import Moving, slider_names
from optlink.io import Registry
from optlink.linkage.dyad_types import RPR, RRP, RRR, Transmitting, transmitting
from optlink.linkage.mechanism import Mechanism
from optlink.linkage.vector2d import Array, Value, Vector, cross, dot, magnitude, minus
from optlink.problem.mechanism import moving_points

if TYPE_CHECKING:
    from optlink.dynamics.columns import MotionColumns


class ElementTerm(Protocol):
    """A term, of which a quantity reads the name `of` its element, the body `on` which a reaction acts, the reference point."""

    @property
    def of(self) -> str | None:
        """Name of the element."""
        ...

    @property
    def on(self) -> str | None:
        """Name of the body."""
        ...

    @property
    def about(self) -> str | tuple[float, float] | None:
        """Reference point of a moment: a point of the frame or its coordinates [m]; None for the crank pivot."""
        ...


Signal: TypeAlias = Callable[[Moving, Reactions, ElementTerm], tuple[Value, ...]]
Course: TypeAlias = "Callable[[MotionColumns, ElementTerm], Array]"


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


PIN = Element(lambda mechanism: mechanism.pins, "no such pin joint")
GUIDE = Element(lambda mechanism: [guide.name for guide in mechanism.guides], "no such guide")
POINT = Element(moving_points, "no moving body has such a point")
JOINT = Element(lambda mechanism: [group.joint for group in transmitting(mechanism)], "no dyad has its transmission angle there")
_SIGNED = ("peak", "rms", "mean", "largest", "least")
_SIZE = ("peak", "rms")
_EXTREMES = ("least", "largest")


@dataclass(frozen=True)
class QuantityType:
    """Properties of a quantity.

    Parameters
    ----------
    kind : str
        Physical kind; empty for a plain number.
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
    """

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

    @property
    def cyclic(self) -> bool:
        """Whether it has a value at every crank angle."""
        return self.signal is not None

    @property
    def affine(self) -> bool:
        """Whether its signal is an affine function of the inertial parameters of the bodies: a force or a moment."""
        return self.cyclic and self.kind in ("force", "torque")


QUANTITIES: Registry[QuantityType] = Registry()


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
    return np.asarray(np.hypot(*(record.full(part) for part in force)))


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
    """Return the transmission angle of a dyad [rad], see `optlink.linkage.dyad_types.Transmitting`; 90 deg is best."""
    p, q = RemainingWrenches(moving, {}).directions(group, {})
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


def _lever_arm(record: MotionColumns, term: ElementTerm) -> Array:
    return np.asarray(np.abs(_column("v_m_s", of_slider=True)(record, term) / record.moving.motion.speed))


QUANTITIES |= {
    "torque": QuantityType(
        "torque",
        _SIGNED,
        signal=lambda moving, reactions, term: (reactions.torque,),
        history=lambda record, term: record["input.torque_Nm"],
        forces=True,
    ),
    "reaction": QuantityType(
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
    "guide force": QuantityType(
        "force",
        _SIGNED,
        "guide",
        GUIDE,
        lambda moving, reactions, term: (reactions.guides[_guide(moving, term)].normal,),
        _column("normal_N"),
        forces=True,
        at="in",
    ),
    "guide moment": QuantityType(
        "torque",
        _SIGNED,
        "guide",
        GUIDE,
        lambda moving, reactions, term: (reactions.guides[_guide(moving, term)].moment,),
        _column("moment_Nm"),
        forces=True,
        at="in",
    ),
    "shaking force": QuantityType(
        "force",
        _SIZE,
        signal=lambda moving, reactions, term: shaking(moving).force,
        history=_size("frame.shaking_fx_N", "frame.shaking_fy_N"),
        vector=True,
    ),
    "shaking moment": QuantityType(
        "torque",
        _SIGNED,
        signal=_shaking_moment,
        history=_shaking_moment_measured,
    ),
    "velocity": QuantityType(
        "velocity",
        _SIZE,
        "moving point",
        POINT,
        lambda moving, reactions, term: moving.velocity(str(term.of)),
        _size("{}.vx_m_s", "{}.vy_m_s"),
        vector=True,
    ),
    "acceleration": QuantityType(
        "acceleration",
        _SIZE,
        "moving point",
        POINT,
        lambda moving, reactions, term: moving.acceleration(str(term.of)),
        _size("{}.ax_m_s2", "{}.ay_m_s2"),
        vector=True,
    ),
    "transmission angle": QuantityType(
        "angle",
        _EXTREMES,
        "joint of a dyad",
        JOINT,
        lambda moving, reactions, term: (_transmission_angle(moving, _groups(moving, term)[0]),),
        lambda record, term: _measured(record, _groups(record.moving, term)[0]),
        at="at",
    ),
    "pressure angle": QuantityType(
        "angle", ("peak",), "joint of a dyad", JOINT, _pressure, _pressure_measured, general=True, at="at"
    ),
    "slide": QuantityType(
        "coordinate",
        _EXTREMES,
        "guide",
        GUIDE,
        lambda moving, reactions, term: (moving.slides[_guide(moving, term)][0],),
        _column("s_m", of_slider=True),
        at="in",
    ),
    "lever arm": QuantityType(
        "length",
        _SIZE,
        "guide",
        GUIDE,
        lambda moving, reactions, term: (moving.slides[_guide(moving, term)][1] / moving.motion.speed,),
        _lever_arm,
    ),
    "stroke": QuantityType("length", (), "slider, body or point"),
    "end": QuantityType("coordinate", (), "slider or point"),
    "time ratio": QuantityType("", (), "slider, body or point"),
    "work": QuantityType("energy", (), "slider", GUIDE),
    "length": QuantityType("coordinate", (), "size"),
    "total length": QuantityType("length", ()),
}
