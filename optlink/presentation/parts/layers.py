"""Layers: parts at heights at which neither they nor pins and heads collide over the motion.

The frame plate lies in layer 0, all links above it. A pin passes through all layers from the lowest of its parts to the highest,
and its heads lie in the layers below and above these and in the gaps before them. The search takes the links in turn, each in
the lowest layer without a collision, and goes back where there is none; the number of layers grows until all find a place.
"""

import itertools
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from optlink.errors import InputError
from optlink.linkage.mechanism import FRAME
from optlink.linkage.vector2d import TURN, Array
from optlink.presentation.parts.model import HEAD, FlatPart, Opening, PartSet, Pin, distance, placed
from optlink.presentation.shapes import hull, in_line

CLEARANCE = 0.05  # least distance of two things in one layer, as a share of the hole diameter
THINNEST = 1.2  # least diameter of a spacer in pin diameters
LAYERS = 2  # most layers per link, the other ones for heads
REMEDY = "Try a smaller [parts] hole, or head = the diameter of the pins; --content parts needs no layers"


@dataclass(frozen=True, eq=False)
class Gap:
    """Distances of two things over the motion [mm], less than `needed` where they collide; the crank angle of the least [rad]."""

    least: float
    at: float


@dataclass(frozen=True)
class Collision:
    """Two things that collide in a layer at a crank angle [rad], by how much [mm]."""

    one: str
    other: str
    overlap: float
    at: float

    @property
    def degrees(self) -> float:
        """The crank angle [deg]."""
        return math.degrees(math.fmod(self.at, TURN))


class Stack:
    """The search for layers."""

    def __init__(self, parts: PartSet) -> None:
        self.parts, self.motion = parts, parts.motion
        self.links = [name for name in parts.parts if name != FRAME]
        cores = {name: placed(self.motion, name, convex(part)) for name, part in parts.parts.items()}
        self.places = {pin.name: placed(self.motion, pin.on, pin.at[None]) for pin in parts.pins}
        self.cores = {**cores, **self.places}
        self.gaps: dict[tuple[str, str], Gap] = {}
        self.worst: Collision | None = None  # that remains, if there are no layers
        self.slack = CLEARANCE * min(one.diameter for part in parts.parts.values() for one in part.openings)

    def layers(self) -> dict[str, int]:
        """Return the layer of every part.

        Raises
        ------
        InputError
            If there are none, with a collision that remains and its crank angle.
        """
        count = len(self.links)
        for top in range(1, LAYERS * count + 2):
            found = self._placed({FRAME: 0}, top, 0)
            if found:
                return found
        tries = (self._placed({FRAME: 0}, count + 1, allowed) for allowed in itertools.count(1))
        self.worst = worst = min(self.collisions(next(filter(None, tries))), key=lambda one: one.overlap)
        message = f"the links cannot be stacked: {worst.one} and {worst.other} collide at a crank angle of"
        raise InputError(f"{message} {worst.degrees:.4g} deg", REMEDY, self.parts.file)

    def room(self, pin: Pin, layers: Mapping[str, int]) -> float:
        """Return the radius [mm] that is free around a pin between its parts, where others have spacers."""
        among = [layers[name] for name in pin.parts]
        levels = range(2 * min(among) + 1, 2 * max(among))
        radii = [(name, part.reach) for name, part in self.parts.parts.items() if 2 * layers[name] in levels]
        for other in self.parts.pins:
            radius = max((self._radius(other, layers, level) for level in levels), default=0.0)
            radii += [(other.name, max(radius, 0.5 * HEAD * other.diameter))] if radius else []
        others = [(name, radius) for name, radius in radii if name not in (pin.name, *pin.parts)]
        return min((self._gap(pin.name, name).least - radius for name, radius in others), default=math.inf) - self.slack

    def _placed(self, layers: Mapping[str, int], top: int, allowed: int) -> dict[str, int] | None:
        """Return the layers of all links, of which some have theirs, with so many collisions at most; None if there are none."""
        if len(layers) > len(self.links):
            return dict(layers)
        new = self.links[len(layers) - 1]
        for layer in range(1, top + 1):
            tried = {**layers, new: layer}
            count = len(list(itertools.islice(self.collisions(tried, new), allowed + 1)))
            if count <= allowed:
                found = self._placed(tried, top, allowed - count)
                if found:
                    return found
        return None

    def collisions(self, layers: Mapping[str, int], new: str = "") -> Iterator[Collision]:
        """Yield the collisions of parts and of pins whose parts have layers; those alone in which a new part takes part."""
        for one, other in itertools.combinations(layers, 2):
            if layers[one] == layers[other] and (not new or new in (one, other)):
                yield from self._colliding(one, other, self.parts.parts[one].reach + self.parts.parts[other].reach)
        whole = [pin for pin in self.parts.pins if all(name in layers for name in pin.parts)]
        for pin in whole:
            for name in layers:
                if name not in pin.parts and (not new or new == name or new in pin.parts):
                    radius = self._radius(pin, layers, 2 * layers[name])
                    if radius:
                        yield from self._colliding(pin.name, name, radius + self.parts.parts[name].reach)
        for pin, other_pin in itertools.combinations(whole, 2):
            near = self._gap(pin.name, other_pin.name).least < 0.5 * (pin.head + other_pin.head) + self.slack
            if near and (not new or new in pin.parts or new in other_pin.parts):
                levels = range(-3, 2 * max(layers.values()) + 4)
                both = [[self._radius(one, layers, level) for one in (pin, other_pin)] for level in levels]
                yield from self._colliding(
                    pin.name, other_pin.name, max(sum(radii) if all(radii) else -math.inf for radii in both)
                )

    def _radius(self, pin: Pin, layers: Mapping[str, int], level: int) -> float:
        """Return the radius that a pin occupies at a level [mm]; zero where it is not.

        Even levels are layers, odd ones the gaps above them. A head fills a gap and a layer, a high one the next gap too.
        """
        levels = [2 * layers[name] for name in pin.parts]
        low, high = min(levels), max(levels)
        if low <= level <= high:
            return 0.5 * pin.diameter
        reach = 3 if pin.height > self.parts.pitch else 2
        return 0.5 * pin.head if pin.height and low - reach <= level <= high + reach else 0.0

    def _colliding(self, one: str, other: str, needed: float) -> Iterator[Collision]:
        gap = self._gap(one, other)
        if gap.least < needed + self.slack:
            yield Collision(self._called(one), self._called(other), needed + self.slack - gap.least, gap.at)

    def _called(self, name: str) -> str:
        return f"pin {name}" if name in self.places else name

    def _gap(self, one: str, other: str) -> Gap:
        """Return the least distance of two cores over the motion: a pin is the point at its axis."""
        if (one, other) not in self.gaps:
            away = np.nan_to_num(distance(self.cores[one], self.cores[other]), nan=math.inf)
            k = int(np.argmin(away))
            self.gaps[one, other] = Gap(float(away[k]), float(np.asarray(self.motion.crank_angle)[k]))
        return self.gaps[one, other]


