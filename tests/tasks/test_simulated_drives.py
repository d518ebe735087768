"""Simulations of machines with couplings, laws of drives, slides and cylinders, against closed forms and own integrations."""

from __future__ import annotations

import math
import tomllib
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import optlink
from optlink.dynamics.forward import Ending
from optlink.errors import InputError
from optlink.presentation.views.simulation import charts, conclusion
from optlink.problem.file import read

FILES = Path(__file__).parents[1] / "data" / "driven"
RPM = math.pi / 30.0


def simulated(name, changes=None, **options):
    return optlink.simulate(optlink.load(FILES / f"{name}.toml", changes), **options)


def balanced(run, share=1e-8):
    assert run.figures["imbalance_J"] <= share * run.figures["turnover_J"]
    assert run.figures["drift_m"] < 1e-8


# --- couplings ------------------------------------------------------------------------------------------------------------


def test_belt_under_a_torque_has_the_inertia_of_both_shafts():
    disc = "kg*m^2"
    changes = {
        "bodies.crank": {"mass": "1 kg", "centroid": ["0 mm", "0 mm"], "inertia": f"0.01 {disc}"},
        "bodies.wheel": {"mass": "4 kg", "centroid": ["0 mm", "0 mm"], "inertia": f"0.08 {disc}"},
        "drive.torque": "6 N*m",
    }
    run = simulated("belt", changes, duration=0.5, rows=20)
    alpha = (6.0 - 0.5 * 10.0) / (0.01 + 0.25 * 0.08)
    np.testing.assert_allclose(run["crank.alpha_rad_s2"], alpha, rtol=1e-9)
    np.testing.assert_allclose(run["wheel.omega_rad_s"], 0.5 * alpha * run["time_s"], rtol=1e-9, atol=1e-12)
    balanced(run)


def test_cam_under_a_torque_by_an_own_integration():
    changes = {"bodies.cam": {"mass": "2 kg", "centroid": ["0 mm", "0 mm"], "inertia": "0.002 kg*m^2"}, "drive.torque": "0.3 N*m"}
    run = simulated("plate-cam", changes, duration=0.3, rows=60, speed=5.0)
    rise = 2.0 * math.pi / 3.0

    def lift(angle):
        """The first rise and dwell, then the cycloidal fall of the file: slope and bend."""
        at = angle % (2.0 * math.pi)
        if at < rise:
            x = at / rise
            return 0.02 / rise * (30 * x**2 - 60 * x**3 + 30 * x**4), 0.02 / rise**2 * (60 * x - 180 * x**2 + 120 * x**3)
        if math.pi < at < 5.0 * math.pi / 3.0:
            x = 2.0 * math.pi * (at - math.pi) / rise
            return -0.02 / rise * (1.0 - math.cos(x)), -0.02 / rise**2 * 2.0 * math.pi * math.sin(x)
        return 0.0, 0.0

    def rates(_, state):
        slope, bend = lift(state[0])
        return state[1], (0.3 - slope * bend * state[1] ** 2) / (0.002 + slope**2)

    own = solve_ivp(rates, (0.0, 0.3), (0.0, 5.0), t_eval=run["time_s"], rtol=1e-9, atol=1e-10, max_step=1e-3)
    np.testing.assert_allclose(np.radians(run["crank_angle_deg"]), own.y[0], atol=2e-6)
    assert own.y[0][-1] > 5.0
    balanced(run)


def test_rack_under_a_torque_gains_the_work_of_the_drive():
    changes = {
        "bodies.crank": {"mass": "2 kg", "centroid": ["0 mm", "0 mm"], "inertia": "0.01 kg*m^2"},
        "drive.torque": "1 N*m",
    }
    run = simulated("rack-and-sector", changes, duration=1.0, rows=50, speed=2.0)
    turned = np.radians(run["crank_angle_deg"])
    y, x = 0.2 + 0.06 * np.sin(turned), 0.06 * np.cos(turned)
    turning = 0.06 * (np.cos(turned) * x + np.sin(turned) * y) / (x**2 + y**2)  # of the sector per rotation of the crank
    omega = run["crank.omega_rad_s"]
    energy = 0.5 * (0.01 + 3.0 * (0.08 * turning) ** 2) * omega**2
    np.testing.assert_allclose(energy - energy[0], turned, rtol=1e-8, atol=1e-10)
    balanced(run)


