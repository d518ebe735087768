"""A yoke driven by a pin in its slot (RPP), written afresh in place of the dyad of the package."""

from dataclasses import dataclass

from optlink.extending import (
    Dyad,
    DyadType,
    GroupForces,
    Guide,
    cross,
    dot,
    minus,
    plus,
    register,
    solve_two_by_two,
    turn,
    turn_back,
)


@dataclass(frozen=True)
class Yoke(Dyad):
    """A block (first) pinned to a known joint, in a slot of a yoke (second) that slides on a known rail."""

    slot: Guide
    pin: str
    rail: Guide

    kind, least = "yoke", 1e-12
    joint = property(lambda self: self.slot.name)
    outer_pins = property(lambda self: ((self.first.body, self.pin),))
    prismatic = property(lambda self: (self.slot, self.rail))

    def solve(self, pose):
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

    gap = property(lambda self: lambda pose: 0.0 * pose.margins[self.joint])
    alignment = property(lambda self: lambda pose: pose.margins[self.joint])

    def forces(self, balance, tilts):
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


register(DyadType("RPP", lambda assembly, block, yoke, pin, slot, rail: Yoke(block, yoke, slot, pin, rail)))
