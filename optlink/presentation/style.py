"""Figure style: colours, fonts, display units and saving of figures."""

import contextlib
import functools
import io
import logging
import re
import sys
import textwrap
import unicodedata
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, Literal, ParamSpec, TypeVar

import matplotlib as mpl
import numpy as np
from matplotlib import font_manager, patheffects
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure as PlainFigure
from matplotlib.text import Text
from numpy.typing import NDArray
from PIL import Image

from optlink.io import whole
from optlink.presentation.chart_spec import (
    BODIES as BODIES,
    COUPLER as COUPLER,
    CRANK as CRANK,
    GROUND as GROUND,
    LIMIT as LIMIT,
    MUTED as MUTED,
    RESULT as RESULT,
    ROCKER as ROCKER,
    SHADE as SHADE,
    TARGET as TARGET,
)
from optlink.presentation.format import Scale as Scale, degrees as degrees, scale as scale

# Fonts of the pictures: those for Chinese letters in a title, and what stands for letters that no font has.

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


def legible(figure: PlainFigure) -> None:
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


HALO: list[patheffects.AbstractPathEffect] = [patheffects.withStroke(linewidth=2.5, foreground="white")]
STYLE: dict[Any, Any] = {
    "font.size": 9.5,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.formatter.useoffset": False,  # whole numbers at the ticks, no "+2.729e2" above them
    "axes.titley": 1.0,  # where it is anyway: else the ticks are measured again for each title
    "grid.alpha": 0.25,
    "svg.hashsalt": "optlink",  # else the names in an SVG file are random
    "text.parse_math": False,  # do not interpret dollar signs in titles as mathematics
}

P = ParamSpec("P")
T = TypeVar("T")
DPI = 150  # pixels per inch of a picture
MAX_GIF_BYTES = 1_500_000  # largest size of an animation [bytes]


@contextlib.contextmanager
def apply_style() -> Iterator[None]:
    """Apply the style of the project, independent of the settings of the caller; matplotlib gives no messages about fonts."""
    with mpl.rc_context({**STYLE, "font.family": families()}), warnings.catch_warnings(), without_weight_messages():
        warnings.filterwarnings("ignore", message="Glyph .* missing from", category=UserWarning)
        yield


def styled(draw: Callable[P, T]) -> Callable[P, T]:
    """Decorate a function to draw in the style of the project."""

    @functools.wraps(draw)
    def inside(*args: P.args, **kwargs: P.kwargs) -> T:
        with apply_style():
            return draw(*args, **kwargs)

    return inside


class Figure(PlainFigure):
    """A figure that a notebook shows as the value of a cell, whether or not its kernel has a backend of matplotlib."""

    def _repr_png_(self) -> bytes:
        with io.BytesIO() as stream:
            self.savefig(stream, format="png")
            return stream.getvalue()


def figure(width: float, height: float, layout: Literal["constrained"] | None = "constrained") -> Figure:
    """Return an empty figure [inch] without a window; without a layout, axes stand at given places."""
    fig = Figure(figsize=(width, height), layout=layout)
    FigureCanvasAgg(fig)
    return fig


def notebook_figure(width: float, height: float) -> Figure:
    """Return an empty figure [inch], which IPython shows at the end of the cell, as those of pyplot.

    Not within `apply_style`: pyplot selects its backend with its first figure, for good.
    """
    shell = sys.modules.get("IPython")
    if shell is None or shell.get_ipython() is None:
        return figure(width, height)
    from matplotlib import pyplot

    return pyplot.figure(figsize=(width, height), layout="constrained", FigureClass=Figure)  # type: ignore[return-value]


def panels(fig: PlainFigure, count: int, columns: int) -> list[Axes]:
    """Return axes in rows, the last of which may be shorter."""
    grid = fig.add_gridspec(-(-count // columns), columns)
    return [fig.add_subplot(grid[divmod(k, columns)]) for k in range(count)]


def heading(text: str, width: float, size: float = 11.0) -> str:
    """Break the lines of a title so that they fit a width [inch] at a font size [pt]."""
    if "\n" in text:
        return "\n".join(heading(line, width, size) for line in text.split("\n"))
    wide = any(unicodedata.east_asian_width(letter) in "WF" for letter in text)
    return textwrap.fill(text, max(16, int(72.0 * width / ((1.0 if wide else 0.58) * size))))


# --- files -----------------------------------------------------------------------------------------------------------


def save(fig: PlainFigure, path: Path) -> None:
    """Write a figure as PNG, SVG or PDF, according to the suffix of the path; the same figure gives the same bytes."""
    with whole(path) as temporary, apply_style():
        legible(fig)
        kind = path.suffix.removeprefix(".")
        if kind == "png":  # `savefig` draws a figure twice
            shown = fig.get_dpi()
            fig.set_dpi(DPI)
            canvas = FigureCanvasAgg(fig)
            canvas.draw()
            opaque = np.ascontiguousarray(np.asarray(canvas.buffer_rgba())[..., :3])
            Image.fromarray(opaque).save(temporary, format=kind, dpi=(DPI, DPI), compress_level=3)
            fig.set_dpi(shown)
            return
        dates = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}
        fig.savefig(temporary, format=kind, dpi=DPI, metadata=dates.get(kind))


def save_film(pictures: Sequence[Image.Image], path: Path) -> None:
    """Write frames of a common palette as a repeating GIF; frames are dropped if the file would be large."""
    with whole(path) as temporary:
        for step in (1, 2, 3):
            shown = pictures[::step]
            shown[0].save(temporary, save_all=True, append_images=list(shown[1:]), duration=40 * step, loop=0, optimize=False)
            if temporary.stat().st_size <= MAX_GIF_BYTES:
                break


def one_palette(pictures: Sequence[NDArray[np.uint8]], colours: int = 160) -> list[Image.Image]:
    """Convert frames (height, width, 3) to a common palette, in which the most frequent colours are exact."""
    packed = [(p[..., 0].astype(np.int32) << 16) | (p[..., 1].astype(np.int32) << 8) | p[..., 2] for p in pictures]
    colours_used, counts = np.unique(np.concatenate([p.ravel() for p in packed[:: max(1, len(packed) // 6)]]), return_counts=True)
    order = np.argsort(-counts, kind="stable")
    exact = _unpacked(colours_used[order[: 2 * colours // 3]])
    chosen = exact
    rest = _unpacked(colours_used[order[2 * colours // 3 :]])
    if len(rest):
        count = colours - len(exact)
        palette = Image.fromarray(rest[None, :, :]).quantize(count).getpalette() or []
        chosen = np.concatenate([exact, np.array(palette[: 3 * count], dtype=np.uint8).reshape(-1, 3)])
    used = np.zeros(1 << 24, dtype=bool)
    for p in packed:
        used[p] = True
    used_colours = np.flatnonzero(used)
    nearest = np.zeros(1 << 24, dtype=np.uint8)
    for k in range(0, len(used_colours), 4096):
        difference = _unpacked(used_colours[k : k + 4096]).astype(np.int32)[:, None, :] - chosen.astype(np.int32)
        nearest[used_colours[k : k + 4096]] = np.argmin(np.sum(difference * difference, axis=-1), axis=-1)
    converted = []
    for p in packed:
        picture = Image.fromarray(nearest[p])  # greyscale until the palette is set
        picture.putpalette(chosen.ravel().tolist())
        converted.append(picture)
    return converted


def _unpacked(colours: NDArray[Any]) -> NDArray[np.uint8]:
    return np.stack([colours >> 16, (colours >> 8) & 255, colours & 255], axis=-1).astype(np.uint8)
