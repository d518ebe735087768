"""Pages of stored results: they agree with the computation, refuse damaged files in one sentence, and work in a browser."""

from __future__ import annotations

import base64
import csv
import itertools
import json
import math
import re
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import optlink
from optlink.errors import InputError
from optlink.presentation.html.shell import MAX_BYTES, PageContent
from optlink.presentation.html.study_page import content_of, study_page
from optlink.presentation.registry import KINDS, read_result, stored_page
from optlink.presentation.view import StoredStudy
from optlink.studies.fronts.design_objectives import ParetoObjective
from optlink.studies.tolerances.robust_design import RobustDesign
from tests.browser import colours, console, faults, opened as shown, requests
from tests.cli.test_cli import run
from tests.presentation.test_report_page import Reader, checked_by_plotly, poses, slide_to
from tests.solved import folder_once

COMMANDS = {
    "course": ("simulate", "six-bar", "--duration", f"{2.0 * math.pi / 10.0!r} s", "--points", "360"),
    "play": ("simulate", "crank-rocker-clearance", "--revolutions", "2", "--points", "90", "--tolerance", "1e-6"),
    "compared": (
        "simulate",
        "crank-rocker-clearance",
        "--control",
        "compare",
        "--revolutions",
        "1",
        "--starts",
        "2",
        "--tolerance",
        "1e-5",
    ),
    "balance": ("balance", "balance-four-bar", "--trade", "force,torque", "--points", "5"),
    "tolerance": (
        *("study", "tolerance", "crank-rocker", "--tolerance", "coupler=0.3 mm", "--tolerance", "rocker=0.2 mm uniform"),
        *("--limit", "2.33 deg", "--samples", "4096", "--allocate", "90 %"),
    ),
    "sensitivity": ("study", "sensitivity", "crank-rocker", "--check"),
    "solve": ("solve", "crank-rocker"),
}
FOLDERS = {
    "sweep": ("study", "sweep", "crank-rocker", "--vary", "limits.transmission_angle.max=110..179 deg:24"),
    "map": (
        "study",
        "sweep",
        "crank-rocker",
        "--vary",
        "mechanism.frame=480..520 mm:3",
        "--vary",
        "limits.transmission_angle.max=130..140 deg:4",
    ),
    "many": (
        *("study", "sweep", "crank-rocker", "--analyze", "--column", "C.transmission_rad", "--points", "24"),
        *("--design", "rocker=232 mm", "--design", "coupler=400 mm", "--vary", "mechanism.frame=480..520 mm:2"),
        *("--vary", "mechanism.crank=90..100 mm:2", "--vary", "mechanism.coupler=400..420 mm:3"),
    ),
    "front": ("study", "pareto", "crank-rocker", "--objectives", "error, limits.transmission_angle.max", "--points", "6"),
}
RECORDED = [name for name in (*COMMANDS, *FOLDERS) if name not in ("sensitivity", "solve")]


@pytest.fixture(scope="module")
def results(tmp_path_factory) -> Path:
    def fill(folder: Path) -> None:
        for name, command in COMMANDS.items():
            done = run(*command, "--json")
            assert done.exit_code == 0, done.stderr
            (folder / name).mkdir()
            (folder / name / "result.json").write_text(done.stdout, encoding="utf-8")
        for name, command in FOLDERS.items():
            assert run(*command, "--out", str(folder / name)).exit_code == 0

    return folder_once("recorded results", tmp_path_factory.mktemp("results"), fill)


@pytest.fixture(scope="module")
def pages(results, tmp_path_factory) -> Callable[[str], Path]:
    """The page of a result and the output of its command, written on first use, once for all processes."""

    @cache
    def page(name: str) -> Path:
        def fill(folder: Path) -> None:
            done = run("report", str(results / name), "-o", str(folder / "a.html"), "--json")
            assert done.exit_code == 0, done.stderr
            (folder / "told.json").write_text(done.stdout, encoding="utf-8")

        return folder_once(f"page of recorded {name}", tmp_path_factory.mktemp(name), fill) / "a.html"

    return page


