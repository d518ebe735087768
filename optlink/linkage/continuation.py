"""Analytic continuation of a mechanism through its singular positions, group by group.

On a small circle about a singular position in the complex plane of the crank angle the two assembly modes are well apart. The
mode that arrives from the left is followed round the circle; Cauchy's integral gives its power series about the centre.

References
----------
L. N. Trefethen, J. A. C. Weideman, The exponentially convergent trapezoidal rule, SIAM Review 56 (2014).
"""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from optlink.linkage.dyads import PRP, RPR, ModalDyad
from optlink.linkage.jet import Jet
from optlink.linkage.mechanism import Dyad, GroupPassages, Mechanism, Passage, Pose
from optlink.linkage.singular import AlignedPosition, alignment_grid, alignment_margin, least_alignments
from optlink.linkage.stroke import Ranges, range_grid, reachable
from optlink.linkage.vector2d import TURN, Array, Value, all_finite, turn, unit

NODES = 64
"""Points of a circle; the series has at most half as many terms."""

_THETA = math.pi + TURN * np.arange(NODES) / NODES
CIRCLE = np.exp(1j * _THETA)
"""Points of the unit circle, from the negative real one on."""

LARGEST, LEAST = 0.3, 1e-3
"""Radii [rad] of the circles: halved until the series converges."""

CONVERGED, ROUNDED = 1e-10, 1e-8
"""Shares of the motion on the circle that the last terms and those of negative powers may have."""

NEGLIGIBLE = 1e-18
"""Share of the motion on the circle below which a term of the series is omitted."""

SAME_CENTRE = 1e-9
"""Crank rotation [rad] within which the singular positions of two groups are continued on the same circles."""

SAME_ANGLE = 1e-6
"""Crank rotation [rad] within which a start counts as the singular position itself."""

MOST_TURNS = 8
"""Revolutions after which a motion that does not close is given up."""


class _Crossing(NamedTuple):
    """Passage of a group through a singular position: whether its side changes, and the series if it comes from side +1 or -1."""

    flips: bool
    series: dict[int, Passage]


@np.errstate(all="ignore")
def continue_through_singularities(
    mechanism: Mechanism, sizes: Mapping[str, Value], start: float, *, every: bool = False
) -> Mechanism:
    """Return the mechanism with its groups continued smoothly through their singular positions.

    The assembly modes apply at the crank angle `start` [rad] unless a group sets its own (`holds_at`); if that is a singular
    position, just beyond it, counter-clockwise. Groups without `follow` are continued if `every` is set; one without a smooth
    motion through a singular position is left unchanged. The `cycle` of the result is the crank rotation after which the motion
    repeats.
    """
    starts = [
        (start if group.holds_at is None else group.holds_at)
        if isinstance(group, ModalDyad) and (every or group.follow)
        else None
        for group in mechanism.groups
    ]
    if not any(at is not None for at in starts):
        return mechanism
    course = _Course(replace(mechanism, limits=None), sizes)  # the limits may begin between change points
    for group, at in zip(mechanism.groups, starts, strict=True):
        course.add(group, at)
    return replace(course.mechanism, limits=mechanism.limits)


