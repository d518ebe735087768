"""Machines: a mechanism with sizes, masses, gravity, loads and friction; and a machine in motion."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from optlink.io import without
from optlink.linkage.cams import Profile
from optlink.linkage.jet import as_jet
from optlink.linkage.mechanism import FRAME, Mechanism, Pose
from optlink.linkage.motion import Motion, sweep
from optlink.linkage.stroke import Ranges, reachable
from optlink.linkage.vector2d import (
    TURN,
    Value,
    Vector,
    angle_from,
    cross,
    dot,
    magnitude,
    minus,
    plus,
    sign,
    turn,
    unit,
    whole_turns,
)

# Mass properties of a body, and the wrench that its motion requires, linear in them.
#
# A body's parameters are its mass m, its first moments m*c (c: centroid in the body's own axes) and its moment of inertia about
# the start of the body; the wrench that moves it is their linear function, so a regressor is the wrench of unit parameters.


class Wrench(NamedTuple):
    """A force [N] and the moment [N m] about the start of the body that it acts on."""

    force: Vector
    moment: Value

    def about(self, start: Vector, point: Vector) -> Value:
        """Return the moment about another point [N m]; `start` is that of the body, to which `moment` refers."""
        return self.moment + cross(minus(start, point), self.force)

    def __add__(self, other: Wrench) -> Wrench:  # type: ignore[override]
        return Wrench(plus(self.force, other.force), self.moment + other.moment)

    def __neg__(self) -> Wrench:
        return Wrench((-self.force[0], -self.force[1]), -self.moment)


class Parameters(NamedTuple):
    """Inertial parameters of a body: mass [kg], first moments [kg m], moment of inertia about the start [kg m^2]."""

    mass: Value
    along: Value
    across: Value
    moment: Value


@dataclass(frozen=True)
class Inertia:
    """Mass [kg], centroid in the body's own axes [m], moment of inertia about the centroid [kg m^2]."""

    mass: Value = 0.0
    along: Value = 0.0
    across: Value = 0.0
    moment: Value = 0.0

    @property
    def parameters(self) -> Parameters:
        """The inertial parameters about the start of the body (Steiner)."""
        square = self.along * self.along + self.across * self.across
        return Parameters(self.mass, self.mass * self.along, self.mass * self.across, self.moment + self.mass * square)


class BodyMotion(NamedTuple):
    """Motion of a body: its start [m, m/s, m/s^2], its x axis (unit vector), angular velocity and acceleration."""

    start: Vector
    velocity: Vector
    acceleration: Vector
    axis: Vector
    omega: Value
    alpha: Value

    def at(self, point: Vector) -> tuple[Vector, Vector]:
        """Return the velocity and acceleration of the body's point at a position [m/s, m/s^2]."""
        x, y = minus(point, self.start)
        square = self.omega * self.omega
        velocity = self.velocity[0] - self.omega * y, self.velocity[1] + self.omega * x
        acceleration = (
            self.acceleration[0] - self.alpha * y - square * x,
            self.acceleration[1] + self.alpha * x - square * y,
        )
        return velocity, acceleration


def body_motion(start: Vector, axis: Vector) -> BodyMotion:
    """Return the state of a body from the motion of its start [m] and of its x axis (unit vector), pairs of jets.

    What is not a jet does not move.
    """
    x, y, c, s = as_jet(start[0]), as_jet(start[1]), as_jet(axis[0]), as_jet(axis[1])
    way, turned = (c.value, s.value), cross((c.value, s.value), (c.acceleration, s.acceleration))
    places = (x.value, y.value), (x.rate, y.rate), (x.acceleration, y.acceleration)
    return BodyMotion(*places, way, cross(way, (c.rate, s.rate)), turned)


def wrench(parameters: Parameters, state: BodyMotion, gravity: Vector) -> Wrench:
    """Compute the force and moment (about the start of the body) that joints and loads together exert on a body in motion.

    Gravity [m/s^2] counts as an acceleration of the frame of reference: pass (0, 0) for the inertia alone. These are the
    Newton-Euler equations, with the Steiner term.
    """
    ax, ay = minus(state.acceleration, gravity)
    rx, ry = turn((parameters.along, parameters.across), state.axis)
    square = state.omega * state.omega
    force = (
        parameters.mass * ax - square * rx - state.alpha * ry,
        parameters.mass * ay - square * ry + state.alpha * rx,
    )
    return Wrench(force, parameters.moment * state.alpha + rx * ay - ry * ax)


