"""Machines whose drive has a range: everything counts over it, and nothing outside."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from numpy.polynomial.legendre import leggauss

import optlink
from optlink.errors import InputError
from optlink.problem.terms import read_words
from tests.cli.test_cli import run
from tests.tiers import mostly_slow

STRUT = """
title = "Gas strut"
gravity = "9.81 m/s^2"
[mechanism.ground]
H = ["0 m", "0 m"]
S = [{ start = "0.1 m", bounds = ["0 m", "0.4 m"] }, { start = "-0.3 m", bounds = ["-0.5 m", "-0.1 m"] }]
[mechanism.links]
lid = { joints = ["H", "E"], length = "0.8 m", points = { M = [{ start = "0.2 m", bounds = ["0.05 m", "0.5 m"] }, "0 m"] } }
tube = { joints = ["S"] }
rod = { joints = ["M"] }
[mechanism.guides]
strut = { slider = "rod", on = "tube", through = "S" }
[mechanism.assembly]
strut = "forward"
[bodies]
lid = { mass = "20 kg", centroid = ["0.4 m", "0 m"], inertia = "1 kg*m^2" }
[loads]
gas = { on = "rod", force = "350 N", against = "tube" }
[drive]
body = "lid"
range = ["0 deg", "90 deg"]
speed = "static"
[objective]
quantity = "torque"
measure = "rms"
"""
LIFT = """
title = "Lift"
gravity = "9.81 m/s^2"
[mechanism.ground]
O = ["0 m", "0 m"]
G = [{ start = "0.5 m", bounds = ["0.1 m", "1.2 m"] }, { start = "-0.5 m", bounds = ["-1.0 m", "-0.2 m"] }]
[mechanism.links]
boom = { joints = ["O", "E"], length = "3 m", points = { M = [{ start = "0.9 m", bounds = ["0.3 m", "2 m"] }, "-0.1 m"] } }
[mechanism.cylinders]
lift = { joints = ["G", "M"], closed = "0.8 m", open = "1.3 m" }
[mechanism.assembly]
M = "left of O-G"
[bodies]
boom = { mass = "120 kg", centroid = ["1.5 m", "0 m"], inertia = "90 kg*m^2" }
[loads]
hook = { on = "boom", at = "E", force = "5000 N", direction = "-90 deg" }
[drive]
cylinder = "lift"
speed = "static"
[objective]
quantity = "drive force"
[limits]
swing = { quantity = "stroke", of = "boom", min = "50 deg" }
top = { quantity = "end", of = "E", direction = "90 deg", stroke = "forward", min = "1.8 m" }
"""
CRANK_ROCKER = """
title = "Crank-rocker"
gravity = "9.81 m/s^2"
[mechanism]
type = "four-bar"
assembly = "left"
crank = { start = "0.1 m", bounds = ["0.05 m", "0.15 m"] }
coupler = "0.4 m"
rocker = "0.3 m"
frame = "0.4 m"
[bodies]
rocker = { mass = "2 kg", inertia = "0.02 kg*m^2" }
[loads]
spring = { on = "rocker", torsional_stiffness = "3 N*m/rad", free_angle = "90 deg" }
[drive]
range = ["20 deg", "200 deg"]
speed = "static"
[objective]
quantity = "torque"
measure = "peak"
[limits]
swing = { quantity = "stroke", of = "rocker", min = "25 deg" }
"""


def problem(tmp_path, text, **changes):
    path = tmp_path / "problem.toml"
    path.write_text(text, encoding="utf-8")
    return optlink.load(path, changes) if changes else optlink.load(path)


def strut_torque(design, phi):
    """Torque on the lid [N m] by the lever arm of the strut's line."""
    x, y, m = design["S.x"], design["S.y"], design["lid.M.along"]
    along, across = m * np.cos(phi) - x, m * np.sin(phi) - y
    lever = m * (np.cos(phi) * across - np.sin(phi) * along) / np.hypot(along, across)
    return 20 * 9.81 * 0.4 * np.cos(phi) - 350 * lever


