"""Motion under a torque: closed forms, an independent integration, energy, rest, dead positions, flywheels."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import quad, solve_ivp
from scipy.special import ellipk
from typer.testing import CliRunner

import optlink
from optlink.cli.app import app
from optlink.dynamics import forward as crank_module, forward as drive_module
from optlink.dynamics.forward import Ending, crank_acceleration
from optlink.dynamics.inverse import reactions, reduced_inertia
from optlink.dynamics.machine import Inertia
from optlink.dynamics.work import Fluctuation, flywheel
from optlink.tasks.clearance import _setting
from optlink.tasks.machine import machine_of
from tests.solved import loaded
from tests.tiers import mostly_slow

TURN = 2.0 * math.pi


def turns_fully(name):
    problem = loaded(name)
    return problem.task != "path" and getattr(getattr(problem.model, "limits", None), "crank", "") != "span"


MACHINES = sorted(filter(turns_fully, optlink.shipped()))
ANGLES = np.linspace(0.05, 0.05 + TURN, 37)


def crank_alone(**changes):
    """One body on a pivot: a pendulum, a rotor."""
    raw = {
        "title": "crank alone",
        "mechanism": {"ground": {"A": ["0 m", "0 m"]}, "links": {"crank": {"joints": ["A", "B"], "length": "0.5 m"}}},
        "bodies": {"crank": {"mass": "2 kg", "inertia": "uniform bar"}},
        "drive": {"torque": "0 N*m", "duration": "3 s"},
    }
    return optlink.read({**raw, **changes})


def slider_crank(**changes):
    raw = {
        "title": "slider-crank",
        "mechanism": {
            "ground": {"A": ["0 m", "0 m"]},
            "links": {
                "crank": {"joints": ["A", "B"], "length": "0.1 m"},
                "rod": {"joints": ["B", "C"], "length": "0.3 m"},
                "slider": {"joints": ["C"]},
            },
            "guides": {"F": {"slider": "slider", "through": "A"}},
            "assembly": {"C": "forward"},
        },
        "bodies": {
            "crank": {"mass": "0.2 kg", "inertia": "uniform bar"},
            "rod": {"mass": "0.2 kg", "inertia": "uniform bar"},
            "slider": {"mass": "0.4 kg"},
        },
        "drive": {"torque": "0.1 N*m", "duration": "2 s"},
    }
    for key, value in changes.items():
        raw[key] = {**raw.get(key, {}), **value} if isinstance(value, dict) else value
    return optlink.read(raw)


ROUGH = {
    "gravity": "9.81 m/s^2",
    "mechanism": {
        **dict(slider_crank().raw["mechanism"]),
        "guides": {"F": {"slider": "slider", "through": "A", "friction": 0.2}},
    },
}
LOADED = {
    "gravity": ["1 m/s^2", "-9.81 m/s^2"],
    "loads": {
        "resistance": {"on": "slider", "force": "3 N", "acts": "opposing"},
        "damper": {"on": "slider", "damping": "2 N*s/m"},
        "spring": {"between": ["C", "A"], "stiffness": "40 N/m", "free_length": "0.3 m"},
    },
}


# --- reduced inertia, forward and inverse ------------------------------------------------------------------------------


@pytest.mark.parametrize("name", MACHINES)
def test_reduced_inertia_has_its_derivative_and_is_twice_the_energy_at_unit_speed(name):
    machine = machine_of(optlink.load(name))
    if not machine.inertias:
        machine = machine.with_(inertias={body: Inertia(1.0, 0.1, 0.02, 0.01) for body in machine.mechanism.bodies})
    inertia, slope = reduced_inertia(machine, ANGLES)
    steps = 1e-4 * np.arange(-2, 3)
    around = np.stack([reduced_inertia(machine, ANGLES + step)[0] for step in steps])
    weights = np.array([1.0, -8.0, 0.0, 8.0, -1.0]) / (12.0 * 1e-4)
    np.testing.assert_allclose(slope, weights @ around, rtol=1e-7, atol=1e-8 * np.max(np.abs(slope)) + 1e-14)
    assert np.all(inertia > 0.0)


@pytest.mark.parametrize("name", MACHINES)
@pytest.mark.parametrize("speed", [7.0, -3.0])
def test_inverse_after_forward_dynamics_returns_the_torque(name, speed):
    machine = machine_of(optlink.load(name))
    if not machine.inertias:
        machine = machine.with_(inertias={body: Inertia(1.0, 0.1, 0.02, 0.01) for body in machine.mechanism.bodies})
    torque = 12.5 * np.cos(2.0 * ANGLES)
    alpha = crank_acceleration(machine.moving(ANGLES, 1.0), speed, torque, np.sign(speed))
    computed = reactions(machine.moving(ANGLES, speed, alpha)).torque
    scale = np.max(np.abs(reactions(machine.moving(ANGLES, speed)).torque)) + 12.5
    np.testing.assert_allclose(computed, torque, rtol=0.0, atol=1e-11 * scale)


def test_inverse_after_forward_dynamics_detects_a_wrong_inertia(monkeypatch):
    machine = machine_of(slider_crank())
    heavier = machine.with_(inertias={**machine.inertias, "slider": Inertia(0.41)})
    alpha = crank_acceleration(heavier.moving(ANGLES, 1.0), 7.0, 1.0, 1.0)
    assert np.max(np.abs(reactions(machine.moving(ANGLES, 7.0, alpha)).torque - 1.0)) > 1e-3


def test_friction_that_depends_on_the_acceleration_is_undone_too():
    machine = machine_of(slider_crank(**ROUGH, **{"loads": LOADED["loads"]}))
    torque = 5.0 * np.sin(ANGLES)
    for speed in (20.0, -20.0):
        alpha = crank_acceleration(machine.moving(ANGLES, 1.0), speed, torque, np.sign(speed))
        computed = reactions(machine.moving(ANGLES, speed, alpha)).torque
        np.testing.assert_allclose(computed, torque, rtol=0.0, atol=1e-11 * 30.0)


# --- closed forms ------------------------------------------------------------------------------------------------------


def test_pendulum_has_the_period_of_the_elliptic_integral():
    """A uniform bar of 0.5 m let go 60 degrees from hanging: T = 4 sqrt(J / (m g l)) K(sin^2(30 deg))."""
    problem = crank_alone(gravity="9.81 m/s^2", drive={"torque": "0 N*m", "start": "-30 deg", "duration": "4 s"})
    reduced = (0.25 / 3.0 * 2.0) / (2.0 * 9.81 * 0.25)  # J / (m g l)
    period = 4.0 * math.sqrt(reduced) * float(ellipk(math.sin(math.radians(30.0)) ** 2))
    result = optlink.simulate(problem, duration=period, rows=4)
    np.testing.assert_allclose(result["crank_angle_deg"], [-30.0, -90.0, -150.0, -90.0, -30.0], rtol=0.0, atol=1e-7)
    assert abs(result["crank.omega_rad_s"][-1]) < 1e-8
    assert result.figures["imbalance_J"] < 1e-9 * result.figures["turnover_J"]


def test_the_energy_does_not_depend_on_the_height_of_the_machine():
    """Relative to the potential energy at y = 0 the imbalance of a machine far up would seem small."""
    drive = {"torque": "0 N*m", "start": "-30 deg", "duration": "0.5 s"}
    low, high = (
        optlink.simulate(crank_alone(gravity="9.81 m/s^2", drive=drive).override({"mechanism.ground.A": ["0 m", y]}))
        for y in ("0 m", "40 m")
    )
    assert low.figures["turnover_J"] == pytest.approx(2.0 * 9.81 * 0.25 * 0.5, rel=1e-5)  # from -30 deg down to hanging
    assert high.figures["turnover_J"] == pytest.approx(low.figures["turnover_J"], rel=1e-9)


def test_motor_curve_and_torsional_damper_give_an_exponential():
    """J w' = 4 - 0.5 w - 0.3 w, from rest: w = 5 (1 - exp(-0.8 t / J))."""
    problem = crank_alone(
        loads={"brake": {"on": "crank", "torsional_damping": "0.3 N*m*s/rad"}},
        drive={"torque": {"expression": "4 - 0.5*omega", "unit": "N*m"}, "duration": "1.5 s"},
    )
    result = optlink.simulate(problem, rows=30)
    inertia = 2.0 * 0.25 / 3.0
    expected = 5.0 * (1.0 - np.exp(-0.8 * result["time_s"] / inertia))
    np.testing.assert_allclose(result["crank.omega_rad_s"], expected, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(
        result.figures["brake.work_J"], -0.3 * quad(lambda t: 25.0 * (1.0 - math.exp(-4.8 * t)) ** 2, 0, 1.5)[0]
    )


def test_motor_curve_as_a_table_is_the_same_as_the_expression():
    table = {"over": "omega", "at": ["-10 rad/s", "10 rad/s"], "values": ["9 N*m", "-1 N*m"]}
    one, other = (
        optlink.simulate(crank_alone(drive={"torque": torque, "duration": "1 s"}), rows=5)["crank.omega_rad_s"]
        for torque in (table, {"expression": "4 - 0.5*omega", "unit": "N*m"})
    )
    np.testing.assert_allclose(one, other, rtol=0.0, atol=1e-10)


def test_dry_brake_stops_a_rotor_by_uniform_deceleration():
    """J w' = -0.6: from 6 rad/s at rest after J 6 / 0.6 = 5/3 s, having turned w t / 2 = 5 rad."""
    problem = crank_alone(
        loads={"brake": {"on": "crank", "torque": "0.6 N*m", "acts": "opposing"}},
        drive={"torque": "0 N*m", "initial_speed": "6 rad/s", "duration": "3 s"},
    )
    result = optlink.simulate(problem, rows=300)
    assert result.ending is Ending.AT_REST
    assert result.valid
    assert result.stopped == pytest.approx(5.0 / 3.0, abs=1e-9)
    assert result.figures["brake.work_J"] == pytest.approx(-3.0, abs=1e-9)
    figures = result.figures  # those of the rest, not of the last even row
    ends = [figures[f"end.{name}"] for name in ("time_s", "crank_angle_rad", "speed_rad_s")]
    assert ends == pytest.approx([5.0 / 3.0, 5.0, 0.0], abs=1e-9)
    assert len(result["time_s"]) == 168  # 0 ... 1.66 s, and the rest
    assert "at rest" in str(result.to_dict()["status"])


def test_rotor_that_the_torque_cannot_move_stays_and_one_that_it_can_moves_either_way():
    def run(torque):
        brake = {"brake": {"on": "crank", "torque": "0.6 N*m", "acts": "opposing"}}
        return optlink.simulate(crank_alone(loads=brake, drive={"torque": torque, "duration": "1 s"}), rows=4)

    assert run("0.59 N*m").ending is Ending.AT_REST
    assert len(run("-0.59 N*m")["time_s"]) == 1
    inertia = 2.0 * 0.25 / 3.0
    for sign in (1.0, -1.0):
        result = run(f"{sign * 0.7} N*m")
        assert result.ending is Ending.FINISHED
        assert result["crank.omega_rad_s"][-1] == pytest.approx(sign * 0.1 / inertia, abs=1e-9)


# --- independent integration --------------------------------------------------------------------------------------------


def independent(time, gravity, stiffness, free, damping, resistance, torque):
    """The slider-crank from its Lagrangian in closed form, derivatives of the energy by hand; SciPy's Radau-free LSODA."""
    r, length, m, ms = 0.1, 0.3, 0.2, 0.4

    def geometry(phi):
        s, c = math.sin(phi), math.cos(phi)
        root = math.sqrt(length**2 - r**2 * s**2)
        x = r * c + root
        dx = -r * s - r**2 * s * c / root
        beta_rate = -r * c / root  # d(rod angle)/d(phi), sin(rod angle) = -r s / length
        rod = np.array([-r * s + 0.5 * (dx + r * s), r * c - 0.5 * r * c])  # velocity of the rod's middle per phi'
        inertia = m * r**2 / 3.0 + m * rod @ rod + m * length**2 / 12.0 * beta_rate**2 + ms * dx**2
        return inertia, x, dx, rod

    def right(_, y):
        phi, w = y
        h = 1e-5
        slope = (-geometry(phi + 2 * h)[0] + 8 * geometry(phi + h)[0] - 8 * geometry(phi - h)[0] + geometry(phi - 2 * h)[0]) / (
            12 * h
        )
        inertia, x, dx, rod = geometry(phi)
        crank = np.array([-r * math.sin(phi), r * math.cos(phi)]) / 2.0
        weight = m * gravity @ crank + m * gravity @ rod + ms * gravity[0] * dx
        pull = -stiffness * (x - free) - damping * dx * w - resistance * np.sign(dx * w)
        return [w, (torque + weight + pull * dx - 0.5 * slope * w * w) / inertia]

    result = solve_ivp(right, (0.0, time), [0.3, 5.0], method="DOP853", rtol=1e-11, atol=1e-11, max_step=1e-2)
    return result.y[:, -1]


@pytest.mark.parametrize("sign", mostly_slow((1.0, -1.0), -1.0))
def test_loaded_slider_crank_follows_its_lagrangian(sign):
    problem = slider_crank(
        **LOADED,
        drive={"torque": "2 N*m", "duration": "0.4 s", "start": f"{0.3 * sign} rad", "initial_speed": f"{5 * sign} rad/s"},
    )
    if sign < 0.0:  # mirrored at the x axis
        problem = problem.override({"drive.torque": "-2 N*m", "gravity": ["1 m/s^2", "9.81 m/s^2"]})
    result = optlink.simulate(problem, rows=3)
    phi, w = independent(0.4, np.array([1.0, -9.81]), 40.0, 0.3, 2.0, 3.0, 2.0)
    assert sign * result["crank.angle_rad"][-1] == pytest.approx(phi, abs=2e-6)  # the other runs through its jumps
    assert sign * result["crank.omega_rad_s"][-1] == pytest.approx(w, abs=2e-5)
    assert result.figures["imbalance_J"] < 1e-9 * result.figures["turnover_J"]
    assert result.figures["drift_m"] < 1e-9


@pytest.mark.parametrize("name", ["six-bar", "oscillating-cylinder", "scotch-yoke", "slotted-quick-return", "stephenson-iii"])
@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_traced_rates_are_those_of_numbers(name, direction):
    problem = optlink.load(name)
    machine = machine_of(problem, None).with_(friction={})
    plant = drive_module.EquationsOfMotion(machine, lambda known: 3.0 - 0.1 * known["omega"] + np.sin(known["phi"]))
    plant.direction = direction
    for angle in problem.model.drive.start.value + direction * np.linspace(0.0, 6.0, 7):
        crank = np.array([angle, 7.0 * direction])
        expected = drive_module.flat(plant.rates(*crank))
        np.testing.assert_allclose(plant.functions()[0](crank)[0], expected, rtol=1e-10, atol=1e-12 * np.max(np.abs(expected)))


def test_drift_and_energy_account_see_a_wrong_acceleration(monkeypatch):
    honest = drive_module.EquationsOfMotion.accelerations
    monkeypatch.setattr(
        drive_module.EquationsOfMotion, "accelerations", lambda self, moving: [1.000001 * a for a in honest(self, moving)]
    )
    assert optlink.simulate(slider_crank(), duration=0.5, rows=10).figures["drift_m"] > 1e-8


def test_energy_account_detects_an_omitted_load(monkeypatch):
    honest = crank_module.required_torque

    def without_loads(moving, geared):
        return honest(drive_module.Moving(moving.machine.with_(loads=()), moving.motion, 1, moving.direction), geared)

    assert optlink.simulate(slider_crank(**LOADED), duration=0.3, rows=5).figures["imbalance_J"] < 1e-9
    monkeypatch.setattr(crank_module, "required_torque", without_loads)
    assert optlink.simulate(slider_crank(**LOADED), duration=0.3, rows=5).figures["imbalance_J"] > 1e-3


def test_functions_compiled_for_a_machine_serve_that_machine_and_torque_alone():
    problem, torque = slider_crank(), slider_crank(drive={"torque": "0.2 N*m", "duration": "2 s"})
    fresh = [
        optlink.simulate(slider_crank(), duration=0.5, rows=3),
        optlink.simulate(slider_crank(), duration=0.5, rows=3, flywheel=0.01),
        optlink.simulate(slider_crank(drive={"torque": "0.2 N*m", "duration": "2 s"}), duration=0.5, rows=3),
        optlink.simulate(slider_crank(), duration=0.5, rows=3, speed=-9.0),
    ]
    again = [
        optlink.simulate(problem, duration=0.5, rows=3),
        optlink.simulate(problem, duration=0.5, rows=3, flywheel=0.01),
        optlink.simulate(torque, duration=0.5, rows=3),
        optlink.simulate(problem, duration=0.5, rows=3, speed=-9.0),
    ]
    optlink.simulate(problem, duration=0.5, rows=3)  # compiled by now
    again.append(optlink.simulate(problem, duration=0.5, rows=3))
    ends = [one.figures["end.crank_angle_rad"] for one in (*fresh, fresh[0])]
    assert [one.figures["end.crank_angle_rad"] for one in again] == ends
    assert len(set(ends)) == 4


def test_a_machine_compiled_for_another_torque_is_detected():
    """A machine keeps its functions with the torque that they contain."""
    problem = slider_crank()
    machine, times = machine_of(problem), np.array([0.0, 0.5])
    ends = [drive_module.run(machine, times, 0.0, 5.0, lambda _, t=torque: t).crank_angle[-1] for torque in (0.1, 0.2, 0.1)]
    assert ends[0] == ends[2] != ends[1]


@pytest.mark.slow
def test_friction_in_a_guide_takes_energy_and_closes_the_account():
    result = optlink.simulate(slider_crank(**ROUGH, drive={"torque": "0.5 N*m"}), duration=0.4, rows=50)
    assert np.all(np.diff(result["friction.work_J"]) <= 0.0)
    assert result["friction.work_J"][-1] < -0.01
    assert result.figures["imbalance_J"] < 1e-8 * result.figures["turnover_J"]


# --- published and special cases ----------------------------------------------------------------------------------------


def test_slider_crank_under_a_torque_reaches_the_reference():
    """theta 55.0724438 rad, omega 39.79557704 rad/s after 2 s: printed to the digits that are compared."""
    result = optlink.simulate(slider_crank(), rows=2)
    assert result.figures["end.crank_angle_rad"] == pytest.approx(55.0724438, abs=1e-7)
    assert result.figures["end.speed_rad_s"] == pytest.approx(39.79557704, abs=1e-7)
    assert result.figures["imbalance_J"] < 1e-8 * result.figures["turnover_J"]
    assert result.figures["drift_m"] < 1e-9


def test_six_bar_at_constant_speed_for_a_second():
    result = optlink.simulate(optlink.load("six-bar"))
    assert result.figures["input.work_J"] == pytest.approx(225.033, abs=1e-3)  # as printed
    gained = result["energy.gained_J"][-1]
    assert result.figures["input.work_J"] == pytest.approx(
        gained - 1000.0 * np.ptp(result["slider.s_m"][[0, -1]]) * -1.0, abs=1e-7
    )
    assert result.figures["drift_m"] < 1e-9
    assert result.figures["imbalance_J"] < 1e-8 * result.figures["turnover_J"]
    assert "finished" in result.to_dict()["status"]


def test_crank_that_cannot_turn_stops_at_its_dead_position():
    problem = optlink.load("six-bar").override({"mechanism.links.link3.length": "0.3 m"})
    result = optlink.simulate(problem, duration=1.0)
    assert result.ending is Ending.DEAD_POSITION
    assert not result.valid
    end = math.acos((0.4**2 + 1.5**2 - 1.5**2) / (2.0 * 0.4 * 1.5))  # triangle A-B-D with B-D stretched to 1.2 + 0.3 m
    assert result["crank.angle_rad"][-1] < end
    assert result.stopped == pytest.approx((end - math.radians(62.0)) / 10.0, abs=1e-6)
    assert len(result["time_s"]) < 100


def test_interrupted_run_keeps_its_rows():
    def stop(share):
        if share > 0.3:
            raise KeyboardInterrupt

    result = optlink.simulate(slider_crank(), rows=100, progress=stop)
    assert result.ending is Ending.INTERRUPTED
    assert 25 < len(result["time_s"]) < 60


def test_massless_machine_is_refused():
    with pytest.raises(optlink.InputError, match="no inertia"):
        optlink.simulate(slider_crank(bodies={body: {"mass": "0 kg"} for body in ("crank", "rod", "slider")}))


@pytest.mark.parametrize(
    ("arguments", "key"),
    [({"duration": 0.0}, "duration"), ({"duration": math.nan}, "duration"), ({"rows": 0}, "rows"), ({"speed": 1e9}, "speed"),
     ({"flywheel": -1.0}, "flywheel")],
)  # fmt: skip
def test_arguments_out_of_range(arguments, key):
    with pytest.raises(optlink.InputError) as error:
        optlink.simulate(slider_crank(), **arguments)
    assert error.value.faults[0].key == key


# --- flywheel ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("torque", "mass"), [(1e30, 1e-130), (1e30, 1e-290), (-1e30, 1e-290)])
def test_acceleration_whose_square_overflows_stalls_the_run(torque, mass):
    masses = {f"bodies.{body}.mass": f"{mass} kg" for body in ("crank", "rod", "slider")}
    result = optlink.simulate(optlink.load("slider-crank", {"drive.torque": f"{torque} N*m", **masses}), 1.0, 10)
    assert result.ending is Ending.STALLED
    assert result.stopped < 1e-70


def test_flywheel_keeps_the_fluctuation_in_the_simulation():
    """The flywheel from the energy equation, then simulated under the constant mean torque from the right start speed."""
    problem = optlink.load("six-bar").override({"loads.process.acts": "opposing", "loads.process.direction": None})
    machine = machine_of(problem)
    wheel = flywheel(machine, 10.0, 0.05, math.radians(62.0))
    assert wheel.inertia > 0.0
    assert not wheel.fluctuation <= 0.05  # it would come to rest
    assert wheel.mean_torque == pytest.approx(747.808316959 / TURN, rel=1e-9)
    start = Fluctuation(machine, 10.0, math.radians(62.0)).speeds(wheel.inertia)[0]
    driven = problem.override({"drive.torque": f"{wheel.mean_torque!r} N*m", "drive.initial_speed": f"{float(start)!r} rad/s"})
    result = optlink.simulate(driven, duration=0.7, rows=4000, flywheel=wheel.inertia)
    assert result.figures["last_turn.fluctuation"] == pytest.approx(0.05, rel=2e-3)  # the mean is over time there
    turns = np.abs(result["crank.angle_rad"] - math.radians(62.0) - TURN)
    assert result["crank.omega_rad_s"][np.argmin(turns)] == pytest.approx(start, rel=1e-4)  # periodic


@pytest.mark.parametrize("rows", [7, 400])
def test_last_revolution_is_measured_between_the_rows_of_the_table(rows):
    """A pendulum that turns over: speed and period from the energy integral."""
    w0, g = 12.0, 3.0 * 9.81 / (2.0 * 0.5)  # uniform bar of 0.5 m on its end, started horizontally: w^2 = w0^2 - 2 g sin(phi)
    problem = crank_alone(gravity="9.81 m/s^2").override({"drive.initial_speed": f"{w0} rad/s"})
    computed = optlink.simulate(problem, rows=rows).figures
    fastest, slowest = math.sqrt(w0**2 + 2.0 * g), math.sqrt(w0**2 - 2.0 * g)
    period = quad(lambda phi: 1.0 / math.sqrt(w0**2 - 2.0 * g * math.sin(phi)), 0.0, TURN)[0]
    assert computed["last_turn.mean_speed_rad_s"] == pytest.approx(TURN / period, rel=1e-6)
    assert computed["last_turn.fluctuation"] == pytest.approx((fastest - slowest) * period / TURN, rel=1e-4)


@pytest.mark.slow
def test_machine_that_runs_evenly_needs_no_flywheel():
    machine = machine_of(slider_crank())
    assert flywheel(machine, 10.0, 1.9).inertia == 0.0
    assert flywheel(machine, 10.0, 0.01).inertia > flywheel(machine, 10.0, 0.1).inertia > 0.0


def test_analysis_includes_the_flywheel():
    result = optlink.analyze(optlink.load("six-bar").override({"drive.fluctuation": 0.02}), points=12)
    assert result.flywheel is not None
    assert result.to_dict()["flywheel"]["inertia"] == pytest.approx(result.flywheel.inertia)


@pytest.mark.slow
def test_mean_speed_states_whether_it_is_over_angle_or_time(tmp_path):
    """A revolution at uneven speed has two means: that of the flywheel is over the angle, that of a simulation over time."""

    def lines(*arguments):
        return " ".join(CliRunner().invoke(app, list(arguments)).stdout.split())

    fluctuating = ("--set", "drive.fluctuation=0.3")
    assert "mean speed 10 rad/s, mean over crank angle, not time" in lines("analyze", "six-bar", *fluctuating)
    result = optlink.analyze(optlink.load("six-bar").override({"drive.fluctuation": 0.3}), points=12)
    assert result.to_dict()["flywheel"]["mean_speed_over"] == "crank angle"
    assert result.flywheel is not None
    speed = Fluctuation(result.machine, 10.0, result.low).speeds(result.flywheel.inertia)
    turned = np.mean(speed), 1.0 / np.mean(1.0 / speed)  # at evenly spaced angles: over the angle, over time
    assert turned[0] == pytest.approx(result.flywheel.mean_speed, rel=1e-6)
    assert turned[1] < 0.995 * turned[0]
    rows = tmp_path / "rows.csv"
    drive = (
        "--torque",
        "119 N*m",
        "--flywheel",
        "8 kg*m^2",
        "--set",
        "drive.initial_speed=12 rad/s",
        "--duration",
        "1.5 s",
        "--points",
        "3000",
        "--csv",
        str(rows),
    )
    shown = lines("simulate", "six-bar", *drive)
    time, angle = np.genfromtxt(rows, delimiter=",", skip_header=1, usecols=(0, 1)).T
    begin = np.interp(angle[-1] - 360.0, angle, time)
    mean = float(shown.split("last turn: mean speed ")[1].split()[0])
    assert mean == pytest.approx(TURN / (time[-1] - begin), rel=2e-3)
    assert "rad/s, mean over time" in shown


SPEEDS = [
    ({"speed": "25 rad/s"}, None, 25.0),  # of the file, under a torque of the command line or the file
    ({"speed": "25 rad/s"}, -8.0, -8.0),
    ({"speed": "25 rad/s", "initial_speed": "3 rad/s"}, None, 3.0),
    ({"speed": "25 rad/s", "initial_speed": "0 rad/s"}, None, 0.0),
    ({"speed": "25 rad/s", "initial_speed": "3 rad/s"}, 8.0, 8.0),
    ({"initial_speed": "3 rad/s"}, None, 3.0),
    ({}, None, 0.0),
    ({}, 8.0, 8.0),
]


@pytest.mark.parametrize(("drive", "speed", "expected"), SPEEDS)
@pytest.mark.parametrize("torque", ["5 N*m", {"expression": "5 - 0.1*omega", "unit": "N*m"}])
def test_one_speed_at_the_start_under_a_torque(torque, drive, speed, expected):
    problem = optlink.load("six-bar", {"drive": {**drive, "torque": torque}})
    run = optlink.simulate(problem, duration=1e-3, rows=1, speed=speed)
    assert run[f"{run.machine.mechanism.crank.body}.omega_rad_s"][0] == expected
    gaps = optlink.load("slider-crank-clearance", {"drive": {**drive, "torque": torque}, "control": None})
    assert _setting(gaps, 12, speed, "none", None, None, 0.0).speed == expected
