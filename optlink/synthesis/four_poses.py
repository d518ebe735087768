"""The dyads that carry a body through four poses: the curves of their points and pivots, and the four-bars of two of them.

The pivots lie on a cubic, the centre-point curve, which passes through all poles. A line through one pole meets it in two more
points, which follow from a quadratic equation: turning the line traces the whole curve, ovals and points at infinity included.

References
----------
L. Burmester, Lehrbuch der Kinematik (1888).
J. M. McCarthy and G. S. Soh, Geometric Design of Linkages, 2nd ed. (2011), chapter 5.
"""

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial

import numpy as np
from numpy.typing import NDArray

from optlink.linkage.vector2d import TURN, Array
from optlink.synthesis.five_poses import INFINITE, SPECIAL, Complex, FourBarSolution, equations, link, special

Part = Callable[[Array], tuple[Array, Array]]  # points and pivots (n, 3) of unit length at places 0 ... 1 of a closed curve

POSES = 4
SAMPLES = 512  # points of each closed curve
ROUNDS = 3  # times that they are spaced evenly again
ON_CIRCLE = 1e-6  # deviation of a root of the discriminant from the unit circle up to which its angle is real
DEFECTS = ("", "circuit", "branch", "order", "no four-bar")
"""What keeps a four-bar from passing the poses, by number."""

ANY = "a given {} lies at a pole, about which the body turns from one pose to another: infinitely many dyads have it"
AT_POLE = "a given {} lies at the pole of poses {} and {}, so that its dyads have a line of other ends"
NEAR_POLE = (
    "a given {} lies near the pole of poses {} and {}: errors of the poses move the other end of its dyad {:.1g} times as far"
)
CLOSER = 12  # times that a row is sought between its neighbours, each time 16 times as closely
AT = 1e-9  # distance from a pole, in units of the displacement, that is rounding
NEAR = 1e-3  # one below which the dyad depends on the last digits of the poses
FARTHEST = 10.0  # largest distance of points along the line of two poses, by the larger one of their displacement and of `reach`
ONE_POLE = 1e-5  # spread of the poles of three poses, by the largest displacement or their distance, up to which they are one
BENT = 1e-2  # of `_Sheets.bend`, below which another pole may be used than that of the largest rotation
REPEATED = "poses {} and {} are the same: three poses have a dyad for each point of the body"
CENTRE_OF_THREE = (
    "in all poses but {} the body turns about one point: each dyad has its pivot or its point there, so that two of them are no"
    " four-bar, or one that is folded at these poses"
)
LINE_OF_THREE = "in all poses but {} the body moves along a line without turning: no link of finite length leads through them"
NEARLY = "the poses nearly are special ones, whose curves of dyads are not traced: change one angle by 0.001 deg"


