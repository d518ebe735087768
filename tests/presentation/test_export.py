"""Exported files read back by other programs: DXF by ezdxf, SVG by an XML parser, CSV and JSON by the standard library."""

from __future__ import annotations

import csv
import errno
import itertools
import json
import math
import os
import re
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import ezdxf
import numpy as np
import pytest
from ezdxf.document import Drawing

import optlink
from optlink.dynamics.machine import slider_names
from optlink.presentation.export import dxf
from optlink.presentation.export.dimensions import dimensioned
from optlink.presentation.export.export import FORMATS, Options, export, geometry
from optlink.presentation.export.svg import svg
from optlink.presentation.report_model import ReportModel, report_model_of, solve_or_validate
from optlink.presentation.scene import scene
from optlink.problem.file import fixed_design
from optlink.problem.mechanism import sizes_of
from optlink.tasks.analyze import analyze
from optlink.tasks.design import SynthesisTask
from tests.cli.test_cli import run
from tests.tiers import mostly_slow

MACHINES = ("crank-rocker", "shaper", "watt-i", "toggle-press", "scotch-yoke", "slider-crank", "oscillating-cylinder")
SVG = "{http://www.w3.org/2000/svg}"
SWINGING = """
title = "Double-rocker"
[mechanism]
crank = "400 mm"
coupler = "200 mm"
rocker = "400 mm"
frame = "500 mm"
[drive]
start = "{start} deg"
"""


def subject(name: str) -> ReportModel:
    file = optlink.load(name)
    return report_model_of(solve_or_validate(file))


@pytest.fixture(scope="module", params=MACHINES)
def machine(request) -> ReportModel:
    return subject(request.param)


@pytest.fixture(scope="module")
def crank_rocker_subject() -> ReportModel:
    return subject("crank-rocker")


def holes(block) -> list[np.ndarray]:
    return [np.array(circle.dxf.center)[:2] for circle in block.query("CIRCLE")]


def assembled(drawing: Drawing) -> dict[str, list[np.ndarray]]:
    """Centres of the holes of every block of the assembly, where ezdxf puts them."""
    computed = {}
    for insert in drawing.modelspace().query('INSERT[layer=="ASSEMBLY"]'):
        parts = insert.virtual_entities()
        computed[insert.dxf.name] = [np.array(part.dxf.center)[:2] for part in parts if part.dxftype() == "CIRCLE"]
    return computed


def written(about: ReportModel, path: Path, **options) -> Drawing:
    export(about, path, Options(**options))
    return ezdxf.readfile(path)


def machine_as_stated(name: str) -> ReportModel:
    """The machine of a shipped problem with its values and starts; of modes that are open, the first that closes."""
    file = optlink.load(name)
    for variant in file.variants():
        settled_ = fixed_design(variant, sizes_of(variant.model.mechanism.quantities))
        try:
            cycle = optlink.analyze(settled_)
        except optlink.InputError:
            continue
        return ReportModel(settled_, cycle, cycle)
    pytest.skip("its start cannot be assembled: only a search finds its sizes")


# --- DXF ---------------------------------------------------------------------------------------------------------------------


def test_links_of_a_dxf_have_their_lengths(machine, tmp_path):
    """Every link of known length: the distance of its first two holes is the length that the problem gives."""
    drawing = written(machine, tmp_path / "a.dxf")
    mechanism, sizes = machine.cycle.machine.mechanism, machine.cycle.machine.sizes
    compared = 0
    for link in mechanism.links:
        if link.start in mechanism.pins and link.end in mechanism.pins:
            length = 1e3 * (sizes[link.length] if isinstance(link.length, str) else link.length)
            centres = holes(drawing.blocks[f"LINK {link.body}"])
            distances = [float(np.linalg.norm(a - b)) for a in centres for b in centres]
            assert min(abs(distance - length) for distance in distances) <= 1e-9
            compared += 1
    assert compared >= (0 if machine.problem.name == "scotch-yoke" else 1)