def document(results: Path, name: str) -> dict:
    return json.loads((results / name / "result.json").read_text())


@cache
def sheet(results: Path, name: str) -> PageContent:
    return content(read_result(results / name))


def content(result: optlink.problem.document.Document) -> PageContent:
    """Return the content of the page of a study or a simulation."""
    computed = stored_page(result, {}, "result.json")
    assert isinstance(computed, StoredStudy)
    return content_of(computed, 90)


def trace(page: PageContent, name: str) -> dict:
    return next(one for chart in page.charts for one in chart.figure["data"] if one["name"].startswith(name))


def numbers(values: list) -> np.ndarray:
    return np.array([math.nan if value is None else value for value in values])


# --- content of pages ----------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("name", RECORDED)
def test_a_page_is_complete_small_and_safe(results, pages, name):
    path = pages(name)
    assert json.loads(path.with_name("told.json").read_text())["bytes"] == path.stat().st_size < MAX_BYTES
    read, record = Reader(path.read_text()), document(results, name)
    assert read.scripts == 4
    assert read.handlers == []
    assert all(address.startswith(("#", "data:,")) for address in read.addresses)
    assert len(read.ids) == len(set(read.ids))
    assert {address[1:] for address in read.addresses if address.startswith("#")} <= set(read.ids)
    words = " ".join(" ".join(texts) for tag, texts in read.texts.items() if tag not in ("script", "style"))
    assert record["title"] in words
    assert record["problem_hash"] in words
    assert "nan" not in re.findall(r"[a-z]+", words)


@pytest.mark.slow
@pytest.mark.parametrize("name", RECORDED)
def test_every_chart_is_a_valid_plotly_figure(results, name):
    page = sheet(results, name)
    assert page.charts
    for chart in page.charts:
        checked_by_plotly(chart.figure)
        if chart.picks is not None:
            assert all(len(row) == len(chart.picks.names) for row in chart.picks.rows)
            assert len(chart.picks.rows) == len(chart.picks.x) == len(chart.picks.y)
            assert chart.figure["data"][-1]["x"] == [chart.picks.x[chart.picks.first]]


@pytest.mark.slow
def test_a_simulation_at_constant_speed_is_the_analysis(results):
    """Published extremes of the torque and of the slide, read from the curves."""
    page = sheet(results, "course")
    torque = numbers(trace(page, "driving torque")["y"])
    assert np.max(torque) == pytest.approx(278.8344391, rel=2e-4)
    assert np.min(torque) == pytest.approx(-320.0521365, rel=2e-4)
    slide = numbers(trace(page, "position")["y"])
    assert np.ptp(slide) == pytest.approx(373.9041584796, rel=1e-4)
    stops = page.moving.stops
    assert stops.values[-1] == pytest.approx(2 * math.pi / 10.0)  # a revolution at 10 rad/s
    crank = numbers(page.moving.readouts[0].values)
    assert np.diff(crank) == pytest.approx(360.0 / (len(crank) - 1), abs=2e-3)


def test_a_simulation_is_drawn_with_the_sizes_that_ran(tmp_path):
    run = optlink.simulate(optlink.load("crank-rocker"), speed=5.0, rows=90, design={"coupler": 0.43, "rocker": 0.22})
    (tmp_path / "result.json").write_text(json.dumps(run.to_dict()))
    moving = content(read_result(tmp_path)).moving
    places = moving.scene.points["C"] - moving.scene.points["B"]
    assert np.hypot(*places.T) == pytest.approx(430.0, abs=1e-3)


