"""Dimensioned SVG drawing of a mechanism: link lengths, pivots, angle ranges and strokes, in millimetres and degrees."""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from html import escape

import numpy as np

from optlink.dynamics.machine import slider_names
from optlink.linkage.mechanism import FRAME
from optlink.linkage.motion import sweep
from optlink.linkage.vector2d import TURN, Array
from optlink.report.export.svg import svg
from optlink.report.html.theme import readable
from optlink.report.scene import FLIP, Scene, scene
from optlink.report.shapes import finite, hull, in_line
from optlink.report.style import GROUND
from optlink.tasks.results.analysis import Analysis

POSITIONS = 24  # positions from which the clearest is drawn
OFFSETS = (1.2, 2.2, 3.3, 4.6)  # distances of a dimension line from what it measures, in heights of a ground pivot
LETTER_WIDTH = 0.62  # width of a letter in font sizes
_ANIMATED = re.compile(r' data-(?:body|point|spring)="[^"]*"')  # names by which the page moves a linkage
COINCIDENT = 1e-6  # distance of coincident points, as a share of the extent


@dataclass(frozen=True, eq=False)
class Drawing:
    """A dimensioned drawing as SVG, and its description in words."""

    svg: str
    words: str


@dataclass(frozen=True)
class _Length:
    """A distance to be dimensioned between two points [mm], with its text and colour."""

    ends: tuple[Array, Array]
    text: str
    colour: str


def dimensioned(cycle: Analysis, title: str) -> Drawing:
    """Draw a mechanism with its dimensions in its clearest position.

    Parameters
    ----------
    cycle : Analysis
    title : str
        Begin of the description.
    """
    at = clearest(cycle)
    drawn = scene(cycle, at=at)
    sheet = _Sheet(drawn)
    descriptions: list[str] = []
    descriptions += list(dict.fromkeys(f"{dimension.text}" for dimension in _links(cycle, drawn, named=True)))
    for name, low, high, centre, start in _swings(cycle, drawn):
        text = "360°" if high - low >= TURN - 1e-9 else f"{_deg(high - low)}"
        descriptions.append(f"{name} turns fully" if text == "360°" else f"{name} swings {text}")
        sheet.angle(centre, start, low, high, text, _colour(drawn, name))
    for dimension in (*_links(cycle, drawn), *_strokes(cycle, at, drawn)):
        sheet.length(dimension)
    for name in cycle.machine.mechanism.ground:
        x, y = drawn.points[name][0] * FLIP
        place = f"{name} ({_mm(x)}, {_mm(y)})"
        descriptions.append(f"pivot {place}" if name in drawn.pins else place)
        sheet.label(drawn.points[name][0], place)
    descriptions += [
        f"{dimension.text.partition(' ')[0]} of {dimension.text.partition(' ')[2]}"
        for dimension in _strokes(cycle, at, drawn, named=True)
    ]
    described = f"{title}, drawn at a crank angle of {_deg(at)}. Dimensions in mm: {'; '.join(descriptions)}."
    for name in drawn.moving:
        if np.all(np.isfinite(drawn.points[name][0])):
            sheet.label(drawn.points[name][0], name)
    box = sheet.box()
    plain = _ANIMATED.sub("", svg(replace(drawn, box=box), described, traces=False, names=False))
    end = plain.rindex("</svg>")
    return Drawing(f"{plain[:end]}{sheet.svg()}</svg>\n", described)


def clearest(cycle: Analysis) -> float:
    """Return the crank angle [rad] at which the joints keep farthest from the lines of links to which they do not belong."""
    machine, mechanism = cycle.machine, cycle.machine.mechanism
    all_angles = np.radians(cycle["crank_angle_deg"])
    angles = all_angles[np.linspace(0, len(all_angles) - 1, POSITIONS).round().astype(int)]
    motion = sweep(mechanism, machine.sizes, angles)
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
            length = _mm(float(np.linalg.norm(q - p)))
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
    motion = sweep(machine.mechanism, machine.sizes, [at])
    for guide in machine.mechanism.guides:
        travel = cycle.strokes.get(slider_names(machine)[guide.name])
        if guide.on == FRAME and travel is not None:
            point, direction = (
                np.array([float(np.asarray(part)) for part in vector]) for vector in motion.pose.local_line(guide, FRAME)
            )
            ends = (1e3 * (point + travel.low * direction) * FLIP, 1e3 * (point + travel.high * direction) * FLIP)
            text = f"stroke {guide.slider} {_mm(1e3 * travel.span)}" if named else f"stroke {_mm(1e3 * travel.span)}"
            yield _Length(ends, text, _colour(drawn, guide.slider))