@pytest.mark.parametrize("name", mostly_slow(sorted(optlink.shipped()), *sorted(optlink.shipped())[::3]))
def test_every_shipped_machine_is_read_back_from_its_dxf(name, tmp_path):
    """Links, pivots and slots of all shipped problems, against the sizes that the problem states."""
    about = machine_as_stated(name)
    drawing = written(about, tmp_path / "a.dxf", at=math.radians(float(about.cycle["crank_angle_deg"][1])))
    assert drawing.audit().errors == []
    machine = about.cycle.machine
    mechanism, sizes = machine.mechanism, {key: 1e3 * float(np.asarray(value)) for key, value in machine.sizes.items()}
    tolerance = 1e-9 * max(1.0, max(scene(about.cycle).box[2:]) / 1000.0)
    compared = 0
    for link in mechanism.links:
        if isinstance(link.length, str) and {link.start, link.end} <= mechanism.pins.keys():
            centres = holes(drawing.blocks[f"LINK {link.body}"])
            distances = [float(np.linalg.norm(a - b)) for a in centres for b in centres]
            assert min(abs(distance - sizes[link.length]) for distance in distances) <= tolerance, link.body
            compared += 1
    pivots = [point for point in mechanism.ground if point in mechanism.pins and f"{point}.x" in sizes]
    ground = holes(drawing.blocks["FRAME"])
    for point in pivots:
        place = np.array([sizes[f"{point}.x"], sizes[f"{point}.y"]])
        assert min(float(np.linalg.norm(place - hole)) for hole in ground) <= tolerance, point
        compared += 1
    for guide in mechanism.guides:
        slider = slider_names(machine)[guide.name]
        stroke = np.ptp(about.cycle[f"{slider}.s_m"][np.isfinite(about.cycle[f"{slider}.s_m"])]) * 1e3
        block = drawing.blocks["FRAME" if guide.on == "frame" else f"LINK {guide.on}"]
        if guide.on == "frame":
            lengths = [float(np.linalg.norm(np.array(one.dxf.end) - np.array(one.dxf.start))) for one in block.query("LINE")]
        else:
            corners = [np.array(line.get_points("xy")) for line in block.query("LWPOLYLINE")]
            lengths = [float(np.linalg.norm(one[1] - one[2])) for one in corners if len(one) == 4]
        # at the rows of the table the stroke is at most that between the exact dead centres
        assert any(stroke - tolerance <= length <= stroke * (1 + 1e-3) + 1e-6 for length in lengths), (
            guide.name,
            stroke,
            lengths,
        )
        compared += 1
    assert compared >= 1


def test_a_dxf_of_the_solved_crank_rocker(crank_rocker_subject, tmp_path):
    """The published optimum, read from the drawing alone."""
    drawing = written(crank_rocker_subject, tmp_path / "a.dxf")
    for body, length in {"crank": 100.0, "coupler": 412.86542, "rocker": 232.24617}.items():
        first, second = holes(drawing.blocks[f"LINK {body}"])
        assert np.linalg.norm(first - second) == pytest.approx(length, abs=1e-5)
    first, second = holes(drawing.blocks["FRAME"])
    assert np.linalg.norm(first - second) == pytest.approx(500.0, abs=1e-9)
    assert drawing.units == ezdxf.units.MM
    assert {"LINK crank", "LINK coupler", "LINK rocker", "ASSEMBLY", "PARTS"} <= {layer.dxf.name for layer in drawing.layers}
    assert drawing.audit().errors == []


def test_the_assembly_closes(machine, tmp_path):
    """At every pin the holes of all links that share it lie on one another: the loops close in the drawing."""
    drawing = written(machine, tmp_path / "a.dxf", at=math.radians(37.0))
    centres, extent = assembled(drawing), max(scene(machine.cycle).box[2:])
    for bodies in machine.cycle.machine.mechanism.pins.values():
        blocks = ["FRAME" if body == "frame" else f"LINK {body}" for body in bodies]
        first, *others = (np.array(centres[block]) for block in blocks)
        for other in others:
            nearest = np.min(np.linalg.norm(first[:, None] - other[None, :], axis=-1))
            assert nearest <= 1e-9 * extent