@dataclass(frozen=True, eq=False)
class DyadCurves:
    """The dyads of four poses, in order along their curves.

    `points`: points of the body (n, 2) [m] in the fixed plane at the first pose (circle-point curve), and `pivots` of the frame
    at constant distance from them (centre-point curve); NaN between closed curves, and where one of both lies at infinity.
    `homogeneous`: the same without a gap at infinity, (n, 3) each, of unit length, with the unit `size` [m] about `places[0]`.
    `poles` (k, 2) [m]: where the body turns from one pose to another. `special`: a sentence about poses that have no such
    curves, `note` about such as nearly have none. `places` x + iy [m] and `angles` [rad] are the poses; `trace` computes dyads
    between rows.
    """

    places: Complex
    angles: Array
    size: float
    homogeneous: tuple[Array, Array] = (np.empty((0, 3)), np.empty((0, 3)))
    poles: Array = field(default_factory=lambda: np.empty((0, 2)))
    special: str = ""
    note: str = ""
    _trace: "_Trace | None" = field(default=None, repr=False)

    @cached_property
    def dyads(self) -> tuple[Complex, Complex]:
        """Points and pivots as complex numbers."""
        return self._placed(self.homogeneous)

    def between(self, rows: Array) -> tuple[Complex, Complex]:
        """Return points and pivots at rows (n,) that need not be whole numbers: of the curves themselves, not of their chords."""
        if self._trace is not None:
            return self._placed(self._trace(rows))
        if self.special:
            return np.full(len(rows), np.nan + 0j), np.full(len(rows), np.nan + 0j)
        low = np.clip(np.floor(rows).astype(int), 0, len(self.homogeneous[0]) - 1)  # of a line
        high, share = np.minimum(low + 1, len(self.homogeneous[0]) - 1), (rows - low)[:, None]
        one, other = ((1.0 - share) * part[low] + share * part[high] for part in self.homogeneous)
        return self._placed((one, other))

    def row_of(self, point: complex, pivot: complex) -> float:
        """Return the row, between whole ones too, of the dyad that is nearest to given joints.

        Parameters
        ----------
        point, pivot : complex [m]
            Point of the body at the first pose, and pivot of the frame.
        """
        rows, step = np.arange(float(len(self.points))), 1.0
        for _ in range(CLOSER):
            points, pivots = self.between(rows)
            row = float(rows[np.nanargmin(np.abs(points - point) + np.abs(pivots - pivot))])
            rows, step = row + step * np.linspace(-1.0, 1.0, 33), step / 16.0
        return row

    def _placed(self, homogeneous: tuple[Array, Array]) -> tuple[Complex, Complex]:
        found = []
        for part in homogeneous:
            x, y, w = np.where(np.abs(part[:, 2:]) > INFINITE, part, np.nan).T
            found.append(self.places[0] + self.size * ((x / w) + 1j * (y / w)))
        missing = np.isnan(found[0]) | np.isnan(found[1])
        points, pivots = (np.where(missing, np.nan + 0j, part) for part in found)
        return points, pivots

    @property
    def points(self) -> Array:
        """Points of the body (n, 2) [m]."""
        return np.stack([self.dyads[0].real, self.dyads[0].imag], axis=1)

    @property
    def pivots(self) -> Array:
        """Pivots of the frame (n, 2) [m]."""
        return np.stack([self.dyads[1].real, self.dyads[1].imag], axis=1)

    @property
    def count(self) -> int:
        """Number of closed curves, each of which may pass through infinity."""
        return int(np.sum(np.isnan(self.homogeneous[0][:, 0])))

    @cached_property
    def in_order(self) -> NDArray[np.bool_]:
        """Whether the crank of each dyad passes the poses in order within a turn (n,): such a dyad may be the driver."""
        points, pivots = self.dyads
        return _in_order(np.angle(_carried(self.places, self.angles, points) - pivots[:, None]))

    def partners(self, drivers: Sequence[int] | NDArray[np.int64], followers: slice | NDArray[np.int64] = slice(None)) -> "Pairs":
        """Return the four-bars of each driver as the crank with each follower.

        Parameters
        ----------
        drivers, followers : integers
            Rows of the curves; by default all are followers.
        """
        points, pivots = self.dyads
        return pairs(self.places, self.angles, (points[drivers], pivots[drivers]), (points[followers], pivots[followers]))


@dataclass(frozen=True, eq=False)
class Pairs:
    """Four-bars of dyads, arrays (drivers, followers).

    `defect`: number of the first of their defects, 0 none, 1 circuit, 2 branch, 3 order, 4 a link without length or of infinite
    length; `turns`: whether the crank turns fully; `transmission`: least distance [rad] of the transmission angle from 0 and 180
    deg at the poses, and `around`, over a revolution (0 if the crank does not turn).
    """

    defect: NDArray[np.int8]
    turns: NDArray[np.bool_]
    transmission: Array
    around: Array