@pytest.mark.parametrize("backend", ["ipopt", "slsqp"])
def test_gas_strut_is_the_global_optimum_over_the_range(tmp_path, backend):
    """The rms torque over 0 ... 90 deg is that of SciPy's differential evolution of a Gauss quadrature, 3.17602899 N m."""
    result = optlink.solve(problem(tmp_path, STRUT), backend=backend)
    best = result.best
    assert result.valid
    assert best.objective == pytest.approx(3.176028992767, rel=1e-7)
    nodes, weights = leggauss(60)
    torque = strut_torque(best.design, 0.25 * math.pi * (nodes + 1.0))
    assert math.sqrt(0.5 * float(weights @ torque**2)) == pytest.approx(best.objective, rel=1e-7)
    assert best.design["S.y"] == pytest.approx(-0.5)
    assert best.design["lid.M.along"] == pytest.approx(0.266559, abs=1e-5)
    assert [check.name for check in best.validation.checks if "fully" in check.name] == []
    assert "the linkage closes throughout the range" in [check.name for check in best.validation.checks]


def lift_forces(design):
    """Angle of the boom [rad] and force of the cylinder [N] over its length, by the cosine rule and virtual power."""
    s, (x, y, m) = np.linspace(0.8, 1.3, 401), design
    g, arm = math.hypot(x, y), math.hypot(m, 0.1)
    with np.errstate(invalid="ignore"):
        enclosed = np.arccos((g * g + arm * arm - s * s) / (2.0 * g * arm))
    angle = math.atan2(y, x) + enclosed - math.atan2(-0.1, m)
    return angle, (120 * 9.81 * 1.5 + 5000 * 3) * np.cos(angle) * s / (g * arm * np.sin(enclosed))


@pytest.mark.parametrize("backend", mostly_slow(["ipopt", "slsqp"], "ipopt"))
def test_lift_has_the_least_peak_force(tmp_path, backend):
    """It is that of SciPy's differential evolution with these formulas (three seeds), at G (789.279, -200) mm, M 708.417 mm."""
    result = optlink.solve(problem(tmp_path, LIFT), backend=backend)
    assert result.valid
    assert result.best.objective == pytest.approx(14308.2695625, rel=1e-6)
    design = result.best.design
    angle, force = lift_forces([design["G.x"], design["G.y"], design["boom.M.along"]])
    assert float(np.max(np.abs(force))) == pytest.approx(result.best.objective, rel=1e-6)
    figures = {figure.words: figure.result for figure in result.best.figures}
    assert figures["stroke of boom"] == pytest.approx(math.degrees(float(np.ptp(angle))), rel=1e-6)


@pytest.mark.slow
def test_lift_has_the_least_power(tmp_path):
    """At constant speed the power of the weights is the force times the speed: the same design, and 50 mm/s of its force."""
    power = {"objective.quantity": "power", "objective.static": True}
    result = optlink.solve(problem(tmp_path, LIFT, **power, **{"drive.speed": "50 mm/s"}))
    assert result.valid
    assert result.best.objective == pytest.approx(0.05 * 14308.2695625, rel=1e-6)
    assert [figure.unit for figure in result.best.figures if figure.words == "peak static power"] == ["W"]
    with pytest.raises(InputError, match="a static drive has no power"):
        problem(tmp_path, LIFT, **power)


@pytest.mark.slow
def test_four_bar_that_need_not_turn_is_designed_over_its_range(tmp_path):
    """Extremes lie within the range, at its ends too; outside it the linkage may do anything."""
    file = problem(tmp_path, CRANK_ROCKER)
    result = optlink.solve(file)
    crank = result.best.design["crank"]
    phi = np.linspace(math.radians(20), math.radians(200), 20001)

    def rocker(r):
        x, y = r * np.cos(phi) - 0.4, r * np.sin(phi)
        d = np.hypot(x, y)
        return np.arctan2(y, x) - np.arccos((d * d + 0.3**2 - 0.4**2) / (2 * d * 0.3))

    psi = np.unwrap(rocker(crank))
    slope = np.gradient(psi, phi)
    weight = 2 * 9.81 * 0.15 * np.cos(psi)
    torque = (weight + 3.0 * (psi - math.radians(90))) * slope
    assert result.valid
    assert float(np.max(np.abs(torque))) == pytest.approx(result.best.objective, rel=1e-4)
    assert np.degrees(np.ptp(psi)) == pytest.approx(25.0, abs=1e-4)  # the limit is active
    least = min((float(np.ptp(np.unwrap(rocker(r)))), r) for r in np.linspace(0.05, 0.15, 2001) if np.all(np.isfinite(rocker(r))))
    assert least[0] < math.radians(25.0)


