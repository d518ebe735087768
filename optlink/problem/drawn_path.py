"""A path in a drawing (an SVG file) as the problem file of a four-bar whose coupler point follows it."""

import json
import math
import os
from pathlib import Path

import numpy as np

from optlink.errors import InputError
from optlink.problem.quantity import Unusable
from optlink.problem.targets.points import svg_points

TEXT = """\
# A four-bar whose point P follows a path of a drawing
# Next: optlink solve FILE --out out
# Next: optlink report FILE -o STEM.html

format = 1
title = {title}

[mechanism]
type = "four-bar"                   # crank A-B, coupler B-C, rocker D-C, frame A-D
# free; the bounds follow from the size of the path, {size:.4g} mm: change them to the room that there is
crank = {{ bounds = {sizes} }}
coupler = {{ bounds = {sizes} }}
rocker = {{ bounds = {sizes} }}
frame = {{ bounds = {sizes} }}
# the point on the coupler: along B -> C, and to its left
points = {{ P = [{{ bounds = {offsets} }}, {{ bounds = {offsets} }}] }}
# place of the motor shaft A, in the coordinates of the drawing with y upwards (0 at its upper edge)
pivot = [{{ bounds = {pivot[0]} }}, {{ bounds = {pivot[1]} }}]
direction = {{ bounds = ["-180 deg", "180 deg"] }}   # angle of the frame A -> D
assembly = "either"                 # search both assembly modes

[requirement]
kind = "path"                       # a point follows a path
point = "P"
# {note}
# add unit = "2 mm" to make a unit of the drawing 2 mm long; points = 100: more points of the path
points = {{ svg = {name}{path} }}

[limits]
crank = "full rotation"             # a motor drives the crank; "span": it only swings along the path, to and fro
transmission_angle = ["35 deg", "145 deg"]   # between coupler and rocker
# every link between a tenth of the frame and ten times the frame
link_ratio = [0.1, 10.0]
"""
OPEN = """\
# The path is open: P goes on beyond its ends and returns on a way that is not prescribed. To prescribe it, close the path
# in the drawing. To keep P in a box all the time, remove the # before the next line:
# box = {{ region = "box", of = "P", x = {box[0]}, y = {box[1]}, side = "inside" }}
"""
SHORTEST, LONGEST, ROOM = 0.05, 2.0, 0.3  # least and largest size of a link, room about the path: shares of its size


def names_drawing(source: str) -> bool:
    """Return whether a source is an SVG file, with or without the name of a path behind a #."""
    return source.partition("#")[0].lower().endswith(".svg")


def problem_text(source: str, out: Path | None = None) -> tuple[str, str]:
    """Return the problem file of a path, and how long the path and a unit of its drawing are.

    Parameters
    ----------
    source : str
        Name of an SVG file; if it has several paths, with the id, label or number of one of them: foot.svg#path2.
    out : Path, optional
        The problem file that is written: its text names the drawing from there; default: from the working directory.

    Raises
    ------
    InputError
        If the file cannot be read, or it has several paths of which none is named.
    """
    name, _, path = source.partition("#")
    if not os.path.isfile(name):
        raise InputError("no such file", "Check the path", key="--from", value=source)
    try:
        targets = svg_points({"svg": name} | ({"path": path} if path else {}), Path())
    except Unusable as error:
        several = error.key == "path" and error.remedy.startswith("It has")
        remedy = f"{error.remedy}. Write one behind the file: --from {name}#1" if several else error.remedy
        raise InputError(error.message, remedy, key="--from", value=source) from None
    places, size = 1e3 * np.array(targets.points), 1e3 * targets.size
    digits = 1 - math.floor(math.log10(size))

    def within(low: float, high: float) -> str:
        return json.dumps([f"{round(value, digits):.12g} mm" for value in (low, high)])

    def about(room: float) -> list[str]:
        return [within(min(axis) - room * size, max(axis) + room * size) for axis in places.T.tolist()]

    text = TEXT + OPEN * (not targets.loop)
    filled = text.format(
        title=_quoted(f"Four-bar for the path of {Path(name).name}"),
        note=targets.note,
        size=size,
        sizes=within(SHORTEST * size, LONGEST * size),
        offsets=within(-LONGEST * size, LONGEST * size),
        pivot=about(LONGEST),
        box=about(ROOM),
        name=_quoted(name if out is None else os.path.relpath(name, out.parent)),
        path=f", path = {_quoted(path)}" if path else "",
    )
    return filled, targets.note


def _quoted(text: str) -> str:
    """Return a text as a TOML string."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")