# --- prescribed motions ---------------------------------------------------------------------------------------------------


def quintic(x):
    """The 3-4-5 polynomial with its first two derivatives."""
    return 10 * x**3 - 15 * x**4 + 6 * x**5, 30 * x**2 - 60 * x**3 + 30 * x**4, 60 * x - 180 * x**2 + 120 * x**3


def test_arm_with_laws_needs_the_torques_of_the_textbook_over_time():
    """Craig, Introduction to Robotics, section 6.7, one revolution of the laws and a half."""
    laws = {
        "drives.shoulder.law": [{"time": "1 s", "to": "80 deg"}, {"time": "1 s", "to": "20 deg"}],
        "drives.elbow.law": {"expression": "-60 + 30*sin(pi*t)", "unit": "deg"},
    }
    run = simulated("two-link-arm", laws, duration=3.0, rows=60)
    time, degree = run["time_s"], math.pi / 180.0
    value, slope, bend = (60.0 * degree * part for part in quintic(time % 1.0))
    back = np.where(np.floor(time) % 2 == 1, -1.0, 1.0)
    q1, w1, a1 = np.where(back > 0.0, 20.0 * degree + value, 80.0 * degree - value), back * slope, back * bend
    phase = math.pi * time
    q, w, a = -60.0 + 30.0 * np.sin(phase), 30.0 * math.pi * np.cos(phase), -30.0 * math.pi**2 * np.sin(phase)
    q, w, a = q * degree, w * degree, a * degree
    coupled, g = 1.5 * 0.3 * 0.1, 9.81
    elbow = (0.02 + 1.5 * 0.1**2) * (a + a1) + coupled * (np.cos(q) * a1 + np.sin(q) * w1**2) + 1.5 * g * 0.1 * np.cos(q1 + q)
    shoulder = elbow + (0.03 + 2.0 * 0.12**2 + 1.5 * 0.3**2) * a1
    shoulder += coupled * (np.cos(q) * (a + a1) - np.sin(q) * (w + w1) ** 2) + (2.0 * 0.12 + 1.5 * 0.3) * g * np.cos(q1)
    np.testing.assert_allclose(run["upper.angle_rad"], q1, atol=1e-12)
    np.testing.assert_allclose(run["elbow.torque_Nm"], elbow, rtol=0.0, atol=1e-8)
    np.testing.assert_allclose(run["shoulder.torque_Nm"], shoulder, rtol=0.0, atol=1e-8)
    assert run.driven == "motion laws"
    balanced(run)
    names = [panel.y.name for chart in charts(run) if chart.file == "drive" for panel in chart.panels]
    assert names == ["crank speed [rpm]", "torque of shoulder [N·m]", "torque of elbow [N·m]"]


def test_lever_rests_at_the_end_of_a_law_that_does_not_repeat():
    law = {"drive.law": [{"time": "0.5 s", "to": "90 deg"}], "drive.start": "0 deg", "drive.speed": None}
    run = simulated("hatch", law, duration=0.8, rows=80)
    time, angle = run["time_s"], run["lid.angle_rad"]
    value, _, bend = quintic(np.minimum(time / 0.5, 1.0))
    np.testing.assert_allclose(angle, math.pi / 2.0 * value, atol=1e-12)
    inertia = 6.0 + 50.0 * 0.8**2
    torque = inertia * math.pi / 2.0 * bend / 0.25 + 50.0 * 9.81 * 0.8 * np.cos(angle)
    away = np.abs(time - 0.5) > 1e-9
    np.testing.assert_allclose(run["input.torque_Nm"][away], torque[away], rtol=0.0, atol=1e-8)
    np.testing.assert_allclose(run["input.work_J"][-1], 50.0 * 9.81 * 0.8, rtol=1e-9)
    balanced(run)


