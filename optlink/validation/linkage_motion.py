"""Motion of many linkages of any dyads at once, measured between their points and lines.

Every figure of a design is the same whatever the other designs are. Extremes are refined between the positions.
"""

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from optlink.linkage.dyad_types import RPR, RRP, RRR, transmitting
from optlink.linkage.extrema import Function, extremes_of_rows
from optlink.linkage.inner_four_bar import whole_four_bar
from optlink.linkage.mechanism import FRAME, Guide, Mechanism
from optlink.linkage.motion import Motion, sweep
from optlink.linkage.stroke import travels
from optlink.linkage.vector2d import TURN, Array, Value, Vector, cross, dot, unit
from optlink.validation.check import Checks, length_check
from optlink.validation.four_bar_motion import BLOCK, ROUNDING, SPEEDUP, FourBarMotion
from optlink.validation.margins import squared_sines


@dataclass(frozen=True)
class _Survey:
    """Figures of the motions, arrays (..., designs).

    `least`, `largest` (links, designs): measured lengths of the links [m]; `height` [m]: least distance of a joint from the line
    of its outer pins; `jump`: longest step of a joint or point as a multiple of `SPEEDUP` steps at its speed.
    """

    least: Array
    largest: Array
    height: Array
    jump: Array


class LinkageMotion:
    """Motion of linkages over evenly spaced crank angles, (angles,) or (designs, angles) [rad]; see `FourBarMotion`.

    `linkage` is the prescribed one, `mechanism` the one that is measured, with the same names of bodies and joints. `point`: a
    point whose path is surveyed beside those of the joints.
    """

    def __init__(
        self,
        linkage: Mechanism,
        mechanism: Mechanism,
        sizes: Mapping[str, Array],
        angles: Array,
        size: ArrayLike,
        point: str = "",
        *,
        closed: bool = False,
        span: Value = TURN,
    ) -> None:
        self.linkage, self.mechanism, self.sizes, self.angles, self.closed = linkage, mechanism, sizes, angles, closed
        self.count, self.positions = len(next(iter(sizes.values()))), angles.shape[-1]
        self.size = np.broadcast_to(np.asarray(size, dtype=float), self.count)
        self.span = np.broadcast_to(np.ravel(span), self.count)[:, None]
        self.width = np.abs(self.span) / (self.positions - (not closed))
        self.joints = tuple(dict.fromkeys((*(group.joint for group in linkage.groups), point)))
        self.links = tuple(link for link in linkage.links if link.end)

    def _blocks(self) -> Iterator[tuple[slice, dict[str, Array], Array]]:
        """Yield designs, their sizes and their crank angles, so many that their positions fit the processor's cache."""
        size = max(1, BLOCK // self.positions)
        for first in range(0, self.count, size):
            part = slice(first, min(first + size, self.count))
            sizes = {name: values[part] for name, values in self.sizes.items()}
            yield part, sizes, self.angles if self.angles.ndim == 1 else self.angles[part]

    @cached_property
    def survey(self) -> _Survey:
        """Figures of the motion of each design."""
        blocks = [self._surveyed(sweep(self.mechanism, sizes, angles), part) for part, sizes, angles in self._blocks()]
        return _Survey(*(np.concatenate(figures, axis=-1) for figures in zip(*blocks, strict=True)))

    @np.errstate(all="ignore")
    def _surveyed(self, motion: Motion, part: slice) -> tuple[Array, ...]:
        """Return the figures of a block of designs."""
        along = np.array([motion.distance(link.start, link.end) for link in self.links])
        heights = np.full(motion.shape, np.inf)
        for group in self.linkage.groups:
            if isinstance(group, RRR):
                p, q, c = (motion.position(name) for name in (*group.outer, group.inner))
                line, arm = q - p, c - p
                moment = line[..., 0] * arm[..., 1] - line[..., 1] * arm[..., 0]
                heights = np.minimum(heights, group.side * moment / np.linalg.norm(line, axis=-1))
        step, rounding, worst = self.width[part], ROUNDING * self.size[part, None], np.zeros(len(heights))
        for name in self.joints:
            if name in motion.pose.points:
                courses = motion.position(name), motion.velocity(name), motion.acceleration(name)
                path, velocity, acceleration = (np.concatenate([x, x[:, :1]], axis=1) if self.closed else x for x in courses)
                speed, bend = (np.linalg.norm(x, axis=-1) for x in (velocity, acceleration))
                fastest = np.maximum(speed[:, 1:], speed[:, :-1]) * step + np.maximum(bend[:, 1:], bend[:, :-1]) * step * step
                jumps = np.linalg.norm(np.diff(path, axis=1), axis=-1) / (SPEEDUP * fastest + rounding)
                worst = np.maximum(worst, np.max(jumps, axis=1))
        return np.min(along, axis=2), np.max(along, axis=2), np.min(heights, axis=1), worst

    def link_lengths(self, size: ArrayLike) -> Checks:
        """Check that all links keep their lengths in motion; `size` [m] is the reference."""
        nominal = (link.length if isinstance(link.length, float) else self.sizes[link.length][:, 0] for link in self.links)
        return length_check(zip(self.survey.least, self.survey.largest, nominal, strict=True), size)

    @property
    def least_height(self) -> Array:
        """Least distance of a joint from the line of its outer pins (designs,) [m], infinite without such joints.

        Negative on the wrong side, NaN if open.
        """
        return self.survey.height

    @property
    def largest_jump(self) -> Array:
        """Longest step of any joint or point (designs,), as a multiple of 1.5 steps at its speed."""
        return self.survey.jump

    @property
    def least_squared_sines(self) -> Array:
        """Least squared sine of the angle of each group from alignment (groups, designs); negative or NaN if not closed."""
        return self._extremes(squared_sines, len(self.linkage.groups), (1.0,), everywhere=True)[..., 0]

    @property
    def transmission_extremes(self) -> tuple[Array, Array]:
        """Least and largest transmission angle of each dyad that has one (dyads, designs) [rad]."""

        def angles(motion: Motion) -> Array:
            return np.moveaxis(transmission_angles(motion, self.linkage), -1, 0)

        least, largest = np.moveaxis(self._extremes(angles, len(transmitting(self.linkage)), (1.0, -1.0)), -1, 0)
        return least, largest

    def _extremes(
        self, measure: Callable[[Motion], Array], kinds: int, signs: tuple[float, ...], *, everywhere: bool = False
    ) -> Array:
        """Return the extremes (kinds, designs, signs) of figures (kinds, ...) of the motion.

        `everywhere`: NaN for figures that have no value at a position.
        """
        parts = [np.zeros((kinds, 0, len(signs)))]
        grid = np.linspace(0.0, 1.0, self.positions + self.closed)
        for part, sizes, angles in self._blocks() if kinds else ():
            samples = measure(placed(self.mechanism, sizes, angles))
            samples = np.concatenate([samples, samples[..., :1]], axis=-1) if self.closed else samples
            begin, span = angles[..., :1], self.span[part]

            def at(shares: Array, sizes: Mapping[str, Array] = sizes, begin: Array = begin, span: Array = span) -> Array:
                return measure(placed(self.mechanism, sizes, begin + span * shares))

            rows = samples.reshape(-1, len(grid))
            values = extremes_of_rows(rows_of(at, kinds, len(span)), grid, rows, periodic=self.closed, signs=signs)
            if everywhere:
                values = np.where(np.all(np.isfinite(rows), axis=1, keepdims=True), values, np.nan)
            parts.append(values.reshape(kinds, len(span), len(signs)))
        return np.concatenate(parts, axis=1)

    def strokes(self, design: int, sense: float) -> tuple[float, float, float]:
        """Return the swing angle of the rocker and the crank rotation of its forward and backward strokes [rad], or NaN."""
        sizes = {name: float(values[design, 0]) for name, values in self.sizes.items()}
        travel = travels(self.mechanism, sizes, 0.0, TURN, True)[0].get("rocker")
        if travel is None:
            return math.nan, math.nan, math.nan
        turned = {stroke.name: stroke.rotation for stroke in travel.strokes(sense)}
        return travel.span, turned.get("forward", math.nan), turned.get("backward", math.nan)


def motion_of(
    linkage: Mechanism,
    mechanism: Mechanism,
    sizes: Mapping[str, Array],
    angles: Array,
    size: ArrayLike,
    point: str = "",
    *,
    closed: bool = False,
    span: Value = TURN,
) -> FourBarMotion | LinkageMotion:
    """Return the motion of linkages: a `LinkageMotion`, or the faster `FourBarMotion` of those that are four-bars as a whole."""
    loop = whole_four_bar(linkage)
    if loop is None:
        return LinkageMotion(linkage, mechanism, sizes, angles, size, point, closed=closed, span=span)
    return FourBarMotion(loop, mechanism, sizes, angles, size, closed=closed, span=span)


def placed(mechanism: Mechanism, sizes: Mapping[str, Value], angles: Array) -> Motion:
    """Return the positions of a mechanism at crank angles [rad] as a motion without velocities."""
    with np.errstate(all="ignore"):
        return Motion(mechanism, sizes, angles, 0.0, mechanism.at(sizes, angles))


def rows_of(measure: Callable[[Array], Array], kinds: int, designs: int) -> Function:
    """Return figures of designs as a function for `extremes_of_rows`: every kind of every design is a row.

    `measure` maps shares of a range, (1, n) or (kinds, designs, n), to the figures (kinds, ..., designs, n).
    """

    def function(shares: Array) -> Array:
        if len(shares) == 1:
            return measure(shares).reshape(kinds * designs, -1)
        each = np.arange(kinds)
        return measure(shares.reshape(kinds, designs, -1))[each, each].reshape(kinds * designs, -1)

    return function


def transmission_angles(motion: Motion, mechanism: Mechanism) -> Array:
    """Return the transmission angle of every dyad (..., dyads) [rad], from 0 to pi, from the moving links and lines."""

    def between(p: str, q: str) -> Vector:
        way = motion.position(q) - motion.position(p)
        return way[..., 0], way[..., 1]

    angles = []
    for group in transmitting(mechanism):
        if isinstance(group, RRR):
            first, second = (between(group.inner, outer) for outer in group.outer)
        elif isinstance(group, RRP):
            (x, y), second = _direction(motion, group.outer[1]), between(group.outer[0], group.inner)
            first = -y, x
        elif isinstance(group, RPR):
            (x, y), second = _direction(motion, group.inner), between(group.outer[1], group.outer[0])
            first = -y, x
        else:
            first, second = (_direction(motion, guide) for guide in group.prismatic)
        angles.append(np.arctan2(np.abs(cross(first, second)), dot(first, second)))
    return np.stack(angles, axis=-1) if angles else np.zeros((*motion.shape, 0))


def _direction(motion: Motion, guide: Guide) -> Vector:
    """Return the direction of a guide, from the angle of the body that carries it."""
    carried = np.zeros(motion.shape) if guide.on == FRAME else motion.wrapped_angle(guide.on)
    return unit(carried + motion.pose.size(guide.direction))
