"""The report: complete, true to the design, safe, and at work in a real browser."""

from __future__ import annotations

import base64
import functools
import gzip
import hashlib
import json
import math
import os
import re
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import plotly.graph_objects as go
import pytest

import optlink
from optlink.io import with_check_sum
from optlink.presentation.export.dimensions import dimensioned
from optlink.presentation.export.svg import motion_data
from optlink.presentation.format import pretty
from optlink.presentation.html import chart_plotly, shell, theme
from optlink.presentation.html.page import charts, page, sensitivities_of, write_page
from optlink.presentation.html.shell import MAX_BYTES, four_digits
from optlink.presentation.registry import read_result
from optlink.presentation.report_model import ReportModel, report_model_of, solve_or_validate
from optlink.presentation.scene import scene
from optlink.presentation.style import BODIES, CRANK, LIMIT, MUTED, TARGET
from optlink.presentation.views import conclusions, sensitivity
from optlink.tasks.analyze import analyze
from optlink.tasks.results.conflict import reached
from optlink.tasks.results.extremes import Extreme
from tests.browser import colours, console, faults, opened, requests
from tests.cli.test_cli import run
from tests.solved import folder_once
from tests.tiers import mostly_slow

PROBLEMS = (
    "crank-rocker",
    "motion-3-poses",
    "six-bar",
    "shaper",
    "watt-i",
    "toggle-press",
    "scotch-yoke",
    "oscillating-cylinder",
)
PLOTLY = "79542150855a52c567260e3137095dbe2b744e6d702a5cabe67da246942fba7a"
EVIL = "<script>window.caught = 1</script><img src=x onerror='window.caught = 2'> \"&' </title></style>"


def subject(name: str, given: dict[str, float] | None = None, **changes: object) -> ReportModel:
    file = optlink.load(name, changes)
    return report_model_of(solve_or_validate(file, design=given))


@functools.cache
def shipped(name: str) -> ReportModel:
    """What the page of a shipped problem shows, computed once per process."""
    return subject(name)


@pytest.fixture(params=mostly_slow(PROBLEMS, "crank-rocker", "scotch-yoke"))
def about(request) -> ReportModel:
    return shipped(request.param)


@pytest.fixture
def crank_rocker_subject() -> ReportModel:
    return shipped("crank-rocker")


@pytest.fixture(scope="module")
def crank_rocker_page(tmp_path_factory) -> Path:
    """A file that tests only read."""
    path = tmp_path_factory.mktemp("page") / "a.html"
    write_page(shipped("crank-rocker"), path)
    return path


