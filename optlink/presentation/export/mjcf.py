"""A machine as a model of MuJoCo (MJCF): bodies, hinges and slides; a loop is closed by an equality constraint.

The plane of the machine is x-z in MuJoCo: x stays, y points along z. All bodies are in the pose in which the motion starts, and
there every joint is at zero.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import numpy as np

from optlink.dynamics.machine import Force, Load, SlideDamper, Spring, Torque, TorsionSpring
from optlink.errors import InputError
from optlink.linkage.bodies import FRAME, Guide
from optlink.linkage.vector2d import TURN
from optlink.presentation.shapes import plain
from optlink.problem.machine.loads import Constant
from optlink.tasks.analyze import Analysis

STEPS = 6000
"""Time steps per revolution."""
IMPEDANCE = 0.9999
"""Of the constraints, the largest that MuJoCo takes: they yield least."""
GAIN = 30.0
"""Gain of the drive over the inertia of the flywheel per time step; its torque is late by 1 + 1 / `GAIN` time steps."""
FLYWHEEL = 1e4
"""Inertia of a flywheel on the crank over that of the machine: it holds the speed, and at constant speed takes no torque."""
Attributes = dict[str, str]


@dataclass(frozen=True)
class Hinge:
    """A pin between two bodies."""

    name: str
    point: str
    bodies: tuple[str, str]


@dataclass(frozen=True)
class Slide:
    """A guide between two bodies."""

    guide: Guide

    @property
    def name(self) -> str:
        """Name of the guide."""
        return self.guide.name

    @property
    def bodies(self) -> tuple[str, str]:
        """The slider and the body on which it slides."""
        return self.guide.bodies


def mjcf(cycle: Analysis, at: float) -> str:
    """Return the model of a machine whose motion starts at a crank angle [rad].

    Raises
    ------
    InputError
        If MuJoCo has no counterpart for a part of the machine, or the machine cannot be assembled over the whole turn.
    """
    for what, remedy, key in _without_counterpart(cycle):
        raise InputError(f"MuJoCo has no counterpart for {what}", remedy, cycle.problem.file, key)
    with np.errstate(all="ignore"):
        kinetic = cycle.machine.moving([at, *cycle.positions], cycle.speed).kinetic
    if not np.all(np.isfinite(kinetic)):
        message = "the design cannot be assembled over the whole turn, or passes a dead centre"
        raise InputError(message, "Change a length a little", cycle.problem.file, "mechanism")
    return _Model(cycle, at, float(np.max(kinetic))).text()


class _Model:
    """A machine in the pose in which its motion starts, with a tree of its joints."""

    def __init__(self, cycle: Analysis, at: float, kinetic: float) -> None:
        self.kinetic, self.cycle, self.machine, self.mechanism = kinetic, cycle, cycle.machine, cycle.machine.mechanism
        self.moving = self.machine.moving([at], cycle.speed)
        self.size = float(self.machine.size)
        self.world, self.tendons = Element("worldbody"), Element("tendon")
        self.parents: dict[str, tuple[str, Hinge | Slide]] = {}
        self.loops = self._span()
        self.tree = {body: [child for child, (parent, _) in self.parents.items() if parent == body] for body in self.bodies}

    @property
    def bodies(self) -> tuple[str, ...]:
        """The frame and the moving bodies."""
        return FRAME, *self.mechanism.bodies

    def _joints(self) -> Iterator[Hinge | Slide]:
        """Yield the joints, the guides first: MuJoCo closes loops by pins alone; then the pin of the crank."""
        yield from map(Slide, self.mechanism.guides)
        pins = self.mechanism.pins
        for point in sorted(pins, key=lambda point: point != self.mechanism.crank.start):
            first, *others = pins[point]
            for body in others:
                yield Hinge(point if len(others) == 1 else f"{point}.{body}", point, (first, body))

    def _span(self) -> list[Hinge]:
        """Find the tree of joints from the frame; return the pins that close its loops."""
        part, chosen, loops = {body: body for body in self.bodies}, list[Hinge | Slide](), list[Hinge]()
        for joint in self._joints():
            one, other = (part[body] for body in joint.bodies)
            if one == other:
                assert isinstance(joint, Hinge)  # no group has a loop of guides alone
                loops.append(joint)
                continue
            chosen.append(joint)
            part = {body: one if of == other else of for body, of in part.items()}
        reached = [FRAME]
        for parent in reached:
            for joint in [joint for joint in chosen if parent in joint.bodies]:
                chosen.remove(joint)
                child = next(body for body in joint.bodies if body != parent)
                self.parents[child] = parent, joint
                reached.append(child)
        return loops

    def place(self, body: str) -> tuple[complex, complex]:
        """Return the start of a body and its x axis, as complex numbers."""
        state = self.moving.state(body)
        return _complex(state.start), _complex(state.axis)

    def local(self, body: str, point: str) -> complex:
        """Return the place of a point in the axes of a body."""
        return _complex(self.moving.pose.local(body, point))

    def points(self, body: str) -> list[str]:
        """Return the points of a body."""
        return [point for point, owners in self.mechanism.owners.items() if body in owners]

    @cached_property
    def heaviest(self) -> float:
        """Largest mass of a body [kg]."""
        return max(float(inertia.mass) for inertia in self.machine.inertias.values())

    # --- the elements

    def text(self) -> str:
        """Return the model as text."""
        root = Element("mujoco", model=self.cycle.problem.model.title)
        root.append(
            ElementTree.Comment(
                " The plane of the machine is x-z; SI units, angles in rad. Load the keyframe 'start' first. The torque of the "
                "drive is the force of the actuator 'drive', which is that of one time step before. The armature of the crank "
                "is a flywheel, which takes no torque at constant speed: remove it before another drive. "
            )
        )
        step = TURN / abs(self.cycle.speed) / STEPS
        SubElement(root, "compiler", angle="radian", autolimits="true")
        option = {"integrator": "implicitfast", "timestep": _text(step), "gravity": _vector(_complex(self.machine.gravity))}
        option |= {"solver": "Newton", "tolerance": "1e-14", "iterations": "50"}
        SubElement(SubElement(root, "option", option), "flag", contact="disable")
        settings = {"solref": f"{_text(2.0 * step)} 1", "solimp": f"{IMPEDANCE} {IMPEDANCE} {_text(1e-3 * self.size)} 0.5 2"}
        SubElement(SubElement(root, "default"), "equality", settings)
        root.append(self.world)
        self._fill(self.world, FRAME)
        equality = SubElement(root, "equality")
        for loop in self.loops:
            sites = {f"site{end}": f"{body}.{loop.point}" for end, body in enumerate(loop.bodies, 1)}
            SubElement(equality, "connect", {"name": loop.name, **sites})
        root.append(self.tendons)
        actuators = SubElement(root, "actuator")
        gain = {"kv": _text(GAIN * self.flywheel / step), "joint": self.parents[self.mechanism.crank.body][1].name}
        SubElement(actuators, "velocity", {"name": "drive", **gain})
        for load in self.machine.loads:
            acts = ACTUATORS[type(load)](self, load)
            SubElement(actuators, "general", {"name": load.name, "gainprm": "0", "biastype": "affine", **acts})
        if not len(self.tendons):
            root.remove(self.tendons)
        rates = " ".join(map(_text, self._rates(FRAME)))
        control = " ".join([_text(self.cycle.speed), *("0" for _ in self.machine.loads)])
        SubElement(SubElement(root, "keyframe"), "key", name="start", qvel=rates, ctrl=control)
        ElementTree.indent(root)
        return ElementTree.tostring(root, encoding="unicode") + "\n"

    def _fill(self, element: Element, body: str) -> None:
        """Add the points of a body, its shape, and the bodies that hang on it."""
        points = self.points(body)
        for point in points:
            SubElement(
                element, "site", name=f"{body}.{point}", pos=_vector(self.local(body, point)), size=_text(0.006 * self.size)
            )
        for point in points if body != FRAME else ():
            end, shape = self.local(body, point), {"type": "sphere", "size": _text(0.012 * self.size)}
            if abs(end) > 0.0:
                shape |= {"type": "capsule", "fromto": f"0 0 0 {_vector(end)}"}
            SubElement(element, "geom", shape | {"mass": "0"})
        (start, axis), joints = self.place(body), self.tree[body]
        for child in joints:
            (to, along), (_, joint) = self.place(child), self.parents[child]
            turned = f"0 -1 0 {_text(float(np.angle(along / axis)))}"
            inner = SubElement(element, "body", name=child, pos=_vector((to - start) / axis), axisangle=turned)
            self._inertia(inner, child)
            if isinstance(joint, Hinge):
                way = {"type": "hinge", "pos": _vector(self.local(child, joint.point)), "axis": "0 -1 0"}
            else:
                line = _complex(self.moving.line(joint.name)) / along
                # of a line that moves on its slider the coordinate is the slide of this, too
                way = {"type": "slide", "axis": _vector(line if child == joint.guide.slider else -line)}
            if child == self.mechanism.crank.body:
                way["armature"] = _text(self.flywheel)
            SubElement(inner, "joint", {"name": joint.name, **way})
            self._fill(inner, child)

    def _inertia(self, element: Element, body: str) -> None:
        """Add the mass of a body; a crank without one gets one at its pivot, which is without effect at constant speed."""
        mass = self.machine.inertias.get(body)
        if mass is None or float(mass.mass) == 0.0:
            at, size, moment = 0j, self.heaviest, self.heaviest * (0.01 * self.size) ** 2
        else:
            at, size, moment = complex(float(mass.along), float(mass.across)), float(mass.mass), float(mass.moment)
        moment = moment or size * (1e-4 * self.size) ** 2  # MuJoCo needs one
        values = {"pos": _vector(at), "mass": _text(size), "diaginertia": " ".join([_text(moment)] * 3)}
        SubElement(element, "inertial", values)

    @cached_property
    def flywheel(self) -> float:
        """Inertia of a flywheel on the crank [kg m^2], large beside the inertia of the machine and its torque."""
        speed, torque = abs(self.cycle.speed), self.cycle["input.torque_Nm"]
        return FLYWHEEL * (2.0 * self.kinetic + float(np.max(np.abs(torque[np.isfinite(torque)]), initial=0.0))) / speed**2

    def _rates(self, body: str) -> Iterator[float]:
        """Yield the rates of the joints at the start, in the order of MuJoCo."""
        for child in self.tree[body]:
            joint = self.parents[child][1]
            if isinstance(joint, Hinge):
                yield float(np.squeeze(self.moving.state(child).omega - self.moving.state(body).omega))
            else:
                yield float(np.squeeze(self.moving.slides[joint.name][1]))
            yield from self._rates(child)

    def angle(self, name: str, body: str, against: str) -> Attributes:
        """Add the angle of a body relative to another, as a tendon of the hinges between them and the frame."""
        sums: dict[str, int] = {}
        for end, sign in ((body, 1), (against, -1)):
            while end != FRAME:
                end, joint = self.parents[end]
                if isinstance(joint, Hinge):
                    sums[joint.name] = sums.get(joint.name, 0) + sign
        fixed = SubElement(self.tendons, "fixed", name=name)
        for joint_name, sign in sums.items():
            if sign:
                SubElement(fixed, "joint", joint=joint_name, coef=str(sign))
        return {"tendon": name}


def without_full_turn(cycle: Analysis) -> Iterator[tuple[str, str, str]]:
    """Yield what of a machine is not a crank that turns at constant speed and moves pins and guides."""
    mechanism = cycle.machine.mechanism
    if mechanism.drives:
        yield "a drive other than a crank at constant speed", 'Drive a body pinned to the frame: speed = "60 rpm"', "drive"
    if cycle.static:
        yield "a drive without inertia", 'Give a speed: drive.speed = "60 rpm"', "drive.speed"
    if not cycle.full:
        yield "a crank that does not turn fully", "Change sizes or drive so that it turns fully", "drive"
    if mechanism.followed:
        yield "a motion through change points", "Change a length a little", "mechanism"
    for element in mechanism.elements:
        yield f"{element.name} ({element.kind})", "Export a machine without gears, racks and cams", "mechanism"


def _without_counterpart(cycle: Analysis) -> Iterator[tuple[str, str, str]]:
    """Yield what of a machine MuJoCo has no counterpart for, with the remedy and the key of the file."""
    yield from without_full_turn(cycle)
    machine = cycle.machine
    mechanism = machine.mechanism
    for name, friction in machine.friction.items():
        if np.any(friction):
            yield f"friction in the guide {name}", "Set it to zero", f"mechanism.guides.{name}.friction"
    for body in mechanism.bodies:
        if body != mechanism.crank.body and not (body in machine.inertias and float(machine.inertias[body].mass) > 0.0):
            inertia = ', inertia = "uniform bar"' if mechanism.bodies[body].end else ""
            remedy = f'Give it one: {body} = {{ mass = "1 kg"{inertia} }}'
            yield f"the body {body} without a mass", remedy, f"bodies.{body}"
    if not any(float(inertia.mass) > 0.0 for inertia in machine.inertias.values()):
        yield "a machine without masses", 'Give its bodies masses: crank = { mass = "1 kg", inertia = "uniform bar" }', "bodies"
    for load in machine.loads:
        names = ["magnitude", "push"]
        sizes = [size for size in (getattr(load, name, None) for name in names) if size is not None]
        if type(load) not in ACTUATORS or load.switching or any(type(size) is not Constant for size in sizes):
            remedy = "Leave it out, or make it a constant force or torque, or a spring"
            yield f"the load {load.name}, which is not constant or linear", remedy, f"loads.{load.name}"
        elif load.name == "drive":
            yield 'a load called "drive" beside the drive', "Give it another name", "loads.drive"
    if "world" in mechanism.bodies:
        yield 'a body called "world", which is its frame', "Give it another name", "mechanism"


# Every load is an actuator with the force c + k l + d dl/dt over a length or angle l: its attributes, by the kind of load.


def _force(model: _Model, load: Force) -> Attributes:
    """Along the guide the force acts on its joint; else on a point, against the origin of the frame."""
    guides = {guide.name: guide.on for guide in model.mechanism.guides}
    if load.against != guides.get(load.guide, FRAME):
        message = f"MuJoCo has no counterpart for the load {load.name}, whose reaction acts on {load.against}"
        raise InputError(message, "Leave it out, or make it a spring", model.cycle.problem.file, f"loads.{load.name}")
    if load.guide:
        return {"joint": load.guide, **_bias(_size(load))}
    (acting,) = load.act(model.moving)
    SubElement(model.world, "site", name=load.name, pos="0 0 0")
    return {
        "site": f"{load.body}.{load.point}",
        "refsite": load.name,
        "gear": f"{_vector(_complex(acting.force))} 0 0 0",
        **_bias(1.0),
    }


def _torque(model: _Model, load: Torque) -> Attributes:
    return {**model.angle(load.name, load.body, load.against), **_bias(_size(load))}


def _spring(model: _Model, load: Spring) -> Attributes:
    spatial = SubElement(model.tendons, "spatial", name=load.name)
    for body, point in load.ends:
        SubElement(spatial, "site", site=f"{body}.{point}")
    push = load.push({}) if load.push is not None else 0.0
    k, d = float(load.stiffness), float(load.damping)
    return {"tendon": load.name, **_bias(k * float(load.free) + float(push), -k, -d)}


def _torsion_spring(model: _Model, load: TorsionSpring) -> Attributes:
    k, d = float(load.stiffness), float(load.damping)
    torque = next(load.act(model.moving)).torque + d * (
        model.moving.state(load.body).omega - model.moving.state(load.against).omega
    )
    return {**model.angle(load.name, load.body, load.against), **_bias(float(np.squeeze(torque)), -k, -d)}


def _damper(model: _Model, load: SlideDamper) -> Attributes:
    return {"joint": load.guide, **_bias(0.0, 0.0, -float(load.damping))}


ACTUATORS: Mapping[type[Load], Callable[[_Model, Any], Attributes]] = {
    Force: _force,
    Torque: _torque,
    Spring: _spring,
    TorsionSpring: _torsion_spring,
    SlideDamper: _damper,
}
"""Kinds of loads that MuJoCo has a counterpart for."""


def _size(load: Force | Torque) -> float:
    return float(load.magnitude({}))


def _bias(constant: float, of_length: float = 0.0, of_rate: float = 0.0) -> Attributes:
    return {"biasprm": " ".join(map(_text, (constant, of_length, of_rate)))}


def _complex(vector: Any) -> complex:
    return complex(*plain(vector))


def _vector(at: complex) -> str:
    return f"{_text(at.real)} 0 {_text(at.imag)}"


def _text(value: float) -> str:
    return f"{value + 0.0:.17g}"
