"""Why a design is not valid, in words; and bounds that let no crank turn, against linear programming."""

from __future__ import annotations

import math
import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import linprog

import optlink
from optlink.linkage.fourbar import LENGTHS
from optlink.presentation.format import causes, why_invalid
from optlink.presentation.report_model import ReportModel
from optlink.presentation.views.design_drawings import at_positions as drawn_mechanism
from optlink.tasks.results.conflict import Length, cannot_turn, four_bar_conflict
from optlink.validation.check import Check


def failing(name: str, value: float, limit: str, unit: str) -> Check:
    return Check(name, False, value, limit, unit)


@pytest.mark.parametrize(
    ("check", "words"),
    [
        (failing("swing angle, least", 89.816, ">= 95", "deg"), "the rocker swings 89.82 deg, at least 95 deg are required"),
        (failing("stroke: stroke of ram", 71.5, "<= 70", "mm"), "the stroke of ram is 71.5 mm, at most 70 mm are required"),
        (failing("time ratio, least", 1.05, ">= 1.2", ""), "the time ratio is 1.05, at least 1.2 is required"),
        (
            failing("transmission_angle.E.min: least transmission angle at E", 39.911, ">= 45", "deg"),
            "the transmission angle at E falls to 39.91 deg, at least 45 deg are required",
        ),
        (failing("coupler within its bounds", 412.0, "100 ... 400", "mm"), "coupler is 412 mm, 100 ... 400 mm are required"),
        (failing("limits.x: peak torque", 12.0, "<= 10", "N m"), "peak torque is 12 N m, at most 10 N m are required"),
        (
            failing("points met within their tolerances", 3.25, "<= 1", "of the tolerance"),
            "a point is missed by 3.25 times its tolerance",
        ),
        (failing("optimality (KKT residual)", 0.7, "<= 1e-06", ""), "the search ended before an optimum"),
        (failing("the wheel is round", math.nan, "yes", ""), "it fails the check of the wheel is round"),
    ],
)
def test_a_failed_check_is_told_in_words(check: Check, words: str) -> None:
    assert causes([check]) == [words]


def test_a_prescribed_value_is_required_exactly() -> None:
    checks = [failing("swing angle, least", 89.8, ">= 100", "deg"), Check("swing angle, largest", True, 89.8, "<= 100", "deg")]
    assert why_invalid(checks, "") == "the rocker swings 89.8 deg, 100 deg are required"


def test_consequences_are_not_causes() -> None:
    checks = [
        failing("link lengths re-measured in motion", math.nan, "<= 1e-07", "mm"),
        failing("Grashof: triple-rocker (non-Grashof)", -40.0, ">= 0.02", "mm"),
        failing("smallest transmission angle", math.nan, ">= 30", "deg"),
    ]
    assert causes(checks) == ["the crank cannot turn fully"]
    assert why_invalid([], "stalled") == "stalled"
    assert causes([checks[0], failing("time ratio, least", 1.0, ">= 2", "")]) == ["the time ratio is 1, at least 2 is required"]


def test_an_infeasible_design_has_no_check_of_its_optimality() -> None:
    result = optlink.solve(optlink.load("crank-rocker", {"limits.transmission_angle": ["88 deg", "92 deg"]}))
    names = [check.name for check in result.validation.checks]
    assert result.status == "infeasible"
    assert any("transmission" in name for name in result.validation.failed)
    assert not {"optimality (KKT residual)", "all limits met (scaled)"} & set(names)


def lengths(bounds: dict[str, list[float]]) -> dict[str, Length]:
    """Free lengths between two bounds [mm]."""
    return {name: Length(name, 1e-3 * low, 1e-3 * high) for name, (low, high) in bounds.items()}


SUMS = {"crank": [[1, -1, -1, 1], [1, 1, -1, -1], [1, -1, 1, -1]], "frame": [[1, -1, -1, 1], [-1, 1, -1, 1], [-1, -1, 1, 1]]}


def turns(bounds: list[tuple[float, float]], shortest: str) -> bool:
    """Whether some sizes let the crank turn fully, with that shortest link: Grashof's inequalities by linear programming."""
    return bool(linprog(np.zeros(4), A_ub=np.array(SUMS[shortest]), b_ub=np.zeros(3), bounds=bounds).status == 0)


@pytest.mark.slow
@pytest.mark.parametrize("crank", ["full rotation", "double-crank", ""])
def test_bounds_that_let_no_crank_turn_are_named_with_a_change_that_does(crank: str) -> None:
    random = np.random.default_rng(8)
    named = 0
    kinds = {"full rotation": ["crank"], "double-crank": ["frame"], "": ["crank", "frame"]}[crank]
    for _ in range(300):
        low = random.uniform(5.0, 250.0, 4)
        bounds = np.column_stack([low, low + random.choice([0.0, 10.0, 60.0], 4) * random.random(4)])
        sentence = four_bar_conflict(lengths(dict(zip(LENGTHS, bounds.tolist(), strict=True))), crank, math.radians(1.0))
        possible = any(turns(bounds.tolist(), shortest) for shortest in kinds)
        if not sentence:
            continue
        named += 1
        assert not possible
        changes = re.findall(r"a (\w+) of (at most|at least) ([\d.]+) mm", sentence)
        assert changes
        wider = dict(zip(LENGTHS, bounds.tolist(), strict=True))
        for name, side, value in changes:
            number = float(value)
            wider[name] = [number, wider[name][1]] if side == "at most" else [wider[name][0], number]
            wider[name] = [min(wider[name]), max(wider[name])]
        assert any(turns(list(wider.values()), shortest) for shortest in kinds), sentence
    assert named > 50