def curves(places: Sequence[complex] | Complex, angles: Sequence[float] | Array, samples: int = SAMPLES) -> DyadCurves:
    """Return the dyads of four poses: positions x + iy [m] of a point of the body, and angles [rad] of the body."""
    z, turn = np.asarray(places, dtype=complex), np.asarray(angles, dtype=float)
    size = float(np.max(np.abs(z - z[0]))) or 1.0
    scaled = (z - z[0]) / size
    for i, j in itertools.combinations(range(POSES), 2):
        if abs(scaled[i] - scaled[j]) <= SPECIAL and abs(math.remainder(turn[i] - turn[j], TURN)) <= SPECIAL:
            return DyadCurves(z, turn, size, special=REPEATED.format(i + 1, j + 1))
    if sentence := special(scaled, turn) or _special_three(scaled, turn):
        return DyadCurves(z, turn, size, special=sentence)
    poles, sines = _poles(scaled, turn)
    q = equations(scaled, turn)[0]
    lines = [np.linalg.svd(q @ pole) for pole in poles[:3]]  # the pole of two poses may be that of the two others
    shared = [k for k in range(3) if min(sines[k], sines[-1 - k]) > SPECIAL and lines[k][1][1] <= SPECIAL * lines[k][1][0]]
    each = (_Sheets(q, poles[k], float(sines[k])) for k in [*shared, *np.argsort(-np.round(sines, 9), kind="stable")])
    sheets = next(each)
    if sheets.bend < BENT:
        sheets = max([sheets, *each], key=lambda one: round(one.bend, 9))  # of mirror images the first
    parts: list[Part] = [partial(sheets.dyads, *ends) for ends in sheets.intervals]
    parts += [partial(_points_of_pole, poles[k], lines[k][2][1:]) for k in shared]
    if sheets.bend <= SPECIAL:
        parts.append(sheets.tangent_line)
    if not parts:
        return DyadCurves(z, turn, size, special=NEARLY)
    trace = _Trace([(part, _spaced(part, samples)) for part in parts])
    finite = poles[sines > SPECIAL, :2]
    every = trace(np.arange(len(parts) * (samples + 1.0)))
    return DyadCurves(z, turn, size, every, [z[0].real, z[0].imag] + size * finite, _trace=trace)


def _special_three(places: Complex, angles: Array) -> str:
    """Return a sentence about three poses that have a pole in common, which may lie at infinity; empty for others."""
    for k in range(POSES):
        first, *others = np.delete(places, k)
        begin, *ends = np.delete(angles, k)
        d, tau = np.array(others) - first, np.exp(1j * (np.array(ends) - begin)) - 1.0
        turned = np.max(np.abs(tau))
        if turned > SPECIAL:
            centre = -np.vdot(tau, d) / np.vdot(tau, tau)
            if np.max(np.abs(d + centre * tau)) <= ONE_POLE * max(1.0, abs(centre)) * turned:
                return CENTRE_OF_THREE.format(k + 1)
        elif abs((d[1] * np.conj(d[0])).imag) <= SPECIAL:
            return LINE_OF_THREE.format(k + 1)
    return ""


def dyads_of_joint(places: Complex, angles: Array, joint: complex, *, fixed: bool, reach: float = 0.0) -> DyadCurves:
    """Return the dyad of three poses, or those of two along a line, with a given joint at the first pose.

    At the pole of two of three poses the joint has one place in the other frame at both: these count once.

    Parameters
    ----------
    joint : complex [m]
        Pivot of the frame if `fixed`, whose points of the body are sought; else a point of the body, whose pivots are.
    reach : float [m]
        Size of the linkage, which that of the displacements need not be.
    """
    size = float(np.max(np.abs(places - places[0]))) or 1.0
    z = (joint - places[0]) / size
    given = np.array([z.real, z.imag, 1.0])
    q = equations((places - places[0]) / size, angles)[0]
    rows = q @ given if fixed else given @ q
    turns = np.exp(1j * (angles - angles[0]))
    seen = (joint - places) / turns if fixed else places + turns * (joint - places[0])
    apart, i, j = min((abs(seen[i] - seen[j]) / size, i, j) for i, j in itertools.combinations(range(len(places)), 2))
    name, note = "pivot" if fixed else "point", ""
    if len(rows) > 1 and apart > AT:
        found = np.cross(rows[0], rows[1])[None, :]
        note = NEAR_POLE.format(name, i + 1, j + 1, 1.0 / apart) if apart < NEAR else ""
    else:
        found = _along(rows[int(np.argmax(np.linalg.norm(rows, axis=1)))], FARTHEST * max(1.0, reach / size))
        note = AT_POLE.format(name, i + 1, j + 1) if len(rows) > 1 else ""
    lengths = np.linalg.norm(found, axis=1)[:, None]
    if not np.all(lengths > SPECIAL):
        return DyadCurves(places, angles, size, special=ANY.format(name))
    found, given = found / lengths, np.repeat(given[None, :] / np.linalg.norm(given), len(found), axis=0)
    return DyadCurves(places, angles, size, (found, given) if fixed else (given, found), note=note)