def test_the_assembly_stands_at_the_crank_angle(crank_rocker_subject, tmp_path):
    centres = assembled(written(crank_rocker_subject, tmp_path / "a.dxf", at=math.radians(110.0)))
    a, b = sorted(centres["LINK crank"], key=np.linalg.norm)
    assert np.degrees(np.arctan2(*(b - a)[::-1])) == pytest.approx(110.0, abs=1e-9)
    d = np.array([500.0, 0.0])
    # the joint between coupler and rocker by the law of cosines, on the left of B -> D
    coupler, rocker = (1e3 * crank_rocker_subject.result.design[name] for name in ("coupler", "rocker"))
    reach = np.linalg.norm(d - b)
    angle = math.acos((coupler**2 + reach**2 - rocker**2) / (2 * coupler * reach))
    way = math.atan2(*(d - b)[::-1]) + angle
    c = b + coupler * np.array([math.cos(way), math.sin(way)])
    assert min(np.linalg.norm(c - hole) for hole in centres["LINK rocker"]) <= 1e-9 * 500


def area(polyline) -> float:
    """Of the polygon, and of the circular segment over every edge with a bulge: tan(a quarter of the arc)."""
    corners = polyline.get_points("xyb")
    computed = 0.0
    for (x, y, bulge), (u, v, _) in zip(corners, [*corners[1:], corners[0]], strict=True):
        computed += (x * v - y * u) / 2
        if bulge:
            arc, chord = 4 * math.atan(bulge), math.hypot(u - x, v - y)
            computed += (chord / (2 * math.sin(arc / 2))) ** 2 / 2 * (arc - math.sin(arc))
    return computed


@pytest.mark.parametrize(
    "corners",
    [
        [(0.0, 0.0)],
        [(0.0, 0.0), (80.0, 0.0)],
        [(0.0, 0.0), (40.0, 0.0), (80.0, 0.0)],
        [(0.0, 0.0), (80.0, 0.0), (20.0, 50.0)],
        [(0.0, 0.0), (80.0, 0.0), (40.0, 0.0), (20.0, -50.0), (30.0, -10.0)],
    ],
)
def test_outlines_by_steiners_formula(corners):
    """Area of everything within r of a convex set: its area + its perimeter times r + pi r^2 (J. Steiner)."""
    radius = 7.0
    drawing = ezdxf.new()
    outline = drawing.modelspace().add_lwpolyline(dxf.rounded(np.array(corners), radius), format="xyb", close=True)
    ring = [c for c in corners if c not in {(40.0, 0.0), (30.0, -10.0)}]
    turned = list(zip(ring, [*ring[1:], ring[0]], strict=True))
    inner = abs(sum(p[0] * q[1] - p[1] * q[0] for p, q in turned)) / 2
    around = sum(math.dist(p, q) for p, q in turned)
    assert area(outline) == pytest.approx(inner + around * radius + math.pi * radius**2, rel=1e-12)


def test_holes_and_widths_can_be_chosen(crank_rocker_subject, tmp_path):
    drawing = written(crank_rocker_subject, tmp_path / "a.dxf", hole=0.008, width=0.03)
    block = drawing.blocks["LINK crank"]
    assert {circle.dxf.radius for circle in block.query("CIRCLE")} == {4.0}
    assert area(block.query("LWPOLYLINE")[0]) == pytest.approx(100.0 * 30.0 + math.pi * 15.0**2, rel=1e-12)


@pytest.mark.parametrize(("extent", "size"), [(100.0, 3.0), (520.0, 15.0), (1.0, 0.03), (33.0, 0.8), (2000.0, 60.0)])
def test_the_usual_hole_is_a_round_number(extent, size):
    assert dxf.usual_hole(extent) == pytest.approx(size, rel=1e-12)


