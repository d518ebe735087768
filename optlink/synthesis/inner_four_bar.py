"""Find the four-bar within a linkage of dyads: its crank and a group of two links between the crank and the frame."""

from collections.abc import Iterator
from dataclasses import dataclass

from optlink.linkage.dyad_types import RRR
from optlink.linkage.mechanism import FRAME, Link, Mechanism


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
