"""The curve between the prescribed points: arcs count as met, a motion that leaves the line of the points does not."""

from __future__ import annotations

import math

import numpy as np
import pytest

import optlink
from optlink.presentation.views.conclusions import design as conclusion
from optlink.tasks.design import validate
from optlink.tasks.results.design import LinkageDesign
from optlink.validation.timing import sagittas
from tests.stated import document, four_bar_section

CRANK, ROD = 40.0, 120.0


def place(degrees: float) -> float:
    """Position of the slider [mm] by the law of cosines."""
    phi = math.radians(degrees)
    return CRANK * math.cos(phi) + math.sqrt(ROD**2 - (CRANK * math.sin(phi)) ** 2)


def slider(*degrees: float) -> LinkageDesign:
    """A slider-crank whose slider is at points of its line at these crank angles."""
    points = [{"x": f"{place(at)!r} mm", "y": "0 mm", "crank": f"{at} deg"} for at in degrees]
    raw = {
        "title": "Slider on its line",
        "mechanism": {
            "type": "dyads",
            "ground": {"A": ["0 mm", "0 mm"]},
            "links": {
                "crank": {"joints": ["A", "B"], "length": f"{CRANK} mm"},
                "rod": {"joints": ["B", "C"], "length": f"{ROD} mm"},
                "ram": {"joints": ["C"]},
            },
            "guides": {"F": {"slider": "ram", "through": "A", "direction": "0 deg"}},
            "assembly": {"C": "forward"},
        },
        "requirement": {"kind": "path", "point": "C", "timing": "given", "points": points},
    }
    best = validate(optlink.read(raw), {}).best
    assert best is not None
    return best


def test_points_in_line_do_not_hide_an_overshoot() -> None:
    """The slider is exactly at every point, but turns back beyond the last one: it passes its dead centre at 0 deg."""
    best = slider(100.0, 80.0, 60.0, 40.0, -20.0)
    fit = best.fit
    assert best.valid
    assert best.exact
    assert fit.at_points == "exact"
    assert fit.grade == "poor"
    assert best.between is not None
    assert 1e3 * best.between == pytest.approx([0.0, 0.0, 0.0, place(0.0) - place(-20.0)], abs=2e-3)
    assert "between points 4 and 5 the curve deviates by" in fit.text
    assert "points 4 and 5" in fit.reasons[0].remedy
    outcome = validate(best.problem, {})
    assert "between points 4 and 5" in conclusion(outcome, ())
    document = best.to_dict()
    assert document["fit"]["grade"] == "poor"
    assert document["objective"]["largest_between_mm"] == pytest.approx(place(0.0) - place(-20.0), abs=2e-3)
    assert len(document["points"]["between_mm"]) == 5


def test_a_motion_along_the_line_is_met_between_its_points() -> None:
    best = slider(100.0, 80.0, 60.0, 40.0, 20.0)
    assert best.fit.grade == "exact"
    assert np.max(best.between) < 1e-12


@pytest.mark.parametrize("step", [10, 20, 30, 60])
def test_the_arcs_of_a_coupler_curve_are_met_between_its_points(step: int) -> None:
    """Points of a planted curve, however far apart, and its closed seam."""
    sizes = {"crank": 30.0, "coupler": 80.0, "rocker": 70.0, "frame": 90.0}
    angles = np.radians(np.arange(0.0, 360.0, step))
    section = four_bar_section("left", **{k: f"{v} mm" for k, v in sizes.items()}, points={"P": ["40 mm", "30 mm"]})
    section |= {"pivot": ["0 mm", "0 mm"], "direction": "0 deg"}
    anywhere = document(section, np.zeros((len(angles), 2)) + np.arange(len(angles))[:, None], crank=angles)
    planted = validate(optlink.read(anywhere), {}).best.measured.generated * 1e3
    raw = document(section, planted, crank=angles)
    raw["requirement"]["closed"] = True
    best = validate(optlink.read(raw), {}).best
    assert best.fit.grade == "exact"
    assert len(best.between) == len(angles)
    assert np.max(best.between) < 1e-3 * best.fit.size


def test_the_sagitta_is_that_of_the_circle() -> None:
    """r (1 - cos(half step)) for even and uneven steps; nothing in line; nothing known beside a dwell."""
    for steps in ((30.0,) * 12, (20.0, 40.0) * 6):
        at = np.radians(np.cumsum(steps))
        arc = 1.0 - np.cos(0.5 * np.radians(np.roll(steps, -1)))
        computed = sagittas(np.stack([np.cos(at), np.sin(at)], axis=1), closed=True, around=True)
        assert np.all(computed >= arc - 1e-12)
        assert np.max(computed / arc) < 2.3
    line = np.array([[0.0, 0.0], [1.0, 0.0], [3.0, 0.0], [4.0, 0.0]])
    assert sagittas(line, closed=False, around=False) == pytest.approx([0.0, 0.0, 0.0])
    dwell = np.array([[0.0, 0.0], [0.0, 0.0], [0.0, 0.0], [5.0, 1.0]])
    assert sagittas(dwell, closed=False, around=False) == pytest.approx([0.0, 0.0, np.nan], nan_ok=True)