UNITS = tuple(Parameters(*(float(i == k) for i in range(4))) for k in range(4))
"""One parameter at a time: the wrench of each is a column of the regressor."""


def kinetic(parameters: Parameters, state: BodyMotion) -> Value:
    """Return the kinetic energy [J] of a body."""
    first = turn((parameters.along, parameters.across), state.axis)
    square = dot(state.velocity, state.velocity)
    return (
        0.5 * parameters.mass * square
        + state.omega * cross(first, state.velocity)
        + 0.5 * parameters.moment * state.omega * state.omega
    )


def potential(parameters: Parameters, state: BodyMotion, gravity: Vector) -> Value:
    """Return the potential energy of a body in the field of gravity [m/s^2], zero at the origin [J]."""
    first = turn((parameters.along, parameters.across), state.axis)
    return -(parameters.mass * dot(gravity, state.start) + dot(gravity, first))


INSTANT = 1e-10
"""Crank rotation [rad] from a load jump to the position of its one-sided value."""


NOISE = 1e-13
"""Least motion per crank rotation, relative to the size of the machine; smaller ones are rounding errors."""


class Acting(NamedTuple):
    """A force [N] at a point of a body [m], and a torque [N m] on it."""

    body: str
    point: Vector
    force: Vector = (0.0, 0.0)
    torque: Value = 0.0

    def wrench(self, state: BodyMotion) -> Wrench:
        """Return the force and torque as a wrench about the start of the body."""
        return Wrench(self.force, self.torque + cross(minus(self.point, state.start), self.force))

    def power(self, state: BodyMotion) -> Value:
        """Return the power fed into the machine [W]."""
        return dot(self.force, state.at(self.point)[0]) + self.torque * state.omega


Ends = tuple[tuple[str, str], tuple[str, str]]
"""Body and point, twice."""


class Load:
    """Base class of loads: forces and torques on the bodies of a machine in motion.

    Unless a subclass says otherwise, a load does not jump, stores no energy and is not drawn.
    """

    name: str
    """Name in the problem file."""
    middle: Value = 0.0
    """Angle [rad] from which it counts the swing of a body, whose angle is at most half a revolution from it."""

    def act(self, moving: Moving) -> Iterator[Acting]:
        """Yield the forces and torques of the load, body by body: elementwise on floats, arrays and symbols.

        Parameters
        ----------
        moving : Moving
            Gives positions, velocities and states of the bodies.
        """
        raise NotImplementedError

    @property
    def switching(self) -> bool:
        """Whether the load jumps where a motion reverses."""
        return False

    def reversing(self, moving: Moving) -> tuple[Value, Value] | None:
        """Return the velocity at whose reversal the load jumps, and the corresponding acceleration; None if it does not jump.

        Parameters
        ----------
        moving : Moving
        """
        return None

    def potential(self, moving: Moving) -> Value:
        """Return the potential energy that it stores [J]; its power is otherwise work done on the machine.

        Parameters
        ----------
        moving : Moving
        """
        return 0.0

    @property
    def drawn(self) -> Ends | None:
        """The ends between which a spring is drawn, or two bodies at whose joint a torsion spring is, with no points."""
        return None


