"""Spanning tree of a mechanism cut at its gaps: the ideal joints form a tree of bodies with its coordinates.

A body is connected to its parent by a pin (coordinate: its own angle) or by a guide (coordinate: the slide), or is free (two
coordinates of its start, and its angle). Ideal joints outside the tree close loops; each gives two equations.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, NamedTuple

from optlink.dynamics.inertia import BodyMotion
from optlink.linkage.mechanism import FRAME, Guide, Mechanism, Pose
from optlink.linkage.vector2d import Value, Vector, angle, cross, dot, minus, plus, turn, turn_back, unit

Kind = Literal["angle", "x", "y", "slide"]


class Coordinate(NamedTuple):
    """One coordinate of a body: its `angle` [rad], `x` or `y` of its start [m], or a `slide` [m]."""

    body: str
    kind: Kind

    @property
    def name(self) -> str:
        """Name for columns and messages."""
        return f"{self.body}.{self.kind}"


class BodyPlace(NamedTuple):
    """Position of a body: its start [m] and the unit vector of its x axis."""

    start: Vector
    axis: Vector


class Pin(NamedTuple):
    """An ideal revolute joint between two bodies."""

    point: str
    first: str
    second: str

    @property
    def bodies(self) -> tuple[str, str]:
        """The two bodies."""
        return self.first, self.second


class Branch(NamedTuple):
    """Connection of a body to the tree: by a joint to a body placed before it, or none (free body)."""

    body: str
    parent: str
    joint: Pin | Guide | None


@dataclass(frozen=True)
class SpanningTree:
    """A mechanism cut at its pins in `gaps`: point -> body that is cut off there (the journal)."""

    mechanism: Mechanism
    sizes: Mapping[str, Value]
    gaps: Mapping[str, str]

    @cached_property
    def joints(self) -> tuple[Pin | Guide, ...]:
        """The ideal joints, each between two bodies: pins, then guides."""
        pins = []
        for point, bodies in self.mechanism.pins.items():
            carriers = [body for body in bodies if body != self.gaps.get(point)]
            pins += [Pin(point, carriers[0], other) for other in carriers[1:]]
        return (*pins, *self.mechanism.guides)

    @cached_property
    def branches(self) -> tuple[Branch, ...]:
        """All bodies, each after its parent."""
        tree = self._grow(free_crank=False)
        crank = next(branch for branch in tree if branch.body == self.mechanism.crank.body)
        # the drive prescribes the crank angle, so it must be a coordinate: a crank connected by a guide becomes a root
        return self._grow(free_crank=True) if isinstance(crank.joint, Guide) else tree

    def _grow(self, *, free_crank: bool) -> tuple[Branch, ...]:
        tree: dict[str, Branch] = {}
        if free_crank:
            tree[self.mechanism.crank.body] = Branch(self.mechanism.crank.body, FRAME, None)
        waiting = [FRAME, *tree]
        for root in ["", *self.mechanism.bodies]:
            if root and root not in tree:
                tree[root] = Branch(root, FRAME, None)
                waiting.append(root)
            while waiting:
                at = waiting.pop(0)
                for joint in self.joints:
                    if at in joint.bodies:
                        other = joint.bodies[0] if joint.bodies[1] == at else joint.bodies[1]
                        if other != FRAME and other not in tree:
                            tree[other] = Branch(other, at, joint)
                            waiting.append(other)
        return tuple(tree.values())

    @cached_property
    def closing(self) -> tuple[Pin | Guide, ...]:
        """The ideal joints outside the tree."""
        used = {id(branch.joint) for branch in self.branches}
        return tuple(joint for joint in self.joints if id(joint) not in used)

    @cached_property
    def coordinates(self) -> tuple[Coordinate, ...]:
        """The coordinates of the tree, in the order of the bodies."""
        coordinates = []
        for body, _, joint in self.branches:
            free: tuple[Kind, ...] = ("x", "y", "angle") if joint is None else ("slide" if isinstance(joint, Guide) else "angle",)
            coordinates += [Coordinate(body, kind) for kind in free]
        return tuple(coordinates)

    @cached_property
    def driven(self) -> int:
        """Index of the crank's angle among the coordinates."""
        return self.coordinates.index(Coordinate(self.mechanism.crank.body, "angle"))

    @cached_property
    def local(self) -> Pose:
        """Local coordinates of points and lines on the bodies; no body is placed in it."""
        return Pose(self.mechanism, self.sizes)

    def place(self, values: Sequence[Value]) -> dict[str, BodyPlace]:
        """Return the position of every body from the coordinates (floats, arrays, symbols or jets), in their order."""
        places = {FRAME: BodyPlace((0.0, 0.0), (1.0, 0.0))}
        remaining = iter(values)
        for body, parent, joint in self.branches:
            if joint is None:
                places[body] = BodyPlace((next(remaining), next(remaining)), unit(next(remaining)))
            elif isinstance(joint, Guide):
                places[body] = self._slid(joint, body, places[parent], next(remaining))
            else:
                axis = unit(next(remaining))
                at = self.at(joint.point, parent, places[parent])
                places[body] = BodyPlace(minus(at, turn(self.local.local(body, joint.point), axis)), axis)
        return places

    def _slid(self, guide: Guide, body: str, parent: BodyPlace, slide: Value) -> BodyPlace:
        """Place a body in a guide of its parent; the body may be the slider, or carry the line."""
        at, line_on_body = self.local.local_line(guide, body)
        begin, way = self.line(guide, guide.other(body), parent)
        axis, shift = turn_back(way, line_on_body), slide if body == guide.slider else -slide
        return BodyPlace(minus((begin[0] + shift * way[0], begin[1] + shift * way[1]), turn(at, axis)), axis)

    def at(self, point: str, body: str, place: BodyPlace | BodyMotion) -> Vector:
        """Return the position of a point of a placed body [m]."""
        return plus(place.start, turn(self.local.local(body, point), place.axis))

    def line(self, guide: Guide, body: str, place: BodyPlace | BodyMotion) -> tuple[Vector, Vector]:
        """Return a point [m] and the unit vector of a guide's line, from the place of one of its two bodies."""
        point, way = self.local.local_line(guide, body)
        return plus(place.start, turn(point, place.axis)), turn(way, place.axis)

    def slide(self, guide: Guide, places: Mapping[str, BodyPlace]) -> Value:
        """Return the displacement of the slider along its line [m]."""
        begin, way = self.line(guide, guide.on, places[guide.on])
        return dot(minus(self.line(guide, guide.slider, places[guide.slider])[0], begin), way)

    def open(self, places: Mapping[str, BodyPlace]) -> list[Value]:
        """Return the residuals of the closing joints [m, or the sine of an angle], two for each joint."""
        gaps: list[Value] = []
        for joint in self.closing:
            first, second = joint.bodies
            if isinstance(joint, Guide):
                at, direction = self.line(joint, first, places[first])
                begin, way = self.line(joint, second, places[second])
                gaps += [cross(way, minus(at, begin)), cross(way, direction)]
            else:
                gaps += minus(self.at(joint.point, first, places[first]), self.at(joint.point, second, places[second]))
        return gaps

    def read(self, pose: Pose) -> list[Value]:
        """Return the coordinates in a pose of the mechanism without gaps (jets if the pose has jets)."""
        values: list[Value] = []
        for body, kind in self.coordinates:
            if kind == "angle":
                values.append(angle(pose.direction(body)))
            elif kind == "slide":
                branch = next(branch for branch in self.branches if branch.body == body)
                assert isinstance(branch.joint, Guide)
                values.append(pose.slide(branch.joint))
            else:
                values.append(pose.points[self.mechanism.bodies[body].start][0 if kind == "x" else 1])
        return values
