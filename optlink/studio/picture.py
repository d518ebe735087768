"""Geometry of a design in motion [mm, deg], as the page draws it: the y axis points up."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from optlink.dynamics.machine import Machine
from optlink.io import finite
from optlink.linkage.motion import Motion
from optlink.linkage.vector2d import TURN, Array
from optlink.presentation.scene import LOOKS, MM, Outline, Region, Scene
from optlink.presentation.shapes import zigzag
from optlink.problem.driving import Driving

POSITIONS = 72  # positions per revolution
END_MARGIN = 1e-8  # rad from the ends of a limited motion: there rounding decides


class Picture:
    """A design in motion: its positions, and the data that the page draws.

    `start` [rad] is the first crank angle, in the reachable range if the crank cannot turn fully; `speed` gives the sense of
    rotation; `regions` are those of the limits; `driving` says how the drive moves the machine, by default a crank that turns.
    """

    def __init__(
        self,
        machine: Machine,
        start: float,
        speed: float = 1.0,
        regions: Sequence[Region] = (),
        driving: Driving | None = None,
    ) -> None:
        self.machine, self.mechanism = machine, machine.mechanism
        self.driving = None if driving is None else driving.of(machine.sizes)
        direction, limits = math.copysign(1.0, speed), self.mechanism.limits
        if limits is None:
            count = POSITIONS * max(1, round(self.mechanism.cycle / TURN))
            angles = start + direction * np.linspace(0.0, self.mechanism.cycle, count + 1)
        else:
            low, high = limits if direction > 0.0 else limits[::-1]
            angles = np.linspace(low, high, POSITIONS + 1)
        motion = machine.motion(angles)
        points = np.array([motion.position(name) for name in self.mechanism.owners])
        assembled = motion.assembled & np.isfinite(points).all(axis=(0, 2))
        self.complete = bool(np.all(assembled))
        self.closed = self.complete and limits is None
        if not self.complete:
            angles = angles[assembled] if machine.ranges.full else self._reachable(start, direction)
            motion = machine.motion(angles)
        self.motion: Motion = motion
        self.angles: Array = np.asarray(motion.crank_angle, dtype=float)
        self.scene = Scene(motion, machine, regions=regions, unit=MM).moved(motion, closed=self.closed)

    def _reachable(self, start: float, direction: float) -> Array:
        """Return angles through the reachable range that contains the start, else through the largest one."""
        ranges = self.machine.ranges
        if not ranges.ranges:
            raise ArithmeticError("the linkage cannot be assembled at any crank angle")
        low, high = ranges.holding(start) or max(ranges.ranges, key=lambda ends: ends[1] - ends[0])
        ends = (low + END_MARGIN, high - END_MARGIN) if direction > 0.0 else (high - END_MARGIN, low + END_MARGIN)
        return np.linspace(*ends, max(2, math.ceil((high - low) / TURN * POSITIONS) + 1))

    def axis(self, angles: Array) -> dict[str, Any]:
        """Return what the slider and the charts show at crank angles or values of the cycle variable [rad], as plain data.

        The time of laws and of several drives; else the positions of the drive in their unit.
        """
        driving = self.driving
        if driving is not None and driving.ends is None and driving.mechanism.drives:
            label, unit, values = "time", "s", (angles - driving.first) / driving.pace
        elif driving is not None:
            label, unit, values = driving.coordinate, driving.unit, driving.shown(angles)
        else:
            label, unit, values = "crank angle", "deg", np.degrees(angles)
        decimals = 3 if np.ptp(values) > 1.0 else 3 - math.floor(math.log10(max(float(np.ptp(values)), 1e-9)))
        return {"label": label, "unit": unit, "values": _plain(np.round(values, decimals))}

    # --- what is sent -------------------------------------------------------------------------------------------------------

    def at(self, name: str) -> tuple[float, float]:
        """Return the place of a point [mm] at the first position."""
        x, y = self.scene.position(self.motion, name)[0]
        return float(x), float(y)

    def document(self) -> dict[str, Any]:
        """Return the scene as data of the page."""
        scene = self.scene
        x, y, wide, high = scene.box
        bodies = []
        for name in scene.parts:
            shapes = [s for s in scene.moving_shapes if s.of == "body" and s.name == name and s.layer in LOOKS]
            parts = [{"kind": s.layer, "outline": self._places(s.line), "width": s.width, "closed": bool(s.fill)} for s in shapes]
            poses = scene.poses(name)
            placed = np.column_stack([np.round(poses[:, :2], scene.decimals), np.round(poses[:, 2], 4)])
            bodies.append({"name": name, "colour": scene.colours[name], "parts": parts, "poses": _plain(placed)})
        return {
            "drive": self.axis(self.angles),
            "closed": scene.closed,
            "box": self._places(np.array([x, y, x + wide, y + high])),
            "bodies": bodies,
            "captions": scene.captions,
            "points": {name: self._places(positions) for name, positions in scene.points.items()},
            "pins": list(scene.pins),
            "free": list(scene.free),
            "owner": {name: scene.owner(name) for name in scene.free},
            "ground": [{"line": self._gaps(line), "width": width, "filled": filled} for line, width, filled in scene.ground],
            "regions": [self._region(outline) for outline in scene.outlines],
            "springs": {spring: self._places(scene.ends(self.motion, spring).reshape(-1, 4)) for spring in scene.springs},
            "zigzag": zigzag(scene.size),
            "size": round(scene.size, scene.decimals),
        }

    def _region(self, outline: Outline) -> dict[str, Any]:
        lines = [{"line": self._gaps(line), "width": width, "dashed": dashed} for line, width, dashed in outline.lines]
        return {"name": outline.name, "violated": outline.violated, "lines": lines, "at": self._places(outline.label)}

    def _places(self, values: Array) -> Any:
        return _plain(np.round(values, self.scene.decimals))

    def _gaps(self, line: Array) -> list[Any]:
        return [None if None in place else place for place in finite(np.round(line, self.scene.decimals))]


def _plain(values: Array) -> Any:
    """Return numbers as nested lists, with None where they are not finite."""
    return values.tolist() if np.all(np.isfinite(values)) else finite(values)