class _Course:
    """A mechanism whose groups are added and continued one by one, with the poses of all groups so far.

    They are kept on the grids on which the next group is examined, and on the circles about singular positions that groups share,
    so that the effort grows with the number of groups, not with its square.
    """

    def __init__(self, mechanism: Mechanism, sizes: Mapping[str, Value]) -> None:
        self.mechanism, self.sizes, self.count = mechanism, sizes, 0
        self.ranges = Ranges(((0.0, mechanism.cycle),), True)
        self.circles: dict[tuple[float, float], tuple[Pose, int]] = {}
        self._sample()

    def _sample(self) -> None:
        cycle = self.mechanism.cycle
        self.moving, self.still = self._pose(Jet(alignment_grid(0.0, cycle), 1.0)), self._pose(range_grid(0.0, cycle))

    def _pose(self, angles: Value) -> Pose:
        return self._grown(self.mechanism.begin(self.sizes, unit(angles), angles), 0)

    def _grown(self, pose: Pose, count: int) -> Pose:
        """Return a pose with the groups that it lacks."""
        for group in self.mechanism.groups[count : self.count]:
            pose.add(group)
        return pose

    def add(self, group: Dyad, start: float | None) -> None:
        """Add the next group, continued from its mode at the crank angle `start` unless that is None."""
        groups, k = self.mechanism.groups, self.count
        joints = {"", *(g.joint for g in groups[: k + 1])}
        trains = tuple(train for train in self.mechanism.trains if train.after in joints)
        part = replace(self.mechanism, groups=groups[: k + 1], points=(), trains=trains)
        part = replace(part, points=tuple(point for point in self.mechanism.points if point.body in part.bodies))
        aligned = least_alignments(part, self.sizes, self.moving.with_group(group))
        if self.ranges.full and self._closes(part, aligned):
            self.ranges = Ranges(((0.0, part.cycle),), True)
        elif self.ranges.full or start is not None:
            self.ranges = reachable(part, self.sizes)
        if start is not None and isinstance(group, ModalDyad):
            passages = self._passages(group, [p for p in aligned if p.singular], start)
            if passages is not None:
                group, cycle = replace(group, passages=passages), max(part.cycle, passages.cycle)
                self.mechanism = replace(self.mechanism, groups=(*groups[:k], group, *groups[k + 1 :]), cycle=cycle)
        self.count += 1
        if self.mechanism.cycle > part.cycle:
            self._sample()
        else:
            self.moving, self.still = self._grown(self.moving, k), self._grown(self.still, k)

    def _closes(self, part: Mechanism, aligned: list[AlignedPosition]) -> bool:
        """Whether the last group of a mechanism closes at all crank angles, like those before it."""
        group = part.groups[-1]
        if isinstance(group, PRP):  # its lines may become parallel
            return False
        lowest = np.array([p.crank_angle for p in aligned if not p.singular])
        poses = [self.still.with_group(group), *([part.at(self.sizes, lowest)] if lowest.size else [])]
        return all(bool(np.all(alignment_margin(pose, [group]) >= 0.0)) for pose in poses)

    def _passages(self, group: ModalDyad, aligned: list[AlignedPosition], start: float) -> GroupPassages | None:
        """Sides and passages of the next group, from the crank angle at which its mode applies."""
        ranges, cycle = self.ranges, self.mechanism.cycle
        holding = (start, start + cycle) if ranges.full else ranges.holding(start)
        if not aligned or holding is None:
            return None
        origin = start if ranges.full else 0.5 * (holding[0] + holding[1]) - 0.5 * cycle
        known = [at for at, _ in self.circles]  # centres of earlier groups
        ahead = []
        for position in aligned:
            centre = next((at for at in known if abs(at - position.crank_angle) < SAME_CENTRE), position.crank_angle)
            crossing = self._crossing(group, centre)
            if crossing is None:
                return None
            distance = (centre - origin) % cycle
            if ranges.full and (distance < SAME_ANGLE or distance > cycle - SAME_ANGLE):
                distance = cycle  # at the origin of a closed motion
            ahead.append((distance, crossing))
        ahead.sort(key=lambda pair: pair[0])
        turns = 2 if ranges.full and sum(crossing.flips for _, crossing in ahead) % 2 else 1
        if turns * cycle > MOST_TURNS * TURN:
            return None
        ahead = [(at + turn * cycle, crossing) for turn in range(turns) for at, crossing in ahead]
        breaks = np.array([origin + at for at, _ in ahead])
        flips = np.cumprod([1, *(-1 if crossing.flips else 1 for _, crossing in ahead)])
        sides = flips * (group.side * flips[np.searchsorted(breaks, start + SAME_ANGLE, side="right") if not ranges.full else 0])
        passages = tuple(
            replace(crossing.series[int(side)], crank_angle=float(at))
            for at, (_, crossing), side in zip(breaks, ahead, sides[:-1], strict=True)
        )
        return GroupPassages(origin, turns * cycle, breaks, sides, passages)

    def _crossing(self, group: ModalDyad, at: float) -> _Crossing | None:
        """Continue a group through a singular position, on the largest circle on which its motion is a power series."""
        powers = np.arange(-NODES // 2, NODES // 2)
        transform = np.exp(-1j * np.outer(_THETA, powers)) / NODES
        radius = LARGEST
        while radius >= LEAST:
            places = [self._places(replace(group, side=side), at, radius) for side in (1, -1)]
            middle, half = 0.5 * (places[0] + places[1]), 0.5 * (places[0] - places[1])
            sense = np.sign(np.real(np.sum(np.conj(half) * np.roll(half, -1, axis=1), axis=0)))  # from each point to the next
            ways = np.cumprod([1.0, *sense[:-1]])
            if all_finite(half) and sense[-1] * ways[-1] > 0.0:
                series, size = {}, np.max(np.abs([half, middle - np.mean(middle, axis=1, keepdims=True)]))
                for side in (1, -1):
                    terms = (middle + side * ways * half) @ transform
                    last, negative = np.abs(terms[:, -NODES // 8 :]), np.abs(terms[:, powers < 0])
                    if np.max(last) <= CONVERGED * size and np.max(negative) <= ROUNDED * size:
                        series[side] = Passage(at, 0.5 * radius, _significant(np.real(terms[:, powers >= 0]), size, radius))
                if len(series) == 2:
                    return _Crossing(bool(ways[NODES // 2] < 0.0), series)
            radius *= 0.5
        return None

    def _places(self, group: ModalDyad, at: float, radius: float) -> NDArray[np.complex128]:
        """Solution of the next group on a circle of complex crank angles: its joint, or the direction of its guide."""
        pose, count = self.circles.get((at, radius)) or (self._pose(at + radius * CIRCLE), self.count)
        pose = self._grown(pose, count)
        self.circles[at, radius] = pose, self.count
        pose = pose.with_group(group)
        if isinstance(group, RPR):
            coordinates = turn(pose.direction(group.first.body), pose.local_line(group.inner, group.first.body)[1])
        else:
            coordinates = pose.point(group.joint)
        return np.array([np.broadcast_to(x, CIRCLE.shape) for x in coordinates], dtype=complex)


def _significant(terms: Array, size: float, radius: float) -> Array:
    """Return the coefficients of a power series (2, terms) without the last ones that are nothing within the window.

    `terms`: those at the distance `radius`, which is twice the window.
    """
    powers = np.arange(terms.shape[1])
    count = 1 + int(np.max(np.flatnonzero(np.max(np.abs(terms), axis=0) * 0.5**powers > NEGLIGIBLE * size), initial=0))
    return terms[:, :count] / radius ** powers[:count].astype(float)
