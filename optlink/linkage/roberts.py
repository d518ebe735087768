"""Cognates of a four-bar: the two other four-bars whose coupler points trace the same curve (Roberts-Chebyshev theorem).

Conventions: crank pivot A = (x, y), rocker pivot D = A + frame in the direction `direction`; crank A-B, coupler B-C, rocker D-C;
coupler point P = B + `along` in the direction B -> C + `across` to the left of it. Link angles count counter-clockwise from the
linkage's own A -> D. Assembly mode +1: C to the left of B -> D.

Theory. Let a, b, c, d be the vectors A-B, B-C, D-C, A-D as complex numbers, a + b = d + c, and let z = (P - B) / b, which is
constant. Three parallelograms (A-B-P, D-C-P and the remaining one) give a third fixed pivot E = A + z d and two more loops,

    at A and E:   z b + z a = z d + z c                        scaled by |z| = B-P / B-C
    at D and E:   (1-z) a - (1-z) c = (1-z) d - (1-z) b        scaled by |1-z| = C-P / B-C   (written from E to D)

The links at A and D rotate with the coupler, those at E with the rocker (first loop) and with the crank (second loop). Since the
lengths are those of the original in another order, all three have the same sign of the Grashof slack:

    original            at A and E                      at D and E, driven at E
    crank-rocker        double-rocker (Grashof)         crank-rocker
    double-crank        double-crank                    double-crank
    double-rocker       crank-rocker, driven at A       rocker-crank
    rocker-crank        crank-rocker, driven at E       double-rocker (Grashof)
    triple-rocker       triple-rocker                   triple-rocker

The cognate at D and E, driven at E, always has the crank angle of the original and the opposite assembly mode.

References
----------
S. Roberts, On three-bar motion in plane space, Proc. London Math. Soc. s1-7 (1875) 14-23; P. L. Chebyshev, 1878; text:
K. H. Hunt, Kinematic Geometry of Mechanisms; R. L. Norton, Design of Machinery, chapter 3, cognates. The same link rotations in
another order, and timed cognates: S. N. Sherman, J. D. Hauenstein, C. W. Wampler, J. Mechanisms Robotics 13(3) (2021) 031009.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np

from optlink.errors import InputError
from optlink.linkage.arguments import called, check_instance, check_length, check_number, check_side
from optlink.linkage.dyads import rrr
from optlink.linkage.fourbar import LENGTHS, Inversion, classify, reachable
from optlink.linkage.vector2d import Value, Vector, angle, cross, dot, minus, plus, turn, unit

DEGENERATE = 1e-9
"""Share of the longest link below which the distance B-P or C-P counts as zero: that cognate would have no size."""

ROUNDING = 1e-9
"""How far beyond the end of a range [rad] an angle still counts as that end."""

EXAMPLE = "optlink.linkage.CouplerLinkage(0.1, 0.4, 0.25, 0.5, 0.2, 0.1)"
SAMPLES = 64
"""Positions among which the one with the best transmission is taken, where the caller names none."""


@dataclass(frozen=True)
class CouplerPose:
    """Pose of a four-bar: unit vectors of its links relative to its own A -> D [-], joints and coupler point in the plane [m].

    `margin` [-] is (height / distance)^2 of C above B-D: negative where it cannot be assembled (C and P are NaN there).
    """

    crank: Vector
    coupler: Vector
    rocker: Vector
    b: Vector
    c: Vector
    p: Vector
    margin: Value

    def link(self, name: str) -> Vector:
        """Return the unit vector of crank (A -> B), coupler (B -> C) or rocker (D -> C) relative to A -> D [-]."""
        link: Vector = getattr(self, name)
        return link

    def angle(self, name: str) -> Value:
        """Return the angle of crank, coupler or rocker from A -> D [rad], in (-pi, pi]."""
        return angle(self.link(name))


@dataclass(frozen=True)
class CouplerLinkage:
    """A four-bar with a coupler point, at any position in the plane.

    Parameters
    ----------
    crank, coupler, rocker, frame : float [m], positive
    along, across : float [m]
        Coupler point from B: along B -> C, and to the left of it.
    x, y : float [m]
        The crank pivot A.
    direction : float [rad]
        Angle of A -> D from the x axis of the plane.
    side : int
        Assembly mode: +1 C to the left of B -> D, -1 to the right.

    Raises
    ------
    InputError
        A length is not positive, a number is not finite, or the assembly mode is neither +1 nor -1.
    """

    crank: float
    coupler: float
    rocker: float
    frame: float
    along: float
    across: float
    x: float = 0.0
    y: float = 0.0
    direction: float = 0.0
    side: int = 1

    def __post_init__(self) -> None:
        for name in ("along", "across", "x", "y", "direction"):
            check_number(name, getattr(self, name))
        for name, length in zip(LENGTHS, self.lengths, strict=True):
            check_length(name, length)
        check_side(self.side)

    @property
    def lengths(self) -> tuple[float, float, float, float]:
        """Crank, coupler, rocker, frame [m]: the order of the functions of `fourbar`."""
        return self.crank, self.coupler, self.rocker, self.frame

    @property
    def pivots(self) -> tuple[Vector, Vector]:
        """Crank pivot A and rocker pivot D [m]."""
        a = (self.x, self.y)
        return a, plus(a, (self.frame * math.cos(self.direction), self.frame * math.sin(self.direction)))

    @property
    def inversion(self) -> Inversion:
        """Inversion of the four-bar when its first link is driven."""
        return classify(*self.lengths).inversion

    @property
    def crank_turns(self) -> bool:
        """Whether the first link makes full revolutions."""
        return self.inversion.crank_turns

    def pose(self, phi: Value, side: Value | None = None) -> CouplerPose:
        """Compute the pose at given crank angles.

        Parameters
        ----------
        phi : Value, any shape [rad]
            Crank angle from A -> D; a jet gives velocities and accelerations too.
        side : Value, optional
            Assembly mode, 1 or -1, broadcastable against `phi`, if it differs from that of the linkage (a cognate that passes
            its dead centres).

        Returns
        -------
        CouplerPose
            NaN where it cannot be assembled.
        """
        crank = unit(phi)
        b, d = (self.crank * crank[0], self.crank * crank[1]), (self.frame, 0.0)
        with np.errstate(all="ignore"):
            c, margin = rrr(b, d, self.coupler, self.rocker, self.side if side is None else side)
            coupler, rocker = minus(c, b), minus(c, d)
            coupler = coupler[0] / self.coupler, coupler[1] / self.coupler
            rocker = rocker[0] / self.rocker, rocker[1] / self.rocker
        return self._placed(crank, coupler, rocker, margin)

    def _placed(self, crank: Vector, coupler: Vector, rocker: Vector, margin: Value) -> CouplerPose:
        """Return the pose with its points in the plane, from the unit vectors of the links."""
        b = self.crank * crank[0], self.crank * crank[1]
        c = b[0] + self.coupler * coupler[0], b[1] + self.coupler * coupler[1]
        p = plus(b, turn((self.along, self.across), coupler))
        axes = math.cos(self.direction), math.sin(self.direction)
        b, c, p = (plus((self.x, self.y), turn(point, axes)) for point in (b, c, p))
        return CouplerPose(crank, coupler, rocker, b, c, p, margin)


class _Drive(NamedTuple):
    """One of the loops above, driven at one of its two pivots.

    `follows`: the links of the original with which its crank, coupler and rocker rotate; `signs`: of these three and the frame.
    """

    at_a: bool
    follows: tuple[str, str, str]
    signs: tuple[int, int, int, int]


_AT_A = _Drive(True, ("coupler", "crank", "rocker"), (1, 1, 1, 1))
_AT_D = _Drive(False, ("coupler", "rocker", "crank"), (-1, 1, 1, -1))
_AT_E_TO_A = _Drive(True, ("rocker", "crank", "coupler"), (1, -1, 1, -1))
_AT_E_TO_D = _Drive(False, ("crank", "rocker", "coupler"), (1, -1, -1, 1))
_OTHER_END = {_AT_A: _AT_E_TO_A, _AT_E_TO_A: _AT_A, _AT_D: _AT_E_TO_D, _AT_E_TO_D: _AT_D}


@dataclass(frozen=True)
class Cognate:
    """A four-bar that traces the coupler curve of `original`, with the relation between the two crank angles.

    `follows` names the links of the original with which its crank, coupler and rocker rotate, always at the same angular
    velocity; its crank angle is that of the first of them plus `offset` [rad], each from the A -> D of its own linkage.

    `turning_back` are the crank angles of the original [rad], in the range in which it is assembled, at which the crank of the
    cognate reverses (its coupler and rocker are in line, its assembly mode changes): the cognate traces the whole curve, but its
    crank alone cannot drive it past these positions. `linkage.side` is the assembly mode at the crank angle `at` of `cognates`.
    """

    linkage: CouplerLinkage
    original: CouplerLinkage
    follows: tuple[str, str, str]
    offset: float
    turning_back: tuple[float, ...]
    _drive: _Drive = field(repr=False)
    _at: float = field(repr=False, compare=False)

    @property
    def turns_as(self) -> str:
        """The link of the original with which its crank rotates: crank, coupler or rocker."""
        return self.follows[0]

    @property
    def inversion(self) -> Inversion:
        """Inversion of the cognate when its crank is driven."""
        return self.linkage.inversion

    @property
    def crank_turns(self) -> bool:
        """Whether its crank makes full revolutions."""
        return self.linkage.crank_turns

    @property
    def keeps_side(self) -> bool:
        """Whether the assembly mode is constant over the motion of the original, so that the crank can drive the cognate."""
        return not self.turning_back

    def crank_angle(self, phi: Value) -> Value:
        """Return the crank angle [rad] of the cognate at the crank angle `phi` [rad] of the original, up to whole revolutions.

        `phi` has any shape, or is a jet. NaN where the original is not assembled, except where the cognate's crank rotates with
        the original's crank: then `phi` plus the offset.
        """
        if self.turns_as == "crank":
            return phi + self.offset
        return self.original.pose(phi).angle(self.turns_as) + self.offset

    def side_at(self, phi: Value) -> Value:
        """Return the assembly mode of the cognate at the crank angle `phi` [rad] of the original (number or array, not a jet).

        It is the sign of the vector product of B -> C and D -> C, which rotate with links of the original; +1 where that is zero.
        """
        return np.where(_sine(self.original.pose(phi), self._drive) < 0.0, -1, 1)

    def pose(self, phi: Value) -> CouplerPose:
        """Return the pose of the cognate at the crank angle `phi` [rad] of the original (any shape or a jet).

        NaN where the original is not assembled.

        The links are set parallel to those of the original; no loop is solved, so the pose is exact at dead centres too.
        """
        pose, signs = self.original.pose(phi), self._drive.signs
        links = [pose.link(name) for name in self.follows]
        directions = [(sign * signs[3] * x, sign * signs[3] * y) for sign, (x, y) in zip(signs[:3], links, strict=True)]
        size = self.linkage
        with np.errstate(all="ignore"):
            area = size.coupler * size.rocker * cross(directions[1], directions[2])
            diagonal = (size.frame - size.crank * directions[0][0], -(size.crank * directions[0][1]))
            height = area / dot(diagonal, diagonal)
        return size._placed(directions[0], directions[1], directions[2], height * height)

    @cached_property
    def driven_from_rocker(self) -> Cognate:
        """The same four-bar driven at its other pivot, in the same position."""
        return _cognate(self.original, _OTHER_END[self._drive], self._at)


class Cognates(NamedTuple):
    """The two cognates; None where the coupler point lies in B (no cognate at A) or in C (no cognate at D).

    at_crank_pivot : on the pivots A and E, driven at the end whose link turns fully, if there is one: see `cognates`.
    at_rocker_pivot : on the pivots E and D, driven at E with the crank angle of the original.
    """

    at_crank_pivot: Cognate | None
    at_rocker_pivot: Cognate | None


@called
def cognates(linkage: CouplerLinkage, at: float | None = None) -> Cognates:
    """Compute the Roberts-Chebyshev cognates of a four-bar.

    Parameters
    ----------
    linkage : CouplerLinkage
    at : float [rad], optional
        Crank angle of `linkage` at which the assembly modes of the cognates are determined. If `linkage` can be assembled in
        two ranges of crank angle, `at` also selects the range. Default: the position in the last range at which the
        transmission angle of the cognate is closest to 90 deg.

    Returns
    -------
    Cognates
        A pair of Cognate or None (see `Cognates`). Both trace the branch of the coupler curve that `linkage` traces in its
        assembly mode and in that range. The cognate at the crank pivot is driven at E, where its crank rotates with the rocker of
        `linkage`, unless only its link at A turns fully (then `linkage` is a Grashof double-rocker). If `linkage` is a
        crank-rocker or a triple-rocker, this cognate passes dead centres at whichever pivot it is driven
        (`Cognate.turning_back`). If the coupler point lies on the line B-C, the three fixed pivots are collinear too. The result
        is undefined for a change-point linkage.

    Raises
    ------
    InputError
        If `linkage` cannot be assembled over any range of crank angles, or cannot be assembled at `at`; if an argument is none of
        these.
    """
    check_instance("linkage", linkage, CouplerLinkage, "four-bar with a coupler point", EXAMPLE)
    if at is not None:
        check_number("at", at)
    ranges = reachable(*linkage.lengths)
    if not ranges:
        raise InputError(
            "the four-bar cannot be assembled so that it moves", "Make the longest link shorter", value=linkage.lengths
        )
    if at is not None and not any(_within(at, low, high) for low, high in ranges):
        raise InputError(
            "the four-bar cannot be assembled at this crank angle", f"Give one within {ranges} rad", key="at", value=at
        )
    smallest = DEGENERATE * max(linkage.lengths)
    first = second = None
    if math.hypot(linkage.along, linkage.across) > smallest:
        first = _cognate(linkage, _AT_E_TO_A, at)
        if not first.crank_turns and first.driven_from_rocker.crank_turns:
            first = first.driven_from_rocker
    if math.hypot(linkage.along - linkage.coupler, linkage.across) > smallest:
        second = _cognate(linkage, _AT_E_TO_D, at)
    return Cognates(first, second)


def _cognate(original: CouplerLinkage, drive: _Drive, at: float | None) -> Cognate:
    """Return one loop driven at one pivot, in its assembly mode at the crank angle `at` of the original."""
    b, across = original.coupler, original.across
    from_b, from_c = complex(original.along, across) / b, complex(b - original.along, -across) / b  # z and 1 - z
    factor, rest = (from_b, from_c) if drive.at_a else (from_c, from_b)
    crank, coupler, rocker = (abs(factor) * getattr(original, name) for name in drive.follows)
    forward = complex(math.cos(original.direction), math.sin(original.direction))
    pivot, ratio = complex(original.x, original.y), 1.0 / factor  # its crank pivot; (P - B) / (C - B) of the cognate
    if drive.follows[0] != "coupler":
        pivot, ratio = pivot + from_b * original.frame * forward, -rest / factor
    elif not drive.at_a:
        pivot += original.frame * forward
    way = drive.signs[3] * factor * forward
    ranges = reachable(*original.lengths)
    low, high = ranges[-1] if at is None else next((low, high) for low, high in ranges if _within(at, low, high))
    inset = ROUNDING * (high - low)  # at the very end of a range its two modes are one
    at = _best(original, drive, low, high) if at is None else min(max(_from(at, low - ROUNDING), low + inset), high - inset)
    turning_back = [_from(phi, low) for phi in _turning_back(original, drive)]
    return Cognate(
        linkage=CouplerLinkage(
            crank=crank,
            coupler=coupler,
            rocker=rocker,
            frame=abs(factor) * original.frame,
            along=coupler * ratio.real,
            across=coupler * ratio.imag,
            x=pivot.real,
            y=pivot.imag,
            direction=math.atan2(way.imag, way.real),
            side=-1 if _sine(original.pose(at), drive) < 0.0 else 1,
        ),
        original=original,
        follows=drive.follows,
        offset=0.0 if drive.signs[0] == drive.signs[3] else math.pi,
        turning_back=tuple(sorted(phi for phi in turning_back if phi <= high)),
        _drive=drive,
        _at=at,
    )


def _sine(pose: CouplerPose, drive: _Drive) -> Value:
    """Sine of the angle from coupler to rocker of a cognate [-], from the original's links; its sign is the assembly mode."""
    coupler, rocker = pose.link(drive.follows[1]), pose.link(drive.follows[2])
    return drive.signs[1] * drive.signs[2] * cross(coupler, rocker)


