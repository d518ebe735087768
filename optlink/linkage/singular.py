"""Alignment of the groups of a mechanism: singular positions (change points) and positions close to them.

Where the alignment of a group is zero its assembly modes meet: the position is singular, and the mechanism may leave it in
either mode.
"""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from optlink.linkage.extrema import in_portions, own_values, zeros
from optlink.linkage.jet import Jet, as_jet
from optlink.linkage.mechanism import Dyad, Mechanism, Pose
from optlink.linkage.vector2d import TURN, Array, Value

# Default limits of the distance from singular positions, where a mechanism locks or may change its branch.
#
# They are the defaults of limits in the problem file, for output laws, paths, poses and cycles alike; a user may set other
# values above zero. The validator uses the same values but measures them in motion, by independent formulas.
#
# References
# ---------- ISO 286-1:2010, table 1: grade IT5 allows 15 um at 100 mm, 1.5e-4 of the length.

LEAST_ALIGNMENT = math.radians(1.0)
"""Least angle [rad] of a joint between two bodies from alignment, so a transmission angle from 1 to 179 deg.

Between two links it is their transmission angle, or 180 deg less it; of a link and a slider the angle of the link from the normal
of the slider's line, likewise; of two guides the angle between their lines; of a swinging guide the angle whose sine is its
slide over the crank. At 1 deg a force is passed on 57 times as large, and
lengths that are 1.5e-4 off (grade IT5) bring the joint into alignment: closer, no drawing could be built.
"""

LEAST_LENGTH_MARGIN = 1e-4
"""Least difference of lengths, as a share of the longest link, where equal ones mean a change point or a point of no direction.

It holds for Grashof's sums (longest + shortest link below the other two), and for coupler and crank where the motion starts at
its inner dead centre (the coupler pin would lie on the crank pivot).
"""

SINGULAR_ALIGNMENT = math.radians(0.001)
"""Angle [rad] of a joint from alignment below which a position counts as singular when a given machine is analysed.

It is far above rounding (double precision leaves about 1e-6 deg) and far below what can be built: lengths would have to agree to
1.5e-10 of their size. A loop that fails to close by no more than that counts as closed, in a singular position.
"""

NEAR_ALIGNMENT = math.radians(5.0)
"""Angle [rad] of a joint from alignment below which an analysis reports the position, as forces and accelerations peak there."""

SMALLEST_ALIGNMENT = math.radians(0.1)
"""Least value [rad] that a problem may set for the alignment: below it a solver's accuracy would decide."""

SMALLEST_LENGTH_MARGIN = 1e-5
"""Least value that a problem may set for the length margin."""

FIXED_LIMIT_TOLERANCE = 1e-9
"""Violation [m, rad or 1] above which a limit that no design variable changes counts as violated, far above rounding errors."""


GRID = 1440
"""Positions per revolution between which each least alignment, end of a range and dead centre is bracketed."""

TOUCHING = math.sin(SINGULAR_ALIGNMENT) ** 2
"""Alignment (a squared sine) up to which a position is singular; a negative one of that size is rounding."""

STRIDE = math.radians(10.0)
"""Angle [rad] by which a body turns between two of the positions at which most designs are seen to be clear of singular ones."""

_STILL = 1e-12  # rate of an alignment over the crank angle that is rounding
_ASIDE = 1e-3  # [rad]: so far on either side of a least alignment the alignment is larger


class AlignedPosition(NamedTuple):
    """Position in which a group comes closest to alignment: crank angle [rad] and angle from alignment [rad]."""

    crank_angle: float
    group: Dyad
    angle: float

    @property
    def singular(self) -> bool:
        """Whether the assembly modes meet at this position."""
        return self.angle <= SINGULAR_ALIGNMENT * (1.0 + 1e-9)

    @property
    def followed(self) -> bool:
        """Whether the group is continued smoothly through the position, so that its motion is determined."""
        return self.group.passages is not None


