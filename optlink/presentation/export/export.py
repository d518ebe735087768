"""Export of a design: drawings, parts to cut or print and their sheets, motion, geometry, a model of MuJoCo, a link of PMKS+."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from optlink.errors import InputError
from optlink.io import finite, head, whole, write_json
from optlink.linkage.elements import disc_cams
from optlink.linkage.jet import as_jet
from optlink.linkage.mechanism import FRAME
from optlink.linkage.stroke import Failure, failure
from optlink.linkage.vector2d import TURN, Array
from optlink.presentation.files import check_target, write_csv
from optlink.presentation.parts.model import part_set
from optlink.presentation.report_model import ReportModel
from optlink.presentation.shapes import plain
from optlink.problem.file import check_plausible
from optlink.problem.quantity import LARGEST_ANGLE, LONGEST, SHORTEST, check_range, nearest
from optlink.tasks.analyze import MAX_POINTS, Analysis, analyze
from optlink.tasks.results.design import LinkageDesign

SCHEMA = "optlink/geometry/1"
FORCES = ("_N", "_Nm", "_J", "_W")
"""Endings of columns that say nothing of a linkage without masses and loads."""
SPREAD = 24
"""Positions of the motion of which the assembly on a sheet is drawn at the clearest."""


@dataclass(frozen=True)
class Options:
    """Export options: crank angle `at` [rad], of a slide or cylinder its slide or length [m] (default: start of the motion).

    Hole and width [m], rows of the table, content of the file (default: the first one that its format can have).

    Raises
    ------
    InputError
        If one is out of range.
    """

    at: float | None = None
    hole: float | None = None
    width: float | None = None
    points: int = 360
    content: str | None = None

    def __post_init__(self) -> None:
        """Check the values."""
        if self.at is not None and not abs(self.at) <= LARGEST_ANGLE:
            raise InputError("out of range", 'Give one such as "30 deg"', key="--at", value=f"{self.at:g}")
        for name, size in (("hole", self.hole), ("width", self.width)):
            if size is not None and not SHORTEST <= size <= LONGEST:
                raise InputError("no link has such a size", 'Give one such as "8 mm"', key=f"--{name}", value=f"{size:g} m")
        if self.hole is not None and self.width is not None and self.width <= self.hole:
            remedy = "Give a width greater than the hole"
            raise InputError("the link width is smaller than the hole", remedy, key="--width", value=f"{self.width:g} m")
        check_range("--points", self.points, 1, MAX_POINTS)


def export(model: ReportModel, path: Path, options: Options | None = None) -> Sequence[str]:
    """Write a design in the format of the file extension; return notes for who makes its parts.

    Parameters
    ----------
    model : ReportModel
    path : Path
        Its extension is one of `FORMATS`.
    options : Options or None, optional
        Default: `Options()`.

    Raises
    ------
    InputError
        If the extension is unknown, the design cannot be assembled or an option is out of range; then no file is written.
    """
    options = options or Options()
    contents = contents_of(path, options.content)
    if model.cycle is None:
        remedy = "Check it with optlink validate, and export another design"
        raise InputError(f"the design cannot be drawn: {model.unmoved}", remedy, model.problem.file)
    return contents[options.content or next(iter(contents))](model, model.cycle, path, options) or ()


def contents_of(path: Path, content: str | None) -> Mapping[str, Callable[..., Sequence[str] | None]]:
    """Return the contents that a file of this name can have, with their writers.

    Raises
    ------
    InputError
        If there is no such format, or it cannot have the requested content.
    """
    check_target(path, tuple(FORMATS), "drawing.dxf")
    contents = FORMATS[path.suffix.lower()]
    if content is not None and content not in contents:
        others = [ending for ending, known in FORMATS.items() if content in known]
        remedy = f"Write a {' or '.join(others)} file" if others else nearest(content, contents)
        raise InputError(f"a {path.suffix} file cannot have this content", remedy, key="--content", value=content)
    return contents


def spread(cycle: Analysis) -> list[float]:
    """Return some crank angles [rad] of the motion, at about equal steps of it, where the mechanism can be assembled."""
    steps = np.linspace(cycle.positions[0], cycle.positions[-1], SPREAD, endpoint=False)
    whole = np.clip(np.radians(np.round(np.degrees(steps))), cycle.positions.min(), cycle.positions.max())
    return [at for at in map(float, whole) if not failure(cycle.machine.mechanism, cycle.machine.sizes, at)] or [
        place_of(cycle, None)
    ]


def place_of(cycle: Analysis, at: float | None, key: str = "--at") -> float:
    """Return the crank angle [rad] of a position `at` in SI, where the mechanism can be assembled.

    None: the first such position of the motion.

    Raises
    ------
    InputError
        If the drive cannot reach the position; the message contains the reachable ranges.
    """

    def failed(angle: float) -> Failure | None:
        return failure(cycle.machine.mechanism, cycle.machine.sizes, angle)

    if at is None:
        return next(angle for angle in map(float, cycle.positions) if not failed(angle))
    driving = cycle.problem.model.driving
    angle = at if driving.ends is None else driving.at(1e3 * at)
    if failed(angle) or not (cycle.full or cycle.ranges.holding(angle)):
        message = str(failed(angle) or "the mechanism cannot be assembled there")
        remedy, shown = f"Give an angle within {cycle.ranges.text}", f"{driving.shown(angle):.6g} {driving.unit}"
        if cycle.full:
            remedy = "Give an angle beside it"
        elif driving.ends is not None:
            message, remedy = "the drive does not move there", f"Give a {driving.reach}"
        raise InputError(message, remedy, cycle.problem.file, key, shown)
    return angle


def check_unit_of_place(cycle: Analysis, at: float | None, key: str) -> None:
    """Refuse a crank angle [rad] that was meant in degrees.

    Raises
    ------
    InputError
        If it is beyond two turns, and the motion is not.
    """
    if at is not None and cycle.problem.model.driving.ends is None and cycle.machine.cycle <= TURN:
        check_plausible({}, at, "rad", cycle.problem.file, key, texts=False)


def _dxf(model: ReportModel, cycle: Analysis, path: Path, options: Options) -> None:
    from optlink.presentation.export.dxf import document

    at = place_of(cycle, options.at)
    drawing = document(cycle, at, model.problem.model.title, options.hole, options.width, model.regions)
    with whole(path) as temporary:
        drawing.saveas(temporary)


def _svg(model: ReportModel, cycle: Analysis, path: Path, options: Options) -> None:
    from optlink.presentation.export.svg import svg
    from optlink.presentation.scene import scene

    at = place_of(cycle, options.at)
    title = f"{model.problem.model.title}: {model.problem.model.driving.text(at)}"
    text = svg(scene(cycle, at=at, regions=model.regions), title, true_size=True)
    with whole(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def _csv(model: ReportModel, cycle: Analysis, path: Path, options: Options) -> None:
    """Write the motion as a table, without force columns if there are no masses and loads."""
    rows = cycle if options.points == len(cycle["time_s"]) - 1 else analyze(cycle.problem, options.points, speed=cycle.speed)
    columns = {name: values for name, values in rows.columns.items() if model.forces or not name.endswith(FORCES)}
    columns |= dict(cam_curves(rows))
    write_csv(path, columns)


def cam_curves(cycle: Analysis) -> Iterator[tuple[str, Array]]:
    """Yield columns of the contact point of every cam, its profile, and of the follower's point, in the axes of the cam."""
    pose = cycle.machine.motion(cycle.positions).pose
    for cam, disc in disc_cams(pose).items():
        contact = disc.at(as_jet(pose.turned(cam.cam) - pose.turned(cam.against)).value)
        centre = complex(*(float(part) for part in pose.local(cam.cam, cam.pivot)))
        for name, at in (("profile", contact.profile + centre), ("pitch", contact.pitch + centre)):
            yield f"{cam.name}.{name}_x_m", at.real
            yield f"{cam.name}.{name}_y_m", at.imag


