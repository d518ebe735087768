"""Mechanisms as data: ground points, a driving crank and dyads solved one after the other.

Sizes are names of parameters, so one description applies to every design: `pose` takes the parameters and the crank's direction,
each a Value (float, batch, symbol or jet), and returns positions and assembly margins.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from optlink.linkage.bodies import (
    FRAME as FRAME,
    Arm as Arm,
    BodyPoint as BodyPoint,
    Ground as Ground,
    Guide as Guide,
    Joint as Joint,
    Link as Link,
    Size as Size,
)
from optlink.linkage.elements import Drive, Element
from optlink.linkage.jet import Jet, as_jet
from optlink.linkage.trains import Single, Train
from optlink.linkage.vector2d import TURN, Array, Value, Vector, angle, angle_from, cross, dot, minus, plus, turn, turn_back, unit

# Sides of a group over the crank angle, and its Taylor series about singular positions.
#
# At a singular position the formulas of a dyad are 0/0. The joint itself moves smoothly: there its position is a power series in
# the crank angle, whose derivatives are the velocities and accelerations.

BEYOND_CIRCLE = 2.0 * (1.0 + 1e-9)
"""Radius of the circle from which a series was computed, over its window."""


@dataclass(frozen=True)
class Passage:
    """Power series (2, terms) of two coordinates in crank angle - `crank_angle` [rad], accurate within `window` [rad]."""

    crank_angle: float
    window: float
    series: Array

    def place(self, angle: Value, delta: Value) -> Vector:
        """Evaluate the two coordinates at the distance `delta` [rad] from `crank_angle`.

        They are jets if `angle`, the crank angle, is one: of that only the derivatives are used.
        """
        if not isinstance(angle, Jet):
            x, y = _polynomials(self.series, delta)
            return x, y
        (x, y), (x_rate, y_rate), (x_bend, y_bend) = (_polynomials(rows, delta) for rows in self._derivatives)
        rate, square, acceleration = angle.rate, angle.rate * angle.rate, angle.acceleration
        return (
            Jet(x, x_rate * rate, x_bend * square + x_rate * acceleration),
            Jet(y, y_rate * rate, y_bend * square + y_rate * acceleration),
        )

    @cached_property
    def _derivatives(self) -> tuple[Array, Array, Array]:
        """The series, and its first and second derivative with respect to the crank angle."""
        first = self.series[:, 1:] * np.arange(1, self.series.shape[1])
        return self.series, first, first[:, 1:] * np.arange(1, first.shape[1])


def _polynomials(rows: Array, delta: Value) -> Iterator[Value]:
    """Yield the values of polynomials (polynomials, terms), by Horner's rule."""
    if isinstance(delta, np.ndarray):
        yield from np.polynomial.polynomial.polyval(delta, rows.T)
        return
    for row in rows:
        value = 0.0
        for coefficient in reversed(row.tolist()):
            value = value * delta + coefficient
        yield value