class Reader(HTMLParser):
    """What a page is made of: texts by element, scripts, addresses, names."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.inside: list[str] = []
        self.scripts = 0
        self.addresses: list[str] = []
        self.ids: list[str] = []
        self.handlers: list[str] = []
        self.texts: dict[str, list[str]] = {}
        self.data: dict[str, str] = {}
        self.kept = ""
        self.feed(text.replace("<wbr>", ""))  # only where a line may be broken

    def handle_starttag(self, tag, attributes):
        self.inside.append(tag)
        result = dict(attributes)
        self.scripts += tag == "script"
        self.kept = result.get("id", "") if tag == "script" else ""
        self.addresses += [value for key, value in attributes if key in ("src", "href", "data", "action", "poster", "srcset")]
        self.handlers += [key for key, _ in attributes if key.startswith("on")]
        self.ids += [result["id"]] if "id" in result else []

    def handle_endtag(self, tag):
        while self.inside and self.inside.pop() != tag:
            pass

    def handle_data(self, data):
        if self.inside:
            self.texts.setdefault(self.inside[-1], []).append(data)
        if self.kept:
            self.data[self.kept] = self.data.get(self.kept, "") + data


# --- content of the page -----------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_page_is_complete_and_small(about):
    text = page(about)
    assert len(text.encode()) < MAX_BYTES
    read = Reader(text)
    assert read.scripts == 4
    assert all(address.startswith(("#", "data:,")) for address in read.addresses)
    assert read.handlers == []
    assert len(read.ids) == len(set(read.ids))
    assert {address[1:] for address in read.addresses if address.startswith("#")} <= set(read.ids)
    values = " ".join(" ".join(texts) for tag, texts in read.texts.items() if tag not in ("script", "style"))
    assert about.problem.model.title in values
    assert about.problem.hash in values
    for words in (about.problem.model.source, about.problem.model.about):
        assert " ".join(pretty(words).split()) in " ".join(values.split())


def test_the_crank_rocker_page_has_the_published_figures(crank_rocker_subject):
    text = page(crank_rocker_subject)
    for words in ("412.865", "232.246", "0.00759237", "rad² per deg", "largest transmission angle", "Valid: every check passed"):
        assert words in text
    checks = crank_rocker_subject.result.validation.checks
    bounds = [check for check in checks if check.name.endswith(" within its bounds")]  # they share a row
    assert text.count('<span class="good">ok</span>') == len(checks) - len(bounds) + 1


def test_the_page_states_a_proof_and_the_dimensions_once(crank_rocker_subject):
    shown = re.sub(r"<(script|style|title)\b.*?</\1>|<[^>]+>", " ", page(crank_rocker_subject), flags=re.DOTALL)
    assert shown.count("globally optimal within the bounds") == 1
    assert "coupler BC" not in shown  # in the drawing, and in words for those who do not see it


@pytest.mark.slow
def test_an_invalid_design_is_marked_invalid():
    text = page(subject("crank-rocker", {"coupler": 0.41, "rocker": 0.22}))
    assert "Not valid: the transmission angle rises to" in text
    assert '<span class="bad">FAIL</span>' in text
    apart = page(subject("crank-rocker", {"coupler": 0.2, "rocker": 0.2}))
    assert "Not valid" in apart


def test_a_design_that_cannot_be_assembled_has_a_page_without_a_drawing():
    text = page(subject("crank-rocker", {"coupler": 0.1, "rocker": 0.1}))
    assert "It cannot be shown in motion" in text
    assert "<svg" not in Reader(text).texts.get("div", [])


def test_a_page_begins_with_its_conclusion(crank_rocker_subject):
    error = np.degrees(crank_rocker_subject.result.error())
    expected = f"within {np.max(np.abs(error)):.4g}° (root mean square {np.sqrt(np.mean(error**2)):.4g}°)"
    expected = f"{expected}; largest transmission angle 135°, 45° from 180°"
    assert f"{expected}. Active limit: largest transmission angle (≤\N{NO-BREAK SPACE}135°)." in page(crank_rocker_subject)
    infeasible = subject("crank-rocker", **{"limits.transmission_angle": ["80 deg", "100 deg"]})
    text = page(infeasible)
    low = reached(infeasible.result.conflict[0])
    assert low == pytest.approx(infeasible.result.conflict[0].relaxed, abs=0.01)
    sentence = "No such linkage: 80° of transmission angle cannot be met; the transmission angle falls to"
    assert f"{sentence} {low:g}° at best." in text
    worse = page(subject("crank-rocker", {"coupler": 0.41, "rocker": 0.22}))
    assert re.search(r"Not valid: the transmission angle rises to [\d.]+ deg, at most 135 deg are required", worse)


class Shared(dict):
    """Extremes that are given."""

    def select(self, names):
        return {name: self[name] for name in names}


def test_the_conclusion_of_a_machine_has_the_figures_of_its_table():
    """The largest reactions of the shaper lie beside a jump of its load, between two rows of the table."""
    result = analyze(optlink.load("shaper"))
    largest = max((extreme.largest, name) for name, extreme in result.extremes.items() if name.endswith(".f_N"))[0]
    assert f"largest joint reaction is {1e-3 * largest:.4g} kN at A." in conclusions.analysis(result)
    names = dict.fromkeys(("B", "C"), 1.0) | {"C.rocker": 2.5}
    shared = Shared({f"{name}.f_N": Extreme(0.0, 0.0, size, 0.0) for name, size in names.items()})
    assert "largest joint reaction is 2.5 N at C on rocker." in conclusions.analysis(replace(result, extremes=shared))


def test_long_point_names_stay_distinct_in_the_description():
    changes = {"ground": {"motor": ["0 mm", "0 mm"]}, "links": {"crank": {"joints": ["motor", "B"], "length": "40 mm"}}}
    crank = analyze(optlink.read({"title": "Crank", "mechanism": changes}))
    assert "crank motor–B 40" in dimensioned(crank, "Test").words


def test_the_drawing_has_the_dimensions_of_the_design(crank_rocker_subject):
    """Lengths of the design, and the swing of the rocker between its dead centres by the law of cosines."""
    drawing = dimensioned(crank_rocker_subject.cycle, "Test")
    crank, coupler, rocker, frame = (1e3 * crank_rocker_subject.result.design[n] for n in ("crank", "coupler", "rocker", "frame"))
    ends = [math.acos((rocker**2 + frame**2 - (coupler + way * crank) ** 2) / (2 * rocker * frame)) for way in (1, -1)]
    texts = re.findall(r"<text[^>]*>([^<]*)<", drawing.svg)
    assert {f"{size:.4g}" for size in (crank, coupler, rocker, frame)} <= set(texts)
    assert f"{math.degrees(ends[0] - ends[1]):.4g}°" in texts
    assert "A (0, 0)" in texts
    assert "D (500, 0)" in texts
    assert f"coupler BC {coupler:.4g}" in drawing.words


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("412.86542 mm", "412.9 mm"),
        ("0.00759237", "0.007592"),
        ("12345.678", "12346"),
        ("1.5", "1.5"),
        ("-1.23456e-07", "-1.235e-07"),
    ],
)
def test_tables_have_four_digits(text, shown):
    assert four_digits(text) == shown
    assert four_digits("0.1.0, 3.11.7, 1,234.56 of 4096") == "0.1.0, 3.11.7, 1,234.56 of 4096"  # versions and groups stay


def test_every_colour_can_be_read_in_both_modes():
    for colour in (*BODIES, CRANK, MUTED, TARGET, LIMIT):
        assert theme.contrast(theme.readable(colour), "#ffffff") >= 4.5
        assert theme.contrast(theme.dark(colour), theme.DARK) >= 4.5
    assert theme.contrast(theme.dark("#f3e3c3"), theme.DARK) < 2.0  # a shade stays one
    assert theme.contrast("#000000", "#ffffff") == pytest.approx(21.0)


@pytest.mark.slow
def test_a_page_names_author_part_and_date(tmp_path):
    """From the section of the file and from options, as text; without effect on the hash."""
    raw = (Path(__file__).parents[2] / "problems" / "slider-crank.toml").read_text()
    head = '[report]\ncompany = "Miller & Sons"\nrevision = "A"\ndate = 2026-03-01\n\n[mechanism]'
    (tmp_path / "mine.toml").write_text(raw.replace("[mechanism]", head, 1))
    assert optlink.load(str(tmp_path / "mine.toml")).hash == optlink.load("slider-crank").hash
    out = tmp_path / "a.html"
    stated = ("--author", EVIL, "--revision", "B", "--title", "Drive")
    assert run("report", str(tmp_path / "mine.toml"), "-o", str(out), *stated).exit_code == 0
    texts = Reader(out.read_text()).texts
    assert [" ".join(text.split()) for text in texts["dd"][:4]] == ["Miller & Sons", " ".join(EVIL.split()), "B", "2026-03-01"]
    assert texts["h1"] == texts["title"][:1] == ["Drive"]
    done = run("report", str(tmp_path / "mine.toml"), "-o", str(out), "--part", "x" * 300)
    assert done.exit_code == 2
    assert "report.part" in done.stderr


def checked_by_plotly(figure):
    """Let the checker of plotly refuse what its schema does not have; before 6.4 it refuses #rrggbbaa, which plotly.js draws."""
    go.Figure(json.loads(re.sub(r'"(#[0-9a-f]{6})[0-9a-f]{2}"', r'"\1"', json.dumps(figure))))


