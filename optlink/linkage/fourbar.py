"""Closed-form four-bar theory, elementwise: Grashof conditions, dead centres, transmission angle, swing angle, time ratio.

Conventions: crank pivot A = (0, 0), rocker pivot D = (frame, 0); crank A-B, coupler B-C, rocker D-C; crank angle phi and
rocker angle psi counter-clockwise from A -> D. Assembly mode +1: C to the left of B -> D (above it where D lies to the right).
The transmission angle gamma is the angle B-C-D between coupler and rocker, 0 ... pi.
"""

import enum
import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np

from optlink.errors import InputError
from optlink.linkage.arguments import called, check_flag, check_length, check_number, check_point_names, check_side
from optlink.linkage.dyads import RRR
from optlink.linkage.mechanism import FRAME, Arm, BodyPoint, Ground, Link, Mechanism, Size
from optlink.linkage.vector2d import Value, Vector, angle, angle_from, magnitude, root, turn

__all__ = [
    "DeadCentre",
    "GrashofClass",
    "Inversion",
    "classify",
    "crank_rocker_conditions",
    "dead_centre",
    "diagonal_squared",
    "double_crank_conditions",
    "four_bar",
    "grashof",
    "reachable",
    "swing",
    "time_ratio",
    "transmission_cosine",
    "turning_points",
]
LENGTHS = ("crank", "coupler", "rocker", "frame")


def __dir__() -> list[str]:
    return __all__


_ELSEWHERE = dict.fromkeys(LENGTHS, 'Give sizes to sweep(mechanism, {"crank": 0.1, ...}, angles)')


@partial(called, elsewhere=_ELSEWHERE)
def four_bar(
    side: int = 1, points: Iterable[str] = (), *, placed: bool = False, follow: bool = False, holds_at: float | None = None
) -> Mechanism:
    """Return the four-bar A-B-C-D as a Mechanism, with the parameters of `LENGTHS` as its sizes.

    Parameters
    ----------
    side : int
        Assembly mode: +1 or -1.
    points : iterable of str
        Names of points fixed on the coupler; their parameters are "P.along" and "P.across" (from B, along and left of B -> C).
    placed : bool
        False: A lies in the origin and D on the x axis. True: the parameters "A.x", "A.y" and "direction" place the frame, and
        crank angles count from A -> D.
    follow : bool
        Continue the motion smoothly through change points.
    holds_at : float [rad], optional
        Crank angle at which `side` applies if `follow` is set. Default: the start of the drive.

    Raises
    ------
    InputError
        If an argument is none of these, or a point has no name of its own.

    Examples
    --------
    >>> mechanism = optlink.linkage.four_bar(points=["P"])
    >>> sizes = {"crank": 0.1, "coupler": 0.4, "rocker": 0.25, "frame": 0.5, "P.along": 0.2, "P.across": 0.1}  # [m]
    >>> optlink.linkage.sweep(mechanism, sizes, np.radians([0.0, 90.0])).position("P").round(4)  # x, y [m]
    array([[0.2016, 0.1992],
           [0.1607, 0.2555]])
    """
    check_side(side)
    check_flag("placed", placed)
    check_flag("follow", follow)
    names = check_point_names(points, ("A", "B", "C", "D", *LENGTHS))
    if holds_at is not None:
        check_number("holds_at", holds_at)
    coupler, rocker = Link("coupler", "B", "C", "coupler"), Link("rocker", "D", "C", "rocker")
    return Mechanism(
        name="four-bar",
        ground={"A": ("A.x", "A.y"), "D": Arm("A", "frame", "direction")} if placed else {"A": (0.0, 0.0), "D": ("frame", 0.0)},
        crank=Link("crank", "A", "B", "crank"),
        groups=(RRR(coupler, rocker, ("B", "D"), "C", side, follow=follow, holds_at=holds_at),),
        points=tuple(BodyPoint(name, "coupler", f"{name}.along", f"{name}.across") for name in names),
        datum="direction" if placed else 0.0,
    )


# --- Grashof conditions --------------------------------------------------------------------------------------------