@dataclass(frozen=True)
class GroupPassages:
    """Sides and passages of a group over the crank angle [rad], from `origin` to `origin + cycle`; they repeat with this period.

    `sides` (n + 1,): assembly modes before, between and after the rising crank angles `breaks` (n,).
    """

    origin: float
    cycle: float
    breaks: Array
    sides: Array
    passages: tuple[Passage, ...]

    def side(self, angle: Value) -> Value:
        """Return the assembly mode at a crank angle."""
        value = as_jet(angle).value
        if _numeric(value):
            within = self.origin + np.remainder(np.real(value) - self.origin, self.cycle)
            return self.sides[np.searchsorted(self.breaks, within, side="right")]
        within = self.origin + np.remainder(value - self.origin, self.cycle)
        changes = zip(np.diff(self.sides), self.breaks, strict=True)
        return self.sides[0] + sum(float(change) * (within >= float(at)) for change, at in changes if change)

    def through(self, angle: Value, formula: Callable[[Value], tuple[Vector, Value]]) -> tuple[Vector, Value]:
        """Return the result of a dyad formula at a crank angle [rad], near singular positions replaced by its series.

        The formula maps the assembly mode to the joint [m], or the unit vector of the guide, and the assembly margin. Margins
        that are rounding errors near singular positions become zero, except those of symbols.
        """
        value = as_jet(angle).value
        number = _numeric(value)
        away = [value - passage.crank_angle for passage in self.passages]
        away = [delta - self.cycle * np.round((np.real(delta) if number else delta) / self.cycle) for delta in away]
        turns = number and np.iscomplexobj(value)
        new, margin = formula(self._side_of_series(value, away, formula) if turns else self.side(angle))
        for passage, delta in zip(self.passages, away, strict=True):
            near = np.abs(delta) < passage.window
            if number and not np.any(near):
                continue
            place = passage.place(angle, np.where(near, delta, 0.0) if number else delta)
            new = _either(near, place[0], new[0]), _either(near, place[1], new[1])
            if number:
                margin = _either(near & ~(np.real(as_jet(margin).value) >= 0.0), 0.0, margin)
        return new, margin

    def _side_of_series(self, value: Value, away: list[Value], formula: Callable[[Value], tuple[Vector, Value]]) -> Value:
        """Return the assembly mode at complex crank angles.

        Round a singular position the two solutions exchange their places where the square root has its branch cut, which is known
        only roughly; the one that continues the motion is the one closer to its series.
        """
        side = self.side(value)
        both = [formula(mode)[0] for mode in (1, -1)]
        for passage, delta in zip(self.passages, away, strict=True):
            near = np.abs(delta) <= BEYOND_CIRCLE * passage.window
            if np.any(near):
                place = passage.place(value, np.where(near, delta, 0.0))
                one, other = (sum(np.abs(x - y) ** 2 for x, y in zip(new, place, strict=True)) for new in both)
                side = np.where(near, np.where(one <= other, 1, -1), side)
        return side


def _either(which: Value, one: Value, other: Value) -> Value:
    """Elementwise selection, of jets too."""
    if not isinstance(one, Jet) and not isinstance(other, Jet):
        return np.where(which, one, other)
    return Jet(*(np.where(which, x, y) for x, y in zip(as_jet(one).parts, as_jet(other).parts, strict=True)))


def _numeric(x: Value) -> bool:
    """Return whether a value is a number or an array of numbers, not a symbol."""
    return isinstance(x, float | int | complex | np.ndarray | np.generic)


@dataclass(frozen=True)
class Dyad:
    """Base class of all dyads: two bodies that can be placed once their neighbours are.

    `kind`: RRR, RRP, RPR, RPP or PRP; `least`: assembly margin below which it cannot be assembled.
    """

    first: Link
    second: Link

    kind: ClassVar[str]
    least: ClassVar[float] = 0.0

    @property
    def joint(self) -> str:
        """Name of the inner joint, also used as the name of the group."""
        raise NotImplementedError

    @property
    def links(self) -> tuple[Link, Link]:
        """The two bodies that the group adds."""
        return self.first, self.second

    @property
    def outer_pins(self) -> tuple[tuple[str, str], ...]:
        """Bodies of the group with their pins to bodies placed before."""
        return ()

    @property
    def prismatic(self) -> tuple[Guide, ...]:
        """Guides of the group."""
        return ()

    @property
    def modes(self) -> tuple[str, ...]:
        """Assembly modes, in the notation of the problem file."""
        return ()

    @property
    def passages(self) -> GroupPassages | None:
        """Sides and series through singular positions, if the group is continued through them."""
        return None

    def solve(self, pose: Pose) -> Value:
        """Add the points and bodies of the group to `pose`; return the assembly margin."""
        raise NotImplementedError

    def gap(self, pose: Pose) -> Value:
        """Return the distance [m] by which the group fails to close; negative where it closes."""
        raise NotImplementedError

    def alignment(self, pose: Pose) -> Value:
        """Return the squared sine of the angle between the group and its alignment.

        It is zero at a singular position and negative beyond it.
        """
        raise NotImplementedError

    def forces(self, balance: Any, tilts: Mapping[str, Value]) -> Any:
        """Return the `GroupForces` of the joints from what is required of the bodies, by default from the three joints.

        Parameters
        ----------
        balance : ForceBalance
            Wrenches that the joints must exert, and the motion.
        tilts : mapping of str to float
            Tangents of the friction angles of guides with friction.
        """
        return balance.jointed_forces(self, tilts)


