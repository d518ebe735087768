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
