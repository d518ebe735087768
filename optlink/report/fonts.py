"""Fonts of the pictures: those for Chinese letters in a title, and what stands for letters that no font has."""

import contextlib
import functools
import logging
import re
import unicodedata
import warnings
from collections.abc import Iterable, Iterator

from matplotlib import font_manager
from matplotlib.figure import Figure
from matplotlib.text import Text

LATIN = "DejaVu Sans"  # comes with matplotlib
CHINESE = (
    "Noto Sans CJK SC",
    "Noto Sans SC",
    "Source Han Sans SC",
    "Source Han Sans CN",
    "Microsoft YaHei",
    "PingFang SC",
    "Hiragino Sans GB",
    "WenQuanYi Micro Hei",
    "WenQuanYi Zen Hei",
    "SimHei",
    "DengXian",
    "Heiti SC",
    "STHeiti",
    "Noto Sans CJK JP",  # the one face of Noto Sans CJK that older versions of matplotlib read
    "Noto Serif CJK SC",
    "Source Han Serif SC",
    "SimSun",
    "Songti SC",
    "Arial Unicode MS",
    "Droid Sans Fallback",
)
"""Common fonts with Chinese letters of Linux, Windows and macOS, in order of preference."""
OMITTED = "\u2026"


class LettersNotDrawn(UserWarning):
    """A picture shows an ellipsis in place of letters that no font of this machine has."""


def families() -> list[str]:
    """Return the names of the installed fonts for pictures, in the order in which a letter is looked up in them."""
    installed = {font.name for font in font_manager.fontManager.ttflist}
    return [LATIN, *(name for name in CHINESE if name in installed)]


def legible(figure: Figure) -> None:
    """Prepare the texts of a figure for drawing: no letter becomes a box.

    A text with letters that its fonts lack gets fonts that were installed since matplotlib made its list of them. Letters that no
    font has become an ellipsis, and a warning names them once.
    """
    texts = [text for text in figure.findobj(Text) if lacking(text.get_text(), text.get_fontfamily())]
    if not texts:
        return
    add_new_fonts()
    chosen = families()
    for text in texts:
        text.set_fontfamily(chosen)
        letters = lacking(text.get_text(), chosen)
        if letters:
            text.set_text(without(text.get_text(), letters))
            warn_once("".join(letters))


def lacking(text: str, names: Iterable[str]) -> list[str]:
    """Return the letters of a text that none of the families of fonts has, each once."""
    other = dict.fromkeys(letter for letter in text if not letter.isascii())
    return [letter for letter in other if not any(ord(letter) in _codes(name) for name in names)] if other else []


@functools.cache
def _codes(name: str) -> frozenset[int]:
    """Code points of the letters of a font."""
    path = font_manager.findfont(font_manager.FontProperties(family=[name]))
    return frozenset(font_manager.get_font(path).get_charmap())


def without(text: str, letters: Iterable[str]) -> str:
    """Return a text with an ellipsis in place of each group of letters, which may have spaces between them."""
    one = f"[{re.escape(''.join(letters))}]"
    return re.sub(rf"{one}(?:\s*{one})*", OMITTED, text)


@functools.cache
def add_new_fonts() -> None:
    """Add fonts to the list that matplotlib stored when it was used first."""
    listed = {font.fname for font in font_manager.fontManager.ttflist}
    for path in font_manager.findSystemFonts():
        if path not in listed:
            with contextlib.suppress(Exception):  # matplotlib leaves out what it cannot read, too
                font_manager.fontManager.addfont(path)


@contextlib.contextmanager
def without_weight_messages() -> Iterator[None]:
    """Drop the message of matplotlib that a font, such as WenQuanYi Zen Hei, has no normal weight."""
    log = logging.getLogger(font_manager.__name__)

    def other(record: logging.LogRecord) -> bool:
        return "Failed to find font weight" not in record.getMessage()

    log.addFilter(other)
    try:
        yield
    finally:
        log.removeFilter(other)


@functools.cache
def warn_once(letters: str) -> None:
    """Warn that letters are not drawn, and name a font that has them."""
    asian = any(unicodedata.east_asian_width(letter) in "WF" and unicodedata.category(letter) != "So" for letter in letters)
    remedy = (
        "Install a font with Chinese letters, for example Noto Sans CJK (package fonts-noto-cjk of Debian and Ubuntu)"
        if asian
        else "Leave them out"
    )
    message = f"no font of this machine has {letters}, so pictures show {OMITTED} in their place. {remedy}"
    warnings.warn(message, LettersNotDrawn, stacklevel=2)
