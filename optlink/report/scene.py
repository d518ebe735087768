"""Geometry of a mechanism in motion [mm, deg]: outlines of its bodies and their poses over the crank angle.

The y axis points down, as in SVG, and angles turn with it.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from optlink.linkage.mechanism import FRAME
from optlink.linkage.motion import Motion, sweep
from optlink.linkage.vector2d import TURN, Array
from optlink.report.drawing import Sketch
from optlink.report.names import NamePlaces, place_names
from optlink.report.regions import Outline, Region
from optlink.report.shapes import Part
from optlink.tasks.analyze import Analysis

FLIP = np.array([1.0, -1.0])
STEPS = 360  # positions per revolution
PLACES = 6  # significant digits of a coordinate, relative to the extent


@dataclass(frozen=True, eq=False)
class Body:
    """A body: outlines in its own axes, centroid there if it has a mass, and poses (positions, 3) as x, y, angle."""

    name: str
    colour: str
    parts: tuple[Part, ...]
    centroid: Array | None
    poses: Array

    def placed(self) -> Iterator[Array]:
        """Yield the outlines of the parts at all positions (positions, corners, 2), closed ones to their first corner."""
        x, y, angle = self.poses.T[:, :, None]
        c, s = np.cos(np.radians(angle)), np.sin(np.radians(angle))
        for part in self.parts:
            outline = part.outline if part.kind == "bar" else np.concatenate([part.outline, part.outline[:1]])
            u, v = outline.T
            yield np.stack([x + c * u - s * v, y + s * u + c * v], axis=-1)


@dataclass(frozen=True, eq=False)
class Scene:
    """A mechanism over its motion.

    `angles` (positions,) [deg] follow the motion; `closed` says whether the last position equals the first; `points` are
    coordinates (positions, 2) by name; `moving`, `free` and `pins` are names of points, `owner` the body whose colour the trace
    of each takes; `ground` contains lines, widths and whether they are filled; `springs` are the two end points
    (positions, 2, 2) by name; `regions` are those that points must stay in or out of; `size` is the height of a ground pivot;
    `box` is x, y, width and height of the drawing.
    """

    angles: Array
    closed: bool
    bodies: tuple[Body, ...]
    points: Mapping[str, Array]
    moving: tuple[str, ...]
    free: tuple[str, ...]
    pins: tuple[str, ...]
    owner: Mapping[str, str]
    ground: Sequence[tuple[Array, float, bool]]
    springs: Mapping[str, Array]
    regions: Sequence[Outline]
    size: float
    box: tuple[float, float, float, float]

    @property
    def still(self) -> frozenset[str]:
        """Names of the points of the frame."""
        return frozenset(self.points).difference(self.moving)

    @cached_property
    def names(self) -> dict[str, NamePlaces]:
        """Places of the names of the points."""
        links = [placed for body in self.bodies for placed in body.placed()]
        ground = [*(line for line, _, _ in self.ground), *(region.edge for region in self.regions)]
        return place_names(self.points, self.still, links, ground, self.moving, self.box, self.size)

    @property
    def decimals(self) -> int:
        """Number of decimals of coordinates."""
        return max(0, PLACES - 1 - math.floor(math.log10(max(self.box[2], self.box[3]))))

    def to_dict(self) -> dict[str, Any]:
        """Return the data that a script needs to animate the drawing."""

        def columns(table: Array, names: str) -> dict[str, list[float]]:
            return {name: np.round(table[:, k], self.decimals).tolist() for k, name in enumerate(names)}

        return {
            "angles_deg": np.round(self.angles, 9).tolist(),
            "closed": self.closed,
            "bodies": {
                body.name: columns(body.poses[:, :2], "xy") | {"a": np.round(body.poses[:, 2], 5).tolist()}
                for body in self.bodies
            },
            "points": {name: columns(self.points[name], "xy") for name in self.moving},
            "names": {name: columns(self.names[name].middles, "xy") | {"side": self.names[name].code} for name in self.moving},
            "springs": {name: columns(ends.reshape(len(ends), 4), "xyuv") for name, ends in self.springs.items()},
            "size": self.size,
        }


def scene(cycle: Analysis, steps: int = STEPS, at: float | None = None, regions: Sequence[Region] = ()) -> Scene:
    """Return the scene of an analysed machine over its motion, or at one crank angle [rad], with regions of its limits.

    Extent and outlines are those of the whole motion in either case.
    """
    machine = cycle.machine
    direction = math.copysign(1.0, cycle.speed)
    first = math.radians(float(cycle["crank_angle_deg"][0]))
    last = first + direction * cycle.cycle if cycle.full else math.radians(float(cycle["crank_angle_deg"][-1]))
    count = steps * round(cycle.cycle / TURN) if cycle.full else max(1, math.ceil(abs(last - first) / TURN * steps))
    angles = np.linspace(first, last, count + 1)
    full_motion = sweep(machine.mechanism, machine.sizes, angles, cycle.speed)
    sketch = Sketch(full_motion, machine, regions=regions)
    if at is not None:
        return scene_of(sketch, sweep(machine.mechanism, machine.sizes, [at], cycle.speed), closed=False)
    known = np.all([np.isfinite(full_motion.position(name)).all(axis=-1) for name in machine.mechanism.owners], axis=0)
    if not known.all() and known.any():  # a singular position has none, for example
        full_motion = sweep(machine.mechanism, machine.sizes, angles[known], cycle.speed)
    return scene_of(sketch, full_motion, closed=cycle.full)


def scene_at(cycle: Analysis, angles: Array) -> Scene:
    """Return the scene of an analysed machine at crank angles (positions,) [rad], with the extent of its whole motion."""
    machine = cycle.machine
    full_motion = sweep(machine.mechanism, machine.sizes, np.radians(cycle["crank_angle_deg"]), cycle.speed)
    return scene_of(Sketch(full_motion, machine), sweep(machine.mechanism, machine.sizes, angles, cycle.speed), closed=False)


def scene_of(sketch: Sketch, motion: Motion, *, closed: bool, up: bool = False) -> Scene:
    """Return the scene of a sketch at the positions of a motion; it is closed if the last one equals the first.

    The y axis points down, and angles turn with it, unless `up`.
    """
    mechanism, k, signs = sketch.mechanism, 1e3 / sketch.scale.factor, np.abs(FLIP) if up else FLIP
    flip = k * signs

    def body(name: str) -> Body:
        parts = tuple(Part(part.kind, part.outline * flip) for part in sketch.parts[name])
        start = motion.position(mechanism.bodies[name].start) * 1e3 * signs
        angle = signs[1] * np.degrees(np.asarray(motion.body_angle(name).value, dtype=float))
        centroid = sketch.centroids.get(name)
        poses = np.concatenate([start, angle[:, None]], axis=1)
        return Body(name, sketch.colours[name], parts, None if centroid is None else centroid[0] * flip, poses)

    owners = mechanism.owners
    (x0, x1), (y0, y1) = sketch.limits
    return Scene(
        angles=np.degrees(np.asarray(motion.crank_angle, dtype=float)),
        closed=closed,
        bodies=tuple(body(name) for name in mechanism.bodies),
        points={name: motion.position(name) * 1e3 * signs for name in sketch.names},
        moving=tuple(name for name, bodies in owners.items() if FRAME not in bodies),
        free=tuple(name for name, bodies in owners.items() if len(bodies) == 1 and bodies[0] != FRAME),
        pins=tuple(mechanism.pins),
        owner={name: bodies[0 if bodies[0] == mechanism.crank.body else -1] for name, bodies in owners.items()},
        ground=[(line * flip, width, filled) for line, width, filled in sketch.ground],
        springs={
            spring.name: np.stack([motion.position(point) * 1e3 * signs for _, point in spring.ends], axis=1)
            for spring in sketch.springs
        },
        regions=[outline.scaled(flip) for outline in sketch.outlines],
        size=sketch.size * k,
        box=(k * x0, k * (y0 if up else -y1), k * (x1 - x0), k * (y1 - y0)),
    )
