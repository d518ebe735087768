"""Elements of a linkage beside links and guides: cylinders, pins in slots, gears, racks, belts and cams, as sections of a file.

Each is an entry that builds its part of the mechanism, and says itself what a file must state for it.
"""

import math
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import replace
from fractions import Fraction
from typing import Annotated, Any, Literal, NamedTuple, Self

import numpy as np
from pydantic import BeforeValidator, model_validator

from optlink.dynamics.machine import Inertia
from optlink.linkage.bodies import FRAME, Size
from optlink.linkage.elements import PRESSURE, Cam, Element, Gear, Rack, key_of
from optlink.linkage.mechanism import Guide, Link, Mechanism, Pose
from optlink.linkage.motion import sweep
from optlink.linkage.trains import determinant
from optlink.linkage.vector2d import TURN, cross, dot, minus
from optlink.problem.base_model import Name, Section
from optlink.problem.machine.drives import CamLaw, read_cam_law
from optlink.problem.quantity import (
    BOTH,
    Angle,
    Coordinate,
    FixedAngle,
    FixedLength,
    Length,
    Mass,
    Quantity,
    Ratio,
    Unusable,
    below,
    check_name,
    check_pair,
    read_positive,
    read_quantity,
    read_scalar,
    reader,
    states,
    where,
)
from optlink.units import measures

PHASE = Quantity(0.0, "angle", "deg")
_SLANT = where(
    lambda angle: 0.0 <= angle < math.radians(60.0), "no teeth have such a pressure angle", 'Give for example "20 deg"'
)
PressureAngle = Annotated[FixedAngle, _SLANT]
TEETH = Quantity(PRESSURE, "angle", "deg")


class Parts(NamedTuple):
    """The bodies, points and guides of a linkage, to which elements refer by name."""

    pose: Pose
    """Sizes of the file, without a position."""
    members: Mapping[str, Collection[str]]
    """Points with the bodies that share them."""

    @property
    def links(self) -> Mapping[str, Link]:
        """The bodies."""
        return self.pose.mechanism.bodies

    @property
    def guides(self) -> Mapping[str, Guide]:
        """The guides."""
        return {guide.name: guide for guide in self.pose.mechanism.guides}

    def body(self, name: str, key: str) -> str:
        """Return the name of a body or of the frame; refuse any other."""
        check_name(name, [*self.links, FRAME], "no such body", key)
        return name

    def pin(self, one: str, other: str) -> str | None:
        """Return the pin that joins two bodies; None if there is none."""
        return next((point for point, bodies in self.members.items() if {one, other} <= set(bodies)), None)

    def guide(self, slider: str, key: str) -> Guide:
        """Return the guide in which a body slides; refuse a body without one."""
        found = [guide for guide in self.guides.values() if guide.slider == slider]
        if len(found) != 1:
            message = f"{slider} slides in no guide" if not found else f"{slider} slides in several guides"
            raise Unusable(message, "Give it one guide under [mechanism.guides]", key, slider)
        return found[0]


def _read_pair(raw: object) -> Any:
    pair = check_pair(raw, "two bodies are needed", 'Write bodies = ["crank", "wheel"]')
    if not all(isinstance(name, str) for name in pair) or pair[0] == pair[1]:
        raise Unusable("two bodies are needed", 'Write bodies = ["crank", "wheel"]', "", raw)
    return tuple(pair)


Pair = Annotated[tuple[str, str], BeforeValidator(_read_pair)]


def _read_teeth(raw: object) -> object:
    if isinstance(raw, list | tuple) and any(isinstance(count, dict) for count in raw):
        remedy = 'Give ratio = "-3..-1" in place of teeth, and choose the teeth by the ratio that is found'
        raise Unusable("numbers of teeth are whole numbers, which cannot be design variables", remedy, "", raw)
    return raw


def _read_lift(raw: object) -> Quantity | None:
    """Read the lift of a cam: an angle if one of its values has a unit of angle, else a length."""
    if raw is None:
        return None
    table: dict[str, Any] = raw if isinstance(raw, dict) else {"start": raw}
    angular = any(measures(text, "angle") for text in (table.get("start"), *(table.get("bounds") or ())) if isinstance(text, str))
    return read_quantity(raw, "angle" if angular else "length")


def named(section: Section, name: str, key: str, default: float = 0.0) -> Size:
    """Return the name of a dimension of an entry that states it; else its default value."""
    return f"{name}.{key}" if states(section, key) and getattr(section, key) is not None else default