def test_every_chart_is_a_valid_plotly_figure(about):
    computed = [chart_plotly.chart(spec) for spec in charts(about) if spec.page]
    assert computed
    for chart in computed:
        checked_by_plotly(chart.figure)
        assert any(any(value is not None for value in trace["y"]) for trace in chart.figure["data"])


def test_the_checker_detects_faults():
    with pytest.raises(ValueError, match="Invalid property"):
        checked_by_plotly({"data": [{"type": "scatter", "colour": "red"}]})


def test_the_torque_chart_is_the_analysis():
    about = shipped("six-bar")
    chart = chart_plotly.chart(next(spec for spec in charts(about) if spec.title == "Driving torque"))
    torque = next(trace for trace in chart.figure["data"] if trace["name"] == "driving torque")
    values = np.array([np.nan if value is None else value for value in torque["y"]])
    assert np.nanmax(values) == pytest.approx(278.8344391, rel=1e-6)  # the source of the problem
    assert np.nanmin(values) == pytest.approx(-320.0521365, rel=1e-6)


@pytest.mark.slow
def test_page_sensitivities_agree_with_reoptimisation(crank_rocker_subject):
    """The tornado's bar of the transmission angle, against the problem solved at 134.9 and 135.1 deg."""
    answers = sensitivities_of(crank_rocker_subject)
    more, less = chart_plotly.chart(*sensitivity.charts(answers)).figure["data"]
    values = dict(zip(more["text"], more["x"], strict=True))["largest transmission angle: 135 deg + 1 deg"]
    assert dict(zip(less["text"], less["x"], strict=True))["largest transmission angle: 135 deg − 1 deg"] == -values
    result = []
    for most in (134.9, 135.1):
        file = optlink.load("crank-rocker", {"limits.transmission_angle": ["45 deg", f"{most} deg"]})
        result.append(optlink.solve(file).objective)
    assert values == pytest.approx(100.0 * (result[1] - result[0]) / 0.2 / crank_rocker_subject.objective, rel=1e-3)
    assert values == pytest.approx(-1.929, abs=1e-3)
    text = page(crank_rocker_subject)
    assert "Sensitivities" in text
    assert "-1.929 %" in text
    assert "Sensitivities" not in page(shipped("motion-3-poses"))  # all poses are met exactly: nothing is left to gain


