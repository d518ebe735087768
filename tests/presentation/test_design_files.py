"""The design.toml of every kind of result: from another folder, its machine moves like the design, and its checks pass."""

from __future__ import annotations

import json
import math
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

import optlink
from optlink.cli.app import app
from optlink.presentation.view import View
from optlink.presentation.views import balance, design as design_view

FREE = {"bounds": ["5 mm", "150 mm"]}
PLACE = {"bounds": ["-150 mm", "150 mm"]}
FOUR_BAR = {"type": "four-bar", "crank": FREE, "coupler": FREE, "rocker": FREE, "frame": FREE, "points": {"P": [PLACE, PLACE]}}
SIZES = {"crank": 22.0, "coupler": 71.0, "rocker": 58.0, "frame": 64.0}
POINT = 31.0 + 24.0j
"""P in the axes of the coupler [mm]."""

FIXED = {"type": "four-bar", **{name: f"{size} mm" for name, size in SIZES.items()}}
SLIDER_CRANK = {
    "type": "dyads",
    "ground": {"A": ["0 mm", "0 mm"]},
    "links": {
        "crank": {"joints": ["A", "B"], "length": {"start": "40 mm", "bounds": ["20 mm", "60 mm"]}},
        "rod": {"joints": ["B", "C"], "length": {"start": "150 mm", "bounds": ["120 mm", "200 mm"]}},
        "ram": {"joints": ["C"]},
    },
    "guides": {"F": {"slider": "ram", "through": "A", "direction": "0 deg"}},
    "assembly": {"C": "forward"},
}


def coupler(angles: np.ndarray, sizes: dict[str, float], left: bool) -> tuple[np.ndarray, np.ndarray]:
    """Joint B and the direction of the coupler, as complex numbers, of a four-bar with its frame along +x: two circles meet."""
    b = sizes["crank"] * np.exp(1j * angles)
    way = sizes["frame"] - b
    gap = np.abs(way)
    along = (gap**2 + sizes["coupler"] ** 2 - sizes["rocker"] ** 2) / (2.0 * gap)
    c = b + way / gap * (along + (1j if left else -1j) * np.sqrt(sizes["coupler"] ** 2 - along**2))
    return b, (c - b) / sizes["coupler"]


def traced(angles: np.ndarray) -> np.ndarray:
    """P of the planted four-bar [mm]."""
    b, way = coupler(angles, SIZES, left=True)
    return b + POINT * way


ANGLES = np.radians(200.0 - 15.0 * np.arange(8))
"""The crank turns clockwise."""


def listed(*, timed: bool, posed: bool = False) -> list[dict[str, str]]:
    places = traced(ANGLES) + 0.4 * np.exp(2j * np.arange(8))  # not met exactly
    turned = np.degrees(np.unwrap(np.angle(coupler(ANGLES, SIZES, left=True)[1])))
    rows = [{"x": f"{place.real} mm", "y": f"{place.imag} mm"} for place in places]
    for row, angle, turn in zip(rows, np.degrees(ANGLES - ANGLES[0]), turned, strict=True):
        row |= {"crank": f"{angle} deg"} if timed else {}
        row |= {"angle": f"{turn} deg"} if posed else {}
    return rows


def path_problem(*, timed: bool) -> dict[str, Any]:
    start = {"start": {"bounds": ["-180 deg", "180 deg"]}, "timing": "from start"} if timed else {}
    task = {"kind": "path", "point": "P", "points": listed(timed=timed), **start}
    return {"mechanism": {**FOUR_BAR, "assembly": "left"}, "requirement": task, "limits": {"link_ratio": [0.05, 20.0]}}


def motion_problem() -> dict[str, Any]:
    place = {"pivot": [PLACE, PLACE], "direction": {"bounds": ["-180 deg", "180 deg"]}}
    task = {"kind": "motion", "point": "P", "points": listed(timed=False, posed=True)[::3]}
    return {"mechanism": {**FOUR_BAR, **place, "assembly": "either"}, "requirement": task}