def _swings(cycle: Analysis, drawn: Scene) -> Iterator[tuple[str, float, float, Array, float]]:
    """Yield body, ends of its range [rad], ground pivot and direction at the low end, of all bodies with a pivot on the frame."""
    mechanism, at = cycle.machine.mechanism, drawn.angles[0]
    for body in mechanism.bodies:
        names = [name for name, bodies in mechanism.owners.items() if body in bodies]
        pivot = next((name for name in names if name in mechanism.ground), None)
        moving_end = next((name for name in names if name not in mechanism.ground), None)
        if pivot is None or moving_end is None:
            continue
        arm = (drawn.points[moving_end][0] - drawn.points[pivot][0]) * FLIP
        direction = math.atan2(arm[1], arm[0])
        angle = -math.radians(float(next(b for b in drawn.bodies if b.name == body).poses[0, 2]))
        if body == mechanism.crank.body:
            angles = np.radians(cycle["crank_angle_deg"])
            low, high = (0.0, TURN) if cycle.full else (float(np.min(angles)), float(np.max(angles)))
            angle = math.radians(float(at))
        elif body in cycle.swings:
            low, high = cycle.swings[body].low, cycle.swings[body].high
            angle = low + (angle - low) % TURN  # the angle of a body is known up to full turns
        else:
            continue
        yield body, low, high, drawn.points[pivot][0], direction - angle + low


def _colour(drawn: Scene, body: str) -> str:
    return readable(next(item.colour for item in drawn.bodies if item.name == body))


def _mm(value: float) -> str:
    return f"{value + 0.0:.4g}".replace("-", "−") if abs(value) >= 5e-4 else "0"


def _deg(angle: float) -> str:
    return f"{math.degrees(angle):.4g}°".replace("-", "−")


# --- drawing -----------------------------------------------------------------------------------------------------------------


