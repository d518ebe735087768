"""Drives and couplings: laws by which one body moves on a placed one, and lengths that cylinders prescribe.

All of them are functions of one cycle variable, the crank angle of a mechanism with one crank at constant speed. A body that has
one joint with placed bodies is placed in closed form: its angle or slide is prescribed, or follows from bodies before it.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, NamedTuple, Protocol, runtime_checkable

import numpy as np

from optlink.linkage.bodies import FRAME, Guide, Joint, Link, Size
from optlink.linkage.cams import Arm, Contact, DiscCam, Face, Profile, Roller, Slide
from optlink.linkage.jet import Jet, as_jet
from optlink.linkage.laws import MotionLaw
from optlink.linkage.vector2d import TURN, Array, Value, Vector, cross, dot, magnitude, minus, plus, sign, turn, turn_back, unit

PRESSURE = math.radians(20.0)
"""Pressure angle of involute teeth (ISO 53)."""


BARREL, SLIM, RIM = 0.85, 0.04, (1.04, 1.12)
"""Length of a barrel and half its width over the length of the closed cylinder, and radii of a rim over that of its teeth."""

SMOOTH: tuple[Value, tuple[float, ...], float] = (0.0, (), 1.0)
"""Knots of an element with a smooth law."""


class Action(NamedTuple):
    """What a drive or a coupling exerts on a body: a force [N] at a point [m], and a torque [N m]."""

    body: str
    force: Vector = (0.0, 0.0)
    point: Vector = (0.0, 0.0)
    torque: Value = 0.0


class Pose(Protocol):
    """Positions of the bodies placed so far, as in `optlink.linkage.mechanism.Pose`."""

    mechanism: Any
    angle: Value
    points: dict[str, Vector]
    turns: dict[str, Value]

    def size(self, size: Size) -> Value:
        """Return the value of a parameter, or a number unchanged."""

    def turned(self, body: str) -> Value:
        """Return the angle of a placed body [rad]."""

    def point(self, name: str) -> Vector:
        """Return the position of a point [m]."""

    def direction(self, body: str) -> Vector:
        """Return the unit vector of a body's x axis."""

    def local(self, body: str, point: str) -> Vector:
        """Return the coordinates of a point in the axes of a body [m]."""

    def line(self, guide: Guide, body: str) -> tuple[Vector, Vector]:
        """Return a point [m] and the unit vector of a guide's line, from the position of one of its bodies."""

    def local_line(self, guide: Guide, body: str) -> tuple[Vector, Vector]:
        """Return a point [m] and the unit vector of a guide's line in the axes of one of its bodies."""

    def slide(self, guide: Guide) -> Value:
        """Return the displacement of a slider along its line [m]."""

    def place(self, link: Link, direction: Vector, point: str) -> None:
        """Place a body by its direction and one of its points whose position is known."""


def key_of(element: Element) -> str:
    """Return the key of a coupling below its linkage in a file, such as gears.mesh."""
    return f"{element.kind.removesuffix('s')}s.{element.name}"


class Places(Protocol):
    """Positions and directions at which actions are computed, without derivatives."""

    @property
    def pose(self) -> Pose:
        """The whole pose."""

    def place(self, point: str) -> Vector:
        """Return the position of a point [m]."""

    def line(self, guide: Guide) -> Vector:
        """Return the unit vector of the line of a guide."""


@runtime_checkable
class Element(Protocol):
    """A drive or a coupling."""

    @property
    def name(self) -> str:
        """Name in the problem file."""

    @property
    def kind(self) -> str:
        """What it is, or what it drives, in a word."""

    @property
    def bodies(self) -> tuple[str, ...]:
        """The bodies whose motions it couples; none for a drive."""

    @property
    def against(self) -> str:
        """The body relative to which it states the angle of a body on a pin."""

    @property
    def sizes(self) -> tuple[Size, ...]:
        """The sizes on which its law depends."""

    def places(self, placed: Collection[str]) -> str:
        """Return the body that it can place once some bodies are placed; empty if there is none."""

    def coordinate(self, pose: Pose, single: Single) -> Value:
        """Return the angle [rad] of a body relative to the body that carries it, or its slide [m]."""

    def knots(self, pose: Pose) -> tuple[Value, tuple[float, ...], float]:
        """Return the variable of its law at a pose, the knots of the law, and its period; no knots for a smooth element."""

    def actions(self, places: Places, single: Single, effort: Value) -> Iterator[Action]:
        """Yield the actions on all bodies, on that of `single` first.

        `effort` is their torque [N m] on this body about its pin, or their force [N] on it along the line of its guide.
        """

    def profiles(self, pose: Pose) -> Iterator[tuple[str, Profile]]:
        """Yield the curves by which it is drawn, with the bodies that carry them, for a pose of the whole motion."""