@dataclass(frozen=True, repr=False)
class Machine:
    """A mechanism with its masses, loads and friction.

    `inertias` by body (a body without an entry has no mass), `gravity` [m/s^2], `loads`, `friction` coefficients by guide,
    `reported`: body on which the reaction at a pin is reported, where it differs from the default (`inverse.reported_on`),
    `profiles`: curves on bodies, which are only drawn.
    """

    mechanism: Mechanism
    sizes: Mapping[str, Value]
    inertias: Mapping[str, Inertia] = field(default_factory=dict)
    gravity: Vector = (0.0, 0.0)
    loads: tuple[Load, ...] = ()
    friction: Mapping[str, Value] = field(default_factory=dict)
    reported: Mapping[str, str] = field(default_factory=dict)
    profiles: Mapping[str, tuple[Profile, ...]] = field(default_factory=dict)

    def __repr__(self) -> str:
        return f"<Machine {self.mechanism.name!r}: {', '.join(self.mechanism.bodies)}>"

    def motion(self, crank_angle: ArrayLike, speed: Value = 1.0, acceleration: Value = 0.0) -> Motion:
        """Return the motion of its mechanism at crank angles (angles,) [rad]."""
        return sweep(self.mechanism, self.sizes, crank_angle, speed, acceleration)

    def moving(
        self, crank_angle: ArrayLike, speed: Value = 1.0, acceleration: Value = 0.0, side: int = 1, direction: Value = None
    ) -> Moving:
        """Return the machine in motion at crank angles (angles,) [rad].

        `side`: where a load jumps, at the reversal of the motion that it opposes, +1 takes the value just after, -1 that just
        before. `direction` is the sense of crank rotation, by default that of the speed, positive where the crank is at rest.
        """
        return Moving(self, self.motion(crank_angle, speed, acceleration), side, direction)

    def with_(self, **changes: object) -> Machine:
        """Return the machine with some fields replaced."""
        return replace(self, **changes)  # type: ignore[arg-type]

    def kinetic(self, state: Callable[[str], BodyMotion]) -> Value:
        """Return the kinetic energy [J]; `state` maps a body to its State."""
        return sum(kinetic(inertia.parameters, state(body)) for body, inertia in self.inertias.items())

    def weight(self, state: Callable[[str], BodyMotion]) -> Value:
        """Return the potential energy of gravity [J]; `state` maps a body to its State."""
        return sum(potential(inertia.parameters, state(body), self.gravity) for body, inertia in self.inertias.items())

    @cached_property
    def size(self) -> Value:
        """Sum of the link lengths [m], the reference length of the motion."""
        ends = {drive.size: drive.begin for drive in self.mechanism.drives if drive.size}
        lengths = [ends.get(str(link.length), link.length) for link in self.mechanism.links if link.end]
        values = (as_jet(self.sizes[length] if isinstance(length, str) else length).value for length in lengths)
        return sum(values, 0.0) if lengths else 1.0

    @cached_property
    def ranges(self) -> Ranges:
        """Crank ranges in which the mechanism can be assembled."""
        return reachable(self.mechanism, self.sizes)

    @property
    def processes(self) -> list[Process]:
        """Loads with a magnitude that may change: forces and torques."""
        return [load for load in self.loads if isinstance(load, Process)]

    @cached_property
    def revolutions(self) -> int | None:
        """Revolutions of the crank after which motion and loads repeat; None where a load never does."""
        motion = whole_turns(self.mechanism.cycle)
        loads = [getattr(load.magnitude, "revolutions", 1) for load in self.processes]
        return None if None in loads else math.lcm(motion, *loads)

    @property
    def cycle(self) -> float:
        """Crank rotation [rad] after which motion and loads repeat; that of the motion alone where a load never does."""
        return self.mechanism.cycle if self.revolutions is None else self.revolutions * TURN

    @cached_property
    def compiled(self) -> dict[str, Any]:
        """Functions compiled for this machine, by what they compute."""
        return {}

    def __getstate__(self) -> dict[str, Any]:
        """Return the attributes without compiled functions, which are compiled again when needed."""
        return without(vars(self), "compiled")

    @cached_property
    def switching(self) -> bool:
        """Whether a force jumps where a motion reverses."""
        return bool(self.friction) or any(load.switching for load in self.loads)

    @property
    def cornered(self) -> bool:
        """Whether a load may have a corner, a jump or a pole: a row of its table, or a breakpoint of its expression."""
        return any(getattr(load.magnitude, "cornered", False) for load in self.processes)