@pytest.mark.parametrize(
    ("text", "key", "value", "part"),
    [
        (LIFT, "objective.quantity", "torque", "a slide or cylinder drives, not a crank"),
        (STRUT, "objective.quantity", "drive force", "no slide and no cylinder drives"),
        (STRUT, "limits.r", {"quantity": "time ratio", "of": "rod", "min": 1.2}, "the drive has a range"),
        (STRUT, "limits.w", {"quantity": "work", "of": "rod", "stroke": "forward", "max": "1 J"}, "the drive has a range"),
        (STRUT, "loads.gas.stroke", "slow", "slow and quick are strokes of a crank that turns fully"),
        (LIFT, "drive.speed", "0.1 m/s", ""),
    ],
)
def test_what_has_no_meaning_over_a_range_is_refused(tmp_path, text, key, value, part):
    changes = {key: value}
    if not part:
        changes |= {"mechanism.cylinders.lift.open": {"start": "1.3 m", "bounds": ["1.2 m", "1.5 m"]}}
        part = "the stroke of the cylinder is a design variable"
    with pytest.raises(InputError, match=part):
        problem(tmp_path, text, **changes)


DAMPED_LID = """
title = "Damped lid"
gravity = "9.81 m/s^2"
[mechanism.ground]
H = ["0 m", "0 m"]
[mechanism.links]
lid = { joints = ["H", "E"], length = "1.2 m" }
[bodies]
lid = { mass = "50 kg", centroid = ["0.8 m", "0 m"], inertia = "6 kg*m^2" }
[loads]
damper = { on = "lid", torsional_damping = "20 N*m*s/rad" }
[drive]
body = "lid"
range = ["0 deg", "90 deg"]
speed = "0.5 rad/s"
"""


def test_the_way_back_is_told_where_forces_differ(tmp_path):
    """The weight of 392.4 N m and the damper of 10 N m add on the way up and are subtracted on the way down."""
    result = optlink.analyze(problem(tmp_path, DAMPED_LID))
    extreme = result.extremes["input.torque_Nm"]
    assert (extreme.least, extreme.largest) == pytest.approx((-10.0, 402.4))
    assert result.extremes.on_way_back("input.torque_Nm") == (True, False)
    assert min(result["input.torque_Nm"]) == pytest.approx(10.0)
    assert result.extremes.on_way_back("lid.omega_rad_s") == (False, False)
    power = result.extremes["input.power_W"]
    assert (power.least, power.largest) == pytest.approx((-0.5 * 382.4, 0.5 * 402.4))
    assert "min_on_way_back" in result.to_dict()["extremes"]["input.torque_Nm"]
    assert result.work == pytest.approx(392.4 + 5.0 * math.pi)
    assert "between -10 and 382.4 N m, and its work is -376.69 J" in result.notes[-1]
    still = optlink.analyze(problem(tmp_path, DAMPED_LID.replace("20 N*m", "0 N*m")))
    assert not still.notes
    assert tuple(still.extremes["input.power_W"])[::2] == pytest.approx((-0.5 * 392.4, 0.5 * 392.4))


BUFFER = """
title = "Flap with a strut that damps"
gravity = "9.81 m/s^2"
[mechanism.ground]
H = ["0 m", "0 m"]
S = ["0.1 m", { start = "-0.3 m", bounds = ["-0.5 m", "-0.1 m"] }]
[mechanism.links]
lid = { joints = ["H", "E"], length = "0.8 m", points = { M = [{ start = "0.2 m", bounds = ["0.1 m", "0.5 m"] }, "0 m"] } }
tube = { joints = ["S"] }
rod = { joints = ["M"] }
[mechanism.guides]
strut = { slider = "rod", on = "tube", through = "S" }
[mechanism.assembly]
strut = "forward"
[bodies]
lid = { mass = "20 kg", centroid = ["0.4 m", "0 m"], inertia = "0 kg*m^2" }
[loads]
gas = { on = "rod", force = "350 N", against = "tube" }
oil = { on = "rod", damping = "900 N*s/m" }
[drive]
body = "lid"
range = ["0 deg", "80 deg"]
speed = "0.8 rad/s"
[objective]
quantity = "torque"
[limits]
pull = { quantity = "torque", measure = "least", min = "-45 N*m" }
hinge = { quantity = "reaction", of = "H", max = "450 N" }
"""