def _along(row: Array, far: float) -> Array:
    """Return points (n, 3) of the line row @ x = 0 to a distance on both sides, the denser the nearer to the origin."""
    square = float(row[:2] @ row[:2])
    foot, along = -row[2] * row[:2] / (square or 1.0), np.array([-row[1], row[0]]) / (math.sqrt(square) or 1.0)
    places = foot + np.sinh(np.linspace(-1.0, 1.0, SAMPLES) * np.arcsinh(far))[:, None] * along
    return np.column_stack([places, np.ones(SAMPLES)]) * (square > SPECIAL**2)


def _poles(scaled: Complex, turn: Array) -> tuple[Array, Array]:
    """Return the poles (6, 3) of all pairs of poses, and sines of half their rotations, zero for a pole at infinity."""
    one, other = np.array(list(itertools.combinations(range(POSES), 2))).T
    half = 0.5 * (turn[other] - turn[one])
    sine = np.sin(half)
    apart = 0.5 * (scaled[other] - scaled[one])
    across = 1j * apart * np.cos(half)  # the pole lies on the perpendicular bisector
    pole = 0.5 * (scaled[one] + scaled[other]) + across / np.where(np.abs(sine) > SPECIAL, sine, 1.0)
    return np.stack([pole.real, pole.imag, np.ones(len(pole))], axis=1), np.abs(sine)


