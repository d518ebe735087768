"""Files of workshop sheets: PDF with a sheet a page at true size, DXF with the sheets side by side in millimetres on paper."""

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from ezdxf import units
from ezdxf.document import Drawing
from ezdxf.enums import TextEntityAlignment
from ezdxf.filemanagement import new
from ezdxf.layouts.base import BaseLayout
from matplotlib.axes import Axes
from matplotlib.backends.backend_pdf import PdfPages
from matplotlib.figure import Figure
from matplotlib.patches import Polygon

from optlink.presentation.parts.sheet import Sheet, moved
from optlink.presentation.parts.view import ARROW, GAP, TEXT, Line, Measure, Words
from optlink.presentation.style import apply_style, figure, legible

INCH = 25.4
CAPITAL = 0.729  # height of a capital letter of the font of the figures, as a share of its size
LOOKS = {"outline": (0.5, 7), "thin": (0.25, 7), "centre": (0.25, 1), "solid": (0.0, 7)}
"""Styles of lines, in DXF layers of the same name: width [mm] and AutoCAD's colour."""
CHAIN = (5.0, -1.0, 1.0, -1.0)  # a dash, a gap, a dot, a gap [mm]
STYLE = "SHEET"  # name of what a DXF file defines
APART = 20.0  # distance of two sheets in a DXF file


class _PagePen:
    """Draws into a figure at true size."""

    def __init__(self, axes: Axes) -> None:
        self.axes = axes

    def line(self, one: Line) -> None:
        """Draw a line."""
        wide = LOOKS[one.style][0] * 72.0 / INCH
        dashes = (0, tuple(abs(length) / LOOKS[one.style][0] for length in CHAIN)) if one.style == "centre" else "-"
        look = {
            "facecolor": "black" if one.style == "solid" else "none",
            "edgecolor": "black",
            "linewidth": wide,
            "linestyle": dashes,
        }
        self.axes.add_patch(Polygon(one.corners, closed=one.closed, joinstyle="round", **look))

    def words(self, one: Words) -> None:
        """Draw a text."""
        turned = math.radians(one.angle)
        x, y = one.at - 0.5 * one.height * np.array([-math.sin(turned), math.cos(turned)])
        look: dict[str, Any] = {"fontsize": one.height / CAPITAL * 72.0 / INCH, "rotation": one.angle, "rotation_mode": "anchor"}
        self.axes.text(x, y, one.text, ha=one.align, va="baseline", **look)

    def measure(self, one: Measure) -> None:
        """Draw a dimension."""
        for piece in one.pieces:
            piece.draw(self)


class _LayoutPen:
    """Draws into a layout or block of a DXF document."""

    def __init__(self, drawing: Drawing, layout: BaseLayout) -> None:
        self.drawing, self.layout = drawing, layout

    def line(self, one: Line) -> None:
        """Draw a line: a circle of two half arcs as such."""
        look = {"layer": one.style}
        (x, y, bulge), (u, v, _) = one.vertices[:2]
        if one.style == "solid":
            hatch = self.layout.add_hatch(color=LOOKS[one.style][1], dxfattribs=look)
            hatch.paths.add_polyline_path(one.vertices, is_closed=True)
        elif bulge == 1.0 and len(one.vertices) == 2:
            self.layout.add_circle((0.5 * (x + u), 0.5 * (y + v)), 0.5 * math.hypot(u - x, v - y), dxfattribs=look)
        else:
            self.layout.add_lwpolyline(one.vertices, format="xyb", close=one.closed, dxfattribs=look)

    def words(self, one: Words) -> None:
        """Draw a text."""
        look = {"layer": "thin", "style": STYLE, "rotation": one.angle}
        align = TextEntityAlignment[f"MIDDLE_{one.align.upper()}"]
        self.layout.add_text(one.text, height=one.height, dxfattribs=look).set_placement((*map(float, one.at),), align=align)

    def measure(self, one: Measure) -> None:
        """Add a dimension, its block drawn as on the page; its style has the scale, by which a program measures it again."""
        style = f"{STYLE} {one.factor:g}"
        if style not in self.drawing.dimstyles:
            sizes = {"dimtxt": TEXT, "dimasz": ARROW, "dimexo": 0.0, "dimexe": GAP, "dimgap": GAP, "dimtxsty": STYLE}
            form = {
                "dimdec": 2,
                "dimrnd": 0.01,
                "dimzin": 8,
                "dimdsep": ord("."),
                "dimtad": 1,
                "dimtih": 0,
                "dimtoh": 0,
                "dimlfac": 1.0 / one.factor,
            }
            self.drawing.dimstyles.new(style, dxfattribs={**sizes, **form})
        base = (0.0, one.line) if not one.upright else (one.line, 0.0)
        text, begin, end = f"<>{one.tolerance}", *map(tuple, one.ends)
        made = self.layout.add_linear_dim(
            base, begin, end, text=text, angle=90.0 * one.upright, dimstyle=style, dxfattribs={"layer": "thin"}
        )
        made.set_location((*map(float, one.words.at),))
        block = self.drawing.blocks.new_anonymous_block(type_char="D")
        made.commit()
        made.dimension.dxf.geometry = block.name
        made.dimension.dxf.text_midpoint = (*map(float, one.words.at), 0.0)
        for piece in one.pieces:
            piece.draw(_LayoutPen(self.drawing, block))


def sheet_figure(sheet: Sheet) -> Figure:
    """Return the figure of a sheet at true size."""
    wide, high = sheet.size
    fig = figure(wide / INCH, high / INCH, None)
    axes = fig.add_axes((0.0, 0.0, 1.0, 1.0), xlim=(0.0, wide), ylim=(0.0, high))
    axes.set_axis_off()
    for item in sheet.items:
        item.draw(_PagePen(axes))
    return fig


def sheets_pdf(sheets: Sequence[Sheet], title: str, path: Path) -> None:
    """Write a PDF file; the same sheets give the same bytes."""
    with apply_style(), PdfPages(path, metadata={"Title": title, "CreationDate": None}) as pages:
        for sheet in sheets:
            legible(fig := sheet_figure(sheet))
            pages.savefig(fig)


def sheets_dxf(sheets: Sequence[Sheet], title: str, path: Path) -> None:
    """Write a DXF file."""
    drawing = new("R2010", units=units.MM)
    drawing.header.custom_vars.append("TITLE", title)
    drawing.styles.add(STYLE, font="arial.ttf")
    drawing.linetypes.add("CHAIN", [sum(map(abs, CHAIN)), *CHAIN])
    for style, (wide, colour) in LOOKS.items():
        layer = drawing.layers.add(style, color=colour, lineweight=int(100.0 * wide))
        layer.dxf.linetype = "CHAIN" if style == "centre" else "Continuous"
    pen, x = _LayoutPen(drawing, drawing.modelspace()), 0.0
    for sheet in sheets:
        for item in moved(sheet.items, np.array([x, 0.0])):
            item.draw(pen)
        x += float(sheet.size[0]) + APART
    drawing.saveas(path)


WRITERS: dict[str, Callable[[Sequence[Sheet], str, Path], None]] = {".dxf": sheets_dxf, ".pdf": sheets_pdf}
"""What writes the sheets, by the ending of the file."""
