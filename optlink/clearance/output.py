"""Output of a machine: the slide of a slider or the angle of a body, and its deviation from the ideal motion."""

from dataclasses import dataclass

import numpy as np

from optlink.clearance.state import ClearanceState
from optlink.dynamics.machine import Machine, Moving, slider_names
from optlink.linkage.mechanism import FRAME
from optlink.linkage.vector2d import Value, angle


@dataclass(frozen=True)
class Output:
    """Output of a machine: the slide in a `guide`, or, without a guide, the angle of a body."""

    name: str
    guide: str = ""

    @property
    def unit(self) -> str:
        """SI unit: m or rad."""
        return "m" if self.guide else "rad"

    @property
    def column(self) -> str:
        """Name of the column in tables."""
        return f"{self.name}.s_m" if self.guide else f"{self.name}.angle_rad"

    @property
    def error(self) -> str:
        """Name of the column of the deviation from the machine without clearance."""
        return f"{self.name}.error_{self.unit}"

    def of(self, with_clearance: ClearanceState) -> Value:
        """Return the output [m, rad]; an angle lies in (-pi, pi]."""
        return with_clearance.slides[self.guide][0] if self.guide else angle(with_clearance.state(self.name).axis)

    def ideal(self, moving: Moving) -> tuple[Value, Value]:
        """Return the output of the machine without clearance [m, rad], and its velocity."""
        if self.guide:
            s, v, _ = moving.slides[self.guide]
            return s, v
        state = moving.state(self.name)
        return angle(state.axis), state.omega

    def difference(self, value: Value, ideal: Value) -> Value:
        """Return the deviation of a value from a target [m, rad]; that of an angle is wrapped to (-pi, pi]."""
        return value - ideal if self.guide else np.remainder(value - ideal + np.pi, 2.0 * np.pi) - np.pi


def outputs(machine: Machine) -> dict[str, Output]:
    """Return the possible outputs by name: sliders in their guides, and the angles of other bodies."""
    sliding = {name: Output(name, guide) for guide, name in slider_names(machine).items()}
    turning = {body: Output(body) for body in machine.mechanism.bodies if body != machine.mechanism.crank.body}
    return {**turning, **sliding}


def default_output(machine: Machine) -> Output:
    """Return the default output: the last slider on the frame, else the last body that is pinned to the frame."""
    available = outputs(machine)
    names = slider_names(machine)
    rams = [names[guide.name] for guide in machine.mechanism.guides if FRAME in guide.bodies]
    if rams:
        return available[rams[-1]]
    pinned = {body for bodies in machine.mechanism.pins.values() if FRAME in bodies for body in bodies}
    moving = [link.body for link in machine.mechanism.links[1:]]
    return available[next((body for body in reversed(moving) if body in pinned), moving[-1])]
