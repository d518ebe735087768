"""Motion of many four-bars at once, measured between the positions of their joints; it takes a third of a `LinkageMotion`.

Designs are worked on in blocks that fit the processor's cache; every figure of a design is the same in any block.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from optlink.linkage.extrema import POINTS, refined_minima
from optlink.linkage.inner_four_bar import InnerFourBar
from optlink.linkage.mechanism import Mechanism
from optlink.linkage.vector2d import TURN, Array, Value, Vector, cross, dot, minus
from optlink.linkage.zeros import refined_roots
from optlink.validation.check import Checks, length_check
from optlink.validation.margins import included_cosine

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
class _Survey:
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


class FourBarMotion:
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
        sizes = {name: size[designs] for name, size in self.sizes.items()}
        shape = np.broadcast_shapes(angles.shape, next(iter(sizes.values())).shape)
        with np.errstate(all="ignore"):
            pose = self.mechanism.at(sizes, angles)
            loop = self.loop
            a, b, c, d = map(pose.point, (loop.crank.start, loop.pin, loop.joint, loop.ground_pin))
            vectors = (minus(b, a), minus(c, b), minus(c, d), minus(d, b), c)
        full = [x if np.shape(x) == shape else np.broadcast_to(x, shape) for vector in vectors for x in vector]
        return _Joints(*zip(full[::2], full[1::2], strict=True))

    def _blocks(self) -> Iterator[tuple[slice, _Joints]]:
        size = max(1, BLOCK // self.positions)
        for first in range(0, self.count, size):
            part = slice(first, min(first + size, self.count))
            yield part, self._joints(self.angles if self.angles.ndim == 1 else self.angles[part], part)

    @cached_property
    def survey(self) -> _Survey:
        """Figures of the motion of each design."""
        blocks = [vars(self._surveyed(part, joints)) for part, joints in self._blocks()]
        return _Survey(**{name: np.concatenate([block[name] for block in blocks], axis=-1) for name in blocks[0]})

    def _surveyed(self, part: slice, joints: _Joints) -> _Survey:
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
        return _Survey(least, largest, mean, heights, fastest, np.sqrt(longest), angle, cosine, nodes, cosines)

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
        return np.asarray(survey.longest / (SPEEDUP * survey.fastest * np.abs(self.width) + ROUNDING * self.size))

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
            return np.asarray(signs[which // self.count] * cosine)

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
        for part, joints in self._blocks():
            rate = joints.rate
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
