"""The five dyads as data types (bodies, joints, assembly mode); the formulas are in `dyads`."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from optlink.linkage.dyads import prp, rpp, rpr, rrp, rrr
from optlink.linkage.mechanism import Dyad, Guide, Mechanism, Pose
from optlink.linkage.passage import GroupPassages
from optlink.linkage.vector2d import Value, Vector, cross, dot, minus, plus, turn, turn_back

FORWARD = {"forward": 1, "backward": -1}
"""Assembly modes of a dyad with one slider."""
PARALLEL = 1e-12
"""Squared sine of the angle between two lines below which they count as parallel and meet nowhere."""


@dataclass(frozen=True)
class ModalDyad(Dyad):
    """A dyad with two assembly modes; `side` is one of them.

    `follow`: continue it smoothly through its singular positions, starting in the mode `side`, which applies at the crank angle
    `holds_at` [rad], or else at the start of the drive. `passages`: its sides and series, once the sizes are known
    (`continuation.follow`).
    """

    follow: bool = field(default=False, kw_only=True)
    holds_at: float | None = field(default=None, kw_only=True)
    passages: GroupPassages | None = field(default=None, kw_only=True, compare=False)

    @property
    def modes(self) -> tuple[str, ...]:
        """Assembly modes, in the notation of the problem file."""
        return tuple(FORWARD)

    def mode(self, pose: Pose) -> Value:
        """Return the assembly mode at the crank angles of a pose."""
        return self.side if self.passages is None else self.passages.side(pose.angle)  # type: ignore[attr-defined]

    def through(self, pose: Pose, new: Vector, margin: Value) -> tuple[Vector, Value]:
        """Return the result of the formula, replaced by its smooth continuation near singular positions.

        Parameters
        ----------
        pose : Pose
        new : pair of Value [m or -]
            Result of the dyad formula: the joint, or the unit vector of the guide.
        margin : Value [-]
            Assembly margin.
        """
        return (new, margin) if self.passages is None else self.passages.through(pose.angle, new, margin)


@dataclass(frozen=True)
class RRR(ModalDyad):
    """Two links pinned to known joints and to each other.

    By default the outer joints are the starts of the links and the inner joint is their common end.
    """

    side: int  # +1: new joint left of the outer joint of first -> that of second
    outer: tuple[str, str] = ("", "")
    inner: str = ""

    kind = "RRR"

    @property
    def joint(self) -> str:
        """Name of the joint that the group adds."""
        return self.inner or self.first.end

    @property
    def pins(self) -> tuple[str, str]:
        """The outer joints, of the first and of the second link."""
        return self.outer[0] or self.first.start, self.outer[1] or self.second.start

    @property
    def outer_pins(self) -> tuple[tuple[str, str], ...]:
        """Bodies of the group with their pins to bodies placed before."""
        return (self.first.body, self.pins[0]), (self.second.body, self.pins[1])

    @property
    def modes(self) -> tuple[str, ...]:
        """Assembly modes, in the notation of the problem file."""
        p, q = self.pins
        return f"left of {p}-{q}", f"right of {p}-{q}"

    def solve(self, pose: Pose) -> Value:
        """Add the new joint and both links; return the assembly margin."""
        p, q = self.pins
        a, b = pose.distance(self.first, p, self.joint), pose.distance(self.second, q, self.joint)
        joint, margin = rrr(pose.point(p), pose.point(q), a, b, self.mode(pose))
        pose.points[self.joint], margin = self.through(pose, joint, margin)
        pose.fit(self.first, p, self.joint)
        pose.fit(self.second, q, self.joint)
        return margin

    def _triangle(self, pose: Pose) -> tuple[Value, Value, Value]:
        """Return the lengths of both links and the squared distance of the outer joints."""
        p, q = self.pins
        between = minus(pose.point(q), pose.point(p))
        return pose.distance(self.first, p, self.joint), pose.distance(self.second, q, self.joint), dot(between, between)

    def cosine(self, pose: Pose) -> Value:
        """Return the cosine of the transmission angle, from the link lengths; outside [-1, 1] where the group cannot close."""
        a, b, square = self._triangle(pose)
        return (a * a + b * b - square) / (2.0 * (a * b))

    def gap(self, pose: Pose) -> Value:
        """Return the distance of the outer joints beyond the reach of the links, or below their least distance [m]."""
        a, b, square = self._triangle(pose)
        distance = np.sqrt(square)
        return np.maximum(distance - (a + b), np.abs(a - b) - distance)

    def alignment(self, pose: Pose) -> Value:
        """Return the squared sine of the transmission angle, from the lengths alone."""
        a, b, square = self._triangle(pose)
        return (square - (a - b) * (a - b)) * ((a + b) * (a + b) - square) / (4.0 * a * a * b * b)


@dataclass(frozen=True)
class RRP(ModalDyad):
    """A link pinned to a known joint and to a slider on a known line."""

    guide: Guide
    outer: str
    inner: str
    side: int  # +1: the joint lies forward, along the guide, of the foot of the outer joint

    kind = "RRP"

    @property
    def joint(self) -> str:
        """Name of the joint between link and slider."""
        return self.inner

    @property
    def outer_pins(self) -> tuple[tuple[str, str], ...]:
        """Bodies of the group with their pins to bodies placed before."""
        return ((self.first.body, self.outer),)

    @property
    def prismatic(self) -> tuple[Guide, ...]:
        """Guides of the group."""
        return (self.guide,)

    def solve(self, pose: Pose) -> Value:
        """Add the joint, the link and the slider; return the assembly margin."""
        begin, line = pose.line(self.guide, self.guide.other(self.second.body))
        offset = pose.offset(self.guide, self.second, self.joint)
        length = pose.distance(self.first, self.outer, self.joint)
        joint, margin = rrp(pose.point(self.outer), begin, line, length, offset, self.mode(pose))
        pose.points[self.joint], margin = self.through(pose, joint, margin)
        pose.fit(self.first, self.outer, self.joint)
        pose.place(self.second, turn_back(line, pose.local_line(self.guide, self.second.body)[1]), self.joint)
        return margin

    def _height(self, pose: Pose) -> Value:
        """Return the distance of the outer joint to the left of the path of the slider's joint."""
        begin, line = pose.line(self.guide, self.guide.other(self.second.body))
        return cross(line, minus(pose.point(self.outer), begin)) - pose.offset(self.guide, self.second, self.joint)

    def gap(self, pose: Pose) -> Value:
        """Return the distance of the outer joint from the path of the slider's joint beyond the link [m]."""
        return np.abs(self._height(pose)) - pose.distance(self.first, self.outer, self.joint)

    def cosine(self, pose: Pose) -> Value:
        """Return the cosine of the angle from the left normal of the guide to the link; outside [-1, 1] where it cannot close."""
        return -self._height(pose) / pose.distance(self.first, self.outer, self.joint)

    def alignment(self, pose: Pose) -> Value:
        """Return the squared sine of the angle between the link and the normal of the guide."""
        return pose.margins[self.joint]


