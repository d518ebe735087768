"""STEP files of parts and assemblies, read back by the reader of Open CASCADE: solids, cylinders, volumes and names."""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from optlink.presentation.parts.layers import stacked
from optlink.presentation.parts.model import part_set
from tests.cli.test_cli import run
from tests.presentation.test_parts import ENDED, area, area_of, distances, holes_of, of, written

needs_ocp = pytest.mark.skipif(find_spec("OCP") is None, reason="the extra cad is not installed")
NAMES = ["crank-rocker", "shaper", "slider-crank", "watt-i", "toggle-press", "slotted-quick-return", "two-wipers", "six-bar"]
NAMES += ["stephenson-iii", "press-toggle"]


@dataclass(frozen=True)
class Cylinder:
    """A cylindrical face: a point of its axis, its direction, radius, and whether material lies outside of it, as at a hole."""

    axis: np.ndarray
    direction: np.ndarray
    radius: float
    hole: bool


@dataclass(frozen=True)
class Component:
    """A component of an assembly: its name and that of its product, its shape where it is."""

    name: str
    product: str
    shape: Any

    @property
    def volume(self) -> float:
        from OCP.BRepGProp import BRepGProp
        from OCP.GProp import GProp_GProps

        found = GProp_GProps()
        BRepGProp.VolumeProperties_s(self.shape, found, 1e-13, True)
        return found.Mass()

    @property
    def heights(self) -> list[float]:
        """The lowest and the highest of its corners."""
        from OCP.BRep import BRep_Tool
        from OCP.TopoDS import TopoDS

        heights = [BRep_Tool.Pnt_s(TopoDS.Vertex(corner)).Z() for corner in self.pieces("VERTEX")]
        return [min(heights), max(heights)]

    def pieces(self, kind: str) -> list[Any]:
        """Corners, faces, shells or solids."""
        from OCP import TopAbs, TopExp

        found, explorer = [], TopExp.TopExp_Explorer(self.shape, getattr(TopAbs.TopAbs_ShapeEnum, f"TopAbs_{kind}"))
        while explorer.More():
            found.append(explorer.Current())
            explorer.Next()
        return found

    def faces(self) -> tuple[list[Cylinder], int]:
        """Cylinders, and the number of planes; other faces are not expected."""
        from OCP.BRepAdaptor import BRepAdaptor_Surface
        from OCP.GeomAbs import GeomAbs_SurfaceType
        from OCP.TopAbs import TopAbs_Orientation
        from OCP.TopoDS import TopoDS

        cylinders, planes = [], 0
        for face in self.pieces("FACE"):
            surface = BRepAdaptor_Surface(TopoDS.Face(face))
            if surface.GetType() == GeomAbs_SurfaceType.GeomAbs_Plane:
                planes += 1
                continue
            assert surface.GetType() == GeomAbs_SurfaceType.GeomAbs_Cylinder
            one = surface.Cylinder()
            at, way = one.Axis().Location(), one.Axis().Direction()
            inwards = (face.Orientation() == TopAbs_Orientation.TopAbs_REVERSED) == one.Position().Direct()
            places = np.array([at.X(), at.Y(), at.Z()]), np.array([way.X(), way.Y(), way.Z()])
            cylinders.append(Cylinder(*places, one.Radius(), inwards))
        return cylinders, planes