@pytest.mark.slow
def test_an_orbit_stays_in_its_gap(results):
    record, page = document(results, "play"), sheet(results, "play")
    [gap] = record["gaps"]
    circle = trace(page, "clearance")
    assert np.hypot(numbers(circle["x"]), numbers(circle["y"])) == pytest.approx(gap["clearance"] * 1e3, rel=1e-5)
    deepest = max(record["columns"][f"{gap['point']}.penetration_m"])
    remark = next(chart.remark for chart in page.charts if chart.title.startswith("Journal orbit"))
    times = float(re.search(r"beyond the circle (\S+)-fold", remark)[1])
    for name in ("apart", "in contact"):
        path = trace(page, name)
        away = np.hypot(numbers(path["x"]), numbers(path["y"]))
        assert np.nanmax(away) <= (gap["clearance"] + times * deepest) * 1e3 + 1e-6
    error = numbers(trace(page, "deviation of rocker")["y"])
    assert np.nanmax(np.abs(error)) <= math.degrees(record["figures"]["peak_rad"]) * (1 + 1e-6)


@pytest.mark.slow
def test_a_stored_balance_leaves_no_shaking_force(results):
    """The full force balance (Berkof and Lowen 1969)."""
    page, record = sheet(results, "balance"), document(results, "balance")
    assert np.max(np.abs(numbers(trace(page, "balanced shaking force")["y"]))) < 1e-9
    shaking = next(chart for chart in page.charts if chart.title == "Shaking and drive")
    given = numbers(shaking.figure["data"][0]["y"])
    rms = next(one["before"] for one in record["measures"] if one["name"] == "rms shaking force")
    assert np.sqrt(np.mean(given[:-1] ** 2)) == pytest.approx(rms, rel=1e-6)


@pytest.mark.slow
def test_the_tolerances_of_a_page_add_up(results):
    record, page = document(results, "tolerance"), sheet(results, "tolerance")
    bands = {one["name"]: one for one in page.charts[0].figure["data"] if "customdata" in one}
    assert bands.keys() == {"coupler", "rocker"}
    assert np.sum([numbers(one["customdata"]) for one in bands.values()], axis=0) == pytest.approx(100.0, abs=1e-4)
    assert numbers(page.charts[0].figure["data"][-1]["y"]) == pytest.approx(100.0, abs=1e-4)
    inside, beyond = (np.sum(numbers(trace(page, name)["y"])) for name in ("within the limit", "beyond it"))
    assert inside + beyond == pytest.approx(100.0)
    edges = np.array(record["monte_carlo"]["histogram"]["edges"])
    held = np.array(record["monte_carlo"]["histogram"]["counts"])
    below = np.sum(held[edges[1:] <= record["limit"]]) / held.sum()
    above = np.sum(held[edges[:-1] <= record["limit"]]) / held.sum()
    assert below <= record["monte_carlo"]["yield"] <= above  # counted one by one, between the bins around the limit
    text = page.html()
    assert f"Yield {100 * record['monte_carlo']['yield']:.3f} %" in text
    low, high = record["monte_carlo"]["yield_interval_95_percent"]
    assert f"{100 * low:.3f} % ... {100 * high:.3f} %" in text


@pytest.mark.slow
def test_conclusions_state_the_main_figures(results):
    record = {name: document(results, name) for name in RECORDED}
    conclusions = {name: sheet(results, name).about.conclusion for name in RECORDED}
    assert f"{100 * record['tolerance']['monte_carlo']['yield']:.4g} % of the linkages" in conclusions["tolerance"]
    assert f"{record['course']['figures']['end.speed_rad_s'] * 30 / math.pi:.4g} rpm" in conclusions["course"]
    gap, figures = record["play"]["gaps"][0]["point"], record["play"]["figures"]
    assert f"deviate by {math.degrees(figures['rms_rad']):.4g}°" in conclusions["play"]
    assert f"N at {gap}" in conclusions["play"]
    best = min(record["compared"]["trials"].items(), key=lambda one: np.mean(one[1]["rms"]))[0]
    assert f"The best control is {best}:" in conclusions["compared"]
    assert f"decreases by {100 * record['balance']['reduction']:.4g} %" in conclusions["balance"]
    assert "24 of 24 points" in conclusions["sweep"]
    assert f"point {record['front']['knee']['point'] + 1}:" in conclusions["front"]