def test_default_holes_of_a_short_crank_do_not_overlap(tmp_path):
    sizes = {"crank": "5 mm", "coupler": "200 mm", "rocker": "200 mm", "frame": "250 mm"}
    file = optlink.read({"mechanism": sizes})
    drawing = written(report_model_of(solve_or_validate(file)), tmp_path / "a.dxf")
    assert {circle.dxf.radius for circle in drawing.blocks["LINK crank"].query("CIRCLE")} == {1.0}


def test_a_slot_is_as_long_as_the_slider_travels(tmp_path):
    """The block of the shaper slides from |AC| - r to |AC| + r on the rocker: 2 r, and the slot's round ends."""
    drawing = written(subject("shaper"), tmp_path / "a.dxf", hole=0.02)
    slot, outline = drawing.blocks["LINK rocker"].query("LWPOLYLINE")
    assert area(slot) == pytest.approx(250.0 * 20.0 + math.pi * 10.0**2, rel=1e-12)
    assert area(outline) > area(slot)


# --- SVG, CSV, JSON ----------------------------------------------------------------------------------------------------------


def test_an_svg_is_in_true_size(crank_rocker_subject, tmp_path):
    export(crank_rocker_subject, tmp_path / "a.svg", Options(at=0.5))
    root = ElementTree.parse(tmp_path / "a.svg").getroot()
    box = [float(part) for part in root.get("viewBox").split()]
    assert [root.get("width"), root.get("height")] == [f"{part:.3f}".rstrip("0").rstrip(".") + "mm" for part in box[2:]]
    joints = {}
    for circle in root.iter(f"{SVG}circle"):
        if circle.get("data-point"):
            x, y = circle.get("transform").removeprefix("translate(").rstrip(")").split()
            joints[circle.get("data-point")] = np.array([float(x), -float(y)])
    design = crank_rocker_subject.result.design
    for pair, name in {"AB": "crank", "BC": "coupler", "CD": "rocker", "AD": "frame"}.items():
        assert np.linalg.norm(joints[pair[0]] - joints[pair[1]]) == pytest.approx(1e3 * design[name], abs=2e-3)
    assert math.atan2(*(joints["B"] - joints["A"])[::-1]) == pytest.approx(0.5, abs=1e-4)


