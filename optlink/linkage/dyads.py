"""Assur groups of two bodies (dyads) in closed form.

Every dyad is one elementwise function ``dyad(known ..., sizes ..., side) -> (new, margin)``. The margin is dimensionless,
positive where the group can be assembled, zero where its assembly modes meet (dead position) or its lines become parallel,
negative where the loop cannot close; there the result is NaN. Nothing is clipped.

A line is a point on it and its unit vector w; its left normal is n = (-w_y, w_x), and offsets count along n.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np

from optlink.linkage.mechanism import Dyad, GroupPassages, Guide, Joint, Mechanism, Pose
from optlink.linkage.vector2d import Value, Vector, cross, dot, minus, plus, root, turn, turn_back

__all__ = ["prp", "rpp", "rpr", "rrp", "rrr"]


def __dir__() -> list[str]:
    return __all__


def rrr(p: Vector, q: Vector, a: Value, b: Value, side: Value) -> tuple[Vector, Value]:
    """Compute the joint of two links pinned at p and q (RRR dyad).

    Parameters
    ----------
    p, q : pair of Value, any common shape [m]
        The two outer joints.
    a, b : Value [m]
        Link lengths from p and from q, positive.
    side : int or array of int
        +1: the joint lies to the left of p -> q; -1: to the right.

    Returns
    -------
    joint : pair of Value [m]; NaN where the group cannot be assembled
    margin : Value [-]
        (height / distance)^2 of the joint above p -> q; negative where it cannot be assembled, NaN where p = q.

    Notes
    -----
    Intersection of two circles (law of cosines in the triangle of p, q and the joint).
    """
    dx, dy = minus(q, p)
    square = dx * dx + dy * dy
    with np.errstate(all="ignore"):
        inverse = np.divide(1.0, square)
        foot = 0.5 + (0.5 * (a * a - b * b)) * inverse  # along p -> q, as a fraction of it
        margin = (a * a) * inverse - foot * foot
        height = side * root(margin)
        return (p[0] + foot * dx - height * dy, p[1] + foot * dy + height * dx), margin


def rrp(p: Vector, g: Vector, w: Vector, a: Value, offset: Value, side: Value) -> tuple[Vector, Value]:
    """Compute the joint of a link pinned at p and a slider on a known line (RRP dyad).

    Parameters
    ----------
    p : pair of Value [m]
        The outer pin.
    g, w : pair of Value [m], [-]
        A point and the unit vector of the slider's line.
    a : Value [m]
        Link length from p to the joint, positive.
    offset : Value [m]
        Distance of the joint to the left of the line, fixed on the slider.
    side : int or array of int
        +1: the joint lies forward (along w) of the foot of p on the line; -1: backward.

    Returns
    -------
    joint : pair of Value [m]; NaN where the group cannot be assembled
    margin : Value [-]
        1 - (h / a)^2, h the distance of p from the path of the joint; negative where that exceeds the link.

    Notes
    -----
    Intersection of a circle and a line.
    """
    to_p = minus(p, g)
    height = cross(w, to_p) - offset
    with np.errstate(all="ignore"):
        ratio = height / a
        margin = 1.0 - ratio * ratio
        along = dot(w, to_p) + side * (a * root(margin))
        return (g[0] + along * w[0] - offset * w[1], g[1] + along * w[1] + offset * w[0]), margin


def rpr(p: Vector, q: Vector, offset: Value, side: Value) -> tuple[Vector, Value]:
    """Compute the direction of the line along which two bodies pinned at p and q slide (RPR dyad).

    Parameters
    ----------
    p, q : pair of Value [m]
        Outer pins of the body that carries the line (p) and of the slider (q).
    offset : Value [m]
        Distance of q minus that of p to the left of the line, fixed on the two bodies.
    side : int or array of int
        +1: q lies forward (along the line) of p; -1: backward.

    Returns
    -------
    direction : pair of Value [-], unit vector of the line; NaN where the group cannot be assembled
    margin : Value [-]
        1 - (offset / distance)^2; negative where the pins are nearer than the offset, NaN where p = q.

    Notes
    -----
    p -> q is the sum of the slide along the line and the offset across it (right triangle).
    """
    dx, dy = minus(q, p)
    with np.errstate(all="ignore"):
        inverse = np.divide(1.0, np.sqrt(dx * dx + dy * dy))
        c, s = dx * inverse, dy * inverse
        across = offset * inverse
        margin = 1.0 - across * across
        along = side * root(margin)
        return (c * along + s * across, s * along - c * across), margin


def rpp(p: Vector, y: Vector, w: Vector, u: Vector, offset: Value) -> tuple[Value, Value]:
    """Compute the displacement of a yoke on its known line, moved by a slider that is pinned at p (RPP dyad).

    Parameters
    ----------
    p : pair of Value [m]
        The outer pin, fixed on the slider.
    y : pair of Value [m]
        A point of the slider's line when the yoke is at zero.
    w, u : pair of Value [-]
        Unit vectors of the yoke's own line and of the slider's line on the yoke.
    offset : Value [m]
        Distance of p to the left of the slider's line.

    Returns
    -------
    displacement : Value [m], of the yoke along w
    margin : Value [-]
        Squared sine of the angle between the two lines: zero where they are parallel.

    Notes
    -----
    Intersection of two lines.
    """
    sine = cross(u, w)
    with np.errstate(all="ignore"):
        return (cross(u, minus(p, y)) - offset) / sine, sine * sine


def prp(g: Vector, w: Vector, h: Vector, u: Vector, first: Value, second: Value) -> tuple[Vector, Value]:
    """Compute the joint of two sliders on two known lines (PRP dyad).

    Parameters
    ----------
    g, w, h, u : pair of Value [m], [-], [m], [-]
        Point and unit vector of the first line, and of the second.
    first, second : Value [m]
        Distances of the joint to the left of the two lines, fixed on the two sliders.

    Returns
    -------
    joint : pair of Value [m]
    margin : Value [-]
        Squared sine of the angle between the two lines: zero where they are parallel.

    Notes
    -----
    Intersection of two lines.
    """
    sine = cross(w, u)
    start = (g[0] - first * w[1], g[1] + first * w[0])
    with np.errstate(all="ignore"):
        along = (second - cross(u, minus(start, h))) / cross(u, w)
        return (start[0] + along * w[0], start[1] + along * w[1]), sine * sine


# --- the five dyads as data types: bodies, joints, assembly mode ---------------------------------------------------------

FORWARD = {"forward": 1, "backward": -1}
"""Assembly modes of a dyad with one slider."""
PARALLEL = 1e-12
"""Squared sine of the angle between two lines below which they count as parallel and meet nowhere."""


@dataclass(frozen=True)
class JointedDyad(Dyad):
    """A dyad of its three joints: the `outer` ones of its first and of its second body, and the `inner` one between them."""

    outer: tuple[Joint, Joint]
    inner: Joint

    @property
    def joint(self) -> str:
        """Name of the inner joint."""
        return self.inner if isinstance(self.inner, str) else self.inner.name

    @property
    def outer_pins(self) -> tuple[tuple[str, str], ...]:
        """Bodies of the group with their pins to bodies placed before."""
        return tuple((link.body, pin) for link, pin in zip(self.links, self.outer, strict=True) if isinstance(pin, str))

    @property
    def prismatic(self) -> tuple[Guide, ...]:
        """Guides of the group."""
        return tuple(joint for joint in (self.outer[0], self.inner, self.outer[1]) if isinstance(joint, Guide))


@dataclass(frozen=True)
class ModalDyad(JointedDyad):
    """A dyad with two assembly modes; `side` is one of them: +1 or -1.

    `follow`: continue it smoothly through its singular positions, starting in the mode `side`, which applies at the crank angle
    `holds_at` [rad], or else at the start of the drive. `passages`: its sides and series, once the sizes are known
    (`continuation.follow`).
    """

    side: int
    follow: bool = field(default=False, kw_only=True)
    holds_at: float | None = field(default=None, kw_only=True)
    passages: GroupPassages | None = field(default=None, kw_only=True, compare=False)

    @property
    def modes(self) -> tuple[str, ...]:
        """Assembly modes, in the notation of the problem file."""
        return tuple(FORWARD)

    def through(self, pose: Pose, formula: Callable[[Value], tuple[Vector, Value]]) -> tuple[Vector, Value]:
        """Return the result of the dyad formula and its assembly margin, near singular positions of its smooth continuation.

        Parameters
        ----------
        pose : Pose
        formula : function
            Of the assembly mode, to the joint, or the unit vector of the guide, and the margin.
        """
        return formula(self.side) if self.passages is None else self.passages.through(pose.angle, formula)


@dataclass(frozen=True)
class RRR(ModalDyad):
    """Two links pinned to known joints and to each other; `side` +1: their joint is left of first -> second outer pin."""

    outer: tuple[str, str]
    inner: str

    kind = "RRR"

    @property
    def modes(self) -> tuple[str, ...]:
        """Assembly modes, in the notation of the problem file."""
        p, q = self.outer
        return f"left of {p}-{q}", f"right of {p}-{q}"

    def solve(self, pose: Pose) -> Value:
        """Add the new joint and both links; return the assembly margin."""
        p, q = self.outer
        a, b = pose.distance(self.first, p, self.inner), pose.distance(self.second, q, self.inner)
        pose.points[self.inner], margin = self.through(pose, lambda side: rrr(pose.point(p), pose.point(q), a, b, side))
        pose.fit(self.first, p, self.inner)
        pose.fit(self.second, q, self.inner)
        return margin

    def _triangle(self, pose: Pose) -> tuple[Value, Value, Value]:
        """Return the lengths of both links and the squared distance of the outer joints."""
        p, q = self.outer
        between = minus(pose.point(q), pose.point(p))
        return pose.distance(self.first, p, self.inner), pose.distance(self.second, q, self.inner), dot(between, between)

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
    """A link pinned to a known joint and to a slider on a known line.

    `side` +1: their joint lies forward, along the guide, of the foot of the outer pin.
    """

    outer: tuple[str, Guide]
    inner: str

    kind = "RRP"

    def solve(self, pose: Pose) -> Value:
        """Add the joint, the link and the slider; return the assembly margin."""
        pin, guide = self.outer
        begin, line = pose.line(guide, guide.other(self.second.body))
        offset, length = pose.offset(guide, self.second, self.inner), pose.distance(self.first, pin, self.inner)
        pose.points[self.inner], margin = self.through(pose, lambda side: rrp(pose.point(pin), begin, line, length, offset, side))
        pose.fit(self.first, pin, self.inner)
        pose.place(self.second, turn_back(line, pose.local_line(guide, self.second.body)[1]), self.inner)
        return margin

    def _height(self, pose: Pose) -> Value:
        """Return the distance of the outer joint to the left of the path of the slider's joint."""
        pin, guide = self.outer
        begin, line = pose.line(guide, guide.other(self.second.body))
        return cross(line, minus(pose.point(pin), begin)) - pose.offset(guide, self.second, self.inner)

    def gap(self, pose: Pose) -> Value:
        """Return the distance of the outer joint from the path of the slider's joint beyond the link [m]."""
        return np.abs(self._height(pose)) - pose.distance(self.first, self.outer[0], self.inner)

    def cosine(self, pose: Pose) -> Value:
        """Return the cosine of the angle from the left normal of the guide to the link; outside [-1, 1] where it cannot close."""
        return -self._height(pose) / pose.distance(self.first, self.outer[0], self.inner)

    def alignment(self, pose: Pose) -> Value:
        """Return the squared sine of the angle between the link and the normal of the guide."""
        return pose.margins[self.inner]


