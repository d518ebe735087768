"""Links as flat parts [mm]: outlines of straight edges and arcs, holes, slots and pins.

A block whose only point is a pin becomes that pin, which runs in a slot of the other body of its guide: the same motion. Any
other sliding body runs with two pins in the slot.
"""

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from optlink.errors import InputError
from optlink.linkage.mechanism import FRAME, Arm, Guide, Mechanism
from optlink.linkage.motion import Motion
from optlink.linkage.vector2d import TURN, Array
from optlink.presentation.export.dxf import HOLE, MAX_HOLE_SHARE, WIDTH, Vertex, nearest_holes, rounded, travelled, usual_hole
from optlink.presentation.format import round_below
from optlink.presentation.parts.outline import ENDS
from optlink.presentation.scene import named_points, scene
from optlink.presentation.shapes import cross, plain
from optlink.problem.machine.parts import End
from optlink.problem.quantity import Quantity
from optlink.tasks.analyze import Analysis

MM = 1e3
THICKNESS, SPACER = 0.75, 0.2  # default thickness of links and washers in hole diameters
OVERTRAVEL = 0.25  # default length of a slot beyond the travel at each end in hole diameters
WHOLE = 0.25  # about the step to which the ends of a slot are rounded outwards, in its length beyond the travel
HEAD, HEAD_HEIGHT = 1.6, 0.6  # default diameter and height of a pin's head in pin diameters
STEPS = 720  # positions per revolution at which slots, pins and distances are computed
SAME = 1e-6  # distance of coincident points, as a share of the hole diameter


@dataclass(frozen=True, eq=False)
class Opening:
    """A hole or a slot of a part [mm]: a pin may be anywhere between its ends (2, 2), which are equal in a hole."""

    joint: str
    ends: Array
    diameter: float
    fit: str = ""

    @property
    def round(self) -> bool:
        """Whether it is a hole."""
        return len(self.outline) == 2

    @property
    def outline(self) -> tuple[Vertex, ...]:
        """Its edge, counter-clockwise."""
        return rounded(self.ends, 0.5 * self.diameter)


@dataclass(frozen=True, eq=False)
class FlatPart:
    """A link as a flat part in its own axes [mm].

    Its outline is half the width away from the hull of its openings and marks, more at ends that are not round. Its dimensions
    begin at the point `origin` (2,), and go along and across the unit vector `along` (2,).
    """

    name: str
    openings: tuple[Opening, ...]
    marks: Mapping[str, Array]
    width: float
    thickness: float
    material: str
    origin: Array
    along: Array
    note: str = ""
    end: End = "round"

    @cached_property
    def core(self) -> Array:
        """Points (n, 2) from whose convex hull the outline keeps half the width."""
        return np.array([*(end for one in self.openings for end in one.ends), *self.marks.values()]).reshape(-1, 2)

    @cached_property
    def outline(self) -> tuple[Vertex, ...]:
        """Its edge, counter-clockwise."""
        return ENDS[self.end](rounded(self.core, 0.5 * self.width))

    @property
    def reach(self) -> float:
        """Distance of its outline from the hull of its `spine`."""
        return 0.5 * self.width if any(bulge for *_, bulge in self.outline) else 0.0

    @property
    def spine(self) -> Array:
        """Points (n, 2) of whose hull its outline is at the distance `reach`: the corners where it has no arcs."""
        return self.core if self.reach else np.array(self.outline)[:, :2]

    @property
    def corners(self) -> tuple[Array, Array]:
        """Lower left and upper right corner (2,) of the rectangle round it."""
        return self.spine.min(axis=0) - self.reach, self.spine.max(axis=0) + self.reach


@dataclass(frozen=True, eq=False)
class Pin:
    """A pin [mm], fixed at a point `at` (2,) of the body `on` in the axes of that; the parts that it joins."""

    name: str
    on: str
    at: Array
    diameter: float
    head: float
    parts: tuple[str, ...]

    @property
    def height(self) -> float:
        """Height of a head; zero without heads."""
        return HEAD_HEIGHT * self.diameter if self.head > self.diameter else 0.0


@dataclass(frozen=True, eq=False)
class PartSet:
    """The parts and pins of a linkage over its motion; `spacer` [mm] between two layers, `file` names the problem in errors.

    `notes`: sentences for who makes them.
    """

    parts: Mapping[str, FlatPart]
    pins: tuple[Pin, ...]
    spacer: float
    motion: Motion
    file: str
    notes: tuple[str, ...]

    @property
    def pitch(self) -> float:
        """Distance of two layers [mm]: thickness and washer, or more where a head must end before the next layer but one."""
        thickness, head = max(part.thickness for part in self.parts.values()), max((pin.height for pin in self.pins), default=0.0)
        return max(thickness + self.spacer, 0.5 * (thickness + self.spacer + head))


