"""Files for laser cutting: every part once, at true size in millimetres, apart from the others, with its name to engrave."""

import math
from collections.abc import Callable, Sequence
from html import escape
from pathlib import Path

import numpy as np

from optlink.linkage.vector2d import Array
from optlink.presentation.export.dxf import Vertex
from optlink.presentation.parts.layout import Placed, engraved, laid_out
from optlink.presentation.parts.model import PartSet
from optlink.presentation.parts.outline import edges

CUT, ENGRAVE = "CUT", "ENGRAVE"
LOOKS = {CUT: ("#ff0000", 1), ENGRAVE: ("#0000ff", 5)}
"""Layers with their colours in SVG and in DXF (AutoCAD's number)."""
CROSS = 0.25  # half the arm of the cross at a point that is no joint, in hole diameters
HAIRLINE = 0.1  # width of lines in SVG [mm]


def cutting_dxf(parts: PartSet, title: str, path: Path) -> None:
    """Write a DXF file: closed polylines and circles on the layer CUT, names and crosses on ENGRAVE."""
    from ezdxf import units
    from ezdxf.enums import TextEntityAlignment
    from ezdxf.filemanagement import new

    drawing = new("R2010", units=units.MM)
    drawing.header.custom_vars.append("TITLE", " ".join(title.split()))
    for layer, (_, colour) in LOOKS.items():
        drawing.layers.add(layer, color=colour)
    space = drawing.modelspace()
    cut, mark = {"layer": CUT}, {"layer": ENGRAVE}
    for one in laid_out(parts.parts.values()).parts:
        space.add_lwpolyline(_moved(one.part.outline, one.shift), format="xyb", close=True, dxfattribs=cut)
        for opening in one.part.openings:
            if opening.round:
                space.add_circle(tuple(opening.ends[0] + one.shift), 0.5 * opening.diameter, dxfattribs=cut)
            else:
                space.add_lwpolyline(_moved(opening.outline, one.shift), format="xyb", close=True, dxfattribs=cut)
        for begin, end in _crosses(one):
            space.add_line(tuple(begin), tuple(end), dxfattribs=mark)
        if name := engraved(one.part):
            look = {**mark, "rotation": math.degrees(name.angle)}
            text = space.add_text(name.text, height=name.height, dxfattribs=look)
            text.set_placement(tuple(name.at + one.shift), align=TextEntityAlignment.MIDDLE_CENTER)
    drawing.saveas(path)


def cutting_svg(parts: PartSet, title: str, path: Path) -> None:
    """Write an SVG file: one unit is a millimetre, red lines are cut, blue ones engraved, in a layer each."""
    sheet = laid_out(parts.parts.values())
    wide, high = (_number(size) for size in sheet.size)
    cut: list[str] = []
    mark: list[str] = []
    for one in sheet.parts:
        cut.append(f'<g id="{escape(one.part.name)}">')
        cut.append(f'<path d="{path_data(_moved(one.part.outline, one.shift))}"/>')
        for opening in one.part.openings:
            x, y = opening.ends[0] + one.shift
            circle = f'<circle cx="{_number(x)}" cy="{_number(-y)}" r="{_number(0.5 * opening.diameter)}"/>'
            cut.append(circle if opening.round else f'<path d="{path_data(_moved(opening.outline, one.shift))}"/>')
        cut.append("</g>")
        for (x, y), (u, v) in _crosses(one):
            mark.append(f'<path d="M{_number(x)} {_number(-y)} L{_number(u)} {_number(-v)}"/>')
        if name := engraved(one.part):
            x, y = name.at + one.shift
            place = f"translate({_number(x)} {_number(-y)}) rotate({_number(-math.degrees(name.angle))})"
            font = f'font-family="sans-serif" font-size="{_number(name.height / 0.72)}" text-anchor="middle"'
            mark.append(f'<text transform="{place}" y="{_number(0.5 * name.height)}" {font}>{escape(name.text)}</text>')
    lines = [
        '<svg xmlns="http://www.w3.org/2000/svg" xmlns:inkscape="http://www.inkscape.org/namespaces/inkscape"',
        f'  width="{wide}mm" height="{high}mm" viewBox="0 -{high} {wide} {high}">',
        f"<title>{escape(title)}</title>",
    ]
    for layer, drawn in ((CUT, cut), (ENGRAVE, mark)):
        look = f'fill="none" stroke="{LOOKS[layer][0]}" stroke-width="{HAIRLINE}"'
        lines += [f'<g id="{layer}" inkscape:groupmode="layer" inkscape:label="{layer}" {look}>', *drawn, "</g>"]
    path.write_text("\n".join([*lines, "</svg>\n"]), encoding="utf-8")


WRITERS: dict[str, Callable[[PartSet, str, Path], None]] = {".dxf": cutting_dxf, ".svg": cutting_svg}
"""What writes the parts, by the ending of the file."""


def _moved(outline: Sequence[Vertex], shift: Array) -> list[Vertex]:
    return [(x + float(shift[0]), y + float(shift[1]), bulge) for x, y, bulge in outline]


def _crosses(one: Placed) -> list[tuple[Array, Array]]:
    """Return the lines of the crosses at the points of a part that are no joints."""
    arms = CROSS * one.part.openings[0].diameter * np.eye(2)
    return [(at + one.shift - way, at + one.shift + way) for at in one.part.marks.values() for way in arms]


def _number(value: float) -> str:
    return f"{float(value):z.9f}".rstrip("0").rstrip(".") or "0"


def path_data(outline: Sequence[Vertex]) -> str:
    """Return a closed outline as path data; the y axis of SVG points down."""
    text = f"M{_number(outline[0][0])} {_number(-outline[0][1])}"
    for (x, y, bulge), (u, v, _) in edges(outline):
        radius = 0.25 * math.hypot(u - x, v - y) * abs(bulge + 1.0 / bulge) if bulge else 0.0
        large = int(abs(bulge) > 1.0)
        arc = f"A{_number(radius)} {_number(radius)} 0 {large} 0" if bulge else "L"
        text += f" {arc} {_number(u)} {_number(-v)}"
    return text + "Z"
