"""DXF drawings: every link as a block with holes at exact distances, and the assembly at a crank angle.

Hole distances are exact. Outlines, hole diameters and slots are a proposal: strength and interference of links are not
considered.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from optlink.dynamics.machine import slider_names
from optlink.errors import InputError
from optlink.linkage.cams import Profile
from optlink.linkage.mechanism import FRAME, Guide, Mechanism
from optlink.linkage.motion import Motion
from optlink.linkage.vector2d import TURN, Array
from optlink.presentation.format import round_below
from optlink.presentation.scene import Outline, Region, named_points, scene
from optlink.presentation.shapes import cross, distinct, finite_range, hull, in_line, pieces
from optlink.tasks.analyze import Analysis

if TYPE_CHECKING:
    from ezdxf.document import Drawing
    from ezdxf.layouts.blocklayout import BlockLayout
    from ezdxf.layouts.layout import Modelspace

Vertex = tuple[float, float, float]
"""x and y [mm] of a corner, and the bulge of the edge that begins there: the tangent of a quarter of its arc."""

ASSEMBLY, PARTS, NAMES, TRACES, MARKS = "ASSEMBLY", "PARTS", "NAMES", "TRACES", "MARKS"
REGIONS, SPRINGS = "REGIONS", "SPRINGS"
HOLE = 0.03  # default hole diameter, as a share of the extent, before rounding
MAX_HOLE_SHARE = 0.5  # default hole diameter, at most this share of the least distance of two holes of a link
WIDTH = 2.5  # default link width in hole diameters
COINCIDENT = 1e-9  # distance of coincident corners, as a share of the extent
COLOURS = (1, 5, 3, 30, 6, 4, 34, 200, 52, 8)
"""AutoCAD colours of the links, the crank's first."""


@dataclass(frozen=True, eq=False)
class Plate:
    """A link as a plate in its own axes [mm]: holes and marks by name, slots (from, to), outline, profiles."""

    body: str
    holes: Mapping[str, Array]
    marks: Mapping[str, Array]
    slots: tuple[tuple[Array, Array], ...]
    outline: tuple[Vertex, ...]
    profiles: tuple[Profile, ...] = ()

    @property
    def block(self) -> str:
        """Name of its block and of its layer."""
        return f"LINK {self.body}" if self.body != FRAME else "FRAME"

    @property
    def corners(self) -> Array:
        """Its named points, the ends of its slots and its profiles (n, 2)."""
        ends = (end for slot in self.slots for end in slot)
        points = np.array([*self.holes.values(), *self.marks.values(), *ends]).reshape(-1, 2)
        return np.concatenate([points, *(profile.corners for profile in self.profiles)])


def document(
    cycle: Analysis,
    at: float,
    title: str,
    hole: float | None = None,
    width: float | None = None,
    regions: Sequence[Region] = (),
) -> Drawing:
    """Return the DXF document of the assembly at a reachable crank angle [rad], with hole diameter and link width [m].

    Springs have a layer of their own, and regions of the limits another one, with their clearances as dashed lines. A profile
    that encloses a link, a cam, is its outline; a circle, such as a roller, is added to the outline.

    Raises
    ------
    InputError
        If two holes of a link would overlap.
    """
    from ezdxf import units
    from ezdxf.filemanagement import new

    machine = cycle.machine
    motion = machine.motion([at])
    drawn = scene(cycle, regions=regions)
    body, least = nearest_holes(machine.mechanism, motion)
    diameter = usual_hole(min(max(drawn.box[2:]), MAX_HOLE_SHARE * least / HOLE)) if hole is None else 1e3 * hole
    if diameter >= least:
        message = f"two holes of {body} would overlap: they are {least:.6g} mm apart"
        raise InputError(message, "Give a smaller diameter", key="--hole", value=f"{diameter:.6g} mm")
    radius = 0.5 * (WIDTH * diameter if width is None else 1e3 * width)
    drawing, driving = new("R2010", units=units.MM), cycle.problem.model.driving
    drawing.header.custom_vars.append("TITLE", " ".join(title.split()))
    drawing.header.custom_vars.append(f"{driving.noun.upper()} [{driving.unit}]", f"{driving.shown(at):.9g}")
    drawing.linetypes.add("DASHED", [1.0, 0.6, -0.4])
    drawing.linetypes.add("CHAIN", [2.0, 1.2, -0.3, 0.2, -0.3])
    for name, colour in ((ASSEMBLY, 7), (PARTS, 7), (NAMES, 7), (TRACES, 9), (MARKS, 8)):
        drawing.layers.add(name, color=colour)
    parts = list(plates(cycle, motion, radius, drawn.profiles))
    for number, plate in enumerate(parts):
        drawing.layers.add(plate.block, color=COLOURS[number % len(COLOURS)] if plate.body != FRAME else 7)
        _cut(drawing.blocks.new(plate.block), plate, diameter, radius)
    space = drawing.modelspace()
    _assemble(space, parts, motion)
    for name in drawn.free:
        line = drawn.points[name]
        space.add_lwpolyline(line[np.all(np.isfinite(line), axis=1)].tolist(), dxfattribs={"layer": TRACES})
    springs = [shape for shape in drawn.moving_shapes if shape.layer == "springs"]
    if springs:
        drawing.layers.add(SPRINGS, color=8)
    for shape in springs:
        space.add_lwpolyline(drawn.located(shape, motion)[0].tolist(), dxfattribs={"layer": SPRINGS})
    _mark_out(drawing, drawn.outlines, radius)
    x, y, wide, _ = drawn.box
    _lay_out(space, [plate for plate in parts if plate.body != FRAME], (x, y), radius, wide)
    return drawing