def _best(original: CouplerLinkage, drive: _Drive, low: float, high: float) -> float:
    """Return the crank angle of the original, inside a range, with the best transmission of the cognate."""
    phi = low + (high - low) * (np.arange(SAMPLES) + 0.5) / SAMPLES
    quality = np.nan_to_num(np.abs(_sine(original.pose(phi), drive)), nan=-1.0)
    return float(phi[np.argmax(quality)])


def _within(phi: float, low: float, high: float) -> bool:
    """Whether an angle lies in a range, up to whole turns."""
    return _from(phi, low - ROUNDING) <= high + ROUNDING


def _from(phi: float, low: float) -> float:
    """Return the angle at or above `low` that differs by whole revolutions."""
    return low + (phi - low) % (2.0 * math.pi)


def _turning_back(original: CouplerLinkage, drive: _Drive) -> list[float]:
    """Crank angles of the original [rad], in its mode, at which coupler and rocker of a cognate are in line.

    Where the crank is in line with one of the other moving links, the two act as one link w, and the remaining three-bar loop is
    a triangle with the frame; one of its two mirror images belongs to the mode.
    """
    pair = set(drive.follows[1:])
    if "crank" not in pair:  # in line where the original's own coupler and rocker are: at the ends of its range
        return []
    with_rocker = "rocker" in pair
    third = original.coupler if with_rocker else original.rocker
    angles = []
    for sense in (1, -1):  # in the same direction as the crank, or against it
        w = original.crank - sense * original.rocker if with_rocker else original.crank + sense * original.coupler
        if w != 0.0:
            cosine = (w * w + original.frame**2 - third**2) / (2.0 * w * original.frame)
            if abs(cosine) < 1.0:
                angles.append(original.side * sense * math.acos(cosine))
    return angles
