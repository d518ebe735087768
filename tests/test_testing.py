"""The oracles for extensions: they pass for what the package has, and detect planted defects."""

from __future__ import annotations

from pathlib import Path

import pytest

import optlink
from optlink.testing import (
    Disagreement,
    check_derivatives,
    check_forces,
    check_motion,
    check_optimum,
    check_prices,
    check_stored,
)

LAW = "crank-rocker"


@pytest.mark.parametrize("name", ["crank-rocker", "six-bar", "shaper", "slider-crank"])
def test_the_motion_of_shipped_linkages_agrees_with_differences(name: str) -> None:
    assert 0.0 < check_motion(name) < 1e-6


def test_a_wrong_velocity_is_detected(monkeypatch: pytest.MonkeyPatch) -> None:
    from optlink.linkage.motion import Motion

    velocity = Motion.velocity
    monkeypatch.setattr(Motion, "velocity", lambda self, point: velocity(self, point) * (1.0 + 1e-5 * (point == "C")))
    with pytest.raises(Disagreement, match="velocity of C"):
        check_motion(LAW)


def test_the_torque_agrees_with_the_energy(monkeypatch: pytest.MonkeyPatch) -> None:
    problem = optlink.load("balance-four-bar")
    assert check_forces(problem) < 1e-6
    with pytest.raises(optlink.InputError, match="without friction"):
        check_forces(optlink.load("shaper", {"mechanism.guides.F.friction": 0.1}))
    from optlink.dynamics.machine import Machine

    kinetic = Machine.kinetic
    monkeypatch.setattr(Machine, "kinetic", lambda self, state: 1.001 * kinetic(self, state))
    with pytest.raises(Disagreement, match="driving torque"):
        check_forces(problem)


def test_the_torque_agrees_with_the_power_of_loads(monkeypatch: pytest.MonkeyPatch) -> None:
    loads = {
        "loads.spring": {"between": ["A", "C"], "stiffness": "5 N/m", "damping": "1 N*s/m"},
        "loads.leaf": {"on": "rocker", "against": "coupler", "torsional_stiffness": "2 N*m/rad"},
        "loads.push": {"on": "coupler", "at": "C", "force": "3 N", "direction": "30 deg"},
    }
    problem = optlink.load("balance-four-bar", loads)
    assert check_forces(problem) < 1e-6
    assert check_forces("six-bar") < 1e-6
    from optlink.dynamics.machine import Acting

    wrench = Acting.wrench
    monkeypatch.setattr(Acting, "wrench", lambda self, state: wrench(self._replace(torque=1.001 * self.torque), state))
    with pytest.raises(Disagreement, match="driving torque"):
        check_forces(problem)


@pytest.mark.parametrize("name", [LAW, "shaper-design"])
def test_derivatives_agree_with_differences(name: str) -> None:
    assert check_derivatives(name) < 1e-5


def test_a_wrong_derivative_is_detected(monkeypatch: pytest.MonkeyPatch) -> None:
    gradient = optlink.Programme.gradient
    monkeypatch.setattr(optlink.Programme, "gradient", lambda self, x: 1.01 * gradient(self, x))
    with pytest.raises(Disagreement, match="derivatives of objective"):
        check_derivatives(LAW)


@pytest.mark.slow
def test_back_ends_and_prices_of_a_law() -> None:
    assert check_optimum(LAW, "slsqp") < 1e-6
    assert check_prices(LAW) < 1e-3


@pytest.mark.slow
def test_results_read_back(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    result = optlink.validate(LAW, {"coupler": 0.412, "rocker": 0.232})
    check_stored(result)
    written = type(result).to_dict
    calls: list[int] = []
    monkeypatch.setattr(type(result), "to_dict", lambda self: written(self) | {"starts": len(calls) + (calls.append(1) or 0)})
    with pytest.raises((Disagreement, optlink.InputError)):
        check_stored(result)
