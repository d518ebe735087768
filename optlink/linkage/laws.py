"""Motion laws: a position y over x (the time, or the angle of a cam), piece by piece, with all of its derivatives.

Every piece is one formula, y = sum_k c_k u^k + a sin(w u + p) + b (exp(g u) - 1) with u from 0 to 1 along the piece, so that
polynomials, the sinusoidal laws of cams, constant speeds, dwells, cubic splines and speeds that are linear in the angle are
numbers in one table, and their derivatives are exact.

References
----------
Norton, R. L.: Cam Design and Manufacturing Handbook. 2nd ed., 2009, chapters 2 to 4: the laws and their peak factors.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, ClassVar, NamedTuple, Self

import numpy as np

from optlink.linkage.jet import Jet
from optlink.linkage.vector2d import Array, Value, real

HALVINGS = 60  # of the distance of two samples between which an extremum lies
SMOOTH = 1e-9  # share of the largest size of a derivative below which a jump of it is rounding


class Extremes(NamedTuple):
    """Least and largest value of a function, and where it has them."""

    least: float
    least_at: float
    largest: float
    largest_at: float


@dataclass(frozen=True)
class MotionLaw:
    """Base class of all motion laws: y(x) from the first to the last of the rising `knots`, between which it is smooth.

    Beyond them it repeats, each time advanced by `advance` (for a crank that turns on; else 0), or rests at the values of
    its ends. x may be a number, an array, complex (with the analytic continuation of the piece at its real part), a symbol or a
    jet. At a knot the derivatives are those after it; at the two ends of a law that rests beyond them, those within.
    """

    knots: tuple[float, ...]
    advance: Value = 0.0
    repeats: bool = True

    samples: ClassVar[int] = 65
    """Values from knot to knot between which `extremes` expects one extremum at most."""

    def __post_init__(self) -> None:
        if len(self.knots) < 2 or not all(a < b for a, b in itertools.pairwise(self.knots)):
            raise ValueError("the knots of a motion law must rise")

    @property
    def begin(self) -> float:
        """The first knot."""
        return self.knots[0]

    @property
    def end(self) -> float:
        """The last knot."""
        return self.knots[-1]

    @property
    def period(self) -> float:
        """Distance from the first to the last knot, after which a law that repeats does so."""
        return self.end - self.begin

    def __call__(self, x: Value) -> Value:
        """Return y; a jet for a jet."""
        return self.derivative(x)

    def derivative(self, x: Value, order: int = 0) -> Value:
        """Return a derivative of y with respect to x; for a jet x that derivative as a jet."""
        if isinstance(x, Jet):
            y, first, second = (self.derivative(x.value, order + k) for k in range(3))
            return Jet(y, first * x.rate, first * x.acceleration + second * x.rate * x.rate)
        at = real(x)
        if self.repeats:
            turns = np.floor((at - self.begin) / self.period)
            y = self._inside(x - self.period * turns, order)
            return y if order or _zero(self.advance) else y + self.advance * turns
        inside, after = (at >= self.begin) * (at <= self.end), at > self.end
        y = self._inside(self.begin + inside * (x - self.begin) + after * self.period, order)
        return y * inside if order else y

    def extremes(self, order: int = 0) -> Extremes:
        """Return the extremes of a derivative, in a law that repeats those of one period; at a jump either side counts."""
        index, u = np.arange(len(self.knots) - 1)[:, None], np.linspace(0.0, 1.0, self.samples)
        values, slopes = self._local(index, u, order), self._local(index, u, order + 1)
        which, where = np.nonzero(slopes[:, :-1] * slopes[:, 1:] < 0.0)
        low, high, before = u[where], u[where + 1], slopes[which, where]
        for _ in range(HALVINGS):
            middle = 0.5 * (low + high)
            same = before * self._local(which, middle, order + 1) > 0.0
            low, high = np.where(same, middle, low), np.where(same, high, middle)
        knots = np.array(self.knots)
        at = np.concatenate([(knots[index] + u * np.diff(knots)[index]).ravel(), knots[which] + low * np.diff(knots)[which]])
        y = np.concatenate([values.ravel(), self._local(which, low, order)])
        least, largest = int(np.argmin(y)), int(np.argmax(y))
        return Extremes(float(y[least]), float(at[least]), float(y[largest]), float(at[largest]))

    def jump(self, order: int) -> tuple[float, float]:
        """Return the size of the largest jump of a derivative, and the knot where it is; size 0 if the derivative is continuous.

        The rest before and after a law that does not repeat counts.
        """
        index = np.arange(len(self.knots) - 1)
        after, before = (self._local(index, np.full(len(index), u), order) for u in (0.0, 1.0))
        advance = 0.0 if order else self.advance
        if self.repeats:
            first, last = before[-1] - advance, after[0] + advance
        else:
            first, last = (0.0, 0.0) if order else (after[0], before[-1])
        jumps = np.abs(np.append(after, last) - np.append(first, before))
        largest, extremes = int(np.argmax(jumps)), self.extremes(order)
        size = float(jumps[largest])
        return (size if size > SMOOTH * max(-extremes.least, extremes.largest) else 0.0), self.knots[largest]

    def scaled(self, factor: Value, offset: Value = 0.0) -> Self:
        """Return the law offset + factor * y(x)."""
        raise NotImplementedError

    def _inside(self, x: Value, order: int) -> Value:
        """Return a derivative at numbers or symbols between the first and the last knot."""
        raise NotImplementedError

    def _local(self, index: Any, u: Array, order: int) -> Array:
        """Return a derivative between the knots `index` and `index` + 1, at u from 0 to 1, with the limits at both ends."""
        raise NotImplementedError


@dataclass(frozen=True)
class Piece:
    """y = sum_k `coefficients`[k] u^k + `amplitude` sin(`frequency` u + `phase`) + `growth` (exp(`exponent` u) - 1).

    u goes from 0 to 1; angles in [rad].
    """

    coefficients: tuple[Value, ...]
    amplitude: Value = 0.0
    frequency: float = 0.0
    phase: float = 0.0
    growth: Value = 0.0
    exponent: float = 0.0

    def __call__(self, u: Value, order: int = 0) -> Value:
        """Return a derivative with respect to u."""
        y = 0.0 * u
        for power in range(len(self.coefficients) - 1, order - 1, -1):
            y = y * u + math.perm(power, order) * self.coefficients[power]
        if not _zero(self.amplitude):
            angle = self.frequency * u + (self.phase + order * math.pi / 2.0)
            y = y + self.amplitude * self.frequency**order * np.sin(angle)
        if not _zero(self.growth):
            power = np.exp(self.exponent * u) if order else np.expm1(self.exponent * u)
            y = y + self.growth * self.exponent**order * power
        return y

    def scaled(self, factor: Value, offset: Value) -> Piece:
        """Return the piece offset + factor * y(u)."""
        first, *others = (factor * coefficient for coefficient in self.coefficients)
        amplitude, growth = factor * self.amplitude, factor * self.growth
        return replace(self, coefficients=(first + offset, *others), amplitude=amplitude, growth=growth)


@dataclass(frozen=True)
class Law(MotionLaw):
    """A motion law of one piece from knot to knot. Coefficients and amplitudes of pieces may be any Values."""

    pieces: tuple[Piece, ...] = field(kw_only=True)

    def scaled(self, factor: Value, offset: Value = 0.0) -> Self:
        """Return the law offset + factor * y(x)."""
        pieces = tuple(piece.scaled(factor, offset) for piece in self.pieces)
        return replace(self, pieces=pieces, advance=factor * self.advance)

    def _inside(self, x: Value, order: int) -> Value:
        at = real(x)
        if self._table is not None and isinstance(x, float | int | complex | np.ndarray | np.generic):
            columns: Any = self._table[:, np.searchsorted(self.knots[1:-1], at, side="right")]
        else:
            begun = [1.0, *(1.0 * (at >= knot) for knot in self.knots[1:-1]), 0.0]
            here = [now - later for now, later in itertools.pairwise(begun)]  # 1 in the piece of x, 0 in all others
            columns = [
                sum((weight * value for weight, value in zip(here, column, strict=True) if not _zero(value)), 0.0)
                for column in zip(*self._rows, strict=True)
            ]
        return _on_piece(columns, (x - columns[0]) / columns[1], order)

    def _local(self, index: Any, u: Array, order: int) -> Array:
        assert self._table is not None, "only a law of numbers has extremes"
        result: Array = _on_piece(self._table[:, index], u, order)
        return result

    @cached_property
    def _rows(self) -> list[tuple[Value, ...]]:
        """The first knot, the width and the numbers of every piece."""
        terms = max(len(piece.coefficients) for piece in self.pieces)
        return [
            (
                a,
                b - a,
                piece.amplitude,
                piece.frequency,
                piece.phase,
                piece.growth,
                piece.exponent,
                *piece.coefficients,
                *[0.0] * (terms - len(piece.coefficients)),
            )
            for (a, b), piece in zip(itertools.pairwise(self.knots), self.pieces, strict=True)
        ]

    @cached_property
    def _table(self) -> Array | None:
        """The columns of the rows, where all of them are numbers."""
        numbers = all(isinstance(value, float | int) for row in self._rows for value in row)
        return np.array(self._rows, dtype=float).T if numbers else None


def _on_piece(columns: Any, u: Value, order: int) -> Value:
    _, width, *others = columns
    return Piece(tuple(others[5:]), *others[:5])(u, order) / width**order


def _zero(value: Value) -> bool:
    """Return whether a value is the number 0 (or an array of zeros), and no symbol."""
    return isinstance(value, float | int | np.ndarray) and not np.any(value)


# Segments: normalised laws from 0 to 1 while x goes from 0 to 1.


def accelerated(profile: Sequence[tuple[float, float, float]]) -> Law:
    """Return the law from 0 to 1, at rest at 0, whose acceleration is proportional to the sine of a phase.

    Each part of the `profile` has its share of the duration and the phases [rad] at its begin and end, linear between them: the
    acceleration is constant where both are equal. The motion ends at rest if the mean acceleration is zero.
    """
    knots, pieces, position, speed = [0.0], list[Piece](), 0.0, 0.0
    for share, begin, end in profile:
        frequency = end - begin
        if frequency:
            a = (share / frequency) ** 2
            start, slope = position + a * math.sin(begin), speed * share + a * frequency * math.cos(begin)
            pieces.append(Piece((start, slope), -a, frequency, begin))
        else:
            pieces.append(Piece((position, speed * share, 0.5 * share**2 * math.sin(begin))))
        position, speed = float(pieces[-1](1.0)), float(pieces[-1](1.0, 1)) / share
        knots.append(knots[-1] + share)
    return Law((*knots[:-1], 1.0), position, repeats=False, pieces=tuple(pieces)).scaled(1.0 / position)


def _polynomial(*coefficients: float) -> Law:
    return Law((0.0, 1.0), sum(coefficients), repeats=False, pieces=(Piece(coefficients),))


_QUARTER = math.pi / 2.0

SEGMENTS: dict[str, Law] = {
    "dwell": _polynomial(0.0),
    "constant": _polynomial(0.0, 1.0),
    "3-4-5": _polynomial(0.0, 0.0, 0.0, 10.0, -15.0, 6.0),
    "4-5-6-7": _polynomial(0.0, 0.0, 0.0, 0.0, 35.0, -84.0, 70.0, -20.0),
    "harmonic": accelerated([(1.0, _QUARTER, 3.0 * _QUARTER)]),
    "cycloidal": accelerated([(1.0, 0.0, 4.0 * _QUARTER)]),
    "trapezoidal": accelerated(
        [(1.0 / 3.0, _QUARTER, _QUARTER), (1.0 / 3.0, 0.0, 0.0), (1.0 / 3.0, 3.0 * _QUARTER, 3.0 * _QUARTER)]
    ),
    "modified sine": accelerated(
        [(0.125, 0.0, _QUARTER), (0.75, _QUARTER, 3.0 * _QUARTER), (0.125, 3.0 * _QUARTER, 4.0 * _QUARTER)]
    ),
    "modified trapezoidal": accelerated(
        [
            (0.125, 0.0, _QUARTER),
            (0.25, _QUARTER, _QUARTER),
            (0.25, _QUARTER, 3.0 * _QUARTER),
            (0.25, 3.0 * _QUARTER, 3.0 * _QUARTER),
            (0.125, 3.0 * _QUARTER, 4.0 * _QUARTER),
        ]
    ),
}
"""Laws of one motion by name, from 0 to 1 over a duration of 1; a dwell stays at 0."""


class Segment(NamedTuple):
    """A motion of a given duration `to` a value, by a law of `SEGMENTS`; a dwell stays where it is."""

    duration: float
    to: Value
    law: str


def joined(start: Value, segments: Iterable[Segment], *, begin: float = 0.0, repeats: bool = True) -> Law:
    """Return the law that goes from `start` through segments, one after the other; `advance` is the sum of their ways."""
    knots, pieces, value = [begin], list[Piece](), start
    for duration, to, name in segments:
        shape = SEGMENTS[name]
        way = to - value if shape.advance else 0.0
        knots += [knots[-1] + duration * knot for knot in shape.knots[1:]]
        pieces += [piece.scaled(way, value) for piece in shape.pieces]
        value = to if shape.advance else value
    return Law(tuple(knots), value - start, repeats, pieces=tuple(pieces))


def paced(angles: Sequence[float], speeds: Sequence[float]) -> Law:
    """Return the angle over the time of a crank whose speed is linear in its angle between rows of a table, all of one sign."""
    knots, pieces = [0.0], list[Piece]()
    for (a, b), (before, after) in zip(itertools.pairwise(angles), itertools.pairwise(speeds), strict=True):
        exponent = math.log(after / before)
        steady = abs(exponent) < 1e-12
        duration = (b - a) / before if steady else (b - a) / (after - before) * exponent
        pieces.append(Piece((a, b - a)) if steady else Piece((a,), growth=before * duration / exponent, exponent=exponent))
        knots.append(knots[-1] + duration)
    return Law(tuple(knots), angles[-1] - angles[0], pieces=tuple(pieces))


def spline(x: Sequence[float], y: Sequence[float], *, repeats: bool) -> Law:
    """Return the cubic spline through two or more points of rising x, with continuous first and second derivatives.

    They are continuous across the ends too if it repeats; else the spline is a single cubic over the first two and over the last
    two intervals ("not-a-knot"), the parabola through three points, or the line through two.
    """
    at, values = np.asarray(x, dtype=float), np.asarray(y, dtype=float)
    steps, ways = np.diff(at), np.diff(values)
    slopes = ways / steps
    if repeats:
        h, before = steps, np.roll(steps, 1)  # one equation for every point but the last, which is the first one
        bends = _cyclic(before, 2.0 * (before + h), h, 6.0 * (slopes - np.roll(slopes, 1)))
        bends = np.append(bends, bends[0])
    elif len(at) < 4:
        bends = np.full(len(at), 2.0 * (slopes[-1] - slopes[0]) / (at[-1] - at[0]))
    else:
        before, h = steps[:-1].copy(), steps[1:].copy()
        diagonal = 2.0 * (before + h)
        first, last = before[0] / h[0], h[-1] / before[-1]
        diagonal[0] += before[0] * (1.0 + first)
        diagonal[-1] += h[-1] * (1.0 + last)
        before[-1] -= h[-1] * last
        h[0] -= before[0] * first
        inner = _tridiagonal(before, diagonal, h, 6.0 * np.diff(slopes))
        ends = inner[0] + first * (inner[0] - inner[1]), inner[-1] + last * (inner[-1] - inner[-2])
        bends = np.concatenate([ends[:1], inner, ends[1:]])
    square = steps * steps / 6.0
    rows = values[:-1], ways - square * (2.0 * bends[:-1] + bends[1:]), 3.0 * square * bends[:-1], square * np.diff(bends)
    pieces = tuple(Piece(tuple(row)) for row in np.transpose(rows).tolist())
    return Law(tuple(at.tolist()), float(values[-1] - values[0]), repeats, pieces=pieces)


def _tridiagonal(below: Array, diagonal: Array, above: Array, right: Array) -> Array:
    """Solve diagonally dominant equations with three diagonals (n,); the ends of `below` and `above` outside are not used."""
    factors, result = above.copy(), right.copy()
    factors[0], result[0] = above[0] / diagonal[0], right[0] / diagonal[0]
    for row in range(1, len(right)):
        pivot = diagonal[row] - below[row] * factors[row - 1]
        factors[row], result[row] = above[row] / pivot, (right[row] - below[row] * result[row - 1]) / pivot
    for row in range(len(right) - 2, -1, -1):
        result[row] -= factors[row] * result[row + 1]
    return result


def _cyclic(below: Array, diagonal: Array, above: Array, right: Array) -> Array:
    """Solve the same equations where the first of `below` and the last of `above` are the corners, by Sherman and Morrison."""
    if len(right) < 3:  # two corners fall on the other diagonals
        whole = np.diag(diagonal)
        for row in range(len(right)):
            whole[row, row - 1] += below[row]
            whole[row, (row + 1) % len(right)] += above[row]
        return np.asarray(np.linalg.solve(whole, right), dtype=float)
    first, last = -diagonal[0], above[-1]  # the matrix is a tridiagonal one plus (first, 0, ..., last) (1, 0, ..., share)
    share, changed, column = below[0] / first, diagonal.copy(), np.zeros(len(right))
    changed[0] -= first
    changed[-1] -= last * share
    column[0], column[-1] = first, last
    one, other = (_tridiagonal(below, changed, above, side) for side in (right, column))
    part = float((one[0] + share * one[-1]) / (1.0 + other[0] + share * other[-1]))
    return one - other * part