@dataclass(frozen=True)
class RPR(ModalDyad):
    """A slider (first) and the body that carries its line (second), each pinned to a known joint.

    `side` +1: the slider's pin lies forward, along the guide, of the other.
    """

    outer: tuple[str, str]
    inner: Guide

    kind = "RPR"

    def solve(self, pose: Pose) -> Value:
        """Add both bodies; return the assembly margin."""
        q, p = map(pose.point, self.outer)
        line, margin = self.through(pose, lambda side: rpr(p, q, self._offset(pose), side))
        for link, pin in zip(self.links, self.outer, strict=True):
            pose.place(link, turn_back(line, pose.local_line(self.inner, link.body)[1]), pin)
        return margin

    def gap(self, pose: Pose) -> Value:
        """Return the offset of the pins across the guide minus their distance [m]."""
        return np.abs(self._offset(pose)) - np.sqrt(self._square(pose))

    def cosine(self, pose: Pose) -> Value:
        """Return the cosine of the angle from the line of the pins to the normal of the guide; beyond 1 where it cannot close."""
        return self._offset(pose) / np.sqrt(self._square(pose))

    def alignment(self, pose: Pose) -> Value:
        """Return the squared distance of the pins along the guide over the squared crank length.

        At zero the guide force has no lever.
        """
        offset, crank = self._offset(pose), pose.size(pose.mechanism.crank.length)
        return (self._square(pose) - offset * offset) / (crank * crank)

    def _square(self, pose: Pose) -> Value:
        between = minus(*map(pose.point, self.outer))
        return dot(between, between)

    def _offset(self, pose: Pose) -> Value:
        of_slider, of_other = (pose.offset(self.inner, link, pin) for link, pin in zip(self.links, self.outer, strict=True))
        return of_slider - of_other