def test_a_csv_keeps_the_lengths_and_leaves_out_forces(crank_rocker_subject, tmp_path):
    export(crank_rocker_subject, tmp_path / "a.csv", Options(points=48))
    with (tmp_path / "a.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 49
    for row in rows:
        b, c = (np.array([float(row[f"{name}.{axis}_m"]) for axis in "xy"]) for name in "BC")
        assert np.linalg.norm(b) == pytest.approx(0.1, abs=1e-12)
        assert np.linalg.norm(c - b) == pytest.approx(crank_rocker_subject.result.design["coupler"], abs=1e-12)
    assert not [name for name in rows[0] if name.endswith(("_N", "_Nm", "_J", "_W"))]
    export(subject("six-bar"), tmp_path / "b.csv")
    assert "input.torque_Nm" in (tmp_path / "b.csv").read_text().splitlines()[0]


def test_a_json_holds_the_whole_geometry(machine):
    """Points in the axes of their bodies, brought to where the bodies are, are where the points are."""
    document = geometry(machine, machine.cycle, 0.7)
    assert document["problem_hash"] == machine.problem.hash
    for body in document["bodies"].values():
        c, s = math.cos(body["angle_rad"]), math.sin(body["angle_rad"])
        for name, (along, across) in body["points_m"].items():
            x, y = body["at_m"][0] + along * c - across * s, body["at_m"][1] + along * s + across * c
            assert [x, y] == pytest.approx(document["points_m"][name], abs=1e-12)


# --- the command ---------------------------------------------------------------------------------------------------------------


GOOD = ("export", "crank-rocker")


def left_behind(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


@pytest.mark.parametrize("ending", [".dxf", ".svg", ".csv", ".json"])
def test_every_format_by_the_command(tmp_path, ending):
    path = tmp_path / f"a{ending}"
    done = run(*GOOD, "-o", str(path), "--at", "45 deg", "--json")
    assert done.exit_code == 0
    assert json.loads(done.stdout)["bytes"] == path.stat().st_size > 500
    assert left_behind(tmp_path) == [path.name]


def test_a_folder_is_no_file_to_write(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "folder.dxf").mkdir()
    done = run(*GOOD, "-o", "folder.dxf")
    assert done.exit_code == 2
    assert "this is a folder" in done.stderr
    assert left_behind(tmp_path) == ["folder.dxf"]


def test_a_crank_angle_that_cannot_be_reached(tmp_path):
    problem = tmp_path / "swing.toml"
    problem.write_text(SWINGING.format(start=60))
    done = run("export", str(problem), "-o", str(tmp_path / "a.dxf"), "--at", "180 deg")
    assert done.exit_code == 2
    assert "fails to close by" in done.stderr
    assert "Give an angle within" in done.stderr
    assert left_behind(tmp_path) == ["swing.toml"]
    problem.write_text(SWINGING.format(start=180))
    done = run("export", str(problem), "-o", str(tmp_path / "a.dxf"))
    assert done.exit_code == 2
    assert left_behind(tmp_path) == ["swing.toml"]


def test_an_invalid_design_is_exported_only_on_request(tmp_path):
    design = ("--design", "coupler=410 mm", "--design", "rocker=220 mm")
    path = tmp_path / "a.dxf"
    done = run(*GOOD, *design, "-o", str(path))
    assert done.exit_code == 1
    assert "transmission angle" in done.stderr
    assert not path.exists()
    document = json.loads(run(*GOOD, *design, "-o", str(path), "--json").stdout)
    assert document["valid"] is False
    assert document["file"] is None
    assert run(*GOOD, *design, "-o", str(path), "--even-invalid").exit_code == 1
    first, second = holes(ezdxf.readfile(path).blocks["LINK coupler"])
    assert np.linalg.norm(first - second) == pytest.approx(410.0, abs=1e-9)


def test_export_does_not_overwrite_its_input(tmp_path):
    result = tmp_path / "result.json"
    result.write_text(run("solve", "crank-rocker", "--json").stdout)
    before = result.read_bytes()
    done = run("export", str(result), "-o", str(result))
    assert done.exit_code == 2
    assert "overwrite" in done.stderr
    assert result.read_bytes() == before


STORED = (("solve",), "stroke-crank-rocker")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("command", "name"),
    [STORED, (("solve",), "path-arc5"), (("study", "sensitivity"), "crank-rocker")],
)
def test_a_stored_design_is_exported_without_a_search(command, name, tmp_path, monkeypatch):
    """The file is that of the design itself."""
    monkeypatch.chdir(tmp_path)
    assert run(*command, name, "--out", "out").exit_code == 0
    assert run("export", name, "-o", "design.dxf").exit_code == 0
    monkeypatch.setattr(SynthesisTask, "search", lambda *_: pytest.fail("it is searched again"))
    assert run("export", "out", "-o", "stored.dxf").exit_code == 0
    blocks = [ezdxf.readfile(f"{name}.dxf").blocks for name in ("design", "stored")]
    links = [[block.name for block in part if block.name.startswith("LINK")] for part in blocks]
    assert links[0] == links[1] != []
    for link in links[0]:
        for own, other in zip(*(holes(part[link]) for part in blocks), strict=True):
            np.testing.assert_allclose(own, other, atol=1e-9)


def test_a_full_disk_leaves_no_files(tmp_path, monkeypatch, crank_rocker_subject):
    path = tmp_path / "a.dxf"
    path.write_text("as it was")

    def full(self, name, *_):
        Path(name).write_text("half", encoding="utf-8")
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Drawing, "saveas", full)
    with pytest.raises(optlink.InputError, match="No space left"):
        export(crank_rocker_subject, path)
    assert left_behind(tmp_path) == ["a.dxf"]
    assert path.read_text() == "as it was"


LIMITED = """
import resource, sys
resource.setrlimit(resource.RLIMIT_FSIZE, (2000, 2000))
from typer.testing import CliRunner
from optlink.cli.app import app
for path in sys.argv[1:]:
    done = CliRunner().invoke(app, ["report" if path.endswith(".html") else "export", "six-bar", "-o", path])
    print(done.exit_code)
    print(done.output, file=sys.stderr)
"""


