"""Variables of the programmes: each has the key that its quantity has in the problem file."""

from __future__ import annotations

import pytest

from optlink.optimization.nlp import scaled_variable
from optlink.optimization.parameters import path_variable
from optlink.problem.file import load

EXPECTED = {
    "path-watt-leg": {
        "rod.length": "mechanism.links.rod.length",
        "leg.P.across": "mechanism.links.leg.points.P.across",
        "D.x": "mechanism.ground.D.x",
    },
    "path-vline6": {"coupler": "mechanism.coupler", "A.x": "mechanism.pivot.x", "P.along": "mechanism.points.P.along"},
}


@pytest.mark.parametrize("name", EXPECTED)
def test_variables_have_the_keys_of_the_file(name):
    file = load(name)
    for quantity, key in EXPECTED[name].items():
        assert path_variable(file.model, quantity).key == key


@pytest.mark.parametrize("name", ["shaper-design", "press-toggle", "stroke-crank-rocker"])
def test_every_key_of_a_cycle_problem_can_be_changed(name):
    file = load(name)
    for quantity in file.model.mechanism.quantities:
        key = scaled_variable(file.model, quantity, 1.0, periodic=False).key
        value = file.model.quantities[quantity]
        changed = file.override({key: f"{value.value / value.si_per_unit!r} {value.display[1]}"})
        assert quantity not in changed.model.free
