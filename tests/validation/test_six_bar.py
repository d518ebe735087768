"""Independently computed numbers of the RRR-RRP six-bar, and the faults of the tutorial that it comes from.

The case is a Simulink tutorial on modelling linkages by Assur groups: a crank, two links, and a slider on a guide through both
pivots, with a constant force of 1000 N. The reference table holds every quantity each 15 degrees, from Newton-Euler equations in
40 digits; virtual power agrees with them to 5e-41, an independent multibody code to 2.4e-6. Printed to 15 digits, so columns are
held to 1e-9 of their largest value: all that double precision could spoil in a well-conditioned linkage, a thousand times over.

The single numbers were noted with six to twelve digits, hence 1e-6 (relative) on them, unless a test says otherwise.
"""

from __future__ import annotations

import csv
import json
import math
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import optlink
from optlink.cli.app import app
from optlink.dynamics.inverse import reactions, required_wrench
from optlink.dynamics.machine import Wrench
from optlink.tasks.analyze import Analysis, analyze

TABLE = Path(__file__).resolve().parent.parent / "data" / "six_bar_15deg.csv"
STEP = math.radians(15.0)
SPEED, LOAD, GRAVITY = 10.0, 1000.0, 9.8
STROKE = 0.3739041584796

# Column of the table -> column of the analysis. Signs agree throughout: A, D and F frame on body, B crank on link 2, E slider on
# link 5, and the pin at C on links 2 and 5 (on link 3 it exerts minus the sum of both).
COLUMNS = {
    "theta1_deg": "crank_angle_deg",
    "theta1": "crank.angle_rad",
    "theta2": "link2.angle_rad",
    "theta3": "link3.angle_rad",
    "theta5": "link5.angle_rad",
    "omega2": "link2.omega_rad_s",
    "omega3": "link3.omega_rad_s",
    "omega5": "link5.omega_rad_s",
    "alpha2": "link2.alpha_rad_s2",
    "alpha3": "link3.alpha_rad_s2",
    "alpha5": "link5.alpha_rad_s2",
    "xC": "C.x_m",
    "yC": "C.y_m",
    "xE": "E.x_m",
    "s": "slider.s_m",
    "ds": "slider.v_m_s",
    "dds": "slider.a_m_s2",
    "RxA": "A.fx_N",
    "RyA": "A.fy_N",
    "RxB": "B.fx_N",
    "RyB": "B.fy_N",
    "RxC2": "C.link2.fx_N",
    "RyC2": "C.link2.fy_N",
    "RxC5": "C.link5.fx_N",
    "RyC5": "C.link5.fy_N",
    "RxD": "D.fx_N",
    "RyD": "D.fy_N",
    "RxE": "E.fx_N",
    "RyE": "E.fy_N",
    "RF": "F.normal_N",
    "M1": "input.torque_Nm",
    "T": "energy.kinetic_J",
    "V": "energy.potential_J",
    "W": "input.work_J",
    "gam": "C.transmission_rad",
}


def read_csv(path: Path) -> dict[str, np.ndarray]:
    with path.open(encoding="utf-8", newline="") as file:
        head, *rows = csv.reader(file)
    return dict(zip(head, np.array(rows, dtype=float).T, strict=True))


def by_command(tmp_path: Path, *options: str) -> dict[str, np.ndarray]:
    done = CliRunner().invoke(app, ["analyze", "six-bar", "--csv", str(tmp_path / "table.csv"), *options])
    assert done.exit_code == 0, done.output
    return read_csv(tmp_path / "table.csv")


@pytest.fixture(scope="module")
def problem() -> optlink.ProblemFile:
    return optlink.load("six-bar")


@pytest.fixture(scope="module")
def cycle(problem: optlink.ProblemFile) -> Analysis:
    return analyze(problem, step=STEP)


@pytest.fixture(scope="module")
def fine(problem: optlink.ProblemFile) -> Analysis:
    return analyze(problem, points=720)


