"""The short page: two printed sheets with what a customer asks for, and without words of the search."""

from __future__ import annotations

import base64
import itertools
import math
import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import optlink
from optlink.presentation import chart_mpl
from optlink.presentation.html import moving_linkage
from optlink.presentation.html.moving_linkage import cycle_of
from optlink.presentation.html.page import page, write_page
from optlink.presentation.html.study_page import _datum, abridged
from optlink.presentation.interface import page_content
from optlink.presentation.views.conclusions import _compared
from optlink.presentation.views.design_charts import output
from optlink.presentation.views.design_tables import _within
from optlink.presentation.views.design_view import DesignView
from optlink.presentation.views.search_tables import limits
from optlink.problem.templates import template
from optlink.tasks.results.design import TermFigure
from optlink.validation import Check
from tests.browser import console, faults, opened
from tests.cli.test_cli import run
from tests.solved import once, shared_searches
from tests.tiers import mostly_slow

RECORDED = sorted((Path(__file__).parents[1] / "data" / "results").glob("*/*.json"))
NO_PAGE = ("output-sensitivity", "tuning")
SOURCES = [*optlink.shipped(), *(str(path) for path in RECORDED if path.stem not in NO_PAGE)]
KEPT = ("crank-rocker", *(one for one in SOURCES if Path(one).stem in ("pareto", "control-comparison", "design-infeasible")))
SEARCH = re.compile(r"KKT|multistart|Lagrange|shadow|iterations|local(?:ly)? optim|ipopt|residual|certif|proven|multiplier", re.I)


def made(source: str) -> str:
    return page(page_content(optlink.read_result(source) if source.endswith(".json") else source, {}), brief=True)


def short(source: str) -> str:
    """The page, made once per run, from the search that other tests need as well."""
    with shared_searches():
        return once(f"short page of {Path(source).stem}", lambda: made(source))


def text_of(document: str) -> str:
    return re.sub(r"<(script|style)\b.*?</\1>|<[^>]+>", " ", document, flags=re.S)


@pytest.mark.parametrize("source", mostly_slow(SOURCES, *KEPT))
def test_a_short_page_fills_at_most_two_sheets(driver, source, tmp_path):
    place = tmp_path / "page.html"
    place.write_text(short(source), encoding="utf-8")
    assert opened(driver, place) == ([], [])
    printed = base64.b64decode(driver.execute_cdp_cmd("Page.printToPDF", {"preferCSSPageSize": True})["data"])
    assert 1 <= len(re.findall(rb"/Type\s*/Page\b", printed)) <= 2
    assert console(driver) == []


def test_paper_shows_positions_in_place_of_the_motion(driver, tmp_path):
    place = tmp_path / "page.html"
    write_page(page_content("crank-rocker", {}), place, brief=True)
    opened(driver, place)
    stills, moving, chart, printed = (
        driver.find_element("css selector", name) for name in (".stills", ".linkage", ".plot", "img.paper")
    )
    assert moving.is_displayed()
    assert chart.is_displayed()
    assert not stills.is_displayed()
    assert not printed.is_displayed()
    assert faults(driver) == []
    driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": "print"})
    assert stills.is_displayed()
    assert printed.is_displayed()
    assert not moving.is_displayed()
    assert not chart.is_displayed()
    assert driver.execute_script("return arguments[0].naturalWidth", printed) > 600
    drawn = [
        figure.get_attribute("innerHTML") for figure in stills.find_elements("css selector", "figure svg [data-layer=bodies]")
    ]
    assert len(set(drawn)) == 4
    driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": ""})


def test_printed_charts_keep_legends_and_names_of_axes_clear(monkeypatch):
    figures = []
    monkeypatch.setattr(chart_mpl, "legible", figures.append)
    made("shaper")
    assert [len(figure.axes) for figure in figures] == [2, 1]
    for figure in figures:
        figure.canvas.draw()
        panels = [axes.get_window_extent() for axes in figure.axes]
        legends = [axes.get_legend().get_window_extent() for axes in figure.axes if axes.get_legend()]
        assert legends
        assert not [legend for legend in legends for panel in panels if legend.count_overlaps([panel])]
        names = [axes.yaxis.label.get_window_extent() for axes in figure.axes]
        assert all(figure.bbox.y0 <= name.y0 for name in names)
        assert all(low.y1 < high.y0 for high, low in itertools.pairwise(names))


@pytest.mark.parametrize("source", mostly_slow(optlink.shipped(), "crank-rocker", "shaper"))
def test_a_short_page_has_no_words_of_the_search(source):
    told = text_of(short(source))
    assert not SEARCH.search(told)
    assert "linkage" in told.partition("Dimensions")[0]