def nearest_holes(mechanism: Mechanism, motion: Motion) -> tuple[str, float]:
    """Return the body with the least distance of two holes, and that distance [mm]; infinite if no body has two."""
    distances = [("", math.inf)]
    for body in (*mechanism.bodies, FRAME):
        pins = [1e3 * at for name, at in named_points(motion, body).items() if name in mechanism.pins]
        gaps = (float(np.linalg.norm(first - second)) for first, second in itertools.combinations(pins, 2))
        distances += [(body, gap) for gap in gaps if gap > 0.0]
    return min(distances, key=lambda item: item[1])


def usual_hole(extent: float) -> float:
    """Return a hole diameter [mm] for a mechanism of an extent [mm], from the series 1, 1.5, 2, 3, 4, 5, 6, 8, 10, ..."""
    return round_below(HOLE * extent, (1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0), 1e-9)


# --- plates ------------------------------------------------------------------------------------------------------------------


def plates(cycle: Analysis, motion: Motion, radius: float, curves: Mapping[str, Sequence[Profile]]) -> Iterator[Plate]:
    """Yield every link as a plate, its outline a radius [mm] from the hole centres, and finally the frame without an outline.

    `curves` [m] are those on the bodies.
    """
    mechanism = cycle.machine.mechanism
    travel = {guide.name: travelled(cycle, guide) for guide in mechanism.guides}
    for body in (*mechanism.bodies, *mechanism.rods, FRAME):
        points = {name: 1e3 * at for name, at in named_points(motion, body).items()}
        holes = {name: at for name, at in points.items() if name in mechanism.pins}
        marks = {name: at for name, at in points.items() if name not in holes}
        slots = tuple(_slot(motion, guide, travel[guide.name]) for guide in mechanism.guides if guide.on == body)
        corners = np.array([*points.values(), *(end for slot in slots for end in slot)]).reshape(-1, 2)
        own = tuple(profile.scaled(1e3) for profile in curves.get(body, ()))
        enclosed = any(profile.encloses(corners) for profile in own if not (profile.radius or profile.auxiliary))
        outline = () if enclosed or body == FRAME else rounded(corners, radius)
        yield Plate(body, holes, marks, slots, outline, own)


def _vector(vector: tuple[object, object]) -> Array:
    """Convert a vector [m] to an array [mm]."""
    return np.array([1e3 * float(part) for part in vector])  # type: ignore[arg-type]


def travelled(cycle: Analysis, guide: Guide) -> tuple[float, float]:
    """Return the least and largest slide [m] of a slider along its guide."""
    name = slider_names(cycle.machine)[guide.name]
    travel = cycle.strokes.get(name)
    return finite_range(cycle[f"{name}.s_m"]) if travel is None else (travel.low, travel.high)


def _slot(motion: Motion, guide: Guide, travel: tuple[float, float]) -> tuple[Array, Array]:
    """Return both ends of the slider path on the body that carries the guide."""
    point, direction = motion.pose.local_line(guide, guide.on)
    begin, along = _vector(point), _vector(direction) / 1e3
    return begin + 1e3 * travel[0] * along, begin + 1e3 * travel[1] * along


