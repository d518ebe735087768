"""Disc cams: profile, contact, pressure angle and curvature for a given motion of the follower.

The cam turns counter-clockwise by theta about the origin; the guide or the pivot of its follower is fixed. The axes of the cam
coincide with the fixed ones at theta = 0, so a point of the profile is the contact point turned back by theta: as theta rises,
the contact runs clockwise round the cam. Lifts count from the lowest position, at which the follower stands on the base circle.
In this module a point or a vector is a complex number x + iy, and rates are derivatives with respect to theta.

The cam is the envelope of its follower (R. L. Norton, Cam Design and Manufacturing Handbook, 2nd ed., 2009, chapter 7). All of
it follows from two rates, of the contact along the profile and of its normal: the radius of curvature is their quotient, and
the profile is undercut where the contact runs backwards.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from optlink.linkage.extrema import distinct, extremes, maxima
from optlink.linkage.vector2d import TURN, Array, root

Complex = NDArray[np.complex128]
"""Points or vectors x + iy."""
Lift = Callable[[Array], tuple[Array, Array, Array]]
"""Cam angles (n,) [rad] -> lift [m, or rad of an arm], its first and its second derivative (n,)."""

CIRCLE = 120  # corners of a circle
STEPS = 720  # of a turn, between which extremes are refined
DEVIATION = 2e-5  # default deviation of a polyline from the profile, in base radii: 1 um for 50 mm
FIRST, ROUNDS, SAFE = 72, 16, 0.9  # pieces of a polyline at first, rounds of halving, share of the deviation used at three points


@dataclass(frozen=True, eq=False)
class Profile:
    """A curve on a body, in its axes: corners (n, 2) [m], or with a `radius` a circle about its only point.

    An `auxiliary` one, such as a base circle, a pitch circle or a belt, is no edge of the body; only such a one may be `open`.
    """

    line: Array
    radius: float = 0.0
    auxiliary: bool = False
    open: bool = False

    @property
    def corners(self) -> Array:
        """Corners (n, 2) of the curve, those of a circle close together; the first of a closed one is the last again."""
        turns = np.linspace(0.0, TURN, CIRCLE + 1)
        circle = self.line[0] + self.radius * np.column_stack([np.cos(turns), np.sin(turns)])
        return circle if self.radius else self.line if self.open else np.concatenate([self.line, self.line[:1]])

    def scaled(self, factor: float) -> "Profile":
        """Return the curve in another unit."""
        return replace(self, line=factor * self.line, radius=factor * self.radius)

    def moved(self, by: Array) -> "Profile":
        """Return the curve shifted by a vector (2,) [m]."""
        return replace(self, line=self.line + by)

    def encloses(self, points: Array) -> bool:
        """Return whether all points (n, 2) lie inside: the curve winds round them."""
        seen = (self.corners - points[:, None]) @ [1.0, 1j]
        with np.errstate(divide="ignore", invalid="ignore"):  # a point on the curve
            winding = np.sum(np.angle(seen[:, 1:] / seen[:, :-1]), axis=1)
        return bool(np.all(np.abs(winding) > math.pi))


class Place(NamedTuple):
    """A follower at cam angles (n,): its point with rates, the normal of its face with the rates of the angle of that."""

    point: Complex
    rate: Complex
    second: Complex
    normal: Complex
    turning: Array
    turning_rate: Array


class Guide(Protocol):
    """What a follower moves on."""

    def of_point(self, radius: float) -> float:
        """Return the lowest position at which the point is a radius [m] away from the cam's pivot; NaN if there is none."""

    def of_face(self, radius: float) -> float:
        """Return the lowest position at which the face touches a circle of a radius [m]; NaN if there is none."""

    def place(self, lowest: float, lift: tuple[Array, Array, Array]) -> Place:
        """Return the follower at lifts from its lowest position."""

    def way(self, at: Complex) -> Complex:
        """Return the unit vector along which the follower lifts at points."""


