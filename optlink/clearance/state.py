"""A machine with joint clearance in motion: the coordinates place every body; pins with clearance impose nothing.

It has the interface of `Moving`, so that loads act on it as on the ideal machine, with floats, arrays or symbols.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property

import numpy as np

from optlink.clearance.joint import Gap, JournalMotion
from optlink.clearance.spanning_tree import SpanningTree
from optlink.dynamics.inertia import BodyMotion, Wrench, body_motion
from optlink.dynamics.inverse import required_wrench
from optlink.dynamics.machine import Acting, Machine
from optlink.linkage.jet import Jet, as_jet
from optlink.linkage.mechanism import FRAME
from optlink.linkage.vector2d import Value, Vector, minus

SMOOTH = 1e-4
"""Share of the nominal speed (crank speed times size of the machine) where a load that opposes a motion has 76 % of its size."""


class ClearanceState:
    """A machine with joint clearance at coordinates that are jets.

    The nominal speed of the crank [rad/s], with its sense, is the reference for the smoothing of `sense`.
    """

    def __init__(self, machine: Machine, cut: SpanningTree, values: Sequence[Value], speed: float) -> None:
        self.machine, self.tree, self.nominal = machine, cut, speed
        self.direction = -1.0 if speed < 0.0 else 1.0
        self.places = cut.place(values)
        self.crank: Jet = values[cut.driven]
        self._states: dict[str, BodyMotion] = {}

    @property
    def variables(self) -> dict[str, Value]:
        """Variables available to every load: crank angle [rad] and speed [rad/s]."""
        return {"phi": self.crank.value, "omega": self.crank.rate}

    def state(self, body: str) -> BodyMotion:
        """Return the motion of a body."""
        if body not in self._states:
            self._states[body] = body_motion(*self.places[body])
        return self._states[body]

    def position(self, point: str, body: str) -> Vector:
        """Return the position of a point of a body [m]."""
        return self.tree.at(point, body, self.state(body))

    def velocity(self, point: str, body: str) -> Vector:
        """Return the velocity of a point of a body [m/s]."""
        return self.state(body).at(self.position(point, body))[0]

    def acceleration(self, point: str, body: str) -> Vector:
        """Return the acceleration of a point of a body [m/s^2]."""
        return self.state(body).at(self.position(point, body))[1]

    def line(self, guide: str) -> Vector:
        """Return the unit vector of a guide's line."""
        joint = next(candidate for candidate in self.machine.mechanism.guides if candidate.name == guide)
        return self.tree.line(joint, joint.on, self.state(joint.on))[1]

    @cached_property
    def slides(self) -> dict[str, tuple[Value, Value, Value]]:
        """Slide in every guide, its velocity and acceleration [m, m/s, m/s^2]."""
        return {guide.name: as_jet(self.tree.slide(guide, self.places)).parts for guide in self.machine.mechanism.guides}

    def sense(self, of: Callable[[ClearanceState], tuple[Value, Value]], size: Value = 1.0) -> Value:
        """Return the smoothed sign of a velocity, because no equation of motion is integrated across a jump.

        `size` is that of the machine [m] for the velocity of a point, 1 for an angular velocity.
        """
        return np.tanh(of(self)[0] / (SMOOTH * abs(self.nominal) * size))

    def journal_motion(self, gap: Gap) -> JournalMotion:
        """Return the motion of the journal of a gap in its bearing."""
        bodies = gap.journal, gap.bearing
        eccentricity = minus(*(self.position(gap.point, body) for body in bodies))
        rate = minus(*(self.velocity(gap.point, body) for body in bodies))
        return JournalMotion(eccentricity, rate, *(self.state(body).omega for body in bodies))

    # --- forces and energies -----------------------------------------------------------------------------------------

    def needed(self) -> dict[str, Wrench]:
        """Return the total force, and moment about its start, that each body requires for its inertia and against gravity."""
        return required_wrench(self, loads=False)  # type: ignore[arg-type]

    def acting(self) -> dict[str, list[Acting]]:
        """Return the forces of each load, by the load's name."""
        return {load.name: list(load.act(self)) for load in self.machine.loads}  # type: ignore[arg-type]

    def power(self, acting: Sequence[Acting]) -> Value:
        """Return the power that loads feed into the machine [W]."""
        return sum(load.power(self.state(load.body)) for load in acting if load.body != FRAME)

    @cached_property
    def kinetic(self) -> Value:
        """Kinetic energy [J]."""
        return self.machine.kinetic(self.state)

    @cached_property
    def potential(self) -> Value:
        """Potential energy of gravity [J]; the energy of springs counts among the works of loads."""
        return self.machine.weight(self.state)