# --- the table -------------------------------------------------------------------------------------------------------


def test_every_column_of_the_table_is_compared():
    assert set(read_csv(TABLE)) == set(COLUMNS)


@pytest.mark.parametrize("way", ["call", "command"])
def test_every_column_agrees(way, cycle, tmp_path):
    computed = cycle.columns if way == "call" else by_command(tmp_path, "--step", "15 deg")
    for name, expected in read_csv(TABLE).items():
        assert np.max(np.abs(expected)) > 0.1  # no column is all zero: its largest value is a fair scale
        np.testing.assert_allclose(
            computed[COLUMNS[name]], expected, rtol=0.0, atol=1e-9 * np.max(np.abs(expected)), err_msg=f"{name}: {COLUMNS[name]}"
        )


def test_pin_at_c_is_in_balance(cycle):
    """Link 3 gets minus what links 2 and 5 get; the table leaves it out."""
    table = read_csv(TABLE)
    for axis in "xy":
        on_link3 = -table[f"R{axis}C2"] - table[f"R{axis}C5"]
        np.testing.assert_allclose(cycle[f"C.link3.f{axis}_N"], on_link3, rtol=0.0, atol=1e-9 * 2000.0)


@pytest.mark.parametrize("column", ["slider.v_m_s", "F.normal_N", "input.torque_Nm", "C.link2.fx_N"])
def test_a_planted_deviation_is_found(column, cycle):
    """The tolerance is sharp: a sign, degrees for radians, or one part in a hundred million would not pass."""
    (name,) = (k for k, v in COLUMNS.items() if v == column)
    expected = read_csv(TABLE)[name]
    for spoilt in (-cycle[column], np.degrees(cycle[column]), cycle[column] * (1.0 + 1e-8)):
        assert np.max(np.abs(spoilt - expected)) > 1e-9 * np.max(np.abs(expected))


# --- extremes, strokes, work -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("figure", "expected"),
    [
        ("input.torque_Nm.max", 278.8344391),
        ("input.torque_Nm.min", -320.0521365),
        ("F.normal_N.max", -126.62251),
        ("F.normal_N.min", -1159.270712),
        ("slider.s_m.min", 0.417261753),
        ("slider.s_m.max", 0.791165911),
        ("slider.stroke_m", STROKE),
        ("input.work_J.max", 259.773891),
    ],
)
def test_extremes_and_stroke(cycle, figure, expected):
    assert cycle.figures[figure] == pytest.approx(expected, rel=1e-6)


def test_stroke_has_every_digit(cycle):
    assert cycle.strokes["slider"].span == pytest.approx(STROKE, rel=1e-12)


@pytest.mark.parametrize(
    ("name", "least_deg", "largest_deg"),
    [("input.torque_Nm", 356.3080, 67.0206), ("input.work_J", 28.849, 156.2980)],
)
def test_where_the_extremes_are_met(cycle, name, least_deg, largest_deg):
    """Angles were noted to 1e-3 degrees, those of the work from samples."""
    result = cycle.extremes[name]
    assert math.degrees(result.least_at) % 360.0 == pytest.approx(least_deg, abs=1e-3)
    assert math.degrees(result.largest_at) % 360.0 == pytest.approx(largest_deg, abs=1e-3)


def energy_route(result: Analysis, angle: float) -> float:
    """Work of the drive since the start [J] without its torque: gain of kinetic and potential energy, less what the force did."""
    moving = result.machine.moving(np.array([math.radians(62.0), angle]), result.speed)
    gain = np.diff(moving.kinetic)[0] + np.diff(moving.potential)[0]
    return float(gain - LOAD * np.diff(moving.slides["F"][0])[0])


