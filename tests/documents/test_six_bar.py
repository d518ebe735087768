"""The block diagram of the six-bar's document, run as printed, beside the page and optlink."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from tests.documents import six_bar
from tests.documents.six_bar import PRINTED, Diagram, consistent, diagram, second
from tests.tiers import mostly_slow

PAGE = (Path(__file__).resolve().parents[2] / "docs" / "six-bar.md").read_text(encoding="utf-8")
RUNS = {"consistent start": (consistent, 0.0, True), "as printed": (lambda: PRINTED, 1000.0, True)}
RUNS["as printed, M3 = 0"] = (lambda: PRINTED, 1000.0, False)


def run(name: str) -> Diagram:
    start, load_across, with_moment = RUNS[name]
    return diagram(start(), load_across, with_moment)


@pytest.mark.slow
def test_the_equations_of_the_document_are_right_from_a_consistent_start():
    """With Fy6 in the vertical row, and the moment of the pin force at C."""
    own, course = run("consistent start"), second()
    for values, column in ((own.torque, "input.torque_Nm"), (own.guide, "F.normal_N"), (own.work, "input.work_J")):
        np.testing.assert_allclose(values[::4], course[column], atol=1e-7 * np.max(np.abs(values)))
    np.testing.assert_allclose(own.slide[::4], course["slider.s_m"], atol=2e-5)  # its start is rounded to 0.1 mm


@pytest.mark.parametrize(
    ("name", "slide", "torque", "guide", "work"),
    mostly_slow(
        [
            ("consistent start", 0.458, (-320.05, 278.83), (-1159.27, -126.62), 225.03),
            ("as printed", -0.633, (-317.48, 276.62), (-2186.27, -1135.99), 220.82),
            ("as printed, M3 = 0", -0.633, (-170.81, 150.77), (-2186.27, -1135.99), 99.62),
        ],
        ("consistent start", 0.458, (-320.05, 278.83), (-1159.27, -126.62), 225.03),
    ),
)
def test_the_printed_start_gives_the_figures_of_an_independent_integration(name, slide, torque, guide, work):
    own = run(name)
    assert own.slide[-1] == pytest.approx(slide, abs=5e-4)
    assert (np.min(own.torque), np.max(own.torque)) == pytest.approx(torque, abs=6e-3)
    assert (np.min(own.guide), np.max(own.guide)) == pytest.approx(guide, abs=6e-3)
    assert own.work[-1] == pytest.approx(work, abs=5e-3)


@pytest.mark.slow
def test_the_table_of_the_page_has_the_figures_of_the_diagram():
    lines = re.findall(r"^\| (.*) \|$", PAGE.partition("## The printed block diagram, run")[2].partition("**")[0], re.MULTILINE)
    head, *rows = (line.split(" | ") for line in lines)
    assert head[1:] == list(RUNS)
    for k, name in enumerate(RUNS, 1):
        own = run(name)
        computed = {
            "slide s at the end, m": [own.slide[-1]],
            "E off its guide, mm": [1e3 * np.min(own.below), 1e3 * np.max(own.below)] if k > 1 else [0.0],
            "driving torque M1, N·m": [np.min(own.torque), np.max(own.torque)],
            "guide force RF, N": [np.min(own.guide), np.max(own.guide)],
            "work W1, J": [own.work[-1]],
        }
        assert [row[0] for row in rows] == list(computed)
        for row in rows:
            for number, value in zip(row[k].split(" ... "), computed[row[0]], strict=True):
                assert float(number) == pytest.approx(value, abs=0.5000001 * 10.0 ** -len(number.partition(".")[2])), row
    assert np.ptp(run("consistent start").below) < 1e-9
    assert max(np.abs(run("consistent start").below)) < 1e-9


def test_the_calls_of_the_page_give_the_values_beside_them():
    text = re.search(r"```python\n(.*?)```", PAGE, re.DOTALL)[1]
    names: dict = {}
    exec(text, names)
    stated = [float(number) for number in re.search(r"^theta2 .*# (.*)$", text, re.MULTILINE)[1].split(", ")]
    np.testing.assert_allclose(names["theta2"].parts, stated, atol=5e-5)
    columns = {"B": names["B"], "C": names["C"], "E": names["E"]}
    for point, (x, y) in columns.items():
        for part, ending in zip(zip(x.parts, y.parts, strict=True), ("{}_m", "v{}_m_s", "a{}_m_s2"), strict=True):
            expected = [six_bar.first(f"{point}.{ending.format(axis)}") for axis in "xy"]
            np.testing.assert_allclose(part, expected, atol=1e-12)
