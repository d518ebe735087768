"""Motion of many linkages of any dyads at once, measured between their points and lines.

Every figure of a design is the same whatever the other designs are. Extremes are refined between the positions.
"""

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from optlink.linkage.dyads import RPR, RRP, RRR, transmitting
from optlink.linkage.extrema import POINTS, Function, extremes_of_rows, refined_minima, refined_roots
from optlink.linkage.fourbar import InnerFourBar, whole_four_bar
from optlink.linkage.mechanism import FRAME, Guide, Mechanism
from optlink.linkage.motion import Motion, sweep
from optlink.linkage.stroke import travels
from optlink.linkage.vector2d import TURN, Array, Value, Vector, cross, dot, minus, unit
from optlink.validation.check import Checks, included_cosine, length_check, squared_sines

# Motion of many four-bars at once, measured between the positions of their joints; it takes a third of a `LinkageMotion`.
#
# Designs are worked on in blocks that fit the processor's cache; every figure of a design is the same in any block.

Index = NDArray[np.intp]

BLOCK = 40_000  # positions that are worked on at a time
ROUNDS = 60  # of the refinement of a dead centre
SPEEDUP = 1.5  # factor by which a step may exceed that at the speed of a joint: speeds change within a step
ROUNDING = 1e-9  # of the size: a step that is no jump


@dataclass(frozen=True)
class _Joints:
    """Vectors between the joints (designs, angles) [m]: A-B, B-C, D-C and B-D; `c`: the position of C.

    A and D are the pivots of crank and rocker, B and C the other ends of these links.
    """

    arm: Vector
    coupler: Vector
    rocker: Vector
    diagonal: Vector
    c: Vector

    @property
    def rate(self) -> Array:
        """Angular velocity of the rocker for a crank with 1 rad/s, from the velocities of B and C along the coupler."""
        with np.errstate(all="ignore"):
            return np.asarray(cross(self.arm, self.coupler) / cross(self.rocker, self.coupler))


@dataclass(frozen=True)
class _FourBarSurvey:
    """Figures of the motions, arrays (..., designs).

    `least`, `largest`: measured lengths of crank, coupler and rocker [m]; `mean`: the mean of both; `heights`: extremes of the
    height of C above B-D [m]; `fastest`, `longest`: of C, see `FourBarMotion`; `angle`, `cosine`: the position of the least and
    of the largest cosine of the transmission angle among all, and its value; `nodes`, `samples`: positions about these, and the
    values there.
    """

    least: Array
    largest: Array
    mean: Array
    heights: Array
    fastest: Array
    longest: Array
    angle: Array
    cosine: Array
    nodes: Array
    samples: Array