@pytest.mark.slow
def test_a_sweep_by_its_table(results):
    """Best row and changes of the active set, found in the CSV file by other means."""
    page = sheet(results, "sweep")
    with (results / "sweep" / "sweep.csv").open() as file:
        rows = list(csv.DictReader(file))
    best = min(range(len(rows)), key=lambda k: float(rows[k]["objective_rad2"]))
    picks = page.charts[0].picks
    assert picks.first == best
    assert float(picks.rows[best][picks.names.index("coupler [mm]")]) == pytest.approx(
        1e3 * float(rows[best]["coupler_m"]), rel=1e-6
    )
    places = [
        math.degrees(float(new["limits.transmission_angle.max_rad"]))
        for old, new in itertools.pairwise(rows)
        if old["active"] != new["active"]
    ]
    assert places  # from some angle on the limit holds no more
    assert [shape["x0"] for shape in page.charts[0].figure["layout"]["shapes"]] == pytest.approx(places)
    frame = 1e3 * read_result(results / "sweep").problem.model.quantities["frame"].value
    assert page.moving.scene.points["D"][0][0] == pytest.approx(frame)


@pytest.mark.slow
def test_a_map_has_every_point_at_its_place(results):
    page = sheet(results, "map")
    shaded = trace(page, "objective")
    with (results / "map" / "sweep.csv").open() as file:
        for row in csv.DictReader(file):
            i = min(range(len(shaded["y"])), key=lambda k: abs(shaded["y"][k] - 1e3 * float(row["mechanism.frame_m"])))
            j = min(range(4), key=lambda k: abs(shaded["x"][k] - math.degrees(float(row["limits.transmission_angle.max_rad"]))))
            assert shaded["z"][i][j] == pytest.approx(float(row["objective_rad2"]), rel=1e-5)
            number = shaded["customdata"][i][j]
            assert page.charts[0].picks.rows[number][0] == f"{1e3 * float(row['mechanism.frame_m']):g}"


@pytest.mark.slow
def test_a_front_by_its_table(results):
    """The knee by the distance from the chord, and every design that can be picked."""
    page = sheet(results, "front")
    with (results / "front" / "front.csv").open() as file:
        rows = list(csv.DictReader(file))
    names = list(rows[0])[:2]
    points = np.array([[float(row[name]) for name in names] for row in rows])
    scaled = (points - points.min(axis=0)) / np.ptp(points, axis=0)
    chord = scaled[-1] - scaled[0]
    off = (scaled - scaled[0]) @ np.array([-chord[1], chord[0]])
    picks = page.charts[0].picks
    assert picks.first == int(np.argmax(np.abs(off)))
    for row, record in zip(rows, picks.rows, strict=True):
        assert float(record[picks.names.index("rocker [mm]")]) == pytest.approx(1e3 * float(row["rocker_m"]), rel=1e-6)
    crank, rocker = (page.moving.scene.points[name] for name in "BC")
    assert np.hypot(*(rocker - crank).T) == pytest.approx(1e3 * float(rows[picks.first]["coupler_m"]), rel=1e-9)


@pytest.mark.slow
def test_three_objectives_have_a_colour(results):
    """A front of three, made from one of two: the colour of every point is its third objective."""
    two = read_result(results / "front")
    points = tuple(replace(point, values=(*point.values, math.radians(40.0 + k))) for k, point in enumerate(two.points))
    swing = ParetoObjective("swing", "swing", "deg", -1)
    assert two.reference is not None
    three = replace(two, objectives=(*two.objectives, swing), points=points, ends=(*two.ends, 1), knee=None)
    page = content(replace(three, reference=(*two.reference, 41.0)))
    cloud = page.charts[0].figure["data"][0]
    assert cloud["marker"]["color"] == pytest.approx([40.0 + k for k in range(len(points))])
    assert "swing [deg] (more is better)" in page.charts[0].picks.names
    checked_by_plotly(page.charts[0].figure)