class Pose:
    """Positions of all points and bodies of a mechanism, computed group by group.

    `points` in [m], `directions` of bodies as unit vectors, `turns`: angles [rad] of those that drives and couplings place,
    `margins` by joint.
    """

    __slots__ = ("angle", "directions", "margins", "mechanism", "points", "sizes", "turns")

    def __init__(self, mechanism: Mechanism, sizes: Mapping[str, Value], crank_angle: Value = None) -> None:
        self.mechanism, self.sizes, self.angle = mechanism, sizes, crank_angle
        self.points: dict[str, Vector] = {}
        self.directions: dict[str, Vector] = {FRAME: (1.0, 0.0)}
        self.turns: dict[str, Value] = {FRAME: 0.0}
        self.margins: dict[str, Value] = {}

    def add(self, group: Dyad) -> None:
        """Place the bodies of a group whose neighbours are placed, and those that couplings place after it."""
        self.margins[group.joint] = group.solve(self)
        for train in self.mechanism.placed_after.get(group.joint, ()):
            train.solve(self)

    def with_group(self, group: Dyad) -> Pose:
        """Return this pose with one more group; this one is unchanged."""
        pose = Pose(self.mechanism, self.sizes, self.angle)
        pose.points, pose.directions, pose.margins = dict(self.points), dict(self.directions), dict(self.margins)
        pose.turns = dict(self.turns)
        pose.add(group)
        return pose

    def size(self, size: Size) -> Value:
        """Return the value of a parameter, or a number unchanged."""
        return self.sizes[size] if isinstance(size, str) else size

    def local(self, body: str, point: str) -> Vector:
        """Return the coordinates of a point in the axes of a body [m].

        Parameters
        ----------
        body : str
            Name of the body, `FRAME` for the frame.
        point : str
            Name of a point of that body.
        """
        if body == FRAME:
            return self.fixed(self.mechanism.ground[point])
        link = self.mechanism.bodies[body]
        if point == link.start:
            return 0.0, 0.0
        if point == link.end:
            return self.size(link.length), 0.0
        mark = self.mechanism.marks[body, point]
        return self.size(mark.along), self.size(mark.across)

    def fixed(self, place: Ground) -> Vector:
        """Return the coordinates of a point of the frame [m]."""
        if not isinstance(place, Arm):
            return self.size(place[0]), self.size(place[1])
        length, (c, s) = self.size(place.length), unit(self.size(place.direction))
        return plus(self.fixed(self.mechanism.ground[place.origin]), (length * c, length * s))

    def point(self, name: str) -> Vector:
        """Return the position of a point [m]; points fixed on a placed body are computed on demand."""
        if name not in self.points:
            body = next(body for body in self.mechanism.owners[name] if self._placed(body))
            link = self.mechanism.bodies[body]
            (x, y), (along, across), (c, s) = self.points[link.start], self.local(body, name), self.direction(body)
            if isinstance(across, float) and across == 0.0:  # on the axis: half of the work
                self.points[name] = x + along * c, y + along * s
            else:
                self.points[name] = plus((x, y), turn((along, across), (c, s)))
        return self.points[name]

    def direction(self, body: str) -> Vector:
        """Return the unit vector of a body's x axis."""
        if body not in self.directions:
            link = self.mechanism.bodies.get(body) or self.mechanism.rods[body]
            (x, y), length = minus(self.points[link.end], self.points[link.start]), self.size(link.length)
            self.directions[body] = x / length, y / length
        return self.directions[body]

    def turned(self, body: str) -> Value:
        """Return the angle of a placed body [rad], which grows by a revolution in each turn of the body.

        A body of a group is taken to swing by less than a revolution, about its angle in `Mechanism.middles`.
        """
        if body not in self.turns:
            middle = self.mechanism.middles.get(body, 0.0)
            self.turns[body] = middle + angle_from(unit(middle), self.direction(body))
        return self.turns[body]

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the crank angles at which the pose is computed."""
        known = self.directions[self.mechanism.crank.body][0] if self.angle is None else self.angle
        return np.shape(as_jet(known).value)

    def line(self, guide: Guide, body: str) -> tuple[Vector, Vector]:
        """Return a point [m] and the unit vector of a guide's line, from the position of one of its bodies.

        Parameters
        ----------
        guide : Guide
        body : str
            Name of one of the two bodies of the guide; it must be placed.
        """
        point, direction = self.local_line(guide, body)
        if body == FRAME:
            return point, direction
        axis, start = self.direction(body), self.point(self.mechanism.bodies[body].start)
        return plus(start, turn(point, axis)), turn(direction, axis)

    def local_line(self, guide: Guide, body: str) -> tuple[Vector, Vector]:
        """Return a point [m] and the unit vector of a guide's line in the axes of one of its bodies.

        Parameters
        ----------
        guide : Guide
        body : str
            Name of one of the two bodies of the guide.
        """
        if body == guide.slider:
            at = guide.at or self.mechanism.bodies[body].start
            return self.local(body, at), unit(-self.size(guide.tilt))
        x, y = self.local(body, guide.through) if isinstance(guide.through, str) else map(self.size, guide.through)
        (c, s), offset = unit(self.size(guide.direction)), self.size(guide.offset)
        return (x - offset * s, y + offset * c), (c, s)

    def slide(self, guide: Guide) -> Value:
        """Return the displacement of the slider along its line [m]."""
        begin, direction = self.line(guide, guide.on)
        return dot(minus(self.point(guide.at or self.mechanism.bodies[guide.slider].start), begin), direction)

    def coordinate(self, output: str) -> Value:
        """Return the coordinate [m] of an output: the slide in a guide, or that of a point, "P.x" or "P.y"."""
        point, _, axis = output.rpartition(".")
        if point:
            return self.point(point)["xy".index(axis)]
        return self.slide(next(guide for guide in self.mechanism.guides if guide.name == output))

    def distance(self, link: Link, p: str, q: str) -> Value:
        """Return the distance between two points of a body [m].

        Parameters
        ----------
        link : Link
        p, q : str
            Names of the two points.
        """
        if {p, q} == {link.start, link.end}:
            return self.size(link.length)
        lever = minus(self.local(link.body, q), self.local(link.body, p))
        return np.sqrt(dot(lever, lever))

    def fit(self, link: Link, p: str, q: str) -> None:
        """Place a body by two of its points whose positions are known.

        Parameters
        ----------
        link : Link
        p, q : str
            Names of the two points.
        """
        if {p, q} != {link.start, link.end}:
            lever = minus(self.local(link.body, q), self.local(link.body, p))
            square = dot(lever, lever)
            x, y = turn_back(minus(self.points[q], self.points[p]), lever)
            self.place(link, (x / square, y / square), p)

    def place(self, link: Link, direction: Vector, point: str) -> None:
        """Place a body by its direction and one of its points whose position is known.

        Parameters
        ----------
        link : Link
        direction : pair of Value [-]
            Unit vector of the body's x axis.
        point : str
            Name of the point.
        """
        self.directions[link.body] = direction
        if link.start not in self.points:
            self.points[link.start] = minus(self.points[point], turn(self.local(link.body, point), direction))
        if link.end and link.end not in self.points:
            self.point(link.end)

    def offset(self, guide: Guide, link: Link, point: str) -> Value:
        """Return the distance of a point of a body to the left of a guide's line [m].

        Parameters
        ----------
        guide : Guide
        link : Link
            One of the two bodies of the guide.
        point : str
            Name of a point of that body.
        """
        begin, direction = self.local_line(guide, link.body)
        return cross(direction, minus(self.local(link.body, point), begin))

    def _placed(self, body: str) -> bool:
        if body == FRAME:
            return False
        link = self.mechanism.bodies[body]
        return link.start in self.points and (body in self.directions or link.end in self.points)


@dataclass(frozen=True, repr=False)
class Mechanism:
    """A planar mechanism: ground, driving crank and ordered dyads, with points fixed on bodies and guides.

    `datum` [rad] is the direction from which crank angles are measured, itself measured from +x. `cycle` [rad] is the crank
    rotation after which the motion repeats: more than a revolution where groups are continued through change points.

    With `drives`, the crank angle is the cycle variable of their laws, and `crank` the body that the first of them drives: one of
    the `trains`, or the link whose length a cylinder prescribes. Couplings place further trains. `limits` [rad] of the crank
    angle, if there are any, bound the motion that is asked for; `middles` [rad]: angles about which coupled bodies swing.
    """

    name: str
    ground: Mapping[str, Ground]
    crank: Link
    groups: tuple[Dyad, ...]
    points: tuple[BodyPoint, ...] = field(default=())
    guides: tuple[Guide, ...] = field(default=())
    datum: Size = 0.0
    cycle: float = 2.0 * np.pi
    trains: tuple[Train, ...] = ()
    drives: tuple[Drive, ...] = ()
    limits: tuple[float, float] | None = None
    middles: Mapping[str, float] = field(default_factory=dict)

    def __repr__(self) -> str:
        return f"<Mechanism {self.name!r}: {', '.join(self.bodies)}>"

    @property
    def extent(self) -> tuple[float, float]:
        """Crank angles [rad] between which the motion counts: its limits, else a revolution from 0."""
        return self.limits or (0.0, TURN)

    @property
    def returns(self) -> bool:
        """Whether the drive moves through its limits there and back: they are not those of a law, which runs once."""
        return self.limits is not None and all(drive.law is None for drive in self.drives)

    @cached_property
    def followed(self) -> bool:
        """Whether a group is continued through change points."""
        return any(group.passages is not None for group in self.groups)

    @cached_property
    def links(self) -> tuple[Link, ...]:
        """All moving bodies, the crank first, in the order in which they are placed."""
        links = [] if self.drives else [self.crank]
        for joint, own in (("", ()), *((group.joint, group.links) for group in self.groups)):
            links += [*own, *(single.link for train in self.placed_after.get(joint, ()) for single in train.singles)]
        return tuple(links)

    @cached_property
    def placed_after(self) -> dict[str, tuple[Train, ...]]:
        """The trains by the joint of the group after which they are placed; empty for those placed before all groups."""
        return {after: tuple(t for t in self.trains if t.after == after) for after in dict.fromkeys(t.after for t in self.trains)}

    @cached_property
    def singles(self) -> tuple[Single, ...]:
        """The bodies that drives and couplings place."""
        return tuple(single for train in self.trains for single in train.singles)

    @cached_property
    def rods(self) -> dict[str, Link]:
        """The rods of cylinders by name, with the links whose direction they have and at whose end they begin."""
        return {drive.rod: self.bodies[drive.body] for drive in self.drives if drive.rod}

    def origin(self, body: str) -> str:
        """Return the point at which the axes of a moving body or of a rod begin."""
        return self.bodies[body].start if body in self.bodies else self.rods[body].end

    @cached_property
    def elements(self) -> tuple[Element, ...]:
        """The drives and couplings."""
        return tuple(dict.fromkeys((*self.drives, *(element for train in self.trains for element in train.elements))))

    @cached_property
    def driven_sizes(self) -> tuple[str, ...]:
        """Names of the lengths that drives prescribe."""
        return tuple(drive.size for drive in self.drives if drive.size)

    @cached_property
    def cylinders(self) -> tuple[str, ...]:
        """Names of the links whose length a drive prescribes."""
        return tuple(drive.body for drive in self.drives if drive.size)

    @cached_property
    def bodies(self) -> dict[str, Link]:
        """The moving bodies by name."""
        return {link.body: link for link in self.links}

    @cached_property
    def marks(self) -> dict[tuple[str, str], BodyPoint]:
        """Further points by body and name."""
        return {(point.body, point.name): point for point in self.points}

    @cached_property
    def owners(self) -> dict[str, tuple[str, ...]]:
        """Every named point with the bodies that share it, the frame first; a point of more than one body is a pin."""
        owners = owners_of(self.ground, self.links, self.points)
        return {name: tuple(bodies) for name, bodies in owners.items()}

    @cached_property
    def pins(self) -> dict[str, tuple[str, ...]]:
        """The revolute joints: points that two or more bodies share."""
        return {name: bodies for name, bodies in self.owners.items() if len(bodies) > 1}

    @cached_property
    def lengths(self) -> tuple[str, ...]:
        """Names of the lengths of links and of arms of the frame, which must be positive."""
        arms = [place.length for place in self.ground.values() if isinstance(place, Arm)]
        return _names(*(link.length for link in self.links if link.length not in self.driven_sizes), *arms)

    @cached_property
    def parameters(self) -> tuple[str, ...]:
        """Names of all sizes: the lengths first, then coordinates and angles."""
        places: list[Size] = [self.datum]
        for place in self.ground.values():
            places += [place.length, place.direction] if isinstance(place, Arm) else place
        for point in self.points:
            places += [point.along, point.across]
        for guide in dict.fromkeys((*self.guides, *(guide for group in self.groups for guide in group.prismatic))):
            places += [guide.direction, guide.offset, guide.tilt]
            places += [] if isinstance(guide.through, str) else guide.through
        for element in self.elements:
            places += element.sizes
        return _names(*self.lengths, *places)

    def link(self, body: str) -> Link:
        """Return the link of a body; KeyError if there is none."""
        return self.bodies[body]

    def at(self, sizes: Mapping[str, Value], crank_angle: Value) -> Pose:
        """Compute the positions of all points at crank angles, see `pose`; jets give velocities and accelerations too.

        Parameters
        ----------
        sizes : mapping of parameter name to Value [m, rad]
        crank_angle : Value [rad]
        """
        return self.pose(sizes, unit(crank_angle), crank_angle)

    def pose(self, sizes: Mapping[str, Value], crank: Vector, crank_angle: Value = None) -> Pose:
        """Compute the positions of all points.

        Parameters
        ----------
        sizes : mapping of parameter name to Value [m, rad]
            Broadcast against the crank: (designs, 1) against (angles,) gives (designs, angles).
        crank : pair of Value
            Unit vector of the crank, relative to the datum of the crank angle.
        crank_angle : Value [rad], optional
            Crank angle, needed by a mechanism that is continued through change points. Default: within the first revolution.

        Returns
        -------
        Pose
            Coordinates in [m], NaN from the first group on that cannot be assembled (its margin is negative).
        """
        known = not (self.followed or self.trains or self.drives)
        pose = self.begin(sizes, crank, angle(crank) if crank_angle is None and not known else crank_angle)
        for group in self.groups:
            pose.add(group)
        for point in self.points:
            pose.point(point.name)
        return pose

    def begin(self, sizes: Mapping[str, Value], crank: Vector, crank_angle: Value) -> Pose:
        """Compute the positions of the frame and of the crank alone; `Pose.add` adds the groups.

        Parameters
        ----------
        sizes, crank, crank_angle
            See `pose`.
        """
        pose = Pose(self, sizes, crank_angle)
        if lengths := {drive.size: drive.value(pose) for drive in self.drives if drive.size}:
            pose.sizes = {**sizes, **lengths}
        for name, place in self.ground.items():
            pose.points[name] = pose.fixed(place)
        if not self.drives:
            if isinstance(self.datum, str) or self.datum != 0.0:
                crank = turn(crank, unit(pose.size(self.datum)))
            pose.turns[self.crank.body] = None if crank_angle is None else pose.size(self.datum) + crank_angle
            pose.place(self.crank, crank, self.crank.start)
        for train in self.placed_after.get("", ()):
            train.solve(pose)
        return pose


def owners_of(ground: Iterable[str], links: Iterable[Link], points: Iterable[BodyPoint]) -> dict[str, list[str]]:
    """Return every named point with the bodies that share it, the frame first."""
    owners = {name: [FRAME] for name in ground}
    for link in links:
        for name in (link.start, link.end, *(point.name for point in points if point.body == link.body)):
            if name:
                owners.setdefault(name, []).append(link.body)
    return owners


def _names(*sizes: Size) -> tuple[str, ...]:
    """Return the sizes that are names of parameters, each once."""
    return tuple(dict.fromkeys(size for size in sizes if isinstance(size, str)))
