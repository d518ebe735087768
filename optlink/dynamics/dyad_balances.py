"""Force balances of dyads: the pin force that two balances determine, and the forces that follow from it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import get_args

import numpy as np

from optlink.dynamics.inertia import Wrench
from optlink.dynamics.machine import Moving
from optlink.io import Registry
from optlink.linkage.dyad_types import JointedDyad, Transmitting
from optlink.linkage.mechanism import Dyad, Guide, Joint, Link
from optlink.linkage.vector2d import Value, Vector, cross, dot, minus, plus


def solve_two_by_two(row: Vector, right: Value, other: Vector, other_right: Value) -> Vector:
    """Solve row . x = right, other . x = other_right for the vector x."""
    inverse = 1.0 / cross(row, other)
    return (right * other[1] - other_right * row[1]) * inverse, (row[0] * other_right - other[0] * right) * inverse


def moment_row(lever: Vector) -> Vector:
    """Row vector with row . force = moment of the force at the lever."""
    return -lever[1], lever[0]


@dataclass
class GroupForces:
    """Forces of one group: on `body` at a pin, and by a guide on a body (force, moment about the slider's point)."""

    pins: list[tuple[str, str, Vector]] = field(default_factory=list)
    guides: list[tuple[Guide, str, Vector, Value]] = field(default_factory=list)
    rows: tuple[Vector, Vector] = ((1.0, 0.0), (0.0, 1.0))

    @property
    def components(self) -> list[Value]:
        """Components of all forces."""
        return [x for *_, force in self.pins for x in force] + [x for _, _, force, _ in self.guides for x in force]

    def each(self, change: Callable[[Value], Value]) -> GroupForces:
        """Return the forces with every number changed."""
        (a, b), (c, d) = self.rows
        return GroupForces(
            [(point, body, (change(x), change(y))) for point, body, (x, y) in self.pins],
            [(guide, body, (change(x), change(y)), change(m)) for guide, body, (x, y), m in self.guides],
            ((change(a), change(b)), (change(c), change(d))),
        )

    def where(self, which: Value, other: GroupForces) -> GroupForces:
        """Return these forces where `which` is true, elementwise, and those of another solution elsewhere."""
        numbers: list[Value] = []
        other.each(lambda x: numbers.append(x) or x)  # type: ignore[func-returns-value]
        rest = iter(numbers)
        return self.each(lambda x: np.where(which, x, next(rest)))


class RemainingWrenches:
    """Wrenches `needed` that the joints not solved yet must exert on the bodies of a machine in motion.

    `tilts` are the tangents of the friction angles of guides with friction, by name.
    """

    def __init__(self, moving: Moving, needed: Mapping[str, Wrench]) -> None:
        self.moving, self.mechanism, self.needed = moving, moving.machine.mechanism, dict(needed)
        self._places: dict[str, Vector] = {}

    def across(self, guide: Guide, tilts: Mapping[str, Value]) -> Vector:
        """Return the direction in which a guide exerts no force: its line, rotated by the friction angle."""
        x, y = self.moving.line(guide.name)
        if guide.name not in tilts:
            return x, y
        tilt = tilts[guide.name]
        return x - tilt * y, y + tilt * x

    def at(self, joint: Joint) -> Vector:
        """Return the position of a pin, or of the point of the slider that slides along the line of a guide."""
        name = joint if isinstance(joint, str) else joint.at or self.mechanism.bodies[joint.slider].start
        if name not in self._places:
            self._places[name] = self.moving.position(name)
        return self._places[name]

    def about(self, link: Link, point: Vector) -> Value:
        """Return the moment about a point [m] that the joints exert on a body."""
        return self.needed[link.body].about(self.moving.state(link.body).start, point)

    def directions(self, group: JointedDyad, tilts: Mapping[str, Value]) -> tuple[Vector, Vector]:
        """Return the two directions between which a group has its transmission angle; it is singular where they are parallel.

        They are those of two of its joints, seen from the third one, a pin: its inner joint or, if that is a guide, the outer
        one of the first body. A guide has that in which it exerts no force, another pin the normal to the lever between the two
        pins.
        """
        first, second, pin = *group.outer, group.inner
        if isinstance(pin, Guide):
            first, pin = pin, first
        return self._direction(first, pin, tilts), self._direction(second, pin, tilts)

    def _direction(self, joint: Joint, pin: Joint, tilts: Mapping[str, Value]) -> Vector:
        if isinstance(joint, Guide):
            return self.across(joint, tilts)
        return moment_row(minus(self.at(joint), self.at(pin)))

    def component(self, joint: Joint, row: Vector, force: Vector, *links: Link) -> Value:
        """Return row . force for the force of one or two bodies on others at the end of the lever from their outer joint.

        `row` is one of `directions`, `force` [N] that of all joints of the bodies on them.
        """
        if isinstance(joint, Guide):
            return -dot(row, force)
        place = self.at(joint)
        moment = self.about(links[0], place)
        return moment if len(links) == 1 else moment + self.about(links[1], place)

    def total(self, group: Dyad) -> Vector:
        """Return the force that the outer joints exert on both bodies of a group."""
        first, second = (self.needed[link.body].force for link in group.links)
        return plus(first, second)


def jointed_forces(balance: RemainingWrenches, group: JointedDyad, tilts: Mapping[str, Value]) -> GroupForces:
    """Return the forces of a group from its three joints: a pin exerts no moment about itself, a guide no force along its line.

    With an inner pin its force follows from one balance of each body, with an inner guide that of the first body's outer pin
    from one balance of this body and one of both.
    """
    (first, second), (joint, other) = group.links, group.outer
    of_first, of_second = (balance.needed[link.body].force for link in group.links)
    row, across = balance.directions(group, tilts)
    at, moment = balance.at(group.inner), 0.0
    pins: list[tuple[str, str, Vector]] = []
    guides: list[tuple[Guide, str, Vector, Value]] = []
    if isinstance(group.inner, Guide):
        both = balance.component(other, across, plus(of_first, of_second), first, second)
        pin = solve_two_by_two(row, dot(row, of_first), across, -both)
        inner, moment = minus(of_first, pin), balance.about(first, at) - cross(minus(balance.at(joint), at), pin)
        guides.append((group.inner, first.body, inner, moment))
    else:
        component = balance.component(joint, row, of_first, first)
        inner = solve_two_by_two(row, -component, across, balance.component(other, across, of_second, second))
        pins.append((group.inner, first.body, inner))
    outer = minus(of_first, inner), plus(of_second, inner)
    for link, joint, force in zip(group.links, group.outer, outer, strict=True):
        if isinstance(joint, Guide):
            place = balance.at(joint)
            whole, passed = balance.about(link, place), cross(minus(at, place), inner)
            if isinstance(group.inner, Guide):
                passed = passed + moment
            guides.append((joint, link.body, force, whole - passed if link is first else whole + passed))
        else:
            pins.append((joint, link.body, force))
    return GroupForces(pins, guides, (row, across))


BALANCES: Registry[Callable[..., GroupForces]] = Registry()
"""By the kind of the group: (remaining wrenches, group, tangents of friction angles of guides) -> forces."""

for kind in get_args(Transmitting):
    BALANCES.add(kind.kind, jointed_forces)