def test_the_moving_drawing_is_the_linkage(about):
    """Every body is a rigid one: its points keep their place in its own axes at every crank angle, and it turns with them."""
    document = motion_data(scene(about.cycle))
    mechanism, sizes = about.cycle.machine.mechanism, about.cycle.machine.sizes
    tolerance = 1.6 * 10.0 ** -scene(about.cycle).decimals  # four rounded coordinates: sqrt(2) units of the last place
    for link in mechanism.links:
        if not link.end or link.end not in document["points"]:
            continue
        pose, end = document["bodies"][link.body], document["points"][link.end]
        dx, dy = (np.array(end[axis]) - np.array(pose[axis]) for axis in "xy")
        length = 1e3 * (sizes[link.length] if isinstance(link.length, str) else link.length)
        assert np.max(np.abs(np.hypot(dx, dy) - length)) <= tolerance
        turned = np.radians(pose["a"])
        assert np.max(np.abs(dx * np.sin(turned) - dy * np.cos(turned))) <= tolerance
    crank = document["bodies"][mechanism.crank.body]["a"]
    assert np.abs(np.diff(crank)) == pytest.approx(np.abs(np.diff(document["angles_deg"])), abs=2e-5)


# --- what others write into it -----------------------------------------------------------------------------------------------


def evil_problem(folder: Path) -> Path:
    """A problem whose every text tries to run."""
    text = EVIL.replace("\\", "\\\\").replace('"', '\\"')
    path = folder / "evil.toml"
    raw = (Path(__file__).parents[2] / "problems" / "crank-rocker.toml").read_text()
    raw = re.sub(r'^(title|source) = ".*"$', lambda computed: f'{computed[1]} = "{text}"', raw, flags=re.MULTILINE)
    path.write_text(re.sub(r'about = """.*?"""', f'about = "{text}"', raw, flags=re.DOTALL))
    return path


@pytest.mark.slow
def test_markup_in_texts_is_escaped(tmp_path):
    file = optlink.load(evil_problem(tmp_path))
    about = report_model_of(solve_or_validate(file, design={"coupler": 0.41286542, "rocker": 0.23224617}))
    read = Reader(page(about))
    assert read.scripts == 4
    assert read.handlers == []
    assert "img" not in read.texts
    assert EVIL in " ".join(read.texts["h1"])
    plain = Reader(page(shipped("crank-rocker")))
    assert read.texts.keys() | {"br"} == plain.texts.keys() | {"br"}  # column names of the sensitivities have line breaks


@pytest.mark.slow
def test_the_check_of_texts_detects_markup(tmp_path):
    text = page(shipped("crank-rocker")).replace("Crank-rocker that", EVIL)
    assert Reader(text).scripts > 4
    assert set(Reader(text).handlers) == {"onerror"}