class LineDyad(JointedDyad):
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

    outer: tuple[str, Guide]
    inner: Guide

    kind = "RPP"

    def solve(self, pose: Pose) -> Value:
        """Add both bodies; return the squared sine of the angle between the two lines."""
        yoke, (pin, rail) = self.second.body, self.outer
        begin, line = pose.line(rail, rail.other(yoke))
        (on_yoke, own_line), (inner, inner_line) = (pose.local_line(guide, yoke) for guide in (rail, self.inner))
        axis = turn_back(line, own_line)
        slot = turn(inner_line, axis)
        zero = minus(begin, turn(on_yoke, axis))  # origin of the yoke's axes at zero displacement
        offset = pose.offset(self.inner, self.first, pin)
        shift, margin = rpp(pose.point(pin), plus(zero, turn(inner, axis)), line, slot, offset)
        pose.points[self.second.start] = plus(zero, (shift * line[0], shift * line[1]))
        pose.place(self.second, axis, self.second.start)
        pose.place(self.first, turn_back(slot, pose.local_line(self.inner, self.first.body)[1]), pin)
        return margin

    def cosine(self, pose: Pose) -> Value:
        """Return the cosine of the angle between the directions of the two lines."""
        yoke, rail = self.second.body, self.outer[1]
        return dot(pose.line(rail, rail.other(yoke))[1], pose.line(self.inner, yoke)[1])


@dataclass(frozen=True)
class PRP(LineDyad):
    """Two sliders on known lines, pinned to each other."""

    outer: tuple[Guide, Guide]
    inner: str

    kind = "PRP"

    def solve(self, pose: Pose) -> Value:
        """Add the pin and both sliders; return the squared sine of the angle between the two lines."""
        pairs = tuple(zip(self.links, self.outer, strict=True))
        (g, w), (h, u) = (pose.line(guide, guide.other(link.body)) for link, guide in pairs)
        first, second = (pose.offset(guide, link, self.inner) for link, guide in pairs)
        pose.points[self.inner], margin = prp(g, w, h, u, first, second)
        for (link, guide), line in zip(pairs, (w, u), strict=True):
            pose.place(link, turn_back(line, pose.local_line(guide, link.body)[1]), self.inner)
        return margin

    def _lines(self, pose: Pose) -> Iterator[Vector]:
        return (pose.line(guide, guide.other(link.body))[1] for link, guide in zip(self.links, self.outer, strict=True))

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