def positions_text(positions: Iterable[AlignedPosition], text: Callable[[float], str]) -> str:
    """Return positions as one comma-separated text, each with all groups that have one there; `text` names one [rad]."""
    joints: dict[tuple[str, str], list[str]] = {}
    for position in positions:
        joints.setdefault((text(position.crank_angle), position.group.kind), []).append(position.group.joint)
    return ", ".join(
        f"{angle} ({kind} group{'s' if len(names) > 1 else ''} of {', '.join(names)})" for (angle, kind), names in joints.items()
    )


def squared_sines(pose: Pose, groups: Sequence[Dyad] | None = None) -> Array:
    """Return the alignment [-] of groups, by default all, array (groups, n); NaN for those that follow one that cannot close."""
    shape = pose.shape
    with np.errstate(all="ignore"):
        alignments = [np.broadcast_to(as_jet(group.alignment(pose)).value, shape) for group in groups or pose.mechanism.groups]
    return np.array(alignments, dtype=float).reshape(-1, *shape)


def alignment_margin(pose: Pose, groups: Sequence[Dyad] | None = None) -> Array:
    """Return the least alignment of groups above its limit [-], array (n,); negative, never NaN, if one fails to close."""
    by_group = zip(groups or pose.mechanism.groups, squared_sines(pose, groups), strict=True)  # parallel lines meet nowhere
    return least_margin(pose, (sines - group.least if group.least > 0.0 else sines + TOUCHING for group, sines in by_group))


def least_margin(pose: Pose, margins: Iterable[Array]) -> Array:
    """Return the least of the margins of all groups [-], array (n,), each NaN where it or one before it cannot close.

    The first that fails to close counts -1, its followers nothing.
    """
    least = np.full(pose.shape, np.inf)
    for margin in margins:
        least = np.minimum(least, np.where(np.isnan(margin), np.where(least < 0.0, np.inf, -1.0), margin))
    return least


def alignment_grid(low: float, high: float) -> Array:
    """Return the crank angles [rad] between which the least alignments are bracketed, so that round ones lie between them.

    They go from before `low` to beyond `high`, and are `GRID` or more.
    """
    step = min(TURN, high - low) / GRID
    return np.arange(low - 0.37 * step, high + step, step)


@np.errstate(all="ignore")
def least_alignments(mechanism: Mechanism, sizes: Mapping[str, Value], last: Pose | None = None) -> list[AlignedPosition]:
    """Return the positions of one cycle, or within the limits of the motion, in which a group is near alignment.

    It then comes within `NEAR_ALIGNMENT` of it, at the least angle. They are in the order of the groups and of the crank angle.
    With `last`, the pose at the crank angles of `alignment_grid` at a crank speed of 1 rad/s, only those of the last group are
    sought.
    """
    groups = mechanism.groups if last is None else mechanism.groups[-1:]
    if not groups:
        return []
    begin, end = mechanism.limits or (0.0, mechanism.cycle)
    grid = alignment_grid(begin, end)

    def rates(angles: Array, pose: Pose | None = None) -> Array:
        moving = pose or mechanism.at(sizes, Jet(angles, 1.0))
        return np.array([np.broadcast_to(as_jet(group.alignment(moving)).rate, angles.shape) for group in groups])

    samples = in_portions(rates, grid) if last is None else rates(grid, last)
    still = np.max(np.nan_to_num(np.abs(samples), posinf=0.0), axis=1, initial=0.0) <= _STILL

    def slope(k: int, angle: float) -> tuple[float, float]:
        alignment = as_jet(groups[k].alignment(mechanism.at(sizes, Jet(angle, 1.0))))
        return float(alignment.rate), float(alignment.acceleration)

    # Newton's method takes a few poses of all groups; for many groups at once the others are cheaper in one array
    angles_by_group = zeros(rates, grid, still=True, rising=True, slope=None if last is None else slope, samples=samples)
    which = np.repeat(np.arange(len(angles_by_group)), [len(angles) for angles in angles_by_group])
    at = np.concatenate(angles_by_group)
    valid = (at >= begin - 1e-9) & (at < end + (-1e-9 if mechanism.limits is None else 1e-9)) & ~still[which]
    at, which = at[valid], which[valid]
    if not at.size:
        return []
    beside = np.concatenate([at + aside for aside in (-_ASIDE, 0.0, _ASIDE)])
    every = own_values(
        lambda angles, rows: squared_sines(mechanism.at(sizes, angles), groups)[rows], beside, np.tile(which, 3), len(groups)
    )
    before, least, after = every.reshape(3, -1)
    lowest = (least <= before) & (least <= after) & (least < math.sin(NEAR_ALIGNMENT) ** 2) & (least >= -TOUCHING)
    return [
        AlignedPosition(0.0 if abs(angle) < 1e-9 else float(angle), groups[k], math.asin(math.sqrt(max(sine, 0.0))))
        for angle, k, sine in zip(at[lowest], which[lowest], least[lowest], strict=True)
    ]


