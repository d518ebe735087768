"""Machines with drives, ranges, cylinders, gears, racks, belts and cams against closed forms."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

import optlink
from optlink.errors import InputError

FILES = Path(__file__).parents[1] / "data" / "driven"
INCH = 0.0254
RPM = math.pi / 30.0


def analysed(name, points=72, changes=None):
    return optlink.analyze(optlink.load(FILES / f"{name}.toml", changes), points=points)


def point(analysis, name, kind=""):
    unit = {"": "m", "v": "m_s", "a": "m_s2"}[kind]
    return np.stack([analysis[f"{name}.{kind}{axis}_{unit}"] for axis in "xy"])


def polar(size, angle):
    return size * np.stack([np.cos(angle), np.sin(angle)])


def meet(one, other, near, far):
    """Point at the distances `near` from `one` and `far` from `other`, to the left of the line from one to the other."""
    way = other - one
    apart = np.hypot(*way)
    along = (apart**2 + near**2 - far**2) / (2.0 * apart)
    across = np.sqrt(near**2 - along**2)
    u = way / apart
    return one + along * u + across * np.stack([-u[1], u[0]])


def check(value, expected, tolerance=1e-9):
    np.testing.assert_allclose(value, expected, rtol=0.0, atol=tolerance * max(1e-12, float(np.max(np.abs(expected)))))


# --- one drive: its range, law, acceleration ------------------------------------------------------------------------------


def test_accelerated_crank_agrees_with_a_published_solution():
    """A course exercise: expertsmind.com, question 5863211, row (d)."""
    first = analysed("accelerated-crank")
    for column, value in (
        ("coupler.angle_rad", math.radians(44.1843)),
        ("coupler.omega_rad_s", 17.7407),
        ("coupler.alpha_rad_s2", -133.61),
        ("rocker.angle_rad", math.radians(113.0076)),
        ("rocker.omega_rad_s", 6.56968),
        ("rocker.alpha_rad_s2", -2112.37),
    ):
        assert first[column][0] == pytest.approx(value, rel=5e-5)
    speed, turned = first["crank.omega_rad_s"], first["crank.angle_rad"] - first["crank.angle_rad"][0]
    check(speed**2, 100.0**2 - 2.0 * 40.0 * np.unwrap(turned))


def test_hatch_opens_through_its_range():
    hatch = analysed("hatch", 90)
    angle = hatch["lid.angle_rad"]
    assert (angle.min(), angle.max()) == (pytest.approx(0.0, abs=1e-12), pytest.approx(math.pi / 2.0))
    check(hatch["input.torque_Nm"], 50.0 * 9.81 * 0.8 * np.cos(angle))


def test_toggle_clamp_over_centre():
    """The force at the knee, across the line of the clamp, is 2 F tan(a); published multipliers are 14 and 28 at 2 and 1 deg."""
    clamp = analysed("toggle-clamp", 360)
    angle = clamp["handle.angle_rad"]
    assert np.degrees([angle.min(), angle.max()]) == pytest.approx([-5.0, 30.0])
    knee = clamp["input.torque_Nm"] / (0.06 * np.cos(angle))
    check(knee, -2000.0 * np.tan(angle))  # the clamp pushes the knee away from the line, on either side
    ratio = 1000.0 / np.interp(math.radians(2.0), angle[::-1], np.abs(knee)[::-1])
    assert ratio == pytest.approx(14.32, abs=0.02)


def test_slider_drives_the_crank():
    motion = analysed("driven-slider")
    b, c, speed = point(motion, "B"), point(motion, "C"), -1.22
    check(motion["slider.v_m_s"], np.full_like(motion["time_s"], speed))
    check(np.hypot(*b), np.full_like(motion["time_s"], 3.05))
    check(np.hypot(*(c - b)), np.full_like(motion["time_s"], 6.1))
    check(c[1], np.full_like(c[1], -2.59))
    across, rod = np.stack([-b[1], b[0]]), b - c
    omega = rod[0] * speed / np.sum(rod * across, axis=0)
    closing = omega * across - np.stack([np.full_like(omega, speed), 0.0 * omega])
    bend = np.sum(closing * across, axis=0) * omega - np.sum(rod * b, axis=0) * omega**2
    alpha = (closing[0] * speed - bend) / np.sum(rod * across, axis=0)
    check(motion["crank.omega_rad_s"], omega)
    check(motion["crank.alpha_rad_s2"], alpha)
    along, rate = -rod, -closing
    turned = along[0] * rate[1] - along[1] * rate[0]
    check(motion["rod.omega_rad_s"], turned / 6.1**2)
    pull = alpha * across - omega**2 * b
    check(motion["rod.alpha_rad_s2"], (along[0] * -pull[1] - along[1] * -pull[0]) / 6.1**2)


def test_servo_press_follows_the_speeds_over_the_angle():
    press = analysed("servo-press")
    angle = press["crank.angle_rad"] % (2.0 * math.pi)
    speed = RPM * np.interp(angle, [0.0, math.pi, 2.0 * math.pi], [60.0, 20.0, 60.0])
    check(press["crank.omega_rad_s"], speed)
    slope = np.where(angle < math.pi, -1.0, 1.0) * 40.0 * RPM / math.pi
    inside = np.abs(np.sin(angle)) > 1e-6
    check(press["crank.alpha_rad_s2"][inside], (speed * slope)[inside])
    check(press["input.power_W"], 50.0 * press["ram.v_m_s"] * press["ram.a_m_s2"])
    check(press["input.torque_Nm"] * speed, press["input.power_W"])


def test_four_stroke_cycle_takes_two_revolutions():
    engine = analysed("four-stroke", 360)
    angle = np.radians(engine["crank_angle_deg"])
    assert np.degrees(angle[[0, -1]]) == pytest.approx([90.0, 810.0])
    force = np.interp(np.degrees(angle), [90.0, 120.0, 270.0, 450.0, 630.0, 810.0], [-20e3, -12e3, -1e3, 0.0, 0.0, -20e3])
    across = 0.04 * np.cos(angle)
    lever = 0.04 * np.cos(angle) - 0.04 * np.sin(angle) * -across / np.sqrt(0.14**2 - across**2)
    check(engine["input.torque_Nm"], -force * lever)


# --- cylinders ------------------------------------------------------------------------------------------------------------


def test_backhoe_bucket_between_the_ends_of_its_cylinder():
    """The law of cosines; a test file of PMKS states 75 and 54 deg."""
    bucket = analysed("backhoe-bucket")
    length = bucket["ram.length_m"]
    assert (length.min(), length.max()) == (pytest.approx(4.67), pytest.approx(8.34))
    bell = math.pi - np.arccos((7.0**2 + 3.0**2 - length**2) / (2.0 * 7.0 * 3.0))
    check(bucket["bell.angle_rad"], bell)
    assert np.degrees(np.ptp(bell)) == pytest.approx(75.5, abs=0.05)
    h = polar(math.hypot(0.3635, 2.3041), bell + math.atan2(-2.3041, 0.3635))
    joint = np.array([[3.2], [-1.6]])
    check(point(bucket, "K"), meet(h, joint, 3.0, 2.4))
    curl = bucket["bucket.angle_rad"]
    assert np.degrees(abs(curl[-1] - curl[0])) == pytest.approx(54.0, abs=0.05)


def test_boom_cylinder_carries_the_weight():
    boom = analysed("excavator-boom")
    angle, length = boom["boom.angle_rad"], boom["lift.length_m"]
    away, tilt = math.hypot(0.6, 0.4), math.atan2(-0.4, 0.6)
    check(length**2, away**2 + 1.5**2 - 2.0 * away * 1.5 * np.cos(angle - tilt))
    lever = away * 1.5 * np.sin(angle - tilt) / length
    check(boom["input.force_N"], 300.0 * 9.81 * (0.7 * np.cos(angle) - 0.1 * np.sin(angle)) / lever, 1e-8)


def test_scissor_lift_by_virtual_work():
    lift = analysed("scissor-lift")
    angle, length = lift["arm1.angle_rad"], lift["lift.length_m"]
    tip, foot = polar(0.7, angle), np.array([[0.3], [-0.06]])
    check(length, np.hypot(*(tip - foot)))
    slope = np.sum((tip - foot) * np.stack([-tip[1], tip[0]]), axis=0) / length
    check(lift["input.force_N"], 100.0 * 9.81 * np.cos(angle) / slope, 1e-8)
    check(lift["T.y_m"], np.sin(angle))


# --- several drives -------------------------------------------------------------------------------------------------------


def test_two_link_arm_has_the_torques_of_the_textbook():
    """Craig, Introduction to Robotics, section 6.7, with moments of inertia."""
    arm = analysed("two-link-arm")
    q1, q = arm["upper.angle_rad"], arm["fore.angle_rad"] - arm["upper.angle_rad"]
    w1, w = arm["upper.omega_rad_s"], arm["fore.omega_rad_s"]
    a1, a = arm["upper.alpha_rad_s2"], arm["fore.alpha_rad_s2"]
    coupled, g = 1.5 * 0.3 * 0.1, 9.81
    elbow = (0.02 + 1.5 * 0.1**2) * a + coupled * (np.cos(q) * a1 + np.sin(q) * w1**2) + 1.5 * g * 0.1 * np.cos(q1 + q)
    shoulder = elbow + (0.03 + 2.0 * 0.12**2 + 1.5 * 0.3**2) * a1 + coupled * (np.cos(q) * a - np.sin(q) * w**2)
    shoulder = shoulder + (2.0 * 0.12 + 1.5 * 0.3) * g * np.cos(q1)
    check(arm["elbow.torque_Nm"], elbow)
    check(arm["shoulder.torque_Nm"], shoulder)
    check(arm["input.power_W"], shoulder * w1 + elbow * (w - w1))


def test_power_of_one_of_two_motors_is_a_limit(tmp_path):
    """The longest upper arm whose shoulder takes 60 W, by the torques of the textbook; the other motor only brakes less."""
    goal = {"objective": {"quantity": "length", "of": "upper.length", "sense": "maximise"}}
    goal["limits"] = {"shoulder": {"quantity": "power", "of": "shoulder", "measure": "largest", "max": "60 W"}}
    goal["mechanism.links.upper.length"] = {"start": "250 mm", "bounds": ["200 mm", "600 mm"]}
    result = optlink.solve(optlink.load(FILES / "two-link-arm.toml", goal), starts=2)
    best, length = result.best, result.best.design["upper.length"]
    arm = optlink.analyze(result.problem, points=7200, design=best.design)
    q1, q = arm["upper.angle_rad"], arm["fore.angle_rad"] - arm["upper.angle_rad"]
    w1, w, a1, a = (arm[f"{body}.{part}"] for part in ("omega_rad_s", "alpha_rad_s2") for body in ("upper", "fore"))
    coupled, g = 1.5 * length * 0.1, 9.81
    elbow = (0.02 + 1.5 * 0.1**2) * a + coupled * (np.cos(q) * a1 + np.sin(q) * w1**2) + 1.5 * g * 0.1 * np.cos(q1 + q)
    shoulder = elbow + (0.03 + 2.0 * 0.12**2 + 1.5 * length**2) * a1 + coupled * (np.cos(q) * a - np.sin(q) * w**2)
    shoulder = shoulder + (2.0 * 0.12 + 1.5 * length) * g * np.cos(q1)
    assert result.valid
    assert 0.2 < length < 0.6
    assert float(np.max(shoulder * w1)) == pytest.approx(60.0, rel=1e-5)
    check(arm["elbow.power_W"], elbow * (w - w1))
    with pytest.raises(InputError, match=r"there are several drives.*shoulder, elbow"):
        optlink.load(FILES / "two-link-arm.toml", {"objective": {"quantity": "power"}})
    with pytest.raises(InputError, match="no drive of that name"):
        optlink.load(FILES / "two-link-arm.toml", {"objective": {"quantity": "power", "of": "wrist"}})


def five_bar(left, right):
    one, other = polar(0.2, left), np.array([[0.15], [0.0]]) + polar(0.2, right)
    return meet(other, one, 0.25, 0.25)


def test_two_motors_of_a_five_bar():
    robot = analysed("five-bar-robot")
    left, right = robot["left.angle_rad"], robot["right.angle_rad"]
    check(point(robot, "P"), five_bar(left, right))
    step, force = 1e-6, np.array([[30.0], [-40.0]])
    for name, turn in (("left", (step, 0.0)), ("right", (0.0, step))):
        slope = five_bar(left + turn[0], right + turn[1]) - five_bar(left - turn[0], right - turn[1])
        check(robot[f"{name}.torque_Nm"], -np.sum(force * slope, axis=0) / (2.0 * step), 1e-7)
    time = robot["time_s"]
    check(np.degrees(right), 60.0 + 20.0 * np.sin(2.0 * math.pi * time))


def test_crane_with_prescribed_swing():
    crane = analysed("crane-crab")
    load = point(crane, "L", "a")
    check(crane["travel.force_N"], 200.0 * crane["trolley.a_m_s2"] + 500.0 * load[0])
    arm = point(crane, "L") - point(crane, "T")
    check(
        crane["swing.torque_Nm"], 10.0 * crane["load.alpha_rad_s2"] + 500.0 * (arm[0] * (load[1] + 9.81) - arm[1] * load[0]), 1e-8
    )


def test_crane_with_a_free_load_is_refused(tmp_path):
    text = (FILES / "crane-crab.toml").read_text(encoding="utf-8")
    (tmp_path / "free.toml").write_text(text.partition("[drives.swing]")[0], encoding="utf-8")
    with pytest.raises(InputError, match="load"):
        optlink.analyze(optlink.load(tmp_path / "free.toml"))


# --- gears, racks, belts, cams --------------------------------------------------------------------------------------------


def test_geared_five_bar():
    machine = analysed("geared-five-bar")
    first, second = machine["crank.angle_rad"], machine["crank2.angle_rad"]
    check(np.cos(second), np.cos(2.0 * first + math.pi / 6.0))
    check(np.sin(second), np.sin(2.0 * first + math.pi / 6.0))
    d = np.array([[6.0 * INCH], [0.0]]) + polar(4.0 * INCH, second)
    check(point(machine, "C"), meet(polar(INCH, first), d, 7.0 * INCH, 9.0 * INCH), 1e-7)


def test_coupler_three_times_as_fast():
    machine = analysed("five-bar-ratio-3")
    turned = machine["crank.angle_rad"]
    b = polar(0.004, turned) + polar(0.004, 3.0 * turned)
    check(point(machine, "B"), b)
    check(point(machine, "C"), meet(b, np.array([[0.012], [0.0]]), 0.01, 0.01))


def test_sector_moves_the_rack():
    machine = analysed("rack-and-sector")
    angle = np.unwrap(np.arctan2(0.2 + 0.06 * np.sin(machine["crank.angle_rad"]), 0.06 * np.cos(machine["crank.angle_rad"])))
    check(machine["sector.angle_rad"], angle)
    check(machine["rack.s_m"] - machine["rack.s_m"][0], 0.08 * (angle - angle[0]))
    check(machine["input.power_W"], 3.0 * machine["rack.v_m_s"] * machine["rack.a_m_s2"])
    force = 3.0 * machine["rack.a_m_s2"]
    check(np.abs(machine["rail.normal_N"]), np.abs(force) * math.tan(math.radians(20.0)))


def test_belt_halves_the_speed_and_pulls_with_one_strand():
    belt = analysed("belt")
    check(belt["wheel.omega_rad_s"], 0.5 * belt["crank.omega_rad_s"])
    check(belt["input.torque_Nm"], np.full_like(belt["time_s"], 5.0))
    sine = (0.04 - 0.08) / 0.3
    pull = 10.0 / 0.08
    check(np.abs(belt["D.fx_N"]), np.full_like(belt["time_s"], pull * math.sqrt(1.0 - sine**2)))
    check(np.abs(belt["D.fy_N"]), np.full_like(belt["time_s"], pull * abs(sine)))


def polynomial(x):
    """The 3-4-5 polynomial with its first two derivatives: Norton, Cam Design, table 3-1."""
    return 10 * x**3 - 15 * x**4 + 6 * x**5, 30 * x**2 - 60 * x**3 + 30 * x**4, 60 * x - 180 * x**2 + 120 * x**3


def test_plate_cam():
    cam = analysed("plate-cam", 360)
    angle, omega, rise = cam["cam.angle_rad"] % (2.0 * math.pi), 300.0 * RPM, 2.0 * math.pi / 3.0
    rising = (angle > 1e-9) & (angle < rise - 1e-9)
    value, slope, bend = polynomial(angle[rising] / rise)
    check(cam["F.y_m"][rising], 0.038 + 0.02 * value)
    check(cam["F.vy_m_s"][rising], 0.02 * slope * omega / rise)
    check(cam["F.ay_m_s2"][rising], 0.02 * bend * (omega / rise) ** 2)
    check(cam["input.torque_Nm"], cam["F.vy_m_s"] * cam["F.ay_m_s2"] / omega)
    pressure = cam["F.vy_m_s"] / omega / cam["F.y_m"]  # tangent of the pressure angle of a central follower
    check(np.abs(cam["rail.normal_N"]), np.abs(cam["F.ay_m_s2"] * pressure))


def test_cam_swings_a_rocker():
    cam = analysed("cam-rocker", 360)
    distance, tilt = math.hypot(0.1, 0.02), math.atan2(-0.02, -0.1)
    base = tilt - math.acos((0.09**2 + distance**2 - 0.045**2) / (2.0 * 0.09 * distance))
    angle, rise = cam["cam.angle_rad"] % (2.0 * math.pi), 2.0 * math.pi / 3.0
    rising = (angle > 1e-9) & (angle < rise - 1e-9)
    value, slope, bend = polynomial(angle[rising] / rise)
    lift, omega, alpha = math.radians(20.0), cam["rocker.omega_rad_s"], cam["rocker.alpha_rad_s2"]
    rate = -300.0 * RPM / rise
    turned = cam["rocker.angle_rad"][rising] - base
    check(np.cos(turned), np.cos(lift * value))
    check(np.abs(omega[rising]), np.abs(lift * slope * rate))
    check(np.abs(alpha[rising]), np.abs(lift * bend * rate**2))
    check(cam["input.power_W"], (0.005 + 0.045**2) * omega * alpha)  # its centroid is at half its length by default
    reach = np.hypot(*(point(cam, "R")))
    assert reach.min() == pytest.approx(0.045)