class _Designs:
    """Designs, each at its crank angles."""

    sizes: Mapping[str, Array]
    angles: Array
    count: int
    positions: int

    def _sizes(self, designs: slice | Index) -> dict[str, Array]:
        return {name: size[designs] for name, size in self.sizes.items()}

    def _blocks(self) -> Iterator[tuple[slice, Array]]:
        """Yield designs and their crank angles, so many that their positions fit the processor's cache."""
        size = max(1, BLOCK // self.positions)
        for first in range(0, self.count, size):
            part = slice(first, min(first + size, self.count))
            yield part, self.angles if self.angles.ndim == 1 else self.angles[part]


class FourBarMotion(_Designs):
    """Motion of four-bars over evenly spaced crank angles, (angles,) or (designs, angles) [rad].

    `loop`: the prescribed four-bar; `mechanism`: the one that is measured, with the same names of joints. The sizes are arrays
    (designs, 1) [m]; `size` [m], a number or (designs,), is the reference of rounding. `closed`: the angles are those of a
    revolution, the last one step before the first; otherwise `span` [rad], a number or (designs, 1), is the crank rotation from
    the first to the last.
    """

    def __init__(
        self,
        loop: InnerFourBar,
        mechanism: Mechanism,
        sizes: Mapping[str, Array],
        angles: Array,
        size: ArrayLike,
        *,
        closed: bool = False,
        span: Value = TURN,
    ) -> None:
        self.loop, self.mechanism, self.sizes, self.angles, self.closed = loop, mechanism, sizes, angles, closed
        self.size = np.asarray(size, dtype=float)
        self.count, self.positions = len(next(iter(sizes.values()))), angles.shape[-1]
        self.width = np.broadcast_to(np.ravel(span) / (self.positions - (not closed)), self.count)
        whole = closed or (np.ndim(span) == 0 and math.isclose(abs(span), TURN))
        self.period = self.positions - (not closed) if whole else None

    def _joints(self, angles: Array, designs: slice | Index) -> _Joints:
        sizes = self._sizes(designs)
        shape = np.broadcast_shapes(angles.shape, next(iter(sizes.values())).shape)
        with np.errstate(all="ignore"):
            pose = self.mechanism.at(sizes, angles)
            loop = self.loop
            a, b, c, d = map(pose.point, (loop.crank.start, loop.pin, loop.joint, loop.ground_pin))
            vectors = (minus(b, a), minus(c, b), minus(c, d), minus(d, b), c)
        full = [x if np.shape(x) == shape else np.broadcast_to(x, shape) for vector in vectors for x in vector]
        return _Joints(*zip(full[::2], full[1::2], strict=True))

    @cached_property
    def survey(self) -> _FourBarSurvey:
        """Figures of the motion of each design."""
        blocks = [vars(self._surveyed(part, self._joints(angles, part))) for part, angles in self._blocks()]
        return _FourBarSurvey(**{name: np.concatenate([block[name] for block in blocks], axis=-1) for name in blocks[0]})

    def _surveyed(self, part: slice, joints: _Joints) -> _FourBarSurvey:
        """Return the figures of a block of designs."""
        with np.errstate(all="ignore"):
            squares = dot(joints.diagonal, joints.diagonal)
            lengths = [dot(way, way) for way in (joints.arm, joints.coupler, joints.rocker)]  # squared: fewer roots
            across = cross(joints.coupler, joints.rocker)  # equal to that of B-D and the coupler
            height = across / np.sqrt(squares)
            speed = np.square(cross(joints.arm, joints.coupler) / across) * lengths[2]
            least, largest = (np.sqrt([extreme(length, axis=1) for length in lengths]) for extreme in (np.min, np.max))
            mean = 0.5 * (least + largest)
            x, y = joints.c
            step = x[:, 1:] - x[:, :-1], y[:, 1:] - y[:, :-1]
            longest = np.max(dot(step, step), axis=1)
            if self.closed:
                last = x[:, 0] - x[:, -1], y[:, 0] - y[:, -1]
                longest = np.maximum(longest, dot(last, last))
            angle, nodes, *samples = self._extremes_of_samples(squares, part)
            cosine, cosines = (included_cosine(mean[1], mean[2], square) for square in samples)
        heights, fastest = np.array([np.min(height, axis=1), np.max(height, axis=1)]), np.sqrt(np.max(speed, axis=1))
        return _FourBarSurvey(least, largest, mean, heights, fastest, np.sqrt(longest), angle, cosine, nodes, cosines)

    def _extremes_of_samples(self, values: Array, part: slice) -> tuple[Array, Array, Array, Array]:
        """Return angle and value (2, designs) of the largest and of the least sample, and those about it (points, 2, designs).

        In the order: angle, angles about it, value, values about it.
        """
        count, half = self.period or self.positions, POINTS // 2
        best = np.array([np.argmax(values[:, :count], axis=1), np.argmin(values[:, :count], axis=1)])
        row, around = np.arange(values.shape[0]), np.arange(-half, POINTS - half)[:, None, None]
        angle = self.angles[best] if self.angles.ndim == 1 else self.angles[part][row, best]
        if self.period is not None:
            samples = values[row, (best + around) % count]
        else:  # none beyond the ends
            around = around + np.clip(best, half, max(count - 1 - half, half)) - best
            samples = values[row, np.minimum(best + around, count - 1)]
            if count < POINTS:
                samples = np.full_like(samples, np.nan)
        return angle, angle + around * self.width[part], values[row, best], samples

    # --- figures by design ---------------------------------------------------------------------------------------------------

    def link_lengths(self, size: ArrayLike) -> Checks:
        """Check that crank, coupler and rocker keep their lengths in motion; `size` [m] is the reference."""
        links, survey = (self.loop.crank, self.loop.coupler, self.loop.rocker), self.survey
        nominal = (self.sizes[str(link.length)][:, 0] for link in links)
        return length_check(zip(survey.least, survey.largest, nominal, strict=True), size)

    @property
    def least_height(self) -> Array:
        """Least height of C on its side of the line B-D (designs,) [m]: negative on the other side, NaN if open."""
        least, largest = self.survey.heights
        return np.asarray(least if self.loop.side > 0 else -largest)

    @property
    def largest_jump(self) -> Array:
        """Longest step of C (designs,) as a multiple of 1.5 steps at its largest speed."""
        survey = self.survey
        return survey.longest / (SPEEDUP * survey.fastest * np.abs(self.width) + ROUNDING * self.size)

    @cached_property
    def _cosine_extremes(self) -> tuple[Array, Array]:
        """Crank angle [rad] and value (2, designs) of the least and of the largest cosine of the transmission angle."""
        survey, signs = self.survey, np.array([[1.0], [-1.0]])
        ends = np.sort(self.angles[..., [0, -1]], axis=-1) if self.period is None else np.array([-np.inf, np.inf])
        low, high = (np.clip(survey.angle + way * np.abs(self.width), ends[..., 0], ends[..., 1]).ravel() for way in (-1.0, 1.0))
        coupler, rocker = survey.mean[1:, :, None]

        def own(points: Array, which: Index) -> Array:
            designs = which % self.count
            diagonal = self._joints(points, designs).diagonal
            cosine = included_cosine(coupler[designs], rocker[designs], dot(diagonal, diagonal))
            return signs[which // self.count] * cosine

        values, samples = signs * survey.cosine, (signs * survey.samples).reshape(POINTS, -1).T
        some = np.flatnonzero(np.isfinite(values))
        best = (survey.angle.ravel(), values.ravel(), low, high)
        angle, value = refined_minima(own, best, some, survey.nodes.reshape(POINTS, -1).T[some], samples[some])
        return angle.reshape(2, -1), signs * value.reshape(2, -1)

    @property
    def least_squared_sines(self) -> Array:
        """Least squared sine of the angle between coupler and rocker (1, designs), negative or NaN where they do not meet."""
        return np.asarray(np.min(1.0 - np.square(self._cosine_extremes[1]), axis=0, keepdims=True))

    @property
    def transmission_extremes(self) -> tuple[Array, Array]:
        """Least and largest transmission angle (1, designs) [rad], each between the directions of the links in its position."""
        joints = self._joints(self._cosine_extremes[0].T, slice(None))
        with np.errstate(all="ignore"):
            sine, cosine = cross(joints.coupler, joints.rocker), dot(joints.coupler, joints.rocker)
        angle = np.where(np.isfinite(self.survey.mean[1])[:, None], np.abs(np.arctan2(sine, cosine)), np.nan)
        return angle[None, :, 1], angle[None, :, 0]

    @cached_property
    def dead_centres(self) -> tuple[Array, Array, Index]:
        """Crank and rocker angles (n,) [rad] at the sign changes of the rocker velocity, and the design (n,) of each."""
        crossings = []
        for part, angles in self._blocks():
            rate = self._joints(angles, part).rate
            after = np.roll(rate, -1, axis=1)
            row, place = np.nonzero((np.sign(rate) * np.sign(after) <= 0.0) & (rate != 0.0))
            crossings.append((row + part.start, self.angles[place], rate[row, place], after[row, place]))
        which, low, before, after = (np.concatenate(column) for column in zip(*crossings, strict=True))

        def own(angles: Array, brackets: Index) -> Array:
            return self._joints(angles[:, None], which[brackets]).rate[:, 0]

        at = refined_roots(own, low, low + self.width[which], before, after, ROUNDS)
        x, y = self._joints(at[:, None], which).rocker
        return at % TURN, np.arctan2(y, x)[:, 0], which

    def strokes(self, design: int, sense: float) -> tuple[float, float, float]:
        """Return the swing angle of the rocker and the crank rotation of its forward and backward strokes [rad].

        `sense`: sign of the rotation of the crank. The design has two dead centres.
        """
        phi, psi, which = self.dead_centres
        (phi_a, phi_b), (psi_a, psi_b) = (values[which == design].tolist() for values in (phi, psi))
        turned = math.copysign(1.0, sense) * (phi_b - phi_a) % TURN
        rest, rise = TURN - turned, math.remainder(psi_b - psi_a, TURN)  # a rocker swings by less than half a turn
        return abs(rise), *((turned, rest) if rise > 0.0 else (rest, turned))


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


class LinkageMotion(_Designs):
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
        self.links = tuple(link for link in linkage.links if link.end and link.length not in linkage.driven_sizes)

    @cached_property
    def survey(self) -> _Survey:
        """Figures of the motion of each design."""
        blocks = [self._surveyed(sweep(self.mechanism, self._sizes(part), angles), part) for part, angles in self._blocks()]
        return _Survey(*(np.concatenate(figures, axis=-1) for figures in zip(*blocks, strict=True)))

    @np.errstate(all="ignore")
    def _surveyed(self, motion: Motion, part: slice) -> tuple[Array, ...]:
        """Return the figures of a block of designs."""
        along = np.array([motion.distance(link.start, link.end) for link in self.links]).reshape(-1, *motion.shape)
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
        for part, angles in self._blocks() if kinds else ():
            sizes = self._sizes(part)
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
