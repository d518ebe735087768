"""Design of machines whose gears, racks, belts and cams have free dimensions: against own searches on the closed form."""

from __future__ import annotations

import math

import numpy as np
import pytest

import optlink
from optlink.errors import InputError
from optlink.linkage.mechanism import Pose
from optlink.optimization.programme import build
from tests.tasks.test_drive_ranges import problem
from tests.tasks.test_law_designs import GEARED
from tests.tasks.test_range_targets import BACKENDS, least

RACK = """
title = "Lever that moves a bar by a rack"
[mechanism.ground]
A = ["0 mm", "0 mm"]
R = ["0 mm", "-200 mm"]
[mechanism.links]
sector = { joints = ["A"] }
bar = { joints = ["S"] }
[mechanism.guides]
way = { slider = "bar", through = "R", direction = "0 deg" }
[mechanism.racks]
mesh = { pinion = "sector", rack = "bar", radius = { start = "70 mm", bounds = ["20 mm", "80 mm"] } }
[bodies]
bar = { mass = "3 kg" }
sector = { mass = "2 kg", inertia = "0.03 kg*m^2" }
[loads]
help = { on = "bar", force = "60 N" }
resistance = { on = "sector", torque = "-3 N*m" }
[drive]
body = "sector"
law = [{ time = "0.3 s", to = "90 deg", law = "3-4-5" }, { time = "0.3 s", to = "0 deg", law = "3-4-5" }]
[objective]
quantity = "torque"
measure = "rms"
"""
BELT = """
title = "Belt between two shafts"
[mechanism.ground]
A = ["0 mm", "0 mm"]
D = ["300 mm", "0 mm"]
[mechanism.links]
motor = { joints = ["A"] }
wheel = { joints = ["D"] }
[mechanism.belts]
strap = { bodies = ["motor", "wheel"], diameters = ["60 mm", { start = "100 mm", bounds = ["40 mm", "200 mm"] }] }
[bodies]
motor = { mass = "1 kg", inertia = "0.004 kg*m^2" }
wheel = { mass = "2 kg", inertia = "0.02 kg*m^2" }
[loads]
brake = { on = "wheel", torque = "-1 N*m" }
[drive]
body = "motor"
law = [{ time = "0.5 s", to = "180 deg", law = "cycloidal" }, { time = "0.5 s", to = "0 deg", law = "cycloidal" }]
[objective]
quantity = "torque"
measure = "rms"
[limits]
swing = { quantity = "stroke", of = "wheel", min = "70 deg" }
"""
SWINGING = """
title = "Wheel geared to a rocker"
[mechanism.ground]
A = ["0 mm", "0 mm"]
D = ["250 mm", "0 mm"]
E = ["250 mm", "100 mm"]
[mechanism.links]
crank = { joints = ["A", "B"], length = "80 mm" }
coupler = { joints = ["B", "C"], length = "250 mm" }
rocker = { joints = ["D", "C"], length = "200 mm" }
wheel = { joints = ["E"] }
[mechanism.gears]
mesh = { bodies = ["rocker", "wheel"], ratio = "-3..-0.5" }
[mechanism.assembly]
C = "left of B-D"
[drive]
body = "crank"
speed = "60 rpm"
[objective]
quantity = "length"
of = "mesh.ratio"
sense = "maximise"
[limits]
swing = { quantity = "stroke", of = "wheel", min = "60 deg" }
"""
FUNCTION = """
[requirement]
kind = "function"
output = "rocker"
law = "psi0 - 0.25*(phi - phi0) + 0.05*sin(90*pi/180*2 - (phi - phi0))"
span = "180 deg"
measure = "rms"
"""
VALVE = """
title = "Cam with a free base circle and a free offset"
[mechanism.ground]
A = ["0 mm", "0 mm"]
S = ["0 mm", "125 mm"]
Q = [{ start = "0 mm", bounds = ["-8 mm", "8 mm"] }, "0 mm"]
[mechanism.links]
cam = { joints = ["A"] }
valve = { joints = ["R"] }
[mechanism.guides]
stem = { slider = "valve", through = "Q", direction = "90 deg" }
[mechanism.cams.lobe]
cam = "cam"
follower = "valve"
base_radius = "20..60 mm"
roller = "10 mm"
law = [{ to = "150 deg", rise = "12 mm", law = "cycloidal" }, { to = "360 deg", fall = "12 mm", law = "cycloidal" }]
[loads.spring]
on = "valve"
force = "-200 N"
[drive]
body = "cam"
speed = "static"
[objective]
quantity = "length"
of = "lobe.base_radius"
[limits]
side = { quantity = "guide force", of = "stem", max = "40 N" }
"""


