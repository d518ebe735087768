"""Results in notebooks: a drawing that a slider moves, without network, kernel or names that clash."""

from __future__ import annotations

import json
import re
from html import unescape
from typing import Any

import numpy as np
import pytest

import optlink
from optlink.linkage.motion import sweep
from optlink.studies import pareto, sensitivities
from tests.browser import console, requests

LARGEST = 150_000  # bytes


def motion(html: str) -> dict[str, Any]:
    (computed,) = re.findall(r'data-motion="([^"]*)"', html)
    return json.loads(unescape(computed))


@pytest.fixture(scope="module")
def result() -> Any:
    return optlink.solve(optlink.load("crank-rocker"))


def test_the_slider_moves_the_design(result):
    """The coordinates in the page are those of the linkage over its revolution; the drawing shows the first position."""
    html = result._repr_html_()
    data = motion(html)
    angles = np.radians(data["slider"]["values"])
    moved = sweep(result.problem.model.linkage, result.design, angles)
    for name, place in data["points"].items():
        np.testing.assert_allclose(np.stack([place["x"], place["y"]], axis=1), moved.position(name) * [1e3, -1e3], atol=1e-2)
    assert angles[-1] - angles[0] == pytest.approx(2.0 * np.pi)
    assert angles[0] == pytest.approx(result.design["phi0"])
    first = data["bodies"]["coupler"]
    assert f"rotate({first['a'][0]:g})" in html
    assert f'max="{len(angles) - 1}"' in html


@pytest.mark.parametrize(
    ("made", "moves", "charts"),
    [
        (lambda: optlink.analyze(optlink.load("shaper")), True, 0),
        pytest.param(lambda: optlink.simulate(optlink.load("slider-crank"), rows=50), True, 1, marks=pytest.mark.slow),
        (lambda: sensitivities(optlink.load("crank-rocker")), True, 1),
        pytest.param(
            lambda: pareto(optlink.load("crank-rocker"), "error, limits.transmission_angle.max", points=3, workers=1),
            True,
            1,
            marks=pytest.mark.slow,
        ),
    ],
    ids=["analysis", "simulation", "sensitivity", "pareto"],
)
def test_every_kind_is_small_and_self_contained(made, moves, charts):
    result = made()
    html = result._repr_html_()
    assert len(html.encode()) < LARGEST
    assert html.count("data-motion=") == moves
    assert html.count("<svg") == moves + charts
    assert "<table" in html
    assert not re.findall(r'(?:src|href)="(?!#)', html)
    used, again = (set(re.findall(r'(?:url\(|href=")#([^")]+)', text)) for text in (html, result._repr_html_()))
    assert all(f'id="{name}"' in html for name in used)
    assert not used & again


def test_a_design_that_cannot_be_assembled_has_a_table_alone():
    problem = optlink.load("crank-rocker")
    html = optlink.validate(problem, {"coupler": 0.2, "rocker": 0.2, "phi0": 0.5})._repr_html_()
    assert "<table" in html
    assert "data-motion" not in html


@pytest.mark.slow
def test_two_results_on_a_page_move_independently(driver, result, tmp_path):
    """In a browser: the slider of the second output moves its own drawing and nothing of the first."""
    path, shaper = tmp_path / "two.html", optlink.analyze(optlink.load("shaper"))._repr_html_()
    path.write_text(f"<meta charset='utf-8'><link rel='icon' href='data:,'>{result._repr_html_()}{shaper}")
    console(driver), requests(driver, path)  # those of pages before
    driver.get(path.as_uri())
    read = "return [...document.querySelectorAll('.optlink-motion')].map((one) => one.querySelector('svg').outerHTML)"
    before = driver.execute_script(read)
    assert len(before) == 2
    driver.execute_script(
        "const slider = document.querySelectorAll('.optlink-motion input')[1];"
        "slider.value = 30; slider.dispatchEvent(new Event('input'))"
    )
    after = driver.execute_script(read)
    assert after[0] == before[0]
    pose = motion(shaper)["bodies"]["coupler"]
    x, y, angle = (repr(pose[name][30]).removesuffix(".0") for name in "xya")
    assert f'data-body="coupler" transform="translate({x} {y}) rotate({angle})"' in after[1]
    angle = driver.execute_script("return document.querySelectorAll('.optlink-motion output')[arguments[0]].textContent", 3)
    assert angle == f"{motion(shaper)['slider']['values'][30]:.1f}°"
    assert console(driver) == []
    assert requests(driver, path) == []


def test_a_printed_result_adds_no_output_to_a_cell(result, monkeypatch):
    shown = []
    monkeypatch.setattr("rich.console._is_jupyter", lambda: True)
    monkeypatch.setattr("rich.jupyter.display", lambda *parts: shown.append(parts))
    assert "optimal, valid" in str(result)
    assert shown == []
