"""What is shown of a certificate: table, status, conclusion, pictures, pages of stored results, damaged files."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, strategies as st
from matplotlib.collections import PolyCollection

import optlink
from optlink.presentation import chart_mpl
from optlink.presentation.html import chart_plotly
from optlink.presentation.registry import read_result, table_of, view_of
from optlink.presentation.views import conclusions, search_tables
from optlink.problem.machine.model import ShownObjective
from optlink.tasks.certify import certify
from optlink.tasks.results.certificate import MOST_DRAWN, Certificate
from optlink.tasks.results.common import Optimum, evidence
from tests.presentation.test_function_tables import words

OPPOSED = {"limits.transmission_angle.min": "80 deg", "limits.transmission_angle.max": "100 deg"}


def shown(result) -> str:
    return words(table_of(result.kind)(result))


def charts(result):
    return {chart.file: chart for chart in view_of("design").charts(result)}


@pytest.fixture(scope="module")
def solved():
    return optlink.solve(optlink.load("crank-rocker"))


@pytest.fixture(scope="module")
def opposed():
    return optlink.solve(optlink.load("crank-rocker").override(OPPOSED))


@pytest.fixture(scope="module")
def unfinished(solved):
    return certify(solved, boxes=40)


def test_a_closed_proof_takes_the_place_of_statistics(solved):
    many = replace(solved, starts=20, evidence=evidence((12, 2)), optima=(Optimum(solved.design, solved.objective, 18),))
    text = shown(many)
    assert "Global optimum best design 0.00759237" in text
    assert "lower bound 0.00759236" in text
    assert "rounding errors are included" in text
    assert "globally optimal within the bounds: no design is better by more than 0.0001 %" in text
    for other in ("local optimum", "--starts", "starts reached", "not closed", "--certify"):
        assert other not in text
    assert "12 of 20 starts reached" in shown(replace(many, certificate=None))
    assert solved.to_dict()["message"] == solved.certificate.text
    assert "within 0.0001 %" in repr(solved)
    assert solved.certificate.text in solved._repr_html_()
    assert "It is proven that no design within the bounds is better by more than 0.0001 %." in conclusions.design(many, ())


def test_infeasibility_is_proven(opposed):
    text = shown(opposed)
    assert "exclude each other." in text or "cannot be met" in text
    assert "no feasible design proven: no design within the bounds meets all limits" in text
    assert "Global optimum boxes" in text
    assert "best design" not in text
    assert "lower bound" not in text
    assert opposed.to_dict()["message"] == f"{opposed.refuted} Proven: no design within the bounds meets all limits."
    unnamed = shown(replace(opposed, conflict=(), together=()))
    assert "proven: no design within the bounds meets all limits; relax a limit whose check fails" in unnamed
    assert "Active constraints" not in unnamed  # no design is determined by them
    assert "It is proven that no design within the bounds meets all limits." in conclusions.design(opposed, ())
    assert repr(opposed).endswith("proven>")


def test_an_open_proof_states_its_bound_and_how_to_continue(unfinished):
    text = shown(unfinished)
    assert "a local optimum" in text
    assert "gap 100 % largest share by which a design could be better, 0.0001 % was required" in text
    assert f"{unfinished.certificate.open_boxes} of them left" in text
    assert search_tables.CONTINUE in text
    assert "proven" not in conclusions.design(unfinished, ())
    assert unfinished.to_dict()["message"].startswith("a local optimum")
    assert "better than that of the local search" not in text
    computed = replace(unfinished, certificate=replace(unfinished.certificate, improved=True))
    assert "better than that of the local search" in shown(computed)


def test_a_path_certificate_has_display_units():
    design = {"crank": 0.0467, "coupler": 0.1162, "rocker": 0.0739}
    result = optlink.validate(optlink.load("transmission-optimal"), design)
    proof = Certificate("within gap", 0.79, 0.789999, 1e-4, 7000, 0, ("crank", "coupler", "rocker"))
    text = shown(replace(result, certificate=proof))
    best, bound = (math.degrees(math.asin(cosine)) for cosine in (0.79, 0.789999))
    lower = math.floor(1e6 * bound) / 1e6
    assert f"Global optimum best design {best:.8g} deg transmission angle from 90 deg lower bound {lower:.8g} deg" in text
    assert "no design is better by more than 0.00013 %" in text


def test_an_exact_design_has_no_gap():
    proof = Certificate("global", 1e-24, 0.0, 1e-6, 0, 0, ("coupler",))
    text = words(search_tables.certificate_table(proof, lambda value: ShownObjective(value, 1.0, "rad^2"), {}))
    assert "%" not in text + proof.text + proof.brief + search_tables.clause(proof)
    assert "no design can be better" in proof.text


@given(st.floats(1e-12, 1e6), st.integers(6, 14))
def test_a_lower_bound_is_rounded_down(value, digits):
    text = search_tables.rounded_down(value, digits)
    assert value * (1.0 - 10.0 ** (1 - digits)) <= float(text) <= value


# --- pictures ------------------------------------------------------------------------------------------------------------------


def test_the_boxes_cover_the_bounds_once_and_one_holds_the_design(solved):
    chart = charts(solved)["boxes"]
    [panel] = chart.panels
    x, y = (np.concatenate([getattr(trace, way) for trace in panel.traces]) for way in "xy")
    assert len(x) == len(solved.certificate.covers[0].test)
    area = float(np.sum((x[:, 1] - x[:, 0]) * (y[:, 1] - y[:, 0])))
    assert area == pytest.approx(800.0 * 800.0, rel=1e-9)
    [mark] = panel.marks
    assert (mark.x, mark.y) == pytest.approx((412.865, 232.246), abs=1e-3)
    assert np.any((x[:, 0] <= mark.x) & (mark.x <= x[:, 1]) & (y[:, 0] <= mark.y) & (mark.y <= y[:, 1]))
    assert chart.x.name == "coupler [mm]"
    drawn = chart_mpl.draw([chart]).findobj(PolyCollection)
    assert sum(len(one.get_paths()) for one in drawn) == len(x)
    traces = [trace for trace in chart_plotly.chart(chart).figure["data"] if trace.get("fill") == "toself"]
    assert sum(trace["x"].count(None) for trace in traces) == len(x)


def test_an_infeasible_problem_has_boxes_and_no_design(opposed):
    computed = charts(opposed)
    assert computed["boxes"].panels[0].marks == []
    assert "bounds" not in computed


def test_the_bounds_meet_at_the_end(solved):
    best, lower = charts(solved)["bounds"].panels[0].traces
    assert np.all(np.diff(lower.y) >= 0.0)
    assert np.all(np.diff(best.y) <= 0.0)
    assert lower.y[-1] == solved.certificate.lower_bound
    assert best.y[-1] == solved.objective
    assert lower.x[-1] == solved.certificate.boxes


def test_no_charts_without_a_cover(solved, unfinished):
    assert "boxes" not in charts(unfinished)
    assert "bounds" not in charts(unfinished)
    [cover] = solved.certificate.covers
    many = {name: np.repeat(getattr(cover, name), MOST_DRAWN // len(cover.test) + 1, axis=0) for name in ("low", "high", "test")}
    large = replace(solved, certificate=replace(solved.certificate, covers=(replace(cover, **many),)))
    assert "boxes" not in charts(large)
    assert not {"boxes", "bounds"} & set(charts(replace(solved, certificate=None)))


# --- stored results ------------------------------------------------------------------------------------------------------------


def stored(result, folder):
    """The result of its file."""
    path = folder / "result.json"
    path.write_text(json.dumps(result.to_dict()), encoding="utf-8")
    return read_result(path)


def test_a_stored_certificate_is_that_of_the_result(solved, tmp_path):
    result = stored(solved, tmp_path).certificate
    assert (result.text, result.lower_bound, result.boxes) == (
        solved.certificate.text,
        solved.certificate.lower_bound,
        solved.certificate.boxes,
    )
    assert np.array_equal(result.history, solved.certificate.history)
    for name in ("low", "high", "test"):
        assert np.array_equal(getattr(result.covers[0], name), getattr(solved.certificate.covers[0], name))
    assert {"boxes", "bounds"} <= set(charts(stored(solved, tmp_path)))


def test_a_result_contains_what_is_drawn_of_a_proof(solved, tmp_path):
    """The boxes of two design variables, unless there are too many to draw; certificate.json has all of them."""
    assert len(json.dumps(solved.to_dict(), indent=2)) < 60_000
    [cover] = solved.certificate.covers
    many = {
        name: np.repeat(getattr(cover, name), MOST_DRAWN // len(cover.test) + 1, axis=0)
        for name in ("low", "high", "test", "multipliers")
    }
    large = replace(solved, certificate=replace(solved.certificate, covers=(replace(cover, **many),)))
    again = stored(large, tmp_path)
    assert again.certificate.covers == ()
    assert "boxes" not in charts(large)
    assert set(charts(again)) == set(charts(large))


def test_a_stored_infeasible_certificate_is_restored(opposed, tmp_path):
    result = stored(opposed, tmp_path).certificate
    assert result.status == "infeasible"
    assert math.isinf(result.lower_bound)


def test_a_changed_certificate_is_refused_in_a_sentence(solved, tmp_path):
    document = json.loads(json.dumps(solved.to_dict()))
    document["certificate"]["lower_bound"] *= 1.001
    (tmp_path / "result.json").write_text(json.dumps(document), encoding="utf-8")
    with pytest.raises(optlink.InputError, match="the result was changed since it was written") as refused:
        read_result(tmp_path)
    assert "\n" not in str(refused.value)
