"""One view for every design: the same law written in two ways has the same page, and several requirements have a chart each."""

from __future__ import annotations

import math
import re
from typing import Any

import numpy as np
import pytest

import optlink
from optlink.presentation.registry import table_of, view_of
from optlink.presentation.views import conclusions
from optlink.presentation.views.design_drawings import positions
from optlink.presentation.views.design_tables import captions
from optlink.presentation.views.design_view import DesignView, best
from tests.presentation.test_function_tables import words

SIZES = {"crank": 100.0, "coupler": 412.0, "rocker": 233.0, "frame": 500.0}  # mm
LAW = {"kind": "function", "law": "psi0 + 2/(3*pi)*(phi - phi0)^2", "span": "90 deg", "points": 30, "psi0": "98 deg"}
LIMITS = {"transmission_angle": ["45 deg", "136 deg"]}
FOUR_BAR = {"type": "four-bar", **{name: f"{size} mm" for name, size in SIZES.items()}}


def by_section(**more: Any) -> optlink.SynthesisResult:
    raw = {"title": "A law", "mechanism": FOUR_BAR, "requirement": {**LAW, "from": "26 deg", **more}, "limits": LIMITS}
    return optlink.validate(optlink.read(raw), {})


def by_dyads(**more: Any) -> optlink.SynthesisResult:
    joints = {"crank": ["A", "B"], "coupler": ["B", "C"], "rocker": ["D", "C"]}
    mechanism = {
        "type": "dyads",
        "ground": {"A": ["0 mm", "0 mm"], "D": ["500 mm", "0 mm"]},
        "links": {name: {"joints": pins, "length": f"{SIZES[name]} mm"} for name, pins in joints.items()},
        "assembly": {"C": "left of B-D"},
    }
    requirement = {**LAW, "start": "26 deg", "output": "rocker", **more}
    return optlink.validate(
        optlink.read({"title": "A law", "mechanism": mechanism, "requirement": requirement, "limits": LIMITS}), {}
    )


def shown(result: optlink.SynthesisResult) -> DesignView:
    view = best(result)
    assert view is not None
    return view


def test_a_law_has_the_same_charts_and_positions_in_either_way() -> None:
    one, other = by_section(), by_dyads()
    for first, second in zip(*(view_of("design").charts(result) for result in (one, other)), strict=True):
        assert (first.file, first.title) == (second.file, second.title)
        assert [span.name for span in first.spans] == [span.name for span in second.spans]
        for upper, lower in zip(first.panels, second.panels, strict=True):
            assert upper.y.name == lower.y.name
            assert [(line.name, line.at) for line in upper.lines] == [(line.name, line.at) for line in lower.lines]
            assert [mark.text for mark in upper.marks] == [mark.text for mark in lower.marks]
            for trace, again in zip(upper.traces, lower.traces, strict=True):
                assert trace.name == again.name
                np.testing.assert_allclose(trace.y, again.y, atol=1e-9)
    named, again = positions(shown(one)), positions(shown(other))
    assert list(named) == list(again)
    assert "outer dead centre" in named
    assert list(named.values()) == pytest.approx(list(again.values()), abs=1e-7)
    assert captions(one.best)[1:] == captions(other.best)[1:]  # sums of squares have another unit
    assert conclusions.design(one, ()) == conclusions.design(other, ())


def test_the_dead_centres_are_those_of_the_law_of_cosines() -> None:
    a, b, c, d = SIZES.values()
    named = positions(shown(by_dyads()))
    for name, reach in (("outer dead centre", b + a), ("inner dead centre", b - a)):
        angle = math.acos((reach**2 + d**2 - c**2) / (2.0 * reach * d)) + (math.pi if reach < b else 0.0)
        assert math.remainder(named[name] - angle, 2.0 * math.pi) == pytest.approx(0.0, abs=1e-7)
    assert math.remainder(named["smallest transmission angle"], 2.0 * math.pi) == pytest.approx(0.0, abs=1e-6)
    assert named["largest transmission angle"] == pytest.approx(math.pi, abs=1e-6)


@pytest.mark.slow
def test_several_requirements_have_their_charts_figures_and_files(tmp_path) -> None:
    law = {**LAW, "from": "26 deg", "measure": "max", "tolerance": "12 deg"}
    raw = {"title": "Two", "mechanism": FOUR_BAR, "requirements": [law, {"kind": "transmission"}], "limits": LIMITS}
    result = optlink.validate(optlink.read(raw), {})
    alone = by_section(measure="max")
    largest, anywhere = (math.degrees(np.max(np.abs(alone.error(at)))) for at in (None, np.linspace(0.0, 0.5 * np.pi, 20_001)))
    assert [chart.file for chart in view_of("design").charts(result) if chart.file] == ["law", "transmission"]
    text = words(table_of("design")(result))
    stated = re.search(r"largest error of function ([\d.]+) deg error: .* at most 12 deg", text)
    assert stated is not None, text
    assert float(stated[1]) == pytest.approx(anywhere, rel=1e-5)
    cosine = max(abs(SIZES["coupler"] ** 2 + SIZES["rocker"] ** 2 - r**2) for r in (400.0, 600.0))
    least = math.degrees(math.acos(cosine / (2.0 * SIZES["coupler"] * SIZES["rocker"])))
    assert f"worst transmission angle {least:.2f} deg" in text
    assert f"within {largest:.4g}°" in conclusions.design(result, ())
    files = {path.name for path in view_of("design").write(result, tmp_path)}
    assert {"points-function.csv", "points-transmission.csv", "law.png", "mechanism.png", "transmission.png"} <= files


def test_positions_are_drawn_with_coordinates_first_and_with_a_swinging_guide() -> None:
    """The angle of the rocker is shown beside a coordinate that comes first, and a guide is no joint of a dead centre."""
    stations = [
        {"kind": "position", "name": "hand", "output": "P.y", "at": "30 deg", "value": {"max": "900 mm"}},
        {"kind": "position", "name": "lever", "at": "30 deg", "value": ["0 deg", "180 deg"]},
    ]
    raw = {"title": "Stations", "mechanism": {**FOUR_BAR, "points": {"P": ["100 mm", "50 mm"]}}, "requirements": stations}
    view = shown(optlink.validate(optlink.read(raw), {}))
    assert view.output == "rocker"
    assert view.output_at(view.sweep(np.array([0.5])))[0].startswith("ψ ")
    whitworth = {
        "type": "dyads",
        "ground": {"A": ["0 mm", "0 mm"], "D": ["0 mm", "-200 mm"]},
        "links": {
            "crank": {"joints": ["A", "B"], "length": "60 mm"},
            "block": {"joints": ["B"]},
            "lever": {"joints": ["D", "E"], "length": "150 mm"},
        },
        "guides": {"G": {"slider": "block", "on": "lever", "through": "D"}},
        "assembly": {"G": "forward"},
    }
    law = {
        "kind": "function",
        "output": "lever",
        "law": "psi0 + 0.2*(phi - phi0)",
        "span": "60 deg",
        "start": "40 deg",
        "psi0": "90 deg",
    }
    named = positions(shown(optlink.validate(optlink.read({"title": "Law", "mechanism": whitworth, "requirement": law}), {})))
    turned = -math.pi / 2.0 - math.acos(60.0 / 200.0)  # the lever is tangent to the circle of B
    assert math.remainder(named["end of the forward stroke"] - turned, 2.0 * math.pi) == pytest.approx(0.0, abs=1e-6)
