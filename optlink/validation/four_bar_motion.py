"""Motion of many four-bars at once, measured between the positions of their joints.

Designs are worked on in blocks that fit the processor's cache; every figure of a design is the same in any block.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from optlink.linkage.extrema import POINTS, refined_minima
from optlink.linkage.mechanism import Mechanism
from optlink.linkage.vector2d import TURN, Array, Vector, cross, dot, minus
from optlink.linkage.zeros import refined_roots
from optlink.validation.check import Checks, length_check
from optlink.validation.margins import included_cosine

Index = NDArray[np.intp]

BLOCK = 40_000  # positions that are worked on at a time
ROUNDS = 60  # of the refinement of a dead centre


@dataclass(frozen=True)
class _Joints:
    """Vectors between the joints (designs, angles) [m]: A-B, B-C, D-C and B-D; `c`: the position of C."""

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
    """Motion of four-bars with the joints A, B, C, D over evenly spaced crank angles, (angles,) or (designs, angles) [rad].

    The sizes are arrays (designs, 1) [m]. `closed`: the angles are those of a revolution, the last one step before the first;
    otherwise `span` [rad] is the crank rotation from the first to the last.
    """

    def __init__(
        self, mechanism: Mechanism, sizes: Mapping[str, Array], angles: Array, *, closed: bool = False, span: float = TURN
    ) -> None:
        self.mechanism, self.sizes, self.angles, self.closed = mechanism, sizes, angles, closed
        self.count, self.positions = len(next(iter(sizes.values()))), angles.shape[-1]
        self.width = span / (self.positions - (not closed))
        self.period = self.positions - (not closed) if closed or math.isclose(abs(span), TURN) else None

    @property
    def step(self) -> float:
        """Magnitude of the step of the crank angle [rad]."""
        return float(abs(self.width))

    def _joints(self, angles: Array, designs: slice | Index) -> _Joints:
        sizes = {name: size[designs] for name, size in self.sizes.items()}
        shape = np.broadcast_shapes(angles.shape, next(iter(sizes.values())).shape)
        with np.errstate(all="ignore"):
            pose = self.mechanism.at(sizes, angles)
            a, b, c, d = (pose.point(name) for name in "ABCD")
            vectors = (minus(b, a), minus(c, b), minus(c, d), minus(d, b), c)
            return _Joints(*((np.broadcast_to(x, shape), np.broadcast_to(y, shape)) for x, y in vectors))

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
        return angle, angle + around * self.width, values[row, best], samples

    # --- figures by design ---------------------------------------------------------------------------------------------------

    def link_lengths(self, lengths: Mapping[str, Array], size: Array) -> Checks:
        """Check that crank, coupler and rocker keep their lengths (designs,) [m] in motion; `size` [m] is the reference."""
        survey = self.survey
        named = zip(("crank", "coupler", "rocker"), survey.least, survey.largest, strict=True)
        return length_check(((least, largest, lengths[name]) for name, least, largest in named), size)

    def least_height(self, side: int) -> Array:
        """Return the least height of C on a side (+1: left) of the line B-D (designs,) [m]."""
        least, largest = self.survey.heights
        return np.asarray(least if side > 0 else -largest)

    @cached_property
    def _cosine_extremes(self) -> tuple[Array, Array]:
        """Crank angle [rad] and value (2, designs) of the least and of the largest cosine of the transmission angle."""
        survey, signs = self.survey, np.array([[1.0], [-1.0]])
        ends = np.sort(self.angles[..., [0, -1]], axis=-1) if self.period is None else np.array([-np.inf, np.inf])
        low, high = (np.clip(survey.angle + way * self.step, ends[..., 0], ends[..., 1]).ravel() for way in (-1.0, 1.0))
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
    def least_squared_sine(self) -> Array:
        """Least squared sine of the angle between coupler and rocker (designs,), negative or NaN where they do not meet."""
        return np.asarray(np.min(1.0 - np.square(self._cosine_extremes[1]), axis=0))

    @property
    def transmission_extremes(self) -> tuple[Array, Array]:
        """Least and largest transmission angle (designs,) [rad], each between the directions of the links in its position."""
        joints = self._joints(self._cosine_extremes[0].T, slice(None))
        with np.errstate(all="ignore"):
            sine, cosine = cross(joints.coupler, joints.rocker), dot(joints.coupler, joints.rocker)
        angle = np.where(np.isfinite(self.survey.mean[1])[:, None], np.abs(np.arctan2(sine, cosine)), np.nan)
        return angle[:, 1], angle[:, 0]

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

        at = refined_roots(own, low, low + self.width, before, after, ROUNDS)
        x, y = self._joints(at[:, None], which).rocker
        return at % TURN, np.arctan2(y, x)[:, 0], which
