"""Simulations in which some of several drives move freely, or follow their laws by a controller, against own integrations."""

from __future__ import annotations

import itertools
import math
import tomllib
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import optlink
from optlink.dynamics.forward import Ending
from optlink.errors import InputError
from optlink.problem.file import read

FILES = Path(__file__).parents[1] / "data" / "driven"
DEGREE = math.pi / 180.0
A, B, C, G = 0.03 + 2.0 * 0.12**2 + 1.5 * 0.3**2, 0.02 + 1.5 * 0.1**2, 1.5 * 0.3 * 0.1, 9.81
FREE = {"drives.elbow.law": None, "drives.elbow.start": "40 deg"}
LOOSE = {**FREE, "drives.shoulder.law": None, "drives.shoulder.torque": "9 N*m"}


def simulated(name, changes=None, **options):
    return optlink.simulate(optlink.load(FILES / f"{name}.toml", changes), **options)


def balanced(run, share=1e-9):
    assert run.figures["imbalance_J"] <= share * run.figures["turnover_J"]
    assert run.figures["drift_m"] < 1e-9


# --- the two-link arm by its Lagrange equations: q1 of the upper arm, q of the forearm relative to it --------------------------


def masses(q):
    return np.array([[A + B + 2.0 * C * np.cos(q), B + C * np.cos(q)], [B + C * np.cos(q), B + 0.0 * q]])


def bias(q1, q, w1, w):
    fore = 1.5 * G * 0.1 * np.cos(q1 + q)
    upper = (2.0 * 0.12 + 1.5 * 0.3) * G * np.cos(q1) + fore
    return np.array([upper - C * np.sin(q) * (2.0 * w1 * w + w**2), fore + C * np.sin(q) * w1**2])


def swing(t):
    """The law of the shoulder: the 3-4-5 polynomial up to 90 deg in 0.5 s, and back."""
    x, back = (t % 0.5) / 0.5, (t % 1.0) >= 0.5
    value, rate, bend = 10 * x**3 - 15 * x**4 + 6 * x**5, 30 * x**2 - 60 * x**3 + 30 * x**4, 60 * x - 180 * x**2 + 120 * x**3
    way = np.where(back, -1.0, 1.0) * math.pi / 2.0
    return np.where(back, math.pi / 2.0, 0.0) + way * value, way * rate / 0.5, way * bend / 0.25


def own(rates, start, times, knots=(0.5, 1.0, 1.5)):
    """Integrate from knot to knot of a law."""
    ends, rows = [times[0], *(knot for knot in knots if times[0] < knot < times[-1]), times[-1]], [np.array(start)[:, None]]
    for begin, end in itertools.pairwise(ends):
        at = np.append(times[(times > begin) & (times < end - 1e-12)], end)
        tight = {"method": "DOP853", "rtol": 1e-12, "atol": 1e-13}
        rows.append(solve_ivp(rates, (begin, end), rows[-1][:, -1], t_eval=at, **tight).y)
    return np.concatenate(rows, axis=1)


def relative(run):
    return np.unwrap(run["fore.angle_rad"] - run["upper.angle_rad"])


def test_elbow_swings_freely_while_the_shoulder_follows_its_law():
    """Also the torque of the prescribed drive, whose work the energy balance includes."""
    spring = {"expression": "-3*(phi - 0.5) - 0.2*omega", "unit": "N*m"}
    run = simulated("two-link-arm", {**FREE, "drives.elbow.torque": spring}, duration=2.0, rows=200)

    def bend(t, q, w):
        q1, w1, a1 = swing(t)
        return (-3.0 * (q - 0.5) - 0.2 * w - bias(q1, q, w1, w)[1] - masses(q)[1, 0] * a1) / B

    time = run["time_s"]
    q, w = own(lambda t, y: (y[1], bend(t, *y)), (40.0 * DEGREE, 0.0), time)
    np.testing.assert_allclose(relative(run), q, atol=1e-9)
    np.testing.assert_allclose(run["elbow.torque_Nm"], -3.0 * (q - 0.5) - 0.2 * w, atol=1e-8)
    q1, w1, a1 = swing(time)
    mass = masses(q)
    shoulder = mass[0, 0] * a1 + mass[0, 1] * bend(time, q, w) + bias(q1, q, w1, w)[0]
    np.testing.assert_allclose(run["shoulder.torque_Nm"], shoulder, atol=1e-7)
    assert run.driven == "2 drives, 1 of them free"
    balanced(run)


