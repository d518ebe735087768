"""What is made of pages and pictures: formulas, sketches, gallery, outputs of commands, links; and the site as a whole."""

from __future__ import annotations

import html
import logging
import re
import shlex
import warnings

import numpy as np
import pytest
from matplotlib.figure import Figure

import optlink
from docs.generate import gallery, outputs, sketches
from docs.hooks import formulas, links
from optlink.errors import Status
from tests.test_docs import DOCS, PAGES, ROOT, parse

# --- formulas ------------------------------------------------------------------------------------------------------------


def test_formulas_become_mathml():
    pytest.importorskip("latex2mathml")
    text, computed = formulas.marked(
        "An angle $`\\cos \\varphi_0`$.\n\n```math\n\\begin{aligned} a &= b \\\\ c &= d \\end{aligned}\n```\n"
    )
    assert [formula.count("<mtr>") for formula in computed] == [2, 0]
    assert "<mi>cos</mi><mspace" in computed[1]
    assert "$" not in text
    assert "`" not in text
    assert formulas.marked("```sh\necho $`date`$\n```\n") == ("```sh\necho $`date`$\n```\n", [])
    with pytest.raises(ValueError, match="not a formula"):
        formulas.mathml(r"\nosuchcommand x")


@pytest.mark.parametrize("path", sorted((ROOT / "notebooks").glob("*.ipynb")), ids=lambda path: path.stem)
def test_no_latex_is_left_on_the_page_of_a_notebook(path):
    pytest.importorskip("latex2mathml")
    text, _ = links.notebook(f"notebooks/{path.name}")
    marked, found = formulas.marked(text)
    prose = re.sub(r"^(`{3,}).*?^\1\s*$|`[^`\n]*`", "", marked, flags=re.DOTALL | re.MULTILINE)
    assert "$" not in prose
    assert not re.search(r"\\(frac|tfrac|sqrt|omega|dot|psi|sum)", prose)
    assert bool(found) == (path.stem in {"clearance", "crank_rocker", "six_bar"})


def test_a_price_in_dollars_is_no_formula():
    text = links.with_formulas("costs $5 and $ 6, but $a_1$ and `$b$`\n$$x\n= y$$ end")
    assert text == "costs $5 and $ 6, but $`a_1`$ and `$b$`\n\n\n```math\nx\n= y\n```\n\n end"


@pytest.mark.slow
def test_formulas_of_every_page_are_read_and_their_letters_are_in_the_font():
    pytest.importorskip("latex2mathml")
    pytest.importorskip("ziamath")
    count = 0
    letters = {*formulas.LETTERS, *formulas.ITALIC}
    for page in PAGES:
        for formula in formulas.marked(page.read_text(encoding="utf-8"))[1]:
            text = html.unescape(re.sub(r"<[^>]+>", "", formula))
            assert set(map(ord, text)) <= letters, f"{page.name}: {text}"
            count += 1
    assert count > 80
    assert formulas.font()[:4] == b"\x00\x01\x00\x00"


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
    assert links.rewritten(text, "docs", "page.md") == expected
    assert set(links.outward(text, "docs")) == {"notebooks/six_bar.ipynb", "tests/test_units.py"}
    assert links.rewritten("[a](docs/images/x.png)", "", "contributing.md") == "[a](images/x.png)"
    assert links.rewritten("[a](../validation.md)", "docs/api", "api/solve.md") == "[a](../validation.md)"


def test_network_access_of_a_page_is_detected():
    assert links.fetched('<script defer src="https://unpkg.com/x.js"></script>') == ["https://unpkg.com/x.js"]
    assert links.fetched('<link rel="stylesheet" href="//fonts.example/css">') == ["//fonts.example/css"]
    assert (
        links.fetched('<link rel=canonical href=https://example.org/><a href="https://example.org">x</a><img src="a.png">') == []
    )


def test_a_notebook_becomes_a_page():
    text, pictures = links.notebook("notebooks/crank_rocker.ipynb")
    assert text.startswith("# ")
    assert "six_bar.ipynb){" not in text
    assert "````python\n" in text
    assert pictures
    assert all(data[:4] in (b"\x89PNG", b"GIF8") for data in pictures.values())
    assert all(f"({name})" in text for name in pictures)


@pytest.mark.slow
def test_the_site_builds_without_warnings_or_network(tmp_path, monkeypatch, caplog):
    pytest.importorskip("mkdocs")
    pytest.importorskip("material")
    from mkdocs.commands.build import build
    from mkdocs.config import load_config

    monkeypatch.chdir(ROOT)
    monkeypatch.setenv("NO_MKDOCS_2_WARNING", "1")  # a word of the theme's makers about the future, on every build
    site = tmp_path / "site"
    with warnings.catch_warnings(), caplog.at_level(logging.WARNING):
        warnings.simplefilter("ignore")  # of other libraries; those of MkDocs are in its log
        config = load_config(str(ROOT / "mkdocs.yml"), strict=True, site_dir=str(site))
        build(config)
    assert caplog.records == []
    pages = list(site.rglob("*.html"))
    assert len(pages) > 40
    for page in pages:
        html = page.read_text(encoding="utf-8")
        assert links.fetched(html) == []
        if "source" not in page.relative_to(site).parts:
            assert not re.search(r"toml (?:design|laws)", html), page.name
    for style in site.rglob("*.css"):
        assert not re.search(r"url\(['\"]?(?:https?:)?//", style.read_text(encoding="utf-8")), style.name
