"""All dyads that carry a body through five poses, certified, and the defects of the linkages that they form.

A dyad joins a point of the body to a pivot of the frame by a link of constant length. With the point (x, y, w) and the pivot
(a, b, v) in homogeneous coordinates each displacement is one bilinear equation, in which v = 0 is a slider (the point runs on a
straight line) and w = 0 an inverted slider (a line of the body passes through the pivot): the three kinds are one problem.

References
----------
L. Burmester, Lehrbuch der Kinematik (1888).
J. M. McCarthy and G. S. Soh, Geometric Design of Linkages, 2nd ed. (2011), chapter 5.
R. Krawczyk, Computing 4 (1969) 187-201 (the certificate).
"""

import itertools
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from decimal import Context, Decimal, Inexact, InvalidOperation, localcontext
from typing import Any

import numpy as np
from numpy.typing import NDArray

from optlink.linkage.fourbar import cosine_ranges
from optlink.linkage.vector2d import TURN, Array
from optlink.synthesis.decimal_algebra import (
    Matrix,
    characteristic_polynomial,
    cos_sin,
    divided,
    null_space,
    precise,
    real_roots,
)

POSES = 5
INFINITE = 1e-9  # homogeneous coordinate, relative to the others and the largest displacement, that counts as zero
SAME = 1e-9  # distance over which Newton steps may correct a root that is certified
SPECIAL = 1e-10  # relative size of quantities that vanish for special poses
DOUBTFUL = 1e-6  # last pivot of the minors below which the poses may be special within their rounding
VANISHING = Decimal("1e-14")  # last pivot of the equations of a point, relative to the first one, below which it is a line
ROUNDING = 2.0**-51  # relative uncertainty of coefficients in doubles
EXACT = Decimal("1e-60")  # that of coefficients in decimals for the numbers as given
MAX_DIGITS = 4000  # of products in exact arithmetic, which have some hundreds

REPEATED = "poses {} and {} are the same: the four different poses have infinitely many dyads"
TRANSLATED = "the body does not turn: each of its points describes the same curve, so a dyad fits all points or none"
ONE_CENTRE = "the body turns about one point in all poses: a pin there does it, and every dyad fits"
TRAMMEL = "infinitely many points of the body run on straight lines, as in an elliptic trammel: two of them are two sliders"
INVERTED = "infinitely many lines of the body pass through fixed points, as in an inverted elliptic trammel"
NO_CIRCLE = "the body turns in pose {} only: no link leads through the others, as they lie neither on a circle nor on a line"
CIRCLE = "the body turns in pose {} only, and the others lie on a circle or a line: infinitely many links lead through them"
FOUR_CENTRE = "in all poses but {} the body turns about one point: infinitely many links join that point to the frame"
TWO_ANGLES = "the body has only two different angles, which is not supported: change one angle by 0.001 deg"
GROUPS = "the body turns about one point within each of two groups of poses: infinitely many links join that point to the frame"
MANY = "the poses are in special positions: infinitely many dyads pass through them"

_PERMUTATIONS = [(order, round(float(np.linalg.det(np.eye(3)[list(order)])))) for order in itertools.permutations(range(3))]
_CUBIC = sorted({tuple(sorted(index)) for index in np.ndindex(3, 3, 3)})
_QUADRATIC = sorted({tuple(sorted(index)) for index in np.ndindex(3, 3)})
_PLACE = {index: _CUBIC.index(tuple(sorted(index))) for index in np.ndindex(3, 3, 3)}
_UNFOLD = [[_PLACE[k, *pair] for pair in _QUADRATIC] for k in range(3)]  # x_k times each quadratic monomial

Complex = NDArray[np.complex128]


@dataclass(frozen=True)
class Dyad:
    """A point of the body and a pivot of the frame at constant distance in all poses, both homogeneous (3,), real.

    The point is given in the fixed plane, as it lies at the first pose; lengths in metres. `certified`: proven to be a
    real root of the equations of the poses as given, alone in its neighbourhood.
    """

    point: Array
    pivot: Array
    certified: bool
    size: float

    @property
    def slider(self) -> bool:
        """Whether the point runs on a straight line, of which the pivot is the normal."""
        return bool(abs(self.pivot[2]) * self.size <= INFINITE * float(np.hypot(*self.pivot[:2])))

    @property
    def inverted(self) -> bool:
        """Whether a line of the body passes through the pivot; the point is its normal."""
        return bool(abs(self.point[2]) * self.size <= INFINITE * float(np.hypot(*self.point[:2])))

    @property
    def kind(self) -> str:
        """Joints from the frame to the body: "RR", "PR" with a slider, "RP" with an inverted one."""
        return "PR" if self.slider else "RP" if self.inverted else "RR"


