"""Unknown names, and the remedy that names what is meant, if a known name is similar."""

from __future__ import annotations

import json

import numpy as np
import pytest

import optlink
from optlink.errors import InputError


@pytest.mark.parametrize(
    ("problem", "change", "remedy"),
    [
        ("shaper-design", {"objective.measure": "lagest"}, 'Did you mean "largest"'),
        ("crank-rocker", {"crank": "90 mm"}, 'Did you mean "mechanism.crank"'),
        ("shaper-design", {"coupler.length": "150 mm"}, 'Did you mean "mechanism.links.coupler.length"'),
        ("six-bar", {"mechanism.type": "sliding"}, "(slider-crank, six-bar and others: `optlink new --list`)"),
        ("crank-rocker", {"requirement.kind": "stance"}, "unknown kind. Known: function, path, "),
        ("six-bar", {"bodies.link3.inertias": "0.1 kg*m^2"}, 'Did you mean "inertia"'),
        ("six-bar", {"mechanism.guides.F.Direction": "3 deg"}, 'Did you mean "direction"'),
        ("six-bar", {"constraints": {}}, "constraints: unknown key. Known: "),
        ("six-bar", {"guides": {}}, 'Did you mean "mechanism.guides"'),
        ("six-bar", {"mechanism.guides.F.direction": [1, 0]}, 'Write { bounds = "45..90 deg" }'),
        ("crank-rocker", {"options": {}}, "options: unknown key. Known: "),
        ("balance-four-bar", {"balance.objective": None}, 'Add objective = { quantity = "shaking force"'),
        ("balance-four-bar", {"balance.counterweights": [{}]}, "optlink show balance-four-bar"),
    ],
)
def test_the_remedy_suggests_the_intended_name(problem: str, change: dict[str, object], remedy: str) -> None:
    with pytest.raises(InputError) as error:
        optlink.load(problem).override(change)
    assert remedy in str(error.value)


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


@pytest.mark.parametrize(
    ("changes", "remedy"),
    [
        (
            {"limits.crank": "full rotation"},
            "not a limit of this kind of problem. Leave it out, or limit a quantity",
        ),
        ({"mechanism.guides.K": {"through": ["0 mm", "0 mm"]}}, 'Add slider = "NAME", with the name of the body that slides'),
    ],
    ids=["limit of another kind", "guide without its slider"],
)
def test_the_remedy_fits_the_fault(changes, remedy):
    with pytest.raises(InputError) as refused:
        optlink.load("stroke-slider-crank", changes)
    assert remedy in str(refused.value)


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