class _Sheets:
    """The two points besides the pole in which lines through it meet the centre-point curve.

    On the line pole + r (cos t, sin t) the determinant of the equations is r (c + b r + a r^2).
    """

    def __init__(self, q: Array, pole: Array, sine: float) -> None:
        self.q, self.pole, self.sine, self.rows = q, pole, sine, q @ pole
        # the discriminant is a polynomial of degree 2 in exp(2it), given by its values at five angles
        angles = np.linspace(0.0, np.pi, 5, endpoint=False)
        c, b, a = self.coefficients(angles)
        series = np.fft.fft(b * b - 4.0 * a * c) / 5.0
        self.scale = float(np.max(np.abs([a, b, c])))
        roots = np.roots(series[[2, 1, 0, 4, 3]])
        real = roots[np.abs(np.abs(roots) - 1.0) <= ON_CIRCLE]
        self.ends = np.sort(np.mod(0.5 * np.angle(real), np.pi))
        slope = complex(c @ np.exp(1j * angles)) * 0.4  # c is that of a cosine
        self.slope, self.tangents = abs(slope), np.array([math.atan2(-slope.real, slope.imag)])
        self.twice = self.slope <= SPECIAL * self.scale  # the curve passes the pole twice: c is zero, and b along both tangents
        if self.twice:
            self.tangents = 0.5 * np.angle(np.roots(np.fft.fft(b)[[1, 0, 4]]))

    @cached_property
    def bend(self) -> float:
        """How much the curve leaves its tangents at the pole: 0 if one is a part of it, or if it nearly passes the pole twice."""
        _, b, a = self.coefficients(self.tangents)
        least = float(np.min(np.hypot(a, b), initial=self.scale)) / max(self.scale, SPECIAL)
        return float(least > BENT**2) if self.twice else self.sine * min(self.slope / max(self.scale, SPECIAL), least)

    def coefficients(self, angles: Array) -> tuple[Array, Array, Array]:
        """Return c, b and a at angles (n,) of the line."""
        turned = np.stack([np.cos(angles), np.sin(angles), np.zeros_like(angles)], axis=-1) @ np.swapaxes(self.q, 1, 2)
        (a0, a1, a2), (b0, b1, b2) = self.rows, turned
        one = b0 @ np.cross(a1, a2) + b1 @ np.cross(a2, a0) + b2 @ np.cross(a0, a1)
        two = np.cross(b1, b2) @ a0 + np.cross(b2, b0) @ a1 + np.cross(b0, b1) @ a2
        return one, two, np.sum(b0 * np.cross(b1, b2), axis=-1)

    @property
    def intervals(self) -> list[tuple[float, float, float]]:
        """Ends of the angle, and the sheet: 0 for both, which join at the ends, else +1 or -1."""
        if self.twice:
            return [(0.0, math.pi, 1.0)]
        if not len(self.ends):
            return [(0.0, math.pi, 1.0), (0.0, math.pi, -1.0)]
        ranges = []
        for low, high in itertools.pairwise([*self.ends, self.ends[0] + math.pi]):
            c, b, a = self.coefficients(np.linspace(low, high, 9)[1:-1])
            if np.median(b * b - 4.0 * a * c) > 0.0 and high - low > ON_CIRCLE:
                ranges.append((float(low), float(high), 0.0))
        return ranges

    def dyads(self, low: float, high: float, sheet: float, along: Array) -> tuple[Array, Array]:
        """Return points and pivots (n, 3) of unit length at places 0 ... 1 along a closed curve."""
        sign, angles = np.full(len(along), sheet), low + (high - low) * along
        if sheet == 0.0:  # there and back: the square root of the discriminant is analytic in this parameter
            sign = np.where(along <= 0.5, 1.0, -1.0)
            angles = 0.5 * (low + high) - 0.5 * (high - low) * np.cos(TURN * along)
        c, b, a = self.coefficients(angles)
        root = sign * np.sqrt(np.maximum(b * b - 4.0 * a * c, 0.0))
        first = -b * sign >= 0.0  # of two equal forms the one without cancellation
        of_pole, of_line = np.where(first, 2.0 * a, -b - root), np.where(first, root - b, 2.0 * c)
        if self.twice:
            of_pole, of_line = a, -b
        direction = np.stack([np.cos(angles), np.sin(angles), np.zeros_like(angles)], axis=-1)
        return self.with_points(of_pole[:, None] * self.pole + of_line[:, None] * direction)

    def tangent_line(self, along: Array) -> tuple[Array, Array]:
        """Return the dyads of the tangent at the pole, if it is a part of the curve, as `dyads` does."""
        return self.with_points(
            _on_line(np.array([self.pole, [math.cos(self.tangents[0]), math.sin(self.tangents[0]), 0.0]]), along)
        )

    def with_points(self, pivots: Array) -> tuple[Array, Array]:
        """Return the points of pivots (n, 3), and these, all of unit length."""
        with np.errstate(invalid="ignore"):  # of three lines, where two of them meet
            pivots = pivots / np.linalg.norm(pivots, axis=1)[:, None]
        rows = np.einsum("kij,nj->nki", self.q, pivots)
        crossed = np.cross(rows, np.roll(rows, -1, axis=1))  # the best of three: two rows may be parallel at a pole
        best = np.argmax(np.linalg.norm(crossed, axis=2), axis=1)
        points = crossed[np.arange(len(best)), best]
        return points / np.linalg.norm(points, axis=1)[:, None], pivots


def _on_line(two: Array, along: Array) -> Array:
    """Return points (n, 3) at places 0 ... 1 of the line through two (2, 3)."""
    return np.stack([np.cos(np.pi * along), np.sin(np.pi * along)], axis=1) @ two


def _points_of_pole(pole: Array, two: Array, along: Array) -> tuple[Array, Array]:
    """Return the dyads of one pivot, whose points lie on a line through two (2, 3), as `_Sheets.dyads` does."""
    return _on_line(two, along), np.repeat(pole[None, :] / np.linalg.norm(pole), len(along), axis=0)