def test_a_machine_that_stays_at_rest_has_a_page(tmp_path):
    """One row, no curve; a drive that is too weak is no damage."""
    change = ("--set", "drive.torque=1 N*m", "--set", "drive.initial_speed=0 rad/s")
    done = run("simulate", "shaper", *change, "--json")
    (tmp_path / "result.json").write_text(done.stdout)
    assert len(json.loads(done.stdout)["columns"]["time_s"]) == 1
    command = run("report", str(tmp_path), "-o", str(tmp_path / "a.html"))
    assert command.exit_code == 0
    assert "Came to rest" in command.stdout


def test_conflicting_limits_are_listed(tmp_path):
    change = ("--set", 'balance.limits={ "peak reaction at D" = "1 N" }')
    (tmp_path / "result.json").write_text(run("balance", "balance-six-bar", *change, "--json").stdout)
    done = run("report", str(tmp_path), "-o", str(tmp_path / "a.html"))
    assert done.exit_code == 1
    text = (tmp_path / "a.html").read_text()
    assert "No counterweights meet all limits" in text
    assert "Conflicting limits" in text


@pytest.mark.slow
def test_sensitivities_are_on_the_page_of_a_result(pages):
    """Sensitivities of a recorded optimum are those of the searched one, for which another test solves the problem again."""
    for name in ("solve", "sensitivity"):
        text = pages(name).read_text()
        assert "Sensitivities" in text
        assert "-1.929 %" in text
        assert ("Re-optimised on both sides of each" in text) is (name == "sensitivity")
    text = pages("sensitivity").read_text()
    assert text.index('id="sensitivities"') < text.index('id="design-and-checks"')


# --- what was changed ----------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("name", [*COMMANDS, *FOLDERS])
def test_a_changed_result_is_refused_in_one_sentence(results, tmp_path, name):
    """Every key missing, or with another value."""
    whole = document(results, name)
    for key, value in whole.items():
        for other in ({}, {key: None if value is not None else 1.0}, {key: "x"}):
            if other == {key: value}:
                continue
            copy = {name: item for name, item in whole.items() if name != key} | other
            (tmp_path / "result.json").write_text(json.dumps(copy))
            with pytest.raises(InputError) as caught:
                read_result(tmp_path)
            [fault] = caught.value.faults
            assert fault.remedy, key
            assert "\n" not in fault.message


@pytest.mark.slow
def test_the_sentences_of_changed_results(results, tmp_path):
    good = document(results, "tolerance")
    bad = {
        "a missing key": (
            {key: value for key, value in good.items() if key != "linear"},
            "the result was changed since it was written",
        ),
        "another number": (good | {"limit": 0.05}, "the result was changed since it was written"),
        "an endless number": (good | {"limit": math.inf}, "the result was changed since it was written"),
        "another version": ({**good, "schema": "optlink/tolerance/1"}, "has the format of another version"),
        "slopes of another version": (
            {**good, "schema": "optlink/output-sensitivity/1"},
            "has the format of another version",
        ),
        "no study": ({**good, "schema": "optlink/list/1"}, "not a result of optlink"),
        "no schema": ({"a": 1}, "not a result of optlink"),
    }
    for name, (copy, words) in bad.items():
        (tmp_path / "result.json").write_text(json.dumps(copy))
        done = run("report", str(tmp_path), "-o", str(tmp_path / "a.html"))
        assert done.exit_code == 2, name
        assert words in " ".join(done.stderr.split()), (name, done.stderr)
        assert done.stderr.count("Error:") == 1
        assert not (tmp_path / "a.html").exists()


def test_a_folder_without_a_result(tmp_path):
    done = run("report", str(tmp_path), "-o", str(tmp_path / "a.html"))
    assert done.exit_code == 2
    assert "the folder contains no result.json" in done.stderr
    assert "continue an interrupted study first" in done.stderr


