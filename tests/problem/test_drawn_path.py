"""The problem file of a path in a drawing: sizes in proportion to it, the path that is named, and what an open one needs."""

import re
import tomllib

import numpy as np
import pytest

import optlink
from tests.cli.test_cli import run

INKSCAPE = 'xmlns="http://www.w3.org/2000/svg" xmlns:inkscape="http://www.inkscape.org/namespaces/inkscape"'
HALF = "m 20,50 h 60 a 30 30 0 0 0 -60 0 z"


def drawing(folder, *paths: str, root: str = 'width="100mm" height="100mm" viewBox="0 0 100 100"') -> str:
    """Write a drawing of paths, each with an id, a label and a layer of its own; return its name."""
    shapes = "".join(
        f'<g inkscape:label="layer {k}"><path id="p{k}" inkscape:label="way {k}" d="{path}"/></g>'
        for k, path in enumerate(paths, 1)
    )
    name = folder / "foot.svg"
    name.write_text(f"<svg {INKSCAPE} {root}>{shapes}</svg>", encoding="utf-8")
    return str(name)


def written(folder, source: str) -> optlink.ProblemFile:
    """The problem that `new` writes into another folder than that of the drawing."""
    (folder / "machines").mkdir(exist_ok=True)
    out = folder / "machines" / "mine.toml"
    done = run("new", "--from", source, "--out", str(out), "--force")
    assert done.exit_code == 0, done.output
    assert f"optlink solve {out}" in done.stdout
    return optlink.load(out)


def test_the_bounds_have_the_size_of_the_path_and_the_pivot_lies_about_it(tmp_path):
    for scale in (1.0, 40.0):
        root = f'width="{100 * scale}mm" height="{100 * scale}mm" viewBox="0 0 100 100"'
        task = written(tmp_path, drawing(tmp_path, HALF, root=root)).spec
        size = 1e-3 * scale * np.hypot(60.0, 30.0)
        assert task.closed
        for name in ("crank", "coupler", "rocker", "frame"):
            assert task.quantities[name].bounds == pytest.approx((0.05 * size, 2.0 * size), rel=0.2, abs=0.03 * size)
        middle = [np.mean(task.quantities[f"A.{axis}"].bounds) for axis in "xy"]
        assert middle == pytest.approx([1e-3 * scale * 50.0, -1e-3 * scale * 35.0], abs=0.05 * size)


def test_one_of_several_paths_is_named_by_id_label_or_number(tmp_path):
    name = drawing(tmp_path, "M 0 0 h 90", HALF)
    refused = run("new", "--from", name)
    assert refused.exit_code == 2
    listed = '1 <path id="p1"> "way 1" in the layer "layer 1", 2 <path id="p2"> "way 2" in the layer "layer 2"'
    assert listed in refused.stderr
    remedy = re.search(r"--from (\S+)#1", refused.stderr)
    assert remedy is not None
    assert remedy[1] == name
    for path in ("p2", "way 2", "2"):
        assert written(tmp_path, f"{name}#{path}").spec.closed


def test_the_box_of_an_open_path_can_be_taken_as_it_is_written(tmp_path):
    file = written(tmp_path, drawing(tmp_path, "M 20 50 C 30 10 70 10 80 50"))
    assert not file.spec.closed
    text = (tmp_path / "machines" / "mine.toml").read_text(encoding="utf-8")
    raw = tomllib.loads(re.sub(r"^# (?=box = )", "", text, flags=re.MULTILINE))
    box = optlink.read(raw, folder=tmp_path / "machines").spec.limits.regions["box"]
    places = 1e3 * np.array(file.spec.target_points.points)
    assert box.side == "inside"
    for axis, (low, high) in zip("xy", ((places.min(axis=0)[k], places.max(axis=0)[k]) for k in (0, 1)), strict=True):
        stated = [float(text.split()[0]) for text in raw["limits"]["box"][axis]]
        assert stated[0] < low < high < stated[1]


@pytest.mark.parametrize(("unit", "factor"), [("pt", 25.4 / 72.0), ("px", 25.4 / 96.0), ("2 mm", 2.0), ("0.5 in", 12.7)])
def test_the_unit_of_a_drawing_is_one_of_svg_or_a_length(tmp_path, unit, factor):
    drawing(tmp_path, "M 0 0 h 90", root="")
    points = {"svg": "foot.svg", "unit": unit, "points": 2}
    section = {"type": "four-bar", "crank": {"bounds": ["1 mm", "2 m"]}, "coupler": "1 m", "rocker": "1 m", "frame": "1 m"}
    raw = {
        "title": "A line",
        "mechanism": {**section, "points": {"P": ["0 mm", "0 mm"]}, "assembly": "left"},
        "requirement": {"kind": "path", "points": points},
    }
    assert optlink.read(raw, folder=tmp_path).spec.target_points.points[1][0] == pytest.approx(0.09 * factor, rel=1e-12)
