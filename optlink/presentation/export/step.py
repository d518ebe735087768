"""STEP files [mm] of parts and assemblies: solids of planes and cylinders, components of their names, by Open CASCADE."""

import io
import itertools
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from optlink.errors import InputError, extra_remedy
from optlink.linkage.vector2d import Array
from optlink.presentation.export.dxf import Vertex
from optlink.presentation.parts.model import FlatPart, Pin
from optlink.presentation.parts.outline import edges, middle
from optlink.presentation.parts.solids import profile

try:
    from OCP.APIHeaderSection import APIHeaderSection_MakeHeader
    from OCP.BRepBuilderAPI import (
        BRepBuilderAPI_MakeEdge,
        BRepBuilderAPI_MakeFace,
        BRepBuilderAPI_MakePolygon,
        BRepBuilderAPI_MakeWire,
    )
    from OCP.BRepPrimAPI import BRepPrimAPI_MakePrism, BRepPrimAPI_MakeRevol
    from OCP.gp import gp_Ax1, gp_Ax2, gp_Circ, gp_Dir, gp_Pln, gp_Pnt, gp_Trsf, gp_Vec
    from OCP.Message import Message, Message_Gravity
    from OCP.STEPCAFControl import STEPCAFControl_Writer
    from OCP.TCollection import TCollection_ExtendedString, TCollection_HAsciiString
    from OCP.TDataStd import TDataStd_Name
    from OCP.TDocStd import TDocStd_Document
    from OCP.TopLoc import TopLoc_Location
    from OCP.TopoDS import TopoDS, TopoDS_Shape, TopoDS_Wire
    from OCP.XCAFDoc import XCAFDoc_DocumentTool
except ImportError:
    message = "STEP files need the package cadquery-ocp-novtk, which is not installed"
    raise InputError(message, extra_remedy("cad")) from None

NEAR = 2e-7  # distance [mm] of points that are one to Open CASCADE, with a margin
LONG_AGO = "1980-01-01T00:00:00"  # the same design gives the same file
UP = gp_Dir(0.0, 0.0, 1.0)
AXIS = gp_Ax1(gp_Pnt(0.0, 0.0, 0.0), UP)


@dataclass(frozen=True, eq=False)
class Body:
    """A named solid in its own axes and where it is."""

    name: str
    shape: TopoDS_Shape
    place: TopLoc_Location

    def moved(self, shift: Array, angle: float = 0.0) -> "Body":
        """Return the body turned by an angle [rad] about the z axis, then shifted by a vector (3,)."""
        turned, shifted = gp_Trsf(), gp_Trsf()
        turned.SetRotation(AXIS, angle)
        shifted.SetTranslation(gp_Vec(*map(float, shift)))
        return Body(self.name, self.shape, TopLoc_Location(shifted * turned) * self.place)


def plate(part: FlatPart) -> Body:
    """Return a part from z = 0 to its thickness."""
    face = BRepBuilderAPI_MakeFace(gp_Pln(gp_Pnt(0.0, 0.0, 0.0), UP), _wire(part.outline))
    for opening in part.openings:
        face.Add(TopoDS.Wire(_wire(opening.outline).Reversed()))
    return _body(part.name, BRepPrimAPI_MakePrism(face.Face(), gp_Vec(0.0, 0.0, part.thickness)).Shape())


def stud(pin: Pin, low: float, high: float) -> Body:
    """Return a pin through parts from one height to another [mm], with its heads beyond."""
    edge = BRepBuilderAPI_MakePolygon()
    steps = profile(pin, low, high)
    for radius, z in ((0.0, steps[0][1]), *steps, (0.0, steps[-1][1])):
        edge.Add(gp_Pnt(radius, 0.0, z))
    edge.Close()
    return _body(f"pin {pin.name}", BRepPrimAPI_MakeRevol(BRepBuilderAPI_MakeFace(edge.Wire()).Face(), AXIS).Shape())


def _body(name: str, shape: TopoDS_Shape) -> Body:
    return Body(name, shape, TopLoc_Location())


def _wire(outline: Sequence[Vertex]) -> TopoDS_Wire:
    """Return an outline as straight edges and arcs of circles; two half arcs are a circle."""
    wire = BRepBuilderAPI_MakeWire()
    kept = [one for one, other in edges(outline) if math.dist(one[:2], other[:2]) > NEAR]
    for (x, y, bulge), (u, v, _) in edges(kept):
        begin, end = gp_Pnt(x, y, 0.0), gp_Pnt(u, v, 0.0)
        if bulge == 0.0:
            wire.Add(BRepBuilderAPI_MakeEdge(begin, end).Edge())
            continue
        centre = middle((x, y), (u, v), bulge)
        circle = gp_Circ(gp_Ax2(gp_Pnt(*map(float, centre), 0.0), UP), math.dist(centre, (x, y)))
        if bulge == 1.0 and len(kept) == 2:
            wire.Add(BRepBuilderAPI_MakeEdge(circle).Edge())
            break
        wire.Add(BRepBuilderAPI_MakeEdge(circle, begin, end).Edge())
    return wire.Wire()


def step(bodies: Sequence[Body], title: str, path: Path) -> None:
    """Write an assembly with a component of its name for every body."""
    document = TDocStd_Document(TCollection_ExtendedString("BinXCAF"))
    tool = XCAFDoc_DocumentTool.ShapeTool_s(document.Main())
    assembly = tool.NewShape()
    title = " ".join(title.split())
    _name(assembly, title)
    for body in bodies:
        label = tool.AddShape(body.shape, False)
        _name(label, body.name)
        _name(tool.AddComponent(assembly, label, body.place), body.name)
    tool.UpdateAssemblies()
    for printer in Message.DefaultMessenger_s().Printers():
        printer.SetTraceLevel(Message_Gravity.Message_Fail)
    writer = STEPCAFControl_Writer()
    writer.Transfer(document)
    head = APIHeaderSection_MakeHeader(writer.ChangeWriter().Model())
    for put, text in ((head.SetName, title), (head.SetTimeStamp, LONG_AGO), (head.SetOriginatingSystem, "optlink")):
        put(TCollection_HAsciiString(text))
    for put in (head.SetAuthorValue, head.SetOrganizationValue):
        put(1, TCollection_HAsciiString(""))
    file, count = io.BytesIO(), itertools.count(1)
    writer.WriteStream(file)
    text = re.sub(r"(?<=NEXT_ASSEMBLY_USAGE_OCCURRENCE\(')\d+", lambda _: str(next(count)), file.getvalue().decode())
    path.write_text(re.sub(r"[^\0-\x7f]+", _escaped, text), encoding="ascii")


def _escaped(letters: re.Match[str]) -> str:
    """Return letters that are not of ASCII in the form of ISO 10303-21, of UTF-16 in hexadecimal digits."""
    return f"\\X2\\{letters[0].encode('utf-16-be').hex().upper()}\\X0\\"


def _name(label: Any, text: str) -> None:
    TDataStd_Name.Set_s(label, TCollection_ExtendedString(text, True))