def six_bar_problem() -> dict[str, Any]:
    """A timed path of the lever of a Stephenson III six-bar whose link and crank are free."""
    raw = json.loads(json.dumps(dict(optlink.load("path-stephenson-dwell").raw)))
    raw["mechanism"]["links"]["coupler"] = {
        "joints": ["B", "C"],
        "length": "110 mm",
        "points": {"E": ["120 mm", {"bounds": ["-100 mm", "100 mm"]}]},
    }
    raw["mechanism"]["links"]["rocker"]["length"] = "120 mm"
    raw.pop("expected")
    return raw


def cycle_problem(folder: Path) -> dict[str, Any]:
    (folder / "press.csv").write_text("s_mm,force_N\n100,900\n160,2100\n200,1500\n", encoding="utf-8")
    (folder / "rods.csv").write_text("rod.length_mm\n0.02\n-0.05\n0.03\n", encoding="utf-8")
    return {
        "mechanism": SLIDER_CRANK,
        "tolerances": {"rod.length": "rods.csv", "crank.length": {"tolerance": "0.1 mm", "cost": 2.0}},
        "loads": {"press": {"on": "ram", "force": {"over": "s", "csv": "press.csv"}, "acts": "opposing"}},
        "objective": {"quantity": "torque", "measure": "peak"},
        "limits": {"stroke": {"quantity": "stroke", "of": "ram", "exactly": "70 mm"}},
    }


def problem(kind: str, folder: Path) -> dict[str, Any]:
    fit = {"mechanism": {**FOUR_BAR, "frame": "64 mm", "assembly": "either"}, "limits": {"link_ratio": [0.05, 20.0]}}
    fit["mechanism"].pop("points")
    if kind == "law":
        (folder / "law.csv").write_text("phi_deg,psi_deg\n10,60\n60,80\n120,105\n", encoding="utf-8")
        fit["requirement"] = {"law": {"csv": "law.csv"}, "points": 24}
        fit["mechanism"]["assembly"] = "left"
        fit["tolerances"] = {"crank": "cranks.csv"}
        (folder / "cranks.csv").write_text("crank_mm\n0.01\n-0.02\n", encoding="utf-8")
    elif kind == "function":
        fit["requirement"] = {"law": {"function": "x^2", "x": [1, 2], "input": "80 deg", "output": "60 deg"}, "points": 24}
    elif kind in ("path", "timed path"):
        fit = path_problem(timed=kind == "timed path")
    elif kind == "motion":
        fit = motion_problem()
    elif kind == "transmission":
        fit["requirement"] = {"kind": "transmission"}
        fit["mechanism"]["assembly"] = "right"
        fit["limits"] = {"swing_angle": "60 deg", "time_ratio": 1.08}
    elif kind == "six-bar":
        fit = six_bar_problem()
    elif kind == "cycle":
        fit = cycle_problem(folder)
    else:
        (folder / "drag.csv").write_text("phi_deg,torque_Nm\n0,-0.02\n180,-0.05\n300,-0.01\n", encoding="utf-8")
        fit = {
            "mechanism": {**FIXED, "rocker": {"start": "58 mm", "bounds": ["50 mm", "70 mm"]}},
            "bodies": {name: {"mass": "0.2 kg", "inertia": "uniform bar"} for name in ("crank", "coupler", "rocker")},
            "loads": {"drag": {"on": "rocker", "torque": {"over": "phi", "csv": "drag.csv"}}},
            "drive": {"speed": "20 rad/s"},
            "balance": {
                "minimise": "rms shaking force",
                "counterweights": [{"body": "crank", "thickness": "10 mm", "density": "7850 kg/m^3", "reach": "60 mm"}],
            },
        }
    return {"title": f"A small problem: {kind}", **fit}


def command(*arguments: str) -> dict[str, Any]:
    done = CliRunner().invoke(app, [*arguments, "--json"])
    assert done.exit_code == 0, done.output[-2000:]
    return json.loads(done.stdout)


def column(machine: dict[str, Any], name: str) -> np.ndarray:
    return np.array(machine["columns"][name], dtype=float)


