"""Design of machines that laws drive, alone or several, and through gears: against own searches by virtual power."""

from __future__ import annotations

import math

import numpy as np
import pytest

import optlink
from optlink.errors import InputError
from optlink.linkage.vector2d import TURN
from tests.tasks.test_drive_ranges import problem
from tests.tasks.test_range_targets import BACKENDS, LAW, four_bar, least

LEVER = """
title = "Lever of a feeder"
[mechanism.ground]
A = ["0 mm", "0 mm"]
D = ["300 mm", "0 mm"]
[mechanism.links]
crank = { joints = ["A", "B"], length = "100 mm" }
rod = { joints = ["B", "C"], length = { start = "250 mm", bounds = ["150 mm", "400 mm"] } }
lever = { joints = ["D", "C"], length = { start = "250 mm", bounds = ["150 mm", "400 mm"] } }
[mechanism.assembly]
C = "left of B-D"
[bodies]
lever = { mass = "5 kg", centroid = ["100 mm", "0 mm"], inertia = "0.05 kg*m^2" }
[loads]
force = { on = "lever", at = "C", force = "100 N", direction = "180 deg" }
[drive]
body = "crank"
law = [
    { time = "0.4 s", to = "120 deg", law = "3-4-5" },
    { time = "0.2 s" },
    { time = "0.4 s", to = "0 deg", law = "3-4-5" },
]
[objective]
quantity = "torque"
measure = "rms"
"""


def lever_torque(x):
    """Torque of the crank [N m] over the time of the law, from the energy as a function of the crank angle."""
    u = np.linspace(0.0, 1.0, 801)
    way, swing = math.radians(120.0), [np.polyval(p, u) for p in ([6, -15, 10, 0, 0, 0], [30, -60, 30, 0, 0], [120, -180, 60, 0])]
    phi, rate, change = way * swing[0], way * swing[1] / 0.4, way * swing[2] / 0.4**2
    grid = np.linspace(-0.01, way + 0.01, 1201)
    _, c = four_bar(0.1, *x, grid, (0.3, 0.0), 1.0)
    if not np.all(np.isfinite(c)):
        return np.array([math.nan])
    slope = np.gradient(np.unwrap(np.angle(c - 0.3)), grid, edge_order=2)
    inertia = (0.05 + 5.0 * 0.1**2) * slope**2
    at = [np.interp(phi, grid, one) for one in (inertia, np.gradient(inertia, grid), 100.0 * np.gradient(c.real, grid))]
    there = at[0] * change + 0.5 * at[1] * rate**2 + at[2]
    return np.concatenate([there, np.full(400, there[-1]), there[::-1]])  # the way back has the same accelerations and squares


@pytest.mark.slow
@BACKENDS
def test_rms_torque_of_a_law(tmp_path, backend):
    best = optlink.solve(problem(tmp_path, LEVER), backend=backend).best
    assert best.valid

    def cost(x):
        return float(np.sqrt(np.mean(lever_torque(x) ** 2)))

    assert cost([best.design["rod.length"], best.design["lever.length"]]) == pytest.approx(best.objective, rel=1e-3)
    found = least(cost, [(0.15, 0.4)] * 2)
    assert best.objective == pytest.approx(found.fun, rel=1e-3)


@pytest.mark.slow
def test_peak_torque_of_a_law(tmp_path):
    best = optlink.solve(problem(tmp_path, LEVER, **{"objective.measure": "peak"}), backend="slsqp").best
    assert best.valid

    def cost(x):
        return float(np.max(np.abs(lever_torque(x))))

    assert cost([best.design["rod.length"], best.design["lever.length"]]) == pytest.approx(best.objective, rel=1e-3)
    assert best.objective <= least(cost, [(0.15, 0.4)] * 2).fun * (1.0 + 1e-3)


FIVE_BAR = """
title = "Five-bar"
[mechanism.ground]
A = ["0 mm", "0 mm"]
E = ["200 mm", "0 mm"]
[mechanism.links]
left = { joints = ["A", "B"], length = "150 mm" }
right = { joints = ["E", "D"], length = "150 mm" }
one = { joints = ["B", "C"], length = { start = "250 mm", bounds = ["200 mm", "350 mm"] } }
other = { joints = ["D", "C"], length = { start = "250 mm", bounds = ["200 mm", "350 mm"] } }
[mechanism.assembly]
C = "right of B-D"
[loads]
load = { on = "one", at = "C", force = "50 N", direction = "-90 deg" }
[drives.a]
body = "left"
law = [{ time = "0.5 s", to = "100 deg", law = "3-4-5" }, { time = "0.5 s", to = "60 deg", law = "3-4-5" }]
[drives.b]
body = "right"
law = [{ time = "0.5 s", to = "100 deg", law = "3-4-5" }, { time = "0.5 s", to = "120 deg", law = "3-4-5" }]
[objective]
quantity = "torque"
of = "a"
measure = "rms"
[limits]
other = { quantity = "torque", of = "b", measure = "peak", max = "4 N*m" }
"""


