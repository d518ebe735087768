"""The picture of a mechanism: all that is drawn of it, its places in motion and its extent, described once for every renderer.

Bodies keep their shape, so each is built once from parts in its own axes (bars, plates, blocks, slots) and then placed. The y
axis points up.
"""

import copy
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal, Self

import numpy as np
from numpy.typing import NDArray

from optlink.dynamics.machine import Ends, Machine
from optlink.linkage.cams import Profile
from optlink.linkage.jet import as_jet
from optlink.linkage.mechanism import FRAME, Guide, Mechanism
from optlink.linkage.motion import Motion
from optlink.linkage.vector2d import TURN, Array, Vector
from optlink.presentation.chart_spec import BODIES, CRANK, GROUND, LIMIT, MUTED
from optlink.presentation.format import Scale, scale
from optlink.presentation.placement import Choice, arrange, beside, short_name, written
from optlink.presentation.shapes import (
    Part,
    clipped,
    distinct,
    even,
    finite,
    finite_range,
    hatching,
    hull,
    in_line,
    left_of,
    plain,
    rectangle,
    spiral,
    spread,
    stem,
    strokes,
    ways,
    zigzag,
)
from optlink.problem.file import ProblemFile
from optlink.problem.limits import RegionLimit
from optlink.tasks.analyze import Analysis
from optlink.validation.check import Check

# Regions that points must stay in or out of, as lines of a drawing: edge, hatching on the forbidden side, clearance, name.

EDGE_WIDTH, THIN_WIDTH = 1.2, 0.6  # line widths [pt] of an edge, and of its hatching and clearance
ROOM = 2.0  # room for hatching and name around a region, in heights of a ground pivot
BEYOND = 0.35  # a region this share of the extent beyond the mechanism still enlarges the drawing
CORNER, ROUND, SAMPLES = 9, 121, 65  # points of a rounded corner, of a circle, and of a straight edge of which one is near
HATCH = 0.35  # depth of the hatching, in heights of a ground pivot


@dataclass(frozen=True, eq=False)
class Outline:
    """A region in a drawing: lines (n, 2) with gaps at NaN, the middle of its name, and whether the design violates it."""

    name: str
    violated: bool
    edge: Array
    hatching: Array
    clearance: Array
    label: Array

    @property
    def colour(self) -> str:
        """Red if the design violates it."""
        return LIMIT if self.violated else GROUND

    @property
    def lines(self) -> tuple[tuple[Array, float, bool], ...]:
        """Its lines with their width [pt] and whether they are dashed."""
        return (self.edge, EDGE_WIDTH, False), (self.hatching, THIN_WIDTH, False), (self.clearance, THIN_WIDTH, True)

    def scaled(self, factor: float) -> "Outline":
        """Return the outline in another unit."""
        lines = (line * factor for line in (self.edge, self.hatching, self.clearance, self.label))
        return Outline(self.name, self.violated, *lines)


