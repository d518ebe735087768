"""Loads on a machine in addition to inertia and gravity: forces, torques, springs, dampers.

A load is an object that returns the forces it exerts on a machine in motion. Forces may be constant, follow a table or
expression, oppose the motion, or act in one stroke only; the stroke is determined from the motion.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from optlink.dynamics.machine import Acting, Moving
from optlink.linkage.mechanism import FRAME
from optlink.linkage.vector2d import Value, Vector, angle_from, dot, minus, turn, unit

Magnitude = Callable[[Mapping[str, Value]], Value]
"""Force [N] or torque [N m] from phi (crank angle) [rad], omega (crank speed), and s, v of a slider or theta, w of a body."""

Stroke = Literal["both", "forward", "backward"]


def _sense(load: Force | Torque, moving: Moving) -> Value:
    """Factor of the magnitude: -1 against a positive velocity if the load opposes motion, 0 in the other stroke."""
    opposing, stroke = load.opposing, load.stroke
    if not opposing and stroke == "both":
        return 1.0
    sign = moving.sense(load.reversing, moving.machine.size if isinstance(load, Force) else 1.0)
    share = 1.0
    if stroke != "both":
        way = moving.direction if load.turning else 1.0
        share = 0.5 * (1.0 + (sign if stroke == "forward" else -sign) * way)
    return share * (-sign if opposing else 1.0)


@dataclass(frozen=True)
class _Process:
    """Base class of forces and torques: they may oppose the motion, act in one stroke, and react on another body."""

    opposing: bool = field(default=False, kw_only=True)
    stroke: Stroke = field(default="both", kw_only=True)
    turning: bool = field(default=False, kw_only=True)
    """The stroke is that of a crank that turns counter-clockwise; clockwise it is the other one."""
    against: str = field(default=FRAME, kw_only=True)
    """The body on which the reaction acts."""

    @property
    def switching(self) -> bool:
        """Whether the load jumps where the motion reverses."""
        return self.opposing or self.stroke != "both"

    def potential(self, moving: Moving) -> Value:
        """Return zero: the load stores no energy."""
        return 0.0

    def known(self, moving: Moving) -> dict[str, Value]:
        """Return the variables of the magnitude: crank angle [rad] and speed, and those of the body on which the load acts."""
        return moving.variables


@dataclass(frozen=True)
class Force(_Process):
    """A force on a point of a body, along a direction fixed in the plane or along the guide of a slider."""

    name: str
    body: str
    point: str
    magnitude: Magnitude
    direction: float | str  # angle [rad], or the guide that the body slides in

    def along(self, moving: Moving) -> Vector:
        """Return the unit vector of the direction."""
        return moving.line(self.direction) if isinstance(self.direction, str) else unit(self.direction)

    def reversing(self, moving: Moving) -> tuple[Value, Value]:
        """Return the velocity and acceleration along the direction, relative to the body that takes the reaction."""
        if isinstance(self.direction, str):
            return moving.slides[self.direction][1:]
        way, other = unit(self.direction), moving.state(self.against)
        velocity, acceleration = other.at(moving.position(self.point, self.body))
        slip = minus(moving.velocity(self.point, self.body), velocity)
        rate = minus(moving.acceleration(self.point, self.body), acceleration)
        # the point of the other body that the force meets changes: its velocity does so by omega x slip
        return dot(way, slip), dot(way, (rate[0] + other.omega * slip[1], rate[1] - other.omega * slip[0]))

    def known(self, moving: Moving) -> dict[str, Value]:
        """Return the variables of the magnitude: crank angle and speed; of a slider its slide and velocity [SI]."""
        if not isinstance(self.direction, str):
            return moving.variables
        s, v, _ = moving.slides[self.direction]
        return {**moving.variables, "s": s, "v": v}

    def act(self, moving: Moving) -> Iterator[Acting]:
        """Yield the force, and its reaction on the other body."""
        size = self.magnitude(self.known(moving)) * _sense(self, moving)
        x, y = self.along(moving)
        at, force = moving.position(self.point, self.body), (size * x + 0.0, size * y + 0.0)  # + 0.0: avoids -0.0
        yield Acting(self.body, at, force)
        if self.against != FRAME:
            yield Acting(self.against, at, (-force[0], -force[1]))


@dataclass(frozen=True)
class Torque(_Process):
    """A torque on a body; `middle` [rad]: the angle of the body that the magnitude sees is at most half a revolution from it."""

    name: str
    body: str
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
        torque = self.magnitude(self.known(moving)) * _sense(self, moving)
        yield Acting(self.body, state.start, torque=torque)
        if self.against != FRAME:
            yield Acting(self.against, moving.state(self.against).start, torque=-torque)


class Steady:
    """Base class of loads without jumps; they store no energy unless they are springs."""

    switching = False

    def reversing(self, moving: Moving) -> None:
        """Return None: the load does not jump."""
        return

    def potential(self, moving: Moving) -> Value:
        """Return zero: the load stores no energy."""
        return 0.0


@dataclass(frozen=True)
class Spring(Steady):
    """A linear spring and damper between two points: `stiffness` [N/m], `free` length [m], `damping` [N s/m]."""

    name: str
    ends: tuple[tuple[str, str], tuple[str, str]]  # (body, point) twice
    stiffness: Value
    free: Value
    damping: Value

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
        for (body, point), sign in zip(self.ends, (1.0, -1.0), strict=True):
            yield Acting(body, moving.position(point, body), (sign * pull * x, sign * pull * y))

    def potential(self, moving: Moving) -> Value:
        """Return the energy stored in the spring [J]."""
        stretch = self._stretch(moving)[0] - self.free
        return 0.5 * self.stiffness * stretch * stretch


@dataclass(frozen=True)
class TorsionSpring(Steady):
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
class SlideDamper(Steady):
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
