"""What all studies have in common: mappings in SI or with units as arguments, tables in SI, one meaning of `best`."""

from __future__ import annotations

import math
import re
from functools import cache

import numpy as np
import pytest

import optlink
from optlink.errors import InputError
from optlink.studies import Tolerance, pareto, sensitivities, sweep, tolerance

LAW = optlink.load("crank-rocker")
LIMIT = "limits.transmission_angle.max"
DESIGN = {"coupler": 0.41, "rocker": 0.232}


@cache
def front():
    return pareto(LAW, {"error": None, LIMIT: np.radians([125.0, 130.0, 135.0])}, workers=1)


def of_tolerances(tolerances, limit) -> Tolerance:
    return tolerance(LAW, tolerances, limit=limit, design=DESIGN, samples=256)


@pytest.mark.slow
def test_a_front_takes_the_values_of_a_limit_as_an_array_or_a_text():
    other = pareto(LAW, f"error, {LIMIT}=125..135 deg", points=3, workers=1)
    assert front().grid == other.grid
    assert front().columns == other.columns
    listed = pareto(LAW, {"error": None, LIMIT: ["125 deg", "130 deg", "135 deg"]}, workers=1)
    assert listed.columns == other.columns


def test_tolerances_and_their_limit_are_numbers_in_si_or_texts():
    texts = of_tolerances(["coupler=0.1 mm", "rocker=0.2 mm uniform"], "2.5 deg")
    stated = of_tolerances({"coupler": 1e-4, "rocker": "0.2 mm uniform"}, math.radians(2.5))
    assert stated.deviations == texts.deviations
    assert stated.limit == pytest.approx(texts.limit, rel=1e-14)
    assert stated.monte_carlo.good == texts.monte_carlo.good


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: sweep(LAW, {}), 'vary: no parameter is varied. Give for example vary={"mechanism.frame": "450..550 mm:101"}'),
        (lambda: sweep(LAW, {"mechanism.frme": [0.5]}), 'vary.mechanism.frme: unknown key. Did you mean "frame"?'),
        (lambda: sweep(LAW, ["title=a,b"]), "Run it once for each word, with overrides and another out"),
        (lambda: of_tolerances({"cupler": 1e-4}, None), 'tolerances.cupler: unknown dimension. Did you mean "coupler"?'),
        (lambda: of_tolerances({"coupler": None}, None), "tolerances.coupler: not a number"),
        (lambda: of_tolerances({"coupler": 500.0}, None), "tolerances.coupler = 500.0: 500 m are 556 times the largest length"),
        (lambda: of_tolerances({"coupler": 1e-4}, "0.5"), 'limit = "0.5": an angle needs a unit'),
        (lambda: tolerance(LAW, {"coupler": 1e-4}, crank_angles=np.array([0.1]), design=DESIGN), "crank_angles: the error is"),
        (lambda: pareto(LAW, {"error": None}), "one objective has no trade-off"),
        (
            lambda: pareto(LAW, {"error": [1.0, 2.0], LIMIT: None}, points=3),
            "error has no range: it is minimised. Leave the range out",
        ),
        (lambda: pareto(LAW, {"error": None, LIMIT: [125.0, 135.0]}), f"objectives.{LIMIT} = 135.0: 135 rad are 21.5 turns"),
        (lambda: pareto(LAW, {"error": None, LIMIT: [2, 3]}), 'an angle needs a unit. Write "2 deg" or "2 rad"'),
    ],
)
def test_errors_of_studies_name_the_argument(call, message):
    with pytest.raises(InputError, match=re.escape(message)) as caught:
        call()
    assert "--" not in str(caught.value)


def test_best_is_a_row_of_the_table_of_a_study_on_a_grid():
    swept = sweep(LAW, {"mechanism.frame": [0.48, 0.5]})
    assert swept.best["mechanism.frame_m"] == 0.5
    assert front().best == {name: column[front().knee[0]] for name, column in front().columns.items()}
    assert front().best["mark"] == "knee"
    analysed = sweep(optlink.load("six-bar"), {"mechanism.links.link2.length": [1.1, 1.2]}, analyze=True)
    assert analysed.best is None


def test_a_design_of_a_front_is_one_for_validate():
    for point in front().points:
        found = optlink.validate(LAW, dict(point.design))
        assert found.objective == pytest.approx(point.values[0], rel=1e-9)


@pytest.mark.parametrize(
    ("make", "units"),
    [
        (
            lambda: sweep(optlink.load("six-bar"), {"mechanism.links.link2.length": [1.1, 1.2]}, analyze=True),
            {"mechanism.links.link2.length_m": "m", **{f"input.torque_Nm.{kind}": "N m" for kind in ("min", "max", "rms")}},
        ),
        (lambda: front(), {"error_rad2": "rad²", "largest_transmission_angle_rad": "rad", "coupler_m": "m", "rocker_m": "m"}),
        (
            lambda: tolerance(LAW, {"coupler": 1e-4}, design=DESIGN, samples=0),
            {
                "crank_deg": "deg",
                **{f"{name}_rad": "rad" for name in ("value", "judged", "worst_low", "worst_high", "rss", "sigma", "shift")},
                "coupler_percent": "%",
            },
        ),
    ],
)
def test_frames_have_the_units_of_their_columns(make, units):
    assert make().to_frame().attrs["units"] == units


def test_tables_of_studies_are_in_si():
    result = tolerance(LAW, {"coupler": 1e-4}, design=DESIGN, samples=0)
    assert np.array_equal(result.columns["sigma_rad"], result.sigma)
    assert np.array_equal(result.to_frame()["value_rad"], result.nominal.value)
    found = sensitivities(LAW)
    table = found.to_frame()
    assert table["objective_per_unit"].tolist() == [row.objective for row in found.rows]
    assert table["coupler_m_per_unit"].tolist() == [row.design["coupler"] for row in found.rows]
    assert set(table["unit"]) <= {"m", "rad", ""}


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: optlink.load("crank-rocker", {"mechanism.frame": 480.0}), "mechanism.frame = 480.0: 480 m are 533 times"),
        (lambda: LAW.override({"limits.transmission_angle": [45.0, 135.0]}), "Numbers are SI: 135 deg are 2.35619, or the text"),
        (lambda: optlink.validate(LAW, {"coupler": 412, "rocker": 232}), "design.coupler = 412.0: 412 m are 458 times"),
        (lambda: optlink.analyze("six-bar", design={"crank.length": 100}), "design.crank.length = 100.0: 100 m are 66.7"),
        (lambda: optlink.analyze_batch("six-bar", {"crank.length": [100, 110]}), "designs.crank.length = 110.0: 110 m are 73.3"),
        (lambda: optlink.validate("path-arc5", dict.fromkeys(optlink.load("path-arc5").model.free, 40.0)), "Numbers are SI: 40 "),
    ],
)
def test_numbers_in_millimetres_or_degrees_are_refused(call, message):
    with pytest.raises(InputError, match=re.escape(message)):
        call()


def test_large_values_have_texts_with_units():
    """A linkage a thousand times as large may be meant, and then has its unit."""
    assert LAW.override({"mechanism.frame": "500 m"}).model.quantities["frame"].value == 500.0
    assert LAW.override({"mechanism.frame": 8.9}).model.quantities["frame"].value == 8.9


def test_statuses_and_notes_are_not_in_the_words_of_commands():
    """They are attributes of results, which Python shows as they are."""
    notes = optlink.analyze("crank-rocker").notes
    assert any(note.startswith("design variables are at their start values") for note in notes)
    assert not [text for text in (*(status.text for status in optlink.Status), *notes) if "--" in text]
