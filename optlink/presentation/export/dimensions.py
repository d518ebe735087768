"""Dimensioned SVG drawing of a mechanism: link lengths, pivots, guides, angle ranges and strokes, in millimetres and degrees."""

import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from optlink.dynamics.machine import slider_names
from optlink.linkage.mechanism import FRAME
from optlink.linkage.vector2d import TURN, Array
from optlink.presentation.chart_spec import GROUND
from optlink.presentation.export.svg import svg
from optlink.presentation.html.theme import readable
from optlink.presentation.placement import CELL, HIGH, LEVEL, Places, arrange, beside, joined, sampled
from optlink.presentation.scene import Scene, Shape, Text, scene
from optlink.presentation.shapes import even, finite, hull, in_line, left_of, normed, pieces, plain, ways
from optlink.tasks.analyze import Analysis

POSITIONS = 24  # positions from which the clearest is drawn
OFFSETS = (1.2, 2.2, 3.3, 4.6, 6.0)  # distances of a dimension line from what it measures, in heights of a ground pivot
REACHES = np.array([1.0, 1.8, 2.8])  # distances of a name from its point, in heights of a ground pivot
LETTER_WIDTH = 0.62  # width of a letter in font sizes
COINCIDENT = 1e-6  # distance of coincident points, as a share of the extent


@dataclass(frozen=True, eq=False)
class Drawing:
    """A dimensioned drawing as SVG, its description in words, and what stands below it."""

    svg: str
    words: str
    caption: str


@dataclass(frozen=True)
class _Length:
    """A distance to be dimensioned between two points [mm], with its text and colour."""

    ends: tuple[Array, Array]
    text: str
    colour: str


def dimensioned(cycle: Analysis, title: str) -> Drawing:
    """Draw a mechanism with its dimensions in its clearest position; the description begins with the title."""
    at = clearest(cycle)
    drawn = scene(cycle, at=at)
    sheet = _Sheet(drawn)
    words = list(dict.fromkeys(dimension.text for dimension in _links(cycle, drawn, named=True)))
    for name, low, high, centre, start in _swings(cycle, drawn):
        text = "360°" if high - low >= TURN - 1e-9 else _deg(high - low)
        words.append(f"{name} turns fully" if text == "360°" else f"{name} swings {text}")
        sheet.angle(centre, start, low, high, text, _colour(drawn, name))
    guides = list(_guides(cycle, at, drawn))
    for dimension in (*_links(cycle, drawn), *_strokes(cycle, at, drawn), *(offset for _, offset in guides)):
        sheet.length(dimension)
    for name in cycle.machine.mechanism.ground:
        x, y = drawn.points[name][0]
        place = f"{name} ({_mm(x)}, {_mm(y)})"
        words.append(f"pivot {place}" if name in drawn.pins else place)
        sheet.label(drawn.points[name][0], place)
    words += [dimension.text.replace(" ", " of ", 1) for dimension in _strokes(cycle, at, drawn, named=True)]
    words += [text for text, _ in guides]
    circles = {f"{body} R {_mm(1e3 * one.radius)}" for body, listed in drawn.profiles.items() for one in listed if one.radius}
    words += sorted(circles)
    driving = cycle.problem.model.driving
    place = f"{driving.noun} of {_deg(at) if driving.ends is None else f'{_mm(driving.shown(at))} mm'}"
    caption = f"Drawn at a {place}; lengths in mm, an angle is that through which a link moves."
    described = f"{title}, drawn at a {place}. Dimensions in mm: {'; '.join(words)}."
    for name in drawn.moving:
        if np.all(np.isfinite(drawn.points[name][0])):
            sheet.label(drawn.points[name][0], name)
    return Drawing(
        svg(drawn, described, traces=False, names=False, box=sheet.place(), dimensions=sheet.drawn), described, caption
    )


def clearest(cycle: Analysis) -> float:
    """Return the crank angle [rad] at which the joints keep farthest from the lines of links to which they do not belong."""
    machine, mechanism = cycle.machine, cycle.machine.mechanism
    all_angles = cycle.positions
    angles = all_angles[even(len(all_angles), POSITIONS)]
    motion = machine.motion(angles)
    places = {name: motion.position(name) for name in mechanism.owners}
    gaps = [np.full(len(angles), math.inf)]
    for body in (*mechanism.bodies, FRAME):
        names = [name for name, bodies in mechanism.owners.items() if body in bodies]
        for (p, q), name in itertools.product(itertools.pairwise(names), places):
            if name not in names:
                along = places[q] - places[p]
                share = np.sum((places[name] - places[p]) * along, axis=1) / np.maximum(np.sum(along**2, axis=1), 1e-30)
                foot = places[p] + share[:, None] * along
                gaps.append(np.linalg.norm(places[name] - foot, axis=1))
    least = np.nan_to_num(np.min(gaps, axis=0), nan=-1.0)
    return float(angles[int(np.argmax(least))])