def polynomial(order):
    """The law of fifth degree from 0 to 1, or a derivative of it, at 4001 times."""
    law = np.polynomial.Polynomial([0.0, 0.0, 0.0, 10.0, -15.0, 6.0])
    return (law.deriv(order) if order else law)(np.linspace(0.0, 1.0, 4001))


def rms(values):
    return math.sqrt(float(np.trapezoid(np.square(values), dx=1.0 / (len(values) - 1))))


@BACKENDS
def test_radius_of_a_rack_balances_a_load(tmp_path, backend):
    """The force on the bar helps against the torque on the lever by the radius, whose square multiplies the mass."""
    best = optlink.solve(problem(tmp_path, RACK), backend=backend).best
    alpha = 0.5 * math.pi * polynomial(2) / 0.3**2

    def cost(x):
        return rms((0.03 + 3.0 * x[0] ** 2) * alpha + 3.0 - 60.0 * x[0])

    expected = least(cost, [(0.02, 0.08)])
    assert best.valid
    assert best.objective == pytest.approx(expected.fun, rel=1e-5)
    assert best.design["mesh.radius"] == pytest.approx(expected.x[0], rel=1e-3)
    assert cost([best.design["mesh.radius"] * 1.02]) > best.objective * (1.0 + 1e-6)  # the search would see another radius


def test_radius_of_a_rack_follows_from_the_way_of_the_bar(tmp_path):
    limits = {"limits.travel": {"quantity": "stroke", "of": "bar", "min": "100 mm"}}
    best = optlink.solve(problem(tmp_path, RACK, **limits)).best
    assert best.valid
    assert best.design["mesh.radius"] == pytest.approx(0.1 / (0.5 * math.pi), rel=1e-8)


@BACKENDS
@pytest.mark.parametrize("key", ["diameters", "radii"])
def test_wheel_of_a_belt_follows_from_the_swing(tmp_path, backend, key):
    sizes = {"mechanism.belts.strap": {"bodies": ["motor", "wheel"], key: ["60 mm", {"bounds": ["40 mm", "200 mm"]}]}}
    best = optlink.solve(problem(tmp_path, BELT, **sizes), backend=backend).best
    assert best.valid
    assert best.design[f"strap.{key}.second"] == pytest.approx(0.06 * 180.0 / 70.0, rel=1e-8)
    alpha = 2.0 * math.pi * math.pi * np.sin(2.0 * math.pi * np.linspace(0.0, 1.0, 4001)) / 0.5**2
    ratio = 70.0 / 180.0
    assert best.objective == pytest.approx(rms((0.004 + 0.02 * ratio**2) * alpha + ratio), rel=1e-6)


@BACKENDS
def test_ratio_of_gears_balances_a_weight(tmp_path, backend):
    """Gears in place of the belt: the torque on the wheel helps by the ratio, whose square multiplies the inertia."""
    changes = {
        "mechanism.belts": None,
        "mechanism.gears.mesh": {"bodies": ["motor", "wheel"], "ratio": {"start": -0.5, "bounds": [-4.0, -0.2]}},
        "loads.brake.torque": "-1.5 N*m",
        "loads.pull": {"on": "motor", "torque": "-2 N*m"},
        "limits": None,
    }
    best = optlink.solve(problem(tmp_path, BELT, **changes), backend=backend).best
    alpha = 2.0 * math.pi * math.pi * np.sin(2.0 * math.pi * np.linspace(0.0, 1.0, 4001)) / 0.5**2
    expected = least(lambda x: rms((0.004 + 0.02 * x[0] ** 2) * alpha + 2.0 + 1.5 * x[0]), [(-4.0, -0.2)])
    assert best.valid
    assert best.objective == pytest.approx(expected.fun, rel=1e-5)
    assert best.design["mesh.ratio"] == pytest.approx(expected.x[0], rel=1e-3)