@dataclass(frozen=True)
class Single:
    """A body placed alone, on a joint with the placed body `against`; `after`: the joint of the last group placed before it."""

    link: Link
    joint: Joint
    against: str
    by: Element
    after: str = ""

    @property
    def guide(self) -> Guide | None:
        """The guide, if the joint is one."""
        return None if isinstance(self.joint, str) else self.joint

    def solve(self, pose: Pose) -> None:
        """Add the body and its points to `pose`."""
        link, guide, coordinate = self.link, self.guide, self.by.coordinate(pose, self)
        if guide is None:
            pin = str(self.joint)
            pose.turns[link.body] = pose.turned(self.against) + coordinate
            pose.point(pin)
            pose.place(link, turn(pose.direction(self.against), unit(coordinate)), pin)
            return
        tilt, direction = pose.size(guide.tilt), pose.size(guide.direction)
        if link.body == guide.slider:
            (x, y), line = pose.line(guide, self.against)
            at = guide.at or link.start
            pose.points[at] = x + coordinate * line[0], y + coordinate * line[1]
            pose.turns[link.body] = pose.turned(self.against) + direction + tilt
            pose.place(link, turn(line, unit(tilt)), at)
            return
        (x, y), line = pose.line(guide, self.against)  # the line moves, and passes through a point of a placed body
        axis = turn_back(line, unit(direction))
        begin = turn(pose.local_line(guide, link.body)[0], axis)
        pose.points[link.start] = minus((x - coordinate * line[0], y - coordinate * line[1]), begin)
        pose.turns[link.body] = pose.turned(self.against) - direction - tilt
        pose.place(link, axis, link.start)


def _array(vector: Vector) -> Array:
    return np.array([as_jet(part).value for part in vector], dtype=float)


def _box(low: float, high: float, half: float) -> Array:
    """Return the corners of a rectangle about the x axis."""
    return np.array([[low, -half], [high, -half], [high, half], [low, half]])


def _mark(centre: Array, radius: float) -> Profile:
    """Return a radius of a wheel about a point (1, 2), which shows that it turns."""
    return Profile(np.concatenate([centre, centre + np.array([radius, 0.0])]), auxiliary=True, open=True)


