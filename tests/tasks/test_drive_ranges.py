"""Machines whose drive has a range: everything counts over it, and nothing outside."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.polynomial.legendre import leggauss

import optlink
from optlink.errors import InputError

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


@pytest.mark.parametrize("backend", ["ipopt", "slsqp"])
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
    assert (extreme.least, extreme.largest) == pytest.approx((10.0, 402.4))
    assert result.work == pytest.approx(392.4 + 5.0 * math.pi)
    assert "between -10 and 382.4 N m, and its work is -376.69 J" in result.notes[-1]
    assert not optlink.analyze(problem(tmp_path, DAMPED_LID.replace("20 N*m", "0 N*m"))).notes


def test_batches_motions_and_sensitivities_keep_to_the_range(tmp_path):
    file = problem(tmp_path, STRUT)
    arms = np.array([0.2, 0.26])
    torque = optlink.analyze_batch(file, {"lid.M.along": arms}, ["input.torque_Nm"], points=9)["input.torque_Nm"]
    phi = np.radians(np.linspace(0.0, 90.0, 10))
    for row, m in zip(torque, arms, strict=True):
        np.testing.assert_allclose(row, strut_torque({"S.x": 0.1, "S.y": -0.3, "lid.M.along": m}, phi), rtol=1e-9)
    with pytest.raises(InputError, match=r"crank angle 120 deg lies outside the range of the drive\. .*crank angle 90 deg"):
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
    with pytest.raises(InputError, match="not supported"):
        optlink.simulate(file)
    sizes, at = file.model.sizes({}), np.array([0.5, 2.5])
    found = optlink.studies.output_sensitivity(file.model.linkage, sizes, at, "boom", ["G.x", "lift.open"])
    for name in ("G.x", "lift.open"):
        ends = [
            optlink.linkage.sweep(file.model.linkage, {**sizes, name: sizes[name] + by}, at).body_angle("boom").value
            for by in (1e-6, -1e-6)
        ]
        np.testing.assert_allclose(found.by[name], (ends[0] - ends[1]) / 2e-6, rtol=1e-6)


def test_targets_and_clearance_refuse_a_range(tmp_path):
    target = '\n[requirement]\nkind = "transmission"\n'
    with pytest.raises(InputError, match="targets of a machine whose drive has a range are not supported"):
        problem(tmp_path, CRANK_ROCKER.partition("[objective]")[0] + target)
