"""Quadratic drag of the air at a point of a body: `[loads.air] on = "rocker"`, `at = "C"`, `drag = 1.2`, `width = ...`."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from optlink.extending import (
    Acting,
    FixedLength,
    InvalidValue,
    Load,
    LoadKind,
    Moving,
    Number,
    OnBody,
    RevolutionSamples,
    register,
)
from optlink.linkage import Mechanism

AIR = 1.2  # density [kg/m^3]
REST = 1e-12  # m^2/s^2, so that the root has a slope where the point is at rest


@dataclass(frozen=True)
class Drag(Load):
    name: str
    body: str
    point: str
    factor: float  # kg/m

    def act(self, moving: Moving) -> Iterator[Acting]:
        x, y = moving.velocity(self.point, self.body)
        size = self.factor * np.sqrt(x * x + y * y + REST)
        yield Acting(self.body, moving.position(self.point, self.body), (-size * x, -size * y))


class DragLoad(OnBody):
    """Drag of the air."""

    at: str
    """Point of the body at which it acts."""
    drag: Number
    """Drag coefficient."""
    width: FixedLength
    """Width of the area."""
    height: FixedLength
    """Height of the area."""

    def build(self, name: str, mechanism: Mechanism, motion: RevolutionSamples) -> Drag:
        body, points = self.body(mechanism), mechanism.owners
        if body not in points.get(self.at, ()):
            own = [point for point, bodies in points.items() if body in bodies]
            raise InvalidValue("the body has no such point", f"Known: {', '.join(own)}", "at", self.at)
        return Drag(name, body, self.at, 0.5 * AIR * self.drag * self.width.value * self.height.value)


register(LoadKind("drag", DragLoad))