def test_accelerated_crank_ends_where_its_motion_is_not_stated():
    run = simulated("accelerated-crank", duration=1.0, rows=50)
    time = run["time_s"]
    np.testing.assert_allclose(run["crank.omega_rad_s"], 100.0 - 40.0 * time, rtol=1e-9)
    assert run.ending is Ending.END_OF_RANGE
    assert run.stopped == pytest.approx((100.0 - math.sqrt(100.0**2 - 2.0 * 40.0 * 2.0 * math.pi)) / 40.0, rel=1e-9)


def test_cylinder_at_constant_speed_lifts_to_the_end_of_its_stroke():
    run = simulated("excavator-boom", {"drive.speed": "100 mm/s"}, rows=70)
    np.testing.assert_allclose(run["lift.length_m"], 1.2 + 0.1 * run["time_s"], rtol=1e-12)
    assert run["time_s"][-1] == pytest.approx(7.0)
    angle = run["boom.angle_rad"]
    away, tilt = math.hypot(0.6, 0.4), math.atan2(-0.4, 0.6)
    np.testing.assert_allclose(run["lift.length_m"] ** 2, away**2 + 1.5**2 - 2.0 * away * 1.5 * np.cos(angle - tilt), rtol=1e-12)
    height = 0.7 * np.sin(angle) + 0.1 * np.cos(angle)
    energy = 0.5 * (60.0 + 300.0 * 0.5) * run["boom.omega_rad_s"] ** 2 + 300.0 * 9.81 * height
    np.testing.assert_allclose(run["input.work_J"], energy - energy[0], atol=1e-6)
    assert conclusion(run).startswith("After 7 s the length of lift is 1900 mm, its speed 100 mm/s")
    assert run.figures["end.position_m"] == pytest.approx(1.9)
    assert run.figures["end.speed_m_s"] == pytest.approx(0.1)
    longer = simulated("excavator-boom", {"drive.speed": "100 mm/s"}, duration=9.0)
    assert (longer.ending, longer.stopped) == (Ending.END_OF_RANGE, pytest.approx(7.0))
    balanced(run)


def test_motor_that_a_law_moves_has_no_torque_or_crank_speed():
    with pytest.raises(InputError, match=r"drive\.torque.*prescribed motion and a torque"):
        simulated("servo-press", {"drive.torque": "5 N*m"})
    with pytest.raises(InputError, match="moves by its law"):
        simulated("two-link-arm", speed=3.0)
    with pytest.raises(InputError, match="moves along a line"):
        simulated("excavator-boom", flywheel=3.0)


# --- forces along a line, end stops -----------------------------------------------------------------------------------------

CARRIAGE = """
title = "Carriage on a rail"
gravity = "9.81 m/s^2"
[mechanism.ground]
A = ["0 m", "0 m"]
[mechanism.links]
carriage = { joints = ["T"] }
[mechanism.guides]
rail = { slider = "carriage", through = "A", direction = "90 deg" }
[bodies]
carriage = { mass = "2 kg" }
[drive]
slide = "rail"
range = ["0 m", "1 m"]
"""


def carriage(**changes):
    file = read(tomllib.loads(CARRIAGE), "carriage")
    return file.override({f"drive.{key}" if key != "gravity" else key: value for key, value in changes.items()})


def test_ball_bounces_until_it_rests():
    """Each impact takes the share 1 - e^2 of the energy; the times are those of the textbook, their sum that of a series."""
    run = optlink.simulate(carriage(force="0 N", start="0.8 m", stops={"restitution": 0.5}, duration="5 s"), rows=2000)
    first = math.sqrt(2.0 * 0.8 / 9.81)
    time, height = run["time_s"], run["carriage.s_m"]
    once = (time > first) & (time < 2.0 * first)
    np.testing.assert_allclose(height[once], 0.5 * 9.81 * (time[once] - first) * (2.0 * first - time[once]), atol=1e-9)
    assert run.ending is Ending.AT_STOP
    assert run.stopped == pytest.approx(first * (1.0 + 2.0 * sum(0.5**k for k in range(1, 14))), rel=1e-6)
    assert run.figures["stops.work_J"] == pytest.approx(-2.0 * 9.81 * 0.8, rel=1e-9)
    assert run.figures["stops.force_N"] == pytest.approx(2.0 * 9.81)
    assert run["input.force_N"][-1] == 0.0
    assert np.all(height >= -1e-12)
    balanced(run)


