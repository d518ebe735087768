"""What is made of pages and pictures: formulas, sketches, gallery, outputs of commands, links; and the site as a whole."""

from __future__ import annotations

import html
import importlib
import os
import re
import shlex
import shutil
import subprocess
import sys
import urllib.parse
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

import optlink
from docs.generate import formulas, gallery, outputs, site, sketches
from optlink.errors import Status
from tests.browser import browser, console, requests
from tests.test_docs import DOCS, PAGES, ROOT, parse

# --- formulas ------------------------------------------------------------------------------------------------------------

MATH = re.compile(r"<math.*?</math>")


def test_formulas_become_mathml():
    pytest.importorskip("latex2mathml")
    text = formulas.shown(
        "An angle $`\\cos \\varphi_0`$, | $`|x|`$.\n\n```math\n\\begin{aligned} a &= b \\\\ c &= d \\end{aligned}\n```\n"
    )
    assert [formula.count("<mtr>") for formula in MATH.findall(text)] == [0, 0, 2]
    assert "<mi>cos</mi><mspace" in text
    assert "$" not in text
    assert "`" not in text
    assert text.count("|") == 1  # those of a formula would split a cell of a table
    assert formulas.shown("````sh\n```\necho $`date`$\n````\n") == "````sh\n```\necho $`date`$\n````\n"
    with pytest.raises(ValueError, match="not a formula"):
        formulas.mathml(r"\nosuchcommand x")


@pytest.mark.parametrize("path", sorted((ROOT / "notebooks").glob("*.ipynb")), ids=lambda path: path.stem)
def test_no_latex_is_left_on_the_page_of_a_notebook(path):
    pytest.importorskip("latex2mathml")
    text, _ = site.notebook(f"notebooks/{path.name}")
    shown = formulas.shown(text)
    prose = re.sub(r"^(`{3,}).*?^\1\s*$|`[^`\n]*`", "", shown, flags=re.DOTALL | re.MULTILINE)
    assert "$" not in prose
    assert not re.search(r"\\(frac|tfrac|sqrt|omega|dot|psi|sum)", prose)
    assert bool(MATH.search(shown)) == (path.stem in {"clearance", "crank_rocker", "six_bar"})


def test_a_price_in_dollars_is_no_formula():
    text = site.with_formulas("costs $5 and $ 6, but $a_1$ and `$b$`\n$$x\n= y$$ end")
    assert text == "costs $5 and $ 6, but $`a_1`$ and `$b$`\n\n\n```math\nx\n= y\n```\n\n end"


@pytest.mark.slow
def test_formulas_of_every_page_are_read_and_their_letters_are_in_the_font(monkeypatch):
    pytest.importorskip("latex2mathml")
    pytest.importorskip("ziamath")
    count = 0
    letters = {*formulas.LETTERS, *formulas.ITALIC}
    for page in PAGES:
        for formula in MATH.findall(formulas.shown(page.read_text(encoding="utf-8"))):
            text = html.unescape(re.sub(r"<[^>]+>", "", formula))
            assert set(map(ord, text)) <= letters, f"{page.name}: {text}"
            count += 1
    assert count > 80
    font = formulas.font()
    assert font[:4] == b"\x00\x01\x00\x00"
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "0")  # the time of day, as fontTools reads it
    assert formulas.font() == font


# --- sketches ------------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_sketches_are_those_of_the_named_dyads_and_the_same_at_each_build():
    for kind, mechanism in sketches.DYADS.items():
        machine = optlink.analyze(sketches.problem_of(mechanism, sketches.ANGLES[kind]), points=4).machine
        assert [group.kind for group in machine.mechanism.groups] == [kind]
    assert sketches.svg("rrp") == sketches.svg("rrp")
    assert all(b"<svg" in sketches.svg(name) for name in ("four-bar", "rocker-angle-below", "six-bar"))


@pytest.mark.parametrize(("end", "before"), [(70.0, 63.0), (-40.0, -33.0)])
def test_an_angle_of_a_sketch_has_its_arrowhead_where_it_ends(end, before):
    axes = Figure().add_subplot()
    sketches._arc(axes, np.array([5.0, 2.0]), 10.0, 0.0, end, "θ")
    (arc,), (arrow, _) = axes.patches, axes.texts
    assert sorted((arc.theta1, arc.theta2)) == sorted((0.0, end))
    for place, angle in ((arrow.xy, end), (arrow.xyann, before)):
        assert np.degrees(np.arctan2(place[1] - 2.0, place[0] - 5.0)) == pytest.approx(angle, abs=0.2)


# --- the gallery -----------------------------------------------------------------------------------------------------------