def test_shoulder_under_a_torque_carries_a_driven_elbow():
    changes = {"drives.shoulder.law": None, "drives.shoulder.start": "20 deg", "drives.shoulder.torque": "12 N*m"}
    changes["drives.shoulder.initial_speed"] = "-1 rad/s"
    run = simulated("two-link-arm", changes, duration=1.5, rows=100)

    def rates(t, y):
        phase = 2.0 * math.pi * t
        q, w = (40.0 - 30.0 * math.cos(phase)) * DEGREE, 60.0 * math.pi * math.sin(phase) * DEGREE
        a = 120.0 * math.pi**2 * math.cos(phase) * DEGREE
        return y[1], (12.0 - bias(y[0], q, y[1], w)[0] - masses(q)[0, 1] * a) / masses(q)[0, 0]

    q1, w1 = own(rates, (20.0 * DEGREE, -1.0), run["time_s"], knots=())
    np.testing.assert_allclose(np.unwrap(run["upper.angle_rad"]), q1, atol=1e-9)
    np.testing.assert_allclose(run["upper.omega_rad_s"], w1, atol=1e-8)
    balanced(run)


def test_loose_arm_rebounds_from_the_stops_of_its_elbow():
    """An impact changes both speeds: the shoulder has no impulse, the elbow that of its stop."""
    changes = {**LOOSE, "drives.elbow.torque": "0 N*m", "drives.elbow.range": ["-30 deg", "60 deg"]}
    run = simulated("two-link-arm", {**changes, "drives.elbow.stops": {"restitution": 0.6}}, duration=0.53, rows=80)

    def rates(_, y):
        bends = np.linalg.solve(masses(y[1]), np.array([9.0, 0.0]) - bias(*y))
        return [*y[2:], *bends]

    def beyond(_, y):
        return (y[1] + 30.0 * DEGREE) * (60.0 * DEGREE - y[1])

    beyond.terminal, beyond.direction = True, -1.0
    time, state, times, hits = 0.0, np.array([0.0, 40.0 * DEGREE, 0.0, 0.0]), run["time_s"], 0
    rows = [state[:, None]]
    while hits < 20:
        at = times[times > time]
        leg = solve_ivp(rates, (time, times[-1]), state, t_eval=at, events=beyond, method="DOP853", rtol=1e-12, atol=1e-13)
        rows.append(leg.y)
        if leg.status == 0:
            break
        time, state = float(leg.t_events[0][0]), leg.y_events[0][0].copy()
        response = np.linalg.solve(masses(state[1]), [0.0, 1.0])
        state[2:] -= 1.6 * state[3] * response / response[1]
        hits += 1
    every = np.concatenate(rows, axis=1)
    assert hits == 4
    np.testing.assert_allclose(np.unwrap(run["upper.angle_rad"]), every[0], atol=1e-8)
    np.testing.assert_allclose(relative(run), every[1], atol=1e-8)
    assert run.figures["stops.work_J"] < -0.1
    balanced(run)


