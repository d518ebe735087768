"""Conflicts are explained although programmes were dropped; the nearest design lies beyond the bounds in conflict."""

import math

import pytest

import optlink
from optlink.presentation.views import design_tables
from optlink.tasks import search


@pytest.mark.slow
def test_an_infeasible_machine_is_explained_after_its_programmes_were_dropped(monkeypatch):
    monkeypatch.setattr(search, "MOST_PROGRAMMES", 1)
    machine = optlink.load("shaper-design")
    raw = {**machine.raw, "limits": {**machine.raw["limits"], "guide": {**machine.raw["limits"]["guide"], "max": "1 N"}}}
    result = optlink.solve(machine.with_tables(raw), starts=1)
    assert not result.valid
    assert result.conflict


def test_the_nearest_design_is_one_that_can_be_assembled_beyond_the_bounds():
    """Crank 10 mm and frame 100 mm: coupler and rocker of 50 mm each do not reach, 55 mm each do."""
    link = {"bounds": ["20 mm", "50 mm"]}
    mechanism = {"type": "four-bar", "crank": "10 mm", "frame": "100 mm", "coupler": link, "rocker": link, "assembly": "left"}
    requirement = {"kind": "function", "law": "psi0 + 0.3*(phi - phi0)", "from": "196 deg", "span": "134 deg", "points": 9}
    result = optlink.solve(optlink.read({"mechanism": mechanism, "requirement": requirement}), starts=2)
    assert not result.valid
    assert {limit.name for limit in result.conflict} >= {"coupler", "rocker"}
    assert result.nearest is not None
    values = result.nearest.values
    assert math.isfinite(result.objective)
    assert values["coupler"] + values["rocker"] >= values["crank"] + values["frame"]
    told = str(design_tables.design_result(result))
    assert f"free, 20 ... 50: {1e3 * values['coupler'] - 50.0:.4g} mm beyond" in told
