"""Published mechanisms with gears, racks, belts, cams, cylinders and several drives: the energy of each one balances."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import optlink

FILES = sorted((Path(__file__).parents[1] / "data" / "mechanisms").glob("*.toml"))
RECORD = Path(__file__).parents[2] / "benchmarks" / "multibody_record.json"


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.stem)
def test_power_is_the_rate_of_the_energy(file):
    machine = optlink.analyze(optlink.load(file), points=720)
    assert all(np.all(np.isfinite(machine[column])) for column in machine.columns)
    time, energy, power = machine["time_s"], machine["energy.kinetic_J"] + machine["energy.potential_J"], machine["input.power_W"]
    peak = float(np.max(np.abs(power)))
    assert peak > 1e-5
    np.testing.assert_allclose((energy[2:] - energy[:-2]) / (time[2:] - time[:-2]), power[1:-1], rtol=0.0, atol=2e-3 * peak)


def test_twelve_of_them_agree_with_a_multibody_code():
    """The record of `benchmarks/multibody.py`; velocities and efforts differ by the errors of its time steps."""
    records = json.loads(RECORD.read_text(encoding="utf-8"))
    assert len({record["machine"] for record in records} & {file.stem for file in FILES}) == 12
    for record in records:
        assert record["positions"] < 1e-11, record
        assert record["velocities"] < 1e-6, record
        assert record["efforts"] < 1e-5, record