def test_elbow_is_held_at_its_stop_until_the_arm_throws_it_off():
    changes = {**FREE, "drives.elbow.start": "0 deg", "drives.elbow.torque": "-2 N*m", "drives.elbow.range": ["0 deg", "90 deg"]}
    run = simulated("two-link-arm", {**changes, "gravity": "0 m/s^2"}, duration=0.45, rows=450)
    time, stop = run["time_s"], run["elbow.stop_torque_Nm"]
    a1 = swing(time)[2]
    needed = (B + C) * a1 + 2.0  # of the stop, while the elbow rests at 0 deg: it can only push
    leaves = int(np.argmax(needed < 0.0))
    assert 0.25 < time[leaves] < 0.4
    np.testing.assert_allclose(stop[:leaves], needed[:leaves], atol=1e-9)
    np.testing.assert_allclose(relative(run)[:leaves], 0.0, atol=1e-12)
    assert np.all(stop[leaves + 1 : leaves + 20] == 0.0)
    assert np.all(relative(run)[leaves + 5 : leaves + 20] > 0.0)
    np.testing.assert_allclose(run["elbow.torque_Nm"], -2.0, atol=1e-9)
    balanced(run)


def test_elbow_at_rest_at_its_stop_does_not_pass_it():
    """The law begins with no acceleration, so that nothing presses the elbow against its stop yet."""
    changes = {**FREE, "drives.elbow.start": "0 deg", "drives.elbow.torque": "0 N*m", "drives.elbow.range": ["0 deg", "90 deg"]}
    run = simulated("two-link-arm", {**changes, "gravity": "0 m/s^2"}, duration=0.45, rows=90)
    time = run["time_s"]
    needed = (B + C) * swing(time)[2]
    np.testing.assert_allclose(run["elbow.stop_torque_Nm"], np.maximum(needed, 0.0), atol=1e-9)
    assert np.all(relative(run)[time > 0.26] > 0.0)
    balanced(run)


# --- elastic stops: going out they push with the square of the restitution of their force going in ------------------------------

STIFF, BACK = 60.0, 0.6**2
ELASTIC = {
    "drives.elbow.torque": "0 N*m",
    "drives.elbow.range": ["-30 deg", "60 deg"],
    "drives.elbow.stops": {"stiffness": f"{STIFF} N*m/rad", "restitution": 0.6},
}


def test_elastic_stop_of_a_free_elbow_has_the_closed_form_of_half_oscillations():
    held = {**FREE, **ELASTIC, "drives.shoulder.law": None, "drives.elbow.initial_speed": "2 rad/s", "gravity": "0 m/s^2"}
    run = simulated("two-link-arm", held, duration=0.5, rows=500)
    time, q = run["time_s"], relative(run)
    frequency, end, hit = math.sqrt(STIFF / B), 60.0 * DEGREE, 20.0 * DEGREE / 2.0
    inmost, out = hit + 0.5 * math.pi / frequency, hit + 0.5 * math.pi * (1.0 + 1.0 / 0.6) / frequency
    into, back, after = (time > hit) & (time < inmost), (time > inmost) & (time < out), time > out
    np.testing.assert_allclose(q[into], end + 2.0 / frequency * np.sin(frequency * (time[into] - hit)), atol=1e-9)
    np.testing.assert_allclose(q[back], end + 2.0 / frequency * np.cos(0.6 * frequency * (time[back] - inmost)), atol=1e-9)
    np.testing.assert_allclose(q[after], end - 1.2 * (time[after] - out), atol=1e-9)
    np.testing.assert_allclose(run["elbow.stop_torque_Nm"][back], -STIFF * BACK * (q[back] - end), atol=1e-7)
    assert run.figures["stops.work_J"] == pytest.approx(-0.5 * B * (2.0**2 - 1.2**2), rel=1e-9)
    balanced(run)