@dataclass(frozen=True)
class FivePoses:
    """The dyads of five poses. `real`: certified ones first; `complex`: number of roots that are no dyads; `special`: a sentence
    about poses with infinitely many dyads, of which none is listed; `uncertain`: number of roots that were not separated.
    """

    real: tuple[Dyad, ...] = ()
    complex: int = 0
    special: str = ""

    @property
    def uncertain(self) -> int:
        """Number of the four roots that are neither certified nor complex."""
        return 0 if self.special else 4 - self.complex - sum(dyad.certified for dyad in self.real)


def equations(places: Complex, angles: Array) -> tuple[Array, Array]:
    """Return the matrices (poses - 1, 3, 3) of the bilinear equations point @ Q @ pivot = 0, and bounds of their entries."""
    d, turn = places[1:] - places[0], angles[1:] - angles[0]
    tau = 2j * np.sin(0.5 * turn) * np.exp(0.5j * turn)
    q = np.moveaxis(np.array(_matrix(d.real, d.imag, tau.real, tau.imag)), 2, 0)
    far, turned = np.abs(d), np.abs(tau)
    bound = np.moveaxis(np.array([[turned, turned, far], [turned, turned, far], [far, far, 0.5 * far**2]]), 2, 0)
    size = np.linalg.norm(q, axis=(1, 2))[:, None, None]
    return q / size, bound / size


def _matrix(x: Any, y: Any, tau_x: Any, tau_y: Any) -> list[list[Any]]:
    """Return Q of a displacement (x, y) with tau = rotation - 1, in doubles or decimals."""
    c = tau_x + 1
    return [[-tau_x, -tau_y, x * c + y * tau_y], [tau_y, -tau_x, y * c - x * tau_y], [-x, -y, (x * x + y * y) / 2]]


def _decimals(places: Complex, angles: Array, size: float) -> list[Matrix]:
    """Return the matrices of the equations in decimals, for the numbers as given; lengths in units of `size`."""
    matrices, (c0, s0) = [], cos_sin(float(angles[0]))
    for d, angle in zip((places[1:] - places[0]).tolist(), angles[1:].tolist(), strict=True):
        c, s = cos_sin(angle)
        x, y = Decimal(d.real) / Decimal(size), Decimal(d.imag) / Decimal(size)
        matrices.append(_matrix(x, y, c * c0 + s * s0 - 1, s * c0 - c * s0))
    return matrices


def dyads(places: Sequence[complex] | Complex, angles: Sequence[float] | Array) -> FivePoses:
    """Return all dyads of five poses: positions x + iy [m] of a point of the body, and angles [rad] of the body.

    All is computed in 80 digits, so that dyads that nearly coincide are separated.
    """
    z, turn = np.asarray(places, dtype=complex), np.asarray(angles, dtype=float)
    size = float(np.max(np.abs(z - z[0]))) or 1.0
    scaled = (z - z[0]) / size
    if sentence := special(scaled, turn) or _special_five(scaled, turn):
        return FivePoses(special=sentence)
    with precise():
        q = _decimals(z, turn, size)
        null, pivot = null_space(_minors(q), 4)
        if pivot < DOUBTFUL and _within_rounding(q, z, turn, size, pivot):
            return FivePoses(special=MANY)
        roots, other = _roots(null)
        bound = [[[Decimal(float(entry)) for entry in row] for row in one] for one in equations(scaled, turn)[1]]
        real = []
        for root, order in roots:
            point, depth = _point(q, root)
            if depth <= VANISHING:
                return FivePoses(special=GROUPS)
            pair = point, root
            if max(abs(part[2]) for part in pair) <= INFINITE:  # of two sliders, between which the body would not turn
                other += order
                continue
            proven = order == 1 and certified(q, bound, *pair, rounding=EXACT)
            here, there = (np.array([float(entry) for entry in part]) * [size, size, 1.0] for part in pair)
            for part in (here, there):
                part[:2] += part[2] * np.array([z[0].real, z[0].imag])
            real.append(Dyad(here, there, proven, size))
    real.sort(key=lambda dyad: not dyad.certified)
    return FivePoses(tuple(real), other)