@dataclass(frozen=True)
class Slide:
    """A follower slides in a `direction` [rad]; its line passes `offset` [m] to the right of the cam's pivot.

    A face is perpendicular to the direction. A positive offset reduces the pressure angle of a rise.
    """

    direction: float = 0.25 * TURN
    offset: float = 0.0

    def of_point(self, radius: float) -> float:
        """Return the slide at which the point is a radius away from the cam's pivot."""
        return float(root(radius * radius - self.offset * self.offset))

    def of_face(self, radius: float) -> float:
        """Return the slide at which the face touches a circle."""
        return radius

    def place(self, lowest: float, lift: tuple[Array, Array, Array]) -> Place:
        """Return the follower at lifts from its lowest position."""
        along, still = np.exp(1j * self.direction), np.zeros_like(lift[0])
        point = (lowest + lift[0] - 1j * self.offset) * along
        return Place(point, lift[1] * along, lift[2] * along, along + 0.0 * point, still, still)

    def way(self, at: Complex) -> Complex:
        """Return the direction."""
        return np.full_like(at, np.exp(1j * self.direction))


@dataclass(frozen=True)
class Arm:
    """A follower swings about a `pivot` x, y [m]; its positions are angles from the line to the cam's pivot, 0 ... pi.

    Its point lies `length` along the arm, and `offset` beside it, away from the cam [m]; a face is parallel to the arm through
    that point. `side` is +1 if the arm lifts counter-clockwise, else -1.
    """

    pivot: tuple[float, float]
    length: float = 0.0
    offset: float = 0.0
    side: int = 1

    def of_point(self, radius: float) -> float:
        """Return the angle at which the point is a radius away from the cam's pivot (cosine rule)."""
        distance, length = math.hypot(*self.pivot), math.hypot(self.length, self.offset)
        cosine = (distance * distance + length * length - radius * radius) / (2.0 * distance * length)
        return math.acos(cosine) - math.atan2(self.offset, self.length) if abs(cosine) <= 1.0 else math.nan

    def of_face(self, radius: float) -> float:
        """Return the angle at which the face touches a circle."""
        sine = (radius - self.offset) / math.hypot(*self.pivot)
        return math.asin(sine) if abs(sine) <= 1.0 else math.nan

    def place(self, lowest: float, lift: tuple[Array, Array, Array]) -> Place:
        """Return the follower at lifts from its lowest position."""
        pivot, (turned, first, second) = complex(*self.pivot), (self.side * part for part in lift)
        along = -pivot / abs(pivot) * np.exp(1j * (self.side * lowest + turned))
        point = (self.length + 1j * self.side * self.offset) * along
        return Place(
            pivot + point, 1j * first * point, (1j * second - first * first) * point, 1j * self.side * along, first, second
        )

    def way(self, at: Complex) -> Complex:
        """Return the direction across the line from the arm's pivot."""
        lever = at - complex(*self.pivot)
        with np.errstate(invalid="ignore"):  # NaN of a follower that does not reach the base circle
            return 1j * self.side * lever / np.abs(lever)


class Touch(NamedTuple):
    """A contact at cam angles (n,): its point, the unit normal from the inside of the cam outwards, and two rates.

    `advance` [m] is that of the contact along the profile, clockwise, and `turning` that of the normal, positive where the
    profile bulges, both relative to the cam. `driven` is the point of the follower from whose direction of motion the pressure
    angle counts.
    """

    contact: Complex
    driven: Complex
    normal: Complex
    advance: Array
    turning: Array


class Contact(Protocol):
    """What a follower touches the cam with."""

    def lowest(self, guide: Guide, base_radius: float) -> float:
        """Return the position of a follower on the base circle."""

    def touch(self, place: Place, *, outer: bool = False) -> Touch:
        """Return the contact of a follower, or that with the `outer` flank of a groove."""


@dataclass(frozen=True)
class Roller:
    """A roller about the point of the follower, with a `radius` [m] of zero a knife edge."""

    radius: float = 0.0

    def lowest(self, guide: Guide, base_radius: float) -> float:
        """Return the position of a follower on the base circle: its point is on the prime circle."""
        return guide.of_point(base_radius + self.radius)

    def touch(self, place: Place, *, outer: bool = False) -> Touch:
        """Return the contact: the profile is an offset of the path of the point relative to the cam (pitch curve)."""
        radius = -self.radius if outer else self.radius
        rate = place.rate - 1j * place.point
        second = place.second - 2j * place.rate - place.point
        speed = np.abs(rate)
        with np.errstate(divide="ignore", invalid="ignore"):  # a point at rest on the cam has no normal
            normal, turning = 1j * rate / speed, -np.imag(np.conj(rate) * second) / (speed * speed)
        advance, contact = speed - radius * turning, place.point - radius * normal
        return Touch(contact, place.point, normal, advance, -turning if outer else turning)