def read_step(path: Path) -> tuple[str, list[Component]]:
    """The name of the assembly and its components."""
    from OCP.collections import Sequence_TDF_Label
    from OCP.STEPCAFControl import STEPCAFControl_Reader
    from OCP.TCollection import TCollection_ExtendedString
    from OCP.TDataStd import TDataStd_Name
    from OCP.TDF import TDF_Label
    from OCP.TDocStd import TDocStd_Document
    from OCP.XCAFDoc import XCAFDoc_DocumentTool, XCAFDoc_ShapeTool

    def name(label) -> str:
        found = TDataStd_Name()
        assert label.FindAttribute(TDataStd_Name.GetID_s(), found)
        return found.Get().ToExtString()

    reader, document = STEPCAFControl_Reader(), TDocStd_Document(TCollection_ExtendedString("BinXCAF"))
    reader.SetNameMode(True)
    reader.ReadFile(str(path))
    assert reader.Transfer(document)
    free, inside = Sequence_TDF_Label(), Sequence_TDF_Label()
    XCAFDoc_DocumentTool.ShapeTool_s(document.Main()).GetFreeShapes(free)
    assert free.Length() == 1
    XCAFDoc_ShapeTool.GetComponents_s(free.Value(1), inside)
    found = []
    for k in range(inside.Length()):
        label, product = inside.Value(k + 1), TDF_Label()
        assert XCAFDoc_ShapeTool.GetReferredShape_s(label, product)
        found.append(Component(name(label), name(product), XCAFDoc_ShapeTool.GetShape_s(label)))
    return name(free.Value(1)), found


def assert_closed(component: Component) -> None:
    from OCP.BRepCheck import BRepCheck_Analyzer

    assert BRepCheck_Analyzer(component.shape).IsValid()
    assert len(component.pieces("SOLID")) == len(component.pieces("SHELL")) == 1
    assert component.pieces("SHELL")[0].Closed()


@pytest.mark.slow
@needs_ocp
@pytest.mark.parametrize("name", NAMES)
def test_parts_are_closed_solids_with_true_cylinders(name, tmp_path):
    """Volumes are those of outlines less openings to 1e-12; distances of holes are those of the motion to 1e-6 mm."""
    about = of(name)
    parts, wanted = part_set(about.cycle).parts, holes_of(about)
    title, read = read_step(written(about, tmp_path / "a.step"))
    assert title == about.problem.model.title
    assert [one.name for one in read] == [one.product for one in read]
    assert {one.name for one in read} == parts.keys()
    compared = 0
    for one in read:
        part = parts[one.name]
        assert_closed(one)
        exact = part.thickness * (area(part.outline) - sum(area(opening.outline) for opening in part.openings))
        assert one.volume == pytest.approx(exact, rel=1e-12)
        assert one.heights == pytest.approx([0.0, part.thickness], abs=1e-9)
        cylinders, planes = one.faces()
        assert all(abs(cylinder.direction[2]) == 1.0 for cylinder in cylinders)
        holes = [cylinder for cylinder in cylinders if cylinder.hole]
        assert len(holes) == sum(1 if opening.round else 2 for opening in part.openings)
        assert sorted(cylinder.radius for cylinder in holes) == pytest.approx(
            sorted(0.5 * opening.diameter for opening in part.openings for _ in range(1 if opening.round else 2)), rel=1e-12
        )
        arcs = sum(bulge != 0.0 for *_, bulge in part.outline)
        assert len(cylinders) - len(holes) == (1 if planes == 2 else arcs)
        if one.name in wanted:
            found = distances(np.array([cylinder.axis[:2] for cylinder in holes]))
            np.testing.assert_allclose(found, wanted[one.name], rtol=0, atol=1e-6)
            compared += len(found)
    assert compared


@pytest.mark.slow
@needs_ocp
@pytest.mark.parametrize(("name", "end"), ENDED)
def test_parts_with_straight_ends_have_the_volumes_of_closed_forms(name, end, tmp_path):
    """To 1e-12, as closed solids of planes but for their openings."""
    about = of(name, {"parts.end": end})
    parts = part_set(about.cycle).parts
    for one in read_step(written(about, tmp_path / "a.step"))[1]:
        part = parts[one.name]
        assert_closed(one)
        assert one.volume == pytest.approx(part.thickness * area_of(part), rel=1e-12)
        cylinders, _ = one.faces()
        assert all(cylinder.hole for cylinder in cylinders) == (end != "round")