def check_lengths(raw: dict[str, Any], result: dict[str, Any], machine: dict[str, Any]) -> None:
    """Sizes of the result are those of the file and of its analysis."""
    for name, size in machine["sizes"].items():
        if f"{name}_mm" in result["design"]:
            assert size == pytest.approx(1e-3 * result["design"][f"{name}_mm"], rel=1e-12)
    assert {"requirement", "objective"} & set(raw)


def check_law(result: dict[str, Any], machine: dict[str, Any]) -> None:
    """The rocker angle agrees with the intersection of two circles, and the largest error with the result."""
    sizes = {name: result["design"][f"{name}_mm"] for name in SIZES}
    crank, rocker = np.radians(column(machine, "crank_angle_deg")), column(machine, "rocker.angle_rad")
    assert math.remainder(crank[0] - math.radians(result["design"]["phi0_deg"]), math.tau) == pytest.approx(0.0, abs=1e-9)
    b, way = coupler(crank, sizes, result["assembly"] == "left")
    expected = np.angle(b + sizes["coupler"] * way - sizes["frame"])
    np.testing.assert_allclose(np.exp(1j * rocker), np.exp(1j * expected), atol=1e-9)


def check_points(result: dict[str, Any], machine: dict[str, Any], point: str) -> None:
    """The first row is the first point, and rows at the crank angles of the others are where the result says."""
    best, crank = result["designs"][0], np.radians(column(machine, "crank_angle_deg"))
    angles = np.radians(best["points"]["crank_deg"])
    assert math.remainder(crank[0] - angles[0], math.tau) == pytest.approx(0.0, abs=1e-9)
    way = math.copysign(1.0, angles[-1] - angles[0])
    assert way * (crank[1] - crank[0]) > 0.0
    after = np.abs(crank - crank[0])
    for axis in "xy":
        computed = np.interp(np.abs(angles - angles[0]), after, column(machine, f"{point}.{axis}_m"))
        np.testing.assert_allclose(computed * 1e3, best["points"][f"{axis}_mm"], atol=0.05)  # between rows 1 deg apart
        assert computed[0] * 1e3 == pytest.approx(best["points"][f"{axis}_mm"][0], abs=1e-7)


def check_transmission(result: dict[str, Any], machine: dict[str, Any]) -> None:
    """The worst transmission angle is met where crank and frame are in line."""
    s = {name: machine["sizes"][name] for name in SIZES}
    least = []
    for reach in (s["frame"] - s["crank"], s["frame"] + s["crank"]):
        gamma = math.degrees(math.acos((s["coupler"] ** 2 + s["rocker"] ** 2 - reach**2) / (2.0 * s["coupler"] * s["rocker"])))
        least.append(min(gamma, 180.0 - gamma))
    assert min(least) == pytest.approx(result["designs"][0]["least_transmission_deg"], abs=1e-6)
    swing = machine["swings"]["rocker"]
    assert math.degrees(swing["span_rad"]) == pytest.approx(60.0, abs=1e-4)


def check_cycle(result: dict[str, Any], machine: dict[str, Any]) -> None:
    """Peak torque by virtual work: force of the table times ds/dphi."""
    crank, rod = (1e-3 * result["design"][f"{name}.length_mm"] for name in ("crank", "rod"))
    phi = np.linspace(0.0, math.tau, 200_001)
    root = np.sqrt(rod**2 - (crank * np.sin(phi)) ** 2)
    force = np.interp(crank * np.cos(phi) + root, [0.1, 0.16, 0.2], [900.0, 2100.0, 1500.0])
    peak = np.max(np.abs(force * (crank * np.sin(phi) + crank**2 * np.sin(phi) * np.cos(phi) / root)))
    extreme = machine["extremes"]["input.torque_Nm"]
    assert max(abs(extreme["min"]), abs(extreme["max"])) == pytest.approx(peak, rel=1e-8)
    assert result["objective"]["value"] == pytest.approx(peak, rel=1e-7)


