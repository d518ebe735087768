"""Targets of machines whose drive has a range: poses, points, laws and positions, against own searches on the closed form."""

from __future__ import annotations

import math
import os
import re

import numpy as np
import pytest
from scipy.optimize import differential_evolution

import optlink
from optlink.errors import InputError
from tests.solved import once
from tests.tasks.test_drive_ranges import CRANK_ROCKER, LIFT, lift_forces, problem

BACKENDS = pytest.mark.parametrize("backend", ["ipopt", "slsqp"])
HOOD = """
title = "Hood"
[mechanism.ground]
A = ["0 mm", "0 mm"]
D = [{ start = "-150 mm", bounds = ["-250 mm", "-50 mm"] }, { start = "60 mm", bounds = ["0 mm", "150 mm"] }]
[mechanism.links]
lever = { joints = ["A", "B"], length = "200 mm" }
lid = { joints = ["B", "C"], length = { start = "150 mm", bounds = ["50 mm", "300 mm"] }, points = { P = ["600 mm", "0 mm"] } }
guide = { joints = ["D", "C"], length = { start = "220 mm", bounds = ["100 mm", "400 mm"] } }
[mechanism.assembly]
C = "left of B-D"
[drive]
body = "lever"
range = ["20 deg", "100 deg"]
speed = "static"
[requirement]
kind = "motion"
point = "P"
mark = { start = "0 deg", bounds = ["-180 deg", "180 deg"] }
angle_length = "500 mm"
points = [
    { x = "780 mm", y = "90 mm", angle = "0 deg", crank = "20 deg" },
    { x = "650 mm", y = "420 mm", angle = "25 deg", crank = "60 deg" },
    { x = "300 mm", y = "720 mm", angle = "60 deg", crank = "100 deg" },
]
"""


def four_bar(crank, coupler, rocker, phi, pivot, side):
    """Points B and C of four-bars with the crank pivot at the origin; NaN where they cannot be assembled."""
    b, d = crank * np.exp(1j * phi), pivot[0] + 1j * pivot[1]
    away = d - b
    q = np.abs(away)
    with np.errstate(invalid="ignore"):
        enclosed = np.arccos((q * q + coupler**2 - rocker**2) / (2.0 * q * coupler))
    return b, b + coupler * away / q * np.exp(side * 1j * enclosed)


def least(cost, bounds, seed=1):
    """The result of differential evolution, searched once per run for both back ends of a test."""

    def safe(x):
        with np.errstate(all="ignore"):
            value = cost(x)
        return value if math.isfinite(value) else 1e6

    test = os.environ["PYTEST_CURRENT_TEST"].partition(" ")[0]
    name = re.sub(r"ipopt|slsqp|\W+", "-", f"least of {test} {bounds} {seed}")
    return once(name, lambda: differential_evolution(safe, bounds, seed=seed, tol=1e-10, maxiter=400))


@pytest.mark.slow
@BACKENDS
def test_poses_of_a_hood_over_its_lever_range(tmp_path, backend):
    """The pivot, the lid and the guide link are the best of an own search that must close everywhere from 20 to 100 deg."""
    phi, whole = np.radians([20.0, 60.0, 100.0]), np.radians(np.linspace(20.0, 100.0, 41))
    target, turned = np.array([0.78 + 0.09j, 0.65 + 0.42j, 0.3 + 0.72j]), np.radians([0.0, 25.0, 60.0])

    def cost(x):
        *pivot, coupler, guide, mark = x
        if not np.all(np.isfinite(four_bar(0.2, coupler, guide, whole, pivot, 1.0)[1])):
            return math.nan
        b, c = four_bar(0.2, coupler, guide, phi, pivot, 1.0)
        axis = (c - b) / coupler
        gap = np.angle(axis * np.exp(1j * (mark - turned)))
        return float(np.sum(np.abs(b + 0.6 * axis - target) ** 2 + (0.5 * gap) ** 2))

    result = optlink.solve(problem(tmp_path, HOOD), backend=backend)
    best = result.best.design
    assert result.valid
    own = [best[name] for name in ("D.x", "D.y", "lid.length", "guide.length", "mark")]
    assert cost(own) == pytest.approx(result.best.objective, rel=1e-6)
    found = least(cost, [(-0.25, -0.05), (0.0, 0.15), (0.05, 0.3), (0.1, 0.4), (-math.pi, math.pi)])
    assert result.best.objective <= found.fun * (1.0 + 1e-6)
    names = [check.name for check in result.best.validation.checks]
    assert "positions within the range of the drive" in names
    assert not any("revolution" in name for name in names)