@dataclass(frozen=True)
class Region:
    """A limit of a region by its name, and whether a design violates it."""

    name: str
    limit: RegionLimit
    violated: bool = False

    def features(self, low: Array, high: Array, size: float) -> Array:
        """Return places (n, 2) [m] that a drawing from `low` to `high` should show; `size` is the height of a ground pivot.

        They are the corners of a region, and the point of its edge nearest to the middle, as far as they are near.
        """
        reach = BEYOND * np.max(high - low)
        edge = clipped(self._line(0.0, low - reach, high + reach), low - reach, high + reach)
        near = edge[np.all(np.isfinite(edge), axis=1)]
        inner = near[np.all((near > low - 0.999 * reach) & (near < high + 0.999 * reach), axis=1)]
        along = np.linspace(edge[:-1], edge[1:], SAMPLES).reshape(-1, 2)
        away = np.linalg.norm(along - 0.5 * (low + high), axis=1)
        if np.any(np.isfinite(away)):
            inner = np.concatenate([inner, along[[np.nanargmin(away)]]])
        return np.concatenate([inner + sign * ROOM * size for sign in (-1.0, 1.0)])

    def outline(self, low: Array, high: Array, size: float) -> Outline:
        """Return the outline in a drawing from `low` to `high` [m]; `size` is the height of a ground pivot."""
        inside = self.limit.side == "inside"
        edge = clipped(self._line(0.0, low, high)[:: -1 if inside else 1], low, high)
        margin = -self.limit.margin if inside else self.limit.margin
        clearance = clipped(self._line(margin, low, high), low, high) if margin else edge[:0]
        return Outline(
            self.name, self.violated, edge, strokes(edge, HATCH * size, HATCH * size), clearance, self._label(edge, size)
        )

    def _line(self, offset: float, low: Array, high: Array) -> Array:
        """Return the edge at an offset outwards, counter-clockwise, with gaps where a side is open."""
        limit, far = self.limit, 4.0 * float(np.max(high - low)) + float(np.max(np.abs([low, high])))
        if limit.region == "circle":
            assert limit.radius is not None
            turns = np.linspace(0.0, TURN, ROUND)
            centre = np.array([each.value for each in limit.centre])
            return np.asarray(centre + (limit.radius.value + offset) * ways(turns))
        if limit.region == "half-plane":
            assert limit.direction is not None
            c, s = math.cos(limit.direction.value), math.sin(limit.direction.value)
            through = np.array([each.value for each in limit.through]) + offset * np.array([s, -c])
            middle = through + ((0.5 * (low + high) - through) @ [c, s]) * np.array([c, s])
            return np.array([middle - far * np.array([c, s]), middle + far * np.array([c, s])])
        (left, right), (bottom, top) = limit.box
        x0, x1, y0, y1 = (float(np.clip(end, -far, far)) for end in (left, right, bottom, top))
        line: list[Array] = []
        for k, (corner, end) in enumerate(zip([(x0, y0), (x1, y0), (x1, y1), (x0, y1)], (bottom, right, top, left), strict=True)):
            turns = math.pi + 0.25 * TURN * (k + np.linspace(0.0, 1.0, CORNER if offset > 0.0 else 2))
            arms = ways(turns) if offset > 0.0 else np.sum(ways(turns), axis=0, keepdims=True)
            line += [np.array(corner) + offset * arms, *([] if math.isfinite(end) else [np.full((1, 2), np.nan)])]
        return np.concatenate([*line, line[0][:1]])

    def _label(self, edge: Array, size: float) -> Array:
        """Return the middle of the name.

        It is in or above a region that nothing may enter; beside another edge it is on the forbidden side, rather below than
        beside it.
        """
        half = half_size(self.name, size)
        known = edge[np.all(np.isfinite(edge), axis=1)]
        if not len(known):
            return np.full(2, np.nan)
        if np.all(np.isfinite(edge)) and np.allclose(edge[0], edge[-1]) and self.limit.side == "outside":
            low, high = np.min(known, axis=0), np.max(known, axis=0)
            middle = 0.5 * (low + high)
            if np.all(0.5 * (high - low) > half + 2.0 * HATCH * size):
                return np.asarray(middle)
            return np.array([middle[0], high[1] + self.limit.margin + HATCH * size + half[1]])
        along = np.nan_to_num(np.diff(edge, axis=0))
        lengths = np.linalg.norm(along, axis=1)
        k = int(np.argmax(lengths + 2.0 * np.abs(along[:, 0])))
        left = np.array([-along[k, 1], along[k, 0]]) / max(float(lengths[k]), 1e-30)
        return np.asarray(0.5 * (edge[k] + edge[k + 1]) + (2.0 * HATCH * size + float(np.abs(left) @ half)) * left)


def half_size(name: str, size: float) -> Array:
    """Return half the size (2,) of a name in a drawing; `size` is the height of a ground pivot."""
    return 0.5 * LETTER * size * np.array([WIDTH * len(name), 1.0])


def regions_of(problem: ProblemFile, checks: Iterable[Check] = ()) -> tuple[Region, ...]:
    """Return the regions of a problem; those whose check failed are violated."""
    limits: Mapping[str, RegionLimit] = getattr(getattr(problem.model, "limits", None), "regions", {})
    failed = {check.name for check in checks if not check.passed}
    return tuple(Region(name, limit, limit.label(name) in failed) for name, limit in limits.items())


