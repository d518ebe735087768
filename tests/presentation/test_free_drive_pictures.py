"""The moving picture of a simulation with drives that move freely: its points are at the places of the table."""

from __future__ import annotations

import numpy as np
import pytest

import optlink
from optlink.presentation.views.simulation import page
from tests.tasks.test_free_drives import LOOSE, cart, simulated

RAM = {
    "drive.speed": None,
    "drive.law": [{"time": "2 s", "to": "6.5 m"}, {"time": "2 s", "to": "6 m"}],
    "drive.controller": {"proportional": "10 kN/m", "derivative": "1 kN*s/m"},
    "bodies.bell": {"mass": "100 kg", "inertia": "uniform bar"},
    "gravity": "9.81 m/s^2",
}


@pytest.mark.parametrize(
    ("run", "column"),
    [
        (lambda: simulated("two-link-arm", LOOSE, duration=0.5, rows=20), "fore.angle_rad"),
        (lambda: optlink.simulate(cart(), duration=0.5, rows=20), "carriage.s_m"),
        (lambda: simulated("backhoe-bucket", RAM, duration=0.5, rows=20), "ram.length_m"),
    ],
    ids=["arm", "cart", "ram"],
)
def test_picture_follows_the_free_drives(run, column):
    run = run()
    moving = page(run).moving(20)
    shown = [name for name in moving.scene.names if f"{name}.x_m" in run.columns]
    assert shown
    for point in shown:
        expected = 1e3 * np.stack([run[f"{point}.x_m"], run[f"{point}.y_m"]], axis=1)
        np.testing.assert_allclose(moving.scene.position(moving.scene.shown, point), expected, atol=1e-6)
    assert np.ptp(run[column]) > 1e-3