def special(places: Complex, angles: Array) -> str:
    """Return a sentence about poses that have infinitely many dyads at first sight; empty for others."""
    for i, j in itertools.combinations(range(len(places)), 2):
        if abs(places[i] - places[j]) <= SPECIAL and abs(math.remainder(angles[i] - angles[j], TURN)) <= SPECIAL:
            return REPEATED.format(i + 1, j + 1)
    d, tau = places[1:] - places[0], np.exp(1j * (angles[1:] - angles[0])) - 1.0
    if np.max(np.abs(tau)) <= SPECIAL:
        return TRANSLATED
    centre = -np.vdot(tau, d) / np.vdot(tau, tau)
    return ONE_CENTRE if np.max(np.abs(d + centre * tau)) <= SPECIAL * max(1.0, abs(centre)) * np.max(np.abs(tau)) else ""


def _special_five(places: Complex, angles: Array) -> str:
    """Return a sentence about five poses of which four are special, or all are those of a trammel; empty for others.

    Points that run on straight lines solve Re(tau p + d q) = 0, with four real unknowns p, q; a trammel has two solutions.
    """
    for k in range(POSES):
        four = np.delete(places, k)
        sentence = special(four, np.delete(angles, k))
        if sentence == TRANSLATED:
            ratio = (four[0] - four[2]) * (four[1] - four[3]) / ((four[0] - four[3]) * (four[1] - four[2]))
            return (CIRCLE if abs(ratio.imag) <= SPECIAL * abs(ratio) else NO_CIRCLE).format(k + 1)
        if sentence == ONE_CENTRE:
            return FOUR_CENTRE.format(k + 1)
    d, tau = places[1:] - places[0], np.exp(1j * (angles[1:] - angles[0])) - 1.0
    turned = tau[np.argmax(np.abs(tau))]
    if np.all(np.minimum(np.abs(tau), np.abs(tau - turned)) <= SPECIAL):
        return TWO_ANGLES
    for one, other, sentence in ((tau, d, TRAMMEL), (np.conj(tau), np.conj(tau + 1.0) * d, INVERTED)):
        columns = np.array([one.real, one.imag, other.real, other.imag])
        columns = columns / np.maximum(np.max(np.abs(columns), axis=1), 1e-300)[:, None]
        if np.linalg.svd(columns, compute_uv=False)[2] <= SPECIAL:
            return sentence
    return ""


def _within_rounding(q: list[Matrix], places: Complex, angles: Array, size: float, pivot: Decimal) -> bool:
    """Return whether the last pivot of the minors is as large as rounding of the poses changes it."""
    if not pivot:
        return True
    noise = np.random.default_rng(5).uniform(-ROUNDING, ROUNDING, (3, len(places)))
    moved = _decimals(places + size * (noise[0] + 1j * noise[1]), angles + noise[2], size)
    return 4 * abs(null_space(_minors(moved), 4)[1] - pivot) > pivot


def _minors(q: list[Matrix]) -> Matrix:
    """Return the coefficients (4, 10) of the 3 x 3 minors of the rows Q f, the largest of each 1."""
    rows = []
    for three in itertools.combinations(q, 3):
        row = [Decimal(0)] * len(_CUBIC)
        for order, sign in _PERMUTATIONS:
            for a, b, c in itertools.product(range(3), repeat=3):
                row[_PLACE[a, b, c]] += sign * three[0][order[0]][a] * three[1][order[1]][b] * three[2][order[2]][c]
        largest = max(map(abs, row)) or Decimal(1)
        rows.append([entry / largest for entry in row])
    return rows