# --- drives ---------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Drive:
    """A motor or a cylinder: it prescribes the angle of a body, its slide in a guide, or the length of a link.

    With a `law`, of time [s], the coordinate is `begin` + law(x * `rate`), x being the cycle variable [rad]; without one it goes
    from `begin` to `end` in half a cycle, x from 0 to pi, or is `begin` + x * `rate` if there is no end.
    """

    name: str
    kind: Literal["angle", "slide", "length"]
    body: str
    """The driven body; of a cylinder the link whose length is prescribed."""
    begin: Size = 0.0
    end: Size | None = None
    law: MotionLaw | None = None
    rate: float = 1.0
    against: str = FRAME
    """The body that carries the drive."""
    bodies: ClassVar[tuple[str, ...]] = ()
    size: str = ""
    """Name of the length that a cylinder prescribes."""
    rod: str = ""
    """Name of the rod of a cylinder: it has the direction of the link, and its origin at the end of it."""
    stroke: tuple[Size, Size] = (0.0, 0.0)
    """Lengths of a closed and an open cylinder."""

    @property
    def sizes(self) -> tuple[Size, ...]:
        """The ends of its stroke."""
        return (self.begin,) if self.end is None else (self.begin, self.end)

    def places(self, placed: Collection[str]) -> str:
        """Return the driven body, once the one that carries the drive is placed; empty for a cylinder."""
        return self.body if self.kind != "length" and self.against in placed else ""

    def value(self, pose: Pose) -> Value:
        """Return the angle [rad], slide or length [m]."""
        begin = pose.size(self.begin)
        if self.law is not None:
            return begin + self.law(pose.angle * self.rate)
        if self.end is None:
            return begin + pose.angle * self.rate
        return begin + (pose.size(self.end) - begin) * (pose.angle * (1.0 / math.pi))

    def coordinate(self, pose: Pose, single: Single) -> Value:
        """Return the angle [rad] of the body relative to the body that carries it, or its slide [m]."""
        return self.value(pose)

    def knots(self, pose: Pose) -> tuple[Value, tuple[float, ...], float]:
        """Return the time at a pose, and the knots and the period of the law [s]; no knots without one."""
        return SMOOTH if self.law is None else (pose.angle * self.rate, self.law.knots, self.law.period)

    def profiles(self, pose: Pose) -> Iterator[tuple[str, Profile]]:
        """Yield the barrel and the rod with its piston, of usual proportions; nothing of a motor."""
        closed, opened = (float(pose.size(end)) for end in self.stroke)
        if not closed:
            return
        barrel, half = BARREL * closed, SLIM * closed
        end = -max(0.9, opened / closed + 3.0 * SLIM - BARREL) * closed
        piston, rod = _box(end, end + half, 0.9 * half), _box(end + half, 0.0, 0.4 * half)
        yield self.rod, Profile(np.concatenate([piston[:2], rod, piston[2:]]))
        yield self.body, Profile(_box(0.0, barrel, half))

    def actions(self, places: Places, single: Single, effort: Value) -> Iterator[Action]:
        """Yield the actions on the driven body and on the one that carries the drive."""
        guide = single.guide
        for body, share in ((single.link.body, effort), (single.against, -effort)):
            if guide is None:
                yield Action(body, torque=share)
            else:
                x, y = places.line(guide)
                share = share if single.link.body == guide.slider else -share
                at = places.place(guide.at or places.pose.mechanism.bodies[guide.slider].start)
                yield Action(body, (share * x, share * y), at)