def strut_forces(y, m, way):
    """Torque of the hand and force at the hinge on one way, by the equilibrium of the lid with the weight and the strut."""
    phi = np.radians(np.linspace(0.0, 80.0, 4001))
    e = np.exp(1j * phi)
    line = m * e - (0.1 + 1j * y)
    length = np.abs(line)
    rate = way * 0.8 * np.real(1j * m * e * np.conj(line)) / length
    push = (350.0 - 900.0 * rate) * line / length
    inward = -20.0 * 0.4 * 0.8**2 * e  # mass times the acceleration of the centroid
    torque = np.imag(np.conj(0.4 * e) * (inward + 20.0 * 9.81j)) - np.imag(np.conj(m * e) * push)
    return torque, np.abs(inward + 20.0 * 9.81j - push)


@pytest.mark.parametrize(("backend", "pull"), [pytest.param("ipopt", 45.0, marks=pytest.mark.slow), ("slsqp", 30.0)])
def test_largest_efforts_are_those_of_both_ways(tmp_path, backend, pull):
    """A strut that damps: no design of a grid is better by own formulas on the way there and back."""
    result = optlink.solve(problem(tmp_path, BUFFER, **{"limits.pull.min": f"{-pull} N*m"}), backend=backend, starts=4)

    def both(y, m):
        ways = [strut_forces(y, m, way) for way in (1.0, -1.0)]
        peaks = [float(np.max(np.abs(torque))) for torque, _ in ways]
        slack = min(float(np.min(torque)) for torque, _ in ways) + pull, 450.0 - max(float(np.max(hinge)) for _, hinge in ways)
        return peaks, min(slack)

    design = result.best.design
    peaks, slack = both(design["S.y"], design["lid.M.along"])
    assert result.valid
    assert max(peaks) == pytest.approx(result.best.objective, rel=1e-6)
    assert abs(peaks[0] - peaks[1]) < 1e-5 if pull == 45.0 else abs(slack) < 1e-5  # both ways are as hard, or a limit holds
    assert slack > -1e-5
    grid = [both(y, m) for y in np.linspace(-0.5, -0.1, 41) for m in np.linspace(0.1, 0.5, 41)]
    assert result.best.objective <= min(max(values) for values, left in grid if left > -1e-9)
    words = {figure.words for figure in result.best.figures}
    assert "peak reaction at H on the way back" in words


def test_batches_motions_and_sensitivities_keep_to_the_range(tmp_path):
    file = problem(tmp_path, STRUT)
    arms = np.array([0.2, 0.26])
    torque = optlink.analyze_batch(file, {"lid.M.along": arms}, ["input.torque_Nm"], points=9)["input.torque_Nm"]
    phi = np.radians(np.linspace(0.0, 90.0, 10))
    for row, m in zip(torque, arms, strict=True):
        np.testing.assert_allclose(row, strut_torque({"S.x": 0.1, "S.y": -0.3, "lid.M.along": m}, phi), rtol=1e-9)
    with pytest.raises(InputError, match=r"angle of lid 120 deg lies outside the range of the drive\. .*angle of lid 90 deg"):
        optlink.motion(file, [0.0, math.radians(120.0)])


def test_positions_of_a_cylinder_are_its_lengths(tmp_path):
    file = problem(tmp_path, LIFT)
    result = optlink.analyze(file, points=4)
    assert next(iter(result.columns)) == "cycle_deg"
    np.testing.assert_allclose(result["lift.length_m"], np.linspace(0.8, 1.3, 5), rtol=1e-12)
    _, force = lift_forces([0.5, -0.5, 0.9])
    np.testing.assert_allclose(result["input.force_N"], force[::100], rtol=1e-7)
    assert file.model.driving.text(0.5 * math.pi) == "length of lift 1050 mm"
    with pytest.raises(InputError, match=r"length of lift 1436\.62 mm lies outside the range of the drive"):
        optlink.motion(file, [4.0])
    with pytest.raises(InputError, match=r"at length of lift 1612\.65 mm .* fails to close .* 800 \.\.\. 1612\.65 mm"):
        optlink.analyze(problem(tmp_path, LIFT, **{"mechanism.cylinders.lift.open": "2 m"}))
    np.testing.assert_allclose(optlink.simulate(file, rows=4)["input.force_N"], force[::100], rtol=1e-7)
    sizes, at = file.model.sizes({}), np.array([0.5, 2.5])
    found = optlink.studies.output_sensitivity(file.model.linkage, sizes, at, "boom", ["G.x", "lift.open"])
    for name in ("G.x", "lift.open"):
        ends = [
            optlink.linkage.sweep(file.model.linkage, {**sizes, name: sizes[name] + by}, at).body_angle("boom").value
            for by in (1e-6, -1e-6)
        ]
        np.testing.assert_allclose(found.by[name], (ends[0] - ends[1]) / 2e-6, rtol=1e-6)