def _spaced(dyads: Part, samples: int) -> Array:
    """Return places along a closed curve, evenly spaced for points and pivots together on the sphere of unit vectors."""
    along = np.linspace(0.0, 1.0, samples)
    for _ in range(ROUNDS):
        chords = np.zeros(len(along) - 1)
        for one in dyads(along):
            chords += np.linalg.norm(np.cross(one[1:], one[:-1]), axis=1)
        length = np.concatenate([[0.0], np.cumsum(chords + 1e-3 * np.mean(chords))])
        along = np.interp(np.linspace(0.0, length[-1], samples), length, along)
    return along


@dataclass(frozen=True)
class _Trace:
    """Closed curves one after another with a gap behind each: their dyads, and places of the rows along them."""

    parts: Sequence[tuple[Part, Array]]

    def __call__(self, rows: Array) -> tuple[Array, Array]:
        """Return points and pivots (n, 3) at rows, whole or not; NaN at gaps."""
        found = np.full((2, len(rows), 3), np.nan)
        count = len(self.parts[0][1])
        part = np.floor(rows / (count + 1)).astype(int)
        for k, (dyads, along) in enumerate(self.parts):
            own = np.flatnonzero((part == k) & (rows - k * (count + 1) < count))
            found[:, own] = dyads(np.interp(rows[own] - k * (count + 1), np.arange(count), along))
        return found[0], found[1]


def _carried(places: Complex, angles: Array, points: Complex) -> Complex:
    """Return points of the body (...) at all poses (..., poses)."""
    return np.asarray(places + np.exp(1j * (angles - angles[0])) * (points[..., None] - places[0]))


def _in_order(phi: Array) -> NDArray[np.bool_]:
    """Return whether angles (..., poses) follow each other within a turn, in one of both senses."""
    ways = [np.sum(np.mod(way * np.diff(phi, axis=-1), TURN), axis=-1) <= TURN for way in (1.0, -1.0)]
    return np.asarray(ways[0] | ways[1])


def pairs(places: Complex, angles: Array, driver: tuple[Complex, Complex], follower: tuple[Complex, Complex]) -> Pairs:
    """Return what keeps the four-bars of drivers and followers, each points and pivots [m], from passing the poses in order."""
    return of_dyads(places, angles, driver, follower).pairs


def of_dyads(places: Complex, angles: Array, driver: tuple[Complex, Complex], follower: tuple[Complex, Complex]) -> "Positions":
    """Return the four-bars of drivers and followers, each points and pivots [m] (n,), at poses of their coupler."""
    (begin, pivot), (end, fixed) = ([part[:, None] for part in driver], [part[None, :] for part in follower])
    pin, joint = _carried(places, angles, begin), _carried(places, angles, end)
    return Positions(pin, joint, pivot, fixed, places, float(angles[0]))