def _roots(null: Matrix) -> tuple[list[tuple[list[Decimal], int]], int]:
    """Return the real common zeros of the cubics with their multiplicity, and the number of others without the circular points.

    `null`: 6 vectors that span the values of the cubic monomials at the zeros. For two linear forms in the coordinates these
    values give a pencil of matrices, whose eigenvalues are the ratios of the forms at the zeros.
    """
    one, other = ([Decimal(float(x)) for x in form] for form in np.random.default_rng(6).standard_normal((2, 3)))
    left, right = (
        [[sum((form[k] * vector[_UNFOLD[k][m]] for k in range(3)), Decimal(0)) for vector in null] for m in range(6)]
        for form in (one, other)
    )
    columns, _ = null_space([b + [-entry for entry in a] for a, b in zip(left, right, strict=True)], 6, 6)
    matrix = [[column[k] for column in columns] for k in range(6)]
    square = other[0] ** 2 + other[1] ** 2
    circular = [Decimal(1), -2 * (one[0] * other[0] + one[1] * other[1]) / square, (one[0] ** 2 + one[1] ** 2) / square]
    polynomial, complete = characteristic_polynomial(matrix), True
    while complete and len(polynomial) > 2:
        quotient, complete = divided(polynomial, circular)
        polynomial = quotient if complete else polynomial
    zeros = []
    for ratio, order in real_roots(polynomial):
        pencil = [[entry - ratio * (k == m) for m, entry in enumerate(row)] for k, row in enumerate(matrix)]
        (weights,), _ = null_space(pencil, 5)
        values = [sum((w * vector[k] for w, vector in zip(weights, null, strict=True)), Decimal(0)) for k in range(len(_CUBIC))]
        rows = [[values[_UNFOLD[k][m]] for k in range(3)] for m in range(6)]  # all proportional to the zero
        zeros.append((_largest_one(max(rows, key=lambda row: max(map(abs, row)))), order))
    return zeros, 4 - sum(order for _, order in zeros)


def _point(q: list[Matrix], pivot: list[Decimal]) -> tuple[list[Decimal], Decimal]:
    """Return the point that belongs to a pivot, its largest coordinate 1, and a number that is 0 for a line of them."""
    rows = [[sum((a * b for a, b in zip(row, pivot, strict=True)), Decimal(0)) for row in one] for one in q]
    (point, *_), last = null_space(rows, 2)
    return _largest_one(point), abs(last)


def _largest_one(vector: list[Decimal]) -> list[Decimal]:
    largest = max(vector, key=abs)
    return [entry / largest for entry in vector]


def certified(q: Any, bound: Any, point: Any, pivot: Any, *, rounding: Decimal = Decimal(ROUNDING)) -> bool:
    """Return whether a real root is proven near a point and a pivot, by Krawczyk's condition in exact arithmetic.

    It holds for all matrices that differ from `q` by `rounding`, relative to the sizes `bound` of their entries.
    """
    exact, loose = ([[[Decimal(entry) for entry in row] for row in one] for one in each] for each in (q, bound))
    x, y = ([Decimal(entry) for entry in part] for part in (point, pivot))
    of_point, of_pivot = ([k for k in range(3) if k != max(range(3), key=lambda k: abs(part[k]))] for part in (x, y))
    three, four = range(3), range(4)

    def value() -> list[Decimal]:
        return [_sum(x[i] * exact[k][i][j] * y[j] for i in three for j in three) for k in four]

    def slope() -> Matrix:
        return [
            [_sum(exact[k][i][j] * y[j] for j in three) for i in of_point]
            + [_sum(exact[k][i][j] * x[i] for i in three) for j in of_pivot]
            for k in four
        ]

    begin = x + y
    with precise():
        for _ in range(3):  # Newton steps, and the inverse at their end
            columns, _ = null_space([row + [-Decimal(int(k == m)) for m in four] for k, row in enumerate(slope())], 4, 4)
            if len(columns) > 4:
                return False
            z = [[column[k] for column in columns] for k in four]
            step = [_sum(a * b for a, b in zip(row, value(), strict=True)) for row in z]
            for part, free, change in ((x, of_point, step[:2]), (y, of_pivot, step[2:])):
                for index, shift in zip(free, change, strict=True):
                    part[index] -= shift
    if max(abs(after - before) for after, before in zip(x + y, begin, strict=True)) > SAME:
        return False
    with localcontext(Context(prec=MAX_DIGITS, traps=[Inexact, InvalidOperation])):  # exact, or an exception
        # bounds of what rounding of the coefficients, and a distance of one from the centre, change
        rounded = [rounding * _sum(abs(x[i]) * loose[k][i][j] * abs(y[j]) for i in three for j in three) for k in four]
        rounded_slope = [
            rounding
            * (
                _sum(abs(y[j]) * loose[k][i][j] for i in of_point for j in three)
                + _sum(abs(x[i]) * loose[k][i][j] for i in three for j in of_pivot)
            )
            for k in four
        ]
        bend = [2 * _sum(abs(exact[k][i][j]) + rounding * loose[k][i][j] for i in of_point for j in of_pivot) for k in four]
        values, slopes = value(), slope()
        off, shrink, curved = [], [], []
        for own, row in enumerate(z):
            off.append(abs(_sum(row[k] * values[k] for k in four)) + _sum(abs(row[k]) * rounded[k] for k in four))
            deviation = [_sum(row[k] * slopes[k][m] for k in four) - (m == own) for m in four]
            shrink.append(_sum(abs(one) for one in deviation) + _sum(abs(row[k]) * rounded_slope[k] for k in four))
            curved.append(_sum(abs(row[k]) * bend[k] for k in four))
        radius = 2 * max(off) + EXACT
        return all(o + radius * (s + radius * c) < radius for o, s, c in zip(off, shrink, curved, strict=True))