@pytest.mark.slow
def test_failed_writes_keep_the_previous_file(tmp_path):
    """A limit of the system on the size of files, met in the middle of the writing, in a process of its own.

    The machine can be no model of MuJoCo and no link of PMKS+.
    """
    pytest.importorskip("resource", reason="this system has no such limits")
    paths = [tmp_path / f"a{ending}" for ending in (*sorted(FORMATS.keys() - {".xml", ".txt"}), ".html")]
    for path in paths:
        path.write_text("as it was")
    command = [sys.executable, "-c", LIMITED, *map(str, paths)]
    environment = os.environ | {"PYTHONDONTWRITEBYTECODE": "1"}  # else the modules that it compiles are cut short as well
    done = subprocess.run(command, capture_output=True, text=True, check=True, env=environment)
    assert done.stdout.split() == ["2"] * len(paths), done.stderr
    assert "Traceback" not in done.stderr
    assert done.stderr.count("cannot write the file: File too large") == len(paths)
    assert left_behind(tmp_path) == sorted(path.name for path in paths)
    assert {path.read_text() for path in paths} == {"as it was"}


@pytest.mark.parametrize("ending", mostly_slow([".svg", ".csv", ".json", ".html"], ".svg"))
def test_a_full_disk_keeps_the_previous_file(tmp_path, monkeypatch, ending):
    """Every way of writing, with a disk that is full after the first letters."""
    path = tmp_path / f"a{ending}"
    path.write_text("as it was")
    opened = Path.open

    def full(self, *arguments, **keywords):
        if self.name.startswith(".a-"):
            with opened(self, "w") as file:
                file.write("half")
            raise OSError(errno.ENOSPC, "No space left on device")
        return opened(self, *arguments, **keywords)

    monkeypatch.setattr(Path, "open", full)
    done = run("report" if ending == ".html" else "export", "shaper", "-o", str(path))
    monkeypatch.undo()
    assert done.exit_code == 2
    assert "No space left on device" in done.stderr
    assert left_behind(tmp_path) == [path.name]
    assert path.read_text() == "as it was"


def test_a_full_disk_at_the_first_byte(tmp_path, monkeypatch):
    """Not even the temporary file can be made; and long names leave room for it."""
    import tempfile

    def full(*_, **__):
        raise OSError(errno.ENOSPC, "No space left on device")

    path = tmp_path / f"{'a' * 245}.svg"
    assert run("export", "shaper", "-o", str(path)).exit_code == 0
    before = path.read_bytes()
    monkeypatch.setattr(tempfile, "mkstemp", full)
    done = run("export", "shaper", "-o", str(path), "--at", "40 deg")
    assert done.exit_code == 2
    assert "No space left on device" in done.stderr
    assert path.read_bytes() == before
    assert left_behind(tmp_path) == [path.name]


def test_file_names_that_are_too_long_are_refused(tmp_path):
    for command, ending in {"export": "dxf", "report": "html"}.items():
        done = run(command, "a" * 300, "-o", str(tmp_path / f"a.{ending}"))
        assert done.exit_code == 2
        assert "no such problem" in done.stderr


@pytest.mark.parametrize("command", ["export", "report"])
@pytest.mark.parametrize("as_json", [False, True])
def test_an_unwritable_target_is_reported_before_solving(tmp_path, monkeypatch, command, as_json):
    """A missing folder, a file instead of a folder, a folder instead of a file, an unknown extension."""
    monkeypatch.chdir(tmp_path)
    ending = ".html" if command == "report" else ".dxf"
    (tmp_path / f"folder{ending}").mkdir()
    (tmp_path / "file").write_text("mine")
    monkeypatch.setattr("optlink.presentation.report_model.solve_or_validate", None)  # whatever is solved would break down
    for name, words in {
        f"nowhere/a{ending}": "there is no folder",
        f"file/a{ending}": "there is no folder",
        f"folder{ending}": "this is a folder",
        "a.xyz": "cannot write",
        "a": "the name has no ending",
        f"{'a' * 300}{ending}": "the name is too long",
        **({f"/proc/a{ending}": "cannot write there"} if Path("/proc").exists() else {}),
    }.items():
        done = run(command, "crank-rocker", "-o", name, *(["--json"] if as_json else []))
        assert done.exit_code == 2, name
        assert words in " ".join(done.stderr.split()), (name, done.stderr)
        assert "Traceback" not in done.stderr
        if as_json:
            assert [fault["key"] for fault in json.loads(done.stdout)["faults"]] == ["--out"]
    assert left_behind(tmp_path) == ["file", f"folder{ending}"]


