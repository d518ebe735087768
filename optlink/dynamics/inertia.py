"""Mass properties of a body, and the wrench that its motion requires, linear in them.

A body's parameters are its mass m, its first moments m*c (c: centroid in the body's own axes) and its moment of inertia about
the start of the body; the wrench that moves it is their linear function, so a regressor is the wrench of unit parameters.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from optlink.linkage.jet import as_jet
from optlink.linkage.vector2d import Value, Vector, cross, dot, minus, plus, turn


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
