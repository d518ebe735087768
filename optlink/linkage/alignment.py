"""Alignment of the groups of a mechanism: singular positions (change points) and positions close to them.

Where the alignment of a group is zero its assembly modes meet: the position is singular, and the mechanism may leave it in
either mode.
"""

import math
from collections.abc import Iterable, Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from optlink.linkage.extrema import in_portions
from optlink.linkage.jet import Jet, as_jet
from optlink.linkage.margins import NEAR_ALIGNMENT, SINGULAR_ALIGNMENT
from optlink.linkage.mechanism import Dyad, Mechanism, Pose
from optlink.linkage.vector2d import TURN, Array, Value
from optlink.linkage.zeros import zeros

GRID = 1440
"""Positions per revolution between which each least alignment is bracketed."""

TOUCHING = math.sin(SINGULAR_ALIGNMENT) ** 2
"""Alignment (a squared sine) up to which a position is singular; a negative one of that size is rounding."""

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

    def __str__(self) -> str:
        return f"{math.degrees(self.crank_angle):.6g} deg ({self.group.kind} group of {self.group.joint})"


def positions_text(positions: Iterable[AlignedPosition]) -> str:
    """Return the crank angles and groups of positions as one comma-separated text."""
    return ", ".join(str(position) for position in positions)


def angles_text(angles: Array) -> str:
    """Return crank angles [rad] in degrees as one comma-separated text, the first six of them."""
    return ", ".join(f"{math.degrees(angle):.6g}" for angle in angles[:6]) + (" ..." if len(angles) > 6 else "") + " deg"


def squared_sines(pose: Pose) -> Array:
    """Return the alignment [-] of every group, array (groups, n); NaN for the groups that follow one that cannot be assembled."""
    shape = np.shape(as_jet(pose.directions[pose.mechanism.crank.body][0]).value)
    with np.errstate(all="ignore"):
        alignments = [np.broadcast_to(as_jet(group.alignment(pose)).value, shape) for group in pose.mechanism.groups]
    return np.array(alignments, dtype=float).reshape(-1, *shape)


def alignment_margin(pose: Pose) -> Array:
    """Return the least alignment of all groups above its limit [-], array (n,); negative, never NaN, if one fails to close."""
    groups = zip(pose.mechanism.groups, squared_sines(pose), strict=True)  # parallel lines meet nowhere
    return least_margin(pose, (sines - group.least if group.least > 0.0 else sines + TOUCHING for group, sines in groups))


def least_margin(pose: Pose, margins: Iterable[Array]) -> Array:
    """Return the least margin of all groups [-], array (n,); the first that fails to close counts -1, its followers nothing.

    Parameters
    ----------
    pose : Pose
    margins : iterable of array (n,)
        That of each group; NaN where it or one before it cannot be assembled.
    """
    least = np.full(np.shape(as_jet(pose.directions[pose.mechanism.crank.body][0]).value), np.inf)
    for margin in margins:
        least = np.minimum(least, np.where(np.isnan(margin), np.where(least < 0.0, np.inf, -1.0), margin))
    return least


def least_alignments(mechanism: Mechanism, sizes: Mapping[str, Value]) -> list[AlignedPosition]:
    """Return the positions of one cycle in which a group comes within `NEAR_ALIGNMENT` of alignment, each at the least angle.

    Parameters
    ----------
    mechanism : Mechanism
    sizes : mapping of parameter name to float [m, rad]

    Returns
    -------
    list of Aligned, in the order of the groups and of the crank angle
    """
    if not mechanism.groups:
        return []
    step = TURN / GRID
    grid = np.arange(-0.37 * step, mechanism.cycle + step, step)  # so that round crank angles lie between its points

    def moving(angles: Array) -> Pose:
        with np.errstate(all="ignore"):
            return mechanism.at(sizes, Jet(angles, 1.0))

    def rates(angles: Array) -> Array:
        pose = moving(angles)
        with np.errstate(all="ignore"):
            derivatives = [as_jet(group.alignment(pose)).rate for group in mechanism.groups]
        return np.array([np.broadcast_to(rate, angles.shape) for rate in derivatives])

    samples = in_portions(rates, grid)
    still = np.max(np.nan_to_num(np.abs(samples), posinf=0.0), axis=1, initial=0.0) <= _STILL

    def sines(angles: Array) -> Array:
        with np.errstate(all="ignore"):
            return squared_sines(mechanism.at(sizes, angles))

    angles_by_group = zeros(rates, grid, still=True, samples=samples)
    which = np.repeat(np.arange(len(angles_by_group)), [len(angles) for angles in angles_by_group])
    at = np.concatenate(angles_by_group)
    valid = (at >= -1e-9) & (at < mechanism.cycle - 1e-9) & ~still[which]
    at, which = at[valid], which[valid]
    if not at.size:
        return []
    before, least, after = (in_portions(sines, at + aside, which) for aside in (-_ASIDE, 0.0, _ASIDE))
    lowest = (least <= before) & (least <= after) & (least < math.sin(NEAR_ALIGNMENT) ** 2) & (least >= -TOUCHING)
    return [
        AlignedPosition(0.0 if abs(angle) < 1e-9 else float(angle), mechanism.groups[k], math.asin(math.sqrt(max(sine, 0.0))))
        for angle, k, sine in zip(at[lowest], which[lowest], least[lowest], strict=True)
    ]


def near_singular(pose: Pose, crank_angle: Array) -> NDArray[np.bool_]:
    """Return which designs (designs,) may have a singular position, from the alignment of their groups at sampled crank angles.

    Parameters
    ----------
    pose : Pose
        Pose of the designs (designs, 1) at these crank angles, at a crank speed of 1 rad/s.
    crank_angle : array (angles,) [rad]
        Evenly spaced over a revolution, the last one step before the first.

    Notes
    -----
    Between two samples, where the alignment has a minimum and is convex, it lies above the intersection of its two tangents.
    """
    step, count = crank_angle[1] - crank_angle[0], len(crank_angle)
    shape = np.broadcast_shapes(*(np.shape(as_jet(margin).value) for margin in pose.margins.values()), (1, count))
    near = np.zeros(shape[0], dtype=bool)
    with np.errstate(all="ignore"):
        for group in pose.mechanism.groups:
            alignment = as_jet(group.alignment(pose))
            sines, rates = (np.broadcast_to(part, shape) for part in (alignment.value, alignment.rate))
            after, rates_after = np.roll(sines, -1, axis=1), np.roll(rates, -1, axis=1)
            along = np.clip((after - sines - rates_after * step) / (rates - rates_after), min(0.0, step), max(0.0, step))
            least = np.where(rates * step < 0.0, np.where(rates_after * step > 0.0, sines + rates * along, sines), sines)
            near |= np.any((least <= TOUCHING) & (sines >= -TOUCHING) & (after >= -TOUCHING), axis=1)
    return near