def part_set(cycle: Analysis, hole: float | None = None, width: float | None = None) -> PartSet:
    """Return the links of a machine as parts, with hole diameter and link width [m] in place of those of the problem file.

    Raises
    ------
    InputError
        If a link cannot be made of a flat part, or two of its openings overlap.
    """
    return _Maker(cycle, hole, width).made()


class _Maker:
    """Makes the parts of a machine."""

    def __init__(self, cycle: Analysis, hole: float | None, width: float | None) -> None:
        self.cycle, self.file, self.section = cycle, cycle.problem.file, cycle.problem.model.made
        self.mechanism: Mechanism = cycle.machine.mechanism
        direction = math.copysign(1.0, cycle.speed)
        first, last = float(cycle.positions[0]), float(cycle.positions[-1])
        last = first + direction * cycle.cycle if cycle.full else last
        count = max(2, math.ceil(abs(last - first) / TURN * STEPS)) + 1
        self.motion = cycle.machine.motion(np.linspace(first, last, count))
        self.points = {
            body: {name: MM * at for name, at in named_points(self.motion, body).items()}
            for body in (FRAME, *self.mechanism.bodies)
        }
        drawn = scene(cycle)
        for body in (*self.mechanism.cylinders, *self.mechanism.rods):
            message = f"{body} is a cylinder, a part to buy: parts of linkages with cylinders are not supported"
            raise InputError(message, "Export the drawing: leave --content out, and write a .dxf file", self.file)
        for body, profiles in drawn.profiles.items():
            message = f"{body} has the profile of a cam, gear or pulley, which is not supported as a part"
            if profiles:
                raise InputError(message, "Export the drawing: leave --content out, and write a .dxf file", self.file)
        least = nearest_holes(self.mechanism, self.motion)[1]
        extent = min(max(drawn.box[2:]), MAX_HOLE_SHARE * least / HOLE)
        self.hole = self._size(self.section.hole, usual_hole(extent), hole)
        self.width = self._size(self.section.width, WIDTH * self.hole, width)
        self.thickness = self._share(self.section.thickness, THICKNESS)
        self.overtravel = self._share(self.section.overtravel, OVERTRAVEL)
        self.step = round_below(WHOLE * self.overtravel, (1.0, 2.0, 5.0), 1e-9)

    @staticmethod
    def _size(stated: Quantity | None, usual: float, option: float | None = None) -> float:
        """Return a size [mm]: that of the option [m], of the file, or the usual one."""
        return MM * option if option is not None else usual if stated is None else MM * stated.value

    def _share(self, stated: Quantity | None, share: float) -> float:
        """Return a size [mm]: that of the file, or about a share of the hole diameter."""
        return self._size(stated, round(round_below(share * self.hole, room=1e-9), 6))

    def made(self) -> PartSet:
        """Return parts and pins."""
        notes = ["Strength is not considered."]
        openings: dict[str, list[Opening]] = {body: [] for body in (FRAME, *self.mechanism.bodies)}
        pins: list[Pin] = []
        blocks = dict(self._blocks())
        for name, owners in self.mechanism.pins.items():
            guide = next((blocks[body] for body in owners if body in blocks), None)
            slotted = None if guide is None else guide.other(next(body for body in owners if body in blocks))
            bodies = [body for body in owners if body not in blocks]
            for body in bodies:
                openings[body].append(self._hole(name, self.points[body][name]))
            on = owners[0] if bodies == [] else bodies[0]
            if guide is not None and slotted is not None:
                openings[slotted].append(self._slot(name, guide, slotted))
                bodies.append(slotted)
                notes.append(f"Pin {name} stands for {guide.other(slotted)}, which is no part, and runs in a slot of {slotted}.")
            pins.append(self._pin(name, on, self.points[on][name], bodies))
        for guide in self._guides(blocks):
            for end, at in zip("ab", self._ends(guide), strict=True):
                name = f"{guide.name}.{end}"
                openings[guide.slider].append(self._hole(name, at))
                pins.append(self._pin(name, guide.slider, at, [guide.slider, guide.on]))
            openings[guide.on].append(self._slot(guide.name, guide, guide.on))
        parts = {body: self._part(body, tuple(found)) for body, found in openings.items() if found and body not in blocks}
        for body in self.section.links:
            if body not in parts:
                message = f"{body} is no part: {'a pin stands for it' if body in blocks else 'it has no holes'}"
                raise InputError(message, "Leave it out", self.file, "parts.links", body)
        if any(not one.round for part in parts.values() for one in part.openings):
            most = number(self.overtravel + self.step)
            notes.append(f"Slots are {number(self.overtravel)} to {most} mm longer than the travel at each end.")
        if any(self._of_joint(pin.name)[0] == pin.diameter for pin in pins):
            notes.append("Holes have no clearance for their pins.")
        return PartSet(parts, tuple(pins), self._share(self.section.spacer, SPACER), self.motion, self.file, tuple(notes))

    def _blocks(self) -> Iterator[tuple[str, Guide]]:
        """Yield the bodies that only join a pin to a guide."""
        guides = self.mechanism.guides
        taken: set[str] = set()
        for guide in guides:
            for body in guide.bodies:
                alone = body != FRAME and len(self.points[body]) == 1 and sum(body in one.bodies for one in guides) == 1
                if alone and guide.name not in taken and next(iter(self.points[body])) in self.mechanism.pins:
                    taken.add(guide.name)
                    yield body, guide

    def _guides(self, blocks: Mapping[str, Guide]) -> list[Guide]:
        return [guide for guide in self.mechanism.guides if guide not in blocks.values()]

    def _of_joint(self, name: str) -> tuple[float, float]:
        """Return the diameters of holes and pin of a joint [mm]."""
        own = self.section.joints.get(name)
        hole = self._size(own.hole if own else None, self.hole)
        usual = self._size(self.section.pin, hole)
        pin = self._size(own.pin if own else None, min(usual, hole) if own and own.hole else usual)
        if pin > hole:
            message = f"the pin of {name} is thicker than its holes, which measure {hole:.6g} mm"
            key = f"parts.joints.{name}.pin" if own and own.pin else "parts.pin"
            raise InputError(message, "Give a thinner pin or a larger hole", self.file, key, f"{pin:.6g} mm")
        return hole, pin

    def _hole(self, name: str, at: Array) -> Opening:
        return self._opening(name, np.array([at, at]))

    def _opening(self, name: str, ends: Array) -> Opening:
        own = self.section.joints.get(name)
        return Opening(name, ends, self._of_joint(name)[0], (own and own.fit) or self.section.fit)

    def _pin(self, name: str, on: str, at: Array, parts: list[str]) -> Pin:
        diameter = self._of_joint(name)[1]
        head = self._size(self.section.head, HEAD * diameter)
        return Pin(name, on, at, diameter, max(head, diameter), tuple(dict.fromkeys(parts)))

    def _slot(self, name: str, guide: Guide, body: str) -> Opening:
        """Return the slot in one body of a guide, in which the pin of the other one, or its two pins, run."""
        low, high = travelled(self.cycle, guide)
        point, direction = map(plain, self.motion.pose.local_line(guide, body))
        slides = np.asarray(self.motion.slide(guide.name).value)
        k = int(np.flatnonzero(np.isfinite(slides))[0])
        way, beyond = direction if body == guide.on else -direction, self.overtravel
        if name in self.mechanism.pins:  # the pin of a block
            place = local(self.motion, body, MM * self.motion.position(name))[k] - MM * slides[k] * way
        else:
            place, beyond = MM * point, beyond + self._width(guide.slider)
        ends = [math.floor((MM * low - beyond) / self.step + SAME), math.ceil((MM * high + beyond) / self.step - SAME)]
        return self._opening(name, place + self.step * np.array(ends)[:, None] * way)

    def _ends(self, guide: Guide) -> Array:
        """Return the places (2, 2) of the two pins of a sliding body."""
        point, direction = map(plain, self.motion.pose.local_line(guide, guide.slider))
        return np.asarray(MM * point + np.array([[-1.0], [1.0]]) * self._width(guide.slider) * direction)

    def _width(self, body: str) -> float:
        own = self.section.links.get(body)
        return self._size(own.width if own else None, self.width)

    def _part(self, body: str, openings: tuple[Opening, ...]) -> FlatPart:
        own, width = self.section.links.get(body), self._width(body)
        free = {} if body == FRAME else self.points[body]
        marks = {name: at for name, at in free.items() if name not in self.mechanism.pins}
        thickness = self._size(own.thickness if own else None, self.thickness)
        material = (own and own.material) or self.section.material
        origin, along, note = self._frame_axes(openings) if body == FRAME else (np.zeros(2), np.array([1.0, 0.0]), "")
        end = (own and own.end) or self.section.end
        part = FlatPart(body, openings, marks, width, thickness, material, origin, along, note, end)
        widest = max(openings, key=lambda one: one.diameter)
        if width <= widest.diameter:
            message = f"{body} is not wider than its hole at {widest.joint}, which measures {widest.diameter:.6g} mm"
            key = f"parts.links.{body}.width" if own and own.width else "parts.width"
            raise InputError(message, "Give a greater width or a smaller hole", self.file, key, f"{width:.6g} mm")
        for one, other in itertools.combinations(openings, 2):
            away = float(distance(one.ends[None], other.ends[None])[0])
            if away < 0.5 * (one.diameter + other.diameter):
                message = f"the openings {one.joint} and {other.joint} of {body} overlap: their centres are {away:.6g} mm apart"
                remedy = (
                    "Give a smaller hole or change the linkage" if away > 0.0 else "Change the linkage: no flat part has both"
                )
                raise InputError(message, remedy, self.file, "parts.hole", f"{self.hole:.6g} mm")
        return part

    def _frame_axes(self, openings: Sequence[Opening]) -> tuple[Array, Array, str]:
        """Return origin and direction of the dimensions of the frame plate, in which they are the sizes of the problem.

        What they do not show stands in a note: the coordinates of the pivots in the plane of the problem.
        """
        arms = [place for place in self.mechanism.ground.values() if isinstance(place, Arm)]
        pivots = [one for one in openings if one.round]
        slots = [one.ends[1] - one.ends[0] for one in openings if not one.round]
        angle = 0.0
        if arms:
            angle = float(self.motion.pose.size(arms[0].direction))
        elif len(pivots) == 1 and slots:
            angle = math.atan2(slots[0][1], slots[0][0])
        origin = (pivots or openings)[0].ends[0]
        along = np.array([math.cos(angle), math.sin(angle)])
        if not origin.any() and (abs(along[1]) < SAME or not arms):
            return origin, along, ""
        places = ", ".join(f"{one.joint} ({', '.join(map(number, one.ends[0]))})" for one in pivots)
        turned = f"; dimensions along {number(math.degrees(angle))}°" if abs(along[1]) >= SAME else ""
        return origin, along, f"x, y in the problem: {places}{turned}"


