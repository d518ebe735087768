"""What is shown of a certificate: table, status, conclusion, pictures, pages of stored results, damaged files."""

from __future__ import annotations

import copy
import json
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, strategies as st
from matplotlib.collections import PolyCollection

import optlink
from optlink.problem.machine.model import ShownObjective
from optlink.report import chart_mpl
from optlink.report.html import chart_plotly
from optlink.report.registry import table_of, view_of
from optlink.report.stored.loader import load_stored
from optlink.report.views import certificate_view, conclusions
from optlink.tasks.certify import certify
from optlink.tasks.results.certificate import Certificate, certificate_document
from optlink.tasks.results.common import Optimum
from tests.report.test_function_tables import words

OPPOSED = {"limits.transmission_angle.min": "80 deg", "limits.transmission_angle.max": "100 deg"}


def shown(result) -> str:
    return words(table_of(result.problem.task)(result))


def charts(result):
    return {chart.file: chart for chart in view_of("function").charts(result)}


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
    many = replace(solved, starts=20, counts=(12, 2), optima=(Optimum(solved.design, solved.objective, 18),))
    text = shown(many)
    assert "Global optimum best design 0.00759237" in text
    assert "lower bound 0.00759236" in text
    assert "rounding errors are included" in text
    assert "globally optimal within the bounds: no design is better by more than 0.0001 %" in text
    for other in ("local optimum", "--starts", "random starts reached", "not closed", "--certify"):
        assert other not in text
    assert "12 of 14 random starts reached" in shown(replace(many, certificate=None))
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
    assert certificate_view.CONTINUE in text
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
    text = words(certificate_view.certificate_table(proof, lambda value: ShownObjective(value, 1.0, "rad^2"), {}))
    assert "%" not in text + proof.text + proof.brief + certificate_view.clause(proof)
    assert "no design can be better" in proof.text


@given(st.floats(1e-12, 1e6), st.integers(6, 14))
def test_a_lower_bound_is_rounded_down(value, digits):
    text = certificate_view.rounded_down(value, digits)
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
    many = {
        name: np.repeat(getattr(cover, name), certificate_view.MAX_SHOWN_BOXES // len(cover.test) + 1, axis=0)
        for name in ("low", "high", "test")
    }
    large = replace(solved, certificate=replace(solved.certificate, covers=(replace(cover, **many),)))
    assert "boxes" not in charts(large)
    assert not {"boxes", "bounds"} & set(charts(replace(solved, certificate=None)))


# --- stored results ------------------------------------------------------------------------------------------------------------


def stored(document, folder, proof=None):
    path = folder / "result.json"
    path.write_text(json.dumps(document), encoding="utf-8")
    if proof is not None:
        (folder / "certificate.json").write_text(json.dumps(proof), encoding="utf-8")
    return load_stored(str(path))


def test_a_stored_certificate_is_that_of_the_result(solved, tmp_path):
    model = stored(solved.to_dict(), tmp_path, certificate_document(solved.certificate, solved))
    result = model.result.certificate
    assert (result.text, result.lower_bound, result.boxes) == (
        solved.certificate.text,
        solved.certificate.lower_bound,
        solved.certificate.boxes,
    )
    assert np.array_equal(result.history, solved.certificate.history)
    assert np.array_equal(result.covers[0].low, solved.certificate.covers[0].low)
    assert np.array_equal(result.covers[0].test, solved.certificate.covers[0].test)
    assert {"boxes", "bounds"} <= set(charts(model.result))
    assert any("certificate of the global optimum is that of the file" in note for note in model.notes)


def test_the_boxes_of_a_proof_are_in_a_file_of_their_own(solved, tmp_path):
    """A result alone is short, and its page has no boxes; those of another search are not shown."""
    assert len(json.dumps(solved.to_dict())) < 12_000
    assert "bounds" in charts(stored(solved.to_dict(), tmp_path).result)
    assert "boxes" not in charts(stored(solved.to_dict(), tmp_path).result)
    other = certificate_document(solved.certificate, solved) | {"lower_bound": 0.9 * solved.certificate.lower_bound}
    assert "boxes" not in charts(stored(solved.to_dict(), tmp_path, other).result)


def test_a_stored_infeasible_certificate_is_restored(opposed, tmp_path):
    path = tmp_path / "result.json"
    path.write_text(json.dumps(opposed.to_dict()), encoding="utf-8")
    result = load_stored(str(path), changes=[f"{key}={value}" for key, value in OPPOSED.items()]).result.certificate
    assert result.status == "infeasible"
    assert math.isinf(result.lower_bound)


DAMAGED = {
    "status": ("fine", "certificate.status"),
    "objective": (0.5, "the gap is too large for the status of the proof"),
    "lower_bound": (0.001, "certificate.lower_bound = 0.001: the result is damaged: the gap is too large for the status"),
    "asked": (7.0, "certificate.asked = 7.0: the result is damaged: expected a number from 1e-12 to less than 1"),
    "boxes": (-1, "certificate.open_boxes"),
    "open_boxes": (4, "certificate.open_boxes = 4: the result is damaged: it does not fit the status of the proof"),
    "unknowns": (["coupler"], "the design variables of the problem are coupler, rocker"),
    "history": ([[1.0, 2.0]], "certificate.history: the result is damaged: its rows are not boxes, lower bound and objective"),
    "rigorous": (False, "certificate.rigorous"),
    "improved": (7, "certificate.improved"),
    "text": (7, "certificate.text = 7: the result is damaged: this is not a text"),
    "gap": ("small", 'certificate.gap = "small": the result is damaged: this is not a number'),
}


@pytest.mark.parametrize("key", DAMAGED)
def test_a_damaged_certificate_is_refused_in_a_sentence(solved, tmp_path, key):
    document = copy.deepcopy(solved.to_dict())
    document["certificate"][key], message = DAMAGED[key]
    with pytest.raises(optlink.InputError) as refused:
        stored(document, tmp_path)
    assert message in str(refused.value)
    assert "damaged" in str(refused.value)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"test": ["magic"]}, "covers[0].test"),
        ({"low": [[0.9, 0.9]]}, "the upper corner of a box lies below its lower corner"),
        ({"low": [[0.1]]}, "this is not 1 rows of 2 finite numbers"),
    ],
)
def test_damaged_boxes_are_refused(solved, tmp_path, change, message):
    one = {"assembly": "left", "low": [[0.1, 0.1]], "high": [[0.2, 0.2]], "test": ["limits"], "limits": [], "multipliers": [{}]}
    proof = certificate_document(solved.certificate, solved) | {"covers": [one | change]}
    with pytest.raises(optlink.InputError, match="damaged") as refused:
        stored(solved.to_dict(), tmp_path, proof)
    assert message in str(refused.value)


def test_a_certificate_of_another_verdict_is_refused(solved, tmp_path):
    document = copy.deepcopy(solved.to_dict())
    document["certificate"]["status"] = "infeasible"
    with pytest.raises(optlink.InputError, match="there is an objective or a bound of it"):
        stored(document, tmp_path)


def test_a_certificate_of_another_design_is_not_shown(solved, tmp_path):
    """A design without a certificate, or a proof that there is none, must not borrow one."""
    other = {"objective": 2.0 * solved.objective, "lower_bound": 2.0 * solved.objective}
    none = {"status": "infeasible", "objective": None, "lower_bound": None}
    for change in (other, none):
        document = copy.deepcopy(solved.to_dict())
        document["certificate"] |= change
        model = stored(document, tmp_path)
        assert model.result.certificate is None
        assert any("not that of this design" in note for note in model.notes)