LAMP = """
title = "Lamp arm"
gravity = "9.81 m/s^2"
[mechanism.ground]
A = ["0 mm", "0 mm"]
D = ["0 mm", "60 mm"]
S = ["0 mm", "100 mm"]
[mechanism.links]
arm = { joints = ["A", "B"], length = "400 mm", points = { Q = ["80 mm", "0 mm"] } }
head = { joints = ["B", "C"], length = "60 mm", points = { L = ["30 mm", "-120 mm"] } }
upper = { joints = ["D", "C"], length = "400 mm" }
[mechanism.assembly]
C = "right of B-D"
[bodies]
head = { mass = "1.2 kg", centroid = "L", inertia = "0.001 kg*m^2" }
[drive]
body = "arm"
range = ["-60 deg", "60 deg"]
speed = "static"
[balance]
minimise = "peak torque"
[[balance.springs]]
name = "tie"
between = ["S", "Q"]
stiffness = { max = "5000 N/m" }
free_length = "0 mm"
"""


@pytest.mark.parametrize("words", ["peak torque", "peak torque from -30 to 45 deg", "peak torque from 330 to 405 deg"])
def test_lamp_is_balanced_within_its_range(tmp_path, words):
    """A spring of zero free length balances it everywhere: k = m g L / (h r); beyond +-90 deg the parallelogram is singular."""
    result = optlink.balance(problem(tmp_path, LAMP, **{"balance.minimise": words}))
    assert result.springs[0].stiffness == pytest.approx(1.2 * 9.81 * 0.4 / (0.1 * 0.08), rel=1e-6)
    assert not [note for note in result.notes if "turn fully" in note or "between the positions" in note]


def test_a_window_outside_the_range_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"the drive does not move through all of this.* from -60 to 60 deg"):
        optlink.balance(problem(tmp_path, LAMP, **{"balance.minimise": "peak torque from 50 to 120 deg"}))


def test_a_spring_relieves_a_cylinder(tmp_path):
    """The stiffness has the least peak force of the cylinder over its stroke, by the cosine rule and virtual power."""
    text = LIFT.partition("[objective]")[0].replace('O = ["0 m", "0 m"]', 'O = ["0 m", "0 m"]\nP = ["-0.2 m", "1.5 m"]')
    for start, bounds in (("0.5", '"0.1 m", "1.2 m"'), ("-0.5", '"-1.0 m", "-0.2 m"'), ("0.9", '"0.3 m", "2 m"')):
        text = text.replace(f'{{ start = "{start} m", bounds = [{bounds}] }}', f'"{start} m"')
    springs = '[[balance.springs]]\nname = "tie"\nbetween = ["P", "M"]\nstiffness = { max = "20000 N/m" }\nfree_length = "0 mm"\n'
    result = optlink.balance(problem(tmp_path, f'{text}[balance]\nminimise = "peak drive force"\n{springs}'))
    angle, force = lift_forces([0.5, -0.5, 0.9])
    s = np.linspace(0.8, 1.3, len(angle))
    x = 0.9 * np.cos(angle) + 0.1 * np.sin(angle) + 0.2
    y = 0.9 * np.sin(angle) - 0.1 * np.cos(angle) - 1.5
    pull = np.gradient(0.5 * (x**2 + y**2), s, edge_order=2)  # per stiffness
    stiffness = np.linspace(0.0, 20000.0, 20001)
    peaks = np.max(np.abs(force + stiffness[:, None] * pull), axis=1)
    assert result.springs[0].stiffness == pytest.approx(float(stiffness[np.argmin(peaks)]), abs=2.0)
    assert result.columns["length_mm"][[0, -1]] == pytest.approx([800.0, 1300.0])