def _sum(terms: Iterable[Decimal]) -> Decimal:
    return sum(terms, Decimal(0))


# --- linkages of two dyads, and their defects --------------------------------------------------------------------------------


def defects(
    places: Sequence[complex] | Complex, angles: Sequence[float] | Array, driver: Dyad, follower: Dyad
) -> tuple[str, ...]:
    """Return what keeps a linkage of two dyads from passing the poses in order while the driver turns: circuit, branch, order.

    The driver is a crank, the follower of any kind. The crank angles at which the linkage closes are ranges of a cosine. A range
    without its ends is two circuits, one for each side of the follower; else it is one, on which the side changes at the ends
    only, where the crank stops.
    """
    z, turn = np.asarray(places, dtype=complex), np.asarray(angles, dtype=float)
    rotation = np.exp(1j * (turn - turn[0]))
    pivot, begin = (complex(*part[:2]) / part[2] for part in (driver.pivot, driver.point))
    pin = z + rotation * (begin - z[0])
    crank = abs(begin - pivot)
    if follower.slider:
        normal = complex(*follower.pivot[:2])
        normal /= abs(normal)
        end = complex(*follower.point[:2]) / follower.point[2]
        carried = z + rotation * (end - z[0])
        axis, length = normal, abs(end - begin)
        level = float(np.mean((carried * normal.conjugate()).real)) - (pivot * normal.conjugate()).real
        lowest, highest = (level - length) / crank, (level + length) / crank
        sides = ((carried - pin) * normal.conjugate()).imag
    else:
        fixed = complex(*follower.pivot[:2]) / follower.pivot[2]
        frame, axis = abs(fixed - pivot), fixed - pivot
        mean, half = crank**2 + frame**2, 2.0 * crank * frame
        if follower.inverted:
            normal = complex(*follower.point[:2])
            across = rotation * normal / abs(normal)
            lowest, highest = -2.0, (mean - float(np.mean(((fixed - pin) * across.conjugate()).real)) ** 2) / half
            sides = ((fixed - pin) * across.conjugate()).imag
        else:
            end = complex(*follower.point[:2]) / follower.point[2]
            carried = z + rotation * (end - z[0])
            coupler, rocker = abs(end - begin), abs(end - fixed)
            lowest, highest = (mean - (coupler + rocker) ** 2) / half, (mean - (coupler - rocker) ** 2) / half
            sides = ((carried - pin) * np.conj(carried - fixed)).imag
    phi = np.angle((pin - pivot) / axis)
    return tuple(_defects(phi, sides > 0.0, cosine_ranges(lowest, highest)))


def _defects(phi: Array, sides: NDArray[np.bool_], ranges: Sequence[tuple[float, float]]) -> Iterator[str]:
    """Yield the defects of positions at crank angles and on sides of the follower, for the ranges of the crank."""
    full = any(high - low >= TURN * (1.0 - 1e-15) for low, high in ranges)
    one_side = bool(np.all(sides == sides[0]))
    if full:
        if not one_side:
            yield "circuit"
        if not any(float(np.sum(np.mod(way * np.diff(phi), TURN))) <= TURN for way in (1.0, -1.0)):
            yield "order"
        return
    inside = []
    for low, high in ranges:
        middle = 0.5 * (low + high)
        centred = np.mod(phi - middle + np.pi, TURN) - np.pi
        inside.append((float(np.max(np.abs(centred))) - 0.5 * (high - low), centred))
    beyond, centred = min(inside, key=lambda one: one[0], default=(math.inf, phi))
    if beyond > 1e-6:
        yield "circuit"
        return
    if not one_side:
        yield "branch"
    steps = np.diff(centred)
    if not (np.all(steps > 0.0) or np.all(steps < 0.0)):
        yield "order"


# --- functions and timed paths as five poses ---------------------------------------------------------------------------------


