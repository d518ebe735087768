"""Machines: a mechanism with sizes, masses, gravity, loads and friction; and a machine in motion."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike

from optlink.dynamics.inertia import BodyMotion, Inertia, Wrench, body_motion, kinetic, potential
from optlink.linkage.jet import as_jet
from optlink.linkage.mechanism import FRAME, Mechanism, Pose
from optlink.linkage.motion import Motion, sweep
from optlink.linkage.stroke import Ranges, reachable
from optlink.linkage.vector2d import TURN, Value, Vector, cross, dot, magnitude, minus, sign

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


class Load(Protocol):
    """Protocol of all loads."""

    @property
    def name(self) -> str:
        """Name in the problem file."""

    @property
    def switching(self) -> bool:
        """Whether the load jumps where a motion reverses."""

    def act(self, moving: Moving) -> Iterator[Acting]:
        """Yield the forces and torques of the load, body by body."""

    def reversing(self, moving: Moving) -> tuple[Value, Value] | None:
        """Return the velocity at whose reversal the load jumps, and the corresponding acceleration."""

    def potential(self, moving: Moving) -> Value:
        """Return the potential energy [J]; zero except for springs."""


@dataclass(frozen=True, repr=False)
class Machine:
    """A mechanism with its masses, loads and friction.

    `inertias` by body (a body without an entry has no mass), `gravity` [m/s^2], `loads`, `friction` coefficients by guide,
    `reported`: body on which the reaction at a pin is reported, where it differs from the default (`inverse.reported_on`).
    """

    mechanism: Mechanism
    sizes: Mapping[str, Value]
    inertias: Mapping[str, Inertia] = field(default_factory=dict)
    gravity: Vector = (0.0, 0.0)
    loads: tuple[Load, ...] = ()
    friction: Mapping[str, Value] = field(default_factory=dict)
    reported: Mapping[str, str] = field(default_factory=dict)

    def __repr__(self) -> str:
        return f"<Machine {self.mechanism.name!r}: {', '.join(self.mechanism.bodies)}>"

    def moving(
        self, crank_angle: ArrayLike, speed: Value = 1.0, acceleration: Value = 0.0, side: int = 1, direction: Value = None
    ) -> Moving:
        """Return the machine in motion at crank angles (angles,) [rad].

        `side`: where a load jumps, at the reversal of the motion that it opposes, +1 takes the value just after, -1 that just
        before. `direction` is the sense of crank rotation, by default that of the speed, positive where the crank is at rest.
        """
        return Moving(self, sweep(self.mechanism, self.sizes, crank_angle, speed, acceleration), side, direction)

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
        lengths = [link.length for link in self.mechanism.links if link.end]
        values = (as_jet(self.sizes[length] if isinstance(length, str) else length).value for length in lengths)
        return sum(values, 0.0) if lengths else 1.0

    @cached_property
    def ranges(self) -> Ranges:
        """Crank ranges in which the mechanism can be assembled."""
        return reachable(self.mechanism, self.sizes)

    @cached_property
    def revolutions(self) -> int | None:
        """Revolutions of the crank after which motion and loads repeat; None where a load never does."""
        motion = max(1, round(self.mechanism.cycle / TURN))
        loads = [getattr(getattr(load, "magnitude", None), "revolutions", 1) for load in self.loads]
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
        return {name: value for name, value in vars(self).items() if name != "compiled"}

    @cached_property
    def switching(self) -> bool:
        """Whether a force jumps where a motion reverses."""
        return bool(self.friction) or any(load.switching for load in self.loads)

    @property
    def cornered(self) -> bool:
        """Whether a load may have a corner, a jump or a pole: a row of its table, or a breakpoint of its expression."""
        return any(getattr(getattr(load, "magnitude", None), "cornered", False) for load in self.loads)


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
        """Return the position of a point [m], which is the same on all bodies that share it."""
        x, y = self.pose.points[point]
        return as_jet(x).value, as_jet(y).value

    def velocity(self, point: str, body: str = "") -> Vector:
        """Return the velocity of a point [m/s]."""
        x, y = self.pose.points[point]
        return as_jet(x).rate, as_jet(y).rate

    def acceleration(self, point: str, body: str = "") -> Vector:
        """Return the acceleration of a point [m/s^2]."""
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
                start = self.pose.points[self.machine.mechanism.bodies[body].start]
                self._states[body] = body_motion(start, self.pose.direction(body))
        return self._states[body]

    def sense(self, of: Callable[[Moving], tuple[Value, Value]], size: Value = 1.0) -> Value:
        """Return the sign of a velocity; where it reverses, the sign just after (or before); zero for rounding errors.

        `of` maps a machine in motion to the velocity and its acceleration; `size` is that of the machine [m] for the velocity
        of a point, 1 for an angular velocity.
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
        """
        return Moving(self.machine, self.motion.scaled(speed, acceleration), self.side, direction)

    @property
    def without_friction(self) -> Moving:
        """The same motion of the machine without friction."""
        return Moving(self.machine.with_(friction={}), self.motion, self.side, self.direction)

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