# --- result files ------------------------------------------------------------------------------------------------------------


def recorded(folder: Path, *command: str) -> None:
    """Write result.json as a command does, without pictures."""
    done = run(*command, "--json")
    assert done.exit_code == 0
    folder.mkdir(exist_ok=True)
    (folder / "result.json").write_text(done.stdout)


@pytest.fixture(scope="module")
def results(tmp_path_factory) -> Callable[[str], Path]:
    """The result.json of a problem, computed on first use."""

    @functools.cache
    def result(name: str) -> Path:
        command = ("analyze", "shaper", "--speed", "64 rpm") if name == "shaper" else ("solve", name)
        folder = folder_once(f"page of {name}", tmp_path_factory.mktemp("results"), lambda place: recorded(place, *command))
        return folder / "result.json"

    return result


@pytest.mark.slow
@pytest.mark.parametrize("name", ["crank-rocker", "motion-3-poses", "function-sin", "shaper"])
def test_a_stored_result_gives_the_page_of_its_problem(results, tmp_path, name):
    path = tmp_path / "a.html"
    done = run("report", str(results(name)), "-o", str(path), "--json")
    assert done.exit_code == 0
    assert json.loads(done.stdout)["valid"] is True
    document = json.loads(results(name).read_text())
    result = read_result(results(name))
    if name == "shaper":
        assert result.speed == pytest.approx(64 * math.pi / 30)
    else:
        first = document["designs"][0] if name == "motion-3-poses" else document
        assert result.objective == first["objective"]["value"]
    text = path.read_text()
    if name == "crank-rocker":
        assert "0.0001465 rad² per deg (1.93 %)" in text
        assert "optimality (KKT residual)" in text


def summed(document: dict) -> dict:
    """The document with the check sum of what it contains."""
    return with_check_sum({key: value for key, value in document.items() if key != "crc32"})


def test_results_that_cannot_be_shown(results, tmp_path):
    good = json.loads(results("crank-rocker").read_text())
    changed = "the result was changed since it was written"
    bad = {
        "schema": ({**good, "schema": "optlink/list/1"}, "not a result of optlink"),
        "version": ({**good, "schema": "optlink/function/2"}, "the format of another version"),
        "none": ({"a": 1}, "not a result of optlink"),
        "hash": ({**good, "problem_hash": "0" * 16}, changed),
        "design": ({**good, "state": {}}, changed),
        "sum": ({key: value for key, value in good.items() if key != "crc32"}, changed),
        "other reading": (summed(good | {"problem_hash": "0" * 16}), "read its problem otherwise"),
        "lacking": (summed({key: value for key, value in good.items() if key != "seconds"}), "lacks or misreads seconds"),
        "misread": (summed(good | {"seconds": 7}), "lacks or misreads seconds"),
        "list": ([good], "not a result"),
    }
    for name, (document, words) in bad.items():
        path = tmp_path / f"{name}.json"
        path.write_text(json.dumps(document))
        done = run("report", str(path), "-o", str(tmp_path / "a.html"))
        assert done.exit_code == 2, name
        assert words in " ".join(done.stderr.split()), name
        assert done.stderr.count("\n") == 1
    (tmp_path / "broken.json").write_text("{")
    assert "it is not a JSON document" in run("report", str(tmp_path / "broken.json"), "-o", str(tmp_path / "a.html")).stderr
    assert not (tmp_path / "a.html").exists()


@pytest.mark.slow
def test_a_result_contains_its_changed_problem(tmp_path):
    recorded(tmp_path, "solve", "crank-rocker", "--set", "mechanism.frame=480 mm")
    result, out = str(tmp_path / "result.json"), str(tmp_path / "a.html")
    refused = run("report", result, "--set", "mechanism.frame=470 mm", "-o", out)
    assert refused.exit_code == 2
    assert "--set" in refused.stderr
    assert run("report", result, "-o", out, "--company", "Acme").exit_code == 0
    assert "480.000" in (tmp_path / "a.html").read_text()
    assert "Acme" in (tmp_path / "a.html").read_text()