# --- what is dimensioned -----------------------------------------------------------------------------------------------------


def _links(cycle: Analysis, drawn: Scene, *, named: bool = False) -> Iterator[_Length]:
    """Yield the distances between neighbouring points of every link, of the frame between its pivots."""
    extent = max(drawn.box[2:])
    pose, drives = drawn.motion.pose, [drive for drive in cycle.machine.mechanism.drives if drive.size]
    strokes = {one.body: "…".join(_mm(1e3 * float(pose.size(end))) for end in one.stroke) for one in drives}
    for body in (*cycle.machine.mechanism.bodies, FRAME):
        names = [
            name
            for name, bodies in cycle.machine.mechanism.owners.items()
            if body in bodies and (body != FRAME or name in drawn.pins)
        ]
        points = [drawn.points[name][0] for name in names]
        distinct = [k for k, p in enumerate(points) if all(np.linalg.norm(p - q) > COINCIDENT * extent for q in points[:k])]
        for i, j in _neighbours(np.array([points[k] for k in distinct]).reshape(-1, 2)):
            p, q = points[distinct[i]], points[distinct[j]]
            length = strokes.get(body) or _mm(float(np.linalg.norm(q - p)))
            ends = names[distinct[i]], names[distinct[j]]
            text = f"{body} {('' if max(map(len, ends)) < 3 else '–').join(ends)} {length}" if named else length
            yield _Length((p, q), text, GROUND if body == FRAME else _colour(drawn, body))


def _neighbours(points: Array) -> list[tuple[int, int]]:
    """Return the pairs of neighbouring points: along a line, or around their convex hull."""
    if len(points) < 2 or not np.all(np.isfinite(points)):
        return []
    if len(points) == 2:
        return [(0, 1)]
    order = in_line(points, 1e-3 * np.ptp(points, axis=0).max())
    if order is not None:
        return list(itertools.pairwise(order.tolist()))
    ring = [int(np.argmin(np.linalg.norm(points - corner, axis=1))) for corner in hull(points)]
    inner = [k for k in range(len(points)) if k not in ring]
    return [*itertools.pairwise([*ring, ring[0]]), *((k, ring[0]) for k in inner)]


def _strokes(cycle: Analysis, at: float, drawn: Scene, *, named: bool = False) -> Iterator[_Length]:
    """Yield the strokes of the sliders on the frame, along their guides."""
    machine = cycle.machine
    motion = machine.motion([at])
    for guide in machine.mechanism.guides:
        travel = cycle.strokes.get(slider_names(machine)[guide.name])
        if guide.on == FRAME and travel is not None:
            point, direction = map(plain, motion.pose.local_line(guide, FRAME))
            ends = (1e3 * (point + travel.low * direction), 1e3 * (point + travel.high * direction))
            text = f"stroke {guide.slider} {_mm(1e3 * travel.span)}" if named else f"stroke {_mm(1e3 * travel.span)}"
            yield _Length(ends, text, _colour(drawn, guide.slider))


def _guides(cycle: Analysis, at: float, drawn: Scene) -> Iterator[tuple[str, _Length]]:
    """Yield every guide in words, and its distance from the point that places it, else the first of its body."""
    mechanism = cycle.machine.mechanism
    pose = cycle.machine.motion([at]).pose
    for guide in mechanism.guides:
        start, along = map(plain, pose.line(guide, guide.on))
        near = mechanism.crank.start if guide.on == FRAME else pose.mechanism.bodies[guide.on].start
        near = guide.through if isinstance(guide.through, str) and guide.through in drawn.points else near
        place = drawn.points[near][0]
        foot = 1e3 * start + np.dot(place - 1e3 * start, along) * along
        distance = _mm(float(np.linalg.norm(foot - place)))
        where = f"through {near}" if distance == "0" else f"{distance} from {near}"
        angle = f" at {_deg(math.atan2(*along[::-1]))}," if guide.on == FRAME else ""
        text = f"guide of {guide.slider}{angle} {where}"
        yield text, _Length((place, foot), "" if distance == "0" else distance, _colour(drawn, guide.slider))


