"""Templates of driven machines: both back ends find the optimum of SciPy's differential evolution on a closed form."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.optimize import differential_evolution, minimize

import optlink
from optlink.problem.templates import template
from tests.solved import once

OUT = 1e3
"""Value of a design that is no machine, in multiples of a usual one."""


def hood(design):
    """Peak torque of the hand [N m], and what is left to the lengths of the strut and to the two poses: by its lever arm."""
    hx, hy, x, y, m = design
    phi = np.radians(np.linspace(0.0, 75.0, 401))
    ex, ey = m * np.cos(phi) + 0.03 * np.sin(phi), m * np.sin(phi) - 0.03 * np.cos(phi)
    away = hx + ex - x, hy + ey - y
    length = np.hypot(*away)
    torque = 20.0 * 9.81 * 0.42 * np.cos(phi) - 800.0 * (ex * away[1] - ey * away[0]) / length
    edge = hx + 1j * hy + 0.9 * np.exp(1j * phi[[0, -1]])
    met = 0.001 - np.abs(edge - [0.92 + 0.04j, 0.253 + 0.909j])
    return float(np.max(np.abs(torque))), [length[0] - 0.32, 0.56 - length[-1], *np.diff(length[[0, -1]]), *1e3 * met]


def excavator(design):
    """Peak force of the cylinder [N] and what is left to its limits, by the cosine rule and virtual power."""
    lever, link, bucket = design
    s = np.linspace(1.15, 1.7, 401)
    lx, ly, jx, jy = 1.5, -0.15, 1.8, -0.2
    base = math.hypot(lx, ly)
    with np.errstate(invalid="ignore"):
        inner = np.arccos((base**2 + lever**2 - s**2) / (2.0 * base * lever))  # at the pivot of the lever
        turned = math.atan2(-ly, -lx) - inner  # to the left of the line from the eye to this pivot
        cx, cy = lx + lever * np.cos(turned), ly + lever * np.sin(turned)
        d = np.hypot(jx - cx, jy - cy)
        at_bucket = np.arccos((bucket**2 + d**2 - link**2) / (2.0 * bucket * d))
        angle = np.unwrap(np.arctan2(cy - jy, cx - jx) - at_bucket)
        mu = np.arccos((bucket**2 + link**2 - d**2) / (2.0 * bucket * link))
        swing = np.ptp(angle)
        force = 5600.0 * np.gradient(angle, s, edge_order=2)
    if not np.all(np.isfinite(force)):
        return math.nan, [-1.0]
    between = (
        np.minimum(mu, math.pi - mu),
        np.minimum(inner_c := np.arccos((s**2 + lever**2 - base**2) / (2 * s * lever)), math.pi - inner_c),
    )
    limits = [
        swing - math.radians(80.0),
        math.radians(120.0) - swing,
        *(float(np.min(one)) - math.radians(30.0) for one in between),
    ]
    return float(np.max(np.abs(force))), limits


SEARCHED = {
    "hood": (
        hood,
        [(0.01, 0.03), (0.03, 0.05), (0.04, 0.3), (-0.25, -0.08), (0.25, 0.45)],
        ("H.x", "H.y", "S.x", "S.y", "hood.M.along"),
        1e-3,
    ),
    "excavator-arm": (
        excavator,
        [(0.3, 0.55), (0.25, 0.55), (0.2, 0.42)],
        ("lever.length", "link.length", "bucket.length"),
        1e-3,
    ),
}


def best(name):
    """The least value that differential evolution finds, with a penalty for what is missing to the limits.

    Three seeds agree to 2e-5.
    """
    function, bounds, *_ = SEARCHED[name]
    usual = {"hood": 10.0, "excavator-arm": 1e4}[name]

    def penalised(design):
        value, slack = function(design)
        return OUT * usual if not math.isfinite(value) else value + 1e2 * usual * sum(max(0.0, -one) for one in slack)

    start = differential_evolution(penalised, bounds, seed=1, popsize=40, maxiter=150, tol=1e-9, polish=False).x
    options = {"xatol": 1e-10, "fatol": 1e-9, "maxiter": 4000}
    return float(minimize(penalised, start, method="Nelder-Mead", bounds=bounds, options=options).fun)


@pytest.mark.slow
@pytest.mark.parametrize("backend", ["ipopt", "slsqp"])
@pytest.mark.parametrize("name", SEARCHED)
def test_template_has_the_optimum_of_an_own_search(name, backend):
    function, _, names, accuracy = SEARCHED[name]
    result = optlink.solve(optlink.read(template(name).text, name, f"{name}.toml"), backend=backend)
    assert result.valid
    value, slack = function([result.best.design[own] for own in names])
    assert value == pytest.approx(result.best.objective, rel=accuracy)
    assert min(slack) > -1e-6
    assert result.best.objective == pytest.approx(once(f"best {name} by evolution", lambda: best(name)), rel=accuracy)


# --- a lid on a four-bar hinge ------------------------------------------------------------------------------------------------

HINGE = """
title = "Lid on a four-bar hinge"
gravity = "9.81 m/s^2"
[mechanism.ground]
A = ["-22 mm", "-25 mm"]
B = [{ start = "-10 mm", bounds = ["-40 mm", "60 mm"] }, { start = "35 mm", bounds = ["0 mm", "60 mm"] }]
S = [{ start = "150 mm", bounds = ["40 mm", "400 mm"] }, { start = "-200 mm", bounds = ["-400 mm", "-80 mm"] }]
[mechanism.links]
arm = { joints = ["A", "C"], length = { start = "132 mm", bounds = ["100 mm", "160 mm"] } }
guide = { joints = ["B", "D"], length = { start = "128 mm", bounds = ["100 mm", "180 mm"] } }
tube = { joints = ["S"] }
rod = { joints = ["M"] }
[mechanism.links.lid]
joints = ["C", "D"]
length = { start = "80 mm", bounds = ["60 mm", "120 mm"] }
points.E = [{ start = "880 mm", bounds = ["800 mm", "950 mm"] }, { start = "0 mm", bounds = ["-60 mm", "60 mm"] }]
points.M = [{ start = "300 mm", bounds = ["200 mm", "450 mm"] }, "-30 mm"]
[mechanism.guides]
strut = { slider = "rod", on = "tube", through = "S" }
[mechanism.assembly]
strut = "forward"
D = "left of C-B"
[bodies]
lid = { mass = "20 kg", centroid = ["420 mm", "0 mm"], inertia = "1.4 kg*m^2" }
[loads]
gas = { on = "rod", force = "800 N", against = "tube" }
[drive]
body = "arm"
range = ["71.4 deg", "120.9 deg"]
speed = "static"
[requirement]
kind = "motion"
point = "E"
mark = "0 deg"
angle_length = "300 mm"
tolerance = "1 mm"
points = [
    { x = "900 mm", y = "100 mm", angle = "0 deg", crank = "71.4 deg" },
    { x = "350 mm", y = "850 mm", angle = "60 deg", crank = "120.9 deg" },
]
[objective]
quantity = "torque"
measure = "peak"
[limits]
closed = { quantity = "end", of = "rod", stroke = "backward", min = "320 mm" }
open = { quantity = "end", of = "rod", stroke = "forward", max = "560 mm" }
"""
FREE = {
    "B.x": (-0.04, 0.06),
    "B.y": (0.0, 0.06),
    "arm.length": (0.1, 0.16),
    "guide.length": (0.1, 0.18),
    "lid.length": (0.06, 0.12),
    "lid.E.along": (0.8, 0.95),
    "lid.E.across": (-0.06, 0.06),
    "S.x": (0.04, 0.4),
    "S.y": (-0.4, -0.08),
    "lid.M.along": (0.2, 0.45),
}


def hinge(design, points=41):
    """Torques of the hand at the arm [N m] by virtual work, and what is left to the strut and to both poses [m]."""
    bx, by, arm, guide, lid, along, across, sx, sy, m = design
    phi = np.radians(np.linspace(71.4, 120.9, points))
    step = 1e-4

    def placed(phi):
        c = -0.022 - 0.025j + arm * np.exp(1j * phi)
        away = bx + 1j * by - c
        far = np.abs(away)
        near = (lid**2 + far**2 - guide**2) / (2.0 * far)
        axis = away / far * (near + 1j * np.sqrt(np.maximum(lid**2 - near**2, 0.0))) / lid
        return c, axis, np.abs(c + (m - 0.03j) * axis - sx - 1j * sy)

    (_, _, low), (_, _, high), (c, axis, length) = placed(phi - step), placed(phi + step), placed(phi)
    height = [(at + 0.42 * way).imag for at, way, _ in (placed(phi + step), placed(phi - step))]
    torque = (20.0 * 9.81 * (height[0] - height[1]) - 800.0 * (high - low)) / (2.0 * step)
    edge, turned = (c + (along + 1j * across) * axis)[[0, -1]], np.angle(axis[[0, -1]] * np.exp([0.0, -1j * math.pi / 3.0]))
    met = 0.001 - np.sqrt(np.abs(edge - [0.9 + 0.1j, 0.35 + 0.85j]) ** 2 + (0.3 * turned) ** 2)
    return torque, np.array([length[0] - 0.32, 0.56 - length[-1], *met])


def best_hinge():
    """The least peak that sequential quadratic programming finds from random starts, among the hinges that meet both poses."""
    low, high = np.array(list(FREE.values())).T

    def slack(x):
        torque, left = hinge(x[:-1] * (high - low) + low)
        return [*(x[-1] - torque / 50.0), *(x[-1] + torque / 50.0), *(100.0 * left)]

    limits, bounds = {"type": "ineq", "fun": slack}, [(0.0, 1.0)] * len(FREE) + [(0.0, 100.0)]
    starts = np.random.default_rng(3).random((8, len(FREE)))
    every = [
        minimize(lambda x: x[-1], [*start, 5.0], method="SLSQP", bounds=bounds, constraints=limits, options={"maxiter": 150})
        for start in starts
    ]
    return min(50.0 * found.x[-1] for found in every if min(slack(found.x)) > -1e-6)


@pytest.mark.slow
def test_lid_on_a_four_bar_hinge_has_the_optimum_of_an_own_search():
    results = [optlink.solve(optlink.read(HINGE), backend=backend, starts=4, designs=1).best for backend in ("ipopt", "slsqp")]
    for best in results:
        assert best.validation.valid
        torque, left = hinge([best.design[name] for name in FREE], 2001)
        assert np.max(np.abs(torque)) == pytest.approx(best.objective, rel=1e-5)
        assert min(left) > -1e-6
    assert results[0].objective == pytest.approx(results[1].objective, rel=1e-4)
    assert results[0].objective == pytest.approx(best_hinge(), rel=1e-3)
