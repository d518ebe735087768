"""Unknown names, and the remedy that names what is meant, if a known name is similar."""

from __future__ import annotations

import json

import numpy as np
import pytest

import optlink
from optlink.errors import InputError


def test_nested_tables_instead_of_a_name_suggest_read() -> None:
    with pytest.raises(InputError, match=r"nested tables to optlink\.read"):
        optlink.load({"mechanism": {"type": "four-bar"}})  # type: ignore[arg-type]


def test_the_shipped_problems_are_in_the_order_of_their_names() -> None:
    assert list(optlink.shipped()) == sorted(optlink.shipped())


def test_an_unknown_column_of_a_result_is_named_with_the_closest() -> None:
    result = optlink.analyze(optlink.load("six-bar"), points=12)
    assert result["input.torque_Nm"].shape == (13,)
    with pytest.raises(KeyError, match=r"no column torque\. Did you mean \"input\.torque_Nm\""):
        _ = result["torque"]


def test_results_with_columns_compare_without_an_error() -> None:
    """Two are equal only if they are the same object: arrays have no truth value."""
    first, second = (optlink.analyze(optlink.load("six-bar"), points=12) for _ in range(2))
    assert first == first
    assert first != second
    assert first.to_dict() == second.to_dict()


def test_numbers_and_lists_of_numpy_are_read_and_recorded_as_those_of_python() -> None:
    points = {"x": np.array([0.0, 30.0, 60.0]), "unit": np.str_("deg")}
    changed = optlink.load("crank-rocker", {"requirement.points": np.int64(20), "mechanism.frame": "480 mm"})
    assert changed.raw["requirement"]["points"] == 20
    assert changed.override({"requirement.points": np.int64(12)}).overrides == {
        "mechanism.frame": "480 mm",
        "requirement.points": 12,
    }
    assert json.loads(json.dumps(optlink.solve(changed).to_dict()))["overrides"]["requirement.points"] == 20
    with pytest.raises(InputError, match=r"requirement\.points = "):
        optlink.load("crank-rocker", {"requirement.points": points})


def test_a_tuple_is_read_as_a_list() -> None:
    assert optlink.load("six-bar", {"gravity": ("0 m/s^2", "-9.81 m/s^2")}).model.gravity == (0.0, -9.81)
    angles = optlink.load("crank-rocker", {"limits.transmission_angle": ("40 deg", "140 deg")})
    assert angles.raw["limits"]["transmission_angle"] == ["40 deg", "140 deg"]
    assert angles.hash == optlink.load("crank-rocker", {"limits.transmission_angle": ["40 deg", "140 deg"]}).hash