def test_a_margin_that_four_digits_do_not_show_is_none_unless_the_limit_is_missed():
    """A customer read 1.000008 with a margin of 8.4e-06."""
    ratio = [
        Check("time ratio, least", True, 1.0000084, ">= 1", ""),
        Check("time ratio, largest", True, 1.0000084, "<= 1.01", ""),
    ]
    missed = Check("smallest transmission angle", False, 44.9999, ">= 45", "deg")
    (table,) = limits([*ratio, missed], 10)
    assert [[cell.text for cell in row] for row in table.rows] == [
        ["smallest transmission angle", "44.9999 deg", ">= 45 deg", "0.0001 deg short"],
        ["time ratio", "1", "1 ... 1.01", "none"],
    ]


def test_a_short_page_does_not_speak_of_the_initial_design():
    result = SimpleNamespace(
        whole=SimpleNamespace(required=[]),
        initial=SimpleNamespace(valid=False),
        figures=[TermFigure("objective", "peak torque", 264.0, 211.3, "minimised", "N*m")],
    )
    assert _compared(result, False) == "Peak torque 211.3 N·m."
    assert "initial design" in _compared(result, True)


def test_the_sentence_of_a_short_page_states_the_swing():
    problem = {"limits.swing_angle": "90 deg +- 0.5 deg", "limits.time_ratio": [1, 1.01]}
    result = optlink.solve(optlink.read(template("wiper").text, "wiper").override(problem), starts=1, certify=False)
    assert "swing angle 89.5°; the smallest transmission angle" in text_of(page(page_content(result, {}), brief=True))


@pytest.mark.parametrize(
    ("most", "size", "told"),
    [
        (0.38e-3, 0.083, "0.38 mm (root mean square 0.2687 mm)"),
        (0.9e-6, 0.083, "0.001 mm"),  # the sum of squares may have any digits below it
        (0.9e-6, 0.0083, "0.0009 mm (root mean square 0.0006364 mm)"),
    ],
)
def test_a_sentence_tells_no_deviation_that_nobody_can_make(most, size, told):
    assert _within(np.array([most, 0.0]), size) == told


def test_pages_say_from_where_crank_angles_are_measured():
    """Of a four-bar whose frame is turned from its frame, else from the x axis; a slide that drives has no crank angle."""
    sizes = {"crank": "20 mm", "coupler": "60 mm", "rocker": "50 mm", "frame": "70 mm", "direction": "20 deg"}
    turned = optlink.read({"title": "Turned", "mechanism": sizes})
    lift = optlink.read(template("lift").text, "lift")
    for problem, told in ((turned, "A → D"), (optlink.load("crank-rocker"), "the x axis"), (lift, "")):
        words = _datum(moving_linkage.turning(optlink.analyze(problem), 24))
        assert words == ([f"Crank angles are measured from {told}, counter-clockwise."] if told else [])


def test_a_crank_that_swings_is_shown_in_its_range():
    """Sentence, drawing, printed positions and slider of a linkage whose crank could turn fully."""
    result = optlink.validate(optlink.load("crank-rocker").override({"limits.crank": "span"}), {"coupler": 0.4, "rocker": 0.24})
    begin, turned = result.best.rotation
    text, angles = page(page_content(result, {}), brief=True), np.degrees([begin, begin + turned])
    assert f"its crank, which swings between {angles[0]:.2f}° and {angles[1]:.2f}°:" in text_of(text)
    assert f">{math.degrees(turned):.4g}°<" in text
    assert ">360°<" not in text
    stops = moving_linkage.turning(cycle_of(result.machine, {}), 360).stops.values
    assert (stops[0], stops[-1]) == pytest.approx(tuple(angles), abs=1e-6)
    assert re.search(rf"crank swings +{angles[0]:.2f} ... {angles[1]:.2f} +deg", str(result))
    assert result.best.strokes == {}
    changed = optlink.load("crank-rocker").override({"requirement.span": "-90 deg", "limits.crank": "span"})
    clockwise = optlink.validate(changed, {"coupler": 0.4, "rocker": 0.24})
    low, high = clockwise.best.swing
    assert high == pytest.approx(clockwise.best.rotation[0])
    assert clockwise.machine.model.linkage.limits == pytest.approx((low, high))
    assert clockwise.machine.model.driving.first == pytest.approx(high)


def test_limits_have_values_and_margins():
    checks = optlink.solve("crank-rocker").best.validation.checks
    (table,) = limits(checks, 10)
    rows = [[cell.text for cell in row] for row in table.rows]
    assert rows == [
        ["largest transmission angle", "135 deg", "<= 135 deg", "none"],
        ["smallest transmission angle", "70.38 deg", ">= 45 deg", "25.4 deg"],
    ]
    assert len(limits(checks, 1)[0].rows) == 1
    assert "1 more" in limits(checks, 1)[0].notes[0].text