def test_ratio_needs_a_cycle_that_it_does_not_change(tmp_path):
    ratio = {"mechanism.gears.mesh": {"bodies": ["motor", "crank"], "ratio": {"bounds": [-0.9, -0.2]}}}
    best = optlink.solve(problem(tmp_path, GEARED + FUNCTION, **ratio)).best
    assert best.valid
    with pytest.raises(InputError, match=r"mesh\.ratio.*other numbers of turns in one of the crank.*Give the drive a range"):
        problem(tmp_path, GEARED + FUNCTION, **ratio, **{"drive.range": None})
    swings = problem(tmp_path, SWINGING)  # a lever that swings to and fro makes no turns, and what it turns makes none
    best = optlink.solve(swings).best
    angle = [math.acos((0.25**2 + 0.2**2 - (0.25 + sense * 0.08) ** 2) / (2.0 * 0.25 * 0.2)) for sense in (1.0, -1.0)]
    assert best.valid
    assert best.design["mesh.ratio"] == pytest.approx(-math.radians(60.0) / (angle[0] - angle[1]), rel=1e-6)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"teeth": [{"bounds": [20.0, 30.0]}, 40]}, r"teeth.*cannot be design variables. Give ratio"),
        ({"ratio": {"bounds": [-0.9, 0.5]}}, r"ratio.*senses of rotation.*Give bounds that are both below 0"),
        ({"ratio": {"bounds": ["-9 mm", "-5 mm"]}}, r"ratio\.bounds.*a ratio has no unit. Write a plain number"),
        ({"ratio": 0.0}, r"ratio.*out of range. Give a ratio from 0.0001"),
    ],
)
def test_ratios_that_no_gears_have(tmp_path, change, message):
    with pytest.raises(InputError, match=message):
        problem(tmp_path, GEARED + FUNCTION, **{"mechanism.gears.mesh": {"bodies": ["motor", "crank"], **change}})


def lift_of_cam(lift):
    """Lift and slope of the cycloidal law of `VALVE` at 20001 cam angles."""
    phi = np.linspace(0.0, 2.0 * math.pi, 20001)
    rise = math.radians(150.0)
    rising, rest = phi < rise, 2.0 * math.pi - rise
    x, way = np.where(rising, phi / rise, (phi - rise) / rest), np.where(rising, 1.0, -1.0)
    s = lift * (np.where(way > 0, 0.0, 1.0) + way * (x - np.sin(2.0 * math.pi * x) / (2.0 * math.pi)))
    return s, lift * way / np.where(rising, rise, rest) * (1.0 - np.cos(2.0 * math.pi * x))


@BACKENDS
def test_base_circle_of_a_cam_for_a_force_of_its_guide(tmp_path, backend):
    """The force on the oblique contact presses the follower against its guide; searched over radius and offset."""
    best = optlink.solve(problem(tmp_path, VALVE), backend=backend).best
    s, slope = lift_of_cam(0.012)

    def excess(x):
        base, offset = x
        height = math.sqrt((base + 0.01) ** 2 - offset**2) + s
        return float(np.max(np.abs(200.0 * (slope - offset) / height))) - 40.0

    def cost(x):
        return x[0] + max(0.0, excess(x))

    expected = least(cost, [(0.02, 0.06), (-0.008, 0.008)])
    assert best.valid
    assert best.design["lobe.base_radius"] == pytest.approx(expected.x[0], rel=1e-4)
    assert excess([best.design["lobe.base_radius"], best.design["Q.x"]]) == pytest.approx(0.0, abs=1e-3)