def test_no_permission(tmp_path, monkeypatch):
    """Also for those whom no permission binds: the trial file cannot be made."""
    import tempfile

    def refused(*_, **__):
        raise PermissionError(errno.EACCES, "Permission denied")

    monkeypatch.setattr(tempfile, "TemporaryFile", refused)
    done = run(*GOOD, "-o", str(tmp_path / "a.dxf"))
    assert done.exit_code == 2
    assert "Permission denied" in done.stderr


LONG = {
    "A": "fixed_pivot_of_the_crank_at_the_left",
    "B": "pin_between_crank_and_link_two",
    "C": "pin_between_link_two_and_link_three",
    "D": "fixed_pivot_of_the_rocker",
    "E": "pin_between_link_five_and_slider",
}


def boxes_of_names(drawing: str) -> dict[str, tuple[float, float, float, float]]:
    """Left, top, right and bottom of the names on the page, for letters of 0.6 of their height."""
    [size] = map(float, re.findall(r'data-layer="names"[^>]*font-size="([\d.]+)"', drawing))
    move = r'transform="translate\(([-\d.]+) ([-\d.]+)\)"'
    shown = rf'<g data-point="([^"]*)" {move}><g data-name="[^"]*" {move}><text y="([-\d.]+)"[^>]*>([^<]*)</text>'
    computed = {}
    for name, *numbers, text in re.findall(shown, drawing):
        x, y, right, down, drop = map(float, numbers)
        half, low = 0.3 * size * len(text), y + down + drop
        computed[name] = x + right - half, low - 0.85 * size, x + right + half, low + 0.15 * size
    return computed


@pytest.mark.slow
def test_long_point_names_do_not_overlap_in_the_animation():
    """Over all positions; both ends of a name are shown, and all of it on hovering."""
    text = json.dumps({key: value for key, value in optlink.load("six-bar").raw.items() if key != "expected"})
    text = text.replace("left of B-D", f"left of {LONG['B']}-{LONG['D']}")
    for short, long in LONG.items():
        text = text.replace(f'"{short}"', f'"{long}"')
    moving = scene(analyze(optlink.read(json.loads(text))))
    drawing = svg(moving, "six-bar")
    assert set(boxes_of_names(drawing)) == set(LONG.values())
    assert f"<title>{LONG['E']}</title>pin_be\u2026lider<" in drawing
    left, low, wide, high = moving.box
    top = -low - high
    meeting = 0
    for k in range(len(moving.crank_angles)):
        placed = [np.array(box) for box in boxes_of_names(svg(moving, "six-bar", k, traces=False)).values()]
        for one, other in itertools.combinations(placed, 2):
            meeting += bool(np.all(np.minimum(one[2:], other[2:]) > np.maximum(one[:2], other[:2])))
        assert all(box[0] >= left and box[1] >= top and box[2] <= left + wide and box[3] <= top + high for box in placed)
    assert meeting < 0.25 * len(moving.crank_angles)  # only where the crank pin passes the name of its pivot


@pytest.mark.slow
def test_pivot_names_do_not_overlap_the_hatching():
    moving = scene(analyze(optlink.load("six-bar")))
    boxes = boxes_of_names(svg(moving, "six-bar"))
    for name in moving.mechanism.ground:
        left, top, right, low = boxes[name]
        ground = np.concatenate([line for line, _, _ in moving.ground]) * [1.0, -1.0]
        assert not np.any((ground[:, 0] > left) & (ground[:, 0] < right) & (ground[:, 1] > top) & (ground[:, 1] < low)), name


