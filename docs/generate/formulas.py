"""Formulas as MathML, which browsers show without a script, in a font of the site.

Pages contain LaTeX in the form that code hosts read: a fence ```math, or `$` around code in a line.
"""

from __future__ import annotations

import importlib.util
import io
import re
from collections.abc import Callable
from pathlib import Path

BLOCK = re.compile(r"^```math\n(?P<tex>.*?)^```[ ]*$", re.DOTALL | re.MULTILINE)
INLINE = re.compile(r"\$`(?P<tex>[^`\n]+)`\$")
FENCE = re.compile(r"^(`{3,}|~~~).*?^\1[ ]*$", re.DOTALL | re.MULTILINE)
ALIGNED = re.compile(r"\s*\\begin\{aligned\}(?P<rows>.*)\\end\{aligned\}\s*", re.DOTALL)
NAMED = re.compile(r"(<mi>(?:cos|sin|tan|tanh|arcsin|arccos|max|min|log)</mi>)(?=<m(?:i|sub|sup|frac|n)\b)")


def mathml(tex: str, *, block: bool = False) -> str:
    """Return a formula as a MathML element.

    Parameters
    ----------
    tex : str
        LaTeX; a block can be an `aligned` environment.
    block : bool, optional
        Whether the formula has lines of its own.

    Raises
    ------
    ValueError
        If a command is unknown.
    """
    aligned = ALIGNED.fullmatch(tex) if block else None
    if aligned:
        rows = [row.split("&") for row in aligned["rows"].split(r"\\")]
        cells = ["".join(f"<mtd>{_inner(cell, block=True)}</mtd>" for cell in row) for row in rows]
        inside = f"<mtable displaystyle='true'>{''.join(f'<mtr>{row}</mtr>' for row in cells)}</mtable>"
    else:
        inside = _inner(tex, block=block)
    text = inert(inside)
    return f'<math display="block">{text}</math>' if block else f"<math>{text}</math>"


def _inner(tex: str, *, block: bool) -> str:
    from latex2mathml.converter import convert

    made = re.sub(r"^<math[^>]*>|</math>$", "", convert(" ".join(tex.split()), display="block" if block else "inline"))
    if "\\" in made:
        raise ValueError(f"not a formula: {tex}")
    return NAMED.sub(r'\1<mspace width="0.17em"/>', made)


def inert(html: str) -> str:
    """Return HTML in which Markdown finds no signs of its own, no end of a cell either."""
    return re.sub(r"[*_`|\\\[\]~^]", lambda found: f"&#{ord(found[0])};", html)


def shown(markdown: str) -> str:
    """Return a page with MathML in the place of its formulas.

    Parameters
    ----------
    markdown : str
        Formulas inside fences of code are none.
    """

    def inline(text: str) -> str:
        return INLINE.sub(lambda found: f"<span>{mathml(found['tex'])}</span>", text)

    text = BLOCK.sub(lambda found: f'\n<div class="formula">{mathml(found["tex"], block=True)}</div>\n', markdown)
    return outside_fences(text, inline)


def outside_fences(markdown: str, change: Callable[[str], str]) -> str:
    """Return a text with a change to everything but its fences of code."""
    done, at = [], 0
    for fence in FENCE.finditer(markdown):
        done += [change(markdown[at : fence.start()]), fence[0]]
        at = fence.end()
    return "".join([*done, change(markdown[at:])])


LETTERS = (
    *range(0x20, 0x7F),
    0xA0,
    0xA8,
    0xB0,
    0xB7,
    0xD7,
    0x2D9,
    *range(0x391, 0x3F7),
    *range(0x2010, 0x2058),
    0x210E,
    0x2202,
    *range(0x2200, 0x2270),
)
ITALIC = (*range(0x1D400, 0x1D468), *range(0x1D6E2, 0x1D71C))


def font() -> bytes:
    """Return STIX Two Math with the letters and signs of formulas alone."""
    from fontTools.subset import Options, Subsetter
    from fontTools.ttLib import TTFont

    found = importlib.util.find_spec("ziamath")
    assert found is not None
    assert found.origin is not None
    whole = TTFont(Path(found.origin).parent / "fonts" / "STIXTwoMath-Regular.ttf", recalcTimestamp=False)
    subset = Subsetter(Options(layout_features=["ssty"], hinting=False, notdef_outline=True))
    subset.populate(unicodes=[*LETTERS, *ITALIC])
    subset.subset(whole)
    with io.BytesIO() as stream:
        whole.save(stream)
        return stream.getvalue()