@pytest.mark.slow
def test_an_infeasible_result_names_the_conflict(tmp_path):
    change = ("--set", 'limits.transmission_angle=["80 deg", "100 deg"]')
    (tmp_path / "result.json").write_text(run("solve", "crank-rocker", *change, "--json").stdout)
    for subject_ in (("crank-rocker", *change), (str(tmp_path / "result.json"),)):
        done = run("report", *subject_, "-o", str(tmp_path / "a.html"))
        assert done.exit_code == 1
        text = (tmp_path / "a.html").read_text()
        assert "no feasible design" in text
        assert "Conflicting limits" in text
        assert "Sensitivities" not in text


@pytest.mark.slow
def test_the_hash_of_a_problem_is_the_same_in_every_process():
    """Otherwise no result file would find its problem; the order of a set depends on the hash seed."""
    code = "import optlink; print([optlink.load(name).hash for name in optlink.shipped()])"
    result = set()
    for seed in ("1", "2", "3"):
        environment = {**os.environ, "PYTHONHASHSEED": seed}
        done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
        result.add(done.stdout)
    assert len(result) == 1


def test_the_limit_of_a_page():
    assert MAX_BYTES == 2_000_000


def test_plotly_is_the_published_one_with_its_licence():
    """That of the npm package plotly.js-cartesian-dist-min; the page names its version and allows this text by its hash."""
    text, packed = shell.plotly()
    assert hashlib.sha256(text.encode()).hexdigest() == PLOTLY
    assert gzip.decompress(base64.b64decode(packed)).decode() == text
    assert text.splitlines()[1] == f"* plotly.js (cartesian - minified) v{shell.plotly_version()}"
    licence = Path(shell.__file__).parents[1] / "assets" / "plotly-LICENSE.txt"
    assert licence.read_text("utf-8").startswith("MIT License\n\nCopyright (c) 2016-2024 Plotly Technologies Inc.")


# --- in a browser ------------------------------------------------------------------------------------------------------------


def test_assets_and_templates_belong_to_the_package():
    """Beside the modules, where the wheel takes them from."""
    folder = Path(optlink.__file__).parent / "presentation"
    assert {path.name for path in (folder / "assets").iterdir()} == {
        *("motion.js", "notebook.js", "page.css", "page.js"),
        *("plotly-cartesian.min.js.gz", "plotly-LICENSE.txt"),
    }
    assert {path.name for path in (folder / "templates").iterdir()} == {"page.html", "parts.html", "notebook.html"}


def poses(driver) -> dict[str, str]:
    script = """return Object.fromEntries([...document.querySelectorAll('[data-body]')]
        .map(node => [node.dataset.body, node.getAttribute('transform')]))"""
    return driver.execute_script(script)


def slide_to(driver, index: int) -> None:
    script = """const slider = document.getElementById('crank'); slider.value = arguments[0];
        slider.dispatchEvent(new Event('input', {bubbles: true}))"""
    driver.execute_script(script, index)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["crank-rocker", "motion-3-poses", "shaper", "oscillating-cylinder"])
def test_a_page_in_a_browser(driver, tmp_path, name):
    """No complaint, no request, all charts drawn; the slider moves the linkage to where the kinematics has it."""
    about, path = shipped(name), tmp_path / "a.html"
    write_page(about, path)
    complaints, asked = opened(driver, path)
    assert complaints == []
    assert asked == []
    with colours(driver, dark=True):
        assert driver.execute_script("return document.documentElement.dataset.theme") == "dark"
        assert name == "motion-3-poses" or faults(driver, "color-contrast") == []  # nothing else changes with the colours
    assert name == "shaper" or faults(driver) == []
    drawn = driver.execute_script("return document.querySelectorAll('.plot .main-svg').length")
    assert drawn >= len(charts(about))
    buttons = driver.execute_script(
        "return [...document.querySelectorAll('.modebar-btn')].map(one => one.dataset.title.toLowerCase())"
    )
    assert set(buttons) == {"download plot as a png", "zoom", "pan", "zoom in", "zoom out", "reset axes"}  # none that uploads
    before = poses(driver)
    slide_to(driver, 100)
    after = poses(driver)
    assert set(before) == set(after) == {shape.name for shape in scene(about.cycle).moving_shapes if shape.of == "body"}
    assert all(before[body] != after[body] for body in before)
    expected = scene(about.cycle)
    for body, text in after.items():
        values = [float(part) for part in re.findall(r"-?[\d.]+(?:e-?\d+)?", text)]
        assert values == pytest.approx(expected.poses(body)[100] * [1.0, -1.0, -1.0], abs=2e-5 * max(expected.box[2:]))
    angle = driver.execute_script("return document.getElementById('crank-angle').textContent")
    assert float(angle.rstrip("°").replace("−", "-")) == pytest.approx(expected.crank_angles[100], abs=0.051)
    assert console(driver) == []
    assert requests(driver, path) == []


