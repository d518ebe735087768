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
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from optlink.linkage.fourbar import cosine_ranges
from optlink.linkage.vector2d import TURN, Array

POSES = 5
TRIALS = 6  # pencils of different linear forms that are solved while roots are missing or clustered
REAL, NEARLY_REAL = 1e-9, 1e-5  # imaginary parts of normalised coordinates: of a real root, and of one that may be real
INFINITE = 1e-9  # homogeneous coordinate, relative to the others and the largest displacement, that counts as zero
SAME = 1e-9  # distance of normalised roots that are one root
SPECIAL = 1e-10  # relative size of coefficients that vanish for special poses
RESIDUAL = 1e-10  # largest residual of a root, relative to the sizes of its terms
ROUNDING = Fraction(1, 2**51)  # relative uncertainty of the coefficients, which the certificate allows for

REPEATED = "poses {} and {} are the same: the four different poses have infinitely many dyads"
TRANSLATED = "the body does not turn: each of its points describes the same curve, so a dyad fits all points or none"
ONE_CENTRE = "the body turns about one point in all poses: a pin there does it, and every dyad fits"
TRAMMEL = "infinitely many points of the body run on straight lines, as in an elliptic trammel: two of them are two sliders"
INVERTED = "infinitely many lines of the body pass through fixed points, as in an inverted elliptic trammel"
MANY = "the poses are in special positions: infinitely many dyads pass through them"

_PERMUTATIONS = np.zeros((3, 3, 3))
for _order in itertools.permutations(range(3)):
    _PERMUTATIONS[_order] = np.linalg.det(np.eye(3)[list(_order)])
_CUBIC = sorted({tuple(sorted(index)) for index in np.ndindex(3, 3, 3)})
_QUADRATIC = sorted({tuple(sorted(index)) for index in np.ndindex(3, 3)})
_PLACE = {index: _CUBIC.index(tuple(sorted(index))) for index in np.ndindex(3, 3, 3)}
_UNFOLD = np.array([[_PLACE[k, *pair] for pair in _QUADRATIC] for k in range(3)])  # x_k times each quadratic monomial
_AT_INFINITY = [k for k, index in enumerate(_CUBIC) if 2 not in index]

Complex = NDArray[np.complex128]