# --- couplings ------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Gear:
    """Two bodies whose angles relative to a third one, the `arm`, are in a fixed ratio: gears, or a belt.

    angle of second = `ratio` * angle of first + `phase` [rad]; two external gears have a negative ratio. Where both turn about
    `pivots` on the arm, teeth press on each other at the pitch point, or the tight strand of a belt on wheels of `radii` pulls;
    else torques alone are passed on.
    """

    name: str
    bodies: tuple[str, str]
    ratio: Size
    phase: Size = 0.0
    arm: str = FRAME
    pivots: tuple[str, str] | None = None
    pressure: float = PRESSURE
    radii: tuple[Size, Size] | None = None
    mesh: bool = True
    """Whether the two bodies themselves have teeth or wheels."""
    against: ClassVar[str] = FRAME

    @property
    def kind(self) -> str:
        """A belt if it has wheels."""
        return "gears" if self.radii is None else "belt"

    @property
    def sizes(self) -> tuple[Size, ...]:
        """Ratio, phase and radii."""
        return self.ratio, self.phase, *(self.radii or ())

    def places(self, placed: Collection[str]) -> str:
        """Return the body whose angle follows from that of the other one; empty if there is none."""
        return _other(self.bodies, placed) if self.arm in placed else ""

    def coordinate(self, pose: Pose, single: Single) -> Value:
        """Return the angle [rad] of one of the bodies relative to the body that carries it."""
        (first, second), arm = self.bodies, pose.turned(self.arm)
        ratio, phase = pose.size(self.ratio), pose.size(self.phase)
        if single.link.body == second:
            whole = arm + ratio * (pose.turned(first) - arm) + phase
        else:
            whole = arm + (pose.turned(second) - arm - phase) / ratio
        return whole - pose.turned(single.against)

    def knots(self, pose: Pose) -> tuple[Value, tuple[float, ...], float]:
        """Return no knots: the ratio is constant."""
        return SMOOTH

    def profiles(self, pose: Pose) -> Iterator[tuple[str, Profile]]:
        """Yield the pitch circles of gears, that of a ring within its rim; wheels and strands of a belt.

        Of a ratio that is obtained in another way, the line of the pivots.
        """
        if self.pivots is None:
            return
        ratio = float(pose.size(self.ratio))
        first, second = (_array(pose.local(self.arm, pivot)) for pivot in self.pivots)
        if not self.mesh:
            yield self.arm, Profile(np.array([first, second]), auxiliary=True, open=True)
            return
        distance = float(np.hypot(*(second - first)))
        radii = [float(pose.size(radius)) for radius in self.radii or ()]
        radii = radii or [abs(distance / (1.0 - speed)) for speed in (1.0 / ratio, ratio)]
        for body, pivot, radius in zip(self.bodies, self.pivots, radii, strict=True):
            centre = _array(pose.local(body, pivot))[None]
            yield body, Profile(centre, radius, auxiliary=self.radii is None)
            if self.radii is None and ratio > 0.0 and radius == max(radii):
                inner, outer = (Profile(centre, share * radius).corners for share in RIM)
                yield body, Profile(np.concatenate([inner, outer[::-1]]))
            else:
                yield body, _mark(centre, radius)
        if self.radii is not None:
            along = (second - first) / distance
            sine = (radii[0] - math.copysign(radii[1], ratio)) / distance
            for side in (1.0, -1.0):
                normal = sine * along + side * math.sqrt(1.0 - sine * sine) * along[::-1] * [-1.0, 1.0]
                ends = first + radii[0] * normal, second + math.copysign(radii[1], ratio) * normal
                yield self.arm, Profile(np.array(ends), auxiliary=True, open=True)

    def actions(self, places: Places, single: Single, effort: Value) -> Iterator[Action]:
        """Yield the actions on both bodies, and on the arm if torques alone are passed on."""
        ratio, second = places.pose.size(self.ratio), single.link.body == self.bodies[1]
        way = -1 if second else 1
        own, other = self.bodies[::way]
        speed = ratio if second else 1.0 / ratio  # of this body over that of the other, relative to the arm
        if self.pivots is None:
            for body, torque in ((own, effort), (other, -speed * effort), (self.arm, (speed - 1.0) * effort)):
                yield Action(body, torque=torque)
            return
        centre, away = map(places.place, self.pivots[::way])
        between = minus(away, centre)
        distance = np.sqrt(dot(between, between))
        u = between[0] / distance, between[1] / distance
        if self.radii is None:
            lever = distance / (1.0 - speed)  # along u, to the pitch point: there both have one velocity
            tangent = effort / lever
            force, arm = (sign(speed) * math.tan(self.pressure) * magnitude(tangent), tangent), (lever, 0.0)
        else:
            radius, opposite = map(places.pose.size, self.radii[::way])
            sine = (radius - sign(speed) * opposite) / distance
            cosine, side, pull = np.sqrt(1.0 - sine * sine), sign(effort), magnitude(effort) / radius
            force, arm = (pull * cosine, side * pull * sine), (radius * sine, -side * radius * cosine)
        whole, point = turn(force, u), plus(centre, turn(arm, u))
        yield Action(own, whole, point)
        yield Action(other, (-whole[0], -whole[1]), point)