FLAT = {
    "crank": ("30 mm", "110 mm", "80 mm", "100 mm"),
    "short crank": ("6 mm", "110 mm", "80 mm", "100 mm"),
    "flat kite": ("40 mm", "100 mm", "40 mm", "100 mm"),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", FLAT)
def test_every_name_of_a_moving_drawing_is_nearest_to_its_own_point(name):
    """Also where links lie flat on one another; only the name of a pivot, which does not move, may be passed by a pin."""
    raw = dict(zip(("crank", "coupler", "rocker", "frame"), FLAT[name], strict=True))
    assembly = "parallelogram" if name == "flat kite" else "left"
    moving = scene(analyze(optlink.read({"mechanism": {**raw, "assembly": assembly}})))
    wrong = {True: 0, False: 0}
    for k in range(0, len(moving.crank_angles), 5):
        for own, box in boxes_of_names(svg(moving, name, k=k, traces=False)).items():
            left, top, right, low = box
            places = {point: path[k] * [1.0, -1.0] for point, path in moving.points.items()}
            distances = {
                point: math.hypot(max(left - x, 0.0, x - right), max(top - y, 0.0, y - low))
                for point, (x, y) in places.items()
                if point == own or math.dist(places[point], places[own]) > moving.size
            }
            wrong[own in moving.mechanism.ground] += min(distances, key=lambda point: distances[point]) != own
    assert wrong[False] == 0
    assert wrong[True] <= 8


@pytest.mark.slow
def test_names_are_readable_without_the_order_of_painting():
    """Programs that do not know `paint-order` draw the rim of a letter over it: a white blot."""
    problem = optlink.load("six-bar")
    for drawing in (svg(scene(analyze(problem)), "six-bar"), dimensioned(analyze(problem), "six-bar").svg):
        assert "paint-order" not in drawing
        texts = re.findall(r"<text [^>]*>", drawing)
        assert texts
        assert not [text for text in texts if "stroke=" in text and 'fill="none"' not in text]


def test_the_springs_of_a_dxf_reach_their_ends(tmp_path):
    """One between two points, and one about the joint of the two bodies that it turns against each other."""
    raw = json.loads(
        json.dumps({key: value for key, value in optlink.load("slotted-quick-return").raw.items() if key != "expected"})
    )
    raw["loads"]["leaf"] = {"on": "rocker", "torsional_stiffness": "5 N*m/rad"}
    export(report_model_of(analyze(optlink.read(raw))), tmp_path / "springs.dxf", Options(at=math.radians(40.0)))
    drawing = ezdxf.readfile(tmp_path / "springs.dxf")
    tension, torsion = (np.array(one.get_points("xy")) for one in drawing.modelspace().query('LWPOLYLINE[layer=="SPRINGS"]'))
    crank = 100.0 * np.array([math.cos(math.radians(40.0)), math.sin(math.radians(40.0))]) + [0.0, 250.0]
    ram = 480.0 * crank[0] / crank[1]  # the rocker turns about the origin; the ram moves along y = 480 mm
    np.testing.assert_allclose(tension[[0, -1]], [[700.0, 480.0], [ram + 150.0, 480.0]], atol=1e-6)
    away = np.linalg.norm(torsion, axis=1)  # from the pivot of the rocker
    assert np.all(np.diff(away) > 0.0)
    turned = np.unwrap(np.arctan2(torsion[:, 1], torsion[:, 0]))
    assert turned[-1] - turned[0] == pytest.approx(4.0 * math.pi)
    bare = json.loads(json.dumps(raw))
    bare["loads"] = {"cutting": raw["loads"]["cutting"]}
    export(report_model_of(analyze(optlink.read(bare))), tmp_path / "bare.dxf")
    assert "SPRINGS" not in {layer.dxf.name for layer in ezdxf.readfile(tmp_path / "bare.dxf").layers}