@pytest.mark.slow
def test_the_slider_of_the_crank_rocker_by_the_law_of_cosines(driver, crank_rocker_page, crank_rocker_subject):
    """Where the page puts the rocker's end, against the textbook."""
    opened(driver, crank_rocker_page)
    crank, coupler, rocker, frame = (1e3 * crank_rocker_subject.result.design[n] for n in ("crank", "coupler", "rocker", "frame"))
    script = "return document.querySelector('circle[data-point=C]').getAttribute('transform')"
    for index in (0, 77, 200, 359):
        slide_to(driver, index)
        phi = crank_rocker_subject.result.design["phi0"] + math.radians(index)
        reach = math.sqrt(crank**2 + frame**2 - 2 * crank * frame * math.cos(phi))
        inner = math.atan2(crank * math.sin(phi), frame - crank * math.cos(phi))
        outer = math.acos((reach**2 + rocker**2 - coupler**2) / (2 * reach * rocker))
        psi = math.pi - inner - outer
        x, y = (float(part) for part in re.findall(r"-?[\d.]+", driver.execute_script(script)))
        assert (x, -y) == pytest.approx((frame + rocker * math.cos(psi), rocker * math.sin(psi)), abs=0.01)


@pytest.mark.slow
def test_the_play_button_moves_and_stops(driver, crank_rocker_page):
    opened(driver, crank_rocker_page)
    before = poses(driver)
    button = driver.find_element("id", "play")
    button.click()
    driver.execute_async_script("setTimeout(arguments[0], 400)")
    assert poses(driver) != before
    button.click()
    stopped = poses(driver)
    driver.execute_async_script("setTimeout(arguments[0], 200)")
    assert poses(driver) == stopped
    toggles = driver.find_elements("css selector", "[data-toggle]")
    toggles[0].click()
    assert driver.execute_script("return document.querySelector('[data-layer=traces]').style.display") == "none"


@pytest.mark.slow
def test_the_check_of_accessibility_detects_faults(driver, tmp_path, crank_rocker_subject):
    path = tmp_path / "a.html"
    path.write_text(
        page(crank_rocker_subject).replace("--soft: #525a64", "--soft: #b8bcc2").replace('<html lang="en">', "<html>")
    )
    opened(driver, path)
    assert {fault.partition(":")[0] for fault in faults(driver)} >= {"color-contrast", "html-has-lang"}
    assert {fault.partition(":")[0] for fault in faults(driver, "color-contrast")} == {"color-contrast"}


@pytest.mark.slow
def test_axis_names_and_tables_fit_a_telephone_screen(driver, crank_rocker_page):
    size = {"width": 375, "height": 800, "deviceScaleFactor": 1, "mobile": True}
    driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    try:
        opened(driver, crank_rocker_page)
        ends = "return [...document.querySelectorAll('.xtitle')].map((one) => one.getBoundingClientRect().right)"
        assert max(driver.execute_script(ends)) <= 375
        wide = "return [...document.querySelectorAll('.scroll')].filter((one) => one.scrollWidth > one.clientWidth + 1).length"
        assert driver.execute_script(wide) == 0
    finally:
        driver.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})


LABELS = """
return [...document.querySelectorAll(".js-plotly-plot")].map((chart) => [...chart.querySelectorAll(".textpoint text")]
  .filter((one) => getComputedStyle(one).visibility !== "hidden").map((one) => {
    const { left, right, top, bottom } = one.getBoundingClientRect();
    return [left, right, top, bottom];
  }));
"""