def _read_joints(raw: object) -> Any:
    pair = check_pair(raw, "two joints are needed", 'Write joints = ["D", "B"]: that of the barrel, then that of the rod')
    return tuple(pair)


class CylinderPart(Section):
    """Mass properties of the barrel or the rod of a cylinder."""

    mass: Mass
    """Mass of the part."""
    centroid: FixedLength | None = None
    """Distance of its centroid from its own joint, towards the other one; default: 0."""
    inertia: Annotated[Quantity | None, reader(read_positive, "moment of inertia")] = None
    """Moment of inertia about its centroid; default: 0."""

    def inertia_of(self, way: float) -> Inertia:
        """Return the mass properties in axes that begin at its joint; `way` is 1 if x points to the other joint, else -1."""
        along = 0.0 if self.centroid is None else way * self.centroid.value
        return Inertia(self.mass.value, along, 0.0, 0.0 if self.inertia is None else self.inertia.value)


class CylinderSection(Section):
    """A cylinder, spindle or gas strut between two joints: a link whose length lies between two values."""

    joints: Annotated[tuple[Name, Name], BeforeValidator(_read_joints)]
    """Names of the joint of the barrel and the joint of the rod."""
    closed: Length
    """Least distance of the joints."""
    open: Length
    """Largest distance of the joints."""
    barrel: CylinderPart | None = None
    """Mass properties of the barrel; default: none."""
    rod: CylinderPart | None = None
    """Mass properties of the rod; default: none."""

    def inertias(self, name: str) -> dict[str, Inertia]:
        """Return the mass properties of barrel and rod by the names of the bodies."""
        parts = ((name, self.barrel, 1.0), (f"{name}.rod", self.rod, -1.0))
        return {body: part.inertia_of(way) for body, part, way in parts if part is not None}

    def link(self, name: str) -> Link:
        """Return the link of the cylinder.

        Raises
        ------
        Unusable
            with the key below the cylinder.
        """
        if self.open.value <= self.closed.value:
            raise Unusable("an open cylinder is longer than a closed one", "Exchange the two", "open", str(self.open))
        return Link(name, *self.joints, f"{name}.length")


class SlotSection(Section):
    """A pin of one body in a straight slot of another."""

    pin: Name
    """The pin, a joint or point of a body."""
    on: str = FRAME
    """The body with the slot."""
    through: str | None = None
    """A point of that body on the middle line of the slot; default: its first joint."""
    direction: Angle | None = None
    """Angle of the slot relative to the x axis of that body; default: 0."""