@pytest.mark.slow
@BACKENDS
def test_torques_of_two_drives(tmp_path, backend):
    """The rms torque of one drive is least while the peak of the other one is limited: from slopes of the height of C."""
    best = optlink.solve(problem(tmp_path, FIVE_BAR), backend=backend).best
    assert best.valid
    u = np.linspace(0.0, 1.0, 401)
    s = np.polyval([6, -15, 10, 0, 0, 0], u)  # the way back takes the same positions
    a, b = np.radians(60.0 + 40.0 * s), np.radians(120.0 - 20.0 * s)

    def height(x, a, b):
        left, right = 0.15 * np.exp(1j * a), 0.2 + 0.15 * np.exp(1j * b)
        away = right - left
        q = np.abs(away)
        return (left + x[0] * away / q * np.exp(-1j * np.arccos((q**2 + x[0] ** 2 - x[1] ** 2) / (2.0 * q * x[0])))).imag

    def torques(x):
        h = 1e-6
        one = (height(x, a + h, b) - height(x, a - h, b)) / (2.0 * h)
        return 50.0 * one, 50.0 * (height(x, a, b + h) - height(x, a, b - h)) / (2.0 * h)

    def cost(x):
        own, other = torques(x)
        return math.sqrt(float(np.trapezoid(own**2, u))) + 1e3 * max(0.0, float(np.max(np.abs(other))) - 4.0)

    own, other = torques([best.design["one.length"], best.design["other.length"]])
    assert math.sqrt(float(np.trapezoid(own**2, u))) == pytest.approx(best.objective, rel=1e-5)
    assert float(np.max(np.abs(other))) == pytest.approx(4.0, rel=1e-5)
    assert best.objective == pytest.approx(least(cost, [(0.2, 0.35)] * 2).fun, rel=1e-3)


def test_a_torque_of_several_drives_names_its_drive(tmp_path):
    with pytest.raises(InputError, match=r"several drives turn a body. Add of, one of: a, b"):
        problem(tmp_path, FIVE_BAR, **{"objective.of": None})
    with pytest.raises(InputError, match="no drive of that name turns a body"):
        problem(tmp_path, FIVE_BAR, **{"objective.of": "c"})


GEARED = """
title = "Law of a geared lever"
[mechanism.ground]
M = ["-200 mm", "0 mm"]
A = ["0 mm", "0 mm"]
D = ["250 mm", "0 mm"]
[mechanism.links]
motor = { joints = ["M"] }
crank = { joints = ["A", "B"], length = "100 mm" }
coupler = { joints = ["B", "C"], length = { start = "250 mm", bounds = ["100 mm", "400 mm"] } }
rocker = { joints = ["D", "C"], length = { start = "250 mm", bounds = ["100 mm", "400 mm"] } }
[mechanism.gears]
mesh = { bodies = ["motor", "crank"], teeth = [20, 40] }
[mechanism.assembly]
C = "left of B-D"
[drive]
body = "motor"
range = ["-260 deg", "-80 deg"]
speed = "static"
"""


@pytest.mark.slow
@BACKENDS
def test_gears_carry_a_target(tmp_path, backend):
    """At half the speed and backwards the crank moves from 130 to 40 deg: the law of the lever run backwards."""
    law = 'law = "psi0 - 0.25*(phi - phi0) + 0.05*sin(90*pi/180*2 - (phi - phi0))"'
    requirement = f'[requirement]\nkind = "function"\noutput = "rocker"\n{law}\nspan = "180 deg"\nmeasure = "rms"\n'
    geared = optlink.solve(problem(tmp_path, GEARED + requirement), backend=backend).best
    plain = optlink.solve(problem(tmp_path, LAW), backend=backend).best
    assert geared.valid
    assert geared.objective == pytest.approx(plain.objective, rel=1e-3)  # positions on other grids
    assert geared.design["coupler.length"] == pytest.approx(plain.design["coupler"], rel=1e-2)


CAM = """
title = "Cam with a spring whose support is free"
[mechanism.ground]
A = ["0 mm", "0 mm"]
S = ["0 mm", { start = "125 mm", bounds = ["120 mm", "150 mm"] }]
Q = [{ start = "3 mm", bounds = ["1 mm", "8 mm"] }, "0 mm"]
[mechanism.links]
cam = { joints = ["A"] }
valve = { joints = ["R"] }
[mechanism.guides]
stem = { slider = "valve", through = "Q", direction = "90 deg" }
[mechanism.cams.lobe]
cam = "cam"
follower = "valve"
base_radius = "30 mm"
roller = "10 mm"
law = [{ to = "150 deg", rise = "12 mm", law = "cycloidal" }, { to = "360 deg", fall = "12 mm", law = "cycloidal" }]
[loads]
spring = { between = ["S", "R"], stiffness = "9 N/mm", free_length = "90 mm" }
[drive]
body = "cam"
speed = "static"
[objective]
quantity = "torque"
"""


@BACKENDS
def test_spring_of_a_cam_is_placed_for_the_least_torque(tmp_path, backend):
    """Virtual work of the spring on the lift, searched over both places; no link has a length."""
    phi = np.linspace(0.0, 2.0 * math.pi, 20001)
    rise = math.radians(150.0)
    rising, rest = phi < rise, TURN - rise
    x, way = np.where(rising, phi / rise, (phi - rise) / rest), np.where(rising, 1.0, -1.0)
    lift = 0.012 * (np.where(way > 0, 0.0, 1.0) + way * (x - np.sin(TURN * x) / TURN))
    slope = 0.012 * way / np.where(rising, rise, rest) * (1.0 - np.cos(TURN * x))

    def peak(at):
        support, aside = at
        begin = math.sqrt(0.04**2 - aside**2)
        down, across = support - begin - lift, aside
        apart = np.hypot(down, across)
        return float(np.max(np.abs(9000.0 * (0.09 - apart) * down / apart * slope)))

    found = optlink.solve(problem(tmp_path, CAM), backend=backend).best
    assert found.valid
    expected = least(peak, [(0.12, 0.15), (0.001, 0.008)])
    assert found.objective == pytest.approx(expected.fun, rel=1e-4)
