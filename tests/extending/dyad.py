"""A yoke driven by a pin in its slot (RPP), written afresh in place of the dyad of the package."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from optlink.extending import (
    Assembly,
    Dyad,
    DyadType,
    ForceBalance,
    GroupForces,
    Guide,
    Joint,
    Link,
    Value,
    cross,
    dot,
    minus,
    plus,
    register,
    solve_two_by_two,
    turn,
    turn_back,
)
from optlink.linkage import Pose


@dataclass(frozen=True)
class Yoke(Dyad):
    """A block (first) pinned to a known joint, in a slot of a yoke (second) that slides on a known rail."""

    slot: Guide
    pin: str
    rail: Guide

    kind: ClassVar[str] = "yoke"
    least: ClassVar[float] = 1e-12

    @property
    def joint(self) -> str:
        """Name of the inner joint."""
        return self.slot.name

    @property
    def outer_pins(self) -> tuple[tuple[str, str], ...]:
        """The pin of the block."""
        return ((self.first.body, self.pin),)

    @property
    def prismatic(self) -> tuple[Guide, ...]:
        """The slot and the rail."""
        return self.slot, self.rail

    def solve(self, pose: Pose) -> Value:
        """Slide the yoke until its slot meets the pin."""
        origin, way = pose.line(self.rail, self.rail.other(self.second.body))
        (own, own_way), (at, slot_way) = (pose.local_line(guide, self.second.body) for guide in (self.rail, self.slot))
        axis = turn_back(way, own_way)
        slot, still = turn(slot_way, axis), minus(origin, turn(own, axis))
        miss = minus(pose.point(self.pin), plus(still, turn(at, axis)))
        shift = (cross(slot, miss) - pose.offset(self.slot, self.first, self.pin)) / cross(slot, way)
        pose.points[self.second.start] = plus(still, (shift * way[0], shift * way[1]))
        pose.place(self.second, axis, self.second.start)
        pose.place(self.first, turn_back(slot, pose.local_line(self.slot, self.first.body)[1]), self.pin)
        return cross(slot, way) * cross(slot, way)

    def gap(self, pose: Pose) -> Value:
        """Return zero: it closes wherever slot and rail are not parallel."""
        return 0.0 * pose.margins[self.joint]

    def alignment(self, pose: Pose) -> Value:
        """Return the squared sine of the angle between slot and rail."""
        return pose.margins[self.joint]

    def forces(self, balance: ForceBalance, tilts: Mapping[str, Value]) -> GroupForces:
        """Return the pin force from the forces of the block along the slot and of both along the rail; the others follow."""
        block, yoke = self.links
        p, at, rest = balance.moving.position(self.pin), balance.at(self.slot), balance.at(self.rail)
        slot, rail = balance.across(self.slot, tilts), balance.across(self.rail, tilts)
        own, total = balance.needed[block.body].force, balance.total(self)
        pin = solve_two_by_two(slot, dot(slot, own), rail, dot(rail, total))
        inner = minus(own, pin)
        moment = balance.about(block, at) - cross(minus(p, at), pin)
        held = balance.about(yoke, rest) + cross(minus(at, rest), inner) + moment
        guides = [(self.slot, block.body, inner, moment), (self.rail, yoke.body, minus(total, pin), held)]
        return GroupForces([(self.pin, block.body, pin)], guides, (slot, rail))


def yoke(assembly: Assembly, block: Link, yoke: Link, pin: Joint, slot: Joint, rail: Joint) -> Yoke:
    """Form the group of its two bodies and three joints."""
    assert isinstance(pin, str)
    assert isinstance(slot, Guide)
    assert isinstance(rail, Guide)
    return Yoke(block, yoke, slot, pin, rail)


register(DyadType("RPP", yoke))