@dataclass(frozen=True)
class Rack:
    """A wheel that rolls on a bar: the slide of the bar is `side` * `radius` * angle of the wheel + `phase` [m].

    The angle is relative to the body that carries the guide of the bar; `side` is +1 if the `pivot` of the wheel lies to the left
    of the line of the guide, else -1.
    """

    name: str
    pinion: str
    guide: Guide
    radius: Size
    pivot: str
    side: int = 1
    phase: Size = 0.0
    pressure: float = PRESSURE
    against: ClassVar[str] = FRAME
    kind: ClassVar[str] = "rack"

    @property
    def bodies(self) -> tuple[str, str]:
        """The wheel and the bar."""
        return self.pinion, self.guide.slider

    @property
    def sizes(self) -> tuple[Size, ...]:
        """Radius and phase."""
        return self.radius, self.phase

    def places(self, placed: Collection[str]) -> str:
        """Return the bar or the wheel, whichever follows from the other one; empty if none does."""
        return _other((self.pinion, self.guide.slider), placed) if self.guide.on in placed else ""

    def coordinate(self, pose: Pose, single: Single) -> Value:
        """Return the slide of the bar [m], or the angle of the wheel [rad] relative to the body that carries it."""
        radius, phase, carrier = self.side * pose.size(self.radius), pose.size(self.phase), pose.turned(self.guide.on)
        if single.guide is not None:
            return radius * (pose.turned(self.pinion) - carrier) + phase
        return (pose.slide(self.guide) - phase) / radius + carrier - pose.turned(single.against)

    def knots(self, pose: Pose) -> tuple[Value, tuple[float, ...], float]:
        """Return no knots: the ratio is constant."""
        return SMOOTH

    def profiles(self, pose: Pose) -> Iterator[tuple[str, Profile]]:
        """Yield the pitch circle of the wheel, and the bar from its guide and as far as it rolls, with its pitch line."""
        radius = float(pose.size(self.radius))
        centre = _array(pose.local(self.pinion, self.pivot))[None]
        yield self.pinion, Profile(centre, radius, auxiliary=True)
        yield self.pinion, _mark(centre, radius)
        begin, line = (_array(part) for part in pose.local_line(self.guide, self.guide.on))
        away = _array(pose.local(self.guide.on, self.pivot)) - begin
        slides = np.asarray(as_jet(pose.slide(self.guide)).value, dtype=float)
        reach = float(line @ away) - np.array([np.nanmax(slides), np.nanmin(slides)])
        reach = np.array([min(reach[0], 0.0) - 0.5 * radius, max(reach[1], 0.0) + 0.5 * radius])
        level = float(line[0] * away[1] - line[1] * away[0]) - self.side * radius
        start, along = (_array(part) for part in pose.local_line(self.guide, self.guide.slider))
        left, deep = along[::-1] * [-1.0, 1.0], 0.25 * self.side * radius
        near, far = (start + reach[:, None] * along + b * left for b in (level + 0.25 * deep, level - deep))
        yield self.guide.slider, Profile(np.concatenate([near, far[::-1]]))
        yield self.guide.slider, Profile(near - 0.25 * deep * left, auxiliary=True, open=True)

    def actions(self, places: Places, single: Single, effort: Value) -> Iterator[Action]:
        """Yield the actions on the bar and on the wheel."""
        line, centre, radius = places.line(self.guide), places.place(self.pivot), places.pose.size(self.radius)
        on_bar = effort if single.guide is not None else -self.side * effort / radius
        force = turn((on_bar, -self.side * math.tan(self.pressure) * magnitude(on_bar)), line)
        point = plus(centre, turn((0.0, -self.side * radius), line))
        both = Action(self.guide.slider, force, point), Action(self.pinion, (-force[0], -force[1]), point)
        yield from both if single.guide is not None else both[::-1]