def test_a_violated_limit_comes_first_and_a_value_is_one_row():
    sides = [Check("stroke: stroke of ram", True, 500.0, f"{sense} 500", "mm") for sense in (">=", "<=")]
    angle = Check("smallest transmission angle", False, 42.0, ">= 45", "deg")
    other = Check("link lengths re-measured in motion", True, 0.0, "<= 1e-9", "mm")
    (table,) = limits([*sides, other, angle], 10)
    assert [[cell.text for cell in row] for row in table.rows] == [
        ["smallest transmission angle", "42 deg", ">= 45 deg", "3 deg short"],
        ["stroke of ram", "500 mm", "= 500 mm", "met"],
    ]


def test_a_range_is_one_row_with_as_many_digits_as_show_its_least_margin():
    def sides(name, value, low, high, unit=""):
        return [Check(name, True, value, f">= {low}", unit), Check(name, True, value, f"<= {high}", unit)]

    end = sides("bottom: end of the forward stroke of ram", 518.9632391, "518.96", "519.04", "mm")
    least, largest = sides("time ratio, equal strokes", 1.0000391, "1", "1.001")
    ratio = [replace(least, name=f"{least.name}, least"), replace(largest, name=f"{largest.name}, largest")]
    (table,) = limits([*end, *ratio], 10)
    assert [[cell.text for cell in row] for row in table.rows] == [
        ["end of the forward stroke of ram", "518.963 mm", "518.96 ... 519.04 mm", "0.00324 mm"],
        ["time ratio, equal strokes", "1.00004", "1 ... 1.001", "3.91e-05"],
    ]


def test_a_chart_marked_for_the_short_page_comes_before_others():
    from optlink.presentation.html.page import _report

    study = _report(page_content("crank-rocker", {}))
    *before, curves = study.sections
    marked = replace(curves, parts=[replace(curves.parts[0], brief=False), *curves.parts[1:]])
    titles = [chart.title for chart in abridged(replace(study, sections=[*before, marked])).sections[-1].parts]
    assert titles[0] == "Transmission angle"
    assert len(titles) == 2


@pytest.mark.slow
def test_a_short_page_draws_the_design_alone():
    from optlink.presentation.html.page import _report

    def curves(sections):
        charts = (part for section in sections for part in section.parts if hasattr(part, "panels"))
        return [curve.name for chart in charts for panel in chart.panels for curve in panel.traces]

    with shared_searches():
        study = _report(page_content("shaper-design", {}))
    assert any("initial" in name for name in curves(study.sections))
    shown = [str(curve.get("name")) for part in abridged(study).sections[-1].parts for curve in part.figure["data"]]
    assert any("result" in name for name in shown)
    assert not any("initial" in name for name in shown)


def test_the_command_and_the_function_write_the_same_short_page(tmp_path):
    facts = {"date": "2026-01-02"}
    optlink.report("crank-rocker", tmp_path / "a.html", facts, brief=True)
    done = run("report", "crank-rocker", "-o", str(tmp_path / "b.html"), "--brief", "--date", facts["date"])
    assert done.exit_code == 0, done.stderr
    assert (tmp_path / "a.html").read_text() == (tmp_path / "b.html").read_text()
    assert 'class="brief"' in (tmp_path / "a.html").read_text()


@pytest.mark.slow
def test_the_short_page_of_a_swing_has_the_curve_of_the_lever_with_its_extremes():
    mechanism = {"crank": "21 mm", "coupler": "249 mm", "rocker": "30 mm", "frame": "250 mm", "type": "four-bar"}
    raw = {
        "title": "A lever",
        "mechanism": {**mechanism, "rocker": {"bounds": ["20 mm", "40 mm"]}, "assembly": "left"},
        "requirement": {"kind": "transmission"},
    }
    result = optlink.validate(optlink.read(raw), {"rocker": 0.03})
    (chart,) = output(DesignView(result.best))
    angle = chart.panels[0].traces[0].y

    def at_dead_centre(diagonal):  # the law of cosines in the triangle A, C, D, with the crank in line with the coupler
        return 180.0 - math.degrees(math.acos((30.0**2 + 250.0**2 - diagonal**2) / (2.0 * 30.0 * 250.0)))

    ends = sorted(at_dead_centre(249.0 + turn * 21.0) for turn in (1.0, -1.0))
    assert [np.min(angle), np.max(angle)] == pytest.approx(ends, abs=0.01)
    assert chart.brief
    assert "Angle of rocker" in text_of(page(page_content(result, {}), brief=True))
