"""Parts of the design on the page: outlines with their layers, sizes that can be changed, and files for the workshop."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from optlink.errors import InputError
from optlink.linkage.mechanism import FRAME
from optlink.presentation.export.cutting import path_data
from optlink.presentation.parts.layers import Stack
from optlink.presentation.parts.model import PartSet, part_set
from optlink.presentation.report_model import ReportModel, report_model_of
from optlink.problem.file import ProblemFile
from optlink.studio.design import Design, fault_text

SECTION = "parts"


def model_of(design: Design, problem: ProblemFile) -> ReportModel:
    """Return the report model of a design with the parts of a problem, which may have changed since the design was found.

    Raises
    ------
    InputError
        If there is no result of the ordinary tasks.
    """
    if design.result is None:
        raise InputError("there is no verified design yet", "Release the handle, or wait for the search", key="export")

    def stated(one: ProblemFile) -> ProblemFile:
        raw = {key: value for key, value in {**one.raw, SECTION: problem.at(SECTION)}.items() if value is not None}
        return one if raw == one.raw else replace(one.with_tables(raw), overrides=one.overrides)

    model = report_model_of(design.result)
    cycle = None if model.cycle is None else replace(model.cycle, problem=stated(model.cycle.problem))
    return replace(model, problem=stated(model.problem), cycle=cycle)


def _made(design: Design, problem: ProblemFile) -> PartSet:
    model = model_of(design, problem)
    if model.cycle is None:
        raise InputError(f"the design cannot be drawn: {model.unmoved}", "Change the problem", problem.file)
    return part_set(model.cycle)


def check(design: Design | None, before: ProblemFile, after: ProblemFile) -> None:
    """Refuse a change after which the parts of a design cannot be made, if they could before.

    Raises
    ------
    InputError
    """
    if design is None or design.result is None or before.at(SECTION) == after.at(SECTION):
        return
    try:
        _made(design, before)
    except InputError:
        return
    _made(design, after)


def document(design: Design, problem: ProblemFile) -> dict[str, Any]:
    """Return the parts of a design as data of the page [mm], in the axes of their bodies with the y axis down.

    A part or pin has its layer, None where the links cannot be stacked: then `refused` says which things collide, and `at` is the
    crank angle [deg]. `fields` are the sizes of a part or joint, with their keys below the section and what the file states.
    """
    try:
        parts = _made(design, problem)
    except InputError as error:
        return {"refused": fault_text(error.faults[0])}
    stack, stated = Stack(parts), problem.at(SECTION) or {}
    layers: Mapping[str, int | None]
    try:
        layers, refused = stack.layers(), {}
    except InputError as error:
        assert stack.worst is not None
        layers = dict.fromkeys(parts.parts)
        refused = {"refused": fault_text(error.faults[0]), "at": stack.worst.degrees}

    def field(key: str, value: float | None) -> dict[str, Any]:
        at: Any = stated
        for name in key.split("."):
            at = at.get(name) if isinstance(at, Mapping) else None
        return {"key": key, "value": value, "stated": at}

    def top(names: tuple[str, ...]) -> int | None:
        return max((layer for name in names if (layer := layers[name]) is not None), default=None)

    shapes, joints, joined = [], dict[str, float](), parts.motion.mechanism.pins
    for name, part in parts.parts.items():
        edges = "".join(path_data(outline) for outline in (part.outline, *(one.outline for one in part.openings)))
        sizes = [field(f"links.{name}.{size}", getattr(part, size)) for size in ("width", "thickness")]
        shapes.append({"name": name, "path": edges, "layer": layers[name], "fields": sizes})
        joints |= {one.joint: one.diameter for one in part.openings if one.joint in joined}
    pins = [
        {"joint": pin.name, "on": pin.on, "at": pin.at.tolist(), "diameter": pin.diameter, "layer": top(pin.parts)}
        for pin in parts.pins
    ]
    diameters = {pin.name: pin.diameter for pin in parts.pins}
    holes = [
        {"name": name, "fields": [field(f"joints.{name}.hole", hole), field(f"joints.{name}.pin", diameters[name])]}
        for name, hole in joints.items()
    ]
    usual = {
        name: [field(key, None) for key in keys]
        for name, keys in (("parts", ("width", "thickness")), ("joints", ("hole", "pin")))
    }
    made = {"parts": shapes, "pins": pins, "joints": holes, "usual": usual, "notes": parts.notes, "frame": FRAME}
    return made | refused