def _json(model: ReportModel, cycle: Analysis, path: Path, options: Options) -> None:
    write_json(path, geometry(model, cycle, place_of(cycle, options.at)))


def _cutting(model: ReportModel, cycle: Analysis, path: Path, options: Options) -> Sequence[str]:
    """Write the parts for laser cutting."""
    from optlink.presentation.export.cutting import WRITERS
    from optlink.presentation.parts.layout import engraved

    write = WRITERS[path.suffix.lower()]
    parts = part_set(cycle, options.hole, options.width)
    with whole(path) as temporary:
        write(parts, model.problem.model.title, temporary)
    bare = ", ".join(name for name, part in parts.parts.items() if engraved(part) is None)
    return (*parts.notes, *([f"Without room for an engraved name: {bare}."] if bare else []))


def _printing(model: ReportModel, cycle: Analysis, path: Path, options: Options) -> Sequence[str]:
    """Write the parts as solids on a plate."""
    from optlink.presentation.export.printing import KERNELS

    kernel = KERNELS[path.suffix.lower()]()
    parts = part_set(cycle, options.hole, options.width)
    solids = [*kernel.on_plate(parts)]
    with whole(path) as temporary:
        kernel.write(solids, model.problem.model.title, temporary)
    return parts.notes


def _assembly(model: ReportModel, cycle: Analysis, path: Path, options: Options) -> Sequence[str]:
    """Write the parts, pins and spacers as solids in their layers, at a crank angle."""
    from optlink.presentation.export.printing import KERNELS
    from optlink.presentation.parts.layers import stacked

    kernel = KERNELS[path.suffix.lower()]()
    motion = cycle.machine.motion([place_of(cycle, options.at)])
    parts = part_set(cycle, options.hole, options.width)
    solids = [*kernel.assembled(stacked(parts), motion)]
    with whole(path) as temporary:
        kernel.write(solids, model.problem.model.title, temporary)
    return parts.notes