def test_loose_arm_on_elastic_stops_by_an_own_integration():
    run = simulated("two-link-arm", {**LOOSE, **ELASTIC}, duration=0.36, rows=60)

    def rates(_, y):
        low, high = min(y[1] + 30.0 * DEGREE, 0.0), max(y[1] - 60.0 * DEGREE, 0.0)
        stop = -STIFF * (low * (1.0 if y[3] < 0.0 else BACK) + high * (1.0 if y[3] > 0.0 else BACK))
        return [*y[2:], *np.linalg.solve(masses(y[1]), np.array([9.0, stop]) - bias(*y))]

    tight = {"method": "DOP853", "rtol": 1e-10, "atol": 1e-11, "max_step": 1e-3}
    solved = solve_ivp(rates, (0.0, 0.36), [0.0, 40.0 * DEGREE, 0.0, 0.0], t_eval=run["time_s"], **tight).y
    np.testing.assert_allclose(np.unwrap(run["upper.angle_rad"]), solved[0], atol=1e-6)
    np.testing.assert_allclose(relative(run), solved[1], atol=1e-6)
    assert np.min(relative(run)) < -40.0 * DEGREE
    assert run.figures["stops.work_J"] < -0.05
    balanced(run)


def test_elastic_stop_holds_the_forearm_until_the_shoulder_throws_it_off():
    """At rest the stop pushes with any force from that of going out to that of going in."""
    laws = [{"time": "2 s"}, {"time": "0.5 s", "to": "90 deg", "law": "3-4-5"}, {"time": "1 s"}]
    changes = {**FREE, **ELASTIC, "drives.shoulder.law": laws, "drives.shoulder.start": "0 deg"}
    changes["drives.elbow.start"] = "-25 deg"
    run = simulated("two-link-arm", changes, duration=2.6, rows=260)
    time, q, stop = run["time_s"], relative(run), run["elbow.stop_torque_Nm"]
    rests = (time > 1.5) & (time < 1.99)
    depth, weight = -30.0 * DEGREE - q[rests][0], 1.5 * G * 0.1 * math.cos(q[rests][0])
    np.testing.assert_allclose(q[rests], q[rests][0], atol=1e-12)
    np.testing.assert_allclose(stop[rests], weight, rtol=1e-9)
    assert BACK * STIFF * depth < weight < STIFF * depth
    assert np.max(q) > 0.0
    assert np.all(stop[(q > -30.0 * DEGREE) & (q < 60.0 * DEGREE)] == 0.0)
    balanced(run)


# --- published mechanisms with freedoms ----------------------------------------------------------------------------------------

PUBLISHED = {file.stem: file for file in (FILES.parent / "free").glob("*.toml")}


@pytest.mark.parametrize("name", PUBLISHED)
def test_energy_of_a_published_mechanism_balances(name):
    run = optlink.simulate(optlink.load(PUBLISHED[name]), duration=0.5, rows=20)
    assert run.ending is Ending.FINISHED
    assert run.figures["turnover_J"] > 0.1
    balanced(run)


def excited(t, q, w):
    """The rod, whose centroid lies at its end, beneath a pivot with a vertical law."""
    return -0.3 * 0.5 * math.cos(q) * (G - 0.1 * (8.0 * math.pi) ** 2 * math.sin(8.0 * math.pi * t)) / (0.3 * 0.25 + 0.005)


def sprung(t, s, v):
    """The mass on the spring from a slider 0.2 m and 0.5 m from the crank pivot."""
    phi, w = 2.0 * math.pi * t, 2.0 * math.pi
    root = math.sqrt(0.25 - (0.2 * math.sin(phi)) ** 2)
    slider, speed = 0.2 * math.cos(phi) + root, -0.2 * w * math.sin(phi) * (1.0 + 0.2 * math.cos(phi) / root)
    return 400.0 * (0.2 - (s - slider)) - 2.0 * (v - speed)


@pytest.mark.parametrize(
    ("name", "column", "bend", "start"),
    [
        ("excited-pendulum", "rod.angle_rad", excited, -60.0 * DEGREE),
        ("slider-crank-with-sprung-mass", "mass.s_m", sprung, 0.9),
    ],
)
def test_published_mechanism_by_an_own_integration(name, column, bend, start):
    run = optlink.simulate(optlink.load(PUBLISHED[name]), duration=1.0, rows=50)
    q, _ = own(lambda t, y: (y[1], bend(t, *y)), (start, 0.0), run["time_s"], knots=())
    np.testing.assert_allclose(np.unwrap(run[column]) if "angle" in column else run[column], q, atol=1e-8)


