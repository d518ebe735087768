"""Force balances of each type of dyad: the pin force that two balances determine, and the forces that follow from it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from optlink.dynamics.inertia import Wrench
from optlink.dynamics.machine import Moving
from optlink.io import Registry
from optlink.linkage.dyad_types import PRP, RPP, RPR, RRP, RRR
from optlink.linkage.mechanism import Dyad, Guide, Link
from optlink.linkage.vector2d import Value, Vector, cross, dot, minus, plus


def solve_two_by_two(row: Vector, right: Value, other: Vector, other_right: Value) -> Vector:
    """Solve row . x = right, other . x = other_right for the vector x.

    Parameters
    ----------
    row, other : pair of Value
    right, other_right : Value
    """
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
        """Return these forces, elementwise, and those of another solution where `which` is false.

        Parameters
        ----------
        which : bool or array (n,)
        other : GroupForces
        """
        numbers: list[Value] = []
        other.each(lambda x: numbers.append(x) or x)  # type: ignore[func-returns-value]
        rest = iter(numbers)
        return self.each(lambda x: np.where(which, x, next(rest)))


class RemainingWrenches:
    """Wrenches `needed` that the joints not solved yet must exert on the bodies of a machine in motion."""

    def __init__(self, moving: Moving, needed: Mapping[str, Wrench]) -> None:
        self.moving, self.mechanism, self.needed = moving, moving.machine.mechanism, dict(needed)

    def across(self, guide: Guide, tilts: Mapping[str, Value]) -> Vector:
        """Return the direction in which a guide exerts no force: its line, rotated by the friction angle.

        Parameters
        ----------
        guide : Guide
        tilts : mapping of str to Value [-]
            Tangents of the friction angles of guides with friction.
        """
        x, y = self.moving.line(guide.name)
        if guide.name not in tilts:
            return x, y
        tilt = tilts[guide.name]
        return x - tilt * y, y + tilt * x

    def at(self, guide: Guide) -> Vector:
        """Return the point of the slider that slides along the line."""
        return self.moving.position(guide.at or self.mechanism.bodies[guide.slider].start)

    def about(self, link: Link, point: Vector) -> Value:
        """Return the moment about a point that the joints exert on a body.

        Parameters
        ----------
        link : Link
            Body.
        point : pair of Value [m]
        """
        return self.needed[link.body].about(self.moving.state(link.body).start, point)

    def total(self, group: Dyad) -> Vector:
        """Return the force that the outer joints exert on both bodies of a group."""
        first, second = (self.needed[link.body].force for link in group.links)
        return plus(first, second)


BALANCES: Registry[Callable[..., GroupForces]] = Registry()
"""By the kind of the group: (remaining wrenches, group, tangents of friction angles of guides) -> forces."""


@partial(BALANCES.add, "RRR")
def _rrr(balance: RemainingWrenches, group: RRR, tilts: Mapping[str, Value]) -> GroupForces:
    """Moments of the first link about the inner joint, of both about the other outer joint."""
    first, second = group.links
    p, q, j = (balance.moving.position(name) for name in (*group.pins, group.joint))
    one, other = minus(p, j), minus(q, j)
    right = balance.about(first, q) + balance.about(second, q)
    outer = solve_two_by_two(moment_row(one), balance.about(first, j), moment_row(minus(p, q)), right)
    inner = minus(balance.needed[first.body].force, outer)
    pins = [(group.pins[0], first.body, outer), (group.joint, first.body, inner)]
    return GroupForces([*pins, (group.pins[1], second.body, plus(balance.needed[second.body].force, inner))], [], (one, other))


@partial(BALANCES.add, "RRP")
def _rrp(balance: RemainingWrenches, group: RRP, tilts: Mapping[str, Value]) -> GroupForces:
    """Moment of the link about the joint, force of both along the guide."""
    link, slider = group.links
    p, j, across = balance.moving.position(group.outer), balance.moving.position(group.joint), balance.across(group.guide, tilts)
    total = balance.total(group)
    lever = moment_row(minus(p, j))
    outer = solve_two_by_two(lever, balance.about(link, j), across, dot(across, total))
    inner = minus(balance.needed[link.body].force, outer)  # on the link
    at = balance.at(group.guide)
    moment = balance.about(slider, at) + cross(minus(j, at), inner)
    return GroupForces(
        [(group.outer, link.body, outer), (group.joint, link.body, inner)],
        [(group.guide, slider.body, minus(total, outer), moment)],
        (lever, across),
    )


@partial(BALANCES.add, "RPR")
def _rpr(balance: RemainingWrenches, group: RPR, tilts: Mapping[str, Value]) -> GroupForces:
    """Force of the slider along the guide, moment of both about the other outer joint."""
    slider, second = group.links
    p, q = (balance.moving.position(name) for name in group.outer)
    across, needed = balance.across(group.guide, tilts), balance.needed[slider.body].force
    lever = moment_row(minus(p, q))
    outer = solve_two_by_two(lever, balance.about(slider, q) + balance.about(second, q), across, dot(across, needed))
    inner, at = minus(needed, outer), balance.at(group.guide)
    moment = balance.about(slider, at) - cross(minus(p, at), outer)
    return GroupForces(
        [(group.outer[0], slider.body, outer), (group.outer[1], second.body, minus(balance.total(group), outer))],
        [(group.guide, slider.body, inner, moment)],
        (lever, across),
    )


@partial(BALANCES.add, "RPP")
def _rpp(balance: RemainingWrenches, group: RPP, tilts: Mapping[str, Value]) -> GroupForces:
    """Force of the first body along its guide, of both along the rail."""
    first, yoke = group.links
    p, needed, total = balance.moving.position(group.outer), balance.needed[first.body].force, balance.total(group)
    across, rail = (balance.across(guide, tilts) for guide in (group.guide, group.rail))
    outer = solve_two_by_two(across, dot(across, needed), rail, dot(rail, total))
    inner, at, rest = minus(needed, outer), balance.at(group.guide), balance.at(group.rail)
    moment = balance.about(first, at) - cross(minus(p, at), outer)
    reaction_moment = balance.about(yoke, rest) + cross(minus(at, rest), inner) + moment
    return GroupForces(
        [(group.outer, first.body, outer)],
        [(group.guide, first.body, inner, moment), (group.rail, yoke.body, minus(total, outer), reaction_moment)],
        (across, rail),
    )


@partial(BALANCES.add, "PRP")
def _prp(balance: RemainingWrenches, group: PRP, tilts: Mapping[str, Value]) -> GroupForces:
    """Forces of both sliders along their guides determine the pin between them."""
    first, second = group.links
    j = balance.moving.position(group.joint)
    one, other = (balance.needed[link.body].force for link in group.links)
    along, across = (balance.across(guide, tilts) for guide in group.guides)
    inner = solve_two_by_two(along, dot(along, one), across, -dot(across, other))  # on the first
    guides = []
    for link, guide, needed, sign in ((first, group.guides[0], one, 1.0), (second, group.guides[1], other, -1.0)):
        at, pin = balance.at(guide), (sign * inner[0], sign * inner[1])
        guides.append((guide, link.body, minus(needed, pin), balance.about(link, at) - cross(minus(j, at), pin)))
    return GroupForces([(group.joint, first.body, inner)], guides, (along, across))
