"""Models of MuJoCo run in MuJoCo: one revolution of shipped machines against `optlink.analyze`, and what is refused."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
import tomli_w

import optlink
from optlink.dynamics.columns import MotionColumns
from optlink.presentation.export.mjcf import STEPS, mjcf
from tests.tiers import mostly_slow

ROOT = Path(__file__).parents[2]
BAR, BLOCK = {"mass": "1 kg", "inertia": "uniform bar"}, {"mass": "1 kg"}
FOUR_BAR = {"bodies": dict.fromkeys(("crank", "coupler", "rocker"), BAR)}
SIX_BAR = {"bodies": {**dict.fromkeys(("crank", "coupler", "rocker", "rod"), BAR), "slider": BLOCK}}
SLIDER_CRANK = {"bodies": {"crank": BAR, "rod": BAR, "slider": BLOCK}}
STEPHENSON = tomllib.loads((ROOT / "problems/stephenson-iii.toml").read_text())
MACHINES: dict[str, dict[str, Any]] = {
    "six-bar": {},
    "oscillating-cylinder": {},
    "slider-crank": {},
    "balance-four-bar": {},
    "balance-six-bar": {},
    "crank-rocker-clearance": {},
    "slider-crank-clearance": {},
    "slider-crank-three-gaps": {},
    "press-toggle": {"loads": {"pressing": {"on": "ram", "force": "500 N", "direction": "270 deg"}}},
    "toggle-press": {"loads": {}},
    "scotch-yoke": {"loads": {"drag": {"on": "yoke", "force": "-20 N"}}},
    "stephenson-iii": {
        "loads": {
            **{name: STEPHENSON["loads"][name] for name in STEPHENSON["loads"] if name != "process"},
            "process": {"on": "lever", "torque": "-3 N*m"},
        }
    },
    "watt-i": {"loads": {"knee": {"on": "leg", "torque": "2 N*m"}}},
    "whitworth": {"loads": {}},
    "shaper": {
        "loads": {},
        "bodies": {"rocker": {"mass": "20 kg", "inertia": "0.12 kg*m^2"}, "coupler": BAR, "ram": BLOCK, "block": BLOCK},
    },
    "crank-rocker": FOUR_BAR,
    "path-crank-rocker": FOUR_BAR,
    "crank-rocker-robust": FOUR_BAR,
    "law-six-bar": SIX_BAR,
    "path-slider-egg": SLIDER_CRANK,
    "law-slider-crank": SLIDER_CRANK,
}
"""Shipped machines with the sections that are replaced: loads that MuJoCo cannot have, and masses where the file has none."""


@pytest.fixture(autouse=True)
def _folder_of_the_log(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """MuJoCo writes its warnings to MUJOCO_LOG.TXT in the working folder."""
    monkeypatch.chdir(tmp_path)


def machine(name: str, folder: Path, sections: dict[str, Any]) -> optlink.Analysis:
    raw = tomllib.loads((ROOT / "problems" / f"{name}.toml").read_text()) | sections
    raw.pop("expected", None)
    path = folder / f"{name}.toml"
    path.write_text(tomli_w.dumps(raw))
    return optlink.analyze(optlink.load(path))


def deviations(run: optlink.Analysis) -> tuple[float, float]:
    """Run a revolution; return the largest deviation of a point over the size, and of the torque over its largest."""
    at = float(run.positions[0])
    model = mujoco.MjModel.from_xml_string(mjcf(run, at))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    places, torques = np.empty((STEPS, model.nsite, 2)), np.empty(STEPS)
    for step in range(STEPS):
        mujoco.mj_step(model, data)
        places[step], torques[step] = data.site_xpos[:, [0, 2]], data.actuator_force[0]
    way = 2.0 * np.pi / STEPS * np.sign(run.speed)
    moving = run.machine.moving(at + way * np.arange(STEPS), run.speed)
    before = run.machine.moving(at + way * (np.arange(STEPS) - 1), run.speed)
    sites = [mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_SITE, index) for index in range(model.nsite)]
    apart = [
        np.hypot(*(places[:, index].T - np.broadcast_arrays(*moving.position(site.partition(".")[2]), np.zeros(STEPS))[:2]))
        for index, site in enumerate(sites)
        if "." in site
    ]
    expected = MotionColumns(before)["input.torque_Nm"]
    late = slice(STEPS // 20, None)
    return np.max(apart) / run.machine.size, np.max(np.abs(torques - expected)[late]) / np.max(np.abs(expected))


@pytest.mark.parametrize("name", mostly_slow(MACHINES, "six-bar", "oscillating-cylinder"))
def test_a_revolution_in_mujoco(name, tmp_path):
    place, torque = deviations(machine(name, tmp_path, MACHINES[name]))
    assert place < 1e-5
    assert torque < 1e-3


REFUSED = {
    "watt-i": "loads.ground: MuJoCo has no counterpart for the load ground, which is not constant or linear. "
    "Leave it out, or make it a constant force or torque, or a spring",
    "slotted-quick-return": "mechanism.guides.F.friction: MuJoCo has no counterpart for friction in the guide F. Set it to zero",
    "templates/geared-five-bar.toml": "mechanism: MuJoCo has no counterpart for train (gears). "
    "Export a machine without gears, racks and cams",
    "crank-rocker": "bodies.coupler: MuJoCo has no counterpart for the body coupler without a mass. "
    'Give it one: coupler = { mass = "1 kg", inertia = "uniform bar" }',
    "templates/lift.toml": "drive: MuJoCo has no counterpart for a drive other than a crank at constant speed. "
    'Drive a body pinned to the frame: speed = "60 rpm"',
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_mujoco_cannot_have_is_refused_by_name(name):
    run = optlink.analyze(optlink.load(str(ROOT / name) if "/" in name else name))
    with pytest.raises(optlink.InputError) as error:
        mjcf(run, float(run.positions[0]))
    assert str(error.value).endswith(f": {REFUSED[name]}")


def test_a_design_that_stops_at_a_dead_centre_is_refused(tmp_path):
    """Coupler and rocker together are as long as the crank and the frame, or 1e-10 mm shorter."""
    links = {name: {"joints": list(joints), "length": "250 mm"} for name, joints in {"coupler": "BC", "rocker": "DC"}.items()}
    ground = {"A": ["0 mm", "0 mm"], "D": ["400 mm", "0 mm"]}
    raw = {"title": "t", **FOUR_BAR, "drive": {"body": "crank", "speed": "60 rpm", "start": "180 deg"}}
    links = {"crank": {"joints": ["A", "B"], "length": "100 mm"}, **links}
    for length in ("250 mm", "249.9999999999 mm"):
        links["coupler"]["length"] = length
        assembly = {"C": "left of B-D"}
        raw["mechanism"] = {"type": "dyads", "ground": ground, "links": links, "assembly": assembly}
        (tmp_path / "dead.toml").write_text(tomli_w.dumps(raw))
        run = optlink.analyze(tmp_path / "dead.toml")
        with pytest.raises(optlink.InputError, match="cannot be assembled over the whole turn, or passes a dead centre"):
            mjcf(run, float(run.positions[0]))