def test_elastic_stop_returns_the_square_of_its_restitution():
    stops = {"stiffness": "20 kN/m", "restitution": 0.6}
    changes = {
        "gravity": "0 m/s^2",
        "force": "0 N",
        "start": "0.9 m",
        "initial_speed": "2 m/s",
        "stops": stops,
        "duration": "0.2 s",
    }
    run = optlink.simulate(carriage(**changes), rows=2000)
    time, place, frequency = run["time_s"], run["carriage.s_m"], math.sqrt(20e3 / 2.0)
    stopped, out = 0.05 + 0.5 * math.pi / frequency, 0.5 * math.pi / (0.6 * frequency)
    into = (time > 0.05) & (time < stopped)
    np.testing.assert_allclose(place[into], 1.0 + 2.0 / frequency * np.sin(frequency * (time[into] - 0.05)), atol=1e-9)
    np.testing.assert_allclose(run["stops.fy_N"][into], -20e3 * (place[into] - 1.0), atol=1e-4)
    after = time > stopped + out
    np.testing.assert_allclose(run["carriage.v_m_s"][after], -1.2, rtol=1e-9)
    assert run.figures["stops.work_J"] == pytest.approx(-0.5 * 2.0 * (2.0**2 - 1.2**2), rel=1e-9)
    balanced(run)


def test_elastic_stop_holds_a_weight_at_last():
    stops = {"stiffness": "20 kN/m", "restitution": 0.3}
    run = optlink.simulate(carriage(force="0 N", start="0.05 m", stops=stops, duration="5 s"))
    assert run.ending is Ending.AT_STOP
    assert 0.3**2 <= -run["carriage.s_m"][-1] * 20e3 * 0.3**2 / (2.0 * 9.81) <= 1.0 + 1e-9
    assert run["stops.fy_N"][-1] == pytest.approx(2.0 * 9.81)
    assert run["input.force_N"][-1] == pytest.approx(0.0, abs=1e-9)
    assert run["input.power_W"][-1] == 0.0
    assert run.figures["stops.force_N"] == pytest.approx(2.0 * 9.81)
    assert f"holds it with {2.0 * 9.81:.6g} N" in run.notes[-1]


def test_force_that_falls_with_the_speed():
    """m v' = F (1 - v/w): the speed approaches w."""
    force = {"over": "v", "at": ["0 m/s", "2 m/s"], "values": ["10 N", "0 N"]}
    run = optlink.simulate(carriage(gravity="0 m/s^2", force=force, duration="0.4 s"))
    np.testing.assert_allclose(run["carriage.v_m_s"], 2.0 * (1.0 - np.exp(-2.5 * run["time_s"])), rtol=1e-7, atol=1e-12)
    assert run.driven == "force"
    balanced(run)