@pytest.mark.slow
def test_a_shipped_problem_takes_precedence_over_a_folder(results, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "six-bar").mkdir()
    (tmp_path / "six-bar" / "result.json").write_bytes((results / "course" / "result.json").read_bytes())
    assert run("report", "six-bar", "-o", "a.html").stdout.endswith("Analysed; the file states no requirement to check\n")
    assert run("report", "six-bar/", "-o", "a.html").stdout.endswith("Finished\n")


@pytest.mark.slow
def test_a_study_cannot_be_exported(results, tmp_path):
    done = run("export", str(results / "sweep"), "-o", str(tmp_path / "a.dxf"))
    assert done.exit_code == 2
    assert "a sweep is not a single design, so it cannot be drawn" in done.stderr
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_markup_in_results_is_escaped(results):
    evil = "<script>window.caught = 1</script><img src=x onerror=alert(1)>"
    front = read_result(results / "front")
    front = replace(front, points=tuple(replace(point, active=evil, mark=evil) for point in front.points))
    read = Reader(study_page(stored_page(front, {}, "result.json")))
    assert read.scripts == 4
    assert read.handlers == []
    assert "img" not in read.texts
    for trace_ in content(front).charts[0].figure["data"]:
        assert evil not in str(trace_.get("text", ""))  # plotly reads texts of points as markup


def test_unknown_schemas_list_the_known_ones(tmp_path):
    (tmp_path / "a.json").write_text(json.dumps({"schema": "optlink/other/1"}))
    with pytest.raises(InputError, match="study pareto") as caught:
        read_result(tmp_path / "a.json")
    for name, kind in KINDS.items():
        assert kind.command.partition(" --")[0] in str(caught.value)
        assert kind.result().kind == kind.name == name


# --- in a browser --------------------------------------------------------------------------------------------------------------


NAMES = "return [...document.querySelectorAll('.picked dt')].map(one => one.textContent)"


def picked(driver) -> list[str]:
    return driver.execute_script("return [...document.querySelectorAll('[data-pick]')].map(one => one.textContent)")


@pytest.mark.slow
@pytest.mark.parametrize("name", [*RECORDED, "sensitivity"])
def test_a_page_in_a_browser(driver, pages, name):
    """No complaint, no request, all charts drawn; the slider moves the linkage; keys go from point to point; it fits."""
    from selenium.webdriver.common.keys import Keys

    path = pages(name)
    complaints, asked = shown(driver, path)
    assert (complaints, asked) == ([], [])
    charts = driver.execute_script("return document.querySelectorAll('.plot').length")
    assert charts == driver.execute_script(
        "return [...document.querySelectorAll('.plot')].filter(one => one.querySelector('svg')).length"
    )
    assert charts > 0
    if name not in ("compared", "many"):
        before = poses(driver)
        slide_to(driver, 20)
        after = poses(driver)
        assert before.keys() == after.keys()
        assert all(before[body] != after[body] for body in before)
        slider = driver.find_element("id", "crank")
        slider.send_keys(Keys.ARROW_RIGHT)
        assert poses(driver) != after
        assert slider.get_attribute("aria-valuetext") == driver.find_element("id", "crank-angle").text
    if name in ("balance", "sweep", "map", "front"):
        slider = driver.find_element("css selector", ".picked input")
        for key in (Keys.HOME, Keys.ARROW_RIGHT):
            slider.send_keys(key)
        rows = json.loads(driver.execute_script("return document.getElementById('chart-data').textContent"))["charts"]
        picks = next(one["picks"] for one in rows if "picks" in one)
        assert picked(driver) == list(picks["rows"][1])
        driver.execute_async_script("setTimeout(arguments[0], 300)")
        mark = driver.execute_script(
            "const d = document.querySelector('.picked').previousElementSibling.data; return d[d.length - 1].x"
        )
        assert mark == [picks["x"][1]]
    if name in ("sweep", "map", "front"):  # the drawing is that of the selected design
        lengths = dict(zip(driver.execute_script(NAMES), picked(driver), strict=True))
        drawn = driver.execute_script("return document.querySelector('.picked ~ .drawing').textContent")
        assert "Point 2, drawn" in drawn
        assert {lengths["coupler [mm]"], lengths["rocker [mm]"]} <= {
            f"{float(text):#.4g}" for text in re.findall(r"\d+(?:\.\d+)?", drawn)
        }
    fits_and_is_accessible(driver, dark=[*RECORDED, "sensitivity"].index(name) % 2 == 0)
    assert console(driver) == []
    assert requests(driver, path) == []