# --- controllers ------------------------------------------------------------------------------------------------------------

GAINS = {"proportional": "200 N*m/rad", "derivative": "10 N*m*s/rad"}


def test_arm_by_controllers_with_feedforward_follows_its_laws_exactly():
    both = {
        "drives.shoulder.controller": {**GAINS, "feedforward": True},
        "drives.elbow.controller": {**GAINS, "feedforward": True},
    }
    run, ideal = (simulated("two-link-arm", changes, duration=1.0, rows=50) for changes in (both, None))
    np.testing.assert_allclose(run["elbow.error_rad"], 0.0, atol=1e-11)
    np.testing.assert_allclose(run["shoulder.torque_Nm"][1:-1], ideal["shoulder.torque_Nm"][1:-1], atol=1e-7)
    balanced(run)
    loose = simulated("two-link-arm", {"drives.elbow.controller": GAINS}, duration=1.0, rows=50)
    lag = np.max(np.abs(loose["elbow.error_rad"]))
    assert 0.01 < lag == loose.figures["elbow.largest_error_rad"]
    q = (40.0 - 30.0 * np.cos(2.0 * np.pi * loose["time_s"])) * DEGREE
    np.testing.assert_allclose(relative(loose) + loose["elbow.error_rad"], q, atol=1e-12)


CART = """
title = "Carriage with a servo"
[mechanism.ground]
A = ["0 m", "0 m"]
[mechanism.links]
carriage = { joints = ["T"] }
[mechanism.guides]
rail = { slider = "carriage", through = "A" }
[bodies]
carriage = { mass = "2 kg" }
[drive]
slide = "rail"
law = { expression = "50*sin(2*pi*t)", unit = "mm" }
controller = { proportional = "800 N/m", derivative = "20 N*s/m" }
"""


def cart(**changes):
    return read(tomllib.loads(CART), "cart").override({f"drive.{key}": value for key, value in changes.items()})


def test_carriage_by_a_controller_has_the_closed_form_of_a_damped_oscillator():
    run = optlink.simulate(cart(initial_speed="0 m/s"), duration=1.5, rows=150)
    time, w = run["time_s"], 2.0 * math.pi
    mass, damping, stiffness = 2.0, 20.0, 800.0
    steady = 0.05 * (stiffness + 1j * w * damping) / (stiffness - mass * w**2 + 1j * w * damping)  # of exp(i w t)
    decay = damping / (2.0 * mass)
    own = math.sqrt(stiffness / mass - decay**2)
    begin, rate = -steady.imag, -(1j * w * steady).imag
    free = np.exp(-decay * time) * (begin * np.cos(own * time) + (rate + decay * begin) / own * np.sin(own * time))
    np.testing.assert_allclose(run["carriage.s_m"], (steady * np.exp(1j * w * time)).imag + free, atol=1e-11)
    assert run.driven == "a controller"
    balanced(run)
    at_speed = optlink.simulate(cart(), duration=0.1, rows=10)
    assert at_speed["carriage.v_m_s"][0] == pytest.approx(0.05 * w)


def test_limited_controller_gives_at_most_its_force():
    limited = {"proportional": "800 N/m", "derivative": "20 N*s/m", "limit": "3 N"}
    run = optlink.simulate(cart(controller=limited), duration=1.0, rows=100)
    assert np.max(np.abs(run["input.force_N"])) == pytest.approx(3.0)
    np.testing.assert_allclose(2.0 * run["carriage.a_m_s2"], run["input.force_N"], atol=1e-10)
    balanced(run)