@dataclass(frozen=True)
class Dyad:
    """A point of the body and a pivot of the frame at constant distance in all poses, both homogeneous (3,), real.

    The point is given in the fixed plane, as it lies at the first pose; lengths in metres. `certified`: proven to be a
    real root of its equations, alone in its neighbourhood, for all coefficients within their rounding.
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
    rotation, tau = np.exp(1j * turn), 2j * np.sin(0.5 * turn) * np.exp(0.5j * turn)
    carried, far, turned = np.conj(d) * rotation, np.abs(d), np.abs(tau)
    q = np.array([[-tau.real, -tau.imag, carried.real], [tau.imag, -tau.real, -carried.imag], [-d.real, -d.imag, 0.5 * far**2]])
    bound = np.array([[turned, turned, far], [turned, turned, far], [far, far, 0.5 * far**2]])
    size = np.linalg.norm(q, axis=(0, 1))
    return np.moveaxis(q / size, 2, 0), np.moveaxis(bound / size, 2, 0)


def dyads(places: Sequence[complex] | Complex, angles: Sequence[float] | Array) -> FivePoses:
    """Return all dyads of five poses: positions x + iy [m] of a point of the body, and angles [rad] of the body."""
    z, turn = np.asarray(places, dtype=complex), np.asarray(angles, dtype=float)
    size = float(np.max(np.abs(z - z[0]))) or 1.0
    scaled = (z - z[0]) / size
    if sentence := special(scaled, turn):
        return FivePoses(special=sentence)
    q, bound = equations(scaled, turn)
    cubics, inverse = _minors(q), _minors(np.swapaxes(q, 1, 2))
    for part, sentence in ((cubics, TRAMMEL), (inverse, INVERTED)):
        if np.linalg.norm(part[:, _AT_INFINITY]) <= SPECIAL * np.linalg.norm(part):
            return FivePoses(special=sentence)
    if any(np.linalg.svd(part, compute_uv=False)[-1] <= SPECIAL * 1e-3 for part in (cubics, inverse)):
        return FivePoses(special=MANY)
    found: list[tuple[Complex, Complex]] = []
    for trial in range(TRIALS):
        for start in _roots(cubics, trial):
            for near in _starts(start):
                root = _refined(q, near)
                if root is not None and all(_distance(root, other) > SAME for other in found):
                    found.append(root)
        doubtful = any(REAL < _imaginary(root) <= NEARLY_REAL for root in found)
        if len(found) >= 4 and not doubtful:
            break
    if len(found) > 4:
        return FivePoses(special=MANY)
    real = []
    for point, pivot in found:
        if _imaginary((point, pivot)) <= REAL:
            proven = certified(q, bound, point.real, pivot.real)
            here, there = (np.array([part.real[0] * size, part.real[1] * size, part.real[2]]) for part in (point, pivot))
            shift = [z[0].real, z[0].imag]
            here[:2] += here[2] * np.array(shift)
            there[:2] += there[2] * np.array(shift)
            real.append(Dyad(here, there, proven, size))
    real.sort(key=lambda dyad: not dyad.certified)
    return FivePoses(tuple(real), sum(_imaginary(root) > REAL for root in found))


def special(places: Complex, angles: Array) -> str:
    """Return a sentence about poses that have infinitely many dyads at first sight; empty for others."""
    for i, j in itertools.combinations(range(len(places)), 2):
        if abs(places[i] - places[j]) <= SPECIAL and abs(math.remainder(angles[i] - angles[j], TURN)) <= SPECIAL:
            return REPEATED.format(i + 1, j + 1)
    d, tau = places[1:] - places[0], np.exp(1j * (angles[1:] - angles[0])) - 1.0
    if np.max(np.abs(tau)) <= SPECIAL:
        return TRANSLATED
    centre = -np.vdot(tau, d) / np.vdot(tau, tau)
    return ONE_CENTRE if np.max(np.abs(d + centre * tau)) <= SPECIAL else ""


def _minors(q: Array) -> Array:
    """Return the coefficients (4, 10) of the 3 x 3 minors of the rows Q f, normalised."""
    rows = []
    for three in itertools.combinations(q, 3):
        tensor = np.einsum("xyz,xa,yb,zc->abc", _PERMUTATIONS, *three)
        row = np.zeros(len(_CUBIC))
        for index in np.ndindex(3, 3, 3):
            row[_PLACE[index]] += tensor[index]
        rows.append(row / max(float(np.linalg.norm(row)), 1e-300))
    return np.array(rows)


def _roots(cubics: Array, trial: int) -> Iterator[Complex]:
    """Yield the common zeros of the cubics without the circular points, as eigenvectors of a pencil of two linear forms."""
    null = np.linalg.svd(cubics)[2][4:].T  # (10, 6): values of the monomials at the zeros
    one, other = np.random.default_rng([trial, 6]).standard_normal((2, 3))
    left, right = (sum(form[k] * null[_UNFOLD[k]] for k in range(3)) for form in (one, other))
    try:
        vectors = np.linalg.eig(np.linalg.solve(right, left))[1]
    except np.linalg.LinAlgError:
        return
    for column in (null @ vectors).T:
        zero = np.linalg.svd(column[_UNFOLD])[0][:, 0]  # of rank one but for rounding
        zero = zero / zero[np.argmax(np.abs(zero))]
        if abs(zero[2]) > 1e-6 or abs(zero[0] ** 2 + zero[1] ** 2) > 1e-6:
            yield zero


def _starts(zero: Complex) -> Iterator[Complex]:
    """Yield a zero as a start, and the two real ones about it if it may be a pair of real ones that rounding has joined."""
    yield zero
    if REAL < float(np.max(np.abs(zero.imag))) <= NEARLY_REAL:
        yield np.asarray(zero.real + zero.imag, dtype=complex)
        yield np.asarray(zero.real - zero.imag, dtype=complex)


def _refined(q: Array, pivot: Complex) -> tuple[Complex, Complex] | None:
    """Return point and pivot at the end of Newton steps, normalised to the largest coordinate; None if they lead to none."""
    point = np.conj(np.linalg.svd(q @ pivot)[2][-1])
    pivot = pivot.copy()
    for _ in range(8):
        point, pivot = point / point[np.argmax(np.abs(point))], pivot / pivot[np.argmax(np.abs(pivot))]
        jacobian, free = _jacobian(q, point, pivot)
        try:
            step = np.linalg.solve(jacobian, -np.einsum("i,kij,j->k", point, q, pivot))
        except np.linalg.LinAlgError:
            return None
        point[free[0]] += step[:2]
        pivot[free[1]] += step[2:]
    sizes = np.einsum("i,kij,j->k", np.abs(point), np.abs(q), np.abs(pivot))
    residual = np.max(np.abs(np.einsum("i,kij,j->k", point, q, pivot)) / sizes)
    circular = abs(pivot[2]) <= 1e-7 and abs(pivot[0] ** 2 + pivot[1] ** 2) <= 1e-7
    if not residual <= RESIDUAL or circular:
        return None
    return point, pivot


def _jacobian(q: Array, point: Any, pivot: Any) -> tuple[Any, tuple[list[int], list[int]]]:
    """Return the derivatives (4, 4) by the coordinates that are not the largest ones, and the indices of these."""
    free = tuple([k for k in range(3) if k != int(np.argmax(np.abs(part)))] for part in (point, pivot))
    by_point, by_pivot = q @ pivot, np.einsum("i,kij->kj", point, q)
    return np.concatenate([by_point[:, free[0]], by_pivot[:, free[1]]], axis=1), (free[0], free[1])


def _imaginary(root: tuple[Complex, Complex]) -> float:
    return float(max(np.max(np.abs(part.imag)) for part in root))


def _distance(one: tuple[Complex, Complex], other: tuple[Complex, Complex]) -> float:
    """Return the largest sine of the angle between the vectors of two roots."""
    return max(
        math.sqrt(float(np.sum(np.abs(np.cross(a / np.linalg.norm(a), b / np.linalg.norm(b))) ** 2)))
        for a, b in zip(one, other, strict=True)
    )


def certified(q: Array, bound: Array, point: Array, pivot: Array) -> bool:
    """Return whether a real root is proven near a point and a pivot, by Krawczyk's condition in exact rational arithmetic.

    It holds for all matrices that differ from `q` by the rounding of their entries, of which `bound` are the sizes.
    """
    jacobian, (of_point, of_pivot) = _jacobian(q, point, pivot)
    inverse = np.linalg.inv(jacobian)
    if not np.all(np.isfinite(inverse)):
        return False
    exact = [[[Fraction(float(entry)) for entry in row] for row in one] for one in q]
    loose = [[[ROUNDING * Fraction(float(entry)) for entry in row] for row in one] for one in bound]
    x, y = ([Fraction(float(value)) for value in part] for part in (point, pivot))
    three, four = range(3), range(4)
    for _ in range(2):  # iterative refinement: residuals are exact
        residual = [float(_sum(x[i] * exact[k][i][j] * y[j] for i in three for j in three)) for k in four]
        step = inverse @ residual
        for k, index in enumerate(of_point):
            x[index] -= Fraction(float(step[k]))
        for k, index in enumerate(of_pivot):
            y[index] -= Fraction(float(step[2 + k]))
    z = [[Fraction(float(value)) for value in row] for row in inverse]
    slope = [
        [_sum(exact[k][i][j] * y[j] for j in three) for i in of_point]
        + [_sum(exact[k][i][j] * x[i] for i in three) for j in of_pivot]
        for k in four
    ]
    value = [_sum(x[i] * exact[k][i][j] * y[j] for i in three for j in three) for k in four]
    # bounds of what rounding of the coefficients, and a distance of one from the centre, change
    rounded = [_sum(abs(x[i]) * loose[k][i][j] * abs(y[j]) for i in three for j in three) for k in four]
    rounded_slope = [
        _sum(abs(y[j]) * loose[k][i][j] for i in of_point for j in three)
        + _sum(abs(x[i]) * loose[k][i][j] for i in three for j in of_pivot)
        for k in four
    ]
    bend = [2 * _sum(abs(exact[k][i][j]) + loose[k][i][j] for i in of_point for j in of_pivot) for k in four]
    off, shrink, curved = [], [], []
    for own, row in enumerate(z):
        off.append(abs(_sum(row[k] * value[k] for k in four)) + _sum(abs(row[k]) * rounded[k] for k in four))
        deviation = [_sum(row[k] * slope[k][m] for k in four) - (m == own) for m in four]
        shrink.append(_sum(abs(one) for one in deviation) + _sum(abs(row[k]) * rounded_slope[k] for k in four))
        curved.append(_sum(abs(row[k]) * bend[k] for k in four))
    radius = 2 * max(off) + Fraction(1, 2**200)
    return all(o + radius * (s + radius * c) < radius for o, s, c in zip(off, shrink, curved, strict=True))


def _sum(terms: Iterable[Fraction]) -> Fraction:
    return sum(terms, Fraction())


# --- linkages of two dyads, and their defects --------------------------------------------------------------------------------


def defects(
    places: Sequence[complex] | Complex, angles: Sequence[float] | Array, driver: Dyad, follower: Dyad
) -> tuple[str, ...]:
    """Return what keeps a linkage of two dyads from passing the poses in order while the driver turns: circuit, branch, order.

    The driver is a crank; the follower is of any kind. The crank angles at which the linkage closes are ranges of a cosine. A
    range without its ends is two circuits, one for each side of the follower; else it is one, on which the side changes
    at the ends only, where the crank stops.
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


