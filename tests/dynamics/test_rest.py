"""A drive that starts from rest: a speed of zero under a torque, and what needs a constant speed."""

from __future__ import annotations

import tomllib

import numpy as np
import pytest

import optlink
from optlink.dynamics.forward import Ending
from optlink.errors import InputError
from optlink.problem.file import ProblemFile, read

FLYWHEEL = """
title = "Slider-crank from rest"
[mechanism.ground]
A = ["0 mm", "0 mm"]
[mechanism.links]
crank = { joints = ["A", "B"], length = "30 mm" }
rod = { joints = ["B", "C"], length = "110 mm" }
slide = { joints = ["C"] }
[mechanism.guides]
G = { slider = "slide", direction = "0 deg", through = "A" }
[mechanism.assembly]
C = "forward"
[bodies]
crank = { mass = "2 kg", inertia = "0.01 kg*m^2", centroid = "start" }
[drive]
speed = "0 rad/s"
torque = "0.5 N*m"
duration = "1 s"
"""


def machine(**changes: object) -> ProblemFile:
    text = FLYWHEEL.replace('centroid = "start"', 'centroid = ["0 mm", "0 mm"]')
    return read(tomllib.loads(text), "rest").override({key.replace("__", "."): value for key, value in changes.items()})


def test_a_machine_with_a_speed_of_zero_is_simulated_from_rest():
    """A crank alone with a constant torque: half the angular acceleration times the time squared."""
    computed = optlink.simulate(machine())
    turned = np.radians(computed["crank_angle_deg"][-1] - computed["crank_angle_deg"][0])
    assert turned == pytest.approx(0.5 * (0.5 / 0.01), rel=1e-6)


def test_loads_that_need_a_constant_speed_are_refused():
    for run in (optlink.analyze, lambda file: optlink.analyze_batch(file, {"crank.length": [0.03]})):
        with pytest.raises(InputError, match=r"drive\.speed.*speed is zero"):
            run(machine())
    with pytest.raises(InputError, match=r"drive\.duration"):
        optlink.simulate(machine(drive__duration=None))
    with pytest.raises(InputError, match=r"drive\.speed.*speed is zero"):
        machine(drive__torque=None)


@pytest.mark.parametrize("key", ["loads.work", "drive.torque"])
def test_a_force_without_a_value_at_the_start_is_no_rest(key):
    """log(0): neither sense of rotation can be judged, so that the machine stays at rest is not known."""
    formula = {"expression": "log(omega)", "unit": "N*m"}
    value = {"on": "crank", "torque": formula} if key == "loads.work" else formula
    result = optlink.simulate(machine().override({key: value}))
    assert (result.ending, result.valid) == (Ending.STALLED, False)