class _Sheet:
    """Dimension lines and labels placed clear of the links and of one another."""

    def __init__(self, drawn: Scene) -> None:
        self.scene, self.size, self.font = drawn, 0.8 * drawn.size, 0.95 * drawn.size
        self.taken: list[Array] = []  # points covered by texts
        outlines = [self._placed(body.poses[0], part.outline) for body in drawn.bodies for part in body.parts]
        ground = [line for line, _, _ in drawn.ground]
        self.corners = finite(np.concatenate([*outlines, *ground]))
        bars = (self._sampled(p, q) for line in outlines for p, q in itertools.pairwise(line))
        self.crowd = finite(np.concatenate([*bars, *ground]))
        self.lines: list[str] = []

    @staticmethod
    def _placed(pose: Array, outline: Array) -> Array:
        """Return an outline in the axes of its body at its place."""
        turn = math.radians(float(pose[2]))
        across, along = np.array([-math.sin(turn), math.cos(turn)]), np.array([math.cos(turn), math.sin(turn)])
        return np.asarray(pose[:2] + outline[:, :1] * along + outline[:, 1:] * across)

    def _sampled(self, p: Array, q: Array, count: int = 24) -> Array:
        return p + np.linspace(0.0, 1.0, count)[:, None] * (q - p)

    def _around(self, middle: Array, half: float) -> Array:
        """Return points along a level text of a half width."""
        return self._sampled(middle - np.array([half, 0.0]), middle + np.array([half, 0.0]), 9)

    def _cost(self, points: Array) -> float:
        """Return how much a text at sampled points covers."""
        crowd = np.concatenate([self.crowd, *self.taken])
        distance = np.linalg.norm(points[:, None] - crowd, axis=-1) if len(crowd) else np.full((1, 1), math.inf)
        return float(np.sum(np.maximum(0.0, 0.9 * self.font - distance)) / self.font)

    def length(self, dimension: _Length) -> None:
        """Draw a distance with extension lines, arrows and its text along the line."""
        p, q = dimension.ends
        along = q - p
        span = float(np.linalg.norm(along))
        if span < 1e-9:
            return
        along /= span
        normal = np.array([along[1], -along[0]])
        half = 0.5 * LETTER_WIDTH * self.font * len(dimension.text)

        def placed(offset: tuple[float, float]) -> tuple[float, Array, Array]:
            shift = offset[1] * offset[0] * self.size * normal
            middle = 0.5 * (p + q) + shift
            covered = self._sampled(middle - half * along, middle + half * along, 9)
            return self._cost(covered) + 0.15 * self._cost(self._sampled(p + shift, q + shift)) + 0.3 * offset[0], shift, covered

        _, shift, covered = min(map(placed, itertools.product(OFFSETS, (1.0, -1.0))), key=lambda item: item[0])
        a, b = p + shift, q + shift
        self.taken += [covered, self._sampled(a, b, 12)]
        over = 0.35 * self.size * shift / np.linalg.norm(shift)
        gap = 0.45 * self.size * shift / np.linalg.norm(shift)
        self._line([p + gap, a + over], dimension.colour, 0.6)
        self._line([q + gap, b + over], dimension.colour, 0.6)
        inside = span > 2.0 * half + 2.5 * self.size
        parts = [(a, 0.5 * (a + b) - half * along), (0.5 * (a + b) + half * along, b)] if inside else [(a, b)]
        for begin, end in parts:
            self._line([begin, end], dimension.colour, 0.8)
        self._arrow(a, -along if span > 1.6 * self.size else along, dimension.colour)
        self._arrow(b, along if span > 1.6 * self.size else -along, dimension.colour)
        middle = 0.5 * (a + b) + (0.0 if inside else 0.75 * self.font) * shift / np.linalg.norm(shift)
        angle = math.degrees(math.atan2(along[1], along[0]))
        self._text(
            middle,
            dimension.text,
            dimension.colour,
            angle - 180.0 if angle > 90.0 else angle + 180.0 if angle <= -90.0 else angle,
        )

    def angle(self, centre: Array, start: float, low: float, high: float, text: str, colour: str) -> None:
        """Draw the range of an angle as an arc with arrows, from the direction `start` [rad] on."""
        half = 0.5 * LETTER_WIDTH * self.font * len(text)

        def placed(radius: float, share: float) -> tuple[float, float, Array]:
            direction = start + share * (high - low)
            ray = np.array([math.cos(direction), -math.sin(direction)])
            inside = min(half / max(abs(ray[0]), 1e-9), 0.4 * self.font / max(abs(ray[1]), 1e-9))  # of the text, along the ray
            middle = centre + (radius * self.size + inside + 0.4 * self.font) * ray
            covered = self._around(middle, half)
            return self._cost(covered) + 0.25 * radius, radius * self.size, covered

        outside = (half + 0.8 * self.font) / (3.2 * self.size * max(high - low, 1e-9))  # beyond the ends of a narrow range
        shares = (0.5, 0.25, 0.75) if outside > 4.0 or high - low > 2.0 else (0.5, 0.25, 0.75, -outside, 1.0 + outside)
        places = itertools.product((2.2, 3.2, 4.4, 5.6), shares)
        _, radius, covered = min(itertools.starmap(placed, places), key=lambda item: item[0])
        turn = min(high - low, math.radians(300.0))
        directions = start + np.linspace(0.0, turn, max(8, math.ceil(math.degrees(turn) / 4)))
        arc = centre + radius * np.stack([np.cos(directions), -np.sin(directions)], axis=1)
        self.taken += [covered, arc]
        self._line(list(arc), colour, 0.8)
        for at, sign in ((0, 1.0), (-1, -1.0)):
            if at or high - low < TURN - 1e-9:
                self._arrow(arc[at], -sign * (arc[1] - arc[0] if at == 0 else arc[-2] - arc[-1]) * sign, colour)
            if high - low < TURN - 1e-9:
                ray = np.array([math.cos(directions[at]), -math.sin(directions[at])])
                self._line([centre + 0.5 * self.size * ray, centre + (radius + 0.6 * self.size) * ray], colour, 0.6)
        self._text(covered[4], text, colour, 0.0)

    def label(self, at: Array, text: str) -> None:
        """Write a text beside a point, that of a ground pivot clear of its support."""
        half = 0.5 * LETTER_WIDTH * self.font * len(text)
        offsets = [*itertools.product((1.1, -1.1), (0.9, 2.0, -1.4)), (0.5, -0.9), (-0.5, -0.9), (0.9, 0.0)]
        places = [at + self.size * np.array(offset) + [math.copysign(half, offset[0]), 0.0] for offset in offsets]
        covered = min((self._around(place, half) for place in places), key=self._cost)
        self.taken.append(covered)
        self._text(covered[4], text, GROUND, 0.0)

    def _line(self, points: list[Array], colour: str, width: float) -> None:
        path = " L".join(f"{x:.6g} {y:.6g}" for x, y in points)
        self.lines.append(f'<path d="M{path}" fill="none" stroke="{colour}" stroke-width="{width * self.size / 8.0:.4g}"/>')

    def _arrow(self, tip: Array, direction: Array, colour: str) -> None:
        direction = direction / max(float(np.linalg.norm(direction)), 1e-30)
        left = np.array([-direction[1], direction[0]])
        back = tip - 0.75 * self.size * direction
        corners = (tip, back + 0.16 * self.size * left, back - 0.16 * self.size * left)
        path = " L".join(f"{x:.6g} {y:.6g}" for x, y in corners)
        self.lines.append(f'<path d="M{path}Z" fill="{colour}"/>')

    def _text(self, at: Array, text: str, colour: str, angle: float) -> None:
        x, y = at
        turned = f' transform="rotate({angle:.4g} {x:.6g} {y:.6g})"' if angle else ""
        look = f'fill="{colour}" stroke="#ffffff" stroke-width="{0.28 * self.size:.4g}" paint-order="stroke"'
        self.lines.append(f'<text x="{x:.6g}" y="{y:.6g}" dy="0.35em" text-anchor="middle" {look}{turned}>{escape(text)}</text>')

    def svg(self) -> str:
        """Return the dimensions as a group."""
        return f'<g data-layer="dimensions" font-family="sans-serif" font-size="{self.font:.4g}">' + "".join(self.lines) + "</g>"

    def box(self) -> tuple[float, float, float, float]:
        """Return the extent of the links and dimensions in this position."""
        points = finite(np.concatenate([self.corners, *self.taken]))
        low, high = points.min(axis=0) - 1.4 * self.size, points.max(axis=0) + 1.4 * self.size
        return float(low[0]), float(low[1]), float(high[0] - low[0]), float(high[1] - low[1])
