"""A mechanism is data: ground points, a driving crank and dyads solved one after the other.

Sizes are names of parameters, so one description serves every design: `pose` takes the parameters and the crank's direction,
each a Value (float, batch, symbol or jet), and returns the points and assembly margins.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from optlink.linkage.dyads import rrr
from optlink.linkage.elementwise import Value, Vector

Size = str | float
"""The name of a parameter, or a number in SI."""


@dataclass(frozen=True)
class Link:
    """A rigid body with two joints at a fixed distance: `start` to `end` over `length`."""

    body: str
    start: str
    end: str
    length: Size


@dataclass(frozen=True)
class RRR:
    """Two links pinned to known joints and to one another: `first.end` is `second.end`, the new joint."""

    first: Link
    second: Link
    side: int  # +1: new joint left of first.start -> second.start

    @property
    def joint(self) -> str:
        """Name of the joint that the group adds."""
        return self.first.end

    @property
    def links(self) -> tuple[Link, ...]:
        """The bodies that the group adds."""
        return self.first, self.second

    def solve(self, points: dict[str, Vector], sizes: Mapping[str, Value]) -> Value:
        """Add the new joint to `points`; return the assembly margin."""
        points[self.joint], margin = rrr(
            points[self.first.start],
            points[self.second.start],
            _size(self.first.length, sizes),
            _size(self.second.length, sizes),
            self.side,
        )
        return margin


@dataclass(frozen=True)
class BodyPoint:
    """A point fixed on a body: `along` the line start -> end of its link, `across` to the left of it."""

    name: str
    body: str
    along: Size
    across: Size


@dataclass(frozen=True)
class Pose:
    """Where everything is: `points` by name, one assembly margin per group (by the name of its joint)."""

    points: dict[str, Vector]
    margins: dict[str, Value]


@dataclass(frozen=True)
class Mechanism:
    """Ground + driving crank + ordered dyads (+ points fixed on bodies)."""

    name: str
    ground: Mapping[str, tuple[Size, Size]]
    crank: Link
    groups: tuple[RRR, ...]
    points: tuple[BodyPoint, ...] = field(default=())

    @property
    def links(self) -> tuple[Link, ...]:
        """All moving bodies, the crank first."""
        return (self.crank, *(link for group in self.groups for link in group.links))

    def link(self, body: str) -> Link:
        """The link of that name; KeyError if there is none."""
        for link in self.links:
            if link.body == body:
                return link
        raise KeyError(body)

    def pose(self, sizes: Mapping[str, Value], crank: Vector) -> Pose:
        """Positions of every point.

        Parameters
        ----------
        sizes : mapping of parameter name to Value [m]
            Broadcast against the crank: (designs, 1) against (angles,) gives (designs, angles).
        crank : pair of Value
            Unit vector of the crank.

        Returns
        -------
        Pose, coordinates in [m], NaN from the first group on that cannot be assembled (its margin is negative).
        """
        points: dict[str, Vector] = {name: (_size(x, sizes), _size(y, sizes)) for name, (x, y) in self.ground.items()}
        length = _size(self.crank.length, sizes)
        pivot = points[self.crank.start]
        points[self.crank.end] = pivot[0] + length * crank[0], pivot[1] + length * crank[1]
        margins = {group.joint: group.solve(points, sizes) for group in self.groups}
        for point in self.points:
            (x, y), (c, s) = points[self.link(point.body).start], self.direction(points, sizes, point.body)
            along, across = _size(point.along, sizes), _size(point.across, sizes)
            points[point.name] = x + along * c - across * s, y + along * s + across * c
        return Pose(points, margins)

    def direction(self, points: Mapping[str, Vector], sizes: Mapping[str, Value], body: str) -> Vector:
        """Unit vector of a body from the start to the end of its link."""
        link = self.link(body)
        start, end, length = points[link.start], points[link.end], _size(link.length, sizes)
        return (end[0] - start[0]) / length, (end[1] - start[1]) / length


def _size(size: Size, sizes: Mapping[str, Value]) -> Value:
    return sizes[size] if isinstance(size, str) else size