@dataclass(frozen=True)
class Face:
    """A flat face."""

    def lowest(self, guide: Guide, base_radius: float) -> float:
        """Return the position of a follower on the base circle."""
        return guide.of_face(base_radius)

    def touch(self, place: Place, *, outer: bool = False) -> Touch:
        """Return the contact, from the distance of the face as a function of its angle to the cam (support function)."""
        point, rate, second = (np.conj(place.normal) * part for part in place[:3])  # along and to the left of the normal
        turned, change = place.turning, place.turning_rate
        distance = point.real
        first = rate.real + turned * point.imag
        bend = second.real + 2.0 * turned * rate.imag + change * point.imag - turned * turned * distance
        relative = turned - 1.0
        left = first / relative
        radius = distance + (bend - left * change) / (relative * relative)
        contact = (distance + 1j * left) * place.normal
        return Touch(contact, contact, place.normal, -radius * relative, -relative)


@dataclass(frozen=True, eq=False)
class CamContact:
    """A cam and its follower in contact at cam angles (n,) [rad].

    Attributes
    ----------
    point, contact : ndarray (n,), complex
        The follower's point (centre of the roller) and the contact point [m], in the fixed axes.
    normal : ndarray (n,), complex
        Unit vector of the force on the follower.
    pressure_angle : ndarray (n,)
        From the direction in which the contact lifts the follower (that of the point of a roller) to the normal,
        counter-clockwise [rad].
    advance, turning : ndarray (n,)
        Rates of the contact along the profile [m], clockwise, and of its normal, positive where the profile bulges.
    """

    angles: Array
    point: Complex
    contact: Complex
    normal: Complex
    pressure_angle: Array
    advance: Array
    turning: Array

    @property
    def profile(self) -> Complex:
        """Contact points in the axes of the cam [m]."""
        return np.asarray(self.contact * np.exp(-1j * self.angles))

    @property
    def pitch(self) -> Complex:
        """Points of the follower in the axes of the cam [m]: with a roller the pitch curve."""
        return np.asarray(self.point * np.exp(-1j * self.angles))

    @property
    def radius(self) -> Array:
        """Radius of curvature of the profile [m], positive where it bulges, negative where it is hollow, reversed if undercut.

        With a roller of radius r that of the pitch curve is radius + r; from an outer flank it is -(radius + r).
        """
        with np.errstate(divide="ignore"):
            return self.advance / self.turning

    @property
    def undercut(self) -> NDArray[np.bool_]:
        """Whether the follower cuts away what it should touch nearby."""
        return ~(self.advance > 0.0)

    @property
    def along(self) -> Array:
        """Distance of the contact from the follower's point along a face [m], to the right of the normal."""
        return -np.imag((self.contact - self.point) * np.conj(self.normal))

    @property
    def lever(self) -> Array:
        """Torque that turns the cam counter-clockwise, per force of the contact along the normal [m]."""
        return np.imag(np.conj(self.contact) * self.normal)


class CamFigures(NamedTuple):
    """Lift [m, or rad of an arm]; largest pressure angle [rad] and least radius of curvature where the profile bulges [m].

    Both have their cam angle [rad]. `undercut` is the cam angle at which the contact runs backwards most; NaN if it never does.
    """

    lift: float
    pressure_angle: tuple[float, float]
    radius: tuple[float, float]
    undercut: float