@dataclass(frozen=True, eq=False)
class Stacked:
    """Parts in layers; `room` [mm]: the radius that is free around every pin between its parts."""

    parts: PartSet
    layers: Mapping[str, int]
    room: Mapping[str, float]

    @cached_property
    def heights(self) -> dict[str, float]:
        """Height of the lower face of every part [mm]."""
        return {name: layer * self.parts.pitch for name, layer in self.layers.items()}

    @property
    def spacers(self) -> Iterator[tuple[Pin, float, FlatPart]]:
        """Tubes on a pin between two of its parts, as thick as the gap, with the height of their lower face [mm]."""
        for pin in self.parts.pins:
            faces = sorted((self.heights[name], self.heights[name] + self.parts.parts[name].thickness) for name in pin.parts)
            bore = Opening(pin.name, np.zeros((2, 2)), pin.diameter)
            outer = min(HEAD * pin.diameter, 2.0 * self.room[pin.name])
            for (_, low), (high, _) in itertools.pairwise(faces) if outer > THINNEST * pin.diameter else ():
                yield pin, low, FlatPart(f"spacer {pin.name}", (bore,), {}, outer, high - low, "", np.zeros(2), np.zeros(2))

    def span(self, pin: Pin) -> tuple[float, float]:
        """Return the heights [mm] between which a pin passes through parts."""
        faces = [(self.heights[name], self.heights[name] + self.parts.parts[name].thickness) for name in pin.parts]
        return min(low for low, _ in faces), max(high for _, high in faces)


def stacked(parts: PartSet) -> Stacked:
    """Return the parts in layers.

    Raises
    ------
    InputError
        If there are none.
    """
    stack = Stack(parts)
    layers = stack.layers()
    return Stacked(parts, layers, {pin.name: stack.room(pin, layers) for pin in parts.pins})


def convex(part: FlatPart) -> Array:
    """Return the corners (n, 2) of the hull of a part's spine, counter-clockwise; two of a round bar, one of a disc."""
    points = np.unique(np.round(part.spine, 9), axis=0)
    if len(points) < 3:
        return points
    order = in_line(points, 1e-9 * float(np.ptp(points)))
    return hull(points) if order is None else points[order[[0, -1]]]
