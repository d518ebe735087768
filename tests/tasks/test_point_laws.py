"""Motion laws of a coordinate of a traced point, judged by complex numbers, with joints on circles, at many positions."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy.optimize import minimize

import optlink
from optlink.errors import InputError
from optlink.presentation.html.page import page
from optlink.presentation.report_model import report_model_of
from optlink.tasks.certify import certify
from optlink.tasks.design import solve
from tests.solved import solution

FINE = np.radians(np.linspace(110.0, 250.0, 14_001))
LAW = {"slide": "s0 - 100*(phi - phi0)", "unit": "mm"}


def dyads(**requirement: Any) -> dict[str, Any]:
    """A four-bar with coupler = rocker = extension of the coupler: P approximates a straight line, here at even speed."""
    links = {
        "crank": {"joints": ["A", "B"], "length": "50 mm"},
        "coupler": {
            "joints": ["B", "C"],
            "length": {"start": "160 mm", "bounds": ["100 mm", "250 mm"]},
            "points": {"P": [{"equals": "2*coupler.length"}, "0 mm"]},
        },
        "rocker": {"joints": ["D", "C"], "length": {"equals": "coupler.length"}},
    }
    ground = {"A": ["0 mm", "0 mm"], "D": [{"start": "120 mm", "bounds": ["75 mm", "200 mm"]}, "0 mm"]}
    mechanism = {"type": "dyads", "ground": ground, "links": links, "assembly": {"C": "left of B-D"}}
    law = {"law": LAW, "output": "P.x", "start": "110 deg", "span": "140 deg", "measure": "max"}
    return {"title": "even speed", "mechanism": mechanism, "requirement": law | requirement}


def four_bar(**requirement: Any) -> dict[str, Any]:
    lengths = {"crank": "50 mm", "coupler": {"start": "160 mm", "bounds": ["100 mm", "250 mm"]}, "rocker": {"equals": "coupler"}}
    frame = {"start": "120 mm", "bounds": ["75 mm", "200 mm"]}
    points = {"P": [{"equals": "2*coupler"}, "0 mm"]}
    return dyads(**requirement) | {"mechanism": {"type": "four-bar", **lengths, "frame": frame, "points": points}}


def traced(frame: float, coupler: float, phi: np.ndarray) -> np.ndarray:
    """P [m] as complex numbers: C on the circles about B and D, of equal radii; P twice as far from B."""
    b, d = 0.05 * np.exp(1j * phi), complex(frame)
    half = 0.5 * (d - b)
    c = b + half + 1j * half / np.abs(half) * np.sqrt(coupler**2 - np.abs(half) ** 2)
    return np.asarray(2.0 * c - b)


def largest(x: np.ndarray) -> float:
    """Largest error [m] over the range with the best s0."""
    return 0.5 * float(np.ptp(traced(*x, FINE).real + 0.1 * (FINE - FINE[0])))


@pytest.fixture(scope="module")
def result() -> Any:
    return solve(optlink.read(dyads()))


def test_a_coordinate_follows_a_law(result: Any) -> None:
    """No worse than an own search; the objective is that of the formula at 14,001 positions."""
    precise = {"xatol": 1e-10, "fatol": 1e-14, "maxiter": 5000}
    limits, starts = ((0.075, 0.2), (0.1, 0.25)), ((0.12, 0.16), (0.1, 0.15), (0.15, 0.2))
    found = [minimize(largest, x, method="Nelder-Mead", bounds=limits, options=precise) for x in starts]
    own = min(found, key=lambda each: float(each.fun))
    design = result.design
    assert result.valid
    assert result.objective == pytest.approx(largest(np.array([design["D.x"], design["coupler.length"]])), rel=1e-6)
    assert result.objective == pytest.approx(float(own.fun), rel=1e-6)
    assert design["D.x"] == pytest.approx(own.x[0], rel=1e-4)


def test_a_four_bar_by_its_lengths_follows_it_too(result: Any) -> None:
    other = solve(optlink.read(four_bar()))
    assert other.valid
    assert other.objective == pytest.approx(result.objective, rel=1e-9)
    assert other.design["frame"] == pytest.approx(result.design["D.x"], rel=1e-6)
    both = optlink.solve(optlink.read(four_bar()), "both")
    assert both.valid


@pytest.mark.parametrize("measure", ["sum of squares", "rms", "max"])
def test_every_measure_is_that_of_the_formula(measure: str) -> None:
    """The rows of a table, rotated about the start, with the positions of a batch of one."""
    phi = np.radians(110.0 + 10.0 * np.arange(15))
    law = {"phi": [f"{10 * k} deg" for k in range(15)], "s": [f"{-17.0 * k} mm" for k in range(15)]}
    file = optlink.read(dyads(law=law, span=None, measure=measure, zero="250 mm"))
    design = {"D.x": 0.1234, "coupler.length": 0.1611}
    error = traced(0.1234, 0.1611, phi).real - (0.25 - 0.017 * np.arange(15))
    value = {"sum of squares": np.sum(error**2), "rms": np.sqrt(np.mean(error**2)), "max": np.max(np.abs(error))}[measure]
    tested = optlink.validate(file, design)
    assert tested.objective == pytest.approx(float(value), rel=1e-12)


@pytest.mark.slow
def test_the_slide_of_a_guide_is_the_coordinate_of_its_pin() -> None:
    """The same problem by the guide, whose line is parallel to x, and by the pin of the slider."""
    pin = optlink.load("law-slider-crank", {"requirement.output": "C.x"})
    result, known = solve(pin), solution("law-slider-crank")
    assert result.valid
    assert result.objective == pytest.approx(known.objective, rel=1e-9)


def test_a_mechanism_with_another_point_is_rejected(result: Any) -> None:
    """Planted: the point lies 0.1 mm beside the line B-C."""
    file = optlink.read(dyads())
    sound = {**result.design, "coupler.P.across": 0.0}
    assert optlink.validate(file, sound).valid
    planted = optlink.validate(file, sound | {"coupler.P.along": sound["coupler.P.along"] + 1e-4})
    assert not planted.valid


def test_a_certificate_is_refused(result: Any) -> None:
    with pytest.raises(InputError, match="coordinate of a point"):
        certify(result)


def test_the_law_of_a_rocker_has_no_place() -> None:
    """A four-bar whose rocker follows a law still refuses its place, one whose point does accepts it."""
    stated = four_bar()
    stated["mechanism"] |= {"pivot": ["10 mm", "20 mm"]}
    moved = optlink.validate(optlink.read(stated), {"frame": 0.1234, "coupler": 0.1611, "zero": 0.26})
    still = optlink.validate(optlink.read(four_bar()), {"frame": 0.1234, "coupler": 0.1611, "zero": 0.25})
    assert moved.objective == pytest.approx(still.objective, rel=1e-9)
    assert math.isfinite(moved.objective)
    with pytest.raises(InputError, match="position of the linkage"):
        optlink.read(stated | {"requirement": {"law": "psi0 + 0.2*(phi - phi0)", "span": "90 deg"}})


def test_pictures_name_the_coordinate(result: Any) -> None:
    text = page(report_model_of(result))
    assert "P.x [mm]" in text
    assert "place along" not in text