def test_the_gallery_has_every_problem_with_a_real_command():
    page = gallery.page()
    for name in optlink.shipped():
        (sentence, command) = re.search(rf"\(images/gallery/{name}\.svg\)<br>\*\*.*?\*\*<br>(.*?)<br>`(.*?)` \|", page).groups()
        assert parse(shlex.split(command)[1:]).params.get("problem") == name
        assert len(sentence) > 30, name
    assert gallery.command_of(optlink.load("slider-crank-clearance")) == "optlink simulate slider-crank-clearance"


@pytest.mark.slow
def test_gallery_pictures_show_valid_designs_only(monkeypatch):
    for name in ("whitworth", "path-scott-russell"):
        assert b"<svg" in gallery.picture(name)
    tight = optlink.load("crank-rocker").override({"limits.transmission_angle": ["85 deg", "95 deg"], "requirement.points": 3})
    monkeypatch.setattr(gallery.optlink, "load", lambda name: tight)
    with pytest.raises(ValueError, match="no valid design to draw"):
        gallery.picture("infeasible")


# --- outputs of commands -----------------------------------------------------------------------------------------------


def test_outputs_are_those_of_the_commands():
    assert "coupler   412.865  mm" in outputs.shown("optlink solve crank-rocker --details", {"from": "Design", "to": "Objective"})
    assert outputs.exit_code('optlink validate crank-rocker --design coupler="412.26 mm" --design rocker="232.2417 mm"') == "1"
    assert outputs.excerpt("a\nb\nc\nd", "b", "d") == "b\nc"
    with pytest.raises(ValueError, match="no line starts with 'x'"):
        outputs.excerpt("a\nb", "x")


def test_every_status_is_explained():
    page = (DOCS / "reading-a-result.md").read_text(encoding="utf-8")
    for status in Status:
        word = {Status.NOT_SEARCHED: "given design", Status.INFEASIBLE: "no feasible design found"}.get(status, status.value)
        assert f"| `{word}` |" in page, word


# --- the site --------------------------------------------------------------------------------------------------------------


def test_links_out_of_the_documentation_lead_to_pages_of_the_site():
    text = "[a](../notebooks/six_bar.ipynb), [b](../tests/test_units.py#x), [c](studies.md#files)\n```\n[d](../README.md)\n```\n"
    expected = (
        "[a](notebooks/six_bar.md), [b](source/tests/test_units.py.md#x), [c](studies.md#files)\n```\n[d](../README.md)\n```\n"
    )
    assert site.rewritten(text, "docs", "page.md") == expected
    assert set(site.outward(text, "docs")) == {"notebooks/six_bar.ipynb", "tests/test_units.py"}
    assert site.rewritten("[a](docs/images/x.png)", "", "contributing.md") == "[a](images/x.png)"
    assert site.rewritten("[a](../validation.md)", "docs/api", "api/solve.md") == "[a](../validation.md)"


FETCHED = re.compile(r"<(?:script|img|iframe|source|video|audio|embed)\b[^>]*?\ssrc=[\"']?((?:https?:)?//[^\"'\s>]+)")
STYLED = re.compile(r"<link\b(?![^>]*\brel=[\"']?canonical)[^>]*?\shref=[\"']?((?:https?:)?//[^\"'\s>]+)")
TARGET = re.compile(r"<(?:a|img|link|script|source|iframe)\b[^>]*?\s(?:href|src)=[\"']?([^\"'\s>]*)")
ANCHOR = re.compile(r"\s(?:id|name)=[\"']?([^\"'\s>]+)")


def fetched(page: str) -> list[str]:
    """Addresses that a page would load from the network when it is opened; links that somebody may follow are none."""
    return FETCHED.findall(page) + STYLED.findall(page)


def dead(folder: Path) -> list[str]:
    """Links, pictures, scripts and styles of a built site that lead to no file of it, or to no anchor of a page."""
    texts = {str(page): page.read_text(encoding="utf-8") for page in folder.rglob("*.html")}
    files = {str(place) for place in folder.rglob("*") if place.is_file()}
    anchors = {page: set(map(html.unescape, ANCHOR.findall(text))) for page, text in texts.items()}
    found = []
    for page, text in texts.items():
        for target in map(html.unescape, TARGET.findall(text)):
            path, _, anchor = urllib.parse.unquote(target).partition("#")
            if re.match(r"[a-z]+:", path):
                continue
            if path.startswith("/") and page.endswith("404.html"):  # it is shown in the place of any page
                path = f".{path}"
            place = os.path.normpath(os.path.join(os.path.dirname(page), path)) if path else page
            if place not in files or (anchor and place in anchors and anchor not in anchors[place]):
                found.append(f"{os.path.relpath(page, folder)}: {target}")
    return found


