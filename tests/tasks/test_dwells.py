"""Dwells: an output stays within a band over a crank range; judged by formulas of their own at many positions."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy.optimize import minimize

import optlink
from optlink.presentation.html.page import page
from optlink.presentation.report_model import report_model_of
from optlink.tasks.results.design import SynthesisResult
from tests.oracles.composed_problems import straight_line, third
from tests.solved import solution

ROCKER = {
    "title": "resting lever",
    "mechanism": {
        "type": "four-bar",
        "frame": "100 mm",
        "crank": "30 mm",
        "coupler": {"start": "90 mm", "bounds": ["60 mm", "150 mm"]},
        "rocker": {"start": "70 mm", "bounds": ["50 mm", "75 mm"]},
    },
    "requirement": {"kind": "dwell", "over": ["20 deg", "80 deg"]},
}


def rocker(**requirement: Any) -> optlink.ProblemFile:
    return optlink.read(ROCKER | {"requirement": {**ROCKER["requirement"], **requirement}})


def angles(coupler: float, length: float, phi: np.ndarray) -> np.ndarray:
    """Angle of the rocker [rad] by the intersection of two circles about B and D."""
    return np.unwrap(np.angle(third(0.03 * np.exp(1j * phi), 0.1, coupler, length, 1.0) - 0.1))


def solved(file: optlink.ProblemFile, **options: Any) -> SynthesisResult:
    result = optlink.solve(file, **options)
    assert isinstance(result, SynthesisResult)
    return result


@pytest.mark.slow
def test_the_straight_line_of_least_breadth() -> None:
    result, known = solution("straight-line"), straight_line()
    assert result.valid
    assert 2.0 * result.objective == pytest.approx(0.05 * known.optimum * known.figures["travel"], rel=1e-6)
    for name in ("frame", "coupler"):
        assert result.design[name] == pytest.approx(0.05 * known.figures[name], rel=1e-6)
    assert result.design["rocker"] == result.design["coupler"]


def test_both_back_ends_agree() -> None:
    result = optlink.solve(optlink.load("straight-line"), "both", starts=60)
    assert result.valid
    first, second = result.backends.values()
    assert first.objective == pytest.approx(second.objective, rel=1e-9)


@pytest.mark.slow
def test_an_angle_dwells_and_the_range_is_found() -> None:
    """The best 60 deg of the crank, of every start of a grid; about the limit position of the rocker."""
    free = solved(rocker(over="60 deg"), starts=60)
    design = free.design
    phi = design["start"] + np.linspace(0.0, math.pi / 3.0, 6001)
    assert free.valid
    assert free.objective == pytest.approx(0.5 * float(np.ptp(angles(design["coupler"], design["rocker"], phi))), rel=1e-7)

    def breadth(x: np.ndarray) -> float:
        return float(np.ptp(angles(x[0], x[1], x[2] + np.linspace(0.0, math.pi / 3.0, 1201))))

    limits = ((0.06, 0.15), (0.05, 0.075), (-7.0, 7.0))
    starts = ((0.09, 0.07, at) for at in np.linspace(0.0, 6.0, 13))
    precise = {"xatol": 1e-10, "fatol": 1e-13, "maxiter": 4000}
    own = min(float(minimize(breadth, x, method="Nelder-Mead", bounds=limits, options=precise).fun) for x in starts)
    assert free.objective <= 0.5 * own * (1.0 + 1e-6)


@pytest.mark.slow
def test_a_range_from_a_given_start_is_that_of_its_ends() -> None:
    ends, start = solved(rocker(), starts=30), solved(rocker(over="60 deg", start="20 deg"), starts=30)
    assert ends.objective == pytest.approx(start.objective, rel=1e-10)
    back = solved(rocker(over=["80 deg", "20 deg"]), starts=30)
    assert back.objective == pytest.approx(ends.objective, rel=1e-9)


@pytest.mark.slow
def test_a_band_is_a_limit() -> None:
    """With a band of 0.1 mm the worst pressure angle is least, by an own search over frame and coupler."""
    result = solved(optlink.load("straight-line", {"requirement.band": "0.1 mm"}), starts=60)

    def breadth(frame: float, coupler: float, count: int = 401) -> float:
        b = 0.05 * np.exp(1j * np.radians(np.linspace(110.0, 250.0, count)))
        return float(np.ptp((2.0 * third(b, complex(frame), coupler, coupler, 1.0) - b).imag))

    def pressure(frame: float, coupler: float) -> float:
        ends = [1.0 - (frame + sign * 0.05) ** 2 / (2.0 * coupler**2) for sign in (1.0, -1.0)]  # cosine theorem, equal sides
        return max(abs(0.5 * math.pi - math.acos(end)) for end in ends)

    grid = [(f, c) for f in np.linspace(0.12, 0.14, 41) for c in np.linspace(0.15, 0.19, 81)]
    best = min(pressure(*x) for x in grid if breadth(*x) <= 1e-4 * (1.0 - 1e-4))  # for the coarse steps
    design = result.design
    assert result.valid
    assert breadth(design["frame"], design["coupler"], 20_001) == pytest.approx(1e-4, rel=1e-6)
    assert result.objective == pytest.approx(pressure(design["frame"], design["coupler"]), rel=1e-9)
    assert result.objective <= best
    priced = [limit for limit in result.best.displayed_limits if limit.active]
    assert [limit.key for limit in priced] == ["requirement.band"]
    assert priced[0].bound == pytest.approx(0.1)


def test_a_band_about_a_value() -> None:
    """The least deviation from 75 deg: the breadth is larger than that of the best middle."""
    stated = solved(rocker(value="75 deg"), starts=30)
    design, phi = stated.design, np.radians(np.linspace(20.0, 80.0, 6001))
    away = np.abs(angles(design["coupler"], design["rocker"], phi) - math.radians(75.0))
    assert stated.valid
    assert stated.objective == pytest.approx(float(np.max(away)), rel=1e-7)
    within = solved(rocker(value={"bounds": ["74 deg", "76 deg"]}), starts=30)
    assert within.objective <= stated.objective
    assert math.radians(74.0) <= within.design["zero"] <= math.radians(76.0)


def test_a_band_that_is_left_between_the_positions_is_noticed() -> None:
    """Planted: the validator measures the breadth itself, at a design beside the optimum."""
    file = optlink.load("straight-line", {"requirement.band": "0.0388 mm"})
    best = solution("straight-line").design
    sound = {name: best[name] for name in ("frame", "coupler", "zero")}
    for change, valid in ((0.0, True), (1e-6, False)):
        tested = optlink.validate(file, sound | {"coupler": best["coupler"] + change})
        checks = {check.name: check for check in tested.validation.checks}
        assert checks["largest breadth"].passed is valid
        assert checks["largest breadth"].unit == "mm"


@pytest.mark.slow
def test_a_conflict_names_the_band() -> None:
    """The breadth of 0.0387 mm is the least one."""
    result = optlink.solve(optlink.load("straight-line", {"requirement.band": "0.03 mm"}), starts=30)
    assert not result.valid
    (relaxed,) = [one for one in result.conflict if one.key == "requirement.band"]
    assert relaxed.in_si.relaxed == pytest.approx(2.0 * solution("straight-line").objective, rel=1e-3)


@pytest.mark.slow
def test_a_dwell_beside_another_requirement() -> None:
    """A law is minimised while another part of the motion rests; with a wide band the law alone decides."""
    law = {"law": "psi0 + 0.3*sin(phi - phi0)", "span": "100 deg", "start": "150 deg", "psi0": "110 deg", "measure": "max"}
    dwell = {"kind": "dwell", "over": ["20 deg", "80 deg"]}

    def both(band: str) -> SynthesisResult:
        raw = {key: value for key, value in ROCKER.items() if key != "requirement"}
        return solved(optlink.read(raw | {"requirements": [law, dwell | {"band": band}]}), starts=30)

    wide, narrow = both("90 deg"), both("9 deg")
    alone = optlink.solve(optlink.read(ROCKER | {"requirement": law}), starts=30)
    assert wide.valid
    assert narrow.valid
    assert wide.objective == pytest.approx(alone.objective, rel=1e-8)
    phi = np.radians(np.linspace(20.0, 80.0, 6001))
    assert math.degrees(np.ptp(angles(narrow.design["coupler"], narrow.design["rocker"], phi))) <= 9.0 * (1.0 + 1e-6)
    assert narrow.objective >= wide.objective


@pytest.mark.slow
def test_a_band_broader_than_needed_lies_evenly_about_its_free_middle() -> None:
    """The middle was left at the edge of its room, so that a slack band read "breadth <= 4 mm, active"."""
    raw = {
        "title": "Slider with a rest and two stations",
        "mechanism": {
            "type": "dyads",
            "ground": {"A": ["0 mm", "0 mm"]},
            "links": {
                "crank": {"joints": ["A", "B"], "length": {"bounds": ["10 mm", "100 mm"]}},
                "rod": {"joints": ["B", "C"], "length": {"bounds": ["30 mm", "400 mm"]}},
                "ram": {"joints": ["C"]},
            },
            "guides": {"G": {"slider": "ram", "through": "A", "direction": "0 deg", "offset": {"bounds": ["-60 mm", "60 mm"]}}},
            "assembly": {"C": "forward"},
        },
        "requirements": [
            {"kind": "dwell", "output": "G", "over": "60 deg", "band": "4 mm"},
            {"kind": "position", "name": "far", "output": "G", "at": "20 deg", "value": {"min": "150 mm"}},
            {"kind": "position", "name": "near", "output": "G", "at": "170 deg", "value": ["60 mm", "70 mm"]},
        ],
        "objective": {"quantity": "total length"},
        "limits": {"pressure_angle": "35 deg"},
    }
    result = optlink.solve(optlink.read(raw))
    sizes = result.design
    phi = sizes["dwell.start"] + np.radians(np.linspace(0.0, 60.0, 6001))
    across = sizes["G.offset"] - sizes["crank.length"] * np.sin(phi)
    slide = 1e3 * (sizes["crank.length"] * np.cos(phi) + np.sqrt(sizes["rod.length"] ** 2 - across**2))
    assert np.ptp(slide) < 3.7
    assert 1e3 * sizes["dwell.zero"] == pytest.approx(0.5 * (np.max(slide) + np.min(slide)), abs=1e-3)
    (breadth,) = (check.value for check in result.validation.checks if check.name == "largest breadth of dwell")
    assert breadth == pytest.approx(np.ptp(slide), abs=1e-3)
    assert not any(limit.active for limit in result.best.displayed_limits if limit.name.startswith("breadth"))


@pytest.mark.slow
def test_the_page_of_a_dwell() -> None:
    text = page(report_model_of(solution("straight-line")))
    assert "P.y [mm]" in text
    assert "start, the default" not in text
