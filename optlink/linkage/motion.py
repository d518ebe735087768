"""A mechanism swept over its crank angles: positions, velocities, accelerations, margins, from the one pose formula."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from optlink.linkage.elementwise import Value, angle, unit
from optlink.linkage.jet import Jet
from optlink.linkage.mechanism import Mechanism, Pose

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Motion:
    """How a mechanism moves while its crank turns evenly.

    Arrays have the shape of sizes broadcast against `crank_angle`: (angles,) for one design, (designs, angles) for a batch.
    """

    mechanism: Mechanism
    sizes: Mapping[str, Value]
    crank_angle: Array
    speed: float
    pose: Pose

    def position(self, point: str) -> Array:
        """Coordinates [m], shape (..., 2)."""
        return self._stack(point, lambda jet: jet.value)

    def velocity(self, point: str) -> Array:
        """Velocity [m/s], shape (..., 2)."""
        return self._stack(point, lambda jet: jet.rate)

    def acceleration(self, point: str) -> Array:
        """Acceleration [m/s^2], shape (..., 2)."""
        return self._stack(point, lambda jet: jet.acceleration)

    def margin(self, joint: str) -> Array:
        """Assembly margin [-] of the group that ends in that joint."""
        return self._full(self.pose.margins[joint].value)

    def body_angle(self, body: str) -> Jet:
        """Angle of a body [rad] (continuous along the sweep), its angular velocity and acceleration [rad/s, rad/s^2]."""
        jet = angle(self.mechanism.direction(self.pose.points, self.sizes, body))
        return Jet(np.unwrap(self._full(jet.value)), self._full(jet.rate), self._full(jet.acceleration))

    def _full(self, x: Any) -> Array:
        shape = np.broadcast_shapes(self.crank_angle.shape, *(np.shape(size) for size in self.sizes.values()))
        return np.broadcast_to(np.asarray(x, dtype=float), shape)

    def _stack(self, point: str, part: Callable[[Jet], Value]) -> Array:
        coordinates = (x if isinstance(x, Jet) else Jet(x) for x in self.pose.points[point])
        return np.stack([self._full(part(x)) for x in coordinates], axis=-1)


def sweep(mechanism: Mechanism, sizes: Mapping[str, Value], crank_angle: ArrayLike, speed: float = 1.0) -> Motion:
    """Move a mechanism through the given crank angles at a constant crank speed.

    Parameters
    ----------
    mechanism : Mechanism
    sizes : mapping of parameter name to float or array (designs, 1) [m]
    crank_angle : array (angles,) [rad]
    speed : float [rad/s], positive counter-clockwise

    Returns
    -------
    Motion; NaN where the mechanism cannot be assembled (see `Motion.margin`).
    """
    angles = np.atleast_1d(np.asarray(crank_angle, dtype=float))
    return Motion(mechanism, sizes, angles, speed, mechanism.pose(sizes, unit(Jet(angles, speed, 0.0))))
