"""Bodies of a mechanism, their points and joints; sizes are names of parameters, or numbers."""

from dataclasses import dataclass

FRAME = "frame"
"""Name of the body that does not move; its own coordinates are those of the plane."""
Size = str | float
"""The name of a parameter, or a number in SI."""


@dataclass(frozen=True)
class Link:
    """A moving body. Its axes have their origin at the point `start`; x points to `end`, at the distance `length`.

    A body without an `end` (a block, a ram, a yoke) gets the direction of its x axis from a guide.
    """

    body: str
    start: str
    end: str = ""
    length: Size = 0.0


@dataclass(frozen=True)
class Arm:
    """Position of a point of the frame: `length` away from another ground point, in a `direction` [rad] from +x."""

    origin: str
    length: Size
    direction: Size


Ground = tuple[Size, Size] | Arm
"""Coordinates of a point of the frame, or its distance and direction from one named before it."""


@dataclass(frozen=True)
class BodyPoint:
    """A further point fixed on a body: `along` its x axis from its start, `across` to the left of it."""

    name: str
    body: str
    along: Size
    across: Size


@dataclass(frozen=True)
class Guide:
    """A prismatic joint: the body `slider` slides without rotation along a line that is fixed on the body `on`.

    The line passes `offset` to the left of the point `through` of `on` (its name, or coordinates on that body), at the angle
    `direction` to the x axis of `on`; the slide counts from there. The point `at` of the slider (default: its start) lies
    on the line, and the slider's x axis is at the angle `tilt` to the line.
    """

    name: str
    slider: str
    on: str = FRAME
    through: str | tuple[Size, Size] = (0.0, 0.0)
    direction: Size = 0.0
    offset: Size = 0.0
    at: str = ""
    tilt: Size = 0.0

    @property
    def bodies(self) -> tuple[str, str]:
        """The two bodies that slide on each other, the slider first."""
        return self.slider, self.on

    def other(self, body: str) -> str:
        """Return the other body of the joint."""
        return self.on if body == self.slider else self.slider


Joint = str | Guide
"""A joint between two bodies: the name of a pin, or a guide."""
