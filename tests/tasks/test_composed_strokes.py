"""Targets together with strokes, time ratios and loads that act in one stroke; see `oracles.composed_problems`."""

from __future__ import annotations

import copy
from typing import Any

import numpy as np
import pytest

import optlink
from optlink.optimization.programme import build
from optlink.solvers import exchange
from optlink.studies import sensitivities
from optlink.studies.target_programme import TargetProgramme
from optlink.tasks.search import DesignOrders
from tests.oracles import composed_problems as composed
from tests.tasks.test_composed import dimensions, measured

SWING = {"quantity": "stroke", "of": "rocker", "max": "50 deg"}


def smallest(**limits: Any) -> optlink.ProblemFile:
    """The law of a crank-rocker with a free crank."""
    raw = copy.deepcopy(dict(optlink.load("law-smallest-machine").raw))
    raw["mechanism"]["crank"] = {"start": "100 mm", "bounds": ["50 mm", "200 mm"]}
    raw["limits"].update(limits)
    return optlink.read(raw)


def pressing(**changes: Any) -> optlink.ProblemFile:
    """A slider-crank that returns at constant speed over a quarter turn, and pushes against a force on its way out."""
    raw = copy.deepcopy(dict(optlink.load("law-slider-crank").raw))
    raw["mechanism"]["guides"]["G"]["offset"] = {"bounds": ["0 mm", "40 mm"]}
    raw["requirement"]["tolerance"] = "3 mm"
    raw["drive"] = {"speed": "60 rpm"}
    raw["loads"] = {"cutting": {"on": "slider", "force": "1000 N", "acts": "opposing", "stroke": "forward"}}
    raw["objective"] = {"quantity": "torque"}
    raw["limits"]["travel"] = {"quantity": "stroke", "of": "slider", "exactly": "60 mm"}
    raw["limits"]["ratio"] = {"quantity": "time ratio", "of": "slider", "stroke": "backward", "min": 1.1}
    return optlink.read(raw | changes)


@pytest.mark.slow
def test_a_law_and_the_swing_of_its_output() -> None:
    result, own = optlink.solve(smallest(swing=SWING), "both"), composed.smallest_machine_of_swing(50.0)
    assert result.valid
    assert 1e3 * result.objective == pytest.approx(own.optimum + 500.0, rel=1e-7)
    for name, length in own.figures.items():
        assert 1e3 * result.design[name] == pytest.approx(length, abs=1e-2)
    assert measured(result, "swing: stroke of rocker") == pytest.approx(50.0, abs=1e-8)


@pytest.mark.slow
def test_a_law_and_a_time_ratio_of_either_stroke() -> None:
    """Linkages whose forward stroke is the slow one, and those whose backward stroke is, have programmes of their own."""
    raw = copy.deepcopy(dict(smallest().raw))
    stroke = {"kind": "stroke", "output": "rocker", "stroke": ["20 deg", "50 deg"], "time_ratio": {"min": 1.1}}
    raw["requirements"] = [raw.pop("requirement"), stroke]
    result, own = optlink.solve(optlink.read(raw)), composed.smallest_machine_of_swing(50.0, 1.1)
    assert result.valid
    assert 1e3 * result.objective == pytest.approx(own.optimum + 500.0, rel=1e-7)
    assert measured(result, "stroke.time_ratio: time ratio of rocker") == pytest.approx(1.1, abs=1e-8)


