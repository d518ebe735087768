"""Find the four-bar within a linkage of dyads: its crank and a group of two links between the crank and the frame."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from optlink.linkage.dyad_types import RRR
from optlink.linkage.fourbar import DeadCentre, dead_centre
from optlink.linkage.mechanism import FRAME, Arm, Ground, Link, Mechanism, Size
from optlink.linkage.vector2d import Value, Vector, angle, turn


@dataclass(frozen=True)
class InnerFourBar:
    """Crank, coupler and rocker: `pin` joins crank and coupler, `joint` coupler and rocker, `ground_pin` rocker and frame.

    `pivots`: places of the two pivots on the frame, that of the crank first.
    """

    crank: Link
    coupler: Link
    rocker: Link
    group: RRR
    pin: str
    ground_pin: str
    pivots: tuple[Ground, Ground]

    @property
    def joint(self) -> str:
        """The joint of coupler and rocker."""
        return self.group.joint

    @property
    def side(self) -> int:
        """Assembly mode: +1 if the joint of coupler and rocker lies to the left of the line from `pin` to `ground_pin`."""
        return self.group.side if self.group.outer == (self.pin, self.ground_pin) else -self.group.side

    @property
    def plain(self) -> bool:
        """Whether its joints are the ends of its links, so that the link lengths are those of the four-bar."""
        ends = [{self.crank.start, self.pin}, {self.pin, self.joint}, {self.ground_pin, self.joint}]
        links = (self.crank, self.coupler, self.rocker)
        return all(
            {link.start, link.end} == both and isinstance(link.length, str) for link, both in zip(links, ends, strict=True)
        )

    @property
    def ground(self) -> tuple[str, ...]:
        """Names of the sizes that place its two pivots."""
        sizes = [size for place in self.pivots for size in ((place.length, place.direction) if isinstance(place, Arm) else place)]
        return tuple(size for size in sizes if isinstance(size, str))

    @property
    def names(self) -> tuple[str, str, str]:
        """Names of the lengths of crank, coupler and rocker of a plain four-bar."""
        return str(self.crank.length), str(self.coupler.length), str(self.rocker.length)

    @property
    def frame_length(self) -> str:
        """Name of the size that is the length of the frame; empty if its pivots have coordinates."""
        one, other = self.pivots
        if isinstance(other, Arm):
            return str(other.length)
        return str(other[0]) if one == (0.0, 0.0) and other[1] == 0.0 else ""

    def frame(self, values: Mapping[str, Value]) -> tuple[Value, Vector | None]:
        """Return the length of the frame [m] and the unit vector from crank to rocker pivot; elementwise.

        The direction is relative to that from which crank angles count, None if it is the same.
        """
        if self.frame_length:
            return values[self.frame_length], None
        one, other = self.pivots
        assert not isinstance(one, Arm)
        assert not isinstance(other, Arm)
        dx, dy = (_size(end, values) - _size(begin, values) for begin, end in zip(one, other, strict=True))
        length = np.sqrt(dx * dx + dy * dy)
        return length, (dx / length, dy / length)

    def frame_bounds(self, bounds: Mapping[str, tuple[float, float]]) -> tuple[float, float]:
        """Return the least and largest length of the frame [m] for the bounds of all dimensions [m]."""
        if self.frame_length:
            return bounds[self.frame_length]
        ends = [bounds[name] for name in self.ground]
        least = [max(0.0, first - high, low - last) for (low, high), (first, last) in zip(ends[:2], ends[2:], strict=True)]
        most = [max(last - low, high - first) for (low, high), (first, last) in zip(ends[:2], ends[2:], strict=True)]
        return math.hypot(*least), math.hypot(*most)

    def lengths(self, values: Mapping[str, Value]) -> tuple[Value, Value, Value, Value]:
        """Return the lengths [m] of crank, coupler, rocker and frame of a plain four-bar; elementwise."""
        crank, coupler, rocker = self.names
        return values[crank], values[coupler], values[rocker], self.frame(values)[0]

    def turned(self, values: Mapping[str, Value]) -> Value:
        """Return the angle [rad] of the frame, from crank to rocker pivot, where crank angles count from; elementwise."""
        axis = self.frame(values)[1]
        return 0.0 if axis is None else angle(axis)

    def dead_centre(self, values: Mapping[str, Value], *, outer: bool) -> DeadCentre:
        """Return a limit position of the rocker of a plain four-bar, with the directions of crank and rocker in the plane.

        `values` are the dimensions [m], elementwise; `outer`: crank and coupler extended, else overlapping.
        """
        axis = self.frame(values)[1]
        limit = dead_centre(*self.lengths(values), self.side, outer)
        return limit if axis is None else DeadCentre(turn(limit.crank, axis), turn(limit.rocker, axis), limit.margin)


def _size(size: Size, values: Mapping[str, Value]) -> Value:
    return values[size] if isinstance(size, str) else size


def whole_four_bar(mechanism: Mechanism) -> InnerFourBar | None:
    """Return the four-bar that a linkage is as a whole, however it is written; None if a joint is not at the end of its link."""
    loop = next(inner_four_bars(mechanism), None) if len(mechanism.groups) == 1 else None
    return loop if loop is not None and loop.plain else None


def inner_four_bars(mechanism: Mechanism) -> Iterator[InnerFourBar]:
    """Yield the four-bars of a linkage, in the order of its groups."""
    crank, owners = mechanism.crank, mechanism.owners
    for group in mechanism.groups:
        if not isinstance(group, RRR):
            continue
        pins = tuple(zip(group.links, group.outer, strict=True))
        for (coupler, pin), (rocker, ground_pin) in (pins, pins[::-1]):
            if crank.body in owners[pin] and FRAME not in owners[pin] and FRAME in owners[ground_pin]:
                pivots = mechanism.ground[crank.start], mechanism.ground[ground_pin]
                yield InnerFourBar(crank, coupler, rocker, group, pin, ground_pin, pivots)