def near_singular(pose: Pose) -> NDArray[np.bool_]:
    """Return which designs (designs,) may have a singular position, from the alignment of their groups at sampled crank angles.

    The pose is that of the designs (designs, 1) at a crank speed of 1 rad/s; the crank angles [rad] are evenly spaced over a
    revolution, the last one step before the first. Between two samples, where the alignment has a minimum and is convex, it lies
    above the intersection of its two tangents.
    """
    crank_angle, near = as_jet(pose.angle).value, np.zeros(1, dtype=bool)
    step = crank_angle[1] - crank_angle[0]
    with np.errstate(all="ignore"):
        for group in pose.mechanism.groups:
            alignment = as_jet(group.alignment(pose))
            sines, rates, _ = np.broadcast_arrays(alignment.value, alignment.rate, crank_angle[None])
            after, rates_after = np.roll(sines, -1, axis=1), np.roll(rates, -1, axis=1)
            along = np.clip((after - sines - rates_after * step) / (rates - rates_after), min(0.0, step), max(0.0, step))
            least = np.where(rates * step < 0.0, np.where(rates_after * step > 0.0, sines + rates * along, sines), sines)
            near = near | np.any((least <= TOUCHING) & (sines >= -TOUCHING) & (after >= -TOUCHING), axis=1)
    return near


def strides(pose: Pose) -> Array:
    """Return those crank angles [rad] of a pose between which no body turns much further than `STRIDE`; all if it has gaps."""
    crank_angle = np.asarray(pose.angle)
    with np.errstate(all="ignore"):
        parts = (map(as_jet, pose.direction(body)) for body in pose.mechanism.bodies)
        turns = [np.hypot(*(np.diff(np.broadcast_to(part.value, crank_angle.shape)) for part in pair)) for pair in parts]
    travel = np.append(0.0, np.cumsum(np.max(turns, axis=0)))
    if not np.isfinite(travel[-1]):
        return crank_angle
    marks = np.linspace(0.0, travel[-1], 2 + math.ceil(travel[-1] / STRIDE))
    return crank_angle[np.unique(np.searchsorted(travel, marks))]


def near_alignment(pose: Pose) -> NDArray[np.bool_]:
    """Return which designs (designs,) may have a singular position, from the alignment of their groups at `strides`.

    That of the others would have to fall to zero and rise again between two of them, faster than it changes between any two, and
    while no body turns much further than `STRIDE`: the strides may be those of another design.
    """
    near = np.zeros(1, dtype=bool)
    with np.errstate(all="ignore"):
        for body in pose.mechanism.bodies:
            turns = (np.diff(np.atleast_2d(as_jet(part).value)) for part in pose.direction(body))
            near = near | np.any(~(np.hypot(*turns) <= 2.0 * STRIDE), axis=1)
        for group in pose.mechanism.groups:
            sines = np.atleast_2d(as_jet(group.alignment(pose)).value)
            near = near | ~(np.min(sines, axis=1) - np.max(np.abs(np.diff(sines)), axis=1, initial=0.0) > TOUCHING)
    return near