PATH = """
title = "Points of a lever drive"
[mechanism]
type = "four-bar"
assembly = "left"
crank = "100 mm"
coupler = { start = "250 mm", bounds = ["150 mm", "400 mm"] }
rocker = { start = "250 mm", bounds = ["150 mm", "400 mm"] }
frame = "300 mm"
points = { P = ["250 mm", "100 mm"] }
[drive]
range = ["30 deg", "120 deg"]
speed = "static"
[requirement]
kind = "path"
points = [["280 mm", "250 mm"], ["230 mm", "270 mm"], ["160 mm", "255 mm"]]
rotation = "counter-clockwise"
"""


@BACKENDS
def test_points_are_passed_within_the_range(tmp_path, backend):
    """The crank angles are unknowns between 30 and 120 deg, in order; without the range the points would be met better."""
    target = np.array([0.28 + 0.25j, 0.23 + 0.27j, 0.16 + 0.255j])
    whole = np.linspace(math.radians(30.0), math.radians(120.0), 181)

    def trace(coupler, rocker, phi):
        b, c = four_bar(0.1, coupler, rocker, phi, (0.3, 0.0), 1.0)
        return b + (0.25 + 0.1j) * (c - b) / coupler

    def cost(x):
        z = trace(*x, whole)
        if not np.all(np.isfinite(z)):
            return math.nan
        each, best = np.abs(z[:, None] - target) ** 2, np.zeros(len(whole))
        for k in range(3):
            best = np.minimum.accumulate(best) + each[:, k]
        return float(np.min(best))

    result = optlink.solve(problem(tmp_path, PATH), backend=backend)
    best = result.best
    assert result.valid
    angles = np.asarray(best.crank_angles)
    assert np.all(np.diff(angles) > 0.0)
    assert np.min(angles) >= math.radians(30.0) - 1e-9
    assert np.max(angles) <= math.radians(120.0) + 1e-9
    own = float(np.sum(np.abs(trace(best.design["coupler"], best.design["rocker"], angles) - target) ** 2))
    assert own == pytest.approx(best.objective, rel=1e-6)
    found = least(cost, [(0.15, 0.4)] * 2)
    assert best.objective <= found.fun * (1.0 + 1e-6)
    assert best.objective == pytest.approx(found.fun, rel=2e-2)  # its crank angles are those of a grid


LAW = """
title = "Law of a lever"
[mechanism]
type = "four-bar"
assembly = "left"
crank = "100 mm"
coupler = { start = "250 mm", bounds = ["100 mm", "400 mm"] }
rocker = { start = "250 mm", bounds = ["100 mm", "400 mm"] }
frame = "250 mm"
[drive]
range = ["40 deg", "130 deg"]
speed = "static"
[requirement]
kind = "function"
law = "psi0 + 0.5*(phi - phi0) + 0.05*sin(2*(phi - phi0))"
span = "90 deg"
measure = "rms"
"""


@pytest.mark.slow
@BACKENDS
def test_law_over_the_range_starts_where_the_range_does(tmp_path, backend):
    """The start is fixed by the range, as the law needs all of it; psi0 is the best constant, so it is eliminated here."""
    phi = np.radians(np.linspace(40.0, 130.0, 61))
    law = 0.5 * (phi - phi[0]) + 0.05 * np.sin(2.0 * (phi - phi[0]))

    def cost(x):
        _, c = four_bar(0.1, *x, phi, (0.25, 0.0), 1.0)
        error = np.unwrap(np.angle(c - 0.25)) - law
        return float(np.std(error)) if np.all(np.isfinite(error)) else math.nan

    file = problem(tmp_path, LAW)
    result = optlink.solve(file, backend=backend)
    best = result.best
    assert result.valid
    assert file.model.quantities["start"].bounds == pytest.approx((math.radians(40.0),) * 2)
    assert cost([best.design["coupler"], best.design["rocker"]]) == pytest.approx(best.objective, rel=1e-6)
    found = least(cost, [(0.1, 0.4)] * 2)
    assert best.objective == pytest.approx(found.fun, rel=1e-5)