class GearSection(Section):
    """Two gears, or two bodies whose angles are in a fixed ratio in another way."""

    bodies: Pair
    """The two bodies; the frame for a fixed gear."""
    teeth: Annotated[tuple[int, int], BeforeValidator(_read_teeth)] | None = None
    """Numbers of teeth of both."""
    ratio: Ratio | None = None
    """Instead of the teeth: speed of the second body over that of the first, negative if they turn in opposite senses."""
    internal: bool = False
    """Whether one of the gears is a ring with internal teeth: they turn in the same sense."""
    arm: str = FRAME
    """The body that carries both pivots: the frame, or the carrier of a planetary train."""
    phase: Angle = PHASE
    """Angle of the second body where that of the first is zero, both relative to the arm."""
    module: FixedLength | None = None
    """Module: with the teeth it states the distance of the pivots, which is checked."""
    pressure_angle: PressureAngle = TEETH
    """Pressure angle of the teeth."""

    @model_validator(mode="after")
    def _determined(self) -> Self:
        if (self.teeth is None) == (self.ratio is None):
            message = "the ratio of the gears is stated twice" if self.teeth else "the ratio of the gears is not determined"
            raise Unusable(message, "Give teeth = [20, 60], or ratio = -0.333", "teeth")
        if self.teeth is not None and min(self.teeth) < 1:
            raise Unusable("a gear has teeth", "Give two whole numbers above zero", "teeth", list(self.teeth))
        low, high = (0.0, 0.0) if self.ratio is None or not self.ratio.free else self.ratio.bounds
        if low < high and (low <= 0.0 <= high or low <= 1.0 <= high):
            message = "the senses of rotation, or of the relative rotation, would differ from design to design"
            remedy = "Give bounds that are both below 0, both between 0 and 1, or both above 1"
            raise Unusable(message, remedy, "ratio", str(self.ratio))
        if self.ratio is not None and (self.internal or self.module is not None):
            key = "internal" if self.internal else "module"
            raise Unusable(f"{key} belongs to teeth", "Give teeth instead of ratio, or leave it out", key)
        return self

    def coupling(self, name: str, parts: Parts) -> Element:
        """Return the coupling of the two bodies."""
        for body in self.bodies:
            parts.body(body, "bodies")
        parts.body(self.arm, "arm")
        ratio = 0.0 if self.ratio is None else self.ratio.value
        if self.teeth is not None:
            ratio = self.teeth[0] / self.teeth[1] * (1.0 if self.internal else -1.0)
        pivots = [parts.pin(body, self.arm) for body in self.bodies]
        if self.arm != FRAME and FRAME in self.bodies:  # the axis of a fixed gear is the pivot of the arm
            pivots[self.bodies.index(FRAME)] = parts.pin(self.arm, FRAME)
        both = (pivots[0], pivots[1]) if pivots[0] and pivots[1] and pivots[0] != pivots[1] else None
        if self.teeth is not None and both is None:
            where_ = "the frame" if self.arm == FRAME else self.arm
            message = f"both gears turn about pivots on {where_}, and {' and '.join(self.bodies)} have none there"
            raise Unusable(
                message, "Name the body that carries both pivots: arm = ..., or give ratio instead of teeth", "arm", self.arm
            )
        stated = self.distance()
        if stated is not None and both is not None:
            apart = float(np.hypot(*minus(*(parts.pose.local(self.arm, pivot) for pivot in both))))
            if abs(stated - apart) > 1e-6 * apart:
                message = f"module and teeth put the axes {1e3 * stated:.6g} mm apart, but they are {1e3 * apart:.6g} mm apart"
                raise Unusable(message, "Change the module, the teeth or the pivots", "module", str(self.module))
        if self.teeth is not None and ratio == 1.0:
            raise Unusable("a ring has more teeth than the gear in it", "Change the teeth", "teeth", list(self.teeth))
        pivoted, mesh = both if ratio != 1.0 else None, self.teeth is not None or ratio < 0.0
        size, phase = ratio if self.ratio is None else f"{name}.ratio", named(self, name, "phase")
        return Gear(name, self.bodies, size, phase, self.arm, pivoted, self.pressure_angle.value, mesh=mesh)

    def distance(self) -> float | None:
        """Return the distance of the pivots [m] that module and teeth state; None without them."""
        if self.module is None or self.teeth is None:
            return None
        first, second = self.teeth
        return 0.5 * self.module.value * (abs(second - first) if self.internal else first + second)


class RackSection(Section):
    """A rack and its pinion, or a sector."""

    pinion: str
    """The body with the gear."""
    rack: str
    """The body with the rack, which slides in a guide, or on which the body that carries the pinion slides: "frame"."""
    radius: Length
    """Pitch radius of the pinion."""
    side: Literal["left", "right"] | None = None
    """Side of the rack, along its guide, on which the pivot of the pinion lies; default: as drawn, unless the rack is fixed."""
    phase: Coordinate | None = None
    """Slide of the rack, less that of the pinion, where the angle of the pinion is zero; default: 0."""
    pressure_angle: PressureAngle = TEETH
    """Pressure angle of the teeth."""

    def coupling(self, name: str, parts: Parts) -> Element:
        """Return the coupling of rack and pinion."""
        check_name(self.pinion, parts.links, "no such body", "pinion")
        parts.body(self.rack, "rack")
        paths = (guide for guide in parts.guides.values() if guide.slider != self.pinion)
        path = next((guide for guide in paths if parts.pin(self.pinion, guide.slider)), None)
        fixed = path is not None and path.on == self.rack  # the pivot slides on the body with the rack
        guide = None if fixed else parts.guide(self.rack, "rack")
        on, way = self.rack if guide is None else guide.on, 1.0
        pivot = parts.pin(self.pinion, on)
        if pivot is None and path is not None and path.on == on:
            pivot = parts.pin(self.pinion, path.slider)
        else:
            path = None
        if pivot is None:
            message = f"the pinion turns about a pivot on the body with the guide of the rack, {on}, and has none there"
            raise Unusable(
                message,
                "Pin it to that body or to one that slides on it, or guide the rack on the body that carries the pinion",
                "pinion",
                self.pinion,
            )
        place = parts.pose.local(on, pivot) if path is None else parts.pose.local_line(path, on)[0]
        drawn = 0.0
        if guide is not None:
            begin, line = parts.pose.local_line(guide, on)
            drawn = float(cross(line, minus(place, begin)))
            way = 1.0 if path is None else float(dot(line, parts.pose.local_line(path, on)[1]))
        if abs(abs(way) - 1.0) > 1e-9:
            message = "the pinion does not slide along the rack: their guides are not parallel"
            raise Unusable(message, "Give both guides one direction", "rack", self.rack)
        if self.side is None and guide is None:
            message = "a fixed rack lies on either side of the path of its pinion"
            raise Unusable(message, 'Add side = "left" if the pinion is to the left of the rack, else "right"', "side")
        side = -1 if self.side == "right" or (self.side is None and drawn < 0.0) else 1
        phase, angle = named(self, name, "phase"), self.pressure_angle.value
        return Rack(name, self.pinion, guide, f"{name}.radius", pivot, side, phase, angle, path, round(way))