class Moving:
    """A machine in motion: states of the bodies, computed once and shared by inertia, loads and reactions.

    Where the crank is at rest, the senses of motion are those of a crank that is about to turn in `direction`.
    """

    def __init__(self, machine: Machine, motion: Motion, side: int = 1, direction: Value = None) -> None:
        self.machine, self.motion, self.side = machine, motion, side
        self.direction = np.where(np.asarray(motion.speed) < 0.0, -1.0, 1.0) if direction is None else direction
        self._states: dict[str, BodyMotion] = {}

    @property
    def pose(self) -> Pose:
        """Positions with their time derivatives."""
        return self.motion.pose

    def position(self, point: str, body: str = "") -> Vector:
        """Return the position of a point [m], which is the same on all bodies that share it.

        Parameters
        ----------
        point : str
            Name of a point.
        body : str
            Name of a body with that point; not needed.
        """
        x, y = self.pose.points[point]
        return as_jet(x).value, as_jet(y).value

    def velocity(self, point: str, body: str = "") -> Vector:
        """Return the velocity of a point [m/s].

        Parameters
        ----------
        point : str
            Name of a point.
        body : str
            Name of a body with that point; not needed.
        """
        x, y = self.pose.points[point]
        return as_jet(x).rate, as_jet(y).rate

    def acceleration(self, point: str, body: str = "") -> Vector:
        """Return the acceleration of a point [m/s^2].

        Parameters
        ----------
        point : str
            Name of a point.
        body : str
            Name of a body with that point; not needed.
        """
        x, y = self.pose.points[point]
        return as_jet(x).acceleration, as_jet(y).acceleration

    @property
    def variables(self) -> dict[str, Value]:
        """Variables available to every load: crank angle [rad] and speed [rad/s]."""
        return {"phi": self.motion.crank_angle, "omega": self.motion.speed}

    def line(self, guide: str) -> Vector:
        """Return the unit vector of a guide's line."""
        return self._lines[guide]

    @cached_property
    def _lines(self) -> dict[str, Vector]:
        lines = {}
        for guide in self.machine.mechanism.guides:
            x, y = self.pose.line(guide, guide.on)[1]
            lines[guide.name] = as_jet(x).value, as_jet(y).value
        return lines

    @cached_property
    def slides(self) -> dict[str, tuple[Value, Value, Value]]:
        """Slide in every guide, its velocity and acceleration [m, m/s, m/s^2]."""
        return {guide.name: as_jet(self.pose.slide(guide)).parts for guide in self.machine.mechanism.guides}

    def state(self, body: str) -> BodyMotion:
        """Return the motion of a body."""
        if body not in self._states:
            if body == FRAME:
                nothing = (0.0, 0.0)
                self._states[body] = BodyMotion(nothing, nothing, nothing, (1.0, 0.0), 0.0, 0.0)
            else:
                start = self.pose.points[self.machine.mechanism.origin(body)]
                self._states[body] = body_motion(start, self.pose.direction(body))
        return self._states[body]

    def sense(self, of: Callable[[Moving], tuple[Value, Value]], size: Value = 1.0) -> Value:
        """Return the sign of a velocity; where it reverses, the sign just after (or before); zero for rounding errors.

        `of` maps a machine in motion to the velocity and its acceleration; `size` is that of the machine [m] for the velocity
        of a point, 1 for an angular velocity.

        Parameters
        ----------
        of : function of (machine in motion)
            Returns the velocity and its acceleration.
        size : Value [m]
            Of the machine for the velocity of a point, 1 for an angular velocity.
        """
        source = self.turning
        rate, acceleration = of(source)
        speed, turning = source.motion.speed, source.motion.crank_acceleration
        first = rate / speed  # per crank rotation, as is the second
        second = (acceleration - first * turning) / (speed * speed)
        ahead = first + (self.side * INSTANT) * self.direction * second
        moves = sign(sign(magnitude(first) + INSTANT * magnitude(second) - NOISE * size) + 1.0)  # 0: no motion
        return self.direction * sign(ahead) * moves

    @property
    def turning(self) -> Moving:
        """The same positions with the crank in motion."""
        return self._geared if self._still else self

    @cached_property
    def _still(self) -> bool:
        """Whether the crank is at rest at any position."""
        speed = self.motion.speed
        return isinstance(speed, float | int | np.ndarray | np.generic) and bool(np.any(np.asarray(speed) == 0.0))

    @cached_property
    def _geared(self) -> Moving:
        """The same positions at a crank speed of 1 rad/s."""
        return self.machine.moving(self.motion.crank_angle, self.direction, 0.0, self.side, self.direction)

    def scaled(self, speed: Value, acceleration: Value, direction: Value) -> Moving:
        """Return the motion at another crank speed and acceleration; this motion must have a constant speed of 1 rad/s.

        `direction` is the sense of crank rotation, +1 or -1.

        Parameters
        ----------
        speed : Value [rad/s]
        acceleration : Value [rad/s^2]
        direction : Value
            Sense of crank rotation, +1 or -1.
        """
        return Moving(self.machine, self.motion.scaled(speed, acceleration), self.side, direction)

    @cached_property
    def kinetic(self) -> Value:
        """Kinetic energy [J]."""
        return self.machine.kinetic(self.state)

    @cached_property
    def potential(self) -> Value:
        """Potential energy of gravity and springs [J]."""
        return self.machine.weight(self.state) + sum(load.potential(self) for load in self.machine.loads)