def fits_and_is_accessible(driver, *, dark: bool) -> None:
    """No wider than a desk or a telephone, and there no serious fault for axe-core; every second page in dark mode."""
    with colours(driver, dark=dark):
        try:
            for width in (1400, 400):
                size = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": width < 500}
                driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
                driver.execute_async_script("setTimeout(arguments[0], 200)")  # charts are drawn anew
                assert driver.execute_script("return document.documentElement.scrollWidth") <= width
            assert faults(driver) == []
        finally:
            driver.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})


@pytest.mark.slow
@pytest.mark.parametrize("name", ["front", "map"])
def test_selecting_a_point_shows_its_design(driver, pages, name):
    """The mouse moves to the point as a user's does."""
    shown(driver, pages(name))
    chart = json.loads(driver.execute_script("return document.getElementById('chart-data').textContent"))["charts"][0]
    curve = next(one for one in chart["figure"]["data"] if "customdata" in one)
    i, j = (1, 2) if name == "map" else (2, 2)
    expected = curve["customdata"][i][j] if name == "map" else curve["customdata"][j]
    assert expected != chart["picks"]["first"]
    script = """const place = document.getElementById('chart-1');
        place.scrollIntoView();
        const [x, y] = [place._fullLayout.xaxis, place._fullLayout.yaxis];
        const box = place.getBoundingClientRect();
        return [box.left + x._offset + x.d2p(arguments[0]), box.top + y._offset + y.d2p(arguments[1])]"""
    x, y = driver.execute_script(script, curve["x"][j], curve["y"][i])
    for away in (4.0, 0.0):
        driver.execute_cdp_cmd("Input.dispatchMouseEvent", {"type": "mouseMoved", "x": x + away, "y": y + away})
        driver.execute_async_script("setTimeout(arguments[0], 300)")
    assert picked(driver) == list(chart["picks"]["rows"][expected])


@pytest.mark.slow
def test_a_page_prints_its_points_without_sliders(driver, pages):
    shown(driver, pages("front"))
    printed = driver.execute_cdp_cmd("Page.printToPDF", {"preferCSSPageSize": True})
    pages = len(re.findall(rb"/Type\s*/Page\b", base64.b64decode(printed["data"])))
    assert 2 <= pages <= 8
    driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": "print"})
    try:
        assert not driver.find_element("css selector", ".picked input").is_displayed()
        assert driver.find_element("css selector", "[data-pick]").is_displayed()
    finally:
        driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": ""})


@pytest.mark.slow
@pytest.mark.parametrize(("by_yield", "row"), [(True, "largest, nominal"), (False, "largest")])
def test_the_largest_value_of_a_robust_design_is_labelled(results, by_yield, row):
    """With standard deviations they stand in the table's title; of a most-yield design the figure has no scatter in it."""
    study = read_result(results / "tolerance")
    design = optlink.validate(study.problem, {"coupler": 0.41, "rocker": 0.23})
    robust = RobustDesign(design, dict(design.design), 3.0, design.objective, by_yield)
    read = Reader(study_page(stored_page(replace(study, robust=robust), {}, "result.json")))
    texts = [text.strip() for group in read.texts.values() for text in group]
    assert row in texts
    assert ("largest, nominal" in texts) is by_yield