@pytest.mark.slow
@needs_ocp
@pytest.mark.parametrize("name", ["crank-rocker", "shaper", "watt-i", "six-bar"])
def test_an_assembly_has_parts_and_pins_in_their_places(name, tmp_path):
    """Every pin has the axis of the holes that it passes through, is as thick as stated, and reaches beyond its parts."""
    about = of(name)
    stack = stacked(part_set(about.cycle))
    path = written(about, tmp_path / "a.step", content="assembly", at=1.0 if about.cycle.full else None)
    read = {one.name: one for one in read_step(path)[1]}
    tubes = {f"spacer {pin.name}": (pin, tube) for pin, _, tube in stack.spacers}
    assert read.keys() == {*stack.parts.parts, *(f"pin {pin.name}" for pin in stack.parts.pins), *tubes}
    for tube_name, (pin, tube) in tubes.items():
        exact = 0.25 * math.pi * (tube.width**2 - pin.diameter**2) * tube.thickness
        assert read[tube_name].volume == pytest.approx(exact, rel=1e-12)
    for body, layer in stack.layers.items():
        low = layer * stack.parts.pitch
        assert read[body].heights == pytest.approx([low, low + stack.parts.parts[body].thickness], abs=1e-7)
    for pin in stack.parts.pins:
        one = read[f"pin {pin.name}"]
        assert_closed(one)
        low, high = stack.span(pin)
        assert one.heights == pytest.approx([low - pin.height, high + pin.height], abs=1e-7)
        exact = 0.25 * math.pi * (pin.diameter**2 * (high - low) + 2.0 * pin.height * pin.head**2)
        assert one.volume == pytest.approx(exact, rel=1e-12)
        (axis, *others) = (cylinder.axis[:2] for cylinder in one.faces()[0])
        np.testing.assert_allclose(others, [axis] * len(others), atol=1e-9)
        for body in pin.parts:
            openings = {opening.joint: opening for opening in stack.parts.parts[body].openings}
            if openings[pin.name].round:
                holes = np.array([cylinder.axis[:2] for cylinder in read[body].faces()[0] if cylinder.hole])
                assert np.linalg.norm(holes - axis, axis=1).min() < 1e-6


@pytest.mark.slow
@needs_ocp
def test_the_same_design_gives_the_same_step_file(tmp_path):
    """Without the hour and the counters of the library; letters that are not of ASCII are escaped as the standard says."""
    about = of("crank-rocker", {"title": "Kurbelschwinge für Ø 20\n 'mm'"})
    once, again = (written(about, tmp_path / f"{name}.step", content="assembly") for name in "ab")
    assert once.read_bytes() == again.read_bytes()
    assert once.read_bytes().isascii()
    assert read_step(once)[0] == "Kurbelschwinge für Ø 20 'mm'"


@pytest.mark.slow
@needs_ocp
@pytest.mark.parametrize("factor", [1e-4, 1e5])
def test_small_and_large_linkages(factor, tmp_path):
    sizes = {name: f"{length * factor} mm" for name, length in {"crank": 40, "coupler": 120, "rocker": 80, "frame": 120}.items()}
    about = of("crank-rocker", {f"mechanism.{name}": size for name, size in sizes.items()})
    for one in read_step(written(about, tmp_path / "a.step"))[1]:
        assert_closed(one)
        assert one.volume > 0.0


def test_without_the_package_the_extra_is_named(tmp_path, monkeypatch):
    monkeypatch.delitem(sys.modules, "optlink.presentation.export.step", raising=False)
    monkeypatch.delattr("optlink.presentation.export.step", raising=False)
    for module in ("OCP", "OCP.APIHeaderSection"):
        monkeypatch.setitem(sys.modules, module, None)
    result = run("export", "crank-rocker", "-o", str(tmp_path / "a.step"))
    assert result.exit_code == 2
    says = 'STEP files need the package cadquery-ocp-novtk, which is not installed. Install the extra cad: pip install ".[cad]"'
    assert says in " ".join(result.stderr.split())
    assert not [*tmp_path.iterdir()]