def crank_rocker_conditions(crank: Value, coupler: Value, rocker: Value, frame: Value) -> dict[str, Value]:
    """Return the Grashof condition with the crank as the shortest link, as six slacks [m] that must not be negative.

    The slacks are linear in the lengths, so a solver that starts feasible remains feasible.

    Parameters
    ----------
    crank, coupler, rocker, frame : Value [m]
    """
    return {
        "crank <= coupler": coupler - crank,
        "crank <= rocker": rocker - crank,
        "crank <= frame": frame - crank,
        "crank + frame <= coupler + rocker": coupler + rocker - crank - frame,
        "crank + coupler <= rocker + frame": rocker + frame - crank - coupler,
        "crank + rocker <= coupler + frame": coupler + frame - crank - rocker,
    }


def double_crank_conditions(crank: Value, coupler: Value, rocker: Value, frame: Value) -> dict[str, Value]:
    """Return the Grashof condition with the frame as the shortest link (drag link): crank and frame are interchanged.

    Parameters
    ----------
    crank, coupler, rocker, frame : Value [m]
    """
    swapped = crank_rocker_conditions(frame, coupler, rocker, crank)
    return {
        label.replace("crank", "\0").replace("frame", "crank").replace("\0", "frame"): slack for label, slack in swapped.items()
    }


class Inversion(enum.Enum):
    """Inversion of a four-bar whose first link is driven, by its textbook name."""

    CRANK_ROCKER = "crank-rocker"
    DOUBLE_CRANK = "double-crank (drag link)"
    DOUBLE_ROCKER = "double-rocker (Grashof)"
    ROCKER_CRANK = "rocker-crank"
    TRIPLE_ROCKER = "triple-rocker (non-Grashof)"
    CHANGE_POINT = "change-point"
    PARALLELOGRAM = "parallelogram (change-point)"
    KITE = "kite (change-point)"
    IMPOSSIBLE = "cannot be assembled"

    @property
    def crank_turns(self) -> bool:
        """Whether the driven link makes full revolutions without passing a singular position."""
        return self in (Inversion.CRANK_ROCKER, Inversion.DOUBLE_CRANK)


SHORTEST = (Inversion.CRANK_ROCKER, Inversion.DOUBLE_ROCKER, Inversion.ROCKER_CRANK, Inversion.DOUBLE_CRANK)
"""Inversions of linkages that satisfy Grashof's condition by their shortest link, in the order of `LENGTHS`."""


@dataclass(frozen=True)
class GrashofClass:
    """Inversion and Grashof slack p + q - s - l [m], which is positive where the shortest link turns fully."""

    inversion: Inversion
    slack: float


@called
def grashof(crank: float, coupler: float, rocker: float, frame: float, tolerance: float = 1e-9) -> GrashofClass:
    """Classify a four-bar driven at its crank.

    Parameters
    ----------
    crank, coupler, rocker, frame : float [m], positive
    tolerance : float [-]
        A four-bar counts as a change-point linkage if the magnitude of its slack is below this fraction of its longest link.

    Returns
    -------
    GrashofClass
        Inversion and Grashof slack [m].

    Raises
    ------
    InputError
        If a length is not positive and finite, or the tolerance is negative.

    References
    ----------
    Grashof's condition s + l <= p + q; inversions as in Norton, Design of Machinery, chapter 2.

    Examples
    --------
    >>> result = optlink.linkage.grashof(crank=0.1, coupler=0.4, rocker=0.25, frame=0.5)
    >>> result.inversion.value, round(result.slack, 6)  # p + q - s - l [m]
    ('crank-rocker', 0.05)
    """
    for name, length in zip(LENGTHS, (crank, coupler, rocker, frame), strict=True):
        check_length(name, length)
    if check_number("tolerance", tolerance) < 0.0:
        raise InputError(
            "a tolerance cannot be negative", "Give a share of the longest link such as 1e-9", None, "tolerance", tolerance
        )
    return classify(crank, coupler, rocker, frame, tolerance)


def classify(crank: float, coupler: float, rocker: float, frame: float, tolerance: float = 1e-9) -> GrashofClass:
    """Classify a four-bar as `grashof` does, without a check: lengths that are not finite close nowhere.

    Parameters
    ----------
    crank, coupler, rocker, frame : float [m]
    tolerance : float [-]
    """
    lengths = (crank, coupler, rocker, frame)
    if not all(map(math.isfinite, lengths)):  # a NaN would compare as any class
        return GrashofClass(Inversion.IMPOSSIBLE, math.nan)
    shortest, short, long, longest = sorted(lengths)
    slack = short + long - shortest - longest
    tiny = tolerance * longest

    def equal(*pairs: tuple[float, float]) -> bool:
        return all(abs(a - b) <= tiny for a, b in pairs)

    if longest > shortest + short + long + tiny:
        inversion = Inversion.IMPOSSIBLE
    elif slack < -tiny:
        inversion = Inversion.TRIPLE_ROCKER
    elif slack > tiny:
        inversion = SHORTEST[lengths.index(shortest)]
    elif equal((crank, rocker), (coupler, frame)):
        inversion = Inversion.PARALLELOGRAM
    elif equal((crank, coupler), (rocker, frame)) or equal((crank, frame), (coupler, rocker)):
        inversion = Inversion.KITE
    else:
        inversion = Inversion.CHANGE_POINT
    return GrashofClass(inversion, slack)