def couplers(inputs: Array, outputs: Array, *, slides: bool = False) -> tuple[FivePoses, tuple[FourBarSolution, ...]]:
    """Return all four-bars whose output turns as prescribed while the crank turns: 1 or 3 real ones, some with infinite links.

    The crank pivot is the origin and the frame, of length 1, lies along x; both links may begin at any angle. By inversion,
    the output link as seen from the crank takes five poses, and its dyads are the coupler and the frame.

    Parameters
    ----------
    inputs, outputs : array (5,) [rad]
        Angles of the crank, and of the output or, if it `slides`, its coordinate [m] along x, from which the sizes follow.
    """
    phi = inputs - inputs[0]
    seen = np.exp(-1j * phi)
    turned = -phi if slides else outputs - outputs[0] - phi
    along = outputs - outputs[0] if slides else np.ones(len(phi))
    found = dyads(along * seen, turned)
    solutions = []
    for dyad in found.real:
        if dyad.kind != "RR" or (abs(complex(*dyad.pivot[:2])) <= 1e-7 * abs(dyad.pivot[2]) and not slides):
            continue
        pin, joint = (complex(*part[:2]) / part[2] for part in (dyad.pivot, dyad.point))
        driver = link(pin, 0j, 1.0)
        follower = link(joint, 1j if slides else 1.0 + 0j, 1.0, slides=slides)
        carried = joint + along - along[0] if slides else 1.0 + np.exp(1j * (outputs - outputs[0])) * (joint - 1.0)
        pins = pin * np.exp(1j * phi)
        solutions.append(FourBarSolution(driver, follower, pins, np.angle((carried - pins) / (joint - pin))))
    return found, tuple(solutions)


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