def number(value: float) -> str:
    """Format a measure [mm] to 0.01 mm."""
    return f"{float(value):z.2f}".rstrip("0").rstrip(".")


def local(motion: Motion, body: str, at: Array) -> Array:
    """Return places (positions, 2) [mm] in the axes of a body."""
    if body == FRAME:
        return at
    away = at - MM * motion.position(motion.mechanism.origin(body))
    turned = np.asarray(motion.body_angle(body).value)
    c, s = np.cos(turned), np.sin(turned)
    return np.stack([c * away[:, 0] + s * away[:, 1], c * away[:, 1] - s * away[:, 0]], axis=1)


def placed(motion: Motion, body: str, points: Array) -> Array:
    """Return points (n, 2) [mm] of a body at all positions (positions, n, 2)."""
    count = len(motion.crank_angle)
    if body == FRAME:
        return np.broadcast_to(points, (count, *points.shape))
    turned = np.broadcast_to(np.asarray(motion.body_angle(body).value), count)
    c, s = np.cos(turned)[:, None], np.sin(turned)[:, None]
    at = np.stack([c * points[:, 0] - s * points[:, 1], s * points[:, 0] + c * points[:, 1]], axis=2)
    return np.asarray(at + MM * motion.position(motion.mechanism.origin(body))[:, None])


