"""Closed-form four-bar theory, elementwise: Grashof conditions, dead centres, transmission angle, swing angle, time ratio.

Conventions: crank pivot A = (0, 0), rocker pivot D = (frame, 0); crank A-B, coupler B-C, rocker D-C; crank angle phi and
rocker angle psi counter-clockwise from A -> D. Assembly mode +1: C to the left of B -> D (above it where D lies to the right).
The transmission angle gamma is the angle B-C-D between coupler and rocker, 0 ... pi.
"""

import enum
import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from optlink.errors import InputError
from optlink.linkage.arguments import check_length, check_number, check_point_names, check_side
from optlink.linkage.dyad_types import RRR
from optlink.linkage.mechanism import Arm, BodyPoint, Link, Mechanism
from optlink.linkage.vector2d import Value, Vector, angle, angle_from, magnitude, root

LENGTHS = ("crank", "coupler", "rocker", "frame")


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
        If `side` is neither +1 nor -1, or a point has no name of its own.

    Examples
    --------
    >>> mechanism = optlink.four_bar(points=["P"])
    >>> sizes = {"crank": 0.1, "coupler": 0.4, "rocker": 0.25, "frame": 0.5, "P.along": 0.2, "P.across": 0.1}  # [m]
    >>> optlink.sweep(mechanism, sizes, np.radians([0.0, 90.0])).position("P").round(4)  # x, y [m]
    array([[0.2016, 0.1992],
           [0.1607, 0.2555]])
    """
    check_side(side)
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


@dataclass(frozen=True)
class GrashofClass:
    """Inversion and Grashof slack p + q - s - l [m], which is positive where the shortest link turns fully."""

    inversion: Inversion
    slack: float


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
    >>> result = optlink.grashof(crank=0.1, coupler=0.4, rocker=0.25, frame=0.5)
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
    lengths = {"crank": crank, "coupler": coupler, "rocker": rocker, "frame": frame}
    if not all(map(math.isfinite, lengths.values())):  # a NaN would compare as any class
        return GrashofClass(Inversion.IMPOSSIBLE, math.nan)
    shortest, short, long, longest = sorted(lengths.values())
    slack = short + long - shortest - longest
    tiny = tolerance * longest
    if longest > shortest + short + long + tiny:
        return GrashofClass(Inversion.IMPOSSIBLE, slack)
    if slack < -tiny:
        return GrashofClass(Inversion.TRIPLE_ROCKER, slack)
    if slack <= tiny:

        def equal(a: float, b: float) -> bool:
            return abs(a - b) <= tiny

        if equal(crank, rocker) and equal(coupler, frame):
            return GrashofClass(Inversion.PARALLELOGRAM, slack)
        if (equal(crank, coupler) and equal(rocker, frame)) or (equal(crank, frame) and equal(coupler, rocker)):
            return GrashofClass(Inversion.KITE, slack)
        return GrashofClass(Inversion.CHANGE_POINT, slack)
    by_shortest = {
        "crank": Inversion.CRANK_ROCKER,
        "frame": Inversion.DOUBLE_CRANK,
        "coupler": Inversion.DOUBLE_ROCKER,
        "rocker": Inversion.ROCKER_CRANK,
    }
    return GrashofClass(by_shortest[min(lengths, key=lambda name: lengths[name])], slack)


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