@pytest.mark.parametrize("which", ["least", "largest"])
def test_extremes_of_work_by_the_energies(cycle, which):
    """The least work of -101.926927 J in the reference is a sampled one. The exact extreme lies 1.4e-4 J lower."""
    result = cycle.extremes["input.work_J"]
    angle = getattr(result, f"{which}_at")
    assert getattr(result, which) == pytest.approx(energy_route(cycle, angle), abs=1e-9)
    around = [energy_route(cycle, angle + shift) for shift in (-1e-4, 1e-4)]
    assert min(around) > result.least if which == "least" else max(around) < result.largest


def test_least_work_against_the_sampled_one(cycle):
    """-101.92706497 J exactly, -101.926927 J sampled: apart by 5e-7 of the largest work, hence 1e-6 of that on the latter."""
    result = cycle.extremes["input.work_J"]
    assert result.least == pytest.approx(-101.92706497, abs=1e-8)
    assert result.least == pytest.approx(-101.926927, abs=1e-6 * result.largest)
    assert result.least < -101.926927


def test_work_after_one_second(problem):
    """10 rad/s for 1 s: a revolution, whose work is zero, and 10 - 2 pi rad more. Noted as 225.033, cut off: 1e-3."""
    computed = analyze(problem, step=10.0 - 2.0 * math.pi)
    assert computed["input.work_J"][1] == pytest.approx(
        energy_route(computed, math.radians(computed["crank_angle_deg"][1])), abs=1e-9
    )
    assert computed["input.work_J"][1] == pytest.approx(225.033, abs=1e-3)


def test_a_constant_force_does_no_work_in_a_revolution(cycle):
    assert cycle.work == pytest.approx(0.0, abs=1e-10)
    assert cycle["input.work_J"][-1] == pytest.approx(0.0, abs=1e-10)


def test_an_opposing_force_does(problem):
    """Twice the force times the stroke; from the command line."""
    options = ["--set", "loads.process.acts=opposing", "--json"]
    document = json.loads(CliRunner().invoke(app, ["analyze", "six-bar", *options]).stdout)
    assert document["work_J"] == pytest.approx(747.808316959, rel=1e-11)
    assert document["work_J"] == pytest.approx(2.0 * LOAD * document["strokes"]["slider"]["span_m"], rel=1e-12)
    jumps = [angle % 360.0 for angle in document["load_jumps_deg"]]
    assert sorted(jumps) == pytest.approx(sorted(a % 360.0 for a in document["strokes"]["slider"]["dead_centres_deg"]), abs=1e-9)


def test_an_opposing_force_jumps_by_twice_its_size(problem):
    """At a reversal of the slider the force turns round; no velocity, so no power and no torque is lost in that."""
    result = analyze(problem.override({"loads.process.acts": "opposing"}))
    before, after = (reactions(result.machine.moving(result.jumps, SPEED, side=side)) for side in (-1, 1))
    pull = after.pins["E"]["slider"][0] - before.pins["E"]["slider"][0]
    assert np.abs(pull) == pytest.approx([2.0 * LOAD] * 2, rel=1e-12)
    assert after.torque == pytest.approx(before.torque, abs=1e-9)


# --- balances that use neither dyads nor the package's inertia ---------------------------------------------------------

BODIES = {  # mass [kg], moment of inertia about the centroid [kg m^2], ends (centroid half-way)
    "crank": (1.2, 0.016, "A", "B"),
    "link2": (3.0, 0.25, "B", "C"),
    "link3": (2.2, 0.09, "D", "C"),
    "link5": (3.6, 0.45, "C", "E"),
    "slider": (6.0, 0.0, "E", "E"),
}


def point(computed: Analysis, name: str, kind: str) -> np.ndarray:
    """Velocity ("v") or acceleration ("a") of a point from its columns, (2, positions)."""
    if name in "AD":
        return np.zeros((2, len(computed["time_s"])))
    unit = {"v": "m_s", "a": "m_s2"}[kind]
    return np.array([computed[f"{name}.{kind}{axis}_{unit}"] for axis in "xy"])


