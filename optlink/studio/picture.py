"""Geometry of a design in motion [mm, deg], as the page draws it: the y axis points up."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from optlink.dynamics.machine import Machine
from optlink.io import finite
from optlink.linkage.motion import Motion, sweep
from optlink.linkage.vector2d import TURN, Array
from optlink.report.drawing import Sketch
from optlink.report.regions import Outline, Region
from optlink.report.scene import scene_of

POSITIONS = 72  # positions per revolution
END_MARGIN = 1e-8  # rad from the ends of a limited motion: there rounding decides
DIGITS = 6  # significant digits of a coordinate, relative to the extent


class Picture:
    """A design in motion: its positions, and the data that the page draws.

    `start` [rad] is the first crank angle, in the reachable range if the crank cannot turn fully; `speed` gives the sense of
    rotation; `regions` are those of the limits.
    """

    def __init__(self, machine: Machine, start: float, speed: float = 1.0, regions: Sequence[Region] = ()) -> None:
        self.machine, self.mechanism = machine, machine.mechanism
        direction = math.copysign(1.0, speed)
        count = POSITIONS * max(1, round(self.mechanism.cycle / TURN))
        angles = start + direction * np.linspace(0.0, self.mechanism.cycle, count + 1)
        motion = sweep(self.mechanism, machine.sizes, angles)
        points = np.array([motion.position(name) for name in self.mechanism.owners])
        assembled = motion.assembled & np.isfinite(points).all(axis=(0, 2))
        self.closed = bool(np.all(assembled))
        if not self.closed:
            angles = angles[assembled] if machine.ranges.full else self._reachable(start, direction)
            motion = sweep(self.mechanism, machine.sizes, angles)
        self.motion: Motion = motion
        self.angles: Array = np.asarray(motion.crank_angle, dtype=float)
        self.sketch = Sketch(motion, machine, regions=regions)
        extent = 1e3 * max(np.ptp(self.sketch.limits, axis=1)) / self.sketch.scale.factor
        self._decimals = max(0, DIGITS - 1 - math.floor(math.log10(max(extent, 1e-9))))

    def _reachable(self, start: float, direction: float) -> Array:
        """Return angles through the reachable range that contains the start, else through the largest one."""
        ranges = self.machine.ranges
        if not ranges.ranges:
            raise ArithmeticError("the linkage cannot be assembled at any crank angle")
        low, high = ranges.holding(start) or max(ranges.ranges, key=lambda ends: ends[1] - ends[0])
        ends = (low + END_MARGIN, high - END_MARGIN) if direction > 0.0 else (high - END_MARGIN, low + END_MARGIN)
        return np.linspace(*ends, max(2, math.ceil((high - low) / TURN * POSITIONS) + 1))

    # --- what is sent -------------------------------------------------------------------------------------------------------

    def at(self, name: str) -> tuple[float, float]:
        """Return the place of a point [mm] at the first position."""
        x, y = 1e3 * self.motion.position(name)[0]
        return float(x), float(y)

    def document(self) -> dict[str, Any]:
        """Return the scene as data of the page."""
        scene = scene_of(self.sketch, self.motion, closed=self.closed, up=True)
        x, y, wide, high = scene.box
        points = {name: self._places(positions) for name, positions in scene.points.items()}
        bodies = []
        for body in scene.bodies:
            parts = [{"kind": p.kind, "outline": self._places(p.outline)} for p in body.parts]
            poses = np.column_stack([np.round(body.poses[:, :2], self._decimals), np.round(body.poses[:, 2], 4)])
            bodies.append({"name": body.name, "colour": body.colour, "parts": parts, "poses": _plain(poses)})
        return {
            "angles": np.round(scene.angles, 4).tolist(),
            "closed": scene.closed,
            "box": self._places(np.array([x, y, x + wide, y + high])),
            "bodies": bodies,
            "points": points,
            "pins": list(scene.pins),
            "free": list(scene.free),
            "owner": {name: scene.owner[name] for name in scene.free},
            "ground": [{"line": self._gaps(line), "width": width, "filled": filled} for line, width, filled in scene.ground],
            "regions": [self._region(outline) for outline in scene.regions],
            "springs": {name: self._places(ends.reshape(len(ends), 4)) for name, ends in scene.springs.items()},
            "size": round(scene.size, self._decimals),
            "traces": {name: points[name] for name in scene.free},
        }

    def _region(self, outline: Outline) -> dict[str, Any]:
        lines = [{"line": self._gaps(line), "width": width, "dashed": dashed} for line, width, dashed in outline.lines]
        return {"name": outline.name, "violated": outline.violated, "lines": lines, "at": self._places(outline.label)}

    def _places(self, values: Array) -> Any:
        return _plain(np.round(values, self._decimals))

    def _gaps(self, line: Array) -> list[Any]:
        return [None if None in place else place for place in finite(np.round(line, self._decimals))]


def _plain(values: Array) -> Any:
    """Return numbers as nested lists, with None where they are not finite."""
    return values.tolist() if np.all(np.isfinite(values)) else finite(values)