def built(folder: Path) -> subprocess.CompletedProcess[str]:
    """Build the site of the pages in a folder, with the settings of ours."""
    shutil.copy(ROOT / "mkdocs.yml", folder)
    command = [sys.executable, "-m", "zensical", "build", "--strict"]
    return subprocess.run(command, cwd=folder, env=os.environ | {"PYTHONPATH": ""}, capture_output=True, text=True, check=False)


@pytest.fixture
def small(tmp_path):
    """A place for pages, with the assets of ours."""
    pytest.importorskip("zensical")
    shutil.copytree(DOCS / "assets", tmp_path / "build/pages/assets")
    (tmp_path / "build/pages/assets/math.ttf").touch()
    return tmp_path


@pytest.mark.slow
def test_what_a_page_links_to_in_vain_is_detected(small):
    """A page and an anchor by the build, pictures and links in HTML by `dead`."""
    pages = small / "build/pages"
    (pages / "two.md").write_text("# Two\n\n## There\n", encoding="utf-8")
    front = pages / "index.md"
    front.write_text(
        "# One\n\n[a](two.md#there) [b](none.md) [c](two.md#none) [d](#none) ![e](none.png) <a href='two/'>\n", encoding="utf-8"
    )
    done = built(small)
    assert done.returncode == 1
    said = re.findall(r"(\w+) does not exist\n", re.sub(r"\x1b\[[\d;]*m", "", done.stderr))
    assert sorted(set(said)) == ["anchor", "page"]
    found = {one.removeprefix("index.html: ") for one in dead(small / "site") if one.startswith("index.html: ")}
    assert {"none.html", "two.html#none", "#none", "none.png", "two/"} <= found
    assert "two.html#there" not in found


@pytest.mark.slow
def test_pages_that_are_opened_as_files_can_be_searched(small):
    (small / "build/pages/index.md").write_text("# One\n\nA word: pantograph.\n", encoding="utf-8")
    assert built(small).returncode == 0
    page = small / "site/index.html"
    with browser() as driver:
        driver.get(page.as_uri())
        driver.find_element("css selector", "body").send_keys("/")
        waiting = importlib.import_module("selenium.webdriver.support.ui").WebDriverWait(driver, 30, 0.05)
        waiting.until(lambda driver: driver.execute_script("return Boolean(document.activeElement.shadowRoot)"))
        driver.switch_to.active_element.send_keys("pantogr")
        waiting.until(lambda driver: "1 result" in driver.execute_script("return document.activeElement.shadowRoot.textContent"))
        assert console(driver) == []
        assert [address for address in requests(driver, page) if not address.startswith((small / "site").as_uri())] == []


def test_code_of_a_table_has_no_backslash():
    """On a code host it has none; outside tables it is code as it stands."""
    text = "`a \\| b`\n\n| `int \\| None` | `x` |\n|---|---|\n```sh\n| `a \\| b` |\n```\n"
    assert site.prose(text) == text.replace("`int \\| None`", "<code>int &#124; None</code>")


def test_network_access_of_a_page_is_detected():
    assert fetched('<script defer src="https://unpkg.com/x.js"></script>') == ["https://unpkg.com/x.js"]
    assert fetched('<link rel="stylesheet" href="//fonts.example/css">') == ["//fonts.example/css"]
    assert fetched('<link rel=canonical href=https://example.org/><a href="https://example.org">x</a><img src="a.png">') == []


def test_a_notebook_becomes_a_page():
    text, pictures = site.notebook("notebooks/crank_rocker.ipynb")
    assert text.startswith("# ")
    assert "six_bar.ipynb){" not in text
    assert "````python\n" in text
    assert pictures
    assert all(data[:4] in (b"\x89PNG", b"GIF8") for data in pictures.values())
    assert all(f"({name})" in text for name in pictures)


@pytest.mark.slow
def test_the_site_builds_without_warnings_or_network(tmp_path):
    pytest.importorskip("zensical")
    site.write(tmp_path / "build/pages")
    done = built(tmp_path)
    assert done.returncode == 0, done.stderr
    assert "No issues found" in done.stderr
    folder = tmp_path / "site"
    assert dead(folder) == []
    pages = {page.relative_to(folder).as_posix(): page.read_text(encoding="utf-8") for page in folder.rglob("*.html")}
    assert len(pages) == len(list((tmp_path / "build/pages").rglob("*.md"))) + 1  # that of 404
    for name, text in pages.items():
        assert fetched(text) == [], name
        if not name.startswith("source/"):
            assert not re.search(r"toml (?:design|laws)", text), name
    for style in folder.rglob("*.css"):
        assert not re.search(r"url\(['\"]?(?:https?:)?//", style.read_text(encoding="utf-8")), style.name