@dataclass(frozen=True, eq=False)
class Positions:
    """Four-bars, or slider-cranks, (drivers, followers) at all positions, whose shapes broadcast.

    `pin`, `joint` (..., positions): ends of the coupler at crank and rocker [m]; `pivot`, `fixed`: those of the crank and of the
    rocker in the frame, of a slider (`slides`) the unit normal of its line. `places` (positions,): a point of the coupler, or
    None, whose body has the angle `begin` [rad] at the first one.
    """

    pin: Complex
    joint: Complex
    pivot: Complex
    fixed: Complex
    places: Complex | None = None
    begin: float = 0.0
    slides: bool = False

    def __getitem__(self, index: tuple[int, int]) -> FourBarSolution:
        shape = np.broadcast_shapes(self.pin.shape[:2], self.joint.shape[:2])
        pin, joint = (np.broadcast_to(part, (*shape, part.shape[2]))[index] for part in (self.pin, self.joint))
        pivot, fixed = (complex(np.broadcast_to(part, shape)[index]) for part in (self.pivot, self.fixed))
        places = pin if self.places is None else self.places
        angles = self.begin + np.angle((joint - pin) / (joint[0] - pin[0]))
        size = float(np.max(np.abs(places - places[0]))) or 1.0
        crank, follower = link(complex(pin[0]), pivot, size), link(complex(joint[0]), fixed, size, slides=self.slides)
        return FourBarSolution(crank, follower, places, angles)

    @property
    def lengths(self) -> tuple[Array, Array, Array, Array]:
        """Crank, coupler, rocker and frame [m]; the distance of the line of a slider from the crank pivot as rocker."""
        pin, joint = self.pin[..., 0], self.joint[..., 0]
        a, b, g = np.abs(pin - self.pivot), np.abs(joint - pin), np.abs(self.fixed - self.pivot)
        return a, b, ((joint - self.pivot) * np.conj(self.fixed)).real if self.slides else np.abs(joint - self.fixed), g

    @cached_property
    def sines(self) -> Array:
        """Sine of the angle from the rocker, or from the normal of the line of a slider, to the coupler (..., positions)."""
        fixed, coupler = np.asarray(self.fixed)[..., None], self.joint - self.pin
        arm = fixed if self.slides else self.joint - fixed
        with np.errstate(all="ignore"):
            return np.asarray((coupler * np.conj(arm)).imag / (np.abs(coupler) * np.abs(arm)))

    @property
    def side(self) -> Array:
        """Assembly mode at the first position: +1 if the joint lies to the left of the line from the pin to the rocker pivot, or
        forward of the pin along the line of a slider, else -1.
        """
        return np.where(self.sines[..., 0] < 0.0, 1, -1)

    @property
    def sense(self) -> Array:
        """Sense in which the crank passes the positions within a turn: +1 counter-clockwise, else -1."""
        turned = np.mod(np.diff(np.angle(self.pin - np.asarray(self.pivot)[..., None]), axis=-1), TURN)
        return np.where(np.sum(turned, axis=-1) <= TURN, 1, -1)

    @cached_property
    def pairs(self) -> Pairs:
        """What keeps them from passing the positions in order: the closed form of `optlink.synthesis.five_poses.defects`, for all
        at once; a defect hides those that come after it.
        """
        pin, sine = self.pin, self.sines
        a, b, c, g = self.lengths
        with np.errstate(all="ignore"):
            if self.slides:
                lowest, highest = (c - b) / a, (c + b) / a
                cosines = np.array([(c - a) / b, (c + a) / b])
            else:
                lowest, highest = ((a * a + g * g - (b + way * c) ** 2) / (2.0 * a * g) for way in (1.0, -1.0))
                cosines = np.array([(b * b + c * c - (g + way * a) ** 2) / (2.0 * b * c) for way in (1.0, -1.0)])
            axis = self.fixed if self.slides else self.fixed - self.pivot
            phi = np.angle((pin - np.asarray(self.pivot)[..., None]) / np.asarray(axis)[..., None])
        turns = (lowest <= -1.0) & (highest >= 1.0)
        two = (lowest > -1.0) & (highest < 1.0)  # ranges, one on each side of the frame line
        aside = (highest < 1.0) & ~two & ~turns  # one range about the angle pi
        centred = np.where(aside[..., None], np.mod(phi, TURN) - np.pi, phi)
        steps = np.diff(centred, axis=-1)
        along = np.all(steps > 0.0, axis=-1) | np.all(steps < 0.0, axis=-1)
        one_side = np.abs(np.sum(np.sign(sine), axis=-1)) == pin.shape[-1]
        apart = two & (np.abs(np.sum(np.sign(phi), axis=-1)) != pin.shape[-1])
        circuit, order = np.where(turns, ~one_side, apart), np.where(turns, ~_in_order(phi), ~along)
        measured = pin if self.places is None else self.places
        size = float(np.nanmax(np.abs(measured - measured[..., :1]))) or 1.0
        least = np.minimum(a, b) if self.slides else np.minimum(np.minimum(a, b), np.minimum(c, g))
        none = ~(least > 1e-6 * size)  # also NaN
        defect = np.select([none, circuit, ~one_side, order], [4, 1, 2, 3], 0).astype(np.int8)
        around = np.min(np.arccos(np.clip(np.abs(cosines), 0.0, 1.0)), axis=0)
        transmission = np.min(np.arcsin(np.clip(np.abs(sine), 0.0, 1.0)), axis=-1)
        return Pairs(defect, turns, np.where(none, 0.0, transmission), np.where(none | ~turns, 0.0, around))
