"""Shadow prices where gradients of active limits are linearly dependent, against designs for limits moved by a little."""

import math
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pytest

import optlink
from optlink.optimization.multipliers import MultiplierSet
from optlink.presentation.views.search_tables import active
from optlink.presentation.views.sensitivity import charts
from optlink.solvers.solution import LimitState
from optlink.studies.sensitivity import of_solution
from tests.presentation.test_function_tables import words

STEP = 1e-4  # mm, deg


def states(result: Any) -> dict[str, LimitState]:
    return {limit.name: limit for limit in result.solution.displayed_limits if limit.active}


def with_limits(coupler: float, rocker: float, angle: float, alignment: float = 1.0) -> Any:
    """Crank-rocker whose two free links are limited by three limits [mm, deg]."""
    changes = {
        "mechanism.coupler": {"bounds": ["100 mm", f"{coupler!r} mm"]},
        "mechanism.rocker": {"bounds": [f"{rocker!r} mm", "900 mm"]},
        "limits.transmission_angle": ["45 deg", f"{angle!r} deg"],
        "limits.alignment": f"{alignment!r} deg",
    }
    return optlink.solve(optlink.load("crank-rocker").override(changes))


@pytest.mark.slow
def test_each_of_three_limits_in_two_variables_has_the_price_of_relaxing_it_alone() -> None:
    rocker = 1e3 * with_limits(400.0, 100.0, 135.0).solution.design["rocker"]
    result = with_limits(400.0, rocker, 135.0)
    coupler, shortest, angle = (states(result)[name] for name in ("coupler", "rocker", "largest transmission angle"))
    gains = [
        (result.objective - with_limits(*moved).objective) / STEP
        for moved in (
            (400.0 + STEP, rocker, 135.0),
            (400.0, rocker - STEP, 135.0),
            (400.0, rocker, 135.0 + STEP),
            (400.0 + STEP, rocker - STEP, 135.0 + STEP),
        )
    ]
    prices = [abs(limit.multiplier) for limit in (coupler, shortest, angle)]
    assert prices == pytest.approx(gains[:3], rel=1e-4, abs=1e-9)
    assert coupler.joint_gain == pytest.approx(gains[3], rel=1e-4)
    assert gains[3] > 2.0 * sum(gains[:3])
    assert set(coupler.depends_on) == {"rocker", "largest transmission angle"}
    text = words(active(result.problem.model, result.objective, result.solution.displayed_limits))
    assert "coupler, rocker and largest transmission angle hold together: the objective improves by 0.00108 rad^2" in text


def test_of_opposite_limits_the_one_that_limits_has_the_whole_price() -> None:
    """A link between two equal bounds of different keys: only the relaxation of one of them has an effect."""
    free = with_limits(400.0, 100.0, 135.0)
    rocker = 1e3 * free.solution.design["rocker"]
    changes = {"mechanism.rocker": {"bounds": ["100 mm", f"{rocker!r} mm"]}}
    result = optlink.solve(free.problem.override(changes))
    for name in ("coupler", "largest transmission angle"):
        assert states(result)[name].multiplier == pytest.approx(states(free)[name].multiplier, rel=1e-9)
        assert not states(result)[name].depends_on
    assert states(result)["rocker"].multiplier == 0.0


def slider(transmission: float, alignment: float) -> Any:
    """Slider-crank whose transmission angle is limited by two keys [deg]."""
    changes = {"limits.transmission_angle": {"min": f"{transmission!r} deg"}, "limits.alignment": f"{alignment!r} deg"}
    return optlink.solve(optlink.load("law-slider-crank").override(changes)).best


def rocker(transmission: float, alignment: float) -> Any:
    """Crank-rocker whose largest transmission angle is limited by two keys [deg]."""
    return with_limits(900.0, 100.0, 180.0 - transmission, alignment)


