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

from optlink.linkage.alignment import AlignedPosition, least_alignments
from optlink.linkage.dyad_types import RPR, ModalDyad
from optlink.linkage.mechanism import Mechanism
from optlink.linkage.passage import GroupPassages, Passage
from optlink.linkage.stroke import reachable
from optlink.linkage.vector2d import TURN, Value, turn

NODES = 64
"""Points of a circle; the series has half as many terms."""

LARGEST, LEAST = 0.3, 1e-3
"""Radii [rad] of the circles: halved until the series converges."""

CONVERGED, ROUNDED = 1e-10, 1e-8
"""Shares of the motion on the circle that the last terms and those of negative powers may have."""

SAME_ANGLE = 1e-6
"""Crank rotation [rad] within which a start counts as the singular position itself."""

MOST_TURNS = 8
"""Revolutions after which a motion that does not close is given up."""


class _Crossing(NamedTuple):
    """Passage of a group through a singular position: whether its side changes, and the series if it comes from side +1 or -1."""

    flips: bool
    series: dict[int, Passage]


def continue_through_singularities(
    mechanism: Mechanism, sizes: Mapping[str, Value], start: float, *, every: bool = False
) -> Mechanism:
    """Return the mechanism with its groups continued smoothly through their singular positions.

    Parameters
    ----------
    mechanism : Mechanism
    sizes : mapping of parameter name to float [m, rad]
    start : float [rad]
        Crank angle at which the assembly modes apply, unless a group sets its own (`holds_at`). If it is a singular position,
        they apply just beyond it, counter-clockwise.
    every : bool
        Continue every group, not only those with `follow`.

    Returns
    -------
    Mechanism, its `cycle` the crank rotation after which the motion repeats; a group without a smooth motion through a
    singular position is left unchanged
    """
    for k, group in enumerate(mechanism.groups):
        if isinstance(group, ModalDyad) and (every or group.follow):
            bodies = {link.body for g in mechanism.groups[: k + 1] for link in g.links} | {mechanism.crank.body}
            points = tuple(point for point in mechanism.points if point.body in bodies)
            part = replace(mechanism, groups=mechanism.groups[: k + 1], points=points)
            passages = _course(part, sizes, group, start if group.holds_at is None else group.holds_at)
            if passages is not None:
                groups = (*mechanism.groups[:k], replace(group, passages=passages), *mechanism.groups[k + 1 :])
                mechanism = replace(mechanism, groups=groups, cycle=max(mechanism.cycle, passages.cycle))
    return mechanism


def _course(part: Mechanism, sizes: Mapping[str, Value], group: ModalDyad, start: float) -> GroupPassages | None:
    """Sides and passages of the last group of a mechanism, from the crank angle at which its mode applies."""
    ranges, cycle = reachable(part, sizes), part.cycle
    aligned = [p for p in least_alignments(part, sizes) if p.group is group and p.singular]
    holding = (start, start + cycle) if ranges.full else ranges.holding(start)
    if not aligned or holding is None:
        return None
    crossings = [_crossing(part, sizes, group, p) for p in aligned]
    known_crossings = [(p.crank_angle, crossing) for p, crossing in zip(aligned, crossings, strict=True) if crossing is not None]
    if len(known_crossings) < len(aligned):
        return None
    origin = start if ranges.full else 0.5 * (holding[0] + holding[1]) - 0.5 * cycle
    ahead = sorted(
        ((_ahead(at, origin, cycle, closed=ranges.full), crossing) for at, crossing in known_crossings), key=lambda pair: pair[0]
    )
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


def _ahead(at: float, origin: float, cycle: float, *, closed: bool) -> float:
    """Return the distance [rad] of a crank angle ahead of the origin; one cycle, not zero, at the origin of a closed motion."""
    distance = (at - origin) % cycle
    return cycle if closed and (distance < SAME_ANGLE or distance > cycle - SAME_ANGLE) else distance


def _crossing(part: Mechanism, sizes: Mapping[str, Value], group: ModalDyad, at: AlignedPosition) -> _Crossing | None:
    """Continue a group through a singular position, on the largest circle on which its motion is a power series."""
    theta = math.pi + TURN * np.arange(NODES) / NODES
    circle = np.exp(1j * theta)
    powers = np.arange(-NODES // 2, NODES // 2)
    transform = np.exp(-1j * np.outer(theta, powers)) / NODES
    radius = LARGEST
    while radius >= LEAST:
        places = [_places(part, sizes, replace(group, side=side), at.crank_angle + radius * circle) for side in (1, -1)]
        middle, half = 0.5 * (places[0] + places[1]), 0.5 * (places[0] - places[1])
        sense = np.sign(np.real(np.sum(np.conj(half) * np.roll(half, -1, axis=1), axis=0)))  # from each point to the next
        ways = np.cumprod([1.0, *sense[:-1]])
        if np.all(np.isfinite(half)) and sense[-1] * ways[-1] > 0.0:
            series, size = {}, np.max(np.abs([half, middle - np.mean(middle, axis=1, keepdims=True)]))
            for side in (1, -1):
                terms = (middle + side * ways * half) @ transform
                last, negative = np.abs(terms[:, -NODES // 8 :]), np.abs(terms[:, powers < 0])
                if np.max(last) <= CONVERGED * size and np.max(negative) <= ROUNDED * size:
                    scale = radius ** powers[powers >= 0].astype(float)
                    series[side] = Passage(at.crank_angle, 0.5 * radius, np.real(terms[:, powers >= 0]) / scale)
            if len(series) == 2:
                return _Crossing(bool(ways[NODES // 2] < 0.0), series)
        radius *= 0.5
    return None


def _places(
    part: Mechanism, sizes: Mapping[str, Value], group: ModalDyad, angles: NDArray[np.complex128]
) -> NDArray[np.complex128]:
    """Solution of the group at complex crank angles: the coordinates of its joint, or the direction of its guide."""
    with np.errstate(all="ignore"):
        pose = replace(part, groups=(*part.groups[:-1], group)).at(sizes, angles)
        if isinstance(group, RPR):
            coordinates = turn(pose.direction(group.first.body), pose.local_line(group.inner, group.first.body)[1])
        else:
            coordinates = pose.point(group.joint)
    return np.array([np.broadcast_to(x, angles.shape) for x in coordinates], dtype=complex)