@pytest.mark.slow
def test_labels_of_points_do_not_overlap_on_a_telephone(driver, tmp_path):
    """Of the crank angles along the hodographs of a six-bar, of which some lie close together."""
    file, path = optlink.load("six-bar"), tmp_path / "a.html"
    write_page(report_model_of(solve_or_validate(file)), path)
    driver.execute_cdp_cmd(
        "Emulation.setDeviceMetricsOverride", {"width": 375, "height": 800, "deviceScaleFactor": 1, "mobile": True}
    )
    try:
        opened(driver, path)
        shown = driver.execute_script(LABELS)
    finally:
        driver.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})
    assert sum(map(len, shown)) >= 8
    for labels in shown:
        for k, (left, right, top, bottom) in enumerate(labels):
            over = [one for one in labels[:k] if one[0] < right and left < one[1] and one[2] + 2 < bottom and top + 2 < one[3]]
            assert not over


@pytest.mark.slow
def test_a_page_prints(driver, crank_rocker_page):
    """On paper: a few sheets, no controls, and the charts as wide as the sheet."""
    opened(driver, crank_rocker_page)
    printed = driver.execute_cdp_cmd("Page.printToPDF", {"preferCSSPageSize": True})
    document = base64.b64decode(printed["data"])
    assert document.startswith(b"%PDF")
    assert 3 <= len(re.findall(rb"/Type\s*/Page\b", document)) <= 10
    driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": "print"})
    assert not driver.find_element("id", "play").is_displayed()
    driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": ""})
    assert console(driver) == []


OVERLAPS = """
const over = (one, other) => one.top < other.bottom - 1 && other.top < one.bottom - 1;
return [...document.querySelectorAll(".js-plotly-plot")].flatMap((chart) => {
  const top = chart.getBoundingClientRect().top;
  const panels = Object.entries(chart._fullLayout).filter(([key]) => /^yaxis/.test(key))
    .map(([, axis]) => ({ top: top + axis._offset, bottom: top + axis._offset + axis._length }));
  const rows = [...chart.querySelectorAll(".ytick text")].map((one) => one.getBoundingClientRect());
  const legends = [...chart.querySelectorAll(".legend .bg")].map((one) => one.getBoundingClientRect());
  return [
    ...rows.flatMap((one, k) => rows.slice(k + 1).filter((other) => over(one, other)).map(() => "names of rows")),
    ...legends.flatMap((one) => panels.filter((other) => over(one, other)).map(() => "a legend and a panel")),
  ];
});
"""


@pytest.mark.slow
def test_charts_on_paper_do_not_overlap(driver, tmp_path):
    """Neither the names of many rows, nor a legend and the panel above it."""
    (tmp_path / "press.toml").write_text(optlink.new("quick-return-press"))
    file, path = optlink.load(tmp_path / "press.toml"), tmp_path / "a.html"
    write_page(report_model_of(solve_or_validate(file)), path)
    opened(driver, path)
    assert driver.execute_script(OVERLAPS) == []
    driver.execute_script("window.dispatchEvent(new Event('beforeprint'))")
    assert driver.execute_script(OVERLAPS) == []


@pytest.mark.slow
def test_texts_do_not_run_in_a_browser(driver, tmp_path):
    file = optlink.load(evil_problem(tmp_path))
    path = tmp_path / "a.html"
    write_page(report_model_of(solve_or_validate(file, design={"coupler": 0.41286542, "rocker": 0.23224617})), path)
    complaints, asked = opened(driver, path)
    assert (complaints, asked) == ([], [])
    assert driver.execute_script("return window.caught === undefined")
    assert driver.execute_script("return document.querySelector('h1').textContent") == EVIL


@pytest.mark.slow
def test_injected_scripts_are_blocked_by_the_security_policy(driver, tmp_path, crank_rocker_subject):
    """The content security policy blocks other scripts and all loading; the checks above detect a fault."""
    path = tmp_path / "a.html"
    text = page(crank_rocker_subject)
    more = "<script>window.caught = 1</script><img src='http://127.0.0.1:9/x.png'>"
    path.write_text(text.replace("</footer>", f"</footer>{more}"))
    complaints, _ = opened(driver, path)
    assert len(complaints) >= 2
    assert driver.execute_script("return window.caught === undefined")
    policy = re.compile(r'<meta http-equiv="Content-Security-Policy"[^>]*>')
    path.write_text(policy.sub("", text).replace("</footer>", f"</footer>{more}"))
    complaints, asked = opened(driver, path)
    assert asked == ["http://127.0.0.1:9/x.png"]
    assert complaints
    assert driver.execute_script("return window.caught === 1")
