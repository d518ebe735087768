"""Geometry of a design in motion [mm, deg], as the page draws it: the y axis points up."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from optlink.dynamics.machine import Machine
from optlink.io import finite
from optlink.linkage.mechanism import FRAME
from optlink.linkage.motion import Motion, sweep
from optlink.linkage.vector2d import TURN, Array
from optlink.report.drawing import Sketch

STEPS = 72  # positions per revolution
EDGE = 24  # halvings of the crank angle at which a limited motion ends
DIGITS = 6  # significant digits of a coordinate, relative to the extent


class Picture:
    """A design in motion: its positions, and the data that the page draws.

    Parameters
    ----------
    machine : Machine
    start : float [rad]
        Crank angle of the first position; of a crank that cannot turn fully, one in the reachable range.
    speed : float
        Only its sign matters: the sense of rotation.
    """

    def __init__(self, machine: Machine, start: float, speed: float = 1.0) -> None:
        self.machine, self.mechanism = machine, machine.mechanism
        way = math.copysign(1.0, speed)
        count = STEPS * max(1, round(self.mechanism.cycle / TURN))
        angles = start + way * np.linspace(0.0, self.mechanism.cycle, count + 1)
        motion = sweep(self.mechanism, machine.sizes, angles)
        assembled = self._assembled(motion)
        self.closed = bool(np.all(assembled))
        if not self.closed:
            motion = sweep(self.mechanism, machine.sizes, self._reachable(angles, assembled))
        self.motion: Motion = motion
        self.angles: Array = np.asarray(motion.crank_angle, dtype=float)
        self.sketch = Sketch(motion, machine)
        extent = 1e3 * max(np.ptp(self.sketch.limits, axis=1)) / self.sketch.scale.factor
        self._decimals = max(0, DIGITS - 1 - math.floor(math.log10(max(extent, 1e-9))))

    def _assembled(self, motion: Motion) -> NDArray[np.bool_]:
        points = np.array([motion.position(name) for name in self.mechanism.owners])
        found: NDArray[np.bool_] = motion.assembled & np.isfinite(points).all(axis=(0, 2))
        return found

    def _reachable(self, angles: Array, assembled: NDArray[np.bool_]) -> Array:
        """Return angles through the reachable range that contains the start, else through the largest one."""
        count = len(angles) - 1
        cyclic = assembled[:count]
        if not cyclic.any():
            raise ArithmeticError("the linkage cannot be assembled at any crank angle")
        first = 0 if cyclic[0] else _longest(cyclic)
        low = high = first
        while low > first - count and cyclic[(low - 1) % count]:
            low -= 1
        while high < first + count and cyclic[(high + 1) % count]:
            high += 1
        step = angles[1] - angles[0]
        ends = [self._edge(angles[0] + step * end, step * side) for end, side in ((low, -1), (high, 1))]
        return np.linspace(ends[0], ends[1], max(2, math.ceil(abs(ends[1] - ends[0]) / TURN * STEPS) + 1))

    def _edge(self, inside: float, step: float) -> float:
        """Return the last crank angle, within a step, at which the linkage can be assembled."""
        low, high = 0.0, 1.0
        for _ in range(EDGE):
            middle = 0.5 * (low + high)
            if self._assembled(sweep(self.mechanism, self.machine.sizes, np.array([inside + middle * step])))[0]:
                low = middle
            else:
                high = middle
        return inside + low * step

    # --- what is sent -------------------------------------------------------------------------------------------------------

    def at(self, name: str, k: int = 0) -> tuple[float, float]:
        """Return the place of a point [mm].

        Parameters
        ----------
        name : str
        k : int
            Index of the position.
        """
        x, y = 1e3 * self.motion.position(name)[k]
        return float(x), float(y)

    def document(self, *, parts: bool = True) -> dict[str, Any]:
        """Return the scene as data of the page.

        Parameters
        ----------
        parts : bool
            Include the outlines of the bodies.
        """
        sketch, motion, k = self.sketch, self.motion, 1e3 / self.sketch.scale.factor
        owners = self.mechanism.owners
        free = [name for name, bodies in owners.items() if len(bodies) == 1 and bodies[0] != FRAME]
        points = {name: self._places(1e3 * motion.position(name)) for name in sketch.names}
        (x0, x1), (y0, y1) = sketch.limits
        bodies = []
        for name in self.mechanism.bodies:
            start = 1e3 * motion.position(self.mechanism.bodies[name].start)
            angle = np.degrees(np.asarray(motion.body_angle(name).value, dtype=float))
            body: dict[str, Any] = {"name": name, "colour": sketch.colours[name]}
            if parts:
                body["parts"] = [{"kind": p.kind, "outline": self._places(k * p.outline)} for p in sketch.parts[name]]
            poses = np.column_stack([np.round(start, self._decimals), np.round(angle, 4)])
            bodies.append(body | {"poses": _plain(poses)})
        return {
            "angles": np.round(np.degrees(self.angles), 4).tolist(),
            "closed": self.closed,
            "box": self._places(k * np.array([x0, y0, x1, y1])),
            "bodies": bodies,
            "points": points,
            "pins": list(self.mechanism.pins),
            "free": free,
            "ground": [{"line": self._gaps(k * line), "width": width, "filled": filled} for line, width, filled in sketch.ground],
            "springs": {
                spring.name: self._places(1e3 * np.concatenate([motion.position(p) for _, p in spring.ends], axis=1))
                for spring in sketch.springs
            },
            "size": round(k * sketch.size, self._decimals),
            "traces": {name: points[name] for name in free},
        }

    def _places(self, values: Array) -> Any:
        return _plain(np.round(values, self._decimals))

    def _gaps(self, line: Array) -> list[Any]:
        return [None if None in place else place for place in finite(np.round(line, self._decimals))]


def _plain(values: Array) -> Any:
    """Return numbers as nested lists, with None where they are not finite."""
    return values.tolist() if np.all(np.isfinite(values)) else finite(values)


def _longest(assembled: NDArray[np.bool_]) -> int:
    """Return an index in the longest run of a cyclic mask."""
    best, where = 0, int(np.argmax(assembled))
    for first in np.flatnonzero(assembled & ~np.roll(assembled, 1)):
        length = 0
        while length < len(assembled) and assembled[(first + length) % len(assembled)]:
            length += 1
        if length > best:
            best, where = length, int(first) + length // 2
    return where % len(assembled)
