"""Cycle of a design with a cam: divided where a piece of its law begins, wherever the phase is; against a dense analysis."""

from __future__ import annotations

import math

import numpy as np
import pytest

import optlink
from optlink.linkage.vector2d import TURN
from optlink.optimization.cycle_signals import TracedCycle
from optlink.optimization.programme import build
from tests.tasks.test_drive_ranges import problem

CAM = """
title = "Cam of a press with dwells"
[mechanism.ground]
A = ["0 mm", "0 mm"]
M = ["-100 mm", "0 mm"]
S = ["0 mm", { start = "125 mm", bounds = ["120 mm", "150 mm"] }]
[mechanism.links]
motor = { joints = ["M"] }
cam = { joints = ["A"] }
valve = { joints = ["R"] }
[mechanism.gears]
mesh = { bodies = ["motor", "cam"], teeth = [20, 20] }
[mechanism.guides]
stem = { slider = "valve", through = "A", direction = "90 deg" }
[mechanism.cams.lobe]
cam = "cam"
follower = "valve"
base_radius = "30 mm"
roller = "10 mm"
phase = { start = "20 deg", bounds = ["-180 deg", "180 deg"] }
law = [{ to = "100 deg", rise = "12 mm" }, { to = "170 deg" }, { to = "250 deg", fall = "12 mm" }, { to = "360 deg" }]
[bodies]
valve = { mass = "2 kg" }
[loads]
spring = { between = ["S", "R"], stiffness = "9 N/mm", free_length = "90 mm" }
[drive]
body = "motor"
speed = "300 rpm"
[objective]
quantity = "torque"
measure = "rms"
"""


def cam(tmp_path, law, **changes):
    """Problem whose rise and fall have one of the laws of motion."""
    pieces = [{"to": "100 deg", "rise": "12 mm", "law": law}, {"to": "170 deg"}]
    pieces += [{"to": "250 deg", "fall": "12 mm", "law": law}, {"to": "360 deg"}]
    return problem(tmp_path, CAM, **{"mechanism.cams.lobe.law": pieces}, **changes)


def dense_torque(given, design=None):
    """Torque of the drive [N m] between 100,000 even steps of the cycle."""
    result = optlink.analyze(given, design=design) if design else optlink.analyze(given)
    found = result.at((np.arange(100_000) + 0.5) * 1e-5 * result.cycle)
    return next(values for name, values in found.items() if "torque" in name)


@pytest.mark.parametrize("teeth", [[20, 20], [20, 40], [20, 30]], ids=str)
@pytest.mark.parametrize("law", ["3-4-5", "trapezoidal"])
def test_integral_of_a_design_is_that_of_the_analysis(tmp_path, law, teeth):
    """Gears give the cam other turns than the crank, so that its knots differ between the revolutions of a cycle."""
    given = cam(tmp_path, law, **{"mechanism.gears.mesh.teeth": teeth})
    nlp = build(given.model)
    assert nlp.at(nlp.x_start, nlp.p).f == pytest.approx(np.sqrt(np.mean(dense_torque(given) ** 2)), rel=1e-5)
    ratio = -teeth[0] / teeth[1]
    begins = np.radians(np.repeat([20.0, 120.0, 190.0, 270.0], teeth[1] // 10))
    found = np.exp(1j * (ratio * np.array(nlp.terms.structure.angles)))
    assert np.min(np.abs(found[:, None] - np.exp(1j * begins)), axis=0) == pytest.approx(0.0, abs=1e-9)
    assert np.ptp(nlp.terms.structure.angles) < TURN * teeth[1] / math.gcd(*teeth)


@pytest.mark.parametrize("phase", [-180.0, -70.0, 0.0, 1e-9, 95.0])
def test_knots_move_with_the_phase(tmp_path, phase):
    """A design whose phase differs from that of the trace, also where a piece begins at the crank angle 0."""
    given = cam(tmp_path, "trapezoidal")
    values = given.model.complete({"lobe.phase": math.radians(phase)})
    terms = build(given.model).terms
    events = np.array(terms.trace.structure(values).angles)
    shares, weights = terms.nodes
    parts = [motion.span * weights @ motion.signals(shares)[0] ** 2 for motion in terms.motions(values, events)]
    moved = cam(tmp_path, "trapezoidal", **{"mechanism.cams.lobe.phase": f"{phase!r} deg"})
    assert math.sqrt(sum(parts) / TURN) == pytest.approx(np.sqrt(np.mean(dense_torque(moved) ** 2)), rel=1e-4)


def test_each_knot_divides_once(tmp_path):
    """A second cam with a phase of its own adds its two events; the end of a law is the begin of the next turn."""
    lobe = {"cam": "cam", "follower": "other", "base_radius": "30 mm", "roller": "10 mm"}
    law = [{"to": "100 deg", "rise": "12 mm", "law": "3-4-5"}, {"to": "360 deg", "fall": "12 mm", "law": "3-4-5"}]
    second = {
        "mechanism.links.other": {"joints": ["Q"]},
        "mechanism.guides.way": {"slider": "other", "through": "A", "direction": "0 deg"},
        "mechanism.cams.lobe.phase": "20 deg",
        "mechanism.cams.lobe.law": law,
    }

    def count(phase):
        changes = second | {"mechanism.cams.second": lobe | {"law": law, "phase": phase}}
        return len(TracedCycle(problem(tmp_path, CAM, **changes).model).events)

    assert count("50 deg") == 4
    alone = {key: value for key, value in second.items() if key.startswith("mechanism.cams")}
    assert len(TracedCycle(problem(tmp_path, CAM, **alone).model).events) == 2


@pytest.mark.slow
@pytest.mark.parametrize("measure", ["rms", "peak"])
def test_optimum_of_a_cam_is_that_of_the_analysis(tmp_path, measure):
    """The spring that is best for the inertia of a cam with dwells, by an own search over the analysis."""
    given = cam(tmp_path, "trapezoidal", **{"objective.measure": measure, "mechanism.cams.lobe.phase": "20 deg"})
    best = optlink.solve(given, backend="slsqp").best

    def cost(height):
        torque = dense_torque(cam(tmp_path, "trapezoidal", **{"mechanism.ground.S": ["0 mm", f"{1e3 * height:.15g} mm"]}))
        return float(np.sqrt(np.mean(torque**2)) if measure == "rms" else np.max(np.abs(torque)))

    assert best.valid
    assert best.objective == pytest.approx(cost(best.design["S.y"]), rel=1e-3)  # even steps miss a corner
    assert best.objective <= min(cost(height) for height in np.linspace(0.12, 0.15, 31)) * (1.0 + 1e-3)