def slider_names(machine: Machine) -> dict[str, str]:
    """Return the name of the slide of every guide: the slider's name, or the guide's name where one body slides in two guides."""
    sliders = [guide.slider for guide in machine.mechanism.guides]
    return {g.name: g.slider if sliders.count(g.slider) == 1 else g.name for g in machine.mechanism.guides}


# Loads on a machine in addition to inertia and gravity: forces, torques, springs, dampers.
#
# A load is an object that returns the forces it exerts on a machine in motion. Forces may be constant, follow a table or
# expression, oppose the motion, or act in one stroke only; the stroke is determined from the motion.

Magnitude = Callable[[Mapping[str, Value]], Value]
"""Force [N] or torque [N m] from phi (crank angle) [rad], omega (crank speed), and s, v of a slider or theta, w of a body."""

Stroke = Literal["both", "forward", "backward"]


@dataclass(frozen=True)
class Process(Load):
    """Base class of forces and torques: they may oppose the motion, act in one stroke, and react on another body."""

    name: str
    body: str
    opposing: bool = field(default=False, kw_only=True)
    stroke: Stroke = field(default="both", kw_only=True)
    turning: bool = field(default=False, kw_only=True)
    """The stroke is that of a crank that turns counter-clockwise; clockwise it is the other one."""
    against: str = field(default=FRAME, kw_only=True)
    """The body on which the reaction acts."""
    moves: ClassVar[str] = "turn"
    """What the body does where the load acts, in words."""

    if TYPE_CHECKING:  # a field of every subclass

        @property
        def magnitude(self) -> Magnitude:
            """Force [N] or torque [N m]."""

    @property
    def switching(self) -> bool:
        """Whether the load jumps where the motion reverses."""
        return self.opposing or self.stroke != "both"

    @property
    def guide(self) -> str:
        """The guide along which the load acts, if it does."""
        return ""

    def reversing(self, moving: Moving) -> tuple[Value, Value]:
        """Return velocity and acceleration of the motion that the load opposes, relative to the body that takes the reaction."""
        raise NotImplementedError

    def extent(self, machine: Machine) -> Value:
        """Return the velocity of that motion per crank speed that is large: 1, or the size of the machine [m]."""
        return 1.0

    def known(self, moving: Moving) -> dict[str, Value]:
        """Return the variables of the magnitude: crank angle [rad] and speed, and those of the body on which the load acts."""
        return moving.variables

    def size(self, moving: Moving) -> Value:
        """Return the magnitude with its sign: against a positive velocity if the load opposes it, zero in the other stroke."""
        magnitude = self.magnitude(self.known(moving))
        if not self.switching:
            return magnitude * 1.0
        sign, share = moving.sense(self.reversing, self.extent(moving.machine)), 1.0
        if self.stroke != "both":
            way = moving.direction if self.turning else 1.0
            share = 0.5 * (1.0 + (sign if self.stroke == "forward" else -sign) * way)
        return magnitude * (share * (-sign if self.opposing else 1.0))