def centroid(computed: Analysis, body: str, kind: str) -> np.ndarray:
    _, _, start, end = BODIES[body]
    return (point(computed, start, kind) + point(computed, end, kind)) / 2.0


def rate_of_energy(computed: Analysis) -> np.ndarray:
    """d/dt of kinetic and potential energy [W], body by body."""
    total = np.zeros_like(computed["time_s"])
    for body, (mass, inertia, _, _) in BODIES.items():
        v, a = centroid(computed, body, "v"), centroid(computed, body, "a")
        total += mass * (v * a).sum(axis=0) + mass * GRAVITY * v[1]
        total += inertia * computed[f"{body}.omega_rad_s"] * computed[f"{body}.alpha_rad_s2"]
    return total


def unbalanced_power(computed: Analysis, torque: np.ndarray) -> np.ndarray:
    """What a driving torque feeds in beyond what the energies take up and the load gives [W]."""
    return SPEED * torque + LOAD * computed["slider.v_m_s"] - rate_of_energy(computed)


def test_power_balance_at_each_position(fine):
    """Relative to the largest power, 3.2 kW: rounding alone is left."""
    assert np.max(np.abs(unbalanced_power(fine, fine["input.torque_Nm"]))) < 1e-11 * 3200.0
    split = sum(fine[f"input.torque_{part}_Nm"] for part in ("inertia", "gravity", "load"))
    np.testing.assert_allclose(split, fine["input.torque_Nm"], rtol=0.0, atol=1e-11 * 320.0)


def unbalanced_force(computed: Analysis, axis: str, guide: np.ndarray) -> np.ndarray:
    """Reactions of the frame, weight and load, less mass times acceleration, for the whole machine [N]."""
    k = "xy".index(axis)
    total = computed[f"A.f{axis}_N"] + computed[f"D.f{axis}_N"] + (LOAD if axis == "x" else guide)
    for body, (mass, *_) in BODIES.items():
        total = total - mass * (centroid(computed, body, "a")[k] + (GRAVITY if axis == "y" else 0.0))
    return total


def test_whole_machine_is_in_balance(fine):
    """Relative to the largest reaction, 2.1 kN."""
    for axis in "xy":
        assert np.max(np.abs(unbalanced_force(fine, axis, fine["F.normal_N"]))) < 1e-11 * 2100.0


# --- faults of the source ----------------------------------------------------------------------------------------------


def test_source_guide_force_is_1000_n_off(problem, fine):
    """The source lets the horizontal load into the vertical equation of the slider.

    With the toolkit: a further load of 1000 N across the guide changes the guide force by 1000 N at every position and nothing
    else at all, so that no torque and no work would tell. The vertical balance of the whole machine does.
    """
    stray = {"on": "slider", "force": "1000 N", "direction": "90 deg"}
    source = analyze(problem.override({"loads.stray": stray}), points=720)
    np.testing.assert_allclose(fine["F.normal_N"] - source["F.normal_N"], 1000.0, rtol=1e-12)
    for name, values in fine.columns.items():
        if name != "F.normal_N":
            np.testing.assert_allclose(
                source[name], values, rtol=0.0, atol=1e-10 * max(1.0, np.max(np.abs(values))), err_msg=name
            )
    np.testing.assert_allclose(np.abs(unbalanced_force(fine, "y", source["F.normal_N"])), 1000.0, rtol=1e-11)


SOURCE_THETA5 = math.radians(-41.0)


def test_source_start_angle_puts_the_slider_off_its_guide(cycle):
    """theta5 = -41 degrees, given for the start; consistent is -40.366 degrees. It is not rounding: E lies 10 mm off."""
    assert math.degrees(cycle["link5.angle_rad"][0]) == pytest.approx(-40.366039, abs=1e-6)
    off = cycle["C.y_m"][0] + 1.2 * math.sin(SOURCE_THETA5)
    assert off == pytest.approx(-0.010069, abs=1e-6)
    assert cycle["C.y_m"][0] + 1.2 * math.sin(cycle["link5.angle_rad"][0]) == pytest.approx(0.0, abs=1e-15)