def rounded(points: Array, radius: float) -> tuple[Vertex, ...]:
    """Return the outline at a distance from the convex hull of points (n, 2), counter-clockwise.

    It consists of straight edges and arcs: two vertices per corner, with the arc between them as a bulge.
    """
    extent = float(np.max(np.ptp(points, axis=0)))
    corners = distinct(points, COINCIDENT * max(extent, radius))
    if len(corners) > 2:
        corners = hull(corners)
        arms = np.roll(corners, -1, axis=0) - corners
        before = np.roll(arms, 1, axis=0)
        sines = cross(before, arms) / np.prod(np.linalg.norm([before, arms], axis=2), axis=0)
        corners = corners[sines > COINCIDENT] if np.sum(sines > COINCIDENT) > 2 else corners
        order = in_line(corners, COINCIDENT * extent)
        corners = corners if order is None else corners[order[[0, -1]]]
    if len(corners) == 1:
        x, y = corners[0]
        return ((x - radius, y, 1.0), (x + radius, y, 1.0))
    vertices: list[Vertex] = []
    for k, corner in enumerate(corners):
        before, after = corner - corners[k - 1], corners[(k + 1) % len(corners)] - corner
        turned = math.atan2(cross(before, after), before @ after) % TURN
        normals = [np.array([edge[1], -edge[0]]) / np.linalg.norm(edge) for edge in (before, after)]
        first, second = (corner + radius * normal for normal in normals)
        vertices += [(float(first[0]), float(first[1]), math.tan(turned / 4.0)), (float(second[0]), float(second[1]), 0.0)]
    return tuple(vertices)


# --- drawing -----------------------------------------------------------------------------------------------------------------


def _cut(block: BlockLayout, plate: Plate, diameter: float, radius: float) -> None:
    """Draw a plate into its block."""
    layer = {"layer": plate.block}
    for at in plate.holes.values():
        block.add_circle(tuple(at), 0.5 * diameter, dxfattribs=layer)
    for at in plate.marks.values():
        for arm in 0.5 * diameter * np.eye(2):
            block.add_line(tuple(at - arm), tuple(at + arm), dxfattribs={"layer": MARKS})
    for first, last in plate.slots:
        if plate.body == FRAME or np.linalg.norm(last - first) <= COINCIDENT * radius:
            block.add_line(tuple(first), tuple(last), dxfattribs=layer)
        else:
            outline = rounded(np.array([first, last]), 0.5 * diameter)
            block.add_lwpolyline(outline, format="xyb", close=True, dxfattribs=layer)
    if plate.outline:
        block.add_lwpolyline(plate.outline, format="xyb", close=True, dxfattribs=layer)
    for profile in plate.profiles:
        look = {"layer": MARKS, "linetype": "CHAIN", "ltscale": radius} if profile.auxiliary else layer
        if profile.radius:
            block.add_circle(tuple(profile.line[0]), profile.radius, dxfattribs=look)
        else:
            block.add_lwpolyline(profile.line.tolist(), close=not profile.open, dxfattribs=look)


def _mark_out(drawing: Drawing, regions: Sequence[Outline], radius: float) -> None:
    """Draw the edges, clearances and names of regions on their layer."""
    from ezdxf.enums import TextEntityAlignment

    if not regions:
        return
    drawing.layers.add(REGIONS, color=8)
    space = drawing.modelspace()
    for region in regions:
        look = {"layer": REGIONS, **({"color": 1} if region.violated else {})}
        for line, way in ((region.edge, "Continuous"), (region.clearance, "DASHED")):
            for piece in pieces(line):
                if len(piece) > 1:
                    space.add_lwpolyline(piece.tolist(), dxfattribs={**look, "linetype": way, "ltscale": radius})
        if np.all(np.isfinite(region.label)):
            text = space.add_text(region.name, height=0.6 * radius, dxfattribs=look)
            text.set_placement(tuple(region.label), align=TextEntityAlignment.MIDDLE_CENTER)


def _assemble(space: Modelspace, parts: list[Plate], motion: Motion) -> None:
    """Insert every plate at its position in the assembly."""
    for plate in parts:
        place, angle = (0.0, 0.0), 0.0
        if plate.body != FRAME:
            start = motion.position(motion.mechanism.origin(plate.body))[0] * 1e3
            place = float(start[0]), float(start[1])
            angle = math.degrees(float(np.asarray(motion.body_angle(plate.body).value)[0]))
        space.add_blockref(plate.block, place, dxfattribs={"rotation": angle, "layer": ASSEMBLY})


def _lay_out(space: Modelspace, parts: list[Plate], corner: tuple[float, float], radius: float, wide: float) -> None:
    """Arrange the plates with their names below the assembly, in rows about as wide as the assembly."""
    left, x, y, deep = corner[0], corner[0], corner[1] - 2.0 * radius, 0.0
    for plate in parts:
        low, high = plate.corners.min(axis=0) - radius, plate.corners.max(axis=0) + radius
        if x > left and x + high[0] - low[0] > left + wide:
            x, y, deep = left, y - deep - 2.5 * radius, 0.0
        place = (x - float(low[0]), y - float(high[1]))
        space.add_blockref(plate.block, place, dxfattribs={"layer": PARTS})
        text = space.add_text(plate.body, height=0.6 * radius, dxfattribs={"layer": NAMES})
        text.set_placement((x, y - float(high[1] - low[1]) - 0.9 * radius))
        x += float(high[0] - low[0]) + radius
        deep = max(deep, float(high[1] - low[1]))