PRESS = """
title = "Press"
[mechanism.ground]
A = ["0 mm", "0 mm"]
[mechanism.links]
crank = { joints = ["A", "B"], length = "40 mm" }
rod = { joints = ["B", "C"], length = { start = "150 mm", bounds = ["80 mm", "300 mm"] } }
ram = { joints = ["C"] }
[mechanism.guides]
G = { slider = "ram", through = ["0 mm", "0 mm"], offset = { start = "0 mm", bounds = ["-30 mm", "30 mm"] } }
[mechanism.assembly]
C = "forward"
[loads]
cut = { on = "ram", force = "1000 N", acts = "opposing" }
[drive]
range = ["20 deg", "250 deg"]
speed = "10 rad/s"
[objective]
quantity = "torque"
measure = "rms"
[limits]
slide = { quantity = "stroke", of = "ram", min = "79 mm" }
"""


@pytest.mark.slow
def test_a_load_that_switches_within_the_range(tmp_path):
    """The ram reverses once; the torque is 1000 N times the transfer of the ram, of either sense."""
    result = optlink.solve(problem(tmp_path, PRESS))
    phi = np.radians(np.linspace(20.0, 250.0, 40001))

    def figures(rod, offset):
        across = 0.04 * np.sin(phi) - offset
        slide = 0.04 * np.cos(phi) + np.sqrt(rod**2 - across**2)
        transfer = -0.04 * np.sin(phi) - across * 0.04 * np.cos(phi) / np.sqrt(rod**2 - across**2)
        return 1000 * math.sqrt(float(np.trapezoid(transfer**2, phi) / np.ptp(phi))), float(np.ptp(slide))

    design = result.best.design
    own, stroke = figures(design["rod.length"], design["G.offset"])
    assert result.valid
    assert own == pytest.approx(result.best.objective, rel=1e-6)
    assert {figure.words: figure.result for figure in result.best.figures}["stroke of ram"] == pytest.approx(
        1e3 * stroke, rel=1e-6
    )
    others = (figures(rod, e) for rod in np.linspace(0.08, 0.3, 45) for e in np.linspace(-0.03, 0.03, 25))
    assert result.best.objective <= min(rms for rms, reached in others if reached >= 0.079) * (1 + 1e-6)


def test_a_page_of_a_cylinder_is_moved_by_its_length(tmp_path):
    from optlink.presentation.html.moving_linkage import turning

    result = optlink.analyze(problem(tmp_path, LIFT), points=4)
    stops = turning(result, 36).stops
    assert (stops.name, stops.unit) == ("length of lift", " mm")
    np.testing.assert_allclose([stops.values[0], stops.values[-1]], [800.0, 1300.0])


def test_positions_are_called_by_the_drive(tmp_path):
    """Charts, tables and files of a cylinder tell its length; those of a static machine no velocities."""
    from optlink.presentation.registry import view_of
    from optlink.presentation.views.analysis_charts import CycleCurves
    from optlink.presentation.views.analysis_tables import analysis
    from optlink.presentation.views.sensitivity import outputs
    from optlink.studies.motion_sensitivity import OutputStudy

    file = problem(tmp_path, LIFT)
    result = optlink.analyze(file, points=4)
    cycle = CycleCurves(result)
    charts = [chart for chart in view_of("analysis").charts(cycle) if not chart.equal]
    assert {(chart.x.name, chart.x.limits) for chart in charts} == {("length of lift [mm]", (800.0, 1300.0))}
    x, y = cycle.line("input.force_N")
    np.testing.assert_allclose(y, np.interp(x, np.linspace(800.0, 1300.0, 401), lift_forces([0.5, -0.5, 0.9])[1]), rtol=1e-5)
    shown = repr(analysis(result))
    assert "velocity" not in shown
    assert "crank" not in shown
    study = OutputStudy(file, "boom", file.model.sizes({}), file.model.driving.at(np.array([800.0, 1200.0])))
    table = outputs(study)
    assert [row[0].text for row in table.rows] == ["800", "1200"]
    assert "constant length" in table.title
    scatter = optlink.studies.tolerance(
        file, {"G.x": "1 mm"}, "boom", samples=16, design={name: file.model.sizes({})[name] for name in file.model.free}
    )
    np.testing.assert_allclose(scatter.columns["length_mm"][[0, -1]], [800.0, 1300.0])


