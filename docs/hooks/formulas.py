"""Formulas as MathML, which browsers show without a script, in a font of the site.

Pages contain LaTeX in the form that code hosts read: a fence ```math, or `$` around code in a line. MkDocs calls
`on_files`, which adds a mathematical font, `on_page_markdown`, which puts marks in the place of formulas, and
`on_page_content`, which replaces the marks.
"""

from __future__ import annotations

import importlib.util
import io
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mkdocs.config.defaults import MkDocsConfig
    from mkdocs.structure.files import Files
    from mkdocs.structure.pages import Page

BLOCK = re.compile(r"^```math\n(?P<tex>.*?)^```[ ]*$", re.DOTALL | re.MULTILINE)
INLINE = re.compile(r"\$`(?P<tex>[^`\n]+)`\$")
FENCE = re.compile(r"^(```|~~~).*?^\1[ ]*$", re.DOTALL | re.MULTILINE)
ALIGNED = re.compile(r"\s*\\begin\{aligned\}(?P<rows>.*)\\end\{aligned\}\s*", re.DOTALL)
NAMED = re.compile(r"(<mi>(?:cos|sin|tan|tanh|arcsin|arccos|max|min|log)</mi>)(?=<m(?:i|sub|sup|frac|n)\b)")
OPENED = '<math display="block">'
MARK = "optlinkformula{}z"


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
    return f"{OPENED if block else '<math>'}{inside}</math>"


def _inner(tex: str, *, block: bool) -> str:
    from latex2mathml.converter import convert

    made = re.sub(r"^<math[^>]*>|</math>$", "", convert(" ".join(tex.split()), display="block" if block else "inline"))
    if "\\" in made:
        raise ValueError(f"not a formula: {tex}")
    return NAMED.sub(r'\1<mspace width="0.17em"/>', made)


def marked(markdown: str) -> tuple[str, list[str]]:
    """Return a page with a mark in the place of each formula, and the formulas as MathML.

    Parameters
    ----------
    markdown : str
        Formulas inside fences of code are none.
    """
    found: list[str] = []

    def mark(html: str) -> str:
        found.append(html)
        return MARK.format(len(found) - 1)

    def inline(text: str) -> str:
        return INLINE.sub(lambda match: mark(mathml(match["tex"])), text)

    text = BLOCK.sub(lambda match: f"\n{mark(mathml(match['tex'], block=True))}\n", markdown)
    parts, at = [], 0
    for fence in FENCE.finditer(text):
        parts += [inline(text[at : fence.start()]), fence[0]]
        at = fence.end()
    return "".join([*parts, inline(text[at:])]), found


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
    whole = TTFont(Path(found.origin).parent / "fonts" / "STIXTwoMath-Regular.ttf")
    subset = Subsetter(Options(layout_features=["ssty"], hinting=False, notdef_outline=True))
    subset.populate(unicodes=[*LETTERS, *ITALIC])
    subset.subset(whole)
    with io.BytesIO() as stream:
        whole.save(stream)
        return stream.getvalue()


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """MkDocs: add the font."""
    from mkdocs.structure.files import File

    files.append(File.generated(config, "assets/math.ttf", content=font()))
    return files


def on_page_markdown(markdown: str, page: Page, **_: Any) -> str:
    """MkDocs: put marks in the place of formulas."""
    text, page.meta["formulas"] = marked(markdown)
    return text


def on_page_content(html: str, page: Page, **_: Any) -> str:
    """MkDocs: replace the marks by formulas."""
    for k, formula in enumerate(page.meta.pop("formulas", [])):
        mark = MARK.format(k)
        if formula.startswith(OPENED):
            html = html.replace(f"<p>{mark}</p>", f'<div class="formula">{formula}</div>')
        html = html.replace(mark, formula)
    return html