def _swings(cycle: Analysis, drawn: Scene) -> Iterator[tuple[str, float, float, Array, float]]:
    """Yield body, ends of its range [rad], ground pivot and direction at the low end, of all bodies with a pivot on the frame."""
    mechanism, at = cycle.machine.mechanism, drawn.crank_angles[0]
    for body in mechanism.bodies:
        names = [name for name, bodies in mechanism.owners.items() if body in bodies]
        pivot = next((name for name in names if name in mechanism.ground), None)
        moving_end = next((name for name in names if name not in mechanism.ground), None)
        if pivot is None or moving_end is None:
            continue
        arm = drawn.points[moving_end][0] - drawn.points[pivot][0]
        direction = math.atan2(arm[1], arm[0])
        angle = math.radians(float(drawn.poses(body)[0, 2]))
        if body == mechanism.crank.body and not mechanism.drives:
            angles = cycle.positions
            low, high = (0.0, TURN) if cycle.full else (float(np.min(angles)), float(np.max(angles)))
            angle = math.radians(float(at))
        elif body in cycle.swings:
            low, high = cycle.swings[body].low, cycle.swings[body].high
            angle = low + (angle - low) % TURN  # the angle of a body is known up to full turns
        else:
            continue
        yield body, low, high, drawn.points[pivot][0], direction - angle + low


def _colour(drawn: Scene, body: str) -> str:
    return readable(drawn.colours[body])


def _mm(value: float) -> str:
    return f"{value + 0.0:.4g}".replace("-", "−") if abs(value) >= 5e-4 else "0"


def _deg(angle: float) -> str:
    return f"{math.degrees(angle):.4g}°".replace("-", "−")


# --- drawing -----------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Place:
    """A place of a text with its lines: its middle, unit vector along it, its cost, and lines, each (n, 2)."""

    middle: Array
    along: Array
    cost: float
    lines: tuple[Array, ...]


