"""Sliders of a problem in a notebook, through the models of the widgets: what moves, what is optimised again, what is shown."""

from __future__ import annotations

import asyncio
import re
import sys

import numpy as np
import pytest

import optlink
from optlink.errors import InputError
from optlink.report.html import notebook as module

pytest.importorskip("ipywidgets")
LIMIT = "limits.transmission_angle.max"


@pytest.fixture(scope="module")
def begun():
    return optlink.explore("crank-rocker", sliders=True)


@pytest.fixture(scope="module")
def begun_shaper():
    return optlink.explore("shaper", sliders=True)


def reset(shown):
    """Set the sliders of what is fixed to the values of the file, without a search."""
    shown.live.value = False
    for key, knob in shown.knobs.items():
        if knob.key and shown.sliders[key].value != knob.value:
            shown.sliders[key].value = knob.value
    if shown._designed and not shown.result.valid:
        shown.optimise()
    shown.live.value = True
    return shown


@pytest.fixture
def rocker(begun):
    return reset(begun)


@pytest.fixture
def shaper(begun_shaper):
    return reset(begun_shaper)


def test_the_explorer_starts_at_the_optimum(begun):
    fixed = {"mechanism.crank", "mechanism.frame", "limits.transmission_angle.min", LIMIT}
    assert set(begun.sliders) == {"coupler", "rocker"} | fixed
    assert begun.sliders["coupler"].value == pytest.approx(412.865, abs=1e-3)
    assert (begun.sliders["coupler"].min, begun.sliders["coupler"].max) == pytest.approx((100.0, 900.0))
    assert begun.sliders[LIMIT].description == "transmission angle max [deg]"
    assert begun.result.objective == pytest.approx(0.00759237, rel=1e-6)
    assert "optimal" in begun.status.value
    assert "0.00759" in begun.chart.value
    assert begun.drawing.value.count("<svg") == begun.chart.value.count("<svg") == 1


def test_a_design_variable_is_validated(rocker):
    """The figures are those of `validate`; the check that fails is named."""
    before = rocker.drawing.value
    rocker.sliders["rocker"].value = 215.0
    design = {"coupler": rocker.sliders["coupler"].value / 1e3, "rocker": 0.215}
    reference = optlink.validate(optlink.load("crank-rocker"), design)
    assert rocker.result.objective == pytest.approx(reference.objective, rel=1e-12)
    assert not rocker.result.valid
    failed = [check.name for check in reference.validation.checks if not check.passed]
    assert failed
    assert all(f"{name}</" in rocker.status.value for name in failed)
    assert f"{len(failed)} of {len(reference.validation.checks)} checks fail" in rocker.status.value
    assert rocker.drawing.value != before
    rocker.optimise()
    assert rocker.result.valid
    assert rocker.sliders["rocker"].value == pytest.approx(232.246, abs=1e-3)


def test_a_changed_limit_is_reoptimised(rocker):
    rocker.sliders[LIMIT].value = 125.0
    reference = optlink.solve(optlink.load("crank-rocker", {LIMIT: "125 deg"}))
    assert rocker.result.objective == pytest.approx(reference.objective, rel=1e-9)
    assert rocker.sliders["coupler"].value == pytest.approx(1e3 * reference.design["coupler"], rel=1e-9)
    assert rocker.problem.raw["limits"]["transmission_angle"][1] == "125.0 deg"
    rocker.live.value = False
    rocker.sliders[LIMIT].value = 120.0
    assert rocker.result.design["coupler"] == pytest.approx(reference.design["coupler"], rel=1e-9)
    assert not rocker.result.valid
    rocker.button.click()
    assert rocker.result.valid
    assert rocker.result.objective > reference.objective


