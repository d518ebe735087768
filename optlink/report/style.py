"""The house's style: colours, figures, units that suit the size of what is shown, and how a picture gets onto the disk."""

from __future__ import annotations

import contextlib
import functools
import math
import textwrap
import unicodedata
import warnings
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple, ParamSpec, TypeVar

import matplotlib as mpl
from matplotlib import font_manager, patheffects
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

from optlink.report.store import whole

CRANK, COUPLER, ROCKER, GROUND = "#c0392b", "#2c6fbb", "#2e8b57", "#444444"
BODIES = (COUPLER, ROCKER, "#d07d00", "#7d55a8", "#17888f", "#a0522d", "#c2527f", "#6f7d22", "#5a6b7b")
"""Colours of the bodies after the crank, in the order in which they are placed."""
QUIET, WANTED, FOUND, LIMIT = "#9a9a9a", "#111111", "#2c6fbb", "#c0392b"
SHADE = "#f3e3c3"
HALO = [patheffects.withStroke(linewidth=2.5, foreground="white")]
OTHER_SCRIPTS = ("Noto Sans CJK SC", "Source Han Sans SC", "Microsoft YaHei", "SimHei", "PingFang SC", "WenQuanYi Zen Hei")
STYLE: dict[Any, Any] = {
    "font.family": ["DejaVu Sans", *sorted({f.name for f in font_manager.fontManager.ttflist}.intersection(OTHER_SCRIPTS))],
    "font.size": 9.5,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.alpha": 0.25,
    "text.parse_math": False,  # a dollar in a title is a dollar
}

P = ParamSpec("P")
T = TypeVar("T")


@contextlib.contextmanager
def house() -> Iterator[None]:
    """The house's style, whatever the caller's is; a letter that no font has is drawn as a box without a word."""
    with mpl.rc_context(STYLE), warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Glyph .* missing from", category=UserWarning)
        yield


def styled(draw: Callable[P, T]) -> Callable[P, T]:
    """Let a function draw in the house's style."""

    @functools.wraps(draw)
    def inside(*args: P.args, **kwargs: P.kwargs) -> T:
        with house():
            return draw(*args, **kwargs)

    return inside


def figure(width: float, height: float) -> Figure:
    """An empty figure [inch] that no window shows."""
    made = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(made)
    return made


def heading(text: str, width: float, size: float = 11.0) -> str:
    """A title broken into lines that fit into a width [inch]."""
    wide = any(unicodedata.east_asian_width(letter) in "WF" for letter in text)
    return textwrap.fill(text, max(16, int(72.0 * width / ((1.0 if wide else 0.58) * size))))


# --- units -----------------------------------------------------------------------------------------------------------


class Scale(NamedTuple):
    """How a quantity in SI is shown: times `factor`, in `unit`; `decimals` show the largest value to five digits."""

    factor: float
    unit: str
    decimals: int = 3

    def text(self, value: float) -> str:
        """A value [SI] with its unit."""
        shown = f"{value * self.factor:.{self.decimals}f}"
        if float(shown) == 0.0:
            shown = shown.lstrip("-")
        return f"{shown}{'°' if self.unit == 'deg' else ' ' + self.unit}"


LENGTH = ((1e3, "k", 5.0), (1.0, "", 2.0), (1e-3, "m", 1.0), (1e-6, "µ", 1.0), (1e-9, "n", 0.0))
OTHER = ((1e9, "G", 5.0), (1e6, "M", 5.0), (1e3, "k", 5.0), (1.0, "", 0.5), (1e-3, "m", 0.5), (1e-6, "µ", 0.5), (1e-9, "n", 0.0))
PREFIXED = {"m": LENGTH, "m/s": OTHER[3:], "m/s²": OTHER[3:], "N": OTHER, "N m": OTHER, "J": OTHER, "W": OTHER}
"""Prefixes by unit: size, letter, and from how many of them on it is taken."""


def scale(largest: float, unit: str) -> Scale:
    """The scale in which quantities up to `largest` [SI] are read best; angles [rad] are shown in degrees."""
    largest = abs(largest) if math.isfinite(largest) else 0.0
    if unit == "deg":
        return Scale(math.degrees(1.0), unit, 2)
    factor, letter = 1.0, ""
    if largest > 0.0 and unit in PREFIXED:
        size, letter = next((size, letter) for size, letter, least in PREFIXED[unit] if largest >= least * size or least == 0.0)
        factor = 1.0 / size
    digits = math.floor(math.log10(largest * factor)) if largest > 0.0 else 0
    return Scale(factor, letter + unit, min(max(0, 4 - digits), 9))


# --- files -----------------------------------------------------------------------------------------------------------


def save(drawn: Figure, path: Path) -> None:
    """Write a picture."""
    with whole(path) as temporary, house():
        drawn.savefig(temporary, dpi=150)


def save_film(pictures: Sequence[Image.Image], path: Path) -> None:
    """Write pictures of one palette as a film that repeats."""
    with whole(path) as temporary:
        pictures[0].save(temporary, save_all=True, append_images=list(pictures[1:]), duration=40, loop=0, optimize=False)


def one_palette(pictures: Sequence[Image.Image], colours: int = 128) -> list[Image.Image]:
    """Pictures in one palette that all of them were asked for, so that no colour flickers."""
    asked = pictures[:: max(1, len(pictures) // 6)]
    width, height = pictures[0].size
    together = Image.new("RGB", (width, height * len(asked)))
    for k, picture in enumerate(asked):
        together.paste(picture, (0, k * height))
    palette = together.quantize(colours)
    return [picture.quantize(palette=palette, dither=Image.Dither.NONE) for picture in pictures]