DRAG_LINK = """
title = "Drag link"
[mechanism.ground]
A = ["0 mm", "0 mm"]
D = ["60 mm", "0 mm"]
[mechanism.links]
crank = { joints = ["A", "B"], length = "200 mm" }
rod = { joints = ["B", "C"], length = { start = "180 mm", bounds = ["150 mm", "260 mm"] } }
follower = { joints = ["D", "C"], length = "200 mm" }
[mechanism.assembly]
C = "left of B-D"
[drive]
range = ["20 deg", "240 deg"]
speed = "static"
[objective]
quantity = "length"
of = "rod.length"
[limits]
swing = { quantity = "stroke", of = "follower", min = "SWING deg" }
"""


def test_a_swing_of_more_than_half_a_turn(tmp_path):
    phi = np.radians(np.linspace(20.0, 240.0, 2001))

    def swing(rod):
        away = 0.06 - 0.2 * np.exp(1j * phi)
        q = np.abs(away)
        c = 0.2 * np.exp(1j * phi) + rod * away / q * np.exp(1j * np.arccos((q * q + rod**2 - 0.2**2) / (2.0 * q * rod)))
        return math.degrees(float(np.ptp(np.unwrap(np.angle(c - 0.06)))))

    asked = 0.5 * (swing(0.15) + swing(0.26))
    assert min(swing(0.15), swing(0.26)) > 180.0
    text = DRAG_LINK.replace("SWING", f"{asked:.9f}")
    goal = 'quantity = "length"\nof = "rod.length"'
    sense = "" if swing(0.15) < swing(0.26) else '\nsense = "maximise"'
    result = optlink.solve(problem(tmp_path, text.replace(goal, goal + sense)), backend="slsqp")
    assert result.valid
    assert swing(result.best.design["rod.length"]) == pytest.approx(asked, abs=1e-5)


def test_a_work_is_named_by_what_it_is_counted_over(tmp_path):
    work = {"objective": {"quantity": "work"}}
    lift, strut = problem(tmp_path, LIFT, **work), problem(tmp_path, STRUT, **work)
    assert [one.model.goals[0].words for one in (lift, strut)] == ["work over the stroke", "work over the range"]
    assert read_words(f"minimise {lift.model.goals[0].words}") == {"sense": "minimise", "quantity": "work"}
    turning = CRANK_ROCKER.replace('range = ["20 deg", "200 deg"]', "")
    assert problem(tmp_path, turning, **work).model.goals[0].words == "work per revolution"


def test_a_drawing_of_a_cylinder_is_exported_at_its_length(tmp_path):
    machine = tmp_path / "lift.toml"
    machine.write_text(LIFT.partition("[objective]")[0], encoding="utf-8")
    for length, angle in ((1300.0, math.pi), (800.0, 0.0)):
        file = tmp_path / "lift.json"
        assert run("export", str(machine), "-o", str(file), "--at", f"{length:g} mm").exit_code == 0
        drawn = json.loads(file.read_text(encoding="utf-8"))
        assert drawn["crank_angle_rad"] == pytest.approx(angle)
    for text, part in (("30 deg", "is not a unit of coordinate"), ("1.5 m", "Give a length of lift 800 ... 1300 mm")):
        assert part in run("export", str(machine), "-o", str(tmp_path / "lift.svg"), "--at", text).stderr


def test_texts_that_are_no_names_are_refused():
    with pytest.raises(InputError, match="not a text"):
        optlink.read_design("shaper-design", [], varied=[[1.0]])


@pytest.mark.parametrize(
    ("key", "value", "part"),
    [
        (
            "loads.gas",
            {"on": "rod", "gas": {"pressure": "3 bar"}},
            "loads.gas.gas.bore: this key is missing. Write for example gas",
        ),
        ("drive.law", {"over": "t", "at": ["0 s"], "values": ["0 deg"]}, "the law of a drive over the time is a list of motions"),
    ],
)
def test_remedies_are_those_of_the_key(tmp_path, key, value, part):
    with pytest.raises(InputError) as error:
        problem(tmp_path, STRUT, **{key: value})
    assert part in str(error.value)