def test_cylinder_with_a_force_gives_its_work_to_the_boom():
    run = simulated("excavator-boom", {"drive.speed": None, "drive.force": "10 kN", "drive.duration": "3 s"}, rows=200)
    angle, length = run["boom.angle_rad"], run["lift.length_m"]
    height = 0.7 * np.sin(angle) + 0.1 * np.cos(angle)
    energy = 0.5 * (60.0 + 300.0 * 0.5) * run["boom.omega_rad_s"] ** 2 + 300.0 * 9.81 * height
    np.testing.assert_allclose(energy - energy[0] - run["stops.work_J"], 10e3 * (length - 1.2), atol=1e-4)
    assert run.figures["stops.work_J"] < -1000.0
    assert run.ending is Ending.AT_STOP
    assert length[-1] == pytest.approx(1.9)
    np.testing.assert_allclose(run["input.force_N"], 10e3, rtol=1e-7)
    away, tilt = math.hypot(0.6, 0.4), math.atan2(-0.4, 0.6)
    lever = away * 1.5 * math.sin(angle[-1] - tilt) / length[-1]
    carried = 300.0 * 9.81 * (0.7 * math.cos(angle[-1]) - 0.1 * math.sin(angle[-1])) / lever
    assert run.figures["stops.force_N"] == pytest.approx(carried - 10e3, rel=1e-6)
    elastic = {"drive.stops": {"stiffness": "2000 kN/m", "restitution": 0.5}, "drive.speed": None, "drive.force": "10 kN"}
    balanced(simulated("excavator-boom", elastic, duration=2.0, rows=200))
    elastic["drive.stops"] = {"stiffness": "2000 kN/m", "restitution": 0.8}
    run = simulated("excavator-boom", elastic, duration=8.0, rows=200)
    angle, length = run["boom.angle_rad"][-1], run["lift.length_m"][-1]
    lever = away * 1.5 * math.sin(angle - tilt) / length
    carried = 300.0 * 9.81 * (0.7 * math.cos(angle) - 0.1 * math.sin(angle)) / lever
    assert run.ending is Ending.AT_STOP
    assert run.figures["stops.force_N"] == pytest.approx(carried - 10e3, rel=1e-6)
    assert math.hypot(run["stops.lift.fx_N"][-1], run["stops.lift.fy_N"][-1]) == pytest.approx(10e3 - carried, rel=1e-6)
    assert run["input.force_N"][-1] == pytest.approx(10e3)


def test_lid_falls_on_its_stop():
    run = simulated("hatch", {"drive.start": "60 deg", "drive.speed": None, "drive.torque": "0 N*m"}, duration=5.0)
    assert run.ending is Ending.AT_STOP
    assert run["lid.angle_rad"][-1] == 0.0
    assert run.figures["stops.torque_Nm"] == pytest.approx(50.0 * 9.81 * 0.8)
    assert run.figures["stops.work_J"] == pytest.approx(-50.0 * 9.81 * 0.8 * math.sin(math.radians(60.0)), rel=1e-9)
    assert "the end stop holds it with 392.4 N m" in run.notes


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"torque": "5 N*m"}, r"drive\.torque.*moves along a line"),
        ({"stops": "rigid"}, r"drive\.stops.*under a torque or force"),
        ({"force": "5 N", "stops": {"stiffness": "5 N*m/rad"}}, r"stops\.stiffness.*along a line.*a stiffness"),
        ({"force": "5 N", "initial_speed": "5 rpm", "duration": "1 s"}, r"initial_speed.*along a line.*a velocity"),
    ],
)
def test_what_does_not_fit_a_drive_along_a_line(changes, words):
    with pytest.raises(InputError, match=words):
        optlink.simulate(carriage(**changes))


# --- gas --------------------------------------------------------------------------------------------------------------------


def test_gas_that_a_carriage_compresses_bounces_adiabatically():
    """Gas of p V^n = constant takes p0 V0 / (n - 1) ((V0/V)^(n - 1) - 1) of work; the atmosphere is on the other side."""
    gas = {"pressure": "2 bar", "ambient": "1 bar", "bore": "50 mm", "volume": "1500 cm^3", "at": "0.5 m", "exponent": 1.3}
    changes = {"force": "0 N", "start": "0.5 m", "initial_speed": "-4 m/s", "duration": "0.1 s"}
    file = carriage(**changes).override({"loads.gas": {"on": "carriage", "gas": gas}})
    run = optlink.simulate(file, rows=100)
    area, place, speed = 0.25 * math.pi * 0.05**2, run["carriage.s_m"], run["carriage.v_m_s"]
    volume = 1.5e-3 + area * (place - 0.5)
    work = 2e5 * 1.5e-3 / 0.3 * (1.0 - (1.5e-3 / volume) ** 0.3) - 1e5 * area * (place - 0.5)
    np.testing.assert_allclose(run["gas.work_J"], work, atol=1e-8)
    np.testing.assert_allclose(speed**2 - 16.0 + 2.0 * 9.81 * (place - 0.5), work, atol=1e-7)
    np.testing.assert_allclose(run["gas.fy_N"], area * (2e5 * (1.5e-3 / volume) ** 1.3 - 1e5), rtol=1e-12)
    with pytest.raises(InputError, match=r"gas\.volume.*the volume of the gas would fall to"):
        file.override({"loads.gas.gas.volume": "500 mm^3"})