@pytest.mark.parametrize(
    ("design", "at", "joint"), [pytest.param(slider, 30.0, 0.0372368e-6, marks=pytest.mark.slow), (rocker, 45.0, 1.464696e-4)]
)
def test_relaxing_one_of_two_equal_limits_gains_nothing(design: Callable[[float, float], Any], at: float, joint: float) -> None:
    result = design(at, at)
    twins = [limit for limit in states(result).values() if limit.depends_on]
    assert [limit.multiplier for limit in twins] == [0.0, 0.0]
    assert {limit.name for limit in twins} == {limit.depends_on[0] for limit in twins}
    together = (result.objective - design(at - STEP, at - STEP).objective) / STEP
    assert [limit.joint_gain for limit in twins] == pytest.approx([together] * 2, rel=1e-3)
    assert together == pytest.approx(joint, rel=1e-3)
    alone = [design(at - STEP, at), design(at, at - STEP)]
    assert [other.objective for other in alone] == pytest.approx([result.objective] * 2, rel=1e-9)
    model = getattr(result, "task", None) or result.problem.model
    text = words(active(model, result.objective, result.solution.displayed_limits))
    assert text.count("no effect alone") == 2
    assert text.count("hold together") == 1


@pytest.mark.slow
def test_sensitivities_of_dependent_limits_are_those_of_an_increase() -> None:
    result = slider(30.0, 30.0)
    file = optlink.load("law-slider-crank").override(
        {"limits.transmission_angle": {"min": "30 deg"}, "limits.alignment": "30 deg"}
    )
    found = of_solution(file, result.solution)
    rows = found.displayed
    tightened = [slider(30.0 + STEP, 30.0), slider(30.0, 30.0 + STEP)]
    for key, other in zip(("limits.transmission_angle.min", "limits.alignment"), tightened, strict=True):
        row = rows[key]
        assert row.objective == pytest.approx((other.objective - result.objective) / STEP, rel=1e-3)
        longer = 1e3 * (other.solution.design["rod.length"] - result.solution.design["rod.length"])
        assert row.design["rod.length"] == pytest.approx(longer / STEP, rel=1e-3)
        assert row.below.value == pytest.approx(30.0, abs=1e-9)
        assert row.above.value > 40.0
    assert found.notes[0].startswith("active limits depend on one another: derivatives are of an increase of ")
    more, less = charts(found)[0].panels[0].traces
    tightened_only = [row.parameter.key in ("limits.transmission_angle.min", "limits.alignment") for row in rows.moving[:3]]
    assert less.y.tolist() == [0.0 if only else -effect for only, effect in zip(tightened_only, more.y, strict=True)]


@pytest.mark.slow
def test_an_exact_length_at_its_bound_cannot_be_raised_alone() -> None:
    """Relaxing the bound changes nothing; a longer frame, which would be better, exceeds the bound."""

    def with_frame(exactly: str, most: str) -> Any:
        changes = {
            "mechanism.frame": {"bounds": ["400 mm", most], "start": "480 mm"},
            "limits.frame_length": {"exactly": exactly},
        }
        return optlink.solve(optlink.load("crank-rocker").override(changes))

    result = with_frame("500 mm", "500 mm")
    assert states(result)["frame"].multiplier == 0.0
    assert states(result)["frame length"].multiplier == math.inf
    assert with_frame("500 mm", "501 mm").objective == pytest.approx(result.objective, rel=1e-9)
    assert with_frame("501 mm", "500 mm").status.value == "infeasible"
    assert "frame length = 500 mm cannot be raised alone" in words(
        active(result.problem.model, result.objective, result.solution.displayed_limits)
    )
    assert result.to_dict()["limits"][-1]["multiplier"] is None


def test_an_equality_that_another_limit_keeps_from_rising_has_an_infinite_price() -> None:
    """x = 1 and x <= 1: the equality cannot be raised alone."""
    every = MultiplierSet(np.array([1.0, 0.0]), np.array([[1.0], [-1.0]]), np.array([0.0, 1.0]))
    least = partial(MultiplierSet.least, every)
    assert least(np.array([1.0, 0.0]))[0] == -np.inf
    assert least(np.array([0.0, 1.0]))[0] == 0.0
    assert least(np.array([1.0, 1.0]))[0] == 1.0


def test_the_sets_of_optima_with_and_without_active_limits_have_the_same_shapes() -> None:
    """Three limits with independent gradients, of which the first ones are active."""
    gradients, sign, multipliers = np.eye(3, 4), np.array([1.0, -1.0, 0.0]), np.array([0.5, -2.0, 0.0])
    for count in range(4):
        every = MultiplierSet.from_gradients(gradients, multipliers, np.arange(3) < count, sign)
        assert every.directions.shape == (3, 0)
        assert every.sign.shape == (3,)
        assert every.least(np.array([1.0, 2.0, 3.0])) == (-3.5, pytest.approx(multipliers))
    assert MultiplierSet.unique(multipliers).least(np.array([1.0, 2.0, 3.0]))[0] == -3.5