# --- transmission angle and assembly over a range of crank angles -------------------------------------------------


def diagonal_squared(crank: Value, frame: Value, cos_phi: Value) -> Value:
    """Return the square of the distance B-D [m^2]. It is linear in cos phi, so its extrema lie at phi = 0 and pi.

    Parameters
    ----------
    crank, frame : Value [m]
    cos_phi : Value [-]
        Cosine of the crank angle.
    """
    return crank * crank + frame * frame - 2.0 * (crank * frame) * cos_phi


def transmission_cosine(crank: Value, coupler: Value, rocker: Value, frame: Value, cos_phi: Value) -> Value:
    """Return the cosine of the transmission angle; outside [-1, 1] where the four-bar cannot be assembled.

    Parameters
    ----------
    crank, coupler, rocker, frame : Value [m]
    cos_phi : Value [-]
        Cosine of the crank angle.
    """
    diagonal = diagonal_squared(crank, frame, cos_phi)
    return (coupler * coupler + rocker * rocker - diagonal) / (2.0 * (coupler * rocker))


def turning_points(start: Value, span: Value) -> list[Value]:
    """Return crank angles [rad] that include the extrema of every function of cos phi over start ... start + span.

    These are both ends, and the multiples of pi clipped to the range: a multiple outside it coincides with an end, and because
    cos is flat there the extremum is continuously differentiable in `start`.

    Parameters
    ----------
    start : Value [rad]
        First crank angle, from -2 pi to 2 pi.
    span : Value [rad]
        Crank rotation, from -2 pi to 2 pi.
    """
    end = start + span
    if isinstance(span, float | int):
        low, high = (start, end) if span >= 0.0 else (end, start)
    else:
        low, high = np.minimum(start, end), np.maximum(start, end)
    inner = [np.minimum(np.maximum(k * np.pi, low), high) for k in range(-4, 5)]
    return [low, high, *inner]


def reachable(crank: float, coupler: float, rocker: float, frame: float) -> list[tuple[float, float]]:
    """Return the ranges of crank angle [rad] in which the four-bar can be assembled.

    Parameters
    ----------
    crank, coupler, rocker, frame : float [m]

    Returns
    -------
    list of (low, high)
        [(-pi, pi)] for full rotation, one range symmetric to 0 or pi, two mirrored ranges, or none.
    """
    denominator = 2.0 * crank * frame
    constant = crank * crank + frame * frame
    highest = (constant - (coupler - rocker) ** 2) / denominator  # cos phi must stay below: B too close to D beyond
    lowest = (constant - (coupler + rocker) ** 2) / denominator  # and above: B too far from D
    return cosine_ranges(lowest, highest)


def cosine_ranges(lowest: float, highest: float) -> list[tuple[float, float]]:
    """Return the ranges of angle [rad] whose cosines lie between two values; see `reachable`.

    Parameters
    ----------
    lowest, highest : float [-]
        They may lie beyond -1 ... 1.
    """
    if lowest >= 1.0 or highest <= -1.0:  # at equality a single position, which is no range
        return []
    near = float(np.arccos(highest)) if highest < 1.0 else 0.0
    far = float(np.arccos(lowest)) if lowest > -1.0 else float(np.pi)
    if near == 0.0:
        return [(-far, far)]
    if far == np.pi:
        return [(near, 2.0 * float(np.pi) - near)]
    return [(-far, -near), (near, far)]


# --- dead centres --------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class DeadCentre:
    """Limit position of the rocker, with crank and coupler in line.

    `crank` and `rocker` are unit vectors; `margin` (dimensionless) is negative where the position does not exist.
    """

    crank: Vector
    rocker: Vector
    margin: Value

    @property
    def phi(self) -> Value:
        """Crank angle [rad]."""
        return angle(self.crank)

    @property
    def psi(self) -> Value:
        """Rocker angle [rad]."""
        return angle(self.rocker)


