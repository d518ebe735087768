"""Drives and couplings: laws by which one body moves on a placed one, and lengths that cylinders prescribe.

All of them are functions of one cycle variable, the crank angle of a mechanism with one crank at constant speed. Each states one
linear equation between the angles of bodies and the slides in guides; those of a `Train` are solved together.
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
from optlink.linkage.vector2d import (
    TURN,
    Array,
    Value,
    Vector,
    angle,
    cross,
    dot,
    magnitude,
    minus,
    plus,
    root,
    sign,
    turn,
    turn_back,
    unit,
)

PRESSURE = math.radians(20.0)
"""Pressure angle of involute teeth (ISO 53)."""


BARREL, SLIM, RIM = 0.85, 0.04, (1.04, 1.12)
"""Length of a barrel and half its width over the length of the closed cylinder, and radii of a rim over that of its teeth."""

FLATTEST = 100.0
"""Radius of curvature of a flat or hollow pitch curve, over the distance of the follower's point from the axis of the cam."""

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
    def sizes(self) -> tuple[Size, ...]:
        """The sizes on which its law depends."""

    def unknown(self, placed: Collection[str]) -> set[str]:
        """Return the bodies of its equation that are not placed; none while it cannot determine their angles or slides."""

    def terms(self, pose: Pose) -> dict[Joint, Value]:
        """Return the coefficients of its equation by the body whose angle [rad] or the guide whose slide [m] they multiply."""

    def value(self, pose: Pose) -> Value:
        """Return the right side of its equation."""

    def knots(self, pose: Pose) -> tuple[Value, tuple[float, ...], float]:
        """Return the variable of its law at a pose, the knots of the law, and its period; no knots for a smooth element."""

    def actions(self, places: Places, effort: Value) -> Iterator[Action]:
        """Yield the actions on all bodies; `effort` is the torque [N m] or force [N] that belongs to the sum of its equation."""

    def profiles(self, pose: Pose) -> Iterator[tuple[str, Profile]]:
        """Yield the curves by which it is drawn, with the bodies that carry them, for a pose of the whole motion."""


def _size(pose: Pose, size: Size) -> Value:
    """Return the value of a parameter without its derivatives, which are zero."""
    return as_jet(pose.size(size)).value


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

    def unknown(self, placed: Collection[str]) -> set[str]:
        """Return the driven body and the one that carries the drive, unless they are placed; none of a cylinder."""
        return set() if self.kind == "length" else {self.body, self.against}.difference(placed)

    def value(self, pose: Pose) -> Value:
        """Return the angle [rad], slide or length [m]."""
        begin = pose.size(self.begin)
        if self.law is not None:
            return begin + self.law(pose.angle * self.rate)
        if self.end is None:
            return begin + pose.angle * self.rate
        return begin + (pose.size(self.end) - begin) * (pose.angle * (1.0 / math.pi))

    def terms(self, pose: Pose) -> dict[Joint, Value]:
        """Return the terms of the angle relative to the body that carries the drive, or of the slide."""
        return _between(pose, self.body, self.against)

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

    def actions(self, places: Places, effort: Value) -> Iterator[Action]:
        """Yield the actions on the driven body and on the one that carries the drive."""
        guide = _guide(places.pose, self.body, self.against)
        for body, share in ((self.body, effort), (self.against, -effort)):
            if guide is None:
                yield Action(body, torque=share)
            else:
                x, y = places.line(guide)
                at = places.place(guide.at or places.pose.mechanism.bodies[guide.slider].start)
                yield Action(body, (share * x, share * y), at)