@dataclass(frozen=True)
class Force(Process):
    """A force on a point of a body, along a direction fixed in the plane or along the guide of a slider."""

    point: str
    magnitude: Magnitude
    direction: float | str  # angle [rad], or the guide that the body slides in
    moves: ClassVar[str] = "move in this direction"

    @property
    def guide(self) -> str:
        """The guide along which the load acts, if it does."""
        return self.direction if isinstance(self.direction, str) else ""

    def extent(self, machine: Machine) -> Value:
        """Return the size of the machine [m]."""
        return machine.size

    def reversing(self, moving: Moving) -> tuple[Value, Value]:
        """Return the velocity and acceleration along the direction, relative to the body that takes the reaction."""
        if self.guide:
            return moving.slides[self.guide][1:]
        way, other = unit(self.direction), moving.state(self.against)
        velocity, acceleration = other.at(moving.position(self.point, self.body))
        slip = minus(moving.velocity(self.point, self.body), velocity)
        rate = minus(moving.acceleration(self.point, self.body), acceleration)
        # the point of the other body that the force meets changes: its velocity does so by omega x slip
        return dot(way, slip), dot(way, (rate[0] + other.omega * slip[1], rate[1] - other.omega * slip[0]))

    def known(self, moving: Moving) -> dict[str, Value]:
        """Return the variables of the magnitude: crank angle and speed; of a slider its slide and velocity [SI]."""
        if not self.guide:
            return moving.variables
        s, v, _ = moving.slides[self.guide]
        return {**moving.variables, "s": s, "v": v}

    def act(self, moving: Moving) -> Iterator[Acting]:
        """Yield the force, and its reaction on the other body."""
        size = self.size(moving)
        x, y = moving.line(self.guide) if self.guide else unit(self.direction)
        at, force = moving.position(self.point, self.body), (size * x + 0.0, size * y + 0.0)  # + 0.0: avoids -0.0
        yield Acting(self.body, at, force)
        if self.against != FRAME:
            yield Acting(self.against, at, (-force[0], -force[1]))


@dataclass(frozen=True)
class Torque(Process):
    """A torque on a body; `middle` [rad]: the angle of the body that the magnitude sees is at most half a revolution from it."""

    magnitude: Magnitude
    middle: Value = 0.0

    def reversing(self, moving: Moving) -> tuple[Value, Value]:
        """Return the angular velocity and acceleration of the body relative to the other."""
        state, other = moving.state(self.body), moving.state(self.against)
        return state.omega - other.omega, state.alpha - other.alpha

    def known(self, moving: Moving) -> dict[str, Value]:
        """Return the variables of the magnitude: crank angle and speed, angle of the body and its relative speed [SI]."""
        theta = self.middle + angle_from(unit(self.middle), moving.state(self.body).axis)
        return {**moving.variables, "theta": theta, "w": self.reversing(moving)[0]}

    def act(self, moving: Moving) -> Iterator[Acting]:
        """Yield the torque, and its reaction on the other body."""
        state = moving.state(self.body)
        torque = self.size(moving)
        yield Acting(self.body, state.start, torque=torque)
        if self.against != FRAME:
            yield Acting(self.against, moving.state(self.against).start, torque=-torque)


@dataclass(frozen=True)
class Spring(Load):
    """A linear spring and damper between two points: `stiffness` [N/m], `free` length [m], `damping` [N s/m].

    `push`: a force [N] over their distance s and its rate v, which drives them apart.
    """

    name: str
    ends: Ends
    stiffness: Value
    free: Value
    damping: Value
    push: Magnitude | None = None

    @property
    def drawn(self) -> Ends:
        """Its ends."""
        return self.ends

    def length(self, moving: Moving) -> Value:
        """Return the distance of the two points [m]."""
        return self._stretch(moving)[0]

    def _stretch(self, moving: Moving) -> tuple[Value, Vector, Value]:
        """Length, direction from the first end to the second, rate of the length."""
        (one, p), (other, q) = self.ends
        between = minus(moving.position(q, other), moving.position(p, one))
        length = np.sqrt(dot(between, between))
        along = (between[0] / length, between[1] / length)
        return length, along, dot(along, minus(moving.velocity(q, other), moving.velocity(p, one)))

    def act(self, moving: Moving) -> Iterator[Acting]:
        """Yield the forces of the spring on both ends."""
        length, (x, y), rate = self._stretch(moving)
        pull = self.stiffness * (length - self.free) + self.damping * rate
        if self.push is not None:
            pull = pull - self.push({"s": length, "v": rate})
        for (body, point), direction in zip(self.ends, (1.0, -1.0), strict=True):
            yield Acting(body, moving.position(point, body), (direction * pull * x, direction * pull * y))

    def potential(self, moving: Moving) -> Value:
        """Return the energy stored in the spring [J]."""
        stretch = self._stretch(moving)[0] - self.free
        return 0.5 * self.stiffness * stretch * stretch