class BeltSection(Section):
    """A belt or chain on two wheels, without slip; its slack strand pulls nothing."""

    bodies: Pair
    """The two bodies with the wheels."""
    diameters: tuple[Length, Length] | None = None
    """Pitch diameters of the wheels."""
    radii: tuple[Length, Length] | None = None
    """Instead of the diameters: pitch radii."""
    crossed: bool = False
    """Whether the belt is crossed: the wheels turn in opposite senses."""
    arm: str = FRAME
    """The body that carries both pivots."""
    phase: Angle = PHASE
    """Angle of the second body where that of the first is zero, both relative to the arm."""

    def coupling(self, name: str, parts: Parts) -> Element:
        """Return the coupling of the two bodies."""
        if (self.diameters is None) == (self.radii is None):
            message = "the sizes of the wheels are stated twice" if self.radii else "the wheels have no size"
            raise Unusable(message, 'Give diameters = ["60 mm", "180 mm"], or radii', "diameters")
        sizes = self.radii or self.diameters or ()
        first, second = (size.value * (1.0 if self.radii else 0.5) for size in sizes)
        for body in self.bodies:
            parts.body(body, "bodies")
        parts.body(self.arm, "arm")
        one, other = (parts.pin(body, self.arm) for body in self.bodies)
        if one is None or other is None:
            raise Unusable("both wheels of a belt turn about pivots on one body", "Name it: arm = ...", "arm", self.arm)
        distance = float(np.hypot(*minus(parts.pose.local(self.arm, other), parts.pose.local(self.arm, one))))
        if (first + second if self.crossed else abs(first - second)) >= distance:
            key = "radii" if self.radii else "diameters"
            message = (
                f"no {'crossed ' if self.crossed else ''}belt fits on these wheels, whose axes are {1e3 * distance:.6g} mm apart"
            )
            raise Unusable(message, "Give smaller wheels, or move the pivots apart", key, ", ".join(map(str, sizes)))
        key, sense = "radii" if self.radii else "diameters", -1.0 if self.crossed else 1.0
        wheels, radius = (f"{name}.{key}.{BOTH[0]}", f"{name}.{key}.{BOTH[1]}"), 1.0 if self.radii else 0.5
        phase = named(self, name, "phase")
        return Gear(name, self.bodies, sense, phase, self.arm, (one, other), radii=wheels, radius=radius)