@dataclass(frozen=True)
class Cam:
    """A follower that slides or turns by a law of the angle of a cam [rad], both relative to the body that carries the follower.

    The force acts along the common normal, which passes through the point of equal velocities of both, and through the centre of
    the roller (or the knife edge) `contact`; without one the follower has a flat face across its slide.
    """

    name: str
    cam: str
    follower: str
    pivot: str
    law: MotionLaw
    lift: Size = 1.0
    begin: Size = 0.0
    phase: Size = 0.0
    contact: str = ""
    against: str = FRAME
    """The body that carries the follower."""
    roller: Size = 0.0
    """Radius of the roller."""
    kind: ClassVar[str] = "cam"

    @property
    def bodies(self) -> tuple[str, str]:
        """The cam and the follower."""
        return self.cam, self.follower

    @property
    def sizes(self) -> tuple[Size, ...]:
        """Lift, its begin, and phase."""
        return self.lift, self.begin, self.phase

    def places(self, placed: Collection[str]) -> str:
        """Return the follower, once the cam is placed."""
        return self.follower if self.cam in placed else ""

    def coordinate(self, pose: Pose, single: Single) -> Value:
        """Return the slide [m] or the angle [rad] of the follower relative to the body that carries it."""
        return pose.size(self.begin) + pose.size(self.lift) * self.law(self._turned(pose))

    def _turned(self, pose: Pose) -> Value:
        """Return the angle of the cam from the begin of its law [rad]."""
        return pose.turned(self.cam) - pose.turned(self.against) - pose.size(self.phase)

    def knots(self, pose: Pose) -> tuple[Value, tuple[float, ...], float]:
        """Return the angle of the cam from the begin of its law, and the knots and the period of the law [rad]."""
        return self._turned(pose), self.law.knots, self.law.period

    def disc(self, pose: Pose) -> DiscCam:
        """Return the disc cam in the axes of the body that carries the follower, about the pivot of the cam."""
        single = next(one for one in pose.mechanism.singles if one.by == self)
        begin, roller, centre = float(pose.size(self.begin)), float(pose.size(self.roller)), pose.local(self.against, self.pivot)
        guide: Slide | Arm
        if single.guide is not None:
            point, line = pose.local_line(single.guide, self.against)
            away = minus(point, centre)
            lowest, offset = begin + float(dot(line, away)), -float(cross(line, away))
            sense = math.copysign(1.0, lowest)
            guide = Slide(math.atan2(sense * line[1], sense * line[0]), sense * offset)
            base = math.hypot(lowest, offset) if self.contact else abs(lowest)
        else:
            pivot = minus(pose.local(self.against, str(single.joint)), centre)
            length, lowest = float(pose.size(single.link.length)), begin - math.atan2(-pivot[1], -pivot[0])
            sense = math.copysign(1.0, math.remainder(lowest, TURN))
            guide = Arm((float(pivot[0]), float(pivot[1])), length, side=int(sense))
            base = abs(length * np.exp(1j * lowest) - math.hypot(*pivot))
        scale, phase = sense * float(pose.size(self.lift)), float(pose.size(self.phase))

        def lift(angles: Array) -> tuple[Array, Array, Array]:
            value, rate, bend = as_jet(self.law(Jet(angles - phase, 1.0))).parts
            return scale * value, scale * rate, scale * bend

        contact: Contact = Roller(roller) if self.contact else Face()
        return DiscCam(lift, guide, contact, base - roller, tuple(knot + phase for knot in self.law.knots))

    def profiles(self, pose: Pose) -> Iterator[tuple[str, Profile]]:
        """Yield the profile of the cam with its base circle, and the roller or the flat face of the follower."""
        disc, centre = self.disc(pose), _array(pose.local(self.cam, self.pivot))
        for profile in disc.profiles:
            yield self.cam, profile.moved(centre)
        if self.contact and self.roller:
            yield self.follower, Profile(_array(pose.local(self.follower, self.contact))[None], float(pose.size(self.roller)))
        guide = next(one.guide for one in pose.mechanism.singles if one.by == self)
        if guide is None or self.contact:
            return
        line, (start, along) = pose.local_line(guide, self.against)[1], pose.local_line(guide, self.follower)
        touch = disc.at(np.linspace(0.0, TURN, 361))
        way, thick = disc.guide.way(touch.point)[0], 0.1 * disc.base_radius
        left = np.imag((touch.contact - touch.point) / way)
        low, high = np.min(left) - thick, np.max(left) + thick
        upright = (way / complex(*line)).real * complex(*along)
        face = complex(*start) + upright * np.array([1j * low, 1j * high, thick + 1j * high, thick + 1j * low])
        yield self.follower, Profile(np.column_stack([face.real, face.imag]))

    def actions(self, places: Places, single: Single, effort: Value) -> Iterator[Action]:
        """Yield the actions on the follower and on the cam."""
        pose, guide = places.pose, single.guide
        centre = places.place(self.pivot)
        turned = as_jet(self._turned(pose)).value
        slope = pose.size(self.lift) * as_jet(self.law(Jet(turned, 1.0))).rate  # per rotation of the cam
        if guide is not None:
            line = places.line(guide)
            common = plus(centre, turn((0.0, -slope), line))  # its velocity on the cam is that of the follower
            at = places.place(self.contact) if self.contact else plus(common, line)
            normal = minus(at, common)
            size = effort / dot(normal, line)
        else:
            pivot = places.place(str(single.joint))
            between = minus(pivot, centre)
            share = slope / (slope - 1.0)
            common = centre[0] + share * between[0], centre[1] + share * between[1]
            at = places.place(self.contact)
            normal = minus(at, common)
            size = effort / cross(minus(at, pivot), normal)
        force = size * normal[0], size * normal[1]
        yield Action(single.link.body, force, at)
        yield Action(self.cam, (-force[0], -force[1]), at)


def _other(bodies: tuple[str, str], placed: Collection[str]) -> str:
    """Return the body of a pair that is not placed, if the other one is; else an empty string."""
    one, other = bodies
    return other if one in placed and other not in placed else one if other in placed and one not in placed else ""