def test_source_start_velocity_of_the_slider_has_a_wrong_sign(problem, cycle):
    """-3.1323 m/s, given for the start, is the velocity of E with link 5's share subtracted, and at theta5 = -41 degrees.

    Five digits are printed, and the source rounded on its way: 2e-4. With the right sign -2.036 m/s comes out even of that angle;
    the slope of the slide itself is -2.048 m/s.
    """
    theta3, omega3 = cycle["link3.angle_rad"][0], cycle["link3.omega_rad_s"][0]
    link3 = -0.8 * omega3 * math.sin(theta3)
    omega5 = -0.8 * omega3 * math.cos(theta3) / (1.2 * math.cos(SOURCE_THETA5))
    link5 = -1.2 * omega5 * math.sin(SOURCE_THETA5)
    assert link3 - link5 == pytest.approx(-3.1323, abs=2e-4)
    assert link3 + link5 == pytest.approx(-2.0362, abs=1e-4)
    assert cycle["slider.v_m_s"][0] == pytest.approx(-2.04833996839, rel=1e-11)
    step, start = 1e-4, math.radians(62.0)
    s = cycle.machine.moving(np.array([start - step, start + step]), SPEED).slides["F"][0]
    assert (s[1] - s[0]) / (2.0 * step) * SPEED == pytest.approx(-2.04833996839, abs=1e-6)  # second order in the step


def without_moment(problem: optlink.ProblemFile, whole: Analysis, at: float) -> np.ndarray:
    """Driving torque where link 3 takes the pin force of link 5 at a point between D (0) and C (1)."""
    bodies = {name: problem.raw["bodies"][name] for name in ("crank", "link2", "link3")}
    machine = analyze(problem.override({"bodies": bodies, "loads": {}})).machine  # the slider idles along, without mass
    moving = machine.moving(np.radians(whole["crank_angle_deg"]), SPEED)
    needed = required_wrench(moving)
    x, y = whole["C.link5.fx_N"], whole["C.link5.fy_N"]  # on link 5; what the joints must give link 3 in addition
    lever = at * (whole["C.x_m"] - 1.5), at * whole["C.y_m"]
    needed["link3"] = needed["link3"] + Wrench((x, y), lever[0] * y - lever[1] * x)
    return np.asarray(reactions(moving, needed).torque)


def test_dropping_the_moment_at_c_makes_the_torque_46_percent_wrong(problem, fine):
    """The force that link 5 exerts at C must reach the centroid of link 3 together with its moment.

    Without it the group of link 5 and the slider costs half of its torque, as the centroid moves half as fast as C. The work per
    revolution of that half is zero as well and tells nothing; the power balance at each position tells.
    """
    torque = fine["input.torque_Nm"]
    largest = np.max(np.abs(torque))
    np.testing.assert_allclose(without_moment(problem, fine, 1.0), torque, rtol=0.0, atol=1e-11 * largest)  # nothing dropped
    wrong = without_moment(problem, fine, 0.5)
    assert np.max(np.abs(wrong - torque)) / largest == pytest.approx(0.46, abs=0.005)
    assert wrong[0] == pytest.approx(150.6915, abs=1e-4)
    assert np.mean(wrong[:-1]) * 2.0 * math.pi == pytest.approx(0.0, abs=1e-9)  # J per revolution; periodic: a sum is exact
    assert np.mean(torque[:-1]) * 2.0 * math.pi == pytest.approx(0.0, abs=1e-9)
    missing = np.abs(unbalanced_power(fine, wrong))
    assert np.max(missing) > 1400.0  # W, of 3200
    assert np.mean(missing > 100.0) > 0.8  # and at most positions