def dead_centre(crank: Value, coupler: Value, rocker: Value, frame: Value, side: int, outer: bool) -> DeadCentre:
    """Compute a limit position of the rocker.

    Parameters
    ----------
    crank, coupler, rocker, frame : Value [m]
    side : int
        Assembly mode.
    outer : bool
        True: crank and coupler extended (A-C = coupler + crank); False: overlapping (A-C = |coupler - crank|).

    Notes
    -----
    Law of cosines in the triangle A-C-D.
    """
    reach = coupler + crank if outer else coupler - crank
    with np.errstate(all="ignore"):  # crank = coupler has no inner dead centre: C would sit on A, in no direction
        cos_ac = np.divide(reach * reach - rocker * rocker + frame * frame, 2.0 * (reach * frame))
        margin = 1.0 - cos_ac * cos_ac
        sin_ac = side * root(margin)
        direction = (cos_ac, sin_ac) if outer else (-cos_ac, -sin_ac)
        return DeadCentre(direction, ((reach * cos_ac - frame) / rocker, reach * sin_ac / rocker), margin)


def swing(crank: Value, coupler: Value, rocker: Value, frame: Value, side: int) -> Value:
    """Return the swing angle between the limit positions of the rocker of a crank-rocker [rad], positive.

    Parameters
    ----------
    crank, coupler, rocker, frame : Value [m]
    side : int
        Assembly mode: +1 or -1.
    """
    outer, inner = (dead_centre(crank, coupler, rocker, frame, side, outer=which) for which in (True, False))
    return side * angle_from(outer.rocker, inner.rocker)


def time_ratio(
    crank: Value, coupler: Value, rocker: Value, frame: Value, side: int, stroke: str | None = None, sense: Value = 1
) -> Value:
    """Return the duration of one rocker stroke over that of the other at constant crank speed, for a crank-rocker.

    The ratio is (pi + theta) / (pi - theta), with theta the angle between the two directions A -> C at the dead centres; the
    forward stroke is the slow one where theta has the sign of `side * sense`. Both assembly modes have the same strokes: the
    other mode is the mirrored linkage with the crank turning backwards.

    Parameters
    ----------
    crank, coupler, rocker, frame : float, array or symbol [m]
    side : +1 or -1
        Assembly mode.
    stroke : "forward", "backward", "slow", "quick" or None
        Stroke whose duration is the numerator; forward is counter-clockwise; None is the slow one.
    sense : +1 or -1
        Sense of crank rotation, +1 counter-clockwise.
    """
    outer, inner = (dead_centre(crank, coupler, rocker, frame, side, outer=which) for which in (True, False))
    theta = side * sense * angle_from(outer.crank, (-inner.crank[0], -inner.crank[1]))
    if stroke not in ("forward", "backward"):
        theta = magnitude(theta)
    if stroke in ("backward", "quick"):
        theta = -theta
    return (np.pi + theta) / (np.pi - theta)


# --- the four-bar within a linkage of dyads: its crank and a group of two links between the crank and the frame ------------