def test_engine_whose_pressure_is_a_table_over_two_revolutions():
    at = ["90 deg", "120 deg", "270 deg", "450 deg", "630 deg", "810 deg"]
    bars = [-20e3, -12e3, -1e3, 0.0, 0.0, -20e3]
    area = 0.25 * math.pi * 0.08**2
    pressure = {"over": "phi", "at": at, "values": [f"{-force / area * 1e-5!r} bar" for force in bars]}
    gas = {"on": "piston", "gas": {"pressure": pressure, "bore": "80 mm", "pushes": "backward"}}
    plain = optlink.analyze(optlink.load(FILES / "four-stroke.toml"), points=90)
    engine = optlink.analyze(optlink.load(FILES / "four-stroke.toml", {"loads.gas": gas}), points=90)
    np.testing.assert_allclose(engine["input.torque_Nm"], plain["input.torque_Nm"], atol=1e-9)
    assert engine["crank_angle_deg"][-1] == pytest.approx(810.0)


def test_gas_strut_holds_a_lid():
    """A force of 120 bar on a rod of 8 mm, along the line of two points."""
    strut = {"between": ["S", "M"], "gas": {"pressure": "120 bar", "bore": "8 mm"}}
    changes = {
        "mechanism.ground.S": ["0 m", "-0.3 m"],
        "mechanism.links.lid.points": {"M": ["0.4 m", "0 m"]},
        "loads": {"strut": strut, "hand": {"between": ["S", "M"], "force": {"expression": "100 - 50*s", "unit": "N"}}},
    }
    hatch = optlink.analyze(optlink.load(FILES / "hatch.toml", changes), points=30)
    angle = hatch["lid.angle_rad"]
    length = np.hypot(0.4 * np.cos(angle), 0.4 * np.sin(angle) + 0.3)
    push = 120e5 * 0.25 * math.pi * 0.008**2 + 100.0 - 50.0 * length
    slope = 0.4 * 0.3 * np.cos(angle) / length
    np.testing.assert_allclose(hatch["input.torque_Nm"], 50.0 * 9.81 * 0.8 * np.cos(angle) - push * slope, atol=1e-9)
    with pytest.raises(InputError, match=r"loads\.strut\.gas.*depends on their distance"):
        optlink.load(FILES / "hatch.toml", {**changes, "loads.strut.gas.pressure": {"expression": "1 + sin(phi)", "unit": "bar"}})


# --- what goes with a range -------------------------------------------------------------------------------------------------


def test_winch_turns_three_times_between_its_stops():
    changes = {
        "bodies.crank": {"mass": "1 kg", "centroid": ["0 mm", "0 mm"], "inertia": "0.01 kg*m^2"},
        "bodies.wheel": {"mass": "4 kg", "centroid": ["0 mm", "0 mm"], "inertia": "0.08 kg*m^2"},
        "drive.range": ["0 deg", "1080 deg"],
    }
    swept = optlink.analyze(optlink.load(FILES / "belt.toml", changes), points=30)
    assert np.degrees(np.unwrap(swept["crank.angle_rad"]))[-1] == pytest.approx(1080.0)
    assert np.degrees(swept["wheel.angle_rad"])[-1] - np.degrees(swept["wheel.angle_rad"])[0] == pytest.approx(540.0)
    run = simulated("belt", {**changes, "drive.torque": "6 N*m"}, duration=5.0)
    alpha = (6.0 - 0.5 * 10.0) / (0.01 + 0.25 * 0.08)
    assert run.stopped == pytest.approx(math.sqrt(2.0 * 6.0 * math.pi / alpha), rel=1e-9)
    assert (run.ending, run["crank_angle_deg"][-1]) == (Ending.AT_STOP, pytest.approx(1080.0))


def test_fluctuation_within_a_range_is_refused():
    with pytest.raises(InputError, match=r"drive\.fluctuation.*turns fully"):
        optlink.load(FILES / "hatch.toml", {"drive.fluctuation": "5 %"})