def test_lift_of_a_cam_scales_its_law(tmp_path):
    """The stroke that is required is the lift, of whatever size the rises in the file are."""
    changes = {"mechanism.cams.lobe.lift": "5..20 mm", "limits.way": {"quantity": "stroke", "of": "valve", "min": "15 mm"}}
    goal = {"objective.of": "lobe.lift", "mechanism.cams.lobe.base_radius": "40 mm"}
    best = optlink.solve(problem(tmp_path, VALVE, **changes, **goal, **{"limits.side": None})).best
    assert best.valid
    assert best.design["lobe.lift"] == pytest.approx(0.015, rel=1e-8)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"lift": "10 deg"}, r"lift.*the follower slides, so its lift is in mm"),
        (
            {"law": [{"to": "180 deg", "rise": "8..12 mm"}, {"to": "360 deg", "fall": "12 mm"}]},
            r"rise.*scale the whole law: lift = ",
        ),
        ({"base_radius": "2 mm", "roller": "1 mm"}, r"base_radius.*outside the base circle"),
    ],
)
def test_cams_that_cannot_be(tmp_path, change, message):
    with pytest.raises(InputError, match=message):
        problem(
            tmp_path,
            VALVE,
            **{"mechanism.ground.Q": ["5 mm", "0 mm"]},
            **{f"mechanism.cams.lobe.{key}": value for key, value in change.items()},
        )


SMALLEST = """
title = "Smallest cam"
[mechanism.ground]
A = ["0 mm", "0 mm"]
Q = [{ start = "0 mm", bounds = ["-10 mm", "10 mm"] }, "0 mm"]
[mechanism.links]
cam = { joints = ["A"] }
valve = { joints = ["R"] }
[mechanism.guides]
stem = { slider = "valve", through = "Q", direction = "90 deg" }
[mechanism.cams.lobe]
cam = "cam"
follower = "valve"
base_radius = "10..80 mm"
roller = "10 mm"
law = [{ to = "150 deg", rise = "12 mm", law = "cycloidal" }, { to = "360 deg", fall = "12 mm", law = "cycloidal" }]
[drive]
body = "cam"
speed = "60 rpm"
[objective]
quantity = "length"
of = "lobe.base_radius"
[limits]
slant = { quantity = "cam pressure angle", of = "lobe", max = "15 deg" }
profile = { quantity = "profile radius", of = "lobe", min = "5 mm" }
"""


def slant_and_radius(base, offset, roller=0.01):
    """Largest pressure angle [rad] and least radius where the profile bulges [m], from differences of the pitch curve."""
    s, slope = lift_of_cam(0.012)
    height = math.sqrt((base + roller) ** 2 - offset**2) + s
    path = (offset + 1j * height) * np.exp(-1j * np.linspace(0.0, 2.0 * math.pi, 20001))
    step = path[1:-1] - path[:-2], path[2:] - path[1:-1]
    turned = -np.angle(step[1] / step[0])  # clockwise round the cam
    radius = 0.5 * (abs(step[0]) + abs(step[1])) / np.where(turned > 0.0, turned, np.nan)
    return float(np.max(np.abs(np.arctan((slope - offset) / height)))), float(np.nanmin(radius)) - roller


@pytest.mark.slow
@BACKENDS
@pytest.mark.parametrize(("slant", "radius", "active"), [(15.0, 5.0, 0), (60.0, 18.0, 1)])
def test_smallest_cam_of_a_pressure_angle_and_a_radius(tmp_path, backend, slant, radius, active):
    limits = {"limits.slant.max": f"{slant} deg", "limits.profile.min": f"{radius} mm"}
    best = optlink.solve(problem(tmp_path, SMALLEST, **limits), backend=backend).best

    def room(x):
        most, least_radius = slant_and_radius(*x)
        return math.radians(slant) - most, 100.0 * (least_radius - 1e-3 * radius)

    expected = least(lambda x: x[0] + max(0.0, *(-one for one in room(x))), [(0.01, 0.08), (-0.01, 0.01)])
    found = best.design["lobe.base_radius"], best.design["Q.x"]
    assert best.valid
    assert found[0] == pytest.approx(expected.x[0], rel=5e-4)
    assert room(found)[active] == pytest.approx(0.0, abs=1e-3)  # of differences
    assert min(room((found[0] * 0.99, found[1]))) < -1e-3  # a smaller one is none