FAR_RATIO = 8.0  # positions beyond this multiple of the median distance from the crank pivot do not set the scale
SYMBOL_SHARE = 0.035  # height of a ground pivot
STEPS = 360  # positions per revolution
PLACES = 6  # significant digits of a coordinate, relative to the extent
MM = Scale(1e3, "mm")
WHITE = "#ffffff"
LAYERS = {
    "regions": 0.9,
    "traces": 1.0,
    "ground": 2.0,
    "slot": 2.6,
    "profile": 2.7,
    "auxiliary": 2.75,
    "plate": 2.8,
    "springs": 2.9,
    "bar": 3.0,
    "block": 3.2,
    "crank": 3.4,
    "centroid": 3.6,
    "joints": 4.0,
}
"""What lies on what: layers and their heights."""
LOOKS = {
    "slot": (1.1, 0.13),
    "profile": (1.5, 0.18),
    "auxiliary": (0.8, 0.0),
    "plate": (2.2, 0.22),
    "bar": (3.0, 0.0),
    "block": (1.5, 0.35),
    "crank": (3.8, 0.0),
}
"""Line width [pt] and opacity of the face of the parts of bodies."""
LETTER, WIDTH = 9.0 / 8.0, 0.6  # height of a letter of names, in heights of a ground pivot, and its width in its height
NEAR = np.array([0.42, 1.05, 1.7])  # distances of a name from its point, in heights of a ground pivot
CHAIN, DASHED = (8.0, 2.0, 1.0, 2.0), (4.0, 3.0)
CORNERS = 120  # of a shape, as far as names keep away from it
BEHIND, TRACE = 3.0, 0.45  # how much a link and a trace count that a name hides
CROSS = np.array([[-1.0, 0.0], [1.0, 0.0], [np.nan, np.nan], [0.0, -1.0], [0.0, 1.0]])


@dataclass(frozen=True, eq=False)
class Shape:
    """An element of the picture: a line (n, 2) with gaps at NaN, or with a `radius` [pt] a circle about its only point.

    It moves with what it is part `of`: a body, in whose axes it lies, a point, about which it lies, a spring or rod, in shares of
    whose length and offsets from which it is given; its `name` is that of the body, point, spring or region. One with a `fill`
    is closed.
    """

    layer: str
    name: str
    line: Array
    colour: str
    width: float
    of: Literal["frame", "body", "point", "spring"] = "frame"
    fill: str = ""
    face: float = 1.0
    opacity: float = 1.0
    dashed: bool = False
    radius: float = 0.0

    @property
    def dashes(self) -> tuple[float, ...]:
        """Lengths [pt] of its strokes and gaps; none if it is drawn through. Axes and pitch circles are dash-dotted."""
        return () if not self.dashed else CHAIN if self.layer == "auxiliary" else DASHED


@dataclass(frozen=True, eq=False)
class Text:
    """A text about its middle, in letters of the height `font`, turned by an angle [deg]."""

    text: str
    at: Array
    colour: str
    font: float
    angle: float = 0.0


def profiles(motion: Motion, machine: Machine | None) -> dict[str, list[Profile]]:
    """Return the curves by which drives, couplings and the machine are drawn, by the bodies that carry them [m]."""
    curves: dict[str, list[Profile]] = {body: [*listed] for body, listed in machine.profiles.items()} if machine else {}
    for element in motion.mechanism.elements:
        for body, profile in element.profiles(motion.pose):
            curves.setdefault(body, []).append(profile)
    return curves


def colours_of(mechanism: Mechanism) -> dict[str, str]:
    """Return the colours of the moving bodies, the crank's last."""
    crank = mechanism.crank.body
    others = [body for body in mechanism.bodies if body != crank]
    return {body: BODIES[k % len(BODIES)] for k, body in enumerate(others)} | {crank: CRANK}


