"""Find the four-bar within a linkage of dyads: its crank and a group of two links between the crank and the frame."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from optlink.linkage.dyad_types import RRR
from optlink.linkage.fourbar import DeadCentre, dead_centre
from optlink.linkage.mechanism import FRAME, Link, Mechanism
from optlink.linkage.vector2d import Value, turn


@dataclass(frozen=True)
class InnerFourBar:
    """Crank, coupler and rocker: `pin` joins crank and coupler, `joint` coupler and rocker, `ground_pin` rocker and frame."""

    crank: Link
    coupler: Link
    rocker: Link
    group: RRR
    pin: str
    ground_pin: str

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
    def ground(self) -> tuple[str, str, str, str]:
        """Names of the coordinates of its two pivots."""
        one, other = self.crank.start, self.ground_pin
        return f"{one}.x", f"{one}.y", f"{other}.x", f"{other}.y"

    def dead_centre(self, values: Mapping[str, Value], *, outer: bool) -> DeadCentre:
        """Return a limit position of the rocker of a plain four-bar, with the directions of crank and rocker in the plane.

        `values` are the dimensions [m], elementwise; `outer`: crank and coupler extended, else overlapping.
        """
        x, y, to_x, to_y = (values[name] for name in self.ground)
        dx, dy = to_x - x, to_y - y
        frame = np.sqrt(dx * dx + dy * dy)
        axis = dx / frame, dy / frame
        crank, coupler, rocker = (values[str(link.length)] for link in (self.crank, self.coupler, self.rocker))
        limit = dead_centre(crank, coupler, rocker, frame, self.side, outer)
        return DeadCentre(turn(limit.crank, axis), turn(limit.rocker, axis), limit.margin)


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
                yield InnerFourBar(crank, coupler, rocker, group, pin, ground_pin)
