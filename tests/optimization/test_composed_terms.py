"""Every quantity of the machine beside a path in one programme: derivatives against differences, values against the analysis."""

from __future__ import annotations

import copy
import math
import pickle
from functools import cache

import numpy as np
import pytest

import optlink
from optlink.optimization.courses import TermCourse
from optlink.optimization.nlp import NLP
from optlink.optimization.programme import build, build_again
from optlink.solvers.exchange import _with_moving_peaks
from optlink.validation.cycle import Cycle
from tests.optimization.test_mapped_terms import same_derivatives
from tests.optimization.test_terms import EVERY, differences
from tests.tiers import mostly_slow

PATH = {
    "kind": "path",
    "point": "D",
    "points": [["-200 mm", "200 mm"], ["0 mm", "290 mm"], ["200 mm", "220 mm"]],
    "tolerance": "90 mm",
}


@cache
def programme(speed: str = "64 rpm", table: bool = False) -> NLP:
    """The shaper with a path of the rocker's end; with `table` the cutting force is tabulated over the slide."""
    raw = copy.deepcopy(dict(optlink.load("shaper-design").raw))
    raw |= {"requirement": PATH, "limits": EVERY}
    raw["drive"]["speed"] = speed
    if table:
        at, values = ["-100 mm", "50 mm", "120 mm", "300 mm"], ["1 kN", "4 kN", "6 kN", "2 kN"]
        raw["loads"]["cutting"] |= {"force": {"over": "s", "at": at, "values": values}, "stroke": "backward"}
    task = optlink.read(raw).spec
    design = {name: task.quantities[name].value for name in task.free}
    design |= {"C.x": 0.013, "coupler.length": 0.21}  # no symmetry, which would hide a wrong derivative
    nlp = build(task, terms=TermCourse(task, design, count=384 if table else 48))
    nlp.x_start[:] = nlp.x_of(nlp.design(nlp.x_start) | design)
    return nlp


@pytest.mark.slow
@pytest.mark.parametrize("speed", ["64 rpm", "-40 rpm"])
def test_derivatives_are_those_of_differences(speed: str) -> None:
    nlp = programme(speed)
    point, expected = nlp.at(nlp.x_start, nlp.p), differences(nlp, nlp.x_start)
    assert point.finite
    assert {row.limit for row in nlp.rows} >= {f"limits.{name}" for name in EVERY}
    assert (nlp.terms.cuts, len(nlp.terms.events)) == (2, 6)
    size = np.maximum(np.max(np.abs(expected[:-1]), axis=1, keepdims=True), 1.0)
    worst = np.max(np.abs(point.jacobian - expected[:-1]) / size, axis=1)
    assert {row.label for row, miss in zip(nlp.rows, worst, strict=True) if miss > 1e-6} == set()
    np.testing.assert_allclose(point.gradient, expected[-1], rtol=1e-6, atol=1e-8)


@pytest.mark.slow
def test_derivatives_with_corners_of_a_load_are_those_of_designs() -> None:
    """With the crank angles at which the slider passes the rows of the table, at which a derivative by itself has no value."""
    nlp, h = programme(table=True), 1e-4
    assert (nlp.terms.cuts, len(nlp.terms.events)) == (4, 8)
    x, first, last = nlp.x_start, nlp.first_event, nlp.first_level
    jacobian = nlp.at(x, nlp.p).jacobian

    def moved(step: np.ndarray) -> np.ndarray:
        y = x + step
        y[first:last] = nlp.terms.event_angles(nlp.design(y))
        return np.concatenate([y, nlp.values(y, nlp.p)[1]])

    for e in h * np.eye(len(x))[:first]:
        rows = [moved(k * e) for k in (-2, -1, 1, 2)]
        slope = (rows[0] - 8.0 * rows[1] + 8.0 * rows[2] - rows[3]) / (12.0 * h)
        expected, found = slope[len(x) :], jacobian @ slope[: len(x)]
        np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-6 * np.max(np.abs(expected)))


@pytest.mark.parametrize(
    ("speed", "table"), mostly_slow([("64 rpm", False), ("-40 rpm", False), ("64 rpm", True)], ("64 rpm", False))
)
def test_values_are_those_of_the_analysis(speed: str, table: bool) -> None:
    """Figures are met; of what a single position decides no position exceeds the analysis, and the densest comes near."""
    nlp = programme(speed, table)
    problem, x = nlp.terms.problem, nlp.x_start
    cycle = Cycle(problem, {name: value for name, value in nlp.design(x).items() if name in problem.quantities})
    _, g = nlp.values(x, nlp.p)
    for bound in problem.bounds:
        rows = [row.scale.to_display(value) for row, value in zip(nlp.rows, g, strict=True) if row.limit == bound.key]
        unit = optlink.units.factor(bound.interval.unit, bound.interval.kind) if bound.interval.kind else 1.0
        computed = (np.min if bound.term.how == "least" else np.max)(np.array(rows) * unit)
        measured = cycle.figure(bound.term)
        assert math.isfinite(measured), bound.name
        np.testing.assert_allclose(computed, measured, rtol=0.05 if bound.term.extreme else 1e-7, err_msg=bound.name)
        beyond = (measured - computed) if bound.term.how == "least" else (computed - measured)
        assert not bound.term.extreme or beyond <= 1e-9 * abs(measured), bound.name


@pytest.mark.slow
def test_copies_and_programmes_with_moving_peaks_have_the_same_derivatives() -> None:
    nlp = programme()
    same_derivatives(nlp)
    copied = pickle.loads(pickle.dumps(nlp))
    same_derivatives(copied)
    np.testing.assert_array_equal(copied.lifted(nlp.x_start), nlp.lifted(nlp.x_start))
    same_derivatives(_with_moving_peaks(nlp, [3, 0, 17]))


@pytest.mark.slow
def test_a_programme_is_built_again_from_its_recipe() -> None:
    nlp = programme()
    again = build_again(nlp.terms.problem, nlp.recipe)
    assert [row.label for row in again.rows] == [row.label for row in nlp.rows]
    for one, other in zip(again.at(nlp.x_start, nlp.p), nlp.at(nlp.x_start, nlp.p), strict=True):
        np.testing.assert_array_equal(one, other)