def named_points(motion: Motion, body: str) -> dict[str, Array]:
    """Return the named points of a body in its own axes [m]; the end of a cylinder is one of its rod."""
    mechanism, pose = motion.mechanism, motion.pose
    if body in mechanism.rods:
        return {mechanism.origin(body): np.zeros(2)}
    ends = [link.end for link in mechanism.rods.values() if link.body == body]
    names = [name for name, bodies in mechanism.owners.items() if body in bodies and name not in ends]
    return {name: plain(pose.local(body, name)) for name in names}


class Scene:
    """Picture of a mechanism with one unit, symbol size and set of colours for all its positions.

    Extent, traces and slider strokes are those of the whole motion; centroids and springs those of the machine; `regions`
    those of the limits; `share` is the height of a ground pivot as a share of the extent; without a `unit` of lengths the
    extent selects it. `shown` are the positions to draw; `closed` says whether the last of them equals the first.
    """

    def __init__(
        self,
        motion: Motion,
        machine: Machine | None = None,
        share: float = SYMBOL_SHARE,
        regions: Sequence[Region] = (),
        unit: Scale | None = None,
    ) -> None:
        self.motion, self.mechanism = motion, motion.mechanism
        self.shown, self.closed = motion, False
        owners = self.mechanism.owners
        self.names, self.pins = list(owners), tuple(self.mechanism.pins)
        self.moving = tuple(name for name, bodies in owners.items() if FRAME not in bodies)
        self.free = tuple(name for name in self.moving if len(owners[name]) == 1)
        self._places = np.array([motion.position(name) for name in self.names])  # m, (points, positions, 2)
        self.near = self._in_sight()
        self.profiles, self.scale = profiles(motion, machine), Scale(1.0, "m")
        curves = [self.placed(motion, body, one.corners) for body, listed in self.profiles.items() for one in listed]
        shown = np.concatenate([finite(places[self.near]) for places in (np.swapaxes(self._places, 0, 1), *curves)])
        extent = max(np.max(spread(shown)), 1e-30)
        self.scale = unit or scale(extent, "m")
        self.size = share * extent * self.scale.factor
        crank = self.mechanism.crank.body
        self.driven = {crank, *(drive.body for drive in self.mechanism.drives)}
        self.colours = {FRAME: GROUND, **colours_of(self.mechanism)}
        self.colours |= {rod: self.colours[link.body] for rod, link in self.mechanism.rods.items()}
        self.travel = {guide.name: self._travel(guide) for guide in self.mechanism.guides}
        inertias = machine.inertias if machine else {}
        self.centroids = {
            body: np.array([[i.along, i.across]], dtype=float) * self.scale.factor for body, i in inertias.items() if i.mass > 0.0
        }
        self.parts = {body: self._parts(body) for body in (*self.mechanism.bodies, *self.mechanism.rods)}
        self.parts |= {FRAME: self._curves(FRAME)} if FRAME in self.profiles else {}
        drawn = {load.name: load.drawn for load in machine.loads if load.drawn} if machine else {}
        self.springs = {name: ends for name, ends in drawn.items() if ends[0][1]}
        self.torsion_springs = [self._turned_at(ends) for ends in drawn.values() if not ends[0][1]]
        self.ground = self._ground_lines()
        self.low, self.high = self._extent()
        self.regions = tuple(regions)
        factor = self.scale.factor
        ends = self.low / factor, self.high / factor, self.size / factor
        for region in self.regions:
            self.widen(region.features(*ends) * factor)

    def moved(self, shown: Motion, *, closed: bool = False) -> Self:
        """Return the scene at the positions of a motion, with the same extent and outlines."""
        other = copy.copy(self)
        other.__dict__.pop("places_of_names", None)
        other.shown, other.closed = shown, closed
        return other

    # --- positions ---------------------------------------------------------------------------------------------------

    def _in_sight(self) -> NDArray[np.bool_]:
        """Return the positions in which no point is so far away (parallel lines) that the others would vanish."""
        crank = self.motion.position(self.mechanism.crank.start)
        away = np.linalg.norm(self._places - crank, axis=-1)
        distance = np.where(np.isfinite(self._places).all(axis=-1), away, 0.0).max(axis=0)
        near: NDArray[np.bool_] = distance <= FAR_RATIO * np.median(distance)
        return near

    def position(self, motion: Motion, name: str) -> Array:
        """Return the positions of a point in the display unit, shape (positions, 2)."""
        return motion.position(name) * self.scale.factor

    def placed(self, motion: Motion, body: str, outline: Array) -> Array:
        """Return the positions (positions, corners, 2) of an outline (corners, 2) in the axes of a body, in the display unit."""
        shape = motion.crank_angle.shape
        with np.errstate(all="ignore"):  # at a dead centre of a group its rates are infinite or NaN
            direction = motion.pose.direction(body)
        x, y = (np.broadcast_to(as_jet(part).value, shape)[:, None] for part in direction)
        start = self._start(motion, body)[:, None, :]
        along, across = outline[:, 0], outline[:, 1]
        return np.asarray(start + np.stack([along * x - across * y, along * y + across * x], axis=-1))

    def _start(self, motion: Motion, body: str) -> Array:
        """Return the positions (positions, 2) of the origin of the axes of a body, in the display unit."""
        if body == FRAME:
            return np.zeros((len(motion.crank_angle), 2))
        return self.position(motion, self.mechanism.origin(body))

    def ends(self, motion: Motion, spring: str) -> Array:
        """Return the positions (positions, 2, 2) of both ends of a spring."""
        return np.stack([self.position(motion, point) for _, point in self.springs[spring]], axis=1)

    def located(self, shape: Shape, motion: Motion) -> Array:
        """Return the places (positions, n, 2) of a shape; one position of a shape that stands still."""
        if shape.of == "body":
            return self.placed(motion, shape.name, shape.line)
        if shape.of == "point":
            return self.position(motion, shape.name)[:, None] + shape.line
        if shape.of == "spring":
            p, q = np.moveaxis(self.ends(motion, shape.name), 1, 0)[:, :, None]
            left = (q - p)[..., ::-1] * [-1.0, 1.0] / np.maximum(np.linalg.norm(q - p, axis=-1, keepdims=True), 1e-30)
            return np.asarray(p + shape.line[:, :1] * (q - p) + shape.line[:, 1:] * left)
        return shape.line[None]

    @property
    def crank_angles(self) -> Array:
        """Crank angles [deg] of the positions to draw."""
        return np.asarray(np.degrees(self.shown.crank_angle), dtype=float)

    @property
    def points(self) -> dict[str, Array]:
        """Positions (positions, 2) of the points to draw."""
        return {name: self.position(self.shown, name) for name in self.names}

    def poses(self, body: str) -> Array:
        """Return the poses (positions, 3) of a body to draw: x and y of its first point, and its angle [deg]."""
        angle = np.degrees(np.asarray(self.shown.body_angle(body).value, dtype=float))
        return np.asarray(np.column_stack([self._start(self.shown, body), angle]))

    @property
    def captions(self) -> dict[str, str]:
        """The name of every point as drawings show it, at the joints of several drives with the names of these."""
        captions = {name: short_name(name) for name in self.names}
        joints = {single.link.body: str(single.joint) for single in self.mechanism.singles if single.guide is None}
        for drive in self.mechanism.drives if len(self.mechanism.drives) > 1 else ():
            captions[joints.get(drive.body, self.mechanism.bodies[drive.body].start)] += f": {drive.name}"
        return captions

    def owner(self, name: str) -> str:
        """Return the body in whose colour a point and its trace are drawn."""
        bodies = self.mechanism.owners[name]
        return bodies[0 if bodies[0] == self.mechanism.crank.body else -1]

    @cached_property
    def places_of_names(self) -> dict[str, tuple[Array, Choice]]:
        """Places of the names of the points: relative to the point (places, 2), and the number of the place at each position."""
        letter, lines = LETTER * self.size, []
        for shape in self.moving_shapes:
            if shape.layer != "joints":
                line = self.located(shape, self.shown)
                line = line[:, even(line.shape[1], CORNERS)]
                lines.append((np.concatenate([line, line[:, :1]], axis=1) if shape.fill else line, BEHIND))
        lines += [(line[None], BEHIND) for line in (*(line for line, _, _ in self.ground), *(one.edge for one in self.outlines))]
        points = self.points
        lines += [(points[name][None], TRACE) for name in self.moving]
        names = sorted(points, key=lambda name: name in self.moving)
        texts = [written(one.label, half_size(one.name, self.size)) for one in self.outlines]
        for name in names:
            others, near = [points[other] for other in names if other != name], NEAR * self.size
            half, moves = half_size(self.captions[name], self.size), name in self.moving
            texts.append(beside(points[name], half, near[: 2 if moves else 3], 1.5 / letter, others, (0.3, 0.3), moves))
        chosen = arrange(texts, lines, letter, self.box)
        return {
            name: (text.middles, at) for name, text, at in zip(names, texts[-len(names) :], chosen[-len(names) :], strict=True)
        }

    def _vector(self, vector: Vector) -> Array:
        return plain(vector) * self.scale.factor

    def _points_of(self, body: str) -> Array:
        """Return the named points of a body in its own axes, without duplicates."""
        points = (local * self.scale.factor for local in named_points(self.motion, body).values())
        return distinct(points, 1e-3 * self.size)

    def _line(self, guide: Guide, body: str) -> tuple[Array, Array]:
        point, direction = self.motion.pose.local_line(guide, body)
        return self._vector(point), self._vector(direction) / self.scale.factor

    def _travel(self, guide: Guide) -> tuple[float, float]:
        slides = np.asarray(self.motion.slide(guide.name).value) * self.scale.factor
        return finite_range(slides[self.near])

    def _turned_at(self, ends: Ends) -> str:
        """Return the point about which a torsion spring is drawn: the joint of its bodies, else the first point of one."""
        (body, _), (against, _) = ends
        shared = (name for name, bodies in self.mechanism.pins.items() if {body, against} <= {*bodies})
        return next(shared, self.mechanism.bodies[body].start)

    # --- shapes of the bodies ------------------------------------------------------------------------------------------

    def _is_rod(self, guide: Guide) -> bool:
        """Return whether the slider is a rod along the line in a small guide, which is then drawn as the block."""
        if guide.on == FRAME or len(self._points_of(guide.on)) > 1:
            return False
        points, (point, direction) = self._points_of(guide.slider), self._line(guide, guide.slider)
        off = (points - point) @ left_of(direction)
        return len(points) > 1 and bool(np.all(np.abs(off) < 0.05 * self.size))

    def _curves(self, body: str) -> list[Part]:
        curves = self.profiles.get(body, ())
        return [Part("auxiliary" if one.auxiliary else "profile", one.corners * self.scale.factor) for one in curves]

    def _parts(self, body: str) -> list[Part]:
        points, parts = self._points_of(body), self._curves(body)
        half = np.array([1.0, 0.62]) * self.size
        for guide in self.mechanism.guides:
            if body not in guide.bodies:
                continue
            rod = self._is_rod(guide)
            point, direction = self._line(guide, body)
            low, high = self.travel[guide.name]
            if rod and body == guide.slider:  # long enough to reach through its block
                points = np.concatenate([points, [point - (high + half[0]) * direction, point - (low - half[0]) * direction]])
            elif (body == guide.slider) != rod:
                parts.append(Part("block", rectangle(point, direction, -half[0], half[0], half[1])))
            else:
                low, high = low - 1.25 * half[0], high + 1.25 * half[0]
                parts.append(Part("slot", rectangle(point, direction, low, high, 1.2 * half[1])))
                arm = stem(points, np.array([point + low * direction, point + high * direction]))
                if np.linalg.norm(arm[1] - arm[0]) > 0.5 * self.size:
                    parts.append(Part("bar", arm))
        if len(points) == 1 and not parts:  # a lever of which the file states no more
            points = np.concatenate([points, self.centroids.get(body, np.array([[2.0 * self.size, 0.0]]))])
        if len(points) > 1:
            order = in_line(points, 0.05 * self.size)
            parts.append(Part("plate", hull(points)) if order is None else Part("bar", points[order[[0, -1]]]))
        return parts

    # --- ground ----------------------------------------------------------------------------------------------------------

    def _ground_lines(self) -> list[tuple[Array, float, bool]]:
        """Return the ground pivots and rails as (line, width, filled white)."""
        lines: list[tuple[Array, float, bool]] = []
        middle = np.mean(finite(self._places[:, self.near] * self.scale.factor), axis=0)
        s = self.size
        anchors = {point for ends in self.springs.values() for body, point in ends if body == FRAME}
        for name in self.mechanism.ground:
            at = self._vector(self.motion.pose.points[name])
            if name in self.mechanism.pins or name in anchors:
                lines.append((at + s * np.array([[0.0, 0.0], [-0.55, -1.0], [0.55, -1.0], [0.0, 0.0]]), 1.1, True))
                lines.append((at + s * np.array([[-0.9, -1.0], [0.9, -1.0]]), 1.1, False))
                strokes = hatching(at - s * np.array([0.9, 1.0]), np.array([1.0, 0.0]), 1.8 * s, -0.35 * s, 0.25 * s)
                lines.append((strokes, 0.8, False))
            else:
                lines.append((at + 0.35 * s * CROSS, 1.0, False))
        for guide in self.mechanism.guides:
            if guide.on == FRAME:
                point, direction = self._line(guide, FRAME)
                left = left_of(direction)
                offset = float((middle - point) @ left)
                side = -math.copysign(1.0, offset if abs(offset) > 0.5 * s else left[1] + 1e-9 * left[0])
                low, high = (end + room * 1.5 * s for end, room in zip(self.travel[guide.name], (-1.0, 1.0), strict=True))
                begin = point + low * direction + side * 0.62 * s * left
                lines.append((np.array([begin, begin + (high - low) * direction]), 1.3, False))
                lines.append((hatching(begin, direction, high - low, side * 0.35 * s, 0.35 * s), 0.8, False))
        return lines

    # --- extent ----------------------------------------------------------------------------------------------------------

    def _extent(self) -> tuple[Array, Array]:
        """Return the least and largest coordinates of everything that is drawn."""
        corners = [finite(self._places[:, self.near] * self.scale.factor), *(finite(line) for line, _, _ in self.ground)]
        for body, parts in self.parts.items():
            outlines = [part.outline for part in parts] + ([self.centroids[body]] if body in self.centroids else [])
            corners += [finite(self.placed(self.motion, body, outline)[self.near]) for outline in outlines]
        together = np.concatenate(corners)
        return np.min(together, axis=0), np.max(together, axis=0)

    def widen(self, points: Array) -> None:
        """Extend the drawing to further points (n, 2), in the display unit."""
        kept = finite(points)
        if kept.size:
            self.low, self.high = np.minimum(self.low, kept.min(axis=0)), np.maximum(self.high, kept.max(axis=0))

    @property
    def limits(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Limits of x and y with a margin; the aspect ratio is limited."""
        size = self.high - self.low
        room = 0.07 * np.max(size)
        widths = np.maximum(size + 2.0 * room, 0.22 * np.max(size))
        middle = 0.5 * (self.low + self.high)
        (x0, y0), (x1, y1) = middle - 0.5 * widths, middle + 0.5 * widths
        return (float(x0), float(x1)), (float(y0), float(y1))

    @property
    def outlines(self) -> list[Outline]:
        """The regions, as far as they are in the drawing."""
        factor = self.scale.factor
        low, high = np.array(self.limits).T / factor
        return [region.outline(low, high, self.size / factor).scaled(factor) for region in self.regions]

    @property
    def ratio(self) -> float:
        """Height divided by width."""
        _, _, width, height = self.box
        return height / width

    @property
    def box(self) -> tuple[float, float, float, float]:
        """x and y of the lower left corner, width and height of the picture."""
        (x0, x1), (y0, y1) = self.limits
        return x0, y0, x1 - x0, y1 - y0

    @property
    def decimals(self) -> int:
        """Number of decimals of coordinates."""
        return max(0, PLACES - 1 - math.floor(math.log10(max(*self.box[2:], 1e-9))))

    # --- elements --------------------------------------------------------------------------------------------------------

    def fixed_shapes(self, *, traces: bool = True) -> Iterator[Shape]:
        """Yield what stands still: regions, traces of the moving points, ground with rails."""
        for region in self.outlines:
            for line, width, dashed in region.lines:
                yield Shape("regions", region.name, line, region.colour, width, dashed=dashed)
        for name in self.moving if traces else ():
            width, opacity = (1.3, 0.75) if name in self.free else (0.9, 0.45)
            motion = self.shown if len(self.shown.crank_angle) > 1 else self.motion
            path = self.position(motion, name)
            path = np.where(self.near[:, None], path, np.nan) if motion is self.motion else path
            yield Shape("traces", name, path, self.colours[self.owner(name)], width, opacity=opacity)
        for line, width, filled in self.ground:
            yield Shape("ground", "", line, GROUND, width, fill=WHITE if filled else "")

    @cached_property
    def moving_shapes(self) -> tuple[Shape, ...]:
        """What moves: parts of the bodies, springs, centroids as rings with a cross, free points as dots, pins as rings."""
        shapes: list[Shape] = []
        for body, parts in self.parts.items():
            colour = self.colours[body]
            for part in parts:
                layer = "crank" if part.kind == "bar" and body in self.driven else part.kind
                width, face = LOOKS[layer]
                shape = Shape(layer, body, part.outline, colour, width, "body", colour if face else "", face)
                shapes.append(replace(shape, dashed=layer == "auxiliary"))
        zigzagged = np.array(zigzag(self.size))
        shapes += [Shape("springs", spring, zigzagged, MUTED, 1.2, "spring") for spring in self.springs]
        shapes += [Shape("springs", point, spiral(self.size), MUTED, 1.2, "point") for point in self.torsion_springs]
        for body, at in self.centroids.items():
            colour, cross = self.colours[body], at + 0.35 * self.size * CROSS
            shapes.append(Shape("centroid", body, at, colour, 0.9, "body", WHITE, radius=2.75))
            shapes.append(Shape("centroid", body, cross, colour, 0.9, "body"))
        origin = np.zeros((1, 2))
        for name in self.free:
            colour = self.colours[self.owner(name)]
            shapes.append(Shape("joints", name, origin, colour, 0.0, "point", colour, radius=2.1))
        shapes += [Shape("joints", name, origin, GROUND, 1.0, "point", WHITE, radius=2.75) for name in self.pins]
        return tuple(sorted(shapes, key=lambda shape: LAYERS[shape.layer]))


def scene(cycle: Analysis, steps: int = STEPS, at: float | None = None, regions: Sequence[Region] = ()) -> Scene:
    """Return the scene of an analysed machine [mm] over its motion, or at one crank angle [rad], with regions of its limits.

    Extent and outlines are those of the whole motion in either case.
    """
    machine = cycle.machine
    direction = math.copysign(1.0, cycle.speed)
    first = float(cycle.positions[0])
    last = first + direction * cycle.cycle if cycle.full else float(cycle.positions[-1])
    count = steps * round(cycle.cycle / TURN) if cycle.full else max(1, math.ceil(abs(last - first) / TURN * steps))
    angles = np.linspace(first, last, count + 1)
    whole = Scene(machine.motion(angles, cycle.speed), machine, regions=regions, unit=MM)
    if at is not None:
        return whole.moved(machine.motion([at], cycle.speed))
    known = np.isfinite(whole._places).all(axis=(0, 2))
    if known.all() or not known.any():
        return whole.moved(whole.motion, closed=cycle.full)
    return whole.moved(machine.motion(angles[known], cycle.speed), closed=cycle.full)  # a singular one


def scene_at(cycle: Analysis, angles: Array) -> Scene:
    """Return the scene of an analysed machine at crank angles (positions,) [rad], with the extent of its whole motion."""
    machine = cycle.machine
    full_motion = machine.motion(cycle.positions, cycle.speed)
    return Scene(full_motion, machine, unit=MM).moved(machine.motion(angles, cycle.speed))