@dataclass(frozen=True)
class TorsionSpring(Load):
    """A torsion spring and damper between two bodies: `stiffness` [N m/rad], `free` angle [rad], `damping` [N m s/rad].

    `middle` [rad]: relative angle of the bodies near the middle of the swing, at most half a revolution from `free`; the
    deflection is measured from there, so a swing of less than a revolution crosses no branch cut.
    """

    name: str
    body: str
    against: str
    stiffness: Value
    free: Value
    damping: Value
    middle: Value = 0.0

    @property
    def drawn(self) -> Ends:
        """The two bodies."""
        return (self.body, ""), (self.against, "")

    def _deflection(self, moving: Moving) -> Value:
        axis, other = moving.state(self.body).axis, moving.state(self.against).axis
        return self.middle - self.free + angle_from(turn(other, unit(self.middle)), axis)

    def act(self, moving: Moving) -> Iterator[Acting]:
        """Yield the torque of the spring on both bodies."""
        body, against = moving.state(self.body), moving.state(self.against)
        torque = -self.stiffness * self._deflection(moving) - self.damping * (body.omega - against.omega)
        yield Acting(self.body, body.start, torque=torque)
        yield Acting(self.against, against.start, torque=-torque)

    def potential(self, moving: Moving) -> Value:
        """Return the energy stored in the spring [J]."""
        deflection = self._deflection(moving)
        return 0.5 * self.stiffness * deflection * deflection


@dataclass(frozen=True)
class SlideDamper(Load):
    """Viscous damping in a guide: `damping` [N s/m]."""

    name: str
    guide: str
    slider: str
    on: str
    point: str
    damping: Value

    def act(self, moving: Moving) -> Iterator[Acting]:
        """Yield the damping force on the slider, and its reaction on the body that carries the line."""
        x, y = moving.line(self.guide)
        force = -self.damping * moving.slides[self.guide][1]
        point = moving.position(self.point, self.slider)
        yield Acting(self.slider, point, (force * x, force * y))
        if self.on != FRAME:
            yield Acting(self.on, point, (-force * x, -force * y))


@dataclass(frozen=True)
class EndStops(Load):
    """Elastic end stops of a drive at crank angles, or values of its cycle variable, `low` and `high` [rad].

    `stiffness` [N m/rad], of a drive along a line [N/m] with its `lever` [m/rad]. Going out the force is that share of it which
    returns the square of `restitution` of the energy, whatever the mass.
    """

    name: str
    low: float
    high: float
    stiffness: float
    restitution: float
    lever: float = 1.0
    switching: ClassVar[bool] = True

    def reversing(self, moving: Moving) -> tuple[Value, Value]:
        """Return speed and acceleration of the crank, with which the force jumps."""
        return moving.motion.speed, moving.motion.crank_acceleration

    def force(self, angle: Value, low_share: Value = 1.0, high_share: Value = 1.0) -> Any:
        """Return the torque [N m] or force [N] at crank angles, of which each stop gives a share: all of it going in.

        Parameters
        ----------
        angle : Value [rad]
        low_share, high_share : Value
        """
        low, high = np.maximum(self.low - angle, 0.0), np.maximum(angle - self.high, 0.0)
        return self.stiffness * self.lever * (low * low_share - high * high_share)

    def act(self, moving: Moving) -> Iterator[Acting]:
        """Yield the torque on the crank, or the force on slider, or on rod and barrel of a cylinder."""
        angle, mechanism = moving.motion.crank_angle, moving.machine.mechanism
        back, rising = self.restitution**2, 0.5 * (1.0 + moving.direction)
        effort = self.force(angle, 1.0 - (1.0 - back) * rising, back + (1.0 - back) * rising)
        body = mechanism.crank.body
        if not mechanism.drives:
            yield Acting(body, moving.state(body).start, torque=effort)
            return
        drive = mechanism.drives[0]
        guide = next((guide for guide in mechanism.guides if guide.slider == body and not drive.size), None)
        x, y = moving.state(body).axis if guide is None else moving.line(guide.name)
        force = effort * x, effort * y
        if guide is not None:
            yield Acting(body, moving.position(guide.at or mechanism.bodies[body].start), force)
            return
        yield Acting(drive.rod, moving.state(drive.rod).start, force)
        yield Acting(body, moving.state(body).start, (-force[0], -force[1]))