@dataclass(frozen=True)
class InnerFourBar:
    """Crank, coupler and rocker: `pin` joins crank and coupler, `joint` coupler and rocker, `ground_pin` rocker and frame.

    `pivots`: places of the two pivots on the frame, that of the crank first.
    """

    crank: Link
    coupler: Link
    rocker: Link
    group: RRR
    pin: str
    ground_pin: str
    pivots: tuple[Ground, Ground]

    @property
    def joint(self) -> str:
        """The joint of coupler and rocker."""
        return self.group.joint

    @property
    def side(self) -> int:
        """Assembly mode: +1 if the joint of coupler and rocker lies to the left of the line from `pin` to `ground_pin`."""
        return self.group.side if self.group.outer == (self.pin, self.ground_pin) else -self.group.side

    @property
    def plain(self) -> bool:
        """Whether its joints are the ends of its links, so that the link lengths are those of the four-bar."""
        ends = [{self.crank.start, self.pin}, {self.pin, self.joint}, {self.ground_pin, self.joint}]
        links = (self.crank, self.coupler, self.rocker)
        return all(
            {link.start, link.end} == both and isinstance(link.length, str) for link, both in zip(links, ends, strict=True)
        )

    @property
    def ground(self) -> tuple[str, ...]:
        """Names of the sizes that place its two pivots."""
        sizes = [size for place in self.pivots for size in ((place.length, place.direction) if isinstance(place, Arm) else place)]
        return tuple(size for size in sizes if isinstance(size, str))

    @property
    def names(self) -> tuple[str, str, str]:
        """Names of the lengths of crank, coupler and rocker of a plain four-bar."""
        return str(self.crank.length), str(self.coupler.length), str(self.rocker.length)

    @property
    def frame_length(self) -> str:
        """Name of the size that is the length of the frame; empty if its pivots have coordinates."""
        one, other = self.pivots
        if isinstance(other, Arm):
            return str(other.length)
        return str(other[0]) if one == (0.0, 0.0) and other[1] == 0.0 else ""

    def frame(self, values: Mapping[str, Value]) -> tuple[Value, Vector | None]:
        """Return the length of the frame [m] and the unit vector from crank to rocker pivot; elementwise.

        The direction is relative to that from which crank angles count, None if it is the same.
        """
        if self.frame_length:
            return values[self.frame_length], None
        one, other = self.pivots
        assert not isinstance(one, Arm)
        assert not isinstance(other, Arm)
        dx, dy = (_size(end, values) - _size(begin, values) for begin, end in zip(one, other, strict=True))
        length = np.sqrt(dx * dx + dy * dy)
        return length, (dx / length, dy / length)

    def frame_bounds(self, bounds: Mapping[str, tuple[float, float]]) -> tuple[float, float]:
        """Return the least and largest length of the frame [m] for the bounds of all dimensions [m]."""
        if self.frame_length:
            return bounds[self.frame_length]
        ends = [bounds[name] for name in self.ground]
        least = [max(0.0, first - high, low - last) for (low, high), (first, last) in zip(ends[:2], ends[2:], strict=True)]
        most = [max(last - low, high - first) for (low, high), (first, last) in zip(ends[:2], ends[2:], strict=True)]
        return math.hypot(*least), math.hypot(*most)

    def lengths(self, values: Mapping[str, Value]) -> tuple[Value, Value, Value, Value]:
        """Return the lengths [m] of crank, coupler, rocker and frame of a plain four-bar; elementwise."""
        crank, coupler, rocker = self.names
        return values[crank], values[coupler], values[rocker], self.frame(values)[0]

    def turned(self, values: Mapping[str, Value]) -> Value:
        """Return the angle [rad] of the frame, from crank to rocker pivot, where crank angles count from; elementwise."""
        axis = self.frame(values)[1]
        return 0.0 if axis is None else angle(axis)

    def dead_centre(self, values: Mapping[str, Value], *, outer: bool) -> DeadCentre:
        """Return a limit position of the rocker of a plain four-bar, with the directions of crank and rocker in the plane.

        Parameters
        ----------
        values : mapping of dimension to Value [m]
            Elementwise.
        outer : bool
            Whether crank and coupler are extended, else they overlap.
        """
        axis = self.frame(values)[1]
        limit = dead_centre(*self.lengths(values), self.side, outer)
        return limit if axis is None else DeadCentre(turn(limit.crank, axis), turn(limit.rocker, axis), limit.margin)


def _size(size: Size, values: Mapping[str, Value]) -> Value:
    return values[size] if isinstance(size, str) else size


def whole_four_bar(mechanism: Mechanism) -> InnerFourBar | None:
    """Return the four-bar that a linkage is as a whole, however it is written; None if a joint is not at the end of its link."""
    loop = next(inner_four_bars(mechanism), None) if len(mechanism.groups) == 1 else None
    return loop if loop is not None and loop.plain else None


def inner_four_bars(mechanism: Mechanism) -> Iterator[InnerFourBar]:
    """Yield the four-bars that a crank turns, its angle being the cycle variable, in the order of the groups of a linkage."""
    crank, owners = mechanism.crank, mechanism.owners
    for group in () if mechanism.drives else mechanism.groups:
        if not isinstance(group, RRR):
            continue
        pins = tuple(zip(group.links, group.outer, strict=True))
        for (coupler, pin), (rocker, ground_pin) in (pins, pins[::-1]):
            if crank.body in owners[pin] and FRAME not in owners[pin] and FRAME in owners[ground_pin]:
                pivots = mechanism.ground[crank.start], mechanism.ground[ground_pin]
                yield InnerFourBar(crank, coupler, rocker, group, pin, ground_pin, pivots)