class _Sheet:
    """Dimension lines and labels placed clear of the links and of one another."""

    def __init__(self, drawn: Scene) -> None:
        self.scene, self.size, self.font = drawn, 0.8 * drawn.size, 0.95 * drawn.size
        shapes = [one for one in drawn.moving_shapes if one.layer not in ("centroid", "joints")]
        lines = [drawn.located(one, drawn.shown)[0] for one in shapes] + [line for line, _, _ in drawn.ground]
        self.links = [piece for line in lines for piece in pieces(line)]
        self.items: list[tuple[Places, Callable[[int], None]]] = []  # possible places, and how one is drawn
        self.drawn: list[Shape | Text] = []

    def _half(self, text: str) -> float:
        """Return half the width of a text."""
        return 0.5 * LETTER_WIDTH * self.font * len(text)

    def length(self, dimension: _Length) -> None:
        """Add a distance with extension lines, arrows and its text along the line."""
        p, q = dimension.ends
        span = float(np.linalg.norm(q - p))
        if span < 1e-9 or not dimension.text:
            return
        along, half = (q - p) / span, self._half(dimension.text)
        normal = left_of(along)
        inside = span > 2.0 * half + 2.5 * self.size
        beyond = 0.5 + (half + 1.4 * self.size) / span  # share of the length at which the text stands beside the arrows
        shares = [
            share for share in (0.5, 0.35, 0.65, 0.22, 0.78) if inside and min(share, 1.0 - share) * span > half + self.size
        ]
        places = []
        for offset, side in itertools.product(OFFSETS, (1.0, -1.0)):
            shift = side * offset * self.size * normal
            a, b = p + shift, q + shift
            gap, over = (share * self.size * side * normal for share in (0.45, 0.35))
            rays = (np.array([p + gap, a + over]), np.array([q + gap, b + over]))
            for share in shares:
                middle = a + share * (b - a)
                parts = (np.array([a, middle - half * along]), np.array([middle + half * along, b]))
                places.append(_Place(middle, along, 0.3 * offset + 0.4 * abs(share - 0.5), (*rays, *parts)))
            if not inside:
                lines = (*rays, np.array([a, b]))
                outside = 0.5 * (a + b) + 0.75 * self.font * side * normal
                places.append(_Place(outside, along, 0.3 * offset, lines))
                for share in (-beyond, beyond):
                    end = 0.5 * (a + b) + share * (b - a)
                    places.append(_Place(end, along, 0.3 * offset + 0.3, lines))

        def drawn(k: int) -> None:
            place = places[k]
            a, b = place.lines[0][1], place.lines[1][1]
            over = 0.35 * self.size * (a - p) / np.linalg.norm(a - p)
            a, b = a - over, b - over
            for n, line in enumerate(place.lines):
                self._line(line, dimension.colour, 0.6 if n < 2 else 0.8)
            self._arrow(a, -along if span > 1.6 * self.size else along, dimension.colour)
            self._arrow(b, along if span > 1.6 * self.size else -along, dimension.colour)
            angle = math.degrees(math.atan2(along[1], along[0]))
            upright = angle + 180.0 if angle < -90.0 else angle - 180.0 if angle >= 90.0 else angle
            self._text(place.middle, dimension.text, dimension.colour, upright)

        self.items.append((self._places(places, half), drawn))

    def angle(self, centre: Array, start: float, low: float, high: float, text: str, colour: str) -> None:
        """Add the range of an angle as an arc with arrows, from the direction `start` [rad] on."""
        half, full = self._half(text), high - low >= TURN - 1e-9
        turn = min(high - low, math.radians(300.0))
        directions = start + np.linspace(0.0, turn, max(8, math.ceil(math.degrees(turn) / 4)))
        rays = ways(directions)
        outside = (half + 0.8 * self.font) / (3.2 * self.size * max(high - low, 1e-9))  # beyond the ends of a narrow range
        shares = np.linspace(0.1, 0.9, 9).tolist() + ([] if outside > 4.0 or high - low > 2.0 else [-outside, 1.0 + outside])
        places = []
        for radius, share in itertools.product((2.2, 3.2, 4.4, 5.6), shares):
            direction = start + share * (high - low)
            ray = np.array([math.cos(direction), math.sin(direction)])
            inside = min(half / max(abs(ray[0]), 1e-9), 0.4 * self.font / max(abs(ray[1]), 1e-9))  # of the text, along the ray
            middle = centre + (radius * self.size + inside + 0.4 * self.font) * ray
            arc = centre + radius * self.size * rays
            reach = np.array([0.5, radius + 0.6]) * self.size
            sides = () if full else tuple(centre + np.outer(reach, rays[at]) for at in (0, -1))
            places.append(_Place(middle, LEVEL[0], 0.25 * radius + 0.3 * abs(share - 0.5), (arc, *sides)))

        def drawn(k: int) -> None:
            place = places[k]
            arc, *sides = place.lines
            self._line(arc, colour, 0.8)
            for side in sides:
                self._line(side, colour, 0.6)
            if not full:
                self._arrow(arc[0], arc[0] - arc[1], colour)
            self._arrow(arc[-1], arc[-1] - arc[-2], colour)
            self._text(place.middle, text, colour, 0.0)

        self.items.append((self._places(places, half), drawn))

    def label(self, at: Array, text: str) -> None:
        """Add a text beside a point."""
        half = np.array([self._half(text), HIGH * self.font])
        others = [path[:1] for path in self.scene.points.values()]
        places = beside(at[None], half, REACHES * self.size, 0.35 / self.size, others, (0.0, 0.0))
        self.items.append((places, lambda k: self._text(at + places.middles[k], text, GROUND, 0.0)))

    def _places(self, places: Sequence[_Place], half: float) -> Places:
        lines = [sampled(joined(line[None] for line in place.lines), CELL * self.font)[0] for place in places]
        table = np.full((len(lines), max(map(len, lines)), 2), np.nan)
        for row, line in zip(table, lines, strict=True):
            row[: len(line)] = line
        size = np.array([half, HIGH * self.font])
        middles, along = (np.array([getattr(place, name) for place in places]) for name in ("middle", "along"))
        return Places(np.zeros((1, 2)), middles, size, np.array([[place.cost for place in places]]), along, table)

    def place(self) -> tuple[float, float, float, float]:
        """Place and draw all texts with their lines, and return the extent of links and dimensions."""
        wide = CELL * self.font * np.array([(x, y) for x in (-1.0, 0.0, 1.0) for y in (-1.0, 0.0, 1.0)])
        thick = [((line + side)[None], 1.0) for line in self.links for side in wide]
        chosen = arrange([places for places, _ in self.items], thick, self.font)
        for [k], (_, drawn) in zip(chosen, self.items, strict=True):
            drawn(int(k))
        self.drawn.sort(key=lambda one: isinstance(one, Text))  # texts above all lines
        taken = [places.covered(0.0, CELL * self.font)[0, k] for [k], (places, _) in zip(chosen, self.items, strict=True)]
        every = finite(np.concatenate([*self.links, *taken, *(one.line for one in self.drawn if isinstance(one, Shape))]))
        low, high = every.min(axis=0) - 0.8 * self.size, every.max(axis=0) + 0.8 * self.size
        return float(low[0]), float(low[1]), float(high[0] - low[0]), float(high[1] - low[1])

    def _line(self, points: Array, colour: str, width: float) -> None:
        self.drawn.append(Shape("dimensions", "", points, colour, 0.8 * width))

    def _arrow(self, tip: Array, direction: Array, colour: str) -> None:
        direction = normed(direction)
        left = left_of(direction)
        back = tip - 0.75 * self.size * direction
        corners = np.array([tip, back + 0.16 * self.size * left, back - 0.16 * self.size * left])
        self.drawn.append(Shape("dimensions", "", corners, colour, 0.0, fill=colour))

    def _text(self, at: Array, text: str, colour: str, angle: float) -> None:
        self.drawn.append(Text(text, at, colour, self.font, angle))