@pytest.mark.slow
@BACKENDS
def test_a_lift_reaches_two_angles_with_the_least_force(tmp_path, backend):
    """The own search has the two angles and M as unknowns; G then is where two circles meet."""
    ends = [("0 deg", '["-30 deg", "-20 deg"]'), ("180 deg", '["40 deg", "50 deg"]')]
    places = "".join(
        f'[[requirements]]\nkind = "position"\noutput = "boom"\nat = "{at}"\nvalue = {value}\n' for at, value in ends
    )
    result = optlink.solve(problem(tmp_path, LIFT.partition("[limits]")[0] + places), backend=backend)
    best = result.best
    assert result.valid

    def peak(x):
        angle, force = lift_forces(x)
        return float(np.max(np.abs(force))) if np.all(np.isfinite(angle)) else math.nan

    def cost(x):
        first, last = ((x[2] - 0.1j) * np.exp(1j * math.radians(angle)) for angle in x[:2])
        away, q = last - first, abs(last - first)
        cosine = (q * q + 0.8**2 - 1.3**2) / (2.0 * q * 0.8)
        each = [first + 0.8 * away / q * np.exp(side * 1j * np.arccos(cosine)) for side in (1.0, -1.0)]
        within = [g for g in each if 0.1 <= g.real <= 1.2 and -1.0 <= g.imag <= -0.2]
        left = [g for g in within if (np.conj(g) * first).imag > 0.0 and (np.conj(g) * last).imag > 0.0]  # M left of O-G
        return min((peak([g.real, g.imag, x[2]]) for g in left), default=math.nan)

    assert peak([best.design[name] for name in ("G.x", "G.y", "boom.M.along")]) == pytest.approx(best.objective, rel=1e-6)
    found = least(cost, [(-30.0, -20.0), (40.0, 50.0), (0.3, 2.0)])
    assert best.objective == pytest.approx(found.fun, rel=1e-5)
    assert "boom at 1300 mm, least" in [check.name for check in best.validation.checks]


@pytest.mark.parametrize("backend", ["slsqp"])
def test_the_best_transmission_over_a_range(tmp_path, backend):
    text = CRANK_ROCKER.partition("[objective]")[0] + '\n[requirement]\nkind = "transmission"\n'
    result = optlink.solve(problem(tmp_path, text), backend=backend)
    phi = np.radians(np.linspace(20.0, 200.0, 3601))

    def worst(crank):
        square = crank**2 + 0.4**2 - 2.0 * crank * 0.4 * np.cos(phi)
        return float(np.max(np.abs((0.4**2 + 0.3**2 - square) / (2.0 * 0.4 * 0.3))))

    assert result.valid
    assert worst(result.best.design["crank"]) == pytest.approx(result.best.objective, rel=1e-6)
    assert result.best.objective <= min(map(worst, np.linspace(0.05, 0.15, 201))) * (1.0 + 1e-6)


@pytest.mark.parametrize(
    ("text", "key", "value", "part"),
    [
        (
            HOOD,
            "drive.range",
            ["20 deg", "90 deg"],
            "asks for positions from 20 to 100 deg, and the drive moves from 20 to 90 deg",
        ),
        (LAW, "requirement.span", "100 deg", "asks for positions from"),
        (LAW, "requirement.from", "50 deg", "asks for positions from 50 to 140 deg"),
        (PATH, "requirement.closed", True, "the last point does not lead back to the first"),
        (PATH, "limits.crank", "span", "the drive has a range, throughout which the linkage closes"),
    ],
)
def test_targets_beyond_the_range_are_refused(tmp_path, text, key, value, part):
    with pytest.raises(InputError, match=part):
        problem(tmp_path, text, **{key: value})