@pytest.mark.slow
def test_slider_rounding_does_not_change_the_design(rocker):
    """A front end rounds the value that it shows to a step of the slider, and sends it back."""
    rocker.optimise()
    result, slider = rocker.result, rocker.sliders["coupler"]
    slider.value = slider.min + round((slider.value - slider.min) / slider.step) * slider.step
    assert rocker.result is result
    assert slider.value == pytest.approx(1e3 * result.design["coupler"], abs=0.05)


def test_a_value_that_is_refused_keeps_the_last_result(rocker):
    result, slider = rocker.result, rocker.sliders["mechanism.frame"]
    slider.min = 0.0
    slider.value = 0.0
    assert rocker.result is result
    assert "a length must be positive" in rocker.status.value


@pytest.mark.slow
def test_conflicting_limits_are_listed(rocker):
    rocker.sliders[LIMIT].value = 125.0
    rocker.sliders["mechanism.frame"].value = 250.0
    assert "no feasible design" in rocker.status.value
    assert "Conflicting limits" in rocker.status.value


def test_the_crank_moves_the_drawing(rocker):
    """B is at the crank angle shown by the slider."""
    rocker.crank.value = 30
    angle = np.radians(rocker._moving.stops.values[30])
    (place,) = re.findall(r'<circle data-point="B" transform="translate\((\S+) (\S+)\)"', rocker.drawing.value)
    assert [float(value) for value in place] == pytest.approx([100.0 * np.cos(angle), -100.0 * np.sin(angle)], abs=1e-2)
    assert rocker.angle.value.startswith(rocker._moving.stops.text(30))


def test_machines_are_analysed(shaper):
    assert "torque" in shaper.chart.value
    before = shaper.chart.value
    shaper.sliders["mechanism.links.crank.length"].value = 100.0
    reference = optlink.analyze(optlink.load("shaper", {"mechanism.links.crank.length": "100 mm"}))
    assert shaper.result.figures == reference.figures
    assert shaper.chart.value != before
    assert not hasattr(shaper.panel.children[0].children[0].children[-1], "on_click")


def test_computation_waits_for_the_sliders_to_rest(shaper, monkeypatch):
    """In a kernel the result is computed once, for the last values, after the sliders rest."""
    calls = []
    monkeypatch.setattr(module, "PAUSE", 0.01)
    monkeypatch.setattr(module, "analyze", lambda problem: calls.append(problem) or optlink.analyze(problem))

    async def drag() -> None:
        for length in (110.0, 105.0, 102.0):
            shaper.sliders["mechanism.links.crank.length"].value = length
        assert calls == []
        await asyncio.sleep(0.05)
        assert len(calls) == 1
        shaper.sliders["mechanism.links.crank.length"].value = 104.0
        assert shaper.result.machine.sizes["crank.length"] == pytest.approx(0.104)  # whoever asks does not wait

    asyncio.run(drag())
    assert [call.raw["mechanism"]["links"]["crank"]["length"] for call in calls] == ["102.0 mm", "104.0 mm"]


def test_a_notebook_without_widgets_shows_the_result(rocker):
    shown = rocker._repr_mimebundle_()
    assert "application/vnd.jupyter.widget-view+json" in shown
    assert "optlink-motion" in shown["text/html"]
    assert shown["text/plain"].startswith("<Explorer of <FunctionResult 'crank-rocker'")


def test_a_missing_package_is_reported(monkeypatch):
    monkeypatch.setitem(sys.modules, "ipywidgets", None)
    with pytest.raises(InputError, match=r'ipywidgets.*pip install "optlink\[notebook\]"'):
        optlink.explore("crank-rocker", sliders=True)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["law-slider-crank", "transmission-optimal", "press-toggle", "balance-four-bar", "function-sin"])
def test_every_kind_can_be_explored(name):
    shown = optlink.explore(name, sliders=True)
    for key, slider in [*shown.sliders.items()][:2]:
        slider.value = 0.4 * slider.min + 0.6 * slider.max
        assert shown.status.value, key
    assert "<svg" in shown.chart.value or not np.isfinite(shown.result.objective)  # a design that cannot be assembled