@dataclass(frozen=True)
class RPR(ModalDyad):
    """A slider (first) and the body that carries its line (second), each pinned to a known joint."""

    guide: Guide
    outer: tuple[str, str]
    side: int  # +1: the slider's pin lies forward, along the guide, of the other

    kind = "RPR"

    @property
    def joint(self) -> str:
        """Name of the guide between the two."""
        return self.guide.name

    @property
    def outer_pins(self) -> tuple[tuple[str, str], ...]:
        """Bodies of the group with their pins to bodies placed before."""
        return (self.first.body, self.outer[0]), (self.second.body, self.outer[1])

    @property
    def prismatic(self) -> tuple[Guide, ...]:
        """Guides of the group."""
        return (self.guide,)

    def solve(self, pose: Pose) -> Value:
        """Add both bodies; return the assembly margin."""
        q, p = (pose.point(name) for name in self.outer)
        line, margin = self.through(pose, *rpr(p, q, self._offset(pose), self.mode(pose)))
        for link, pin in zip(self.links, self.outer, strict=True):
            pose.place(link, turn_back(line, pose.local_line(self.guide, link.body)[1]), pin)
        return margin

    def gap(self, pose: Pose) -> Value:
        """Return the offset of the pins across the guide minus their distance [m]."""
        between = minus(*(pose.point(name) for name in self.outer))
        return np.abs(self._offset(pose)) - np.sqrt(dot(between, between))

    def cosine(self, pose: Pose) -> Value:
        """Return the cosine of the angle from the line of the pins to the normal of the guide; beyond 1 where it cannot close."""
        between = minus(*(pose.point(name) for name in self.outer))
        return self._offset(pose) / np.sqrt(dot(between, between))

    def alignment(self, pose: Pose) -> Value:
        """Return the squared distance of the pins along the guide over the squared crank length.

        At zero the guide force has no lever.
        """
        between, offset = minus(*(pose.point(name) for name in self.outer)), self._offset(pose)
        crank = pose.size(pose.mechanism.crank.length)
        return (dot(between, between) - offset * offset) / (crank * crank)

    def _offset(self, pose: Pose) -> Value:
        of_slider, of_other = (pose.offset(self.guide, link, pin) for link, pin in zip(self.links, self.outer, strict=True))
        return of_slider - of_other