def test_four_bar_by_a_controller_by_an_own_integration():
    linkage = {"type": "four-bar", "crank": "100 mm", "coupler": "400 mm", "rocker": "250 mm", "frame": "450 mm"}
    bodies = {
        name: {"mass": f"{mass} kg", "inertia": "uniform bar"} for name, mass in (("crank", 1), ("coupler", 2), ("rocker", 3))
    }
    drive = {"law": {"expression": "90*t + 20*sin(4*pi*t)", "unit": "deg"}}
    drive["controller"] = {"proportional": "60 N*m/rad", "derivative": "2 N*m*s/rad"}
    file = read({"title": "servo", "gravity": "9.81 m/s^2", "mechanism": linkage, "bodies": bodies, "drive": drive}, "servo")
    run = optlink.simulate(file, duration=1.0, rows=50)

    def points(phi):
        b = 0.1 * np.exp(1j * phi)
        away = b - 0.45
        cosine = (abs(away) ** 2 + 0.25**2 - 0.4**2) / (2.0 * 0.25 * abs(away))
        ends = [0.45 + 0.25 * away / abs(away) * np.exp(side * 1j * math.acos(cosine)) for side in (1, -1)]
        return b, max(ends, key=lambda c: c.imag)

    def parts(phi, step=1e-4):
        """Reduced inertia and potential energy of three bars: each has a third of its mass in the mean of its end speeds."""
        (b0, c0), (b1, c1), (b, c) = points(phi - step), points(phi + step), points(phi)
        vb, vc = (b1 - b0) / (2.0 * step), (c1 - c0) / (2.0 * step)
        kinetic = (abs(vb) ** 2 + 2.0 * (abs(vb) ** 2 + abs(vc) ** 2 + (vb * vc.conjugate()).real) + 3.0 * abs(vc) ** 2) / 3.0
        return kinetic, G * (0.5 * b.imag + (b + c).imag + 1.5 * c.imag)

    def rates(t, y):
        (low, below), (high, above), (here, _) = parts(y[0] - 1e-3), parts(y[0] + 1e-3), parts(y[0])
        aim, rate = 90.0 * t + 20.0 * math.sin(4.0 * math.pi * t), 90.0 + 80.0 * math.pi * math.cos(4.0 * math.pi * t)
        torque = 60.0 * (aim * DEGREE - y[0]) + 2.0 * (rate * DEGREE - y[1])
        return y[1], (torque - (above - below) / 2e-3 - 0.5 * (high - low) / 2e-3 * y[1] ** 2) / here

    solved = solve_ivp(rates, (0.0, 1.0), (0.0, (90.0 + 80.0 * math.pi) * DEGREE), t_eval=run["time_s"], rtol=1e-8, atol=1e-9)
    np.testing.assert_allclose(np.unwrap(run["crank.angle_rad"]), solved.y[0], atol=3e-6)
    assert np.max(np.abs(run["input.error_rad"])) > 0.01
    balanced(run)


# --- closed loops and cylinders ------------------------------------------------------------------------------------------------


def test_efforts_from_reactions_are_those_of_free_drives():
    changes = {"drives.right.law": None, "drives.right.torque": "0.5 N*m", "drives.right.start": "60 deg"}
    changes |= {f"bodies.{name}": {"mass": "1 kg", "inertia": "uniform bar"} for name in ("left", "right")}
    run = simulated("five-bar-robot", changes, duration=0.2, rows=40)
    assert run.ending is Ending.FINISHED
    np.testing.assert_allclose(run["right.torque_Nm"], 0.5, atol=1e-9)
    balanced(run)


def test_cylinder_by_a_controller_pushes_as_its_law_needs():
    ram = {"proportional": "100 kN/m", "derivative": "10 kN*s/m", "feedforward": True}
    changes = {"drive.speed": None, "drive.law": [{"time": "2 s", "to": "6.5 m"}, {"time": "2 s", "to": "6 m"}]}
    changes["bodies.bell"] = {"mass": "100 kg", "inertia": "uniform bar"}
    changes["gravity"] = "9.81 m/s^2"
    run, ideal = (
        simulated("backhoe-bucket", {**changes, **more}, duration=3.0, rows=60) for more in ({"drive.controller": ram}, {})
    )
    np.testing.assert_allclose(run["input.error_m"], 0.0, atol=1e-10)
    away = np.abs(run["time_s"] - 2.0) > 1e-9
    np.testing.assert_allclose(run["input.force_N"][away], ideal["input.force_N"][away], rtol=1e-6, atol=1e-3)
    balanced(run)


