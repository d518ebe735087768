"""Pictures of a simulation in time: the bodies that turn and the forces of the frame, against the columns of the simulation."""

from __future__ import annotations

import functools

import numpy as np
import pytest

import optlink
from optlink.presentation.chart_spec import Curve
from optlink.presentation.registry import view_of

BAR = {"mass": "2 kg", "inertia": "uniform bar"}
PRESS = {
    "title": "Press with an inclined guide",
    "gravity": "9.81 m/s^2",
    "mechanism": {
        "type": "dyads",
        "ground": {"A": ["0 mm", "0 mm"], "D": ["300 mm", "0 mm"]},
        "links": {
            "crank": {"joints": ["A", "B"], "length": "70 mm"},
            "rod": {"joints": ["B", "C"], "length": "280 mm"},
            "rocker": {"joints": ["D", "C"], "length": "160 mm"},
            "pull": {"joints": ["C", "E"], "length": "250 mm"},
            "ram": {"joints": ["E"]},
        },
        "guides": {"F": {"slider": "ram", "on": "frame", "through": "D", "direction": "10 deg"}},
        "assembly": {"C": "left of B-D", "E": "forward"},
    },
    "bodies": {**dict.fromkeys(("crank", "rod", "rocker", "pull"), BAR), "ram": {"mass": "5 kg"}},
}
DRIVES = {
    "speed": {"speed": "60 rpm", "start": "20 deg"},
    "torque": {"torque": "1 N*m", "initial_speed": "60 rpm", "start": "20 deg"},
}


@functools.cache
def simulated(drive: str) -> optlink.Simulation:
    return optlink.simulate(optlink.read({**PRESS, "drive": DRIVES[drive]}), duration=0.6, rows=600)


def curves(result: optlink.Simulation, file: str) -> list[Curve]:
    """All curves of a picture."""
    charts = [chart for chart in view_of("simulation").charts(result) if chart.file == file]
    return [trace for chart in charts for panel in chart.panels for trace in panel.traces]


@pytest.mark.parametrize("drive", DRIVES)
def test_the_angular_velocity_of_every_link_is_drawn(drive):
    result = simulated(drive)
    assert [curve.name for curve in curves(result, "bodies")] == ["rod", "rocker", "pull"]  # the ram does not turn
    for curve in curves(result, "bodies"):
        np.testing.assert_array_equal(curve.x, result["time_s"])
        slope = np.gradient(np.unwrap(result[f"{curve.name}.angle_rad"]), result["time_s"])
        np.testing.assert_allclose(curve.y[2:-2], slope[2:-2], atol=5e-3 * np.ptp(slope))


@pytest.mark.parametrize("drive", DRIVES)
def test_the_forces_of_the_frame_are_drawn_by_components_and_balance_the_machine(drive):
    """Their sum is the rate of momentum less the weight: 13 kg, and the shaking force is minus that rate."""
    result = simulated(drive)
    drawn = {curve.gid: curve.y for curve in curves(result, "reactions") if curve.gid}
    assert set(drawn) == {"A.fx_N", "A.fy_N", "D.fx_N", "D.fy_N", "F.normal_N"}
    normal = drawn["F.normal_N"]
    across, up = -np.sin(np.radians(10.0)), np.cos(np.radians(10.0))
    size = max(np.max(np.abs(values)) for values in drawn.values())
    for total, shaking in (
        (drawn["A.fx_N"] + drawn["D.fx_N"] + across * normal, result["frame.shaking_fx_N"]),
        (drawn["A.fy_N"] + drawn["D.fy_N"] + up * normal - 13.0 * 9.81, result["frame.shaking_fy_N"]),
    ):
        np.testing.assert_allclose(total, -shaking, atol=1e-9 * size)


def test_the_amounts_of_all_joint_forces_are_drawn():
    result = simulated("speed")
    amounts = {curve.name: curve.y for curve in curves(result, "reactions") if not curve.gid}
    assert set(amounts) == {"A", "B", "C.rod", "C.rocker", "C.pull", "D", "E", "F"}
    np.testing.assert_allclose(amounts["C.pull"] ** 2, result["C.pull.fx_N"] ** 2 + result["C.pull.fy_N"] ** 2, rtol=1e-9)


def test_without_masses_and_loads_there_are_no_forces_to_draw():
    massless = optlink.simulate(optlink.read({**PRESS, "bodies": {}, "drive": DRIVES["speed"]}), duration=0.8, rows=20)
    assert curves(massless, "reactions") == []
    assert len(curves(massless, "bodies")) == 3


def test_rounding_errors_of_a_constant_speed_do_not_set_its_scale():
    (chart,) = (chart for chart in view_of("simulation").charts(simulated("speed")) if chart.file == "drive")
    low, high = chart.panels[0].y.limits
    assert low < 60.0 < high
    assert high - low > 6.0  # rpm
