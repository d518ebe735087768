"""Assembly modes given by the place of a joint where the drive starts: `near [12 mm, 40 mm]`."""

import math
import re
from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from optlink.linkage.assur import CONTINUE
from optlink.linkage.mechanism import Dyad, Mechanism, Pose
from optlink.linkage.vector2d import unit
from optlink.problem.quantity import Unusable, read_quantity

_PLACE = re.compile(r"near\s*\[([^\[\],]*),([^\[\],]*)\]\s*(?:,\s*(\w+))?")
NEAR = 0.25
"""Largest distance of a place from a position of a joint that is near it, as a share of the distance of its two positions."""


class NearPlace(NamedTuple):
    """Place [m] near which a joint lies where the drive starts, and whether its group is continued through change points."""

    x: float
    y: float
    follow: bool
    words: str


def read_near(words: object) -> NearPlace | None:
    """Return the place that an assembly mode states; None for a mode in other words.

    Raises
    ------
    Unusable
    """
    if not isinstance(words, str) or not words.strip().lower().startswith("near"):
        return None
    match = _PLACE.fullmatch(words.strip())
    if match is None or match[3] not in (None, CONTINUE):
        remedy = f'Write "near [12 mm, 40 mm]" or "near [12 mm, 40 mm], {CONTINUE}"'
        raise Unusable("this is not the place of a joint", remedy, value=words)
    x, y = (read_quantity(coordinate.strip(), "coordinate").value for coordinate in match.groups()[:2])
    return NearPlace(x, y, match[3] is not None, words)


def nearest_modes(
    mechanism: Mechanism, sizes: Mapping[str, float], start: float, places: Mapping[str, NearPlace]
) -> dict[str, str]:
    """Return the assembly modes, by joint, in which the joints lie nearest to their places where the drive starts [rad].

    Raises
    ------
    Unusable
        If a place is near neither position of its joint, or the joint has no two positions; the key is the joint.
    """
    modes = {}
    with np.errstate(all="ignore"):
        pose = mechanism.begin(sizes, unit(start), start)
        for group in mechanism.groups:
            if group.joint in places:
                group, modes[group.joint] = _nearest(pose, group, places[group.joint])
            pose.add(group)
    return modes


def _nearest(pose: Pose, group: Dyad, near: NearPlace) -> tuple[Dyad, str]:
    """Return a group with the assembly mode in which its joint is nearest to a place, and that mode."""
    where = f"where the drive starts (crank angle {math.degrees(pose.angle):.6g} deg)"
    if group.joint not in pose.mechanism.owners:
        remedy = f'Write "{group.modes[0]}" or "{group.modes[1]}"'
        raise Unusable("this is a guide, and near states the place of a pin joint", remedy, group.joint, near.words)
    both = [replace(group, side=side) for side in (1, -1)]  # type: ignore[call-arg]
    points = [tuple(float(x) for x in pose.with_group(one).point(group.joint)) for one in both]
    if not np.all(np.isfinite(points)):
        message = f"{group.joint} has no position {where}: its group cannot be assembled there"
        raise Unusable(
            message,
            "Start the drive at another angle, change the dimensions, or state the mode in words",
            group.joint,
            near.words,
        )
    distances = [math.hypot(x - near.x, y - near.y) for x, y in points]
    suffix = f", {CONTINUE}" if near.follow else ""
    texts = [f"[{1e3 * x:.6g} mm, {1e3 * y:.6g} mm]" for x, y in points]
    k = int(distances[1] < distances[0])
    if not distances[k] <= NEAR * math.dist(*points):
        message = (
            f"{group.joint} lies at {texts[0]} or {texts[1]} {where}, and this is near neither: "
            f"the distance from one of them must be at most {NEAR:g} times their distance from each other"
        )
        remedy = " or ".join(f'"near {text}{suffix}"' for text in texts)
        raise Unusable(message, f"Write {remedy}", group.joint, near.words)
    return both[k], group.modes[k] + suffix