FOLLOWERS = {
    "roller": SMALLEST,
    "flat": SMALLEST.replace('roller = "10 mm"', "flat = true"),
    "swinging": SMALLEST.replace('valve = { joints = ["R"] }', 'valve = { joints = ["F", "R"], length = "60 mm" }')
    .replace("[mechanism.guides]", "")
    .replace('stem = { slider = "valve", through = "Q", direction = "90 deg" }', "")
    .replace("Q = [", 'F = ["70 mm", "20 mm"]\nQ = [')
    .replace('rise = "12 mm"', 'rise = "11 deg"')
    .replace('fall = "12 mm"', 'fall = "11 deg"'),
}


@pytest.mark.parametrize("side", ["left", "right"])
@pytest.mark.parametrize("kind", FOLLOWERS)
def test_contact_that_is_designed_is_that_of_the_disc_cam(tmp_path, kind, side):
    """The formulas of the programme against the envelope that the profile is drawn by, also where it is undercut."""
    changes = {} if kind == "roller" else {"limits": None}
    changes |= {"mechanism.cams.lobe.side": side} if kind == "swinging" else {}
    for base in (0.02, 0.045):
        model = problem(tmp_path, FOLLOWERS[kind], **changes).model
        sizes = {**model.complete({}), "lobe.base_radius": base, "Q.x": 0.004}
        pose = Pose(model.linkage, sizes)
        (cam,) = (element for element in model.linkage.elements if element.kind == "cam")
        angles = np.linspace(0.01, 6.2, 300)
        there = cam.disc(pose).at(angles)
        slant, radius = cam.contact_at(pose, angles)
        assert slant == pytest.approx(there.pressure_angle if kind != "flat" else 0.0 * angles, abs=1e-12)
        bulging = (there.turning > 0.0) & (np.abs(there.radius) < 1.0)
        assert radius[bulging] == pytest.approx(there.radius[bulging], rel=1e-9)
        assert np.all(radius[~bulging] > 0.9)


PROGRAMMES = {"rack": RACK, "belt": BELT, "valve": VALVE, "cam": SMALLEST, "gears": SWINGING, "law": GEARED + FUNCTION}


@pytest.mark.parametrize("text", PROGRAMMES.values(), ids=PROGRAMMES)
def test_derivatives_by_dimensions_of_elements(tmp_path, text):
    """First and second derivatives of the programme against differences."""
    ratio = (
        {"mechanism.gears.mesh": {"bodies": ["motor", "crank"], "ratio": {"bounds": [-0.9, -0.2]}}} if text is not RACK else {}
    )
    nlp = build(problem(tmp_path, text, **(ratio if text.startswith(GEARED) else {})).model)
    rng = np.random.default_rng(3)
    x = nlp.x_start + 0.01 * rng.standard_normal(nlp.x_start.size)
    point, weights = nlp.at(x, nlp.p), rng.standard_normal(len(nlp.rows))

    def lagrangian(z):
        here = nlp.at(z, nlp.p)
        return here.f + weights @ here.g, here.gradient + weights @ here.jacobian

    step = 1e-6
    first, second = [], []
    for k in range(x.size):
        ahead, behind = (lagrangian(x + sense * step * np.eye(x.size)[k]) for sense in (1.0, -1.0))
        first.append((ahead[0] - behind[0]) / (2.0 * step))
        second.append((ahead[1] - behind[1]) / (2.0 * step))
    expected = point.gradient + weights @ point.jacobian
    size = 1.0 + np.max(np.abs(expected))
    assert np.array(first) == pytest.approx(expected, abs=1e-6 * size)
    hessian = nlp.hessian(x, nlp.p, weights)
    assert np.array(second) == pytest.approx(hessian, abs=1e-5 * (1.0 + np.max(np.abs(hessian))))