# --- laws that end with a speed, and what is refused ---------------------------------------------------------------------------


def test_first_law_that_ends_with_a_speed_ends_the_motion_of_all():
    laws = {"drives.shoulder.law": [{"time": "1 s", "to": "80 deg"}], "drives.shoulder.start": "0 deg"}
    laws["drives.elbow.start"] = "0 deg"
    laws["drives.elbow.law"] = [{"time": "0.4 s", "to": "60 deg", "law": "constant"}]
    run = simulated("two-link-arm", laws, duration=1.0, rows=100)
    assert run.ending is Ending.END_OF_RANGE
    assert run.stopped == pytest.approx(0.4)
    run = simulated("two-link-arm", laws, rows=10)
    assert run["time_s"][-1] == pytest.approx(0.4)
    other = simulated("two-link-arm", {**laws, "drives.shoulder.law": None, "drives.shoulder.torque": "5 N*m"}, duration=1.0)
    assert other.stopped == pytest.approx(0.4)


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"drives.elbow.torque": "1 N*m"}, r"drives\.elbow\.torque.*prescribed motion and a torque"),
        ({**FREE, "drives.elbow.controller": GAINS}, r"drives\.elbow\.controller.*no law"),
        ({"drives.elbow.controller": {"proportional": "5 N/m"}}, r"controller\.proportional.*drive turns"),
        ({"drives.elbow.controller": {"proportional": "0 N*m/rad"}}, r"controller\.proportional.*a gain is positive"),
        ({**FREE, "drives.elbow.torque": "1 N*m", "drives.elbow.stops": "rigid"}, r"drives\.elbow\.stops.*end stops"),
        ({**FREE, "drives.elbow.torque": "1 N*m", "drives.elbow.initial_speed": "1 m/s"}, r"initial_speed.*drive turns"),
        ({**FREE, "drives.elbow.torque": "1 N*m", "drives.elbow.range": ["0 deg", "30 deg"]}, r"drives\.elbow\.start.*outside"),
    ],
)
def test_what_does_not_fit_is_refused(changes, text):
    with pytest.raises(InputError, match=text):
        simulated("two-link-arm", changes, duration=0.1)


def test_loads_that_jump_and_a_missing_duration_are_refused():
    brake = {"on": "fore", "torque": "1 N*m", "acts": "opposing"}
    with pytest.raises(InputError, match=r"loads\.brake.*not supported.*tanh"):
        simulated("two-link-arm", {**FREE, "drives.elbow.torque": "0 N*m", "loads.brake": brake}, duration=0.1)
    with pytest.raises(InputError, match=r"mechanism\.guides\.rail\.friction: friction in a guide is not supported.*tanh"):
        optlink.simulate(optlink.load(PUBLISHED["crane-crab"], {"mechanism.guides.rail.friction": 0.1}), duration=0.1)
    soft = {"drives.elbow.range": ["0 deg", "90 deg"], "drives.elbow.stops": {"stiffness": "0 N*m/rad"}}
    with pytest.raises(InputError, match=r"stops\.stiffness.*a stop needs a stiffness"):
        simulated("two-link-arm", {**FREE, "drives.elbow.torque": "0 N*m", **soft}, duration=0.1)
    with pytest.raises(InputError, match="the duration of the motion is not known"):
        simulated("two-link-arm", {**LOOSE, "drives.elbow.torque": "0 N*m"})
    with pytest.raises(InputError, match="no inertia"):
        simulated("two-link-arm", {**LOOSE, "drives.elbow.torque": "0 N*m", "bodies": None}, duration=0.1)