# --- couplings ------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Gear:
    """Two bodies whose angles relative to a third one, the `arm`, are in a fixed ratio: gears, or a belt.

    angle of second = `ratio` * angle of first + `phase` [rad]; two external gears have a negative ratio. Where both turn about
    `pivots` on the arm, teeth press on each other at the pitch point, or the tight strand of a belt on wheels of `radii` pulls;
    else torques alone are passed on. The ratio of a belt is that of its radii, times `ratio`, -1 for a crossed one.
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
    radius: float = 1.0
    """Radius of a wheel over its size in `radii`: a half for diameters."""

    @property
    def kind(self) -> str:
        """A belt if it has wheels."""
        return "gears" if self.radii is None else "belt"

    @property
    def sizes(self) -> tuple[Size, ...]:
        """Ratio, phase and radii."""
        return self.ratio, self.phase, *(self.radii or ())

    def unknown(self, placed: Collection[str]) -> set[str]:
        """Return those of the two bodies and the arm that are not placed."""
        return {*self.bodies, self.arm}.difference(placed)

    def speed(self, pose: Pose) -> Value:
        """Return the speed of the second body over that of the first one, both relative to the arm."""
        first, second = self.radii or (1.0, 1.0)
        return pose.size(self.ratio) * (pose.size(first) / pose.size(second))

    def terms(self, pose: Pose) -> dict[Joint, Value]:
        """Return the terms of angle of second - ratio * angle of first, both relative to the arm."""
        (first, second), ratio = self.bodies, self.speed(pose)
        return _terms((second, 1.0), (first, -ratio), (self.arm, ratio - 1.0))

    def value(self, pose: Pose) -> Value:
        """Return the phase."""
        return pose.size(self.phase)

    def knots(self, pose: Pose) -> tuple[Value, tuple[float, ...], float]:
        """Return no knots: the ratio is constant."""
        return SMOOTH

    def profiles(self, pose: Pose) -> Iterator[tuple[str, Profile]]:
        """Yield the pitch circles of gears, that of a ring within its rim; wheels and strands of a belt.

        Of a ratio that is obtained in another way, the line of the pivots.
        """
        if self.pivots is None:
            return
        ratio = float(self.speed(pose))
        first, second = (_array(pose.local(self.arm, pivot)) for pivot in self.pivots)
        if not self.mesh:
            yield self.arm, Profile(np.array([first, second]), auxiliary=True, open=True)
            return
        distance = float(np.hypot(*(second - first)))
        radii = [self.radius * float(pose.size(radius)) for radius in self.radii or ()]
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

    def actions(self, places: Places, effort: Value) -> Iterator[Action]:
        """Yield the actions on both bodies, and on the arm if torques alone are passed on."""
        (other, own), speed = self.bodies, as_jet(self.speed(places.pose)).value
        if self.pivots is None:
            for body, torque in ((own, effort), (other, -speed * effort), (self.arm, (speed - 1.0) * effort)):
                yield Action(body, torque=torque)
            return
        away, centre = map(places.place, self.pivots)
        between = minus(away, centre)
        distance = np.sqrt(dot(between, between))
        u = between[0] / distance, between[1] / distance
        if self.radii is None:
            lever = distance / (1.0 - speed)  # along u, to the pitch point: there both have one velocity
            tangent = effort / lever
            force, arm = (sign(speed) * math.tan(self.pressure) * magnitude(tangent), tangent), (lever, 0.0)
        else:
            opposite, radius = (self.radius * _size(places.pose, radius) for radius in self.radii)
            sine = (radius - sign(speed) * opposite) / distance
            cosine, side, pull = np.sqrt(1.0 - sine * sine), sign(effort), magnitude(effort) / radius
            force, arm = (pull * cosine, side * pull * sine), (radius * sine, -side * radius * cosine)
        whole, point = turn(force, u), plus(centre, turn(arm, u))
        yield Action(own, whole, point)
        yield Action(other, (-whole[0], -whole[1]), point)


@dataclass(frozen=True)
class Rack:
    """A wheel that rolls on a bar: slide of the bar = `side` * `radius` * angle of the wheel + `phase` [m] + slide of the wheel.

    The bar slides in `guide`, or is the body that carries the `path`. The `pivot` of the wheel slides along this path, or is
    fixed on the body that carries the guide. Both lines are on one body, to which the angle is relative, and are parallel, or
    opposite if `way` is -1. `side` is +1 if the wheel lies to the left of the bar, seen along its guide or else along the path,
    or -1.
    """

    name: str
    pinion: str
    guide: Guide | None
    radius: Size
    pivot: str
    side: int = 1
    phase: Size = 0.0
    pressure: float = PRESSURE
    path: Guide | None = None
    way: int = 1
    kind: ClassVar[str] = "rack"

    @property
    def _line(self) -> Guide:
        """The guide that has the direction of the bar."""
        guide = self.guide or self.path
        assert guide is not None
        return guide

    @property
    def bar(self) -> str:
        """The body with the rack."""
        return self._line.on if self.guide is None else self.guide.slider

    @property
    def bodies(self) -> tuple[str, str]:
        """The wheel and the bar."""
        return self.pinion, self.bar

    @property
    def sizes(self) -> tuple[Size, ...]:
        """Radius and phase."""
        return self.radius, self.phase

    def unknown(self, placed: Collection[str]) -> set[str]:
        """Return those of the wheel, the bar and the bodies that carry them that are not placed."""
        path = () if self.path is None else self.path.bodies
        return {*self.bodies, self._line.on, *path}.difference(placed)

    def terms(self, pose: Pose) -> dict[Joint, Value]:
        """Return the terms of slide of the bar - slide of the wheel - `side` * `radius` * angle of the wheel."""
        turned = self.side * pose.size(self.radius)
        return _terms((self.pinion, -turned), (self._line.on, turned), (self.path, -self.way), (self.guide, 1.0))

    def value(self, pose: Pose) -> Value:
        """Return the phase."""
        return pose.size(self.phase)

    def knots(self, pose: Pose) -> tuple[Value, tuple[float, ...], float]:
        """Return no knots: the ratio is constant."""
        return SMOOTH

    def profiles(self, pose: Pose) -> Iterator[tuple[str, Profile]]:
        """Yield the pitch circle of the wheel, and the bar from its guide and as far as it rolls, with its pitch line."""
        radius, guide, on = float(pose.size(self.radius)), self._line, self._line.on
        centre = _array(pose.local(self.pinion, self.pivot))[None]
        yield self.pinion, Profile(centre, radius, auxiliary=True)
        yield self.pinion, _mark(centre, radius)
        begin, along = pose.line(guide, on)
        away = turn_back(minus(pose.point(self.pivot), begin), along)
        rolled, level = (np.asarray(as_jet(part).value, dtype=float) for part in away)
        if self.guide is not None:
            rolled = rolled - np.asarray(as_jet(pose.slide(guide)).value, dtype=float)
        reach = np.array([min(np.nanmin(rolled), 0.0) - 0.5 * radius, max(np.nanmax(rolled), 0.0) + 0.5 * radius])
        height = float(np.nanmean(level)) - self.side * radius
        start, way = (_array(part) for part in pose.local_line(guide, self.bar))
        left, deep = way[::-1] * [-1.0, 1.0], 0.25 * self.side * radius
        near, far = (start + reach[:, None] * way + b * left for b in (height + 0.25 * deep, height - deep))
        yield self.bar, Profile(np.concatenate([near, far[::-1]]))
        yield self.bar, Profile(near - 0.25 * deep * left, auxiliary=True, open=True)

    def actions(self, places: Places, effort: Value) -> Iterator[Action]:
        """Yield the actions on the bar and on the wheel."""
        line, centre, radius = places.line(self._line), places.place(self.pivot), _size(places.pose, self.radius)
        force = turn((effort, -self.side * math.tan(self.pressure) * magnitude(effort)), line)
        point = plus(centre, turn((0.0, -self.side * radius), line))
        yield Action(self.bar, force, point)
        yield Action(self.pinion, (-force[0], -force[1]), point)


@dataclass(frozen=True)
class Cam:
    """A follower that slides or turns by a law of the angle of a cam [rad], both relative to the body that carries the follower.

    The force acts along the common normal, which passes through the point of equal velocities of both, and through the centre of
    the roller (or the knife edge) `contact`; without one the follower has a flat face across its slide.

    Its displacement is `sense` * `lift` * law. It counts from `begin`, or from where the follower stands on a circle of the
    radius `base`: a swinging one to the left of the line from the pivot of the cam to its own if `sense` is -1.
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
    base: Size | None = None
    sense: float = 1.0
    kind: ClassVar[str] = "cam"

    @property
    def bodies(self) -> tuple[str, str]:
        """The cam and the follower."""
        return self.cam, self.follower

    @property
    def sizes(self) -> tuple[Size, ...]:
        """Lift, its begin, phase, and radii."""
        return self.lift, self.begin, self.phase, self.roller, *(() if self.base is None else (self.base,))

    def unknown(self, placed: Collection[str]) -> set[str]:
        """Return the follower, once the cam and the body that carries the follower are placed."""
        return {self.follower}.difference(placed) if {self.cam, self.against}.issubset(placed) else set()

    def terms(self, pose: Pose) -> dict[Joint, Value]:
        """Return the terms of the slide of the follower, or of its angle relative to the body that carries it."""
        return _between(pose, self.follower, self.against)

    def value(self, pose: Pose) -> Value:
        """Return the slide [m] or the angle [rad]."""
        return self.lowest(pose) + self.sense * pose.size(self.lift) * self.law(self._turned(pose))

    def lowest(self, pose: Pose) -> Value:
        """Return the slide [m] or the angle [rad] where the displacement is zero; NaN off a base circle that is out of reach."""
        if self.base is None:
            return pose.size(self.begin)
        reach, centre = pose.size(self.base) + pose.size(self.roller), pose.local(self.against, self.pivot)
        guide, link = _guide(pose, self.follower, self.against), pose.mechanism.bodies[self.follower]
        if guide is not None:
            point, line = pose.local_line(guide, self.against)
            away = minus(centre, point)
            offset = cross(line, away)
            return dot(line, away) + (root(reach * reach - offset * offset) if self.contact else reach)
        back, length = minus(centre, pose.local(self.against, link.start)), pose.size(link.length)
        square = dot(back, back)
        cosine = (length * length + square - reach * reach) / (2.0 * length * np.sqrt(square))
        with np.errstate(invalid="ignore"):
            return angle(back) + self.sense * np.arccos(cosine)

    def _turned(self, pose: Pose) -> Value:
        """Return the angle of the cam from the begin of its law [rad]."""
        return pose.turned(self.cam) - pose.turned(self.against) - pose.size(self.phase)

    def knots(self, pose: Pose) -> tuple[Value, tuple[float, ...], float]:
        """Return the angle of the cam from the begin of its law, and the knots and the period of the law [rad]."""
        return self._turned(pose), self.law.knots, self.law.period

    def contact_at(self, pose: Pose, turned: Value) -> tuple[Value, Value]:
        """Return the pressure angle [rad] and the radius of curvature of the profile [m] at an angle of the cam; elementwise.

        `pose` has the sizes alone, and the angle counts from the begin of the law. The profile is parallel to the pitch curve,
        the path of the follower's point on the cam (R. L. Norton, Cam Design and Manufacturing Handbook, 2nd ed., 2009, chapter
        7); where it is undercut its radius is negative, and where it is flat or hollow very large.
        """
        centre, guide = pose.local(self.against, self.pivot), _guide(pose, self.follower, self.against)
        lowest, size = self.lowest(pose), self.sense * pose.size(self.lift)
        lift, first, second = (size * part for part in as_jet(self.law(Jet(turned, 1.0))).parts)
        if guide is not None:
            begin, way = pose.local_line(guide, self.against)
            begin = minus(begin, centre)
            outwards = sign(lowest + dot(begin, way))
            along, rate, bend = lowest + lift, (first * way[0], first * way[1]), (second * way[0], second * way[1])
            point = begin[0] + along * way[0], begin[1] + along * way[1]
            if not self.contact:
                return 0.0 * along, outwards * (dot(point, way) + second)
        else:
            link = pose.mechanism.bodies[self.follower]
            begin, length = minus(pose.local(self.against, link.start), centre), pose.size(link.length)
            (c, s), (c_low, s_low) = unit(lowest + lift), unit(lowest)
            way, outwards = (-s, c), sign(cross((c_low, s_low), begin))
            point = begin[0] + length * c, begin[1] + length * s
            rate = first * length * way[0], first * length * way[1]
            square = first * first
            bend = length * (second * way[0] - square * c), length * (second * way[1] - square * s)
        rate_on_cam = rate[0] + point[1], rate[1] - point[0]
        bend_on_cam = bend[0] + 2.0 * rate[1] - point[0], bend[1] - 2.0 * rate[0] - point[1]
        speed = np.sqrt(dot(rate_on_cam, rate_on_cam))
        normal = -outwards * rate_on_cam[1], outwards * rate_on_cam[0]
        cube, flattest = speed * speed * speed, FLATTEST * np.sqrt(dot(point, point))
        radius = cube / np.maximum(-cross(rate_on_cam, bend_on_cam), cube / flattest) - pose.size(self.roller)
        return np.arctan2(cross(way, normal), dot(way, normal)), radius

    def disc(self, pose: Pose) -> DiscCam:
        """Return the disc cam in the axes of the body that carries the follower, about the pivot of the cam."""
        follower, rail = pose.mechanism.bodies[self.follower], _guide(pose, self.follower, self.against)
        begin, roller, centre = float(self.lowest(pose)), float(pose.size(self.roller)), pose.local(self.against, self.pivot)
        guide: Slide | Arm
        if rail is not None:
            point, line = pose.local_line(rail, self.against)
            away = minus(point, centre)
            lowest, offset = begin + float(dot(line, away)), -float(cross(line, away))
            sense = math.copysign(1.0, lowest)
            guide = Slide(math.atan2(sense * line[1], sense * line[0]), sense * offset)
            base = math.hypot(lowest, offset) if self.contact else abs(lowest)
        else:
            pivot = minus(pose.local(self.against, follower.start), centre)
            length, lowest = float(pose.size(follower.length)), begin - math.atan2(-pivot[1], -pivot[0])
            sense = math.copysign(1.0, math.remainder(lowest, TURN))
            guide = Arm((float(pivot[0]), float(pivot[1])), length, side=int(sense))
            base = abs(length * np.exp(1j * lowest) - math.hypot(*pivot))
        scale, phase = sense * self.sense * float(pose.size(self.lift)), float(pose.size(self.phase))

        def lift(angles: Array) -> tuple[Array, Array, Array]:
            value, rate, bend = as_jet(self.law(Jet(angles - phase, 1.0))).parts
            return scale * value, scale * rate, scale * bend

        contact: Contact = Roller(roller) if self.contact else Face()
        return DiscCam(lift, guide, contact, base - roller, tuple(knot + phase for knot in self.law.knots))

    def profiles(self, pose: Pose) -> Iterator[tuple[str, Profile]]:
        """Yield the profile of the cam with its base circle and pitch curve, and the roller or the flat face of the follower."""
        disc, centre = self.disc(pose), _array(pose.local(self.cam, self.pivot))
        for profile in disc.profiles:
            yield self.cam, profile.moved(centre)
        if self.contact and self.roller:
            yield self.cam, Profile(disc.polyline(pitch=True), auxiliary=True).moved(centre)
            yield self.follower, Profile(_array(pose.local(self.follower, self.contact))[None], float(pose.size(self.roller)))
        guide = _guide(pose, self.follower, self.against)
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

    def actions(self, places: Places, effort: Value) -> Iterator[Action]:
        """Yield the actions on the follower and on the cam."""
        pose, guide = places.pose, _guide(places.pose, self.follower, self.against)
        centre = places.place(self.pivot)
        turned = as_jet(self._turned(pose)).value
        slope = self.sense * _size(pose, self.lift) * as_jet(self.law(Jet(turned, 1.0))).rate  # per rotation of the cam
        if guide is not None:
            line = places.line(guide)
            common = plus(centre, turn((0.0, -slope), line))  # its velocity on the cam is that of the follower
            at = places.place(self.contact) if self.contact else plus(common, line)
            normal = minus(at, common)
            size = effort / dot(normal, line)
        else:
            pivot = places.place(pose.mechanism.bodies[self.follower].start)
            between = minus(pivot, centre)
            share = slope / (slope - 1.0)
            common = centre[0] + share * between[0], centre[1] + share * between[1]
            at = places.place(self.contact)
            normal = minus(at, common)
            size = effort / cross(minus(at, pivot), normal)
        force = size * normal[0], size * normal[1]
        yield Action(self.follower, force, at)
        yield Action(self.cam, (-force[0], -force[1]), at)


def disc_cams(pose: Pose) -> dict[Cam, DiscCam]:
    """Return the disc cams of a mechanism in the axes of the bodies that carry their followers."""
    return {element: element.disc(pose) for element in pose.mechanism.elements if isinstance(element, Cam)}


def _guide(pose: Pose, slider: str, on: str) -> Guide | None:
    """Return the guide of a body on another; None if a pin joins them."""
    return next((guide for guide in pose.mechanism.guides if guide.bodies == (slider, on)), None)


def _between(pose: Pose, body: str, carrier: str) -> dict[Joint, Value]:
    """Return the terms of the slide of a body on another, or of its angle relative to it."""
    guide = _guide(pose, body, carrier)
    return _terms((body, 1.0), (carrier, -1.0)) if guide is None else {guide: 1.0}


def _terms(*terms: tuple[Joint | None, Value]) -> dict[Joint, Value]:
    """Return the coefficients of angles and slides; the frame has none."""
    return {joint: coefficient for joint, coefficient in terms if joint is not None and joint != FRAME}