@pytest.mark.slow
def test_least_torque_of_a_law_with_a_force_in_one_stroke() -> None:
    result, own = optlink.solve(pressing(), "slsqp"), composed.slider_crank_against_a_force()
    assert result.valid
    assert result.objective == pytest.approx(own.optimum, rel=1e-9)
    for name, key in (("crank", "crank.length"), ("rod", "rod.length"), ("offset", "G.offset")):
        assert 1e3 * result.design[key] == pytest.approx(own.figures[name], abs=1e-4)
    again = optlink.validate(result.best.problem, result.design)
    assert again.valid
    assert again.objective == pytest.approx(result.objective, rel=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("measure", ["peak", "rms"])
def test_least_torque_with_a_force_tabulated_over_the_slide(measure: str) -> None:
    """The rows of the table that the slider passes divide the stroke; which it passes follows from the design."""
    raw = copy.deepcopy(dict(pressing(objective={"quantity": "torque", "measure": measure}).raw))
    at, values = [60.0, 120.0, 160.0], [500.0, 1000.0, 200.0]
    table = {"over": "s", "at": [f"{place} mm" for place in at], "values": [f"{force} N" for force in values]}
    raw["loads"]["cutting"]["force"] = table
    raw["bodies"] = {"slider": {"mass": "20 kg"}}
    result, own = (
        optlink.solve(optlink.read(raw), "slsqp"),
        composed.slider_crank_against_a_force(measure, at, values, 20.0, 2400),
    )
    assert result.valid
    assert result.objective == pytest.approx(own.optimum, rel=2e-7)
    for name, key in (("crank", "crank.length"), ("rod", "rod.length"), ("offset", "G.offset")):
        assert 1e3 * result.design[key] == pytest.approx(own.figures[name], abs=1e-2)


@pytest.mark.slow
def test_work_in_the_forward_stroke_is_the_force_times_the_stroke() -> None:
    """Without masses the drive gives exactly that, so the least stroke is the optimum: the same as minimising the stroke."""
    work = {"quantity": "work", "of": "slider", "stroke": "forward"}
    ratio = {"quantity": "time ratio", "of": "slider", "stroke": "backward", "min": 1.1}
    limits = {"alignment": "30 deg", "ratio": ratio}
    one = optlink.solve(pressing(objective=work, limits=limits), "slsqp")
    other = optlink.solve(pressing(objective={"quantity": "stroke", "of": "slider"}, limits=limits), "slsqp")
    assert one.valid
    assert other.valid
    assert one.objective == pytest.approx(1000.0 * other.objective, rel=1e-7)


@pytest.mark.slow
def test_least_torque_within_a_distance_of_the_path_with_a_load_in_one_stroke() -> None:
    """The best of both assembly modes; the load on the rocker acts while it turns counter-clockwise."""
    raw = copy.deepcopy(dict(optlink.load("least-torque").raw))
    raw["loads"] = {"push": {"on": "rocker", "torque": "1 N*m", "acts": "opposing", "stroke": "forward"}}
    result = optlink.solve(optlink.read(raw), starts=60)
    assert result.valid
    x, opposing = dimensions(result), 1.0 if result.best.assembly == "right" else -1.0
    assert composed.peak_torque(x, opposing) == pytest.approx(result.objective, rel=1e-9)
    assert composed.peak_torque(x) != pytest.approx(result.objective, rel=0.01)  # without the load
    own = min(composed.least_torque(0.5, starts=2, opposing=way).optimum for way in (1.0, -1.0))
    assert result.objective == pytest.approx(own, rel=1e-8)


# --- the order of the ends of strokes --------------------------------------------------------------------------------------


def test_a_design_has_the_ends_of_its_strokes() -> None:
    """The unknown crank angles of a design are its dead centres by the triangles; they are no part of the design."""
    nlp = build(smallest(swing=SWING).spec)
    design = {"crank": 0.12, "coupler": 0.40, "rocker": 0.30}
    events = nlp.x_of(design)[nlp.first_event : nlp.first_level]
    at = [np.arccos((0.25 + reach**2 - 0.09) / reach) for reach in (0.52, 0.28)]
    assert sorted(np.remainder(events, 2.0 * np.pi)) == pytest.approx(sorted([at[0], np.pi + at[1]]), abs=1e-9)
    assert {nlp.variables[k].name for k in range(nlp.first_event, nlp.first_level)} <= nlp.states & nlp.helpers


def test_a_design_with_further_dead_centres_does_not_fit_its_programme() -> None:
    """The rocker of a double-crank never reverses, and a design of a crank-rocker has the order of its programme."""
    orders = DesignOrders(smallest(swing=SWING))
    trace, structure, design = orders.of({"crank": 0.12, "coupler": 0.40, "rocker": 0.30})
    assert exchange.misfit(trace, structure, design) == ""
    assert exchange.misfit(trace, structure, {"crank": 0.8, "coupler": 0.7, "rocker": 0.8}) == exchange.FURTHER


def test_the_validator_finds_a_wrong_stroke_by_itself() -> None:
    """A planted design: the swing by the triangles of the dead centres exceeds what is permitted."""
    design = {"crank": 0.14, "coupler": 0.40, "rocker": 0.30}
    checked = optlink.validate(smallest(swing=SWING), design)
    at_d = [np.arccos((0.25 + 0.09 - reach**2) / 0.3) for reach in (0.54, 0.26)]
    swing = np.degrees(at_d[0] - at_d[1])
    assert swing > 50.0
    assert "swing: stroke of rocker" in checked.validation.failed
    assert measured(checked, "swing: stroke of rocker") == pytest.approx(swing, abs=1e-8)


def test_an_output_that_never_reverses_is_named() -> None:
    raw = copy.deepcopy(dict(smallest(swing=SWING).raw))
    raw["mechanism"] |= {"crank": {"bounds": ["700 mm", "900 mm"]}, "frame": "100 mm", "coupler": "750 mm", "rocker": "760 mm"}
    raw["limits"] |= {"crank": "double-crank"}
    raw["requirement"]["from"] = "60 deg"
    with pytest.raises(optlink.errors.InputError, match="rocker never reverses"):
        optlink.solve(optlink.read(raw))


# --- studies ---------------------------------------------------------------------------------------------------------------


def test_a_programme_takes_the_limits_of_another_problem() -> None:
    """Bounds of named limits too, which a sweep varies."""
    programme, other = TargetProgramme(pressing().spec, 1, "slsqp"), pressing().override({"limits.ratio.min": 1.2})
    assert programme.bind(other.override({"limits.travel.exactly": "63 mm"}).spec)
    nlp = programme.nlp
    bounds = {row.limit: (row.scale, low, high) for row, low, high in zip(nlp.rows, nlp.low, nlp.high, strict=True)}
    scale, low, high = bounds["limits.travel"]
    assert [scale.to_display(end) for end in (low, high)] == pytest.approx([63.0, 63.0], rel=1e-12)
    scale, low, high = bounds["limits.ratio"]
    assert scale.to_display(low) == pytest.approx(1.2, rel=1e-12)
    assert high == np.inf


@pytest.mark.slow
def test_derivatives_by_strokes_are_those_of_new_searches() -> None:
    result = sensitivities(pressing(), "slsqp", starts=60, check=True)
    assert {row.parameter.key for row in result.moving} >= {"limits.travel", "limits.ratio.min"}
    assert result.gap < 1e-6