class CamSection(Section):
    """A disc cam and the follower that it moves by a law of the cam angle."""

    cam: str
    """The body with the cam."""
    follower: str
    """The body that slides in a guide or turns about a pivot."""
    law: Any
    """Displacement of the follower over a revolution of the cam, segment by segment."""
    base_radius: Length | None = None
    """Radius of the base circle, from which the displacement counts; default: it counts from `start`."""
    start: Any = None
    """Without a base circle: the slide or angle of the follower where its displacement is zero; default: 0."""
    lift: Annotated[Quantity | None, BeforeValidator(_read_lift)] = None
    """Difference of the largest and the least displacement, to which that of the law is scaled; default: that of the law."""
    roller: Length | None = None
    """Radius of the roller of the follower; its centre is the point of the follower on its guide, or at the end of its link."""
    flat: bool = False
    """Whether the follower has a flat face, across its guide."""
    phase: Angle = PHASE
    """Angle of the cam, relative to the body that carries the follower, at which the law begins."""
    side: Literal["left", "right"] = "left"
    """Of a swinging follower with a base circle: the side of the line from the pivot of the cam to that of the follower."""

    @model_validator(mode="after")
    def _one_face(self) -> Self:
        if self.flat and self.roller is not None:
            raise Unusable("the follower has a roller and a flat face", "Give one of the two", "roller", str(self.roller))
        if self.start is not None and self.base_radius is not None:
            raise Unusable("the base circle determines where the follower starts", "Give one of the two", "start", self.start)
        return self

    def coupling(self, name: str, parts: Parts) -> Element:
        """Return the coupling of cam and follower."""
        for key, body in (("cam", self.cam), ("follower", self.follower)):
            check_name(body, parts.links, "no such body", key)
        if self.cam == self.follower:
            raise Unusable("a cam moves another body", "Name the body that it moves", "follower", self.follower)
        guide = next((guide for guide in parts.guides.values() if guide.slider == self.follower), None)
        carriers = [FRAME, *parts.links] if guide is None else [guide.on]
        carrier = next((one for one in carriers if parts.pin(self.cam, one) and (guide or parts.pin(self.follower, one))), None)
        if carrier is None or carrier in (self.cam, self.follower):
            message = f"{self.cam} and {self.follower} have no body on which both have a joint"
            raise Unusable(message, "Pin the cam to the body that carries the follower", "cam", self.cam)
        pivot, link = str(parts.pin(self.cam, carrier)), parts.links[self.follower]
        swings, sense = guide is None, 1.0
        if swings and self.flat:
            raise Unusable("a swinging follower with a flat face is not supported", "Give it a roller", "flat", True)
        law = self._law("angle" if swings else "length").law()
        contact = "" if self.flat else self._tip(parts, link, carrier) if guide is None else guide.at or link.start
        begin = 0.0
        if self.base_radius is None:
            kind = "angle" if swings else "coordinate"
            begin = 0.0 if self.start is None else read_scalar(self.start, kind, "start")[0]
        elif swings:
            sense = -1.0 if self.side == "left" else 1.0
        lift = named(self, name, "lift", 1.0)
        if self.lift is not None:
            if (self.lift.kind == "angle") is not swings:
                message, unit = ("the follower turns", "deg") if swings else ("the follower slides", "mm")
                raise Unusable(f"{message}, so its lift is in {unit}", f'Write lift = "12 {unit}"', "lift", str(self.lift))
            least, _, largest, _ = law.extremes()
            law = law.scaled(1.0 / (largest - least))
        base = None if self.base_radius is None else f"{name}.base_radius"
        roller, phase = named(self, name, "roller"), named(self, name, "phase")
        cam = Cam(name, self.cam, self.follower, pivot, law, lift, begin, phase, contact, carrier, roller, base, sense)
        if not math.isfinite(float(cam.lowest(parts.pose))):
            message, remedy = (
                "the follower does not reach its base circle",
                "Change the base circle, or the length of the follower",
            )
            if guide is not None:
                message = "the line of the guide passes the axis of the cam outside the base circle"
                remedy = "Give a larger base circle, or a smaller offset"
            raise Unusable(message, remedy, "base_radius", str(self.base_radius))
        return cam

    def _law(self, kind: str) -> CamLaw:
        with below("law"):
            return read_cam_law(self.law, kind)

    def _tip(self, parts: Parts, link: Link, carrier: str) -> str:
        """Return the point of a swinging follower that follows the pitch curve: the end of its link."""
        if parts.pin(self.follower, carrier) != link.start or not link.end:
            message = "a swinging follower turns about its first joint, and its second one touches the cam"
            raise Unusable(message, 'Write joints = ["F", "R"] with the pivot first, and a length', "follower", self.follower)
        return link.end


ELEMENTS = ("gears", "racks", "belts", "cams")
"""Tables of a linkage whose entries couple two bodies."""


def couplings(tables: Mapping[str, Mapping[str, Any]], parts: Parts) -> Iterator[Element]:
    """Yield the couplings of the tables of `ELEMENTS`.

    Raises
    ------
    Unusable
        with the key below the linkage.
    """
    for kind, entries in tables.items():
        for name, entry in entries.items():
            with below(f"{kind}.{name}"):
                yield entry.coupling(name, parts)


