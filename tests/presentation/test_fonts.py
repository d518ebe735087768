"""Letters that the font of the pictures lacks: drawn by another font, or replaced by an ellipsis with one note."""

from __future__ import annotations

import numpy as np
import pytest
from fontTools.fontBuilder import FontBuilder
from fontTools.pens.ttGlyphPen import TTGlyphPen
from matplotlib import font_manager
from matplotlib.backends.backend_agg import FigureCanvasAgg

from optlink.presentation import style, style as fonts
from optlink.presentation.html import notebook
from tests.cli.test_cli import run

TITLE = "牛头刨床: six bodies"


@pytest.fixture(autouse=True)
def fresh(monkeypatch):
    """Matplotlib's own fonts alone, without what earlier tests found; no font of the machine."""
    own = [font for font in font_manager.fontManager.ttflist if "matplotlib" in str(font.fname)]
    monkeypatch.setattr(font_manager.fontManager, "ttflist", own)
    monkeypatch.setattr(font_manager, "findSystemFonts", list)
    caches = [fonts._codes, fonts.add_new_fonts, fonts.warn_once, font_manager.fontManager._findfont_cached]
    for cached in caches:
        cached.cache_clear()
    yield
    for cached in caches:
        cached.cache_clear()


def font_file(folder, family, letters):
    """A font whose letters are full squares, half of their height below the line."""
    names = {letter: f"u{ord(letter):04X}" for letter in letters}
    pen = TTGlyphPen(None)
    pen.moveTo((0, -500))
    for corner in ((0, 500), (1000, 500), (1000, -500)):
        pen.lineTo(corner)
    pen.closePath()
    square, empty = pen.glyph(), TTGlyphPen(None).glyph()
    build = FontBuilder(1000, isTTF=True)
    build.setupGlyphOrder([".notdef", *names.values()])
    build.setupCharacterMap({ord(letter): name for letter, name in names.items()})
    build.setupGlyf({".notdef": empty, **dict.fromkeys(names.values(), square)})
    build.setupHorizontalMetrics(dict.fromkeys([".notdef", *names.values()], (1000, 0)))
    build.setupHorizontalHeader(ascent=800, descent=-500)
    build.setupNameTable({"familyName": family, "styleName": "Regular", "psName": family.replace(" ", "")})
    build.setupOS2(usWeightClass=500)  # as WenQuanYi Zen Hei
    build.setupPost()
    build.save(folder / f"{family}.ttf")
    return str(folder / f"{family}.ttf")


def titled(title):
    with style.apply_style():
        fig = style.figure(4.0, 1.0)
        fig.suptitle(title)
    return fig


def pixels(fig):
    FigureCanvasAgg(fig).draw()
    return np.asarray(fig.canvas.buffer_rgba())[..., 0]


@pytest.mark.parametrize("kind", ["png", "svg", "pdf"])
def test_letters_of_an_installed_chinese_font_are_drawn_by_it(tmp_path, caplog, kind):
    font_manager.fontManager.addfont(font_file(tmp_path, "SimHei", "牛头刨床"))
    fig = titled(TITLE)
    style.save(fig, tmp_path / f"a.{kind}")  # a warning is an error here
    assert caplog.records == []
    assert fig.get_suptitle() == TITLE
    assert fig._suptitle.get_fontfamily() == ["DejaVu Sans", "SimHei"]
    if kind == "png":
        assert np.mean(pixels(fig) < 50) > 0.01  # four black squares
    if kind == "svg":
        assert "SimHei-" in (tmp_path / "a.svg").read_text(encoding="utf-8")


def test_a_font_that_was_installed_after_the_list_of_matplotlib_is_found(tmp_path, monkeypatch):
    fig = titled(TITLE)
    file = font_file(tmp_path, "WenQuanYi Zen Hei", "牛头刨床")
    broken = tmp_path / "broken.ttf"
    broken.write_bytes(b"no font")
    monkeypatch.setattr(font_manager, "findSystemFonts", lambda: [str(broken), file])
    style.save(fig, tmp_path / "a.png")
    assert fig.get_suptitle() == TITLE
    assert "WenQuanYi Zen Hei" in fig._suptitle.get_fontfamily()


def test_without_a_font_an_ellipsis_stands_for_the_letters_and_one_warning_names_a_font(tmp_path):
    fig = titled(TITLE)
    with pytest.warns(fonts.LettersNotDrawn, match=r"has 牛头刨床, .* Noto Sans CJK .*fonts-noto-cjk"):
        style.save(fig, tmp_path / "a.svg")
    assert fig.get_suptitle() == "\u2026: six bodies"
    again = titled("床: the second picture")
    with pytest.warns(fonts.LettersNotDrawn, match="has 床,"):
        style.save(again, tmp_path / "b.png")
    third = titled(TITLE)
    style.save(third, tmp_path / "c.png")  # no second warning
    assert np.array_equal(pixels(third), pixels(titled("\u2026: six bodies")))


def test_the_remedy_for_a_pictograph_is_no_chinese_font(tmp_path):
    with pytest.warns(fonts.LettersNotDrawn, match="Leave them out"):
        style.save(titled("press 🙂"), tmp_path / "a.png")


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("曲柄摇杆 and 刨床", "\u2026 and \u2026"),
        ("曲柄\n摇杆", "\u2026"),
        ("φ ≤ 2 · π, Größe", "φ ≤ 2 · π, Größe"),
        ("a]曲^b", "a]\u2026^b"),
    ],
)
def test_letters_that_are_lacking_are_replaced_by_groups(text, shown):
    letters = fonts.lacking(text, fonts.families())
    assert (fonts.without(text, letters) if letters else text) == shown


def test_the_preferred_of_several_fonts_comes_first(tmp_path):
    for family in ("SimHei", "Noto Sans CJK SC", "Another Font"):
        font_manager.fontManager.addfont(font_file(tmp_path, family, "牛"))
    assert fonts.families() == ["DejaVu Sans", "Noto Sans CJK SC", "SimHei"]


def test_a_notebook_leaves_the_letters_to_the_browser():
    assert TITLE in notebook._svg(titled(TITLE))  # without a warning


@pytest.mark.slow
@pytest.mark.parametrize("present", [True, False])
def test_a_command_draws_all_pictures_and_the_film_of_a_chinese_title(tmp_path, present):
    if present:
        font_manager.fontManager.addfont(font_file(tmp_path, "Microsoft YaHei", "曲柄摇杆机构"))
    done = run("analyze", "shaper", "--set", 'title="曲柄摇杆机构"', "--out", str(tmp_path / "out"), "--film")
    assert done.exit_code == 0, done.stderr
    assert (tmp_path / "out" / "motion.gif").is_file()
    assert done.stderr.count("曲柄摇杆机构") == (0 if present else 1)
    assert done.stderr.startswith("" if present else "Note: no font of this machine has 曲柄摇杆机构, so pictures show")
    assert done.stdout.startswith("曲柄摇杆机构")