FOUR_BAR = {
    "type": "four-bar",
    "crank": {"bounds": ["20 mm", "60 mm"]},
    "coupler": {"bounds": ["200 mm", "600 mm"]},
    "rocker": {"bounds": ["20 mm", "80 mm"]},
    "frame": {"bounds": ["90 mm", "99.8 mm"]},
    "assembly": "left",
}
LINKS = {
    "crank": {"joints": ["A", "B"], "length": FOUR_BAR["crank"]},
    "rod": {"joints": ["B", "C"], "length": FOUR_BAR["coupler"]},
    "arm": {"joints": ["D", "C"], "length": FOUR_BAR["rocker"]},
}
GROUND = {"A": ["0 mm", "0 mm"], "D": [{"bounds": ["90 mm", "99.8 mm"]}, "0 mm"]}
DYADS = {"type": "dyads", "ground": GROUND, "links": LINKS, "assembly": {"C": "left of B-D"}}
SLIDER = {
    "type": "dyads",
    "ground": {"A": ["0 mm", "0 mm"]},
    "links": {
        "crank": {"joints": ["A", "B"], "length": {"bounds": ["60 mm", "90 mm"]}},
        "rod": {"joints": ["B", "C"], "length": {"bounds": ["40 mm", "75 mm"]}},
        "ram": {"joints": ["C"]},
    },
    "guides": {"G": {"slider": "ram", "through": "A", "offset": {"bounds": ["20 mm", "50 mm"]}}},
    "assembly": {"C": "forward"},
}
ROD = "mechanism.links.rod.length"


@pytest.mark.parametrize(
    ("mechanism", "output", "key", "inequality", "remedy"),
    [
        (
            FOUR_BAR,
            "rocker",
            "mechanism.coupler",
            "crank 20 + coupler 200 > rocker 80 + frame 99.8 mm",
            "coupler of at most 159.7 mm",
        ),
        (DYADS, "arm", ROD, "crank 20 + rod 200 > arm 80 + distance A-D 99.8 mm", "rod of at most 159.7 mm"),
        (SLIDER, "ram", ROD, "crank 60 + offset 20 > rod 75 mm", "rod of at least 80.03 mm"),
    ],
)
def test_the_inequality_is_stated_with_its_numbers_and_its_remedy_works(
    mechanism: dict[str, object], output: str, key: str, inequality: str, remedy: str
) -> None:
    stroke = ">= 1 mm" if output == "ram" else ">= 1 deg"
    task = {"kind": "stroke", "output": output, "stroke": stroke}
    file = optlink.read({"title": "No crank", "mechanism": mechanism, "requirement": task})
    assert optlink.solve(file, starts=1).notes == (
        f"no sizes within the bounds let the crank turn: {inequality}. Allow a {remedy}",
    )
    value, side = remedy.split()[-2], "min" if "at most" in remedy else "max"
    wider = file.override({f"{key}.{side}": f"{value} mm"}).model
    assert cannot_turn(wider.mechanism.quantities, wider.linkage, "", math.radians(1.0)) == ()
    assert cannot_turn(file.model.mechanism.quantities, file.model.linkage, "span", 0.0) == ()


@pytest.mark.slow
def test_pictures_and_pages_name_the_cause() -> None:
    """Of a law that breaks its limit of the transmission angle; a valid one has no such line."""
    law, design = optlink.load("crank-rocker"), {"coupler": 0.41, "rocker": 0.22}
    cause = "the transmission angle rises to"
    for result, wrong in ((optlink.validate(law, design), True), (optlink.solve(law), False)):
        titles = drawn_mechanism(result).get_suptitle().split("\n")
        assert any(line.startswith(f"NOT VALID: {cause}") for line in titles) == wrong
        assert (cause in ReportModel(result.problem, result, None).verdict) == wrong
    narrow = optlink.load("crank-rocker", {"limits.transmission_angle": ["88 deg", "92 deg"]})
    infeasible = optlink.solve(narrow)
    assert infeasible.refuted.startswith("No such linkage: 88 deg of transmission angle cannot be met")
    assert ReportModel(narrow, infeasible, None).verdict == "No feasible design found"  # the sentence is the conclusion
    unnamed = ReportModel(narrow, replace(infeasible, conflict=()), None)
    assert unnamed.verdict.startswith("No feasible design found: the transmission angle")
    _, why = drawn_mechanism(infeasible).get_suptitle().split("\n")[:2]
    assert why == infeasible.refuted