MOST_TURNS = 1000
"""Revolutions of the crank after which a geared mechanism must repeat."""
SAME_TURNS = 1e-9
"""Difference of two numbers of turns that is rounding."""


def geared(mechanism: Mechanism, sizes: Mapping[str, float]) -> Mechanism:
    """Return a mechanism with the angles about which its coupled bodies swing, and the rotation after which its motion repeats.

    Raises
    ------
    Unusable
        If couplings do not determine their bodies, a body of a group is coupled that turns fully, or the motion does not repeat.
    """
    for train in mechanism.trains:
        rows = train.rows(Pose(mechanism, sizes))
        if abs(determinant(rows, train.coordinates)) < 1e-9 * math.prod(math.hypot(*row.values()) for row in rows):
            bodies, names = ", ".join(one.link.body for one in train.singles), ", ".join(one.name for one in train.elements)
            message = f"the motion of {bodies} is not determined by {names}: one of them only repeats another"
            raise Unusable(message, "Change a number of teeth, or couple other bodies", "mechanism.gears")
    if not mechanism.singles:
        return mechanism
    grouped = {link.body for group in mechanism.groups for link in group.links}
    coupling = [element for element in mechanism.elements if element.bodies]
    coupled = {body: one for one in coupling for body in (*one.bodies, *one.unknown({FRAME})) if body in grouped}
    low, high = mechanism.limits or (0.0, TURN)
    if coupled:
        motion = sweep(mechanism, sizes, np.linspace(low, high, 361))
        middles = {}
        for body, element in coupled.items():
            angles = motion.body_angle(body).value
            if np.nanmax(angles) - np.nanmin(angles) >= TURN * 0.999:
                message = f"{body} turns fully, and its angle is that of a group of two bodies: this is not supported"
                remedy = "Couple a body that the drive or another coupling turns, or one that swings"
                raise Unusable(message, remedy, f"mechanism.{key_of(element)}")
            middles[body] = float(0.5 * (np.nanmax(angles) + np.nanmin(angles)))
        mechanism = replace(mechanism, middles=middles)
    if mechanism.limits is not None:
        return mechanism
    shares = [Fraction(1)]
    for (place, body), turns in _turns(mechanism, sizes).items():
        shares.append(Fraction(turns).limit_denominator(MOST_TURNS))
        if abs(turns - shares[-1]) > SAME_TURNS:
            message = f"{body} makes {turns:.9g} turns in one of the crank: the motion does not repeat"
            remedy = "Give numbers of teeth, or sizes in a ratio of whole numbers, or a range of the drive"
            elements = (element for element in mechanism.trains[place].elements if element.bodies)
            key = next((f"mechanism.{key_of(element)}" for element in elements), "drive")
            raise Unusable(message, remedy, key)
    count = math.lcm(*(share.denominator for share in shares))
    return replace(mechanism, cycle=max(mechanism.cycle, count * TURN))


def _turns(mechanism: Mechanism, sizes: Mapping[str, float]) -> dict[tuple[int, str], float]:
    """Return the turns of the bodies of trains, by number of the train and name, in one turn of the crank."""
    before, after = (mechanism.at(sizes, at).turns for at in (0.3, 0.3 + TURN))
    bodies = [(k, single.link.body) for k, train in enumerate(mechanism.trains) for single in train.singles]
    turns = {(k, body): float(after[body] - before[body]) / TURN for k, body in bodies if body in before}
    return {which: turned for which, turned in turns.items() if math.isfinite(turned)}


def check_one_cycle(
    mechanism: Mechanism, free: Mapping[str, Quantity], complete: Callable[[Mapping[str, float]], Mapping[str, float]]
) -> None:
    """Refuse design variables that change the turns of a body in one of the crank, after which the motion repeats.

    `complete` returns all dimensions for values of those that are `free`.

    Raises
    ------
    Unusable
        whose key is the name of the variable.
    """
    if mechanism.limits is not None or not mechanism.singles:
        return
    turns = _turns(mechanism, complete({}))
    for name, quantity in free.items():
        for end in quantity.bounds:
            for which, other in _turns(mechanism, complete({name: end})).items():
                if abs(other - turns.get(which, other)) > SAME_TURNS:
                    message = f"{which[1]} would make other numbers of turns in one of the crank, after which the motion repeats"
                    raise Unusable(message, 'Give the drive a range: range = ["0 deg", "90 deg"], or fix it', name, str(quantity))