@dataclass(frozen=True, eq=False)
class DiscCam:
    """A disc cam that moves its follower by a law.

    Parameters
    ----------
    lift : callable
        Cam angles (n,) [rad] -> lift and its first two derivatives with respect to the cam angle; one turn is a period.
    guide : Guide
        `Slide` or `Arm`.
    contact : Contact
        `Roller` or `Face`.
    base_radius : float [m]
    breaks : tuple of float, optional
        Cam angles [rad] at which the second derivative jumps.
    groove : bool, optional
        Whether a roller runs in a groove, which has an outer flank, too.
    """

    lift: Lift
    guide: Guide
    contact: Contact
    base_radius: float
    breaks: tuple[float, ...] = ()
    groove: bool = False

    def at(self, angles: Array, *, outer: bool = False) -> CamContact:
        """Return the contact at cam angles (n,) [rad], on the profile or the `outer` flank of a groove.

        All is NaN if the follower cannot stand on the base circle.
        """
        place = self.guide.place(self.contact.lowest(self.guide, self.base_radius), self.lift(angles))
        contact, driven, normal, advance, turning = self.contact.touch(place, outer=outer)
        pressure = np.angle(normal * np.conj(self.guide.way(driven)))
        return CamContact(angles, place.point, contact, -normal if outer else normal, pressure, advance, turning)

    def polyline(self, deviation: float | None = None, *, outer: bool = False, pitch: bool = False) -> Array:
        """Return corners (n, 2) [m] of the profile, the `outer` flank or the `pitch` curve in the axes of the cam.

        They run counter-clockwise; the last corner is joined to the first. No edge is further than `deviation` [m] from it,
        by default `DEVIATION` base radii; edges are short where the curve is sharp.
        """
        most = SAFE * (DEVIATION * self.base_radius if deviation is None else deviation)

        def corners(angles: Array) -> Complex:
            contact = self.at(angles, outer=outer)
            return contact.pitch if pitch else contact.profile

        angles = distinct([*np.linspace(0.0, TURN, FIRST + 1), *np.mod(self.breaks, TURN)])
        points = corners(angles)
        for _ in range(ROUNDS):
            inner = angles[:-1, None] + np.diff(angles)[:, None] * [0.25, 0.5, 0.75]
            between = corners(inner.ravel()).reshape(inner.shape)
            start, edge = points[:-1, None], np.diff(points)[:, None]
            with np.errstate(divide="ignore", invalid="ignore"):  # an edge without length: the contact rests
                share = np.nan_to_num(np.clip(np.real((between - start) * np.conj(edge)) / np.abs(edge) ** 2, 0.0, 1.0))
            far = np.flatnonzero(np.max(np.abs(between - start - share * edge), axis=1) > most)
            angles, points = np.insert(angles, far + 1, inner[far, 1]), np.insert(points, far + 1, between[far, 1])
            if not far.size:
                break
        return np.column_stack([points.real, points.imag])[:0:-1]

    @property
    def profiles(self) -> tuple[Profile, ...]:
        """Its flanks and its base circle, as they are drawn on the cam."""
        flanks = [Profile(self.polyline(outer=outer)) for outer in self.flanks]
        return *flanks, Profile(np.zeros((1, 2)), self.base_radius, auxiliary=True)

    @property
    def flanks(self) -> tuple[bool, ...]:
        """Whether each flank is the outer one of a groove."""
        return (False, True) if self.groove else (False,)

    @property
    def figures(self) -> CamFigures:
        """What a designer asks of the profile, each with its cam angle."""

        def largest(quantity: Callable[[CamContact], Array]) -> tuple[float, float]:
            place, value = maxima(lambda angles: quantity(self.at(angles))[None], _TURN, self.breaks, periodic=True)
            return float(value[0]), float(place[0])

        backwards, where = largest(lambda contact: -contact.advance)
        curvature, sharp = largest(lambda contact: np.where(contact.advance > 0.0, contact.turning / contact.advance, np.nan))
        radius = 1.0 / curvature if curvature > 0.0 else math.inf
        least, most = extremes(lambda angles: self.lift(angles)[0][None], _TURN, self.breaks, periodic=True)[1][0]
        pressure = largest(lambda contact: np.abs(contact.pressure_angle))
        return CamFigures(float(most - least), pressure, (radius, sharp), where if backwards >= 0.0 else math.nan)

    def extremes(self, quantity: Callable[[CamContact], Array]) -> tuple[float, float]:
        """Return the least and the largest value of a quantity of the contact over a turn.

        That of `along` is the range of a face that is used, from the follower's point to the right.
        """
        low, high = extremes(lambda angles: quantity(self.at(angles))[None], _TURN, self.breaks, periodic=True)[1][0]
        return float(low), float(high)


_TURN = np.linspace(0.0, TURN, STEPS + 1)