class LineDyad(Dyad):
    """A dyad whose two sliders determine it by their lines, which meet once unless they are parallel."""

    least = PARALLEL

    def gap(self, pose: Pose) -> Value:
        """Return zero: two lines intersect unless they are parallel."""
        return 0.0 * pose.margins[self.joint]

    def alignment(self, pose: Pose) -> Value:
        """Return the squared sine of the angle between the two lines."""
        return pose.margins[self.joint]


@dataclass(frozen=True)
class RPP(LineDyad):
    """A slider (first) pinned to a known joint, on a yoke (second) that slides on a known line."""

    guide: Guide  # between the two
    outer: str
    rail: Guide  # of the yoke

    kind = "RPP"

    @property
    def joint(self) -> str:
        """Name of the guide between the two."""
        return self.guide.name

    @property
    def outer_pins(self) -> tuple[tuple[str, str], ...]:
        """Bodies of the group with their pins to bodies placed before."""
        return ((self.first.body, self.outer),)

    @property
    def prismatic(self) -> tuple[Guide, ...]:
        """Guides of the group."""
        return self.guide, self.rail

    def solve(self, pose: Pose) -> Value:
        """Add both bodies; return the squared sine of the angle between the two lines."""
        yoke = self.second.body
        begin, line = pose.line(self.rail, self.rail.other(yoke))
        (on_yoke, own_line), (inner, inner_line) = (pose.local_line(guide, yoke) for guide in (self.rail, self.guide))
        axis = turn_back(line, own_line)
        slot = turn(inner_line, axis)
        zero = minus(begin, turn(on_yoke, axis))  # origin of the yoke's axes at zero displacement
        offset = pose.offset(self.guide, self.first, self.outer)
        shift, margin = rpp(pose.point(self.outer), plus(zero, turn(inner, axis)), line, slot, offset)
        pose.points[self.second.start] = plus(zero, (shift * line[0], shift * line[1]))
        pose.place(self.second, axis, self.second.start)
        pose.place(self.first, turn_back(slot, pose.local_line(self.guide, self.first.body)[1]), self.outer)
        return margin

    def cosine(self, pose: Pose) -> Value:
        """Return the cosine of the angle between the directions of the two lines."""
        return dot(pose.line(self.rail, self.rail.other(self.second.body))[1], pose.line(self.guide, self.second.body)[1])


@dataclass(frozen=True)
class PRP(LineDyad):
    """Two sliders on known lines, pinned to each other."""

    guides: tuple[Guide, Guide]
    inner: str

    kind = "PRP"

    @property
    def joint(self) -> str:
        """Name of the pin between the two."""
        return self.inner

    @property
    def prismatic(self) -> tuple[Guide, ...]:
        """Guides of the group."""
        return self.guides

    def solve(self, pose: Pose) -> Value:
        """Add the pin and both sliders; return the squared sine of the angle between the two lines."""
        pairs = tuple(zip(self.links, self.guides, strict=True))
        (g, w), (h, u) = (pose.line(guide, guide.other(link.body)) for link, guide in pairs)
        first, second = (pose.offset(guide, link, self.joint) for link, guide in pairs)
        pose.points[self.joint], margin = prp(g, w, h, u, first, second)
        for (link, guide), line in zip(pairs, (w, u), strict=True):
            pose.place(link, turn_back(line, pose.local_line(guide, link.body)[1]), self.joint)
        return margin

    def _lines(self, pose: Pose) -> Iterator[Vector]:
        return (pose.line(guide, guide.other(link.body))[1] for link, guide in zip(self.links, self.guides, strict=True))

    def sine(self, pose: Pose) -> Value:
        """Return the sine of the angle from the first line to the second; it changes sign where they become parallel."""
        return cross(*self._lines(pose))

    def cosine(self, pose: Pose) -> Value:
        """Return the cosine of the angle between the directions of the two lines."""
        return dot(*self._lines(pose))


Transmitting = RRR | RRP | RPR | RPP | PRP
"""The dyads that have a transmission angle: `cosine` is its cosine.

It is the angle between the force that the driving body exerts on the driven one, without friction and inertia, and the direction
in which that force would have no effect; 90 deg is best, and the pressure angle is the difference from 90 deg. RRR: the angle
between the two links. RRP: between the link and the normal of the slider's line. RPR: between the line of the two pins and the
normal of the guide. RPP, PRP: between the two lines. Both bodies of a dyad can be the driven one.

References
----------
H. Alt, Der Uebertragungswinkel und seine Bedeutung fuer das Konstruieren periodischer Getriebe, Werkstattstechnik 26 (1932).

S. S. Balli, S. Chand, Transmission angle in mechanisms, Mechanism and Machine Theory 37 (2002) 175-195.
"""


def transmitting(mechanism: Mechanism) -> list[Transmitting]:
    """Return the groups of a mechanism that have a transmission angle, in their order."""
    return [group for group in mechanism.groups if isinstance(group, Transmitting)]