def distance(first: Array, second: Array) -> Array:
    """Return the distances (positions,) of two convex polygons (positions, corners, 2), counter-clockwise; zero if they meet.

    A polygon of one corner is a point, of two a segment.
    """
    least = np.full(len(first), np.inf)
    for one, other in ((first, second), (second, first)):
        edges = [(one[:, k], np.roll(one, -1, axis=1)[:, k]) for k in range(one.shape[1])]
        for (begin, end), k in itertools.product(edges, range(other.shape[1])):
            along, away = end - begin, other[:, k] - begin
            share = np.clip(np.sum(along * away, axis=1) / np.maximum(np.sum(along**2, axis=1), 1e-30), 0.0, 1.0)
            least = np.minimum(least, np.linalg.norm(away - share[:, None] * along, axis=1))
        if len(edges) > 2:  # a corner of the other one inside
            sides = np.array([cross(end - begin, other[:, 0] - begin) for begin, end in edges])
            least = np.where(np.all(sides >= 0.0, axis=0), 0.0, least)
        for (a, b), k in itertools.product(edges, range(other.shape[1])):
            c, d = other[:, k], other[:, (k + 1) % other.shape[1]]
            across = (cross(b - a, c - a) * cross(b - a, d - a) < 0.0) & (cross(d - c, a - c) * cross(d - c, b - c) < 0.0)
            least = np.where(across, 0.0, least)
    return least