def check_balance(result: dict[str, Any], machine: dict[str, Any]) -> None:
    after = {row["name"]: row["after"] for row in result["measures"]}
    force = np.hypot(column(machine, "frame.shaking_fx_N"), column(machine, "frame.shaking_fy_N"))[:-1]
    assert np.sqrt(np.mean(force**2)) == pytest.approx(after["rms shaking force"], rel=1e-8)
    assert np.sqrt(np.mean(column(machine, "input.torque_Nm")[:-1] ** 2)) == pytest.approx(after["rms torque"], rel=1e-8)


KINDS = ["law", "function", "path", "timed path", "motion", "transmission", "six-bar", "cycle", "balance"]


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_the_design_file_of_every_kind_of_result_is_a_machine(kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for module in (design_view, balance):
        plain = View(tables=module.VIEW.tables, design=module.VIEW.design)
        monkeypatch.setattr(module, "VIEW", plain)
    source, elsewhere, moved = tmp_path / "source", tmp_path / "elsewhere", tmp_path / "elsewhere" / "kept"
    source.mkdir()
    elsewhere.mkdir()
    (source / "problem.toml").write_text(optlink_toml(problem(kind, source)), encoding="utf-8")
    monkeypatch.chdir(source)
    verb = "balance" if kind == "balance" else "solve"
    few = ["--starts", "60"] if kind in ("path", "transmission") else ["--starts", "1"] if kind == "function" else []
    result = command(verb, "problem.toml", "--out", "answer", *few)
    (source / "answer").rename(moved)
    for file in source.iterdir():
        file.unlink()
    monkeypatch.chdir(elsewhere)
    machine = command("analyze", "kept/design.toml")
    raw = tomllib.loads((moved / "design.toml").read_text(encoding="utf-8"))
    assert "bounds" not in json.dumps(raw["mechanism"])
    if kind == "balance":
        check_balance(result, machine)
        return
    check_lengths(raw, result, machine)
    checked = command("validate", "kept/design.toml")
    assert checked["valid"]
    assert checked["objective"]["value"] == pytest.approx(result["objective"]["value"], rel=1e-9)
    if kind in ("law", "function"):
        check_law(result, machine)
    elif kind == "transmission":
        check_transmission(result, machine)
    elif kind == "cycle":
        check_cycle(result, machine)
        assert optlink.load(moved / "design.toml").model.deviations[0].values == pytest.approx([2e-5, -5e-5, 3e-5])
    else:
        check_points(result, machine, "G" if kind == "six-bar" else "P")


def optlink_toml(raw: dict[str, Any]) -> str:
    import tomli_w

    return tomli_w.dumps(raw)


def test_files_of_one_name_are_kept_apart(tmp_path: Path) -> None:
    """Two loads over tables of one name in two folders, and a third over the first again: two files beside the design."""
    from optlink.presentation.files import write_design

    raw = cycle_problem(tmp_path)
    for name, force in (("one", 900), ("two", 400)):
        (tmp_path / name).mkdir()
        (tmp_path / name / "force.csv").write_text(f"s_mm,force_N\n100,{force}\n200,1500\n", encoding="utf-8")
    load = raw["loads"].pop("press")
    raw["loads"] = {name: {**load, "force": {"over": "s", "csv": f"{name}/force.csv"}} for name in ("one", "two")}
    raw["loads"]["three"] = {**load, "force": {"over": "s", "csv": str(tmp_path / "one" / "force.csv")}}
    file = optlink.read({"title": "Three loads", **raw}, folder=tmp_path)
    out = tmp_path / "out"
    out.mkdir()
    written = write_design(out, file, "checked")
    assert [path.name for path in written] == ["design.toml", "design-rods.csv", "design-force.csv", "design-force-2.csv"]
    assert (out / "design-rods.csv").read_bytes() == (tmp_path / "rods.csv").read_bytes()
    again = optlink.load(out / "design.toml")
    assert again.model.loads == file.model.loads
    (tmp_path / "two" / "force.csv").unlink()  # the problem has what was read of it
    assert write_design(out, file, "checked") == written
    assert optlink.load(out / "design.toml").model.loads == file.model.loads