def _sheet(model: ReportModel, cycle: Analysis, path: Path, options: Options) -> Sequence[str]:
    """Write the workshop sheets; those of a design that is not valid say so in their title."""
    from optlink.presentation.export.workshop import WRITERS
    from optlink.presentation.html.shell import letterhead
    from optlink.presentation.parts.sheet import permitted, sheets

    angles = spread(cycle) if options.at is None else [place_of(cycle, options.at)]
    problem = model.problem.model
    head = {"title": problem.title, **letterhead(model.problem)}
    head["title"] = head["title"] if model.valid else f"NOT VALID: {head['title']}"
    positions = cycle.machine.motion(angles)
    parts = part_set(cycle, options.hole, options.width)
    shown = [at % TURN if cycle.full and cycle.cycle == TURN else at for at in angles]
    captions = [f"assembly, {problem.driving.text(at)}" for at in shown]
    drawn, notes = sheets(parts, cycle, positions, captions, head, [*_exceeded(model, permitted(parts, cycle))])
    with whole(path) as temporary:
        WRITERS[path.suffix.lower()](drawn, head["title"], temporary)
    return notes


def _exceeded(model: ReportModel, tolerances: Mapping[str, float]) -> Iterator[str]:
    """Yield the note about limits of a valid design that sizes within the tolerances [m] of the sheets could violate."""
    from optlink.studies.tolerances.general import violations

    best = getattr(model.result, "best", None)
    if model.valid and isinstance(best, LinkageDesign) and (found := violations(best, tolerances)):
        yield f"Sizes at the ends of the tolerances of these sheets may violate limits: {'; '.join(map(str, found))}."


def geometry(model: ReportModel, cycle: Analysis, at: float) -> dict[str, Any]:
    """Return the linkage as a JSON document [SI]: points of the bodies in their own axes, and all positions at a crank angle."""
    from optlink.presentation.export.dxf import travelled
    from optlink.presentation.scene import named_points

    machine = cycle.machine
    mechanism = machine.mechanism
    motion = machine.motion([at])

    def local(body: str) -> dict[str, list[float]]:
        return {name: at.tolist() for name, at in named_points(motion, body).items()}

    bodies = {}
    for body in (*mechanism.bodies, *mechanism.rods):
        angle = float(np.asarray(motion.body_angle(body).value)[0])
        bodies[body] = {"points_m": local(body), "at_m": motion.position(mechanism.origin(body))[0].tolist(), "angle_rad": angle}
        if body in machine.inertias:
            bodies[body] |= {"inertia": vars(machine.inertias[body]) | {}}
    guides = {}
    for guide in mechanism.guides:
        point, direction = map(plain, motion.pose.local_line(guide, guide.on))
        record = {"slider": guide.slider, "on": guide.on, "through_m": point.tolist(), "direction": direction.tolist()}
        guides[guide.name] = record | {"travel_m": list(travelled(cycle, guide))}
    document = {
        **head(SCHEMA, model.problem, "valid" if model.valid else "not valid"),
        "valid": model.valid,
        "crank_angle_rad": at,
        "full_rotation": cycle.full,
        "reachable_rad": [list(range_) for range_ in cycle.ranges.ranges],
        "crank": mechanism.crank.body,
        "speed_rad_s": cycle.speed,
        "ground_m": local(FRAME),
        "bodies": bodies,
        "pins": {name: list(owners) for name, owners in mechanism.pins.items()},
        "guides": guides,
        "points_m": {name: motion.position(name)[0].tolist() for name in mechanism.owners},
    }
    return finite(document)  # type: ignore[no-any-return]


def _foreign(model: ReportModel, cycle: Analysis, path: Path, options: Options) -> None:
    """Write the machine for another program."""
    from optlink.presentation.export.mjcf import mjcf
    from optlink.presentation.export.pmks import share_link

    text = {".xml": mjcf, ".txt": share_link}[path.suffix.lower()](cycle, place_of(cycle, options.at))
    with whole(path) as temporary:
        temporary.write_text(f"{text.rstrip()}\n", encoding="utf-8")


Writer = Callable[[ReportModel, Analysis, Path, Options], Sequence[str] | None]
FORMATS: dict[str, dict[str, Writer]] = {
    ".dxf": {"drawing": _dxf, "parts": _cutting, "sheet": _sheet},
    ".svg": {"drawing": _svg, "parts": _cutting},
    ".pdf": {"sheet": _sheet},
    ".stl": {"parts": _printing, "assembly": _assembly},
    ".3mf": {"parts": _printing, "assembly": _assembly},
    ".step": {"parts": _printing, "assembly": _assembly},
    ".csv": {"motion": _csv},
    ".json": {"geometry": _json},
    ".xml": {"model": _foreign},
    ".txt": {"pmks": _foreign},
}
"""What can be written, by the ending of the file and by content, the usual one first."""
