"""Motion of a mechanism over its crank angles: positions, velocities, accelerations, margins, from the one pose formula."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from optlink.errors import UnknownName, nearest
from optlink.linkage.jet import Jet, as_jet
from optlink.linkage.mechanism import FRAME, Mechanism, Pose
from optlink.linkage.vector2d import Array, Value, Vector, all_finite, angle


@dataclass(frozen=True, repr=False)
class Motion:
    """Motion of a mechanism with its crank.

    Arrays have the shape of sizes broadcast against `crank_angle`: (angles,) for one design, (designs, angles) for a batch.
    """

    mechanism: Mechanism
    sizes: Mapping[str, Value]
    crank_angle: Value
    speed: Value
    pose: Pose
    crank_acceleration: Value = 0.0

    def __repr__(self) -> str:
        return f"<Motion {self.mechanism.name!r}: crank angles {self.shape}>"

    def position(self, point: str) -> Array:
        """Return the coordinates [m], shape (..., 2)."""
        return self._stack(point, lambda jet: jet.value)

    def distance(self, p: str, q: str) -> Array:
        """Return the distance between two points [m].

        Parameters
        ----------
        p, q : str
        """
        (px, py), (qx, qy) = ([self._full(as_jet(x).value) for x in self._point(name)] for name in (p, q))
        x, y = qx - px, qy - py
        return np.sqrt(x * x + y * y)

    def velocity(self, point: str) -> Array:
        """Return the velocity [m/s], shape (..., 2)."""
        return self._stack(point, lambda jet: jet.rate)

    def acceleration(self, point: str) -> Array:
        """Return the acceleration [m/s^2], shape (..., 2)."""
        return self._stack(point, lambda jet: jet.acceleration)

    def margin(self, joint: str) -> Array:
        """Return the assembly margin [-] of the group with that inner joint."""
        return self._full(as_jet(self.pose.margins[_known(self.pose.margins, joint, "inner joint of a group")]).value)

    def body_angle(self, body: str) -> Jet:
        """Return the angle of a body [rad], continuous along the sweep, and its first and second derivative [rad/s, rad/s^2]."""
        value, rate, acceleration = map(self._full, self._angle(body).parts)
        return Jet(continuous(value), rate, acceleration)

    def wrapped_angle(self, body: str) -> Array:
        """Return the angle of a body [rad] in (-pi, pi]."""
        return self._full(self._angle(body).value)

    def body_rate(self, body: str) -> Array:
        """Return the angular velocity of a body [rad/s]."""
        return self._full(self._angle(body).rate)

    def slide(self, guide: str) -> Jet:
        """Return the slide in a guide [m], its velocity and acceleration [m/s, m/s^2]."""
        guides = {candidate.name: candidate for candidate in self.mechanism.guides}
        joint = guides[_known(guides, guide, "guide")]
        with np.errstate(all="ignore"):
            return Jet(*map(self._full, as_jet(self.pose.slide(joint)).parts))

    def coordinate(self, output: str) -> Jet:
        """Return the coordinate of an output, the slide in a guide or that of a point, "P.x" or "P.y", with its derivatives."""
        point, _, axis = output.rpartition(".")
        if not point:
            return self.slide(output)
        return Jet(*(of(point)[..., "xy".index(axis)] for of in (self.position, self.velocity, self.acceleration)))

    @property
    def assembled(self) -> NDArray[np.bool_]:
        """Whether every group closes, at each position."""
        margins = [self.margin(joint) for joint in self.pose.margins]
        return np.all([margin >= 0.0 for margin in margins], axis=0) if margins else np.ones(self.shape, dtype=bool)

    def scaled(self, speed: Value, acceleration: Value) -> Motion:
        """Return the motion at the same positions and another crank speed; this motion must have 1 rad/s and no acceleration.

        Parameters
        ----------
        speed : Value [rad/s]
        acceleration : Value [rad/s^2]
        """
        square, steady = speed * speed, isinstance(acceleration, float) and acceleration == 0.0

        def scale(x: Value) -> Value:
            if not isinstance(x, Jet):
                return x
            bent = square * x.acceleration
            return Jet(x.value, speed * x.rate, bent if steady else bent + acceleration * x.rate)

        sizes = {name: scale(size) for name, size in self.pose.sizes.items()}  # those that drives prescribe change
        pose = Pose(self.mechanism, sizes, scale(self.pose.angle))
        pose.turns = {name: scale(angle) for name, angle in self.pose.turns.items()}
        pose.points = {name: (scale(x), scale(y)) for name, (x, y) in self.pose.points.items()}
        pose.directions = {name: (scale(x), scale(y)) for name, (x, y) in self.pose.directions.items()}
        pose.margins = self.pose.margins
        return Motion(self.mechanism, self.sizes, self.crank_angle, speed, pose, acceleration)

    @cached_property
    def shape(self) -> tuple[int, ...]:
        """Shape of all arrays."""
        return np.broadcast_shapes(self.crank_angle.shape, *(np.shape(size) for size in self.sizes.values()))

    def _full(self, x: Any) -> Array:
        return np.broadcast_to(np.asarray(x, dtype=float), self.shape)

    def _stack(self, point: str, part: Callable[[Jet], Value]) -> Array:
        return np.stack([self._full(part(as_jet(x))) for x in self._point(point)], axis=-1)

    def _point(self, name: str) -> Vector:
        points = self.pose.points
        return points[name] if name in points else self.pose.point(_known(self.mechanism.owners, name, "point"))

    def _angle(self, body: str) -> Jet:
        with np.errstate(all="ignore"):
            direction = self.pose.direction(_known((FRAME, *self.mechanism.bodies, *self.mechanism.rods), body, "body"))
            return as_jet(angle(direction))


def _known(names: Collection[str], name: str, what: str) -> str:
    """Return a name of the mechanism, and raise if it has none such."""
    if name not in names:
        raise UnknownName(f"the mechanism has no such {what}", nearest(str(name), names), key=what.split(" of ")[0], value=name)
    return name


def continuous(angles: Array) -> Array:
    """Unwrap angles along the last axis; NaN stays NaN and the values after a gap stay near those before it."""
    if all_finite(angles):
        return np.unwrap(angles)
    result = np.array(angles)
    for row in result.reshape(-1, result.shape[-1]):
        finite = np.isfinite(row)
        row[finite] = np.unwrap(row[finite])
    return result


def sweep(
    mechanism: Mechanism, sizes: Mapping[str, Value], crank_angle: ArrayLike, speed: Value = 1.0, acceleration: Value = 0.0
) -> Motion:
    """Compute the motion of a mechanism as `optlink.linkage.sweep`, without a check of the arguments.

    Parameters
    ----------
    mechanism : Mechanism
    sizes : mapping of parameter name to float or array (designs, 1) [m, rad]
    crank_angle : array (angles,) [rad]
    speed : float or array (angles,) [rad/s]
    acceleration : float or array (angles,) [rad/s^2]
    """
    angles = np.atleast_1d(np.asarray(crank_angle, dtype=float))
    with np.errstate(all="ignore"):  # at a dead position of a group its speeds are infinite or NaN
        pose = mechanism.at(sizes, Jet(angles, speed, acceleration))
    return Motion(mechanism, sizes, angles, speed, pose, acceleration)
