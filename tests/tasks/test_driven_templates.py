"""Templates of driven machines: both back ends find the optimum of SciPy's differential evolution on a closed form."""

from __future__ import annotations

import functools
import math

import numpy as np
import pytest
from scipy.optimize import differential_evolution, minimize

import optlink
from optlink.problem.templates import template

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


@functools.cache
def best(name):
    """The least value that differential evolution finds from three seeds, with a penalty for what is missing to the limits."""
    function, bounds, *_ = SEARCHED[name]
    usual = {"hood": 10.0, "excavator-arm": 1e4}[name]

    def penalised(design):
        value, slack = function(design)
        return OUT * usual if not math.isfinite(value) else value + 1e2 * usual * sum(max(0.0, -one) for one in slack)

    every = [differential_evolution(penalised, bounds, seed=k, popsize=40, maxiter=150, tol=1e-9, polish=False) for k in range(3)]
    start = min(every, key=lambda found: found.fun).x
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
    assert result.best.objective == pytest.approx(best(name), rel=accuracy)