@dataclass(frozen=True)
class FourBarSolution:
    """A four-bar, or a slider-crank: the dyads of its crank and its follower, and the poses of its coupler (points [m], rad)."""

    crank: Dyad
    follower: Dyad
    places: Complex
    angles: Array

    @property
    def defects(self) -> tuple[str, ...]:
        """What keeps it from passing all positions in order; see `defects`."""
        return defects(self.places, self.angles, self.crank, self.follower)


def link(point: complex, pivot: complex, size: float, *, slides: bool = False) -> Dyad:
    """Return a dyad of given joints; `slides`: the pivot is the direction of the normal of a straight line."""
    begin, end = ([z.real, z.imag, 1.0 - k * slides] for k, z in enumerate((point, pivot)))
    return Dyad(np.array(begin), np.array(end), True, size)


def seen_from_crank(inputs: Array, outputs: Array, *, slides: bool) -> tuple[Complex, Array]:
    """Return places and angles of the output link as seen from the crank; see `couplers`."""
    phi, rise = inputs - inputs[0], outputs - outputs[0]
    return (rise if slides else np.ones(len(phi))) * np.exp(-1j * phi), -phi if slides else rise - phi


def couplers(inputs: Array, outputs: Array, *, slides: bool = False) -> tuple[FivePoses, tuple[FourBarSolution, ...]]:
    """Return all four-bars whose output turns as prescribed while the crank turns: 1 or 3 real ones, some with infinite links.

    The crank pivot is the origin and the frame, of length 1, lies along x; both links may begin at any angle. By inversion,
    the output link as seen from the crank takes five poses, and its dyads are the coupler and the frame.

    Parameters
    ----------
    inputs, outputs : array (5,) [rad]
        Angles of the crank, and of the output or, if it `slides`, its coordinate [m] along x, from which the sizes follow.
    """
    found = dyads(*seen_from_crank(inputs, outputs, slides=slides))
    solutions = []
    for dyad in found.real:
        if dyad.kind != "RR" or (abs(complex(*dyad.pivot[:2])) <= 1e-7 * abs(dyad.pivot[2]) and not slides):
            continue
        solutions.append(moved(dyad, inputs, outputs, slides=slides))
    return found, tuple(solutions)


def moved(coupler: Dyad, inputs: Array, outputs: Array, *, slides: bool) -> FourBarSolution:
    """Return the linkage of a coupler, a dyad from the crank to the output as these begin, at all positions; see `couplers`."""
    rise = outputs - outputs[0]
    pin, joint = (complex(*part[:2]) / part[2] for part in (coupler.pivot, coupler.point))
    driver, follower = link(pin, 0j, 1.0), link(joint, 1j if slides else 1.0 + 0j, 1.0, slides=slides)
    carried = joint + rise if slides else 1.0 + np.exp(1j * rise) * (joint - 1.0)
    pins = pin * np.exp(1j * (inputs - inputs[0]))
    return FourBarSolution(driver, follower, pins, np.angle((carried - pins) / (joint - pin)))


def timed_paths(places: Sequence[complex] | Complex, inputs: Array) -> tuple[FivePoses, tuple[FourBarSolution, ...]]:
    """Return all four-bars that pass five points [m] at given crank rotations [rad]: up to four cranks, each with three partners.

    A body that turns with the crank takes five poses at the points; the point of it that lies a crank length behind keeps its
    distance, that of the point from the crank pin, from the crank pivot. The rotations of the coupler follow, and its dyads.
    """
    z, phi = np.asarray(places, dtype=complex), np.asarray(inputs, dtype=float) - inputs[0]
    first = dyads(z, phi)
    solutions = []
    for dyad in first.real:
        if dyad.kind != "RR":
            continue
        pivot, corner = (complex(*part[:2]) / part[2] for part in (dyad.pivot, dyad.point))
        crank = z[0] - corner
        pins = pivot + crank * np.exp(1j * phi)
        if min(abs(crank), abs(z[0] - pins[0])) <= INFINITE * dyad.size:
            continue
        angles = np.angle((z - pins) / (z[0] - pins[0]))
        driver = link(pins[0], pivot, dyad.size)
        for partner in dyads(z, angles).real:
            if partner.kind == "RR" and abs(complex(*partner.point[:2]) / partner.point[2] - pins[0]) > 1e-6 * dyad.size:
                solutions.append(FourBarSolution(driver, partner, z, angles))
    return first, tuple(solutions)
